"""Pills and a camera in, depth, part number and normal of every pixel out, by exact ray-pill intersection.

Every pixel centre has one ray; the first pill on it is what the pixel shows (the Z-buffer of the hand thesis, section 10.2,
without facets). Each pill is tried only inside a box of pixels that surely holds its silhouette. Lens distortion bends the
rays, not the picture: the normalised coordinates of all pixels are computed once per camera.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from handtrack.camera import Camera, distort, rays
from handtrack.pills import Pills, ray_hits_numpy

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


def ray_arrays(
    camera: Camera, xy: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Origins and directions of the rays with the given normalised coordinates."""
    across = np.column_stack([xy, np.zeros(xy.shape[0])])
    ahead = np.tile([0.0, 0.0, 1.0], (xy.shape[0], 1))
    return (across, ahead) if camera.kind == "orthographic" else (np.zeros_like(across), across + ahead)


def pill_boxes(pills: Pills, camera: Camera) -> Int[np.ndarray, "l 4"]:
    """Pixel boxes (x0, x1, y0, y1), half open and clipped to the image, that hold each pill's silhouette.

    The silhouette of a convex hull is the hull of the two spheres' silhouettes. A sphere lies in a cube; the image of the
    cube in front of a pinhole is bounded by its near and far faces. A pill that reaches behind the pinhole gets the whole image.
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
    edge = pixel_grid(camera)[[0, -1]].reshape(-1, 2), pixel_grid(camera)[:, [0, -1]].reshape(-1, 2)
    view = np.concatenate(edge)  # the outermost rays of the image; far beyond them the distortion may fold
    low, high = np.clip([low, high], view.min(axis=0), view.max(axis=0))
    s = np.linspace(0.0, 1.0, 17)
    border = np.concatenate(
        [np.column_stack([a, b]) for a, b in ((s, 0 * s), (s, 0 * s + 1), (0 * s, s), (0 * s + 1, s))]
    )
    bent = distort(low[:, None] + border * (high - low)[:, None], camera.distortion) * focal + centre
    spare = 2.0 + 0.02 * (bent.max(axis=1) - bent.min(axis=1))  # the border bulges between its samples
    return bent.min(axis=1) - spare, bent.max(axis=1) + spare


def kernel_pills(
    pills: Pills,
) -> tuple[Float[np.ndarray, "l 3"], Float[np.ndarray, "l 3"], Float[np.ndarray, "l 2"]]:
    """Axis bases, tips and radii as the contiguous arrays that the kernels take."""
    base, tip, radius = (np.ascontiguousarray(a, dtype=float) for a in (pills.base, pills.tip, pills.radius))
    return base, tip, radius


def _empty_buffers(camera: Camera) -> RenderBuffers:
    shape = (camera.height, camera.width)
    return RenderBuffers(np.full(shape, np.inf), np.full(shape, -1, dtype=np.int32), np.zeros((*shape, 3)))


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
    buffers = _empty_buffers(camera)
    _kernels.cast_pixels(
        pixel_grid(camera),
        camera.kind == "perspective",
        kernel_pills(pills),
        pill_boxes(pills, camera),
        buffers.depth,
        buffers.part,
        buffers.normal,
    )
    return buffers


def cast_numpy(pills: Pills, camera: Camera) -> RenderBuffers:
    """The same as `cast` in plain NumPy, one pill and its box after the other: the twin of `_kernels.cast_pixels`."""
    buffers = _empty_buffers(camera)
    grid = pixel_grid(camera)
    for k, (x0, x1, y0, y1) in enumerate(pill_boxes(pills, camera)):
        if x0 >= x1 or y0 >= y1:
            continue
        xy = grid[y0 + 1 : y1 + 1, x0 + 1 : x1 + 1].reshape(-1, 2)
        t, _, normal = first_hits(Pills(pills.base[k : k + 1], pills.tip[k : k + 1], pills.radius[k : k + 1]), camera, xy)
        t = t.reshape(y1 - y0, x1 - x0)
        depth = buffers.depth[y0:y1, x0:x1]
        nearer = t < depth
        depth[nearer] = t[nearer]
        buffers.part[y0:y1, x0:x1][nearer] = k
        buffers.normal[y0:y1, x0:x1][nearer] = normal[nearer.ravel()]
    return buffers


def first_hits(
    pills: Pills, camera: Camera, xy: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Depth, part and normal on rays given by normalised coordinates, plain NumPy; nothing behind a pinhole counts."""
    origin, direction = ray_arrays(camera, xy)
    depth, part, normal = np.full(xy.shape[0], np.inf), np.full(xy.shape[0], -1), np.zeros((xy.shape[0], 3))
    for k in range(pills.base.shape[0]):
        one = Pills(pills.base[k : k + 1], pills.tip[k : k + 1], pills.radius[k : k + 1])
        hits = ray_hits_numpy(one, origin, direction)
        nearer = (hits.t < depth) & ((hits.t > 0) | (camera.kind == "orthographic"))
        depth = np.where(nearer, hits.t, depth)
        part[nearer] = k
        normal[nearer] = hits.normal[nearer]
    return depth, part, normal
