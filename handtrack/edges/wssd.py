"""Profiles and templates in, edge points by windowed sums of squared differences out (hand thesis, 4.3.1 and 4.3.2).

    WSSD(k) = mean over visible j of (I(j + k) - t(j))^2

The window moves with the template, and the sum is divided by the number of visible samples. The lowest point of the
curve, weighed against how far the prediction may be off, is refined to a fraction of a sample by one Gauss-Newton
step, which also yields the standard deviation: the Cramer-Rao bound of a shift in noise that the interpolation has
correlated.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from .. import _kernels
from ..profiles import Profiles, Samplers
from ..templates import EXPECTED, Templates
from ..templates import HIDDEN as STATE_HIDDEN
from .points import BORDER, FLAT, FOUND, HIDDEN, JOINT, MISFIT, OUTSIDE, EdgePoints

_LEAST_SAMPLES = 6  # a window shorter than 3 px cannot tell an edge
_MOST_RAW = (
    0.2  # the same before grey levels are adjusted: where there is no edge at all, adjusting explains everything
)
_MOST_MISFIT = 0.15  # of the squared contrast: more is another object
_SAMPLES = 8  # most samples that a profile counts for
_FORGIVEN = 0.1  # of the contrast: how far the rendered grey levels may be off
_RIDGE_SHAPE = np.array([0.0, 1.0, 1.0, 1.0, 4.0])
_INTERPOLATION_FLOOR = 0.04  # pixels: what interpolation and the blur's shape leave when noise is absent


def curves(image: Profiles, templates: Templates) -> Float[np.ndarray, "n k"]:
    """WSSD curves over shifts, for profiles k - 1 samples longer than the templates; inf where too little is seen."""
    n, m = templates.values.shape
    out, counts = np.empty((n, image.values.shape[1] - m + 1)), np.empty(n, dtype=np.int64)
    _kernels.wssd(image.values, image.inside, templates.values, templates.visible, out, counts)
    return out


def curves_numpy(image: Profiles, templates: Templates) -> Float[np.ndarray, "n k"]:
    """The same as `curves` in plain NumPy: the twin of the compiled kernel."""
    m = templates.values.shape[1]
    window = np.lib.stride_tricks.sliding_window_view(image.values, m, axis=1)
    seen = np.lib.stride_tricks.sliding_window_view(image.inside, m, axis=1) & templates.visible[:, None, :]
    total = (np.where(seen, window - templates.values[:, None, :], 0.0) ** 2).sum(axis=2)
    used, wanted = seen.sum(axis=2), templates.visible.sum(axis=1)
    return np.where((2 * used >= wanted[:, None]) & (used > 0), total / np.maximum(used, 1), np.inf)


def refine(
    image: Profiles,
    templates: Templates,
    best: Int[np.ndarray, " n"],
    samplers: Samplers,
    step: float,
    ridge: Float[np.ndarray, "n 5"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Sub-sample shift in pixels at the valleys, its variance for unit pixel noise, and the misfit that is left.

    `ridge` is the noise variance over the prior variance of the shift (0) and of the four corrections of grey level:
    level, facing term and gradient of the finger, level beyond the edge.
    """
    n = best.size
    shift, variance, misfit = np.empty(n), np.empty(n), np.empty(n)
    _kernels.refine_shift(
        image.values,
        image.inside,
        templates.values,
        templates.parts,
        templates.visible,
        best,
        step,
        samplers.direction,
        ridge,
        shift,
        variance,
        misfit,
    )
    return shift, variance, misfit


