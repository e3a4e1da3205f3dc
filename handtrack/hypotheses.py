"""Poses that the images cannot tell apart in, how likely each is out, until one of them is left.

A link near the image plane may be folded to either side with the same outline (`folds`). Each such pose is a rival of
the tracked one, with a filter state of its own, and is measured in every frame like the tracked one. The logarithm of
its weight relative to the best,

    l_i <- f l_i - (cost_i - cost_best),        w_i = exp(l_i) / sum exp(l)

with f = 0.9 so that what was long ago is forgotten. The cost of a frame is half a chi-square: the whitened edges,
the grey levels of the surface (`shading_cost`), and the prediction. A rival is dropped at `l < -9`, and merged when it
is within a sigma of a better one. While rivals live the best is reported, with the second moment of all about it,

    C = sum_i w_i (C_i + d_i d_i^T),        d_i = u_i - u_best

which covers the truth whichever it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .estimate import Estimate, Known, estimate
from .folds import find_folds
from .kinematics import Model
from .observability import length_unit, sliding_joints
from .prediction import Prediction, correct, predict
from .residuals import Chain
from .shading_cost import loss, shading_cost

DROPPED = -9.0
AMBIGUOUS = np.radians(5.0)  # difference of two poses at a joint that is worth telling
_FORGET = 0.9
_RIVALS = 3
_EDGES = 0.5  # share of an edge's evidence: neighbours have errors in common that whitening does not know
_USUAL, _MISSING = 0.42, 1.0  # cost of an edge of a right pose, mean of the loss; and of one that should be there
_COINCIDE = 1.0
_CHANGED = np.radians(1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Hypotheses:
    """Poses with their covariances and log weights (any constant may be added to all), radians."""

    u: Float[np.ndarray, "m k"]
    covariance: Float[np.ndarray, "m k k"]
    log_weight: Float[np.ndarray, " m"]


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """A pose that may be the right one: its filter state, and its log weight relative to the tracked pose."""

    prediction: Prediction
    log_ratio: float


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """The best pose of a frame and what speaks against it.

    Attributes
    ----------
    found, ahead : Estimate, Prediction
        Of the best hypothesis.
    covariance : (k, k)
        Of the best pose, all hypotheses and close folds counted.
    close : (p, k)
        Displacements to close folds of the best pose, times the roots of their weights.
    rivals : tuple of Rival
        Corrected by this frame.
    other, other_weight : (k,) or None, float
        The likeliest rival's pose and weight.
    """

    found: Estimate
    ahead: Prediction
    covariance: Float[np.ndarray, "k k"]
    rivals: tuple[Rival, ...]
    close: Float[np.ndarray, "p k"]
    other: Float[np.ndarray, " k"] | None
    other_weight: float


def weights(log_weight: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Weights that sum to one.

    >>> weights(np.array([0.0, -np.log(3.0)])).round(2).tolist()
    [0.75, 0.25]
    """
    w = np.exp(log_weight - log_weight.max())
    return w / w.sum()


def updated(
    log_weight: Float[np.ndarray, " m"], cost: Float[np.ndarray, " m"], forget: float = _FORGET
) -> Float[np.ndarray, " m"]:
    """Log weights relative to the best after a frame of these costs."""
    new = forget * (log_weight - log_weight.max()) - cost
    return new - new.max()


def kept(hypotheses: Hypotheses, most: int = _RIVALS + 1) -> tuple[Int[np.ndarray, " r"], Float[np.ndarray, " r"]]:
    """Hypotheses that live on, the best first, and their log weights: the hopeless dropped, those that agree merged."""
    order = np.argsort(-hypotheses.log_weight, kind="stable")
    chosen: list[int] = []
    shares: list[float] = []
    for i in order.tolist():
        if hypotheses.log_weight[i] < hypotheses.log_weight[order[0]] + DROPPED:
            break
        same = next((n for n, j in enumerate(chosen) if coincide(hypotheses, i, j)), None)
        if same is not None:
            shares[same] = float(np.logaddexp(shares[same], hypotheses.log_weight[i]))
        elif len(chosen) < most:
            chosen.append(i)
            shares.append(float(hypotheses.log_weight[i]))
    return np.array(chosen), np.array(shares) - shares[0]


def coincide(hypotheses: Hypotheses, i: int, j: int) -> bool:
    """Whether two hypotheses lie within a sigma of their difference, or a degree apart."""
    difference = hypotheses.u[i] - hypotheses.u[j]
    if (np.abs(difference) < _CHANGED).all():
        return True
    both = hypotheses.covariance[i] + hypotheses.covariance[j]
    return float(difference @ np.linalg.solve(both, difference)) < _COINCIDE**2


def differ(model: Model, a: Float[np.ndarray, " k"], b: Float[np.ndarray, " k"]) -> bool:
    """Whether a joint of two poses differs by more than 5 degrees (sliding: times a typical link's length)."""
    scale = np.where(sliding_joints(model), length_unit(model), 1.0)
    return bool((np.abs(model.coupling @ (a - b)) > AMBIGUOUS * scale).any())


def about_best(hypotheses: Hypotheses) -> Float[np.ndarray, "k k"]:
    """Second moment of all hypotheses about the first: the mean square error of reporting it.

    >>> two = Hypotheses(np.array([[0.0], [4.0]]), np.array([[[1.0]], [[1.0]]]), np.log([0.75, 0.25]))
    >>> about_best(two).tolist()
    [[5.0]]
    """
    w = weights(hypotheses.log_weight)
    d = hypotheses.u - hypotheses.u[0]
    return (w[:, None, None] * (hypotheses.covariance + d[:, :, None] * d[:, None, :])).sum(axis=0)


