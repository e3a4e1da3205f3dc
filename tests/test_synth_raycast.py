"""The renderer's rays against oracles: distance to the axis, analytic silhouettes, finite differences."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.camera import Camera, orthographic, perspective, project_camera, rays
from handtrack.pills import Pills, ray_hits
from synth.raycast import cast, cast_numpy, hull_box, pill_boxes, pixel_grid, surface_points

BENT = np.array([-0.25, 0.08, 0.002, -0.003, 0.01])
ORTHOGRAPHIC = orthographic(96, 72, 1.7, 40.137, 33.291, np.eye(3), np.zeros(3))
PERSPECTIVE = perspective(96, 72, 110.0, 115.0, 45.0, 35.0, np.eye(3), np.zeros(3))
DISTORTED = replace(PERSPECTIVE, distortion=BENT)
CAMERAS = pytest.mark.parametrize(
    "camera", [ORTHOGRAPHIC, PERSPECTIVE, DISTORTED], ids=["orthographic", "perspective", "bent"]
)
HAND = Pills(
    np.array([[-12.0, -6.0, 80.0], [8.0, 2.0, 78.0], [-15.0, 12.0, 90.0], [5.0, -14.0, 70.0], [0.0, 0.0, 60.0]]),
    np.array([[8.0, 2.0, 78.0], [20.0, 12.0, 70.0], [22.0, -9.0, 95.0], [6.0, -13.0, 70.5], [0.0, 1.0, 110.0]]),
    np.array([[4.0, 4.0], [4.0, 2.5], [3.0, 5.0], [1.0, 4.0], [2.0, 2.0]]),
)


def distance_to_pill(p: np.ndarray, pills: Pills, link: int, steps: int = 20001) -> np.ndarray:
    """Oracle: distance of points from the union of a pill's spheres, by dense sampling along the axis."""
    s = np.linspace(0.0, 1.0, steps)
    centres = pills.base[link] + s[:, None] * (pills.tip[link] - pills.base[link])
    radii = pills.radius[link, 0] + s * (pills.radius[link, 1] - pills.radius[link, 0])
    return np.array([(np.linalg.norm(centres - x, axis=1) - radii).min() for x in p])


@CAMERAS
def test_hits_lie_on_the_surface_and_rays_before_them_are_outside(camera: Camera) -> None:
    buffers = cast(HAND, camera)
    v, u = np.nonzero(buffers.part >= 0)
    some = np.random.default_rng(1).choice(v.size, 60, replace=False)
    v, u = v[some], u[some]
    xy = pixel_grid(camera)[v + 1, u + 1]
    p = surface_points(camera, xy, buffers.depth[v, u])
    nearer = surface_points(camera, xy, buffers.depth[v, u] - 0.05)
    for i in range(v.size):
        on = [float(distance_to_pill(p[i : i + 1], HAND, k)[0]) for k in range(5)]
        assert abs(on[buffers.part[v[i], u[i]]]) < 1e-6
        assert min(on) > -1e-6
        assert min(float(distance_to_pill(nearer[i : i + 1], HAND, k)[0]) for k in range(5)) > 0.0


