"""Poses that look the same: where they are, how they are weighed, and that the tracker ends on the right side."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.appearance import learn
from handtrack.camera import Camera, orthographic, perspective
from handtrack.consistency import first_consistency
from handtrack.estimate import Estimate, Known, Prior, estimate
from handtrack.folds import depth_angles, find_folds, fold_candidates
from handtrack.hypotheses import (
    Hypotheses,
    about_best,
    coincide,
    corrected,
    differ,
    frame_cost,
    in_question,
    judge,
    kept,
    updated,
    weights,
)
from handtrack.kinematics import Coupling, FrameRow, Model, forward, link_ends, model_from_rows
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.measure import posed
from handtrack.prediction import first_prediction
from handtrack.profiles import place_outline
from handtrack.residuals import OutlineFeatures, chain, in_world, outline_residuals
from handtrack.settings import Settings
from handtrack.shading_cost import loss, shading_cost
from handtrack.track import UNCERTAIN
from handtrack.tracker import track
from synth.scene import LIGHT, Scene, images, skin
from synth.scene import image as image_of
from synth.scenes import full_hand_spread
from synth.sensor import Sensor
from synth.shading import Light

EDGE_ON = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # fingers bend towards or from the camera
WIDE = np.eye(3) * math.radians(10.0) ** 2


def camera(kind: str = "orthographic", R: np.ndarray = EDGE_ON) -> Camera:
    if kind == "orthographic":
        return orthographic(480, 240, 3.2, 100.0, 120.0, R, np.zeros(3))
    return perspective(480, 240, 640.0, 640.0, 100.0, 120.0, R, np.array([0.0, 0.0, 200.0]))


def outline_change(on, u: np.ndarray, other: np.ndarray) -> float:
    """Root mean square distance in pixels of the outline of `other` from that of `u`."""
    at = place_outline(posed(on, u), on.camera, on.model.link_is_tip)
    edges = OutlineFeatures(*in_world(on.camera, at.ray, at.slope), at.link, np.ones(at.link.size))
    return float(np.sqrt(np.mean(outline_residuals(on, edges, other)[0] ** 2)))


def tip_depth(model: Model, R: np.ndarray, q: np.ndarray) -> np.ndarray:
    """How far the links' tips lie behind the image plane through the knuckle."""
    return (link_ends(model, forward(model, q))[1] @ R.T)[..., 2]


# --- folds


def test_an_orthographic_finger_folds_onto_its_mirror_image():
    on = chain(builtin_model("index"), camera())
    found = fold_candidates(on, np.radians([8.0, 0.0, 0.0]), WIDE)
    assert np.abs(np.degrees(found) - [-8.0, 0.0, 0.0]).max(axis=1).min() < 0.01


@settings(max_examples=25, deadline=None)
@given(st.floats(-14.0, 14.0), st.floats(0.0, 25.0), st.floats(0.0, 25.0))
def test_a_fold_has_the_same_outline_another_place_and_keeps_the_limits(mcp, pip, dip):
    model = builtin_model("index")
    on, u = chain(model, camera()), np.radians([mcp, pip, dip])
    folds = find_folds(on, u, WIDE)
    for other in folds.poses:
        assert outline_change(on, u, other) < 1.0
        assert np.abs(other - u).max() >= math.radians(2.5)
        assert (other >= model.limits[:, 0] - 1e-12).all() and (other <= model.limits[:, 1] + 1e-12).all()
    for step in folds.close:
        assert outline_change(on, u, u + step) < 0.3 and np.abs(step).max() < math.radians(2.5)


def test_a_finger_folds_as_a_whole_where_two_joints_move_its_base():
    scene = full_hand_spread(0, frames=30)
    on = chain(scene.model, scene.camera)
    found = fold_candidates(on, scene.truth[0], np.eye(21) * math.radians(8.0) ** 2)
    assert found.shape[0]
    for other in found:
        moved = np.degrees(np.abs(other - scene.truth[0]))
        names = {scene.model.joint_names[j].split("_")[0] for j in np.flatnonzero(moved > 0.5)}
        assert len(names) == 1  # one finger
        assert outline_change(on, scene.truth[0], other) < 0.7


