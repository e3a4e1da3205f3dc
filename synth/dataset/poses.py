"""Random numbers in, joint values of natural hands out, and paths from one to the next.

Fingers bend together: a hand is drawn as one of a few gestures (open, curled, pointing, pinching, holding), which give
each finger a share of bending; knuckles, middle and end joints follow with noise. `spread` mixes in joint values drawn
evenly from their ranges. The gestures' numbers are chosen here, not measured.
"""

import math

import numpy as np
from jaxtyping import Float

from handtrack.kinematics import Model, forward, link_ends, pose_from_free

from ..mesh_hand import FINGERS
from ..motion import inside_limits, keys_needed, walk

GESTURES = np.array(  # share of bending of thumb, index, middle, ring, little
    [
        [0.10, 0.05, 0.05, 0.05, 0.08],
        [0.45, 0.75, 0.80, 0.80, 0.80],
        [0.55, 0.05, 0.80, 0.85, 0.85],
        [0.55, 0.50, 0.30, 0.20, 0.15],
        [0.40, 0.45, 0.48, 0.50, 0.52],
        [0.25, 0.25, 0.28, 0.30, 0.32],
    ]
)
TRIES, OVERLAP = 12, 0.65  # draws before links that cut into each other are put up with; share of their radii allowed
_SIDEWAYS = ("abduction",)


def natural_pose(model: Model, rng: np.random.Generator, spread: float) -> Float[np.ndarray, " j"]:
    """A pose inside the joint limits whose fingers do not cut through each other, if some draws find one."""
    q = _draw(model, rng, spread)
    for _ in range(TRIES):
        if not cuts(model, q):
            break
        q = _draw(model, rng, spread)
    return q


def _draw(model: Model, rng: np.random.Generator, spread: float) -> Float[np.ndarray, " j"]:
    low, high = np.where(np.isfinite(model.limits), model.limits, [-math.pi, math.pi]).T
    gesture = rng.integers(GESTURES.shape[0])
    mixed = rng.uniform(0.0, 1.0)
    bend = np.clip(mixed * GESTURES[gesture] + (1 - mixed) * rng.uniform(0, 0.8) + 0.08 * rng.standard_normal(5), 0, 1)
    q = np.empty(low.size)
    noise = rng.standard_normal(low.size)
    even = rng.uniform(low, high)
    for i, name in enumerate(model.joint_names):
        finger, _, part = name.partition("_")
        if finger not in FINGERS or part in _SIDEWAYS:
            q[i] = 0.5 * (low[i] + high[i]) + 0.15 * noise[i] * (high[i] - low[i])
            continue
        end = high[i] if abs(high[i]) >= abs(low[i]) else low[i]
        q[i] = (bend[FINGERS.index(finger)] + 0.07 * noise[i]) * end
    share = spread * rng.uniform(0.0, 1.0, low.size)
    return inside_limits(model, q + share * (even - q))


def even_pose(model: Model, rng: np.random.Generator) -> Float[np.ndarray, " j"]:
    """A pose drawn evenly from the joint ranges."""
    limits = np.where(np.isfinite(model.limits), model.limits, [-math.pi, math.pi])
    return inside_limits(model, rng.uniform(limits[:, 0], limits[:, 1]))


def cuts(model: Model, q: Float[np.ndarray, " j"]) -> bool:
    """Whether links of different fingers are deeper inside each other than flesh gives way."""
    base, tip = link_ends(model, forward(model, q))
    one, two = np.triu_indices(base.shape[0], 1)
    apart = model.link_finger[one] != model.link_finger[two]
    one, two = one[apart], two[apart]
    reach = OVERLAP * (model.link_radius.mean(axis=1)[one] + model.link_radius.mean(axis=1)[two])
    return bool((_gap(base[one], tip[one], base[two], tip[two]) < reach).any())


def _gap(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> Float[np.ndarray, " n"]:
    """Distance between segments ab and cd (Ericson, Real-Time Collision Detection, section 5.1.9)."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    uw, vw = (u * w).sum(1), (v * w).sum(1)
    whole = np.maximum(uu * vv - uv * uv, 1e-9)
    s = np.clip((uv * vw - vv * uw) / whole, 0.0, 1.0)
    t = (uv * s + vw) / vv
    held = np.clip(t, 0.0, 1.0)
    s = np.where(t == held, s, np.clip((uv * held - uw) / uu, 0.0, 1.0))
    return np.linalg.norm(w + s[:, None] * u - held[:, None] * v, axis=1)


def path_of(
    model: Model, rng: np.random.Generator, frames: int, speed: float, spread: float, even: bool
) -> Float[np.ndarray, "m j"]:
    """Joint values of `frames` frames and one more, whose fastest joint moves `speed` degrees a frame at most."""

    def key() -> Float[np.ndarray, " j"]:
        return even_pose(model, rng) if even else natural_pose(model, rng, spread)

    if speed <= 0.0:
        return np.repeat(key()[None], frames + 1, axis=0)
    if frames == 1:
        first, second = key(), key()
        step = (second - first) / max(float(np.abs(second - first).max()), 1e-9)
        moved = first + math.radians(speed) * step
        return np.stack([first, pose_from_free(model, moved[model.free])])
    keys = np.stack([key() for _ in range(keys_needed(frames + 1, speed, 40.0))])
    return walk(keys, frames + 1, speed)
