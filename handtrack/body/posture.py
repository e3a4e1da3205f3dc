"""A body of 13 segments and 20 joints, and joint values in; segment frames and keypoints of a batch out; and back.

State of the walk paper, section III-A: the pose of the pelvis, six numbers here (x, y, z in metres; yaw, pitch, roll
with `R = Rot_z(yaw) Rot_y(pitch) Rot_x(roll)`), and the posture, 20 angles in the order of `JOINTS`. A change of
heading adds to the yaw. Segments, joints and limits are told in `posture_tree`, lengths in `anthropometry`.

`segment_frames` is eq. (2.2) of the hand thesis for all particles in one call: each segment sits on its parent by a
shift and by turns about coordinate axes. The same tree stands in `Body.model` as rows of Denavit and Hartenberg, for
Jacobians, files and viewers.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from .. import _kernels
from ..formats.skeletons import KEYPOINTS
from ..formats.walks import SEGMENTS
from ..kinematics.tree import Model
from .anthropometry import Sizes, radii_of, sizes_of
from .posture_tree import (
    JOINTS,
    LIMITS,
    PARTS,
    ROOT_JOINTS,
    Chain,
    body_model,
    ends_of,
    part_chain,
    whole_chain,
)

ROOT = len(ROOT_JOINTS)  # joint values before the posture's
PART_JOINTS = np.array([[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11], [12, 13, 14, 15], [16, 17, 18, 19]])  # of each part
HINGE = 12.0  # weight of a forearm bent by 90 degrees against the upper arm's own turn about itself


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A person's body.

    Attributes
    ----------
    height : float
        Metres.
    sizes : Sizes
        Distances between joints.
    model : Model
        The body as a tree of frames with pills; its joints are `ROOT_JOINTS` and `JOINTS`.
    frame : (13,)
        Index in the model of the frame that has each segment's axes.
    whole, parts : Chain, tuple of five Chain
        All segments, and those of each of `PARTS` alone.
    end : (13, 3)
        Far end of each segment in its own axes, metres.
    keypoint_segment, keypoint_local : (16,), (16, 3)
        Where each of `formats.skeletons.KEYPOINTS` sits.
    limits : (20, 2)
        Of `JOINTS`, radians.
    """

    height: float
    sizes: Sizes
    model: Model
    frame: Int[np.ndarray, " 13"]
    whole: Chain
    parts: tuple[Chain, ...]
    end: Float[np.ndarray, "13 3"]
    keypoint_segment: Int[np.ndarray, " 16"]
    keypoint_local: Float[np.ndarray, "16 3"]
    limits: Float[np.ndarray, "20 2"]


def body_of(height: float, sizes: Sizes | None = None) -> Body:
    """The body of a person.

    Parameters
    ----------
    height : float
        Stature, metres, 0.5 to 2.5.
    sizes : Sizes, optional
        Measured lengths; `sizes_of(height)` if not given, and `dataclasses.replace` of that where some are known.

    Raises
    ------
    ValueError
        If the height is outside of its range.

    >>> body = body_of(1.8)
    >>> len(SEGMENTS), len(JOINTS), len(body.model.joint_names)
    (13, 20, 26)
    """
    average = sizes_of(height)
    sizes = average if sizes is None else sizes
    whole = whole_chain(sizes)
    model = body_model("body", whole, ends_of(sizes), radii_of(height))
    segment, local = _keypoint_places(sizes)
    return Body(
        height=float(height),
        sizes=sizes,
        model=model,
        frame=np.flatnonzero(model.frame_ids % 100 == 0),
        whole=whole,
        parts=tuple(part_chain(whole, part) for part in range(len(PARTS))),
        end=ends_of(sizes),
        keypoint_segment=segment,
        keypoint_local=local,
        limits=LIMITS.copy(),
    )


