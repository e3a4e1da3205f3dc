"""Links in, pills (capsules, tapered or not) in camera axes out, with exact ray hits and exact clearances.

A pill is the convex hull of two spheres, so also the union of the spheres `c(s), r(s)` between them, s in [0, 1]. From
this one fact follow both operations here, in both projections:

- a ray hits the side where its distance from the tangent cone is zero, or one of the end spheres;
- a ray's clearance from the pill is `min_s |c(s) - ray| - r(s)`: zero on the silhouette, negative inside.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from . import _kernels
from .camera import Camera, camera_from_world
from .kinematics import Model, link_ends


@dataclass(frozen=True, slots=True, eq=False)
class Pills:
    """Posed pills in camera axes: ends of their axes and radius at each end, model units."""

    base: Float[np.ndarray, "l 3"]
    tip: Float[np.ndarray, "l 3"]
    radius: Float[np.ndarray, "l 2"]


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """First hit of each ray: parameter (inf where missed), pill (-1 where missed), outward normal in camera axes."""

    t: Float[np.ndarray, " n"]
    pill: Int[np.ndarray, " n"]
    normal: Float[np.ndarray, "n 3"]


@dataclass(frozen=True, slots=True, eq=False)
class Clearance:
    """Distance of each ray from the surface of one pill.

    Attributes
    ----------
    distance : (n,)
        Model units; negative inside the silhouette.
    along : (n,)
        Axial position s in [0, 1] of the nearest sphere.
    normal : (n, 3)
        Unit vector from the axis to the ray: the outward normal at the nearest surface point.
    depth : (n,)
        Ray parameter at its nearest approach.
    """

    distance: Float[np.ndarray, " n"]
    along: Float[np.ndarray, " n"]
    normal: Float[np.ndarray, "n 3"]
    depth: Float[np.ndarray, " n"]


def pose_pills(model: Model, frames: Float[np.ndarray, "f 4 4"], camera: Camera) -> Pills:
    """Pills of a posed model in camera axes, in the order of the model's links."""
    base, tip = link_ends(model, frames)
    return Pills(camera_from_world(camera, base), camera_from_world(camera, tip), model.link_radius)


def ray_hits(pills: Pills, origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]) -> Hits:
    """First pill that each ray hits.

    >>> ball = Pills(np.array([[0.0, 0.0, 9.0]]), np.array([[1.0, 0.0, 9.0]]), np.array([[2.0, 2.0]]))
    >>> hits = ray_hits(ball, np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))
    >>> hits.t.tolist(), hits.pill.tolist(), hits.normal.tolist()
    ([7.0], [0], [[0.0, 0.0, -1.0]])
    """
    n = origin.shape[0]
    t, pill, normal = np.empty(n), np.empty(n, dtype=np.int64), np.zeros((n, 3))
    _kernels.cast_rays(
        np.ascontiguousarray(origin),
        np.ascontiguousarray(direction),
        pills.base,
        pills.tip,
        pills.radius,
        t,
        pill,
        normal,
    )
    return Hits(t, pill, normal)


def ray_hits_numpy(pills: Pills, origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]) -> Hits:
    """The same as `ray_hits` in plain NumPy, one pill after the other: the twin of the compiled kernel."""
    n = origin.shape[0]
    best, pill, normal = np.full(n, np.inf), np.full(n, -1, dtype=np.int64), np.zeros((n, 3))
    for k in range(pills.base.shape[0]):
        t, n_k = _pill_hit(origin, direction, pills.base[k], pills.tip[k], pills.radius[k])
        nearer = t < best
        best = np.where(nearer, t, best)
        pill[nearer] = k
        normal[nearer] = n_k[nearer]
    return Hits(best, pill, normal)


