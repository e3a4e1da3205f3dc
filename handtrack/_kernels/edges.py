"""Compiled loops over WSSD curves: the curves themselves, and the sub-sample shift at their valleys."""

import math

import numpy as np
from numba import njit


@njit(cache=True, inline="always", error_model="numpy")
def spline_overlap(d):  # pragma: no cover - compiled
    """Cubic B-spline: correlation of two linear interpolations of white noise, d pixels apart."""
    d = abs(d)
    if d < 1.0:
        return 2.0 / 3.0 - d * d * (1.0 - 0.5 * d)
    if d < 2.0:
        return (2.0 - d) ** 3 / 6.0
    return 0.0


@njit(cache=True, error_model="numpy")
def search_valleys(
    image, inside, template, visible, shift, reach, predicted, scale2, samples, best, lowest, rise, used
):  # pragma: no cover - compiled
    """Shift of each profile's weighed WSSD minimum within reach; twin: `edges.wssd.search_numpy`.

    The cost of shift k is its WSSD over `scale2`, counted for at most `samples` samples, plus its square over the
    predicted variance. Shifts are the inner loop: their sums are independent of each other.
    """
    m, shifts = template.shape[1], shift.shape[0]
    total, count = np.empty(shifts), np.empty(shifts, np.int64)
    for i in range(image.shape[0]):
        wanted, top, low = 0, -math.inf, math.inf
        for j in range(m):
            if visible[i, j]:
                wanted += 1
                top, low = max(top, template[i, j]), min(low, template[i, j])
        used[i], rise[i] = wanted, top - low if top > low else 0.0
        best[i], lowest[i] = 0, math.inf
        if wanted == 0:
            continue
        first, last = 0, shifts
        while first < last and abs(shift[first]) > reach[i] + 1e-9:
            first += 1
        while last > first and abs(shift[last - 1]) > reach[i] + 1e-9:
            last -= 1
        whole = True
        for j in range(first, last + m - 1):
            whole = whole and inside[i, j]
        for k in range(first, last):
            total[k], count[k] = 0.0, wanted if whole else 0
        for j in range(m):
            if not visible[i, j]:
                continue
            level = template[i, j]
            if whole:
                for k in range(first, last):
                    d = image[i, j + k] - level
                    total[k] += d * d
                continue
            for k in range(first, last):
                if inside[i, j + k]:
                    total[k] += (image[i, j + k] - level) ** 2
                    count[k] += 1
        weight = min(wanted, samples) / scale2
        for k in range(first, last):
            if 2 * count[k] < wanted or count[k] == 0:
                continue
            cost = total[k] / count[k] * weight + (shift[k] / predicted[i]) ** 2
            if cost < lowest[i]:
                best[i], lowest[i] = k, cost


@njit(cache=True, error_model="numpy")
def wssd(image, inside, template, visible, curves, counts):  # pragma: no cover - compiled
    """Sums of squared differences of windowed templates, moved along longer profiles; twin: `edges.wssd.curves_numpy`.

    curves[i, k] is the mean over the visible samples j of (image[i, j + k] - template[i, j])^2, inf where fewer than
    half of them are inside the image.
    """
    for i in range(image.shape[0]):
        wanted = 0
        for j in range(template.shape[1]):
            wanted += visible[i, j]
        counts[i] = wanted
        for k in range(curves.shape[1]):
            total, used = 0.0, 0
            for j in range(template.shape[1]):
                if visible[i, j] and inside[i, j + k]:
                    d = image[i, j + k] - template[i, j]
                    total += d * d
                    used += 1
            curves[i, k] = total / used if 2 * used >= wanted and used > 0 else math.inf


@njit(cache=True, inline="always", error_model="numpy")
def dot_rows(rows, a, b):  # pragma: no cover - compiled
    """Scalar product of two rows, whose length is a multiple of four, in four sums that do not wait for each other.

    Part of `refine_shift`; twin: `np.dot`.
    """
    s0 = s1 = s2 = s3 = 0.0
    for j in range(0, rows.shape[1], 4):
        s0 += rows[a, j] * rows[b, j]
        s1 += rows[a, j + 1] * rows[b, j + 1]
        s2 += rows[a, j + 2] * rows[b, j + 2]
        s3 += rows[a, j + 3] * rows[b, j + 3]
    return (s0 + s1) + (s2 + s3)


