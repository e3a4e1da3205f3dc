"""Particles that have gone on to a moment in; what its camera frame makes of them, and what is said of it, out.

This is what the walk paper's two fusion filters have in common (sections III-D and III-E); they differ in how particles
go on from one moment to the next, see `drift_filter` and `pose_filter`.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from . import posture_filter
from .drift_eskf import FAR, RECENT, UNKNOWN_SPEED, WIDE
from .particles import normalised
from .posture import ROOT, Body, heading_first, keypoints
from .posture_filter import Postures
from .walk_baselines import place_from_points
from .walk_cloud import HEADING, SIZE, Cloud, moments_of, renewed, scattered, world_points
from .walk_moment import Estimate, Moment
from .walk_settings import Settings
from .walk_weights import fits, weighed

AGAIN = (0.5, 0.2, 30.0)  # metres along the floor and up, and degrees, that a place from one frame alone may be off


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What a fusion filter knows.

    Attributes
    ----------
    body, settings : Body, Settings
    postures : Postures
        Of the five sub-filters.
    cloud : Cloud
        Of the fusion filter.
    p : (3,)
        Place of the pelvis in the suit's frame at the moment before; NaN before the first.
    tilt : float
        Standard deviation with which tilts of the drift begin, radians; 0 if it has a heading only.
    updated, period : float
        Seconds at which the camera last helped, and between the camera's frames.
    misfits : int
        Frames in view, one after another, that did not fit.
    fitted : bool
        Whether any did.
    """

    body: Body
    settings: Settings
    postures: Postures
    cloud: Cloud
    p: Float[np.ndarray, " 3"]
    tilt: float = 0.0
    updated: float = -np.inf
    period: float = 0.0
    misfits: int = 0
    fitted: bool = False


def begun(body: Body, settings: Settings, tilt: float = 0.0) -> State:
    """The state before the first moment, without a single particle."""
    cloud = scattered(np.zeros(SIZE), np.zeros(SIZE), np.zeros(SIZE), np.zeros((0, 20)), np.random.default_rng(0))
    return State(body, settings, posture_filter.begin(body, settings), cloud, np.full(3, np.nan), tilt)


def postures_at(state: State, moment: Moment, rng: np.random.Generator) -> State:
    """The state with postures that follow the suit to a moment.

    While the suit is silent, its last posture stands. Without the proposal the particles keep postures of their own,
    which walk at random and are weighted by what the suit says of each part.
    """
    told, postures = state.settings, state.postures
    if postures.known and moment.since > 0.0:
        return state
    if told.proposal or not postures.known:
        return replace(state, postures=posture_filter.step(postures, state.body, moment, told, rng))
    cloud = state.cloud
    noise = np.radians(told.posture_noise) * np.sqrt(moment.dt)
    theta = cloud.theta + noise * rng.standard_normal(cloud.theta.shape)
    theta = np.clip(theta, state.body.limits[:, 0], state.body.limits[:, 1])
    z = posture_filter.measured(state.body, moment, told)
    found = posture_filter.log_likelihood(postures, state.body, theta, z, told).sum(axis=1)
    log_weight = np.log(np.maximum(cloud.weight, 1e-300)) + told.temper * found
    return replace(state, cloud=replace(cloud, theta=theta, weight=normalised(log_weight)))


def taken_in(
    state: State, moment: Moment, base: Float[np.ndarray, "3 3"], rng: np.random.Generator
) -> tuple[State, Estimate]:
    """The state after what the camera saw, and the estimate of the moment.

    Parameters
    ----------
    base : (3, 3)
        Orientation of the pelvis before each particle turns it.
    """
    told, restarted = state.settings, False
    if moment.seen and np.isfinite(moment.camera_dt):
        state = replace(state, period=moment.camera_dt)
    if moment.in_view:
        cloud = _in_postures(state, state.cloud, rng)
        points = world_points(cloud, state.body, base)
        good = fits(cloud, points, moment, told)
        lost = not good and (not state.fitted or state.misfits + 1 >= told.lost_after)
        if lost or _spread(cloud) > FAR:
            again = _again(state, moment, base, rng)
            if again is not None:
                cloud, good, restarted = again, True, True
                points = world_points(cloud, state.body, base)
        if good:
            draw = partial(_in_postures, state, rng=rng)
            cloud = weighed(cloud, points, draw, state.body, base, moment, told, rng)
            state = replace(state, cloud=cloud, updated=moment.time, misfits=0, fitted=True)
        else:
            state = replace(state, misfits=state.misfits + 1)
    estimate = _estimate(state, moment, base, restarted)
    return replace(state, cloud=renewed(state.cloud, told.resample, rng)), estimate


