"""Compiled loops over WSSD curves: the curves themselves, and the sub-sample shift at their valleys."""

import math

import numpy as np
from numba import njit


@njit(cache=True, inline="always")
def spline_overlap(d):  # pragma: no cover - compiled
    """Cubic B-spline: correlation of two linear interpolations of white noise, d pixels apart."""
    d = abs(d)
    if d < 1.0:
        return 2.0 / 3.0 - d * d * (1.0 - 0.5 * d)
    if d < 2.0:
        return (2.0 - d) ** 3 / 6.0
    return 0.0


@njit(cache=True)
def invert(A, out):  # pragma: no cover - compiled
    """Inverse of a small positive definite matrix by Gauss-Jordan elimination, A is used up; twin: `np.linalg.inv`."""
    n = A.shape[0]
    for i in range(n):
        for j in range(n):
            out[i, j] = 1.0 if i == j else 0.0
    for i in range(n):
        pivot = 1.0 / A[i, i]
        for j in range(n):
            A[i, j] *= pivot
            out[i, j] *= pivot
        for k in range(n):
            if k != i:
                factor = A[k, i]
                for j in range(n):
                    A[k, j] -= factor * A[i, j]
                    out[k, j] -= factor * out[i, j]


@njit(cache=True)
def search_valleys(
    image, inside, template, visible, shift, reach, predicted, scale2, samples, best, lowest, rise, used
):  # pragma: no cover - compiled
    """Shift of each profile's weighed WSSD minimum within reach; twin: `edges.wssd.search_numpy`.

    The cost of shift k is its WSSD over `scale2`, counted for at most `samples` samples, plus its square over the
    predicted variance.
    """
    m = template.shape[1]
    for i in range(image.shape[0]):
        wanted, top, low = 0, -math.inf, math.inf
        for j in range(m):
            if visible[i, j]:
                wanted += 1
                top, low = max(top, template[i, j]), min(low, template[i, j])
        used[i], rise[i] = wanted, top - low if top > low else 0.0
        best[i], lowest[i] = 0, math.inf
        weight = min(max(wanted, 1), samples) / scale2
        for k in range(shift.shape[0]):
            if abs(shift[k]) > reach[i] + 1e-9:
                continue
            total, count = 0.0, 0
            for j in range(m):
                if visible[i, j] and inside[i, j + k]:
                    d = image[i, j + k] - template[i, j]
                    total += d * d
                    count += 1
            if 2 * count < wanted or count == 0:
                continue
            cost = total / count * weight + (shift[k] / predicted[i]) ** 2
            if cost < lowest[i]:
                best[i], lowest[i] = k, cost


@njit(cache=True)
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


@njit(cache=True)
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
    m, n = template.shape[1], 5
    design, r, weight = np.zeros((n, m)), np.zeros(m), np.zeros(m)
    normal, inverse, right = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    solution, row = np.zeros(n), np.zeros(n)
    for i in range(image.shape[0]):
        used = 0
        for j in range(m):
            seen = visible[i, j] and inside[i, j + best[i]]
            low, high = max(j - 1, 0), min(j + 1, m - 1)
            cover = parts[i, 0, j]
            design[0, j] = -(template[i, high] - template[i, low]) / ((high - low) * step) if seen else 0.0
            design[1, j] = cover if seen else 0.0
            design[2, j] = parts[i, 1, j] if seen else 0.0
            design[3, j] = cover * (j - 0.5 * m) / m if seen else 0.0
            design[4, j] = 1.0 - cover if seen else 0.0
            r[j] = image[i, j + best[i]] - template[i, j] if seen else 0.0
            used += seen
        gg = 0.0
        for j in range(m):
            gg += design[0, j] ** 2
        if gg <= 1e-9:
            shift[i], variance[i], misfit[i] = 0.0, math.inf, math.inf
            continue
        for a in range(n):
            right[a] = 0.0
            for j in range(m):
                right[a] += design[a, j] * r[j]
            for b in range(a, n):
                total = 0.0
                for j in range(m):
                    total += design[a, j] * design[b, j]
                normal[a, b] = normal[b, a] = total
            normal[a, a] += ridge[i, a] + 1e-9 * gg
        invert(normal, inverse)
        for a in range(n):
            solution[a] = 0.0
            row[a] = inverse[0, a]
            for b in range(n):
                solution[a] += inverse[a, b] * right[b]
        left = 0.0
        for j in range(m):
            weight[j] = 0.0
            fitted = 0.0
            for a in range(n):
                weight[j] += row[a] * design[a, j]
                fitted += solution[a] * design[a, j]
            if design[1, j] + design[4, j] > 0.0:
                left += (r[j] - fitted) ** 2
        total = 0.0
        for lag in range(-lags, lags + 1):
            rho = spline_overlap(lag * step * direction[i, 0]) * spline_overlap(lag * step * direction[i, 1])
            if rho == 0.0:
                continue
            for j in range(max(0, -lag), min(m, m - lag)):
                total += rho * weight[j] * weight[j + lag]
        for a in range(1, n):  # what the prior lets the grey levels be wrong by
            total += row[a] * row[a] * ridge[i, a]
        shift[i] = solution[0]
        variance[i] = total
        misfit[i] = left / max(used - 3, 1) * (9.0 / 4.0)
