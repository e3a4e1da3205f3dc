"""Where two people's hands go in; their keypoints, frame by frame, out. Metres, seconds, the stage's axes (z up).

A hand follows knots `(t_i, p_i)`: between two of them it goes on a straight line with the minimum-jerk law of time and,
if it is lifted, an arc over it: `p = a + s (b - a) + 4 s (1 - s) lift z`. The trunk leans as little as the reach of
both arms asks for; a wrist that is still too far is drawn back onto the sphere that it can reach.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from handtrack.errors import InputError
from handtrack.formats.markers import Markers, read_markers

from .cell_motion import minimum_jerk, smooth_noise
from .people import LEFT, RIGHT, Body, Posture, body_of, keypoints_of, shoulders, trunk_axes

REACH = 0.97  # share of the arm's length that a hand is led to
LEANS = np.radians(np.arange(0.0, 51.0, 2.5))
WIDEST = 0.04  # metres that recorded motion adds at most
# Wrist, elbow and shoulder of a recorded arm, each the mean of some markers; metres are theirs.
_ARMS = (
    (("hand_top", "hand_left", "hand_right"), ("right_shoulder",)),
    (("STYLr", "STYLu"), ("ACRO_tip",)),
)


Spot = tuple[float, float, float] | list[float] | Float[np.ndarray, " 3"]


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """Who stands where: proportions, place of the feet's middle (2,), and the direction looked at, radians from +y."""

    body: Body
    place: Float[np.ndarray, " 2"]
    heading: float

    def own(self, p: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Points of the stage in the person's axes: x right, y forward, z up."""
        return (p - [*self.place.tolist(), 0.0]) @ _turn(self.heading)

    def stage(self, p: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Points in the person's axes in the stage's."""
        return p @ _turn(self.heading).T + [*self.place.tolist(), 0.0]


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """Knots of a hand: times (n,), seconds, rising; places (n, 3); and lift (n - 1,) of each arc between them."""

    time: Float[np.ndarray, " n"]
    p: Float[np.ndarray, "n 3"]
    lift: Float[np.ndarray, " m"]


def way_of(rows: Sequence[tuple[float, Spot, float]]) -> Way:
    """A way from rows of time, place, and the lift of the arc that leads there."""
    return Way(
        np.array([row[0] for row in rows], dtype=float),
        np.array([row[1] for row in rows], dtype=float),
        np.array([row[2] for row in rows[1:]], dtype=float),
    )


def along(way: Way, time: Float[np.ndarray, " f"]) -> Float[np.ndarray, "f 3"]:
    """Places on a way; the first before it begins, the last after it ends.

    >>> way = way_of([(0.0, [0.0, 0.0, 0.0], 0.0), (1.0, [1.0, 0.0, 0.0], 0.5)])
    >>> along(way, np.array([-1.0, 0.5, 2.0])).tolist()
    [[0.0, 0.0, 0.0], [0.5, 0.0, 0.5], [1.0, 0.0, 0.0]]
    """
    i = np.clip(np.searchsorted(way.time, time, side="right") - 1, 0, way.time.size - 2)
    s = minimum_jerk((time - way.time[i]) / (way.time[i + 1] - way.time[i]))[:, None]
    arc = 4.0 * s * (1.0 - s) * way.lift[i][:, None] * np.array([0.0, 0.0, 1.0])
    return way.p[i] + s * (way.p[i + 1] - way.p[i]) + arc


def person_at(rng: np.random.Generator, stature: float, place: Sequence[float], heading: float) -> Person:
    """A person about a place, looking about a direction (degrees from +y to the left)."""
    where = np.asarray(place, dtype=float) + rng.uniform(-0.04, 0.04, 2)
    return Person(body_of(stature), where, math.radians(heading + rng.uniform(-6.0, 6.0)))


def hanging(person: Person, side: int, frames: int) -> Float[np.ndarray, "f 3"]:
    """A hand beside the thigh, in the stage's axes."""
    body = person.body
    out = (body.shoulder + 0.06) * (1.0 if side == RIGHT else -1.0)
    height = body.hip_height + body.trunk - 0.93 * body.arm
    return np.repeat(person.stage(np.array([[out, 0.06, height]])), frames, axis=0)


def acted(
    rng: np.random.Generator,
    person: Person,
    hands: tuple[Float[np.ndarray, "f 3"], Float[np.ndarray, "f 3"]],
    fps: float,
    motion: Path | None = None,
) -> Float[np.ndarray, "f 16 3"]:
    """Keypoints of a person who stands and works, in the stage's axes.

    Parameters
    ----------
    hands : pair of (f, 3)
        Where the left and the right wrist are led, in the stage's axes.
    motion : Path or None
        Markers of a recorded arm that sway the hands; smooth noise where there is none.
    """
    f, body = hands[0].shape[0], person.body
    slow = smooth_noise(rng, f, 0.8 * fps, 4)
    pelvis = np.column_stack([0.02 * slow[:, :2], np.full(f, body.hip_height) + 0.004 * slow[:, 2]])
    sway = [_sway(rng, f, fps, motion) for _ in hands]
    wrist = np.stack([person.own(hand) + moved for hand, moved in zip(hands, sway, strict=True)], axis=1)
    middle = wrist.mean(axis=1)
    turned = np.clip(np.arctan2(-middle[:, 0], np.maximum(middle[:, 1], 0.25)), -0.5, 0.5)
    twist = gaussian_filter1d(0.5 * turned, 0.15 * fps, mode="nearest") + 0.03 * slow[:, 3]
    lean = gaussian_filter1d(_lean(body, pelvis, twist, wrist), 0.15 * fps, mode="nearest")
    axes = trunk_axes(lean, twist)
    wrist = _within_reach(body, shoulders(body, pelvis, axes), wrist)
    swivel = np.radians([20.0, 20.0]) + math.radians(7.0) * smooth_noise(rng, f, 0.6 * fps, 2)
    return person.stage(keypoints_of(body, Posture(pelvis, lean, twist, wrist, swivel)))


def walked(
    rng: np.random.Generator, body: Body, path: Float[np.ndarray, "f 2"], fps: float
) -> Float[np.ndarray, "f 16 3"]:
    """Keypoints of a person who walks along a path of the floor, in the stage's axes.

    Legs and arms swing as sines of the distance walked, 1.4 m to a double step; who stands does not swing.
    """
    f = path.shape[0]
    speed = np.gradient(path, 1.0 / fps, axis=0)
    pace = np.linalg.norm(speed, axis=1)
    heading = _heading(speed, pace, fps)
    phase = np.cumsum(pace) / fps * 2.0 * math.pi / 1.4 + rng.uniform(0.0, 2.0 * math.pi)
    swing = np.minimum(pace / 1.0, 1.0) * np.sin(phase)
    zero = np.zeros(f)
    pelvis = np.column_stack([zero, zero, body.hip_height + 0.02 * np.minimum(pace, 1.0) * np.cos(2.0 * phase)])
    lean = np.full(f, 0.05) + 0.01 * smooth_noise(rng, f, 0.5 * fps, 1)[:, 0]
    down = body.hip_height + body.trunk - 0.93 * body.arm
    hands = [
        np.column_stack([np.full(f, side * (body.shoulder + 0.06)), 0.06 + side * 0.22 * swing, np.full(f, down)])
        for side in (-1.0, 1.0)
    ]
    wrist = np.stack(hands, axis=1) + 0.01 * smooth_noise(rng, f, 0.3 * fps, 6).reshape(f, 2, 3)
    wrist = _within_reach(body, shoulders(body, pelvis, trunk_axes(lean, zero)), wrist)
    p = keypoints_of(body, Posture(pelvis, lean, zero, wrist, np.full((f, 2), 0.2)))
    for side, sign in ((LEFT, 1.0), (RIGHT, -1.0)):  # the leg swings against the arm of its side
        angle = sign * 0.42 * swing
        forward = np.column_stack([zero, np.sin(angle), -np.cos(angle)])
        p[:, 8 + side] = p[:, 6 + side] + body.thigh * forward
        back = angle - 0.35 * np.abs(swing)
        p[:, 10 + side] = p[:, 8 + side] + body.shin * np.column_stack([zero, np.sin(back), -np.cos(back)])
    turn = np.stack([_turn(angle) for angle in heading])
    return p @ np.swapaxes(turn, 1, 2) + np.column_stack([path, zero])[:, None]


def _heading(speed: Float[np.ndarray, "f 2"], pace: Float[np.ndarray, " f"], fps: float) -> Float[np.ndarray, " f"]:
    """Direction of walking, radians from +y; held where the person stands, and turned within half a second."""
    moving = np.flatnonzero(pace > 0.15)
    if not moving.size:
        return np.full(pace.size, math.pi)  # nobody walks: look at the camera
    at = moving[np.clip(np.searchsorted(moving, np.arange(pace.size), side="right") - 1, 0, moving.size - 1)]
    angle = np.unwrap(np.arctan2(-speed[at, 0], speed[at, 1]))
    return gaussian_filter1d(angle, 0.2 * fps, mode="nearest")


def _lean(
    body: Body,
    pelvis: Float[np.ndarray, "f 3"],
    twist: Float[np.ndarray, " f"],
    wrist: Float[np.ndarray, "f 2 3"],
) -> Float[np.ndarray, " f"]:
    """The least lean with both wrists in reach, or the one that comes nearest."""
    n = LEANS.size
    axes = trunk_axes(np.broadcast_to(LEANS, (twist.size, n)), np.broadcast_to(twist[:, None], (twist.size, n)))
    joints = shoulders(body, np.repeat(pelvis[:, None], n, axis=1), axes)
    short = np.linalg.norm(wrist[:, None] - joints, axis=-1).max(axis=-1) - REACH * body.arm
    first = (short <= 0).argmax(axis=1)
    return LEANS[np.where((short <= 0).any(axis=1), first, short.argmin(axis=1))]


def _within_reach(
    body: Body, shoulder: Float[np.ndarray, "f 2 3"], wrist: Float[np.ndarray, "f 2 3"]
) -> Float[np.ndarray, "f 2 3"]:
    line = wrist - shoulder
    size = np.linalg.norm(line, axis=-1, keepdims=True)
    return shoulder + line / size * np.clip(size, 0.35 * body.arm, 0.99 * body.arm)


def _sway(rng: np.random.Generator, frames: int, fps: float, motion: Path | None) -> Float[np.ndarray, "f 3"]:
    """What lies over a led hand: smooth noise of 8 mm within 0.35 s and 3 mm within 0.08 s, or a recording's."""
    if motion is None:
        slow, fast = smooth_noise(rng, frames, 0.35 * fps, 3), smooth_noise(rng, frames, 0.08 * fps, 3)
        return 0.008 * slow + 0.003 * fast
    return recorded_sway(motion, rng, frames, fps)


def recorded_sway(path: Path | str, rng: np.random.Generator, frames: int, fps: float) -> Float[np.ndarray, "f 3"]:
    """A recorded hand from its shoulder: a random stretch without its slow part (over 0.8 s), at most 40 mm.

    Parameters
    ----------
    path : Path
        A marker file with `hand_top`, `hand_left`, `hand_right`, `right_shoulder`, or with `STYLr`, `STYLu` and
        `ACRO_tip`. A stretch that is longer than the recording goes back and forth.

    Raises
    ------
    InputError
        For a file that is none, or has neither of these sets of markers.
    """
    markers = read_markers(path)
    hand = _hand_of(path, markers)
    length = (hand.shape[0] - 1) / markers.rate
    time = (rng.uniform(0.0, length) + np.arange(frames) / fps) % (2.0 * length)
    at = np.minimum(time, 2.0 * length - time) * markers.rate
    way = np.column_stack([np.interp(at, np.arange(hand.shape[0]), hand[:, c]) for c in range(3)])
    moved = way - gaussian_filter1d(way, 0.8 * fps, axis=0, mode="nearest")
    size = np.linalg.norm(moved, axis=1, keepdims=True)
    return moved * (WIDEST / np.maximum(size, WIDEST)) @ _turn(rng.uniform(-math.pi, math.pi)).T


def _hand_of(path: Path | str, markers: Markers) -> Float[np.ndarray, "m 3"]:
    """The hand from the shoulder, metres, gaps bridged."""
    for names in _ARMS:
        if all(name in markers.names for group in names for name in group):
            hand, shoulder = (
                np.stack([_filled(path, markers, name) for name in group]).mean(axis=0) for group in names
            )
            return 0.001 * (hand - shoulder)
    wanted = " or ".join(", ".join(name for group in names for name in group) for names in _ARMS)
    raise InputError(f"{path}: has no markers of an arm; wanted: {wanted}")


def _filled(path: Path | str, markers: Markers, name: str) -> Float[np.ndarray, "m 3"]:
    places = markers.places[:, markers.names.index(name)]
    number, seen = np.arange(places.shape[0]), ~np.isnan(places[:, 0])
    if not seen.any():
        raise InputError(f"{path}: marker '{name}' is never seen; a recorded arm is wanted")
    return np.column_stack([np.interp(number, number[seen], places[seen, c]) for c in range(3)])


def _turn(angle: float | np.floating) -> Float[np.ndarray, "3 3"]:
    """Rotation about z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
