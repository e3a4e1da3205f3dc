"""Geometry in, what every pixel sees of it out: depth, surface, bits of all parts, and the same at samples of edges.

A pixel is what its centre sees. Where a part begins or ends in a pixel, samples spread over it say how much of it is
whose: 8 in a pixel as a rule, 16 for parts of fewer than 250 pixels, and 64 all over those of fewer than 60, so that
areas of small parts are as exact as those of large ones.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int, UInt8, UInt64

from .. import _kernels
from ..mesh import sample_places
from .geometry import Geometry

MANY, FEW = 250, 60  # pixels below which a part's edges get 16 samples, and all its pixels 64


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What the pixels of a window see.

    Attributes
    ----------
    depth : (h, w)
        inf where nothing is.
    surface : (h, w)
        Number of the first surface; -1 where nothing is.
    part : (h, w)
        Part of that surface; -1 where nothing is.
    bits : (h, w)
        Parts whose surface lies on the ray.
    first, level : (h, w), (h, w)
        First sample of an edge pixel (-1 elsewhere), and how many it has.
    sample_depth, sample_surface, sample_bits : (n,), (n,), (n,)
    """

    depth: Float[np.ndarray, "h w"]
    surface: Int[np.ndarray, "h w"]
    part: Int[np.ndarray, "h w"]
    bits: UInt64[np.ndarray, "h w"]
    first: Int[np.ndarray, "h w"]
    level: UInt8[np.ndarray, "h w"]
    sample_depth: Float[np.ndarray, " n"]
    sample_surface: Int[np.ndarray, " n"]
    sample_bits: UInt64[np.ndarray, " n"]


@lru_cache(maxsize=1)
def places() -> Float[np.ndarray, "3 64 2"]:
    """Offsets of 8, 16 and 64 samples from a pixel's centre; the last are a grid of 8 by 8."""
    out = np.zeros((3, 64, 2))
    for i, count in enumerate((8, 16)):
        out[i, :count] = sample_places(count)
    out[2] = np.stack(np.meshgrid(*2 * [(np.arange(8) + 0.5) / 8 - 0.5]), axis=-1).reshape(64, 2)
    return out


def scan(geometry: Geometry, offset: tuple[float, float] = (0.0, 0.0)):
    """Depth, surface and bits at one place of every pixel of the window."""
    shape = (geometry.grid.shape[1] - 2, geometry.grid.shape[2] - 2)
    depth, surface = np.full(shape, np.inf), np.full(shape, -1, np.int32)
    bits = np.zeros(shape, np.uint64)
    g = geometry
    _kernels.scan(
        g.grid, g.pinhole, g.tables, g.pills, g.vertices, g.triangles, g.knot, g.blend, g.boxes, g.part_of, offset,
        depth, surface, bits,
    )  # fmt: skip
    return depth, surface, bits


def see(geometry: Geometry, parts: int) -> Seen:
    """What every pixel of a window sees, with samples where parts begin and end."""
    g = geometry
    depth, surface, bits = scan(g)
    count, part = np.zeros(parts, np.int64), np.empty(surface.shape, np.int16)
    _kernels.parts_seen(surface, g.part_of, bits, part, count)
    level_of = np.where(count < FEW, -64, np.where(count < MANY, 16, 8))
    first, level = np.full(surface.shape, -1, np.int32), np.zeros(surface.shape, np.uint8)
    near = np.zeros(surface.shape, np.uint64)
    total = _kernels.find_edges(part, bits, g.part_of, level_of, g.boxes, first, level, near)
    sample_depth, sample_surface = np.full(total, np.inf), np.full(total, -1, np.int32)
    sample_bits = np.zeros(total, np.uint64)
    _kernels.scan_samples(
        g.grid, g.pinhole, g.tables, g.pills, g.vertices, g.triangles, g.knot, g.blend, g.boxes, g.part_of, places(),
        first, level, near, sample_depth, sample_surface, sample_bits,
    )  # fmt: skip
    return Seen(depth, surface, part, bits, first, level, sample_depth, sample_surface, sample_bits)
