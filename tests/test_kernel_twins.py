"""Compiled stages of the hand loop against their plain twins, in both projections, with distortion and without."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handtrack import _kernels
from handtrack.appearance import (
    Appearance,
    design_numpy,
    harmonics,
    learn,
    light_numpy,
    noise_numpy,
    pixel_noise,
    surface_samples,
    surface_samples_numpy,
)
from handtrack.camera import Camera, orthographic, perspective, project_camera
from handtrack.edges import find_edges
from handtrack.edges.wssd import find_edges_numpy
from handtrack.folds import _screen, least_turn, screen_numpy
from handtrack.kinematics import Model, link_ends
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.measure import _predicted_spread, posed, posed_numpy, posed_with_frames, predicted_spread_numpy
from handtrack.pills import Pills
from handtrack.profiles import place_outline, sample, side_counts
from handtrack.residuals import (
    Chain,
    OutlineFeatures,
    chain,
    outline_residuals,
    turned_rays,
    turned_rays_numpy,
)
from handtrack.scatter import moments_numpy
from handtrack.shading_cost import read_patches, read_patches_numpy
from handtrack.shape_error import shape_jacobian, shape_jacobian_numpy
from handtrack.templates import depth_step_numpy, expect, positions
from synth.render import render
from synth.scene import LIGHT, skin

TILTED = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
CAMERAS = {
    "orthographic": orthographic(320, 240, 1.6, 80.0, 120.0, TILTED, np.array([3.0, -2.0, 100.0])),
    "perspective": perspective(320, 240, 500.0, 480.0, 60.0, 120.0, TILTED, np.array([-40.0, 5.0, 300.0])),
    "distorted": perspective(
        320, 240, 500.0, 480.0, 60.0, 120.0, TILTED, np.array([-40.0, 5.0, 300.0]), np.array([-0.1, 0.05, 1e-3, 0, 0])
    ),
}
MODELS = ("two_finger", "full_hand", "coupled")


def built(name: str) -> Model:
    if name != "coupled":
        return builtin_model(name)
    return builtin_model("full_hand_coupled")


def in_the_middle(camera: Camera, pills: Pills) -> Camera:
    """The camera with its image moved so that the pills fill it, but for one end."""
    xy = project_camera(camera, np.concatenate([pills.base, pills.tip]))
    low, high = xy.min(axis=0), xy.max(axis=0)
    zoom = float((np.array([300.0, 230.0]) / (high - low)).min())
    cx, cy = np.array([160.0, 120.0]) - zoom * (0.5 * (low + high) - [camera.cx, camera.cy])
    fx, fy = camera.fx * zoom, camera.fy * zoom
    return replace(camera, cx=float(cx), cy=float(cy), fx=fx, fy=fy)


class Scene:
    """A posed model before a camera, its image, and what was learnt from it."""

    def __init__(self, name: str, kind: str, seed: int = 0):
        self.model, self.rng = built(name), np.random.default_rng(seed)
        self.u = self.rng.uniform(0.0, 0.35, self.model.free.size)
        self.camera = in_the_middle(CAMERAS[kind], posed(chain(self.model, CAMERAS[kind]), self.u))
        self.on: Chain = chain(self.model, self.camera)
        self.pills: Pills = posed(self.on, self.u)
        clean = render(self.pills, self.camera, skin(self.model), LIGHT)
        self.image = np.clip(clean + self.rng.normal(0.0, 2.0, clean.shape), 0, 255).astype(np.float32)
        self.look: Appearance = learn(self.image, self.pills, self.camera)


@pytest.fixture(scope="module", params=[(m, c) for m in MODELS for c in CAMERAS], ids="-".join)
def scene(request) -> Scene:
    return Scene(*request.param)


def test_posed_links_are_those_of_the_frames_step_by_step(scene):
    twin = posed_numpy(scene.on, scene.u)
    np.testing.assert_allclose(scene.pills.base, twin.base, atol=1e-9)
    np.testing.assert_allclose(scene.pills.tip, twin.tip, atol=1e-9)
    frames, _ = posed_with_frames(scene.on, scene.u)
    base, _ = link_ends(scene.model, frames[0])
    np.testing.assert_allclose(base @ scene.camera.R.T + scene.camera.t, twin.base, atol=1e-9)


def test_sides_get_as_many_samplers_as_their_length_in_the_image_asks_for(scene):
    camera = scene.camera
    intrinsic = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    behind = replace(scene.pills, base=scene.pills.base * [1, 1, -1])
    for pills in (scene.pills, behind):
        counts = _kernels.count_samplers(
            pills.base, pills.tip, camera.kind == "orthographic", intrinsic, camera.distortion, 7.0, 5
        )
        np.testing.assert_array_equal(counts, side_counts(pills, camera, 7.0, 5))


def test_predicted_spreads_and_depth_steps_equal_their_twins(scene):
    samplers = place_outline(scene.pills, scene.camera, scene.model.link_is_tip)
    root = scene.rng.normal(0.0, 0.02, (scene.u.size, scene.u.size))
    frames, _ = posed_with_frames(scene.on, scene.u)
    ours = _predicted_spread(scene.on, samplers, frames, root @ root.T)
    np.testing.assert_allclose(ours, predicted_spread_numpy(scene.on, samplers, scene.u, root @ root.T), atol=1e-9)
    focal = 0.5 * (scene.camera.fx + scene.camera.fy)
    steps = _kernels.depth_steps(
        scene.pills.radius, samplers.link, samplers.contact, focal, scene.camera.kind == "orthographic"
    )
    np.testing.assert_allclose(steps, depth_step_numpy(samplers, scene.pills, scene.camera), rtol=1e-12)


def test_edge_rays_turn_into_world_axes_like_their_twin(scene):
    samplers = place_outline(scene.pills, scene.camera, scene.model.link_is_tip)
    n = samplers.link.size
    found, offset = scene.rng.random(n) < 0.7, scene.rng.normal(0.0, 3.0, n)
    given = scene.camera, samplers.ray, samplers.slope, offset, found, samplers.link, 0.1 + scene.rng.random(n)
    ours, twin = turned_rays(*given), turned_rays_numpy(*given)
    np.testing.assert_allclose(ours.ray, twin.ray, atol=1e-10)
    np.testing.assert_allclose(ours.slope, twin.slope, atol=1e-12)
    np.testing.assert_array_equal(ours.link, twin.link)
    np.testing.assert_array_equal(ours.sigma, twin.sigma)


def test_edges_have_the_places_sigmas_and_reasons_of_their_twin(scene):
    samplers = place_outline(scene.pills, scene.camera, scene.model.link_is_tip)
    off = posed(scene.on, scene.u + scene.rng.normal(0.0, 0.02, scene.u.size))
    templates = expect(samplers, off, scene.model.link_finger, scene.camera, scene.look, 10.0, 5.0)
    profiles = sample(scene.image, samplers, positions(16.0, 11.0, 0.5))
    reach = scene.rng.uniform(2.5, 5.9, samplers.link.size)
    given = samplers, templates, profiles, reach, 0.4 * reach, scene.look.noise, scene.look.spread
    ours, twin = find_edges(*given), find_edges_numpy(*given)
    np.testing.assert_array_equal(ours.reason, twin.reason)
    assert np.unique(ours.reason).size >= 3
    np.testing.assert_allclose(ours.offset, twin.offset, atol=1e-7)
    np.testing.assert_allclose(ours.sigma, twin.sigma, rtol=1e-6)
    np.testing.assert_allclose(ours.misfit, twin.misfit, rtol=1e-6)


def test_links_to_fold_are_those_of_the_twin(scene):
    root = scene.rng.normal(0.0, 0.1, (scene.u.size, scene.u.size))
    frames, pills = posed_with_frames(scene.on, scene.u)
    allowed = scene.rng.random(pills.base.shape[0]) < 0.8
    given = scene.on, frames[0], pills.base, pills.tip, allowed, root @ root.T
    ours, twin = _screen(*given), screen_numpy(*given)
    np.testing.assert_array_equal(ours[1], twin[1])
    for a, b in ((ours[0], twin[0]), (ours[2], twin[2]), (ours[3], twin[3])):
        np.testing.assert_allclose(a[allowed], b[allowed], atol=1e-10)


@pytest.mark.parametrize("kind", CAMERAS)
def test_links_near_the_image_plane_are_chosen_like_the_twin_does(kind):
    model, rng = builtin_model("full_hand"), np.random.default_rng(1)
    flat = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    on = chain(model, replace(CAMERAS[kind], R=flat))
    chosen = np.zeros(model.link_frame.size, dtype=int)
    for _ in range(20):
        u = rng.uniform(-0.1, 0.3, model.free.size)
        frames, pills = posed_with_frames(on, u)
        given = on, frames[0], pills.base, pills.tip, chosen >= 0, 0.03 * np.eye(u.size)
        ours, twin = _screen(*given), screen_numpy(*given)
        np.testing.assert_array_equal(ours[1], twin[1])
        chosen += ours[1]
    assert chosen.any() and (chosen < 20).any()


@given(st.lists(st.floats(-2.0, 2.0), min_size=2, max_size=10), st.floats(-1.0, 1.0))
def test_the_least_turn_is_that_of_the_pseudoinverse(numbers, angle):
    rows = np.array(numbers[: 2 * (len(numbers) // 2)]).reshape(2, -1)
    size = np.linalg.svd(rows, compute_uv=False)
    if size[0] < 1e-3 or abs(size.min() / size[0] - 0.05) < 1e-6:
        return  # nothing to turn, or at the very edge of what counts
    wanted = np.linalg.pinv(rows, rcond=0.05) @ [angle, 0.0]
    np.testing.assert_allclose(least_turn(rows[0], rows[1], angle), wanted, atol=1e-6 / size[0])


def test_no_joint_turns_what_no_joint_moves():
    assert least_turn(np.zeros(3), np.zeros(3), 0.3).tolist() == [0.0, 0.0, 0.0]


def test_surface_points_with_levels_and_rays_equal_their_twin(scene):
    behind = replace(scene.pills, base=np.vstack([-scene.pills.base[:1], scene.pills.base[1:]]))
    for pills in (scene.pills, behind):
        given = scene.image, pills, scene.camera, 0.7
        for ours, twin in zip(surface_samples(*given), surface_samples_numpy(*given), strict=True):
            np.testing.assert_allclose(ours, twin, atol=1e-8)


def test_noise_is_that_of_the_twin_with_many_points_on_the_surface_and_with_few(scene):
    points, *_ = surface_samples(scene.image, scene.pills, scene.camera, 0.5)
    for share in (0.8, 0.01):
        on = scene.rng.random(points.shape[0]) < share
        ours, twin = pixel_noise(scene.image, points, on), noise_numpy(scene.image, points, on)
        np.testing.assert_allclose(ours, twin, rtol=1e-6)
    assert pixel_noise(scene.image, points[:5], np.ones(5, dtype=bool)) == 1.0


def test_the_light_and_the_rows_of_the_shading_equal_their_twins():
    rng = np.random.default_rng(3)
    normal = rng.normal(size=(200, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    light, weight = np.array([0.6, 0.0, -0.8]), rng.random(200) * (rng.random(200) < 0.8)
    target = 30.0 + 150.0 * np.maximum(normal @ light, 0.0) + rng.normal(0.0, 2.0, 200)
    start = np.array([0.0, 0.0, -1.0])
    ours = _kernels.find_light(normal, target, weight, start, 4)
    np.testing.assert_allclose(ours, light_numpy(normal, target, weight, start, 4), atol=1e-9)
    assert ours @ light > 0.999
    nothing = np.zeros(200)
    np.testing.assert_array_equal(_kernels.find_light(normal, nothing, weight, light, 1), start)
    link, gain, basis = rng.integers(0, 3, 200), np.array([0.9, 1.0, 1.2]), harmonics(normal)
    lit, design = np.empty(200), np.empty((200, 26))
    _kernels.fill_shading(basis, normal, light, gain, link, np.sqrt(weight), lit, design)
    np.testing.assert_allclose(design, design_numpy(basis, normal, light, gain[link] * np.sqrt(weight)), atol=1e-12)
    np.testing.assert_allclose(lit, np.maximum(normal @ light, 0.0))


def test_readings_of_the_surface_equal_their_twin(scene):
    wanted = scene.rng.random(scene.pills.base.shape[0]) < 0.8
    given = scene.image, scene.pills, scene.camera, scene.look, wanted
    ours, twin = read_patches(*given), read_patches_numpy(*given)
    np.testing.assert_array_equal(ours[..., 0], twin[..., 0])
    np.testing.assert_allclose(ours, twin, atol=1e-7)
    assert ours[wanted, :, 0].sum() > 20 and not ours[~wanted].any()


def edge_features(scene: Scene) -> OutlineFeatures:
    samplers = place_outline(scene.pills, scene.camera, scene.model.link_is_tip)
    n = samplers.link.size
    found, sigma = scene.rng.random(n) < 0.7, scene.rng.uniform(0.05, 0.6, n)
    return turned_rays(scene.camera, samplers.ray, samplers.slope, sigma, found, samplers.link, sigma)


def test_what_the_shape_does_to_outlines_equals_the_twin(scene):
    features = edge_features(scene)
    ours = shape_jacobian(scene.on, features, scene.u)
    np.testing.assert_allclose(ours, shape_jacobian_numpy(scene.on, features, scene.u), atol=1e-9)


def test_moments_of_the_scatter_equal_their_twin(scene):
    features = edge_features(scene)
    r, J = outline_residuals(scene.on, features, scene.u)
    w = 1.0 / features.sigma**2
    r, J = r * features.sigma, J * features.sigma[:, None]
    gain = np.linalg.solve((J * w[:, None]).T @ J + 1e3 * np.eye(J.shape[1]), (J * w[:, None]).T)
    member = np.unique(features.link, return_inverse=True)[1]
    given = r, J, w, member, int(member.max()) + 1, gain
    for ours, twin in zip(_kernels.scatter_moments(*given), moments_numpy(*given), strict=True):
        np.testing.assert_allclose(ours, twin, rtol=1e-7)
