"""Compiled loops that shade a mesh: a table over normals beside one light, whole images with soft outlines."""

import math

import numpy as np
from numba import njit

from .raster import first_triangle, plane_of

INSIDE, RIM, EDGE = 1, 2, 3
# Points of a pixel: Fibonacci lattices, which show an edge in any direction as nearly as many grey levels as they have
# points. (number, step): point i lies at ((i + 1/2) / number, (i step mod number + 1/2) / number).
RIM_POINTS, RIM_STEP = 5, 3
EDGE_POINTS, EDGE_STEP = 13, 8


@njit(cache=True, inline="always")
def spline_place(x, low, spacing, size, weight):  # pragma: no cover - compiled
    """First of the four cubic B-splines at x on a grid, and their values."""
    at = (x - low) / spacing
    at = min(max(at, 1.0), size - 2.000001)
    i = int(at)
    f = at - i
    g = 1.0 - f
    weight[0] = g * g * g / 6.0
    weight[1] = (3.0 * f * f * (f - 2.0) + 4.0) / 6.0
    weight[2] = (3.0 * g * g * (g - 2.0) + 4.0) / 6.0
    weight[3] = f * f * f / 6.0
    return i - 1


@njit(cache=True, inline="always")
def table_level(table, low, spacing, x, y, z, wx, wy):  # pragma: no cover - compiled
    """Value of the table at a unit normal, mapped to a plane with equal areas about the direction to the camera."""
    scale = math.sqrt(2.0 / max(1.0 - z, 0.2))
    i = spline_place(x * scale, low, spacing, table.shape[1], wx)
    j = spline_place(y * scale, low, spacing, table.shape[0], wy)
    total = 0.0
    for b in range(4):
        row = 0.0
        for a in range(4):
            row += table[j + b, i + a] * wx[a]
        total += row * wy[b]
    return total


@njit(cache=True)
def table_rows(normal, low, spacing, size, column, weight):  # pragma: no cover - compiled
    """Sixteen columns and values of a normal's row in the table's design; twin: `surface.shading.table_rows_numpy`."""
    wx, wy = np.empty(4), np.empty(4)
    for n in range(normal.shape[0]):
        x, y, z = normal[n, 0], normal[n, 1], normal[n, 2]
        scale = math.sqrt(2.0 / max(1.0 - z, 0.2))
        i = spline_place(x * scale, low, spacing, size, wx)
        j = spline_place(y * scale, low, spacing, size, wy)
        for b in range(4):
            for a in range(4):
                column[n, 4 * b + a] = (j + b) * size + i + a
                weight[n, 4 * b + a] = wx[a] * wy[b]


@njit(cache=True)
def add_rows(column, weight, right, importance, matrix, vector):  # pragma: no cover - compiled
    """Add sparse rows to normal equations, lower triangle; twin: a dense product in the tests of `surface.shading`."""
    for n in range(column.shape[0]):
        for a in range(column.shape[1]):
            w = weight[n, a] * importance[n]
            vector[column[n, a]] += w * right[n]
            for b in range(column.shape[1]):
                if column[n, b] <= column[n, a]:
                    matrix[column[n, a], column[n, b]] += w * weight[n, b]


