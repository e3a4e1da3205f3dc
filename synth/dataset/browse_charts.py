"""Rows of a dataset's index in, charts of its distributions as inline SVG out: occlusion, view, pose, size.

Every chart is drawn in a box 1000 wide that the page stretches; words stand beside it in HTML. The same rows give the
same bytes.
"""

import html
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..labels.labelled import HIDDEN, UNSEEN
from ..labels.solids import KEYPOINTS
from .index import Row

BARS = 40
AROUND, UP = 36, 18  # cells of the map of views; they have equal areas on the sphere
MOST_JOINTS = 60


@dataclass(frozen=True, slots=True)
class Chart:
    """One figure: what it shows, its drawing, and a line of facts."""

    title: str
    drawing: str
    facts: str


def charts(rows: Sequence[Row]) -> tuple[Chart, ...]:
    """All charts of a dataset."""
    return (
        *_occlusion(rows),
        *(_views(rows)),
        *_sizes(rows),
        *_poses(rows),
    )


def _occlusion(rows: Sequence[Row]) -> tuple[Chart, ...]:
    shares = np.array([100.0 * share for row in rows for share in row.visible_fraction if share is not None])
    hidden = np.array([float(row.keypoints_hidden) for row in rows])
    first = histogram("Visible share of each hand", shares, (0.0, 100.0), "%")
    counts = histogram("Hidden keypoints of each image", hidden, (0.0, max(hidden.max(initial=0.0), 21.0) + 1.0), "")
    marks = np.array([hand for row in rows for hand in row.visibility]).reshape(-1, len(KEYPOINTS))
    inside = (marks > UNSEEN).sum(axis=0)
    share = np.divide(100.0 * (marks == HIDDEN).sum(axis=0), inside, out=np.zeros(len(KEYPOINTS)), where=inside > 0)
    return first, counts, bars("How often each keypoint inside the image is hidden", KEYPOINTS, share, "%")


def _views(rows: Sequence[Row]) -> tuple[Chart, ...]:
    """Where the cameras stand around the hands."""
    view = np.array([v for row in rows for v in row.view if v is not None]).reshape(-1, 3)
    distance = np.array([d for row in rows for d in row.distance_mm if d is not None])
    far = histogram("Distance of the camera", distance, _range(distance), "mm")
    if not view.shape[0]:
        return (far,)
    around = np.degrees(np.arctan2(view[:, 0], view[:, 2]))
    counts, _, _ = np.histogram2d(
        np.clip(view[:, 1], -1.0, 1.0), around, bins=(UP, AROUND), range=((-1.0, 1.0), (-180.0, 180.0))
    )
    most, width, height = counts.max(), 1000.0 / AROUND, 500.0 / UP
    cells = "".join(
        f'<rect class="cell" x="{column * width:.1f}" y="{500.0 - (line + 1) * height:.1f}" width="{width:.1f}" '
        f'height="{height:.1f}" opacity="{0.12 + 0.88 * counts[line, column] / most:.2f}"/>'
        for line, column in np.argwhere(counts > 0).tolist()
    )
    drawing = (
        f'<div class="map"><svg viewBox="0 0 1000 500" preserveAspectRatio="none">{cells}</svg>'
        '<i style="left:0">palm</i><i style="left:25%">little finger</i><i style="left:50%">back</i>'
        '<i style="left:75%">thumb</i><i style="left:100%">palm</i></div>'
    )
    says = f"{view.shape[0]} hands; {100 * (counts > 0).mean():.0f} % of {UP * AROUND} equal directions are there"
    return Chart("From where each hand is seen (above: from the fingertips)", drawing, says), far


def _sizes(rows: Sequence[Row]) -> tuple[Chart, ...]:
    boxes = [box for row in rows for box in row.modal_boxes[: row.hands]]
    sides = np.array([max(x1 - x0, y1 - y0) for x0, y0, x1, y1 in boxes if x1 > x0])
    return (histogram("Longest side of the box around what is seen of each hand", sides, _range(sides), "px"),)


