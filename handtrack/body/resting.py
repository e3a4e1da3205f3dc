"""Trunks of people in; where joints are that nobody has seen, by what they did before and what bodies mostly do, out.

Every bone's direction is averaged in its person's own axes (to his left, down his trunk, forward), so that it turns
with him. A mean of directions that vary is short. It begins with what people do who stand and work with their hands.
"""

import numpy as np
from jaxtyping import Bool, Float

from .skeleton_graph import FILTERED

PARENT = np.array([1, 0, 0, 1, 2, 3, 0, 1, 6, 7, 8, 9])  # shoulders hang on each other
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]
BEFORE, MOST = 30.0, 900.0  # frames as which the first guess counts; frames over which is averaged
# Outwards, down, forward, of one bone length: shoulder, elbow, wrist, hip, knee, ankle.
_MOSTLY = {
    0: (1.0, 0.0, 0.0),
    2: (0.15, 0.85, 0.15),
    4: (-0.1, 0.5, 0.7),
    6: (-0.2, 0.97, 0.0),
    8: (0.0, 0.95, 0.15),
    10: (0.0, 0.97, -0.1),
}
AT_FIRST = np.zeros((FILTERED, 3))
for _k, _share in _MOSTLY.items():
    AT_FIRST[_k] = _share
    AT_FIRST[_k + 1] = -_share[0], _share[1], _share[2]


def axes(p: Float[np.ndarray, "q 12 3"]) -> Float[np.ndarray, "q 3 3"]:
    """Rows: to the left of each person, down his trunk, forward; upright and facing the camera where nothing is known.

    >>> p = np.full((1, 12, 3), np.nan)
    >>> p[0, [0, 1, 6, 7]] = [[0.2, 0, 2], [-0.2, 0, 2], [0.1, 0.5, 2], [-0.1, 0.5, 2]]
    >>> axes(p)[0].round(6).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]
    """
    down = _known(p[:, 6] + p[:, 7] - p[:, 0] - p[:, 1], (0.0, 1.0, 0.0))
    left = _known(p[:, 0] - p[:, 1], (1.0, 0.0, 0.0))
    left = _known(left - (left * down).sum(axis=-1, keepdims=True) * down, (1.0, 0.0, 0.0))
    out = np.empty((p.shape[0], 3, 3))
    out[:, 0], out[:, 1] = left, down
    out[:, 2] = down[:, _NEXT] * left[:, _AFTER] - down[:, _AFTER] * left[:, _NEXT]
    return out


def _known(v: Float[np.ndarray, "q 3"], otherwise: tuple[float, float, float]) -> Float[np.ndarray, "q 3"]:
    """Unit vectors; another one where it is unknown or too short."""
    size = np.sqrt((v * v).sum(axis=-1, keepdims=True))
    return np.where(size > 1e-3, v / np.maximum(size, 1e-3), np.array(otherwise))


def learnt(
    rest: Float[np.ndarray, "q 12 3"],
    times: Float[np.ndarray, "q 12"],
    p: Float[np.ndarray, "q 12 3"],
    turn: Float[np.ndarray, "q 3 3"],
    seen: Bool[np.ndarray, "q 12"],
) -> tuple[Float[np.ndarray, "q 12 3"], Float[np.ndarray, "q 12"]]:
    """Mean directions of bones after a frame, in people's axes, and how many frames they are of.

    Parameters
    ----------
    p : (q, 12, 3)
        Metres.
    turn : (q, 3, 3)
        See `axes`.
    seen : (q, 12)
        Keypoints that are seen now.
    """
    bone = p - p[:, PARENT]
    size = np.sqrt((bone * bone).sum(axis=-1))
    good = seen & seen[:, PARENT] & (size > 1e-3)
    unit = np.where(good[..., None], bone, 0.0) / np.where(good, size, 1.0)[..., None]
    times = np.minimum(times + good, MOST)
    off = unit @ np.swapaxes(turn, 1, 2) - rest
    return rest + np.where(good[..., None], off / (BEFORE + times)[..., None], 0.0), times


def offsets(
    rest: Float[np.ndarray, "q 12 3"], turn: Float[np.ndarray, "q 3 3"], length: Float[np.ndarray, "q 12"]
) -> Float[np.ndarray, "q 12 3"]:
    """From each joint's parent to where it mostly is, metres, camera axes; NaN where the length is unknown."""
    return (rest @ turn) * length[..., None]
