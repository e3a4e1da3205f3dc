"""Claims about the Kalman and g-h-k filters, and about the process noise that the Kalman filter finds by itself."""

import re

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.gh import GHKFilter
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.stats import chi2

from handtrack.ghk import (
    Ghk,
    critically_damped_gains,
    ghk_gains,
    ghk_noise_gain,
    ghk_predict,
    ghk_start,
    ghk_start_steady,
    ghk_update,
)
from handtrack.process_noise import process_from_innovations
from handtrack.smooth import KalmanState, predict, predict_frozen, process_covariance, start, transition, update

DEGREE = np.pi / 180
DT = 0.04


def random_covariance(rng, n, scale=1.0):
    root = rng.normal(size=(n, n + 2))
    return scale * root @ root.T / n


def random_state(rng, j, order):
    return KalmanState(rng.normal(size=order * j), random_covariance(rng, order * j), order)


# --- Kalman: models -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("dt", [0.0, 0.01, 0.04, 1.7])
def test_process_covariance_is_filterpys_continuous_white_noise(order, dt):
    expected = Q_continuous_white_noise(order, dt=dt, spectral_density=1.0) if dt else np.zeros((order, order))
    np.testing.assert_allclose(process_covariance(order, dt), np.asarray(expected), atol=1e-15)


