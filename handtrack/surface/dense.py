"""An image, a surface at a pose and its appearance in, residuals of all its pixels and their Jacobian out.

The expected grey level of a pixel is the mean over its area. When the pose changes, it changes for two reasons,

    dI = integral over the covered area of dS  +  integral along the outline in the pixel of (inside - outside) v.n ds

the surface slides and turns beneath the pixel (S is its grey level at a place of the image), and its outline crosses
the pixel with the normal velocity v.n. The first is summed over points of the pixel, the second over short pieces of
the outline. Nothing of an edge is given away to free grey levels, as it is when single profiles are searched: near the
true pose this tells joint angles ten times better.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .._kernels import mesh_dense as kernels
from ..camera import Camera, project_with_jacobian
from .contour import contour_places, place_contour
from .image import EDGE, INSIDE, Box, box_of
from .shading import LOW, SPACING, SurfaceAppearance
from .skin import Surface, edge_points, vertex_normals
from .templates import contact_table
from .view import moving_box, moving_triangles, view_of

LIGHTS = 5  # ways in which the light may be off
_PIECE = 0.5  # pixels of outline taken at a time
_BLACK, _WHITE = 0.5, 254.5  # grey levels that a sensor may have cut
_CELL = 12.0  # pixels along a side of a patch


@dataclass(frozen=True, slots=True, eq=False)
class Dense:
    """Pixels of one view.

    Attributes
    ----------
    r, J : (n,), (n, k)
        Residuals (level - expected) / noise and their derivative by the free joints.
    B : (n, m)
        Derivative by the light (even, growing with x, y, z of the normal, from its one direction; grey levels) and by
        the gain of each region.
    row, column, kind : (n,), (n,), (n,)
        Pixel, and INSIDE, RIM or EDGE.
    patch : (n,)
        Patch of the image it lies in, by region and kind, numbered from 0 without gaps.
    """

    r: Float[np.ndarray, " n"]
    J: Float[np.ndarray, "n k"]
    B: Float[np.ndarray, "n m"]
    row: Int[np.ndarray, " n"]
    column: Int[np.ndarray, " n"]
    kind: Int[np.ndarray, " n"]
    patch: Int[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Image places of all vertices' derivatives by the free joints: pixels, 1 / depth, normal in camera axes."""

    dxy: Float[np.ndarray, "v 2 k"]
    s: Float[np.ndarray, " v"]
    ds: Float[np.ndarray, "v k"]
    dn: Float[np.ndarray, "v 3 k"]


def vertex_motion(surface: Surface, camera: Camera, u: Float[np.ndarray, " k"]) -> Motion:
    """How every vertex and its normal move."""
    every = np.arange(surface.weight.shape[0])
    p, dp = edge_points(surface, np.stack([every, every], axis=1), np.zeros(every.size), u)
    _, d_normal = vertex_normals(surface, every, u)
    _, d_xy = project_with_jacobian(camera, p)
    s, ds = np.ones(every.size), np.zeros((every.size, u.size))
    if camera.kind == "perspective":
        s = 1.0 / (p @ camera.R[2] + camera.t[2])
        ds = -(s * s)[:, None] * (camera.R[2] @ dp)
    return Motion(d_xy @ dp, s, ds, camera.R @ d_normal)


def _moved(surface: Surface, motion: Motion) -> Bool[np.ndarray, "t k"]:
    """Which free joints move which triangle."""
    of_vertex = (motion.dxy != 0.0).any(axis=1) | (motion.dn != 0.0).any(axis=1)
    return of_vertex[surface.triangles].any(axis=1)


