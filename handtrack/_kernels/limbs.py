"""Compiled tests of limbs, each from a father's place to a particle."""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def limb_rays(p, father, start, beyond):  # pragma: no cover - compiled
    """Origins and vectors of rays along limbs, from `start` after the father to `beyond` after the particle.

    Twin: `body.constraints.limb_rays_numpy`.
    """
    origin, vector = np.empty_like(p), np.empty_like(p)
    for i in range(p.shape[0]):
        x, y, z = p[i, 0] - father[i, 0], p[i, 1] - father[i, 1], p[i, 2] - father[i, 2]
        length = math.sqrt(x * x + y * y + z * z)
        over = 1.0 / length if length > 0.0 else 0.0
        ahead = max(length - start, 0.0) + beyond
        for d, way in enumerate((x * over, y * over, z * over)):
            origin[i, d] = father[i, d] + start * way
            vector[i, d] = ahead * way
    return origin, vector


@njit(cache=True)
def limb_lengths(p, father):  # pragma: no cover - compiled
    """Distances between particles and fathers. Twin: `np.linalg.norm`."""
    out = np.empty(p.shape[0])
    for i in range(p.shape[0]):
        x, y, z = p[i, 0] - father[i, 0], p[i, 1] - father[i, 1], p[i, 2] - father[i, 2]
        out[i] = math.sqrt(x * x + y * y + z * z)
    return out


@njit(cache=True)
def outside_wedge(p, father, axes, most, least_bend, most_bend):  # pragma: no cover - compiled
    """Whether limbs leave a plane by more than the sine `most`, or bend beyond two cosines of the angle inside.

    The rows of `axes` are the plane's normal, the direction across the limb before within it, and that limb's own.
    Twin: `body.constraints.outside_volume_numpy`.
    """
    out = np.zeros(p.shape[0], np.bool_)
    for i in range(p.shape[0]):
        x, y, z = p[i, 0] - father[i, 0], p[i, 1] - father[i, 1], p[i, 2] - father[i, 2]
        length = max(math.sqrt(x * x + y * y + z * z), 1e-12)
        off = (x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]) / length
        inner = (x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]) / length
        cosine = -(x * axes[2, 0] + y * axes[2, 1] + z * axes[2, 2]) / length
        out[i] = abs(off) > most or inner < -most or cosine > least_bend or cosine < most_bend
    return out
