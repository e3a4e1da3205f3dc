"""Anti-aliasing against area laws and brute force; light against its formula; the compiled loops against their twin."""

import math
from dataclasses import replace

import numpy as np
import pytest

from handtrack.camera import Camera, orthographic, perspective
from handtrack.pills import Pills
from synth import _kernels
from synth.edges import covered, edge_pixels, see
from synth.facets import facet_place, facet_points, facet_rows
from synth.raycast import cast, pill_table, pixel_grid
from synth.render import REC_601, render, render_numpy
from synth.scenes import posed, two_finger_crossing, two_finger_hard
from synth.shading import Light, Material, Mode, make_look, point_light

FRONT = Light(np.array([0.0, 0.0, -1.0]))
SLANTED = Light(np.array([-0.5, -0.6, -0.8]))
CAMERA = orthographic(96, 72, 1.7, 40.137, 33.291, np.eye(3), np.zeros(3))
BENT = perspective(
    96, 72, 110.0, 115.0, 45.0, 35.0, np.eye(3), np.zeros(3), np.array([-0.25, 0.08, 0.002, -0.003, 0.01])
)
HAND = Pills(
    np.array([[-12.0, -6.0, 80.0], [8.0, 2.0, 78.0], [-15.0, 12.0, 90.0], [5.0, -14.0, 70.0]]),
    np.array([[8.0, 2.0, 78.0], [20.0, 12.0, 70.0], [22.0, -9.0, 95.0], [6.0, -13.0, 70.5]]),
    np.array([[4.0, 4.0], [4.0, 2.5], [3.0, 5.0], [1.0, 4.0]]),
)
MODES = pytest.mark.parametrize("mode", ["binary", "flat", "gouraud", "phong"])


def white(links: int, level: float = 1.0) -> Material:
    return Material(np.full((links, 3), level))


def pill(base: list[float], tip: list[float], r0: float, r1: float) -> Pills:
    return Pills(np.array([base]), np.array([tip]), np.array([[r0, r1]]))


@MODES
@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["orthographic", "bent perspective"])
@pytest.mark.parametrize("colour", [False, True])
def test_compiled_image_is_that_of_the_plain_twin(mode: Mode, camera: Camera, colour: bool) -> None:
    material = Material(
        np.array([[230.0, 200.0, 180.0], [90.0, 220.0, 60.0], [60.0, 80.0, 250.0], [255.0, 255.0, 0.0]])
    )
    behind = np.linspace(0.0, 90.0, camera.width * camera.height).reshape(camera.height, camera.width)
    fast = render(HAND, camera, material, SLANTED, mode, colour=colour, background=behind)
    plain = render_numpy(HAND, camera, material, SLANTED, mode, colour=colour, background=behind)
    assert fast.shape == (72, 96, 3)[: 2 + colour] and fast.dtype == np.float32
    # float32 images; where a facet's corner touches a bisection node the twins may part by 1/256 pixel
    assert np.abs(fast - plain).max() < (1e-4 if mode != "flat" else 1.0)


@pytest.mark.parametrize(
    ("r0", "r1", "length", "turn"), [(5.0, 5.0, 20.0, 0.0), (6.0, 3.0, 17.0, 0.7), (4.0, 4.0, 9.0, 1.9)]
)
def test_binary_image_sums_up_to_the_area_of_the_silhouette(r0: float, r1: float, length: float, turn: float) -> None:
    camera = orthographic(140, 110, 3.0, 50.3, 51.6, np.eye(3), np.zeros(3))
    pills = pill([0.0, 0.0, 0.0], [length * math.cos(turn), length * math.sin(turn), 0.0], r0, r1)
    lean = math.asin((r0 - r1) / length)
    area = (math.pi / 2 + lean) * r0**2 + (math.pi / 2 - lean) * r1**2 + (r0 + r1) * length * math.cos(lean)
    assert render(pills, camera, white(1), FRONT, "binary").sum(dtype=float) == pytest.approx(9.0 * area, rel=1e-3)


