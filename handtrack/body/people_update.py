"""Tracks and their skeletons of a frame in; tracks with everything that the frame taught them out."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from .identities import undone_swaps
from .people_settings import Settings
from .people_tracks import BONE, Tracks
from .people_whole import SURE, begun_anew, doubts, drifts, heights, lengths
from .permanence import Estimate, Stories, paper_step, robust_step, seen_now
from .resting import axes, learnt, offsets
from .skeleton_graph import FILTERED
from .skin import doubt
from .spatial import Spatial

JUDGED, USUAL = 0.35, 0.05  # share of rewards that counts in mode `robust`, and the usual reward


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Tracks (a,), their skeletons (a,), which are near (a,), and where all keypoints are expected (q, 12, 3), metres.

    One who was unseen for a while can be found farther away than the gate of one who is seen. He counts as unseen until
    his track has come there, for his gate has to stay open.
    """

    who: Int[np.ndarray, " a"]
    which: Int[np.ndarray, " a"]
    near: Bool[np.ndarray, " a"]
    expected: Float[np.ndarray, "q 12 3"]


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Measurements of all tracks: places (q, 12, 3), NaN where none; confidences (q, 12) without and with rewards."""

    z: Float[np.ndarray, "q 12 3"]
    confidence: Float[np.ndarray, "q 12"]
    judged: Float[np.ndarray, "q 12"]


@dataclass(frozen=True, slots=True)
class Moment:
    """Time of a frame, and since the last one, seconds."""

    time: float
    dt: float


def filtered(
    tracks: Tracks,
    pairs: Pairs,
    seen: Spatial,
    raw: Float[np.ndarray, "m 16"],
    moment: Moment,
    settings: Settings,
    rng: np.random.Generator,
) -> Tracks:
    """Tracks after a frame.

    Parameters
    ----------
    raw : (m, 16)
        Confidences of the skeletons without rewards.
    """
    q = tracks.label.size
    if q == 0:
        return tracks
    z, confidence, judged = measured(pairs, seen, raw, q)
    count = (raw[pairs.which, :FILTERED] > 0).sum(axis=1)
    height, told = heights(tracks, pairs.who, seen.height[pairs.which], count)
    tracks = replace(tracks, height=height, told=told)
    if isinstance(tracks.clouds, Stories):
        return _by_stories(tracks, tracks.clouds, pairs, Measured(z, confidence, judged), moment.dt, settings)
    clouds, estimate = paper_step(tracks.clouds, z, judged, moment.time, moment.dt, tracks.hidden, settings, rng)
    return _estimated(replace(tracks, clouds=clouds), estimate, pairs, confidence, moment.dt)


def _by_stories(
    tracks: Tracks,
    stories: Stories,
    pairs: Pairs,
    found: Measured,
    dt: float,
    settings: Settings,
) -> Tracks:
    """Mode `robust`: keypoints by their stories, and what they tell of the whole person."""
    z, confidence = found.z, found.confidence
    trusted = confidence + JUDGED * (found.judged - confidence - USUAL)
    length = np.where(np.isnan(tracks.length), tracks.height[:, None] * BONE, tracks.length)
    turn = axes(tracks.p)
    rest = offsets(tracks.rest, turn, np.where(np.isnan(length), 0.0, length))
    stories = begun_anew(tracks, stories, confidence)
    stories, estimate = robust_step(stories, z, trusted, dt, tracks.drift, length, rest)
    estimate = replace(estimate, covariance=estimate.covariance + doubt(estimate.p, settings.skin))
    here = seen_now(estimate)
    sure = here & (confidence > SURE)
    long, times = lengths(tracks, z, sure, tracks.height)
    rest, rested = learnt(tracks.rest, tracks.rested, estimate.p, turn, sure)
    drift, paced = drifts(tracks, z, dt)
    doubted = doubts(tracks, confidence, here, dt)
    new = replace(
        tracks, drift=drift, paced=paced, was=z, length=long, measured=times, rest=rest, rested=rested, clouds=stories,
        doubted=doubted,
    )  # fmt: skip
    return _estimated(new, estimate, pairs, confidence, dt)


def _estimated(
    tracks: Tracks, estimate: Estimate, pairs: Pairs, confidence: Float[np.ndarray, "q 12"], dt: float
) -> Tracks:
    """Tracks with this frame's estimate, and for how long everything was hidden."""
    here = seen_now(estimate)
    known = np.isfinite(estimate.p[..., 0])
    hidden = np.where(known & np.isinf(tracks.hidden), 0.0, tracks.hidden) + dt
    there, near = np.zeros((2, tracks.label.size), dtype=bool)
    there[pairs.who], near[pairs.who] = True, pairs.near
    count = np.maximum((confidence > 0).sum(axis=1), 1)
    return replace(
        tracks,
        hits=tracks.hits + there,
        sure=tracks.sure + np.where(there, confidence.sum(axis=1) / count, 0.0),
        unseen=np.where(near, 0.0, tracks.unseen + dt),
        p=estimate.p,
        covariance=estimate.covariance,
        confidence=np.where(here, 0.8 * tracks.confidence + 0.2 * confidence, tracks.confidence),
        hidden=np.where(here, 0.0, np.where(known, hidden, np.inf)),
        used=np.where(here, confidence, 0.0),
    )


def measured(
    pairs: Pairs, seen: Spatial, raw: Float[np.ndarray, "m 16"], q: int
) -> tuple[Float[np.ndarray, "q 12 3"], Float[np.ndarray, "q 12"], Float[np.ndarray, "q 12"]]:
    """Measurements of all tracks, sides put right: places (NaN where none), confidences without and with rewards."""
    z, confidence, judged = np.full((q, FILTERED, 3), np.nan), np.zeros((q, FILTERED)), np.zeros((q, FILTERED))
    p = seen.p[pairs.which, :FILTERED]
    both = np.stack([raw[pairs.which, :FILTERED], seen.confidence[pairs.which, :FILTERED]], axis=-1)
    p, both = undone_swaps(pairs.expected[pairs.who], p, both)
    z[pairs.who] = p
    here = ~np.isnan(p[..., 0])
    confidence[pairs.who], judged[pairs.who] = np.where(here, both[..., 0], 0.0), np.where(here, both[..., 1], 0.0)
    return z, confidence, judged
