"""A BVH file of a person in, the postures of its frames out, and from them a stride or the movements of arms.

Only the places of the joints are used: their own axes differ from one system to the next. Pelvis and trunk have z along
the line from the hips' middle to the shoulders' and y along hips and shoulders; a limb's segment points to its next
joint, and turns about itself so that the joint after it bends in the plane of its hinge.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from handtrack.body.posture import PART_JOINTS, Body, pose_from_segments
from handtrack.errors import InputError
from handtrack.formats.bvh import Bvh, joint_frames, read_bvh

# Names of the joints that different systems give; of several in one file the first counts.
_NAMES = (
    ("hip", ("UpLeg", "Hip", "Thigh")), ("knee", ("Leg", "Knee", "Shin")), ("ankle", ("Foot", "Ankle")),
    ("toe", ("ToeBase", "Toe", "ForeFoot", "Foot_end", "Ankle_end")), ("shoulder", ("Arm", "Shoulder", "UpperArm")),
    ("elbow", ("ForeArm", "Elbow")), ("wrist", ("Hand", "Wrist")),
)  # fmt: skip
_BENT = 4.0  # weight of a bend's plane against the axes of the segment before, for a right angle
WALKS = 0.7  # metres that the hips travel, for a height of 1.75 m, in a file that counts as walking


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """Postures of a recorded person.

    Attributes
    ----------
    seconds : float
        Between frames.
    tilt : (k, 3)
        Yaw, pitch and roll of the pelvis; the yaw less its slow part, radians.
    theta : (k, 20)
        Posture.
    reach : (k,)
        By how much the left ankle is before the right one, as a share of the leg's length.
    travel : float
        Way of the hips, as a share of the leg's length.
    """

    seconds: float
    tilt: Float[np.ndarray, "k 3"]
    theta: Float[np.ndarray, "k 20"]
    reach: Float[np.ndarray, " k"]
    travel: float


def read_motion(path: Path | str, body: Body) -> Recorded:
    """Read a BVH file of a person.

    Raises
    ------
    InputError
        If the file is malformed, has fewer than ten frames, or lacks one of the joints of arms, legs and head.
    """
    bvh = read_bvh(path)
    if bvh.motion.shape[0] < 10:
        raise InputError(f"{path}: has {bvh.motion.shape[0]} frames; at least 10 are wanted")
    places = joint_frames(bvh)[1]
    left, right = (
        np.stack([places[:, _joint(bvh, path, side, name)] for name, _ in _NAMES], axis=1) for side in ("Left", "Right")
    )
    head, neck = (places[:, _named(bvh, path, (name,))] for name in ("Head", "Neck"))
    up = _up(0.5 * (left[:, 2] + right[:, 2]), head)
    left, right, head, neck = (points @ up.T for points in (left, right, head, neck))
    wxyz = _segments(left, right, head, neck)
    q = pose_from_segments(body, np.zeros((wxyz.shape[0], 13, 3)), wxyz)
    leg = float(np.linalg.norm(np.diff(left[:, :3], axis=1), axis=-1).sum(axis=1).mean())
    heading = np.unwrap(q[:, 3])
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    middle = 0.5 * (left[:, 0, :2] + right[:, 0, :2])
    return Recorded(
        seconds=bvh.seconds,
        tilt=np.column_stack([heading - _slow(heading), q[:, 4:6]]),
        theta=q[:, 6:],
        reach=((left[:, 2, :2] - right[:, 2, :2]) * ahead).sum(axis=-1) / leg,
        travel=float(np.linalg.norm(middle[-1] - middle[0])) / leg,
    )


def _named(bvh: Bvh, path: Path | str, names: tuple[str, ...]) -> int:
    for name in names:
        if name in bvh.names:
            return bvh.names.index(name)
    raise InputError(f"{path}: no joint is called {' or '.join(names)}; one is wanted")


def _joint(bvh: Bvh, path: Path | str, side: str, joint: str) -> int:
    return _named(bvh, path, tuple(f"{side}{name}" for name in dict(_NAMES)[joint]))


def _up(feet: Float[np.ndarray, "k 3"], head: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "3 3"]:
    """Turns the file's axes, y or z up, so that z is up."""
    mean = (head - feet).mean(axis=0)
    if np.abs(mean).argmax() == 1:
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    return np.eye(3)


