"""Figures of a wrist's track in; the tiles at the top of its page out."""

import html

import numpy as np

from ..formats.wrists import STATUSES, WristTrack
from .wrist_facts import LITRE, Facts

_NBSP = "\N{NO-BREAK SPACE}"


def tiles_of(track: WristTrack, facts: Facts) -> list[str]:
    """All tiles in reading order: how much was hidden, how well it was known there, how fast."""
    data = facts.as_data()
    f = track.time.size
    shares = [(status, float(np.mean(track.status == status))) for status in STATUSES]
    bar = "".join(
        f'<i style="flex:{share:.4f};background:var(--{status})"></i>' for status, share in shares if share > 0
    )
    words = ", ".join(f"{round(share * f)} {status}" for status, share in shares if share > 0)
    out = [
        _tile("Frames", f"{f}", f"over {track.time[-1] - track.time[0]:.2f}{_NBSP}s"),
        _tile("Wrist hidden", f"{100.0 * facts.hidden.mean():.0f}{_NBSP}%", f'{words}<span class="bar">{bar}</span>'),
    ]
    error = data.get("mean_error_hidden_mm")
    if error is not None:
        held = f"holding the last position {data['mean_error_last_position_mm']:.0f}"
        held = f"95{_NBSP}% below {data['p95_error_hidden_mm']:.0f}; {held}"
        out.append(_tile("Error while hidden", f"{error:.0f}{_NBSP}mm", held))
        inside = 100.0 * float(data["hidden_inside_95"])  # type: ignore[arg-type]
        out.append(_tile("Truth in the ellipsoid", f"{inside:.0f}{_NBSP}%", "of the hidden frames; 95 % are promised"))
    if facts.hidden.any():
        litres = track.volume[facts.hidden] / LITRE
        note = f"mean {litres.mean():.3g}{_NBSP}l, while hidden"
        out.append(_tile("Volume, median", f"{np.median(litres):.2g}{_NBSP}l", note))
    if data.get("least_distance_to_robot_m") is not None:
        note = f"95{_NBSP}% of the particles beyond {data['least_5_percent_distance_to_robot_m']:.2f}{_NBSP}m"
        out.append(_tile("Nearest to the robot", f"{data['least_distance_to_robot_m']:.2f}{_NBSP}m", note))
    usual = 1e3 * track.seconds[np.isfinite(track.seconds)]
    if usual.size:
        note = f"95{_NBSP}% below {np.quantile(usual, 0.95):.1f}{_NBSP}ms"
        out.append(_tile("Time per frame", f"{np.median(usual):.1f}{_NBSP}ms", note))
    return out


def _tile(name: str, value: str, note: str) -> str:
    """One figure with its name above and a note below; `note` is HTML."""
    return f'<div class="tile"><span>{html.escape(name)}</span><b>{value}</b><small>{note}</small></div>'
