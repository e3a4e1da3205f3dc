"""The compiled pixel loops of the renderer; each has a plain NumPy twin, named in its docstring, that a test compares.

A `pinhole` flag stands for the projection: rays leave the origin through (x, y, 1), or run along z through (x, y, 0), where
(x, y) are the normalised coordinates of a pixel, so that the ray parameter is the depth in both. `pills` is the tuple of axis
bases, tips and radii; `look` is (mode, coefficients, light, mesh) of `synth.shading`.
"""

import math

import numpy as np
from numba import njit

HALVINGS = 7  # bisections of the place where a line crosses an edge: to 1/128 pixel
GAUSS = 0.5 / math.sqrt(3.0)  # offset of the two Gauss nodes from the middle of an interval of length 1
TIE = 1e-9  # depths closer than this are equal and the first pill wins: neighbouring links share a sphere
BINARY, FLAT, GOURAUD, PHONG = 0, 1, 2, 3


@njit(cache=True, inline="always")
def pill_depth(x, y, pinhole, pills, k):  # pragma: no cover - compiled
    """Depth of a pill's first point on a ray, inf where missed; twin and derivation: `synth.raycast.pill_depth`."""
    ax, ay, az, ux, uy, uz = pills[k, 0], pills[k, 1], pills[k, 2], pills[k, 3], pills[k, 4], pills[k, 5]
    length, r0, r1, slope, c2 = pills[k, 6], pills[k, 7], pills[k, 8], pills[k, 9], pills[k, 10]
    if pinhole:
        mx, my, mz = -ax, -ay, -az
        dx, dy = x, y
    else:
        mx, my, mz = x - ax, y - ay, -az
        dx, dy = 0.0, 0.0
    dd = dx * dx + dy * dy + 1.0
    md = mx * dx + my * dy + mz
    mm = mx * mx + my * my + mz * mz
    m_u, d_u = mx * ux + my * uy + mz * uz, dx * ux + dy * uy + uz
    w = r0 - slope * m_u
    a = c2 * dd - d_u * d_u
    b = c2 * (md - m_u * d_u) + slope * d_u * w
    c = c2 * (mm - m_u * m_u) - w * w
    gap = b * b - a * c
    if gap < 0.0 and a > 0.0:
        return math.inf
    best = math.inf
    if gap >= 0.0:
        root = math.sqrt(gap)
        bottom = root - b if b <= 0.0 else a
        if bottom != 0.0:
            t = (c if b <= 0.0 else -b - root) / bottom
            side = m_u + t * d_u
            if side >= r0 * slope and side <= length + r1 * slope:
                best = t
    if best == math.inf:
        gap = md * md - dd * (mm - r0 * r0)
        if gap >= 0.0:
            best = (-md - math.sqrt(gap)) / dd
        md -= length * d_u
        gap = md * md - dd * (mm - 2.0 * length * m_u + length * length - r1 * r1)
        if gap >= 0.0:
            best = min(best, (-md - math.sqrt(gap)) / dd)
    return best if best > 0.0 or not pinhole else math.inf


@njit(cache=True, inline="always")
def pill_normal(x, y, t, pinhole, pills, k):  # pragma: no cover - compiled
    """Outward normal where a pill is hit; twin and derivation: `synth.raycast.pill_normal`."""
    px, py = (x * t, y * t) if pinhole else (x, y)
    px, py, pz = px - pills[k, 0], py - pills[k, 1], t - pills[k, 2]
    ux, uy, uz = pills[k, 3], pills[k, 4], pills[k, 5]
    length, r0, slope = pills[k, 6], pills[k, 7], pills[k, 9]
    along = (px * ux + py * uy + pz * uz - r0 * slope) / pills[k, 10]
    along = min(max(along, 0.0), length)
    radius = r0 - slope * along
    return (px - along * ux) / radius, (py - along * uy) / radius, (pz - along * uz) / radius


