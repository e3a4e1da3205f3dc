"""Tables, tracks and whole-or-nothing writing."""

import dataclasses
import math
import os
from pathlib import Path

import numpy as np
import pytest

from handtrack.errors import InputError
from handtrack.formats.tables import check_rising, gap_warnings, integers, numbers, read_table, words
from handtrack.formats.tracks import read_track, write_track
from handtrack.formats.truths import read_truth
from handtrack.formats.writing import folder_written_whole, write_bytes, write_text
from handtrack.kinematics import Coupling, FrameRow, Model, model_from_rows
from handtrack.kinematics.builtin import model
from handtrack.track import Track


def table(tmp_path: Path, text: str, needed: tuple[str, ...] = ()):
    (tmp_path / "t.csv").write_bytes(text.encode())
    return read_table(tmp_path / "t.csv", needed)


def test_columns_are_found_by_name_and_byte_order_marks_skipped(tmp_path):
    t = table(tmp_path, '\ufeffframe, x ,"y"\r\n0,1.5,-2e-3\r\n\r\n3, .5 ,4.\r\n', ("frame", "x"))
    assert t.names == ("frame", "x", "y")
    assert integers(t, "frame").tolist() == [0, 3]
    assert numbers(t, "x").tolist() == [1.5, 0.5]
    assert numbers(t, "y").tolist() == [-0.002, 4.0]
    assert t.lines.tolist() == [2, 4]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("x,y\n1,2\n", "line 1: column 'frame' is missing"),
        ("frame,frame\n1,2\n", "line 1: column 'frame' is given twice"),
        ("frame,x\n1\n", "line 2: 1 cells; 2, as in the header"),
        ("frame,x\n1,2\n1,2,3\n", "line 3: 3 cells"),
        ('frame,x\n1,"2\n', "comma separated values are wanted"),
    ],
)
def test_malformed_tables_are_refused_with_their_line(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        table(tmp_path, text, ("frame",))


@pytest.mark.parametrize("cell", ["nan", "inf", "-inf", "1e999", "", "x", "1_000", "0x1", "1 2", "١"])
def test_cells_that_are_no_plain_finite_numbers_are_refused(tmp_path, cell):
    t = table(tmp_path, f"x,y\n1,1\n{cell},1\n")
    with pytest.raises(InputError, match=r"t.csv: line 3: x: .* a finite number is wanted"):
        numbers(t, "x")


def test_empty_cells_are_nan_only_where_allowed(tmp_path):
    values = numbers(table(tmp_path, "x,y\n ,1\n2,1\n"), "x", empty=True)
    np.testing.assert_array_equal(values, [math.nan, 2])


def test_whole_numbers_words_and_order_are_checked(tmp_path):
    t = table(tmp_path, "a,b,c\n1,-1,red\n1.5,2,blue\n")
    for name in ("a", "b"):
        with pytest.raises(InputError, match="a whole number from 0 is wanted"):
            integers(t, name)
    with pytest.raises(InputError, match="line 3: c: 'blue' given; wanted: red, green"):
        words(t, "c", ("red", "green"))
    with pytest.raises(InputError, match="line 3: a: 1 after 1; strictly rising"):
        check_rising(t, "a", np.array([1.0, 1.0]))


def test_gaps_of_over_a_second_are_warned_of(tmp_path):
    t = table(tmp_path, "time\n0\n1\n2.5\n")
    assert gap_warnings(t, np.array([0.0, 1.0, 2.5])) == (f"{t.path}: line 4: 1.5 s pass without a row",)
    assert gap_warnings(t, np.array([0.0, 0.5, 1.5])) == ()
    assert gap_warnings(t, np.array([0.0])) == ()


def track_of(name: str | Model = "two_finger", n: int = 5, views: int = 1) -> Track:
    rng = np.random.default_rng(3)
    hand = model(name) if isinstance(name, str) else name
    j, k, links = len(hand.joint_names), hand.free.size, hand.link_frame.size
    known = rng.normal(size=(n, k, k))
    root = 0.02 * rng.normal(size=(n, j, j))
    covariance = root @ np.swapaxes(root, 1, 2)
    return Track(
        joint_names=hand.joint_names,
        frame=np.arange(n) + 2,
        time=np.arange(n) / 25,
        q=rng.normal(size=(n, j)),
        sigma=np.sqrt(np.einsum("njj->nj", covariance)),
        covariance=covariance,
        information=1e5 * known @ np.swapaxes(known, 1, 2) * (np.arange(n) < n - 1)[:, None, None],
        status=np.array((["tracked", "uncertain", "lost"] * n)[:n]),
        confidence=rng.uniform(size=n),
        residual=np.append(rng.uniform(size=n - 1), math.nan),
        visible=rng.uniform(size=(n, links)),
        edges=np.append(rng.integers(1, 99, n - 1), 0),
        seconds=rng.uniform(size=n),
        view_edges=rng.integers(0, 99, (n, views)) if views > 1 else None,
        view_visible=rng.uniform(size=(n, views, links)) if views > 1 else None,
    )


@pytest.mark.parametrize("name", ["two_finger", "pr", "full_hand"])
def test_a_track_comes_back_from_its_tables(tmp_path, name):
    track = track_of(name)
    write_track(tmp_path, track, model(name))
    again = read_track(tmp_path, model(name))
    assert again.joint_names == track.joint_names
    assert again.status.tolist() == track.status.tolist()
    arrays = [name for name in Track.__slots__ if isinstance(getattr(track, name), np.ndarray) and name != "status"]
    for field in arrays:
        np.testing.assert_allclose(getattr(again, field), getattr(track, field), rtol=1e-9, atol=1e-15, err_msg=field)
    assert again.view_edges is None and again.view_visible is None


def test_the_evidence_of_each_view_comes_back(tmp_path):
    track = track_of(views=3)
    write_track(tmp_path, track)
    again = read_track(tmp_path)
    assert track.view_visible is not None and again.view_visible is not None
    np.testing.assert_array_equal(again.view_edges, track.view_edges)
    np.testing.assert_allclose(again.view_visible, track.view_visible, rtol=1e-9)
    np.testing.assert_allclose(again.visible, track.visible, rtol=1e-9)
    text = (tmp_path / "evidence.csv").read_text()
    (tmp_path / "evidence.csv").write_text(text.replace("view1_visible_2", "view1_other", 1))
    with pytest.raises(InputError, match=r"evidence.csv: line 1: column 'view1_visible_2' is missing"):
        read_track(tmp_path)


def with_rivals(name: str = "two_finger") -> Track:
    track = track_of(name)
    rival = track.q + np.radians(12.0)
    rival[[0, 3]] = math.nan
    return dataclasses.replace(track, rival=rival, rival_weight=np.array([0.0, 0.25, 0.5, 0.0, 0.125]))


@pytest.mark.parametrize("name", ["two_finger", "pr"])
def test_rivals_and_their_weights_come_back(tmp_path, name):
    track = with_rivals(name)
    write_track(tmp_path, track, model(name))
    again = read_track(tmp_path, model(name))
    assert again.rival is not None and track.rival is not None
    np.testing.assert_allclose(again.rival, track.rival, rtol=1e-9)
    np.testing.assert_array_equal(again.rival_weight, track.rival_weight)
    first = (tmp_path / "rivals.csv").read_text().splitlines()[1]
    assert first == "2,0" + "," * len(track.joint_names)


def test_a_track_that_does_not_say_has_no_table_of_rivals(tmp_path):
    write_track(tmp_path, track_of())
    assert not (tmp_path / "rivals.csv").exists()
    assert read_track(tmp_path).rival is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\n3,", "\n7,", "its frames are not those of poses.csv"),
        ("weight", "share", "column 'weight' is missing"),
        (",0.25,", ",1.25,", "line 3: weight: a number from 0 to 1"),
        ("\n2,0,", "\n2,0,1", "line 2: a rival has all joints or none"),
        (",0.25,", ",inf,", "weight: 'inf' given"),
    ],
)
def test_rivals_that_make_no_sense_are_refused(tmp_path, old, new, message):
    write_track(tmp_path, with_rivals())
    text = (tmp_path / "rivals.csv").read_text()
    assert old in text
    (tmp_path / "rivals.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_track(tmp_path)


def test_half_a_rival_or_too_heavy_a_one_is_not_written(tmp_path):
    track = with_rivals()
    assert track.rival is not None
    track.rival[1, 0] = math.nan
    with pytest.raises(ValueError, match="rival of row 1: all joints or none"):
        write_track(tmp_path, track)
    heavy = dataclasses.replace(with_rivals(), rival_weight=np.full(5, 1.5))
    with pytest.raises(ValueError, match="rival of row 0"):
        write_track(tmp_path, heavy)


def test_one_view_has_no_columns_of_its_own(tmp_path):
    track = track_of()
    single = dataclasses.replace(track, view_edges=track.edges[:, None], view_visible=track.visible[:, None])
    write_track(tmp_path, single)
    assert "view0" not in (tmp_path / "evidence.csv").read_text()


def test_information_is_that_of_the_independent_joints_in_one_over_square_degrees(tmp_path):
    rows = [FrameRow(1, 0, joint="pip"), FrameRow(2, 1, a=1.0, joint="dip"), FrameRow(3, 2, a=1.0, joint="tip")]
    coupled = model_from_rows("coupled", rows, [Coupling("dip", "pip", 0.67)])
    track = track_of(coupled)
    with pytest.raises(ValueError, match="information is 2 x 2; wanted that of the 3 independent joints"):
        write_track(tmp_path, track)
    write_track(tmp_path, track, coupled)
    table = read_table(tmp_path / "information.csv")
    assert table.names == ("frame", "pip*pip", "pip*tip", "tip*tip")
    np.testing.assert_allclose(
        numbers(table, "pip*tip"), track.information[:, 0, 1] * math.radians(1) ** 2, rtol=1e-9, atol=1e-15
    )
    for again in (read_track(tmp_path, coupled), read_track(tmp_path)):
        np.testing.assert_allclose(again.information, track.information, rtol=1e-9, atol=1e-9)
    (tmp_path / "information.csv").unlink()
    assert not read_track(tmp_path, coupled).information.any()


def test_poses_are_in_degrees_with_the_columns_of_the_format(tmp_path):
    track = track_of()
    write_track(tmp_path, track)
    lines = (tmp_path / "poses.csv").read_text().splitlines()
    joints = list(track.joint_names)
    assert lines[0].split(",") == ["frame", "time", "status", "confidence", *joints, *(f"{j}_sigma" for j in joints)]
    first = lines[1].split(",")
    assert first[:3] == ["2", "0", "tracked"]
    assert float(first[4]) == pytest.approx(math.degrees(track.q[0, 0]))
    header = (tmp_path / "covariance.csv").read_text().split("\n")[0].split(",")
    assert header[:3] == ["frame", "middle_mcp*middle_mcp", "middle_mcp*middle_pip"]
    assert len(header) == 1 + 21


def test_joints_that_slide_are_written_in_model_units(tmp_path):
    track = track_of("pr")
    write_track(tmp_path, track, model("pr"))
    table = read_table(tmp_path / "poses.csv")
    np.testing.assert_allclose(numbers(table, "d1"), track.q[:, 0], rtol=1e-9)
    np.testing.assert_allclose(numbers(table, "theta2"), np.degrees(track.q[:, 1]), rtol=1e-9)


def test_no_table_but_the_timing_depends_on_the_clock(tmp_path):
    for folder, seconds in (("a", 0.1), ("b", 0.2)):
        track = track_of()
        (tmp_path / folder).mkdir()
        fields = {name: getattr(track, name) for name in Track.__slots__}
        write_track(tmp_path / folder, Track(**{**fields, "seconds": np.full(5, seconds)}))
    for name in ("poses.csv", "covariance.csv", "information.csv", "evidence.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_results_never_hold_nan_or_unknown_words(tmp_path):
    for field in ("q", "sigma", "covariance", "information"):
        track = track_of()
        getattr(track, field)[1] = math.nan
        with pytest.raises(ValueError, match=f"track: {field} of row 1 is not finite"):
            write_track(tmp_path, track)
    track = track_of()
    track.status[0] = "good"
    with pytest.raises(ValueError, match="status 'good' is unknown"):
        write_track(tmp_path, track)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="model: 'rr' has joints"):
        write_track(tmp_path, track_of(), model("rr"))


def test_poses_alone_are_enough_to_read_a_track(tmp_path):
    track = track_of()
    write_track(tmp_path, track)
    for name in ("covariance.csv", "information.csv", "evidence.csv", "timing.csv"):
        (tmp_path / name).unlink()
    again = read_track(tmp_path)
    np.testing.assert_allclose(again.covariance[0], np.diag(track.sigma[0] ** 2), rtol=1e-8)
    assert again.visible.shape == (5, 0)
    assert np.isnan(again.seconds).all()


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("poses.csv", "middle_mcp_sigma", "middle_mcp_error", "<joint>_sigma... are wanted"),
        ("poses.csv", "tracked", "found", "status: 'found' given; wanted: tracked, uncertain, lost"),
        ("poses.csv", "\n3,0.04", "\n3,0", "time: 0 after 0; strictly rising"),
        ("poses.csv", "\n3,", "\n2,", "frame: 2 after 2; strictly rising"),
        ("poses.csv", ",tracked,0.", ",tracked,7.", "confidence: a number from 0 to 1"),
        ("covariance.csv", "\n3,", "\n7,", "its frames are not those of poses.csv"),
        ("information.csv", "\n3,", "\n7,", "its frames are not those of poses.csv"),
        ("information.csv", "middle_mcp*middle_pip", "x", r"column 'middle_mcp\*middle_pip' is missing"),
        ("covariance.csv", "middle_mcp*middle_pip", "x", r"column 'middle_mcp\*middle_pip' is missing"),
    ],
)
def test_tables_that_do_not_fit_are_refused(tmp_path, name, old, new, message):
    write_track(tmp_path, track_of())
    text = (tmp_path / name).read_text()
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_track(tmp_path)


