"""One look at an image in the thesis's own way: a pose to look from in, axial lines and tips out.

Profiles across each link -> WSSD surface -> valley -> a pair of edges for each profile -> boundary lines (RANSAC,
PCA) -> axial line (bisector) -> tip searched along it. The tip's search is gated: it uses the rendered template of
the cap, so an edge of another finger or of the wrong sign is no match, and starts from the refined tip of eq. (4.1).
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from .across import Across, across
from .appearance import Appearance
from .camera import project_camera, project_with_jacobian
from .edges import FLAT, FOUND, HIDDEN, MISFIT, OUTSIDE, EdgePoints, curves, find_edges
from .edges.valley import fit_valley
from .kinematics import forward, link_ends, point_jacobian, pose_from_free
from .lines import Line, axial_line, fit_line, refined_tip
from .measure import LEAST_REACH, MOST_REACH, Look, posed
from .pills import Pills
from .profiles import Profiles, Samplers, place_tips, sample
from .residuals import Chain, LineFeatures
from .settings import Settings
from .templates import Templates, expect, positions

COUNT = 8  # samplers across each link
_TOLERANCE = 1.0  # pixels: inliers of a boundary line
_LEAST_SHARE = 0.45  # of a link visible at a sampler
_HIDDEN = 1.0  # pixels: what a wholly hidden link would add, since a window's cut moves with the pose
_FLOOR = 0.12  # pixels: what shading that is slightly off leaves
_AT = np.array([0.2, 0.8])  # where on a link its axis is held against the line


def look_lines(
    image: Float[np.ndarray, "h w"],
    on: Chain,
    u: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "k k"],
    appearance: Appearance,
    settings: Settings,
    stored: Float[np.ndarray, "n m"] | None = None,
    widen: float = 1.0,
) -> Look:
    """Measure axial lines and tips around the pose u, reaching three sigmas of the prediction.

    Parameters
    ----------
    stored : (n, m)
        Profiles of the first frame to use as templates instead of rendered ones.
    """
    pills = posed(on, u)
    wide = across(pills, on.model.link_finger, on.camera, appearance, COUNT, settings.visibility == "polygons")
    spread = widen * _spread(on, wide.samplers, u, covariance)
    reach = np.clip(3.0 * spread + 1.0, LEAST_REACH, MOST_REACH)
    step = float(wide.u[1] - wide.u[0])
    margin = int(np.ceil(reach.max(initial=LEAST_REACH) / step))
    longer = (np.arange(wide.u.size + 2 * margin) - (wide.u.size + 2 * margin) // 2) * step
    profiles = sample(image, wide.samplers, longer, settings.interpolation)
    values = stored if stored is not None and stored.shape == wide.values.shape else wide.values
    none = np.zeros((wide.samplers.link.size, 2, wide.u.size))
    templates = Templates(wide.u, values, none, wide.visible, np.zeros(wide.samplers.link.size, dtype=np.int64))
    offset, sigma, reason = _centres(wide, templates, profiles, reach, spread, appearance)
    edges = _edge_points(wide, offset, sigma, reason)
    found = reason == FOUND
    axes, links = _axes(wide, edges, found, on.model.link_frame.size)
    tips = _tips(image, on, pills, axes, links, u, covariance, appearance, settings)
    features = _features(on, pills, axes, links, wide, tips, appearance)
    expected = ~np.isin(reason, (HIDDEN, OUTSIDE))
    return Look(pills, wide.samplers, templates, profiles, edges, reach, expected, found, features)


def first_profiles(
    image: Float[np.ndarray, "h w"], on: Chain, u: Float[np.ndarray, " k"], appearance: Appearance, settings: Settings
) -> Float[np.ndarray, "n m"]:
    """The thesis's templates: what the profiles of a frame without occlusion look like."""
    wide = across(posed(on, u), on.model.link_finger, on.camera, appearance, COUNT, settings.visibility == "polygons")
    return sample(image, wide.samplers, wide.u, settings.interpolation).values


