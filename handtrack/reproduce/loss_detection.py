"""Scores of fingers that were made to be lost in, how soon and how surely the tracker tells it out.

Every frame and finger has a score, low where the tracker doubts it. With the truth known, a finger is *lost* where a
joint of it is off by more than 10 degrees, or where the camera sees nothing; *held* where all are within 5 degrees. A
frame is *calm* where all fingers are held: who doubts a finger beside a lost one gives no false alarm, but is counted.

    false alarms(c) = share of the fingers in calm frames with score <= c
    told(c)         = share of the lost ones with score <= c           the curve of both over c is the ROC
    area            = probability that a lost one scores below a calm one, ties counted half

At the threshold c of 1 % false alarms the delay is the number of frames from the first in which an injection has lost a
finger to the first with score <= c. A finger that is held again before that needed no telling.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

OFF, NEAR = np.radians(10.0), np.radians(5.0)
FALSE_ALARMS = 0.01
PROMPT = 5  # frames within which a loss should be told
STAYS = 3  # frames for which a finger must be held to count as recovered


@dataclass(frozen=True, slots=True, eq=False)
class LossRun:
    """One run of n frames and f fingers.

    Attributes
    ----------
    kind : str
        What was injected.
    at, until : int
        First frame of the injection, and first one after it.
    worst : (n, f)
        Largest error of each finger's joints, radians.
    score : (n, f)
        How sure the tracker is of each finger; any scale on which more is surer.
    struck : (f,)
        Fingers that the injection strikes.
    dark : (n,)
        Frames in which the camera sees nothing.
    called_lost : (n,)
        Frames that the tracker itself calls lost.
    """

    kind: str
    at: int
    until: int
    worst: Float[np.ndarray, "n f"]
    score: Float[np.ndarray, "n f"]
    struck: Bool[np.ndarray, " f"]
    dark: Bool[np.ndarray, " n"]
    called_lost: Bool[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class Roc:
    """Shares at rising thresholds.

    Attributes
    ----------
    threshold, false_alarms, told : (t,)
    area : float
        Under `told` over `false_alarms`.
    """

    threshold: Float[np.ndarray, " t"]
    false_alarms: Float[np.ndarray, " t"]
    told: Float[np.ndarray, " t"]
    area: float


@dataclass(frozen=True, slots=True, eq=False)
class LossRow:
    """Figures of one kind of injection at the threshold of 1 % false alarms.

    Attributes
    ----------
    events : int
        Fingers that an injection made lost.
    harmless : int
        Struck fingers that were never lost, or held again before anything was told and within `PROMPT` frames.
    prompt : int
        Events told within `PROMPT` frames.
    frames_told : float
        Share of all lost frames of the struck fingers that are told.
    delay, delay_90 : float
        Frames until told: median and nine tenths; inf for never.
    recovered, struck : int
        Struck fingers that are held at the end, and their number.
    back : float
        Median number of frames from the end of the injection until they are held.
    """

    kind: str
    events: int
    harmless: int
    prompt: int
    frames_told: float
    delay: float
    delay_90: float
    recovered: int
    struck: int
    back: float


def lost(run: LossRun) -> Bool[np.ndarray, "n f"]:
    """Where a finger is lost."""
    return (run.worst > OFF) | run.dark[:, None]


def held(run: LossRun) -> Bool[np.ndarray, "n f"]:
    """Where a finger is held."""
    return (run.worst < NEAR) & ~run.dark[:, None]


def calm(run: LossRun) -> Bool[np.ndarray, "n f"]:
    """Where all fingers of a frame are held."""
    return np.repeat(np.all(held(run), axis=1, keepdims=True), run.worst.shape[1], axis=1)


def roc(good: Float[np.ndarray, " n"], bad: Float[np.ndarray, " m"]) -> Roc:
    """The ROC of scores that should be high (`good`) and low (`bad`).

    >>> curve = roc(np.array([3.0, 2.0]), np.array([1.0, 2.0]))
    >>> curve.threshold.tolist(), curve.false_alarms.tolist(), curve.told.tolist(), curve.area
    ([1.0, 2.0, 3.0], [0.0, 0.5, 1.0], [0.5, 1.0, 1.0], 0.875)

    Raises
    ------
    ValueError
        If there are none of either.
    """
    if not good.size or not bad.size:
        raise ValueError(f"good, bad: got {good.size} and {bad.size} scores, wanted at least one of each")
    threshold = np.unique(np.concatenate([good, bad]))
    false = np.searchsorted(np.sort(good), threshold, side="right") / good.size
    told = np.searchsorted(np.sort(bad), threshold, side="right") / bad.size
    x, y = np.append(0.0, false), np.append(0.0, told)
    return Roc(threshold, false, told, float(np.sum(np.diff(x) * 0.5 * (y[1:] + y[:-1]))))


def pooled(runs: Sequence[LossRun]) -> Roc:
    """The ROC over all frames and fingers of all runs."""
    good = np.concatenate([run.score[calm(run)] for run in runs])
    return roc(good, np.concatenate([run.score[lost(run)] for run in runs]))


def threshold_at(curve: Roc, false_alarms: float = FALSE_ALARMS) -> float:
    """Highest threshold with no more false alarms than that; minus infinity if even the lowest has more."""
    allowed = np.flatnonzero(curve.false_alarms <= false_alarms)
    return float(curve.threshold[allowed[-1]]) if allowed.size else -np.inf


def told_at(curve: Roc, false_alarms: float = FALSE_ALARMS) -> float:
    """Share of the lost frames told there."""
    allowed = np.flatnonzero(curve.false_alarms <= false_alarms)
    return float(curve.told[allowed[-1]]) if allowed.size else 0.0


def delays(run: LossRun, threshold: float) -> tuple[Float[np.ndarray, " e"], int]:
    """Frames from each struck finger's loss until it is told, inf for never; and the number that needed no telling."""
    found, harmless = [], 0
    for finger in np.flatnonzero(run.struck):
        gone = run.at + np.flatnonzero(lost(run)[run.at :, finger])
        if not gone.size:
            harmless += 1
            continue
        first = gone[0]
        told = np.flatnonzero(run.score[first:, finger] <= threshold)
        again = np.flatnonzero(held(run)[first:, finger])
        delay = float(told[0]) if told.size else np.inf
        if again.size and again[0] <= min(delay, PROMPT):
            harmless += 1
        else:
            found.append(delay)
    return np.array(found), harmless


