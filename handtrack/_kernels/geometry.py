"""Compiled loops over frames and rays: forward kinematics, exact ray hits on pills."""

import math

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def pose_links(
    parent, prefix, joint, prismatic, link_frame, link_base, link_tip, q, R, t
):  # pragma: no cover - compiled
    """Frames (1, f, 4, 4) of a pose, and both ends of every link in camera axes; twin: `measure.posed_numpy`."""
    frames = forward(parent, prefix, joint, prismatic, q.reshape(1, -1))
    base, tip = np.empty((link_frame.shape[0], 3)), np.empty((link_frame.shape[0], 3))
    at = np.empty(3)
    for end in range(2):
        place, out = (link_base, base) if end == 0 else (link_tip, tip)
        for k in range(link_frame.shape[0]):
            f = link_frame[k]
            for a in range(3):
                at[a] = frames[0, f, a, 3]
                for b in range(3):
                    at[a] += frames[0, f, a, b] * place[k, b]
            for a in range(3):
                out[k, a] = t[a] + R[a, 0] * at[0] + R[a, 1] * at[1] + R[a, 2] * at[2]
    return frames, base, tip


@njit(cache=True, inline="always", error_model="numpy")
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


@njit(cache=True, inline="always", error_model="numpy")
def hit_cone(mx, my, mz, dx, dy, dz, dd, shift, ax, ay, az, length, slope, c2, r0, r1):  # pragma: no cover - compiled
    """First hit (t, nx, ny, nz) of a ray on a pill with unit axis a, no sphere of which holds the other.

    m is the ray's origin from the base; the side is the cone that touches both spheres. With axis length L and slope
    s = (r0 - r1) / L its outward normal makes n . axis = s, and it covers the axial positions of contact from r0 s to
    L + r1 s. `c2` is 1 - s^2, `shift` the parameter nearest to the pill's middle: starting from there keeps the
    quadratic well conditioned for far cameras. Twin: `pills.ray_hits_numpy`.
    """
    mx, my, mz = mx + shift * dx, my + shift * dy, mz + shift * dz
    md = mx * dx + my * dy + mz * dz
    mm = mx * mx + my * my + mz * mz
    m_a, d_a = mx * ax + my * ay + mz * az, dx * ax + dy * ay + dz * az
    # Cone: |p - x a|^2 c^2 = (r0 - slope x)^2 with x the axial coordinate of the surface point.
    qa = c2 * (dd - d_a * d_a) - slope * slope * d_a * d_a
    w = r0 - slope * m_a
    qb = c2 * (md - m_a * d_a) + slope * d_a * w
    qc = c2 * (mm - m_a * m_a) - w * w
    disc = qb * qb - qa * qc
    first, second, best, nx, ny, nz = True, True, math.inf, 0.0, 0.0, 0.0
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
            centre, inverse = x - slope * radius, 1.0 / radius
            nx = (mx + t * dx - centre * ax) * inverse
            ny = (my + t * dy - centre * ay) * inverse
            nz = (mz + t * dz - centre * az) * inverse
            return t + shift, nx, ny, nz
    elif disc >= 0.0 and qa != 0.0:  # steeper than the cone's side: it may enter through the side or either sphere
        for sign in (-1.0, 1.0):
            t = (-qb + sign * math.sqrt(disc)) / qa
            x = m_a + t * d_a
            if t < best and r0 * slope <= x <= length + r1 * slope:
                best, radius = t, (r0 - slope * x) / c2
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


