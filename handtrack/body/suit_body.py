"""A suit's segments in, the lengths of the person's body out: the joints of a suit lie where it was told they are.

A length is the median, over time, of the distance between two origins, or of one coordinate of an origin in the axes of
the segment that carries it. What no origin tells (forearm, head, foot, ankle) is scaled with the lengths that are told.
"""

from dataclasses import fields, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ..formats.walks import SEGMENTS, Walk
from .anthropometry import Sizes, measured, sizes_of
from .posture import Body, body_of

_UNTOLD = ("forearm", "head", "foot", "ankle")
SMALLEST = 0.3  # of an average length: less is a suit that puts two origins in one place, and is not used


def body_of_walk(walk: Walk) -> Body:
    """The body of the person of a walk: measured lengths first, then the suit's, then the average of the height."""
    sizes = sizes_from_segments(sizes_of(walk.height), walk.p, walk.wxyz)
    return body_of(walk.height, measured(sizes, walk.measurements))


def sizes_from_segments(sizes: Sizes, p: Float[np.ndarray, "f 13 3"], wxyz: Float[np.ndarray, "f 13 4"]) -> Sizes:
    """Lengths as a suit has them; those of `sizes` where it does not tell.

    Parameters
    ----------
    p, wxyz : (f, 13, 3), (f, 13, 4)
        Origins and quaternions (real part first) of `formats.walks.SEGMENTS`, metres; NaN where missing.

    >>> from .posture import segment_frames
    >>> T = segment_frames(body_of(1.9), np.zeros((1, 26)))
    >>> one = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (1, 13, 4))
    >>> round(sizes_from_segments(sizes_of(1.7), T[..., :3, 3], one).thigh / sizes_of(1.9).thigh, 6)
    1.0
    """
    whole = np.isfinite(p).all(axis=(1, 2)) & np.isfinite(wxyz).all(axis=(1, 2))
    if not whole.any():
        return sizes
    p, wxyz = p[whole], wxyz[whole]

    def local(child: str, parent: str) -> Float[np.ndarray, " 3"]:
        """Median place of an origin in another segment's axes."""
        i, j = SEGMENTS.index(child), SEGMENTS.index(parent)
        turn = Rotation.from_quat(wxyz[:, j], scalar_first=True).inv()
        return np.median(turn.apply(p[:, i] - p[:, j]), axis=0)

    def both(child: str, parent: str) -> float:
        """Mean of left and right of a distance."""
        return 0.5 * sum(float(np.linalg.norm(local(f"{s}_{child}", f"{s}_{parent}"))) for s in ("left", "right"))

    arms = [local(f"{side}_upper_arm", "trunk") for side in ("left", "right")]
    legs = [local(f"{side}_thigh", "pelvis") for side in ("left", "right")]
    trunk = 0.5 * float(arms[0][2] + arms[1][2])
    found = (
        ("hip", 0.5 * float(legs[0][1] - legs[1][1])),
        ("shoulder", 0.5 * float(arms[0][1] - arms[1][1])),
        ("lumbar", float(local("trunk", "pelvis")[2])),
        ("trunk", trunk),
        ("neck", float(local("head", "trunk")[2]) - trunk),
        ("upper_arm", both("forearm", "upper_arm")),
        ("thigh", both("shank", "thigh")),
        ("shank", both("foot", "shank")),
    )
    told = [(name, value) for name, value in found if value > SMALLEST * getattr(sizes, name)]
    limbs = [value / getattr(sizes, name) for name, value in told if name in ("upper_arm", "thigh", "shank")]
    scale = float(np.mean(limbs)) if limbs else 1.0
    rest = {field.name: scale * getattr(sizes, field.name) for field in fields(Sizes) if field.name in _UNTOLD}
    return replace(sizes, **rest, **dict(told))