def _pill_hit(
    origin: Float[np.ndarray, "n 3"],
    direction: Float[np.ndarray, "n 3"],
    base: Float[np.ndarray, " 3"],
    tip: Float[np.ndarray, " 3"],
    radius: Float[np.ndarray, " 2"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Parameter and normal of each ray's first hit on one pill; the derivation stands in `_kernels.hit_pill`."""
    t0, n0 = _sphere_hit(origin, direction, base, radius[0])
    t1, n1 = _sphere_hit(origin, direction, tip, radius[1])
    t, normal = np.where(t0 <= t1, t0, t1), np.where((t0 <= t1)[:, None], n0, n1)
    length = float(np.linalg.norm(tip - base))
    if length <= abs(radius[0] - radius[1]):
        return t, normal
    axis = (tip - base) / length
    s = (radius[0] - radius[1]) / length
    c2 = 1.0 - s * s
    dd = (direction * direction).sum(axis=1)
    shift = -((origin - base - 0.5 * length * axis) * direction).sum(axis=1) / dd
    m = origin + shift[:, None] * direction - base
    md, mm = (m * direction).sum(axis=1), (m * m).sum(axis=1)
    m_a, d_a = m @ axis, direction @ axis
    w = radius[0] - s * m_a
    qa = c2 * (dd - d_a * d_a) - s * s * d_a * d_a
    qb = c2 * (md - m_a * d_a) + s * d_a * w
    qc = c2 * (mm - m_a * m_a) - w * w
    disc = qb * qb - qa * qc
    with np.errstate(divide="ignore", invalid="ignore"):
        for sign in (-1.0, 1.0):
            side = (-qb + sign * np.sqrt(np.where(disc >= 0.0, disc, np.nan))) / qa
            x = m_a + side * d_a
            nearer = (radius[0] * s <= x) & (x <= length + radius[1] * s) & (side + shift < t)
            r = (radius[0] - s * x) / c2
            n_side = (m + side[:, None] * direction - (x - s * r)[:, None] * axis) / r[:, None]
            t, normal = np.where(nearer, side + shift, t), np.where(nearer[:, None], n_side, normal)
    return t, normal


def _sphere_hit(
    origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"], centre: Float[np.ndarray, " 3"], r: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    a = (direction * direction).sum(axis=1)
    m = origin - centre
    b = (m * direction).sum(axis=1)
    nearest = m - (b / a)[:, None] * direction
    gap = r * r - (nearest * nearest).sum(axis=1)
    t = np.where(gap >= 0.0, (-b - np.sqrt(np.maximum(gap, 0.0) * a)) / a, np.inf)
    return t, (m + np.where(gap >= 0.0, t, 0.0)[:, None] * direction) / r


def clearance(
    pills: Pills, link: Int[np.ndarray, " n"], origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]
) -> Clearance:
    """Distance of each ray from the surface of the pill named for it; zero on the silhouette in either projection.

    The squared distance of the axis point `c(s)` from the ray is `A (s - s0)^2 + h^2`, so with `r(s) = r0 + k s` the
    minimum over s of distance minus radius is at `s0 + k h / sqrt(A (A - k^2))`, kept inside [0, 1].

    >>> ball = Pills(np.array([[0.0, 0.0, 9.0]]), np.array([[1.0, 0.0, 9.0]]), np.array([[2.0, 2.0]]))
    >>> clearance(ball, np.array([0]), np.array([[0.5, 3.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])).distance.tolist()
    [1.0]
    """
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    base, axis = pills.base[link], pills.tip[link] - pills.base[link]
    r0, k = pills.radius[link, 0], pills.radius[link, 1] - pills.radius[link, 0]
    m = base - origin
    m_across = m - (m * unit).sum(axis=1, keepdims=True) * unit
    a_across = axis - (axis * unit).sum(axis=1, keepdims=True) * unit
    size = (a_across * a_across).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        s0 = -(m_across * a_across).sum(axis=1) / size
        across = m_across + s0[:, None] * a_across
        h = np.sqrt((across * across).sum(axis=1))
        s = s0 + k * h / np.sqrt(size * (size - k * k))
    # Seen end on, or with one sphere hiding the other, the larger sphere decides.
    s = np.where(size > k * k, np.clip(s, 0.0, 1.0), (k > 0).astype(float))
    across = m_across + s[:, None] * a_across
    gap = np.sqrt((across * across).sum(axis=1))
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = np.where(gap[:, None] > 0.0, -across / gap[:, None], 0.0)
    nearest = m + s[:, None] * axis
    depth = (nearest * unit).sum(axis=1) / np.linalg.norm(direction, axis=1)
    return Clearance(gap - (r0 + k * s), s, normal, depth)
