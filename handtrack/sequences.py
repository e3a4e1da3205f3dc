"""A folder, video or list of images in; frames, cameras, model, start pose and truth out.

A sequence is a folder with `sequence.yaml` (`format: handtrack/sequence-1`); plain folders of images or video files
become one when model, cameras and start pose are given beside them. Each view has its frames and its camera; frame n of
every view shows the same moment. Pictures are decoded as they are asked for.
"""

from collections.abc import Iterator, Mapping
from collections.abc import Sequence as Several
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Discriminator, Field, Tag

from .camera import Camera
from .errors import InputError
from .formats.cameras import MOST_VIEWS, OneOrMoreCameras, cameras_from_file, read_cameras
from .formats.images import image_paths, matching_paths, open_images_of
from .formats.models import read_model
from .formats.paths import inside
from .formats.poses import start_pose
from .formats.truths import Truth as Truth
from .formats.truths import read_truth
from .formats.videos import SUFFIXES as VIDEO_SUFFIXES
from .formats.videos import open_video
from .formats.views import Frames as Frames
from .formats.views import in_step, view_names
from .formats.yaml_files import Document, Place, Strict, at, read_yaml, shorten, validate
from .kinematics.builtin import model as builtin_model
from .kinematics.builtin import model_names
from .kinematics.tree import Model

