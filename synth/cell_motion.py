"""A cell and an order of tasks in, the wrists' way through an assembly cycle out.

From a place over the table the hand reaches into the shelf or over a box, stays, and comes back. A reach follows a
Bezier curve from home `P0` by a random way-point `P1` to the target `P3`, which it enters along the line from `P2`,
with the minimum-jerk law of time `s(u) = 10 u^3 - 15 u^4 + 6 u^5` (Flash and Hogan 1985). Over it lies a wandering: of
smooth noise, or of a person's recorded arm.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter1d

from handtrack.errors import InputError
from handtrack.formats.markers import Markers, read_markers

from .cell_room import Furniture

INTO_SHELF, BEHIND_ROBOT, IN_THE_OPEN = 0, 1, 2
DRAWS, STEPS = 10, 10  # ways tried for each task, and places looked at on each
PARTS_OF_A_TASK = np.array([0.12, 0.40, 0.65, 0.92])  # leaves, arrives, departs, is back: shares of its time

_ARM_MARKERS = ("hand_top", "hand_left", "hand_right", "right_elbow", "right_shoulder")
_MM = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class Tasks:
    """Reaches in order of time; n of them.

    Attributes
    ----------
    kind : (n,)
        `INTO_SHELF`, `BEHIND_ROBOT` or `IN_THE_OPEN`.
    frames : (n, 4)
        Frame, not whole, at which the hand leaves, arrives, departs and is back.
    target : (n, 3)
        Of the wrist, in the cell's frame.
    entry : (n, 3)
        From the last control point to the target.
    home : (n + 1, 3)
        Where the wrist rests before, between and after the reaches.
    bend : (n, 2, 3)
        From home to the way-point, on the way there and back.
    """

    kind: Int[np.ndarray, " n"]
    frames: Float[np.ndarray, "n 4"]
    target: Float[np.ndarray, "n 3"]
    entry: Float[np.ndarray, "n 3"]
    home: Float[np.ndarray, "m 3"]
    bend: Float[np.ndarray, "n 2 3"]


@dataclass(frozen=True, slots=True, eq=False)
class Wander:
    """What lies over the reaches: of the wrist (f, 3), metres, and of the elbow's swivel (f,), radians."""

    wrist: Float[np.ndarray, "f 3"]
    swivel: Float[np.ndarray, " f"]


def smooth_noise(
    rng: np.random.Generator, frames: int, width: float, columns: int
) -> Float[np.ndarray, "frames columns"]:
    """Noise of unit variance, made smooth over a Gaussian of `width` frames.

    >>> smooth_noise(np.random.default_rng(0), 5, 2.0, 3).shape
    (5, 3)
    """
    edge = math.ceil(4.0 * width)
    white = rng.standard_normal((frames + 2 * edge, columns))
    smooth = gaussian_filter1d(white, width, axis=0)[edge : edge + frames]
    return smooth * math.sqrt(2.0 * width * math.sqrt(math.pi))


