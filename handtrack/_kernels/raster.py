"""Compiled loops over projected triangles: z-buffer, first triangle at single points, contours, expected profiles."""

import math

import numpy as np
from numba import njit

from .profiles import shade


@njit(cache=True, inline="always")
def plane_of(xy, a, b, c):  # pragma: no cover - compiled
    """Barycentric coordinates l1, l2 of a triangle over the image: (usable, origin x, y, l1 by x, y, l2 by x, y).

    Not usable without an area, or with a corner behind the camera (NaN).
    """
    ax, ay = xy[a, 0], xy[a, 1]
    bx, by = xy[b, 0] - ax, xy[b, 1] - ay
    cx, cy = xy[c, 0] - ax, xy[c, 1] - ay
    area = bx * cy - by * cx
    usable = abs(area) > 1e-12  # also False where a corner is behind the camera: NaN
    scale = 1.0 / area if usable else 0.0
    return usable, ax, ay, cy * scale, -cx * scale, -by * scale, bx * scale


@njit(cache=True)
def rasterise(xy, inverse, pinhole, triangles, triangle, bary, depth):  # pragma: no cover - compiled
    """Z-buffer of projected triangles: nearest triangle at each pixel centre; twin: `surface.raster.rasterise_numpy`.

    `inverse` holds depth, or 1 / depth for a pinhole, of each vertex. `triangle` comes full of -1, `depth` of inf.
    """
    height, width = triangle.shape
    for k in range(triangles.shape[0]):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        usable, ax, ay, l1x, l1y, l2x, l2y = plane_of(xy, a, b, c)
        if not usable:
            continue
        left = max(int(math.ceil(min(xy[a, 0], xy[b, 0], xy[c, 0]))), 0)
        right = min(int(math.floor(max(xy[a, 0], xy[b, 0], xy[c, 0]))), width - 1)
        top = max(int(math.ceil(min(xy[a, 1], xy[b, 1], xy[c, 1]))), 0)
        bottom = min(int(math.floor(max(xy[a, 1], xy[b, 1], xy[c, 1]))), height - 1)
        za, zb, zc = inverse[a], inverse[b], inverse[c]
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                l1 = (x - ax) * l1x + (y - ay) * l1y
                l2 = (x - ax) * l2x + (y - ay) * l2y
                l0 = 1.0 - l1 - l2
                if l0 < -1e-12 or l1 < -1e-12 or l2 < -1e-12:
                    continue
                number = l0 * za + l1 * zb + l2 * zc
                z = 1.0 / number if pinhole else number
                if z < depth[y, x]:
                    depth[y, x], triangle[y, x] = z, k
                    if pinhole:
                        l0, l1, l2 = l0 * za * z, l1 * zb * z, l2 * zc * z
                    bary[y, x, 0], bary[y, x, 1], bary[y, x, 2] = l0, l1, l2


@njit(cache=True)
def count_tiles(xy, triangles, tile, first, columns, rows, x0, y0):  # pragma: no cover - compiled
    """How many triangles overlap each tile, as running sums in `first`; twin: `surface.raster.tiles_numpy`."""
    first[:] = 0
    for k in range(triangles.shape[0]):
        left, right, top, bottom = tile_span(xy, triangles, k, tile, columns, rows, x0, y0)
        for r in range(top, bottom + 1):
            for c in range(left, right + 1):
                first[r * columns + c + 1] += 1
    for i in range(first.shape[0] - 1):
        first[i + 1] += first[i]


