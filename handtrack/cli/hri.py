"""Seeded recordings of each task in, each simulated and followed by every method out (people paper, Table I).

Recordings are made and followed in parallel processes; results are put together in the order of their seeds, so that
they do not depend on how many there are. Times do: for those, take one process.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from time import perf_counter

import numpy as np
from matplotlib.figure import Figure

from synth.people_tasks import TaskSettings, make_task

from ..body.people import follow
from ..body.people_baselines import baseline
from ..body.people_metrics import accuracy, course_of, honesty, labels_of, main_labels, switches
from ..body.people_run import MODES, settings_for
from ..formats.people import People
from ..formats.skeletons import KEYPOINTS, Detections, TruthPoints
from ..reproduce.hri_tasks import NAMES, TASKS, Comparison, Trial, comparison, theirs

METHODS = ("raw", "kalman-1", "kalman-2", "one-euro", "paper", "robust")
WRIST = KEYPOINTS.index("left_wrist")
OPERATOR = 0  # the true person whom the robot follows
_COLOURS = ("#9aa5b1", "#4c78a8", "#72b7b2", "#b279a2", "#f58518", "#54a24b")


@dataclass(frozen=True, slots=True)
class Job:
    """One recording and how it is made."""

    task: str
    seed: int
    settings: TaskSettings


def tried(job: Job) -> Trial:
    """Simulate one recording and follow it by every method; the baselines get the identities of the robust mode."""
    task = make_task(job.task, job.seed, job.settings)
    found, took = results(task.detections, job.seed)
    scores = [_score(people, task.truth) for people in found]
    return Trial(
        task=job.task,
        figures=np.array([score[:3] for score in scores]),
        milliseconds=1e3 * np.array(took) / task.detections.time.size,
        inside=np.array([score[3] for score in scores]),
        predicted=np.array([score[4] for score in scores]),
        switches=np.array([score[5] for score in scores]),
    )


def results(detections: Detections, seed: int) -> tuple[list[People], list[float]]:
    """What each of `METHODS` finds, and the seconds it took (NaN for the raw skeletons, which take none)."""
    modes, times = {}, {}
    for mode in MODES:
        begun = perf_counter()
        modes[mode] = follow(detections, settings_for(mode), seed)
        times[mode] = perf_counter() - begun
    for name in METHODS[:4]:
        begun = perf_counter()
        modes[name] = baseline(name, detections, modes["robust"], settings_for("robust"))
        times[name] = np.nan if name == "raw" else perf_counter() - begun
    return [modes[name] for name in METHODS], [times[name] for name in METHODS]


def _score(people: People, truth: TruthPoints) -> tuple[float, float, float, float, float, float]:
    """MAE, STD, ACC of the operator's wrist; share and number of predicted keypoints inside; switches."""
    labels = labels_of(people, truth)
    mains = main_labels(labels)
    f = min(people.time.size, truth.p.shape[0])
    wrist = course_of(people, int(mains[OPERATOR]), WRIST)
    found = accuracy(people.time[:f], wrist.p[:f], truth.p[:f, OPERATOR, WRIST])
    honest = honesty(people, truth, mains)
    return (
        found.mae, found.std, found.acc, honest.predicted, float(honest.predicted_count), float(switches(labels).sum()),
    )  # fmt: skip


def hri_tasks(
    seeds: int,
    settings: TaskSettings,
    first_seed: int = 0,
    tasks: Sequence[str] = TASKS,
    workers: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Comparison:
    """Compare all methods on so many recordings of each task.

    Parameters
    ----------
    workers : int or None
        Processes; one for each core if None; with 1 everything is done in this one.
    progress : callable
        Called with the number of recordings done.
    """
    jobs = [Job(task, first_seed + i, settings) for task in tasks for i in range(seeds)]
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
    """Bars of MAE, STD and ACC for each task and method; theirs as a line across."""
    drawn = Figure(figsize=(11.0, 8.4), layout="constrained")
    panels = drawn.subplots(3, 1, sharex=True)
    m, width = len(result.methods), 0.84 / len(result.methods)
    for i, (panel, words, scale) in enumerate(
        zip(panels, ("MAE (mm)", "STD (mm)", "ACC (m/s²)"), (1e3, 1e3, 1.0), strict=True)
    ):
        for k, method in enumerate(result.methods):
            at = np.arange(len(TASKS)) + (k - (m - 1) / 2) * width
            label = NAMES.get(method, method) if i == 0 else None
            panel.bar(at, scale * result.figures[k, :, i], 0.92 * width, color=_COLOURS[k % len(_COLOURS)], label=label)
            known = theirs(method)
            if known is not None:
                label = "theirs (Table I)" if i == k == 0 else None
                panel.hlines(scale * known[:, i], at - width / 2, at + width / 2, color="black", lw=1.8, label=label)
        panel.set(ylabel=words, ylim=(0.0, None))
        panel.grid(axis="y", color="#e2e5ea", linewidth=0.8)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
    recordings = f"{max(result.trials)} simulated recording{'s' if max(result.trials) > 1 else ''} of each task"
    panels[-1].set_xticks(range(len(TASKS)), TASKS)
    panels[0].set_title(f"left wrist of the operator, {recordings}", loc="left")
    drawn.legend(loc="outside lower center", ncols=4, frameon=False)
    return drawn
