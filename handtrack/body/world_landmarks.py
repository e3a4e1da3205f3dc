"""Keypoints about the hips in metres and the same in pixels in, keypoints in space out, without a depth image.

MediaPipe gives both. With X the place about the hips, (a, b, 1) the ray of the pixel and t the place of the hips, each
keypoint says `X_x + t_x = a (X_z + t_z)` and `X_y + t_y = b (X_z + t_z)`: linear in t, and solved by least squares,
weighted by confidence. The distance is only as good as the network's idea of how tall the person is.
"""

import numpy as np
from jaxtyping import Float

from ..camera import Camera, rays
from ..formats.poses2d import Poses2d, to_keypoints
from ..formats.skeletons import Detections
from .back_projection import detections_from

FEWEST = 4  # keypoints that place a person


def detections_by_world(poses: Poses2d, camera: Camera) -> Detections:
    """People of a whole recording in space.

    Raises
    ------
    ValueError
        If the poses have no places in metres.
    """
    if poses.world is None:
        raise ValueError("poses: have no world landmarks; places about the hips, in metres, are wanted")
    hips = hips_of(poses.world, poses.uv, poses.confidence, camera)
    p, confidence = to_keypoints(poses.world + hips[:, None], poses.confidence, poses.names)
    return detections_from(poses, p, confidence)


def hips_of(
    world: Float[np.ndarray, "d k 3"],
    uv: Float[np.ndarray, "d k 2"],
    confidence: Float[np.ndarray, "d k"],
    camera: Camera,
) -> Float[np.ndarray, "d 3"]:
    """Where the origin of each person's places is, metres, camera axes; NaN where too few keypoints are seen.

    >>> camera = Camera("perspective", 9, 9, 10.0, 10.0, 4.0, 4.0, np.eye(3), np.zeros(3), np.zeros(5))
    >>> world = np.array([[[0.0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.2]]])
    >>> uv = np.array([[[4.0, 4.0], [5.0, 4.0], [4.0, 5.0], [4.0, 4.0]]])
    >>> hips_of(world, uv, np.ones((1, 4)), camera).round(3)[0, 2]
    np.float64(2.0)
    """
    seen = np.isfinite(world).all(axis=-1) & np.isfinite(uv).all(axis=-1) & (confidence > 0)
    X = np.where(seen[..., None], world, 0.0)
    ray = rays(camera, np.where(seen[..., None], uv, 0.0).reshape(-1, 2))[1].reshape(*seen.shape, 3)
    slope = ray[..., :2]
    weight = np.where(seen, confidence, 0.0)
    rows = np.zeros((*seen.shape, 2, 3))
    rows[..., 0, 0] = rows[..., 1, 1] = 1.0
    rows[..., 2] = -slope
    right = slope * X[..., 2:] - X[..., :2]
    A = (np.swapaxes(rows, -1, -2) @ rows * weight[..., None, None]).sum(axis=1)
    b = ((np.swapaxes(rows, -1, -2) @ right[..., None])[..., 0] * weight[..., None]).sum(axis=1)
    good = (seen.sum(axis=1) >= FEWEST) & (np.linalg.cond(A) < 1e12)
    t = np.linalg.solve(np.where(good[:, None, None], A, np.eye(3)), b[..., None])[..., 0]
    return np.where((good & (t[:, 2] > 0))[:, None], t, np.nan)
