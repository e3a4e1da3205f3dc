"""Keypoints of people in pixels, as pose networks give them, in; the keypoints of the project out.

Every network has its own list of keypoints: OpenPose's 15 (MPI), 18 (COCO) and 25 (BODY_25 and BODY_25B, in different
orders), COCO's 17, MediaPipe's 33; and 21 of each hand. They are told apart by name. What is built: `mid_shoulder` is
the neck where there is one, else the middle of the shoulders, `mid_hip` the middle of the hips where it is not given,
`head` the middle of the ears, `root` the middle of hips and shoulders; each as sure as the least sure of its sources.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from .skeletons import KEYPOINTS

MOST_PIXELS = 1e6


def _sides(*joints: str) -> tuple[str, ...]:
    return tuple(f"{side}_{joint}" for joint in joints for side in ("left", "right"))


_RIGHT_LEFT = tuple(
    f"{side}_{joint}" for side in ("right", "left") for joint in ("shoulder", "elbow", "wrist")
)  # fmt: skip
_LEGS = tuple(f"{side}_{joint}" for side in ("right", "left") for joint in ("hip", "knee", "ankle"))
COCO_17 = ("nose", *_sides("eye", "ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle"))
MPI_15 = ("head_top", "neck", *_RIGHT_LEFT, *_LEGS, "chest")
COCO_18 = ("nose", "neck", *_RIGHT_LEFT, *_LEGS, "right_eye", "left_eye", "right_ear", "left_ear")
BODY_25 = (
    "nose", "neck", *_RIGHT_LEFT, "mid_hip", *_LEGS, "right_eye", "left_eye", "right_ear", "left_ear",
    "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel",
)  # fmt: skip
BODY_25B = (
    *COCO_17, "neck", "head_top",
    "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel",
)  # fmt: skip
MEDIAPIPE_33 = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    *_sides("ear"), "mouth_left", "mouth_right", *_sides("shoulder", "elbow", "wrist", "pinky", "index", "thumb"),
    *_sides("hip", "knee", "ankle", "heel", "foot_index"),
)  # fmt: skip
_FINGERS = ("thumb", "index", "middle", "ring", "little")
HAND_21 = ("wrist", *(f"{finger}_{i}" for finger in _FINGERS for i in range(1, 5)))

# Which keypoints each of the last four is the middle of, where the network does not give it.
_BUILT = (
    ("mid_hip", ("left_hip", "right_hip")),
    ("mid_shoulder", ("left_shoulder", "right_shoulder")),
    ("head", ("left_ear", "right_ear")),
    ("root", ("left_shoulder", "right_shoulder", "left_hip", "right_hip")),
)


@dataclass(frozen=True, slots=True, eq=False)
class Poses2d:
    """People in pixels, d of them with k keypoints, sorted by frame, then by person.

    Attributes
    ----------
    time : (f,)
        Seconds of every frame, strictly rising; also of frames without anybody.
    frame, person : (d,)
        Frame of each, and its number in that frame, from 0; no identity.
    uv : (d, k, 2)
        Pixels, (0, 0) the centre of the top-left one; NaN where unseen.
    confidence : (d, k)
        0..1; 0 where unseen.
    names : tuple of k str
    world : (d, k, 3) or None
        Metres from the middle of the hips, along the camera's axes, where the network says so; NaN where unseen.
    files : tuple of Path
        All that was read.
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    time: Float[np.ndarray, " f"]
    frame: Int[np.ndarray, " d"]
    person: Int[np.ndarray, " d"]
    uv: Float[np.ndarray, "d k 2"]
    confidence: Float[np.ndarray, "d k"]
    names: tuple[str, ...]
    world: Float[np.ndarray, "d k 3"] | None = None
    files: tuple[Path, ...] = ()
    warnings: tuple[str, ...] = ()


def refuse_far(place: str, values: Float[np.ndarray, "..."], most: float, unit: str) -> None:
    """Refuse values whose size no image or room has.

    Raises
    ------
    InputError
        Naming the place and the largest value.
    """
    if values.size and np.abs(values).max() > most:
        raise InputError(f"{place}: {np.abs(values).max():g} {unit} are given; at most {most:g} are wanted")


def to_keypoints(
    values: Float[np.ndarray, "d k c"], confidence: Float[np.ndarray, "d k"], names: tuple[str, ...]
) -> tuple[Float[np.ndarray, "d 16 c"], Float[np.ndarray, "d 16"]]:
    """Values and confidences of a network's keypoints as those of `KEYPOINTS`; NaN and 0 where there is none.

    Parameters
    ----------
    values : (d, k, c)
        Pixels or metres, NaN where unseen.

    >>> values, sure = to_keypoints(np.array([[[2.0], [4.0]]]), np.array([[0.5, 0.9]]), ("left_hip", "right_hip"))
    >>> values[0, KEYPOINTS.index("mid_hip")].tolist(), sure[0, KEYPOINTS.index("mid_hip")].tolist()
    ([3.0], 0.5)
    """
    d, _, c = values.shape
    out, sure = np.full((d, 16, c), np.nan), np.zeros((d, 16))
    for k, name in enumerate(KEYPOINTS):
        known = "neck" if name == "mid_shoulder" and "neck" in names else name
        if known in names:
            out[:, k], sure[:, k] = values[:, names.index(known)], confidence[:, names.index(known)]
    for name, sources in _BUILT:
        k = KEYPOINTS.index(name)
        at = [names.index(source) for source in sources if source in names]
        if len(at) == len(sources):
            lacking = np.isnan(out[:, k, 0])
            built, least = values[:, at].mean(axis=1), confidence[:, at].min(axis=1)
            out[lacking, k], sure[lacking, k] = built[lacking], least[lacking]
    return out, np.where(np.isnan(out[..., 0]), 0.0, sure)
