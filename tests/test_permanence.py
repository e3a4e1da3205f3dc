"""Claims about keypoints that are followed: laws of both filters, honest growth while hidden."""

import math
from dataclasses import fields

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import settings as tried
from hypothesis import strategies as st
from made_people import figure

from handtrack.body.people_settings import Settings
from handtrack.body.people_tracks import BONE
from handtrack.body.permanence import (
    FASTEST,
    MOTION,
    NOISE_ACROSS,
    SYSTEMATIC,
    Estimate,
    Particles,
    Stories,
    drawn_anew,
    no_particles,
    no_stories,
    paper_noise,
    paper_step,
    robust_step,
    seen_now,
    slopes,
)
from handtrack.body.resting import AT_FIRST, PARENT

DT = 1.0 / 30.0
NOWHERE = np.full((1, 12, 3), np.nan)
FREE = np.full((1, 12), np.nan)  # no length is known: keypoints do not hold each other
STILL = np.zeros((1, 3))
PAPER = Settings(mode="paper", particles=60)


def arrays(stories: Stories | Particles) -> dict[str, np.ndarray]:
    return {field.name: getattr(stories, field.name) for field in fields(stories)}


def wrist(*xyz: float) -> np.ndarray:
    z = NOWHERE.copy()
    z[0, 4] = xyz
    return z


class Robust:
    """Frames of the robust filter for one person; by default without bones."""

    def __init__(self, length: np.ndarray = FREE, n: int = 8):
        self.stories, self.length = no_stories(1, n), length
        self.rest = AT_FIRST[None] * np.nan_to_num(length)[..., None]

    def step(self, z: np.ndarray, sure: float | np.ndarray = 0.7, drift: np.ndarray = STILL) -> Estimate:
        sure = np.where(np.isnan(z[..., 0]), 0.0, sure)
        self.stories, found = robust_step(self.stories, z, sure, DT, drift, self.length, self.rest)
        return found


class Paper:
    """Frames of the paper's filter for one person."""

    def __init__(self, settings: Settings = PAPER, seed: int = 1):
        self.clouds = no_particles(1, settings.particles, settings.history)
        self.settings, self.rng = settings, np.random.default_rng(seed)
        self.time, self.hidden = 0.0, np.full((1, 12), np.inf)

    def step(self, z: np.ndarray, sure: float = 0.9) -> Estimate:
        confidence = np.where(np.isnan(z[..., 0]), 0.0, sure)
        self.time += DT
        self.clouds, found = paper_step(
            self.clouds, z, confidence, self.time, DT, self.hidden, self.settings, self.rng
        )  # fmt: skip
        self.hidden = np.where(seen_now(found), 0.0, np.where(np.isinf(self.hidden), 0.0, self.hidden) + DT)
        return found


def test_noise_is_the_papers_as_deviation_or_as_variance():
    """People paper, eq. (6): alpha^(c - beta)."""
    c = np.linspace(0.0, 1.0, 11)
    np.testing.assert_allclose(paper_noise(c, PAPER), 0.01 ** (c - 0.2))
    variance = Settings(mode="paper", noise="variance", alpha=0.1, beta=0.4)
    np.testing.assert_allclose(paper_noise(c, variance) ** 2, 0.1 ** (c - 0.4))
    assert (np.diff(paper_noise(c, PAPER)) < 0).all()


@given(st.integers(0, 9999), st.integers(2, 40))
def test_particles_are_drawn_anew_as_often_as_their_weight_says(seed, n):
    """Systematic resampling: floor(n w) or ceil(n w) times each, in order, and none of weight 0."""
    rng = np.random.default_rng(seed)
    weight = rng.dirichlet(np.full(n, 0.3), (2, 3)) * (rng.random((2, 3, n)) < 0.8)
    weight[..., 0] += 1e-3
    weight /= weight.sum(axis=-1, keepdims=True)
    found = drawn_anew(rng, weight)
    assert (np.diff(found, axis=-1) >= 0).all()
    counts = (found[..., None] == np.arange(n)).sum(axis=2)
    assert (np.abs(counts - n * weight) < 1.0 + 1e-9).all()
    assert not counts[weight == 0.0].any()


