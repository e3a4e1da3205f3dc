"""The compiled loops that find what every pixel sees of pills and triangles; twins: `synth.labels.plain`.

All work in a window of the image. `grid` (2, h + 2, w + 2) holds the normalised coordinates of its pixel centres with
a border of one pixel. Rays leave the origin through (x, y, 1) (`pinhole`), or run along z through (x, y, 0), so the ray
parameter is the depth in both. Geometry may change from row to row (rolling shutter): `tables` is (l, step), and row v
of the window sees pill k in row k + step v of the table `pills` (step is l, or 0 where all rows see the same); vertices
(k, v, 3) are given at k instants, and row v sees them at the share `blend[v]` between instants `knot[v]` and
`knot[v] + 1`.

A surface is numbered: pills first, then triangles. `part` gives the part of each. A part's bit in `bits` says that its
surface lies on the ray, hidden or not.
"""

import math

import numpy as np
from numba import njit

from .pills import TIE, pill_depth

NEAR = 1e-6  # triangles' depths must exceed this in front of a pinhole
ONE = np.uint64(1)


@njit(cache=True, error_model="numpy", inline="always")
def corner(vertices, knot, blend, i):  # pragma: no cover - compiled
    """A vertex at a row's instant."""
    x, y, z = vertices[knot, i, 0], vertices[knot, i, 1], vertices[knot, i, 2]
    if blend != 0.0:
        x += blend * (vertices[knot + 1, i, 0] - x)
        y += blend * (vertices[knot + 1, i, 1] - y)
        z += blend * (vertices[knot + 1, i, 2] - z)
    return x, y, z


@njit(cache=True, error_model="numpy", inline="always")
def side(ax, ay, az, bx, by, bz):  # pragma: no cover - compiled
    """Coefficients of the edge from a to b: positive on its left. Swapped ends give the exact opposite: no leaks."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(cache=True, error_model="numpy", inline="always")
def triangle_sides(vertices, triangles, knot, blend, pinhole, t):  # pragma: no cover - compiled
    """Linear functions of (x, y, 1) that share a ray's hit among a triangle's corners, and what gives its depth.

    With corners a, b, c and the ray d, the shares are d . (b x c), d . (c x a), d . (a x b) over their sum, which is
    d . n with n = (b - a) x (c - a); a pinhole's depth is a . (b x c) over that sum. An orthographic ray meets the
    corners (x, y, 1) in the plane, and its depth is the mean of theirs.
    """
    ax, ay, az = corner(vertices, knot, blend, triangles[t, 0])
    bx, by, bz = corner(vertices, knot, blend, triangles[t, 1])
    cx, cy, cz = corner(vertices, knot, blend, triangles[t, 2])
    za, zb, zc = az, bz, cz
    if not pinhole:
        az, bz, cz = 1.0, 1.0, 1.0
    a0, a1, a2 = side(bx, by, bz, cx, cy, cz)
    b0, b1, b2 = side(cx, cy, cz, ax, ay, az)
    c0, c1, c2 = side(ax, ay, az, bx, by, bz)
    if pinhole:
        za = ax * a0 + ay * a1 + az * a2
    return a0, a1, a2, b0, b1, b2, c0, c1, c2, za, zb, zc


@njit(cache=True, error_model="numpy", inline="always")
def triangle_hit(x, y, pinhole, sides):  # pragma: no cover - compiled
    """Depth of a ray's hit (inf where missed) and the shares of the three corners."""
    a0, a1, a2, b0, b1, b2, c0, c1, c2, za, zb, zc = sides
    a = x * a0 + y * a1 + a2
    b = x * b0 + y * b1 + b2
    c = x * c0 + y * c1 + c2
    if not ((a >= 0.0 and b >= 0.0 and c >= 0.0) or (a <= 0.0 and b <= 0.0 and c <= 0.0)):
        return math.inf, 0.0, 0.0, 0.0
    whole = a + b + c
    if whole == 0.0:
        return math.inf, 0.0, 0.0, 0.0
    a, b, c = a / whole, b / whole, c / whole
    depth = za / whole if pinhole else a * za + b * zb + c * zc
    if pinhole and not depth > NEAR:
        return math.inf, 0.0, 0.0, 0.0
    return depth, a, b, c


