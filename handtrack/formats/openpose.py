"""A folder of OpenPose's JSON files in, one for each frame; keypoints of people in pixels out.

`{"people": [{"pose_keypoints_2d": [u, v, c, ...], "hand_left_keypoints_2d": [], "hand_right_keypoints_2d": []}]}`. A
keypoint `0, 0, 0` was not seen. The last number in a file's name is its frame's, and frames without a file saw nobody.
The length tells the list of keypoints, but BODY_25 and BODY_25B both have 25: the right order is the one in which limbs
are short. Points off the image were not detected but put there by somebody: they count as unseen.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import Field

from ..errors import InputError
from .json_files import Loose, read_json
from .paths import leaving
from .poses2d import BODY_25, BODY_25B, COCO_18, HAND_21, MOST_PIXELS, MPI_15, Poses2d, refuse_far
from .skeletons import MOST_FRAMES

MOST_PEOPLE = 1000
BORDER = 2.0  # pixels beyond the image's border that rounding and interpolation explain

_LIMBS = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("eye", "ear"))

Layout = Literal["auto", "body_25", "body_25b"]


class _Person(Loose):
    pose_keypoints_2d: list[float] = Field(default_factory=list)
    hand_left_keypoints_2d: list[float] = Field(default_factory=list)
    hand_right_keypoints_2d: list[float] = Field(default_factory=list)


class _File(Loose):
    people: Annotated[list[_Person], Field(max_length=MOST_PEOPLE)]


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """All people of all files: file number of each (d,), and its keypoints with confidence (d, k, 3)."""

    file: Int[np.ndarray, " d"]
    values: Float[np.ndarray, "d k 3"]


def read_openpose(
    folder: Path | str, fps: float, size: tuple[int, int] | None = None, layout: Layout = "auto"
) -> Poses2d:
    """Read a folder of `*_keypoints.json`, or of any `.json` files if it has none of that name.

    Parameters
    ----------
    fps : float
        Frames a second.
    size : (width, height) or None
        Of the image, pixels; points more than two pixels off it count as unseen, with a warning.
    layout : 'auto', 'body_25' or 'body_25b'
        Order of 25 keypoints; `auto` takes the one with the shorter limbs.

    Raises
    ------
    InputError
        If there are no files, a file is not OpenPose's, two files have the same frame number, or lists of different
        lengths, or of an unknown one, are found.
    """
    folder = Path(folder)
    if not 0 < fps < np.inf:
        raise ValueError(f"fps: got {fps}, wanted a finite number > 0")
    paths = sorted(folder.glob("*_keypoints.json")) or sorted(folder.glob("*.json"))
    if not paths:
        raise InputError(f"{folder}: holds no .json files; OpenPose's, one for each frame, are wanted")
    number = _numbers(paths)
    paths = [paths[i] for i in np.argsort(number)]
    number = np.sort(number)
    files = [read_json(path, _File, "OpenPose's file of one frame") for path in paths]
    notes = [note for path in paths for note in leaving(folder, path)]
    body = _stacked(paths, [[person.pose_keypoints_2d for person in file.people] for file in files], None)
    refuse_far(f"{folder}: keypoints", body.values, MOST_PIXELS, "pixels")
    names, said = _names(folder, body, layout)
    values = [body.values]
    for side, lists in (
        ("left", [[person.hand_left_keypoints_2d for person in file.people] for file in files]),
        ("right", [[person.hand_right_keypoints_2d for person in file.people] for file in files]),
    ):
        if any(numbers for one in lists for numbers in one):
            values.append(_stacked(paths, lists, len(HAND_21)).values)
            names = (*names, *(f"{side}_hand_{name}" for name in HAND_21))
    uv, confidence, more = _checked(folder, np.concatenate(values, axis=1), size)
    frame = number[body.file] - number[0]
    first = np.searchsorted(frame, frame)
    return Poses2d(
        time=np.arange(int(number[-1] - number[0]) + 1) / fps,
        frame=frame,
        person=np.arange(frame.size) - first,
        uv=uv,
        confidence=confidence,
        names=names,
        files=tuple(paths),
        warnings=(*notes, *said, *more, *_gaps(folder, number)),
    )


def _numbers(paths: list[Path]) -> Int[np.ndarray, " f"]:
    """Frame number of each file: the last digits of its name."""
    found = [re.findall(r"\d+", re.sub(r"_keypoints$", "", path.stem)) for path in paths]
    for path, digits in zip(paths, found, strict=True):
        if not digits or len(digits[-1]) > 15:
            raise InputError(f"{path}: has no frame number in its name; name_000000000012_keypoints.json is wanted")
    number = np.array([int(digits[-1]) for digits in found])
    same, count = np.unique(number, return_counts=True)
    if (count > 1).any():
        one = same[count.argmax()]
        raise InputError(f"{paths[0].parent}: has {count.max()} files of frame {one}; one recording is wanted")
    if same[-1] - same[0] >= MOST_FRAMES:
        raise InputError(f"{paths[0].parent}: frames {same[0]} to {same[-1]}; at most {MOST_FRAMES} are wanted")
    return number


def _stacked(paths: list[Path], lists: list[list[list[float]]], count: int | None) -> _Rows:
    """Keypoints of all people as one array; who has none at all is all zeros."""
    lengths = sorted({len(numbers) for one in lists for numbers in one if numbers})
    for path, one in zip(paths, lists, strict=True):
        for numbers in one:
            wanted = 3 * count if count is not None else lengths[0] if lengths else 0
            if numbers and (len(numbers) % 3 or len(numbers) != wanted):
                raise InputError(f"{path}: {len(numbers)} numbers of a person's keypoints; {wanted} are wanted")
    k = count if count is not None else lengths[0] // 3 if lengths else 25
    file = np.repeat(np.arange(len(lists)), [len(one) for one in lists])
    rows = [numbers or [0.0] * (3 * k) for one in lists for numbers in one]
    return _Rows(file, np.array(rows, dtype=float).reshape(len(rows), k, 3))


def _names(folder: Path, body: _Rows, layout: Layout) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the body's keypoints, and warnings."""
    k = body.values.shape[1]
    for names in (COCO_18, MPI_15):
        if k == len(names):
            return names, ()
    if k != len(BODY_25):
        raise InputError(f"{folder}: {k} keypoints of a body; 25, 18 or 15 are wanted")
    if layout != "auto":
        return (BODY_25 if layout == "body_25" else BODY_25B), ()
    if _is_body_25(body.values):
        return BODY_25, ()
    return BODY_25B, (f"{folder}: limbs are short in the order of BODY_25B, not BODY_25: read so",)


