"""COCO keypoints in; people in pixels out.

Either results, `[{"image_id": 1, "keypoints": [u, v, c, ... 17 of them], "score": s}, ...]`, or annotations,
`{"images": [{"id": 1, "file_name": ...}], "annotations": [{"image_id": 1, "keypoints": [u, v, flag, ...]}]}`, whose
flags 0 (not labelled), 1 (hidden) and 2 (seen) become confidences 0, 0.5 and 1. Images are a video's frames: by their
order where they are listed; else by the number in `image_id`, which may be a file's name.
"""

import re
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field, RootModel

from ..errors import InputError
from .json_files import Loose, read_json
from .poses2d import COCO_17, MOST_PIXELS, Poses2d, refuse_far
from .skeletons import MOST_FRAMES

SPARSE = 20  # times as many frames as images with people: then the numbers do not count frames
_Keypoints = Annotated[list[float], Field(min_length=51, max_length=51)]


class _Result(Loose):
    image_id: int | str
    keypoints: _Keypoints


class _Image(Loose):
    id: int


class _Annotation(Loose):
    image_id: int
    keypoints: _Keypoints | None = None


class _Labelled(Loose):
    images: list[_Image]
    annotations: list[_Annotation]


class _Content(RootModel[list[_Result] | _Labelled]):
    pass


def read_coco_poses(path: Path | str, fps: float) -> Poses2d:
    """Read results or annotations of COCO's 17 keypoints.

    Raises
    ------
    InputError
        If the file is neither, an annotation's image is not listed, a name holds no number, or a confidence is not
        from 0 to 1.
    """
    path = Path(path)
    if not 0 < fps < np.inf:
        raise ValueError(f"fps: got {fps}, wanted a finite number > 0")
    content = read_json(path, _Content, "COCO's keypoint results or annotations").root
    notes: tuple[str, ...] = ()
    if isinstance(content, _Labelled):
        place = {image.id: i for i, image in enumerate(content.images)}
        rows = [(one.image_id, one.keypoints) for one in content.annotations if one.keypoints is not None]
        absent = next((image for image, _ in rows if image not in place), None)
        if absent is not None:
            raise InputError(f"{path}: annotations: image {absent} is not among the images; their ids are wanted")
        frame = np.array([place[image] for image, _ in rows], dtype=int)
        count = len(content.images)
        values = _values([keypoints for _, keypoints in rows])
        values[..., 2] = np.array([0.0, 0.5, 1.0])[np.clip(values[..., 2], 0, 2).astype(int)]
    else:
        frame, notes = _frames(path, [one.image_id for one in content])
        count = int(frame.max(initial=-1)) + 1
        values = _values([one.keypoints for one in content])
    confidence = values[..., 2]
    if (confidence < 0).any() or (confidence > 1.0).any():
        worst = float(confidence.min() if (confidence < 0).any() else confidence.max())
        raise InputError(f"{path}: a confidence of {worst:g} is given; 0 to 1 is wanted")
    refuse_far(f"{path}: keypoints", values, MOST_PIXELS, "pixels")
    by = np.argsort(frame, kind="stable")
    frame, values = frame[by], values[by]
    seen = values[..., 2] > 0
    return Poses2d(
        time=np.arange(count) / fps,
        frame=frame,
        person=np.arange(frame.size) - np.searchsorted(frame, frame),
        uv=np.where(seen[..., None], values[..., :2], np.nan),
        confidence=np.where(seen, values[..., 2], 0.0),
        names=COCO_17,
        files=(path,),
        warnings=notes,
    )


def _values(rows: list[list[float]]) -> Float[np.ndarray, "d 17 3"]:
    return np.array(rows, dtype=float).reshape(len(rows), 17, 3)


def _frames(path: Path, ids: list[int | str]) -> tuple[Int[np.ndarray, " d"], tuple[str, ...]]:
    """Frame of each result from the number of its image."""
    found = [str(one) if isinstance(one, int) else (re.findall(r"\d+", Path(one).stem) or [""])[-1] for one in ids]
    bad = next((one for one, text in zip(ids, found, strict=True) if not text or len(text) > 15), None)
    if bad is not None:
        raise InputError(f"{path}: image_id {str(bad)[:60]!r} holds no number of a frame")
    number = np.array([int(text) for text in found], dtype=int)
    if not number.size:
        return number, ()
    known, rank = np.unique(number, return_inverse=True)
    if known[-1] - known[0] > SPARSE * known.size or known[-1] - known[0] >= MOST_FRAMES:
        return rank, (f"{path}: its image ids are too far apart to count frames; taken as one frame after the other",)
    return number - known[0], ()
