"""An image and a posed surface in, pixels well inside it out, with their shading residuals.

What `handtrack.pixels` does with pills. A pixel counts where it and its neighbours on all four sides show the moving
surface without a step in depth. Its residual is the grey level less what the learnt shading says of the blended
normal; the triangle it was found on is posed anew at every u.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .._kernels import mesh_image as kernels
from ..appearance import shaded
from ..camera import Camera, project_with_jacobian
from ..pixels import Shaded
from .raster import probe
from .shading import LOW, SPACING, SurfaceAppearance, table_levels
from .skin import Surface, edge_points, points_numpy, vertex_normals
from .view import View, moving_box, moving_triangles

_CLOSEST = 3.0  # pixels between pixels
_BLACK, _WHITE = 1.5, 253.5  # grey levels that a sensor may have cut
_CELL = 14.0  # pixels along a side of a patch
_STEP = 0.25  # of the link's radius: depth between neighbours that ends a surface


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePixels:
    """Pixels on the visible surface.

    Attributes
    ----------
    xy, level : (n, 2), (n,)
        Pixel and its grey level.
    corner : (n, 3)
        Corners of the triangle it shows, as numbers into `vertex`.
    vertex : (m,)
        Vertices of these triangles.
    link, patch : (n,), (n,)
        Region of the surface, and patch of the image in it: errors of the shading are shared in a patch.
    """

    surface: Surface
    camera: Camera
    xy: Float[np.ndarray, "n 2"]
    level: Float[np.ndarray, " n"]
    corner: Int[np.ndarray, "n 3"]
    vertex: Int[np.ndarray, " m"]
    link: Int[np.ndarray, " n"]
    patch: Int[np.ndarray, " n"]


def surface_pixels(
    image: Float[np.ndarray, "h w"], surface: Surface, camera: Camera, view: View, blur: float, most: int = 1500
) -> SurfacePixels:
    """Whole pixels on a grid over the moving part of the surface that show nothing but it; at most about `most`."""
    margin = 2.5 * blur + 1.5
    low, high = moving_box(surface, camera, view, 0.0)
    low, high = np.maximum(low, np.ceil(margin)), np.minimum(high, [camera.width - 1 - margin, camera.height - 1 - margin])
    moving = moving_triangles(surface)
    area = 0.5 * float(np.maximum(-view.mesh.area[moving], 0.0).sum())
    spacing = max(_CLOSEST, np.sqrt(area / most))
    sides = [np.rint(np.arange(a, b, spacing)) for a, b in zip(low, high, strict=True)]
    xy = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    seen = probe(view.mesh, view.tiles, xy)
    own = (seen.triangle >= 0) & moving[seen.triangle]
    xy, triangle, depth = xy[own], seen.triangle[own], seen.depth[own]
    links = surface.model.link_radius.mean(axis=1)
    # The surface may fall away from the viewer over the margin, but not step.
    room = _STEP * links[surface.link[triangle]] + 2.0 * margin / camera.fx * (depth if view.mesh.pinhole else 1.0)
    kept = np.ones(xy.shape[0], dtype=bool)
    for step in ((margin, 0.0), (-margin, 0.0), (0.0, margin), (0.0, -margin)):
        beside = probe(view.mesh, view.tiles, xy + step)
        with np.errstate(invalid="ignore"):
            kept &= (beside.triangle >= 0) & (np.abs(beside.depth - depth) < room)
    column, row = xy.astype(int).T
    level = image[row, column].astype(float)
    kept &= (level > _BLACK) & (level < _WHITE)
    xy, triangle, level = xy[kept], triangle[kept], level[kept]
    region = surface.region[triangle]
    vertex, corner = np.unique(surface.triangles[triangle], return_inverse=True)
    cell = np.floor(xy / _CELL).astype(int)
    patch = np.unique(np.column_stack([region, cell]), axis=0, return_inverse=True)[1].reshape(-1)
    return SurfacePixels(surface, camera, xy, level, corner.reshape(-1, 3), vertex, region, patch)


def surface_pixel_rows(pixels: SurfacePixels, appearance: SurfaceAppearance, u: Float[np.ndarray, " k"]) -> Shaded:
    """Shading residuals in units of the noise and their Jacobian by u."""
    surface, camera, n = pixels.surface, pixels.camera, pixels.level.size
    p, dp = edge_points(surface, np.stack([pixels.vertex] * 2, axis=1), np.zeros(pixels.vertex.size), u)
    normal, d_normal = vertex_normals(surface, pixels.vertex, u)
    xy, d_xy = project_with_jacobian(camera, p)
    s, ds = np.ones(p.shape[0]), np.zeros((p.shape[0], u.size))
    if camera.kind == "perspective":
        s = 1.0 / (p @ camera.R[2] + camera.t[2])
        ds = -(s * s)[:, None] * (camera.R[2] @ dp)
    r, J, seen, expected = np.empty(n), np.empty((n, u.size)), np.empty((n, 3)), np.empty(n)
    kernels.shaded_pixels(
        pixels.xy,
        pixels.corner,
        pixels.link,
        pixels.level,
        appearance.noise,
        (xy, d_xy @ dp, s, ds, normal @ camera.R.T, camera.R @ d_normal, appearance.albedo[pixels.vertex]),
        (appearance.plain.shading, appearance.plain.gain, appearance.table, LOW, SPACING),
        r,
        J,
        seen,
        expected,
    )
    return Shaded(r, J, seen, expected)


def rows_numpy(pixels: SurfacePixels, appearance: SurfaceAppearance, u: Float[np.ndarray, " k"]) -> Shaded:
    """The same as `surface_pixel_rows` in plain NumPy, the Jacobian by central differences: the kernel's twin."""
    surface, camera = pixels.surface, pixels.camera

    def level(v: Float[np.ndarray, " k"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        p, _ = points_numpy(surface, np.stack([pixels.vertex] * 2, axis=1), np.zeros(pixels.vertex.size), v)
        n = vertex_normals(surface, pixels.vertex, v)[0] @ camera.R.T
        xy = project_with_jacobian(camera, p)[0][pixels.corner]
        edges = np.swapaxes(xy[:, 1:] - xy[:, :1], 1, 2)
        share = np.linalg.solve(edges, (pixels.xy - xy[:, 0])[..., None])[..., 0]
        share = np.column_stack([1.0 - share.sum(axis=1), share])
        colour = (share * appearance.albedo[pixels.vertex][pixels.corner]).sum(axis=1)
        if camera.kind == "perspective":
            share = share / (p @ camera.R[2] + camera.t[2])[pixels.corner]
        blend = (share[..., None] * n[pixels.corner]).sum(axis=1)
        blend = blend / np.linalg.norm(blend, axis=1, keepdims=True)
        smooth = shaded(appearance.plain.shading, blend) + table_levels(appearance.table, blend)
        return appearance.plain.gain[pixels.link] * colour * smooth, blend

    h = 1e-6
    J = np.stack([-(level(u + e)[0] - level(u - e)[0]) / (2.0 * h) for e in h * np.eye(u.size)], axis=1)
    expected, normal = level(u)
    return Shaded((pixels.level - expected) / appearance.noise, J / appearance.noise, normal, expected)
