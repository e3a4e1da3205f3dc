"""Features and a pose in, stacked residuals in units of their sigma and the Jacobian out: what `solve` minimises.

Two kinds behind one interface, each a function of the independent joints u that returns `(r, J)`:

- `OutlineFeatures`: every edge point against the silhouette of its link, along the normal. The residual is the
  clearance of the edge point's ray from the pill, zero exactly on the silhouette in either projection, turned into
  pixels. By the envelope theorem its derivative is that of the nearest axis point along the normal: where on the pill
  the ray touches changes with the pose, but to first order the distance does not notice.
- `LineFeatures`: the thesis's tips, eq. (3.1), and points of each link against its axial line, eq. (3.2), with (3.7),
  (3.8).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from . import _kernels
from .camera import Camera, project_with_jacobian, rays
from .kinematics import Model, forward, joints_below, link_ends, point_jacobian, pose_from_free
from .pills import Pills, clearance

Residual = Callable[[Float[np.ndarray, " k"]], tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m k"]]]


@dataclass(frozen=True, slots=True, eq=False)
class OutlineFeatures:
    """Edge points as rays.

    Attributes
    ----------
    ray, slope : (n, 6)
        Origin and direction, in world axes, of the ray through each point, and their change for one pixel outwards;
        so points of several views stack.
    link : (n,)
        Link whose silhouette the point lies on.
    sigma : (n,)
        Standard deviation along the normal, pixels.
    """

    ray: Float[np.ndarray, "n 6"]
    slope: Float[np.ndarray, "n 6"]
    link: Int[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class LineFeatures:
    """Axial lines and tips in the image.

    Attributes
    ----------
    line_link, line : (n,), (n, 3)
        Link and `[a, b, rho]` of its axial line `a x + b y = rho`, pixels.
    along : (n, 2)
        Two axial positions s in [0, 1] whose projections should lie on the line.
    line_sigma : (n, 2)
        Standard deviation of the line at these positions, pixels.
    tip_link, tip, tip_sigma : (m,), (m, 2), (m,)
        Link, position and standard deviation of each tip's cap centre, pixels.
    """

    line_link: Int[np.ndarray, " n"]
    line: Float[np.ndarray, "n 3"]
    along: Float[np.ndarray, "n 2"]
    line_sigma: Float[np.ndarray, "n 2"]
    tip_link: Int[np.ndarray, " m"]
    tip: Float[np.ndarray, "m 2"]
    tip_sigma: Float[np.ndarray, " m"]


def outline_features(
    camera: Camera,
    xy: Float[np.ndarray, "n 2"],
    direction: Float[np.ndarray, "n 2"],
    link: Int[np.ndarray, " n"],
    sigma: Float[np.ndarray, " n"],
) -> OutlineFeatures:
    """Edge points in pixels, with the outward unit vectors of their samplers, as rays."""
    ray = np.hstack(rays(camera, xy))
    ahead = np.hstack(rays(camera, xy + 0.5 * direction))
    behind = np.hstack(rays(camera, xy - 0.5 * direction))
    return OutlineFeatures(*in_world(camera, ray, ahead - behind), link, sigma)


def in_world(
    camera: Camera, ray: Float[np.ndarray, "n 6"], slope: Float[np.ndarray, "n 6"]
) -> tuple[Float[np.ndarray, "n 6"], Float[np.ndarray, "n 6"]]:
    """Rays and their slopes, from camera axes into world axes."""
    n = ray.shape[0]
    here, link = np.zeros(n), np.zeros(n, dtype=np.int64)
    turned = turned_rays(camera, ray, slope, here, np.ones(n, dtype=np.bool_), link, here)
    return turned.ray, turned.slope


def turned_rays(
    camera: Camera,
    ray: Float[np.ndarray, "n 6"],
    slope: Float[np.ndarray, "n 6"],
    offset: Float[np.ndarray, " n"],
    found: Bool[np.ndarray, " n"],
    link: Int[np.ndarray, " n"],
    sigma: Float[np.ndarray, " n"],
) -> OutlineFeatures:
    """The rays at `offset` pixels along the samplers that found an edge, from camera axes into world axes."""
    n = ray.shape[0]
    out = np.empty((n, 6)), np.empty((n, 6)), np.empty(n, dtype=np.int64), np.empty(n)
    count = _kernels.turn_rays(ray, slope, offset, found, camera.R, camera.t, link, sigma, *out)
    return OutlineFeatures(*(column[:count] for column in out))


def turned_rays_numpy(
    camera: Camera,
    ray: Float[np.ndarray, "n 6"],
    slope: Float[np.ndarray, "n 6"],
    offset: Float[np.ndarray, " n"],
    found: Bool[np.ndarray, " n"],
    link: Int[np.ndarray, " n"],
    sigma: Float[np.ndarray, " n"],
) -> OutlineFeatures:
    """The same as `turned_rays` in plain NumPy: the twin of the compiled kernel."""
    R, slope = camera.R, slope[found]
    ray = ray[found] + offset[found, None] * slope
    turned = np.hstack([(ray[:, :3] - camera.t) @ R, ray[:, 3:] @ R])
    return OutlineFeatures(turned, np.hstack([slope[:, :3] @ R, slope[:, 3:] @ R]), link[found], sigma[found])


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """What the kernels need of a model and a camera, laid out once; `plain` if no joint follows another."""

    model: Model
    camera: Camera
    moves: Bool[np.ndarray, "f j"]
    joint_frame: Int[np.ndarray, " j"]
    plain: bool


def chain(model: Model, camera: Camera) -> Chain:
    """Prepare a model seen by a camera."""
    joint_frame = np.empty(len(model.joint_names), dtype=np.int64)
    moved = np.flatnonzero(model.joint >= 0)
    joint_frame[model.joint[moved]] = moved
    return Chain(model, camera, joints_below(model), joint_frame, model.free.size == len(model.joint_names))


def outline_residuals(
    on: Chain, features: OutlineFeatures, u: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n k"]]:
    """Signed distances of edge points from the silhouette in units of sigma (positive outside), and their Jacobian."""
    model = on.model
    frames = forward(model, pose_from_free(model, u))
    r = np.empty(features.link.size)
    J = np.empty((features.link.size, len(model.joint_names)))
    _kernels.outline_rows(
        features.ray,
        features.slope,
        features.link,
        features.sigma,
        frames,
        model.link_frame,
        model.link_base,
        model.link_tip,
        model.link_radius,
        on.moves,
        on.joint_frame,
        model.prismatic,
        r,
        J,
    )
    return r, J if on.plain else J @ model.coupling


def outline_residuals_numpy(
    on: Chain, features: OutlineFeatures, u: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n k"]]:
    """The same as `outline_residuals` in plain NumPy: the twin of the compiled kernel."""
    model = on.model
    frames = forward(model, pose_from_free(model, u))
    base, tip = link_ends(model, frames)
    pills = Pills(base, tip, model.link_radius)
    seen = clearance(pills, features.link, features.ray[:, :3], features.ray[:, 3:])
    spread = features.slope[:, :3] + seen.depth[:, None] * features.slope[:, 3:]
    per_pixel = np.maximum(np.abs((seen.normal * spread).sum(axis=1)), 1e-9)
    point = base[features.link] + seen.along[:, None] * (tip - base)[features.link]
    moved = point_jacobian(model, frames, model.link_frame[features.link], point)
    J = -(seen.normal[:, None, :] @ moved)[:, 0, :]
    scale = 1.0 / (per_pixel * features.sigma)
    return seen.distance * scale, (J * scale[:, None]) @ model.coupling


def line_residuals(
    on: Chain, features: LineFeatures, u: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m k"]]:
    """Tip residuals (two for each tip) and link residuals (two for each line) in units of sigma, and their Jacobian."""
    model = on.model
    frames = forward(model, pose_from_free(model, u))
    base, tip = link_ends(model, frames)
    link = np.repeat(features.line_link, 2)
    along = features.along.reshape(-1, 1)
    points = np.concatenate([tip[features.tip_link], base[link] + along * (tip - base)[link]])
    frame = model.link_frame[np.concatenate([features.tip_link, link])]
    xy, d_xy = project_with_jacobian(on.camera, points)
    J = d_xy @ point_jacobian(model, frames, frame, points)
    m = features.tip_link.size
    r_tip = (xy[:m] - features.tip) / features.tip_sigma[:, None]
    J_tip = J[:m] / features.tip_sigma[:, None, None]
    line = np.repeat(features.line, 2, axis=0)
    sigma = features.line_sigma.reshape(-1)
    r_line = ((line[:, :2] * xy[m:]).sum(axis=1) - line[:, 2]) / sigma
    J_line = (line[:, None, :2] @ J[m:])[:, 0, :] / sigma[:, None]
    stacked = np.concatenate([J_tip.reshape(2 * m, J.shape[-1]), J_line])
    return np.concatenate([r_tip.reshape(-1), r_line]), stacked @ model.coupling


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Residual rows of either kind: the function, and each row's sigma (pixels) and group of errors with one cause."""

    residual: Residual
    sigma: Float[np.ndarray, " m"]
    group: Int[np.ndarray, " m"]


