"""`handtrack models`: the name of a built-in model or a model file in, its tree or its text out."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..errors import InputError
from .console import say, say_json, table

app = typer.Typer(help="List, show and export hand models.", no_args_is_help=False)

_SHAPE = ("length", "radius", "base_offset", "tip_offset")
_Name = Annotated[str, typer.Argument(help="Name of a built-in model, or a model file.", show_default=False)]


@app.command("list")
def list_models(as_json: Annotated[bool, typer.Option("--json", help="JSON for machines.")] = False) -> None:
    """The built-in models."""
    from ..kinematics.builtin import model, model_names

    models = [model(name) for name in model_names()]
    if as_json:
        say_json([{"name": m.name, "joints": m.joint_names, "links": m.link_frame.size} for m in models])
    else:
        rows = [[m.name, len(m.joint_names), m.link_frame.size, ", ".join(m.joint_names[:4])] for m in models]
        say(table(["model", "joints", "links", "first joints"], rows))


@app.command()
def show(
    name: _Name,
    as_json: Annotated[bool, typer.Option("--json", help="JSON for machines.")] = False,
    plot: Annotated[Path | None, typer.Option(help="Picture to write: a .png, .svg or .pdf file.")] = None,
) -> None:
    """The frames of a model as a table: parent, joint, limits (degrees; lengths for sliding joints) and pill.

    Below it the pills whose ends are moved or whose shape has a sigma, and the couplings.
    """
    from ..sequences import find_model
    from .model_tables import coupling_lines, frame_rows, shape_rows

    model = find_model(name)
    rows, shapes = frame_rows(model), shape_rows(model)
    if plot is not None:
        from .pictures import model_figure, save

        save(model_figure(model), plot)
    if as_json:
        keys = ("id", "parent", "joint", "low", "high", "length", "radius_base", "radius_tip")
        frames = [dict(zip(keys, row, strict=True)) for row in rows]
        shape_keys = ("id", "base_offset", "tip_offset", *(f"{key}_sigma" for key in _SHAPE))
        known = [dict(zip(shape_keys, row, strict=True)) for row in shapes]
        couplings = coupling_lines(model)
        say_json({"name": model.name, "units": model.units, "frames": frames, "shapes": known, "couplings": couplings})
        return
    say(f"{model.name}: {len(model.joint_names)} joints, {model.link_frame.size} links, lengths in {model.units}")
    header = ["id", "parent", "joint", "low", "high", "length", "radius", "to"]
    say(table(header, [["" if cell is None else cell for cell in row] for row in rows]))
    if shapes:
        header = ["id", "base end moved by", "tip end by", "sigma: length", "radii", "base end", "tip end"]
        say(table(header, [[_short(cell) for cell in row] for row in shapes]))
    for line in coupling_lines(model):
        say(line)


def _short(cell: object) -> object:
    return " ".join(f"{x:.3g}" for x in cell) if isinstance(cell, list) else cell


@app.command()
def export(
    name: _Name,
    out: Annotated[Path | None, typer.Option(help="File to write; by default the text goes to the terminal.")] = None,
    form: Annotated[
        Literal["yaml", "urdf"], typer.Option("--format", help="Model file, or URDF for robot tools.")
    ] = "yaml",
) -> None:
    """The model as a file: a model.yaml to be changed and given to `track --model`, or URDF."""
    from ..formats import export_urdf, write_text
    from ..formats.model_writing import model_text
    from ..sequences import find_model

    model = find_model(name)
    text = model_text(model) if form == "yaml" else export_urdf(model)
    if out is None:
        say(text.rstrip())
    elif not out.absolute().parent.is_dir() or out.is_dir():
        raise InputError(f"--out: {out}; a file in an existing folder was wanted")
    else:
        write_text(out, text)
