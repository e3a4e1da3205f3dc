"""Files of labelled people: what is written comes back, gaps stay gaps, and one clear line for what is malformed."""

import builtins
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handtrack.camera import perspective
from handtrack.errors import InputError
from handtrack.formats.bvh import joint_frames, read_bvh
from handtrack.formats.bvh_writing import bvh_text, write_bvh
from handtrack.formats.c3d_files import c3d_bytes, read_c3d, write_c3d
from handtrack.formats.markers import Markers, read_markers
from handtrack.formats.people import LOST, PREDICTED, SEEN, People, people_text, read_people, write_people
from handtrack.formats.people_markers import UP, courses, people_markers, rate_of
from handtrack.formats.people_scenes import read_people_scene, write_people_scene
from handtrack.formats.skeletons import KEYPOINTS, Detections, TruthPoints
from handtrack.formats.trc import trc_text, write_trc
from synth.people_tasks import TaskSettings, make_task

DATA = Path(__file__).parents[2] / "shared" / "data"


def made_people(frames=6, seed=0) -> People:
    """Two people, labels 3 and 8; 8 comes in frame 2. One wrist is lost for a while and has no place then."""
    rng = np.random.default_rng(seed)
    rows = [(n, who) for n in range(frames) for who in (3, 8) if who == 3 or n >= 2]
    frame, person = np.array(rows).T
    d = frame.size
    p = rng.normal([0.0, 0.0, 3.0], 1.0, (d, 16, 3))
    root = rng.normal(0.0, 0.1, (d, 16, 3, 3))
    covariance = root @ np.swapaxes(root, -1, -2)
    status = rng.choice([SEEN, PREDICTED], (d, 16)).astype(np.int8)
    gone = (person == 8) & (frame >= 4)
    status[gone, 4], p[gone, 4], covariance[gone, 4] = LOST, np.nan, np.nan
    return People(
        np.arange(frames) / 30.0, frame, person, p, np.where(status == SEEN, 0.7, 0.0), covariance, status
    )  # fmt: skip


def changed(people: People, **changes) -> People:
    fields = ("time", "frame", "person", "p", "confidence", "covariance", "status")
    return People(**{name: changes.get(name, getattr(people, name)) for name in fields})


def nobody() -> People:
    empty = np.zeros(0, dtype=int)
    return People(
        np.arange(3) / 30.0, empty, empty, np.zeros((0, 16, 3)), np.zeros((0, 16)), np.zeros((0, 16, 3, 3)),
        np.zeros((0, 16), np.int8),
    )  # fmt: skip


# --- people.csv


