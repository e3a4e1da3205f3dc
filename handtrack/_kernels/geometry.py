"""Compiled loops over frames and rays: forward kinematics, exact ray hits on pills."""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def forward(parent, prefix, joint, prismatic, q):  # pragma: no cover - compiled
    """Frames (b, f, 4, 4) of a tree for poses (b, j); twin: `kinematics.tree.forward_numpy`."""
    frames = np.zeros((q.shape[0], parent.shape[0], 4, 4))
    local = np.zeros((4, 4))
    for b in range(q.shape[0]):
        for i in range(parent.shape[0]):
            local[:, :] = prefix[i]
            if joint[i] >= 0:
                value = q[b, joint[i]]
                if prismatic[i]:
                    for row in range(3):
                        local[row, 3] += local[row, 2] * value
                else:
                    c, s = math.cos(value), math.sin(value)
                    for row in range(3):
                        x, y = local[row, 0], local[row, 1]
                        local[row, 0] = x * c + y * s
                        local[row, 1] = y * c - x * s
            p = parent[i]
            if p < 0:
                frames[b, i] = local
                continue
            for row in range(3):
                for col in range(4):
                    total = frames[b, p, row, 3] if col == 3 else 0.0
                    for k in range(3):
                        total += frames[b, p, row, k] * local[k, col]
                    frames[b, i, row, col] = total
            frames[b, i, 3, 3] = 1.0
    return frames


@njit(cache=True, inline="always")
def hit_sphere(ox, oy, oz, dx, dy, dz, cx, cy, cz, r):  # pragma: no cover - compiled
    """Smallest ray parameter on a sphere, inf where missed."""
    a = dx * dx + dy * dy + dz * dz
    mx, my, mz = ox - cx, oy - cy, oz - cz
    b = mx * dx + my * dy + mz * dz
    # The squared distance of the line from the centre, free of the cancellation of b*b - a*c far from the sphere.
    px, py, pz = mx - b / a * dx, my - b / a * dy, mz - b / a * dz
    gap = r * r - (px * px + py * py + pz * pz)
    if gap < 0.0:
        return math.inf
    return (-b - math.sqrt(gap * a)) / a


