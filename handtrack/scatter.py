"""Residuals of a solved frame in, how far the edges really scatter out: the sigmas of a pose are only as honest as
this.

Edge errors of one side of a link share a cause: a shading that is slightly off, a radius that is slightly wrong. So the
error of edge i in group c is modelled as

    e_i = s sigma_i eps_i + tau b_c,      eps, b standard normal

with a factor s on the claimed sigmas and a common offset of standard deviation tau pixels. Both are found by the
method of moments from the residuals left after the solve, corrected for what the solve has absorbed: scatter within
the groups tells s, scatter between their means tau. Both are averaged over frames: where the model is wrong, tau
grows by itself and every sigma with it. Generalised least squares under this model only needs a share of each group's
weighted mean taken off residuals and Jacobian (`Whitener`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from . import _kernels
from .residuals import Residual

_MEMORY = 0.85  # weight of earlier frames
_CUT, _OUTLIER = 2.5, 5.0
_LEAST_S2, _LEAST_TAU = 0.5, 0.03
_FIRST_TAU = 0.03  # pixels
_FIRST_WEIGHT = 0.1  # of the first guess, in frames


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """Running moments and what follows from them.

    Attributes
    ----------
    s, tau : float
        Factor on the claimed sigmas, and standard deviation of the common offset of a group, pixels.
    moments, response : (2,), (2, 2)
        Accumulated sums of squares within and between groups, and their expectation per unit of `s^2` and `tau^2`.
    """

    s: float
    tau: float
    moments: Float[np.ndarray, " 2"]
    response: Float[np.ndarray, "2 2"]


def first_scatter() -> Scatter:
    """Before any frame: sigmas as claimed, offsets of a twentieth of a pixel."""
    response = _FIRST_WEIGHT * np.eye(2)
    return Scatter(1.0, _FIRST_TAU, response @ [1.0, _FIRST_TAU**2], response)


def common_share(
    sigma: Float[np.ndarray, " n"], group: Int[np.ndarray, " n"], s: float, tau: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " c"]]:
    """Unit vector of each group in units of sigma, and the share of it to take off.

    In these units the covariance of a group is `I + t v v^T` with `v_i` proportional to `1 / sigma_i` and
    `t = tau^2 sum(1 / (s sigma_i)^2)`; its inverse square root is `I - (1 - 1 / sqrt(1 + t)) v v^T`.
    """
    weight = 1.0 / (s * sigma) ** 2
    total = np.bincount(group, weight)
    share = 1.0 - 1.0 / np.sqrt(1.0 + tau**2 * total)
    return np.sqrt(weight / np.maximum(total[group], 1e-300)), share


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """Linear map from errors in units of sigma to independent errors of unit variance.

    `v` and `share` are those of `common_share`.
    """

    s: float
    group: Int[np.ndarray, " n"]
    v: Float[np.ndarray, " n"]
    share: Float[np.ndarray, " c"]

    def __call__(
        self, r: Float[np.ndarray, " n"], J: Float[np.ndarray, "n k"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n k"]]:
        """Whitened copies of a vector and of the columns of a matrix."""
        r, J = r.copy(), np.array(J, order="C")
        _kernels.whiten_rows(r, J, self.v, self.share, self.group, self.s)
        return r, J


def whiten_numpy(white: Whitener, rows: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
    """What a `Whitener` does to columns, in plain NumPy: the twin of the compiled kernel."""
    member = (white.group == np.arange(white.share.size)[:, None]) * white.v
    return (rows - (member * white.share[:, None]).T @ (member @ rows)) / white.s


def whitener(sigma: Float[np.ndarray, " n"], group: Int[np.ndarray, " n"], scatter: Scatter) -> Whitener:
    """The map for edges of these sigmas and groups."""
    return Whitener(scatter.s, group, *common_share(sigma, group, scatter.s, scatter.tau))


@dataclass(frozen=True, slots=True, eq=False)
class Whitened:
    """A residual function in units of sigma, made independent and of unit variance."""

    residual: Residual
    white: Whitener

    def __call__(self, u: Float[np.ndarray, " k"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n k"]]:
        return self.white(*self.residual(u))


def learn_scatter(
    scatter: Scatter,
    r: Float[np.ndarray, " n"],
    J: Float[np.ndarray, "n k"],
    z: Float[np.ndarray, " n"],
    sigma: Float[np.ndarray, " n"],
    group: Int[np.ndarray, " n"],
    gain: Float[np.ndarray, "k n"],
) -> Scatter:
    """Blend one frame's residuals in.

    Parameters
    ----------
    r, J : (n,), (n, k)
        Residuals and Jacobian in units of sigma at the solution.
    z : (n,)
        Size of the residuals in units of their robust scale: edges beyond 5 are left out, beyond 2.5 cut down to it.
    gain : (k, n)
        Linear map from edge errors in units of sigma to the solution's error.
    """
    kept = z < _OUTLIER
    r = (r * sigma * np.minimum(1.0, _CUT / np.maximum(z, 1e-9)))[kept]
    J, gain = (J * sigma[:, None])[kept], (gain / sigma)[:, kept]
    w = 1.0 / sigma[kept] ** 2
    occurs = np.bincount(group[kept]) > 0
    member = (np.cumsum(occurs) - 1)[group[kept]]
    found, expected = _kernels.scatter_moments(r, J, w, member, int(occurs.sum()), np.ascontiguousarray(gain))
    size = np.diag(expected)  # both moments as means, so that frames count alike
    moments = _MEMORY * scatter.moments + found / size
    response = _MEMORY * scatter.response + expected / size[:, None]
    s2, tau2 = np.linalg.solve(response, moments)
    if tau2 < _LEAST_TAU**2:
        s2, tau2 = moments[0] / response[0, 0], _LEAST_TAU**2
    return Scatter(float(np.sqrt(max(s2, _LEAST_S2))), float(np.sqrt(tau2)), moments, response)


def moments_numpy(
    r: Float[np.ndarray, " n"],
    J: Float[np.ndarray, "n k"],
    w: Float[np.ndarray, " n"],
    member: Int[np.ndarray, " n"],
    groups: int,
    gain: Float[np.ndarray, "k n"],
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "2 2"]]:
    """A frame's moments and their response to `s^2` and `tau^2`, in plain NumPy: the twin of the compiled kernel.

    Parameters
    ----------
    r, J, w : (n,), (n, k), (n,)
        Residuals and Jacobian in pixels, and inverse squares of the claimed sigmas.
    member, groups : (n,), int
        Group of each edge, numbered from 0 without gaps, and how many there are.
    gain : (k, n)
        Linear map from edge errors in pixels to the solution's error.
    """
    Z = (member[:, None] == np.arange(groups)).astype(float)
    weight_of = Z.T @ w
    mean = (Z * w[:, None]).T / weight_of[:, None]
    left_of_groups = Z - J @ (gain @ Z)  # what a common offset leaves in each residual
    means_of_groups = mean @ left_of_groups
    means_of_edges = mean - (mean @ J) @ gain  # what the group means see of each edge's error
    # What the solve takes out of the sum of squares, for a gain that is not that of plain least squares.
    absorbed = float((((J * w[:, None]).T @ J) * ((gain / w) @ gain.T)).sum() - 2.0 * (J * gain.T).sum())
    within_groups = left_of_groups - Z @ means_of_groups
    mean_r = mean @ r
    moments = np.array([(w * (r - Z @ mean_r) ** 2).sum(), (weight_of * mean_r**2).sum()])
    between = float((weight_of * (means_of_edges**2 @ (1.0 / w))).sum())
    return moments, np.array(
        [
            [max(r.size + absorbed - between, 1.0), (w[:, None] * within_groups**2).sum()],
            [between, (weight_of[:, None] * means_of_groups**2).sum()],
        ]
    )
