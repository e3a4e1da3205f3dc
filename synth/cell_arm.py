"""The wrists' way in, a whole posture out that keeps the joint limits and stays out of the furniture.

The trunk leans as far as the reach needs, early and smoothly. Of the elbow's swivel angles those are tried that keep
the limits and the distance from every box; a path through them of least `sum ((s - nominal) / spread)^2 + (step /
pace)^2` is found by dynamic programming, then made smooth and checked again.
"""

import math

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from .cell_room import Boxes, distance_to
from .people import RIGHT, Body, arm_angles, elbow_at, shoulders, trunk_axes, within_limits

MOST_LEAN, ALWAYS, TWIST = 36.0, math.radians(3.0), 0.6  # degrees; radians; of the lean
FREE = 3  # swivel angles that are left everywhere on a way
REACH = 0.93  # share of the arm's length that the trunk leans for
SPARE = 0.012  # metres kept from the furniture while planning
WANDERING = 0.012  # more that ways keep, because the wrist will wander about them
CLEAR = 0.003  # metres kept in the end
SMOOTH = (0.1, 0.06, 0.03)  # seconds over which a path of swivel angles is made smooth, the first that fits
LIMIT_SPARE = math.radians(2.0)
SWIVELS = np.radians(np.arange(-60.0, 121.0, 6.0))
NOMINAL = math.radians(22.0)
_SPREAD, _PACE, _MOST_STEP = math.radians(25.0), math.radians(3.0), 3
_SAMPLES = (5, 9, 5)  # spheres along the upper arm's lower end, forearm and hand


def _least_lean(
    body: Body, pelvis: Float[np.ndarray, "n 3"], wrist: Float[np.ndarray, "n 3"], turn: float
) -> Float[np.ndarray, " n"]:
    """Least lean, radians, that brings the right wrist within reach, or as near as it can."""
    grid = np.radians(np.arange(0.0, MOST_LEAN, 1.0))
    leaning = [
        shoulders(body, pelvis, np.broadcast_to(ax, (pelvis.shape[0], 3, 3)))[:, RIGHT]
        for ax in trunk_axes(grid, turn + TWIST * grid)
    ]
    gap = np.stack([np.linalg.norm(wrist - shoulder, axis=1) for shoulder in leaning], axis=1)
    near = gap <= REACH * body.arm
    return np.where(near.any(axis=1), grid[near.argmax(axis=1)], grid[gap.argmin(axis=1)])


def lean_for(
    body: Body, pelvis: Float[np.ndarray, "f 3"], wrist: Float[np.ndarray, "f 3"], turn: float, fps: float
) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, " f"]]:
    """Lean and twist, radians: the least that bring the right wrist within reach, spread over half a second.

    Reaching with the right arm turns the trunk to the left, from the `turn` it stands with.
    """
    window = 2 * int(0.15 * fps) + 1
    need = maximum_filter1d(_least_lean(body, pelvis, wrist, turn), window)
    lean = gaussian_filter1d(need, max(0.08 * fps, 0.5)) + ALWAYS
    return lean, turn + TWIST * lean


def reachable(body: Body, ways: Float[np.ndarray, "w s 3"], turn: float, boxes: Boxes) -> Bool[np.ndarray, " w"]:
    """Whether the right wrist may go ways through the cell: within reach, and with room for the elbow everywhere."""
    wrist = ways.reshape(-1, 3)
    pelvis = np.repeat([[0.0, 0.0, body.hip_height]], wrist.shape[0], axis=0)
    least = _least_lean(body, pelvis, wrist, turn).reshape(ways.shape[:2])
    # the trunk leans before the hand needs it: a reach of 0.7 s has a place every 0.1 s in its middle
    lean = maximum_filter1d(least, 3, axis=1).reshape(-1) + ALWAYS
    axes = trunk_axes(lean, turn + TWIST * lean)
    shoulder = shoulders(body, pelvis, axes)[:, RIGHT]
    fits = np.linalg.norm(wrist - shoulder, axis=1) <= (REACH + 0.02) * body.arm
    fits &= _allowed(body, shoulder, axes, wrist, RIGHT, boxes, SPARE + WANDERING).sum(axis=1) >= FREE
    return fits.reshape(ways.shape[:2]).all(axis=1)


