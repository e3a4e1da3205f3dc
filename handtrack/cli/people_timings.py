"""A number of repeats in, times of a frame of the people filter out, with two people and with twenty."""

from dataclasses import replace
from time import perf_counter

import numpy as np
from filterpy.kalman import KalmanFilter
from jaxtyping import Float

from synth.people_tasks import TaskSettings, make_task

from ..body.people import Settings, begin, step
from ..body.people_metrics import FILTERED
from ..formats.skeletons import Detections
from .timings import Timing

ROOMY = 50.0  # metres: nobody of the twenty is too far away
_COPIES = 10
_PLACES = np.stack([1.6 * (np.arange(_COPIES) % 5 - 2), np.zeros(_COPIES), 2.0 * (np.arange(_COPIES) // 5)], axis=1)


def people(repeats: int) -> list[Timing]:
    """A frame of two people who work together, and of ten such pairs; beside a Kalman filter for each keypoint."""
    task = make_task("T1", 1, TaskSettings(frames=60 + repeats))
    twin = "a filterpy Kalman filter for each keypoint"
    found = []
    for count in (1, _COPIES):
        ours, plain = _frame(task.detections, count, repeats), _plain(task.detections, 2 * count)
        found.append(Timing(f"people in view, {2 * count} x {FILTERED} keypoints", ours, twin, plain))
    return found


def _frame(seen: Detections, copies: int, repeats: int) -> float:
    """Median milliseconds of a frame, after the first 60."""
    settings = Settings() if copies == 1 else replace(Settings(), distance=ROOMY)
    state, rng, took = begin(settings), np.random.default_rng(1), []
    for n, time in enumerate(seen.time.tolist()[: 60 + repeats]):
        rows = np.flatnonzero(seen.frame == n)
        p = np.concatenate([seen.p[rows] + place for place in _PLACES[:copies]])
        confidence = np.tile(seen.confidence[rows], (copies, 1))
        begun = perf_counter()
        state, _ = step(state, time, p, confidence, rng)
        took.append(perf_counter() - begun)
    return 1e3 * float(np.median(took[60:]))


def _plain(seen: Detections, persons: int) -> float:
    """Median milliseconds of a frame in which every keypoint has its own filter, as the library gives it."""
    filters = [_filter(seen.p[0, 0]) for _ in range(persons * FILTERED)]
    took = []
    for n in range(5):
        z = np.nan_to_num(seen.p[n, 0], nan=1.0)
        begun = perf_counter()
        for each in filters:
            each.predict()
            each.update(z)
        took.append(perf_counter() - begun)
    return 1e3 * float(np.median(took))


def _filter(p: Float[np.ndarray, " 3"]) -> KalmanFilter:
    each = KalmanFilter(dim_x=6, dim_z=3)
    each.F = np.eye(6) + np.eye(6, k=3) / 30.0
    each.H = np.eye(3, 6)
    each.R = 1e-4 * np.eye(3)
    each.Q = 1e-4 * np.eye(6)
    each.x = np.concatenate([np.nan_to_num(p), np.zeros(3)])[:, None]
    return each
