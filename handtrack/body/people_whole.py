"""Measurements of everybody's keypoints in; what they tell of whole people out: height, lengths of bones, speed, place.

Single keypoints are often wrong, and each may be thought an outlier. Most of them together are not.
"""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from .people_tracks import BONE, Tracks
from .permanence import Stories
from .resting import PARENT
from .skeleton_graph import FILTERED

DRIFT_TIME = 0.25  # seconds over which the whole person's speed is averaged
QUICKEST = 4.0  # m/s along each axis
STANDSTILL = 1.0  # seconds after which one of whom nothing is seen is thought to stand
FEWEST_MOVING = 3  # keypoints that must be seen before they tell the whole person's speed
LENGTH_WEIGHT = 20.0  # measurements as which the length from the height counts
MOST_LENGTHS = 600.0
SHORT, LONG = 0.6, 1.4  # of the length from the height: what a bone of this person can measure
MOST_HEIGHTS = 300.0
WHOLE = 7  # keypoints of one who tells his height: few bones of one who just comes into view mislead
ASTRAY, MOST = 0.3, 5  # seconds for which most of so many sure keypoints are not believed: then he is elsewhere
SURE = 0.45  # confidence of a measurement that is good


def heights(
    tracks: Tracks, who: Int[np.ndarray, " a"], new: Float[np.ndarray, " a"], count: Int[np.ndarray, " a"]
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    """Mean height of everybody (q,), metres, and how many heights it is of (q,).

    Parameters
    ----------
    who, new, count : (a,)
        Tracks, what their skeletons tell, metres, and of how many keypoints these are.
    """
    height, told = tracks.height.copy(), tracks.told.copy()
    good = ~np.isnan(new) & (count >= WHOLE)
    new, who = new[good], who[good]
    told[who] = np.minimum(told[who] + 1.0, MOST_HEIGHTS)
    height[who] = np.where(np.isnan(height[who]), new, height[who] + (new - height[who]) / told[who])
    return height, told


def lengths(
    tracks: Tracks, z: Float[np.ndarray, "q 12 3"], sure: Bool[np.ndarray, "q 12"], height: Float[np.ndarray, " q"]
) -> tuple[Float[np.ndarray, "q 12"], Float[np.ndarray, "q 12"]]:
    """Lengths of bones, metres, from the height to begin with, and how often they were measured.

    Parameters
    ----------
    z : (q, 12, 3)
        Metres; NaN where unseen.
    sure : (q, 12)
        Which of them are believed.
    """
    from_height = height[:, None] * BONE
    length = np.where(np.isnan(tracks.length), from_height, tracks.length)
    apart = z - z[:, PARENT]
    long = np.sqrt((apart * apart).sum(axis=-1))
    with np.errstate(invalid="ignore"):
        good = sure & sure[:, PARENT] & (long > SHORT * from_height) & (long < LONG * from_height)
    step = np.where(good, (long - length) / (LENGTH_WEIGHT + tracks.measured), 0.0)
    length = length + np.where(np.isnan(step), 0.0, step)
    return length, np.minimum(tracks.measured + good, MOST_LENGTHS)


def drifts(
    tracks: Tracks, z: Float[np.ndarray, "q 12 3"], dt: float
) -> tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, " q"]]:
    """Speed of each whole person, m/s, and of how many frames it is the mean.

    It is the median over keypoints of what measurements moved since the frame before, averaged. It does not hang on the
    estimates, so nobody who walks evenly is left behind. It fades where too few keypoints are seen.
    """
    moved = (z - tracks.was) / dt
    median, count = _medians(moved)
    told = count >= FEWEST_MOVING
    frames = np.where(told, tracks.paced + 1.0, tracks.paced)
    share = np.maximum(1.0 / np.maximum(frames, 1.0), 1.0 - math.exp(-dt / DRIFT_TIME))[:, None]
    new = tracks.drift + share * (np.clip(median, -QUICKEST, QUICKEST) - tracks.drift)
    return np.where(told[:, None], new, math.exp(-dt / STANDSTILL) * tracks.drift), frames


def begun_anew(tracks: Tracks, clouds: Stories, confidence: Float[np.ndarray, "q 12"]) -> Stories:
    """Forget the stories of whoever was not believed for a while, where new ones can begin in this frame.

    Keypoints hold each other by their bones, so a whole skeleton that was left behind would take every measurement for
    an outlier.

    Parameters
    ----------
    confidence : (q, 12)
        Of the measurements; 0 where none.
    """
    astray = (tracks.doubted > ASTRAY) & ((confidence > SURE).sum(axis=1) >= MOST)
    if not astray.any():
        return clouds
    return replace(clouds, weight=np.where(astray[:, None, None], 0.0, clouds.weight))


def doubts(
    tracks: Tracks, confidence: Float[np.ndarray, "q 12"], here: Bool[np.ndarray, "q 12"], dt: float
) -> Float[np.ndarray, " q"]:
    """For how long everybody is measured well but not believed (q,), seconds.

    Parameters
    ----------
    here : (q, 12)
        Which measurements are believed.
    """
    sure = confidence > SURE
    count = sure.sum(axis=1)
    doubted = (count >= MOST) & (2 * (sure & here).sum(axis=1) < count)
    before = np.where(tracks.doubted > ASTRAY, 0.0, tracks.doubted)
    return np.where(doubted, before + dt, 0.0)


def _medians(values: Float[np.ndarray, "q 12 3"]) -> tuple[Float[np.ndarray, "q 3"], Int[np.ndarray, " q"]]:
    """Median over what is not NaN, 0 where there is nothing; and how many there are."""
    known = ~np.isnan(values[..., 0])
    count = known.sum(axis=1)
    ranked = np.sort(np.where(known[..., None], values, np.inf), axis=1)
    rows = np.arange(count.size)
    low, high = ranked[rows, np.maximum(count - 1, 0) // 2], ranked[rows, np.minimum(count // 2, FILTERED - 1)]
    some = (count > 0)[:, None]
    return 0.5 * (np.where(some, low, 0.0) + np.where(some, high, 0.0)), count
