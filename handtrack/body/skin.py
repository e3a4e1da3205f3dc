"""Keypoints that a depth camera read on the skin in; joints below it, and how far they may be off along the ray, out.

A joint lies deeper than the skin over it, by some half of the body's depth there, and the people paper's wrists are
read off a depth image. Keypoints that were triangulated, or are corrected already, lie at the joint. Where nothing says
which it is, the middle is taken, with half of the way as its deviation.
"""

import numpy as np
from jaxtyping import Float

from .skeleton_graph import FILTERED

WRIST = 0.035  # metres from the skin to the wrist
# Depths of shoulders, elbows, wrists, hips, knees and ankles, over the wrist's.
_DEPTHS = np.repeat([1.6, 1.2, 1.0, 3.2, 1.6, 1.3], 2)
_TOLERANCE = 0.3  # of the depth, by which people and postures differ


def below_skin(p: Float[np.ndarray, "m 16 3"], skin: float | None) -> Float[np.ndarray, "m 16 3"]:
    """Move the first 12 keypoints away from the camera, along their rays.

    Parameters
    ----------
    p : (m, 16, 3)
        Metres, camera axes; NaN where unseen.
    skin : float or None
        Metres from a wrist's reading to its joint; None if it is not known whether readings are of the skin.

    >>> p = np.full((1, 16, 3), np.nan)
    >>> p[0, 4] = 0.0, 0.0, 2.0
    >>> below_skin(p, 0.04)[0, 4].round(3).tolist(), below_skin(p, None)[0, 4].round(4).tolist()
    ([0.0, 0.0, 2.04], [0.0, 0.0, 2.0175])
    """
    deep = 0.5 * WRIST * _DEPTHS if skin is None else skin * _DEPTHS
    out = p.copy()
    out[:, :FILTERED] += deep[:, None] * _rays(p[:, :FILTERED])
    return out


def doubt(p: Float[np.ndarray, "q 12 3"], skin: float | None) -> Float[np.ndarray, "q 12 3 3"]:
    """Covariance of what is left of it, m^2; NaN where there is no place."""
    if skin is None:
        sigma = 0.5 * WRIST * _DEPTHS
    else:
        sigma = np.hypot(_TOLERANCE * abs(skin) * _DEPTHS, 0.5 * WRIST * (_DEPTHS - 1.0))
    ray = sigma[:, None] * _rays(p)
    return ray[..., :, None] * ray[..., None, :]


def _rays(p: Float[np.ndarray, "m k 3"]) -> Float[np.ndarray, "m k 3"]:
    return p / np.maximum(np.sqrt((p * p).sum(axis=-1, keepdims=True)), 1e-9)
