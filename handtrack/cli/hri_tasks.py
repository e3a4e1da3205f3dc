"""`handtrack reproduce hri-tasks`: a number of seeds in, Table I of the people paper, theirs above ours, out."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..errors import InputError
from .console import progress, say, say_json, table


def hri_tasks(
    seeds: Annotated[int, typer.Option(help="Number of seeded recordings of each task.")] = 10,
    task: Annotated[
        Literal["T0", "T1", "T2", "T3", "all"], typer.Option(help="One task of the paper, or all four.")
    ] = "all",
    first_seed: Annotated[int, typer.Option(help="Seed of the first recording; the others follow.")] = 0,
    frames: Annotated[int, typer.Option(help="Frames of each recording; 30 a second.")] = 600,
    motion: Annotated[
        Path | None, typer.Option(help="Marker file of a recorded arm that sways the hands.", show_default=False)
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; one for each core if not given.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON for machines.")] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Picture to write beside the table: a .png, .svg or .pdf file.")
    ] = None,
) -> None:
    """Table I of the people paper: the operator's left wrist in tasks T0 to T3, beside Kalman filters."""
    from synth.people_tasks import TaskSettings

    from ..reproduce.hri_tasks import GAINS, HEADER, TASKS, as_data, gain_rows, table_rows
    from .hri import figure
    from .hri import hri_tasks as run
    from .pictures import check, save

    for name, value, least in (("seeds", seeds, 1), ("frames", frames, 3), ("first-seed", first_seed, 0)):
        if value < least:
            raise InputError(f"--{name}: {value} given; at least {least} was wanted")
    if plot is not None:  # first: a wrong name is told before minutes of work
        check(plot)
    tasks = TASKS if task == "all" else (task,)
    with progress("recordings", seeds * len(tasks)) as done:
        result = run(seeds, TaskSettings(frames=frames, motion=motion), first_seed, tasks, workers, done)
    if plot is not None:
        save(figure(result), plot)
    if as_json:
        say_json(as_data(result))
        return
    say(table(HEADER, table_rows(result)))
    say("\nbelow the raw skeletons, mean over the tasks; truth in the 95 % ellipsoids of predicted keypoints\n")
    say(table(GAINS, gain_rows(result)))
    say("\ntheirs: Table I, real recordings; ours: simulated ones; MAE and STD in mm, ACC in m/s^2, ms of a frame")
