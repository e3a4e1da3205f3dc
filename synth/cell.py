"""A seed and settings in, an RGB-D scene folder of a person at work in a cell out.

What happens is drawn by `cell_plan.make_cell`; here the sensors look at it, and the scene is written. The cell of a
left-handed person is the mirror image of a right-handed one's, about the camera's plane x = 0.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32

from handtrack.camera import Camera, perspective
from handtrack.formats.rgbd import write_rgbd
from handtrack.formats.robots import RobotVolume, robot_text
from handtrack.formats.skeletons import KEYPOINTS, Detections, TruthPoints

from .cell_plan import Cell as Cell
from .cell_plan import make_cell as make_cell
from .cell_room import mesh_of, ply_of
from .cell_sensor import sense_depth, sense_keypoints, states_of
from .cell_settings import CellSettings as CellSettings
from .cell_view import person_and_robot, room_surfaces, with_pills

NEAREST = 0.4  # metres: readings of a depth camera begin here


def depth_frames(cell: Cell, rng: np.random.Generator) -> Iterator[Float32[np.ndarray, "h w"]]:
    """What the depth camera reports, frame by frame; metres, 0 where there is no reading."""
    settings = cell.settings
    room = room_surfaces(cell.room.boxes, cell.eye)
    for parts, links in zip(cell.parts, cell.links, strict=True):
        seen = with_pills(room, person_and_robot(cell.body, parts, links, cell.robot.radius), cell.eye.camera)
        depth = sense_depth(rng, seen, settings.noise, settings.holes, NEAREST, settings.farthest)
        yield depth if settings.side == "right" else np.ascontiguousarray(depth[:, ::-1])


def detections_of(cell: Cell, rng: np.random.Generator) -> Detections:
    """What the body tracker reports."""
    settings = cell.settings
    state = states_of(cell.share, round(settings.linger * settings.fps))
    noise, offset = settings.sensor_noise, settings.sensor_offset
    p, confidence = sense_keypoints(rng, cell.p, cell.share, state, noise, offset, settings.fps)
    if settings.side == "left":
        p, confidence, state = mirrored(p), confidence[:, _swapped()], state[:, _swapped()]
    f = settings.frames
    return Detections(np.arange(f) / settings.fps, np.arange(f), np.zeros(f, dtype=int), p, confidence, state)


def _swapped() -> list[int]:
    """Order of the keypoints of a mirror image."""
    other = [name.replace("left", "RIGHT").replace("right", "left").replace("RIGHT", "right") for name in KEYPOINTS]
    return [KEYPOINTS.index(name) for name in other]


def mirrored(p: Float[np.ndarray, "f 16 3"]) -> Float[np.ndarray, "f 16 3"]:
    """Keypoints of the mirror image about the camera's plane x = 0: left and right change places."""
    return p[:, _swapped()] * [-1.0, 1.0, 1.0]


def scene_camera(cell: Cell) -> Camera:
    """The camera that the written scene has."""
    c = cell.eye.camera
    if cell.settings.side == "right":
        return c
    return perspective(c.width, c.height, c.fx, c.fy, c.width - 1 - c.cx, c.cy, np.eye(3), np.zeros(3))


def room_ply(cell: Cell) -> bytes:
    """The furniture, floor and walls as a mesh in camera axes: without person and robot."""
    vertices, triangles = mesh_of(cell.room.boxes)
    vertices = cell.eye.see(vertices)
    if cell.settings.side == "left":
        vertices, triangles = vertices * [-1.0, 1.0, 1.0], triangles[:, ::-1]
    return ply_of(vertices, np.ascontiguousarray(triangles))


def robot_volume(cell: Cell) -> RobotVolume:
    """The robot's pills in camera axes."""
    flip = np.array([1.0 if cell.settings.side == "right" else -1.0, 1.0, 1.0])
    return RobotVolume(cell.links * flip, np.tile(cell.robot.radius, (cell.settings.frames, 1)))


def simulate_cell(folder: Path | str, seed: int, settings: CellSettings | None = None, replace: bool = False) -> Cell:
    """Write a complete RGB-D scene folder: depth, detections, room, truth, and the robot's volume (`robot.csv`).

    Returns
    -------
    Cell
        What was written, with what the files do not say.

    Raises
    ------
    InputError
        If the folder is not empty and may not be replaced, or the recorded motion cannot be read.
    """
    cell = make_cell(seed, settings)
    truth = cell.p if cell.settings.side == "right" else mirrored(cell.p)
    write_rgbd(
        folder,
        cell.settings.fps,
        scene_camera(cell),
        depth_frames(cell, np.random.default_rng([seed, 1])),
        detections_of(cell, np.random.default_rng([seed, 2])),
        room_ply(cell),
        TruthPoints(truth[:, None]),
        (("robot.csv", robot_text(robot_volume(cell)).encode()),),
        replace,
    )
    return cell
