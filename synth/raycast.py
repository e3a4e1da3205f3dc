"""Pills and a camera in, depth, part number and normal of every pixel out, by exact ray-pill intersection.

Every pixel centre has one ray; the first pill on it is what the pixel shows (the Z-buffer of the hand thesis, section
10.2, without facets). Each pill is tried only inside a box of pixels that surely holds its silhouette. Lens
distortion bends the rays, not the picture: the normalised coordinates of all pixels are computed once per camera.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from handtrack.camera import Camera, distort, rays
from handtrack.pills import Pills

from . import _kernels


@dataclass(frozen=True, slots=True, eq=False)
class RenderBuffers:
    """What each pixel centre sees.

    Attributes
    ----------
    depth : (h, w)
        Camera z of the surface point, model units; inf on the background.
    part : (h, w)
        Number of the pill, -1 on the background.
    normal : (h, w, 3)
        Unit outward normal in camera axes; zero on the background.
    """

    depth: Float[np.ndarray, "h w"]
    part: Int[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]


@lru_cache(maxsize=8)
def pixel_grid(camera: Camera) -> Float[np.ndarray, "hp wp 2"]:
    """Normalised coordinates (undistorted) of all pixel centres, with a border one pixel wide all round."""
    u, v = np.meshgrid(np.arange(-1.0, camera.width + 1), np.arange(-1.0, camera.height + 1))
    origin, direction = rays(camera, np.stack([u.ravel(), v.ravel()], axis=1))
    flat = origin[:, :2] if camera.kind == "orthographic" else direction[:, :2]
    grid = np.ascontiguousarray(flat).reshape(*u.shape, 2)
    grid.flags.writeable = False
    return grid


@lru_cache(maxsize=8)
def border_bounds(camera: Camera) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
    """Least and greatest normalised coordinates (undistorted) of the image and one pixel around it."""
    u, v = np.arange(-1.0, camera.width + 1), np.arange(-1.0, camera.height + 1)
    ends = [np.column_stack([u, np.full(u.size, y)]) for y in (v[0], v[-1])]
    ends += [np.column_stack([np.full(v.size, x), v]) for x in (u[0], u[-1])]
    origin, direction = rays(camera, np.concatenate(ends))
    flat = origin[:, :2] if camera.kind == "orthographic" else direction[:, :2]
    return flat.min(axis=0), flat.max(axis=0)


def pill_boxes(pills: Pills, camera: Camera) -> Int[np.ndarray, "l 4"]:
    """Pixel boxes (x0, x1, y0, y1), half open and clipped to the image, that hold each pill's silhouette.

    The silhouette of a convex hull is the hull of the two spheres' silhouettes. A sphere lies in a cube; the image of
    the cube in front of a pinhole is bounded by its near and far faces. A pill that reaches behind the pinhole gets
    the whole image.
    """
    centre = np.stack([pills.base, pills.tip])
    r = pills.radius.T[..., None]
    low, high = centre[..., :2] - r, centre[..., :2] + r
    if camera.kind == "perspective":
        near, far = centre[..., 2:] - r, centre[..., 2:] + r
        safe = near > 1e-6 * far
        near = np.where(safe, near, 1.0)
        low = np.where(safe, np.minimum(low / near, low / far), -np.inf)
        high = np.where(safe, np.maximum(high / near, high / far), np.inf)
    low, high = _pixel_bounds(camera, low.min(axis=0), high.max(axis=0))
    size = (camera.width, camera.height)
    first = np.clip(np.floor(low), 0, size).astype(np.int64)
    last = np.clip(np.ceil(high) + 1, 0, size).astype(np.int64)
    return np.column_stack([first[:, 0], last[:, 0], first[:, 1], last[:, 1]])


def _pixel_bounds(
    camera: Camera, low: Float[np.ndarray, "l 2"], high: Float[np.ndarray, "l 2"]
) -> tuple[Float[np.ndarray, "l 2"], Float[np.ndarray, "l 2"]]:
    """Pixel box around the image of each box of normalised coordinates; its border bounds it, bent or not."""
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    if not camera.distortion.any():
        return low * focal + centre, high * focal + centre
    low, high = np.clip([low, high], *border_bounds(camera))  # far beyond the image the distortion may fold
    s = np.linspace(0.0, 1.0, 17)
    border = np.concatenate(
        [np.column_stack([a, b]) for a, b in ((s, 0 * s), (s, 0 * s + 1), (0 * s, s), (0 * s + 1, s))]
    )
    bent = distort(low[:, None] + border * (high - low)[:, None], camera.distortion) * focal + centre
    spare = 2.0 + 0.02 * (bent.max(axis=1) - bent.min(axis=1))  # the border bulges between its samples
    return bent.min(axis=1) - spare, bent.max(axis=1) + spare


def pill_table(pills: Pills) -> Float[np.ndarray, "l 11"]:
    """Rows (base, unit axis, length, base radius, tip radius, slope s, 1 - s^2) with s = (base - tip radius) / length.

    A pill of which one end sphere holds the other is that sphere: length and slope 0.
    """
    base, axis, radius = pills.base.copy(), pills.tip - pills.base, pills.radius.copy()
    length = np.sqrt((axis * axis).sum(axis=1))
    ball = length <= np.abs(radius[:, 0] - radius[:, 1])
    tip_holds = ball & (radius[:, 1] > radius[:, 0])
    base[tip_holds] = pills.tip[tip_holds]
    radius[ball] = radius[ball].max(axis=1, keepdims=True)
    divisor = np.where(ball, 1.0, length)
    unit = np.where(ball[:, None], [1.0, 0.0, 0.0], axis / divisor[:, None])
    slope = np.where(ball, 0.0, (radius[:, 0] - radius[:, 1]) / divisor)
    return np.column_stack([base, unit, np.where(ball, 0.0, length), radius, slope, 1.0 - slope * slope])


def pill_depth(row: Float[np.ndarray, " p"], pinhole: bool, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Depth of a pill's first point on rays through normalised coordinates, inf where missed.

    Twin of `_kernels.pill_depth`.

    The side is the cone that touches both spheres, |p - u y|^2 (1 - s^2) = (r0 - s y)^2 with y the coordinate of p
    along the axis u, between the circles of contact y = r0 s and y = L + r1 s. On the ray o + t d this is a quadratic
    in t; its smaller root enters the cone, and if it lies between the circles no point of the (convex) pill comes
    before it. Else the pill is entered through one of its end spheres.
    """
    a, u, (length, r0, r1, s, c2) = row[:3], row[3:6], row[6:11]
    x, y = xy.T
    mx, my, mz = (-a[0], -a[1], -a[2]) if pinhole else (x - a[0], y - a[1], -a[2])
    dx, dy = (x, y) if pinhole else (0.0, 0.0)
    dd, md, mm = dx * dx + dy * dy + 1.0, mx * dx + my * dy + mz, mx * mx + my * my + mz * mz
    m_u, d_u = mx * u[0] + my * u[1] + mz * u[2], dx * u[0] + dy * u[1] + u[2]
    w = r0 - s * m_u
    qa, qb, qc = c2 * dd - d_u * d_u, c2 * (md - m_u * d_u) + s * d_u * w, c2 * (mm - m_u * m_u) - w * w
    gap = qb * qb - qa * qc
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(gap)
        side = np.where(qb <= 0.0, qc, -qb - root) / np.where(qb <= 0.0, root - qb, qa)
        at = m_u + side * d_u
        t = np.where((at >= r0 * s) & (at <= length + r1 * s), side, np.inf)
        ends = np.fmin(
            _sphere_depth(dd, md, mm - r0 * r0),
            _sphere_depth(dd, md - length * d_u, mm - 2.0 * length * m_u + length * length - r1 * r1),
        )
    ends = np.where(np.isnan(ends) | ((gap < 0.0) & (qa > 0.0)), np.inf, ends)
    t = np.where(t < np.inf, t, ends)
    return np.where(t > 0.0, t, np.inf) if pinhole else t


