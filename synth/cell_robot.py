"""The lines from camera to wrist in, a robot arm that swings into them out: three capsules in every frame.

A column, an upper link and a fore link in one upright plane. A point `SHARE` along the fore link is led: between a
parking place and, while the hand works behind it, a place on the line from the camera to the target. The elbow follows
from the triangle of the two lengths and lies above.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .cell_motion import BEHIND_ROBOT, Tasks, minimum_jerk, smooth_noise

LINKS = ("column", "upper", "fore")
SHARE = 0.94
EARLY, LATE = 0.25, 0.15  # seconds that the robot is in place before the hand arrives, and stays after it departs
SWING = 0.75  # seconds to get there and to park


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """Foot (3,) and parking place (3,) in the cell's frame; height of the shoulder, lengths and radii, metres."""

    foot: Float[np.ndarray, " 3"]
    park: Float[np.ndarray, " 3"]
    height: float
    length: Float[np.ndarray, " 2"]
    radius: Float[np.ndarray, " 3"]


def random_robot(rng: np.random.Generator) -> Robot:
    """A robot on the floor beyond the table, to the person's left."""
    foot = np.array([rng.uniform(-0.85, -0.6), rng.uniform(1.2, 1.35), 0.0])
    height = rng.uniform(0.95, 1.1)
    park = foot + np.array([rng.uniform(-0.3, 0.0), rng.uniform(0.3, 0.5), height + rng.uniform(0.3, 0.5)])
    length, radius = rng.uniform([0.5, 0.52], [0.6, 0.6]), rng.uniform([0.08, 0.07, 0.075], [0.1, 0.08, 0.095])
    return Robot(foot, park, height, length, radius)


def led_point(
    rng: np.random.Generator, robot: Robot, tasks: Tasks, eye: Float[np.ndarray, " 3"], frames: int, fps: float
) -> Float[np.ndarray, "f 3"]:
    """Where the fore link is led, in the cell's frame; it drifts by a centimetre."""
    moved, shares = np.zeros((frames, 3)), np.zeros((frames, 1))
    number = np.arange(frames, dtype=float)
    for i in np.flatnonzero(tasks.kind == BEHIND_ROBOT):
        toward = eye - tasks.target[i]
        place = tasks.target[i] + rng.uniform(0.36, 0.52) * toward / np.linalg.norm(toward)
        _, arrive, depart, _ = tasks.frames[i]
        first, last = arrive - EARLY * fps, depart + LATE * fps
        there = minimum_jerk((number - first + SWING * fps) / (SWING * fps))
        share = np.minimum(there, 1.0 - minimum_jerk((number - last) / (SWING * fps)))[:, None]
        moved, shares = moved + share * (place - robot.park), shares + share
    return robot.park + moved / np.maximum(shares, 1.0) + 0.01 * smooth_noise(rng, frames, 0.4 * fps, 3)


def links_of(robot: Robot, led: Float[np.ndarray, "f 3"]) -> Float[np.ndarray, "f 3 2 3"]:
    """Ends of the links in every frame; a place out of reach is approached as far as the arm goes.

    >>> robot = Robot(np.zeros(3), np.ones(3), 1.0, np.array([0.5, 0.5]), np.full(3, 0.1))
    >>> links_of(robot, np.array([[0.6, 0.0, 1.0]])).shape
    (1, 3, 2, 3)
    """
    shoulder = robot.foot + np.array([0.0, 0.0, robot.height])
    first, second = robot.length[0], SHARE * robot.length[1]
    line = led - shoulder
    size = np.linalg.norm(line, axis=1)
    reach = np.clip(size, abs(first - second) + 1e-3, first + second - 1e-3)
    n = line / size[:, None]
    along = (first**2 - second**2 + reach**2) / (2.0 * reach)
    rise = np.sqrt(np.maximum(first**2 - along**2, 0.0))
    up = np.array([0.0, 0.0, 1.0]) - n[:, 2:] * n
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    elbow = shoulder + along[:, None] * n + rise[:, None] * up
    tip = elbow + (shoulder + reach[:, None] * n - elbow) / SHARE
    base = np.broadcast_to(shoulder, elbow.shape)
    foot = np.broadcast_to(robot.foot, elbow.shape)
    return np.stack([np.stack(pair, axis=1) for pair in ((foot, base), (base, elbow), (elbow, tip))], axis=1)
