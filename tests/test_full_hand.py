"""Section 6.2.2 of the hand thesis: the scene is its motion, and the command prints its words beside our figures."""

import json

import numpy as np
import pytest

from handtrack.cli import main
from handtrack.cli.full_hand import figure, track_hands
from handtrack.reproduce.full_hand import ASTRAY, FOLLOWS, as_data, rows, summary
from handtrack.settings import Settings
from synth.scenes import full_hand_spread


@pytest.fixture(scope="module")
def results():
    return [track_hands(2, views, Settings(), first_seed=1, frames=6) for views in (1, 2)]


def test_the_scene_turns_as_figure_6_6_says():
    scene = full_hand_spread(4, frames=80)
    q = dict(zip(scene.model.joint_names, np.degrees(scene.truth).T, strict=True))
    for finger in ("little", "ring", "middle", "index"):
        np.testing.assert_allclose(q[f"{finger}_dip"], q[f"{finger}_pip"])  # "overlaps the true value of the third"
    spread = np.sum([q[f"{finger}_abduction"] for finger in ("little", "ring", "middle", "index")], axis=0)
    flexion = np.sum([q[f"{finger}_pip"] for finger in ("ring", "middle", "index")], axis=0)
    assert spread[35] > spread[0] + 25.0 and flexion[35] < flexion[0] + 10.0  # they spread first
    assert flexion[-1] > flexion[0] + 40.0
    np.testing.assert_allclose(q["thumb_ip"], q["thumb_palmar"])  # "of the fifth DOF overlaps ... of the first"
    assert all(np.ptp(q[name]) == 0.0 for name in q if name.startswith("thumb"))
    last = [q[f"{finger}_mcp"][-1] for finger in ("little", "ring", "middle", "index")]
    assert last[0] < -15.0 and last == sorted(last)


def test_the_table_has_every_joint_with_the_statement_and_the_figures_of_each_run(results):
    header, table = rows(results)
    assert header[:3] == ["joint", "thesis, chapter 7", "1 view: RMSE"] and header[6] == "2 views: RMSE"
    assert len(table) == 21 and all(len(row) == len(header) for row in table)
    assert [row[1] for row in table].count(ASTRAY) == 5 and table[0][1] == FOLLOWS


def test_six_frames_of_the_hand_are_followed_by_one_view_and_by_two(results):
    one, two = results
    assert one.worst_rmse.shape == (2,) and one.worst_rmse.max() < 1.5 and one.thumb_rmse.max() < 2.0
    assert two.thumb_rmse.max() < 0.3 and two.covered.mean() > 0.8
    text = "\n".join(summary(one) + summary(two))
    assert "one view, 2 motions" in text and "2 views, 2 motions" in text and "weakest direction" in text


def test_the_figures_are_plain_data_and_a_picture(results):
    data = json.loads(json.dumps(as_data(results), allow_nan=False))
    assert [result["views"] for result in data["results"]] == [1, 2]
    assert len(data["results"][0]["joints"]) == 21 and data["section"] == "6.2.2"
    assert len(figure(results).axes) == 2 and len(figure(results[:1]).axes) == 1


def test_the_command_prints_the_table_and_saves_the_picture(tmp_path, capsys):
    picture = tmp_path / "hand.png"
    options = ["--motions", "1", "--frames", "3", "--views", "1"]
    assert main(["reproduce", "full-hand", *options, "--plot", str(picture)]) == 0
    out = capsys.readouterr().out
    assert "thumb_abduction" in out and "doesn't correspond at all" in out and "two sigmas" in out
    assert picture.stat().st_size > 10_000
    assert main(["reproduce", "full-hand", *options, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["results"][0]["motions"] == 1


@pytest.mark.parametrize(
    ("option", "value", "wanted"),
    [("--motions", "0", "at least 1"), ("--frames", "2", "at least 3"), ("--views", "6", "1 to 5")],
)
def test_bad_numbers_are_refused(option, value, wanted, capsys):
    assert main(["reproduce", "full-hand", option, value]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: {option}: {value} given") and wanted in error
