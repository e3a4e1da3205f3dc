"""Windowed sums of squared differences: shifts found, their sigma by Monte Carlo, and every reason for finding none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from handtrack.appearance import Appearance
from handtrack.camera import orthographic, perspective
from handtrack.edges import BORDER, FLAT, FOUND, HIDDEN, JOINT, MISFIT, OUTSIDE, REASONS, EdgePoints, find_edges
from handtrack.edges.wssd import curves, curves_numpy, refine, refine_numpy, search_numpy
from handtrack.edges.wssd import search as search_valleys
from handtrack.pills import Pills
from handtrack.profiles import Profiles, Samplers, place_outline, sample, with_rays
from handtrack.templates import EXPECTED, Templates, expect, positions
from handtrack.templates import HIDDEN as STATE_HIDDEN
from handtrack.templates import JOINT as STATE_JOINT
from synth.render import render
from synth.shading import Light, Material

EYE, ZERO = np.eye(3), np.zeros(3)
CAMERA = orthographic(60, 60, 1.0, 0.0, 0.0, EYE, ZERO)
IMAGE_BLUR = 0.5  # pixels: a pixel's box and a linear interpolation


def star(n: int, seed: int = 0) -> Samplers:
    """Samplers in all directions, with room on both sides."""
    rng = np.random.default_rng(seed)
    angle, zero = rng.uniform(0, 2 * np.pi, n), np.zeros(n, dtype=int)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return with_rays(CAMERA, rng.uniform(22, 38, (n, 2)), direction, zero, zero * 1.0, zero, zero, np.zeros((n, 3)))


def level(u: np.ndarray, blur: float) -> np.ndarray:
    """A surface that brightens inwards, an edge at u = 0, a dark background."""
    return 10.0 + (150.0 - 3.0 * u) * ndtr(-u / blur)


def template(n: int, blur: float = IMAGE_BLUR, step: float = 0.5) -> Templates:
    u = positions(12.0, 6.0, step)
    cover = ndtr(-u / blur)
    parts = np.stack([cover, cover * np.clip(-u, 0.0, 12.0) / 12.0])
    shape = (n, u.size)
    return Templates(
        u, np.tile(level(u, blur), (n, 1)), np.tile(parts, (n, 1, 1)), np.ones(shape, dtype=bool), np.full(n, EXPECTED)
    )


def shifted(shift: np.ndarray, blur: float = IMAGE_BLUR, step: float = 0.5, margin: float = 4.0) -> Profiles:
    """Exact profiles of edges at given places."""
    u = positions(12.0 + margin, 6.0 + margin, step)
    return Profiles(u, level(u - shift[:, None], blur), np.ones((shift.size, u.size), dtype=bool))


def search(image: Profiles, looks: Templates, n: int, reach: float = 3.5, noise: float = 1.0) -> EdgePoints:
    return find_edges(star(n), looks, image, np.full(n, reach), np.full(n, 1e3), noise, noise)


def rough(rng: np.random.Generator, n: int, step: float) -> tuple[Templates, Profiles]:
    """Templates and profiles of noise, with holes in window and image."""
    looks = template(n, step=step)
    u = positions(15.0, 9.0, step)
    visible = rng.random(looks.visible.shape) < rng.uniform(0, 1, (n, 1))
    parts = rng.uniform(0, 1, looks.parts.shape)
    looks = replace(looks, values=rng.uniform(0, 255, looks.values.shape), parts=parts, visible=visible)
    inside = np.abs(u - rng.uniform(-10, 4, (n, 1))) < rng.uniform(3, 20, (n, 1))
    return looks, Profiles(u, rng.uniform(0, 255, (n, u.size)), inside)


@pytest.mark.parametrize("step", [0.5, 1.0])
def test_curves_of_kernel_and_numpy_twin_agree(step):
    looks, image = rough(np.random.default_rng(0), 200, step)
    found, twin = curves(image, looks), curves_numpy(image, looks)
    np.testing.assert_array_equal(np.isinf(found), np.isinf(twin))
    assert np.isinf(found).any() and np.isfinite(found).any()
    finite = np.isfinite(found)
    np.testing.assert_allclose(found[finite], twin[finite], rtol=1e-12)


@pytest.mark.parametrize("step", [0.5, 1.0])
def test_search_of_kernel_and_numpy_twin_agree(step):
    rng, n = np.random.default_rng(7), 200
    looks, image = rough(rng, n, step)
    looks.visible[:5] = False
    reach, predicted = rng.uniform(0.0, 3.0, n), rng.uniform(0.1, 50.0, n)
    for one, two in zip(*(f(image, looks, reach, predicted, 9.0) for f in (search_valleys, search_numpy)), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-9)


@pytest.mark.parametrize("step", [0.5, 1.0])
def test_refinement_of_kernel_and_numpy_twin_agree(step):
    rng, n = np.random.default_rng(1), 200
    looks, image = rough(rng, n, step)
    looks.values[:5] = 80.0  # flat: nothing to refine
    best = rng.integers(0, image.u.size - looks.u.size + 1, n)
    ridge = rng.uniform(0.01, 3.0, (n, 5)) * [1.0, 1.0, 1.0, 1.0, 4.0]
    for one, two in zip(*(f(image, looks, best, star(n), step, ridge) for f in (refine, refine_numpy)), strict=True):
        np.testing.assert_array_equal(np.isinf(one), np.isinf(two))
        finite = np.isfinite(one)
        np.testing.assert_allclose(one[finite], two[finite], rtol=1e-7, atol=1e-10)


def test_curve_is_the_mean_square_over_the_window_that_moves_along():
    looks, image = template(1), shifted(np.array([0.0]))
    looks = replace(looks, visible=looks.visible & (looks.u > -3.0))
    for k, value in enumerate(curves(image, looks)[0]):
        difference = image.values[0, k : k + looks.u.size] - looks.values[0]
        assert value == pytest.approx(np.mean(difference[looks.visible[0]] ** 2), abs=1e-9)
    assert curves(image, looks)[0].argmin() == 8, "4 px of margin, half a pixel a sample"


def test_a_curve_needs_half_of_its_window_inside_the_image():
    looks, image = template(1), shifted(np.array([0.0]))
    for lost, seen in ((18, True), (19, False)):  # of 36 samples
        inside = np.arange(image.u.size)[None] >= 8 + lost
        assert np.isfinite(curves(replace(image, inside=inside), looks)[0, 8]) == seen


@pytest.mark.parametrize(("blur", "most"), [(IMAGE_BLUR, 0.022), (0.8, 0.012), (1.0, 0.01)])
def test_a_shifted_template_is_found_without_noise(blur, most):
    shift = np.linspace(-3.0, 3.0, 121)
    found = search(shifted(shift, blur), template(121, blur), 121, noise=0.3)
    assert (found.reason == FOUND).all()
    assert np.abs(found.offset - shift).max() < most
    assert np.sqrt(np.mean((found.offset - shift) ** 2)) < 0.6 * most
    samplers = star(121)
    np.testing.assert_allclose(found.xy, samplers.origin + found.offset[:, None] * samplers.direction, atol=1e-12)


def test_grey_levels_a_little_off_hardly_move_the_edge():
    shift = np.linspace(-2.0, 2.0, 41)
    image = shifted(shift)
    for factor, more in ((1.08, 0.0), (0.92, 0.0), (1.0, 6.0), (1.05, -4.0)):
        found = search(replace(image, values=factor * image.values + more), template(41), 41)
        assert (found.reason == FOUND).all()
        assert np.abs(found.offset - shift).max() < 0.06


def test_a_rendered_edge_is_found_where_the_model_is():
    pills = Pills(np.array([[-20.0, -3.0, 300.0]]), np.array([[30.0, 8.0, 310.0]]), np.array([[12.0, 10.0]]))
    shading = np.zeros(28)
    shading[0] = 200.0
    plain = Appearance(shading, np.ones(1), 10.0, 1.0, 0.5, 1.0, np.zeros((26, 26)), np.zeros(26))
    errors = []
    for x, y in ((0.0, 0.0), (0.4, 0.3), (-1.1, 0.7)):  # the model is off by so many pixels
        camera, off = (perspective(320, 240, 500.0, 500.0, 160.0 + k * x, 120.0 + k * y, EYE, ZERO) for k in (0, 1))
        light = Light(np.array([0.0, 0.0, -1.0]))
        image = render(pills, off, Material(np.full((1, 3), 200.0)), light, "binary", background=10.0)
        samplers = place_outline(pills, camera, np.array([True]), spacing=2.0, most=60)
        n = samplers.link.size
        seen = sample(image, samplers, positions(16.0, 10.0, 0.5))
        looks = expect(samplers, pills, np.array([0]), camera, plain)
        found = find_edges(samplers, looks, seen, np.full(n, 3.5), np.full(n, 1e3), 1.0, 1.0)
        assert (found.reason == FOUND).all()
        errors.append(found.offset - samplers.direction @ [x, y])
    error = np.concatenate(errors)
    assert abs(error.mean()) < 0.025 and error.std() < 0.07


@pytest.mark.parametrize("prior", [False, True])
@pytest.mark.parametrize("step", [0.5, 1.0])
def test_variance_is_that_of_many_noisy_images(step, prior):
    """White pixel noise through the real bilinear sampling, and with a prior, grey levels off as the prior says."""
    rng, n, sigma, runs = np.random.default_rng(2), 60, 4.0, 300
    samplers, looks = star(n), template(n, step=step)
    image = shifted(np.zeros(n), step=step)
    best = np.full(n, round(4.0 / step))
    ridge = np.tile([0.0, 0.01, 0.01, 0.01, 0.04] if prior else np.zeros(5), (n, 1))
    m = looks.u.size
    cover = looks.parts[0, 0]
    wrong = np.zeros((4, image.u.size))
    wrong[:, best[0] : best[0] + m] = cover, looks.parts[0, 1], cover * (np.arange(m) - 0.5 * m) / m, 1.0 - cover
    shift = np.empty((runs, n))
    for run in range(runs):
        noise = sample(rng.normal(0, sigma, (60, 60)), samplers, image.u)
        assert noise.inside.all()
        values = image.values + noise.values
        if prior:
            values = values + rng.normal(size=(n, 4)) * sigma / np.sqrt(ridge[:, 1:]) @ wrong
        shift[run], variance, _ = refine(replace(image, values=values), looks, best, samplers, step, ridge)
    ratio = shift.std(axis=0) / (sigma * np.sqrt(variance))
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.08)
    assert ((ratio > 0.75) & (ratio < 1.35)).all()


def test_misfit_without_error_is_near_one_and_grows_with_what_is_wrong():
    rng, n = np.random.default_rng(3), 60
    samplers, looks, image = star(n), template(n), shifted(np.zeros(n))
    noise = sample(rng.normal(0, 4.0, (60, 60)), samplers, image.u)
    one = search(replace(image, values=image.values + noise.values), looks, n, noise=4.0)
    assert 0.5 < np.median(one.misfit) < 1.5
    wave = 15.0 * np.sin(2.5 * image.u)
    two = search(replace(image, values=image.values + noise.values + wave), looks, n, noise=4.0)
    assert np.median(two.misfit) > 4.0
    assert np.median(two.sigma[two.reason == FOUND]) > np.median(one.sigma)


def test_more_noise_gives_a_larger_sigma():
    image, looks = shifted(np.zeros(10)), template(10)
    sigma = [np.median(search(image, looks, 10, noise=noise).sigma) for noise in (1.0, 4.0, 8.0)]
    assert sigma[0] < sigma[1] < sigma[2] < 0.3


def one_reason(found: EdgePoints, reason: int) -> None:
    assert found.reason.tolist() == [reason] * found.reason.size, [REASONS[i] for i in found.reason]
    assert np.isinf(found.sigma).all() and (found.offset == 0.0).all()
    np.testing.assert_array_equal(found.xy, star(found.reason.size).origin)


def test_reason_hidden_by_another_finger():
    looks = template(3)
    one_reason(search(shifted(np.zeros(3)), replace(looks, state=np.full(3, STATE_HIDDEN)), 3), HIDDEN)
    narrow = replace(looks, visible=looks.visible & (np.abs(looks.u) < 1.2))
    one_reason(search(shifted(np.zeros(3)), narrow, 3), HIDDEN)


def test_reason_no_depth_step():
    looks = replace(template(3), state=np.full(3, STATE_JOINT))
    one_reason(search(shifted(np.zeros(3)), looks, 3), JOINT)


def test_reason_outside_the_image():
    image = shifted(np.zeros(3))
    one_reason(search(replace(image, inside=np.zeros_like(image.inside)), template(3), 3), OUTSIDE)


def test_reason_no_contrast():
    looks, image = template(3), shifted(np.zeros(3))
    flat = replace(looks, values=np.full_like(looks.values, 80.0))
    one_reason(search(replace(image, values=np.full_like(image.values, 80.0)), flat, 3), FLAT)
    one_reason(search(image, looks, 3, noise=60.0), FLAT)  # contrast drowned in noise


def test_reason_valley_at_the_end_of_the_range():
    one_reason(search(shifted(np.full(3, 3.0)), template(3), 3, reach=2.0), BORDER)


def test_reason_does_not_look_like_the_template():
    image = shifted(np.zeros(3))
    stripes = 120.0 + 120.0 * np.sign(np.sin(1.1 * image.u + 0.3))
    one_reason(search(replace(image, values=np.tile(stripes, (3, 1))), template(3), 3, reach=3.5), MISFIT)


def test_a_far_valley_must_be_better_by_what_the_prediction_says():
    u = shifted(np.zeros(1)).u
    far, near = level(u + 3.0, IMAGE_BLUR), 0.9 * level(u - 0.5, IMAGE_BLUR)  # the near edge matches less well
    image = Profiles(u, np.where(u < -1.2, far, near)[None], np.ones((1, u.size), dtype=bool))
    looks = template(1)
    looks = replace(looks, visible=np.abs(looks.u[None]) < 1.6)
    for predicted, offset in ((1e3, -3.0), (0.3, 0.5)):
        found = find_edges(star(1), looks, image, np.full(1, 3.5), np.full(1, predicted), 4.0, 4.0)
        assert found.reason[0] == FOUND and found.offset[0] == pytest.approx(offset, abs=0.1)


def test_every_reason_has_its_words():
    assert len(REASONS) == 1 + max(FOUND, HIDDEN, JOINT, OUTSIDE, FLAT, BORDER, MISFIT) and len(set(REASONS)) == 7
