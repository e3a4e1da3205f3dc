"""A cell in camera axes in, the depth of every pixel and how much of every keypoint the camera sees out.

The furniture is met analytically (`cell_room.first_hits`), once a scene, because it rests; the person and the robot are
pills, met exactly in every frame. A keypoint is looked for on rays through a disc about its pixel: a ray sees it if
what it meets first is a part of the body that belongs to the keypoint, near the keypoint's own depth.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int8

from handtrack.camera import Camera, perspective
from handtrack.pills import Pills, ray_hits

from .cell_room import Boxes, first_hits
from .people import PARTS, Body, flesh, showing
from .raycast import cast, pixel_grid

SEEN, BY_ROOM, BY_ROBOT, BY_BODY, OUTSIDE = range(5)  # what hides a keypoint, or nothing
DISC = 0.7  # radius of the disc, in radii of the body there

_RINGS = ((0.0, 1), (0.5, 6), (1.0, 12))
_DISC = np.array(
    [[r * math.cos(2 * math.pi * i / n), r * math.sin(2 * math.pi * i / n)] for r, n in _RINGS for i in range(n)]
)


@dataclass(frozen=True, slots=True, eq=False)
class Eye:
    """Where the camera stands in the cell: `x_cam = R (x_cell - place)`."""

    place: Float[np.ndarray, " 3"]
    R: Float[np.ndarray, "3 3"]
    camera: Camera

    def see(self, p_cell: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Points of the cell in camera axes."""
        return (p_cell - self.place) @ self.R.T


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """What each pixel sees: depth (h, w), metres, inf for nothing, and the cosine of the angle of incidence."""

    depth: Float[np.ndarray, "h w"]
    facing: Float[np.ndarray, "h w"]


def random_eye(rng: np.random.Generator, width: int, height: int, field_of_view: float) -> Eye:
    """A camera 2.1 to 2.9 m away, to the front left of the person, looking down on the table by 10 to 24 degrees.

    Parameters
    ----------
    field_of_view : float
        Horizontal, degrees.
    """
    goal = np.array([0.1, 0.3, 1.1]) + rng.uniform(-0.06, 0.06, 3)
    around, above, far = (
        np.radians(rng.uniform(144.0, 163.0)),
        np.radians(rng.uniform(10.0, 24.0)),
        rng.uniform(2.1, 2.9),
    )
    outward = np.array([np.cos(around) * np.cos(above), np.sin(around) * np.cos(above), np.sin(above)])
    z = -outward
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = x / np.linalg.norm(x)
    roll = math.radians(rng.uniform(-2.0, 2.0))
    y = np.cross(z, x)
    x, y = math.cos(roll) * x + math.sin(roll) * y, math.cos(roll) * y - math.sin(roll) * x
    focal = 0.5 * width / math.tan(math.radians(0.5 * field_of_view))
    cx, cy = np.array([0.5 * (width - 1), 0.5 * (height - 1)]) + rng.uniform(-0.01, 0.01, 2) * width
    camera = perspective(width, height, focal, focal, float(cx), float(cy), np.eye(3), np.zeros(3))
    return Eye(goal + far * outward, np.stack([x, y, z]), camera)


def room_surfaces(boxes: Boxes, eye: Eye) -> Surfaces:
    """The empty cell."""
    camera = eye.camera
    flat = pixel_grid(camera)[1:-1, 1:-1].reshape(-1, 2)
    d = np.column_stack([flat, np.ones(flat.shape[0])])
    share, normal = first_hits(boxes, eye.place, d @ eye.R)
    facing = np.abs((normal * (d @ eye.R)).sum(axis=1)) / np.linalg.norm(d, axis=1)
    shape = (camera.height, camera.width)
    return Surfaces(share.reshape(shape), facing.reshape(shape))


def with_pills(room: Surfaces, pills: Pills, camera: Camera) -> Surfaces:
    """The cell with pills (camera axes) in it."""
    buffers = cast(pills, camera)
    flat = pixel_grid(camera)[1:-1, 1:-1]
    length = np.sqrt((flat * flat).sum(axis=-1) + 1.0)
    facing = np.abs((buffers.normal[..., :2] * flat).sum(axis=-1) + buffers.normal[..., 2]) / length
    nearer = buffers.depth < room.depth
    return Surfaces(np.where(nearer, buffers.depth, room.depth), np.where(nearer, facing, room.facing))


def person_and_robot(
    body: Body,
    parts: Float[np.ndarray, "parts 2 3"],
    links: Float[np.ndarray, "l 2 3"],
    radius: Float[np.ndarray, " l"],
) -> Pills:
    """The pills of one frame: first the person's parts, then the robot's links."""
    ends = np.concatenate([parts, links])
    radii = np.concatenate([body.radius, np.repeat(radius[:, None], 2, axis=1)])
    return Pills(np.ascontiguousarray(ends[:, 0]), np.ascontiguousarray(ends[:, 1]), radii)


def visible_share(
    body: Body,
    p_cam: Float[np.ndarray, "f 16 3"],
    parts: Float[np.ndarray, "f parts 2 3"],
    links: Float[np.ndarray, "f l 2 3"],
    radius: Float[np.ndarray, " l"],
    boxes: Boxes,
    eye: Eye,
) -> tuple[Float[np.ndarray, "f 16"], Int8[np.ndarray, "f 16"]]:
    """Share of each keypoint's disc that the camera sees, 0..1, and what hides the most of the rest.

    All points are in camera axes but the boxes, which are in the cell's frame.
    """
    f = p_cam.shape[0]
    size = flesh(body)
    directions = p_cam[:, :, None, :2] + DISC * size[:, None, None] * _DISC
    directions = directions / p_cam[:, :, None, 2:]
    d = np.concatenate([directions, np.ones((*directions.shape[:-1], 1))], axis=-1)
    still = first_hits(boxes, eye.place, d.reshape(-1, 3) @ eye.R)[0].reshape(d.shape[:-1])
    pixel = d[..., :2] * (eye.camera.fx, eye.camera.fy) + (eye.camera.cx, eye.camera.cy)
    outside = ((pixel < -0.5) | (pixel > np.array([eye.camera.width, eye.camera.height]) - 0.5)).any(axis=-1)
    own = np.column_stack([showing(), np.zeros((16, links.shape[1] + 1), dtype=bool)])  # the last column: no pill
    blocked = np.empty(d.shape[:-1], dtype=np.int8)
    for i in range(f):
        pills = person_and_robot(body, parts[i], links[i], radius)
        rays = d[i].reshape(-1, 3)
        hits = ray_hits(pills, np.zeros_like(rays), rays)
        t, pill = hits.t.reshape(d.shape[1:3]), hits.pill.reshape(d.shape[1:3])
        near = np.abs(t - p_cam[i, :, 2:]) < 2.0 * size[:, None] + 0.05
        fits = own[np.arange(16)[:, None], pill] & near
        blocked[i] = np.where(fits, SEEN, np.where(pill >= len(PARTS), BY_ROBOT, BY_BODY))
        blocked[i][still[i] < t] = BY_ROOM
    blocked[outside] = OUTSIDE
    counts = np.stack([(blocked == cause).sum(axis=-1) for cause in range(5)], axis=-1)
    cause = np.where(counts[..., 1:].any(axis=-1), counts[..., 1:].argmax(axis=-1) + 1, SEEN).astype(np.int8)
    return counts[..., SEEN] / _DISC.shape[0], cause


def hides(boxes: Boxes, eye: Eye, p_cell: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Whether the furniture stands between the camera and points of the cell."""
    return first_hits(boxes, eye.place, p_cell - eye.place)[0] < 1.0
