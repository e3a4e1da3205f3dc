"""Profiles in, their derivatives with the covariance of the noise, and the sub-sample peaks of such curves, out.

A derivative is a correlation of the profile with a mask c (hand thesis, 11.1.2). Interpolation correlates the noise
of samples t pixels apart by a product of cubic B-splines, so the noise of the derivative has the covariance

    cov(l) = noise^2 sum over a, b of c_a c_b B((l + a - b) h dx) B((l + a - b) h dy)

at a lag of l samples, h apart along the direction (dx, dy). A peak stands at the vertex of the parabola through the
logarithms of three samples, which is exact for a blurred step (its derivative is a Gaussian), or through the samples
themselves where one is not positive. To first order the vertex moves by w . noise, which gives its sigma.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .crossings import OUTWARD, Crossings, answer
from .points import BORDER, FLAT, FOUND, OUTSIDE, EdgePoints

_LEAST_HEIGHT = 0.25  # of what the predicted step would give: less is shading, not an edge
_CLEAR = 4.0  # sigmas of the noise that a peak stands out by


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Derivatives of profiles.

    Attributes
    ----------
    u : (k,)
        Positions that the values belong to, pixels.
    values : (n, k)
        Grey levels per pixel.
    usable : (n, k)
        Where the whole mask lies inside the window.
    covariance : (n, g)
        Of the noise, (grey levels per pixel)^2, at lags 0, 1, ... samples; zero beyond the last.
    height : float
        Peak of a step of one grey level, 1 / (sqrt(2 pi) blur) with the mask's own blur added, 1/pixel.
    """

    u: Float[np.ndarray, " k"]
    values: Float[np.ndarray, "n k"]
    usable: Bool[np.ndarray, "n k"]
    covariance: Float[np.ndarray, "n g"]
    height: float


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """The highest allowed sample of each curve.

    Attributes
    ----------
    place : (r,)
        Vertex, in pixels of u; NaN where no sample is allowed.
    height : (r,)
        Value of the highest sample; -inf where none is allowed.
    sigma : (r,)
        Standard deviation of the place by the noise, pixels; inf without a vertex.
    inner : (r,)
        Whether it is a vertex: both neighbours can be used and neither is higher.
    """

    place: Float[np.ndarray, " r"]
    height: Float[np.ndarray, " r"]
    sigma: Float[np.ndarray, " r"]
    inner: Bool[np.ndarray, " r"]


def slopes(crossings: Crossings, mask: Float[np.ndarray, " a"], spread: float) -> Slopes:
    """Correlate profiles with a derivative mask; the result belongs to the middle of the mask.

    Parameters
    ----------
    mask : (a,)
        Weights, 1/pixel.
    spread : float
        Standard deviation of what the mask adds to the blur of an edge, pixels.
    """
    h = crossings.step
    grey = np.where(crossings.window, crossings.profiles.values, 0.0)
    values = np.lib.stride_tricks.sliding_window_view(grey, mask.size, axis=1) @ mask
    # A running count instead of a window over booleans: all of the mask is usable where it counts `mask.size`.
    count = np.cumsum(np.pad(crossings.window, ((0, 0), (1, 0))), axis=1)
    usable = count[:, mask.size :] - count[:, : -mask.size] == mask.size
    first = crossings.profiles.u[0] + 0.5 * (mask.size - 1) * h
    u = first + h * np.arange(values.shape[1])
    height = 1.0 / np.sqrt(2.0 * np.pi * (crossings.blur**2 + spread**2))
    covariance = noise_covariance(mask, crossings.samplers.direction, h) * crossings.noise**2
    return Slopes(u, values, usable, covariance, height)


def noise_covariance(
    mask: Float[np.ndarray, " a"], direction: Float[np.ndarray, "n 2"], step: float
) -> Float[np.ndarray, "n g"]:
    """Covariance of the derivative for unit pixel noise, at lags of 0, 1, ... samples.

    >>> one_pixel = noise_covariance(np.array([-1.0, 1.0]), np.array([[1.0, 0.0]]), 1.0)
    >>> one_pixel.round(3).tolist()
    [[0.667, -0.222, -0.111, 0.0, 0.0]]
    """
    reach = int(np.ceil(2.0 * np.sqrt(2.0) / step))
    own = np.correlate(mask, mask, mode="full")
    most = mask.size - 1 + reach
    lag = np.arange(-(mask.size - 1), most + mask.size) * step
    rho = _spline(lag * direction[:, :1]) * _spline(lag * direction[:, 1:])
    return np.lib.stride_tricks.sliding_window_view(rho, own.size, axis=1) @ own


