"""Claims about Table I of the people paper and the command that prints it beside ours."""

import json
import pickle
from concurrent.futures import ThreadPoolExecutor
from typing import cast

import numpy as np
import pytest

from handtrack.cli import hri
from handtrack.cli.commands import main
from handtrack.cli.hri import METHODS, Job, figure, hri_tasks
from handtrack.reproduce.hri_tasks import (
    GAINS,
    HEADER,
    RAW,
    TASKS,
    THEIRS,
    Trial,
    as_data,
    better,
    comparison,
    gain_rows,
    table_rows,
    theirs,
)
from synth.people_tasks import TaskSettings

TINY = TaskSettings(frames=40)


def trial(task="T0", scale=1.0, inside=0.9, predicted=100.0):
    m = len(METHODS)
    figures = np.outer(np.linspace(1.0, 0.4, m), [0.2, 0.1, 8.0]) * scale
    return Trial(
        task, figures, np.array([np.nan, 1, 1, 1, 2, 2]), np.array([np.nan, 0.2, 0.2, np.nan, inside, inside]),
        np.array([0, 5, 5, 0, predicted, predicted]), np.zeros(m),
    )  # fmt: skip


def table_of(method):
    known = theirs(method)
    assert known is not None
    return known


def test_the_papers_own_improvements_follow_from_its_table():
    """Section IV says 49.33 % of MAE, 71.72 % of STD and 38.04 % of ACC, as means of the tasks' percentages."""
    assert better(table_of("raw"), table_of("paper")) == pytest.approx([49.33, 71.72, 38.04], abs=0.01)
    assert theirs("robust") is None and table_of("raw")[3] == pytest.approx([0.31925, 0.25759, 11.72])


def test_means_are_over_the_recordings_of_each_task_and_a_missing_task_is_unknown():
    result = comparison(METHODS, [trial("T0", 1.0), trial("T0", 3.0), trial("T2", 1.0)])
    assert result.trials == (2, 0, 1, 0) and result.figures[0, 0].tolist() == pytest.approx([0.4, 0.2, 16.0])
    assert result.worst[0, 0] == pytest.approx(0.6) and np.isnan(result.figures[:, 1]).all()
    assert better(result.figures[0], result.figures[-1]).tolist() == pytest.approx([60.0, 60.0, 60.0])
    assert np.isnan(better(result.figures[0], result.figures[0] * np.nan)).all()
    with pytest.raises(ValueError, match="at least one"):
        comparison(METHODS, [])


def test_honesty_is_weighed_by_how_many_were_predicted():
    result = comparison(METHODS, [trial(inside=0.5, predicted=300.0), trial(inside=1.0, predicted=100.0)])
    assert result.inside[-1] == pytest.approx(0.625) and np.isnan(result.inside[0])


def test_theirs_stand_above_ours_and_methods_of_our_own_alone():
    result = comparison(METHODS, [trial(task) for task in TASKS])
    rows = table_rows(result)
    assert [row[:2] for row in rows[:2]] == [["raw skeletons", "theirs"], ["", "ours"]]
    assert len(rows) == len(METHODS) + len(THEIRS) and {len(row) for row in rows} == {len(HEADER)}
    assert rows[0][2:5] == ["67", "163", "12.7"] and rows[0][-1] == "-" and rows[-1][-1] == "2.00"
    gains = gain_rows(result)
    assert {len(row) for row in gains} == {len(GAINS)}
    named = {(row[0], row[1]): row for row in gains}
    assert named["permanence, as in the paper", "theirs"][2:5] == ["49.3", "71.7", "38.0"]
    assert named["permanence, robust", "ours"][2:] == ["60.0", "60.0", "60.0", "90.0", "0"]


def test_without_the_raw_skeletons_there_are_no_gains():
    one = trial()
    few = Trial("T1", one.figures[1:], one.milliseconds[1:], one.inside[1:], one.predicted[1:], one.switches[1:])
    result = comparison(METHODS[1:], [few])
    assert RAW not in result.methods and gain_rows(result)[-1][2] == "-"
    first = cast("list[dict]", as_data(result)["methods"])[0]
    assert np.isnan(first["gain_percent"]).all()


def test_a_tiny_recording_from_end_to_end_is_the_same_with_two_workers(monkeypatch):
    monkeypatch.setattr(hri, "ProcessPoolExecutor", lambda count, mp_context: ThreadPoolExecutor(count))
    counts = []
    one, two = (hri_tasks(1, TINY, 5, ("T0", "T3"), workers, counts.append) for workers in (1, 2))
    assert np.array_equal(one.figures, two.figures, equal_nan=True) and counts == [1, 2, 1, 2]
    assert np.isfinite(one.figures[:, [0, 3]]).all() and one.trials == (1, 0, 0, 1)
    assert (one.milliseconds[1:] > 0).all() and np.isnan(one.milliseconds[0])
    drawn = figure(one)
    assert [axes.get_ylabel()[:3] for axes in drawn.axes] == ["MAE", "STD", "ACC"]


def test_a_recording_that_fails_ends_the_work(monkeypatch):
    monkeypatch.setattr(hri, "ProcessPoolExecutor", lambda count, mp_context: ThreadPoolExecutor(count))
    with pytest.raises(ValueError, match="T9"):
        hri_tasks(2, TINY, 0, ("T9",), 2)


def test_jobs_and_results_travel_to_other_processes_and_back():
    job = Job("T1", 3, TINY)
    assert pickle.loads(pickle.dumps(job)) == job
    assert np.array_equal(pickle.loads(pickle.dumps(trial())).figures, trial().figures)


@pytest.fixture
def quick(monkeypatch):
    """The command without its recordings."""
    told = []
    monkeypatch.setattr(hri, "tried", lambda job: told.append(job) or trial(job.task))
    return told


def test_the_command_prints_tables_or_json_and_draws_bars(quick, tmp_path, capsys):
    given = ["reproduce", "hri-tasks", "--seeds", "2", "--workers", "1", "--first-seed", "7"]
    assert main([*given, "--plot", str(tmp_path / "bars.png")]) == 0
    out = capsys.readouterr().out
    assert "T0 MAE" in out and "theirs" in out and "permanence, robust" in out and "switches" in out
    assert (tmp_path / "bars.png").stat().st_size > 10_000
    assert [(job.task, job.seed) for job in quick] == [(task, seed) for task in TASKS for seed in (7, 8)]
    assert main([*given, "--task", "T3", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["recordings"] == [0, 0, 0, 2] and data["methods"][0]["mae_m"][:3] == [None] * 3
    assert data["paper"][3]["mae_mm"] == [48.89, 96.98, 81.62, 77.47] and quick[-1].settings.frames == 600


@pytest.mark.parametrize(
    ("more", "wanted"),
    [
        (["--seeds", "0"], "--seeds: 0 given"),
        (["--frames", "2"], "--frames: 2 given"),
        (["--first-seed", "-1"], "--first-seed: -1 given"),
        (["--plot", "bars.txt"], "--plot: bars.txt"),
    ],
)
def test_bad_arguments_are_told_before_any_work(quick, capsys, more, wanted):
    assert main(["reproduce", "hri-tasks", "--workers", "1", *more]) == 2
    assert wanted in capsys.readouterr().err and not quick