def test_negative_sigmas_and_other_models_are_refused(tmp_path):
    track = track_of()
    track.sigma[2] *= -1
    write_track(tmp_path, track)
    with pytest.raises(InputError, match="a sigma is negative"):
        read_track(tmp_path)
    write_track(tmp_path, track_of())
    with pytest.raises(InputError, match="its joints are not those of model 'rr'"):
        read_track(tmp_path, model("rr"))
    with pytest.raises(InputError, match=r"poses.csv: no such file"):
        read_track(tmp_path / "none")


def test_truth_is_read_in_model_order_with_nan_for_missing_joints(tmp_path):
    (tmp_path / "truth.csv").write_text("frame,theta2,d1\n0,90,3\n2,45,4\n")
    truth, notes = read_truth(tmp_path / "truth.csv", model("pr"), 3)
    np.testing.assert_allclose(truth.q, [[3, math.pi / 2], [4, math.pi / 4]])
    assert truth.frame.tolist() == [0, 2]
    assert notes == (f"{tmp_path / 'truth.csv'}: has no truth for 1 of 3 frames",)
    (tmp_path / "truth.csv").write_text("frame,theta2\n5,90\n")
    truth, notes = read_truth(tmp_path / "truth.csv", model("pr"), 1)
    assert np.isnan(truth.q[:, 0]).all()
    assert "has truth up to frame 5; the sequence ends with frame 0" in notes[1]