@njit(cache=True, inline="always")
def tile_span(xy, triangles, k, tile, columns, rows, x0, y0):  # pragma: no cover - compiled
    """First and last tile column and row that the box of a triangle overlaps; an empty range if it is unusable."""
    a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
    total = xy[a, 0] + xy[b, 0] + xy[c, 0] + xy[a, 1] + xy[b, 1] + xy[c, 1]
    if not math.isfinite(total):
        return 0, -1, 0, -1
    low_x, high_x = min(xy[a, 0], xy[b, 0], xy[c, 0]) - x0, max(xy[a, 0], xy[b, 0], xy[c, 0]) - x0
    low_y, high_y = min(xy[a, 1], xy[b, 1], xy[c, 1]) - y0, max(xy[a, 1], xy[b, 1], xy[c, 1]) - y0
    if high_x < 0.0 or high_y < 0.0 or low_x >= columns * tile or low_y >= rows * tile:
        return 0, -1, 0, -1
    left, right = max(int(low_x / tile), 0), min(int(high_x / tile), columns - 1)
    top, bottom = max(int(low_y / tile), 0), min(int(high_y / tile), rows - 1)
    return left, right, top, bottom


@njit(cache=True)
def fill_tiles(xy, triangles, tile, first, columns, rows, x0, y0, member):  # pragma: no cover - compiled
    """Numbers of the triangles of each tile, tile after tile as `first` says."""
    fill = first.copy()
    for k in range(triangles.shape[0]):
        left, right, top, bottom = tile_span(xy, triangles, k, tile, columns, rows, x0, y0)
        for r in range(top, bottom + 1):
            for c in range(left, right + 1):
                at = r * columns + c
                member[fill[at]] = k
                fill[at] += 1


@njit(cache=True, inline="always")
def first_triangle(x, y, xy, inverse, pinhole, triangles, tiles):  # pragma: no cover - compiled
    """Nearest triangle at one image point: (number or -1, l0, l1, l2, depth)."""
    tile, columns, rows, x0, y0, first, member = tiles
    best, b0, b1, b2, nearest = -1, 0.0, 0.0, 0.0, math.inf
    c, r = int(math.floor((x - x0) / tile)), int(math.floor((y - y0) / tile))
    if c >= 0 and r >= 0 and c < columns and r < rows:
        at = r * columns + c
        for i in range(first[at], first[at + 1]):
            k = member[i]
            va, vb, vc = triangles[k, 0], triangles[k, 1], triangles[k, 2]
            usable, ax, ay, l1x, l1y, l2x, l2y = plane_of(xy, va, vb, vc)
            if not usable:
                continue
            l1 = (x - ax) * l1x + (y - ay) * l1y
            l2 = (x - ax) * l2x + (y - ay) * l2y
            l0 = 1.0 - l1 - l2
            if l0 < -1e-12 or l1 < -1e-12 or l2 < -1e-12:
                continue
            number = l0 * inverse[va] + l1 * inverse[vb] + l2 * inverse[vc]
            z = 1.0 / number if pinhole else number
            if z < nearest:
                best, nearest = k, z
                b0, b1, b2 = l0, l1, l2
                if pinhole:
                    b0, b1, b2 = l0 * inverse[va] * z, l1 * inverse[vb] * z, l2 * inverse[vc] * z
    return best, b0, b1, b2, nearest


@njit(cache=True)
def probe(points, xy, inverse, pinhole, triangles, tiles, triangle, bary, depth):  # pragma: no cover - compiled
    """Nearest triangle at image points, -1 where there is none; twin: `surface.raster.probe_numpy`."""
    for i in range(points.shape[0]):
        k, b0, b1, b2, z = first_triangle(points[i, 0], points[i, 1], xy, inverse, pinhole, triangles, tiles)
        triangle[i], depth[i] = k, z
        bary[i, 0], bary[i, 1], bary[i, 2] = b0, b1, b2


@njit(cache=True)
def facing(xy, triangles, front):  # pragma: no cover - compiled
    """Signed doubled areas in the image, negative where the camera is faced; twin: `surface.raster.facing_numpy`."""
    for k in range(triangles.shape[0]):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        front[k] = (xy[b, 0] - xy[a, 0]) * (xy[c, 1] - xy[a, 1]) - (xy[b, 1] - xy[a, 1]) * (xy[c, 0] - xy[a, 0])


