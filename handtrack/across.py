"""Posed pills in, the thesis's whole-link profiles with templates and window functions out (hand thesis, 4.1, 4.3.1,
4.3.3).

These samplers cross the whole link. A window keeps what is visible of the own finger, and a margin of background on
each side: without it a half-hidden link slides along itself.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from .appearance import Appearance, shade_numpy
from .camera import Camera, project_camera, rays
from .pills import Pills, ray_hits
from .profiles import Samplers, contact_normals, place_across
from .templates import blurred
from .visibility import truncated_polygons, window

MARGIN = 6.0  # pixels of background kept on each side


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
    edge = _edges(pills, camera, samplers)
    half = float(np.nanmax(np.abs(edge), initial=4.0)) + MARGIN
    u = np.arange(-np.ceil(half / step), np.ceil(half / step) + 1) * step
    points = samplers.origin[:, None, :] + u[None, :, None] * samplers.direction[:, None, :]
    origin, direction = rays(camera, points.reshape(-1, 2))
    hits = ray_hits(pills, origin, direction)
    shape = (samplers.link.size, u.size)
    values = blurred(shade_numpy(appearance, hits.normal, hits.pill).reshape(shape), step, appearance.blur)
    own = np.expand_dims(finger[samplers.link], 1)
    near = np.isfinite(edge).all(axis=1, keepdims=True) & (u >= edge[:, :1] - MARGIN) & (u <= edge[:, 1:] + MARGIN)
    within = (u >= edge[:, :1]) & (u <= edge[:, 1:])
    if polygons:
        group, free = polygon_windows(pills, finger, camera, samplers.link, points)
    else:
        seen = np.where(hits.pill >= 0, finger[hits.pill], -1).reshape(shape)
        group, free = np.asarray(seen == own), np.asarray(seen < 0)
    visible = near & (group | (free & ~within))
    total = np.maximum(within.sum(axis=1), 1)
    return Across(samplers, u, values, visible, edge, (group & within).sum(axis=1) / total)


def _edges(pills: Pills, camera: Camera, samplers: Samplers) -> Float[np.ndarray, "n 2"]:
    """Where the silhouette crosses each sampler: the contact points of both sides, seen along the sampler."""
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
