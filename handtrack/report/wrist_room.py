"""A room in, what a page shows of it out: few triangles, the edges that stand out, and which way is up."""

import numpy as np
from jaxtyping import Float, Int

from ..body.environment import Room

MOST_TRIANGLES, MOST_EDGES = 30_000, 20_000
SHARP = np.cos(np.radians(30.0))
_FINEST = 1e-4  # metres: vertices nearer than that are one


def decimated(room: Room, most: int = MOST_TRIANGLES) -> Room:
    """The room with at most so many triangles: vertices in one cell of a grid, as fine as that allows, become one.

    >>> square = Room(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    >>> decimated(square, most=2).triangles.shape[0], decimated(square, most=0).triangles.shape[0]
    (2, 0)
    """
    cell = _FINEST
    found = _clustered(room, cell)
    size = float(np.ptp(room.vertices, axis=0).max()) if room.vertices.size else 0.0
    cell = max(size / 1000.0, _FINEST)
    while found.triangles.shape[0] > most:
        found = _clustered(room, cell)
        cell *= 1.25
    return found


def _clustered(room: Room, cell: float) -> Room:
    """Vertices in one cell replaced by their mean; triangles without area and doubles left out."""
    if not room.triangles.shape[0]:
        return room
    used, triangles = np.unique(room.triangles, return_inverse=True)
    p = room.vertices[used]
    _, back, count = np.unique(np.round(p / cell).astype(np.int64), axis=0, return_inverse=True, return_counts=True)
    back = back.reshape(-1)
    vertices = np.stack([np.bincount(back, p[:, k], count.size) / count for k in range(3)], axis=1)
    corner = back[triangles.reshape(-1, 3)]
    whole = (corner[:, 0] != corner[:, 1]) & (corner[:, 1] != corner[:, 2]) & (corner[:, 2] != corner[:, 0])
    corner = corner[whole]
    _, first = np.unique(np.sort(corner, axis=1), axis=0, return_index=True)
    return Room(vertices, corner[np.sort(first)])


def normals(room: Room) -> tuple[Float[np.ndarray, "t 3"], Float[np.ndarray, " t"]]:
    """Unit normals of triangles, and their areas; zero where there is none."""
    corner = room.vertices[room.triangles]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(across, axis=1)
    return across / np.maximum(length, 1e-300)[:, None], 0.5 * length


def edges(room: Room, most: int = MOST_EDGES) -> Int[np.ndarray, "e 2"]:
    """Vertices of the edges at which the surface ends or bends by 30 degrees; none where there are too many to help."""
    t = room.triangles
    if not t.shape[0]:
        return np.zeros((0, 2), int)
    sides = np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(t.shape[0]), 3)
    order = np.lexsort((sides[:, 1], sides[:, 0]))
    sides, owner = sides[order], owner[order]
    unique, start, count = np.unique(sides, axis=0, return_index=True, return_counts=True)
    normal, _ = normals(room)
    sharp = count != 2
    two = np.flatnonzero(count == 2)
    bend = np.abs((normal[owner[start[two]]] * normal[owner[start[two] + 1]]).sum(axis=1))
    sharp[two] = bend < SHARP
    return unique[sharp] if sharp.sum() <= most else np.zeros((0, 2), int)


def upward(room: Room | None) -> Float[np.ndarray, " 3"]:
    """Unit vector up, from the surfaces that face the camera's up by and large; that itself without any."""
    up = np.array([0.0, -1.0, 0.0])
    if room is None or not room.triangles.shape[0]:
        return up
    normal, area = normals(room)
    normal = normal * np.where(normal @ up < 0.0, -1.0, 1.0)[:, None]  # either side may be the front
    for least in (0.6, 0.9, 0.98):
        weight = area * (normal @ up > least)
        if not weight.sum() > 0.0:
            break
        up = weight @ normal
        up /= np.linalg.norm(up)
    return up
