"""Claims about the comparison of an image with the rendered hand, and about the solve that aligns both."""

from dataclasses import replace

import numpy as np
import pytest

from handtrack import _kernels
from handtrack.appearance import learn
from handtrack.kinematics import forward
from handtrack.measure import posed
from handtrack.refine import trusted
from handtrack.residuals import chain
from handtrack.scatter import first_scatter
from handtrack.settings import Settings
from handtrack.soft_image import soft_image
from handtrack.synthesis import (
    PATCHES,
    Unmodelled,
    choose,
    differences,
    link_twists,
    normal_equations_numpy,
    outlined_numpy,
    rendered,
    samples_of,
)
from handtrack.tracker import track
from handtrack.unmodelled import _nodes, learn_unmodelled, read_table
from synth.scene import images_together
from synth.scenes import image, images, two_finger_crossing
from synth.views import with_views

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
    return on, u, appearance, picture, samples_of(picture, on, appearance, u)[0]


@pytest.mark.parametrize("kind", SCENES)
def test_single_pixels_show_what_the_plain_rendering_shows(kind):
    on, u, appearance, _, samples = seen(kind)
    plain = soft_image(posed(on, u), on.camera, appearance, block=1).image
    single = samples.place[:, 2] == 1.0
    x, y = samples.place[single, :2].astype(int).T
    shown = rendered(samples, posed(on, u), on.camera, appearance).level[single]
    assert single.sum() > 300
    np.testing.assert_allclose(shown, plain[y, x], atol=1e-4)


@pytest.mark.parametrize("kind", SCENES)
def test_rows_by_the_twists_are_finite_differences_by_the_pose(kind):
    on, u, appearance, _, samples = seen(kind)
    rows = rendered(samples, posed(on, u), on.camera, appearance).row
    G = (link_twists(on, forward(on.model, u)) @ on.model.coupling).reshape(-1, 6, u.size)
    J = sum(np.einsum("na,nak->nk", rows[:, i], G[samples.pill[:, i]] * (samples.pill[:, i] >= 0)[:, None, None])
            for i in range(4))  # fmt: skip
    step = 1e-6
    plain = np.stack(
        [
            (rendered(samples, posed(on, u + e), on.camera, appearance).level
             - rendered(samples, posed(on, u - e), on.camera, appearance).level) / (2.0 * step)
            for e in step * np.eye(u.size)
        ],
        axis=1,
    )  # fmt: skip
    off = np.abs(J - plain) / np.abs(plain).max()
    assert np.quantile(off, 0.95) < 1e-2 and np.median(off) < 1e-5  # the turning of edges in a pixel is left out


@pytest.mark.parametrize("kind", SCENES)
def test_rows_by_a_patch_are_finite_differences_by_gain_and_radius(kind):
    on, u, appearance, _, samples = seen(kind)
    flat = np.zeros(28)
    flat[0] = 150.0
    flat = replace(appearance, shading=flat)
    pills, one = posed(on, u), (samples.pill[:, 1] < 0) & (samples.place[:, 2] == 1.0)
    link = samples.patch // PATCHES
    by_patch = rendered(samples, pills, on.camera, flat).by_patch
    step = 1e-5
    larger, smaller = (replace(pills, radius=pills.radius + s * step) for s in (0.5, -0.5))
    by_radius = np.subtract(*(rendered(samples, p, on.camera, flat).level for p in (larger, smaller))) / step
    np.testing.assert_allclose(by_patch[one, 1], by_radius[one], atol=2e-2 * np.abs(by_radius).max())
    brighter, darker = (
        rendered(samples, pills, on.camera, replace(flat, gain=flat.gain * (1.0 + s * step))).level for s in (0.5, -0.5)
    )
    np.testing.assert_allclose(by_patch[one, 0], (brighter - darker)[one] / step, atol=1e-3)
    assert (link[one] == samples.pill[one, 0]).all()


