"""The edge methods of appendix D on synthetic profiles: places, honest sigmas, and what each can and cannot do."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.special import ndtr

from handtrack.camera import orthographic
from handtrack.edges import BORDER, FLAT, FOUND, HIDDEN, JOINT, OUTSIDE, Crossings, EdgePoints
from handtrack.edges.derivative import difference, gaussian, gaussian_slopes, plain_slopes
from handtrack.edges.rectilinear import along_link, fit_iterative, fit_mwplls, fit_plls, mwplls, mwplls_iterative, plls
from handtrack.edges.slopes import noise_covariance, peaks, variance_of, vertex
from handtrack.edges.width_restricted import correlate, width, width_compensated
from handtrack.profiles import Profiles, Samplers, sample, with_rays

CAMERA = orthographic(640, 640, 1.0, 0.0, 0.0, np.eye(3), np.zeros(3))
SINGLE: tuple[Callable[[Crossings], EdgePoints], ...] = (difference, gaussian, width, width_compensated)
FITTED: tuple[Callable[[Crossings], EdgePoints], ...] = (plls, mwplls, mwplls_iterative)
METHODS = (*SINGLE, *FITTED)
HIT = np.isin(np.arange(8), (2, 5))
COUNT, HALF, U = 8, 12.0, np.arange(-80, 81) * 0.5
every_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: method.__name__)


def samplers(links: int, rng: np.random.Generator) -> tuple[Samplers, np.ndarray]:
    """Eight samplers across each link, ten pixels apart, in all directions; and their places along the link."""
    angle = np.repeat(rng.uniform(0.0, 2.0 * np.pi, links), COUNT)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x = np.tile(10.0 * (np.arange(COUNT) - 0.5 * (COUNT - 1)), links)
    origin = np.repeat(rng.uniform(150.0, 490.0, (links, 2)), COUNT, axis=0)
    origin = origin + x[:, None] * np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    zero = np.zeros(x.size, dtype=int)
    link = np.repeat(np.arange(links), COUNT)
    return with_rays(CAMERA, origin, direction, link, zero * 1.0, zero, zero, np.zeros((x.size, 3))), x


def bright(shift: np.ndarray, half: float = HALF, blur: float = 0.55) -> np.ndarray:
    """Profiles of a bright band, moved by `shift`."""
    rise, fall = U - (shift - half)[:, None], U - (shift + half)[:, None]
    return 10.0 + 150.0 * (ndtr(rise / blur) - ndtr(fall / blur))


def crossed(
    links: int = 6, noise: float = 0.0, seed: int = 0, reach: float = 6.0, shift: np.ndarray | None = None
) -> tuple[Crossings, np.ndarray]:
    """Links that lie off their prediction by a shift and a turn, and the true offset of every edge."""
    rng = np.random.default_rng(seed)
    placed, x = samplers(links, rng)
    n = placed.link.size
    if shift is None:
        shift = np.repeat(rng.uniform(-3.0, 3.0, links), COUNT) + np.repeat(rng.uniform(-0.03, 0.03, links), COUNT) * x
    values = bright(shift)
    if noise:
        values = values + sample(rng.normal(0.0, noise, (640, 640)), placed, U).values
    whole, edge = np.ones((n, U.size), dtype=bool), np.tile([-HALF, HALF], (n, 1))
    found = Crossings(
        placed,
        Profiles(U, values, whole),
        whole,
        edge,
        np.full((n, 2), 150.0),
        np.full((n, 2), FOUND),
        np.full(n, reach),
        max(noise, 0.3),
        0.55,
    )
    return found, np.stack([-shift, shift], axis=1).ravel()


def with_values(given: Crossings, values: np.ndarray) -> Crossings:
    return replace(given, profiles=replace(given.profiles, values=values))


@every_method
def test_a_clean_step_is_found_to_a_twentieth_of_a_pixel(method):
    given, true = crossed(links=20)
    found = method(given)
    assert (found.reason == FOUND).all()
    assert np.abs(found.offset - true).max() < 0.05
    assert_allclose(found.xy, (given.samplers.origin[:, None] + _at(given, true)).reshape(-1, 2), atol=0.05)


def _at(given: Crossings, offset: np.ndarray) -> np.ndarray:
    along = given.edge + np.array([-1.0, 1.0]) * offset.reshape(-1, 2)
    return along[..., None] * given.samplers.direction[:, None]


@every_method
@pytest.mark.parametrize("noise", [2.0, 8.0])
def test_errors_are_as_large_as_the_sigmas_say(method, noise):
    error = []
    for seed in range(4):
        given, true = crossed(links=40, noise=noise, seed=seed)
        found = method(given)
        assert (found.reason == FOUND).mean() > 0.98
        ok = found.reason == FOUND
        error.append(((found.offset - true) / found.sigma)[ok])
    error = np.concatenate(error)
    assert 0.8 < error.std() < 1.2
    assert abs(error.mean()) < 0.15


@every_method
def test_a_dark_finger_on_a_bright_ground_is_found_as_well(method):
    given, true = crossed(links=3)
    inverted = replace(with_values(given, 255.0 - given.profiles.values), rise=-given.rise)
    assert_allclose(method(inverted).offset, method(given).offset, atol=1e-9)
    assert_allclose(method(inverted).offset, true, atol=0.05)


@every_method
def test_the_wrong_sign_is_no_edge(method):
    given, _ = crossed(links=3)
    assert not (method(replace(given, rise=-given.rise)).reason == FOUND).any()


@every_method
@given(start=st.integers(0, 10_000), moved=st.integers(-3, 3))
@settings(max_examples=6, deadline=None)
def test_edges_move_with_the_profile(method, start, moved):
    given, _ = crossed(links=2, noise=3.0, seed=start)
    shifted = with_values(given, np.roll(given.profiles.values, moved, axis=1))
    wider = replace(shifted, edge=given.edge + 0.5 * moved)
    before, after = method(given), method(wider)
    np.testing.assert_array_equal(before.reason, after.reason)
    assert_allclose(before.offset, after.offset, atol=1e-8)
    assert_allclose(before.sigma, after.sigma, rtol=1e-6)


@every_method
@given(gain=st.floats(0.3, 3.0), level=st.floats(-50.0, 50.0))
@settings(max_examples=5, deadline=None)
def test_brightness_and_contrast_do_not_move_an_edge(method, gain, level):
    given, _ = crossed(links=2, noise=2.0)
    other = with_values(given, level + gain * given.profiles.values)
    other = replace(other, rise=gain * given.rise, noise=gain * given.noise)
    assert_allclose(method(other).offset, method(given).offset, atol=1e-7)
    assert_allclose(method(other).sigma, method(given).sigma, rtol=1e-6)


@every_method
@given(seed=st.integers(0, 10_000))
@settings(max_examples=6, deadline=None)
def test_what_lies_under_hidden_samples_changes_nothing(method, seed):
    rng = np.random.default_rng(seed)
    given, _ = crossed(links=2, noise=2.0, seed=seed)
    first, length = rng.integers(0, U.size, (2, given.samplers.link.size))
    window = (np.arange(U.size) < first[:, None]) | (np.arange(U.size) >= (first + length // 2)[:, None])
    hidden = replace(given, window=window)
    other = with_values(hidden, np.where(window, given.profiles.values, rng.uniform(0.0, 255.0, window.shape)))
    for one, two in zip(_columns(method(hidden)), _columns(method(other)), strict=True):
        np.testing.assert_array_equal(one, two)


def _columns(found: EdgePoints) -> tuple[np.ndarray, ...]:
    return found.xy, found.offset, found.sigma, found.reason


@every_method
def test_hidden_samples_give_no_edge(method):
    given, true = crossed(links=4)
    at = (given.edge[:, 1] + true[1::2])[:, None]  # the true edge on side +1, and all beyond
    window = at - 1.0 > U
    found = method(replace(given, window=window))
    assert not (found.reason[1::2] == FOUND).any()
    assert (found.reason[::2] == FOUND).all()
    assert np.abs(found.offset[::2] - true[::2]).max() < 0.05
    nothing = method(replace(given, window=np.zeros_like(window)))
    assert not (nothing.reason == FOUND).any() and np.isinf(nothing.sigma).all()


@every_method
def test_edges_that_are_not_expected_keep_their_reason(method):
    given, _ = crossed(links=3)
    state = np.tile([[HIDDEN, FOUND], [FOUND, JOINT], [FOUND, OUTSIDE]], (COUNT, 1))
    found = method(replace(given, state=state))
    np.testing.assert_array_equal(found.reason.reshape(-1, 2)[state != FOUND], state[state != FOUND])
    assert (found.reason.reshape(-1, 2)[state == FOUND] == FOUND).all()
    np.testing.assert_array_equal(found.offset.reshape(-1, 2)[state != FOUND], 0.0)


@every_method
def test_an_even_grey_has_no_edge(method):
    given, _ = crossed(links=2, noise=2.0)
    flat = with_values(given, np.full_like(given.profiles.values, 90.0))
    assert not (method(flat).reason == FOUND).any()
    assert set(np.unique(method(flat).reason)) <= {FLAT, BORDER}


@every_method
def test_no_edge_is_believed_beyond_reach(method):
    given, _ = crossed(links=3, shift=np.full(3 * COUNT, 5.0), reach=3.0)
    found = method(given)
    assert not (found.reason == FOUND).any()


@every_method
def test_no_profiles_give_no_edges(method):
    given, _ = crossed(links=1)
    none = Crossings(
        samplers(0, np.random.default_rng(0))[0],
        Profiles(U, np.zeros((0, U.size)), np.zeros((0, U.size), dtype=bool)),
        np.zeros((0, U.size), dtype=bool),
        np.zeros((0, 2)),
        np.zeros((0, 2)),
        np.zeros((0, 2), dtype=int),
        np.zeros(0),
        1.0,
        0.5,
    )
    assert method(none).reason.shape == (0,) and given.step == 0.5


def test_the_plain_difference_stands_halfway_between_its_samples():
    given, _ = crossed(links=1, shift=np.zeros(COUNT))
    ramp = with_values(given, np.tile(3.0 * U, (COUNT, 1)))
    slopes = plain_slopes(ramp)
    assert_allclose(slopes.u, U[:-1] + 0.25)
    assert_allclose(slopes.values, 3.0)
    step = with_values(given, np.where(U < 4.0, 10.0, 160.0)[None] + np.zeros((COUNT, 1)))  # rises from 3.5 to 4
    assert_allclose(plain_slopes(step).u[np.argmax(plain_slopes(step).values, axis=1)], 3.75)


def test_the_gaussian_amplifies_noise_less_than_the_difference():
    given, _ = crossed(links=4, noise=5.0)
    assert (gaussian_slopes(given).covariance[:, 0] < 0.5 * plain_slopes(given).covariance[:, 0]).all()
    assert_allclose(gaussian_slopes(with_values(given, np.tile(2.0 * U, (32, 1)))).values, 2.0)


@pytest.mark.parametrize("make", [plain_slopes, gaussian_slopes])
def test_the_noise_of_derivatives_is_as_stated(make):
    rng = np.random.default_rng(3)
    placed, _ = samplers(400, rng)
    n = placed.link.size
    values = sample(rng.normal(0.0, 4.0, (640, 640)), placed, U).values
    whole = np.ones(values.shape, dtype=bool)
    two, found = np.zeros((n, 2)), np.full((n, 2), FOUND)
    flat = Crossings(placed, Profiles(U, values, whole), whole, two, two, found, np.ones(n), 4.0, 0.5)
    given = make(flat)
    for lag in (0, 1, 2, 4):
        product = (given.values[:, lag:] * given.values[:, : given.values.shape[1] - lag]).mean()
        assert_allclose(product, given.covariance[:, lag].mean(), atol=0.06 * given.covariance[:, 0].mean())


def test_a_weighted_sum_has_the_variance_that_its_noise_gives_it():
    rng = np.random.default_rng(5)
    covariance = noise_covariance(np.array([-1.0, 0.0, 1.0]), np.array([[0.6, 0.8]]), 0.5)
    weight = rng.normal(size=(1, 6))
    lag = np.abs(np.arange(6)[:, None] - np.arange(6))
    dense = np.where(lag < covariance.shape[1], covariance[0, np.minimum(lag, covariance.shape[1] - 1)], 0.0)
    assert_allclose(variance_of(weight, covariance), weight @ dense @ weight[0])


@given(st.floats(-0.5, 0.5), st.floats(0.8, 4.0))
@settings(max_examples=30, deadline=None)
def test_the_vertex_of_a_gaussian_is_exact_and_its_derivative_true(place, spread):
    curve = np.exp(-0.5 * ((np.arange(5.0) - 2.0 - place) / spread) ** 2)[None]
    at = np.array([2])
    shift, by = vertex(curve, at)
    assert_allclose(shift, place, atol=1e-9)
    for j in range(3):
        moved = curve.copy()
        moved[0, 1 + j] += 1e-7
        assert_allclose((vertex(moved, at)[0] - shift) / 1e-7, by[:, j], rtol=1e-3, atol=1e-4)


def test_a_curve_that_is_not_positive_has_the_vertex_of_a_parabola():
    curve = -((np.arange(5.0) - 2.2) ** 2)[None]
    assert_allclose(vertex(curve, np.array([2]))[0], 0.2)
    assert np.isinf(vertex((np.arange(5.0)[None] - 2.0) ** 2 + 1.0, np.array([2]))[1]).all()


def test_a_peak_at_the_rim_of_what_is_allowed_is_no_vertex():
    curve = np.exp(-0.5 * (np.arange(9.0) - 6.0) ** 2)[None]
    whole, part = np.ones((1, 9), dtype=bool), (np.arange(9) < 5)[None]
    found = peaks(curve, whole, part, np.arange(9.0), np.ones((1, 1)))
    assert not found.inner[0] and np.isinf(found.sigma[0])
    nothing = peaks(curve, whole, ~whole, np.arange(9.0), np.ones((1, 1)))
    assert np.isnan(nothing.place[0]) and nothing.height[0] == -np.inf


def ringed(given: Crossings, at: float, size: float = 260.0) -> Crossings:
    """A brighter band inside the link, steeper than its edges, `at` pixels from the axis on both sides."""
    ring = size * (ndtr((U + at) / 0.4) - ndtr((U - at) / 0.4))
    return with_values(given, given.profiles.values + ring)


@pytest.mark.parametrize("method", [width, width_compensated, plls, mwplls_iterative], ids=lambda m: m.__name__)
def test_knowing_the_width_a_stronger_edge_at_the_wrong_width_is_ignored(method):
    given, true = crossed(links=4, shift=np.full(4 * COUNT, 1.0))
    given = ringed(given, 3.0)
    assert not (difference(given).reason == FOUND).any() and not (gaussian(given).reason == FOUND).any()
    found = method(given)
    assert (found.reason == FOUND).all()
    assert np.abs(found.offset - true).max() < 0.3


def test_compensation_finds_a_link_that_has_left_the_windows():
    shift = np.full(4 * COUNT, 8.0)
    given, true = crossed(links=4, shift=shift, reach=10.0)
    assert not (width(given).reason == FOUND).any()  # the windows are 12 pixels wide
    found = width_compensated(given)
    assert (found.reason == FOUND).all() and np.abs(found.offset - true).max() < 0.05


def test_the_correlation_peaks_where_both_edges_meet_the_template():
    given, true = crossed(links=4)
    surface = correlate(given, gaussian_slopes(given))
    assert_allclose(surface.shift[np.argmax(surface.curves, axis=1)], true[1::2], atol=0.26)
    assert_allclose(surface.curves.max(axis=1), surface.wanted, rtol=0.05)
    single = correlate(
        replace(given, state=np.tile([HIDDEN, FOUND], (given.samplers.link.size, 1))), gaussian_slopes(given)
    )
    assert_allclose(single.curves.max(axis=1), 0.5 * surface.wanted, rtol=0.05)
    assert_allclose(single.wanted, 0.5 * surface.wanted)
    assert_allclose(single.covariance.sum(axis=1), 0.5 * surface.covariance.sum(axis=1), atol=2e-3)


def cluttered(seed: int, strength: float = 90.0) -> tuple[Crossings, np.ndarray]:
    """A faint link; on two of its eight profiles clutter of the same width stands out more, at other shifts."""
    rng = np.random.default_rng(seed)
    given, true = crossed(links=4, noise=3.0, seed=seed, reach=9.0)
    n = given.samplers.link.size
    values = 10.0 + 0.4 * (given.profiles.values - 10.0)
    hit = np.tile(HIT, 4)
    away = true[1::2] + rng.choice([-1.0, 1.0], n) * rng.uniform(4.0, 5.5, n)
    for sign in (-1.0, 1.0):
        # Narrow lines just inside where a displaced link's edges would be.
        rim = U - (away + sign * HALF)[:, None]
        values = values + hit[:, None] * strength * ndtr(-sign * rim / 0.5) * ndtr((sign * rim + 4.0) / 0.5)
    return replace(with_values(given, values), rise=0.4 * given.rise), true


def test_the_iterated_line_goes_through_clutter_that_single_profiles_miss():
    for seed in range(3):
        given, true = cluttered(seed)
        hit = np.repeat(np.tile(HIT, 4), 2)
        alone, line = width_compensated(given), mwplls_iterative(given)
        missed = (alone.reason != FOUND) | (np.abs(alone.offset - true) > 2.0)
        assert missed[hit].all() and not missed[~hit].any()
        assert (line.reason == FOUND).all()
        assert np.abs(line.offset - true).max() < 0.2
        assert np.sqrt(np.mean((plls(given).offset - true) ** 2)) > 2.0 * np.sqrt(np.mean((line.offset - true) ** 2))


def test_a_line_through_clutter_claims_less():
    clean, _ = crossed(links=4, noise=3.0, reach=9.0)
    assert np.median(plls(cluttered(0)[0]).sigma) > 10.0 * np.median(plls(clean).sigma)


def test_mwplls_is_drawn_between_two_crests_and_its_iteration_to_the_heavier():
    given, true = crossed(links=2, shift=np.full(2 * COUNT, -2.0), reach=9.0)
    other = bright(np.full(2 * COUNT, 4.0)) - 10.0
    both = with_values(given, given.profiles.values + 0.5 * other)
    surface, x = correlate(both, gaussian_slopes(both)), along_link(both)
    mass = fit_mwplls(surface, x, both.samplers.link).shift
    assert ((mass > -1.0) & (mass < 1.0)).all()
    assert_allclose(fit_iterative(surface, x, both.samplers.link).shift, -2.0, atol=0.1)
    assert_allclose(fit_plls(surface, x, both.samplers.link).shift, -2.0, atol=0.05)
    assert true[0] == 2.0


def test_mwplls_is_the_minimum_of_its_cost():
    given, _ = crossed(links=1, noise=6.0, seed=4)
    surface, x = correlate(given, gaussian_slopes(given)), along_link(given)
    crest = fit_mwplls(surface, x, given.samplers.link)
    w = np.where(surface.allowed, np.maximum(surface.curves - 3.0 * np.sqrt(surface.covariance[:, :1]), 0.0), 0.0)

    def cost(c: np.ndarray) -> float:
        line = c[0] + c[1] * x
        return float(((w * (surface.shift - line[:, None])).sum(axis=1) ** 2).sum())

    c1 = (crest.shift[-1] - crest.shift[0]) / (x[-1] - x[0])
    best = np.array([crest.shift[0] - c1 * x[0], c1])
    for step in (np.array([1e-3, 0.0]), np.array([0.0, 1e-5])):
        assert cost(best) < min(cost(best + step), cost(best - step))


@pytest.mark.parametrize("method", FITTED, ids=lambda method: method.__name__)
def test_fitted_edges_of_a_link_lie_on_two_parallel_lines(method):
    given, _ = crossed(links=3, noise=6.0)
    found = method(given)
    for one in range(3):
        mine = np.repeat(given.samplers.link == one, 2)
        for side in (0, 1):
            xy = found.xy[mine][side::2]
            assert np.linalg.svd(xy - xy.mean(axis=0))[1][1] < 1e-9
    assert_allclose(found.offset[::2], -found.offset[1::2])


@pytest.mark.parametrize("method", FITTED, ids=lambda method: method.__name__)
def test_a_line_wants_three_profiles(method):
    given, _ = crossed(links=1)
    state = np.full((COUNT, 2), HIDDEN)
    state[:2] = FOUND
    found = method(replace(given, state=state))
    assert (found.reason == HIDDEN).all()
    state[2] = FOUND
    assert (method(replace(given, state=state)).reason[:6] == FOUND).all()


def test_places_along_a_link_are_those_of_its_samplers():
    given, _ = crossed(links=3)
    assert_allclose(np.abs(along_link(given)), np.tile(10.0 * np.arange(COUNT), 3), atol=1e-9)
