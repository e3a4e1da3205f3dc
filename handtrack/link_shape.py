"""A model and changes of its links' shapes in, the changed model out; and what shape does to outline residuals.

Seven parameters each: length (what sits on the end moves with it), the two radii, and the offsets of the two ends
along y and z of the link's frame.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .kinematics import LinkSigmas, Model, forward, link_ends, pose_from_free
from .pills import Pills, clearance
from .residuals import OutlineFeatures

PARAMETERS = 7  # of a link: length, radius at base and tip, offsets y and z of the base and of the tip


def reshaped(model: Model, shape: Float[np.ndarray, "l 7"]) -> Model:
    """The model with each link's shape changed; what sits at a link's end moves with its length."""
    prefix, along = model.prefix.copy(), np.array([1.0, 0.0, 0.0])
    for link, frame in enumerate(model.link_frame):
        prefix[model.parent == frame, :3, 3] += shape[link, 0] * along
    base, tip = model.link_base.copy(), model.link_tip.copy()
    tip[:, 0] += shape[:, 0]
    base[:, 1:] += shape[:, 3:5]
    tip[:, 1:] += shape[:, 5:7]
    radius = np.maximum(model.link_radius + shape[:, 1:3], 0.2 * model.link_radius)
    return replace(
        model,
        prefix=prefix,
        link_length=model.link_length + shape[:, 0],
        link_base=base,
        link_tip=tip,
        link_radius=radius,
    )


def shape_rows(model: Model, features: OutlineFeatures, u: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n p"]:
    """Derivative of `outline_residuals` by all links' shapes, link after link, in units of sigma."""
    frames = forward(model, pose_from_free(model, u))
    base, tip = link_ends(model, frames)
    link, n = features.link, features.link.size
    seen = clearance(Pills(base, tip, model.link_radius), link, features.ray[:, :3], features.ray[:, 3:])
    spread = features.slope[:, :3] + seen.depth[:, None] * features.slope[:, 3:]
    scale = 1.0 / (np.maximum(np.abs((seen.normal * spread).sum(axis=1)), 1e-9) * features.sigma)
    axes = frames[model.link_frame, :3, :3]
    own = np.einsum("na,nab->nb", seen.normal, axes[link])  # the outward normal in the axes of the own link
    s = seen.along
    H = np.zeros((n, model.link_frame.size, PARAMETERS))
    at = np.arange(n)
    H[at, link, 0] = -s * own[:, 0]
    H[at, link, 1], H[at, link, 2] = s - 1.0, -s
    H[at, link, 3:5] = -(1.0 - s)[:, None] * own[:, 1:]
    H[at, link, 5:7] = -s[:, None] * own[:, 1:]
    carried = ancestors(model)[link]
    H[:, :, 0] -= carried * (seen.normal @ axes[:, :, 0].T)
    return (H * scale[:, None, None]).reshape(n, -1)


def ancestors(model: Model) -> Float[np.ndarray, "l l"]:
    """1 where the first link sits, over any number of frames, on the end of the second."""
    carried = np.zeros((model.link_frame.size, model.link_frame.size))
    number = {int(frame): link for link, frame in enumerate(model.link_frame)}
    for link, frame in enumerate(model.link_frame):
        above = int(model.parent[frame])
        while above >= 0:
            if above in number:
                carried[link, number[above]] = 1.0
            above = int(model.parent[above])
    return carried


def sigmas_from_covariance(covariance: Float[np.ndarray, "n n"]) -> tuple[LinkSigmas, ...]:
    """Standard deviations of every link's shape as a model file holds them, from the covariance of all parameters."""
    rows = np.sqrt(np.diag(covariance)).reshape(-1, PARAMETERS).tolist()
    return tuple(LinkSigmas(length, (r0, r1), (0.0, by, bz), (0.0, ty, tz)) for length, r0, r1, by, bz, ty, tz in rows)


def shape_sigmas(model: Model) -> Float[np.ndarray, " p"]:
    """Standard deviations of all links' parameters; zero where the model takes its shape as exact."""
    known = [sigmas or LinkSigmas() for sigmas in model.link_sigmas]
    rows = [(one.length, *one.radius, *one.base_offset[1:], *one.tip_offset[1:]) for one in known]
    return np.array(rows, dtype=float).ravel()


def shape_root(model: Model) -> Float[np.ndarray, "p m"]:
    """A root R of the covariance `R R^T` of all links' parameters; no columns where the shape is taken as exact."""
    if model.shape_factor is not None:
        return model.shape_factor
    sigma = shape_sigmas(model)
    return np.diag(sigma)[:, sigma > 0.0]


def factor_of(covariance: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Lower triangular F with `F F^T` the covariance, in six digits, as a model file holds it.

    >>> factor_of(np.array([[4.0, 2.0], [2.0, 2.0]])).tolist()
    [[2.0, 0.0], [1.0, 1.0]]
    """
    factor = np.linalg.cholesky(covariance)
    return np.array([[float(f"{x:.6g}") for x in row] for row in factor.tolist()])