@njit(cache=True)
def fill_depth(xy, inverse, pinhole, triangles, x0, y0, triangle, depth):  # pragma: no cover - compiled
    """Z-buffer of a box of the image whose first pixel is (x0, y0); twin: `surface.raster.rasterise_numpy`."""
    height, width = triangle.shape
    for k in range(triangles.shape[0]):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        usable, ax, ay, l1x, l1y, l2x, l2y = plane_of(xy, a, b, c)
        if not usable:
            continue
        left = max(int(math.ceil(min(xy[a, 0], xy[b, 0], xy[c, 0]))) - x0, 0)
        right = min(int(math.floor(max(xy[a, 0], xy[b, 0], xy[c, 0]))) - x0, width - 1)
        top = max(int(math.ceil(min(xy[a, 1], xy[b, 1], xy[c, 1]))) - y0, 0)
        bottom = min(int(math.floor(max(xy[a, 1], xy[b, 1], xy[c, 1]))) - y0, height - 1)
        za, zb, zc = inverse[a], inverse[b], inverse[c]
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                l1 = (x + x0 - ax) * l1x + (y + y0 - ay) * l1y
                l2 = (x + x0 - ax) * l2x + (y + y0 - ay) * l2y
                l0 = 1.0 - l1 - l2
                if l0 < -1e-12 or l1 < -1e-12 or l2 < -1e-12:
                    continue
                number = l0 * za + l1 * zb + l2 * zc
                z = 1.0 / number if pinhole else number
                if z < depth[y, x]:
                    depth[y, x], triangle[y, x] = z, k


@njit(cache=True)
def classify(triangle, depth, jump, rim, kind):  # pragma: no cover - compiled
    """0 where neither a pixel nor its neighbours show the mesh, else INSIDE, RIM (within `rim` of an edge) or EDGE.

    An edge is where one of the eight neighbours differs in being hit, or in depth by more than the triangle's `jump`.
    """
    height, width = triangle.shape
    for y in range(height):
        for x in range(width):
            k = triangle[y, x]
            found = INSIDE if k >= 0 else 0
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    r, c = y + dy, x + dx
                    if r < 0 or c < 0 or r >= height or c >= width:
                        continue
                    other = triangle[r, c]
                    if (other >= 0) != (k >= 0) or (
                        k >= 0 and abs(depth[r, c] - depth[y, x]) > max(jump[k], jump[other])
                    ):
                        found = EDGE
            kind[y, x] = found
    for y in range(height):
        for x in range(width):
            if kind[y, x] != EDGE:
                continue
            for r in range(max(y - rim, 0), min(y + rim + 1, height)):
                for c in range(max(x - rim, 0), min(x + rim + 1, width)):
                    if kind[r, c] == INSIDE:
                        kind[r, c] = RIM


@njit(cache=True, inline="always")
def shade_point(k, b0, b1, b2, triangles, normal, albedo, region, light, wx, wy):  # pragma: no cover - compiled
    """Grey level at one place of a triangle."""
    lamp, gain, table, low, spacing = light
    a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
    x = b0 * normal[a, 0] + b1 * normal[b, 0] + b2 * normal[c, 0]
    y = b0 * normal[a, 1] + b1 * normal[b, 1] + b2 * normal[c, 1]
    z = b0 * normal[a, 2] + b1 * normal[b, 2] + b2 * normal[c, 2]
    size = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / size if size > 0.0 else 0.0
    x, y, z = x * scale, y * scale, z * scale
    colour = b0 * albedo[a] + b1 * albedo[b] + b2 * albedo[c]
    lit = max(lamp[0] * x + lamp[1] * y + lamp[2] * z, 0.0)
    return gain[region[k]] * colour * (lit + table_level(table, low, spacing, x, y, z, wx, wy))


