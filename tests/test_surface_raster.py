"""What pixels show of a mesh: compiled loops against plain twins, outlines against the renderer's exact silhouettes."""

import numpy as np
import pytest
from made_hand import made_hand

from handtrack._kernels import mesh_image as image_kernels
from handtrack.appearance import SHARP, learn_from_samples
from handtrack.camera import orthographic, perspective
from handtrack.surface import bind
from handtrack.surface.contour import contour_edges_numpy, contour_places, place_contour
from handtrack.surface.gloss import Gloss, fit_gloss, gloss_levels
from handtrack.surface.image import EDGE, INSIDE, RIM, box_of, expected_image, fragments, shade_box, shade_box_numpy
from handtrack.surface.learning import learn_lens, learn_surface
from handtrack.surface.raster import facing_numpy, probe, probe_numpy, rasterise, rasterise_numpy, tiled, tiles_numpy
from handtrack.surface.shading import table_levels, table_rows, table_rows_numpy
from handtrack.surface.templates import expect_contours, expect_numpy
from handtrack.surface.view import moving_box, view_of
from synth.mesh_hand import mesh_hand
from synth.mesh_scene import mesh_scene
from synth.scene import image

MESH = made_hand()
MODEL, _ = mesh_hand(MESH)
SURFACE = bind(MODEL, MESH)
FLAT = np.diag([1.0, -1.0, -1.0])
FRONT = orthographic(96, 80, 0.45, 48.0, 45.0, FLAT, np.array([0.0, 0.0, 300.0]))
NEAR = perspective(96, 80, 150.0, 150.0, 48.0, 45.0, FLAT, np.array([0.0, 0.0, 330.0]))
CLIP = mesh_scene(3, MESH, frames=2, size=(320, 240), zoom=1.5, noise=1.0)
HERE = bind(CLIP.model, MESH)
U = np.full(12, 0.35)


@pytest.fixture(scope="module")
def learnt():
    return learn_surface(image(CLIP, 0), HERE, CLIP.camera, CLIP.truth[0])


@pytest.mark.parametrize("camera", [FRONT, NEAR])
def test_pixels_points_and_tiles_are_those_of_the_plain_twins(camera):
    view = view_of(SURFACE, camera, U)
    np.testing.assert_allclose(view.mesh.area, facing_numpy(view.mesh.xy, SURFACE.triangles))
    for compiled, plain in ((rasterise(view.mesh, camera), rasterise_numpy(view.mesh, camera)),):
        np.testing.assert_array_equal(compiled.triangle, plain.triangle)
        np.testing.assert_allclose(compiled.bary, plain.bary, atol=1e-9)
        np.testing.assert_allclose(compiled.depth, plain.depth)
    points = np.random.default_rng(1).uniform(0.0, 90.0, (300, 2))
    compiled, plain = probe(view.mesh, view.tiles, points), probe_numpy(view.mesh, points)
    np.testing.assert_array_equal(compiled.triangle, plain.triangle)
    np.testing.assert_allclose(compiled.depth, plain.depth)
    tiles, twin = tiled(view.mesh, camera), tiles_numpy(view.mesh, camera)
    np.testing.assert_array_equal(tiles.first, twin.first)
    np.testing.assert_array_equal(tiles.member, twin.member)


def test_triangles_behind_a_camera_are_left_out():
    behind = perspective(96, 80, 150.0, 150.0, 48.0, 45.0, FLAT, np.array([0.0, 0.0, 5.0]))
    view = view_of(SURFACE, behind, U)
    assert np.isnan(view.mesh.xy).any() and (rasterise(view.mesh, behind).depth > 0.0).all()


@pytest.mark.parametrize("camera", [FRONT, NEAR])
def test_a_box_shows_the_same_as_the_whole_image(camera):
    view = view_of(SURFACE, camera, U)
    box = box_of(SURFACE, camera, view, np.array([10.0, 5.0]), np.array([80.0, 60.0]))
    whole = rasterise_numpy(view.mesh, camera)
    np.testing.assert_array_equal(box.triangle, whole.triangle[5:61, 10:81])
    row, column = np.nonzero(box.triangle >= 0)
    np.testing.assert_allclose(fragments(view, box, row, column).bary, whole.bary[row + 5, column + 10], atol=1e-9)
    inside = np.zeros(box.triangle.shape, dtype=bool)
    hit = box.triangle >= 0
    inside[1:-1, 1:-1] = np.logical_and.reduce(
        [hit[1 + r : hit.shape[0] - 1 + r, 1 + c : hit.shape[1] - 1 + c] for r in (-1, 0, 1) for c in (-1, 0, 1)]
    )
    assert not (inside & (box.kind == 0)).any() and {INSIDE, RIM, EDGE} <= set(box.kind.ravel().tolist())
    assert (box.kind[hit & ~inside][1:] != 0).all()


