"""The compiled pixel loops of the renderer; each has a plain NumPy twin, named in its docstring, that a test compares.

A `pinhole` flag stands for the projection: rays leave the origin through (x, y, 1), or run along z through (x, y, 0),
where (x, y) are the normalised coordinates of a pixel, so that the ray parameter is the depth in both. A row of
`pills` is that of `synth.raycast.pill_table`, then the two vectors across the axis and the light of the facets from
`synth.facets`. `look` holds numbers only, (mode, coefficients, light, counts): counting references to arrays takes
longer than a ray.
"""

import math

import numpy as np
from numba import njit

REACH, HALVINGS = 1.3, 9  # where on a line its crossing is sought, and bisections of that: to 1/400 pixel
GAUSS = 0.5 / math.sqrt(3.0)  # offset of the two Gauss nodes from the middle of an interval of length 1
LATTICE, STRIDE = 89, 55  # points where several edges meet: neighbouring Fibonacci numbers
TIE = 1e-9  # depths closer than this are equal and the first pill wins: neighbouring links share a sphere
BINARY, FLAT, GOURAUD, PHONG = 0, 1, 2, 3


@njit(cache=True, error_model="numpy", inline="always")
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


@njit(cache=True, error_model="numpy", inline="always")
def pill_normal(x, y, t, pinhole, pills, k):  # pragma: no cover - compiled
    """Outward normal where a pill is hit; twin and derivation: `synth.raycast.pill_normal`."""
    px, py = (x * t, y * t) if pinhole else (x, y)
    px, py, pz = px - pills[k, 0], py - pills[k, 1], t - pills[k, 2]
    ux, uy, uz = pills[k, 3], pills[k, 4], pills[k, 5]
    length, r0, slope = pills[k, 6], pills[k, 7], pills[k, 9]
    along = (px * ux + py * uy + pz * uz - r0 * slope) / pills[k, 10]
    along = min(max(along, 0.0), length)
    scale = 1.0 / (r0 - slope * along)
    return (px - along * ux) * scale, (py - along * uy) * scale, (pz - along * uz) * scale


@njit(cache=True, error_model="numpy")
def cast_pixels(grid, pinhole, pills, boxes, depth, part):  # pragma: no cover - compiled
    """First pill at every pixel centre, a box of pixels per pill; `part` has a border; twin: `raycast.cast_numpy`."""
    for k in range(boxes.shape[0]):
        for v in range(boxes[k, 2], boxes[k, 3]):
            for u in range(boxes[k, 0], boxes[k, 1]):
                t = pill_depth(grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1], pinhole, pills, k)
                if t < depth[v, u] - TIE:
                    depth[v, u] = t
                    part[v + 1, u + 1] = k


@njit(cache=True, error_model="numpy")
def normal_pixels(grid, pinhole, pills, span, depth, part, normal):  # pragma: no cover - compiled
    """Normal at every pixel that sees a pill; twin: `synth.raycast.cast_numpy`."""
    for v in range(span[2], span[3]):
        for u in range(span[0], span[1]):
            pill = part[v + 1, u + 1]
            if pill >= 0:
                n = pill_normal(grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1], depth[v, u], pinhole, pills, pill)
                normal[v, u, 0], normal[v, u, 1], normal[v, u, 2] = n


@njit(cache=True, error_model="numpy")
def facet_place(x, y, t, n, pinhole, pills, k, counts):  # pragma: no cover - compiled
    """Continuous (ring, sector) of a surface point in a pill's facet mesh; twin: `synth.facets.facet_place`."""
    cap, side, around = counts
    ux, uy, uz, length, slope = pills[k, 3], pills[k, 4], pills[k, 5], pills[k, 6], pills[k, 9]
    px, py = (x * t, y * t) if pinhole else (x, y)
    lean = n[0] * ux + n[1] * uy + n[2] * uz
    axial = (px - pills[k, 0]) * ux + (py - pills[k, 1]) * uy + (t - pills[k, 2]) * uz
    along = min(max((axial - pills[k, 7] * slope) / pills[k, 10], 0.0), length)
    ring = side * (along / length if length > 0.0 else (1.0 if lean > 0.0 else 0.0))
    ring += cap * min(math.acos(min(max(-lean, -1.0), 1.0)) / math.acos(-slope), 1.0)
    ring += cap * max(1.0 - math.acos(min(max(lean, -1.0), 1.0)) / math.acos(slope), 0.0)
    east = n[0] * pills[k, 11] + n[1] * pills[k, 12] + n[2] * pills[k, 13]
    north = n[0] * pills[k, 14] + n[1] * pills[k, 15] + n[2] * pills[k, 16]
    return ring, (math.atan2(north, east) / (2.0 * math.pi) + 0.5) * around


