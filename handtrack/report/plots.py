"""Series in, one chart as inline HTML and SVG out.

A chart is an SVG in a fixed 1000 x 1000 box that the page stretches to any size (lines keep their width), with HTML
for everything that must not be stretched: tick labels and names. It needs no script to be read; `page.js` adds the
cursor and the values under the pointer. Numbers are written with a fixed number of digits, so the same series give the
same bytes.
"""

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int, Shaped

_BOX = 1000.0  # side of the SVG's coordinate system
_MOST_POINTS = 1600  # in one path; more than a screen has pixels across


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One curve: name, CSS class (which sets its colour), values and, optionally, sigmas, true values and rivals."""

    name: str
    style: str
    values: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"] | None = None
    truth: Float[np.ndarray, " n"] | None = None
    rival: Float[np.ndarray, " n"] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What all charts of a page share: the time axis in seconds, and where the status is not `tracked`."""

    time: Float[np.ndarray, " n"]
    status: Shaped[np.ndarray, " n"]


def chart(
    name: str,
    frame: Frame,
    series: Sequence[Series],
    limits: tuple[float, float],
    unit: str,
    *,
    kind: str = "",
    ticks: int = 4,
    marks: Float[np.ndarray, " k"] | None = None,
    filled: bool = False,
    labels: bool = False,
    time_axis: bool = True,
) -> str:
    """One chart as HTML.

    Parameters
    ----------
    name : str
        Identifier of the chart on the page, also the key of its values for the script.
    limits : (float, float)
        Lowest and highest value shown; what lies outside is cut off.
    unit : str
        Follows the tick values.
    kind : str
        Extra CSS class, which sets the height.
    ticks : int
        About how many horizontal lines.
    marks : (k,), optional
        Where to draw the horizontal lines instead; zero is then drawn but not numbered.
    filled : bool
        Fill the area under the curves instead of drawing sigmas.
    labels : bool
        Write the names of the series at their last values.
    time_axis : bool
        Write the seconds below.
    """
    x = positions(frame.time, *time_range(frame.time))
    with_zero = marks is None  # marks given from outside are symmetric: their zero needs no number
    marks = tick_values(*limits, ticks) if marks is None else marks
    return "".join(
        [
            f'<div class="chart {kind}" data-chart="{html.escape(name)}">',
            '<svg viewBox="0 0 1000 1000" preserveAspectRatio="none" aria-hidden="true">',
            *_backdrop(frame, marks, limits),
            *(_area(item, x, limits, filled) for item in series if filled or item.sigma is not None),
            *(path for item in series for path in ([] if filled else _lines(item, x, limits))),
            "</svg>",
            *_value_labels(marks, limits, unit, with_zero),
            *(_time_labels(frame) if time_axis else []),
            *(_end_labels(series, limits) if labels else []),
            "</div>",
        ]
    )


def _backdrop(frame: Frame, marks: Float[np.ndarray, " k"], limits: tuple[float, float]) -> list[str]:
    """Stretches that are not tracked, and horizontal lines."""
    spans = [
        f'<rect class="{status}" x="{left:.1f}" y="0" width="{right - left:.1f}" height="1000"/>'
        for status, left, right in status_spans(frame)
    ]
    heights = _BOX - positions(marks, *limits)
    return spans + [
        f'<path class="{"grid" if mark else "zero"}" d="M0 {y:.1f}H1000"/>'
        for mark, y in zip(marks, heights, strict=True)
    ]


def _value_labels(marks: Float[np.ndarray, " k"], limits: tuple[float, float], unit: str, with_zero: bool) -> list[str]:
    digits = _digits(marks)
    return [
        f'<span class="y" style="top:{y / 10:.2f}%">{_minus(mark, digits)}{html.escape(unit)}</span>'
        for mark, y in zip(marks, _BOX - positions(marks, *limits), strict=True)
        if with_zero or mark != 0
    ]


def _time_labels(frame: Frame) -> list[str]:
    limits = time_range(frame.time)
    times = tick_values(*limits, 6)
    digits = _digits(times)
    return [
        f'<span class="x" style="left:{left / 10:.2f}%">{_minus(second, digits)} s</span>'
        for second, left in zip(times, positions(times, *limits), strict=True)
    ]


def _area(item: Series, x: Float[np.ndarray, " n"], limits: tuple[float, float], filled: bool) -> str:
    """The area under a curve, or its band of two sigmas; drawn before all lines."""
    if filled or item.sigma is None:
        floor, y = np.full(x.size, _BOX), _BOX - positions(item.values, *limits)
        return f'<path class="area {item.style}" d="{band_path(x, floor, y)}"/>'
    low, high = (_BOX - positions(item.values + k * item.sigma, *limits) for k in (-2.0, 2.0))
    return f'<path class="band {item.style}" d="{band_path(x, low, high)}"/>'


def _lines(item: Series, x: Float[np.ndarray, " n"], limits: tuple[float, float]) -> list[str]:
    parts = [f'<path class="line {item.style}" d="{line_path(x, _BOX - positions(item.values, *limits))}"/>']
    if item.truth is not None:
        true = line_path(x, _BOX - positions(item.truth, *limits))
        parts.append(f'<path class="truth {item.style}" d="{true}"/>')
    if item.rival is not None and np.isfinite(item.rival).any():
        other = line_path(x, _BOX - positions(item.rival, *limits))
        parts.append(f'<path class="rival {item.style}" d="{other}"/>')
    return parts


