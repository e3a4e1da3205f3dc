"""A scene file and a seed in, the shot of any image out, by its number alone.

Everything about a sequence is drawn from (seed, group, sequence), a generator of its own for each group of choices, so
that a scene with one more occluder keeps its cameras; frames only differ in time. A sequence is drawn whole each time
one of its frames is asked for, unless it is the one asked for last.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from handtrack.camera import Camera, orthographic
from handtrack.errors import InputError
from handtrack.formats.glb import SkinnedMesh, read_glb
from handtrack.formats.models import read_model
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.kinematics.builtin import model_names

from ..labels.bodies import Body, MeshHand, PillHand, Placed, Rigid, points_of
from ..labels.shot import Exposure, Shot, parts_of
from . import backgrounds, views
from .hands import longer, own_axes, pill_hand, scaled, skinned_hand
from .occluders import ball, box, mesh_body, read_body, stick
from .painting import painted
from .poses import path_of
from .scene_file import SceneFile
from .scene_schema import HandFile, OccluderFile
from .wandering import Wandering, offset, wandering

CAMERA, LIGHTS, BACKGROUND, EXPOSURE, PAINT, HANDS, OCCLUDERS = 1, 2, 3, 4, 5, 10, 30  # groups of random choices
GRASP_ROOM = 6.0  # mm of half thickness below which nothing fits between the fingers
ObjMesh = tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "t 3"]]


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A scene with everything that it refers to in memory: shots of all numbers come from it.

    Attributes
    ----------
    hands : tuple of (right, left)
        Both sides of each entry of the scene's hands.
    motions : tuple
        Joint values (m, j) of each entry that takes them from a file, for the right and the left side; None else.
    meshes : tuple
        Vertices and triangles of each entry of the scene's occluders; None where it is no mesh.
    """

    scene: SceneFile
    seed: int
    hands: tuple[tuple[PillHand | MeshHand, PillHand | MeshHand], ...]
    motions: tuple[tuple[Float[np.ndarray, "m j"], Float[np.ndarray, "m j"]] | None, ...]
    meshes: tuple[ObjMesh | None, ...]
    backgrounds: tuple[Path, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """A body on its way: `hand` is the number of the one that carries it (-1: none)."""

    shape: PillHand | MeshHand | Rigid
    R: Float[np.ndarray, "3 3"]
    t: Float[np.ndarray, " 3"]
    path: Wandering
    q: Float[np.ndarray, "m j"]
    hand: int = -1


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """All that the frames of a sequence share: a shot without bodies, and the bodies on their way."""

    shared: Shot
    moving: tuple[Moving, ...]


def prepare(scene: SceneFile, seed: int, surface: Path | None = None) -> Source:
    """Load what a scene refers to.

    Parameters
    ----------
    surface : Path, optional
        Mesh for skinned hands that name none.

    Raises
    ------
    InputError
        If a file is bad, or a hand of `kind: mesh` has no mesh.
    """
    hands, motions = [], []
    for i, file in enumerate(scene.schema.hands):
        pair = _both_sides(scene, file, i, surface)
        hands.append(pair)
        motions.append(_motions(scene, file, pair) if file.pose.type == "file" else None)
    meshes = tuple(
        read_body(scene.file(file.mesh)) if file.kind == "mesh" and file.mesh else None
        for file in scene.schema.occluders
    )
    folder = scene.schema.background.folder
    images = tuple(path for name, path in scene.inputs if folder and name.startswith(f"{folder}/"))
    return Source(scene, seed, tuple(hands), tuple(motions), meshes, images)


def _both_sides(scene: SceneFile, file: HandFile, i: int, surface: Path | None):
    if file.kind == "mesh":
        path = scene.file(file.mesh) if file.mesh else surface
        if path is None:
            raise InputError(f"{scene.path}: hands[{i}]: 'mesh' is missing; name a file here or give --surface")
        mesh: SkinnedMesh = read_glb(path)
        return skinned_hand(mesh), skinned_hand(mesh, left=True)
    model = builtin_model(file.model) if file.model in model_names() else read_model(scene.file(file.model))
    return pill_hand(model), pill_hand(model, left=True)


def _motions(scene: SceneFile, file: HandFile, pair):
    """Joint values of a motion file for both sides."""
    from .motion_files import joint_motion

    path = scene.file(file.pose.file or "")
    sides = ("right", "left")
    return tuple(joint_motion(path, hand, scene.fps, side) for hand, side in zip(pair, sides, strict=True))


def shot(source: Source, index: int) -> Shot:
    """The shot of an image.

    Parameters
    ----------
    index : int
        `sequence * frames + frame`, >= 0.
    """
    frames = source.scene.frames
    sequence, frame = divmod(index, frames)
    drawn = _sequence(source, sequence)
    bodies: list[Body] = []
    for moving in drawn.moving:
        placed = _placed(moving, frame)
        if moving.hand >= 0:
            placed = _carried(bodies[moving.hand].placed, moving)
        bodies.append(Body(moving.shape, placed, moving.q[[frame, frame + 1]] if moving.q.size else np.zeros((2, 0))))
    return replace(drawn.shared, bodies=tuple(bodies), index=index, frame=frame)


def _placed(moving: Moving, frame: int) -> Placed:
    turns, shifts = zip(*(offset(moving.path, at) for at in (frame, frame + 1)), strict=True)
    R = np.stack([turn @ moving.R for turn in turns])
    return Placed(R, np.stack([turn @ moving.t + shift for turn, shift in zip(turns, shifts, strict=True)]))


def _carried(hand: Placed, moving: Moving) -> Placed:
    """Placement of what a hand holds."""
    return Placed(hand.R @ moving.R, (hand.R @ moving.t[:, None])[..., 0] + hand.t)


@lru_cache(maxsize=2)
def _sequence(source: Source, sequence: int) -> Drawn:
    schema = source.scene.schema

    def rng(group: int) -> np.random.Generator:
        return np.random.default_rng([source.seed, group, sequence])

    moving = [_hand(source, i, rng(HANDS + i)) for i in range(len(schema.hands))]
    mirrored = _is_left(moving[0].shape)
    camera = views.camera(rng(CAMERA), schema.camera, schema.image, mirrored)
    for i, file in enumerate(schema.occluders):
        moving += _occluders(source, i, file, rng(OCCLUDERS + i), camera, moving[0])
    parts = parts_of([Body(body.shape, _placed(body, 0), np.zeros((2, 0))) for body in moving])
    sensor, draw = schema.sensor, rng(EXPOSURE)
    ranges = (sensor.blur, sensor.readout, sensor.noise, sensor.vignette, sensor.gain)
    exposure = Exposure(*(float(draw.uniform(*given)) for given in ranges))
    paint = painted(rng(PAINT), parts, schema)
    lights, behind = views.lights(rng(LIGHTS), schema.lights), _background(source, rng(BACKGROUND))
    shared = Shot((), parts, paint, camera, lights, behind, exposure, source.seed, 0, sequence, 0)
    return Drawn(shared, tuple(moving))


def _is_left(shape: PillHand | MeshHand | Rigid) -> bool:
    return getattr(shape, "mirrored", False) or getattr(shape, "left", False)


def _hand(source: Source, i: int, rng: np.random.Generator) -> Moving:
    """A hand of its own size and side, about the origin; a second one apart from it."""
    file, frames = source.scene.schema.hands[i], source.scene.frames
    left = file.side == "left" or (file.side == "any" and rng.random() < 0.5)
    hand = source.hands[i][int(left)]
    scale, radius = rng.uniform(*file.scale), rng.uniform(*file.radii)
    factor = rng.uniform(file.lengths[0], file.lengths[1], hand.model.link_length.size)
    if isinstance(hand, PillHand) and file.lengths != (1.0, 1.0):
        hand = pill_hand(longer(hand.model, factor), left)
    hand = scaled(hand, scale, radius)
    pose, speed = file.pose, rng.uniform(*file.pose.speed)
    motions = source.motions[i]
    if motions is not None:
        motion = motions[int(left)]
        q = motion[(int(rng.integers(motion.shape[0])) + np.arange(frames + 1)) % motion.shape[0]]
    else:
        q = path_of(hand.model, rng, frames, speed, rng.uniform(*pose.spread), pose.type == "limits")
    path = wandering(rng, rng.uniform(*file.motion.translation), np.radians(rng.uniform(*file.motion.rotation)))
    R, middle = own_axes(hand)
    apart = np.zeros(3)
    if i > 0:
        turn = views.in_cone(rng, np.array([0.0, 0.0, 1.0]), (0.0, 180.0)) * np.radians(rng.uniform(*file.turned))
        R = Rotation.from_rotvec(turn).as_matrix() @ R
        apart = views.in_cone(rng, np.array([0.0, 0.0, 1.0]), (0.0, 180.0)) * rng.uniform(*file.apart)
    return Moving(hand, R, apart - R @ middle, path, q)


def _occluders(
    source: Source, i: int, file: OccluderFile, rng: np.random.Generator, camera: Camera, hand: Moving
) -> list[Moving]:
    """The occluders of one entry: some before the hand, or one between its fingers."""
    count = int(rng.integers(file.count[0], file.count[1] + 1))
    points = hand_points(hand)
    if not np.isfinite(points).any():
        points = np.zeros((1, 3))
    made = []
    for _ in range(count):
        body = _grasped(source, i, file, rng, hand) if file.place == "grasped" else None
        if body is None and file.place == "free":
            body = _free(source, i, file, rng, camera, points)
        if body is not None:
            made.append(body)
    return made


def _free(
    source: Source, i: int, file: OccluderFile, rng: np.random.Generator, camera: Camera, points: np.ndarray
) -> Moving:
    """One that stands between the camera and a random keypoint."""
    known = points[np.isfinite(points[:, 0])]
    target = known[int(rng.integers(known.shape[0]))]
    eye = -camera.R.T @ camera.t
    if camera.kind == "orthographic":
        eye = target - camera.R[2] * (camera.R[2] @ (target - eye))
    place = eye + (1.0 - rng.uniform(*file.nearer)) * (target - eye)
    place = place + views.in_cone(rng, camera.R[2], (90.0, 90.0)) * rng.uniform(*file.aside)
    shape = _shape(source, i, file, rng, rng.uniform(*file.size), rng.uniform(*file.length))
    path = wandering(rng, rng.uniform(*file.motion.translation), np.radians(rng.uniform(*file.motion.rotation)))
    return Moving(shape, Rotation.random(rng=rng).as_matrix(), place, path, np.zeros((0, 0)))


def _shape(source: Source, i: int, file: OccluderFile, rng: np.random.Generator, size: float, length: float) -> Rigid:
    if file.kind == "sphere":
        return ball(size)
    if file.kind == "pill":
        return stick(length, size, float(rng.uniform(0.6, 1.0)))
    if file.kind == "box":
        return box(np.array([size, *rng.uniform(file.size[0], file.size[1], 2)]))
    vertices, triangles = source.meshes[i] or (np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    return mesh_body(vertices, triangles, size)


def _grasped(source: Source, i: int, file: OccluderFile, rng: np.random.Generator, hand: Moving) -> Moving | None:
    """One held between the thumb's tip and the others', as thick as there is room; None where there is none."""
    points = hand_points(hand, world=False)
    tips = points[[4, 8, 12, 16, 20]]
    length, turn, size = rng.uniform(*file.length), Rotation.random(rng=rng).as_matrix(), rng.uniform(*file.size)
    if not np.isfinite(tips).all():
        return None
    others = tips[1:3].mean(axis=0)
    middle = 0.5 * (tips[0] + others)
    room = 0.5 * float(np.linalg.norm(others - tips[0])) - float(hand.shape.model.link_radius.mean())  # type: ignore[union-attr]
    if room < GRASP_ROOM:
        return None
    thickness = min(2.0 * room, max(size, file.size[0]))
    if file.kind == "pill":  # across the palm, as a handle lies in the hand
        x = points[5] - points[17]
        x = x / np.linalg.norm(x)
        y = np.cross(np.cross(x, others - tips[0]), x)
        y = y / np.linalg.norm(y)
        turn = np.column_stack([x, y, np.cross(x, y)])
    shape = _shape(source, i, file, rng, thickness, length)
    return Moving(shape, turn, middle, wandering(rng, 0.0, 0.0), np.zeros((0, 0)), hand=0)


def hand_points(hand: Moving, world: bool = True) -> Float[np.ndarray, "k 3"]:
    """Keypoints of a hand at its sequence's first frame, in the world or in the hand's own axes."""
    straight = orthographic(1, 1, 1.0, 0.0, 0.0, np.eye(3), np.zeros(3))
    placed = _placed(hand, 0) if world else Placed(np.stack([np.eye(3)] * 2), np.zeros((2, 3)))
    return points_of(Body(hand.shape, placed, hand.q[:2]), 0.0, straight, 0).p_cam[0]


def _background(source: Source, rng: np.random.Generator):
    file, image = source.scene.schema.background, source.scene.schema.image
    size = (image.width, image.height)
    if file.kind == "grey":
        return backgrounds.plain(rng, size, file.level)
    if file.kind == "colours":
        return backgrounds.colours(rng, size, file.level)
    return backgrounds.piece(rng, size, source.backgrounds)
