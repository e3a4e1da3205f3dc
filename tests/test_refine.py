"""Claims about pixels of the visible surface and the solve that aligns edges and pixels together."""

from dataclasses import replace

import numpy as np
import pytest

from handtrack.appearance import learn
from handtrack.camera import camera_from_world
from handtrack.kinematics import forward, link_ends
from handtrack.measure import posed
from handtrack.pills import ray_hits
from handtrack.pixels import pixel_rows, pixel_rows_numpy, surface_pixels
from handtrack.refine import _light, _patch_scatter
from handtrack.residuals import chain
from handtrack.settings import Settings
from handtrack.tracker import track
from synth.scenes import image, images, two_finger_crossing

SCENES = {
    kind: two_finger_crossing(3, frames=12, projection=kind, size=(320, 240), scale=1.6)
    for kind in ("orthographic", "perspective")
}


def seen(kind):
    scene = SCENES[kind]
    on = chain(scene.model, scene.camera)
    u = scene.truth[0][scene.model.free]
    picture = image(scene, 0).astype(np.float32)
    appearance = learn(picture, posed(on, u), on.camera)
    return on, u, appearance, surface_pixels(picture, on, posed(on, u), 0.5, 400)


@pytest.mark.parametrize("kind", SCENES)
def test_compiled_rows_are_those_of_finite_differences(kind):
    on, u, appearance, pixels = seen(kind)
    moved = u + np.radians(0.3)
    compiled, plain = (rows(on, pixels, appearance, moved) for rows in (pixel_rows, pixel_rows_numpy))
    np.testing.assert_allclose(compiled.r, plain.r, atol=1e-8)
    np.testing.assert_allclose(compiled.normal, plain.normal, atol=1e-10)
    np.testing.assert_allclose(compiled.expected, plain.expected, atol=1e-8)
    off = np.abs(compiled.J - plain.J) / np.abs(plain.J).max()
    assert np.quantile(off, 0.99) < 1e-6  # a pixel on the seam of cap and side bends within the difference


@pytest.mark.parametrize("kind", SCENES)
def test_pixels_lie_well_inside_the_surface_of_their_link(kind):
    on, u, _, pixels = seen(kind)
    base, tip = (camera_from_world(on.camera, end) for end in link_ends(on.model, forward(on.model, u)))
    origin = camera_from_world(on.camera, pixels.ray[:, :3])
    direction = pixels.ray[:, 3:] @ on.camera.R.T
    hits = ray_hits(replace(posed(on, u), base=base, tip=tip), origin, direction)
    assert pixels.link.size > 100
    np.testing.assert_array_equal(hits.pill, pixels.link)
    assert (np.abs((hits.normal * direction).sum(axis=1)) / np.linalg.norm(direction, axis=1)).min() > 0.25


def test_a_picture_without_the_hand_has_no_pixels():
    on, u, _, _ = seen("orthographic")
    assert surface_pixels(np.zeros((240, 320), np.float32), on, posed(on, u), 0.5).link.size == 0


def test_light_and_gains_are_eliminated():
    """A grey level that only says the light is other than learnt says next to nothing of the pose."""
    on, u, appearance, pixels = seen("orthographic")
    light = _light(on, pixels, appearance, u)
    brighter = replace(pixels, level=1.02 * pixels.level)
    change = pixel_rows(on, brighter, appearance, u).r - pixel_rows(on, pixels, appearance, u).r
    white, _ = light.white(light.weight * change, np.zeros((change.size, 1)))
    left = white - light.basis @ (light.basis.T @ white)
    assert np.linalg.norm(left) < 0.25 * np.linalg.norm(white)


def test_a_common_error_of_patches_is_told_from_noise():
    *_, pixels = seen("orthographic")
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, 1.5, pixels.link.size)
    s, tau = _patch_scatter(noise, pixels, 0)
    assert s == pytest.approx(1.5, rel=0.15) and tau < 0.4
    common = rng.normal(0.0, 3.0, pixels.patch.max() + 1)[pixels.patch]
    s, tau = _patch_scatter(noise + common, pixels, 0)
    assert s == pytest.approx(1.5, rel=0.3) and 1.8 < tau < 4.5


@pytest.mark.parametrize("kind", SCENES)
def test_refinement_is_nearer_to_the_truth_and_surer(kind):
    scene = SCENES[kind]
    pictures = list(images(scene))
    errors, sigmas = [], []
    for refine in (False, True):
        found = track(pictures, scene.model, scene.camera, scene.start, settings=Settings(refine=refine))
        z = (found.q - scene.truth) / found.sigma
        assert np.mean(np.abs(z) < 2.0) > 0.8
        errors.append(np.sqrt(np.mean((found.q - scene.truth) ** 2)))
        sigmas.append(np.median(found.sigma))
    assert errors[1] < 0.8 * errors[0] and sigmas[1] < 0.8 * sigmas[0]