@njit(cache=True)
def walk_contours(
    xy, ends, sides, area, spacing, corner, edge, share, size, next_edge, count
):  # pragma: no cover - compiled
    """Places about `spacing` pixels apart along the chains of contour edges: (number of places).

    A contour edge lies between a triangle that faces the camera and one that does not, or ends the mesh. `edge` and
    `share` get the mesh edge and the place on it, kept `corner` pixels off its ends where the outline bends, `size` the
    length of outline the place stands for. `next_edge` (v, m) and `count` (v,) are room for the contour edges at each
    vertex. Twin: `surface.contour.contour_edges_numpy`, of the edges alone.
    """
    count[:] = 0
    for e in range(ends.shape[0]):
        if not on_contour(sides, area, e):
            continue
        for side in range(2):
            v = ends[e, side]
            if count[v] < next_edge.shape[1]:
                next_edge[v, count[v]] = e
                count[v] += 1
    visited = np.zeros(ends.shape[0], np.bool_)
    chain, length = np.empty(ends.shape[0], np.int64), np.empty(ends.shape[0])
    backwards = np.empty(ends.shape[0], np.bool_)
    placed = 0
    for closed in range(2):  # chains with ends first, then rings
        for e in range(ends.shape[0]):
            if visited[e] or not on_contour(sides, area, e):
                continue
            first, last = ends[e, 0], ends[e, 1]
            if closed == 0:
                if count[first] == 2 and count[last] == 2:
                    continue
                if count[first] == 2:
                    first, last = last, first
            at, n, current, total = last, 0, e, 0.0
            while current >= 0:
                visited[current] = True
                backwards[n] = ends[current, 0] == at
                dx = xy[ends[current, 0], 0] - xy[ends[current, 1], 0]
                dy = xy[ends[current, 0], 1] - xy[ends[current, 1], 1]
                long = math.sqrt(dx * dx + dy * dy)
                chain[n], length[n] = current, long if math.isfinite(long) else 0.0
                total += length[n]
                n += 1
                following = -1
                for i in range(count[at]):
                    if not visited[next_edge[at, i]]:
                        following = next_edge[at, i]
                        break
                if following >= 0:
                    at = ends[following, 1] if ends[following, 0] == at else ends[following, 0]
                current = following
            places = int(total / spacing + 0.5)
            if places == 0:
                continue
            gap, i, passed = total / places, 0, 0.0
            for p in range(places):
                goal = (p + 0.5) * gap
                while i < n - 1 and passed + length[i] < goal:
                    passed += length[i]
                    i += 1
                room = 0.5 if length[i] <= 2.0 * corner else corner / length[i]
                s = min(max((goal - passed) / max(length[i], 1e-9), room), 1.0 - room)
                s = 1.0 - s if backwards[i] else s
                if placed < edge.shape[0]:
                    edge[placed], share[placed], size[placed] = chain[i], s, gap
                    placed += 1
    return placed


@njit(cache=True, inline="always")
def on_contour(sides, area, e):  # pragma: no cover - compiled
    """Whether the outline may run along a mesh edge."""
    if sides[e, 1] < 0:
        return area[sides[e, 0]] != 0.0
    return (area[sides[e, 0]] < 0.0) != (area[sides[e, 1]] < 0.0)


@njit(cache=True, inline="always")
def state_of_contour(first, second, own_depth, own, jump, reach, finger, region, area):  # pragma: no cover - compiled
    """0 where an outline is to be seen, 1 where another finger hides it, 2 where there is none.

    `first` and `second` are what is met just inside and just outside; `own` is the finger of the contour, -1 the palm.
    """
    inside, depth_in, outside, depth_out = first[0], first[4], second[0], second[4]
    if inside < 0:
        return 2
    other = finger[region[inside]]
    stranger = other >= 0 and own >= 0 and other != own
    if depth_in < own_depth - (jump if stranger else reach):
        return 1 if stranger else 2
    if stranger or area[inside] > 0.0 or depth_in > own_depth + reach:
        return 2
    if outside >= 0 and depth_out < depth_in + jump:
        other = finger[region[outside]]
        stranger = other >= 0 and own >= 0 and other != own
        return 1 if stranger and depth_out < depth_in else 2
    return 0


