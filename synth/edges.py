"""Pixels on edges in, the mean of the image over each of them out: the anti-aliasing.

Within one pixel an edge is nearly straight. Two lines are laid across it, at the Gauss nodes y = ±1/(2 sqrt 3) of the
pixel, and on each the crossing is found by bisection to 1/400 pixel; through both crossings goes the
edge

    x = middle + slope y,        area on its left  A = integral of clip(x, -1/2, 1/2) + 1/2 over |y| <= 1/2

and the pixel shows A (mean light on the left) + (1 - A) (mean on the right), each mean from two Gauss nodes on each
line. A regular grid of as many rays would move an upright edge in steps of its spacing. Where several edges meet in a
pixel, the mean is that of the 89 points of a Fibonacci lattice.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from handtrack.camera import Camera

from . import _kernels
from .raycast import first_hits, pixel_grid, surface_points
from .shading import Look, surface

GAUSS = _kernels.GAUSS
Place = float | Float[np.ndarray, " n"]  # along a pixel's lines, or from line to line: -1/2 to 1/2 inside the pixel
Sample = Callable[[Place, Place], tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]]


@dataclass(frozen=True, slots=True, eq=False)
class EdgePixels:
    """Pixels to integrate: column, row, whether lines run along x, whether several edges meet there."""

    u: Int[np.ndarray, " n"]
    v: Int[np.ndarray, " n"]
    across: Bool[np.ndarray, " n"]
    junction: Bool[np.ndarray, " n"]


def edge_pixels(keys: Int[np.ndarray, "h w"], part: Int[np.ndarray, "h w"]) -> EdgePixels:
    """Pixels whose key differs from that of a neighbour in their row or column; outside the image lies background.

    A straight edge that parts a pixel's centre from none of these four does not cut the pixel: its corner is the mean
    of two of them. Lines run along x where more keys change from left to right than from top to bottom.
    """
    padded = np.pad(keys, 1, constant_values=-1)
    edge = (padded[:-2, 1:-1] != keys) | (padded[2:, 1:-1] != keys)
    v, u = np.nonzero(edge | (padded[1:-1, :-2] != keys) | (padded[1:-1, 2:] != keys))
    votes = np.zeros(u.size, dtype=int)
    for i in range(3):
        votes += padded[v + i, u] != padded[v + i, u + 2]
        votes -= padded[v, u + i] != padded[v + 2, u + i]
    near = np.arange(9)
    around = v[:, None] + near // 3, u[:, None] + near % 3
    parts = np.pad(part, 1, constant_values=-1)
    junction = (_different(parts[around]) > 2) | (_different(padded[around]) > 2)
    return EdgePixels(u, v, votes >= 0, junction)


def _different(values: Int[np.ndarray, "n m"]) -> Int[np.ndarray, " n"]:
    """Number of different values in each row."""
    ordered = np.sort(values, axis=1)
    return 1 + (ordered[:, 1:] != ordered[:, :-1]).sum(axis=1)


def covered(middle: Float[np.ndarray, " n"], slope: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Area of the unit pixel left of the line x = middle + slope y: the twin of `_kernels.covered`.

    With H the integral of the clip (z^2 / 2 up to |z| = 1/2, then |z| / 2 - 1/8) it is
    1/2 + (H(middle + slope / 2) - H(middle - slope / 2)) / slope.

    >>> covered(np.array([0.0, 0.25, 0.5]), np.array([3.0, 0.0, 1.0])).tolist()
    [0.5, 0.75, 0.875]
    """
    steep = np.abs(slope) >= 1e-6
    total = np.zeros(middle.size)
    for sign in (-1.0, 1.0):
        z = np.abs(middle + 0.5 * sign * slope)
        total = total + sign * np.where(z <= 0.5, 0.5 * z * z, 0.5 * z - 0.125)
    upright = 0.5 + np.clip(middle, -0.5, 0.5)
    return np.where(steep, 0.5 + total / np.where(steep, slope, 1.0), upright)


