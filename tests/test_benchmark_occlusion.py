"""The figures of hidden and of lost fingers are what they say, and the commands print them."""

import json

import numpy as np
import pytest

from handtrack.cli import main
from handtrack.cli.loss_trials import LossJob, finger_scores, followed, loss_figure, loss_suite, loss_tried, told
from handtrack.cli.occlusion_trials import Job, all_tried, figure, script_of, suite, tracked, tried
from handtrack.reproduce.hidden_fingers import (
    HEADER,
    Run,
    Script,
    as_data,
    found_again,
    frames_text,
    summed,
    swapped,
    table_rows,
    trial,
)
from handtrack.reproduce.loss_detection import HEADER as LOSS_HEADER
from handtrack.reproduce.loss_detection import (
    LossRun,
    by_kind,
    calm,
    delays,
    held,
    lost,
    neighbours_told,
    pooled,
    returns,
    roc,
    status_shares,
    threshold_at,
    told_at,
)
from handtrack.reproduce.loss_detection import as_data as loss_data
from handtrack.reproduce.loss_detection import table_rows as loss_rows
from handtrack.reproduce.total_occlusion import claim_rows, claims
from handtrack.residuals import chain
from handtrack.settings import Settings
from handtrack.tracker import begin, step
from synth.loss_scenes import loss_picture, loss_scene
from synth.occlusion_scenes import occlusion_scene

DEG = np.pi / 180.0
FINGERS = np.repeat(np.eye(2, dtype=bool), 3, axis=1)


def script(n=20, first=5, last=10, watched=0, kind="hidden"):
    """Two fingers 20 degrees apart; the watched one is hidden in frames first..last, then shows more each frame."""
    number = np.arange(n)
    hidden = (number >= first) & (number <= last)
    share = np.where(hidden, 0.0, np.where(number > last, 0.06 * (number - last), 1.0))
    truth = np.tile(np.array([0.0, 0, 0, 20, 20, 20]) * DEG, (n, 1))
    return Script(kind, int(hidden.sum()), 0, truth, FINGERS, watched, share, hidden)


def run(off: float | np.ndarray = 0.0, sigma=1.0, n=20):
    """A run that is off by so many degrees (anything that broadcasts to (n, 6))."""
    q = script(n).truth + np.broadcast_to(np.asarray(off, dtype=float) * DEG, (n, 6))
    return Run(q, np.tile(np.eye(6) * (sigma * DEG) ** 2, (n, 1, 1)), 0.003)


def test_error_and_nees_are_those_of_the_hidden_finger_in_the_hidden_frames():
    off = np.zeros((20, 6))
    off[5:11, :3] = 2.0
    off[:, 3:] = 0.5
    found = trial(script(), run(off))
    np.testing.assert_allclose(found.off, np.full((6, 3), 2.0 * DEG))
    np.testing.assert_allclose(found.nees, 12.0)
    np.testing.assert_allclose(found.others, 0.5 * DEG)
    assert not found.swapped and found.back.tolist() == [0.0]


def test_right_sigmas_hold_the_error_in_their_ellipsoid_as_often_as_two_sigmas_should():
    rng = np.random.default_rng(5)
    trials = [trial(script(), run(rng.standard_normal((20, 6)))) for _ in range(300)]
    (row,) = summed(trials)
    assert abs(row.inside - 0.9545) < 0.015 and abs(row.inside_joints - 0.9545) < 0.01
    assert abs(row.nees - 3.0) < 0.15 and row.joints == 3 and row.hidden == 1800
    (tight,) = summed([trial(script(), run(rng.standard_normal((20, 6)), sigma=0.5)) for _ in range(50)])
    assert tight.inside < 0.6 and tight.nees > 9.0


def test_a_finger_is_found_when_all_its_joints_are_near_and_stay():
    share = script().share
    hidden = share == 0.0
    worst = np.full(20, 20.0 * DEG)
    assert np.isinf(found_again(worst, share, hidden)).all()
    worst[14:] = 0.0
    assert found_again(worst, share, hidden).tolist() == [2.0], "a tenth is seen from frame 12 on"
    worst[15] = 20.0 * DEG
    assert found_again(worst, share, hidden).tolist() == [4.0], "a moment's luck does not count"
    assert found_again(worst, np.where(hidden, 0.0, 0.05), hidden).size == 0, "it never comes back"
    twice = hidden | (np.arange(20) == 15)
    assert found_again(np.zeros(20), np.where(twice, 0.0, 1.0), twice).tolist() == [0.0, 0.0]


