"""An image, a surface at a pose and its appearance in, residuals of all its pixels and their Jacobian out.

The expected grey level of a pixel is the mean over its area. When the pose changes, it changes for two reasons,

    dI = integral over the covered area of dS  +  integral along the outline in the pixel of (inside - outside) v.n ds

the surface slides and turns beneath the pixel (S is its grey level at a place of the image), and its outline crosses
the pixel with the normal velocity v.n. The first is summed over points of the pixel, the second over short pieces of
the outline. Nothing of an edge is given away to free grey levels, as it is when single profiles are searched: near the
true pose this tells joint angles ten times better.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from .._kernels import mesh_dense as kernels
from ..camera import Camera
from .image import EDGE, INSIDE, Box, box_of, lens_blur
from .outline import Motion, outline_pieces, vertex_motion
from .shading import LOW, SPACING, SurfaceAppearance
from .skin import Surface
from .view import View, moving_box, moving_triangles, view_of

LIGHTS = 5  # ways in which the light may be off
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
    region : (n,)
        Region of the surface that it shows, -1 for none.
    contrast : (n,)
        Step in grey level of the outline that crosses the pixel, in units of the noise; 0 where none does.
    patch : (n,)
        Patch of the image it lies in, by region and kind, numbered from 0 without gaps.
    """

    r: Float[np.ndarray, " n"]
    J: Float[np.ndarray, "n k"]
    B: Float[np.ndarray, "n m"]
    row: Int[np.ndarray, " n"]
    column: Int[np.ndarray, " n"]
    kind: Int[np.ndarray, " n"]
    region: Int[np.ndarray, " n"]
    contrast: Float[np.ndarray, " n"]
    patch: Int[np.ndarray, " n"]


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
    lens = lens_blur(appearance)
    view = view_of(surface, camera, u)
    low, high = moving_box(surface, camera, view, 2.0 + 3.0 * lens)
    box = box_of(surface, camera, view, low, high)
    height, width = box.triangle.shape
    part = np.ascontiguousarray(image[box.y0 : box.y0 + height, box.x0 : box.x0 + width], dtype=float)
    chosen = chosen_pixels(surface, box, part, stride)
    sharp = _sharp_rows(part, surface, camera, view, box, box.kind > 0 if lens > 0.0 else chosen, u, appearance)
    return sharp if lens == 0.0 else _through_lens(sharp, box, part, chosen, appearance, lens)


def _sharp_rows(
    part: Float[np.ndarray, "h w"],
    surface: Surface,
    camera: Camera,
    view: View,
    box: Box,
    chosen: Bool[np.ndarray, "h w"],
    u: Float[np.ndarray, " k"],
    appearance: SurfaceAppearance,
) -> Dense:
    """The rows of the chosen pixels of a box, without any blur."""
    row, column = np.nonzero(chosen)
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
    contrast = np.zeros(n)
    pieces = outline_pieces(surface, camera, view, u, motion)
    kernels.add_outline(
        pieces.origin,
        pieces.direction,
        pieces.contact,
        pieces.outwards,
        pieces.length,
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
        (plain.background, plain.noise),
        J,
        contrast,
    )
    patch = _patches(kind, region, row, column)
    return Dense(r, J, B, row + box.y0, column + box.x0, kind, region, contrast, patch)


def _through_lens(
    sharp: Dense,
    box: Box,
    part: Float[np.ndarray, "h w"],
    chosen: Bool[np.ndarray, "h w"],
    appearance: SurfaceAppearance,
    lens: float,
) -> Dense:
    """The rows of a blurred image: expected levels and derivatives are blurred like the image, as planes.

    Pixels of the background that the surface is smeared over count as pixels on an edge.
    """
    noise, row, column = appearance.noise, sharp.row - box.y0, sharp.column - box.x0
    k, m = sharp.J.shape[1], sharp.B.shape[1]
    planes = np.zeros((*box.triangle.shape, k + m + 2))
    expected = part[row, column] - noise * sharp.r
    planes[row, column] = np.column_stack([sharp.J, sharp.B, sharp.contrast, expected - appearance.background])
    for i in range(k + m + 2):  # one filter for each plane
        planes[..., i] = cv2.GaussianBlur(planes[..., i].copy(), (0, 0), lens, borderType=cv2.BORDER_REPLICATE)
    size = 2 * int(np.ceil(2.0 * lens)) + 1
    smeared = cv2.dilate((chosen & (box.kind == EDGE)).astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    usable = (part > _BLACK) & (part < _WHITE)
    row, column = np.nonzero(usable & (chosen | (smeared & (box.kind == 0))))
    of = planes[row, column]
    regions = np.full(box.triangle.shape, -1)
    regions[sharp.row - box.y0, sharp.column - box.x0] = sharp.region
    region = np.asarray(regions[row, column])
    kind = np.where(box.kind[row, column] == 0, EDGE, box.kind[row, column])
    r = (part[row, column] - appearance.background - of[:, -1]) / noise
    patch = _patches(kind, region, row, column)
    return Dense(r, of[:, :k], of[:, k : k + m], row + box.y0, column + box.x0, kind, region, of[:, -2], patch)


def _patches(
    kind: Int[np.ndarray, " n"],
    region: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    column: Int[np.ndarray, " n"],
) -> Int[np.ndarray, " n"]:
    """Numbers of the patches that pixels lie in, without gaps."""
    cell = np.floor(np.column_stack([column, row]) / _CELL).astype(np.int64)
    key = ((region + 1) * 4 + kind) * 1_000_000 + cell[:, 0] * 1000 + cell[:, 1]
    return np.unique(key, return_inverse=True)[1].reshape(-1)
