"""Samplers sit on the silhouette and point outwards; sampling is checked on images one can compute in the head."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from handtrack.camera import Camera, orthographic, perspective, project_camera, rays
from handtrack.pills import Pills, clearance, ray_hits
from handtrack.profiles import (
    CAP,
    SIDE,
    Samplers,
    cap_normals,
    contact_normals,
    place_across,
    place_outline,
    place_outline_numpy,
    place_tips,
    sample,
    sample_numpy,
    sample_points,
    uniform_spread,
    with_rays,
)

EYE, ZERO = np.eye(3), np.zeros(3)
BENT = np.array([0.12, -0.15, 0.002, -0.003, 0.04])
CAMERAS = {
    "orthographic": orthographic(320, 240, 1.5, 160.0, 120.0, EYE, ZERO),
    "perspective": perspective(320, 240, 450.0, 470.0, 150.0, 125.0, EYE, ZERO),
    "distorted": perspective(320, 240, 450.0, 470.0, 150.0, 125.0, EYE, ZERO, BENT),
}
cameras = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
METHODS = ("nearest", "bilinear", "bicubic")


def random_pills(seed: int, n: int = 10) -> Pills:
    """Pills of every slant and moderate taper, so that both sides and the cap have a silhouette."""
    rng = np.random.default_rng(seed)
    base = rng.uniform([-60, -40, 250], [60, 40, 400], (n, 3))
    axis = rng.normal(0, 1, (n, 3)) * [1.0, 1.0, 0.4]
    axis *= rng.uniform(30, 60, (n, 1)) / np.linalg.norm(axis, axis=1, keepdims=True)
    radius = rng.uniform(4, 12, (n, 1)) * rng.uniform(0.7, 1.3, (n, 2))
    return Pills(base, base + axis, radius)


def paths(origin: np.ndarray, direction: np.ndarray) -> Samplers:
    zero = np.zeros(len(origin), dtype=int)
    camera = CAMERAS["orthographic"]
    return with_rays(camera, origin, direction, zero, zero * 1.0, zero, zero, np.zeros((len(origin), 3)))


def row(x: float, y: float, angle: float = 0.0) -> Samplers:
    return paths(np.array([[x, y]]), np.array([[math.cos(angle), math.sin(angle)]]))


def clearance_at(pills: Pills, camera: Camera, link: np.ndarray, xy: np.ndarray) -> np.ndarray:
    return clearance(pills, link, *rays(camera, xy)).distance


@cameras
@pytest.mark.parametrize("seed", range(3))
def test_outline_samplers_start_on_the_silhouette(camera, seed):
    pills = random_pills(seed)
    samplers = place_outline(pills, camera, np.ones(10, dtype=bool))
    assert set(samplers.link) == set(range(10)) and set(samplers.kind) == {SIDE, CAP}
    np.testing.assert_allclose(clearance_at(pills, camera, samplers.link, samplers.origin), 0.0, atol=1e-7)
    np.testing.assert_allclose(project_camera(camera, samplers.contact), samplers.origin, atol=1e-9)


@cameras
@pytest.mark.parametrize("seed", range(3))
def test_outline_samplers_point_outwards(camera, seed):
    pills = random_pills(seed)
    samplers = place_outline(pills, camera, np.ones(10, dtype=bool))
    np.testing.assert_allclose(np.linalg.norm(samplers.direction, axis=1), 1.0, atol=1e-12)
    for u in (0.01, 0.5, 2.0):
        ahead, behind = samplers.origin + u * samplers.direction, samplers.origin - u * samplers.direction
        assert (clearance_at(pills, camera, samplers.link, ahead) > 0).all()
        assert (clearance_at(pills, camera, samplers.link, behind) < 0).all()


@pytest.mark.parametrize("kind", ["orthographic", "perspective"])
def test_direction_is_the_normal_of_the_silhouette_in_the_image(kind):
    camera, pills = CAMERAS[kind], random_pills(3)
    samplers = place_outline(pills, camera, np.ones(10, dtype=bool))
    h = 1e-4
    slope = np.stack(
        [
            clearance_at(pills, camera, samplers.link, samplers.origin + e)
            - clearance_at(pills, camera, samplers.link, samplers.origin - e)
            for e in h * np.eye(2)
        ],
        axis=1,
    )
    np.testing.assert_allclose(slope / np.linalg.norm(slope, axis=1, keepdims=True), samplers.direction, atol=1e-6)


@cameras
@pytest.mark.parametrize("seed", range(4))
def test_kernel_and_numpy_twin_place_the_same_samplers(camera, seed):
    pills = random_pills(seed)
    pills.radius[0] = (45.0, 6.0)  # its base hides its tip: no sides
    tips = np.arange(10) % 2 == 0
    kernel, twin = (place(pills, camera, tips) for place in (place_outline, place_outline_numpy))
    for name in ("link", "side", "kind"):
        np.testing.assert_array_equal(getattr(kernel, name), getattr(twin, name))
    for name in ("origin", "direction", "along", "contact", "ray", "slope"):
        np.testing.assert_allclose(getattr(kernel, name), getattr(twin, name), atol=1e-9)


@cameras
def test_rays_of_samplers_see_their_origin_and_what_lies_a_pixel_on(camera):
    samplers = place_outline(random_pills(3), camera, np.ones(10, dtype=bool))
    np.testing.assert_allclose(samplers.ray, np.hstack(rays(camera, samplers.origin)), atol=1e-12)
    for u in (-6.0, 1.0, 6.0):
        ahead = np.hstack(rays(camera, samplers.origin + u * samplers.direction))
        bend = 0.0 if camera.kind == "orthographic" or not camera.distortion.any() else 2e-5
        np.testing.assert_allclose(samplers.ray + u * samplers.slope, ahead, atol=1e-12 + bend)


@cameras
def test_contact_points_lie_on_the_surface_and_their_rays_graze(camera):
    pills = random_pills(4)
    link, side = np.repeat(np.arange(10), 2), np.tile([1.0, -1.0], 10)
    normal = contact_normals(pills, link, side, camera)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-12)
    for s in (0.0, 0.3, 1.0):  # one normal touches along the whole side
        radius = pills.radius[link, 0] + s * np.diff(pills.radius[link])[:, 0]
        contact = pills.base[link] + s * (pills.tip[link] - pills.base[link]) + radius[:, None] * normal
        sight = contact if camera.kind == "perspective" else np.tile([0.0, 0.0, 1.0], (20, 1))
        np.testing.assert_allclose((normal * sight).sum(axis=1), 0.0, atol=1e-9)
        np.testing.assert_allclose(clearance_at(pills, camera, link, project_camera(camera, contact)), 0.0, atol=1e-7)
    turn = np.cross(normal[::2], normal[1::2])[:, 2] * np.cross(pills.tip - pills.base, normal[::2])[:, 2]
    assert (turn != 0).all(), "the two sides differ"


@cameras
def test_where_one_sphere_hides_the_other_there_are_no_sides(camera):
    pills = Pills(np.array([[5.0, 3.0, 300.0]]), np.array([[6.0, 3.5, 320.0]]), np.array([[12.0, 5.0]]))
    assert np.isnan(contact_normals(pills, np.zeros(2, dtype=int), np.array([1.0, -1.0]), camera)).all()
    assert SIDE not in place_outline(pills, camera, np.array([True])).kind


@cameras
def test_cap_normals_graze_the_tip_and_fan_out_from_the_axis(camera):
    pills, fan = random_pills(5), np.radians([-90.0, -45.0, 0.0, 45.0, 90.0])
    link, angle = np.repeat(np.arange(10), 5), np.tile(fan, 10)
    normal = cap_normals(pills, link, angle, camera)
    contact = pills.tip[link] + pills.radius[link, 1, None] * normal
    sight = contact if camera.kind == "perspective" else np.tile([0.0, 0.0, 1.0], (50, 1))
    np.testing.assert_allclose((normal * sight).sum(axis=1), 0.0, atol=1e-9)
    along = (normal * (pills.tip - pills.base)[link]).sum(axis=1).reshape(10, 5)
    assert (along.argmax(axis=1) == 2).all(), "angle zero looks along the axis"
    np.testing.assert_allclose(along[:, 1], along[:, 3], atol=1e-9)


@cameras
def test_only_tips_have_a_fan_and_its_angles_are_free(camera):
    pills, tips = random_pills(6), np.arange(10) % 3 == 0
    default = place_outline(pills, camera, tips)
    assert np.bincount(default.link[default.kind == CAP], minlength=10).tolist() == (5 * tips).tolist()
    assert (default.side[default.kind == CAP] == 0).all() and (default.along[default.kind == CAP] == 1).all()
    assert set(default.side[default.kind == SIDE]) == {-1, 1}
    two = place_outline(pills, camera, tips, fan=np.array([-0.3, 0.3]))
    assert np.bincount(two.link[two.kind == CAP], minlength=10).tolist() == (2 * tips).tolist()


def test_side_samplers_are_spread_evenly_about_as_far_apart_as_wanted():
    base = np.array([[-60.0, 0.0, 300.0], [-60.0, 30.0, 300.0], [-60.0, 50.0, 300.0]])
    length = np.array([80.0, 4.0, 300.0])
    pills = Pills(base, base + length[:, None] * [1.0, 0.0, 0.0], np.full((3, 2), 6.0))
    samplers = place_outline(pills, CAMERAS["orthographic"], np.zeros(3, dtype=bool), spacing=8.0, most=20)
    for link, count in enumerate((15, 2, 20)):  # 120 px, too short, too long
        for side in (-1, 1):
            chosen = (samplers.link == link) & (samplers.side == side)
            np.testing.assert_allclose(samplers.along[chosen], uniform_spread(count))


def test_links_behind_the_camera_get_no_samplers():
    base = np.array([[0.0, 0.0, -300.0], [0.0, 0.0, 300.0]])
    pills = Pills(base, base + 40.0 * np.eye(3)[0], np.full((2, 2), 6.0))
    assert set(place_outline(pills, CAMERAS["perspective"], np.ones(2, dtype=bool)).link) == {1}


@given(st.integers(1, 60))
@settings(deadline=None)
def test_uniform_spread_leaves_equal_gaps_also_at_the_ends(count):
    gaps = np.diff(np.concatenate([[0.0], uniform_spread(count), [1.0]]))
    np.testing.assert_allclose(gaps, 1.0 / (count + 1), rtol=1e-9)


@cameras
def test_link_samplers_lie_across_the_axis_and_grow_towards_side_one(camera):
    pills = random_pills(7)
    across = place_across(pills, camera, 6)
    assert np.bincount(across.link).tolist() == [6] * 10
    axis_point = pills.base[across.link] + across.along[:, None] * (pills.tip - pills.base)[across.link]
    np.testing.assert_allclose(across.origin, project_camera(camera, axis_point), atol=1e-9)
    seen = project_camera(camera, pills.tip) - project_camera(camera, pills.base)
    np.testing.assert_allclose((across.direction * seen[across.link]).sum(axis=1), 0.0, atol=1e-9)
    towards = contact_normals(pills, across.link, np.ones(60), camera)[:, :2]
    assert ((across.direction * towards).sum(axis=1) > 0).all()


def test_a_link_seen_end_on_has_no_samplers_across():
    pills = Pills(np.array([[0.0, 0.0, 300.0]]), np.array([[0.0, 0.0, 340.0]]), np.array([[6.0, 6.0]]))
    assert place_across(pills, CAMERAS["orthographic"]).link.size == 0


def test_tip_samplers_head_along_their_line():
    pills = random_pills(8)
    samplers = place_tips(
        pills,
        CAMERAS["perspective"],
        np.array([2, 5]),
        np.array([[9.0, 4.0], [1.0, 2.0]]),
        np.array([[3.0, 4.0], [-2.0, 0.0]]),
    )
    np.testing.assert_allclose(samplers.direction, [[0.6, 0.8], [-1.0, 0.0]])
    assert samplers.kind.tolist() == [CAP, CAP] and samplers.link.tolist() == [2, 5]


def test_profile_of_a_ramp_reads_its_place():
    ramp = np.tile(np.arange(10.0), (6, 1)).astype(np.float32)
    u = np.array([-1.5, 0.0, 0.25, 2.0])
    assert sample(ramp, row(3.0, 2.0), u, "bilinear").values.tolist() == [[1.5, 3.0, 3.25, 5.0]]
    assert sample(ramp, row(3.0, 2.0), u, "bicubic").values.tolist() == [[1.5, 3.0, 3.25, 5.0]]
    assert sample(ramp, row(3.2, 2.0), u, "nearest").values.tolist() == [[2.0, 3.0, 3.0, 5.0]]
    down = sample(ramp.T.copy(), row(2.0, 3.0, math.pi / 2), u, "bilinear")
    np.testing.assert_allclose(down.values, [[1.5, 3.0, 3.25, 5.0]], atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_constant_image_is_constant_everywhere_inside(method):
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 7, 200)
    lines = paths(rng.uniform([0, 0], [19, 14], (200, 2)), np.stack([np.cos(angle), np.sin(angle)], axis=1))
    profiles = sample(np.full((15, 20), 7.25, dtype=np.float32), lines, np.linspace(-20, 20, 81), method)
    assert profiles.inside.any() and not profiles.inside.all()
    np.testing.assert_allclose(profiles.values[profiles.inside], 7.25, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_kernel_and_numpy_twin_sample_alike(method, dtype):
    rng = np.random.default_rng(1)
    image, angle = rng.uniform(0, 255, (33, 41)).astype(dtype), rng.uniform(0, 7, 300)
    lines = paths(rng.uniform([-3, -3], [43, 35], (300, 2)), np.stack([np.cos(angle), np.sin(angle)], axis=1))
    u = np.linspace(-30, 30, 61)
    kernel, twin = sample(image, lines, u, method), sample_numpy(image, lines, u, method)
    np.testing.assert_array_equal(kernel.inside, twin.inside)
    np.testing.assert_allclose(kernel.values, twin.values, atol=1e-4 if dtype == np.float32 else 1e-10)
    np.testing.assert_array_equal(kernel.u, u)


@given(*[st.floats(-3, 3) for _ in range(6)], st.floats(2, 9), st.floats(2, 7), st.floats(0, 7))
@settings(max_examples=60, deadline=None)
def test_bicubic_reproduces_quadratics_away_from_the_border(a, b, c, d, e, f, x, y, angle):
    def surface(x, y):
        return a + b * x + c * y + d * x * x + e * x * y + f * y * y

    v, w = np.mgrid[:10, :12].astype(float)
    profile = sample(surface(w, v), row(x, y, angle), np.linspace(-1, 1, 9), "bicubic")
    xs, ys = x + profile.u * math.cos(angle), y + profile.u * math.sin(angle)
    np.testing.assert_allclose(profile.values[0], surface(xs, ys), atol=1e-9)


def test_bilinear_is_that_of_scipy_and_within_the_rounding_of_opencv():
    rng = np.random.default_rng(2)
    image = rng.uniform(0, 255, (30, 40)).astype(np.float32)
    x, y = rng.uniform(0, 39, 500), rng.uniform(0, 29, 500)
    found = sample(image, paths(np.column_stack([x, y]), np.tile([1.0, 0.0], (500, 1))), np.zeros(1))
    assert found.inside.all()
    np.testing.assert_allclose(found.values[:, 0], map_coordinates(image.astype(float), [y, x], order=1), atol=1e-4)
    theirs = cv2.remap(image, x[None].astype(np.float32), y[None].astype(np.float32), cv2.INTER_LINEAR)[0]
    steepest = max(np.abs(np.diff(image, axis=i)).max() for i in (0, 1))
    assert np.abs(found.values[:, 0] - theirs).max() < 2 * steepest / 32  # OpenCV rounds places to 1/32 of a pixel


@pytest.mark.parametrize("method", METHODS)
def test_beyond_the_outermost_pixel_centres_nothing_is_inside(method):
    image = np.full((5, 8), 100.0)
    u = np.array([-0.01, 0.0, 7.0, 7.01, 200.0])
    assert sample(image, row(0.0, 2.0), u, method).inside.tolist() == [[False, True, True, False, False]]
    assert sample(image, row(3.0, 4.01), np.zeros(1), method).inside.tolist() == [[False]]
    assert sample(image, row(3.0, 4.0), np.zeros(1), method).values.tolist() == [[100.0]]
    assert sample(image, row(-50.0, 2.0), u, method).values[0, 0] == 0.0, "no border pixel is repeated"


@pytest.mark.parametrize("method", METHODS)
def test_single_points_are_sampled_like_paths(method):
    rng = np.random.default_rng(3)
    image, xy = rng.uniform(0, 255, (9, 12)), rng.uniform(-2, 13, (80, 2))
    values, inside = sample_points(image, xy, method)
    on_paths = sample(image, paths(xy, np.tile([1.0, 0.0], (80, 1))), np.zeros(1), method)
    np.testing.assert_array_equal(values, on_paths.values[:, 0])
    np.testing.assert_array_equal(inside, on_paths.inside[:, 0])


def test_a_silhouette_sampler_sees_the_pill_on_its_inner_half_only():
    camera, pills = CAMERAS["perspective"], random_pills(9, 1)
    samplers = place_outline(pills, camera, np.array([True]))
    u, v = np.meshgrid(np.arange(320.0), np.arange(240.0))
    hit = ray_hits(pills, *rays(camera, np.column_stack([u.ravel(), v.ravel()]))).pill >= 0
    image = np.where(hit.reshape(240, 320), 200.0, 0.0)
    profiles = sample(image, samplers, np.array([-2.0, 2.0]), "nearest")
    np.testing.assert_array_equal(profiles.values, np.tile([200.0, 0.0], (samplers.link.size, 1)))
