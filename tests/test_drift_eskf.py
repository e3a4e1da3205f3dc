"""The error-state filter of a walk: right derivatives, drifts and calibrations found, and an honest uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handtrack.body import drift_eskf
from handtrack.body.drift_eskf import C, E, H, State, begin, expected, predicted, step, updated, ways_along
from handtrack.body.posture import body_of, keypoints, pose_from_segments, segment_frames
from handtrack.body.walk_moment import Moment
from handtrack.body.walk_settings import Settings
from handtrack.camera import perspective, project

BODY = body_of(1.75)
# looks along world y from 4 m behind the person, from the height of the chest
CAMERA = perspective(
    1280, 720, 920.0, 920.0, 639.5, 359.5,
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), np.array([0.0, 1.2, 4.2]), np.zeros(5),
)  # fmt: skip
NOTHING = np.random.default_rng(0)


def posture(seed: int = 0, at: tuple[float, float, float] = (0.2, -0.1, 0.9), yaw: float = 0.4) -> np.ndarray:
    q = np.zeros(26)
    q[:4] = *at, yaw
    q[6:] = 0.3 * np.random.default_rng(seed).uniform(*BODY.limits.T)
    return q


def moment(q: np.ndarray, drift: tuple[float, ...] = (0.0,) * 4, **changes) -> Moment:
    """What suit and camera say of a true pose when the suit's frame is off by `p_world = Rot_z(h) p_suit + t`."""
    T = segment_frames(BODY, q[None])[0]
    back = Rotation.from_euler("z", -drift[3]).as_matrix()
    R, p = back @ T[:, :3, :3], (T[:, :3, 3] - np.array(drift[:3])) @ back.T
    wxyz = Rotation.from_matrix(R).as_quat(scalar_first=True)
    told = Moment(
        time=0.0, dt=0.0, frame=0, since=0.0, q=pose_from_segments(BODY, p[None], wxyz[None])[0], p=p, R=R, speed=0.0,
        seen=True, uv=project(CAMERA, keypoints(BODY, q[None])[0]), confidence=np.full(16, 0.9), in_view=True,
        camera_dt=np.inf, camera=CAMERA,
    )  # fmt: skip
    return replace(told, **changes)


def unseen(told: Moment) -> Moment:
    return replace(told, seen=False, in_view=False, uv=np.full((16, 2), np.nan), confidence=np.zeros(16))


def after(drift: tuple[float, float, float, float], frames: int = 40, settings: Settings | None = None, **changes):
    """State and estimate after frames of many postures under one drift, and the last true pose."""
    state, rng = begin(BODY, settings or Settings()), np.random.default_rng(1)
    estimate, q = None, posture()
    for k in range(frames):
        q = posture(k, (0.2 + 0.02 * k, -0.1, 0.9), 0.4 + 0.1 * k)
        told = moment(q, drift, time=0.2 * k, dt=0.2 * (k > 0), camera_dt=0.2 if k else np.inf, **changes)
        noisy = replace(told, uv=told.uv + 5.0 * rng.standard_normal((16, 2)))
        state, estimate = step(state, noisy, NOTHING)
    assert estimate is not None
    return state, estimate, q


def test_ways_along_segments_add_up_to_the_keypoints():
    q = posture()
    T = segment_frames(BODY, q[None])[0]
    way = (T[:, :3, :3] @ ways_along(BODY)[..., None])[..., 0].sum(axis=1)
    np.testing.assert_allclose(q[:3] + way, keypoints(BODY, q[None])[0], atol=1e-12)


def test_derivative_of_expected_keypoints_is_that_of_finite_differences():
    state = begin(BODY, Settings())
    x = np.zeros(47)
    x[E], x[H] = (0.3, -0.2, 1.0), 0.5
    told = moment(posture())
    _, J = expected(state, x, told)
    step_by = 1e-6
    for i in (*range(4), *range(C.start, C.stop)):
        more, less = x.copy(), x.copy()
        more[i] += step_by
        less[i] -= step_by
        slope = (expected(state, more, told)[0] - expected(state, less, told)[0]) / (2 * step_by)
        np.testing.assert_allclose(J[:, :, i], slope, atol=1e-8)


