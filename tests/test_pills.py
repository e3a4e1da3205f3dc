"""Pills: hits and clearances against minimisation over the spheres they are made of, which knows no cones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.camera import Camera, orthographic, perspective, rays
from handtrack.kinematics import forward, link_ends
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.pills import Pills, clearance, pose_pills, ray_hits, ray_hits_numpy

EYE, ZERO = np.eye(3), np.zeros(3)
CAMERAS = {
    "orthographic": orthographic(320, 240, 1.5, 160.0, 120.0, EYE, ZERO),
    "perspective": perspective(
        320, 240, 450.0, 470.0, 160.0, 120.0, EYE, ZERO, np.array([0.1, -0.1, 1e-3, -2e-3, 0.0])
    ),
}
cameras = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
GOLDEN = 0.5 * (5**0.5 - 1)


def lowest(f, low: np.ndarray, high: np.ndarray, steps: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Place and value of the minimum of convex functions, one for each entry, by golden sections."""
    a, b = low.astype(float), high.astype(float)
    for _ in range(steps):
        c, d = b - GOLDEN * (b - a), a + GOLDEN * (b - a)
        left = f(c) < f(d)
        a, b = np.where(left, a, c), np.where(left, d, b)
    ends = np.stack([low + 0.0 * a, 0.5 * (a + b), high + 0.0 * a])
    values = np.stack([f(x) for x in ends])
    best = values.argmin(axis=0)
    return np.take_along_axis(ends, best[None], axis=0)[0], np.take_along_axis(values, best[None], axis=0)[0]


def gap(pills: Pills, k: np.ndarray, p: np.ndarray) -> np.ndarray:
    """`min_s |p - c(s)| - r(s)` of each point from the pill named for it: zero on the surface, negative inside."""

    def of(s):
        centre = pills.base[k] + s[:, None] * (pills.tip[k] - pills.base[k])
        return np.linalg.norm(p - centre, axis=1) - (pills.radius[k, 0] + s * (pills.radius[k, 1] - pills.radius[k, 0]))

    return lowest(of, np.zeros(len(k)), np.ones(len(k)))[1]


def random_pills(seed: int, n: int = 8) -> Pills:
    """Pills of every slant and taper; in some, one sphere holds the other, and some are a single sphere."""
    rng = np.random.default_rng(seed)
    base = rng.uniform([-70, -50, 250], [70, 50, 400], (n, 3))
    tip = base + rng.normal(0, 30, (n, 3))
    radius = rng.uniform(3, 22, (n, 2))
    radius[: n // 4, 1] = radius[: n // 4, 0]  # capsules
    tip[-1] = base[-1] + [2.0, 1.0, -1.0]
    radius[-1] = (20.0, 9.0)  # the base sphere holds the tip's
    tip[-2] = base[-2]
    radius[-2] = (8.0, 8.0)  # no length at all
    return Pills(base, tip, radius)


def pixel_rays(camera: Camera, step: float = 6.0) -> tuple[np.ndarray, np.ndarray]:
    xy = np.stack(np.meshgrid(np.arange(0, 320, step), np.arange(0, 240, step)), axis=-1).reshape(-1, 2)
    return rays(camera, xy)


@cameras
@pytest.mark.parametrize("seed", range(3))
def test_hits_lie_on_the_surface_of_the_pill_they_name(camera, seed):
    pills = random_pills(seed)
    origin, direction = pixel_rays(camera)
    hits = ray_hits(pills, origin, direction)
    on = hits.pill >= 0
    assert 100 < on.sum() < on.size
    p = origin[on] + hits.t[on, None] * direction[on]
    np.testing.assert_allclose(gap(pills, hits.pill[on], p), 0.0, atol=1e-8)
    assert np.isinf(hits.t[~on]).all()


@cameras
def test_nothing_lies_in_front_of_a_hit_and_nothing_on_a_ray_that_missed(camera):
    pills = random_pills(1, 6)
    origin, direction = pixel_rays(camera, 32.0)
    n, links = origin.shape[0], pills.base.shape[0]
    hits = ray_hits(pills, origin, direction)
    until = np.where(hits.pill >= 0, hits.t, 1000.0) - 1e-6
    # Every ray with every pill at once.
    link, o, d = np.repeat(np.arange(links), n), np.tile(origin, (links, 1)), np.tile(direction, (links, 1))

    def along(t):
        return gap(pills, link, o + t[:, None] * d)

    assert lowest(along, np.zeros(link.size), np.tile(until, links))[1].min() > -1e-9
    nearest = clearance(pills, link, o, d).distance
    closest = lowest(along, np.zeros(link.size), np.full(link.size, 1000.0))[1]
    sure = np.abs(nearest) > 1e-6
    np.testing.assert_array_equal((closest < 0)[sure], (nearest < 0)[sure])


@cameras
def test_normals_are_the_gradient_of_the_distance(camera):
    pills = random_pills(5)
    origin, direction = pixel_rays(camera)
    hits = ray_hits(pills, origin, direction)
    on = hits.pill >= 0
    p, pill = origin[on] + hits.t[on, None] * direction[on], hits.pill[on]
    h = 1e-4
    steps = h * np.eye(3)
    gradient = np.stack([(gap(pills, pill, p + e) - gap(pills, pill, p - e)) / (2 * h) for e in steps], axis=1)
    np.testing.assert_allclose(hits.normal[on], gradient, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(hits.normal[on], axis=1), 1.0, atol=1e-12)
    assert ((hits.normal[on] * direction[on]).sum(axis=1) < 1e-7).all(), "a first hit faces the viewer"


@cameras
@pytest.mark.parametrize("seed", range(6))
def test_kernel_and_numpy_twin_hit_alike(camera, seed):
    pills = random_pills(seed, 12)
    origin, direction = pixel_rays(camera, 3.0)
    kernel, twin = ray_hits(pills, origin, direction), ray_hits_numpy(pills, origin, direction)
    np.testing.assert_array_equal(kernel.pill, twin.pill)
    np.testing.assert_allclose(kernel.t, twin.t, rtol=1e-12, atol=1e-9)
    seen = kernel.pill >= 0
    np.testing.assert_allclose(kernel.normal[seen], twin.normal[seen], atol=1e-8)


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda x: round(x, 6))