@njit(cache=True)
def cast_pixels(grid, pinhole, pills, boxes, depth, part, normal):  # pragma: no cover - compiled
    """First pill at every pixel centre, one box of pixels per pill; twin: `synth.raycast.cast_numpy`."""
    for k in range(boxes.shape[0]):
        for v in range(boxes[k, 2], boxes[k, 3]):
            for u in range(boxes[k, 0], boxes[k, 1]):
                t = pill_depth(grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1], pinhole, pills, k)
                if t < depth[v, u] - TIE:
                    depth[v, u] = t
                    part[v, u] = k
    for k in range(boxes.shape[0]):
        for v in range(boxes[k, 2], boxes[k, 3]):
            for u in range(boxes[k, 0], boxes[k, 1]):
                if part[v, u] == k:
                    x, y, t = grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1], depth[v, u]
                    normal[v, u, 0], normal[v, u, 1], normal[v, u, 2] = pill_normal(x, y, t, pinhole, pills, k)


@njit(cache=True)
def facet_place(p, n, pill, mesh):  # pragma: no cover - compiled
    """Continuous (ring, sector) of a surface point in a pill's facet mesh; twin: `synth.facets.facet_place`."""
    frames, shape, _ = mesh
    f = frames[pill]
    length, slope, radius = f[4, 0], f[4, 1], f[4, 2]
    lean = n[0] * f[1, 0] + n[1] * f[1, 1] + n[2] * f[1, 2]
    axial = (p[0] - f[0, 0]) * f[1, 0] + (p[1] - f[0, 1]) * f[1, 1] + (p[2] - f[0, 2]) * f[1, 2]
    along = min(max((axial - radius * slope) / (1.0 - slope * slope), 0.0), length)
    ring = shape[1] * (along / length if length > 0.0 else 0.0)
    ring += shape[0] * min(math.acos(min(max(-lean, -1.0), 1.0)) / math.acos(-slope), 1.0)
    ring += shape[0] * max(1.0 - math.acos(min(max(lean, -1.0), 1.0)) / math.acos(slope), 0.0)
    east = n[0] * f[2, 0] + n[1] * f[2, 1] + n[2] * f[2, 2]
    north = n[0] * f[3, 0] + n[1] * f[3, 1] + n[2] * f[3, 2]
    return ring, (math.atan2(north, east) / (2.0 * math.pi) + 0.5) * shape[2]


@njit(cache=True)
def facet_light(place, pill, mesh, smooth):  # pragma: no cover - compiled
    """Body and gloss light of a facet, or between its four corners; twin: `synth.facets.facet_light`."""
    _, shape, table = mesh
    rings = 2 * shape[0] + shape[1]
    i, j = min(int(place[0]), rings - 1), min(int(place[1]), shape[2] - 1)
    if not smooth:
        return table[pill, i, j, 0], table[pill, i, j, 1]
    a, b = place[0] - i, place[1] - j
    body, gloss, k = 0.0, 0.0, (j + 1) % shape[2]
    for row, col, w in (
        (i, j, (1.0 - a) * (1.0 - b)),
        (i, k, (1.0 - a) * b),
        (i + 1, j, a * (1.0 - b)),
        (i + 1, k, a * b),
    ):
        body += w * table[pill, row, col, 0]
        gloss += w * table[pill, row, col, 1]
    return body, gloss


@njit(cache=True)
def point_light(n, view, coefficients, light):  # pragma: no cover - compiled
    """Body (ambient and diffuse) and gloss (specular) light, Phong's model; twin: `synth.shading.point_light`."""
    ambient, diffuse, specular, shininess = coefficients
    facing = n[0] * light[0] + n[1] * light[1] + n[2] * light[2]
    if facing <= 0.0:
        return ambient, 0.0
    if specular == 0.0:
        return ambient + diffuse * facing, 0.0
    towards = n[0] * view[0] + n[1] * view[1] + n[2] * view[2]
    mirrored = 2.0 * facing * towards - (light[0] * view[0] + light[1] * view[1] + light[2] * view[2])
    return ambient + diffuse * facing, (specular * mirrored**shininess if mirrored > 0.0 else 0.0)