@njit(cache=True)
def expect_contours(
    origin, direction, contact, u, mesh, look, blur, margin, values, parts, visible, state
):  # pragma: no cover - compiled
    """Rendered templates, their parts, windows and states of contour samplers; twin: `surface.templates.expect_numpy`.

    As `profiles.expect_profiles`, with the mesh for the pills: the own surface is what goes on inwards without a step
    in depth, whatever link it belongs to. `contact` holds depth, finger, jump and reach of each sampler: steps in depth
    above `jump` separate surfaces, and the surface just inside lies within `reach` of the contour.
    """
    xy, inverse, pinhole, triangles, tiles, normal, region, finger, area = mesh
    coefficients, gain, background = look
    m, half = u.shape[0], blur.shape[0] // 2
    mid = np.searchsorted(u, 0.0)
    raw, depth, hit, face = np.empty(m), np.empty(m), np.empty(m, np.bool_), np.empty(m)
    inner, outer = mid - 2, mid + 1
    for i in range(origin.shape[0]):
        ox, oy, dx, dy = origin[i, 0], origin[i, 1], direction[i, 0], direction[i, 1]
        jump = contact[i, 2]
        inside = first_triangle(ox + u[inner] * dx, oy + u[inner] * dy, xy, inverse, pinhole, triangles, tiles)
        outside = first_triangle(ox + u[outer] * dx, oy + u[outer] * dy, xy, inverse, pinhole, triangles, tiles)
        state[i] = state_of_contour(
            inside, outside, contact[i, 0], int(contact[i, 1]), jump, contact[i, 3], finger, region, area
        )
        if state[i] != 0:
            for j in range(m):
                values[i, j], parts[i, 0, j], parts[i, 1, j], visible[i, j] = 0.0, 0.0, 0.0, False
            continue
        for j in range(m):
            k, b0, b1, b2, z = first_triangle(ox + u[j] * dx, oy + u[j] * dy, xy, inverse, pinhole, triangles, tiles)
            depth[j], hit[j], raw[j], face[j] = z, k >= 0, background, 0.0
            if k >= 0:
                a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
                nx = b0 * normal[a, 0] + b1 * normal[b, 0] + b2 * normal[c, 0]
                ny = b0 * normal[a, 1] + b1 * normal[b, 1] + b2 * normal[c, 1]
                nz = b0 * normal[a, 2] + b1 * normal[b, 2] + b2 * normal[c, 2]
                size = math.sqrt(nx * nx + ny * ny + nz * nz)
                scale = 1.0 / size if size > 0.0 else 0.0
                raw[j] = shade(coefficients, gain[region[k]], nx * scale, ny * scale, nz * scale)
                face[j] = max(-nz * scale, 0.0)
        top = mid - 1 if hit[mid - 1] else inner
        low = top
        while low > 0 and hit[low - 1] and abs(depth[low - 1] - depth[low]) < jump:
            low -= 1
        for j in range(m):
            total = cover = faces = 0.0
            for b in range(-half, half + 1):
                k = min(max(j + b, 0), m - 1)
                total += blur[b + half] * raw[k]
                if low <= k <= top:
                    cover += blur[b + half]
                    faces += blur[b + half] * face[k]
            values[i, j], parts[i, 0, j], parts[i, 1, j] = total, cover, faces
            visible[i, j] = low <= j <= mid
        if low > 0:
            for j in range(low, min(low + margin, mid - 2)):
                visible[i, j] = False
        j = mid
        while j < m - 1 and hit[j + 1] == hit[outer]:
            if j >= outer and hit[j + 1] and abs(depth[j + 1] - depth[j]) >= jump:
                break
            j += 1
            visible[i, j] = True
        if j < m - 1:
            for k in range(max(j - margin, mid + 1) + 1, j + 1):
                visible[i, k] = False