def _spread(
    on: Chain, samplers: Samplers, u: Float[np.ndarray, " k"], covariance: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, " n"]:
    """Standard deviation of each sampler's axis point along the sampler, pixels."""
    frames = forward(on.model, pose_from_free(on.model, u))
    base, tip = link_ends(on.model, frames)
    point = base[samplers.link] + samplers.along[:, None] * (tip - base)[samplers.link]
    _, d_xy = project_with_jacobian(on.camera, point)
    J = d_xy @ point_jacobian(on.model, frames, on.model.link_frame[samplers.link], point) @ on.model.coupling
    across_it = (samplers.direction[:, None, :] @ J)[:, 0]
    return np.sqrt(np.maximum(((across_it @ covariance) * across_it).sum(axis=1), 0.0))


def _centres(
    wide: Across,
    templates: Templates,
    profiles: Profiles,
    reach: Float[np.ndarray, " n"],
    spread: Float[np.ndarray, " n"],
    appearance: Appearance,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Offset, sigma and reason of each profile, link by link, from the valley of its WSSD surface."""
    step = float(wide.u[1] - wide.u[0])
    surface = curves(profiles, templates)
    shift = (np.arange(surface.shape[1]) - surface.shape[1] // 2) * step
    surface = np.where(np.abs(shift) <= reach[:, None] + step, surface, np.inf)
    used = np.maximum(wide.visible.sum(axis=1), 1)
    n = wide.samplers.link.size
    offset, sigma, reason = np.zeros(n), np.full(n, np.inf), np.full(n, OUTSIDE)
    reason[wide.share < _LEAST_SHARE] = HIDDEN
    usable = np.isfinite(surface).any(axis=1) & (wide.share >= _LEAST_SHARE) & np.isfinite(wide.edge).all(axis=1)
    variance = max(appearance.spread, appearance.noise) ** 2
    rise = np.abs(np.median(wide.values[:, wide.u.size // 2]) - appearance.background) if n else 0.0
    for link in np.unique(wide.samplers.link[usable]):
        rows = np.flatnonzero(usable & (wide.samplers.link == link))
        if rows.size < 3:
            reason[rows] = HIDDEN
            continue
        weight = np.minimum(used[rows], 16) * wide.share[rows] / variance
        valley = fit_valley(surface[rows], weight, (shift / (spread[rows].mean() + 0.5)) ** 2)
        good = np.isfinite(valley.minimum)
        matched = valley.height < 0.15 * rise**2 + 9.0 * variance
        reason[rows] = np.where(~good, FLAT, np.where(matched, FOUND, MISFIT))
        kept = reason[rows] == FOUND
        offset[rows[kept]] = np.interp(valley.minimum[kept], np.arange(shift.size), shift)
        # n S(k) has curvature 2 sum(g^2): noise moves its minimum by sigma / sqrt(sum(g^2)), samples counted by the
        # pixel.
        slope2 = np.maximum(valley.curvature[kept] * used[rows[kept]] / (2.0 * step**2), 1e-9)
        claimed = np.sqrt(
            np.maximum(valley.height[kept], appearance.noise**2) / (slope2 * step) / wide.share[rows[kept]]
        )
        sigma[rows[kept]] = np.hypot(claimed, _FLOOR + _HIDDEN * (1.0 - wide.share[rows[kept]]))
    return offset, sigma, reason


def _edge_points(
    wide: Across, offset: Float[np.ndarray, " n"], sigma: Float[np.ndarray, " n"], reason: Int[np.ndarray, " n"]
) -> EdgePoints:
    """The profile centres as points; the pairs of edges stand at `offset + edge`."""
    xy = wide.samplers.origin + offset[:, None] * wide.samplers.direction
    return EdgePoints(xy, offset, sigma, reason, np.zeros(offset.size))


def _axes(
    wide: Across, edges: EdgePoints, found: Bool[np.ndarray, " n"], links: int
) -> tuple[Line, Int[np.ndarray, " a"]]:
    """Axial lines of the links with enough profiles: both boundary lines, then their bisector."""
    count = np.bincount(wide.samplers.link[found], minlength=links)
    kept = np.flatnonzero(count >= 3)
    most = COUNT
    points = np.full((kept.size, 2, most, 2), np.nan)
    sigma = np.full((kept.size, 2, most), np.inf)
    for row, link in enumerate(kept):
        of_link = np.flatnonzero(found & (wide.samplers.link == link))
        for side in (0, 1):
            u = edges.offset[of_link] + wide.edge[of_link, side]
            at = wide.samplers.origin[of_link] + u[:, None] * wide.samplers.direction[of_link]
            points[row, side, : of_link.size] = at
            # Both edges of a profile come from one match: each counts half.
            sigma[row, side, : of_link.size] = np.sqrt(2.0) * edges.sigma[of_link]
    both = fit_line(points, sigma, _TOLERANCE)
    return axial_line(both[:, 0], both[:, 1]), kept


def _tips(
    image: Float[np.ndarray, "h w"],
    on: Chain,
    pills: Pills,
    axes: Line,
    links: Int[np.ndarray, " a"],
    u: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "k k"],
    appearance: Appearance,
    settings: Settings,
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
    """Link, cap centre and sigma of each tip found along its axial line."""
    chosen = np.flatnonzero(on.model.link_is_tip[links] & axes.valid)
    link = links[chosen]
    if link.size == 0:
        return link, np.zeros((0, 2)), np.zeros(0)
    tip = project_camera(on.camera, pills.tip[link])
    base = project_camera(on.camera, pills.base[link])
    line = axes[chosen]
    heading = line.direction * np.where(((tip - base) * line.direction).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    radius = np.linalg.norm(project_camera(on.camera, pills.tip[link] + _sideways(pills, link)) - tip, axis=1)
    model_edge = tip + radius[:, None] * heading
    samplers = place_tips(pills, on.camera, link, model_edge, heading)
    templates = expect(samplers, pills, on.model.link_finger, on.camera, appearance)
    spread = _spread(on, samplers, u, covariance)
    reach = np.clip(3.0 * spread + 1.0, LEAST_REACH, MOST_REACH)
    margin = np.ceil(reach.max() * 2.0) / 2.0
    # The template is rendered where the model is; the image is searched along the axial line that was found.
    refined = refined_tip(tip, line)
    found_on = place_tips(pills, on.camera, link, refined + radius[:, None] * heading, heading)
    profiles = sample(image, found_on, positions(12.0 + margin, 6.0 + margin, 0.5), settings.interpolation)
    edges = find_edges(found_on, templates, profiles, reach, spread + 0.5, appearance.noise, appearance.spread)
    ok = edges.reason == FOUND
    centre = edges.xy - radius[:, None] * heading
    across_sigma = np.sqrt(line.covariance[:, 1, 1])
    return link[ok], centre[ok], np.sqrt(edges.sigma**2 + across_sigma**2 + _FLOOR**2)[ok]


def _sideways(pills: Pills, link: Int[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
    """A vector of the tip's radius across both the axis and the line of sight of an orthographic view."""
    axis = pills.tip[link] - pills.base[link]
    side = np.stack([-axis[:, 1], axis[:, 0], np.zeros(link.size)], axis=1)
    return pills.radius[link, 1:] * side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)


