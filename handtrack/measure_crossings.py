"""One look at an image by the edge searches of the hand thesis's appendix D: a pose to look from in, edges out.

Profiles across each link -> a pair of edges for each profile, by the method asked for -> either every edge against the
outline, with a fan of samplers around each tip, or boundary lines, axial lines and tips as in `measure_lines`.
A tip has no width and no neighbours: its edge is searched by the method's own derivative (hand thesis, 11.1.1).
"""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from .across import crossings
from .appearance import Appearance
from .axes import FLOOR, FindTips, axis_spread, find_axes, find_tips, line_features
from .edges import FOUND, HIDDEN, JOINT, OUTSIDE, EdgePoints
from .edges.crossings import OUTWARD, Crossings
from .edges.derivative import difference, gaussian
from .edges.rectilinear import mwplls, mwplls_iterative, plls
from .edges.width_restricted import width, width_compensated
from .measure import LEAST_REACH, MOST_REACH, Look, posed
from .pills import Pills
from .profiles import CAP, Samplers, place_across, place_outline, sample, with_rays
from .residuals import Chain, LineFeatures, OutlineFeatures, in_world, outline_features, outline_residuals
from .settings import EDGES, Settings
from .templates import EXPECTED, expect, positions
from .templates import HIDDEN as STATE_HIDDEN

_Arrays = TypeVar("_Arrays", EdgePoints, Samplers)
Method = Callable[[Crossings], EdgePoints]
METHODS: tuple[Method, ...] = (difference, gaussian, width, width_compensated, plls, mwplls, mwplls_iterative)
FITTED = ("plls", "mwplls", "mwplls-iterative")  # their edges share the errors of one line for each link
_MASS_FLOOR = 0.25  # pixels: a centre of mass is drawn to the side where the surface is lit, as seen in images
_INWARDS, _OUTWARDS, _STEP = 10.0, 5.0, 0.5  # pixels of template kept beside each edge, to look at
_BESIDE = 6.0  # pixels of profile kept beyond what is searched: the widest mask and its peak


def method_of(edges: str) -> Method:
    """The function behind a name of `settings.EDGES`.

    Raises
    ------
    ValueError
        For 'wssd', which compares with templates and has its own look, and for what is no method.

    >>> method_of("plls").__name__
    'plls'
    """
    names = EDGES[1:]
    if edges not in names:
        raise ValueError(f"edges: got '{edges}', wanted one of {', '.join(names)}")
    return METHODS[names.index(edges)]


def look_crossings(
    image: Float[np.ndarray, "h w"],
    on: Chain,
    u: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "k k"],
    appearance: Appearance,
    settings: Settings,
    count: int,
    widen: float = 1.0,
) -> Look:
    """Search the edges of whole links around the pose u, reaching three sigmas of the prediction.

    Parameters
    ----------
    count : int
        Samplers across each link.

    Returns
    -------
    Look
        One entry for each edge: side -1 and +1 of every profile, then, for outlines, the fans around the tips.
    """
    pills = posed(on, u)
    across = place_across(pills, on.camera, count)
    spread = widen * axis_spread(on, across, u, covariance)
    reach = _reach(spread)
    polygons = settings.visibility == "polygons"
    crossed = crossings(
        image,
        pills,
        on.model.link_finger,
        on.camera,
        appearance,
        across,
        reach,
        spread,
        polygons,
        settings.interpolation,
    )
    edges, samplers = method_of(settings.edges)(crossed), edge_samplers(crossed, on)
    edges = _with_floor(edges, _MASS_FLOOR if settings.edges.startswith("mwplls") else FLOOR)
    reach, sigma = np.repeat(reach, 2), _independent_sigma(settings, samplers.link, edges)
    if settings.residuals == "lines":
        axes = find_axes(samplers.link, samplers.side, *_completed(crossed, edges, sigma))
        tips = find_tips(on, pills, axes, u, covariance, _steepest_tips(image, pills, on, appearance, settings))
        features = line_features(on, pills, axes, _visible(samplers, edges, on.model.link_frame.size), tips)
        return _as_look(image, on, pills, samplers, edges, reach, features, appearance, settings)
    caps = _only_caps(place_outline(pills, on.camera, on.model.link_is_tip, spacing=np.inf))
    cap_spread = widen * _edge_spread(on, caps, u, covariance)
    tips = _with_floor(tip_edges(image, pills, on, appearance, settings, caps, caps, cap_spread), FLOOR)
    edges, samplers = _joined(edges, tips), _joined(samplers, caps)
    found, sigma = edges.reason == FOUND, np.concatenate([sigma, tips.sigma])
    features = outline_features(
        on.camera, edges.xy[found], samplers.direction[found], samplers.link[found], sigma[found]
    )
    reach = np.concatenate([reach, _reach(cap_spread)])
    return _as_look(image, on, pills, samplers, edges, reach, features, appearance, settings)


