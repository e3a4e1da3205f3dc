"""`handtrack explain` as a user meets it: one page, the same pose, one line for what cannot be explained."""

import json
import re
import shutil

import pytest

from handtrack.cli import main
from handtrack.cli.rendering import write_scene
from handtrack.formats.tracks import read_track
from synth.scenes import two_finger_crossing


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rendered") / "clip"
    write_scene(folder, two_finger_crossing(3, frames=3, size=(320, 240), scale=1.6))
    return folder


@pytest.fixture(scope="module")
def tracked(clip, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tracked") / "run"
    assert main(["track", str(clip), "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def run(tracked, tmp_path):
    return shutil.copytree(tracked, tmp_path / "run")


def edit(run, **changes):
    record = json.loads((run / "run.json").read_text())
    record.update(changes)
    (run / "run.json").write_text(json.dumps({key: value for key, value in record.items() if value is not None}))


def errors(capsys):
    return [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]


def test_explain_writes_the_page_into_the_run_and_finds_the_same_pose(run, clip, capsys):
    assert main(["explain", str(run), "2", "--input", str(clip), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["same_pose"] is True
    assert facts["page"] == str(run / "explain-000002.html")
    assert facts["findings"]
    assert (run / "explain-000002.html").stat().st_size < 3_000_000
    assert "warning" not in capsys.readouterr().err


def test_the_record_may_say_where_the_input_is(run, clip, tmp_path, capsys):
    shutil.copytree(clip, tmp_path / "clip")
    edit(run, input="../clip/sequence.yaml")
    page = tmp_path / "page.html"
    assert main(["explain", str(run), "0", "--out", str(page)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(page)
    edit(run, input=["../gone"])
    assert main(["explain", str(run), "0"]) == 2
    assert "--input tells where it is now" in errors(capsys)[0]


def test_images_with_the_runs_own_model_camera_and_start_give_the_same_pose(run, clip, capsys):
    assert main(["explain", str(run), "2", "--input", str(clip / "frames"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["same_pose"] is True


def test_another_start_than_the_sequences_is_that_of_the_run(run, clip, tmp_path, capsys):
    other = shutil.copytree(clip, tmp_path / "clip")
    text = (other / "sequence.yaml").read_text()
    (other / "sequence.yaml").write_text(re.sub(r"index_mcp: [-\d.]+", "index_mcp: 0.5", text, count=1))
    assert main(["explain", str(run), "1", "--input", str(other), "--json"]) == 0
    told = capsys.readouterr()
    assert json.loads(told.out)["same_pose"] is True
    assert "sequence.yaml: changed since the run was made" in told.err


def test_changed_images_and_another_pose_are_warnings_on_page_and_terminal(run, clip, tmp_path, capsys):
    other = shutil.copytree(clip, tmp_path / "clip")
    shutil.copy(other / "frames" / "000000.png", other / "frames" / "000001.png")
    assert main(["explain", str(run), "1", "--input", str(other)]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: ")]
    assert any("frames: changed" in line for line in said)
    assert any("degrees" in line and "poses.csv" in line for line in said)
    assert (run / "explain-000001.html").read_text().count('class="warning"') == 2


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["9"], "FRAME: 9 given"),
        (["x"], "frame"),
        (["1", "--out", "."], "--out"),
        (["1", "--out", "no/page.html"], "--out"),
        (["1", "--input", "missing"], "missing: no such file or folder"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_code_2(run, clip, capsys, monkeypatch, arguments, told):
    monkeypatch.chdir(run.parent)
    given = arguments if "--input" in arguments else [*arguments, "--input", str(clip)]
    assert main(["explain", str(run), *given]) == 2
    lines = errors(capsys)
    assert len(lines) == 1 and told in lines[0]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"format": "other"}, "format: handtrack/run-1"),
        ({"settings": None}, "settings: names and values"),
        ({"fps": "fast"}, "fps: a number"),
        ({"settings": {"magic": 1}}, "'magic'"),
        ({"settings": {"passes": 0}}, "passes: got 0"),
        ({"settings": {"passes": "many"}}, "settings: "),
        ({"input": None}, "--input was wanted"),
    ],
)
def test_a_record_that_cannot_be_used_is_one_line_and_exit_code_2(run, capsys, changes, told):
    edit(run, **changes)
    assert main(["explain", str(run), "1"]) == 2
    assert told in errors(capsys)[0]


def test_a_folder_without_a_record_or_with_a_broken_one_is_no_run(run, tmp_path, capsys):
    assert main(["explain", str(tmp_path), "1"]) == 2
    assert "has no run.json" in errors(capsys)[0]
    (run / "run.json").write_text("{")
    assert main(["explain", str(run), "1"]) == 2
    assert "is no JSON" in errors(capsys)[0]


def test_a_sequence_without_start_uses_that_of_the_run(run, clip, tmp_path, capsys):
    other = shutil.copytree(clip, tmp_path / "clip")
    text = (other / "sequence.yaml").read_text()
    (other / "sequence.yaml").write_text(re.sub(r"(?m)^start:.*\n(?:^  .*\n)*", "", text))
    assert main(["explain", str(run), "1", "--input", str(other), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["same_pose"] is True


def test_poses_are_held_against_those_of_the_run(run, clip, capsys):
    track_now = read_track(run)
    assert track_now.frame.size == 3
    text = (run / "poses.csv").read_text().splitlines()
    cells = text[2].split(",")
    cells[4] = str(float(cells[4]) + 1.0)
    (run / "poses.csv").write_text("\n".join([*text[:2], ",".join(cells), *text[3:]]) + "\n")
    assert main(["explain", str(run), "1", "--input", str(clip)]) == 0
    assert "is 1 degrees off poses.csv" in capsys.readouterr().err
