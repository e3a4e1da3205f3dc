"""`handtrack explain`: a run and the number of a frame in; a page that shows why the pose there is what it is out.

The run keeps no images and no looks at them. Its record names input and settings, so the frames up to the one asked
for are tracked again; the pose must come out as it did, to the printed digits.
"""

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InputError
from .console import note, progress, say, say_json, warning

if TYPE_CHECKING:
    from ..replay import Replay
    from ..sequences import Sequence
    from ..settings import Settings
    from ..track import Track

_SAME, _CLOSE = 1e-9, 1e-6  # share of a value that ten printed digits may differ by; degrees where the start is rounded
_SAID = 8


def explain(
    run: Annotated[Path, typer.Argument(help="Folder that `handtrack track` wrote.", show_default=False)],
    frame: Annotated[int, typer.Argument(help="Number of the frame, as in poses.csv.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Page to write; by default explain-NNNNNN.html in RUN.")] = None,
    source: Annotated[
        list[Path] | None,
        typer.Option("--input", help="Input of the run, where it is not where it was; once for each view."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The findings as JSON for machines.")] = False,
) -> None:
    """Show why a pose is what it is: every profile, edge, weight and residual of a frame on one page."""
    from ..report.explain import write_explanation

    record = read_record(run)
    settings = settings_of(record, run)
    track, sequence, exact = open_past(run, record, source)
    if not 0 <= frame < min(track.frame.size, len(sequence)):
        raise InputError(f"FRAME: {frame} given; {run} has frames 0 to {track.frame.size - 1}")
    page = out if out is not None else run / f"explain-{frame:06d}.html"
    check_page(page)
    said = changed_inputs(record, sequence)
    past = again(sequence, settings, frame)
    off = pose_difference(past, track, frame, exact)
    if off is not None:
        said.append(
            f"frame {frame}, tracked again, is {off:.3g} degrees off poses.csv; the page explains it as it is now"
        )
    for line in said:
        warning(line)
    findings = write_explanation(page, past, sequence.truth, str(record.get("sequence", run.name)), said)
    if as_json:
        told = [{"level": finding.level, "text": finding.text} for finding in findings]
        facts = {"run": str(run), "frame": frame, "page": str(page), "status": past.frame.status}
        say_json({**facts, "same_pose": off is None, "findings": told})
        return
    for finding in findings[:_SAID]:
        say(f"{finding.level:4} {finding.text}")
    if len(findings) > _SAID:
        note(f"{len(findings) - _SAID} more on the page")
    say(str(page))


def read_record(run: Path) -> Mapping[str, Any]:
    """The record of a run."""
    from .record import FORMAT, RUN_FILE

    path = run / RUN_FILE
    if not path.is_file():
        raise InputError(f"{run}: has no {RUN_FILE}; a folder written by `handtrack track` was wanted")
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as broken:
        raise InputError(f"{path}: is no JSON ({broken}); the record of a run was wanted") from broken
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise InputError(f"{path}: `format: {FORMAT}` was wanted")
    if "surface" in record:
        raise InputError(f"{run}: was tracked with a skinned surface; a run with pills was wanted")
    for key in ("settings", "start", "inputs"):
        if not isinstance(record.get(key), dict):
            raise InputError(f"{path}: {key}: names and values were wanted")
    if not isinstance(record.get("fps"), int | float):
        raise InputError(f"{path}: fps: a number was wanted")
    return record


def settings_of(record: Mapping[str, Any], run: Path) -> "Settings":
    """The settings of a run; those that it does not name have their defaults."""
    from ..settings import Settings

    known = {field.name for field in fields(Settings)}
    for name in record["settings"]:
        if name not in known:
            raise InputError(
                f"{run}: run.json: settings: '{name}' is unknown to this version; one of its own was wanted"
            )
    try:
        return Settings(**record["settings"])
    except (TypeError, ValueError) as refused:
        raise InputError(f"{run}: run.json: settings: {refused}") from refused


def open_past(run: Path, record: Mapping[str, Any], source: list[Path] | None) -> "tuple[Track, Sequence, bool]":
    """Track and input of a run, and whether its start pose is known to the last digit.

    A sequence folder is opened as it is where it still has the run's model and start; else, and for images and videos,
    model, camera and start are the run's own copies, of which the start is rounded to ten digits.
    """
    from ..formats.cameras import read_cameras
    from ..formats.models import read_model
    from ..formats.tracks import read_track
    from ..sequences import NAME, open_images, open_sequence
    from .record import checksums

    paths = input_paths(run, record, source)
    track = read_track(run, read_model(run / "model.yaml"))
    first = paths[0]
    if first.name == NAME or (first / NAME).exists():
        sequence = open_sequence(first)
        same_model = dict(checksums(sequence)).get("model") == record["inputs"].get("model")
        same_model = same_model and not record.get("calibrated_on")
        if same_model and same_start(sequence, record):
            return track, sequence, True
        return track, open_sequence(first, run / "model.yaml", record["start"]), False
    fps = float(record["fps"]) if first.is_dir() else None
    cameras = list(read_cameras(run / "camera.yaml"))
    return track, open_images(paths, run / "model.yaml", cameras, record["start"], fps), False


def input_paths(run: Path, record: Mapping[str, Any], source: list[Path] | None) -> list[Path]:
    """Where the input is: as given, or as the record says, relative to the run."""
    told = record.get("input", [])
    kept = [run / str(one) for one in (told if isinstance(told, list) else [told])]
    paths = source or kept
    if not paths:
        raise InputError(f"{run}: run.json does not say where its input is; --input was wanted")
    for path in paths:
        if not path.exists():
            hint = "" if source else f", the input of {run}; --input tells where it is now"
            raise InputError(f"{path}: no such file or folder{hint}")
    return paths


def same_start(sequence: "Sequence", record: Mapping[str, Any]) -> bool:
    """Whether the sequence's start is that of the run, as far as the record tells."""
    from .texts import degrees

    return sequence.start is not None and degrees(sequence.model, sequence.start) == record["start"]


def check_page(page: Path) -> None:
    """Refuse a place where no page can be, before any work is done."""
    if page.is_dir() or not page.absolute().parent.is_dir():
        raise InputError(f"--out: {page}; a file in an existing folder was wanted")


def changed_inputs(record: Mapping[str, Any], sequence: "Sequence") -> list[str]:
    """A line for each input whose checksum is not that of the run."""
    from .record import checksums

    now = dict(checksums(sequence))
    changed = [name for name, digest in record["inputs"].items() if name in now and now[name] != digest]
    return [f"{name}: changed since the run was made (its SHA-256 differs)" for name in changed]


def again(sequence: "Sequence", settings: "Settings", frame: int) -> "Replay":
    """Track the sequence up to the frame, with a bar."""
    from ..replay import replay
    from ..residuals import chain

    if sequence.start is None:
        raise InputError(f"{sequence.path}: no start pose; `start:` in the sequence file was wanted")
    on = [chain(sequence.model, camera) for camera in sequence.cameras]
    with progress("tracking again", frame + 1) as done:
        return replay(sequence, on, sequence.start, sequence.fps, settings, frame, sequence.times, done)


def pose_difference(past: "Replay", track: "Track", frame: int, exact: bool) -> float | None:
    """Largest difference, in the units of files, of the replayed pose from the run's; None where they are the same."""
    import numpy as np

    from ..formats.poses import code_units

    units = code_units(past.on[0].model)
    now, then = past.frame.q / units, track.q[frame] / units
    allowed = np.maximum(_SAME * np.maximum(np.abs(then), 1e-3), 0.0 if exact else _CLOSE)
    return float(np.abs(now - then).max()) if (np.abs(now - then) > allowed).any() else None
