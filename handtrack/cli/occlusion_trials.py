"""Seeded occlusions in, each rendered and tracked out; in parallel processes, with results in the order of the jobs.

Results do not depend on the number of processes. Times do: for those, take one.
"""

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from typing import TypeVar

import numpy as np
from matplotlib.figure import Figure

from synth.occlusion_scenes import occlusion_scene
from synth.scripted import Scripted, finger_joints, finger_names, pictures

from ..reproduce.hidden_fingers import Row, Run, Script, Trial, trial
from ..residuals import chain
from ..settings import Settings
from ..tracker import begin, step

_Job, _Result = TypeVar("_Job"), TypeVar("_Result")


@dataclass(frozen=True, slots=True)
class Job:
    """One scene and how it is tracked."""

    kind: str
    length: int
    seed: int
    settings: Settings


def script_of(scene: Scripted, length: int) -> Script:
    """What the figures need to know of a scene."""
    model = scene.scene.model
    names = finger_names(model)
    fingers = np.zeros((len(names), len(model.joint_names)), dtype=bool)
    for number, name in enumerate(names):
        fingers[number, finger_joints(model, name)] = True
    watched = names.index(scene.watched)
    share = scene.finger_share[:, watched]
    return Script(scene.kind, length, scene.scene.seed, scene.scene.truth, fingers, watched, share, scene.hidden)


def tracked(scene: Scripted, settings: Settings) -> Run:
    """Track a scene from its first frame to its last."""
    it = scene.scene
    on = (chain(it.model, it.camera),)
    state, q, covariance, seconds = begin(on, it.start, it.fps, settings), [], [], []
    for number, image in enumerate(pictures(scene)):
        begun = time.perf_counter()
        state, frame = step(state, (image,), on, 1.0 / it.fps if number else 0.0, settings)
        seconds.append(time.perf_counter() - begun)
        q.append(frame.q)
        covariance.append(frame.covariance)
    return Run(np.array(q), np.array(covariance), float(np.median(seconds)))


def tried(job: Job) -> Trial:
    """Render and track one scene."""
    scene = occlusion_scene(job.kind, job.seed, job.length)
    return trial(script_of(scene, job.length), tracked(scene, job.settings))


def all_tried(
    work: Callable[[_Job], _Result],
    jobs: Sequence[_Job],
    workers: int | None,
    progress: Callable[[int], None] | None = None,
) -> list[_Result]:
    """The result of every job.

    Parameters
    ----------
    workers : int or None
        Processes; one for each core if None; with 1 everything is done in this one.
    progress : callable
        Called with the number of jobs done.
    """
    told = progress or (lambda _: None)
    count = min(workers or os.cpu_count() or 1, max(len(jobs), 1))
    if count == 1:
        found = []
        for job in jobs:
            found.append(work(job))
            told(len(found))
        return found
    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
        waiting = [pool.submit(work, job) for job in jobs]
        try:
            for done, each in enumerate(as_completed(waiting), 1):
                each.result()
                told(done)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [each.result() for each in waiting]


def suite(scenes: Sequence[tuple[str, int]], seeds: int, first_seed: int, settings: Settings) -> list[Job]:
    """Every scene of a name and a length, with every seed."""
    return [Job(kind, length, first_seed + i, settings) for kind, length in scenes for i in range(seeds)]


def figure(rows: Sequence[Row], trials: Sequence[Trial]) -> Figure:
    """Error while hidden beside its stated sigma, and the share of runs that found the finger again over frames."""
    drawn = Figure(figsize=(12.0, 4.2), layout="constrained")
    left, right = drawn.subplots(1, 2)
    most = 20
    for number, row in enumerate(rows):
        mine = [each for each in trials if (each.kind, each.length) == (row.kind, row.length)]
        colour, label = f"C{number % 10}", f"{row.kind} {row.length}"
        rms = [np.degrees(np.sqrt(np.mean(each.off**2))) for each in mine if each.off.size]
        stated = [np.degrees(np.sqrt(np.mean(each.sigma**2))) for each in mine if each.off.size]
        left.plot(stated, rms, "o", ms=3.5, color=colour, alpha=0.6, label=label)
        back = np.array([each.back.max(initial=0.0) for each in mine])
        back = np.where([each.swapped for each in mine], np.inf, back)
        right.step(
            np.arange(most + 1),
            [100.0 * float(np.mean(back <= k)) for k in range(most + 1)],
            where="post",
            color=colour,
            label=label,
        )
    ends = np.array([0.1, 60.0])
    left.plot(ends, ends, color="black", lw=0.8)
    left.set(xscale="log", yscale="log", xlabel="stated sigma (degrees)", ylabel="RMS error while hidden (degrees)")
    right.axvline(3, color="black", lw=0.8, ls=":")
    right.set(xlabel="frames since a tenth of it is seen again", ylabel="runs that found the finger (%)", ylim=(0, 102))
    for panel in (left, right):
        panel.grid(color="#e2e5ea", linewidth=0.8)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
    right.legend(frameon=False, loc="lower right", fontsize=8)
    return drawn