def test_exchanged_fingers_are_swapped_and_two_on_one_finger_are_not():
    exchanged, both_on_one = script().truth.copy(), script().truth.copy()
    exchanged[11:] = np.roll(exchanged[11:], 3, axis=1)
    both_on_one[11:, :3] = both_on_one[11:, 3:]
    assert swapped(script(), exchanged) and not swapped(script(), both_on_one)
    assert not swapped(script(), script().truth)
    exchanged[:] = script().truth
    exchanged[11:16] = np.roll(exchanged[11:16], 3, axis=1)
    assert not swapped(script(), exchanged), "a swap that is undone soon is none"
    never = script(first=30, last=40)
    assert not swapped(never, np.roll(never.truth, 3, axis=1))


def test_a_row_counts_runs_that_found_the_finger_and_kept_its_name():
    late, gone, wrong = np.zeros((20, 6)), np.zeros((20, 6)), np.zeros((20, 6))
    late[8:17, :3] = 8.0
    gone[8:, :3] = 9.0
    wrong[8:, :3], wrong[8:, 3:] = 20.0, -20.0
    rows = summed([trial(script(), run(off)) for off in (0.0, late, gone, wrong)])
    assert (rows[0].runs, rows[0].prompt, rows[0].lost, rows[0].swaps) == (4, 1, 2, 1)
    assert rows[0].back == 5.0 and np.isinf(rows[0].back_90)
    cells = dict(zip(HEADER, table_rows(rows)[0], strict=True))
    assert cells["90 %"] == "never" and cells["back"] == "5" and cells["runs"] == 4
    data = json.loads(json.dumps(as_data(rows, [trial(script(), run())]), default=lambda a: a.tolist()))
    assert data["scenes"][0]["found_promptly"] == 1 and data["runs"][0]["swapped"] is False


def test_what_the_thesis_says_stands_beside_each_length():
    rows = summed([trial(script(), run()), trial(script(kind="crossing"), run(1.0))])
    found = claims(rows)
    assert [each.scene for each in found] == ["hidden 6"] * 3 + ["crossing 6"]
    assert "in 1 of 1 runs" in found[0].ours and "swapped in 0 of 1" in found[1].ours and "1.00 deg" in found[3].ours
    assert all(len(row) == 3 for row in claim_rows(rows))


def test_the_roc_of_scores_that_tell_nothing_is_a_diagonal_and_of_sure_ones_a_step():
    rng = np.random.default_rng(2)
    same = roc(rng.random(4000), rng.random(4000))
    assert abs(same.area - 0.5) < 0.02 and abs(told_at(same, 0.2) - 0.2) < 0.03
    sure = roc(1.0 + rng.random(50), rng.random(50))
    assert sure.area == 1.0 and told_at(sure, 0.0) == 1.0 and threshold_at(sure) < 1.0 + 0.5
    assert np.isneginf(threshold_at(roc(np.zeros(4), np.ones(4)))) and told_at(roc(np.zeros(4), np.ones(4))) == 0.0
    with pytest.raises(ValueError, match="at least one of each"):
        roc(np.zeros(0), np.ones(3))


def loss_run(worst, score, kind="cut", at=5, until=10, dark=()):
    """One finger."""
    n = len(worst)
    where = np.isin(np.arange(n), dark)
    column = np.array(worst, dtype=float)[:, None] * DEG
    return LossRun(kind, at, until, column, np.array(score, dtype=float)[:, None], np.array([True]), where, where)


def test_the_delay_runs_from_the_first_lost_frame_to_the_first_low_score():
    worst = [0.0] * 6 + [20.0] * 10
    one = loss_run(worst, [1.0] * 9 + [0.1] * 7)
    assert delays(one, 0.5)[0].tolist() == [3.0] and delays(one, 0.05)[0].tolist() == [np.inf]
    assert lost(one).sum() == 10 and held(one).sum() == 6


def test_a_finger_held_again_before_it_is_told_needed_no_telling():
    short = loss_run([0.0] * 6 + [20.0] * 2 + [0.0] * 8, [1.0] * 16)
    assert delays(short, 0.5)[0].size == 0 and delays(short, 0.5)[1] == 1
    never = loss_run([0.0] * 16, [1.0] * 16)
    assert delays(never, 0.5)[1] == 1
    long = loss_run([0.0] * 6 + [20.0] * 8 + [0.0] * 2, [1.0] * 16)
    assert np.isinf(delays(long, 0.5)[0]).all(), "eight frames are too long to say nothing"


