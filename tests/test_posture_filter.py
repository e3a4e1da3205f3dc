"""Posture filters of five parts: what they compare, what they draw, and that it is what Bayes says."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handtrack.body import posture_filter
from handtrack.body.posture import ROOT, Body, body_of, part_frames, segment_frames
from handtrack.body.posture_filter import Postures, begin, fitted, log_likelihood, measured, relative_frames, step
from handtrack.body.posture_tree import JOINTS, PART_SEGMENTS, PARTS
from handtrack.body.walk_moment import Moment
from handtrack.body.walk_settings import Settings
from handtrack.camera import perspective

CAMERA = perspective(640, 480, 500.0, 500.0, 320.0, 240.0, np.eye(3), np.zeros(3))
BODY = body_of(1.75)


def posture(seed: int, size: float = 0.3) -> np.ndarray:
    """A posture well inside the limits."""
    low, high = BODY.limits.T
    rng = np.random.default_rng(seed)
    return 0.5 * (low + high) + size * 0.5 * (high - low) * rng.uniform(-1.0, 1.0, len(JOINTS))


def moment(theta: np.ndarray, dt: float = 0.2, pelvis: tuple[float, ...] = (1.0, -2.0, 0.9, 2.0, 0.1, -0.1)) -> Moment:
    """What an exact suit tells of a posture."""
    q = np.concatenate([pelvis, theta])
    T = segment_frames(BODY, q[None])[0]
    none = np.zeros(16)
    return Moment(
        time=0.0, dt=dt, frame=0, since=0.0, q=q, p=T[:, :3, 3].copy(), R=T[:, :3, :3].copy(), speed=0.0, seen=False,
        uv=np.full((16, 2), np.nan), confidence=none, in_view=False, camera_dt=np.inf, camera=CAMERA,
    )  # fmt: skip


def test_one_chain_poses_all_parts_as_each_of_them_alone():
    theta = np.stack([posture(seed) for seed in range(3)])
    frames = posture_filter.chain_frames(begin(BODY, Settings()).chain, theta)
    at = 0
    for part, segments in enumerate(PART_SEGMENTS):
        alone = part_frames(BODY, part, theta[:, 4 * part : 4 * part + 4])
        np.testing.assert_allclose(frames[:, at : at + len(segments)], alone, atol=1e-12)
        at += len(segments)
    assert at == frames.shape[1]


@given(seed=st.integers(0, 10_000), yaw=st.floats(-3.0, 3.0), x=st.floats(-50.0, 50.0))
def test_what_is_measured_does_not_depend_on_where_the_suit_thinks_it_is(seed, yaw, x):
    theta = posture(seed, 0.8)
    here = moment(theta, pelvis=(x, 3.0, 0.9, yaw, 0.2, -0.1))
    found = relative_frames(BODY, here.p, here.R)
    wanted = posture_filter.chain_frames(begin(BODY, Settings()).chain, theta[None])[0]
    np.testing.assert_allclose(found, wanted, atol=1e-10)


@pytest.mark.parametrize("turn_noise", [4.0, 180.0])
def test_the_fit_finds_the_posture_with_orientations_or_with_little_of_them(turn_noise):
    told, theta = Settings(segment_turn_noise=turn_noise), posture(3)
    guess = theta + np.radians(3.0) * np.random.default_rng(1).standard_normal(20)
    z = measured(BODY, moment(theta), told)
    state = begin(BODY, told)
    found, _ = fitted(state, BODY, z, guess, told)
    before = np.sqrt(-log_likelihood(state, BODY, guess[None], z, told))
    after = np.sqrt(-log_likelihood(state, BODY, found.reshape(1, -1), z, told))
    assert (after < 0.05 * before + 1e-6).all()


def test_the_fits_precision_is_the_curvature_of_the_likelihood():
    told, theta = Settings(), posture(5)
    state, z = begin(BODY, told), measured(BODY, moment(theta), told)
    _, precision = fitted(state, BODY, z, theta, told)
    for k in range(4):
        move = np.zeros((2, 20))
        move[0, k::4], move[1, k::4] = 1e-3, -1e-3
        value = log_likelihood(state, BODY, np.vstack([theta + move, theta[None]]), z, told)
        curvature = -(value[0] + value[1] - 2.0 * value[2]) / 1e-6
        np.testing.assert_allclose(curvature, precision[:, k, k], rtol=1e-3)


def blind(before: np.ndarray, z: np.ndarray, told: Settings, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Posterior means and standard deviations from particles that are drawn blindly, very many of them."""
    rng = np.random.default_rng(9)
    theta = before + np.radians(told.posture_noise) * np.sqrt(0.2) * rng.standard_normal((count, 20))
    found = log_likelihood(begin(BODY, told), BODY, theta, z, told)
    weight = np.exp(found - found.max(axis=0))
    weight = np.repeat(weight / weight.sum(axis=0), 4, axis=1)
    mean = (weight * theta).sum(axis=0)
    return mean, np.sqrt((weight * (theta - mean) ** 2).sum(axis=0))


