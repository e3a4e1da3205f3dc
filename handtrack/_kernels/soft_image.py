"""Compiled loops over the pixels of a smooth image of pills: grey levels, and the information on every link's motion.

In each square the pills that `soft_pill.see_pill` finds are laid over each other from front to back; the derivatives
of the grey level by the links' twists are summed over the squares of a pixel, and their outer products over the pixels.
"""

import math

import numpy as np
from numba import njit

from .soft_pill import COVER, DEPTH, FACTS, HIT, LEVEL, NORMAL, NX, NY, ROOT, SLOPE, TX, TY, clear_pill, cover, see_pill


@njit(cache=True)
def crease(front, back, unit, h, s):  # pragma: no cover - compiled
    """Share of the square in which `front` lies before `back`, its slope by the distance, and 1 / that depth's slope.

    `unit` is the size of a pixel at the surface.
    """
    if front[HIT] == 0.0 or back[HIT] == 0.0:
        return 1.0, 0.0, 0.0
    apart = back[DEPTH] - front[DEPTH]
    gx, gy = back[TX] - front[TX], back[TY] - front[TY]
    size = math.sqrt(gx * gx + gy * gy)
    if size < 1e-5 * unit:
        # Two surfaces that are the same, as where the links of a finger share the sphere of their joint.
        return (0.5, 0.0, 0.0) if apart < 1e-5 * unit else (1.0, 0.0, 0.0)
    share, slope = cover(-apart / size, gx / size, gy / size, h, s)
    return share, slope, 1.0 / size


@njit(cache=True)
def overlap(m, a, cosine):  # pragma: no cover - compiled
    """Share that shows of a pill covering `a` behind what covers `m`, and its derivatives by a and m.

    Edges that run side by side hide the same part of the square, edges that face each other different parts.
    """
    if m <= 0.0 or cosine < -0.8:
        return (a, 1.0, 0.0) if a < 1.0 - m else (1.0 - m, 0.0, -1.0)
    if cosine > 0.8:
        return (a - m, 1.0, -1.0) if a > m else (0.0, 0.0, 0.0)
    return (1.0 - m) * a, 1.0 - m, -a


@njit(cache=True)
def composite(fact, order, count, behind, unit, h, s, by, keep):  # pragma: no cover - compiled
    """Grey level of a square, front to back; `by` (l, 3) receives its derivatives by level, coverage and depth.

    Returns the level and the share of the background.
    """
    m, level = 0.0, 0.0
    ex = ey = 0.0
    for i in range(count):
        k = order[i]
        by[k, 0] = by[k, 1] = by[k, 2] = 0.0
        cosine = ex * fact[k, NX] + ey * fact[k, NY]
        w, keep[i, 0], keep[i, 1] = overlap(m, fact[k, COVER], cosine)
        keep[i, 2] = w
        if fact[k, COVER] < 1.0 and w > 0.0:
            ex, ey = fact[k, NX], fact[k, NY]
        m += w
    bar = -behind
    for i in range(count - 1, -1, -1):
        k, w = order[i], keep[i, 2]
        shown = fact[k, LEVEL]
        by[k, 0] += w
        if i + 1 < count:
            j = order[i + 1]
            share, slope, scale = crease(fact[k], fact[j], unit, h, s)
            if share < 1.0:
                mix, other = (1.0 - share) * fact[j, COVER], fact[j, LEVEL] - fact[k, LEVEL]
                shown += mix * other
                by[k, 0] -= w * mix
                by[j, 0] += w * mix
                by[j, 1] += w * other * (1.0 - share)
                by[j, 2] -= w * other * fact[j, COVER] * slope * scale
                by[k, 2] += w * other * fact[j, COVER] * slope * scale
        level += w * shown
        bar_w = shown + bar
        by[k, 1] += bar_w * keep[i, 0]
        bar += bar_w * keep[i, 1]
    return level + (1.0 - m) * behind, 1.0 - m


@njit(cache=True)
def sort_by_depth(fact, order, count):  # pragma: no cover - compiled
    """Pills from front to back, by insertion: they are few."""
    for i in range(1, count):
        k, j = order[i], i
        while j > 0 and fact[order[j - 1], DEPTH] > fact[k, DEPTH]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = k


@njit(cache=True)
def add_light(fact, order, count, open_share, by, look, links, weight, more):  # pragma: no cover - compiled
    """Derivatives of a square's level by the 28 shading coefficients, the gains and the background, added to `more`."""
    shading, gain = look
    for i in range(count):
        k = order[i]
        x, y, z = fact[k, NORMAL], fact[k, NORMAL + 1], fact[k, NORMAL + 2]
        scale = weight * by[k, 0] * gain[k]
        column = 0
        for deep in range(2):
            for degree in range(5 - deep):
                for b in range(degree + 1):
                    more[column] += scale * (z if deep else 1.0) * x ** (degree - b) * y**b
                    column += 1
        if shading[25] * x + shading[26] * y + shading[27] * z > 0.0:
            more[25] += scale * x
            more[26] += scale * y
            more[27] += scale * z
        more[28 + k] += weight * by[k, 0] * fact[k, LEVEL] / gain[k]
    more[28 + links] += weight * open_share


