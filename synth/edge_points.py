"""A pose in, simulated edge points and tips in pixels out: the image analysis of the hand thesis without an image.

Appendix B: a link from p1 to p2 is projected (9.1), marks are spread evenly along it (9.2),

    M = dp s^T + P1,    s = [1 2 ... n] / (n + 1)

and each gives two edge points at the distance sigma to both sides along the normal v (9.4, 9.5): S± = M ± sigma v.
The tip of a finger is its projected end. As in the thesis these are points of the projected axis, shifted: the radius
in pixels is that of the link at the mark, which is the pill's silhouette in an orthographic view of an untapered pill
and close to it otherwise.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from handtrack.camera import Camera, pixels_per_unit, project_camera
from handtrack.kinematics import Model, forward
from handtrack.pills import pose_pills


@dataclass(frozen=True, slots=True, eq=False)
class EdgePoints:
    """Edge points of the links of a pose, and the tips of its fingers.

    Attributes
    ----------
    xy : (n, 2)
        Pixels.
    link : (n,)
        Link that each point belongs to.
    side : (n,)
        +1 or -1: on which side of the axis, along v of eq. (9.4).
    tip_xy : (f, 2)
        Pixels of the ends of the last links.
    tip_link : (f,)
        Those links.
    """

    xy: Float[np.ndarray, "n 2"]
    link: Int[np.ndarray, " n"]
    side: Int[np.ndarray, " n"]
    tip_xy: Float[np.ndarray, "f 2"]
    tip_link: Int[np.ndarray, " f"]


def simulate_edge_points(
    model: Model,
    q: Float[np.ndarray, " j"],
    camera: Camera,
    marks: int = 8,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> EdgePoints:
    """Edge points and tips of a pose, hand thesis appendix B, eq. (9.1) to (9.5).

    Parameters
    ----------
    marks : int
        Pairs of points on each link, at least 1.
    noise : float
        Standard deviation, pixels, by which each edge point is off across its link and each tip in both directions.
    rng : Generator, optional
        Wanted where there is noise.

    Returns
    -------
    EdgePoints
        Link by link, the side +v before -v; points of a link seen end on, or behind the camera, are NaN.

    Examples
    --------
    >>> from handtrack.camera import orthographic
    >>> from handtrack.kinematics.builtin import model
    >>> camera = orthographic(64, 48, 2.0, 10.0, 20.0, np.eye(3), np.zeros(3))
    >>> points = simulate_edge_points(model("r"), np.zeros(1), camera, marks=1)
    >>> points.xy.tolist(), points.tip_xy.tolist()
    ([[15.0, 21.0], [15.0, 19.0]], [[20.0, 20.0]])
    """
    if marks < 1:
        raise ValueError(f"marks: {marks}; wanted at least 1 pair of points a link")
    if noise < 0 or (noise > 0 and rng is None):
        raise ValueError(f"noise: {noise} pixels; wanted >= 0, and a generator where it is not 0")
    pills = pose_pills(model, forward(model, q), camera)
    first, last = project_camera(camera, pills.base), project_camera(camera, pills.tip)  # (9.1)
    along = last - first
    s = np.arange(1, marks + 1) / (marks + 1)
    on_axis = first[:, None] + s[:, None] * along[:, None]  # (9.2), (9.3)
    with np.errstate(invalid="ignore", divide="ignore"):
        v = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)  # (9.4)
    centre = pills.base[:, None] + s[:, None] * (pills.tip - pills.base)[:, None]
    radius = pills.radius[:, :1] + s * (pills.radius[:, 1:] - pills.radius[:, :1])
    sigma = np.stack([radius * pixels_per_unit(camera, centre)] * 2, axis=1)
    tips = last[model.link_is_tip]
    if noise > 0 and rng is not None:
        sigma = sigma + noise * rng.standard_normal(sigma.shape)
        tips = tips + noise * rng.standard_normal(tips.shape)
    side = np.array([1.0, -1.0])
    xy = on_axis[:, None] + (side[:, None] * sigma)[..., None] * v[:, None, None]  # (9.5)
    link = np.repeat(np.arange(along.shape[0]), 2 * marks)
    sides = np.tile(np.repeat([1, -1], marks), along.shape[0])
    return EdgePoints(xy.reshape(-1, 2), link, sides, tips, np.flatnonzero(model.link_is_tip))
