"""Nonlinear least squares: a residual function in, a solution with status and covariance out. Knows nothing of hands.

The cost is ``H(x) = 0.5 ||r(x)||^2`` (hand thesis, eq. (3.3)). Four ways down, all from ``fun(x) -> (r, J)``:

* ``gauss-newton``: ``x <- x - (J^T J)^-1 J^T r``, eq. (3.4), full steps whatever the cost does; ``max_steps=1`` is the
  thesis's fast variant of one step per image;
* ``damped``: the same step times a fixed ``eta`` (section 3.2.4, Table 3.6);
* ``levenberg-marquardt``: ``(J^T J + mu D) h = -J^T r``, with ``mu`` led by how well the quadratic model predicted the
  cost;
* ``trust-region``: the bounded interior-reflective method of the thesis's section 6.2.2 (Coleman and Li), from SciPy.

With residuals in units of their sigma the covariance of the solution is ``(J^T J)^-1``; `handtrack.evidence` says what
happens to directions that no residual speaks about, `handtrack.steps` computes the steps that are accepted here.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares

from .evidence import UNOBSERVED_VARIANCE, covariance_from_jacobian
from .steps import bounded_step, fits, gauss_newton_step

Fun = Callable[[Float[np.ndarray, " n"]], tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m n"]]]

METHODS = ("levenberg-marquardt", "gauss-newton", "damped", "trust-region")

_EPS = float(np.finfo(float).eps)
# First damping, relative to the diagonal of J^T J: small, since a tracker starts close to the solution.
_FIRST_DAMPING = 1e-4
_LAST_DAMPING = 1e16
# Cosine between the residual and a Jacobian column below which the gradient counts as zero.
_FLAT_COSINE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where a solver ended, and how far it can be trusted.

    Attributes
    ----------
    x : (n,)
        The parameters.
    cost : float
        ``0.5 ||residual||^2`` at `x`.
    residual, jacobian : (m,), (m, n)
        At `x`.
    status : str
        ``converged``; ``singular``: settled, but `rank` < n, the solution nearest the start among many; ``max-steps``;
        ``stalled``: no step lowers the cost, yet its gradient is not zero; ``diverged``: the residuals left the finite
        numbers, and `x` is the last finite iterate.
    steps : int
        Steps tried; `fun` was called ``steps + 1`` times.
    covariance : (n, n)
        Finite and positive definite, see `handtrack.evidence.covariance_from_jacobian`; it ignores bounds.
    rank, null_directions : int, (n, n - rank)
        Number of directions with evidence, and orthonormal directions without.
    trace_x, trace_cost : (k, n), (k,)
        The accepted iterates, the start first; k = 0 unless asked for.
    """

    x: Float[np.ndarray, " n"]
    cost: float
    residual: Float[np.ndarray, " m"]
    jacobian: Float[np.ndarray, "m n"]
    status: str
    steps: int
    covariance: Float[np.ndarray, "n n"]
    rank: int
    null_directions: Float[np.ndarray, "n free"]
    trace_x: Float[np.ndarray, "k n"]
    trace_cost: Float[np.ndarray, " k"]


@dataclass(slots=True, eq=False)
class _Run:
    """One solve in progress: the problem, the present iterate and the path to it."""

    fun: Fun
    bounds: Float[np.ndarray, "n 2"] | None
    max_steps: int
    tolerance: float
    keep_trace: bool
    x: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, " m"]
    jacobian: Float[np.ndarray, "m n"]
    cost: float
    steps: int
    trace: list[tuple[Float[np.ndarray, " n"], float]]

    def move(self, x, residual, jacobian, cost) -> None:
        """Make a tried point the present iterate."""
        self.x, self.residual, self.jacobian, self.cost = x, residual, jacobian, cost
        if self.keep_trace:
            self.trace.append((x, cost))

    def try_point(self, x) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m n"], float]:
        """Residual, Jacobian and cost of a point; an infinite cost where anything is not finite."""
        self.steps += 1
        residual, jacobian = self.fun(x)
        return residual, jacobian, _cost(residual, jacobian)

    def is_small(self, h) -> bool:
        """Whether a step no longer matters: every component below tolerance * (1 + largest parameter)."""
        return _largest(h) <= self.tolerance * (1.0 + _largest(self.x))

    def after(self, h) -> Float[np.ndarray, " n"]:
        """The point that a step leads to; adding it may round across a bound."""
        x = self.x + h
        return x if self.bounds is None else np.minimum(np.maximum(x, self.bounds[:, 0]), self.bounds[:, 1])

    def room(self) -> Float[np.ndarray, "n 2"] | None:
        """How far each parameter may still go, down (<= 0) and up (>= 0)."""
        return None if self.bounds is None else self.bounds - self.x[:, None]