@njit(cache=True, error_model="numpy")
def solve_five(normal, x, row):  # pragma: no cover - compiled
    """Solve a (5, 5) system for x, given the right side in it, and find the inverse's first row.

    Cholesky's factor takes the place of the lower triangle. Part of `refine_shift`; twin: `np.linalg.solve`.
    """
    for i in range(5):
        for j in range(i):
            total = normal[i, j]
            for k in range(j):
                total -= normal[i, k] * normal[j, k]
            normal[i, j] = total * normal[j, j]
        total = normal[i, i]
        for k in range(i):
            total -= normal[i, k] * normal[i, k]
        normal[i, i] = 1.0 / math.sqrt(total)
    for i in range(5):
        at, one = x[i], 1.0 if i == 0 else 0.0
        for k in range(i):
            at -= normal[i, k] * x[k]
            one -= normal[i, k] * row[k]
        x[i], row[i] = at * normal[i, i], one * normal[i, i]
    for i in range(4, -1, -1):
        at, one = x[i], row[i]
        for k in range(i + 1, 5):
            at -= normal[k, i] * x[k]
            one -= normal[k, i] * row[k]
        x[i], row[i] = at * normal[i, i], one * normal[i, i]


@njit(cache=True, error_model="numpy")
def fill_design(i, image, inside, template, parts, visible, shift, step, design):  # pragma: no cover - compiled
    """Columns of the shift's linear model, residual in row 5, zero where unseen; returns the number seen.

    Part of `refine_shift`; twin: `edges.wssd.refine_numpy`.
    """
    m, used = template.shape[1], 0
    for j in range(m):
        low, high = max(j - 1, 0), min(j + 1, m - 1)
        seen = 1.0 if visible[i, j] and inside[i, j + shift] else 0.0
        cover = parts[i, 0, j]
        design[0, j] = -seen * (template[i, high] - template[i, low]) / ((high - low) * step)
        design[1, j], design[2, j] = seen * cover, seen * parts[i, 1, j]
        design[3, j], design[4, j] = seen * cover * (j - 0.5 * m) / m, seen * (1.0 - cover)
        design[5, j] = seen * (image[i, j + shift] - template[i, j])
        used += int(seen)
    return used


@njit(cache=True, error_model="numpy")
def spread_noise(weight, step, nx, ny, lags, spread):  # pragma: no cover - compiled
    """Variance of a weighted sum of samples whose noise the interpolation has correlated; `lags` zeros end `weight`.

    Part of `refine_shift`; twin: `edges.wssd.refine_numpy`.
    """
    spread[:] = 0.0
    for lag in range(lags + 1):
        rho = spline_overlap(lag * step * nx) * spline_overlap(lag * step * ny)
        if rho == 0.0:
            continue
        rho = rho if lag == 0 else 2.0 * rho
        for j in range(spread.shape[0]):
            spread[j] += rho * weight[j + lag]
    total = 0.0
    for j in range(spread.shape[0]):
        total += spread[j] * weight[j]
    return total


