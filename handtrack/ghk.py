"""Measured poses in, filtered and predicted poses out: the g-h-k filter with critically damped gains.

The hand thesis, section 5.1.2, tracks value, velocity and acceleration of each joint with three constant gains,
eq. (5.1)-(5.6), and sets the gains by one number: ``g = 1 - theta^3``, ``h = 1.5 (1 - theta^2)(1 - theta)``,
``k = 0.5 (1 - theta)^3``. That filter is the steady state of a fit: the parabola that minimises the squared errors of
all measurements so far, each discounted by ``theta`` per frame of age.

The fit can be carried on for any frame times, so this module does that: a measurement is discounted by
``theta^(age / dt0)``, and the information of the fit (3 x 3 for each joint, in powers of ``age / dt0``) is kept:

    prediction  L- = theta^(dt / dt0) A^-T L A^-1        correction  L = L- + e1 e1^T,   gains = L^-1 e1

With even frames the gains become exactly the thesis's. After a gap they are larger, as they must; and in the first
frames they are those of the plain fit, so velocity and acceleration start from the first three frames instead of zero.

A constant acceleration is followed without error. A constant jerk J needs the acceleration to grow by ``J T`` a frame,
which eq. (5.1) delivers when the innovation is ``J T^3 / (2 k) = J T^3 / (1 - theta)^3``; the filtered value then lags
by ``1 - g = theta^3`` times that.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .smooth import transition


@dataclass(frozen=True, slots=True, eq=False)
class Ghk:
    """The settings: discount `theta` per `dt0` seconds, 0 < theta < 1 (0.85 in the hand thesis); dt0 > 0.

    Raises
    ------
    ValueError
        A value outside its range.
    """

    theta: float
    dt0: float

    def __post_init__(self) -> None:
        if not 0.0 < self.theta < 1.0:
            raise ValueError(f"theta: {self.theta} is not between 0 and 1")
        if not 0.0 < self.dt0 < np.inf:
            raise ValueError(f"dt0: {self.dt0} is not a finite time > 0")


@dataclass(frozen=True, slots=True, eq=False)
class GhkState:
    """Estimate of each joint and the discounted information behind it.

    Attributes
    ----------
    q, velocity, acceleration : (j,)
        Per second and second squared.
    information : (j, 3, 3)
        Of ``(q, q' dt0, q'' dt0^2)``, in units of one measurement.
    """

    q: Float[np.ndarray, " j"]
    velocity: Float[np.ndarray, " j"]
    acceleration: Float[np.ndarray, " j"]
    information: Float[np.ndarray, "j 3 3"]


# Belief in "velocity and acceleration are as predicted" where no measurement has told, in measurements: small enough to
# yield to any, the acceleration's larger so that two frames make a velocity and no acceleration. It also keeps the
# information regular when a long gap has discounted everything.
_FAINT_VELOCITY, _FAINT_ACCELERATION = 1e-10, 1e-7


def critically_damped_gains(theta: float) -> tuple[float, float, float]:
    """g, h and k of the hand thesis, section 5.1.2, from the discounting factor.

    Parameters
    ----------
    theta : float
        0 (believe the measurement) to 1 (never change).

    Raises
    ------
    ValueError
        `theta` outside [0, 1].

    Examples
    --------
    >>> critically_damped_gains(0.5)
    (0.875, 0.5625, 0.0625)
    """
    if not 0.0 <= theta <= 1.0:
        raise ValueError(f"theta: {theta} is not between 0 and 1")
    return 1.0 - theta**3, 1.5 * (1.0 - theta**2) * (1.0 - theta), 0.5 * (1.0 - theta) ** 3


def ghk_start(
    q: Float[np.ndarray, " j"],
    velocity_weight: float = _FAINT_VELOCITY,
    acceleration_weight: float = _FAINT_ACCELERATION,
) -> GhkState:
    """State after the first frame; the next two start velocity and acceleration.

    Parameters
    ----------
    q : (j,)
        First pose; NaN is refused.
    velocity_weight, acceleration_weight : float
        Belief in "velocity and acceleration are zero" in units of a measurement, > 0; tiny by default. A larger
        acceleration weight calms the extrapolation of the third and fourth frame and is soon discounted.

    Raises
    ------
    ValueError
        `q` is not finite, or a weight is not positive.

    Examples
    --------
    >>> settings, state = Ghk(theta=0.85, dt0=1.0), ghk_start(np.array([1.0]))
    >>> for z in (4.0, 9.0):
    ...     state = ghk_update(ghk_predict(state, 1.0, settings), np.array([z]), settings)
    >>> ghk_predict(state, 1.0, settings).q.round(4).tolist()
    [16.0]
    """
    if not np.isfinite(q).all():
        raise ValueError(f"q: the first pose {q} is not finite")
    if not (velocity_weight > 0.0 and acceleration_weight > 0.0):
        raise ValueError(f"velocity_weight, acceleration_weight: {velocity_weight}, {acceleration_weight} must be > 0")
    information = np.tile(np.diag([1.0, velocity_weight, acceleration_weight]), (q.size, 1, 1))
    return GhkState(q.copy(), np.zeros(q.size), np.zeros(q.size), information)


def ghk_start_steady(q: Float[np.ndarray, " j"], settings: Ghk) -> GhkState:
    """State at rest with the information of an endless past of even frames: the thesis's constant gains from the start.

    Examples
    --------
    >>> settings = Ghk(theta=0.5, dt0=0.04)
    >>> state = ghk_predict(ghk_start_steady(np.zeros(1), settings), 0.04, settings)
    >>> ghk_update(state, np.ones(1), settings).q.round(6).tolist()
    [0.875]
    """
    return GhkState(
        q.copy(), np.zeros(q.size), np.zeros(q.size), np.tile(_steady_information(settings.theta), (q.size, 1, 1))
    )


def ghk_noise_gain(theta: float) -> tuple[float, float]:
    """Variance of the filtered and of the predicted value per variance of the measurements, with even frames.

    The discounted fit is linear in the measurements: with ``L(theta)`` its information its covariance is
    ``L(theta)^-1 L(theta^2) L(theta)^-1`` for white measurement noise of variance 1.

    Parameters
    ----------
    theta : float
        0 < theta < 1.

    Examples
    --------
    >>> [round(gain, 4) for gain in ghk_noise_gain(0.85)]
    [0.2929, 0.3819]
    """
    if not 0.0 < theta < 1.0:
        raise ValueError(f"theta: {theta} is not between 0 and 1")
    inverse = np.linalg.inv(_steady_information(theta))
    covariance = inverse @ _steady_information(theta**2) @ inverse
    ahead = transition(3, 1.0)[0]
    return float(covariance[0, 0]), float(ahead @ covariance @ ahead)


def _steady_information(theta: float) -> Float[np.ndarray, "3 3"]:
    """Sum over i = 0, 1, 2 ... of ``theta^i a a^T``, ``a = [1, -i, i^2 / 2]``, from the power sums of i^m theta^i."""
    t, s = theta, 1.0 - theta
    m0, m1, m2 = 1.0 / s, t / s**2, t * (1.0 + t) / s**3
    m3, m4 = t * (1.0 + 4.0 * t + t**2) / s**4, t * (1.0 + 11.0 * t + 11.0 * t**2 + t**3) / s**5
    return np.array([[m0, -m1, 0.5 * m2], [-m1, m2, -0.5 * m3], [0.5 * m2, -0.5 * m3, 0.25 * m4]])


def ghk_predict(state: GhkState, dt: float, settings: Ghk) -> GhkState:
    """Equations (5.4)-(5.6) over any time step, the information discounted by ``theta^(dt / dt0)``.

    Parameters
    ----------
    state : GhkState
    dt : float
        Seconds, >= 0.
    settings : Ghk

    Raises
    ------
    ValueError
        Negative or infinite `dt`.
    """
    if not 0.0 <= dt < np.inf:
        raise ValueError(f"dt: {dt} is not a finite time step >= 0")
    back = transition(3, -dt / settings.dt0)
    information = settings.theta ** (dt / settings.dt0) * (back.T @ state.information @ back)
    information[:, [1, 2], [1, 2]] += (_FAINT_VELOCITY, _FAINT_ACCELERATION)
    return GhkState(
        q=state.q + state.velocity * dt + state.acceleration * (0.5 * dt * dt),
        velocity=state.velocity + state.acceleration * dt,
        acceleration=state.acceleration,
        information=information,
    )


def ghk_gains(state: GhkState) -> tuple[Float[np.ndarray, " j"], Float[np.ndarray, " j"], Float[np.ndarray, " j"]]:
    """g, h and k that the next measurement of a predicted state will be taken in with, per `dt0`."""
    information = state.information.copy()
    information[:, 0, 0] += 1.0
    gain = np.linalg.solve(information, np.array([[1.0], [0.0], [0.0]]))[..., 0]
    return gain[:, 0], gain[:, 1], 0.5 * gain[:, 2]


def ghk_update(state: GhkState, z: Float[np.ndarray, " j"], settings: Ghk) -> GhkState:
    """Equations (5.1)-(5.3) with the gains of the discounted fit.

    Parameters
    ----------
    state : GhkState
        Predicted for the time of the measurement.
    z : (j,)
        Measured pose; NaN for joints that were not measured.
    settings : Ghk
    """
    seen: Bool[np.ndarray, " j"] = ~np.isnan(z)
    innovation = np.where(seen, z - state.q, 0.0)
    g, h, k = ghk_gains(state)
    information = state.information.copy()
    information[:, 0, 0] += seen
    return GhkState(
        q=state.q + g * innovation,
        velocity=state.velocity + h * innovation / settings.dt0,
        acceleration=state.acceleration + 2.0 * k * innovation / settings.dt0**2,
        information=information,
    )
