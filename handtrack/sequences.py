"""A folder, video or list of images in; frames, camera, model, start pose and truth out.

A sequence is a folder with `sequence.yaml` (`format: handtrack/sequence-1`); a plain folder of images or a video file
becomes one when model, camera and start pose are given beside it. Pictures are decoded as they are asked for.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Discriminator, Field, Tag

from .camera import Camera
from .errors import InputError
from .formats.cameras import CameraFile, camera_from_file, read_camera
from .formats.images import ImageFiles, image_paths, matching_paths, open_images_of
from .formats.models import read_model
from .formats.paths import inside
from .formats.poses import start_pose
from .formats.truths import Truth as Truth
from .formats.truths import read_truth
from .formats.videos import SUFFIXES as VIDEO_SUFFIXES
from .formats.videos import VideoFile, open_video
from .formats.yaml_files import Document, Place, Strict, at, read_yaml, shorten, validate
from .kinematics.builtin import model as builtin_model
from .kinematics.builtin import model_names
from .kinematics.tree import Model

Frames = ImageFiles | VideoFile
Start = Mapping[str, float] | str | Path
NAME = "sequence.yaml"
USUAL_FPS = 25.0
HIGHEST_FPS = 1e5


@dataclass(frozen=True, slots=True, eq=False)
class Sequence:
    """Everything that tracking needs.

    Attributes
    ----------
    path : Path
        The sequence file, image folder or video.
    fps : float
        Frames per second.
    start : (j,) or None
        Pose of the first frame, radians (model units where a joint slides); None where it has to be found.
    truth : Truth or None
    frames : Frames
        `len(frames)`, `frames.read(i)`, iteration, and `frames.times` in seconds; grey float32 pictures, 0..255.
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    path: Path
    fps: float
    camera: Camera
    model: Model
    start: Float[np.ndarray, " j"] | None
    truth: Truth | None
    frames: Frames
    warnings: tuple[str, ...]


class _SequenceFile(Strict):
    format: Literal["handtrack/sequence-1"]
    fps: Annotated[float, Field(gt=0, le=HIGHEST_FPS)]
    frames: Annotated[
        Annotated[str, Tag("text")] | Annotated[list[str], Tag("list")],
        Discriminator(lambda value: "list" if isinstance(value, list) else "text"),
    ]
    camera: Annotated[
        Annotated[CameraFile, Tag("one")] | Annotated[list[CameraFile], Tag("list")],
        Discriminator(lambda value: "list" if isinstance(value, list) else "one"),
    ]
    model: str
    start: dict[str, float] | None = None
    truth: str | None = None


class _StartFile(Strict):
    start: dict[str, float]


def open_sequence(path: Path | str, model: Path | str | Model | None = None, start: Start | None = None) -> Sequence:
    """Open a sequence folder, or its `sequence.yaml`.

    Parameters
    ----------
    model : path, built-in name or Model, optional
        Used instead of the file's.
    start : mapping of joint to degrees, or path of a YAML file `start: {...}`, optional
        Used instead of the file's.

    Raises
    ------
    InputError
        In one line with file, line, place and what was wanted, for everything that cannot be used.
    """
    path = Path(path)
    if path.is_dir():
        if not (path / NAME).exists():
            raise InputError(
                f"{path}: has no {NAME}; a sequence folder is wanted, or model, camera and start beside the images"
            )
        path = path / NAME
    document = read_yaml(path)
    entry = validate(document, _SequenceFile)
    notes: list[str] = []
    if isinstance(entry.camera, list) or isinstance(entry.frames, list):
        raise InputError(f"{at(document, ('frames',))} several views are given; one is wanted here")
    camera = camera_from_file(entry.camera, document, ("camera",))
    used_model = _model_of_file(document, entry.model, notes) if model is None else find_model(model)
    frames = _frames_of_file(document, entry.frames, camera, entry.fps, notes)
    pose = None
    if start is not None:
        pose = _pose(used_model, start, notes)
    elif entry.start is not None:
        pose, said = start_pose(used_model, entry.start, lambda joint: at(document, _start_place(joint)))
        notes += said
    truth = None
    if entry.truth is not None:
        truth_path, said = inside(path.parent, entry.truth, at(document, ("truth",)))
        truth, more = read_truth(truth_path, used_model, len(frames))
        notes += [*said, *more]
    return Sequence(path, entry.fps, camera, used_model, pose, truth, frames, tuple(notes))


