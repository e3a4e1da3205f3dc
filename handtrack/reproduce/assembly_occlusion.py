"""Tracked assembly cycles in, the wrist thesis's comparison of its variants beside ours out (section 7.3).

The thesis tells of 25 cycles for each variant. Its Figure 7.8 compares errors behind a shelf, its Figure 7.7 volumes of
the ellipsoid that holds 95 % of the particles; of both it prints changes against the original filter only. A small
ellipsoid is worth something only if the truth is inside, which the thesis does not tell: here it stands beside.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..report.wrist_facts import LITRE, QUANTILE_95, known, recovery

ORIGINAL = "original"
HOLD = "last position held"
THEIR_ERROR = {"joint-volume": -21.7, "complete": -28.3}  # section 7.3.3, static occlusions, per cent
THEIR_VOLUME = {"joint-volume": "one order", "complete": "-90"}  # section 7.3.3 and chapter 8


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """One cell, tracked by each of v variants.

    Attributes
    ----------
    hidden, tracked : (f,)
        Frames in which the sensor does not, and does, track the wrist.
    held : (f,)
        Error of the last position that it tracked, metres.
    error, square, volume : (v, f)
        Distance from the truth, metres; its square in units of the covariance; m^3.
    uncertain : (v, f)
        Frames in which all particles had died, or the elbow was not tracked either.
    """

    hidden: Bool[np.ndarray, " f"]
    tracked: Bool[np.ndarray, " f"]
    held: Float[np.ndarray, " f"]
    error: Float[np.ndarray, "v f"]
    square: Float[np.ndarray, "v f"]
    volume: Float[np.ndarray, "v f"]
    uncertain: Bool[np.ndarray, "v f"]


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """Figures of one variant over all hidden frames of all cycles.

    Attributes
    ----------
    error, p95, volume, median_volume : float
        Mean and 95 % quantile of the error, metres; m^3.
    inside, uncertain : float
        Share of hidden frames with the truth inside the 95 % ellipsoid, and with status `uncertain`.
    recovery, slowest : float
        Frames from coming back to an error below 5 cm, median and largest.
    cycle_error, cycle_volume : (n,)
        Means of each cycle that hides the wrist.
    """

    name: str
    error: float
    p95: float
    volume: float
    median_volume: float
    inside: float
    uncertain: float
    recovery: float
    slowest: float
    cycle_error: Float[np.ndarray, " n"]
    cycle_volume: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Rows of one kind of occlusion, the last of them that of the last position held."""

    kind: str
    cycles: int
    hidden: int
    rows: tuple[Row, ...]


def comparison(kind: str, names: Sequence[str], cycles: Sequence[Cycle]) -> Comparison:
    """Sum up cycles that were tracked by the variants of these names."""
    rows = [_row(name, k, cycles) for k, name in enumerate(names)]
    return Comparison(kind, len(cycles), sum(int(c.hidden.sum()) for c in cycles), (*rows, _held(cycles)))


def _row(name: str, k: int, cycles: Sequence[Cycle]) -> Row:
    error, square, volume, uncertain = (
        np.concatenate([getattr(c, field)[k, c.hidden] for c in cycles])
        for field in ("error", "square", "volume", "uncertain")
    )
    back = [frames for c in cycles for frames in recovery(c.error[k], c.tracked)]
    return Row(
        name=name,
        error=_mean(error),
        p95=_p95(error),
        volume=_mean(volume),
        median_volume=float(np.median(volume)) if volume.size else np.nan,
        inside=_mean((known(square) <= QUANTILE_95).astype(float)),
        uncertain=_mean(uncertain.astype(float)),
        recovery=float(np.median(back)) if back else np.nan,
        slowest=float(max(back)) if back else np.nan,
        cycle_error=np.array([_mean(c.error[k, c.hidden]) for c in cycles if c.hidden.any()]),
        cycle_volume=np.array([_mean(c.volume[k, c.hidden]) for c in cycles if c.hidden.any()]),
    )


def _held(cycles: Sequence[Cycle]) -> Row:
    error = np.concatenate([c.held[c.hidden] for c in cycles])
    each = np.array([_mean(c.held[c.hidden]) for c in cycles if c.hidden.any()])
    none = np.nan
    return Row(HOLD, _mean(error), _p95(error), none, none, none, none, none, none, each, np.full(each.size, none))


def _mean(values: np.ndarray) -> float:
    values = known(values)
    return float(values.mean()) if values.size else np.nan


def _p95(values: np.ndarray) -> float:
    values = known(values)
    return float(np.quantile(values, 0.95)) if values.size else np.nan


def change(ours: float, original: float) -> float:
    """Per cent.

    >>> change(0.75, 1.0)
    -25.0
    """
    return 100.0 * (ours / original - 1.0) if original > 0 else np.nan


HEADER = (
    "variant", "error mm", "p95 mm", "change %", "theirs %", "volume l", "median l", "change %", "theirs %", "inside %",
    "uncertain %", "recovery", "slowest",
)  # fmt: skip


def table_rows(result: Comparison) -> list[list[object]]:
    """Rows of the table, under `HEADER`: millimetres, litres, per cent, frames."""
    first = result.rows[0]
    out: list[list[object]] = []
    for row in result.rows:
        static = result.kind == "static"
        theirs = THEIR_ERROR.get(row.name) if static else None
        compared = row.name != first.name
        out.append(
            [
                row.name,
                f"{1000.0 * row.error:.1f}",
                f"{1000.0 * row.p95:.1f}",
                _signed(change(row.error, first.error)) if compared else "-",
                "-" if theirs is None else _signed(theirs),
                _cell(row.volume / LITRE, 2),
                _cell(row.median_volume / LITRE, 2),
                _signed(change(row.volume, first.volume)) if compared else "-",
                THEIR_VOLUME.get(row.name, "-"),
                _cell(100.0 * row.inside, 1),
                _cell(100.0 * row.uncertain, 1),
                _cell(row.recovery, 0),
                _cell(row.slowest, 0),
            ]
        )
    return out


def _signed(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:+.1f}"


def _cell(value: float, digits: int) -> str:
    return "-" if np.isnan(value) else f"{value:.{digits}f}"


def as_data(results: Sequence[Comparison]) -> dict[str, object]:
    """The figures as plain data; metres, m^3, shares; what is not known is NaN."""
    return {
        "section": "7.3.3",
        "thesis": {"error_change_percent": THEIR_ERROR, "volume_change_percent": THEIR_VOLUME},
        "results": [
            {
                "occlusion": result.kind,
                "cycles": result.cycles,
                "hidden_frames": result.hidden,
                "variants": [
                    {
                        "variant": row.name,
                        "mean_error_m": row.error,
                        "p95_error_m": row.p95,
                        "error_change_percent": change(row.error, result.rows[0].error),
                        "mean_volume_m3": row.volume,
                        "median_volume_m3": row.median_volume,
                        "volume_change_percent": change(row.volume, result.rows[0].volume),
                        "inside_95": row.inside,
                        "uncertain": row.uncertain,
                        "recovery_frames": row.recovery,
                        "slowest_recovery_frames": row.slowest,
                        "cycle_error_m": row.cycle_error,
                        "cycle_volume_m3": row.cycle_volume,
                    }
                    for row in result.rows
                ],
            }
            for result in results
        ],
    }
