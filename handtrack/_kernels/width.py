"""Compiled loops over pairs of opposite edges: the width of each profile, and of each link from its profiles."""

import math

import numpy as np
from numba import njit


@njit(cache=True, inline="always")
def edge_radius(base, tip, r0, r1, ray, slope, offset, at):  # pragma: no cover - compiled
    """Radius that the pill would need to touch the edge's ray, into `at`: radius, axial position, units per pixel."""
    o, d = np.empty(3), np.empty(3)
    dd = md = ad = 0.0
    for a in range(3):
        o[a], d[a] = ray[a] + offset * slope[a], ray[3 + a] + offset * slope[3 + a]
        dd += d[a] * d[a]
        md += (base[a] - o[a]) * d[a]
        ad += (tip[a] - base[a]) * d[a]
    size = cross = 0.0
    for a in range(3):
        m, axis = base[a] - o[a] - md / dd * d[a], tip[a] - base[a] - ad / dd * d[a]
        size += axis * axis
        cross += m * axis
    k = r1 - r0
    s = 1.0 if k > 0.0 else 0.0
    if size > k * k:
        s0, h2 = -cross / size, 0.0
        for a in range(3):
            across = base[a] - o[a] - md / dd * d[a] + s0 * (tip[a] - base[a] - ad / dd * d[a])
            h2 += across * across
        s = min(max(s0 + k * math.sqrt(h2 / (size * (size - k * k))), 0.0), 1.0)
    gap = depth = 0.0
    for a in range(3):
        across = base[a] - o[a] - md / dd * d[a] + s * (tip[a] - base[a] - ad / dd * d[a])
        gap += across * across
        depth += (base[a] - o[a] + s * (tip[a] - base[a])) * d[a]
    gap, depth, per_pixel = math.sqrt(gap), depth / dd, 0.0
    for a in range(3):
        across = base[a] - o[a] - md / dd * d[a] + s * (tip[a] - base[a] - ad / dd * d[a])
        per_pixel -= across * (slope[a] + depth * slope[3 + a])
    at[0], at[1], at[2] = gap, s, abs(per_pixel) / max(gap, 1e-12)


@njit(cache=True)
def opposite_edges(found, link, along, side, plus, minus):  # pragma: no cover - compiled
    """Pairs of edges at one place on both sides, and their number; twin: `width.opposite_edges_numpy`."""
    n, count, ahead = link.shape[0], 0, 0
    for p in range(n):
        if not found[p] or side[p] != 1:
            continue
        for step in range(n):  # the opposite one stands right behind the last one's, if there is no gap
            m = ahead + step if ahead + step < n else ahead + step - n
            if side[m] == -1 and link[m] == link[p] and along[m] == along[p]:
                if found[m]:
                    plus[count], minus[count] = p, m
                    count += 1
                ahead = m + 1 if m + 1 < n else 0
                break
    return count


@njit(cache=True)
def profile_widths(
    base, tip, radius, plus, minus, link, ray, slope, offset, sigma, xy, direction, out
):  # pragma: no cover - compiled
    """Rows of `out`: along, width, sigma, width and sigma in pixels; twin: `width.profile_widths_numpy`."""
    a, b = np.empty(3), np.empty(3)
    for i in range(plus.shape[0]):
        p, m = plus[i], minus[i]
        k = link[p]
        edge_radius(base[k], tip[k], radius[k, 0], radius[k, 1], ray[p], slope[p], offset[p], a)
        edge_radius(base[k], tip[k], radius[k, 0], radius[k, 1], ray[m], slope[m], offset[m], b)
        out[i, 0], out[i, 1] = 0.5 * (a[1] + b[1]), a[0] + b[0]
        out[i, 2] = math.hypot(a[2] * sigma[p], b[2] * sigma[m])
        nx, ny = direction[p, 0] - direction[m, 0], direction[p, 1] - direction[m, 1]
        size = math.sqrt(nx * nx + ny * ny)
        out[i, 3] = ((xy[p, 0] - xy[m, 0]) * nx + (xy[p, 1] - xy[m, 1]) * ny) / max(size, 1e-12)
        out[i, 4] = math.hypot(sigma[p], sigma[m])


@njit(cache=True)
def link_widths(rows, link, radius, common, taper, pull, clear, cut, out):  # pragma: no cover - compiled
    """Rows of `out`: the fields of `LinkWidths` in their order, as numbers; twin: `width.link_widths_numpy`."""
    count = link.shape[0]
    difference, z, weight = np.empty(count), np.empty(count), np.empty(count)
    for k in range(radius.shape[0]):
        mean, growth = radius[k, 0] + radius[k, 1], 2.0 * (radius[k, 1] - radius[k, 0])
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = 0.0, np.inf, 0.0, growth
        out[k, 4], out[k, 5], out[k, 6] = taper * mean, 0.0, 0.0
    first = 0
    while first < count:
        k = link[first]
        mean, growth = radius[k, 0] + radius[k, 1], 2.0 * (radius[k, 1] - radius[k, 0])
        last = first
        while last < count and link[last] == k:
            difference[last] = rows[last, 1] - mean - growth * (rows[last, 0] - 0.5)
            last += 1
        middle, slope, scale = np.median(difference[first:last]), 0.0, 1.0
        n0 = n1 = n2 = det = 1.0
        for _ in range(3):
            for i in range(first, last):
                z[i] = (difference[i] - middle - slope * (rows[i, 0] - 0.5)) / rows[i, 2]
            if last - first > 3:
                scale = max(1.0, 1.4826 * np.median(np.abs(z[first:last])))
            n0, n1, n2, b0, b1 = 0.0, 0.0, 1.0 / (taper * mean) ** 2, 0.0, 0.0
            for i in range(first, last):
                weight[i] = 1.0 / (1.0 + (z[i] / (cut * scale)) ** 2) / (scale * rows[i, 2]) ** 2
                s = rows[i, 0] - 0.5
                n0, n1, n2 = n0 + weight[i], n1 + weight[i] * s, n2 + weight[i] * s * s
                b0, b1 = b0 + weight[i] * difference[i], b1 + weight[i] * s * difference[i]
            det = n0 * n2 - n1 * n1
            middle, slope = (n2 * b0 - n1 * b1) / det, (n0 * b1 - n1 * b0) / det
        pixels = 0.0
        for i in range(first, last):
            pixels += weight[i] * rows[i, 3] / n0
        width = mean + middle
        shared = 2.0 * (common * width / max(abs(pixels), 1e-9)) ** 2
        missed = pull[0] if middle < 0.0 else pull[1]
        lasting = shared + missed**2 * max(middle**2 - clear**2 * (n2 / det + shared), 0.0)
        out[k, 0], out[k, 1], out[k, 2] = width, math.sqrt(n2 / det + lasting), math.sqrt(lasting)
        out[k, 3], out[k, 4], out[k, 5], out[k, 6] = growth + slope, math.sqrt(n0 / det), pixels, last - first
        first = last