def minimum_jerk(u: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Share of the way after the share `u` of the time; 0 before the start, 1 after the end.

    >>> minimum_jerk(np.array([-1.0, 0.5, 2.0])).tolist()
    [0.0, 0.5, 1.0]
    """
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u * u)


def kinds_of(rng: np.random.Generator, occlusion: str) -> Int[np.ndarray, " n"]:
    """Four tasks of one cycle in random order: two and two of those that the wanted occlusion has."""
    pairs = {
        "static": (INTO_SHELF, IN_THE_OPEN),
        "dynamic": (BEHIND_ROBOT, IN_THE_OPEN),
        "both": (INTO_SHELF, BEHIND_ROBOT),
    }
    return rng.permutation(np.repeat(pairs[occlusion], 2))


def random_home(rng: np.random.Generator, room: Furniture) -> Float[np.ndarray, " 3"]:
    """Where the right wrist rests: over the front of the table, before the person."""
    return np.array([0.0, room.front, room.table]) + rng.uniform([0.04, 0.01, 0.12], [0.12, 0.07, 0.18])


def random_tasks(
    rng: np.random.Generator,
    room: Furniture,
    kind: Int[np.ndarray, " n"],
    home: Float[np.ndarray, " 3"],
    span: tuple[int, int],
    fits: Callable[[Float[np.ndarray, "w s 3"]], Bool[np.ndarray, " w"]],
) -> Tasks | None:
    """Targets and times of the reaches of one cycle, or None if no targets fit.

    Parameters
    ----------
    home : (3,)
        Where the wrist rests before and after the cycle.
    span : (first, last)
        Frames of the cycle, half open.
    fits : callable
        Whether the wrist may go ways through the cell.
    """
    n = kind.size
    slot = (span[1] - span[0]) / n
    shares = PARTS_OF_A_TASK + rng.uniform(-0.03, 0.03, (n, 4))
    homes = np.concatenate([home[None], home + rng.uniform(-0.02, 0.02, (n - 1, 3)), home[None]])
    drawn = [_targets(rng, room, int(k)) for k in kind]
    target, entry = (np.stack(values) for values in zip(*drawn, strict=True))
    bend = rng.uniform([-0.04, -0.16, 0.02], [0.06, 0.0, 0.12], (n, DRAWS, 2, 3))
    start = np.stack([homes[:-1], homes[1:]], axis=1)[:, None]
    last = np.broadcast_to(target[:, :, None], bend.shape)
    knots = [v[..., None, :] for v in (start, start + bend, last - entry[:, :, None], last)]
    ways = _bezier(knots, np.linspace(0.0, 1.0, STEPS)[:, None])
    good = fits(ways.reshape(-1, STEPS, 3)).reshape(n, DRAWS, 2).all(axis=2)
    if not np.count_nonzero(good, axis=1).all():
        return None
    chosen = (np.arange(n), good.argmax(axis=1))
    frames = span[0] + slot * (np.arange(n)[:, None] + shares)
    return Tasks(kind, frames, target[chosen], entry[chosen], homes, bend[chosen])


def _targets(
    rng: np.random.Generator, room: Furniture, kind: int
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Several targets of one kind and the ways into them."""
    if kind == INTO_SHELF:
        level = rng.integers(room.shelf.floors.size, size=DRAWS)
        shares = rng.uniform([0.3, 0.32, 0.4], [0.7, 0.52, 0.62], (DRAWS, 3))
        places = [room.shelf.place(int(i), *share) for i, share in zip(level, shares.tolist(), strict=True)]
        return np.stack(places), rng.uniform(0.28, 0.42, (DRAWS, 1)) * room.shelf.inward
    top = room.tops[rng.integers(room.tops.shape[0], size=DRAWS)]
    target = top + rng.uniform([-0.02, -0.14, 0.12], [0.02, -0.07, 0.20], (DRAWS, 3))
    return target, rng.uniform([-0.03, 0.05, -0.16], [0.03, 0.12, -0.10], (DRAWS, 3))


def joined(cycles: Sequence[Tasks]) -> Tasks:
    """The tasks of several cycles; each begins where the one before ends."""
    kind, frames, target, entry, bend = (
        np.concatenate([getattr(tasks, name) for tasks in cycles])
        for name in ("kind", "frames", "target", "entry", "bend")
    )
    home = np.concatenate([*(tasks.home[:-1] for tasks in cycles), cycles[-1].home[-1:]])
    return Tasks(kind, frames, target, entry, home, bend)


def reach_path(tasks: Tasks, number: Int[np.ndarray, " f"]) -> Float[np.ndarray, "f 3"]:
    """The wrist's way in the frames of some numbers, without wandering, in the cell's frame."""
    out = np.repeat(tasks.home[:1], number.size, axis=0)
    for i, (leave, arrive, depart, back) in enumerate(tasks.frames):
        there = minimum_jerk((number - leave) / (arrive - leave))[:, None]
        again = 1.0 - minimum_jerk((number - depart) / (back - depart))[:, None]
        late = number > 0.5 * (arrive + depart)
        for way, s, when in ((0, there, ~late & (number >= leave)), (1, again, late)):
            start = tasks.home[i + way]
            knots = (start, start + tasks.bend[i, way], tasks.target[i] - tasks.entry[i], tasks.target[i])
            out[when] = _bezier(knots, s[when])
    return out


def _bezier(knots: Sequence[Float[np.ndarray, "..."]], s: Float[np.ndarray, "n 1"]) -> Float[np.ndarray, "..."]:
    a, b, c, d = knots
    r = 1.0 - s
    return r**3 * a + 3.0 * r * r * s * b + 3.0 * r * s * s * c + s**3 * d


def away(tasks: Tasks, number: Int[np.ndarray, " f"]) -> Float[np.ndarray, " f"]:
    """Share of the way from home, 1 while the hand stays at a target."""
    out = np.zeros(number.size)
    for leave, arrive, depart, back in tasks.frames:
        up = minimum_jerk((number - leave) / (arrive - leave))
        out = np.maximum(out, np.minimum(up, 1.0 - minimum_jerk((number - depart) / (back - depart))))
    return out


def noise_wander(rng: np.random.Generator, frames: int, fps: float) -> Wander:
    """Wandering of smooth noise: 12 mm within a second, 4 mm within a fifth, 6 degrees of swivel."""
    slow, fast = smooth_noise(rng, frames, 0.35 * fps, 4), smooth_noise(rng, frames, 0.08 * fps, 3)
    return Wander(0.012 * slow[:, :3] + 0.004 * fast, math.radians(6.0) * slow[:, 3])


def recorded_wander(path: Path | str, rng: np.random.Generator, frames: int, fps: float) -> Wander:
    """Wandering of a recorded right arm: a random stretch, without its slow part (over 0.8 s), at most 40 mm.

    Parameters
    ----------
    path : Path
        A marker file with `hand_top`, `hand_left`, `hand_right`, `right_elbow` and `right_shoulder`; a stretch that is
        longer than the recording goes back and forth.

    Raises
    ------
    InputError
        For a file that is none, or lacks one of these markers.
    """
    markers = read_markers(path)
    for name in _ARM_MARKERS:
        if name not in markers.names:
            raise InputError(f"{path}: has no marker '{name}'; wanted: {', '.join(_ARM_MARKERS)}")
    wrist, elbow = _arm_of(path, markers)
    length = wrist.shape[0] / markers.rate
    time = (rng.uniform(0.0, length) + np.arange(frames) / fps) % (2.0 * length)
    at = np.minimum(time, 2.0 * length - time) * markers.rate
    number = np.arange(wrist.shape[0])
    way = np.column_stack([np.interp(at, number, wrist[:, c]) for c in range(3)])
    moved = way - gaussian_filter1d(way, 0.8 * fps, axis=0)
    size = np.linalg.norm(moved, axis=1, keepdims=True)
    moved = moved * (0.04 / np.maximum(size, 0.04))
    swivel = np.interp(at, number, _swivel(wrist, elbow))
    swivel = np.clip(swivel - np.median(swivel), -math.radians(15.0), math.radians(15.0))
    turn = rng.uniform(-np.pi, np.pi)
    c, s = math.cos(turn), math.sin(turn)
    return Wander(moved @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), swivel)


