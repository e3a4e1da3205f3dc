"""Moments of a walk in, the suit's drift and with it the person out: an iterated, robust error-state Kalman filter.

What undoes the drift has four numbers: the place e of the pelvis in the world, which moves with the suit's own steps,
and the turn h of the suit's frame about the vertical,

    e_k = e_{k-1} + Rot_z(h) (s_k - s_{k-1}) + v dt,    h_k = h_{k-1} + g dt,

with a random walk that is faster while the person walks. The paper found the drift "large and asymmetrical, expanding
more significantly in a particular direction" (walk paper, section IV-B, and left it to future work): v and g are its
pace, which changes slowly. Errors c_j of how the suit sits on segment j are constant and followed as well, so that one
and the same wrong posture is not taken for news in every frame. A keypoint m is expected at

    e + Rot_z(h) sum_j R_j exp(-[c_j]) a_mj,

with the suit's own orientations R_j and the way a_mj along segment j to the keypoint. The update is Gauss-Newton's
(Bell & Cathey 1993, "The iterated Kalman filter update as a Gauss-Newton method"), with the weights of Student's t.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ..camera import camera_from_world, pixels_per_unit, project_with_jacobian
from .posture import Body, pose_from_segments
from .posture_tree import SEGMENT_JOINTS
from .walk_baselines import place_from_points
from .walk_moment import Estimate, Moment, keypoint_sigma, lasting_factor
from .walk_settings import Settings

E, H, V, G, C = slice(0, 3), 3, slice(4, 7), 7, slice(8, 47)  # place, heading, their paces, turns of 13 segments
SIZE = 47
CLOSE = 5e-4  # metres and radians: an update that moves place and heading by less has come to rest
WIDE, FAR = 0.25, 1.0  # metres of standard deviation from which the place is uncertain, or lost
AGAIN = (1.0, 40.0)  # metres and degrees that a place from one frame alone may be off
RECENT = 1.5  # frames of the camera since the last update that count as with its help
UNKNOWN_SPEED = 0.7  # m/s by which a person's way is unknown while the suit is silent


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What the filter knows.

    Attributes
    ----------
    body, settings : Body, Settings
    along : (16, 13, 3)
        a_mj: way along each segment, in its axes, on the way to each keypoint; metres.
    x, P : (47,), (47, 47)
        e, h, v, g and c, and their covariance.
    p : (3,)
        Place of the pelvis in the suit's frame at the moment before; NaN before the first.
    updated, period : float
        Seconds at which the camera last helped, and between the camera's frames.
    misfits : int
        Frames in view, one after another, that did not fit.
    fitted : bool
        Whether any did.
    """

    body: Body
    settings: Settings
    along: Float[np.ndarray, "16 13 3"]
    x: Float[np.ndarray, " 47"]
    P: Float[np.ndarray, "47 47"]
    p: Float[np.ndarray, " 3"]
    updated: float = -np.inf
    period: float = 0.0
    misfits: int = 0
    fitted: bool = False


def begin(body: Body, settings: Settings) -> State:
    """The state before the first moment: the suit's frame is the world's, as far as anybody knows."""
    sigma = np.zeros(SIZE)
    sigma[E], sigma[H] = settings.start, np.radians(settings.start_heading)
    if settings.asymmetric:
        sigma[V] = settings.pace * np.array([1.0, 1.0, settings.drift_up])
        sigma[G] = np.radians(settings.heading_pace)
    if settings.calibrate:
        sigma[C] = np.radians(settings.calibration)
        sigma[C.start : C.start + 3] = np.radians(settings.pelvis_calibration)
    return State(body, settings, ways_along(body), np.zeros(SIZE), np.diag(sigma**2), np.full(3, np.nan))


def ways_along(body: Body) -> Float[np.ndarray, "16 13 3"]:
    """Way along each segment, in its own axes, from the pelvis to each keypoint; zero off that way.

    >>> from .posture import body_of
    >>> bool((ways_along(body_of(1.8))[4].any(axis=-1)).sum() == 3)  # left wrist: trunk, upper arm and forearm; lumbar
    False
    """
    out = np.zeros((body.keypoint_segment.size, body.whole.parent.size, 3))
    for m, segment in enumerate(body.keypoint_segment.tolist()):
        out[m, segment] = body.keypoint_local[m]
        while body.whole.parent[segment] >= 0:
            out[m, body.whole.parent[segment]] = body.whole.offset[segment]
            segment = int(body.whole.parent[segment])
    return out