def test_a_step_is_the_one_of_bayes():
    told = Settings(part_particles=20_000, posture_noise=20.0, segment_noise=0.03, segment_turn_noise=6.0)
    before, now = posture(7), posture(7) + np.radians(4.0) * np.random.default_rng(2).standard_normal(20)
    start = replace(begin(BODY, told), theta=np.tile(before, (20_000, 1)))
    here = moment(now)
    after = step(start, BODY, here, told, np.random.default_rng(3))
    mean, sigma = posture_filter.mean_posture(after)
    wanted, spread = blind(before, measured(BODY, here, told), told, 200_000)
    np.testing.assert_allclose(mean, wanted, atol=np.radians(0.25))
    np.testing.assert_allclose(sigma, spread, rtol=0.12)


def test_two_hundred_particles_follow_a_moving_posture():
    told, rng = Settings(), np.random.default_rng(0)
    state = begin(BODY, told)
    assert not state.known
    for k in range(12):
        theta = np.clip(posture(11) + np.radians(15.0) * np.sin(0.6 * k + np.arange(20)), *BODY.limits.T)
        state = step(state, BODY, moment(theta), told, rng)
    assert state.known
    mean, sigma = posture_filter.mean_posture(state)
    # an arm that is held out at the side: flexion and rotation turn it alike, only their sum is told
    assert (np.abs(mean - theta) < 2.0 * sigma + np.radians(1.0)).all()
    apart = posture_filter.chain_frames(state.chain, np.stack([mean, theta]))
    assert np.linalg.norm(np.diff(apart[..., :3, 3], axis=0), axis=-1).max() < 0.01
    assert np.median(sigma) < np.radians(4.0)


def test_postures_stay_inside_the_limits():
    low, high = BODY.limits.T
    told, rng, state = Settings(), np.random.default_rng(0), begin(BODY, Settings())
    for theta in (high, low):
        state = step(state, BODY, moment(theta), told, rng)
        assert (state.theta >= low - 1e-12).all() and (state.theta <= high + 1e-12).all()
        np.testing.assert_allclose(state.weight.sum(axis=0), 1.0)


def test_whole_postures_keep_the_weights_of_each_part_and_pair_the_parts_at_random():
    m = 1000
    rank = np.tile(np.arange(m, dtype=float)[:, None], (1, 20))
    weight = np.full((m, len(PARTS)), 1.0 / m)
    weight[:, 2] = np.where(np.arange(m) < m // 2, 2.0 / m, 0.0)
    state = Postures(begin(BODY, Settings()).chain, rank, weight)
    drawn = posture_filter.whole_postures(state, m, np.random.default_rng(4))
    assert drawn[:, 8:12].max() < m // 2
    np.testing.assert_allclose(drawn.mean(axis=0)[[0, 4, 12, 16]], 0.5 * (m - 1), atol=1.0)
    assert (drawn[:, 0] == drawn[:, 3]).all()  # the four angles of a part stay together
    paired = np.corrcoef(drawn[:, ::4].T) - np.eye(5)
    assert np.abs(paired).max() < 0.15


def test_unequal_particles_are_drawn_anew_part_by_part():
    told = Settings(part_particles=400, resample=1.0)
    state = step(begin(BODY, told), BODY, moment(posture(1)), told, np.random.default_rng(1))
    np.testing.assert_allclose(state.weight, 1.0 / 400)
    never = replace(told, resample=0.0)
    state = step(begin(BODY, never), BODY, moment(posture(1)), never, np.random.default_rng(1))
    assert np.ptp(state.weight[:, 1]) > 0


def test_the_same_random_numbers_give_the_same_particles_and_the_state_before_is_kept():
    told, here = Settings(), moment(posture(2))
    before = step(begin(BODY, told), BODY, here, told, np.random.default_rng(5))
    kept = before.theta.copy(), before.weight.copy()
    one = step(before, BODY, here, told, np.random.default_rng(6))
    two = step(before, BODY, replace(here, dt=0.2), told, np.random.default_rng(6))
    assert np.array_equal(one.theta, two.theta) and np.array_equal(one.weight, two.weight)
    assert np.array_equal(before.theta, kept[0]) and np.array_equal(before.weight, kept[1])


def test_a_second_sample_at_the_same_time_does_no_harm():
    told, here = Settings(), moment(posture(2))
    state = step(begin(BODY, told), BODY, here, told, np.random.default_rng(5))
    state = step(state, BODY, replace(here, dt=0.0), told, np.random.default_rng(5))
    assert np.isfinite(state.theta).all()
    assert np.abs(posture_filter.mean_posture(state)[0] - here.q[ROOT:]).max() < np.radians(3.0)


def test_a_wider_body_does_not_change_how_many_particles_there_are():
    tall: Body = body_of(2.0)
    state = begin(tall, Settings(part_particles=50))
    assert state.theta.shape == (50, 20) and state.weight.shape == (50, 5)


def test_compiled_misfits_are_those_of_the_features():
    frames = posture_filter.chain_frames(begin(BODY, Settings()).chain, np.stack([posture(k, 0.9) for k in range(20)]))
    z = measured(BODY, moment(posture(3)), Settings())
    args = BODY, frames, z, Settings(segment_noise=0.03, segment_turn_noise=7.0)
    np.testing.assert_allclose(posture_filter.misfits(*args), posture_filter.misfits_numpy(*args), rtol=1e-12)