def edge_samplers(crossed: Crossings, on: Chain) -> Samplers:
    """A sampler on each predicted edge that grows outwards, side -1 before +1 of each profile: u = `EdgePoints.offset`.

    Where a link has no edge it stays on the axis. `contact` is the axis point: the surface is within a radius of it.
    """
    across = crossed.samplers
    n = across.link.size
    origin = across.origin[:, None] + np.nan_to_num(crossed.edge)[..., None] * across.direction[:, None]
    direction = OUTWARD[:, None] * across.direction[:, None]
    link, along, kind = (np.repeat(values, 2) for values in (across.link, across.along, across.kind))
    side, contact = np.tile([-1, 1], n), np.repeat(across.contact, 2, axis=0)
    return with_rays(on.camera, origin.reshape(-1, 2), direction.reshape(-1, 2), link, along, side, kind, contact)


def tip_edges(
    image: Float[np.ndarray, "h w"],
    pills: Pills,
    on: Chain,
    appearance: Appearance,
    settings: Settings,
    expected: Samplers,
    found_on: Samplers,
    spread: Float[np.ndarray, " m"],
) -> EdgePoints:
    """Edges of finger tips by the steepest expected step: the plain difference for 'difference', else the Gaussian.

    Parameters
    ----------
    expected, found_on : Samplers
        Where windows and grey levels are expected, and where the image is read; u = 0 on the predicted edge of both.
    spread : (m,)
        Standard deviation of the predicted edge, pixels.
    """
    reach = _reach(spread)
    margin = np.ceil(float(reach.max(initial=LEAST_REACH)) / _STEP) * _STEP + _BESIDE
    templates = expect(
        expected, pills, on.model.link_finger, on.camera, appearance, _INWARDS + margin, margin + _BESIDE, _STEP
    )
    profiles = sample(image, found_on, templates.u, settings.interpolation)
    middle, beside = int(np.searchsorted(templates.u, 0.0)), round(1.5 / _STEP)
    step = templates.values[:, middle - beside] - templates.values[:, middle + beside - 1]
    state = np.where(templates.state == EXPECTED, FOUND, np.where(templates.state == STATE_HIDDEN, HIDDEN, JOINT))
    nothing = np.zeros(step.size)
    one_sided = Crossings(
        found_on,
        profiles,
        templates.visible & profiles.inside,
        np.stack([nothing + np.nan, nothing], axis=1),
        np.stack([nothing, step], axis=1),
        np.stack([np.full(step.size, JOINT), state], axis=1),
        reach,
        appearance.noise,
        appearance.blur,
    )
    both = (difference if settings.edges == "difference" else gaussian)(one_sided)
    return EdgePoints(*(getattr(both, field.name)[1::2] for field in fields(EdgePoints)))


def _steepest_tips(
    image: Float[np.ndarray, "h w"], pills: Pills, on: Chain, appearance: Appearance, settings: Settings
) -> FindTips:
    def find(expected: Samplers, found_on: Samplers, spread: Float[np.ndarray, " m"]) -> EdgePoints:
        return tip_edges(image, pills, on, appearance, settings, expected, found_on, spread)

    return find


