"""Orientations of inertial sensors in, a suit's segments out: which way each sensor sits, and where the pelvis went.

The person stands still first, upright, facing the x axis, so that every segment's orientation is known then. A sensor's
own world differs from the person's by a heading h, so that

    R_segment(t) = Rz(h)^T R_sensor(t) R_sensor(0)^T Rz(h).

Legs swing to and fro, and so the upward direction as a leg's segment sees it swings along the forward axis: its
principal direction is h, and since knees bend backward and hips forward, its third moment about where it was in
standing tells which way is forward. Pelvis, trunk and head hardly tilt: their h does not matter.

The lowest of heels and toes stays where it is: from that the pelvis's way follows, a drifting one, as of every suit.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from ..errors import InputError
from ..formats.imu_logs import ImuLogs
from ..formats.walks import SEGMENTS
from .posture import Body

STILL = 0.5  # seconds at the beginning in which the person is taken to stand
MOST_RATE = 0.6  # rad/s, root of the mean square there: more is no standing
LEAST_SWING = 0.1  # of the upward direction's horizontal part: less tells no axis
FORWARD = {"thigh": 1.0, "shank": -1.0, "foot": -1.0}  # sign of the upward direction's third moment along that axis
RISE = 0.05  # metres that each rad/s of a foot counts as
_OTHER_NAMES = (
    ("chest", "trunk"), ("torso", "trunk"), ("sternum", "trunk"), ("hips", "pelvis"),
    ("left_upper_leg", "left_thigh"), ("right_upper_leg", "right_thigh"), ("left_lower_leg", "left_shank"),
    ("right_lower_leg", "right_shank"), ("left_lower_arm", "left_forearm"), ("right_lower_arm", "right_forearm"),
)  # fmt: skip
_FEET = (SEGMENTS.index("left_foot"), SEGMENTS.index("right_foot"))


@dataclass(frozen=True, slots=True, eq=False)
class SuitSegments:
    """What a suit of such sensors says.

    Attributes
    ----------
    time : (m,)
        Seconds.
    p, wxyz : (m, 13, 3), (m, 13, 4)
        Origins and orientations of `formats.walks.SEGMENTS`, in the suit's frame: x is forward at the beginning, the
        floor is z = 0.
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    time: Float[np.ndarray, " m"]
    p: Float[np.ndarray, "m 13 3"]
    wxyz: Float[np.ndarray, "m 13 4"]
    warnings: tuple[str, ...]


def suit_segments(logs: ImuLogs, wxyz: Float[np.ndarray, "m n 4"], body: Body) -> SuitSegments:
    """Segments from the orientations of sensors that sit on them.

    Parameters
    ----------
    wxyz : (m, n, 4)
        world_R_sensor, of `orientation.orientations` or the sensors' own, real part first.

    Raises
    ------
    InputError
        If no sensor is on the pelvis, a sensor's name is that of no segment, or nobody stands still at first.
    """
    segment = segments_of_sensors(logs.names)
    still = logs.time - logs.time[0] <= STILL
    rate = np.sqrt((logs.gyroscope[still] ** 2).sum(axis=2).mean(axis=0))
    if rate.max() > MOST_RATE:
        name = logs.names[int(rate.argmax())]
        raise InputError(f"{name}: turns by {rate.max():.2f} rad/s at first; {STILL:g} s of standing still are wanted")
    notes: list[str] = []
    own = np.full((logs.time.size, len(SEGMENTS), 3, 3), np.nan)
    for i, at in enumerate(segment.tolist()):
        turn = Rotation.from_quat(wxyz[:, i], scalar_first=True)
        turn = turn * turn[still].mean().inv()
        heading = _forward(turn, SEGMENTS[at])
        if heading is None:
            heading = 0.0
            if at > 2:  # beyond pelvis, trunk and head, which stay upright
                notes.append(f"{logs.names[i]}: which way is forward is not told; taken to be its world's x axis")
        to = Rotation.from_euler("z", heading)
        own[:, at] = (to.inv() * turn * to).as_matrix()
    R = _with_parents(own, body)
    p = _places(R, body)
    p = p + _way(logs.time, p, R, body)[:, None]
    quaternions = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(scalar_first=True, canonical=True)
    return SuitSegments(logs.time, p, quaternions.reshape(-1, len(SEGMENTS), 4), tuple(notes))


