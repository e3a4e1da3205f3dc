"""Compiled search for links that may be folded to the other side of the image plane."""

import math

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def line_of_sight(base, end, ortho, sight):  # pragma: no cover - compiled
    """Unit vector from the camera to the middle of an axis; part of `screen_folds`, twin: `folds.screen_numpy`."""
    sight[0], sight[1], sight[2] = 0.0, 0.0, 1.0
    if not ortho:
        for a in range(3):
            sight[a] = 0.5 * (base[a] + end[a])
        size = max(math.sqrt(sight[0] ** 2 + sight[1] ** 2 + sight[2] ** 2), 1e-12)
        for a in range(3):
            sight[a] /= size


@njit(cache=True, error_model="numpy")
def turning_rows(k, axis, sight, z, moves, coupling, deeper, sideways):  # pragma: no cover - compiled
    """Derivative by the free joints of a link's angle with the image plane, and of its direction in that plane.

    A joint with axis z turns the vector a by `z x a`, so `a . s` by `z . (a x s)`. Part of `screen_folds`; twin:
    `folds.screen_numpy`.
    """
    flat, across = np.empty(3), np.empty(3)
    flat[0] = axis[1] * sight[2] - axis[2] * sight[1]
    flat[1] = axis[2] * sight[0] - axis[0] * sight[2]
    flat[2] = axis[0] * sight[1] - axis[1] * sight[0]
    size = max(math.sqrt(flat[0] ** 2 + flat[1] ** 2 + flat[2] ** 2), 1e-9)
    for a in range(3):
        flat[a] /= size
    across[0] = axis[1] * flat[2] - axis[2] * flat[1]
    across[1] = axis[2] * flat[0] - axis[0] * flat[2]
    across[2] = axis[0] * flat[1] - axis[1] * flat[0]
    deeper[k], sideways[k] = 0.0, 0.0
    for j in range(z.shape[0]):
        if not moves[k, j]:
            continue
        down = flat[0] * z[j, 0] + flat[1] * z[j, 1] + flat[2] * z[j, 2]
        beside = across[0] * z[j, 0] + across[1] * z[j, 1] + across[2] * z[j, 2]
        for v in range(coupling.shape[1]):
            if coupling[j, v] != 0.0:
                deeper[k, v] += down * coupling[j, v]
                sideways[k, v] += beside * coupling[j, v]


@njit(cache=True, error_model="numpy")
def screen_folds(
    base, end, allowed, frames, joint_frame, slides, R, ortho, moves, coupling, covariance, limits
):  # pragma: no cover - compiled
    """Angles with the image plane, which links may be folded, and for the allowed ones the rows of `turning_rows`.

    `limits` are the largest angle, the least change and the sigmas that are plausible. Twin: `folds.screen_numpy`.
    """
    links, joints, k = base.shape[0], joint_frame.shape[0], coupling.shape[1]
    near, least, plausible = limits
    angle, chosen = np.zeros(links), np.zeros(links, np.bool_)
    deeper, sideways = np.zeros((links, k)), np.zeros((links, k))
    z, sigma = np.zeros((joints, 3)), np.zeros(joints)
    for j in range(joints):
        if slides[j]:
            continue
        f, total = joint_frame[j], 0.0
        for a in range(3):
            for b in range(3):
                z[j, a] += R[a, b] * frames[f, b, 2]
        for a in range(k):
            if coupling[j, a] != 0.0:
                for b in range(k):
                    total += coupling[j, a] * covariance[a, b] * coupling[j, b]
        sigma[j] = math.sqrt(max(total, 0.0))
    axis, sight = np.empty(3), np.empty(3)
    for i in range(links):
        if not allowed[i]:
            continue
        line_of_sight(base[i], end[i], ortho, sight)
        size = along = reach = 0.0
        for a in range(3):
            axis[a] = end[i, a] - base[i, a]
            size += axis[a] * axis[a]
        size = max(math.sqrt(size), 1e-12)
        for a in range(3):
            axis[a] /= size
            along += axis[a] * sight[a]
        angle[i] = math.asin(min(max(along, -1.0), 1.0))
        # The sum of the joints' sigmas is more than any link's angle can have: most links end here.
        for j in range(joints):
            if moves[i, j]:
                reach += plausible * sigma[j]
        turn = abs(2.0 * angle[i])
        turning_rows(i, axis, sight, z, moves, coupling, deeper, sideways)
        if not (least < turn < 2.0 * near and turn < reach):
            continue
        total = 0.0
        for a in range(k):
            if deeper[i, a] != 0.0:
                for b in range(k):
                    total += deeper[i, a] * covariance[a, b] * deeper[i, b]
        chosen[i] = turn < plausible * math.sqrt(max(total, 0.0))
    return angle, chosen, deeper, sideways
