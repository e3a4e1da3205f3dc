"""Claims about simpler filters: filterpy's own as an oracle, keypoint by keypoint; limits of the one-euro filter."""

import math

import numpy as np
import pytest
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import settings as tried
from hypothesis import strategies as st
from made_people import confidences, figure, recording

from handtrack.body import people_baselines
from handtrack.body.people import Settings, follow
from handtrack.body.people_baselines import EAGER, GATE, JERKY, NAMES, NOISE, SLOWEST, baseline, kalman, one_euro
from handtrack.body.skeleton_graph import ROOT
from handtrack.formats.people import LOST, PREDICTED, SEEN, people_text

DT = 1.0 / 30.0


def walk(seed: int, frames: int, keypoints: int, holes: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Times with uneven steps, and measurements (f, k, 3) with holes."""
    rng = np.random.default_rng(seed)
    z = np.array([0.0, 0.0, 2.0]) + np.cumsum(rng.normal(0.0, 0.03, (frames, keypoints, 3)), axis=0)
    z[rng.random((frames, keypoints)) < holes] = np.nan
    return np.cumsum(rng.uniform(0.02, 0.08, frames)), z


def oracle(time: np.ndarray, z: np.ndarray, order: int, jerky: float) -> tuple[np.ndarray, np.ndarray]:
    """One coordinate of one keypoint by filterpy: places, variances; NaN before the first measurement."""
    n, out = order + 1, np.full((time.size, 2), np.nan)
    found = KalmanFilter(dim_x=n, dim_z=1)
    found.H, found.R = np.eye(1, n), np.array([[NOISE**2]])
    begun = False
    for i, value in enumerate(z):
        if begun:
            dt = time[i] - time[i - 1]
            found.F = np.array([[1.0, dt, dt * dt / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])[:n, :n]
            found.Q = np.asarray(Q_discrete_white_noise(n, dt, jerky**2))
            found.predict()
            if not np.isnan(value):
                found.update(value)
        elif not np.isnan(value):
            begun, found.x, found.P = True, np.eye(n, 1) * value, np.diag([NOISE**2, 1.0, 25.0][:n])
        if begun:
            out[i] = found.x[0, 0], found.P[0, 0]
    return out[:, 0], out[:, 1]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("seed", [1, 2])
def test_kalman_filters_are_filterpys_one_by_one(order, seed):
    time, z = walk(seed, 60, 5)
    z[:, 4], z[:20, 3] = np.nan, np.nan
    ours = kalman(time, z, order, 5.0)
    for k in range(5):
        for axis in range(3):
            p, variance = oracle(time, z[:, k, axis], order, 5.0)
            np.testing.assert_allclose(ours.p[:, k, axis], p, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(ours.variance[:, k], variance, rtol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_kalman_filters_run_away_in_long_gaps(order):
    """They have no bound on extrapolation, and say so by their variance: constant speed, or constant acceleration."""
    t = np.arange(150) * DT
    z = np.full((150, 1, 3), np.nan)
    z[:30, 0] = np.array([0.5, 0.0, 0.0]) * (t[:30, None] if order == 1 else t[:30, None] ** 2) + [0.0, 0.0, 2.0]
    found = kalman(t, z, order, 5.0)
    path = 0.5 * t if order == 1 else 0.5 * t**2
    np.testing.assert_allclose(found.p[-1, 0, 0], path[-1], rtol=0.2)
    assert (np.diff(found.variance[30:, 0]) > 0).all() and found.variance[-1, 0] > 1.0


def test_the_one_euro_filter_gives_a_constant_back_and_holds_its_last_place():
    z = np.tile([0.3, -0.2, 2.0], (50, 2, 1))
    z[:5, 1], z[30:, 0] = np.nan, np.nan
    found = one_euro(np.arange(50) * DT, z)
    np.testing.assert_allclose(found.p[:, 0], z[:1, 0].repeat(50, axis=0))
    assert np.isnan(found.p[:5, 1]).all() and np.isnan(found.variance[:5, 1]).all()
    np.testing.assert_allclose(found.p[5:, 1], z[5:, 1])


def low_pass(values: np.ndarray, cut: float) -> np.ndarray:
    a = 1.0 / (1.0 + 1.0 / (2.0 * math.pi * cut * DT))
    out = values.copy()
    for i in range(1, values.shape[0]):
        out[i] = out[i - 1] + a * (values[i] - out[i - 1])
    return out


def test_a_one_euro_filter_that_is_not_eager_is_a_low_pass(monkeypatch):
    """Casiez, Roussel & Vogel 2012: with b = 0 the cut-off is the lowest one."""
    monkeypatch.setattr(people_baselines, "EAGER", 0.0)
    _, z = walk(3, 80, 2, 0.0)
    np.testing.assert_allclose(one_euro(np.arange(80) * DT, z).p, low_pass(z, SLOWEST), atol=1e-12)


def test_a_one_euro_filter_that_is_very_eager_gives_what_it_gets(monkeypatch):
    monkeypatch.setattr(people_baselines, "EAGER", 1e9)
    _, z = walk(4, 80, 2, 0.0)
    np.testing.assert_allclose(one_euro(np.arange(80) * DT, z).p, z, atol=1e-6)


def test_the_one_euro_filter_smooths_what_stands_and_lags_little_behind_what_moves():
    rng = np.random.default_rng(5)
    t = np.arange(300) * DT
    still = rng.normal(0.0, 0.01, (300, 1, 3))
    assert one_euro(t, still).p[50:].std() < 0.5 * still.std()
    lags = []
    for speed in (0.05, 2.0):
        moving = np.tile((speed * t)[:, None, None], (1, 1, 3))
        lags.append((moving - one_euro(t, moving).p)[-1, 0, 0] / speed)  # seconds
    assert 0.0 < lags[1] < 0.5 * lags[0]
    fast = math.sqrt(3.0) * 2.0
    assert lags[1] < 1.3 / (2.0 * math.pi * (SLOWEST + EAGER * fast))


def test_a_one_euro_filter_counts_the_time_that_passed():
    """After a gap it takes more of the new place than after one frame."""
    z = np.zeros((2, 1, 3))
    z[1] = 0.1
    moved = [one_euro(np.array([0.0, dt]), z).p[1, 0, 0] for dt in (DT, 10 * DT)]
    assert 0.0 < moved[0] < moved[1] < 0.1


@given(st.integers(0, 999), st.sampled_from(["kalman-1", "kalman-2", "one-euro"]))
@tried(max_examples=30, deadline=None)
def test_keypoints_are_filtered_alone_and_all_axes_alike(seed, name):
    """Other keypoints, a shift and a turn of axes change nothing."""
    time, z = walk(seed, 20, 3)
    both = people_baselines._course(name, time, z)
    np.testing.assert_array_equal(people_baselines._course(name, time, z[:, 1:2]).p, both.p[:, 1:2])
    turn = np.array([[0.0, 1.0, 0.0], [0.6, 0.0, 0.8], [0.8, 0.0, -0.6]])
    turned = people_baselines._course(name, time, z @ turn.T + 3.0)
    np.testing.assert_allclose(turned.p, both.p @ turn.T + 3.0, atol=1e-9)


@pytest.fixture(scope="module")
def scene():
    """Two people in a changing order, with holes; who is who; the true places."""
    rng = np.random.default_rng(6)
    truth = np.stack([figure(1.62, (-0.6, 0.0, 2.2)), figure(1.85, (0.6, 0.0, 2.3))])
    frames = []
    for i in range(50):
        p = truth + rng.normal(0.0, 0.01, truth.shape)
        p[rng.random((2, 16)) < 0.15] = np.nan
        p[:, 4] = np.nan if 20 <= i < 35 else p[:, 4]
        frames.append(p[rng.permutation(2)] if i != 40 else p[:0])
    detections = recording(frames)
    return detections, follow(detections, Settings(skin=0.0)), truth


@pytest.mark.parametrize("name", NAMES)
def test_baselines_have_the_identities_of_the_result_and_promise_what_it_promises(scene, name):
    detections, identities, truth = scene
    found = baseline(name, detections, identities, Settings())
    np.testing.assert_array_equal(found.frame, identities.frame)
    np.testing.assert_array_equal(found.person, identities.person)
    first = {int(w): truth[np.linalg.norm(truth[:, 0] - identities.p[identities.person == w][0, 0], axis=1).argmin()]
             for w in (0, 1)}  # fmt: skip
    near = np.stack([first[int(w)] for w in found.person])
    assert np.nanmax(np.linalg.norm(found.p - near, axis=-1)[:, [0, 1, 2, 6, 7]]) < 0.3
    there = found.status != LOST
    assert np.isfinite(found.p[there]).all() and np.isfinite(found.covariance[there]).all()
    assert np.isnan(found.p[~there]).all() and (found.confidence[~there] == 0).all()
    assert people_text(found)
    hidden = (found.frame >= 20) & (found.frame < 35)
    assert (found.status[hidden, 4] == (LOST if name == "raw" else PREDICTED)).all()


def test_raw_is_what_was_measured(scene):
    detections, identities, _ = scene
    found = baseline("raw", detections, identities, Settings())
    for i in range(0, found.frame.size, 7):
        here = detections.p[detections.frame == found.frame[i]]
        if here.size:
            assert any(np.array_equal(found.p[i, :12], p[:12], equal_nan=True) for p in here)
    assert (found.status[found.frame == 40] == LOST).all()
    seen = found.status == SEEN
    np.testing.assert_array_equal(seen[:, :12], found.confidence[:, :12] > 0)
    assert seen[:, ROOT].any()  # centre joints are built here too


def test_a_skeleton_far_from_everybody_belongs_to_nobody():
    at = figure()[None].copy()
    frames = [at] * 10
    identities = follow(recording(frames), Settings(skin=0.0))
    away = recording([at] * 9 + [at + np.array([GATE + 0.1, 0.0, 0.0])])
    found = baseline("raw", away, identities, Settings())
    assert (found.status[-1] == LOST).all() and (found.status[-2, :12] == SEEN).all()


def test_confidence_0_is_not_measured_here_either():
    at = figure()[None]
    sure = confidences(at)
    sure[0, 4] = 0.0
    identities = follow(recording([at] * 10), Settings(skin=0.0))
    found = baseline("raw", recording([at] * 10, [sure] * 10), identities, Settings())
    assert (found.status[:, 4] == LOST).all() and (found.status[:, 5] == SEEN).all()


def test_nobody_and_an_unknown_name():
    empty = recording([np.zeros((0, 16, 3))] * 3)
    nobody = follow(empty, Settings())
    for name in NAMES:
        assert baseline(name, empty, nobody, Settings()).frame.size == 0
    with pytest.raises(ValueError, match="name: got 'median', wanted one of raw, kalman-1, kalman-2, one-euro"):
        baseline("median", empty, nobody, Settings())


def test_kalman_names_have_their_noise():
    assert set(JERKY) == {name for name in NAMES if name.startswith("kalman")}
    time, z = walk(9, 10, 16, 0.0)
    for name, order in (("kalman-1", 1), ("kalman-2", 2)):
        course = people_baselines._course(name, time, z)
        np.testing.assert_array_equal(course.p, kalman(time, z, order, JERKY[name]).p)


def test_a_person_who_was_never_measured_has_lost_entries_only():
    at = figure()[None]
    identities = follow(recording([at] * 10), Settings(skin=0.0))
    found = baseline("kalman-1", recording([at[:0]] * 10), identities, Settings())
    assert (found.status == LOST).all() and np.isnan(found.p).all() and (found.confidence == 0).all()
