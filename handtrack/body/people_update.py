"""Tracks and their skeletons of a frame in; tracks with everything that the frame taught them out."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from .identities import undone_swaps
from .people_settings import Settings
from .people_tracks import BONE, Tracks
from .permanence import Stories, paper_step, robust_step, seen_now
from .resting import PARENT, axes, learnt, offsets
from .skeleton_graph import FILTERED
from .skin import doubt
from .spatial import Spatial

DRIFT_TIME = 0.25  # seconds over which the whole person's speed is averaged
QUICKEST = 4.0  # m/s along each axis
STANDSTILL = 1.0  # seconds after which one of whom nothing is seen is thought to stand
FEWEST_MOVING = 3  # keypoints that must be seen before they tell the whole person's speed
LENGTH_WEIGHT = 20.0  # measurements as which the length from the height counts
MOST_LENGTHS = 600.0
SHORT, LONG = 0.6, 1.4  # of the length from the height: what a bone of this person can measure
SURE = 0.45  # confidence of both ends of a bone that is measured
MOST_HEIGHTS = 300.0
WHOLE = 7  # keypoints of one who tells his height: few bones of one who just comes into view mislead


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
    found_height, told = _heights(tracks, pairs, seen, raw)
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
    long, times = _lengths(tracks, z, here & (confidence > SURE), found_height)
    rest, rested = learnt(tracks.rest, tracks.rested, new.p, axes(new.p), here & (confidence > SURE))
    drift, paced = _drifts(tracks, z, moment.dt)
    return replace(new, drift=drift, paced=paced, was=z, length=long, measured=times, rest=rest, rested=rested)


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


def _heights(
    tracks: Tracks, pairs: Pairs, seen: Spatial, raw: Float[np.ndarray, "m 16"]
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    """Mean height of everybody, and how many heights it is of."""
    height, told = tracks.height.copy(), tracks.told.copy()
    new, who = seen.height[pairs.which], pairs.who
    good = ~np.isnan(new) & ((raw[pairs.which, :FILTERED] > 0).sum(axis=1) >= WHOLE)
    new, who = new[good], who[good]
    told[who] = np.minimum(told[who] + 1.0, MOST_HEIGHTS)
    height[who] = np.where(np.isnan(height[who]), new, height[who] + (new - height[who]) / told[who])
    return height, told


def _lengths(
    tracks: Tracks, z: Float[np.ndarray, "q 12 3"], sure: Bool[np.ndarray, "q 12"], height: Float[np.ndarray, " q"]
) -> tuple[Float[np.ndarray, "q 12"], Float[np.ndarray, "q 12"]]:
    """Lengths of bones, from the height to begin with, and how often they were measured."""
    from_height = height[:, None] * BONE
    length = np.where(np.isnan(tracks.length), from_height, tracks.length)
    apart = z - z[:, PARENT]
    long = np.sqrt((apart * apart).sum(axis=-1))
    with np.errstate(invalid="ignore"):
        good = sure & sure[:, PARENT] & (long > SHORT * from_height) & (long < LONG * from_height)
    step = np.where(good, (long - length) / (LENGTH_WEIGHT + tracks.measured), 0.0)
    length = length + np.where(np.isnan(step), 0.0, step)
    return length, np.minimum(tracks.measured + good, MOST_LENGTHS)


def _drifts(tracks: Tracks, z: Float[np.ndarray, "q 12 3"], dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Speed of each whole person (q, 3), and of how many frames it is the mean (q,).

    It is the median over keypoints of what measurements moved since the frame before, averaged, and does not hang on the
    estimates: nobody who walks evenly is left behind. It fades where too few keypoints are seen.
    """
    moved = (z - tracks.was) / dt
    known = ~np.isnan(moved[..., 0])
    ranked = np.sort(np.where(known[..., None], moved, np.inf), axis=1)
    count = known.sum(axis=1)
    who = np.arange(count.size)
    low, high = ranked[who, np.maximum(count - 1, 0) // 2], ranked[who, np.minimum(count // 2, FILTERED - 1)]
    told = count >= FEWEST_MOVING
    median = np.where(
        told[:, None], 0.5 * (np.where(told[:, None], low, 0.0) + np.where(told[:, None], high, 0.0)), 0.0
    )
    frames = np.where(told, tracks.paced + 1.0, tracks.paced)
    share = np.maximum(1.0 / np.maximum(frames, 1.0), 1.0 - math.exp(-dt / DRIFT_TIME))[:, None]
    new = tracks.drift + share * (np.clip(median, -QUICKEST, QUICKEST) - tracks.drift)
    return np.where(told[:, None], new, math.exp(-dt / STANDSTILL) * tracks.drift), frames
