"""A replayed frame and the true pose in; how wrong the estimate is, and where the error came in, out.

Two trials tell causes apart. The robust cost of the frame's own edges at both poses says whether they asked for the
wrong pose. The frame measured again with the truth for a prediction says whether a better prediction would have
helped: if it would, the error came from earlier frames; if not, this frame's edges or the model's shape made it.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ..estimate import Estimate, Known, estimate
from ..evaluate import joint_error, prismatic_joints
from ..kinematics import pose_from_free
from ..replay import Replay
from ..robust import CAUCHY_C
from ..scatter import whitener
from .explain_evidence import appearance_of, off_truth
from .explain_facts import joint_scale


@dataclass(frozen=True, slots=True, eq=False)
class TruthFacts:
    """The estimate against the truth.

    Attributes
    ----------
    q : (j,)
        True pose, radians; whole, since trials need every joint.
    error, trial_error : (j,)
        Of the estimate, and of a fit that had the truth for its prediction, degrees (model units for joints that
        slide).
    off : tuple of (n,)
        For each view, distance of every accepted edge from the true outline, pixels; NaN without an edge.
    cost, cost_true : float
        Robust cost of the edges at the fitted and at the true pose; NaN without evidence.
    """

    q: Float[np.ndarray, " j"]
    error: Float[np.ndarray, " j"]
    trial_error: Float[np.ndarray, " j"]
    off: tuple[Float[np.ndarray, " n"], ...]
    cost: float
    cost_true: float


def truth_facts(past: Replay, true: Float[np.ndarray, " j"]) -> TruthFacts:
    """Hold a frame against its true pose, given in radians with all joints."""
    model = past.on[0].model
    slides, scale = prismatic_joints(model), joint_scale(model)
    trial = pose_from_free(model, _with_true_prediction(past, true).u)
    errors = joint_error(np.stack([past.frame.q, trial]), np.stack([true, true]), slides) * scale
    off = tuple(off_truth(past, view, true) for view in range(len(past.on)))
    return TruthFacts(true, errors[0], errors[1], off, *_costs(past, true[model.free]))


def _with_true_prediction(past: Replay, true: Float[np.ndarray, " j"]) -> Estimate:
    """The frame measured again, as sure of the truth as it was of its prediction."""
    model, motion = past.on[0].model, past.ahead.motion
    u = true[model.free]
    x = motion.x.copy()
    x[: u.size] = u
    known = Known(past.on, past.settings, appearance_of(past), past.before.consistency, past.before.stored)
    return estimate(past.images, known, replace(motion, x=x), u, past.settings.passes, 1.0)


def _costs(past: Replay, true: Float[np.ndarray, " k"]) -> tuple[float, float]:
    found = past.frame.estimate
    if found.fit is None or found.rows is None:
        return np.nan, np.nan
    white = whitener(found.rows.sigma, found.rows.group, past.before.consistency.scatter)
    costs = []
    for u in (found.u, true):
        r, _ = white(*found.rows.residual(u))
        costs.append(float(0.5 * CAUCHY_C**2 * np.log1p((r / (CAUCHY_C * found.fit.spread)) ** 2).sum()))
    return costs[0], costs[1]
