"""Residuals: zero on exact silhouettes, Jacobians against differences, equations (3.1) and (3.2) by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.camera import Camera, orthographic, perspective, project
from handtrack.kinematics import Coupling, FrameRow, Model, forward, link_ends, model_from_rows, pose_from_free
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.pills import pose_pills
from handtrack.profiles import Samplers, place_outline
from handtrack.residuals import (
    Chain,
    LineFeatures,
    Robust,
    WithPrior,
    chain,
    line_residuals,
    outline_features,
    outline_residuals,
    outline_residuals_numpy,
    rows,
    soften_numpy,
)
from handtrack.robust import CAUCHY_C, cauchy_weight

BENT = np.array([0.12, -0.15, 0.002, -0.003, 0.04])


def sliding_finger() -> Model:
    """Tapered links on a slide and three joints, the last of which follows the one before."""
    table = [
        FrameRow(1, 0, joint="slide", prismatic=True),
        FrameRow(2, 1, 1.3, 5.0, 2.0, 0.2, joint="mcp", link_length=46.0, link_radius=(11.0, 9.0)),
        FrameRow(3, 2, 0.1, 46.0, joint="pip", link_length=27.0, link_radius=(9.0, 8.5)),
        FrameRow(4, 3, -0.1, 27.0, joint="dip", link_length=20.0, link_radius=(8.5, 7.0)),
    ]
    return model_from_rows("sliding", table, [Coupling("dip", "pip", 0.67, 0.1)])


MODELS = {
    "two_finger": builtin_model("two_finger"),
    "full_hand": builtin_model("full_hand"),
    "sliding": sliding_finger(),
}


def camera_of(kind: str) -> Camera:
    R = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    R *= np.linalg.det(R)
    t = np.array([0.0, 0.0, 420.0]) - R @ [0.0, 60.0, 0.0]
    if kind == "orthographic":
        return orthographic(640, 480, 2.0, 320.0, 240.0, R, t)
    return perspective(640, 480, 800.0, 830.0, 320.0, 240.0, R, t, BENT if kind == "distorted" else None)


KINDS = ("orthographic", "perspective", "distorted")
every = pytest.mark.parametrize(("name", "kind"), [(name, kind) for name in MODELS for kind in KINDS])


def scene(name: str, kind: str, seed: int = 0) -> tuple[Chain, np.ndarray, Samplers]:
    """A model seen by a camera, a random pose, and samplers on its outline there."""
    model, camera = MODELS[name], camera_of(kind)
    low, high = np.clip(model.limits[model.free], -0.8, 0.8).T
    u = np.random.default_rng(seed).uniform(low, high)
    pills = pose_pills(model, forward(model, pose_from_free(model, u)), camera)
    return chain(model, camera), u, place_outline(pills, camera, model.link_is_tip)


def features_at(on: Chain, samplers: Samplers, offset: float | np.ndarray, sigma: float = 0.5):
    xy = samplers.origin + np.multiply(offset, np.ones(samplers.link.size))[:, None] * samplers.direction
    return outline_features(on.camera, xy, samplers.direction, samplers.link, np.full(samplers.link.size, sigma))


def differences(residual, u: np.ndarray, h: float = 1e-4) -> np.ndarray:
    """Jacobian by central differences of fourth order."""
    columns = []
    for step in h * np.eye(u.size):
        near, far = (residual(u + n * step)[0] - residual(u - n * step)[0] for n in (1, 2))
        columns.append((8 * near - far) / (12 * h))
    return np.stack(columns, axis=1)


@every
def test_points_on_the_exact_silhouette_leave_no_residual(name, kind):
    for seed in range(3):
        on, u, samplers = scene(name, kind, seed)
        r, _ = outline_residuals(on, features_at(on, samplers, 0.0), u)
        np.testing.assert_allclose(r, 0.0, atol=1e-7)


@every
def test_residual_is_the_distance_in_pixels_over_sigma_positive_outside(name, kind):
    on, u, samplers = scene(name, kind)
    for offset in (-1.0, 0.3, 2.0):
        r, _ = outline_residuals(on, features_at(on, samplers, offset, sigma=0.25), u)
        np.testing.assert_allclose(0.25 * r, offset, rtol=0.04)


@every
def test_outline_jacobian_equals_differences_on_the_silhouette(name, kind):
    for seed in range(3):
        on, u, samplers = scene(name, kind, seed)
        features = features_at(on, samplers, 0.0)
        _, J = outline_residuals(on, features, u)
        assert J.shape == (samplers.link.size, on.model.free.size)
        # Short steps: where the touching sphere reaches an end of the axis, the second derivative jumps.
        numeric = differences(lambda v, on=on, features=features: outline_residuals(on, features, v), u, 2e-6)
        np.testing.assert_allclose(J, numeric, atol=1e-5 * np.abs(J).max())


@every
def test_outline_jacobian_stays_good_a_few_pixels_off(name, kind):
    on, u, samplers = scene(name, kind, 1)
    features = features_at(on, samplers, np.random.default_rng(0).uniform(-3, 3, samplers.link.size))
    _, J = outline_residuals(on, features, u)
    numeric = differences(lambda v: outline_residuals(on, features, v), u)
    assert np.abs(J - numeric).max() < 0.04 * np.abs(J).max()


@every
def test_kernel_and_numpy_twin_of_the_outline_agree(name, kind):
    for seed in range(3):
        on, u, samplers = scene(name, kind, seed)
        offset = np.random.default_rng(seed).normal(0, 8, samplers.link.size)
        features = features_at(on, samplers, offset)
        away = u + np.random.default_rng(seed).normal(0, 0.1, u.size)
        for one, two in zip(
            outline_residuals(on, features, away), outline_residuals_numpy(on, features, away), strict=True
        ):
            np.testing.assert_allclose(one, two, rtol=1e-7, atol=1e-7)


def test_coupled_joints_share_one_column():
    on, u, samplers = scene("sliding", "perspective")
    _, J = outline_residuals(on, features_at(on, samplers, 0.0), u)
    assert J.shape[1] == 3
    free = model_from_rows("free", [FrameRow(1, 0, joint="a")])
    assert chain(free, on.camera).plain and not on.plain
    last = samplers.link == 2  # the last link moves with slide, mcp, and pip + 0.67 dip
    assert (np.abs(J[last]).max(axis=0) > 0.01).all()


def test_joints_of_other_fingers_do_not_move_an_edge():
    on, u, samplers = scene("two_finger", "perspective")
    _, J = outline_residuals(on, features_at(on, samplers, 1.0), u)
    np.testing.assert_array_equal(J[samplers.link < 3, 3:], 0.0)
    np.testing.assert_array_equal(J[samplers.link == 3, 4:], 0.0)
    assert (np.abs(J[samplers.link == 5, 3:]).max(axis=0) > 0).all()


STICKS = builtin_model("rr")  # two links of length 5 in the plane z = 0
FLAT = orthographic(100, 100, 1.0, 0.0, 0.0, np.eye(3), np.array([0.0, 0.0, 50.0]))


def line_features(**given_) -> LineFeatures:
    none = {
        "line_link": np.zeros(0, dtype=int),
        "line": np.zeros((0, 3)),
        "along": np.zeros((0, 2)),
        "line_sigma": np.zeros((0, 2)),
        "tip_link": np.zeros(0, dtype=int),
        "tip": np.zeros((0, 2)),
        "tip_sigma": np.zeros(0),
    }
    return LineFeatures(**(none | given_))


def test_tip_residual_is_predicted_less_measured_tip():
    # Elbow at (5, 0), tip at (5, 5): eq. (3.1) by hand, and (3.8): a turn by dq moves the tip by z x (p - o).
    features = line_features(tip_link=np.array([1]), tip=np.array([[4.0, 7.0]]), tip_sigma=np.array([2.0]))
    r, J = line_residuals(chain(STICKS, FLAT), features, np.array([0.0, math.pi / 2]))
    np.testing.assert_allclose(r, [0.5, -1.0], atol=1e-12)
    np.testing.assert_allclose(J, [[-2.5, -2.5], [2.5, 0.0]], atol=1e-12)


def test_link_residual_is_the_distance_of_axis_points_from_the_line():
    # Second link upright from (5, 0): points at a quarter and the end of it are (5, 1.25) and (5, 5).
    # Line 0.6 x + 0.8 y = 3: eq. (3.2) by hand gives 1.0 and 4.0; (3.7) for the gradient.
    features = line_features(
        line_link=np.array([1]),
        line=np.array([[0.6, 0.8, 3.0]]),
        along=np.array([[0.25, 1.0]]),
        line_sigma=np.array([[1.0, 0.5]]),
    )
    r, J = line_residuals(chain(STICKS, FLAT), features, np.array([0.0, math.pi / 2]))
    np.testing.assert_allclose(r, [1.0, 8.0], atol=1e-12)
    np.testing.assert_allclose(
        J, [[0.8 * 5 - 0.6 * 1.25, -0.6 * 1.25], [2 * (0.8 * 5 - 0.6 * 5), -2 * 0.6 * 5]], atol=1e-12
    )


def random_lines(on: Chain, rng: np.random.Generator) -> LineFeatures:
    links = on.model.link_frame.size
    angle = rng.uniform(0, 7, links)
    tips = np.flatnonzero(on.model.link_is_tip)
    return LineFeatures(
        np.arange(links),
        np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(-300, 300, links)]),
        rng.uniform(0, 1, (links, 2)),
        rng.uniform(0.2, 2, (links, 2)),
        tips,
        rng.uniform(0, 400, (tips.size, 2)),
        rng.uniform(0.2, 2, tips.size),
    )


@every
def test_line_jacobian_equals_differences(name, kind):
    on, u, _ = scene(name, kind)
    features = random_lines(on, np.random.default_rng(0))
    r, J = line_residuals(on, features, u)
    assert r.size == 2 * features.tip_link.size + 2 * features.line_link.size
    numeric = differences(lambda v: line_residuals(on, features, v), u)
    np.testing.assert_allclose(J, numeric, atol=1e-7 * np.abs(J).max())


@pytest.mark.parametrize("kind", KINDS[:2])
def test_lines_through_the_projected_axes_leave_no_residual(kind):
    on, u, _ = scene("full_hand", kind)
    base, tip = (project(on.camera, end) for end in link_ends(on.model, forward(on.model, u)))
    normal = np.stack([base[:, 1] - tip[:, 1], tip[:, 0] - base[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    features = random_lines(on, np.random.default_rng(1))
    line = np.column_stack([normal, (normal * base).sum(axis=1)])
    tips = on.model.link_is_tip
    features = LineFeatures(
        features.line_link, line, features.along, features.line_sigma, features.tip_link, tip[tips], features.tip_sigma
    )
    np.testing.assert_allclose(line_residuals(on, features, u)[0], 0.0, atol=1e-9)


def linear(seed: int, scale: float = 3.0):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(0, scale, (12, 3)), rng.normal(0, scale, 12)
    return lambda u: (A @ u - b, A)


@given(st.integers(0, 50), st.floats(0.2, 20.0), st.lists(st.floats(-3, 3), min_size=3, max_size=3))
@settings(max_examples=40, deadline=None)
def test_half_the_sum_of_squares_of_softened_residuals_is_cauchys_loss(seed, scale, u):
    residual, at = linear(seed), np.array(u)
    r, J = residual(at)
    soft, J_soft = Robust(residual, scale)(at)
    z = r / scale
    loss = 0.5 * CAUCHY_C**2 * np.log1p((z / CAUCHY_C) ** 2)
    np.testing.assert_allclose(0.5 * soft**2, loss, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(np.sign(soft), np.sign(r))
    # Its gradient is that of least squares with Cauchy's weights.
    np.testing.assert_allclose(J_soft.T @ soft, J.T @ (cauchy_weight(z) * r) / scale**2, rtol=1e-7, atol=1e-9)
    for one, two in zip((soft, J_soft), soften_numpy(r, J, scale), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("size", [1e-12, 1e-7, 1e-6, 1.1e-6, 1e-5, 1e-3, 1.0, 50.0, 1e6])
def test_softened_jacobian_equals_differences_at_any_size(size):
    A = np.array([[1.0], [-2.0]])

    def residual(u):
        return size * (A @ u), size * A

    at = np.array([1.0])
    _, J = Robust(residual)(at)
    np.testing.assert_allclose(J, differences(Robust(residual), at, 1e-3), rtol=1e-6)


def test_softening_leaves_small_residuals_and_the_originals_alone():
    residual = linear(0, 1e-4)
    u = np.array([0.1, -0.2, 0.3])
    r, J = residual(u)
    kept = r.copy(), J.copy()
    soft, J_soft = Robust(residual)(u)
    np.testing.assert_allclose(soft, r, rtol=1e-6)
    np.testing.assert_allclose(J_soft, J, rtol=1e-6)
    np.testing.assert_array_equal(r, kept[0])
    np.testing.assert_array_equal(residual(u)[1], kept[1])
    assert soften_numpy(np.zeros(1), np.ones((1, 1)), 2.0)[1].tolist() == [[0.5]]


def test_a_prior_adds_its_mahalanobis_distance():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(3, 3))
    residual, mean, u = linear(3), rng.normal(size=3), rng.normal(size=3)
    r, J = WithPrior(residual, mean, root)(u)
    information = root.T @ root
    plain = residual(u)[0]
    assert r @ r == pytest.approx(plain @ plain + (u - mean) @ information @ (u - mean))
    np.testing.assert_allclose(J.T @ J, residual(u)[1].T @ residual(u)[1] + information)
    np.testing.assert_array_equal(WithPrior(residual, mean, root)(mean)[0][-3:], 0.0)


def test_one_side_of_a_link_is_one_group_of_outline_rows():
    on, u, samplers = scene("two_finger", "orthographic")
    features = features_at(on, samplers, 0.5)
    found = rows(on, features, samplers.side)
    np.testing.assert_array_equal(found.sigma, features.sigma)
    names = {(link, side): group for link, side, group in zip(samplers.link, samplers.side, found.group, strict=True)}
    assert len(set(names.values())) == len(names) == 6 * 2 + 2
    np.testing.assert_array_equal([names[key] for key in zip(samplers.link, samplers.side, strict=True)], found.group)
    for one, two in zip(found.residual(u), outline_residuals(on, features, u), strict=True):
        np.testing.assert_array_equal(one, two)


def test_each_tip_and_each_line_is_one_group_of_line_rows():
    on, u, _ = scene("two_finger", "orthographic")
    features = random_lines(on, np.random.default_rng(4))
    found = rows(on, features)
    r, _ = found.residual(u)
    assert found.sigma.shape == found.group.shape == r.shape
    np.testing.assert_array_equal(found.sigma[:4], np.repeat(features.tip_sigma, 2))
    pairs = found.group.reshape(-1, 2)
    np.testing.assert_array_equal(pairs[:, 0], pairs[:, 1])
    assert np.unique(pairs[:, 0]).size == 8
