"""Compiled comparison of an image with a smooth image of pills: samples of the image, and their normal equations.

A sample is a block of pixels that shows one surface and nothing else, or a single pixel on an outline or a crease.
Its grey level depends on the twists of the links in it (velocity of the base, angular velocity; camera axes) and on
two nuisances of the patch of surface that dominates it: a relative error of the grey level, and an outward shift of
the surface there.
"""

import math

import numpy as np
from numba import njit

from .geometry import hit_pill
from .soft_image import place_at, square
from .soft_pill import DEPTH, FACTS, LEVEL, NORMAL, ROOT, SLOPE, clear_pill

ALONG, ACROSS = 4, 3  # patches of a link: three thirds and what lies beyond the tip, times left, middle, right
PATCHES = ALONG * ACROSS
LARGE, LEAST, SMALL = 16, 8, 4  # pixels along the side of the largest and least block, and of what is kept of one
FEW = 4  # pills that one sample can hold
NOTHING, OUTLINE, CREASE = 0, 1, 2
UNKNOWN = -1  # the patch of a sample that no pill has shown in yet


@njit(cache=True)
def mean_level(image, x, y, size):  # pragma: no cover - compiled
    """Mean of a block of pixels."""
    total = 0.0
    for i in range(y, y + size):
        for j in range(x, x + size):
            total += image[i, j]
    return total / (size * size)


@njit(cache=True)
def put_sample(image, x, y, size, chosen, count, out, n):  # pragma: no cover - compiled
    """Write sample n: its middle, side and mean level, and the pills that may show in it."""
    place, level, pill = out
    if n >= level.shape[0] or count > FEW:
        return n
    place[n, 0], place[n, 1], place[n, 2] = x + 0.5 * (size - 1), y + 0.5 * (size - 1), size
    level[n] = mean_level(image, x, y, size)
    for i in range(FEW):
        pill[n, i] = chosen[i] if i < count else -1
    return n + 1


@njit(cache=True)
def outline_near(at, pinhole, pills, chosen, count, reach, n, inside):  # pragma: no cover - compiled
    """How many pills cover a place (numbers in `inside`), and whether an outline passes at `reach` pixels or less.

    Pills that lie wholly beyond that are dropped from `chosen`; the number of those left comes first.
    """
    base, tip, radius = pills
    X, Y, Xx, Xy, Yx, Yy = at[0], at[1], at[2], at[3], at[4], at[5]
    covering, left, near = 0, 0, False
    for i in range(count):
        k = chosen[i]
        if pinhole:
            distance, far = clear_pill(0.0, 0.0, 0.0, X, Y, 1.0, base, tip, radius, k, n)
        else:
            distance, far = clear_pill(X, Y, 0.0, 0.0, 0.0, 1.0, base, tip, radius, k, n)
            far = 1.0
        gx, gy = far * (n[0] * Xx + n[1] * Yx), far * (n[0] * Xy + n[1] * Yy)
        meets = distance * distance <= reach * reach * (gx * gx + gy * gy)
        if meets or distance < 0.0:
            chosen[left] = k
            left += 1
        near = near or meets
        if distance < 0.0:
            inside[covering] = k
            covering += 1
    return left, covering, near


