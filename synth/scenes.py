"""A name and a seed in, a ready scene out.

- `two-finger-crossing`: hand thesis, section 6.1 (Table 6.1): the index finger crosses in front of the middle finger;
  the plane of the fingers is parallel to the image, then tilted by 45 degrees about its horizontal axis;
- `two-finger-hard`: the same in perspective, faster, with more noise, from a wrong start;
- `index-thumb-pinch`: the hand of Table 2.3 closes and opens a pinch;
- `full-hand-spread`: section 6.2.2 (Table 6.2): the fingers spread, then flex by degrees from little to index;
- `random`: any model, moving at random inside its limits.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from handtrack.kinematics import Model, forward, link_ends
from handtrack.kinematics.builtin import model as builtin_model

from .motion import inside_limits, keys_needed, random_keys, walk
from .scene import Scene as Scene
from .scene import about_x, skin, view, wrong_start
from .scene import clean_image as clean_image
from .scene import image as image
from .scene import images as images
from .scene import images_together as images_together
from .scene import posed as posed
from .sensor import Sensor

NAMES = ("two-finger-crossing", "two-finger-hard", "index-thumb-pinch", "full-hand-spread", "random")
# Poses of the index_thumb model whose tips touch (gap 0.3 mm) and no other pills meet, degrees.
PINCHED = np.array(
    [
        [-22.6, -55.8, -32.8, 28.7, -13.1, -13.0],
        [-26.0, -62.2, -35.3, 29.6, 0.0, -21.3],
        [-38.6, -40.1, -21.5, 39.4, -25.9, -5.2],
    ]
)


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
    """The crossing in perspective: noise 6, joints moving up to 8 degrees a frame, a start wrong by 3 degrees."""
    hard = two_finger_crossing(seed, frames=frames, projection="perspective", noise=6.0, max_speed=8.0, start_error=3.0)
    return replace(hard, name="two-finger-hard")


def index_thumb_pinch(
    seed: int,
    *,
    frames: int = 60,
    projection: str = "perspective",
    noise: float = 2.0,
    max_speed: float = 3.5,
    scale: float = 3.0,
    size: tuple[int, int] = (640, 480),
) -> Scene:
    """Index finger and thumb of Table 2.3 close until their tips touch, and open; options as above."""
    model, rng = builtin_model("index_thumb"), np.random.default_rng(seed)
    count = keys_needed(frames, max_speed, 25.0)
    opened = rng.uniform([-8.0, -34.0, -18.0, 36.0, -2.0, -8.0], [6.0, -18.0, -8.0, 44.0, 6.0, 4.0], (count, 6))
    closed = PINCHED[rng.integers(0, PINCHED.shape[0], count)]
    keys = np.radians(np.where((np.arange(count) % 2 == 0)[:, None], opened, closed))
    truth = walk(inside_limits(model, keys), frames, max_speed)
    # Image x from the wrist to the fingertips, the thumb below; seen a little from above.
    R = about_x(math.radians(20.0)) @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    camera = view(projection, size, scale, (0.5 * size[0], 0.5 * size[1]), R, np.array([75.0, 0.0, -30.0]))
    return Scene("index-thumb-pinch", seed, model, camera, truth, truth[0].copy(), skin(model), sensor=Sensor(noise))


def full_hand_spread(
    seed: int,
    *,
    frames: int = 60,
    projection: str = "orthographic",
    noise: float = 2.0,
    max_speed: float = 3.5,
    scale: float = 2.6,
    size: tuple[int, int] = (640, 480),
) -> Scene:
    """The fingers spread, then flex by degrees from the little to the index finger; the thumb stays (thesis, 6.2.2).

    As in Figure 6.6, the two outer joints of a finger turn alike, and so do the first and the last of the thumb. The
    seed moves the joints of every key pose but the thumb's by up to 3 degrees; options as in `two_finger_crossing`.
    """
    model, rng = builtin_model("full_hand"), np.random.default_rng(seed)
    keys = np.array([_hand_pose(model, spread, grade) for spread, grade in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))])
    fingers = np.array([not name.startswith("thumb") for name in model.joint_names])
    keys = keys + np.radians(rng.uniform(-3.0, 3.0, keys.shape)) * fingers
    names = np.array(model.joint_names)
    keys[:, np.char.endswith(names, "_dip")] = keys[:, np.char.endswith(names, "_pip")]
    truth = walk(inside_limits(model, keys), frames, max_speed)
    # The palm faces the camera, fingers to the right, thumb below; then the tilt of 45 degrees.
    R = about_x(math.pi / 4) @ np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    camera = view(projection, size, scale, (0.5 * size[0], 0.5 * size[1]), R, np.array([0.0, 85.0, 0.0]))
    return Scene("full-hand-spread", seed, model, camera, truth, truth[0].copy(), skin(model), sensor=Sensor(noise))


def _hand_pose(model: Model, spread: float, grade: float) -> Float[np.ndarray, " j"]:
    """Pose of the full hand, radians: 0..1 of the spread, and of the flexion from little (over-extended) to index."""
    abduction = {"little": 16.0, "ring": 8.0, "middle": 5.0, "index": 14.0}
    rest, flexed = {"mcp": 8.0, "pip": 10.0, "dip": 10.0}, {"mcp": 38.0, "pip": 30.0, "dip": 30.0}
    fingers = ("little", "ring", "middle", "index")
    pose = {"thumb_palmar": 10.0, "thumb_radial": 25.0, "thumb_mcp": -10.0, "thumb_ip": 10.0, "thumb_abduction": 0.0}
    for number, finger in enumerate(fingers):
        pose[f"{finger}_abduction"] = spread * abduction[finger]
        for part, angle in rest.items():
            pose[f"{finger}_{part}"] = angle + grade * flexed[part] * number / 3.0
    pose["little_mcp"] -= 33.0 * grade
    return np.radians([pose[name] for name in model.joint_names])


def random_motion(
    seed: int,
    model: Model,
    *,
    frames: int = 60,
    projection: str = "orthographic",
    noise: float = 2.0,
    max_speed: float = 3.0,
    size: tuple[int, int] = (640, 480),
) -> Scene:
    """Any model, moving at random within its limits, seen from where it spreads most; options as above."""
    keys = random_keys(model, np.random.default_rng(seed), keys_needed(frames, max_speed, 25.0))
    truth = walk(keys, frames, max_speed)
    base, tip = link_ends(model, forward(model, truth))
    points = np.concatenate([base, tip], axis=1).reshape(-1, 3)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=True)[2]
    R = np.array([axes[0], axes[1], np.cross(axes[0], axes[1])])
    reach = np.abs((points - middle) @ R.T).max(axis=0) + model.link_radius.max()
    scale = float((0.35 * np.array(size) / reach[:2]).min())
    focal = max(640.0, 3.0 * scale * float(reach[2]))  # the camera stands clear of the motion
    camera = view(projection, size, scale, (0.5 * size[0], 0.5 * size[1]), R, middle, focal)
    return Scene("random", seed, model, camera, truth, truth[0].copy(), skin(model), sensor=Sensor(noise))


def scene(name: str, seed: int, model: Model | None = None, **options: Any) -> Scene:
    """The scene of that name.

    Parameters
    ----------
    name : str
        One of `NAMES`.
    model : Model, optional
        What moves, for `random` and for nothing else.
    **options
        Of the scene's own function.

    Raises
    ------
    ValueError
        For an unknown name, or a model where none, or none where a model is wanted.

    >>> scene("index-thumb-pinch", 1, frames=3).truth.shape
    (3, 6)
    """
    if name not in NAMES:
        raise ValueError(f"name: '{name}' is no scene; there are {', '.join(NAMES)}")
    if (model is None) == (name == "random"):
        raise ValueError(f"model: scene '{name}' {'wants a' if model is None else 'has its own'} model")
    if model is not None:
        return random_motion(seed, model, **options)
    makers: tuple[Callable[..., Scene], ...] = (
        two_finger_crossing,
        two_finger_hard,
        index_thumb_pinch,
        full_hand_spread,
    )
    return makers[NAMES.index(name)](seed, **options)


def _crossing_keys(rng: np.random.Generator, count: int) -> Float[np.ndarray, "k 6"]:
    """Key poses, radians: the middle finger, a little bent, drifts; the index finger swings from below it to above."""
    middle = rng.uniform([2.0, 12.0, 6.0], [16.0, 30.0, 18.0], (count, 3))
    below = rng.uniform([-26.0, 6.0, 4.0], [-14.0, 22.0, 14.0], (count, 3))
    above = rng.uniform([18.0, 26.0, 12.0], [34.0, 52.0, 30.0], (count, 3))
    index = np.where((np.arange(count) % 2 == 0)[:, None], below, above)
    return np.radians(np.hstack([middle, index]))
