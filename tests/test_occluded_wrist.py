"""Claims about the filter of a hidden wrist: a made arm before a wall, and everything that can be missing."""

import math
from dataclasses import replace

import numpy as np
import pytest

from handtrack.body.arm_state import VARIANTS, Scene, Seen, Variant, begin, settings_of
from handtrack.body.environment import ray_caster, room_of
from handtrack.body.joint_filter import Sampling
from handtrack.body.occluded_wrist import step
from handtrack.body.particles import mahalanobis
from handtrack.camera import perspective

CAMERA = perspective(160, 120, 150.0, 150.0, 80.0, 60.0, np.eye(3), np.zeros(3))
WALL = ray_caster(room_of(np.array([[-9.0, -9, 2.12], [9, -9, 2.12], [0, 9, 2.12]]), np.array([[0, 1, 2]])), "bvh")
TRACKED = np.zeros(3, int)
HIDDEN = np.array([0, 0, 2])


def arm_at(time):
    """Shoulder, elbow, wrist: the forearm swings in a plane that faces the camera's side."""
    shoulder, elbow = np.array([0.0, -0.3, 2.0]), np.array([0.0, 0.0, 2.0])
    angle = 0.9 + 0.5 * math.sin(1.5 * time)
    return np.stack([shoulder, elbow, elbow + 0.26 * np.array([math.sin(angle), math.cos(angle), 0.0])])


def screen(p, nearer=0.3, half=0.16):
    """A depth map of the wall with a screen before a point."""
    depth = np.full((120, 160), 2.12, np.float32)
    u, v = 150.0 * p[:2] / p[2] + (80.0, 60.0)
    r = round(150.0 * half / (p[2] - nearer))
    rows, columns = slice(max(int(v) - r, 0), int(v) + r), slice(max(int(u) - r, 0), int(u) + r)
    depth[rows, columns] = p[2] - nearer
    return depth


def setting(variant: Variant = "complete", **changes):
    settings = settings_of(variant)
    return replace(settings, sampling=Sampling(particles=800), fathers=Sampling(particles=200), **changes)


def followed(states, seed=0, settings=None, depth=screen, noise=0.008, points=arm_at):
    """Estimates of the wrist, frame by frame, and the true places; `states` is what the sensor says of each frame."""
    settings = settings or setting()
    scene, rng, noisy = Scene(CAMERA, WALL, settings), np.random.default_rng(seed), np.random.default_rng(seed + 99)
    state, out, truth = begin(settings), [], []
    for frame, code in enumerate(states):
        p = points(frame / 30)
        y = np.where(np.asarray(code)[:, None] < 2, p + noise * noisy.normal(size=(3, 3)), np.nan)
        state, found = step(
            state, Seen(frame / 30, y, np.asarray(code), None if depth is None else depth(p[2])), scene, rng
        )
        out.append(found[2])
        truth.append(p[2])
    return out, np.array(truth), state


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_tracked_wrist_is_followed_better_than_it_is_measured(variant):
    found, truth, _ = followed([TRACKED] * 60, settings=setting(variant), noise=0.012)
    error = np.linalg.norm([e.mean for e in found] - truth, axis=1)[10:]
    assert {e.status for e in found} == {"tracked"}
    assert np.sqrt((error**2).mean()) < 0.012 * math.sqrt(3)


@pytest.mark.parametrize("seed", range(4))
def test_a_hidden_wrist_stays_in_the_ellipsoid_and_comes_back_at_once(seed):
    states = [TRACKED] * 30 + [HIDDEN] * 40 + [TRACKED] * 5
    found, truth, _ = followed(states, seed)
    lost = [k for k, e in enumerate(found) if e.status == "predicted"]
    assert lost == list(range(30, 70))
    inside = [mahalanobis(truth[k : k + 1], found[k].mean, found[k].covariance)[0] < 7.815 for k in lost]
    assert np.mean(inside) >= 0.9
    assert np.linalg.norm(found[70].mean - truth[70]) < 0.04
    assert found[31].volume > found[29].volume


def test_every_further_constraint_makes_the_cloud_smaller():
    states = [TRACKED] * 30 + [HIDDEN] * 30
    volumes = {v: np.mean([e.volume for e in followed(states, 1, setting(v))[0][35:]]) for v in VARIANTS}
    assert volumes["complete"] <= 1.05 * volumes["joint-volume"] < 0.7 * volumes["original"]


def test_each_variant_tests_what_it_says():
    states = [TRACKED] * 30 + [HIDDEN] * 20
    kills = {v: np.sum([e.kills for e in followed(states, 2, setting(v))[0][30:]], axis=0) for v in VARIANTS}
    assert (kills["original"][:2] == 0).all() and (kills["original"][2:] > 0).all()
    assert kills["joint-volume"][0] == 0 and kills["joint-volume"][1] > 0
    assert (kills["complete"][[0, 1, 3]] > 0).all()