@njit(cache=True)
def shade_box(
    x0, y0, triangle, kind, wanted, mesh, normal, albedo, region, light, background, image
):  # pragma: no cover - compiled
    """Grey levels of a box: pixel centres inside, the mean over points of the pixel on edges and rims.

    Pixels that are not wanted keep the background. Twin: `surface.image.shade_box_numpy`.
    """
    xy, inverse, pinhole, triangles, tiles = mesh
    wx, wy = np.empty(4), np.empty(4)
    height, width = triangle.shape
    for r in range(height):
        for c in range(width):
            what = kind[r, c]
            image[r, c] = background
            if what == 0 or not wanted[r, c]:
                continue
            k = triangle[r, c]
            if what == INSIDE:
                va, vb, vc = triangles[k, 0], triangles[k, 1], triangles[k, 2]
                _, ax, ay, l1x, l1y, l2x, l2y = plane_of(xy, va, vb, vc)
                l1 = (c + x0 - ax) * l1x + (r + y0 - ay) * l1y
                l2 = (c + x0 - ax) * l2x + (r + y0 - ay) * l2y
                l0 = 1.0 - l1 - l2
                if pinhole:
                    l0, l1, l2 = l0 * inverse[va], l1 * inverse[vb], l2 * inverse[vc]
                    total = l0 + l1 + l2
                    l0, l1, l2 = l0 / total, l1 / total, l2 / total
                image[r, c] = shade_point(k, l0, l1, l2, triangles, normal, albedo, region, light, wx, wy)
                continue
            points, step = (EDGE_POINTS, EDGE_STEP) if what == EDGE else (RIM_POINTS, RIM_STEP)
            total = 0.0
            for i in range(points):
                x = c + x0 - 0.5 + (i + 0.5) / points
                y = r + y0 - 0.5 + (i * step % points + 0.5) / points
                k, b0, b1, b2, _ = first_triangle(x, y, xy, inverse, pinhole, triangles, tiles)
                if k < 0:
                    total += background
                else:
                    total += shade_point(k, b0, b1, b2, triangles, normal, albedo, region, light, wx, wy)
            image[r, c] = total / points


@njit(cache=True, inline="always")
def spline_slope(x, low, spacing, size, weight):  # pragma: no cover - compiled
    """Derivatives of the four cubic B-splines at x; zero beyond the grid."""
    at = (x - low) / spacing
    if at < 1.0 or at > size - 2.000001:
        weight[0] = weight[1] = weight[2] = weight[3] = 0.0
        return
    f = at - int(at)
    g = 1.0 - f
    weight[0] = -0.5 * g * g / spacing
    weight[1] = 0.5 * f * (3.0 * f - 4.0) / spacing
    weight[2] = -0.5 * g * (3.0 * g - 4.0) / spacing
    weight[3] = 0.5 * f * f / spacing


@njit(cache=True, inline="always")
def table_slope(table, low, spacing, n, room, slope):  # pragma: no cover - compiled
    """Value of the table at a normal; its derivative by the normal is added to `slope`. `room` is (4, 4)."""
    wx, wy, dx, dy = room[0], room[1], room[2], room[3]
    free = 1.0 - n[2] > 0.2
    scale = math.sqrt(2.0 / max(1.0 - n[2], 0.2))
    x, y = n[0] * scale, n[1] * scale
    i = spline_place(x, low, spacing, table.shape[1], wx)
    j = spline_place(y, low, spacing, table.shape[0], wy)
    spline_slope(x, low, spacing, table.shape[1], dx)
    spline_slope(y, low, spacing, table.shape[0], dy)
    value = by_x = by_y = 0.0
    for b in range(4):
        row = along = 0.0
        for a in range(4):
            c = table[j + b, i + a]
            row += c * wx[a]
            along += c * dx[a]
        value += row * wy[b]
        by_x += along * wy[b]
        by_y += row * dy[b]
    slope[0] += by_x * scale
    slope[1] += by_y * scale
    if free:
        slope[2] += (by_x * n[0] + by_y * n[1]) * 0.5 * scale / (1.0 - n[2])
    return value


@njit(cache=True)
def mark_profiles(origin, direction, u, x0, y0, reach, wanted):  # pragma: no cover - compiled
    """Mark the pixels of a box that samples between pixel centres read, and those within `reach` of them."""
    height, width = wanted.shape
    for i in range(origin.shape[0]):
        for j in range(u.shape[0]):
            c = int(math.floor(origin[i, 0] + u[j] * direction[i, 0])) - x0
            r = int(math.floor(origin[i, 1] + u[j] * direction[i, 1])) - y0
            for y in range(max(r - reach, 0), min(r + reach + 2, height)):
                for x in range(max(c - reach, 0), min(c + reach + 2, width)):
                    wanted[y, x] = True
