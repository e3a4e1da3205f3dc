"""A walk in; what a filter is told at each moment, one after another, out; and what it answers.

Suit and camera have times of their own. A moment is a frame of the suit, or of the camera, or both where their times
agree. Between two samples of the suit the segments are interpolated, so a frame of the camera waits for the next one.
Where samples are missing for longer, the pelvis goes on as it last moved, for a while, and the camera is not
used: nobody knows the posture that it saw.

A filter is a module with

    begin(body, settings) -> State                          a frozen dataclass of arrays
    step(state, moment, rng) -> (State, Estimate)           pure

and all its random numbers come from `rng`. What undoes the drift is `p_world = Rot_z(h) p_suit + t`.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from ..camera import Camera
from ..errors import InputError
from ..formats.walks import Walk
from .posture import Body, pose_from_segments
from .walk_settings import Settings

SAME = 1e-6  # seconds by which times of suit and camera may differ and still agree
EDGE = 0.02  # seconds before the suit's first sample, or after its last, in which nobody moves much
CARRY_ON = 0.3  # seconds for which a suit without samples is thought to go on at its speed
LEAST_SURE = 0.4  # confidence to which `Settings.least_sure` belongs
SPEED_OVER = 0.4  # seconds over which the speed is taken


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """What is known at one time.

    Attributes
    ----------
    time, dt : float
        Seconds; and those since the moment before, 0 for the first.
    frame : int
        Row of the suit's frame whose estimate is wanted, -1 for none.
    since : float
        Seconds since the suit's last sample where its samples are missing: the segments are a guess; 0 if they are not.
    q : (26,)
        Pelvis and joint angles that follow the suit's segments, in the suit's frame.
    p : (13, 3)
        Origins of the segments in the suit's frame.
    R : (13, 3, 3)
        Their orientations, suit_R_segment.
    speed : float
        Of the pelvis over the floor, m/s.
    seen : bool
        Whether this is a frame of the camera.
    uv, confidence : (16, 2), (16,)
        Keypoints in pixels, NaN and 0 where unseen; all of them if this is no frame of the camera.
    in_view : bool
        Whether enough keypoints are seen.
    camera_dt : float
        Seconds since the camera's frame before, infinite for the first.
    camera : Camera
    """

    time: float
    dt: float
    frame: int
    since: float
    q: Float[np.ndarray, " 26"]
    p: Float[np.ndarray, "13 3"]
    R: Float[np.ndarray, "13 3 3"]
    speed: float
    seen: bool
    uv: Float[np.ndarray, "16 2"]
    confidence: Float[np.ndarray, " 16"]
    in_view: bool
    camera_dt: float
    camera: Camera


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What a filter says of a moment; world frame, metres and radians.

    Attributes
    ----------
    q, sigma_posture : (26,), (20,)
        Pelvis and posture, and the standard deviations of the posture's angles.
    covariance : (4, 4)
        Of the pelvis's x, y, z and of its heading.
    keypoints : (16, 3)
    status : str
        One of `formats.walk_tracks.STATUSES`.
    """

    q: Float[np.ndarray, " 26"]
    sigma_posture: Float[np.ndarray, " 20"]
    covariance: Float[np.ndarray, "4 4"]
    keypoints: Float[np.ndarray, "16 3"]
    status: str


def keypoint_sigma(confidence: Float[np.ndarray, "*n"], settings: Settings) -> Float[np.ndarray, "*n"]:
    """Standard deviation of keypoints in pixels, from their confidences; infinite for 0.

    Linear from 1 to 0.4, and in inverse proportion below: who is half as sure is wrong by twice as much.

    >>> keypoint_sigma(np.array([1.0, 0.7, 0.4, 0.2]), Settings()).round(6).tolist()
    [4.0, 6.0, 8.0, 16.0]
    """
    share = np.clip((1.0 - confidence) / (1.0 - LEAST_SURE), 0.0, 1.0)
    below = LEAST_SURE / np.maximum(np.minimum(confidence, LEAST_SURE), 1e-9)
    sigma = (settings.surest + share * (settings.least_sure - settings.surest)) * below
    return np.where(confidence > 0.0, sigma, np.inf)


def lasting_factor(moment: Moment, settings: Settings) -> float:
    """By how much the variance of a camera frame's keypoints counts more, since half of it lasts to the next frame.

    A share a = exp(-dt / lasting) of that half stays; the mean of many such values has (1 + a) / (1 - a) times the
    variance that it would have if they were independent.
    """
    if settings.lasting <= 0.0 or not np.isfinite(moment.camera_dt):
        return 1.0
    kept = np.exp(-max(moment.camera_dt, 1e-3) / settings.lasting)
    return float(0.5 + 0.5 * (1.0 + kept) / (1.0 - kept))


