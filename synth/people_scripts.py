"""A task's name and a seed in, what two people, their things and a robot do on the stage out.

The tasks are those of the people paper, III-C (operator O to the left, collaborator C to the right of the camera's
image, both behind a table and turned a little to each other, so that O's left and C's right hand are the inner ones):

* `T0`: O's left hand carries a small thing from O's right to the left, in waves around obstacles; C looks on.
* `T1`: O's left and C's right hand stack ten cups to a pyramid between them.
* `T2`: five cups go from O's left to C's left hand, one by one, and back.
* `T3`: O lifts a box with both hands and hands it over; O's left hand gives C's right one a thing, C puts it in, closes
  the box and hands it back. The box is between the camera and O's left wrist while O holds it.

Places and times vary from seed to seed by some centimetres and 15 %. The stage's axes: x right, y away from the
camera, z up; metres, seconds.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .people_motion import Person, Spot, Way, along, hanging, way_of

TASKS = ("T0", "T1", "T2", "T3")
TABLE = 0.90  # height of the table
CUP = np.array([0.04, 0.04, 0.05])  # half size
_UP = np.array([0.0, 0.0, 1.0])
GONE = np.array([0.0, 0.0, -50.0])  # where things are that are not there

_Rows = list[tuple[float, Spot, float]]


@dataclass(frozen=True, slots=True, eq=False)
class Script:
    """Where wrists are led and things are, in f frames; the stage's axes, metres.

    Attributes
    ----------
    hands : (f, 2, 2, 3)
        Left and right wrist of O, then of C.
    centre, turn, half : (f, b, 3), (f, b), (b, 3)
        Of boxes that move, appear or go.
    """

    hands: Float[np.ndarray, "f 2 2 3"]
    centre: Float[np.ndarray, "f b 3"]
    turn: Float[np.ndarray, "f b"]
    half: Float[np.ndarray, "b 3"]


def script(rng: np.random.Generator, name: str, people: tuple[Person, Person], frames: int, fps: float) -> Script:
    """What is done in one of the `TASKS`, begun again until the frames are full."""
    time = np.arange(frames) / fps
    rest = np.stack([np.stack([hanging(who, side, frames) for side in (0, 1)], axis=1) for who in people], axis=1)
    return {"T0": _waves, "T1": _pyramid, "T2": _handovers, "T3": _heavy_box}[name](rng, time, rest)


class _Clock:
    """Times of knots, one after the other, each step stretched at random by up to 15 %."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng, self.now = rng, 0.0

    def after(self, seconds: float) -> float:
        self.now += seconds * self._rng.uniform(0.85, 1.15)
        return self.now


def _near(rng: np.random.Generator, place: Spot, spread: float = 0.025) -> list[float]:
    return (np.asarray(place) + rng.uniform(-spread, spread, 3)).tolist()


def _waves(rng: np.random.Generator, time: Float[np.ndarray, " f"], rest: Float[np.ndarray, "f 2 2 3"]) -> Script:
    """T0: to and fro in waves around three obstacles on the table."""
    left, right = -0.66 + rng.uniform(-0.04, 0.04), -0.12 + rng.uniform(-0.04, 0.04)
    period = 2.0 * rng.uniform(4.2, 5.4)
    cycle = (time % period) / period
    share = np.where(cycle < 0.5, 2.0 * cycle, 2.0 - 2.0 * cycle)
    share = np.clip((share - 0.06) / 0.88, 0.0, 1.0)
    share = share * share * (3.0 - 2.0 * share)  # rests a little at both ends
    hands = rest.copy()
    wave = np.sin(3.0 * math.pi * share)
    hands[:, 0, 0, 0] = left + (right - left) * share
    hands[:, 0, 0, 1] = 0.08 + rng.uniform(0.07, 0.10) * wave
    hands[:, 0, 0, 2] = TABLE + 0.16 + 0.03 * np.cos(6.0 * math.pi * share)
    at = left + (right - left) * (np.arange(3) + 0.5) / 3.0
    spots = np.column_stack([at, 0.08 - 0.04 * np.array([1.0, -1.0, 1.0]), np.full(3, TABLE + 0.08)])
    half = np.tile([0.03, 0.03, 0.08], (3, 1))
    return Script(hands, np.repeat(spots[None], time.size, axis=0), np.zeros((time.size, 3)), half)


