"""A walk and choices in, the folder of a run out: the work of `handtrack body walk` and `body simulate-walk`.

walk.csv, posture.csv, keypoints.csv   where the person was, and how (see `handtrack.formats.walk_tracks`)
run.json                               settings, versions, checksums of the input, figures, timings
report.html                            what to look at
"""

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ..body.suit_body import body_of_walk
from ..body.walk_run import follow_walk
from ..body.walk_settings import Settings
from ..errors import InputError
from ..formats.walk_tracks import NAMES, WalkTrack, write_walk_track
from ..formats.walks import NAME, Walk
from ..formats.writing import write_text
from ..report.walk import WalkShown, write_walk_report
from ..report.walk_facts import WalkFacts, walk_facts
from .console import note, version_of
from .record import RUN_FILE, whole_folder

FORMAT = "handtrack/walk-run-1"
_PACKAGES = ("handtrack", "numpy", "scipy", "numba", "opencv-python-headless")
_READ = (NAME, "segments.csv", "keypoints2d.csv", "truth.csv", "truth_keypoints.csv")


@dataclass(frozen=True, slots=True, eq=False)
class Done:
    """A finished run, the suit alone, and what both can be held against."""

    walk: Walk
    settings: Settings
    seed: int
    track: WalkTrack
    raw: WalkTrack
    facts: WalkFacts

    @property
    def milliseconds(self) -> float:
        """Median time of a frame."""
        return 1e3 * float(np.median(self.track.seconds))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of the input, then of the run."""
        return (*self.walk.warnings, *(line for line in self.track.warnings if line not in self.walk.warnings))


def follow_into(out: Path, walk: Walk, settings: Settings, seed: int) -> Done:
    """Follow a person through a walk and write the run folder, whole or not at all."""
    with whole_folder(out, NAMES[0], "run") as folder:
        note(f"following a person through {walk.frame.size} frames, method {settings.method}")
        body = body_of_walk(walk)
        track = follow_walk(walk, body, settings, seed)
        raw = track if settings.method == "suit" else follow_walk(walk, body, replace(settings, method="suit"), seed)
        done = Done(walk, settings, seed, track, raw, walk_facts(track, raw, walk.truth))
        note("writing report")
        write_walk_track(folder, track)
        record = _record(folder, done)
        write_text(folder / RUN_FILE, json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n")
        write_walk_report(folder / "report.html", _shown(done))
    return done


def _shown(done: Done) -> WalkShown:
    walk = done.walk
    return WalkShown(
        title=walk.path.resolve().parent.name,
        method=done.settings.method,
        track=done.track,
        facts=done.facts,
        raw=None if done.settings.method == "suit" else done.raw,
        truth=walk.truth,
        walk=walk,
        milliseconds=done.milliseconds,
        settings=(("seed", str(done.seed)), *((name, str(value)) for name, value in asdict(done.settings).items())),
        versions=tuple(_versions().items()),
        inputs=tuple((name, digest[:16]) for name, digest in checksums(walk).items()),
        warnings=done.warnings,
    )


def _record(folder: Path, done: Done) -> dict[str, object]:
    """Content of `run.json`."""
    walk, track = done.walk, done.track
    return {
        "format": FORMAT,
        "walk": walk.path.resolve().parent.name,
        "frames": int(track.frame.size),
        "fps": walk.fps,
        "seed": done.seed,
        "settings": asdict(done.settings),
        "versions": _versions(),
        "input": os.path.relpath(walk.path, folder),
        "inputs": checksums(walk),
        "files": list(NAMES),
        "warnings": list(done.warnings),
        "figures": done.facts.as_data(),
        "timings": {"median_frame_ms": round(done.milliseconds, 4)},
    }


def _versions() -> dict[str, str]:
    return {"python": platform.python_version(), **{name: version_of(name) for name in _PACKAGES}}


def checksums(walk: Walk) -> dict[str, str]:
    """Name and SHA-256 of the files that were read."""
    paths = [walk.path, *(walk.path.parent / name for name in _READ[1:])]
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths if path.is_file()}


def summary(done: Done, out: Path) -> dict[str, object]:
    """What a machine wants to know of a run at once."""
    return {
        "run": str(out),
        "report": str(out / "report.html"),
        "files": list(NAMES),
        "method": done.settings.method,
        "frames": int(done.track.frame.size),
        "figures": done.facts.as_data(),
        "median_frame_ms": done.milliseconds,
        "warnings": list(done.warnings),
    }


def summary_text(done: Done, out: Path) -> str:
    """The same in a few lines."""
    first = f"{done.track.frame.size} frames, {done.milliseconds:.2f} ms a frame"
    return "\n".join([first, *done.facts.sentences(), str(out / "report.html")])


def simulated(out: Path, seed: int, chosen: Mapping[str, object]) -> None:
    """Write a simulated walk; an earlier walk there is replaced.

    Raises
    ------
    InputError
        For settings that the simulator refuses, or a folder that holds something else.
    """
    from synth.walk import WalkSettings, simulate_walk

    try:
        settings = WalkSettings(**chosen)  # type: ignore[arg-type]
    except ValueError as refused:
        raise InputError(f"--{refused}") from refused
    if out.is_dir() and any(out.iterdir()) and not (out / NAME).is_file():
        raise InputError(f"{out}: holds other files; a new or empty folder, or an earlier walk, was wanted")
    blocked = next((place for place in (out, *out.parents) if place.exists() and not place.is_dir()), None)
    if blocked is not None:
        raise InputError(f"{blocked}: is a file; a folder was wanted")
    simulate_walk(out, seed, settings, replace=True)
