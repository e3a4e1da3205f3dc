"""Evidence of one look and a prediction in, the pose that fits both best out.

The cost is that of `solve` on `WithPrior(Robust(Whitened(residual)))`. For outlines and the default solver the same
iteration runs compiled; every other combination goes through `solve`.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from . import _kernels
from .residuals import Chain, OutlineFeatures, Robust, Rows, Weighted, WithPrior
from .robust import cauchy_weight, median
from .scatter import Whitened, Whitener
from .settings import Settings
from .solve import solve

_STEPS, _TOLERANCE = 8, 1e-5  # radians


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fitted pose.

    Attributes
    ----------
    u : (k,)
        Independent joints.
    r, J : (n,), (n, k)
        Whitened residuals and Jacobian there.
    weight, spread : (n,), float
        Cauchy weights, and the robust scale they are relative to.
    information : (k, k)
        What the image alone says of the pose.
    """

    u: Float[np.ndarray, " k"]
    r: Float[np.ndarray, " n"]
    J: Float[np.ndarray, "n k"]
    weight: Float[np.ndarray, " n"]
    spread: float
    information: Float[np.ndarray, "k k"]


def fit(
    on: Chain,
    features: object,
    evidence: Rows,
    white: Whitener,
    u: Float[np.ndarray, " k"],
    mean: Float[np.ndarray, " k"],
    root: Float[np.ndarray, "k k"],
    settings: Settings,
    rescale: bool,
) -> Fit:
    """Fit the pose from u, with the prediction `mean` of information `root.T @ root`.

    Parameters
    ----------
    rescale : bool
        Fit twice, the second time with the robust scale of the first: for the first look at a frame, whose residuals at
        the start are mostly error of the prediction.
    """
    if isinstance(features, OutlineFeatures) and settings.solver == "levenberg-marquardt" and features.link.size:
        return _compiled(on, features, white, u, mean, root, rescale)
    return fit_numpy(on, evidence, white, u, mean, root, settings, rescale)


def fit_numpy(
    on: Chain,
    evidence: Rows,
    white: Whitener,
    u: Float[np.ndarray, " k"],
    mean: Float[np.ndarray, " k"],
    root: Float[np.ndarray, "k k"],
    settings: Settings,
    rescale: bool,
) -> Fit:
    """The same as `fit` in plain NumPy, for any kind of residual and any solver: the twin of the compiled kernel."""
    edges = Whitened(evidence.residual, white)
    spread = max(1.0, 1.4826 * median(np.abs(edges(u)[0])))
    for again in (rescale, False):
        u = _solved(on, edges, spread, u, mean, root, settings)
        r, J = edges(u)
        before, spread = spread, max(1.0, 1.4826 * median(np.abs(r)))
        if not again or before < 1.3 * spread:
            break
    weight = cauchy_weight(r / spread)
    return Fit(u, r, J, weight, spread, (J * weight[:, None]).T @ J / spread**2)


def _compiled(
    on: Chain,
    features: OutlineFeatures,
    white: Whitener,
    u: Float[np.ndarray, " k"],
    mean: Float[np.ndarray, " k"],
    root: Float[np.ndarray, "k k"],
    rescale: bool,
) -> Fit:
    m = on.model
    low, high = m.limits[m.free].T
    tree = m.parent, m.prefix, m.joint, m.prismatic, m.link_frame, m.link_base, m.link_tip, m.link_radius
    u, r, J, weight, spread, information = _kernels.fit_frame(
        u,
        (features.ray, features.slope, features.link, features.sigma),
        (*tree, on.moves, on.joint_frame),
        (m.coupling, m.coupling_offset),
        on.plain,
        (white.v, white.share, white.group, white.s),
        mean,
        np.ascontiguousarray(root),
        np.ascontiguousarray(low),
        np.ascontiguousarray(high),
        _STEPS,
        _TOLERANCE,
        rescale,
    )
    return Fit(u, r, J, weight, float(spread), information)


def _solved(
    on: Chain,
    edges: Whitened,
    spread: float,
    u: Float[np.ndarray, " k"],
    mean: Float[np.ndarray, " k"],
    root: Float[np.ndarray, "k k"],
    settings: Settings,
) -> Float[np.ndarray, " k"]:
    limits = on.model.limits[on.model.free]
    one = settings.solver == "gauss-newton-one"
    method = "gauss-newton" if one else settings.solver
    descends = method in ("levenberg-marquardt", "trust-region")
    # A full step on the robust cost overshoots where edges are off: those methods get weights fixed at the start.
    cost = Robust(edges, spread) if descends else Weighted(edges, np.sqrt(cauchy_weight(edges(u)[0] / spread)) / spread)
    found = solve(
        WithPrior(cost, mean, root),
        u,
        method=method,
        bounds=limits if descends and np.isfinite(limits).any() else None,
        step=0.5 if method == "damped" else 1.0,
        max_steps=1 if one else _STEPS,
        tolerance=_TOLERANCE,
    )
    return np.clip(found.x, limits[:, 0], limits[:, 1])