def test_files_are_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a ü.txt"
    write_text(path, "first\n")
    write_bytes(path, b"second\n")
    assert path.read_bytes() == b"second\n"
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mode & 0o400


def test_a_failure_while_writing_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    write_text(path, "old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_appears_whole(tmp_path):
    target = tmp_path / "deep" / "run"
    with folder_written_whole(target) as partial:
        (partial / "sub").mkdir()
        (partial / "sub/a.txt").write_text("a")
        assert not target.exists()
    assert (target / "sub/a.txt").read_text() == "a"
    assert [p.name for p in target.parent.iterdir()] == ["run"]


def test_an_interrupted_folder_leaves_nothing(tmp_path):
    def interrupted() -> None:
        with folder_written_whole(tmp_path / "run") as partial:
            (partial / "a.txt").write_text("a")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_an_old_folder_is_replaced_only_when_asked(tmp_path):
    target = tmp_path / "run"
    target.mkdir()
    with folder_written_whole(target) as partial:  # empty: no harm
        (partial / "a.txt").write_text("old")
    with pytest.raises(InputError, match="already exists and is not empty"), folder_written_whole(target):
        pass
    with pytest.raises(RuntimeError, match="stop"), folder_written_whole(target, replace=True):
        raise RuntimeError("stop")
    assert (target / "a.txt").read_text() == "old"
    with folder_written_whole(target, replace=True) as partial:
        (partial / "b.txt").write_text("new")
    assert [p.name for p in target.iterdir()] == ["b.txt"]
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a file; a new or empty folder"), folder_written_whole(tmp_path / "file"):
        pass


def test_an_old_folder_comes_back_if_the_new_one_cannot_take_its_place(tmp_path, monkeypatch):
    target = tmp_path / "run"
    target.mkdir()
    (target / "a.txt").write_text("old")
    rename = Path.rename

    def failing(self: Path, to: Path) -> Path:
        if self.name.endswith(".partial"):
            raise OSError("no")
        return rename(self, to)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(OSError, match="no"), folder_written_whole(target, replace=True) as partial:
        (partial / "b.txt").write_text("new")
    assert (target / "a.txt").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
