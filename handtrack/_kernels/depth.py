"""Compiled search in depth images."""

import numpy as np
from numba import njit


@njit(cache=True)
def nearest_readings(depth, row, column, reach):  # pragma: no cover - compiled
    """Reading of each asked pixel; where it is zero, the nearest one within `reach` pixels, 0 where there is none.

    Of readings equally near, the first row by row counts.
    """
    height, width = depth.shape
    out = np.empty(row.size, depth.dtype)
    for i in range(row.size):
        r, c = row[i], column[i]
        out[i] = depth[r, c]
        if out[i] > 0:
            continue
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
                    if far < best or (far == best and out[i] > 0 and y * width + x < place):
                        best, place = far, y * width + x
                        out[i] = depth[y, x]
            ring += 1
    return out