def _is_body_25(values: Float[np.ndarray, "d 25 3"]) -> bool:
    """Whether limbs are no longer in BODY_25's order than in BODY_25B's."""
    return _mean_limb(values, BODY_25) <= _mean_limb(values, BODY_25B)


def _mean_limb(values: Float[np.ndarray, "d 25 3"], names: tuple[str, ...]) -> float:
    """Mean length of all seen limbs, pixels, if keypoints have these names; 0 if none is seen."""
    ends = [[names.index(f"{side}_{end}") for end in limb] for limb in _LIMBS for side in ("left", "right")]
    a, b = values[:, [i for i, _ in ends]], values[:, [j for _, j in ends]]
    seen = (a[..., 2] > 0) & (b[..., 2] > 0)
    length = np.linalg.norm(a[..., :2] - b[..., :2], axis=-1)
    return float(length[seen].sum() / max(np.count_nonzero(seen), 1))


def _checked(
    folder: Path, values: Float[np.ndarray, "d k 3"], size: tuple[int, int] | None
) -> tuple[Float[np.ndarray, "d k 2"], Float[np.ndarray, "d k"], tuple[str, ...]]:
    """Pixels and confidences of what was detected, and warnings."""
    uv, confidence = values[..., :2], values[..., 2]
    if (confidence < 0).any() or (confidence > 1.05).any():  # sums of maps pass 1 by rounding and interpolation
        worst = float(confidence.min() if (confidence < 0).any() else confidence.max())
        raise InputError(f"{folder}: a confidence of {worst:g} is given; 0 to 1 is wanted")
    seen: Bool[np.ndarray, "d k"] = confidence > 0
    notes = []
    certain = seen & (confidence == 1.0)
    if certain.any():
        notes.append(
            f"{folder}: {np.count_nonzero(certain)} keypoints have a confidence of exactly 1, which no network gives: "
            "they may be made by hand"
        )
    if size is not None:
        off = seen & ((uv < -BORDER) | (uv > np.array(size) - 1.0 + BORDER)).any(axis=-1)
        if off.any():
            notes.append(f"{folder}: {np.count_nonzero(off)} keypoints lie off the image and count as unseen")
        seen &= ~off
    return np.where(seen[..., None], uv, np.nan), np.where(seen, np.minimum(confidence, 1.0), 0.0), tuple(notes)


def _gaps(folder: Path, number: Int[np.ndarray, " f"]) -> tuple[str, ...]:
    missing = int(number[-1] - number[0]) + 1 - number.size
    return (f"{folder}: {missing} frames between the first and the last have no file",) if missing else ()
