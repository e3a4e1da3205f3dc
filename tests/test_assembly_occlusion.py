"""`reproduce assembly-occlusion`: figures over made cycles, and two tiny cells from end to end."""

import json
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from handtrack.cli import assembly, main
from handtrack.cli.assembly import assembly_occlusion, figure, variants
from handtrack.errors import InputError
from handtrack.reproduce.assembly_occlusion import HOLD, Cycle, as_data, comparison, table_rows
from synth.cell import CellSettings

TINY = CellSettings(frames=30, fps=10.0, width=80, height=60)


def made(scale=1.0):
    hidden = np.array([False, True, True, False])
    error = np.array([[0.01, 0.2, 0.4, 0.02], [0.01, 0.1, 0.2, 0.2]]) * scale
    square = np.array([[1.0, 9.0, 2.0, 1.0], [1.0, 1.0, 2.0, 1.0]])
    volume = np.array([[1e-4, 1e-2, 3e-2, 1e-4], [1e-4, 1e-3, 3e-3, 1e-4]])
    uncertain = np.array([[False, True, False, False], [False] * 4])
    return Cycle(hidden, ~hidden, np.array([0.0, 0.3, 0.5, 0.0]), error, square, volume, uncertain)


def test_rows_are_means_over_hidden_frames_and_changes_against_the_first():
    result = comparison("static", ["original", "complete"], [made(), made(2.0)])
    first, second, hold = result.rows
    assert result.hidden == 4 and result.cycles == 2 and hold.name == HOLD
    assert (
        first.error == pytest.approx(0.45) and second.error == pytest.approx(0.225) and hold.error == pytest.approx(0.4)
    )
    assert first.volume == pytest.approx(0.02) and (first.inside, second.inside) == (0.5, 1.0)
    assert first.uncertain == 0.5 and (first.recovery, second.slowest) == (1.0, 2.0)
    assert np.allclose(first.cycle_error, [0.3, 0.6]) and np.allclose(second.cycle_volume, [2e-3, 2e-3])
    cells = table_rows(result)
    assert cells[1][:5] == ["complete", "225.0", cells[1][2], "-50.0", "-28.3"] and cells[1][7:9] == ["-90.0", "-90"]
    assert cells[2][5:] == ["-"] * 2 + ["-"] * 6
    assert table_rows(comparison("dynamic", ["original", "complete"], [made()]))[1][4] == "-"


def test_cycles_that_hide_nothing_have_no_figures_but_do_not_fail():
    bare = made()
    bare = Cycle(np.zeros(4, bool), np.ones(4, bool), bare.held, bare.error, bare.square, bare.volume, bare.uncertain)
    result = comparison("static", ["original", "complete"], [bare])
    assert np.isnan(result.rows[0].error) and result.rows[0].cycle_error.size == 0
    assert all(cell == "-" or cell == "nan" for cell in table_rows(result)[1][2:4])


def test_two_tiny_cells_from_end_to_end_are_the_same_with_two_workers(monkeypatch):
    monkeypatch.setattr(assembly, "ProcessPoolExecutor", lambda count, mp_context: ThreadPoolExecutor(count))
    named, counts = variants(100, narrow=8.0)[2:], []
    results = [
        assembly_occlusion(1, named, TINY, 5, kinds, workers, counts.append)
        for kinds, workers in ((("static", "dynamic"), 1), (("static",), 2))
    ]
    data = [json.dumps(as_data(result[:1]), default=lambda array: array.tolist()) for result in results]
    assert data[0] == data[1] and [r.kind for r in results[0]] == ["static", "dynamic"] and counts == [1, 2, 1]
    assert results[0][0].hidden > 0
    assert [row.name for row in results[0][0].rows] == ["complete", "complete, 8 deg", HOLD]
    drawn = figure(results[0])
    assert [axes.get_ylabel()[:6] for axes in drawn.axes] == ["mean e", "volume"] * 2


def test_a_cell_that_fails_ends_the_work(monkeypatch, tmp_path):
    monkeypatch.setattr(assembly, "ProcessPoolExecutor", lambda count, mp_context: ThreadPoolExecutor(count))
    with pytest.raises(InputError, match="none"):
        assembly_occlusion(2, variants(50)[:1], CellSettings(frames=5, motion=tmp_path / "none.tsv"), workers=2)


def test_cells_and_results_travel_to_other_processes_and_back():
    job = assembly.Job(3, TINY, tuple(settings for _, settings in variants()))
    assert pickle.loads(pickle.dumps(job)) == job
    assert np.array_equal(pickle.loads(pickle.dumps(made())).error, made().error)


@pytest.fixture
def quick(monkeypatch):
    """The command without its cells."""
    told = []
    monkeypatch.setattr(assembly, "tracked", lambda job: told.append(job) or made())
    return told


def test_the_command_prints_a_table_or_json_and_draws_boxes(quick, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(assembly, "variants", lambda particles, narrow: variants(50)[:2])
    given = ["reproduce", "assembly-occlusion", "--cycles", "2", "--workers", "1", "--first-seed", "7"]
    assert main([*given, "--plot", str(tmp_path / "boxes.png")]) == 0
    out = capsys.readouterr().out
    assert "static occlusion, 2 cycles, 4 hidden frames" in out and "theirs %" in out and "dynamic" in out
    assert (tmp_path / "boxes.png").stat().st_size > 10_000
    assert [job.seed for job in quick] == [7, 8, 7, 8] and {job.cell.frames for job in quick} == {300}
    assert main([*given, "--occlusion", "static", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["thesis"]["error_change_percent"]["complete"] == -28.3 and len(data["results"]) == 1


@pytest.mark.parametrize(
    ("more", "wanted"),
    [
        (["--cycles", "0"], "--cycles: 0 given"),
        (["--frames", "1"], "--frames: 1 given"),
        (["--narrow", "0"], "--narrow: 0 given"),
        (["--particles", "5"], "--particles: 5 given"),
        (["--plot", "boxes.txt"], "--plot: boxes.txt"),
    ],
)
def test_bad_arguments_are_told_before_any_work(quick, capsys, more, wanted):
    assert main(["reproduce", "assembly-occlusion", "--workers", "1", *more]) == 2
    assert wanted in capsys.readouterr().err and not quick
