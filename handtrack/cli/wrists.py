"""A scene and choices in, the folder of a wrist's run out: the work of `handtrack body wrist` and `body simulate`.

wrist.csv      what was found (see `handtrack.formats.wrists`)
run.json       settings, versions, checksums of the input, timings
report.html    what to look at
"""

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..body.arm import Side
from ..body.environment import Engine, Room, read_room
from ..body.occluded_wrist import Settings
from ..body.wrist_run import Arm, WristTrack, arm_of, run
from ..errors import InputError
from ..formats.rgbd import NAME as SCENE
from ..formats.rgbd import RgbdScene, read_rgbd
from ..formats.robots import RobotVolume, read_robot
from ..formats.skeletons import KEYPOINTS
from ..formats.wrists import KILLS, NAME, STATUSES, write_wrist
from ..formats.writing import write_text
from ..report.wrist import WristShown, write_wrist_report
from ..report.wrist_facts import Facts, facts_of
from .console import note, progress, version_of
from .record import RUN_FILE, whole_folder

FORMAT = "handtrack/wrist-run-1"
ROBOT = "robot.csv"
_PACKAGES = ("handtrack", "numpy", "scipy", "numba", "trimesh", "embreex")


@dataclass(frozen=True, slots=True)
class Choice:
    """Everything but the settings that decides a run."""

    seed: int = 1
    side: Side = "right"
    person: int = 0
    engine: Engine = "auto"


@dataclass(frozen=True, slots=True, eq=False)
class Done:
    """A finished run and what it can be held against."""

    scene: RgbdScene
    arm: Arm
    track: WristTrack
    facts: Facts


def open_scene(folder: Path) -> RgbdScene:
    """The scene in a folder; see `read_rgbd`."""
    if not folder.exists():
        raise InputError(f"{folder}: no such file or folder; a folder with {SCENE} was wanted")
    return read_rgbd(folder)


def robot_of(scene: RgbdScene) -> RobotVolume | None:
    """The robot's volume from the file beside the scene's, where there is one."""
    path = scene.path.parent / ROBOT
    return read_robot(path, len(scene)) if path.is_file() else None


def room_of_scene(scene: RgbdScene) -> Room | None:
    """The room to be shown; None without one."""
    return None if scene.environment is None else read_room(scene.environment)


def truth_of(scene: RgbdScene, arm: Arm, side: Side) -> Float[np.ndarray, "f 3 3"] | None:
    """True shoulder, elbow and wrist of the person whose truth is nearest to what was seen; None without truth."""
    if scene.truth is None or not scene.truth.p.shape[1]:
        return None
    at = [KEYPOINTS.index(f"{side}_{joint}") for joint in ("shoulder", "elbow", "wrist")]
    p = scene.truth.p[:, :, at]
    apart = np.linalg.norm(p - arm.p[:, None], axis=-1)
    known = ~np.isnan(apart)
    mean = np.where(known, apart, 0.0).sum(axis=(0, 2)) / np.maximum(known.sum(axis=(0, 2)), 1)
    return p[:, int(np.where(known.any(axis=(0, 2)), mean, np.inf).argmin())]


