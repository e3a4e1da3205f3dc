"""Claims about particle clouds: laws of resampling, estimates against closed forms, a filter against Kalman's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.stats import multivariate_normal

from handtrack.body.particles import (
    SCHEMES,
    effective_size,
    ellipsoid,
    estimate,
    log_evidence,
    mahalanobis,
    normalised,
    resampled,
    volume,
)

LOGS = hnp.arrays(float, st.integers(1, 60), elements=st.one_of(st.floats(-800, 800), st.just(-np.inf)))


@given(LOGS)
def test_weights_sum_to_one_or_all_are_dead(logs):
    weight = normalised(logs)
    assert (weight >= 0).all()
    assert weight.sum() == (pytest.approx(1.0) if np.isfinite(logs).any() else 0.0)
    assert not weight[logs == -np.inf].any()


@given(LOGS, st.floats(-700, 700))
def test_weights_do_not_depend_on_a_common_factor(logs, shift):
    np.testing.assert_allclose(normalised(logs), normalised(logs + shift), atol=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_weights_that_are_no_numbers_are_refused(bad):
    with pytest.raises(ValueError, match="log_weight: holds NaN"):
        normalised(np.array([0.0, bad]))


@pytest.mark.parametrize("scheme", SCHEMES)
@given(logs=LOGS, seed=st.integers(0, 99), count=st.integers(1, 200))
def test_only_living_particles_go_on_and_as_many_as_wanted(scheme, logs, seed, count):
    weight = normalised(logs)
    if not weight.any():
        return
    chosen = resampled(np.random.default_rng(seed), weight, scheme, count)
    assert chosen.size == count and (weight[chosen] > 0).all()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_duplicates_follow_the_weights(scheme):
    rng = np.random.default_rng(3)
    weight = rng.dirichlet(np.full(12, 0.7))
    counts = np.stack([np.bincount(resampled(rng, weight, scheme, 50), minlength=12) for _ in range(4000)])
    np.testing.assert_allclose(counts.mean(axis=0), 50 * weight, atol=5 * np.sqrt(50 * 0.25 / 4000))
    allowed = {"systematic": 1.0, "stratified": 2.0, "residual": 50.0, "multinomial": 50.0}[scheme]
    assert (np.abs(counts - 50 * weight) < allowed + 1e-9).all()
    if scheme == "residual":
        assert (counts >= np.floor(50 * weight)).all()


def test_better_schemes_scatter_less():
    rng = np.random.default_rng(5)
    weight = rng.dirichlet(np.full(30, 0.5))
    spread = {
        s: np.var([np.bincount(resampled(rng, weight, s), minlength=30) for _ in range(3000)], axis=0).sum()
        for s in SCHEMES
    }
    assert spread["systematic"] < spread["multinomial"] and spread["stratified"] < spread["multinomial"]
    assert spread["residual"] < spread["multinomial"]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_equal_weights_keep_every_particle_where_the_scheme_is_not_pure_chance(scheme):
    chosen = resampled(np.random.default_rng(0), np.full(40, 1 / 40), scheme)
    if scheme != "multinomial":
        assert np.array_equal(chosen, np.arange(40))
    assert (np.diff(chosen) >= 0).all()


def test_bad_arguments_of_resampling_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match=r"weight: sums to 0\.5"):
        resampled(rng, np.array([0.5]))


@given(hnp.arrays(float, st.integers(1, 50), elements=st.floats(0.001, 1)))
def test_the_effective_size_lies_between_one_and_all(raw):
    weight = raw / raw.sum()
    assert 1.0 - 1e-9 <= effective_size(weight) <= raw.size + 1e-9
    assert effective_size(np.zeros(3)) == 0.0


def test_the_ellipsoid_holds_its_share_and_has_the_volume_of_the_formats_page():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 3))
    covariance = root @ root.T
    x = rng.multivariate_normal(np.ones(3), covariance, 20000)
    mean, found = estimate(x, np.full(20000, 1 / 20000))
    body = ellipsoid(mean, found)
    inside = (((x - body.centre) @ body.axes / body.half) ** 2).sum(axis=1) <= 1.0
    assert inside.mean() == pytest.approx(0.95, abs=0.006)
    assert np.array_equal(inside, mahalanobis(x, mean, found) <= 7.814727903251179)
    np.testing.assert_allclose(volume(found), 4 / 3 * np.pi * body.half.prod())
    np.testing.assert_allclose(volume(found), 4 / 3 * np.pi * 7.815**1.5 * np.sqrt(np.linalg.det(found)), rtol=1e-4)


def test_a_flat_cloud_has_no_volume_and_nothing_off_it():
    mean, covariance = estimate(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.array([0.5, 0.5]))
    assert volume(covariance) == 0.0
    square = mahalanobis(np.array([[0.5, 0.1, 0.0], [0.0, 0.0, 0.0]]), mean, covariance)
    assert square[0] == np.inf and square[1] == pytest.approx(1.0)


@pytest.mark.parametrize(("seed", "scheme"), list(enumerate(SCHEMES)))
def test_a_linear_gaussian_system_is_tracked_like_kalmans_filter_does(seed, scheme):
    """The oracle has a closed form: position and velocity, position measured."""
    rng = np.random.default_rng(seed)
    A, q, r = np.array([[1.0, 0.1], [0.0, 1.0]]), 0.3, 0.2
    mean, P = np.zeros(2), np.eye(2)
    x, logs = rng.normal(size=(20000, 2)), np.zeros(20000)
    truth = rng.normal(size=2)
    for _ in range(15):
        truth = A @ truth + [0.0, q * rng.normal()]
        y = truth[0] + r * rng.normal()
        mean, P = A @ mean, A @ P @ A.T + np.diag([0.0, q * q])
        S = P[0, 0] + r * r
        x = x @ A.T + np.column_stack([np.zeros(20000), q * rng.normal(size=20000)])
        like = -0.5 * (y - x[:, 0]) ** 2 / r**2 - 0.5 * np.log(2 * np.pi * r * r)
        assert log_evidence(logs, like) == pytest.approx(multivariate_normal(mean[0], S).logpdf(y), abs=0.25)
        gain = P[:, 0] / S
        mean, P = mean + gain * (y - mean[0]), P - np.outer(gain, P[0])
        logs = logs + like
        weight = normalised(logs)
        got, spread = estimate(x, weight)
        assert (np.abs(got - mean) < 0.15 * np.sqrt(np.diag(P))).all()
        np.testing.assert_allclose(spread, P, atol=0.12 * P.max())
        if effective_size(weight) < 10000:
            x, logs = x[resampled(rng, weight, scheme)], np.zeros(20000)
    assert log_evidence(np.full(3, -np.inf), np.zeros(3)) == -np.inf
