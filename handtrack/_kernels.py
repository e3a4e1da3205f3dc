"""The few compiled loops. Each has a plain NumPy twin, named in its docstring, that a test compares it with.

Kernels take and return arrays only, never allocate per point, and run in one thread: with a busy core, numba's thread
layer stalls kernels of this size for milliseconds.
"""

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

    The side is the cone that touches both spheres. With axis length L and slope s = (r0 - r1) / L its outward normal makes
    n . axis = s, and it covers the axial positions of contact from r0 s to L + r1 s. Two spheres one of which holds the
    other are just the larger one.
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
    # Start from the point of the ray nearest to the pill's middle: keeps the quadratic well conditioned for far cameras.
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
    best = math.inf
    nx, ny, nz = 0.0, 0.0, 0.0
    if disc >= 0.0 and qa != 0.0:
        root = math.sqrt(disc)
        for sign in (-1.0, 1.0):
            t = (-qb + sign * root) / qa
            x = m_a + t * d_a
            if t < best and r0 * slope <= x <= length + r1 * slope:
                best = t
                radius = (r0 - slope * x) / c2  # distance from the axis centre whose sphere touches here
                centre = x - slope * radius
                nx = (mx + t * dx - centre * ax) / radius
                ny = (my + t * dy - centre * ay) / radius
                nz = (mz + t * dz - centre * az) / radius
    # The spheres: any hit of theirs lies inside or on the hull, so the smallest parameter of all is the hull's.
    t = hit_sphere(mx, my, mz, dx, dy, dz, 0.0, 0.0, 0.0, r0)
    if t < best:
        best = t
        nx, ny, nz = (mx + t * dx) / r0, (my + t * dy) / r0, (mz + t * dz) / r0
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


@njit(cache=True, inline="always")
def cubic_weight(d):  # pragma: no cover - compiled
    """Keys' cubic convolution kernel with a = -1/2."""
    d = abs(d)
    if d <= 1.0:
        return 1.0 + d * d * (1.5 * d - 2.5)
    if d < 2.0:
        return 2.0 + d * (-4.0 + d * (2.5 - 0.5 * d))
    return 0.0


@njit(cache=True)
def sample_lines(image, origin, direction, u, order, values, inside):  # pragma: no cover - compiled
    """Interpolate an image along straight paths, order 0, 1 or 3; twin: `profiles.sample_numpy`."""
    height, width = image.shape
    for i in range(origin.shape[0]):
        for j in range(u.shape[0]):
            x = origin[i, 0] + u[j] * direction[i, 0]
            y = origin[i, 1] + u[j] * direction[i, 1]
            values[i, j] = 0.0
            inside[i, j] = 0.0 <= x <= width - 1 and 0.0 <= y <= height - 1
            if not inside[i, j]:
                continue
            if order == 0:
                values[i, j] = image[int(math.floor(y + 0.5)), int(math.floor(x + 0.5))]
                continue
            x0, y0 = int(math.floor(x)), int(math.floor(y))
            fx, fy = x - x0, y - y0
            if order == 1:
                x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
                top = image[y0, x0] * (1.0 - fx) + image[y0, x1] * fx
                bottom = image[y1, x0] * (1.0 - fx) + image[y1, x1] * fx
                values[i, j] = top * (1.0 - fy) + bottom * fy
                continue
            total = 0.0
            for r in range(-1, 3):
                row = min(max(y0 + r, 0), height - 1)
                line = 0.0
                for c in range(-1, 3):
                    line += image[row, min(max(x0 + c, 0), width - 1)] * cubic_weight(fx - c)
                total += line * cubic_weight(fy - r)
            values[i, j] = total


@njit(cache=True)
def shade(c, gain, x, y, z):  # pragma: no cover - compiled
    """Quartic plus one light of a unit normal, the sum of `appearance.harmonics`; twin: `appearance.shade_numpy`."""
    flat = c[0] + x * (c[1] + x * (c[3] + x * (c[6] + x * c[10])))
    flat += y * (c[2] + x * (c[4] + x * (c[7] + x * c[11])))
    flat += y * y * (c[5] + x * (c[8] + x * c[12])) + y * y * y * (c[9] + x * c[13] + y * c[14])
    deep = c[15] + x * (c[16] + x * (c[18] + x * c[21])) + y * (c[17] + x * (c[19] + x * c[22]))
    deep += y * y * (c[20] + x * c[23] + y * c[24])
    return gain * (flat + z * deep + max(c[25] * x + c[26] * y + c[27] * z, 0.0))