def test_particles_are_drawn_without_favour():
    rng = np.random.default_rng(2)
    weight = np.tile(rng.dirichlet(np.full(9, 0.5)), (40, 100, 1))
    counts = (drawn_anew(rng, weight)[..., None] == np.arange(9)).sum(axis=2)
    np.testing.assert_allclose(counts.mean(axis=(0, 1)), 9 * weight[0, 0], atol=5 * 0.5 / math.sqrt(4000))


@given(st.integers(0, 9999), st.integers(2, 50))
def test_the_line_is_the_one_that_fits_best(seed, count):
    """First-order polynomial over up to gamma frames, with gaps in time; at most 2 m/s."""
    rng = np.random.default_rng(seed)
    past, when = np.full((1, 12, 50, 3), np.nan), np.full((1, 12, 50), np.nan)
    t = 7.0 + np.cumsum(rng.uniform(0.02, 0.3, count))
    when[..., -count:] = t
    past[..., -count:, :] = rng.normal(0.0, 0.3, (12, 1, 3)) * (t - 7.0)[:, None] + rng.normal(
        0.0, 0.02, (12, count, 3)
    )
    found = slopes(Particles(np.zeros((1, 12, 2, 3)), past, when))
    for k in range(12):
        fit = np.polyfit(t - t.mean(), past[0, k, -count:], 1)[0]
        fast = np.linalg.norm(fit)
        np.testing.assert_allclose(found[0, k], fit * min(1.0, FASTEST / fast), atol=1e-9)


@pytest.mark.parametrize("count", [0, 1])
def test_a_history_of_less_than_two_places_has_no_slope(count):
    clouds = no_particles(1, 2, 5)
    clouds.past[..., 5 - count :, :], clouds.when[..., 5 - count :] = 1.0, 2.0
    assert (slopes(clouds) == 0.0).all()


def test_a_short_history_is_enough_for_a_line():
    follow = Paper()
    for i in range(3):
        follow.step(wrist(0.02 * i, 0.0, 2.0), 0.95)
    assert follow.clouds.past.shape[2] == 50
    before = follow.step(NOWHERE).p[0, 4]
    for _ in range(10):
        after = follow.step(NOWHERE).p[0, 4]
    assert after[0] - before[0] > 0.05


@pytest.mark.parametrize("noise", ["sd", "variance"])
def test_the_papers_filter_follows_sure_measurements(noise):
    follow = Paper(Settings(mode="paper", noise=noise))
    for i in range(60):
        found = follow.step(wrist(0.005 * i, 0.0, 2.0), 1.0)
    np.testing.assert_allclose(found.p[0, 4], [0.005 * 59, 0.0, 2.0], atol=0.06)
    assert np.isnan(np.delete(found.p[0], 4, axis=0)).all()


@pytest.mark.parametrize("sure", [0.0, 0.1, 0.4])
def test_measurements_not_above_the_threshold_are_occluded_for_the_paper(sure):
    """A measurement elsewhere changes nothing while it is not surer than T; confidence 0 is predicted, not skipped."""
    one, other = Paper(), Paper()
    for _ in range(5):
        one.step(wrist(0.0, 0.0, 2.0))
        other.step(wrist(0.0, 0.0, 2.0))
    a, b = one.step(wrist(5.0, 5.0, 5.0), sure), other.step(NOWHERE)
    np.testing.assert_array_equal(a.p, b.p)
    np.testing.assert_array_equal(a.covariance, b.covariance)
    assert not a.believed.any() and np.isfinite(a.p[0, 4]).all()


def test_the_papers_line_goes_on_for_gamma_frames_and_then_stops():
    follow = Paper(Settings(mode="paper", particles=800, history=20))
    for i in range(20):
        follow.step(wrist(0.02 * i, 0.0, 2.0), 1.0)
    x = [follow.step(NOWHERE).p[0, 4, 0] for _ in range(60)]
    speed = slopes(follow.clouds)[0, 4, 0]
    assert speed == pytest.approx(0.6, abs=0.1)
    assert x[19] - x[0] == pytest.approx(19 * DT * speed, abs=0.1)
    assert x[-1] == pytest.approx(x[21], abs=0.15)  # a random walk's rest