def test_there_is_no_fold_where_the_finger_bends_in_the_image_plane():
    on = chain(builtin_model("index"), camera(R=np.eye(3)))
    folds = find_folds(on, np.radians([8.0, 4.0, 3.0]), WIDE)
    assert not folds.poses.size and not folds.close.size


def test_there_is_no_fold_where_the_prediction_is_sure_or_the_limits_forbid_it():
    model = builtin_model("index")
    on = chain(model, camera())
    u = np.radians([20.0, 0.0, 0.0])
    assert not fold_candidates(on, u, np.eye(3) * math.radians(0.5) ** 2).size
    assert not fold_candidates(on, u, np.eye(3) * math.radians(1e-3) ** 2).size
    limited = replace(model, limits=np.radians([[0.0, 90.0], [0.0, 100.0], [0.0, 80.0]]))
    straight = np.radians([12.0, 0.0, 0.0])
    assert all(other[0] >= 0.0 for other in fold_candidates(chain(limited, camera()), straight, WIDE))


def test_a_fold_within_the_fitted_sigmas_is_no_pose_apart():
    on, u = chain(builtin_model("index"), camera()), np.radians([5.0, 0.0, 0.0])
    assert fold_candidates(on, u, WIDE).shape[0] > 0
    assert not fold_candidates(on, u, WIDE, fitted=WIDE).size


def test_a_near_fold_is_a_step_and_not_a_pose():
    on = chain(builtin_model("r"), orthographic(64, 64, 10.0, 5.0, 32.0, EDGE_ON, np.zeros(3)))
    folds = find_folds(on, np.radians([1.0]), np.eye(1) * 0.04)
    assert not folds.poses.size
    np.testing.assert_allclose(np.degrees(folds.close), [[-2.0]], atol=1e-6)


def test_in_perspective_the_plane_is_across_the_line_of_sight():
    base = np.array([[60.0, 0.0, 200.0]])
    across = np.array([[200.0, 0.0, -60.0]])
    tip = base + 20.0 * across / np.linalg.norm(across)
    middle = 0.5 * (base + tip)
    expected = math.asin(float((tip - base)[0] @ middle[0]) / (20.0 * float(np.linalg.norm(middle))))
    assert depth_angles(camera("perspective"), base, tip)[0] == pytest.approx(expected)
    assert abs(math.degrees(expected)) < 6.0 and depth_angles(camera(), base, tip)[0] == pytest.approx(
        -0.2915, abs=1e-3
    )
    on = chain(builtin_model("index"), camera("perspective"))
    found = fold_candidates(on, np.radians([5.0, 8.0, 20.0]), WIDE)
    assert found.shape[0] and outline_change(on, np.radians([5.0, 8.0, 20.0]), found[0]) < 1.0


def test_sliding_and_coupled_joints_fold_only_as_they_can_move():
    rows = [
        FrameRow(1, 0, joint="slide", prismatic=True, link_length=20.0, link_radius=(8.0, 8.0)),
        FrameRow(2, 1, a=20.0, joint="pip", limits=(-0.5, 1.5), link_length=30.0, link_radius=(7.0, 7.0)),
        FrameRow(3, 2, a=30.0, joint="dip", link_length=20.0, link_radius=(6.0, 6.0)),
    ]
    model = model_from_rows("mixed", rows, [Coupling("dip", "pip", 0.7)])
    on, u = chain(model, camera()), np.array([3.0, math.radians(6.0)])
    found = fold_candidates(on, u, np.diag([1.0, math.radians(12.0) ** 2]))
    np.testing.assert_allclose(found, [[3.0, math.radians(-6.0)]], atol=math.radians(0.5))
    fixed = model_from_rows("fixed", [replace(rows[0], joint="slide")])
    assert not fold_candidates(chain(fixed, camera()), np.array([1.0]), np.eye(1)).size


