"""Compiled loop that places samplers on the outline, with the rays they see along."""

import math

import numpy as np
from numba import njit


@njit(cache=True, inline="always", error_model="numpy")
def bend(x, y, k):  # pragma: no cover - compiled
    """OpenCV's distortion of normalised coordinates; twin: `camera.distort`."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    return x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x), y * radial + k[2] * (
        r2 + 2.0 * y * y
    ) + 2.0 * k[3] * x * y


@njit(cache=True, error_model="numpy")
def straighten(bx, by, k):  # pragma: no cover - compiled
    """Inverse of `bend` by Newton's method; twin: `camera.undistort`."""
    x, y = bx, by
    if k[0] == 0.0 and k[1] == 0.0 and k[2] == 0.0 and k[3] == 0.0 and k[4] == 0.0:
        return x, y
    for _ in range(12):
        fx, fy = bend(x, y, k)
        ex, ey = fx - bx, fy - by
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        growth = 2.0 * (k[0] + r2 * (2.0 * k[1] + 3.0 * k[4] * r2))
        a = radial + growth * x * x + 2.0 * k[2] * y + 6.0 * k[3] * x
        d = radial + growth * y * y + 6.0 * k[2] * y + 2.0 * k[3] * x
        b = growth * x * y + 2.0 * (k[2] * x + k[3] * y)
        det = a * d - b * b
        x -= (d * ex - b * ey) / det
        y -= (a * ey - b * ex) / det
        if abs(ex) + abs(ey) < 1e-14:
            break
    return x, y


@njit(cache=True, error_model="numpy")
def pixel_ray(x, y, ortho, intrinsic, k, ray):  # pragma: no cover - compiled
    """Origin and direction of the ray through a pixel; twin: `camera.rays`."""
    u, v = (x - intrinsic[2]) / intrinsic[0], (y - intrinsic[3]) / intrinsic[1]
    ray[:] = 0.0
    ray[5] = 1.0
    if ortho:
        ray[0], ray[1] = u, v
    else:
        ray[3], ray[4] = straighten(u, v, k)


@njit(cache=True, error_model="numpy")
def side_normal(b, t, r0, r1, side, ortho, n):  # pragma: no cover - compiled
    """Contact normal on one side of a pill, False where there is none; twin: `profiles.contact_normals`."""
    if ortho:
        e1x, e1y, e1z, e2x, e2y, e2z = t[0] - b[0], t[1] - b[1], 0.0, 0.0, 0.0, 1.0
        c1, c2 = r0 - r1, 0.0
    else:
        e1x, e1y, e1z, e2x, e2y, e2z = b[0], b[1], b[2], t[0], t[1], t[2]
        c1, c2 = -r0, -r1
    g11, g22 = e1x * e1x + e1y * e1y + e1z * e1z, e2x * e2x + e2y * e2y + e2z * e2z
    g12 = e1x * e2x + e1y * e2y + e1z * e2z
    det = g11 * g22 - g12 * g12
    if det <= 1e-12 * g11 * g22:
        return False
    x, y = (g22 * c1 - g12 * c2) / det, (g11 * c2 - g12 * c1) / det
    px, py, pz = x * e1x + y * e2x, x * e1y + y * e2y, x * e1z + y * e2z
    rest = 1.0 - (px * px + py * py + pz * pz)
    if rest <= 0.0:
        return False
    across = side * math.sqrt(rest / det)
    n[0] = px + across * (e1y * e2z - e1z * e2y)
    n[1] = py + across * (e1z * e2x - e1x * e2z)
    n[2] = pz + across * (e1x * e2y - e1y * e2x)
    return True