def test_the_outline_is_walked_along_every_contour_edge():
    view = view_of(HERE, CLIP.camera, CLIP.truth[0])
    at, length = contour_places(HERE, view.mesh, 0.5, 0.0)
    on = contour_edges_numpy(HERE, view.mesh)
    known = {tuple(sorted(ends)) for ends in HERE.edge[on].tolist()}
    assert {tuple(sorted(ends)) for ends in at.vertex.tolist()} <= known
    a, b = view.mesh.xy[HERE.edge[on, 0]], view.mesh.xy[HERE.edge[on, 1]]
    assert length.sum() == pytest.approx(np.linalg.norm(b - a, axis=1).sum(), rel=0.02)


def test_samplers_point_away_from_the_surface():
    view = view_of(HERE, CLIP.camera, CLIP.truth[0])
    at, _ = contour_places(HERE, view.mesh, 6.0)
    samplers = place_contour(HERE, view.skin, view.mesh, CLIP.camera, CLIP.truth[0], at)
    np.testing.assert_allclose(np.linalg.norm(samplers.direction, axis=1), 1.0)
    inner = probe(view.mesh, view.tiles, samplers.origin - 0.7 * samplers.direction).triangle
    outer = probe(view.mesh, view.tiles, samplers.origin + 0.7 * samplers.direction).triangle
    outline = (inner >= 0) & (outer < 0)
    assert outline.mean() > 0.4 and ((inner < 0) & (outer >= 0)).mean() < 0.02


@pytest.mark.parametrize("name", ["orthographic", "perspective"])
def test_templates_are_those_of_the_plain_twin(name, learnt):
    clip = mesh_scene(3, MESH, frames=1, size=(320, 240), zoom=1.5, projection=name)
    surface, u = bind(clip.model, MESH), clip.truth[0]
    view = view_of(surface, clip.camera, u)
    at, _ = contour_places(surface, view.mesh, 9.0)
    samplers = place_contour(surface, view.skin, view.mesh, clip.camera, u, at)
    arguments = (samplers, at, clip.camera, learnt.plain)
    compiled = expect_contours(surface, view.skin, view.mesh, view.tiles, *arguments)
    plain = expect_numpy(surface, view.skin, view.mesh, *arguments)
    here = (samplers.origin > 0.0).all(axis=1) & (samplers.origin < [320.0, 240.0]).all(axis=1)
    np.testing.assert_array_equal(compiled.state[here], plain.state[here])
    np.testing.assert_array_equal(compiled.visible[here], plain.visible[here])
    np.testing.assert_allclose(compiled.values[here], plain.values[here], atol=1e-6)
    np.testing.assert_allclose(compiled.parts[here], plain.parts[here], atol=1e-9)
    assert {0, 2} <= set(compiled.state[here].tolist())


def test_expected_pixels_are_those_of_the_plain_twin(learnt):
    view = view_of(HERE, CLIP.camera, CLIP.truth[1])
    box = box_of(HERE, CLIP.camera, view, *moving_box(HERE, CLIP.camera, view, 5.0))
    np.testing.assert_allclose(shade_box(HERE, view, box, learnt), shade_box_numpy(HERE, view, box, learnt), atol=1e-6)


def test_the_expected_image_is_that_of_the_renderer(learnt):
    """The renderer is another program with its own light: what is left is its noise."""
    view = view_of(HERE, CLIP.camera, CLIP.truth[1])
    box = box_of(HERE, CLIP.camera, view, *moving_box(HERE, CLIP.camera, view, 5.0))
    off = (image(CLIP, 1) - expected_image(HERE, CLIP.camera, view, learnt, box))[
        box.y0 : box.y0 + box.kind.shape[0], box.x0 : box.x0 + box.kind.shape[1]
    ]
    finger = (box.triangle >= 0) & (HERE.region[box.triangle] < 12)
    assert np.sqrt((off[finger & (box.kind == INSIDE)] ** 2).mean()) < 1.6
    assert np.sqrt((off[finger & (box.kind == EDGE)] ** 2).mean()) < 6.0


