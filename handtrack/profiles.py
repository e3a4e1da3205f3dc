"""Image and posed pills in, placed samplers and intensity profiles out (hand thesis, 4.1 and 4.2).

A sampler is a short straight path over the image. The thesis lays it across a link, centred on the axis; for the
outline residuals it is centred on the silhouette instead, one on each side and a fan around each finger tip, so that
its coordinate u is zero where the model says the edge is, and grows outwards. Both come from the contact normals of
the silhouette: unit vectors n for which the plane (perspective: through the camera centre) that touches the pill at
`c(s) + r(s) n` contains the line of sight.
"""

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from . import _kernels
from .camera import Camera, project_camera, rays
from .pills import Pills

SIDE, CAP = 0, 1
Interpolation = Literal["nearest", "bilinear", "bicubic"]
_FAN = tuple(np.radians([-60.0, -30.0, 0.0, 30.0, 60.0]).tolist())
_ORDER = {"nearest": 0, "bilinear": 1, "bicubic": 3}


@dataclass(frozen=True, slots=True, eq=False)
class Samplers:
    """Straight sampling paths.

    Attributes
    ----------
    origin, direction : (n, 2)
        Pixel where u = 0, and unit vector along which u grows.
    link, along : (n,)
        Link that the sampler measures, and axial position s in [0, 1] on it.
    side : (n,)
        +1 or -1 for the two sides of a link, 0 for a tip.
    kind : (n,)
        SIDE or CAP.
    contact : (n, 3)
        The surface point, in camera axes, seen at the origin.
    ray, slope : (n, 6)
        Origin and direction, in camera axes, of the ray through the origin, and their change for one pixel along u.
    """

    origin: Float[np.ndarray, "n 2"]
    direction: Float[np.ndarray, "n 2"]
    link: Int[np.ndarray, " n"]
    along: Float[np.ndarray, " n"]
    side: Int[np.ndarray, " n"]
    kind: Int[np.ndarray, " n"]
    contact: Float[np.ndarray, "n 3"]
    ray: Float[np.ndarray, "n 6"]
    slope: Float[np.ndarray, "n 6"]


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """Intensities along samplers at common positions u; `inside` is False where the path has left the image."""

    u: Float[np.ndarray, " m"]
    values: Float[np.ndarray, "n m"]
    inside: Bool[np.ndarray, "n m"]


def uniform_spread(count: int) -> Float[np.ndarray, " count"]:
    """Positions `1/(n+1), ..., n/(n+1)` of samplers along a link (hand thesis, appendix B, below (9.3)).

    >>> uniform_spread(3).tolist()
    [0.25, 0.5, 0.75]
    """
    return np.arange(1, count + 1) / (count + 1)


def contact_normals(
    pills: Pills, link: Int[np.ndarray, " n"], side: Float[np.ndarray, " n"], camera: Camera
) -> Float[np.ndarray, "n 3"]:
    """Outward unit normals, in camera axes, where a link's silhouette touches its surface, on side +1 or -1.

    Perspective: the touching plane passes the camera centre, `n . c = -r` at both ends. Orthographic: `n . z = 0` and
    `n . (c1 - c0) = r0 - r1`. NaN where one end sphere hides the other and the silhouette has no sides.
    """
    c0, c1 = pills.base[link], pills.tip[link]
    r0, r1 = pills.radius[link, 0], pills.radius[link, 1]
    if camera.kind == "orthographic":
        e1, e2 = c1 - c0, np.broadcast_to([0.0, 0.0, 1.0], c0.shape)
        b1, b2 = r0 - r1, np.zeros(link.shape)
    else:
        e1, e2, b1, b2 = c0, c1, -r0, -r1
    # n = x e1 + y e2 + z (e1 x e2): two linear conditions, and the sign of z picks the side.
    g11, g12, g22 = (e1 * e1).sum(1), (e1 * e2).sum(1), (e2 * e2).sum(1)
    if camera.kind == "orthographic":  # keep only what is seen of the axis
        e1 = e1 - g12[:, None] * e2
        g11, g12 = (e1 * e1).sum(1), np.zeros(link.shape)
    det = g11 * g22 - g12 * g12
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = (g22 * b1 - g12 * b2) / det, (g11 * b2 - g12 * b1) / det
        planar = x[:, None] * e1 + y[:, None] * e2
        rest = np.sqrt(1.0 - (planar * planar).sum(1))
        across = np.cross(e1, e2) / np.sqrt(det)[:, None]
    return planar + (side * rest)[:, None] * across


