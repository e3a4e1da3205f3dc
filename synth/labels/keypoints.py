"""Keypoints and solids in, their pixels, visibility and what hides them out, by one ray for each.

A keypoint lies inside the parts that meet there. It is seen where the first surface on its ray belongs to one of these,
or lies behind it; else the part of that surface hides it. With a rolling shutter a keypoint is where it was when its
own row was read.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int, UInt64

from handtrack.camera import Camera, project_camera, rays

from .. import _kernels
from .geometry import Geometry
from .labelled import HIDDEN, SEEN, UNSEEN
from .solids import Keypoints


def placed(
    keypoints: Sequence[Keypoints], camera: Camera, settle: int = 8
) -> tuple[Float[np.ndarray, "n k 3"], Float[np.ndarray, "n k 2"]]:
    """Keypoints in camera axes and in pixels, each at the instant at which its row is read."""
    p = np.stack([k.p_cam for k in keypoints])
    knots = p.shape[0]
    p_cam = p[knots // 2]
    xy = project_camera(camera, p_cam)
    for _ in range(settle if knots > 1 else 0):
        row = np.clip(np.where(np.isfinite(xy[..., 1]), xy[..., 1], 0.0), 0.0, camera.height - 1)
        at = row / max(camera.height - 1, 1) * (knots - 1)
        before = np.minimum(at.astype(np.int64), knots - 2)[None, ..., None]
        low = np.take_along_axis(p, before, axis=0)[0]
        high = np.take_along_axis(p, before + 1, axis=0)[0]
        p_cam = low + (at[..., None] - before[0]) * (high - low)
        xy = project_camera(camera, p_cam)
    return p_cam, xy


def visibility(
    p_cam: Float[np.ndarray, "n k 3"],
    xy: Float[np.ndarray, "n k 2"],
    own: UInt64[np.ndarray, "n k"],
    camera: Camera,
    geometry: Geometry,
) -> tuple[Int[np.ndarray, "n k"], Int[np.ndarray, "n k"]]:
    """Visibility (0 outside, 1 hidden, 2 seen) and the part that hides each keypoint (-1: none)."""
    visible, hidden_by = np.full(own.shape, UNSEEN, np.int64), np.full(own.shape, -1, np.int64)
    low, high = np.array([-0.5, -0.5]), np.array([camera.width - 0.5, camera.height - 0.5])
    with np.errstate(invalid="ignore"):
        inside = ((xy >= low) & (xy < high)).all(axis=-1)
    if not inside.any():
        return visible, hidden_by
    depth, surface = first_surfaces(xy[inside], camera, geometry)
    part = np.where(surface >= 0, geometry.part_of[surface], 0)
    mine = (own[inside] >> part.astype(np.uint64)) & np.uint64(1) == 1
    hidden = (surface >= 0) & ~mine & (depth < p_cam[inside][:, 2])
    visible[inside] = np.where(hidden, HIDDEN, SEEN)
    hidden_by[inside] = np.where(hidden, part, -1)
    return visible, hidden_by


def first_surfaces(
    xy: Float[np.ndarray, "n 2"], camera: Camera, geometry: Geometry
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Depth (inf) and number (-1) of the first surface on rays through image positions, against all surfaces."""
    origin, direction = rays(camera, xy)
    flat = direction[:, :2] if geometry.pinhole else origin[:, :2]
    row = np.clip(np.rint(xy[:, 1]).astype(np.int64) - geometry.span[2], 0, max(geometry.knot.size - 1, 0))
    depth, surface = np.full(xy.shape[0], np.inf), np.full(xy.shape[0], -1, np.int64)
    g = geometry
    if g.knot.size:
        _kernels.first_surfaces(
            flat[:, 0],
            flat[:, 1],
            row,
            g.pinhole,
            g.tables,
            g.pills,
            g.vertices,
            g.triangles,
            g.knot,
            g.blend,
            depth,
            surface,
        )
    return depth, surface
