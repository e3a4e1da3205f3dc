"""Simulated walks: they go where and as people go, and suit and camera err as they are told to."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handtrack.body.anthropometry import measured, sizes_of
from handtrack.body.posture import (
    JOINTS,
    LIMITS,
    PART_JOINTS,
    ROOT,
    body_of,
    keypoints,
    pose_from_segments,
    segment_frames,
)
from handtrack.body.posture_tree import offsets_of
from handtrack.camera import project
from handtrack.errors import InputError
from handtrack.formats.skeletons import KEYPOINTS
from handtrack.formats.walks import SEGMENTS, read_walk
from synth.walk import WalkScene, WalkSettings, make_walk, simulate_walk
from synth.walk_bvh import looped, read_motion, stride_of
from synth.walk_camera import longest_run, place_camera, seen_spans, shown, visible_lengths
from synth.walk_gait import ANKLE, HIP, KNEE, STRIDE, gait, stride_curve
from synth.walk_path import LONG, SHORT, lap, place_at, way_of
from synth.walk_suit import drift_of

CLIPS = Path(__file__).resolve().parents[2] / "shared" / "data" / "body_bvh"
SHORT_WALK = WalkSettings(seconds=40.0)


@pytest.fixture(scope="module")
def scene() -> WalkScene:
    return make_walk(3, WalkSettings(seconds=120.0))


def exact(**changes) -> WalkSettings:
    """A walk whose suit and camera make no error."""
    errors = ("proportions", "looseness", "drop_outs", "outliers", "heading_drift", "start_offset", "start_heading")
    errors += ("calibration", "pelvis_calibration", "orientation_noise")
    zero = dict.fromkeys(errors, 0.0)
    return WalkSettings(
        **{**zero, "seconds": 20.0, "noise": (0.0, 0.0), "drift": (0.0, 0.0), "measured": 0.0, **changes}
    )


def test_the_path_is_a_closed_rectangle_with_round_corners_walked_evenly():
    s = np.linspace(0.0, lap(), 2001)
    xy, heading = place_at(s)
    np.testing.assert_allclose(xy[0], xy[-1], atol=1e-9)
    assert heading[-1] - heading[0] == pytest.approx(2 * math.pi) and (np.diff(heading) >= -1e-12).all()
    assert np.abs(xy).max(axis=0) == pytest.approx([0.5 * LONG, 0.5 * SHORT], abs=1e-3)
    step = np.diff(xy, axis=0) / np.diff(s)[:, None]
    np.testing.assert_allclose(np.linalg.norm(step, axis=1), 1.0, atol=1e-4)
    along = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    assert (np.sum(step * along[:-1], axis=1) > 0.999).all()


def test_a_person_stops_where_told_and_walks_on():
    way = way_of(np.random.default_rng(0), 30.0, 50.0, 1.2, 0.5, np.array([[6.5, 5.0]]))
    still = way.pace < 0.01
    assert still.sum() / 50.0 == pytest.approx(5.0, abs=0.7)
    assert way.s[still].mean() == pytest.approx(6.5, abs=0.05)
    # the way without the stop, less the time of standing and one ramp
    assert way.s[-1] - way.s[0] == pytest.approx(1.2 * (30.0 - 5.0 - 0.8), abs=0.05)


def test_joints_follow_level_walking_and_stay_inside_the_limits(scene):
    phase = np.linspace(0.0, 1.0, 201)
    knee, hip, ankle = (stride_curve(curve, phase) for curve in (KNEE, HIP, ANKLE))
    # Winter 1991: the knee bends some 60 degrees in swing; the hip extends some 10 before the toes leave
    assert knee.max() == pytest.approx(62, abs=3) and 0.65 < phase[knee.argmax()] < 0.8
    assert hip.min() == pytest.approx(-10, abs=2) and ankle.min() < -14
    left, right = (gait(phase, np.ones(201))[:, 3 + JOINTS.index(f"{side}_knee")] for side in ("left", "right"))
    np.testing.assert_allclose(left[:100], right[100:200], atol=1e-12)
    theta = scene.q[:, ROOT:]
    assert (theta >= LIMITS[:, 0]).all() and (theta <= LIMITS[:, 1]).all()


def test_feet_stay_on_the_floor_and_the_head_above(scene):
    points = keypoints(scene.body, scene.q)
    low = points[:, [KEYPOINTS.index("left_ankle"), KEYPOINTS.index("right_ankle")], 2].min(axis=1)
    np.testing.assert_allclose(low, scene.body.sizes.ankle, atol=0.01)
    assert (points[:, KEYPOINTS.index("head"), 2] > 1.4).all()


def test_the_standing_foot_hardly_slides():
    """At 50 frames a second, the lower ankle moves much slower than the pelvis."""
    settings = replace(exact(), fps=50.0, stops=0.0, gestures=0.0)
    made = make_walk(1, settings)
    points = keypoints(made.body, made.q)
    ankles = points[:, [KEYPOINTS.index("left_ankle"), KEYPOINTS.index("right_ankle")]]
    stance = ankles[:, :, 2].argmin(axis=1)[:-1]
    moved = np.linalg.norm(np.diff(ankles[..., :2], axis=0), axis=-1)[np.arange(stance.size), stance]
    assert np.median(moved) * 50.0 < 0.45


def test_without_errors_suit_and_camera_tell_the_truth():
    made = make_walk(2, exact())
    walk = made.walk
    assert walk.truth is not None
    np.testing.assert_allclose(walk.p[:, 0], walk.truth.p, atol=0.02)  # each sample's own few millimetres
    T = segment_frames(made.body, made.q)
    R = Rotation.from_quat(walk.wxyz.reshape(-1, 4), scalar_first=True).as_matrix().reshape(T[..., :3, :3].shape)
    np.testing.assert_allclose(R, T[..., :3, :3], atol=1e-9)
    np.testing.assert_allclose(walk.truth.keypoints, keypoints(made.body, made.q), atol=1e-9)
    seen = walk.confidence > 0
    np.testing.assert_allclose(walk.uv[seen], project(walk.camera, walk.truth.keypoints)[seen], atol=1e-6)
    body = body_of(walk.height, measured(sizes_of(walk.height), walk.measurements))
    np.testing.assert_allclose(pose_from_segments(body, walk.p, walk.wxyz)[:, ROOT:], made.q[:, ROOT:], atol=1e-6)


def test_the_model_follows_the_true_body_to_a_few_centimetres(scene):
    walk = scene.walk
    assert walk.truth is not None
    body = body_of(walk.height, measured(sizes_of(walk.height), walk.measurements))
    q = pose_from_segments(body, walk.p, walk.wxyz)
    turn = Rotation.from_euler("z", -scene.drift.heading[:, None])
    ours = np.stack([turn.apply(p) for p in np.moveaxis(keypoints(body, q) - q[:, None, :3], 1, 0)], axis=1)
    apart = np.linalg.norm(ours - (walk.truth.keypoints - walk.truth.p[:, None]), axis=-1)
    assert np.median(apart) < 0.04 and np.percentile(apart, 95) < 0.12


def test_the_suits_bones_keep_the_lengths_it_was_told(scene):
    walk = scene.walk
    told = offsets_of(measured(sizes_of(walk.height), walk.measurements))
    arm, fore = SEGMENTS.index("left_upper_arm"), SEGMENTS.index("left_forearm")
    apart = np.linalg.norm(walk.p[:, fore] - walk.p[:, arm], axis=1)
    np.testing.assert_allclose(apart, np.linalg.norm(told[fore]), atol=1e-9)


def test_the_drift_grows_to_what_is_wanted_and_mostly_one_way():
    time = np.arange(1501) / 5.0
    settings = WalkSettings(start_offset=0.0)
    drifts = [drift_of(np.random.default_rng(seed), time, settings) for seed in range(30)]
    ends = np.array([np.linalg.norm(drift.place[-1]) for drift in drifts])
    assert np.quantile(ends, 0.1) > 0.45 and np.quantile(ends, 0.9) < 1.6
    straight = np.array([abs(np.corrcoef(d.place[:, 0], d.place[:, 1])[0, 1]) for d in drifts])
    assert np.median(straight) > 0.8
    assert all(np.linalg.norm(d.place[0]) < 0.02 for d in drifts)
    headings = np.degrees([drift.heading[-1] for drift in drifts])
    assert 2.0 < headings.std() < 7.0


def test_a_shorter_walk_drifts_less():
    settings = WalkSettings(start_offset=0.0, drift=(1.0, 1.0), asymmetry=1.0)
    for seconds in (60.0, 300.0):
        drift = drift_of(np.random.default_rng(0), np.arange(0.0, seconds, 0.2), settings)
        assert np.linalg.norm(drift.place[-1]) == pytest.approx(seconds / 300.0, rel=0.02)


def test_the_person_is_in_view_for_the_wanted_share_with_gaps_up_to_the_longest(scene):
    settings = scene.settings
    assert scene.seen.mean() == pytest.approx(settings.in_view, abs=0.02)
    assert 7.0 < longest_run(~scene.seen) / settings.camera_fps <= settings.longest_gap
    assert scene.seen[:5].all()
    assert (scene.walk.confidence[~scene.seen] == 0).all()
    assert (scene.walk.confidence[scene.seen] > 0).mean() > 0.85


def test_keypoints_err_by_the_wanted_pixels_and_confidence_tells_by_how_much():
    made = make_walk(5, replace(SHORT_WALK, seconds=100.0, outliers=0.0))
    walk = made.walk
    assert walk.truth is not None
    error = np.linalg.norm(walk.uv - project(walk.camera, walk.truth.keypoints), axis=-1) / math.sqrt(2.0)
    seen = walk.confidence > 0
    sigma = math.sqrt(np.mean(error[seen] ** 2))
    assert 4.0 < sigma < 8.0
    sure, unsure = seen & (walk.confidence > 0.9), seen & (walk.confidence < 0.6)
    assert np.mean(error[sure] ** 2) < 0.8 * np.mean(error[unsure] ** 2)


def test_keypoints_found_lie_inside_the_image(scene):
    uv = scene.walk.uv[scene.walk.confidence > 0]
    assert (uv >= -0.5).all() and (uv <= np.array([1280, 720]) - 0.5).all()


def test_the_camera_sees_a_part_of_the_laps():
    for share in (0.4, 0.7, 1.0):
        camera = place_camera(np.random.default_rng(0), share, WalkSettings())
        xy, _ = place_at(np.linspace(0.0, lap(), 500))
        seen = shown(camera, np.column_stack([xy, np.full(500, 0.9)]), 20.0)
        assert seen.mean() == pytest.approx(share, abs=0.12)
        assert camera.R @ np.array([0.0, 0.0, -1.0]) @ np.array([0.0, 1.0, 0.0]) > 0.9  # upright
        assert visible_lengths(camera, 1.75).size


def test_no_view_of_the_path_leaves_every_place_to_start_from():
    camera = place_camera(np.random.default_rng(0), 1.0, WalkSettings())
    behind = replace(camera, R=camera.R * np.array([[-1.0], [1.0], [-1.0]]))
    assert visible_lengths(replace(behind, t=camera.t * [-1, 1, -1]), 1.75).size == 120


def test_spans_are_taken_away_only_as_far_as_the_longest_gap_allows():
    rng = np.random.default_rng(1)
    seen = seen_spans(rng, np.ones(600, dtype=bool), 5.0, 0.5, 3.0)
    assert longest_run(~seen) <= 15 and seen.mean() == pytest.approx(0.5, abs=0.02)
    hidden = np.arange(600) % 100 < 20
    np.testing.assert_array_equal(seen_spans(rng, hidden, 5.0, 0.6, 30.0), hidden)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_another_walk(tmp_path):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        simulate_walk(tmp_path / name, seed, replace(SHORT_WALK, seconds=8.0))
    for name in ("walk.yaml", "segments.csv", "keypoints2d.csv", "truth.csv", "truth_keypoints.csv"):
        contents = [(tmp_path / folder / name).read_bytes() for folder in "abc"]
        assert contents[0] == contents[1] != contents[2]


def test_a_written_walk_reads_back_with_its_missing_samples(tmp_path):
    settings = replace(
        SHORT_WALK, missing=0.2, camera_fps=8.0, jitter=0.01, measured=None, distortion=(0.05, 0.0, 0.0, 0.0, 0.0)
    )
    made = simulate_walk(tmp_path / "walk", 4, settings)
    walk = read_walk(tmp_path / "walk")
    assert walk.warnings == () and walk.measurements == ()
    assert walk.time.size == 201 and walk.camera_time.size == 321
    lost = np.asarray(np.isnan(walk.p).any(axis=(1, 2)))
    assert 0.1 < lost.mean() < 0.3 and not lost[[0, -1]].any()
    np.testing.assert_allclose(walk.p, made.walk.p, atol=1e-8)
    np.testing.assert_allclose(walk.uv, made.walk.uv, rtol=1e-8, atol=1e-8)
    assert 0.001 < np.std(np.diff(walk.camera_time)) < 0.05 and walk.camera.distortion[0] == 0.05


def test_hands_move_while_standing(scene):
    pace = np.gradient(scene.lap, scene.walk.time) * lap()
    still = np.flatnonzero(pace < 0.05)
    assert still.size > 20
    elevation = scene.q[:, ROOT + PART_JOINTS[1]], scene.q[:, ROOT + PART_JOINTS[2]]
    moved = max(np.ptp(arm[still, 0]) for arm in elevation)
    assert moved > math.radians(25)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seconds": 0.0}, "seconds: got 0.0, wanted 2.0 to 36000"),
        ({"in_view": 1.5}, "in_view: got 1.5"),
        ({"noise": (8.0, 4.0)}, "noise: got"),
        ({"drift": (-1.0, 4.0)}, "drift: got"),
        ({"measured": 2.0}, "measured: got 2.0"),
        ({"jitter": 0.05}, "jitter: got 0.05"),
    ],
)
def test_settings_out_of_range_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        WalkSettings(**changes)


PARTS_OF_BVH = (
    ("Hip", "Knee", "Ankle", "Toe", "Shoulder", "Elbow", "Wrist"),
    ("UpLeg", "Leg", "Foot", "ToeBase", "Arm", "ForeArm", "Hand"),
)


def bvh_of(q, path, names, up="z", rate=30.0):
    """A BVH file with a position for every joint: the places that a body has in these poses."""
    body = body_of(1.75)
    points, T = keypoints(body, q), segment_frames(body, q)
    columns = [("Hips", 0.5 * (points[:, 6] + points[:, 7])), ("Neck", T[:, 2, :3, 3]), ("Head", points[:, 15])]
    for k, side in enumerate(("Left", "Right")):
        toe = T[:, 9 + 3 * k, :3, 3] + body.sizes.foot * T[:, 9 + 3 * k, :3, 0]
        places = (points[:, 6 + k], points[:, 8 + k], points[:, 10 + k], toe)
        places += (points[:, k], points[:, 2 + k], points[:, 4 + k])
        columns += [(f"{side}{name}", place) for name, place in zip(names, places, strict=True)]
    head = ["HIERARCHY", f"ROOT {columns[0][0]}", "{"]
    position = "CHANNELS 3 Xposition Yposition Zposition"
    head += ["OFFSET 0 0 0", position]
    for name, _ in columns[1:]:
        head += [f"JOINT {name}", "{", "OFFSET 0 0 0", position, "}"]
    head += ["}", "MOTION", f"Frames: {q.shape[0]}", f"Frame Time: {1.0 / rate}"]
    root = columns[0][1]
    p = np.stack([root, *(place - root for _, place in columns[1:])], axis=1)
    if up == "y":
        p = p[..., [1, 2, 0]]
    head += [" ".join(f"{value:.6f}" for value in row) for row in 100.0 * p.reshape(q.shape[0], -1)]
    path.write_text("\n".join(head) + "\n")


@pytest.mark.parametrize(("names", "up"), [(PARTS_OF_BVH[0], "y"), (PARTS_OF_BVH[1], "z")])
def test_a_recorded_stride_comes_back_from_the_places_of_its_joints(tmp_path, names, up):
    phase = np.arange(90) / 30.0 / 1.2
    swing = gait(phase, np.ones(90))
    swing[:, 1:3], swing[:, 4:6] = 0.0, 0.0  # what hips and shoulders alone do not tell apart
    q = np.concatenate([np.zeros((90, 6)), swing[:, 3:]], axis=1)
    q[:, 3] = swing[:, 0]
    q[:, 0] = STRIDE * phase
    bvh_of(q, tmp_path / "walk.bvh", names, up)
    body = body_of(1.75)
    recorded = read_motion(tmp_path / "walk.bvh", body)
    leg = body.sizes.thigh + body.sizes.shank
    assert recorded.travel * leg == pytest.approx(q[-1, 0], rel=0.05)
    for name in ("left_knee", "right_hip_flexion", "left_elbow", "right_shoulder_flexion"):
        k = JOINTS.index(name)
        np.testing.assert_allclose(recorded.theta[:, k], swing[:, 3 + k], atol=math.radians(3.0), err_msg=name)
    stride = stride_of(recorded, leg)
    assert stride is not None and stride.shape[0] == pytest.approx(37, abs=1)
    np.testing.assert_allclose(stride[0], stride[-1], atol=1e-12)
    made = make_walk(0, replace(SHORT_WALK, motion=tmp_path / "walk.bvh"))
    assert np.degrees(np.ptp(made.q[:, ROOT + JOINTS.index("left_knee")])) > 45.0


def test_a_recording_that_stands_gives_its_arms(tmp_path):
    q = np.zeros((30, 26))
    q[:, ROOT + JOINTS.index("left_shoulder_elevation")] = np.radians(np.linspace(-85, 20, 30))
    bvh_of(q, tmp_path / "arms.bvh", PARTS_OF_BVH[0])
    made = make_walk(1, replace(SHORT_WALK, gestures=10.0, motion=tmp_path / "arms.bvh"))
    raised = made.q[:, ROOT + JOINTS.index("left_shoulder_elevation")]
    assert raised.max() > math.radians(-40) and stride_of(read_motion(tmp_path / "arms.bvh", made.body), 0.86) is None


@pytest.mark.skipif(not CLIPS.is_dir(), reason="the recorded clips are not here")
@pytest.mark.parametrize("name", ["bvh_test1", "bvh_test2", "bvh_test3"])
def test_recorded_clips_of_several_systems_stay_inside_the_limits(name):
    recorded = read_motion(CLIPS / f"{name}.bvh", body_of(1.75))
    assert (recorded.theta >= LIMITS[:, 0] - 1e-9).all() and (recorded.theta <= LIMITS[:, 1] + 1e-9).all()
    assert np.abs(np.degrees(recorded.theta[:, [JOINTS.index("left_knee"), JOINTS.index("left_elbow")]])).max() < 90


def test_a_recording_that_is_too_short_or_lacks_a_joint_is_refused(tmp_path):
    bvh_of(np.zeros((5, 26)), tmp_path / "short.bvh", PARTS_OF_BVH[0])
    with pytest.raises(InputError, match="has 5 frames; at least 10"):
        read_motion(tmp_path / "short.bvh", body_of(1.75))
    bvh_of(np.zeros((12, 26)), tmp_path / "odd.bvh", ("Hip", "Knee", "Ankle", "Toe", "Shoulder", "Elbow", "Paw"))
    with pytest.raises(InputError, match="no joint is called LeftHand or LeftWrist"):
        read_motion(tmp_path / "odd.bvh", body_of(1.75))


def test_a_walk_of_too_few_strides_is_no_walk(tmp_path):
    q = np.zeros((20, 26))
    q[:, 0] = np.linspace(0.0, 1.5, 20)
    bvh_of(q, tmp_path / "slide.bvh", PARTS_OF_BVH[0])
    assert stride_of(read_motion(tmp_path / "slide.bvh", body_of(1.75)), 0.86) is None


def test_a_cycle_is_played_on_and_on():
    cycle = np.array([[0.0], [2.0], [0.0]])
    np.testing.assert_allclose(looped(cycle, np.array([0.25, 1.25, 7.5])), [[1.0], [1.0], [2.0]])
