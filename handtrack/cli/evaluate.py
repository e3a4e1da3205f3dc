"""`handtrack evaluate`: a run and the truth in, errors and the honesty of the sigmas out."""

from pathlib import Path
from typing import Annotated

import typer

from .console import say


def evaluate(
    run: Annotated[Path, typer.Argument(help="Folder that `handtrack track` wrote.", show_default=False)],
    truth: Annotated[
        Path | None, typer.Option(help="Table of true joint values; by default that of the run's sequence.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON for machines.")] = False,
) -> None:
    """Compare a run with the truth: RMSE and largest error of each joint, landmarks, frames tracked, NEES."""
    from ..evaluate import as_json as to_json
    from ..evaluate import as_text
    from ..evaluate import evaluate as compare
    from .record import open_run

    past = open_run(run, truth)
    result = compare(past.track, past.truth, past.model, past.camera)
    say((to_json if as_json else as_text)(result).rstrip())
