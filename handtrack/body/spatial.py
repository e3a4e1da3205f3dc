"""Skeletons of one frame in; how much each keypoint is believed, and which skeletons are people, out.

The people paper's spatial evaluation (II-A). The root's distance from the camera is gated; bones tell the height; every
bone whose length suits the height adds r to both of its keypoints' confidence, every other one takes p away:

    all bones of a keypoint right      +r for one, +2r for several
    several of them wrong              -2p
    some right, one wrong              +r - p

A bone that is not seen is neither right nor wrong, and the order of bones plays no part.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .._kernels.skeletons import judge_skeletons
from ..formats.skeletons import FARTHEST
from .people_settings import Settings
from .skeleton_graph import (
    FAR,
    NEAR,
    NECK,
    ROOT,
    SEGMENTS,
    SHARE,
    SHORTEST,
    SIDE,
    TALLEST,
    complete,
    heights,
    lengths,
)

REASONS = ("", "no keypoint", "beyond the distance", "no plausible height")
_END = np.zeros((2, len(SEGMENTS), 16))
_END[0, np.arange(len(SEGMENTS)), NEAR] = 1.0
_END[1, np.arange(len(SEGMENTS)), FAR] = 1.0
_TOUCHES = _END.sum(axis=0)  # bones x keypoints
_FEWEST = 2  # bones that must be seen before wrong lengths say that this is nobody
_PAIRS = np.array([[0, 2], [6, 8], [2, 4], [8, 10]])  # elbows and knees, then wrists and ankles, which hang on them
_SHARES = np.array([0.186, 0.245, 0.146, 0.246])
_CLEAR = 0.25  # of a bone's length, mean of two, by which a change of sides must be better


@dataclass(frozen=True, slots=True, eq=False)
class Spatial:
    """Judged skeletons, m of them.

    Attributes
    ----------
    p : (m, 16, 3)
        Metres; centre joints built, sides put right; NaN where unseen.
    confidence : (m, 16)
        With rewards and penalties, 0..1; 0 where unseen.
    root : (m, 3)
        The root, or else the middle of what is seen.
    height : (m,)
        Metres; NaN where no bone tells one.
    reward : (m,)
        Mean over the seen keypoints of what was added.
    kept : (m,)
        Whether this can be a person.
    reason : tuple of str
        Why not; empty for one who is kept.
    """

    p: Float[np.ndarray, "m 16 3"]
    confidence: Float[np.ndarray, "m 16"]
    root: Float[np.ndarray, "m 3"]
    height: Float[np.ndarray, " m"]
    reward: Float[np.ndarray, " m"]
    kept: Bool[np.ndarray, " m"]
    reason: tuple[str, ...]


def evaluate(
    p: Float[np.ndarray, "m 16 3"],
    confidence: Float[np.ndarray, "m 16"],
    settings: Settings,
    known_height: Float[np.ndarray, " m"] | None = None,
) -> Spatial:
    """Judge the skeletons of one frame.

    Parameters
    ----------
    p : (m, 16, 3)
        Metres, camera axes; NaN where unseen. What is not finite counts as unseen, and so does confidence 0.
    confidence : (m, 16)
        0..1.
    known_height : (m,), optional
        Heights that are known from earlier frames, metres; NaN where none.

    >>> p, c = np.full((1, 16, 3), np.nan), np.zeros((1, 16))
    >>> p[0, [0, 2, 4]], c[0, [0, 2, 4]] = [[0, 0, 2], [0, 0.325, 2], [0, 0.58, 2]], 0.5
    >>> found = evaluate(p, c, Settings())
    >>> found.confidence[0, [0, 2, 4]].round(2).tolist(), found.height.round(2).tolist()
    ([0.6, 0.7, 0.6], [1.75])
    """
    p, confidence = clean(p, confidence)
    known = np.full(p.shape[0], np.nan) if known_height is None else known_height
    height, added, bones = np.empty(p.shape[0]), np.empty(p.shape[:2]), np.empty(p.shape[0])
    numbers = np.array([SHORTEST, TALLEST, _CLEAR, settings.tolerance, settings.reward, settings.penalty, NECK / SIDE])
    judge_skeletons(p, confidence, NEAR, FAR, SHARE, _PAIRS, _SHARES, known, numbers, height, added, bones)
    seen = confidence > 0
    reward = (added * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    confidence = np.where(seen, np.clip(confidence + added, 0.0, 1.0), 0.0)
    root = _roots(p, seen)
    far = np.sqrt((root * root).sum(axis=1))
    empty = ~seen.any(axis=1)
    with np.errstate(invalid="ignore"):
        distant = ~empty & (far > settings.distance)
    shapeless = ~empty & ~distant & np.isnan(height) & (bones >= _FEWEST)
    which = np.select([empty, distant, shapeless], [1, 2, 3]).tolist()
    reason = tuple(REASONS[i] for i in which)
    return Spatial(p, confidence, root, height, reward, ~(empty | distant | shapeless), reason)


def clean(
    p: Float[np.ndarray, "m 16 3"], confidence: Float[np.ndarray, "m 16"]
) -> tuple[Float[np.ndarray, "m 16 3"], Float[np.ndarray, "m 16"]]:
    """NaN and 0 for every keypoint that lacks a place within 50 m along each axis or a positive, finite confidence."""
    with np.errstate(invalid="ignore"):
        seen = (np.abs(p) <= FARTHEST).all(axis=-1) & np.isfinite(confidence) & (confidence > 0)
    return np.where(seen[..., None], p, np.nan), np.where(seen, np.minimum(confidence, 1.0), 0.0)


def judged_numpy(
    p: Float[np.ndarray, "m 16 3"],
    confidence: Float[np.ndarray, "m 16"],
    known: Float[np.ndarray, " m"],
    settings: Settings,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Plain twin of `_kernels.skeletons.judge_skeletons`: p, confidence, height, what is added to these, bones."""
    p, confidence = _sides_right(p, confidence)
    p, confidence = complete(p, confidence)
    height = np.where(np.isfinite(known), known, heights(p, confidence))
    return p, confidence, height, *rewards(p, height, settings)