def solve(
    fun: Fun,
    x0: Float[np.ndarray, " n"],
    *,
    method: str = "levenberg-marquardt",
    bounds: Float[np.ndarray, "_ 2"] | None = None,
    step: float = 1.0,
    max_steps: int = 50,
    tolerance: float = 1e-10,
    trace: bool = False,
    unobserved_variance: float = UNOBSERVED_VARIANCE,
) -> Solution:
    """Minimise ``0.5 ||r(x)||^2`` from `x0`.

    Parameters
    ----------
    fun : callable
        Residuals (m,) and their Jacobian (m, n) at x (n,); m may be smaller than n. It must stay the same function
        during the solve: robust weights are renewed between solves, not inside.
    x0 : (n,)
        Start; moved onto the bounds where it lies outside.
    method : str
        One of `METHODS`.
    bounds : (n, 2), optional
        Lowest and highest value, infinite where free, low <= high (low < high for ``trust-region``).
    step : float
        Share eta of each Gauss-Newton step that ``damped`` takes, in (0, 1]; 1 for the other methods.
    max_steps : int
        Steps tried at most, >= 0.
    tolerance : float
        A step is small when no component exceeds ``tolerance * (1 + max |x|)``; then the solver has converged, and does
        not evaluate `fun` for it any more. ``trust-region`` hands the number to SciPy's three criteria.
    trace : bool
        Keep the accepted iterates.
    unobserved_variance : float
        Variance of directions without evidence, in the square of the unit of x.

    Returns
    -------
    Solution
        Failure to converge is its status, not an exception.

    Raises
    ------
    ValueError
        Unknown method, shapes or ranges that do not fit, or residuals that are not finite at the start.

    Notes
    -----
    Hand thesis, section 3.1.2, eq. (3.3)-(3.5), and section 6.2.2.

    Examples
    --------
    >>> target = np.array([1.0, 2.0, 4.0])
    >>> def line(x):
    ...     jacobian = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]])
    ...     return jacobian @ x - target, jacobian
    >>> solution = solve(line, np.zeros(2), method="gauss-newton")
    >>> solution.status, solution.steps, solution.x.round(6).tolist()
    ('converged', 1, [0.833333, 1.5])
    """
    x, bounds = _checked(x0, method, bounds, step, max_steps, tolerance)
    residual, jacobian = fun(x)
    if jacobian.shape != (residual.size, x.size):
        raise ValueError(f"fun: Jacobian of shape {jacobian.shape}, wanted {(residual.size, x.size)}")
    cost = _cost(residual, jacobian)
    if not math.isfinite(cost):
        raise ValueError(f"fun: residual or Jacobian at the start {x} is not finite")
    start = [(x, cost)] if trace else []
    run = _Run(fun, bounds, max_steps, tolerance, trace, x, residual, jacobian, cost, 0, start)
    if method == "trust-region":
        status = _trust_region(run)
    elif method == "levenberg-marquardt":
        status = _levenberg_marquardt(run)
    else:
        status = _full_steps(run, step)
    covariance, null = covariance_from_jacobian(run.jacobian, unobserved_variance)
    if status == "converged" and null.shape[1] > 0:
        status = "singular"
    return Solution(
        x=run.x,
        cost=run.cost,
        residual=run.residual,
        jacobian=run.jacobian,
        status=status,
        steps=run.steps,
        covariance=covariance,
        rank=x.size - null.shape[1],
        null_directions=null,
        trace_x=np.array([point for point, _ in run.trace]).reshape(-1, x.size),
        trace_cost=np.array([value for _, value in run.trace]),
    )


def _cost(residual, jacobian) -> float:
    """Equation (3.3), or infinity where a residual or a derivative is not finite."""
    cost = 0.5 * float(residual @ residual)
    # One sum sees every NaN and infinity (a cancelling pair gives NaN); a sum is half the price of a test per element.
    return cost if math.isfinite(cost) and math.isfinite(float(jacobian.sum())) else math.inf


def _largest(h) -> float:
    """Largest magnitude; a Python loop over a handful of parameters beats two array passes."""
    return max(map(abs, h.tolist()), default=0.0)


def _full_steps(run: _Run, eta: float) -> str:
    """Gauss-Newton: accept every step, as eq. (3.4) does, or the share eta of it."""
    while True:
        h = eta * _projected_gauss_newton(run)
        if run.is_small(h):
            return "converged"
        if run.steps >= run.max_steps:
            return "max-steps"
        x = run.after(h)
        residual, jacobian, cost = run.try_point(x)
        if not math.isfinite(cost):
            return "diverged"
        run.move(x, residual, jacobian, cost)


def _projected_gauss_newton(run: _Run) -> Float[np.ndarray, " n"]:
    h = gauss_newton_step(run.residual, run.jacobian)
    room = run.room()
    if room is None or fits(h, room):
        return h
    normal = run.jacobian.T @ run.jacobian
    # The active set needs a definite matrix; 1e-10 of the diagonal keeps directions without evidence where they are.
    diagonal = normal.diagonal().copy()
    normal.flat[:: diagonal.size + 1] += np.where(diagonal > 0, 1e-10 * diagonal, 1.0)
    bounded = bounded_step(normal, run.jacobian.T @ run.residual, room)
    return np.clip(h, room[:, 0], room[:, 1]) if bounded is None else bounded