# --- weights


def test_weights_follow_the_costs_and_forget_them():
    log = updated(np.array([0.0, -2.0]), np.array([3.0, 1.0]))
    np.testing.assert_allclose(log, [0.0 - 0.2, 0.0])  # 0.9 * 2 = 1.8 behind, 2 better
    for _ in range(300):
        log = updated(log, np.array([1.0, 1.5]))
    np.testing.assert_allclose(log, [0.0, -0.5 / 0.1], atol=1e-6)  # the geometric sum of half a unit
    np.testing.assert_allclose(weights(np.array([-700.0, -700.0])), [0.5, 0.5])


def two(u, log_weight, sigma=0.01) -> Hypotheses:
    u = np.array(u)
    return Hypotheses(u, np.tile(np.eye(u.shape[1]) * sigma**2, (u.shape[0], 1, 1)), np.array(log_weight))


def test_the_hopeless_are_dropped_and_those_that_agree_are_merged():
    chosen, log = kept(two([[0.0], [0.5], [0.501], [1.0]], [-1.0, 0.0, -0.5, -9.5]))
    assert chosen.tolist() == [1, 0]
    merged = np.logaddexp(0.0, -0.5)
    np.testing.assert_allclose(log, [0.0, -1.0 - merged])
    many, _ = kept(two([[float(i)] for i in range(7)], [-0.1 * i for i in range(7)]))
    assert many.tolist() == [0, 1, 2, 3]


def test_poses_a_degree_or_a_sigma_apart_coincide():
    assert coincide(two([[0.0], [0.017]], [0.0, 0.0], sigma=1e-6), 0, 1)
    assert not coincide(two([[0.0], [0.03]], [0.0, 0.0], sigma=1e-6), 0, 1)
    assert coincide(two([[0.0], [0.5]], [0.0, 0.0], sigma=0.5), 0, 1)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 3))
def test_the_covariance_is_the_second_moment_of_the_mixture_about_the_best(seed, m, k):
    rng = np.random.default_rng(seed)
    u, log = rng.normal(size=(m, k)), rng.normal(size=m)
    roots = rng.normal(size=(m, k, k))
    covariance = roots @ np.swapaxes(roots, 1, 2)
    C = about_best(Hypotheses(u, covariance, log))
    w = np.exp(log) / np.exp(log).sum()
    mean = w @ u
    own = sum(w[i] * (covariance[i] + np.outer(u[i] - mean, u[i] - mean)) for i in range(m))
    np.testing.assert_allclose(C, own + np.outer(mean - u[0], mean - u[0]), atol=1e-9)


def test_poses_differ_by_angle_or_by_a_share_of_a_link():
    rows = [
        FrameRow(1, 0, joint="slide", prismatic=True, link_length=40.0, link_radius=(9.0, 9.0)),
        FrameRow(2, 1, a=40.0, joint="turn", link_length=40.0, link_radius=(8.0, 8.0)),
    ]
    model = model_from_rows("sliding", rows)
    assert not differ(model, np.zeros(2), np.array([3.0, 0.08]))
    assert differ(model, np.zeros(2), np.array([4.0, 0.0])) and differ(model, np.zeros(2), np.array([0.0, 0.09]))


def test_only_links_that_a_pose_moves_are_in_question():
    on = chain(builtin_model("two_finger"), camera())
    u = np.zeros((2, 6))
    u[1, 4] = 0.1  # the index finger's middle joint
    assert in_question(on, u).tolist() == [False, False, False, False, True, True]


# --- shading


def lit_scene(light: Light, mcp: float = 12.0) -> Scene:
    model = builtin_model("index")
    q = np.radians([[mcp, 2.0, 2.0]])
    return Scene("lit", 1, model, camera(), q, q[0], skin(model), light=light, sensor=Sensor(2.0))


