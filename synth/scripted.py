"""A scene with a script in: pictures with what comes between camera and hand, and exact visible shares, out.

The share of a link in a frame is counted on pixel rays: those that meet the link before anything else, over those that
would meet it if nothing else were there. A finger's share is that of its links together.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from handtrack.camera import Camera
from handtrack.kinematics import Model

from . import _kernels
from .raycast import hull_box, pill_boxes, pill_table, pixel_grid
from .scene import Scene, clean_image, posed
from .sensor import sense

HIDDEN = 0.01  # share of a finger below which it counts as wholly hidden


@dataclass(frozen=True, slots=True, eq=False)
class Board:
    """A board between camera and hand: all pixels on one side of a line that moves.

    Attributes
    ----------
    normal : (2,)
        Unit vector across its edge, away from the board; pixels (x right, y down).
    reach : (m,)
        Where the edge is in each frame: the board covers `normal . xy < reach`.
    grey : float
        Mean grey level of its surface, which is faintly striped.
    """

    normal: Float[np.ndarray, " 2"]
    reach: Float[np.ndarray, " m"]
    grey: float = 90.0


@dataclass(frozen=True, slots=True, eq=False)
class Scripted:
    """A scene in which a finger is hidden on purpose.

    Attributes
    ----------
    kind : str
        Name of the script.
    watched : str
        Name of the finger that is hidden.
    link_share, finger_share : (m, l), (m, f)
        Exact visible shares, 0 to 1, of every link and finger of the model.
    hidden : (m,)
        Frames in which the watched finger is hidden; see `HIDDEN`, or the script where that is said otherwise.
    board : Board or None
    """

    scene: Scene
    kind: str
    watched: str
    link_share: Float[np.ndarray, "m l"]
    finger_share: Float[np.ndarray, "m f"]
    hidden: Bool[np.ndarray, " m"]
    board: Board | None = None


def finger_names(model: Model) -> tuple[str, ...]:
    """Name of each finger, in the order of `link_finger`: what its joints' names begin with.

    >>> from handtrack.kinematics.builtin import model
    >>> finger_names(model("two_finger"))
    ('middle', 'index')
    """
    ends = np.flatnonzero(model.link_is_tip)
    order = ends[np.argsort(model.link_finger[ends])]
    return tuple(model.joint_names[model.joint[model.link_frame[link]]].split("_")[0] for link in order)


def finger_joints(model: Model, finger: str) -> Int[np.ndarray, " n"]:
    """Joints of one finger."""
    return np.array([i for i, name in enumerate(model.joint_names) if name.startswith(f"{finger}_")], dtype=int)


def shares(scene: Scene, board: Board | None = None) -> tuple[Float[np.ndarray, "m l"], Float[np.ndarray, "m f"]]:
    """Visible share of every link, and of every finger, in every frame; 0 for one outside the image."""
    finger, camera = scene.model.link_finger, scene.camera
    alone = [np.arange(finger.size) == k for k in range(finger.size)]
    alone += [finger == f for f in range(finger.max() + 1)]
    links, fingers = [], []
    for frame in range(scene.truth.shape[0]):
        pills = posed(scene, frame)
        table, boxes = pill_table(pills), pill_boxes(pills, camera)
        x0, x1, y0, y1 = hull_box(boxes, camera)
        grid = np.ascontiguousarray(pixel_grid(camera)[y0 : y1 + 2, x0 : x1 + 2])
        boxes = boxes - np.array([x0, x0, y0, y0])
        part = _parts(camera, grid, table, boxes)
        if board is not None:
            shape = (camera.height, camera.width)
            part = np.where(covered(board, frame, shape)[y0:y1, x0:x1] > 0.5, -1, part)
        seen = np.bincount(part[part >= 0], minlength=finger.size).astype(float)
        whole = np.array([np.count_nonzero(_parts(camera, grid, table[its], boxes[its]) >= 0) for its in alone])
        whole = np.maximum(whole, 1)
        links.append(seen / whole[: finger.size])
        fingers.append(np.bincount(finger, seen) / whole[finger.size :])
    return np.array(links), np.array(fingers)


def _parts(
    camera: Camera, grid: Float[np.ndarray, "hp wp 2"], table: Float[np.ndarray, "l p"], boxes: Int[np.ndarray, "l 4"]
) -> Int[np.ndarray, "h w"]:
    """Link seen at each pixel of a part of the image, -1 for none."""
    height, width = grid.shape[0] - 2, grid.shape[1] - 2
    depth, part = np.full((height, width), np.inf), np.full((height + 2, width + 2), -1, dtype=np.int32)
    _kernels.cast_pixels(grid, camera.kind == "perspective", table, boxes, depth, part)
    return part[1:-1, 1:-1]


def covered(board: Board, frame: int, shape: tuple[int, int]) -> Float[np.ndarray, "h w"]:
    """Share of each pixel that the board covers, 0 to 1."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    return np.clip(board.reach[frame] - (board.normal[0] * u + board.normal[1] * v) + 0.5, 0.0, 1.0)


def picture(scripted: Scripted, frame: int) -> Float[np.ndarray, "h w"]:
    """The image of a frame as a camera delivers it."""
    return seen_by_camera(scripted.scene, frame, scripted.board)


def seen_by_camera(scene: Scene, frame: int, board: Board | None = None) -> Float[np.ndarray, "h w"]:
    """The image of a frame, with a board before it, through the sensor; its noise depends on scene and frame alone."""
    clean = clean_image(scene, frame)
    if board is not None:
        share = covered(board, frame, clean.shape)
        stripes = board.grey + 8.0 * np.sin(0.15 * np.arange(clean.shape[1]))
        clean = (clean + share * (stripes - clean)).astype(np.float32)
    return sense(clean, scene.sensor, np.random.default_rng([scene.seed, frame]))


def pictures(scripted: Scripted) -> Iterator[Float[np.ndarray, "h w"]]:
    """The images of all frames."""
    for frame in range(scripted.scene.truth.shape[0]):
        yield picture(scripted, frame)
