"""Edge points of links in, axial lines and tips as features for the residuals out (hand thesis, 4.4 and 4.1).

The points of one side of a link make a boundary line (RANSAC, then PCA); the bisector of both is the axial line. A
finger tip is searched along it, starting from the refined tip of eq. (4.1); the tip feature is the centre of the cap,
a radius behind the edge.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .camera import project_camera, project_with_jacobian
from .edges import FOUND, EdgePoints
from .kinematics import forward, link_ends, point_jacobian, pose_from_free
from .lines import Line, axial_line, fit_line, refined_tip
from .pills import Pills
from .profiles import Samplers, place_tips
from .residuals import Chain, LineFeatures

FLOOR = 0.12  # pixels: what shading that is slightly off leaves
TOLERANCE = 1.0  # pixels: inliers of a boundary line
_LEAST_POINTS = 3  # on each side of a link
_AT = np.array([0.2, 0.8])  # where on a link its axis is held against the line

# From samplers where the model is, the same on the line that was found, and the spread of the prediction in pixels.
FindTips = Callable[[Samplers, Samplers, Float[np.ndarray, " m"]], EdgePoints]


@dataclass(frozen=True, slots=True, eq=False)
class Axes:
    """Axial lines and the links they belong to."""

    line: Line
    link: Int[np.ndarray, " a"]


@dataclass(frozen=True, slots=True, eq=False)
class Tips:
    """Link, cap centre in pixels and standard deviation of each tip."""

    link: Int[np.ndarray, " m"]
    centre: Float[np.ndarray, "m 2"]
    sigma: Float[np.ndarray, " m"]


def axis_spread(
    on: Chain, samplers: Samplers, u: Float[np.ndarray, " k"], covariance: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, " n"]:
    """Standard deviation of each sampler's axis point along the sampler, pixels, from the covariance of the pose."""
    frames = forward(on.model, pose_from_free(on.model, u))
    base, tip = link_ends(on.model, frames)
    point = base[samplers.link] + samplers.along[:, None] * (tip - base)[samplers.link]
    _, d_xy = project_with_jacobian(on.camera, point)
    J = d_xy @ point_jacobian(on.model, frames, on.model.link_frame[samplers.link], point) @ on.model.coupling
    across_it = (samplers.direction[:, None, :] @ J)[:, 0]
    return np.sqrt(np.maximum(((across_it @ covariance) * across_it).sum(axis=1), 0.0))


def find_axes(
    link: Int[np.ndarray, " p"],
    side: Int[np.ndarray, " p"],
    xy: Float[np.ndarray, "p 2"],
    sigma: Float[np.ndarray, " p"],
    found: Bool[np.ndarray, " p"],
) -> Axes:
    """Axial lines of the links with enough edge points on both sides.

    Parameters
    ----------
    side : (p,)
        -1 or +1; points of one side of a link in order along it.
    """
    links = int(link.max(initial=-1)) + 1
    group = 2 * link[found] + (side[found] > 0)
    count = np.bincount(group, minlength=2 * links).reshape(links, 2)
    kept = np.flatnonzero((count >= _LEAST_POINTS).all(axis=1))
    order = np.argsort(group, kind="stable")
    first = np.cumsum(count.ravel()) - count.ravel()
    rank = np.arange(order.size) - first[group[order]]
    points = np.full((2 * links, int(count.max(initial=1)), 2), np.nan)
    spread = np.full(points.shape[:2], np.inf)
    points[group[order], rank], spread[group[order], rank] = xy[found][order], sigma[found][order]
    chosen = np.stack([2 * kept, 2 * kept + 1], axis=1)
    both = fit_line(points[chosen], spread[chosen], TOLERANCE)
    return Axes(axial_line(both[:, 0], both[:, 1]), kept)


def find_tips(
    on: Chain,
    pills: Pills,
    axes: Axes,
    u: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "k k"],
    find: FindTips,
) -> Tips:
    """The tips that `find` sees on the axial lines of finger ends.

    What to expect is told where the model is; the image is searched along the axial line that was found.
    """
    chosen = np.flatnonzero(on.model.link_is_tip[axes.link] & axes.line.valid)
    link = axes.link[chosen]
    if link.size == 0:
        return Tips(link, np.zeros((0, 2)), np.zeros(0))
    tip = project_camera(on.camera, pills.tip[link])
    base = project_camera(on.camera, pills.base[link])
    line = axes.line[chosen]
    heading = line.direction * np.where(((tip - base) * line.direction).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    radius = np.linalg.norm(project_camera(on.camera, pills.tip[link] + _sideways(pills, link)) - tip, axis=1)
    expected = place_tips(pills, on.camera, link, tip + radius[:, None] * heading, heading)
    found_on = place_tips(pills, on.camera, link, refined_tip(tip, line) + radius[:, None] * heading, heading)
    edges = find(expected, found_on, axis_spread(on, expected, u, covariance))
    ok = edges.reason == FOUND
    centre = edges.xy - radius[:, None] * heading
    sigma = np.sqrt(edges.sigma**2 + line.covariance[:, 1, 1] + FLOOR**2)
    return Tips(link[ok], centre[ok], sigma[ok])


def _sideways(pills: Pills, link: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
    """A vector of the tip's radius across both the axis and the line of sight of an orthographic view."""
    axis = pills.tip[link] - pills.base[link]
    side = np.stack([-axis[:, 1], axis[:, 0], np.zeros(link.size)], axis=1)
    return pills.radius[link, 1:] * side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)


def line_features(on: Chain, pills: Pills, axes: Axes, visible: Float[np.ndarray, " l"], tips: Tips) -> LineFeatures:
    """Lines and tips for the residuals; a line's sigma at a point follows from its angle and its offset.

    Parameters
    ----------
    visible : (l,)
        Share of each link that is visible: a line seen on less of it counts for less.
    """
    ok = np.flatnonzero(axes.line.valid)
    link, line = axes.link[ok], axes.line[ok]
    along = np.tile(_AT, (link.size, 1))
    point = pills.base[link][:, None] + along[..., None] * (pills.tip - pills.base)[link][:, None]
    xy = project_camera(on.camera, point)
    away = ((xy - line.centroid[:, None]) * line.direction[:, None]).sum(axis=-1)
    C = line.covariance
    variance = C[:, 1, 1, None] + 2.0 * away * C[:, 0, 1, None] + away**2 * C[:, 0, 0, None]
    share = np.clip(visible[link], 0.1, 1.0)
    sigma = np.sqrt(2.0 * np.maximum(variance, 1e-6) / share[:, None])  # two points of one line share its evidence
    parameters = np.column_stack([line.normal, line.rho])
    return LineFeatures(link, parameters, along, sigma, tips.link, tips.centre, tips.sigma)
