"""Measured poses in, the next frame's prediction with its covariance out: one interface for the three filters.

`kalman` carries pose and velocity with full covariance and learns how restless each joint is. `ghk` predicts by the
critically damped g-h-k filter of the hand thesis, section 5.1.2, whose constant gains know no covariance: the
adaptive Kalman filter beside it supplies that. `none` predicts the last pose. A joint without evidence is frozen: it
keeps its last pose, and its sigma grows.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from .ghk import Ghk, GhkState, ghk_predict, ghk_start, ghk_update
from .process_noise import process_from_innovations
from .settings import Settings
from .smooth import KalmanState, predict_frozen, start, update

_FLOOR = np.radians(60.0) ** -2  # information of knowing nothing
_UNSEEN = np.radians(8.0)  # sigma from the image alone beyond which a joint counts as not seen
_DRIFT = np.radians(3.0)  # random walk of a joint that is not seen, for each root of a frame
_ACCELERATION = np.radians(2.0)  # typical change of velocity from frame to frame before any was measured


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Filter state of the independent joints.

    Attributes
    ----------
    motion : KalmanState
        Pose and velocity with covariance: predicted after `predict`, filtered after `correct`.
    psd : (k,)
        Spectral density of each joint's acceleration.
    unseen : (k,)
        Joints that the last frame had no evidence of.
    ghk : GhkState or None
        The constant-gain filter, if it predicts.
    """

    motion: KalmanState
    psd: Float[np.ndarray, " k"]
    unseen: Bool[np.ndarray, " k"]
    ghk: GhkState | None
    settings: Settings
    fps: float
    moved: bool


def first_prediction(u: Float[np.ndarray, " k"], fps: float, settings: Settings) -> Prediction:
    """Before the first frame: the start pose, and velocities that are not known."""
    motion = start(u, np.eye(u.size) * settings.start_sigma**2, sigma_velocity=settings.start_speed * fps)
    psd = np.full(u.size, (_ACCELERATION * fps) ** 2 * fps)
    ghk = ghk_start(u) if settings.filter == "ghk" else None
    return Prediction(motion, psd, np.zeros(u.size, dtype=bool), ghk, settings, fps, False)


def predict(last: Prediction, dt: float) -> Prediction:
    """The prediction dt seconds on; the state itself for dt = 0, at the first frame."""
    if dt <= 0.0:
        return replace(last, moved=False)
    held = np.ones_like(last.unseen) if last.settings.filter == "none" else last.unseen
    drift = _DRIFT if last.settings.filter != "none" else last.settings.start_speed
    motion = predict_frozen(last.motion, dt, last.psd, held, drift * np.sqrt(last.fps))
    ghk = last.ghk
    if ghk is not None:
        ghk = ghk_predict(ghk, dt, Ghk(last.settings.theta, 1.0 / last.fps))
        x = motion.x.copy()
        x[: ghk.q.size] = np.where(last.unseen, motion.q, ghk.q)
        motion = replace(motion, x=x)
    return replace(last, motion=motion, ghk=ghk, moved=True)


def correct(
    ahead: Prediction,
    u: Float[np.ndarray, " k"],
    information: Float[np.ndarray, "k k"],
    mean: Float[np.ndarray, " k"] | None = None,
    prior: Float[np.ndarray, "k k"] | None = None,
) -> Prediction:
    """Take in the pose u that image (`information`) and prior (`mean`, information `prior`) agreed on.

    The filters want the measurement without the prior that is already in u: with `A` the image's and `L` the prior's
    information, `u = (A + L)^-1 (A z + L m)` gives `z = u + A^-1 L (u - m)`. The prediction is the prior unless
    another is named.
    """
    mean = ahead.motion.q if mean is None else mean
    prior = np.linalg.inv(ahead.motion.covariance) if prior is None else prior
    R = np.linalg.inv(information + _FLOOR * np.eye(u.size))
    unseen = np.diag(R) > _UNSEEN**2
    z = u + R @ (prior @ (u - mean))
    motion, innovation, S = update(ahead.motion, z, R)
    psd = ahead.psd
    if ahead.moved:
        psd = process_from_innovations(psd, np.where(unseen, np.nan, innovation), S, R)
    ghk = ahead.ghk
    if ghk is not None:
        ghk = ghk_update(ghk, np.where(unseen, np.nan, u), Ghk(ahead.settings.theta, 1.0 / ahead.fps))
    return replace(ahead, motion=motion, psd=psd, unseen=unseen, ghk=ghk)
