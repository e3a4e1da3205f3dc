"""`handtrack body` as a user meets it: scenes in, whole run folders out, one line for a failure."""

import json
import shutil

import pytest

from handtrack.cli import main
from handtrack.formats.rgbd import read_rgbd
from handtrack.formats.wrists import read_wrist

FEW = ["--particles", "150"]


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulated") / "eine Zelle 100%"
    given = ["body", "simulate", str(folder), "--seed", "4", "--frames", "30", "--fps", "10", "--size", "96", "72"]
    assert main([*given, "--occlusion", "static"]) == 0
    return folder


@pytest.fixture(scope="module")
def done(cell, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tracked") / "run"
    assert main(["body", "wrist", str(cell), "--out", str(folder), *FEW]) == 0
    return folder


@pytest.fixture
def own(cell, tmp_path):
    return shutil.copytree(cell, tmp_path / "cell")


def refused(capsys, arguments, wanted, code=2):
    assert main(arguments) == code
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(lines) == 1 and wanted in lines[0], lines


def test_a_simulated_scene_is_one_that_is_read(cell):
    scene = read_rgbd(cell)
    assert len(scene) == 30 and scene.truth is not None and scene.environment is not None and not scene.warnings
    assert (scene.camera.width, scene.camera.height) == (96, 72) and (cell / "robot.csv").is_file()


def test_a_run_holds_table_record_and_page(done, cell):
    assert {file.name for file in done.iterdir()} == {"wrist.csv", "run.json", "report.html"}
    track, record = read_wrist(done / "wrist.csv"), json.loads((done / "run.json").read_text())
    assert track.time.size == record["frames"] == 30 and sum(record["status"].values()) == 30
    assert record["settings"]["variant"] == "complete" and record["settings"]["sampling"]["particles"] == 150
    assert record["inputs"].keys() >= {"scene.yaml", "skeletons.csv", "environment", "depth", "robot.csv"}
    assert (done / record["input"]).resolve() == (cell / "scene.yaml").resolve()
    assert "eine Zelle 100%" in (done / "report.html").read_text()


def test_the_same_run_again_gives_the_same_bytes(done, cell, tmp_path, capsys):
    assert main(["body", "wrist", str(cell), "--out", str(tmp_path / "again"), *FEW, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (tmp_path / "again/wrist.csv").read_bytes() == (done / "wrist.csv").read_bytes()
    assert facts["frames"] == 30 and facts["figures"]["hidden_frames"] > 0


def test_variants_seeds_and_engines_are_taken(cell, tmp_path, capsys):
    given = ["body", "wrist", str(cell), "--out", str(tmp_path / "run"), *FEW]
    assert main([*given, "--variant", "original", "--seed", "9"]) == 0
    record = json.loads((tmp_path / "run/run.json").read_text())
    assert record["choice"]["seed"] == 9 and record["kills"]["collision"] == record["kills"]["joint_volume"] == 0
    assert main([*given, "--side", "left", "--engine", "bvh"]) == 0
    assert json.loads((tmp_path / "run/run.json").read_text())["choice"]["side"] == "left"
    assert "30 frames" in capsys.readouterr().out


def test_complete_without_a_room_warns_and_goes_on(own, tmp_path, capsys):
    text = (own / "scene.yaml").read_text()
    (own / "scene.yaml").write_text(
        "".join(x for x in text.splitlines(True) if not x.startswith(("environment", "truth")))
    )
    (own / "robot.csv").unlink()
    assert main(["body", "wrist", str(own), "--out", str(tmp_path / "run"), *FEW]) == 0
    assert "warning:" in (err := capsys.readouterr().err) and "'joint-volume' is taken instead of 'complete'" in err
    assert any("joint-volume" in line for line in json.loads((tmp_path / "run/run.json").read_text())["warnings"])


def test_an_earlier_run_is_replaced_but_nothing_else(cell, done, tmp_path, capsys):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "letter.txt").write_text("dear")
    refused(capsys, ["body", "wrist", str(cell), "--out", str(mine)], "holds other files")
    assert [file.name for file in mine.iterdir()] == ["letter.txt"]
    assert main(["body", "wrist", str(cell), "--out", str(shutil.copytree(done, tmp_path / "old")), *FEW]) == 0


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (["--variant", "thin"], "--variant"),
        (["--particles", "3"], "--particles"),
        (["--seed", "-1"], "--seed"),
        (["--person", "5"], "person: 5 given"),
    ],
)
def test_bad_arguments_are_one_line(cell, tmp_path, capsys, arguments, wanted):
    refused(capsys, ["body", "wrist", str(cell), "--out", str(tmp_path / "run"), *arguments], wanted)
    assert not list(tmp_path.iterdir())


def test_bad_scenes_are_one_line_and_leave_nothing(own, tmp_path, capsys):
    out = tmp_path / "run"
    refused(capsys, ["body", "wrist", str(tmp_path / "none"), "--out", str(out)], "no such file or folder")
    (own / "room.ply").write_bytes(b"ply\nno mesh")
    refused(capsys, ["body", "wrist", str(own), "--out", str(out), *FEW], "room.ply")
    (own / "depth/000003.png").write_bytes(b"no image")
    refused(capsys, ["body", "wrist", str(own), "--out", str(out), *FEW], "000003.png")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["cell"]


def test_bad_simulations_are_one_line_and_leave_nothing(cell, tmp_path, capsys):
    refused(capsys, ["body", "simulate", str(tmp_path / "a"), "--fps", "0"], "--fps")
    refused(capsys, ["body", "simulate", str(tmp_path / "a"), "--sensor-offset", "9"], "--sensor_offset: got 9.0")
    refused(capsys, ["body", "simulate", str(tmp_path / "a"), "--motion", str(tmp_path / "none.tsv")], "none.tsv")
    (tmp_path / "file").write_text("")
    refused(capsys, ["body", "simulate", str(tmp_path / "file")], "file: is a file")
    (tmp_path / "b").mkdir()
    (tmp_path / "b/letter.txt").write_text("dear")
    refused(capsys, ["body", "simulate", str(tmp_path / "b")], "holds other files")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["b", "file"]
