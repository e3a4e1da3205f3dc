"""A number of seeded assembly cycles in, each simulated and tracked by every variant out (wrist thesis, section 7.3).

Cells are made and tracked in parallel processes; results are put together in the order of their seeds, so that they do
not depend on how many there are.
"""

import math
import os
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from synth.cell import CellSettings, simulate_cell

from ..body.occluded_wrist import VARIANTS, Settings
from ..body.wrist_run import arm_of, run, settings_for
from ..formats.rgbd import read_rgbd
from ..formats.skeletons import KEYPOINTS
from ..report.wrist_facts import facts_of
from ..reproduce.assembly_occlusion import HOLD, Comparison, Cycle, comparison

KINDS = ("static", "dynamic")
_COLOURS = ("#9aa5b1", "#4c78a8", "#f58518", "#54a24b", "#b0328f")


@dataclass(frozen=True, slots=True)
class Job:
    """One cell and how it is tracked."""

    seed: int
    cell: CellSettings
    settings: tuple[Settings, ...]


def variants(particles: int | None = None, narrow: float | None = None) -> tuple[tuple[str, Settings], ...]:
    """Names and settings that are compared.

    Parameters
    ----------
    particles : int or None
        Of the wrist.
    narrow : float or None
        Degrees of another half-thickness of the joint volume that `complete` is tried with too.
    """
    found = [(name, settings_for(name, particles)) for name in VARIANTS]
    if narrow is not None:
        complete = settings_for("complete", particles)
        found.append((f"complete, {narrow:g} deg", replace(complete, half_thickness=math.radians(narrow))))
    return tuple(found)


def tracked(job: Job) -> Cycle:
    """Simulate one cell and track it by every variant."""
    with tempfile.TemporaryDirectory(prefix="handtrack-") as folder:
        simulate_cell(Path(folder) / "cell", job.seed, job.cell)
        scene = read_rgbd(Path(folder) / "cell")
        side = job.cell.side
        arm = arm_of(scene.detections, 0, side)
        truth = None if scene.truth is None else scene.truth.p[:, 0, KEYPOINTS.index(f"{side}_wrist")]
        tracks = [run(scene, settings, job.seed, 0, side) for settings in job.settings]
    facts = [facts_of(track, arm.state[:, 2], arm.p[:, 2], truth) for track in tracks]
    return Cycle(
        hidden=facts[0].hidden,
        tracked=arm.state[:, 2] == 0,
        held=np.asarray(facts[0].held),
        error=np.stack([np.asarray(each.error) for each in facts]),
        square=np.stack([np.asarray(each.square) for each in facts]),
        volume=np.stack([track.volume for track in tracks]),
        uncertain=np.stack([track.status == "uncertain" for track in tracks]),
    )


def assembly_occlusion(
    cycles: int,
    named: Sequence[tuple[str, Settings]],
    cell: CellSettings,
    first_seed: int = 0,
    kinds: Sequence[str] = KINDS,
    workers: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> tuple[Comparison, ...]:
    """Compare variants on so many cells of each kind of occlusion.

    Parameters
    ----------
    cell : CellSettings
        Of every cell, but for the kind of occlusion.
    workers : int or None
        Processes; one for each core if None; with 1 everything is done in this one.
    progress : callable
        Called with the number of cells done.
    """
    settings = tuple(each for _, each in named)
    jobs = [
        Job(first_seed + i, replace(cell, occlusion=kind), settings)  # type: ignore[arg-type]
        for kind in kinds
        for i in range(cycles)
    ]
    done = _all_tracked(jobs, workers or os.cpu_count() or 1, progress or (lambda _: None))
    names = [name for name, _ in named]
    return tuple(comparison(kind, names, done[k * cycles : (k + 1) * cycles]) for k, kind in enumerate(kinds))


def _all_tracked(jobs: Sequence[Job], workers: int, progress: Callable[[int], None]) -> list[Cycle]:
    if workers == 1:
        found = []
        for job in jobs:
            found.append(tracked(job))
            progress(len(found))
        return found
    with ProcessPoolExecutor(min(workers, len(jobs)), mp_context=get_context("spawn")) as pool:
        waiting = [pool.submit(tracked, job) for job in jobs]
        try:
            for count, each in enumerate(as_completed(waiting), 1):
                each.result()
                progress(count)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [each.result() for each in waiting]


def figure(results: Sequence[Comparison]) -> Figure:
    """Box plots of error and volume over the cycles, a row of panels for each kind of occlusion."""
    drawn = Figure(figsize=(11.0, 3.7 * len(results)), layout="constrained")
    panels = drawn.subplots(len(results), 2, squeeze=False)
    for (left, right), result in zip(panels, results, strict=True):
        rows = [result.rows[-1], *result.rows[:-1]]
        _boxes(left, [1000.0 * row.cycle_error for row in rows], [row.name for row in rows], 0)
        words = "behind a shelf" if result.kind == "static" else "behind a robot's link"
        left.set(ylabel="mean error while hidden (mm)", ylim=(0.0, None))
        left.set_title(f"{result.kind} occlusion ({words}), {result.cycles} cycles", loc="left")
        names = [f"{row.name}\ninside {100.0 * row.inside:.0f} %" for row in rows[1:]]
        _boxes(right, [1000.0 * row.cycle_volume for row in rows[1:]], names, 1)
        right.set(ylabel="volume of the 95 % ellipsoid (litres)", yscale="log")
        right.set_title("and in how many hidden frames the truth is inside", loc="left")
    return drawn


def _boxes(axes, values: Sequence[np.ndarray], names: Sequence[str], first: int) -> None:
    """A box for each variant, with the cycles themselves beside each other on top."""
    labels = [("last position\nheld" if name == HOLD else name).replace("complete, ", "complete,\n") for name in names]
    boxes = axes.boxplot(
        values, widths=0.55, showfliers=False, patch_artist=True, medianprops={"color": "black", "linewidth": 1.4}
    )
    for k, (box, each) in enumerate(zip(boxes["boxes"], values, strict=True)):
        colour = _COLOURS[(k + first) % len(_COLOURS)]
        box.set(facecolor=colour, alpha=0.45, edgecolor=colour)
        across = np.linspace(-0.18, 0.18, each.size) if each.size > 1 else np.zeros(each.size)
        axes.plot(k + 1 + across, each, ".", color=colour, markersize=5, alpha=0.9)
    axes.set_xticks(range(1, len(names) + 1), labels)
    axes.grid(axis="y", color="#e2e5ea", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