@CAMERAS
def test_kernel_agrees_with_its_twin_and_with_the_rays_of_the_tracker(camera: Camera) -> None:
    fast, plain = cast(HAND, camera), cast_numpy(HAND, camera)
    np.testing.assert_array_equal(fast.part, plain.part)
    np.testing.assert_allclose(fast.depth, plain.depth, rtol=1e-12)
    np.testing.assert_allclose(fast.normal, plain.normal, atol=1e-12)
    v, u = np.mgrid[: camera.height, : camera.width]
    hits = ray_hits(HAND, *rays(camera, np.stack([u.ravel(), v.ravel()], axis=1).astype(float)))
    np.testing.assert_array_equal(fast.part.ravel(), hits.pill)
    np.testing.assert_allclose(fast.depth.ravel(), hits.t, rtol=1e-9)
    seen = hits.pill >= 0
    np.testing.assert_allclose(fast.normal.reshape(-1, 3)[seen], hits.normal[seen], atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(-25, 25), min_size=6, max_size=6),
    st.tuples(st.floats(0.5, 9.0), st.floats(0.5, 9.0)),
    st.sampled_from([ORTHOGRAPHIC, PERSPECTIVE, DISTORTED]),
)
def test_any_pill_is_hit_where_its_twin_and_the_tracker_hit_it(
    ends: list[float], radius: tuple[float, float], camera: Camera
) -> None:
    base, tip = np.array(ends).reshape(2, 3) + np.array([0.0, 0.0, 60.0])
    pill = Pills(base[None], tip[None], np.array([radius]))
    fast, plain = cast(pill, camera), cast_numpy(pill, camera)
    np.testing.assert_array_equal(fast.part, plain.part)
    v, u = np.mgrid[: camera.height, : camera.width]
    hits = ray_hits(pill, *rays(camera, np.stack([u.ravel(), v.ravel()], axis=1).astype(float)))
    both = (hits.pill >= 0) & (fast.part.ravel() >= 0)
    assert ((hits.pill >= 0) != (fast.part.ravel() >= 0)).sum() <= 1  # a ray that touches may fall either way
    np.testing.assert_allclose(fast.depth.ravel()[both], hits.t[both], rtol=1e-6)


@pytest.mark.parametrize("camera", [ORTHOGRAPHIC, PERSPECTIVE], ids=["orthographic", "perspective"])
def test_normals_are_those_of_the_depth(camera: Camera) -> None:
    fine = replace(
        camera, width=768, height=576, fx=8 * camera.fx, fy=8 * camera.fy, cx=8 * camera.cx, cy=8 * camera.cy
    )
    buffers = cast(HAND, fine)
    xy = pixel_grid(fine)[1:-1, 1:-1]
    depth = np.where(np.isfinite(buffers.depth), buffers.depth, np.nan)
    p = surface_points(fine, xy.reshape(-1, 2), depth.ravel()).reshape(*depth.shape, 3)
    with np.errstate(invalid="ignore"):
        along, down = p[1:-1, 2:] - p[1:-1, :-2], p[2:, 1:-1] - p[:-2, 1:-1]
        n = np.cross(down, along)
        n /= np.linalg.norm(n, axis=2, keepdims=True)
    part = buffers.part
    inner = (part >= 0)[1:-1, 1:-1]
    for rows, cols in (
        (slice(2, None), slice(1, -1)),
        (slice(None, -2), slice(1, -1)),
        (slice(1, -1), slice(2, None)),
        (slice(1, -1), slice(None, -2)),
    ):
        inner &= part[rows, cols] == part[1:-1, 1:-1]
    inner &= buffers.normal[1:-1, 1:-1, 2] < -0.8
    assert inner.sum() > 10_000
    off = np.abs(n[inner] - buffers.normal[1:-1, 1:-1][inner]).max(axis=1)
    assert np.quantile(off, 0.99) < 5e-3 and off.max() < 0.02  # the curvature jumps where a cap meets the side
    np.testing.assert_allclose(np.linalg.norm(buffers.normal[part >= 0], axis=1), 1.0, atol=1e-9)