def test_the_papers_covariance_grows_while_nothing_is_seen():
    follow = Paper(Settings(mode="paper", particles=400))
    for _ in range(5):
        follow.step(wrist(0.0, 0.0, 2.0))
    traces = [np.trace(follow.step(NOWHERE).covariance[0, 4]) for _ in range(90)]
    assert traces[9] < traces[29] < traces[89] < 3.0


def test_far_measurements_do_not_kill_all_particles():
    follow = Paper()
    follow.step(wrist(0.0, 0.0, 2.0), 1.0)
    found = follow.step(wrist(9.0, 0.0, 2.0), 1.0)
    assert np.isfinite(found.p[0, 4]).all() and np.isfinite(found.covariance[0, 4]).all()


def test_the_same_random_numbers_give_the_same_clouds():
    runs = [Paper(seed=seed) for seed in (3, 3, 4)]
    for i in range(5):
        found = [run.step(wrist(0.01 * i, 0.0, 2.0)).p for run in runs]
    np.testing.assert_array_equal(found[0], found[1])
    assert (found[0][0, 4] != found[2][0, 4]).any()


# Mode `robust`.


def story(seed: int, q: int, n: int) -> tuple:
    """A crowd in the midst of things, with holes everywhere."""
    rng = np.random.default_rng(seed)
    stories = no_stories(q, n)
    truth = np.stack([figure(rng.uniform(1.5, 1.9), (i, 0.0, 2.0))[:12] for i in range(q)])
    length = np.where(rng.random((q, 12)) < 0.8, rng.uniform(1.6, 1.8, (q, 1)) * BONE, np.nan)
    rest = AT_FIRST * np.nan_to_num(length)[..., None]
    drift = rng.normal(0.0, 0.4, (q, 3))
    frames = []
    for _ in range(6):
        z = truth + rng.normal(0.0, rng.choice([0.02, 0.3], (q, 12, 1), p=[0.8, 0.2]), (q, 12, 3))
        z[rng.random((q, 12)) < 0.3] = np.nan
        frames.append((z, np.where(np.isnan(z[..., 0]), 0.0, rng.random((q, 12)))))
    return stories, frames, length, rest, drift


def test_a_step_changes_no_input():
    stories, frames, length, rest, drift = story(3, 2, 4)
    for z, sure in frames:
        given_arrays = [*arrays(stories).values(), z, sure, length, rest, drift]
        before = [array.copy() for array in given_arrays]
        after, _ = robust_step(stories, z, sure, DT, drift, length, rest)
        for one, other in zip(before, given_arrays, strict=True):
            np.testing.assert_array_equal(one, other)
        stories = after


def test_people_of_a_batch_do_not_touch_each_other():
    stories, frames, length, rest, drift = story(5, 3, 4)
    alone = [no_stories(1, 4) for _ in range(3)]
    for z, sure in frames:
        stories, together = robust_step(stories, z, sure, DT, drift, length, rest)
        for i in range(3):
            own = slice(i, i + 1)
            alone[i], found = robust_step(alone[i], z[own], sure[own], DT, drift[own], length[own], rest[own])
            np.testing.assert_array_equal(found.p, together.p[own])
            np.testing.assert_array_equal(found.covariance, together.covariance[own])


def test_weights_sum_to_one_and_covariances_are_positive():
    stories, frames, length, rest, drift = story(11, 4, 8)
    for z, sure in frames * 3:
        stories, found = robust_step(stories, z, sure, DT, drift, length, rest)
        total = stories.weight.sum(axis=-1)
        known = np.isfinite(found.p[..., 0])
        np.testing.assert_allclose(total[known], 1.0)
        assert (total[~known] == 0).all() and np.isnan(found.covariance[~known]).all()
        assert (np.linalg.eigvalsh(found.covariance[known]) > 0).all()
        assert (found.believed >= 0).all() and (found.believed <= 1 + 1e-12).all()