def _keypoint_places(sizes: Sizes) -> tuple[Int[np.ndarray, " 16"], Float[np.ndarray, "16 3"]]:
    """Segment of each keypoint, and its place in that segment's axes."""
    segment, local = np.zeros(len(KEYPOINTS), dtype=int), np.zeros((len(KEYPOINTS), 3))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for joint, of in (("shoulder", "upper_arm"), ("elbow", "forearm"), ("wrist", "forearm"), ("hip", "thigh")):
            segment[KEYPOINTS.index(f"{side}_{joint}")] = SEGMENTS.index(f"{side}_{of}")
        local[KEYPOINTS.index(f"{side}_wrist"), 1] = sign * sizes.forearm
        for joint, of in (("knee", "shank"), ("ankle", "foot")):
            segment[KEYPOINTS.index(f"{side}_{joint}")] = SEGMENTS.index(f"{side}_{of}")
    middle, head, root = (KEYPOINTS.index(name) for name in ("mid_shoulder", "head", "root"))
    local[root, 2] = 0.5 * sizes.lumbar
    segment[middle], local[middle, 2] = SEGMENTS.index("trunk"), sizes.trunk
    segment[head], local[head, 2] = SEGMENTS.index("head"), sizes.head
    return segment, local


def segment_frames(body: Body, q: Float[np.ndarray, "n 26"]) -> Float[np.ndarray, "n 13 4 4"]:
    """`world_T_segment` of all segments, in the order of `SEGMENTS`, for a batch of poses.

    Parameters
    ----------
    q : (n, 26)
        Pelvis (x, y, z, yaw, pitch, roll) and posture: metres and radians.

    Raises
    ------
    ValueError
        If `q` has not 26 columns.

    >>> segment_frames(body_of(1.8), np.zeros((2, 26)))[1, 3, :3, 3].round(3).tolist()
    [0.0, 0.211, 0.518]
    """
    return chain_frames(body.whole, q)