@njit(cache=True)
def surface(x, y, t, n, pill, pinhole, look):  # pragma: no cover - compiled
    """What a pixel shows of a hit: (key, body, gloss); the key changes wherever the image may jump."""
    mode, coefficients, light, mesh = look
    if mode == BINARY:
        return 0, 1.0, 0.0
    if mode == PHONG:
        if not pinhole:
            body, gloss = point_light(n, (0.0, 0.0, -1.0), coefficients, light)
            return pill, body, gloss
        s = -1.0 / math.sqrt(x * x + y * y + 1.0)
        body, gloss = point_light(n, (x * s, y * s, s), coefficients, light)
        return pill, body, gloss
    p = (x * t, y * t, t) if pinhole else (x, y, t)
    place = facet_place(p, n, pill, mesh)
    body, gloss = facet_light(place, pill, mesh, mode == GOURAUD)
    if mode == GOURAUD:
        return pill, body, gloss
    shape = mesh[1]
    rings = 2 * shape[0] + shape[1]
    return (pill * rings + min(int(place[0]), rings - 1)) * shape[2] + min(int(place[1]), shape[2] - 1), body, gloss


@njit(cache=True)
def first_pill(x, y, pinhole, pills, chosen, count):  # pragma: no cover - compiled
    """Depth and number (-1 where missed) of the first of some pills on a ray; twin: `synth.raycast.first_hits`."""
    best, pill = math.inf, -1
    for i in range(count):
        t = pill_depth(x, y, pinhole, pills, chosen[i])
        if t < best - TIE:
            best, pill = t, chosen[i]
    return best, pill


@njit(cache=True)
def key_at(x, y, pinhole, pills, chosen, count, look):  # pragma: no cover - compiled
    """Key of what a ray sees, -1 on the background."""
    t, pill = first_pill(x, y, pinhole, pills, chosen, count)
    if pill < 0 or look[0] == BINARY:
        return min(pill, 0)
    if look[0] != FLAT:
        return pill
    return surface(x, y, t, pill_normal(x, y, t, pinhole, pills, pill), pill, pinhole, look)[0]


@njit(cache=True)
def covered(middle, slope):  # pragma: no cover - compiled
    """Area of the unit pixel left of the line x = middle + slope y; twin and derivation: `synth.edges.covered`."""
    if abs(slope) < 1e-6:
        return 0.5 + min(max(middle, -0.5), 0.5)
    total = 0.0
    for sign in (-1.0, 1.0):
        z = abs(middle + 0.5 * sign * slope)
        total += sign * (0.5 * z * z if z <= 0.5 else 0.5 * z - 0.125)
    return 0.5 + total / slope


@njit(cache=True)
def crossing(x, y, ax, ay, pinhole, pills, chosen, count, look):  # pragma: no cover - compiled
    """Keys at both ends of a line from -1 to 1, and where the first key ends (1 where both agree)."""
    first = key_at(x - ax, y - ay, pinhole, pills, chosen, count, look)
    last = key_at(x + ax, y + ay, pinhole, pills, chosen, count, look)
    if first == last:
        return first, last, 1.0
    low, high = -1.0, 1.0
    for _ in range(HALVINGS):
        cut = 0.5 * (low + high)
        if key_at(x + cut * ax, y + cut * ay, pinhole, pills, chosen, count, look) == first:
            low = cut
        else:
            high = cut
    return first, last, 0.5 * (low + high)


@njit(cache=True)
def integrate(gx, gy, axes, pinhole, pills, chosen, count, look, albedo, behind, total):  # pragma: no cover - compiled
    """Mean of the image over one pixel cut by one straight edge, into `total`; twin and rule: `synth.edges`."""
    ax, ay, bx, by = axes
    f0, l0, c0 = crossing(gx - GAUSS * bx, gy - GAUSS * by, ax, ay, pinhole, pills, chosen, count, look)
    f1, l1, c1 = crossing(gx + GAUSS * bx, gy + GAUSS * by, ax, ay, pinhole, pills, chosen, count, look)
    if f0 == l0 and f1 != l1 and f0 == l1:
        c0 = -1.0
    if f1 == l1 and f0 != l0 and f1 == l0:
        c1 = -1.0
    if f0 == l0 and f1 == l1 and f0 != f1:
        c0, c1 = 1.0, -1.0
    area = covered(0.5 * (c0 + c1), 0.5 * (c1 - c0) / GAUSS)
    for side in range(2):
        share = area if side == 0 else 1.0 - area
        if share <= 0.0:
            continue
        w0 = 0.5 + (c0 if side == 0 else -c0)
        w1 = 0.5 + (c1 if side == 0 else -c1)
        w0, w1 = min(max(w0, 0.0), 1.0), min(max(w1, 0.0), 1.0)
        if w0 + w1 <= 0.0:  # only a corner
            w0, w1 = (1e-6, 0.0) if (c0 > c1) == (side == 0) else (0.0, 1e-6)
        for line in range(2):
            w, offset = (w0, -GAUSS) if line == 0 else (w1, GAUSS)
            if w <= 0.0:
                continue
            for sign in (-1.0, 1.0):
                at = -0.5 + w * (0.5 + sign * GAUSS)
                at = at if side == 0 else -at
                x, y = gx + at * ax + offset * bx, gy + at * ay + offset * by
                t, pill = first_pill(x, y, pinhole, pills, chosen, count)
                weight = 0.5 * share * w / (w0 + w1)
                if pill < 0:
                    for c in range(total.shape[0]):
                        total[c] += weight * behind[c]
                    continue
                n = pill_normal(x, y, t, pinhole, pills, pill)
                _, body, gloss = surface(x, y, t, n, pill, pinhole, look)
                for c in range(total.shape[0]):
                    total[c] += weight * (albedo[pill, c] * body + gloss)


