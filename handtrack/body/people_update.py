"""Tracks and their skeletons of a frame in; tracks with everything that the frame taught them out."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from .identities import undone_swaps
from .people_settings import Settings
from .people_tracks import BONE, Tracks
from .people_whole import SURE, begun_anew, drifts, heights, lengths
from .permanence import Stories, paper_step, robust_step, seen_now
from .resting import axes, learnt, offsets
from .skeleton_graph import FILTERED
from .skin import doubt
from .spatial import Spatial


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Tracks (a,), their skeletons (a,), and where all keypoints are expected (q, 12, 3), metres."""

    who: Int[np.ndarray, " a"]
    which: Int[np.ndarray, " a"]
    expected: Float[np.ndarray, "q 12 3"]


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
    whole = (raw[pairs.which, :FILTERED] > 0).sum(axis=1)
    found_height, told = heights(tracks, pairs.who, seen.height[pairs.which], whole)
    if isinstance(tracks.clouds, Stories):
        length = np.where(np.isnan(tracks.length), found_height[:, None] * BONE, tracks.length)
        rest = offsets(tracks.rest, axes(tracks.p), np.nan_to_num(length))
        clouds, estimate = robust_step(tracks.clouds, z, confidence, moment.dt, tracks.drift, length, rest)
        estimate = replace(estimate, covariance=estimate.covariance + doubt(estimate.p, settings.skin))
    else:
        clouds, estimate = paper_step(tracks.clouds, z, judged, moment.time, moment.dt, tracks.hidden, settings, rng)
    here = seen_now(estimate)
    known = np.isfinite(estimate.p[..., 0]) & np.isinf(tracks.hidden)
    hidden = np.where(here, 0.0, np.where(known, 0.0, tracks.hidden) + moment.dt)
    there = np.zeros(q, dtype=bool)
    there[pairs.who] = True
    count = np.maximum((confidence > 0).sum(axis=1), 1)
    new = replace(
        tracks,
        hits=tracks.hits + there,
        sure=tracks.sure + np.where(there, confidence.sum(axis=1) / count, 0.0),
        unseen=np.where(there, 0.0, tracks.unseen + moment.dt),
        height=found_height,
        told=told,
        p=estimate.p,
        covariance=estimate.covariance,
        confidence=np.where(here, 0.8 * tracks.confidence + 0.2 * confidence, tracks.confidence),
        hidden=hidden,
        used=np.where(here, confidence, 0.0),
        clouds=clouds,
    )
    if not isinstance(clouds, Stories):
        return new
    long, times = lengths(tracks, z, here & (confidence > SURE), found_height)
    rest, rested = learnt(tracks.rest, tracks.rested, new.p, axes(new.p), here & (confidence > SURE))
    drift, paced = drifts(tracks, z, moment.dt)
    clouds, doubted = begun_anew(tracks, clouds, confidence, here, moment.dt)
    return replace(
        new, drift=drift, paced=paced, was=z, length=long, measured=times, rest=rest, rested=rested, clouds=clouds,
        doubted=doubted,
    )  # fmt: skip


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
