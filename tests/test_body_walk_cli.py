"""`handtrack body walk` as a user meets it: walks in, whole run folders out, one line for a failure."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from handtrack.cli import drift_walk as command
from handtrack.cli import walk_files, walk_trials
from handtrack.cli.commands import main
from handtrack.cli.walk_trials import METHODS, figure, scored, settings_of
from handtrack.formats.walk_tracks import read_walk_track
from handtrack.formats.walks import read_walk
from handtrack.reproduce.drift_walk import NAMES, comparison
from synth.walk import WalkSettings, make_walk

SHORT = WalkSettings(seconds=8.0)


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulated") / "eine Halle 100%"
    assert main(["body", "simulate-walk", str(folder), "--seed", "4", "--seconds", "12"]) == 0
    return folder


@pytest.fixture(scope="module")
def done(hall, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "run"
    assert main(["body", "walk", str(hall), "--out", str(out), "--method", "eskf"]) == 0
    return out


@pytest.fixture
def own(hall, tmp_path):
    return shutil.copytree(hall, tmp_path / "hall")


def refused(capsys, arguments, wanted):
    assert main(arguments) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(lines) == 1 and wanted in lines[0], lines


def test_a_simulated_walk_is_one_that_is_read(hall):
    walk = read_walk(hall)
    assert walk.frame.size == 61 and walk.truth is not None and not walk.warnings


def test_a_run_holds_tables_record_and_page(done, hall):
    assert {file.name for file in done.iterdir()} == {
        "walk.csv", "posture.csv", "keypoints.csv", "run.json", "report.html",
    }  # fmt: skip
    track, record = read_walk_track(done), json.loads((done / "run.json").read_text())
    assert track.frame.size == record["frames"] == 61 and record["settings"]["method"] == "eskf"
    assert record["inputs"].keys() == {path.name for path in hall.iterdir()}
    assert (done / record["input"]).resolve() == (hall / "walk.yaml").resolve()
    assert record["figures"]["mean_mm"] < record["figures_suit_alone"]["mean_mm"]
    assert "eine Halle 100%" in (done / "report.html").read_text()


def test_the_same_run_again_gives_the_same_tables(done, hall, tmp_path, capsys):
    out = tmp_path / "again"
    assert main(["body", "walk", str(hall / "walk.yaml"), "--out", str(out), "--method", "eskf", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["frames"] == 61 and facts["method"] == "eskf" and facts["median_frame_ms"] > 0
    for name in ("walk.csv", "posture.csv", "keypoints.csv"):
        assert (out / name).read_bytes() == (done / name).read_bytes()


@pytest.mark.parametrize("method", ["drift-ff", "pose-ff", "camera", "suit"])
def test_every_method_gives_a_whole_run(method, hall, tmp_path, capsys):
    assert main(["body", "walk", str(hall), "--out", str(tmp_path / "run"), "--method", method]) == 0
    assert "mean error of the pelvis" in capsys.readouterr().out
    assert read_walk_track(tmp_path / "run").frame.size == 61
    assert ('"raw":null' in (tmp_path / "run/report.html").read_text()) == (method == "suit")


def test_a_walk_without_truth_is_followed_as_well(own, tmp_path, capsys):
    for path in own.glob("truth*"):
        path.unlink()
    given = ["body", "walk", str(own), "--out", str(tmp_path / "run"), "--method", "eskf"]
    assert main(given) == 0 and main(given) == 0, "an earlier run is replaced"
    assert "mean error" not in capsys.readouterr().out


def test_what_is_accepted_with_care_is_told(own, tmp_path, capsys):
    path = own / "truth.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-5]))
    assert main(["body", "walk", str(own), "--out", str(tmp_path / "run"), "--method", "suit"]) == 0
    assert "warning:" in capsys.readouterr().err
    assert "has no truth for 5" in (tmp_path / "run/report.html").read_text()


def test_bad_input_is_told_in_one_line_and_leaves_nothing(own, tmp_path, capsys):
    out = tmp_path / "run"
    path = own / "segments.csv"
    path.write_text(path.read_text().replace(",pelvis,", ",tail,", 1))
    refused(capsys, ["body", "walk", str(own), "--out", str(out)], "segments.csv: line 2")
    refused(capsys, ["body", "walk", str(tmp_path / "none"), "--out", str(out)], "none")
    assert not out.exists()
    (own / "run.txt").write_text("mine")
    path.write_text(path.read_text().replace(",tail,", ",pelvis,", 1))
    refused(capsys, ["body", "walk", str(own), "--out", str(own)], str(own))
    assert {entry.name for entry in tmp_path.iterdir()} == {"hall"}


def test_a_failure_on_the_way_leaves_nothing(hall, tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(walk_files, "write_walk_report", fail)
    assert main(["body", "walk", str(hall), "--out", str(tmp_path / "run"), "--method", "suit"]) == 1
    assert not list(tmp_path.iterdir())


def test_a_simulation_refuses_settings_and_other_peoples_folders(tmp_path, capsys):
    out = tmp_path / "new"
    refused(capsys, ["body", "simulate-walk", str(out), "--seconds", "1"], "--seconds: got 1.0")
    (tmp_path / "file").write_text("mine")
    refused(capsys, ["body", "simulate-walk", str(tmp_path)], "holds other files")
    refused(capsys, ["body", "simulate-walk", str(tmp_path / "file" / "in")], "is a file")
    assert {entry.name for entry in tmp_path.iterdir()} == {"file"}


def test_walks_are_the_same_with_two_workers(monkeypatch):
    monkeypatch.setattr(walk_trials, "ProcessPoolExecutor", lambda count, mp_context: ThreadPoolExecutor(count))
    monkeypatch.setattr(walk_trials, "METHODS", ("eskf", "suit"))
    counts = []
    one, two = (walk_trials.drift_walk(2, SHORT, 5, workers, counts.append) for workers in (1, 2))
    assert np.array_equal(one.means, two.means) and counts == [1, 2, 1, 2] and one.walks == 2
    assert (one.milliseconds > 0).all() and (one.relative[:, 1] < one.hand[:, 1]).all()
    assert len(figure(one).axes[0].lines) == 2


def test_a_walk_that_fails_ends_the_work(monkeypatch):
    monkeypatch.setattr(walk_trials, "ProcessPoolExecutor", lambda count, mp_context: ThreadPoolExecutor(count))

    def fail(job):
        raise ValueError(f"walk {job.seed}")

    monkeypatch.setattr(walk_trials, "tried", fail)
    with pytest.raises(ValueError, match="walk 0"):
        walk_trials.drift_walk(2, SHORT, 0, 2)


def test_every_method_of_the_figures_has_settings():
    assert tuple(NAMES) == METHODS
    methods = [settings_of(name) for name in METHODS]
    assert [each.method for each in methods].count("drift-ff") == 2 and [each.proposal for each in methods].count(
        False
    ) == 1


def test_the_command_prints_tables_or_json_and_draws_laps(monkeypatch, tmp_path, capsys):
    told = []
    trial = scored(make_walk(3, SHORT), ("suit",) * len(METHODS), 3)
    monkeypatch.setattr(walk_trials, "tried", lambda job: told.append(job) or trial)
    given = ["reproduce", "drift-walk", "--seeds", "2", "--workers", "1", "--first-seed", "7", "--seconds", "9"]
    assert main([*given, "--plot", str(tmp_path / "laps.png")]) == 0
    out = capsys.readouterr().out
    for words in ("last/first", "Drift-FF without proposal", "hand, relative", "theirs, in words"):
        assert words in out
    assert (tmp_path / "laps.png").stat().st_size > 10_000 and [job.seed for job in told] == [7, 8]
    assert main([*given, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["walks"] == 2 and told[-1].settings.seconds == 9
    assert comparison(METHODS, [trial]).walks == 1 and command.drift_walk


@pytest.mark.parametrize(
    ("more", "wanted"),
    [
        (["--seeds", "0"], "--seeds: 0 given"),
        (["--seconds", "nan"], "--seconds: nan given"),
        (["--seconds", "1e9"], "--seconds: got"),
        (["--first-seed", "-1"], "--first-seed: -1 given"),
        (["--plot", "laps.txt"], "--plot: laps.txt"),
    ],
)
def test_bad_arguments_are_told_before_any_work(more, wanted, capsys, monkeypatch):
    monkeypatch.setattr(walk_trials, "tried", lambda job: pytest.fail("worked"))
    refused(capsys, ["reproduce", "drift-walk", "--workers", "1", *more], wanted)