@njit(cache=True)
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

    `ray0 + u ray1` is the ray (origin, direction) at u. The edge is at u = 0, between two samples. parts[:, 0] is the share
    of the own finger, parts[:, 1] that share times how much the surface faces the camera.
    States: 0 an edge is expected, 1 hidden by another finger, 2 no depth step (joint).
    """
    m, reach = u.shape[0], blur.shape[0] // 2
    mid = np.searchsorted(u, 0.0)
    raw, depth, group, facing = np.empty(m), np.empty(m), np.empty(m, np.int64), np.empty(m)
    for i in range(link.shape[0]):
        own = finger[link[i]]
        for j in range(m):
            ox, oy, oz = ray0[i, 0] + u[j] * ray1[i, 0], ray0[i, 1] + u[j] * ray1[i, 1], ray0[i, 2] + u[j] * ray1[i, 2]
            dx, dy, dz = ray0[i, 3] + u[j] * ray1[i, 3], ray0[i, 4] + u[j] * ray1[i, 4], ray0[i, 5] + u[j] * ray1[i, 5]
            depth[j], group[j], raw[j], facing[j] = math.inf, -1, background, 0.0
            for k in range(base.shape[0]):
                t, nx, ny, nz = hit_pill(ox, oy, oz, dx, dy, dz, base, tip, radius, k)
                if t < depth[j]:
                    depth[j], group[j] = t, finger[k]
                    raw[j] = shade(coefficients, gain[k], nx, ny, nz)
                    facing[j] = -(nx * dx + ny * dy + nz * dz) / math.sqrt(dx * dx + dy * dy + dz * dz)
        inner, outer = mid - 2, mid + 1
        state[i] = 0
        if group[inner] != own or (group[outer] >= 0 and group[outer] != own and depth[outer] < depth[inner]):
            state[i] = 1
        elif group[outer] == own and depth[outer] - depth[inner] < jump[i]:
            state[i] = 2
        for j in range(m):
            total = cover = faces = 0.0
            for b in range(-reach, reach + 1):
                k = min(max(j + b, 0), m - 1)
                total += blur[b + reach] * raw[k]
                if k < mid and group[k] == own:
                    cover += blur[b + reach]
                    faces += blur[b + reach] * facing[k]
            values[i, j], parts[i, 0, j], parts[i, 1, j] = total, cover, faces
            visible[i, j] = False
        if state[i] != 0:
            continue
        j = mid - 1
        visible[i, j] = visible[i, mid] = True
        while j > 0 and group[j - 1] == own and abs(depth[j - 1] - depth[j]) < jump[i]:
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


@njit(cache=True, inline="always")
def spline_overlap(d):  # pragma: no cover - compiled
    """Cubic B-spline: correlation of two linear interpolations of white noise, d pixels apart."""
    d = abs(d)
    if d < 1.0:
        return 2.0 / 3.0 - d * d * (1.0 - 0.5 * d)
    if d < 2.0:
        return (2.0 - d) ** 3 / 6.0
    return 0.0


@njit(cache=True)
def wssd(image, inside, template, visible, curves, counts):  # pragma: no cover - compiled
    """Sums of squared differences of windowed templates, moved along longer profiles; twin: `edges.wssd.curves_numpy`.

    curves[i, k] is the mean over the visible samples j of (image[i, j + k] - template[i, j])^2, inf where fewer than half
    of them are inside the image.
    """
    for i in range(image.shape[0]):
        wanted = 0
        for j in range(template.shape[1]):
            wanted += visible[i, j]
        counts[i] = wanted
        for k in range(curves.shape[1]):
            total, used = 0.0, 0
            for j in range(template.shape[1]):
                if visible[i, j] and inside[i, j + k]:
                    d = image[i, j + k] - template[i, j]
                    total += d * d
                    used += 1
            curves[i, k] = total / used if 2 * used >= wanted and used > 0 else math.inf


@njit(cache=True)
def refine_shift(
    image, inside, template, parts, visible, best, step, direction, ridge, shift, variance, misfit
):  # pragma: no cover - compiled
    """Sub-sample shift at a valley by one Gauss-Newton step, its variance for unit pixel noise, and the misfit left.

    Four unknowns beside the shift make the template's grey levels forgiving: level and facing term of the finger, its
    gradient, and the level beyond the edge, each with the ridge of a prior. Interpolated noise is correlated by
    `spline_overlap`; misfit is the mean square left over the 4/9 of the noise variance that bilinear interpolation keeps
    on average. Twin: `edges.wssd.refine_numpy`.
    """
    lags = int(math.ceil(2.0 * math.sqrt(2.0) / step))
    m, n = template.shape[1], 5
    design, r, weight = np.zeros((n, m)), np.zeros(m), np.zeros(m)
    normal, right, first = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    for i in range(image.shape[0]):
        used = 0
        for j in range(m):
            seen = visible[i, j] and inside[i, j + best[i]]
            low, high = max(j - 1, 0), min(j + 1, m - 1)
            cover = parts[i, 0, j]
            design[0, j] = -(template[i, high] - template[i, low]) / ((high - low) * step) if seen else 0.0
            design[1, j] = cover if seen else 0.0
            design[2, j] = parts[i, 1, j] if seen else 0.0
            design[3, j] = cover * (j - 0.5 * m) / m if seen else 0.0
            design[4, j] = 1.0 - cover if seen else 0.0
            r[j] = image[i, j + best[i]] - template[i, j] if seen else 0.0
            used += seen
        gg = 0.0
        for j in range(m):
            gg += design[0, j] ** 2
        if gg <= 1e-9:
            shift[i], variance[i], misfit[i] = 0.0, math.inf, math.inf
            continue
        for a in range(n):
            right[a] = 0.0
            for j in range(m):
                right[a] += design[a, j] * r[j]
            for b in range(a, n):
                total = 0.0
                for j in range(m):
                    total += design[a, j] * design[b, j]
                normal[a, b] = normal[b, a] = total
            normal[a, a] += ridge[i, a] + 1e-9 * gg
        first[:] = 0.0
        first[0] = 1.0
        solution = np.linalg.solve(normal, right)
        row = np.linalg.solve(normal, first)
        left = 0.0
        for j in range(m):
            weight[j] = 0.0
            fitted = 0.0
            for a in range(n):
                weight[j] += row[a] * design[a, j]
                fitted += solution[a] * design[a, j]
            if design[1, j] + design[4, j] > 0.0:
                left += (r[j] - fitted) ** 2
        total = 0.0
        for lag in range(-lags, lags + 1):
            rho = spline_overlap(lag * step * direction[i, 0]) * spline_overlap(lag * step * direction[i, 1])
            if rho == 0.0:
                continue
            for j in range(max(0, -lag), min(m, m - lag)):
                total += rho * weight[j] * weight[j + lag]
        for a in range(1, n):  # what the prior lets the grey levels be wrong by
            total += row[a] * row[a] * ridge[i, a]
        shift[i] = solution[0]
        variance[i] = total
        misfit[i] = left / max(used - 3, 1) * (9.0 / 4.0)


@njit(cache=True)
def outline_rows(
    ray, slope, link, sigma, frames, link_frame, length, radius, R, t, moves, joint_frame, prismatic, r, J
):  # pragma: no cover - compiled
    """Clearance residuals of edge rays and their Jacobian rows; twin: `residuals.outline_residuals_numpy`."""
    for i in range(link.shape[0]):
        k = link[i]
        f = link_frame[k]
        # The ray in the base frame: all the rest is done there.
        o, d, o1, d1 = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
        for a in range(3):
            for b in range(3):
                o[a] += R[b, a] * (ray[i, b] - t[b])
                d[a] += R[b, a] * ray[i, 3 + b]
                o1[a] += R[b, a] * slope[i, b]
                d1[a] += R[b, a] * slope[i, 3 + b]
        norm = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        m, axis = np.empty(3), np.empty(3)
        md = ad = 0.0
        for a in range(3):
            m[a] = frames[f, a, 3] - o[a]
            axis[a] = length[k] * frames[f, a, 0]
            md += m[a] * d[a] / norm
            ad += axis[a] * d[a] / norm
        size = cross = 0.0
        for a in range(3):
            ma, aa = m[a] - md * d[a] / norm, axis[a] - ad * d[a] / norm
            size += aa * aa
            cross += ma * aa
        r0, grow = radius[k, 0], radius[k, 1] - radius[k, 0]
        if size > grow * grow:
            s0 = -cross / size
            h2 = 0.0
            for a in range(3):
                across = (m[a] - md * d[a] / norm) + s0 * (axis[a] - ad * d[a] / norm)
                h2 += across * across
            s = min(max(s0 + grow * math.sqrt(h2) / math.sqrt(size * (size - grow * grow)), 0.0), 1.0)
        else:
            s = 1.0 if grow > 0 else 0.0
        gap = depth = 0.0
        n, p = np.empty(3), np.empty(3)
        for a in range(3):
            n[a] = -((m[a] - md * d[a] / norm) + s * (axis[a] - ad * d[a] / norm))
            gap += n[a] * n[a]
            depth += (m[a] + s * axis[a]) * d[a]
            p[a] = frames[f, a, 3] + s * axis[a]
        gap, depth = math.sqrt(gap), depth / (norm * norm)
        per_pixel = 0.0
        for a in range(3):
            n[a] = n[a] / gap if gap > 0.0 else 0.0
            per_pixel += n[a] * (o1[a] + depth * d1[a])
        scale = 1.0 / (max(abs(per_pixel), 1e-9) * sigma[i])
        r[i] = (gap - r0 - grow * s) * scale
        for j in range(J.shape[1]):
            J[i, j] = 0.0
            if not moves[f, j]:
                continue
            g = joint_frame[j]
            zx, zy, zz = frames[g, 0, 2], frames[g, 1, 2], frames[g, 2, 2]
            if prismatic[g]:
                J[i, j] = -scale * (n[0] * zx + n[1] * zy + n[2] * zz)
                continue
            px, py, pz = p[0] - frames[g, 0, 3], p[1] - frames[g, 1, 3], p[2] - frames[g, 2, 3]
            J[i, j] = -scale * (n[0] * (zy * pz - zz * py) + n[1] * (zz * px - zx * pz) + n[2] * (zx * py - zy * px))
