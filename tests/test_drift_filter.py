"""Drift-FF: particles of the suit's drift, their weights, and what is said of them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handtrack.body import drift_filter, walk_fusion
from handtrack.body.particles import effective_size, estimate
from handtrack.body.posture import body_of
from handtrack.body.suit_body import body_of_walk
from handtrack.body.walk_cloud import (
    Cloud,
    mean_turn,
    moments_of,
    renewed,
    scattered,
    spread_anew,
    turns,
    walked,
    world_points,
)
from handtrack.body.walk_metrics import walk_errors, walk_figures
from handtrack.body.walk_moment import Moment, moments
from handtrack.body.walk_run import follow_walk
from handtrack.body.walk_settings import Settings
from handtrack.body.walk_weights import fits, largest_power, log_likelihood, pixel_variance
from handtrack.camera import project
from handtrack.formats.walks import Walk
from synth.walk import WalkScene, WalkSettings, make_walk

TOLD = Settings(method="drift-ff")


@pytest.fixture(scope="module")
def scene() -> WalkScene:
    return make_walk(3, WalkSettings(seconds=20.0))


@pytest.fixture(scope="module")
def seen(scene: WalkScene) -> Moment:
    """A moment in which all keypoints are where the suit, as it is, expects them."""
    told = moments(scene.walk, body_of_walk(scene.walk), TOLD)
    here = next(moment for moment in told if moment.in_view)
    points = world_points(cloud_at(here), body_of_walk(scene.walk), here.R[0])
    return replace(here, uv=project(here.camera, points[0]), confidence=np.ones(16))


def cloud_at(moment: Moment, n: int = 1) -> Cloud:
    """Particles of no drift in the suit's posture."""
    x = np.zeros((n, 6))
    x[:, :3] = moment.p[0]
    return Cloud(x, np.zeros((n, 6)), np.zeros(6), np.full(n, 1.0 / n), np.tile(moment.q[6:], (n, 1)))


def random_cloud(n: int, seed: int) -> Cloud:
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((n, 6)) @ rng.standard_normal((6, 6)) * 0.1
    return Cloud(x, 0.1 * x + rng.standard_normal((n, 6)), np.ones(6), rng.dirichlet(np.ones(n)), np.zeros((n, 20)))


@given(angles=st.lists(st.floats(-7.0, 7.0), min_size=3, max_size=3))
def test_turns_are_those_of_scipy(angles):
    x = np.array([[0.0, 0.0, 0.0, *angles]])
    wanted = Rotation.from_euler("ZYX", angles[::-1]).as_matrix()
    np.testing.assert_allclose(turns(x)[0], wanted, atol=1e-12)


@given(seed=st.integers(0, 1000), spread=st.floats(0.01, 1.0))
def test_mean_of_rotations_is_that_of_their_quaternions(seed, spread):
    rng = np.random.default_rng(seed)
    middle = Rotation.from_rotvec(rng.standard_normal(3) * 2.0)
    R = Rotation.from_rotvec(spread * rng.standard_normal((20, 3))) * middle
    weight = rng.dirichlet(np.ones(20))
    mean, apart = mean_turn(R.as_matrix(), weight)
    assert np.isclose(np.linalg.det(mean), 1.0)
    np.testing.assert_allclose(mean, R.mean(weight).as_matrix(), atol=1e-6)
    np.testing.assert_allclose(
        (Rotation.from_rotvec(apart) * Rotation.from_matrix(mean)).as_matrix(), R.as_matrix(), atol=1e-9
    )


def test_heading_has_a_mean_and_a_spread_across_the_half_turn():
    cloud = scattered(np.array([1.0, 2.0, 3.0, 0.0, 0.0, np.pi]), 0.1 * np.ones(6), np.zeros(6), np.zeros((5000, 20)),
                      np.random.default_rng(1))  # fmt: skip
    cloud = replace(cloud, x=np.concatenate([cloud.x[:, :3], np.zeros((5000, 2)), cloud.x[:, 5:]], axis=1))
    place, turn, covariance = moments_of(cloud)
    np.testing.assert_allclose(place, [1.0, 2.0, 3.0], atol=0.01)
    assert abs(abs(np.arctan2(turn[1, 0], turn[0, 0])) - np.pi) < 0.01
    np.testing.assert_allclose(np.diag(covariance), 0.01, rtol=0.1)


