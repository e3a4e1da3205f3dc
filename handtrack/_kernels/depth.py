"""Compiled search in depth images."""

import numpy as np
from numba import njit


@njit(cache=True)
def _nearest(depth, r, c, reach):  # pragma: no cover - compiled
    height, width = depth.shape
    out = depth[r, c]
    if out > 0:
        return out
    best, place = reach * reach + 1, 0
    ring = 1
    while ring * ring <= best and ring <= reach:  # rings farther out hold nothing as near
        for y in range(max(r - ring, 0), min(r + ring, height - 1) + 1):
            edge = y == r - ring or y == r + ring
            step = 1 if edge else 2 * ring
            for x in range(c - ring, c + ring + 1, step):
                if x < 0 or x >= width or depth[y, x] <= 0:
                    continue
                far = (y - r) * (y - r) + (x - c) * (x - c)
                if far < best or (far == best and out > 0 and y * width + x < place):
                    best, place = far, y * width + x
                    out = depth[y, x]
        ring += 1
    return out


@njit(cache=True)
def nearest_readings(depth, row, column, reach):  # pragma: no cover - compiled
    """Reading of each asked pixel; where it is zero, the nearest one within `reach` pixels, 0 where there is none.

    Of readings equally near, the first row by row counts. Twin: `body.constraints.nearest_readings_numpy`.
    """
    out = np.empty(row.size, depth.dtype)
    for i in range(row.size):
        out[i] = _nearest(depth, row[i], column[i], reach)
    return out


@njit(cache=True)
def seen_through(depth, uv, z, margin, noise, reach):  # pragma: no cover - compiled
    """Whether a reading lies behind any point of each limb, by more than `margin + noise z^2`.

    `uv` (n, s, 2) and `z` (n, s) are the pixels and depths of points in the middle of each limb.
    Twin: `body.constraints.seen_through_numpy`.
    """
    height, width = depth.shape
    dead = np.zeros(z.shape[0], np.bool_)
    for i in range(z.shape[0]):
        for k in range(z.shape[1] - 1, -1, -1):  # the end is farthest from what is known, and fails most often
            u, v = uv[i, k, 0], uv[i, k, 1]
            if not (-0.5 <= u < width and -0.5 <= v < height):  # NaN behind the camera
                continue
            c, r = round(u), round(v)
            if not (0 <= c < width and 0 <= r < height):
                continue
            if float(_nearest(depth, r, c, reach)) > z[i, k] + margin + noise * z[i, k] * z[i, k]:
                dead[i] = True
                break
    return dead