def test_a_finger_has_come_back_when_it_is_held_to_the_end():
    assert returns(loss_run([20.0] * 12 + [0.0] * 4, [1.0] * 16)).tolist() == [2.0]
    assert returns(loss_run([20.0] * 12 + [0.0] * 4, [1.0] * 16, kind="jump", at=5)).tolist() == [7.0]
    assert np.isinf(returns(loss_run([0.0] * 14 + [20.0] * 2, [1.0] * 16))).all()
    assert np.isinf(returns(loss_run([20.0] * 14 + [0.0] * 2, [1.0] * 16))).all(), "too short to say"
    assert returns(loss_run([0.0] * 16, [1.0] * 16)).tolist() == [0.0]


def test_a_covered_camera_has_lost_every_finger_wherever_it_is():
    dark = loss_run([0.0] * 16, [1.0] * 16, kind="covered", dark=(5, 6, 7))
    assert lost(dark)[5:8].all() and lost(dark).sum() == 3 and not held(dark)[5:8].any()
    assert status_shares([dark]) == (0.0, 1.0)


def test_a_held_finger_beside_a_lost_one_is_no_false_alarm_but_counted():
    one = loss_run([0.0] * 6 + [20.0] * 10, [0.9] * 6 + [0.1] * 10)
    worst = np.column_stack([one.worst[:, 0], np.zeros(16)])
    score = np.column_stack([one.score[:, 0], np.repeat([0.8, 0.05, 0.8], [6, 5, 5])])
    run = LossRun("cut", 5, 10, worst, score, np.array([True, False]), one.dark, one.dark)
    assert calm(run)[:6].all() and not calm(run)[6:].any()
    assert pooled([run]).area == 1.0 and neighbours_told([run], 0.3) == 0.5
    assert np.isnan(neighbours_told([loss_run([0.0] * 16, [1.0] * 16)], 0.3))


def test_rows_of_injections_add_up():
    runs = [
        loss_run([0.0] * 6 + [20.0] * 10, [1.0] * 7 + [0.1] * 9),
        loss_run([0.0] * 6 + [20.0] * 4 + [0.0] * 6, [0.9] * 6 + [0.2] * 4 + [0.8] * 6, kind="jump"),
    ]
    curve = pooled(runs)
    rows = by_kind(runs, 0.3)
    assert [row.kind for row in rows] == ["cut", "jump", "all"]
    assert (rows[2].events, rows[2].prompt, rows[2].recovered, rows[2].struck) == (2, 2, 1, 2)
    assert rows[0].frames_told == 0.9 and rows[0].delay == 1.0 and np.isinf(rows[0].back) and 0.9 < curve.area <= 1.0
    cells = loss_rows(rows)
    assert all(len(row) == len(LOSS_HEADER) for row in cells) and cells[0][-1] == "never"
    assert loss_rows(by_kind([loss_run([0.0] * 16, [1.0] * 16)], 0.3))[0][3] == "-"
    data = loss_data(runs, curve, rows)
    injections = data["injections"]
    assert data["runs"] == 2 and isinstance(injections, list) and len(injections) == 3
    quiet = LossRun("none", 9, 9, runs[0].worst, runs[0].score, np.array([False]), runs[0].dark, runs[0].dark)
    assert by_kind([quiet], 0.3) == ()


@pytest.fixture(scope="module")
def short():
    """A finger hidden for three frames, tracked."""
    scene = occlusion_scene("hidden", 4, 3, "still")
    return trial(script_of(scene, 3), tracked(scene, Settings()))


def test_a_finger_hidden_for_three_frames_is_kept(short):
    found = short
    assert np.degrees(np.abs(found.off).max()) < 8.0 and found.back.max() <= 3.0 and not found.swapped
    assert found.off.shape == (3, 3) and found.seconds > 0.0


def test_scores_are_high_on_fingers_that_are_held_and_low_under_a_covered_camera():
    loss = loss_scene("covered", 3)
    it = loss.scene
    on = (chain(it.model, it.camera),)
    state = begin(on, it.start, it.fps, Settings())
    state, frame = step(state, (loss_picture(loss, 0),), on, 0.0, Settings())
    assert frame.q.size == 6 and (finger_scores(frame, on[0]) > 0.9).all()
    believed = told(state, it.truth[0] + 0.5, on[0])
    np.testing.assert_allclose(believed.prediction.motion.q, it.truth[0] + 0.5)
    _, dark = step(state, (loss_picture(loss, loss.at),), on, 1.0 / it.fps, Settings())
    assert (finger_scores(dark, on[0]) < 0.5).all()


