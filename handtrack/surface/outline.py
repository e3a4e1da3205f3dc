"""A posed surface in, how its vertices move and what its moving outline does to pixels out.

A piece of outline of length s that moves outwards by v n per unit of a joint turns background into surface: its pixel
changes by (inside - outside) v s.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..camera import Camera, project_with_jacobian
from .contour import contour_places, place_contour
from .image import Box, levels_at
from .raster import probe
from .shading import SurfaceAppearance
from .skin import Surface, edge_points, vertex_normals
from .templates import contact_table
from .view import View

_PIECE = 0.5  # pixels of outline taken at a time
_BESIDE = 0.2  # pixels from the outline at which both sides are looked at, as in the kernel


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Image places of all vertices' derivatives by the free joints: pixels, 1 / depth, normal in camera axes."""

    dxy: Float[np.ndarray, "v 2 k"]
    s: Float[np.ndarray, " v"]
    ds: Float[np.ndarray, "v k"]
    dn: Float[np.ndarray, "v 3 k"]


def vertex_motion(surface: Surface, camera: Camera, u: Float[np.ndarray, " k"]) -> Motion:
    """How every vertex and its normal move."""
    every = np.arange(surface.weight.shape[0])
    p, dp = edge_points(surface, np.stack([every, every], axis=1), np.zeros(every.size), u)
    _, d_normal = vertex_normals(surface, every, u)
    _, d_xy = project_with_jacobian(camera, p)
    s, ds = np.ones(every.size), np.zeros((every.size, u.size))
    if camera.kind == "perspective":
        s = 1.0 / (p @ camera.R[2] + camera.t[2])
        ds = -(s * s)[:, None] * (camera.R[2] @ dp)
    return Motion(d_xy @ dp, s, ds, camera.R @ d_normal)


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Pieces of outline, hidden ones included: places and normals (n, 2), `contact_table` (n, 4), motion along the
    normal by each joint (n, k), and length (n,), pixels."""

    origin: Float[np.ndarray, "n 2"]
    direction: Float[np.ndarray, "n 2"]
    contact: Float[np.ndarray, "n 4"]
    outwards: Float[np.ndarray, "n k"]
    length: Float[np.ndarray, " n"]


def outline_pieces(surface: Surface, camera: Camera, view: View, u: Float[np.ndarray, " k"], motion: Motion) -> Pieces:
    """Cut the outline into pieces of half a pixel."""
    at, length = contour_places(surface, view.mesh, _PIECE, 0.0)
    first, second = motion.dxy[at.vertex[:, 0]], motion.dxy[at.vertex[:, 1]]
    dxy = (1.0 - at.share)[:, None, None] * first + at.share[:, None, None] * second
    samplers = place_contour(surface, view.skin, view.mesh, camera, u, at)
    outwards = (samplers.direction[:, None, :] @ dxy)[:, 0, :]
    return Pieces(samplers.origin, samplers.direction, contact_table(surface, samplers, at, camera), outwards, length)


def outline_numpy(
    surface: Surface,
    view: View,
    pieces: Pieces,
    appearance: SurfaceAppearance,
    row_of: Int[np.ndarray, "h w"],
    box: Box,
) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, " n"]]:
    """What the kernel `add_outline` adds to the Jacobian, and the contrasts, in plain NumPy: its twin."""
    count = int(row_of.max()) + 1
    J, contrast = np.zeros((count, pieces.outwards.shape[1])), np.zeros(count)
    column, row = np.floor(pieces.origin.T + 0.5).astype(int) - np.array([[box.x0], [box.y0]])
    here = (row >= 0) & (column >= 0) & (row < row_of.shape[0]) & (column < row_of.shape[1])
    at = np.where(here, row_of[np.where(here, row, 0), np.where(here, column, 0)], -1)
    sides = [pieces.origin + step * pieces.direction for step in (-_BESIDE, _BESIDE)]
    first, second = (probe(view.mesh, view.tiles, points) for points in sides)
    own_depth, own, jump, reach = pieces.contact.T
    finger = np.where(first.triangle >= 0, surface.finger[surface.region[first.triangle]], -1)
    stranger = (finger >= 0) & (own >= 0) & (finger != own)
    back = view.mesh.area[first.triangle] > 0.0
    hidden = first.depth < own_depth - np.where(stranger, jump, reach)
    with np.errstate(invalid="ignore"):
        goes_on = (second.triangle >= 0) & (second.depth < first.depth + jump)
    seen = (first.triangle >= 0) & ~hidden & ~stranger & ~back & (first.depth <= own_depth + reach) & ~goes_on
    step = levels_at(surface, view, appearance, sides[0]) - levels_at(surface, view, appearance, sides[1])
    used = np.flatnonzero(seen & (at >= 0))
    noise = appearance.noise
    np.add.at(J, at[used], (-step * pieces.length / noise)[used, None] * pieces.outwards[used])
    np.maximum.at(contrast, at[used], np.abs(step[used]) / noise)
    return J, contrast
