"""Claims about following a wrist through a scene folder, its table, and the figures that are drawn from it."""

from dataclasses import replace

import numpy as np
import pytest

from handtrack.body.joint_filter import Sampling
from handtrack.body.wrist_run import SHOWN, arm_of, run, settings_for
from handtrack.camera import perspective
from handtrack.errors import InputError
from handtrack.formats.rgbd import read_rgbd, write_rgbd
from handtrack.formats.robots import RobotVolume
from handtrack.formats.skeletons import KEYPOINTS, LOST, Detections, TruthPoints
from handtrack.formats.wrists import COLUMNS, STATUSES, read_wrist, wrist_text, write_wrist
from handtrack.report.wrist_facts import facts_of, recovery, robot_distance

CAMERA = perspective(160, 120, 150.0, 150.0, 80.0, 60.0, np.eye(3), np.zeros(3))
ARM = [KEYPOINTS.index(f"right_{name}") for name in ("shoulder", "elbow", "wrist")]
WALL = b"""ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
-9 -9 2.12
9 -9 2.12
0 9 2.12
3 0 1 2
"""
EMPTY = WALL.split(b"-9")[0].replace(b"vertex 3", b"vertex 0").replace(b"face 1", b"face 0")


def arm_at(frame):
    angle = 0.9 + 0.5 * np.sin(frame / 20)
    shoulder, elbow = np.array([0.0, -0.3, 2.0]), np.array([0.0, 0.0, 2.0])
    return np.stack([shoulder, elbow, elbow + 0.26 * np.array([np.sin(angle), np.cos(angle), 0.0])])


def detections_of(frames, hidden=(), stranger=None, empty=(), elbow=()):
    """One person, whose wrist is lost in some frames; a stranger stands beside, and comes first in the list."""
    rng, rows = np.random.default_rng(0), []
    for n in range(frames):
        if n in empty:
            continue
        p, state = np.full((16, 3), np.nan), np.full(16, LOST, np.int8)
        p[ARM] = arm_at(n) + 0.005 * rng.normal(size=(3, 3))
        state[ARM] = 0
        if n in hidden:
            p[ARM[2]], state[ARM[2]] = np.nan, LOST
        if n in elbow:
            p[ARM[1]], state[ARM[1]] = np.nan, LOST
        rows.append((n, p, state))
        if stranger is not None and n > 0:
            rows.append((n, p + stranger, state))
    order = [(n, k, *rest) for n in range(frames) for k, (m, *rest) in enumerate(reversed(rows)) if m == n]
    who = [sum(1 for m, *_ in order[:i] if m == n) for i, (n, *_) in enumerate(order)]
    p = np.array([p for *_, p, _ in order]).reshape(-1, 16, 3)
    return Detections(
        np.arange(frames) / 30, np.array([n for n, *_ in order], int), np.array(who, int), p,
        np.isfinite(p[..., 0]).astype(float), np.array([s for *_, s in order], np.int8).reshape(-1, 16),
    )  # fmt: skip


def made(folder, frames=24, environment=WALL, **more):
    depth = np.full((120, 160), 2.12, np.float32)
    depth[30:110, 50:130] = 1.6
    truth = np.full((frames, 1, 16, 3), np.nan)
    truth[:, 0, ARM] = [arm_at(n) for n in range(frames)]
    write_rgbd(
        folder,
        30.0,
        CAMERA,
        [depth] * frames,
        detections_of(frames, **more),
        environment,
        TruthPoints(truth),
        replace=True,
    )
    return read_rgbd(folder)


def settings(variant="complete"):
    return replace(settings_for(variant, 200), fathers=Sampling(particles=100))


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return made(tmp_path_factory.mktemp("made") / "scene", hidden=range(10, 20))


