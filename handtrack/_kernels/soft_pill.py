"""Compiled view of one pill in one square of a smooth image: its share, grey level and depth, with derivatives.

One sample of the image is a square of side h. A pill covers the share `a` of it that a straight edge leaves (`cover`)
and shows one grey level there. All derivatives are by the twist of its link in camera axes: the velocity (3) of the
link's base and its angular velocity (3).
"""

import math

from numba import njit

from .geometry import hit_pill

COVER, SLOPE, LEVEL, DEPTH, NX, NY, TX, TY, HIT, NORMAL = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
FACTS = 12
PLAIN, CELLS = 28, 24  # coefficients of a shading before its table, and cells along the side of that
ROOT = math.sqrt(0.5)
_DENSITY = 1.0 / math.sqrt(2.0 * math.pi)
_LEAST = 1e-3  # narrowest side of a pixel seen along its edge, so that nothing is divided by zero
_FAINT = 1e-6  # share below which a pill is not there


@njit(cache=True)
def ramps(x, s):  # pragma: no cover - compiled
    """First and second antiderivative of the normal distribution function of standard deviation s; s = 0: of a step."""
    if s == 0.0 or abs(x) > 8.0 * s:
        return max(x, 0.0), 0.5 * max(x, 0.0) ** 2 + (0.5 * s * s if x > 0.0 else 0.0)
    z = x / s
    below, density = 0.5 * math.erfc(-z * ROOT), _DENSITY * math.exp(-0.5 * z * z)
    return x * below + s * density, 0.5 * ((x * x + s * s) * below + x * s * density)


@njit(cache=True)
def cover(d, nx, ny, h, s):  # pragma: no cover - compiled
    """Share of a square of side h inside a straight edge at signed distance d (positive: its middle lies outside).

    The square seen along the edge is a trapezoid, the convolution of two boxes of widths h |nx| and h |ny|; a lens of
    blur s is convolved with it. Returns the share and its negative derivative by d; twin: `soft_image.cover_numpy`.
    """
    if d > ROOT * h + 6.0 * s or d < -ROOT * h - 6.0 * s:
        return (0.0, 0.0) if d > 0.0 else (1.0, 0.0)
    p, q = h * max(abs(nx), abs(ny)), h * max(min(abs(nx), abs(ny)), _LEAST)
    a1, b1 = ramps(0.5 * (p + q) - d, s)
    a2, b2 = ramps(0.5 * (p - q) - d, s)
    a3, b3 = ramps(0.5 * (q - p) - d, s)
    a4, b4 = ramps(-0.5 * (p + q) - d, s)
    share = (b1 - b2 - b3 + b4) / (p * q)
    return min(max(share, 0.0), 1.0), max((a1 - a2 - a3 + a4) / (p * q), 0.0)


@njit(cache=True)
def clear_pill(ox, oy, oz, dx, dy, dz, base, tip, radius, k, n):  # pragma: no cover - compiled
    """Distance of a ray from a pill (negative inside its silhouette) and ray parameter there; twin: `pills.clearance`.

    `n` receives the unit vector from the axis to the ray.
    """
    size = math.sqrt(dx * dx + dy * dy + dz * dz)
    ux, uy, uz = dx / size, dy / size, dz / size
    mx, my, mz = base[k, 0] - ox, base[k, 1] - oy, base[k, 2] - oz
    ax, ay, az = tip[k, 0] - base[k, 0], tip[k, 1] - base[k, 1], tip[k, 2] - base[k, 2]
    mu, au = mx * ux + my * uy + mz * uz, ax * ux + ay * uy + az * uz
    mx, my, mz = mx - mu * ux, my - mu * uy, mz - mu * uz
    ax, ay, az = ax - au * ux, ay - au * uy, az - au * uz
    across, taper = ax * ax + ay * ay + az * az, radius[k, 1] - radius[k, 0]
    s = 1.0 if taper > 0.0 else 0.0
    if across > taper * taper:
        s = -(mx * ax + my * ay + mz * az) / across
        hx, hy, hz = mx + s * ax, my + s * ay, mz + s * az
        h = math.sqrt(hx * hx + hy * hy + hz * hz)
        s = min(max(s + taper * h / math.sqrt(across * (across - taper * taper)), 0.0), 1.0)
    n[0], n[1], n[2] = -(mx + s * ax), -(my + s * ay), -(mz + s * az)
    gap = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if gap > 0.0:
        n[0], n[1], n[2] = n[0] / gap, n[1] / gap, n[2] / gap
    return gap - (radius[k, 0] + taper * s), (mu + s * au) / size