@given(
    start=st.tuples(*[number(-60, 60)] * 3),
    aim=st.tuples(*[number(-12, 12)] * 3),
    tip=st.tuples(*[number(-30, 30)] * 3),
    radius=st.tuples(number(0.5, 15), number(0.5, 15)),
    speed=number(0.1, 9),
)
@settings(max_examples=150, deadline=None)
def test_any_ray_from_outside_hits_where_it_first_touches(start, aim, tip, radius, speed):
    pills = Pills(np.zeros((1, 3)), np.array([tip]), np.array([radius]))
    origin, target = np.array([start]), np.array([aim])
    which = np.array([0])
    if gap(pills, which, origin)[0] < 1e-3 or np.linalg.norm(target - origin) < 1e-3:
        return
    direction = speed * (target - origin) / np.linalg.norm(target - origin)
    hits = ray_hits(pills, origin, direction)
    nearest = clearance(pills, which, origin, direction)
    if abs(nearest.distance[0]) < 1e-6:  # grazing: either answer is right
        return
    assert (hits.pill[0] == 0) == (nearest.distance[0] < 0)
    if hits.pill[0] == 0:
        p = origin + hits.t[:, None] * direction
        assert abs(gap(pills, which, p)[0]) < 1e-7
        assert hits.normal[0] @ direction[0] < 0


def test_rays_along_the_axis_hit_the_caps():
    pills = Pills(np.array([[0.0, 0.0, 50.0]]), np.array([[0.0, 0.0, 90.0]]), np.array([[6.0, 9.0]]))
    origin = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [8.0, 0.0, 0.0], [9.5, 0.0, 0.0]])
    hits = ray_hits(pills, origin, np.tile([0.0, 0.0, 1.0], (4, 1)))
    assert hits.pill.tolist() == [0, 0, 0, -1]
    np.testing.assert_allclose(hits.t[:2], [44.0, 50.0 - np.sqrt(36 - 25)], atol=1e-12)
    # Seen along the axis the cone meets the tip's sphere at x = r1 cos, so 8 mm off the axis the side is hit.
    np.testing.assert_allclose(gap(pills, np.array([0]), origin[[2]] + [[0, 0, hits.t[2]]]), 0.0, atol=1e-9)


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("offset", [0.0, 1e-9, 3.0, 5.0])
def test_a_sphere_that_holds_the_other_is_all_there_is(swap, offset):
    ends, radius = np.array([[1.0, 2.0, 80.0], [1.0 + offset, 2.0, 80.0]]), [10.0, 5.0]
    order = [1, 0] if swap else [0, 1]
    pills = Pills(ends[order][:1], ends[order][1:], np.array([radius])[:, order])
    ball = Pills(ends[:1], ends[:1], np.array([[10.0, 10.0]]))
    origin, direction = pixel_rays(CAMERAS["perspective"], 4.0)
    found, wanted = ray_hits(pills, origin, direction), ray_hits(ball, origin, direction)
    np.testing.assert_array_equal(found.pill, wanted.pill)
    np.testing.assert_allclose(found.t, wanted.t, rtol=1e-12)
    np.testing.assert_allclose(found.normal, wanted.normal, atol=1e-9)
    which = np.zeros(origin.shape[0], dtype=int)
    a, b = (clearance(p, which, origin, direction).distance for p in (pills, ball))
    np.testing.assert_allclose(a, b, atol=1e-9)