def test_an_edge_is_where_it_is_to_a_two_hundredth_of_a_pixel() -> None:
    camera = orthographic(40, 40, 1.0, 0.0, 0.0, np.eye(3), np.zeros(3))
    for offset in np.linspace(-0.5, 0.5, 23):
        for slope in (0.0, 0.13, 1.0):
            along = np.array([1.0, slope, 0.0]) / math.hypot(1.0, slope)
            middle = np.array([20.0, 12.0 + offset, 0.0]) - 40.0 * np.array([-along[1], along[0], 0.0])
            wide = Pills((middle - 300 * along)[None], (middle + 300 * along)[None], np.full((1, 2), 40.0))
            image = render(wide, camera, white(1), FRONT, "binary")
            column = 20
            edge = image[:, column].sum(dtype=float) - 0.5  # the silhouette crosses this column at y = 12 + offset
            assert edge == pytest.approx(12.0 + offset, abs=0.005)


@pytest.mark.parametrize("scene", [two_finger_crossing(3), two_finger_hard(3)], ids=["orthographic", "perspective"])
def test_edges_agree_with_brute_force_within_half_a_grey_level(scene) -> None:
    pills, camera = posed(scene, 20), scene.camera
    image = render(pills, camera, scene.material, scene.light, background=5.0)
    look = make_look(pills, camera, scene.material, scene.light)
    part = cast(pills, camera).part
    edge = edge_pixels(part, part)
    v, u = edge.v[::9], edge.u[::9]
    grid = pixel_grid(camera)
    right, down = 0.5 * (grid[v + 1, u + 2] - grid[v + 1, u]), 0.5 * (grid[v + 2, u + 1] - grid[v, u + 1])
    albedo = scene.material.albedo @ REC_601
    nodes = (np.arange(24) + 0.5) / 24 - 0.5  # 24 x 24: that of 16 x 16 is itself off by 0.2 to 0.8 grey levels
    mean = np.zeros(v.size)
    for x in nodes:
        for y in nodes:
            pill_, _, lit = see(camera, look, grid[v + 1, u + 1] + x * right + y * down)
            mean += np.where(pill_ < 0, 5.0, albedo[pill_] * lit[:, 0] + lit[:, 1]) / nodes.size**2
    off = image[v, u] - mean
    assert math.sqrt((off**2).mean()) < 0.45
    assert abs(off.mean()) < 0.05


def test_covered_is_the_integral_of_the_clip() -> None:
    middle, slope = np.random.default_rng(0).uniform(-2.0, 2.0, (2, 200))
    y = (np.arange(4000) + 0.5) / 4000 - 0.5
    wanted = 0.5 + np.clip(middle[:, None] + slope[:, None] * y, -0.5, 0.5).mean(axis=1)
    np.testing.assert_allclose(covered(middle, slope), wanted, atol=1e-6)
    np.testing.assert_allclose([_kernels.covered(m, s) for m, s in zip(middle, slope, strict=True)], wanted, atol=1e-6)


def test_light_follows_phong() -> None:
    n = np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, 0.0, 1.0]])
    view = np.tile([0.0, 0.0, -1.0], (3, 1))
    light = np.array([0.6, 0.0, -0.8])
    lit = point_light(n, view, (0.25, 0.65, 20.0, 12.0), light)
    mirror = 2 * 0.8 * n[0] - light  # r = 2 (n.l) n - l
    np.testing.assert_allclose(lit[0], [0.25 + 0.65 * 0.8, 20.0 * (mirror @ view[0]) ** 12])
    np.testing.assert_allclose(lit[1], [0.25 + 0.65, 20.0 * 0.8**12])
    np.testing.assert_allclose(lit[2], [0.25, 0.0])  # turned away: no diffuse, no gloss


@pytest.mark.parametrize("shininess", [0.5, 1.0, 7.0, 12.25])
def test_powers_of_any_exponent(shininess: float) -> None:
    assert _kernels.power(0.83, shininess) == pytest.approx(0.83**shininess, rel=1e-14)


@MODES
def test_a_ball_lit_from_the_eye_is_as_bright_as_its_albedo_says(mode: Mode) -> None:
    camera = orthographic(61, 61, 3.0, 30.0, 30.0, np.eye(3), np.zeros(3))
    material = Material(np.full((1, 3), 200.0), ambient=0.3, diffuse=0.5, specular=0.0)
    image = render(pill([0.0, 0.0, 0.0], [0.0, 0.0, 1e-9], 8.0, 8.0), camera, material, FRONT, mode)
    assert image[30, 30] == pytest.approx(200.0 if mode == "binary" else 160.0, rel=0.03)
    assert image[0, 0] == 0.0