@pytest.mark.parametrize("mcp", [12.0, -12.0])
def test_light_from_the_side_tells_a_pose_from_its_fold(mcp):
    scene = lit_scene(LIGHT, mcp)
    on, right = chain(scene.model, scene.camera), scene.truth[0]
    wrong = right * [-1.0, 1.0, 1.0]
    grey = np.asarray(image_of(scene, 0), dtype=np.float32)
    side = replace(scene, truth=np.radians([[-18.0, 10.0, 8.0], [18.0, 10.0, 8.0], [0.0, 15.0, 10.0]]))
    appearance = None
    for frame, q in enumerate(side.truth):  # the light is known from other poses
        before = np.asarray(image_of(side, frame), dtype=np.float32)
        appearance = learn(before, posed(on, q), scene.camera, appearance)
    assert appearance is not None
    good, bad = (shading_cost(grey, on, u, appearance) for u in (right, wrong))
    assert good.shape == (3,) and good.sum() < 5.0 and bad.sum() > good.sum() + 9.0


def test_a_link_that_is_not_in_the_image_costs_what_a_right_one_does():
    scene = lit_scene(LIGHT)
    on = chain(scene.model, scene.camera)
    grey = np.asarray(image_of(scene, 0), dtype=np.float32)
    appearance = learn(grey, posed(on, scene.truth[0]), scene.camera)
    away = chain(scene.model, replace(scene.camera, cx=-900.0))
    np.testing.assert_allclose(shading_cost(grey, away, scene.truth[0], appearance), 1.0)
    assert loss(np.array([0.1]), 1.0)[0] == pytest.approx(0.005, rel=0.01)


# --- the tracker


def folding(seed: int, frames: int = 52) -> Scene:
    """A finger swings into the image plane, rests there, and bends to one side."""
    rng = np.random.default_rng(seed)
    model, t = builtin_model("index"), np.arange(frames)

    def ease(x: np.ndarray) -> np.ndarray:
        x = np.clip(x, 0.0, 1.0)
        return x * x * (3.0 - 2.0 * x)

    start, side = (
        rng.choice([-1.0, 1.0]) * rng.uniform(22.0, 28.0),
        (1.0 if seed % 2 else -1.0) * rng.uniform(31.0, 39.0),
    )
    mcp = start * (1.0 - ease(t / 20.0)) + side * ease((t - 28) / 20.0)
    q = np.radians(np.stack([mcp, np.ones(frames), np.ones(frames)], axis=1))
    return Scene("folding", seed, model, camera(), q, q[0], skin(model), sensor=Sensor(2.0))


SEEDS = (0, 3)


@pytest.fixture(scope="module")
def tracked():
    """Each motion with one pose, and with rivals."""
    scenes = [folding(seed) for seed in SEEDS]
    return [
        (
            scene,
            *(
                track(images(scene), scene.model, scene.camera, scene.start, settings=Settings(hypotheses=on))
                for on in (False, True)
            ),
        )
        for scene in scenes
    ]


def wrong_side(scene: Scene, q: np.ndarray) -> bool:
    depth = tip_depth(scene.model, scene.camera.R, np.stack([q[-1], scene.truth[-1]]))[:, -1]
    return bool(depth[0] * depth[1] < 0.0)


def test_rivals_end_on_the_right_side_where_one_pose_does_not(tracked):
    alone = [wrong_side(scene, single.q) for scene, single, _ in tracked]
    with_rivals = [wrong_side(scene, both.q) for scene, _, both in tracked]
    assert sum(alone) >= 1 and not any(with_rivals)


def test_rivals_make_the_sigmas_cover_and_the_status_uncertain(tracked):
    for scene, single, both in tracked:
        error = np.abs(both.q - scene.truth)
        assert np.mean(error <= 2.0 * both.sigma) > 0.85
        assert single.rival is not None and np.isnan(single.rival).all()
        live = np.flatnonzero(np.isfinite(both.rival).all(axis=1))
        assert live.size and (both.rival_weight[live] > 0.0).all() and (both.rival_weight[live] <= 1.0).all()
        far = live[np.abs(both.rival[live] - both.q[live]).max(axis=1) > math.radians(5.0)]
        assert (both.status[far] == UNCERTAIN).all()
        distance = np.abs(both.rival[far] - both.q[far])
        assert (both.sigma[far] >= 0.99 * np.sqrt(both.rival_weight[far])[:, None] * distance).all()