def test_the_nearest_of_several_pills_wins_whatever_their_order():
    pills = random_pills(8)
    origin, direction = pixel_rays(CAMERAS["perspective"])
    hits = ray_hits(pills, origin, direction)
    order = np.random.default_rng(0).permutation(pills.base.shape[0])
    mixed = ray_hits(Pills(pills.base[order], pills.tip[order], pills.radius[order]), origin, direction)
    np.testing.assert_array_equal(mixed.t, hits.t)
    seen = hits.pill >= 0
    np.testing.assert_array_equal(order[mixed.pill[seen]], hits.pill[seen])


def test_rays_are_hit_far_from_the_camera_as_exactly_as_near():
    near, far = 300.0, 3e6
    for depth in (near, far):
        pills = Pills(np.array([[0.0, 0.0, depth]]), np.array([[20.0, 0.0, depth]]), np.array([[5.0, 4.0]]))
        hits = ray_hits(pills, np.array([[10.0, 4.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]))
        np.testing.assert_allclose(gap(pills, np.array([0]), np.array([[10.0, 4.0, hits.t[0]]])), 0.0, atol=1e-8)


def test_no_pills_are_never_hit():
    none = Pills(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)))
    for find in (ray_hits, ray_hits_numpy):
        hits = find(none, np.zeros((2, 3)), np.ones((2, 3)))
        assert hits.pill.tolist() == [-1, -1] and np.isinf(hits.t).all()


@cameras
@pytest.mark.parametrize("seed", range(3))
def test_clearance_is_the_least_distance_from_the_spheres(camera, seed):
    pills, rng = random_pills(seed, 12), np.random.default_rng(seed)
    origin, direction = rays(camera, rng.uniform([0, 0], [320, 240], (600, 2)))
    link = rng.integers(0, 12, 600)
    found = clearance(pills, link, origin, direction)
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)

    def at(s):
        m = pills.base[link] + s[:, None] * (pills.tip[link] - pills.base[link]) - origin
        across = m - (m * unit).sum(axis=1, keepdims=True) * unit
        return np.linalg.norm(across, axis=1) - (pills.radius[link, 0] + s * np.diff(pills.radius[link])[:, 0])

    np.testing.assert_allclose(found.distance, lowest(at, np.zeros(600), np.ones(600))[1], atol=1e-9)
    np.testing.assert_allclose(at(found.along), found.distance, atol=1e-9)
    assert ((found.along >= 0) & (found.along <= 1)).all()


@cameras
def test_clearance_tells_hits_from_misses(camera):
    pills = random_pills(4)
    origin, direction = pixel_rays(camera, 4.0)
    for k in range(pills.base.shape[0]):
        one = Pills(pills.base[[k]], pills.tip[[k]], pills.radius[[k]])
        distance = clearance(pills, np.full(origin.shape[0], k), origin, direction).distance
        sure = np.abs(distance) > 1e-9
        np.testing.assert_array_equal((ray_hits(one, origin, direction).pill == 0)[sure], (distance < 0)[sure])


@cameras
def test_normal_and_depth_of_a_clearance_lead_from_axis_to_ray(camera):
    pills, rng = random_pills(6), np.random.default_rng(0)
    origin, direction = rays(camera, rng.uniform([0, 0], [320, 240], (200, 2)))
    link = rng.integers(0, 8, 200)
    found = clearance(pills, link, origin, direction)
    centre = pills.base[link] + found.along[:, None] * (pills.tip[link] - pills.base[link])
    radius = pills.radius[link, 0] + found.along * np.diff(pills.radius[link])[:, 0]
    reached = centre + (found.distance + radius)[:, None] * found.normal
    np.testing.assert_allclose(reached, origin + found.depth[:, None] * direction, atol=1e-9)
    np.testing.assert_allclose((found.normal * direction).sum(axis=1), 0.0, atol=1e-10)


def test_a_ray_through_the_axis_has_no_normal_but_a_distance():
    pills = Pills(np.array([[0.0, 0.0, 9.0]]), np.array([[4.0, 0.0, 9.0]]), np.array([[2.0, 2.0]]))
    found = clearance(pills, np.array([0]), np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert found.distance.tolist() == [-2.0]
    assert found.normal.tolist() == [[0.0, 0.0, 0.0]]


@cameras
def test_posed_pills_are_the_links_in_camera_axes(camera):
    model = builtin_model("full_hand")
    R = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turned = Camera(camera.kind, 320, 240, 450.0, 470.0, 160.0, 120.0, R, np.array([1.0, -2.0, 300.0]), np.zeros(5))
    frames = forward(model, np.full(21, 0.2))
    base, tip = link_ends(model, frames)
    pills = pose_pills(model, frames, turned)
    np.testing.assert_allclose(pills.base, base @ R.T + turned.t, atol=1e-11)
    np.testing.assert_allclose(pills.tip, tip @ R.T + turned.t, atol=1e-11)
    np.testing.assert_array_equal(pills.radius, model.link_radius)