@pytest.mark.parametrize("order", [2, 3])
@given(first=st.floats(0.001, 2.0), second=st.floats(0.001, 2.0))
@settings(max_examples=20, deadline=None)
def test_two_short_predictions_are_one_long_one(order, first, second):
    rng = np.random.default_rng(0)
    state, psd = random_state(rng, 3, order), rng.uniform(0, 5, 3)
    twice = predict(predict(state, first, psd), second, psd)
    once = predict(state, first + second, psd)
    np.testing.assert_allclose(twice.x, once.x, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(twice.P, once.P, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("order", [2, 3])
def test_prediction_extends_the_taylor_polynomial(order):
    state = KalmanState(np.array([1.0, 2.0, 6.0][:order]), np.eye(order), order)
    value = predict(state, 0.5, 0.0).q[0]
    assert value == pytest.approx(1.0 + 2.0 * 0.5 + (6.0 * 0.125 if order == 3 else 0.0))


def test_shared_matrices_cannot_be_written():
    for matrix in (transition(2, 0.1), process_covariance(2, 0.1)):
        with pytest.raises(ValueError, match="read-only"):
            matrix[0, 0] = 7.0


def test_predicting_over_no_time_changes_nothing():
    state = random_state(np.random.default_rng(1), 4, 3)
    same = predict(state, 0.0, 1.0)
    np.testing.assert_array_equal(same.x, state.x)
    np.testing.assert_allclose(same.P, state.P, rtol=1e-15)


# --- Kalman: against independent oracles ---------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("j", [1, 4])
def test_filter_follows_filterpy_step_by_step(order, j):
    rng = np.random.default_rng(order * 10 + j)
    state, psd = random_state(rng, j, order), rng.uniform(0.1, 5, j)
    oracle = KalmanFilter(dim_x=order * j, dim_z=j)
    oracle.x, oracle.P = state.x[:, None].copy(), state.P.copy()
    oracle.H = np.eye(j, order * j)
    for _ in range(25):
        dt, z, R = rng.uniform(0.01, 0.2), rng.normal(size=j), random_covariance(rng, j, 0.1)
        state, innovation, S = update(predict(state, dt, psd), z, R)
        oracle.predict(
            F=np.kron(transition(order, dt), np.eye(j)), Q=np.kron(process_covariance(order, dt), np.diag(psd))
        )
        oracle.update(z[:, None], R=R)
        np.testing.assert_allclose(state.x, oracle.x[:, 0], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(state.P, oracle.P, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(innovation, oracle.y[:, 0], rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(S, oracle.S, rtol=1e-8, atol=1e-10)


def test_filter_is_the_posterior_of_the_joint_gaussian():
    # Condition the joint distribution of all measurements and the last state in one go, without recursion.
    rng = np.random.default_rng(5)
    order, j, n = 2, 2, 4
    first, psd = random_state(rng, j, order), np.array([0.7, 2.0])
    steps, zs = rng.uniform(0.1, 1.0, n), rng.normal(size=(n, j))
    noises = [random_covariance(rng, j) for _ in range(n)]
    state = first
    for dt, z, R in zip(steps, zs, noises, strict=True):
        state = update(predict(state, dt, psd), z, R)[0]
    H, size = np.eye(j, order * j), order * j
    mean, joint = [first.x], first.P
    for i, dt in enumerate(steps):
        A, Q = np.kron(transition(order, dt), np.eye(j)), np.kron(process_covariance(order, dt), np.diag(psd))
        last = slice(i * size, (i + 1) * size)
        cross = joint[:, last] @ A.T
        joint = np.block([[joint, cross], [cross.T, A @ joint[last, last] @ A.T + Q]])
        mean.append(A @ mean[-1])
    pick = np.zeros((n * j, (n + 1) * size))
    R_all = np.zeros((n * j, n * j))
    for i, R in enumerate(noises):
        pick[i * j : (i + 1) * j, (i + 1) * size : (i + 2) * size] = H
        R_all[i * j : (i + 1) * j, i * j : (i + 1) * j] = R
    S = pick @ joint @ pick.T + R_all
    gain = np.linalg.solve(S, pick @ joint[:, -size:]).T
    np.testing.assert_allclose(state.x, mean[-1] + gain @ (zs.ravel() - pick @ np.concatenate(mean)), atol=1e-10)
    np.testing.assert_allclose(state.P, joint[-size:, -size:] - gain @ pick @ joint[:, -size:], atol=1e-10)


@pytest.mark.parametrize("order", [2, 3])
def test_a_batch_of_filters_is_many_filters(order):
    rng = np.random.default_rng(2)
    states = [random_state(rng, 2, order) for _ in range(5)]
    batch = KalmanState(np.stack([s.x for s in states]), np.stack([s.P for s in states]), order)
    psd, z = rng.uniform(0, 2, (5, 2)), rng.normal(size=(5, 2))
    z[1, 0] = z[3, 1] = np.nan
    R = np.stack([random_covariance(rng, 2) for _ in range(5)])
    together, innovation, S = update(predict(batch, DT, psd), z, R)
    for i, state in enumerate(states):
        alone, y, s = update(predict(state, DT, psd[i]), z[i], R[i])
        np.testing.assert_allclose(together.x[i], alone.x, atol=1e-12)
        np.testing.assert_allclose(together.P[i], alone.P, atol=1e-12)
        np.testing.assert_array_equal(innovation[i], y)
        np.testing.assert_allclose(S[i], s, atol=1e-12)
    np.testing.assert_allclose(together.sigma[0], np.sqrt(np.diag(together.covariance[0])))


# --- Kalman: missing measurements, start, precision ---------------------------------------------------------------


def test_an_unmeasured_joint_is_one_left_out_of_the_update():
    rng = np.random.default_rng(3)
    state, z, R = random_state(rng, 3, 2), rng.normal(size=3), random_covariance(rng, 3)
    z[1] = np.nan
    left, innovation, S = update(state, z, R)
    seen = [0, 2]
    H = np.eye(3, 6)[seen]
    gain = state.P @ H.T @ np.linalg.inv(H @ state.P @ H.T + R[np.ix_(seen, seen)])
    np.testing.assert_allclose(left.x, state.x + gain @ (z[seen] - state.x[seen]), atol=1e-12)
    np.testing.assert_allclose(left.P, (np.eye(6) - gain @ H) @ state.P, atol=1e-12)
    assert np.isnan(innovation).tolist() == [False, True, False]
    assert np.isfinite(S).all()
    assert S[1, 1] == state.P[1, 1]


def test_a_missing_frame_changes_nothing():
    state = random_state(np.random.default_rng(4), 3, 2)
    same, innovation, S = update(state, np.full(3, np.nan), np.full((3, 3), np.nan))
    np.testing.assert_array_equal(same.x, state.x)
    np.testing.assert_allclose(same.P, state.P, rtol=1e-15)
    assert np.isnan(innovation).all()
    np.testing.assert_array_equal(S, state.covariance)


def test_a_nearly_unmeasured_joint_acts_like_an_unmeasured_one():
    rng = np.random.default_rng(6)
    state, z = random_state(rng, 3, 2), rng.normal(size=3)
    vague = update(state, z, np.diag([0.1, 1e9, 0.1]))[0]
    blind = update(state, np.where([False, True, False], np.nan, z), np.diag([0.1, 1.0, 0.1]))[0]
    np.testing.assert_allclose(vague.x, blind.x, atol=1e-7)
    np.testing.assert_allclose(vague.P, blind.P, atol=1e-7)


def test_the_second_frame_starts_the_velocity():
    R = np.diag([0.01, 0.04])
    state = start(np.array([0.1, -0.2]), R, sigma_velocity=1e4)
    state = update(predict(state, DT, 0.0), np.array([0.3, -0.3]), R)[0]
    np.testing.assert_allclose(state.velocity, [5.0, -2.5], rtol=1e-6)
    # Difference quotient of two independent measurements: variance 2 R / dt^2, covariance with the value R / dt.
    np.testing.assert_allclose(state.P[2:, 2:], 2 * R / DT**2, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(state.P[:2, 2:], R / DT, rtol=1e-5, atol=1e-8)


def test_the_third_frame_starts_the_acceleration():
    t = np.array([0.0, 0.05, 0.13])
    truth = 0.3 - 2.0 * t + 9.0 * t**2
    state = start(truth[:1], np.eye(1) * 1e-6, sigma_velocity=1e4, sigma_acceleration=1e5)
    for i in (1, 2):
        state = update(predict(state, t[i] - t[i - 1], 0.0), truth[i : i + 1], np.eye(1) * 1e-6)[0]
    np.testing.assert_allclose(state.x, [truth[2], -2.0 + 18.0 * t[2], 18.0], rtol=1e-4)


def test_a_fast_joint_is_not_lost_at_the_start():
    # 7 degrees a frame from the first frame on: lost by a filter that insists on zero velocity.
    speed, R = 7 * DEGREE / DT, np.eye(1) * (0.3 * DEGREE) ** 2
    state = start(np.zeros(1), R, sigma_velocity=200 * DEGREE)
    for i in range(1, 4):
        ahead = predict(state, DT, 10.0)
        state = update(ahead, np.array([speed * DT * i]), R)[0]
    assert abs(ahead.q[0] - 3 * speed * DT) < 0.5 * DEGREE


def test_covariance_stays_definite_through_a_sure_measurement_of_an_unknown_state():
    state = start(np.zeros(3), 1e8 * np.eye(3), sigma_velocity=1e6, sigma_acceleration=1e6)
    for _ in range(50):
        state = update(predict(state, DT, 1e-6), np.ones(3), 1e-10 * np.eye(3))[0]
        assert (np.linalg.eigvalsh(state.P) > -1e-12 * state.P.trace()).all()
        assert (np.diag(state.P) > 0).all()
        np.testing.assert_array_equal(state.P, state.P.T)
    np.testing.assert_allclose(state.q, 1.0, atol=1e-5)


def test_predictions_of_the_filters_own_model_are_consistent():
    rng = np.random.default_rng(7)
    order, j, n, psd, R = 2, 3, 300, np.array([0.5, 2.0, 8.0]), random_covariance(rng, 3, 0.01)
    A, root_Q = (
        np.kron(transition(order, DT), np.eye(j)),
        np.linalg.cholesky(np.kron(process_covariance(order, DT), np.diag(psd))),
    )
    truth = np.zeros(order * j)
    state, nees = start(np.zeros(j), R, sigma_velocity=1.0), []
    for _ in range(n):
        truth = A @ truth + root_Q @ rng.normal(size=order * j)
        z = truth[:j] + np.linalg.cholesky(R) @ rng.normal(size=j)
        state, y, S = update(predict(state, DT, psd), z, R)
        nees.append(y @ np.linalg.solve(S, y))
    # Innovations are independent: their sum is chi-square with 3 n degrees of freedom.
    assert chi2.ppf(0.0005, j * n) < np.sum(nees) < chi2.ppf(0.9995, j * n)


@pytest.mark.parametrize(
    ("dt", "psd", "message"),
    [
        (-0.1, 1.0, "dt: -0.1 is not a finite time step >= 0"),
        (np.nan, 1.0, "dt: nan is not a finite time step >= 0"),
        (0.1, -1.0, "psd: -1.0 must be finite and not negative"),
        (0.1, np.inf, "psd: inf must be finite and not negative"),
    ],
)
def test_time_steps_and_densities_out_of_range_are_named(dt, psd, message):
    state = random_state(np.random.default_rng(0), 1, 2)
    with pytest.raises(ValueError, match=re.escape(message)):
        predict(state, dt, psd)
    with pytest.raises(ValueError, match=re.escape(message)):
        predict_frozen(state, dt, psd, np.array([True]), 0.1)


# --- frozen joints -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 3])
def test_a_frozen_joint_keeps_its_pose_and_its_sigma_grows_like_a_random_walk(order):
    rng = np.random.default_rng(8)
    first = random_state(rng, 2, order)
    frozen, rate, state = np.array([True, False]), 0.3, first
    for i in range(1, 13):
        state = predict_frozen(state, DT, 1.0, frozen, rate)
        assert state.q[0] == first.q[0]
        assert state.velocity[0] == 0.0
        assert state.covariance[0, 0] == pytest.approx(first.covariance[0, 0] + rate**2 * DT * i)
        assert (np.linalg.eigvalsh(state.P) > 0).all()


def test_freezing_keeps_the_lost_velocity_as_uncertainty_and_no_more():
    state = KalmanState(np.array([0.2, 3.0]), np.diag([0.01, 0.5]), 2)
    once = predict_frozen(state, DT, 1.0, np.array([True]), 0.1)
    twice = predict_frozen(once, DT, 1.0, np.array([True]), 0.1)
    assert once.P[1, 1] == twice.P[1, 1] == pytest.approx(0.5 + 9.0)
    assert once.P[0, 1] == twice.P[0, 1] == 0.0


@pytest.mark.parametrize("order", [2, 3])
def test_joints_that_are_not_frozen_are_predicted_as_usual(order):
    rng = np.random.default_rng(9)
    state, psd = random_state(rng, 3, order), rng.uniform(0, 2, 3)
    mixed = predict_frozen(state, DT, psd, np.array([False, True, False]), 0.1)
    usual = predict(state, DT, psd)
    free = [i + 3 * level for level in range(order) for i in (0, 2)]
    np.testing.assert_allclose(mixed.x[free], usual.x[free], atol=1e-14)
    np.testing.assert_allclose(mixed.P[np.ix_(free, free)], usual.P[np.ix_(free, free)], atol=1e-13)
    none = predict_frozen(state, DT, psd, np.zeros(3, bool), 0.1)
    np.testing.assert_array_equal(none.P, usual.P)


def test_a_frozen_joint_beats_extrapolation_over_a_long_gap_of_a_motion_that_turns():
    t = np.arange(60) * DT
    truth = 25 * DEGREE * np.sin(2 * np.pi * t / 1.2)
    R = np.eye(1) * (0.2 * DEGREE) ** 2
    state = start(truth[:1], R, sigma_velocity=4.0)
    for i in range(1, 31):
        state = update(predict(state, DT, 50.0), truth[i : i + 1], R)[0]
    held = carried = state
    for _ in range(12):
        held = predict_frozen(held, DT, 50.0, np.array([True]), 0.8)
        carried = predict(carried, DT, 50.0)
    assert abs(held.q[0] - truth[42]) < abs(carried.q[0] - truth[42])
    assert abs(held.q[0] - truth[42]) < 2.5 * held.sigma[0]


# --- process noise from innovations -------------------------------------------------------------------------------


def tracked_with_found_noise(truth, sigma, rng, *, order=2, first_psd=1.0):
    """NEES of predictions and filtered values per frame and joint, and the densities used."""
    n, j = truth.shape
    R = sigma**2 * np.eye(j)
    z = truth + sigma * rng.normal(size=truth.shape)
    state = start(z[0], R, sigma_velocity=3.0, sigma_acceleration=50.0 if order == 3 else None)
    psd, ahead, after, used = np.full(j, first_psd), [], [], []
    for i in range(1, n):
        state = predict(state, DT, psd)
        ahead.append(((state.q - truth[i]) / state.sigma) ** 2)
        used.append(psd)
        state, innovation, S = update(state, z[i], R)
        after.append(((state.q - truth[i]) / state.sigma) ** 2)
        psd = process_from_innovations(psd, innovation, S, R)
    return np.array(ahead), np.array(after), np.array(used)


def smooth_motion(rng, n, j, fastest):
    """Splines through random key poses every 10 frames; `fastest` radians a frame at the fastest moment."""
    keys = np.arange(n // 10 + 3) * 10
    q = CubicSpline(keys, rng.uniform(-1, 1, (keys.size, j)))(np.arange(n))
    return q * fastest / np.abs(np.diff(q, axis=0)).max()


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize(("fastest", "sigma"), [(0.5, 0.1), (3.0, 0.3), (8.0, 0.1), (8.0, 1.0)])
def test_predictions_are_honest_for_slow_and_fast_joints_without_tuning(order, fastest, sigma):
    rng = np.random.default_rng(10)
    ahead, after, _ = tracked_with_found_noise(
        smooth_motion(rng, 160, 21, fastest * DEGREE), sigma * DEGREE, rng, order=order, first_psd=10.0
    )
    # After 30 frames of burn-in the mean of the normalised squared errors is one up to a third.
    assert 0.6 < ahead[30:].mean() < 1.35
    assert 0.8 < after[30:].mean() < 1.2
    assert 0.92 < (ahead[30:] < 4.0).mean() < 0.995


def test_the_density_of_true_white_acceleration_is_found():
    rng = np.random.default_rng(11)
    n, true_psd = 600, np.array([0.5, 20.0, 800.0])
    x, rows = np.zeros(6), []
    A, root = (
        np.kron(transition(2, DT), np.eye(3)),
        np.linalg.cholesky(np.kron(process_covariance(2, DT), np.diag(true_psd))),
    )
    for _ in range(n):
        rows.append(x[:3])
        x = A @ x + root @ rng.normal(size=6)
    ahead, _, used = tracked_with_found_noise(np.array(rows), 0.02 * DEGREE, rng)
    ratio = np.exp(np.log(used[100:]).mean(axis=0)) / true_psd
    assert ((ratio > 0.5) & (ratio < 2.0)).all()
    np.testing.assert_allclose(ahead[100:].mean(axis=0), 1.0, atol=0.25)


def test_a_joint_that_sets_off_is_followed_within_a_few_frames_and_calms_down_later():
    rng = np.random.default_rng(12)
    t = np.arange(240)
    truth = np.where((t > 80) & (t < 160), 25 * np.sin((t - 80) * 2 * np.pi / 20), 0.0)[:, None] * DEGREE
    ahead, _, used = tracked_with_found_noise(truth, 0.2 * DEGREE, rng)
    assert used[88] > 30 * used[78]
    assert used[-1] < 0.1 * used[155]
    assert ahead[90:158].mean() < 2.0


def test_one_wild_measurement_moves_the_density_by_a_bounded_factor():
    psd = process_from_innovations(np.ones(1), np.array([1e6]), np.eye(1), np.zeros((1, 1)), rate=0.1, limit=4.0)
    assert psd[0] == pytest.approx(np.exp(0.1 * 15))


def test_joints_without_measurement_or_without_information_keep_their_density():
    psd = np.array([3.0, 5.0, 7.0])
    found = process_from_innovations(psd, np.array([np.nan, 2.0, 2.0]), np.eye(3), np.diag([0.0, 1.0, 0.5]))
    assert found[0] == 3.0
    assert found[1] == 5.0
    assert found[2] > 7.0


def test_the_density_stays_within_its_bounds():
    S, none = np.eye(1), np.zeros((1, 1))
    low = high = np.ones(1)
    for _ in range(200):
        low = process_from_innovations(low, np.zeros(1), S, none, bounds=(0.5, 2.0))
        high = process_from_innovations(high, np.ones(1) * 3, S, none, bounds=(0.5, 2.0))
    assert (low[0], high[0]) == (0.5, 2.0)


@pytest.mark.parametrize(("rate", "limit"), [(0.0, 4.0), (1.5, 4.0), (0.1, 1.0)])
def test_rates_and_limits_out_of_range_are_named(rate, limit):
    with pytest.raises(ValueError, match=re.escape(f"rate, limit: {rate}, {limit}; wanted 0 < rate <= 1")):
        process_from_innovations(np.ones(1), np.ones(1), np.eye(1), np.eye(1), rate=rate, limit=limit)


# --- g-h-k ---------------------------------------------------------------------------------------------------------


def run_ghk(state, times, values, settings):
    """Filtered states at all times after the first, and the predictions that led to them."""
    ahead, after = [], []
    for dt, z in zip(np.diff(times), values[1:], strict=True):
        state = ghk_predict(state, float(dt), settings)
        ahead.append(state)
        state = ghk_update(state, z, settings)
        after.append(state)
    return ahead, after


@pytest.mark.parametrize("theta", [0.3, 0.6, 0.85, 0.95])
def test_gains_settle_at_the_critically_damped_ones(theta):
    chosen = Ghk(theta, DT)
    state = ghk_start(np.zeros(2))
    for _ in range(600):
        ahead = ghk_predict(state, DT, chosen)
        state = ghk_update(ahead, np.zeros(2), chosen)
    for gain, expected in zip(ghk_gains(ahead), critically_damped_gains(theta), strict=True):
        np.testing.assert_allclose(gain, expected, rtol=1e-5)


@pytest.mark.parametrize("theta", [0.3, 0.85])
def test_steady_filter_follows_filterpy_step_by_step(theta):
    rng = np.random.default_rng(13)
    values = rng.normal(size=(40, 3)).cumsum(axis=0)
    oracle = GHKFilter(values[0], np.zeros(3), np.zeros(3), DT, *critically_damped_gains(theta))
    chosen = Ghk(theta, DT)
    _, after = run_ghk(ghk_start_steady(values[0], chosen), np.arange(40) * DT, values, chosen)
    for state, z in zip(after, values[1:], strict=True):
        oracle.update(z)
        np.testing.assert_allclose(state.q, oracle.x, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(state.velocity, oracle.dx, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(state.acceleration, oracle.ddx, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("theta", [0.5, 0.85])
@pytest.mark.parametrize("even", [True, False])
def test_filter_is_the_discounted_least_squares_parabola(theta, even):
    # Squared errors weighted by theta^(age / dt0); polyfit multiplies errors, hence the square root.
    rng = np.random.default_rng(14)
    steps = np.full(60, DT) if even else DT * rng.choice([0.5, 1.0, 1.3, 4.0], 60)
    times = np.concatenate([[0.0], steps.cumsum()])
    values = rng.normal(size=(61, 1)).cumsum(axis=0)
    _, after = run_ghk(ghk_start(values[0]), times, values, Ghk(theta, DT))
    for i in (4, 10, 60):
        age = times[: i + 1] - times[i]
        fit = np.polyfit(age, values[: i + 1, 0], 2, w=theta ** (-age / DT / 2))
        state = after[i - 1]
        np.testing.assert_allclose(state.q[0], fit[2], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(state.velocity[0], fit[1], rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(state.acceleration[0], 2 * fit[0], rtol=1e-4, atol=1e-1)


@pytest.mark.parametrize("theta", [0.3, 0.85])
@pytest.mark.parametrize("even", [True, False])
def test_constant_acceleration_is_followed_without_lag_from_the_third_frame(theta, even):
    steps = np.full(30, DT) if even else DT * np.random.default_rng(1).uniform(0.2, 3.0, 30)
    times = np.concatenate([[0.0], steps.cumsum()])
    values = (1.0 - 3.0 * times + 20.0 * times**2)[:, None]
    ahead, after = run_ghk(ghk_start(values[0]), times, values, Ghk(theta, DT))
    for i in range(2, 30):
        assert ahead[i].q[0] == pytest.approx(values[i + 1, 0], abs=1e-4)
        assert after[i].acceleration[0] == pytest.approx(40.0, rel=1e-3)


@pytest.mark.parametrize("theta", [0.3, 0.6, 0.85])
def test_constant_jerk_leaves_the_lag_that_the_gains_foretell(theta):
    jerk, chosen = 300.0, Ghk(theta, DT)
    times = np.arange(400) * DT
    values = (jerk * times**3 / 6)[:, None]
    ahead, after = run_ghk(ghk_start(values[0]), times, values, chosen)
    _, _, k = critically_damped_gains(theta)
    lag = jerk * DT**3 / (2 * k)
    assert values[-1, 0] - ahead[-1].q[0] == pytest.approx(lag, rel=1e-3)
    assert lag == pytest.approx(jerk * DT**3 / (1 - theta) ** 3)
    assert values[-1, 0] - after[-1].q[0] == pytest.approx(theta**3 * lag, rel=1e-3)


def test_after_missing_frames_the_gains_are_larger():
    chosen = Ghk(0.85, DT)
    steady = ghk_start_steady(np.zeros(1), chosen)
    gains = [float(ghk_gains(ghk_predict(steady, frames * DT, chosen))[0][0]) for frames in (1, 2, 5)]
    assert gains[0] == pytest.approx(1 - 0.85**3)
    assert gains[0] < gains[1] < gains[2] < 1.0


def test_an_unmeasured_joint_is_only_predicted():
    chosen = Ghk(0.7, DT)
    state = ghk_start(np.array([1.0, 2.0]))
    for z in ([1.1, 2.2], [1.2, np.nan], [1.3, np.nan]):
        ahead = ghk_predict(state, DT, chosen)
        state = ghk_update(ahead, np.array(z), chosen)
    assert state.q[1] == ahead.q[1] == pytest.approx(2.6, abs=1e-3)
    np.testing.assert_array_equal(state.information[1], ahead.information[1])
    assert state.q[0] == pytest.approx(1.3)


def test_a_gap_that_discounts_everything_restarts_the_filter():
    chosen = Ghk(0.85, DT)
    state = ghk_update(ghk_predict(ghk_start(np.zeros(1)), DT, chosen), np.zeros(1), chosen)
    state = ghk_update(ghk_predict(state, 3000.0, chosen), np.array([5.0]), chosen)
    assert state.q[0] == pytest.approx(5.0, abs=1e-6)
    for z in (5.1, 5.2, 5.3):
        ahead = ghk_predict(state, DT, chosen)
        state = ghk_update(ahead, np.array([z]), chosen)
    assert ahead.q[0] == pytest.approx(5.3, abs=1e-3)


def test_a_belief_in_rest_calms_the_first_extrapolations():
    chosen, values = Ghk(0.85, DT), np.array([[0.0], [1.0], [0.0]])
    wild, _ = run_ghk(ghk_start(values[0]), np.arange(3) * DT, values, chosen)
    calm, _ = run_ghk(ghk_start(values[0], 1.0, 1.0), np.arange(3) * DT, values, chosen)
    assert abs(calm[1].q[0]) < abs(wild[1].q[0])


@pytest.mark.parametrize("theta", [0.5, 0.85])
def test_noise_gain_is_the_variance_seen_in_simulation(theta):
    rng = np.random.default_rng(15)
    chosen = Ghk(theta, 1.0)
    state = ghk_start_steady(np.zeros(4000), chosen)
    for _ in range(80):
        ahead = ghk_predict(state, 1.0, chosen)
        state = ghk_update(ahead, rng.normal(size=4000), chosen)
    filtered, predicted = ghk_noise_gain(theta)
    assert state.q.var() == pytest.approx(filtered, rel=0.08)
    assert ahead.q.var() == pytest.approx(predicted, rel=0.08)


def test_extreme_discounts_believe_all_or_nothing():
    assert critically_damped_gains(0.0) == (1.0, 1.5, 0.5)
    assert critically_damped_gains(1.0) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Ghk(1.0, DT), "theta: 1.0 is not between 0 and 1"),
        (lambda: Ghk(0.85, 0.0), "dt0: 0.0 is not a finite time > 0"),
        (lambda: critically_damped_gains(1.5), "theta: 1.5 is not between 0 and 1"),
        (lambda: ghk_noise_gain(0.0), "theta: 0.0 is not between 0 and 1"),
        (lambda: ghk_start(np.array([np.nan])), "q: the first pose [nan] is not finite"),
        (lambda: ghk_start(np.zeros(1), 0.0), "velocity_weight, acceleration_weight: 0.0, 1e-07 must be > 0"),
        (lambda: ghk_predict(ghk_start(np.zeros(1)), -1.0, Ghk(0.5, DT)), "dt: -1.0 is not a finite time step >= 0"),
    ],
)
def test_ghk_arguments_out_of_range_are_named(call, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        call()