@njit(cache=True)
def place_at(grid, x, y, out):  # pragma: no cover - compiled
    """Normalised coordinates at a place of the image and their slopes by pixel, from those of the pixel centres."""
    height, width = grid.shape[0], grid.shape[1]
    column, row = min(max(int(x + 0.5), 0), width - 1), min(max(int(y + 0.5), 0), height - 1)
    left, right = max(column - 1, 0), min(column + 1, width - 1)
    above, below = max(row - 1, 0), min(row + 1, height - 1)
    out[0], out[1] = grid[row, column, 0], grid[row, column, 1]
    for a in range(2):
        out[2 + 2 * a] = (grid[row, right, a] - grid[row, left, a]) / max(right - left, 1)
        out[3 + 2 * a] = (grid[below, column, a] - grid[above, column, a]) / max(below - above, 1)
        out[a] += out[2 + 2 * a] * (x - column) + out[3 + 2 * a] * (y - row)


@njit(cache=True)
def chosen_pills(grid, x0, y0, size, boxes, pad, chosen):  # pragma: no cover - compiled
    """Numbers of the pills whose box, `pad` pixels wider, meets a block of pixels; how many."""
    x1, y1 = min(x0 + size, grid.shape[1]) - 1, min(y0 + size, grid.shape[0]) - 1
    count = 0
    X0, X1, Y0, Y1 = grid[y0, x0, 0], grid[y1, x1, 0], grid[y0, x0, 1], grid[y1, x1, 1]
    slack_x = pad * abs(grid[0, 1, 0] - grid[0, 0, 0])
    slack_y = pad * abs(grid[1, 0, 1] - grid[0, 0, 1])
    for k in range(boxes.shape[0]):
        across = X1 + slack_x >= boxes[k, 0] and X0 - slack_x <= boxes[k, 1]
        if across and Y1 + slack_y >= boxes[k, 2] and Y0 - slack_y <= boxes[k, 3]:
            chosen[count] = k
            count += 1
    return count


@njit(cache=True)
def is_plain(place, pinhole, pills, chosen, count, reach, work):  # pragma: no cover - compiled
    """Whether every outline passes a place at more than `reach` pixels."""
    base, tip, radius = pills
    X, Y, Xx, Xy, Yx, Yy = place
    n = work[0]
    for i in range(count):
        k = chosen[i]
        if pinhole:
            distance, depth = clear_pill(0.0, 0.0, 0.0, X, Y, 1.0, base, tip, radius, k, n)
        else:
            distance, depth = clear_pill(X, Y, 0.0, 0.0, 0.0, 1.0, base, tip, radius, k, n)
        far = depth if pinhole else 1.0
        gx, gy = far * (n[0] * Xx + n[1] * Yx), far * (n[0] * Xy + n[1] * Yy)
        if abs(distance) <= reach * math.sqrt(gx * gx + gy * gy):
            return False
    return True


@njit(cache=True)
def square(place, pinhole, pills, look, behind, chosen, count, h, s, scratch):  # pragma: no cover - compiled
    """One sample: (level, share of the background, pills in it); details stay in `scratch`."""
    fact, row, order, by, keep, work = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5]
    there = 0
    for i in range(count):
        k = chosen[i]
        if see_pill(k, place, pinhole, pills, look, h, s, fact[k], row[k], work):
            order[there] = k
            there += 1
    sort_by_depth(fact, order, there)
    unit = math.sqrt(abs(place[2] * place[5] - place[3] * place[4]))
    if pinhole and there > 0:
        unit *= abs(fact[order[0], DEPTH])
    level, rest = composite(fact, order, there, behind, unit, h, s, by, keep)
    return level, rest, there


@njit(cache=True)
def add_motion(scratch, there, weight, total, used):  # pragma: no cover - compiled
    """Derivatives of a square's level by the links' twists, added to those of its pixel."""
    fact, row, order, by = scratch[0], scratch[1], scratch[2], scratch[3]
    for i in range(there):
        k = order[i]
        if not used[k]:
            used[k] = True
            total[6 * k : 6 * k + 6] = 0.0
        level, edge, depth = weight * by[k, 0], -weight * by[k, 1] * fact[k, SLOPE], weight * by[k, 2]
        for a in range(6):
            total[6 * k + a] += level * row[k, a]
        if edge != 0.0:
            for a in range(6):
                total[6 * k + a] += edge * row[k, 6 + a]
        if depth != 0.0:
            for a in range(6):
                total[6 * k + a] += depth * row[k, 12 + a]


@njit(cache=True)
def add_information(total, used, chosen, count, more, light, weight, H):  # pragma: no cover - compiled
    """Outer product of one pixel's derivatives, added to the upper triangle of H."""
    links = used.shape[0]
    for i in range(count):
        k = chosen[i]
        if not used[k]:
            continue
        for j in range(i, count):
            o = chosen[j]
            if not used[o]:
                continue
            for a in range(6):
                scaled = weight * total[6 * k + a]
                for b in range(6):
                    H[6 * k + a, 6 * o + b] += scaled * total[6 * o + b]
        if light:
            for a in range(6):
                scaled = weight * total[6 * k + a]
                for b in range(more.shape[0]):
                    H[6 * k + a, 6 * links + b] += scaled * more[b]
    if light:
        for a in range(more.shape[0]):
            for b in range(a, more.shape[0]):
                H[6 * links + a, 6 * links + b] += weight * more[a] * more[b]


