"""A seed and settings in, a cell and everything that happens in it out.

Cells are drawn until one holds what it promises: the arms keep their joint limits and stay out of the furniture, the
robot stays out of both, and the wrist is hidden where a task says so and seen at home. The tasks of each cycle are
drawn until the person can do them. All comes from one seed: geometry, camera, tasks, motion and noise.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int8

from handtrack.formats.skeletons import KEYPOINTS

from .cell_arm import lean_for, plan_swivel, reachable
from .cell_motion import (
    BEHIND_ROBOT,
    INTO_SHELF,
    Tasks,
    Wander,
    away,
    joined,
    kinds_of,
    noise_wander,
    random_home,
    random_tasks,
    reach_path,
    recorded_wander,
    smooth_noise,
)
from .cell_robot import Robot, led_point, links_of, random_robot
from .cell_room import Boxes, Furniture, distance_to, random_furniture
from .cell_settings import CellSettings
from .cell_view import BY_ROBOT, BY_ROOM, Eye, hides, random_eye, visible_share
from .people import LEFT, RIGHT, Body, Posture, body_of, capsules_of, keypoints_of, shoulders, trunk_axes

TRIES = 200
FIRST_TRIES, CYCLE_TRIES = 3, 25  # draws of the first cycle's tasks, which tell a hopeless cell, and of a later one's
WRIST, ELBOW = KEYPOINTS.index("right_wrist"), KEYPOINTS.index("right_elbow")
FASTEST = 2.2  # metres a second: hands at work are seldom faster
ELBOW_SEEN = 0.5  # share of the frames at home, and of those with a hidden wrist, in which the elbow is mostly seen


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """A simulated cell of a right-handed person; points are in camera axes unless said otherwise.

    Attributes
    ----------
    room : Furniture
        In the cell's own frame, as `tasks` and `posture`.
    p : (f, 16, 3)
        True keypoints.
    parts : (f, parts, 2, 3)
        Ends of the person's capsules.
    links : (f, 3, 2, 3)
        Ends of the robot's capsules.
    share, cause : (f, 16)
        How much of each keypoint the camera sees, 0..1, and what hides the most of the rest (`cell_view.SEEN`...).
    """

    settings: CellSettings
    body: Body
    room: Furniture
    robot: Robot
    tasks: Tasks
    posture: Posture
    eye: Eye
    p: Float[np.ndarray, "f 16 3"]
    parts: Float[np.ndarray, "f parts 2 3"]
    links: Float[np.ndarray, "f links 2 3"]
    share: Float[np.ndarray, "f 16"]
    cause: Int8[np.ndarray, "f 16"]


@dataclass(frozen=True, slots=True, eq=False)
class _Habits:
    """What a person does besides the tasks, in every frame: the cell's frame, metres and radians."""

    turn: float
    home: Float[np.ndarray, " 3"]
    pelvis: Float[np.ndarray, "f 3"]
    left: Float[np.ndarray, "f 3"]
    wander: Wander

    def cut(self, first: int, last: int) -> "_Habits":
        """The same for some of the frames."""
        wander = Wander(self.wander.wrist[first:last], self.wander.swivel[first:last])
        return _Habits(self.turn, self.home, self.pelvis[first:last], self.left[first:last], wander)


def make_cell(seed: int, settings: CellSettings | None = None) -> Cell:
    """Draw a cell and everything that happens in it.

    Raises
    ------
    RuntimeError
        If no cell of many holds what it promises; then the settings leave the person no time.
    """
    settings = settings or CellSettings()
    for attempt in range(TRIES):
        cell = _attempt(np.random.default_rng([seed, 0, attempt]), settings)
        if cell is not None:
            return cell
    raise RuntimeError(f"seed {seed}: no cell of {TRIES} lets the person work unhurt; other settings are wanted")


def _attempt(rng: np.random.Generator, settings: CellSettings) -> Cell | None:
    """One draw, or None if it does not hold what it promises; the cheap questions come first."""
    frames, fps = settings.frames, settings.fps
    body, room, robot = body_of(rng.uniform(1.62, 1.88)), random_furniture(rng), random_robot(rng)
    eye = random_eye(rng, settings.width, settings.height, settings.field_of_view)
    habits = _habits(rng, body, room, settings)
    if hides(room.boxes, eye, habits.home[None]).any():
        return None
    work = _work(rng, body, room, eye, habits, settings)
    if work is None:
        return None
    tasks, posture = work
    links = links_of(robot, led_point(rng, robot, tasks, eye.place, frames, fps))
    if _gap(links, robot.radius, room.boxes) < 0.0:
        return None
    p, links = eye.see(keypoints_of(body, posture)), eye.see(links)
    parts = capsules_of(body, p)
    share, cause = visible_share(body, p, parts, links, robot.radius, room.boxes, eye)
    cell = Cell(settings, body, room, robot, tasks, posture, eye, p, parts, links, share, cause)
    return cell if _holds(cell) else None


def _habits(rng: np.random.Generator, body: Body, room: Furniture, settings: CellSettings) -> _Habits:
    frames, fps = settings.bounds()[-1], settings.fps
    turn, home = math.radians(rng.uniform(10.0, 26.0)), random_home(rng, room)
    sway = smooth_noise(rng, frames, 0.7 * fps, 6)
    pelvis = np.array([0.0, 0.0, body.hip_height]) + sway[:, :3] * [0.008, 0.006, 0.001]
    left = np.array([-0.10, room.front, room.table]) + rng.uniform([-0.06, -0.02, 0.13], [0.0, 0.04, 0.18])
    if settings.motion is None:
        wander = noise_wander(rng, frames, fps)
    else:
        wander = recorded_wander(settings.motion, rng, frames, fps)
    return _Habits(turn, home, pelvis, left + 0.012 * sway[:, 3:], wander)


