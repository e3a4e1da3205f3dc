"""Moments of a walk in, what the suit alone and the camera alone say out: what the filters are measured against.

* `suit`: the suit as it is, with its drift (the paper's XS-IMU);
* `camera`: each frame on its own, as a pose from points: the keypoints of the suit's posture, and their pixels
  (perspective-n-point by OpenCV, RANSAC and refinement). Between such frames the last place stands.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from .posture import ROOT, Body, keypoints, pelvis_numbers
from .walk_moment import Estimate, Moment
from .walk_settings import Settings

REACH = 15.0  # pixels within which a keypoint agrees with a pose
TRIALS = 100
FARTHEST = 100.0  # metres from the camera at which nobody's keypoints can be told apart
FEWEST = 6  # keypoints that a pose needs: four fix it, the others say whether it is right
SUIT_SIGMA = (0.3, 10.0)  # metres and degrees, of a suit that nobody corrects
CAMERA_SIGMA = (0.15, 8.0)  # of a pose from one frame; and what each second without one adds:
ASTRAY = (0.8, 40.0)
RECENT = 1.5  # frames of the camera


def place_from_points(
    moment: Moment, points: Float[np.ndarray, "16 3"]
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]] | None:
    """World pose of a frame from keypoints known in it and seen in the image; None if too few agree.

    Parameters
    ----------
    points : (16, 3)
        Keypoints in some frame of the body or the suit, metres.

    Returns
    -------
    place, turn : (3,), (3, 3)
        Of that frame in the world: `p_world = turn points + place`.
    """
    seen = moment.confidence > 0
    if np.count_nonzero(seen) < FEWEST:
        return None
    camera = moment.camera
    K = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    object_points, image_points = np.ascontiguousarray(points[seen]), np.ascontiguousarray(moment.uv[seen])
    cv2.setRNGSeed(1)  # the same frame gives the same pose
    try:
        good, rvec, tvec, inliers = cv2.solvePnPRansac(
            object_points, image_points, K, camera.distortion,
            iterationsCount=TRIALS, reprojectionError=REACH, flags=cv2.SOLVEPNP_EPNP,
        )  # fmt: skip
        if not good or inliers is None or inliers.size < FEWEST:
            return None
        at = np.asarray(inliers, dtype=np.intp).reshape(-1)
        rvec, tvec = cv2.solvePnPRefineLM(object_points[at], image_points[at], K, camera.distortion, rvec, tvec)
    except cv2.error:  # points in one line, or none that agree
        return None
    turn = camera.R.T @ Rotation.from_rotvec(np.ravel(rvec)).as_matrix()
    place = camera.R.T @ (np.ravel(tvec) - camera.t)
    ahead = float((camera.R @ (turn @ points.mean(axis=0) + place) + camera.t)[2])
    sensible = np.isfinite(place).all() and np.isfinite(turn).all() and 0.0 < ahead < FARTHEST
    return (place, turn) if sensible else None


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What is kept from moment to moment.

    Attributes
    ----------
    body, settings : Body, Settings
    pelvis : (6,)
        Last place and turn (yaw, pitch, roll) from the camera; NaN before the first.
    found, period : float
        Seconds at which that was, and between the camera's frames.
    """

    body: Body
    settings: Settings
    pelvis: Float[np.ndarray, " 6"]
    found: float = -np.inf
    period: float = 0.0


def begin(body: Body, settings: Settings) -> State:
    """The state before the first moment."""
    return State(body, settings, np.full(ROOT, np.nan))


def step(state: State, moment: Moment, rng: np.random.Generator) -> tuple[State, Estimate]:
    """Go on to a moment with the method of the settings, `suit` or `camera`; `rng` stays untouched."""
    return _suit(state, moment) if state.settings.method == "suit" else _camera(state, moment)


def _suit(state: State, moment: Moment) -> tuple[State, Estimate]:
    return state, _estimate(state, moment.q, SUIT_SIGMA, "predicted")


def _camera(state: State, moment: Moment) -> tuple[State, Estimate]:
    if moment.seen and np.isfinite(moment.camera_dt):
        state = replace(state, period=moment.camera_dt)
    if moment.in_view:
        still = moment.q.copy()
        still[:ROOT] = 0.0
        found = place_from_points(moment, keypoints(state.body, still[None])[0])
        if found is not None:
            place, turn = found
            pelvis = pelvis_numbers(place[None], Rotation.from_matrix(turn[None]))[0]
            state = replace(state, pelvis=pelvis, found=moment.time)
    q = moment.q.copy()
    if np.isnan(state.pelvis).any():
        return state, _estimate(state, q, (ASTRAY[0] * 5, ASTRAY[1] * 2), "lost")
    q[:ROOT] = state.pelvis
    age = moment.time - state.found
    recent = age <= RECENT * state.period or age == 0.0
    sigma = (CAMERA_SIGMA[0] + ASTRAY[0] * age, min(CAMERA_SIGMA[1] + ASTRAY[1] * age, 104.0))
    return state, _estimate(state, q, sigma, "tracked" if recent else "uncertain")


def _estimate(state: State, q: Float[np.ndarray, " 26"], sigma: tuple[float, float], status: str) -> Estimate:
    told = state.settings
    spread = np.radians(np.hypot(told.calibration, told.orientation_noise)) * np.sqrt(2.0)
    return Estimate(
        q=q,
        sigma_posture=np.full(q.size - ROOT, spread),
        covariance=np.diag([sigma[0] ** 2] * 3 + [np.radians(sigma[1]) ** 2]),
        keypoints=keypoints(state.body, q[None])[0],
        status=status,
    )