@njit(cache=True, error_model="numpy", inline="always")
def ray_at(grid, v, u, dx, dy):  # pragma: no cover - compiled
    """Normalised coordinates at an offset from a pixel's centre, in pixels."""
    x, y = grid[0, v + 1, u + 1], grid[1, v + 1, u + 1]
    x += 0.5 * (dx * (grid[0, v + 1, u + 2] - grid[0, v + 1, u]) + dy * (grid[0, v + 2, u + 1] - grid[0, v, u + 1]))
    y += 0.5 * (dx * (grid[1, v + 1, u + 2] - grid[1, v + 1, u]) + dy * (grid[1, v + 2, u + 1] - grid[1, v, u + 1]))
    return x, y


@njit(cache=True, error_model="numpy", inline="always")
def pill_depths(x, y, count, pinhole, pills, k, out):  # pragma: no cover - compiled
    """`pill_depth` of the first `count` rays without branches, so that several are worked on at once."""
    ax, ay, az, ux, uy, uz = pills[k, 0], pills[k, 1], pills[k, 2], pills[k, 3], pills[k, 4], pills[k, 5]
    length, r0, r1, slope, c2 = pills[k, 6], pills[k, 7], pills[k, 8], pills[k, 9], pills[k, 10]
    low, high = r0 * slope, length + r1 * slope
    behind = 0.0 if pinhole else -math.inf
    for i in range(count):
        mx, my, dx, dy = -ax, -ay, x[i], y[i]
        if not pinhole:
            mx, my, dx, dy = x[i] - ax, y[i] - ay, 0.0, 0.0
        mz = -az
        dd = dx * dx + dy * dy + 1.0
        md = mx * dx + my * dy + mz
        mm = mx * mx + my * my + mz * mz
        m_u, d_u = mx * ux + my * uy + mz * uz, dx * ux + dy * uy + uz
        w = r0 - slope * m_u
        a = c2 * dd - d_u * d_u
        b = c2 * (md - m_u * d_u) + slope * d_u * w
        c = c2 * (mm - m_u * m_u) - w * w
        gap = b * b - a * c
        root = math.sqrt(gap if gap > 0.0 else 0.0)
        t = (c if b <= 0.0 else -b - root) / (root - b if b <= 0.0 else a)
        at = m_u + t * d_u
        first = md * md - dd * (mm - r0 * r0)
        last_md = md - length * d_u
        last = last_md * last_md - dd * (mm - 2.0 * length * m_u + length * length - r1 * r1)
        t0 = (-md - math.sqrt(first if first > 0.0 else 0.0)) / dd
        t1 = (-last_md - math.sqrt(last if last > 0.0 else 0.0)) / dd
        t0 = t0 if first >= 0.0 else math.inf
        t1 = t1 if last >= 0.0 else math.inf
        ends = t1 if t1 < t0 else t0
        ends = math.inf if (gap < 0.0) & (a > 0.0) else ends
        t = t if (gap >= 0.0) & (at >= low) & (at <= high) else ends
        out[i] = t if t > behind else math.inf


@njit(cache=True, error_model="numpy")
def scan(
    grid, pinhole, tables, pills, vertices, triangles, knot, blend, boxes, part_of, offset, depth, surface, bits
):  # pragma: no cover - compiled
    """First surface at one place of every pixel, and the bits of all parts there; twin: `synth.labels.plain.scan`."""
    (count, step), (dx, dy) = tables, offset
    x, y, t = np.empty(surface.shape[1]), np.empty(surface.shape[1]), np.empty(surface.shape[1])
    centres = dx == 0.0 and dy == 0.0
    for k in range(count):
        bit = ONE << np.uint64(part_of[k])
        left, right = boxes[k, 0], boxes[k, 1]
        if right <= left:
            continue
        for v in range(boxes[k, 2], boxes[k, 3]):
            if centres:
                for i in range(right - left):
                    x[i], y[i] = grid[0, v + 1, left + 1 + i], grid[1, v + 1, left + 1 + i]
            else:
                for i in range(right - left):
                    x[i], y[i] = ray_at(grid, v, left + i, dx, dy)
            pill_depths(x, y, right - left, pinhole, pills, k + step * v, t)
            for u in range(left, right):
                here = t[u - left]
                if here < math.inf:
                    bits[v, u] |= bit
                    if here < depth[v, u] - TIE:
                        depth[v, u] = here
                        surface[v, u] = k
    for k in range(triangles.shape[0]):
        left, right, top, bottom = boxes[count + k, 0], boxes[count + k, 1], boxes[count + k, 2], boxes[count + k, 3]
        bit = ONE << np.uint64(part_of[count + k])
        sides = triangle_sides(vertices, triangles, 0, 0.0, pinhole, k)
        for v in range(top, bottom):
            if vertices.shape[0] > 1:
                sides = triangle_sides(vertices, triangles, knot[v], blend[v], pinhole, k)
            for u in range(left, right):
                px, py = ray_at(grid, v, u, dx, dy)
                depth_here = triangle_hit(px, py, pinhole, sides)[0]
                if depth_here < math.inf:
                    bits[v, u] |= bit
                    if depth_here < depth[v, u] - TIE:
                        depth[v, u] = depth_here
                        surface[v, u] = count + k


