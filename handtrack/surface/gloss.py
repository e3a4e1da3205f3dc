"""Normals and grey levels in, one light with a broad highlight out (Phong 1975).

    level = a + max(n . l, 0) + g max(r . v, 0)^s,      r = 2 (n . l^) n - l^,   v towards the camera, l^ = l / |l|

(no highlight where n . l <= 0). Six numbers cannot follow every surface, but where they do they say what normals look
like that no frame has shown yet. They are fitted by damped Gauss-Newton steps with Tukey's weights.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_STARTS = (4.0, 20.0)  # exponents to begin with
_STEPS, _FIRST_STEPS = 4, 20
_SEEN = 0.02  # of the light: a highlight that was found once is followed
_LEAST, _MOST = 1.0, 100.0  # of the exponent
_USUAL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.log(12.0)])  # what a highlight that no reading tells of is held to,
_WITHIN = np.array([np.inf, np.inf, np.inf, np.inf, 40.0, 1.0])  # and how tightly: grey levels, and log exponent


@dataclass(frozen=True, slots=True, eq=False)
class Gloss:
    """`ambient` a, `light` l (3,), `gloss` g, `exponent` s, and `spread`, the robust scatter of levels about it."""

    ambient: float
    light: Float[np.ndarray, " 3"]
    gloss: float
    exponent: float
    spread: float


def gloss_levels(of: Gloss, normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Grey levels of unit normals in camera axes.

    >>> front = Gloss(10.0, np.array([0.0, 0.0, -100.0]), 50.0, 5.0, 0.0)
    >>> gloss_levels(front, np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])).tolist()
    [160.0, 10.0]
    """
    return of.ambient + np.maximum(normal @ of.light, 0.0) + highlight(of, normal)


def highlight(of: Gloss, normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """The last term alone."""
    size = float(np.linalg.norm(of.light))
    if size == 0.0 or of.gloss == 0.0:
        return np.zeros(normal.shape[0])
    light = of.light / size
    facing = normal @ light
    mirrored = -2.0 * facing * normal[:, 2] + light[2]
    return np.where(facing > 0.0, of.gloss * np.maximum(mirrored, 0.0) ** of.exponent, 0.0)


def fit_gloss(
    normal: Float[np.ndarray, "n 3"],
    level: Float[np.ndarray, " n"],
    light: Float[np.ndarray, " 3"],
    noise: float,
    before: Gloss | None = None,
) -> Gloss:
    """Fit the six numbers.

    Parameters
    ----------
    light : (3,)
        A guess of the light, for the first time.
    before : Gloss
        The last fit, to start from.
    """
    if before is not None and before.gloss > _SEEN * np.linalg.norm(before.light):
        return _fitted(normal, level, noise, before, _STEPS)
    size = float(np.linalg.norm(light))
    direction = light / size if size > 0.0 else np.array([0.0, 0.0, -1.0])
    high, low = np.percentile(level, [95.0, 10.0])
    found = [
        _fitted(
            normal, level, noise, Gloss(low, 0.8 * (high - low) * direction, 0.2 * (high - low), s, high), _FIRST_STEPS
        )
        for s in _STARTS
    ]
    return min(found, key=lambda each: each.spread)


def _numbers(of: Gloss) -> Float[np.ndarray, " 6"]:
    return np.array([of.ambient, *of.light, of.gloss, np.log(of.exponent)])


def _gloss(x: Float[np.ndarray, " 6"], spread: float) -> Gloss:
    exponent = float(np.exp(np.clip(x[5], np.log(_LEAST), np.log(_MOST))))
    return Gloss(float(x[0]), x[1:4].copy(), max(float(x[4]), 0.0), exponent, spread)


def _fitted(
    normal: Float[np.ndarray, "n 3"], level: Float[np.ndarray, " n"], noise: float, start: Gloss, steps: int
) -> Gloss:
    x, damping = _numbers(start), 1e-3
    off = level - gloss_levels(start, normal)
    for _ in range(steps):
        weight, held = _weight(off, noise), max(spread_of(off), noise) ** 2 / _WITHIN**2
        J = _slope(x, normal)
        A, g = (J * weight[:, None]).T @ J + np.diag(held), J.T @ (weight * off) + held * (_USUAL - x)
        cost = float((weight * off * off).sum() + (held * (x - _USUAL) ** 2).sum())
        for _ in range(4):
            trial = _numbers(_gloss(x + np.linalg.solve(A + damping * np.diag(A.diagonal() + 1e-6), g), 0.0))
            left = level - gloss_levels(_gloss(trial, 0.0), normal)
            if float((weight * left * left).sum() + (held * (trial - _USUAL) ** 2).sum()) <= cost:
                x, off, damping = trial, left, 0.2 * damping
                break
            damping *= 10.0
        else:
            break
    return _gloss(x, spread_of(off))


def _weight(off: Float[np.ndarray, " n"], noise: float) -> Float[np.ndarray, " n"]:
    cut = 4.7 * max(spread_of(off), noise)
    return np.where(np.abs(off) < cut, (1.0 - (off / cut) ** 2) ** 2, 0.0)


def spread_of(off: Float[np.ndarray, " n"]) -> float:
    """Standard deviation of the better part: the lower third of a normal's absolute values lies below 0.43 sigma.

    A third of the surface may have another colour, or a shadow on it, without any effect.
    """
    return float(np.percentile(np.abs(off), 100.0 / 3.0)) / 0.4307 if off.size else 0.0


def _slope(x: Float[np.ndarray, " 6"], normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 6"]:
    """Derivative by the six numbers, by differences."""
    h = np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-5])
    base = x.copy()
    base[4] = max(base[4], 1e-2)
    columns = []
    for i in range(6):
        e = np.zeros(6)
        e[i] = h[i]
        ahead, behind = gloss_levels(_gloss(base + e, 0.0), normal), gloss_levels(_gloss(base - e, 0.0), normal)
        columns.append((ahead - behind) / (2.0 * h[i]))
    return np.stack(columns, axis=1)
