"""Cameras: OpenCV as an independent oracle, derivatives by differences, and the matrices of appendix C."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.camera import (
    Camera,
    camera_from_world,
    distort,
    orthographic,
    perspective,
    pixels_per_unit,
    project,
    project_camera,
    project_with_jacobian,
    projection_matrix,
    projection_matrix_4x4,
    rays,
    undistort,
)

R = cv2.Rodrigues(np.array([0.4, -0.7, 0.2]))[0]
T = np.array([12.0, -7.0, 400.0])
BENT = np.array([0.12, -0.15, 0.002, -0.003, 0.04])
CAMERAS = {
    "orthographic": orthographic(640, 480, 2.5, 300.0, 250.0, R, T),
    "perspective": perspective(640, 480, 700.0, 720.0, 310.0, 235.0, R, T),
    "distorted": perspective(640, 480, 700.0, 720.0, 310.0, 235.0, R, T, BENT),
}
cameras = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
POINTS = np.random.default_rng(0).uniform(-90, 90, (300, 3))


@pytest.mark.parametrize("k", [np.zeros(5), BENT, -BENT, np.array([0.0, 0.0, 0.01, 0.02, 0.0])])
def test_perspective_projection_is_that_of_opencv(k):
    camera = perspective(640, 480, 700.0, 720.0, 310.0, 235.0, R, T, k)
    K = np.array([[700.0, 0, 310], [0, 720, 235], [0, 0, 1]])
    expected = cv2.projectPoints(POINTS, cv2.Rodrigues(R)[0], T, K, k)[0].reshape(-1, 2)
    np.testing.assert_allclose(project(camera, POINTS), expected, atol=1e-9)


def test_orthographic_projection_scales_and_ignores_depth():
    camera = CAMERAS["orthographic"]
    xy = project(camera, POINTS)
    np.testing.assert_allclose(xy, (POINTS @ R.T + T)[:, :2] * 2.5 + [300, 250], atol=1e-10)
    np.testing.assert_allclose(project(camera, POINTS + 77.0 * R[2]), xy, atol=1e-9)


def test_orthographic_is_perspective_from_infinity():
    distance = 1e7
    far = perspective(640, 480, 2.5 * distance, 2.5 * distance, 300.0, 250.0, R, [T[0], T[1], distance] * np.ones(3))
    np.testing.assert_allclose(project(far, POINTS), project(CAMERAS["orthographic"], POINTS), atol=0.01)


@cameras
def test_any_batch_of_points_projects_like_the_single_ones(camera):
    batch = project(camera, POINTS.reshape(3, 100, 3))
    assert batch.shape == (3, 100, 2)
    np.testing.assert_array_equal(batch.reshape(-1, 2), project(camera, POINTS))
    np.testing.assert_allclose(project(camera, POINTS[7]), batch[0, 7], atol=1e-11)
    np.testing.assert_array_equal(project_camera(camera, camera_from_world(camera, POINTS)), project(camera, POINTS))


@cameras
def test_derivative_equals_central_differences(camera):
    xy, d = project_with_jacobian(camera, POINTS)
    np.testing.assert_allclose(xy, project(camera, POINTS), atol=1e-12)
    h = 1e-3
    for i in range(3):
        step = h * np.eye(3)[i]
        near, far = (project(camera, POINTS + n * step) - project(camera, POINTS - n * step) for n in (1, 2))
        np.testing.assert_allclose(d[:, :, i], (8 * near - far) / (12 * h), atol=1e-8)


@cameras
@given(x=st.floats(-0.5, 639.5), y=st.floats(-0.5, 479.5), depth=st.floats(1.0, 1e5))
@settings(max_examples=60, deadline=None)
def test_every_point_of_a_ray_projects_to_its_pixel(camera, x, y, depth):
    xy = np.array([[x, y]])
    origin, direction = rays(camera, xy)
    assert direction[0, 2] == 1.0
    np.testing.assert_allclose(project_camera(camera, origin + depth * direction), xy, atol=1e-8)
    assert (origin + depth * direction)[0, 2] == depth, "the ray parameter is the depth"


@cameras
def test_rays_of_a_camera_start_where_its_kind_says(camera):
    xy = np.random.default_rng(1).uniform([0, 0], [639, 479], (50, 2))
    origin, direction = rays(camera, xy)
    if camera.kind == "orthographic":
        np.testing.assert_array_equal(direction, np.tile([0.0, 0.0, 1.0], (50, 1)))
        np.testing.assert_array_equal(origin[:, 2], 0.0)
    else:
        np.testing.assert_array_equal(origin, 0.0)


def test_points_behind_a_perspective_camera_are_nan_and_leave_the_others_alone():
    camera = CAMERAS["distorted"]
    p_cam = np.array([[5.0, 5.0, 100.0], [5.0, 5.0, -100.0], [0.0, 0.0, 0.0]])
    p_world = (p_cam - T) @ R
    p_world[2] -= 1e-9 * R[2]  # safely on the wrong side of rounding
    xy, d = project_with_jacobian(camera, p_world)
    for found in (xy, project(camera, p_world)):
        assert np.isfinite(found[0]).all() and np.isnan(found[1:]).all()
    assert np.isfinite(d[0]).all() and np.isnan(d[1:]).any(axis=(1, 2)).all()
    assert np.isfinite(project(CAMERAS["orthographic"], p_world)).all()


@given(
    st.floats(-0.4, 0.4),
    st.floats(-0.4, 0.4),
    st.tuples(*(st.floats(-most, most) for most in (0.2, 0.1, 0.01, 0.01, 0.05))),
)
@settings(deadline=None)
def test_undistort_undoes_distort_to_rounding(x, y, k):
    slope, k = np.array([x, y]), np.array(k)
    np.testing.assert_allclose(undistort(distort(slope, k), k), slope, atol=1e-12)


def test_distortion_far_from_the_axis_is_undone_too():
    slope = np.random.default_rng(2).uniform(-0.8, 0.8, (500, 2))
    barrel = np.array([-0.25, 0.08, 0.001, -0.001, -0.01])
    np.testing.assert_allclose(undistort(distort(slope, barrel), barrel), slope, atol=1e-11)


def test_undistort_converges_in_a_few_steps():
    slope = np.random.default_rng(3).uniform(-0.4, 0.4, (100, 2))
    bent = distort(slope, BENT)
    error = [np.abs(undistort(bent, BENT, steps) - slope).max() for steps in (1, 2, 4)]
    assert 1e-7 < error[0] < 1e-4
    assert error[1] < 1e-4 * error[0] and error[2] < 1e-14


def test_no_distortion_leaves_slopes_as_they_are():
    slope = np.array([[0.3, -0.2]])
    np.testing.assert_array_equal(distort(slope, np.zeros(5)), slope)
    np.testing.assert_array_equal(undistort(slope, np.zeros(5)), slope)


@pytest.mark.parametrize("kind", ["orthographic", "perspective"])
def test_matrices_project_homogeneous_points(kind):
    camera = CAMERAS[kind]
    points = np.hstack([POINTS, np.ones((300, 1))])
    P, P4 = projection_matrix(camera), projection_matrix_4x4(camera)
    assert P.shape == (3, 4) and P4.shape == (4, 4)
    flat, deep = points @ P.T, points @ P4.T
    np.testing.assert_allclose(flat[:, :2] / flat[:, 2:], project(camera, POINTS), atol=1e-9)
    np.testing.assert_allclose(deep[:, :2] / deep[:, 3:], project(camera, POINTS), atol=1e-9)
    np.testing.assert_array_equal(P4[[0, 1, 3]], P)  # appendix C: one extra row, the third


def test_simple_example_of_appendix_c():
    # The y axes of image and frame {0} are opposite; such an image frame is left-handed, so R is no rotation here.
    camera = orthographic(4, 4, 1.0, 0.0, 0.0, np.diag([1.0, -1.0, 1.0]), np.zeros(3))
    assert projection_matrix(camera).tolist() == [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]
    assert projection_matrix_4x4(camera).tolist() == [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


def test_round_fingers_stay_round_in_the_depth_of_the_4x4_matrix():
    P4 = projection_matrix_4x4(CAMERAS["orthographic"])  # Figure 10.10: depth is scaled like x and y
    np.testing.assert_allclose(P4[:3, :3] @ P4[:3, :3].T, 2.5**2 * np.eye(3), atol=1e-12)


@cameras
def test_depth_row_sorts_like_depth(camera):
    points = np.hstack([POINTS, np.ones((300, 1))])
    order = np.argsort(camera_from_world(camera, POINTS)[:, 2])
    assert (np.diff((points @ projection_matrix_4x4(camera)[2])[order]) >= 0).all()


@pytest.mark.parametrize("kind", ["orthographic", "perspective"])
def test_local_scale_is_how_far_the_pixel_of_a_moved_point_moves(kind):
    camera: Camera = CAMERAS[kind]
    p_cam = np.array([[0.0, 0.0, 400.0], [30.0, -20.0, 350.0]])
    across = np.cross(p_cam if kind == "perspective" else [[0.0, 0.0, 1.0]] * 2, [[0.3, 0.9, 0.1]] * 2)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    moved = project_camera(camera, p_cam + 1e-4 * across) - project_camera(camera, p_cam - 1e-4 * across)
    scale = np.linalg.norm(moved, axis=1) / 2e-4
    np.testing.assert_allclose(pixels_per_unit(camera, p_cam), scale, rtol=0.03)  # fx, fy differ by 3 %
    if kind == "perspective":
        assert pixels_per_unit(camera, p_cam)[1] == pytest.approx(710.0 / math.hypot(30, 20, 350))
