"""Compiled loops of learning the appearance: points on and beside the links, their noise, and the one light."""

import math

import numpy as np
from numba import njit

from .placing import bend, pixel_ray


@njit(cache=True, error_model="numpy")
def surface_points(
    image, base, tip, radius, ortho, intrinsic, k, along, across, blur, points, level, origin, direction
):  # pragma: no cover - compiled
    """Points on and beside every link that are inside the image, with grey levels and rays; returns how many.

    Twin: `appearance.surface_samples_numpy`.
    """
    height, width = image.shape
    focal, count, ray = 0.5 * (intrinsic[0] + intrinsic[1]), 0, np.empty(6)
    for m in range(base.shape[0]):
        bx, by, tx, ty, unit = base[m, 0], base[m, 1], tip[m, 0], tip[m, 1], focal
        if not ortho:
            if base[m, 2] <= 0.0 or tip[m, 2] <= 0.0:
                continue
            bx, by = bend(bx / base[m, 2], by / base[m, 2], k)
            tx, ty = bend(tx / tip[m, 2], ty / tip[m, 2], k)
            x, y, z = base[m, 0] + tip[m, 0], base[m, 1] + tip[m, 1], base[m, 2] + tip[m, 2]
            unit = focal / (0.5 * math.sqrt(x * x + y * y + z * z))
        bx, by = bx * intrinsic[0] + intrinsic[2], by * intrinsic[1] + intrinsic[3]
        ax, ay = tx * intrinsic[0] + intrinsic[2] - bx, ty * intrinsic[1] + intrinsic[3] - by
        length = max(math.sqrt(ax * ax + ay * ay), 1e-9)
        size = 0.5 * (radius[m, 0] + radius[m, 1]) * unit
        rim = max(1.0 - 2.0 * blur / max(size, 1.0), 0.5)  # as near to the edge as blur allows
        for s in along:
            for c in across:
                beyond = c + (0.967 - rim if c > 0.0 else rim - 0.967)
                share = size * (min(max(c, -rim), rim) if abs(c) < 1.0 else beyond)
                x, y = bx + s * ax - share * ay / length, by + s * ay + share * ax / length
                if not (0.0 <= x <= width - 1 and 0.0 <= y <= height - 1):
                    continue
                x0, y0 = int(x), int(y)
                x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
                top = image[y0, x0] * (1.0 - (x - x0)) + image[y0, x1] * (x - x0)
                bottom = image[y1, x0] * (1.0 - (x - x0)) + image[y1, x1] * (x - x0)
                level[count] = top * (1.0 - (y - y0)) + bottom * (y - y0)
                points[count, 0], points[count, 1] = x, y
                pixel_ray(x, y, ortho, intrinsic, k, ray)
                for a in range(3):
                    origin[count, a], direction[count, a] = ray[a], ray[3 + a]
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def second_differences(image, points, chosen, out):  # pragma: no cover - compiled
    """Sizes of second differences along rows at the chosen points; returns how many; twin: `appearance.noise_numpy`."""
    height, width = image.shape
    count = 0
    for i in range(points.shape[0]):
        x, y = np.rint(points[i, 0]), np.rint(points[i, 1])
        if chosen[i] and 1.0 <= x < width - 1 and 0.0 <= y < height:
            row, column = int(y), int(x)
            out[count] = abs(image[row, column - 1] - 2.0 * image[row, column] + image[row, column + 1])
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def find_light(normal, target, weight, light, rounds):  # pragma: no cover - compiled
    """Direction of one light by alternating least squares, from a first guess; twin: `appearance.light_numpy`.

    Which points are lit follows from the light; level and light are linear in the lit ones' normals.
    """
    A, b, row = np.empty((4, 4)), np.empty(4), np.empty(4)
    found = light.copy()
    for _ in range(rounds):
        A[:], b[:] = 0.0, 0.0
        for i in range(normal.shape[0]):
            if weight[i] == 0.0:
                continue
            x, y, z = normal[i, 0], normal[i, 1], normal[i, 2]
            lit = 1.0 if x * found[0] + y * found[1] + z * found[2] > 0.0 else 0.0
            row[0], row[1], row[2], row[3] = 1.0, lit * x, lit * y, lit * z
            for a in range(4):
                size = weight[i] * row[a]
                b[a] += size * target[i]
                for c in range(a + 1):
                    A[a, c] += size * row[c]
        ridge = 1e-3 * max(A[0, 0], 1.0)
        for a in range(4):
            A[a, a] += ridge
            for c in range(a):
                A[c, a] = A[a, c]
        solution = np.linalg.solve(A, b)
        size = math.sqrt(solution[1] ** 2 + solution[2] ** 2 + solution[3] ** 2)
        found[0], found[1], found[2] = 0.0, 0.0, -1.0
        if size > 1e-6:
            found[0], found[1], found[2] = solution[1] / size, solution[2] / size, solution[3] / size
    return found


@njit(cache=True, error_model="numpy")
def fill_shading(basis, normal, light, gain, link, root, lit, design):  # pragma: no cover - compiled
    """Rows of the shading model times gain and root of weight; twin: `appearance.design_numpy`."""
    columns = basis.shape[1]
    for i in range(basis.shape[0]):
        lit[i] = max(normal[i, 0] * light[0] + normal[i, 1] * light[1] + normal[i, 2] * light[2], 0.0)
        scale = gain[link[i]] * root[i]
        for a in range(columns):
            design[i, a] = basis[i, a] * scale
        design[i, columns] = lit[i] * scale
