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
    particles: Annotated[
        int, typer.Option(min=2, max=100_000, help="Of the fusion filter, and of each of the five posture filters.")
    ] = 200,
    tilt: Annotated[
        float, typer.Option(min=0.0, max=45.0, help="Degrees by which the suit's vertical may be off, for drift-ff.")
    ] = 0.0,
    poses: Annotated[
        Path | None,
        typer.Option(
            help="OpenPose's folder, or COCO's or MediaPipe's file, instead of keypoints2d.csv.", show_default=False
        ),
    ] = None,
    poses_fps: Annotated[
        float | None,
        typer.Option(min=0.1, max=1000.0, help="Frames a second of --poses.", show_default="that of the walk"),
    ] = None,
    poses_start: Annotated[float, typer.Option(help="Time of their first frame on the suit's clock, seconds.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Decides every random choice.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="A summary as JSON for machines.")] = False,
) -> None:
    """Follow a person with an inertial suit before a camera; writes walk.csv, posture.csv, keypoints.csv and a page."""
    from ..body.walk_inputs import open_walk
    from ..body.walk_settings import Settings
    from .walk_files import follow_into, summary, summary_text

    opened = open_walk(recording, poses, poses_fps, poses_start)
    for line in opened.warnings:
        warning(line)
    done = follow_into(out, opened, Settings(method, particles, particles, tilt=tilt), seed)
    for line in done.warnings[len(opened.warnings) :]:
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
