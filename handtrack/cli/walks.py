"""`handtrack body walk`, `body simulate-walk`: what suit and camera saw in, a walk without drift out; simulations."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from .console import progress, say, say_json, warning

Method = Literal["drift-ff", "pose-ff", "eskf", "camera", "suit"]


def walk(
    recording: Annotated[Path, typer.Argument(metavar="WALK", help="Walk folder with walk.yaml.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder to write; an earlier run there is replaced.", show_default=False)],
    method: Annotated[
        Method,
        typer.Option(
            help="Particles on the drift or on the pose, an error-state filter on the drift; camera or suit alone."
        ),
    ] = "drift-ff",
    seed: Annotated[int, typer.Option(min=0, help="Decides every random choice.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="A summary as JSON for machines.")] = False,
) -> None:
    """Follow a person with an inertial suit before a camera; writes walk.csv, posture.csv, keypoints.csv and a page."""
    from ..body.walk_settings import Settings
    from ..formats.walks import read_walk
    from .walk_files import follow_into, summary, summary_text

    read = read_walk(recording)
    for line in read.warnings:
        warning(line)
    done = follow_into(out, read, Settings(method=method), seed)
    for line in done.warnings[len(read.warnings) :]:
        warning(line)
    if as_json:
        say_json(summary(done, out))
    else:
        say(summary_text(done, out))


def simulate_walk(
    out: Annotated[Path, typer.Argument(help="Folder to write; an earlier walk there is replaced.")],
    seed: Annotated[int, typer.Option(min=0, help="Decides person, way, drift and noise.")] = 1,
    seconds: Annotated[float, typer.Option(help="Length of the walk.")] = 300.0,
    fps: Annotated[float, typer.Option(help="Samples a second of the suit.")] = 5.0,
    camera_fps: Annotated[
        float | None, typer.Option(help="Frames a second of the camera.", show_default="those of the suit")
    ] = None,
    in_view: Annotated[float, typer.Option(help="Share of the camera's frames that show the person.")] = 0.6,
    motion: Annotated[
        Path | None, typer.Option(help="BVH file of a recorded person that shapes the gait.", show_default=False)
    ] = None,
) -> None:
    """Simulate a walk with an inertial suit that drifts and a camera that loses sight, with exact truth."""
    from .walk_files import simulated

    chosen = {"seconds": seconds, "fps": fps, "camera_fps": camera_fps or fps, "in_view": in_view, "motion": motion}
    with progress("simulating", None):
        simulated(out, seed, chosen)
    say(str(out / "walk.yaml"))