def test_where_the_camera_sees_the_wall_the_wrist_is_not():
    _, _, state = followed([TRACKED] * 30 + [HIDDEN] * 20, 3)
    p = state.clouds[2].x[np.isfinite(state.clouds[2].log_weight), :3]
    depth = screen(arm_at(49 / 30)[2])
    u, v = np.rint(150.0 * p[:, :2].T / p[:, 2] + np.array([[80.0], [60.0]])).astype(int)
    assert (depth[v, u] <= p[:, 2] + 0.06).all()


def test_when_no_particle_is_left_all_are_drawn_again_and_it_is_said():
    """The camera looks through every place that the wrist could have gone to."""
    empty = np.full((120, 160), 9.0, np.float32)
    found, *_ = followed([TRACKED] * 10 + [HIDDEN] * 10, 4, depth=lambda p: empty)
    assert {e.status for e in found[10:]} == {"uncertain"}
    for estimate in found[10:]:
        assert np.isfinite(estimate.mean).all() and np.linalg.eigvalsh(estimate.covariance).min() > 0
        assert np.linalg.norm(estimate.mean - arm_at(0)[1]) < 0.4 and estimate.kills.sum() > 0


@pytest.mark.parametrize(
    "states",
    [
        [np.full(3, 2)] * 20,
        [np.array([0, 0, 2])] * 20,
        [np.array([0, 2, 2])] * 20,
        [np.array([2, 2, 0])] * 20,
        [TRACKED] * 5 + [np.full(3, 2)] * 30,
        [TRACKED] * 5 + [np.array([0, 2, 2])] * 30,
        [TRACKED] * 5 + [np.full(3, 1)] * 45,
        [np.full(3, 1)] * 30,
    ],
    ids=[
        "nothing",
        "no wrist",
        "no elbow",
        "wrist only",
        "all lost",
        "elbow lost",
        "inferred for long",
        "inferred only",
    ],
)
@pytest.mark.parametrize(
    "depth", [screen, None, lambda p: np.zeros((120, 160), np.float32)], ids=["map", "none", "holes"]
)
def test_whatever_is_missing_there_is_an_answer(states, depth):
    few = {"sampling": Sampling(particles=150), "fathers": Sampling(particles=40)}
    for variant in ("original", "complete"):
        found, *_ = followed(states, 5, replace(settings_of(variant), **few), depth)
        for estimate, code in zip(found, states, strict=True):
            assert np.isfinite(estimate.mean).all() and np.isfinite(estimate.volume) and estimate.volume > 0
            assert np.linalg.eigvalsh(estimate.covariance).min() > 0
            assert (estimate.status == "tracked") == (code[2] == 0)
        if states[0][0] == 2 and states[0][2] == 2:
            assert {e.status for e in found} == {"lost"}


def test_uncertainty_grows_while_everything_is_lost():
    found, _, _ = followed([TRACKED] * 10 + [np.full(3, 2)] * 30, 6, depth=None)
    volumes = [e.volume for e in found]
    assert volumes[12] < volumes[18] < volumes[35]


def test_lengths_are_measured_from_tracked_joints():
    _, _, state = followed([TRACKED] * 60, 7)
    np.testing.assert_allclose(state.length, [0.30, 0.26], atol=0.005)
    assert state.length_count.tolist() == [60, 60]
    _, _, unknown = followed([np.full(3, 1)] * 5, 7)
    assert unknown.length.tolist() == [0.30, 0.26] and unknown.length_count.tolist() == [0, 0]


def test_the_same_seed_gives_the_same_numbers():
    states = [TRACKED] * 10 + [HIDDEN] * 10
    one, other, third = (followed(states, seed)[0] for seed in (8, 8, 9))
    assert all(np.array_equal(a.mean, b.mean) for a, b in zip(one, other, strict=True))
    assert not np.array_equal(one[15].mean, third[15].mean)


def test_any_time_step_spreads_a_hidden_cloud_alike():
    """Twice the frames a second, the same second."""
    spread = []
    for rate in (15, 60):
        settings = setting()
        scene, rng, state = Scene(CAMERA, None, settings), np.random.default_rng(1), begin(settings)
        for frame in range(2 * rate):
            code = TRACKED if frame < rate else HIDDEN
            y = np.where(code[:, None] < 2, arm_at(0), np.nan)
            state, found = step(state, Seen(frame / rate, y, code), scene, rng)
        spread.append(math.sqrt(found[2].covariance.trace()))
    assert spread[0] == pytest.approx(spread[1], rel=0.25)


def test_time_has_to_rise():
    settings = setting()
    scene, rng = Scene(CAMERA, WALL, settings), np.random.default_rng(0)
    state, _ = step(begin(settings), Seen(1.0, arm_at(1.0), TRACKED), scene, rng)
    for time in (1.0, 0.5):
        with pytest.raises(ValueError, match=r"time: .* s after 1 s; a later time was wanted"):
            step(state, Seen(time, arm_at(1.0), TRACKED), scene, rng)
