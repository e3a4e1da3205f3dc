"""One image and a prediction in, the pose that image and prediction agree on out: look, fit, and look again.

The second look starts from the fitted pose, so that templates are rendered where the hand is; it ends when the edges
rest.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .appearance import Appearance
from .consistency import Consistency, assess
from .edges import BORDER
from .fit import fit
from .measure import Look, look
from .measure_lines import look_lines
from .residuals import Chain, rows
from .scatter import whitener
from .settings import Settings
from .smooth import KalmanState

_REST, _REST_AT_ONCE = (
    0.08,
    1.0,
)  # largest motion of an edge, in pixels, at which the frame is done; after the first look
_MOST_BORDER, _WIDEST = 0.06, 8.0  # share of edges at the end of their search range that asks for a wider one
_CLOSE = 1.0  # motion of the edges, in pixels, within which templates need not be rendered again
_LEAST_ROWS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """One frame's result, in independent joints.

    Attributes
    ----------
    u, covariance : (k,), (k, k)
        Fitted pose, and its covariance from noise, scatter and prediction alone.
    information : (k, k)
        What the image alone says; zero where it says nothing.
    seen : Look
        The last look.
    residual : float
        Root mean square residual, pixels.
    consistency : Consistency
        Scatter and shape error with this frame learnt.
    widen : float
        How much wider than predicted the search had to be.
    """

    u: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    information: Float[np.ndarray, "k k"]
    seen: Look
    residual: float
    consistency: Consistency
    widen: float


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What does not change while one frame is looked at."""

    on: Chain
    settings: Settings
    appearance: Appearance
    consistency: Consistency
    stored: Float[np.ndarray, "n m"] | None


def estimate(
    image: Float[np.ndarray, "h w"],
    known: Known,
    motion: KalmanState,
    start: Float[np.ndarray, " k"],
    passes: int,
    widen: float,
) -> Estimate:
    """Look and fit in turn until the pose rests.

    Parameters
    ----------
    motion : KalmanState
        The prediction.
    start : (k,)
        Where to look first: the prediction, or a better guess.
    passes, widen : int, float
        Most looks, and the factor on the search ranges of the first.
    """
    prior = motion.covariance
    prior_information = np.linalg.inv(prior)
    root = np.linalg.cholesky(prior_information).T
    u, search = start, prior
    scatter = known.consistency.scatter
    done, moved = None, np.inf
    # One look is enough where every edge was found by itself and the fit ran to its end.
    quick = known.settings.residuals == "outline" and known.settings.solver != "gauss-newton-one"
    for number in range(passes):
        before = done[0] if done is not None and moved < _CLOSE else None
        seen = _look(image, known, u, search, widen, before)
        evidence = rows(known.on, seen.features, seen.samplers.side[seen.found])
        if evidence.sigma.size < _LEAST_ROWS:
            search, widen = search * 4.0, min(2.0 * widen, _WIDEST)
            continue
        white = whitener(evidence.sigma, evidence.group, scatter)
        found = fit(known.on, seen.features, evidence, white, u, motion.q, root, known.settings, number == 0)
        covariance = np.linalg.inv(found.information + prior_information)
        moved = float(np.abs(found.J @ (found.u - u) * evidence.sigma).max()) * scatter.s
        u, search, done = found.u, 2.0 * covariance, (seen, evidence, white, found, covariance)
        border = (seen.edges.reason == BORDER).sum() > _MOST_BORDER * seen.expected.sum()
        widen = min(2.0 * widen, _WIDEST) if border else widen
        at_once = _REST_AT_ONCE if quick else 0.0
        if not border and moved < (_REST if number else at_once):
            break
    if done is None:
        return Estimate(motion.q, prior, np.zeros_like(prior), seen, 0.0, known.consistency, widen)
    seen, evidence, white, found, covariance = done
    consistency = assess(known.consistency, known.on, seen.features, evidence, white, found, covariance, prior)
    pixels = float(np.sqrt(np.mean((evidence.residual(u)[0] * evidence.sigma) ** 2)))
    return Estimate(u, covariance, found.information, seen, pixels, consistency, widen)


def _look(
    image: Float[np.ndarray, "h w"],
    known: Known,
    u: Float[np.ndarray, " k"],
    search: Float[np.ndarray, "k k"],
    widen: float,
    before: Look | None,
) -> Look:
    if known.settings.residuals == "outline":
        return look(image, known.on, u, search, known.appearance, known.settings, widen, before)
    return look_lines(image, known.on, u, search, known.appearance, known.settings, known.stored, widen)
