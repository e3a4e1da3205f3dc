"""A finished track in, the run folder out; a run folder in, what is needed to evaluate it out.

poses.csv, covariance.csv    what was found (see `handtrack.formats`)
information.csv, evidence.csv what they rest on
rivals.csv                   other poses that the images could not tell from them
widths.csv                   how wide each link is
model.yaml, camera.yaml      what the poses mean; a list of cameras where there are several views
truth.csv                    a copy of the truth, where the sequence has one
run.json                     settings, versions, cameras, checksums of the input, what the images left open, timings
overlay.mp4, report.html     what to look at
"""

import hashlib
import json
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ..ambiguity import ambiguity
from ..ambiguity import as_data as folds_as_data
from ..camera import Camera
from ..errors import InputError
from ..formats.cameras import camera_entries, read_cameras
from ..formats.images import ImageFiles
from ..formats.model_writing import model_text, write_model
from ..formats.models import read_model
from ..formats.tracks import read_track, write_track
from ..formats.truths import read_truth
from ..formats.widths import write_widths
from ..formats.writing import folder_written_whole, write_text
from ..kinematics import Model
from ..observability import observability
from ..observability_words import as_data
from ..report import RunInfo, write_overlay, write_report
from ..sequences import NAME, Frames, Sequence, Truth
from ..settings import Settings
from ..track import Track
from .bound_frames import few_bounds
from .console import version_of
from .skinned import Skinned
from .texts import camera_text, degrees, truth_text

