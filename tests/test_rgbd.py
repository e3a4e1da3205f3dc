"""RGB-D scene folders: what is written reads back, and what is no such scene is refused with its place."""

import cv2
import numpy as np
import pytest

from handtrack.camera import perspective
from handtrack.errors import InputError
from handtrack.formats.rgbd import read_depth, read_rgbd, write_rgbd
from handtrack.formats.robots import RobotVolume, read_robot, robot_text
from handtrack.formats.skeletons import Detections, TruthPoints

CAMERA = perspective(8, 6, 7.5, 7.25, 3.5, 2.5, np.eye(3), np.zeros(3))


def detections(frames=3):
    p = np.full((frames, 16, 3), np.nan)
    p[:, 5] = 0.25, -0.5, 2.0
    state = np.full((frames, 16), 2, dtype=np.int8)
    state[:, 5] = 0
    confidence = np.where(state == 0, 0.75, 0.0)
    number = np.arange(frames)
    return Detections(number / 30.0, number, np.zeros(frames, dtype=int), p, confidence, state)


def depths(frames=3):
    return [np.full((6, 8), 1.5 + 0.001 * i, dtype=np.float32) for i in range(frames)]


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "a scene, 100%"
    truth = TruthPoints(np.ones((3, 1, 16, 3)))
    write_rgbd(path, 30.0, CAMERA, depths(), detections(), b"ply\n", truth, [("robot.csv", b"x")])
    return path


def edit(folder, old, new):
    text = (folder / "scene.yaml").read_text()
    assert old in text
    (folder / "scene.yaml").write_text(text.replace(old, new))


def test_a_scene_reads_back_as_written(folder):
    for path in (folder, folder / "scene.yaml"):
        scene = read_rgbd(path)
        assert len(scene) == 3 and scene.fps == 30.0 and scene.warnings == ()
        assert (scene.camera.fx, scene.camera.fy, scene.camera.cx) == (7.5, 7.25, 3.5)
        np.testing.assert_allclose(scene.detections.p, detections().p)
        assert scene.environment is not None and scene.environment.read_bytes() == b"ply\n"
        assert scene.truth is not None and (scene.truth.p == 1.0).all()
        depth = read_depth(scene, 2)
        assert depth.dtype == np.float32 and np.abs(depth - 1.502).max() < 1e-6
    assert (folder / "robot.csv").read_bytes() == b"x"


def test_what_a_scene_may_lack_is_none(tmp_path):
    write_rgbd(tmp_path / "s", 30.0, CAMERA, depths(), detections())
    scene = read_rgbd(tmp_path / "s")
    assert scene.environment is None and scene.truth is None


def test_depth_is_rounded_to_millimetres_and_what_does_not_fit_has_no_reading(tmp_path):
    depth = np.full((6, 8), 1.2344, dtype=np.float32)
    depth[0, :5] = np.nan, np.inf, -1.0, 70.0, 0.0
    write_rgbd(tmp_path / "s", 30.0, CAMERA, [depth], detections(1))
    back = read_depth(read_rgbd(tmp_path / "s"), 0)
    assert (back[0, :5] == 0.0).all() and np.abs(back[1:] - 1.234).max() < 1e-6


def test_a_scene_is_written_whole_or_not_at_all(tmp_path):
    with pytest.raises(ValueError, match="depths: 2 images; wanted 3"):
        write_rgbd(tmp_path / "s", 30.0, CAMERA, depths(2), detections())
    with pytest.raises(ValueError, match=r"depths: \(5, 8\) given; wanted \(6, 8\)"):
        write_rgbd(tmp_path / "s", 30.0, CAMERA, [np.ones((5, 8), dtype=np.float32)], detections(1))
    assert list(tmp_path.iterdir()) == []


