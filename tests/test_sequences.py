"""Sequences: what opening a folder, images or a video gives."""

import json
import math
import os
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from handtrack.camera import distort, orthographic, perspective
from handtrack.errors import InputError
from handtrack.formats import write_model
from handtrack.formats.cameras import folds, read_camera
from handtrack.kinematics import Coupling, FrameRow, Model, model_from_rows
from handtrack.kinematics.builtin import model
from handtrack.sequences import Frames, camera_index, find_model, open_images, open_sequence

SHARED = Path(__file__).parents[2] / "shared/data/sequences"
IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
CAMERA = {
    "type": "orthographic",
    "width": 16,
    "height": 12,
    "scale": 3.2,
    "cx": 8,
    "cy": 6,
    "R": IDENTITY,
    "t": [0, 0, 0],
}
START = {"theta1": 10, "theta2": -20.5}


def clip(folder: Path, count: int = 3, **changes: object) -> Path:
    """A sequence folder of tiny images; a change to None removes the key."""
    (folder / "frames").mkdir(parents=True)
    for i in range(count):
        Image.fromarray(np.full((12, 16), 10 * i, np.uint8)).save(folder / f"frames/{i:06d}.png")
    entry = {
        "format": "handtrack/sequence-1",
        "fps": 25,
        "frames": "frames/*.png",
        "camera": CAMERA,
        "model": "rr",
        "start": START,
        **changes,
    }
    (folder / "sequence.yaml").write_text(json.dumps({key: value for key, value in entry.items() if value is not None}))
    return folder


def test_a_sequence_folder_gives_frames_camera_model_start_and_truth(tmp_path):
    folder = clip(tmp_path / "ünï 100% ✋", truth="truth.csv")
    (folder / "truth.csv").write_text("frame,theta1,theta2\n0,1,2\n1,1,2\n2,1,2\n")
    for path in (folder, folder / "sequence.yaml", str(folder)):
        sequence = open_sequence(path)
        assert sequence.warnings == ()
        assert sequence.fps == 25.0
        assert isinstance(sequence.frames, Frames)
        assert (len(sequence.frames), sequence.model.name, sequence.camera.fx) == (3, "rr", 3.2)
        assert sequence.start is not None
        np.testing.assert_allclose(sequence.start, np.radians([10, -20.5]))
        assert sequence.truth is not None
        np.testing.assert_allclose(sequence.truth.q, np.radians([[1, 2]] * 3))
        np.testing.assert_allclose(sequence.frames.times, [0, 0.04, 0.08])
        assert [image[0, 0] for image in sequence.frames] == [0, 10, 20]
        assert sequence.frames.read(2).dtype == np.float32


def test_start_and_truth_may_be_absent(tmp_path):
    sequence = open_sequence(clip(tmp_path / "a", start=None))
    assert sequence.start is None
    assert sequence.truth is None


def test_model_and_start_can_be_given_from_outside(tmp_path):
    folder = clip(tmp_path / "a")
    write_model(tmp_path / "own.yaml", model("pr"))
    (tmp_path / "start.yaml").write_text("start: {d1: 2, theta2: 90}")
    sequence = open_sequence(folder, model=tmp_path / "own.yaml", start=tmp_path / "start.yaml")
    assert sequence.start is not None
    np.testing.assert_allclose(sequence.start, [2, math.pi / 2])
    again = open_sequence(folder, model=model("pr"), start={"d1": 2.0, "theta2": 90.0})
    assert again.start is not None
    np.testing.assert_allclose(again.start, sequence.start)


def test_a_model_file_beside_the_sequence_is_used(tmp_path):
    folder = clip(tmp_path / "a", model="my model ü.yaml")
    write_model(folder / "my model ü.yaml", model("rr"))
    assert open_sequence(folder).model.joint_names == ("theta1", "theta2")


def limited() -> Model:
    rows = [
        FrameRow(1, 0, joint="pip", limits=(0.0, 1.0)),
        FrameRow(2, 1, a=1.0, joint="dip", limits=(0.0, 0.5)),
    ]
    return model_from_rows("limited", rows, [Coupling("dip", "pip", 0.67)])


def test_a_start_beyond_its_limits_is_moved_onto_them_with_a_warning(tmp_path):
    sequence = open_sequence(clip(tmp_path / "a"), model=limited(), start={"pip": 80.0})
    assert sequence.start is not None
    np.testing.assert_allclose(sequence.start, [1.0, 0.67])
    assert "start: pip: 80 is beyond the limits [0, 57.2958]; the limit is used" in sequence.warnings[0]
    assert "its coupling puts it at 38.3882, beyond its limits" in sequence.warnings[1]


def test_coupled_joints_need_no_start_and_follow_their_coupling(tmp_path):
    folder = clip(tmp_path / "a")
    sequence = open_sequence(folder, model=limited(), start={"pip": 30.0})
    assert sequence.start is not None
    np.testing.assert_allclose(sequence.start, np.radians([30, 20.1]))
    assert sequence.warnings == ()
    told = open_sequence(folder, model=limited(), start={"pip": 30.0, "dip": 5.0})
    assert "start: dip: 5 does not follow its coupling; 20.1 is used" in told.warnings[0]
    with pytest.raises(InputError, match="start has no value for pip"):
        open_sequence(folder, model=limited(), start={"dip": 5.0})


