"""Posed vertices and a camera in, what each pixel or image point shows of the mesh out.

Vertices are projected, triangles are filled between them; the one nearest to the camera wins. Inside a triangle depth
is linear in the image for parallel rays, its inverse for a pinhole, so barycentric coordinates are corrected by

    b_i = (l_i / z_i) / sum_k (l_k / z_k).

A lens that bends straight lines bends the corners of the triangles only. `rasterise` fills whole images; `probe` asks
for single points, at any fraction of a pixel, of the few triangles whose box reaches their tile of the image.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .._kernels import raster as kernels
from ..camera import Camera, project_camera
from .skin import Skin

TILE = 6.0  # pixels


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """A posed mesh as the camera sees it.

    Attributes
    ----------
    xy : (v, 2)
        Pixels; NaN behind a perspective camera, which leaves out the triangles there.
    depth, inverse : (v,), (v,)
        Depth in camera axes, and what is linear in the image: depth itself, or one over it for a pinhole.
    area : (t,)
        Doubled signed area of each triangle in the image: negative where it faces the camera.
    """

    xy: Float[np.ndarray, "v 2"]
    depth: Float[np.ndarray, " v"]
    inverse: Float[np.ndarray, " v"]
    pinhole: bool
    triangles: Int[np.ndarray, "t 3"]
    area: Float[np.ndarray, " t"]


@dataclass(frozen=True, slots=True, eq=False)
class Fragments:
    """What is seen: triangle (-1: none), barycentric coordinates, depth (inf: none), at pixels or at points."""

    triangle: Int[np.ndarray, "*n"]
    bary: Float[np.ndarray, "*n 3"]
    depth: Float[np.ndarray, "*n"]


@dataclass(frozen=True, slots=True, eq=False)
class Tiles:
    """Triangles by tiles of the image: tile i of `columns * rows` holds `member[first[i]:first[i + 1]]`."""

    columns: int
    rows: int
    x0: float
    y0: float
    first: Int[np.ndarray, " m"]
    member: Int[np.ndarray, " n"]

    def packed(self):
        """As the kernels take it."""
        return TILE, self.columns, self.rows, self.x0, self.y0, self.first, self.member


def project_mesh(skin: Skin, triangles: Int[np.ndarray, "t 3"], camera: Camera) -> Projected:
    """Project a posed mesh."""
    xy, depth = project_camera(camera, skin.p), np.ascontiguousarray(skin.p[:, 2])
    pinhole = camera.kind == "perspective"
    with np.errstate(divide="ignore"):
        inverse = 1.0 / depth if pinhole else depth
    area = np.empty(triangles.shape[0])
    kernels.facing(xy, triangles, area)
    return Projected(np.ascontiguousarray(xy), depth, inverse, pinhole, triangles, area)


def facing_numpy(xy: Float[np.ndarray, "v 2"], triangles: Int[np.ndarray, "t 3"]) -> Float[np.ndarray, " t"]:
    """Doubled signed areas of triangles in the image in plain NumPy: the twin of the compiled kernel."""
    a, b, c = (xy[triangles[:, i]] for i in range(3))
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


def rasterise(mesh: Projected, camera: Camera) -> Fragments:
    """What each pixel centre shows.

    >>> from handtrack.camera import orthographic
    >>> camera = orthographic(4, 3, 1.0, 0.0, 0.0, np.eye(3), np.zeros(3))
    >>> corners = np.array([[0.0, 0.0, 5.0], [2.5, 0.0, 5.0], [0.0, 2.5, 5.0]])
    >>> mesh = project_mesh(Skin(corners, corners), np.array([[0, 1, 2]]), camera)
    >>> (rasterise(mesh, camera).triangle + 1).tolist()
    [[1, 1, 1, 0], [1, 1, 0, 0], [1, 0, 0, 0]]
    """
    shape = (camera.height, camera.width)
    triangle, bary = np.full(shape, -1, dtype=np.int64), np.zeros((*shape, 3))
    depth = np.full(shape, np.inf)
    kernels.rasterise(mesh.xy, mesh.inverse, mesh.pinhole, mesh.triangles, triangle, bary, depth)
    return Fragments(triangle, bary, depth)


def rasterise_numpy(mesh: Projected, camera: Camera) -> Fragments:
    """The same as `rasterise` in plain NumPy, one triangle after the other: the twin of the compiled kernel."""
    x, y = np.meshgrid(np.arange(float(camera.width)), np.arange(float(camera.height)))
    points = np.stack([x, y], axis=-1).reshape(-1, 2)
    found = probe_numpy(mesh, points)
    shape = (camera.height, camera.width)
    return Fragments(found.triangle.reshape(shape), found.bary.reshape(*shape, 3), found.depth.reshape(shape))


def tiled(mesh: Projected, camera: Camera, margin: float = 16.0) -> Tiles:
    """Sort triangles into tiles of the image and `margin` pixels around it."""
    columns, rows = (int((size + 2.0 * margin) / TILE) + 1 for size in (camera.width, camera.height))
    first = np.zeros(columns * rows + 1, dtype=np.int64)
    kernels.count_tiles(mesh.xy, mesh.triangles, TILE, first, columns, rows, -margin, -margin)
    member = np.empty(int(first[-1]), dtype=np.int64)
    kernels.fill_tiles(mesh.xy, mesh.triangles, TILE, first, columns, rows, -margin, -margin, member)
    return Tiles(columns, rows, -margin, -margin, first, member)


def tiles_numpy(mesh: Projected, camera: Camera, margin: float = 16.0) -> Tiles:
    """The same as `tiled`, in plain NumPy: the twin of the compiled kernels."""
    columns, rows = (int((size + 2.0 * margin) / TILE) + 1 for size in (camera.width, camera.height))
    corner = (mesh.xy + margin)[mesh.triangles]
    usable: Bool[np.ndarray, " t"] = np.asarray(np.isfinite(corner).all(axis=(1, 2)))
    low = np.floor(np.where(usable[:, None], corner.min(axis=1), 1e12) / TILE)
    high = np.floor(np.where(usable[:, None], corner.max(axis=1), -1e12) / TILE)
    members = [
        np.flatnonzero((low[:, 0] <= c) & (high[:, 0] >= c) & (low[:, 1] <= r) & (high[:, 1] >= r))
        for r in range(rows)
        for c in range(columns)
    ]
    first = np.concatenate([[0], np.cumsum([m.size for m in members])])
    return Tiles(columns, rows, -margin, -margin, first, np.concatenate(members))


def probe(mesh: Projected, tiles: Tiles, points: Float[np.ndarray, "n 2"]) -> Fragments:
    """What single image points show; nothing outside the tiles."""
    n = points.shape[0]
    triangle, bary, depth = np.empty(n, dtype=np.int64), np.empty((n, 3)), np.empty(n)
    kernels.probe(points, mesh.xy, mesh.inverse, mesh.pinhole, mesh.triangles, tiles.packed(), triangle, bary, depth)
    return Fragments(triangle, bary, depth)


def probe_numpy(mesh: Projected, points: Float[np.ndarray, "n 2"]) -> Fragments:
    """What single image points show, in plain NumPy and without tiles: the twin of the compiled kernel."""
    n = points.shape[0]
    triangle, bary, depth = np.full(n, -1), np.zeros((n, 3)), np.full(n, np.inf)
    for k in np.flatnonzero(np.abs(mesh.area) > 1e-12):
        corner = mesh.triangles[k]
        a, b, c = mesh.xy[corner]
        l1 = ((points[:, 0] - a[0]) * (c[1] - a[1]) - (points[:, 1] - a[1]) * (c[0] - a[0])) / mesh.area[k]
        l2 = ((b[0] - a[0]) * (points[:, 1] - a[1]) - (b[1] - a[1]) * (points[:, 0] - a[0])) / mesh.area[k]
        share = np.stack([1.0 - l1 - l2, l1, l2], axis=1)
        number = share @ mesh.inverse[corner]
        with np.errstate(divide="ignore", invalid="ignore"):
            z = 1.0 / number if mesh.pinhole else number
        nearer = (share >= -1e-12).all(axis=1) & (z < depth)
        triangle[nearer], depth[nearer] = k, z[nearer]
        corrected = share * mesh.inverse[corner] * z[:, None] if mesh.pinhole else share
        bary[nearer] = corrected[nearer]
    return Fragments(triangle, bary, depth)


def smooth_normals(skin: Skin, mesh: Projected, seen: Fragments) -> Float[np.ndarray, "n 3"]:
    """Unit normals, camera axes, blended between the corners of the triangles seen; zero where there is none."""
    corners = mesh.triangles[np.maximum(seen.triangle, 0)]
    blend = (seen.bary[..., None] * skin.normal[corners]).sum(axis=-2)
    size = np.linalg.norm(blend, axis=-1, keepdims=True)
    return np.where(seen.triangle[..., None] >= 0, blend / np.where(size > 0.0, size, 1.0), 0.0)
