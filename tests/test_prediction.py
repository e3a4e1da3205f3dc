"""Prediction and correction: the three filters behind one interface, and what the image alone had measured."""

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from handtrack.ghk import Ghk, ghk_predict, ghk_start, ghk_update
from handtrack.prediction import Prediction, correct, first_prediction, predict
from handtrack.settings import Settings
from handtrack.smooth import update

FPS, DT = 25.0, 0.04
Filter = Literal["kalman", "ghk", "none"]
FILTERS: tuple[Filter, ...] = ("ghk", "kalman", "none")


def run(u: np.ndarray, filter_: Filter, information: float = 1e8, theta: float = 0.4) -> tuple[Prediction, np.ndarray]:
    """Measure poses `u` (n, k) as they are; the state, and the predictions made on the way (n - 1, k)."""
    state = first_prediction(u[0], FPS, Settings(filter=filter_, theta=theta))
    ahead = predict(state, 0.0)
    out = []
    for number, pose in enumerate(u):
        if number:
            ahead = predict(state, DT)
            out.append(ahead.motion.q)
        state = correct(ahead, pose, information * np.eye(pose.size))
    return state, np.array(out)


@pytest.mark.parametrize("filter_", FILTERS)
def test_at_the_start_the_start_pose_is_predicted_with_its_sigma(filter_: Filter):
    u = np.array([0.1, -0.2, 0.3])
    state = first_prediction(u, FPS, Settings(filter=filter_, start_sigma=0.07, start_speed=0.09))
    ahead = predict(state, 0.0)
    assert_allclose(ahead.motion.q, u)
    assert_allclose(ahead.motion.covariance, 0.07**2 * np.eye(3))
    assert_allclose(ahead.motion.velocity, 0.0)
    assert_allclose(np.diag(ahead.motion.P)[3:], (0.09 * FPS) ** 2)
    assert (state.ghk is not None) == (filter_ == "ghk")
    assert not state.unseen.any() and not ahead.moved


def test_the_kalman_filter_carries_a_constant_velocity_on():
    u = np.outer(np.arange(12), [0.05, -0.03])
    state, _ = run(u, "kalman")
    assert_allclose(predict(state, DT).motion.q, u[-1] + [0.05, -0.03], atol=2e-3)
    assert_allclose(predict(state, 3 * DT).motion.q, u[-1] + [0.15, -0.09], atol=6e-3)


def test_without_a_filter_the_last_pose_is_predicted():
    rng = np.random.default_rng(0)
    u = rng.normal(size=(8, 3))
    _, ahead = run(u, "none", information=1e12)
    assert_allclose(ahead, u[:-1], atol=1e-6)


@pytest.mark.parametrize("theta", [0.3, 0.85])
def test_the_ghk_prediction_is_that_of_the_filter_by_itself(theta):
    rng = np.random.default_rng(1)
    u = np.cumsum(np.cumsum(0.02 * rng.normal(size=(20, 3)), axis=0), axis=0)
    _, ahead = run(u, "ghk", theta=theta)
    chosen, alone, wanted = Ghk(theta, 1.0 / FPS), ghk_start(u[0]), []
    alone = ghk_update(alone, u[0], chosen)
    for pose in u[1:]:
        alone = ghk_predict(alone, DT, chosen)
        wanted.append(alone.q)
        alone = ghk_update(alone, pose, chosen)
    assert_allclose(ahead, wanted, atol=1e-12)


def test_ghk_follows_a_constant_acceleration_where_kalman_lags():
    t = np.arange(25) * DT
    u = (0.5 * 6.0 * t**2)[:, None]
    ghk, kalman, none = (np.abs(run(u, name)[1] - u[1:])[-5:].max() for name in FILTERS)
    assert ghk < 1e-6 < kalman < none


@pytest.mark.parametrize("filter_", FILTERS)
def test_a_joint_without_evidence_is_frozen_and_its_sigma_grows(filter_: Filter):
    u = np.outer(np.arange(8), [0.05, 0.05])
    state, _ = run(u, filter_)
    information = np.diag([1e8, 0.0])
    spreads, poses = [], []
    for _ in range(5):
        ahead = predict(state, DT)
        state = correct(ahead, ahead.motion.q + np.array([0.05, 0.0]), information)
        spreads.append(state.motion.sigma[1])
        poses.append(ahead.motion.q[1])
    np.testing.assert_array_equal(state.unseen, [False, True])
    assert (np.diff(spreads) > 0.0).all() and spreads[-1] > math.radians(3.0)
    assert_allclose(poses[1:], poses[1], atol=1e-3)  # the first is still predicted with its velocity
    assert state.motion.sigma[0] < math.radians(0.1)


def test_a_joint_that_is_seen_again_moves_on():
    state, _ = run(np.outer(np.arange(8), [0.05, 0.05]), "kalman")
    for _ in range(3):
        ahead = predict(state, DT)
        state = correct(ahead, ahead.motion.q, np.zeros((2, 2)))
    assert state.unseen.all()
    for n in range(6):
        ahead = predict(state, DT)
        state = correct(ahead, np.array([0.6, 0.6]) + 0.05 * n, 1e8 * np.eye(2))
    assert not state.unseen.any()
    assert_allclose(predict(state, DT).motion.q, 0.6 + 0.05 * 6, atol=0.02)


