"""Solids at a few instants and a camera in, the arrays that the compiled loops walk over out.

A global shutter needs one instant. A rolling shutter reads row after row: the solids are given at `KNOTS` instants from
the first row to the last, and run linearly between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from handtrack.camera import Camera
from handtrack.pills import Pills

from .. import _kernels
from ..raycast import border_bounds, pill_boxes, pill_table
from .solids import Solids

KNOTS = 9
Span = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Surfaces in a window of the image; pills come first, then triangles.

    Attributes
    ----------
    span : (x0, x1, y0, y1)
        The window, half open.
    lens : (fx, fy, cx, cy)
    bend : (5,)
        Distortion.
    straight : bool
        Whether there is none.
    grid : (2, h + 2, w + 2)
        Normalised coordinates of the window's pixels and a border.
    tables : (count, step)
        Number of pills, and the step in the tables from one image row to the next: 0 unless the shutter rolls.
    pills, frames : (n, 11), (n, 12)
        Tables of pills, and base and axes of their frames.
    vertices, normals : (k, v, 3), (k, v, 3)
    knot, blend : (h,), (h,)
        Instants between which each row is read.
    boxes : (l + t, 4)
        Window pixels (x0, x1, y0, y1) that hold each surface.
    part_of : (l + t,)
        Part of each surface.
    """

    span: Span
    lens: tuple[float, float, float, float]
    bend: Float[np.ndarray, " 5"]
    straight: bool
    pinhole: bool
    grid: Float[np.ndarray, "2 hp wp"]
    tables: tuple[int, int]
    pills: Float[np.ndarray, "n 11"]
    frames: Float[np.ndarray, "n 12"]
    vertices: Float[np.ndarray, "k v 3"]
    normals: Float[np.ndarray, "k v 3"]
    rest: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "t 3"]
    knot: Int[np.ndarray, " h"]
    blend: Float[np.ndarray, " h"]
    boxes: Int[np.ndarray, "s 4"]
    part_of: Int[np.ndarray, " s"]


def instants(readout: float) -> Float[np.ndarray, " k"]:
    """Shares of the frame interval at which a sensor's solids are given.

    >>> instants(0.0).tolist(), instants(0.5)[[0, -1]].tolist()
    ([0.0], [-0.25, 0.25])
    """
    return np.zeros(1) if readout == 0.0 else np.linspace(-0.5, 0.5, KNOTS) * readout


def row_instants(height: int, knots: int) -> tuple[Int[np.ndarray, " h"], Float[np.ndarray, " h"]]:
    """For each row of the image the knot before its reading, and the share of the way to the next one."""
    if knots == 1:
        return np.zeros(height, np.int64), np.zeros(height)
    at = np.arange(height) / max(height - 1, 1) * (knots - 1)
    knot = np.minimum(at.astype(np.int64), knots - 2)
    return knot, at - knot


def boxes_of(solids: Sequence[Solids], camera: Camera) -> Int[np.ndarray, "s 4"]:
    """Image pixels (x0, x1, y0, y1), half open, that hold each surface at and between the instants.

    What moves in a straight line between two places stays inside the box around both.
    """
    each = np.stack([pill_boxes(s.pills, camera) for s in solids])
    empty = (each[..., 0] >= each[..., 1]) | (each[..., 2] >= each[..., 3])
    low = np.where(empty[..., None], max(camera.width, camera.height), each[..., ::2]).min(axis=0)
    high = np.where(empty[..., None], 0, each[..., 1::2]).max(axis=0)
    first = np.column_stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]])
    triangles = solids[0].triangles
    boxes = np.zeros((first.shape[0] + triangles.shape[0], 4), np.int64)
    boxes[: first.shape[0]] = first
    if triangles.shape[0]:
        vertices = np.stack([s.vertices for s in solids])
        straight, view, bulge = _view(camera)
        lens = (camera.fx, camera.fy, camera.cx, camera.cy)
        size, pinhole = (camera.width, camera.height), camera.kind == "perspective"
        into = boxes[first.shape[0] :]
        _kernels.triangle_boxes(
            vertices, triangles, lens, camera.distortion, straight, pinhole, view, bulge, size, into
        )
    return boxes