def _spline(d: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
    """Cubic B-spline: correlation of two linear interpolations of white noise, d pixels apart."""
    d = np.abs(d)
    return np.where(d < 1.0, 2.0 / 3.0 - d * d * (1.0 - 0.5 * d), np.where(d < 2.0, (2.0 - d) ** 3 / 6.0, 0.0))


def variance_of(weight: Float[np.ndarray, "r k"], covariance: Float[np.ndarray, "r g"]) -> Float[np.ndarray, " r"]:
    """Variance of `weight . noise` for noise with that covariance at lags of 0, 1, ... samples."""
    lags = min(covariance.shape[1], weight.shape[1])
    ahead = np.lib.stride_tricks.sliding_window_view(np.pad(weight, ((0, 0), (0, lags - 1))), lags, axis=1)
    products = np.einsum("rk,rkg->rg", weight, ahead)
    twice = np.where(np.arange(lags) == 0, 1.0, 2.0)
    return np.maximum((products * covariance[:, :lags] * twice).sum(axis=1), 0.0)


def outward_fall(crossings: Crossings, values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n 2 k"]:
    """Derivatives with the sign that makes each side's predicted step positive."""
    return -(OUTWARD * np.sign(crossings.rise))[..., None] * values[:, None, :]


def vertex(
    curve: Float[np.ndarray, "r k"], at: Int[np.ndarray, " r"]
) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, "r 3"]]:
    """Sub-sample shift of the vertex from the sample `at` (not the first or last), and its derivative by the three
    samples.

    >>> k = np.arange(5.0)
    >>> float(vertex(np.exp(-((k[None] - 2.3) ** 2)), np.array([2]))[0][0].round(6))
    0.3
    """
    three = np.take_along_axis(curve, at[:, None] + np.arange(-1, 2), axis=1)
    positive = (three > 0.0).all(axis=1, keepdims=True)
    safe = np.where(positive, three, 1.0)
    level, scale = np.where(positive, np.log(safe), three), np.where(positive, 1.0 / safe, 1.0)
    slope, bend = level[:, 0] - level[:, 2], level[:, 0] - 2.0 * level[:, 1] + level[:, 2]
    usable = bend < 0.0
    bend = np.where(usable, bend, -1.0)
    shift = np.where(usable, 0.5 * slope / bend, 0.0)
    by = np.stack([bend - slope, 2.0 * slope, -bend - slope], axis=1) / (2.0 * bend**2)[:, None]
    return shift, np.where(usable[:, None], by * scale, np.inf)


def peaks(
    curve: Float[np.ndarray, "r k"],
    usable: Bool[np.ndarray, "r k"],
    allowed: Bool[np.ndarray, "r k"],
    u: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "r g"],
) -> Peaks:
    """The highest sample of each curve among those allowed, refined by its neighbours.

    Parameters
    ----------
    usable, allowed : (r, k)
        Samples that are known, and those of them where the peak may be.
    covariance : (r, g)
        Of the curve's noise at lags of 0, 1, ... samples.
    """
    row, count = np.arange(curve.shape[0]), curve.shape[1]
    masked = np.where(usable & allowed, curve, -np.inf)
    at = np.argmax(masked, axis=1)
    height = masked[row, at]
    middle = np.clip(at, 1, count - 2)
    near = middle[:, None] + np.array([-1, 1])
    inner = (at == middle) & usable[row[:, None], near].all(axis=1) & np.isfinite(height)
    inner &= (curve[row[:, None], near] <= curve[row, middle][:, None]).all(axis=1)
    shift, by = vertex(curve, middle)
    inner &= np.isfinite(by).all(axis=1)
    step = float(u[1] - u[0])
    place = np.where(np.isfinite(height), u[at] + np.where(inner, np.clip(shift, -1.0, 1.0) * step, 0.0), np.nan)
    sigma = np.sqrt(variance_of(np.where(inner[:, None], by, 0.0), covariance)) * step
    return Peaks(place, height, np.where(inner, sigma, np.inf), inner)


def strongest(crossings: Crossings, given: Slopes, allowed: Bool[np.ndarray, "n 2 k"]) -> EdgePoints:
    """The steepest expected step of each side among the allowed places, as edge points with sigma and reason."""
    n, k = given.values.shape
    fall = outward_fall(crossings, given.values).reshape(2 * n, k)
    usable = np.repeat(given.usable, 2, axis=0)
    covariance = np.repeat(given.covariance, 2, axis=0)
    found = peaks(fall, usable, allowed.reshape(2 * n, k), given.u, covariance)
    wanted, noise = np.abs(crossings.rise).ravel() * given.height, np.sqrt(covariance[:, 0])
    reason = np.full(2 * n, FOUND)
    reason[~found.inner] = BORDER
    weak = ~(found.height >= np.maximum(_LEAST_HEIGHT * wanted, _CLEAR * noise)) | (wanted < _CLEAR * noise)
    reason[weak] = FLAT
    reason[~np.isfinite(found.height)] = OUTSIDE
    offset = OUTWARD * (found.place.reshape(n, 2) - crossings.edge)
    misfit = ((np.where(np.isfinite(found.height), found.height, 0.0) - wanted) / np.maximum(noise, 1e-12)) ** 2
    return answer(crossings, offset, found.sigma.reshape(n, 2), reason.reshape(n, 2), misfit.reshape(n, 2))
