"""Random sizes in, the still part of a work cell out: table, shelf, boxes, floor and walls, all turned boxes.

The cell's frame: the person stands at the origin; x to the right, y forward, z up, metres. A box is turned about z
alone. In its own axes a ray hits it where the three slabs' intervals of the ray parameter overlap, and a point's
distance is `|max(q, 0)| + min(max(q), 0)` with `q = |x| - half`.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ._kernels.boxes import box_distance

# Corners of a cube, and its twelve triangles turned outward.
_CORNERS = np.array([[x, y, z] for z in (-1.0, 1.0) for y in (-1.0, 1.0) for x in (-1.0, 1.0)])
_FACES = np.array(
    [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
     [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]]
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Boxes:
    """Boxes turned about z: centre (b, 3), half size (b, 3), metres, and turn (b,), radians."""

    centre: Float[np.ndarray, "b 3"]
    half: Float[np.ndarray, "b 3"]
    turn: Float[np.ndarray, " b"]


@dataclass(frozen=True, slots=True, eq=False)
class Shelf:
    """Where a shelf may be reached into.

    Attributes
    ----------
    corner : (3,)
        Left lower corner of its open front.
    turn : float
        Radians about z; 0 opens toward the person.
    width, depth : float
        Of the compartments, metres.
    floors : (n,)
        Height of each compartment's floor above the corner.
    clear : (n,)
        Height of each compartment.
    """

    corner: Float[np.ndarray, " 3"]
    turn: float
    width: float
    depth: float
    floors: Float[np.ndarray, " n"]
    clear: Float[np.ndarray, " n"]

    @property
    def inward(self) -> Float[np.ndarray, " 3"]:
        """Unit vector into the shelf."""
        return np.array([-math.sin(self.turn), math.cos(self.turn), 0.0])

    def place(self, level: int, across: float, deep: float, high: float) -> Float[np.ndarray, " 3"]:
        """A point in a compartment from shares of its width, depth and height."""
        right = np.array([math.cos(self.turn), math.sin(self.turn), 0.0])
        rise = self.floors[level] + high * self.clear[level]
        return self.corner + across * self.width * right + deep * self.depth * self.inward + [0.0, 0.0, rise]


@dataclass(frozen=True, slots=True, eq=False)
class Furniture:
    """The still cell: all its boxes, the shelf, height and front edge of the table, tops of near boxes (n, 3)."""

    boxes: Boxes
    shelf: Shelf
    table: float
    front: float
    tops: Float[np.ndarray, "n 3"]


def random_furniture(rng: np.random.Generator) -> Furniture:
    """A cell for a right-handed person who stands at the origin and looks along y."""
    height = rng.uniform(0.86, 0.96)
    front = rng.uniform(0.20, 0.25)
    table = _table(rng, height, front)
    shelf, shelf_boxes = _shelf(rng, height, front)
    tops, things = _things(rng, height, front)
    floor_and_walls = [
        ((0.0, 0.0, -0.05), (4.0, 4.0, 0.05), 0.0),
        ((rng.uniform(1.6, 2.6), 0.0, 1.3), (0.05, 4.0, 1.3), 0.0),
        ((0.0, rng.uniform(-2.2, -1.2), 1.3), (4.0, 0.05, 1.3), 0.0),
    ]
    return Furniture(_boxes([*floor_and_walls, *table, *shelf_boxes, *things]), shelf, height, front, tops)


_Box = tuple[tuple[float, float, float], tuple[float, float, float], float]


def _boxes(rows: list[_Box]) -> Boxes:
    centre, half, turn = zip(*rows, strict=True)
    return Boxes(np.array(centre), np.array(half), np.array(turn))


def _table(rng: np.random.Generator, height: float, front: float) -> list[_Box]:
    thick = rng.uniform(0.025, 0.045)
    left, right, back = rng.uniform(-0.75, -0.6), rng.uniform(0.85, 1.0), front + rng.uniform(0.62, 0.78)
    half_x, half_y = 0.5 * (right - left), 0.5 * (back - front)
    x, y = 0.5 * (left + right), 0.5 * (front + back)
    rows = [((x, y, height - 0.5 * thick), (half_x, half_y, 0.5 * thick), 0.0)]
    leg = 0.03
    for i in (-1.0, 1.0):
        for j in (-1.0, 1.0):
            at = (x + i * (half_x - leg), y + j * (half_y - leg), 0.5 * (height - thick))
            rows.append((at, (leg, leg, 0.5 * (height - thick)), 0.0))
    return rows


def _shelf(rng: np.random.Generator, height: float, front: float) -> tuple[Shelf, list[_Box]]:
    """Two sides, a back and boards, standing on the table to the person's right."""
    board = rng.uniform(0.012, 0.02)
    levels = int(rng.integers(2, 4))
    clear = rng.uniform(0.24, 0.31, levels) if levels == 2 else rng.uniform(0.22, 0.26, levels)
    floors = board + np.concatenate([[0.0], np.cumsum(clear[:-1] + board)])
    width, depth, turn = rng.uniform(0.32, 0.42), rng.uniform(0.28, 0.36), math.radians(rng.uniform(-12.0, 8.0))
    corner = np.array([rng.uniform(0.16, 0.22), front + rng.uniform(0.09, 0.13), height])
    shelf = Shelf(corner, turn, width, depth, floors, clear)
    tall = float(floors[-1] + clear[-1] + board)
    right, deep, up = np.array([math.cos(turn), math.sin(turn), 0.0]), shelf.inward, np.array([0.0, 0.0, 1.0])
    parts = [(-0.5 * board, 0.5 * depth, 0.5 * tall, board, depth, tall)]
    parts.append((width + 0.5 * board, 0.5 * depth, 0.5 * tall, board, depth, tall))
    parts.append((0.5 * width, depth + 0.5 * board, 0.5 * tall, width + 2.0 * board, board, tall))
    parts += [(0.5 * width, 0.5 * depth, float(top) - 0.5 * board, width, depth, board) for top in [*floors, tall]]
    rows = []
    for a, b, c, x, y, z in parts:
        at = corner + a * right + b * deep + c * up
        rows.append((tuple(at.tolist()), (0.5 * x, 0.5 * y, 0.5 * z), turn))
    return shelf, rows


