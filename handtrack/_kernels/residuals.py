"""Compiled loops over edge points: residuals against the outline, and their Jacobian."""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def outline_rows(
    ray, slope, link, sigma, frames, link_frame, link_base, link_tip, radius, moves, joint_frame, prismatic, r, J
):  # pragma: no cover - compiled
    """Clearance residuals of edge rays and their Jacobian rows; twin: `residuals.outline_residuals_numpy`."""
    d, m, axis, base, n, p = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(link.shape[0]):
        k = link[i]
        f = link_frame[k]
        for a in range(3):
            d[a] = ray[i, 3 + a]
        norm = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        md = ad = 0.0
        for a in range(3):
            base[a], axis[a] = frames[f, a, 3], 0.0
            for b in range(3):
                base[a] += frames[f, a, b] * link_base[k, b]
                axis[a] += frames[f, a, b] * (link_tip[k, b] - link_base[k, b])
            m[a] = base[a] - ray[i, a]
            md += m[a] * d[a] / norm
            ad += axis[a] * d[a] / norm
        size = cross = 0.0
        for a in range(3):
            ma, aa = m[a] - md * d[a] / norm, axis[a] - ad * d[a] / norm
            size += aa * aa
            cross += ma * aa
        r0, grow = radius[k, 0], radius[k, 1] - radius[k, 0]
        if size > grow * grow:
            s0 = -cross / size
            h2 = 0.0
            for a in range(3):
                across = (m[a] - md * d[a] / norm) + s0 * (axis[a] - ad * d[a] / norm)
                h2 += across * across
            s = min(max(s0 + grow * math.sqrt(h2) / math.sqrt(size * (size - grow * grow)), 0.0), 1.0)
        else:
            s = 1.0 if grow > 0 else 0.0
        gap = depth = 0.0
        for a in range(3):
            n[a] = -((m[a] - md * d[a] / norm) + s * (axis[a] - ad * d[a] / norm))
            gap += n[a] * n[a]
            depth += (m[a] + s * axis[a]) * d[a]
            p[a] = base[a] + s * axis[a]
        gap, depth = math.sqrt(gap), depth / (norm * norm)
        per_pixel = 0.0
        for a in range(3):
            n[a] = n[a] / gap if gap > 0.0 else 0.0
            per_pixel += n[a] * (slope[i, a] + depth * slope[i, 3 + a])
        scale = 1.0 / (max(abs(per_pixel), 1e-9) * sigma[i])
        r[i] = (gap - r0 - grow * s) * scale
        for j in range(J.shape[1]):
            J[i, j] = 0.0
            if not moves[f, j]:
                continue
            g = joint_frame[j]
            zx, zy, zz = frames[g, 0, 2], frames[g, 1, 2], frames[g, 2, 2]
            if prismatic[g]:
                J[i, j] = -scale * (n[0] * zx + n[1] * zy + n[2] * zz)
                continue
            px, py, pz = p[0] - frames[g, 0, 3], p[1] - frames[g, 1, 3], p[2] - frames[g, 2, 3]
            J[i, j] = -scale * (n[0] * (zy * pz - zz * py) + n[1] * (zz * px - zx * pz) + n[2] * (zx * py - zy * px))


@njit(cache=True)
def whiten_rows(r, J, v, share, group, s):  # pragma: no cover - compiled
    """Take each group's share of its weighted mean off residuals and Jacobian, in place; twin: `scatter.Whitener`."""
    n, k = J.shape
    mean_r = np.zeros(share.shape[0])
    mean_J = np.zeros((share.shape[0], k))
    for i in range(n):
        g = group[i]
        mean_r[g] += v[i] * r[i]
        for j in range(k):
            mean_J[g, j] += v[i] * J[i, j]
    for i in range(n):
        g = group[i]
        off = v[i] * share[g]
        r[i] = (r[i] - off * mean_r[g]) / s
        for j in range(k):
            J[i, j] = (J[i, j] - off * mean_J[g, j]) / s


@njit(cache=True)
def soften_rows(r, J, scale):  # pragma: no cover - compiled
    """Cauchy's loss as plain least squares, in place; twin: `residuals.Robust`."""
    c = 2.385
    for i in range(r.shape[0]):
        z = abs(r[i]) / (c * scale)
        slope = 1.0
        if z > 1e-6:
            size = math.sqrt(math.log1p(z * z))
            slope = z / ((1.0 + z * z) * size)
            r[i] = math.copysign(c * size, r[i])
        else:
            r[i] = r[i] / scale
        for j in range(J.shape[1]):
            J[i, j] *= slope / scale
