"""An image and a posed model in, how badly the grey levels of its surface fit the learnt light out.

Two poses with the same outline show different normals, and light from the side tells them apart. The grey levels of
pixels well inside every link are compared with the shading that earlier frames taught, with a gain of each link left
free within five per cent. Errors of the shading are shared by neighbouring pixels, so every patch of a link counts
once, and the patches of a link together as two independent readings:

    cost = sum over links of 2 mean_p rho(z_p),     z_p = mean residual of patch p / scatter about the shading

with Cauchy's loss rho. The cost is half a chi-square: differences are log ratios of likelihoods.
"""

import numpy as np
from jaxtyping import Float

from .appearance import Appearance, shaded
from .measure import posed
from .pills import ray_hits
from .pixels import surface_pixels
from .residuals import Chain
from .robust import CAUCHY_C

_READINGS = 2.0
_GAIN_SIGMA = 0.05
_PIXELS = 400
UNREAD = 0.5  # what a reading of a right pose costs on average: half a chi-square's mean


def shading_cost(
    image: Float[np.ndarray, "h w"], on: Chain, u: Float[np.ndarray, " k"], appearance: Appearance
) -> Float[np.ndarray, " l"]:
    """Cost of the grey levels at a pose.

    Parameters
    ----------
    image : (h, w)
        Grey levels 0 to 255.
    u : (k,)
        Independent joints.
    appearance : Appearance
        Learnt before this image.

    Returns
    -------
    (l,)
        For each link half a chi-square of about two readings; one that cannot be read costs what a right one does.

    Examples
    --------
    >>> loss(np.array([0.0, 2.385]), np.array([1.0, 1.0])).round(3).tolist()
    [0.0, 1.971]
    """
    pills = posed(on, u)
    seen = surface_pixels(image, on, pills, appearance.blur, most=_PIXELS)
    links = pills.base.shape[0]
    nothing = _READINGS * UNREAD
    if not seen.link.size:
        return np.full(links, nothing)
    R = on.camera.R
    origin, direction = seen.ray[:, :3] @ R.T + on.camera.t, seen.ray[:, 3:] @ R.T
    expected = appearance.gain[seen.link] * shaded(appearance.shading, ray_hits(pills, origin, direction).normal)
    count = np.bincount(seen.patch).astype(float)
    of_patch = np.zeros(count.size, dtype=int)
    of_patch[seen.patch] = seen.link
    level = np.bincount(seen.patch, expected) / count
    off = np.bincount(seen.patch, seen.level - expected) / count
    spread = max(appearance.spread, appearance.noise)
    gain = np.bincount(of_patch, level * off, links) / (
        np.bincount(of_patch, level * level, links) + (spread / _GAIN_SIGMA) ** 2
    )
    cost = loss(off - gain[of_patch] * level, spread)
    cost = np.bincount(of_patch, cost, links) + 0.5 / _GAIN_SIGMA**2 * gain**2
    patches = np.bincount(of_patch, minlength=links)
    return np.where(patches > 0, _READINGS * cost / np.maximum(patches, 1), nothing)


def loss(r: Float[np.ndarray, " n"], sigma: float | Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Cauchy's loss of residuals with standard deviation sigma; half a chi-square for small ones."""
    return 0.5 * CAUCHY_C**2 * np.log1p((r / (CAUCHY_C * sigma)) ** 2)
