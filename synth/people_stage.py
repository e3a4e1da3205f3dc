"""People, things and a robot on a stage in; what the camera sees of every keypoint, and depth along its rays, out.

The stage's axes: x to the camera's right, y away from it, z up, metres. Things are boxes turned about z, met
analytically; people and robot are pills, met exactly. A keypoint is looked for on rays through a disc about it: a ray
sees it if what it meets first is a part of its own body that shows it, near the keypoint's own depth.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from handtrack.camera import project_camera
from handtrack.pills import Pills, ray_hits

from .cell_room import Boxes
from .cell_view import Eye
from .people import PARTS, Body, capsules_of, flesh, showing

_RING = 2.0 * math.pi * np.arange(6) / 6.0
_DISC = 0.6 * np.concatenate([np.zeros((1, 2)), np.column_stack([np.cos(_RING), np.sin(_RING)])])
_SHOWING = showing()


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Everything that light meets, in f frames with q people, b moving boxes and l links of a robot.

    Attributes
    ----------
    eye : Eye
        Camera and where it stands.
    bodies : tuple of q Body
    p : (f, q, 16, 3)
        True keypoints, metres, camera axes; NaN where a person is not there.
    still : Boxes
        At rest, in the stage's axes.
    centre, turn, half : (f, b, 3), (f, b), (b, 3)
        Of moving boxes, in the stage's axes.
    links, radius : (f, l, 2, 3), (l,)
        Axes of the robot's links, in camera axes, and their radii.
    """

    eye: Eye
    bodies: tuple[Body, ...]
    p: Float[np.ndarray, "f q 16 3"]
    still: Boxes
    centre: Float[np.ndarray, "f b 3"]
    turn: Float[np.ndarray, "f b"]
    half: Float[np.ndarray, "b 3"]
    links: Float[np.ndarray, "f l 2 3"]
    radius: Float[np.ndarray, " l"]


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """Pixels of all keypoints (f, q, 16, 2), the share of each that is seen, 0..1, and what there is to meet."""

    stage: Stage
    uv: Float[np.ndarray, "f q 16 2"]
    share: Float[np.ndarray, "f q 16"]
    parts: Float[np.ndarray, "f q 15 2 3"]


def nothing_moves(frames: int) -> tuple[Float[np.ndarray, "f 0 3"], Float[np.ndarray, "f 0"], Float[np.ndarray, "0 3"]]:
    """Centre, turn and half size of no boxes."""
    return np.zeros((frames, 0, 3)), np.zeros((frames, 0)), np.zeros((0, 3))


def look(stage: Stage) -> Sight:
    """What the camera sees of every keypoint."""
    f, q = stage.p.shape[:2]
    parts = np.stack([capsules_of(body, stage.p[:, i]) for i, body in enumerate(stage.bodies)], axis=1)
    uv = project_camera(stage.eye.camera, stage.p.reshape(-1, 3)).reshape(f, q, 16, 2)
    sight = Sight(stage, uv, np.zeros((f, q, 16)), parts)
    return Sight(stage, uv, np.stack([_shares(sight, i) for i in range(f)]), parts)


def _shares(sight: Sight, frame: int) -> Float[np.ndarray, "q 16"]:
    """Share of each keypoint's disc that is seen in one frame."""
    stage, camera = sight.stage, sight.stage.eye.camera
    p = stage.p[frame]
    q = p.shape[0]
    size = np.stack([flesh(body) for body in stage.bodies])
    xy = (p[:, :, None, :2] + size[:, :, None, None] * _DISC) / p[:, :, None, 2:]
    pixel = xy * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    inside = ((pixel >= -0.5) & (pixel <= np.array([camera.width, camera.height]) - 0.5)).all(axis=-1)
    z, pill = _first(sight, frame, xy.reshape(-1, 2))
    z, pill = z.reshape(xy.shape[:-1]), pill.reshape(xy.shape[:-1])
    who, part = np.divmod(pill, len(PARTS))
    own = (pill >= 0) & (who == np.arange(q)[:, None, None])
    own &= _SHOWING[np.arange(16)[:, None], np.where(own, part, 0)]
    with np.errstate(invalid="ignore"):
        near = np.abs(z - p[:, :, None, 2]) < 2.0 * size[:, :, None] + 0.05
    return (own & near & inside).mean(axis=-1)


def depth_at(sight: Sight, frame: int, uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """True depth z of what each pixel shows in a frame, metres; inf where it shows nothing."""
    camera = sight.stage.eye.camera
    return _first(sight, frame, (uv - (camera.cx, camera.cy)) / (camera.fx, camera.fy))[0]


def _first(sight: Sight, frame: int, xy: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, " n"], np.ndarray]:
    """Depth of what rays through normalised pixels meet first, and the pill (q * parts, then links; -1: another)."""
    stage, eye = sight.stage, sight.stage.eye
    known = np.asarray(np.isfinite(xy).all(axis=1))
    rays = np.where(known[:, None], np.column_stack([xy, np.ones(xy.shape[0])]), [0.0, 0.0, -1.0])
    there = ~np.isnan(stage.p[frame, :, 0, 0])
    ends = np.where(there[:, None, None, None], sight.parts[frame], -1e3).reshape(-1, 2, 3)  # who is away is behind
    ends = np.concatenate([ends, stage.links[frame]])
    radius = np.concatenate([*(body.radius for body in stage.bodies), np.repeat(stage.radius[:, None], 2, axis=1)])
    pills = Pills(np.ascontiguousarray(ends[:, 0]), np.ascontiguousarray(ends[:, 1]), radius)
    hits = ray_hits(pills, np.zeros_like(rays), rays)
    walls = box_hits(
        np.concatenate([stage.still.centre, stage.centre[frame]]),
        np.concatenate([stage.still.half, stage.half]),
        np.concatenate([stage.still.turn, stage.turn[frame]]),
        eye.place,
        rays @ eye.R,
    )
    links = hits.pill >= len(stage.bodies) * len(PARTS)
    return np.minimum(hits.t, walls), np.where((walls < hits.t) | links, -1, hits.pill)


def box_hits(
    centre: Float[np.ndarray, "b 3"],
    half: Float[np.ndarray, "b 3"],
    turn: Float[np.ndarray, " b"],
    origin: Float[np.ndarray, " 3"],
    vectors: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, " n"]:
    """Share of each vector at which the first box, turned about z, is met from outside; inf where none is.

    >>> one = np.ones((1, 3))
    >>> box_hits(0 * one, one, np.zeros(1), np.array([-3.0, 0.0, 0.0]), np.eye(3)[:2]).tolist()
    [2.0, inf]
    """
    c, s = np.cos(turn), np.sin(turn)
    away = origin - centre
    x, y, z = (vectors[:, i, None] for i in range(3))
    near, far = np.full((vectors.shape[0], turn.size), -np.inf), np.inf
    for m, d, size in (
        (c * away[:, 0] + s * away[:, 1], c * x + s * y, half[:, 0]),
        (c * away[:, 1] - s * away[:, 0], c * y - s * x, half[:, 1]),
        (away[:, 2], z, half[:, 2]),
    ):
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.copysign(size, d)
            # along a face's plane 0 / 0 says nothing about that slab: fmax and fmin pass it over
            near, far = np.fmax(near, (-m - reach) / d), np.fmin(far, (-m + reach) / d)
    return np.where((near <= far) & (near >= 0.0), near, np.inf).min(axis=1, initial=np.inf)
