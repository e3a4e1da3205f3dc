"""`handtrack bench`: nothing in; times of the parts beside those of their plain twins out, in the same run."""

from typing import Annotated

import typer

from .console import note, say, say_json, table


def bench(
    frames: Annotated[int, typer.Option(min=5, help="Frames of the tracked sequence.")] = 60,
    as_json: Annotated[bool, typer.Option("--json", help="JSON for machines.")] = False,
) -> None:
    """Timings after warm-up, on one thread: tracking, renderer, profiles, kinematics."""
    from .timings import measure_all

    note("warming up: compiling and tracking once")
    results = measure_all(frames)
    if as_json:
        say_json([result.as_data() for result in results])
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
