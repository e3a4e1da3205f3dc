"""People that a pose network found, numbered anew in every frame, in; who of them wears the suit out.

People are chained from frame to frame by where their middle is. Whoever wears the suit has the suit's posture, and is
about where the suit says: each chain is asked in some of its frames for the place that fits the suit's posture to its
keypoints. In each frame the walker is the one of the chain that fits best; a chain that mostly does not fit is
somebody else's.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from ..formats.poses2d import Poses2d, to_keypoints
from ..formats.walks import Walk
from .posture import keypoints
from .suit_body import body_of_walk
from .walk_baselines import FEWEST, place_from_points
from .walk_moment import Moment, moments
from .walk_settings import Settings

FASTEST = 1.0  # of the image's height a second, that somebody's middle moves
JUMP = 0.1  # of the image's height, that it may seem to move besides
FORGET = 1.0  # seconds unseen after which a chain has ended
ASKED = 15  # frames of a chain
STRANGER = 0.5  # share of them that may not fit
MISFIT = 10.0  # metres that each share of them counts as


def with_poses(walk: Walk, poses: Poses2d, start: float = 0.0) -> Walk:
    """The walk with one person of a network's as what its camera saw.

    Parameters
    ----------
    start : float
        Time of the network's first frame on the suit's clock.

    Raises
    ------
    InputError
        If there are no frames, or none overlaps the suit's.
    """
    if not poses.time.size:
        raise InputError(f"{walk.path}: the keypoints have no frames; at least one is wanted")
    time = poses.time + start
    if time[-1] < walk.time[0] or time[0] > walk.time[-1]:
        raise InputError(
            f"{walk.path}: the keypoints go from {time[0]:.4g} to {time[-1]:.4g} s, the suit from {walk.time[0]:.4g} "
            f"to {walk.time[-1]:.4g}; times on one clock are wanted"
        )
    uv, confidence = to_keypoints(poses.uv, poses.confidence, poses.names)
    blank = replace(
        walk,
        camera_frame=np.arange(time.size),
        camera_time=time,
        uv=np.full((time.size, 16, 2), np.nan),
        confidence=np.zeros((time.size, 16)),
    )
    chosen = walker(blank, poses.frame, uv, confidence)
    seen = chosen >= 0
    blank.uv[seen], blank.confidence[seen] = uv[chosen[seen]], confidence[chosen[seen]]
    return blank


def walker(
    walk: Walk,
    frame: Int[np.ndarray, " d"],
    uv: Float[np.ndarray, "d 16 2"],
    confidence: Float[np.ndarray, "d 16"],
) -> Int[np.ndarray, " c"]:
    """Number of the walker's detection in each frame of the camera, -1 where nobody is.

    Parameters
    ----------
    walk : Walk
        With the camera's times.
    frame : (d,)
        Of each detection, ascending.
    """
    chain = chains(walk.camera_time, frame, uv, confidence, float(walk.camera.height))
    cost = _costs(walk, frame, uv, confidence, chain)
    chosen = np.full(walk.camera_time.size, -1)
    order = np.lexsort((np.where(chain >= 0, cost[chain], np.inf), frame))
    at, first = np.unique(frame[order], return_index=True)
    best = order[first]
    fits = (chain[best] >= 0) & (cost[chain[best]] < np.inf)
    chosen[at[fits]] = best[fits]
    return chosen


def chains(
    time: Float[np.ndarray, " f"],
    frame: Int[np.ndarray, " d"],
    uv: Float[np.ndarray, "d 16 2"],
    confidence: Float[np.ndarray, "d 16"],
    height: float,
) -> Int[np.ndarray, " d"]:
    """Number of the chain that each detection belongs to; -1 for one without keypoints.

    Parameters
    ----------
    height : float
        Of the image, pixels.

    >>> uv = np.zeros((3, 16, 2)) + np.array([100.0, 400.0, 110.0])[:, None, None]
    >>> chains(np.array([0.0, 0.1]), np.array([0, 1, 1]), uv, np.ones((3, 16)), 720.0).tolist()
    [0, 1, 0]
    """
    out = np.full(frame.size, -1)
    known = confidence > 0
    count = known.sum(axis=1)
    middle = np.where(known[..., None], uv, 0.0).sum(axis=1) / np.maximum(count, 1)[:, None]
    last, when = np.zeros((0, 2)), np.zeros(0)
    for n in np.unique(frame).tolist():
        here = np.flatnonzero((frame == n) & (count > 0))
        age = time[n] - when
        apart = np.linalg.norm(middle[here][:, None] - last, axis=-1)
        apart[:, age > FORGET] = np.inf
        apart[apart > height * (JUMP + FASTEST * age)] = np.inf
        while apart.size and np.isfinite(apart.min()):
            who, which = np.unravel_index(int(apart.argmin()), apart.shape)
            out[here[who]] = which
            apart[who], apart[:, which] = np.inf, np.inf
        new = here[out[here] < 0]
        out[new] = when.size + np.arange(new.size)
        last, when = np.concatenate([last, middle[new]]), np.concatenate([when, np.zeros(new.size)])
        last[out[here]], when[out[here]] = middle[here], time[n]
    return out


def _costs(
    walk: Walk,
    frame: Int[np.ndarray, " d"],
    uv: Float[np.ndarray, "d 16 2"],
    confidence: Float[np.ndarray, "d 16"],
    chain: Int[np.ndarray, " d"],
) -> Float[np.ndarray, " c"]:
    """How badly each chain fits the suit, metres; infinite for somebody else's."""
    body = body_of_walk(walk)
    told = [each for each in moments(walk, body, Settings()) if each.seen]
    row = np.searchsorted([each.time for each in told], walk.camera_time)
    row = np.minimum(row, max(len(told) - 1, 0))
    out = np.full(int(chain.max(initial=-1)) + 1, np.inf)
    for k in range(out.size):
        rows = np.flatnonzero((chain == k) & (np.count_nonzero(confidence > 0, axis=1) >= FEWEST))
        rows = rows[np.unique(np.linspace(0, max(rows.size - 1, 0), ASKED).astype(int))] if rows.size else rows
        asked = [replace(told[row[frame[d]]], uv=uv[d], confidence=confidence[d]) for d in rows.tolist() if told]
        found = [_off(moment, keypoints(body, _still(moment))[0]) for moment in asked]
        off = [each for each in found if each is not None]
        misfits = 1.0 - len(off) / len(found) if found else 1.0
        if found and misfits <= STRANGER:
            out[k] = float(np.median(off)) + MISFIT * misfits
        elif not found:
            out[k] = 2.0 * MISFIT  # too few keypoints to tell: only where nobody else is there
    return out


def _still(moment: Moment) -> Float[np.ndarray, "1 26"]:
    """The suit's posture with the pelvis's turn, at the origin."""
    q = moment.q[None].copy()
    q[:, :3] = 0.0
    return q


def _off(moment: Moment, points: Float[np.ndarray, "16 3"]) -> float | None:
    """Metres from the suit's place to that of a person with its posture in the image; None if there is none."""
    found = place_from_points(moment, points)
    return None if found is None else float(np.linalg.norm(found[0] - moment.p[0]))
