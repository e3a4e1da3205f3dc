"""An image and posed pills in, the pixels that show the inside of a surface out, with their shading residuals.

A pixel counts where it and its neighbours on all four sides hit the same link: away from every outline, where blur
and other surfaces mix in, and from creases between links.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from . import _kernels
from .appearance import Appearance, shaded
from .camera import pixels_per_unit, project_camera, rays
from .kinematics import forward, link_ends, pose_from_free
from .pills import Pills, ray_hits
from .residuals import Chain, in_world

_RIM = 0.88  # outermost pixels, in radii
_CLOSEST = 3.0  # pixels between pixels
_BLACK, _WHITE = 1.5, 253.5  # grey levels that a sensor may have cut
_CELLS = 3  # patches along and across a link


@dataclass(frozen=True, slots=True, eq=False)
class Pixels:
    """Pixels on the visible surface of links.

    Attributes
    ----------
    ray : (n, 6)
        Origin and direction of each pixel's ray, world axes.
    link, patch : (n,)
        Link, and patch of the surface, numbered from 0 without gaps: errors of the shading are shared in a patch.
    level : (n,)
        Grey level.
    """

    ray: Float[np.ndarray, "n 6"]
    link: Int[np.ndarray, " n"]
    patch: Int[np.ndarray, " n"]
    level: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class Shaded:
    """Residuals `(level - expected) / noise`, their Jacobian by the free joints, normals in camera axes, levels."""

    r: Float[np.ndarray, " n"]
    J: Float[np.ndarray, "n k"]
    normal: Float[np.ndarray, "n 3"]
    expected: Float[np.ndarray, " n"]


def surface_pixels(image: Float[np.ndarray, "h w"], on: Chain, pills: Pills, blur: float, most: int = 1500) -> Pixels:
    """Whole pixels on a grid along every link that show nothing but its surface; about `most` of them at the most."""
    camera = on.camera
    base, tip = project_camera(camera, pills.base), project_camera(camera, pills.tip)
    radius = pills.radius.mean(axis=1) * pixels_per_unit(camera, 0.5 * (pills.base + pills.tip))
    length = np.linalg.norm(tip - base, axis=1)
    usable = np.isfinite(length) & np.isfinite(radius)
    area = float((2.0 * radius[usable] * (length[usable] + radius[usable])).sum())
    spacing = max(_CLOSEST, np.sqrt(area / most))
    grids = [_grid(base[k], tip[k], float(length[k]), float(radius[k]), spacing) for k in np.flatnonzero(usable)]
    if not grids:
        return _none()
    xy = np.rint(np.concatenate([grid[0] for grid in grids]))
    cell = np.concatenate([grid[1] for grid in grids])
    link = np.repeat(np.flatnonzero(usable), [len(grid[1]) for grid in grids])
    margin = 2.5 * blur + 1.5
    inside = (xy >= margin).all(axis=1) & (xy <= [camera.width - 1 - margin, camera.height - 1 - margin]).all(axis=1)
    xy, cell, link = xy[inside], cell[inside], link[inside]
    ray = np.hstack(rays(camera, xy))
    own = _all_around(camera, pills, xy, ray, link, margin)
    column, row = xy[own].astype(int).T
    level = image[row, column].astype(float)
    kept = (level > _BLACK) & (level < _WHITE)
    if not kept.any():
        return _none()
    world, _ = in_world(camera, ray[own][kept], ray[own][kept])
    link = link[own][kept]
    patch = np.unique(_CELLS * _CELLS * link + cell[own][kept], return_inverse=True)[1]
    return Pixels(np.ascontiguousarray(world), link, patch, level[kept])


def _grid(
    base: Float[np.ndarray, " 2"], tip: Float[np.ndarray, " 2"], length: float, radius: float, spacing: float
) -> tuple[Float[np.ndarray, "n 2"], Int[np.ndarray, " n"]]:
    """Points on one link in the image, from beyond its base to beyond its tip, and the patch cell of each."""
    axis = (tip - base) / length if length > 1e-6 else np.array([1.0, 0.0])
    reach = length + 2.0 * _RIM * radius
    along = np.linspace(-_RIM * radius, length + _RIM * radius, max(int(reach / spacing), 2))
    across = np.linspace(-_RIM * radius, _RIM * radius, max(int(2.0 * _RIM * radius / spacing), 2))
    a, c = (part.ravel() for part in np.meshgrid(along, across, indexing="ij"))
    normal = np.array([-axis[1], axis[0]])
    place = [
        np.minimum((_CELLS * (a / reach + _RIM * radius / reach)).astype(int), _CELLS - 1),
        np.minimum((_CELLS * 0.5 * (c / (_RIM * radius) + 1.0)).astype(int), _CELLS - 1),
    ]
    return base + a[:, None] * axis + c[:, None] * normal, _CELLS * place[0] + place[1]


def _all_around(
    camera, pills: Pills, xy: Float[np.ndarray, "n 2"], ray: Float[np.ndarray, "n 6"], link, margin: float
) -> Bool[np.ndarray, " n"]:
    """Whether a pixel and its neighbours at a distance hit the link."""
    own = np.ones(link.size, dtype=bool)
    for step in ((0.0, 0.0), (margin, 0.0), (-margin, 0.0), (0.0, margin), (0.0, -margin)):
        left = np.flatnonzero(own)
        at = np.hstack(rays(camera, xy[left] + step)) if any(step) else ray[left]
        own[left] = ray_hits(pills, at[:, :3], at[:, 3:]).pill == link[left]
    return own


def _none() -> Pixels:
    nothing = np.zeros(0, dtype=np.int64)
    return Pixels(np.zeros((0, 6)), nothing, nothing, np.zeros(0))


def pixel_rows(on: Chain, pixels: Pixels, appearance: Appearance, u: Float[np.ndarray, " k"]) -> Shaded:
    """Shading residuals in units of the noise and their Jacobian; zero for a pixel whose link has moved off it."""
    model, n = on.model, pixels.link.size
    r, J = np.empty(n), np.empty((n, len(model.joint_names)))
    normal, expected = np.empty((n, 3)), np.empty(n)
    tree = (
        forward(model, pose_from_free(model, u)),
        model.link_frame,
        model.link_base,
        model.link_tip,
        model.link_radius,
        on.moves,
        on.joint_frame,
        model.prismatic,
    )
    _kernels.pixel_rows(
        pixels.ray,
        pixels.link,
        pixels.level,
        appearance.noise,
        tree,
        on.camera.R,
        appearance.shading,
        appearance.gain,
        r,
        J,
        normal,
        expected,
    )
    return Shaded(r, J if on.plain else J @ model.coupling, normal, expected)


def pixel_rows_numpy(on: Chain, pixels: Pixels, appearance: Appearance, u: Float[np.ndarray, " k"]) -> Shaded:
    """The same as `pixel_rows` in plain NumPy, the normals' motion by central differences: the kernel's twin."""

    def normals(v: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n 3"]:
        ends = link_ends(on.model, forward(on.model, pose_from_free(on.model, v)))
        out = np.zeros((pixels.link.size, 3))
        for k in np.unique(pixels.link):
            at = pixels.link == k
            pill = Pills(ends[0][k : k + 1], ends[1][k : k + 1], on.model.link_radius[k : k + 1])
            out[at] = ray_hits(pill, pixels.ray[at, :3], pixels.ray[at, 3:]).normal
        return out @ on.camera.R.T

    def level(v: Float[np.ndarray, " k"]) -> Float[np.ndarray, " n"]:
        return appearance.gain[pixels.link] * shaded(appearance.shading, normals(v))

    step = 1e-6
    J = np.stack([-(level(u + e) - level(u - e)) / (2.0 * step) for e in step * np.eye(u.size)], axis=1)
    expected = level(u)
    return Shaded((pixels.level - expected) / appearance.noise, J / appearance.noise, normals(u), expected)
