"""Compiled rendering of what each outline sampler should see."""

import math

import numpy as np
from numba import njit

from .geometry import C2, FARTHEST, LENGTH, R0, R1, REACH2, SLOPE, WIDEST, hit_known, pill_facts
from .profiles import shade


@njit(cache=True, error_model="numpy")
def depth_steps(radius, link, contact, focal, ortho):  # pragma: no cover - compiled
    """Depth between two surfaces of one finger that shows as an edge; twin: `templates.depth_step_numpy`."""
    jump = np.empty(link.shape[0])
    for i in range(link.shape[0]):
        k, far = link[i], 1.0
        if not ortho:
            far = math.sqrt(contact[i, 0] ** 2 + contact[i, 1] ** 2 + contact[i, 2] ** 2)
        jump[i] = max(0.125 * (radius[k, 0] + radius[k, 1]), 2.0 * far / focal)
    return jump


@njit(cache=True, error_model="numpy")
def near_pills(ray, slope, half, middle, facts, chosen):  # pragma: no cover - compiled
    """Numbers of the pills that a sampler of half length `half` pixels about u = middle may cross, and how many.

    It leaves nothing out that `templates.expect_numpy` sees, its twin.
    """
    count = 0
    ox, oy, oz = ray[0] + middle * slope[0], ray[1] + middle * slope[1], ray[2] + middle * slope[2]
    dx, dy, dz = ray[3] + middle * slope[3], ray[4] + middle * slope[4], ray[5] + middle * slope[5]
    dd = dx * dx + dy * dy + dz * dz
    across = math.sqrt(slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2)
    turning = math.sqrt(slope[3] ** 2 + slope[4] ** 2 + slope[5] ** 2)
    for k in range(facts.shape[0]):
        more = half * (across + facts[k, FARTHEST] * turning)
        if facts[k, LENGTH] > 0.0:
            ax, ay, az = facts[k, 3], facts[k, 4], facts[k, 5]
            mx, my, mz = ox - facts[k, 0], oy - facts[k, 1], oz - facts[k, 2]
            room = facts[k, WIDEST] + more
            ux, uy, uz = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
            apart, uu = mx * ux + my * uy + mz * uz, ux * ux + uy * uy + uz * uz
            # A line through the axis' far end only: the axis seen end on has no cross product, and stays in.
            if apart * apart > room * room * uu and uu > 1e-12 * dd:
                continue
        hx, hy, hz = ox - facts[k, 6], oy - facts[k, 7], oz - facts[k, 8]
        hd = hx * dx + hy * dy + hz * dz
        reach = math.sqrt(facts[k, REACH2]) + more
        if (hx * hx + hy * hy + hz * hz - reach * reach) * dd > hd * hd:
            continue
        chosen[count] = k
        count += 1
    return count


@njit(cache=True, error_model="numpy")
def cut_window(i, state, group, depth, own, jump, margin, mid, visible):  # pragma: no cover - compiled
    """The window of one sampler: steady surface inwards, one surface outwards; part of `expect_profiles`.

    Twin: `templates.expect_numpy`.
    """
    m, outer = visible.shape[1], mid + 1
    for j in range(m):
        visible[i, j] = False
    if state[i] != 0:
        return
    j = mid - 1
    visible[i, j] = visible[i, mid] = True
    while j > 0 and group[j - 1] == own and abs(depth[j - 1] - depth[j]) < jump:
        j -= 1
        visible[i, j] = True
    if j > 0:
        for k in range(j, min(j + margin, mid - 2)):
            visible[i, k] = False
    j = mid
    while j < m - 1 and group[j + 1] == group[outer]:
        j += 1
        visible[i, j] = True
    if j < m - 1:
        for k in range(max(j - margin, mid + 1) + 1, j + 1):
            visible[i, k] = False


