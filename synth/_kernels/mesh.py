"""The compiled loop that renders a mesh: many samples a pixel, each with its own z-buffer and its own light."""

import math

import numpy as np
from numba import njit

STRIP = 4  # rows that are worked on at once, so that the samples fit into the cache


@njit(cache=True, error_model="numpy")
def render_samples(
    xy, inverse, pinhole, p, normal, albedo, triangles, offsets, box, light, coefficients, out
):  # pragma: no cover - compiled
    """Put the mean over samples of each pixel of a box into `out`, which holds the background.

    `offsets` (s, 2) are the samples' places in a pixel, -1/2 to 1/2. `inverse` is depth, or one over it for a pinhole;
    `box` holds the first and the last row and column. Oracle: rays against every triangle, in `tests/test_synth_mesh`.
    """
    first_row, last_row, first_column, last_column = box
    width, count = last_column - first_column + 1, offsets.shape[0]
    number = np.empty((STRIP, width, count), np.int32)
    key = np.empty((STRIP, width, count))
    l1s, l2s = np.empty((STRIP, width, count)), np.empty((STRIP, width, count))
    for top in range(first_row, last_row + 1, STRIP):
        bottom = min(top + STRIP - 1, last_row)
        number[:] = -1
        key[:] = -np.inf if pinhole else np.inf
        for t in range(triangles.shape[0]):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            low_y, high_y = min(xy[a, 1], xy[b, 1], xy[c, 1]), max(xy[a, 1], xy[b, 1], xy[c, 1])
            if not (high_y >= top - 0.5 and low_y <= bottom + 0.5):
                continue
            ax, ay = xy[a, 0], xy[a, 1]
            bx, by, cx, cy = xy[b, 0] - ax, xy[b, 1] - ay, xy[c, 0] - ax, xy[c, 1] - ay
            area = bx * cy - by * cx
            if not abs(area) > 1e-12:
                continue
            left = max(int(math.floor(min(ax, xy[b, 0], xy[c, 0]) + 0.5)), first_column)
            right = min(int(math.ceil(max(ax, xy[b, 0], xy[c, 0]) - 0.5)), last_column)
            for row in range(max(int(math.floor(low_y + 0.5)), top), min(int(math.ceil(high_y - 0.5)), bottom) + 1):
                for column in range(left, right + 1):
                    for s in range(count):
                        x, y = column + offsets[s, 0] - ax, row + offsets[s, 1] - ay
                        l1, l2 = (x * cy - y * cx) / area, (bx * y - by * x) / area
                        if l1 < 0.0 or l2 < 0.0 or l1 + l2 > 1.0:
                            continue
                        z = (1.0 - l1 - l2) * inverse[a] + l1 * inverse[b] + l2 * inverse[c]
                        i, j = row - top, column - first_column
                        if z > key[i, j, s] if pinhole else z < key[i, j, s]:
                            key[i, j, s], number[i, j, s], l1s[i, j, s], l2s[i, j, s] = z, t, l1, l2
        for row in range(top, bottom + 1):
            for column in range(first_column, last_column + 1):
                i, j, total = row - top, column - first_column, 0.0
                for s in range(count):
                    t = number[i, j, s]
                    if t < 0:
                        total += out[row, column]
                        continue
                    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
                    l0, l1, l2 = 1.0 - l1s[i, j, s] - l2s[i, j, s], l1s[i, j, s], l2s[i, j, s]
                    if pinhole:
                        l0, l1, l2 = l0 * inverse[a], l1 * inverse[b], l2 * inverse[c]
                        whole = l0 + l1 + l2
                        l0, l1, l2 = l0 / whole, l1 / whole, l2 / whole
                    total += phong(p, normal, albedo, a, b, c, l0, l1, l2, pinhole, light, coefficients)
                out[row, column] = total / count


@njit(cache=True, error_model="numpy", inline="always")
def phong(p, normal, albedo, a, b, c, l0, l1, l2, pinhole, light, coefficients):  # pragma: no cover - compiled
    """Grey level at one place of a triangle; the formula of `synth.shading`."""
    ambient, diffuse, specular, shininess = coefficients
    nx = l0 * normal[a, 0] + l1 * normal[b, 0] + l2 * normal[c, 0]
    ny = l0 * normal[a, 1] + l1 * normal[b, 1] + l2 * normal[c, 1]
    nz = l0 * normal[a, 2] + l1 * normal[b, 2] + l2 * normal[c, 2]
    size = math.sqrt(nx * nx + ny * ny + nz * nz)
    scale = 1.0 / size if size > 0.0 else 0.0
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    vx, vy, vz = 0.0, 0.0, -1.0
    if pinhole:
        vx = -(l0 * p[a, 0] + l1 * p[b, 0] + l2 * p[c, 0])
        vy = -(l0 * p[a, 1] + l1 * p[b, 1] + l2 * p[c, 1])
        vz = -(l0 * p[a, 2] + l1 * p[b, 2] + l2 * p[c, 2])
        size = math.sqrt(vx * vx + vy * vy + vz * vz)
        vx, vy, vz = vx / size, vy / size, vz / size
    facing = nx * light[0] + ny * light[1] + nz * light[2]
    level = (l0 * albedo[a] + l1 * albedo[b] + l2 * albedo[c]) * (ambient + diffuse * max(facing, 0.0))
    if facing > 0.0:
        mirrored = 2.0 * facing * (nx * vx + ny * vy + nz * vz) - (light[0] * vx + light[1] * vy + light[2] * vz)
        if mirrored > 0.0:
            level += specular * math.exp(shininess * math.log(mirrored))
    return level
