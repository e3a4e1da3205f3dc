"""Sizes of a body in, its tree of segments and joints out: as compact chains for batches, and as a model of frames.

The walk paper's digital human has "13 segments linked by 20 revolute joints" and is filtered in five parts, trunk with
head, arms and legs; its figure is not at hand. Here every part has four joints:

    trunk and head: rotation (z), flexion (y), bending to the side (x); nodding (y)
    arm:            flexion (y), elevation (x), rotation (y) of the shoulder; elbow (z)
    leg:            flexion (y), abduction (x) of the hip; knee (y); ankle (y)

Axes are those of the neutral pose, in which all segments have the axes of the world: x forward, y to the left, z up,
arms out. Bending forward, lifting an arm or a leg forward, lifting it to its own side, turning it outward, bending
elbow or knee and lifting the toes are positive. Six more joints, x, y, z, yaw, pitch and roll, move the pelvis.

Limits: American Academy of Orthopaedic Surgeons, "Joint Motion" (1965), as commonly tabulated; the elevation of an arm
is its abduction less 90 degrees, for it starts from the arm stretched out. Knees and elbows may overstretch a little.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..formats.walks import SEGMENTS
from ..kinematics.tree import FrameRow, Model, model_from_rows
from .anthropometry import Sizes

PARENT = (-1, 0, 1, 1, 3, 1, 5, 0, 7, 8, 0, 10, 11)
PARTS = ("trunk", "left_arm", "right_arm", "left_leg", "right_leg")
PART_SEGMENTS = ((1, 2), (3, 4), (5, 6), (7, 8, 9), (10, 11, 12))

Joint = tuple[str, str, float, float]  # name, axis with its sign, lowest and highest angle in degrees

_TRUNK: tuple[Joint, ...] = (
    ("trunk_rotation", "+z", -45.0, 45.0), ("trunk_flexion", "+y", -25.0, 80.0), ("trunk_bending", "+x", -35.0, 35.0),
)  # fmt: skip
_HEAD: tuple[Joint, ...] = (("neck_flexion", "+y", -45.0, 45.0),)
_ROOT = ("x", "y", "z", "yaw", "pitch", "roll")
ROOT_JOINTS = tuple(f"pelvis_{name}" for name in _ROOT)


def _side(side: str) -> tuple[tuple[Joint, ...], ...]:
    """Joints of upper arm, forearm, thigh, shank and foot."""
    left = side == "left"
    up, out, bend = ("+x", "+x", "-z") if left else ("-x", "-x", "+z")
    return (
        (
            (f"{side}_shoulder_flexion", "-y", -60.0, 180.0),
            (f"{side}_shoulder_elevation", up, -130.0, 90.0),
            (f"{side}_shoulder_rotation", "-y", -90.0, 90.0),
        ),
        ((f"{side}_elbow", bend, -5.0, 150.0),),
        ((f"{side}_hip_flexion", "-y", -30.0, 120.0), (f"{side}_hip_abduction", out, -30.0, 45.0)),
        ((f"{side}_knee", "+y", -5.0, 135.0),),
        ((f"{side}_ankle", "-y", -50.0, 20.0),),
    )


_LEFT, _RIGHT = _side("left"), _side("right")
SEGMENT_JOINTS = ((), _TRUNK, _HEAD, *_LEFT[:2], *_RIGHT[:2], *_LEFT[2:], *_RIGHT[2:])
JOINTS = tuple(name for joints in SEGMENT_JOINTS for name, *_ in joints)
LIMITS = np.radians([joint[2:] for joints in SEGMENT_JOINTS for joint in joints])


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Segments and their joints for the batch kinematics.

    Attributes
    ----------
    parent : (s,)
        -1: the base. Parents come before their children.
    offset : (s, 3)
        Of each segment's origin from its parent's, in the parent's axes, metres.
    first : (s + 1,)
        Joints `first[i]` to `first[i + 1] - 1` turn segment i, one after the other.
    axis : (j,)
        0, 1, 2: turns about x, y, z; 3, 4, 5: slides along them.
    sign : (j,)
        +1 or -1, the direction of the axis.
    """

    parent: Int[np.ndarray, " s"]
    offset: Float[np.ndarray, "s 3"]
    first: Int[np.ndarray, " t"]
    axis: Int[np.ndarray, " j"]
    sign: Float[np.ndarray, " j"]


def offsets_of(sizes: Sizes) -> Float[np.ndarray, "13 3"]:
    """Origin of each segment in its parent's axes, metres; zero for the pelvis."""
    out = np.zeros((len(SEGMENTS), 3))
    out[1, 2], out[2, 2] = sizes.lumbar, sizes.trunk + sizes.neck
    for side, arm, leg in ((1.0, 3, 7), (-1.0, 5, 10)):
        out[arm] = 0.0, side * sizes.shoulder, sizes.trunk
        out[arm + 1, 1] = side * sizes.upper_arm
        out[leg, 1] = side * sizes.hip
        out[leg + 1, 2], out[leg + 2, 2] = -sizes.thigh, -sizes.shank
    return out


