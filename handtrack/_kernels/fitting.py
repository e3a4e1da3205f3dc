"""Compiled Levenberg-Marquardt for the tracker's inner loop: robust, whitened outline residuals with a prior."""

import math

import numpy as np
from numba import njit

from .geometry import forward
from .residuals import outline_rows, soften_rows, whiten_rows


@njit(cache=True, error_model="numpy")
def cholesky_solve(A, g, active, x):  # pragma: no cover - compiled
    """Solve A x = -g over the active variables, 0 for the others; False if A is not positive definite there."""
    k = g.shape[0]
    L = np.zeros((k, k))
    for i in range(k):
        x[i] = 0.0
        if not active[i]:
            continue
        for j in range(i + 1):
            if not active[j]:
                continue
            total = A[i, j]
            for m in range(j):
                total -= L[i, m] * L[j, m]
            if i == j:
                if total <= 0.0:
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    for i in range(k):
        if active[i]:
            total = -g[i]
            for m in range(i):
                total -= L[i, m] * x[m]
            x[i] = total / L[i, i]
    for i in range(k - 1, -1, -1):
        if active[i]:
            total = x[i]
            for m in range(i + 1, k):
                total -= L[m, i] * x[m]
            x[i] = total / L[i, i]
    return True


@njit(cache=True, error_model="numpy")
def whitened_rows(u, edges, tree, coupling, plain, white):  # pragma: no cover - compiled
    """Whitened residuals and Jacobian at u; twin: `scatter.Whitened`."""
    ray, slope, link, sigma = edges
    parent, prefix, joint, prismatic, link_frame, link_base, link_tip, radius, moves, joint_frame = tree
    v, share, group, s = white
    q = coupling[0] @ u + coupling[1]
    frames = forward(parent, prefix, joint, prismatic, q.reshape(1, -1))[0]
    r, J_all = np.empty(link.shape[0]), np.empty((link.shape[0], q.shape[0]))
    outline_rows(
        ray,
        slope,
        link,
        sigma,
        frames,
        link_frame,
        link_base,
        link_tip,
        radius,
        moves,
        joint_frame,
        prismatic,
        r,
        J_all,
    )
    J = J_all if plain else J_all @ coupling[0]
    whiten_rows(r, J, v, share, group, s)
    return r, J


@njit(cache=True, error_model="numpy")
def normal_equations(u, edges, tree, coupling, plain, white, spread, mean, prior, A, g):  # pragma: no cover - compiled
    """Cost, gradient g, Gauss-Newton matrix A at u; twin: `residuals.WithPrior` of `Robust` of `scatter.Whitened`."""
    r, J = whitened_rows(u, edges, tree, coupling, plain, white)
    n, k = J.shape
    soften_rows(r, J, spread)
    cost = 0.0
    for a in range(k):
        g[a] = 0.0
        for b in range(k):
            A[a, b] = 0.0
    for i in range(n):
        cost += 0.5 * r[i] * r[i]
        for a in range(k):
            size = J[i, a]
            if size != 0.0:  # few joints move a link
                g[a] += size * r[i]
                for b in range(a + 1):
                    A[a, b] += size * J[i, b]
    for a in range(k):
        pull = 0.0
        for b in range(k):
            pull += prior[a, b] * (u[b] - mean[b])
        cost += 0.5 * pull * (u[a] - mean[a])
        g[a] += pull
        for b in range(a + 1):
            A[a, b] += prior[a, b]
    for a in range(k):
        for b in range(a):
            A[b, a] = A[a, b]
    return cost


@njit(cache=True, error_model="numpy")
def fit_outline(
    u0, edges, tree, coupling, plain, white, spread, mean, root, low, high, most, tolerance
):  # pragma: no cover - compiled
    """Minimise the robust cost from u0 within bounds: (u, steps); twin: `solve.solve` on the same residuals."""
    k, prior = u0.shape[0], root.T @ root
    u = np.minimum(np.maximum(u0, low), high)
    A, g, A2, g2 = np.empty((k, k)), np.empty(k), np.empty((k, k)), np.empty(k)
    damped, h, active = np.empty((k, k)), np.empty(k), np.empty(k, np.bool_)
    cost = normal_equations(u, edges, tree, coupling, plain, white, spread, mean, prior, A, g)
    mu, grow = 1e-4, 2.0
    for step in range(most):
        for a in range(k):
            active[a] = not ((u[a] <= low[a] and g[a] > 0.0) or (u[a] >= high[a] and g[a] < 0.0))
            for b in range(k):
                damped[a, b] = A[a, b]
            damped[a, a] += mu * A[a, a]
        if not cholesky_solve(damped, g, active, h):
            mu, grow = max(mu, 1e-8) * grow, 2.0 * grow
            continue
        trial = np.minimum(np.maximum(u + h, low), high)
        predicted, largest = 0.0, 0.0
        for a in range(k):
            h[a] = trial[a] - u[a]
            largest = max(largest, abs(h[a]))
        for a in range(k):
            predicted -= h[a] * g[a]
            for b in range(k):
                predicted -= 0.5 * h[a] * A[a, b] * h[b]
        if largest < tolerance:
            return trial, step
        following = normal_equations(trial, edges, tree, coupling, plain, white, spread, mean, prior, A2, g2)
        gain = (cost - following) / predicted if predicted > 0.0 else -1.0
        if gain > 0.0:
            u, cost = trial, following
            A[:, :], g[:] = A2, g2
            mu, grow = mu * max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3), 2.0
        else:
            mu, grow = mu * grow, 2.0 * grow
    return u, most


@njit(cache=True, error_model="numpy")
def robust_scale(r):  # pragma: no cover - compiled
    """Median size of whitened residuals as a standard deviation, at least 1; twin: `robust.median`."""
    middle = r.shape[0] // 2
    return max(1.0, 1.4826 * np.partition(np.abs(r), middle)[middle])


@njit(cache=True, error_model="numpy")
def fit_frame(
    u, edges, tree, coupling, plain, white, mean, root, low, high, most, tolerance, rescale
):  # pragma: no cover - compiled
    """A whole fit: pose, whitened residuals, Jacobian, Cauchy weights, scale, information; twin: `fit.fit_numpy`."""
    spread = robust_scale(whitened_rows(u, edges, tree, coupling, plain, white)[0])
    while True:
        u, _ = fit_outline(u, edges, tree, coupling, plain, white, spread, mean, root, low, high, most, tolerance)
        r, J = whitened_rows(u, edges, tree, coupling, plain, white)
        before, spread = spread, robust_scale(r)
        if not rescale or before < 1.3 * spread:
            break
        rescale = False
    k = u.shape[0]
    weight, information = np.empty(r.shape[0]), np.zeros((k, k))
    for i in range(r.shape[0]):
        weight[i] = 1.0 / (1.0 + (r[i] / spread / 2.385) ** 2)
        for a in range(k):
            size = J[i, a] * weight[i] / spread**2
            if size != 0.0:
                for b in range(k):
                    information[a, b] += size * J[i, b]
    return u, r, J, weight, spread, information
