"""A way and gestures in, the joint angles of a walking person out.

Hip, knee and ankle follow the usual curves of level walking over a stride (rounded from Winter 1991, "The Biomechanics
and Motor Control of Human Gait"), the other leg half a stride later. Arms swing against the legs, and the trunk turns
against the pelvis. Where the person stands the swings fade to a quiet posture. A gesture blends one arm to a pose and
back, with `minimum_jerk`. The pelvis is as high as the lower ankle needs to be at its height above the floor.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import CubicSpline

from handtrack.body.posture import JOINTS, LIMITS, PART_JOINTS, Body, segment_frames

from .cell_motion import minimum_jerk, smooth_noise
from .walk_path import Way

STRIDE = 1.35  # metres
# Share of the stride from heel strike, and degrees.
HIP = ((0.0, 0.10, 0.30, 0.50, 0.60, 0.75, 0.87), (30.0, 27.0, 6.0, -10.0, -5.0, 22.0, 33.0))
KNEE = ((0.0, 0.13, 0.40, 0.60, 0.73, 0.90, 0.97), (5.0, 18.0, 5.0, 36.0, 62.0, 16.0, 4.0))
ANKLE = ((0.0, 0.07, 0.20, 0.45, 0.62, 0.73, 0.85), (0.0, -6.0, 3.0, 10.0, -17.0, -6.0, 1.0))
SWING, ELBOW, YAW, LIST = 22.0, 12.0, 4.0, 3.0  # degrees: half ranges of arm, elbow, pelvis in turning and dropping
QUIET = 1.5  # degrees and
QUIET_SECONDS = 1.5  # seconds of what every joint does besides
RISE = 0.8  # seconds that a gesture needs to its pose, and back

# Poses of an arm, degrees: flexion, elevation, rotation, elbow.
# Reach out, hold to the front, raise, aside, to the face, fold.
POSES = np.array(
    [
        [65.0, -85.0, 0.0, 25.0],
        [25.0, -85.0, -10.0, 90.0],
        [140.0, -80.0, 5.0, 20.0],
        [5.0, -15.0, 10.0, 10.0],
        [70.0, -75.0, -25.0, 125.0],
        [40.0, -95.0, -35.0, 70.0],
    ]
)
REST = np.array([0.0, -83.0, -5.0, 18.0])


@dataclass(frozen=True, slots=True, eq=False)
class Gestures:
    """Movements of the arms: begin and end in seconds, the arm (0 left, 1 right), and the pose in `POSES`."""

    begin: Float[np.ndarray, " n"]
    end: Float[np.ndarray, " n"]
    arm: Int[np.ndarray, " n"]
    pose: Int[np.ndarray, " n"]


def stride_curve(
    knots: tuple[tuple[float, ...], tuple[float, ...]], phase: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """Degrees at phases, in strides; periodic.

    >>> stride_curve(HIP, np.array([0.0, 1.0, 2.5])).round(6).tolist()
    [30.0, 30.0, -10.0]
    """
    at, value = (*knots[0], 1.0), (*knots[1], knots[1][0])
    return CubicSpline(at, value, bc_type="periodic")(phase % 1.0)


def gait(phase: Float[np.ndarray, " m"], pace: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 23"]:
    """Yaw, pitch and roll of the pelvis against its heading and the 20 angles, radians, without gestures."""
    out = np.zeros((phase.size, 3 + len(JOINTS)))
    round_ = 2.0 * math.pi * phase
    out[:, 0] = YAW * pace * np.sin(round_)
    out[:, 1] = 3.0 * pace
    out[:, 2] = LIST * pace * np.sin(round_)
    body = out[:, 3:]
    body[:, 0] = -2.0 * out[:, 0]  # the trunk turns as far the other way
    body[:, 1] = 2.0
    body[:, 2] = -0.7 * out[:, 2]
    body[:, 3] = -3.0
    for side, shift, sign in (("left", 0.0, 1.0), ("right", 0.5, -1.0)):
        own = phase + shift
        for name, knots, still in (("hip_flexion", HIP, 2.0), ("knee", KNEE, 4.0), ("ankle", ANKLE, 0.0)):
            body[:, JOINTS.index(f"{side}_{name}")] = still + pace * (stride_curve(knots, own) - still)
        body[:, JOINTS.index(f"{side}_hip_abduction")] = 3.0 - sign * out[:, 2]
        arm = body[:, PART_JOINTS[1 if side == "left" else 2]]
        arm += REST
        arm[:, 0] -= SWING * pace * np.cos(2.0 * math.pi * own)
        arm[:, 3] -= ELBOW * pace * np.cos(2.0 * math.pi * own) - 8.0 * pace
        body[:, PART_JOINTS[1 if side == "left" else 2]] = arm
    return np.radians(out)


def gestures_of(rng: np.random.Generator, way: Way, per_minute: float, standing: Float[np.ndarray, "n 2"]) -> Gestures:
    """Gestures in every stop, one arm after the other, and some while walking.

    Parameters
    ----------
    standing : (n, 2)
        Seconds at which each stop begins and ends.
    """
    begins: list[float] = []
    ends: list[float] = []
    arms: list[int] = []
    for begin, end in standing.tolist():
        at, arm = begin, int(rng.integers(2))
        while at + 2.5 < end:
            begins.append(at)
            ends.append(min(at + rng.uniform(2.5, 4.5), end + RISE))
            arms.append(arm)
            at, arm = at + rng.uniform(1.5, 3.0), 1 - arm
    for at in np.sort(rng.uniform(0.0, way.time[-1], rng.poisson(per_minute * way.time[-1] / 60.0))).tolist():
        begins.append(at)
        ends.append(at + rng.uniform(2.5, 5.0))
        arms.append(int(rng.integers(2)))
    return Gestures(
        np.array(begins), np.array(ends), np.array(arms, dtype=int), rng.integers(len(POSES), size=len(arms))
    )


def with_gestures(
    theta: Float[np.ndarray, "m 20"],
    time: Float[np.ndarray, " m"],
    gestures: Gestures,
    poses: Float[np.ndarray, "p 2 m 4"],
) -> Float[np.ndarray, "m 20"]:
    """Arms drawn to the gestures' poses and back; of two at once the later one wins.

    Parameters
    ----------
    poses : (p, 2, m, 4)
        Angles of each pose for either arm, at every time.
    """
    out = theta.copy()
    for begin, end, arm, pose in zip(gestures.begin, gestures.end, gestures.arm, gestures.pose, strict=True):
        low, high = np.searchsorted(time, (begin, end + RISE))
        at = time[low:high]
        share = minimum_jerk((at - begin) / RISE) * (1.0 - minimum_jerk((at - end) / RISE))
        part = PART_JOINTS[1 + arm]
        out[low:high, part] += share[:, None] * (poses[pose % len(poses), arm, low:high] - out[low:high, part])
    return out


def fixed_poses(count: int) -> Float[np.ndarray, "p 2 m 4"]:
    """`POSES` for both arms at each of `count` times; they are alike, since angles are told from the body's middle."""
    return np.broadcast_to(np.radians(POSES)[:, None, None], (len(POSES), 2, count, 4))


