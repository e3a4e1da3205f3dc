"""Figures of people in; the tiles at the top of their page out."""

import html

import numpy as np

from ..formats.people import STATUSES, People
from .people_facts import PeopleFacts

_NBSP = "\N{NO-BREAK SPACE}"


def tiles_of(people: People, facts: PeopleFacts, milliseconds: float | None = None) -> list[str]:
    """All tiles in reading order: who was there, how much was seen of them, how well they were known, how fast.

    Parameters
    ----------
    milliseconds : float or None
        Mean time of a frame.
    """
    f = people.time.size
    shares = list(zip(STATUSES, facts.shares, strict=True))
    bar = "".join(f'<i style="flex:{share:.4f};background:var(--{name})"></i>' for name, share in shares if share > 0)
    words = ", ".join(f"{100.0 * share:.1f}{_NBSP}% {name}" for name, share in shares[1:])
    present = people.frame.size / f
    out = [
        _tile("Frames", f"{f}", f"over {people.time[-1] - people.time[0]:.2f}{_NBSP}s"),
        _tile("People", f"{facts.labels.size}", f"{present:.1f} in a frame, on average"),
        _tile("Keypoints seen", f"{100.0 * facts.shares[0]:.0f}{_NBSP}%", f'{words}<span class="bar">{bar}</span>'),
        _tile("Longest gap bridged", f"{facts.longest:.2f}{_NBSP}s", "a keypoint predicted, then seen again"),
    ]
    if facts.truth is not None:
        out += _truth_tiles(facts)
    if milliseconds is not None:
        out.append(_tile("Time per frame", f"{milliseconds:.2f}{_NBSP}ms", "mean, without reading and writing"))
    return out


def _truth_tiles(facts: PeopleFacts) -> list[str]:
    data, truth = facts.as_data(), facts.truth
    out = []
    if truth is None:
        return out
    if data["mean_error_mm"] is not None:
        raw = "" if data["raw_mean_error_mm"] is None else f"; raw {data['raw_mean_error_mm']:.0f}, where seen"
        out.append(_tile("Mean error", f"{data['mean_error_mm']:.0f}{_NBSP}mm", f"of all keypoints put out{raw}"))
    if np.isfinite(truth.honesty.predicted):
        share = 100.0 * truth.honesty.predicted
        note = f"of predicted keypoints; 95{_NBSP}% are promised"
        out.append(_tile("Truth in the ellipsoid", f"{share:.0f}{_NBSP}%", note))
    count = int(truth.switches.sum())
    note = "nobody got another's label" if not count else "times that a true person got another label"
    out.append(_tile("Identity switches", f"{count}", note))
    return out


def _tile(name: str, value: str, note: str) -> str:
    """One figure with its name above and a note below; `note` is HTML."""
    return f'<div class="tile"><span>{html.escape(name)}</span><b>{value}</b><small>{note}</small></div>'
