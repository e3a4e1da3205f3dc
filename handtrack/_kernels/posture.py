"""Compiled kinematics of a body whose joints turn about coordinate axes, for batches of postures."""

import math

import numpy as np
from numba import njit

# pi / 2 in three parts, each of 33 bits, so that whole multiples of the first two are exact
_TURN = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)


@njit(cache=True, error_model="numpy")
def sines(value, sine, cosine):  # pragma: no cover - compiled
    """Fill sines and cosines of angles below some 10^5, to rounding; one loop without branches, which vectorises.

    An angle less its nearest multiple k of pi / 2 lies within pi / 4, where Taylor's series to the 17th and 18th power
    are exact to rounding; k tells which of the two is which, and their signs. Twin: `np.sin` (and `np.cos`).
    """
    for j in range(value.size):
        k = math.floor(value[j] * (2.0 / math.pi) + 0.5)
        r = ((value[j] - k * _TURN[0]) - k * _TURN[1]) - k * _TURN[2]
        x = r * r
        s = 1.0 - x * (1.0 / 272.0)
        s = 1.0 - x * (1.0 / 210.0) * s
        s = 1.0 - x * (1.0 / 156.0) * s
        s = 1.0 - x * (1.0 / 110.0) * s
        s = 1.0 - x * (1.0 / 72.0) * s
        s = 1.0 - x * (1.0 / 42.0) * s
        s = 1.0 - x * (1.0 / 20.0) * s
        s = r * (1.0 - x * (1.0 / 6.0) * s)
        c = 1.0 - x * (1.0 / 306.0)
        c = 1.0 - x * (1.0 / 240.0) * c
        c = 1.0 - x * (1.0 / 182.0) * c
        c = 1.0 - x * (1.0 / 132.0) * c
        c = 1.0 - x * (1.0 / 90.0) * c
        c = 1.0 - x * (1.0 / 56.0) * c
        c = 1.0 - x * (1.0 / 30.0) * c
        c = 1.0 - x * (1.0 / 12.0) * c
        c = 1.0 - 0.5 * x * c
        half = k - 2.0 * math.floor(0.5 * k)  # 0 or 1: whether sine and cosine change places
        sign = 1.0 - (k - half - 4.0 * math.floor(0.25 * (k - half)))  # 1 or -1
        sine[j] = sign * (half * c + (1.0 - half) * s)
        cosine[j] = sign * ((1.0 - half) * c - half * s)


@njit(cache=True, error_model="numpy")
def chain_frames(parent, offset, first, axis, sign, q, frames):  # pragma: no cover - compiled
    """Fill the frames (n, s, 4, 4) of segments for joint values (n, j); twin: `body.posture.chain_frames_numpy`.

    A turn about a coordinate axis mixes two columns, half the work of a product of matrices.
    """
    sine, cosine = np.empty(axis.size), np.empty(axis.size)
    for b in range(q.shape[0]):
        sines(q[b], sine, cosine)
        for i in range(parent.size):
            f = frames[b, i]
            p = parent[i]
            x, y, z = offset[i, 0], offset[i, 1], offset[i, 2]
            if p < 0:
                for r in range(3):
                    for c in range(3):
                        f[r, c] = 1.0 if r == c else 0.0
                f[0, 3], f[1, 3], f[2, 3] = x, y, z
            else:
                g = frames[b, p]
                for r in range(3):
                    f[r, 0], f[r, 1], f[r, 2] = g[r, 0], g[r, 1], g[r, 2]
                    f[r, 3] = g[r, 3] + g[r, 0] * x + g[r, 1] * y + g[r, 2] * z
            f[3, 0], f[3, 1], f[3, 2], f[3, 3] = 0.0, 0.0, 0.0, 1.0
            for j in range(first[i], first[i + 1]):
                kind = axis[j]
                if kind >= 3:
                    for r in range(3):
                        f[r, 3] += f[r, kind - 3] * sign[j] * q[b, j]
                    continue
                s, c = sign[j] * sine[j], cosine[j]
                u = kind + 1 if kind < 2 else 0
                v = kind - 1 if kind > 0 else 2
                for r in range(3):
                    a, d = f[r, u], f[r, v]
                    f[r, u] = a * c + d * s
                    f[r, v] = d * c - a * s


@njit(cache=True, error_model="numpy")
def points_on(frames, segment, local, out):  # pragma: no cover - compiled
    """Fill (n, m, 3) with points fixed to segments; twin: `body.posture.points_on_numpy`."""
    for b in range(frames.shape[0]):
        for k in range(segment.size):
            f = frames[b, segment[k]]
            for r in range(3):
                out[b, k, r] = f[r, 3] + f[r, 0] * local[k, 0] + f[r, 1] * local[k, 1] + f[r, 2] * local[k, 2]


@njit(cache=True, error_model="numpy")
def segment_misfits(frames, end, z, place, turn, out):  # pragma: no cover - compiled
    """Fill (n, s) with squared differences of segments' ends and axes from measured ones (s, 12).

    `place` and `turn` are what one metre and one unit of an axis weigh; twin: `body.posture_filter.misfits_numpy`.
    """
    for b in range(frames.shape[0]):
        for i in range(frames.shape[1]):
            f = frames[b, i]
            total = 0.0
            for r in range(3):
                at = f[r, 3] + f[r, 0] * end[i, 0] + f[r, 1] * end[i, 1] + f[r, 2] * end[i, 2]
                total += (at * place - z[i, r]) ** 2
                for c in range(3):
                    total += (f[r, c] * turn - z[i, 3 + 3 * r + c]) ** 2
            out[b, i] = total