@given(st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_people_come_back_from_their_table(tmp_path_factory, seed):
    path = tmp_path_factory.mktemp("p") / "people.csv"
    people = made_people(seed=seed)
    write_people(path, people)
    back = read_people(path)
    for name in ("frame", "person", "status"):
        np.testing.assert_array_equal(getattr(back, name), getattr(people, name))
    for name in ("time", "p", "confidence", "covariance"):
        np.testing.assert_allclose(getattr(back, name), getattr(people, name), rtol=1e-8, atol=1e-12)
    text = path.read_text()
    write_people(path, back)
    assert path.read_text() == text and "nan" not in text


def test_rows_may_come_in_any_order_and_frames_may_be_empty(tmp_path):
    path = tmp_path / "people.csv"
    head, *rows = people_text(made_people()).splitlines()
    rows = [row for row in rows if not row.startswith("1,")]
    path.write_text("\n".join([head, *reversed(rows)]) + "\n")
    back = read_people(path)
    np.testing.assert_allclose(back.time, np.arange(6) / 30.0, atol=1e-9)
    assert 1 not in back.frame
    np.testing.assert_array_equal(np.lexsort((back.person, back.frame)), np.arange(back.frame.size))


def test_an_empty_table_is_nobody(tmp_path):
    path = tmp_path / "people.csv"
    write_people(path, nobody())
    back = read_people(path)
    assert back.p.shape == (0, 16, 3) and back.time.size == 0


def test_a_keypoint_that_is_not_lost_always_has_a_place():
    people = made_people()
    for name in ("p", "covariance", "confidence"):
        values = getattr(people, name).copy()
        values[2, 5] = np.nan
        with pytest.raises(ValueError, match="frame 2, person 3: right_wrist is not finite"):
            people_text(changed(people, **{name: values}))
    with pytest.raises(ValueError, match="time: is not finite"):
        people_text(changed(people, time=np.full(6, np.inf)))
    with pytest.raises(ValueError, match="status: an index into seen, predicted, lost"):
        people_text(changed(people, status=people.status + np.int8(2)))


@pytest.mark.parametrize(
    ("row", "column", "cell", "wanted"),
    [
        (1, 3, "nose", "line 2: keypoint: .*nose.* wanted: left_shoulder"),
        (1, 3, "right_shoulder", "line 2: keypoint: is given twice"),
        (1, 14, "found", "line 2: status: .*found.* wanted: seen, predicted, lost"),
        (1, 4, "", r"line 2: x \.\.\. czz: are wanted for a keypoint that is not lost"),
        (1, 7, "1.5", "line 2: confidence: a number from 0 to 1"),
        (1, 8, "-1", r"line 2: cxx \.\.\. czz: no covariance"),
        (1, 2, "4000", "line 2: person: a number below 1000"),
        (1, 1, "9", "line 2: time: differs within one frame|line 3: time: differs within one frame"),
        (5, 4, "nan", "line 6: x: 'nan' given"),
    ],
)
def test_malformed_tables_are_named(tmp_path, row, column, cell, wanted):
    lines = [line.split(",") for line in people_text(made_people()).splitlines()]
    lines[row][column] = cell
    path = tmp_path / "people.csv"
    path.write_text("\n".join(",".join(line) for line in lines))
    with pytest.raises(InputError, match=wanted):
        read_people(path)


def test_time_rises_and_all_keypoints_are_given(tmp_path):
    path = tmp_path / "people.csv"
    text = people_text(made_people())
    path.write_text(text.replace("\n2,0.06666666667,", "\n2,0.01,"))
    with pytest.raises(InputError, match="time: is not after that of the frame before"):
        read_people(path)
    path.write_text("\n".join(text.splitlines()[:-1]))
    with pytest.raises(InputError, match="some are missing for this frame and person; all 16"):
        read_people(path)


# --- skeletons-1


def test_a_scene_reads_back_and_needs_no_truth_or_camera(tmp_path):
    task = make_task("T0", 0, TaskSettings(frames=4))
    write_people_scene(tmp_path / "a", 30.0, None, task.detections)
    scene = read_people_scene(tmp_path / "a")
    assert scene.camera is None and scene.truth is None and len(scene.files) == 2
    np.testing.assert_allclose(scene.detections.p, task.detections.p, rtol=1e-9)
    assert read_people_scene(tmp_path / "a" / "scene.yaml").fps == 30.0


def test_frames_at_the_end_without_anybody_are_those_of_the_truth(tmp_path):
    task = make_task("T0", 0, TaskSettings(frames=6))
    d = task.detections
    early = d.frame < 4
    few = Detections(d.time, d.frame[early], d.person[early], d.p[early], d.confidence[early], d.state[early])
    write_people_scene(tmp_path / "a", 30.0, task.camera, few, task.truth)
    scene = read_people_scene(tmp_path / "a")
    assert scene.detections.time.size == 6 == scene.truth.p.shape[0] and not scene.warnings  # pyright: ignore
    write_people_scene(tmp_path / "b", 30.0, task.camera, d, TruthPoints(task.truth.p[:3]))
    scene = read_people_scene(tmp_path / "b")
    assert scene.detections.time.size == 6 == scene.truth.p.shape[0]  # pyright: ignore
    assert "has no truth for 3 of 6 frames" in scene.warnings[0]


def scene_with(tmp_path, text, skeletons=True):
    (tmp_path / "scene.yaml").write_text(text)
    if skeletons:
        write_people_scene(tmp_path / "s", 30.0, None, some_detections())
        (tmp_path / "skeletons.csv").write_bytes((tmp_path / "s" / "skeletons.csv").read_bytes())
    return tmp_path


def some_detections() -> Detections:
    zero = np.zeros(1, dtype=int)
    return Detections(
        np.zeros(1), zero, zero, np.ones((1, 16, 3)), np.full((1, 16), 0.5), np.zeros((1, 16), np.int8)
    )  # fmt: skip


def test_a_plain_scene_takes_the_usual_names(tmp_path):
    scene = read_people_scene(scene_with(tmp_path, "format: handtrack/skeletons-1\nfps: 30\n"))
    assert scene.detections.p.shape == (1, 16, 3)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("format: handtrack/rgbd-1\nfps: 30\n", "format"),
        ("format: handtrack/skeletons-1\nfps: 0\n", "fps"),
        ("format: handtrack/skeletons-1\nfps: 30\nskeletons: other.csv\n", "'other.csv' is no file"),
        ("format: handtrack/skeletons-1\nfps: 30\ntruth: ../t.csv\n", "leaves the folder"),
        ("format: handtrack/skeletons-1\nfps: 30\ndepth: x\n", "unknown key 'depth'"),
    ],
)
def test_malformed_scenes_are_named(tmp_path, text, wanted):
    with pytest.raises(InputError, match=wanted):
        read_people_scene(scene_with(tmp_path, text))