@njit(cache=True)
def shade_pixels(grid, pinhole, pills, boxes, depth, part, normal, look, albedo, keys, out):  # pragma: no cover
    """Shade every pixel: its centre inside a surface, its integral at edges; twin: `synth.render.shade_numpy`."""
    height, width = part.shape
    chosen, total = np.empty(boxes.shape[0], np.int64), np.empty(out.shape[2])
    if boxes.shape[0] == 0:
        return
    left, right = max(boxes[:, 0].min() - 1, 0), min(boxes[:, 1].max() + 1, width)
    top, bottom = max(boxes[:, 2].min() - 1, 0), min(boxes[:, 3].max() + 1, height)
    flat = look[0] == FLAT
    for v in range(top, bottom):
        for u in range(left, right):
            pill = part[v, u]
            if pill < 0:
                keys[v, u] = -1
                continue
            if not flat:
                keys[v, u] = pill if look[0] != BINARY else 0
                continue
            n = (normal[v, u, 0], normal[v, u, 1], normal[v, u, 2])
            x, y = grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1]
            keys[v, u], _, _ = surface(x, y, depth[v, u], n, pill, pinhole, look)
    for v in range(top, bottom):
        v0, v1 = max(v - 1, 0), min(v + 1, height - 1)
        for u in range(left, right):
            u0, u1 = max(u - 1, 0), min(u + 1, width - 1)
            key = keys[v, u]
            even = key == keys[v, u0] and key == keys[v, u1]
            even = even and key == keys[v0, u0] and key == keys[v0, u] and key == keys[v0, u1]
            even = even and key == keys[v1, u0] and key == keys[v1, u] and key == keys[v1, u1]
            if even:
                pill = part[v, u]
                if pill >= 0:
                    n = (normal[v, u, 0], normal[v, u, 1], normal[v, u, 2])
                    x, y = grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1]
                    _, body, gloss = surface(x, y, depth[v, u], n, pill, pinhole, look)
                    for c in range(out.shape[2]):
                        out[v, u, c] = albedo[pill, c] * body + gloss
                continue
            count = 0
            for row in range(v0, v1 + 1):
                for col in range(u0, u1 + 1):
                    known = part[row, col] < 0
                    for i in range(count):
                        known = known or chosen[i] == part[row, col]
                    if not known:
                        chosen[count] = part[row, col]
                        count += 1
            chosen[:count].sort()
            across = 0
            for row in (v0, v, v1):
                across += keys[row, u0] != keys[row, u1]
            for col in (u0, u, u1):
                across -= keys[v0, col] != keys[v1, col]
            ax = 0.5 * (grid[v + 1, u + 2, 0] - grid[v + 1, u, 0])
            ay = 0.5 * (grid[v + 1, u + 2, 1] - grid[v + 1, u, 1])
            bx = 0.5 * (grid[v + 2, u + 1, 0] - grid[v, u + 1, 0])
            by = 0.5 * (grid[v + 2, u + 1, 1] - grid[v, u + 1, 1])
            axes = (ax, ay, bx, by) if across >= 0 else (bx, by, ax, ay)
            x, y = grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1]
            total[:] = 0.0
            integrate(x, y, axes, pinhole, pills, chosen, count, look, albedo, out[v, u], total)
            out[v, u] = total