def frame_cost(
    images: Sequence[Float[np.ndarray, "h w"]],
    known: Known,
    found: Estimate,
    compared: Bool[np.ndarray, " l"],
    spread: float = 1.0,
) -> float:
    """What a frame says against a pose fitted to it: edges, grey levels and prediction; half a chi-square.

    Parameters
    ----------
    compared : (l,)
        Links that count: those that the hypotheses do not have in common.
    spread : float
        Scatter of the whitened edges that the best of the hypotheses leaves, at least 1.
    """
    off = found.u - found.prior.mean
    cost = 0.5 * float(off @ found.prior.information @ off)
    if found.fit is None:
        return cost
    own = compared[np.concatenate([view.samplers.link[view.found] for view in found.seen])]
    missing = sum(int((view.expected & ~view.found & compared[view.samplers.link]).sum()) for view in found.seen)
    # Against the usual cost of an edge: a pose is no better for showing fewer of them.
    cost += _EDGES * (float((loss(found.fit.r[own], spread) - _USUAL).sum()) + _MISSING * missing)
    views = zip(images, known.on, known.appearance, strict=True)
    return cost + sum(
        float(shading_cost(image, on, found.u, its, compared)[compared].sum()) for image, on, its in views
    )


def in_question(on: Chain, u: Float[np.ndarray, "m k"]) -> Bool[np.ndarray, " l"]:
    """Links that some joint places differently in some of the poses."""
    changed = np.ptp(u, axis=0) @ (np.abs(on.model.coupling.T) > 0.0) > _CHANGED
    return (on.moves[on.model.link_frame] & changed).any(axis=1)


def judge(
    images: Sequence[Float[np.ndarray, "h w"]],
    known: Known,
    ahead: Prediction,
    found: Estimate,
    rivals: Sequence[Rival],
    dt: float,
    passes: int,
) -> Verdict:
    """Measure the rivals, look for new ones, and decide what is reported.

    Parameters
    ----------
    ahead, found : Prediction, Estimate
        Of the tracked pose.
    rivals : sequence of Rival
        Carried from the frame before, dt seconds ago.
    """
    tried, close = [(ahead, found, 0.0)], np.zeros((0, found.u.size))
    for rival in rivals:
        its = predict(rival.prediction, dt)
        tried.append((its, estimate(images, known, its.motion, its.motion.q, passes, 1.0), rival.log_ratio))
    if len(known.on) == 1 and found.fit is not None and len(rivals) < _RIVALS:  # a second view tells the sides apart
        folds = find_folds(known.on[0], found.u, found.prior.covariance, found.covariance)
        new = folds.poses[: _RIVALS - len(rivals)]
        tried += [(ahead, estimate(images, known, ahead.motion, other, passes, 1.0), 0.0) for other in new]
        if not known.settings.refine:  # whose grey levels tell the sides apart
            close = folds.close * np.sqrt(_prior_weights(found, folds.close))[:, None]
    if len(tried) == 1:
        return Verdict(found, ahead, found.covariance + close.T @ close, (), close, None, 0.0)
    u = np.array([estimated.u for _, estimated, _ in tried])
    covariance = np.array([estimated.covariance for _, estimated, _ in tried])
    before = np.array([log for *_, log in tried])
    compared = in_question(known.on[0], u)
    spread = min((estimated.fit.spread for _, estimated, _ in tried if estimated.fit is not None), default=1.0)
    cost = np.array([frame_cost(images, known, estimated, compared, spread) for _, estimated, _ in tried])
    chosen, log_weight = kept(Hypotheses(u, covariance, updated(before, cost)))
    best = tried[chosen[0]]
    left = Hypotheses(u[chosen], covariance[chosen], log_weight)
    following = tuple(
        Rival(corrected(*tried[i][:2]), float(log)) for i, log in zip(chosen[1:], log_weight[1:], strict=True)
    )
    if chosen[0] != 0:
        close = close[:0]
    other = left.u[1] if following else None
    share = float(weights(log_weight)[1]) if following else 0.0
    return Verdict(best[1], best[0], about_best(left) + close.T @ close, following, close, other, share)


def _prior_weights(found: Estimate, steps: Float[np.ndarray, "p k"]) -> Float[np.ndarray, " p"]:
    """Weight of each displaced pose against the found one, by the prediction alone: the images do not tell.

    Predictions follow the side taken before, so their errors are those of many frames: their odds count by the root.
    """
    before, after = found.u - found.prior.mean, found.u + steps - found.prior.mean
    more = ((after @ found.prior.information) * after).sum(axis=1) - before @ found.prior.information @ before
    return 1.0 / (1.0 + np.exp(np.clip(0.25 * more, -50.0, 50.0)))


def corrected(ahead: Prediction, found: Estimate, close: Float[np.ndarray, "p k"] | None = None) -> Prediction:
    """The filter state with a frame's estimate taken in.

    Parameters
    ----------
    close : (p, k), optional
        Displacements to close folds, times the roots of their weights: what the images measured is less sure by their
        second moment. The measurement itself stays, so the pose is the one that a prior of the same information and
        images that know less would have agreed on.
    """
    A, L, m = found.information, found.prior.information, found.prior.mean
    if close is None or not close.size or not A.any():
        return correct(ahead, found.u, A, m, L)
    cross = A @ close.T
    softer = A - cross @ np.linalg.solve(np.eye(close.shape[0]) + close @ cross, cross.T)
    of_images = A @ found.u + L @ (found.u - m)  # A z
    u = np.linalg.solve(softer + L, softer @ np.linalg.lstsq(A, of_images, rcond=1e-12)[0] + L @ m)
    return correct(ahead, u, softer, m, L)
