"""A mesh file in, its vertices and triangles out: whatever trimesh reads, its parts put together."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError

MOST_BYTES = 500_000_000


def read_mesh(
    path: Path | str, most_bytes: int = MOST_BYTES
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "t 3"]]:
    """Vertices, in the file's unit and axes, and triangles; none of either where the file holds an empty mesh.

    Raises
    ------
    InputError
        If the file cannot be read, is too large, or holds something else.
    """
    import trimesh

    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; a mesh is wanted")
    size = path.stat().st_size
    if not 0 < size <= most_bytes:
        raise InputError(f"{path}: has {size} bytes; 1 to {most_bytes} are wanted of a mesh")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene: Any = trimesh.load_scene(path, process=False, skip_materials=True)
            mesh: Any = scene.to_geometry() if scene.geometry else None
    except Exception as error:
        words = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path}: {words}; a mesh is wanted") from error
    if mesh is None or (not hasattr(mesh, "faces") and not len(getattr(mesh, "vertices", ()))):
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    if not hasattr(mesh, "faces"):
        raise InputError(f"{path}: holds no triangles; a mesh is wanted")
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)
