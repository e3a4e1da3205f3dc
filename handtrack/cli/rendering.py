"""The name of a scene in, the scene and its sequence folder out: the work of `handtrack render`."""

from dataclasses import dataclass, fields, replace
from pathlib import Path

from synth.mesh_scene import mesh_scene
from synth.scenes import Scene, scene
from synth.sequence import fill_sequence
from synth.shading import Mode
from synth.views import with_views

from ..errors import InputError
from ..formats.glb import read_glb
from ..formats.images import read_image
from ..sequences import NAME, find_model
from .console import Done
from .record import whole_folder


@dataclass(frozen=True, slots=True)
class MeshOptions:
    """What `--scene mesh` shows, and from where; see `synth.mesh_scene.mesh_scene`."""

    surface: Path | None = None
    scale: float = 1.0
    mirror: bool = False
    tilt: float = 30.0
    turn: float = 0.0
    palm: bool = False
    covered: bool = False


def build(
    name: str, model: str | None, seed: int, frames: int, views: int = 1, mesh: MeshOptions | None = None
) -> Scene:
    """The scene of that name, seen by so many cameras; `random` moves any model within its limits."""
    mesh = mesh or MeshOptions()
    if (name == "mesh") != (mesh.surface is not None) or (mesh.surface is None and mesh != MeshOptions()):
        raise InputError("--surface: goes with `--scene mesh`, which needs it, and so do the options of the mesh")
    if mesh.surface is not None:
        if model is not None:
            raise InputError("--model: a mesh brings its own; none was wanted with `--scene mesh`")
        chosen = {field.name: getattr(mesh, field.name) for field in fields(mesh) if field.name != "surface"}
        try:
            return with_views(mesh_scene(seed, read_glb(mesh.surface), frames=frames, **chosen), views)
        except ValueError as refused:
            raise refused if isinstance(refused, InputError) else InputError(f"{mesh.surface}: {refused}") from refused
    if (name == "random") != (model is not None):
        raise InputError("--model: goes with `--scene random`, which needs it")
    return with_views(scene(name, seed, find_model(model) if model is not None else None, frames=frames), views)


def dressed(
    scene: Scene, noise: float | None, vignette: float | None, background: Path | None, mode: Mode, colour: bool
) -> Scene:
    """The scene with another sensor, background, light or colour, where something is given."""
    sensor = scene.sensor
    if noise is not None:
        sensor = replace(sensor, noise=noise)
    if vignette is not None:
        sensor = replace(sensor, vignette=vignette)
    if scene.hand is not None and (colour or mode != "phong"):
        raise InputError("--mode, --colour: a mesh is shown in grey and lit by Phong; the defaults were wanted")
    behind = scene.background
    if background is not None:
        behind = read_image(background)
        wanted = (scene.camera.height, scene.camera.width)
        if behind.shape != wanted:
            raise InputError(
                f"{background}: is {behind.shape[1]} x {behind.shape[0]} pixels; {wanted[1]} x {wanted[0]} was wanted"
            )
    return replace(scene, sensor=sensor, background=behind, mode=mode, colour=colour)


def write_scene(out: Path, scene: Scene, done: Done | None = None, video: bool = False) -> None:
    """Write a scene as a sequence folder, whole or not at all; an earlier sequence there is replaced."""
    with whole_folder(out, NAME, "sequence") as folder:
        fill_sequence(folder, scene, video=video, done=done)
