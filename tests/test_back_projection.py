"""Pixels and depth to places: thin arms, holes, skin; hips from world landmarks; several views and a reference."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handtrack.body.back_projection import DepthSettings, back_project, detections_in_depth, near_depth
from handtrack.body.triangulated import agreement, lifted, reference_of, triangulate
from handtrack.body.world_landmarks import detections_by_world, hips_of
from handtrack.camera import Camera, camera_from_world, perspective, project
from handtrack.errors import InputError
from handtrack.formats.calibrations import read_calibration
from handtrack.formats.markers import Markers, read_markers
from handtrack.formats.openpose import read_openpose
from handtrack.formats.poses2d import COCO_17, MEDIAPIPE_33, Poses2d, to_keypoints
from handtrack.formats.skeletons import KEYPOINTS, LOST, TRACKED

DATA = Path(__file__).parents[2] / "shared" / "data" / "body_openpose"
TRIAL = DATA / "S00_P00_SingleParticipant" / "S00_P00_T01_BalancingTrial"
NO_SKIN = DepthSettings(offset=0.0)


def camera(width=160, height=120, **changes) -> Camera:
    bend = changes.get("distortion")
    return perspective(width, height, 150.0, 152.0, 80.0, 59.0, np.eye(3), np.zeros(3), bend)


def one(x, y):
    return np.array([[[float(x), float(y)]]])


# --- depth images


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_points_of_a_tilted_wall_come_back(seed):
    rng = np.random.default_rng(seed)
    eye = camera(distortion=np.array([0.02, -0.01, 0.001, -0.001, 0.0]))
    p = np.column_stack([rng.uniform(-0.3, 0.3, (8, 2)), rng.uniform(1.0, 3.0, 8)])
    for point in p:
        uv = project(eye, point[None])[None]
        found = back_project(uv, np.full((120, 160), point[2]), eye, NO_SKIN)
        np.testing.assert_allclose(found[0, 0], point, atol=1e-9)


def test_the_joint_lies_deeper_along_the_ray():
    depth = np.full((120, 160), 2.0, dtype=np.float32)
    skin = back_project(one(20, 30), depth, camera(), NO_SKIN)[0, 0]
    joint = back_project(one(20, 30), depth, camera())[0, 0]
    np.testing.assert_allclose(joint - skin, 0.035 * skin / np.linalg.norm(skin), atol=1e-12)


def arm_before_wall(thick=3):
    """An arm, `thick` pixels wide, a metre before a wall."""
    depth = np.full((120, 160), 3.0)
    depth[60 : 60 + thick] = 2.0
    return depth


def test_a_keypoint_beside_a_thin_arm_still_lies_on_it():
    for row in (58, 60, 61, 64):
        assert back_project(one(70, row), arm_before_wall(), camera(), NO_SKIN)[0, 0, 2] == 2.0
    assert back_project(one(70, 40), arm_before_wall(), camera(), NO_SKIN)[0, 0, 2] == 3.0
    own = DepthSettings(window=0, offset=0.0)
    assert back_project(one(70, 58), arm_before_wall(), camera(), own)[0, 0, 2] == 3.0


def test_a_few_flying_pixels_are_no_body():
    depth = np.full((120, 160), 3.0)
    depth[59:61, 70] = 1.0
    assert back_project(one(70, 60), depth, camera(), NO_SKIN)[0, 0, 2] == 3.0


def test_the_depth_is_the_median_of_the_near_cluster():
    rng = np.random.default_rng(0)
    depth = np.where(np.arange(120)[:, None] < 60, 1.5 + 0.02 * rng.standard_normal((120, 160)), 2.4)
    window = depth[56:60, 66:75]
    found = near_depth(np.array([[70.0, 60.0]]), depth, DepthSettings(gap=0.3))
    assert found[0] == pytest.approx(np.median(window))


def test_holes_are_filled_from_around_and_stay_holes_where_they_are_large():
    depth = np.full((120, 160), 2.0)
    depth[58:63, 68:73] = 0.0
    assert back_project(one(70, 60), depth, camera(), NO_SKIN)[0, 0, 2] == 2.0
    depth[40:80, 50:90] = 0.0
    assert np.isnan(back_project(one(70, 60), depth, camera())).all()
    for bad in (np.nan, np.inf, -1.0, 20.0, 0.1):
        assert np.isnan(back_project(one(70, 60), np.full((120, 160), bad), camera())).all()


def test_what_is_unseen_or_off_the_image_has_no_place():
    depth = np.full((120, 160), 2.0)
    uv = np.array([[[np.nan, np.nan], [-50.0, 60.0], [1e9, -1e9], [0.0, 0.0]]])
    found = back_project(uv, depth, camera())
    assert np.isnan(found[0, :3]).all() and np.isfinite(found[0, 3]).all()
    assert back_project(np.zeros((0, 4, 2)), depth, camera()).shape == (0, 4, 3)


def made_poses(uv, names=COCO_17, frames=2, world=None) -> Poses2d:
    d = uv.shape[0]
    seen = ~np.isnan(uv[..., 0])
    return Poses2d(
        np.arange(frames) / 30.0, np.arange(d), np.zeros(d, dtype=int), uv, np.where(seen, 0.7, 0.0), names, world,
        warnings=("told",),
    )  # fmt: skip


def test_a_recording_keeps_its_confidences_and_loses_what_has_no_depth():
    rng = np.random.default_rng(1)
    poses = made_poses(rng.uniform(20, 100, (2, 17, 2)))
    near, none = np.full((120, 160), 2.0), np.zeros((120, 160))
    found = detections_in_depth(poses, iter([near, none]), camera())
    assert found.confidence[0, :12].tolist() == [0.7] * 12 and (found.state[0, :12] == TRACKED).all()
    assert np.isnan(found.p[1]).all() and not found.confidence[1].any() and (found.state[1] == LOST).all()
    assert found.warnings == ("told",) and np.isfinite(found.p[0, KEYPOINTS.index("root")]).all()
    with pytest.raises(ValueError, match="got 1 images, wanted 2"):
        detections_in_depth(poses, [near], camera())


def test_bad_depth_arguments_are_named():
    with pytest.raises(ValueError, match=r"depth: got \(3, 4\), wanted \(120, 160\)"):
        back_project(one(1, 1), np.zeros((3, 4)), camera())
    with pytest.raises(ValueError, match="window: got -1, wanted 0 to 100"):
        DepthSettings(window=-1)
    with pytest.raises(ValueError, match=r"farthest: got 0\.2, wanted more than nearest"):
        DepthSettings(farthest=0.2)


# --- world landmarks


def a_person(rng):
    return rng.normal(0.0, 0.4, (33, 3))


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_hips_are_found_from_places_and_pixels(seed):
    rng = np.random.default_rng(seed)
    eye = camera(distortion=np.array([0.02, 0.0, 0.0, 0.0, 0.0]))
    world = np.stack([a_person(rng), a_person(rng)])
    hips = np.column_stack([rng.uniform(-0.5, 0.5, (2, 2)), rng.uniform(2.5, 4.0, 2)])
    uv = project(eye, world + hips[:, None])
    sure = rng.uniform(0.2, 1.0, (2, 33))
    np.testing.assert_allclose(hips_of(world, uv, sure, eye), hips, atol=1e-6)


def test_a_recording_with_world_landmarks_needs_no_depth():
    rng = np.random.default_rng(4)
    world = a_person(rng)[None]
    uv = project(camera(), world + np.array([0.1, 0.2, 3.0]))
    uv[0, MEDIAPIPE_33.index("left_wrist")] = np.nan
    found = detections_by_world(made_poses(uv, MEDIAPIPE_33, 1, world), camera())
    assert np.isnan(found.p[0, KEYPOINTS.index("left_wrist")]).all()
    expected = world[0, MEDIAPIPE_33.index("right_wrist")] + [0.1, 0.2, 3.0]
    np.testing.assert_allclose(found.p[0, KEYPOINTS.index("right_wrist")], expected, atol=1e-9)


def test_too_few_keypoints_or_no_world_place_nobody():
    world, uv = np.full((1, 33, 3), np.nan), np.full((1, 33, 2), np.nan)
    world[0, :3], uv[0, :3] = np.eye(3), 50.0
    assert np.isnan(hips_of(world, uv, np.ones((1, 33)), camera())).all()
    with pytest.raises(ValueError, match="have no world landmarks"):
        detections_by_world(made_poses(uv, MEDIAPIPE_33, 1), camera())


# --- several views


def ring(count=4) -> list[Camera]:
    out = []
    for i in range(count):
        R = Rotation.from_euler("y", 360.0 * i / count, degrees=True).as_matrix()
        out.append(perspective(640, 480, 500.0, 500.0, 320.0, 240.0, R, np.array([0.0, 0.0, 3.0])))
    return out


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_views_of_points_give_the_points_and_a_wrong_view_is_left_out(seed):
    rng = np.random.default_rng(seed)
    views, x = ring(), rng.uniform(-0.6, 0.6, (9, 3))
    uv = np.stack([project(view, x) for view in views])
    found, used = triangulate(views, uv, np.ones((4, 9)))
    np.testing.assert_allclose(found, x, atol=1e-8)
    assert used.all()
    uv[1, 2] += [90.0, 60.0]
    uv[3, 5] = np.nan
    found, used = triangulate(views, uv, np.ones((4, 9)))
    np.testing.assert_allclose(found, x, atol=1e-8)
    assert not used[1, 2] and not used[3, 5] and used.sum() == 34
    uv[:2] = np.nan
    assert triangulate(views, uv, np.ones((4, 9)), miss=1e-9)[1].sum() == 17  # two views are never made one


def test_one_view_places_nothing():
    uv = np.full((4, 1, 2), np.nan)
    uv[0] = 100.0
    found, used = triangulate(ring(), uv, np.ones((4, 1)))
    assert np.isnan(found).all() and used.sum() == 1


def test_confident_views_count_more():
    views, x = ring(), np.zeros((1, 3))
    uv = np.stack([project(view, x) for view in views])
    uv[0] += 10.0
    errors = [np.linalg.norm(triangulate(views, uv, np.array([[c], [0.9], [0.9], [0.9]]))[0]) for c in (0.9, 0.3, 0.05)]
    assert errors[0] > errors[1] > errors[2]


def test_the_real_views_agree_with_their_published_triangulation():
    names, cameras = read_calibration(DATA / "S00_Calibration" / "Calib_qualisys.toml")
    assert names == ("cam_01", "cam_02", "cam_03", "cam_04")
    reference = reference_of(read_markers(TRIAL / "pose-3d" / "S00_P00_T01_BalancingTrial_0-100.trc"))
    assert reference.shape == (100, 16, 3) and np.isfinite(reference[:, :12]).all()
    pixels, sure = np.full((4, 100, 16, 2), np.nan), np.zeros((4, 100, 16))
    medians = []
    for i, eye in enumerate(cameras):
        poses = read_openpose(TRIAL / "pose" / f"cam0{i + 1}_json", 60.0, (eye.width, eye.height))
        seen = lifted(poses, reference, eye)
        mine = seen.confidence.any(axis=1)
        assert 99 <= mine.sum() <= 101  # bystanders have no known place
        p = np.full((100, 16, 3), np.nan)
        p[seen.frame[mine]] = seen.p[mine]
        medians.append(agreement(p, camera_from_world(eye, reference)).median)
        uv, confidence = to_keypoints(poses.uv, poses.confidence, poses.names)
        pixels[i, poses.frame[mine]], sure[i, poses.frame[mine]] = uv[mine], confidence[mine]
    assert max(medians) < 0.045 and sorted(medians)[1] < 0.02
    found, _ = triangulate(cameras, pixels.reshape(4, -1, 2), sure.reshape(4, -1))
    close = agreement(found.reshape(100, 16, 3), reference)
    assert close.median < 0.003 and close.share > 0.9 and close.compared == 1200


def test_agreement_says_nan_where_nothing_is_comparable():
    none = agreement(np.full((3, 16, 3), np.nan), np.zeros((3, 16, 3)))
    assert np.isnan([none.median, none.worst, none.share]).all() and none.compared == 0 and np.isnan(none.each).all()
    some = agreement(np.full((3, 16, 3), 0.03), np.zeros((3, 16, 3)))
    assert some.median == pytest.approx(0.03 * np.sqrt(3)) and some.share == 0.0 and some.compared == 36


def test_a_reference_without_a_joint_leaves_it_unknown():
    markers = Markers(("LWrist", "Nose"), np.array([[[1000.0, 2000.0, 3000.0], [0.0, 0.0, 0.0]]]), 60.0)
    found = reference_of(markers)
    assert found[0, KEYPOINTS.index("left_wrist")].tolist() == [3.0, 1.0, 2.0]
    assert np.isfinite(found).all(axis=-1).sum() == 1


def test_people_far_from_the_reference_are_not_lifted():
    eye, reference = camera(), np.zeros((1, 16, 3))
    reference[0] = np.column_stack([np.linspace(-0.3, 0.3, 16), np.linspace(-0.2, 0.2, 16), np.full(16, 2.0)])
    names = KEYPOINTS
    near, far = project(eye, reference), project(eye, reference) + 400.0
    empty = np.full((1, 16, 2), np.nan)
    uv = np.concatenate([near, far, empty])
    poses = Poses2d(
        np.arange(2.0), np.array([0, 0, 1]), np.array([0, 1, 0]), uv, np.where(np.isnan(uv[..., 0]), 0.0, 0.5), names
    )
    found = lifted(poses, reference, eye)  # the reference is a frame shorter
    np.testing.assert_allclose(found.p[0], reference[0], atol=1e-12)
    assert np.isnan(found.p[1:]).all()


# --- calibration files

GOOD = (
    "[a]\nsize = [640, 480]\n"
    "matrix = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]\n"
    "distortions = [0.01, 0.0, 0.0, 0.0]\nrotation = [0.0, 0.1, 0.0]\ntranslation = [0.0, 0.0, 2.0]\n"
    "[metadata]\nx = 1\n"
)  # fmt: skip


def test_a_calibration_becomes_cameras(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text(GOOD)
    names, (eye,) = read_calibration(path)
    assert names == ("a",) and (eye.width, eye.height, eye.fx) == (640, 480, 500.0)
    np.testing.assert_allclose(eye.R, Rotation.from_rotvec([0.0, 0.1, 0.0]).as_matrix())
    assert eye.distortion.tolist() == [0.01, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("[a]", "[a", "is no TOML"),
        ("size = [640, 480]", "", "a.size: Field required; a calibration of cameras is wanted"),
        ("size = [640, 480]", "size = [0, 480]", "size: .* positive numbers of pixels"),
        ("[500.0, 0.0, 320.0]", "[500.0, 1.0, 320.0]", r"matrix: \[\[fx, 0, cx\]"),
        ("[500.0, 0.0, 320.0]", "[-500.0, 0.0, 320.0]", r"matrix: \[\[fx, 0, cx\]"),
        ("rotation", "fisheye = true\nrotation", "is a fisheye camera"),
        (GOOD, "[metadata]\nx = 1\n", "has no cameras"),
    ],
)
def test_malformed_calibrations_are_named(tmp_path, old, new, wanted):
    path = tmp_path / "c.toml"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(InputError, match=wanted):
        read_calibration(path)
