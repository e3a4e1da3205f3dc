"""A link's WSSD surface in, one offset for each profile out: the valley line of the hand thesis, section 4.3.2.

The curves of a link's profiles stand side by side; the valley that crosses them is a straight line `k = c0 + c1 i`,
since a link that is off is shifted and turned. The thesis descends from the middle by unit steps, `y <- y -
sign(gradient)`, with a line fitted to all after each step. From the middle alone that ends in the nearest dip; here
it starts from the best of all straight lines over the surface, and ends with a parabola through the lowest samples
near the line, which turns whole samples into fractions and gives every profile an offset of its own.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

_NEAR = 2  # samples a profile's own minimum may lie off the line
_STEPS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Valley:
    """The line in samples (`c0 + c1 i` for profile i), and each profile's own minimum near it; NaN without one."""

    line: Float[np.ndarray, " 2"]
    minimum: Float[np.ndarray, " n"]
    curvature: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]


def fit_valley(
    surface: Float[np.ndarray, "n k"], weight: Float[np.ndarray, " n"], cost: Float[np.ndarray, " k"]
) -> Valley:
    """Find the valley of one link.

    Parameters
    ----------
    surface : (n, k)
        WSSD curves of the link's profiles, inf where a shift is not allowed.
    weight : (n,)
        Weight of each profile (its visible share over the noise).
    cost : (k,)
        What each shift costs by itself: its square over the variance of the prediction.

    >>> k = np.arange(9.0)
    >>> surface = np.stack([(k - 3.0) ** 2, (k - 3.5) ** 2, (k - 4.0) ** 2])
    >>> valley = fit_valley(surface, np.ones(3), np.zeros(9))
    >>> valley.minimum.round(3).tolist()
    [3.0, 3.5, 4.0]
    """
    n, count = surface.shape
    finite = np.where(np.isfinite(surface), surface, np.nan)
    top = np.nanmax(finite) if np.isfinite(surface).any() else 1.0
    filled = np.where(np.isfinite(surface), surface, 4.0 * top + 1.0)
    total = filled * weight[:, None] + cost
    line = _best_line(total)
    line = _descend(total, line)
    at = np.clip(np.rint(line[0] + line[1] * np.arange(n)).astype(int), 0, count - 1)
    minimum, curvature, height = _parabola(filled, at)
    return Valley(line, minimum, curvature, height)


def _best_line(total: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " 2"]:
    """The cheapest of all lines through a whole shift at the first and one at the last profile."""
    n, count = total.shape
    first, last = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
    summed = np.zeros((count, count))
    for i in range(n):  # over profiles, of which a link has a handful
        share = i / max(n - 1, 1)
        summed += total[i, np.rint(first + share * (last - first)).astype(int)]
    low, high = np.unravel_index(np.argmin(summed), summed.shape)
    return np.array([float(low), (float(high) - float(low)) / max(n - 1, 1)])


def _descend(total: Float[np.ndarray, "n k"], line: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " 2"]:
    """The thesis's unit steps: down each curve by one, a line through all, rounded, until nothing changes."""
    n, count = total.shape
    x = np.arange(n)
    design = np.column_stack([np.ones(n), x])
    gradient = np.gradient(total, axis=1)
    y = np.clip(np.rint(line[0] + line[1] * x), 0, count - 1).astype(int)
    cost = total[x, y].sum()
    for _ in range(_STEPS):
        moved = y - np.sign(gradient[x, y])
        fitted = np.linalg.lstsq(design, moved, rcond=None)[0]
        following = np.clip(np.rint(design @ fitted), 0, count - 1).astype(int)
        if total[x, following].sum() >= cost:
            break
        y, line, cost = following, fitted, total[x, following].sum()
    return line


def _parabola(
    surface: Float[np.ndarray, "n k"], at: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Vertex, curvature and height of each curve's lowest point within a few samples of the line."""
    n, count = surface.shape
    row = np.arange(n)
    near = np.clip(at[:, None] + np.arange(-_NEAR, _NEAR + 1), 1, count - 2)
    lowest = near[row, np.argmin(surface[row[:, None], near], axis=1)]
    left, middle, right = surface[row, lowest - 1], surface[row, lowest], surface[row, lowest + 1]
    curvature = left - 2.0 * middle + right
    vertex = (middle <= left) & (middle <= right) & (curvature > 0)
    shift = np.where(vertex, 0.5 * (left - right) / np.where(curvature > 0, curvature, 1.0), 0.0)
    nothing = np.where(vertex, 0.0, np.nan)
    return lowest + shift + nothing, curvature + nothing, middle + nothing