@njit(cache=True, error_model="numpy")
def blur_rows(i, raw, blur, values, parts):  # pragma: no cover - compiled
    """One sampler's grey levels and parts blurred, from rows that go on by the blur's reach at both ends.

    Part of `expect_profiles`; twin: `templates.blurred`.
    """
    m = values.shape[1]
    for j in range(m):
        values[i, j], parts[i, 0, j], parts[i, 1, j] = 0.0, 0.0, 0.0
    for b in range(blur.shape[0]):
        weight = blur[b]
        for j in range(m):
            values[i, j] += weight * raw[0, j + b]
        for j in range(m):
            parts[i, 0, j] += weight * raw[1, j + b]
        for j in range(m):
            parts[i, 1, j] += weight * raw[2, j + b]


@njit(cache=True, error_model="numpy")
def meet_pill(k, ray, facts, side, first, hit, normal):  # pragma: no cover - compiled
    """Take pill k into the first hits of the rays along one sampler; part of `expect_profiles`.

    The quadratic of `hit_cone` for all rays in one loop without branches: `ray` holds origin, direction and 1 / d . d,
    `side` t, axial position, the two numbers that say whether they count, and the normal. Where it is the sphere at an
    end that a ray meets, or a ray runs steeper than the cone, `hit_known` decides. Twin: `pills.ray_hits_numpy`.
    """
    m = ray.shape[1]
    ax, ay, az, bx, by, bz = facts[k, 3], facts[k, 4], facts[k, 5], facts[k, 0], facts[k, 1], facts[k, 2]
    cx, cy, cz, c2, slope, r0 = facts[k, 6], facts[k, 7], facts[k, 8], facts[k, C2], facts[k, SLOPE], facts[k, R0]
    flat = 1.0 / c2
    for j in range(m):
        ox, oy, oz, dx, dy, dz = ray[0, j], ray[1, j], ray[2, j], ray[3, j], ray[4, j], ray[5, j]
        shift = -((ox - cx) * dx + (oy - cy) * dy + (oz - cz) * dz) * ray[6, j]
        mx, my, mz = ox - bx + shift * dx, oy - by + shift * dy, oz - bz + shift * dz
        md, mm = mx * dx + my * dy + mz * dz, mx * mx + my * my + mz * mz
        m_a, d_a = mx * ax + my * ay + mz * az, dx * ax + dy * ay + dz * az
        w = r0 - slope * m_a
        qa = c2 * (dx * dx + dy * dy + dz * dz - d_a * d_a) - slope * slope * d_a * d_a
        qb = c2 * (md - m_a * d_a) + slope * d_a * w
        disc = qb * qb - qa * (c2 * (mm - m_a * m_a) - w * w)
        t = (-qb - math.sqrt(abs(disc))) / qa
        x = m_a + t * d_a
        size = (r0 - slope * x) * flat  # distance from the axis centre whose sphere touches here
        centre, inverse = x - slope * size, 1.0 / size
        side[0, j], side[1, j], side[2, j], side[3, j] = t + shift, x, qa, disc
        side[4, j] = (mx + t * dx - centre * ax) * inverse
        side[5, j] = (my + t * dy - centre * ay) * inverse
        side[6, j] = (mz + t * dz - centre * az) * inverse
    low, high = r0 * slope, facts[k, LENGTH] + facts[k, R1] * slope
    ball = facts[k, LENGTH] < 0.0
    for j in range(m):
        steep = ball or not side[2, j] > 0.0
        if not steep and side[3, j] < 0.0:
            continue
        if not steep and low <= side[1, j] <= high:
            if side[0, j] < first[j]:
                first[j], hit[j] = side[0, j], k
                normal[0, j], normal[1, j], normal[2, j] = side[4, j], side[5, j], side[6, j]
            continue
        ox, oy, oz, dx, dy, dz = ray[0, j], ray[1, j], ray[2, j], ray[3, j], ray[4, j], ray[5, j]
        t, nx, ny, nz = hit_known(ox, oy, oz, dx, dy, dz, dx * dx + dy * dy + dz * dz, facts, k)
        if t < first[j]:
            first[j], hit[j] = t, k
            normal[0, j], normal[1, j], normal[2, j] = nx, ny, nz


