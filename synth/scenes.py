"""A name and a seed in, a ready scene out: model, camera, light, motion with exact truth, and its images.

- `two-finger-crossing`: hand thesis, section 6.1 (Table 6.1): the index finger crosses in front of the middle finger; the plane of
  the fingers is parallel to the image, then tilted by 45 degrees about its horizontal axis;
- `full-hand-spread`: section 6.2.2 (Table 6.2): the fingers spread, then flex by degrees from little to index; the thumb stays;
- `index-thumb-pinch`: the hand of Table 2.3 closes and opens a pinch;
- `random`: any model, moving at random inside its limits.

Every frame has its own random numbers, drawn from (seed, frame): frames can be made in any order, with the same bytes.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from handtrack.camera import Camera, orthographic, perspective
from handtrack.kinematics import Model, forward, link_ends
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.pills import Pills, pose_pills

from .motion import inside_limits, keys_needed, random_keys, walk
from .render import render
from .sensor import Sensor, sense
from .shading import Light, Material, Mode

# From the upper left, in front of the scene.
LIGHT = Light(np.array([-0.5, -0.6, -0.8]))
SKIN = np.array([[236.0, 208.0, 188.0], [224.0, 196.0, 178.0], [242.0, 216.0, 200.0], [216.0, 186.0, 166.0], [230.0, 204.0, 192.0]])
BLACK = 5.0
NAMES = ("two-finger-crossing", "index-thumb-pinch", "full-hand-spread", "random")


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All that decides the images of a sequence.

    Attributes
    ----------
    truth : (m, j)
        Joint values of each frame, radians, in the order of `model.joint_names`.
    start : (j,)
        The pose given to a tracker for frame 0; may be wrong on purpose.
    background : float or (h, w) array
        Grey level behind the pills.
    """

    name: str
    seed: int
    model: Model
    camera: Camera
    truth: Float[np.ndarray, "m j"]
    start: Float[np.ndarray, " j"]
    material: Material
    light: Light = LIGHT
    mode: Mode = "phong"
    colour: bool = False
    background: float | Float[np.ndarray, "h w"] | Float[np.ndarray, "h w 3"] = BLACK
    sensor: Sensor = Sensor()
    fps: float = 25.0


def skin(model: Model) -> Material:
    """Skin whose tone differs a little from finger to finger; its grey levels reach from 60 at the rim to 220."""
    return Material(SKIN[model.link_finger % SKIN.shape[0]])


def posed(scene: Scene, frame: int) -> Pills:
    """True pills of a frame, in camera axes."""
    return pose_pills(scene.model, forward(scene.model, scene.truth[frame]), scene.camera)


def clean_image(scene: Scene, frame: int) -> Float[np.ndarray, "h w *c"]:
    """Image of a frame before the sensor."""
    pills = posed(scene, frame)
    return render(
        pills, scene.camera, scene.material, scene.light, scene.mode, colour=scene.colour, background=scene.background
    )


def image(scene: Scene, frame: int) -> Float[np.ndarray, "h w *c"]:
    """Image of a frame as the camera delivers it, float32 grey levels (or red, green, blue)."""
    return sense(clean_image(scene, frame), scene.sensor, np.random.default_rng([scene.seed, frame]))


def images(scene: Scene) -> Iterator[Float[np.ndarray, "h w *c"]]:
    """Images of all frames, one after the other.

    >>> clip = two_finger_crossing(1, frames=2)
    >>> [picture.shape for picture in images(clip)]
    [(480, 640), (480, 640)]
    """
    for frame in range(scene.truth.shape[0]):
        yield image(scene, frame)


def about_x(angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about the horizontal image axis, radians."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def view(
    projection: str,
    size: tuple[int, int],
    scale: float,
    focus: tuple[float, float],
    R: Float[np.ndarray, "3 3"],
    target: Float[np.ndarray, " 3"],
    focal: float = 640.0,
) -> Camera:
    """Camera of either projection that shows world point `target` at pixel `focus` with the same scale there.

    The perspective camera stands at the distance where its focal length gives that scale.
    """
    width, height = size
    t = np.array([0.0, 0.0, focal / scale]) - R @ target
    if projection == "orthographic":
        return orthographic(width, height, scale, *focus, R, t)
    if projection == "perspective":
        return perspective(width, height, focal, focal, *focus, R, t)
    raise ValueError(f"projection: '{projection}' is unknown; wanted orthographic or perspective")


def wrong_start(model: Model, q: Float[np.ndarray, " j"], error: float, seed: int) -> Float[np.ndarray, " j"]:
    """A pose wrong by `error` degrees in every joint, with random signs turned where they would leave the limits."""
    if error == 0:
        return q.copy()
    sign = np.random.default_rng([seed, 2**31]).choice([-1.0, 1.0], q.size)
    off = q + sign * math.radians(error)
    out = (off < model.limits[:, 0]) | (off > model.limits[:, 1])
    return np.where(out, q - sign * math.radians(error), off)


def two_finger_crossing(
    seed: int,
    *,
    frames: int = 60,
    projection: str = "orthographic",
    noise: float = 2.0,
    max_speed: float = 3.5,
    start_error: float = 0.0,
    scale: float = 3.2,
    size: tuple[int, int] = (640, 480),
) -> Scene:
    """The index finger crosses in front of the middle finger, again and again, by different flexions (thesis, 6.1).

    Parameters
    ----------
    seed : int
        Decides motion, start and noise.
    max_speed : float
        Degrees a frame that the fastest joint reaches.
    start_error : float
        Degrees by which each joint of the given start pose is wrong.
    """
    model, rng = builtin_model("two_finger"), np.random.default_rng(seed)
    keys = _crossing_keys(rng, keys_needed(frames, max_speed, 35.0))
    truth = walk(inside_limits(model, keys), frames, max_speed)
    # Image x along the fingers, flexion upwards, the index finger in front; then the tilt of 45 degrees.
    R = about_x(math.pi / 4) @ np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    knuckle = link_ends(model, forward(model, truth[0]))[0][[0, 3]].mean(axis=0)
    focus = (0.25 * size[0], 0.5 * size[1])
    camera = view(projection, size, scale, focus, R, knuckle)
    start = wrong_start(model, truth[0], start_error, seed)
    return Scene("two-finger-crossing", seed, model, camera, truth, start, skin(model), sensor=Sensor(noise))


def two_finger_hard(seed: int, *, frames: int = 60) -> Scene:
    """The crossing in perspective, with noise 6, joints moving up to 8 degrees a frame, from a start wrong by 3 degrees."""
    hard = two_finger_crossing(
        seed, frames=frames, projection="perspective", noise=6.0, max_speed=8.0, start_error=3.0
    )
    return replace(hard, name="two-finger-hard")


def _crossing_keys(rng: np.random.Generator, count: int) -> Float[np.ndarray, "k 6"]:
    """Key poses, radians: the middle finger rests a little bent and drifts, the index finger swings from below it to above."""
    middle = rng.uniform([2.0, 12.0, 6.0], [16.0, 30.0, 18.0], (count, 3))
    below = rng.uniform([-26.0, 6.0, 4.0], [-14.0, 22.0, 14.0], (count, 3))
    above = rng.uniform([18.0, 26.0, 12.0], [34.0, 52.0, 30.0], (count, 3))
    index = np.where((np.arange(count) % 2 == 0)[:, None], below, above)
    return np.radians(np.hstack([middle, index]))
