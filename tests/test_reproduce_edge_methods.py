"""The comparison of edge methods: exact true edges, figures that mean what they say, table, JSON and picture."""

import json
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from handtrack.camera import orthographic
from handtrack.cli import edge_methods as command
from handtrack.cli import main
from handtrack.pills import Pills
from handtrack.reproduce import edge_methods as figures
from handtrack.reproduce.edge_methods import (
    PRINTED,
    TEMPLATES,
    THEIRS,
    VALLEY,
    EdgeFigures,
    Motion,
    Row,
    TrackFigures,
    as_printed,
    edge_methods,
    single_frames,
    tracking,
    true_edges,
)
from handtrack.settings import EDGES, Settings

CAMERA = orthographic(200, 200, 1.0, 100.0, 100.0, np.eye(3), np.zeros(3))


@cache
def motion(frames: int = 6) -> Motion:
    return command.make_motions("crossing", 1, 1, frames)[0]


def test_true_edges_of_a_pill_are_a_radius_from_its_axis():
    pill = Pills(np.array([[-40.0, 0.0, 100.0]]), np.array([[40.0, 0.0, 100.0]]), np.array([[12.0, 12.0]]))
    origin, direction = np.array([[100.0, 110.0], [90.0, 95.0]]), np.array([[0.0, 1.0], [0.0, -1.0]])
    place, visible = true_edges(pill, np.array([0]), CAMERA, origin, direction, np.array([0, 0]))
    assert_allclose(place, [2.0, 7.0], atol=1e-6)
    assert visible.all()


def test_true_edges_behind_another_finger_are_not_to_be_seen():
    base, tip = np.array([[-40.0, 0.0, 100.0], [0.0, 5.0, 50.0]]), np.array([[40.0, 0.0, 100.0], [0.0, 90.0, 50.0]])
    both = Pills(base, tip, np.array([[12.0, 12.0], [6.0, 6.0]]))
    origin, direction = np.array([[100.0, 110.0], [70.0, 110.0], [100.0, 130.0]]), np.tile([0.0, 1.0], (3, 1))
    link = np.array([0, 0, 1])
    direction[2] = [1.0, 0.0]
    place, visible = true_edges(both, np.array([0, 1]), CAMERA, origin, direction, link)
    assert_allclose(place, [2.0, 2.0, 6.0], atol=1e-6)
    np.testing.assert_array_equal(visible, [False, True, True])
    # Where one link of a finger goes over into the next there is no edge either.
    assert not true_edges(both, np.array([0, 0]), CAMERA, origin, direction, link)[1][0]


def test_a_path_that_misses_the_link_has_no_true_edge():
    pill = Pills(np.array([[-40.0, 0.0, 100.0]]), np.array([[40.0, 0.0, 100.0]]), np.array([[12.0, 12.0]]))
    far, along = np.array([[20.0, 20.0], [100.0, 100.0]]), np.array([[0.0, 1.0], [1.0, 0.0]])
    place, visible = true_edges(pill, np.array([0]), CAMERA, far, along, np.array([0, 0]))
    assert np.isnan(place).all() and not visible.any()


def test_figures_of_single_frames_are_those_of_their_edges():
    error = np.array([0.1, -0.1, 0.3, 5.0, np.nan, 0.2])
    found, visible = np.array([1, 1, 1, 1, 1, 0], dtype=bool), np.array([1, 1, 1, 1, 0, 1], dtype=bool)
    got = figures._figures(figures._Errors(error, np.full(6, 0.1), found, visible))
    assert_allclose([got.bias, got.scatter], [0.1, float(np.std([0.1, -0.1, 0.3]))])
    assert_allclose([got.found, got.false, got.normalised], [0.6, 0.4, float(np.sqrt(11.0 / 3.0))])
    none = figures._figures(figures._Errors(error, np.full(6, 0.1), ~visible & visible, visible))
    assert np.isnan(none.bias) and none.found == 0.0 and none.false == 0.0
    wrong = figures._figures(figures._Errors(error + 9.0, np.full(6, 0.1), found, visible))
    assert np.isnan(wrong.scatter) and wrong.false == 1.0


@pytest.mark.parametrize(("edges", "residuals", "scatter"), [("wssd", "outline", 0.3), ("wssd", "lines", 0.5)])
def test_templates_are_judged_like_any_method(edges, residuals, scatter):
    got = single_frames([motion()], Settings(edges=edges, residuals=residuals))
    assert got.scatter < scatter and abs(got.bias) < 0.1 and got.found > 0.9