@njit(cache=True)
def shade_slope(c, x, y, z, slope):  # pragma: no cover - compiled
    """Grey level of a normal and its derivative by that normal; twin: `appearance.shaded` and its differences."""
    p0, q0 = (
        c[0] + x * (c[1] + x * (c[3] + x * (c[6] + x * c[10]))),
        c[1] + x * (2.0 * c[3] + x * (3.0 * c[6] + 4.0 * x * c[10])),
    )
    p1, q1 = c[2] + x * (c[4] + x * (c[7] + x * c[11])), c[4] + x * (2.0 * c[7] + 3.0 * x * c[11])
    p2, q2 = c[5] + x * (c[8] + x * c[12]), c[8] + 2.0 * x * c[12]
    p3 = c[9] + x * c[13]
    flat = p0 + y * (p1 + y * (p2 + y * (p3 + y * c[14])))
    r0, s0 = c[15] + x * (c[16] + x * (c[18] + x * c[21])), c[16] + x * (2.0 * c[18] + 3.0 * x * c[21])
    r1, s1 = c[17] + x * (c[19] + x * c[22]), c[19] + 2.0 * x * c[22]
    r2 = c[20] + x * c[23]
    deep = r0 + y * (r1 + y * (r2 + y * c[24]))
    slope[0] = q0 + y * (q1 + y * (q2 + y * c[13])) + z * (s0 + y * (s1 + y * c[23]))
    slope[1] = p1 + y * (2.0 * p2 + y * (3.0 * p3 + 4.0 * y * c[14])) + z * (r1 + y * (2.0 * r2 + 3.0 * y * c[24]))
    slope[2] = deep
    lit = c[25] * x + c[26] * y + c[27] * z
    if lit > 0.0:
        slope[0], slope[1], slope[2] = slope[0] + c[25], slope[1] + c[26], slope[2] + c[27]
    level = flat + z * deep + max(lit, 0.0)
    return level + table_slope(c, x, y, slope) if c.shape[0] > PLAIN else level


@njit(cache=True)
def table_slope(c, x, y, slope):  # pragma: no cover - compiled
    """What a table over the normal adds to a grey level, between its nodes; its derivative is added to `slope`.

    The table follows the PLAIN coefficients: CELLS + 1 nodes a side, from -1 to 1, rows along y.
    """
    u, v = 0.5 * CELLS * (x + 1.0), 0.5 * CELLS * (y + 1.0)
    i, j = min(max(int(u), 0), CELLS - 1), min(max(int(v), 0), CELLS - 1)
    u, v, at = u - i, v - j, PLAIN + j * (CELLS + 1) + i
    a, b, d, e = c[at], c[at + 1], c[at + CELLS + 1], c[at + CELLS + 2]
    slope[0] += 0.5 * CELLS * ((1.0 - v) * (b - a) + v * (e - d))
    slope[1] += 0.5 * CELLS * ((1.0 - u) * (d - a) + u * (e - b))
    return (1.0 - v) * ((1.0 - u) * a + u * b) + v * ((1.0 - u) * d + u * e)


@njit(cache=True)
def bend(g, n, x, base, tip, radius, k, out):  # pragma: no cover - compiled
    """Derivative by the surface point of what changes by g with the normal n: `out` = S g, S the curvature there."""
    ax, ay, az = tip[k, 0] - base[k, 0], tip[k, 1] - base[k, 1], tip[k, 2] - base[k, 2]
    length = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    along = (x[0] - base[k, 0]) * ax + (x[1] - base[k, 1]) * ay + (x[2] - base[k, 2]) * az
    taper = (radius[k, 0] - radius[k, 1]) / length
    if abs(taper) < 1.0 and radius[k, 0] * taper <= along <= length + radius[k, 1] * taper:
        # The cone bends about its axis only, with the radius of the sphere that touches it there.
        e0, e1, e2 = ay * n[2] - az * n[1], az * n[0] - ax * n[2], ax * n[1] - ay * n[0]
        r = (radius[k, 0] - taper * along) / (1.0 - taper * taper)
        ge = (g[0] * e0 + g[1] * e1 + g[2] * e2) / ((e0 * e0 + e1 * e1 + e2 * e2) * r)
        out[0], out[1], out[2] = ge * e0, ge * e1, ge * e2
        return
    r = radius[k, 0] if along < 0.5 * length else radius[k, 1]
    if abs(taper) >= 1.0:
        r = max(radius[k, 0], radius[k, 1])
    gn = g[0] * n[0] + g[1] * n[1] + g[2] * n[2]
    out[0], out[1], out[2] = (g[0] - gn * n[0]) / r, (g[1] - gn * n[1]) / r, (g[2] - gn * n[2]) / r


@njit(cache=True)
def wrench(force, x, base, k, scale, out, at):  # pragma: no cover - compiled
    """`scale * force . velocity(x)` as a row over the twist of link k, written to out[at : at + 6]."""
    rx, ry, rz = x[0] - base[k, 0], x[1] - base[k, 1], x[2] - base[k, 2]
    out[at], out[at + 1], out[at + 2] = scale * force[0], scale * force[1], scale * force[2]
    out[at + 3] = scale * (ry * force[2] - rz * force[1])
    out[at + 4] = scale * (rz * force[0] - rx * force[2])
    out[at + 5] = scale * (rx * force[1] - ry * force[0])