def moments(walk: Walk, body: Body, settings: Settings) -> list[Moment]:
    """All moments of a walk, in the order of time; each frame of the suit is one of them.

    Raises
    ------
    InputError
        If no frame of the suit has the pelvis.
    """
    known = np.asarray(np.isfinite(np.concatenate([walk.p, walk.wxyz], axis=-1)).all(axis=-1))
    if not known[:, 0].any():
        raise InputError(f"{walk.path.parent / 'segments.csv'}: the pelvis has no sample; at least one is wanted")
    time, frame, shot = _times(walk)
    hold = max(settings.longest_hold, 1.5 / walk.fps)
    since = _since(walk.time[known[:, 0]], time, hold)
    p, R = _segments(walk, body, known, time, hold)
    pelvis = p[:, 0] + np.minimum(since, CARRY_ON)[:, None] * _velocity(walk, known[:, 0], time - since)
    p = p + (pelvis - p[:, 0])[:, None]
    wxyz = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(scalar_first=True).reshape(-1, 13, 4)
    q = pose_from_segments(body, p, wxyz)
    speed = np.linalg.norm(_velocity(walk, known[:, 0], time)[:, :2], axis=1)
    seen = (shot >= 0) & (since == 0.0)
    uv, confidence = np.full((time.size, 16, 2), np.nan), np.zeros((time.size, 16))
    uv[seen], confidence[seen] = walk.uv[shot[seen]], walk.confidence[shot[seen]]
    dt = np.diff(time, prepend=time[0])
    before = np.full(time.size, np.inf)
    at = np.flatnonzero(seen)
    before[at[1:]] = np.diff(time[at])
    return [
        Moment(
            time=float(time[i]),
            dt=float(dt[i]),
            frame=int(frame[i]),
            since=float(since[i]),
            q=q[i],
            p=p[i],
            R=R[i],
            speed=float(speed[i]),
            seen=bool(seen[i]),
            uv=uv[i],
            confidence=confidence[i],
            in_view=bool(np.count_nonzero(confidence[i] > 0) >= settings.fewest),
            camera_dt=float(before[i]),
            camera=walk.camera,
        )
        for i in range(time.size)
    ]


def _times(walk: Walk) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Times of all moments, and the rows of the suit's and of the camera's frames there, -1 for none."""
    after = np.searchsorted(walk.time, walk.camera_time).clip(1, max(walk.time.size - 1, 1))
    after = after.clip(max=walk.time.size - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(
        np.abs(walk.time[after] - walk.camera_time) < np.abs(walk.time[before] - walk.camera_time), after, before
    )
    same = np.abs(walk.time[nearest] - walk.camera_time) <= SAME
    alone = np.flatnonzero(~same)
    shots = np.full(walk.time.size, -1)
    shots[nearest[same]] = np.flatnonzero(same)
    time = np.concatenate([walk.time, walk.camera_time[alone]])
    order = np.argsort(time, kind="stable")
    frame = np.concatenate([np.arange(walk.time.size), np.full(alone.size, -1)])
    return time[order], frame[order], np.concatenate([shots, alone])[order]


def _bracket(
    given: Float[np.ndarray, " n"], time: Float[np.ndarray, " m"], hold: float
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"], Float[np.ndarray, " m"], Bool[np.ndarray, " m"]]:
    """Samples before and after each time, the share of the way between them, and whether they are near enough."""
    after = np.searchsorted(given, time).clip(0, given.size - 1)
    before = np.where(given[after] <= time, after, np.maximum(after - 1, 0))
    gap = given[after] - given[before]
    near = np.where(gap > 0, gap <= hold, np.abs(time - given[before]) <= EDGE)
    share = np.where(near & (gap > 0), (time - given[before]) / np.maximum(gap, SAME), 0.0)
    return before, after, np.clip(share, 0.0, 1.0), near


def _since(given: Float[np.ndarray, " n"], time: Float[np.ndarray, " m"], hold: float) -> Float[np.ndarray, " m"]:
    """Seconds since the last sample (or until the first) where the suit is silent, else 0."""
    before, _, _, near = _bracket(given, time, hold)
    return np.where(near, 0.0, np.abs(time - given[before]))


def _segments(
    walk: Walk, body: Body, known: Bool[np.ndarray, "f 13"], time: Float[np.ndarray, " m"], hold: float
) -> tuple[Float[np.ndarray, "m 13 3"], Float[np.ndarray, "m 13 3 3"]]:
    """Origins and orientations of the segments at given times; one that has no sample at all goes with its parent."""
    p, R = np.empty((time.size, 13, 3)), np.empty((time.size, 13, 3, 3))
    for i in range(13):
        if not known[:, i].any():
            above = int(body.whole.parent[i])
            R[:, i] = R[:, above]
            p[:, i] = p[:, above] + R[:, above] @ body.whole.offset[i]
            continue
        before, after, share, _ = _bracket(walk.time[known[:, i]], time, hold)
        x, wxyz = walk.p[known[:, i], i], walk.wxyz[known[:, i], i]
        p[:, i] = x[before] + share[:, None] * (x[after] - x[before])
        first, last = (Rotation.from_quat(wxyz[at], scalar_first=True) for at in (before, after))
        way = (first.inv() * last).as_rotvec()
        R[:, i] = (first * Rotation.from_rotvec(share[:, None] * way)).as_matrix()
    return p, R


def _velocity(walk: Walk, known: Bool[np.ndarray, " f"], time: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 3"]:
    """Of the pelvis over the last moments before each time, as the suit says it."""
    given, x = walk.time[known], walk.p[known, 0]
    back = np.maximum(time - SPEED_OVER, given[0])
    now = np.maximum(time, given[0])
    step = [np.interp(now, given, column) - np.interp(back, given, column) for column in x.T]
    return np.column_stack(step) / np.maximum(now - back, 0.25 * SPEED_OVER)[:, None]