def test_a_scene_is_in_camera_axes_and_has_skeletons(tmp_path):
    folder = scene_with(tmp_path, "format: handtrack/skeletons-1\nfps: 30\n", skeletons=False)
    with pytest.raises(InputError, match=r"skeletons\.csv: no such file"):
        read_people_scene(folder)
    moved = perspective(64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(3), np.array([0.0, 0.0, 1.0]))
    write_people_scene(tmp_path / "m", 30.0, moved, some_detections())
    with pytest.raises(InputError, match="is not at the origin"):
        read_people_scene(tmp_path / "m")


# --- markers


def test_markers_have_y_up_millimetres_and_gaps():
    people = made_people()
    markers = people_markers(people)
    assert markers.rate == pytest.approx(30.0) and len(markers.names) == 32
    wrist = markers.names.index("8_left_wrist")
    assert np.isnan(markers.places[:, wrist, 0]).tolist() == [True, True, False, False, True, True]
    at = np.flatnonzero((people.person == 8) & (people.frame == 3))[0]
    np.testing.assert_allclose(markers.places[3, wrist], 1000.0 * people.p[at, 4] * [1.0, -1.0, -1.0])
    assert np.linalg.det(np.diag(UP)) == 1.0  # a turn, not a mirror
    assert rate_of(changed(people, time=people.time[:1])) == 1.0
    label, p = courses(nobody())
    assert label.size == 0 and p.shape == (3, 0, 16, 3)


def test_trc_reads_back_with_its_gaps(tmp_path):
    people = made_people()
    write_trc(tmp_path / "people.trc", people)
    back, made = read_markers(tmp_path / "people.trc"), people_markers(people)
    assert back.names == made.names and back.rate == pytest.approx(made.rate)
    np.testing.assert_allclose(back.places, made.places, rtol=1e-9)
    second = (tmp_path / "people.trc").read_text().splitlines()[6].split("\t")
    assert second[0] == "2" and float(second[1]) == pytest.approx(1 / 30)


def test_c3d_reads_back_with_its_gaps(tmp_path):
    people = made_people()
    write_c3d(tmp_path / "people.c3d", people)
    back, made = read_c3d(tmp_path / "people.c3d"), people_markers(people)
    assert back.names == made.names and back.rate == pytest.approx(made.rate, rel=1e-6)
    np.testing.assert_allclose(back.places, made.places, rtol=2e-7)  # single precision
    again = c3d_bytes(made)
    assert again == (tmp_path / "people.c3d").read_bytes()


