"""`handtrack evaluate`: a run and the truth in, errors and the honesty of the sigmas out."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError
from .console import say, say_json

if TYPE_CHECKING:
    from ..evaluate import Evaluation
    from .record import Run


def evaluate(
    run: Annotated[Path, typer.Argument(help="Folder that `handtrack track` wrote.", show_default=False)],
    truth: Annotated[
        Path | None, typer.Option(help="Table of true joint values; by default that of the run's sequence.")
    ] = None,
    bound_frames: Annotated[
        int, typer.Option(min=0, help="Most frames, evenly spread, whose Cramer-Rao bound is computed; 0 for none.")
    ] = 60,
    unknown_light: Annotated[
        bool, typer.Option("--unknown-light", help="Bound with light, gains and background not known.")
    ] = False,
    source: Annotated[
        list[Path] | None,
        typer.Option("--input", help="Input of the run, where it is not where it was; once for each view."),
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="Table of error, sigma and bound in each frame to write.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Picture of the same to write (.png, .svg, .pdf).")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON for machines.")] = False,
) -> None:
    """Compare a run with the truth: errors of each joint and their ratio to the Cramer-Rao bound, landmarks, NEES."""
    from ..evaluate import as_json as to_json
    from ..evaluate import as_text
    from ..view_errors import as_data, evaluate_views
    from ..view_errors import as_text as views_text
    from .record import open_run

    past = open_run(run, truth)
    result, landmarks = evaluate_views(past.track, past.truth, past.model, past.cameras)
    if bound_frames:
        from .bounding import bounds_of_run

        result = replace(result, bounds=bounds_of_run(run, past, bound_frames, not unknown_light, source))
    _write(csv, plot, past, result)
    several = len(past.cameras) > 1
    if as_json:
        document = json.loads(to_json(result)) | ({"views": as_data(landmarks)} if several else {})
        say_json(document)
        return
    say(as_text(result).rstrip())
    if several:
        say(f"\nlandmarks in each view\n{views_text(landmarks)}")


def _write(csv: Path | None, plot: Path | None, past: "Run", result: "Evaluation") -> None:
    """Table and picture of error, sigma and bound over time, where they are wanted."""
    if csv is not None:
        from ..formats import write_text
        from ..report.bounds import error_table

        if csv.is_dir() or not csv.absolute().parent.is_dir():
            raise InputError(f"--csv: {csv}; a file in an existing folder was wanted")
        write_text(csv, error_table(past.track, past.truth, past.model, result.bounds))
    if plot is not None:
        from ..report.bounds import error_figure
        from .pictures import save

        save(error_figure(past.track, past.truth, past.model, result.bounds), plot)
