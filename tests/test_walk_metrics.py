"""Figures of walks: distances, headings and shares are what their words say, and unknown truth stays unknown."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handtrack.body.walk_metrics import (
    WRISTS,
    held,
    lap_means,
    longest_span,
    walk_errors,
    walk_figures,
    wrapped,
    yaw_of,
)
from handtrack.formats.walk_tracks import WalkTrack
from handtrack.formats.walks import WalkTruth

F = 40


def turned(degrees: np.ndarray) -> np.ndarray:
    return Rotation.from_euler("z", np.reshape(degrees, (-1, 1)), degrees=True).as_quat(scalar_first=True)


def truth() -> WalkTruth:
    rng = np.random.default_rng(0)
    p = rng.normal(size=(F, 3))
    return WalkTruth(p, turned(np.linspace(-170.0, 540.0, F)), p[:, None] + rng.normal(size=(F, 16, 3)))


def track(of: WalkTruth) -> WalkTrack:
    """The truth as a track."""
    return WalkTrack(
        frame=np.arange(F), time=0.2 * np.arange(F), p=of.p, wxyz=of.wxyz, sigma=np.full((F, 3), 0.1),
        sigma_heading=np.full(F, 0.1), joint_names=("knee",), posture=np.zeros((F, 1)), sigma_posture=np.zeros((F, 1)),
        keypoints=of.keypoints, in_view=np.arange(F) % 4 > 0, status=np.full(F, "tracked"), seconds=np.full(F, 0.001),
    )  # fmt: skip


def test_the_truth_itself_has_no_error_and_is_held():
    found = walk_figures(track(truth()), truth())
    assert found is not None
    for name in ("mean", "worst", "in_view", "out_of_view", "heading", "wrist", "relative"):
        assert getattr(found, name) == pytest.approx(0.0, abs=1e-12), name
    assert found.held.tolist() == [1.0, 1.0, 1.0] and found.heading_held == 1.0


def test_a_shift_is_the_error_of_everything_but_relative_wrists():
    true = truth()
    shift = np.array([0.03, 0.0, 0.04])
    found = walk_figures(replace(track(true), p=true.p + shift, keypoints=true.keypoints + shift), true)
    assert found is not None
    assert [found.mean, found.worst, found.in_view, found.out_of_view, found.wrist] == pytest.approx([0.05] * 5)
    assert found.relative == pytest.approx(0.0, abs=1e-12)


def test_errors_out_of_view_are_told_apart():
    true = truth()
    seen = track(true).in_view
    p = true.p + np.where(seen[:, None], [0.01, 0.0, 0.0], [0.0, 0.05, 0.0])
    found = walk_figures(replace(track(true), p=p), true)
    assert found is not None and [found.in_view, found.out_of_view] == pytest.approx([0.01, 0.05])


def test_heading_errors_go_the_short_way_round():
    true = truth()
    off = np.where(np.arange(F) % 2 == 0, 2.0, -358.0 - 4.0)
    wxyz = turned(np.linspace(-170.0, 540.0, F) + off)
    errors = walk_errors(replace(track(true), wxyz=wxyz), true)
    np.testing.assert_allclose(np.degrees(errors.heading), np.where(np.arange(F) % 2 == 0, 2.0, -2.0), atol=1e-9)


def test_a_wrong_heading_alone_does_not_change_relative_wrists():
    true = truth()
    turn = Rotation.from_euler("z", 7.0, degrees=True)
    points = true.p[:, None] + (true.keypoints - true.p[:, None]) @ turn.as_matrix().T
    wxyz = (turn * Rotation.from_quat(true.wxyz, scalar_first=True)).as_quat(scalar_first=True)
    errors = walk_errors(replace(track(true), wxyz=wxyz, keypoints=points), true)
    assert errors.relative.max() < 1e-12 < errors.wrist.max()
    np.testing.assert_allclose(np.degrees(errors.heading), 7.0, atol=1e-9)


def test_unknown_truth_is_left_out():
    true = truth()
    p, wxyz, points = true.p.copy(), true.wxyz.copy(), true.keypoints.copy()
    p[3:], wxyz[5:], points[:, WRISTS[0]] = np.nan, np.nan, np.nan
    part = WalkTruth(p, wxyz, points)
    found = walk_figures(replace(track(true), p=true.p + np.array([0.1, 0.0, 0.0])), part)
    assert found is not None and found.mean == pytest.approx(0.1) and np.isfinite(found.wrist)
    nothing = WalkTruth(np.full((F, 3), np.nan), np.full((F, 4), np.nan), np.full((F, 16, 3), np.nan))
    found = walk_figures(track(true), nothing)
    assert found is not None and np.isnan([found.mean, found.worst, found.relative, found.held[0]]).all()
    assert set(found.as_data()) and found.as_data()["mean_mm"] is None
    assert found.as_data()["two_sigma_hold"] == [None, None, None]
    assert walk_figures(track(true), None) is None


def test_truth_of_another_walk_is_refused():
    true = truth()
    other = WalkTruth(true.p[1:], true.wxyz[1:], true.keypoints[1:])
    with pytest.raises(ValueError, match="truth: has 39 frames; wanted those of the track, 40"):
        walk_errors(track(true), other)


def test_plain_data_is_in_millimetres_and_degrees():
    true = truth()
    found = walk_figures(replace(track(true), p=true.p + np.array([0.0, 0.0123, 0.0])), true)
    assert found is not None and found.as_data()["mean_mm"] == 12.3
    assert found.as_data()["two_sigma_hold"] == [1.0, 1.0, 1.0]


def test_two_sigma_hold_95_percent_of_normal_errors():
    off = 0.7 * np.random.default_rng(1).standard_normal((20_000, 2))
    np.testing.assert_allclose(held(off, np.full(off.shape, 0.7)), 0.9545, atol=0.005)


def test_only_laps_walked_to_their_end_count():
    lap = np.linspace(0.0, 2.6, F)
    means = lap_means(np.floor(lap), lap)
    assert means.tolist() == [0.0, 1.0]
    assert lap_means(np.ones(3), np.zeros(3)).size == 0


def test_longest_span_is_from_first_to_last_frame():
    time = np.arange(8.0)
    assert longest_span(np.array([1, 1, 0, 1, 1, 1, 0, 1], dtype=bool), time) == 2.0
    assert longest_span(np.zeros(8, dtype=bool), time) == 0.0


def test_yaw_is_the_first_euler_angle():
    turn = Rotation.random(50, rng=np.random.default_rng(4))
    np.testing.assert_allclose(yaw_of(turn.as_quat(scalar_first=True)), turn.as_euler("ZYX")[:, 0], atol=1e-12)
    np.testing.assert_allclose(wrapped(np.array([3.5 * np.pi])), [-0.5 * np.pi])