def test_a_wrist_is_followed_and_the_hidden_frames_say_so(scene):
    track = run(scene, settings(), seed=3, engine="bvh")
    assert track.status.tolist() == ["tracked"] * 10 + ["predicted"] * 10 + ["tracked"] * 4
    truth = scene.truth.p[:, 0, ARM]
    assert np.linalg.norm(track.mean - truth[:, 2], axis=1).max() < 0.1
    assert np.linalg.norm(track.elbow - truth[:, 1], axis=1).max() < 0.05
    assert np.linalg.norm(track.shoulder - truth[:, 0], axis=1).max() < 0.05
    assert track.cloud.shape == (24, SHOWN, 3) and np.isfinite(track.cloud).all() and not track.warnings
    assert np.linalg.norm(track.cloud.mean(axis=1) - track.mean, axis=1).max() < 0.05


def test_the_same_seed_gives_the_same_table_and_another_one_does_not(scene):
    texts = [wrist_text(run(scene, settings(), seed, engine="bvh")) for seed in (1, 1, 2)]
    assert texts[0] == texts[1] != texts[2]


def test_particles_that_are_shown_are_spread_as_the_covariance_says(tmp_path):
    """The elbow is lost too: particles themselves know nothing of that."""
    scene = made(tmp_path / "s", 30, hidden=range(10, 30), elbow=range(12, 30))
    track = run(scene, settings("joint-volume"), 1)
    for n in (5, 11, 20, 29):
        ratio = np.trace(np.cov(track.cloud[n].T)) / np.trace(track.covariance[n])
        assert 0.7 < ratio < 1.4, (n, ratio)
    assert np.trace(track.covariance[29]) > 3 * np.trace(track.covariance[11])


def test_progress_counts_every_frame(scene):
    told = []
    run(scene, settings("original"), progress=told.append)
    assert told == list(range(1, 25))


@pytest.mark.parametrize("environment", [None, EMPTY])
def test_without_a_room_complete_falls_back_and_says_so(tmp_path, environment):
    scene = made(tmp_path / "s", 6, environment)
    track = run(scene, settings(), 1)
    assert any("'joint-volume' is taken instead of 'complete'" in line for line in track.warnings)
    assert wrist_text(track) == wrist_text(run(scene, settings("joint-volume"), 1))


def test_the_same_person_is_followed_although_a_stranger_comes_first(tmp_path):
    scene = made(tmp_path / "s", 12, stranger=np.array([1.5, 0.0, 0.0]))
    arm = arm_of(scene.detections)
    assert scene.detections.frame.size == 23
    assert np.abs(arm.p - [arm_at(n) for n in range(12)]).max() < 0.05


def test_a_lone_stranger_is_not_taken_for_the_person():
    here, there = detections_of(4), detections_of(4)
    p = np.concatenate([here.p[:2], there.p[2:] + 3.0])
    arm = arm_of(replace(here, p=p))
    assert np.isfinite(arm.p[:2]).all() and np.isnan(arm.p[2:]).all() and (arm.state[2:] == LOST).all()


def test_a_frame_without_any_detection_is_a_frame_in_which_all_is_lost():
    arm = arm_of(detections_of(5, empty=(0, 3)))
    assert (arm.state[[0, 3]] == LOST).all() and np.isnan(arm.p[[0, 3]]).all() and np.isfinite(arm.p[[1, 2, 4]]).all()


def test_the_other_side_and_a_person_who_is_not_there():
    assert (arm_of(detections_of(3), side="left").state == LOST).all()
    with pytest.raises(InputError, match="person: 4 given"):
        arm_of(detections_of(3), person=4)


def test_settings_are_checked():
    with pytest.raises(InputError, match="--variant: thin"):
        settings_for("thin")
    with pytest.raises(InputError, match="--particles: 3 given; 10 to 1000000"):
        settings_for("original", 3)
    assert settings_for("original").variant == "original"


def test_a_scene_without_frames_is_refused(scene):
    with pytest.raises(InputError, match="no frames"):
        run(replace(scene, depth=()), settings())


def test_the_table_reads_back_what_was_written(scene, tmp_path):
    track = run(scene, settings(), 1, engine="bvh")
    write_wrist(tmp_path / "wrist.csv", track)
    back = read_wrist(tmp_path / "wrist.csv")
    for name in ("time", "mean", "covariance", "volume"):
        assert np.allclose(getattr(back, name), getattr(track, name), rtol=1e-9, atol=1e-12), name
    assert (back.kills == track.kills).all() and (back.status == track.status).all()
    assert set(back.status) <= set(STATUSES) and "nan" not in (tmp_path / "wrist.csv").read_text()
    assert back.cloud.shape == (24, 0, 3) and np.isnan(back.elbow).all()


