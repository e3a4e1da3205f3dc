"""`handtrack body room` and `body register`: depth images in, a mesh out; two cameras' pictures in, their relation out.

Each writes a picture beside its result: the room as the first camera would see it, the corners found in each image.
"""

import math
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from .console import progress, say, say_json, warning


def room(
    scene: Annotated[
        Path, typer.Argument(help="Folder with scene.yaml (RGB-D scene) and poses.csv.", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="Mesh to write, .ply; a .png beside shows it.", show_default=False)],
    voxel: Annotated[float, typer.Option(help="Edge of a voxel, metres.")] = 0.02,
    truncation: Annotated[
        float | None,
        typer.Option(help="Metres before and behind a surface that are averaged.", show_default="4 voxels"),
    ] = None,
    farthest: Annotated[float, typer.Option(help="Readings beyond are left out, metres.")] = 5.0,
    seen: Annotated[int, typer.Option(min=1, help="Images that must have looked at a place.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="A summary as JSON for machines.")] = False,
) -> None:
    """Fuse depth images with known poses into the mesh of a room."""
    from ..body.fusion import POSES, fuse_folder, read_poses, write_room
    from ..formats.rgbd import read_rgbd
    from ..formats.writing import write_bytes
    from .room_pictures import png, shaded

    if out.suffix.lower() != ".ply":
        raise InputError(f"--out: {out} given; a name that ends in .ply is wanted")
    try:
        with progress("fusing", None):
            made = fuse_folder(scene, voxel, truncation, farthest, seen)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"--{error}") from error
    for line in made.warnings:
        warning(line)
    opened = read_rgbd(scene)
    _, poses = read_poses(opened.path.parent / POSES, len(opened))
    write_room(out, made)
    picture = out.with_suffix(".png")
    write_bytes(picture, png(shaded(made, opened.camera, poses[0])))
    facts = {"mesh": str(out), "picture": str(picture), "images": len(poses), "triangles": made.triangles.shape[0]}
    if as_json:
        say_json(facts)
    else:
        say(f"{out}: {facts['triangles']} triangles from {facts['images']} depth images; {picture} shows it")


def register(
    moving: Annotated[Path, typer.Option(help="Folder of pictures by the camera that moves.", show_default=False)],
    poses: Annotated[Path, typer.Option(help="poses.csv: where that camera was in frame 0.", show_default=False)],
    moving_camera: Annotated[Path, typer.Option(help="Camera file of the moving camera.", show_default=False)],
    fixed: Annotated[
        Path, typer.Option(help="Folder of pictures by the camera that stands still.", show_default=False)
    ],
    fixed_camera: Annotated[Path, typer.Option(help="Camera file of the fixed camera.", show_default=False)],
    board: Annotated[Path, typer.Option(help="board.yaml: the ChArUco board that both see.", show_default=False)],
    out: Annotated[Path, typer.Option(help="YAML file to write; a .png beside shows the corners.", show_default=False)],
    gate_mm: Annotated[float, typer.Option(help="How far the board may seem to move, millimetres.")] = 50.0,
    gate_degrees: Annotated[float, typer.Option(help="How far it may seem to turn, degrees.")] = 3.0,
    as_json: Annotated[bool, typer.Option("--json", help="A summary as JSON for machines.")] = False,
) -> None:
    """Find where a fixed camera is in the frame of a moving one, by a ChArUco board that both see."""
    from ..body.board import read_board
    from ..body.registration import Gate
    from ..body.registration_files import register_images, write_registration
    from ..formats.writing import write_bytes
    from ..report.mosaic import side_by_side
    from .room_pictures import drawn, facts, png

    if out.suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"--out: {out} given; a name that ends in .yaml is wanted")
    try:
        gate = Gate(1e-3 * gate_mm, math.radians(gate_degrees))
    except ValueError as error:
        raise InputError(f"--gate-mm, --gate-degrees: {error}") from error
    with progress("looking for the board", None):
        found = register_images(moving, poses, moving_camera, fixed, fixed_camera, board, gate)
        plan = read_board(board)
        pictures = [*drawn(moving, moving_camera, plan), *drawn(fixed, fixed_camera, plan)]
    for line in found.warnings:
        warning(line)
    write_registration(out, found)
    picture = out.with_suffix(".png")
    write_bytes(picture, png(side_by_side(pictures)))
    shown = {"registration": str(out), "picture": str(picture), **facts(found)}
    if as_json:
        say_json(shown)
        return
    say(
        f"{out}: {shown['moving_images']} and {shown['fixed_images']} images, reprojection error "
        f"{shown['moving_reprojection_px']:.2f} and {shown['fixed_reprojection_px']:.2f} px, sigma "
        f"{shown['sigma_mm']:.1f} mm and {shown['sigma_degrees']:.2f} degrees; {picture} shows the corners"
    )