def _in_postures(state: State, cloud: Cloud, rng: np.random.Generator) -> Cloud:
    """The particles with postures from the proposal, or, without it, with those that they have."""
    if not state.settings.proposal:
        return cloud
    return replace(cloud, theta=posture_filter.whole_postures(state.postures, cloud.weight.size, rng))


def _spread(cloud: Cloud) -> float:
    """Largest standard deviation of the place."""
    apart = cloud.x[:, :3] - cloud.weight @ cloud.x[:, :3]
    return float(np.sqrt(np.linalg.eigvalsh((apart * cloud.weight[:, None]).T @ apart)[-1]))


def _again(state: State, moment: Moment, base: Float[np.ndarray, "3 3"], rng: np.random.Generator) -> Cloud | None:
    """Particles begun anew from this frame of the camera alone, in the postures there are; None without a place."""
    cloud = state.cloud
    posture, _ = _posture(state, in_view=False)
    q = np.concatenate([np.zeros(ROOT), posture])
    found = place_from_points(moment, keypoints(state.body, q[None])[0] @ base.T)
    if found is None:
        return None
    place, turn = found
    mean = np.zeros(SIZE)
    mean[:3], mean[HEADING] = place, np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    sigma = np.array([AGAIN[0], AGAIN[0], AGAIN[1], state.tilt, state.tilt, np.radians(AGAIN[2])])
    theta = _in_postures(state, cloud, rng).theta
    new = scattered(mean, sigma, np.sqrt(cloud.pace_variance), theta, rng)
    return replace(new, pace=np.tile(cloud.weight @ cloud.pace, (cloud.weight.size, 1)))


def _posture(state: State, in_view: bool) -> tuple[Float[np.ndarray, " 20"], Float[np.ndarray, " 20"]]:
    """Mean posture and standard deviations: of the sub-filters, or of the particles that the camera has weighted."""
    if state.settings.proposal and not in_view:
        return posture_filter.mean_posture(state.postures)
    cloud = state.cloud
    mean = cloud.weight @ cloud.theta
    return mean, np.sqrt(cloud.weight @ (cloud.theta - mean) ** 2)


def _estimate(state: State, moment: Moment, base: Float[np.ndarray, "3 3"], restarted: bool) -> Estimate:
    """What is said of a moment."""
    told = state.settings
    place, turn, covariance = moments_of(state.cloud)
    posture, sigma = _posture(state, in_view=moment.in_view and state.misfits == 0)
    q = np.concatenate([place, heading_first(turn @ base), posture])
    silent = (UNKNOWN_SPEED * moment.since) ** 2
    own = np.radians(np.hypot(told.pelvis_calibration, told.orientation_noise)) ** 2
    extra = told.odometry_noise**2 + silent * np.array([1.0, 1.0, 0.1])
    covariance = covariance + np.diag([*extra, own])
    points = keypoints(state.body, q[None])[0]
    return Estimate(q, sigma, covariance, points, _status(state, moment, covariance, restarted))


def _status(state: State, moment: Moment, covariance: Float[np.ndarray, "4 4"], restarted: bool) -> str:
    spread = float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
    if spread > FAR or state.misfits >= state.settings.lost_after:
        return "lost"
    if restarted or spread > WIDE or state.misfits:
        return "uncertain"
    recent = moment.time - state.updated <= max(RECENT * state.period, 1e-9)
    return "tracked" if recent else "predicted"
