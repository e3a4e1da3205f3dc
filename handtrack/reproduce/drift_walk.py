"""Simulated walks followed by every method in; Figures 3 and 5 of the walk paper, in numbers of ours, out.

Their recordings are not public, and their figures print no numbers: what is theirs stands here in words only, as the
text says it (section IV-B), beside what ours give for it. Figure 3 is the error of the pelvis over the laps ("cycles"),
Figure 5 that of the hands: absolute, and relative to the pelvis, here in the pelvis's own axes, so that an error of the
heading does not count twice.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

NAMES = {
    "drift-ff": "Drift-FF",
    "drift-ff, no proposal": "Drift-FF without proposal",
    "pose-ff": "Pose-FF",
    "eskf": "error-state filter",
    "camera": "camera alone",
    "suit": "suit alone (XS-IMU)",
}
NEAR = 1.1  # times as large: "not significantly different"
STEADY = 0.5  # of a walk's last lap against its first: grows


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One walk of f frames, followed by each of m methods.

    Attributes
    ----------
    lap : (f,)
        Laps walked.
    in_view : (f,)
        Whether the camera saw the person.
    place : (m, f)
        Distance from the true pelvis, metres.
    heading : (m, f)
        Error of the heading, radians, 0 or more.
    hand, relative : (m, f)
        Mean distance of both wrists from the true ones, metres; and of their places in the pelvis's axes.
    held : (m,)
        Share of the places, along each axis, that two sigma hold.
    milliseconds : (m,)
        Median of a frame.
    """

    lap: Float[np.ndarray, " f"]
    in_view: Bool[np.ndarray, " f"]
    place: Float[np.ndarray, "m f"]
    heading: Float[np.ndarray, "m f"]
    hand: Float[np.ndarray, "m f"]
    relative: Float[np.ndarray, "m f"]
    held: Float[np.ndarray, " m"]
    milliseconds: Float[np.ndarray, " m"]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """All walks together; metres and radians.

    Attributes
    ----------
    methods : tuple of m str
        Keys of `NAMES`.
    walks : int
    quartiles : (m, laps, 3)
        Of the pelvis's error in each lap: 25, 50 and 75 %, over the frames of all walks; NaN without any.
    lap_means : (walks, m, laps)
        Mean error of each lap of each walk; NaN for a lap that was not walked to its end.
    means, blind, worst : (walks, m), (walks, m), (m,)
        Mean error of each walk, that while out of view (NaN for none), and the largest mean of a walk.
    heading, held, milliseconds : (walks, m), (m,), (m,)
        Mean error of the heading of each walk; means over the walks.
    hand, relative : (walks, m)
        Mean error of the wrists of each walk, absolute and relative.
    hand_quartiles, relative_quartiles : (m, 3)
        Over the frames of all walks.
    """

    methods: tuple[str, ...]
    walks: int
    quartiles: Float[np.ndarray, "m laps 3"]
    lap_means: Float[np.ndarray, "walks m laps"]
    means: Float[np.ndarray, "walks m"]
    blind: Float[np.ndarray, "walks m"]
    worst: Float[np.ndarray, " m"]
    heading: Float[np.ndarray, "walks m"]
    held: Float[np.ndarray, " m"]
    milliseconds: Float[np.ndarray, " m"]
    hand: Float[np.ndarray, "walks m"]
    relative: Float[np.ndarray, "walks m"]
    hand_quartiles: Float[np.ndarray, "m 3"]
    relative_quartiles: Float[np.ndarray, "m 3"]


def comparison(methods: Sequence[str], trials: Sequence[Trial]) -> Comparison:
    """Sum up walks that were followed by these methods.

    Raises
    ------
    ValueError
        If there is no walk.
    """
    if not trials:
        raise ValueError("trials: there are none, at least one was wanted")
    laps = max(int(np.floor(trial.lap.max())) for trial in trials)
    laps = max(laps, 1)
    quartiles = np.full((len(methods), laps, 3), np.nan)
    for k in range(laps):
        every = np.concatenate([trial.place[:, _in(trial, k)] for trial in trials], axis=1)
        if every.shape[1]:
            quartiles[:, k] = _quartiles(every)
    return Comparison(
        methods=tuple(methods),
        walks=len(trials),
        quartiles=quartiles,
        lap_means=np.stack([_lap_means(trial, laps) for trial in trials]),
        means=np.stack([trial.place.mean(axis=1) for trial in trials]),
        blind=np.stack([_mean(trial.place, ~trial.in_view) for trial in trials]),
        worst=np.stack([trial.place.mean(axis=1) for trial in trials]).max(axis=0),
        heading=np.stack([trial.heading.mean(axis=1) for trial in trials]),
        held=np.stack([trial.held for trial in trials]).mean(axis=0),
        milliseconds=np.stack([trial.milliseconds for trial in trials]).mean(axis=0),
        hand=np.stack([trial.hand.mean(axis=1) for trial in trials]),
        relative=np.stack([trial.relative.mean(axis=1) for trial in trials]),
        hand_quartiles=_quartiles(np.concatenate([trial.hand for trial in trials], axis=1)),
        relative_quartiles=_quartiles(np.concatenate([trial.relative for trial in trials], axis=1)),
    )