@njit(cache=True)
def creased(scratch, there, reach):  # pragma: no cover - compiled
    """Whether the two nearest surfaces meet within `reach` pixels."""
    fact, order = scratch[0], scratch[2]
    if there < 2 or fact[order[0], HIT] == 0.0 or fact[order[1], HIT] == 0.0:
        return False
    front, back = fact[order[0]], fact[order[1]]
    size = math.sqrt((back[TX] - front[TX]) ** 2 + (back[TY] - front[TY]) ** 2)
    return back[DEPTH] - front[DEPTH] <= reach * size


@njit(cache=True)
def cut_pixel(
    x, y, n, place, world, chosen, count, s, scratch, light, total, used, more
):  # pragma: no cover - compiled
    """Mean level of n x n squares about a place, and its derivatives in `total` and `more`; how many pills it shows."""
    grid, pinhole, pills, look, behind = world
    mean, weight, there = 0.0, 1.0 / (n * n), 0
    used[:] = False
    if light:
        more[:] = 0.0
    for i in range(n):
        for j in range(n):
            place_at(grid, x, y, place)
            u, v = (j + 0.5) / n - 0.5, (i + 0.5) / n - 0.5
            place[0] += u * place[2] + v * place[3]
            place[1] += u * place[4] + v * place[5]
            level, rest, there = square(place, pinhole, pills, look, behind, chosen, count, 1.0 / n, s, scratch)
            mean += weight * level
            add_motion(scratch, there, weight, total, used)
            if light:
                add_light(scratch[0], scratch[2], there, rest, scratch[3], look, used.shape[0], weight, more)
    return mean, there


@njit(cache=True)
def soft_image(
    grid, pinhole, pills, boxes, look, behind, s, fine, block, light, image, H
):  # pragma: no cover - compiled
    """Render pills smoothly into `image`, and sum the information of the pixels in the upper triangle of H.

    Blocks of `block` pixels, a power of two, far from every outline and crease are represented by their middle, others
    are quartered; a pixel on an edge is cut into `fine` x `fine` squares. Rows of H: six for each link, then, if
    `light`, those of `add_light`. Pixels beyond 0..255 are cut by the sensor and say nothing.
    Twin: `soft_image.soft_image_numpy`.
    """
    height, width, links = grid.shape[0], grid.shape[1], boxes.shape[0]
    scratch = (
        np.zeros((links, FACTS)),
        np.zeros((links, 18)),
        np.zeros(links, np.int64),
        np.zeros((links, 3)),
        np.zeros((links, 3)),
        np.zeros((5, 3)),
    )
    chosen, used, total = np.zeros(links, np.int64), np.zeros(links, np.bool_), np.zeros(6 * links)
    more, place = np.zeros(29 + links), np.zeros(6)
    world = (grid, pinhole, pills, look, behind)
    near, left = ROOT + 4.0 * s + 0.5, np.zeros((64, 3), np.int64)
    for y0 in range(0, height, block):
        for x0 in range(0, width, block):
            count = chosen_pills(grid, x0, y0, block, boxes, near + 1.0, chosen)
            if count == 0:
                wide, tall = min(block, width - x0), min(block, height - y0)
                image[y0 : y0 + tall, x0 : x0 + wide] = behind
                if light:
                    H[6 * links + 28 + links, 6 * links + 28 + links] += wide * tall
                continue
            left[0, 0], left[0, 1], left[0, 2], waiting = x0, y0, block, 1
            while waiting > 0:
                waiting -= 1
                u, v, size = left[waiting, 0], left[waiting, 1], left[waiting, 2]
                wide, tall = min(size, width - u), min(size, height - v)
                if wide <= 0 or tall <= 0:
                    continue
                x, y, reach = u + 0.5 * (wide - 1), v + 0.5 * (tall - 1), near + 0.75 * (size - 1)
                place_at(grid, x, y, place)
                plain, level, n = is_plain(place, pinhole, pills, chosen, count, reach, scratch[5]), 0.0, 1
                if plain or size == 1:
                    n = 1 if plain else fine
                    level, there = cut_pixel(x, y, n, place, world, chosen, count, s, scratch, light, total, used, more)
                    plain = plain and not creased(scratch, there, reach)
                if not plain and size > 1:  # quarter it
                    half = size // 2
                    for i in range(4):
                        left[waiting, 0], left[waiting, 1] = u + half * (i % 2), v + half * (i // 2)
                        left[waiting, 2] = half
                        waiting += 1
                    continue
                if not plain and n < fine:
                    level, _ = cut_pixel(x, y, fine, place, world, chosen, count, s, scratch, light, total, used, more)
                image[v : v + tall, u : u + wide] = level
                if 0.0 <= level <= 255.0:
                    add_information(total, used, chosen, count, more, light, float(wide * tall), H)
