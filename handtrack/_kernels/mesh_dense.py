"""Compiled loops that align a whole image with a mesh: pixel residuals, their Jacobian, what moving outlines add."""

import math

import numpy as np
from numba import njit

from .mesh_image import EDGE, EDGE_POINTS, EDGE_STEP, RIM, RIM_POINTS, RIM_STEP, table_level, table_slope
from .raster import first_triangle, state_of_contour

THIN = 0.1  # pixels: a triangle less high than this is seen edge on, and what slides beneath a point of it is not told


@njit(cache=True)
def dense_rows(
    pixel, kind, level, mesh, region, vertices, light, background, noise, r, J, B, on_region
):  # pragma: no cover - compiled
    """Residuals (level - expected) / noise of pixels, their Jacobian as far as the surface moves beneath them, and B.

    A pixel inside is its centre; on an edge or beside one it is the mean over points of it, those beyond the surface
    being background. At a point the triangle moves beneath it: its shares l of the corners change by
    `dl = -A^-1 sum l_i dxy_i`, A the two edges of the triangle; the normal is `sum l_i s_i n_i` to unit length, s one
    over depth for a pinhole; the albedo is blended by l. B: derivative by an even light, one that grows with each
    component of the normal, the one light, and the regions' gains. Residuals are those of a twin,
    `surface.image.shade_box_numpy`, derivatives those of differences of it.
    """
    xy, inverse, pinhole, triangles, tiles = mesh
    dxy, s, ds, n, dn, albedo, moved = vertices
    lamp, gain, table, low, spacing = light
    size_l = math.sqrt(lamp[0] ** 2 + lamp[1] ** 2 + lamp[2] ** 2)
    slope, d, g = np.empty(3), np.empty(3), np.empty(3)
    room = np.empty((4, 4))
    k = J.shape[1]
    for i in range(pixel.shape[0]):
        count, step = 1, 1
        if kind[i] == RIM:
            count, step = RIM_POINTS, RIM_STEP
        elif kind[i] == EDGE:
            count, step = EDGE_POINTS, EDGE_STEP
        part = 1.0 / count
        expected = 0.0
        J[i], B[i] = 0.0, 0.0
        on_region[i] = -1
        for point in range(count):
            px = pixel[i, 0] - 0.5 + (point + 0.5) / count
            py = pixel[i, 1] - 0.5 + (point * step % count + 0.5) / count
            t, _, _, _, _ = first_triangle(px, py, xy, inverse, pinhole, triangles, tiles)
            if t < 0:
                expected += part * background
                continue
            on_region[i] = region[t]
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            bx, by = xy[b, 0] - xy[a, 0], xy[b, 1] - xy[a, 1]
            cx, cy = xy[c, 0] - xy[a, 0], xy[c, 1] - xy[a, 1]
            area = bx * cy - by * cx
            x, y = px - xy[a, 0], py - xy[a, 1]
            l1, l2 = (x * cy - y * cx) / area, (bx * y - by * x) / area
            l0 = 1.0 - l1 - l2
            w0, w1, w2 = l0 * s[a], l1 * s[b], l2 * s[c]
            size = 0.0
            for q in range(3):
                d[q] = w0 * n[a, q] + w1 * n[b, q] + w2 * n[c, q]
                size += d[q] * d[q]
            size = math.sqrt(size)
            if size == 0.0:
                continue
            for q in range(3):
                d[q] /= size
            lit = lamp[0] * d[0] + lamp[1] * d[1] + lamp[2] * d[2]
            for q in range(3):
                slope[q] = lamp[q] if lit > 0.0 else 0.0
            value = max(lit, 0.0) + table_slope(table, low, spacing, d, room, slope)
            factor = gain[region[t]]
            colour = l0 * albedo[a] + l1 * albedo[b] + l2 * albedo[c]
            shown = factor * colour * value
            expected += part * shown
            lit = lit / size_l if lit > 0.0 and size_l > 0.0 else 0.0
            share = -part * factor * colour / noise
            B[i, 0] += share
            B[i, 1], B[i, 2], B[i, 3] = B[i, 1] + share * d[0], B[i, 2] + share * d[1], B[i, 3] + share * d[2]
            B[i, 4] += share * lit
            B[i, 5 + region[t]] -= part * shown / noise
            longest = max(bx * bx + by * by, cx * cx + cy * cy, (bx - cx) ** 2 + (by - cy) ** 2)
            if area * area < THIN * THIN * longest:
                continue
            along = slope[0] * d[0] + slope[1] * d[1] + slope[2] * d[2]
            scale = -part * factor * colour / (noise * size)
            painted = -part * factor * value / noise
            ga = gb = gc = 0.0
            for q in range(3):
                g[q] = (slope[q] - along * d[q]) * scale
                ga, gb, gc = ga + g[q] * n[a, q], gb + g[q] * n[b, q], gc + g[q] * n[c, q]
            for j in range(k):
                if not moved[t, j]:
                    continue
                mx = l0 * dxy[a, 0, j] + l1 * dxy[b, 0, j] + l2 * dxy[c, 0, j]
                my = l0 * dxy[a, 1, j] + l1 * dxy[b, 1, j] + l2 * dxy[c, 1, j]
                d1, d2 = -(mx * cy - my * cx) / area, -(bx * my - by * mx) / area
                total = ga * (-(d1 + d2) * s[a] + l0 * ds[a, j])
                total += gb * (d1 * s[b] + l1 * ds[b, j]) + gc * (d2 * s[c] + l2 * ds[c, j])
                for q in range(3):
                    total += g[q] * (w0 * dn[a, q, j] + w1 * dn[b, q, j] + w2 * dn[c, q, j])
                total += painted * (d1 * (albedo[b] - albedo[a]) + d2 * (albedo[c] - albedo[a]))
                J[i, j] += total
        r[i] = (level[i] - expected) / noise


