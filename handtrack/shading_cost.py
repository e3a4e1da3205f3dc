"""An image and a posed model in, how badly the grey levels of its surface fit the learnt light out.

Two poses with the same outline show different normals, and light from the side tells them apart. The grey levels of
pixels well inside every link are compared with the shading that earlier frames taught, with a gain of each link left
free within five per cent. Errors of the shading are shared by neighbouring pixels, so every patch of a link counts
once, and the patches of a link together as two independent readings:

    cost = sum over links of 2 mean_p rho(z_p),     z_p = mean residual of patch p / scatter about the shading

with Cauchy's loss rho. The cost is half a chi-square: differences are log ratios of likelihoods.
"""

import numpy as np
from jaxtyping import Bool, Float

from . import _kernels
from .appearance import Appearance, shaded
from .camera import Camera, pixels_per_unit, project_camera, rays
from .measure import posed
from .pills import Pills, ray_hits_numpy
from .residuals import Chain
from .robust import CAUCHY_C

_READINGS = 2.0
_GAIN_SIGMA = 0.05
_RIM, _CLOSEST, _PIXELS = 0.88, 3.0, 400.0  # outermost pixels in radii, pixels between pixels, about how many
_BLACK, _WHITE = 1.5, 253.5  # grey levels that a sensor may have cut
UNREAD = 0.5  # what a reading of a right pose costs on average: half a chi-square's mean


def shading_cost(
    image: Float[np.ndarray, "h w"],
    on: Chain,
    u: Float[np.ndarray, " k"],
    appearance: Appearance,
    wanted: Bool[np.ndarray, " l"] | None = None,
) -> Float[np.ndarray, " l"]:
    """Cost of the grey levels at a pose.

    Parameters
    ----------
    image : (h, w)
        Grey levels 0 to 255.
    u : (k,)
        Independent joints.
    appearance : Appearance
        Learnt before this image.
    wanted : (l,), optional
        Links to read; the others count as unread.

    Returns
    -------
    (l,)
        For each link half a chi-square of about two readings; one that cannot be read costs what a right one does.

    Examples
    --------
    >>> loss(np.array([0.0, 2.385]), np.array([1.0, 1.0])).round(3).tolist()
    [0.0, 1.971]
    """
    pills = posed(on, u)
    wanted = np.ones(pills.base.shape[0], dtype=np.bool_) if wanted is None else wanted
    count, level, off = np.moveaxis(read_patches(image, pills, on.camera, appearance, wanted), 2, 0)
    there = count > 0
    level, off = level / np.maximum(count, 1.0), off / np.maximum(count, 1.0)
    spread = max(appearance.spread, appearance.noise)
    gain = (level * off).sum(axis=1) / ((level * level).sum(axis=1) + (spread / _GAIN_SIGMA) ** 2)
    cost = np.where(there, loss(off - gain[:, None] * level, spread), 0.0).sum(axis=1)
    cost = cost + 0.5 / _GAIN_SIGMA**2 * gain**2
    patches = there.sum(axis=1)
    return np.where(patches > 0, _READINGS * cost / np.maximum(patches, 1), _READINGS * UNREAD)


def read_patches(
    image: Float[np.ndarray, "h w"], pills: Pills, camera: Camera, look: Appearance, wanted: Bool[np.ndarray, " l"]
) -> Float[np.ndarray, "l 9 3"]:
    """Number of pixels, sum of their expected levels and of what they differ by, in nine patches of each link.

    Whole pixels on a grid along every link; one counts where it and its neighbours on all four sides show the link:
    away from every outline, where blur and other surfaces mix in, and from creases between links.
    """
    sums = np.empty((pills.base.shape[0], 9, 3))
    _kernels.read_patches(
        image,
        pills.base,
        pills.tip,
        pills.radius,
        wanted,
        camera.kind == "orthographic",
        np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        camera.distortion,
        look.blur,
        look.shading,
        look.gain,
        (_RIM, _CLOSEST, _PIXELS, _BLACK, _WHITE),
        sums,
    )
    return sums


def read_patches_numpy(
    image: Float[np.ndarray, "h w"], pills: Pills, camera: Camera, look: Appearance, wanted: Bool[np.ndarray, " l"]
) -> Float[np.ndarray, "l 9 3"]:
    """The same as `read_patches` in plain NumPy: the twin of the compiled kernel."""
    base, tip = project_camera(camera, pills.base), project_camera(camera, pills.tip)
    size = pills.radius.mean(axis=1) * pixels_per_unit(camera, 0.5 * (pills.base + pills.tip))
    length = np.linalg.norm(tip - base, axis=1)
    there = np.isfinite(length)
    area = float((2.0 * size[there] * (length[there] + size[there])).sum())
    spacing, margin = max(_CLOSEST, np.sqrt(area / _PIXELS)), 2.5 * look.blur + 1.5
    sums = np.zeros((length.size, 9, 3))
    for k in np.flatnonzero(wanted & there):
        axis = (tip[k] - base[k]) / length[k] if length[k] > 1e-6 else np.array([1.0, 0.0])
        outer = _RIM * size[k]
        reach = length[k] + 2.0 * outer
        along = np.linspace(-outer, length[k] + outer, max(int(reach / spacing), 2))
        across = np.linspace(-outer, outer, max(int(2.0 * outer / spacing), 2))
        s, c = (part.ravel() for part in np.meshgrid(along, across, indexing="ij"))
        i, j = (part.ravel() for part in np.indices((along.size, across.size)))
        xy = np.rint(base[k] + s[:, None] * axis + c[:, None] * np.array([-axis[1], axis[0]]))
        cell = 3 * np.minimum(3 * i // (along.size - 1), 2) + np.minimum(3 * j // (across.size - 1), 2)
        last = np.array([camera.width - 1, camera.height - 1]) - margin
        kept = (xy >= margin).all(axis=1) & (xy <= last).all(axis=1)
        xy, cell = xy[kept], cell[kept]
        own = np.ones(cell.size, dtype=bool)
        for step in ((margin, 0.0), (-margin, 0.0), (0.0, margin), (0.0, -margin)):
            own &= ray_hits_numpy(pills, *rays(camera, xy + step)).pill == k
        hits = ray_hits_numpy(pills, *rays(camera, xy))
        level = image[xy[:, 1].astype(int), xy[:, 0].astype(int)].astype(float)
        own &= (hits.pill == k) & (level > _BLACK) & (level < _WHITE)
        expected = look.gain[k] * shaded(look.shading, hits.normal)
        for column, value in enumerate((np.ones(level.size), expected, level - expected)):
            sums[k, :, column] = np.bincount(cell[own], value[own], 9)
    return sums


def loss(r: Float[np.ndarray, "*n"], sigma: float | Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Cauchy's loss of residuals with standard deviation sigma; half a chi-square for small ones."""
    return 0.5 * CAUCHY_C**2 * np.log1p((r / (CAUCHY_C * sigma)) ** 2)
