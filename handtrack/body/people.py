"""Skeletons of a frame in, in any order, with holes and strangers among them; steady people with labels out.

For every frame: `spatial.evaluate` judges skeletons, `identities` says who is who, `permanence` follows every keypoint.
The same skeletons, settings and random numbers give the same people.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from ..formats.people import LOST, PREDICTED, SEEN, People
from ..formats.skeletons import Detections
from .identities import Costs, assigned, costs, gates, newcomers, returned, undone_swaps
from .people_output import PeopleFrame, frame_of, gathered
from .people_settings import Settings as Settings
from .people_tracks import BONE, TENTATIVE, Remembered, Tracks, chosen, joined, nobody, nobody_remembered, places
from .permanence import PARENT, Particles, Stories, paper_step, robust_step, seen_now
from .skeleton_graph import FILTERED
from .spatial import Spatial, clean, evaluate

LIKELY, UNLIKELY = 0.42, 6  # mean confidence at which one is confirmed at once; otherwise it takes so many times longer
FEWEST = 4  # keypoints of somebody new
PATIENCE = 0.15  # seconds for which one who is not confirmed may be unseen
AWAY = 0.3  # seconds unseen after which a known person may be found again elsewhere
_EVERY = np.full(FILTERED, True)


@dataclass(frozen=True, slots=True, eq=False)
class PeopleState:
    """What is known after a frame: who is followed, who is remembered, the next label, the time."""

    settings: Settings
    tracks: Tracks
    remembered: Remembered
    next_label: int
    time: float


def begin(settings: Settings) -> PeopleState:
    """Nobody is known yet.

    >>> begin(Settings()).tracks.label.size
    0
    """
    return PeopleState(settings, nobody(0, settings), nobody_remembered(), 0, np.nan)


def step(
    state: PeopleState,
    time: float,
    p: Float[np.ndarray, "m 16 3"],
    confidence: Float[np.ndarray, "m 16"],
    rng: np.random.Generator,
) -> tuple[PeopleState, PeopleFrame]:
    """One frame.

    Parameters
    ----------
    time : float
        Seconds, after that of the frame before.
    p : (m, 16, 3)
        Metres, camera axes, in the order of `KEYPOINTS`; NaN where unseen. Only the first 12 are filtered.
    confidence : (m, 16)
        0..1; a keypoint of confidence 0 is not seen.
    rng : Generator
        Moves the particles of mode `paper`.

    Raises
    ------
    ValueError
        If the time does not rise or is not finite, or the arrays do not fit each other.

    >>> state, rng = begin(Settings(confirm=1)), np.random.default_rng(1)
    >>> p = np.full((1, 16, 3), np.nan)
    >>> p[0, [0, 1, 2, 3]] = [[0.2, 0, 2], [-0.2, 0, 2], [0.2, 0.32, 2], [-0.2, 0.32, 2]]
    >>> state, frame = step(state, 0.0, p, np.full((1, 16), 0.6), rng)
    >>> frame.person.tolist(), frame.p[0, 2].round(2).tolist()
    ([0], [0.2, 0.32, 2.0])
    """
    dt = _checked(state, time, p, confidence)
    settings = state.settings
    raw = clean(p, confidence)[1]
    seen = evaluate(p, confidence, settings)
    tracks = state.tracks
    expected = tracks.p + (tracks.drift * dt)[:, None]
    found = costs(expected, tracks.confidence, seen.p[:, :FILTERED], raw[:, :FILTERED], settings)
    found = Costs(found.distance, found.confidence, np.where(seen.kept, found.total, np.inf))
    found = replace(found, distance=np.where(seen.kept, found.distance, np.inf))
    who, which, _ = _known_first(found, tracks, gates(tracks.unseen, settings))
    enough = seen.kept & ((raw[:, :FILTERED] > 0).sum(axis=1) >= FEWEST)
    new = newcomers(found, which, tracks.label >= 0, enough)
    if new.size:
        who = np.concatenate([who, np.arange(new.size) + tracks.label.size])
        which = np.concatenate([which, new])
        tracks = joined(tracks, nobody(new.size, settings))
        expected = np.concatenate([expected, np.full((new.size, FILTERED, 3), np.nan)])
    tracks, used = _filtered(tracks, seen, (who, which), expected, time, dt, settings, rng)
    state = _living(replace(state, tracks=tracks, time=time), dt)
    tracks = state.tracks
    return state, frame_of(tracks, used[: tracks.label.size] if used.shape[0] == tracks.label.size else used, settings)


def _checked(state: PeopleState, time: float, p: Float[np.ndarray, "m 16 3"], confidence: np.ndarray) -> float:
    """Seconds since the last frame."""
    if p.shape[1:] != (16, 3) or confidence.shape != p.shape[:2]:
        raise ValueError(f"p, confidence: got shapes {p.shape}, {confidence.shape}; wanted (m, 16, 3) and (m, 16)")
    if not np.isfinite(time):
        raise ValueError(f"time: got {time}, wanted a finite number of seconds")
    if np.isnan(state.time):
        return 1.0 / 30.0
    if not time > state.time:
        raise ValueError(f"time: got {time}, wanted more than {state.time}, that of the frame before")
    return time - state.time
