"""`handtrack benchmark`: a number of seeds in, the tracker's figures where hands are hidden or lost out."""

from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from .console import progress, say, say_json, table

app = typer.Typer(help="Scripted scenes on which the tracker is measured.")

_Seeds = Annotated[int, typer.Option(help="Number of seeded runs of each scene.")]
_First = Annotated[int, typer.Option(help="Seed of the first run; the others follow.")]
_Workers = Annotated[int | None, typer.Option(min=1, help="Processes; one for each core if not given.")]
_Json = Annotated[bool, typer.Option("--json", help="JSON for machines.")]
_Plot = Annotated[Path | None, typer.Option(help="Picture to write beside the table: a .png, .svg or .pdf file.")]
_Refine = Annotated[bool, typer.Option("--refine", help="Edges and grey levels in one solve.")]

SCENES = (
    ("hidden", 10),
    ("hidden", 20),
    ("hidden", 30),
    ("board", 20),
    ("crossing", 60),
    ("hand", 20),
)


@app.command("occlusion")
def occlusion(
    seeds: _Seeds = 10,
    first_seed: _First = 0,
    scene: Annotated[
        list[str] | None,
        typer.Option(help="A scene: hidden, board, crossing or hand; once for each. All if not given."),
    ] = None,
    frames: Annotated[
        list[int] | None,
        typer.Option(help="How long the finger is hidden; once for each length.", show_default=False),
    ] = None,
    refine: _Refine = False,
    workers: _Workers = None,
    as_json: _Json = False,
    plot: _Plot = None,
) -> None:
    """Fingers hidden wholly, by one that looks alike, by a board, in a whole hand: error, NEES, swaps, recovery."""
    from ..reproduce.hidden_fingers import HEADER, as_data, summed, table_rows
    from ..settings import Settings
    from .occlusion_trials import all_tried, figure, suite, tried
    from .pictures import check, save

    chosen = chosen_scenes(scene, frames)
    at_least(seeds, first_seed)
    if plot is not None:  # first: a wrong name is told before minutes of work
        check(plot)
    jobs = suite(chosen, seeds, first_seed, Settings(refine=refine))
    with progress("runs", len(jobs)) as done:
        trials = all_tried(tried, jobs, workers, done)
    rows = summed(trials)
    if plot is not None:
        save(figure(rows, trials), plot)
    if as_json:
        say_json(as_data(rows, trials))
        return
    say(table(HEADER, table_rows(rows)))


def chosen_scenes(names: list[str] | None, frames: list[int] | None) -> list[tuple[str, int]]:
    """Scenes with their lengths, as asked for; those of `SCENES` if not."""
    known = tuple(dict.fromkeys(kind for kind, _ in SCENES))
    for name in names or ():
        if name not in known:
            raise InputError(f"--scene: '{name}' given; one of {', '.join(known)} was wanted")
    for count in frames or ():
        if not 1 <= count <= 60:
            raise InputError(f"--frames: {count} given; 1 to 60 was wanted")
    wanted = names or known
    if frames:
        return [(name, count) for name in wanted for count in frames]
    return [(kind, length) for kind, length in SCENES if kind in wanted]


def at_least(seeds: int, first_seed: int) -> None:
    """Refuse numbers of seeds that make no run."""
    for name, value, least in (("seeds", seeds, 1), ("first-seed", first_seed, 0)):
        if value < least:
            raise InputError(f"--{name}: {value} given; at least {least} was wanted")


@app.command("loss")
def loss(
    seeds: _Seeds = 10,
    first_seed: _First = 0,
    refine: _Refine = False,
    workers: _Workers = None,
    as_json: _Json = False,
    plot: _Plot = None,
) -> None:
    """Injected losses (cut, jump, covered camera, wrong pose): ROC, delay of detection, share recovered."""
    from ..reproduce.loss_detection import (
        HEADER,
        as_data,
        by_kind,
        neighbours_told,
        pooled,
        status_shares,
        table_rows,
        threshold_at,
        told_at,
    )
    from ..settings import Settings
    from .loss_trials import loss_figure, loss_suite, loss_tried
    from .occlusion_trials import all_tried
    from .pictures import check, save

    at_least(seeds, first_seed)
    if plot is not None:
        check(plot)
    jobs = loss_suite(seeds, first_seed, Settings(refine=refine))
    with progress("runs", len(jobs)) as done:
        runs = all_tried(loss_tried, jobs, workers, done)
    curve = pooled(runs)
    rows = by_kind(runs, threshold_at(curve))
    if plot is not None:
        save(loss_figure(curve, rows), plot)
    if as_json:
        say_json(as_data(runs, curve, rows))
        return
    say(table(HEADER, table_rows(rows)))
    shares = ", ".join(f"{100 * told_at(curve, each):.1f} % at {100 * each:g} %" for each in (0.001, 0.01, 0.05, 0.2))
    say(f"\nlost frames told at false alarms of: {shares}; area under the ROC {curve.area:.4f}")
    beside = neighbours_told(runs, threshold_at(curve))
    say(f"threshold at 1 %: {threshold_at(curve):.3f}; held ones beside a lost one told too: {100 * beside:.1f} %")
    calm, lost = status_shares(runs)
    say(f"by status alone: {100 * lost:.1f} % of the lost frames called lost, {100 * calm:.2f} % of the calm ones")
