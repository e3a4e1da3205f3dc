"""Figures of a walk in; the tiles at the top of its page out."""

import html

from ..formats.walk_tracks import STATUSES, WalkTrack
from .walk_facts import WalkFacts

_NBSP = "\N{NO-BREAK SPACE}"


def walk_tiles(track: WalkTrack, facts: WalkFacts, milliseconds: float | None = None) -> list[str]:
    """All tiles in reading order: how long, how much was seen, how well the person was known, how fast.

    Parameters
    ----------
    milliseconds : float or None
        Median time of a frame.
    """
    seconds = float(track.time[-1] - track.time[0])
    bar = "".join(
        f'<i style="flex:{share:.4f};background:var(--{name})"></i>'
        for name, share in zip(STATUSES, facts.shares, strict=True)
        if share > 0
    )
    doubt = 100.0 * sum(facts.shares[2:])
    words = f"{doubt:.1f}{_NBSP}% uncertain or lost" if doubt else "never uncertain or lost"
    out = [
        _tile("Frames", f"{track.frame.size}", f"over {seconds:.1f}{_NBSP}s"),
        _tile("In view", f"{100.0 * facts.in_view:.0f}{_NBSP}%", f'{words}<span class="bar">{bar}</span>'),
        _tile("Longest out of view", f"{facts.longest:.1f}{_NBSP}s", "the camera saw nobody"),
    ]
    out += _truth_tiles(facts)
    if milliseconds is not None:
        out.append(_tile("Time per frame", f"{milliseconds:.2f}{_NBSP}ms", "median, without reading and writing"))
    return out


def _truth_tiles(facts: WalkFacts) -> list[str]:
    data = facts.as_data()
    if data.get("mean_error_mm") is None:
        return []
    raw = data.get("raw_mean_error_mm")
    beside = "of the pelvis" if raw is None else f"of the pelvis; suit alone {raw:.0f}"
    out = [_tile("Mean error", f"{data['mean_error_mm']:.0f}{_NBSP}mm", beside)]
    if data["out_of_view_error_mm"] is not None:
        out.append(_tile("Out of view", f"{data['out_of_view_error_mm']:.0f}{_NBSP}mm", "mean error of the pelvis"))
    out.append(_tile("Heading", f"{data['heading_error_deg']:.1f}\N{DEGREE SIGN}", "mean error"))
    if data["place_in_two_sigma"] is not None:
        note = "of the places, along each axis; 95 are promised"
        out.append(_tile("Two sigma hold", f"{100.0 * facts.held:.0f}{_NBSP}%", note))
    return out


def _tile(name: str, value: str, note: str) -> str:
    """One figure with its name above and a note below; `note` is HTML."""
    return f'<div class="tile"><span>{html.escape(name)}</span><b>{value}</b><small>{note}</small></div>'