def test_a_scene_that_is_there_gives_way_only_when_asked(folder):
    with pytest.raises(InputError, match="not empty"):
        write_rgbd(folder, 30.0, CAMERA, depths(), detections())
    write_rgbd(folder, 15.0, CAMERA, depths(), detections(), replace=True)
    assert read_rgbd(folder).fps == 15.0


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("rgbd-1", "rgbd-2", "line 1: format: 'handtrack/rgbd-2' given"),
        ("fps: 30.0", "fps: 0", "line 2: fps:"),
        ("[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]", "[[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]", "camera.R: is not the identity"),
        ("t: [0.0, 0.0, 0.0]", "t: [0.0, 0.0, 0.1]", "camera.t: is not zero; a scene is given in camera axes"),
        ("type: perspective", "type: orthographic", "camera.type: 'orthographic' given"),
        ("width: 8", "width: 9", "is 8 x 6 pixels; 9 x 6, the camera's size, is wanted"),
        ("depth/*.png", "depth/*.tif", "matches no file"),
        ("depth/*.png", "../depth/*.png", "leaves the folder"),
        ("skeletons.csv", "people.csv", "skeleton: 'people.csv' is no file"),
        ("room.ply", "hall.ply", "environment: 'hall.ply' is no file"),
        ("room.ply", "/room.ply", "is absolute"),
        ("truth.csv", "what.csv", "truth: 'what.csv' is no file"),
        ("skeleton: ", "skeletons: ", "unknown key 'skeletons'"),
    ],
)
def test_a_bad_scene_file_is_refused_with_its_place(folder, old, new, match):
    edit(folder, old, new)
    with pytest.raises(InputError, match=match) as error:
        read_rgbd(folder)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("values", "match"),
    [
        (np.ones((6, 8), dtype=np.uint8), "is not 16-bit grey; 16-bit depth in millimetres is wanted"),
        (np.ones((6, 8, 3), dtype=np.uint16), "is not 16-bit grey"),
        (np.ones((4, 8), dtype=np.uint16), "is 8 x 4 pixels; 8 x 6, the camera's size, is wanted"),
    ],
)
def test_depth_of_another_kind_is_refused(folder, values, match):
    scene = read_rgbd(folder)
    (folder / "depth" / "000001.png").write_bytes(cv2.imencode(".png", values)[1].tobytes())
    with pytest.raises(InputError, match=match):
        read_depth(scene, 1)


def test_broken_depth_is_refused_by_name(folder):
    scene = read_rgbd(folder)
    content = (folder / "depth" / "000001.png").read_bytes()
    (folder / "depth" / "000001.png").write_bytes(content[: len(content) - 25])
    with pytest.raises(InputError, match=r"000001\.png: is broken"):
        read_depth(scene, 1)


def test_a_folder_without_a_scene_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"scene\.yaml: no such file"):
        read_rgbd(tmp_path)


def test_warnings_of_the_tables_are_the_scenes(folder):
    (folder / "truth.csv").write_text("frame,person,keypoint,x,y,z\n0,0,head,0,0,2\n")
    assert "has no truth for 2 of 3 frames" in read_rgbd(folder).warnings[0]


def test_a_robots_volume_reads_back_as_written(tmp_path):
    rng = np.random.default_rng(0)
    volume = RobotVolume(rng.uniform(-2.0, 2.0, (4, 3, 2, 3)), rng.uniform(0.05, 0.1, (4, 3)))
    (tmp_path / "robot.csv").write_text(robot_text(volume))
    back = read_robot(tmp_path / "robot.csv", 4)
    np.testing.assert_allclose(back.ends, volume.ends, rtol=1e-9)
    np.testing.assert_allclose(back.radius, volume.radius, rtol=1e-9)
    assert read_robot(tmp_path / "robot.csv", 2).radius.shape == (2, 3)


@pytest.mark.parametrize(
    ("rows", "match"),
    [
        (["0,0,0,0,2,1,0,2,0"], "line 2: radius: a number above 0 is wanted"),
        (["0,0,0,0,2000,1,0,2,0.1"], "line 2: beyond 50 m; metres are wanted"),
        (["0,1000,0,0,2,1,0,2,0.1"], "line 2: link: a number below 1000 is wanted"),
        (["0,1,0,0,2,1,0,2,0.1"], "frame 0 has link 0 0 times; once is wanted"),
        (["0,0,0,0,2,1,0,2,0.1"] * 2, "frame 0 has link 0 2 times; once is wanted"),
    ],
)
def test_a_bad_robot_is_refused(tmp_path, rows, match):
    (tmp_path / "robot.csv").write_text("\n".join(["frame,link,ax,ay,az,bx,by,bz,radius", *rows]) + "\n")
    with pytest.raises(InputError, match=match):
        read_robot(tmp_path / "robot.csv", 1)