def rows(on: Chain, features: OutlineFeatures | LineFeatures, side: Int[np.ndarray, " n"] | None = None) -> Rows:
    """Features as residual rows.

    Parameters
    ----------
    side : (n,)
        For outlines: +1 or -1 for the two sides of a link, 0 for a tip. One side of a link is one group.
    """
    if isinstance(features, OutlineFeatures):
        group = _numbered(3 * features.link + (0 if side is None else side) + 1)
        return Rows(lambda u: outline_residuals(on, features, u), features.sigma, group)
    sigma = np.concatenate([np.repeat(features.tip_sigma, 2), features.line_sigma.reshape(-1)])
    key = np.concatenate([np.repeat(2 * features.tip_link + 1, 2), np.repeat(2 * features.line_link, 2)])
    return Rows(lambda u: line_residuals(on, features, u), sigma, _numbered(key))


def stack_features(features: Sequence[OutlineFeatures | LineFeatures]) -> OutlineFeatures | LineFeatures:
    """Edge points of several views as one set; lines belong to their view's camera, so the first view's stand for all.

    Only the compiled fit of outlines looks into what this returns; lines are fitted through their stacked rows.
    """
    if len(features) == 1 or not all(isinstance(each, OutlineFeatures) for each in features):
        return features[0]
    parts = [(each.ray, each.slope, each.link, each.sigma) for each in features if isinstance(each, OutlineFeatures)]
    return OutlineFeatures(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def stack_rows(views: Sequence[Rows]) -> Rows:
    """Rows of several views, one after the other; no two views share a group."""
    if len(views) == 1:
        return views[0]

    def residual(u: Float[np.ndarray, " k"]) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m k"]]:
        parts = [view.residual(u) for view in views]
        return np.concatenate([r for r, _ in parts]), np.concatenate([J for _, J in parts])

    groups, first = [], 0
    for view in views:
        groups.append(view.group + first)
        first += int(view.group.max(initial=-1)) + 1
    return Rows(residual, np.concatenate([view.sigma for view in views]), np.concatenate(groups))


def _numbered(key: Int[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    """The keys that occur, numbered from 0 without gaps."""
    occurs = np.bincount(key) > 0
    return (np.cumsum(occurs) - 1)[key]


@dataclass(frozen=True, slots=True, eq=False)
class WithPrior:
    """Residuals with the prediction appended as `root @ (u - mean)`, where `root.T @ root` is its information."""

    residual: Residual
    mean: Float[np.ndarray, " k"]
    root: Float[np.ndarray, "k k"]

    def __call__(self, u: Float[np.ndarray, " k"]) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m k"]]:
        r, J = self.residual(u)
        return np.concatenate([r, self.root @ (u - self.mean)]), np.concatenate([J, self.root])


@dataclass(frozen=True, slots=True, eq=False)
class Robust:
    """The same residuals under Cauchy's loss, written as plain least squares.

    `r' = c sqrt(log(1 + z^2))` with `z = r / (c scale)` and the sign of r: its half square is Cauchy's loss, so every
    solver for sums of squares minimises the robust cost. c = 2.385 keeps 95 % efficiency for normal errors (Holland and
    Welsch 1977).
    """

    residual: Residual
    scale: float = 1.0

    def __call__(self, u: Float[np.ndarray, " k"]) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m k"]]:
        r, J = self.residual(u)
        r, J = r.copy(), J.copy()
        _kernels.soften_rows(r, J, self.scale)
        return r, J


@dataclass(frozen=True, slots=True, eq=False)
class Weighted:
    """Residuals times fixed roots of weights: one round of iteratively reweighted least squares."""

    residual: Residual
    root: Float[np.ndarray, " m"]

    def __call__(self, u: Float[np.ndarray, " k"]) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m k"]]:
        r, J = self.residual(u)
        return self.root * r, self.root[:, None] * J


def soften_numpy(
    r: Float[np.ndarray, " m"], J: Float[np.ndarray, "m k"], scale: float, c: float = 2.385
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m k"]]:
    """What `Robust` does to residuals and Jacobian, in plain NumPy: the twin of the compiled kernel."""
    z = np.abs(r) / (c * scale)
    size = np.sqrt(np.log1p(z * z))
    small = z <= 1e-6
    slope = np.where(small, 1.0, z / np.where(small, 1.0, (1.0 + z * z) * size))
    return np.where(small, r / scale, c * np.sign(r) * size), J * (slope / scale)[:, None]
