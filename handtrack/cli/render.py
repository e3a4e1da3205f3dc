"""`handtrack render`: the name of a scene and a seed in, a sequence folder with exact truth out."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from .console import progress, say

SceneName = Literal["two-finger-crossing", "two-finger-hard", "index-thumb-pinch", "full-hand-spread", "random", "mesh"]


def render(
    out: Annotated[
        Path, typer.Option(help="Folder to write; an earlier sequence there is replaced.", show_default=False)
    ],
    scene: Annotated[SceneName, typer.Option(help="What moves, and how.")] = "two-finger-crossing",
    model: Annotated[str | None, typer.Option(help="Built-in model or model file, for `--scene random`.")] = None,
    surface: Annotated[
        Path | None, typer.Option(help="Skinned hand mesh (.glb, W3C joint names), for `--scene mesh`.")
    ] = None,
    hand_scale: Annotated[float, typer.Option(min=0.2, max=5.0, help="Size of the mesh, for `--scene mesh`.")] = 1.0,
    mirror: Annotated[bool, typer.Option("--mirror", help="The other hand, for `--scene mesh`.")] = False,
    tilt: Annotated[float, typer.Option(help="Degrees about the horizontal image axis, for `--scene mesh`.")] = 30.0,
    turn: Annotated[float, typer.Option(help="Degrees about the vertical image axis, for `--scene mesh`.")] = 0.0,
    palm: Annotated[bool, typer.Option("--palm", help="Seen from the palm, for `--scene mesh`.")] = False,
    covered: Annotated[bool, typer.Option("--covered", help="A dark palm, for `--scene mesh`.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Decides motion and noise.")] = 1,
    frames: Annotated[int, typer.Option(min=1, help="Number of frames.")] = 60,
    views: Annotated[
        int, typer.Option(min=1, max=5, help="Number of cameras; each further one is turned by 60 degrees.")
    ] = 1,
    noise: Annotated[float | None, typer.Option(min=0.0, help="Standard deviation of the noise, grey levels.")] = None,
    vignette: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="Share of the light lost in the corners.")
    ] = None,
    background: Annotated[Path | None, typer.Option(help="Image of the camera's size behind the fingers.")] = None,
    mode: Annotated[
        Literal["binary", "flat", "gouraud", "phong"], typer.Option(help="How surfaces are lit.")
    ] = "phong",
    colour: Annotated[bool, typer.Option("--colour", help="Colour instead of grey.")] = False,
    video: Annotated[bool, typer.Option("--video", help="A video file (lossy) instead of PNG images.")] = False,
) -> None:
    """Render a sequence: images, model, cameras, start pose and true joint values."""
    from .rendering import MeshOptions, build, dressed, write_scene

    mesh = MeshOptions(surface, hand_scale, mirror, tilt, turn, palm, covered)
    made = dressed(build(scene, model, seed, frames, views, mesh), noise, vignette, background, mode, colour)
    with progress("rendering", frames * views) as done:
        write_scene(out, made, done, video)
    say(str(out / "sequence.yaml"))