def _in(trial: Trial, lap: int) -> Bool[np.ndarray, " f"]:
    return (trial.lap >= lap) & (trial.lap < lap + 1)


def _lap_means(trial: Trial, laps: int) -> Float[np.ndarray, "m laps"]:
    """Means of the laps that were walked to their end; the whole walk as the first if none was."""
    whole = int(np.floor(trial.lap.max()))
    out = np.full((trial.place.shape[0], laps), np.nan)
    for k in range(whole):
        out[:, k] = _mean(trial.place, _in(trial, k))
    if not whole:
        out[:, 0] = trial.place.mean(axis=1)
    return out


def _mean(values: Float[np.ndarray, "m f"], where: Bool[np.ndarray, " f"]) -> Float[np.ndarray, " m"]:
    return values[:, where].mean(axis=1) if where.any() else np.full(values.shape[0], np.nan)


def _quartiles(values: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "m 3"]:
    return np.quantile(values, (0.25, 0.5, 0.75), axis=1).T


def growth(result: Comparison) -> Float[np.ndarray, "walks m"]:
    """Mean error of each walk's last whole lap, as a multiple of that of its first."""
    known = np.isfinite(result.lap_means)
    last = known.shape[-1] - 1 - known[..., ::-1].argmax(axis=-1)
    return np.take_along_axis(result.lap_means, last[..., None], axis=-1)[..., 0] / result.lap_means[..., 0]


LAP_HEADER = ("method", "mean", "worst walk", "lap 1", "lap 2", "half way", "last lap", "last/first", "out of view")
MORE_HEADER = ("method", "heading deg", "2 sigma hold %", "hand, absolute", "hand, relative", "ms")


def lap_rows(result: Comparison) -> list[list[object]]:
    """Rows of Figure 3 under `LAP_HEADER`: mean errors of the pelvis, millimetres."""
    rows: list[list[object]] = []
    ratio = growth(result)
    for k, method in enumerate(result.methods):
        laps = [result.lap_means[:, k, i] for i in _landmarks(result)]
        cells = [result.means[:, k], result.worst[k : k + 1], *laps]
        means = [_cell(1e3 * average(each)) for each in cells]
        blind = _cell(1e3 * average(result.blind[:, k]))
        rows.append([NAMES.get(method, method), *means, _cell(average(ratio[:, k]), 2), blind])
    return rows


def _landmarks(result: Comparison) -> tuple[int, int, int, int]:
    """First, second, middle and last lap that every walk came to the end of; the first if there is one only."""
    whole = np.isfinite(result.lap_means).all(axis=(0, 1))
    last = max(int(whole.sum()) - 1, 0)
    return 0, min(1, last), last // 2, last


def more_rows(result: Comparison) -> list[list[object]]:
    """Rows of Figure 5 and of what else counts, under `MORE_HEADER`: millimetres, degrees, milliseconds."""
    return [
        [
            NAMES.get(method, method),
            _cell(np.degrees(average(result.heading[:, k])), 2),
            _cell(100.0 * float(result.held[k])),
            _cell(1e3 * average(result.hand[:, k])),
            _cell(1e3 * average(result.relative[:, k])),
            _cell(float(result.milliseconds[k]), 2),
        ]
        for k, method in enumerate(result.methods)
    ]


def average(values: Float[np.ndarray, " n"]) -> float:
    """Mean of what is known; NaN for nothing.

    >>> average(np.array([1.0, np.nan, 3.0]))
    2.0
    """
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def _cell(value: float, digits: int = 0) -> str:
    return "-" if not np.isfinite(value) else f"{value:.{digits}f}"


@dataclass(frozen=True, slots=True)
class Claim:
    """What the paper says, and what ours give for it.

    Attributes
    ----------
    figure : str
        Which one it is about.
    theirs, ours : str
        Words; and numbers.
    holds : bool
        Whether ours say the same.
    """

    figure: str
    theirs: str
    ours: str
    holds: bool


