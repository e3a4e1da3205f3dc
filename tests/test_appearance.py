"""Appearance: what it learns from rendered images against what the renderer, which knows no harmonics, shows."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.appearance import Appearance, harmonics, harmonics_numpy, learn, shade_numpy, shaded
from handtrack.camera import rays
from handtrack.kinematics import forward
from handtrack.pills import Pills, pose_pills, ray_hits
from synth.scenes import Scene, clean_image, image, posed, two_finger_crossing
from synth.sensor import Sensor


def scene(seed: int, **chosen) -> Scene:
    return two_finger_crossing(seed, **({"frames": 12, "noise": 2.0} | chosen))


def surface_error(clip: Scene, appearance: Appearance, frame: int) -> np.ndarray:
    """Predicted less true grey level of the visible surface, every second pixel."""
    u, v = np.meshgrid(np.arange(0, clip.camera.width, 2), np.arange(0, clip.camera.height, 2))
    xy = np.column_stack([u.ravel(), v.ravel()])
    hits = ray_hits(posed(clip, frame), *rays(clip.camera, xy.astype(float)))
    on = hits.pill >= 0
    shown = clean_image(clip, frame)[xy[:, 1], xy[:, 0]]
    return (shade_numpy(appearance, hits.normal, hits.pill) - shown)[on]


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 0.1))
@settings(deadline=None)
def test_harmonics_have_definite_parity(v):
    n = np.array([v]) / np.linalg.norm(v)
    there, back = harmonics(n)[0], harmonics(-n)[0]
    np.testing.assert_allclose(np.abs(there), np.abs(back), atol=1e-12)
    assert there.shape == (25,) and there[0] == 1.0


def test_harmonics_span_all_polynomials_of_degree_four_on_the_sphere():
    rng = np.random.default_rng(0)
    n = rng.normal(size=(400, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    basis = harmonics(n)
    assert np.linalg.matrix_rank(basis) == 25  # 1 + 3 + 5 + 7 + 9
    np.testing.assert_allclose(basis, harmonics_numpy(n), atol=1e-14)
    powers = [(i, j, k) for i in range(5) for j in range(5 - i) for k in range(5 - i - j)]
    target = np.stack([n[:, 0] ** i * n[:, 1] ** j * n[:, 2] ** k for i, j, k in powers], axis=1)
    fitted = basis @ np.linalg.lstsq(basis, target, rcond=None)[0]
    np.testing.assert_allclose(fitted, target, atol=1e-9)


def test_shading_is_the_harmonics_plus_one_light_times_the_gain():
    rng = np.random.default_rng(1)
    n = rng.normal(size=(50, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    shading = rng.normal(size=28)
    appearance = Appearance(shading, np.array([0.5, 2.0]), 7.0, 1.0, 0.5, 1.0, np.zeros((26, 26)), np.zeros(26))
    level = harmonics(n) @ shading[:25] + np.clip(n @ shading[25:], 0.0, None)
    np.testing.assert_allclose(shaded(shading, n), level)
    link = np.arange(50) % 3 - 1
    expected = np.where(link < 0, 7.0, np.array([0.5, 2.0])[np.maximum(link, 0)] * level)
    np.testing.assert_allclose(shade_numpy(appearance, n, link), expected)


@pytest.mark.parametrize("projection", ["orthographic", "perspective"])
@pytest.mark.parametrize("seed", range(2))
def test_a_rendered_scene_is_learnt_to_within_its_noise(projection, seed):
    clip = scene(seed, projection=projection)
    known = learn(image(clip, 0), posed(clip, 0), clip.camera)
    assert np.median(np.abs(surface_error(clip, known, 0))) < 2.0
    again = learn(image(clip, 0), posed(clip, 0), clip.camera, known)
    error = surface_error(clip, again, 0)
    assert np.median(np.abs(error)) < 2.0
    assert np.sqrt(np.mean(error**2)) < 0.04 * 175, "4 % of the range, rim and highlight included"
    assert known.background == pytest.approx(5.0, abs=1.0)
    assert known.spread < 2.5 * clip.sensor.noise


@pytest.mark.parametrize("projection", ["orthographic", "perspective"])
@pytest.mark.parametrize("seed", range(3))
def test_grey_levels_of_a_new_pose_are_predicted(projection, seed):
    clip = scene(seed, projection=projection)
    known = None
    for frame in range(3):
        known = learn(image(clip, frame), posed(clip, frame), clip.camera, known)
    assert known is not None
    error = surface_error(clip, known, 11)  # up to 30 degrees on
    assert np.median(np.abs(error)) < 5.0
    assert np.percentile(np.abs(error), 90) < 0.08 * 175


@pytest.mark.parametrize("seed", range(4))
def test_a_pose_wrong_by_3_degrees_spoils_it_little_and_not_for_long(seed):
    clip = scene(seed, start_error=3.0)
    wrong = pose_pills(clip.model, forward(clip.model, clip.start), clip.camera)
    known = learn(image(clip, 0), wrong, clip.camera)
    assert np.median(np.abs(surface_error(clip, known, 0))) < 0.2 * 175
    assert known.background == pytest.approx(5.0, abs=2.0)
    for frame in range(6):
        known = learn(image(clip, frame), posed(clip, frame), clip.camera, known)
    assert np.median(np.abs(surface_error(clip, known, 5))) < 5.0


@pytest.mark.parametrize("sigma", [1.0, 2.0, 4.0, 8.0])
def test_noise_is_estimated_within_15_percent(sigma):
    for seed in range(3):
        clip = replace(scene(seed), sensor=Sensor(sigma, quantise=False))
        known = None
        for frame in range(5):
            known = learn(image(clip, frame), posed(clip, frame), clip.camera, known)
        assert known is not None
        assert known.noise == pytest.approx(sigma, rel=0.15)


@pytest.mark.parametrize("sigma", [4.0, 8.0])
def test_rounding_to_whole_grey_levels_leaves_the_noise_estimate_right(sigma):
    clip = scene(1, noise=sigma)
    known = None
    for frame in range(5):
        known = learn(image(clip, frame), posed(clip, frame), clip.camera, known)
    assert known is not None
    assert known.noise == pytest.approx(sigma, rel=0.15)


def test_an_image_without_noise_still_has_the_rounding_of_its_grey_levels():
    clip = scene(0, noise=0.0)
    assert learn(image(clip, 0), posed(clip, 0), clip.camera).noise >= 1.0 / np.sqrt(12.0) - 0.01


def test_a_darker_link_gets_a_smaller_gain():
    clip = scene(2)
    albedo = clip.material.albedo * np.where(np.arange(6) >= 3, 0.7, 1.0)[:, None]
    dark = replace(clip, material=replace(clip.material, albedo=albedo))
    known = None
    for frame in range(10):
        known = learn(image(dark, frame), posed(dark, frame), dark.camera, known)
    assert known is not None
    assert known.gain[3:].mean() / known.gain[:3].mean() < 0.85


def test_learning_is_a_pure_function():
    clip = scene(3)
    picture, pills = image(clip, 0), posed(clip, 0)
    first = learn(picture, pills, clip.camera)
    kept = [np.array(x) for x in (first.shading, first.gain, first.normal_matrix)]
    one, two = (learn(picture, pills, clip.camera, first) for _ in range(2))
    np.testing.assert_array_equal(one.shading, two.shading)
    for before, after in zip(kept, (first.shading, first.gain, first.normal_matrix), strict=True):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("before", [False, True])
def test_a_model_out_of_the_image_teaches_nothing(before):
    clip = scene(0)
    picture, pills = image(clip, 0), posed(clip, 0)
    previous = learn(picture, pills, clip.camera) if before else None
    away = Pills(pills.base + 1e4 * np.eye(3)[0], pills.tip + 1e4 * np.eye(3)[0], pills.radius)
    known = learn(picture, away, clip.camera, previous)
    assert np.isfinite(known.shading).all() and known.noise > 0.0
    if previous is not None:
        np.testing.assert_array_equal(known.shading, previous.shading)
        np.testing.assert_array_equal(known.gain, previous.gain)


def test_a_black_image_gives_a_finite_appearance():
    clip = scene(0)
    known = learn(np.zeros((480, 640), dtype=np.float32), posed(clip, 0), clip.camera)
    assert np.isfinite(known.shading).all() and np.isfinite(known.gain).all()
    assert known.noise > 0.0 and known.background == 0.0
