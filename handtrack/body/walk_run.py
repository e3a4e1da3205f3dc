"""A walk in, the person out: the filters moment by moment, and the folder of a run.

walk.csv        place of the pelvis, its heading, and how sure they are (see `handtrack.formats.walk_tracks`)
posture.csv     joint angles
keypoints.csv   keypoints in the world
run.json        settings, versions, checksums of the input, figures, timings
"""

import hashlib
import importlib
import json
import os
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter
from types import ModuleType

import numpy as np
from jaxtyping import Bool, Float

from ..errors import InputError
from ..formats.walk_tracks import WalkTrack, write_walk_track
from ..formats.walks import Walk
from ..formats.writing import folder_written_whole, write_text
from .posture import ROOT, Body, pelvis_turn
from .posture_tree import JOINTS
from .suit_body import body_of_walk
from .walk_inputs import WalkInput, open_walk
from .walk_metrics import walk_figures
from .walk_moment import Estimate, Moment, moments
from .walk_settings import METHODS, Method, Settings

RUN_FILE, FORMAT = "run.json", "handtrack/walk-run-1"
NEAR = 1.5  # frames of the camera within which it counts as seeing somebody, where it is slower than the suit
_PACKAGES = ("handtrack", "numpy", "scipy", "numba", "opencv-python-headless")
_MODULES = (
    ("drift-ff", "drift_filter"), ("pose-ff", "pose_filter"), ("eskf", "drift_eskf"), ("camera", "walk_baselines"),
    ("suit", "walk_baselines"),
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class WalkRun:
    """A finished run: what was read, whose body, what was found, the suit alone, and the content of `run.json`."""

    opened: WalkInput
    body: Body
    track: WalkTrack
    raw: WalkTrack
    record: dict[str, object]


def settings_for(method: str) -> Settings:
    """Settings of a method.

    Raises
    ------
    InputError
        If the method is unknown.
    """
    known: Method | None = next((name for name in METHODS if name == method), None)
    if known is None:
        raise InputError(f"--method: {method} given; wanted: {', '.join(METHODS)}")
    return Settings(method=known)


def filter_of(method: Method) -> ModuleType:
    """The module with `begin` and `step` of a method; loaded when it is wanted, for most need one only."""
    return importlib.import_module(f"{__package__}.{dict(_MODULES)[method]}")


def follow_walk(
    walk: Walk,
    body: Body,
    settings: Settings,
    seed: int = 1,
    progress: Callable[[int], None] | None = None,
) -> WalkTrack:
    """Follow a person through a walk.

    Parameters
    ----------
    seed : int
        Decides every random choice: the same walk, body, settings and seed give the same track.
    progress : callable
        Called with the number of the suit's frames done.

    Raises
    ------
    InputError
        If no frame of the suit has the pelvis.
    """
    told = moments(walk, body, settings)
    rng = np.random.default_rng(seed)
    chosen = filter_of(settings.method)
    state = chosen.begin(body, settings)
    found: list[Estimate] = []
    seconds: list[float] = []
    since = 0.0
    for moment in told:
        begun = perf_counter()
        state, estimate = chosen.step(state, moment, rng)
        since += perf_counter() - begun
        if moment.frame >= 0:
            found.append(estimate)
            seconds.append(since)
            since = 0.0
            if progress is not None:
                progress(len(found))
    return _track(walk, found, _in_view(walk, told), np.array(seconds))


def _in_view(walk: Walk, told: list[Moment]) -> Bool[np.ndarray, " f"]:
    """Whether the camera saw the person since the frame of the suit before, or in its last frame if it is slow."""
    at = np.array([moment.time for moment in told if moment.seen])
    seen = np.array([moment.in_view for moment in told if moment.seen], dtype=bool)
    if not at.size:
        return np.zeros(walk.time.size, dtype=bool)
    last = np.searchsorted(at, walk.time, side="right")
    first = np.concatenate([[0], last[:-1]])
    count = np.concatenate([[0], np.cumsum(seen)])
    since = count[last] > count[first]
    period = float(np.median(np.diff(walk.camera_time))) if walk.camera_time.size > 1 else 1.0 / walk.fps
    before = np.maximum(last - 1, 0)
    slow = (last == first) & (last > 0) & seen[before] & (walk.time - at[before] <= NEAR * period)
    return since | slow


def _track(
    walk: Walk, found: list[Estimate], in_view: Bool[np.ndarray, " f"], seconds: Float[np.ndarray, " f"]
) -> WalkTrack:
    q = np.stack([each.q for each in found])
    spread = np.sqrt(np.diagonal(np.stack([each.covariance for each in found]), axis1=1, axis2=2))
    wxyz = pelvis_turn(q).as_quat(scalar_first=True, canonical=True)
    return WalkTrack(
        frame=walk.frame,
        time=walk.time,
        p=q[:, :3].copy(),
        wxyz=wxyz,
        sigma=spread[:, :3].copy(),
        sigma_heading=np.minimum(spread[:, 3], np.pi),
        joint_names=JOINTS,
        posture=q[:, ROOT:].copy(),
        sigma_posture=np.stack([each.sigma_posture for each in found]),
        keypoints=np.stack([each.keypoints for each in found]),
        in_view=in_view,
        status=np.array([each.status for each in found], dtype=np.str_),
        seconds=seconds,
        warnings=(),
    )


def run_folder(
    folder: Path | str,
    out: Path | str,
    settings: Settings,
    seed: int = 1,
    poses: Path | str | None = None,
    replace: bool = False,
    progress: Callable[[int], None] | None = None,
) -> WalkRun:
    """Follow the person of a walk folder, and write the folder of the run, whole or not at all.

    Parameters
    ----------
    poses : path, optional
        What a pose network wrote, in the place of `keypoints2d.csv`; see `walk_inputs.open_walk`.
    replace : bool
        Whether a folder that is already there gives way.

    Raises
    ------
    InputError
        For a walk that cannot be read, or a folder that may not be written.
    """
    opened = open_walk(folder, poses)
    done = follow_input(opened, settings, seed, progress)
    with folder_written_whole(Path(out), replace) as partial:
        write_run(partial, done)
    return done


def follow_input(
    opened: WalkInput, settings: Settings, seed: int = 1, progress: Callable[[int], None] | None = None
) -> WalkRun:
    """Follow the person of an opened walk."""
    body = body_of_walk(opened.walk)
    track = follow_walk(opened.walk, body, settings, seed, progress)
    raw = track
    if settings.method != "suit":
        raw = follow_walk(opened.walk, body, replace(settings, method="suit"), seed)
    return WalkRun(opened, body, track, raw, run_record(opened, track, raw, settings, seed))


def write_run(folder: Path, done: WalkRun) -> None:
    """Write the four files into a folder that is there, each whole or not at all."""
    write_walk_track(folder, done.track)
    record = done.record | {"input": os.path.relpath(done.opened.walk.path, folder)}
    text = json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False)
    write_text(folder / RUN_FILE, text + "\n")


def run_record(opened: WalkInput, track: WalkTrack, raw: WalkTrack, settings: Settings, seed: int) -> dict[str, object]:
    """Content of `run.json`; all of it but the timings is the same for the same input, settings and seed."""
    walk = opened.walk
    ours, suit = walk_figures(track, walk.truth), walk_figures(raw, walk.truth)
    return {
        "format": FORMAT,
        "walk": walk.path.absolute().parent.name,
        "method": settings.method,
        "frames": int(walk.frame.size),
        "camera_frames": int(walk.camera_frame.size),
        "fps": walk.fps,
        "seed": seed,
        "settings": asdict(settings),
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in _PACKAGES}},
        "inputs": {name: _digest(paths) for name, paths in opened.files},
        "warnings": [*opened.warnings, *track.warnings],
        "figures": None if ours is None else ours.as_data(),
        "figures_suit_alone": None if suit is None else suit.as_data(),
        "timings": {"median_frame_ms": round(1e3 * float(np.median(track.seconds)), 3)},
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # run from its sources, or OpenCV under another name
        return "unknown"


def _digest(paths: tuple[Path, ...]) -> str:
    total = hashlib.sha256()
    for path in paths:
        total.update(path.read_bytes())
    return total.hexdigest()