def test_the_blur_of_a_lens_is_found(learnt):
    import cv2

    soft = cv2.GaussianBlur(image(CLIP, 1).astype(float), (0, 0), 1.2)
    found = learn_lens(soft, HERE, CLIP.camera, CLIP.truth[1], learnt)
    assert found.blur == pytest.approx(np.hypot(1.2, SHARP), abs=0.3)
    assert learn_lens(image(CLIP, 1), HERE, CLIP.camera, CLIP.truth[1], learnt).blur == pytest.approx(SHARP)


def directions(count: int = 2000) -> np.ndarray:
    n = np.random.default_rng(3).normal(size=(count, 3))
    n[:, 2] = -np.abs(n[:, 2])
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def test_rows_of_the_table_are_those_of_the_plain_twin_and_sum_to_one():
    n = directions(200)
    column, weight = table_rows(n)
    also, twin = table_rows_numpy(n)
    np.testing.assert_array_equal(column, also)
    np.testing.assert_allclose(weight, twin, atol=1e-12)
    np.testing.assert_allclose(weight.sum(axis=1), 1.0)
    matrix, vector, right = np.zeros((289, 289)), np.zeros(289), np.arange(200.0)
    image_kernels.add_rows(column, weight, right, np.full(200, 2.0), matrix, vector)
    dense = np.zeros((200, 289))
    np.add.at(dense, (np.arange(200)[:, None], column), weight)
    np.testing.assert_allclose(np.tril(matrix), np.tril(2.0 * dense.T @ dense), atol=1e-9)
    np.testing.assert_allclose(vector, 2.0 * dense.T @ right, atol=1e-9)


def test_the_slope_of_the_table_is_that_of_differences():
    table, h = np.random.default_rng(2).normal(size=(17, 17)), 1e-6
    for n in directions(20):
        slope = np.zeros(3)
        value = image_kernels.table_slope(table, -2.0, 0.25, n, np.empty((4, 4)), slope)
        assert value == pytest.approx(table_levels(table, n[None])[0])
        for i in range(3):
            e = h * (np.arange(3) == i)
            around = [image_kernels.table_level(table, -2.0, 0.25, *(n + s), *np.empty((2, 4))) for s in (e, -e)]
            assert slope[i] == pytest.approx((around[0] - around[1]) / (2 * h), abs=1e-4)


def test_marked_pixels_are_those_that_profiles_are_read_from():
    wanted = np.zeros((20, 30), dtype=bool)
    origin, direction, u = np.array([[12.3, 8.6]]), np.array([[0.6, 0.8]]), np.array([-1.0, 0.0, 2.0])
    image_kernels.mark_profiles(origin, direction, u, 3, 2, 0, wanted)
    read = {
        (int(np.floor(y)) - 2 + i, int(np.floor(x)) - 3 + j)
        for x, y in origin + u[:, None] * direction
        for i in (0, 1)
        for j in (0, 1)
    }
    assert set(zip(*np.nonzero(wanted), strict=True)) == read


def test_light_and_highlight_are_found_though_a_quarter_of_the_surface_is_dark():
    true = Gloss(50.0, np.array([-60.0, -70.0, -100.0]), 30.0, 11.0, 0.0)
    n, rng = directions(), np.random.default_rng(4)
    level = gloss_levels(true, n) + rng.normal(0.0, 1.5, n.shape[0])
    level[:500] *= rng.uniform(0.3, 0.95, 500)
    found = fit_gloss(n, level, np.array([-40.0, -40.0, -80.0]), 1.5)
    np.testing.assert_allclose(found.light, true.light, atol=1.5)
    assert found.ambient == pytest.approx(50.0, abs=1.0) and found.gloss == pytest.approx(30.0, abs=3.0)
    again = fit_gloss(n, level, true.light, 1.5, found)
    np.testing.assert_allclose(again.light, true.light, atol=1.5)


def test_a_highlight_that_no_reading_shows_stays_of_usual_size():
    true = Gloss(50.0, np.array([-60.0, -70.0, -100.0]), 0.0, 1.0, 0.0)
    n = directions()
    n = n[n[:, 0] > 0.3]
    found = fit_gloss(n, gloss_levels(true, n) + np.random.default_rng(5).normal(0.0, 2.0, n.shape[0]), true.light, 2.0)
    assert found.gloss < 40.0 and 1.0 <= found.exponent <= 100.0
    assert np.abs(gloss_levels(found, directions()) - gloss_levels(true, directions())).max() < 40.0


def test_too_few_readings_leave_a_plain_appearance():
    plain = learn_from_samples(
        np.zeros((0, 3)), np.zeros(0, int), np.zeros(0), np.full(50, 7.0), 1.0, SURFACE.finger.size, None
    )
    assert plain.background == pytest.approx(7.0)
