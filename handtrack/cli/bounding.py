"""A run and its input in, Cramer-Rao bounds out: the part of `handtrack evaluate` that needs the images."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..bound import Bounds, bounds, spread_frames
from ..errors import InputError
from ..formats.images import ImageFiles
from ..residuals import chain
from ..sequences import Sequence as Input
from .console import progress, warning
from .explain import open_past, read_record
from .record import Run

Image = Float[np.ndarray, "h w"]


def bounds_of_run(
    run: Path, past: Run, most: int, known_light: bool, source: list[Path] | None = None
) -> Bounds | None:
    """Bounds at the true poses of at most `most` frames; None, and a warning, where the images are gone.

    Raises
    ------
    InputError
        If `source` is given and is no input of this run.
    """
    whole = np.isfinite(past.truth.q).all(axis=1)
    number, _, rows = np.intersect1d(past.track.frame, past.truth.frame[whole], return_indices=True)
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
    q = past.truth.q[whole][rows][chosen]
    on = [chain(past.model, camera) for camera in past.cameras]
    with progress("Cramer-Rao bound", chosen.size) as done:
        return bounds(pictures(sequence, number[chosen]), on, q, number[chosen], known_light, done)


def _same_size(run: Path, past: Run, sequence: Input, last: int) -> None:
    """Refuse images that are not those the run was made from, as far as their number and size tell."""
    sizes = [(camera.width, camera.height) for camera in past.cameras]
    if sizes != [(camera.width, camera.height) for camera in sequence.cameras] or last >= len(sequence):
        raise InputError(
            f"{sequence.path}: number, length or size of the views is not that of {run}; its input was wanted"
        )


def pictures(sequence: Input, number: Int[np.ndarray, " n"]) -> Iterator[Sequence[Image]]:
    """Images of all views in the frames asked for, in rising order; videos are decoded from their start."""
    if all(isinstance(view, ImageFiles) for view in sequence.views):
        for i in number.tolist():
            yield tuple(view.read(i) for view in sequence.views)
        return
    wanted, last = set(number.tolist()), int(number[-1])
    for i, together in enumerate(sequence):
        if i in wanted:
            yield together
        if i >= last:
            return
