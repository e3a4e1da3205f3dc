"""A walk and choices in, the folder of a run out: the work of `handtrack body walk` and `body simulate-walk`.

walk.csv, posture.csv, keypoints.csv   where the person was, and how (see `handtrack.formats.walk_tracks`)
run.json                               settings, versions, checksums of the input, figures, timings
report.html                            what to look at
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ..body.walk_inputs import WalkInput
from ..body.walk_run import WalkRun, follow_input, write_run
from ..body.walk_settings import Settings
from ..errors import InputError
from ..formats.walk_tracks import NAMES
from ..formats.walks import NAME
from ..report.walk import WalkShown, write_walk_report
from ..report.walk_facts import WalkFacts, walk_facts
from .console import note
from .record import whole_folder


@dataclass(frozen=True, slots=True, eq=False)
class Done:
    """A finished run and the figures of its page."""

    run: WalkRun
    facts: WalkFacts
    warnings: tuple[str, ...]

    @property
    def milliseconds(self) -> float:
        """Median time of a frame."""
        return 1e3 * float(np.median(self.run.track.seconds))


def follow_into(out: Path, opened: WalkInput, settings: Settings, seed: int) -> Done:
    """Follow a person through a walk and write the run folder, whole or not at all."""
    with whole_folder(out, NAMES[0], "run") as folder:
        note(f"following a person through {opened.walk.frame.size} frames, method {settings.method}")
        run = follow_input(opened, settings, seed)
        facts = walk_facts(run.track, run.raw, opened.walk.truth)
        done = Done(run, facts, tuple(dict.fromkeys([*opened.warnings, *run.track.warnings])))
        note("writing report")
        write_run(folder, run)
        write_walk_report(folder / "report.html", _shown(done, settings, seed))
    return done


def _shown(done: Done, settings: Settings, seed: int) -> WalkShown:
    run, walk = done.run, done.run.opened.walk
    versions, inputs = run.record["versions"], run.record["inputs"]
    if not isinstance(versions, Mapping) or not isinstance(inputs, Mapping):
        raise TypeError("record: `versions` and `inputs` are wanted as mappings")
    return WalkShown(
        title=walk.path.resolve().parent.name,
        method=settings.method,
        track=run.track,
        facts=done.facts,
        raw=None if settings.method == "suit" else run.raw,
        truth=walk.truth,
        walk=walk,
        milliseconds=done.milliseconds,
        settings=(("seed", str(seed)), *((name, str(value)) for name, value in asdict(settings).items())),
        versions=tuple(versions.items()),
        inputs=tuple((name, digest[:16]) for name, digest in inputs.items()),
        warnings=done.warnings,
    )


def summary(done: Done, out: Path) -> dict[str, object]:
    """What a machine wants to know of a run at once."""
    return {
        "run": str(out),
        "report": str(out / "report.html"),
        "files": list(NAMES),
        "method": done.run.record["method"],
        "frames": int(done.run.track.frame.size),
        "figures": done.facts.as_data(),
        "median_frame_ms": done.milliseconds,
        "warnings": list(done.warnings),
    }


def summary_text(done: Done, out: Path) -> str:
    """The same in a few lines."""
    first = f"{done.run.track.frame.size} frames, {done.milliseconds:.2f} ms a frame"
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