def _features(
    on: Chain,
    pills: Pills,
    axes: Line,
    links: Int[np.ndarray, " a"],
    wide: Across,
    tips: tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]],
    appearance: Appearance,
) -> LineFeatures:
    """Lines and tips for the residuals; a line's sigma at a point follows from its angle and its offset."""
    ok = np.flatnonzero(axes.valid)
    link, line = links[ok], axes[ok]
    along = np.tile(_AT, (link.size, 1))
    point = pills.base[link][:, None] + along[..., None] * (pills.tip - pills.base)[link][:, None]
    xy = project_camera(on.camera, point)
    away = ((xy - line.centroid[:, None]) * line.direction[:, None]).sum(axis=-1)
    C = line.covariance
    variance = C[:, 1, 1, None] + 2.0 * away * C[:, 0, 1, None] + away**2 * C[:, 0, 0, None]
    share = np.bincount(wide.samplers.link, wide.share, on.model.link_frame.size)[link]
    visible = np.clip(share / COUNT, 0.1, 1.0)
    sigma = np.sqrt(2.0 * np.maximum(variance, 1e-6) / visible[:, None])  # two points of one line share its evidence
    parameters = np.column_stack([line.normal, line.rho])
    return LineFeatures(link, parameters, along, sigma, *tips)
