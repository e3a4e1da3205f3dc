"""A room as a mesh in, where rays meet it out: by Embree where it is installed, else by a tree of boxes of our own.

Rooms are in metres. Any file that trimesh reads is one: its parts are put together. A room without triangles is one
that nothing hits.
"""

from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, Protocol, get_args, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32, Int

from .. import _kernels
from ..errors import InputError
from ..formats.meshes import read_mesh

Engine = Literal["auto", "embree", "bvh"]
ENGINES: tuple[Engine, ...] = get_args(Engine)
MOST_TRIANGLES = 5_000_000
FARTHEST = 1000.0  # metres from the origin: a room beyond is in another unit


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """A triangulated surface.

    Attributes
    ----------
    vertices : (v, 3)
        Metres, camera axes.
    triangles : (t, 3)
        Vertices of each triangle.
    warnings : tuple of str
        What was accepted with care.
    """

    vertices: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "t 3"]
    warnings: tuple[str, ...] = ()


@runtime_checkable
class RayCaster(Protocol):
    """Something that knows where rays meet a room."""

    engine: str

    def hits(self, origins: Float[np.ndarray, "*n 3"], vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Share of each vector at which it first meets the room, +inf where it does not within its length.

        Parameters
        ----------
        origins : (n, 3) or (3,)
            Where rays begin; one for all, or one each.
        vectors : (n, 3)
            From there to where they end. A vector without length or with NaN meets nothing.
        """
        ...


def read_room(path: Path | str) -> Room:
    """Read a mesh file.

    Raises
    ------
    InputError
        If the file cannot be read, is too large, or holds no mesh.
    """
    vertices, triangles = read_mesh(path)
    if not triangles.shape[0]:
        return Room(np.zeros((0, 3)), np.zeros((0, 3), np.int64), (f"{path}: the mesh is empty",))
    return room_of(vertices, triangles, str(path))


def room_of(vertices: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "t 3"], name: str = "room") -> Room:
    """A room without triangles that are no surface.

    Raises
    ------
    InputError
        If triangles name vertices that are not there, there are too many, or the room is not in metres.
    """
    if triangles.size and (triangles.min() < 0 or triangles.max() >= vertices.shape[0]):
        raise InputError(f"{name}: a triangle names vertex {int(triangles.max())} of {vertices.shape[0]}")
    if triangles.shape[0] > MOST_TRIANGLES:
        raise InputError(f"{name}: has {triangles.shape[0]} triangles; at most {MOST_TRIANGLES} are wanted")
    corner = vertices[triangles]
    finite = np.isfinite(corner).all(axis=(1, 2))
    far = float(np.abs(corner[finite]).max(initial=0.0))
    if far > FARTHEST:
        raise InputError(f"{name}: reaches {far:g} from the origin; metres are wanted, at most {FARTHEST:g}")
    with np.errstate(invalid="ignore"):
        area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
        good = finite & (area > 0)
    said = ()
    if not good.all():
        said = (f"{name}: {int((~good).sum())} of {good.size} triangles have no area or no place and are left out",)
    return Room(np.where(np.isfinite(vertices), vertices, 0.0), triangles[good], said)


def ray_caster(room: Room, engine: Engine = "auto") -> RayCaster:
    """What casts rays in a room.

    Parameters
    ----------
    engine : "auto", "embree" or "bvh"
        `auto` is Embree where the package embreex is installed, else the tree of boxes.

    Raises
    ------
    InputError
        If Embree is wanted and not there.
    """
    if not room.triangles.shape[0]:
        return Nothing()
    if engine == "bvh" or (engine == "auto" and find_spec("embreex") is None):
        return Tree(room)
    if find_spec("embreex") is None:
        raise InputError("engine: Embree is not installed; `pip install handtrack[room]` brings it, or take bvh")
    return Embree(room)


class Nothing:
    """An empty room."""

    engine = "none"

    def hits(self, origins: Float[np.ndarray, "*n 3"], vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """No ray meets anything."""
        return np.full(vectors.shape[0], np.inf)


class Tree:
    """Rays through a tree of boxes, in double precision (`_kernels.bvh`)."""

    engine = "bvh"

    def __init__(self, room: Room) -> None:
        corner = room.vertices[room.triangles]
        order, self._box, self._child, self._count = _kernels.build_tree(corner.min(axis=1), corner.max(axis=1))
        self._corner = np.ascontiguousarray(corner[order])

    def hits(self, origins: Float[np.ndarray, "*n 3"], vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """See `RayCaster`."""
        start = np.ascontiguousarray(np.broadcast_to(origins, vectors.shape), float)
        return _kernels.first_hits(
            self._box, self._child, self._count, self._corner, start, np.ascontiguousarray(vectors, float)
        )


class Embree:
    """Rays by Intel's Embree, in single precision."""

    engine = "embree"

    def __init__(self, room: Room) -> None:
        self._triangles = np.ascontiguousarray(room.vertices[room.triangles], np.float32)

    @cached_property
    def _scene(self) -> Any:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore import EmbreeDevice
        from embreex.rtcore_scene import EmbreeScene

        self._device = EmbreeDevice()
        scene = EmbreeScene(self._device, robust=True)
        TriangleMesh(scene, self._triangles)
        return scene

    def hits(self, origins: Float[np.ndarray, "*n 3"], vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """See `RayCaster`."""
        way = np.ascontiguousarray(vectors, np.float32)
        start = np.empty(way.shape, np.float32)
        start[:] = origins
        return _kernels.within(self._scene.run(start, way, query="DISTANCE"), start, way)


def within_numpy(
    share: Float32[np.ndarray, " n"], origin: Float32[np.ndarray, "n 3"], vector: Float32[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Twin of the compiled check of Embree's answers."""
    finite = np.isfinite(vector).all(axis=1) & np.isfinite(origin).all(axis=1)
    return np.where(finite & vector.any(axis=1) & (share <= 1.0), share.astype(float), np.inf)


def hits_numpy(
    room: Room, origins: Float[np.ndarray, "*n 3"], vectors: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Twin of the compiled tree and its rays: every ray against every triangle (Moeller & Trumbore 1997)."""
    corner = room.vertices[room.triangles]
    start = np.broadcast_to(origins, vectors.shape)
    out = np.full(vectors.shape[0], np.inf)
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    for i in range(vectors.shape[0]):
        v = vectors[i]
        cross = np.cross(v, b)
        det = (a * cross).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = start[i] - corner[:, 0]
            u = (s * cross).sum(axis=1) / det
            q = np.cross(s, a)
            w = (q @ v) / det
            share = (b * q).sum(axis=1) / det
        met = (u >= 0) & (w >= 0) & (u + w <= 1) & (share >= 0) & (share <= 1)
        out[i] = share[met].min(initial=np.inf)
    return out
