"""A surface and a pose in, the posed surface in front of a camera out: skin, its image, triangles by tile."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..camera import Camera
from .raster import Projected, Tiles, project_mesh, tiled
from .skin import Skin, Surface, pose_skin


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A surface posed in front of a camera."""

    skin: Skin
    mesh: Projected
    tiles: Tiles


def view_of(surface: Surface, camera: Camera, u: Float[np.ndarray, " k"]) -> View:
    """Pose, project and sort the mesh."""
    skin = pose_skin(surface, camera, u)
    mesh = project_mesh(skin, surface.triangles, camera)
    return View(skin, mesh, tiled(mesh, camera))


def moving_triangles(surface: Surface) -> Bool[np.ndarray, " t"]:
    """Triangles that belong to a link; the rest is the palm or the arm, which no joint moves much."""
    return surface.region < surface.finger.size - 1


def moving_box(
    surface: Surface, camera: Camera, view: View, margin: float
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
    """Lowest and highest pixel of the moving triangles, widened by a margin, inside the image."""
    corners = view.mesh.xy[np.unique(surface.triangles[moving_triangles(surface)])]
    corners = corners[np.isfinite(corners).all(axis=1)]
    size = np.array([camera.width - 1.0, camera.height - 1.0])
    low = np.clip(corners.min(axis=0, initial=np.inf) - margin, 0.0, size)
    high = np.clip(corners.max(axis=0, initial=-np.inf) + margin, 0.0, size)
    return np.floor(low), np.ceil(high)
