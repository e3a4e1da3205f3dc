"""Compiled loops over profiles: sampling an image, rendering what a profile should look like."""

import math

import numpy as np
from numba import njit

from .geometry import hit_pill


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
def near_pills(ray, slope, half, middle, base, tip, radius, chosen):  # pragma: no cover - compiled
    """Numbers of the pills that a sampler of half length `half` pixels about u = middle may cross, and how many."""
    count = 0
    ox, oy, oz = ray[0] + middle * slope[0], ray[1] + middle * slope[1], ray[2] + middle * slope[2]
    dx, dy, dz = ray[3] + middle * slope[3], ray[4] + middle * slope[4], ray[5] + middle * slope[5]
    dd = dx * dx + dy * dy + dz * dz
    across = math.sqrt(slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2)
    turning = math.sqrt(slope[3] ** 2 + slope[4] ** 2 + slope[5] ** 2)
    for k in range(base.shape[0]):
        ax, ay, az = tip[k, 0] - base[k, 0], tip[k, 1] - base[k, 1], tip[k, 2] - base[k, 2]
        mx, my, mz = ox - base[k, 0], oy - base[k, 1], oz - base[k, 2]
        widest = max(radius[k, 0], radius[k, 1])
        farthest = max(abs(base[k, 2]), abs(tip[k, 2])) + widest
        room = widest + half * (across + farthest * turning)
        ux, uy, uz = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
        apart = mx * ux + my * uy + mz * uz
        # A line through the axis' far end only: the axis seen end on has no cross product, and stays in.
        if apart * apart > room * room * (ux * ux + uy * uy + uz * uz) and ux * ux + uy * uy + uz * uz > 1e-12 * dd:
            continue
        hx, hy, hz = mx - 0.5 * ax, my - 0.5 * ay, mz - 0.5 * az
        hd = hx * dx + hy * dy + hz * dz
        reach = 0.5 * math.sqrt(ax * ax + ay * ay + az * az) + room
        if (hx * hx + hy * hy + hz * hz - reach * reach) * dd > hd * hd:
            continue
        chosen[count] = k
        count += 1
    return count


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

    `ray0 + u ray1` is the ray (origin, direction) at u. The edge is at u = 0, between two samples. parts[:, 0] is the
    share of the own finger, parts[:, 1] that share times how much the surface faces the camera. States: 0 an edge is
    expected, 1 hidden by another finger, 2 no depth step (joint).
    """
    m, reach = u.shape[0], blur.shape[0] // 2
    mid = np.searchsorted(u, 0.0)
    raw, depth, group, facing = np.empty(m), np.empty(m), np.empty(m, np.int64), np.empty(m)
    chosen = np.empty(base.shape[0], np.int64)
    half, middle = 0.5 * (u[m - 1] - u[0]), 0.5 * (u[m - 1] + u[0])
    for i in range(link.shape[0]):
        own = finger[link[i]]
        count = near_pills(ray0[i], ray1[i], half, middle, base, tip, radius, chosen)
        for j in range(m):
            ox, oy, oz = ray0[i, 0] + u[j] * ray1[i, 0], ray0[i, 1] + u[j] * ray1[i, 1], ray0[i, 2] + u[j] * ray1[i, 2]
            dx, dy, dz = ray0[i, 3] + u[j] * ray1[i, 3], ray0[i, 4] + u[j] * ray1[i, 4], ray0[i, 5] + u[j] * ray1[i, 5]
            depth[j], group[j], raw[j], facing[j] = math.inf, -1, background, 0.0
            hit, x, y, z = -1, 0.0, 0.0, 0.0
            for c in range(count):
                t, nx, ny, nz = hit_pill(ox, oy, oz, dx, dy, dz, base, tip, radius, chosen[c])
                if t < depth[j]:
                    depth[j], hit, x, y, z = t, chosen[c], nx, ny, nz
            if hit >= 0:
                group[j] = finger[hit]
                raw[j] = shade(coefficients, gain[hit], x, y, z)
                facing[j] = -(x * dx + y * dy + z * dz) / math.sqrt(dx * dx + dy * dy + dz * dz)
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


@njit(cache=True)
def fill_harmonics(normal, out):  # pragma: no cover - compiled
    """Rows of the shading basis; twin: `appearance.harmonics`."""
    for i in range(normal.shape[0]):
        x, y, z = normal[i, 0], normal[i, 1], normal[i, 2]
        column = 0
        for degree in range(5):
            for b in range(degree + 1):
                out[i, column] = x ** (degree - b) * y**b
                column += 1
        for degree in range(4):
            for b in range(degree + 1):
                out[i, column] = z * x ** (degree - b) * y**b
                column += 1