def segments_of_sensors(names: tuple[str, ...]) -> Int[np.ndarray, " n"]:
    """Index in `formats.walks.SEGMENTS` of each sensor, from its name.

    >>> segments_of_sensors(("pelvis", "left_upper_leg")).tolist()
    [0, 7]
    """
    usual = [dict(_OTHER_NAMES).get(name, name) for name in names]
    for name, known in zip(names, usual, strict=True):
        if known not in SEGMENTS:
            raise InputError(f"{name}: is no segment; wanted: {', '.join(SEGMENTS)}")
        if usual.count(known) > 1:
            raise InputError(f"{name}: a second sensor of {known}; one was wanted")
    if SEGMENTS[0] not in usual:
        raise InputError("pelvis: has no sensor, one was wanted")
    return np.array([SEGMENTS.index(name) for name in usual])


def _forward(turn: Rotation, name: str) -> float | None:
    """Heading of the person's forward axis in a sensor's world at the beginning, radians; None if nothing tells."""
    sign = FORWARD.get(name.rsplit("_", maxsplit=1)[-1])
    if sign is None:
        return None
    up = turn.inv().apply([0.0, 0.0, 1.0])[:, :2]
    value, axes = np.linalg.eigh(np.cov(up.T))
    if np.sqrt(value[1]) < LEAST_SWING:
        return None
    swing = up @ axes[:, 1]
    x, y = axes[:, 1] * np.sign(sign * float((swing**3).sum()))
    return float(np.arctan2(y, x))


def _with_parents(own: Float[np.ndarray, "m 13 3 3"], body: Body) -> Float[np.ndarray, "m 13 3 3"]:
    """Orientations of all segments; one without a sensor goes with its parent."""
    R = own.copy()
    for i in range(1, len(SEGMENTS)):
        if np.isnan(R[0, i, 0, 0]):
            R[:, i] = R[:, body.whole.parent[i]]
    return R


def _places(R: Float[np.ndarray, "m 13 3 3"], body: Body) -> Float[np.ndarray, "m 13 3"]:
    """Origins of the segments with the pelvis at the origin."""
    p = np.zeros(R.shape[:3])
    for i in range(1, len(SEGMENTS)):
        above = int(body.whole.parent[i])
        p[:, i] = p[:, above] + R[:, above] @ body.whole.offset[i]
    return p


def _way(
    time: Float[np.ndarray, " m"], p: Float[np.ndarray, "m 13 3"], R: Float[np.ndarray, "m 13 3 3"], body: Body
) -> Float[np.ndarray, "m 3"]:
    """Place of the pelvis at each time: whatever of heels and toes is lowest stays, on the floor.

    A foot that turns is about to leave, or not yet there: it counts as higher.
    """
    sole = np.array([[0.0, 0.0, -body.sizes.ankle], [body.sizes.foot, 0.0, -body.sizes.ankle]])
    points = np.concatenate([p[:, foot, None] + sole @ np.swapaxes(R[:, foot], 1, 2) for foot in _FEET], axis=1)
    height = points[..., 2]
    turned = np.stack(
        [Rotation.from_matrix(R[1:, f] @ np.swapaxes(R[:-1, f], 1, 2)).magnitude() for f in _FEET], axis=1
    )
    rate = turned / np.diff(time)[:, None]
    lowest = (0.5 * (height[:-1] + height[1:]) + RISE * np.repeat(rate, 2, axis=1)).argmin(axis=1)
    step = -np.diff(points, axis=0)[np.arange(lowest.size), lowest]
    way = np.zeros((p.shape[0], 3))
    way[1:, :2] = np.cumsum(step[:, :2], axis=0)
    way[:, 2] = -height.min(axis=1)
    return way
