"""Random numbers in, cameras and lights out."""

import math

import numpy as np
from jaxtyping import Float

from handtrack.camera import Camera, orthographic, perspective
from handtrack.formats.cameras import folds

from ..labels.solids import Lights
from .scene_schema import CameraFile, ImageFile, LightsFile

TRIES = 8  # distortions that fold inside the image are drawn again so many times, then left out
# Where the camera stands, in a hand's axes: x to the thumb's side, y to the fingertips, z out of the palm.
TOWARDS = {
    "palm": (0.0, 0.0, 1.0),
    "back": (0.0, 0.0, -1.0),
    "thumb": (1.0, 0.0, 0.0),
    "little": (-1.0, 0.0, 0.0),
    "fingertips": (0.0, 1.0, 0.0),
}


def cross(a: Float[np.ndarray, " 3"], b: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Cross product of two vectors, without the detours of the general one."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def in_cone(
    rng: np.random.Generator, axis: Float[np.ndarray, " 3"], cone: tuple[float, float]
) -> Float[np.ndarray, " 3"]:
    """A unit vector whose angle to an axis lies in a range of degrees, spread evenly over the sphere there."""
    low, high = (math.cos(math.radians(angle)) for angle in cone)
    z, turn = rng.uniform(high, low), rng.uniform(0.0, 2.0 * math.pi)
    a = np.eye(3)[int(np.abs(axis).argmin())]
    a = a - (a @ axis) * axis
    a = a / np.linalg.norm(a)
    side = math.cos(turn) * a + math.sin(turn) * cross(axis, a)
    return z * axis + math.sqrt(max(0.0, 1.0 - z * z)) * side


def camera(rng: np.random.Generator, file: CameraFile, image: ImageFile, mirrored: bool) -> Camera:
    """A camera that looks at the world's origin, where the first hand has its middle."""
    if file.towards == "any":
        axis, cone = np.array([0.0, 0.0, 1.0]), (0.0, 180.0)
    else:
        axis, cone = np.array(TOWARDS[file.towards]), file.cone
    if mirrored:
        axis = axis * (-1.0, 1.0, 1.0)
    forward = -in_cone(rng, axis, cone)
    up = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    x = cross(-up, forward)
    x = x / np.linalg.norm(x)
    R = np.stack([x, cross(forward, x), forward])
    roll = math.radians(rng.uniform(*file.roll))
    c, s = math.cos(roll), math.sin(roll)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    away = rng.uniform(*file.distance)
    width, height = image.width, image.height
    centre = (0.5 * (width - 1), 0.5 * (height - 1))
    aside, turn = rng.uniform(*file.off_centre), rng.uniform(0.0, 2.0 * math.pi)
    shift = aside * np.array([math.cos(turn) * width, math.sin(turn) * height])
    wanted = rng.uniform(*(file.fov if file.type == "perspective" else file.extent))
    k = _distortion(rng, file)
    if file.type == "orthographic":
        scale = max(width, height) / wanted
        return orthographic(width, height, scale, *centre, R, np.array([*(shift / scale), away]))
    focal = 0.5 * max(width, height) / math.tan(0.5 * math.radians(wanted))
    t = np.array([*(shift / focal * away), away])
    made = perspective(width, height, focal, focal, *centre, R, t, k)
    for _ in range(TRIES):
        if not folds(made):
            return made
        made = perspective(width, height, focal, focal, *centre, R, t, _distortion(rng, file))
    return perspective(width, height, focal, focal, *centre, R, t)


def _distortion(rng: np.random.Generator, file: CameraFile) -> Float[np.ndarray, " 5"]:
    """Coefficients in OpenCV's order."""
    d = file.distortion
    return np.array([rng.uniform(*given) for given in (d.k1, d.k2, d.p1, d.p2, d.k3)])


def lights(rng: np.random.Generator, file: LightsFile) -> Lights:
    """Lights in a cone about the direction from the hand to the camera."""
    count = int(rng.integers(file.count[0], file.count[1] + 1))
    direction = np.array([in_cone(rng, np.array([0.0, 0.0, -1.0]), file.cone) for _ in range(count)]).reshape(-1, 3)
    strength = rng.uniform(file.strength[0], file.strength[1], (count, 1)) / max(count, 1) ** 0.5
    tint = 1.0 - rng.uniform(file.colour[0], file.colour[1], (count, 1)) * rng.uniform(0.0, 1.0, (count, 3))
    return Lights(rng.uniform(*file.ambient), direction, strength * tint)
