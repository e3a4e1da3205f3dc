"""`handtrack bench`: nothing in; times of the parts beside those of their plain twins out, in the same run."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from .console import note, say, say_json, table


def bench(
    frames: Annotated[int, typer.Option(min=5, help="Frames of the tracked sequence.")] = 60,
    memory_frames: Annotated[
        int, typer.Option(min=0, help="Frames to track for the growth of memory, 3 ms each; 0 for none.")
    ] = 0,
    surface: Annotated[
        Path | None, typer.Option(help="Skinned hand mesh (.glb), to time labelled images of it too.")
    ] = None,
    dataset_images: Annotated[
        int, typer.Option(min=0, help="Images of a dataset to make with one and with two processes; 0 for none.")
    ] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="JSON for machines.")] = False,
) -> None:
    """Timings after warm-up, on one thread: tracking, renderer, profiles, kinematics, bodies, labelled images."""
    from .dataset_timings import Rate, rates
    from .label_timings import labels
    from .memory import growth_mb
    from .people_timings import people
    from .posture_timings import posture
    from .timings import measure_all
    from .walk_timings import walk
    from .wrist_timings import wrist

    note("warming up: compiling and tracking once")
    results = [*measure_all(frames), *wrist(frames), *people(frames), *posture(frames), *walk(frames)]
    made: list[Rate] = []
    with TemporaryDirectory() as folder:
        results += labels(frames // 2, surface, Path(folder))
        if dataset_images:
            note(f"making a dataset of {dataset_images} images, with two processes and with one")
            made = rates(dataset_images, Path(folder))
    grown = None
    if memory_frames:
        note(f"tracking {memory_frames} frames")
        grown = growth_mb(memory_frames)
    if as_json:
        more = [] if grown is None else [{"name": f"memory over {memory_frames} frames", "grown_mb": grown}]
        say_json([*(result.as_data() for result in [*results, *made]), *more])
        return
    rows = [
        [
            r.name,
            f"{r.ours_ms:.3f}",
            r.twin,
            "" if r.twin_ms is None else f"{r.twin_ms:.3f}",
            "" if r.ratio is None else f"{r.ratio:.1f}",
        ]
        for r in results
    ]
    say(table(["what", "ms", "against", "ms", "times"], rows))
    for rate in made:
        say(rate.as_line())
    if grown is not None:
        say(f"memory over {memory_frames} frames: {grown:+.1f} MB")
