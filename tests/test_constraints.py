"""Claims about what a wrist's particles may do: each test against geometry that can be reckoned by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from handtrack import _kernels
from handtrack.body.constraints import (
    Constraints,
    DepthMap,
    JointVolume,
    Room,
    Shell,
    carried,
    collides,
    contradicted,
    limb_rays_numpy,
    nearest_readings_numpy,
    outside_shell,
    outside_volume,
    outside_volume_numpy,
    plane_normal,
    seen_through_numpy,
    survivors,
    volume_at,
)
from handtrack.body.environment import ray_caster, room_of
from handtrack.camera import orthographic, perspective

CAMERA = perspective(40, 30, 40.0, 40.0, 20.0, 15.0, np.eye(3), np.zeros(3))
WALL = room_of(np.array([[-9.0, -9, 2], [9, -9, 2], [0, 9, 2]]), np.array([[0, 1, 2]]))
DIRECTIONS = hnp.arrays(float, 3, elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 0.1)


@settings(deadline=None)
@given(
    depth=hnp.arrays(np.float32, (12, 9), elements=st.sampled_from([0, 0, 0, 1, 2])),
    asked=st.lists(st.tuples(st.integers(0, 11), st.integers(0, 8)), min_size=1, max_size=8),
    reach=st.integers(1, 14),
)
def test_the_nearest_reading_is_found_as_by_looking_at_all(depth, asked, reach):
    row, column = np.array(asked).T.copy()
    found = _kernels.nearest_readings(depth, row, column, reach)
    np.testing.assert_array_equal(found, nearest_readings_numpy(depth, row, column, reach))


@settings(deadline=None)
@given(seed=st.integers(0, 10**6), reach=st.integers(1, 14), bent=st.booleans(), flat=st.booleans())
def test_limbs_are_looked_at_as_by_plain_arithmetic(seed, reach, bent, flat):
    rng = np.random.default_rng(seed)
    lens = np.array([-0.2, 0.1, 0.01, -0.02, 0.03]) if bent else None
    camera = perspective(9, 12, 11.0, 12.0, 4.3, 5.2, np.eye(3), np.zeros(3), lens)
    if flat:
        camera = orthographic(9, 12, 5.0, 4.3, 5.2, np.eye(3), np.zeros(3))
    depth = rng.choice([0.0, 0.0, 1.0, 1.5, 2.0], (12, 9)).astype(np.float32)
    father, p = rng.normal(size=(2, 40, 3)) * [0.5, 0.5, 0.8] + [0, 0, 1.2]
    where = DepthMap(depth, camera, reach=reach, along=(0.3, 0.7, 1.0))
    np.testing.assert_array_equal(contradicted(p, father, where), seen_through_numpy(p, father, where))


@settings(deadline=None)
@given(seed=st.integers(0, 10**6), start=st.floats(0, 0.2), most=st.floats(0, 1))
def test_limbs_are_tested_as_by_plain_arithmetic(seed, start, most):
    rng = np.random.default_rng(seed)
    father, p = rng.normal(size=(2, 50, 3))
    p[0] = father[0]
    axes = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    for ours, twin in zip(
        _kernels.limb_rays(p, father, start, 0.1), limb_rays_numpy(p, father, start, 0.1), strict=True
    ):
        np.testing.assert_allclose(ours, twin, atol=1e-12)
    np.testing.assert_allclose(_kernels.limb_lengths(p, father), np.linalg.norm(p - father, axis=1), atol=1e-12)
    asked = (p, father, axes, most, 0.8, -0.7)
    np.testing.assert_array_equal(_kernels.outside_wedge(*asked), outside_volume_numpy(*asked))


def test_what_is_seen_through_is_contradicted():
    depth = np.full((30, 40), 2.0, np.float32)
    depth[:, 20:] = 1.0
    where = DepthMap(depth, CAMERA, margin=0.02, noise=0.01)
    p = np.array([[-0.2, 0, 1.5], [0.2, 0, 1.5], [-0.2, 0, 1.98], [-9.0, 0, 1.5], [0, 0, -1.0], [-0.1, 0, 2.5]])
    assert contradicted(p, None, where).tolist() == [True, False, False, False, False, False]


def test_a_hole_takes_the_nearest_reading_and_an_empty_map_says_nothing():
    depth = np.zeros((30, 40), np.float32)
    p = np.array([[0.0, 0.0, 1.0]])
    assert not contradicted(p, None, DepthMap(depth, CAMERA)).any()
    depth[15, 25] = 3.0
    assert contradicted(p, None, DepthMap(depth, CAMERA)).all()
    assert not contradicted(p, None, DepthMap(depth, CAMERA, reach=4)).any()


def test_a_limb_is_contradicted_where_the_camera_looks_through_its_middle():
    """A forearm along x at 1.5 m, seen; one deeper by 20 cm, hidden by it; one across, that would have been seen."""
    depth = np.full((30, 40), 2.0, np.float32)
    depth[13:18, 18:31] = 1.46
    where = DepthMap(depth, CAMERA, along=(0.4, 0.6, 0.8, 1.0))
    elbow = np.array([[0.0, 0, 1.5], [0.0, 0, 1.7], [0.0, 0, 1.5]])
    wrist = elbow + np.array([[0.3, 0, 0], [0.3, 0, 0], [0, 0.3, 0]])
    assert contradicted(wrist, elbow, where).tolist() == [False, False, True]
    depth[22:, :] = 1.3  # something before its end, but not before its middle
    assert contradicted(wrist, elbow, where).tolist() == [False, False, True]
    assert not contradicted(wrist, elbow, replace(where, along=(1.0,)))[2]


def test_each_particle_may_have_its_own_elbow():
    p, own = np.array([[0.3, 0, 1.0], [0.3, 0, 1.0]]), np.array([[0.05, 0, 1.0], [0.2, 0, 1.0]])
    found = survivors(p, own, Constraints(Room(ray_caster(WALL, "bvh")), shell=Shell(0.2, 0.3)))
    assert found.alive.tolist() == [True, False] and found.kills.tolist() == [0, 0, 1, 0]


@pytest.mark.parametrize("engine", ["embree", "bvh"])
def test_a_forearm_does_not_go_through_a_wall_nor_closer_than_its_wrist_is_thick(engine):
    room = Room(ray_caster(WALL, engine), start=0.03, clearance=0.02)
    p = np.array([[0.0, 0, 1.9], [0.0, 0, 1.99], [0.0, 0, 2.1], [0.0, 0.5, 1.7]])
    assert collides(p, np.array([0.0, 0, 1.8]), room).tolist() == [False, True, True, False]
    near = np.array([0.0, 0, 1.98])  # an elbow whose own error may put it into the wall
    assert not collides(np.array([[0.0, 0.0, 1.7]]), near, room).any()


@given(turn=st.floats(-3, 3), bend=st.floats(0.4, 3.1), out=st.floats(-1.2, 1.2), half=st.floats(0.05, 1.0))
def test_the_joint_volume_is_a_wedge_about_the_arms_plane(turn, bend, out, half):
    R = Rotation.from_rotvec([turn, 0.3, -turn]).as_matrix()
    upper, normal = R @ [0, 0, -1.0], R @ [0, -1.0, 0]
    inner = np.cross(normal, upper)
    fore = (-math.cos(bend) * upper + math.sin(bend) * inner) * math.cos(out) + math.sin(out) * normal
    volume = JointVolume(upper, normal, (math.radians(20), math.pi), half)
    inside = math.acos(np.clip(-(fore @ upper), -1, 1))
    expected = abs(out) > half or inside < math.radians(20)
    if abs(abs(out) - half) > 1e-6 and abs(inside - math.radians(20)) > 1e-6:
        assert outside_volume(0.3 * fore[None], np.zeros(3), volume)[0] == expected


def test_a_forearm_may_not_fold_to_the_other_side_unless_it_is_nearly_straight():
    volume = volume_at(np.array([0, 0, -2.0]), np.array([0, -1.0, 0.3]), (0.3, math.pi), math.radians(10))
    folded, nearly, inner = (np.array([[math.sin(a), 0, -math.cos(a)]]) for a in (-0.6, -0.1, 0.6))
    found = [outside_volume(fore, np.zeros(3), volume)[0] for fore in (folded, nearly, inner)]
    assert found == [True, False, False]


@settings(deadline=None)
@given(a=DIRECTIONS, b=DIRECTIONS, v=DIRECTIONS)
def test_carrying_along_is_the_least_rotation(a, b, v):
    if np.dot(a, b) / np.linalg.norm(a) / np.linalg.norm(b) < -0.99:
        return
    moved = carried(np.stack([v, a, np.cross(a, b)]), a, b)
    assert np.linalg.norm(moved[0]) == pytest.approx(np.linalg.norm(v))
    np.testing.assert_allclose(moved[1] / np.linalg.norm(a), b / np.linalg.norm(b), atol=1e-9)
    np.testing.assert_allclose(moved[2], np.cross(a, b), atol=1e-9)  # the axis of the least rotation stays


def test_opposite_directions_and_straight_arms_give_no_direction():
    np.testing.assert_array_equal(carried(np.ones(3), np.array([1.0, 0, 0]), np.array([-2.0, 0, 0])), np.ones(3))
    assert plane_normal(np.array([0, 0, -1.0]), np.array([0.1, 0, -1.0])) is None
    found = plane_normal(np.array([0, 0, -1.0]), np.array([1.0, 0, -1.0]))
    assert found is not None
    np.testing.assert_allclose(found, [0, -1, 0])


def test_tests_follow_each_other_and_each_counts_its_own_kills():
    tests = Constraints(
        Room(ray_caster(WALL, "bvh")),
        JointVolume(np.array([0, -1.0, 0]), np.array([1.0, 0, 0]), (0.3, math.pi), 0.2),
        Shell(0.2, 0.3),
        DepthMap(np.full((30, 40), 5.0, np.float32), CAMERA),
    )
    father = np.array([0.0, 0, 1.8])
    way = np.array([[0, 0, 0.25], [0.25, 0, 0], [0, 0, -0.5], [0, 0, -0.25], [0.5, 0, 0.5]])
    found = survivors(father + way, father, tests)
    assert found.kills.tolist() == [2, 1, 1, 1] and not found.alive.any()
    assert survivors(father + way, None, tests).kills.tolist() == [0, 0, 0, 5]
    one = survivors(father + way, father, Constraints(shell=tests.shell), np.array([False, True, True, True, True]))
    assert one.alive.tolist() == [False, True, False, True, False] and one.kills.tolist() == [0, 0, 2, 0]
    assert outside_shell(way, np.zeros(3), Shell(0.2, 0.3)).tolist() == [False, False, True, False, True]
