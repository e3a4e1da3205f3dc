"""3D points in, pixels and their derivatives out; and back from pixels to rays.

Axes are OpenCV's: x right, y down, z forward. `p_cam = R p_world + t`. Pixels are (x, y), and (0, 0) is the centre of
the top-left pixel. An orthographic camera (hand thesis, 2.4.1) scales x and y and ignores depth; a perspective one
divides by depth and may bend the result with OpenCV's distortion `k1 k2 p1 p2 k3`. The normalised coordinates of a
pixel are millimetres for the orthographic camera and slopes for the perspective one, so that both are `pixel = f *
normalised + c`.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Intrinsic and extrinsic parameters; `fx = fy = scale` (pixels per model unit) for an orthographic camera."""

    kind: Literal["orthographic", "perspective"]
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    R: Float[np.ndarray, "3 3"]
    t: Float[np.ndarray, " 3"]
    distortion: Float[np.ndarray, " 5"]


def orthographic(
    width: int,
    height: int,
    scale: float,
    cx: float,
    cy: float,
    R: Float[np.ndarray, "3 3"],
    t: Float[np.ndarray, " 3"],
) -> Camera:
    """A camera at infinite distance, `scale` pixels for each model unit."""
    return Camera("orthographic", width, height, scale, scale, cx, cy, R, t, np.zeros(5))


def perspective(
    width: int,
    height: int,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    R: Float[np.ndarray, "3 3"],
    t: Float[np.ndarray, " 3"],
    distortion: Float[np.ndarray, " 5"] | None = None,
) -> Camera:
    """A pinhole camera, with OpenCV's distortion `k1 k2 p1 p2 k3` if given."""
    return Camera("perspective", width, height, fx, fy, cx, cy, R, t, np.zeros(5) if distortion is None else distortion)


def camera_from_world(camera: Camera, p_world: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Points of the base frame in camera axes."""
    return p_world @ camera.R.T + camera.t


def project(camera: Camera, p_world: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Pixels of points in the base frame, eq. (2.3); NaN for points behind a perspective camera.

    >>> camera = orthographic(64, 48, 2.0, 32.0, 24.0, np.eye(3), np.zeros(3))
    >>> project(camera, np.array([1.0, -2.0, 9.0])).tolist()
    [34.0, 20.0]
    """
    return project_camera(camera, camera_from_world(camera, p_world))


def project_camera(camera: Camera, p_cam: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Pixels of points in camera axes; NaN behind a perspective camera."""
    if camera.kind == "orthographic":
        normalised = p_cam[..., :2]
    else:
        depth = np.where(p_cam[..., 2:] > 0, p_cam[..., 2:], np.nan)
        normalised = distort(p_cam[..., :2] / depth, camera.distortion)
    return normalised * (camera.fx, camera.fy) + (camera.cx, camera.cy)


def project_with_jacobian(
    camera: Camera, p_world: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 3"]]:
    """Pixels and their derivative by the point in the base frame; NaN behind a perspective camera."""
    p_cam = camera_from_world(camera, p_world)
    d_normalised = np.zeros((p_cam.shape[0], 2, 3))
    if camera.kind == "orthographic":
        d_normalised[:, 0, 0] = d_normalised[:, 1, 1] = 1.0
    else:
        z = np.where(p_cam[:, 2] > 0, p_cam[:, 2], np.nan)
        slope = p_cam[:, :2] / z[:, None]
        d_normalised[:, 0, 0] = d_normalised[:, 1, 1] = 1.0 / z
        d_normalised[:, :, 2] = -slope / z[:, None]
        d_normalised = _distortion_derivative(slope, camera.distortion) @ d_normalised
    focal = np.array([[camera.fx], [camera.fy]])
    return project_camera(camera, p_cam), (focal * d_normalised) @ camera.R


def distort(slope: Float[np.ndarray, "*n 2"], k: Float[np.ndarray, " 5"]) -> Float[np.ndarray, "*n 2"]:
    """Bend normalised coordinates by OpenCV's model `k1 k2 p1 p2 k3`."""
    if not k.any():
        return slope
    x, y = slope[..., 0], slope[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    return np.stack(
        [
            x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
            y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
        ],
        axis=-1,
    )


def _distortion_derivative(slope: Float[np.ndarray, "*n 2"], k: Float[np.ndarray, " 5"]) -> Float[np.ndarray, "*n 2 2"]:
    x, y = slope[..., 0], slope[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    growth = 2.0 * (k[0] + r2 * (2.0 * k[1] + 3.0 * k[4] * r2))  # d(radial)/d(r2) * 2
    cross = growth * x * y + 2.0 * (k[2] * x + k[3] * y)
    out = np.empty((*slope.shape, 2))
    out[..., 0, 0] = radial + growth * x * x + 2.0 * k[2] * y + 6.0 * k[3] * x
    out[..., 1, 1] = radial + growth * y * y + 6.0 * k[2] * y + 2.0 * k[3] * x
    out[..., 0, 1] = out[..., 1, 0] = cross
    return out


def undistort(
    bent: Float[np.ndarray, "*n 2"], k: Float[np.ndarray, " 5"], steps: int = 12
) -> Float[np.ndarray, "*n 2"]:
    """Inverse of `distort` by Newton's method, exact to rounding wherever the distortion does not fold."""
    if not k.any():
        return bent
    slope = bent.copy()
    for _ in range(steps):
        error = distort(slope, k) - bent
        slope = slope - np.linalg.solve(_distortion_derivative(slope, k), error[..., None])[..., 0]
        if np.abs(error).max(initial=0.0) < 1e-14:
            break
    return slope


def rays(camera: Camera, xy: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Origin and direction, in camera axes, of the ray through each pixel position.

    The direction has z = 1, so a ray parameter is a depth. Orthographic rays start at depth 0 and run both ways: what
    is nearer has the smaller, perhaps negative, parameter.
    """
    normalised = (xy - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    origin, direction = np.zeros((xy.shape[0], 3)), np.zeros((xy.shape[0], 3))
    direction[:, 2] = 1.0
    if camera.kind == "orthographic":
        origin[:, :2] = normalised
    else:
        direction[:, :2] = undistort(normalised, camera.distortion)
    return origin, direction


def pixels_per_unit(camera: Camera, p_cam: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
    """Pixels for each model unit across the line of sight, at points in camera axes (distortion left out)."""
    focal = 0.5 * (camera.fx + camera.fy)
    if camera.kind == "orthographic":
        return np.full(p_cam.shape[:-1], focal)
    return focal / np.linalg.norm(p_cam, axis=-1)


def projection_matrix(camera: Camera) -> Float[np.ndarray, "3 4"]:
    """`C_T_0` of eq. (2.4): homogeneous base-frame points to homogeneous pixels, before distortion."""
    pose = np.hstack([camera.R, camera.t[:, None]])
    if camera.kind == "orthographic":
        pose = np.vstack([pose[:2], [0.0, 0.0, 0.0, 1.0]])
    intrinsic = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    return intrinsic @ pose


def projection_matrix_4x4(camera: Camera) -> Float[np.ndarray, "4 4"]:
    """`projection_matrix` with a third row that keeps depth (hand thesis, appendix C).

    The row scales depth like x and y, so that a round finger stays round (Figure 10.10): for the orthographic camera
    depth in pixels; for the perspective one `lambda * depth'` is the plain camera depth times the mean focal length.
    """
    flat = projection_matrix(camera)
    focal = 0.5 * (camera.fx + camera.fy)
    depth = focal * np.append(camera.R[2], camera.t[2])
    return np.vstack([flat[:2], depth, flat[2:]])
