"""A track in, the report's section on the width of each link out: a small chart for each, measured and filtered."""

import html

import numpy as np

from ..formats.widths import filtered_of
from ..track import Track
from .figures import Figure, Joints, small_number
from .plots import Frame, Series, chart

_NOTE = (
    "Distance between the two edges of a link across its axis, in its middle: measured in each frame, and (dark) "
    "filtered over the frames with its band of two sigmas. Where it clearly differs from the model, the model's radius "
    "is wrong."
)
_NBSP = "\N{NO-BREAK SPACE}"


def width_section(track: Track, joints: Joints, frame: Frame) -> tuple[str, list[Figure]]:
    """The section's HTML with its heading, and its charts; nothing for a track that does not say."""
    filtered = filtered_of(track)
    if track.width is None or track.width_sigma is None or filtered is None:
        return "", []
    measured = np.where(np.isfinite(track.width_sigma), track.width, np.nan)
    kept = np.where(np.isfinite(filtered.sigma), filtered.width, np.nan)
    spread = np.where(np.isfinite(filtered.sigma), filtered.sigma, np.nan)
    unit, model = f"{_NBSP}{joints.model.units}", joints.model.link_radius.sum(axis=1)
    rows, figures = [], []
    for number, finger in enumerate(joints.fingers):
        for place, link in enumerate(finger.links):
            name = f"w{link}"
            series = (
                Series("measured", f"f{number % 8}", measured[:, link]),
                Series("filtered", "neutral", kept[:, link], spread[:, link]),
            )
            limits = _limits(measured[:, link], spread[:, link], float(model[link]))
            last = len(figures) == joints.model.link_frame.size - 1
            markup = chart(name, frame, series, limits, unit, kind="low", ticks=2, time_axis=last)
            figures.append(Figure(name, markup, f" {joints.model.units}", series))
            label = f"<b>{html.escape(finger.name)} {place + 1}</b>"
            facts = _facts(float(kept[-1, link]), float(spread[-1, link]), float(model[link]), unit)
            rows.append(f'<div class="row">{markup}<span class="facts">{label} {facts}</span></div>')
    body = f'<p class="facts">{_NOTE}</p><div class="rows">{"".join(rows)}</div>'
    return f'<h2>Width of each link</h2><section class="card">{body}</section>', figures


def _limits(measured: np.ndarray, spread: np.ndarray, model: float) -> tuple[float, float]:
    """The usual values: single wide misses must not flatten the rest."""
    seen = measured[np.isfinite(measured)]
    if not seen.size:
        return 0.98 * model, 1.02 * model
    low, high = np.percentile(seen, [2.0, 98.0])
    reach = max(0.01 * model, 2.5 * float(np.nanmedian(spread)))
    return float(min(low, np.median(seen) - reach)), float(max(high, np.median(seen) + reach))


def _facts(width: float, sigma: float, model: float, unit: str) -> str:
    if not np.isfinite(width):
        return f"not measured<br>model {model:.2f}{unit}"
    return f"{width:.2f} \N{PLUS-MINUS SIGN}{_NBSP}{small_number(sigma)}{unit}<br>model {model:.2f}{unit}"