@njit(cache=True)
def crease_near(at, pinhole, pills, inside, covering, reach, two):  # pragma: no cover - compiled
    """Whether the two nearest of the pills that cover a place meet within `reach` pixels."""
    base, tip, radius = pills
    X, Y, Xx, Xy, Yx, Yy = at[0], at[1], at[2], at[3], at[4], at[5]
    two[0, 0] = two[1, 0] = math.inf  # depth and its slopes along x and y, of the nearest and the next
    for i in range(covering):
        k = inside[i]
        if pinhole:
            t, nx, ny, nz = hit_pill(0.0, 0.0, 0.0, X, Y, 1.0, base, tip, radius, k)
            facing, far = nx * X + ny * Y + nz, t
        else:
            t, nx, ny, nz = hit_pill(X, Y, 0.0, 0.0, 0.0, 1.0, base, tip, radius, k)
            facing, far = nz, 1.0
        if not (t < two[1, 0] and facing < -1e-9):
            continue
        row = 0 if t < two[0, 0] else 1
        if row == 0:
            two[1, 0], two[1, 1], two[1, 2] = two[0, 0], two[0, 1], two[0, 2]
        two[row, 0], two[row, 1] = t, -far * (nx * Xx + ny * Yx) / facing
        two[row, 2] = -far * (nx * Xy + ny * Yy) / facing
    if not two[1, 0] < math.inf:
        return False
    return two[1, 0] - two[0, 0] <= reach * math.hypot(two[1, 1] - two[0, 1], two[1, 2] - two[0, 2])


@njit(cache=True)
def passing(at, world, chosen, count, reach, scratch):  # pragma: no cover - compiled
    """What passes a place at `reach` pixels or less: an outline, a crease or NOTHING; and how many pills are left."""
    pinhole, pills = world
    inside = scratch[7]
    left, covering, near = outline_near(at, pinhole, pills, chosen, count, reach, scratch[5][0], inside)
    if near:
        return OUTLINE, left
    if covering < 2:
        return NOTHING, left
    return (CREASE if crease_near(at, pinhole, pills, inside, covering, reach, scratch[4]) else NOTHING), left


@njit(cache=True)
def pills_in_block(grid, x, y, boxes, pad, chosen, low, high):  # pragma: no cover - compiled
    """Numbers of the pills whose box, `pad` pixels wider, meets a LARGE block; how many."""
    place_at(grid, x, y, low)
    place_at(grid, x + LARGE - 1, y + LARGE - 1, high)
    slack_x, slack_y, count = pad * abs(low[2]), pad * abs(low[5]), 0
    for k in range(boxes.shape[0]):
        across = high[0] + slack_x >= boxes[k, 0] and low[0] - slack_x <= boxes[k, 1]
        if across and high[1] + slack_y >= boxes[k, 2] and low[1] - slack_y <= boxes[k, 3]:
            chosen[count] = k
            count += 1
    return count


