"""Random numbers in, joint values of natural hands out, and paths from one to the next.

Fingers bend together: a hand is drawn as one of a few gestures (open, curled, pointing, pinching, holding), which give
each finger a share of bending; knuckles, middle and end joints follow with noise. `spread` mixes in joint values drawn
evenly from their ranges. The gestures' numbers are chosen here, not measured.
"""

import math
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

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
TRIES, OVERLAP = 5, 0.65  # draws at once, and again, of which the first is taken whose links, at this share of their
# radii, stay out of each other
_SIDEWAYS = ("abduction",)


def natural_pose(model: Model, rng: np.random.Generator, spread: float) -> Float[np.ndarray, " j"]:
    """A pose inside the joint limits whose fingers do not cut through each other, if some draws find one."""
    q = _draw(model, rng, spread, TRIES)
    clear = ~cuts(model, q)
    if not clear.any():
        q = _draw(model, rng, spread, TRIES)
        clear = ~cuts(model, q)
    return q[int(clear.argmax())]


def _draw(model: Model, rng: np.random.Generator, spread: float, count: int) -> Float[np.ndarray, "n j"]:
    """Poses that need not be clear of themselves."""
    low, high, finger, end = joint_ranges(model)
    gesture, mixed = rng.integers(GESTURES.shape[0], size=count), rng.uniform(0.0, 1.0, (count, 1))
    bend = mixed * GESTURES[gesture] + (1.0 - mixed) * rng.uniform(0.0, 0.8, (count, 1))
    bend = np.clip(bend + 0.08 * rng.standard_normal((count, 5)), 0.0, 1.0)
    noise = rng.standard_normal((count, low.size))
    bent = (bend[:, finger] + 0.07 * noise) * end
    q = np.where(finger >= 0, bent, 0.5 * (low + high) + 0.15 * noise * (high - low))
    share = spread * rng.uniform(0.0, 1.0, q.shape)
    return inside_limits(model, q + share * (rng.uniform(low, high, q.shape) - q))


def joint_ranges(model: Model):
    """Limits (half a turn to each side where there are none), finger that each joint bends (-1: none), and its end."""
    return _ranges(model.joint_names, model.limits.tobytes())


@lru_cache(maxsize=32)
def _ranges(names: tuple[str, ...], limits: bytes):
    given = np.frombuffer(limits).reshape(-1, 2)
    low, high = np.where(np.isfinite(given), given, [-math.pi, math.pi]).T
    parts = [name.partition("_") for name in names]
    finger = [FINGERS.index(a) if a in FINGERS and b not in _SIDEWAYS else -1 for a, _, b in parts]
    return low, high, np.array(finger), np.where(np.abs(high) >= np.abs(low), high, low)


def even_pose(model: Model, rng: np.random.Generator) -> Float[np.ndarray, " j"]:
    """A pose drawn evenly from the joint ranges."""
    limits = np.where(np.isfinite(model.limits), model.limits, [-math.pi, math.pi])
    return inside_limits(model, rng.uniform(limits[:, 0], limits[:, 1]))


def cuts(model: Model, q: Float[np.ndarray, "n j"]) -> Bool[np.ndarray, " n"]:
    """Whether links of different fingers are deeper inside each other than flesh gives way, for each pose."""
    base, tip = link_ends(model, forward(model, q))
    one, two = _pairs(model.link_finger.tobytes())
    radius = model.link_radius.mean(axis=1)
    ends = (values[:, which].reshape(-1, 3) for which in (one, two) for values in (base, tip))
    gap = _gap(*ends).reshape(q.shape[0], one.size)
    return (gap < OVERLAP * (radius[one] + radius[two])).any(axis=1)


@lru_cache(maxsize=32)
def _pairs(fingers: bytes) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """All pairs of links of different fingers."""
    finger = np.frombuffer(fingers, dtype=np.int64)
    one, two = np.triu_indices(finger.size, 1)
    apart = finger[one] != finger[two]
    return one[apart], two[apart]


def _gap(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> Float[np.ndarray, " n"]:
    """Distance between segments ab and cd (Ericson, Real-Time Collision Detection, section 5.1.9)."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv = _dot(u, u), _dot(u, v), _dot(v, v)
    uw, vw = _dot(u, w), _dot(v, w)
    whole = np.maximum(uu * vv - uv * uv, 1e-9)
    s = np.clip((uv * vw - vv * uw) / whole, 0.0, 1.0)
    t = (uv * s + vw) / vv
    held = np.clip(t, 0.0, 1.0)
    s = np.where(t == held, s, np.clip((uv * held - uw) / uu, 0.0, 1.0))
    between = w + s[:, None] * u - held[:, None] * v
    return np.sqrt(_dot(between, between))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def path_of(
    model: Model, rng: np.random.Generator, frames: int, speed: float, spread: float, even: bool
) -> Float[np.ndarray, "m j"]:
    """Joint values of `frames` frames and one more, whose fastest joint moves `speed` degrees a frame at most."""

    def key() -> Float[np.ndarray, " j"]:
        return even_pose(model, rng) if even else natural_pose(model, rng, spread)

    if speed <= 0.0:
        return np.repeat(key()[None], frames + 1, axis=0)
    if frames == 1:
        first = key()
        step = even_pose(model, rng) - first
        step = step / max(float(np.abs(step).max()), 1e-9)
        moved = first + math.radians(speed) * step
        return np.stack([first, pose_from_free(model, moved[model.free])])
    keys = np.stack([key() for _ in range(keys_needed(frames + 1, speed, 40.0))])
    return walk(keys, frames + 1, speed)