def _poses(rows: Sequence[Row]) -> tuple[Chart, ...]:
    """Ranges of the joint angles, all hands together."""
    values: dict[str, list[float]] = {}
    for row in rows:
        for names, angles in zip(row.joints, row.angles_deg, strict=True):
            for name, angle in zip(names, angles, strict=True):
                values.setdefault(name, []).append(angle)
    if not values:
        return ()
    levels = np.array([np.percentile(v, [0, 5, 25, 50, 75, 95, 100]) for v in values.values()])[:MOST_JOINTS]
    low, high = float(levels[:, 0].min()), float(levels[:, -1].max())
    scale = 100.0 / max(high - low, 1e-9)
    lines = []
    for name, (first, five, quarter, half, three, most, last) in zip(values, levels.tolist(), strict=False):
        spans = ((first, last, "all"), (five, most, "most"), (quarter, three, "half"))
        strips = "".join(
            f'<i class="{style}" style="left:{(a - low) * scale:.2f}%;width:{(b - a) * scale:.2f}%"></i>'
            for a, b, style in spans
        )
        title = f"{first:.0f} to {last:.0f}, median {half:.0f}"
        middle = f'<i class="middle" style="left:{(half - low) * scale:.2f}%"></i>'
        lines.append(f'<b>{html.escape(name)}</b><span class="strip" title="{title}">{strips}{middle}</span>')
    says = f"from {low:.0f} to {high:.0f} degrees; dark: the middle half, lighter: 90 %, line: all, mark: median"
    return (Chart("Joint angles", f'<div class="strips">{"".join(lines)}</div>', says),)


def histogram(title: str, values: Float[np.ndarray, " n"], limits: tuple[float, float], unit: str) -> Chart:
    """Shares of values in `BARS` equal bins; whole numbers get a bin each where there are few.

    Parameters
    ----------
    limits : (low, high)
        Of the axis.
    """
    if not values.size:
        return Chart(title, '<p class="none">no values</p>', "")
    low, high = limits
    whole = unit == "" and high - low <= 2 * BARS
    counts, _ = np.histogram(values, int(high - low) if whole else BARS, (low, high))
    width, most = 1000.0 / counts.size, counts.max()
    drawn = "".join(
        f'<rect class="bar" x="{k * width + 0.5:.1f}" y="{300 - 300 * n / most:.1f}" width="{width - 1:.1f}" '
        f'height="{300 * n / most:.1f}"/>'
        for k, n in enumerate(counts.tolist())
        if n
    )
    gap = unit and f" {unit}"
    ends = f"<i>{low:.0f}{gap}</i><i>{(low + high) / 2:.0f}{gap}</i><i>{high - whole:.0f}{gap}</i>"
    quarter, half, three = np.percentile(values, [25, 50, 75])
    says = f"{values.size} values, median {half:.3g}{gap}, middle half {quarter:.3g} to {three:.3g}{gap}"
    svg = f'<svg viewBox="0 0 1000 300" preserveAspectRatio="none">{drawn}</svg>'
    return Chart(title, f'<div class="histogram">{svg}<div class="axis">{ends}</div></div>', says)


def bars(title: str, names: Sequence[str], values: Float[np.ndarray, " n"], unit: str) -> Chart:
    """A named bar for each value, from 0 to the largest."""
    most = max(float(values.max(initial=0.0)), 1e-9)
    lines = "".join(
        f'<b>{html.escape(name.replace("_", " "))}</b><span class="row"><i style="width:{100 * v / most:.1f}%"></i>'
        f"<em>{v:.0f} {unit}</em></span>"
        for name, v in zip(names, values.tolist(), strict=True)
    )
    mean = float(values.mean()) if values.size else 0.0
    return Chart(title, f'<div class="bars">{lines}</div>', f"mean {mean:.1f} {unit}")


def _range(values: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Axis that holds all values, with some room."""
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    room = max(0.04 * (high - low), 0.5)
    return max(low - room, 0.0) if low >= 0 else low - room, high + room