@pytest.mark.parametrize(
    ("column", "cell", "wanted"),
    [
        ("frame", "7", "line 3: frame: one row for each"),
        ("volume", "-1", "line 3: 0 or more"),
        ("x", "nan", "line 3: x: 'nan' given"),
        ("status", "seen", "line 3: status: 'seen' given"),
        ("time", "0", "line 3: time: 0 after 0"),
        ("killed_depth", "1.5", "line 3: killed_depth"),
    ],
)
def test_a_spoilt_table_is_refused_in_one_line(tmp_path, column, cell, wanted):
    row = ["0", "0", "0", "0", "2", "1", "0", "0", "1", "0", "1", "1", "tracked", "0", "0", "0", "0"]
    second = ["1", "0.1", *row[2:]]
    second[COLUMNS.index(column)] = cell
    (tmp_path / "w.csv").write_text("\n".join(map(",".join, [COLUMNS, row, second])) + "\n")
    with pytest.raises(InputError, match=wanted):
        read_wrist(tmp_path / "w.csv")


def test_nothing_that_is_not_finite_is_ever_written(scene):
    track = run(scene, settings("original"), 1)
    with pytest.raises(ValueError, match="row 2 is not finite"):
        wrist_text(replace(track, volume=np.where(np.arange(24) == 2, np.inf, track.volume)))
    with pytest.raises(ValueError, match="status 'seen' is unknown"):
        wrist_text(replace(track, status=np.where(np.arange(24) == 2, "seen", track.status)))


def test_figures_are_those_of_hidden_frames(scene):
    track, arm = run(scene, settings(), 1, engine="bvh"), arm_of(scene.detections)
    truth = np.stack([arm_at(n)[2] for n in range(24)])
    facts = facts_of(track, arm.state[:, 2], arm.p[:, 2], truth)
    data = facts.as_data()
    assert np.flatnonzero(facts.hidden).tolist() == list(range(10, 20)) and data["hidden_frames"] == 10
    error = np.linalg.norm(track.mean - truth, axis=1)
    assert data["mean_error_hidden_mm"] == pytest.approx(1e3 * error[10:20].mean(), abs=1e-3)
    assert facts.held is not None and np.allclose(facts.held[10:20], np.linalg.norm(arm.p[9, 2] - truth[10:20], axis=1))
    assert "hidden in 10 frames" in facts.sentences()[0] and "%" in facts.sentences()[0]
    bare = facts_of(track, np.zeros(24, int), np.zeros((24, 3)), None)
    assert bare.sentences() == [] and bare.as_data() == {"hidden_frames": 0, "mean_volume_litres": None}


def test_distance_to_a_pill_is_that_of_its_surface():
    robot = RobotVolume(np.array([[[[0.0, 0, 2], [1.0, 0, 2]], [[5.0, 0, 2], [5.0, 0, 2]]]]), np.array([[0.1, 0.2]]))
    p = np.array([[[0.5, 0.3, 2.0], [-0.3, 0.4, 2.0], [0.5, 0.0, 2.0], [5.0, 0.0, 2.5]]])
    assert np.allclose(robot_distance(p, robot), [[0.2, 0.4, -0.1, 0.3]])


def test_a_robot_without_links_has_no_distance(scene):
    track = run(scene, settings("original"), 1)
    nothing = RobotVolume(np.zeros((24, 0, 2, 3)), np.zeros((24, 0)))
    facts = facts_of(track, np.zeros(24, int), np.zeros((24, 3)), None, nothing)
    assert facts.robot is None and "least_distance_to_robot_m" not in facts.as_data()


def test_recovery_counts_frames_from_coming_back():
    tracked = np.array([True, False, True, True, False, True])
    assert recovery(np.array([0, 1, 0.01, 0, 1, 0.2]), tracked) == [1, 2]
    assert recovery(np.zeros(3), np.ones(3, bool)) == []
