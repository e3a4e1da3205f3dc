"""Tracks and their skeletons of a frame in; tracks with everything that the frame taught them out."""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from .identities import undone_swaps
from .people_settings import Settings
from .people_tracks import BONE, Tracks
from .permanence import PARENT, Stories, paper_step, robust_step, seen_now
from .skeleton_graph import FILTERED
from .spatial import Spatial

DRIFT_TIME = 0.2  # seconds over which the whole person's speed is averaged
STANDSTILL = 1.0  # seconds after which one of whom nothing is seen is thought to stand
FEWEST_MOVING = 3  # keypoints that must be seen before they tell the whole person's speed
LENGTH_WEIGHT = 20.0  # measurements as which the length from the height counts
MOST_LENGTHS = 600.0
SHORT, LONG = 0.6, 1.4  # of the length from the height: what a bone of this person can measure
SURE = 0.45  # confidence of both ends of a bone that is measured
MOST_HEIGHTS = 300.0
_SIDE = np.array([2, 3, 4, 5, 8, 9, 10, 11])
_UP = PARENT[_SIDE]


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
    found_height, told = _heights(tracks, pairs, seen)
    if isinstance(tracks.clouds, Stories):
        length = np.where(np.isnan(tracks.length), found_height[:, None] * BONE, tracks.length)
        clouds, estimate = robust_step(tracks.clouds, z, confidence, moment.dt, tracks.drift, length)
    else:
        clouds, estimate = paper_step(tracks.clouds, z, judged, moment.time, moment.dt, tracks.hidden, settings, rng)
    here = seen_now(estimate)
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
        hidden=np.where(here, 0.0, tracks.hidden + moment.dt),
        used=np.where(here, confidence, 0.0),
        clouds=clouds,
    )
    if not isinstance(clouds, Stories):
        return new
    long, times = _lengths(tracks, z, here & (confidence > SURE), found_height)
    return replace(new, drift=_drifts(tracks, clouds, here, moment.dt), length=long, measured=times)


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


def _heights(tracks: Tracks, pairs: Pairs, seen: Spatial) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    """Mean height of everybody, and how many heights it is of."""
    height, told = tracks.height.copy(), tracks.told.copy()
    new, who = seen.height[pairs.which], pairs.who
    good = ~np.isnan(new)
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
    count = tracks.measured.copy()
    apart = z[:, _SIDE] - z[:, _UP]
    long = np.sqrt((apart * apart).sum(axis=-1))
    with np.errstate(invalid="ignore"):
        good = sure[:, _SIDE] & sure[:, _UP] & (long > SHORT * from_height[:, _SIDE])
        good &= long < LONG * from_height[:, _SIDE]
    step = np.where(good, (long - length[:, _SIDE]) / (LENGTH_WEIGHT + count[:, _SIDE]), 0.0)
    length[:, _SIDE] += np.where(np.isnan(step), 0.0, step)
    count[:, _SIDE] = np.minimum(count[:, _SIDE] + good, MOST_LENGTHS)
    return length, count


def _drifts(tracks: Tracks, clouds: Stories, here: Bool[np.ndarray, "q 12"], dt: float) -> Float[np.ndarray, "q 3"]:
    """Speed of each whole person: the median over seen keypoints, averaged; it fades where too few are seen."""
    speed = (clouds.weight[..., None] * clouds.v).sum(axis=2)
    count = here.sum(axis=1)
    ranked = np.sort(np.where(here[..., None], speed, np.inf), axis=1)
    middle = np.maximum(count - 1, 0) // 2
    median = ranked[np.arange(count.size), middle]
    told = (count >= FEWEST_MOVING)[:, None]
    keep = math.exp(-dt / DRIFT_TIME)
    fade = math.exp(-dt / STANDSTILL)
    return np.where(told, keep * tracks.drift + (1.0 - keep) * np.where(told, median, 0.0), fade * tracks.drift)