def _end_labels(series: Sequence[Series], limits: tuple[float, float]) -> list[str]:
    """Names beside the last values, moved apart where they would overlap."""
    last = np.array([item.values[-1] for item in series])
    top = np.clip((_BOX - positions(last, *limits)) / 10, 3, 97)
    gap = 9.0  # per cent of the height
    order = np.argsort(top, kind="stable")
    for i, j in pairwise(order):
        top[j] = max(top[j], top[i] + gap)
    top -= max(0.0, float(top.max()) - 97)
    return [
        f'<span class="name {item.style}" style="top:{y:.2f}%">{html.escape(item.name)}</span>'
        for item, y in zip(series, top, strict=True)
    ]


def time_range(time: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """First and last time, a second apart if there is only one."""
    first, last = float(time[0]), float(time[-1])
    return (first, last) if last > first else (first, first + 1.0)


def positions(values: Float[np.ndarray, " n"], low: float, high: float) -> Float[np.ndarray, " n"]:
    """Values on a scale from `low` at 0 to `high` at 1000, kept within reach of what SVG draws well."""
    return np.clip((values - low) / (high - low), -9.0, 9.0) * _BOX


def line_path(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> str:
    """SVG path through the points, interrupted where y is NaN.

    >>> line_path(np.array([0.0, 1.0, 2.0, 3.0]), np.array([5.0, np.nan, 6.0, 7.0]))
    'M0 5M2 6L3 7'
    """
    parts = []
    pen_down = False
    keep = thin(y)
    for point, finite in zip(_points(x[keep], y[keep]), np.isfinite(y[keep]), strict=True):
        if finite:
            parts.append(("L" if pen_down else "M") + point)
        pen_down = bool(finite)
    return "".join(parts)


def band_path(x: Float[np.ndarray, " n"], low: Float[np.ndarray, " n"], high: Float[np.ndarray, " n"]) -> str:
    """Closed SVG path between two curves; points where one is NaN are left out."""
    keep = thin(high - low)
    keep = keep[np.isfinite(low[keep]) & np.isfinite(high[keep])]
    if not keep.size:
        return ""
    there, back = _points(x[keep], high[keep]), _points(x[keep[::-1]], low[keep[::-1]])
    return f"M{'L'.join(there + back)}Z"


def thin(values: Float[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
    """Rows to draw of a long series: the extremes of each stretch, so that no peak is lost."""
    if values.size <= _MOST_POINTS:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, _MOST_POINTS // 2 + 1).astype(int)
    filled = np.nan_to_num(values)
    keep = {0, values.size - 1} | set(np.flatnonzero(~np.isfinite(values))[: _MOST_POINTS // 4].tolist())
    for start, stop in pairwise(edges.tolist()):
        keep.update((start + int(np.argmin(filled[start:stop])), start + int(np.argmax(filled[start:stop]))))
    return np.array(sorted(keep))


def status_spans(frame: Frame) -> list[tuple[str, float, float]]:
    """Stretches of time that are not `tracked`: status, left and right edge on the scale of the chart."""
    if frame.time.size == 1:
        return [] if frame.status[0] == "tracked" else [(str(frame.status[0]), 0.0, _BOX)]
    x = positions(frame.time, *time_range(frame.time))
    middle = (x[1:] + x[:-1]) / 2
    left, right = np.concatenate([[0.0], middle]), np.concatenate([middle, [_BOX]])
    change = np.flatnonzero(frame.status[1:] != frame.status[:-1]) + 1
    starts, stops = np.concatenate([[0], change]), np.concatenate([change, [frame.time.size]])
    return [
        (str(frame.status[i]), float(left[i]), float(right[j - 1]))
        for i, j in zip(starts, stops, strict=True)
        if frame.status[i] != "tracked"
    ]


def tick_values(low: float, high: float, count: int) -> Float[np.ndarray, " k"]:
    """About `count` round values (1, 2 or 5 times a power of ten apart) between two limits.

    >>> tick_values(-3.0, 11.0, 4).tolist()
    [0.0, 5.0, 10.0]
    """
    raw = (high - low) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= raw * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return np.arange(first, last + 1) * step


def mirrored_ticks(reach: float) -> Float[np.ndarray, " 3"]:
    """Zero and the largest round value to both sides of it that is inside `reach`.

    >>> mirrored_ticks(0.37).tolist()
    [-0.2, 0.0, 0.2]
    """
    power = 10.0 ** math.floor(math.log10(0.95 * reach))
    step = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= 0.95 * reach)
    return np.array([-step, 0.0, step])


def padded_limits(*values: np.ndarray, least: float, zero: bool = False) -> tuple[float, float]:
    """Limits that hold all finite values with 6 % to spare, at least `least` apart; from 0 if `zero`."""
    finite = np.concatenate([array[np.isfinite(array)] for array in values])
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    if zero:
        return 0.0, max(high * 1.06, least)
    spare = max(0.06 * (high - low), (least - (high - low)) / 2)
    return low - spare, high + spare


def _points(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> list[str]:
    return [f"{_short(a)} {_short(b)}" for a, b in zip(x.tolist(), y.tolist(), strict=True)]


def _short(value: float) -> str:
    text = f"{value:.1f}"
    return text[:-2] if text.endswith(".0") else text


def _digits(values: Float[np.ndarray, " k"]) -> int:
    """Decimals needed to tell neighbouring ticks apart."""
    if values.size < 2:
        return 1
    return max(0, -math.floor(math.log10(float(values[1] - values[0])) + 1e-9))


def _minus(value: float, digits: int) -> str:
    """A number with a typographic minus sign and no negative zero."""
    return f"{value + 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}")
