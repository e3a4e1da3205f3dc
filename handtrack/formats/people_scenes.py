"""A folder with `scene.yaml` (`format: handtrack/skeletons-1`) in, people as a pose network saw them out; and back.

format: handtrack/skeletons-1
fps: 30
camera: {type: perspective, ...}    # R = I and t = 0: everything is in camera axes
skeletons: skeletons.csv            # optional, this name without it
truth: truth.csv                    # optional; a file of this name is taken without it
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..camera import Camera
from ..errors import InputError
from .cameras import PerspectiveFile, camera_from_file, cameras_text
from .paths import inside
from .rgbd import HIGHEST_FPS, NAME
from .skeletons import Detections, TruthPoints, read_skeletons, read_truth, skeletons_text, truth_text
from .writing import folder_written_whole
from .yaml_files import Document, Strict, at, read_yaml, validate

FORMAT = "handtrack/skeletons-1"
SKELETONS, TRUTH = "skeletons.csv", "truth.csv"


@dataclass(frozen=True, slots=True, eq=False)
class PeopleScene:
    """Skeletons of people, and the camera that saw them.

    Attributes
    ----------
    path : Path
        The scene file.
    fps : float
        Frames per second.
    camera : Camera or None
        Perspective, R = I and t = 0; None where the file does not say.
    detections : Detections
        For as many frames as skeletons or truth name, whichever are more.
    truth : TruthPoints or None
        For the same frames.
    files : tuple of Path
        All that was read.
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    path: Path
    fps: float
    camera: Camera | None
    detections: Detections
    truth: TruthPoints | None
    files: tuple[Path, ...]
    warnings: tuple[str, ...] = ()


class _SceneFile(Strict):
    format: Literal["handtrack/skeletons-1"]
    fps: Annotated[float, Field(gt=0, le=HIGHEST_FPS)]
    camera: Annotated[PerspectiveFile, Field()] | None = None
    skeletons: str | None = None
    truth: str | None = None


def read_people_scene(folder: Path | str) -> PeopleScene:
    """Open a scene folder, or its `scene.yaml`.

    Raises
    ------
    InputError
        In one line with file, place and what was wanted: for a scene file that is not one, a camera that is not at the
        origin, and tables that are missing or malformed.
    """
    path = Path(folder)
    path = path / NAME if path.is_dir() else path
    document = read_yaml(path)
    entry = validate(document, _SceneFile)
    camera = None if entry.camera is None else camera_from_file(entry.camera, document, ("camera",))
    if camera is not None and not (np.array_equal(camera.R, np.eye(3)) and not camera.t.any()):
        raise InputError(f"{at(document, ('camera',))} is not at the origin; R = I and t = 0 are wanted: camera axes")
    notes: list[str] = []
    skeletons = _table(document, "skeletons", entry.skeletons, SKELETONS, notes)
    if skeletons is None:
        raise InputError(f"{path.parent / SKELETONS}: no such file; the skeletons of the scene are wanted")
    detections = read_skeletons(skeletons, None, entry.fps)
    where = _table(document, "truth", entry.truth, TRUTH, notes)
    truth = None if where is None else read_truth(where)
    if where is not None and truth is not None and truth.p.shape[0] < detections.time.size:
        truth = read_truth(where, detections.time.size)
    elif truth is not None and truth.p.shape[0] > detections.time.size:  # at the end nobody was seen
        detections = read_skeletons(skeletons, truth.p.shape[0], entry.fps)
    notes += [*detections.warnings, *(truth.warnings if truth is not None else ())]
    files = (path, skeletons) if where is None else (path, skeletons, where)
    return PeopleScene(path, entry.fps, camera, detections, truth, files, tuple(notes))


def _table(document: Document, key: str, text: str | None, usual: str, notes: list[str]) -> Path | None:
    """A table that the scene names, or the one of the usual name; None where there is none."""
    folder = document.path.parent
    if text is None:
        return folder / usual if (folder / usual).is_file() else None
    place = at(document, (key,))
    path, said = inside(folder, text, place)
    if not path.is_file():
        raise InputError(f"{place} {text!r} is no file in {folder}; a file is wanted")
    notes += said
    return path


def write_people_scene(
    folder: Path | str,
    fps: float,
    camera: Camera | None,
    detections: Detections,
    truth: TruthPoints | None = None,
    replace: bool = False,
) -> None:
    """Write a scene folder, whole or not at all.

    Parameters
    ----------
    replace : bool
        Whether a folder that is already there gives way.

    Raises
    ------
    InputError
        If `folder` is a file, or not empty and `replace` is false.
    """
    with folder_written_whole(Path(folder), replace) as partial:
        keys = [f"format: {FORMAT}\n", f"fps: {float(fps)}\n"]
        keys += [cameras_text([camera])] if camera is not None else []
        (partial / SKELETONS).write_text(skeletons_text(detections), encoding="utf-8")
        keys.append(f"skeletons: {SKELETONS}\n")
        if truth is not None:
            (partial / TRUTH).write_text(truth_text(truth), encoding="utf-8")
            keys.append(f"truth: {TRUTH}\n")
        (partial / NAME).write_text("".join(keys), encoding="utf-8")