def open_images(
    path: Path | str,
    model: Path | str | Model,
    camera: Path | str | Camera,
    start: Start | None = None,
    fps: float | None = None,
) -> Sequence:
    """A folder of images (all of them, sorted by name) or a video file as a sequence.

    Parameters
    ----------
    model : path, built-in name or Model
    camera : path or Camera
        A file `camera: {...}`, or a sequence file whose camera is taken.
    start : mapping of joint to degrees, or path of a YAML file `start: {...}`, optional
    fps : float, optional
        Frames per second; a video says its own, images are taken to have 25, with a warning.

    Raises
    ------
    InputError
        In one line with what was wanted, for everything that cannot be used.
    """
    path = Path(path)
    if fps is not None and not 0 < fps <= HIGHEST_FPS:
        raise InputError(f"fps: {fps} given; a number above 0 is wanted")
    if not path.exists():
        number = camera_index(str(path))
        if number is not None:
            raise InputError(
                f"camera {number}: live cameras are not read here; a folder of images or a video file is wanted"
            )
        raise InputError(f"{path}: no such file or folder")
    used_camera = camera if isinstance(camera, Camera) else read_camera(Path(camera))
    used_model = find_model(model)
    notes: list[str] = []
    frames: Frames
    if path.is_dir():
        paths = image_paths(path)
        if fps is None:
            fps = USUAL_FPS
            notes.append(f"{path}: no frame rate is given; {USUAL_FPS:g} per second is used")
        times = np.arange(len(paths)) / fps
        frames, said = open_images_of(paths, times, used_camera.width, used_camera.height)
    else:
        frames, fps, said = open_video(path, used_camera.width, used_camera.height, fps)
    notes += said
    pose = None if start is None else _pose(used_model, start, notes)
    return Sequence(path, fps, used_camera, used_model, pose, None, frames, tuple(notes))


def camera_index(source: str) -> int | None:
    """The number of a live camera if the text is one (`0`, `1`, ...), else None.

    >>> camera_index("0"), camera_index("clip.mp4")
    (0, None)
    """
    return int(source) if source.isascii() and source.isdigit() and len(source) < 4 else None


def find_model(model: Path | str | Model) -> Model:
    """A model as it is, the built-in one of that name, or the one in that file.

    Raises
    ------
    InputError
        If there is neither a built-in model of that name nor such a file, or the file is bad.
    """
    if isinstance(model, Model):
        return model
    if str(model) in model_names():
        return builtin_model(str(model))
    if not Path(model).exists():
        raise InputError(f"{model}: no such model file, and no built-in model; built in are {', '.join(model_names())}")
    return read_model(Path(model))


def _model_of_file(document: Document, text: str, notes: list[str]) -> Model:
    if text in model_names():
        return builtin_model(text)
    place = at(document, ("model",))
    path, said = inside(document.path.parent, text, place)
    if not path.exists():
        raise InputError(
            f"{place} {shorten(text)}: no such file, and no built-in model; built in are {', '.join(model_names())}"
        )
    notes += said
    return read_model(path)


def _frames_of_file(document: Document, text: str, camera: Camera, fps: float, notes: list[str]) -> Frames:
    """Video if the name ends like one, images otherwise."""
    folder, place = document.path.parent, at(document, ("frames",))
    frames: Frames
    if text.lower().endswith(VIDEO_SUFFIXES):
        path, links = inside(folder, text, place)
        frames, _, said = open_video(path, camera.width, camera.height, fps)
    else:
        paths, links = matching_paths(folder, text, place)
        frames, said = open_images_of(paths, np.arange(len(paths)) / fps, camera.width, camera.height)
    notes += [*links, *said]
    return frames


def _start_place(joint: str) -> Place:
    return ("start", joint) if joint else ("start",)


def _pose(model: Model, start: Start, notes: list[str]) -> Float[np.ndarray, " j"]:
    """Start pose from the caller's mapping or file."""
    if isinstance(start, str | Path):
        document = read_yaml(Path(start))
        given: Mapping[str, float] = validate(document, _StartFile).start
        pose, said = start_pose(model, given, lambda joint: at(document, _start_place(joint)))
    else:
        pose, said = start_pose(model, start, lambda joint: f"start: {joint}:" if joint else "start:")
    notes += said
    return pose
