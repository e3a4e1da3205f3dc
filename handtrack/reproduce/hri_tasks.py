"""Simulated tasks followed by every method in; Table I of the people paper, theirs beside ours, out.

Their recordings are not public; ours are simulated (`synth.people_tasks`). Errors can be compared with theirs in size,
and methods with each other within one's own recordings. All figures are of the operator's left wrist; while a method
puts nothing out, its last place is held, as the robot that follows it would.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

TASKS = ("T0", "T1", "T2", "T3")
RAW = "raw"
# Table I: MAE mm, STD mm, ACC m/s^2 for each task, and milliseconds.
THEIRS = {
    "raw": (
        ((66.69, 163.15, 12.65), (195.07, 271.69, 11.83), (147.39, 173.12, 11.88), (319.25, 257.59, 11.72)),
        np.nan,
    ),
    "kalman-1": (((69.57, 127.88, 6.94), (149.52, 215.98, 6.43), (227.56, 192.59, 7.27), (315.66, 262.06, 8.20)), 2.95),
    "kalman-2": (((64.19, 122.18, 6.63), (163.28, 192.80, 6.75), (149.35, 147.12, 6.54), (258.13, 241.96, 7.71)), 3.01),
    "paper": (((48.89, 19.55, 7.24), (96.98, 79.37, 8.86), (81.62, 68.12, 6.07), (77.47, 83.83, 7.57)), 8.22),
}
NAMES = {
    "raw": "raw skeletons",
    "kalman-1": "Kalman, constant velocity",
    "kalman-2": "Kalman, constant acceleration",
    "one-euro": "one-euro filter",
    "paper": "permanence, as in the paper",
    "robust": "permanence, robust",
}


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One recording, followed by each of m methods.

    Attributes
    ----------
    task : str
        One of `TASKS`.
    figures : (m, 3)
        MAE and STD, metres, and ACC, m/s^2.
    milliseconds : (m,)
        Mean of a frame; NaN where it is not measured.
    inside : (m,)
        Share of predicted keypoints of both people whose truth is in the 95 % ellipsoid; NaN without covariances.
    predicted : (m,)
        How many these are.
    switches : (m,)
        Identity switches of both people.
    """

    task: str
    figures: Float[np.ndarray, "m 3"]
    milliseconds: Float[np.ndarray, " m"]
    inside: Float[np.ndarray, " m"]
    predicted: Float[np.ndarray, " m"]
    switches: Float[np.ndarray, " m"]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Means over the recordings of each task.

    Attributes
    ----------
    methods : tuple of str
        Keys of `NAMES`, or other names.
    trials : (4,)
        Recordings of each task.
    figures : (m, 4, 3)
        MAE and STD, metres, and ACC, m/s^2, of each task; NaN for a task without recordings.
    worst : (m, 4)
        Largest MAE of a recording, metres.
    milliseconds, inside, switches : (m,)
        Mean time of a frame; share of predicted keypoints inside; sum.
    """

    methods: tuple[str, ...]
    trials: tuple[int, ...]
    figures: Float[np.ndarray, "m 4 3"]
    worst: Float[np.ndarray, "m 4"]
    milliseconds: Float[np.ndarray, " m"]
    inside: Float[np.ndarray, " m"]
    switches: Float[np.ndarray, " m"]


def comparison(methods: Sequence[str], trials: Sequence[Trial]) -> Comparison:
    """Sum up recordings that were followed by these methods.

    Raises
    ------
    ValueError
        If there is no recording.
    """
    if not trials:
        raise ValueError("trials: there are none, at least one was wanted")
    groups = [[trial for trial in trials if trial.task == task] for task in TASKS]
    m = len(methods)
    figures, worst = np.full((m, len(TASKS), 3), np.nan), np.full((m, len(TASKS)), np.nan)
    for k, group in enumerate(groups):
        if group:
            every = np.stack([trial.figures for trial in group])
            figures[:, k], worst[:, k] = every.mean(axis=0), every[:, :, 0].max(axis=0)
    predicted = np.stack([trial.predicted for trial in trials])
    inside = np.where(predicted > 0, np.stack([trial.inside for trial in trials]), 0.0)
    count = predicted.sum(axis=0)
    return Comparison(
        methods=tuple(methods),
        trials=tuple(len(group) for group in groups),
        figures=figures,
        worst=worst,
        milliseconds=np.stack([trial.milliseconds for trial in trials]).mean(axis=0),
        inside=np.where(count > 0, (inside * predicted).sum(axis=0) / np.maximum(count, 1.0), np.nan),
        switches=np.stack([trial.switches for trial in trials]).sum(axis=0),
    )


def better(raw: Float[np.ndarray, "4 3"], filtered: Float[np.ndarray, "4 3"]) -> Float[np.ndarray, " 3"]:
    """Per cent by which MAE, STD and ACC are below the raw ones, mean over the tasks (people paper, IV).

    >>> better(np.full((4, 3), 2.0), np.full((4, 3), 0.5)).tolist()
    [75.0, 75.0, 75.0]
    """
    share = 1.0 - filtered / raw
    known = np.isfinite(share).all(axis=1)
    return 100.0 * share[known].mean(axis=0) if known.any() else np.full(3, np.nan)


def theirs(method: str) -> Float[np.ndarray, "4 3"] | None:
    """Table I's figures of a method in metres and m/s^2; None where it has none."""
    found = THEIRS.get(method)
    return None if found is None else np.array(found[0]) * (1e-3, 1e-3, 1.0)