def test_facets_shade_in_steps_corners_blend_and_both_follow_phong() -> None:
    images = {mode: render(HAND, CAMERA, white(4, 230.0), SLANTED, mode) for mode in ("flat", "gouraud", "phong")}
    inside = cast(HAND, CAMERA).part >= 0
    assert np.abs(images["gouraud"] - images["phong"])[inside].mean() < 4.0
    assert np.abs(images["flat"] - images["phong"])[inside].mean() < 14.0
    steps = {mode: np.abs(np.diff(image, axis=0))[inside[1:] & inside[:-1]] for mode, image in images.items()}
    assert (steps["flat"] < 1e-3).mean() > 0.05 > (steps["gouraud"] < 1e-3).mean()


def test_facet_places_are_the_inverse_of_facet_points() -> None:
    rows = facet_rows(pill_table(HAND))
    counts = (3, 4, 16)
    ring, sector = np.linspace(0.1, 9.9, 23), np.linspace(0.1, 15.9, 17)
    p, n = facet_points(rows, counts, ring, sector)
    assert np.abs(np.linalg.norm(n, axis=-1) - 1).max() < 1e-12
    caps = (ring < 3) | (ring > 7)
    for k, known in enumerate((slice(None), slice(None), slice(None), caps)):  # the last is a ball: it has no side
        points, normals = p[k][known].reshape(-1, 3), n[k][known].reshape(-1, 3)
        again = facet_place(np.tile(rows[k], (points.shape[0], 1)), counts, points, normals)
        np.testing.assert_allclose(again[0], np.repeat(ring[known], sector.size), atol=1e-6)
        np.testing.assert_allclose(again[1], np.tile(sector, ring[known].size), atol=1e-9)


def test_facets_of_a_pill_that_points_at_the_camera_are_finite() -> None:
    towards = pill([0.0, 0.0, 9.0], [0.0, 0.0, 2.0], 3.0, 2.0)
    assert np.isfinite(facet_rows(pill_table(towards))).all()
    assert np.isfinite(render(towards, CAMERA, white(1, 99.0), SLANTED, "gouraud")).all()


def test_colour_and_grey_tell_the_same_by_rec_601() -> None:
    material = Material(np.array([[230.0, 30.0, 80.0]] * 4))
    colour = render(HAND, CAMERA, material, SLANTED, colour=True, background=np.full((72, 96, 3), (10.0, 50.0, 90.0)))
    grey = render(HAND, CAMERA, material, SLANTED, background=np.full((72, 96, 3), (10.0, 50.0, 90.0)))
    np.testing.assert_allclose(colour @ REC_601, grey, atol=1e-3)


def test_background_shows_through_at_edges_by_its_share() -> None:
    camera = orthographic(4, 1, 1.0, 0.0, 0.0, np.eye(3), np.zeros(3))
    bar = pill([-50.0, 0.0, 0.0], [-9.0, 0.0, 0.0], 10.75, 10.75)
    image = render(bar, camera, white(1, 200.0), FRONT, "binary", background=np.array([[0.0, 40.0, 80.0, 120.0]]))
    share = render(bar, camera, white(1), FRONT, "binary")[0, 2]
    assert 0.1 < share < 0.4
    np.testing.assert_allclose(image[0], [200.0, 200.0, 80.0 + 120.0 * share, 120.0], rtol=1e-5)


def test_no_pills_leave_the_background() -> None:
    nothing = Pills(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)))
    assert (render(nothing, CAMERA, white(0), FRONT, background=7.0) == 7.0).all()


def test_bad_arguments_are_named() -> None:
    good = white(4)
    with pytest.raises(ValueError, match=r"material: shares of light .* must be >= 0"):
        make_look(HAND, CAMERA, replace(good, diffuse=-0.1), FRONT)
    with pytest.raises(ValueError, match=r"light: direction \[0.0, 0.0, 0.0\]"):
        make_look(HAND, CAMERA, good, Light(np.zeros(3)))
    with pytest.raises(ValueError, match=r"facets: \(3, 4, 2\) is no body"):
        make_look(HAND, CAMERA, good, FRONT, facets=(3, 4, 2))
    with pytest.raises(ValueError, match=r"albedo has 3 rows; wanted one for each of 4 pills"):
        render(HAND, CAMERA, white(3), FRONT)
    with pytest.raises(ValueError, match=r"background: its height and width are \(5, 6\)"):
        render(HAND, CAMERA, good, FRONT, background=np.zeros((5, 6)))
