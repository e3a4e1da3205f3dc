"""Lengths of a body in, its upper half as a Denavit-Hartenberg tree of pills out; and joint angles with their limits.

Frame {0} sits between the hips: x forward, y to the left, z up. Each arm has the four joints of the wrist thesis,
figure 6.1: `alpha1` abducts the upper arm (raises it to its own side), `alpha2` flexes it (raises it forward), `alpha3`
turns it about itself, outward positive, and `alpha4` is the angle inside the elbow, 180 degrees for a straight arm. At
zero and with a straight elbow an arm hangs down; the turn of the upper arm is

    R = Rot_x(-s alpha1) Rot_y(-alpha2) Rot_z(-s alpha3),  s = 1 for the right arm and -1 for the left

Limits are those of the thesis, section 6.2.1, after Lenarcic & Umek 1994 ("Simple model of human arm reachable
workspace"), whose couplings are named parameters here. The thesis prints 160 degrees where that paper's workspace and
the other direction suggest 60: `ArmLimits.outward` decides.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from ..kinematics.tree import FrameRow, Model, model_from_rows

Side = Literal["left", "right"]
ARM_JOINTS = ("abduction", "flexion", "rotation", "elbow")  # alpha1 .. alpha4


@dataclass(frozen=True, slots=True)
class BodyLengths:
    """Distances between joints and radii of pills, metres: an adult's by default (after Winter 2009, table 4.1)."""

    torso: float = 0.50
    shoulder: float = 0.19
    upper_arm: float = 0.30
    forearm: float = 0.26
    hand: float = 0.10
    neck: float = 0.12
    torso_radius: float = 0.13
    upper_arm_radius: float = 0.05
    forearm_radius: float = 0.04
    hand_radius: float = 0.03
    head_radius: float = 0.10


@dataclass(frozen=True, slots=True)
class ArmLimits:
    """Limits of alpha1 .. alpha4, degrees; (a, b, c, d) stands for a + b alpha1 + c alpha2 + d alpha1 alpha2."""

    abduction: tuple[float, float] = (-9.0, 160.0)
    flexion_low: tuple[float, float] = (-43.0, 1.0 / 3.0)
    flexion_high: tuple[float, float] = (153.0, -1.0 / 6.0)
    inward: tuple[float, float, float, float] = (-90.0, 7.0 / 9.0, -1.0 / 9.0, 2.0 / 810.0)
    outward: tuple[float, float, float, float] = (60.0, 4.0 / 9.0, -5.0 / 9.0, 5.0 / 810.0)
    elbow: tuple[float, float] = (20.0, 180.0)


LIMITS = ArmLimits()
PRINTED = ArmLimits(outward=(160.0, 4.0 / 9.0, -5.0 / 9.0, 5.0 / 810.0))  # as the thesis has it


def limits_at(
    abduction: Float[np.ndarray, " n"], flexion: Float[np.ndarray, " n"], limits: ArmLimits = LIMITS
) -> Float[np.ndarray, "n 4 2"]:
    """Least and greatest alpha1 .. alpha4 of arms whose first two angles are these; radians.

    >>> np.degrees(limits_at(np.radians([90.0]), np.radians([0.0])))[0].round(1).tolist()
    [[-9.0, 160.0], [-13.0, 138.0], [-20.0, 100.0], [20.0, 180.0]]
    """
    a, b = np.degrees(abduction), np.degrees(flexion)
    out = np.empty((a.size, 4, 2))
    out[:, 0], out[:, 3] = limits.abduction, limits.elbow
    for k, (constant, slope) in enumerate((limits.flexion_low, limits.flexion_high)):
        out[:, 1, k] = constant + slope * a
    for k, (constant, by_a, by_b, by_ab) in enumerate((limits.inward, limits.outward)):
        out[:, 2, k] = constant + by_a * a + by_b * b + by_ab * a * b
    return np.radians(out)


def within_limits(
    alpha: Float[np.ndarray, "n 4"], limits: ArmLimits = LIMITS, slack: float = 1e-9
) -> Bool[np.ndarray, " n"]:
    """Whether arms keep all four limits; `slack` in radians."""
    allowed = limits_at(alpha[:, 0], alpha[:, 1], limits)
    return np.all((alpha >= allowed[..., 0] - slack) & (alpha <= allowed[..., 1] + slack), axis=1)


def torso_axes(
    left_shoulder: Float[np.ndarray, " 3"], right_shoulder: Float[np.ndarray, " 3"], down: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "3 3"]:
    """Axes of a torso as columns: x forward, y to the left shoulder, z up.

    Parameters
    ----------
    down : (3,)
        From the shoulders to the hips, or along gravity.

    Raises
    ------
    ValueError
        If the three directions lie in one line.
    """
    y = left_shoulder - right_shoulder
    x = np.cross(y, -down)
    size, width = np.linalg.norm(x), np.linalg.norm(y)
    if not size > 1e-9 * max(width, 1e-9):
        raise ValueError("down: runs along the line of the shoulders; another direction was wanted")
    x, y = x / size, y / width
    return np.column_stack([x, y, np.cross(x, y)])