def refine_numpy(
    image: Profiles,
    templates: Templates,
    best: Int[np.ndarray, " n"],
    samplers: Samplers,
    step: float,
    ridge: Float[np.ndarray, "n 5"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The same as `refine` in plain NumPy: the twin of the compiled kernel."""
    m = templates.values.shape[1]
    column = best[:, None] + np.arange(m)
    seen = templates.visible & np.take_along_axis(image.inside, column, axis=1)
    span = np.full(m, 2.0)
    span[[0, -1]] = 1.0
    edge = np.pad(templates.values, ((0, 0), (1, 1)), mode="edge")
    cover, faces = templates.parts[:, 0], templates.parts[:, 1]
    slope = -(edge[:, 2:] - edge[:, :-2]) / (span * step)
    design = (
        np.stack([slope, cover, faces, cover * (np.arange(m) - 0.5 * m) / m, 1.0 - cover], axis=1) * seen[:, None, :]
    )
    r = np.where(seen, np.take_along_axis(image.values, column, axis=1) - templates.values, 0.0)
    gg = (design[:, 0] ** 2).sum(axis=1)
    flat = gg <= 1e-9
    normal = design @ np.swapaxes(design, 1, 2)
    normal[:, range(5), range(5)] += ridge + 1e-9 * gg[:, None]
    normal[flat] = np.eye(5)
    solution = np.linalg.solve(normal, (design @ r[..., None]))[..., 0]
    row = np.linalg.inv(normal)[:, 0]
    weight = (row[:, None, :] @ design)[:, 0]
    lag = (np.arange(m)[:, None] - np.arange(m)) * step
    rho = _spline(lag[None] * samplers.direction[:, 0, None, None]) * _spline(
        lag[None] * samplers.direction[:, 1, None, None]
    )
    variance = np.einsum("ni,nij,nj->n", weight, rho, weight) + (row[:, 1:] ** 2 * ridge[:, 1:]).sum(axis=1)
    left = ((r - (solution[:, None, :] @ design)[:, 0]) ** 2 * (design[:, 1] + design[:, 4] > 0)).sum(axis=1)
    misfit = left / np.maximum(seen.sum(axis=1) - 3, 1) * (9.0 / 4.0)
    return np.where(flat, 0.0, solution[:, 0]), np.where(flat, np.inf, variance), np.where(flat, np.inf, misfit)


def _spline(d: Float[np.ndarray, "n m m"]) -> Float[np.ndarray, "n m m"]:
    d = np.abs(d)
    return np.where(d < 1.0, 2.0 / 3.0 - d * d * (1.0 - 0.5 * d), np.where(d < 2.0, (2.0 - d) ** 3 / 6.0, 0.0))


def search(
    image: Profiles,
    templates: Templates,
    reach: Float[np.ndarray, " n"],
    predicted: Float[np.ndarray, " n"],
    scale2: float,
) -> tuple[
    Int[np.ndarray, " n"],
    Float[np.ndarray, " n"],
    Float[np.ndarray, " n"],
    Int[np.ndarray, " n"],
    Float[np.ndarray, " k"],
]:
    """The best shift of every profile: its index, cost, the template's contrast, its visible samples; and all shifts.

    Grey levels off the template by their spread are common to a whole profile, so a profile counts as a few samples
    only; a far valley must be better by as much as the prediction makes it unlikely.
    """
    n = templates.values.shape[0]
    shift = _shifts(image, templates)
    best, used = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    lowest, rise = np.empty(n), np.empty(n)
    _kernels.search_valleys(
        image.values,
        image.inside,
        templates.values,
        templates.visible,
        shift,
        reach,
        predicted,
        scale2,
        _SAMPLES,
        best,
        lowest,
        rise,
        used,
    )
    return best, lowest, rise, used, shift


def search_numpy(
    image: Profiles,
    templates: Templates,
    reach: Float[np.ndarray, " n"],
    predicted: Float[np.ndarray, " n"],
    scale2: float,
) -> tuple[
    Int[np.ndarray, " n"],
    Float[np.ndarray, " n"],
    Float[np.ndarray, " n"],
    Int[np.ndarray, " n"],
    Float[np.ndarray, " k"],
]:
    """The same as `search` in plain NumPy: the twin of the compiled kernel."""
    shift = _shifts(image, templates)
    used = templates.visible.sum(axis=1)
    weight = np.clip(used, 1, _SAMPLES)[:, None] / scale2
    cost = curves_numpy(image, templates) * weight + (shift / predicted[:, None]) ** 2
    cost = np.where(np.abs(shift) <= reach[:, None] + 1e-9, cost, np.inf)
    best = np.where(np.isfinite(cost).any(axis=1), np.argmin(cost, axis=1), 0)
    top = np.where(templates.visible, templates.values, -np.inf).max(axis=1)
    low = np.where(templates.visible, templates.values, np.inf).min(axis=1)
    rise = np.where(top > low, top - low, 0.0)
    return best, np.min(cost, axis=1), rise, used, shift


def _shifts(image: Profiles, templates: Templates) -> Float[np.ndarray, " k"]:
    """Shifts in pixels: the profile's samples k to k + m stand for shift k, and shift 0 is where both start alike."""
    step = float(templates.u[1] - templates.u[0])
    middle = round(float(templates.u[0] - image.u[0]) / step)
    return (np.arange(image.values.shape[1] - templates.values.shape[1] + 1) - middle) * step


def find_edges(
    samplers: Samplers,
    templates: Templates,
    image: Profiles,
    reach: Float[np.ndarray, " n"],
    predicted: Float[np.ndarray, " n"],
    noise: float,
    spread: float,
) -> EdgePoints:
    """The edge on each sampler: the lowest point of its WSSD curve within reach, refined.

    Parameters
    ----------
    image : Profiles
        At the same distance of samples as the templates, symmetric about u = 0, longer on both sides.
    reach : (n,)
        How far from u = 0 the edge is searched, pixels.
    predicted : (n,)
        Standard deviation of the predicted edge, pixels: far valleys must be that much better.
    noise, spread : float
        Standard deviation of the pixels' noise, and of grey levels about the template.
    """
    n = templates.state.size
    offset, sigma, misfit, reason = np.empty(n), np.empty(n), np.empty(n), np.empty(n, dtype=np.int64)
    _kernels.find_edges(
        image.values,
        image.inside,
        (templates.values, templates.parts, templates.visible, templates.state),
        _shifts(image, templates),
        samplers.direction,
        reach,
        predicted,
        noise,
        spread,
        _RIDGE_SHAPE,
        (_SAMPLES, _FORGIVEN, _INTERPOLATION_FLOOR, _LEAST_SAMPLES, _MOST_RAW, _MOST_MISFIT),
        offset,
        sigma,
        reason,
        misfit,
    )
    return EdgePoints(samplers.origin + offset[:, None] * samplers.direction, offset, sigma, reason, misfit)


def find_edges_numpy(
    samplers: Samplers,
    templates: Templates,
    image: Profiles,
    reach: Float[np.ndarray, " n"],
    predicted: Float[np.ndarray, " n"],
    noise: float,
    spread: float,
) -> EdgePoints:
    """The same as `find_edges` in plain NumPy: the twin of the compiled kernel."""
    step = float(templates.u[1] - templates.u[0])
    best, lowest, rise, used, shift = search_numpy(image, templates, reach, predicted, max(spread, noise) ** 2)
    tolerance = np.maximum(_FORGIVEN * rise, noise)
    ridge = (noise / tolerance)[:, None] ** 2 * _RIDGE_SHAPE
    fine, variance, left = refine_numpy(image, templates, best, samplers, step, ridge)
    offset = shift[best] + np.clip(fine, -step, step)
    misfit = left / noise**2
    sigma = np.sqrt(variance * noise**2 * np.maximum(1.0, misfit / 4.0) + _INTERPOLATION_FLOOR**2)
    weight = np.clip(used, 1, _SAMPLES) / max(spread, noise) ** 2
    raw = (lowest - (shift[best] / predicted) ** 2) / weight
    at_end = np.abs(shift[best]) > reach - 0.5 * step
    reason = _reasons(templates, raw, rise, sigma, left, at_end, noise, used)
    found = reason == FOUND
    sigma = np.where(found, sigma, np.inf)
    offset = np.where(found, offset, 0.0)
    return EdgePoints(samplers.origin + offset[:, None] * samplers.direction, offset, sigma, reason, misfit)


def _reasons(
    templates: Templates,
    raw: Float[np.ndarray, " n"],
    rise: Float[np.ndarray, " n"],
    sigma: Float[np.ndarray, " n"],
    left: Float[np.ndarray, " n"],
    at_end: Bool[np.ndarray, " n"],
    noise: float,
    used: Int[np.ndarray, " n"],
) -> Int[np.ndarray, " n"]:
    """Why a profile gives no edge, the first of the tests that it fails."""
    reason = np.full(raw.size, FOUND)
    unlike = (left > _MOST_MISFIT * rise**2 + 9.0 * noise**2) | (raw > _MOST_RAW * rise**2 + 9.0 * noise**2)
    reason[unlike] = MISFIT
    reason[at_end] = BORDER
    reason[~(sigma < 1.5) | (rise < 4.0 * noise)] = FLAT
    reason[~np.isfinite(raw)] = OUTSIDE
    reason[(templates.state == EXPECTED) & (used < _LEAST_SAMPLES)] = HIDDEN
    reason[templates.state == STATE_HIDDEN] = HIDDEN
    reason[(templates.state != EXPECTED) & (templates.state != STATE_HIDDEN)] = JOINT
    return reason