def _slow(heading: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """A straight line through the heading: nobody turns evenly, but a stride is short."""
    at = np.arange(heading.size)
    return np.polyval(np.polyfit(at, heading, 1), at)


def _unit(v: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def _axes(main: Float[np.ndarray, "k 3"], other: Float[np.ndarray, "k 3"], order: str) -> Float[np.ndarray, "k 3 3"]:
    """Frames with axis `order[0]` along `main`, and `order[1]` as near as may be to `other`."""
    first = _unit(main)
    second = _unit(other - (other * first).sum(axis=-1, keepdims=True) * first)
    i, j = "xyz".index(order[0]), "xyz".index(order[1])
    out = np.empty((*main.shape, 3))
    out[..., i], out[..., j] = first, second
    third = np.cross(first, second)
    out[..., 3 - i - j] = third if (j - i) % 3 == 1 else -third
    return out


def _segments(
    left: Float[np.ndarray, "k 7 3"],
    right: Float[np.ndarray, "k 7 3"],
    head: Float[np.ndarray, "k 3"],
    neck: Float[np.ndarray, "k 3"],
) -> Float[np.ndarray, "k 13 4"]:
    """Quaternions of `SEGMENTS` from hip, knee, ankle, toe, shoulder, elbow and wrist of both sides."""
    up = 0.5 * (left[:, 4] + right[:, 4] - left[:, 0] - right[:, 0])
    R = np.empty((left.shape[0], 13, 3, 3))
    R[:, 0] = _axes(up, left[:, 0] - right[:, 0], "zy")
    R[:, 1] = _axes(up, left[:, 4] - right[:, 4], "zy")
    R[:, 2] = _axes(head - neck, R[:, 1, :, 1], "zy")
    for side, p, arm, leg in ((1.0, left, 3, 7), (-1.0, right, 5, 10)):
        upper, fore = _unit(p[:, 5] - p[:, 4]), _unit(p[:, 6] - p[:, 5])
        bent = _BENT * (fore - (fore * upper).sum(axis=-1, keepdims=True) * upper)
        forward = _axes(side * upper, R[:, 1, :, 0], "yx")[..., 0]
        R[:, arm] = _axes(side * upper, bent + forward, "yx")
        R[:, arm + 1] = _axes(side * fore, R[:, arm, :, 0], "yx")
        thigh, shank = _unit(p[:, 1] - p[:, 0]), _unit(p[:, 2] - p[:, 1])
        back = _BENT * (shank - (shank * thigh).sum(axis=-1, keepdims=True) * thigh)
        forward = _axes(-thigh, R[:, 0, :, 0], "zx")[..., 0]
        R[:, leg] = _axes(-thigh, forward - back, "zx")
        R[:, leg + 1] = _axes(-shank, R[:, leg, :, 0], "zx")
        R[:, leg + 2] = _axes(p[:, 3] - p[:, 2], R[:, leg + 1, :, 2], "xz")
        # a foot's joint lies above its sole: level on average is flat on the floor
        level = R[:, leg + 2, 2, 0].mean()
        R[:, leg + 2] = R[:, leg + 2] @ Rotation.from_euler("y", float(np.arcsin(level))).as_matrix()
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(scalar_first=True).reshape(-1, 13, 4)


def stride_of(recorded: Recorded, leg: float) -> Float[np.ndarray, "k 23"] | None:
    """Tilt of the pelvis and posture over one stride that closes in itself; None where the person does not walk.

    A stride goes from one greatest reach of the left foot to the next. What is left between its ends is spread evenly.

    Parameters
    ----------
    leg : float
        Metres.
    """
    if recorded.travel * leg < WALKS:
        return None
    reach = recorded.reach
    peaks = (
        np.flatnonzero((reach[1:-1] >= reach[:-2]) & (reach[1:-1] > reach[2:]) & (reach[1:-1] > 0.6 * reach.max())) + 1
    )
    peaks = peaks[np.concatenate([[True], np.diff(peaks) * recorded.seconds > 0.5])] if peaks.size else peaks
    if peaks.size < 2:
        return None
    both = np.column_stack([recorded.tilt, recorded.theta])[peaks[0] : peaks[1] + 1]
    share = np.linspace(0.0, 1.0, both.shape[0])[:, None]
    return both - (share - 0.5) * (both[-1] - both[0])


def looped(cycle: Float[np.ndarray, "k d"], phase: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m d"]:
    """Values of a closed cycle, its last row equal to its first, at phases in cycles.

    >>> looped(np.array([[0.0], [1.0], [0.0]]), np.array([0.25, 1.5])).tolist()
    [[0.5], [1.0]]
    """
    at = np.linspace(0.0, 1.0, cycle.shape[0])
    return np.column_stack([np.interp(phase % 1.0, at, column) for column in cycle.T])


def recorded_poses(recorded: Recorded, time: Float[np.ndarray, " m"]) -> Float[np.ndarray, "1 2 m 4"]:
    """Both arms of the recording, played forth and back, at times; one "pose" for `walk_gait.with_gestures`."""
    arms = recorded.theta[:, np.concatenate([PART_JOINTS[1], PART_JOINTS[2]])]
    there_and_back = np.concatenate([arms, arms[-2::-1]])
    played = looped(there_and_back, time / (recorded.seconds * (there_and_back.shape[0] - 1)))
    return np.stack([played[:, :4], played[:, 4:]])[None]