def track_into(out: Path, scene: RgbdScene, settings: Settings, choice: Choice) -> Done:
    """Track a wrist and write its run folder, whole or not at all."""
    arm = arm_of(scene.detections, choice.person, choice.side)
    robot, room = robot_of(scene), room_of_scene(scene)  # before the work: a bad file is told at once
    with whole_folder(out, NAME, "run") as folder:
        with progress("tracking", len(scene)) as done:
            track = run(scene, settings, choice.seed, choice.person, choice.side, choice.engine, done)
        truth = truth_of(scene, arm, choice.side)
        facts = facts_of(track, arm.state[:, 2], arm.p[:, 2], None if truth is None else truth[:, 2], robot)
        result = Done(scene, arm, track, facts)
        note("writing report")
        write_wrist(folder / NAME, track)
        record = _record(folder, result, settings, choice)
        write_text(folder / RUN_FILE, json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n")
        shown = WristShown(
            title=scene.path.absolute().parent.name,
            side=choice.side,
            track=track,
            facts=facts,
            seen=arm.p,
            state=arm.state,
            truth=truth,
            room=room,
            robot=robot,
            camera=scene.camera,
            settings=tuple((name, str(value)) for name, value in _flat(asdict(settings)).items()),
            versions=tuple(_versions().items()),
            inputs=tuple((name, digest[:16]) for name, digest in checksums(scene).items()),
            warnings=(*scene.warnings, *track.warnings),
        )
        write_wrist_report(folder / "report.html", shown)
    return result


def _record(folder: Path, done: Done, settings: Settings, choice: Choice) -> dict[str, object]:
    """Content of `run.json`."""
    scene, track = done.scene, done.track
    return {
        "format": FORMAT,
        "scene": scene.path.absolute().parent.name,
        "frames": len(scene),
        "fps": scene.fps,
        "choice": asdict(choice),
        "settings": asdict(settings),
        "versions": _versions(),
        "input": os.path.relpath(scene.path, folder),
        "inputs": checksums(scene),
        "warnings": [*scene.warnings, *track.warnings],
        "status": _statuses(track),
        "kills": dict(zip(KILLS, track.kills.sum(axis=0).tolist(), strict=True)),
        "figures": done.facts.as_data(),
        "timings": {"median_frame_ms": round(1000.0 * float(np.median(track.seconds)), 3)},
    }


def _flat(settings: Mapping[str, object], before: str = "") -> dict[str, object]:
    """Settings of settings as `outer.inner`."""
    out: dict[str, object] = {}
    for name, value in settings.items():
        out |= _flat(value, f"{before}{name}.") if isinstance(value, Mapping) else {before + name: value}
    return out


def _versions() -> dict[str, str]:
    return {"python": platform.python_version(), **{name: version_of(name) for name in _PACKAGES}}


def checksums(scene: RgbdScene) -> dict[str, str]:
    """Name and SHA-256 of the files of a scene; the depth images count as one, in their order."""
    folder = scene.path.parent
    names = ("skeletons.csv", "truth.csv", ROBOT)
    files = {name: (folder / name,) for name in (scene.path.name, *names) if (folder / name).is_file()}
    if scene.environment is not None:
        files["environment"] = (scene.environment,)
    return {name: _digest(paths) for name, paths in (files | {"depth": scene.depth}).items()}


def _digest(paths: tuple[Path, ...]) -> str:
    total = hashlib.sha256()
    for path in paths:
        total.update(path.read_bytes())
    return total.hexdigest()


def _statuses(track: WristTrack) -> dict[str, int]:
    return {name: int(np.sum(track.status == name)) for name in STATUSES}


def summary(done: Done, out: Path) -> dict[str, object]:
    """What a machine wants to know of a run at once."""
    return {
        "run": str(out),
        "report": str(out / "report.html"),
        "frames": len(done.scene),
        "status": _statuses(done.track),
        "figures": done.facts.as_data(),
        "median_frame_ms": float(1000.0 * np.median(done.track.seconds)),
        "warnings": [*done.scene.warnings, *done.track.warnings],
    }


def summary_text(done: Done, out: Path) -> str:
    """The same in a few lines."""
    counts = ", ".join(f"{count} {name}" for name, count in _statuses(done.track).items() if count)
    lines = [f"{len(done.scene)} frames: {counts}; median {1000.0 * np.median(done.track.seconds):.2f} ms a frame"]
    lines += done.facts.sentences()
    return "\n".join([*lines, str(out / "report.html")])


def simulated(out: Path, seed: int, chosen: Mapping[str, object]) -> None:
    """Write a simulated scene; an earlier scene there is replaced.

    Raises
    ------
    InputError
        For settings that the simulator refuses, or a folder that holds something else.
    """
    from synth.cell import CellSettings, simulate_cell

    try:
        settings = CellSettings(**chosen)  # type: ignore[arg-type]
    except ValueError as refused:
        raise InputError(f"--{refused}") from refused
    if out.is_dir() and any(out.iterdir()) and not (out / SCENE).is_file():
        raise InputError(f"{out}: holds other files; a new or empty folder, or an earlier scene, was wanted")
    blocked = next((place for place in (out, *out.parents) if place.exists() and not place.is_dir()), None)
    if blocked is not None:
        raise InputError(f"{blocked}: is a file; a folder was wanted")
    simulate_cell(out, seed, settings, replace=True)