@njit(cache=True, error_model="numpy")
def facet_light(ring, sector, pills, k, counts, smooth):  # pragma: no cover - compiled
    """Body and gloss light of a facet, or between its four corners; twin: `synth.facets.facet_light`."""
    around = counts[2]
    i, j = min(int(ring), 2 * counts[0] + counts[1] - 1), min(int(sector), around - 1)
    at = 17 + 2 * (i * around + j)
    if not smooth:
        return pills[k, at], pills[k, at + 1]
    a, b = ring - i, sector - j
    body, gloss, right = 0.0, 0.0, (2 if j + 1 < around else 2 - 2 * around)
    for step, w in (
        (0, (1.0 - a) * (1.0 - b)),
        (right, (1.0 - a) * b),
        (2 * around, a * (1.0 - b)),
        (2 * around + right, a * b),
    ):
        body += w * pills[k, at + step]
        gloss += w * pills[k, at + step + 1]
    return body, gloss


@njit(cache=True, error_model="numpy")
def power(x, exponent):  # pragma: no cover - compiled
    """x ** exponent, by multiplication where the exponent is whole: a tenth of the time."""
    whole = int(exponent)
    value = 1.0 if whole == exponent else x ** (exponent - whole)
    while whole > 0:
        if whole & 1:
            value *= x
        x *= x
        whole >>= 1
    return value


@njit(cache=True, error_model="numpy")
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
    return ambient + diffuse * facing, (specular * power(mirrored, shininess) if mirrored > 0.0 else 0.0)


@njit(cache=True, error_model="numpy")
def surface_light(x, y, t, pinhole, pills, k, look):  # pragma: no cover - compiled
    """Body and gloss light of a hit; twin: `synth.shading.surface`."""
    mode, coefficients, light, counts = look
    if mode == BINARY:
        return 1.0, 0.0
    n = pill_normal(x, y, t, pinhole, pills, k)
    if mode != PHONG:
        ring, sector = facet_place(x, y, t, n, pinhole, pills, k, counts)
        return facet_light(ring, sector, pills, k, counts, mode == GOURAUD)
    if not pinhole:
        return point_light(n, (0.0, 0.0, -1.0), coefficients, light)
    s = -1.0 / math.sqrt(x * x + y * y + 1.0)
    return point_light(n, (x * s, y * s, s), coefficients, light)


@njit(cache=True, error_model="numpy")
def facet_key(x, y, t, pinhole, pills, k, counts):  # pragma: no cover - compiled
    """Number of the facet that a hit lies in; twin: `synth.shading.surface`."""
    ring, sector = facet_place(x, y, t, pill_normal(x, y, t, pinhole, pills, k), pinhole, pills, k, counts)
    rings = 2 * counts[0] + counts[1]
    return (k * rings + min(int(ring), rings - 1)) * counts[2] + min(int(sector), counts[2] - 1)


@njit(cache=True, error_model="numpy", inline="always")
def first_pill(x, y, pinhole, pills, chosen, count):  # pragma: no cover - compiled
    """Depth and number (-1 where missed) of the first of some pills on a ray; twin: `synth.raycast.first_hits`."""
    best, pill = math.inf, -1
    for i in range(count):
        t = pill_depth(x, y, pinhole, pills, chosen[i])
        if t < best - TIE:
            best, pill = t, chosen[i]
    return best, pill


@njit(cache=True, error_model="numpy", inline="always")
def key_at(x, y, pinhole, pills, chosen, count, mode, counts):  # pragma: no cover - compiled
    """Number that changes wherever the image may jump: pill or facet, -1 on the background."""
    t, pill = first_pill(x, y, pinhole, pills, chosen, count)
    if mode == FLAT and pill >= 0:
        return facet_key(x, y, t, pinhole, pills, pill, counts)
    return pill if mode != BINARY else min(pill, 0)


@njit(cache=True, error_model="numpy")
def covered(middle, slope):  # pragma: no cover - compiled
    """Area of the unit pixel left of the line x = middle + slope y; twin and derivation: `synth.edges.covered`."""
    if abs(slope) < 1e-6:
        return 0.5 + min(max(middle, -0.5), 0.5)
    total = 0.0
    for sign in (-1.0, 1.0):
        z = abs(middle + 0.5 * sign * slope)
        total += sign * (0.5 * z * z if z <= 0.5 else 0.5 * z - 0.125)
    return 0.5 + total / slope


