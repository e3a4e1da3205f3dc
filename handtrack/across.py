"""Posed pills in, the thesis's whole-link profiles with templates and window functions out (hand thesis, 4.1, 4.3.1,
4.3.3).

These samplers cross the whole link. A window keeps what is visible of the own finger, and a margin of background on
each side: without it a half-hidden link slides along itself. The methods that look for edges one by one get the same
profiles from the image, with windows that stay in the image instead of moving with a template (`crossings`).
"""

from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from .appearance import Appearance, shade_numpy
from .camera import Camera, project_camera, rays
from .edges.crossings import OUTWARD, Crossings
from .edges.points import FOUND, HIDDEN, JOINT, OUTSIDE
from .pills import Hits, Pills, ray_hits
from .profiles import Interpolation, Samplers, contact_normals, place_across, sample
from .templates import blurred
from .visibility import truncated_polygons, window

MARGIN = 6.0  # pixels of background kept on each side
_CLEAR = 1.5  # pixels kept free beside another finger, beyond what its place is uncertain by
_BESIDE = np.arange(1.0, 2.75, 0.5)  # pixels from an edge at which both sides of it must be seen


@dataclass(frozen=True, slots=True, eq=False)
class Across:
    """Samplers across links with what they should see.

    Attributes
    ----------
    u : (m,)
        Positions along every sampler, pixels from the axis.
    values, visible : (n, m)
        Templates and window functions.
    edge : (n, 2)
        Positions u of the silhouette on side -1 and +1; NaN where the link shows none.
    share : (n,)
        Visible share of the link at each sampler.
    """

    samplers: Samplers
    u: Float[np.ndarray, " m"]
    values: Float[np.ndarray, "n m"]
    visible: Bool[np.ndarray, "n m"]
    edge: Float[np.ndarray, "n 2"]
    share: Float[np.ndarray, " n"]


def across(
    pills: Pills,
    finger: Int[np.ndarray, " l"],
    camera: Camera,
    appearance: Appearance,
    count: int,
    polygons: bool,
    step: float = 0.5,
) -> Across:
    """Place `count` samplers across each link and render their templates and windows.

    Parameters
    ----------
    polygons : bool
        Windows from polygons truncated in order of mean depth (4.3.3) instead of from a ray through every sample.
    """
    samplers = place_across(pills, camera, count)
    edge = silhouette_edges(pills, camera, samplers)
    u = _positions(edge, MARGIN, step)
    hits, group, free = _seen(pills, finger, camera, samplers, u, polygons)
    values = blurred(shade_numpy(appearance, hits.normal, hits.pill).reshape(group.shape), step, appearance.blur)
    near = np.isfinite(edge).all(axis=1, keepdims=True) & (u >= edge[:, :1] - MARGIN) & (u <= edge[:, 1:] + MARGIN)
    within = (u >= edge[:, :1]) & (u <= edge[:, 1:])
    visible = near & (group | (free & ~within))
    total = np.maximum(within.sum(axis=1), 1)
    return Across(samplers, u, values, visible, edge, (group & within).sum(axis=1) / total)


def _positions(edge: Float[np.ndarray, "n 2"], beyond: float, step: float) -> Float[np.ndarray, " m"]:
    """Positions along samplers that reach past every edge."""
    half = float(np.nanmax(np.abs(edge), initial=4.0)) + beyond
    return np.arange(-np.ceil(half / step), np.ceil(half / step) + 1) * step


def _seen(
    pills: Pills,
    finger: Int[np.ndarray, " l"],
    camera: Camera,
    samplers: Samplers,
    u: Float[np.ndarray, " m"],
    polygons: bool,
) -> tuple[Hits, Bool[np.ndarray, "n m"], Bool[np.ndarray, "n m"]]:
    """What the ray through every sample hits, and which samples show the own finger, and the background."""
    points = samplers.origin[:, None, :] + u[None, :, None] * samplers.direction[:, None, :]
    hits = ray_hits(pills, *rays(camera, points.reshape(-1, 2)))
    if polygons:
        return hits, *polygon_windows(pills, finger, camera, samplers.link, points)
    seen = np.where(hits.pill >= 0, finger[hits.pill], -1).reshape(points.shape[:2])
    return hits, np.asarray(seen == np.expand_dims(finger[samplers.link], 1)), np.asarray(seen < 0)