def test_the_gaussian_scatters_less_than_the_difference_and_both_miss_what_lies_against_another_finger():
    plain, smooth = (single_frames([motion()], Settings(edges=name)) for name in ("difference", "gaussian"))
    assert smooth.scatter < plain.scatter < 0.35
    assert 0.5 < smooth.found < 1.0 and smooth.false < 0.08


def test_tracking_is_told_in_radians_and_milliseconds():
    got = tracking([motion()], Settings(edges="gaussian"))
    assert np.radians(0.01) < got.worst_rmse < np.radians(2.0)
    assert got.lost == 0 and 0.0 < got.frame_ms < 10_000.0 and got.nees_ratio > 0.0


def test_a_track_that_strays_counts_as_lost():
    astray = Motion(
        motion().images,
        motion().model,
        motion().camera,
        motion().truth + np.radians(20.0),
        motion().start,
        motion().fps,
    )
    assert tracking([astray], Settings(edges="gaussian")).lost == 1


def test_the_printed_alternative_is_section_6_2():
    got = as_printed()
    assert (got.residuals, got.edges, got.solver, got.filter) == (
        "lines",
        "mwplls-iterative",
        "gauss-newton-one",
        "ghk",
    )
    assert got.theta == 0.85


def test_every_method_has_its_row(monkeypatch):
    edges, track = EdgeFigures(0.0, 0.1, 1.0, 0.9, 0.0), TrackFigures(0.01, 1.0, 5.0, 0)
    asked: list[Settings] = []
    monkeypatch.setattr(figures, "single_frames", lambda motions, settings: edges)
    monkeypatch.setattr(figures, "tracking", lambda motions, settings: asked.append(settings) or track)
    told: list[int] = []
    rows = edge_methods((), progress=told.append)
    assert [row.method for row in rows] == [TEMPLATES, VALLEY, *EDGES[1:], PRINTED]
    assert len(rows) == command.ROWS and told[-1] == command.ROWS
    assert {(s.edges, s.residuals) for s in asked} == {(e, r) for e in EDGES for r in ("outline", "lines")}
    assert edge_methods((), methods=("gaussian",))[0] == Row("gaussian", edges, track, track)
    assert set(THEIRS) == {*EDGES[1:], VALLEY}


@pytest.fixture
def short(monkeypatch):
    """The command with two methods instead of nine."""
    monkeypatch.setattr(
        command,
        "edge_methods",
        lambda motions, progress: edge_methods(motions, ("mwplls-iterative",), progress),
    )


def test_the_table_holds_both_scenes_and_the_thesis_s_words(monkeypatch, short, capsys):
    monkeypatch.setattr(figures, "single_frames", lambda motions, settings: EdgeFigures(0.0, 0.1, 1.0, 0.9, 0.0))
    monkeypatch.setattr(figures, "tracking", lambda motions, settings: TrackFigures(0.01, 1.0, 5.0, 0))
    assert main(["reproduce", "edge-methods", "--motions", "1", "--frames", "3"]) == 0
    told = capsys.readouterr().out
    assert "two fingers, crossing, 1 motions" in told and "two fingers, hard, 1 motions" in told
    assert told.count("mwplls-iterative as in 6.2") == 2 and "bias px" in told
    assert "not used by itself (11.3.1)" in told


def test_json_and_picture(monkeypatch, short, capsys, tmp_path):
    monkeypatch.setattr(command, "VARIANTS", ("hard",))
    drawn = tmp_path / "edges.png"
    arguments = ["reproduce", "edge-methods", "--motions", "1", "--frames", "2", "--json", "--plot", str(drawn)]
    assert main(arguments) == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told["scenes"]) == {"hard"} and told["motions"] == 1
    row = told["scenes"]["hard"][0]
    assert row["method"] == "mwplls-iterative" and row["edges"]["scatter"] > 0.0
    assert row["outline"]["worst_rmse_median_deg"] > 0.0 and told["scenes"]["hard"][1]["outline"] is None
    assert drawn.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" and drawn.stat().st_size > 50_000


@pytest.mark.parametrize(("option", "value"), [("--motions", "0"), ("--frames", "1"), ("--first-seed", "-1")])
def test_too_small_numbers_are_refused(option, value, capsys):
    assert main(["reproduce", "edge-methods", option, value]) == 2
    assert f"error: {option}: {value} given" in capsys.readouterr().err


def test_a_picture_of_no_known_format_is_refused_before_any_work(capsys):
    assert main(["reproduce", "edge-methods", "--plot", "edges.txt"]) == 2
    assert "ends in '.txt'" in capsys.readouterr().err
