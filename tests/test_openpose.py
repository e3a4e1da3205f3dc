"""Files of pose networks: real recordings, made ones in every layout, and one clear line for what is malformed."""

import json
from pathlib import Path

import numpy as np
import pytest

from handtrack.errors import InputError
from handtrack.formats.coco_poses import read_coco_poses
from handtrack.formats.mediapipe import read_mediapipe
from handtrack.formats.openpose import read_openpose
from handtrack.formats.pose_inputs import read_poses
from handtrack.formats.poses2d import BODY_25, BODY_25B, COCO_17, COCO_18, HAND_21, MEDIAPIPE_33, MPI_15, to_keypoints
from handtrack.formats.skeletons import KEYPOINTS

DATA = Path(__file__).parents[2] / "shared" / "data"
VIEWS = DATA / "body_openpose" / "S00_P00_SingleParticipant" / "S00_P00_T01_BalancingTrial" / "pose"
# A person who faces the camera, in pixels: what each keypoint's place looks like in any layout.
PLACES = {
    "nose": (100, 40), "left_eye": (104, 36), "right_eye": (96, 36), "left_ear": (110, 38), "right_ear": (90, 38),
    "neck": (100, 60), "head_top": (100, 20), "left_shoulder": (120, 60), "right_shoulder": (80, 60),
    "left_elbow": (125, 90), "right_elbow": (75, 90), "left_wrist": (128, 118), "right_wrist": (72, 118),
    "mid_hip": (100, 120), "left_hip": (110, 121), "right_hip": (90, 119), "left_knee": (112, 165),
    "right_knee": (88, 165), "left_ankle": (113, 205), "right_ankle": (87, 205),
}  # fmt: skip


def person(names, confidence=0.6, shift=0.0):
    rows = [(*PLACES.get(name, (100, 210)), confidence) for name in names]
    return [value + (shift if i % 3 == 0 else 0.0) for row in rows for i, value in enumerate(row)]


def write(folder, frame, people, name="video_{:012d}_keypoints.json"):
    folder.mkdir(exist_ok=True)
    (folder / name.format(frame)).write_text(json.dumps({"version": 1.3, "people": people}))


def body(names, **changes):
    return {"pose_keypoints_2d": person(names, **changes)}


# --- OpenPose


@pytest.mark.parametrize("view", ["cam01", "cam02", "cam03", "cam04"])
def test_real_views_are_read_in_the_order_that_makes_a_body(view):
    poses = read_openpose(VIEWS / f"{view}_json", 60.0, (1088, 1920))
    assert poses.time.size == 100 and poses.names == BODY_25B and "BODY_25B" in poses.warnings[0]
    assert len(poses.files) == 100 and np.bincount(poses.frame).max() <= 3
    np.testing.assert_array_equal(np.isnan(poses.uv[..., 0]), poses.confidence == 0)
    shoulder, ankle = (poses.uv[:, poses.names.index(name), 1] for name in ("left_shoulder", "left_ankle"))
    assert np.nanmean(ankle - shoulder) > 200  # upright


def test_the_two_orders_of_25_are_told_apart_and_can_be_forced(tmp_path):
    for names in (BODY_25, BODY_25B):
        folder = tmp_path / str(len(names)) / names[1]
        folder.mkdir(parents=True)
        write(folder, 7, [body(names)])
        assert read_openpose(folder, 30.0).names == names
        assert read_openpose(folder, 30.0, layout="body_25").names == BODY_25
        assert read_openpose(folder, 30.0, layout="body_25b").names == BODY_25B


@pytest.mark.parametrize("names", [COCO_18, MPI_15, BODY_25, BODY_25B])
def test_every_layout_gives_the_same_keypoints(tmp_path, names):
    write(tmp_path, 0, [body(names)])
    poses = read_openpose(tmp_path, 30.0)
    uv, confidence = to_keypoints(poses.uv, poses.confidence, poses.names)
    for k, name in enumerate(KEYPOINTS[:12]):
        assert uv[0, k].tolist() == list(PLACES[name]) and confidence[0, k] == 0.6
    assert uv[0, KEYPOINTS.index("mid_shoulder")].tolist() == [100.0, 60.0]
    assert uv[0, KEYPOINTS.index("mid_hip")].tolist() == [100.0, 120.0]
    assert uv[0, KEYPOINTS.index("root")].tolist() == [100.0, 90.0]