def ends_of(sizes: Sizes) -> Float[np.ndarray, "13 3"]:
    """Far end of each segment in its own axes, metres: the pelvis ends at the trunk, the head in the face."""
    out = np.zeros((len(SEGMENTS), 3))
    out[0, 2], out[1, 2], out[2, 2] = sizes.lumbar, sizes.trunk, sizes.head
    for side, arm, leg in ((1.0, 3, 7), (-1.0, 5, 10)):
        out[arm, 1], out[arm + 1, 1] = side * sizes.upper_arm, side * sizes.forearm
        out[leg, 2], out[leg + 1, 2] = -sizes.thigh, -sizes.shank
        out[leg + 2] = sizes.foot, 0.0, -0.5 * sizes.ankle
    return out


def whole_chain(sizes: Sizes) -> Chain:
    """All segments; the first six joints move the pelvis."""
    signed = ["+z", "+y", "+x", *(axis for joints in SEGMENT_JOINTS for _, axis, *_ in joints)]
    counts = [6, *(len(joints) for joints in SEGMENT_JOINTS[1:])]
    return Chain(
        parent=np.array(PARENT),
        offset=offsets_of(sizes),
        first=np.concatenate([[0], np.cumsum(counts)]),
        axis=np.array([3, 4, 5, *("xyz".index(axis[1]) for axis in signed)]),
        sign=np.array([1.0, 1.0, 1.0, *(float(axis[0] + "1") for axis in signed)]),
    )


def part_chain(whole: Chain, part: int) -> Chain:
    """One part alone: its first segment sits in the base's origin, with the axes of the segment that carries it."""
    segments = np.array(PART_SEGMENTS[part])
    joints = np.concatenate([np.arange(int(whole.first[i]), int(whole.first[i + 1])) for i in PART_SEGMENTS[part]])
    counts = np.diff(whole.first)[segments]
    offset = whole.offset[segments].copy()
    offset[0] = 0.0
    number = {int(segment): i for i, segment in enumerate(segments)}
    return Chain(
        parent=np.array([number.get(int(whole.parent[i]), -1) for i in segments]),
        offset=offset,
        first=np.concatenate([[0], np.cumsum(counts)]),
        axis=whole.axis[joints],
        sign=whole.sign[joints],
    )


def body_model(name: str, chain: Chain, ends: Float[np.ndarray, "13 3"], radii: Float[np.ndarray, "13 2"]) -> Model:
    """The same tree as rows of hand thesis, eq. (2.1); frame `100 (i + 1)` has the axes of segment i.

    A joint's frame turns about its own z, so each segment begins with a fixed frame that has z along its first axis and
    ends with one that has the segment's axes, and its pill.
    """
    names = (*ROOT_JOINTS, *JOINTS)
    limits = [(-math.inf, math.inf)] * 6 + [(float(low), float(high)) for low, high in LIMITS]
    rows: list[FrameRow] = []
    for i, above in enumerate(chain.parent):
        joints = range(chain.first[i], chain.first[i + 1])
        axes = [chain.sign[j] * np.eye(3)[chain.axis[j] % 3] for j in joints]
        first = 100 * (i + 1) - len(axes) - 1
        frame = _axes(axes[0], axes[1] if len(axes) > 1 else axes[0])
        rows.append(FrameRow(first, 100 * (int(above) + 1), transform=_placed(frame, chain.offset[i])))
        for k, j in enumerate(joints):
            turn = frame.T @ axes[k]
            alpha = math.atan2(-turn[1], turn[2])
            frame = frame @ _about_x(alpha)
            wanted = frame.T @ _axes(axes[k], axes[min(k + 1, len(axes) - 1)])[:, 0]
            theta = math.atan2(wanted[1], wanted[0])
            frame = frame @ _about_x(theta)[[1, 2, 0]][:, [1, 2, 0]]
            rows.append(
                FrameRow(
                    first + k + 1,
                    first + k,
                    alpha,
                    theta=theta,
                    joint=names[j],
                    prismatic=bool(chain.axis[j] >= 3),
                    limits=limits[j],
                )
            )
        length = float(np.linalg.norm(ends[i]))
        rows.append(
            FrameRow(
                100 * (i + 1),
                100 * (i + 1) - 1,
                transform=_placed(np.rint(frame.T), np.zeros(3)),
                link_length=length,
                link_radius=(float(radii[i, 0]), float(radii[i, 1])),
                link_tip_offset=(float(ends[i, 0]) - length, float(ends[i, 1]), float(ends[i, 2])),
            )
        )
    return model_from_rows(name, rows, units="m")


def _axes(z: Float[np.ndarray, " 3"], after: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """A frame with this z axis, and x across it and the axis that comes after."""
    x = np.cross(z, after)
    if not x.any():
        x = np.roll(z, 1)
    return np.column_stack([x, np.cross(z, x), z])


def _about_x(angle: float) -> Float[np.ndarray, "3 3"]:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _placed(R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = R, t
    return out
