"""Joint values as files have them (degrees, model units where a joint slides) in, poses in radians out."""

import math
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from ..kinematics.tree import Model, pose_from_free
from .yaml_files import shorten


def code_units(model: Model) -> Float[np.ndarray, " j"]:
    """What one unit of a file (a degree, or a model unit) is in code, for each joint.

    >>> from handtrack.kinematics.builtin import model
    >>> code_units(model("pr")).round(4).tolist()
    [1.0, 0.0175]
    """
    units = np.full(len(model.joint_names), math.radians(1.0))
    moved = np.flatnonzero(model.joint >= 0)
    units[model.joint[moved[model.prismatic[moved]]]] = 1.0
    return units


def start_pose(
    model: Model, given: Mapping[str, float], where: Callable[[str], str]
) -> tuple[Float[np.ndarray, " j"], tuple[str, ...]]:
    """The pose of the first frame from its values by joint name.

    Every independent joint must be given; the others follow their couplings. A value beyond its limits is moved onto
    the limit, because nothing later may leave them, and that is said in a warning.

    Parameters
    ----------
    where : callable
        Beginning of an error message about a joint ("" for the whole).

    Raises
    ------
    InputError
        For a joint that the model does not have, one that is missing, or a value that is not finite.
    """
    names = model.joint_names
    for joint, value in given.items():
        if joint not in names:
            raise InputError(
                f"{where(joint)} joint {shorten(joint)} is not in model '{model.name}'; wanted: {', '.join(names)}"
            )
        if not math.isfinite(value):
            raise InputError(f"{where(joint)} {value} given; a finite number is wanted")
    missing = [names[i] for i in model.free if names[i] not in given]
    if missing:
        raise InputError(
            f"{where('')} start has no value for {', '.join(missing)}; every joint of '{model.name}' is wanted"
        )
    units, notes = code_units(model), []
    u = np.array([given[names[i]] for i in model.free], dtype=float) * units[model.free]
    low, high = model.limits[model.free].T
    for k in np.flatnonzero((u < low) | (u > high)):
        joint = names[model.free[k]]
        unit = units[model.free[k]]
        limits = f"[{low[k] / unit:g}, {high[k] / unit:g}]"
        notes.append(f"{where(joint)} {given[joint]:g} is beyond the limits {limits}; the limit is used")
    q = pose_from_free(model, np.clip(u, low, high))
    for i, joint in enumerate(names):
        if i in model.free:
            continue
        if joint in given and abs(given[joint] - q[i] / units[i]) > 1e-3:
            notes.append(f"{where(joint)} {given[joint]:g} does not follow its coupling; {q[i] / units[i]:g} is used")
        if not model.limits[i, 0] <= q[i] <= model.limits[i, 1]:
            notes.append(f"{where(joint)} its coupling puts it at {q[i] / units[i]:g}, beyond its limits")
    return q, tuple(notes)