def test_frames_are_counted_by_the_files_names_and_gaps_are_told(tmp_path):
    write(tmp_path, 12, [body(BODY_25), body(BODY_25, shift=300.0)])
    write(tmp_path, 14, [])
    write(tmp_path, 15, [body(BODY_25)])
    poses = read_openpose(tmp_path, 10.0)
    np.testing.assert_allclose(poses.time, [0.0, 0.1, 0.2, 0.3])
    assert poses.frame.tolist() == [0, 0, 3] and poses.person.tolist() == [0, 1, 0]
    assert any("1 frames between the first and the last have no file" in note for note in poses.warnings)


def test_zeros_were_not_seen_and_points_off_the_image_neither(tmp_path):
    values = person(BODY_25)
    values[0:3] = 0.0, 0.0, 0.0
    values[3] = -40.0
    write(tmp_path, 0, [{"pose_keypoints_2d": values}])
    poses = read_openpose(tmp_path, 30.0, (640, 480))
    assert np.isnan(poses.uv[0, :2]).all() and poses.confidence[0, :2].tolist() == [0.0, 0.0]
    assert any("1 keypoints lie off the image" in note for note in poses.warnings)
    assert read_openpose(tmp_path, 30.0).uv[0, 1, 0] == -40.0  # nobody said how large the image is


def test_a_confidence_of_exactly_one_is_told(tmp_path):
    write(tmp_path, 0, [body(BODY_25, confidence=1.0)])
    (note,) = read_openpose(tmp_path, 30.0).warnings
    assert "25 keypoints have a confidence of exactly 1" in note
    write(tmp_path, 0, [body(BODY_25, confidence=1.02)])
    assert read_openpose(tmp_path, 30.0).confidence.max() == 1.0


def test_hands_follow_the_body(tmp_path):
    hand = [value for i in range(21) for value in (10.0 + i, 20.0, 0.5)]
    write(tmp_path, 0, [{**body(BODY_25), "hand_left_keypoints_2d": hand}, body(BODY_25)])
    poses = read_openpose(tmp_path, 30.0)
    assert poses.names[25:] == tuple(f"left_hand_{name}" for name in HAND_21)
    tip = poses.names.index("left_hand_little_4")
    assert poses.uv[0, tip].tolist() == [30.0, 20.0] and np.isnan(poses.uv[1, tip]).all()


def test_nobody_at_all_is_no_error(tmp_path):
    write(tmp_path, 0, [])
    poses = read_openpose(tmp_path, 30.0)
    assert poses.uv.shape == (0, 25, 2) and poses.time.tolist() == [0.0]


@pytest.mark.parametrize(
    ("name", "text", "wanted"),
    [
        ("a_0_keypoints.json", "{", "OpenPose's file of one frame is wanted"),
        ("a_0_keypoints.json", "[]", "OpenPose's file of one frame is wanted"),
        ("a_0_keypoints.json", '{"people": [{"pose_keypoints_2d": [1, 2]}]}', "2 numbers of a person's keypoints"),
        ("a_0_keypoints.json", '{"people": [{"pose_keypoints_2d": [NaN, 2, 1]}]}', r"people\.0\.pose_keypoints_2d\.0"),
        ("a_0_keypoints.json", '{"people": [{"pose_keypoints_2d": [1, 2, 1]}]}', "1 keypoints of a body; 25, 18 or 15"),
        ("a_keypoints.json", '{"people": []}', "has no frame number in its name"),
        ("a_0_keypoints.json", json.dumps({"people": [body(BODY_25, confidence=-0.5)]}), "a confidence of -0.5"),
        ("a_0_keypoints.json", json.dumps({"people": [body(BODY_25, shift=1e300)]}), r"1e\+300 pixels are given"),
        ("a_0_keypoints.json", json.dumps({"people": [body(BODY_25, confidence=70.0)]}), "a confidence of 70"),
    ],
)
def test_malformed_files_are_named(tmp_path, name, text, wanted):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=wanted):
        read_openpose(tmp_path, 30.0)


def test_malformed_folders_are_named(tmp_path):
    with pytest.raises(InputError, match=r"holds no \.json files"):
        read_openpose(tmp_path, 30.0)
    write(tmp_path, 1, [])
    write(tmp_path, 1, [], name="other_{}_keypoints.json")
    with pytest.raises(InputError, match="has 2 files of frame 1"):
        read_openpose(tmp_path, 30.0)
    (tmp_path / "other_1_keypoints.json").rename(tmp_path / "other_7000000_keypoints.json")
    with pytest.raises(InputError, match="frames 1 to 7000000"):
        read_openpose(tmp_path, 30.0)
    with pytest.raises(ValueError, match=r"fps: got 0\.0"):
        read_openpose(tmp_path, 0.0)


