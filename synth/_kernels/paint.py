"""The compiled loops that colour surfaces: solid textures, lights, pixels and samples.

Their plain twins are in `synth.labels.plain`. All work row by row: the hits of a row are gathered, placed and lit in
loops of their own, which compilers like better than one long one. `paint` (p, 10) holds each part's colour, second
colour, texture, 1 / grain, specular share in grey levels and shininess; `lights` (k, 6) directions and
strengths.
"""

import math

import numpy as np
from numba import njit

from .places import places
from .solids import pattern_of, ray_at

CELLS = 16  # the lattice of noise values repeats after so many cells
PLAIN, NOISE, STRIPES, CHECKER = 0, 1, 2, 3


@njit(cache=True, error_model="numpy", inline="always")
def value_noise(x, y, z, lattice):  # pragma: no cover - compiled
    """Smooth noise, 0..1: values on a lattice, blended by smooth steps."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    a, b, c = x - i, y - j, z - k
    a, b, c = a * a * (3.0 - 2.0 * a), b * b * (3.0 - 2.0 * b), c * c * (3.0 - 2.0 * c)
    last = CELLS - 1
    i0, j0, k0 = int(i) & last, int(j) & last, int(k) & last
    i1, j1, k1 = (i0 + 1) & last, (j0 + 1) & last, (k0 + 1) & last
    n00 = lattice[i0, j0, k0] + a * (lattice[i1, j0, k0] - lattice[i0, j0, k0])
    n10 = lattice[i0, j1, k0] + a * (lattice[i1, j1, k0] - lattice[i0, j1, k0])
    n01 = lattice[i0, j0, k1] + a * (lattice[i1, j0, k1] - lattice[i0, j0, k1])
    n11 = lattice[i0, j1, k1] + a * (lattice[i1, j1, k1] - lattice[i0, j1, k1])
    n0, n1 = n00 + b * (n10 - n00), n01 + b * (n11 - n01)
    return n0 + c * (n1 - n0)


@njit(cache=True, error_model="numpy")
def mix_colours(count, surface, part_of, paint, lattice, placed, out):  # pragma: no cover - compiled
    """Unlit colours of hits, from their own places, into the rows of `out`."""
    for i in range(count):
        part = part_of[surface[i]]
        grain, texture, share = paint[part, 7], int(paint[part, 6]), 0.0
        x, y, z = placed[3, i] * grain, placed[4, i] * grain, placed[5, i] * grain
        if texture == NOISE:
            share = value_noise(x, y, z, lattice)
        elif texture == STRIPES:
            share = 0.5 + 0.5 * math.sin(2.0 * math.pi * (x + 0.35 * y + 0.2 * z))
        elif texture == CHECKER:
            share = float((int(math.floor(x)) + int(math.floor(y)) + int(math.floor(z))) & 1)
        out[0, i] = paint[part, 0] + share * (paint[part, 3] - paint[part, 0])
        out[1, i] = paint[part, 1] + share * (paint[part, 4] - paint[part, 1])
        out[2, i] = paint[part, 2] + share * (paint[part, 5] - paint[part, 2])


@njit(cache=True, error_model="numpy")
def light_up(
    count, x, y, surface, pinhole, part_of, paint, lights, ambient, placed, work, out
):  # pragma: no cover - compiled
    """Colours of hits under all lights: `out` comes with the unlit ones. `work` (12, n) is room for numbers.

    Highlights follow Schlick's rational form of Phong's power, t / (n - n t + t) (Computer Graphics Forum 13(3), 1994).
    """
    shine = 0.0
    for i in range(count):
        part = part_of[surface[i]]
        work[0, i], work[1, i] = paint[part, 8], paint[part, 9]
        shine = max(shine, paint[part, 8])
        size = 1.0 / math.sqrt(x[i] * x[i] + y[i] * y[i] + 1.0) if pinhole else 1.0
        work[2, i], work[3, i], work[4, i] = (-x[i] * size, -y[i] * size, -size) if pinhole else (0.0, 0.0, -1.0)
        work[5, i] = placed[0, i] * work[2, i] + placed[1, i] * work[3, i] + placed[2, i] * work[4, i]
        for c in range(3):
            work[6 + c, i], work[9 + c, i] = ambient, 0.0
    for k in range(lights.shape[0]):
        lx, ly, lz = lights[k, 0], lights[k, 1], lights[k, 2]
        red, green, blue = lights[k, 3], lights[k, 4], lights[k, 5]
        for i in range(count):
            facing = placed[0, i] * lx + placed[1, i] * ly + placed[2, i] * lz
            facing = facing if facing > 0.0 else 0.0
            work[6, i] += red * facing
            work[7, i] += green * facing
            work[8, i] += blue * facing
        if shine == 0.0:
            continue
        for i in range(count):
            facing = placed[0, i] * lx + placed[1, i] * ly + placed[2, i] * lz
            t = 2.0 * facing * work[5, i] - (lx * work[2, i] + ly * work[3, i] + lz * work[4, i])
            t = t if t > 0.0 else 0.0
            t = t if facing > 0.0 else 0.0
            gloss = work[0, i] * t / (work[1, i] - work[1, i] * t + t)
            work[9, i] += red * gloss
            work[10, i] += green * gloss
            work[11, i] += blue * gloss
    for c in range(3):
        for i in range(count):
            out[c, i] = out[c, i] * work[6 + c, i] + work[9 + c, i]


@njit(cache=True, error_model="numpy")
def gather_samples(
    n, v, grid, part_of, places_in, surface, first, level, sample_depth, sample_surface, x, y, t, hit
):  # pragma: no cover - compiled
    """Add the samples of a row that need a light of their own to its hits: see `colour`."""
    for u in range(surface.shape[1]):
        at = first[v, u]
        if at < 0:
            continue
        k, pattern = surface[v, u], pattern_of(level[v, u])
        centre = part_of[k] if k >= 0 else -1
        last = centre
        for i in range(level[v, u]):
            k = sample_surface[at + i]
            if k < 0 or part_of[k] == centre or part_of[k] == last:
                continue
            last = part_of[k]
            x[n], y[n] = ray_at(grid, v, u, places_in[pattern, i, 0], places_in[pattern, i, 1])
            t[n], hit[n] = sample_depth[at + i], k
            n += 1
    return n


@njit(cache=True, error_model="numpy")
def spread(n, v, part_of, surface, first, level, sample_surface, background, shade, out):  # pragma: no cover - compiled
    """Colours of a row's pixels from those of its hits, in the order in which they were gathered."""
    m = 0
    for u in range(surface.shape[1]):
        k, at = surface[v, u], first[v, u]
        red, green, blue = 0.0, 0.0, 0.0
        if k >= 0:
            red, green, blue = shade[0, m], shade[1, m], shade[2, m]
            m += 1
            if at < 0:
                out[v, u, 0], out[v, u, 1], out[v, u, 2] = red, green, blue
        if at < 0:
            continue
        sum_r, sum_g, sum_b, share = 0.0, 0.0, 0.0, 1.0 / level[v, u]
        centre = part_of[k] if k >= 0 else -1
        last, r, g, b = centre, red, green, blue
        for i in range(level[v, u]):
            k = sample_surface[at + i]
            if k < 0:
                sum_r += background[v, u, 0]
                sum_g += background[v, u, 1]
                sum_b += background[v, u, 2]
            elif part_of[k] == centre:
                sum_r, sum_g, sum_b = sum_r + red, sum_g + green, sum_b + blue
            else:
                if part_of[k] != last:
                    last, r, g, b = part_of[k], shade[0, n], shade[1, n], shade[2, n]
                    n += 1
                sum_r, sum_g, sum_b = sum_r + r, sum_g + g, sum_b + b
        out[v, u, 0], out[v, u, 1], out[v, u, 2] = sum_r * share, sum_g * share, sum_b * share


