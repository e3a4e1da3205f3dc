"""Claims about the arm: its tree against the formula of its turns, angles there and back, limits against the seed."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handtrack.body.arm import (
    ARM_JOINTS,
    LIMITS,
    PRINTED,
    BodyLengths,
    arm_angles,
    limits_at,
    torso_axes,
    upper_body,
    within_limits,
)
from handtrack.kinematics.tree import forward, link_ends

SIDES = ("left", "right")
LENGTHS = BodyLengths()
DEGREES = st.tuples(st.floats(-9, 160), st.floats(-40, 150), st.floats(-100, 100), st.floats(21, 179))


def arm_points(side, degrees):
    """Shoulder, elbow, wrist of the tree."""
    model = upper_body()
    q = np.zeros(8)
    q[[model.joint_names.index(f"{side}_{joint}") for joint in ARM_JOINTS]] = np.radians(degrees)
    base, tip = link_ends(model, forward(model, q))
    first = 2 if side == "left" else 5
    return base[first], tip[first], tip[first + 1]


@pytest.mark.parametrize("side", SIDES)
@settings(deadline=None)
@given(degrees=DEGREES)
def test_the_tree_turns_the_arm_as_the_formula_says(side, degrees):
    s = 1 if side == "right" else -1
    shoulder, elbow, wrist = arm_points(side, degrees)
    a1, a2, a3, a4 = np.radians(degrees)
    R = (
        Rotation.from_rotvec([-s * a1, 0, 0])
        * Rotation.from_rotvec([0, -a2, 0])
        * Rotation.from_rotvec([0, 0, -s * a3])
    ).as_matrix()
    np.testing.assert_allclose(shoulder, [0, -s * LENGTHS.shoulder, LENGTHS.torso], atol=1e-12)
    np.testing.assert_allclose(elbow - shoulder, R @ [0, 0, -LENGTHS.upper_arm], atol=1e-12)
    fore = LENGTHS.forearm * np.array([math.sin(a4), 0, math.cos(a4)])
    np.testing.assert_allclose(wrist - elbow, R @ fore, atol=1e-12)
    upper = -(elbow - shoulder) @ (wrist - elbow) / LENGTHS.upper_arm / LENGTHS.forearm
    assert upper == pytest.approx(math.cos(a4))


@pytest.mark.parametrize("side", SIDES)
@settings(deadline=None)
@given(degrees=DEGREES, turn=st.floats(0, 6))
def test_angles_come_back_from_points(side, degrees, turn):
    shoulder, elbow, wrist = arm_points(side, degrees)
    T = Rotation.from_rotvec([0.3 * turn, -0.2, turn]).as_matrix()
    got = np.degrees(arm_angles((T @ (elbow - shoulder))[None], (T @ (wrist - elbow))[None], T, side)[0])
    again = arm_points(side, got)
    np.testing.assert_allclose(again[1], elbow, atol=1e-7)
    np.testing.assert_allclose(again[2], wrist, atol=1e-7)
    if within_limits(np.radians([degrees]), slack=-1e-4)[0] and abs(degrees[1] - 90) > 1:
        assert within_limits(np.radians(got)[None], slack=1e-5)[0]


@pytest.mark.parametrize(("side", "degrees", "direction"), [
    ("right", (90, 0, 0, 180), (0, -1, 0)),
    ("left", (90, 0, 0, 180), (0, 1, 0)),
    ("right", (0, 90, 0, 180), (1, 0, 0)),
    ("left", (0, 90, 0, 180), (1, 0, 0)),
])  # fmt: skip
def test_abduction_raises_to_the_own_side_and_flexion_forward(side, degrees, direction):
    shoulder, elbow, wrist = arm_points(side, degrees)
    np.testing.assert_allclose((elbow - shoulder) / LENGTHS.upper_arm, direction, atol=1e-12)
    np.testing.assert_allclose((wrist - shoulder) / (LENGTHS.upper_arm + LENGTHS.forearm), direction, atol=1e-12)


@pytest.mark.parametrize("side", SIDES)
def test_outward_rotation_turns_a_bent_forearm_away_from_the_body(side):
    _, elbow, wrist = arm_points(side, (0, 0, 50, 90))
    outward = -1 if side == "right" else 1
    assert (wrist - elbow)[1] * outward > 0.1


@settings(deadline=None)
@given(a=st.floats(-9, 160), b=st.floats(-100, 150))
def test_limits_are_those_of_the_thesis(a, b):
    low, high = np.degrees(limits_at(np.radians([a]), np.radians([b]))[0]).T
    np.testing.assert_allclose(low, [-9, -43 + a / 3, -90 + 7 * a / 9 - b / 9 + 2 * a * b / 810, 20], atol=1e-9)
    np.testing.assert_allclose(high, [160, 153 - a / 6, 60 + 4 * a / 9 - 5 * b / 9 + 5 * a * b / 810, 180], atol=1e-9)
    printed = np.degrees(limits_at(np.radians([a]), np.radians([b]), PRINTED)[0])
    assert printed[2, 1] - high[2] == pytest.approx(100)


@settings(deadline=None)
@given(degrees=DEGREES)
def test_the_model_allows_whatever_the_couplings_allow(degrees):
    alpha = np.radians([degrees])
    model = upper_body()
    inside = ((alpha[0] >= model.limits[:4, 0] - 1e-6) & (alpha[0] <= model.limits[:4, 1] + 1e-6)).all()
    if within_limits(alpha, LIMITS)[0]:
        assert inside


def test_the_axes_of_a_torso_are_forward_left_up():
    axes = torso_axes(np.array([0.2, 0.0, 2.0]), np.array([-0.2, 0.0, 2.0]), np.array([0.05, 1.0, 0.0]))
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)  # camera axes: a person who faces the camera
    np.testing.assert_allclose(axes[:, 0], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(axes[:, 2], [0, -1, 0], atol=1e-12)
    with pytest.raises(ValueError, match="down: runs along the line of the shoulders"):
        torso_axes(np.array([1.0, 0, 0]), np.zeros(3), np.array([-2.0, 0, 0]))


def test_pills_reach_from_joint_to_joint():
    model = upper_body(BodyLengths(upper_arm=0.33, forearm=0.25))
    base, tip = link_ends(model, forward(model, np.full(8, 0.4)))
    np.testing.assert_allclose(np.linalg.norm(tip - base, axis=1)[[2, 3, 5, 6]], [0.33, 0.25, 0.33, 0.25])
    np.testing.assert_allclose(tip[[2, 5]], base[[3, 6]], atol=1e-12)
