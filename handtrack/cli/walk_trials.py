"""Seeded walks in, each simulated and followed by every method out (walk paper, Figures 3 and 5).

Walks are made and followed in parallel processes; results are put together in the order of their seeds, so that they do
not depend on how many there are. Times do: for those, take one process.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from synth.walk import WalkScene, WalkSettings, make_walk

from ..body.suit_body import body_of_walk
from ..body.walk_metrics import held, walk_errors
from ..body.walk_run import follow_walk
from ..body.walk_settings import Settings
from ..reproduce.drift_walk import NAMES, Comparison, Trial, comparison

METHODS = tuple(NAMES)
_COLOURS = ("#54a24b", "#b279a2", "#4c78a8", "#f58518", "#72b7b2", "#9aa5b1")


@dataclass(frozen=True, slots=True)
class Job:
    """One walk and how it is made."""

    seed: int
    settings: WalkSettings


def settings_of(method: str) -> Settings:
    """Settings of a key of `NAMES`."""
    if method == "drift-ff, no proposal":
        return replace(Settings(method="drift-ff"), proposal=False)
    return Settings(method=method)  # type: ignore[arg-type]


def tried(job: Job) -> Trial:
    """Simulate one walk and follow it by every method."""
    return scored(make_walk(job.seed, job.settings), METHODS, job.seed)


def scored(scene: WalkScene, methods: Sequence[str], seed: int) -> Trial:
    """Errors of every method on one walk."""
    walk, truth = scene.walk, scene.walk.truth
    if truth is None:
        raise ValueError("scene: has no truth, one was wanted")
    body = body_of_walk(walk)
    tracks = [follow_walk(walk, body, settings_of(method), seed) for method in methods]
    errors = [walk_errors(track, truth) for track in tracks]
    return Trial(
        lap=scene.lap,
        in_view=tracks[0].in_view,
        place=np.stack([each.place for each in errors]),
        heading=np.stack([np.abs(each.heading) for each in errors]),
        hand=np.stack([each.wrist.mean(axis=1) for each in errors]),
        relative=np.stack([each.relative.mean(axis=1) for each in errors]),
        held=np.array([held(each.off, track.sigma).mean() for each, track in zip(errors, tracks, strict=True)]),
        milliseconds=np.array([1e3 * float(np.median(track.seconds)) for track in tracks]),
    )


def drift_walk(
    seeds: int,
    settings: WalkSettings,
    first_seed: int = 0,
    workers: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Comparison:
    """Compare all methods on so many walks.

    Parameters
    ----------
    workers : int or None
        Processes; one for each core if None; with 1 everything is done in this one.
    progress : callable
        Called with the number of walks done.
    """
    jobs = [Job(first_seed + i, settings) for i in range(seeds)]
    return comparison(METHODS, _all(jobs, workers or os.cpu_count() or 1, progress or (lambda _: None)))


def _all(jobs: Sequence[Job], workers: int, progress: Callable[[int], None]) -> list[Trial]:
    if workers == 1:
        found = []
        for job in jobs:
            found.append(tried(job))
            progress(len(found))
        return found
    with ProcessPoolExecutor(min(workers, len(jobs)), mp_context=get_context("spawn")) as pool:
        waiting = [pool.submit(tried, job) for job in jobs]
        try:
            for count, each in enumerate(as_completed(waiting), 1):
                each.result()
                progress(count)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [each.result() for each in waiting]


def figure(result: Comparison) -> Figure:
    """The pelvis's error over the laps with quartiles (as Figure 3); the hands' errors (as Figure 5)."""
    drawn = Figure(figsize=(12.0, 8.0), layout="constrained")
    panels = drawn.subplot_mosaic([["laps", "laps"], ["relative", "absolute"]], height_ratios=[1.3, 1.0])
    laps = 1 + np.arange(result.quartiles.shape[1])
    for k, method in enumerate(result.methods):
        low, middle, high = 1e3 * result.quartiles[k].T
        colour = _COLOURS[k % len(_COLOURS)]
        panels["laps"].plot(laps, middle, color=colour, marker="o", ms=3.5, label=NAMES.get(method, method))
        panels["laps"].fill_between(laps, low, high, color=colour, alpha=0.18, lw=0)
    panels["laps"].set(xlabel="lap", ylabel="error of the pelvis (mm)", yscale="log")
    panels["laps"].xaxis.set_major_locator(MaxNLocator(integer=True))
    title = f"median and quartiles, {result.walks} simulated walk{'s' if result.walks > 1 else ''}"
    panels["laps"].set_title(title, loc="left")
    for name, quartiles in (("relative", result.relative_quartiles), ("absolute", result.hand_quartiles)):
        at = np.arange(len(result.methods))
        low, middle, high = 1e3 * quartiles.T
        colours = [_COLOURS[k % len(_COLOURS)] for k in at]
        panels[name].bar(at, high - low, bottom=low, color=colours, alpha=0.55, width=0.62)
        panels[name].hlines(middle, at - 0.31, at + 0.31, color="black", lw=1.8)
        panels[name].set_xticks(
            at, [NAMES.get(each, each).replace(" ", "\n", 1) for each in result.methods], fontsize=8
        )
        panels[name].set_ylabel("mm")
    panels["relative"].set_title("hands, relative to the pelvis", loc="left")
    panels["relative"].set_ylim(bottom=0.0)
    panels["absolute"].set_yscale("log")
    for name in ("laps", "absolute"):
        panels[name].yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panels[name].yaxis.set_major_formatter("{x:g}")
        panels[name].yaxis.set_minor_formatter(NullFormatter())
    panels["absolute"].set_title("hands, absolute", loc="left")
    for panel in panels.values():
        panel.grid(axis="y", color="#e2e5ea", linewidth=0.8)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
    drawn.legend(loc="outside lower center", ncols=6, frameon=False)
    return drawn
