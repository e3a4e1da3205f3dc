"""`handtrack body people` and `body simulate-people`: skeletons in, steady people out; and simulated skeletons."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from .console import progress, say, say_json, warning

Mode = Literal["paper", "robust"]
Task = Literal["T0", "T1", "T2", "T3", "permuted", "crossing", "entering", "re-entering"]


def people(
    skeletons: Annotated[
        Path,
        typer.Argument(
            help="Scene folder with scene.yaml; or OpenPose's folder, COCO's or MediaPipe's JSON file.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder to write; an earlier run there is replaced.", show_default=False)],
    mode: Annotated[
        Mode, typer.Option(help="`paper`: its rules and numbers; `robust`: with what a trial taught.")
    ] = "robust",
    seed: Annotated[int, typer.Option(min=0, help="Decides every random choice.")] = 1,
    camera: Annotated[
        Path | None, typer.Option(help="Camera file (YAML), for keypoints in pixels.", show_default=False)
    ] = None,
    depth: Annotated[
        Path | None,
        typer.Option(help="Folder of 16-bit depth images in millimetres, for keypoints in pixels.", show_default=False),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(min=1.0, max=1000.0, help="Frames per second of keypoints in pixels.", show_default="30"),
    ] = None,
    offset: Annotated[
        float | None,
        typer.Option(
            min=-0.5,
            max=0.5,
            help="Metres from the skin, which a depth camera sees, to a wrist's joint; 0 for readings of joints.",
            show_default="0.035 with --depth, else unknown",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="A summary as JSON for machines.")] = False,
) -> None:
    """Label and follow people, hidden or not; writes people.csv, .trc, .c3d, .bvh, run.json and an HTML report."""
    from ..body.people_inputs import Given, open_people
    from ..body.people_run import settings_for
    from .people_files import follow_into, summary, summary_text

    opened = open_people(skeletons, Given(camera, depth, fps, offset))
    for line in opened.warnings:
        warning(line)
    done = follow_into(out, opened, replace(settings_for(mode), skin=opened.skin), seed)
    for line in done.warnings:
        warning(line)
    if as_json:
        say_json(summary(done, out))
    else:
        say(summary_text(done, out))


def simulate_people(
    out: Annotated[Path, typer.Argument(help="Folder to write; an earlier scene there is replaced.")],
    task: Annotated[Task, typer.Option(help="A task of the people paper, or a test of who is who.")] = "T3",
    seed: Annotated[int, typer.Option(min=0, help="Decides people, motion and the network's errors.")] = 1,
    frames: Annotated[int, typer.Option(help="Number of frames.")] = 600,
    fps: Annotated[float, typer.Option(help="Frames per second.")] = 30.0,
    motion: Annotated[
        Path | None, typer.Option(help="Marker file of a recorded arm that sways the hands.", show_default=False)
    ] = None,
) -> None:
    """Simulate skeletons of two people as a pose network and a depth camera report them, with exact truth."""
    from .people_files import simulated

    with progress("simulating", None):
        simulated(out, task, seed, {"frames": frames, "fps": fps, "motion": motion})
    say(str(out / "scene.yaml"))
