"""Moments of a walk in, the suit's drift and with it the person out: the walk paper's Drift-FF.

Particles of the drift (walk paper, section III-E): the place e of the pelvis in the world, which moves with the suit's
own steps s_k - s_{k-1}, and the turn D of the suit's frame, a heading and, where wanted, two tilts:

    e_k = e_{k-1} + D (s_k - s_{k-1}) + v dt + noise,    h_k = h_{k-1} + g dt + noise.

The paper does not state what the drift composes with. To turn about the pelvis's present place, not about the suit's
far origin, keeps place and heading independent. The noise is faster while the person walks, small against Pose-FF's.
The drift is "large and asymmetrical" (section IV-B): v and g are its own pace, which each particle learns from its way.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .posture import Body
from .posture_filter import whole_postures
from .walk_cloud import SIZE, scattered, turns, walked
from .walk_fusion import State, begun, postures_at, taken_in
from .walk_moment import Estimate, Moment
from .walk_settings import Settings

TILT_NOISE = 0.05  # share of their usual size by which tilts change in a minute: gravity keeps them


def begin(body: Body, settings: Settings) -> State:
    """The state before the first moment: the suit's frame is the world's, as far as anybody knows."""
    return begun(body, settings, float(np.radians(settings.tilt)))


def step(state: State, moment: Moment, rng: np.random.Generator) -> tuple[State, Estimate]:
    """Go on to a moment, and take in what the camera saw.

    Returns
    -------
    state : State
    estimate : Estimate
    """
    state = postures_at(state, moment, rng)
    state = predicted(state, moment, rng)
    return taken_in(state, moment, moment.R[0], rng)


def predicted(state: State, moment: Moment, rng: np.random.Generator) -> State:
    """The particles at a moment, from those before and the suit's own step."""
    told, dt = state.settings, moment.dt
    usual = _paces(told)
    if np.isnan(state.p).any():
        mean = np.concatenate([moment.p[0], np.zeros(3)])
        sigma = [told.start, told.start, told.start, state.tilt, state.tilt, np.radians(told.start_heading)]
        theta = whole_postures(state.postures, told.particles, rng)
        return replace(state, cloud=scattered(mean, np.array(sigma), usual, theta, rng), p=moment.p[0].copy())
    way = turns(state.cloud.x) @ (moment.p[0] - state.p)
    walk = (told.drift_noise + told.drift_per_speed * moment.speed) ** 2 * dt
    up = walk * told.drift_up**2
    tilt = (TILT_NOISE * state.tilt) ** 2 * dt / 60.0
    noise = np.array([walk, walk, up, tilt, tilt, np.radians(told.heading_noise) ** 2 * dt])
    keep = float(np.exp(-dt / told.pace_lasts))
    return replace(state, cloud=walked(state.cloud, way, dt, noise, keep, usual, rng), p=moment.p[0].copy())


def _paces(told: Settings) -> Float[np.ndarray, " 6"]:
    """Usual standard deviations of the drift's paces, per second."""
    out = np.zeros(SIZE)
    if told.asymmetric:
        out[:3] = told.pace * np.array([1.0, 1.0, told.drift_up])
        out[SIZE - 1] = np.radians(told.heading_pace)
    return out
