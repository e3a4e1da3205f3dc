"""`truth.csv` (`frame,<joint>,<joint>...`, degrees) in, true poses in radians out."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from ..kinematics.tree import Model
from .poses import code_units
from .tables import check_rising, integers, numbers, read_table
from .yaml_files import shorten


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """True joint values of some frames.

    Attributes
    ----------
    frame : (m,)
        Frame numbers, rising.
    q : (m, j)
        Radians (model units where a joint slides), columns as `model.joint_names`; NaN for a joint that the file lacks.
    """

    frame: Int[np.ndarray, " m"]
    q: Float[np.ndarray, "m j"]


def read_truth(path: Path | str, model: Model, count: int | None = None) -> tuple[Truth, tuple[str, ...]]:
    """Read the truth of a sequence.

    Parameters
    ----------
    count : int or None
        Number of frames of the sequence; truth that is shorter or longer is a warning.

    Raises
    ------
    InputError
        For a table that is malformed, has a column that is no joint of the model, or frames that do not rise.
    """
    path = Path(path)
    table = read_table(path, ["frame"])
    for name in table.names:
        if name != "frame" and name not in model.joint_names:
            wanted = ", ".join(model.joint_names)
            raise InputError(
                f"{path}: line 1: column {shorten(name)} is no joint of model '{model.name}'; wanted: {wanted}"
            )
    frame = integers(table, "frame")
    check_rising(table, "frame", frame)
    if not frame.size:
        raise InputError(f"{path}: has a header and no rows; at least one frame is wanted")
    if len(table.names) < 2:
        raise InputError(
            f"{path}: line 1: has no joint; at least one column of {', '.join(model.joint_names)} is wanted"
        )
    q = np.full((frame.size, len(model.joint_names)), np.nan)
    for j, (name, unit) in enumerate(zip(model.joint_names, code_units(model), strict=True)):
        if name in table.names:
            q[:, j] = numbers(table, name) * unit
    notes = []
    if count is not None:
        absent = count - int(np.isin(np.arange(count), frame).sum())
        if absent:
            notes.append(f"{path}: has no truth for {absent} of {count} frames")
        if frame[-1] >= count:
            notes.append(f"{path}: has truth up to frame {frame[-1]}; the sequence ends with frame {count - 1}")
    return Truth(frame, q), tuple(notes)