@njit(cache=True, error_model="numpy")
def refine_shift(
    image, inside, template, parts, visible, best, step, direction, ridge, shift, variance, misfit
):  # pragma: no cover - compiled
    """Sub-sample shift at a valley by one Gauss-Newton step, its variance for unit pixel noise, and the misfit left.

    Four unknowns beside the shift make the template's grey levels forgiving: level and facing term of the finger, its
    gradient, and the level beyond the edge, each with the ridge of a prior. Interpolated noise is correlated by
    `spline_overlap`; misfit is the mean square left over the 4/9 of the noise variance that bilinear interpolation
    keeps on average. Twin: `edges.wssd.refine_numpy`.
    """
    lags = int(math.ceil(2.0 * math.sqrt(2.0) / step))
    m = template.shape[1]
    wide = (m + 3) // 4 * 4
    design, normal, x, row = np.zeros((6, wide)), np.zeros((5, 5)), np.zeros(5), np.zeros(5)
    weight, spread, off = np.zeros(wide + lags), np.zeros(wide), np.zeros(wide)
    for i in range(image.shape[0]):
        shift[i], variance[i], misfit[i] = 0.0, math.inf, math.inf
        used = fill_design(i, image, inside, template, parts, visible, best[i], step, design)
        gg = dot_rows(design, 0, 0)
        if gg <= 1e-9:
            continue
        for a in range(5):
            x[a] = dot_rows(design, a, 5)
            for b in range(a + 1):
                normal[a, b] = dot_rows(design, a, b)
            normal[a, a] += ridge[i, a] + 1e-9 * gg
        solve_five(normal, x, row)
        for j in range(wide):
            weight[j] = (
                row[0] * design[0, j]
                + row[1] * design[1, j]
                + row[2] * design[2, j]
                + row[3] * design[3, j]
                + row[4] * design[4, j]
            )
        for j in range(wide):
            off[j] = design[5, j] - (
                x[0] * design[0, j]
                + x[1] * design[1, j]
                + x[2] * design[2, j]
                + x[3] * design[3, j]
                + x[4] * design[4, j]
            )
        left = 0.0
        for j in range(wide):
            left += off[j] * off[j]
        total = spread_noise(weight, step, direction[i, 0], direction[i, 1], lags, spread)
        for a in range(1, 5):  # what the prior lets the grey levels be wrong by
            total += row[a] * row[a] * ridge[i, a]
        shift[i], variance[i], misfit[i] = x[0], total, left / max(used - 3, 1) * (9.0 / 4.0)


@njit(cache=True, error_model="numpy")
def find_edges(
    image,
    inside,
    templates,
    shift,
    direction,
    reach,
    predicted,
    noise,
    spread,
    shape,
    limits,
    offset,
    sigma,
    reason,
    misfit,
):  # pragma: no cover - compiled
    """Offset, sigma, reason and misfit of each profile's edge; twin: `edges.wssd.find_edges_numpy`.

    Searched by `search_valleys`, refined by `refine_shift`; reasons are numbered as in `edges.points`. `templates`
    holds values, parts, windows and states; `limits` the numbers that `edges.wssd` explains.
    """
    template, parts, visible, state = templates
    samples, forgiven, floor, least, raw_most, misfit_most = limits
    best = np.empty(template.shape[0], np.int64)
    n, step = template.shape[0], shift[1] - shift[0] if shift.shape[0] > 1 else 1.0
    lowest, rise, used = np.empty(n), np.empty(n), np.empty(n, np.int64)
    fine, variance, left, ridge = np.empty(n), np.empty(n), np.empty(n), np.empty((n, 5))
    scale2 = max(spread, noise) ** 2
    search_valleys(image, inside, template, visible, shift, reach, predicted, scale2, samples, best, lowest, rise, used)
    for i in range(n):
        for a in range(5):
            ridge[i, a] = (noise / max(forgiven * rise[i], noise)) ** 2 * shape[a]
    refine_shift(image, inside, template, parts, visible, best, step, direction, ridge, fine, variance, left)
    for i in range(n):
        coarse = shift[best[i]]
        misfit[i] = left[i] / noise**2
        sigma[i] = math.sqrt(variance[i] * noise**2 * max(1.0, misfit[i] / 4.0) + floor * floor)
        raw = (lowest[i] - (coarse / predicted[i]) ** 2) * scale2 / min(max(used[i], 1), samples)
        bound = rise[i] ** 2
        if state[i] == 1 or (state[i] == 0 and used[i] < least):
            reason[i] = 1
        elif state[i] != 0:
            reason[i] = 2
        elif not math.isfinite(raw):
            reason[i] = 3
        elif not sigma[i] < 1.5 or rise[i] < 4.0 * noise:
            reason[i] = 4
        elif abs(coarse) > reach[i] - 0.5 * step:
            reason[i] = 5
        elif left[i] > misfit_most * bound + 9.0 * noise**2 or raw > raw_most * bound + 9.0 * noise**2:
            reason[i] = 6
        else:
            reason[i], offset[i] = 0, coarse + min(max(fine[i], -step), step)
            continue
        offset[i], sigma[i] = 0.0, math.inf
