"""A task's name and a seed in; two people as a pose network and a depth camera report them, with exact truth, out.

`make_task` makes the tasks T0 to T3 of the people paper, III-C (`people_scripts`), `crossing` scenes for who-is-who:
`permuted` (two who stand, and are reported in a random order), `crossing` (two walk past each other), `entering`
(both come in at once) and `re-entering` (one leaves the image and comes back). The camera is the paper's: 848 x 480
pixels, 30 frames a second, a horizontal field of view of 90 degrees. Metres, seconds, camera axes.
"""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from handtrack.camera import Camera, perspective
from handtrack.formats.people_scenes import write_people_scene
from handtrack.formats.skeletons import LOST, TRACKED, Detections, TruthPoints

from .cell_motion import smooth_noise
from .cell_robot import Robot, links_of
from .cell_room import Boxes
from .cell_view import Eye
from .people import body_of
from .people_motion import acted, person_at, walked
from .people_scripts import TABLE, TASKS, script
from .people_stage import Sight, Stage, look, nothing_moves
from .pose_network import NetworkSettings, detect

CROSSINGS = ("permuted", "crossing", "entering", "re-entering")
NEAREST_STATURES = 0.10  # metres between the two people of a crossing: labels of twins that come back are ambiguous
ROBOT = Robot(np.array([-0.95, -0.12, TABLE]), np.zeros(3), 0.33, np.array([0.46, 0.50]), np.array([0.07, 0.06, 0.05]))
SAFE = np.array([-0.15, 0.0, 0.15])  # where the robot follows the operator's wrist (III-C), with a lag of 0.2 s


