"""A track in, the report's section on what the images alone can tell out: a heat map of sigmas, and open directions.

The map has a row for each joint and a column for each frame (for a stretch of frames where there are many: its largest
sigma). Joints that slide are judged in a typical link's length for a radian. Prediction, limits and soft couplings are
left out: a joint may be dark here and still have a small sigma above, because it was seen a moment ago.
"""

import html
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from ..ambiguity import Ambiguity, ambiguity
from ..ambiguity import named as named_fold
from ..kinematics import Model
from ..observability import UNKNOWN, Observability, observability
from ..observability_words import grouped, named, unseen_names
from ..observability_words import lines as sentences
from ..track import Track

STEPS = np.radians([0.3, 1.0, 2.0, 5.0, 15.0])  # limits between the six shades
_MOST_COLUMNS = 300
_MOST_ROWS = 14
_ROW = 10.0
_NOTE = (
    "Standard deviation of each joint from the images of one frame alone, without prediction, limits or couplings. "
    "A direction is open where that exceeds {limit} degrees: the joints can be turned together by these shares, and "
    "the images hardly change."
)


def observability_section(track: Track, model: Model) -> str:
    """The section's HTML."""
    seen, folds = observability(track, model), ambiguity(track, model)
    limit = f"{np.degrees(seen.threshold):.0f}"
    return (
        f'<section class="card"><p class="facts">{_NOTE.format(limit=limit)}</p>{heat_map(seen, model)}'
        f"{_directions(seen)}{_folds(folds)}</section>"
    )


def heat_map(seen: Observability, model: Model) -> str:
    """Joint by frame, shaded by sigma."""
    scale = np.where(seen.prismatic, seen.length, 1.0)
    shades = np.searchsorted(STEPS, _columns(seen.sigma / scale), side="right")
    n, joints = shades.shape
    rects = "".join(
        f'<path class="h{shade}" d="{"".join(_runs(shades[:, j] == shade, j))}"/>'
        for shade in range(1, STEPS.size + 1)
        for j in range(joints)
        if (shades[:, j] == shade).any()
    )
    names = "".join(f"<li>{html.escape(name)}</li>" for name in seen.joint_names)
    median = np.median(seen.sigma, axis=0)
    facts = "".join(f"<li>{_value(seen, model, j, float(median[j]))}</li>" for j in range(joints))
    first, last = int(seen.frame[0]), int(seen.frame[-1])
    return (
        f'<div class="heat"><ul>{names}</ul><div><svg viewBox="0 0 {n} {_ROW * joints:g}" preserveAspectRatio="none" '
        f'style="height:{1.35 * joints:.2f}em" role="img" aria-label="Image-only sigma of each joint over the frames">'
        f'{rects}</svg><p><span>frame {first}</span><span>{last}</span></p></div><ul title="median">{facts}</ul></div>'
        f"{_legend()}"
    )


def _columns(sigma: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "c j"]:
    """At most `_MOST_COLUMNS` rows, each the largest sigma of its stretch of frames."""
    if sigma.shape[0] <= _MOST_COLUMNS:
        return sigma
    starts = np.linspace(0, sigma.shape[0], _MOST_COLUMNS, endpoint=False).astype(int)
    return np.maximum.reduceat(sigma, starts, axis=0)


def _runs(on: np.ndarray, row: int) -> list[str]:
    """Boxes over the runs of true values."""
    edges: Int[np.ndarray, " e"] = np.flatnonzero(np.diff(on.astype(int), prepend=0, append=0))
    top, height = _ROW * row, 0.86 * _ROW
    ends = list(pairwise(edges.tolist()))[::2]
    return [f"M{a} {top:g}H{b}V{top + height:g}H{a}Z" for a, b in ends]


def _value(seen: Observability, model: Model, joint: int, sigma: float) -> str:
    if seen.prismatic[joint]:
        return f"{sigma:.2g} {html.escape(model.units)}"
    if sigma > 0.9 * UNKNOWN:
        return "unknown"
    degrees = np.degrees(sigma)
    return f"{degrees:.{2 if degrees < 9.995 else 0}f}\N{DEGREE SIGN}"


def _legend() -> str:
    limits = [f"{value:g}" for value in np.degrees(STEPS).round(1)]
    between = [f"{a} to {b}" for a, b in pairwise(limits)]
    words = [f"below {limits[0]}\N{DEGREE SIGN}", *between, f"above {limits[-1]}\N{DEGREE SIGN}"]
    keys = "".join(f'<li><i class="key h{i}"></i>{word}</li>' for i, word in enumerate(words))
    return f'<ul class="keys heat-keys">{keys}</ul>'


def _directions(seen: Observability) -> str:
    if not seen.count.size:
        return f'<p class="facts">{html.escape(sentences(seen)[0])}</p>'
    groups = grouped(seen)
    rows = "".join(
        f"<tr><td>{_joints(seen, group)}</td><td>{_along(seen, group[0])}</td>"
        f"<td>{_span(int(seen.first[group[0]]), int(seen.last[group[0]]))}</td><td>{seen.count[group[0]]}</td></tr>"
        for group in groups[:_MOST_ROWS]
    )
    more = len(groups) - _MOST_ROWS
    rest = f'<p class="facts">and {more} shorter ones; run.json has them all.</p>' if more > 0 else ""
    return (
        '<table class="views"><thead><tr><th>open direction</th><th>sigma</th><th>frames</th><th>count</th></tr>'
        f"</thead><tbody>{rows}</tbody></table>{rest}"
    )


def _joints(seen: Observability, group: tuple[int, ...]) -> str:
    weights = named(seen, seen.direction[group[0]])
    if seen.unseen[group[0]]:
        return f"<b>{html.escape(unseen_names(seen, group))}</b> not seen"
    if len(weights) == 1:
        return f"<b>{html.escape(weights[0][0])}</b> hardly seen"
    return ", ".join(f"<b>{html.escape(name)}</b> {_signed(value)}" for name, value in weights)


def _along(seen: Observability, i: int) -> str:
    lead = int(seen.free[int(np.argmax(np.abs(seen.direction[i])))])
    sigma = float(seen.direction_sigma[i])
    if sigma > 0.9 * UNKNOWN:
        return "unknown"
    if seen.prismatic[lead]:
        return f"{sigma * seen.length:.2g} {html.escape(seen.units)}"
    return f"{np.degrees(sigma):.1f}\N{DEGREE SIGN}"


def _folds(folds: Ambiguity) -> str:
    if not folds.count.size:
        return ""
    order = np.argsort(-folds.count, kind="stable")[:_MOST_ROWS]
    rows = "".join(
        f"<tr><td>{_folded(folds, i)}</td><td>{folds.weight[i]:.2f}</td>"
        f"<td>{_span(int(folds.first[i]), int(folds.last[i]))}</td><td>{folds.count[i]}</td></tr>"
        for i in order.tolist()
    )
    return (
        '<h4>Poses that looked the same, folded to the other side of the image plane</h4><table class="views"><thead>'
        "<tr>"
        "<th>other pose less the reported one</th><th>weight</th><th>frames</th><th>count</th></tr></thead>"
        f"<tbody>{rows}</tbody></table>"
    )


def _folded(folds: Ambiguity, row: int) -> str:
    joints = named_fold(folds, row)
    return ", ".join(f"<b>{html.escape(name)}</b> {_signed(value)} {html.escape(unit)}" for name, value, unit in joints)


def _signed(value: float) -> str:
    return f"{value:+g}".replace("-", "\N{MINUS SIGN}")


def _span(first: int, last: int) -> str:
    return f"{first} to {last}" if last > first else str(first)
