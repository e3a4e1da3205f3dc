"""Residuals of solved frames in, how wrong the model's shape may be out, and what that does to the pose.

A model whose lengths, radii or positions are off by a few per cent leaves residuals, but most of its error goes into
the pose, where no residual shows it. So shape is a set of nuisance parameters: relative length, relative radius and
sideways offset (in radii) of every link, partly common to all links, each with standard deviation eps. The evidence
for eps,

    log p(r | eps) = 1/2 sum_i [ eps^2 b_i^2 / (1 + eps^2 l_i) - log(1 + eps^2 l_i) ]

with l, b from the eigenvectors of `H^T Q H`, H the derivative of the whitened residuals by the shape and Q what the
solve leaves of them, is summed over frames; the best eps widens the covariance of the pose by `K H eps^2 (K H)^T`. A
right model keeps eps near zero and its sigmas tight.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from . import _kernels
from .camera import project_with_jacobian
from .kinematics import Model, forward, link_ends, pose_from_free
from .pills import Pills, clearance
from .residuals import Chain, LineFeatures, OutlineFeatures

EPS = np.array([0.0, 0.001, 0.002, 0.004, 0.007, 0.01, 0.014, 0.02, 0.03, 0.045, 0.07, 0.1, 0.15])
_COMMON = 0.5  # share of the variance that all links have in common: a larger hand has longer links everywhere
_MEMORY = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class ShapeError:
    """Evidence for each value of EPS, and the standard deviation of shape parameters that follows."""

    evidence: Float[np.ndarray, " e"]
    eps: float


def first_shape_error() -> ShapeError:
    """Before any frame: two per mille, the error of a model measured well."""
    return ShapeError(-((EPS / 0.002) ** 2) * 0.05, 0.002)


def shape_jacobian(
    on: Chain, features: OutlineFeatures | LineFeatures, u: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "n p"]:
    """Derivative of the residuals, in units of their sigma, by the independent shape errors of the model."""
    frames = forward(on.model, pose_from_free(on.model, u))
    base, tip = link_ends(on.model, frames)
    share = _length_shares(on.model)
    if not isinstance(features, OutlineFeatures):
        return _line_jacobian(on, features, base, tip - base, share)
    H = np.empty((features.link.size, 3 * share.shape[0] + 2))
    ends, sight = np.hstack([base, tip - base]), np.ascontiguousarray(on.camera.R[2])
    edges = features.ray, features.slope, features.link, features.sigma
    _kernels.shape_columns(*edges, ends, on.model.link_radius, share, sight, H)
    return H


def shape_jacobian_numpy(on: Chain, features: OutlineFeatures, u: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n p"]:
    """The same as `shape_jacobian` of outlines in plain NumPy: the twin of the compiled kernel."""
    base, tip = link_ends(on.model, forward(on.model, pose_from_free(on.model, u)))
    axis, share, link = tip - base, _length_shares(on.model), features.link
    pills = Pills(base, tip, on.model.link_radius)
    seen = clearance(pills, link, features.ray[:, :3], features.ray[:, 3:])
    spread = features.slope[:, :3] + seen.depth[:, None] * features.slope[:, 3:]
    per_pixel = np.maximum(np.abs((seen.normal * spread).sum(axis=1)), 1e-9)
    scale = -1.0 / (per_pixel * features.sigma)
    moved = seen.normal @ axis.T
    own = np.arange(axis.shape[0]) == link[:, None]
    length = moved * np.where(own, seen.along[:, None], share[link])
    radius = pills.radius[link, 0] + seen.along * (pills.radius[link, 1] - pills.radius[link, 0])
    across = np.cross(axis, on.camera.R[2])[link]
    across = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    towards = (seen.normal * across).sum(axis=1)
    kinds = [length, own * radius[:, None], own * (radius * towards)[:, None]]
    return np.hstack([_with_common(kind * scale[:, None]) for kind in kinds[:2]] + [kinds[2] * scale[:, None]])


def _line_jacobian(on: Chain, features: LineFeatures, base, axis, share) -> Float[np.ndarray, "n p"]:
    """Only lengths move an axis or a tip."""
    link = np.concatenate([features.tip_link, np.repeat(features.line_link, 2)])
    along = np.concatenate([np.ones(features.tip_link.size), features.along.reshape(-1)])
    points = base[link] + along[:, None] * axis[link]
    _, d_xy = project_with_jacobian(on.camera, points)
    own = np.arange(axis.shape[0]) == link[:, None]
    moved = (d_xy @ axis.T) * np.where(own, along[:, None], share[link])[:, None, :]
    m = features.tip_link.size
    tips = (moved[:m] / features.tip_sigma[:, None, None]).reshape(2 * m, axis.shape[0])
    normal = np.repeat(features.line[:, :2], 2, axis=0)[:, None, :]
    lines = (normal @ moved[m:])[:, 0] / features.line_sigma.reshape(-1, 1)
    return _with_common(np.concatenate([tips, lines]))


@lru_cache(maxsize=16)
def _length_shares(model: Model) -> Float[np.ndarray, "l l"]:
    """1 where a link's base moves with the length of another: that other is one of its ancestors."""
    share = np.zeros((model.link_frame.size, model.link_frame.size))
    for link, parent in enumerate(model.link_parent):
        if parent >= 0:
            share[link] = share[parent]
            share[link, parent] = 1.0
    return share


def _with_common(each: Float[np.ndarray, "n l"]) -> Float[np.ndarray, "n m"]:
    """Split each link's error into an own part and one that all share."""
    return np.hstack([np.sqrt(1.0 - _COMMON) * each, np.sqrt(_COMMON) * each.sum(axis=1, keepdims=True)])


def learn_shape_error(
    shape: ShapeError,
    r: Float[np.ndarray, " n"],
    H: Float[np.ndarray, "n p"],
    J: Float[np.ndarray, "n k"],
    covariance: Float[np.ndarray, "k k"],
) -> tuple[ShapeError, Float[np.ndarray, " p"]]:
    """Blend one frame's evidence in.

    Parameters
    ----------
    r, H, J : (n,), (n, p), (n, k)
        Whitened residuals at the solution, their derivatives by shape and by pose.
    covariance : (k, k)
        Of the solution.

    Returns
    -------
    ShapeError, (p,)
        And the shape errors this frame's residuals suggest.
    """
    JH = J.T @ H
    A = H.T @ H - JH.T @ covariance @ JH
    b = -(H.T @ r - JH.T @ (covariance @ (J.T @ r)))
    size, vectors = np.linalg.eigh(A)
    size, along = np.maximum(size, 0.0), vectors.T @ b
    e2 = EPS[:, None] ** 2
    gain = e2 * size
    evidence = 0.5 * (e2 * along**2 / (1.0 + gain) - np.log1p(gain)).sum(axis=1)
    evidence = _MEMORY * shape.evidence + evidence
    weight = np.exp(evidence - evidence.max())
    eps = float(np.sqrt((weight * EPS**2).sum() / weight.sum()))
    suggested = vectors @ (eps**2 * along / (1.0 + eps**2 * size))
    return ShapeError(evidence, eps), suggested
