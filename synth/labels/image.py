"""What pixels see, paint and lights in, a colour image as a sensor delivers it out."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from jaxtyping import Float, UInt8
from scipy.special import ndtri

from .. import _kernels
from ..mesh import sample_places
from .geometry import Geometry, Span
from .seen import Seen, places, scan
from .shot import Exposure
from .solids import Lights, Paint

NORMALS = 65521  # a prime, so that stretches that begin at random do not line up
MOMENTS = 16  # images that a blurred one is the mean of, each at its own place in the pixel


@lru_cache(maxsize=1)
def lattice() -> Float[np.ndarray, "c c c"]:
    """Values that the noise texture blends; fixed, so that a texture is decided by its paint alone."""
    return np.random.default_rng(20051).random((_kernels.CELLS,) * 3, np.float32)


@lru_cache(maxsize=1)
def _normals() -> Float[np.ndarray, " n"]:
    """Standard normal numbers that noise is cut from: every quantile once, shuffled; then the first ones again."""
    values = ndtri((np.arange(NORMALS) + 0.5) / NORMALS).astype(np.float32)
    values = np.random.default_rng(20052).permutation(values)
    return np.tile(values, 2)


@lru_cache(maxsize=4)
def _across(width: int) -> Float[np.ndarray, " w"]:
    """Squared distance of columns from the middle, three values each."""
    x = np.arange(width) - 0.5 * (width - 1)
    return np.repeat(x * x, 3)


def sensed(
    background: UInt8[np.ndarray, "h w 3"],
    window: Float[np.ndarray, "a b 3"],
    span: Span,
    exposure: Exposure,
    key: np.uint64,
    out: UInt8[np.ndarray, "h w 3"],
) -> None:
    """The whole image as the sensor delivers it, into `out`: gain, vignette, noise, rounding.

    Parameters
    ----------
    window : (a, b, 3)
        Colours at `span` of the background.
    key : uint64
        From `noise_key`.
    """
    height, width = background.shape[:2]
    if 3 * width > NORMALS:
        raise ValueError(f"background: {width} pixels wide; wanted at most {NORMALS // 3}")
    far = max(0.25 * ((width - 1) ** 2 + (height - 1) ** 2), 1e-300)
    across = (_across(width) / far).astype(np.float32)
    line = np.empty(3 * width, np.float32)
    flat = (height, 3 * width)
    _kernels.sensed(
        np.ascontiguousarray(background).reshape(flat), window.reshape(window.shape[0], 3 * window.shape[1]), span,
        exposure.gain, exposure.vignette, across, exposure.noise, _normals()[: NORMALS + 3 * width], key, line,
        out.reshape(flat),
    )  # fmt: skip


def paint_table(paint: Paint) -> Float[np.ndarray, "p 10"]:
    """Rows for the compiled loops; see `synth._kernels.paint`."""
    return np.column_stack(
        [paint.colour, paint.second, paint.texture, 1.0 / paint.grain, 255.0 * paint.specular, paint.shininess]
    )


def light_table(lights: Lights) -> Float[np.ndarray, "k 6"]:
    """Rows for the compiled loops; see `synth._kernels.paint`."""
    return np.column_stack([lights.direction, lights.strength])


def coloured(
    geometry: Geometry, seen: Seen, paint: Paint, lights: Lights, background: UInt8[np.ndarray, "h w 3"]
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w 3"]]:
    """Sharp colours of a window, before the sensor, and the normals of its pixel centres.

    Parameters
    ----------
    background : (h, w, 3)
        Of the window.
    """
    g, out = geometry, background.astype(np.float32)
    normal = np.zeros_like(out)
    _kernels.colour(
        g.grid, g.pinhole, g.tables, g.pills, g.frames, g.vertices, g.normals, g.rest, g.triangles, g.knot, g.blend,
        g.part_of, paint_table(paint), light_table(lights), lights.ambient, lattice(), seen.depth, seen.surface,
        places(), seen.first, seen.level, seen.sample_depth, seen.sample_surface, background, normal, out,
    )  # fmt: skip
    return out, normal


def blurred(
    moments: Sequence[Geometry], paint: Paint, lights: Lights, background: UInt8[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w 3"]:
    """Colours of a window while the shutter is open: the mean over moments, each at another place in the pixel."""
    out = np.zeros(background.shape, np.float32)
    offsets = sample_places(len(moments)).tolist()
    table, light = paint_table(paint), light_table(lights)
    for g, offset in zip(moments, offsets, strict=True):
        depth, surface, _ = scan(g, tuple(offset))
        _kernels.add_colour(
            g.grid, g.pinhole, g.tables, g.pills, g.frames, g.vertices, g.normals, g.rest, g.triangles, g.knot, g.blend,
            g.part_of, table, light, lights.ambient, lattice(), depth, surface, tuple(offset), background,
            1.0 / len(moments), out,
        )  # fmt: skip
    return out


def normals_of(geometry: Geometry, seen: Seen) -> Float[np.ndarray, "h w 3"]:
    """Unit outward normals at the pixel centres of a window, zero where nothing is."""
    g, out = geometry, np.zeros((*seen.surface.shape, 3), np.float32)
    _kernels.normals_at(
        g.grid, g.pinhole, g.tables, g.pills, g.frames, g.vertices, g.normals, g.rest, g.triangles, g.knot, g.blend,
        seen.depth, seen.surface, out,
    )  # fmt: skip
    return out


def noise_key(seed: int, index: int) -> np.uint64:
    """Where the noise of an image starts in the stream of random bits."""
    return np.random.SeedSequence([seed, 9, index]).generate_state(1, np.uint64)[0]