@njit(cache=True, error_model="numpy")
def colour(
    grid, pinhole, tables, pills, frames, vertices, normals, rest, triangles, knot, blend, part_of, paint, lights,
    ambient, lattice, depth, surface, places_in, first, level, sample_depth, sample_surface, background, normal, out,
):  # pragma: no cover - compiled  # fmt: skip
    """Mean colour of every pixel: its centre's, or in edge pixels the mean over samples, against the background.

    A sample that sees the part of the centre, or the one seen just before, takes its light. Normals come out too.
    """
    w = surface.shape[1]
    most = w + max(1, sample_depth.size)
    x, y, t, hit = np.empty(most), np.empty(most), np.empty(most), np.empty(most, np.int32)
    placed, shade, work = np.empty((6, most)), np.empty((3, most)), np.empty((12, most))
    for v in range(surface.shape[0]):
        n = 0
        for u in range(w):
            if surface[v, u] >= 0:
                x[n], y[n] = grid[0, v + 1, u + 1], grid[1, v + 1, u + 1]
                t[n], hit[n] = depth[v, u], surface[v, u]
                n += 1
        count = gather_samples(
            n, v, grid, part_of, places_in, surface, first, level, sample_depth, sample_surface, x, y, t, hit
        )
        if count == 0:
            continue
        places(
            count, v, x, y, t, hit, pinhole, tables, pills, frames, vertices, normals, rest, triangles, knot, blend,
            placed,
        )  # fmt: skip
        mix_colours(count, hit, part_of, paint, lattice, placed, shade)
        light_up(count, x, y, hit, pinhole, part_of, paint, lights, ambient, placed, work, shade)
        spread(n, v, part_of, surface, first, level, sample_surface, background, shade, out)
        n = 0
        for u in range(w):
            if surface[v, u] >= 0:
                normal[v, u, 0], normal[v, u, 1], normal[v, u, 2] = placed[0, n], placed[1, n], placed[2, n]
                n += 1