def _sphere_depth(dd, md, c) -> Float[np.ndarray, " n"]:
    """Smaller root of dd t^2 + 2 md t + c, NaN where there is none."""
    return (-md - np.sqrt(md * md - dd * c)) / dd


def pill_normal(rows: Float[np.ndarray, "n p"], p_cam: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Outward normals at surface points, each on the pill of its row: twin of `_kernels.pill_normal`.

    The point at y along the axis is touched by the sphere of the pill with centre (y - r0 s) / (1 - s^2), kept on the
    axis.
    """
    p = p_cam - rows[:, :3]
    u, length, r0, s, c2 = rows[:, 3:6], *rows[:, [6, 7, 9, 10]].T
    axial = p[:, 0] * u[:, 0] + p[:, 1] * u[:, 1] + p[:, 2] * u[:, 2]
    along = np.minimum(np.maximum((axial - r0 * s) / c2, 0.0), length)
    return (p - along[:, None] * u) * (1.0 / (r0 - s * along))[:, None]


def surface_points(
    camera: Camera, xy: Float[np.ndarray, "n 2"], depth: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """Points in camera axes from normalised coordinates and depth."""
    scale = 1.0 if camera.kind == "orthographic" else depth[:, None]
    return np.column_stack([xy * scale, depth])


def hull_box(boxes: Int[np.ndarray, "l 4"], camera: Camera) -> tuple[int, int, int, int]:
    """Box (x0, x1, y0, y1) around all boxes and one pixel more, inside the image; empty without pills."""
    if boxes.shape[0] == 0:
        return 0, 0, 0, 0
    x0, y0 = np.maximum(boxes[:, [0, 2]].min(axis=0) - 1, 0).tolist()
    x1, y1 = np.minimum(boxes[:, [1, 3]].max(axis=0) + 1, (camera.width, camera.height)).tolist()
    return x0, max(x0, x1), y0, max(y0, y1)


def cast_depth(
    table: Float[np.ndarray, "l p"], boxes: Int[np.ndarray, "l 4"], camera: Camera
) -> tuple[Float[np.ndarray, "h w"], Int[np.ndarray, "hp wp"]]:
    """Depth of every pixel centre, and its part with a border of -1, from `pill_table` and `pill_boxes`."""
    depth = np.full((camera.height, camera.width), np.inf)
    part = np.full((camera.height + 2, camera.width + 2), -1, dtype=np.int32)
    _kernels.cast_pixels(pixel_grid(camera), camera.kind == "perspective", table, boxes, depth, part)
    return depth, part


def cast(pills: Pills, camera: Camera) -> RenderBuffers:
    """Depth, part and normal at every pixel centre.

    Parameters
    ----------
    pills : Pills
        In camera axes.
    camera : Camera

    Returns
    -------
    RenderBuffers

    Examples
    --------
    >>> from handtrack.camera import orthographic
    >>> camera = orthographic(5, 3, 1.0, 2.0, 1.0, np.eye(3), np.zeros(3))
    >>> ball = Pills(np.array([[0.0, 0.0, 9.0]]), np.array([[1.0, 0.0, 9.0]]), np.array([[0.9, 0.9]]))
    >>> cast(ball, camera).part.tolist()
    [[-1, -1, -1, -1, -1], [-1, -1, 0, 0, -1], [-1, -1, -1, -1, -1]]
    """
    table, boxes = pill_table(pills), pill_boxes(pills, camera)
    depth, part = cast_depth(table, boxes, camera)
    normal = np.zeros((*depth.shape, 3))
    pinhole, span = camera.kind == "perspective", hull_box(boxes, camera)
    _kernels.normal_pixels(pixel_grid(camera), pinhole, table, span, depth, part, normal)
    return RenderBuffers(depth, part[1:-1, 1:-1].copy(), normal)


def cast_numpy(pills: Pills, camera: Camera) -> RenderBuffers:
    """The same as `cast` in plain NumPy, one pill and its box after the other: the twin of `_kernels.cast_pixels`."""
    shape = (camera.height, camera.width)
    depth, part, normal = np.full(shape, np.inf), np.full(shape, -1, dtype=np.int32), np.zeros((*shape, 3))
    table, grid = pill_table(pills), pixel_grid(camera)
    for k, (x0, x1, y0, y1) in enumerate(pill_boxes(pills, camera)):
        t = pill_depth(table[k], camera.kind == "perspective", grid[y0 + 1 : y1 + 1, x0 + 1 : x1 + 1].reshape(-1, 2))
        box = depth[y0:y1, x0:x1]
        t = t.reshape(box.shape)
        nearer = t < box - _kernels.TIE
        box[nearer] = t[nearer]
        part[y0:y1, x0:x1][nearer] = k
    seen = part >= 0
    normal[seen] = pill_normal(table[part[seen]], surface_points(camera, grid[1:-1, 1:-1][seen], depth[seen]))
    return RenderBuffers(depth, part, normal)


def first_hits(
    table: Float[np.ndarray, "l p"], camera: Camera, xy: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Depth (inf) and part (-1 where missed) on rays given by normalised coordinates; plain NumPy."""
    depth, part = np.full(xy.shape[0], np.inf), np.full(xy.shape[0], -1)
    for k in range(table.shape[0]):
        t = pill_depth(table[k], camera.kind == "perspective", xy)
        nearer = t < depth - _kernels.TIE
        depth[nearer] = t[nearer]
        part[nearer] = k
    return depth, part
