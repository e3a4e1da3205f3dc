"""`handtrack models`: the name of a built-in model or a model file in, its tree or its text out."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ..errors import InputError
from .console import say, say_json, table

if TYPE_CHECKING:
    from ..kinematics import Model

app = typer.Typer(help="List, show and export hand models.", no_args_is_help=False)

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
def show(name: _Name, as_json: Annotated[bool, typer.Option("--json", help="JSON for machines.")] = False) -> None:
    """The frames of a model as a table: parent, joint, limits (degrees; lengths for sliding joints) and pill."""
    from ..sequences import find_model

    model = find_model(name)
    rows = _frames(model)
    if as_json:
        keys = ("id", "parent", "joint", "low", "high", "length", "radius_base", "radius_tip")
        frames = [dict(zip(keys, row, strict=True)) for row in rows]
        say_json({"name": model.name, "units": model.units, "frames": frames, "couplings": _couplings(model)})
        return
    say(f"{model.name}: {len(model.joint_names)} joints, {model.link_frame.size} links, lengths in {model.units}")
    header = ["id", "parent", "joint", "low", "high", "length", "radius", "to"]
    say(table(header, [["" if cell is None else cell for cell in row] for row in rows]))
    for line in _couplings(model):
        say(line)


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


def _frames(model: "Model") -> list[list[object]]:
    rows: list[list[object]] = []
    for i in range(model.frame_ids.size):
        joint, parent = int(model.joint[i]), int(model.parent[i])
        row: list[object] = [int(model.frame_ids[i]), int(model.frame_ids[parent]) if parent >= 0 else 0]
        if joint < 0:
            row += [None, None, None]
        else:
            limits = [float(x) if model.prismatic[i] else math.degrees(x) for x in model.limits[joint]]
            row += [model.joint_names[joint], *(limit if math.isfinite(limit) else None for limit in limits)]
        links = [k for k in range(model.link_frame.size) if int(model.link_frame[k]) == i]
        pill = [[float(model.link_length[k]), *map(float, model.link_radius[k])] for k in links]
        rows.append(row + (list(pill[0]) if pill else [None, None, None]))
    return rows


def _couplings(model: "Model") -> list[str]:
    """One line for each joint that follows others, in the units of files."""
    lines = []
    slides = {int(j): bool(p) for j, p in zip(model.joint, model.prismatic, strict=True) if j >= 0}
    for joint in range(len(model.joint_names)):
        if joint in model.free:
            continue
        own = 1.0 if slides[joint] else 180.0 / math.pi
        terms = []
        for column, source in enumerate(model.free):
            ratio = float(model.coupling[joint, column])
            if ratio:
                unit = own / (1.0 if slides[int(source)] else 180.0 / math.pi)
                terms.append(f"{ratio * unit:g} {model.joint_names[int(source)]}")
        offset = float(model.coupling_offset[joint]) * own
        lines.append(f"{model.joint_names[joint]} = {' + '.join(terms)}" + (f" + {offset:g}" if offset else ""))
    return lines