@njit(cache=True)
def see_pill(k, place, pinhole, pills, look, h, s, fact, row, work):  # pragma: no cover - compiled
    """What pill k shows in a square of side h: `fact` (FACTS) and rows over its twist, of level, distance and depth.

    `place` is X, Y and their slopes by pixel. False where the pill is not there. Where the edge runs through the square
    the grey level is that in the middle of the covered part, by the inverse Mills ratio. Twin:
    `soft_image.soft_image_numpy`, by differences.
    """
    base, tip, radius = pills
    shading, gain = look
    X, Y, Xx, Xy, Yx, Yy = place
    n, x, g, sg, seen = work[0], work[1], work[2], work[3], work[4]
    if pinhole:
        distance, depth = clear_pill(0.0, 0.0, 0.0, X, Y, 1.0, base, tip, radius, k, n)
    else:
        distance, depth = clear_pill(X, Y, 0.0, 0.0, 0.0, 1.0, base, tip, radius, k, n)
    far = depth if pinhole else 1.0
    gx, gy = far * (n[0] * Xx + n[1] * Yx), far * (n[0] * Xy + n[1] * Yy)
    size = math.sqrt(gx * gx + gy * gy)
    if size < 1e-12:  # on the axis, as far from the edge as can be
        if distance > 0.0:
            return False
        size, gx = 1e-12, 1e-12
    gx, gy, d = gx / size, gy / size, distance / size
    share, slope = cover(d, gx, gy, h, s)
    if share < _FAINT:
        return False
    fact[COVER], fact[SLOPE], fact[NX], fact[NY] = share, slope, gx, gy
    x[0], x[1], x[2] = (depth * X, depth * Y, depth) if pinhole else (X, Y, depth)
    inwards = 0.0
    width = math.sqrt(h * h / 12.0 + s * s)
    z = d / width
    if slope > 0.0 or z > -4.0:
        wrench(n, x, base, k, -1.0 / size, row, 6)
    if z > -4.0:
        mills = _DENSITY * math.exp(-0.5 * z * z) / (0.5 * math.erfc(z * ROOT)) if z < 8.0 else z + 1.0 / z
        inwards = mills * (mills - z)
        X, Y = X - width * mills * (Xx * gx + Xy * gy), Y - width * mills * (Yx * gx + Yy * gy)
    if pinhole:
        t, seen[0], seen[1], seen[2] = hit_pill(0.0, 0.0, 0.0, X, Y, 1.0, base, tip, radius, k)
    else:
        t, seen[0], seen[1], seen[2] = hit_pill(X, Y, 0.0, 0.0, 0.0, 1.0, base, tip, radius, k)
    hit = t < math.inf
    if hit:
        n[0], n[1], n[2], depth = seen[0], seen[1], seen[2], t
        x[0], x[1], x[2] = (t * X, t * Y, t) if pinhole else (X, Y, t)
    dn = n[0] * X + n[1] * Y + n[2] if pinhole else n[2]
    hit = hit and dn < -1e-9
    fact[HIT], fact[DEPTH], fact[TX], fact[TY] = 1.0 if hit else 0.0, depth, 0.0, 0.0
    fact[NORMAL], fact[NORMAL + 1], fact[NORMAL + 2] = n[0], n[1], n[2]
    fact[LEVEL] = gain[k] * shade_slope(shading, n[0], n[1], n[2], g)
    sg[0] = sg[1] = sg[2] = 0.0
    if hit:
        # A point of the surface stays on its ray: it slides by dt = n . w / n . d while the link moves by w.
        bend(g, n, x, base, tip, radius, k, sg)
        slide = (sg[0] * X + sg[1] * Y + sg[2] if pinhole else sg[2]) / dn
        for a in range(3):
            sg[a] = n[a] * slide - sg[a]
        wrench(n, x, base, k, 1.0 / dn, row, 12)
        far = t if pinhole else 1.0
        fact[TX], fact[TY] = -far * (n[0] * Xx + n[1] * Yx) / dn, -far * (n[0] * Xy + n[1] * Yy) / dn
    wrench(sg, x, base, k, gain[k], row, 0)
    row[3] += gain[k] * (n[1] * g[2] - n[2] * g[1])
    row[4] += gain[k] * (n[2] * g[0] - n[0] * g[2])
    row[5] += gain[k] * (n[0] * g[1] - n[1] * g[0])
    if inwards != 0.0 and hit:  # the place that is looked at moves with the edge
        ux, uy = inwards * far * (Xx * gx + Xy * gy), inwards * far * (Yx * gx + Yy * gy)
        shade, sink = gain[k] * (sg[0] * ux + sg[1] * uy), (n[0] * ux + n[1] * uy) / dn
        for a in range(6):
            row[a] += shade * row[6 + a]
            row[12 + a] += sink * row[6 + a]
    return True
