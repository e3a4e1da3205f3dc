"""Tables of bodies: what is written reads back, and what a table may not hold is refused with its place."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.errors import InputError
from handtrack.formats.skeletons import (
    INFERRED,
    KEYPOINTS,
    LOST,
    TRACKED,
    Detections,
    TruthPoints,
    read_skeletons,
    read_truth,
    write_skeletons,
    write_truth,
)

HEAD = "frame,time,person,keypoint,x,y,z,confidence"
ROW = "0,0,0,head,0.1,0.2,2,0.9"


def table(tmp_path, *rows, head=HEAD):
    path = tmp_path / "skeletons.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def some_detections(seed=0, frames=6, persons=2):
    rng = np.random.default_rng(seed)
    frame, person = np.repeat(np.arange(frames), persons), np.tile(np.arange(persons), frames)
    shape = (frame.size, 16)
    state = rng.integers(0, 3, shape).astype(np.int8)
    p = np.where((state == LOST)[..., None], np.nan, rng.uniform(-3.0, 3.0, (*shape, 3)))
    confidence = np.where(state == LOST, 0.0, rng.uniform(0.0, 1.0, shape))
    return Detections(np.arange(frames) / 30.0, frame, person, p, confidence, state)


def assert_same(a, b):
    for name in ("time", "frame", "person", "p", "confidence", "state"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-9, atol=1e-12)


def test_detections_read_back_as_written(tmp_path):
    written = some_detections()
    write_skeletons(tmp_path / "s.csv", written, with_state=True)
    back = read_skeletons(tmp_path / "s.csv", 6, 30.0)
    assert_same(written, back)
    assert back.warnings == ()


def test_without_states_what_is_seen_is_tracked(tmp_path):
    written = some_detections()
    write_skeletons(tmp_path / "s.csv", written)
    back = read_skeletons(tmp_path / "s.csv", 6, 30.0)
    np.testing.assert_array_equal(back.state, np.where(written.state == LOST, LOST, TRACKED))


def test_rows_in_any_order_read_the_same(tmp_path):
    write_skeletons(tmp_path / "s.csv", some_detections(), with_state=True)
    head, *rows = (tmp_path / "s.csv").read_text().splitlines()
    np.random.default_rng(1).shuffle(rows)
    assert_same(read_skeletons(table(tmp_path, *rows, head=head), 6, 30.0), some_detections())


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 40), unique=True, min_size=1, max_size=8), st.floats(1.0, 120.0))
def test_frames_without_rows_get_a_rising_time_between_the_others(tmp_path_factory, frames, fps):
    path = tmp_path_factory.mktemp("gap") / "s.csv"
    path.write_text("\n".join([HEAD, *(f"{n},{n / fps!r},0,head,0,0,2,1" for n in frames)]) + "\n")
    time = read_skeletons(path, 41, fps).time
    np.testing.assert_allclose(time, np.arange(41) / fps, atol=1e-9)


def test_a_table_without_rows_is_a_scene_without_people(tmp_path):
    for frames, count in ((5, 5), (None, 0)):
        empty = read_skeletons(table(tmp_path), frames, 10.0)
        assert empty.frame.size == 0 and empty.p.shape == (0, 16, 3)
        np.testing.assert_allclose(empty.time, np.arange(count) / 10.0)


def test_an_unseen_keypoint_is_nan_and_lost(tmp_path):
    seen = read_skeletons(table(tmp_path, ROW, "0,0,0,root,,,,0"), None, 30.0)
    root = KEYPOINTS.index("root")
    assert np.isnan(seen.p[0, root]).all() and seen.confidence[0, root] == 0 and seen.state[0, root] == LOST
    assert seen.state[0, KEYPOINTS.index("head")] == TRACKED


def test_coordinates_of_a_lost_keypoint_are_not_used_and_that_is_said(tmp_path):
    seen = read_skeletons(table(tmp_path, ROW + ",lost", head=HEAD + ",state"), None, 30.0)
    assert np.isnan(seen.p).all() and not seen.confidence.any()
    assert "line 2: coordinates of a lost keypoint are not used" in seen.warnings[0]


def test_an_inferred_keypoint_keeps_its_place(tmp_path):
    seen = read_skeletons(table(tmp_path, ROW + ",inferred", head=HEAD + ",state"), None, 30.0)
    assert seen.state[0, KEYPOINTS.index("head")] == INFERRED and seen.p[0, -1, 2] == 2.0


def test_rows_beyond_the_scene_are_left_out_with_a_warning(tmp_path):
    seen = read_skeletons(table(tmp_path, ROW, "7,0.5,0,head,0,0,2,1"), 3, 30.0)
    assert seen.frame.tolist() == [0] and seen.time.size == 3
    assert "the scene ends with frame 2 and 1 rows are left out" in seen.warnings[0]


def test_a_second_without_rows_is_said(tmp_path):
    seen = read_skeletons(table(tmp_path, ROW, "40,1.5,0,head,0,0,2,1"), None, 30.0)
    assert "line 3: 1.5 s pass without a row" in seen.warnings[0]


@pytest.mark.parametrize(
    ("row", "match"),
    [
        ("0,0,0,nose,0,0,2,1", "line 3: keypoint: 'nose' given; wanted: left_shoulder"),
        ("0,0,0,root,100,200,2000,1", "line 3: x, y, z: beyond 50 m, as if in millimetres; metres are wanted"),
        ("0,0,0,root,1,,2,1", "line 3: x, y, z: only some are given"),
        ("0,0,0,root,nan,0,2,1", "line 3: x: 'nan' given; a finite number or nothing is wanted"),
        ("0,0,0,root,0,0,2,1.5", "line 3: confidence: a number from 0 to 1 is wanted"),
        ("0,0,0,root,0,0,2,", "line 3: confidence: '' given"),
        ("0,0,0,head,0,0,2,1", "line 3: keypoint: is given twice for this frame and person"),
        ("0,0.5,0,root,0,0,2,1", "line 3: time: differs within one frame"),
        ("1,0,0,root,0,0,2,1", "line 3: time: is not after that of the frame before; strictly rising"),
        ("1,-1,0,root,0,0,2,1", "line 3: time: is not after that of the frame before"),
        (
            "1,33.3,0,root,0,0,2,1",
            "time: 33.3 a frame at 30 frames a second, as if in milliseconds; seconds are wanted",
        ),
        ("-1,0,0,root,0,0,2,1", "line 3: frame: '-1' given; a whole number from 0 is wanted"),
        ("0,0,1000,root,0,0,2,1", "line 3: person: 1000 given; a number below 1000 is wanted"),
        ("2000000,9,0,root,0,0,2,1", "line 3: frame: 2000000 given; a number below 1000000 is wanted"),
    ],
)
def test_a_bad_row_is_refused_with_its_line(tmp_path, row, match):
    with pytest.raises(InputError, match=match) as error:
        read_skeletons(table(tmp_path, ROW, row), None, 30.0)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("row", "match"),
    [
        ("0,0,0,root,,,,0,tracked", "line 2: state: 'lost' is wanted where there are no coordinates"),
        ("0,0,0,root,0,0,2,1,seen", "line 2: state: 'seen' given; wanted: tracked, inferred, lost"),
    ],
)
def test_a_bad_state_is_refused(tmp_path, row, match):
    with pytest.raises(InputError, match=match):
        read_skeletons(table(tmp_path, row, head=HEAD + ",state"), None, 30.0)


def test_a_missing_column_is_named(tmp_path):
    with pytest.raises(InputError, match="column 'confidence' is missing"):
        read_skeletons(table(tmp_path, head=HEAD.removesuffix(",confidence")), None, 30.0)


def test_truth_reads_back_as_written(tmp_path):
    p = np.random.default_rng(3).uniform(-3.0, 3.0, (4, 3, 16, 3))
    p[1, 2, 5] = math.nan
    write_truth(tmp_path / "t.csv", TruthPoints(p))
    back = read_truth(tmp_path / "t.csv", 4)
    np.testing.assert_allclose(back.p, p, rtol=1e-9)
    assert back.warnings == ()


def test_truth_that_is_shorter_or_longer_warns(tmp_path):
    write_truth(tmp_path / "t.csv", TruthPoints(np.ones((4, 1, 16, 3))))
    shorter, longer = read_truth(tmp_path / "t.csv", 6), read_truth(tmp_path / "t.csv", 3)
    assert "has no truth for 2 of 6 frames" in shorter.warnings[0] and np.isnan(shorter.p[4:]).all()
    assert "has truth up to frame 3; the scene ends with frame 2" in longer.warnings[0] and longer.p.shape[0] == 3
    assert read_truth(tmp_path / "t.csv").p.shape == (4, 1, 16, 3)


def test_truth_of_absurd_size_is_refused_before_memory_is_taken(tmp_path):
    path = table(tmp_path, "999999,999,head,0,0,2", head="frame,person,keypoint,x,y,z")
    with pytest.raises(InputError, match="1000000 frames of 1000 persons"):
        read_truth(path)