CLAIM_HEADER = ("figure", "theirs, in words", "ours", "same")


def claims(result: Comparison) -> list[Claim]:
    """What section IV-B says of both figures, held against ours; none without Drift-FF, Pose-FF and the suit."""
    if not {"drift-ff", "pose-ff", "suit"} <= set(result.methods):
        return []
    drift, pose, suit = (result.methods.index(name) for name in ("drift-ff", "pose-ff", "suit"))
    mean = 1e3 * result.means.mean(axis=0)
    best = int(np.count_nonzero(result.means[:, drift] < result.means[:, [pose, suit]].min(axis=1)))
    first, _, _, end = _landmarks(result)
    late = 1e3 * np.nanmean(result.lap_means[:, :, end], axis=0)
    early = 1e3 * np.nanmean(result.lap_means[:, :, first], axis=0)
    spread = 1e3 * (result.quartiles[:, :, 2] - result.quartiles[:, :, 0])[suit]
    hand, relative = 1e3 * result.hand.mean(axis=0), 1e3 * result.relative.mean(axis=0)
    ratio = max(relative[drift], relative[pose]) / max(min(relative[drift], relative[pose]), 1e-9)
    numbers = (
        f"{mean[drift]:.0f} against {mean[pose]:.0f} and {mean[suit]:.0f} mm, best in {best} of {result.walks} walks"
    )
    return [
        Claim("3", "Drift-FF better than Pose-FF and XS-IMU", numbers, best == result.walks),
        Claim(
            "3",
            "XS-IMU's error grows with the cycles",
            f"{early[suit]:.0f} mm in the first lap, {late[suit]:.0f} in the last",
            bool(late[suit] > early[suit] * (1.0 + STEADY)),
        ),
        Claim(
            "3",
            "its interquartile range grows too",
            f"{spread[first]:.0f} mm in the first lap, {spread[end]:.0f} in the last",
            bool(spread[end] > spread[first]),
        ),
        Claim(
            "3",
            "in the long term both filters are better than XS-IMU",
            f"last lap: {late[drift]:.0f} and {late[pose]:.0f} against {late[suit]:.0f} mm",
            bool(max(late[drift], late[pose]) < late[suit]),
        ),
        Claim(
            "5, relative",
            "no significant difference of both filters",
            f"{relative[drift]:.0f} and {relative[pose]:.0f} mm",
            bool(ratio <= NEAR),
        ),
        Claim(
            "5, relative",
            "higher for both filters than for XS-IMU",
            f"{relative[drift]:.0f} and {relative[pose]:.0f} against {relative[suit]:.0f} mm",
            bool(min(relative[drift], relative[pose]) > relative[suit]),
        ),
        Claim(
            "5, absolute",
            "significantly lower for Drift-FF than for XS-IMU",
            f"{hand[drift]:.0f} against {hand[suit]:.0f} mm",
            bool((result.hand[:, drift] < result.hand[:, suit]).all()),
        ),
    ]


def claim_rows(result: Comparison) -> list[list[object]]:
    """The same as rows under `CLAIM_HEADER`."""
    return [[each.figure, each.theirs, each.ours, "yes" if each.holds else "no"] for each in claims(result)]


def as_data(result: Comparison) -> dict[str, object]:
    """The figures as plain data; metres, degrees, shares; what is not known is NaN."""
    ratio = growth(result)
    return {
        "figures": ["3", "5"],
        "walks": result.walks,
        "methods": [
            {
                "method": method,
                "mean_m": average(result.means[:, k]),
                "walk_means_m": result.means[:, k],
                "worst_walk_m": result.worst[k],
                "lap_quartiles_m": result.quartiles[k],
                "lap_means_m": [average(lap) for lap in result.lap_means[:, k].T],
                "last_lap_over_first": ratio[:, k],
                "out_of_view_m": average(result.blind[:, k]),
                "heading_deg": np.degrees(average(result.heading[:, k])),
                "two_sigma_hold": result.held[k],
                "hand_absolute_m": average(result.hand[:, k]),
                "walk_hand_absolute_m": result.hand[:, k],
                "hand_absolute_quartiles_m": result.hand_quartiles[k],
                "hand_relative_m": average(result.relative[:, k]),
                "hand_relative_quartiles_m": result.relative_quartiles[k],
                "frame_ms": result.milliseconds[k],
            }
            for k, method in enumerate(result.methods)
        ],
        "paper": [
            {"figure": each.figure, "theirs": each.theirs, "ours": each.ours, "same": each.holds}
            for each in claims(result)
        ],
    }