def _levenberg_marquardt(run: _Run) -> str:
    """Accept a step when it lowers the cost; lead the damping by the gain ratio.

    The damping rule is H. B. Nielsen's ("Damping Parameter in Marquardt's Method", 1999): ``mu`` times
    ``max(1/3, 1 - (2 gain - 1)^3)`` after a success, times 2, 4, 8 ... after failures in a row. The diagonal that it
    multiplies is the largest ``diag(J^T J)`` seen so far (J. J. More, 1978), so units of the parameters do not matter.
    """
    damping, growth = _FIRST_DAMPING, 2.0
    normal, gradient = run.jacobian.T @ run.jacobian, run.jacobian.T @ run.residual
    scale = normal.diagonal().copy()
    weight = _nonzero(scale)
    while True:
        damped = normal.copy()
        damped.ravel()[:: scale.size + 1] += damping * weight
        h = bounded_step(damped, gradient, run.room())
        accepted = False
        if h is not None:
            predicted = -float(h @ (gradient + 0.5 * (normal @ h)))
            if run.is_small(h) or abs(predicted) <= _EPS * run.cost:
                return "converged" if damping <= 1.0 or _is_flat(run, gradient, weight) else "stalled"
            if run.steps >= run.max_steps:
                return "max-steps"
            x = run.after(h)
            residual, jacobian, cost = run.try_point(x)
            gain = (run.cost - cost) / predicted
            accepted = predicted > 0.0 and gain > 0.0
            if accepted:
                run.move(x, residual, jacobian, cost)
                normal, gradient = jacobian.T @ jacobian, jacobian.T @ residual
                scale = np.maximum(scale, normal.diagonal())
                weight = _nonzero(scale)
                damping *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
                growth = 2.0
        if not accepted:
            damping *= growth
            growth *= 2.0
            if damping > _LAST_DAMPING:
                return "stalled"


def _nonzero(scale):
    """A column without evidence has a gradient of zero: any damping keeps its parameter in place."""
    return np.where(scale > 0.0, scale, 1.0)


def _is_flat(run: _Run, gradient, weight) -> bool:
    """Whether the cost has no slope left towards the inside of the bounds, in any units."""
    size = np.sqrt(2.0 * run.cost * weight)
    room = run.room()
    inside: Bool[np.ndarray, " n"] = np.ones(gradient.size, bool)
    if room is not None:
        inside = np.where(gradient > 0.0, room[:, 0] < 0.0, room[:, 1] > 0.0)
    return bool((np.abs(gradient) * inside <= _FLAT_COSINE * size).all())


def _trust_region(run: _Run) -> str:
    """SciPy's ``trf``; it asks for the Jacobian of each accepted point, which is what moves the run."""
    last = (run.x, run.residual, run.jacobian)

    def residual(x):
        nonlocal last
        if not np.array_equal(x, last[0]):
            tried, jacobian, cost = run.try_point(x)
            # SciPy answers residuals that are not finite with a shorter step.
            last = (x.copy(), tried if math.isfinite(cost) else np.full_like(tried, np.nan), jacobian)
        return last[1]

    def jacobian(x):
        residual(x)
        if not np.array_equal(x, run.x):
            run.move(*last, _cost(last[1], last[2]))
        return last[2]

    if run.max_steps == 0:
        return "max-steps"
    limits = (-np.inf, np.inf) if run.bounds is None else (run.bounds[:, 0], run.bounds[:, 1])
    tolerance = max(run.tolerance, 2.0 * _EPS)
    found = least_squares(
        residual,
        run.x,
        jac=jacobian,  # pyright: ignore[reportArgumentType]
        bounds=limits,
        method="trf",
        x_scale="jac",
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
        max_nfev=run.max_steps + 1,
    )
    return "converged" if found.status > 0 else "max-steps"


def _checked(x0, method, bounds, step, max_steps, tolerance):
    """The start as a fresh float array inside the bounds, or ValueError."""
    x = np.array(x0, float)
    if method not in METHODS:
        raise ValueError(f"method: {method!r} is unknown, wanted one of {', '.join(METHODS)}")
    if x.ndim != 1 or x.size == 0 or not np.isfinite(x).all():
        raise ValueError(f"x0: {x0} is not a finite vector with at least one element")
    if not 0.0 < step <= 1.0 or (step != 1.0 and method != "damped"):
        raise ValueError(
            f"step: {step} with method {method!r}; wanted 0 < step <= 1, and 1 unless the method is 'damped'"
        )
    if max_steps < 0 or not tolerance >= 0.0:
        raise ValueError(f"max_steps, tolerance: {max_steps}, {tolerance} must not be negative")
    if bounds is None:
        return x, None
    bounds = np.asarray(bounds, float)
    if bounds.shape != (x.size, 2):
        raise ValueError(f"bounds: shape {bounds.shape}, wanted {(x.size, 2)}")
    wrong = ~(bounds[:, 0] < bounds[:, 1]) if method == "trust-region" else ~(bounds[:, 0] <= bounds[:, 1])
    if wrong.any():
        i = int(np.argmax(wrong))
        raise ValueError(f"bounds: parameter {i} has low {bounds[i, 0]} and high {bounds[i, 1]}, wanted low below high")
    return np.clip(x, bounds[:, 0], bounds[:, 1]), bounds