def chosen_pixels(surface: Surface, box: Box, part: Float[np.ndarray, "h w"], stride: int) -> Bool[np.ndarray, "h w"]:
    """Every pixel on edges of the moving surface and beside them, every `stride`-th inside, none that is cut off."""
    moving = (box.triangle >= 0) & moving_triangles(surface)[box.triangle]
    grown = moving.copy()
    for axis in (0, 1):
        for step in (1, -1):
            grown |= np.roll(moving, step, axis)
    grid = np.zeros(moving.shape, dtype=bool)
    grid[::stride, ::stride] = True
    usable = (part > _BLACK) & (part < _WHITE)
    return usable & np.where(
        box.kind == INSIDE, moving & grid, (box.kind > INSIDE) & (moving | (grown & (box.kind == EDGE)))
    )


def dense_rows(
    image: Float[np.ndarray, "h w"],
    surface: Surface,
    camera: Camera,
    u: Float[np.ndarray, " k"],
    appearance: SurfaceAppearance,
    stride: int = 3,
) -> Dense:
    """Residuals and Jacobians of the pixels of the moving surface at the pose u.

    Parameters
    ----------
    stride : int
        Inside the surface one pixel in `stride` along rows and columns is taken; all on edges and beside them.
    """
    view = view_of(surface, camera, u)
    low, high = moving_box(surface, camera, view, 2.0)
    box = box_of(surface, camera, view, low, high)
    height, width = box.triangle.shape
    part = np.ascontiguousarray(image[box.y0 : box.y0 + height, box.x0 : box.x0 + width], dtype=float)
    row, column = np.nonzero(chosen_pixels(surface, box, part, stride))
    kind, level = box.kind[row, column], part[row, column]
    n, m, plain = row.size, LIGHTS + surface.finger.size, appearance.plain
    r, J, B, region = np.empty(n), np.empty((n, u.size)), np.empty((n, m)), np.empty(n, dtype=np.int64)
    motion = vertex_motion(surface, camera, u)
    mesh = (view.mesh.xy, view.mesh.inverse, view.mesh.pinhole, view.mesh.triangles, view.tiles.packed())
    light = (appearance.light, plain.gain, appearance.table, LOW, SPACING)
    pixel = np.column_stack([column + box.x0, row + box.y0]).astype(float)
    kernels.dense_rows(
        pixel,
        kind,
        level,
        mesh,
        surface.region,
        (motion.dxy, motion.s, motion.ds, view.skin.normal, motion.dn, appearance.albedo, _moved(surface, motion)),
        light,
        plain.background,
        plain.noise,
        r,
        J,
        B,
        region,
    )
    row_of = np.full(box.triangle.shape, -1, dtype=np.int64)
    row_of[row, column] = np.arange(n)
    _outline(surface, camera, view, u, motion, mesh, light, appearance, row_of, box, J)
    cell = np.floor(np.column_stack([column, row]) / _CELL).astype(np.int64)
    key = ((region + 1) * 4 + kind) * 1_000_000 + cell[:, 0] * 1000 + cell[:, 1]
    patch = np.unique(key, return_inverse=True)[1].reshape(-1)
    return Dense(r, J, B, row + box.y0, column + box.x0, kind, patch)


def _outline(surface, camera, view, u, motion, mesh, light, appearance, row_of, box, J) -> None:
    """Add the outline's part to J."""
    at, length = contour_places(surface, view.mesh, _PIECE, 0.0)
    dxy = (1.0 - at.share)[:, None, None] * motion.dxy[at.vertex[:, 0]] + at.share[:, None, None] * motion.dxy[
        at.vertex[:, 1]
    ]
    samplers = place_contour(surface, view.skin, view.mesh, camera, u, at)
    outwards = (samplers.direction[:, None, :] @ dxy)[:, 0, :]
    kernels.add_outline(
        samplers.origin,
        samplers.direction,
        contact_table(surface, samplers, at, camera),
        outwards,
        length,
        row_of,
        box.x0,
        box.y0,
        mesh,
        surface.region,
        surface.finger,
        view.mesh.area,
        view.skin.normal,
        appearance.albedo,
        light,
        (appearance.plain.background, appearance.plain.noise),
        J,
    )