@njit(cache=True, error_model="numpy")
def parts_seen(surface, part_of, bits, part, count):  # pragma: no cover - compiled
    """Part that every pixel sees (-1: none), and the number of pixels of each part, hidden or not."""
    for v in range(surface.shape[0]):
        u = 0
        while u < surface.shape[1]:
            here, mine, start = bits[v, u], surface[v, u], u
            while u < surface.shape[1] and bits[v, u] == here and surface[v, u] == mine:
                part[v, u] = part_of[mine] if mine >= 0 else -1
                u += 1
            p = 0
            while here:
                if here & ONE:
                    count[p] += u - start
                here >>= ONE
                p += 1


@njit(cache=True, error_model="numpy")
def mark_edges(part, bits, level):  # pragma: no cover - compiled
    """Set `level` to 1 in pixels whose part or bits differ from those of one of their four neighbours."""
    h, w = part.shape
    for v in range(h):
        for u in range(w - 1):
            differs = np.uint8((part[v, u] != part[v, u + 1]) | (bits[v, u] != bits[v, u + 1]))
            level[v, u] |= differs
            level[v, u + 1] |= differs
        if v + 1 < h:
            for u in range(w):
                differs = np.uint8((part[v, u] != part[v + 1, u]) | (bits[v, u] != bits[v + 1, u]))
                level[v, u] |= differs
                level[v + 1, u] |= differs


@njit(cache=True, error_model="numpy")
def find_edges(part, bits, part_of, level_of, boxes, first, level, near):  # pragma: no cover - compiled
    """Pixels in which a part begins or ends, numbered by their first sample; returns how many samples they need.

    `level_of` gives each part's number of samples for an edge pixel; where it is negative, the part is so small that
    all pixels of its boxes get as many. `first` is -1 elsewhere; `level` gets the numbers of samples, `near` the parts
    that reach into a pixel or one of its eight neighbours.
    """
    h, w = part.shape
    mark_edges(part, bits, level)
    for k in range(boxes.shape[0]):
        if level_of[part_of[k]] < 0:
            for v in range(boxes[k, 2], boxes[k, 3]):
                for u in range(boxes[k, 0], boxes[k, 1]):
                    level[v, u] = -level_of[part_of[k]]
                    near[v, u] |= ONE << np.uint64(part_of[k])
    total = 0
    for v in range(h):
        for u in range(w):
            if level[v, u] == 0:
                continue
            around = near[v, u]
            for i in range(max(v - 1, 0), min(v + 2, h)):
                for j in range(max(u - 1, 0), min(u + 2, w)):
                    around |= bits[i, j]
            near[v, u] = around
            wanted, p = np.int64(level[v, u]), 0
            while around:
                if around & ONE:
                    wanted = max(wanted, abs(level_of[p]))
                around >>= ONE
                p += 1
            level[v, u] = wanted
            first[v, u] = total
            total += wanted
    return total


