"""Claims about what can be opened as people, and about the run folder that `handtrack body people` writes."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from handtrack.body.people_inputs import Given, open_people
from handtrack.body.people_run import run, settings_for
from handtrack.camera import perspective
from handtrack.cli import people_files
from handtrack.cli.commands import main
from handtrack.errors import InputError
from handtrack.formats.people import LOST, people_text, read_people
from handtrack.formats.people_scenes import write_people_scene
from handtrack.formats.poses2d import MEDIAPIPE_33
from handtrack.formats.skeletons import Detections
from synth.people_tasks import TaskSettings, make_task

CAMERA = perspective(160, 120, 100.0, 100.0, 80.0, 60.0, np.eye(3), np.zeros(3))
CAMERA_FILE = """camera: {type: perspective, width: 160, height: 120, fx: 100.0, fy: 100.0, cx: 80.0, cy: 60.0,
  R: [[0, -1, 0], [1, 0, 0], [0, 0, 1]], t: [1, 2, 3]}
"""
# Pixels of COCO's 18 keypoints of somebody who stands 2 m away.
NECK_18 = np.array(
    [[80, 20], [80, 28], [70, 28], [67, 42], [65, 54], [90, 28], [93, 42], [95, 54], [74, 58], [73, 78], [73, 98],
     [86, 58], [87, 78], [87, 98], [78, 18], [82, 18], [76, 19], [84, 19]], float,
)  # fmt: skip


@pytest.fixture(scope="module")
def task():
    return make_task("T0", 1, TaskSettings(frames=45))


@pytest.fixture(scope="module")
def scene(task, tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "hall"
    write_people_scene(folder, task.fps, task.camera, task.detections, task.truth)
    return folder


@pytest.fixture(scope="module")
def done(scene, tmp_path_factory):
    """A run folder, and what the command said."""
    out = tmp_path_factory.mktemp("runs") / "run"
    assert main(["body", "people", str(scene), "--out", str(out)]) == 0
    return out


def openpose(folder, frames=6, depths=6, depth=2000):
    """A folder of OpenPose's files, depth images and a camera file."""
    (folder / "pose").mkdir(parents=True)
    (folder / "depth").mkdir()
    for n in range(frames):
        numbers = np.column_stack([NECK_18 + 0.2 * n, np.full(18, 0.8)]).ravel().tolist()
        person = {"pose_keypoints_2d": numbers, "hand_left_keypoints_2d": [], "hand_right_keypoints_2d": []}
        (folder / "pose" / f"walk_{n:012d}_keypoints.json").write_text(json.dumps({"people": [person]}))
    for n in range(depths):
        cv2.imwrite(str(folder / "depth" / f"{n:04d}.png"), np.full((120, 160), depth, np.uint16))
    (folder / "camera.yaml").write_text(CAMERA_FILE)
    return folder


def given(folder, **more):
    return Given(**({"camera": folder / "camera.yaml", "depth": folder / "depth"} | more))


def test_a_scene_is_opened_as_it_is(scene, task):
    opened = open_people(scene)
    assert opened.fps == 30.0 and opened.camera is not None and opened.camera.width == 848 and opened.truth is not None
    assert np.allclose(opened.detections.p, task.detections.p, atol=1e-9, equal_nan=True)
    assert [name for name, _ in opened.files] == ["scene.yaml", "skeletons.csv", "truth.csv"]
    assert open_people(scene / "scene.yaml").path == opened.path


def test_keypoints_in_pixels_are_placed_by_depth_in_the_cameras_own_axes(tmp_path):
    folder = openpose(tmp_path)
    opened = open_people(folder / "pose", given(folder, fps=25.0, offset=0.0))
    p = opened.detections.p
    assert p.shape == (6, 16, 3) and opened.fps == pytest.approx(25.0)
    assert np.allclose(p[0, 5], [(65 - 80) / 50, (54 - 60) / 50, 2.0])  # right wrist
    assert opened.camera is not None and np.array_equal(opened.camera.R, np.eye(3)) and not opened.camera.t.any()
    deeper = open_people(folder / "pose", given(folder)).detections.p
    moved = np.linalg.norm(deeper - p, axis=-1)[:, :12]
    assert np.allclose(moved[np.isfinite(p[:, :12, 0])], 0.035)
    assert [name for name, _ in opened.files] == ["keypoints", "camera", "depth"]


