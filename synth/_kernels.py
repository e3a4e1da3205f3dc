"""The compiled pixel loops of the renderer; each has a plain NumPy twin, named in its docstring, that a test compares.

A `pinhole` flag stands for the projection: rays leave the origin through (x, y, 1), or run along z through (x, y, 0), where
(x, y) are the normalised coordinates of a pixel, so that the ray parameter is the depth in both. `pills` is the tuple of axis
bases, tips and radii; `look` is (mode, coefficients, light, mesh) of `synth.shading`.
"""

import math

import numpy as np
from numba import njit

from handtrack._kernels import hit_pill

LINES, HALVINGS = 4, 6
BINARY, FLAT, GOURAUD, PHONG = 0, 1, 2, 3


@njit(cache=True, inline="always")
def pixel_hit(x, y, pinhole, pills, k):  # pragma: no cover - compiled
    """Hit of one pill on the ray through normalised coordinates; inf where missed or behind a pinhole."""
    bases, tips, radii = pills
    if not pinhole:
        return hit_pill(x, y, 0.0, 0.0, 0.0, 1.0, bases, tips, radii, k)
    t, nx, ny, nz = hit_pill(0.0, 0.0, 0.0, x, y, 1.0, bases, tips, radii, k)
    return (t if t > 0.0 else math.inf), nx, ny, nz


@njit(cache=True)
def cast_pixels(grid, pinhole, pills, boxes, depth, part, normal):  # pragma: no cover - compiled
    """First pill at every pixel centre, one box of pixels per pill; twin: `synth.raycast.cast_numpy`."""
    for k in range(boxes.shape[0]):
        for v in range(boxes[k, 2], boxes[k, 3]):
            for u in range(boxes[k, 0], boxes[k, 1]):
                t, nx, ny, nz = pixel_hit(grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1], pinhole, pills, k)
                if t < depth[v, u]:
                    depth[v, u] = t
                    part[v, u] = k
                    normal[v, u, 0], normal[v, u, 1], normal[v, u, 2] = nx, ny, nz


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
def surface(x, y, t, n, pill, pinhole, look, lit):  # pragma: no cover - compiled
    """What a pixel shows of a hit: (key, body, gloss); the key changes wherever the image may jump."""
    mode, coefficients, light, mesh = look
    if mode == BINARY:
        return 0, 1.0, 0.0
    if mode == PHONG or (mode == GOURAUD and not lit):
        if not lit:
            return pill, 0.0, 0.0
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
def sample(x, y, pinhole, pills, chosen, count, look, lit):  # pragma: no cover - compiled
    """Cast one ray against the chosen pills: (key, pill, body, gloss), key and pill -1 on the background."""
    best, pill, bx, by, bz = math.inf, -1, 0.0, 0.0, 0.0
    for i in range(count):
        t, nx, ny, nz = pixel_hit(x, y, pinhole, pills, chosen[i])
        if t < best:
            best, pill, bx, by, bz = t, chosen[i], nx, ny, nz
    if pill < 0:
        return -1, -1, 0.0, 0.0
    key, body, gloss = surface(x, y, best, (bx, by, bz), pill, pinhole, look, lit)
    return key, pill, body, gloss


@njit(cache=True)
def integrate(v, u, across, grid, pinhole, pills, chosen, count, look, albedo, total, out):  # pragma: no cover
    """Mean of the image over one pixel, line by line, each line cut where it crosses an edge.

    Twin: `synth.render.integrate_numpy`, where the rule is derived.
    """
    gx, gy = grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1]
    along_x, along_y = 0.5 * (grid[v + 1, u + 2] - grid[v + 1, u]), 0.5 * (grid[v + 2, u + 1] - grid[v, u + 1])
    if not across:
        along_x, along_y = along_y, along_x
    ax, ay, bx, by = along_x[0], along_x[1], along_y[0], along_y[1]
    total[:] = 0.0
    for line in range(LINES):
        offset = (line + 0.5) / LINES - 0.5
        x, y = gx + offset * bx, gy + offset * by
        first, _, _, _ = sample(x - 0.5 * ax, y - 0.5 * ay, pinhole, pills, chosen, count, look, False)
        last, _, _, _ = sample(x + 0.5 * ax, y + 0.5 * ay, pinhole, pills, chosen, count, look, False)
        cut = 0.5
        if first != last:
            low, high = -0.5, 0.5
            for _ in range(HALVINGS):
                cut = 0.5 * (low + high)
                key, _, _, _ = sample(x + cut * ax, y + cut * ay, pinhole, pills, chosen, count, look, False)
                if key == first:
                    low = cut
                else:
                    high = cut
            cut = 0.5 * (low + high)
        for piece in range(2):
            start, end = (-0.5, cut) if piece == 0 else (cut, 0.5)
            if end <= start:
                continue
            for sign in (-1.0, 1.0):
                at = 0.5 * (start + end) + sign * (end - start) * 0.28867513459481287
                _, pill, body, gloss = sample(x + at * ax, y + at * ay, pinhole, pills, chosen, count, look, True)
                weight = 0.5 * (end - start) / LINES
                for c in range(out.shape[2]):
                    total[c] += weight * (out[v, u, c] if pill < 0 else albedo[pill, c] * body + gloss)
    for c in range(out.shape[2]):
        out[v, u, c] = total[c]


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
            n = (normal[v, u, 0], normal[v, u, 1], normal[v, u, 2])
            x, y = grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1]
            keys[v, u], _, _ = surface(x, y, depth[v, u], n, pill, pinhole, look, flat)
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
                    _, body, gloss = surface(x, y, depth[v, u], n, pill, pinhole, look, True)
                    for c in range(out.shape[2]):
                        out[v, u, c] = albedo[pill, c] * body + gloss
                continue
            count = 0
            for k in range(boxes.shape[0]):
                if boxes[k, 0] - 1 <= u <= boxes[k, 1] and boxes[k, 2] - 1 <= v <= boxes[k, 3]:
                    chosen[count] = k
                    count += 1
            across = 0
            for row in (v0, v, v1):
                across += keys[row, u0] != keys[row, u1]
            for col in (u0, u, u1):
                across -= keys[v0, col] != keys[v1, col]
            integrate(v, u, across >= 0, grid, pinhole, pills, chosen, count, look, albedo, total, out)