def test_the_real_c3d_recording_has_its_markers():
    markers = read_c3d(DATA / "body_markers" / "markers_analogs.c3d")
    assert markers.places.shape == (580, 51, 3) and markers.rate == 100.0
    extent = np.nanmax(markers.places, axis=(0, 1)) - np.nanmin(markers.places, axis=(0, 1))
    assert 500.0 < extent.max() < 3000.0


def test_a_c3d_file_holds_a_crowd(tmp_path):
    crowd = Markers(tuple(f"m{i}" for i in range(600)), np.random.default_rng(0).normal(0, 1e3, (2, 600, 3)), 30.0)
    (tmp_path / "x.c3d").write_bytes(c3d_bytes(crowd))
    back = read_c3d(tmp_path / "x.c3d")
    assert back.names == crowd.names
    np.testing.assert_allclose(back.places, crowd.places, rtol=2e-7)


def test_what_is_no_c3d_is_named(tmp_path):
    path = tmp_path / "x.c3d"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(InputError, match="is no C3D file"):
        read_c3d(path)
    with pytest.raises(InputError, match="no such file"):
        read_c3d(tmp_path / "y.c3d")
    path.write_bytes(c3d_bytes(Markers(("a", "a"), np.ones((2, 2, 3)), 30.0)))
    with pytest.raises(InputError, match="marker 'a' is given twice"):
        read_c3d(path)


def test_a_c3d_file_of_another_unit_or_without_points_is_named(tmp_path):
    path = tmp_path / "x.c3d"
    for unit, factor in (("m", 1000.0), ("cm", 10.0)):
        path.write_bytes(
            c3d_bytes(Markers(("a",), np.full((2, 1, 3), 2.0), 30.0)).replace(b"mm", unit.ljust(2).encode())
        )
        np.testing.assert_allclose(read_c3d(path).places, 2.0 * factor)
    path.write_bytes(c3d_bytes(Markers(("a",), np.ones((2, 1, 3)), 30.0)).replace(b"mm", b"ft"))
    with pytest.raises(InputError, match="its unit is 'ft'; mm, cm, m is wanted"):
        read_c3d(path)
    empty = ezc3d.c3d()
    for kind in ("POINT", "ANALOG"):
        empty["parameters"][kind]["RATE"]["value"] = [30.0]
    empty["parameters"]["ANALOG"]["LABELS"]["value"] = ["force"]
    empty["data"]["analogs"] = np.ones((1, 1, 4))
    empty["data"]["points"] = np.zeros((4, 0, 4))
    empty.write(str(path))
    with pytest.raises(InputError, match="has no markers"):
        read_c3d(path)


def test_c3d_without_its_package_says_how_to_get_it(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "ezc3d":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"pip install handtrack\[c3d\]"):
        write_c3d(tmp_path / "a.c3d", made_people())
    assert not (tmp_path / "a.c3d").exists()


def test_files_of_markers_need_somebody(tmp_path):
    for write in (write_trc, write_c3d):
        with pytest.raises(ValueError, match="got 3 frames of 0 markers"):
            write(tmp_path / "x", nobody())
    with pytest.raises(ValueError, match="time: got 1, wanted 2"):
        trc_text(Markers(("a",), np.ones((2, 1, 3)), 30.0), np.zeros(1), "x")
    with pytest.raises(ValueError, match="nobody with hips, wanted one"):
        write_bvh(tmp_path / "x", nobody())
    assert not list(tmp_path.iterdir())


# --- BVH


def moving_people(frames=20, seed=0) -> People:
    """The true people of a task: their bones keep their lengths, but for the chest's and the hips' shape."""
    truth = make_task("T0", seed, TaskSettings(frames=frames)).truth.p
    frame, person = np.repeat(np.arange(frames), 2), np.tile([0, 1], frames)
    d = frame.size
    eye = np.broadcast_to(1e-4 * np.eye(3), (d, 16, 3, 3))
    time, seen = np.arange(frames) / 30.0, np.zeros((d, 16), np.int8)
    return People(time, frame, person, truth.reshape(d, 16, 3), np.ones((d, 16)), eye, seen)


