"""A model and its start pose in, the model with each finger's last two joints loosely coupled out.

The tendons bend the last joint of a finger with the one before it, by about two thirds of its angle (H. Rijpkema and
M. Girard, "Computer animation of knowledge-based human grasping", SIGGRAPH 1991). Hands differ by an offset, which
the start pose tells:

    dip - dip_0 = 2/3 (pip - pip_0),     with a standard deviation.

An outline hardly shows where along a finger it bends, so this much knowledge decides between poses of one outline.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .kinematics import Model
from .kinematics.couplings import Coupling, soft_rows

RATIO = 2.0 / 3.0


def with_coupled_tips(model: Model, start_pose: Float[np.ndarray, " j"], sigma: float) -> Model:
    """The model with a soft coupling for every joint `*dip` that has its `*pip` and follows none yet.

    Parameters
    ----------
    start_pose : (j,)
        Joint values that lie on the coupling, radians.
    sigma : float
        Standard deviation about it, radians, > 0.

    Raises
    ------
    ValueError
        For a sigma that is not positive, or a model without such joints.

    Examples
    --------
    >>> from handtrack.kinematics.builtin import model
    >>> [one.joint for one in with_coupled_tips(model("index"), np.zeros(3), 0.1).soft_couplings]
    ['index_dip']
    """
    names, number = model.joint_names, {name: i for i, name in enumerate(model.joint_names)}
    taken = {one.joint for one in model.soft_couplings} | {names[i] for i in range(len(names)) if i not in model.free}
    pairs = [(name, f"{name[:-3]}pip") for name in names if name.endswith("dip") and name not in taken]
    new = [
        Coupling(dip, of=pip, ratio=RATIO, offset=float(start_pose[number[dip]] - RATIO * start_pose[number[pip]]))
        for dip, pip in pairs
        if pip in number
    ]
    if not new:
        raise ValueError(f"model: '{model.name}' has no free joints '*dip' with a '*pip'; such names were wanted")
    couplings = (*model.soft_couplings, *(replace(one, sigma=sigma) for one in new))
    soft, target = soft_rows(names, couplings, model.coupling, model.coupling_offset)
    return replace(model, soft=soft, soft_target=target, soft_couplings=couplings)
