"""An image and posed pills in, how the rendered image differs from it out: samples, residuals, normal equations.

The image is compared with the smooth image of the pills (`soft_image`) in samples: blocks of pixels inside surfaces
and single pixels on outlines and creases. Besides the pose u, each patch of surface has two nuisances b, a relative
error of its grey level and an outward shift (what the shading and the pills cannot express), with variances Lambda^-1:

    r = seen - I(u) - B b,    A = J^T W J - J^T W B (B^T W B + Lambda)^-1 B^T W J.

Every sample belongs to one patch, so the eliminated matrix is made of 2 x 2 blocks.
"""

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from . import _kernels
from ._kernels.soft_rows import PATCHES, UNKNOWN
from .appearance import Appearance
from .camera import Camera, pixels_per_unit, project_camera
from .kinematics import forward, link_ends, point_jacobian, pose_from_free
from .pills import Pills, clearance, pose_pills
from .residuals import Chain
from .robust import median
from .soft_image import lens_blur, pill_boxes, ray_grid

_MOST, _WANTED = 6000, 225.0  # samples that are kept at the most; wanted on outlines, for each grey level of noise
_FEWEST, _PLENTY = 450.0, 1800.0
_BAND = 2.4  # pixels: width of the band along an outline where pixels show both sides
_CUT = 3.0  # residual at which a sample counts half
_FIRST = (0.03, 0.02, 0.5)  # errors of a patch: grey level (relative), shift (pixels); of a sample: grey levels
COMMON = 1.0  # variance common to the patches of a link, in units of that of each
_CAUTION = 3.0  # factor on variances, measured on rendered hands: errors that all patches share say nothing in a frame


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Parts of an image to compare.

    Attributes
    ----------
    place : (n, 3)
        Middle (x, y) and side of the block, pixels.
    level : (n,)
        Mean grey level.
    pill : (n, 4)
        Pills that may show there, -1 where there are fewer.
    patch : (n,)
        Patch of surface that dominates it: 12 for each link.
    """

    place: Float[np.ndarray, "n 3"]
    level: Float[np.ndarray, " n"]
    pill: Int[np.ndarray, "n 4"]
    patch: Int[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """Expected levels (n,), derivatives by twists (n, 4, 6) and errors of the patch (n, 2), normals (n, 3)."""

    level: Float[np.ndarray, " n"]
    row: Float[np.ndarray, "n 4 6"]
    by_patch: Float[np.ndarray, "n 2"]
    normal: Float[np.ndarray, "n 3"]


@dataclass(frozen=True, slots=True, eq=False)
class Unmodelled:
    """What neither pills nor shading express, as standard deviations.

    Attributes
    ----------
    level, shift : float
        Of the relative error of a patch's grey level, and of its outward shift in pixels.
    grain : float
        Of a sample's grey level within its patch.
    table : (25, 25), optional
        Grey levels on top of the shading, over the x and y of the normal from -1 to 1, rows along y.
    sums : (2, 25, 25), optional
        Weights of its nodes so far, and weighted errors.
    """

    level: float = _FIRST[0]
    shift: float = _FIRST[1]
    grain: float = _FIRST[2]
    table: Float[np.ndarray, "t t"] | None = None
    sums: Float[np.ndarray, "2 t t"] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """What the samples of one view say of the pose, with the errors of the patches eliminated.

    Attributes
    ----------
    score : (p, k)
        Gradient to climb by the free joints, the part of each patch.
    A : (k, k)
        Information.
    samples, r, weight : Samples, (n,), (n,)
        Samples, residuals (seen - expected) in grey levels, and their weights.
    own, inverse, of_pose : (p, 2), (l, 24, 24), (l, 24, k)
        Gradient of the patches' errors, inverse of their information, and its product with what couples them to the
        pose.
    unit : float
        Pixels in one unit of the model at the hand.
    """

    score: Float[np.ndarray, "p k"]
    A: Float[np.ndarray, "k k"]
    samples: Samples
    r: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    seen: Rendered
    own: Float[np.ndarray, "p 2"]
    inverse: Float[np.ndarray, "l m m"]
    of_pose: Float[np.ndarray, "l m k"]
    unit: float

    def answer(self, step: Float[np.ndarray, " k"]) -> Float[np.ndarray, "p 2"]:
        """How the errors of the patches change when the pose takes a step."""
        links = self.inverse.shape[0]
        return (self.inverse @ self.own.reshape(links, -1, 1) - (self.of_pose @ step)[..., None]).reshape(-1, 2)


def link_twists(on: Chain, frames: Float[np.ndarray, "f 4 4"]) -> Float[np.ndarray, "m j"]:
    """Derivative of every link's twist in camera axes by all joint values: rows base velocity, angular velocity."""
    model, R = on.model, on.camera.R
    base, _ = link_ends(model, frames)
    velocity = R @ point_jacobian(model, frames, model.link_frame, base)
    axis = (frames[on.joint_frame, :3, 2] * ~model.prismatic[on.joint_frame][:, None]).T
    turning = R @ (axis * on.moves[model.link_frame][:, None, :])
    return np.concatenate([velocity, turning], axis=1).reshape(-1, len(model.joint_names))