def test_landmarks_with_metres_do_without_depth_and_say_so(tmp_path):
    folder = openpose(tmp_path)
    world = np.random.default_rng(0).normal(scale=0.3, size=(33, 3))
    away = world + np.array([0.0, 0.0, 2.5])
    uv = away[:, :2] / away[:, 2:] * 100.0 + (80.0, 60.0)

    def marks(rows):
        return [dict(zip(("x", "y", "z", "visibility"), (*row, 0.9), strict=True)) for row in rows.tolist()]

    share = np.column_stack([(uv + 0.5) / (160, 120), np.zeros(33)])
    one = {"pose_landmarks": [marks(share)], "pose_world_landmarks": [marks(world)]}
    (folder / "marks.json").write_text(json.dumps([one, one]))
    opened = open_people(folder / "marks.json", given(folder, depth=None))
    wrist = MEDIAPIPE_33.index("left_wrist")
    assert np.allclose(opened.detections.p[0, 4], away[wrist], atol=0.02)
    assert any("the network's guesses" in line for line in opened.warnings)


@pytest.mark.parametrize(
    ("more", "wanted"),
    [
        ({"camera": None}, "--camera: is wanted: .*pixels"),
        ({"depth": None}, "--depth: is wanted: .*pixels"),
    ],
)
def test_what_pixels_cannot_do_without_is_asked_for(tmp_path, more, wanted):
    folder = openpose(tmp_path)
    with pytest.raises(InputError, match=wanted):
        open_people(folder / "pose", given(folder, **more))


def test_depth_images_have_to_be_as_many_as_frames(tmp_path):
    few, many = openpose(tmp_path / "few", depths=5), openpose(tmp_path / "many", depths=8)
    with pytest.raises(InputError, match="has 5 images; 6, one for each frame"):
        open_people(few / "pose", given(few))
    assert any("8 images for 6 frames" in line for line in open_people(many / "pose", given(many)).warnings)


def test_a_flat_camera_and_wrong_places_are_refused(tmp_path, scene):
    folder = openpose(tmp_path)
    flat = CAMERA_FILE.replace("perspective", "orthographic").replace("fx: 100.0, fy: 100.0", "scale: 1.0")
    (folder / "flat.yaml").write_text(flat)
    with pytest.raises(InputError, match="orthographic; a perspective one"):
        open_people(folder / "pose", given(folder, camera=folder / "flat.yaml"))
    with pytest.raises(InputError, match="no such file or folder"):
        open_people(tmp_path / "none")
    with pytest.raises(InputError, match="--depth: is not for a scene"):
        open_people(scene, Given(depth=folder / "depth"))


def test_settings_and_recordings_without_frames_are_refused(task):
    with pytest.raises(InputError, match="--mode: wild given; wanted: paper, robust"):
        settings_for("wild")
    assert settings_for("paper").mode == "paper"
    none = np.zeros(0, int)
    empty = Detections(
        np.zeros(0), none, none, np.zeros((0, 16, 3)), np.zeros((0, 16)), np.zeros((0, 16), np.int8)
    )  # fmt: skip
    with pytest.raises(InputError, match="no frames"):
        run(empty, settings_for("robust"))


def test_the_same_seed_gives_the_same_people(task):
    settings = settings_for("robust")
    first, again = (run(task.detections, settings, 3) for _ in range(2))
    assert people_text(first.people) == people_text(again.people) and first.milliseconds > 0
    assert set(np.unique(first.raw.person)) <= set(np.unique(first.people.person))


def test_raw_people_are_measurements_and_nothing_else(task):
    raw = run(task.detections, settings_for("robust")).raw
    for n in (20, 40):
        reported = task.detections.p[task.detections.frame == n].reshape(-1, 3)
        rows = raw.p[raw.frame == n][:, :12].reshape(-1, 3)
        for p in rows[np.isfinite(rows[:, 0])]:
            assert np.abs(reported - p).max(axis=1)[np.isfinite(reported[:, 0])].min() < 1e-9


def test_a_run_folder_is_whole_and_reads_back(done):
    names = {"people.csv", "people.trc", "people.c3d", "people.bvh", "run.json", "report.html"}
    assert {file.name for file in done.iterdir()} == names
    people = read_people(done / "people.csv")
    assert np.unique(people.person).size == 2 and people.time.size == 45
    assert np.isfinite(people.p[people.status != LOST]).all() and "nan" not in (done / "people.csv").read_text()
    record = json.loads((done / "run.json").read_text())
    assert record["format"] == "handtrack/people-run-1" and record["settings"]["mode"] == "robust"
    assert set(record["inputs"]) == {"scene.yaml", "skeletons.csv", "truth.csv"} and len(record["labels"]) == 2
    assert record["figures"]["identity_switches"] == 0 and record["input"].endswith("hall")
    assert "hall" in (done / "report.html").read_text()[:800]


