"""Sizes in, stiff bodies out: balls, boxes, sticks, and meshes from files."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from handtrack.errors import InputError
from handtrack.formats.meshes import read_mesh
from handtrack.formats.paths import read_bytes
from handtrack.pills import Pills

from ..labels.bodies import Rigid

MOST_BYTES, MOST_TRIANGLES = 20_000_000, 100_000
_NONE = np.zeros((0, 3))
_NO_PILLS = Pills(_NONE, _NONE, np.zeros((0, 2)))
_NO_TRIANGLES = np.zeros((0, 3), np.int64)


def ball(diameter: float) -> Rigid:
    """A sphere about its origin."""
    pills = Pills(np.zeros((1, 3)), np.zeros((1, 3)), np.full((1, 2), 0.5 * diameter))
    return Rigid("sphere", pills, _NONE, _NONE, _NO_TRIANGLES)


def stick(length: float, diameter: float, taper: float = 1.0) -> Rigid:
    """A pill along x about its origin; `taper` is the ratio of its end radii."""
    half = np.array([[0.5 * length, 0.0, 0.0]])
    return Rigid("pill", Pills(-half, half, 0.5 * diameter * np.array([[1.0, taper]])), _NONE, _NONE, _NO_TRIANGLES)


def box(edges: Float[np.ndarray, " 3"]) -> Rigid:
    """A box about its origin, four vertices on each flat face."""
    vertices, normals, triangles = [], [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            n, a, b = np.zeros(3), np.zeros(3), np.zeros(3)
            n[axis], a[(axis + 1) % 3], b[(axis + 2) % 3] = sign, 1.0, sign
            first = len(vertices)
            vertices += [n - a - b, n + a - b, n + a + b, n - a + b]
            normals += [n] * 4
            triangles += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    return Rigid("box", _NO_PILLS, 0.5 * edges * np.array(vertices), np.array(normals), np.array(triangles))


def mesh_body(
    vertices: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "t 3"], longest: float, flat: bool = True
) -> Rigid:
    """A mesh about the middle of its box, its longest side `longest` mm; `flat` gives each triangle its own normal."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    placed = (vertices - 0.5 * (low + high)) * (longest / float((high - low).max()))
    corners = placed[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if flat:
        size = np.linalg.norm(normal, axis=1, keepdims=True)
        normals = np.repeat(normal / np.where(size > 0, size, 1.0), 3, axis=0)
        return Rigid("mesh", _NO_PILLS, corners.reshape(-1, 3), normals, np.arange(normals.shape[0]).reshape(-1, 3))
    normals = np.zeros_like(placed)
    for c in range(3):
        np.add.at(normals, triangles[:, c], normal)
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    return Rigid("mesh", _NO_PILLS, placed, normals / np.where(size > 0, size, 1.0), triangles)


def read_body(path: Path | str) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "t 3"]]:
    """Vertices and triangles of a mesh file: Wavefront OBJ by `read_obj`, others by trimesh.

    Raises
    ------
    InputError
        If the file is none, is empty, or is too large.
    """
    if Path(path).suffix.lower() == ".obj":
        return read_obj(path)
    vertices, triangles = read_mesh(path, MOST_BYTES)
    if not 0 < triangles.shape[0] <= MOST_TRIANGLES:
        raise InputError(f"{path}: holds {triangles.shape[0]} triangles; 1 to {MOST_TRIANGLES} are wanted")
    used, triangles = np.unique(triangles, return_inverse=True)
    return _with_size(vertices[used], path), triangles.reshape(-1, 3)


def _with_size(vertices: Float[np.ndarray, "v 3"], path: Path | str) -> Float[np.ndarray, "v 3"]:
    """The vertices, if they are numbers and not all one."""
    if not np.isfinite(vertices).all() or not np.ptp(vertices, axis=0).max() > 0:
        raise InputError(f"{path}: all vertices lie in one place, or nowhere; a mesh with a size is wanted")
    return vertices


def read_obj(path: Path | str) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "t 3"]]:
    """Vertices and triangles of a Wavefront OBJ file; polygons are cut into fans, everything else is passed over.

    Raises
    ------
    InputError
        For lines that hold no numbers, vertices that do not exist, no triangle or too many.
    """
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for number, line in enumerate(read_bytes(Path(path), MOST_BYTES).decode("utf-8", "replace").splitlines(), 1):
        words = line.split()
        if not words or words[0] not in ("v", "f"):
            continue
        try:
            if words[0] == "v":
                vertices.append([float(word) for word in words[1:4]])
                if len(vertices[-1]) != 3 or not np.isfinite(vertices[-1]).all():
                    raise ValueError
                continue
            face = [int(word.split("/")[0]) for word in words[1:]]
            face = [k - 1 if k > 0 else len(vertices) + k for k in face]
            if len(face) < 3 or min(face) < 0 or max(face) >= len(vertices):
                raise ValueError
        except ValueError as error:
            wanted = "three finite numbers" if words[0] == "v" else "three or more vertices that exist"
            raise InputError(f"{path}: line {number}: {line.strip()[:60]!r}; wanted: {wanted}") from error
        triangles += [(face[0], face[i], face[i + 1]) for i in range(1, len(face) - 1)]
        if len(triangles) > MOST_TRIANGLES:
            raise InputError(f"{path}: line {number}: more than {MOST_TRIANGLES} triangles; fewer are wanted")
    if not triangles:
        raise InputError(f"{path}: holds no triangles; a mesh with faces is wanted")
    return _with_size(np.array(vertices), path), np.array(triangles)
