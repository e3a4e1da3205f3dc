"""Sensors that sit on a person anyhow: the person's segments, and the way that was walked."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handtrack.body.imu_suit import SuitSegments, segments_of_sensors, suit_segments
from handtrack.body.orientation import orientations
from handtrack.body.posture import Body, body_of, pose_from_segments, segment_frames
from handtrack.body.posture_tree import JOINTS
from handtrack.body.suit_body import body_of_walk
from handtrack.cli.commands import main
from handtrack.errors import InputError
from handtrack.formats.imu_logs import ImuLogs, read_imu_logs
from handtrack.formats.walks import SEGMENTS, read_walk
from synth.walk import WalkSettings, make_walk

REAL = Path(__file__).resolve().parents[2] / "shared" / "data" / "body_imu" / "Examples" / "logged_lower_body"
real_logs = pytest.mark.skipif(not REAL.is_dir(), reason="the recordings are not there")
LEGS = ("pelvis", "left_thigh", "left_shank", "left_foot", "right_thigh", "right_shank", "right_foot")
KNEES = [6 + JOINTS.index(name) for name in ("left_knee", "right_knee")]


def worn(seed: int = 1, names: tuple[str, ...] = LEGS) -> tuple[ImuLogs, np.ndarray, Body]:
    """Logs of sensors that sit anyhow on a simulated walker, after a second of standing; orientations; the body."""
    scene = make_walk(seed, WalkSettings(seconds=12.0, fps=50.0, camera_fps=1.0, looseness=0.0))
    rng = np.random.default_rng(seed)
    body = body_of_walk(scene.walk)
    R = segment_frames(body, scene.q)[..., :3, :3]
    to_x = Rotation.from_euler("z", -np.arctan2(R[0, 0, 1, 0], R[0, 0, 0, 0])).as_matrix()
    R = np.concatenate([np.broadcast_to(np.eye(3), (50, 13, 3, 3)), to_x @ R])
    at = [SEGMENTS.index(name) for name in names]
    mount = Rotation.random(len(at), rng=rng).as_matrix()
    world = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi, (len(at), 1))).as_matrix()
    turn = world @ R[:, at] @ mount
    wxyz = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_quat(scalar_first=True).reshape(-1, len(at), 4)
    m = len(R)
    rates = np.zeros((m, len(at), 3))
    for i in range(len(at)):
        each = Rotation.from_matrix(turn[:, i])
        rates[1:, i] = (each[:-1].inv() * each[1:]).as_rotvec() * 50.0
    rates[:52] = 0.0
    none = np.full((m, len(at), 3), np.nan)
    there = np.ones((m, len(at)), dtype=bool)
    logs = ImuLogs(names, np.arange(m) / 50.0, rates, none, none, wxyz, there, (m,) * len(at))
    return logs, R, body


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_segments_come_out_however_the_sensors_sit(seed):
    logs, R, body = worn(seed)
    found = suit_segments(logs, logs.wxyz, body)
    assert not found.warnings
    legs = [SEGMENTS.index(name) for name in LEGS[1:]]
    ours = Rotation.from_quat(found.wxyz[:, legs].reshape(-1, 4), scalar_first=True)
    apart = (ours.inv() * Rotation.from_matrix(R[:, legs].reshape(-1, 3, 3))).magnitude()
    assert np.degrees(np.median(apart)) < 1.0 and np.degrees(apart.max()) < 10.0


def test_the_lowest_foot_stays_on_the_floor():
    logs, _, body = worn(2)
    found = suit_segments(logs, logs.wxyz, body)
    sole = np.array([[0.0, 0.0, -body.sizes.ankle], [body.sizes.foot, 0.0, -body.sizes.ankle]])
    feet = [SEGMENTS.index("left_foot"), SEGMENTS.index("right_foot")]
    R = Rotation.from_quat(found.wxyz[:, feet].reshape(-1, 4), scalar_first=True).as_matrix().reshape(-1, 2, 3, 3)
    points = found.p[:, feet, None] + sole @ np.swapaxes(R, -1, -2)
    np.testing.assert_allclose(points[..., 2].min(axis=(1, 2)), 0.0, atol=1e-9)
    moved = np.linalg.norm(np.diff(points[..., :2], axis=0), axis=-1).min(axis=(1, 2))
    assert moved.max() < 1e-9, "of the four points, one stays in every step"


def test_segments_without_a_sensor_go_with_their_parents():
    logs, _, body = worn(2)
    wxyz = suit_segments(logs, logs.wxyz, body).wxyz
    np.testing.assert_allclose(wxyz[:, 1], wxyz[:, 0], atol=1e-12)
    np.testing.assert_allclose(wxyz[:, 4], wxyz[:, 0], atol=1e-12)


def test_an_arm_whose_forward_is_not_told_is_named():
    logs, _, body = worn(2, ("pelvis", "left_upper_arm"))
    assert "left_upper_arm: which way is forward is not told" in suit_segments(logs, logs.wxyz, body).warnings[0]


def test_what_is_no_suit_is_told():
    logs, _, body = worn(2)
    assert segments_of_sensors(("hips", "chest")).tolist() == [0, 1]
    with pytest.raises(InputError, match="hat: is no segment; wanted: pelvis"):
        segments_of_sensors(("pelvis", "hat"))
    with pytest.raises(InputError, match="chest: a second sensor of trunk"):
        segments_of_sensors(("chest", "pelvis", "trunk"))
    with pytest.raises(InputError, match="pelvis: has no sensor"):
        segments_of_sensors(("trunk",))
    moving = replace(logs, gyroscope=logs.gyroscope + 1.0)
    with pytest.raises(InputError, match=r"pelvis: turns by 1\.73 rad/s at first"):
        suit_segments(moving, logs.wxyz, body)


def told(way: SuitSegments) -> tuple[float, float]:
    at = way.p[:, 0, :2]
    return float(np.linalg.norm(at[-1] - at[0])), float(np.linalg.norm(at - at[0], axis=1).max())


@real_logs
@pytest.mark.parametrize("own", [True, False])
def test_a_recorded_walk_there_and_back_ends_where_it_began(own):
    if not own:
        pytest.importorskip("imufusion")
    logs, body = read_imu_logs(REAL), body_of(1.75)
    found = suit_segments(logs, logs.wxyz if own else orientations(logs), body)
    back, far = told(found)
    assert far > 1.3 and back < 0.25
    knee = np.degrees(pose_from_segments(body, found.p, found.wxyz)[:, KNEES])
    assert (np.quantile(knee, 0.9, axis=0) > 25.0).all() and (knee.min(axis=0) > -10.0).all()


CAMERA = """camera:
  type: perspective
  width: 1280
  height: 720
  fx: 900
  fy: 900
  cx: 640
  cy: 360
  R: [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
  t: [0, 1.2, 4]
"""


@real_logs
def test_the_command_writes_a_walk_that_is_followed(tmp_path, capsys):
    (tmp_path / "camera.yaml").write_text(CAMERA)
    given = ["body", "imu", str(REAL), "--camera", str(tmp_path / "camera.yaml"), "--height", "1.75"]
    assert main([*given, "--out", str(tmp_path / "walk"), "--headings", "sensors", "--fps", "20"]) == 0
    assert "the pelvis went 4" in capsys.readouterr().out
    walk = read_walk(tmp_path / "walk", with_keypoints=False)
    assert walk.fps == pytest.approx(20.0) and walk.frame.size > 350
    assert main(["body", "walk", str(tmp_path / "walk"), "--out", str(tmp_path / "run")]) == 2
    assert "keypoints2d.csv" in capsys.readouterr().err
    assert main([*given, "--out", str(tmp_path / "walk")]) == 2, "nothing is overwritten"


def test_bad_logs_are_told_in_one_line(tmp_path, capsys):
    (tmp_path / "camera.yaml").write_text(CAMERA)
    given = ["body", "imu", str(tmp_path), "--out", str(tmp_path / "walk"), "--height", "1.75"]
    assert main([*given, "--camera", str(tmp_path / "camera.yaml")]) == 2
    assert capsys.readouterr().err.count("error:") == 1 and not (tmp_path / "walk").exists()