def _as_look(
    image: Float[np.ndarray, "h w"],
    on: Chain,
    pills: Pills,
    samplers: Samplers,
    edges: EdgePoints,
    reach: Float[np.ndarray, " n"],
    features: LineFeatures | OutlineFeatures,
    appearance: Appearance,
    settings: Settings,
) -> Look:
    """The look with what a template would have been at each edge, for those who want to see it."""
    templates = expect(samplers, pills, on.model.link_finger, on.camera, appearance, _INWARDS, _OUTWARDS, _STEP)
    margin = np.ceil(float(reach.max(initial=LEAST_REACH)) / _STEP) * _STEP
    u = positions(_INWARDS + margin, _OUTWARDS + margin, _STEP)
    profiles = sample(image, samplers, u, settings.interpolation)
    expected = ~np.isin(edges.reason, (HIDDEN, JOINT, OUTSIDE))
    return Look(pills, samplers, templates, profiles, edges, reach, expected, edges.reason == FOUND, features)


def _reach(spread: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return np.clip(3.0 * spread + 1.0, LEAST_REACH, MOST_REACH)


def _edge_spread(
    on: Chain, samplers: Samplers, u: Float[np.ndarray, " k"], covariance: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, " n"]:
    """Standard deviation of each predicted edge of the outline, pixels, from the covariance of the pose."""
    at = OutlineFeatures(*in_world(on.camera, samplers.ray, samplers.slope), samplers.link, np.ones(samplers.link.size))
    _, J = outline_residuals(on, at, u)
    return np.sqrt(np.maximum(((J @ covariance) * J).sum(axis=1), 0.0))


def _with_floor(edges: EdgePoints, floor: float) -> EdgePoints:
    """Sigmas with what interpolation and shading leave when noise is absent; the methods know the noise alone."""
    return replace(edges, sigma=np.hypot(edges.sigma, floor))


def _independent_sigma(settings: Settings, link: Int[np.ndarray, " n"], edges: EdgePoints) -> Float[np.ndarray, " n"]:
    """Sigmas with which the edges may be taken for independent.

    All c edges of a fitted line share the errors of its two numbers, so together they must not count for more than
    two, or, where both sides are fitted again to make one axis, for more than one of each number.
    """
    sigma = edges.sigma
    if settings.edges in FITTED:
        count = np.bincount(link, edges.reason == FOUND)[link]
        sigma = sigma * np.sqrt(np.maximum(count * (0.5 if settings.residuals == "outline" else 1.0), 1.0))
    return sigma


def _completed(
    crossed: Crossings, edges: EdgePoints, sigma: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Place, sigma and validity of edges, each that is hidden set at the link's width from the other of its profile.

    An axial line needs both boundaries; with one of them behind another finger the width tells where it is. One
    measurement then stands for two points, so both count half.
    """
    n = crossed.samplers.link.size
    offset, found, spread = edges.offset.reshape(n, 2), (edges.reason == FOUND).reshape(n, 2), sigma.reshape(n, 2)
    lent = (~found & found[:, ::-1]) & np.isfinite(crossed.edge).all(axis=1, keepdims=True)
    offset = np.where(lent, -offset[:, ::-1], offset)
    spread = np.where(lent, spread[:, ::-1], spread) * np.where(lent.any(axis=1, keepdims=True), np.sqrt(2.0), 1.0)
    at = np.nan_to_num(crossed.edge) + OUTWARD * offset
    xy = crossed.samplers.origin[:, None] + at[..., None] * crossed.samplers.direction[:, None]
    return xy.reshape(-1, 2), spread.ravel(), (found | lent).ravel()


def _visible(samplers: Samplers, edges: EdgePoints, links: int) -> Float[np.ndarray, " l"]:
    """Share of each link's edges that nothing hides."""
    hidden = np.bincount(samplers.link, edges.reason == HIDDEN, links)
    return 1.0 - hidden / np.maximum(np.bincount(samplers.link, minlength=links), 1)


def _only_caps(samplers: Samplers) -> Samplers:
    return Samplers(*(getattr(samplers, field.name)[samplers.kind == CAP] for field in fields(Samplers)))


def _joined(first: _Arrays, second: _Arrays) -> _Arrays:
    """Two sets of parallel arrays, one after the other."""
    columns = (np.concatenate([getattr(first, f.name), getattr(second, f.name)]) for f in fields(first))
    return type(first)(*columns)