@njit(cache=True, error_model="numpy")
def crossing(x, y, ax, ay, pinhole, pills, chosen, count, mode, counts):  # pragma: no cover - compiled
    """Keys at both ends of a line, -REACH and REACH, and where the first key ends (REACH where both agree)."""
    low, high, first, last = -REACH, REACH, 0, 0
    for i in range(HALVINGS + 2):
        cut = 0.5 * (low + high) if i > 1 else (low if i == 0 else high)
        key = key_at(x + cut * ax, y + cut * ay, pinhole, pills, chosen, count, mode, counts)
        if i == 0:
            first = key
        elif i == 1:
            last = key
            if first == last:
                return first, last, REACH
        elif key == first:
            low = cut
        else:
            high = cut
    return first, last, 0.5 * (low + high)


@njit(cache=True, error_model="numpy")
def integrate(gx, gy, axes, pinhole, pills, chosen, count, look, albedo, out, v, u, total):  # pragma: no cover
    """Mean of the image over one pixel cut by one straight edge, into `total`; twin and rule: `synth.edges`.

    Returns whether all that was seen on either side of the edge is what its ends show.
    """
    ax, ay, bx, by = axes
    f0, l0, c0 = crossing(gx - GAUSS * bx, gy - GAUSS * by, ax, ay, pinhole, pills, chosen, count, look[0], look[3])
    f1, l1, c1 = crossing(gx + GAUSS * bx, gy + GAUSS * by, ax, ay, pinhole, pills, chosen, count, look[0], look[3])
    if f0 == l0 and f1 != l1 and f0 == l1:
        c0 = -REACH
    if f1 == l1 and f0 != l0 and f1 == l0:
        c1 = -REACH
    if f0 == l0 and f1 == l1 and f0 != f1:
        c0, c1 = REACH, -REACH
    area = covered(0.5 * (c0 + c1), 0.5 * (c1 - c0) / GAUSS)
    plain = True
    for side in range(2):
        share = area if side == 0 else 1.0 - area
        if share <= 0.0:
            continue
        key0, key1 = (f0, f1) if side == 0 else (l0, l1)
        if key0 < 0 and key1 < 0:
            for c in range(total.shape[0]):
                total[c] += share * out[v, u, c]
            continue
        w0 = 0.5 + (c0 if side == 0 else -c0)
        w1 = 0.5 + (c1 if side == 0 else -c1)
        w0, w1 = min(max(w0, 0.0), 1.0), min(max(w1, 0.0), 1.0)
        outward = GAUSS if w0 + w1 > 0.0 else 0.5
        if w0 + w1 <= 0.0:  # neither line meets the part, only a corner of the pixel does
            w0, w1 = (1e-6, 0.0) if (c0 > c1) == (side == 0) else (0.0, 1e-6)
        for line in range(2):
            w, offset = (w0, -outward) if line == 0 else (w1, outward)
            if w <= 0.0:
                continue
            for sign in (-1.0, 1.0):
                at = -0.5 + w * (0.5 + sign * GAUSS)
                at = at if side == 0 else -at
                x, y = gx + at * ax + offset * bx, gy + at * ay + offset * by
                t, pill = first_pill(x, y, pinhole, pills, chosen, count)
                weight = 0.5 * share * w / (w0 + w1)
                key = pill if look[0] != BINARY else min(pill, 0)
                plain = plain and (key in (key0, key1) or look[0] == FLAT)
                if pill < 0:
                    for c in range(total.shape[0]):
                        total[c] += weight * out[v, u, c]
                    continue
                body, gloss = surface_light(x, y, t, pinhole, pills, pill, look)
                for c in range(total.shape[0]):
                    total[c] += weight * (albedo[pill, c] * body + gloss)
    return plain


@njit(cache=True, error_model="numpy")
def key_pixels(grid, pinhole, pills, span, depth, part, counts, keys):  # pragma: no cover - compiled
    """Facet of every pixel centre inside the span (x0, x1, y0, y1); `part` and `keys` have a border one pixel wide."""
    for v in range(span[2], span[3]):
        for u in range(span[0], span[1]):
            x, y, pill = grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1], part[v + 1, u + 1]
            if pill >= 0:
                keys[v + 1, u + 1] = facet_key(x, y, depth[v, u], pinhole, pills, pill, counts)


