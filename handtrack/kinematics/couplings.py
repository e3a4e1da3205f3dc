"""Joints that follow other joints in, the linear map from independent joints to all joints out.

`q = C u + c`: a finger's DIP that bends with its PIP is the row `C[dip, pip] = ratio`, `c[dip] = offset`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, slots=True, eq=False)
class Coupling:
    """`joint = ratio * of + offset`, in radians (model units for prismatic joints)."""

    joint: str
    of: str
    ratio: float
    offset: float = 0.0


def coupling_matrix(
    names: tuple[str, ...], couplings: Sequence[Coupling]
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "j k"], Float[np.ndarray, " j"]]:
    """Independent joints, matrix and offset of `q = C u + c`; chains of couplings are multiplied out.

    Raises
    ------
    ValueError
        For an unknown joint, a joint coupled twice, or couplings that circle.

    >>> free, c, c0 = coupling_matrix(("pip", "dip"), [Coupling("dip", of="pip", ratio=0.67)])
    >>> free.tolist(), c.tolist()
    ([0], [[1.0], [0.67]])
    """
    by_joint: dict[str, Coupling] = {}
    for coupling in couplings:
        for joint in (coupling.joint, coupling.of):
            if joint not in names:
                raise ValueError(f"couplings: joint '{joint}' does not exist; the model has {', '.join(names)}")
        if coupling.joint in by_joint:
            raise ValueError(f"couplings: joint '{coupling.joint}' is coupled twice")
        by_joint[coupling.joint] = coupling
    free = [i for i, joint in enumerate(names) if joint not in by_joint]
    matrix = np.zeros((len(names), len(free)))
    offset = np.zeros(len(names))
    for i, joint in enumerate(names):
        gain, shift, seen = 1.0, 0.0, {joint}
        while joint in by_joint:
            coupling = by_joint[joint]
            shift += gain * coupling.offset
            gain *= coupling.ratio
            joint = coupling.of
            if joint in seen:
                raise ValueError(f"couplings: '{joint}' follows itself in a circle")
            seen.add(joint)
        matrix[i, free.index(names.index(joint))] = gain
        offset[i] = shift
    return np.array(free, dtype=int), matrix, offset
