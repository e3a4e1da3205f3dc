"""A posed surface and its appearance in, the image it should give out.

Where a pixel and its eight neighbours show one surface, its grey level is that of its centre; on edges and beside them
it is the mean over points of the pixel. What the lens blurs beyond that is blurred at the end.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from .._kernels import mesh_image as kernels
from ..appearance import SHARP
from ..camera import Camera
from ..profiles import Samplers
from .raster import Fragments, probe, smooth_normals
from .shading import LOW, SPACING, SurfaceAppearance, lit_levels
from .skin import Surface
from .view import View

INSIDE, RIM, EDGE = kernels.INSIDE, kernels.RIM, kernels.EDGE
_RIM_PIXELS = 2
_JUMP = 0.25  # of the link's radius: a step in depth between two surfaces


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """What the pixels of a box of the image show.

    Attributes
    ----------
    x0, y0 : int
        First pixel.
    triangle, depth : (h, w), (h, w)
        At the pixel's centre: -1 and inf where there is none.
    kind : (h, w)
        INSIDE, RIM or EDGE; 0 where neither the pixel nor a neighbour shows the surface.
    """

    x0: int
    y0: int
    triangle: Int[np.ndarray, "h w"]
    depth: Float[np.ndarray, "h w"]
    kind: Int[np.ndarray, "h w"]


def box_of(
    surface: Surface, camera: Camera, view: View, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]
) -> Box:
    """Rasterise the pixels from `low` to `high`, both included."""
    width, height = np.maximum(high - low, 0.0).astype(int) + 1
    triangle, depth = np.full((height, width), -1, dtype=np.int64), np.full((height, width), np.inf)
    mesh = view.mesh
    kernels.fill_depth(mesh.xy, mesh.inverse, mesh.pinhole, mesh.triangles, int(low[0]), int(low[1]), triangle, depth)
    kind = np.empty((height, width), dtype=np.int64)
    kernels.classify(triangle, depth, depth_jumps(surface), _RIM_PIXELS, kind)
    return Box(int(low[0]), int(low[1]), triangle, depth, kind)


def depth_jumps(surface: Surface) -> Float[np.ndarray, " t"]:
    """Depth that must lie between two surfaces at each triangle, mm: a quarter of the link's radius."""
    return _JUMP * surface.model.link_radius.mean(axis=1)[surface.link]


def shade_box(
    surface: Surface,
    view: View,
    box: Box,
    appearance: SurfaceAppearance,
    wanted: Bool[np.ndarray, "h w"] | None = None,
) -> Float[np.ndarray, "h w"]:
    """Grey levels of the wanted pixels of the box, before the blur of the lens; background elsewhere."""
    image = np.empty(box.triangle.shape)
    wanted = np.ones(image.shape, dtype=bool) if wanted is None else wanted
    mesh, plain = view.mesh, appearance.plain
    kernels.shade_box(
        box.x0,
        box.y0,
        box.triangle,
        box.kind,
        wanted,
        (mesh.xy, mesh.inverse, mesh.pinhole, mesh.triangles, view.tiles.packed()),
        view.skin.normal,
        appearance.albedo,
        surface.region,
        (appearance.light, plain.gain, appearance.table, LOW, SPACING),
        plain.background,
        image,
    )
    return image


def shade_box_numpy(surface: Surface, view: View, box: Box, appearance: SurfaceAppearance) -> Float[np.ndarray, "h w"]:
    """The same as `shade_box` in plain NumPy: the twin of the compiled kernel."""
    image = np.full(box.triangle.shape, appearance.plain.background)
    row, column = np.nonzero(box.kind == INSIDE)
    image[row, column] = levels_at(surface, view, appearance, np.column_stack([column + box.x0, row + box.y0]) + 0.0)
    for kind, points, step in (
        (RIM, kernels.RIM_POINTS, kernels.RIM_STEP),
        (EDGE, kernels.EDGE_POINTS, kernels.EDGE_STEP),
    ):
        row, column = np.nonzero(box.kind == kind)
        centre, total = np.column_stack([column + box.x0, row + box.y0]), np.zeros(row.size)
        for i in range(points):
            place = (np.array([i, i * step % points]) + 0.5) / points - 0.5
            total += levels_at(surface, view, appearance, centre + place)
        image[row, column] = total / points
    return image


def levels_at(
    surface: Surface, view: View, appearance: SurfaceAppearance, points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Grey levels of image points, in plain NumPy."""
    seen = probe(view.mesh, view.tiles, points)
    normal = smooth_normals(view.skin, view.mesh, seen)
    on = seen.triangle >= 0
    colour = (seen.bary * appearance.albedo[view.mesh.triangles[seen.triangle]]).sum(axis=1)
    level = appearance.plain.gain[surface.region[seen.triangle]] * colour * lit_levels(appearance, normal)
    return np.where(on, level, appearance.plain.background)


def lens_blur(appearance: SurfaceAppearance) -> float:
    """Standard deviation of the blur beyond that of a square pixel and its sampling, pixels."""
    return float(np.sqrt(max(appearance.blur**2 - SHARP**2, 0.0)))


def expected_image(
    surface: Surface,
    camera: Camera,
    view: View,
    appearance: SurfaceAppearance,
    box: Box,
    wanted: Bool[np.ndarray, "h w"] | None = None,
) -> Float[np.ndarray, "rows columns"]:
    """The whole image that the surface in the box should give, background everywhere else.

    If only some pixels of the box are wanted, the others are not to be relied on.
    """
    image = np.full((camera.height, camera.width), appearance.plain.background)
    lens = lens_blur(appearance)
    if wanted is not None and lens > 0.0:
        size = 2 * int(np.ceil(3.0 * lens)) + 1
        wanted = cv2.dilate(wanted.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    part = shade_box(surface, view, box, appearance, wanted)
    if lens > 0.0:
        part = cv2.GaussianBlur(part, (0, 0), lens, borderType=cv2.BORDER_REPLICATE)
    height, width = part.shape
    image[box.y0 : box.y0 + height, box.x0 : box.x0 + width] = part
    return image


def profile_pixels(box: Box, samplers: Samplers, u: Float[np.ndarray, " m"]) -> Bool[np.ndarray, "h w"]:
    """Pixels of the box that profiles are read from."""
    wanted = np.zeros(box.triangle.shape, dtype=bool)
    kernels.mark_profiles(samplers.origin, samplers.direction, u, box.x0, box.y0, 0, wanted)
    return wanted


def fragments(view: View, box: Box, row: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]) -> Fragments:
    """What the centres of some pixels of the box show; all must show the surface."""
    mesh, triangle = view.mesh, box.triangle[row, column]
    corner = mesh.triangles[triangle]
    a, b, c = (mesh.xy[corner[:, i]] for i in range(3))
    point = np.column_stack([column + box.x0, row + box.y0]) - a
    b, c, area = b - a, c - a, mesh.area[triangle]
    l1 = (point[:, 0] * c[:, 1] - point[:, 1] * c[:, 0]) / area
    l2 = (b[:, 0] * point[:, 1] - b[:, 1] * point[:, 0]) / area
    share = np.stack([1.0 - l1 - l2, l1, l2], axis=1)
    if mesh.pinhole:
        share = share * mesh.inverse[corner]
        share = share / share.sum(axis=1, keepdims=True)
    return Fragments(triangle, share, box.depth[row, column])
