"""Compiled reading of grey levels well inside the surface of links."""

import math

import numpy as np
from numba import njit

from .geometry import hit_known, pill_facts
from .placing import bend, pixel_ray
from .profiles import shade
from .templates import near_pills


@njit(cache=True, error_model="numpy")
def image_axes(base, tip, radius, ortho, intrinsic, k, rim):  # pragma: no cover - compiled
    """Base, tip and mean radius of every link in pixels, NaN behind the camera, and the area of them all.

    Part of `read_patches`; twin: `shading_cost.read_patches_numpy`.
    """
    links, area = base.shape[0], 0.0
    flat, focal = np.full((links, 6), np.nan), 0.5 * (intrinsic[0] + intrinsic[1])
    for m in range(links):
        bx, by, tx, ty, unit = base[m, 0], base[m, 1], tip[m, 0], tip[m, 1], focal
        if not ortho:
            if base[m, 2] <= 0.0 or tip[m, 2] <= 0.0:
                continue
            bx, by = bend(bx / base[m, 2], by / base[m, 2], k)
            tx, ty = bend(tx / tip[m, 2], ty / tip[m, 2], k)
            x, y, z = base[m, 0] + tip[m, 0], base[m, 1] + tip[m, 1], base[m, 2] + tip[m, 2]
            unit = focal / (0.5 * math.sqrt(x * x + y * y + z * z))
        flat[m, 0], flat[m, 1] = bx * intrinsic[0] + intrinsic[2], by * intrinsic[1] + intrinsic[3]
        flat[m, 2] = tx * intrinsic[0] + intrinsic[2] - flat[m, 0]
        flat[m, 3] = ty * intrinsic[1] + intrinsic[3] - flat[m, 1]
        flat[m, 4], flat[m, 5] = (
            math.sqrt(flat[m, 2] ** 2 + flat[m, 3] ** 2),
            0.5 * (radius[m, 0] + radius[m, 1]) * unit,
        )
        area += 2.0 * flat[m, 5] * (flat[m, 4] + flat[m, 5])
    return flat, area


@njit(cache=True, error_model="numpy")
def near_link(m, flat, ortho, intrinsic, k, facts, chosen, ray, slope, more):  # pragma: no cover - compiled
    """Pills that may be seen within a link's outline and `more` pixels around it, and how many.

    Part of `read_patches`; twin: `shading_cost.read_patches_numpy`.
    """
    x, y = flat[m, 0] + 0.5 * flat[m, 2], flat[m, 1] + 0.5 * flat[m, 3]
    pixel_ray(x, y, ortho, intrinsic, k, ray)
    pixel_ray(x + 1.0, y, ortho, intrinsic, k, slope)
    for a in range(6):
        slope[a] -= ray[a]
    half = 1.2 * (0.5 * flat[m, 4] + 1.5 * flat[m, 5] + more)  # distortion may stretch what lies farther out
    return near_pills(ray, slope, half, 0.0, facts, chosen)


@njit(cache=True, error_model="numpy")
def sees(x, y, pill, ortho, intrinsic, k, facts, chosen, count, ray, normal):  # pragma: no cover - compiled
    """Whether a pixel shows this pill, with its normal; part of `read_patches`, twin: `pills.ray_hits_numpy`."""
    pixel_ray(x, y, ortho, intrinsic, k, ray)
    dd = ray[3] * ray[3] + ray[4] * ray[4] + ray[5] * ray[5]
    first, normal[0], normal[1], normal[2] = hit_known(ray[0], ray[1], ray[2], ray[3], ray[4], ray[5], dd, facts, pill)
    if not first < math.inf:
        return False
    for c in range(count):
        if chosen[c] != pill:
            t, _, _, _ = hit_known(ray[0], ray[1], ray[2], ray[3], ray[4], ray[5], dd, facts, chosen[c])
            if t < first:
                return False
    return True


@njit(cache=True, error_model="numpy")
def read_patches(
    image, base, tip, radius, wanted, ortho, intrinsic, k, blur, shading, gain, grid, sums
):  # pragma: no cover - compiled
    """Count, sum of expected levels and of differences in the 3 x 3 patches of every wanted link, into `sums`.

    `grid` holds the rim in radii, the least spacing, the number of pixels and the levels a sensor may have cut. A pixel
    counts where it and its neighbours on all four sides show the link. Twin: `shading_cost.read_patches_numpy`.
    """
    rim, closest, most, black, white = grid
    height, width = image.shape
    facts = pill_facts(base, tip, radius)
    flat, area = image_axes(base, tip, radius, ortho, intrinsic, k, rim)
    spacing, margin = max(closest, math.sqrt(area / most)), 2.5 * blur + 1.5
    chosen, ray, slope = np.empty(base.shape[0], np.int64), np.empty(6), np.empty(6)
    normal, beside = np.empty(3), np.empty(3)
    sums[:] = 0.0
    for m in range(base.shape[0]):
        if not wanted[m] or np.isnan(flat[m, 0]):
            continue
        count = near_link(m, flat, ortho, intrinsic, k, facts, chosen, ray, slope, margin)
        length, size = flat[m, 4], flat[m, 5]
        ax, ay = (flat[m, 2] / length, flat[m, 3] / length) if length > 1e-6 else (1.0, 0.0)
        outer, reach = rim * size, length + 2.0 * rim * size
        rows, columns = max(int(reach / spacing), 2), max(int(2.0 * outer / spacing), 2)
        for i in range(rows):
            s = length + outer if i == rows - 1 else i * (reach / (rows - 1)) - outer
            for j in range(columns):
                c = outer if j == columns - 1 else j * (2.0 * outer / (columns - 1)) - outer
                x, y = np.rint(flat[m, 0] + s * ax - c * ay), np.rint(flat[m, 1] + s * ay + c * ax)
                if not (margin <= x <= width - 1 - margin and margin <= y <= height - 1 - margin):
                    continue
                level = float(image[int(y), int(x)])
                if not black < level < white:
                    continue
                if not sees(x, y, m, ortho, intrinsic, k, facts, chosen, count, ray, normal):
                    continue
                if not (
                    sees(x + margin, y, m, ortho, intrinsic, k, facts, chosen, count, ray, beside)
                    and sees(x - margin, y, m, ortho, intrinsic, k, facts, chosen, count, ray, beside)
                    and sees(x, y + margin, m, ortho, intrinsic, k, facts, chosen, count, ray, beside)
                    and sees(x, y - margin, m, ortho, intrinsic, k, facts, chosen, count, ray, beside)
                ):
                    continue
                expected = shade(shading, gain[m], normal[0], normal[1], normal[2])
                cell = 3 * min(3 * i // (rows - 1), 2) + min(3 * j // (columns - 1), 2)
                sums[m, cell, 0] += 1.0
                sums[m, cell, 1] += expected
                sums[m, cell, 2] += level - expected
