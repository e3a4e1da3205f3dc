"""One look at an image with a skinned surface: a pose to look from in, edge points ready for the solver out.

What `handtrack.measure` does with pills: samplers on the outline of the posed surface, templates and windows rendered
for them, profiles from the image, edges searched as far out as the covariance of the pose says. Samplers that no
joint moves (on a resting palm, on the arm) are left out.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float

from ..camera import Camera, project_with_jacobian
from ..edges import FOUND, HIDDEN, JOINT, OUTSIDE, EdgePoints, find_edges
from ..kinematics import forward, pose_from_free
from ..measure import LEAST_REACH, MOST_REACH
from ..pills import Pills, pose_pills
from ..profiles import Profiles, Samplers, sample
from ..settings import Settings
from ..templates import Templates, positions
from .contour import Attached, contour_places, place_contour
from .image import box_of, expected_image, profile_pixels
from .residuals import SurfaceFeatures
from .shading import SurfaceAppearance
from .skin import Surface, edge_points
from .templates import expect_contours
from .view import View, moving_box, view_of

_COARSE = 14.0  # pixels of reach beyond which samples are a pixel apart
_STILL = 2.0  # pixels for each radian of the joint that moves it most, below which a sampler tells nothing
_PRECISE = 9.0  # pixels of reach up to which templates are read from a whole expected image


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceLook:
    """Everything one pass saw: the fields of `measure.Look`, the features attached to the surface.

    `pills` are the model's links at the same pose, for pictures.
    """

    pills: Pills
    samplers: Samplers
    templates: Templates
    profiles: Profiles
    edges: EdgePoints
    reach: Float[np.ndarray, " n"]
    expected: Bool[np.ndarray, " n"]
    found: Bool[np.ndarray, " n"]
    features: SurfaceFeatures


def surface_look(
    image: Float[np.ndarray, "h w"],
    surface: Surface,
    camera: Camera,
    u: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "k k"],
    appearance: SurfaceAppearance,
    settings: Settings,
    widen: float = 1.0,
) -> SurfaceLook:
    """Search the edges of the surface's outline around the pose u.

    Parameters
    ----------
    u, covariance : (k,), (k, k)
        Pose to look from, and how far off it may be; the search reaches three sigmas, times `widen`.
    appearance : SurfaceAppearance
        From `learn_surface`.
    """
    view = view_of(surface, camera, u)
    at, samplers, J = _moving_samplers(surface, camera, view, u, settings.spacing)
    spread = np.sqrt(np.maximum(((J @ covariance) * J).sum(axis=1), 0.0))
    reach = np.clip(widen * (3.0 * spread + 1.0), LEAST_REACH, MOST_REACH)
    farthest = float(reach.max(initial=LEAST_REACH))
    step = 0.5 if farthest <= _COARSE else 1.0
    inwards, outwards = (10.0, 5.0) if step == 0.5 else (14.0, 8.0)
    templates = expect_contours(
        surface, view.skin, view.mesh, view.tiles, samplers, at, camera, appearance.plain, inwards, outwards, step
    )
    if farthest <= _PRECISE:
        low, high = moving_box(surface, camera, view, inwards + outwards)
        box = box_of(surface, camera, view, low, high)
        wanted = profile_pixels(box, samplers, templates.u)
        should = expected_image(surface, camera, view, appearance, box, wanted)
        templates = replace(templates, values=sample(should, samplers, templates.u, settings.interpolation).values)
    margin = np.ceil(farthest / step) * step
    profiles = sample(image, samplers, positions(inwards + margin, outwards + margin, step), settings.interpolation)
    edges = find_edges(samplers, templates, profiles, reach, widen * spread + 0.5, appearance.noise, appearance.spread)
    found = edges.reason == FOUND
    expected = (edges.reason != HIDDEN) & (edges.reason != JOINT) & (edges.reason != OUTSIDE)
    features = SurfaceFeatures(
        at.vertex[found],
        at.share[found],
        edges.xy[found],
        samplers.direction[found],
        samplers.link[found],
        edges.sigma[found],
    )
    pills = pose_pills(surface.model, forward(surface.model, pose_from_free(surface.model, u)), camera)
    return SurfaceLook(pills, samplers, templates, profiles, edges, reach, expected, found, features)


def _moving_samplers(
    surface: Surface, camera: Camera, view: View, u: Float[np.ndarray, " k"], spacing: float
) -> tuple[Attached, Samplers, Float[np.ndarray, "n k"]]:
    """Samplers that the joints move in front of the camera, and how far: derivative of the edge along each, pixels."""
    at, _ = contour_places(surface, view.mesh, spacing)
    p, dp = edge_points(surface, at.vertex, at.share, u)
    _, d_xy = project_with_jacobian(camera, p)
    motion = d_xy @ dp
    moving = np.isfinite(motion).all(axis=(1, 2)) & (np.abs(motion).max(axis=(1, 2), initial=0.0) > _STILL)
    at, motion = Attached(*(getattr(at, field.name)[moving] for field in fields(at))), motion[moving]
    samplers = place_contour(surface, view.skin, view.mesh, camera, u, at)
    return at, samplers, (samplers.direction[:, None, :] @ motion)[:, 0, :]
