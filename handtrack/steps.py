"""Steps of least-squares solvers: residual, Jacobian or normal matrix in, the correction to the parameters out.

Computing a step is this module; whether it is taken is decided in `handtrack.solve`. The Gauss-Newton correction is
eq. (3.5) of the hand thesis, ``-(J^T J)^-1 J^T r``; the bounded one is the minimiser of the quadratic model in a box.
"""

import numpy as np
from jaxtyping import Float
from scipy.linalg.lapack import dposv  # pyright: ignore[reportAttributeAccessIssue]

_EPS = float(np.finfo(float).eps)


def gauss_newton_step(residual: Float[np.ndarray, " m"], jacobian: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " n"]:
    """The correction ``-(J^T J)^-1 J^T r`` of eq. (3.5); the shortest one, column scaled, where ``J^T J`` is singular.

    Parameters
    ----------
    residual, jacobian : (m,), (m, n)
        At the present iterate.

    Returns
    -------
    (n,)
        The step to add.

    Examples
    --------
    >>> gauss_newton_step(np.array([2.0, 3.0]), np.array([[2.0, 0.0], [0.0, 1.0]])).tolist()
    [-1.0, -3.0]
    """
    # Columns of length one make the pivots of the Cholesky factor tell how singular the problem is, in any units.
    length = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    length[length == 0.0] = 1.0
    scaled = jacobian / length
    factor, h, failed = dposv(scaled.T @ scaled, scaled.T @ residual)
    if failed or factor.diagonal().min(initial=1.0) < 1e-4:
        h = np.linalg.lstsq(scaled, residual, rcond=1e-8)[0]
    return -h / length


def bounded_step(
    normal: Float[np.ndarray, "n n"],
    gradient: Float[np.ndarray, " n"],
    room: Float[np.ndarray, "n 2"] | None,
) -> Float[np.ndarray, " n"] | None:
    """Minimiser of ``g^T h + 0.5 h^T B h`` within a box around zero, by an active set.

    Parameters
    ----------
    normal : (n, n)
        The positive definite B.
    gradient : (n,)
        g.
    room : (n, 2) or None
        Lowest (<= 0) and highest (>= 0) step of each parameter; None leaves all free.

    Returns
    -------
    (n,) or None
        The step; None where `normal` is not positive definite in floating point.

    Examples
    --------
    >>> bounded_step(np.eye(2), np.array([-3.0, 1.0]), np.array([[-1.0, 1.0], [-5.0, 5.0]])).tolist()
    [1.0, -1.0]
    """
    _, h, failed = dposv(normal, -gradient)
    if failed:
        return None
    return h if room is None or fits(h, room) else _active_set(normal, gradient, room)


def fits(h: Float[np.ndarray, " n"], room: Float[np.ndarray, "n 2"]) -> bool:
    """Whether a step stays within its room."""
    return bool((h >= room[:, 0]).all() and (h <= room[:, 1]).all())


def _active_set(normal, gradient, room):
    """Fix what leaves the box on its face, solve the rest, release what a face no longer holds back."""
    n = gradient.size
    face = np.zeros(n, int)
    h = np.zeros(n)
    # Fixing and releasing may take turns; the bound on the turns costs accuracy of this step only, never feasibility.
    for _ in range(3 * n):
        free = face == 0
        h = np.where(face < 0, room[:, 0], np.where(face > 0, room[:, 1], 0.0))
        if free.any():
            inner = normal[np.ix_(free, free)]
            h[free] = dposv(inner, -(gradient + normal @ h)[free])[1]
        beyond = np.where(h < room[:, 0], -1, np.where(h > room[:, 1], 1, 0)) * free
        if beyond.any():
            face = np.where(free, beyond, face)
            continue
        pull = face * (gradient + normal @ h)
        if pull.max() <= _EPS * np.abs(gradient).max():
            break
        face[np.argmax(pull)] = 0
    return np.clip(h, room[:, 0], room[:, 1])
