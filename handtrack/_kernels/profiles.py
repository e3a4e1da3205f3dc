"""Compiled loops over profiles and normals: sampling an image, shading."""

import math

from numba import njit


@njit(cache=True, inline="always")
def cubic_weight(d):  # pragma: no cover - compiled
    """Keys' cubic convolution kernel with a = -1/2."""
    d = abs(d)
    if d <= 1.0:
        return 1.0 + d * d * (1.5 * d - 2.5)
    if d < 2.0:
        return 2.0 + d * (-4.0 + d * (2.5 - 0.5 * d))
    return 0.0


@njit(cache=True, inline="always", error_model="numpy")
def sample_cubic(image, x, y):  # pragma: no cover - compiled
    """One bicubic sample inside the image; part of `sample_lines`, twin: `profiles.sample_numpy`."""
    height, width = image.shape
    x0, y0 = int(math.floor(x)), int(math.floor(y))
    total = 0.0
    for r in range(-1, 3):
        row = min(max(y0 + r, 0), height - 1)
        line = 0.0
        for c in range(-1, 3):
            line += image[row, min(max(x0 + c, 0), width - 1)] * cubic_weight(x - x0 - c)
        total += line * cubic_weight(y - y0 - r)
    return total


@njit(cache=True, error_model="numpy")
def sample_lines(image, origin, direction, u, order, values, inside):  # pragma: no cover - compiled
    """Interpolate an image along straight paths, order 0, 1 or 3; twin: `profiles.sample_numpy`."""
    height, width = image.shape
    for i in range(origin.shape[0]):
        px, py, dx, dy = origin[i, 0], origin[i, 1], direction[i, 0], direction[i, 1]
        for j in range(u.shape[0]):
            x, y = px + u[j] * dx, py + u[j] * dy
            if not (0.0 <= x <= width - 1 and 0.0 <= y <= height - 1):
                values[i, j], inside[i, j] = 0.0, False
                continue
            inside[i, j] = True
            if order == 1:
                x0, y0 = int(x), int(y)
                fx, fy = x - x0, y - y0
                x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
                top = image[y0, x0] * (1.0 - fx) + image[y0, x1] * fx
                bottom = image[y1, x0] * (1.0 - fx) + image[y1, x1] * fx
                values[i, j] = top * (1.0 - fy) + bottom * fy
            elif order == 0:
                values[i, j] = image[int(math.floor(y + 0.5)), int(math.floor(x + 0.5))]
            else:
                values[i, j] = sample_cubic(image, x, y)


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