_EACH = ("MAE", "STD", "ACC")
HEADER = ("method", "", *(f"{task} {name}" for task in (*TASKS, "mean") for name in _EACH), "ms")


def table_rows(result: Comparison) -> list[list[object]]:
    """Rows of Table I, theirs above ours, under `HEADER`: millimetres, m/s^2, milliseconds."""
    out: list[list[object]] = []
    for k, method in enumerate(result.methods):
        known = theirs(method)
        name = NAMES.get(method, method)
        if known is not None:
            out.append([name, "theirs", *_cells(known), _cell(THEIRS[method][1], 2)])
            name = ""
        out.append([name, "ours", *_cells(result.figures[k]), _cell(float(result.milliseconds[k]), 2)])
    return out


GAINS = ("method", "", "MAE %", "STD %", "ACC %", "inside %", "switches")


def gain_rows(result: Comparison) -> list[list[object]]:
    """Rows of what each method gains on the raw skeletons, under `GAINS`, and how honest it is."""
    out: list[list[object]] = []
    raw = result.methods.index(RAW) if RAW in result.methods else None
    for k, method in enumerate(result.methods):
        name, ours, base = NAMES.get(method, method), [np.nan] * 3, theirs(RAW)
        if method == RAW:
            continue
        known = theirs(method)
        if known is not None and base is not None:
            out.append([name, "theirs", *(_cell(gain, 1) for gain in better(base, known)), "-", "-"])
            name = ""
        if raw is not None:
            ours = better(result.figures[raw], result.figures[k]).tolist()
        share = _cell(100.0 * float(result.inside[k]), 1)
        switches = f"{result.switches[k]:.0f}"
        out.append([name, "ours", *(_cell(gain, 1) for gain in ours), share, switches])
    return out


def _cells(figures: Float[np.ndarray, "4 3"]) -> list[str]:
    known = np.isfinite(figures).all(axis=1)
    average = figures[known].mean(axis=0) if known.any() else np.full(3, np.nan)
    return [
        _cell(value * scale, digits)
        for row in (*figures, average)
        for value, scale, digits in zip(row.tolist(), (1e3, 1e3, 1.0), (0, 0, 1), strict=True)
    ]


def _cell(value: float, digits: int) -> str:
    return "-" if not np.isfinite(value) else f"{value:.{digits}f}"


def as_data(result: Comparison) -> dict[str, object]:
    """The figures as plain data; metres, m/s^2, shares; what is not known is NaN."""
    raw = result.methods.index(RAW) if RAW in result.methods else None
    nothing = np.full(3, np.nan)
    return {
        "table": "I",
        "tasks": TASKS,
        "recordings": result.trials,
        "keypoint": "left_wrist",
        "methods": [
            {
                "method": method,
                "mae_m": result.figures[k, :, 0],
                "std_m": result.figures[k, :, 1],
                "acc_m_s2": result.figures[k, :, 2],
                "worst_mae_m": result.worst[k],
                "gain_percent": nothing if raw is None else better(result.figures[raw], result.figures[k]),
                "frame_ms": result.milliseconds[k],
                "predicted_inside_95": result.inside[k],
                "identity_switches": result.switches[k],
            }
            for k, method in enumerate(result.methods)
        ],
        "paper": [
            {
                "method": method,
                "mae_mm": [task[0] for task in figures],
                "std_mm": [task[1] for task in figures],
                "acc_m_s2": [task[2] for task in figures],
                "frame_ms": milliseconds,
            }
            for method, (figures, milliseconds) in THEIRS.items()
        ],
    }