def rewards(
    p: Float[np.ndarray, "m 16 3"], height: Float[np.ndarray, " m"], settings: Settings
) -> tuple[Float[np.ndarray, "m 16"], Float[np.ndarray, " m"]]:
    """What is added to each confidence, and how many bones are seen; nothing without a height."""
    long = lengths(p)
    expected = height[:, None] * SHARE
    with np.errstate(invalid="ignore"):
        right = np.abs(long - expected) <= settings.tolerance * expected
    seen = np.isfinite(long)
    judged = seen & np.isfinite(expected)
    good, bad = (right & judged) @ _TOUCHES, (~right & judged) @ _TOUCHES
    r, q = settings.reward, settings.penalty
    mixed = r * (good > 0) - q * (bad > 0)
    return np.select([(good > 1) & (bad == 0), bad > 1], [2.0 * r, -2.0 * q], mixed), seen.sum(axis=1).astype(float)


def _roots(p: Float[np.ndarray, "m 16 3"], seen: Bool[np.ndarray, "m 16"]) -> Float[np.ndarray, "m 3"]:
    """The root, or the mean of what is seen; NaN where nothing is."""
    middle = np.where(seen[..., None], p, 0.0).sum(axis=1)
    count = seen.sum(axis=1)[:, None]
    middle = np.where(count > 0, middle / np.maximum(count, 1), np.nan)
    return np.where(np.isnan(p[:, ROOT]), middle, p[:, ROOT])


def _sides_right(
    p: Float[np.ndarray, "m 16 3"], confidence: Float[np.ndarray, "m 16"]
) -> tuple[Float[np.ndarray, "m 16 3"], Float[np.ndarray, "m 16"]]:
    """Change left and right joints back where that makes both bones to the trunk's side as long as they should be."""
    height = heights(p, confidence)
    p, confidence = p.copy(), confidence.copy()
    rows = np.arange(p.shape[0])[:, None]
    for two in (slice(0, 2), slice(2, 4)):
        near, far, share = _PAIRS[two, 0], _PAIRS[two, 1], _SHARES[two]
        expected = height[:, None] * share
        across = _misfit(p, near, far + 1, expected) + _misfit(p, near + 1, far, expected)
        straight = _misfit(p, near, far, expected) + _misfit(p, near + 1, far + 1, expected)
        with np.errstate(invalid="ignore"):
            wrong = across + 2.0 * _CLEAR < straight
        one, other = np.where(wrong, far + 1, far), np.where(wrong, far, far + 1)
        p[:, far], p[:, far + 1] = p[rows, one], p[rows, other]
        confidence[:, far], confidence[:, far + 1] = confidence[rows, one], confidence[rows, other]
    return p, confidence


def _misfit(
    p: Float[np.ndarray, "m 16 3"], a: np.ndarray, b: np.ndarray, expected: Float[np.ndarray, "m e"]
) -> Float[np.ndarray, "m e"]:
    """By which share of its length a bone is too long or too short; at most 1; NaN where an end is not seen."""
    apart = p[:, a] - p[:, b]
    return np.minimum(np.abs(np.sqrt((apart * apart).sum(axis=-1)) - expected) / expected, 1.0)
