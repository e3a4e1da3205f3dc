"""Compiled tree of boxes over triangles: building it by binned surface areas, and first hits of rays.

A node holds the boxes of its two children, so that one step of a ray loads both. A child is a node (>= 0) or, below
zero, a leaf: `-1 - first` in `child`, with its number of triangles in `count`.
"""

import numpy as np
from numba import njit

BINS = 16
LEAF = 4  # triangles that a leaf holds at most
DEEP = 96  # most nodes on the way down
TINY = 1e-200
WIDER = 1.0 + 3.2e-15  # of boxes, for rounding


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
    Twin: `body.environment.hits_numpy`, of tree and rays together.
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


@njit(cache=True, error_model="numpy")
def first_hits(box, child, count, corner, origin, vector):  # pragma: no cover - compiled
    """Share of each vector at which it first meets a triangle, inf where it meets none within its length.

    `corner` (t, 3, 3) in the order of the tree; `origin` and `vector` (n, 3). Triangles are met as Woop, Benthin & Wald
    2013 do it: sheared so that the ray runs along one axis, and an edge belongs to both of its triangles.
    Twin: `body.environment.hits_numpy`, of tree and rays together.
    """
    out = np.full(vector.shape[0], np.inf)
    stack, entry = np.empty(DEEP, np.int64), np.empty(DEEP)
    for i in range(vector.shape[0]):
        ox, oy, oz = origin[i, 0], origin[i, 1], origin[i, 2]
        vx, vy, vz = vector[i, 0], vector[i, 1], vector[i, 2]
        if not np.isfinite(vx + vy + vz + ox + oy + oz) or (vx == 0 and vy == 0 and vz == 0):
            continue
        # Slopes of zero have a large inverse instead of an infinite one, so that 0 x inf never comes up.
        ix = 1.0 / vx if abs(vx) > TINY else 1.0 / TINY
        iy = 1.0 / vy if abs(vy) > TINY else 1.0 / TINY
        iz = 1.0 / vz if abs(vz) > TINY else 1.0 / TINY
        ax, ay, az = (0 if ix > 0 else 3), (1 if iy > 0 else 4), (2 if iz > 0 else 5)  # the sides that rays enter by
        bx, by, bz = 3 - ax, 5 - ay, 7 - az
        kz = 0
        if abs(vy) > abs(vx):
            kz = 1
        if abs(vz) > max(abs(vx), abs(vy)):
            kz = 2
        kx, ky = (kz + 1) % 3, (kz + 2) % 3
        sx, sy, sz = vector[i, kx] / vector[i, kz], vector[i, ky] / vector[i, kz], 1.0 / vector[i, kz]
        px, py, pz = origin[i, kx], origin[i, ky], origin[i, kz]
        best = 1.0
        found = False
        stack[0], entry[0], filled = 0, 0.0, 1
        while filled:
            filled -= 1
            if entry[filled] > best:
                continue
            node = stack[filled]
            nears = (np.inf, np.inf)
            for side in range(2):
                near = max(
                    max((box[node, side, ax] - ox) * ix, (box[node, side, ay] - oy) * iy),
                    max((box[node, side, az] - oz) * iz, 0.0),
                )
                far = min(
                    min((box[node, side, bx] - ox) * ix, (box[node, side, by] - oy) * iy),
                    min((box[node, side, bz] - oz) * iz, best),
                )
                if not near <= far * WIDER + 1e-300:
                    near = np.inf
                elif child[node, side] < 0:
                    start = -1 - child[node, side]
                    for t in range(start, start + count[node, side]):
                        z0, z1, z2 = corner[t, 0, kz] - pz, corner[t, 1, kz] - pz, corner[t, 2, kz] - pz
                        x0, y0 = corner[t, 0, kx] - px - sx * z0, corner[t, 0, ky] - py - sy * z0
                        x1, y1 = corner[t, 1, kx] - px - sx * z1, corner[t, 1, ky] - py - sy * z1
                        x2, y2 = corner[t, 2, kx] - px - sx * z2, corner[t, 2, ky] - py - sy * z2
                        u, v, w = x2 * y1 - y2 * x1, x0 * y2 - y0 * x2, x1 * y0 - y1 * x0
                        if (u < 0 or v < 0 or w < 0) and (u > 0 or v > 0 or w > 0):
                            continue
                        det = u + v + w
                        if det == 0:
                            continue
                        share = (u * z0 + v * z1 + w * z2) * sz / det
                        if 0 <= share <= best:
                            best, found = share, True
                    near = np.inf
                nears = (near, nears[1]) if side == 0 else (nears[0], near)
            first = 0 if nears[0] <= nears[1] else 1  # the nearer one is looked at first: it goes on the stack last
            for side in (1 - first, first):
                near = nears[0] if side == 0 else nears[1]
                if near <= best:
                    stack[filled], entry[filled] = child[node, side], near
                    filled += 1
        if found:
            out[i] = best
    return out


@njit(cache=True, error_model="numpy")
def within(share, origin, vector):  # pragma: no cover - compiled
    """Shares of vectors in double precision, inf beyond the end of each and where a ray is none.

    Twin: `body.environment.within_numpy`.
    """
    out = np.full(share.size, np.inf)
    for i in range(share.size):
        size, place = 0.0, 0.0
        for d in range(3):
            size += vector[i, d] * vector[i, d]
            place += origin[i, d]
        if share[i] <= 1.0 and 0.0 < size < np.inf and np.isfinite(place):
            out[i] = share[i]
    return out