def arm_angles(
    upper: Float[np.ndarray, "n 3"],
    fore: Float[np.ndarray, "n 3"],
    torso: Float[np.ndarray, "3 3"],
    side: Side,
    limits: ArmLimits = LIMITS,
) -> Float[np.ndarray, "n 4"]:
    """alpha1 .. alpha4 of arms whose upper arm and forearm point there; radians.

    Parameters
    ----------
    upper, fore : (n, 3)
        From shoulder to elbow and from elbow to wrist, of any length; same axes as `torso`.
    torso : (3, 3)
        Axes of the torso as columns (`torso_axes`).

    Notes
    -----
    Two sets of angles give the same arm; the one with at most 90 degrees of flexion comes back, unless only the other
    keeps the limits. A straight arm has any rotation, 0 is given; an arm stretched forward any abduction.
    """
    u = upper @ torso / np.linalg.norm(upper, axis=1, keepdims=True)
    f = fore @ torso / np.linalg.norm(fore, axis=1, keepdims=True)
    s = 1.0 if side == "right" else -1.0
    # u = Rot_x(-s alpha1) Rot_y(-alpha2) (-z) = (sin alpha2, -s sin alpha1 cos alpha2, -cos alpha1 cos alpha2)
    flexion, abduction = np.arcsin(np.clip(u[:, 0], -1.0, 1.0)), np.arctan2(-s * u[:, 1], -u[:, 2])
    one = _with_forearm(abduction, flexion, f, s)
    other = _with_forearm(np.mod(abduction + 2.0 * np.pi, 2.0 * np.pi) - np.pi, np.pi - flexion, f, s)
    second = ~within_limits(one, limits) & within_limits(other, limits)
    return np.where(second[:, None], other, one)


def _with_forearm(
    abduction: Float[np.ndarray, " n"], flexion: Float[np.ndarray, " n"], fore: Float[np.ndarray, "n 3"], s: float
) -> Float[np.ndarray, "n 4"]:
    """All four angles, from the first two and the forearm's direction in the torso's axes."""
    turn = _turns(-s * abduction, -flexion)
    own = np.einsum("nji,nj->ni", turn, fore)  # in the axes of the upper arm before it turns about itself
    elbow = np.arccos(np.clip(own[:, 2], -1.0, 1.0))
    bent = np.hypot(own[:, 0], own[:, 1]) > 1e-9
    rotation = np.where(bent, np.arctan2(-s * own[:, 1], own[:, 0]), 0.0)
    return np.column_stack([abduction, flexion, rotation, elbow])


def _turns(about_x: Float[np.ndarray, " n"], about_y: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
    """Rot_x Rot_y."""
    cx, sx, cy, sy = np.cos(about_x), np.sin(about_x), np.cos(about_y), np.sin(about_y)
    zero = np.zeros_like(cx)
    rows = [[cy, zero, sy], [sx * sy, cx, -sx * cy], [-cx * sy, sx, cx * cy]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def upper_body(lengths: BodyLengths = BodyLengths(), limits: ArmLimits = LIMITS) -> Model:
    """The tree of both arms, torso and head, metres; joints are `left_abduction` .. `right_elbow`.

    Limits in the model are the widest that the couplings allow; `within_limits` knows the couplings.

    >>> upper_body().joint_names[:4]
    ('left_abduction', 'left_flexion', 'left_rotation', 'left_elbow')
    """
    up, out = math.pi / 2.0, math.pi / 2.0
    rows = [
        FrameRow(1, 0, alpha=up, theta=out, link_length=lengths.torso, link_radius=_both(lengths.torso_radius)),
        FrameRow(2, 1, a=lengths.torso),
        FrameRow(3, 2, a=lengths.neck, link_length=0.5 * lengths.neck, link_radius=_both(lengths.head_radius)),
    ]
    for first, side in ((10, "left"), (20, "right")):
        rows += _arm(first, "left" if side == "left" else "right", lengths, limits)
    return model_from_rows("upper_body", rows, units="m")


def _arm(first: int, side: Side, lengths: BodyLengths, limits: ArmLimits) -> list[FrameRow]:
    """Rows of one arm on frame {0}."""
    s = 1.0 if side == "right" else -1.0
    quarter = math.pi / 2.0
    shoulder = np.eye(4)
    shoulder[:3, 3] = (0.0, -s * lengths.shoulder, lengths.torso)
    ends = _widest(limits)
    names = [f"{side}_{joint}" for joint in ARM_JOINTS]
    k = list(range(first, first + 7))
    fore, upper = _both(lengths.forearm_radius), _both(lengths.upper_arm_radius)
    return [
        FrameRow(k[0], 0, transform=shoulder),
        FrameRow(k[1], k[0], theta=-s * quarter),
        FrameRow(k[2], k[1], alpha=quarter, theta=-quarter, joint=names[0], limits=ends[0]),
        FrameRow(k[3], k[2], alpha=-s * quarter, theta=quarter, joint=names[1], limits=ends[1]),
        FrameRow(k[4], k[3], theta=-quarter, link_length=lengths.upper_arm, link_radius=upper),
        FrameRow(k[5], k[3], alpha=s * quarter, d=s * lengths.upper_arm, joint=names[2], limits=ends[2]),
        FrameRow(
            k[6],
            k[5],
            alpha=s * quarter,
            theta=-quarter,
            joint=names[3],
            limits=ends[3],
            link_length=lengths.forearm,
            link_radius=fore,
        ),
        FrameRow(
            first + 7,
            k[6],
            a=lengths.forearm,
            link_length=lengths.hand,
            link_radius=_both(lengths.hand_radius),
        ),
    ]


def _both(radius: float) -> tuple[float, float]:
    return radius, radius


def _widest(limits: ArmLimits) -> list[tuple[float, float]]:
    """Limits that hold whatever the other angles are."""
    grid = np.radians(np.linspace(*limits.abduction, 30))
    a, share = (x.ravel() for x in np.meshgrid(grid, np.linspace(0.0, 1.0, 30)))
    flexion = limits_at(a, np.zeros_like(a), limits)[:, 1]
    allowed = limits_at(a, flexion[:, 0] + share * (flexion[:, 1] - flexion[:, 0]), limits)
    return list(zip(allowed[..., 0].min(axis=0).tolist(), allowed[..., 1].max(axis=0).tolist(), strict=True))