def step(state: State, moment: Moment, rng: np.random.Generator) -> tuple[State, Estimate]:
    """Go on to a moment, and take in what the camera saw; nothing here is random, `rng` stays untouched.

    Returns
    -------
    state : State
    estimate : Estimate
    """
    state = predicted(state, moment)
    restarted = False
    if moment.in_view:
        period = moment.camera_dt if np.isfinite(moment.camera_dt) else state.period
        state = replace(state, period=period)
        after, fits = updated(state, moment)
        if not fits and (not state.fitted or state.misfits + 1 >= state.settings.lost_after):
            again = _again(state, moment)
            if again is not None:
                after, fits = updated(again, moment)
                restarted = fits
        state = after if fits else replace(state, misfits=state.misfits + 1)
    elif moment.seen and np.isfinite(moment.camera_dt):
        state = replace(state, period=moment.camera_dt)
    return state, _estimate(state, moment, restarted)


def predicted(state: State, moment: Moment) -> State:
    """The state at a moment, from that before and the suit's own step."""
    if np.isnan(state.p).any():
        x = state.x.copy()
        x[E] = moment.p[0]
        return replace(state, x=x, p=moment.p[0].copy())
    told, dt = state.settings, moment.dt
    move = moment.p[0] - state.p
    c, s = np.cos(state.x[H]), np.sin(state.x[H])
    x, F = state.x.copy(), np.eye(SIZE)
    keep = np.exp(-dt / told.pace_lasts)
    lasts = told.pace_lasts * (1.0 - keep)  # the pace fades on the way: as many seconds of it count
    x[E] += _about_z(state.x[H]) @ move + state.x[V] * lasts
    x[H] += state.x[G] * lasts
    F[E, H] = -s * move[0] - c * move[1], c * move[0] - s * move[1], 0.0
    F[E, V], F[H, G] = np.eye(3) * lasts, lasts
    x[V], x[G] = keep * x[V], keep * x[G]
    F[V], F[G] = keep * F[V], keep * F[G]
    Q = np.zeros(SIZE)
    walk = (told.drift_noise + told.drift_per_speed * moment.speed) ** 2 * dt
    Q[E] = walk * np.array([1.0, 1.0, told.drift_up**2])
    Q[H] = np.radians(told.heading_noise) ** 2 * dt
    if told.asymmetric:
        new = 1.0 - keep**2
        Q[V] = new * told.pace**2 * np.array([1.0, 1.0, told.drift_up**2])
        Q[G] = new * np.radians(told.heading_pace) ** 2
    P = F @ state.P @ F.T
    P[np.diag_indices(SIZE)] += Q
    return replace(state, x=x, P=P, p=moment.p[0].copy())


def expected(
    state: State, x: Float[np.ndarray, " 47"], moment: Moment
) -> tuple[Float[np.ndarray, "16 3"], Float[np.ndarray, "16 3 47"]]:
    """Keypoints in the world for a state x, and their derivative by it."""
    turn = _about_z(x[H])
    R = turn @ moment.R @ Rotation.from_rotvec(-x[C].reshape(13, 3)).as_matrix()
    way = (R @ state.along[..., None])[..., 0]  # (16, 13, 3)
    reach = way.sum(axis=1)
    J = np.zeros((16, 3, SIZE))
    J[:, :, E] = np.eye(3)
    J[:, 0, H], J[:, 1, H] = -reach[:, 1], reach[:, 0]
    # d/dc of R exp(-[c]) a is R [a] to first order, [a] the matrix of the cross product
    J[:, :, C] = np.moveaxis(R @ _cross(state.along), 1, 2).reshape(16, 3, 39)
    return x[E] + reach, J


def updated(state: State, moment: Moment) -> tuple[State, bool]:
    """The state after a frame in view; unchanged, and False, if most keypoints do not fit."""
    told = state.settings
    x, P = state.x, state.P
    seen = moment.confidence > 0
    PA, inverse = np.zeros((SIZE, 0)), np.zeros((0, 0))
    for i in range(told.iterations):
        points, J = expected(state, x, moment)
        uv, by_point = project_with_jacobian(moment.camera, points)
        use = seen & np.isfinite(uv).all(axis=1) & np.isfinite(by_point).all(axis=(1, 2))
        if np.count_nonzero(use) < told.fewest:
            return state, False
        residual = moment.uv[use] - uv[use]
        A = by_point[use] @ J[use]
        variance = _variance(state, moment, points)[use]
        if i == 0:
            square = _square(residual, A @ P @ np.swapaxes(A, 1, 2), variance)
            if np.mean(square < told.gate**2) <= 0.5:
                return state, False
        else:
            square = (residual**2).sum(axis=1) / variance
        weight = np.where(square < told.gate**2, (told.freedom + 2.0) / (told.freedom + square), 1e-6)
        noise = np.repeat(variance / weight, 2) * lasting_factor(moment, told)
        A = A.reshape(-1, SIZE)
        PA = P @ A.T
        # not by Cholesky: LAPACK's threads wait for each other there, for milliseconds on a busy machine
        inverse = np.linalg.inv(A @ PA + np.diag(noise))
        new = state.x + PA @ (inverse @ (residual.reshape(-1) + A @ (x - state.x)))
        done = i > 0 and np.abs(new - x)[:4].max() < CLOSE
        x = new
        if done:
            break
    P = P - PA @ inverse @ PA.T
    P = 0.5 * (P + P.T)
    return replace(state, x=x, P=P, updated=moment.time, misfits=0, fitted=True), True


