"""Weighted particles: log weights in, normalised weights, estimates, ellipsoids and new particles out.

A posterior is the cloud `sum_i w_i delta(x - x_i)` (wrist thesis, section 2.3). Weights are kept as logarithms, so that
a product of many likelihoods does not vanish; a particle that a constraint forbids has the weight -inf. After each
frame the cloud is drawn anew where its effective size `1 / sum_i w_i^2` is below a share of its particles: duplicates
follow the weights, by one of four schemes (Douc, Cappe & Moulines 2005, "Comparison of resampling schemes").
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtri

Scheme = Literal["systematic", "stratified", "residual", "multinomial"]
SCHEMES: tuple[Scheme, ...] = get_args(Scheme)


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoid:
    """Where a share of a normal distribution lies.

    Attributes
    ----------
    centre : (d,)
    axes : (d, d)
        Unit directions of the half axes, as columns.
    half : (d,)
        Their lengths, ascending.
    """

    centre: Float[np.ndarray, " d"]
    axes: Float[np.ndarray, "d d"]
    half: Float[np.ndarray, " d"]


def normalised(log_weight: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Weights that sum to one; all zero where every particle is dead.

    Raises
    ------
    ValueError
        If a weight is NaN or +inf.

    >>> normalised(np.array([0.0, np.log(3.0), -np.inf])).tolist()
    [0.25, 0.75, 0.0]
    """
    if np.isnan(log_weight).any() or (log_weight == np.inf).any():
        raise ValueError("log_weight: holds NaN or +inf; finite numbers and -inf were wanted")
    if not np.isfinite(log_weight).any():
        return np.zeros_like(log_weight)
    weight = np.exp(log_weight - log_weight.max())
    return weight / weight.sum()


def log_evidence(log_weight: Float[np.ndarray, " n"], log_likelihood: Float[np.ndarray, " n"]) -> float:
    """Logarithm of the likelihood that the cloud as a whole gives to an observation; -inf where all are dead."""
    if not np.isfinite(log_weight).any():
        return -np.inf
    return float(np.logaddexp.reduce(log_weight + log_likelihood) - np.logaddexp.reduce(log_weight))


def effective_size(weight: Float[np.ndarray, " n"]) -> float:
    """`1 / sum w^2`: how many equal particles would say as much (Kong, Liu & Wong 1994); 0 where all are dead.

    >>> effective_size(np.array([0.5, 0.5, 0.0]))
    2.0
    """
    total = float(weight @ weight)
    return 1.0 / total if total > 0.0 else 0.0


def estimate(
    x: Float[np.ndarray, "n d"], weight: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "d d"]]:
    """Weighted mean and covariance; the covariance is that of the cloud, not of its mean.

    >>> mean, covariance = estimate(np.array([[0.0], [2.0]]), np.array([0.5, 0.5]))
    >>> float(mean[0]), float(covariance[0, 0])
    (1.0, 1.0)
    """
    mean = weight @ x
    apart = x - mean
    return mean, (apart * weight[:, None]).T @ apart


def ellipsoid(mean: Float[np.ndarray, " d"], covariance: Float[np.ndarray, "d d"], share: float = 0.95) -> Ellipsoid:
    """The ellipsoid about the mean that holds a share of the normal distribution with this covariance.

    >>> ellipsoid(np.zeros(3), np.eye(3)).half.round(4).tolist()
    [2.7955, 2.7955, 2.7955]
    """
    variance, axes = np.linalg.eigh(covariance)
    return Ellipsoid(mean, axes, np.sqrt(np.maximum(variance, 0.0) * chdtri(mean.size, 1.0 - share)))


def volume(covariance: Float[np.ndarray, "3 3"], share: float = 0.95) -> float:
    """Volume of that ellipsoid, `4/3 pi c^1.5 sqrt(det C)` with c the quantile of chi square, 7.815 for 95 %.

    >>> round(volume(np.eye(3)), 2)
    91.51
    """
    variance = np.maximum(np.linalg.eigvalsh(covariance), 0.0)
    return float(4.0 / 3.0 * np.pi * chdtri(3, 1.0 - share) ** 1.5 * np.sqrt(variance.prod()))


def mahalanobis(
    x: Float[np.ndarray, "n d"], mean: Float[np.ndarray, " d"], covariance: Float[np.ndarray, "d d"]
) -> Float[np.ndarray, " n"]:
    """Squared distance from the mean in units of the covariance; +inf off a flat distribution."""
    variance, axes = np.linalg.eigh(covariance)
    along = (x - mean) @ axes
    with np.errstate(divide="ignore", invalid="ignore"):
        square = np.where(along == 0.0, 0.0, along**2 / np.maximum(variance, 0.0))
    return square.sum(axis=-1)


def resampled(
    rng: np.random.Generator, weight: Float[np.ndarray, " n"], scheme: Scheme = "systematic", count: int | None = None
) -> Int[np.ndarray, " m"]:
    """Numbers of the particles that go on, each about `count * weight` times.

    Parameters
    ----------
    weight : (n,)
        Sums to one.
    count : int, optional
        Particles wanted, n if not given.

    Raises
    ------
    ValueError
        If the weights do not sum to one.

    >>> resampled(np.random.default_rng(0), np.array([0.5, 0.0, 0.25, 0.25])).tolist()
    [0, 0, 2, 3]
    """
    n = weight.size if count is None else count
    total = np.cumsum(weight)
    if not abs(total[-1] - 1.0) < 1e-6:
        raise ValueError(f"weight: sums to {total[-1]}; 1 was wanted")
    if scheme == "residual":
        return _residual(rng, weight, n)
    if scheme == "systematic":
        at = (np.arange(n) + rng.random()) / n
    elif scheme == "stratified":
        at = (np.arange(n) + rng.random(n)) / n
    else:
        at = np.sort(rng.random(n))
    return _at(total, at)


def _at(total: Float[np.ndarray, " n"], at: Float[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    """The particles at which cumulated weights reach given shares; never one of weight zero."""
    last = int(np.searchsorted(total, total[-1]))  # the last one with a weight
    return np.minimum(np.searchsorted(total, at * total[-1], side="right"), last)


def _residual(rng: np.random.Generator, weight: Float[np.ndarray, " n"], n: int) -> Int[np.ndarray, " m"]:
    """Whole parts of `n w` for certain, the rest at random by what is left of the weights (Liu & Chen 1998)."""
    wanted = n * weight
    sure = np.floor(wanted + 1e-9).astype(int)
    kept = np.repeat(np.arange(weight.size), sure)
    missing = n - kept.size
    if missing <= 0:
        return kept[:n]
    rest = np.cumsum(np.maximum(wanted - sure, 0.0))
    return np.sort(np.concatenate([kept, _at(rest / rest[-1], np.sort(rng.random(missing)))]))
