"""Pills in, the light on the facets of their coarse meshes out: flat and Gouraud shading without a mesh.

The hand thesis (section 10.2) draws pills as patches: flat shading gives a facet one colour, Gouraud shading blends the
colours of its corners. Here a hit keeps its exact place, and only its light is that of the facet it lies in. A facet is found
by its ring (cap, side, cap: polar angle on the caps, position along the axis on the side) and its sector around the axis.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from handtrack.pills import Pills


@dataclass(frozen=True, slots=True, eq=False)
class FacetMesh:
    """Facet meshes of all pills.

    Attributes
    ----------
    frames : (l, 5, 3)
        Base of the axis, unit axis, two unit vectors across it, and (length, slope of the side, base radius).
    counts : (3,)
        Rings on each cap, rings on the side, sectors around.
    """

    frames: Float[np.ndarray, "l 5 3"]
    counts: Int[np.ndarray, " 3"]


def facet_mesh(pills: Pills, cap: int, side: int, around: int) -> FacetMesh:
    """Coarse mesh of each pill; a pill of which one sphere holds the other is that sphere.

    The vectors across the axis turn with it without a jump, save where it points straight at the camera.
    """
    base, axis, radius = pills.base.copy(), pills.tip - pills.base, pills.radius[:, 0].copy()
    length = np.linalg.norm(axis, axis=1)
    grows = pills.radius[:, 1] - pills.radius[:, 0]
    ball = length <= np.abs(grows)
    base[ball & (grows > 0)] = pills.tip[ball & (grows > 0)]
    radius[ball] = pills.radius.max(axis=1)[ball]
    unit = np.where(ball[:, None], [1.0, 0.0, 0.0], axis / np.where(ball, 1.0, length)[:, None])
    slope = np.where(ball, 0.0, -grows / np.where(ball, 1.0, length))
    x, y, z = unit.T
    k = 1.0 / np.maximum(1.0 + z, 1e-12)
    first = np.column_stack([1.0 - x * x * k, -x * y * k, -x])
    first[z < -1.0 + 1e-9] = [1.0, 0.0, 0.0]
    numbers = np.column_stack([np.where(ball, 0.0, length), slope, radius])
    frames = np.stack([base, unit, first, np.cross(unit, first), numbers], axis=1)
    return FacetMesh(frames, np.array([cap, side, around]))


def facet_points(
    mesh: FacetMesh, ring: Float[np.ndarray, " r"], sector: Float[np.ndarray, " c"]
) -> tuple[Float[np.ndarray, "l r c 3"], Float[np.ndarray, "l r c 3"]]:
    """Points and outward normals of all pills at given rings and sectors; the inverse of `facet_place`."""
    cap, side, around = mesh.counts
    length, slope, radius = (mesh.frames[:, 4, i, None, None] for i in range(3))
    low, mid, high = np.clip(ring / cap, 0, 1), np.clip((ring - cap) / side, 0, 1), np.clip((ring - cap - side) / cap, 0, 1)
    low, mid, high = low[:, None], mid[:, None], high[:, None]
    lean = np.where(high > 0, np.cos(np.arccos(slope) * (1.0 - high)), -np.cos(np.arccos(-slope) * low))
    centre = mid * length
    turn = (sector / around - 0.5) * 2.0 * np.pi
    axis, first, second = (mesh.frames[:, i, None, None, :] for i in (1, 2, 3))
    across = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    normal = lean[..., None] * axis + np.sqrt(np.maximum(1.0 - lean**2, 0.0))[..., None] * across
    point = mesh.frames[:, 0, None, None, :] + centre[..., None] * axis + (radius - slope * centre)[..., None] * normal
    return point, normal


def facet_place(
    mesh: FacetMesh, pill: Int[np.ndarray, " n"], p: Float[np.ndarray, "n 3"], n: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Continuous ring and sector of surface points: the twin of `_kernels.facet_place`.

    The sphere that touches the surface at p has its centre (axial - r0 s) / (1 - s^2) along the axis, kept on it.
    """
    cap, side, around = mesh.counts
    f = mesh.frames[pill]
    length, slope, radius = f[:, 4].T
    lean = (n * f[:, 1]).sum(axis=1)
    axial = ((p - f[:, 0]) * f[:, 1]).sum(axis=1)
    along = np.minimum(np.maximum((axial - radius * slope) / (1.0 - slope * slope), 0.0), length)
    ring = side * np.where(length > 0, along / np.where(length > 0, length, 1.0), 0.0)
    ring = ring + cap * np.minimum(np.arccos(np.clip(-lean, -1, 1)) / np.arccos(-slope), 1.0)
    ring = ring + cap * np.maximum(1.0 - np.arccos(np.clip(lean, -1, 1)) / np.arccos(slope), 0.0)
    turn = np.arctan2((n * f[:, 3]).sum(axis=1), (n * f[:, 2]).sum(axis=1))
    return ring, (turn / (2.0 * np.pi) + 0.5) * around


def facet_number(
    mesh: FacetMesh, ring: Float[np.ndarray, " n"], sector: Float[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Facet that a place lies in."""
    cap, side, around = mesh.counts
    return np.minimum(ring.astype(int), 2 * cap + side - 1), np.minimum(sector.astype(int), around - 1)


def facet_light(
    mesh: FacetMesh,
    table: Float[np.ndarray, "l r c 2"],
    pill: Int[np.ndarray, " n"],
    ring: Float[np.ndarray, " n"],
    sector: Float[np.ndarray, " n"],
    smooth: bool,
) -> Float[np.ndarray, "n 2"]:
    """Light (body, gloss) of the facets, or blended between their corners: the twin of `_kernels.facet_light`."""
    i, j = facet_number(mesh, ring, sector)
    if not smooth:
        return table[pill, i, j]
    a, b = (ring - i)[:, None], (sector - j)[:, None]
    k = (j + 1) % mesh.counts[2]
    low = (1.0 - a) * (1.0 - b) * table[pill, i, j] + (1.0 - a) * b * table[pill, i, k]
    return low + a * (1.0 - b) * table[pill, i + 1, j] + a * b * table[pill, i + 1, k]
