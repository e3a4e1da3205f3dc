"""Joints that follow other joints in, the maps between independent joints and all joints out.

A coupling without sigma is a substitution, `q = C u + c`: a finger's DIP that bends with its PIP is the row
`C[dip, pip] = ratio`, `c[dip] = offset`. With sigma it is a soft prior: both joints stay free, and
`joint - ratio of - offset` is normal with that standard deviation. Divided by sigma these are rows `S` and targets `b`
with `S u - b` standard normal.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

_NOTHING = 1e-12  # size of a row, against its ratio, below which a soft coupling constrains nothing


@dataclass(frozen=True, slots=True, eq=False)
class Coupling:
    """`joint = ratio * of + offset`, in radians (model units for prismatic joints).

    Attributes
    ----------
    sigma : float or None
        Standard deviation of the difference, in the unit of `joint`, > 0; None where the joint follows exactly.
    """

    joint: str
    of: str
    ratio: float
    offset: float = 0.0
    sigma: float | None = None


def coupling_matrix(
    names: tuple[str, ...], couplings: Sequence[Coupling]
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "j k"], Float[np.ndarray, " j"]]:
    """Independent joints, matrix and offset of `q = C u + c`; chains of couplings are multiplied out.

    Soft couplings (with sigma) leave their joints independent; see `soft_rows`.

    Raises
    ------
    ValueError
        For an unknown joint, a joint coupled twice, or couplings that circle, soft ones included.

    >>> free, c, c0 = coupling_matrix(("pip", "dip"), [Coupling("dip", of="pip", ratio=0.67)])
    >>> free.tolist(), c.tolist()
    ([0], [[1.0], [0.67]])
    """
    by_joint: dict[str, Coupling] = {}
    for coupling in couplings:
        for joint in (coupling.joint, coupling.of):
            if joint not in names:
                raise ValueError(f"couplings: joint '{joint}' does not exist; the model has {', '.join(names)}")
        if coupling.sigma is not None:
            continue
        if coupling.joint in by_joint:
            raise ValueError(f"couplings: joint '{coupling.joint}' is coupled twice")
        by_joint[coupling.joint] = coupling
    _refuse_circles(couplings)
    free = [i for i, joint in enumerate(names) if joint not in by_joint]
    matrix = np.zeros((len(names), len(free)))
    offset = np.zeros(len(names))
    for i, joint in enumerate(names):
        gain, shift = 1.0, 0.0
        while joint in by_joint:
            coupling = by_joint[joint]
            shift += gain * coupling.offset
            gain *= coupling.ratio
            joint = coupling.of
        matrix[i, free.index(names.index(joint))] = gain
        offset[i] = shift
    return np.array(free, dtype=int), matrix, offset


def _refuse_circles(couplings: Sequence[Coupling]) -> None:
    """Couplings of joints that follow nothing more are taken away in turn; what cannot be leads into a circle."""
    left = list(couplings)
    while left:
        following = {coupling.joint for coupling in left}
        remaining = [coupling for coupling in left if coupling.of in following]
        if len(remaining) == len(left):
            seen, joint = set[str](), left[0].joint
            while joint not in seen:
                seen.add(joint)
                joint = next(coupling.of for coupling in left if coupling.joint == joint)
            raise ValueError(f"couplings: '{joint}' follows itself in a circle")
        left = remaining


def soft_rows(
    names: tuple[str, ...],
    couplings: Sequence[Coupling],
    matrix: Float[np.ndarray, "j k"],
    offset: Float[np.ndarray, " j"],
) -> tuple[Float[np.ndarray, "c k"], Float[np.ndarray, " c"]]:
    """Rows and targets of the soft couplings: `rows @ u - targets` is standard normal.

    With `q = C u + c` the difference `q_joint - ratio q_of - offset` is
    `(C_joint - ratio C_of) u - (offset - c_joint + ratio c_of)`; both parts are divided by sigma.

    Parameters
    ----------
    matrix, offset : (j, k), (j,)
        From `coupling_matrix` of the same couplings.

    Raises
    ------
    ValueError
        For a sigma that is not positive, the same two joints given twice, or a soft coupling of joints that an exact
        one already ties together.

    >>> names, soft = ("pip", "dip"), [Coupling("dip", of="pip", ratio=0.5, sigma=0.25)]
    >>> _, c, c0 = coupling_matrix(names, soft)
    >>> rows, targets = soft_rows(names, soft, c, c0)
    >>> rows.tolist(), targets.tolist()
    ([[-2.0, 4.0]], [0.0])
    """
    soft = [coupling for coupling in couplings if coupling.sigma is not None]
    rows, targets = np.zeros((len(soft), matrix.shape[1])), np.zeros(len(soft))
    pairs: set[tuple[str, str]] = set()
    for i, coupling in enumerate(soft):
        sigma = coupling.sigma or 0.0
        if not 0.0 < sigma < np.inf:
            raise ValueError(f"couplings: sigma of joint '{coupling.joint}' is {sigma}; a finite one > 0 is wanted")
        if (coupling.joint, coupling.of) in pairs:
            raise ValueError(f"couplings: joint '{coupling.joint}' follows '{coupling.of}' twice")
        pairs.add((coupling.joint, coupling.of))
        joint, of = names.index(coupling.joint), names.index(coupling.of)
        rows[i] = (matrix[joint] - coupling.ratio * matrix[of]) / sigma
        targets[i] = (coupling.offset - offset[joint] + coupling.ratio * offset[of]) / sigma
        if np.abs(rows[i]).max() * sigma <= _NOTHING * (1.0 + abs(coupling.ratio)):
            raise ValueError(f"couplings: joint '{coupling.joint}' follows '{coupling.of}' exactly; no sigma is wanted")
    return rows, targets
