"""Images and a pose close to the right one in, the pose that aligns every pixel of the surface out.

Gauss-Newton steps on residuals of all pixels (`surface.dense`) and the prediction. As in `handtrack.refine`, light and
gains are solved for with the pose and eliminated, single pixels that do not fit get robust weights, and what the
appearance cannot express is an error that all pixels of a patch share, its size estimated from the residuals.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..camera import Camera
from ..robust import cauchy_weight, median
from ..scatter import Whitener
from .dense import LIGHTS, Dense, dense_rows
from .shading import SurfaceAppearance
from .skin import Surface

_STEPS = 5
_REST = 0.5  # of a sigma in each joint: a step at which the pose rests
_GAIN_SIGMA = 0.02  # of each region's gain
_LIGHT_SIGMA = 3.0  # grey levels, of each coefficient of the shading
_LEAST_PIXELS = 60
_REWEIGHED = 2
_SHRINK = 0.1  # of the covariance, with each step
_MOST_SPREAD = 4.0
_LEAST_S, _CUT = 0.8, 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """An aligned pose.

    Attributes
    ----------
    u, information : (k,), (k, k)
        Free joints, and what the images alone say of them.
    residual : float
        Root mean square of the pixels' residuals in units of the noise.
    """

    u: Float[np.ndarray, " k"]
    information: Float[np.ndarray, "k k"]
    residual: float


def align(
    images: Sequence[Float[np.ndarray, "h w"]],
    surface: Surface,
    cameras: Sequence[Camera],
    appearance: Sequence[SurfaceAppearance],
    u: Float[np.ndarray, " k"],
    mean: Float[np.ndarray, " k"],
    prior: Float[np.ndarray, "k k"],
    covariance: Float[np.ndarray, "k k"],
    stride: int = 3,
    steps: int = _STEPS,
) -> Aligned:
    """Align all views in one solve.

    Parameters
    ----------
    u : (k,)
        Pose from the edges, within a pixel or two of the right one.
    mean, prior : (k,), (k, k)
        Prediction and its information.
    covariance : (k, k)
        How far off u may be: residuals that this explains are no outliers.
    stride : int
        Inside the surface one pixel in `stride` along rows and columns is taken.
    """
    limits = surface.model.limits[surface.model.free]
    views = list(zip(images, cameras, appearance, strict=True))
    A, residual = np.zeros_like(prior), 0.0
    for _ in range(steps):
        g, A, residual = _normal_equations(views, surface, u, stride, covariance)
        g, both = g + prior @ (u - mean), A + prior
        free = ~((u <= limits[:, 0]) & (g > 0.0) | (u >= limits[:, 1]) & (g < 0.0))
        h = np.zeros(u.size)
        h[free] = -np.linalg.solve(both[np.ix_(free, free)], g[free])
        u = np.clip(u + h, limits[:, 0], limits[:, 1])
        covariance = _SHRINK * covariance
        if h @ both @ h < _REST**2 * u.size:
            break
    return Aligned(u, A, residual)


def _normal_equations(
    views: Sequence[tuple[Float[np.ndarray, "h w"], Camera, SurfaceAppearance]],
    surface: Surface,
    u: Float[np.ndarray, " k"],
    stride: int,
    covariance: Float[np.ndarray, "k k"],
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"], float]:
    """Gradient and matrix of the pixels of all views, and the root mean square of their residuals."""
    g, A, squares, count = np.zeros(u.size), np.zeros((u.size, u.size)), 0.0, 0
    for image, camera, appearance in views:
        rows = dense_rows(image, surface, camera, u, appearance, stride)
        if rows.r.size < _LEAST_PIXELS:
            continue
        its_g, its_A = _eliminated(rows, _known(surface), covariance)
        g, A = g + its_g, A + its_A
        squares, count = squares + float((rows.r**2).sum()), count + rows.r.size
    return g, A, float(np.sqrt(squares / max(count, 1)))


def _known(surface: Surface) -> Float[np.ndarray, " m"]:
    """Information on the coefficients of the shading, the light's share and the gains, from earlier frames."""
    sigma = np.full(LIGHTS + surface.finger.size, _LIGHT_SIGMA)
    sigma[LIGHTS:] = _GAIN_SIGMA
    return sigma**-2.0