def _work(
    rng: np.random.Generator, body: Body, room: Furniture, eye: Eye, habits: _Habits, settings: CellSettings
) -> tuple[Tasks, Posture] | None:
    """Tasks of all cycles that the person can do, and how; None where too many draws fail."""

    def fits(ways: Float[np.ndarray, "w s 3"]) -> Bool[np.ndarray, " w"]:
        return reachable(body, ways, habits.turn, room.boxes)

    cycles: list[Tasks] = []
    posture = None
    for first, last in pairwise(settings.bounds()):
        for _ in range(CYCLE_TRIES if cycles else FIRST_TRIES):
            tasks = random_tasks(rng, room, kinds_of(rng, settings.occlusion), habits.home, (first, last), fits)
            if tasks is None or (hides(room.boxes, eye, tasks.target) != (tasks.kind == INTO_SHELF)).any():
                continue
            posture = _posture(body, room, tasks, habits.cut(first, last), first, settings.fps)
            if posture is not None:
                cycles.append(tasks)
                break
        else:
            return None
    tasks = joined(cycles)
    if len(cycles) > 1:
        posture = _posture(body, room, tasks, habits, 0, settings.fps)
    return None if posture is None else (tasks, posture.cut(settings.frames))


def _posture(body: Body, room: Furniture, tasks: Tasks, habits: _Habits, first: int, fps: float) -> Posture | None:
    """The person's way through the tasks, from the frame `first` on; None where an arm finds none."""
    number = first + np.arange(habits.pelvis.shape[0])
    right = reach_path(tasks, number) + habits.wander.wrist * (1.0 - 0.4 * away(tasks, number)[:, None])
    if (np.linalg.norm(np.diff(right, axis=0), axis=1) * fps > FASTEST).any():
        return None
    lean, twist = lean_for(body, habits.pelvis, right, habits.turn, fps)
    axes = trunk_axes(lean, twist)
    both = shoulders(body, habits.pelvis, axes)
    extra, boxes = habits.wander.swivel, room.boxes
    swivel = plan_swivel(body, both[:, RIGHT], axes, right, extra, RIGHT, boxes, fps)
    other = None if swivel is None else plan_swivel(body, both[:, LEFT], axes, habits.left, 0 * extra, LEFT, boxes, fps)
    if swivel is None or other is None:
        return None
    wrists = np.stack([habits.left, right], axis=1)
    return Posture(habits.pelvis, lean, twist, wrists, np.stack([other, swivel], axis=1))


def _gap(ends: Float[np.ndarray, "f l 2 3"], radius: Float[np.ndarray, " l"], boxes: Boxes) -> float:
    """Smallest distance of the upper and the fore link from the furniture (the column stands on the floor)."""
    s = np.linspace(0.0, 1.0, 12)[:, None]
    points = ends[::3, 1:, None, 0] + s * (ends[::3, 1:, None, 1] - ends[::3, 1:, None, 0])
    return float((distance_to(boxes, points.reshape(-1, 3)).reshape(points.shape[:-1]) - radius[1:, None]).min())


def _holds(cell: Cell) -> bool:
    """Whether the wrist is hidden by what should hide it at the targets and seen at home, the elbow is seen often
    enough to follow the arm, and the robot touches no one.
    """
    number = np.arange(cell.settings.frames)
    share, cause, elbow = cell.share[:, WRIST], cell.cause[:, WRIST], cell.share[:, ELBOW]
    busy = np.zeros(number.size, dtype=bool)
    for kind, (leave, arrive, depart, back) in zip(cell.tasks.kind, cell.tasks.frames, strict=True):
        there = (number >= arrive) & (number <= depart)
        busy |= (number >= leave) & (number <= back)
        if kind == INTO_SHELF and there.any() and ((share < 0.1) & (cause == BY_ROOM))[there].mean() < 0.9:
            return False
        if kind == BEHIND_ROBOT and there.any() and ((share < 0.3) & (cause == BY_ROBOT))[there].mean() < 0.7:
            return False
    if (~busy).any() and ((share[~busy] >= 0.5).mean() < 0.7 or (elbow[~busy] >= 0.5).mean() < ELBOW_SEEN):
        return False
    hidden = busy & (share < 0.1)
    if hidden.any() and (elbow[hidden] >= 0.5).mean() < ELBOW_SEEN:
        return False
    return _robot_gap(cell) > 0.03


def _robot_gap(cell: Cell) -> float:
    """Smallest distance between the robot's and the person's surfaces, in every other frame, by samples of both."""
    s = np.linspace(0.0, 1.0, 8)[:, None]
    a, b = (
        ends[::2, :, None, 0] + s * (ends[::2, :, None, 1] - ends[::2, :, None, 0]) for ends in (cell.parts, cell.links)
    )
    ra = cell.body.radius[:, :1] + s[:, 0] * (cell.body.radius[:, 1:] - cell.body.radius[:, :1])
    rb = np.broadcast_to(cell.robot.radius[:, None], b.shape[1:3])
    flat_a, flat_b = a.reshape(a.shape[0], -1, 3), b.reshape(b.shape[0], -1, 3)
    apart = np.linalg.norm(flat_a[:, :, None] - flat_b[:, None], axis=-1)
    return float((apart - ra.reshape(-1)[:, None] - rb.reshape(-1)).min())