def returns(run: LossRun) -> Float[np.ndarray, " s"]:
    """Frames from the end of the injection until each struck finger is held for good; inf for one that is not."""
    begin = run.at if run.kind == "jump" else run.until
    kept = held(run)[begin:][:, run.struck]
    last = np.array([np.flatnonzero(~column)[-1] + 1 if not column.all() else 0 for column in kept.T], dtype=float)
    return np.where(last + STAYS <= kept.shape[0], last, np.inf)


def by_kind(runs: Sequence[LossRun], threshold: float) -> tuple[LossRow, ...]:
    """One row for each kind of injection, in the order in which they come, and one for all."""
    injected = [run for run in runs if run.struck.any()]
    kinds = list(dict.fromkeys(run.kind for run in injected))
    rows = [_row(kind, [run for run in injected if run.kind == kind], threshold) for kind in kinds]
    return (*rows, _row("all", injected, threshold)) if injected else ()


def _row(kind: str, runs: Sequence[LossRun], threshold: float) -> LossRow:
    pairs = [delays(run, threshold) for run in runs]
    found = np.concatenate([each for each, _ in pairs])
    back = np.concatenate([returns(run) for run in runs])
    low = np.concatenate([run.score[lost(run) & run.struck] <= threshold for run in runs])
    return LossRow(
        kind=kind,
        events=found.size,
        harmless=sum(count for _, count in pairs),
        prompt=int(np.sum(found <= PROMPT)),
        frames_told=float(low.mean()) if low.size else float("nan"),
        delay=_quantile(found, 0.5),
        delay_90=_quantile(found, 0.9),
        recovered=int(np.isfinite(back).sum()),
        struck=back.size,
        back=_quantile(back, 0.5),
    )


def _quantile(values: Float[np.ndarray, " n"], share: float) -> float:
    return float(np.quantile(values, share, method="inverted_cdf")) if values.size else float("nan")


def neighbours_told(runs: Sequence[LossRun], threshold: float) -> float:
    """Share of the held fingers beside a lost one that are told with it; NaN where there are none."""
    beside = [run.score[held(run) & np.any(lost(run), axis=1, keepdims=True)] for run in runs]
    scores = np.concatenate(beside)
    return float(np.mean(scores <= threshold)) if scores.size else float("nan")


def status_shares(runs: Sequence[LossRun]) -> tuple[float, float]:
    """Shares of the fingers in calm frames and of the lost ones, in frames that the tracker itself calls lost."""
    shares = []
    for where in (calm, lost):
        called = np.concatenate([np.broadcast_to(r.called_lost[:, None], r.worst.shape)[where(r)] for r in runs])
        shares.append(float(called.mean()) if called.size else float("nan"))
    return shares[0], shares[1]


HEADER = (
    "injected",
    "lost",
    "harmless",
    f"told in {PROMPT}",
    "frames told",
    "delay",
    "90 %",
    "recovered",
    "of",
    "after",
)


def table_rows(rows: Sequence[LossRow]) -> list[list[object]]:
    """Rows under `HEADER`."""
    return [
        [
            row.kind,
            row.events,
            row.harmless,
            f"{100.0 * row.prompt / row.events:.0f} %" if row.events else "-",
            f"{100.0 * row.frames_told:.0f} %" if row.events else "-",
            _text(row.delay),
            _text(row.delay_90),
            row.recovered,
            row.struck,
            _text(row.back),
        ]
        for row in rows
    ]


def _text(count: float) -> str:
    if np.isnan(count):
        return "-"
    return f"{count:.0f}" if np.isfinite(count) else "never"


def as_data(runs: Sequence[LossRun], curve: Roc, rows: Sequence[LossRow]) -> dict[str, object]:
    """The figures as plain data."""
    called_calm, called_lost = status_shares(runs)
    at = np.array([0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5])
    return {
        "runs": len(runs),
        "false_alarms": FALSE_ALARMS,
        "threshold": threshold_at(curve),
        "area": curve.area,
        "held_beside_lost_told": neighbours_told(runs, threshold_at(curve)),
        "roc": [{"false_alarms": float(each), "told": told_at(curve, float(each))} for each in at],
        "status": {"calm_called_lost": called_calm, "lost_called_lost": called_lost},
        "injections": [
            {
                "kind": row.kind,
                "lost": row.events,
                "harmless": row.harmless,
                f"told_within_{PROMPT}": row.prompt,
                "lost_frames_told": row.frames_told,
                "delay_median": row.delay,
                "delay_90": row.delay_90,
                "recovered": row.recovered,
                "struck": row.struck,
                "frames_until_held_median": row.back,
            }
            for row in rows
        ],
    }
