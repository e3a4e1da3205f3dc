"""People and choices in, the folder of a run out: the work of `handtrack body people` and `body simulate-people`.

people.csv             who was where (see `handtrack.formats.people`)
people.trc, .c3d, .bvh the same for programs of motion capture
run.json               settings, versions, checksums of the input, figures, timings
report.html            what to look at
"""

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ..body.people import Settings
from ..body.people_inputs import PeopleInput
from ..body.people_run import Followed, run
from ..errors import InputError
from ..formats.bvh_writing import write_bvh
from ..formats.c3d_files import write_c3d
from ..formats.people import NAME, People, write_people
from ..formats.people_markers import courses
from ..formats.people_scenes import SKELETONS
from ..formats.rgbd import NAME as SCENE
from ..formats.trc import write_trc
from ..formats.writing import write_text
from ..report.people import PeopleShown, write_people_report
from ..report.people_facts import PeopleFacts, facts_of
from .console import note, version_of
from .record import RUN_FILE, whole_folder

FORMAT = "handtrack/people-run-1"
_PACKAGES = ("handtrack", "numpy", "scipy", "numba")


@dataclass(frozen=True, slots=True, eq=False)
class Done:
    """A finished run and what it can be held against."""

    opened: PeopleInput
    followed: Followed
    facts: PeopleFacts
    written: tuple[str, ...]
    warnings: tuple[str, ...]


def follow_into(out: Path, opened: PeopleInput, settings: Settings, seed: int) -> Done:
    """Follow people and write their run folder, whole or not at all."""
    with whole_folder(out, NAME, "run") as folder:
        note(f"following people through {opened.detections.time.size} frames")
        followed = run(opened.detections, settings, seed)
        facts = facts_of(followed.people, followed.raw, opened.truth)
        note("writing report")
        write_people(folder / NAME, followed.people)
        written, said = _exported(folder, followed.people)
        own = tuple(line for line in followed.people.warnings if line not in opened.warnings)
        done = Done(opened, followed, facts, (NAME, *written), (*own, *said))
        record = _record(folder, done, settings, seed)
        write_text(folder / RUN_FILE, json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n")
        write_people_report(folder / "report.html", _shown(done, settings, seed))
    return done


def _exported(folder: Path, people: People) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the files of motion capture that could be written, and why others could not."""
    labels, p = courses(people)
    if not labels.size:
        return (), ("nobody was found: people.trc, people.c3d and people.bvh are left out",)
    written, said = ["people.trc"], []
    write_trc(folder / "people.trc", people)
    if find_spec("ezc3d") is None:
        said.append("people.c3d is left out: it needs 'pip install handtrack[c3d]'")
    else:
        write_c3d(folder / "people.c3d", people)
        written.append("people.c3d")
    if np.isfinite(p[:, :, 6:8]).all(axis=(2, 3)).any():
        write_bvh(folder / "people.bvh", people)
        written.append("people.bvh")
    else:
        said.append("people.bvh is left out: nobody has hips")
    return tuple(written), tuple(said)


def _shown(done: Done, settings: Settings, seed: int) -> PeopleShown:
    opened, followed = done.opened, done.followed
    return PeopleShown(
        title=opened.path.stem if opened.path.is_file() else opened.path.name,
        mode=settings.mode,
        people=followed.people,
        raw=followed.raw,
        detections=opened.detections,
        truth=opened.truth,
        facts=done.facts,
        camera=opened.camera,
        gate=settings.distance,
        milliseconds=followed.milliseconds,
        settings=(("seed", str(seed)), *((name, str(value)) for name, value in _flat(asdict(settings)).items())),
        versions=tuple(_versions().items()),
        inputs=tuple((name, digest[:16]) for name, digest in checksums(opened).items()),
        warnings=(*opened.warnings, *done.warnings),
    )


def _record(folder: Path, done: Done, settings: Settings, seed: int) -> dict[str, object]:
    """Content of `run.json`."""
    opened = done.opened
    return {
        "format": FORMAT,
        "scene": opened.path.name,
        "frames": int(opened.detections.time.size),
        "fps": opened.fps,
        "seed": seed,
        "settings": asdict(settings),
        "versions": _versions(),
        "input": os.path.relpath(opened.path, folder),
        "inputs": checksums(opened),
        "files": list(done.written),
        "warnings": [*opened.warnings, *done.warnings],
        "labels": done.facts.labels.tolist(),
        "figures": done.facts.as_data(),
        "timings": {"mean_frame_ms": round(done.followed.milliseconds, 3)},
    }


def _flat(settings: Mapping[str, object], before: str = "") -> dict[str, object]:
    """Settings of settings as `outer.inner`."""
    out: dict[str, object] = {}
    for name, value in settings.items():
        out |= _flat(value, f"{before}{name}.") if isinstance(value, Mapping) else {before + name: value}
    return out


def _versions() -> dict[str, str]:
    return {"python": platform.python_version(), **{name: version_of(name) for name in _PACKAGES}}


def checksums(opened: PeopleInput) -> dict[str, str]:
    """Name and SHA-256 of what was read; several files of a kind count as one, in their order."""
    return {name: _digest(paths) for name, paths in opened.files}


def _digest(paths: tuple[Path, ...]) -> str:
    total = hashlib.sha256()
    for path in paths:
        total.update(path.read_bytes())
    return total.hexdigest()


def summary(done: Done, out: Path) -> dict[str, object]:
    """What a machine wants to know of a run at once."""
    return {
        "run": str(out),
        "report": str(out / "report.html"),
        "files": list(done.written),
        "frames": int(done.opened.detections.time.size),
        "labels": done.facts.labels.tolist(),
        "figures": done.facts.as_data(),
        "mean_frame_ms": done.followed.milliseconds,
        "warnings": [*done.opened.warnings, *done.warnings],
    }


def summary_text(done: Done, out: Path) -> str:
    """The same in a few lines."""
    frames, ms = done.opened.detections.time.size, done.followed.milliseconds
    lines = [f"{frames} frames, {ms:.2f} ms a frame", *done.facts.sentences(), str(out / "report.html")]
    return "\n".join(lines)


def simulated(out: Path, task: str, seed: int, chosen: Mapping[str, object]) -> None:
    """Write a simulated task; an earlier scene there is replaced.

    Raises
    ------
    InputError
        For settings that the simulator refuses, or a folder that holds something else.
    """
    from synth.people_scripts import TASKS
    from synth.people_tasks import TaskSettings, crossing, make_task, simulate_people

    try:
        settings = TaskSettings(**chosen)  # type: ignore[arg-type]
    except ValueError as refused:
        raise InputError(f"--{refused}") from refused
    if out.is_dir() and any(out.iterdir()) and not ((out / SCENE).is_file() and (out / SKELETONS).is_file()):
        raise InputError(f"{out}: holds other files; a new or empty folder, or an earlier scene, was wanted")
    blocked = next((place for place in (out, *out.parents) if place.exists() and not place.is_dir()), None)
    if blocked is not None:
        raise InputError(f"{blocked}: is a file; a folder was wanted")
    made = make_task(task, seed, settings) if task in TASKS else crossing(seed, task, settings)
    simulate_people(out, made, replace_folder=True)