@njit(cache=True, inline="always")
def level_of(hit, triangles, n, albedo, region, light, background, wx, wy):  # pragma: no cover - compiled
    """Grey level of what `first_triangle` has met."""
    k, b0, b1, b2, _ = hit
    if k < 0:
        return background
    lamp, gain, table, low, spacing = light
    a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
    x = b0 * n[a, 0] + b1 * n[b, 0] + b2 * n[c, 0]
    y = b0 * n[a, 1] + b1 * n[b, 1] + b2 * n[c, 1]
    z = b0 * n[a, 2] + b1 * n[b, 2] + b2 * n[c, 2]
    size = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / size if size > 0.0 else 0.0
    x, y, z = x * scale, y * scale, z * scale
    factor = gain[region[k]] * (b0 * albedo[a] + b1 * albedo[b] + b2 * albedo[c])
    lit = max(lamp[0] * x + lamp[1] * y + lamp[2] * z, 0.0)
    return factor * (lit + table_level(table, low, spacing, x, y, z, wx, wy))


@njit(cache=True)
def add_outline(
    origin,
    direction,
    contact,
    motion,
    length,
    row_of,
    x0,
    y0,
    mesh,
    region,
    finger,
    area,
    n,
    albedo,
    light,
    rest,
    J,
    contrast,
):  # pragma: no cover - compiled
    """Add to J what moving outlines do to the pixels they cross.

    A piece of outline of `length` pixels that moves outwards by `motion` per unit of a joint turns background into
    surface: the pixel changes by (inside - outside) motion length. `row_of` holds each pixel's row of J, or -1.
    `contrast` gets the largest such step of each row, in units of the noise.
    Twin: `surface.outline.outline_numpy`.
    """
    xy, inverse, pinhole, triangles, tiles = mesh
    background, noise = rest
    wx, wy = np.empty(4), np.empty(4)
    height, width = row_of.shape
    for i in range(origin.shape[0]):
        ox, oy, dx, dy = origin[i, 0], origin[i, 1], direction[i, 0], direction[i, 1]
        c, r = int(math.floor(ox + 0.5)) - x0, int(math.floor(oy + 0.5)) - y0
        if c < 0 or r < 0 or c >= width or r >= height or row_of[r, c] < 0:
            continue
        inside = first_triangle(ox - 0.2 * dx, oy - 0.2 * dy, xy, inverse, pinhole, triangles, tiles)
        outside = first_triangle(ox + 0.2 * dx, oy + 0.2 * dy, xy, inverse, pinhole, triangles, tiles)
        state = state_of_contour(
            inside, outside, contact[i, 0], int(contact[i, 1]), contact[i, 2], contact[i, 3], finger, region, area
        )
        if state != 0:
            continue
        step = level_of(inside, triangles, n, albedo, region, light, background, wx, wy)
        step -= level_of(outside, triangles, n, albedo, region, light, background, wx, wy)
        scale = -step * length[i] / noise
        contrast[row_of[r, c]] = max(contrast[row_of[r, c]], abs(step) / noise)
        for j in range(J.shape[1]):
            J[row_of[r, c], j] += scale * motion[i, j]