@njit(cache=True, error_model="numpy")
def tip_normal(b, t, r, angle, ortho, n):  # pragma: no cover - compiled
    """Contact normal on a tip's sphere, `angle` from the seen axis; twin: `profiles.cap_normals`."""
    sx, sy, sz, sin_beta = 0.0, 0.0, 1.0, 0.0
    if not ortho:
        distance = math.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
        sx, sy, sz, sin_beta = t[0] / distance, t[1] / distance, t[2] / distance, r / distance
    ax, ay, az = t[0] - b[0], t[1] - b[1], t[2] - b[2]
    along = ax * sx + ay * sy + az * sz
    ax, ay, az = ax - along * sx, ay - along * sy, az - along * sz
    size = math.sqrt(ax * ax + ay * ay + az * az)
    if size < 1e-9 or sin_beta >= 1.0:
        return False
    ax, ay, az = ax / size, ay / size, az / size
    ux, uy, uz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    c, s, out = math.cos(angle), math.sin(angle), math.sqrt(1.0 - sin_beta * sin_beta)
    n[0] = out * (c * ax + s * ux) - sin_beta * sx
    n[1] = out * (c * ay + s * uy) - sin_beta * sy
    n[2] = out * (c * az + s * uz) - sin_beta * sz
    return True


@njit(cache=True, error_model="numpy")
def place_outline(
    base, tip, radius, link, along, side, angle, ortho, intrinsic, k, origin, direction, contact, ray, slope, kept
):  # pragma: no cover - compiled
    """Pixels, outward directions, contact points and rays of outline samplers; twin: `profiles.place_outline_numpy`."""
    n = np.empty(3)
    ahead, behind = np.empty(6), np.empty(6)
    for i in range(link.shape[0]):
        m = link[i]
        if side[i] != 0:
            ok = side_normal(base[m], tip[m], radius[m, 0], radius[m, 1], float(side[i]), ortho, n)
        else:
            ok = tip_normal(base[m], tip[m], radius[m, 1], angle[i], ortho, n)
        kept[i] = False
        if not ok:
            continue
        r = radius[m, 0] + along[i] * (radius[m, 1] - radius[m, 0])
        for a in range(3):
            contact[i, a] = base[m, a] + along[i] * (tip[m, a] - base[m, a]) + r * n[a]
        if ortho:
            x, y = contact[i, 0], contact[i, 1]
        else:
            if contact[i, 2] <= 0.0:
                continue
            x, y = bend(contact[i, 0] / contact[i, 2], contact[i, 1] / contact[i, 2], k)
        dx, dy = n[0] / intrinsic[0], n[1] / intrinsic[1]
        size = math.sqrt(dx * dx + dy * dy)
        x, y, dx, dy = x * intrinsic[0] + intrinsic[2], y * intrinsic[1] + intrinsic[3], dx / size, dy / size
        origin[i, 0], origin[i, 1], direction[i, 0], direction[i, 1] = x, y, dx, dy
        pixel_ray(x, y, ortho, intrinsic, k, ray[i])
        pixel_ray(x + dx, y + dy, ortho, intrinsic, k, ahead)
        pixel_ray(x - dx, y - dy, ortho, intrinsic, k, behind)
        for a in range(6):
            slope[i, a] = 0.5 * (ahead[a] - behind[a])
        kept[i] = True


@njit(cache=True, error_model="numpy")
def count_samplers(base, tip, ortho, intrinsic, k, spacing, most):  # pragma: no cover - compiled
    """Samplers on one side of every link: as many as its length in the image asks for; twin: `profiles.side_counts`."""
    count = np.empty(base.shape[0], np.int64)
    for m in range(base.shape[0]):
        length = 0.0
        if ortho:
            x, y = tip[m, 0] - base[m, 0], tip[m, 1] - base[m, 1]
            length = math.hypot(x * intrinsic[0], y * intrinsic[1])
        elif base[m, 2] > 0.0 and tip[m, 2] > 0.0:
            x0, y0 = bend(base[m, 0] / base[m, 2], base[m, 1] / base[m, 2], k)
            x1, y1 = bend(tip[m, 0] / tip[m, 2], tip[m, 1] / tip[m, 2], k)
            length = math.hypot((x1 - x0) * intrinsic[0], (y1 - y0) * intrinsic[1])
        count[m] = int(min(max(length / spacing, 2.0), float(most)))
    return count
