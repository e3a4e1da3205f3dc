"""Error of the shape: derivatives by really changed models, and evidence that finds how wrong a shape is."""

import math
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from handtrack.camera import orthographic, perspective, project
from handtrack.consistency import first_consistency
from handtrack.kinematics import Model, forward, link_ends, pose_from_free
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.pills import Pills, clearance, pose_pills
from handtrack.profiles import place_outline
from handtrack.residuals import Chain, LineFeatures, OutlineFeatures, chain, line_residuals, outline_features
from handtrack.residuals import outline_residuals as outline
from handtrack.settings import Settings
from handtrack.shape_error import EPS, ShapeError, first_shape_error, learn_shape_error, shape_jacobian
from handtrack.tracker import begin, step
from synth.scene import images
from synth.scenes import two_finger_crossing

KINDS = ("orthographic", "perspective")
OWN = COMMON = math.sqrt(0.5)  # half of the variance is common to all links


@cache
def scene(kind: str) -> tuple[Chain, np.ndarray]:
    model = builtin_model("two_finger")
    R = np.array([[0.0, 1.0, 0.0], [0.0, 0.6, -0.8], [-1.0, 0.0, 0.0]])
    R = np.linalg.qr(R.T)[0].T
    R *= np.linalg.det(R)
    t = np.array([0.0, 0.0, 420.0])
    camera = (
        orthographic(640, 480, 3.0, 320.0, 240.0, R, t)
        if kind == "orthographic"
        else perspective(640, 480, 900.0, 900.0, 320.0, 240.0, R, t)
    )
    return chain(model, camera), np.array([0.1, 0.4, 0.3, -0.3, 0.5, 0.2])


@cache
def outline_of(kind: str) -> OutlineFeatures:
    """Points on the exact silhouette."""
    on, u = scene(kind)
    pills = pose_pills(on.model, forward(on.model, pose_from_free(on.model, u)), on.camera)
    samplers = place_outline(pills, on.camera, on.model.link_is_tip)
    sigma = np.linspace(0.1, 0.4, samplers.link.size)
    return outline_features(on.camera, samplers.origin, samplers.direction, samplers.link, sigma)


@cache
def lines_of(kind: str) -> LineFeatures:
    """The exact axial lines and tips."""
    on, u = scene(kind)
    base, tip = (project(on.camera, end) for end in link_ends(on.model, forward(on.model, pose_from_free(on.model, u))))
    heading = (tip - base) / np.linalg.norm(tip - base, axis=1, keepdims=True)
    normal = np.stack([-heading[:, 1], heading[:, 0]], axis=1)
    line = np.column_stack([normal, (normal * base).sum(axis=1)])
    links = np.arange(6)
    tips = np.flatnonzero(on.model.link_is_tip)
    sigma = np.linspace(0.2, 0.5, 12).reshape(6, 2)
    return LineFeatures(links, line, np.tile([0.2, 0.8], (6, 1)), sigma, tips, tip[tips], np.array([0.3, 0.4]))


def changed(model: Model, link: int | None, kind: str, h: float) -> Model:
    """The model with one link (or all) longer or thicker by the share h; the next links stay at its end."""
    which = np.arange(6) == link if link is not None else np.ones(6, dtype=bool)
    if kind == "radius":
        return replace(model, link_radius=model.link_radius * (1.0 + h * which)[:, None])
    prefix = model.prefix.copy()
    prefix[np.isin(model.parent, model.link_frame[which]), :3, 3] *= 1.0 + h
    longer = 1.0 + h * which
    tip = model.link_tip * longer[:, None]
    return replace(model, link_length=model.link_length * longer, link_tip=tip, prefix=prefix)


def derivative(on: Chain, residuals, features, u: np.ndarray, link: int | None, kind: str) -> np.ndarray:
    h = 1e-5
    ahead, behind = (
        residuals(replace(on, model=changed(on.model, link, kind, s * h)), features, u)[0] for s in (1, -1)
    )
    return (ahead - behind) / (2.0 * h)


@pytest.mark.parametrize("projection", KINDS)
@pytest.mark.parametrize(("kind", "first"), [("length", 0), ("radius", 7)])
def test_outline_derivatives_are_those_of_changed_models(projection, kind, first):
    (on, u), features = scene(projection), outline_of(projection)
    H = shape_jacobian(on, features, u)
    assert H.shape == (features.link.size, 7 + 7 + 6)
    for link in range(6):
        numeric = derivative(on, outline, features, u, link, kind)
        assert np.abs(numeric).max() > 1.0
        assert_allclose(H[:, first + link], OWN * numeric, atol=2e-4 * np.abs(numeric).max())
    numeric = derivative(on, outline, features, u, None, kind)
    assert_allclose(H[:, first + 6], COMMON * numeric, atol=2e-4 * np.abs(numeric).max())


@pytest.mark.parametrize("projection", KINDS)
def test_sideways_derivatives_are_those_of_pills_moved_across_by_their_radius(projection):
    (on, u), features = scene(projection), outline_of(projection)
    H = shape_jacobian(on, features, u)[:, 14:]
    base, tip = link_ends(on.model, forward(on.model, u))
    across = np.cross(tip - base, on.camera.R[2])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    h = 1e-5
    for link in range(6):
        found = []
        for s in (h, -h):
            shift = s * (np.arange(6) == link)[:, None] * across
            ends = [end + shift * on.model.link_radius[:, [column]] for column, end in enumerate((base, tip))]
            pills = Pills(ends[0], ends[1], on.model.link_radius)
            seen = clearance(pills, features.link, features.ray[:, :3], features.ray[:, 3:])
            spread = features.slope[:, :3] + seen.depth[:, None] * features.slope[:, 3:]
            found.append(seen.distance / np.abs((seen.normal * spread).sum(axis=1)) / features.sigma)
        numeric = (found[0] - found[1]) / (2.0 * h)
        assert_allclose(H[:, link], numeric, atol=2e-4 * np.abs(numeric).max())


