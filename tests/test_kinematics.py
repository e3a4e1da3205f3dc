"""Denavit-Hartenberg trees: eq. (2.1) and (2.2) by hand, Jacobians by differences, and what is no tree refused."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.kinematics import (
    Coupling,
    FrameRow,
    Model,
    forward,
    forward_numpy,
    joints_below,
    link_ends,
    link_transform,
    model_from_rows,
    point_jacobian,
    pose_from_free,
)
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.kinematics.builtin import model_names


def turn(axis: int, angle: float) -> np.ndarray:
    """Homogeneous rotation about a coordinate axis."""
    T, (i, k) = np.eye(4), [(1, 2), (2, 0), (0, 1)][axis]
    T[i, i] = T[k, k] = math.cos(angle)
    T[k, i], T[i, k] = math.sin(angle), -math.sin(angle)
    return T


def shift(axis: int, by: float) -> np.ndarray:
    T = np.eye(4)
    T[axis, 3] = by
    return T


def random_rows(rng: np.random.Generator, count: int = 9) -> list[FrameRow]:
    """A tree of turning, sliding and fixed frames, most of them with a link."""
    rows = []
    for i in range(1, count + 1):
        kind = rng.choice(["turns", "slides", "fixed", "transform"], p=[0.5, 0.2, 0.15, 0.15]) if i > 1 else "turns"
        transform = turn(0, 0.4) @ turn(2, rng.uniform(-3, 3)) @ shift(1, 7.0) if kind == "transform" else None
        numbers = (0.0, 0.0, 0.0, 0.0) if kind == "transform" else rng.uniform([-3, -40, -20, -3], [3, 40, 20, 3])
        rows.append(
            FrameRow(
                i,
                int(rng.integers(0, i)),
                *map(float, numbers),
                joint=f"q{i}" if kind in ("turns", "slides") else None,
                prismatic=kind == "slides",
                transform=transform,
                link_length=float(rng.uniform(5, 40)) if rng.random() < 0.8 else None,
                link_radius=(5.0, 4.0),
            )
        )
    return rows


def random_tree(seed: int) -> Model:
    return model_from_rows(f"tree {seed}", random_rows(np.random.default_rng(seed)))


MODELS = {name: builtin_model(name) for name in model_names()} | {f"tree {i}": random_tree(i) for i in range(4)}
models = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())


@given(st.floats(-7, 7), st.floats(-50, 50), st.floats(-50, 50), st.floats(-7, 7))
@settings(deadline=None)
def test_link_transform_is_the_matrix_that_the_thesis_prints(alpha, a, d, theta):
    c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    printed = [  # eq. (2.1)
        [c, -s, 0, a],
        [s * ca, c * ca, -sa, -sa * d],
        [s * sa, c * sa, ca, ca * d],
        [0, 0, 0, 1],
    ]
    np.testing.assert_allclose(link_transform(alpha, a, d, theta), printed, atol=1e-13)
    steps = turn(0, alpha) @ shift(0, a) @ turn(2, theta) @ shift(2, d)
    np.testing.assert_allclose(link_transform(alpha, a, d, theta), steps, atol=1e-13)


@given(st.floats(-4, 4), st.floats(-30, 30))
@settings(max_examples=30, deadline=None)
def test_joint_value_adds_to_the_offset_of_its_own_variable(value, offset):
    turns = model_from_rows("turns", [FrameRow(1, 0, 0.7, 3.0, -2.0, offset, joint="q")])
    slides = model_from_rows("slides", [FrameRow(1, 0, 0.7, 3.0, offset, 1.1, joint="q", prismatic=True)])
    q = np.array([value])
    np.testing.assert_allclose(forward(turns, q)[0], link_transform(0.7, 3.0, -2.0, offset + value), atol=1e-12)
    np.testing.assert_allclose(forward(slides, q)[0], link_transform(0.7, 3.0, offset + value, 1.1), atol=1e-12)


def test_frames_multiply_along_the_chain():
    table = [(0.2, 0.0, 4.0, 0.3), (-1.2, 30.0, 0.0, -0.8), (0.9, 22.0, -3.0, 1.4)]
    rows = [FrameRow(i + 1, i, *row, joint=f"q{i}") for i, row in enumerate(table)]
    frames = forward(model_from_rows("chain", rows), np.array([0.4, -0.6, 1.0]))
    expected = np.eye(4)  # eq. (2.2)
    for i, ((alpha, a, d, theta), value) in enumerate(zip(table, (0.4, -0.6, 1.0), strict=True)):
        expected = expected @ link_transform(alpha, a, d, theta + value)
        np.testing.assert_allclose(frames[i], expected, atol=1e-13)


def test_a_fixed_transform_stands_in_for_the_four_parameters():
    T = turn(1, 0.8) @ shift(0, 5.0)
    model = model_from_rows("m", [FrameRow(1, 0, transform=T), FrameRow(2, 1, joint="q")])
    np.testing.assert_allclose(forward(model, np.array([0.3])), [T, T @ turn(2, 0.3)], atol=1e-14)


@models
def test_frames_are_rigid_and_links_keep_their_length(model):
    q = np.random.default_rng(0).uniform(-3, 3, (20, len(model.joint_names)))
    frames = forward(model, q)
    R = frames[..., :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
    np.testing.assert_array_equal(frames[..., 3, :], np.broadcast_to([0, 0, 0, 1], (*frames.shape[:-2], 4)))
    base, tip = link_ends(model, frames)
    length = np.broadcast_to(model.link_length, base.shape[:-1])
    np.testing.assert_allclose(np.linalg.norm(tip - base, axis=-1), length, rtol=1e-12)


@models
def test_kernel_forward_equals_its_numpy_twin(model):
    q = np.random.default_rng(1).uniform(-3, 3, (50, len(model.joint_names)))
    np.testing.assert_allclose(forward(model, q), forward_numpy(model, q), atol=1e-11)


@models
def test_a_batch_holds_the_single_poses(model):
    q = np.random.default_rng(2).uniform(-3, 3, (2, 3, len(model.joint_names)))
    frames = forward(model, q)
    ends = link_ends(model, frames)
    for i, k in np.ndindex(2, 3):
        one = forward(model, q[i, k])
        np.testing.assert_array_equal(frames[i, k], one)
        for many, single in zip(ends, link_ends(model, one), strict=True):
            np.testing.assert_array_equal(many[i, k], single)


@pytest.mark.parametrize("name", ["full_hand", "pr", "tree 0", "tree 1", "tree 2", "tree 3"])
def test_jacobian_of_any_point_on_any_link_equals_differences_at_1000_poses(name):
    model, rng = MODELS[name], np.random.default_rng(3)
    j, links = len(model.joint_names), model.link_frame.size
    q = rng.uniform(-math.pi, math.pi, (1000, j))
    local = np.concatenate([rng.uniform(-1, 1, (links, 3)) * [60, 12, 12], np.ones((links, 1))], axis=1)

    def points(poses):
        return (forward(model, poses)[:, model.link_frame] @ local[..., None])[..., :3, 0]

    frames, at = forward(model, q), points(q)
    jacobian = np.stack([point_jacobian(model, frames[i], model.link_frame, at[i]) for i in range(1000)])
    assert jacobian.shape == (1000, links, 3, j)
    h = 1e-3  # of a central difference of fourth order: truncation below 1e-11, rounding below 1e-10
    for i in range(j):
        step = h * np.eye(j)[i]
        near, far = points(q + step) - points(q - step), points(q + 2 * step) - points(q - 2 * step)
        np.testing.assert_allclose(jacobian[..., i], (8 * near - far) / (12 * h), rtol=0, atol=1e-8)


@models
def test_joints_below_are_those_that_move_the_frame(model):
    rng = np.random.default_rng(4)
    q = rng.uniform(-1, 1, len(model.joint_names))
    still = forward(model, q)
    below = joints_below(model)
    for i in range(q.size):
        changed = np.abs(forward(model, q + 0.1 * np.eye(q.size)[i]) - still).max(axis=(1, 2)) > 1e-12
        np.testing.assert_array_equal(changed, below[:, i])


@pytest.mark.parametrize("seed", range(8))
def test_rows_may_come_in_any_order(seed):
    rng = np.random.default_rng(seed)
    rows = random_rows(rng)
    straight = model_from_rows("a", rows)
    mixed = model_from_rows("b", [rows[i] for i in rng.permutation(len(rows))])
    q = dict(zip(straight.joint_names, rng.uniform(-2, 2, len(straight.joint_names)), strict=True))
    frames = [forward(m, np.array([q[name] for name in m.joint_names])) for m in (straight, mixed)]
    place = [mixed.frame_ids.tolist().index(i) for i in straight.frame_ids]
    np.testing.assert_allclose(frames[1][place], frames[0], atol=1e-12)
    assert all(parent < i for i, parent in enumerate(mixed.parent)), "parents come first"
    np.testing.assert_array_equal(mixed.limits.shape, (len(q), 2))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([FrameRow(1, 2, joint="a"), FrameRow(2, 1)], "frame 1: its parents form a cycle"),
        ([FrameRow(1, 0, joint="a"), FrameRow(3, 3)], "frame 3: its parents form a cycle"),
        ([FrameRow(1, 0, joint="a"), FrameRow(1, 0)], "frame 1: id is given twice"),
        ([FrameRow(1, 0, joint="a"), FrameRow(2, 7)], "frame 2: parent 7 does not exist"),
        ([FrameRow(0, 0, joint="a")], "frame 0: id must be a positive integer"),
        ([FrameRow(1, 0)], "model 'm' has no joint"),
        ([], "model 'm' has no joint"),
        ([FrameRow(1, 0, joint="a"), FrameRow(2, 1, joint="a")], "joint 'a' is named twice"),
    ],
)
def test_what_is_no_tree_of_joints_is_refused(rows, message):
    with pytest.raises(ValueError, match=message):
        model_from_rows("m", rows)


ABC = [FrameRow(1, 0, joint="a"), FrameRow(2, 1, a=9.0, joint="b"), FrameRow(3, 2, a=9.0, joint="c")]


@pytest.mark.parametrize(
    ("couplings", "message"),
    [
        ([Coupling("a", "b", 1.0), Coupling("b", "a", 1.0)], "follows itself in a circle"),
        ([Coupling("b", "b", 0.5)], "'b' follows itself in a circle"),
        ([Coupling("b", "x", 0.5)], "joint 'x' does not exist; the model has a, b, c"),
        ([Coupling("x", "b", 0.5)], "joint 'x' does not exist"),
        ([Coupling("b", "a", 0.5), Coupling("b", "c", 0.5)], "joint 'b' is coupled twice"),
    ],
)
def test_couplings_that_say_nothing_are_refused(couplings, message):
    with pytest.raises(ValueError, match=message):
        model_from_rows("m", ABC, couplings)


@given(*[st.floats(-2, 2) for _ in range(5)])
@settings(max_examples=30, deadline=None)
def test_chained_couplings_hold_for_every_pose(a, r1, o1, r2, o2):
    # Written before the one it follows: order must not matter.
    model = model_from_rows("m", ABC, [Coupling("c", "b", r2, o2), Coupling("b", "a", r1, o1)])
    assert model.free.tolist() == [0]
    q = pose_from_free(model, np.array([a]))
    np.testing.assert_allclose(q, [a, r1 * a + o1, r2 * (r1 * a + o1) + o2], atol=1e-12)
    many = pose_from_free(model, np.array([[a], [a + 1.0]]))
    np.testing.assert_allclose(many[0], q, atol=1e-15)


def test_without_couplings_every_joint_is_free():
    model = MODELS["full_hand"]
    assert model.free.tolist() == list(range(21))
    np.testing.assert_array_equal(model.coupling, np.eye(21))
    np.testing.assert_array_equal(model.coupling_offset, 0.0)


def test_links_of_two_fingers_are_numbered_from_the_knuckles_to_the_tips():
    model = MODELS["two_finger"]
    assert model.link_finger.tolist() == [0, 0, 0, 1, 1, 1]
    assert model.link_is_tip.tolist() == [False, False, True] * 2
    assert model.link_parent.tolist() == [-1, 0, 1, -1, 3, 4]


def test_full_hand_has_five_fingers_of_three_links():
    model = MODELS["full_hand"]
    assert model.link_finger.tolist() == np.repeat(range(5), 3).tolist()
    assert model.link_is_tip.tolist() == [False, False, True] * 5
    assert model.link_parent.reshape(5, 3).tolist() == [[-1, 3 * i, 3 * i + 1] for i in range(5)]
    # Each link hangs on the frame of the link below, frames without a body between them or not.
    assert [model.joint_names[model.joint[i]] for i in model.link_frame[12:]] == [
        "thumb_radial",
        "thumb_mcp",
        "thumb_ip",
    ]


def test_a_link_shared_by_two_tips_is_a_group_of_its_own():
    pill = {"link_length": 10.0, "link_radius": (2.0, 2.0)}
    rows = [
        FrameRow(1, 0, joint="palm", **pill),
        FrameRow(2, 1, a=10.0, joint="left", **pill),
        FrameRow(3, 1, a=10.0),
        FrameRow(4, 3, theta=1.0, joint="right", **pill),
        FrameRow(5, 4, a=10.0, joint="right_end", **pill),
    ]
    model = model_from_rows("y", rows)
    assert model.link_finger.tolist() == [0, 1, 2, 2]
    assert model.link_is_tip.tolist() == [False, True, False, True]
    assert model.link_parent.tolist() == [-1, 0, 0, 2]


def test_a_model_without_bodies_still_moves():
    model = model_from_rows("bare", ABC)
    base, tip = link_ends(model, forward(model, np.zeros(3)))
    assert base.shape == tip.shape == (0, 3)
    assert model.link_radius.shape == (0, 2)


def test_a_pose_of_the_wrong_length_is_refused():
    with pytest.raises(ValueError, match="q: last axis has 5 values, model 'two_finger' has 6 joints"):
        forward(MODELS["two_finger"], np.zeros(5))


@models
def test_a_batched_jacobian_holds_the_single_ones(model):
    q = np.random.default_rng(5).uniform(-3, 3, (2, 3, len(model.joint_names)))
    frames = forward(model, q)
    _, tip = link_ends(model, frames)
    jacobian = point_jacobian(model, frames, model.link_frame, tip)
    for i, k in np.ndindex(2, 3):
        one = point_jacobian(model, frames[i, k], model.link_frame, tip[i, k])
        np.testing.assert_allclose(jacobian[i, k], one, atol=1e-12)
