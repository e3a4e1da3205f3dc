"""Images and an aligned pose in, a pose refined against edges and pixels together out (analysis by synthesis).

The smooth image of the posed pills (`soft_image`) is compared with the image itself, on outlines, on creases and inside
surfaces (`synthesis`), together with the edges and the prediction:

    minimise  sum rho((seen - I(u) - B b) / sigma) + |b / spread|^2 + |edges(u)|^2 / 4 + |u - mean|^2_prior

over the pose u and, for every patch of surface, a relative error of its grey level and an outward shift b. Outlines
tell most, but only from within a pixel; the edges, which see farther, keep the solve where it belongs.
They are measured in the same image, so they count for a quarter of what they would by themselves. How large the errors
b are is learnt from frame to frame (`Unmodelled`), so the covariance knows what neither pills nor shading express.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from .appearance import Appearance
from .fit import Fit
from .kinematics import forward, pose_from_free
from .residuals import Chain, Rows
from .robust import cauchy_weight, median
from .scatter import Scatter, Whitened, Whitener
from .synthesis import Differences, Unmodelled, differences, link_twists, samples_of
from .unmodelled import learn_unmodelled

_ANNEAL = (0.6, 0.2, 0.0)  # pixels by which outlines may still be off in each step
_EDGES = 0.25
_RIGHT_TAU, _RIGHT_S = 0.3, 1.5  # scatter of edges that a right model may show, while it is still being learnt
_STILL = 1e-3  # radians: a step within which the rows need not be rendered again


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """The refined fit, and what was learnt of the unmodelled errors in each view."""

    fit: Fit
    unmodelled: tuple[Unmodelled, ...]


def refine(
    images: Sequence[Float[np.ndarray, "h w"]],
    on: Sequence[Chain],
    edges: Rows,
    white: Whitener,
    appearance: Sequence[Appearance],
    unmodelled: Sequence[Unmodelled],
    u: Float[np.ndarray, " k"],
    mean: Float[np.ndarray, " k"],
    prior: Float[np.ndarray, "k k"],
    scatter: Scatter,
) -> Refined:
    """Align edges, pixels and prediction in one solve.

    Parameters
    ----------
    images, on, appearance, unmodelled : sequences
        One for each view.
    edges, white : Rows, Whitener
        Edge rows of all views.
    u : (k,)
        Pose from the edges alone, within a pixel or so.
    mean, prior : (k,), (k, k)
        Prediction and its information.
    scatter : Scatter
        How far edges have scattered about the outline so far.

    Returns
    -------
    Refined
        The fit's residuals and Jacobian are those of the edges, its information that of edges and pixels.
    """
    whitened, limits = Whitened(edges.residual, white), on[0].model.limits[on[0].model.free]
    trust = trusted(scatter)
    wrong = scatter.tau if trust < 1.0 else 0.0
    edge_share = 1.0 - (1.0 - _EDGES) * trust  # edges count in full where pixels do not
    doubted = [replace(rest, shift=float(np.hypot(rest.shift, wrong))) for rest in unmodelled]
    views = list(zip(images, on, appearance, doubted, strict=True))
    chosen = [samples_of(image, view, its, u, rest.table) for image, view, its, rest in views]
    frames = forward(on[0].model, pose_from_free(on[0].model, u))
    twists = [link_twists(view, frames) @ view.model.coupling for view in on]
    shift = [np.zeros((12 * view.model.link_frame.size, 2)) for view in on]
    found: list[Differences] = []
    for number, loose in enumerate(_ANNEAL):
        found = [
            differences(samples, view, its, rest, u, b, loose, seen if number == 0 else None, G)
            for (samples, seen), (_, view, its, rest), b, G in zip(chosen, views, shift, twists, strict=True)
        ]
        g, A = prior @ (mean - u), prior.copy()
        r, J = whitened(u)
        weighted = J * _edge_weight(r)[:, None]
        g, A = g - edge_share * (weighted.T @ r), A + edge_share * (weighted.T @ J)
        for each in found:
            g, A = g + trust * each.score.sum(axis=0), A + trust * each.A
        after = _step(u, g, A, limits)
        shift = [b + each.answer(after - u) for b, each in zip(shift, found, strict=True)]
        still, u = bool(np.abs(after - u).max() < _STILL), after
        if still and number:
            break
    r, J = whitened(u)
    weight = _edge_weight(r)
    spread = max(1.0, 1.4826 * median(np.abs(r)))
    information = edge_share * (J * weight[:, None]).T @ J
    for each in found:
        information = information + trust * each.A
    learnt = tuple(
        learn_unmodelled(rest, each, b, its.gain)
        for its, rest, each, b in zip(appearance, unmodelled, found, shift, strict=True)
    )
    return Refined(Fit(u, r, J, weight * spread**2, spread, information), learnt)


def trusted(scatter: Scatter) -> float:
    """Share of the pixels' information to believe: all of it for pills, next to none where edges say it is no pill.

    Edges of rendered pills scatter little more than they claim. On a hand that no pills fit they scatter three times
    as much; its surface then faces other ways than that of the pills, so that shading misleads.

    >>> from .scatter import first_scatter
    >>> right = first_scatter()
    >>> trusted(right), round(trusted(replace(right, s=3.0)), 4)
    (1.0, 0.0039)
    """
    misfit = max(scatter.tau / _RIGHT_TAU, scatter.s / _RIGHT_S)
    return min(1.0, misfit**-8.0)


def _edge_weight(r: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    spread = max(1.0, 1.4826 * median(np.abs(r)))
    return cauchy_weight(r / spread) / spread**2


def _step(
    u: Float[np.ndarray, " k"],
    g: Float[np.ndarray, " k"],
    A: Float[np.ndarray, "k k"],
    limits: Float[np.ndarray, "k 2"],
) -> Float[np.ndarray, " k"]:
    """One Gauss-Newton step up the gradient g inside the limits."""
    free = ~((u <= limits[:, 0]) & (g < 0.0) | (u >= limits[:, 1]) & (g > 0.0))
    h = np.zeros(u.size)
    h[free] = np.linalg.solve(A[np.ix_(free, free)], g[free])
    return np.clip(u + h, limits[:, 0], limits[:, 1])