def places(path) -> dict[str, np.ndarray]:
    bvh = read_bvh(path)
    return dict(zip(bvh.names, np.moveaxis(joint_frames(bvh)[1], 1, 0), strict=True))


def test_skeletons_follow_people(tmp_path):
    people = moving_people()
    write_bvh(tmp_path / "people.bvh", people)
    found, bvh = places(tmp_path / "people.bvh"), read_bvh(tmp_path / "people.bvh")
    assert (bvh.parent == -1).sum() == 2 and bvh.seconds == pytest.approx(1 / 30)
    truth = people.p.reshape(-1, 2, 16, 3) * UP
    for who in (0, 1):
        hips = truth[:, who, KEYPOINTS.index("mid_hip")]
        np.testing.assert_allclose(found[f"{who}_mid_hip"], hips, atol=2e-6)
        for name in ("left_shoulder", "right_elbow", "left_knee"):
            off = np.linalg.norm(found[f"{who}_{name}"] - truth[:, who, KEYPOINTS.index(name)], axis=1)
            assert off.max() < 0.12, name  # the angle between girdle and neck is fixed in rest, and a joint has none
        for a, b in (("left_shoulder", "left_elbow"), ("right_hip", "right_knee"), ("left_elbow", "left_wrist")):
            bone = found[f"{who}_{b}"] - found[f"{who}_{a}"]
            now = truth[:, who, KEYPOINTS.index(b)] - truth[:, who, KEYPOINTS.index(a)]
            cosine = (bone * now).sum(axis=1) / np.linalg.norm(bone, axis=1) / np.linalg.norm(now, axis=1)
            assert cosine.min() > 1.0 - 1e-9