def cap_normals(
    pills: Pills, link: Int[np.ndarray, " n"], angle: Float[np.ndarray, " n"], camera: Camera
) -> Float[np.ndarray, "n 3"]:
    """Outward unit normals on the silhouette of a link's tip sphere, `angle` radians from its seen axis."""
    c, axis = pills.tip[link], pills.tip[link] - pills.base[link]
    if camera.kind == "orthographic":
        sight, sin_beta = np.broadcast_to([0.0, 0.0, 1.0], c.shape), np.zeros(link.shape)
    else:
        distance = np.linalg.norm(c, axis=1)
        sight, sin_beta = c / distance[:, None], pills.radius[link, 1] / distance
    e1 = axis - (axis * sight).sum(1, keepdims=True) * sight
    e1 = e1 / np.maximum(np.linalg.norm(e1, axis=1, keepdims=True), 1e-12)
    e2 = np.cross(sight, e1)
    across = np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2
    return np.sqrt(1.0 - sin_beta**2)[:, None] * across - sin_beta[:, None] * sight


def place_outline(
    pills: Pills,
    camera: Camera,
    tips: Bool[np.ndarray, " l"],
    spacing: float = 8.0,
    most: int = 16,
    fan: Float[np.ndarray, " k"] | None = None,
) -> Samplers:
    """Samplers on the silhouette: along both sides of every link, and a fan around every tip.

    Parameters
    ----------
    tips : (l,)
        Links that end a finger; only these have a fan.
    spacing, most : float, int
        Wanted distance of neighbouring samplers in pixels, and the most on one side of a link.
    fan : (k,)
        Angles of the tip's samplers from the seen axis, radians; default five from -60 to 60 degrees.
    """
    link, along, side, angle = _outline_places(pills, camera, tips, spacing, most, fan)
    n = link.size
    origin, direction, contact = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 3))
    ray, slope, kept = np.empty((n, 6)), np.empty((n, 6)), np.empty(n, dtype=np.bool_)
    _kernels.place_outline(
        pills.base,
        pills.tip,
        pills.radius,
        link,
        along,
        side,
        angle,
        camera.kind == "orthographic",
        _intrinsic(camera),
        camera.distortion,
        origin,
        direction,
        contact,
        ray,
        slope,
        kept,
    )
    found = Samplers(origin, direction, link, along, side, np.where(side == 0, CAP, SIDE), contact, ray, slope)
    return found if kept.all() else _only(found, kept)


def place_outline_numpy(
    pills: Pills,
    camera: Camera,
    tips: Bool[np.ndarray, " l"],
    spacing: float = 8.0,
    most: int = 16,
    fan: Float[np.ndarray, " k"] | None = None,
) -> Samplers:
    """The same as `place_outline` in plain NumPy: the twin of the compiled kernel."""
    link, along, side, angle = _outline_places(pills, camera, tips, spacing, most, fan)
    sides = side != 0
    normal = np.empty((link.size, 3))
    normal[sides] = contact_normals(pills, link[sides], side[sides].astype(float), camera)
    normal[~sides] = cap_normals(pills, link[~sides], angle[~sides], camera)
    kept = np.isfinite(normal).all(axis=1)
    kind = np.where(side == 0, CAP, SIDE)
    return _on_surface(pills, camera, link[kept], along[kept], side[kept], kind[kept], normal[kept])