def _things(rng: np.random.Generator, height: float, front: float) -> tuple[Float[np.ndarray, "n 3"], list[_Box]]:
    """Boxes side by side on the free part of the table; the right hand goes to those before the person."""
    count = int(rng.integers(4, 6))
    slots = np.linspace(-0.5, 0.06, count)
    tops, rows = [], []
    for slot in slots:
        half = rng.uniform([0.035, 0.04, 0.015], [0.055, 0.08, 0.05])
        x, y = slot + rng.uniform(-0.015, 0.015), front + rng.uniform(0.27, 0.36)
        rows.append(((x, y, height + half[2]), tuple(half.tolist()), math.radians(rng.uniform(-15.0, 15.0))))
        if slot > -0.22:
            tops.append((x, y, height + 2.0 * half[2]))
    return np.array(tops), rows


def mesh_of(boxes: Boxes) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "t 3"]]:
    """Vertices in the cell's frame and triangles, turned outward."""
    local = _CORNERS * boxes.half[:, None]
    c, s = np.cos(boxes.turn)[:, None], np.sin(boxes.turn)[:, None]
    x, y, z = np.moveaxis(local, -1, 0)
    vertices = np.stack([c * x - s * y, s * x + c * y, z], axis=-1) + boxes.centre[:, None]
    triangles = _FACES + 8 * np.arange(boxes.turn.size)[:, None, None]
    return vertices.reshape(-1, 3), triangles.reshape(-1, 3)


def _into(boxes: Boxes, i: int, v: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Vectors turned into a box's own axes."""
    c, s = math.cos(boxes.turn[i]), math.sin(boxes.turn[i])
    return np.column_stack([c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0], v[:, 2]])


def distance_to(boxes: Boxes, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Distance of points from the nearest box, metres; negative inside one.

    >>> cube = Boxes(np.zeros((1, 3)), np.ones((1, 3)), np.zeros(1))
    >>> distance_to(cube, np.array([[3.0, 0.0, 0.0], [0.0, 0.5, 0.0]])).tolist()
    [2.0, -0.5]
    """
    out = np.empty(p.shape[0])
    box_distance(np.ascontiguousarray(p), boxes.centre, boxes.half, np.cos(boxes.turn), np.sin(boxes.turn), out)
    return out


def distance_to_numpy(boxes: Boxes, p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """The same as `distance_to` in plain NumPy, one box after the other."""
    out = np.full(p.shape[0], np.inf)
    for i in range(boxes.turn.size):
        q = np.abs(_into(boxes, i, p - boxes.centre[i])) - boxes.half[i]
        outside = np.maximum(q, 0.0)
        out = np.minimum(out, np.sqrt((outside * outside).sum(axis=1)) + np.minimum(q.max(axis=1), 0.0))
    return out


def first_hits(
    boxes: Boxes, origin: Float[np.ndarray, " 3"], vectors: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Share of each vector at which the first box is met from outside, inf where none, and its outward normal."""
    share, normal = np.full(vectors.shape[0], np.inf), np.zeros(vectors.shape)
    for i in range(boxes.turn.size):
        d = _into(boxes, i, vectors)
        m = _into(boxes, i, (origin - boxes.centre[i])[None])
        with np.errstate(divide="ignore", invalid="ignore"):
            near, far = (-m - np.copysign(boxes.half[i], d)) / d, (-m + np.copysign(boxes.half[i], d)) / d
        # along a face's plane 0 / 0 says nothing about that slab
        near, far = np.where(np.isnan(near), -np.inf, near), np.where(np.isnan(far), np.inf, far)
        axis = near.argmax(axis=1)
        t = near.max(axis=1)
        met = (t <= far.min(axis=1)) & (t >= 0.0) & (t < share)
        share[met] = t[met]
        local = np.zeros((int(met.sum()), 3))
        rows = np.arange(local.shape[0])
        local[rows, axis[met]] = -np.copysign(1.0, d[met][rows, axis[met]])
        c, s = math.cos(boxes.turn[i]), math.sin(boxes.turn[i])
        normal[met] = np.column_stack(
            [c * local[:, 0] - s * local[:, 1], s * local[:, 0] + c * local[:, 1], local[:, 2]]
        )
    return share, normal


def ply_of(vertices: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "t 3"]) -> bytes:
    """A mesh as a binary PLY file, single precision."""
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {vertices.shape[0]}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {triangles.shape[0]}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(triangles.shape[0], dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, triangles
    return head.encode("ascii") + vertices.astype("<f4").tobytes() + rows.tobytes()
