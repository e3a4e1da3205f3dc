"""Walk folders and tracks of walks: what is written reads back, and what is no such thing is refused by its place."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handtrack.camera import perspective
from handtrack.errors import InputError
from handtrack.formats.skeletons import KEYPOINTS
from handtrack.formats.walk_tracks import WalkTrack, read_walk_track, walk_texts, write_walk_track
from handtrack.formats.walks import SEGMENTS, Walk, WalkTruth, read_walk, write_walk

CAMERA = perspective(64, 48, 50.0, 50.0, 31.5, 23.5, np.eye(3), np.array([0.0, 0.0, 4.0]), np.array([0.1, 0, 0, 0, 0]))


def unit(rng, *shape):
    q = rng.standard_normal((*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def a_walk(frames=4, seen=3, measurements=(("forearm", 0.25),)):
    """A suit at 5 Hz from frame 2 on, and a camera at 10 Hz."""
    rng = np.random.default_rng(0)
    uv, confidence = rng.uniform(0, 40, (seen, 16, 2)), rng.uniform(0.1, 1.0, (seen, 16))
    uv[1, 3], confidence[1, 3] = np.nan, 0.0
    truth = WalkTruth(rng.standard_normal((frames, 3)), unit(rng, frames), rng.standard_normal((frames, 16, 3)))
    return Walk(
        Path("walk.yaml"), 5.0, CAMERA, 1.8, measurements, np.arange(2, 2 + frames), 0.4 + 0.2 * np.arange(frames),
        0.5 * rng.standard_normal((frames, 13, 3)), unit(rng, frames, 13), np.arange(seen), 0.1 * np.arange(seen), uv,
        confidence, truth,
    )  # fmt: skip


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walk") / "w"
    write_walk(folder, a_walk())
    return folder


@pytest.fixture
def folder(original, tmp_path):
    """A walk folder of its own, to be spoilt."""
    return Path(shutil.copytree(original, tmp_path / "w"))


def write(tmp_path, **changes):
    write_walk(tmp_path / "w", replace(a_walk(), **changes))
    return tmp_path / "w"


def edit(folder, name, old, new, count=1):
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, count))


def test_a_walk_reads_back_as_written(folder):
    walk = a_walk()
    for path in (folder, folder / "walk.yaml"):
        again = read_walk(path)
        assert (again.fps, again.height, again.measurements, again.warnings) == (5.0, 1.8, (("forearm", 0.25),), ())
        for name in ("frame", "time", "p", "wxyz", "camera_frame", "camera_time", "uv", "confidence"):
            np.testing.assert_allclose(getattr(again, name), getattr(walk, name), rtol=1e-9, atol=1e-9, err_msg=name)
        assert again.truth is not None and walk.truth is not None
        for name in ("p", "wxyz", "keypoints"):
            np.testing.assert_allclose(getattr(again.truth, name), getattr(walk.truth, name), rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(again.camera.distortion, CAMERA.distortion)


def test_a_walk_may_lack_its_truth_and_measurements(tmp_path):
    folder = write(tmp_path, truth=None, measurements=())
    walk = read_walk(folder)
    assert walk.truth is None and walk.measurements == ()
    assert not (folder / "truth.csv").exists()


def test_missing_samples_and_whole_missing_frames_are_not_a_number_and_their_times_filled_in(tmp_path):
    walk = a_walk()
    p, wxyz = walk.p.copy(), walk.wxyz.copy()
    p[1], wxyz[1] = np.nan, np.nan
    p[2, 7], wxyz[2, 7] = np.nan, np.nan
    again = read_walk(write(tmp_path, p=p, wxyz=wxyz))
    assert again.frame.tolist() == [2, 3, 4, 5]
    np.testing.assert_allclose(again.time, walk.time)
    np.testing.assert_array_equal(np.isnan(again.p).any(axis=-1), np.isnan(p).any(axis=-1))


def test_rows_may_come_in_any_order(folder):
    before = read_walk(folder)
    for name in ("segments.csv", "keypoints2d.csv", "truth.csv", "truth_keypoints.csv"):
        head, *rows = (folder / name).read_text().splitlines()
        order = np.random.default_rng(1).permutation(len(rows))
        (folder / name).write_text("\n".join([head, *(rows[i] for i in order)]) + "\n")
    after = read_walk(folder)
    for name in ("time", "p", "wxyz", "uv", "confidence"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


def test_quaternions_are_made_unit_and_a_confidence_of_zero_hides_a_keypoint(folder):
    walk = read_walk(folder)
    edit(folder, "keypoints2d.csv", f",{walk.confidence[0, 0]:.10g}\n", ",0\n")
    q = ",".join(f"{value:.10g}" for value in walk.wxyz[0, 0])
    edit(folder, "segments.csv", q, ",".join(f"{1.004 * value:.10g}" for value in walk.wxyz[0, 0]))
    again = read_walk(folder)
    assert np.isnan(again.uv[0, 0]).all() and again.confidence[0, 0] == 0.0
    np.testing.assert_allclose(np.linalg.norm(again.wxyz, axis=-1), 1.0, atol=1e-12)


def test_segments_of_other_suits_are_left_out_with_a_warning(folder):
    edit(folder, "segments.csv", "qw,qx,qy,qz\n", "qw,qx,qy,qz\n2,0.4,left_hand,0,0,0,1,0,0,0\n")
    walk = read_walk(folder)
    assert "segment 'left_hand' and its like are not used" in walk.warnings[0]
    np.testing.assert_allclose(walk.p, a_walk().p, atol=1e-9)


def test_a_gap_and_truth_of_other_frames_warn(folder):
    edit(folder, "segments.csv", "\n5,1,", "\n5,2.9,", count=-1)
    rows = (folder / "truth.csv").read_text().splitlines()
    (folder / "truth.csv").write_text("\n".join([*rows[:3], "77," + rows[3].split(",", 1)[1]]) + "\n")
    text = "\n".join(read_walk(folder).warnings)
    assert "2.1 s pass without a row" in text
    assert "has no truth for 2 of 4 frames" in text and "1 rows are left out" in text


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("walk.yaml", "handtrack/walk-1", "handtrack/walk-9", "format"),
        ("walk.yaml", "height_m: 1.8", "height_m: 180", "height_m"),
        ("walk.yaml", "forearm: 0.25", "forearm: -1.0", "forearm"),
        ("walk.yaml", "forearm: 0.25", "tail: 0.25", "unknown key 'tail'"),
        ("walk.yaml", "fps: 5.0", "fps: 0", "fps"),
        ("segments.csv", "left_foot", "left_wing", "segment: 'left_wing' given; wanted: pelvis"),
        ("segments.csv", "qw,qx", "qw,qq", "column 'qx' is missing"),
        ("keypoints2d.csv", "left_knee", "left_tail", "keypoint: 'left_tail' given"),
        ("truth_keypoints.csv", "left_knee", "left_tail", "keypoint: 'left_tail' given"),
    ],
)
def test_what_is_no_walk_is_refused_with_its_place(folder, name, old, new, message):
    edit(folder, name, old, new)
    with pytest.raises(InputError, match=message) as error:
        read_walk(folder)
    assert name in str(error.value) and "\n" not in str(error.value)


ROW = "2,0.4,pelvis,0,0,1,1,0,0,0"


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "has a header and no row"),
        (["2,0.4,pelvis,0,0,1,1,,0,0"], r"line 2: x \.\.\. qz: only some are given"),
        (["2,0.4,pelvis,0,0,1,2,0,0,0"], "line 2: qw, qx, qy, qz: a unit quaternion"),
        (["2,0.4,pelvis,0,0,1,0,0,0,0"], "line 2: qw, qx, qy, qz: a unit quaternion"),
        ([ROW, ROW], "line 3: segment: is given twice"),
        ([ROW, "2,0.5,head,0,0,1,1,0,0,0"], "line 3: time: differs within one frame"),
        ([ROW, "3,0.4,pelvis,0,0,1,1,0,0,0"], "line 3: time: is not after"),
        ([ROW, "3,200.4,pelvis,0,0,1,1,0,0,0"], "as if in milliseconds; seconds are wanted"),
        ([ROW, "2,0.4,head,0,0,1500,1,0,0,0"], "as if in millimetres; metres are wanted"),
        (["2,0.4,pelvis,0,0,1e9,1,0,0,0"], "line 2: x, y, z: beyond"),
        (["9999999,0.4,pelvis,0,0,1,1,0,0,0"], "line 2: frame: a number below 1000000"),
        (["2,0.4,pelvis,0,0,nan,1,0,0,0"], "line 2: z: 'nan' given"),
    ],
)
def test_a_malformed_suit_is_refused_with_its_line(folder, rows, message):
    head = (folder / "segments.csv").read_text().splitlines()[0]
    (folder / "segments.csv").write_text("\n".join([head, *rows]) + "\n")
    with pytest.raises(InputError, match=message):
        read_walk(folder)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0,0,left_knee,3,,0.5", "line 2: u, v: only one is given"),
        ("0,0,left_knee,3,4,1.5", "line 2: confidence: a number from 0 to 1"),
        ("0,0,left_knee,3,1e9,0.5", "line 2: u, v: beyond"),
    ],
)
def test_a_malformed_camera_table_is_refused_with_its_line(folder, row, message):
    (folder / "keypoints2d.csv").write_text(f"frame,time,keypoint,u,v,confidence\n{row}\n")
    with pytest.raises(InputError, match=message):
        read_walk(folder)


def test_truth_whose_quaternions_are_no_rotations_is_refused(folder):
    (folder / "truth.csv").write_text("frame,pelvis_x,pelvis_y,pelvis_z,qw,qx,qy,qz\n2,0,0,0,0,0,0,0\n")
    with pytest.raises(InputError, match=r"truth\.csv: line 2: qw, qx, qy, qz"):
        read_walk(folder)


def test_truth_without_keypoints_leaves_them_unknown(folder):
    (folder / "truth_keypoints.csv").unlink()
    truth = read_walk(folder).truth
    assert truth is not None and np.isnan(truth.keypoints).all() and np.isfinite(truth.p).all()


def test_a_folder_that_is_not_empty_stays_as_it_is_unless_it_may_be_replaced(folder):
    with pytest.raises(InputError, match="already exists and is not empty"):
        write_walk(folder, a_walk())
    write_walk(folder, replace(a_walk(), height=1.6), replace=True)
    assert read_walk(folder).height == 1.6


def a_track(frames=3):
    rng = np.random.default_rng(2)
    return WalkTrack(
        frame=np.arange(2, 2 + frames),
        time=0.2 * np.arange(2, 2 + frames),
        p=rng.standard_normal((frames, 3)),
        wxyz=unit(rng, frames),
        sigma=rng.uniform(0.01, 0.1, (frames, 3)),
        sigma_heading=rng.uniform(0.01, 0.1, frames),
        joint_names=("left_knee", "right_knee"),
        posture=rng.standard_normal((frames, 2)),
        sigma_posture=rng.uniform(0.0, 0.1, (frames, 2)),
        keypoints=rng.standard_normal((frames, 16, 3)),
        in_view=np.arange(frames) % 2 == 0,
        status=np.array(["tracked", "predicted", "lost"])[:frames],
        seconds=np.full(frames, 0.01),
    )


def test_a_track_reads_back_as_written(tmp_path):
    write_walk_track(tmp_path, a_track())
    track, again = a_track(), read_walk_track(tmp_path)
    assert again.joint_names == track.joint_names and np.isnan(again.seconds).all()
    assert again.status.tolist() == track.status.tolist() and again.in_view.tolist() == track.in_view.tolist()
    names = ("frame", "time", "p", "wxyz", "sigma", "sigma_heading", "posture", "sigma_posture", "keypoints")
    for name in names:
        np.testing.assert_allclose(getattr(again, name), getattr(track, name), rtol=1e-8, atol=1e-9, err_msg=name)


def test_the_header_begins_as_the_format_says_and_angles_are_degrees():
    walk, posture, points = walk_texts(a_track())
    assert walk.startswith("frame,pelvis_x,pelvis_y,pelvis_z,qw,qx,qy,qz,sx,sy,sz,")
    head, row, *_ = posture.splitlines()
    assert head == "frame,left_knee,right_knee,left_knee_sigma,right_knee_sigma"
    assert float(row.split(",")[1]) == pytest.approx(np.degrees(a_track().posture[0, 0]))
    assert points.splitlines()[1].startswith(f"2,{KEYPOINTS[0]},") and len(SEGMENTS) == 13


@pytest.mark.parametrize("name", ["p", "sigma", "posture", "keypoints", "sigma_heading"])
def test_a_result_never_holds_what_is_no_number(name):
    values = getattr(a_track(), name).copy()
    values[1] = np.nan
    with pytest.raises(ValueError, match=f"track: {name}: row 1 is not finite"):
        walk_texts(replace(a_track(), **{name: values}))


def test_an_unknown_status_is_refused():
    with pytest.raises(ValueError, match="status 'asleep' is unknown; wanted: tracked"):
        walk_texts(replace(a_track(), status=np.array(["asleep"] * 3)))


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("walk.csv", ",0,predicted", ",2,predicted", "in_view: 0 or 1"),
        ("walk.csv", "predicted", "guessed", "status: 'guessed' given"),
        ("walk.csv", "\n3,", "\n2,", "frame: 2 after 2"),
        ("posture.csv", "right_knee_sigma", "right_knee_spread", "the same joints with '_sigma'"),
        ("posture.csv", "\n3,", "\n9,", "frames are not those of walk.csv"),
        ("keypoints.csv", "right_knee", "left_knee", "all 16 keypoints are wanted once"),
        ("keypoints.csv", "\n3,", "\n4,", "frames are not those of walk.csv"),
    ],
)
def test_a_malformed_track_is_refused(tmp_path, name, old, new, message):
    write_walk_track(tmp_path, a_track())
    edit(tmp_path, name, old, new)
    with pytest.raises(InputError, match=message):
        read_walk_track(tmp_path)


def test_a_negative_sigma_is_refused(tmp_path):
    write_walk_track(tmp_path, replace(a_track(), sigma=-a_track().sigma))
    with pytest.raises(InputError, match="sx, sy, sz: 0 or more"):
        read_walk_track(tmp_path)
