"""The valley line of a link's WSSD surface: straight, the best there is, refined for each profile by a parabola."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from handtrack.edges.valley import fit_valley


def bowls(vertex: np.ndarray, count: int = 41, curvature: float = 2.0, floor: float = 0.0) -> np.ndarray:
    """Curves `curvature / 2 (k - vertex)^2 + floor`."""
    return 0.5 * curvature * (np.arange(count) - vertex[:, None]) ** 2 + floor


@given(st.integers(3, 9), st.floats(8.0, 32.0), st.floats(-1.5, 1.5), st.floats(0.1, 50.0))
@settings(max_examples=40, deadline=None)
def test_a_straight_valley_is_found_to_a_fraction_of_a_sample(n, first, slope, curvature):
    vertex = np.clip(first + slope * np.arange(n), 2.0, 38.0)
    found = fit_valley(bowls(vertex, curvature=curvature, floor=3.0), np.ones(n), np.zeros(41))
    assert_allclose(found.minimum, vertex, atol=1e-6)
    assert_allclose(found.curvature, curvature, rtol=1e-6)
    assert_allclose(found.height, 3.0 + 0.5 * curvature * (vertex - np.rint(vertex)) ** 2, atol=0.3 * curvature)


def test_each_profile_keeps_its_own_minimum_near_the_line():
    vertex = np.array([20.3, 19.6, 20.4, 19.5, 20.2, 19.8])
    assert_allclose(fit_valley(bowls(vertex), np.ones(6), np.zeros(41)).minimum, vertex, atol=1e-9)


def test_the_line_is_no_costlier_than_any_other():
    rng = np.random.default_rng(2)
    for _ in range(10):
        surface, weight, cost = rng.uniform(0.0, 1.0, (5, 15)), rng.uniform(0.5, 2.0, 5), rng.uniform(0.0, 0.3, 15)
        total, row = surface * weight[:, None] + cost, np.arange(5)
        found = fit_valley(surface, weight, cost).line
        mine = total[row, np.clip(np.rint(found[0] + found[1] * row), 0, 14).astype(int)].sum()
        every = [total[row, np.rint(a + (b - a) * row / 4).astype(int)].sum() for a in range(15) for b in range(15)]
        assert mine <= min(every) + 1e-12


def test_a_nearer_dip_does_not_catch_the_line():
    k = np.arange(61.0)
    near, far = 0.3 - 0.3 * np.exp(-((k - 27.0) ** 2) / 8.0), 0.7 - 0.7 * np.exp(-((k - 45.0) ** 2) / 8.0)
    surface = np.tile(near + far, (6, 1))  # unit steps from the middle, 30, would end at 27
    assert_allclose(fit_valley(surface, np.ones(6), np.zeros(61)).minimum, 45.0, atol=0.3)


def test_the_prediction_decides_between_equal_valleys():
    k = np.arange(61.0)
    surface = np.tile(1.0 - np.exp(-((k - 20.0) ** 2) / 8.0) - np.exp(-((k - 42.0) ** 2) / 8.0), (6, 1))
    for centre, wanted in ((24.0, 20.0), (38.0, 42.0)):
        found = fit_valley(surface, np.ones(6), 1e-3 * (k - centre) ** 2)
        assert_allclose(found.minimum, wanted, atol=0.05)


def test_profiles_with_more_weight_draw_the_line():
    k = np.arange(61.0)
    dips = 1.0 - np.exp(-((k - np.array([20.0] * 3 + [42.0] * 3)[:, None]) ** 2) / 8.0)
    surface = np.vstack([dips[[0, 3]], dips[[0, 3]], dips[[0, 3]]])  # they take turns: no line serves both
    for heavy, wanted in ((0, 20.0), (1, 42.0)):
        weight = np.where(np.arange(6) % 2 == heavy, 5.0, 1.0)
        found = fit_valley(surface, weight, np.zeros(61))
        assert_allclose(found.minimum[heavy::2], wanted, atol=1e-6)


def test_a_curve_without_a_minimum_near_the_line_gives_none():
    surface = bowls(np.full(5, 20.0))
    surface[2] = np.linspace(5.0, 0.0, 41)
    surface[3] = 1.0
    found = fit_valley(surface, np.ones(5), np.zeros(41))
    np.testing.assert_array_equal(np.isnan(found.minimum), [False, False, True, True, False])
    assert np.isnan(found.curvature[2:4]).all() and np.isnan(found.height[2:4]).all()


def test_shifts_that_are_not_allowed_are_not_taken():
    surface = bowls(np.full(5, 10.0))
    surface[:, :15] = np.inf
    found = fit_valley(surface, np.ones(5), np.zeros(41))
    assert not (found.minimum < 15.0).any() and (found.line[0] + found.line[1] * np.arange(5) > 14.0).all()


def test_nothing_allowed_is_nothing_found():
    found = fit_valley(np.full((4, 21), np.inf), np.ones(4), np.zeros(21))
    assert np.isnan(found.minimum).all() and np.isfinite(found.line).all()


def test_a_single_profile_has_a_valley_too():
    found = fit_valley(bowls(np.array([12.25])), np.ones(1), np.zeros(41))
    assert_allclose(found.minimum, [12.25], atol=1e-9)
    assert found.line[0] == 12.0


def test_noise_moves_the_minimum_by_little():
    rng = np.random.default_rng(7)
    vertex = 18.0 + 0.7 * np.arange(8)
    surface = bowls(vertex, curvature=4.0) + rng.normal(0.0, 0.1, (8, 41))
    assert_allclose(fit_valley(surface, np.ones(8), np.zeros(41)).minimum, vertex, atol=0.15)
