"""A scene of one camera in, the same scene seen by several out.

Further cameras stand on a circle round the hand: each is the first one turned about the vertical axis of its image
through the middle p of the motion, by 60 degrees to one side, 60 to the other, 120 to the one ...

    x_k = A_k (x_0 - p_0) + p_0,    A_k a rotation about y,    p_0 the middle in the first camera's axes

so p stays at its pixel and distance in every view.
"""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from handtrack.camera import Camera, camera_from_world
from handtrack.kinematics import forward, link_ends

from .scene import Scene

STEP = math.radians(60.0)
MOST_VIEWS = 5  # a sixth would face the first, whose outlines it mirrors


def with_views(scene: Scene, count: int, step: float = STEP) -> Scene:
    """The scene with `count` cameras in all, 1 to 5, neighbours `step` radians apart; the first stays where it is.

    >>> from synth.scenes import two_finger_crossing
    >>> len(with_views(two_finger_crossing(1, frames=2), 2).cameras)
    2
    """
    if not 1 <= count <= MOST_VIEWS:
        raise ValueError(f"count: {count} views; wanted 1 to {MOST_VIEWS}")
    base, tip = link_ends(scene.model, forward(scene.model, scene.truth))
    middle = np.concatenate([base, tip], axis=1).mean(axis=(0, 1))
    # The first turn is towards the usual light, so that the second view is lit as well as the first.
    angles = [-step * (k // 2 + 1) * (-1) ** k for k in range(count - 1)]
    return replace(scene, more_cameras=tuple(turned(scene.camera, middle, angle) for angle in angles))


def turned(camera: Camera, p_world: Float[np.ndarray, " 3"], angle: float) -> Camera:
    """The camera turned by `angle` radians about its image's vertical axis through a point, which keeps its place."""
    c, s = math.cos(angle), math.sin(angle)
    A = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    p_cam = camera_from_world(camera, p_world)
    return replace(camera, R=A @ camera.R, t=A @ (camera.t - p_cam) + p_cam)
