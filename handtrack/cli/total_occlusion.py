"""`handtrack reproduce total-occlusion`: a number of seeds in, the thesis's words beside figures of ours out."""

from pathlib import Path
from typing import Annotated

import typer

from .console import progress, say, say_json, table


def total_occlusion(
    seeds: Annotated[int, typer.Option(help="Number of seeded motions of each length.")] = 10,
    first_seed: Annotated[int, typer.Option(help="Seed of the first motion; the others follow.")] = 0,
    frames: Annotated[
        list[int] | None,
        typer.Option(help="How long the finger is hidden; once for each length.", show_default="10, 20, 30"),
    ] = None,
    refine: Annotated[bool, typer.Option("--refine", help="Edges and grey levels in one solve.")] = False,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; one for each core if not given.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON for machines.")] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Picture to write beside the table: a .png, .svg or .pdf file.")
    ] = None,
) -> None:
    """Chapter 7 of the hand thesis: a finger wholly hidden by one that looks alike, which it leaves to future work."""
    from ..reproduce.hidden_fingers import HEADER, as_data, summed, table_rows
    from ..reproduce.total_occlusion import CLAIM_HEADER, claim_rows, claims_data
    from ..settings import Settings
    from .benchmark import at_least, chosen_scenes
    from .occlusion_trials import all_tried, figure, suite, tried
    from .pictures import check, save

    at_least(seeds, first_seed)
    scenes = [*chosen_scenes(["hidden"], frames), ("crossing", 60)]
    if plot is not None:  # first: a wrong name is told before minutes of work
        check(plot)
    jobs = suite(scenes, seeds, first_seed, Settings(refine=refine))
    with progress("motions", len(jobs)) as done:
        trials = all_tried(tried, jobs, workers, done)
    rows = summed(trials)
    if plot is not None:
        save(figure(rows, trials), plot)
    if as_json:
        say_json({"chapter": "7", **as_data(rows, trials), "thesis": claims_data(rows)})
        return
    say(table(HEADER, table_rows(rows)))
    say("\nwhat the thesis says of its own method, or hopes for\n")
    say(table(CLAIM_HEADER, claim_rows(rows)))
