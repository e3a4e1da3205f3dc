"""Images and a prediction in, the pose that images and prediction agree on out: look, fit, and look again.

The second look starts from the fitted pose, so that templates are rendered where the hand is; it ends when the edges
rest. Edges of all views go into one stacked residual.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .appearance import Appearance
from .consistency import Consistency, assess
from .edges import BORDER
from .fit import Fit, fit
from .measure import Look, look
from .measure_lines import look_lines
from .refine import refine
from .residuals import Chain, Rows, rows, stack_features, stack_rows
from .scatter import Whitener, whitener
from .settings import Settings
from .smooth import KalmanState
from .synthesis import Unmodelled

_REST, _REST_AT_ONCE = (
    0.08,
    1.0,
)  # largest motion of an edge, in pixels, at which the frame is done; after the first look
_MOST_BORDER, _WIDEST = 0.06, 8.0  # share of edges at the end of their search range that asks for a wider one
_CLOSE = 1.0  # motion of the edges, in pixels, within which templates need not be rendered again
_LEAST_ROWS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What is known of the pose before the images: mean, covariance and its inverse."""

    mean: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    information: Float[np.ndarray, "k k"]


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """One frame's result, in independent joints.

    Attributes
    ----------
    u, covariance : (k,), (k, k)
        Fitted pose, and its covariance from noise, scatter and prediction alone.
    information : (k, k)
        What the images alone say; zero where they say nothing.
    prior : Prior
        Prediction and soft couplings, as they went into the fit.
    seen : tuple of Look
        The last look, at each view.
    fit, rows : Fit or None, Rows or None
        The last fit and its residual rows, those of all views stacked; None without evidence.
    residual : float
        Root mean square residual, pixels.
    consistency : Consistency
        Scatter and shape error with this frame learnt.
    widen : float
        How much wider than predicted the search had to be.
    unmodelled : tuple of Unmodelled
        What refinement learnt of the errors of surface and shape, in each view.
    """

    u: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    information: Float[np.ndarray, "k k"]
    prior: Prior
    seen: tuple[Look, ...]
    fit: Fit | None
    rows: Rows | None
    residual: float
    consistency: Consistency
    widen: float
    unmodelled: tuple[Unmodelled, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What does not change while one frame is looked at; tuples have one entry for each view."""

    on: tuple[Chain, ...]
    settings: Settings
    appearance: tuple[Appearance, ...]
    consistency: Consistency
    stored: tuple[Float[np.ndarray, "n m"] | None, ...]
    unmodelled: tuple[Unmodelled, ...] = ()


_Done = tuple[tuple[Look, ...], Rows, Whitener, Fit, Float[np.ndarray, "k k"]]  # what one round of the loop leaves


def prior_of(on: Chain, motion: KalmanState) -> Prior:
    """The prediction with the model's soft couplings taken in.

    They belong to the frame and not to the filter: a coupling that is off is off in every frame, so a filter that took
    it for news each time would trust it more and more.
    """
    soft = on.model.soft
    information = np.linalg.inv(motion.covariance)
    if not soft.size:
        return Prior(motion.q, motion.covariance, information)
    both = information + soft.T @ soft
    covariance = np.linalg.inv(both)
    mean = covariance @ (information @ motion.q + soft.T @ on.model.soft_target)
    return Prior(mean, covariance, both)


def estimate(
    images: Sequence[Float[np.ndarray, "h w"]],
    known: Known,
    motion: KalmanState,
    start: Float[np.ndarray, " k"],
    passes: int,
    widen: float,
) -> Estimate:
    """Look and fit in turn until the pose rests.

    Parameters
    ----------
    images : sequence of (h, w)
        One image for each view.
    motion : KalmanState
        The prediction.
    start : (k,)
        Where to look first: the prediction, or a better guess.
    passes, widen : int, float
        Most looks, and the factor on the search ranges of the first.
    """
    prior = prior_of(known.on[0], motion)
    root = np.linalg.cholesky(prior.information).T
    u, search = start, prior.covariance
    scatter = known.consistency.scatter
    done, moved = None, np.inf
    # One look is enough where every edge was found by itself and the fit ran to its end.
    quick = known.settings.residuals == "outline" and known.settings.solver != "gauss-newton-one"
    for number in range(passes):
        before = done[0] if done is not None and moved < _CLOSE else (None,) * len(known.on)
        seen = _look(images, known, u, search, widen, before)
        features = [view.features for view in seen]
        evidence = _evidence(known.on, seen)
        if evidence.sigma.size < _LEAST_ROWS:
            search, widen = search * 4.0, min(2.0 * widen, _WIDEST)
            continue
        white = whitener(evidence.sigma, evidence.group, scatter)
        stacked = stack_features(features)
        found = fit(known.on[0], stacked, evidence, white, u, prior.mean, root, known.settings, number == 0)
        covariance = np.linalg.inv(found.information + prior.information)
        moved = float(np.abs(found.J @ (found.u - u) * evidence.sigma).max()) * scatter.s
        u, search, done = found.u, 2.0 * covariance, (seen, evidence, white, found, covariance)
        border = sum((view.edges.reason == BORDER).sum() for view in seen) > _MOST_BORDER * _expected(seen)
        widen = min(2.0 * widen, _WIDEST) if border else widen
        at_once = _REST_AT_ONCE if quick else 0.0
        if not border and moved < (_REST if number else at_once):
            break
    if done is None:
        nothing = np.zeros_like(prior.covariance)
        return Estimate(prior.mean, prior.covariance, nothing, prior, seen, None, None, 0.0, known.consistency, widen)
    seen, evidence, white, found, covariance = done
    unmodelled = known.unmodelled or (Unmodelled(),) * len(known.on)
    if known.settings.refine and known.settings.residuals == "outline":
        before = prior.mean, prior.information
        refined = refine(images, known.on, evidence, white, known.appearance, unmodelled, found.u, *before, scatter)
        found, unmodelled = refined.fit, refined.unmodelled
        covariance = np.linalg.inv(found.information + prior.information)
    u = found.u
    features = [view.features for view in seen]
    consistency = assess(known.consistency, known.on, features, evidence, white, found, covariance, prior.covariance)
    pixels = float(np.sqrt(np.mean((evidence.residual(u)[0] * evidence.sigma) ** 2)))
    return Estimate(
        u, covariance, found.information, prior, seen, found, evidence, pixels, consistency, widen, unmodelled
    )


def _expected(seen: Sequence[Look]) -> int:
    return sum(int(view.expected.sum()) for view in seen)


def _evidence(on: Sequence[Chain], seen: Sequence[Look]) -> Rows:
    return stack_rows(
        [rows(chain, view.features, view.samplers.side[view.found]) for chain, view in zip(on, seen, strict=True)]
    )


def _look(
    images: Sequence[Float[np.ndarray, "h w"]],
    known: Known,
    u: Float[np.ndarray, " k"],
    search: Float[np.ndarray, "k k"],
    widen: float,
    before: Sequence[Look | None],
) -> tuple[Look, ...]:
    """One look at each view."""
    settings, views = known.settings, range(len(known.on))
    if settings.residuals == "outline" and settings.edges == "wssd":
        return tuple(
            look(images[v], known.on[v], u, search, known.appearance[v], settings, widen, before[v]) for v in views
        )
    return tuple(
        look_lines(images[v], known.on[v], u, search, known.appearance[v], settings, known.stored[v], widen)
        for v in views
    )
