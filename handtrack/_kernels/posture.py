"""Compiled kinematics of a body whose joints turn about coordinate axes, for batches of postures."""

import math

from numba import njit


@njit(cache=True, error_model="numpy")
def chain_frames(parent, offset, first, axis, sign, q, frames):  # pragma: no cover - compiled
    """Fill the frames (n, s, 4, 4) of segments for joint values (n, j); twin: `body.posture.chain_frames_numpy`.

    A turn about a coordinate axis mixes two columns, half the work of a product of matrices.
    """
    for b in range(q.shape[0]):
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
                value = sign[j] * q[b, j]
                kind = axis[j]
                if kind >= 3:
                    for r in range(3):
                        f[r, 3] += f[r, kind - 3] * value
                    continue
                s, c = math.sin(value), math.cos(value)
                u, v = (kind + 1) % 3, (kind + 2) % 3
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
