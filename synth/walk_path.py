"""A speed and stops in, where a person walks on a rectangle in a room out.

The path is a rectangle with round corners about the room's middle, walked counter-clockwise: at the arc length s its
place and direction are those of its four straights and four quarter circles in turn. The arc length grows with the
speed, which fades to zero and back about each stop along `minimum_jerk`.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .cell_motion import minimum_jerk, smooth_noise

LONG, SHORT, CORNER = 3.0, 2.4, 0.6  # metres: sides of the rectangle, in an arena of 4 by 4, and radius of its corners
RAMP = 0.8  # seconds to stop, or to start
SWAY = (0.06, 3.0)  # metres and seconds: nobody walks on a line
TURN = (3.0, 2.0)  # degrees and seconds: nor straight ahead


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """Where a person walks, at the times of a fine grid.

    Attributes
    ----------
    time : (m,)
        Seconds, evenly spaced.
    s : (m,)
        Arc length, metres.
    xy, heading : (m, 2), (m,)
        Metres, and radians without jumps.
    pace : (m,)
        Speed as a share of the usual one.
    """

    time: Float[np.ndarray, " m"]
    s: Float[np.ndarray, " m"]
    xy: Float[np.ndarray, "m 2"]
    heading: Float[np.ndarray, " m"]
    pace: Float[np.ndarray, " m"]


def lap() -> float:
    """Length of the path, metres.

    >>> round(lap(), 2)
    9.77
    """
    return 2.0 * (LONG + SHORT) - 8.0 * CORNER + 2.0 * math.pi * CORNER


def place_at(s: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Place and direction at arc lengths; the direction grows by a full turn a lap.

    >>> xy, heading = place_at(np.array([0.0, lap()]))
    >>> xy.round(2).tolist(), heading.round(3).tolist()
    ([[-0.9, -1.2], [-0.9, -1.2]], [0.0, 6.283])
    """
    quarter = 0.5 * math.pi * CORNER
    sides = np.array([LONG, SHORT, LONG, SHORT]) - 2.0 * CORNER
    lengths = np.column_stack([sides, np.full(4, quarter)]).ravel()
    begins = np.concatenate([[0.0], np.cumsum(lengths)])
    laps, rest = np.divmod(s, begins[-1])
    piece = np.clip(np.searchsorted(begins, rest, side="right") - 1, 0, 7)
    along, side = rest - begins[piece], piece // 2
    bent = np.where(piece % 2 == 1, along / CORNER, 0.0)
    half = 0.5 * np.array([LONG, SHORT]) - CORNER
    corner = half * np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])  # centre of the circle at each end
    heading = 0.5 * math.pi * side + bent
    before = np.where(piece % 2 == 1, 0.0, along - sides[side])
    xy = corner[side] + CORNER * np.stack([np.sin(heading), -np.cos(heading)], axis=-1)
    xy = xy + before[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return xy, heading + 2.0 * math.pi * laps


def way_of(
    rng: np.random.Generator,
    seconds: float,
    rate: float,
    speed: float,
    start: float,
    stops: Float[np.ndarray, "n 2"],
) -> Way:
    """Walk along the path for a time.

    Parameters
    ----------
    rate : float
        Samples a second of the grid.
    start : float
        Arc length of the first place.
    stops : (n, 2)
        Arc length at which to stand, and seconds to stay there, in the order of the way.
    """
    time = np.arange(math.ceil(seconds * rate) + 1) / rate
    s, pace = _progress(time, speed, start, stops)
    xy, heading = place_at(s)
    side = SWAY[0] * smooth_noise(rng, time.size, SWAY[1] * rate, 1)[:, 0]
    xy = xy + side[:, None] * np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    drift = math.radians(TURN[0]) * smooth_noise(rng, time.size, TURN[1] * rate, 1)[:, 0]
    return Way(time, s, xy, heading + drift * pace, pace)


def _progress(
    time: Float[np.ndarray, " m"], speed: float, start: float, stops: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Arc length, and speed as a share of the usual one.

    A stop takes its time and half a ramp at each end on top of the way, so its beginning follows from the stops before.
    """
    pace = np.ones(time.size)
    lost = 0.0
    for s, stay in stops:
        begin = (s - start) / speed + lost - 0.5 * RAMP
        end = begin + RAMP + stay
        pace = pace * (1.0 - minimum_jerk((time - begin) / RAMP) * (1.0 - minimum_jerk((time - end) / RAMP)))
        lost += RAMP + stay
    step = 0.5 * (pace[1:] + pace[:-1]) * np.diff(time)
    return start + speed * np.concatenate([[0.0], np.cumsum(step)]), pace