def _pyramid(rng: np.random.Generator, time: Float[np.ndarray, " f"], rest: Float[np.ndarray, "f 2 2 3"]) -> Script:
    """T1: ten cups, in turn from O's and C's pile; the pyramid is taken away when it stands."""
    slots = [(0.085 * (i - 0.5 * (4 - row - 1)), row) for row in range(4) for i in range(4 - row)]
    middle = np.array([rng.uniform(-0.03, 0.03), rng.uniform(-0.02, 0.04), 0.0])
    tops = [middle + np.array([x, 0.0, TABLE + 0.05 + 0.1 * row]) for x, row in slots]
    order = [[i for i in range(10) if i % 2 == who] for who in (0, 1)]
    piles = (_near(rng, (-0.34, 0.05, TABLE + 0.12)), _near(rng, (0.34, 0.05, TABLE + 0.12)))
    hands, centre = rest.copy(), np.broadcast_to(GONE, (time.size, 10, 3)).copy()
    start, carried = 0.0, list[tuple[float, float, int, int]]()  # from, to, by whom, which cup
    while start < time[-1] or start == 0.0:
        ends = []
        for who, cups in enumerate(order):
            clock = _Clock(rng)
            clock.now = start + rng.uniform(0.0, 0.4)
            rows: _Rows = [(start, piles[who], 0.0), (clock.after(0.2), piles[who], 0.0)]
            for cup in cups:
                goal = tops[cup] + [(-0.045, 0.045)[who], 0.09, 0.0]  # the wrist stays behind and beside the cup
                taken = clock.now
                rows.append((clock.after(1.2), _near(rng, goal, 0.01), 0.06))
                placed = clock.after(0.6)
                carried.append((taken, placed, who, cup))
                rows.append((placed, goal.tolist(), 0.0))
                centre[time >= placed, cup] = tops[cup]
                rows += [(clock.after(1.2), _near(rng, piles[who]), 0.06), (clock.after(0.35), piles[who], 0.0)]
            ends.append(clock.now)
            now = time >= start
            hands[now, who, who] = along(way_of(rows), time[now])
        start = max(ends) + 1.0
        centre[time >= start] = GONE
    for begin, end, who, cup in carried:
        now = (time >= begin) & (time < end)
        centre[now, cup] = hands[now, who, who] + [(0.045, -0.045)[who], -0.09, 0.0]
    return Script(hands, centre, np.zeros((time.size, 10)), np.tile(CUP, (10, 1)))