def test_ties_on_a_shared_sphere_go_to_the_first_link() -> None:
    chain = Pills(
        np.array([[-9.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
        np.array([[0.0, 0.0, 0.0], [6.0, 7.0, 0.3]]),
        np.full((2, 2), 4.0),
    )
    camera = orthographic(160, 160, 6.0, 80.0, 80.0, np.eye(3), np.zeros(3))
    buffers = cast(chain, camera)
    v, u = np.nonzero(buffers.part >= 0)
    p = surface_points(camera, pixel_grid(camera)[v + 1, u + 1], buffers.depth[v, u])
    shared = np.abs(np.linalg.norm(p, axis=1) - 4.0) < 1e-12
    wedge = shared & (p[:, 0] > 1e-6) & (p @ (chain.tip[1] / np.linalg.norm(chain.tip[1])) < -1e-6)
    assert wedge.sum() > 30 and (buffers.part[v, u][wedge] == 0).all()


@CAMERAS
def test_boxes_hold_everything_that_is_seen(camera: Camera) -> None:
    for k in range(5):
        one = Pills(HAND.base[k : k + 1], HAND.tip[k : k + 1], HAND.radius[k : k + 1])
        (x0, x1, y0, y1) = pill_boxes(one, camera)[0]
        v, u = np.mgrid[: camera.height, : camera.width]
        hits = ray_hits(one, *rays(camera, np.stack([u.ravel(), v.ravel()], axis=1).astype(float))).pill.reshape(
            u.shape
        )
        assert (hits[y0:y1, x0:x1] >= 0).sum() == (hits >= 0).sum() > 0


def test_a_pill_around_or_behind_the_pinhole_is_no_hit() -> None:
    behind = Pills(
        np.array([[0.0, 0.0, -30.0], [0.0, 0.0, -4.0]]),
        np.array([[3.0, 0.0, -20.0], [0.0, 0.0, 50.0]]),
        np.full((2, 2), 5.0),
    )
    assert (cast(behind, PERSPECTIVE).part == -1).all()
    np.testing.assert_array_equal(cast(behind, PERSPECTIVE).part, cast_numpy(behind, PERSPECTIVE).part)
    # Ahead of it is still seen past the one behind.
    both = Pills(
        np.vstack([behind.base[:1], [[0.0, 0.0, 60.0]]]), np.vstack([behind.tip[:1], [[5.0, 0.0, 60.0]]]), behind.radius
    )
    assert set(np.unique(cast(both, PERSPECTIVE).part)) == {-1, 1}


def test_no_pills_give_an_empty_picture() -> None:
    nothing = Pills(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)))
    assert (cast(nothing, ORTHOGRAPHIC).part == -1).all() and np.isinf(cast(nothing, ORTHOGRAPHIC).depth).all()
    assert hull_box(pill_boxes(nothing, ORTHOGRAPHIC), ORTHOGRAPHIC) == (0, 0, 0, 0)


def test_grid_is_the_inverse_of_the_projection() -> None:
    grid = pixel_grid(DISTORTED)
    p = np.concatenate([grid, np.ones((*grid.shape[:2], 1))], axis=2)
    u, v = np.meshgrid(np.arange(-1.0, 97.0), np.arange(-1.0, 73.0))
    np.testing.assert_allclose(project_camera(DISTORTED, p), np.stack([u, v], axis=2), atol=1e-9)


@pytest.mark.parametrize(("r0", "r1", "length"), [(5.0, 5.0, 20.0), (6.0, 3.0, 17.0), (2.0, 7.0, 3.0)])
def test_orthographic_silhouette_has_the_area_of_the_hull_of_two_circles(r0: float, r1: float, length: float) -> None:
    camera = orthographic(400, 240, 10.0, 120.37, 117.21, np.eye(3), np.zeros(3))
    pill = Pills(np.array([[0.0, 0.0, 4.0]]), np.array([[length, 0.0, 4.0]]), np.array([[r0, r1]]))
    area = (cast(pill, camera).part >= 0).sum() / 100.0
    if length <= abs(r0 - r1):
        wanted = math.pi * max(r0, r1) ** 2
    else:
        lean = math.asin((r0 - r1) / length)  # tangent points lie at angle pi/2 -+ lean from the axis
        wanted = (math.pi / 2 + lean) * r0**2 + (math.pi / 2 - lean) * r1**2 + (r0 + r1) * length * math.cos(lean)
    assert area == pytest.approx(wanted, rel=2e-3)


def test_perspective_silhouette_of_a_ball_is_the_ellipse_of_its_tangent_cone() -> None:
    camera = perspective(640, 480, 500.0, 500.0, 300.0, 240.0, np.eye(3), np.zeros(3))
    centre, r = np.array([9.0, -5.0, 40.0]), 7.0
    ball = Pills(centre[None], centre[None] + 1e-9, np.full((1, 2), r))
    v, u = np.mgrid[:480, :640]
    d = np.stack([(u - 300.0) / 500.0, (v - 240.0) / 500.0, np.ones(u.shape)], axis=2)
    cosine = d @ centre / np.linalg.norm(d, axis=2) / np.linalg.norm(centre)
    inside = cosine >= math.sqrt(1.0 - r * r / (centre @ centre))
    np.testing.assert_array_equal(cast(ball, camera).part >= 0, inside)
