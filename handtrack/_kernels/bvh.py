"""Compiled tree of boxes over triangles: building it by binned surface areas, and first hits of rays.

A node holds the boxes of its two children, so that one step of a ray loads both. A child is a node (>= 0) or, below
zero, a leaf: `-1 - first` in `child`, with its number of triangles in `count`.
"""

import numpy as np
from numba import njit

BINS = 16
LEAF = 4  # triangles that a leaf holds at most
DEEP = 96  # most nodes on the way down


@njit(cache=True, error_model="numpy")
def _half_area(low, high):  # pragma: no cover - compiled
    x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
    return x * y + y * z + z * x


@njit(cache=True, error_model="numpy")
def _split(order, first, count, low, high, middle):  # pragma: no cover - compiled
    """Rearrange triangles so that the first `n` of them are the better half; `n` comes back."""
    least, most = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(first, first + count):
        for d in range(3):
            least[d] = min(least[d], middle[order[i], d])
            most[d] = max(most[d], middle[order[i], d])
    best_cost, best_axis, best_bin = np.inf, -1, 0
    number = np.empty(BINS, np.int64)
    box = np.empty((BINS, 2, 3))
    after = np.empty(BINS)
    for d in range(3):
        width = most[d] - least[d]
        if not width > 0:
            continue
        number[:] = 0
        box[:, 0], box[:, 1] = np.inf, -np.inf
        for i in range(first, first + count):
            t = order[i]
            b = min(int((middle[t, d] - least[d]) / width * BINS), BINS - 1)
            number[b] += 1
            for e in range(3):
                box[b, 0, e] = min(box[b, 0, e], low[t, e])
                box[b, 1, e] = max(box[b, 1, e], high[t, e])
        a, z = np.full(3, np.inf), np.full(3, -np.inf)
        n = 0
        for b in range(BINS - 1, 0, -1):
            n += number[b]
            for e in range(3):
                a[e], z[e] = min(a[e], box[b, 0, e]), max(z[e], box[b, 1, e])
            after[b] = n * _half_area(a, z) if n else 0.0
        a, z = np.full(3, np.inf), np.full(3, -np.inf)
        n = 0
        for b in range(BINS - 1):
            n += number[b]
            for e in range(3):
                a[e], z[e] = min(a[e], box[b, 0, e]), max(z[e], box[b, 1, e])
            if n == 0 or n == count:
                continue
            cost = n * _half_area(a, z) + after[b + 1]
            if cost < best_cost:
                best_cost, best_axis, best_bin = cost, d, b
    if best_axis < 0:
        return count // 2  # all middles are one: any half does
    d, width = best_axis, most[best_axis] - least[best_axis]
    n = first
    for i in range(first, first + count):
        t = order[i]
        if min(int((middle[t, d] - least[d]) / width * BINS), BINS - 1) <= best_bin:
            order[i], order[n] = order[n], t
            n += 1
    return n - first


@njit(cache=True, error_model="numpy")
def build_tree(low, high):  # pragma: no cover - compiled
    """Order of the triangles, and the nodes' boxes (n, 2, 6), children (n, 2) and counts (n, 2).

    `low`, `high` are the boxes of the triangles, at least one.
    """
    total = low.shape[0]
    middle = 0.5 * (low + high)
    order = np.arange(total)
    box, child = np.empty((total, 2, 6)), np.empty((total, 2), np.int64)
    count = np.zeros((total, 2), np.int64)
    stack = np.empty((total + 2, 4), np.int64)  # first, number, node above, side
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, total, -1, 0
    filled, nodes = 1, 0
    while filled:
        filled -= 1
        first, n, above, side = stack[filled, 0], stack[filled, 1], stack[filled, 2], stack[filled, 3]
        if above >= 0:
            for d in range(3):
                least, most = np.inf, -np.inf
                for i in range(first, first + n):
                    least, most = min(least, low[order[i], d]), max(most, high[order[i], d])
                box[above, side, d], box[above, side, 3 + d] = least, most
            if n <= LEAF:
                child[above, side], count[above, side] = -1 - first, n
                continue
            child[above, side] = nodes
        node = nodes
        nodes += 1
        left = _split(order, first, n, low, high, middle) if n > 1 else 1
        stack[filled, 0], stack[filled, 1], stack[filled, 2], stack[filled, 3] = first + left, n - left, node, 1
        stack[filled + 1, 0], stack[filled + 1, 1] = first, left
        stack[filled + 1, 2], stack[filled + 1, 3] = node, 0
        filled += 2
        if n == 1:  # a room of one triangle: its other half is empty
            box[node, 1, :3], box[node, 1, 3:] = np.inf, -np.inf
            child[node, 1], count[node, 1] = -1, 0
            filled -= 1
            stack[filled - 1, 0], stack[filled - 1, 1] = first, 1
            stack[filled - 1, 2], stack[filled - 1, 3] = node, 0
    return order, box[:nodes].copy(), child[:nodes].copy(), count[:nodes].copy()