@njit(cache=True)
def hit_pill(ox, oy, oz, dx, dy, dz, bases, tips, radii, pill):  # pragma: no cover - compiled
    """First hit of a ray on the convex hull of two spheres: (t, nx, ny, nz); twin: `pills.ray_hits_numpy`.

    The side is the cone that touches both spheres. With axis length L and slope s = (r0 - r1) / L its outward normal
    makes n . axis = s, and it covers the axial positions of contact from r0 s to L + r1 s. Two spheres one of which
    holds the other are just the larger one.
    """
    bx, by, bz, r0, r1 = bases[pill, 0], bases[pill, 1], bases[pill, 2], radii[pill, 0], radii[pill, 1]
    ax, ay, az = tips[pill, 0] - bx, tips[pill, 1] - by, tips[pill, 2] - bz
    mx, my, mz = ox - bx, oy - by, oz - bz
    # Quick way out: the ray passes the infinite axis at more than the larger radius, or misses the bounding sphere.
    ux, uy, uz = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
    apart = mx * ux + my * uy + mz * uz
    widest = max(r0, r1)
    if apart * apart > widest * widest * (ux * ux + uy * uy + uz * uz):
        return math.inf, 0.0, 0.0, 0.0
    length = math.sqrt(ax * ax + ay * ay + az * az)
    hx, hy, hz = mx - 0.5 * ax, my - 0.5 * ay, mz - 0.5 * az
    dd = dx * dx + dy * dy + dz * dz
    hd = hx * dx + hy * dy + hz * dz
    reach = 0.5 * length + widest
    if (hx * hx + hy * hy + hz * hz - reach * reach) * dd > hd * hd:
        return math.inf, 0.0, 0.0, 0.0
    if length <= abs(r0 - r1):
        first = r0 >= r1
        cx, cy, cz, r = (bx, by, bz, r0) if first else (bx + ax, by + ay, bz + az, r1)
        t = hit_sphere(ox, oy, oz, dx, dy, dz, cx, cy, cz, r)
        return t, (ox + t * dx - cx) / r, (oy + t * dy - cy) / r, (oz + t * dz - cz) / r
    ax, ay, az = ax / length, ay / length, az / length
    slope = (r0 - r1) / length
    c2 = 1.0 - slope * slope
    # Start from the point of the ray nearest to the pill's middle: keeps the quadratic well conditioned for far
    # cameras.
    shift = -hd / dd
    mx, my, mz = mx + shift * dx, my + shift * dy, mz + shift * dz
    md = mx * dx + my * dy + mz * dz
    mm = mx * mx + my * my + mz * mz
    m_a, d_a = mx * ax + my * ay + mz * az, dx * ax + dy * ay + dz * az
    # Cone: |p - x a|^2 c^2 = (r0 - slope x)^2 with x the axial coordinate of the surface point.
    qa = c2 * (dd - d_a * d_a) - slope * slope * d_a * d_a
    qb = c2 * (md - m_a * d_a) + slope * d_a * (r0 - slope * m_a)
    w = r0 - slope * m_a
    qc = c2 * (mm - m_a * m_a) - w * w
    disc = qb * qb - qa * qc
    first, second, best = True, True, math.inf
    nx, ny, nz = 0.0, 0.0, 0.0
    if qa > 0.0:
        # The hull lies inside the cone, so the ray enters it through the cone's near side or, beyond an end of that,
        # through the sphere at that end.
        if disc < 0.0:
            return math.inf, 0.0, 0.0, 0.0
        t = (-qb - math.sqrt(disc)) / qa
        x = m_a + t * d_a
        first, second = x < r0 * slope, x > length + r1 * slope
        if not (first or second):
            radius = (r0 - slope * x) / c2  # distance from the axis centre whose sphere touches here
            centre = x - slope * radius
            nx = (mx + t * dx - centre * ax) / radius
            ny = (my + t * dy - centre * ay) / radius
            nz = (mz + t * dz - centre * az) / radius
            return t + shift, nx, ny, nz
    elif disc >= 0.0 and qa != 0.0:  # steeper than the cone's side: it may enter through the side or either sphere
        for sign in (-1.0, 1.0):
            t = (-qb + sign * math.sqrt(disc)) / qa
            x = m_a + t * d_a
            if t < best and r0 * slope <= x <= length + r1 * slope:
                best = t
                radius = (r0 - slope * x) / c2
                centre = x - slope * radius
                nx = (mx + t * dx - centre * ax) / radius
                ny = (my + t * dy - centre * ay) / radius
                nz = (mz + t * dz - centre * az) / radius
    if first:
        t = hit_sphere(mx, my, mz, dx, dy, dz, 0.0, 0.0, 0.0, r0)
        if t < best:
            best = t
            nx, ny, nz = (mx + t * dx) / r0, (my + t * dy) / r0, (mz + t * dz) / r0
    if second:
        t = hit_sphere(mx, my, mz, dx, dy, dz, length * ax, length * ay, length * az, r1)
        if t < best:
            best = t
            nx, ny, nz = (
                (mx + t * dx - length * ax) / r1,
                (my + t * dy - length * ay) / r1,
                (mz + t * dz - length * az) / r1,
            )
    return best + shift, nx, ny, nz


@njit(cache=True)
def cast_rays(origin, direction, base, tip, radius, hit_t, hit_pill_index, hit_normal):  # pragma: no cover - compiled
    """First pill hit by each ray, written into the three output arrays; twin: `pills.ray_hits_numpy`."""
    for i in range(origin.shape[0]):
        ox, oy, oz = origin[i, 0], origin[i, 1], origin[i, 2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        hit_t[i] = math.inf
        hit_pill_index[i] = -1
        for k in range(base.shape[0]):
            t, nx, ny, nz = hit_pill(ox, oy, oz, dx, dy, dz, base, tip, radius, k)
            if t < hit_t[i]:
                hit_t[i] = t
                hit_pill_index[i] = k
                hit_normal[i, 0], hit_normal[i, 1], hit_normal[i, 2] = nx, ny, nz