@lru_cache(maxsize=8)
def _grid(camera: Camera) -> Float[np.ndarray, "h w 2"]:
    """Normalised coordinates of the pixels, of as few as tell all of them: `place_at` goes on from the nearest."""
    grid = ray_grid(camera)
    grid = grid if camera.distortion.any() else np.ascontiguousarray(grid[:2, :2])
    grid.flags.writeable = False
    return grid


def samples_of(
    image: Float[np.ndarray, "h w"],
    on: Chain,
    appearance: Appearance,
    u: Float[np.ndarray, " k"],
    table: Float[np.ndarray, "t t"] | None = None,
) -> tuple[Samples, Rendered]:
    """Samples where the pose u shows or ends pills, on outlines about as many as are worth their time, and rendered."""
    pills = pose_pills(on.model, forward(on.model, pose_from_free(on.model, u)), on.camera)
    return choose(image, pills, on.camera, appearance, _thinning(pills, on.camera, appearance.noise), table)


def _thinning(pills: Pills, camera: Camera, noise: float) -> int:
    """One pixel in so many on an outline is enough; never a multiple of three, which would comb vertical outlines."""
    base, tip = project_camera(camera, pills.base), project_camera(camera, pills.tip)
    radius = pills.radius.mean(axis=1) * pixels_per_unit(camera, 0.5 * (pills.base + pills.tip))
    around = 2.0 * np.linalg.norm(tip - base, axis=1) + np.pi * radius
    wanted = min(max(_WANTED * noise, _FEWEST), _PLENTY)
    thin = int(np.nansum(np.where(np.isfinite(around), around, 0.0)) * _BAND / wanted) + 1
    return thin + 1 if thin % 3 == 0 else thin


def choose(
    image: Float[np.ndarray, "h w"],
    pills: Pills,
    camera: Camera,
    appearance: Appearance,
    thin: int = 1,
    table: Float[np.ndarray, "t t"] | None = None,
) -> tuple[Samples, Rendered]:
    """Samples where the pills, in camera axes, show or end: blocks inside, one pixel in `thin` on outlines."""
    place, level, pill = np.empty((_MOST, 3)), np.empty(_MOST), np.empty((_MOST, 4), np.int64)
    n = _kernels.choose_samples(
        image,
        _grid(camera),
        camera.kind == "perspective",
        (pills.base, pills.tip, pills.radius),
        pill_boxes(pills, camera),
        lens_blur(appearance),
        thin,
        place,
        level,
        pill,
    )
    samples = Samples(place[:n], level[:n], pill[:n], np.full(n, UNKNOWN))
    seen = rendered(samples, pills, camera, appearance, table)  # which finds the patches
    kept = samples.patch != UNKNOWN
    return _part(samples, kept), _part(seen, kept)


