"""Moments of a walk in, the person out, without the suit's way through the room: the walk paper's Pose-FF.

Particles of the pelvis's pose follow a walk at random (walk paper, section III-D),

    x_k ~ N(x_{k-1}, Sigma_p dt),

that must be wide enough for whatever a person may do. Only the postures come from the suit, and the pelvis's tilt,
which gravity gives to it without a drift; place and heading are the camera's. Out of view the particles spread until
the person is lost, and begin anew from the first frame that sees the person again.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .posture import Body
from .posture_filter import whole_postures
from .walk_cloud import SIZE, scattered, walked
from .walk_fusion import State, begun, postures_at, taken_in
from .walk_moment import Estimate, Moment
from .walk_settings import Settings

UP = 0.2  # share of the walk at random in the vertical: a pelvis keeps about its height


def begin(body: Body, settings: Settings) -> State:
    """The state before the first moment: the person is about where the suit begins."""
    return begun(body, settings)


def step(state: State, moment: Moment, rng: np.random.Generator) -> tuple[State, Estimate]:
    """Go on to a moment, and take in what the camera saw.

    Returns
    -------
    state : State
    estimate : Estimate
    """
    state = postures_at(state, moment, rng)
    heading, base = _heading_and_tilt(moment)
    return taken_in(predicted(state, moment, heading, rng), moment, base, rng)


def predicted(state: State, moment: Moment, heading: float, rng: np.random.Generator) -> State:
    """The particles at a moment, from those before.

    Parameters
    ----------
    heading : float
        Of the pelvis as the suit has it, radians, to begin with.
    """
    told, none = state.settings, np.zeros(SIZE)
    if np.isnan(state.p).any():
        mean = np.concatenate([moment.p[0], [0.0, 0.0, heading]])
        sigma = np.array([told.start] * 3 + [0.0, 0.0, np.radians(told.start_heading)])
        theta = whole_postures(state.postures, told.particles, rng)
        return replace(state, cloud=scattered(mean, sigma, none, theta, rng), p=moment.p[0].copy())
    place, turn = told.pose_noise**2 * moment.dt, np.radians(told.pose_heading_noise) ** 2 * moment.dt
    noise = np.array([place, place, place * UP**2, 0.0, 0.0, turn])
    still = np.zeros((state.cloud.weight.size, 3))
    return replace(state, cloud=walked(state.cloud, still, moment.dt, noise, 1.0, none, rng))


def _heading_and_tilt(moment: Moment) -> tuple[float, Float[np.ndarray, "3 3"]]:
    """The pelvis's orientation as a turn about the vertical and what comes before it."""
    R = moment.R[0]
    yaw = float(np.arctan2(R[1, 0], R[0, 0]))
    c, s = np.cos(yaw), np.sin(yaw)
    return yaw, np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
