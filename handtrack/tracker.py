"""The hand loop: images in, a track out. One step reads like the picture of the method:

predict -> (look -> solve) until the pose rests -> learn the appearance -> filter
"""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from .appearance import Appearance, learn
from .camera import Camera
from .edges import BORDER
from .kinematics import Model
from .measure import Look, look, posed, visible_share
from .measure_lines import first_profiles, look_lines
from .process_noise import process_from_innovations
from .residuals import Chain, Robust, Rows, WithPrior, chain, rows
from .robust import cauchy_weight, median
from .scatter import Scatter, Whitened, first_scatter, learn_scatter, whitener
from .shape_error import ShapeError, first_shape_error, learn_shape_error, shape_jacobian
from .settings import Settings
from .smooth import KalmanState, predict_frozen, start, update
from .solve import solve
from .track import LOST, TRACKED, UNCERTAIN, Track

_MOST_BORDER, _WIDEST = 0.06, 8.0  # share of edges at the end of their search range that asks for a wider one
_PLAIN_S, _PLAIN_TAU = 2.0, 0.1  # scatter that a right model may show
_REST = 0.05  # largest motion of an edge, in pixels, at which a pass ends the frame


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What the tracker carries from frame to frame.

    Attributes
    ----------
    motion : KalmanState
        Independent joints and their velocities.
    psd : (k,)
        Spectral density of each joint's acceleration.
    frozen : (k,)
        Joints that the last frame had no evidence of.
    scatter : Scatter
        How far edges really scatter, learnt from the residuals.
    """

    motion: KalmanState
    psd: Float[np.ndarray, " k"]
    frozen: Bool[np.ndarray, " k"]
    appearance: Appearance | None
    scatter: Scatter
    shape: ShapeError
    stored: Float[np.ndarray, "n m"] | None
    widen: float
    frames: int


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """One frame's result, in independent joints."""

    u: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    full: Float[np.ndarray, "k k"]
    information: Float[np.ndarray, "k k"]
    seen: Look
    residual: float
    scatter: Scatter
    shape: ShapeError
    widen: float


