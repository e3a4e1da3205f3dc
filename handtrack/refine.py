"""Images and an aligned pose in, a pose refined against edges and pixels together out (analysis by synthesis).

Three kinds of evidence go into one solve: the edges of a denser set of samplers, against the pill outline; the grey
levels of pixels well inside the visible surface, against the rendered shading; and the prediction. The light is not
taken as known: the coefficients of the shading and a gain for each link are solved for with the pose and eliminated,

    A = J^T J - J^T B (B^T B + L)^-1 B^T J,      g = J^T r - J^T B (B^T B + L)^-1 B^T r,

with B the derivative of the residuals by the coefficients and L what earlier frames say of them. What the shading
cannot express (a highlight, a crease, another colour) is met twice: single pixels by robust weights, regions by a
common error of every patch of surface, whose size is estimated from the residuals (`scatter`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .appearance import Appearance, harmonics
from .fit import Fit
from .pixels import Pixels, Shaded, pixel_rows
from .residuals import Chain, Rows
from .robust import cauchy_weight, median
from .scatter import Whitened, Whitener, common_share

_ROUNDS, _STEPS = 2, 2  # of fixed weights, and Gauss-Newton steps in each
_GAIN_SIGMA = 0.05  # of each link's gain
_LEAST_S, _CUT = 0.7, 4.0
_RIDGE = 1e-6
_LEAST_PIXELS = 60


@dataclass(frozen=True, slots=True, eq=False)
class Grey:
    """The pixels of one view as a quadratic in the pose, with light and gains eliminated: cost, gradient, matrix."""

    cost: float
    g: Float[np.ndarray, " k"]
    A: Float[np.ndarray, "k k"]


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """What is held fixed in one view while the pose takes its steps.

    Attributes
    ----------
    weight : (n,)
        Root of each pixel's robust weight.
    white : Whitener
        Of pixels in patches.
    basis : (n, m)
        Whitened derivative by the light and the gains, times an inverse root of its normal matrix.
    """

    weight: Float[np.ndarray, " n"]
    white: Whitener
    basis: Float[np.ndarray, "n m"]


def refine(
    on: Sequence[Chain],
    edges: Rows,
    white: Whitener,
    pixels: Sequence[Pixels],
    appearance: Sequence[Appearance],
    u: Float[np.ndarray, " k"],
    mean: Float[np.ndarray, " k"],
    prior: Float[np.ndarray, "k k"],
) -> Fit:
    """Align edges, pixels and prediction in one solve.

    Parameters
    ----------
    edges, white : Rows, Whitener
        Edge rows of all views.
    pixels, appearance : sequences
        Visible pixels and what is known of light and surface, one for each view.
    u : (k,)
        Pose from the edges alone.
    mean, prior : (k,), (k, k)
        Prediction and its information.

    Returns
    -------
    Fit
        Its residuals and Jacobian are those of the edges, its information that of edges and pixels.
    """
    whitened = Whitened(edges.residual, white)
    limits = on[0].model.limits[on[0].model.free]
    views = [view for view in zip(on, pixels, appearance, strict=True) if view[1].link.size >= _LEAST_PIXELS]
    for _ in range(_ROUNDS):
        r, _ = whitened(u)
        spread = max(1.0, 1.4826 * median(np.abs(r)))
        weight = cauchy_weight(r / spread) / spread**2
        lights = [_light(*view, u) for view in views]
        state = _normal_equations(whitened, weight, views, lights, u, mean, prior)
        for _ in range(_STEPS):
            u, state = _step(whitened, weight, views, lights, u, mean, prior, state, limits)
    r, J = whitened(u)
    spread = max(1.0, 1.4826 * median(np.abs(r)))
    weight = cauchy_weight(r / spread)
    information = (J * weight[:, None]).T @ J / spread**2
    for view in views:
        information = information + _grey(*view, _light(*view, u), u).A
    return Fit(u, r, J, weight, spread, information)


def _normal_equations(
    edges: Whitened,
    weight: Float[np.ndarray, " n"],
    views: Sequence[tuple[Chain, Pixels, Appearance]],
    lights: Sequence[Light],
    u: Float[np.ndarray, " k"],
    mean: Float[np.ndarray, " k"],
    prior: Float[np.ndarray, "k k"],
) -> Grey:
    r, J = edges(u)
    weighted, off = J * weight[:, None], u - mean
    cost = 0.5 * float((weight * r * r).sum() + off @ prior @ off)
    g, A = weighted.T @ r + prior @ off, weighted.T @ J + prior
    for view, light in zip(views, lights, strict=True):
        grey = _grey(*view, light, u)
        cost, g, A = cost + grey.cost, g + grey.g, A + grey.A
    return Grey(cost, g, A)


def _step(
    edges: Whitened,
    weight: Float[np.ndarray, " n"],
    views: Sequence[tuple[Chain, Pixels, Appearance]],
    lights: Sequence[Light],
    u: Float[np.ndarray, " k"],
    mean: Float[np.ndarray, " k"],
    prior: Float[np.ndarray, "k k"],
    state: Grey,
    limits: Float[np.ndarray, "k 2"],
) -> tuple[Float[np.ndarray, " k"], Grey]:
    """One Gauss-Newton step inside the limits, halved until the cost falls; none if it does not."""
    free = ~((u <= limits[:, 0]) & (state.g > 0.0) | (u >= limits[:, 1]) & (state.g < 0.0))
    h = np.zeros(u.size)
    h[free] = -np.linalg.solve(state.A[np.ix_(free, free)], state.g[free])
    for _ in range(4):
        trial = np.clip(u + h, limits[:, 0], limits[:, 1])
        following = _normal_equations(edges, weight, views, lights, trial, mean, prior)
        if following.cost <= state.cost:
            return trial, following
        h = 0.5 * h
    return u, state


def _light(on: Chain, pixels: Pixels, appearance: Appearance, u: Float[np.ndarray, " k"]) -> Light:
    """Weights, scatter and the eliminated directions at the pose u."""
    seen = pixel_rows(on, pixels, appearance, u)
    design = _design(on, pixels, appearance, seen)
    known = _known_of_light(on, appearance)
    r = seen.r - design @ np.linalg.solve(design.T @ design + known, design.T @ seen.r)
    weight = np.sqrt(cauchy_weight(r / max(1.0, 1.4826 * median(np.abs(r)))))
    s, tau = _patch_scatter(r, pixels, design.shape[1])
    ones = np.full(r.size, 1.0)
    white = Whitener(s, pixels.patch, *common_share(ones, pixels.patch, s, tau))
    basis = white(r, weight[:, None] * design)[1]
    root = np.linalg.cholesky(basis.T @ basis + known)
    return Light(weight, white, np.linalg.solve(root, basis.T).T)


def _design(on: Chain, pixels: Pixels, appearance: Appearance, seen: Shaded) -> Float[np.ndarray, "n m"]:
    """Derivative of the residuals by shading coefficients (light and polynomial) and by the logarithm of each gain."""
    light = appearance.shading[25:]
    size = float(np.linalg.norm(light))
    lit = np.maximum(seen.normal @ (light / size), 0.0) if size > 0.0 else np.zeros(seen.r.size)
    shading = np.column_stack([harmonics(seen.normal), lit]) * appearance.gain[pixels.link, None]
    own = pixels.link[:, None] == np.arange(on.model.link_frame.size)
    return -np.hstack([shading, own * seen.expected[:, None]]) / appearance.noise


def _known_of_light(on: Chain, appearance: Appearance) -> Float[np.ndarray, "m m"]:
    """Information on light and gains from earlier frames, as far as the scatter about the shading lets it count."""
    links, n = on.model.link_frame.size, appearance.normal_matrix.shape[0]
    known = np.zeros((n + links, n + links))
    known[:n, :n] = appearance.normal_matrix / max(appearance.spread, appearance.noise) ** 2
    known[range(n), range(n)] += _RIDGE
    known[range(n, n + links), range(n, n + links)] = _GAIN_SIGMA**-2
    return known


def _patch_scatter(r: Float[np.ndarray, " n"], pixels: Pixels, solved: int) -> tuple[float, float]:
    """Scatter of pixels about their patch, and of patches, both in units of the noise, by the method of moments."""
    r = np.clip(r, -_CUT * 1.4826 * median(np.abs(r)), _CUT * 1.4826 * median(np.abs(r)))
    count = np.bincount(pixels.patch).astype(float)
    mean = np.bincount(pixels.patch, r) / count
    within = float(((r - mean[pixels.patch]) ** 2).sum() / max(r.size - count.size, 1))
    s = max(np.sqrt(within), _LEAST_S)
    full = count >= 4
    if full.sum() < 4:
        return s, 0.0
    patches = float(full.sum())
    between = float((mean[full] ** 2).mean()) * patches / max(patches - min(solved, 0.6 * patches), 1.0)
    return s, float(np.sqrt(max(between - s * s * float((1.0 / count[full]).mean()), 0.0)))


def _grey(on: Chain, pixels: Pixels, appearance: Appearance, light: Light, u: Float[np.ndarray, " k"]) -> Grey:
    """The pixels' part of the normal equations at u."""
    seen = pixel_rows(on, pixels, appearance, u)
    r, J = light.white(light.weight * seen.r, light.weight[:, None] * seen.J)
    of_r, of_J = light.basis.T @ r, light.basis.T @ J
    return Grey(0.5 * float(r @ r - of_r @ of_r), J.T @ r - of_J.T @ of_r, J.T @ J - of_J.T @ of_J)