def test_a_folder_of_images_needs_model_and_camera(tmp_path):
    folder = clip(tmp_path / "a")
    (tmp_path / "camera.yaml").write_text(json.dumps({"camera": CAMERA}))
    sequence = open_images(folder / "frames", "rr", tmp_path / "camera.yaml", {"theta1": 0.0, "theta2": 0.0})
    assert "no frame rate is given; 25 per second is used" in sequence.warnings[0]
    assert (len(sequence.frames), sequence.fps, sequence.truth) == (3, 25.0, None)
    sequence = open_images(str(folder / "frames"), model("rr"), folder / "sequence.yaml", fps=50.0)
    assert sequence.warnings == ()
    assert sequence.start is None
    np.testing.assert_allclose(sequence.frames.times, [0, 0.02, 0.04])


def test_a_video_is_a_sequence_with_its_own_times(tmp_path):
    path = tmp_path / "clip ✋.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=50)
        stream.width, stream.height, stream.pix_fmt = 16, 12, "yuv420p"
        for level in (20, 120, 220):
            frame = av.VideoFrame.from_ndarray(np.full((12, 16, 3), level, np.uint8), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    camera = orthographic(16, 12, 1.0, 8.0, 6.0, np.eye(3), np.zeros(3))
    sequence = open_images(path, "rr", camera)
    assert (len(sequence.frames), sequence.fps) == (3, 50.0)
    np.testing.assert_allclose(sequence.frames.times, [0, 0.02, 0.04])
    folder = clip(tmp_path / "a", frames="film.mp4")
    (folder / "film.mp4").write_bytes(path.read_bytes())
    frames = open_sequence(folder).frames
    np.testing.assert_allclose(frames.times, [0, 0.04, 0.08])
    np.testing.assert_allclose([image.mean() for image in frames], [20, 120, 220], atol=4)


def test_live_cameras_are_recognised_but_not_opened(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert [camera_index(text) for text in ("0", "12", "clip", "-1", "1234", "")] == [0, 12, None, None, None, None]
    camera = orthographic(16, 12, 1.0, 8.0, 6.0, np.eye(3), np.zeros(3))
    with pytest.raises(InputError, match="camera 0: live cameras are not read"):
        open_images("0", "rr", camera)
    with pytest.raises(InputError, match="nothing: no such file or folder"):
        open_images("nothing", "rr", camera)
    with pytest.raises(InputError, match=r"fps: -1.0 given"):
        open_images("nothing", "rr", camera, fps=-1.0)


def test_models_are_found_by_name_or_file(tmp_path):
    assert find_model("two_finger").name == "two_finger"
    with pytest.raises(InputError, match="no such model file, and no built-in model; built in are index"):
        find_model(tmp_path / "none.yaml")


def test_links_that_leave_the_folder_are_warned_of(tmp_path):
    folder = clip(tmp_path / "a", model="linked.yaml")
    write_model(tmp_path / "elsewhere.yaml", model("rr"))
    os.symlink(tmp_path / "elsewhere.yaml", folder / "linked.yaml")
    assert "a symbolic link leads out of its folder" in open_sequence(folder).warnings[0]


def test_perspective_cameras_are_read_with_their_distortion(tmp_path):
    entry = {key: value for key, value in CAMERA.items() if key != "scale"}
    entry |= {"type": "perspective", "fx": 20, "fy": 21, "distortion": [-0.1, 0.01, 1e-3, 0, 0]}
    (tmp_path / "camera.yaml").write_text(json.dumps({"camera": entry}))
    camera = read_camera(tmp_path / "camera.yaml")
    assert (camera.kind, camera.fy) == ("perspective", 21)
    np.testing.assert_allclose(camera.distortion, [-0.1, 0.01, 1e-3, 0, 0])


@pytest.mark.parametrize("k1", [-0.6, -0.35, -0.33, -0.25, -0.1, 0.0, 0.3])
def test_folding_is_where_the_radial_polynomial_stops_rising(k1):
    # Oracle: the cubic r (1 + k1 r^2) itself; the corner lies at radius 1 of the bent picture.
    camera = perspective(601, 801, 500.0, 500.0, 300.0, 400.0, np.eye(3), np.zeros(3), np.array([k1, 0, 0, 0, 0.0]))
    corner = math.hypot(300.5, 400.5) / 500
    r = np.linspace(0, 5, 200_001)
    bent = r * (1 + k1 * r**2)
    rising = bent[: int(np.argmax(np.diff(bent) <= 0)) + 1] if (np.diff(bent) <= 0).any() else bent
    assert folds(camera) == (rising[-1] < corner)


def test_a_fold_by_tangential_distortion_is_found():
    bend = np.array([0, 0, 0.0, -0.9, 0])
    camera = perspective(640, 480, 400.0, 400.0, 320.0, 240.0, np.eye(3), np.zeros(3), bend)
    assert folds(camera)
    slope = np.array([[0.3, 0.0], [0.3 + 1e-6, 0.0]])
    assert np.diff(distort(slope, bend)[:, 0]) < 0, "x runs backwards inside the image"


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared sequences are not here")
@pytest.mark.parametrize("name", ["mesh_covered_palm", "mesh_whole_hand"])
def test_the_mesh_sequences_open_without_a_warning(name):
    sequence = open_sequence(SHARED / name)
    assert sequence.warnings == ()
    assert (len(sequence.frames), len(sequence.model.joint_names)) == (60, 12)
    assert sequence.truth is not None
    assert sequence.start is not None
    np.testing.assert_allclose(sequence.truth.q[0], sequence.start, atol=1e-7)
    assert sequence.frames.read(59).shape == (480, 640)