@njit(cache=True, error_model="numpy")
def spread_rays(i, ray0, ray1, u, ray):  # pragma: no cover - compiled
    """Origin, direction and 1 / d . d of the rays along sampler i; part of `expect_profiles`."""
    for a in range(6):
        for j in range(u.shape[0]):
            ray[a, j] = ray0[i, a] + u[j] * ray1[i, a]
    for j in range(u.shape[0]):
        ray[6, j] = 1.0 / (ray[3, j] * ray[3, j] + ray[4, j] * ray[4, j] + ray[5, j] * ray[5, j])


@njit(cache=True, error_model="numpy")
def face(own, ray, mid, finger, look, hit, normal, group, raw, reach):  # pragma: no cover - compiled
    """Grey level, own finger and facing of the first hits along a sampler, into `raw`; part of `expect_profiles`.

    `look` is shading, gains and background. Twin: `appearance.shade_numpy`.
    """
    m, (shading, gain, background) = ray.shape[1], look
    for j in range(m):
        raw[0, reach + j] = shade(shading, 1.0, normal[0, j], normal[1, j], normal[2, j])
        facing = normal[0, j] * ray[3, j] + normal[1, j] * ray[4, j] + normal[2, j] * ray[5, j]
        raw[2, reach + j] = -facing * math.sqrt(ray[6, j])
    for j in range(m):
        at, k = reach + j, hit[j]
        group[j] = finger[k] if k >= 0 else -1
        raw[0, at] = gain[k] * raw[0, at] if k >= 0 else background
        raw[1, at] = 1.0
        if j >= mid or group[j] != own:
            raw[1, at], raw[2, at] = 0.0, 0.0
    for row in range(3):
        for b in range(reach):
            raw[row, b], raw[row, reach + m + b] = raw[row, reach], raw[row, reach + m - 1]


@njit(cache=True, error_model="numpy")
def expect_profiles(
    ray0,
    ray1,
    u,
    base,
    tip,
    radius,
    finger,
    link,
    jump,
    coefficients,
    gain,
    background,
    blur,
    margin,
    values,
    parts,
    visible,
    state,
):  # pragma: no cover - compiled
    """Rendered templates, their parts, windows and states of outline samplers; twin: `templates.expect_numpy`.

    `ray0 + u ray1` is the ray (origin, direction) at u. The edge is at u = 0, between two samples. parts[:, 0] is the
    share of the own finger, parts[:, 1] that share times how much the surface faces the camera. States: 0 an edge is
    expected, 1 hidden by another finger, 2 no depth step (joint).
    """
    m, reach = u.shape[0], blur.shape[0] // 2
    mid = np.searchsorted(u, 0.0)
    inner, outer = mid - 2, mid + 1
    depth, group, hit = np.empty(m), np.empty(m, np.int64), np.empty(m, np.int64)
    ray, side, normal = np.empty((7, m)), np.empty((7, m)), np.zeros((3, m))
    raw = np.zeros((3, m + 2 * reach))  # grey level, own finger, facing
    facts = pill_facts(base, tip, radius)
    look = coefficients, gain, background
    chosen = np.empty(base.shape[0], np.int64)
    half, middle = 0.5 * (u[m - 1] - u[0]), 0.5 * (u[m - 1] + u[0])
    for i in range(link.shape[0]):
        own = finger[link[i]]
        count = near_pills(ray0[i], ray1[i], half, middle, facts, chosen)
        depth[:], hit[:] = math.inf, -1
        spread_rays(i, ray0, ray1, u, ray)
        for c in range(count):
            meet_pill(chosen[c], ray, facts, side, depth, hit, normal)
        face(own, ray, mid, finger, look, hit, normal, group, raw, reach)
        state[i] = 0
        if group[inner] != own or (group[outer] >= 0 and group[outer] != own and depth[outer] < depth[inner]):
            state[i] = 1
        elif group[outer] == own and depth[outer] - depth[inner] < jump[i]:
            state[i] = 2
        blur_rows(i, raw, blur, values, parts)
        cut_window(i, state, group, depth, own, jump[i], margin, mid, visible)
