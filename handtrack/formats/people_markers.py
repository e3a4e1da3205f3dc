"""Labelled people in, one marker for each label and keypoint out: what the formats of motion capture know.

Those formats have the y axis up: `x` stays, `y` and `z` change their signs (half a turn about x), lengths become
millimetres. A marker is called `<label>_<keypoint>`. Where a keypoint is lost, or its person absent, is a gap (NaN).
"""

import numpy as np
from jaxtyping import Float, Int

from .markers import Markers
from .people import LOST, People
from .skeletons import KEYPOINTS

UP = np.array([1.0, -1.0, -1.0])  # camera axes from axes with y up, and back
MILLIMETRES = 1000.0  # in a metre


def courses(people: People) -> tuple[Int[np.ndarray, " q"], Float[np.ndarray, "f q 16 3"]]:
    """Labels, rising, and the keypoints of each in every frame, metres, camera axes; NaN where absent or lost."""
    label, at = np.unique(people.person, return_inverse=True)
    out = np.full((people.time.size, label.size, len(KEYPOINTS), 3), np.nan)
    out[people.frame, at] = np.where((people.status == LOST)[..., None], np.nan, people.p)
    return label, out


def rate_of(people: People) -> float:
    """Frames a second; 1 where there are not two frames."""
    return float(1.0 / np.median(np.diff(people.time))) if people.time.size > 1 else 1.0


def people_markers(people: People) -> Markers:
    """Markers of all people, y up, millimetres.

    >>> zero = np.zeros(1, dtype=int)
    >>> C = np.broadcast_to(np.eye(3), (1, 16, 3, 3))
    >>> one = People(np.zeros(1), zero, zero + 7, np.ones((1, 16, 3)), np.ones((1, 16)), C, np.zeros((1, 16), np.int8))
    >>> markers = people_markers(one)
    >>> markers.names[4], markers.places[0, 4].tolist()
    ('7_left_wrist', [1000.0, -1000.0, -1000.0])
    """
    label, p = courses(people)
    names = tuple(f"{who}_{name}" for who in label.tolist() for name in KEYPOINTS)
    return Markers(names, MILLIMETRES * (p * UP).reshape(p.shape[0], len(names), 3), rate_of(people))