def walking(
    rng: np.random.Generator, body: Body, way: Way, swing: Float[np.ndarray, "m 23"], theta: Float[np.ndarray, "m 20"]
) -> Float[np.ndarray, "m 26"]:
    """Poses in the world of a person who takes the way with these postures.

    Parameters
    ----------
    swing : (m, 23)
        As from `gait`; its first three columns tilt the pelvis.
    theta : (m, 20)
        The postures, gestures included.
    """
    rate = (way.time.size - 1) / way.time[-1]
    quiet = math.radians(QUIET) * smooth_noise(rng, way.time.size, QUIET_SECONDS * rate, len(JOINTS))
    theta = np.clip(theta + quiet, *LIMITS.T)
    q = np.zeros((way.time.size, 6 + len(JOINTS)))
    q[:, :2], q[:, 3], q[:, 6:] = way.xy, way.heading, theta
    q[:, 3:6] += swing[:, :3]
    low = segment_frames(body, q)[:, [9, 12], 2, 3].min(axis=1)
    q[:, 2] = body.sizes.ankle - low
    return q


def standing_times(way: Way) -> Float[np.ndarray, "n 2"]:
    """Seconds at which the person comes to stand, and walks on."""
    still: Bool[np.ndarray, " m"] = np.concatenate([[False], way.pace < 0.05, [False]])
    edges = np.flatnonzero(np.diff(still.astype(int)))
    return np.column_stack([way.time[np.minimum(edges[part::2], way.time.size - 1)] for part in (0, 1)])