def outlined_numpy(pills: Pills, camera: Camera, reach: float) -> Bool[np.ndarray, "h w"]:
    """Pixels within `reach` pixels of the outline of any pill, hidden or not: twin of how the kernel finds them."""
    grid, pinhole = ray_grid(camera), camera.kind == "perspective"
    place, slope = grid.reshape(-1, 2), [g.reshape(-1, 2) for g in np.gradient(grid, axis=(1, 0))]
    nothing, one = np.zeros((place.shape[0], 1)), np.ones((place.shape[0], 1))
    along = np.hstack([place, one]) if pinhole else np.hstack([np.zeros_like(place), one])
    origin = np.zeros_like(along) if pinhole else np.hstack([place, nothing])
    out = np.zeros(place.shape[0], dtype=bool)
    for k in range(pills.base.shape[0]):
        near = clearance(pills, np.full(place.shape[0], k), origin, along)
        steep = np.stack([(near.normal[:, :2] * part).sum(axis=1) for part in slope], axis=1)
        steep *= near.depth[:, None] if pinhole else 1.0
        out |= np.abs(near.distance) <= reach * np.linalg.norm(steep, axis=1)
    return out.reshape(grid.shape[:2])


def _part(of, kept: Bool[np.ndarray, " n"]):
    """The same arrays for some of the samples."""
    return type(of)(*(getattr(of, each.name)[kept] for each in fields(of)))


def rendered(
    samples: Samples,
    pills: Pills,
    camera: Camera,
    appearance: Appearance,
    table: Float[np.ndarray, "t t"] | None = None,
) -> Rendered:
    """What the samples should show with the pills posed so, and its derivatives."""
    n = samples.level.size
    level, row, by_patch, normal = np.empty(n), np.empty((n, 4, 6)), np.empty((n, 2)), np.empty((n, 3))
    _kernels.sample_rows(
        _grid(camera),
        camera.kind == "perspective",
        (pills.base, pills.tip, pills.radius),
        (appearance.shading if table is None else np.append(appearance.shading, table), appearance.gain),
        float(appearance.background),
        lens_blur(appearance),
        samples.place,
        samples.pill,
        samples.patch,
        level,
        row,
        by_patch,
        normal,
    )
    return Rendered(level, row, by_patch, normal)


