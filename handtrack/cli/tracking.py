"""What was typed in; settings, sequence and a finished run out: the work of `handtrack track`."""

from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

from ..errors import InputError
from ..formats.yaml_files import parse_yaml
from ..sequences import NAME, Sequence, open_images, open_sequence
from ..settings import Settings
from ..surface.tracking import track_surface
from ..track import Track
from ..tracker import track
from .calibrating import ROUNDS, with_calibrated_model
from .console import note, progress, warning
from .record import RUN_FILE, whole_folder, write_run
from .skinned import open_surface


def make_settings(chosen: dict[str, object]) -> Settings:
    """Settings from what was chosen on the command line; what they refuse is the user's error."""
    try:
        return Settings(**chosen)  # type: ignore[arg-type]
    except ValueError as refused:
        raise InputError(f"--{refused}") from refused


def open_input(
    sources: list[Path], model: str | None, cameras: list[Path], start: str | None, fps: float | None
) -> Sequence:
    """The sequence that the arguments describe, with a start pose; several sources are as many views."""
    pose = None if start is None else parse_start(start)
    source = sources[0]
    whole = next((one for one in sources if one.name == NAME or (one / NAME).exists()), None)
    if len(sources) > 1 and whole is not None:
        raise InputError(f"{whole}: is a sequence, which names all its views itself; one input was wanted")
    if whole is not None or (len(sources) == 1 and source.is_dir() and model is None and not cameras):
        for name, value in (("--camera", cameras or None), ("--fps", fps)):
            if value is not None:
                raise InputError(f"{name}: {source} is a sequence and has its own; it is for image folders and videos")
        sequence = open_sequence(source, model, pose)
    else:
        missing = next((one for one in sources if not one.exists()), None)
        if missing is not None:
            raise InputError(f"{missing}: no such file or folder")
        if model is None or not cameras:
            raise InputError(f"{source}: has no {NAME}; --model and --camera were wanted with it")
        sequence = open_images(sources, model, cameras, pose, fps)
    for line in sequence.warnings:
        warning(line)
    if sequence.start is None:
        raise InputError(f"{source}: no start pose; `start:` in {NAME}, or --start, was wanted")
    return sequence


def parse_start(text: str) -> dict[str, float] | Path:
    """A start pose typed on the command line, or the path of a file that holds one."""
    if not text.lstrip().startswith("{"):
        return Path(text)
    data = parse_yaml(text.encode(), Path("--start")).data
    if not isinstance(data, dict) or not all(isinstance(value, int | float) for value in data.values()):
        raise InputError(f"--start: {text} given; '{{joint: degrees, ...}}' was wanted")
    return {joint: float(value) for joint, value in data.items()}


def track_into(
    out: Path, sequence: Sequence, settings: Settings, surface: Path | None = None, calibrate: int | None = None
) -> Track:
    """Track a sequence, with a skinned surface if a file is named, and write its run folder, whole or not at all.

    Parameters
    ----------
    calibrate : int or None
        First frames that the shape of the links is found from before tracking; None leaves the model as it is.
    """
    start = sequence.start
    if start is None:
        raise InputError(f"{sequence.path}: no start pose; `start:` in the sequence file was wanted")
    skinned = None if surface is None else open_surface(surface, sequence.model, settings)
    if calibrate is not None and surface is not None:
        raise InputError("--calibrate: finds the shape of pills; no --surface was wanted with it")
    with whole_folder(out, RUN_FILE, "run") as folder:
        if calibrate is not None:
            with progress("calibrating", ROUNDS) as done:
                sequence = with_calibrated_model(sequence, calibrate, done, float(np.degrees(settings.start_sigma)))
        begun = perf_counter()
        with progress("tracking", len(sequence)) as done:
            if skinned is None:
                follow = partial(track, sequence, sequence.model)
            else:
                follow = partial(track_surface, sequence, skinned.surface)
            result = follow(
                sequence.cameras,
                start,
                fps=sequence.fps,
                settings=settings,
                times=sequence.times,
                progress=done,
            )
        seconds = perf_counter() - begun
        note("writing video and report")
        write_run(folder, result, sequence, settings, seconds, skinned, calibrate)
    return result


def summary(result: Track, out: Path) -> dict[str, object]:
    """What a machine wants to know of a run at once; the rest is in its files."""
    return {
        "run": str(out),
        "report": str(out / "report.html"),
        "frames": int(result.frame.size),
        "status": {name: int(np.sum(result.status == name)) for name in ("tracked", "uncertain", "lost")},
        "median_sigma_deg": float(np.degrees(np.median(result.sigma))),
        "median_residual_px": float(np.median(result.residual)),
        "median_frame_ms": float(1000.0 * np.median(result.seconds)),
    }


def summary_text(result: Track, out: Path) -> str:
    """The same in two lines."""
    facts = summary(result, out)
    counts = ", ".join(f"{count} {name}" for name, count in facts["status"].items() if count)  # type: ignore[attr-defined]
    return (
        f"{facts['frames']} frames: {counts}; median {facts['median_frame_ms']:.2f} ms a frame, "
        f"residual {facts['median_residual_px']:.2f} px\n{out / 'report.html'}"
    )
