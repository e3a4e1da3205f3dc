"""Measured poses in, filtered and predicted poses with their covariance out: the discrete Kalman filter.

The state holds the joint values and their first (order 2) or first and second (order 3) derivatives, stacked by
derivative, ``x = [q, q']`` or ``[q, q', q'']``, with one joint covariance P for the whole pose. Time and measurement
update are those of the hand thesis, section 5.1.1:

    x- = A x,  P- = A P A^T + Q                     K = P- H^T (H P- H^T + R)^-1,  x = x- + K (z - H x-)

with H picking the joint values. The highest derivative is driven by white noise of power spectral density `psd` (white
acceleration for order 2, white jerk for order 3), integrated exactly over a step of any length, so missing frames and
uneven frame times need no special case. `handtrack.process_noise` finds `psd` from the motion itself;
`handtrack.ghk` is the constant-gain filter of section 5.1.2.

Every function takes leading batch axes: b independent filters of one joint each, or one filter of j joints.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import factorial

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True, slots=True, eq=False)
class KalmanState:
    """What a filter believes about a pose at one time; radians and seconds (model units for prismatic joints).

    Attributes
    ----------
    x : (*b, order * j)
        Joint values, then their first, then their second derivatives.
    P : (*b, order * j, order * j)
        Covariance of `x`.
    order : int
        2: constant velocity but for white acceleration; 3: constant acceleration but for white jerk.
    """

    x: Float[np.ndarray, "*b n"]
    P: Float[np.ndarray, "*b n n"]
    order: int

    @property
    def q(self) -> Float[np.ndarray, "*b j"]:
        """Joint values."""
        return self.x[..., : self.x.shape[-1] // self.order]

    @property
    def velocity(self) -> Float[np.ndarray, "*b j"]:
        """First derivatives of the joint values."""
        j = self.x.shape[-1] // self.order
        return self.x[..., j : 2 * j]

    @property
    def covariance(self) -> Float[np.ndarray, "*b j j"]:
        """Covariance of the joint values."""
        j = self.x.shape[-1] // self.order
        return self.P[..., :j, :j]

    @property
    def sigma(self) -> Float[np.ndarray, "*b j"]:
        """Standard deviation of the joint values."""
        return np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))


def start(
    q: Float[np.ndarray, "*b j"],
    R: Float[np.ndarray, "*b j j"],
    *,
    sigma_velocity: float | Float[np.ndarray, "*b j"],
    sigma_acceleration: float | Float[np.ndarray, "*b j"] | None = None,
) -> KalmanState:
    """State at the first frame: at rest, but sure of that only as far as `sigma_velocity` says.

    The next frames then start the velocity by themselves; for a large `sigma_velocity` the second frame sets it to the
    difference quotient of the first two, with that quotient's covariance (and a third frame the acceleration). A zero
    velocity believed too firmly is what loses fast motion.

    Parameters
    ----------
    q, R : (*b, j), (*b, j, j)
        First pose and its covariance.
    sigma_velocity : float or (*b, j)
        Spread of joint velocities to expect, per second.
    sigma_acceleration : float or (*b, j), optional
        Spread of accelerations; makes the state one of order 3.

    Returns
    -------
    KalmanState

    Examples
    --------
    >>> state = start(np.zeros(1), np.eye(1), sigma_velocity=1e4)
    >>> state, _, _ = update(predict(state, 0.5, psd=0.0), np.array([2.0]), np.eye(1))
    >>> state.velocity.round(3).tolist()
    [4.0]
    """
    sigmas = [sigma_velocity] if sigma_acceleration is None else [sigma_velocity, sigma_acceleration]
    order, j = len(sigmas) + 1, q.shape[-1]
    x = np.concatenate([q, np.zeros((*q.shape[:-1], (order - 1) * j))], axis=-1)
    P = np.zeros((*q.shape[:-1], order * j, order * j))
    P[..., :j, :j] = R
    for level, sigma in enumerate(sigmas, start=1):
        rows = range(level * j, (level + 1) * j)
        P[..., rows, rows] = np.square(sigma)
    return KalmanState(x, P, order)


@lru_cache(maxsize=64)
def transition(order: int, dt: float) -> Float[np.ndarray, "order order"]:
    """A for one joint: Taylor's polynomial, equations (5.4)-(5.6) for order 3. The array is shared: read only.

    >>> transition(3, 2.0).tolist()
    [[1.0, 2.0, 2.0], [0.0, 1.0, 2.0], [0.0, 0.0, 1.0]]
    """
    A = np.array([[dt ** (c - r) / factorial(c - r) if c >= r else 0.0 for c in range(order)] for r in range(order)])
    A.setflags(write=False)
    return A


@lru_cache(maxsize=64)
def process_covariance(order: int, dt: float) -> Float[np.ndarray, "order order"]:
    """Q for one joint and unit spectral density: white noise in the highest derivative, integrated exactly.

    With ``g(s) = [s^(order-1) / (order-1)!, ..., s, 1]`` the response to noise that is s seconds old,
    ``Q = integral of g g^T from 0 to dt``. The array is shared: read only.

    >>> process_covariance(2, 2.0).round(6).tolist()
    [[2.666667, 2.0], [2.0, 2.0]]
    """
    power = np.arange(order - 1, -1, -1)
    scale = np.array([factorial(p) for p in power])
    total = power[:, None] + power + 1
    Q = dt**total / (total * scale[:, None] * scale)
    Q.setflags(write=False)
    return Q


def predict(state: KalmanState, dt: float, psd: float | Float[np.ndarray, "*b j"]) -> KalmanState:
    """Time update: where the pose will be `dt` seconds later, and how sure that is.

    Parameters
    ----------
    state : KalmanState
    dt : float
        Seconds, >= 0, any.
    psd : float or (*b, j)
        Power spectral density of the driving noise, >= 0: rad^2/s^3 (order 2) or rad^2/s^5 (order 3).

    Returns
    -------
    KalmanState

    Raises
    ------
    ValueError
        Negative `dt` or `psd`, or one that is not finite.

    Examples
    --------
    >>> state = KalmanState(np.array([1.0, 2.0]), np.eye(2), order=2)
    >>> predict(state, 0.5, psd=0.0).x.tolist(), predict(state, 0.5, psd=0.0).covariance.tolist()
    ([2.0, 2.0], [[1.25]])
    """
    order, j = state.order, state.x.shape[-1] // state.order
    psd = _checked_noise(dt, psd)
    A = transition(order, dt)
    batch = state.x.shape[:-1]
    x = (A @ state.x.reshape(*batch, order, j)).reshape(state.x.shape)
    # A acts on derivatives, not on joints: both products run over reshaped blocks instead of a Kronecker product.
    left = (A @ state.P.reshape(*batch, order, -1)).reshape(*batch, order * j, order, j)
    P = (A @ left).reshape(state.P.shape)
    return KalmanState(x, _with_process_noise(P, order, dt, psd), order)


def predict_frozen(
    state: KalmanState,
    dt: float,
    psd: float | Float[np.ndarray, " j"],
    frozen: Bool[np.ndarray, " j"],
    rate: float | Float[np.ndarray, " j"],
) -> KalmanState:
    """Time update in which joints without evidence keep their last pose, with a sigma that grows.

    A hidden finger may do anything; carrying its last velocity on leads it away. A frozen joint therefore performs a
    random walk: its value stays, ``sigma^2`` grows by ``rate^2 dt``, and its velocity is set to zero. Since the
    velocity it had may still be the true one, the variance of its derivatives becomes their second moment about zero,
    ``var + mean^2``, which does not grow further; they are no longer correlated with anything.

    Parameters
    ----------
    state, dt, psd
        As for `predict`; one filter, no batch axes.
    frozen : (j,)
        Joints to freeze; the others are predicted as usual.
    rate : float or (j,)
        Growth of the standard deviation in one second, rad/sqrt(s), >= 0.

    Returns
    -------
    KalmanState

    Examples
    --------
    >>> state = KalmanState(np.array([1.0, 2.0]), np.diag([0.01, 0.01]), order=2)
    >>> later = predict_frozen(state, 4.0, 0.0, np.array([True]), rate=0.1)
    >>> later.x.tolist(), later.P.round(9).tolist()
    ([1.0, 0.0], [[0.05, 0.0], [0.0, 4.01]])
    """
    if not frozen.any():
        return predict(state, dt, psd)
    order, j = state.order, frozen.size
    psd = np.where(frozen, 0.0, _checked_noise(dt, psd))
    held = np.tile(frozen, order)
    value = held & (np.arange(order * j) < j)
    derivative = held & ~value
    A = np.kron(transition(order, dt), np.eye(j))
    A[held] = 0.0
    A[value, value] = 1.0
    P = _with_process_noise(A @ state.P @ A.T, order, dt, psd)
    P[value, value] += (np.square(rate) * dt * np.ones(j))[frozen]
    P[derivative, derivative] = np.diagonal(state.P)[derivative] + np.square(state.x[derivative])
    return KalmanState(A @ state.x, P, order)


def update(
    state: KalmanState, z: Float[np.ndarray, "*b j"], R: Float[np.ndarray, "*b j j"]
) -> tuple[KalmanState, Float[np.ndarray, "*b j"], Float[np.ndarray, "*b j j"]]:
    """Measurement update with a whole pose and its full covariance.

    Parameters
    ----------
    state : KalmanState
        Predicted for the time of the measurement.
    z : (*b, j)
        Measured joint values; NaN for joints that were not measured, which then change only through their correlation
        with the others.
    R : (*b, j, j)
        Covariance of `z`; rows of joints that were not measured are not read.

    Returns
    -------
    state : KalmanState
        With the measurement taken in; P stays symmetric and positive definite (Joseph form).
    innovation : (*b, j)
        ``z - H x-``, NaN where not measured.
    S : (*b, j, j)
        Covariance of the innovation, ``H P- H^T + R``; where not measured the prediction's own covariance.

    Examples
    --------
    >>> state = KalmanState(np.zeros(2), np.diag([1.0, 4.0]), order=2)
    >>> state, innovation, S = update(state, np.array([2.0]), np.array([[1.0]]))
    >>> state.q.tolist(), state.covariance.tolist(), S.tolist()
    ([1.0], [[0.5]], [[2.0]])
    """
    j = z.shape[-1]
    innovation = z - state.q
    seen = ~np.isnan(innovation)
    all_seen = bool(seen.all())
    both = seen[..., :, None] & seen[..., None, :]
    noise = R if all_seen else np.where(both, R, 0.0)
    S = state.covariance + noise
    cross = state.P[..., :j, :]
    if all_seen:
        gain = np.linalg.solve(S, cross).swapaxes(-1, -2)
        step = innovation
    else:
        # An unmeasured joint gets a unit row in S and a zero column in the gain: exact, and the shapes stay.
        solvable = np.where(both, S, np.eye(j))
        gain = np.linalg.solve(solvable, np.where(seen[..., :, None], cross, 0.0)).swapaxes(-1, -2)
        step = np.where(seen, innovation, 0.0)
    x = state.x + (gain @ step[..., None])[..., 0]
    # Joseph's (I - K H) P (I - K H)^T + K R K^T, multiplied out with left = (I - K H) P: it stays definite where
    # P - K S K^T would cancel (P of 1e6 for an unknown velocity against R of 1e-8).
    left = state.P - gain @ cross
    P = left - (left[..., :j] - gain @ noise) @ gain.swapaxes(-1, -2)
    return KalmanState(x, 0.5 * (P + P.swapaxes(-1, -2)), state.order), innovation, S


def _checked_noise(dt: float, psd: float | Float[np.ndarray, "*b j"]) -> Float[np.ndarray, "..."]:
    density = np.asarray(psd, float)
    if not 0.0 <= dt < np.inf:
        raise ValueError(f"dt: {dt} is not a finite time step >= 0")
    if not (np.isfinite(density).all() and (density >= 0.0).all()):
        raise ValueError(f"psd: {psd} must be finite and not negative")
    return density


def _with_process_noise(P, order: int, dt: float, psd):
    """P plus the exact process covariance, joint by joint."""
    j = P.shape[-1] // order
    out = np.array(P)
    # A repeated index in einsum is a view of the diagonals of all derivative blocks.
    blocks = np.einsum("...rjcj->...rcj", out.reshape(*P.shape[:-2], order, j, order, j))
    blocks += process_covariance(order, dt)[:, :, None] * np.atleast_1d(psd)[..., None, None, :]
    return out
