"""Compiled sums over the edges of a frame: how they scatter, and how they would move with the shape."""

import math

import numpy as np
from numba import njit

from .residuals import touch


@njit(cache=True, error_model="numpy")
def scatter_moments(r, J, w, member, groups, gain):  # pragma: no cover - compiled
    """Sums of squares within and between groups, and their expectations; twin: `scatter.moments_numpy`.

    Returns moments (2,) and response (2, 2), before frames are blended.
    """
    n, k = J.shape
    total, mean_r, of_gain = np.zeros(groups), np.zeros(groups), np.zeros((k, groups))
    mean_J, means, left = np.zeros((groups, k)), np.zeros((groups, groups)), np.empty(groups)
    for i in range(n):
        g = member[i]
        total[g] += w[i]
        mean_r[g] += w[i] * r[i]
        for a in range(k):
            mean_J[g, a] += w[i] * J[i, a]
            of_gain[a, g] += gain[a, i]
    for g in range(groups):
        mean_r[g] /= total[g]
        for a in range(k):
            mean_J[g, a] /= total[g]
    own = taken = square = within = between = grouped = 0.0
    for i in range(n):
        g = member[i]
        own += w[i] * (r[i] - mean_r[g]) ** 2
        left[:] = 0.0  # what a common offset of each group leaves in this residual
        left[g] = 1.0
        for a in range(k):
            size = J[i, a]
            if size != 0.0:
                taken += size * gain[a, i]
                for c in range(groups):
                    left[c] -= size * of_gain[a, c]
        for c in range(groups):
            means[g, c] += w[i] / total[g] * left[c]
            within += w[i] * left[c] * left[c]
    for g in range(groups):
        square += total[g] * mean_r[g] ** 2
        for c in range(groups):
            grouped += total[g] * means[g, c] ** 2
    seen = np.empty(n)
    for g in range(groups):  # what the mean of a group sees of each edge's error
        for i in range(n):
            seen[i] = w[i] / total[g] if member[i] == g else 0.0
        for a in range(k):
            size = mean_J[g, a]
            if size != 0.0:
                for i in range(n):
                    seen[i] -= size * gain[a, i]
        for i in range(n):
            between += total[g] * seen[i] * seen[i] / w[i]
    # What the solve takes out of the sum of squares, for a gain that is not that of plain least squares.
    weighted = J.copy()
    for i in range(n):
        weighted[i] *= w[i]
    absorbed = (weighted.T @ J * ((gain / w) @ gain.T)).sum() - 2.0 * taken
    response = np.array([[max(n + absorbed - between, 1.0), within - grouped], [between, grouped]])
    return np.array([own, square]), response


@njit(cache=True, error_model="numpy")
def shape_columns(ray, slope, link, sigma, ends, radius, share, sight, H):  # pragma: no cover - compiled
    """Derivatives of outline residuals by length, radius and sideways offset of the links, in three blocks of H.

    `ends` holds base and axis of every link. The first two blocks end in a column that all links have in common, each
    part with half of the variance. Twin: `shape_error.shape_jacobian_numpy`.
    """
    links, half = ends.shape[0], math.sqrt(0.5)
    across = np.zeros((links, 3))
    for k in range(links):
        x, y, z = ends[k, 3], ends[k, 4], ends[k, 5]
        across[k, 0] = y * sight[2] - z * sight[1]
        across[k, 1] = z * sight[0] - x * sight[2]
        across[k, 2] = x * sight[1] - y * sight[0]
        size = max(math.sqrt(across[k, 0] ** 2 + across[k, 1] ** 2 + across[k, 2] ** 2), 1e-9)
        for a in range(3):
            across[k, a] /= size
    H[:] = 0.0
    for i in range(link.shape[0]):
        k = link[i]
        ox, oy, oz, dx, dy, dz = ray[i, 0], ray[i, 1], ray[i, 2], ray[i, 3], ray[i, 4], ray[i, 5]
        nx, ny, nz, s, _, scale = touch(ox, oy, oz, dx, dy, dz, i, slope, k, sigma[i], ends, radius)
        common = 0.0
        for j in range(links):
            moved = nx * ends[j, 3] + ny * ends[j, 4] + nz * ends[j, 5]
            length = -scale * moved * (s if j == k else share[k, j])
            H[i, j] = half * length
            common += length
        size = -scale * (radius[k, 0] + s * (radius[k, 1] - radius[k, 0]))
        H[i, links], H[i, 2 * links + 1] = half * common, half * size
        H[i, links + 1 + k] = half * size
        towards = nx * across[k, 0] + ny * across[k, 1] + nz * across[k, 2]
        H[i, 2 * links + 2 + k] = size * towards
