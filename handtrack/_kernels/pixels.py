"""Compiled loops over pixels of the visible surface: shading residuals and their Jacobian."""

import math

import numpy as np
from numba import njit

from .geometry import hit_pill


@njit(cache=True, inline="always")
def shading_slope(c, x, y, z, slope):  # pragma: no cover - compiled
    """Grey level of a normal and its derivative by that normal; twin: `appearance.shaded` and its finite difference."""
    px, py = np.empty(5), np.empty(5)
    px[0] = py[0] = 1.0
    for i in range(1, 5):
        px[i], py[i] = px[i - 1] * x, py[i - 1] * y
    level = 0.0
    slope[0] = slope[1] = slope[2] = 0.0
    column = 0
    for deep in range(2):
        factor = z if deep else 1.0
        for degree in range(5 - deep):
            for b in range(degree + 1):
                a = degree - b
                value = px[a] * py[b]
                level += c[column] * factor * value
                if a > 0:
                    slope[0] += c[column] * factor * a * px[a - 1] * py[b]
                if b > 0:
                    slope[1] += c[column] * factor * b * px[a] * py[b - 1]
                if deep:
                    slope[2] += c[column] * value
                column += 1
    lit = c[25] * x + c[26] * y + c[27] * z
    if lit > 0.0:
        level += lit
        for a in range(3):
            slope[a] += c[25 + a]
    return level


@njit(cache=True)
def pixel_rows(
    ray, link, level, noise, tree, view, shading, gain, r, J, normal, expected
):  # pragma: no cover - compiled
    """Residuals (level - expected) / noise of rays on their links, and Jacobian rows; twin: `pixels.pixel_rows_numpy`.

    A surface point stays on its ray while the link moves with velocity w(x) and turns by omega: it slides by
    dt = (n . w) / (n . d) along the ray, so its normal changes by omega x n + S (d dt - w), where S = P / radius is
    the curvature: P all tangents on a cap, the direction around the axis on the side.
    """
    frames, link_frame, base_in, tip_in, radii, moves, joint_frame, prismatic = tree
    R = view
    base, tip = np.empty((1, 3)), np.empty((1, 3))
    one = np.empty((1, 2))
    x, n, d, g, seen, slope = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    sg, y, turn, axis = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(link.shape[0]):
        k = link[i]
        f = link_frame[k]
        for a in range(3):
            base[0, a] = tip[0, a] = frames[f, a, 3]
            d[a] = ray[i, 3 + a]
            for b in range(3):
                base[0, a] += frames[f, a, b] * base_in[k, b]
                tip[0, a] += frames[f, a, b] * tip_in[k, b]
        one[0, 0], one[0, 1] = radii[k, 0], radii[k, 1]
        t, n[0], n[1], n[2] = hit_pill(ray[i, 0], ray[i, 1], ray[i, 2], d[0], d[1], d[2], base, tip, one, 0)
        for j in range(J.shape[1]):
            J[i, j] = 0.0
        r[i], expected[i] = 0.0, 0.0
        normal[i, 0] = normal[i, 1] = normal[i, 2] = 0.0
        if not t < math.inf:  # it slid off its link: says nothing
            continue
        length = along = 0.0
        for a in range(3):
            x[a] = ray[i, a] + t * d[a]
            axis[a] = tip[0, a] - base[0, a]
            length += axis[a] * axis[a]
        length = math.sqrt(length)
        for a in range(3):
            axis[a] /= length
            along += (x[a] - base[0, a]) * axis[a]
            seen[a] = 0.0
        for a in range(3):
            for b in range(3):
                seen[a] += R[a, b] * n[b]
        value = shading_slope(shading, seen[0], seen[1], seen[2], slope)
        expected[i] = gain[k] * value
        r[i] = (level[i] - expected[i]) / noise
        dn = dsg = 0.0
        for a in range(3):
            normal[i, a] = seen[a]
            g[a] = 0.0
            for b in range(3):
                g[a] += R[b, a] * slope[b]
            dn += d[a] * n[a]
        taper = (radii[k, 0] - radii[k, 1]) / length
        if radii[k, 0] * taper <= along <= length + radii[k, 1] * taper:
            # Around the axis: e = axis x n, normalised; the radius there is that of the touching sphere.
            e0, e1, e2 = (
                axis[1] * n[2] - axis[2] * n[1],
                axis[2] * n[0] - axis[0] * n[2],
                axis[0] * n[1] - axis[1] * n[0],
            )
            size = math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
            radius = (radii[k, 0] - taper * along) / (1.0 - taper * taper)
            ge = (g[0] * e0 + g[1] * e1 + g[2] * e2) / (size * size * radius)
            sg[0], sg[1], sg[2] = ge * e0, ge * e1, ge * e2
        else:
            radius = radii[k, 0] if along < 0.5 * length else radii[k, 1]
            gn = g[0] * n[0] + g[1] * n[1] + g[2] * n[2]
            for a in range(3):
                sg[a] = (g[a] - gn * n[a]) / radius
        for a in range(3):
            dsg += sg[a] * d[a]
        for a in range(3):
            y[a] = n[a] * dsg / dn - sg[a]
        turn[0] = n[1] * g[2] - n[2] * g[1]
        turn[1] = n[2] * g[0] - n[0] * g[2]
        turn[2] = n[0] * g[1] - n[1] * g[0]
        scale = -gain[k] / noise
        for j in range(J.shape[1]):
            if not moves[f, j]:
                continue
            h = joint_frame[j]
            zx, zy, zz = frames[h, 0, 2], frames[h, 1, 2], frames[h, 2, 2]
            if prismatic[h]:
                J[i, j] = scale * (zx * y[0] + zy * y[1] + zz * y[2])
                continue
            px, py, pz = x[0] - frames[h, 0, 3], x[1] - frames[h, 1, 3], x[2] - frames[h, 2, 3]
            J[i, j] = scale * (
                zx * (turn[0] + py * y[2] - pz * y[1])
                + zy * (turn[1] + pz * y[0] - px * y[2])
                + zz * (turn[2] + px * y[1] - py * y[0])
            )
