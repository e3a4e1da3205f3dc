"""Errors against hand-computed values, NEES against the chi-square law, and laws that hold for every track."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from handtrack.camera import orthographic, perspective
from handtrack.errors import InputError
from handtrack.evaluate import (
    as_json,
    as_text,
    evaluate,
    joint_error,
    landmark_distances,
    landmark_joints,
    nees,
    prismatic_joints,
)
from handtrack.kinematics import FrameRow, model_from_rows
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.sequences import Truth
from handtrack.track import Track

FLAT = orthographic(100, 100, 2.0, 50.0, 50.0, np.eye(3), np.zeros(3))


def two_links():
    """Two links of 10 and 5 mm along x that bend in the image plane."""
    rows = [
        FrameRow(1, 0, joint="one", link_length=10.0, link_radius=(2.0, 2.0)),
        FrameRow(2, 1, a=10.0, joint="two", link_length=5.0, link_radius=(2.0, 2.0)),
    ]
    return model_from_rows("two_links", rows)


def slider():
    """A link that turns on a carriage that slides along x (z of its frame turned into x of the base)."""
    rows = [
        FrameRow(1, 0, theta=np.pi / 2),
        FrameRow(2, 1, alpha=np.pi / 2, joint="slide", prismatic=True),
        FrameRow(3, 2, alpha=-np.pi / 2, joint="turn", link_length=5.0, link_radius=(1.0, 1.0)),
    ]
    return model_from_rows("slider", rows)


def make_track(model, q, sigma=0.01, status=None, frame=None):
    q = np.asarray(q, dtype=float)
    n, j = q.shape
    sigmas = np.full((n, j), sigma)
    return Track(
        joint_names=model.joint_names,
        frame=np.arange(n) if frame is None else np.asarray(frame),
        time=np.arange(n) / 25.0,
        q=q,
        sigma=sigmas,
        covariance=sigmas[:, :, None] ** 2 * np.eye(j),
        information=np.zeros((n, model.free.size, model.free.size)),
        status=np.array(["tracked"] * n if status is None else status, dtype="<U9"),
        confidence=np.ones(n),
        residual=np.ones(n),
        visible=np.ones((n, model.link_length.size)),
        edges=np.full(n, 50),
        seconds=np.full(n, 0.002),
    )


def test_errors_match_values_computed_by_hand():
    model = two_links()
    degrees = np.array([[1.0, 2.0], [1.0, -2.0], [-2.0, 6.0]])
    result = evaluate(make_track(model, np.radians(degrees)), Truth(np.arange(3), np.zeros((3, 2))), model, FLAT)
    np.testing.assert_allclose(np.degrees(result.rmse), [np.sqrt(2.0), np.sqrt(44.0 / 3.0)])
    np.testing.assert_allclose(np.degrees(result.bias), [0.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(np.degrees(result.largest), [2.0, 6.0])
    assert model.joint_names[result.worst_joint] == "two"


def test_landmark_error_is_the_distance_of_the_moved_tip_in_pixels():
    # Only the second joint is off, by 90 degrees: its tip moves over the chord of 5 mm; 2 px each.
    model = two_links()
    track = make_track(model, [[0.0, np.pi / 2]])
    result = evaluate(track, Truth(np.arange(1), np.zeros((1, 2))), model, FLAT)
    # Landmarks that can move: the origin of the second link, which is right, and the tip.
    assert result.landmark_max_px == pytest.approx(10 * np.sqrt(2))
    assert result.landmark_px == pytest.approx(5 * np.sqrt(2))
    assert result.landmark_median_px == pytest.approx(5 * np.sqrt(2))


def test_landmarks_that_cannot_move_are_not_counted():
    used = landmark_joints(two_links())
    assert used.tolist() == [[False, False], [True, False], [True, True]]
    assert landmark_joints(slider()).tolist() == [[True, False], [True, True]]


def test_landmarks_behind_the_camera_are_left_out():
    model = two_links()
    behind = perspective(100, 100, 100.0, 100.0, 50.0, 50.0, np.eye(3), np.array([0.0, 0.0, -5.0]))
    result = evaluate(make_track(model, np.zeros((1, 2))), Truth(np.arange(1), np.zeros((1, 2))), model, behind)
    assert np.isnan(result.landmark_px)
    assert json.loads(as_json(result))["landmark_px"] is None


def test_truth_may_be_shorter_than_the_track_and_in_another_order():
    model = two_links()
    track = make_track(model, np.radians([[9.0, 9.0], [1.0, 0.0], [9.0, 9.0], [2.0, 0.0]]), frame=[4, 5, 6, 7])
    result = evaluate(track, Truth(np.array([7, 5]), np.radians([[1.0, 0.0], [0.0, 0.0]])), model, FLAT)
    assert result.frames == 4
    assert result.compared == 2
    np.testing.assert_allclose(np.degrees(result.rmse), [1.0, 0.0], atol=1e-12)
    assert result.nees.shape == (2,)


def test_joint_without_truth_has_no_error_and_costs_nees_one_degree_of_freedom():
    model = two_links()
    track = make_track(model, np.radians([[1.0, 50.0], [1.0, 50.0]]), sigma=np.radians(0.5))
    result = evaluate(track, Truth(np.arange(2), np.array([[0.0, np.nan], [0.0, np.nan]])), model, FLAT)
    assert np.isnan([result.rmse[1], result.bias[1], result.largest[1], result.coverage_1sigma[1]]).all()
    assert result.nees_dof.tolist() == [1, 1]
    np.testing.assert_allclose(result.nees, 4.0)
    # Only the origin of the second link is known; its 1 degree on 10 mm at 2 px/mm.
    assert result.landmark_max_px == pytest.approx(40 * np.sin(np.radians(0.5)))


def test_angles_are_compared_the_short_way_round_and_lengths_are_not():
    model = slider()
    assert prismatic_joints(model).tolist() == [True, False]
    error = joint_error(np.array([[10.0, 3.1]]), np.array([[0.0, -3.1]]), prismatic_joints(model))
    np.testing.assert_allclose(error, [[10.0, 6.2 - 2 * np.pi]])


def test_worst_joint_is_an_angle_where_there_is_one():
    model = slider()
    track = make_track(model, [[3.0, 0.1]])
    result = evaluate(track, Truth(np.arange(1), np.zeros((1, 2))), model, FLAT)
    assert model.joint_names[result.worst_joint] == "turn"
    only_slide = evaluate(track, Truth(np.arange(1), np.array([[0.0, np.nan]])), model, FLAT)
    assert model.joint_names[only_slide.worst_joint] == "slide"
    document = json.loads(as_json(only_slide))
    assert document["worst_rmse"] == 3.0
    assert document["joints"][0]["unit"] == "mm"


def test_shares_of_status_cover_all_frames_of_the_track():
    model = two_links()
    status = ["tracked", "tracked", "uncertain", "lost"]
    result = evaluate(
        make_track(model, np.zeros((4, 2)), status=status), Truth(np.arange(1), np.zeros((1, 2))), model, FLAT
    )
    assert (result.share_tracked, result.share_uncertain, result.share_lost) == (0.5, 0.25, 0.25)


def test_coverage_counts_errors_inside_one_and_two_sigmas():
    model = two_links()
    q = np.array([[0.5, 0.0], [1.5, 0.0], [2.5, 0.0], [-0.2, 0.0]])
    result = evaluate(make_track(model, q, sigma=1.0), Truth(np.arange(4), np.zeros((4, 2))), model, FLAT)
    np.testing.assert_allclose(result.coverage_1sigma, [0.5, 1.0])
    np.testing.assert_allclose(result.coverage_2sigma, [0.75, 1.0])


def test_nees_matches_the_formula_for_a_full_covariance():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(7, 4, 4))
    covariance = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(4)
    error = rng.normal(size=(7, 4))
    value, dof = nees(error, covariance)
    expected = [e @ np.linalg.solve(C, e) for e, C in zip(error, covariance, strict=True)]
    np.testing.assert_allclose(value, expected, rtol=1e-9)
    assert (dof == 4).all()


def test_nees_of_coupled_joints_counts_the_independent_ones():
    # q = A u with more joints than independent ones: the NEES of q must be that of u.
    rng = np.random.default_rng(4)
    A = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.67]])
    root = rng.normal(size=(5, 2, 2))
    C_u = root @ np.swapaxes(root, 1, 2) + 0.05 * np.eye(2)
    u = rng.normal(size=(5, 2))
    value, dof = nees(u @ A.T, A @ C_u @ A.T)
    np.testing.assert_allclose(value, nees(u, C_u)[0], rtol=1e-6)
    assert (dof == 2).all()


def test_nees_ignores_the_units_of_the_joints():
    rng = np.random.default_rng(5)
    root = rng.normal(size=(3, 3, 3))
    C = root @ np.swapaxes(root, 1, 2)
    e = rng.normal(size=(3, 3))
    units = np.array([1.0, 1e-4, 1e5])
    np.testing.assert_allclose(nees(e * units, C * units[:, None] * units)[0], nees(e, C)[0], rtol=1e-6)


def test_nees_of_honest_sigmas_is_chi_square_and_its_mean_lies_in_the_band():
    rng = np.random.default_rng(11)
    model = two_links()
    C = np.array([[4e-4, 1e-4], [1e-4, 1e-4]])
    inside = 0
    values = []
    for _ in range(200):
        q = rng.multivariate_normal([0.0, 0.0], C, size=40)
        track = make_track(model, q)
        track = replace(track, covariance=C * np.ones((40, 1, 1)))
        result = evaluate(track, Truth(np.arange(40), np.zeros((40, 2))), model, FLAT)
        inside += result.nees_band[0] <= result.nees_mean <= result.nees_band[1]
        values.append(result.nees)
    assert 180 <= inside <= 199  # 190 of 200 expected; 3 standard deviations are 9.2
    shares = np.quantile(np.concatenate(values), [0.5, 0.95])
    np.testing.assert_allclose(shares, chi2.ppf([0.5, 0.95], 2), rtol=0.05)


def test_no_degree_of_freedom_gives_no_band():
    model = two_links()
    track = make_track(model, np.zeros((2, 2)), sigma=0.0)
    result = evaluate(track, Truth(np.arange(2), np.zeros((2, 2))), model, FLAT)
    assert result.nees_dof.tolist() == [0, 0]
    assert np.isnan([result.nees_mean, *result.nees_band]).all()
    assert json.loads(as_json(result))["nees_band"] == [None, None]
    assert "NEES          mean -" in as_text(result)


@given(st.integers(0, 2**32 - 1), st.integers(2, 12))
@settings(max_examples=25, deadline=None)
def test_order_of_the_frames_does_not_matter(seed, count):
    rng = np.random.default_rng(seed)
    model = two_links()
    track = make_track(model, rng.normal(size=(count, 2)))
    truth = Truth(np.arange(count), rng.normal(size=(count, 2)))
    order = rng.permutation(count)
    mixed = evaluate(track, Truth(truth.frame[order], truth.q[order]), model, FLAT)
    plain = evaluate(track, truth, model, FLAT)
    assert as_json(mixed) == as_json(plain)


@given(st.integers(0, 2**32 - 1), st.floats(-0.5, 0.5))
@settings(max_examples=25, deadline=None)
def test_rmse_lies_between_bias_and_largest_error_and_a_shift_moves_the_bias(seed, shift):
    rng = np.random.default_rng(seed)
    model = two_links()
    q = rng.uniform(-1, 1, size=(6, 2))
    truth = Truth(np.arange(6), rng.uniform(-1, 1, size=(6, 2)))
    result = evaluate(make_track(model, q), truth, model, FLAT)
    slack = 1e-12
    assert (np.abs(result.bias) <= result.rmse + slack).all()
    assert (result.rmse <= result.largest + slack).all()
    moved = evaluate(make_track(model, q + shift), truth, model, FLAT)
    np.testing.assert_allclose(moved.bias - result.bias, shift, atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.floats(0.2, 5.0))
@settings(max_examples=25, deadline=None)
def test_scaling_all_sigmas_divides_nees_by_the_square(seed, factor):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(2, 3, 3))
    C = root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(3)
    e = rng.normal(size=(2, 3))
    np.testing.assert_allclose(nees(e, factor**2 * C)[0], nees(e, C)[0] / factor**2, rtol=1e-7)


def test_perfect_track_of_the_full_hand_has_no_error():
    model = builtin_model("full_hand")
    q = np.clip(np.random.default_rng(0).normal(0, 0.2, (3, 21)), model.limits[:, 0], model.limits[:, 1])
    result = evaluate(make_track(model, q), Truth(np.arange(3), q), model, FLAT)
    assert result.rmse.max() == 0.0
    assert result.landmark_max_px == 0.0
    assert landmark_distances(model, FLAT, q, q).shape[0] == 3


def test_json_is_in_degrees_and_has_no_nan():
    model = two_links()
    result = evaluate(
        make_track(model, np.radians([[1.0, 0.0]])), Truth(np.arange(1), np.array([[0.0, np.nan]])), model, FLAT
    )
    text = as_json(result)
    assert "NaN" not in text
    document = json.loads(text)
    assert document["worst_joint"] == "one"
    assert document["worst_rmse"] == pytest.approx(1.0)
    assert document["joints"][1] == {
        "joint": "two",
        "unit": "deg",
        "rmse": None,
        "bias": None,
        "largest": None,
        "coverage_1sigma": None,
        "coverage_2sigma": None,
    }


def test_text_lists_every_joint_in_degrees():
    model = two_links()
    text = as_text(
        evaluate(make_track(model, np.radians([[1.0, 0.25]])), Truth(np.arange(1), np.zeros((1, 2))), model, FLAT)
    )
    assert re.search(r"^one +1\.000 +1\.000 +1\.000", text, re.MULTILINE)
    assert re.search(r"^two +0\.250 ", text, re.MULTILINE)
    assert "worst joint   one" in text


def test_truth_without_a_common_frame_is_refused():
    model = two_links()
    with pytest.raises(InputError, match="no frame in common"):
        evaluate(make_track(model, np.zeros((2, 2))), Truth(np.array([8]), np.zeros((1, 2))), model, FLAT)


def test_truth_without_any_value_is_refused():
    model = two_links()
    with pytest.raises(InputError, match="no joint of the model has a value"):
        evaluate(make_track(model, np.zeros((1, 2))), Truth(np.arange(1), np.full((1, 2), np.nan)), model, FLAT)


def test_joints_of_another_model_are_refused():
    model = two_links()
    with pytest.raises(ValueError, match="truth: has 3 columns of joints, the model has 2"):
        evaluate(make_track(model, np.zeros((1, 2))), Truth(np.arange(1), np.zeros((1, 3))), model, FLAT)
    with pytest.raises(ValueError, match="track: has the joints"):
        evaluate(make_track(slider(), np.zeros((1, 2))), Truth(np.arange(1), np.zeros((1, 2))), model, FLAT)
