"""Compiled loops over edge points: residuals against the outline, and their Jacobian."""

import math

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def lay_out(
    frames, link_frame, link_base, link_tip, joint_frame, prismatic, ends, lever
):  # pragma: no cover - compiled
    """Base and axis of every link, and the line that every joint turns about; part of `outline_rows`.

    A joint moves the point p along n by `n . (z x (p - o)) = z . (p x n) - n . (z x o)`: `lever` holds z and z x o, or
    0 and -z where the joint slides. Twin: `residuals.outline_residuals_numpy`.
    """
    for k in range(link_frame.shape[0]):
        f = link_frame[k]
        for a in range(3):
            ends[k, a], ends[k, 3 + a] = frames[f, a, 3], 0.0
            for b in range(3):
                ends[k, a] += frames[f, a, b] * link_base[k, b]
                ends[k, 3 + a] += frames[f, a, b] * (link_tip[k, b] - link_base[k, b])
    for j in range(joint_frame.shape[0]):
        g = joint_frame[j]
        x, y, z = frames[g, 0, 2], frames[g, 1, 2], frames[g, 2, 2]
        ox, oy, oz = frames[g, 0, 3], frames[g, 1, 3], frames[g, 2, 3]
        if prismatic[g]:
            lever[0, j], lever[1, j], lever[2, j], lever[3, j], lever[4, j], lever[5, j] = 0.0, 0.0, 0.0, -x, -y, -z
        else:
            lever[0, j], lever[1, j], lever[2, j] = x, y, z
            lever[3, j], lever[4, j], lever[5, j] = y * oz - z * oy, z * ox - x * oz, x * oy - y * ox


@njit(cache=True, inline="always", error_model="numpy")
def touch(ox, oy, oz, dx, dy, dz, i, slope, k, sigma, ends, radius):  # pragma: no cover - compiled
    """Outward normal where link k is nearest to a ray, place s on its axis, distance from that, and 1 / (pixel sigma).

    Part of `outline_rows`; twin: `pills.clearance`.
    """
    short = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    ux, uy, uz = dx * short, dy * short, dz * short
    mx, my, mz = ends[k, 0] - ox, ends[k, 1] - oy, ends[k, 2] - oz
    ax, ay, az = ends[k, 3], ends[k, 4], ends[k, 5]
    md, ad = mx * ux + my * uy + mz * uz, ax * ux + ay * uy + az * uz
    # What a ray sees of the axis: from its base and along it, across the ray.
    sx, sy, sz = mx - md * ux, my - md * uy, mz - md * uz
    tx, ty, tz = ax - ad * ux, ay - ad * uy, az - ad * uz
    size, cross = tx * tx + ty * ty + tz * tz, sx * tx + sy * ty + sz * tz
    grow = radius[k, 1] - radius[k, 0]
    s = 1.0 if grow > 0 else 0.0
    if size > grow * grow:
        s = -cross / size
        if grow != 0.0:
            hx, hy, hz = sx + s * tx, sy + s * ty, sz + s * tz
            s += grow * math.sqrt((hx * hx + hy * hy + hz * hz) / (size * (size - grow * grow)))
        s = min(max(s, 0.0), 1.0)
    nx, ny, nz = -(sx + s * tx), -(sy + s * ty), -(sz + s * tz)
    gap, depth = math.sqrt(nx * nx + ny * ny + nz * nz), (md + s * ad) * short
    inverse = 1.0 / gap if gap > 0.0 else 0.0
    nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
    per_pixel = nx * (slope[i, 0] + depth * slope[i, 3])
    per_pixel += ny * (slope[i, 1] + depth * slope[i, 4]) + nz * (slope[i, 2] + depth * slope[i, 5])
    return nx, ny, nz, s, gap, 1.0 / (max(abs(per_pixel), 1e-9) * sigma)


@njit(cache=True, error_model="numpy")
def outline_row(
    ox, oy, oz, dx, dy, dz, i, slope, k, sigma, ends, radius, lever, moved, J
):  # pragma: no cover - compiled
    """Residual of one ray against link k, with its Jacobian row in J[i]; twin: `residuals.outline_residuals_numpy`."""
    nx, ny, nz, s, gap, scale = touch(ox, oy, oz, dx, dy, dz, i, slope, k, sigma, ends, radius)
    px, py, pz = ends[k, 0] + s * ends[k, 3], ends[k, 1] + s * ends[k, 4], ends[k, 2] + s * ends[k, 5]
    wx, wy, wz = py * nz - pz * ny, pz * nx - px * nz, px * ny - py * nx
    for j in range(J.shape[1]):
        turn = lever[0, j] * wx + lever[1, j] * wy + lever[2, j] * wz
        slide = lever[3, j] * nx + lever[4, j] * ny + lever[5, j] * nz
        J[i, j] = scale * moved[k, j] * (slide - turn)
    return (gap - radius[k, 0] - s * (radius[k, 1] - radius[k, 0])) * scale