@njit(cache=True, error_model="numpy", inline="always")
def _enter(box, node, side, origin, over, far):  # pragma: no cover - compiled
    """Where a ray enters a child's box, inf where it misses it; the box is a little larger than the triangles."""
    near, last = 0.0, far
    for d in range(3):
        a = (box[node, side, d] - origin[d]) * over[d]
        b = (box[node, side, 3 + d] - origin[d]) * over[d]
        if a > b:
            a, b = b, a
        if a > near:  # NaN, of a ray within a face, changes nothing
            near = a
        if b < last:
            last = b
    return near if near <= last * (1.0 + 4e-16 * 8) + 1e-300 else np.inf


@njit(cache=True, error_model="numpy", inline="always")
def _meet(corner, t, origin, kx, ky, kz, sx, sy, sz, far):  # pragma: no cover - compiled
    """Share of a ray at which it meets a triangle, inf where it does not: edges belong to both of their triangles.

    The test of Woop, Benthin & Wald 2013: the triangle is sheared so that the ray runs along z.
    """
    az, bz, cz = corner[t, 0, kz] - origin[kz], corner[t, 1, kz] - origin[kz], corner[t, 2, kz] - origin[kz]
    ax, ay = corner[t, 0, kx] - origin[kx] - sx * az, corner[t, 0, ky] - origin[ky] - sy * az
    bx, by = corner[t, 1, kx] - origin[kx] - sx * bz, corner[t, 1, ky] - origin[ky] - sy * bz
    cx, cy = corner[t, 2, kx] - origin[kx] - sx * cz, corner[t, 2, ky] - origin[ky] - sy * cz
    u, v, w = cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax
    if (u < 0 or v < 0 or w < 0) and (u > 0 or v > 0 or w > 0):
        return np.inf
    det = u + v + w
    if det == 0:
        return np.inf
    share = (u * az + v * bz + w * cz) * sz / det
    return share if 0 <= share <= far else np.inf


@njit(cache=True, error_model="numpy")
def first_hits(box, child, count, corner, origin, vector):  # pragma: no cover - compiled
    """Share of each vector at which it first meets a triangle, inf where it meets none within its length.

    `corner` (t, 3, 3) in the order of the tree; `origin` and `vector` (n, 3).
    """
    out = np.full(vector.shape[0], np.inf)
    stack, entry = np.empty(DEEP, np.int64), np.empty(DEEP)
    over = np.empty(3)
    for i in range(vector.shape[0]):
        o, v = origin[i], vector[i]
        kz = 0
        for d in range(3):
            over[d] = 1.0 / v[d]
            if abs(v[d]) > abs(v[kz]):
                kz = d
        if v[kz] == 0 or not np.isfinite(v[0] + v[1] + v[2] + o[0] + o[1] + o[2]):
            continue
        kx, ky = (kz + 1) % 3, (kz + 2) % 3
        sx, sy, sz = v[kx] / v[kz], v[ky] / v[kz], 1.0 / v[kz]
        best = 1.0
        found = False
        stack[0], entry[0], filled = 0, 0.0, 1
        while filled:
            filled -= 1
            if entry[filled] > best:
                continue
            node = stack[filled]
            near, far = _enter(box, node, 0, o, over, best), _enter(box, node, 1, o, over, best)
            first = 0 if near <= far else 1
            for turn in range(2):
                side = first if turn == 0 else 1 - first
                at = near if side == 0 else far
                if child[node, side] < 0 and at <= best:
                    start = -1 - child[node, side]
                    for t in range(start, start + count[node, side]):
                        share = _meet(corner, t, o, kx, ky, kz, sx, sy, sz, best)
                        if share <= best:
                            best, found = share, True
            for turn in range(2):  # the nearer one is looked at first: it goes on the stack last
                side = 1 - first if turn == 0 else first
                at = near if side == 0 else far
                if child[node, side] >= 0 and at <= best:
                    stack[filled], entry[filled] = child[node, side], at
                    filled += 1
        if found:
            out[i] = best
    return out
