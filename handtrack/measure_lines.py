"""One look at an image in the thesis's own way: a pose to look from in, axial lines and tips out.

Profiles across each link -> WSSD surface -> valley -> a pair of edges for each profile -> boundary lines (RANSAC,
PCA) -> axial line (bisector) -> tip searched along it. The tip's search is gated: it uses the rendered template of
the cap, so an edge of another finger or of the wrong sign is no match, and starts from the refined tip of eq. (4.1).
With another method of edge search the look is that of `measure_crossings`.
"""

import numpy as np
from jaxtyping import Float, Int

from .across import Across, across
from .appearance import Appearance
from .axes import FLOOR, FindTips, axis_spread, find_axes, find_tips, line_features
from .edges import FLAT, FOUND, HIDDEN, MISFIT, OUTSIDE, EdgePoints, curves, find_edges
from .edges.valley import fit_valley
from .measure import LEAST_REACH, MOST_REACH, Look, posed
from .measure_crossings import look_crossings
from .pills import Pills
from .profiles import Profiles, Samplers, sample
from .residuals import Chain
from .settings import Settings
from .templates import Templates, expect, positions

COUNT = 8  # samplers across each link
_LEAST_SHARE = 0.45  # of a link visible at a sampler
_HIDDEN = 1.0  # pixels: what a wholly hidden link would add, since a window's cut moves with the pose


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
    """Measure whole links around the pose u, reaching three sigmas of the prediction.

    Parameters
    ----------
    stored : (n, m)
        Profiles of the first frame to use as templates instead of rendered ones; only 'wssd' has templates.

    Returns
    -------
    Look
        With axial lines and tips; with edge points against the outline where `settings` say `residuals='outline'`
        and another method than 'wssd'.
    """
    if settings.edges != "wssd":
        return look_crossings(image, on, u, covariance, appearance, settings, COUNT, widen)
    pills = posed(on, u)
    wide = across(pills, on.model.link_finger, on.camera, appearance, COUNT, settings.visibility == "polygons")
    spread = widen * axis_spread(on, wide.samplers, u, covariance)
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
    axes = find_axes(*_pairs(wide, edges))
    tips = find_tips(on, pills, axes, u, covariance, _matched_tips(image, pills, on, appearance, settings))
    share = np.bincount(wide.samplers.link, wide.share, on.model.link_frame.size) / COUNT
    features = line_features(on, pills, axes, share, tips)
    expected = ~np.isin(reason, (HIDDEN, OUTSIDE))
    return Look(pills, wide.samplers, templates, profiles, edges, reach, expected, found, features)


def first_profiles(
    image: Float[np.ndarray, "h w"], on: Chain, u: Float[np.ndarray, " k"], appearance: Appearance, settings: Settings
) -> Float[np.ndarray, "n m"]:
    """The thesis's templates: what the profiles of a frame without occlusion look like."""
    wide = across(posed(on, u), on.model.link_finger, on.camera, appearance, COUNT, settings.visibility == "polygons")
    return sample(image, wide.samplers, wide.u, settings.interpolation).values


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
        sigma[rows[kept]] = np.hypot(claimed, FLOOR + _HIDDEN * (1.0 - wide.share[rows[kept]]))
    return offset, sigma, reason


def _edge_points(
    wide: Across, offset: Float[np.ndarray, " n"], sigma: Float[np.ndarray, " n"], reason: Int[np.ndarray, " n"]
) -> EdgePoints:
    """The profile centres as points; the pairs of edges stand at `offset + edge`."""
    xy = wide.samplers.origin + offset[:, None] * wide.samplers.direction
    return EdgePoints(xy, offset, sigma, reason, np.zeros(offset.size))


def _pairs(
    wide: Across, edges: EdgePoints
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Float[np.ndarray, "p 2"], Float[np.ndarray, " p"], np.ndarray]:
    """Link, side, place and sigma of both edges of each profile, and whether they were found."""
    n = edges.offset.size
    at = edges.offset[:, None] + wide.edge
    xy = wide.samplers.origin[:, None] + at[..., None] * wide.samplers.direction[:, None]
    # Both edges of a profile come from one match: each counts half.
    sigma = np.repeat(np.sqrt(2.0) * edges.sigma, 2)
    side = np.tile([-1, 1], n)
    return np.repeat(wide.samplers.link, 2), side, xy.reshape(-1, 2), sigma, np.repeat(edges.reason == FOUND, 2)


def _matched_tips(
    image: Float[np.ndarray, "h w"], pills: Pills, on: Chain, appearance: Appearance, settings: Settings
) -> FindTips:
    """Tips by the rendered template of the cap."""

    def find(expected: Samplers, found_on: Samplers, spread: Float[np.ndarray, " m"]) -> EdgePoints:
        templates = expect(expected, pills, on.model.link_finger, on.camera, appearance)
        reach = np.clip(3.0 * spread + 1.0, LEAST_REACH, MOST_REACH)
        margin = np.ceil(reach.max() * 2.0) / 2.0
        profiles = sample(image, found_on, positions(12.0 + margin, 6.0 + margin, 0.5), settings.interpolation)
        return find_edges(found_on, templates, profiles, reach, spread + 0.5, appearance.noise, appearance.spread)

    return find
