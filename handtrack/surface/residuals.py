"""Edge points attached to a skinned surface and a pose in, residuals in units of their sigma and the Jacobian out.

    r_i = n_i . (e_i - project(p_i(q))) / sigma_i,      dr_i/dq = -n_i . dproject . dp_i/dq / sigma_i

with p_i the attached point, posed anew at every q (only the vertices of its mesh edge are), e_i the edge point and n_i
the direction of its sampler.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..camera import Camera, project_with_jacobian
from ..kinematics import forward, link_ends, pose_from_free
from ..residuals import Rows
from .skin import Surface, edge_points

_COMMON = 0.5  # share of the variance of shape errors that all links have in common, as in `handtrack.shape_error`


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceFeatures:
    """Edge points of one view and the surface points they were searched from.

    Attributes
    ----------
    vertex, share : (n, 2), (n,)
        The attached point, `(1 - share) v_0 + share v_1`.
    xy, direction : (n, 2), (n, 2)
        Edge point, pixels, and unit vector outwards along its sampler.
    link, sigma : (n,), (n,)
        Nearest link, and standard deviation along the direction, pixels.
    """

    vertex: Int[np.ndarray, "n 2"]
    share: Float[np.ndarray, " n"]
    xy: Float[np.ndarray, "n 2"]
    direction: Float[np.ndarray, "n 2"]
    link: Int[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]


def surface_residuals(
    surface: Surface, camera: Camera, features: SurfaceFeatures, u: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n k"]]:
    """Signed distances of edge points from the outline in units of sigma (positive outside), and their Jacobian."""
    p, dp = edge_points(surface, features.vertex, features.share, u)
    xy, d_xy = project_with_jacobian(camera, p)
    across = features.direction / features.sigma[:, None]
    r = (across * (features.xy - xy)).sum(axis=1)
    return r, -((across[:, None, :] @ d_xy) @ dp)[:, 0, :]


def surface_rows(
    surface: Surface, camera: Camera, features: SurfaceFeatures, side: Int[np.ndarray, " n"] | None = None
) -> Rows:
    """Features as residual rows; one side of a link (+1, -1; 0 for a tip) is one group of errors with one cause."""
    key = 3 * features.link + (0 if side is None else side) + 1
    occurs = np.bincount(key) > 0
    group = (np.cumsum(occurs) - 1)[key]
    return Rows(lambda u: surface_residuals(surface, camera, features, u), features.sigma, group)


def surface_shape_jacobian(
    surface: Surface, camera: Camera, features: SurfaceFeatures, u: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "n p"]:
    """Derivative of the residuals by the errors a surface may have: the same shape parameters as those of pills.

    Relative length of every link (it carries what hangs on it along), relative thickness and sideways offset of every
    link; half of the variance of lengths and of thicknesses is common to all.
    """
    model, link = surface.model, features.link
    p, _ = edge_points(surface, features.vertex, features.share, u)
    _, d_xy = project_with_jacobian(camera, p)
    per_mm = -((features.direction / features.sigma[:, None])[:, None, :] @ d_xy)[:, 0, :]
    base, tip = link_ends(model, forward(model, pose_from_free(model, u)))
    axis = tip - base
    along = ((p - base[link]) * axis[link]).sum(axis=1) / np.maximum((axis * axis).sum(axis=1), 1e-9)[link]
    out = p - base[link] - np.clip(along, 0.0, 1.0)[:, None] * axis[link]
    radius = np.linalg.norm(out, axis=1)
    own = np.arange(base.shape[0]) == link[:, None]
    length = (per_mm @ axis.T) * np.where(own, np.clip(along, 0.0, 1.0)[:, None], _carried(model)[link])
    thickness = own * (per_mm * out).sum(axis=1)[:, None]
    sight = p + camera.R.T @ camera.t if camera.kind == "perspective" else np.broadcast_to(camera.R[2], p.shape)
    across = np.cross(axis[link], sight)
    across = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    sideways = own * (radius * (per_mm * across).sum(axis=1))[:, None]
    return np.hstack([_with_common(length), _with_common(thickness), sideways])


def _carried(model) -> Float[np.ndarray, "l l"]:
    """1 where a link's base moves with the length of another."""
    share = np.zeros((model.link_frame.size, model.link_frame.size))
    for link, parent in enumerate(model.link_parent):
        if parent >= 0:
            share[link] = share[parent]
            share[link, parent] = 1.0
    return share


def _with_common(each: Float[np.ndarray, "n l"]) -> Float[np.ndarray, "n m"]:
    return np.hstack([np.sqrt(1.0 - _COMMON) * each, np.sqrt(_COMMON) * each.sum(axis=1, keepdims=True)])
