"""`handtrack dataset`: a scene file in, a dataset of any size out; or its address in, what is in it out."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from .console import error, note, say, say_json

_MAKE = "SCENE"  # the command that is meant where the first word is none

_Options = Annotated[
    list[str] | None,
    typer.Option("--storage-option", help="KEY=VALUE for the object store; repeat it.", show_default=False),
]
_Workers = Annotated[int | None, typer.Option(min=1, help="Processes; one for each core if not given.")]
_Surface = Annotated[Path | None, typer.Option(help="Skinned hand mesh (.glb) for hands of the scene that name none.")]
_Json = Annotated[bool, typer.Option("--json", help="JSON for machines.")]


class SceneFirst(TyperGroup):
    """A group whose first word is a scene file, unless it is exactly the name of a command."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Arguments with the name of the command in front."""
        args = args or ["--help"]
        if args[0] not in (*self.commands, "--help"):
            args = [_MAKE, *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=SceneFirst,
    subcommand_metavar="SCENE|verify|browse [OPTIONS] ...",
    help="Make datasets of labelled images from a scene file, check them, look at them.",
)


@app.command(_MAKE)
def make(
    scene: Annotated[Path, typer.Argument(help="Scene file; `./verify` for one of that name.", show_default=False)],
    out: Annotated[str, typer.Option(help="Folder, or s3://bucket/prefix, to write to.", show_default=False)],
    count: Annotated[int, typer.Option(min=1, help="Number of images.", show_default=False)],
    seed: Annotated[int, typer.Option(min=0, help="Decides every random choice.")] = 1,
    layout: Annotated[
        Literal["shards", "coco", "folders"], typer.Option("--format", help="How images and labels are stored.")
    ] = "shards",
    shard_size: Annotated[int, typer.Option(min=1, help="Images that are made and recorded as one piece.")] = 1000,
    workers: _Workers = None,
    engine: Annotated[Literal["pool", "dask"], typer.Option(help="What runs the workers.")] = "pool",
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a running Dask scheduler, tcp://127.0.0.1:8786.")
    ] = None,
    allow_remote: Annotated[
        bool, typer.Option("--allow-remote", help="The scheduler may be another machine's.")
    ] = False,
    surface: _Surface = None,
    storage_option: _Options = None,
    as_json: _Json = False,
) -> None:
    """Make a dataset (`handtrack dataset SCENE --out URI --count N`); run it again to go on after an interruption."""
    from synth.dataset.engine import Stopped

    from .dataset_making import Machine, made

    machine = Machine(engine, workers, scheduler, allow_remote)
    try:
        facts = made(scene, out, tuple(storage_option or ()), layout, seed, count, shard_size, surface, machine)
    except Stopped as stopped:
        error(str(stopped))
        raise typer.Exit(1) from stopped
    if as_json:
        say_json(facts.as_data())
    else:
        say(facts.as_line())


@app.command()
def verify(
    uri: Annotated[str, typer.Argument(help="Folder, or s3://bucket/prefix.", show_default=False)],
    scene: Annotated[
        Path | None, typer.Option(help="The scene file, where it refers to other files.", show_default=False)
    ] = None,
    share: Annotated[float, typer.Option(min=0.0, max=1.0, help="Of the images, that are rendered again.")] = 0.01,
    workers: _Workers = None,
    surface: _Surface = None,
    storage_option: _Options = None,
    as_json: _Json = False,
) -> None:
    """Check counts, checksums and label rules, and render some images again."""
    from synth.dataset.engine import Stopped

    from .dataset_verifying import verified

    try:
        facts = verified(uri, tuple(storage_option or ()), scene, surface, share, workers)
    except Stopped as stopped:
        error(str(stopped))
        raise typer.Exit(1) from stopped
    if as_json:
        say_json(facts.as_data())
    else:
        say(facts.as_line())
    if facts.verdict.problems:
        for problem in facts.verdict.problems:
            note(f"  {problem}")
        error(f"{uri}: {len(facts.verdict.problems)} problems")
        raise typer.Exit(1)


@app.command()
def browse(
    uri: Annotated[str, typer.Argument(help="Folder, or s3://bucket/prefix.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Page to write.")] = Path("dataset.html"),
    count: Annotated[int, typer.Option(min=1, max=400, help="Images on the contact sheet.")] = 48,
    seed: Annotated[int, typer.Option(min=0, help="Decides which images.")] = 1,
    storage_option: _Options = None,
) -> None:
    """Write a page to look at: a contact sheet with labels drawn, and distributions of occlusion, pose and view."""
    from .dataset_browse import browse as written
    from .dataset_making import needed

    needed()
    shown = written(uri, out, count, seed, tuple(storage_option or ()))
    say(f"{out}: {shown} images")