def test_prediction_moves_with_the_suits_step_turned_into_the_world():
    state = predicted(begin(BODY, Settings()), moment(posture()))
    x = state.x.copy()
    x[H] = np.pi / 2
    state = replace(state, x=x)
    later = predicted(state, moment(posture(at=(1.2, -0.1, 0.9)), dt=0.2))
    np.testing.assert_allclose(later.x[E] - state.x[E], [0.0, 1.0, 0.0], atol=1e-12)


def test_covariance_of_prediction_agrees_with_samples():
    told = replace(Settings(), drift_noise=0.0, drift_per_speed=0.0, heading_noise=0.0, pace=0.0, heading_pace=0.0)
    state = predicted(begin(BODY, told), moment(posture()))
    sigma = np.zeros(47)
    sigma[:8] = 0.02
    state = replace(state, P=np.diag(sigma**2))
    later = moment(posture(at=(0.8, 0.5, 0.9)), dt=0.2)
    rng = np.random.default_rng(3)
    cloud = [predicted(replace(state, x=state.x + sigma * rng.standard_normal(47)), later).x[:4] for _ in range(1000)]
    found = np.cov(np.array(cloud).T)
    np.testing.assert_allclose(found, predicted(state, later).P[:4, :4], atol=0.1 * np.abs(found).max())


def test_uncertainty_grows_out_of_view_and_faster_while_walking():
    state, *_ = after((0.1, 0.0, 0.0, 0.0), 5)
    spread = []
    for speed in (0.0, 1.0):
        away = state
        for _ in range(20):
            away = predicted(away, unseen(moment(posture(), dt=0.2, speed=speed)))
        spread.append(away.P[0, 0])
    assert state.P[0, 0] < spread[0] < spread[1]


def test_drift_is_found_from_noisy_keypoints():
    drift = (0.15, -0.1, 0.02, np.radians(3.0))
    _, estimate, q = after(drift)
    sigma = np.sqrt(np.diag(estimate.covariance))
    assert np.linalg.norm(estimate.q[:3] - q[:3]) < 0.03
    assert abs(estimate.q[3] - q[3] + 2 * np.pi * round((q[3] - estimate.q[3]) / (2 * np.pi))) < np.radians(1.5)
    assert (np.abs(estimate.q[:3] - q[:3]) < 3.5 * sigma[:3]).all()
    assert estimate.status == "tracked"
    np.testing.assert_allclose(estimate.keypoints, keypoints(BODY, q[None])[0], atol=0.06)


def test_wrongly_found_keypoints_hardly_matter():
    drift, rng = (0.1, 0.1, 0.0, 0.0), np.random.default_rng(5)
    state = begin(BODY, Settings())
    clean = begin(BODY, Settings())
    for k in range(10):
        told = moment(posture(k), drift, time=0.2 * k, dt=0.2 * (k > 0), camera_dt=0.2)
        uv = told.uv.copy()
        uv[rng.integers(16)] += 150.0
        state, estimate = step(state, replace(told, uv=uv), NOTHING)
        clean, without = step(clean, told, NOTHING)
        assert np.linalg.norm(estimate.q[:3] - without.q[:3]) < 0.03


def test_calibration_of_a_segment_is_found():
    wrong = np.radians([0.0, 3.0, 0.0])  # of the trunk
    state = begin(BODY, Settings())
    for k in range(40):
        told = moment(posture(k, yaw=0.5 * k), (0.05, 0.0, 0.0, 0.0), time=0.2 * k, dt=0.2 * (k > 0), camera_dt=0.2)
        R = told.R.copy()
        R[1] = R[1] @ Rotation.from_rotvec(wrong).as_matrix()
        state, _ = step(state, replace(told, R=R), NOTHING)
    c = state.x[C].reshape(13, 3)
    assert abs(c[1, 1] - wrong[1]) < np.radians(1.0)
    assert np.abs(np.delete(c, 1, axis=0)).max() < np.radians(1.0)


