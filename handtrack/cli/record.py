"""A finished track in, the run folder out; a run folder in, what is needed to evaluate it out.

poses.csv, covariance.csv    what was found (see `handtrack.formats`)
model.yaml, camera.yaml      what the poses mean
truth.csv                    a copy of the truth, where the sequence has one
run.json                     settings, versions, checksums of the input, timings
overlay.mp4, report.html     what to look at
"""

import hashlib
import json
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ..camera import Camera
from ..errors import InputError
from ..formats.cameras import read_camera
from ..formats.images import ImageFiles
from ..formats.model_writing import model_text, write_model
from ..formats.models import read_model
from ..formats.tracks import read_track, write_track
from ..formats.truths import read_truth
from ..formats.writing import folder_written_whole, write_text
from ..kinematics import Model
from ..report import RunInfo, write_overlay, write_report
from ..sequences import Sequence, Truth
from ..settings import Settings
from ..track import Track
from .console import version_of
from .texts import camera_text, degrees, truth_text

RUN_FILE, FORMAT = "run.json", "handtrack/run-1"
_PACKAGES = ("handtrack", "numpy", "scipy", "opencv-python-headless", "scikit-image", "shapely", "numba")
_BLOCK = 2**20


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A run folder, read back together with the truth to hold against it."""

    track: Track
    model: Model
    camera: Camera
    truth: Truth


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


def write_run(folder: Path, track: Track, sequence: Sequence, settings: Settings, seconds: float) -> None:
    """Write every file of a run; `seconds` is what tracking took, image reading included."""
    write_track(folder, track, sequence.model)
    write_model(folder / "model.yaml", sequence.model)
    write_text(folder / "camera.yaml", camera_text(sequence.camera))
    if sequence.truth is not None:
        write_text(folder / "truth.csv", truth_text(sequence.truth, sequence.model))
    versions, inputs = _versions(), checksums(sequence)
    video = folder / "overlay.mp4"
    write_overlay(video, sequence.frames, track, sequence.model, sequence.camera, sequence.fps)
    info = RunInfo(
        title=title(sequence.path),
        fps=sequence.fps,
        settings=tuple((name, str(value)) for name, value in asdict(settings).items()),
        versions=versions,
        inputs=tuple((name, digest[:16]) for name, digest in inputs),
        warnings=sequence.warnings,
    )
    write_report(folder / "report.html", track, sequence.model, sequence.camera, video, sequence.truth, info)
    record = {
        "format": FORMAT,
        "sequence": info.title,
        "frames": int(track.frame.size),
        "fps": sequence.fps,
        "start": {} if sequence.start is None else degrees(sequence.model, sequence.start),
        "settings": asdict(settings),
        "versions": dict(versions),
        "inputs": dict(inputs),
        "warnings": list(sequence.warnings),
        "status": {name: int(np.sum(track.status == name)) for name in ("tracked", "uncertain", "lost")},
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
    camera = read_camera(folder / "camera.yaml")
    known, _ = read_truth(table, model)
    return Run(read_track(folder, model), model, camera, known)


def title(path: Path) -> str:
    """What a sequence is called: its folder, or the name of its video.

    >>> title(Path("clips/pinch/sequence.yaml")), title(Path("clips/pinch.mp4"))
    ('pinch', 'pinch.mp4')
    """
    return path.absolute().parent.name if path.name == "sequence.yaml" else path.absolute().name


def checksums(sequence: Sequence) -> tuple[tuple[str, str], ...]:
    """Name and SHA-256 of the files the run was made from; the images count as one, in their order."""
    images = sequence.frames.paths if isinstance(sequence.frames, ImageFiles) else (sequence.frames.path,)
    found = [("frames", _digest(images))]
    if sequence.path.name == "sequence.yaml":
        found.append((sequence.path.name, _digest((sequence.path,))))
    model = hashlib.sha256(model_text(sequence.model).encode()).hexdigest()
    return (*found, ("model", model))


def _versions() -> tuple[tuple[str, str], ...]:
    return (("python", platform.python_version()), *((name, version_of(name)) for name in _PACKAGES))


def _digest(paths: tuple[Path, ...]) -> str:
    total = hashlib.sha256()
    for path in paths:
        with path.open("rb") as stream:
            while block := stream.read(_BLOCK):
                total.update(block)
    return total.hexdigest()