@dataclass(frozen=True, slots=True)
class TaskSettings:
    """What is left to the user; checked on construction.

    Attributes
    ----------
    frames, fps : int, float
        Length, and frames a second.
    motion : Path or None
        Markers of a recorded arm that sway the hands (see `people_motion.recorded_sway`); smooth noise without.
    network : NetworkSettings
        Errors of the pose network and the depth camera.
    """

    frames: int = 600
    fps: float = 30.0
    motion: Path | None = None
    network: NetworkSettings = field(default_factory=NetworkSettings)

    def __post_init__(self) -> None:
        for name, low, high in (("frames", 2, 1_000_000), ("fps", 1.0, 1000.0)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: got {getattr(self, name)}, wanted {low} to {high}")


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A simulated recording.

    Attributes
    ----------
    name : str
    detections : Detections
        What is reported, metres, camera axes.
    truth : TruthPoints
        Joints, not skin: 0 is the operator, 1 the collaborator; NaN where one is not there.
    fps : float
    camera : Camera
        Perspective, R = I and t = 0.
    who : (d,)
        Whom each detection truly shows, -1 for a false person.
    uv : (d, 16, 2)
        Pixels of the reported keypoints, NaN where unseen.
    visible : (f, 2, 16)
        Share of each true keypoint that the camera sees.
    """

    name: str
    detections: Detections
    truth: TruthPoints
    fps: float
    camera: Camera
    who: Int[np.ndarray, " d"]
    uv: Float[np.ndarray, "d 16 2"]
    visible: Float[np.ndarray, "f 2 16"]


def make_task(name: str, seed: int, settings: TaskSettings | None = None) -> Task:
    """A task of the people paper; the same arguments give the same recording.

    Parameters
    ----------
    name : 'T0', 'T1', 'T2' or 'T3'

    Raises
    ------
    ValueError
        For an unknown task.
    InputError
        For a recorded arm that cannot be read.

    >>> task = make_task("T0", 1, TaskSettings(frames=5))
    >>> task.truth.p.shape, task.detections.p.shape[1:]
    ((5, 2, 16, 3), (16, 3))
    """
    settings = settings or TaskSettings()
    if name not in TASKS:
        raise ValueError(f"name: got '{name}', wanted one of {', '.join(TASKS)}")
    rng = np.random.default_rng([seed, TASKS.index(name)])
    f, fps = settings.frames, settings.fps
    people = (
        person_at(rng, rng.uniform(1.60, 1.88), (-0.42, 0.42), -152.0),
        person_at(rng, rng.uniform(1.60, 1.88), (0.42, 0.42), 152.0),
    )
    done = script(rng, name, people, f, fps)
    p = [
        acted(rng, who, (done.hands[:, i, 0], done.hands[:, i, 1]), fps, settings.motion)
        for i, who in enumerate(people)
    ]
    eye = _eye(rng, (0.0, -1.75, 1.62), (0.0, 0.25, 1.12))
    lag = np.maximum(np.arange(f) - round(0.2 * fps), 0)
    links = links_of(ROBOT, p[0][lag, 4] + SAFE)
    still = _furniture(table=True)
    stage = Stage(
        eye, tuple(who.body for who in people), eye.see(np.stack(p, axis=1)), still, done.centre, done.turn, done.half,
        eye.see(links), ROBOT.radius,
    )  # fmt: skip
    return _recorded(rng, name, look(stage), fps, settings.network)


def crossing(seed: int, kind: str, settings: TaskSettings | None = None) -> Task:
    """Two people who walk or stand, for tests of identity; the same arguments give the same recording.

    Parameters
    ----------
    kind : 'permuted', 'crossing', 'entering' or 're-entering'
        Detections of `permuted` come in a random order in every frame.

    Raises
    ------
    ValueError
        For an unknown kind.
    """
    settings = settings or TaskSettings(frames=180)
    if kind not in CROSSINGS:
        raise ValueError(f"kind: got '{kind}', wanted one of {', '.join(CROSSINGS)}")
    rng = np.random.default_rng([seed, 10 + CROSSINGS.index(kind)])
    f, fps = settings.frames, settings.fps
    first = rng.uniform(1.55, 1.92)
    second = rng.uniform(1.55, 1.92 - 2.0 * NEAREST_STATURES)
    second += 2.0 * NEAREST_STATURES * (second > first - NEAREST_STATURES)  # evenly from what is not too near
    statures = (first, second)
    bodies = tuple(body_of(stature) for stature in statures)
    paths = _paths(rng, kind, f, fps)
    p = np.stack([walked(rng, body, path, fps) for body, path in zip(bodies, paths, strict=True)], axis=1)
    eye = _eye(rng, (0.0, 0.0, 1.5), (0.0, 2.2, 1.0))
    stage = Stage(
        eye, bodies, eye.see(p), _furniture(table=False), *nothing_moves(f), np.zeros((f, 0, 2, 3)), np.zeros(0)
    )
    network = replace(settings.network, order="random") if kind == "permuted" else settings.network
    return _recorded(rng, kind, look(stage), fps, network)


def _recorded(rng: np.random.Generator, name: str, sight: Sight, fps: float, network: NetworkSettings) -> Task:
    """What is reported of a sight."""
    seen = detect(rng, sight, fps, network)
    f = sight.share.shape[0]
    state = np.where(np.isnan(seen.p[..., 0]), LOST, TRACKED).astype(np.int8)
    detections = Detections(np.arange(f) / fps, seen.frame, seen.order, seen.p, seen.confidence, state)
    camera = sight.stage.eye.camera
    return Task(name, detections, TruthPoints(sight.stage.p), fps, camera, seen.who, seen.uv, sight.share)


def _eye(rng: np.random.Generator, place: tuple[float, float, float], goal: tuple[float, float, float]) -> Eye:
    """A RealSense D455 about a place, looking about a goal."""
    here, there = np.array(place) + rng.uniform(-0.08, 0.08, 3), np.array(goal) + rng.uniform(-0.05, 0.05, 3)
    z = (there - here) / np.linalg.norm(there - here)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = x / np.linalg.norm(x)
    width, height = 848, 480
    focal = 0.5 * width / math.tan(math.radians(45.0))
    camera = perspective(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), np.eye(3), np.zeros(3))
    return Eye(here, np.stack([x, np.cross(z, x), z]), camera)


def _furniture(table: bool) -> Boxes:
    """Floor, a wall 1 m behind the people, side walls, and a table or none."""
    rows = [
        ((0.0, 1.0, -0.05), (6.0, 6.0, 0.05)),
        ((0.0, 4.2 if not table else 1.5, 1.4), (6.0, 0.05, 1.4)),
        ((-3.4, 1.0, 1.4), (0.05, 6.0, 1.4)),
        ((3.4, 1.0, 1.4), (0.05, 6.0, 1.4)),
    ]
    rows += [((0.0, -0.12, TABLE - 0.02), (0.95, 0.32, 0.02))] if table else []
    centre, half = zip(*rows, strict=True)
    return Boxes(np.array(centre), np.array(half), np.zeros(len(rows)))


def _paths(
    rng: np.random.Generator, kind: str, frames: int, fps: float
) -> tuple[Float[np.ndarray, "f 2"], Float[np.ndarray, "f 2"]]:
    """Where two people walk on the floor: x, and distance y from the camera."""
    u = np.arange(frames) / max(frames - 1, 1)
    near, far = rng.uniform(1.75, 1.95), rng.uniform(2.30, 2.60)
    depths = rng.permutation([near, far])
    wander = 0.03 * smooth_noise(rng, frames, 0.7 * fps, 4)
    ease = u * u * (3.0 - 2.0 * u)
    side = rng.choice([-1.0, 1.0])
    if kind == "permuted":
        middle = np.array([[-0.6, 0.6], [0.6, 0.6]]) * side
        x = middle[:, 0] + np.zeros((frames, 2)) + 4.0 * wander[:, :2]
    elif kind == "crossing":
        reach = rng.uniform(0.9, 1.2, 2)
        x = side * np.stack([reach[0] * (2.0 * ease - 1.0), reach[1] * (1.0 - 2.0 * ease)], axis=1)
    elif kind == "entering":
        goal = rng.uniform(0.35, 0.7, 2)
        out = depths + 0.55  # half a metre beyond the image's border
        s = np.clip(u / 0.7, 0.0, 1.0)[:, None]
        s = s * s * (3.0 - 2.0 * s)
        x = side * np.array([-1.0, 1.0]) * (out + s * (goal - out))
    else:
        stay = rng.uniform(-0.3, 0.3)
        begin = rng.uniform(0.5, 0.8)
        gone = depths[0] + 0.6
        away = np.clip(np.minimum(u - 0.12, 0.88 - u) / 0.28, 0.0, 1.0)
        away = away * away * (3.0 - 2.0 * away)
        x = side * np.stack([begin + away * (gone - begin), np.full(frames, -0.7 + stay)], axis=1)
    paths = [np.column_stack([x[:, i] + wander[:, 2 * i], depths[i] + wander[:, 2 * i + 1]]) for i in range(2)]
    return paths[0], paths[1]


def simulate_people(folder: Path | str, task: Task, replace_folder: bool = False) -> None:
    """Write a task as a scene folder: `scene.yaml`, `skeletons.csv`, `truth.csv`; whole or not at all.

    Raises
    ------
    InputError
        If `folder` is a file, or not empty and `replace_folder` is false.
    """
    write_people_scene(folder, task.fps, task.camera, task.detections, task.truth, replace_folder)
