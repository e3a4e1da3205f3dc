"""What residuals say about parameters: a Jacobian in, covariance and directions without evidence out.

With residuals in units of their sigma, ``(J^T J)^-1`` is the covariance of the least-squares solution, to first order.
A hidden finger leaves directions in which ``J`` is blind: ``J^T J`` is singular, which the text below eq. (3.5) of the
hand thesis warns of. Then the pseudo-inverse speaks for the directions with evidence, a stated variance for the others:

    C = (J^T J)^+ + u N N^T,    N = orthonormal null directions of J,  u = unobserved variance

No direction gets more than ``u``, so C stays finite and definite however weak the evidence is.
"""

import numpy as np
from jaxtyping import Float
from scipy.linalg.lapack import dpotrf, dpotri  # pyright: ignore[reportAttributeAccessIssue]

UNOBSERVED_VARIANCE = 1e6

# An eigenvalue of J^T J (columns scaled to length one) below this is rounding: 1e-5 as a singular value of J.
_BLIND = 1e-10


def covariance_from_jacobian(
    jacobian: Float[np.ndarray, "m n"], unobserved_variance: float = UNOBSERVED_VARIANCE
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n free"]]:
    """Covariance of a least-squares solution by a route that reveals the rank.

    Parameters
    ----------
    jacobian : (m, n)
        Derivative of residuals in units of their sigma; m may be 0 or smaller than n.
    unobserved_variance : float
        Variance u of directions without evidence, and the most that any direction gets; > 0, in the square of the
        parameters' unit.

    Returns
    -------
    covariance : (n, n)
        Symmetric, positive definite, no eigenvalue above u.
    null_directions : (n, n - rank)
        Orthonormal. Which directions count as blind does not depend on the units of the parameters, since that is
        decided with columns of length one.

    Raises
    ------
    ValueError
        `unobserved_variance` is not a finite positive number.

    Examples
    --------
    >>> covariance, null = covariance_from_jacobian(np.array([[2.0, 0.0]]), unobserved_variance=9.0)
    >>> covariance.tolist(), np.abs(null.T).tolist()
    ([[0.25, 0.0], [0.0, 9.0]], [[0.0, 1.0]])
    """
    if not (0.0 < unobserved_variance < np.inf):
        raise ValueError(f"unobserved_variance: {unobserved_variance} is not a finite number > 0")
    normal = jacobian.T @ jacobian
    length = np.sqrt(normal.diagonal())
    n = length.size
    blind_column = length == 0.0
    inverse_length = 1.0 / np.where(blind_column, 1.0, length)
    scaled = normal * inverse_length[:, None] * inverse_length
    covariance, null = _full_rank_inverse(scaled), np.empty((n, 0))
    if covariance is None:
        covariance, null = _pseudo_inverse(scaled, inverse_length)
    else:
        covariance *= inverse_length[:, None] * inverse_length
    # The largest eigenvalue is at most the trace: only then can the cap bind.
    if covariance.trace() > unobserved_variance:
        value, vector = np.linalg.eigh(covariance)
        covariance = (vector * np.minimum(value, unobserved_variance)) @ vector.T
    if null.shape[1] > 0:
        covariance = covariance + unobserved_variance * (null @ null.T)
    return 0.5 * (covariance + covariance.T), null


def _full_rank_inverse(scaled: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"] | None:
    """Inverse by Cholesky where the rank is certainly full, else None; no eigenvalue of S is below 1 / trace(S^-1)."""
    factor, failed = dpotrf(scaled, lower=0, clean=1)
    if failed:
        return None
    upper, failed = dpotri(factor, lower=0)
    if failed or not upper.trace() < 1.0 / _BLIND:
        return None
    # LAPACK fills the upper triangle; `clean` has left zeros below it.
    return upper + upper.T - np.diag(upper.diagonal())


def _pseudo_inverse(scaled: Float[np.ndarray, "n n"], inverse_length: Float[np.ndarray, " n"]):
    """Moore-Penrose inverse of ``J^T J`` and the null directions of J, from the column-scaled normal matrix."""
    value, vector = np.linalg.eigh(scaled)
    blind = value <= _BLIND
    # J x = 0 where x = D^-1 v and v is a null vector of J D^-1.
    null = np.linalg.qr(inverse_length[:, None] * vector[:, blind])[0]
    # Signs of a QR are arbitrary; the largest component positive makes the answer repeatable.
    largest = null[np.abs(null).argmax(axis=0), np.arange(null.shape[1])] if null.size else np.empty(0)
    null = null * np.where(largest < 0.0, -1.0, 1.0)
    seen = inverse_length[:, None] * vector[:, ~blind]
    seen = seen - null @ (null.T @ seen)
    return (seen / value[~blind]) @ seen.T, null