@njit(cache=True, error_model="numpy")
def add_colour(
    grid, pinhole, tables, pills, frames, vertices, normals, rest, triangles, knot, blend, part_of, paint, lights,
    ambient, lattice, depth, surface, offset, background, weight, out,
):  # pragma: no cover - compiled  # fmt: skip
    """Add the colour at one place of every pixel with a weight: one moment of a blurred image."""
    w = surface.shape[1]
    x, y, t, hit = np.empty(w), np.empty(w), np.empty(w), np.empty(w, np.int32)
    placed, shade, work = np.empty((6, w)), np.empty((3, w)), np.empty((12, w))
    for v in range(surface.shape[0]):
        n = 0
        for u in range(w):
            if surface[v, u] >= 0:
                x[n], y[n] = ray_at(grid, v, u, offset[0], offset[1])
                t[n], hit[n] = depth[v, u], surface[v, u]
                n += 1
        places(
            n, v, x, y, t, hit, pinhole, tables, pills, frames, vertices, normals, rest, triangles, knot, blend, placed
        )
        mix_colours(n, hit, part_of, paint, lattice, placed, shade)
        light_up(n, x, y, hit, pinhole, part_of, paint, lights, ambient, placed, work, shade)
        n = 0
        for u in range(w):
            if surface[v, u] >= 0:
                for c in range(3):
                    out[v, u, c] += weight * shade[c, n]
                n += 1
            else:
                for c in range(3):
                    out[v, u, c] += weight * background[v, u, c]


@njit(cache=True, error_model="numpy")
def normals_at(
    grid, pinhole, tables, pills, frames, vertices, normals, rest, triangles, knot, blend, depth, surface, out
):  # pragma: no cover - compiled
    """Unit outward normal of every pixel that sees a surface."""
    w = surface.shape[1]
    x, y, t, hit, placed = np.empty(w), np.empty(w), np.empty(w), np.empty(w, np.int32), np.empty((6, w))
    for v in range(surface.shape[0]):
        n = 0
        for u in range(w):
            if surface[v, u] >= 0:
                x[n], y[n] = grid[0, v + 1, u + 1], grid[1, v + 1, u + 1]
                t[n], hit[n] = depth[v, u], surface[v, u]
                n += 1
        places(
            n, v, x, y, t, hit, pinhole, tables, pills, frames, vertices, normals, rest, triangles, knot, blend, placed
        )
        n = 0
        for u in range(w):
            if surface[v, u] >= 0:
                out[v, u, 0], out[v, u, 1], out[v, u, 2] = placed[0, n], placed[1, n], placed[2, n]
                n += 1