Source = Path | str
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
        The sequence file, or the image folder or video of the first view.
    fps : float
        Frames per second.
    cameras : tuple of Camera
        One for each view.
    start : (j,) or None
        Pose of the first frame, radians (model units where a joint slides); None where it has to be found.
    truth : Truth or None
    views : tuple of Frames
        For each view `len(frames)`, `frames.read(i)`, iteration, and `frames.times` in seconds; grey float32 pictures,
        0..255. All views are equally long.
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    path: Path
    fps: float
    cameras: tuple[Camera, ...]
    model: Model
    start: Float[np.ndarray, " j"] | None
    truth: Truth | None
    views: tuple[Frames, ...]
    warnings: tuple[str, ...]

    @property
    def camera(self) -> Camera:
        """Camera of the first view."""
        return self.cameras[0]

    @property
    def frames(self) -> Frames:
        """Frames of the first view."""
        return self.views[0]

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Seconds."""
        return self.views[0].times

    @property
    def names(self) -> tuple[str, ...]:
        """What the views are called, after their files."""
        return view_names(self.views)

    def __len__(self) -> int:
        return len(self.views[0])

    def __iter__(self) -> Iterator[tuple[Float[np.ndarray, "h w"], ...]]:
        """At each moment a picture from every view, decoded in step."""
        return zip(*self.views, strict=True)


class _SequenceFile(Strict):
    format: Literal["handtrack/sequence-1"]
    fps: Annotated[float, Field(gt=0, le=HIGHEST_FPS)]
    frames: Annotated[
        Annotated[str, Tag("text")] | Annotated[list[str], Field(min_length=1, max_length=MOST_VIEWS), Tag("list")],
        Discriminator(lambda value: "list" if isinstance(value, list) else "text"),
    ]
    camera: OneOrMoreCameras
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
    cameras = cameras_from_file(entry.camera, document)
    patterns = entry.frames if isinstance(entry.frames, list) else [entry.frames]
    if len(patterns) != len(cameras):
        raise InputError(
            f"{at(document, ('camera',))} {_count(len(cameras), 'camera')} for {_count(len(patterns), 'view')} in "
            "`frames`; one for each view, in the same order, is wanted"
        )
    used_model = _model_of_file(document, entry.model, notes) if model is None else find_model(model)
    places = [("frames", i) if isinstance(entry.frames, list) else ("frames",) for i in range(len(patterns))]
    opened = [
        _frames_of_file(document, pattern, place, camera, entry.fps, notes)
        for pattern, place, camera in zip(patterns, places, cameras, strict=True)
    ]
    views = _together(opened, cameras, entry.fps, notes)
    pose = None
    if start is not None:
        pose = _pose(used_model, start, notes)
    elif entry.start is not None:
        pose, said = start_pose(used_model, entry.start, lambda joint: at(document, _start_place(joint)))
        notes += said
    truth = None
    if entry.truth is not None:
        truth_path, said = inside(path.parent, entry.truth, at(document, ("truth",)))
        truth, more = read_truth(truth_path, used_model, len(views[0]))
        notes += [*said, *more]
    return Sequence(path, entry.fps, cameras, used_model, pose, truth, views, tuple(notes))


def open_images(
    path: Source | Several[Source],
    model: Path | str | Model,
    camera: Source | Camera | Several[Source | Camera],
    start: Start | None = None,
    fps: float | None = None,
) -> Sequence:
    """A folder of images (all of them, sorted by name) or a video file as a sequence; a list of them for several views.

    Parameters
    ----------
    model : path, built-in name or Model
    camera : path, Camera, or a list of them
        A file `camera: {...}`, or a sequence file whose camera is taken; as many cameras as views, in the same order.
    start : mapping of joint to degrees, or path of a YAML file `start: {...}`, optional
    fps : float, optional
        Frames per second; a video says its own, images beside it have the same, and images alone are taken to have
        25, with a warning.

    Raises
    ------
    InputError
        In one line with what was wanted, for everything that cannot be used.
    """
    paths = [Path(one) for one in ([path] if isinstance(path, Path | str) else path)]
    if fps is not None and not 0 < fps <= HIGHEST_FPS:
        raise InputError(f"fps: {fps} given; a number above 0 is wanted")
    for one in paths:
        _check_source(one)
    cameras = _cameras([camera] if isinstance(camera, Path | str | Camera) else camera)
    if len(paths) != len(cameras):
        raise InputError(
            f"camera: {_count(len(cameras), 'camera')} for {_count(len(paths), 'view')}; "
            "one for each view, in the same order, is wanted"
        )
    used_model = find_model(model)
    notes: list[str] = []
    opened, rate = _open_sources(paths, cameras, fps, notes)
    views = _together(opened, cameras, rate, notes)
    pose = None if start is None else _pose(used_model, start, notes)
    return Sequence(paths[0], rate, cameras, used_model, pose, None, views, tuple(notes))


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


def _frames_of_file(
    document: Document, text: str, where: Place, camera: Camera, fps: float, notes: list[str]
) -> Frames:
    """Video if the name ends like one, images otherwise."""
    folder, place = document.path.parent, at(document, where)
    frames: Frames
    if text.lower().endswith(VIDEO_SUFFIXES):
        path, links = inside(folder, text, place)
        frames, _, said = open_video(path, camera.width, camera.height, fps)
    else:
        paths, links = matching_paths(folder, text, place)
        frames, said = open_images_of(paths, np.arange(len(paths)) / fps, camera.width, camera.height)
    notes += [*links, *said]
    return frames


def _check_source(path: Path) -> None:
    if path.exists():
        return
    number = camera_index(str(path))
    if number is not None:
        raise InputError(
            f"camera {number}: live cameras are not read here; a folder of images or a video file is wanted"
        )
    raise InputError(f"{path}: no such file or folder")


def _open_sources(
    paths: Several[Path], cameras: Several[Camera], fps: float | None, notes: list[str]
) -> tuple[list[Frames], float]:
    """Folders of images and videos, and frames per second: as given, or of the first video, or the usual."""
    opened: dict[int, Frames] = {}
    rate = fps
    for i, path in enumerate(paths):
        if not path.is_dir():
            opened[i], own, said = open_video(path, cameras[i].width, cameras[i].height, fps)
            rate = own if rate is None else rate
            notes += said
    if rate is None:
        rate = USUAL_FPS
        notes.append(f"{paths[0]}: no frame rate is given; {USUAL_FPS:g} per second is used")
    for i, path in enumerate(paths):
        if path.is_dir():
            files = image_paths(path)
            opened[i], said = open_images_of(files, np.arange(len(files)) / rate, cameras[i].width, cameras[i].height)
            notes += said
    return [opened[i] for i in range(len(paths))], rate


def _together(opened: Several[Frames], cameras: Several[Camera], fps: float, notes: list[str]) -> tuple[Frames, ...]:
    """Views in step; with a warning for two cameras at one place, which is more often a slip than meant."""
    for i, camera in enumerate(cameras):
        for j, other in enumerate(cameras[:i]):
            if np.array_equal(camera.R, other.R) and np.array_equal(camera.t, other.t):
                notes.append(f"camera[{i}]: stands where camera[{j}] stands; another place says more of the depth")
    views, said = in_step(opened, fps)
    notes += said
    return views


def _cameras(given: Several[Source | Camera]) -> tuple[Camera, ...]:
    """All cameras, those of a file with several one after the other."""
    lists = [(one,) if isinstance(one, Camera) else read_cameras(one) for one in given]
    return tuple(camera for cameras in lists for camera in cameras)


def _count(count: int, name: str) -> str:
    return f"{count} {name}{'' if count == 1 else 's'}"


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
