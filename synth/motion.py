"""Key poses or limits in, joint values of every frame out.

A motion is a path through key poses, one time unit apart, along monotone cubic splines (PCHIP: no overshoot, so a
path between poses inside the joint limits stays inside them). Frames walk along the path with a constant time step,
chosen so that the fastest joint reaches a wanted speed in degrees a frame.
"""

import math

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator

from handtrack.kinematics import Model, pose_from_free

STEP_SEARCH = 60  # halvings of the time step: to the last bit


def key_times_path(
    keys: Float[np.ndarray, "k j"], times: Float[np.ndarray, " k"], at: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "m j"]:
    """Poses at given times on the path through key poses.

    >>> key_times_path(np.array([[0.0], [1.0]]), np.array([0.0, 2.0]), np.array([0.0, 1.0, 2.0])).tolist()
    [[0.0], [0.5], [1.0]]

    Raises
    ------
    ValueError
        If there are fewer than two keys, times do not rise, or a wanted time lies outside them.
    """
    if keys.shape[0] < 2 or times.shape != keys.shape[:1] or not (np.diff(times) > 0).all():
        raise ValueError(f"times: {times.tolist()} must rise strictly, one for each of {keys.shape[0]} >= 2 key poses")
    if at.size and (at.min() < times[0] or at.max() > times[-1]):
        raise ValueError(f"at: {at.min()} to {at.max()} leaves the path's times {times[0]} to {times[-1]}")
    return PchipInterpolator(times, keys, axis=0)(at)


def largest_step(q: Float[np.ndarray, "m j"]) -> float:
    """Largest change of any joint from one frame to the next; 0 for a single frame."""
    return float(np.abs(np.diff(q, axis=0)).max(initial=0.0))


def walk(keys: Float[np.ndarray, "k j"], frames: int, max_speed: float) -> Float[np.ndarray, "m j"]:
    """Poses of frames that walk from the first key pose along the path, as fast as `max_speed` allows.

    Parameters
    ----------
    keys : (k, j)
        Key poses, radians.
    frames : int
        Number of frames, at least 1.
    max_speed : float
        Degrees a frame that the fastest joint reaches and none exceeds; slower if the path ends before.

    Returns
    -------
    (frames, j)
    """
    if frames < 1:
        raise ValueError(f"frames: {frames}; wanted at least 1")
    if not (max_speed > 0 and math.isfinite(max_speed)):
        raise ValueError(f"max_speed: {max_speed} degrees a frame; wanted a finite number > 0")
    times = np.arange(float(keys.shape[0]))
    number = np.arange(float(frames))
    low, high = 0.0, times[-1] / max(frames - 1, 1)
    limit = math.radians(max_speed)
    if largest_step(key_times_path(keys, times, np.minimum(number * high, times[-1]))) > limit:
        for _ in range(STEP_SEARCH):
            step = 0.5 * (low + high)
            fast = largest_step(key_times_path(keys, times, number * step)) > limit
            low, high = (low, step) if fast else (step, high)
        high = low
    return key_times_path(keys, times, np.minimum(number * high, times[-1]))


def keys_needed(frames: int, max_speed: float, swing: float) -> int:
    """Key poses `swing` degrees apart that surely last for the frames: PCHIP's mean speed is at least half its peak."""
    return max(3, math.ceil(frames * max_speed / swing) + 2)


def inside_limits(model: Model, q: Float[np.ndarray, "*b j"]) -> Float[np.ndarray, "*b j"]:
    """Poses moved inside the joint limits; coupled joints follow theirs."""
    return pose_from_free(model, np.clip(q, *model.limits.T)[..., model.free])


def random_keys(model: Model, rng: np.random.Generator, count: int, width: float = 60.0) -> Float[np.ndarray, "k j"]:
    """Key poses drawn evenly from the middle of the joint ranges.

    Parameters
    ----------
    width : float
        Degrees (model units where a joint slides) that each joint roams at most; one without limits roams about zero.
    """
    low, high = model.limits.T
    bounded = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(bounded, low, 0.0), np.where(bounded, high, 0.0)
    slides = np.zeros(low.size, dtype=bool)
    moved = model.joint >= 0
    slides[model.joint[moved]] = model.prismatic[moved]
    half = 0.5 * np.where(slides, width, math.radians(width))
    half = np.where(bounded, np.minimum(half, 0.5 * (high - low)), half)
    return inside_limits(model, 0.5 * (low + high) + half * rng.uniform(-1.0, 1.0, (count, low.size)))