def _arm_of(path: Path | str, markers: Markers) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
    """Wrist (the middle of the hand's back) and elbow from the shoulder, metres, gaps bridged."""
    columns = [markers.places[:, markers.names.index(name)] for name in _ARM_MARKERS]
    number = np.arange(markers.places.shape[0])
    filled = []
    for name, places in zip(_ARM_MARKERS, columns, strict=True):
        seen = ~np.isnan(places[:, 0])
        if not seen.any():
            raise InputError(f"{path}: marker '{name}' is never seen; a recorded arm is wanted")
        filled.append(np.column_stack([np.interp(number, number[seen], places[seen, c]) for c in range(3)]))
    top, left, right, elbow, shoulder = filled
    return _MM * ((top + left + right) / 3.0 - shoulder), _MM * (elbow - shoulder)


def _swivel(wrist: Float[np.ndarray, "m 3"], elbow: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, " m"]:
    """Angle of the elbow about the line from shoulder to wrist, from the vertical; z is up."""
    n = wrist / np.linalg.norm(wrist, axis=1, keepdims=True)
    e1 = -np.array([0.0, 0.0, 1.0]) + n[:, 2:] * n
    e1 = e1 / np.linalg.norm(e1, axis=1, keepdims=True)
    aside = np.cross(e1, n)
    return np.unwrap(np.arctan2((elbow * aside).sum(axis=1), (elbow * e1).sum(axis=1)))
