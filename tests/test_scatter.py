"""Scatter of edges: whitening by exact linear algebra, and its two numbers recovered from simulated residuals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.scatter import (
    Scatter,
    Whitened,
    common_share,
    first_scatter,
    learn_scatter,
    whiten_numpy,
    whitener,
)


def claimed(s: float, tau: float) -> Scatter:
    return Scatter(s, tau, np.zeros(2), np.eye(2))


def covariance(sigma: np.ndarray, group: np.ndarray, s: float, tau: float) -> np.ndarray:
    """Of errors in units of sigma, from the model `e_i = s sigma_i eps_i + tau b_c` itself."""
    together = (group[:, None] == group) / (sigma[:, None] * sigma)
    return s**2 * np.eye(sigma.size) + tau**2 * together


@given(st.integers(0, 10**6), st.floats(0.7, 4.0), st.floats(0.0, 2.0))
@settings(max_examples=40, deadline=None)
def test_whitened_errors_are_independent_and_of_unit_variance(seed, s, tau):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 30))
    sigma, group = rng.uniform(0.02, 0.8, n), np.unique(rng.integers(0, 6, n), return_inverse=True)[1]
    W = whitener(sigma, group, claimed(s, tau))(np.zeros(n), np.eye(n))[1]
    np.testing.assert_allclose(W @ covariance(sigma, group, s, tau) @ W.T, np.eye(n), atol=1e-9)


@pytest.mark.parametrize("order", ["C", "F"])
def test_kernel_and_numpy_twin_whiten_alike(order):
    rng = np.random.default_rng(0)
    sigma, group = rng.uniform(0.02, 0.8, 50), rng.integers(0, 7, 50)
    white = whitener(sigma, group, claimed(1.3, 0.2))
    r, J = rng.normal(size=50), np.asarray(rng.normal(size=(50, 6)), order=order)
    kept = r.copy(), J.copy()
    r_white, J_white = white(r, J)
    np.testing.assert_allclose(r_white, whiten_numpy(white, r[:, None])[:, 0], atol=1e-12)
    np.testing.assert_allclose(J_white, whiten_numpy(white, J), atol=1e-12)
    np.testing.assert_array_equal(r, kept[0])
    np.testing.assert_array_equal(J, kept[1])


def test_a_whitened_residual_function_is_the_whitened_residual():
    rng = np.random.default_rng(1)
    A, b = rng.normal(size=(20, 3)), rng.normal(size=20)
    white = whitener(rng.uniform(0.1, 0.5, 20), np.arange(20) // 4, claimed(1.5, 0.3))
    residual = Whitened(lambda u: (A @ u - b, A), white)
    u = np.array([0.3, -1.0, 2.0])
    for one, two in zip(residual(u), white(A @ u - b, A), strict=True):
        np.testing.assert_array_equal(one, two)


def test_without_a_common_offset_only_the_factor_is_taken_off():
    r = np.arange(6.0)
    out, _ = whitener(np.full(6, 0.1), np.zeros(6, dtype=int), claimed(2.0, 0.0))(r, np.zeros((6, 1)))
    np.testing.assert_allclose(out, r / 2.0)


def test_a_large_common_offset_is_ignored_altogether():
    white = whitener(np.full(8, 0.1), np.zeros(8, dtype=int), claimed(1.0, 1e6))
    out, _ = white(np.full(8, 3.0), np.zeros((8, 1)))
    np.testing.assert_allclose(out, 0.0, atol=1e-5)


def test_shares_grow_with_the_offset_and_unit_vectors_have_unit_length():
    sigma, group = np.array([0.1, 0.2, 0.1, 0.4, 0.3]), np.array([0, 0, 1, 1, 1])
    v, small = common_share(sigma, group, 1.0, 0.01)
    np.testing.assert_allclose(np.bincount(group, v**2), 1.0)
    _, large = common_share(sigma, group, 1.0, 1.0)
    assert ((small > 0) & (small < large) & (large < 1)).all()


def problem(rng: np.random.Generator, n: int = 90, k: int = 6, groups: int = 14):
    """Sigmas, groups, and a Jacobian in units of sigma with like rows within a group, as on one side of a link."""
    group = np.concatenate([np.arange(groups), rng.integers(0, groups, n - groups)])
    sigma = rng.uniform(0.03, 0.12, n)
    side = rng.normal(size=(groups, k))
    return sigma, group, side[group] * rng.uniform(0.3, 1.0, (n, 1)) * 30.0 / sigma[:, None]


def simulate(rng: np.random.Generator, s: float, tau: float, frames: int) -> list[Scatter]:
    """Scatter learnt frame by frame from generalised least squares, a new linear problem in each frame."""
    scatter, history = first_scatter(), []
    for _ in range(frames):
        sigma, group, J = problem(rng)
        n = sigma.size
        e = s * rng.normal(size=n) + tau * rng.normal(size=group.max() + 1)[group] / sigma
        W = whitener(sigma, group, scatter)(np.zeros(n), np.eye(n))[1]
        gain = np.linalg.inv((W @ J).T @ (W @ J)) @ (W @ J).T @ W
        r = e - J @ (gain @ e)
        z = np.abs(W @ r)
        scatter = learn_scatter(scatter, r, J, z / max(1.0, 1.4826 * float(np.median(z))), sigma, group, gain)
        history.append(scatter)
    return history


@pytest.mark.parametrize(("s", "tau"), [(1.0, 0.05), (1.5, 0.1), (2.0, 0.15), (1.0, 0.3)])
def test_factor_and_offset_are_learnt_from_residuals(s, tau):
    late = simulate(np.random.default_rng(3), s, tau, 160)[40:]
    assert np.sqrt(np.mean([x.s**2 for x in late])) == pytest.approx(s, rel=0.15)
    assert np.sqrt(np.mean([x.tau**2 for x in late])) == pytest.approx(tau, rel=0.15)


def test_only_the_floor_of_the_offset_is_learnt_where_there_is_none():
    late = simulate(np.random.default_rng(4), 1.0, 0.0, 100)[40:]
    assert np.median([x.tau for x in late]) == 0.03
    assert np.mean([x.s for x in late]) == pytest.approx(1.0, rel=0.1)


def test_an_edge_beyond_five_robust_sigmas_is_left_out():
    rng = np.random.default_rng(5)
    sigma, group, J = problem(rng)
    gain = np.linalg.pinv(J)
    r = rng.normal(size=90)
    found = []
    for wrong in (6.0, 6e5):
        r[17] = wrong
        z = np.where(np.arange(90) == 17, 6.0, np.minimum(np.abs(r), 2.4))
        found.append(learn_scatter(first_scatter(), r, J, z, sigma, group, gain))
    np.testing.assert_array_equal(found[0].moments, found[1].moments)
    assert (found[0].s, found[0].tau) == (found[1].s, found[1].tau)


def test_an_edge_beyond_two_and_a_half_robust_sigmas_counts_as_that():
    rng = np.random.default_rng(6)
    sigma, group, J = problem(rng)
    gain, r, z = np.linalg.pinv(J), rng.normal(size=90), np.ones(90)
    r[17], cut = 4.0, r.copy()
    z[17], cut[17] = 4.0, 2.5
    one = learn_scatter(first_scatter(), r, J, z, sigma, group, gain)
    two = learn_scatter(first_scatter(), cut, J, np.ones(90), sigma, group, gain)
    np.testing.assert_allclose(one.moments, two.moments, rtol=1e-12)


def test_a_wrong_model_makes_the_offset_grow_by_itself():
    early, late = (simulate(np.random.default_rng(6), 1.0, tau, 30)[-1].tau for tau in (0.05, 0.6))
    assert late > 5 * early


def test_before_any_frame_sigmas_are_as_claimed():
    start = first_scatter()
    assert start.s == 1.0 and start.tau == 0.03
    np.testing.assert_allclose(np.linalg.solve(start.response, start.moments), [1.0, 0.03**2])