def crossings(
    image: Float[np.ndarray, "h w"],
    pills: Pills,
    finger: Int[np.ndarray, " l"],
    camera: Camera,
    appearance: Appearance,
    samplers: Samplers,
    reach: Float[np.ndarray, " n"],
    spread: Float[np.ndarray, " n"],
    polygons: bool = False,
    interpolation: Interpolation = "bilinear",
    step: float = 0.5,
) -> Crossings:
    """Profiles of the image across links, with windows and predicted edges, for the methods of appendix D.

    Parameters
    ----------
    samplers : Samplers
        Across links, as `profiles.place_across` lays them.
    reach, spread : (n,)
        How far from its predicted place an edge may be, and the standard deviation of that place, pixels.
    polygons : bool
        Windows from truncated polygons (4.3.3) instead of from a ray through every sample.
    """
    edge = silhouette_edges(pills, camera, samplers)
    u = _positions(edge, float(reach.max(initial=0.0)) + MARGIN, step)
    hits, own, free = _seen(pills, finger, camera, samplers, u, polygons)
    profiles = sample(image, samplers, u, interpolation)
    clear = _distance_from(~(own | free), step) > (_CLEAR + spread)[:, None]
    usable = clear & profiles.inside
    at = edge[..., None] + OUTWARD[:, None] * _BESIDE
    inner = _index(edge[..., None] - OUTWARD[:, None] * _BESIDE, u)
    outer = _index(at, u)
    row = np.arange(edge.shape[0])[:, None, None]
    state = np.full(edge.shape, FOUND)
    state[own[row, outer].any(axis=2) | ~np.isfinite(edge)] = JOINT
    state[~(own & clear)[row, inner].all(axis=2) | ~clear[row, outer].all(axis=2)] = HIDDEN
    state[~(profiles.inside[row, inner] & profiles.inside[row, outer]).all(axis=2)] = OUTSIDE
    just_inside = row[..., 0] * u.size + inner[..., 1]
    level = shade_numpy(appearance, hits.normal[just_inside.ravel()], hits.pill[just_inside.ravel()])
    rise = level.reshape(edge.shape) - appearance.background
    return Crossings(samplers, profiles, usable, edge, rise, state, reach, appearance.noise, appearance.blur)


def _index(at: Float[np.ndarray, "n s k"], u: Float[np.ndarray, " m"]) -> Int[np.ndarray, "n s k"]:
    """Nearest samples of positions; the middle one where a position is not known."""
    return np.clip(np.rint((np.nan_to_num(at) - u[0]) / (u[1] - u[0])).astype(int), 0, u.size - 1)


def _distance_from(marked: Bool[np.ndarray, "n m"], step: float) -> Float[np.ndarray, "n m"]:
    """Distance of every sample from the nearest marked one of its row, pixels; inf in a row without."""
    index = np.arange(marked.shape[1], dtype=float)
    before = np.maximum.accumulate(np.where(marked, index, -np.inf), axis=1)
    after = np.minimum.accumulate(np.where(marked, index, np.inf)[:, ::-1], axis=1)[:, ::-1]
    return np.minimum(index - before, after - index) * step


def silhouette_edges(pills: Pills, camera: Camera, samplers: Samplers) -> Float[np.ndarray, "n 2"]:
    """Where the silhouette crosses each sampler, side -1 and +1: the contact points of both sides, seen along the
    sampler; NaN where a link shows none.
    """
    radius = pills.radius[samplers.link, 0] + samplers.along * (
        pills.radius[samplers.link, 1] - pills.radius[samplers.link, 0]
    )
    out = np.empty((samplers.link.size, 2))
    for column, side in enumerate((-1.0, 1.0)):
        normal = contact_normals(pills, samplers.link, np.full(samplers.link.size, side), camera)
        seen = project_camera(camera, samplers.contact + radius[:, None] * normal)
        out[:, column] = ((seen - samplers.origin) * samplers.direction).sum(axis=1)
    return np.sort(out, axis=1)


def polygon_windows(
    pills: Pills,
    finger: Int[np.ndarray, " l"],
    camera: Camera,
    link: Int[np.ndarray, " n"],
    points: Float[np.ndarray, "n m 2"],
) -> tuple[Bool[np.ndarray, "n m"], Bool[np.ndarray, "n m"]]:
    """Samples in the truncated polygons of their link's finger, and samples outside every polygon."""
    layers = truncated_polygons(pills, camera, finger)
    own = np.zeros(points.shape[:2], dtype=bool)
    for number in np.unique(finger):
        rows = finger[link] == number
        merged = shapely.union_all(layers.truncated[finger == number])
        own[rows] = window(merged, points[rows])
    return own, ~window(shapely.union_all(layers.whole), points)
