"""A posed mesh in, samplers on its outline out.

The outline runs along edges of the mesh between a triangle that faces the camera and one that does not (or beside
none). Samplers stand on these edges some pixels apart, kept off the corners, and look across them, away from the
triangle that faces the camera. Most of such edges are inside the silhouette or hidden; `surface.templates` tells which
of the samplers should see a step.

A sampler is attached to its place on the mesh edge. An edge point e found along it gives the residual

    d = n . (e - project(p(q))),      dd/dq = -n . dproject . dp/dq

with p the attached point and n the sampler's direction: that the outline moves on to other points of the surface as
the pose changes does not matter to first order, because the surface is tangent to the line of sight there (the
envelope theorem); the next look attaches anew.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .._kernels import raster as kernels
from ..camera import Camera, project_camera
from ..kinematics import forward, link_ends, pose_from_free
from ..profiles import CAP, SIDE, Samplers, with_rays
from .raster import Projected
from .skin import Skin, Surface

_MOST = 4096  # samplers


@dataclass(frozen=True, slots=True, eq=False)
class Attached:
    """Where samplers stand on the mesh: `(1 - share) v_0 + share v_1` on the edge between two vertices.

    Attributes
    ----------
    vertex, share : (n, 2), (n,)
    region, triangle : (n,), (n,)
        Region of the surface, and the triangle beside the edge that faces the camera.
    """

    vertex: Int[np.ndarray, "n 2"]
    share: Float[np.ndarray, " n"]
    region: Int[np.ndarray, " n"]
    triangle: Int[np.ndarray, " n"]


def contour_places(
    surface: Surface, mesh: Projected, spacing: float, corner: float = 2.0
) -> tuple[Attached, Float[np.ndarray, " n"]]:
    """Places on contour edges of the mesh about `spacing` pixels apart, hidden ones included, and the length of each.

    Parts of the outline shorter than half the spacing get none.

    Parameters
    ----------
    corner : float
        How far to keep from the ends of mesh edges, where the outline bends, pixels.
    """
    room = _MOST if spacing > 2.0 else 8 * _MOST
    edge, share, length = np.empty(room, dtype=np.int64), np.empty(room), np.empty(room)
    count = np.empty(mesh.xy.shape[0], dtype=np.int64)
    beside = np.empty((mesh.xy.shape[0], 8), dtype=np.int64)
    n = kernels.walk_contours(
        mesh.xy, surface.edge, surface.edge_side, mesh.area, spacing, corner, edge, share, length, beside, count
    )
    edge, share, length = edge[:n], share[:n], length[:n]
    side = surface.edge_side[edge]
    second = (side[:, 1] >= 0) & (mesh.area[side[:, 1]] < 0.0)
    triangle = np.where(second, side[:, 1], side[:, 0])
    vertex = surface.edge[edge]
    if mesh.pinhole:  # the place was chosen in the image
        far, near = mesh.inverse[vertex[:, 1]], mesh.inverse[vertex[:, 0]]
        share = share * far / (share * far + (1.0 - share) * near)
    return Attached(vertex, share, surface.region[triangle], triangle), length


def contour_edges_numpy(surface: Surface, mesh: Projected) -> Bool[np.ndarray, " e"]:
    """Which edges of the mesh the outline may run along, in plain NumPy: what the compiled walk visits."""
    front = mesh.area < 0.0
    first, second = surface.edge_side.T
    return np.where(second < 0, mesh.area[first] != 0.0, front[first] != front[second])


def place_contour(
    surface: Surface, skin: Skin, mesh: Projected, camera: Camera, u: Float[np.ndarray, " k"], at: Attached
) -> Samplers:
    """Samplers at attached places: origin on the mesh edge, direction across it, outwards.

    `link` is the nearest link, `along` the axial position on it; places beyond the end of a finger count as tips.
    """
    a, b = mesh.xy[at.vertex[:, 0]], mesh.xy[at.vertex[:, 1]]
    contact = (1.0 - at.share)[:, None] * skin.p[at.vertex[:, 0]] + at.share[:, None] * skin.p[at.vertex[:, 1]]
    along_edge = b - a
    across = np.stack([-along_edge[:, 1], along_edge[:, 0]], axis=1)
    across = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    middle = mesh.xy[mesh.triangles[at.triangle]].mean(axis=1)
    inwards = ((middle - a) * across).sum(axis=1) > 0.0
    direction = np.where(inwards[:, None], -across, across)
    model, link = surface.model, surface.link[at.triangle]
    frames = forward(model, pose_from_free(model, u))
    base, tip = (ends @ camera.R.T + camera.t for ends in link_ends(model, frames))
    axis = (tip - base)[link]
    along = ((contact - base[link]) * axis).sum(axis=1) / np.maximum((axis * axis).sum(axis=1), 1e-9)
    turned = axis[:, 0] * direction[:, 1] - axis[:, 1] * direction[:, 0]
    cap = (along > 1.0) & model.link_is_tip[link]
    side = np.where(cap, 0, np.where(turned > 0.0, 1, -1))
    origin = project_camera(camera, contact)
    return with_rays(camera, origin, direction, link, np.clip(along, 0.0, 1.0), side, np.where(cap, CAP, SIDE), contact)