def first_estimate(scene: Scene, u: np.ndarray) -> tuple[tuple[np.ndarray, ...], Known, Estimate]:
    on = chain(scene.model, scene.camera)
    grey = np.asarray(image_of(scene, 0), dtype=np.float32)
    appearance = learn(grey, posed(on, u), scene.camera)
    known = Known((on,), Settings(), (appearance,), first_consistency(3), (None,))
    return (grey,), known, estimate((grey,), known, first_prediction(u, 25.0, Settings()).motion, u, 3, 1.0)


def test_an_ordinary_frame_has_no_rivals_and_keeps_its_covariance():
    scene = replace(lit_scene(LIGHT), camera=camera(R=np.eye(3)))
    pictures, known, found = first_estimate(scene, scene.truth[0])
    ahead = first_prediction(scene.truth[0], 25.0, Settings())
    verdict = judge(pictures, known, ahead, found, (), 0.0, 3)
    assert verdict.rivals == () and verdict.other is None and not verdict.close.size
    np.testing.assert_array_equal(verdict.covariance, found.covariance)
    assert verdict.found is found


def test_the_cost_of_a_frame_counts_prediction_edges_and_what_is_missing():
    scene = lit_scene(LIGHT)
    pictures, known, found = first_estimate(scene, scene.truth[0])
    compared = np.ones(3, dtype=bool)
    whole = frame_cost(pictures, known, found, compared)
    off = np.array([0.1, 0.0, 0.0])
    prior = Prior(found.u - off, np.eye(3) * 0.01, np.eye(3) * 100.0)
    blind = replace(found, fit=None, prior=prior)
    assert frame_cost(pictures, known, blind, compared) == pytest.approx(0.5)
    view = found.seen[0]
    assert found.fit is not None and isinstance(view.features, OutlineFeatures)
    fewer = view.found & (np.cumsum(view.found) > 4)
    fit = replace(found.fit, r=found.fit.r[4:], J=found.fit.J[4:], weight=found.fit.weight[4:])
    features = view.features
    cut = OutlineFeatures(features.ray[4:], features.slope[4:], features.link[4:], features.sigma[4:])
    missing = replace(found, seen=(replace(view, found=fewer, features=cut),), fit=fit)
    assert frame_cost(pictures, known, missing, compared) > whole
    assert frame_cost(pictures, known, found, np.zeros(3, dtype=bool)) < 1.0


def test_a_close_fold_softens_the_measurement_and_leaves_its_value():
    scene = lit_scene(LIGHT)
    _, _, found = first_estimate(scene, scene.truth[0])
    ahead = first_prediction(scene.truth[0], 25.0, Settings())
    plain = corrected(ahead, found)
    same = corrected(ahead, found, np.zeros((0, 3)))
    np.testing.assert_array_equal(plain.motion.x, same.motion.x)
    step = np.radians([[1.5, 0.0, 0.0]])
    soft = corrected(ahead, found, step)
    more = soft.motion.covariance - plain.motion.covariance
    assert np.linalg.eigvalsh(more).min() > -1e-12 and more[0, 0] > 0.0
    # An oracle by hand: the measurement z with R widened by the step's second moment.
    A, L, m = found.information, found.prior.information, found.prior.mean
    z = found.u + np.linalg.solve(A, L @ (found.u - m))
    R = np.linalg.inv(A) + step.T @ step
    gain = found.prior.covariance @ np.linalg.inv(found.prior.covariance + R)
    np.testing.assert_allclose(soft.motion.q, m + gain @ (z - m), atol=math.radians(0.05))
    lost = replace(found, information=np.zeros((3, 3)))
    assert np.isfinite(corrected(ahead, lost, step).motion.x).all()