@lru_cache(maxsize=8)
def _view(camera: Camera) -> tuple[bool, tuple[float, float, float, float], float]:
    """Whether rays are not bent; bounds x0, x1, y0, y1 of the image's normalised coordinates; bulge of edges.

    The second derivative of the distortion along any direction is at most 6 |k1| r + 20 |k2| r^3 + 42 |k3| r^5 +
    6 |p1| + 6 |p2|, and a curve leaves its chord by at most an eighth of that times the squared length.
    """
    low, high = border_bounds(camera)
    r = float(np.hypot(*np.maximum(np.abs(low), np.abs(high))))
    k1, k2, p1, p2, k3 = np.abs(camera.distortion).tolist()
    second = 6.0 * k1 * r + 20.0 * k2 * r**3 + 42.0 * k3 * r**5 + 6.0 * (p1 + p2)
    view = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    return not camera.distortion.any(), view, 0.125 * second * max(camera.fx, camera.fy)


def hull(boxes: Int[np.ndarray, "s 4"], camera: Camera) -> Span:
    """Window around all boxes that are not empty, and one pixel more, inside the image."""
    full = boxes[(boxes[:, 1] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 2])]
    if not full.size:
        return 0, 0, 0, 0
    x0, y0 = np.maximum(full[:, [0, 2]].min(axis=0) - 1, 0).tolist()
    x1, y1 = np.minimum(full[:, [1, 3]].max(axis=0) + 1, (camera.width, camera.height)).tolist()
    return x0, x1, y0, y1


def geometry(
    solids: Sequence[Solids], camera: Camera, boxes: Int[np.ndarray, "s 4"], span: Span, grid: np.ndarray | None = None
) -> Geometry:
    """Arrays of the surfaces inside a window.

    Parameters
    ----------
    solids : sequence of Solids
        At one instant, or at `KNOTS` from the first row's reading to the last's.
    boxes : (s, 4)
        From `boxes_of`.
    span : (x0, x1, y0, y1)
        Window that holds them.
    grid : array, optional
        Of an earlier geometry with the same window.
    """
    x0, _, y0, y1 = span
    lens, straight = (camera.fx, camera.fy, camera.cx, camera.cy), not camera.distortion.any()
    knot, blend = (rows[y0:y1] for rows in row_instants(camera.height, len(solids)))
    rows = y1 - y0 if len(solids) > 1 else 1
    base, tip = (of_rows(np.stack([getattr(s.pills, end) for s in solids]), knot, blend) for end in ("base", "tip"))
    radius = np.tile(solids[0].pills.radius, (rows, 1))
    table = pill_table(Pills(base.reshape(-1, 3), tip.reshape(-1, 3), radius))
    count = solids[0].pills.base.shape[0]
    return Geometry(
        span,
        lens,
        camera.distortion,
        straight,
        camera.kind == "perspective",
        window_grid(camera, span) if grid is None else grid,
        (count, count if rows > 1 else 0),
        table,
        frames_of(solids, knot, blend),
        np.stack([s.vertices for s in solids]),
        np.stack([s.normals for s in solids]),
        solids[0].rest,
        solids[0].triangles,
        knot,
        blend,
        np.ascontiguousarray(boxes - np.array([x0, x0, y0, y0])).clip(0),
        np.concatenate([solids[0].pill_part, solids[0].triangle_part]),
    )


def window_grid(camera: Camera, span: Span) -> Float[np.ndarray, "2 hp wp"]:
    """Normalised coordinates of a window's pixel centres, with a border one pixel wide."""
    x0, x1, y0, y1 = span
    grid = np.empty((2, y1 - y0 + 2, x1 - x0 + 2))
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    _kernels.window_grid(lens, camera.distortion, not camera.distortion.any(), x0 - 1, y0 - 1, grid)
    return grid


def frames_of(
    solids: Sequence[Solids], knot: Int[np.ndarray, " h"], blend: Float[np.ndarray, " h"]
) -> Float[np.ndarray, "n 12"]:
    """Base and axes of the pills' frames, for the rows of a window where the shutter rolls."""
    base = np.stack([s.pills.base for s in solids])
    axes = np.stack([s.pill_axes.reshape(-1, 9) for s in solids])
    return of_rows(np.concatenate([base, axes], axis=2), knot, blend).reshape(-1, 12)


def of_rows(
    values: Float[np.ndarray, "k l c"], knot: Int[np.ndarray, " h"], blend: Float[np.ndarray, " h"]
) -> Float[np.ndarray, "n l c"]:
    """Values of each row from those at the knots; those given if there is one knot."""
    if values.shape[0] == 1:
        return values
    return values[knot] + blend[:, None, None] * (values[knot + 1] - values[knot])
