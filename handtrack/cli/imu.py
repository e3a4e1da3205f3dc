"""`handtrack body imu`: raw inertial logs and a camera's parameters in, a walk folder out."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from .console import note, say, say_json, warning

Headings = Literal["rates", "magnetic", "sensors"]


def imu(
    logs: Annotated[Path, typer.Argument(metavar="LOGS", help="Folder with a folder of logs for each sensor.")],
    out: Annotated[Path, typer.Option(help="Walk folder to write; must be new or empty.", show_default=False)],
    camera: Annotated[Path, typer.Option(help="Camera file (YAML) of the camera that looks on.", show_default=False)],
    height: Annotated[float, typer.Option(min=0.5, max=2.5, help="Of the person, metres.", show_default=False)],
    fps: Annotated[
        float | None, typer.Option(min=1.0, max=1000.0, help="Frames a second to write.", show_default="the sensors'")
    ] = None,
    headings: Annotated[
        Headings, typer.Option(help="From rates alone; with the magnetic field; or as the sensors say themselves.")
    ] = "rates",
    as_json: Annotated[bool, typer.Option("--json", help="A summary as JSON for machines.")] = False,
) -> None:
    """Turn raw logs of sensors on a person's segments into a walk folder for `body walk`; first stand still."""
    from ..body.posture import body_of
    from ..errors import InputError
    from ..formats.cameras import read_camera
    from ..formats.imu_logs import read_imu_logs
    from ..formats.walks import write_walk
    from .imu_walk import facts, suit_of, walk_of

    view = read_camera(camera)
    if view.kind != "perspective":
        raise InputError(f"{camera}: camera: type: got {view.kind}, wanted perspective")
    read = read_imu_logs(logs, fps)
    for line in read.warnings:
        warning(line)
    note(f"orientations of {len(read.names)} sensors at {read.time.size} times")
    suit = suit_of(read, body_of(height), headings, logs)
    for line in suit.warnings:
        warning(line)
    write_walk(out, walk_of(suit, view, height, out))
    found = facts(suit, out)
    if as_json:
        say_json(found)
    else:
        say(
            f"{found['frames']} frames, {found['seconds']:.1f} s; the pelvis went {found['way_m']:.1f} m and ended "
            f"{found['ended_m']:.2f} m from where it began\n{out / 'walk.yaml'}"
        )