def test_nothing_is_calibrated_if_not_wanted():
    state, *_ = after((0.1, 0.0, 0.0, 0.0), 5, Settings(calibrate=False, asymmetric=False))
    assert not state.x[4:].any() and not state.P[4:].any()


def test_pace_of_a_steady_drift_is_learnt_and_goes_on_out_of_view():
    settings = Settings(pace=0.02)
    blind = []
    for asymmetric in (True, False):
        state = begin(BODY, replace(settings, asymmetric=asymmetric))
        for k in range(200):
            told = moment(posture(k), (0.03 * 0.2 * k, 0.0, 0.0, 0.0), time=0.2 * k, dt=0.2 * (k > 0), camera_dt=0.2)
            if k >= 150:
                told = unseen(told)
            state, estimate = step(state, told, NOTHING)
        blind.append(np.linalg.norm(estimate.q[:3] - posture(199)[:3]))
    assert blind[0] < 0.75 * blind[1]


def test_a_suit_in_another_frame_is_found_by_a_new_start():
    state, estimate = step(begin(BODY, Settings()), moment(posture(), (3.0, -2.0, 0.3, 2.0)), NOTHING)
    assert estimate.status == "uncertain"
    np.testing.assert_allclose(estimate.q[:4], posture()[:4], atol=0.02)
    assert state.fitted


def test_a_lost_filter_begins_anew_after_some_frames_that_do_not_fit():
    state, *_ = after((0.0, 0.0, 0.0, 0.0), 20)
    said = []
    for k in range(4):
        told = moment(posture(3), (2.0, 0.5, 0.0, 1.0), time=4.0 + 0.2 * k, dt=0.2, camera_dt=0.2)
        state, estimate = step(state, told, NOTHING)
        said.append(estimate.status)
    assert said[:3] == ["uncertain", "uncertain", "uncertain"] and said[3] == "tracked"
    np.testing.assert_allclose(estimate.q[:3], posture(3)[:3], atol=0.05)


def test_a_frame_that_shows_no_pose_does_not_begin_anew():
    told = moment(posture(), (3.0, -2.0, 0.3, 2.0))
    few = np.where(np.arange(16) < 5, 0.9, 0.0)
    uv = np.where(few[:, None] > 0, told.uv, np.nan)
    state, estimate = step(begin(BODY, Settings()), replace(told, confidence=few, uv=uv), NOTHING)
    assert estimate.status == "uncertain" and state.misfits == 1 and not state.fitted


def test_status_goes_from_predicted_to_lost_as_nothing_is_seen():
    state, *_ = after((0.0, 0.0, 0.0, 0.0), 5)
    seen = []
    for dt in (5.0, 5.0, *[300.0] * 30):
        told = unseen(moment(posture(5), time=state.updated + 10.0, dt=dt, speed=1.0))
        state, estimate = step(state, told, NOTHING)
        seen.append(estimate.status)
    assert list(dict.fromkeys(seen)) == ["predicted", "uncertain", "lost"]


def test_silence_of_the_suit_widens_the_place():
    state = begin(BODY, Settings())
    state, first = step(state, moment(posture()), NOTHING)
    _, later = step(state, unseen(moment(posture(), time=1.0, dt=1.0, since=1.0)), NOTHING)
    assert later.covariance[0, 0] > first.covariance[0, 0] + 0.4


def test_keypoints_behind_the_camera_are_left_out():
    state = begin(BODY, Settings())
    told = moment(posture(at=(0.0, -6.0, 0.9)))
    state = predicted(state, told)
    assert updated(state, replace(told, uv=np.zeros((16, 2))))[1] is False


@pytest.mark.parametrize("freedom", [5.0, 1e6])
def test_an_update_never_makes_less_certain(freedom: float):
    state = predicted(begin(BODY, Settings(freedom=freedom)), moment(posture()))
    later, fits = updated(state, moment(posture()))
    assert fits and (np.diag(later.P) <= np.diag(state.P) + 1e-15).all()
    assert np.linalg.eigvalsh(later.P).min() > -1e-12
    assert isinstance(later, State) and later.x.size == drift_eskf.SIZE