@njit(cache=True, error_model="numpy")
def moved_links(moves, link_frame):  # pragma: no cover - compiled
    """1 where a joint moves a link, else 0: the rows of `residuals.Chain.moves` that `outline_rows` needs.

    Twin: `residuals.outline_residuals_numpy`.
    """
    moved = np.empty((link_frame.shape[0], moves.shape[1]))
    for k in range(link_frame.shape[0]):
        for j in range(moves.shape[1]):
            moved[k, j] = 1.0 if moves[link_frame[k], j] else 0.0
    return moved


@njit(cache=True, error_model="numpy")
def outline_rows(
    ray, slope, link, sigma, frames, link_frame, link_base, link_tip, radius, moves, joint_frame, prismatic, r, J
):  # pragma: no cover - compiled
    """Clearance residuals of edge rays and their Jacobian rows; twin: `residuals.outline_residuals_numpy`."""
    ends, lever = np.empty((link_frame.shape[0], 6)), np.empty((6, joint_frame.shape[0]))
    lay_out(frames, link_frame, link_base, link_tip, joint_frame, prismatic, ends, lever)
    moved = moved_links(moves, link_frame)
    for i in range(link.shape[0]):
        ox, oy, oz, dx, dy, dz = ray[i, 0], ray[i, 1], ray[i, 2], ray[i, 3], ray[i, 4], ray[i, 5]
        r[i] = outline_row(ox, oy, oz, dx, dy, dz, i, slope, link[i], sigma[i], ends, radius, lever, moved, J)


@njit(cache=True, error_model="numpy")
def turn_rays(
    ray, slope, offset, found, R, t, link, sigma, world, turned, of, out_sigma
):  # pragma: no cover - compiled
    """Rays at `offset` along the samplers that are `found`, in world axes, with their slopes, links and sigmas.

    Written to the first rows of the last four; returns how many. Twin: `residuals.turned_rays_numpy`.
    """
    count = 0
    for i in range(ray.shape[0]):
        if not found[i]:
            continue
        for a in range(3):
            world[count, a] = world[count, 3 + a] = turned[count, a] = turned[count, 3 + a] = 0.0
            for b in range(3):
                at, ahead = ray[i, b] + offset[i] * slope[i, b] - t[b], ray[i, 3 + b] + offset[i] * slope[i, 3 + b]
                world[count, a] += at * R[b, a]
                world[count, 3 + a] += ahead * R[b, a]
                turned[count, a] += slope[i, b] * R[b, a]
                turned[count, 3 + a] += slope[i, 3 + b] * R[b, a]
        of[count], out_sigma[count] = link[i], sigma[i]
        count += 1
    return count


@njit(cache=True, error_model="numpy")
def outline_spread(
    ray, slope, link, R, t, frames, tree, coupling, plain, covariance, spread
):  # pragma: no cover - compiled
    """Standard deviation of every predicted edge in pixels; twin: `measure.predicted_spread_numpy`.

    Rays in camera axes; `tree` holds the arguments of `outline_rows` from `link_frame` on.
    """
    n, k = link.shape[0], covariance.shape[0]
    world, turned, of, one = np.empty((n, 6)), np.empty((n, 6)), np.empty(n, np.int64), np.ones(n)
    turn_rays(ray, slope, np.zeros(n), np.ones(n, np.bool_), R, t, link, one, world, turned, of, one)
    r, J_all = np.empty(n), np.empty((n, coupling.shape[0]))
    link_frame, link_base, link_tip, radius, moves, joint_frame, prismatic = tree
    outline_rows(
        world,
        turned,
        link,
        one,
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
    J, row = J_all if plain else J_all @ coupling, np.empty(k)
    for i in range(n):
        row[:] = 0.0
        for a in range(k):
            size = J[i, a]
            if size != 0.0:
                for b in range(k):
                    row[b] += size * covariance[a, b]
        total = 0.0
        for b in range(k):
            total += row[b] * J[i, b]
        spread[i] = math.sqrt(max(total, 0.0))


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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