# --- COCO


def results(*frames, confidence=0.7):
    return [{"image_id": frame, "category_id": 1, "keypoints": person(COCO_17, confidence)} for frame in frames]


def test_coco_results_are_a_video_by_the_numbers_of_their_images(tmp_path):
    path = tmp_path / "r.json"
    for ids in ((5, 4, 7, 4), ("img_5.jpg", "img_4.jpg", "img_7.jpg", "img_4.jpg")):
        path.write_text(json.dumps(results(*ids)))
        poses = read_coco_poses(path, 10.0)
        assert poses.frame.tolist() == [0, 0, 1, 3] and poses.person.tolist() == [0, 1, 0, 0]
        assert poses.time.size == 4 and poses.names == COCO_17
        assert poses.uv[0, COCO_17.index("left_wrist")].tolist() == list(PLACES["left_wrist"])


def test_coco_ids_of_a_collection_become_one_frame_after_the_other(tmp_path):
    path = tmp_path / "r.json"
    path.write_text(json.dumps(results(139, 581929, 785)))
    poses = read_coco_poses(path, 10.0)
    assert poses.frame.tolist() == [0, 1, 2] and "too far apart" in poses.warnings[0]


def test_coco_annotations_keep_images_without_people_and_flags_are_confidences(tmp_path):
    values = person(COCO_17, 2)
    values[2], values[5] = 0, 1
    path = tmp_path / "a.json"
    images = [{"id": 30, "file_name": "x"}, {"id": 10}, {"id": 20}]
    annotations = [{"image_id": 20, "keypoints": values}, {"image_id": 30, "bbox": [0, 0, 1, 1]}]
    path.write_text(json.dumps({"images": images, "annotations": annotations, "categories": []}))
    poses = read_coco_poses(path, 10.0)
    assert poses.time.size == 3 and poses.frame.tolist() == [2]
    assert poses.confidence[0, :3].tolist() == [0.0, 0.5, 1.0] and np.isnan(poses.uv[0, 0]).all()
    path.write_text(json.dumps({"images": images, "annotations": [{"image_id": 1, "keypoints": values}]}))
    with pytest.raises(InputError, match="image 1 is not among the images"):
        read_coco_poses(path, 10.0)


def test_no_results_are_no_people(tmp_path):
    path = tmp_path / "r.json"
    path.write_text("[]")
    assert read_coco_poses(path, 10.0).uv.shape == (0, 17, 2)


@pytest.mark.parametrize(
    ("content", "wanted"),
    [
        ([{"image_id": 1, "keypoints": [1.0] * 50}], "COCO's keypoint results or annotations is wanted"),
        ([{"image_id": "front.jpg", "keypoints": [1.0] * 51}], "'front.jpg' holds no number"),
        (results(1, confidence=1.5), "a confidence of 1.5"),
        (results(1, confidence=-1.0), "a confidence of -1"),
        ([{"image_id": 1, "keypoints": [1e9, 2.0, 0.5] * 17}], r"1e\+09 pixels are given; at most 1e\+06"),
        ({"images": []}, "COCO's keypoint results or annotations is wanted"),
    ],
)
def test_malformed_coco_files_are_named(tmp_path, content, wanted):
    path = tmp_path / "r.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=wanted):
        read_coco_poses(path, 10.0)
    with pytest.raises(ValueError, match="fps"):
        read_coco_poses(path, float("nan"))


# --- MediaPipe


def landmarks(x=0.5, y=0.25, visibility=0.9):
    return [{"x": x, "y": y, "z": 0.1, "visibility": visibility, "presence": 1.0} for _ in range(33)]


def test_mediapipe_landmarks_are_shares_of_the_image_and_metres(tmp_path):
    path = tmp_path / "m.json"
    for image, world, time in (
        ("pose_landmarks", "pose_world_landmarks", "timestamp_ms"),
        ("landmarks", "worldLandmarks", "timestamp"),
    ):
        frames = [
            {image: [landmarks(), landmarks(0.75)], world: [landmarks(0.1, -0.2)] * 2, time: 40},
            {image: [], world: [], time: 80},
            {image: [landmarks(visibility=0.0)], world: [landmarks()], time: 140},
        ]
        for content in (frames, {"frames": frames}):
            path.write_text(json.dumps(content))
            poses = read_mediapipe(path, 25.0, (640, 480))
            np.testing.assert_allclose(poses.time, [0.04, 0.08, 0.14])
            assert poses.frame.tolist() == [0, 0, 2] and poses.person.tolist() == [0, 1, 0]
            assert poses.uv[0, 0].tolist() == [319.5, 119.5] and poses.uv[1, 0, 0] == 479.5
            assert poses.world is not None and poses.world[0, 5].tolist() == [0.1, -0.2, 0.1]
            assert np.isnan(poses.uv[2]).all() and np.isnan(poses.world[2]).all() and not poses.confidence[2].any()


