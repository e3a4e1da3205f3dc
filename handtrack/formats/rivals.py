"""A track in, `rivals.csv` out, and back: another pose of each frame that the images could not tell from the tracked.

`frame,weight,<joint>...`: the rival's weight, 0 to 1, and its joints in degrees (model units where a joint slides). A
frame without a rival has weight 0 and empty cells.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from ..track import Track
from .tables import integers, numbers, read_table


def rivals_rows(track: Track, units: Float[np.ndarray, " j"]) -> Iterable[list[str]]:
    """Header and rows of the table; nothing for a track that does not say.

    Parameters
    ----------
    units : (j,)
        What one unit of the file is in the code.

    Raises
    ------
    ValueError
        If a rival lacks some of the joints, or has no weight from 0 to 1.
    """
    if track.rival is None or track.rival_weight is None:
        return
    there = np.isfinite(track.rival)
    wrong = (there.any(axis=1) != there.all(axis=1)) | ~((track.rival_weight >= 0.0) & (track.rival_weight <= 1.0))
    if wrong.any():
        raise ValueError(f"track: rival of row {np.argmax(wrong)}: all joints or none, and a weight from 0 to 1 wanted")
    yield ["frame", "weight", *track.joint_names]
    for i, frame in enumerate(track.frame):
        cells = [_short(value) if np.isfinite(value) else "" for value in track.rival[i] / units]
        yield [str(frame), _short(track.rival_weight[i]), *cells]


def _short(value: float) -> str:
    return f"{float(value) + 0.0:.10g}"


def read_rivals(
    path: Path, frame: Int[np.ndarray, " n"], joints: tuple[str, ...], units: Float[np.ndarray, " j"]
) -> tuple[Float[np.ndarray, "n j"] | None, Float[np.ndarray, " n"] | None]:
    """Rivals and weights in the units of the code; None where there is no such file.

    Raises
    ------
    InputError
        If the table is malformed, is about other frames, or a rival lacks some of its joints.
    """
    if not path.exists():
        return None, None
    table = read_table(path, ("frame", "weight", *joints))
    if not np.array_equal(integers(table, "frame"), frame):
        raise InputError(f"{path}: its frames are not those of poses.csv; one row for each is wanted")
    weight = numbers(table, "weight")
    rival = np.stack([numbers(table, joint, empty=True) for joint in joints], axis=1)
    there = np.isfinite(rival)
    for bad, wanted in (
        ((weight < 0.0) | (weight > 1.0), "weight: a number from 0 to 1 is wanted"),
        (there.any(axis=1) != there.all(axis=1), "a rival has all joints or none"),
    ):
        if bad.any():
            raise InputError(f"{path}: line {table.lines[np.argmax(bad)]}: {wanted}")
    return rival * units, weight