def differences(
    samples: Samples,
    on: Chain,
    appearance: Appearance,
    unmodelled: Unmodelled,
    u: Float[np.ndarray, " k"],
    error: Float[np.ndarray, "p 2"],
    loose: float,
    seen: Rendered | None = None,
    twists: Float[np.ndarray, "m k"] | None = None,
) -> Differences:
    """Compare the samples with the pose u and the errors of the patches.

    Parameters
    ----------
    error : (p, 2)
        Relative error of the grey level, and outward shift in model units, of every patch.
    loose : float
        Pixels by which outlines may still be off, without counting as outliers.
    seen : Rendered, optional
        The samples at this pose, where they have been rendered already.
    twists : (6l, k), optional
        Derivative of the links' twists by the free joints, from a pose nearby.
    """
    model = on.model
    frames = forward(model, pose_from_free(model, u))
    pills = pose_pills(model, frames, on.camera)
    seen = rendered(samples, pills, on.camera, appearance, unmodelled.table) if seen is None else seen
    unit = float(np.nanmedian(pixels_per_unit(on.camera, 0.5 * (pills.base + pills.tip))))
    r = samples.level - seen.level - (seen.by_patch * error[samples.patch]).sum(axis=1)
    variance = (appearance.noise / samples.place[:, 2]) ** 2 + unmodelled.grain**2
    spread = max(1.0, 1.4826 * median(np.abs(r) / np.sqrt(variance))) if r.size else 1.0
    variance = spread**2 * variance
    weight = 1.0 / (1.0 + r * r / (variance + (seen.by_patch[:, 1] * (loose / unit)) ** 2) / _CUT**2) / variance
    links, patches = pills.base.shape[0], error.shape[0]
    H, g, across = np.zeros((6 * links, 6 * links)), np.zeros((patches, 6 * links)), np.zeros((patches, 2, 6 * links))
    within, own = np.zeros((patches, 3)), np.zeros((patches, 2))
    _kernels.normal_equations(
        samples.pill, samples.patch, weight, r, seen.row, seen.by_patch, H, g, across, within, own
    )
    H = np.triu(H) + np.triu(H, 1).T
    G = link_twists(on, frames) @ model.coupling if twists is None else twists
    inverse, held = _eliminated(within, _held(unmodelled, unit))
    own = own - (held @ error.reshape(links, -1, 1)).reshape(own.shape)
    to_pose = (across @ G).reshape(links, -1, u.size)
    of_pose = inverse @ to_pose
    score = g @ G - (of_pose * own.reshape(links, -1, 1)).reshape(patches, 2, -1).sum(axis=1)
    A = G.T @ H @ G - to_pose.reshape(-1, u.size).T @ of_pose.reshape(-1, u.size)
    return Differences(
        score / _CAUTION, 0.5 * (A + A.T) / _CAUTION, samples, r, weight, seen, own, inverse, of_pose, unit
    )


def normal_equations_numpy(
    samples: Samples, seen: Rendered, weight: Float[np.ndarray, " n"], r: Float[np.ndarray, " n"], links: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The sums of the compiled kernel by dense matrices: its twin."""
    J = np.zeros((r.size, links, 6))
    for i in range(samples.pill.shape[1]):
        there = np.flatnonzero(samples.pill[:, i] >= 0)
        J[there, samples.pill[there, i]] += seen.row[there, i]
    J, B = J.reshape(r.size, -1), seen.by_patch
    member = (samples.patch == np.arange(PATCHES * links)[:, None]) * weight
    return (
        np.triu((J * weight[:, None]).T @ J),
        member @ (J * r[:, None]),
        np.stack([member @ (J * B[:, a : a + 1]) for a in range(2)], axis=1),
        member @ np.stack([B[:, 0] ** 2, B[:, 0] * B[:, 1], B[:, 1] ** 2], axis=1),
        member @ (B * r[:, None]),
    )


def _held(unmodelled: Unmodelled, unit: float) -> Float[np.ndarray, "m m"]:
    """Information on the errors of a link's patches: part of their variance is common to the link."""
    out = np.zeros((PATCHES, 2, PATCHES, 2))
    for a, size in enumerate((unmodelled.level, unmodelled.shift / unit)):
        out[:, a, :, a] = (np.eye(PATCHES) - COMMON / (1.0 + PATCHES * COMMON)) / size**2
    return out.reshape(2 * PATCHES, 2 * PATCHES)


def _eliminated(
    within: Float[np.ndarray, "p 3"], held: Float[np.ndarray, "m m"]
) -> tuple[Float[np.ndarray, "l m m"], Float[np.ndarray, "m m"]]:
    """Inverse information of every link's errors, and the part of the information that was there before the image."""
    links, each = within.shape[0] // PATCHES, np.arange(PATCHES)
    M = np.tile(held, (links, 1, 1)).reshape(links, PATCHES, 2, PATCHES, 2)
    part = within.reshape(links, PATCHES, 3)
    M[:, each, 0, each, 0] += part[..., 0]
    M[:, each, 1, each, 1] += part[..., 2]
    M[:, each, 0, each, 1] += part[..., 1]
    M[:, each, 1, each, 0] += part[..., 1]
    return np.linalg.inv(M.reshape(links, 2 * PATCHES, 2 * PATCHES)), held