def _variance(state: State, moment: Moment, points: Float[np.ndarray, "16 3"]) -> Float[np.ndarray, " 16"]:
    """Of each keypoint along an axis of the image, pixels^2: the network's, the suit's noise, and the body's."""
    told = state.settings
    turned = np.radians(told.orientation_noise) ** 2 * (state.along**2).sum(axis=(1, 2)) * (2.0 / 3.0)
    if not told.calibrate:
        turned = turned * (1.0 + (told.calibration / max(told.orientation_noise, 1e-6)) ** 2)
    near = camera_from_world(moment.camera, points)
    metre = pixels_per_unit(moment.camera, near)
    return keypoint_sigma(moment.confidence, told) ** 2 + metre**2 * (turned + told.length_noise**2)


def _square(
    residual: Float[np.ndarray, "n 2"], spread: Float[np.ndarray, "n 2 2"], variance: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Squared residuals in units of what was to be expected before the frame."""
    whole = spread + variance[:, None, None] * np.eye(2)
    return (residual * np.linalg.solve(whole, residual[..., None])[..., 0]).sum(axis=1)


def _again(state: State, moment: Moment) -> State | None:
    """The state begun anew from this frame of the camera alone; the calibration is kept. None if it shows no place."""
    still = state.x.copy()
    still[E], still[H] = 0.0, 0.0
    found = place_from_points(moment, expected(state, still, moment)[0])
    if found is None:
        return None
    x, P = state.x.copy(), state.P.copy()
    place, turn = found
    x[E], x[H] = place, np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    P[:4], P[:, :4] = 0.0, 0.0
    P[range(4), range(4)] = [AGAIN[0] ** 2] * 3 + [np.radians(AGAIN[1]) ** 2]
    return replace(state, x=x, P=P)


def _estimate(state: State, moment: Moment, restarted: bool) -> Estimate:
    """What is said of a moment."""
    told, x, P = state.settings, state.x, state.P
    turn = _about_z(x[H])
    R = turn @ moment.R @ Rotation.from_rotvec(-x[C].reshape(13, 3)).as_matrix()
    wxyz = Rotation.from_matrix(R).as_quat(scalar_first=True)
    q = pose_from_segments(state.body, np.broadcast_to(x[E], (1, 13, 3)), wxyz[None])[0]
    # the heading is that of the pelvis: h less what its own error turns about the vertical
    A = np.zeros((4, SIZE))
    A[:3, E], A[3, H], A[3, C.start : C.start + 3] = np.eye(3), 1.0, -R[0, 2]
    noise = np.radians(told.orientation_noise) ** 2
    silent = (UNKNOWN_SPEED * moment.since) ** 2
    extra = told.odometry_noise**2 + silent * np.array([1.0, 1.0, 0.1])
    covariance = A @ P @ A.T + np.diag([*extra, noise])
    own = np.diag(P)[C].reshape(13, 3).mean(axis=1) + noise
    pair = own + own[np.maximum(state.body.whole.parent, 0)]
    sigma = np.sqrt(np.repeat(pair, [len(joints) for joints in SEGMENT_JOINTS]))
    points = x[E] + (R @ state.along[..., None])[..., 0].sum(axis=1)
    return Estimate(q, sigma, covariance, points, _status(state, moment, covariance, restarted))


def _status(state: State, moment: Moment, covariance: Float[np.ndarray, "4 4"], restarted: bool) -> str:
    spread = float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
    if spread > FAR or state.misfits >= state.settings.lost_after:
        return "lost"
    if restarted or spread > WIDE or state.misfits:
        return "uncertain"
    recent = moment.time - state.updated <= max(RECENT * state.period, 1e-9)
    return "tracked" if recent else "predicted"


def _about_z(angle: float) -> Float[np.ndarray, "3 3"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _cross(v: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """Matrices of the cross product with each vector from the left."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - np.swapaxes(out, -1, -2)
