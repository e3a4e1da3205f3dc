"""`handtrack body room` and `body register`: depth images in, a mesh out; two cameras' pictures in, their relation out.

Each writes a picture beside its result: the room as the first camera would see it, the corners found in each image.
"""

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from jaxtyping import Float, UInt8

from ..body.board import Board, detect
from ..body.environment import Room, ray_caster
from ..body.registration import Gate, Pose, board_pose
from ..camera import Camera, rays
from ..errors import InputError
from ..formats.cameras import read_camera
from ..formats.images import image_paths, read_image
from ..formats.writing import write_bytes
from ..report.mosaic import side_by_side
from .console import progress, say, say_json, warning

SHOWN = 9  # pictures of each camera
WIDEST = 640  # pixels of each


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
    write_bytes(picture, _png(shaded(made, opened.camera, poses[0])))
    facts = {"mesh": str(out), "picture": str(picture), "images": len(poses), "triangles": made.triangles.shape[0]}
    if as_json:
        say_json(facts)
    else:
        say(f"{out}: {facts['triangles']} triangles from {facts['images']} depth images; {picture} shows it")


def shaded(room: Room, camera: Camera, pose: Float[np.ndarray, "4 4"]) -> UInt8[np.ndarray, "h w 3"]:
    """A room lit from the camera, which stands at `pose`; darker with the distance, blue where there is nothing."""
    v, u = np.mgrid[: camera.height, : camera.width].reshape(2, -1)
    _, way = rays(camera, np.stack([u, v], axis=1).astype(float))
    way = 20.0 * way @ pose[:3, :3].T
    share = ray_caster(room).hits(pose[:3, 3], way).reshape(camera.height, camera.width)
    depth = 20.0 * share
    seen = np.where(np.isfinite(depth), depth, np.nan)
    rise = np.hypot(np.gradient(seen, axis=0) * camera.fy, np.gradient(seen, axis=1) * camera.fx) / seen
    light = 1.0 / np.sqrt(1.0 + rise**2)  # cosine between the surface's normal and the camera's axis
    level = np.where(np.isfinite(light), light, 0.5) * np.clip(1.0 - 0.12 * seen, 0.2, 1.0)
    grey = np.where(np.isfinite(depth), np.nan_to_num(255.0 * level), 0.0)[..., None]
    return np.where(np.isfinite(depth)[..., None], grey, (90.0, 50.0, 40.0)).astype(np.uint8)


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
    from ..body.registration_files import register_images, write_registration

    if out.suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"--out: {out} given; a name that ends in .yaml is wanted")
    try:
        gate = Gate(1e-3 * gate_mm, float(np.radians(gate_degrees)))
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
    write_bytes(picture, _png(side_by_side(pictures)))
    sigma = np.sqrt(np.diag(found.relation.covariance))
    facts = {
        "registration": str(out),
        "picture": str(picture),
        "A_0kin": found.relation.A_0kin.tolist(),
        "sigma_mm": float(1e3 * np.linalg.norm(sigma[:3])),
        "sigma_degrees": float(np.degrees(np.linalg.norm(sigma[3:]))),
        "moving_images": int(found.moving.kept.sum()),
        "fixed_images": int(found.fixed.kept.sum()),
        "moving_reprojection_px": found.relation.moving.pose.reprojection_px,
        "fixed_reprojection_px": found.relation.fixed.pose.reprojection_px,
    }
    if as_json:
        say_json(facts)
        return
    say(
        f"{out}: {facts['moving_images']} and {facts['fixed_images']} images, reprojection error "
        f"{facts['moving_reprojection_px']:.2f} and {facts['fixed_reprojection_px']:.2f} px, sigma "
        f"{facts['sigma_mm']:.1f} mm and {facts['sigma_degrees']:.2f} degrees; {picture} shows the corners"
    )


def drawn(folder: Path, camera_file: Path, board: Board) -> list[UInt8[np.ndarray, "h w 3"]]:
    """The first pictures of a folder, with the corners found and the board's axes."""
    from ..body.registration_files import draw_detection

    camera, out = read_camera(camera_file), []
    for path in image_paths(folder)[:SHOWN]:
        image = read_image(path)
        found = detect(image, board, camera)
        try:
            pose: Pose | None = board_pose(found, board, camera)
        except InputError:
            pose = None
        picture = draw_detection(image, found, pose, board, camera)
        words = f"{path.name}: {found.ids.size} corners" + (f", {pose.reprojection_px:.2f} px" if pose else "")
        picture[:30] //= 3
        cv2.putText(picture, words, (8, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255, 255, 255), 1, cv2.LINE_AA)
        scale = min(1.0, WIDEST / picture.shape[1])
        out.append(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    return out


def _png(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    return cv2.imencode(".png", picture)[1].tobytes()
