"""Posed pills in, an anti-aliased grey or colour image out.

Away from edges a pixel shows the light at its centre. Where the part (or facet) seen differs among a pixel and its eight
neighbours, the pixel integrates the image over its area: on each of four lines across the pixel, laid across the edge, the
crossing is found by bisection (to 1/128 pixel) and both pieces are integrated by two-point Gauss quadrature,

    I = 1/m sum_lines sum_pieces |piece| / 2 (f(x-) + f(x+)),    x± = middle ± |piece| / (2 sqrt 3)

which places an edge far better than a regular grid of as many rays: that moves it in steps of its spacing.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from handtrack.camera import Camera
from handtrack.pills import Pills

from . import _kernels
from .raycast import RenderBuffers, cast, cast_numpy, first_hits, pill_boxes, pill_normal, pill_table, pixel_grid, surface_points
from .shading import Light, Look, Material, Mode, make_look, surface

REC_601 = np.array([0.299, 0.587, 0.114])
GAUSS = 0.5 / np.sqrt(3.0)  # offset of the two nodes from the middle of an interval of length 1


@dataclass(frozen=True, slots=True, eq=False)
class EdgePixels:
    """Pixels to integrate: column, row, whether lines run along x, and the pills seen in the neighbourhood."""

    u: Int[np.ndarray, " n"]
    v: Int[np.ndarray, " n"]
    across: Bool[np.ndarray, " n"]
    chosen: Bool[np.ndarray, "n l"]


def render(
    pills: Pills,
    camera: Camera,
    material: Material,
    light: Light,
    mode: Mode = "phong",
    *,
    colour: bool = False,
    background: float | Float[np.ndarray, "h w"] | Float[np.ndarray, "h w 3"] = 0.0,
) -> Float[np.ndarray, "h w"] | Float[np.ndarray, "h w 3"]:
    """Image of posed pills.

    Parameters
    ----------
    pills : Pills
        In camera axes.
    mode : {"binary", "flat", "gouraud", "phong"}
    colour : bool
        Red, green, blue instead of grey (Rec. 601 weights of the albedo).
    background : float or array
        Grey level, or an image of the camera's size.

    Returns
    -------
    (h, w) or (h, w, 3) float32
        Grey levels, nominally 0..255; neither clipped nor rounded.

    Examples
    --------
    >>> from handtrack.camera import orthographic
    >>> camera = orthographic(4, 1, 1.0, 0.0, 0.0, np.eye(3), np.zeros(3))
    >>> bar = Pills(np.array([[-50.0, 0.0, 0.0]]), np.array([[-9.0, 0.0, 0.0]]), np.array([[10.75, 10.75]]))
    >>> white, front = Material(np.full((1, 3), 200.0)), Light(np.array([0.0, 0.0, -1.0]))
    >>> render(bar, camera, white, front, "binary").round().tolist()
    [[200.0, 200.0, 49.0, 0.0]]
    """
    look, albedo, out = _prepare(pills, camera, material, light, mode, colour, background)
    buffers = cast(pills, camera)
    mesh = (look.mesh.frames, look.mesh.counts, look.table)
    _kernels.shade_pixels(
        pixel_grid(camera),
        camera.kind == "perspective",
        pill_table(pills),
        pill_boxes(pills, camera),
        buffers.depth,
        buffers.part,
        buffers.normal,
        (look.mode, look.coefficients, look.light, mesh),
        albedo,
        np.full(buffers.part.shape, -1, dtype=np.int32),
        out,
    )
    return out if colour else out[..., 0]


def render_numpy(
    pills: Pills,
    camera: Camera,
    material: Material,
    light: Light,
    mode: Mode = "phong",
    *,
    colour: bool = False,
    background: float | Float[np.ndarray, "h w"] | Float[np.ndarray, "h w 3"] = 0.0,
) -> Float[np.ndarray, "h w"] | Float[np.ndarray, "h w 3"]:
    """The same as `render` in plain NumPy: the twin that the compiled loops are tested and timed against."""
    look, albedo, out = _prepare(pills, camera, material, light, mode, colour, background)
    shade_numpy(pills, camera, cast_numpy(pills, camera), look, albedo, out)
    return out if colour else out[..., 0]


def _prepare(
    pills: Pills,
    camera: Camera,
    material: Material,
    light: Light,
    mode: Mode,
    colour: bool,
    background: float | Float[np.ndarray, "h w"] | Float[np.ndarray, "h w 3"],
) -> tuple[Look, Float[np.ndarray, "l c"], Float[np.ndarray, "h w c"]]:
    """Look, albedo of the channels wanted, and the image as the empty background."""
    links = pills.base.shape[0]
    if material.albedo.shape[0] != links:
        raise ValueError(f"material: albedo has {material.albedo.shape[0]} rows; wanted one for each of {links} pills")
    albedo = material.albedo if colour else material.albedo @ REC_601[:, None]
    channels = 3 if colour else 1
    behind = np.asarray(background, dtype=np.float32)
    if behind.ndim == 3 and not colour:
        behind = behind @ REC_601.astype(np.float32)
    if behind.ndim and behind.shape[:2] != (camera.height, camera.width):
        raise ValueError(
            f"background: its shape {behind.shape[:2]} is not the camera's (height, width) {(camera.height, camera.width)}"
        )
    out = np.empty((camera.height, camera.width, channels), dtype=np.float32)
    out[:] = behind[..., None] if behind.ndim == 2 else behind
    return make_look(pills, camera, material, light, mode), np.ascontiguousarray(albedo), out


def edge_pixels(keys: Int[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels whose key differs from that of any of their eight neighbours."""
    padded = np.pad(keys, 1, mode="edge")
    low = high = keys
    for dv in range(3):
        for du in range(3):
            near = padded[dv : dv + keys.shape[0], du : du + keys.shape[1]]
            low, high = np.minimum(low, near), np.maximum(high, near)
    return low != high