def test_particles_that_walk_know_their_place_and_pace_as_a_kalman_filter_does():
    n, dt, keep, rng = 40_000, 0.5, 0.9, np.random.default_rng(2)
    noise, usual = np.full(6, 0.02), np.full(6, 0.3)
    cloud = scattered(np.zeros(6), np.full(6, 0.1), usual, np.zeros((n, 20)), rng)
    P = np.diag([0.01, 0.09])
    for _ in range(6):
        cloud = walked(cloud, np.zeros((n, 3)), dt, noise, keep, usual, rng)
        F = np.array([[1.0, dt], [0.0, keep]])
        P = F @ P @ F.T + np.diag([0.02, (1.0 - keep**2) * 0.09])
    for k in range(6):
        found = np.cov(cloud.x[:, k], cloud.pace[:, k])
        found[1, 1] += cloud.pace_variance[k]
        np.testing.assert_allclose(found, P, rtol=0.06, atol=2e-3)


def test_without_noise_and_pace_particles_go_exactly_their_ways():
    cloud = random_cloud(5, 1)
    cloud = replace(cloud, pace=np.zeros((5, 6)), pace_variance=np.zeros(6))
    way = np.arange(15.0).reshape(5, 3)
    after = walked(cloud, way, 0.2, np.zeros(6), 1.0, np.zeros(6), np.random.default_rng(0))
    np.testing.assert_allclose(after.x[:, :3] - cloud.x[:, :3], way)
    np.testing.assert_allclose(after.x[:, 3:], cloud.x[:, 3:])


def test_spreading_particles_anew_keeps_mean_and_covariance():
    cloud = random_cloud(20_000, 3)
    both = np.concatenate([cloud.x, cloud.pace], axis=1)
    mean, covariance = estimate(both, cloud.weight)
    after = spread_anew(cloud, np.random.default_rng(4))
    found, spread = estimate(np.concatenate([after.x, after.pace], axis=1), after.weight)
    scale = np.sqrt(np.diag(covariance))
    assert (np.abs(found - mean) < 0.05 * scale).all()
    assert (np.abs(spread - covariance) < 0.08 * np.outer(scale, scale)).all()
    assert np.unique(after.x, axis=0).shape == after.x.shape


def test_particles_are_drawn_anew_only_where_few_of_them_count():
    even = replace(random_cloud(100, 5), weight=np.full(100, 0.01))
    assert renewed(even, 0.5, np.random.default_rng(0)) is even
    weight = np.zeros(100)
    weight[[3, 40]] = 0.5
    after = renewed(replace(even, weight=weight), 0.5, np.random.default_rng(0))
    np.testing.assert_allclose(after.weight, 0.01)
    assert np.array_equal(np.unique(after.x[:, 0]), np.unique(even.x[[3, 40], 0]))


def test_the_largest_power_leaves_the_wanted_share_and_no_more():
    rng = np.random.default_rng(6)
    found, even = -50.0 * rng.standard_normal(500) ** 2, np.full(500, 0.002)
    power = largest_power(even, found, 1.0, 0.3)
    weight = np.exp(power * found)
    assert 0.0 < power < 1.0
    assert effective_size(weight / weight.sum()) == pytest.approx(150.0, rel=1e-3)
    assert largest_power(even, 1e-6 * found, 1.0, 0.3) == 1.0


def test_the_likelihood_is_normal_without_outliers(seen: Moment):
    told, body = replace(TOLD, outliers=0.0), body_of(1.75)
    cloud = cloud_at(seen, 3)
    cloud = replace(cloud, x=cloud.x + np.array([[0.0], [0.02], [-0.02]]) * np.array([0, 0, 1.0, 0, 0, 0]))
    points = world_points(cloud, body, seen.R[0])
    variance = pixel_variance(seen, points[0], told)
    found = log_likelihood(seen, points, variance, told)
    square = ((project(seen.camera, points) - seen.uv) ** 2).sum(axis=-1) / variance
    np.testing.assert_allclose(found - found[0], -0.5 * (square.sum(axis=1) - square[0].sum()), atol=0.02)


def test_a_keypoint_somewhere_else_costs_no_more_the_farther_it_is(seen: Moment):
    body = body_of(1.75)
    points = world_points(cloud_at(seen), body, seen.R[0])
    variance = pixel_variance(seen, points[0], TOLD)
    cost = []
    for off in (0.0, 1000.0, 5000.0):
        uv = seen.uv.copy()
        uv[4] += [off, 0.0]
        cost.append(float(log_likelihood(replace(seen, uv=uv), points, variance, TOLD)[0]))
    assert cost[0] > cost[1] == cost[2] > -100.0


