"""Claims about the solvers, their steps, the covariance they report and the robust weights."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import least_squares

from handtrack.evidence import UNOBSERVED_VARIANCE, covariance_from_jacobian
from handtrack.robust import cauchy_weight, huber_weight, robust_sigma, tukey_weight
from handtrack.solve import METHODS, solve
from handtrack.steps import bounded_step, gauss_newton_step

DESCENDING = ("levenberg-marquardt", "trust-region")


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


def linear(seed, m, n):
    rng = np.random.default_rng(seed)
    matrix, target = rng.normal(size=(m, n)), rng.normal(size=m)
    return (lambda x: (matrix @ x - target, matrix)), matrix, target


def wavy(seed, m, n, height=0.3):
    """A nonlinear problem with a unique nearby minimum: linear plus a sine of another mixture."""
    rng = np.random.default_rng(seed)
    a, b, target = rng.normal(size=(m, n)), rng.normal(size=(m, n)), rng.normal(size=m)

    def fun(x):
        return a @ x + height * np.sin(b @ x) - target, a + height * np.cos(b @ x)[:, None] * b

    return fun, rng.normal(size=n)


def counted(fun):
    calls = []

    def wrapped(x):
        calls.append(np.array(x))
        return fun(x)

    return wrapped, calls


# --- finding the minimum ------------------------------------------------------------------------------------------


@given(st.integers(0, 10**6), st.integers(1, 8), st.integers(0, 20))
@settings(max_examples=30, deadline=None)
def test_gauss_newton_solves_linear_problems_in_one_step(seed, n, extra):
    fun, matrix, target = linear(seed, n + 5 + extra, n)
    solution = solve(fun, np.ones(n), method="gauss-newton", tolerance=1e-7)
    assert solution.status == "converged"
    assert solution.steps == 1
    np.testing.assert_allclose(solution.x, np.linalg.lstsq(matrix, target, rcond=None)[0], atol=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_walks_the_rosenbrock_valley(method):
    solution = solve(
        rosenbrock, np.array([-1.2, 1.0]), method=method, step=0.3 if method == "damped" else 1.0, max_steps=200
    )
    assert solution.status == "converged"
    np.testing.assert_allclose(solution.x, [1.0, 1.0], atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("n", "m"), [(1, 4), (6, 120), (21, 60)])
def test_random_problems_end_where_scipy_ends(method, n, m):
    fun, start = wavy(n, m, n)
    solution = solve(fun, start, method=method, max_steps=100)
    oracle = least_squares(
        lambda x: fun(x)[0],
        start,
        jac=lambda x: fun(x)[1],  # pyright: ignore[reportArgumentType]
        method="lm",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    assert solution.status == "converged"
    np.testing.assert_allclose(solution.x, oracle.x, atol=1e-5)
    assert solution.cost == pytest.approx(oracle.cost, rel=1e-9)
    assert solution.cost == pytest.approx(0.5 * solution.residual @ solution.residual, rel=1e-14)


@pytest.mark.parametrize("method", METHODS)
def test_solution_holds_residual_and_jacobian_of_its_own_point(method):
    fun, start = wavy(3, 20, 4)
    solution = solve(fun, start, method=method)
    np.testing.assert_array_equal(solution.residual, fun(solution.x)[0])
    np.testing.assert_array_equal(solution.jacobian, fun(solution.x)[1])
    step = 1e-6 * np.eye(4)
    numeric = np.stack([(fun(solution.x + e)[0] - fun(solution.x - e)[0]) / 2e-6 for e in step], axis=1)
    np.testing.assert_allclose(solution.jacobian, numeric, atol=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_the_start_is_not_written_into(method):
    fun, start = wavy(3, 20, 4)
    before = start.copy()
    solve(fun, start, method=method, bounds=np.array([[-0.1, 0.1]] * 4))
    np.testing.assert_array_equal(start, before)


@pytest.mark.parametrize("method", METHODS)
def test_a_function_is_called_once_per_step_and_once_at_the_start(method):
    problem, start = wavy(5, 30, 6)
    fun, calls = counted(problem)
    solution = solve(fun, start, method=method)
    assert len(calls) == solution.steps + 1


def test_one_gauss_newton_step_is_the_fast_variant():
    fun, start = wavy(7, 30, 6)
    solution = solve(fun, start, method="gauss-newton", max_steps=1)
    r, jacobian = fun(start)
    np.testing.assert_allclose(solution.x, start - np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ r), atol=1e-12)
    assert (solution.status, solution.steps) == ("max-steps", 1)


def test_damped_takes_its_share_of_the_gauss_newton_step():
    fun, start = wavy(7, 30, 6)
    full = solve(fun, start, method="gauss-newton", max_steps=1).x - start
    part = solve(fun, start, method="damped", step=0.1, max_steps=1).x - start
    np.testing.assert_allclose(part, 0.1 * full, atol=1e-13)


@pytest.mark.parametrize("method", DESCENDING)
@given(seed=st.integers(0, 10**6))
@settings(max_examples=15, deadline=None)
def test_descent_methods_never_raise_the_cost(method, seed):
    fun, start = wavy(seed, 12, 3, height=3.0)
    solution = solve(fun, 3 * start, method=method, trace=True)
    assert (np.diff(solution.trace_cost) <= 1e-12).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_trace_runs_from_the_start_to_the_solution(method):
    fun, start = wavy(11, 30, 5)
    solution = solve(fun, start, method=method, trace=True)
    np.testing.assert_array_equal(solution.trace_x[0], start)
    np.testing.assert_array_equal(solution.trace_x[-1], solution.x)
    assert solution.trace_cost[-1] == solution.cost
    assert solve(fun, start, method=method).trace_x.shape == (0, 5)


def test_levenberg_marquardt_does_not_care_about_units():
    fun, start = wavy(2, 40, 5, height=1.0)
    unit = np.array([1e-6, 1.0, 1e3, 1e6, 1.0])

    def rescaled(y):
        r, jacobian = fun(y * unit)
        return r, jacobian * unit

    plain = solve(fun, start, tolerance=0.0, max_steps=4)
    other = solve(rescaled, start / unit, tolerance=0.0, max_steps=4)
    np.testing.assert_allclose(other.x * unit, plain.x, rtol=1e-6)


def test_fewer_residuals_than_parameters_still_reach_zero_cost():
    fun, _, _ = linear(1, 3, 6)
    for method in METHODS:
        solution = solve(fun, np.zeros(6), method=method)
        assert solution.status == "singular"
        assert solution.cost < 1e-12
        assert solution.rank == 3


# --- bounds -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_rosenbrock_stops_at_the_bound(method):
    bounds = np.array([[-2.0, 0.5], [-1.0, 2.0]])
    solution = solve(rosenbrock, np.array([-1.2, 1.0]), method=method, bounds=bounds, max_steps=200)
    assert solution.status == "converged"
    np.testing.assert_allclose(solution.x, [0.5, 0.25], atol=1e-6)


@given(seed=st.integers(0, 10**6), n=st.integers(1, 7), width=st.floats(0.01, 2.0))
@settings(max_examples=60, deadline=None)
def test_bounded_levenberg_marquardt_ends_at_scipys_bounded_minimum(seed, n, width):
    fun, matrix, target = linear(seed, n + 6, n)
    rng = np.random.default_rng(seed)
    centre = rng.normal(size=n)
    bounds = np.stack([centre - width, centre + width], axis=1)
    solution = solve(fun, rng.normal(size=n), bounds=bounds, max_steps=100)
    oracle = least_squares(
        lambda x: matrix @ x - target,
        centre,
        jac=lambda x: matrix,  # pyright: ignore[reportArgumentType]
        bounds=(bounds[:, 0], bounds[:, 1]),
        method="dogbox",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    assert solution.status == "converged"
    assert solution.cost <= oracle.cost * (1 + 1e-8)
    assert ((solution.x >= bounds[:, 0]) & (solution.x <= bounds[:, 1])).all()


@pytest.mark.parametrize("method", METHODS)
def test_no_evaluation_leaves_the_bounds(method):
    problem, start = wavy(4, 30, 6, height=2.0)
    fun, calls = counted(problem)
    bounds = np.stack([start - 0.05, start + 0.3], axis=1)
    solve(fun, start + 1.0, method=method, bounds=bounds)
    tried = np.array(calls)
    assert ((tried >= bounds[:, 0]) & (tried <= bounds[:, 1])).all()


@pytest.mark.parametrize("method", ["levenberg-marquardt", "gauss-newton", "damped"])
def test_equal_bounds_hold_a_parameter_still(method):
    fun, _, _ = linear(9, 12, 3)
    bounds = np.array([[-np.inf, np.inf], [0.25, 0.25], [-np.inf, np.inf]])
    solution = solve(fun, np.zeros(3), method=method, bounds=bounds, step=0.5 if method == "damped" else 1.0)
    assert solution.status == "converged"
    assert solution.x[1] == 0.25
    gradient = solution.jacobian.T @ solution.residual
    np.testing.assert_allclose(gradient[[0, 2]], 0.0, atol=1e-8)


@given(seed=st.integers(0, 10**6), n=st.integers(1, 9))
@settings(max_examples=100, deadline=None)
def test_bounded_step_meets_the_optimality_conditions(seed, n):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n + 2, n))
    normal, gradient = root.T @ root + 1e-3 * np.eye(n), 3 * rng.normal(size=n)
    room = np.stack([-rng.uniform(0, 1, n), rng.uniform(0, 1, n)], axis=1) * rng.integers(0, 2, n)[:, None]
    h = bounded_step(normal, gradient, room)
    assert h is not None
    slope = gradient + normal @ h
    at_low, at_high = h <= room[:, 0], h >= room[:, 1]
    free = ~at_low & ~at_high
    assert (np.abs(slope[free]) < 1e-8).all()
    assert (slope[at_low & ~at_high] > -1e-8).all()
    assert (slope[at_high & ~at_low] < 1e-8).all()


def test_bounded_step_refuses_an_indefinite_matrix():
    assert bounded_step(-np.eye(2), np.ones(2), None) is None


# --- failure is data ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_a_blind_direction_gives_status_singular_and_stays_where_it_was(method):
    fun, _, _ = linear(3, 12, 2)

    def blind(x):
        r, jacobian = fun(x[[0, 2]])
        return r, np.insert(jacobian, 1, 0.0, axis=1)

    solution = solve(blind, np.array([5.0, 7.0, -3.0]), method=method, unobserved_variance=100.0)
    assert solution.status == "singular"
    assert solution.rank == 2
    assert solution.x[1] == 7.0
    np.testing.assert_allclose(np.abs(solution.null_directions[:, 0]), [0.0, 1.0, 0.0], atol=1e-12)
    assert np.isfinite(solution.covariance).all()
    assert solution.covariance[1, 1] == pytest.approx(100.0)


@pytest.mark.parametrize("method", ["levenberg-marquardt", "gauss-newton"])
def test_two_parameters_that_only_act_together_share_the_blame(method):
    def fun(x):
        return np.array([x[0] + x[1] - 2.0, 2 * (x[0] + x[1]) - 4.0]), np.array([[1.0, 1.0], [2.0, 2.0]])

    solution = solve(fun, np.zeros(2), method=method)
    assert solution.status == "singular"
    np.testing.assert_allclose(solution.x, [1.0, 1.0], atol=1e-8)


def test_gauss_newton_within_bounds_leaves_blind_parameters_alone():
    def fun(x):
        return np.array([x[0] - 5.0, x[0] - 6.0]), np.array([[1.0, 0.0], [1.0, 0.0]])

    solution = solve(fun, np.zeros(2), method="gauss-newton", bounds=np.array([[-1.0, 1.0], [-1.0, 1.0]]))
    assert solution.status == "singular"
    np.testing.assert_allclose(solution.x, [1.0, 0.0], atol=1e-12)


def test_leaving_the_finite_numbers_is_called_diverged():
    def fun(x):
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(x), 0.5 / np.sqrt(x)[:, None]

    solution = solve(fun, np.array([4.0]), method="gauss-newton")
    assert solution.status == "diverged"
    assert solution.x[0] == 4.0
    assert np.isfinite(solution.covariance).all()


@pytest.mark.parametrize("method", DESCENDING)
def test_descent_methods_step_back_from_where_residuals_are_not_finite(method):
    def fun(x):
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.log(x) - 1.0, (1.0 / x)[:, None]

    solution = solve(fun, np.array([30.0]), method=method)
    assert solution.status == "converged"
    assert solution.x[0] == pytest.approx(np.e, rel=1e-8)


def test_a_derivative_that_is_not_finite_counts_as_a_failed_step():
    def fun(x):
        return x - 1.0, np.array([[1.0 if x[0] == 0.0 else np.nan]])

    assert solve(fun, np.zeros(1), method="gauss-newton").status == "diverged"
    assert solve(fun, np.zeros(1), max_steps=3).x[0] == 0.0


def test_a_wrong_jacobian_ends_in_stalled():
    def fun(x):
        return np.array([x[0] - 1.0, 3.0]), np.array([[-1.0], [0.0]])

    solution = solve(fun, np.zeros(1), max_steps=500)
    assert solution.status == "stalled"
    assert solution.x[0] == 0.0


def test_a_wrong_jacobian_stalls_in_exact_arithmetic_too():
    def fun(x):
        return np.array([x[0] - 1.0, 3.0]), np.array([[-1.0], [0.0]])

    assert solve(fun, np.zeros(1), max_steps=500, tolerance=0.0).status == "stalled"


def test_a_bound_in_the_way_of_the_descent_is_convergence_not_a_stall():
    # The cost curves away from its quadratic model, so the damping has grown by the time the bound is met.
    def fun(x):
        return np.array([np.exp(-3 * x[0]) + 1, 0.3 * x[1]]), np.array([[-3 * np.exp(-3 * x[0]), 0.0], [0.0, 0.3]])

    solution = solve(fun, np.array([-2.0, 1.0]), bounds=np.array([[-3.0, 0.5], [-2.0, 2.0]]))
    assert solution.status == "converged"
    np.testing.assert_allclose(solution.x, [0.5, 0.0], atol=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_no_steps_allowed_returns_the_start(method):
    fun, start = wavy(1, 10, 2)
    solution = solve(fun, start, method=method, max_steps=0)
    assert (solution.status, solution.steps) == ("max-steps", 0)
    np.testing.assert_array_equal(solution.x, start)


@pytest.mark.parametrize("method", METHODS)
def test_a_start_at_the_minimum_has_converged(method):
    fun, matrix, target = linear(1, 10, 2)
    best = np.linalg.lstsq(matrix, target, rcond=None)[0]
    solution = solve(fun, best, method=method)
    assert solution.status == "converged"
    np.testing.assert_allclose(solution.x, best, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"method": "newton"}, "method: 'newton' is unknown, wanted one of levenberg-marquardt, "),
        ({"x0": np.array([np.nan, 0.0])}, "x0: [nan  0.] is not a finite vector"),
        ({"x0": np.empty(0)}, "x0: [] is not a finite vector with at least one element"),
        ({"step": 0.5}, "step: 0.5 with method 'levenberg-marquardt'"),
        ({"step": 0.0, "method": "damped"}, "step: 0.0 with method 'damped'"),
        ({"max_steps": -1}, "max_steps, tolerance: -1, 1e-10 must not be negative"),
        ({"tolerance": float("nan")}, "max_steps, tolerance: 50, nan must not be negative"),
        ({"bounds": np.zeros((3, 2))}, "bounds: shape (3, 2), wanted (2, 2)"),
        ({"bounds": np.array([[0.0, 1.0], [2.0, 1.0]])}, "bounds: parameter 1 has low 2.0 and high 1.0"),
        (
            {"bounds": np.array([[1.0, 1.0], [0.0, 1.0]]), "method": "trust-region"},
            "bounds: parameter 0 has low 1.0 and high 1.0",
        ),
        ({"unobserved_variance": 0.0}, "unobserved_variance: 0.0 is not a finite number > 0"),
    ],
)
def test_arguments_out_of_range_are_named(change, message):
    arguments = {"x0": np.zeros(2), **change}
    start = arguments.pop("x0")
    with pytest.raises(ValueError, match=re.escape(message)):
        solve(rosenbrock, start, **arguments)


def test_a_function_that_does_not_fit_is_named():
    with pytest.raises(ValueError, match=re.escape("fun: Jacobian of shape (2, 2), wanted (2, 3)")):
        solve(rosenbrock, np.zeros(3))
    with pytest.raises(ValueError, match=r"fun: residual or Jacobian at the start .* is not finite"):
        solve(lambda x: (np.array([np.nan]), np.ones((1, 1))), np.zeros(1))


# --- steps and covariance -----------------------------------------------------------------------------------------


@given(seed=st.integers(0, 10**6), n=st.integers(1, 6), scale=st.floats(1e-6, 1e6))
@settings(max_examples=50, deadline=None)
def test_gauss_newton_step_is_the_least_squares_solution_in_any_unit(seed, n, scale):
    rng = np.random.default_rng(seed)
    jacobian, r = rng.normal(size=(n + 6, n)), rng.normal(size=n + 6)
    unit = np.ones(n)
    unit[0] = scale
    expected = -np.linalg.lstsq(jacobian, r, rcond=None)[0]
    np.testing.assert_allclose(gauss_newton_step(r, jacobian * unit) * unit, expected, rtol=1e-6, atol=1e-8)


def test_covariance_matches_the_spread_of_repeated_measurements():
    rng = np.random.default_rng(0)
    t, truth, sigma = np.linspace(0, 3, 40), np.array([2.0, 0.7]), 0.02
    clean = truth[0] * np.exp(-truth[1] * t)
    found, reported = [], []
    for _ in range(400):
        noisy = clean + sigma * rng.normal(size=t.size)

        def decay(x, noisy=noisy):
            e = np.exp(-x[1] * t)
            return (x[0] * e - noisy) / sigma, np.stack([e, -x[0] * t * e], axis=1) / sigma

        solution = solve(decay, np.array([1.0, 1.0]))
        found.append(solution.x)
        reported.append(solution.covariance)
    ratio = np.linalg.solve(np.mean(reported, axis=0), np.cov(np.array(found).T))
    # The eigenvalues of the ratio are spread by about sqrt(2 / 400) around one.
    np.testing.assert_allclose(np.linalg.eigvals(ratio), 1.0, atol=0.3)
    errors = np.array(found) - truth
    nees = np.einsum("ki,kij,kj->k", errors, np.linalg.inv(reported), errors)
    assert nees.mean() == pytest.approx(2.0, abs=0.3)


@given(seed=st.integers(0, 10**6), n=st.integers(1, 8), rank=st.integers(0, 8))
@settings(max_examples=60, deadline=None)
def test_covariance_is_the_pseudo_inverse_plus_the_stated_variance_of_blind_directions(seed, n, rank):
    rank = min(rank, n)
    rng = np.random.default_rng(seed)
    directions = np.linalg.qr(rng.normal(size=(n, n)))[0][:, :rank]
    jacobian = rng.normal(size=(rank + 9, rank)) @ directions.T
    covariance, null = covariance_from_jacobian(jacobian, unobserved_variance=1e6)
    assert null.shape == (n, n - rank)
    np.testing.assert_allclose(jacobian @ null, 0.0, atol=1e-9)
    np.testing.assert_allclose(null.T @ null, np.eye(n - rank), atol=1e-12)
    expected = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-10) + 1e6 * null @ null.T
    np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
    assert (np.linalg.eigvalsh(covariance) > 0).all() or rank < n


@given(seed=st.integers(0, 10**6), exponent=st.floats(-9, 9))
@settings(max_examples=40, deadline=None)
def test_what_counts_as_blind_does_not_depend_on_units(seed, exponent):
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(20, 4))
    jacobian[:, 3] = jacobian[:, 2]
    unit = np.array([1.0, 10.0**exponent, 1.0, 1.0])
    covariance, null = covariance_from_jacobian(jacobian * unit, unobserved_variance=1e30)
    assert null.shape == (4, 1)
    assert np.isfinite(covariance).all()


def test_no_evidence_at_all_is_the_unobserved_variance():
    for empty in (np.zeros((5, 3)), np.zeros((0, 3))):
        covariance, null = covariance_from_jacobian(empty, unobserved_variance=4.0)
        np.testing.assert_allclose(covariance, 4.0 * np.eye(3))
        assert null.shape == (3, 3)


def test_weak_evidence_is_never_vaguer_than_none():
    covariance, null = covariance_from_jacobian(np.diag([1.0, 1e-8]), unobserved_variance=100.0)
    assert null.shape == (2, 0)
    np.testing.assert_allclose(np.diag(covariance), [1.0, 100.0])
    assert UNOBSERVED_VARIANCE > 100.0


def test_full_rank_covariance_is_the_plain_inverse():
    jacobian = np.random.default_rng(0).normal(size=(30, 6))
    covariance, null = covariance_from_jacobian(jacobian)
    np.testing.assert_allclose(covariance, np.linalg.inv(jacobian.T @ jacobian), rtol=1e-10)
    assert null.shape == (6, 0)


# --- robust weights -----------------------------------------------------------------------------------------------

LOSSES = {
    huber_weight: lambda z, c: np.where(np.abs(z) <= c, z**2 / 2, c * np.abs(z) - c**2 / 2),
    cauchy_weight: lambda z, c: c**2 / 2 * np.log1p((z / c) ** 2),
    tukey_weight: lambda z, c: np.where(np.abs(z) <= c, c**2 / 6 * (1 - (1 - (z / c) ** 2) ** 3), c**2 / 6),
}
DEFAULT_C = {huber_weight: 1.345, cauchy_weight: 2.385, tukey_weight: 4.685}


@pytest.mark.parametrize("weight", LOSSES)
@given(z=st.floats(-50, 50), c=st.floats(0.1, 10))
@settings(max_examples=40, deadline=None)
def test_weight_times_residual_is_the_slope_of_the_loss(weight, z, c):
    step = 1e-5
    # The second derivative jumps where a loss changes its branch; there a difference quotient says nothing.
    if abs(abs(z) - c) > 2 * step:
        slope = (LOSSES[weight](np.array(z + step), c) - LOSSES[weight](np.array(z - step), c)) / (2 * step)
        assert float(weight(np.array([z]), c)[0] * z) == pytest.approx(float(slope), rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("weight", LOSSES)
def test_weights_are_one_at_zero_even_and_fall_with_the_residual(weight):
    z = np.linspace(0, 20, 400)
    w = weight(z)
    assert w[0] == 1.0
    assert (np.diff(w) <= 1e-15).all()
    assert ((w >= 0) & (w <= 1)).all()
    np.testing.assert_array_equal(weight(-z), w)


@pytest.mark.parametrize("weight", LOSSES)
def test_default_constants_keep_95_percent_of_the_efficiency_for_normal_noise(weight):
    # Asymptotic efficiency of an M-estimator of location: E[psi']^2 / E[psi^2], psi(z) = w(z) z (Huber 1964), where
    # E[psi'] = E[z psi] for a standard normal z.
    def expect(f):
        half = lambda a, b: quad(lambda z: f(z) * np.exp(-z * z / 2) / np.sqrt(2 * np.pi), a, b)[0]  # noqa: E731
        c = DEFAULT_C[weight]
        return 2 * (half(0, c) + half(c, 12))

    psi = lambda z: float(weight(np.array([z]))[0]) * z  # noqa: E731
    efficiency = expect(lambda z: z * psi(z)) ** 2 / expect(lambda z: psi(z) ** 2)
    assert efficiency == pytest.approx(0.95, abs=5e-4)


@pytest.mark.parametrize("weight", LOSSES)
def test_reweighting_ignores_a_gross_error(weight):
    rng = np.random.default_rng(1)
    t = np.linspace(0, 1, 30)
    y = 1 + 2 * t + 0.01 * rng.normal(size=30)
    y[::6] += 5.0
    x = np.array([1.0, 1.5])
    design = np.stack([np.ones(30), t], axis=1)
    for _ in range(30):
        root = np.sqrt(weight((design @ x - y) / 0.1))
        x = solve(lambda x, root=root: (root * (design @ x - y) / 0.1, root[:, None] * design / 0.1), x).x
    np.testing.assert_allclose(x, [1.0, 2.0], atol=0.08)


def test_robust_sigma_is_the_standard_deviation_of_normal_noise_whatever_a_third_does():
    rng = np.random.default_rng(0)
    noise = 0.3 * rng.normal(size=20000)
    assert robust_sigma(noise) == pytest.approx(0.3, rel=0.02)
    noise[: noise.size // 3] *= 1e6
    assert robust_sigma(noise) < 0.6


@pytest.mark.parametrize("weight", LOSSES)
def test_tuning_constants_must_be_positive(weight):
    with pytest.raises(ValueError, match=re.escape("c: 0.0 is not a tuning constant, a number > 0 is wanted")):
        weight(np.zeros(1), 0.0)


def test_robust_sigma_of_nothing_is_refused():
    with pytest.raises(ValueError, match="residual: has no elements, at least one is wanted"):
        robust_sigma(np.empty(0))