def test_evidence_worth_less_than_eight_degrees_is_none():
    state, _ = run(np.zeros((3, 2)), "kalman")
    ahead = predict(state, DT)
    weak, fair = (math.radians(s) ** -2 for s in (9.0, 7.0))
    np.testing.assert_array_equal(correct(ahead, np.zeros(2), np.diag([weak, fair])).unseen, [True, False])


@given(st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_correction_recovers_what_the_image_alone_measured(seed):
    # u is the pose that image (information A, pose z) and prediction (information L, pose m) agree on; the filter must
    # end as if it had been given z itself with covariance A^-1.
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 6))
    state, _ = run(np.cumsum(0.05 * rng.normal(size=(4, k)), axis=0), "kalman")
    ahead = predict(state, DT)
    root = rng.normal(size=(k, k)) + 2.0 * np.eye(k)
    A = root @ root.T * 1e4 / math.radians(1.0)
    L, m = np.linalg.inv(ahead.motion.covariance), ahead.motion.q
    z = m + 0.05 * rng.normal(size=k)
    measured = A + math.radians(60.0) ** -2 * np.eye(k)  # with what knowing nothing is worth
    u = np.linalg.solve(measured + L, measured @ z + L @ m)
    wanted, _, _ = update(ahead.motion, z, np.linalg.inv(measured))
    found = correct(ahead, u, A).motion
    assert_allclose(found.x, wanted.x, atol=1e-8 * np.abs(wanted.x).max())
    assert_allclose(found.P, wanted.P, rtol=1e-6, atol=1e-12)
    # Filtered pose and fitted pose are one where the fit and the filter had the same prediction.
    assert_allclose(found.q, u, atol=1e-9)


def test_a_named_prior_is_the_one_that_is_taken_out_again():
    # The fit may have had more than the prediction to go by: soft couplings belong to the frame, not to the filter.
    state, _ = run(np.zeros((4, 2)), "kalman")
    ahead = predict(state, DT)
    A, L, m = np.diag([4e4, 9e4]), np.array([[5e4, -1e4], [-1e4, 2e4]]), np.array([0.03, -0.02])
    z = np.array([0.05, 0.01])
    measured = A + math.radians(60.0) ** -2 * np.eye(2)
    u = np.linalg.solve(measured + L, measured @ z + L @ m)
    wanted, _, _ = update(ahead.motion, z, np.linalg.inv(measured))
    assert_allclose(correct(ahead, u, A, m, L).motion.x, wanted.x, atol=1e-12)
    assert not np.allclose(correct(ahead, u, A).motion.x, wanted.x, atol=1e-4)


def test_a_ghk_filter_does_not_hear_of_unseen_joints():
    state, _ = run(np.outer(np.arange(8), [0.05, 0.05]), "ghk")
    ahead = predict(state, DT)
    after = correct(ahead, np.array([0.4, 9.0]), np.diag([1e8, 0.0]))
    assert ahead.ghk is not None
    assert after.ghk is not None
    assert after.ghk.q[1] == ahead.ghk.q[1]
    assert after.ghk.q[0] != ahead.ghk.q[0]


def test_no_evidence_leaves_the_prediction_nearly_as_it_was():
    state, _ = run(np.zeros((4, 2)), "kalman")
    ahead = predict(state, DT)
    after = correct(ahead, ahead.motion.q, np.zeros((2, 2)))
    assert_allclose(after.motion.x, ahead.motion.x, atol=1e-9)
    assert_allclose(after.motion.sigma, ahead.motion.sigma, rtol=0.01)


def test_restless_joints_are_predicted_less_surely():
    rng = np.random.default_rng(3)
    calm, restless = 0.0005 * rng.normal(size=60), 0.08 * rng.normal(size=60)
    state, _ = run(np.stack([calm, restless], axis=1), "kalman")
    assert state.psd[1] > 100.0 * state.psd[0]
    assert predict(state, DT).motion.sigma[1] > 5.0 * predict(state, DT).motion.sigma[0]


def test_the_first_frame_tells_nothing_of_restlessness():
    state = first_prediction(np.zeros(2), FPS, Settings())
    after = correct(predict(state, 0.0), np.array([0.3, -0.3]), 1e6 * np.eye(2))
    assert_allclose(after.psd, state.psd)


@pytest.mark.parametrize("filter_", FILTERS)
def test_the_longer_ahead_the_less_sure(filter_: Filter):
    state, _ = run(np.outer(np.arange(6), [0.02, 0.0]), filter_)
    spreads = [predict(state, dt).motion.sigma for dt in (DT, 2 * DT, 10 * DT)]
    assert (np.diff(spreads, axis=0) > 0.0).all()


def test_predicting_leaves_the_state_untouched():
    state, _ = run(np.outer(np.arange(6), [0.02, 0.0]), "ghk")
    kept = replace(state, motion=replace(state.motion, x=state.motion.x.copy(), P=state.motion.P.copy()))
    predict(state, DT)
    np.testing.assert_array_equal(state.motion.x, kept.motion.x)
    np.testing.assert_array_equal(state.motion.P, kept.motion.P)