@njit(cache=True, error_model="numpy")
def scan_samples(
    grid, pinhole, tables, pills, vertices, triangles, knot, blend, boxes, part_of, places, first, level, near,
    depth, surface, bits,
):  # pragma: no cover - compiled  # fmt: skip
    """First surface and bits at the samples of all edge pixels; `places` (patterns, most, 2), see `pattern_of`."""
    count, step = tables
    x, y = np.empty(depth.size), np.empty(depth.size)
    for v in range(first.shape[0]):
        for u in range(first.shape[1]):
            at = first[v, u]
            if at >= 0:
                pattern = pattern_of(level[v, u])
                for i in range(level[v, u]):
                    x[at + i], y[at + i] = ray_at(grid, v, u, places[pattern, i, 0], places[pattern, i, 1])
    near_x, near_y, t = np.empty(depth.size), np.empty(depth.size), np.empty(depth.size)
    index = np.empty(depth.size, np.int64)
    for k in range(count):
        bit = ONE << np.uint64(part_of[k])
        n, last = 0, boxes[k, 3] - 1
        for v in range(boxes[k, 2], boxes[k, 3]):
            for u in range(boxes[k, 0], boxes[k, 1]):
                if first[v, u] >= 0 and near[v, u] & bit:
                    for i in range(first[v, u], first[v, u] + level[v, u]):
                        near_x[n], near_y[n], index[n] = x[i], y[i], i
                        n += 1
            if step == 0 and v < last:
                continue  # all rows see the same pill: their samples are worked on together
            pill_depths(near_x, near_y, n, pinhole, pills, k + step * v, t)
            for m in range(n):
                if t[m] < math.inf:
                    i = index[m]
                    bits[i] |= bit
                    if t[m] < depth[i] - TIE:
                        depth[i], surface[i] = t[m], k
            n = 0
    for k in range(triangles.shape[0]):
        bit = ONE << np.uint64(part_of[count + k])
        sides = triangle_sides(vertices, triangles, 0, 0.0, pinhole, k)
        left, right, top, bottom = boxes[count + k, 0], boxes[count + k, 1], boxes[count + k, 2], boxes[count + k, 3]
        for v in range(top, bottom):
            if vertices.shape[0] > 1:
                sides = triangle_sides(vertices, triangles, knot[v], blend[v], pinhole, k)
            for u in range(left, right):
                at, n = first[v, u], level[v, u]
                if at < 0 or not (near[v, u] & bit):
                    continue
                for i in range(at, at + n):
                    depth_here = triangle_hit(x[i], y[i], pinhole, sides)[0]
                    if depth_here < math.inf:
                        bits[i] |= bit
                        if depth_here < depth[i] - TIE:
                            depth[i], surface[i] = depth_here, count + k


@njit(cache=True, error_model="numpy", inline="always")
def pattern_of(level):  # pragma: no cover - compiled
    """Number of the sample pattern with 8, 16 or 64 places."""
    return 0 if level <= 8 else (1 if level <= 16 else 2)


@njit(cache=True, error_model="numpy")
def first_surfaces(
    x, y, row_of, pinhole, tables, pills, vertices, triangles, knot, blend, depth, surface
):  # pragma: no cover - compiled
    """First surface on single rays, against all surfaces; twin: `synth.labels.plain.first_surfaces`."""
    count, step = tables
    for i in range(x.size):
        for k in range(count):
            t = pill_depth(x[i], y[i], pinhole, pills, k + step * row_of[i])
            if t < depth[i] - TIE:
                depth[i], surface[i] = t, k
        for k in range(triangles.shape[0]):
            sides = triangle_sides(vertices, triangles, knot[row_of[i]], blend[row_of[i]], pinhole, k)
            t = triangle_hit(x[i], y[i], pinhole, sides)[0]
            if t < depth[i] - TIE:
                depth[i], surface[i] = t, count + k


@njit(cache=True, error_model="numpy")
def measure(
    part, bits, part_of, first, level, sample_surface, sample_bits, visible, amodal, modal_box, amodal_box
):  # pragma: no cover - compiled
    """Area in pixels of each part, as seen and as alone, and boxes (x0, x1, y0, y1; half open) of its pixels.

    Areas count whole pixels, and the shares of samples in edge pixels. Twin: `synth.labels.plain.measure`.
    """
    for v in range(part.shape[0]):
        u = 0
        while u < part.shape[1]:
            here, mine, start, edge = bits[v, u], part[v, u], u, first[v, u] >= 0
            while u < part.shape[1] and bits[v, u] == here and part[v, u] == mine and (first[v, u] >= 0) == edge:
                u += 1
            if here:
                grow(modal_box, mine, start, u, v)
                if not edge:
                    visible[mine] += u - start
                p = 0
                while here:
                    if here & ONE:
                        grow(amodal_box, p, start, u, v)
                        if not edge:
                            amodal[p] += u - start
                    here >>= ONE
                    p += 1
            for j in range(start, u if edge else start):
                share, i, end = 1.0 / level[v, j], first[v, j], first[v, j] + level[v, j]
                while i < end:
                    seen, left, run = sample_surface[i], sample_bits[i], i
                    while i < end and sample_surface[i] == seen and sample_bits[i] == left:
                        i += 1
                    if seen < 0:
                        continue
                    visible[part_of[seen]] += share * (i - run)
                    p = 0
                    while left:
                        if left & ONE:
                            amodal[p] += share * (i - run)
                        left >>= ONE
                        p += 1


@njit(cache=True, error_model="numpy", inline="always")
def grow(box, p, start, stop, v):  # pragma: no cover - compiled
    """Let a part's box hold a run of pixels; an empty box has its ends swapped."""
    box[p, 0], box[p, 1] = min(box[p, 0], start), max(box[p, 1], stop)
    box[p, 2], box[p, 3] = min(box[p, 2], v), max(box[p, 3], v + 1)