def crossing(
    key: Callable[[Float[np.ndarray, " n"]], Int[np.ndarray, " n"]], n: int
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Keys at both ends of lines, and where the first ends (the far end if both agree): twin of `_kernels.crossing`."""
    low, high = np.full(n, -_kernels.REACH), np.full(n, _kernels.REACH)
    first, last = key(low), key(high)
    for _ in range(_kernels.HALVINGS):
        cut = 0.5 * (low + high)
        same = key(cut) == first
        low, high = np.where(same, cut, low), np.where(same, high, cut)
    return first, last, np.where(first == last, _kernels.REACH, 0.5 * (low + high))


def edge_means(
    camera: Camera, look: Look, albedo: Float[np.ndarray, "l c"], edge: EdgePixels, behind: Float[np.ndarray, "n c"]
) -> Float[np.ndarray, "n c"]:
    """Mean of the image over edge pixels, of which `behind` is the background."""
    grid = pixel_grid(camera)
    u, v, across = edge.u + 1, edge.v + 1, edge.across[:, None]
    right, down = 0.5 * (grid[v, u + 1] - grid[v, u - 1]), 0.5 * (grid[v + 1, u] - grid[v - 1, u])
    along, step = np.where(across, right, down), np.where(across, down, right)
    out, torn = np.empty(behind.shape), edge.junction.copy()

    def sampler(of: Bool[np.ndarray, " n"]) -> Sample:
        xy, a, b = grid[v, u][of], along[of], step[of]
        return lambda at, offset: see(camera, look, xy + np.reshape(at, (-1, 1)) * a + np.reshape(offset, (-1, 1)) * b)

    single = ~torn
    out[single], plain = integrate_numpy(sampler(single), albedo, behind[single])
    if look.mode != _kernels.FLAT:
        torn[single] = ~plain
    out[torn] = scatter_numpy(sampler(torn), albedo, behind[torn])
    return out


def scatter_numpy(
    sample: Sample, albedo: Float[np.ndarray, "l c"], behind: Float[np.ndarray, "n c"]
) -> Float[np.ndarray, "n c"]:
    """Mean over pixels where several edges meet, by a Fibonacci lattice: the twin of `_kernels.scatter`."""
    count = _kernels.LATTICE
    total = np.zeros(behind.shape)
    for i in range(count):
        pill, _, lit = sample((i + 0.5) / count - 0.5, ((i * _kernels.STRIDE) % count + 0.5) / count - 0.5)
        total += np.where(pill[:, None] < 0, behind, albedo[pill] * lit[:, :1] + lit[:, 1:]) / count
    return total


def integrate_numpy(
    sample: Sample,
    albedo: Float[np.ndarray, "l c"],
    behind: Float[np.ndarray, "n c"],
) -> tuple[Float[np.ndarray, "n c"], Bool[np.ndarray, " n"]]:
    """Mean over pixels cut by one edge, by the rule above: the twin of `_kernels.integrate`.

    The second result says whether all that was seen on either side of the edge is what its ends show.
    """
    n = behind.shape[0]
    f0, l0, c0 = crossing(lambda at: sample(at, -GAUSS)[1], n)
    f1, l1, c1 = crossing(lambda at: sample(at, GAUSS)[1], n)
    whole0, whole1 = f0 == l0, f1 == l1
    c0 = np.where(whole0 & ~whole1 & (f0 == l1), -_kernels.REACH, c0)
    c1 = np.where((whole1 & ~whole0 & (f1 == l0)) | (whole0 & whole1 & (f0 != f1)), -_kernels.REACH, c1)
    area = covered(0.5 * (c0 + c1), 0.5 * (c1 - c0) / GAUSS)
    total, plain = np.zeros(behind.shape), np.ones(n, dtype=bool)
    for share, sense, key0, key1 in ((area, 1.0, f0, f1), (1.0 - area, -1.0, l0, l1)):
        empty, none = (key0 < 0) & (key1 < 0), share <= 0.0
        mean = np.zeros(behind.shape)
        w0, w1 = np.clip(0.5 + sense * c0, 0.0, 1.0), np.clip(0.5 + sense * c1, 0.0, 1.0)
        corner = w0 + w1 <= 0.0
        first_line = (c0 > c1) == (sense > 0)
        w0, w1 = np.where(corner & first_line, 1e-6, w0), np.where(corner & ~first_line, 1e-6, w1)
        outward = np.where(corner, 0.5, GAUSS)
        for w, offset in ((w0, -outward), (w1, outward)):
            for sign in (-1.0, 1.0):
                pill, key, lit = sample(sense * (-0.5 + w * (0.5 + sign * GAUSS)), offset)
                value = np.where(pill[:, None] < 0, behind, albedo[pill] * lit[:, :1] + lit[:, 1:])
                plain &= empty | none | (w <= 0.0) | (key == key0) | (key == key1)
                mean += (0.5 * w / (w0 + w1))[:, None] * value
        total += share[:, None] * np.where(empty[:, None], behind, mean)
    return total, plain


def see(
    camera: Camera, look: Look, xy: Float[np.ndarray, "n 2"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Pill, key (-1 both on the background) and light on rays given by normalised coordinates."""
    depth, part = first_hits(look.rows, camera, xy)
    inside = part >= 0
    key, lit = np.full(part.size, -1), np.zeros((part.size, 2))
    key[inside], lit[inside] = surface(look, camera, part[inside], surface_points(camera, xy[inside], depth[inside]))
    return part, key, lit
