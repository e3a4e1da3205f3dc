"""Profiles across links in, edges at the steepest places of their derivative out (hand thesis, 11.1).

Plain difference, eq. (11.1), and convolution with the derivative of a Gaussian,

    D(k) = I(k + 1) - I(k)        D(k) = sum over i of c_i I(k + i),  c_i = d/dk N(k = i | 0, sigma)

The steepest rise and the steepest fall of a profile are its two edges; a finger tip has one. Nothing but the predicted
sign tells an edge from the rest: whatever is steeper elsewhere on the profile is taken in its place, and is then
refused if it lies beyond reach of the prediction.
"""

import numpy as np
from jaxtyping import Bool, Float

from .crossings import Crossings
from .points import EdgePoints
from .slopes import Slopes, slopes, strongest

SIGMA = 1.0  # pixels, of the Gaussian; the thesis states none


def plain_slopes(crossings: Crossings) -> Slopes:
    """Differences of neighbouring samples, eq. (11.1), per pixel, between the two samples.

    The thesis sets the peak on the first of the two, half a sample early; here it stands halfway.
    """
    h = crossings.step
    return slopes(crossings, np.array([-1.0, 1.0]) / h, h / np.sqrt(12.0))


def gaussian_mask(step: float, sigma: float = SIGMA) -> Float[np.ndarray, " a"]:
    """Derivative of a Gaussian out to three sigmas, for samples `step` pixels apart; a ramp of slope 1 gives 1.

    >>> mask = gaussian_mask(0.5)
    >>> float((mask * 0.5 * np.arange(-6, 7)).sum().round(9)), float(mask.sum().round(9))
    (1.0, 0.0)
    """
    half = int(np.ceil(3.0 * sigma / step))
    x = np.arange(-half, half + 1) * step
    mask = x * np.exp(-0.5 * (x / sigma) ** 2)
    return mask / (mask * x).sum()


def gaussian_slopes(crossings: Crossings) -> Slopes:
    """Derivatives smoothed by a Gaussian, per pixel, where its whole mask lies inside the window."""
    return slopes(crossings, gaussian_mask(crossings.step), SIGMA)


def difference(crossings: Crossings) -> EdgePoints:
    """Edges at the extremes of the plain difference (hand thesis, 11.1.1).

    Parameters
    ----------
    crossings : Crossings
        n profiles.

    Returns
    -------
    EdgePoints
        2 n entries, side -1 before side +1 of each profile; `offset` outwards from the predicted edge, pixels.
    """
    given = plain_slopes(crossings)
    return strongest(crossings, given, _whole_profile(crossings, given))


def gaussian(crossings: Crossings) -> EdgePoints:
    """Edges at the extremes of the Gaussian derivative (hand thesis, 11.1.2); arguments as in `difference`."""
    given = gaussian_slopes(crossings)
    return strongest(crossings, given, _whole_profile(crossings, given))


def _whole_profile(crossings: Crossings, given: Slopes) -> Bool[np.ndarray, "n 2 k"]:
    """All of the profile from one reach before its first edge to one reach behind its last."""
    edge, none = crossings.edge, np.isnan(crossings.edge)
    first = np.where(none[:, 0], -np.inf, edge[:, 0] - crossings.reach)
    last = np.where(none[:, 1], np.inf, edge[:, 1] + crossings.reach)
    inside = (given.u >= first[:, None]) & (given.u <= last[:, None])
    return np.repeat(inside[:, None, :], 2, axis=1)