def test_a_covered_camera_is_told_at_once():
    run = followed(loss_scene("covered", 3, frames=40), Settings())
    assert run.worst.shape == run.score.shape == (40, 2)
    during = slice(run.at, run.until)
    assert run.score[during].max() < run.score[: run.at].min()


def test_jobs_are_done_in_order_by_as_many_as_there_are():
    jobs = suite((("hidden", 10), ("board", 20)), 2, 5, Settings())
    assert [(job.kind, job.length, job.seed) for job in jobs] == [
        ("hidden", 10, 5), ("hidden", 10, 6), ("board", 20, 5), ("board", 20, 6),
    ]  # fmt: skip
    done = []
    assert all_tried(abs, [-1, 2, -3], 1, done.append) == [1, 2, 3] and done == [1, 2, 3]
    assert all_tried(abs, [-4, 5], 2, done.append) == [4, 5]
    with pytest.raises(TypeError):
        all_tried(abs, ["no", "number"], 2)
    assert len(loss_suite(2, 0, Settings())) == 10


def test_the_pictures_have_a_panel_for_each_question(short):
    assert len(figure(summed([short]), [short]).axes) == 2
    runs = [loss_run([0.0] * 6 + [20.0] * 10, [1.0] * 7 + [0.1] * 9)]
    curve = pooled(runs)
    assert len(loss_figure(curve, by_kind(runs, threshold_at(curve))).axes) == 2


def test_the_benchmark_prints_its_table_and_saves_a_picture(tmp_path, capsys):
    picture = tmp_path / "hidden.png"
    options = ["--seeds", "1", "--workers", "1", "--scene", "hidden", "--frames", "1"]
    assert main(["benchmark", "occlusion", *options, "--plot", str(picture)]) == 0
    out = capsys.readouterr().out
    assert "back in 3" in out and "hidden" in out and picture.stat().st_size > 10_000


def test_total_occlusion_prints_the_words_of_the_thesis(monkeypatch, capsys, tmp_path):
    from handtrack.cli import occlusion_trials

    made = {"hidden": trial(script(), run()), "crossing": trial(script(kind="crossing"), run(1.0))}
    monkeypatch.setattr(occlusion_trials, "tried", lambda job: made[job.kind])
    options = ["--seeds", "1", "--workers", "1", "--frames", "6"]
    assert main(["reproduce", "total-occlusion", *options, "--plot", str(tmp_path / "a.png")]) == 0
    assert "theirs, in words" in capsys.readouterr().out
    assert main(["reproduce", "total-occlusion", *options, "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["thesis"]) == 4
    assert main(["benchmark", "occlusion", *options, "--scene", "hidden", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["scenes"][0]["runs"] == 1


def test_the_loss_benchmark_prints_delays_and_shares(monkeypatch, capsys, tmp_path):
    from handtrack.cli import loss_trials

    made = loss_run([0.0] * 6 + [20.0] * 10, [1.0] * 7 + [0.1] * 9)
    monkeypatch.setattr(loss_trials, "loss_tried", lambda job: made)
    options = ["benchmark", "loss", "--seeds", "1", "--workers", "1"]
    assert main([*options, "--plot", str(tmp_path / "a.svg")]) == 0
    out = capsys.readouterr().out
    assert "told in 5" in out and "area under the ROC" in out and "by status alone" in out
    assert main([*options, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["injections"][0]["kind"] == "cut"


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        (["--seeds", "0"], "at least 1"),
        (["--first-seed", "-1"], "at least 0"),
        (["--scene", "fog"], "one of hidden, board, crossing, hand"),
        (["--frames", "61"], "1 to 60"),
        (["--plot", "a.bmp"], "one of .png"),
    ],
)
def test_bad_options_are_refused(options, wanted, capsys):
    assert main(["benchmark", "occlusion", *options]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {options[0]}") and wanted in error


def test_jobs_can_be_sent_to_other_processes():
    import pickle

    for job, work in ((Job("hidden", 10, 1, Settings()), tried), (LossJob("cut", 1, Settings()), loss_tried)):
        assert pickle.loads(pickle.dumps((work, job)))[1] == job
    assert frames_text(2.0) == "2"