def _handovers(rng: np.random.Generator, time: Float[np.ndarray, " f"], rest: Float[np.ndarray, "f 2 2 3"]) -> Script:
    """T2: five cups from O's left to C's left hand, and back."""
    piles = ((-0.34, 0.08, TABLE + 0.12), (0.50, 0.08, TABLE + 0.12))
    clock = _Clock(rng)
    rows: tuple[_Rows, _Rows] = ([(0.0, piles[0], 0.0)], [(0.0, piles[1], 0.0)])
    carried: list[tuple[float, float, int]] = []  # from, to, whose hand
    turn = 0
    while clock.now < time[-1] or turn == 0:
        giver = (turn // 5) % 2
        meet = np.array(_near(rng, (0.03, 0.05, TABLE + 0.30), 0.04))
        taken, there, gone = clock.after(0.5), clock.after(1.0), clock.after(0.7)
        back = clock.after(0.9)
        for who in (0, 1):
            apart = np.array([-0.045, 0.05, 0.0]) if who == 0 else np.array([0.045, 0.05, 0.02])
            late = 0.12 if who != giver else 0.0  # the taker comes a moment later
            rows[who].append((taken + late, _near(rng, piles[who]), 0.0))
            rows[who].append((there + late, (meet + apart).tolist(), 0.05))
            rows[who].append((gone + late, (meet + apart).tolist(), 0.0))
            rows[who].append((back + late, _near(rng, piles[who]), 0.05))
        carried += [(taken, 0.5 * (there + gone), giver), (0.5 * (there + gone), back, 1 - giver)]
        turn += 1
    hands = rest.copy()
    for who in (0, 1):
        hands[:, who, 0] = along(way_of(rows[who]), time)
    cup = np.broadcast_to(GONE, (time.size, 1, 3)).copy()
    for begin, end, who in carried:
        now = (time >= begin) & (time < end)
        cup[now, 0] = hands[now, who, 0] + [(0.07, -0.07)[who], -0.06, 0.0]  # in the hand, beyond the wrist
    return Script(hands, cup, np.zeros((time.size, 1)), CUP[None].copy())


def _heavy_box(rng: np.random.Generator, time: Float[np.ndarray, " f"], rest: Float[np.ndarray, "f 2 2 3"]) -> Script:
    """T3: the box goes to C, gets a thing from O's left by C's right hand, and comes back; again and again."""
    half = np.array([0.20, 0.18, 0.15]) * rng.uniform(0.92, 1.08)
    spots = ((-0.42, 0.0), (0.02, 0.16), (0.40, 0.0))
    left, middle, right = (np.array([x, 0.02, TABLE + half[2] + lift]) for x, lift in spots)
    grips = np.array([[0.55 * half[0], half[1] + 0.05, 0.0], [-0.55 * half[0], half[1] + 0.05, 0.0]])
    pile, meet = np.array([-0.52, 0.10, TABLE + 0.10]), np.array([0.02, 0.10, TABLE + 0.30])
    aside = np.array([0.04, 0.0, 0.0])
    clock = _Clock(rng)
    box: _Rows = [(0.0, left, 0.0)]
    o_left: _Rows = [(0.0, left + grips[0], 0.0)]
    c_right: _Rows = [(0.0, [0.45, 0.12, TABLE + 0.12], 0.0)]
    held: list[tuple[float, float, int]] = []  # both hands of whom are at the box
    while clock.now < time[-1] or len(box) == 1:
        begin = clock.now
        for place, seconds in ((left, 1.0), (left + 0.15 * _UP, 1.1), (middle, 2.0), (middle, 1.4)):
            box.append((clock.after(seconds), place, 0.0))
        given = clock.now
        box += [(clock.after(1.3), right, 0.0), (clock.after(0.5), right, 0.0)]
        held += [(begin, given + 0.3, 0), (given - 0.6, clock.now, 1)]
        o_left.append((given + 0.9, _near(rng, (-0.45, 0.15, TABLE + 0.2)), 0.0))
        c_right.append((clock.now, right + grips[1], 0.0))
        o_left += [(clock.after(0.9), _near(rng, pile), 0.05), (clock.after(0.4), pile, 0.0)]
        there = clock.after(1.2)
        o_left += [(there, meet - aside, 0.05), (there + 0.6, meet - aside, 0.0)]
        c_right += [(there + 0.1, meet + aside, 0.05), (there + 0.7, meet + aside, 0.0)]
        clock.now = there + 0.7
        o_left.append((clock.after(1.0), _near(rng, (-0.40, 0.15, TABLE + 0.15)), 0.0))
        c_right += [(clock.now, right + (half[2] + 0.06) * _UP, 0.05), (clock.after(0.8), right + grips[1], 0.0)]
        lifted = clock.now
        box.append((lifted, right, 0.0))
        box += [(clock.after(1.8), middle, 0.0), (clock.after(1.4), middle, 0.0)]
        held += [(lifted, clock.now + 0.3, 1), (clock.now - 0.6, clock.now + 4.0, 0)]
        c_right.append((clock.now + 1.0, [0.45, 0.12, TABLE + 0.12], 0.0))
        box += [(clock.after(2.0), left, 0.0), (clock.after(1.0), left, 0.0)]
    return _around_box(time, rest, way_of(box), (way_of(o_left), way_of(c_right)), held, grips, half)


def _around_box(
    time: Float[np.ndarray, " f"],
    rest: Float[np.ndarray, "f 2 2 3"],
    box: Way,
    free: tuple[Way, Way],
    held: list[tuple[float, float, int]],
    grips: Float[np.ndarray, "2 3"],
    half: Float[np.ndarray, " 3"],
) -> Script:
    """Hands at the box while they hold it, else on their own ways; half a second leads from one to the other."""
    centre = along(box, time)
    share = np.zeros((time.size, 2))
    for begin, end, who in held:
        share[:, who] = np.maximum(share[:, who], np.clip(np.minimum(time - begin, end - time) / 0.5 + 0.5, 0.0, 1.0))
    share = (share * share * (3.0 - 2.0 * share))[:, :, None, None]
    # seen from behind the box both have their left hand to the camera's right
    holding = np.stack([centre[:, None] + grips] * 2, axis=1)
    loose = rest.copy()
    loose[:, 0, 0], loose[:, 1, 1] = along(free[0], time), along(free[1], time)
    hands = loose + share * (holding - loose)
    return Script(hands, centre[:, None], np.zeros((time.size, 1)), half[None])