def shade_numpy(
    pills: Pills,
    camera: Camera,
    buffers: RenderBuffers,
    look: Look,
    albedo: Float[np.ndarray, "l c"],
    out: Float[np.ndarray, "h w c"],
) -> None:
    """Shade into `out`, which holds the background: the twin of `_kernels.shade_pixels`."""
    inside = buffers.part >= 0
    xy = pixel_grid(camera)[1:-1, 1:-1][inside]
    pill = buffers.part[inside].astype(int)
    p_cam = surface_points(camera, xy, buffers.depth[inside])
    key, lit = surface(look, camera, pill, p_cam, buffers.normal[inside])
    keys = np.full(inside.shape, -1)
    keys[inside] = key
    edge = edge_pixels(keys)
    values = albedo[pill] * lit[:, :1] + lit[:, 1:]
    even = inside & ~edge
    out[even] = values[even[inside]]
    v, u = np.nonzero(edge)
    if v.size:
        pixels = EdgePixels(u, v, _across(keys, u, v), _neighbours(buffers.part, u, v, pills.base.shape[0]))
        out[v, u] = integrate_numpy(pill_table(pills), camera, look, albedo, pixels, out[v, u].astype(float))


def _across(
    keys: Int[np.ndarray, "h w"], u: Int[np.ndarray, " n"], v: Int[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Whether the edge in each pixel is crossed best by horizontal lines: more changes from left to right than down."""
    padded = np.pad(keys, 1, mode="edge")
    votes = np.zeros(u.size, dtype=int)
    for i in range(3):
        votes += padded[v + i, u] != padded[v + i, u + 2]
        votes -= padded[v, u + i] != padded[v + 2, u + i]
    return votes >= 0


def _neighbours(
    part: Int[np.ndarray, "h w"], u: Int[np.ndarray, " n"], v: Int[np.ndarray, " n"], pills: int
) -> Bool[np.ndarray, "n l"]:
    """Which pills are seen by a pixel or one of its eight neighbours."""
    padded = np.pad(part, 1, mode="edge")
    seen = np.zeros((u.size, pills + 1), dtype=bool)
    for dv in range(3):
        for du in range(3):
            seen[np.arange(u.size), padded[v + dv, u + du]] = True  # the background, -1, goes to the spare last column
    return seen[:, :-1]


def integrate_numpy(
    table: Float[np.ndarray, "l 11"],
    camera: Camera,
    look: Look,
    albedo: Float[np.ndarray, "l c"],
    pixels: EdgePixels,
    background: Float[np.ndarray, "n c"],
) -> Float[np.ndarray, "n c"]:
    """Mean of the image over edge pixels, by the rule above: the twin of `_kernels.integrate`."""
    grid = pixel_grid(camera)
    u, v, across = pixels.u + 1, pixels.v + 1, pixels.across[:, None]
    right, down = 0.5 * (grid[v, u + 1] - grid[v, u - 1]), 0.5 * (grid[v + 1, u] - grid[v - 1, u])
    along, step = np.where(across, right, down), np.where(across, down, right)
    total = np.zeros_like(background)
    ends = np.full(u.size, -0.5), np.full(u.size, 0.5)
    for line in range(_kernels.LINES):
        start = grid[v, u] + ((line + 0.5) / _kernels.LINES - 0.5) * step

        def sample(at, start=start):
            return _sample(table, camera, look, start + at[:, None] * along, pixels.chosen)

        cut = _crossing(sample, *ends)
        for low, high in ((ends[0], cut), (cut, ends[1])):
            for sign in (-1.0, 1.0):
                pill, _, lit = sample(0.5 * (low + high) + sign * (high - low) * GAUSS)
                value = np.where(pill[:, None] < 0, background, albedo[pill] * lit[:, :1] + lit[:, 1:])
                total += (0.5 * (high - low) / _kernels.LINES)[:, None] * value
    return total


def _crossing(sample, low: Float[np.ndarray, " n"], high: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Where on its line each pixel's key first changes, by bisection; its end where both ends agree."""
    first, last, end = sample(low)[1], sample(high)[1], high
    for _ in range(_kernels.HALVINGS):
        cut = 0.5 * (low + high)
        same = sample(cut)[1] == first
        low, high = np.where(same, cut, low), np.where(same, high, cut)
    return np.where(first != last, 0.5 * (low + high), end)


def _sample(
    table: Float[np.ndarray, "l 11"],
    camera: Camera,
    look: Look,
    xy: Float[np.ndarray, "n 2"],
    chosen: Bool[np.ndarray, "n l"],
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Pill, key (-1 both on the background) and light on rays given by normalised coordinates."""
    depth, part = first_hits(table, camera, xy, chosen)
    inside = part >= 0
    key, lit = np.full(part.size, -1), np.zeros((part.size, 2))
    p_cam = surface_points(camera, xy[inside], depth[inside])
    key[inside], lit[inside] = surface(look, camera, part[inside], p_cam, pill_normal(table[part[inside]], p_cam))
    return part, key, lit
