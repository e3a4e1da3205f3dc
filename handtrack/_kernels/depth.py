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


@njit(cache=True, error_model="numpy")
def seen_through(
    depth, p, father, shares, lens, bend, perspective, margin, noise, reach
):  # pragma: no cover - compiled
    """Whether a reading lies behind a point on the way from each father to each particle, by `margin + noise z^2`.

    `shares` (s,) are the places of the points on the way, `lens` is fx, fy, cx, cy and `bend` k1 k2 p1 p2 k3.
    Twin: `body.constraints.seen_through_numpy`.
    """
    height, width = depth.shape
    fx, fy, cx, cy = lens
    k1, k2, p1, p2, k3 = bend
    dead = np.zeros(p.shape[0], np.bool_)
    for i in range(p.shape[0]):
        for k in range(shares.size - 1, -1, -1):  # the end is farthest from what is known, and fails most often
            s = shares[k]
            x = father[i, 0] + s * (p[i, 0] - father[i, 0])
            y = father[i, 1] + s * (p[i, 1] - father[i, 1])
            z = father[i, 2] + s * (p[i, 2] - father[i, 2])
            if perspective:
                if not z > 0.0:
                    continue
                x, y = x / z, y / z
                r2 = x * x + y * y
                radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
                x, y = (
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                )
            u, v = x * fx + cx, y * fy + cy
            if not (-0.5 <= u < width and -0.5 <= v < height):
                continue
            c, r = round(u), round(v)
            if not (0 <= c < width and 0 <= r < height):
                continue
            if float(_nearest(depth, r, c, reach)) > z + margin + noise * z * z:
                dead[i] = True
                break
    return dead