def test_who_is_less_sure_counts_less(seen: Moment):
    points = world_points(cloud_at(seen), body_of(1.75), seen.R[0])
    off = replace(seen, uv=seen.uv + 10.0)
    drop = []
    for confidence in (1.0, 0.5, 0.1):
        other = replace(off, confidence=np.full(16, confidence))
        exact = replace(seen, confidence=np.full(16, confidence))
        variance = pixel_variance(other, points[0], TOLD)
        drop.append(
            float((log_likelihood(exact, points, variance, TOLD) - log_likelihood(other, points, variance, TOLD))[0])
        )
    assert drop[0] > drop[1] > drop[2] > 0.0


def test_particles_behind_the_camera_have_a_weight_that_is_small_but_a_number(seen: Moment):
    points = world_points(cloud_at(seen, 2), body_of(1.75), seen.R[0])
    points[1] -= 50.0 * seen.camera.R[2]
    variance = pixel_variance(seen, points[0], TOLD)
    found = log_likelihood(seen, points, variance, TOLD)
    assert np.isfinite(found).all() and found[1] < found[0] - 50.0


def test_a_frame_fits_where_the_particles_expect_it(seen: Moment):
    points = world_points(cloud_at(seen, 2), body_of(1.75), seen.R[0])
    assert fits(cloud_at(seen, 2), points, seen, TOLD)
    assert not fits(cloud_at(seen, 2), points, replace(seen, uv=seen.uv + 300.0), TOLD)
    assert not fits(cloud_at(seen, 2), points - 50.0 * seen.camera.R[2], seen, TOLD)


def figures(walk: Walk, **changes):
    track = follow_walk(walk, body_of_walk(walk), Settings(**{"method": "drift-ff", **changes}))
    found = walk_figures(track, walk.truth)
    assert found is not None
    return track, found


def test_drift_ff_is_better_than_suit_and_camera_alone_and_than_no_proposal(scene: WalkScene):
    track, found = figures(scene.walk)
    assert found.mean < 0.06 and found.heading < np.radians(3.0)
    for changes in ({"method": "suit"}, {"method": "camera"}, {"proposal": False}):
        _, other = figures(scene.walk, **changes)
        assert found.mean < other.mean and found.wrist < other.wrist, changes
    assert {"tracked", "predicted"} <= set(track.status)


def test_the_same_seed_gives_the_same_track_and_another_one_another():
    walk = make_walk(4, WalkSettings(seconds=4.0)).walk
    body = body_of_walk(walk)
    one, two, other = (follow_walk(walk, body, TOLD, seed) for seed in (1, 1, 2))
    assert np.array_equal(one.p, two.p) and np.array_equal(one.posture, two.posture)
    assert not np.array_equal(one.p, other.p)


def test_a_step_leaves_the_state_before_as_it_was(scene: WalkScene):
    told = moments(scene.walk, body_of_walk(scene.walk), TOLD)
    state = drift_filter.begin(body_of_walk(scene.walk), TOLD)
    state, _ = drift_filter.step(state, told[0], np.random.default_rng(0))
    kept = state.cloud.x.copy(), state.cloud.weight.copy(), state.postures.theta.copy()
    drift_filter.step(state, told[1], np.random.default_rng(1))
    for before, now in zip(kept, (state.cloud.x, state.cloud.weight, state.postures.theta), strict=True):
        assert np.array_equal(before, now)


def jumping(walk: Walk, at: float, metres: float, degrees: float) -> Walk:
    """The same walk whose suit, at a time, thinks itself somewhere else."""
    later = walk.time >= at
    turn = Rotation.from_euler("z", degrees, degrees=True)
    p, wxyz = walk.p.copy(), walk.wxyz.copy()
    p[later] = turn.apply(p[later].reshape(-1, 3)).reshape(-1, 13, 3) + np.array([metres, 0.0, 0.0])
    turned = turn * Rotation.from_quat(wxyz[later].reshape(-1, 4), scalar_first=True)
    wxyz[later] = turned.as_quat(scalar_first=True).reshape(-1, 13, 4)
    return replace(walk, p=p, wxyz=wxyz)