@given(st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_a_skeleton_in_rest_comes_back_however_it_is_turned(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    rest = np.zeros((16, 3))
    for name, place in (
        ("mid_hip", (0, 0, 0)), ("root", (0, 0.1, 0)), ("mid_shoulder", (0, 0.5, 0)), ("head", (0, 0.7, 0)),
        ("left_shoulder", (0.2, 0.5, 0)), ("left_elbow", (0.5, 0.5, 0)), ("left_wrist", (0.7, 0.5, 0)),
        ("right_shoulder", (-0.2, 0.5, 0)), ("right_elbow", (-0.5, 0.5, 0)), ("right_wrist", (-0.7, 0.5, 0)),
        ("left_hip", (0.1, 0, 0)), ("left_knee", (0.1, -0.4, 0)), ("left_ankle", (0.1, -0.8, 0)),
        ("right_hip", (-0.1, 0, 0)), ("right_knee", (-0.1, -0.4, 0)), ("right_ankle", (-0.1, -0.8, 0)),
    ):  # fmt: skip
        rest[KEYPOINTS.index(name)] = place
    turn = Rotation.from_quat(rng.normal(0.0, 1.0, (5, 4))).as_matrix()
    p = (rest @ np.swapaxes(turn, 1, 2) + rng.normal(0, 1, (5, 1, 3))) * UP
    zero = np.zeros(5, dtype=int)
    eye = np.broadcast_to(np.eye(3), (5, 16, 3, 3))
    status = np.zeros((5, 16), np.int8)
    people = People(np.arange(5) / 10.0, np.arange(5), zero, p, np.ones((5, 16)), eye, status)
    path = tmp_path_factory.mktemp("b") / "x.bvh"
    write_bvh(path, people)
    found = places(path)
    for k, name in enumerate(KEYPOINTS):
        np.testing.assert_allclose(found[f"0_{name}"], p[:, k] * UP, atol=1e-5)


def test_a_joint_without_a_place_keeps_its_turn_and_a_limb_never_seen_is_not_there(tmp_path):
    people = moving_people()
    p, status = people.p.copy(), people.status.copy()
    gone = (people.person == 0) & (people.frame >= 10)
    p[gone, KEYPOINTS.index("left_wrist")], status[gone, KEYPOINTS.index("left_wrist")] = np.nan, LOST
    for name in ("right_elbow", "right_wrist", "mid_hip", "mid_shoulder", "root"):
        p[people.person == 0, KEYPOINTS.index(name)] = np.nan
        status[people.person == 0, KEYPOINTS.index(name)] = LOST
    path = tmp_path / "x.bvh"
    write_bvh(path, changed(people, p=p, status=status), person=0)
    bvh = read_bvh(path)
    assert "0_right_elbow" not in bvh.names and "0_right_shoulder_end" in bvh.names
    assert "1_mid_hip" not in bvh.names and "0_root" in bvh.names
    assert np.isfinite(joint_frames(bvh)[1]).all()
    start = sum(map(len, bvh.channels[: bvh.names.index("0_left_elbow")]))
    elbow = bvh.motion[:, start : start + 3]
    assert np.ptp(elbow[9:], axis=0).max() == 0.0 and np.ptp(elbow[:10], axis=0).max() > 0.0
    with pytest.raises(ValueError, match="nobody with hips labelled 9"):
        bvh_text(people, 9)


def test_half_a_turn_is_one_and_who_has_no_hips_is_left_out(tmp_path):
    people = moving_people(4)
    p, status = people.p.copy(), people.status.copy()
    hang = KEYPOINTS.index("left_knee")
    p[:, hang] = p[:, KEYPOINTS.index("left_hip")] - [0.0, 0.4, 0.0]  # a leg straight up
    ankle = KEYPOINTS.index("left_ankle")
    p[:, ankle] = p[:, hang] + [0.0, 0.4, 0.0]  # and its shin straight down again
    for name in ("left_hip", "right_hip", "mid_hip"):
        k = KEYPOINTS.index(name)
        p[people.person == 1, k], status[people.person == 1, k] = np.nan, LOST
    write_bvh(tmp_path / "x.bvh", changed(people, p=p, status=status))
    bvh, found = read_bvh(tmp_path / "x.bvh"), places(tmp_path / "x.bvh")
    assert (bvh.parent == -1).sum() == 1
    shin = found["0_left_ankle"] - found["0_left_knee"]
    np.testing.assert_allclose(shin, np.tile([[0.0, -0.4, 0.0]], (4, 1)), atol=1e-5)


def test_children_that_are_never_seen_together_leave_their_joint_unturned(tmp_path):
    people = moving_people(4)
    p, status = people.p.copy(), people.status.copy()
    for name, frames in (("head", (0, 1)), ("left_shoulder", (2, 3))):
        gone, k = np.isin(people.frame, frames), KEYPOINTS.index(name)
        p[gone, k], status[gone, k] = np.nan, LOST
    write_bvh(tmp_path / "x.bvh", changed(people, p=p, status=status), person=1)
    bvh = read_bvh(tmp_path / "x.bvh")
    start = sum(map(len, bvh.channels[: bvh.names.index("1_mid_shoulder")]))
    assert not bvh.motion[:, start : start + 3].any()


def test_who_is_absent_stays_where_he_was(tmp_path):
    people = moving_people()
    there = ~((people.person == 1) & ((people.frame < 5) | (people.frame > 12)))
    fields = ("frame", "person", "p", "confidence", "covariance", "status")
    some = changed(people, **{name: getattr(people, name)[there] for name in fields})
    write_bvh(tmp_path / "x.bvh", some)
    hips = places(tmp_path / "x.bvh")["1_mid_hip"]
    np.testing.assert_array_equal(hips[:5], np.repeat(hips[5:6], 5, axis=0))
    np.testing.assert_array_equal(hips[13:], np.repeat(hips[12:13], 7, axis=0))