@njit(cache=True)
def choose_samples(image, grid, pinhole, pills, boxes, s, thin, place, level, pill):  # pragma: no cover - compiled
    """One small block of every large one inside surfaces, and one in `thin` of the pixels on outlines and creases.

    Large blocks, LARGE pixels a side, are quartered until they are LEAST; SMALL is what is kept
    of one without an outline. Single pixels lie on the lattice
    `(x + 3 y) mod thin = 0`. Returns the number of samples. Twin: `synthesis.outlined_numpy`,
    for pixels on outlines.
    """
    height, width, links = image.shape[0], image.shape[1], boxes.shape[0]
    at, scratch = np.zeros(6), soft_scratch(links)
    near, n, left = ROOT + 4.0 * s + 0.5, 0, np.zeros((16, 4), np.int64)
    each = np.zeros((16, links), np.int64)  # the pills that may show in each block that waits
    out, world = (place, level, pill), (pinhole, pills)
    for y0 in range(0, height - LARGE + 1, LARGE):
        for x0 in range(0, width - LARGE + 1, LARGE):
            left[0, 0], left[0, 1], left[0, 2], waiting = x0, y0, LARGE, 1
            left[0, 3] = pills_in_block(grid, x0, y0, boxes, near + 1.0, each[0], at, scratch[9])
            while waiting > 0:
                waiting -= 1
                u, v, size, count = left[waiting, 0], left[waiting, 1], left[waiting, 2], left[waiting, 3]
                if count == 0:
                    continue
                chosen = each[waiting]
                place_at(grid, u + 0.5 * (size - 1), v + 0.5 * (size - 1), at)
                what, count = passing(at, world, chosen, count, near + 0.75 * (size - 1), scratch)
                if what == NOTHING:
                    turn = u // SMALL + v // SMALL  # a small part of it: all of it would be bent by the shading
                    if count > 0:
                        x, y = u + SMALL * (turn % (size // SMALL)), v + SMALL * (turn // 2 % (size // SMALL))
                        n = put_sample(image, x, y, SMALL, chosen, count, out, n)
                elif size > LEAST:
                    for i in range(3, -1, -1):
                        left[waiting + i, 0], left[waiting + i, 1] = u + size // 2 * (i % 2), v + size // 2 * (i // 2)
                        left[waiting + i, 2], left[waiting + i, 3] = size // 2, count
                        each[waiting + i, :count] = chosen[:count]
                    waiting += 4
                else:
                    n = put_pixels(image, grid, u, v, world, chosen, count, what, near, thin, scratch, out, n)
    return n


@njit(cache=True)
def put_pixels(
    image, grid, u, v, world, chosen, count, what, near, thin, scratch, out, n
):  # pragma: no cover - compiled
    """Write the pixels of a block that lie on the lattice: on outlines and creases all, beside them a quarter."""
    at = scratch[6]
    for y in range(v, v + LEAST):
        for x in range(u + (thin - (u + 3 * y) % thin) % thin, u + LEAST, thin):
            place_at(grid, x, y, at)
            fine = scratch[8]
            fine[:count] = chosen[:count]
            found = OUTLINE
            if what == CREASE:
                found, _ = passing(at, world, fine, count, near, scratch)
            elif not outline_near(at, world[0], world[1], fine, count, near, scratch[5][0], scratch[7])[2]:
                found = NOTHING
            take = found != NOTHING or (x + 3 * y) // thin % 4 == 0
            if take:
                n = put_sample(image, x, y, 1, chosen, count, out, n)
    return n


@njit(cache=True)
def dominant(fact, order, by, there):  # pragma: no cover - compiled
    """The pill that a sample depends on most: by its outline, else by its grey level."""
    best, most = order[0], -1.0
    for i in range(there):
        k = order[i]
        size = abs(by[k, 1]) * fact[k, SLOPE] + 1e-3 * abs(by[k, 0] * fact[k, LEVEL])
        if size > most:
            best, most = k, size
    return best


@njit(cache=True)
def patch_at(at, pinhole, pills, fact, k):  # pragma: no cover - compiled
    """Patch of pill k that the place `at` of the image shows."""
    base, tip, radius = pills
    depth = fact[k, DEPTH] if pinhole else 1.0
    x, y = at[0] * depth - base[k, 0], at[1] * depth - base[k, 1]
    ax, ay = tip[k, 0] - base[k, 0], tip[k, 1] - base[k, 1]
    length = math.sqrt(ax * ax + ay * ay)
    if length < 1e-9:
        return (k * ALONG + ALONG - 1) * ACROSS + 1
    along, across = (x * ax + y * ay) / (length * length), (x * ay - y * ax) / (length * radius[k, 0])
    row = ALONG - 1 if along > 1.0 else min(max(int(along * (ALONG - 1)), 0), ALONG - 2)
    column = 0 if across < -0.45 else 2 if across > 0.45 else 1
    return (k * ALONG + row) * ACROSS + column


@njit(cache=True)
def soft_scratch(links):  # pragma: no cover - compiled
    """Working memory of `square`."""
    return (
        np.zeros((links, FACTS)),
        np.zeros((links, 18)),
        np.zeros(links, np.int64),
        np.zeros((links, 3)),
        np.zeros((links, 3)),
        np.zeros((5, 3)),
        np.zeros(6),
        np.zeros(links, np.int64),
        np.zeros(links, np.int64),
        np.zeros(6),
    )


@njit(cache=True)
def sample_rows(
    grid, pinhole, pills, look, behind, s, place, pill, patch, level, row, by_patch, normal
):  # pragma: no cover - compiled
    """Expected grey level of every sample and its derivatives, by the twists of its pills and by its patch.

    `row` (n, FEW, 6) follows the order of `pill`; `by_patch` (n, 2) is by the relative error of the patch's grey level
    and by its outward shift in model units; `normal` (n, 3) is that of the patch's pill. A sample
    whose patch is UNKNOWN gets the one that dominates it.
    Twin: `soft_image.soft_image_numpy` and its differences.
    """
    links = pills[0].shape[0]
    scratch = soft_scratch(links)
    fact, order, by = scratch[0], scratch[2], scratch[3]
    at, chosen = np.zeros(6), np.zeros(links, np.int64)
    for n in range(patch.shape[0]):
        count = 0
        while count < FEW and pill[n, count] >= 0:
            chosen[count] = pill[n, count]
            count += 1
        place_at(grid, place[n, 0], place[n, 1], at)
        level[n], _, there = square(at, pinhole, pills, look, behind, chosen, count, 1.0, s, scratch)
        if patch[n] == UNKNOWN and there > 0:
            k = dominant(fact, order, by, there)
            patch[n] = patch_at(at, pinhole, pills, fact, k)
        row[n] = 0.0
        by_patch[n] = 0.0
        normal[n] = 0.0
        own = patch[n] // PATCHES
        for i in range(there):
            k = order[i]
            slot = 0
            while pill[n, slot] != k:
                slot += 1
            shade, edge, depth = by[k, 0], -by[k, 1] * fact[k, SLOPE], by[k, 2]
            for a in range(6):
                row[n, slot, a] = shade * scratch[1][k, a]
                if edge != 0.0:
                    row[n, slot, a] += edge * scratch[1][k, 6 + a]
                if depth != 0.0:
                    row[n, slot, a] += depth * scratch[1][k, 12 + a]
            if k == own:
                by_patch[n, 0] = shade * fact[k, LEVEL]
                normal[n] = fact[k, NORMAL : NORMAL + 3]
                if edge != 0.0:  # rows of the distance are -n / size: an outward shift moves the outline by 1 / size
                    x, y, z = scratch[1][k, 6], scratch[1][k, 7], scratch[1][k, 8]
                    by_patch[n, 1] = -edge * math.sqrt(x * x + y * y + z * z)


@njit(cache=True)
def normal_equations(pill, patch, weight, r, row, by_patch, H, g, across, within, own):  # pragma: no cover - compiled
    """Sums over the samples of `weight` times outer products of their derivatives, and times r.

    H (6l, 6l) upper triangle by the twists and g (p, 6l) for each patch; `across` (p, 2, 6l),
    `within` (p, 3) as xx, xy, yy, and `own` (p, 2) by the nuisances of each patch. r is observed minus expected.
    Twin: `synthesis.normal_equations_numpy`.
    """
    for n in range(patch.shape[0]):
        w, p = weight[n], patch[n]
        if w == 0.0 or p < 0:
            continue
        b0, b1 = by_patch[n, 0], by_patch[n, 1]
        within[p, 0] += w * b0 * b0
        within[p, 1] += w * b0 * b1
        within[p, 2] += w * b1 * b1
        own[p, 0] += w * b0 * r[n]
        own[p, 1] += w * b1 * r[n]
        for i in range(FEW):
            k = pill[n, i]
            if k < 0:
                break
            for a in range(6):
                scaled = w * row[n, i, a]
                g[p, 6 * k + a] += scaled * r[n]
                across[p, 0, 6 * k + a] += scaled * b0
                across[p, 1, 6 * k + a] += scaled * b1
                for j in range(FEW):
                    o = pill[n, j]
                    if o < 0:
                        break
                    if o < k:
                        continue
                    for b in range(6):
                        H[6 * k + a, 6 * o + b] += scaled * row[n, j, b]
