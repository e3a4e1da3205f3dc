"""The command line as a user meets it: exit codes, one line for a failure, whole runs or none."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from handtrack.cli import main
from handtrack.cli.rendering import write_scene
from handtrack.errors import InputError
from handtrack.formats.images import read_image
from synth.scenes import two_finger_crossing

ROOT = Path(__file__).resolve().parent.parent
RUN_FILES = {
    "camera.yaml",
    "covariance.csv",
    "evidence.csv",
    "information.csv",
    "model.yaml",
    "overlay.mp4",
    "poses.csv",
    "report.html",
    "rivals.csv",
    "run.json",
    "timing.csv",
    "truth.csv",
    "widths.csv",
}


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rendered") / "ein Fuß 100%"
    write_scene(folder, two_finger_crossing(3, frames=4, size=(320, 240), scale=1.6))
    return folder


@pytest.fixture(scope="module")
def run(clip, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tracked") / "run"
    assert main(["track", str(clip), "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def own_clip(clip, tmp_path):
    """A copy of the clip that a test may spoil, in a folder that holds nothing else."""
    return shutil.copytree(clip, tmp_path / "clip")


def edit(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))


def only_error(capsys):
    """The one line on stderr, which must be an error, and nothing on stdout."""
    said = capsys.readouterr()
    lines = [line for line in said.err.splitlines() if not line.startswith("warning: ")]
    assert said.out == ""
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    return lines[0]


def test_help_loads_neither_compilers_nor_plots():
    code = (
        "import sys; from handtrack.cli import main; main(['--help']); "
        "sys.exit(any(name in sys.modules for name in ('numpy', 'numba', 'cv2', 'matplotlib', 'synth')))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "demo" in done.stdout


def test_every_exported_name_resolves():
    import handtrack

    assert len(dir(handtrack)) > 20
    assert all(getattr(handtrack, name) is not None for name in dir(handtrack))


def test_no_arguments_show_the_help(capsys):
    assert main([]) == 0
    assert "Commands:" in capsys.readouterr().out


def test_version_is_told(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("handtrack ")


def test_a_run_holds_every_file_and_nothing_else(run):
    assert {file.name for file in run.iterdir()} == RUN_FILES
    assert [file.name for file in run.parent.iterdir()] == ["run"]


def test_the_record_names_settings_versions_checksums_and_timings(run):
    record = json.loads((run / "run.json").read_text())
    assert record["format"] == "handtrack/run-1"
    assert record["frames"] == 4
    assert record["settings"]["residuals"] == "outline"
    assert set(record["inputs"]) == {"frames", "sequence.yaml", "model"}
    assert all(len(digest) == 64 for digest in record["inputs"].values())
    assert record["timings"]["tracking_seconds"] > 0
    assert record["start"].keys() == {f"{f}_{j}" for f in ("middle", "index") for j in ("mcp", "pip", "dip")}


def test_the_summary_is_json_where_it_is_wanted(clip, tmp_path, capsys):
    assert main(["track", str(clip), "--out", str(tmp_path / "run"), "--json", "--residuals", "lines"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["frames"] == 4
    assert sum(facts["status"].values()) == 4
    assert Path(facts["report"]).is_file()


def test_the_same_input_gives_the_same_poses(clip, run, tmp_path):
    assert main(["track", str(clip / "sequence.yaml"), "--out", str(tmp_path / "again")]) == 0
    for name in ("poses.csv", "covariance.csv", "evidence.csv", "truth.csv", "camera.yaml", "model.yaml"):
        assert (tmp_path / "again" / name).read_bytes() == (run / name).read_bytes()


def test_evaluation_finds_the_joints_within_a_degree(run, capsys):
    assert main(["evaluate", str(run), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["compared"] == 4
    assert result["worst_rmse"] < 1.0
    assert main(["evaluate", str(run), "--truth", str(run / "truth.csv")]) == 0
    assert "worst joint" in capsys.readouterr().out


def test_an_image_folder_with_model_camera_and_start_is_a_sequence(clip, run, tmp_path, capsys):
    start = json.dumps(json.loads((run / "run.json").read_text())["start"])
    command = ["track", str(clip / "frames"), "--model", str(clip / "model.yaml"), "--camera", str(run / "camera.yaml")]
    assert main([*command, "--start", start, "--fps", "25", "--out", str(tmp_path / "run")]) == 0
    assert (tmp_path / "run" / "poses.csv").read_bytes() == (run / "poses.csv").read_bytes()
    assert not (tmp_path / "run" / "truth.csv").exists()
    capsys.readouterr()
    assert main(["evaluate", str(tmp_path / "run")]) == 2
    assert "--truth" in only_error(capsys)


def test_a_video_is_tracked(clip, run, tmp_path):
    import imageio.v3 as iio

    images = np.stack([iio.imread(file, mode="RGB") for file in sorted((clip / "frames").iterdir())])
    iio.imwrite(tmp_path / "clip.mp4", images, fps=25, codec="libx264")
    (tmp_path / "start.yaml").write_text(f"start: {json.dumps(json.loads((run / 'run.json').read_text())['start'])}\n")
    command = ["track", str(tmp_path / "clip.mp4"), "--model", "two_finger", "--camera", str(clip / "sequence.yaml")]
    assert main([*command, "--start", str(tmp_path / "start.yaml"), "--out", str(tmp_path / "run")]) == 0
    assert len((tmp_path / "run" / "poses.csv").read_text().splitlines()) == 5


def test_an_earlier_run_is_replaced(own_clip, run, tmp_path):
    out = shutil.copytree(run, tmp_path / "runs" / "run")
    (out / "poses.csv").write_text("old")
    assert main(["track", str(own_clip), "--out", str(out)]) == 0
    assert (out / "poses.csv").read_bytes() == (run / "poses.csv").read_bytes()
    assert {file.name for file in out.iterdir()} == RUN_FILES
    assert [file.name for file in out.parent.iterdir()] == ["run"]


def test_a_folder_with_other_files_is_left_alone(clip, tmp_path, capsys):
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "love.txt").write_text("dear")
    assert main(["track", str(clip), "--out", str(tmp_path / "letters")]) == 2
    assert "holds other files" in only_error(capsys)
    assert main(["track", str(clip), "--out", str(tmp_path / "letters" / "love.txt" / "run")]) == 2
    assert "is a file" in only_error(capsys)
    assert [file.name for file in tmp_path.rglob("*")] == ["letters", "love.txt"]


SPOILT = {
    "missing image": (lambda c: shutil.rmtree(c / "frames"), "frames"),
    "broken image": (lambda c: (c / "frames" / "000002.png").write_bytes(b"\x89PNG\r\n\x1a\nno"), "000002.png"),
    "cut image": (lambda c: cut(c / "frames" / "000002.png"), "000002.png"),
    "other size": (lambda c: cv2.imwrite(str(c / "frames" / "000001.png"), np.zeros((9, 9), np.uint8)), "000001.png"),
    "NaN in truth": (lambda c: (c / "truth.csv").write_text("frame,index_mcp\n0,nan\n"), "truth.csv: line 2"),
    "circling model": (lambda c: edit(c / "model.yaml", "id: 2, parent: 1", "id: 2, parent: 3"), "model.yaml: line"),
    "limits reversed": (lambda c: edit(c / "model.yaml", "[-45, 90]", "[90, -45]"), "model.yaml: line"),
    "negative radius": (lambda c: edit(c / "model.yaml", "radius: 10}", "radius: -10}"), "model.yaml: line"),
    "R no rotation": (lambda c: edit(c / "sequence.yaml", "R: [[0.0, 1.0", "R: [[0.0, 1.1"), "sequence.yaml: line"),
    "unknown joint": (lambda c: edit(c / "sequence.yaml", "index_mcp:", "indx_mcp:"), "indx_mcp"),
    "missing model": (lambda c: (c / "model.yaml").unlink(), "model.yaml"),
    "path that leaves": (lambda c: edit(c / "sequence.yaml", "truth.csv", "../truth.csv"), "sequence.yaml: line"),
    "no start": (lambda c: edit(c / "sequence.yaml", "start: ", "# "), "--start"),
}


def cut(file):
    file.write_bytes(file.read_bytes()[:-300])


@pytest.mark.parametrize("name", SPOILT)
def test_bad_input_gives_one_line_exit_code_2_and_leaves_nothing(own_clip, tmp_path, capsys, name):
    spoil, told = SPOILT[name]
    spoil(own_clip)
    before = sorted(tmp_path.rglob("*"))
    assert main(["track", str(own_clip), "--out", str(tmp_path / "deep" / "run")]) == 2
    assert told in only_error(capsys)
    assert sorted(tmp_path.rglob("*")) == before


def test_an_empty_or_missing_folder_is_bad_input(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    for name in ("empty", "missing"):
        assert main(["track", str(tmp_path / name), "--out", str(tmp_path / "run")]) == 2
        assert name in only_error(capsys)
    assert main(["track", str(tmp_path / "empty"), "--model", "index", "--out", str(tmp_path / "run")]) == 2
    assert "--camera" in only_error(capsys)
    assert main(["evaluate", str(tmp_path / "empty")]) == 2
    assert "run.json" in only_error(capsys)


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (["--camera", "c.yaml"], "--camera"),
        (["--theta", "1.5"], "--theta: got 1.5"),
        (["--passes", "0"], "--passes"),
        (["--solver", "magic"], "magic"),
        (["--start", "{index_mcp: fast}"], "--start"),
        (["--start", "missing.yaml"], "missing.yaml"),
        (["--nonsense"], "--nonsense"),
    ],
)
def test_bad_arguments_give_one_line_and_exit_code_2(clip, tmp_path, capsys, more, told):
    assert main(["track", str(clip), "--out", str(tmp_path / "run"), *more]) == 2
    assert told in only_error(capsys)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("failure", "code", "told"),
    [
        (InputError("clip: line 3\nis odd"), 2, "error: clip: line 3 is odd"),
        (OSError(28, "No space left on device", "run/poses.csv"), 1, "error: run/poses.csv: No space left on device"),
        (RuntimeError("worker lost"), 1, "error: RuntimeError: worker lost (--debug shows where)"),
        (KeyboardInterrupt(), 130, "error: interrupted"),
    ],
)
def test_every_failure_has_its_exit_code_and_its_line(monkeypatch, clip, tmp_path, capsys, failure, code, told):
    def fail(*given):
        raise failure

    monkeypatch.setattr("handtrack.cli.record.write_track", fail)
    command = ["track", str(clip), "--out", str(tmp_path / "runs" / "run")]
    assert main(command) == code
    assert capsys.readouterr().err.splitlines()[-1] == told
    assert not any(tmp_path.iterdir())
    main([*command, "--debug"])
    assert ("Traceback" in capsys.readouterr().err) == (code != 130)


def test_what_is_accepted_with_care_is_a_warning_line(own_clip, tmp_path, capsys):
    edit(own_clip / "truth.csv", (own_clip / "truth.csv").read_text(), "frame,index_mcp\n0,1.5\n")
    assert main(["track", str(own_clip), "--out", str(tmp_path / "run")]) == 0
    said = capsys.readouterr().err.splitlines()
    assert [line.split(":")[0] for line in said if "truth" in line] == ["warning"]
    assert main(["evaluate", str(tmp_path / "run")]) == 0


def test_library_warnings_become_warning_lines(monkeypatch, capsys):
    import warnings

    def run(given):
        warnings.warn("odd\nclip", UserWarning, stacklevel=1)
        return 0

    monkeypatch.setattr("handtrack.cli.commands._run", run)
    assert main(["models"]) == 0
    assert capsys.readouterr().err == "warning: odd clip\n"


def test_models_are_listed_shown_and_exported(tmp_path, capsys):
    assert main(["models", "list", "--json"]) == 0
    names = [entry["name"] for entry in json.loads(capsys.readouterr().out)]
    assert "two_finger" in names
    assert main(["models", "list"]) == 0
    assert main(["models", "show", "pr"]) == 0
    assert "theta2" in capsys.readouterr().out
    file = tmp_path / "hand.yaml"
    assert main(["models", "export", "full_hand", "--out", str(file)]) == 0
    assert main(["models", "show", str(file), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["frames"]) > 21
    assert main(["models", "export", "index", "--format", "urdf"]) == 0
    assert "<robot" in capsys.readouterr().out
    assert main(["models", "export", "index", "--out", str(tmp_path / "no" / "hand.yaml")]) == 2
    assert "existing folder" in only_error(capsys)
    assert main(["models", "show", "nobody"]) == 2
    assert "two_finger" in only_error(capsys)


def test_couplings_are_shown_in_the_units_of_files(tmp_path, capsys):
    file = tmp_path / "coupled.yaml"
    assert main(["models", "export", "index", "--out", str(file)]) == 0
    file.write_text(file.read_text() + "couplings:\n  - {joint: index_dip, of: index_pip, ratio: 0.67, offset: 2}\n")
    assert main(["models", "show", str(file)]) == 0
    assert "index_dip = 0.67 index_pip + 2" in capsys.readouterr().out


def test_demo_says_where_the_page_is(tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path / "demo"), "--frames", "3"]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("open in a browser: file:///")
    assert last.endswith("report.html")
    assert sorted(file.name for file in (tmp_path / "demo").iterdir()) == ["run", "two-finger-crossing"]


def test_pose_tables_are_printed_and_given_as_json(capsys):
    assert main(["reproduce", "pose-tables"]) == 0
    assert "3.1" in capsys.readouterr().out
    assert main(["reproduce", "pose-tables", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)) == 6


@pytest.mark.parametrize("variant", ["crossing", "hard"])
def test_occlusion_reports_each_motion_and_the_median(capsys, variant):
    command = ["reproduce", "two-finger-occlusion", "--variant", variant, "--motions", "2", "--frames", "3"]
    assert main([*command, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [motion["seed"] for motion in facts["motions"]] == [0, 1]
    assert facts["worst_rmse_median_deg"] < 5.0
    assert facts["nees_band_95"][0] < facts["nees_dof"] < facts["nees_band_95"][1]
    assert main(command) == 0
    assert "median over 2 motions" in capsys.readouterr().out
    assert main([*command, "--first-seed", "-1"]) == 2
    assert "--first-seed" in only_error(capsys)


def test_bench_compares_each_kernel_with_its_plain_twin(monkeypatch, capsys):
    from handtrack.cli import timings

    measured = timings.measure_all(frames=2, repeats=1)
    assert all(timing.ours_ms > 0 for timing in measured)
    assert sum(timing.ratio is not None for timing in measured) >= 4
    monkeypatch.setattr(timings, "measure_all", lambda frames: measured)
    monkeypatch.setattr(
        "handtrack.cli.wrist_timings.wrist", lambda repeats: [timings.Timing("wrist", 2.0, "tree", 5.0)]
    )
    monkeypatch.setattr("handtrack.cli.people_timings.people", lambda frames: [])
    monkeypatch.setattr("handtrack.cli.posture_timings.posture", lambda repeats: [])
    monkeypatch.setattr("handtrack.cli.walk_timings.walk", lambda repeats: [])
    monkeypatch.setattr("handtrack.cli.label_timings.labels", lambda *_: [timings.Timing("labels", 7.0)])
    assert main(["bench", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert len(rows) == len(measured) + 2 and rows[-2]["ratio"] == 2.5 and rows[-1]["ratio"] is None
    assert main(["bench"]) == 0
    assert "NumPy twin" in capsys.readouterr().out
    monkeypatch.setattr("handtrack.cli.memory.growth_mb", lambda frames: 0.25)
    assert main(["bench", "--memory-frames", "7"]) == 0
    assert "memory over 7 frames: +0.2 MB" in capsys.readouterr().out
    assert main(["bench", "--memory-frames", "7", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[-1] == {"name": "memory over 7 frames", "grown_mb": 0.25}


def test_a_rendered_sequence_can_be_tracked_and_has_its_truth(tmp_path, capsys):
    command = ["render", "--frames", "3", "--seed", "4", "--noise", "1", "--vignette", "0.1"]
    for name in ("a", "b"):
        assert main([*command, "--out", str(tmp_path / name)]) == 0
    files = [file.relative_to(tmp_path / "a") for file in sorted((tmp_path / "a").rglob("*")) if file.is_file()]
    assert [file.name for file in files[:2]] == ["000000.png", "000001.png"]
    assert all((tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes() for file in files)
    assert main(["track", str(tmp_path / "a"), "--out", str(tmp_path / "run")]) == 0
    assert main(["evaluate", str(tmp_path / "run"), "--json"]) == 0
    assert '"compared": 3' in capsys.readouterr().out


@pytest.mark.parametrize("model", ["full_hand", "index_thumb", "pr"])
def test_any_model_is_rendered_whole_and_within_its_limits(tmp_path, model):
    from handtrack.sequences import open_sequence

    command = ["render", "--scene", "random", "--model", model, "--frames", "3", "--colour", "--mode", "flat"]
    assert main([*command, "--out", str(tmp_path / "clip")]) == 0
    sequence = open_sequence(tmp_path / "clip")
    assert sequence.truth is not None
    low, high = sequence.model.limits.T
    assert ((sequence.truth.q >= low - 1e-9) & (sequence.truth.q <= high + 1e-9)).all()
    for image in sequence.frames:
        border = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
        assert image.max() > 40.0 > border.max()


def test_a_background_of_another_size_is_bad_input(tmp_path, capsys):
    cv2.imwrite(str(tmp_path / "wall.png"), np.full((48, 64), 90, np.uint8))
    command = ["render", "--frames", "1", "--out", str(tmp_path / "clip"), "--background"]
    assert main([*command, str(tmp_path / "wall.png")]) == 2
    assert "640 x 480 was wanted" in only_error(capsys)
    cv2.imwrite(str(tmp_path / "wall.png"), np.full((480, 640), 90, np.uint8))
    assert main([*command, str(tmp_path / "wall.png")]) == 0
    assert abs(read_image(tmp_path / "clip" / "frames" / "000000.png")[0, 0] - 90.0) < 12.0
    assert main(["render", "--out", str(tmp_path / "other"), "--scene", "random"]) == 2
    assert "--model" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    "command", [["reproduce", "pose-tables"], ["models", "show", "full_hand"], ["models", "show", "rr"]]
)
def test_what_is_computed_is_also_drawn(command, tmp_path, capsys):
    assert main([*command, "--plot", str(tmp_path / "picture.png")]) == 0
    assert (tmp_path / "picture.png").read_bytes()[:4] == b"\x89PNG"
    assert main([*command, "--plot", str(tmp_path / "picture.txt")]) == 2
    assert "one of .png, .svg, .pdf was wanted" in capsys.readouterr().err


def test_the_occlusion_figures_are_drawn(tmp_path):
    drawn = tmp_path / "occlusion.svg"
    assert main(["reproduce", "two-finger-occlusion", "--motions", "1", "--frames", "3", "--plot", str(drawn)]) == 0
    assert "</svg>" in drawn.read_text()