def test_compiled_normal_equations_are_those_of_dense_matrices():
    on, u, appearance, _, samples = seen("orthographic")
    shown = rendered(samples, posed(on, u), on.camera, appearance)
    links, patches = on.model.link_frame.size, PATCHES * on.model.link_frame.size
    rng = np.random.default_rng(0)
    weight, r = rng.uniform(0.0, 2.0, samples.level.size), rng.standard_normal(samples.level.size)
    H, g = np.zeros((6 * links, 6 * links)), np.zeros((patches, 6 * links))
    across, within, own = np.zeros((patches, 2, 6 * links)), np.zeros((patches, 3)), np.zeros((patches, 2))
    _kernels.normal_equations(
        samples.pill, samples.patch, weight, r, shown.row, shown.by_patch, H, g, across, within, own
    )
    plain = normal_equations_numpy(samples, shown, weight, r, links)
    for compiled, dense in zip((np.triu(H), g, across, within, own), plain, strict=True):
        np.testing.assert_allclose(compiled, dense, rtol=1e-9, atol=1e-6 * np.abs(dense).max())


@pytest.mark.parametrize("kind", SCENES)
def test_samples_lie_on_outlines_and_inside_and_are_means_of_the_image(kind):
    on, u, appearance, picture, samples = seen(kind)
    plain = soft_image(posed(on, u), on.camera, appearance, block=1).image
    for (x, y, size), level in zip(samples.place, samples.level, strict=True):
        x0, y0, n = round(x - 0.5 * (size - 1)), round(y - 0.5 * (size - 1)), int(size)
        assert level == pytest.approx(picture[y0 : y0 + n, x0 : x0 + n].mean(), abs=1e-3)
        assert n == 1 or np.ptp(plain[y0 : y0 + n, x0 : x0 + n]) < 0.4 * np.ptp(plain)  # no outline in a block
    assert set(samples.place[:, 2]) == {1.0, 4.0}
    assert set(samples.patch // PATCHES) == set(range(on.model.link_frame.size))


@pytest.mark.parametrize("kind", SCENES)
def test_the_pixels_on_outlines_are_those_of_the_plain_search(kind):
    on, u, appearance, picture, _ = seen(kind)
    pills, thin = posed(on, u), 5
    samples, _ = choose(picture, pills, on.camera, appearance, thin)
    single = samples.place[samples.place[:, 2] == 1.0, :2].astype(int)
    found = np.zeros(picture.shape, bool)
    found[single[:, 1], single[:, 0]] = True
    y, x = np.indices(picture.shape)
    lattice = (x + 3 * y) % thin == 0
    outlined = outlined_numpy(pills, on.camera, np.sqrt(0.5) + 0.5) & lattice
    inside = soft_image(pills, on.camera, appearance, block=1).image != appearance.background
    missed = outlined & inside & ~found
    assert outlined.sum() > 200 and missed.mean() * picture.size < 0.01 * outlined.sum()
    more = found & ~outlined
    assert not (found & ~lattice).any() and more.sum() < 1.2 * outlined.sum()


def test_an_outline_out_of_the_image_or_a_dark_image_gives_no_false_samples():
    on, u, appearance, picture, _ = seen("orthographic")
    away = replace(posed(on, u), base=posed(on, u).base + 1e4, tip=posed(on, u).tip + 1e4)
    assert choose(picture, away, on.camera, appearance)[0].level.size == 0


def test_thinning_keeps_its_share_of_the_outline_pixels():
    on, u, appearance, picture, _ = seen("orthographic")
    count = [
        (choose(picture, posed(on, u), on.camera, appearance, thin)[0].place[:, 2] == 1.0).sum() for thin in (1, 2, 5)
    ]
    assert count[1] == pytest.approx(count[0] / 2, rel=0.1) and count[2] == pytest.approx(count[0] / 5, rel=0.15)


def test_a_table_over_the_normal_adds_to_the_level_and_its_slope():
    on, u, appearance, _, samples = seen("orthographic")
    rng = np.random.default_rng(1)
    table = rng.normal(0.0, 5.0, (25, 25))
    plain, more = (rendered(samples, posed(on, u), on.camera, appearance, t) for t in (None, table))
    whole = samples.place[:, 2] > 1.0
    gain = appearance.gain[samples.patch // PATCHES]
    np.testing.assert_allclose(
        (more.level - plain.level)[whole], (gain * read_table(table, more.normal))[whole], atol=1e-9
    )
    at, share = _nodes(more.normal)
    assert at.min() >= 0 and at.max() < 625
    np.testing.assert_allclose(share.sum(axis=0), 1.0)


def test_a_change_of_light_on_a_patch_says_little_of_the_pose():
    """What could as well be another grey level of the patches moves the pose less than if levels were known."""
    on, u, appearance, _, samples = seen("orthographic")
    rng = np.random.default_rng(2)
    shown = rendered(samples, posed(on, u), on.camera, appearance)
    off = rng.normal(0.0, 0.03, PATCHES * on.model.link_frame.size)
    brighter = replace(samples, level=shown.level + shown.by_patch[:, 0] * off[samples.patch])
    b = np.zeros((off.size, 2))
    steps = []
    for level in (0.03, 1e-4):
        found = differences(brighter, on, appearance, Unmodelled(level, 1e-4, 0.5), u, b, 0.0)
        steps.append(np.linalg.norm(np.linalg.solve(found.A, found.score.sum(axis=0))))
    assert steps[0] < 0.6 * steps[1]


def test_sizes_of_the_unmodelled_errors_are_learnt():
    on, u, appearance, _, samples = seen("orthographic")
    rng = np.random.default_rng(3)
    shown = rendered(samples, posed(on, u), on.camera, appearance)
    for truth in (0.01, 0.06):
        known = Unmodelled(0.03, 0.02, 0.5)
        for _ in range(40):
            off = rng.normal(0.0, truth, PATCHES * on.model.link_frame.size)
            level = shown.level + shown.by_patch[:, 0] * off[samples.patch]
            noisy = replace(samples, level=level + rng.normal(0.0, appearance.noise, level.size) / samples.place[:, 2])
            plain = replace(known, table=None, sums=None)
            b = np.zeros((off.size, 2))
            for _ in range(2):
                found = differences(noisy, on, appearance, plain, u, b, 0.0)
                b = b + found.answer(np.zeros(u.size))
            known = learn_unmodelled(plain, found, b, appearance.gain)
        assert known.level == pytest.approx(truth, rel=0.5)


@pytest.mark.parametrize("kind", SCENES)
def test_refinement_is_nearer_to_the_truth_and_surer(kind):
    scene = SCENES[kind]
    pictures = list(images(scene))
    errors, sigmas = [], []
    for refine in (False, True):
        found = track(pictures, scene.model, scene.camera, scene.start, settings=Settings(refine=refine))
        z = (found.q - scene.truth) / found.sigma
        assert np.mean(np.abs(z) < 2.0) > 0.85
        errors.append(np.sqrt(np.mean((found.q - scene.truth) ** 2)))
        sigmas.append(np.median(found.sigma))
    assert errors[1] < 0.6 * errors[0] and sigmas[1] < 0.8 * sigmas[0]


def test_two_views_are_refined_in_one_solve():
    scene = with_views(two_finger_crossing(5, frames=6, size=(320, 240), scale=1.6), 2)
    pictures = list(images_together(scene))
    errors = []
    for refine in (False, True):
        found = track(pictures, scene.model, scene.cameras, scene.start, settings=Settings(refine=refine))
        errors.append(np.sqrt(np.mean((found.q - scene.truth) ** 2)))
        assert np.mean(np.abs(found.q - scene.truth) < 2.0 * found.sigma) > 0.85
    assert errors[1] < 0.6 * errors[0]


def test_pixels_are_believed_only_where_edges_say_that_pills_fit():
    right = first_scatter()
    shares = [trusted(replace(right, s=s)) for s in (0.8, 1.2, 2.0, 3.0, 10.0)]
    assert shares[:2] == [1.0, 1.0] and np.all(np.diff(shares[1:]) < 0.0) and shares[-1] < 1e-6
    assert trusted(replace(right, tau=1.0)) < 1e-3