def part_frames(body: Body, part: int, theta: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n s 4 4"]:
    """Frames of one part's segments, `root_T_segment`, for a batch of its four angles.

    The root has its origin in the part's first joint and the axes of the segment that carries it: the pelvis for trunk
    and legs, the trunk for arms (walk paper, section III-C: "relative to the root of the part").

    Parameters
    ----------
    part : int
        Number in `PARTS`; its segments are `posture_tree.PART_SEGMENTS[part]`, its angles `PART_JOINTS[part]`.

    >>> part_frames(body_of(1.8), 1, np.zeros((1, 4)))[0, 1, :3, 3].round(3).tolist()
    [0.0, 0.335, 0.0]
    """
    return chain_frames(body.parts[part], theta)


def chain_frames(chain: Chain, q: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n s 4 4"]:
    """Frames of a chain's segments in its base's axes."""
    if q.shape[1] != chain.axis.size:
        raise ValueError(f"q: has {q.shape[1]} columns; wanted {chain.axis.size}, one for each joint")
    out = np.empty((q.shape[0], chain.parent.size, 4, 4))
    _kernels.chain_frames(
        chain.parent, chain.offset, chain.first, chain.axis, chain.sign, np.ascontiguousarray(q, dtype=float), out
    )
    return out


def chain_frames_numpy(chain: Chain, q: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n s 4 4"]:
    """The same as `chain_frames` in plain NumPy: the twin that the compiled kernel is tested against."""
    out = np.empty((q.shape[0], chain.parent.size, 4, 4))
    for i, above in enumerate(chain.parent):
        shift = np.eye(4)
        shift[:3, 3] = chain.offset[i]
        frame = np.broadcast_to(shift, (q.shape[0], 4, 4)) if above < 0 else out[:, above] @ shift
        for j in range(chain.first[i], chain.first[i + 1]):
            value = chain.sign[j] * q[:, j]
            motion = np.zeros((q.shape[0], 4, 4))
            motion[:, range(4), range(4)] = 1.0
            if chain.axis[j] >= 3:
                motion[:, chain.axis[j] - 3, 3] = value
            else:
                motion[:, :3, :3] = Rotation.from_rotvec(value[:, None] * np.eye(3)[chain.axis[j]]).as_matrix()
            frame = frame @ motion
        out[:, i] = frame
    return out


def points_on(
    frames: Float[np.ndarray, "n s 4 4"], segment: Int[np.ndarray, " m"], local: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n m 3"]:
    """Points that are fixed to segments, for every pose of a batch.

    Parameters
    ----------
    segment, local : (m,), (m, 3)
        Segment of each point, and its place in that segment's axes.
    """
    out = np.empty((frames.shape[0], segment.size, 3))
    _kernels.points_on(np.ascontiguousarray(frames), segment, local, out)
    return out


def points_on_numpy(
    frames: Float[np.ndarray, "n s 4 4"], segment: Int[np.ndarray, " m"], local: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n m 3"]:
    """The same in plain NumPy."""
    of = frames[:, segment]
    return (of[..., :3, :3] @ local[:, :, None])[..., 0] + of[..., :3, 3]


def keypoints(body: Body, q: Float[np.ndarray, "n 26"]) -> Float[np.ndarray, "n 16 3"]:
    """World places of all `formats.skeletons.KEYPOINTS`, in their order, for a batch of poses; metres.

    >>> keypoints(body_of(1.8), np.zeros((1, 26)))[0, KEYPOINTS.index("left_wrist")].round(3).tolist()
    [0.0, 0.808, 0.518]
    """
    return points_on(segment_frames(body, q), body.keypoint_segment, body.keypoint_local)


def pelvis_numbers(position: Float[np.ndarray, "n 3"], turn: Rotation) -> Float[np.ndarray, "n 6"]:
    """x, y, z, yaw, pitch and roll of pelvises from their places and `turn`, world_R_pelvis; yaw in (-pi, pi].

    >>> pelvis_numbers(np.zeros((1, 3)), Rotation.from_euler("z", [90.0], degrees=True)).round(3).tolist()
    [[0.0, 0.0, 0.0, 1.571, 0.0, 0.0]]
    """
    return np.concatenate([position, turn.as_euler("ZYX").reshape(-1, 3)], axis=1)


def heading_first(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " 3"]:
    """Yaw, pitch and roll of one rotation, as `pelvis_numbers` has them; a tenth of the time that a `Rotation` takes.

    >>> heading_first(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])).round(3).tolist()[0]
    1.571
    """
    level = math.hypot(R[0, 0], R[1, 0])
    return np.array(
        [math.atan2(R[1, 0], R[0, 0]), math.atan2(-R[2, 0], level), math.atan2(R[2, 1], R[2, 2])], dtype=float
    )


def pelvis_turn(q: Float[np.ndarray, "n j"]) -> Rotation:
    """world_R_pelvis of poses, from their first six numbers."""
    return Rotation.from_euler("ZYX", q[:, 3:ROOT])


def pose_from_segments(
    body: Body, positions: Float[np.ndarray, "n 13 3"], wxyz: Float[np.ndarray, "n 13 4"]
) -> Float[np.ndarray, "n 26"]:
    """Joint values that follow the segments of a suit, kept inside the limits.

    The pelvis is taken as it is. Every segment after it is fitted in the axes of the one before: the trunk exactly, the
    head's nod in the least squares of its axes, limbs by the directions that they point to. A turn of the upper arm
    about itself follows the forearm where the elbow is bent, since that shows it best, and the upper arm where not.
    What the joints cannot do is left out: the suit's own skeleton has more of them.

    Parameters
    ----------
    positions : (n, 13, 3)
        Origins, metres; only the pelvis's is used, for the lengths are the body's own.
    wxyz : (n, 13, 4)
        world_R_segment as quaternions, real part first.

    >>> body, q = body_of(1.8), np.radians(np.arange(26.0)[None] / 2)
    >>> T = segment_frames(body, q)
    >>> wxyz = Rotation.from_matrix(T[0, :, :3, :3]).as_quat(scalar_first=True)[None]
    >>> bool(np.allclose(pose_from_segments(body, T[..., :3, 3], wxyz), q))
    True
    """
    n = positions.shape[0]
    R = Rotation.from_quat(wxyz.reshape(-1, 4), scalar_first=True).as_matrix().reshape(n, len(SEGMENTS), 3, 3)
    theta = np.zeros((n, len(JOINTS)))
    pelvis = np.swapaxes(R[:, 0], -1, -2)
    theta[:, :3] = Rotation.from_matrix(pelvis @ R[:, 1]).as_euler("ZYX")
    trunk = np.swapaxes(R[:, 1], -1, -2)
    nod = trunk @ R[:, 2]
    theta[:, 3] = np.arctan2(nod[:, 0, 2] - nod[:, 2, 0], nod[:, 0, 0] + nod[:, 2, 2])
    for side, arm, leg, at in ((1.0, 3, 7, 0), (-1.0, 5, 10, 1)):
        theta[:, PART_JOINTS[1 + at]] = _arm_angles(
            trunk @ R[:, arm], trunk @ R[:, arm + 1], side, body.limits[PART_JOINTS[1 + at]]
        )
        theta[:, PART_JOINTS[3 + at]] = _leg_angles(
            pelvis @ R[:, leg], pelvis @ R[:, leg + 1], pelvis @ R[:, leg + 2], side
        )
    theta = np.clip(theta, *body.limits.T)
    return np.concatenate([pelvis_numbers(positions[:, 0], Rotation.from_matrix(R[:, 0])), theta], axis=1)


def _arm_angles(
    upper: Float[np.ndarray, "n 3 3"],
    fore: Float[np.ndarray, "n 3 3"],
    side: float,
    limits: Float[np.ndarray, "4 2"],
) -> Float[np.ndarray, "n 4"]:
    """Flexion, elevation, rotation and elbow of an arm from its segments' axes in those of the trunk.

    The upper arm points to `(-sin e sin f, s cos e, sin e cos f)` with flexion f, elevation e and s = 1 on the left; so
    do `f + pi` and `-e`. Of the two the one counts that leaves the limits by less.
    """
    point = side * upper[:, :, 1]
    down = np.arccos(np.clip(side * point[:, 1], -1.0, 1.0))
    swing = np.arctan2(point[:, 0], -point[:, 2])
    both = []
    for f, e in ((swing, -down), (swing - np.copysign(np.pi, swing), down)):
        back = Rotation.from_euler("YX", np.stack([-f, side * e], axis=-1)).inv().as_matrix()
        own, g = back @ upper, side * (back @ fore[:, :, 1:2])[..., 0]
        own_c, own_s = own[:, 0, 0] + own[:, 2, 2], own[:, 0, 2] - own[:, 2, 0]
        # Rot_y(-rotation) takes the bent forearm's forward direction x to (cos, 0, sin), and errs by 1 / sin(bend)
        weight = HINGE * np.hypot(g[:, 0], g[:, 2])
        r = np.arctan2(weight * g[:, 2] - own_s, weight * g[:, 0] + own_c)
        bend = np.arctan2(np.cos(r) * g[:, 0] + np.sin(r) * g[:, 2], side * g[:, 1])
        both.append(np.stack([f, e, r, bend], axis=-1))
    beyond = [np.abs(angles - np.clip(angles, *limits.T)).sum(axis=-1, keepdims=True) for angles in both]
    return np.where(beyond[1] < beyond[0], both[1], both[0])


def _leg_angles(
    thigh: Float[np.ndarray, "n 3 3"], shank: Float[np.ndarray, "n 3 3"], foot: Float[np.ndarray, "n 3 3"], side: float
) -> Float[np.ndarray, "n 4"]:
    """Flexion and abduction of the hip, knee and ankle, from the segments' axes in those of the pelvis."""
    point = -thigh[:, :, 2]
    abduction = side * np.arcsin(np.clip(point[:, 1], -1.0, 1.0))
    flexion = np.arctan2(point[:, 0], -point[:, 2])
    back = Rotation.from_euler("YX", np.stack([-flexion, side * abduction], axis=-1)).inv().as_matrix()
    low = -(back @ shank[:, :, 2:3])[..., 0]
    knee = np.arctan2(-low[:, 0], -low[:, 2])
    toe = (Rotation.from_euler("y", knee[:, None]).inv().as_matrix() @ back @ foot[:, :, :1])[..., 0]
    ankle = np.arctan2(toe[:, 2], toe[:, 0])
    return np.stack([flexion, abduction, knee, ankle], axis=-1)