def test_found_again_after_the_suit_has_jumped():
    walk = make_walk(4, WalkSettings(seconds=12.0, in_view=1.0)).walk
    track, _ = figures(jumping(walk, 4.0, 3.0, 60.0))
    assert walk.truth is not None
    errors = walk_errors(track, walk.truth)
    assert np.median(errors.place[walk.time < 4.0]) < 0.08
    assert np.median(errors.place[walk.time > 7.0]) < 0.12
    assert np.median(np.abs(errors.heading[walk.time > 7.0])) < np.radians(5.0)
    assert {"lost", "uncertain"} & set(track.status[(walk.time >= 4.0) & (walk.time < 7.0)])


def test_a_suit_that_begins_somewhere_else_is_found_in_the_first_frame():
    walk = make_walk(4, WalkSettings(seconds=4.0, in_view=1.0)).walk
    track, _ = figures(jumping(walk, -1.0, 5.0, 100.0))
    assert walk.truth is not None
    errors = walk_errors(track, walk.truth)
    assert errors.place[0] < 0.6 and errors.place[5:].max() < 0.3


def test_keypoints_of_nobody_do_not_move_the_person():
    walk = make_walk(4, WalkSettings(seconds=6.0, in_view=1.0)).walk
    uv = walk.uv.copy()
    uv[15] = np.random.default_rng(0).uniform(0.0, 700.0, uv[15].shape)
    track, found = figures(replace(walk, uv=uv))
    assert found.worst < 0.25 and track.status[15] == "uncertain"


def test_a_tilted_suit_is_set_upright_where_the_whole_rotation_is_followed():
    walk = make_walk(6, WalkSettings(seconds=10.0, in_view=1.0)).walk
    lean = Rotation.from_euler("xy", [8.0, -6.0], degrees=True)
    p = lean.apply(walk.p.reshape(-1, 3)).reshape(walk.p.shape)
    turned = lean * Rotation.from_quat(walk.wxyz.reshape(-1, 4), scalar_first=True)
    walk = replace(walk, p=p, wxyz=turned.as_quat(scalar_first=True).reshape(walk.wxyz.shape))
    assert walk.truth is not None
    up = Rotation.from_quat(walk.truth.wxyz, scalar_first=True).as_matrix()[:, 2]
    off = []
    for tilt in (0.0, 10.0):
        body, rng = body_of_walk(walk), np.random.default_rng(1)
        state, found = drift_filter.begin(body, replace(TOLD, tilt=tilt)), []
        for moment in moments(walk, body, TOLD):
            state, said = drift_filter.step(state, moment, rng)
            found.append(Rotation.from_euler("ZYX", said.q[3:6]).as_matrix()[2])
        off.append(np.median(np.degrees(np.arccos(np.clip((np.array(found) * up).sum(axis=1), -1.0, 1.0)))[20:]))
    assert off[0] > 8.0 and off[1] < 0.5 * off[0]


def test_spread_grows_while_the_suit_is_silent_and_out_of_view(scene: WalkScene):
    walk = scene.walk
    p, wxyz = walk.p.copy(), walk.wxyz.copy()
    p[40:60], wxyz[40:60] = np.nan, np.nan
    track, _ = figures(replace(walk, p=p, wxyz=wxyz))
    assert track.sigma[58, 0] > track.sigma[38, 0] + 0.5
    assert track.sigma[65, 0] < 0.5
    assert np.isfinite(track.p).all()


def test_a_frame_without_a_place_does_not_begin_anything_anew(scene: WalkScene):
    body = body_of_walk(scene.walk)
    told = moments(scene.walk, body, TOLD)
    rng = np.random.default_rng(0)
    state, _ = drift_filter.step(drift_filter.begin(body, TOLD), told[0], rng)
    few = np.where(np.arange(16) < 4, 1.0, 0.0)
    strange = replace(told[1], seen=True, in_view=True, confidence=few, uv=rng.uniform(0.0, 700.0, (16, 2)))
    after, said = drift_filter.step(replace(state, fitted=False), strange, rng)
    assert after.misfits == state.misfits + 1 and said.status != "tracked"


def test_begun_state_takes_its_counts_from_the_settings():
    state = walk_fusion.begun(body_of(1.75), Settings(particles=33, part_particles=44))
    assert state.cloud.x.shape == (0, 6) and state.postures.theta.shape == (44, 20)
