"""A fitted frame in, an honest covariance out: noise, scatter the sigmas did not claim, and a shape that may be wrong.

Neither scatter nor shape changes from frame to frame, so both are learnt a little from each and kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from .fit import Fit
from .link_shape import shape_root, shape_rows
from .residuals import Chain, LineFeatures, OutlineFeatures, Rows
from .scatter import Scatter, Whitener, first_scatter, learn_scatter, whitener
from .shape_error import ShapeError, first_shape_error, learn_shape_error, shape_jacobian

_PLAIN_S, _PLAIN_TAU = 2.0, 0.1  # scatter that a right model may show
_YOUNG, _EVERY = 12, 4  # frames learnt from one by one, and how often after that


@dataclass(frozen=True, slots=True, eq=False)
class Consistency:
    """What earlier frames told of the scatter and the shape, and the shape's share of the pose covariance."""

    scatter: Scatter
    shape: ShapeError
    shape_covariance: Float[np.ndarray, "k k"]
    frames: int


def first_consistency(joints: int) -> Consistency:
    """Before any frame."""
    return Consistency(first_scatter(), first_shape_error(), np.zeros((joints, joints)), 0)


def assess(
    known: Consistency,
    on: Sequence[Chain],
    features: Sequence[OutlineFeatures | LineFeatures],
    evidence: Rows,
    white: Whitener,
    found: Fit,
    covariance: Float[np.ndarray, "k k"],
    prior: Float[np.ndarray, "k k"],
) -> Consistency:
    """Learn from a fitted frame of all views; `covariance` and `prior` are those of the pose with and without it.

    Once settled, only every fourth frame is looked at: the shape does not change, and the look costs half a
    millisecond.
    """
    if known.frames >= _YOUNG and known.frames % _EVERY:
        return replace(known, frames=known.frames + 1)
    r, J = evidence.residual(found.u)
    # K maps edge errors in units of sigma to errors of the pose.
    K = covariance @ white(found.r, found.J * found.weight[:, None] / found.spread**2)[1].T
    H = np.concatenate([shape_jacobian(*view, found.u) for view in zip(on, features, strict=True)])
    shape, suggested = _shape_evidence(known, evidence, found, r, J, H, prior)
    z = np.abs(found.r / found.spread)
    scatter = learn_scatter(known.scatter, r - H @ suggested, J, z, evidence.sigma, evidence.group, K)
    shaped = np.hstack([shape.eps * (K @ H), K @ _calibrated(on, features, found.u)])
    return Consistency(scatter, shape, shaped @ shaped.T, known.frames + 1)


def _calibrated(
    on: Sequence[Chain], features: Sequence[OutlineFeatures | LineFeatures], u: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "n p"]:
    """What the shape's independent errors, a sigma each, do to the residuals, where the model file tells of them."""
    root = shape_root(on[0].model)
    rows = [part for part in features if isinstance(part, OutlineFeatures)]
    if not root.size or len(rows) < len(features):
        return np.zeros((sum(_count(part) for part in features), 0))
    return np.concatenate([shape_rows(on[0].model, part, u) for part in rows]) @ root


def _count(part: OutlineFeatures | LineFeatures) -> int:
    return part.link.size if isinstance(part, OutlineFeatures) else 2 * (part.tip_link.size + part.line_link.size)


def _shape_evidence(
    known: Consistency,
    evidence: Rows,
    found: Fit,
    r: Float[np.ndarray, " n"],
    J: Float[np.ndarray, "n k"],
    H: Float[np.ndarray, "n p"],
    prior: Float[np.ndarray, "k k"],
) -> tuple[ShapeError, Float[np.ndarray, " p"]]:
    """Evidence of a wrong shape, judged by the scatter of a right model: else the scatter explains everything first."""
    scatter = known.scatter
    least = replace(scatter, s=min(scatter.s, _PLAIN_S), tau=min(scatter.tau, _PLAIN_TAU))
    root = np.sqrt(found.weight)
    r, both = whitener(evidence.sigma, evidence.group, least)(r, np.hstack([J, H]))
    r, both = root * r, root[:, None] * both
    J, H = both[:, : J.shape[1]], both[:, J.shape[1] :]
    return learn_shape_error(known.shape, r, H, J, np.linalg.inv(J.T @ J + np.linalg.inv(prior)))
