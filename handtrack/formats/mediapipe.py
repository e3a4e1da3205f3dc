"""MediaPipe's pose landmarks in; people in pixels, and in metres about their hips, out.

A list of frames, or an object with the list under `frames`; each frame is a result as MediaPipe's tasks give it:

    {"timestamp_ms": 40, "pose_landmarks": [[{"x": 0.5, "y": 0.4, "z": 0, "visibility": 0.9}, ... 33], ... people],
     "pose_world_landmarks": [[{"x": 0.1, "y": -0.2, "z": 0.05, "visibility": 0.9}, ... 33], ...]}

in these words or in JavaScript's (`landmarks`, `worldLandmarks`, `timestamp`). A frame of one person may leave out the
outer list, as the older solution did. Image coordinates are shares of width and height, world coordinates metres from
the middle of the hips along the camera's axes. `visibility` is the confidence.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from pydantic import AliasChoices, Field, RootModel

from ..errors import InputError
from .json_files import Loose, read_json
from .poses2d import MEDIAPIPE_33, Poses2d, refuse_far
from .skeletons import FARTHEST

MOST_SHARES = 1000.0  # widths of the image that a landmark may be off it


class _Landmark(Loose):
    x: float
    y: float
    z: float = 0.0
    visibility: Annotated[float, Field(ge=0, le=1)] = 1.0


_Body = Annotated[list[_Landmark], Field(min_length=33, max_length=33)]
_Bodies = list[_Body] | _Body | None


class _Result(Loose):
    landmarks: _Bodies = Field(
        default=None, validation_alias=AliasChoices("pose_landmarks", "poseLandmarks", "landmarks")
    )
    world: _Bodies = Field(
        default=None, validation_alias=AliasChoices("pose_world_landmarks", "poseWorldLandmarks", "worldLandmarks")
    )
    milliseconds: float | None = Field(
        default=None, validation_alias=AliasChoices("timestamp_ms", "timestampMs", "timestamp")
    )


class _Frames(Loose):
    frames: list[_Result]


class _Content(RootModel[list[_Result] | _Frames]):
    pass


def read_mediapipe(path: Path | str, fps: float, size: tuple[int, int]) -> Poses2d:
    """Read pose landmarks of a video.

    Parameters
    ----------
    fps : float
        Frames a second, for frames without a time.
    size : (width, height)
        Of the image, pixels.

    Raises
    ------
    InputError
        If the file is no such list, image and world landmarks are of different people, or times do not rise.
    """
    path = Path(path)
    if not 0 < fps < np.inf:
        raise ValueError(f"fps: got {fps}, wanted a finite number > 0")
    content = read_json(path, _Content, "a list of MediaPipe's pose results").root
    results = content.frames if isinstance(content, _Frames) else content
    images = [_people(result.landmarks) for result in results]
    worlds = [_people(result.world) for result in results]
    for i, (image, world) in enumerate(zip(images, worlds, strict=True)):
        if world and len(world) != len(image):
            raise InputError(f"{path}: frame {i}: {len(image)} people in the image and {len(world)} in the world")
    frame = np.repeat(np.arange(len(results)), [len(image) for image in images])
    shares = _values([body for image in images for body in image])
    refuse_far(f"{path}: landmarks", shares, MOST_SHARES, "shares of the image")
    confidence = shares[..., 3]
    seen = confidence > 0
    # shares count from the image's edge, pixels from the centre of the first one
    uv = shares[..., :2] * np.array(size) - 0.5
    world = None
    if any(worlds):
        bodies = [body for some, image in zip(worlds, images, strict=True) for body in (some or [None] * len(image))]
        world = np.where(seen[..., None], _values(bodies)[..., :3], np.nan)
        refuse_far(f"{path}: world landmarks", np.nan_to_num(world), FARTHEST, "metres")
    return Poses2d(
        time=_times(path, results, fps),
        frame=frame,
        person=np.arange(frame.size) - np.searchsorted(frame, frame),
        uv=np.where(seen[..., None], uv, np.nan),
        confidence=confidence,
        names=MEDIAPIPE_33,
        world=world,
        files=(path,),
    )


def _people(bodies: _Bodies) -> list[list[_Landmark]]:
    """People of one frame; the older solution gives one without a list around it."""
    if not bodies:
        return []
    people = [body for body in bodies if isinstance(body, list)]
    return people or [[one for one in bodies if isinstance(one, _Landmark)]]


def _values(bodies: list[list[_Landmark]] | list[list[_Landmark] | None]) -> Float[np.ndarray, "d 33 4"]:
    rows = [
        [[np.nan] * 4] * 33 if body is None else [(one.x, one.y, one.z, one.visibility) for one in body]
        for body in bodies
    ]
    return np.array(rows, dtype=float).reshape(len(rows), len(MEDIAPIPE_33), 4)


def _times(path: Path, results: list[_Result], fps: float) -> Float[np.ndarray, " f"]:
    """Seconds of the frames: those given if all are, else by number."""
    given = [result.milliseconds for result in results if result.milliseconds is not None]
    number: Int[np.ndarray, " f"] = np.arange(len(results))
    if len(given) < len(results):
        return number / fps
    time = 0.001 * np.array(given)
    late = np.flatnonzero(np.diff(time) <= 0)
    if late.size:
        raise InputError(f"{path}: frame {late[0] + 1}: its time is not after the one before; rising times are wanted")
    return time
