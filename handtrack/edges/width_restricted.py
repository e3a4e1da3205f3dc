"""Profiles across links of known width in, edges searched only where that width allows them out (hand thesis, 11.2).

Basic restriction (11.2.1): with the profile's centre c and the width d, the peaks of the Gaussian derivative D are
searched within

    (c +- d / 2) +- tau / 2

Compensated restriction (11.2.2): first the profile's own shift is found, where a template of one peak up and one down,
d apart, correlates best with D,

    C(s) = D(c - d / 2 + s) - D(c + d / 2 + s),      s* = argmax C

(for a finger brighter than what lies behind it), then peaks are searched around `c +- d / 2 + s*`. A side that is
hidden adds nothing to C. The width of each profile is that of the posed model at its place.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .crossings import Crossings
from .derivative import gaussian_slopes
from .points import FOUND, EdgePoints
from .slopes import Slopes, outward_fall, peaks, strongest

_TAU = 0.5  # of the width: the basic window, which the thesis leaves open
_NEAR = 2.0  # pixels to both sides of a compensated prediction


@dataclass(frozen=True, slots=True, eq=False)
class Correlation:
    """Correlation curves of the two-peak template.

    Attributes
    ----------
    shift : (k,)
        Shifts of the template from the predicted place, pixels along u.
    curves : (n, k)
        Grey levels per pixel.
    allowed : (n, k)
        Shifts within reach at which at least one side of the template can be compared.
    covariance : (n, g)
        Of the curves' noise at lags of 0, 1, ... samples.
    wanted : (n,)
        Height of the curve where the predicted steps are met.
    """

    shift: Float[np.ndarray, " k"]
    curves: Float[np.ndarray, "n k"]
    allowed: Bool[np.ndarray, "n k"]
    covariance: Float[np.ndarray, "n g"]
    wanted: Float[np.ndarray, " n"]


def correlate(crossings: Crossings, given: Slopes) -> Correlation:
    """Correlate derivatives with two peaks as far apart as the predicted edges (hand thesis, 11.2.2)."""
    h, count = crossings.step, given.u.size
    most = int(np.ceil(float(crossings.reach.max(initial=h)) / h))
    shift = np.arange(-most, most + 1) * h
    active = crossings.state == FOUND
    first = np.where(active, (np.nan_to_num(crossings.edge) + shift[0] - given.u[0]) / h, 0.0)
    whole = np.floor(first).astype(int)
    part = (first - whole)[..., None]
    index = whole[..., None] + np.arange(shift.size)
    inside = (index >= 0) & (index + 1 < count) & active[..., None]
    low = np.where(inside, index, 0)
    row = np.arange(low.shape[0])[:, None, None]
    usable = inside & given.usable[row, low] & given.usable[row, np.minimum(low + 1, count - 1)]
    fall = outward_fall(crossings, given.values)
    side = np.arange(2)[:, None]
    between = (1.0 - part) * fall[row, side, low] + part * fall[row, side, np.minimum(low + 1, count - 1)]
    curves = np.where(usable, between, 0.0).sum(axis=1)
    allowed = usable.any(axis=1) & (np.abs(shift) <= crossings.reach[:, None] + 1e-9)
    wanted = (np.abs(crossings.rise) * active).sum(axis=1) * given.height
    return Correlation(shift, curves, allowed, _covariance(given, part[..., 0], active), wanted)


def _covariance(
    given: Slopes, part: Float[np.ndarray, "n 2"], active: Bool[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n g"]:
    """Noise of the curves: each active side adds its own, smoothed by the interpolation between two samples."""
    padded = np.pad(given.covariance, ((0, 0), (0, 2)))
    plain, later = padded[:, :-1], padded[:, 1:]
    earlier = np.concatenate([padded[:, 1:2], padded[:, :-2]], axis=1)
    own = ((part**2 + (1.0 - part) ** 2) * active).sum(axis=1)[:, None]
    crossed = ((part * (1.0 - part)) * active).sum(axis=1)[:, None]
    return own * plain + crossed * (earlier + later)


def width(crossings: Crossings) -> EdgePoints:
    """Edges in windows around the predicted ones, basic restriction (hand thesis, 11.2.1).

    Parameters
    ----------
    crossings : Crossings
        n profiles. The window is half as wide as the link, and never beyond reach.

    Returns
    -------
    EdgePoints
        2 n entries, side -1 before side +1 of each profile; `offset` outwards from the predicted edge, pixels.
    """
    given = gaussian_slopes(crossings)
    tau = np.where(np.isfinite(crossings.width), _TAU * crossings.width, np.inf)
    half = np.minimum(0.5 * tau, crossings.reach)
    away = np.abs(given.u - crossings.edge[..., None])
    return strongest(crossings, given, away <= half[:, None, None] + 1e-9)


def width_compensated(crossings: Crossings) -> EdgePoints:
    """Edges in narrow windows around the best place of a two-peak template, compensated restriction (11.2.2).

    Arguments as in `width`.
    """
    given = gaussian_slopes(crossings)
    matched = correlate(crossings, given)
    best = peaks(matched.curves, matched.allowed, matched.allowed, matched.shift, matched.covariance)
    moved = crossings.edge + np.nan_to_num(best.place)[:, None]
    away = np.abs(given.u - moved[..., None])
    near = (away <= _NEAR) & np.isfinite(best.place)[:, None, None]
    return strongest(crossings, given, near)