def test_one_person_without_an_outer_list_and_without_times(tmp_path):
    path = tmp_path / "m.json"
    path.write_text(json.dumps([{"pose_landmarks": landmarks()}, {"pose_landmarks": None}]))
    poses = read_mediapipe(path, 25.0, (640, 480))
    assert poses.time.tolist() == [0.0, 0.04] and poses.frame.tolist() == [0] and poses.world is None
    assert poses.names == MEDIAPIPE_33 and poses.names[15:17] == ("left_wrist", "right_wrist")


def test_a_frame_without_world_among_others_has_unknown_places(tmp_path):
    path = tmp_path / "m.json"
    both = {"landmarks": [landmarks()], "worldLandmarks": [landmarks()]}
    path.write_text(json.dumps([both, {"landmarks": [landmarks()]}]))
    poses = read_mediapipe(path, 25.0, (640, 480))
    assert poses.world is not None and np.isfinite(poses.world[0]).all() and np.isnan(poses.world[1]).all()


@pytest.mark.parametrize(
    ("content", "wanted"),
    [
        ([{"landmarks": [landmarks()[:5]]}], "a list of MediaPipe's pose results is wanted"),
        (
            [{"landmarks": [landmarks()], "worldLandmarks": [landmarks()] * 2}],
            "1 people in the image and 2 in the world",
        ),
        ([{"timestamp": 40}, {"timestamp": 40}], "frame 1: its time is not after"),
        ([{"landmarks": [landmarks(visibility=1.5)]}], "less than or equal to 1"),
        ([{"landmarks": [landmarks(x=1e5)]}], "100000 shares of the image are given"),
        ([{"landmarks": [landmarks()], "worldLandmarks": [landmarks(y=-900.0)]}], "900 metres are given; at most 50"),
    ],
)
def test_malformed_landmarks_are_named(tmp_path, content, wanted):
    path = tmp_path / "m.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=wanted):
        read_mediapipe(path, 25.0, (640, 480))
    with pytest.raises(ValueError, match="fps"):
        read_mediapipe(path, -1.0, (640, 480))


# --- whatever it is


def test_inputs_are_known_by_what_they_hold(tmp_path):
    write(tmp_path / "open", 0, [body(BODY_25)])
    assert read_poses(tmp_path / "open", 30.0).names == BODY_25
    path = tmp_path / "x.json"
    path.write_text(json.dumps(results(1)))
    assert read_poses(path, 30.0).names == COCO_17
    path.write_text(json.dumps([{"landmarks": [landmarks()]}]))
    assert read_poses(path, 30.0, (640, 480)).names == MEDIAPIPE_33
    with pytest.raises(InputError, match="its size is wanted"):
        read_poses(path, 30.0)
    path.write_text("{}")
    with pytest.raises(InputError, match="holds no keypoints or landmarks"):
        read_poses(path, 30.0)
    with pytest.raises(InputError, match="no such file"):
        read_poses(tmp_path / "y.json", 30.0)


def test_names_are_unique_and_as_many_as_the_networks_have():
    for names, count in ((BODY_25, 25), (BODY_25B, 25), (COCO_18, 18), (COCO_17, 17), (MPI_15, 15), (MEDIAPIPE_33, 33)):
        assert len(names) == count == len(set(names))
        assert all(name in names for name in KEYPOINTS[:12])


def test_built_keypoints_are_as_sure_as_their_least_sure_source():
    names = ("left_hip", "right_hip", "left_ear", "right_ear")
    values = np.array([[[0.0, 0.0], [2.0, 4.0], [1.0, 1.0], [np.nan, np.nan]]])
    out, sure = to_keypoints(values, np.array([[0.3, 0.8, 0.9, 0.0]]), names)
    assert out[0, KEYPOINTS.index("mid_hip")].tolist() == [1.0, 2.0] and sure[0, KEYPOINTS.index("mid_hip")] == 0.3
    assert np.isnan(out[0, KEYPOINTS.index("head")]).all() and sure[0, KEYPOINTS.index("head")] == 0.0
    assert np.isnan(out[0, KEYPOINTS.index("root")]).all()
