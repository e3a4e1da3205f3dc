"""The four chains of the hand thesis, section 3.2, as least-squares problems ``q -> (residuals, Jacobian)``.

Residuals are those of section 3.1.1: two per observed tip, eq. (3.1), and one per point on a link, its distance from
the observed axial line ``a x + b y = rho``, eq. (3.2). Jacobians are eq. (3.7) and (3.8): the image point's derivative,
and its component along the line's normal. Frames and their Jacobians come from `handtrack.kinematics`, the projection
from `handtrack.camera`.

The text lacks the figures with the set-ups of the first three chains; these follow from the printed iterates.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..camera import Camera, orthographic, project_with_jacobian
from ..kinematics import Model, forward, point_jacobian
from ..kinematics.builtin import model as builtin_model

# Two points on each link, at these distances from its joint (Figures 3.20 and 3.24).
POINTS = (3.0, 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class ChainProblem:
    """Points on a chain and the features of an image that they are to meet.

    Attributes
    ----------
    model, camera
        The chain, and the image frame that section 3.2 gives it: one pixel per unit, {0} at p0.
    tip_link : int
        Index of the link whose end is the tip.
    tip : (2,)
        Observed tip.
    link, along : (n,), (n,)
        Link of each point, and its distance from the link's joint.
    line : (n, 3)
        ``[a, b, rho]`` of the line that each point should lie on.
    """

    model: Model
    camera: Camera
    tip_link: int
    tip: Float[np.ndarray, " 2"]
    link: Int[np.ndarray, " n"]
    along: Float[np.ndarray, " n"]
    line: Float[np.ndarray, "n 3"]

    def __call__(self, q: Float[np.ndarray, " j"]) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m j"]]:
        """Residuals and Jacobian for `handtrack.solve.solve`: tip x, tip y, then the points."""
        link = np.append(self.tip_link, self.link)
        along = np.append(self.model.link_length[self.tip_link], self.along)
        xy, d_xy = _image_points(self.model, self.camera, q, link, along)
        normal = self.line[:, :2]
        distance = (normal * xy[1:]).sum(axis=1) - self.line[:, 2]
        d_distance = (normal[:, None, :] @ d_xy[1:])[:, 0]
        return np.concatenate([xy[0] - self.tip, distance]), np.concatenate([d_xy[0], d_distance])


def _image_points(model, camera, q, link, along):
    """Points on link axes in the image (n, 2), and their derivative by the joints (n, 2, j)."""
    frames = forward(model, q)
    frame = model.link_frame[link]
    p_world = frames[frame, :3, 3] + along[:, None] * frames[frame, :3, 0]
    xy, d_xy = project_with_jacobian(camera, p_world)
    return xy, d_xy @ point_jacobian(model, frames, frame, p_world)


def r_chain() -> ChainProblem:
    """Section 3.2.1: ideal pose 90 degrees, the line is the vertical through p0."""
    return _problem("r", np.eye(3), (0.0, 0.0), (math.pi / 2,), ((1.0, 0.0, 0.0),))


def p_chain() -> ChainProblem:
    """Section 3.2.2: the link stands on a slide along the image's x axis; ideal d1 = 0."""
    return _problem("p", np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), (0.0, 0.0), (0.0,), ((1.0, 0.0, 0.0),))


def pr_chain() -> ChainProblem:
    """Section 3.2.3: ideal d1 = 3, theta2 = -30 degrees; the line runs through the link at that pose."""
    turn = math.radians(-30.0)
    line = (math.cos(turn), math.sin(turn), 3.0 * math.cos(turn))
    return _problem("pr", np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), (0.0, 0.0), (3.0, turn), (line,))


def rr_chain() -> ChainProblem:
    """Section 3.2.4, Figures 3.20 and 3.24: r1 is the line of the base link, r2 of the terminal one.

    The equations of the section pair them the other way round; only this pairing gives the printed costs. Those also
    tell that the lines' parameters, printed with 3 and 4 decimals, were used in full: -sqrt(3)/2, and 3 + 5 sqrt(3)/2.
    """
    half = math.sqrt(3.0) / 2.0
    lines = ((0.5, -half, 1.5), (1.0, 0.0, 3.0 + 5.0 * half))
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    return _problem("rr", turn, (3.0, 0.0), (-math.pi / 3, -2 * math.pi / 3), lines)


def _problem(name, R, p0, ideal, lines) -> ChainProblem:
    """The problem whose observed tip is that of the ideal pose."""
    model = builtin_model(name)
    camera = orthographic(640, 480, 1.0, 0.0, 0.0, R, np.array([*p0, 0.0]))
    count = model.link_frame.size
    tip_link = np.array([count - 1])
    tip, _ = _image_points(model, camera, np.array(ideal), tip_link, model.link_length[tip_link])
    return ChainProblem(
        model=model,
        camera=camera,
        tip_link=count - 1,
        tip=tip[0],
        link=np.repeat(np.arange(count), len(POINTS)),
        along=np.tile(POINTS, count),
        line=np.repeat(np.array(lines), len(POINTS), axis=0),
    )