@njit(cache=True, error_model="numpy")
def hit_pill(ox, oy, oz, dx, dy, dz, bases, tips, radii, pill):  # pragma: no cover - compiled
    """First hit of a ray on the convex hull of two spheres: (t, nx, ny, nz); twin: `pills.ray_hits_numpy`.

    Two spheres one of which holds the other are just the larger one.
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
    return hit_cone(mx, my, mz, dx, dy, dz, dd, -hd / dd, ax, ay, az, length, slope, 1.0 - slope * slope, r0, r1)


# Columns of what `pill_facts` keeps of a pill: base, unit axis, middle, and the scalars that every ray would compute.
LENGTH, SLOPE, C2, R0, R1, WIDEST, REACH2, FARTHEST, FACTS = 9, 10, 11, 12, 13, 14, 15, 16, 17


@njit(cache=True, error_model="numpy")
def pill_facts(base, tip, radius):  # pragma: no cover - compiled
    """What the rays on a set of pills have in common, one row of FACTS for each; LENGTH is -1 for a mere sphere.

    Part of `cast_rays`; twin: `pills.ray_hits_numpy`.
    """
    facts = np.empty((base.shape[0], FACTS))
    for k in range(base.shape[0]):
        r0, r1, size = radius[k, 0], radius[k, 1], 0.0
        for a in range(3):
            facts[k, a] = base[k, a]
            facts[k, 6 + a] = 0.5 * (base[k, a] + tip[k, a])
            size += (tip[k, a] - base[k, a]) ** 2
        length = math.sqrt(size)
        for a in range(3):
            facts[k, 3 + a] = (tip[k, a] - base[k, a]) / length if length > 0.0 else 0.0
        slope = (r0 - r1) / length if length > 0.0 else 0.0
        facts[k, LENGTH], facts[k, SLOPE], facts[k, C2] = length, slope, 1.0 - slope * slope
        facts[k, R0], facts[k, R1], facts[k, WIDEST] = r0, r1, max(r0, r1)
        facts[k, REACH2] = (0.5 * length + max(r0, r1)) ** 2
        facts[k, FARTHEST] = max(abs(base[k, 2]), abs(tip[k, 2])) + max(r0, r1)
        if length <= abs(r0 - r1):
            facts[k, LENGTH] = -1.0
            if r1 > r0:
                facts[k, 0], facts[k, 1], facts[k, 2] = tip[k, 0], tip[k, 1], tip[k, 2]
    return facts


@njit(cache=True, inline="always", error_model="numpy")
def hit_known(ox, oy, oz, dx, dy, dz, dd, facts, k):  # pragma: no cover - compiled
    """`hit_pill` for a pill whose `pill_facts` are known; dd is d . d. Twin: `pills.ray_hits_numpy`."""
    ax, ay, az = facts[k, 3], facts[k, 4], facts[k, 5]
    mx, my, mz = ox - facts[k, 0], oy - facts[k, 1], oz - facts[k, 2]
    ux, uy, uz = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
    apart, widest = mx * ux + my * uy + mz * uz, facts[k, WIDEST]
    if apart * apart > widest * widest * (ux * ux + uy * uy + uz * uz):
        return math.inf, 0.0, 0.0, 0.0
    hx, hy, hz = ox - facts[k, 6], oy - facts[k, 7], oz - facts[k, 8]
    hd = hx * dx + hy * dy + hz * dz
    if (hx * hx + hy * hy + hz * hz - facts[k, REACH2]) * dd > hd * hd:
        return math.inf, 0.0, 0.0, 0.0
    if facts[k, LENGTH] < 0.0:
        t = hit_sphere(mx, my, mz, dx, dy, dz, 0.0, 0.0, 0.0, widest)
        return t, (mx + t * dx) / widest, (my + t * dy) / widest, (mz + t * dz) / widest
    return hit_cone(
        mx,
        my,
        mz,
        dx,
        dy,
        dz,
        dd,
        -hd / dd,
        ax,
        ay,
        az,
        facts[k, LENGTH],
        facts[k, SLOPE],
        facts[k, C2],
        facts[k, R0],
        facts[k, R1],
    )


@njit(cache=True, error_model="numpy")
def cast_rays(origin, direction, base, tip, radius, hit_t, hit_pill_index, hit_normal):  # pragma: no cover - compiled
    """First pill hit by each ray, written into the three output arrays; twin: `pills.ray_hits_numpy`."""
    facts = pill_facts(base, tip, radius)
    for i in range(origin.shape[0]):
        ox, oy, oz = origin[i, 0], origin[i, 1], origin[i, 2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        dd = dx * dx + dy * dy + dz * dz
        first, pill, x, y, z = math.inf, -1, 0.0, 0.0, 0.0
        for k in range(base.shape[0]):
            t, nx, ny, nz = hit_known(ox, oy, oz, dx, dy, dz, dd, facts, k)
            if t < first:
                first, pill, x, y, z = t, k, nx, ny, nz
        hit_t[i], hit_pill_index[i] = first, pill
        hit_normal[i, 0], hit_normal[i, 1], hit_normal[i, 2] = x, y, z
