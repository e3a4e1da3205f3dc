"""Keypoints of people in; the bones between them, their centre joints and their heights out.

Bones are arcs of a graph whose nodes are the keypoints (people paper, II-A). A bone's length is a share of the body's
height (Drillis & Contini 1966, "Body segment parameters", as printed by Winter 2009, "Biomechanics and Motor Control of
Human Movement", Figure 4.1), so that every bone that is seen tells a height:

    h = median over bones of |a - b| / share

Widths of shoulders and hips are those between joint centres, inside of that figure's widths to the skin.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..formats.skeletons import KEYPOINTS

SHORTEST, TALLEST = 1.0, 2.3  # metres; a bone that tells another height is not believed
ROOT, MID_HIP, MID_SHOULDER, HEAD = (KEYPOINTS.index(name) for name in ("root", "mid_hip", "mid_shoulder", "head"))
SHOULDERS, HIPS = (0, 1), (6, 7)
FILTERED = 12
SIDE = 0.288  # from the line of the hips to that of the shoulders, share of height
NECK = 0.118  # from the line of the shoulders to the middle of the face, share of height
OTHER_SIDE = np.array([1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 12, 13, 14, 15])


@dataclass(frozen=True, slots=True)
class Segment:
    """A bone: keypoints at both ends, the one nearer to the trunk first, and its share of the body's height."""

    name: str
    near: int
    far: int
    share: float


SEGMENTS: tuple[Segment, ...] = (
    Segment("left_upper_arm", 0, 2, 0.186), Segment("right_upper_arm", 1, 3, 0.186),
    Segment("left_forearm", 2, 4, 0.146), Segment("right_forearm", 3, 5, 0.146),
    Segment("left_thigh", 6, 8, 0.245), Segment("right_thigh", 7, 9, 0.245),
    Segment("left_shank", 8, 10, 0.246), Segment("right_shank", 9, 11, 0.246),
    Segment("shoulders", 0, 1, 0.234), Segment("hips", 6, 7, 0.110),
    Segment("left_side", 6, 0, 0.294), Segment("right_side", 7, 1, 0.294),
)  # fmt: skip
NEAR: Int[np.ndarray, " b"] = np.array([segment.near for segment in SEGMENTS])
FAR: Int[np.ndarray, " b"] = np.array([segment.far for segment in SEGMENTS])
SHARE: Float[np.ndarray, " b"] = np.array([segment.share for segment in SEGMENTS])
LIMBS = 8  # the first bones; the others are of the trunk


def lengths(p: Float[np.ndarray, "m 16 3"]) -> Float[np.ndarray, "m b"]:
    """Lengths of all bones, metres; NaN where an end is not seen."""
    apart = p[:, FAR] - p[:, NEAR]
    return np.sqrt((apart * apart).sum(axis=-1))


def complete(
    p: Float[np.ndarray, "m 16 3"], confidence: Float[np.ndarray, "m 16"]
) -> tuple[Float[np.ndarray, "m 16 3"], Float[np.ndarray, "m 16"]]:
    """Put in the centre joints that are not seen but can be built; what is seen stays.

    The middles of hips and shoulders come from both sides, the root is the mean of shoulders and hips (people paper,
    II-A), the head lies above the shoulders on the trunk's line. The confidence is that of the least sure joint used.

    Parameters
    ----------
    p : (m, 16, 3)
        Metres; NaN where unseen.
    confidence : (m, 16)

    >>> p, c = np.full((1, 16, 3), np.nan), np.zeros((1, 16))
    >>> p[0, 6:8], c[0, 6:8] = [[0.0, 0, 2], [0.5, 0, 2]], [0.5, 0.75]
    >>> p, c = complete(p, c)
    >>> p[0, 13].tolist(), float(c[0, 13])
    ([0.25, 0.0, 2.0], 0.5)
    """
    p, confidence = p.copy(), confidence.copy()
    for middle, (a, b) in ((MID_HIP, HIPS), (MID_SHOULDER, SHOULDERS)):
        _put(p, confidence, middle, 0.5 * (p[:, a] + p[:, b]), np.minimum(confidence[:, a], confidence[:, b]))
    hip, shoulder = p[:, MID_HIP], p[:, MID_SHOULDER]
    least = np.minimum(confidence[:, MID_HIP], confidence[:, MID_SHOULDER])
    _put(p, confidence, ROOT, 0.5 * (hip + shoulder), least)
    _put(p, confidence, HEAD, shoulder + NECK / SIDE * (shoulder - hip), least)
    return p, confidence


def _put(
    p: Float[np.ndarray, "m 16 3"],
    confidence: Float[np.ndarray, "m 16"],
    k: int,
    place: Float[np.ndarray, "m 3"],
    sure: Float[np.ndarray, " m"],
) -> None:
    """Fill keypoint k in place where it is not seen and the new place is known."""
    new = np.isnan(p[:, k, 0]) & ~np.isnan(place[:, 0])
    p[new, k], confidence[new, k] = place[new], sure[new]


def heights(p: Float[np.ndarray, "m 16 3"], confidence: Float[np.ndarray, "m 16"]) -> Float[np.ndarray, " m"]:
    """Height of each person, metres: the median of what bones tell; NaN where no bone tells a plausible one.

    Parameters
    ----------
    p : (m, 16, 3)
        Metres; NaN where unseen.
    confidence : (m, 16)
        Bones with an end of confidence 0 are left out.

    >>> p = np.full((1, 16, 3), np.nan)
    >>> p[0, [2, 4]] = [[0, 0, 2], [0, 0.25, 2]]  # a forearm; the paper's own example
    >>> heights(p, np.ones((1, 16))).round(2).tolist()
    [1.71]
    """
    told = lengths(p) / SHARE
    with np.errstate(invalid="ignore"):
        good = (told > SHORTEST) & (told < TALLEST) & (confidence[:, NEAR] > 0) & (confidence[:, FAR] > 0)
    return _median(told, good)


def _median(values: Float[np.ndarray, "m b"], good: Bool[np.ndarray, "m b"]) -> Float[np.ndarray, " m"]:
    """Median of the good ones of each row; NaN where there is none."""
    ranked = np.sort(np.where(good, values, np.inf), axis=1)
    count = good.sum(axis=1)
    rows = np.arange(values.shape[0])
    low, high = ranked[rows, np.maximum(count - 1, 0) // 2], ranked[rows, np.minimum(count // 2, values.shape[1] - 1)]
    return np.where(count > 0, 0.5 * (np.where(count > 0, low, 0.0) + np.where(count > 0, high, 0.0)), np.nan)