def test_a_keypoint_that_is_surely_right_is_followed_as_by_kalmans_filter():
    """With sure measurements near each other there is one story, and it is an Ornstein-Uhlenbeck Kalman filter's."""
    rng = np.random.default_rng(8)
    speed, tau, _, shake = MOTION[4]
    decay = math.exp(-DT / tau)
    reach, power = tau * (1 - decay), 2 * speed**2 / tau
    oracle = KalmanFilter(dim_x=2, dim_z=1)
    oracle.F, oracle.H = np.array([[1, reach], [0, decay]]), np.array([[1.0, 0.0]])
    oracle.Q = power * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]]) + np.diag([shake * DT, 0.0])
    oracle.R = np.array([[NOISE_ACROSS**2]])
    follow = Robust(n=2)
    for i in range(40):
        z = wrist(0.01 * i + rng.normal(0, 0.005), 0.0, 2.0)
        found = follow.step(z, 0.65)
        if i == 0:
            oracle.x, oracle.P = np.array([[z[0, 4, 0]], [0.0]]), np.diag([NOISE_ACROSS**2, speed**2])
        else:
            oracle.predict()
            oracle.update(z[0, 4, 0])
    assert found.p[0, 4, 0] == pytest.approx(oracle.x[0, 0], abs=2e-3)
    assert found.covariance[0, 4, 0, 0] == pytest.approx(oracle.P[0, 0] + SYSTEMATIC[0, 0], rel=0.1)


def seen_for(follow: Robust, frames: int, step: float = 0.0) -> Estimate:
    for i in range(frames):
        found = follow.step(wrist(step * i, 0.0, 2.0))
    return found


def test_a_hidden_keypoint_slows_down_and_its_covariance_grows_to_a_bound():
    follow = Robust()
    seen = seen_for(follow, 30, 0.02)
    hidden = [follow.step(NOWHERE) for _ in range(300)]
    x = np.array([found.p[0, 4, 0] for found in hidden])
    assert (np.diff(x) > -1e-12).all() and np.diff(x)[-1] < 1e-6 < np.diff(x)[0]
    speed, tau = 0.02 / DT, MOTION[4, 1]
    assert 0.5 * speed * tau < x[-1] - seen.p[0, 4, 0] < 1.3 * speed * tau
    traces = np.array([np.trace(found.covariance[0, 4]) for found in [seen, *hidden]])
    assert (np.diff(traces) > -1e-12).all() and traces[30] > 5 * traces[0]
    assert traces[-1] <= 3 * (MOTION[4, 2] ** 2 + SYSTEMATIC[0, 0]) * 1.01
    assert not any(seen_now(found).any() for found in hidden)


def test_a_hidden_keypoint_goes_with_the_whole_person():
    follow = Robust()
    seen = seen_for(follow, 10)
    for _ in range(30):
        found = follow.step(NOWHERE, drift=np.array([[1.0, 0.0, 0.0]]))
    assert found.p[0, 4, 0] - seen.p[0, 4, 0] == pytest.approx(30 * DT - MOTION[4, 1], abs=0.05)


@pytest.mark.parametrize("sure", [0.2, 0.4, 0.55])
def test_one_wild_measurement_is_not_followed(sure):
    follow = Robust()
    seen = seen_for(follow, 20)
    wild = follow.step(wrist(0.8, 0.3, 2.5), sure)
    assert not seen_now(wild)[0, 4] and np.linalg.norm(wild.p[0, 4] - seen.p[0, 4]) < 0.1


@pytest.mark.parametrize("sure", [0.5, 0.7, 0.9])
def test_a_jump_off_the_body_is_not_followed_however_sure_it_is(sure):
    person = figure(1.75)[None, :12]
    follow = Robust(1.75 * BONE[None])
    for _ in range(20):
        seen = follow.step(person)
    away = person.copy()
    away[0, 4] += 0.6, 0.3, 0.5
    wild = follow.step(away, np.where(np.arange(12) == 4, sure, 0.7))
    assert not seen_now(wild)[0, 4] and np.linalg.norm(wild.p[0, 4] - seen.p[0, 4]) < 0.1


def test_a_keypoint_that_stays_elsewhere_is_believed_in_the_end():
    follow = Robust()
    seen_for(follow, 20)
    for _ in range(45):
        found = follow.step(wrist(0.5, 0.0, 2.2), 0.75)
    np.testing.assert_allclose(found.p[0, 4], [0.5, 0.0, 2.2], atol=0.03)
    assert seen_now(found)[0, 4]


