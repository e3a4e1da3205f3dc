"""`handtrack body`: a scene of a person in, what is known of the body out; and simulated scenes."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from .console import progress, say, say_json, warning
from .imu import imu
from .people import people, simulate_people
from .rooms import register, room
from .walks import simulate_walk, walk

app = typer.Typer(
    help="Follow bodies: the wrist that a depth camera loses behind things, people in view;\nand get the room ready."
)

Variant = Literal["original", "joint-volume", "complete"]
Side = Literal["right", "left"]


@app.command()
def wrist(
    scene: Annotated[Path, typer.Argument(help="Folder with scene.yaml (RGB-D scene).", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder to write; an earlier run there is replaced.", show_default=False)],
    variant: Annotated[
        Variant, typer.Option(help="Constraints: shell and depth; the arm's joints too; the room too.")
    ] = "complete",
    seed: Annotated[int, typer.Option(min=0, help="Decides every random choice.")] = 1,
    particles: Annotated[
        int | None, typer.Option(min=10, max=1_000_000, help="Particles of the wrist.", show_default="2000")
    ] = None,
    side: Annotated[Side, typer.Option(help="The arm that is followed.")] = "right",
    person: Annotated[int, typer.Option(min=0, help="Which person of the first frame, from 0.")] = 0,
    engine: Annotated[
        Literal["auto", "embree", "bvh"], typer.Option(help="What casts rays in the room; auto: Embree if installed.")
    ] = "auto",
    as_json: Annotated[bool, typer.Option("--json", help="A summary as JSON for machines.")] = False,
) -> None:
    """Follow a wrist through an RGB-D scene, hidden or not; writes wrist.csv, run.json and an HTML report."""
    from ..body.wrist_run import settings_for
    from .wrists import Choice, open_scene, summary, summary_text, track_into

    settings = settings_for(variant, particles)
    opened = open_scene(scene)
    for line in opened.warnings:
        warning(line)
    done = track_into(out, opened, settings, Choice(seed, side, person, engine))
    for line in done.track.warnings:
        warning(line)
    if as_json:
        say_json(summary(done, out))
    else:
        say(summary_text(done, out))


@app.command()
def simulate(
    out: Annotated[Path, typer.Argument(help="Folder to write; an earlier scene there is replaced.")],
    seed: Annotated[int, typer.Option(min=0, help="Decides cell, person, motion and noise.")] = 1,
    occlusion: Annotated[
        Literal["static", "dynamic", "both"],
        typer.Option(help="What hides the wrist: a shelf, a moving robot link, or each in turn."),
    ] = "both",
    frames: Annotated[int, typer.Option(min=1, help="Number of frames; a cycle takes 10 s.")] = 300,
    fps: Annotated[float, typer.Option(min=1.0, max=1000.0, help="Frames per second.")] = 30.0,
    size: Annotated[tuple[int, int], typer.Option(help="Width and height of the depth images.")] = (320, 240),
    side: Annotated[Side, typer.Option(help="The arm that works.")] = "right",
    sensor_offset: Annotated[
        float, typer.Option(help="Metres by which the sensor reports joints too near; 0.035 for one that sees skin.")
    ] = 0.0,
    motion: Annotated[
        Path | None, typer.Option(help="Marker file of a recorded arm that shapes the motion.", show_default=False)
    ] = None,
) -> None:
    """Simulate an RGB-D scene of a person at work in a robot's cell, with exact truth."""
    from .wrists import simulated

    chosen = {
        "occlusion": occlusion,
        "frames": frames,
        "fps": fps,
        "width": size[0],
        "height": size[1],
        "side": side,
        "sensor_offset": sensor_offset,
        "motion": motion,
    }
    with progress("simulating", None):
        simulated(out, seed, chosen)
    say(str(out / "scene.yaml"))


app.command()(people)
app.command("simulate-people")(simulate_people)
app.command()(imu)
app.command()(walk)
app.command("simulate-walk")(simulate_walk)
app.command()(room)
app.command()(register)