def _outline_places(
    pills: Pills,
    camera: Camera,
    tips: Bool[np.ndarray, " l"],
    spacing: float,
    most: int,
    fan: Float[np.ndarray, " k"] | None,
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Link, axial position, side and (for tips) angle of every outline sampler."""
    count = _kernels.count_samplers(
        pills.base,
        pills.tip,
        camera.kind == "orthographic",
        _intrinsic(camera),
        camera.distortion,
        float(spacing),
        most,
    )
    angles = _FAN if fan is None else tuple(fan.tolist())
    return _laid_out(tuple(count.tolist()), tuple(np.flatnonzero(tips).tolist()), angles)


def side_counts(pills: Pills, camera: Camera, spacing: float, most: int) -> Int[np.ndarray, " l"]:
    """Samplers on one side of every link, in plain NumPy: the twin of the compiled `count_samplers`."""
    ends = project_camera(camera, np.stack([pills.base, pills.tip]))
    length = np.linalg.norm(ends[1] - ends[0], axis=1)
    return np.clip(np.where(length > 0.0, length, 0.0) / spacing, 2, most).astype(int)


def _intrinsic(camera: Camera) -> Float[np.ndarray, " 4"]:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])


@lru_cache(maxsize=256)
def _laid_out(
    count: tuple[int, ...], tips: tuple[int, ...], fan: tuple[float, ...]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    link_one = np.repeat(np.arange(len(count)), count)
    along_one = np.concatenate([uniform_spread(c) for c in count])
    tip_links = np.repeat(np.array(tips, dtype=int), len(fan))
    link = np.concatenate([link_one, link_one, tip_links])
    along = np.concatenate([along_one, along_one, np.ones(tip_links.size)])
    side = np.repeat(np.array([1, -1, 0]), [link_one.size, link_one.size, tip_links.size])
    angle = np.concatenate([np.zeros(2 * link_one.size), np.tile(fan, len(tips))])
    for shared in (link, along, side, angle):
        shared.setflags(write=False)
    return link, along, side, angle


def outside(samplers: Samplers, buried: Float[np.ndarray, " l"]) -> Samplers:
    """Samplers but those on the share of each link, from its base, that is buried in what the model lacks."""
    return _only(samplers, (samplers.side == 0) | (samplers.along >= buried[samplers.link]))


def _only(samplers: Samplers, kept: Bool[np.ndarray, " n"]) -> Samplers:
    return Samplers(*(getattr(samplers, field.name)[kept] for field in fields(samplers)))


def with_rays(
    camera: Camera,
    origin: Float[np.ndarray, "n 2"],
    direction: Float[np.ndarray, "n 2"],
    link: Int[np.ndarray, " n"],
    along: Float[np.ndarray, " n"],
    side: Int[np.ndarray, " n"],
    kind: Int[np.ndarray, " n"],
    contact: Float[np.ndarray, "n 3"],
) -> Samplers:
    """Samplers with the rays that follow from their pixels."""
    ahead, behind = np.hstack(rays(camera, origin + direction)), np.hstack(rays(camera, origin - direction))
    return Samplers(
        origin, direction, link, along, side, kind, contact, np.hstack(rays(camera, origin)), 0.5 * (ahead - behind)
    )


def _on_surface(
    pills: Pills,
    camera: Camera,
    link: Int[np.ndarray, " n"],
    along: Float[np.ndarray, " n"],
    side: Int[np.ndarray, " n"],
    kind: Int[np.ndarray, " n"],
    normal: Float[np.ndarray, "n 3"],
) -> Samplers:
    radius = pills.radius[link, 0] + along * (pills.radius[link, 1] - pills.radius[link, 0])
    axis_point = pills.base[link] + along[:, None] * (pills.tip[link] - pills.base[link])
    contact = axis_point + radius[:, None] * normal
    origin = project_camera(camera, contact)
    # The silhouette's image normal: its plane cuts the image in a line whose normal is the plane's (x, y).
    across = normal[:, :2] / (camera.fx, camera.fy)
    direction = across / np.linalg.norm(across, axis=1, keepdims=True)
    seen = np.isfinite(origin).all(axis=1)
    found = (origin, direction, link, along, side, kind, contact)
    return with_rays(camera, *(values[seen] for values in found))


def place_across(pills: Pills, camera: Camera, count: int = 6) -> Samplers:
    """The thesis's link samplers: `count` across each link, centred on its projected axis (4.1, Figure 4.2).

    `side` is 0, and u grows towards side +1 of `contact_normals`.
    """
    link = np.repeat(np.arange(pills.base.shape[0]), count)
    along = np.tile(uniform_spread(count), pills.base.shape[0])
    ends = project_camera(camera, np.stack([pills.base, pills.tip]))
    axis = ends[1] - ends[0]
    length = np.linalg.norm(axis, axis=1)
    kept = length[link] > 1.0  # a link seen end on has no direction across
    link, along = link[kept], along[kept]
    normal = np.stack([-axis[:, 1], axis[:, 0]], axis=1)[link] / length[link, None]
    towards = contact_normals(pills, link, np.ones(link.size), camera)[:, :2]
    flip = np.where((np.nan_to_num(towards) * normal).sum(axis=1) < 0, -1.0, 1.0)
    point = pills.base[link] + along[:, None] * (pills.tip[link] - pills.base[link])
    zero = np.zeros(link.size, dtype=int)
    return with_rays(
        camera, project_camera(camera, point), flip[:, None] * normal, link, along, zero, zero + SIDE, point
    )


def place_tips(
    pills: Pills,
    camera: Camera,
    link: Int[np.ndarray, " n"],
    origin: Float[np.ndarray, "n 2"],
    direction: Float[np.ndarray, "n 2"],
) -> Samplers:
    """Tip samplers on given axial lines: centred on the refined tip of eq. (4.1) and heading along the line."""
    n = link.size
    zero = np.zeros(n, dtype=int)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return with_rays(camera, origin, unit, link, np.ones(n), zero, zero + CAP, pills.tip[link])


def sample(
    image: Float[np.ndarray, "h w"], samplers: Samplers, u: Float[np.ndarray, " m"], method: Interpolation = "bilinear"
) -> Profiles:
    """Interpolated intensities at `origin + u direction` (hand thesis, 4.2).

    Parameters
    ----------
    u : (m,)
        Positions along every sampler, pixels.
    method : 'nearest', 'bilinear' or 'bicubic'
        Bicubic is Keys' kernel with a = -1/2. Positions beyond the outermost pixel centres are not inside.
    """
    values, inside = (
        np.empty((samplers.origin.shape[0], u.size)),
        np.empty((samplers.origin.shape[0], u.size), dtype=np.bool_),
    )
    _kernels.sample_lines(image, samplers.origin, samplers.direction, u, _ORDER[method], values, inside)
    return Profiles(u, values, inside)


def sample_points(
    image: Float[np.ndarray, "h w"], xy: Float[np.ndarray, "n 2"], method: Interpolation = "bilinear"
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Interpolated intensities at single pixels, and which of them are inside the image."""
    values, inside = np.empty((xy.shape[0], 1)), np.empty((xy.shape[0], 1), dtype=np.bool_)
    _kernels.sample_lines(image, xy, np.zeros_like(xy), np.zeros(1), _ORDER[method], values, inside)
    return values[:, 0], inside[:, 0]


def sample_numpy(
    image: Float[np.ndarray, "h w"], samplers: Samplers, u: Float[np.ndarray, " m"], method: Interpolation = "bilinear"
) -> Profiles:
    """The same as `sample` in plain NumPy: the twin of the compiled kernel."""
    height, width = image.shape
    xy = samplers.origin[:, None, :] + u[None, :, None] * samplers.direction[:, None, :]
    x, y = xy[..., 0], xy[..., 1]
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    if method == "nearest":
        found = image[np.floor(y + 0.5).astype(int), np.floor(x + 0.5).astype(int)]
        return Profiles(u, np.where(inside, found, 0.0).astype(float), inside)
    reach = (0, 1) if method == "bilinear" else (-1, 0, 1, 2)
    x0, y0 = np.floor(x), np.floor(y)
    total = np.zeros(x.shape)
    for i in reach:
        row = np.clip(y0 + i, 0, height - 1).astype(int)
        for k in reach:
            column = np.clip(x0 + k, 0, width - 1).astype(int)
            total += image[row, column] * _weight(y - y0 - i, method) * _weight(x - x0 - k, method)
    return Profiles(u, np.where(inside, total, 0.0), inside)


def _weight(distance: Float[np.ndarray, "n m"], method: Interpolation) -> Float[np.ndarray, "n m"]:
    d = np.abs(distance)
    if method == "bilinear":
        return np.maximum(1.0 - d, 0.0)
    near = 1.0 + d * d * (1.5 * d - 2.5)
    far = 2.0 + d * (-4.0 + d * (2.5 - 0.5 * d))
    return np.where(d <= 1.0, near, np.where(d < 2.0, far, 0.0))