def track(
    frames: Iterable[Float[np.ndarray, "h w"]],
    model: Model,
    camera: Camera,
    start_pose: Float[np.ndarray, " j"],
    fps: float = 25.0,
    settings: Settings | None = None,
    times: Sequence[float] | Float[np.ndarray, " n"] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Track:
    """Track a model through images.

    Parameters
    ----------
    frames : iterable of (h, w) arrays
        Grey levels 0 to 255.
    start_pose : (j,)
        Joint values in the first frame, radians; a few degrees off is fine.
    fps, times : float, (n,)
        Frame rate, or the time of each frame in seconds.
    progress : callable
        Called with the number of frames done.

    Raises
    ------
    ValueError
        For a start pose of the wrong length, or no frame at all.
    """
    settings = settings or Settings()
    if start_pose.shape != (len(model.joint_names),):
        raise ValueError(
            f"start_pose: got {start_pose.size} values, model '{model.name}' has {len(model.joint_names)} joints"
        )
    on = chain(model, camera)
    state = begin(on, start_pose, fps, settings)
    done = []
    last = None
    for number, image in enumerate(frames):
        now = float(times[number]) if times is not None else number / fps
        begun = time.perf_counter()
        state, estimate = step(state, image, on, 0.0 if last is None else now - last, fps, settings)
        done.append((number, now, estimate, state, time.perf_counter() - begun))
        last = now
        if progress is not None:
            progress(number + 1)
    if not done:
        raise ValueError("frames: there is no image to track")
    return _collect(on, done)


def begin(on: Chain, start_pose: Float[np.ndarray, " j"], fps: float, settings: Settings) -> State:
    """State before the first frame: the start pose, unknown velocities."""
    u = start_pose[on.model.free]
    motion = start(u, np.eye(u.size) * settings.start_sigma**2, sigma_velocity=settings.start_speed * fps)
    psd = np.full(u.size, (np.radians(2.0) * fps) ** 2 * fps)
    return State(motion, psd, np.zeros(u.size, dtype=bool), None, first_scatter(), first_shape_error(), None, 1.0, 0)


def step(
    state: State, image: Float[np.ndarray, "h w"], on: Chain, dt: float, fps: float, settings: Settings
) -> tuple[State, Estimate]:
    """One frame: predict, look and solve until the pose rests, learn, filter."""
    motion = state.motion
    if dt > 0.0:
        motion = predict_frozen(motion, dt, state.psd, state.frozen, np.radians(1.0) * np.sqrt(fps))
    appearance = state.appearance or learn(image, posed(on, motion.q), on.camera)
    estimate = _estimate(image, on, motion, appearance, state, settings)
    appearance = learn(image, posed(on, estimate.u), on.camera, appearance)
    if state.appearance is None:  # the first templates were learnt at a pose that was only supposed
        estimate = _estimate(image, on, motion, appearance, state, settings, estimate.u)
        appearance = learn(image, posed(on, estimate.u), on.camera, appearance)
    prior = motion.covariance
    frozen = np.diag(estimate.covariance) > 0.7 * np.diag(prior)
    z, R = _as_measurement(estimate, motion)
    motion, innovation, S = update(motion, z, R)
    psd = process_from_innovations(state.psd, np.where(frozen, np.nan, innovation), S, R) if dt > 0.0 else state.psd
    stored = state.stored
    if settings.templates == "first" and stored is None:
        stored = first_profiles(image, on, estimate.u, appearance, settings)
    return State(motion, psd, frozen, appearance, estimate.scatter, estimate.shape, stored, max(1.0, 0.8 * estimate.widen), state.frames + 1), estimate


def _estimate(
    image: Float[np.ndarray, "h w"],
    on: Chain,
    motion: KalmanState,
    appearance: Appearance,
    state: State,
    settings: Settings,
    first: Float[np.ndarray, " k"] | None = None,
) -> Estimate:
    """Look and solve in turn until the pose rests."""
    prior = motion.covariance
    prior_root = np.linalg.cholesky(np.linalg.inv(prior)).T
    u, search, scatter = motion.q if first is None else first, prior, state.scatter
    limits = on.model.limits[on.model.free]
    bounds = limits if np.isfinite(limits).any() else None
    passes, widen = settings.passes + (4 if state.frames < 3 else 0), state.widen
    for number in range(passes):
        seen = _look(image, on, u, search, appearance, settings, state.stored, widen)
        evidence = rows(on, seen.features, seen.samplers.side[seen.found])
        if evidence.sigma.size < 3:
            search = search * 4.0
            continue
        white = whitener(evidence.sigma, evidence.group, scatter)
        edges = Whitened(evidence.residual, white)
        spread = max(1.0, 1.4826 * median(np.abs(edges(u)[0])))
        for rescale in range(2):
            fun = WithPrior(Robust(edges, spread), motion.q, prior_root)
            solution = solve(fun, u if rescale == 0 else solution.x, bounds=bounds, max_steps=8, tolerance=1e-6)
            spread = max(1.0, 1.4826 * median(np.abs(edges(solution.x)[0])))
        r, J = edges(solution.x)
        weight = cauchy_weight(r / spread)
        moved = np.abs(J @ (solution.x - u)) * evidence.sigma
        u = solution.x
        information = (J * weight[:, None]).T @ J / spread**2
        covariance = np.linalg.inv(information + np.linalg.inv(prior))
        search = covariance * 2.0
        border = (seen.edges.reason == BORDER).sum() > _MOST_BORDER * seen.expected.sum()
        widen = min(2.0 * widen, _WIDEST) if border else widen
        if number > 0 and moved.max() < _REST and not border:
            break
    r_s, J_s = evidence.residual(u)
    # K maps edge errors in units of sigma to errors of the pose.
    K = covariance @ white(r, J * weight[:, None] / spread**2)[1].T
    H = shape_jacobian(on, seen.features, u)
    shape, suggested = _shape_evidence(state, evidence, scatter, r_s, J_s, H, np.sqrt(weight), prior)
    left = r_s - H @ suggested
    scatter = learn_scatter(scatter, left, J_s, np.abs(r / spread), evidence.sigma, evidence.group, K)
    shaped = shape.eps * (K @ H)
    full = covariance + shaped @ shaped.T
    pixels = float(np.sqrt(np.mean((r_s * evidence.sigma) ** 2)))
    return Estimate(u, covariance, full, information, seen, pixels, scatter, shape, widen)


def _shape_evidence(state: State, evidence: Rows, scatter: Scatter, r, J, H, root, prior):
    """Evidence of a wrong shape, judged by the scatter of a right model: else the scatter explains everything first."""
    least = replace(scatter, s=min(scatter.s, _PLAIN_S), tau=min(scatter.tau, _PLAIN_TAU))
    white = whitener(evidence.sigma, evidence.group, least)
    r, both = white(r, np.hstack([J, H]))
    r, both = root * r, root[:, None] * both
    J, H = both[:, : J.shape[1]], both[:, J.shape[1] :]
    return learn_shape_error(state.shape, r, H, J, np.linalg.inv(J.T @ J + np.linalg.inv(prior)))


def _look(image, on: Chain, u, search, appearance: Appearance, settings: Settings, stored, widen: float) -> Look:
    if settings.residuals == "outline":
        return look(image, on, u, search, appearance, settings, widen)
    return look_lines(image, on, u, search, appearance, settings, stored, widen)


def _as_measurement(
    estimate: Estimate, motion: KalmanState
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """The measurement that, with the prediction as prior, gives this estimate."""
    floor = np.radians(60.0) ** -2
    R = np.linalg.inv(estimate.information + floor * np.eye(estimate.u.size))
    prior = np.linalg.inv(motion.covariance)
    return estimate.u + R @ (prior @ (estimate.u - motion.q)), R


def _collect(on: Chain, rows: list) -> Track:
    C, links = on.model.coupling, on.model.link_frame.size
    covariance = np.stack([C @ e.full @ C.T for _, _, e, _, _ in rows])
    q = np.stack([C @ e.u + on.model.coupling_offset for _, _, e, _, _ in rows])
    share = np.array([e.seen.found.sum() / max(e.seen.expected.sum(), 1) for _, _, e, _, _ in rows])
    frozen = np.array([s.frozen.any() for _, _, _, s, _ in rows])
    status = np.where(share < 0.4, LOST, np.where(frozen | (share < 0.7), UNCERTAIN, TRACKED))
    return Track(
        joint_names=on.model.joint_names,
        frame=np.array([n for n, *_ in rows]),
        time=np.array([t for _, t, *_ in rows]),
        q=q,
        sigma=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
        covariance=covariance,
        status=status,
        confidence=share,
        residual=np.array([e.residual for _, _, e, _, _ in rows]),
        visible=np.stack([visible_share(e.seen.pills, e.seen.samplers, e.seen.edges, links) for _, _, e, _, _ in rows]),
        edges=np.array([e.seen.found.sum() for _, _, e, _, _ in rows]),
        seconds=np.array([s for *_, s in rows]),
    )