@pytest.mark.parametrize("projection", KINDS)
def test_line_derivatives_are_those_of_changed_models(projection):
    (on, u), features = scene(projection), lines_of(projection)
    H = shape_jacobian(on, features, u)
    assert H.shape == (2 * 2 + 2 * 6, 7)
    assert_allclose(line_residuals(on, features, u)[0], 0.0, atol=1e-9)
    for link in (*range(6), None):
        numeric = derivative(on, line_residuals, features, u, link, "length")
        share, column = (OWN, link) if link is not None else (COMMON, 6)
        assert_allclose(H[:, column], share * numeric, atol=1e-6 * max(1.0, np.abs(numeric).max()))


def test_no_edge_at_all_has_no_derivative():
    on, u = scene("orthographic")
    none = OutlineFeatures(np.zeros((0, 6)), np.zeros((0, 6)), np.zeros(0, dtype=np.int64), np.zeros(0))
    assert shape_jacobian(on, none, u).shape == (0, 20)


def simulated(eps: float, frames: int = 60, seed: int = 0, noise: float = 1.0) -> tuple[ShapeError, np.ndarray, list]:
    """Evidence from linear frames of one hand with shape errors of standard deviation eps; its error, suggestions."""
    rng = np.random.default_rng(seed)
    wrong, shape, suggested = eps * rng.normal(size=14), first_shape_error(), []
    for _ in range(frames):
        J, H = 60.0 * rng.normal(size=(90, 6)), 100.0 * rng.normal(size=(90, 14))
        covariance = np.linalg.inv(J.T @ J)
        r = noise * rng.normal(size=90) - H @ wrong
        r = r - J @ (covariance @ (J.T @ r))
        shape, tip = learn_shape_error(shape, r, H, J, covariance)
        suggested.append(tip)
    return shape, wrong, suggested


def test_clean_residuals_leave_the_shape_error_near_zero():
    for seed in range(4):
        assert simulated(0.0, seed=seed)[0].eps < 0.001


@pytest.mark.parametrize("eps", [0.004, 0.01, 0.03, 0.1])
def test_a_simulated_shape_error_is_found(eps):
    found = [simulated(eps, seed=seed)[0].eps for seed in range(6)]
    wrong = [np.sqrt(np.mean(simulated(eps, frames=1, seed=seed)[1] ** 2)) for seed in range(6)]
    assert np.median(np.divide(found, wrong)) == pytest.approx(1.0, abs=0.35)


def test_errors_beyond_the_grid_are_held_at_its_end():
    assert simulated(2.0)[0].eps == pytest.approx(EPS[-1], rel=1e-6)


def test_the_suggestion_is_the_shape_error():
    shape, wrong, suggested = simulated(0.03)
    assert shape.eps > 0.0
    assert_allclose(np.mean(suggested[-20:], axis=0), wrong, atol=0.004)


def test_what_the_pose_can_explain_is_no_evidence():
    rng = np.random.default_rng(1)
    J = 60.0 * rng.normal(size=(40, 5))
    covariance = np.linalg.inv(J.T @ J)
    H = J @ rng.normal(size=(5, 3))  # a shape that looks like a pose
    shape, suggested = learn_shape_error(first_shape_error(), J @ rng.normal(size=5), H, J, covariance)
    assert_allclose(shape.evidence, 0.95 * first_shape_error().evidence, atol=1e-6)
    assert_allclose(suggested, 0.0, atol=1e-6)


def test_old_evidence_fades():
    strong = ShapeError(np.where(EPS == 0.07, 0.0, -40.0), 0.07)
    rng = np.random.default_rng(2)
    found = [strong]
    for _ in range(80):
        H = 100.0 * rng.normal(size=(60, 8))
        found.append(learn_shape_error(found[-1], rng.normal(size=60), H, np.zeros((60, 1)), np.ones((1, 1)))[0])
    assert found[-1].eps < 0.001 < 0.06 < found[0].eps


def test_before_any_frame_a_well_measured_model_is_supposed():
    start = first_shape_error()
    assert start.eps == 0.002 and start.evidence.argmax() == 0
    known = first_consistency(4)
    assert known.shape_covariance.shape == (4, 4) and not known.shape_covariance.any() and known.frames == 0


def consistency_after(radius: float, frames: int):
    """What the tracker has learnt of its model after some frames."""
    made = two_finger_crossing(2, frames=frames, size=(320, 240), scale=1.6)
    model = replace(made.model, link_radius=radius * made.model.link_radius)
    on = (chain(model, made.camera),)
    state, history = begin(on, made.start, 25.0, Settings()), []
    for number, image in enumerate(images(made)):
        state, _ = step(state, (image,), on, 0.04 if number else 0.0, Settings())
        history.append(state.consistency)
    return history


def test_the_tracker_learns_which_model_is_wrong():
    right, wrong = consistency_after(1.0, 10)[-1], consistency_after(1.04, 10)[-1]
    assert right.shape.eps < 0.003 < 0.006 < wrong.shape.eps
    assert np.trace(wrong.shape_covariance) > 9.0 * np.trace(right.shape_covariance)
    assert (np.linalg.eigvalsh(wrong.shape_covariance) > -1e-15).all()


def test_a_settled_tracker_looks_at_every_fourth_frame():
    history = consistency_after(1.0, 18)
    assert [known.frames for known in history] == list(range(1, 19))
    learnt = [one.scatter is not two.scatter for one, two in pairwise(history)]
    assert learnt == [number < 12 or number % 4 == 0 for number in range(1, 18)]
