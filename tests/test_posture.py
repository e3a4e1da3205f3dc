"""The body of 13 segments and 20 joints: its frames, keypoints, limits, files and the way back from segments."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handtrack._kernels import posture as kernels
from handtrack.body.anthropometry import Sizes, measured, sizes_of
from handtrack.body.posture import (
    JOINTS,
    PART_JOINTS,
    PARTS,
    ROOT,
    Body,
    body_of,
    chain_frames,
    chain_frames_numpy,
    heading_first,
    keypoints,
    part_frames,
    pelvis_numbers,
    pelvis_turn,
    points_on,
    points_on_numpy,
    pose_from_segments,
    segment_frames,
)
from handtrack.body.posture_tree import PARENT, PART_SEGMENTS
from handtrack.body.suit_body import body_of_walk, sizes_from_segments
from handtrack.formats.model_writing import write_model
from handtrack.formats.models import read_model
from handtrack.formats.skeletons import KEYPOINTS
from handtrack.formats.urdf import export_urdf
from handtrack.formats.walks import SEGMENTS
from handtrack.kinematics import forward, forward_numpy
from synth.walk import WalkSettings, make_walk

BODY = body_of(1.8)


def poses(count: int, seed: int = 0, body: Body = BODY) -> np.ndarray:
    """Poses inside the limits, with the pelvis anywhere; its pitch short of a right angle."""
    rng = np.random.default_rng(seed)
    root = rng.uniform(-1.0, 1.0, (count, ROOT)) * [5.0, 5.0, 1.0, math.pi, 1.2, math.pi]
    return np.concatenate([root, rng.uniform(body.limits[:, 0], body.limits[:, 1], (count, len(JOINTS)))], axis=1)


def quaternions(frames: np.ndarray) -> np.ndarray:
    turn = Rotation.from_matrix(frames[..., :3, :3].reshape(-1, 3, 3))
    return turn.as_quat(scalar_first=True).reshape(*frames.shape[:2], 4)


def at(points: np.ndarray, name: str) -> np.ndarray:
    return points[0, KEYPOINTS.index(name)]


def single(**angles: float) -> np.ndarray:
    """A pose with the named joints at so many degrees, and all others at zero."""
    q = np.zeros((1, ROOT + len(JOINTS)))
    for name, value in angles.items():
        q[0, ROOT + JOINTS.index(name)] = math.radians(value)
    return q


def test_there_are_13_segments_20_revolute_joints_and_a_free_pelvis_in_five_parts_of_four_joints():
    assert (len(SEGMENTS), len(JOINTS), len(PARTS)) == (13, 20, 5)
    assert not BODY.model.prismatic[BODY.model.joint >= 3].any() and BODY.model.prismatic.sum() == 3
    assert sorted(np.concatenate(PART_JOINTS).tolist()) == list(range(20))
    assert sorted(sum(PART_SEGMENTS, ())) == list(range(1, 13))


def test_the_neutral_pose_has_all_axes_along_the_worlds_and_the_arms_out():
    T = segment_frames(BODY, np.zeros((1, 26)))
    np.testing.assert_allclose(T[0, :, :3, :3], np.broadcast_to(np.eye(3), (13, 3, 3)), atol=1e-15)
    points = keypoints(BODY, np.zeros((1, 26)))
    sizes = BODY.sizes
    assert at(points, "left_wrist")[1] == pytest.approx(sizes.shoulder + sizes.upper_arm + sizes.forearm)
    np.testing.assert_allclose(at(points, "right_wrist"), at(points, "left_wrist") * [1, -1, 1], atol=1e-15)
    assert at(points, "left_ankle")[2] == pytest.approx(-(sizes.thigh + sizes.shank))


@pytest.mark.parametrize(
    ("joint", "degrees", "point", "axis", "sign"),
    [
        ("trunk_flexion", 40, "head", 0, 1),  # bowing brings the head forward
        ("trunk_bending", 20, "head", 1, -1),  # to the right
        ("trunk_rotation", 30, "left_shoulder", 0, -1),  # turning to the left takes the left shoulder back
        ("neck_flexion", 30, "head", 0, 1),
        ("left_elbow", 90, "left_wrist", 0, 1),
        ("right_elbow", 90, "right_wrist", 0, 1),
        ("left_shoulder_elevation", 60, "left_wrist", 2, 1),
        ("right_shoulder_elevation", 60, "right_wrist", 2, 1),
        ("left_hip_flexion", 50, "left_knee", 0, 1),
        ("right_hip_flexion", 50, "right_knee", 0, 1),
        ("left_hip_abduction", 30, "left_knee", 1, 1),
        ("right_hip_abduction", 30, "right_knee", 1, -1),
        ("left_knee", 60, "left_ankle", 0, -1),
        ("right_knee", 60, "right_ankle", 0, -1),
    ],
)
def test_a_positive_angle_moves_the_body_as_its_name_says(joint, degrees, point, axis, sign):
    moved = at(keypoints(BODY, single(**{joint: degrees})), point) - at(keypoints(BODY, np.zeros((1, 26))), point)
    assert sign * moved[axis] > 0.02


@pytest.mark.parametrize(("side", "outward"), [("left", 1), ("right", -1)])
def test_a_hanging_arm_swings_forward_and_its_bent_forearm_turns_outward(side, outward):
    hanging = {f"{side}_shoulder_elevation": -90.0}
    low = at(keypoints(BODY, single(**hanging)), f"{side}_wrist")
    ahead = at(keypoints(BODY, single(**hanging, **{f"{side}_shoulder_flexion": 30.0})), f"{side}_wrist")
    assert ahead[0] > low[0] + 0.2
    bent = single(**hanging, **{f"{side}_elbow": 90.0})
    turned = single(**hanging, **{f"{side}_elbow": 90.0, f"{side}_shoulder_rotation": 30.0})
    apart = at(keypoints(BODY, turned), f"{side}_wrist") - at(keypoints(BODY, bent), f"{side}_wrist")
    assert outward * apart[1] > 0.05 and abs(apart[2]) < 1e-9


def test_lifted_toes_are_a_positive_ankle():
    toes = segment_frames(BODY, single(left_ankle=15.0))[0, SEGMENTS.index("left_foot"), :3, 0]
    assert toes[2] > 0.2


def test_the_kernel_the_numpy_twin_and_the_tree_of_denavit_and_hartenberg_agree():
    q = poses(40)
    T = segment_frames(BODY, q)
    np.testing.assert_allclose(T, chain_frames_numpy(BODY.whole, q), atol=1e-13)
    np.testing.assert_allclose(T, forward(BODY.model, q)[:, BODY.frame], atol=1e-13)
    np.testing.assert_allclose(T, forward_numpy(BODY.model, q)[:, BODY.frame], atol=1e-13)
    assert BODY.model.joint_names[ROOT:] == JOINTS


def test_sines_and_cosines_are_exact_to_rounding_at_every_quadrant_and_far_away():
    angles = np.concatenate([np.arange(-40, 41) * math.pi / 4, np.random.default_rng(0).uniform(-1e4, 1e4, 2000)])
    sine, cosine = np.empty_like(angles), np.empty_like(angles)
    kernels.sines(angles, sine, cosine)
    np.testing.assert_allclose(sine, np.sin(angles), atol=5e-16)
    np.testing.assert_allclose(cosine, np.cos(angles), atol=5e-16)


def test_points_on_segments_are_those_of_plain_numpy():
    T = segment_frames(BODY, poses(7))
    args = T, BODY.keypoint_segment, BODY.keypoint_local
    np.testing.assert_allclose(points_on(*args), points_on_numpy(*args), atol=1e-14)


def test_one_pose_in_a_batch_is_that_pose_alone():
    q = poses(5)
    np.testing.assert_array_equal(segment_frames(BODY, q)[3], segment_frames(BODY, q[3:4])[0])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_bones_keep_their_lengths_and_frames_stay_rotations(seed):
    T = segment_frames(BODY, poses(3, seed))
    R = T[..., :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-13)
    for i, above in enumerate(PARENT):
        if above >= 0:
            apart = np.linalg.norm(T[:, i, :3, 3] - T[:, above, :3, 3], axis=1)
            np.testing.assert_allclose(apart, np.linalg.norm(BODY.whole.offset[i]), atol=1e-12)


@pytest.mark.parametrize("part", range(5))
def test_a_part_alone_is_that_part_seen_from_its_root(part):
    q = poses(6, part)
    T = segment_frames(BODY, q)
    first, *_ = PART_SEGMENTS[part]
    root = T[:, PARENT[first]].copy()
    root[:, :3, 3] = T[:, first, :3, 3]
    expected = np.linalg.inv(root)[:, None] @ T[:, PART_SEGMENTS[part]]
    np.testing.assert_allclose(part_frames(BODY, part, q[:, ROOT + PART_JOINTS[part]]), expected, atol=1e-12)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_joint_angles_come_back_from_the_segments_of_the_same_body(seed):
    q = poses(4, seed)
    T = segment_frames(BODY, q)
    back = pose_from_segments(BODY, T[..., :3, 3], quaternions(T))
    np.testing.assert_allclose(segment_frames(BODY, back), T, atol=1e-9)
    np.testing.assert_allclose(back[:, ROOT:], q[:, ROOT:], atol=1e-6)


def test_angles_from_a_suit_with_more_joints_stay_inside_the_limits_and_near_its_wrists():
    q = poses(200, 3)
    T = segment_frames(BODY, q)
    rng = np.random.default_rng(1)
    loose = (
        Rotation.from_rotvec(np.radians(4.0) * rng.standard_normal((200 * 13, 3))).as_matrix().reshape(200, 13, 3, 3)
    )
    T[..., :3, :3] = T[..., :3, :3] @ loose
    back = pose_from_segments(BODY, T[..., :3, 3], quaternions(T))
    theta = back[:, ROOT:]
    assert (theta >= BODY.limits[:, 0] - 1e-12).all() and (theta <= BODY.limits[:, 1] + 1e-12).all()
    wrist = T[:, 4, :3, 3] + T[:, 4, :3, :3] @ BODY.end[4] - T[:, 3, :3, 3]
    found = keypoints(BODY, back)
    ours = found[:, KEYPOINTS.index("left_wrist")] - found[:, KEYPOINTS.index("left_shoulder")]
    assert np.median(np.linalg.norm(ours - wrist, axis=1)) < 0.08


def test_a_bent_forearm_tells_how_the_upper_arm_turns():
    """The upper arm says it has not turned about itself; the forearm, bent by a right angle, says 40 degrees."""
    T = segment_frames(BODY, single(left_shoulder_elevation=-90, left_elbow=90))
    turned = segment_frames(BODY, single(left_shoulder_elevation=-90, left_elbow=90, left_shoulder_rotation=40))
    T[:, 4] = turned[:, 4]
    back = pose_from_segments(BODY, T[..., :3, 3], quaternions(T))
    assert math.degrees(back[0, ROOT + JOINTS.index("left_shoulder_rotation")]) == pytest.approx(40, abs=8)


def test_a_change_of_heading_adds_to_the_yaw():
    q = poses(3)
    turn = Rotation.from_euler("z", 0.3) * pelvis_turn(q)
    numbers = pelvis_numbers(q[:, :3], turn)
    apart = (numbers[:, 3] - q[:, 3] - 0.3 + math.pi) % (2 * math.pi) - math.pi
    np.testing.assert_allclose(apart, 0.0, atol=1e-12)
    np.testing.assert_allclose(numbers[:, 4:], q[:, 4:6], atol=1e-12)


def test_sizes_grow_with_height_and_single_measurements_replace_them():
    assert sizes_of(2.0).thigh == pytest.approx(2.0 * sizes_of(1.0).thigh)
    # hip and shoulder heights of Winter 2009, Figure 4.1
    assert sizes_of(1.0).hip_height == pytest.approx(0.530)
    assert sizes_of(1.0).hip_height + sizes_of(1.0).lumbar + sizes_of(1.0).trunk == pytest.approx(0.818)
    long = body_of(1.8, measured(sizes_of(1.8), [("forearm", 0.31)]))
    points = keypoints(long, np.zeros((1, 26)))
    assert at(points, "left_wrist")[1] - at(points, "left_elbow")[1] == pytest.approx(0.31)


@pytest.mark.parametrize("height", [0.3, 3.0, math.nan])
def test_a_height_that_cannot_be_is_refused(height):
    with pytest.raises(ValueError, match=r"height: got .* wanted 0\.5 to 2\.5 m"):
        body_of(height)


def test_a_length_that_cannot_be_and_an_unknown_one_are_refused():
    with pytest.raises(ValueError, match="thigh: got -1"):
        replace(sizes_of(1.8), thigh=-1.0)
    with pytest.raises(ValueError, match="'tail' is unknown; wanted: hip, shoulder"):
        measured(sizes_of(1.8), [("tail", 0.4)])


def test_a_pose_of_another_width_is_refused():
    with pytest.raises(ValueError, match="q: has 4 columns; wanted 26"):
        chain_frames(BODY.whole, np.zeros((2, 4)))


def test_the_body_comes_back_from_its_model_file(tmp_path):
    write_model(tmp_path / "body.yaml", BODY.model)
    again = read_model(tmp_path / "body.yaml")
    q = poses(4)
    np.testing.assert_allclose(forward(again, q), forward(BODY.model, q), atol=1e-9)


def test_pills_lie_along_the_segments():
    base, tip = BODY.model.link_base, BODY.model.link_tip
    np.testing.assert_allclose(tip - base, BODY.end, atol=1e-12)
    assert (BODY.model.link_radius > 0).all() and len(fields(Sizes)) == 12


@pytest.mark.filterwarnings("ignore")  # of the packages that yourdfpy stands on
def test_another_reader_of_the_exported_urdf_finds_the_same_transforms():
    yourdfpy = pytest.importorskip("yourdfpy")
    import io

    urdf = yourdfpy.URDF.load(io.StringIO(export_urdf(BODY.model)), build_scene_graph=True, load_meshes=False)
    assert set(urdf.actuated_joint_names) == set(BODY.model.joint_names)
    q = poses(3, 5)
    q[:, :3] /= 10.0
    T = segment_frames(BODY, q)
    for values, expected in zip(q, T, strict=True):
        urdf.update_cfg(dict(zip(BODY.model.joint_names, values.tolist(), strict=True)))
        for i in range(len(SEGMENTS)):
            found = urdf.get_transform(f"frame_{100 * (i + 1)}", "frame_0")
            np.testing.assert_allclose(found, expected[i], atol=1e-9)


def test_the_batch_is_timed_beside_its_twin_and_beside_pinocchio_where_that_is():
    from importlib.util import find_spec

    from handtrack.cli.posture_timings import posture

    plain, *others = posture(3)
    assert plain.ratio is not None and plain.ratio > 3.0
    assert len(others) == (find_spec("pinocchio") is not None)
    assert all(other.twin_ms is not None and other.twin_ms > 0.0 for other in others)


def test_a_suit_tells_the_lengths_of_its_wearer_and_measurements_come_first():
    rng = np.random.default_rng(4)
    average = sizes_of(1.7)
    true = replace(average, **{f.name: getattr(average, f.name) * rng.uniform(0.9, 1.1) for f in fields(Sizes)})
    T = segment_frames(body_of(1.7, true), poses(9))
    p, wxyz = T[..., :3, 3].copy(), quaternions(T)
    p[3], wxyz[5, 2] = np.nan, np.nan  # lost samples do not matter
    found = sizes_from_segments(average, p, wxyz)
    for name in ("hip", "shoulder", "lumbar", "trunk", "neck", "upper_arm", "thigh", "shank"):
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=1e-9), name
    limbs = [getattr(true, name) / getattr(average, name) for name in ("upper_arm", "thigh", "shank")]
    assert found.forearm / average.forearm == pytest.approx(np.mean(limbs))
    walk = make_walk(0, WalkSettings(seconds=4.0)).walk
    body = body_of_walk(replace(walk, measurements=(("forearm", 0.3),)))
    assert body.sizes.forearm == 0.3 and body.sizes.thigh == pytest.approx(dict(walk.measurements)["thigh"])


def test_a_suit_without_a_whole_sample_or_with_origins_in_one_place_tells_no_lengths():
    none = np.full((2, 13, 3), np.nan), np.full((2, 13, 4), np.nan)
    assert sizes_from_segments(sizes_of(1.7), *none) == sizes_of(1.7)
    still = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (2, 13, 4)).copy()
    assert sizes_from_segments(sizes_of(1.7), np.zeros((2, 13, 3)), still) == sizes_of(1.7)


@given(st.integers(0, 10_000))
def test_heading_first_reads_a_rotation_as_scipy_does(seed):
    turn = Rotation.random(rng=np.random.default_rng(seed))
    np.testing.assert_allclose(
        heading_first(turn.as_matrix()), pelvis_numbers(np.zeros((1, 3)), turn)[0, 3:], atol=1e-9
    )