def _eliminated(
    rows: Dense, known: Float[np.ndarray, " m"], covariance: Float[np.ndarray, "k k"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """Gradient and matrix of one view with light and gains solved for.

    Weights and scatter are those of what pose and light together leave of the residuals: a pose that is off must not
    look like outliers, nor like errors that patches share.
    """
    k = rows.J.shape[1]
    both = np.hstack([rows.J, rows.B])
    prior = np.zeros((k + known.size, k + known.size))
    prior[:k, :k] = np.linalg.inv(covariance)
    prior[range(k, prior.shape[0]), range(k, prior.shape[0])] = known
    spread = np.sqrt(_own_spread(rows.r, rows.kind) ** 2 + ((rows.J @ covariance) * rows.J).sum(axis=1))
    weight = cauchy_weight(rows.r / spread)
    for _ in range(_REWEIGHED):
        weighted = both * weight[:, None]
        left = rows.r - both @ np.linalg.solve(weighted.T @ both + prior, weighted.T @ rows.r)
        weight = cauchy_weight(left / _own_spread(left, rows.kind))
    weight = np.sqrt(weight)
    s, tau = patch_scatter(weight * left, rows.patch, rows.kind)
    white, scale = Whitener(1.0, rows.patch, *_patches(rows, s, tau)), weight / s
    r, both = white(scale * rows.r, scale[:, None] * both)
    J, B = both[:, :k], both[:, k:]
    K = B.T @ B
    K[range(known.size), range(known.size)] += known
    BJ, Br = B.T @ J, B.T @ r
    solved = np.linalg.solve(K, np.column_stack([BJ, Br]))
    return J.T @ r - BJ.T @ solved[:, -1], J.T @ J - BJ.T @ solved[:, :-1]


def _own_spread(r: Float[np.ndarray, " n"], kind: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Robust scatter of the residuals of each kind of pixel, at least that of the noise."""
    out = np.ones(r.size)
    for which in np.unique(kind):
        at = kind == which
        out[at] = min(max(1.0, 1.4826 * median(np.abs(r[at]))), _MOST_SPREAD)
    return out


def _patches(
    rows: Dense, s: Float[np.ndarray, " n"], tau: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " p"]]:
    """Unit vector and share of each patch's common error, its size differing by kind of pixel."""
    count = np.bincount(rows.patch).astype(float)
    of_patch = np.zeros(count.size)
    of_patch[rows.patch] = tau / s
    return (1.0 / np.sqrt(count))[rows.patch], 1.0 - 1.0 / np.sqrt(1.0 + of_patch**2 * count)


def patch_scatter(
    r: Float[np.ndarray, " n"], patch: Int[np.ndarray, " n"], kind: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """For each pixel: scatter within and between patches of its kind, in units of the noise (method of moments)."""
    s, tau = np.ones(r.size), np.zeros(r.size)
    for which in np.unique(kind):
        at = kind == which
        s[at], tau[at] = _scatter_of(r[at], patch[at])
    return s, tau


def _scatter_of(r: Float[np.ndarray, " n"], patch: Int[np.ndarray, " n"]) -> tuple[float, float]:
    _, member, count = np.unique(patch, return_inverse=True, return_counts=True)
    member = member.reshape(-1)
    cut = _CUT * 1.4826 * median(np.abs(r))
    r = np.clip(r, -cut, cut)
    mean = np.bincount(member, r) / count
    within = float(((r - mean[member]) ** 2).sum() / max(r.size - count.size, 1))
    s = max(float(np.sqrt(within)), _LEAST_S)
    full: Bool[np.ndarray, " p"] = count >= 4
    if full.sum() < 4:
        return s, 0.0
    between = float((mean[full] ** 2).mean())
    return s, float(np.sqrt(max(between - s * s * float((1.0 / count[full]).mean()), 0.0)))