def arm_spheres(
    body: Body, shoulder: Float[np.ndarray, "n 3"], elbow: Float[np.ndarray, "n 3"], wrist: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n s 3"], Float[np.ndarray, " s"]]:
    """Spheres along the lower half of the upper arm, the forearm and the hand; parts 5, 7 and 9 of `PARTS`."""
    knuckles = wrist + body.hand / body.forearm * (wrist - elbow)
    middle = 0.5 * (shoulder + elbow)
    upper, fore, hand = body.radius[5].copy(), body.radius[7], body.radius[9]
    upper[0] = upper.mean()
    places, radii = [], []
    pairs = ((middle, elbow, upper), (elbow, wrist, fore), (wrist, knuckles, hand))
    for (a, b, r), count in zip(pairs, _SAMPLES, strict=True):
        s = np.linspace(0.0, 1.0, count)
        places.append(a[:, None] + s[:, None] * (b - a)[:, None])
        radii.append(r[0] + s * (r[1] - r[0]))
    return np.concatenate(places, axis=1), np.concatenate(radii)


def arm_fits(
    body: Body,
    shoulder: Float[np.ndarray, "n 3"],
    elbow: Float[np.ndarray, "n 3"],
    wrist: Float[np.ndarray, "n 3"],
    boxes: Boxes,
    spare: float,
) -> Bool[np.ndarray, " n"]:
    """Whether an arm keeps `spare` metres from all boxes; false for NaN."""
    known = ~np.isnan(elbow[:, 0])
    out = np.zeros(known.size, dtype=bool)
    places, radii = arm_spheres(body, shoulder[known], elbow[known], wrist[known])
    gap = distance_to(boxes, places.reshape(-1, 3)).reshape(places.shape[:2]) - radii
    out[known] = (gap >= spare).all(axis=1)
    return out


def plan_swivel(
    body: Body,
    shoulder: Float[np.ndarray, "f 3"],
    axes: Float[np.ndarray, "f 3 3"],
    wrist: Float[np.ndarray, "f 3"],
    wander: Float[np.ndarray, " f"],
    side: int,
    boxes: Boxes,
    fps: float,
) -> Float[np.ndarray, " f"] | None:
    """Swivel angle of one arm in every frame, or None where there is no way.

    Parameters
    ----------
    wander : (f,)
        Wanted deviation from a relaxed arm, radians.
    """
    allowed = _allowed(body, shoulder, axes, wrist, side, boxes)
    cost = np.where(allowed, ((SWIVELS - NOMINAL - wander[:, None]) / _SPREAD) ** 2, np.inf)
    path = _cheapest(cost)
    if path is None:
        return None
    for width in SMOOTH:
        swivel = gaussian_filter1d(SWIVELS[path], max(width * fps, 0.3))
        elbow = elbow_at(body, shoulder, wrist, axes, swivel, side)
        fits = arm_fits(body, shoulder, elbow, wrist, boxes, CLEAR)
        if (fits & within_limits(arm_angles(shoulder, elbow, wrist, axes, side))).all():
            return swivel
    return None


def _allowed(
    body: Body,
    shoulder: Float[np.ndarray, "f 3"],
    axes: Float[np.ndarray, "f 3 3"],
    wrist: Float[np.ndarray, "f 3"],
    side: int,
    boxes: Boxes,
    spare: float = SPARE,
) -> Bool[np.ndarray, "f k"]:
    f, k = wrist.shape[0], SWIVELS.size
    s3, w3 = (np.broadcast_to(v[:, None], (f, k, 3)) for v in (shoulder, wrist))
    ax = np.broadcast_to(axes[:, None], (f, k, 3, 3))
    elbow = elbow_at(body, s3, w3, ax, np.broadcast_to(SWIVELS, (f, k)), side)
    allowed = within_limits(arm_angles(s3, elbow, w3, ax, side), LIMIT_SPARE)
    at = np.flatnonzero(allowed)
    a, b, c = (v.reshape(-1, 3)[at] for v in (s3, elbow, w3))
    allowed.reshape(-1)[at] = arm_fits(body, a, b, c, boxes, spare)
    return allowed


def _cheapest(cost: Float[np.ndarray, "f k"]) -> Int[np.ndarray, " f"] | None:
    """Indices of the path of least cost that steps at most `_MOST_STEP` columns a frame."""
    f, k = cost.shape
    column = np.arange(k)
    step = column[:, None] - column
    move = np.where(np.abs(step) <= _MOST_STEP, ((SWIVELS[1] - SWIVELS[0]) / _PACE * step) ** 2, np.inf)
    total, back = cost[0], np.zeros((f, k), dtype=int)
    for i in range(1, f):
        way = total + move
        back[i] = way.argmin(axis=1)
        total = way[column, back[i]] + cost[i]
    if not np.isfinite(total.min()):
        return None
    path = np.empty(f, dtype=int)
    path[-1] = total.argmin()
    for i in range(f - 1, 0, -1):
        path[i - 1] = back[i, path[i]]
    return path