RUN_FILE, FORMAT = "run.json", "handtrack/run-1"
_PACKAGES = ("handtrack", "numpy", "scipy", "opencv-python-headless", "scikit-image", "shapely", "numba")
_BLOCK = 2**20


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A run folder, read back together with the truth to hold against it."""

    track: Track
    model: Model
    cameras: tuple[Camera, ...]
    truth: Truth

    @property
    def camera(self) -> Camera:
        """Camera of the first view."""
        return self.cameras[0]


@contextmanager
def whole_folder(out: Path, marker: str, kind: str) -> Iterator[Path]:
    """Folder to write into; it becomes `out` when the block ends well, and vanishes when it does not.

    Parameters
    ----------
    marker, kind : str
        File that every earlier folder of this kind holds, and what it is called; such a folder is replaced.

    Raises
    ------
    InputError
        If `out` is a file, or a folder that is neither empty nor of this kind.
    """
    if out.is_dir() and any(out.iterdir()) and not (out / marker).is_file():
        raise InputError(f"--out: {out} holds other files; a new or empty folder, or an earlier {kind}, was wanted")
    blocked = next((place for place in (out, *out.parents) if place.exists() and not place.is_dir()), None)
    if blocked is not None:
        raise InputError(f"--out: {blocked} is a file; a folder was wanted")
    missing = [place for place in out.absolute().parents if not place.exists()]
    try:
        with folder_written_whole(out.absolute(), replace=True) as folder:
            yield folder
    except BaseException:
        for place in missing:
            if place.is_dir() and not any(place.iterdir()):
                place.rmdir()
        raise


def write_run(
    folder: Path,
    track: Track,
    sequence: Sequence,
    settings: Settings,
    seconds: float,
    skinned: Skinned | None = None,
    calibrated_on: int | None = None,
) -> None:
    """Write every file of a run; `seconds` is what tracking took, image reading included.

    `calibrated_on` is the number of first frames that the sequence's model was calibrated on for this run.
    """
    write_track(folder, track, sequence.model)
    if track.width is not None:  # those of pills; a skin has no single one
        write_widths(folder / "widths.csv", track, sequence.model)
    write_model(folder / "model.yaml", sequence.model)
    write_text(folder / "camera.yaml", camera_text(sequence.cameras))
    if sequence.truth is not None:
        write_text(folder / "truth.csv", truth_text(sequence.truth, sequence.model))
    versions, inputs = _versions(), checksums(sequence)
    if skinned is not None:
        inputs = (*inputs, ("surface", skinned.digest))
    video = folder / "overlay.mp4"
    write_overlay(video, sequence, track, sequence.model, sequence.cameras, sequence.fps, skinned and skinned.surface)
    info = RunInfo(
        title=title(sequence),
        fps=sequence.fps,
        settings=tuple((name, str(value)) for name, value in asdict(settings).items()),
        versions=versions,
        inputs=tuple((name, digest[:16]) for name, digest in inputs),
        warnings=sequence.warnings,
        views=sequence.names,
    )
    least = few_bounds(sequence, track)
    write_report(folder / "report.html", track, sequence.model, sequence.cameras, video, sequence.truth, info, least)
    record = {
        "format": FORMAT,
        "sequence": info.title,
        "frames": int(track.frame.size),
        "fps": sequence.fps,
        "start": {} if sequence.start is None else degrees(sequence.model, sequence.start),
        "settings": asdict(settings),
        **({} if skinned is None else {"surface": skinned.as_data()}),
        **({} if calibrated_on is None else {"calibrated_on": calibrated_on}),
        "versions": dict(versions),
        "views": [
            {"name": name, "camera": dict(camera_entries(camera))}
            for name, camera in zip(sequence.names, sequence.cameras, strict=True)
        ],
        "input": [os.path.relpath(path, folder) for path in sources(sequence)],
        "inputs": dict(inputs),
        "warnings": list(sequence.warnings),
        "status": {name: int(np.sum(track.status == name)) for name in ("tracked", "uncertain", "lost")},
        "observability": {
            **as_data(observability(track, sequence.model)),
            "folds": folds_as_data(ambiguity(track, sequence.model)),
        },
        "timings": {
            "tracking_seconds": round(seconds, 3),
            "first_frame_ms": round(1000.0 * float(track.seconds[0]), 3),
            "median_frame_ms": round(1000.0 * float(np.median(track.seconds)), 3),
        },
    }
    write_text(folder / RUN_FILE, json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def open_run(folder: Path, truth: Path | None) -> Run:
    """Read a run folder; the truth is the file given, or the run's own copy.

    Raises
    ------
    InputError
        If the folder is no run, one of its files is bad, or there is no truth.
    """
    if not (folder / RUN_FILE).is_file():
        raise InputError(f"{folder}: has no {RUN_FILE}; a folder written by `handtrack track` was wanted")
    table = folder / "truth.csv" if truth is None else truth
    if truth is None and not table.is_file():
        raise InputError(f"{folder}: the sequence had no truth; give a table with --truth")
    model = read_model(folder / "model.yaml")
    cameras = read_cameras(folder / "camera.yaml")
    known, _ = read_truth(table, model)
    return Run(read_track(folder, model), model, cameras, known)


def title(sequence: Sequence) -> str:
    """What a sequence is called: its folder, or the names of its videos."""
    if sequence.path.name == NAME:
        return sequence.path.absolute().parent.name
    return sequence.path.absolute().name if len(sequence.views) == 1 else ", ".join(sequence.names)


def sources(sequence: Sequence) -> tuple[Path, ...]:
    """The sequence file; or the image folder or video of each view."""
    if sequence.path.name == NAME or len(sequence.views) == 1:
        return (sequence.path,)
    return tuple(view.paths[0].parent if isinstance(view, ImageFiles) else view.path for view in sequence.views)


def checksums(sequence: Sequence) -> tuple[tuple[str, str], ...]:
    """Name and SHA-256 of the files the run was made from; the images of a view count as one, in their order."""
    several = len(sequence.views) > 1
    found = [(f"frames[{i}]" if several else "frames", _digest(_files(view))) for i, view in enumerate(sequence.views)]
    if sequence.path.name == NAME:
        found.append((sequence.path.name, _digest((sequence.path,))))
    model = hashlib.sha256(model_text(sequence.model).encode()).hexdigest()
    return (*found, ("model", model))


def _files(view: Frames) -> tuple[Path, ...]:
    return view.paths if isinstance(view, ImageFiles) else (view.path,)


def _versions() -> tuple[tuple[str, str], ...]:
    return (("python", platform.python_version()), *((name, version_of(name)) for name in _PACKAGES))


def _digest(paths: tuple[Path, ...]) -> str:
    total = hashlib.sha256()
    for path in paths:
        with path.open("rb") as stream:
            while block := stream.read(_BLOCK):
                total.update(block)
    return total.hexdigest()
