"""`handtrack demo`: nothing in; a rendered sequence, its track, the errors and a page to look at out."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from .console import note, say


def demo(
    out: Annotated[Path, typer.Option(help="Folder to write; an earlier demo there is replaced.")] = Path(
        "handtrack-demo"
    ),
    seed: Annotated[int, typer.Option(min=0, help="Decides motion and noise.")] = 1,
    frames: Annotated[int, typer.Option(min=2, help="Number of frames.")] = 60,
) -> None:
    """Render two fingers that cross, track them, evaluate the track, and write a page that shows it all."""
    from ..evaluate import as_text
    from ..sequences import open_sequence
    from ..view_errors import evaluate_views
    from .bound_frames import few_bounds
    from .occlusion import make_scene
    from .rendering import write_scene
    from .tracking import make_settings, summary_text, track_into

    clip, run = out / "two-finger-crossing", out / "run"
    note(f"rendering {frames} frames of two fingers into {clip}")
    write_scene(clip, make_scene(seed, "crossing", frames))
    note("tracking (the first run compiles for some seconds)")
    sequence = open_sequence(clip)
    track = track_into(run, sequence, make_settings({}))
    if sequence.truth is not None:
        found, _ = evaluate_views(track, sequence.truth, sequence.model, sequence.cameras)
        say(as_text(replace(found, bounds=few_bounds(sequence, track))))
    text, _ = summary_text(track, run).rsplit("\n", 1)
    say(text)
    say(f"open in a browser: {(run / 'report.html').absolute().as_uri()}")