@njit(cache=True, error_model="numpy")
def boxed(boxes, v, u, chosen):  # pragma: no cover - compiled
    """Number of pills whose box holds a pixel or one two pixels away; they go to `chosen`."""
    count = 0
    for k in range(boxes.shape[0]):
        if boxes[k, 0] - 2 <= u <= boxes[k, 1] + 1 and boxes[k, 2] - 2 <= v <= boxes[k, 3] + 1:
            chosen[count] = k
            count += 1
    return count


@njit(cache=True, error_model="numpy", inline="always")
def is_edge(keys, v, u):  # pragma: no cover - compiled
    """Whether a pixel's key differs from a neighbour's in its row or column; `keys` has a border one pixel wide."""
    key = keys[v + 1, u + 1]
    return (keys[v, u + 1] ^ key) | (keys[v + 1, u] ^ key) | (keys[v + 1, u + 2] ^ key) | (
        keys[v + 2, u + 1] ^ key
    ) != 0


@njit(cache=True, error_model="numpy")
def is_junction(keys, part, v, u):  # pragma: no cover - compiled
    """Whether more than one edge meets in a pixel: three keys or three parts among it and its eight neighbours."""
    for table in (keys, part):
        first, second = table[v + 1, u + 1], table[v + 1, u + 1]
        for row in range(v, v + 3):
            for col in range(u, u + 3):
                other = table[row, col]
                if other != first and second == first:
                    second = other
                if other != first and other != second:
                    return True
    return False


@njit(cache=True, error_model="numpy")
def scatter(gx, gy, axes, pinhole, pills, chosen, count, look, albedo, out, v, u, total):  # pragma: no cover
    """Mean of the image over one pixel by a Fibonacci lattice, into `total`; twin: `synth.edges.scatter_numpy`."""
    ax, ay, bx, by = axes
    for i in range(LATTICE):
        along, offset = (i + 0.5) / LATTICE - 0.5, ((i * STRIDE) % LATTICE + 0.5) / LATTICE - 0.5
        x, y = gx + along * ax + offset * bx, gy + along * ay + offset * by
        t, pill = first_pill(x, y, pinhole, pills, chosen, count)
        body, gloss = 0.0, 0.0
        if pill >= 0:
            body, gloss = surface_light(x, y, t, pinhole, pills, pill, look)
        for c in range(total.shape[0]):
            total[c] += (out[v, u, c] if pill < 0 else albedo[pill, c] * body + gloss) / LATTICE


@njit(cache=True, error_model="numpy")
def pixel_axes(grid, keys, v, u):  # pragma: no cover - compiled
    """Steps in normalised coordinates along the lines across a pixel's edge, and from line to line."""
    votes = 0
    for i in range(3):
        votes += keys[v + i, u] != keys[v + i, u + 2]
        votes -= keys[v, u + i] != keys[v + 2, u + i]
    ax, ay = 0.5 * (grid[v + 1, u + 2, 0] - grid[v + 1, u, 0]), 0.5 * (grid[v + 1, u + 2, 1] - grid[v + 1, u, 1])
    bx, by = 0.5 * (grid[v + 2, u + 1, 0] - grid[v, u + 1, 0]), 0.5 * (grid[v + 2, u + 1, 1] - grid[v, u + 1, 1])
    return (ax, ay, bx, by) if votes >= 0 else (bx, by, ax, ay)


@njit(cache=True, error_model="numpy")
def shade_pixels(
    grid, pinhole, pills, boxes, span, depth, part, look, albedo, keys, out
):  # pragma: no cover - compiled
    """Shade every pixel: its centre inside a surface, its integral at edges; twin: `synth.render.shade_numpy`."""
    chosen, total = np.empty(pills.shape[0], np.int64), np.empty(out.shape[2])
    for v in range(span[2], span[3]):
        for u in range(span[0], span[1]):
            x, y, pill = grid[v + 1, u + 1, 0], grid[v + 1, u + 1, 1], part[v + 1, u + 1]
            if is_edge(keys, v, u):
                count = boxed(boxes, v, u, chosen)
                total[:] = 0.0
                axes = pixel_axes(grid, keys, v, u)
                plain = not is_junction(keys, part, v, u)
                if plain:
                    plain = integrate(x, y, axes, pinhole, pills, chosen, count, look, albedo, out, v, u, total)
                if not plain:
                    total[:] = 0.0
                    scatter(x, y, axes, pinhole, pills, chosen, count, look, albedo, out, v, u, total)
                for c in range(out.shape[2]):
                    out[v, u, c] = total[c]
            elif pill >= 0:
                body, gloss = surface_light(x, y, depth[v, u], pinhole, pills, pill, look)
                for c in range(out.shape[2]):
                    out[v, u, c] = albedo[pill, c] * body + gloss
