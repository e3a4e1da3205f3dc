"""One look at an image: a pose to look from in, edge points ready for the solver out.

Samplers are placed on the outline of the posed model, templates and windows rendered for them, profiles taken from the
image, and edges searched as far out as the covariance of the pose says they may be.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from . import _kernels
from .across import polygon_windows
from .appearance import Appearance
from .edges import FOUND, HIDDEN, JOINT, OUTSIDE, EdgePoints, find_edges
from .kinematics import forward, pose_from_free
from .pills import Pills, pose_pills
from .profiles import Profiles, Samplers, outside, place_outline, sample
from .residuals import Chain, LineFeatures, OutlineFeatures, in_world, outline_residuals_numpy, turned_rays
from .settings import Settings
from .templates import Templates, expect, positions

LEAST_REACH, MOST_REACH = 2.5, 60.0  # pixels
_DENSE = 6.0  # spacing below which samplers are as many as fit
_COARSE = 14.0  # pixels of reach beyond which samples are a pixel apart


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """Everything one pass saw.

    Attributes
    ----------
    reach : (n,)
        How far from the predicted edge each sampler searched, pixels.
    expected, found : (n,)
        Samplers that should show an edge, and those that do.
    features : OutlineFeatures or LineFeatures
        The found edges, for the residuals.
    """

    pills: Pills
    samplers: Samplers
    templates: Templates
    profiles: Profiles
    edges: EdgePoints
    reach: Float[np.ndarray, " n"]
    expected: Bool[np.ndarray, " n"]
    found: Bool[np.ndarray, " n"]
    features: OutlineFeatures | LineFeatures


def posed(on: Chain, u: Float[np.ndarray, " k"]) -> Pills:
    """Pills in camera axes at the independent joint values u."""
    return posed_with_frames(on, u)[1]


def posed_numpy(on: Chain, u: Float[np.ndarray, " k"]) -> Pills:
    """The same as `posed` step by step: the twin of the compiled kernel."""
    return pose_pills(on.model, forward(on.model, pose_from_free(on.model, u)), on.camera)


def posed_with_frames(on: Chain, u: Float[np.ndarray, " k"]) -> tuple[Float[np.ndarray, "1 f 4 4"], Pills]:
    """Frames in the world, and pills in camera axes."""
    m, camera = on.model, on.camera
    tree = m.parent, m.prefix, m.joint, m.prismatic, m.link_frame, m.link_base, m.link_tip
    frames, base, tip = _kernels.pose_links(*tree, pose_from_free(m, u), camera.R, camera.t)
    return frames, Pills(base, tip, m.link_radius)


def look(
    image: Float[np.ndarray, "h w"],
    on: Chain,
    u: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "k k"],
    appearance: Appearance,
    settings: Settings,
    widen: float = 1.0,
    before: Look | None = None,
) -> Look:
    """Search the outline's edges around the pose u.

    Parameters
    ----------
    u, covariance : (k,), (k, k)
        Pose to look from, and how far off it may be; the search reaches three sigmas, times `widen`.
    before : Look
        An earlier look from a pose so close that its templates still hold.
    """
    frames, pills = posed_with_frames(on, u)
    samplers = place_outline(pills, on.camera, on.model.link_is_tip, settings.spacing, *_counts(settings.spacing))
    if on.model.link_buried is not None:
        samplers = outside(samplers, on.model.link_buried)
    spread = _predicted_spread(on, samplers, frames, covariance)
    reach = np.clip(widen * (3.0 * spread + 1.0), LEAST_REACH, MOST_REACH)
    farthest = float(reach.max(initial=LEAST_REACH))
    step = 0.5 if farthest <= _COARSE else 1.0
    inwards, outwards = (10.0, 5.0) if step == 0.5 else (14.0, 8.0)
    if before is not None and _same_places(before, samplers, step):
        templates = before.templates
    else:
        templates = expect(samplers, pills, on.model.link_finger, on.camera, appearance, inwards, outwards, step)
        if settings.visibility == "polygons":
            templates = _cut_by_polygons(templates, samplers, pills, on)
    margin = np.ceil(farthest / step) * step
    profiles = sample(image, samplers, positions(inwards + margin, outwards + margin, step), settings.interpolation)
    edges = find_edges(samplers, templates, profiles, reach, widen * spread + 0.5, appearance.noise, appearance.spread)
    found = edges.reason == FOUND
    expected = (edges.reason != HIDDEN) & (edges.reason != JOINT) & (edges.reason != OUTSIDE)
    features = turned_rays(on.camera, samplers.ray, samplers.slope, edges.offset, found, samplers.link, edges.sigma)
    return Look(pills, samplers, templates, profiles, edges, reach, expected, found, features)


def _counts(spacing: float) -> tuple[int, Float[np.ndarray, " k"] | None]:
    """Most samplers on one side of a link, and angles around a tip: as many as the spacing asks for if it is dense."""
    if spacing >= _DENSE:
        return 16, None
    return 64, np.radians(np.linspace(-66.0, 66.0, 2 * int(np.clip(30.0 / spacing, 2, 10)) + 1))


def _cut_by_polygons(templates: Templates, samplers: Samplers, pills: Pills, on: Chain) -> Templates:
    """Windows that also keep to the truncated polygons of the thesis's mean-depth order (4.3.3)."""
    points = samplers.origin[:, None, :] + templates.u[None, :, None] * samplers.direction[:, None, :]
    own, free = polygon_windows(pills, on.model.link_finger, on.camera, samplers.link, points)
    return replace(templates, visible=templates.visible & (own | free))


def _same_places(before: Look, samplers: Samplers, step: float) -> bool:
    """Whether an earlier look's templates are for the same samplers."""
    same = before.samplers.link.size == samplers.link.size and np.array_equal(before.samplers.along, samplers.along)
    return bool(same and abs(before.templates.u[1] - before.templates.u[0] - step) < 1e-9)


def _predicted_spread(
    on: Chain,
    samplers: Samplers,
    frames: Float[np.ndarray, "1 f 4 4"],
    covariance: Float[np.ndarray, "k k"],
) -> Float[np.ndarray, " n"]:
    """Standard deviation of every predicted edge, pixels, from the covariance of the pose."""
    m, spread = on.model, np.empty(samplers.link.size)
    _kernels.outline_spread(
        samplers.ray,
        samplers.slope,
        samplers.link,
        on.camera.R,
        on.camera.t,
        frames[0],
        (m.link_frame, m.link_base, m.link_tip, m.link_radius, on.moves, on.joint_frame, m.prismatic),
        m.coupling,
        on.plain,
        np.ascontiguousarray(covariance),
        spread,
    )
    return spread


def predicted_spread_numpy(
    on: Chain, samplers: Samplers, u: Float[np.ndarray, " k"], covariance: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, " n"]:
    """Standard deviation of every predicted edge in plain NumPy: the twin of the compiled kernel."""
    at = OutlineFeatures(*in_world(on.camera, samplers.ray, samplers.slope), samplers.link, np.ones(samplers.link.size))
    _, J = outline_residuals_numpy(on, at, u)
    return np.sqrt(np.maximum(((J @ covariance) * J).sum(axis=1), 0.0))


def visible_share(samplers: Samplers, edges: EdgePoints, links: int) -> Float[np.ndarray, " l"]:
    """Share of each link's outline, joints with its neighbours apart, that no other finger hides."""
    free = edges.reason != JOINT
    hidden = np.bincount(samplers.link[free & (edges.reason == HIDDEN)], minlength=links)
    total = np.bincount(samplers.link[free], minlength=links)
    return np.where(total > 0, 1.0 - hidden / np.maximum(total, 1), 0.0)