def test_what_is_less_sure_moves_the_estimate_less():
    moved = []
    for sure in (0.55, 0.7, 0.85):
        follow = Robust()
        seen = seen_for(follow, 20)
        moved.append(follow.step(wrist(0.05, 0.0, 2.0), sure).p[0, 4, 0] - seen.p[0, 4, 0])
    assert 0.0 < moved[0] < moved[1] < moved[2] < 0.05


def test_an_unsure_measurement_of_something_never_seen_begins_nothing():
    follow = Robust()
    assert np.isnan(follow.step(wrist(0.0, 0.0, 2.0), 0.1).p).all()
    assert np.isfinite(follow.step(wrist(0.0, 0.0, 2.0), 0.6).p[0, 4]).all()


def test_limbs_keep_their_length_while_their_ends_are_hidden():
    """An arm that swings and then is hidden: the shoulder goes on, elbow and wrist stay on their spheres."""
    person = figure(1.75)[None, :12]
    follow = Robust(1.75 * BONE[None])
    for i in range(30):
        swing = person.copy()
        swing[0, [2, 4], 0] += 0.006 * i * np.array([0.6, 1.0])
        follow.step(swing)
    for i in range(120):
        z = person + np.array([0.004 * i, 0.0, 0.0])
        z[0, [2, 3, 4, 5, 8, 9, 10, 11]] = np.nan
        found = follow.step(z, drift=np.array([[0.004 / DT, 0.0, 0.0]]))
        p = found.p[0]
        for k in (2, 3, 4, 5, 8, 9, 10, 11):
            assert np.linalg.norm(p[k] - p[PARENT[k]]) == pytest.approx(1.75 * BONE[k], rel=0.12)
    assert np.linalg.norm(p[0] - z[0, 0]) < 0.03


def test_a_measurement_at_the_wrong_distance_from_its_joint_is_believed_less():
    person = figure(1.75)[None, :12]
    follow, free = Robust(1.75 * BONE[None]), Robust()
    for _ in range(20):
        follow.step(person)
        free.step(person)
    away = person.copy()
    away[0, 4] = person[0, 2] + 1.6 * (person[0, 4] - person[0, 2])
    bound, loose = follow.step(away, 0.75), free.step(away, 0.75)
    assert bound.believed[0, 4] < loose.believed[0, 4]
    assert seen_now(bound)[0, 5]


def test_a_joint_that_was_never_seen_is_where_it_mostly_is():
    person = figure(1.75)[None, :12].copy()
    person[0, [4, 10]] = np.nan
    follow = Robust(1.75 * BONE[None])
    for _ in range(5):
        found = follow.step(person)
    p = found.p[0]
    assert np.isfinite(p).all() and not seen_now(found)[0, [4, 10]].any()
    assert np.linalg.norm(p[4] - p[2]) == pytest.approx(1.75 * 0.146, rel=0.15)
    assert np.trace(found.covariance[0, 4]) > 10 * np.trace(found.covariance[0, 5])


def test_nobody_is_followed_without_harm():
    none = np.zeros((0, 12))
    stories, found = robust_step(
        no_stories(0, 4), np.zeros((0, 12, 3)), none, DT, np.zeros((0, 3)), none, np.zeros((0, 12, 3))
    )
    assert found.p.shape == (0, 12, 3) and stories.weight.shape == (0, 12, 4)


HOLES = st.sampled_from(["seen", "unseen", "unsure", "jump"])


@given(st.lists(HOLES, min_size=5, max_size=40), st.sampled_from(["paper", "robust"]))
@tried(max_examples=40)
def test_once_seen_a_keypoint_always_has_a_finite_place_and_covariance(kinds, mode):
    follow = Robust() if mode == "robust" else Paper()
    follow.step(wrist(0.0, 0.0, 2.0), 0.8)
    for kind in kinds:
        z = {"seen": wrist(0.0, 0.1, 2.0), "jump": wrist(1.0, -1.0, 3.0)}.get(kind, NOWHERE)
        z = wrist(0.0, 0.0, 2.1) if kind == "unsure" else z
        found = follow.step(z, 0.05 if kind == "unsure" else 0.8)
        assert np.isfinite(found.p[0, 4]).all() and np.isfinite(found.covariance[0, 4]).all()
        assert np.linalg.eigvalsh(found.covariance[0, 4]).min() > -1e-12
