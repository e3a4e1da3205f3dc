"""A run and its input in, Cramer-Rao bounds out: the part of `handtrack evaluate` that needs the images."""

from pathlib import Path

from ..bound import Bounds, spread_frames
from ..errors import InputError
from ..sequences import Sequence as Input
from .bound_frames import bounds_of_input, whole_truth
from .console import progress, warning
from .explain import open_past, read_record
from .record import Run


def bounds_of_run(
    run: Path, past: Run, most: int, known_light: bool, source: list[Path] | None = None
) -> Bounds | None:
    """Bounds at the true poses of at most `most` frames; None, and a warning, where the images are gone.

    Raises
    ------
    InputError
        If `source` is given and is no input of this run.
    """
    number, q = whole_truth(past.track, past.truth)
    if not number.size:
        warning(f"{run}: no Cramer-Rao bound: no frame has a true value for every joint")
        return None
    try:
        _, sequence, _ = open_past(run, read_record(run), source)
        _same_size(run, past, sequence, int(number[-1]))
    except InputError as gone:
        if source:
            raise
        warning(f"no Cramer-Rao bound: {gone}")
        return None
    chosen = spread_frames(number.size, most)
    with progress("Cramer-Rao bound", chosen.size) as done:
        return bounds_of_input(sequence, past.cameras, past.model, number[chosen], q[chosen], known_light, done)


def _same_size(run: Path, past: Run, sequence: Input, last: int) -> None:
    """Refuse images that are not those the run was made from, as far as their number and size tell."""
    sizes = [(camera.width, camera.height) for camera in past.cameras]
    if sizes != [(camera.width, camera.height) for camera in sequence.cameras] or last >= len(sequence):
        raise InputError(
            f"{sequence.path}: number, length or size of the views is not that of {run}; its input was wanted"
        )