def test_the_same_command_gives_the_same_files_and_replaces_them(scene, done, tmp_path, capsys):
    out = tmp_path / "run"
    for _ in range(2):
        assert main(["body", "people", str(scene), "--out", str(out), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out.split("}\n{")[0] + "}")
    assert summary["frames"] == 45 and summary["figures"]["people"] == 2
    for name in ("people.csv", "people.trc", "people.bvh"):
        assert (out / name).read_bytes() == (done / name).read_bytes(), name


def test_pixels_with_depth_make_a_run_and_a_missing_package_a_warning(tmp_path, capsys, monkeypatch):
    folder = openpose(tmp_path, frames=12, depths=12)
    monkeypatch.setattr(people_files, "find_spec", lambda name: None)
    given = ["--camera", str(folder / "camera.yaml"), "--depth", str(folder / "depth"), "--mode", "paper"]
    assert main(["body", "people", str(folder / "pose"), "--out", str(tmp_path / "run"), *given]) == 0
    said = capsys.readouterr()
    assert "people.c3d is left out" in said.err and "12 frames" in said.out
    assert not (tmp_path / "run" / "people.c3d").exists() and (tmp_path / "run" / "people.trc").is_file()


def test_nobody_is_no_failure(tmp_path, capsys):
    folder = openpose(tmp_path, frames=3, depths=3, depth=0)  # no depth: nobody has a place
    given = ["--camera", str(folder / "camera.yaml"), "--depth", str(folder / "depth")]
    assert main(["body", "people", str(folder / "pose"), "--out", str(tmp_path / "run"), *given]) == 0
    assert "nobody was found" in capsys.readouterr().err
    assert {file.name for file in (tmp_path / "run").iterdir()} == {"people.csv", "run.json", "report.html"}


def test_people_without_hips_have_no_skeleton_file(task, tmp_path, capsys):
    p = task.detections.p.copy()
    p[:, 6:14] = np.nan
    confidence = np.where(np.isnan(p[..., 0]), 0.0, task.detections.confidence)
    write_people_scene(
        tmp_path / "hall", 30.0, None, replace(task.detections, p=p, confidence=confidence), task.truth
    )  # fmt: skip
    assert main(["body", "people", str(tmp_path / "hall"), "--out", str(tmp_path / "run")]) == 0
    has = (tmp_path / "run" / "people.bvh").exists()
    assert has != ("nobody has hips" in capsys.readouterr().err)


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["none"], "none: no such file or folder"),
        ([".", "--mode", "wild"], "'wild' is not one of"),
        ([".", "--fps", "0"], "fps"),
        ([".", "--offset", "3"], "offset"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing_behind(tmp_path, monkeypatch, capsys, arguments, wanted):
    monkeypatch.chdir(tmp_path)
    assert main(["body", "people", *arguments, "--out", "run"]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ") and wanted in lines[0]
    assert not (tmp_path / "run").exists()


def test_a_folder_with_other_files_is_not_replaced(scene, tmp_path, capsys):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "letter.txt").write_text("mine")
    assert main(["body", "people", str(scene), "--out", str(tmp_path / "run")]) == 2
    assert "holds other files" in capsys.readouterr().err and (tmp_path / "run" / "letter.txt").is_file()


def test_tasks_and_tests_of_identity_are_simulated_and_replaced(tmp_path, capsys):
    out = tmp_path / "hall"
    for name in ("T1", "crossing"):
        assert main(["body", "simulate-people", str(out), "--task", name, "--frames", "12", "--seed", "4"]) == 0
    assert capsys.readouterr().out.split() == [str(out / "scene.yaml")] * 2
    assert open_people(out).detections.time.size == 12


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["hall", "--frames", "1"], "--frames: got 1"),
        (["busy"], "holds other files"),
        (["busy/letter.txt/hall"], "is a file"),
    ],
)
def test_what_cannot_be_simulated_is_refused(tmp_path, monkeypatch, capsys, arguments, wanted):
    (tmp_path / "busy").mkdir()
    (tmp_path / "busy" / "letter.txt").write_text("mine")
    monkeypatch.chdir(tmp_path)
    assert main(["body", "simulate-people", *arguments]) == 2
    assert wanted in capsys.readouterr().err
