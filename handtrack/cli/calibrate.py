"""`handtrack calibrate-shape`: a sequence and a rough model in, a model file of that hand's shape with sigmas out."""

from pathlib import Path
from typing import Annotated

import typer

from .console import note, progress, say, say_json


def calibrate_shape(
    source: Annotated[
        list[Path],
        typer.Argument(
            metavar="INPUT",
            help="Folder with sequence.yaml; or image folders or videos, a view each.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Model file to write (YAML).", show_default=False)],
    model: Annotated[
        str | None, typer.Option(help="Built-in model or model file; for images and videos, or instead.")
    ] = None,
    camera: Annotated[
        list[Path] | None, typer.Option(help="File with `camera: {...}`, for images and videos; once for each view.")
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(help="Pose of the first frame in degrees: a file with `start: {...}`, or '{joint: value, ...}'."),
    ] = None,
    fps: Annotated[float | None, typer.Option(help="Frames per second, for a folder of images.")] = None,
    frames: Annotated[int, typer.Option(help="Frames that are used at the most.")] = 64,
    couple_tips: Annotated[
        float | None,
        typer.Option(
            metavar="SIGMA",
            help="Also let each finger's last joint follow the one before, within SIGMA degrees (4 is usual).",
            show_default=False,
        ),
    ] = None,
    start_sigma: Annotated[
        float, typer.Option(help="Standard deviation of the start pose, degrees: it ties shape and pose together.")
    ] = 3.0,
    plot: Annotated[
        Path | None, typer.Option(help="Picture of the outlines before and after (PNG, SVG or PDF).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The shape found, as JSON for machines.")] = False,
) -> None:
    """Find length, radii and offsets of every link from the first frames; writes a model file with sigmas."""
    from .calibrating import ROUNDS, calibrated, outline_figure, shape_data, shape_text
    from .pictures import save
    from .tracking import open_input

    sequence = open_input(source, model, camera or [], start, fps)
    with progress("calibrating", ROUNDS) as done:
        found = calibrated(sequence, out, done, frames, couple_tips, start_sigma)
    if plot is not None:
        save(outline_figure(sequence, found), plot)
        note(f"{plot}")
    if as_json:
        say_json(shape_data(found, out))
    else:
        say(shape_text(found, out))
