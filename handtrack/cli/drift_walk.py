"""`handtrack reproduce drift-walk`: a number of seeds in, Figures 3 and 5 of the walk paper in numbers of ours out."""

from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from .console import progress, say, say_json, table


def drift_walk(
    seeds: Annotated[int, typer.Option(help="Number of seeded walks.")] = 10,
    seconds: Annotated[float, typer.Option(help="Length of each walk; a lap takes some ten.")] = 300.0,
    first_seed: Annotated[int, typer.Option(help="Seed of the first walk; the others follow.")] = 0,
    motion: Annotated[
        Path | None, typer.Option(help="BVH file of a recorded person that shapes the gait.", show_default=False)
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; one for each core if not given.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON for machines.")] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Picture to write beside the table: a .png, .svg or .pdf file.")
    ] = None,
) -> None:
    """Figures 3 and 5 of the walk paper: pelvis over laps and hands, by filters, camera alone and suit alone."""
    from synth.walk import WalkSettings

    from ..reproduce.drift_walk import (
        CLAIM_HEADER,
        LAP_HEADER,
        MORE_HEADER,
        as_data,
        claim_rows,
        lap_rows,
        more_rows,
    )
    from .pictures import check, save
    from .walk_trials import drift_walk as run
    from .walk_trials import figure

    for name, value, least in (("seeds", seeds, 1), ("seconds", seconds, 2), ("first-seed", first_seed, 0)):
        if not value >= least:
            raise InputError(f"--{name}: {value:g} given; at least {least} was wanted")
    if plot is not None:  # first: a wrong name is told before minutes of work
        check(plot)
    try:
        settings = WalkSettings(seconds=seconds, motion=motion)
    except ValueError as refused:
        raise InputError(f"--{refused}") from refused
    with progress("walks", seeds) as done:
        result = run(seeds, settings, first_seed, workers, done)
    if plot is not None:
        save(figure(result), plot)
    if as_json:
        say_json(as_data(result))
        return
    say("error of the pelvis, mm (as Figure 3)\n")
    say(table(LAP_HEADER, lap_rows(result)))
    say("\nhands, mm (as Figure 5), and more\n")
    say(table(MORE_HEADER, more_rows(result)))
    say("\nwhat the paper says of its real recordings\n")
    say(table(CLAIM_HEADER, claim_rows(result)))
    say("\ntheirs: section IV-B, in words only, for its figures print no numbers; ours: means over simulated walks")
