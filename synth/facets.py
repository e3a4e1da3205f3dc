"""Pills in, the light on the facets of their coarse meshes out: flat and Gouraud shading without a mesh.

The hand thesis (section 10.2) draws pills as patches: flat shading gives a facet one colour, Gouraud shading blends
the colours of its corners. Here a hit keeps its exact place, and only its light is that of the facet it lies in. A
facet is found by its ring (cap, side, cap: polar angle on the caps, position along the axis on the side) and its
sector around the axis. `counts` says how many: rings on each cap, rings on the side, sectors around.
"""

import numpy as np
from jaxtyping import Float, Int

Counts = tuple[int, int, int]


def facet_rows(table: Float[np.ndarray, "l 11"]) -> Float[np.ndarray, "l 17"]:
    """Rows of `synth.raycast.pill_table` with two unit vectors across the axis, from which sectors are counted.

    The vectors turn with the axis without a jump, save where it points straight at the camera.
    """
    unit = table[:, 3:6]
    x, y, z = unit.T
    k = 1.0 / np.maximum(1.0 + z, 1e-12)
    first = np.column_stack([1.0 - x * x * k, -x * y * k, -x])
    first[z < -1.0 + 1e-9] = [1.0, 0.0, 0.0]
    return np.hstack([table, first, np.cross(unit, first)])


def facet_points(
    rows: Float[np.ndarray, "l 17"], counts: Counts, ring: Float[np.ndarray, " r"], sector: Float[np.ndarray, " c"]
) -> tuple[Float[np.ndarray, "l r c 3"], Float[np.ndarray, "l r c 3"]]:
    """Points and outward normals of all pills at given rings and sectors; the inverse of `facet_place`."""
    cap, side, around = counts
    base, axis, first, second = (rows[:, None, None, i : i + 3] for i in (0, 3, 11, 14))
    length, radius, slope = (rows[:, i, None, None] for i in (6, 7, 9))
    low, mid, high = (
        np.clip(x, 0.0, 1.0)[:, None] for x in (ring / cap, (ring - cap) / side, (ring - cap - side) / cap)
    )
    lean = np.where(high > 0, np.cos(np.arccos(slope) * (1.0 - high)), -np.cos(np.arccos(-slope) * low))
    centre = mid * length
    turn = (sector / around - 0.5) * 2.0 * np.pi
    across = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    normal = lean[..., None] * axis + np.sqrt(np.maximum(1.0 - lean**2, 0.0))[..., None] * across
    return base + centre[..., None] * axis + (radius - slope * centre)[..., None] * normal, normal


def facet_place(
    rows: Float[np.ndarray, "n p"], counts: Counts, p: Float[np.ndarray, "n 3"], n: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Continuous ring and sector of surface points, each on the pill of its row: the twin of `_kernels.facet_place`.

    The sphere that touches the surface at p has its centre (axial - r0 s) / (1 - s^2) along the axis, kept on it.
    """
    cap, side, around = counts
    axis, (length, radius, slope, c2) = rows[:, 3:6], rows[:, [6, 7, 9, 10]].T
    lean = (n * axis).sum(axis=1)
    axial = ((p - rows[:, :3]) * axis).sum(axis=1)
    along = np.minimum(np.maximum((axial - radius * slope) / c2, 0.0), length)
    ring = side * np.where(length > 0, along / np.where(length > 0, length, 1.0), lean > 0)
    ring = ring + cap * np.minimum(np.arccos(np.clip(-lean, -1, 1)) / np.arccos(-slope), 1.0)
    ring = ring + cap * np.maximum(1.0 - np.arccos(np.clip(lean, -1, 1)) / np.arccos(slope), 0.0)
    turn = np.arctan2((n * rows[:, 14:17]).sum(axis=1), (n * rows[:, 11:14]).sum(axis=1))
    return ring, (turn / (2.0 * np.pi) + 0.5) * around


def facet_number(
    counts: Counts, ring: Float[np.ndarray, " n"], sector: Float[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Facet (ring, sector) that a place lies in.

    >>> facet_number((3, 4, 16), np.array([2.5, 10.0]), np.array([0.0, 16.0]))
    (array([2, 9]), array([ 0, 15]))
    """
    cap, side, around = counts
    return np.minimum(ring.astype(int), 2 * cap + side - 1), np.minimum(sector.astype(int), around - 1)


def facet_light(
    light: Float[np.ndarray, "l r c 2"],
    counts: Counts,
    pill: Int[np.ndarray, " n"],
    ring: Float[np.ndarray, " n"],
    sector: Float[np.ndarray, " n"],
    smooth: bool,
) -> Float[np.ndarray, "n 2"]:
    """Light (body, gloss) of the facets, or blended between their corners: the twin of `_kernels.facet_light`."""
    i, j = facet_number(counts, ring, sector)
    if not smooth:
        return light[pill, i, j]
    a, b = (ring - i)[:, None], (sector - j)[:, None]
    k = (j + 1) % counts[2]
    low = (1.0 - a) * (1.0 - b) * light[pill, i, j] + (1.0 - a) * b * light[pill, i, k]
    return low + a * (1.0 - b) * light[pill, i + 1, j] + a * b * light[pill, i + 1, k]
