"""Posed pills in, an anti-aliased grey or colour image out.

A pixel shows the light at its centre, save where the part (or facet) seen differs from that of a neighbour in its row
or column: there it shows the mean over its area, from `synth.edges`.
"""

import math

import numpy as np
from jaxtyping import Float

from handtrack.camera import Camera
from handtrack.pills import Pills

from . import _kernels
from .edges import edge_means, edge_pixels
from .raycast import RenderBuffers, cast_depth, cast_numpy, hull_box, pill_boxes, pixel_grid, surface_points
from .shading import Light, Look, Material, Mode, make_look, surface

REC_601 = np.array([0.299, 0.587, 0.114])
Background = float | Float[np.ndarray, "h w"] | Float[np.ndarray, "h w 3"]


def render(
    pills: Pills,
    camera: Camera,
    material: Material,
    light: Light,
    mode: Mode = "phong",
    *,
    colour: bool = False,
    background: Background = 0.0,
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
    [[200.0, 200.0, 50.0, 0.0]]
    """
    look, albedo, out = _prepare(pills, camera, material, light, mode, colour, background)
    boxes = pill_boxes(pills, camera)
    rows = np.hstack([look.rows, look.facets.reshape(look.rows.shape[0], math.prod(look.facets.shape[1:]))])
    depth, part = cast_depth(rows, boxes, camera)
    grid, pinhole, span = pixel_grid(camera), camera.kind == "perspective", hull_box(boxes, camera)
    numbers = (look.mode, look.coefficients, tuple(look.light.tolist()), look.counts)
    keys = np.minimum(part, 0) if look.mode == _kernels.BINARY else part
    if look.mode == _kernels.FLAT:
        keys = part.copy()
        _kernels.key_pixels(grid, pinhole, rows, span, depth, part, look.counts, keys)
    _kernels.shade_pixels(grid, pinhole, rows, boxes, span, depth, part, numbers, albedo, keys, out)
    return out if colour else out[..., 0]


def render_numpy(
    pills: Pills,
    camera: Camera,
    material: Material,
    light: Light,
    mode: Mode = "phong",
    *,
    colour: bool = False,
    background: Background = 0.0,
) -> Float[np.ndarray, "h w"] | Float[np.ndarray, "h w 3"]:
    """The same as `render` in plain NumPy: the twin that the compiled loops are tested and timed against."""
    look, albedo, out = _prepare(pills, camera, material, light, mode, colour, background)
    shade_numpy(camera, cast_numpy(pills, camera), look, albedo, out)
    return out if colour else out[..., 0]


def _prepare(
    pills: Pills,
    camera: Camera,
    material: Material,
    light: Light,
    mode: Mode,
    colour: bool,
    background: Background,
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
        wanted = (camera.height, camera.width)
        raise ValueError(f"background: its height and width are {behind.shape[:2]}; the camera's, {wanted}, are wanted")
    out = np.empty((camera.height, camera.width, channels), dtype=np.float32)
    out[:] = behind[..., None] if behind.ndim == 2 else behind
    return make_look(pills, camera, material, light, mode), np.ascontiguousarray(albedo), out


def shade_numpy(
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
    key, lit = surface(look, camera, pill, surface_points(camera, xy, buffers.depth[inside]))
    keys = np.full(inside.shape, -1)
    keys[inside] = key
    behind = out.astype(float)
    out[inside] = albedo[pill] * lit[:, :1] + lit[:, 1:]
    edge = edge_pixels(keys, buffers.part)
    out[edge.v, edge.u] = edge_means(camera, look, albedo, edge, behind[edge.v, edge.u])
