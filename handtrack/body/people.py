"""Skeletons of a frame in, in any order, with holes and strangers among them; steady people with labels out.

For every frame: `spatial.evaluate` judges skeletons, `identities` says who is who, `permanence` follows every keypoint.
The same skeletons, settings and random numbers give the same people.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..formats.people import People
from ..formats.skeletons import Detections
from .identities import BEYOND, assigned, costs, gates, newcomers
from .people_life import PeopleState as PeopleState
from .people_life import living
from .people_output import PeopleFrame as PeopleFrame
from .people_output import frame_of, gathered
from .people_settings import Settings as Settings
from .people_tracks import Tracks, joined, nobody, nobody_remembered
from .people_update import Moment, Pairs, filtered
from .skeleton_graph import FILTERED
from .skin import below_skin
from .spatial import Spatial, clean, evaluate

FEWEST = 4  # keypoints of somebody new


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

    >>> state, rng = begin(Settings(confirm=1, skin=0.0)), np.random.default_rng(1)
    >>> half = np.array([[0.2, 0, 2], [0.2, 0.32, 2], [0.2, 0.57, 2], [0.1, 0.5, 2]])  # shoulder, elbow, wrist, hip
    >>> p = np.full((1, 16, 3), np.nan)
    >>> p[0, 0:8:2], p[0, 1:8:2] = half, half * (-1, 1, 1)
    >>> state, frame = step(state, 0.0, p, np.full((1, 16), 0.6), rng)
    >>> frame.person.tolist(), frame.p[0, 0].round(1).tolist()
    ([0], [0.2, 0.0, 2.0])
    """
    dt = _checked(state, time, p, confidence)
    settings = state.settings
    p, raw = clean(p, confidence)
    if settings.mode == "robust":
        p = below_skin(p, settings.skin)
    seen = evaluate(p, confidence, settings)
    tracks, pairs = _paired(state.tracks, seen, raw, dt, settings)
    tracks = filtered(tracks, pairs, seen, raw, Moment(time, dt), settings, rng)
    state = living(replace(state, tracks=tracks, time=float(time)), dt)
    return state, frame_of(state.tracks, settings)


def follow(detections: Detections, settings: Settings, seed: int = 1) -> People:
    """Follow everybody through a recording.

    Between leaving and coming back a person has entries that are lost, so that no gap is without status.

    Parameters
    ----------
    seed : int
        Decides every random choice.
    """
    state, rng = begin(settings), np.random.default_rng(seed)
    rows = np.searchsorted(detections.frame, np.arange(detections.time.size + 1))
    frames = []
    for n, time in enumerate(detections.time.tolist()):
        here = slice(rows[n], rows[n + 1])
        state, frame = step(state, time, detections.p[here], detections.confidence[here], rng)
        frames.append(frame)
    return gathered(detections.time, frames, detections.warnings)


def _paired(
    tracks: Tracks, seen: Spatial, raw: Float[np.ndarray, "m 16"], dt: float, settings: Settings
) -> tuple[Tracks, Pairs]:
    """Tracks with those who are new, who is which skeleton, and where everybody's keypoints are expected."""
    expected = tracks.p + (tracks.drift * dt)[:, None]
    gate = gates(tracks.unseen, settings)
    found = costs(expected, tracks.confidence, seen.p[:, :FILTERED], raw[:, :FILTERED], settings, BEYOND * gate)
    found = replace(found, distance=np.where(seen.kept, found.distance, np.inf))
    who, which, _ = assigned(found, gate)
    near = found.distance[who, which] <= settings.gate
    enough = seen.kept & ((raw[:, :FILTERED] > 0).sum(axis=1) >= FEWEST)
    new = newcomers(found, which, tracks.label >= 0, enough)
    if not new.size:
        return tracks, Pairs(who, which, near, expected)
    who = np.concatenate([who, np.arange(new.size) + tracks.label.size])
    expected = np.concatenate([expected, np.full((new.size, FILTERED, 3), np.nan)])
    near = np.concatenate([near, np.ones(new.size, dtype=bool)])
    return joined(tracks, nobody(new.size, settings)), Pairs(who, np.concatenate([which, new]), near, expected)


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
