"""Correlation surfaces of links in, edges on one straight line for each side out (hand thesis, 11.3).

The correlation curves C_i of a link's profiles stand side by side; as a link is straight, the crest that crosses them
is a straight line `y = c0 + c1 x`, x the place of the profile along the link and y the shift. Three ways to fit it:

    PLLS (11.3.1)       least squares through the highest places  y_i = argmax C_i
    MWPLLS (11.3.2)     minimises sum over i of (sum over j of w_ji (y_j - c0 - c1 x_i))^2,  w_ji = C_i(y_j)
    iterative (11.3.3)  MWPLLS again with the shifts near the last line alone, nearer each time, until it rests

The second is least squares through the centres of mass `sum w y / sum w` with weights `(sum w)^2`. Edges are not
measured but set at the known width around the line, so all of a link's edges share the errors of its two numbers.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .crossings import OUTWARD, Crossings, answer
from .derivative import gaussian_slopes
from .points import BORDER, FLAT, FOUND, HIDDEN, EdgePoints
from .slopes import peaks, variance_of
from .width_restricted import Correlation, correlate

LEAST_PROFILES = 3  # that make a line
_LEAST_HEIGHT = 0.3  # of the crest that the predicted steps would make
_CLEAR = 3.0  # sigmas of the noise: lower is no part of a crest
_NEAREST = 3.0  # pixels: the last neighbourhood of the iteration
_SHRINK = 0.6
_MOST_HELD = 0.8  # of a centre's motion that its neighbourhood may take back
_ROUNDS = 20
_REST = 1e-3  # pixels


@dataclass(frozen=True, slots=True, eq=False)
class Crest:
    """A line over each link's correlation surface, told at every profile.

    Attributes
    ----------
    shift, sigma : (n,)
        The line's shift and its standard deviation, pixels; NaN and inf where the link has too few profiles.
    used : (n,)
        Profiles that the line was fitted to.
    """

    shift: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]
    used: Bool[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class Centres:
    """Where each curve says the crest is: shift, its variance by the noise, its weight (0: it says nothing)."""

    shift: Float[np.ndarray, " n"]
    variance: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]


def plls(crossings: Crossings) -> EdgePoints:
    """Edges around the least-squares line through each curve's maximum, partial linear least squares (11.3.1).

    Parameters
    ----------
    crossings : Crossings
        n profiles; those of one link make one surface.

    Returns
    -------
    EdgePoints
        2 n entries, side -1 before side +1 of each profile; `offset` outwards from the predicted edge, pixels. Sigmas
        are those of the line at each profile: edges of one link are not independent.
    """
    return _edges(crossings, lambda surface, x: fit_plls(surface, x, crossings.samplers.link))


def mwplls(crossings: Crossings) -> EdgePoints:
    """Edges around the line through the curves' centres of mass, modified weighted PLLS (11.3.2); as `plls`."""
    return _edges(crossings, lambda surface, x: fit_mwplls(surface, x, crossings.samplers.link))


def mwplls_iterative(crossings: Crossings) -> EdgePoints:
    """Edges around the line that MWPLLS finds in its own neighbourhood, iterative MWPLLS (11.3.3); as `plls`."""
    return _edges(crossings, lambda surface, x: fit_iterative(surface, x, crossings.samplers.link))


def fit_plls(surface: Correlation, x: Float[np.ndarray, " n"], link: Int[np.ndarray, " n"]) -> Crest:
    """Line through the highest place of every curve that rises above the noise."""
    top = peaks(surface.curves, surface.allowed, surface.allowed, surface.shift, surface.covariance)
    counts = top.inner & (top.height > _CLEAR * np.sqrt(surface.covariance[:, 0]))
    centres = Centres(np.nan_to_num(top.place), np.where(counts, top.sigma, 0.0) ** 2, counts.astype(float))
    return line_through(centres, x, link)


def fit_mwplls(surface: Correlation, x: Float[np.ndarray, " n"], link: Int[np.ndarray, " n"]) -> Crest:
    """Line through the centres of mass of all that rises above the noise."""
    return line_through(centres_of_mass(surface), x, link)


def fit_iterative(surface: Correlation, x: Float[np.ndarray, " n"], link: Int[np.ndarray, " n"]) -> Crest:
    """MWPLLS over the shifts near the last line, from all of them down to three pixels on either side.

    The thesis keeps one neighbourhood; one that shrinks finds crests far from the first line as well.
    """
    crest = fit_mwplls(surface, x, link)
    near = float(np.abs(surface.shift).max(initial=_NEAREST))
    for _ in range(_ROUNDS):
        near = max(_SHRINK * near, _NEAREST)
        last = np.nan_to_num(crest.shift)
        crest = line_through(centres_of_mass(surface, last, near), x, link)
        if near == _NEAREST and np.abs(np.nan_to_num(crest.shift) - last).max(initial=0.0) < _REST:
            break
    return crest


def centres_of_mass(
    surface: Correlation, around: Float[np.ndarray, " n"] | None = None, near: float = np.inf
) -> Centres:
    """Mean shift of each curve weighted by what rises above the noise, `y = sum w y_j / sum w`, itself weighted by
    `(sum w)^2`.

    Its derivative by the height w_j is `(y_j - y) / sum w`, which gives the variance. Where only shifts within `near`
    pixels of a line count and the line then moves to the result, as in an iteration that has come to rest, whatever
    moves y moves the neighbourhood along, by the share v (w(-v) + w(v)) / sum w of it, v its half width in samples.
    """
    noise = np.sqrt(surface.covariance[:, :1])
    weight = np.where(surface.allowed, np.maximum(surface.curves - _CLEAR * noise, 0.0), 0.0)
    held = np.zeros(weight.shape[0])
    if around is not None:
        step = float(surface.shift[1] - surface.shift[0])
        # Samples at the rim count by how much of them lies inside, or the centre would jump from sample to sample.
        inside = np.clip((near - np.abs(surface.shift - around[:, None])) / step + 0.5, 0.0, 1.0)
        rim = (weight * ((inside > 0.0) & (inside < 1.0))).sum(axis=1)
        weight = weight * inside
        held = np.minimum(rim * near / step / np.maximum(weight.sum(axis=1), 1e-300), _MOST_HELD)
    total = weight.sum(axis=1)
    safe = np.where(total > 0.0, total, 1.0)
    centre = (weight @ surface.shift) / safe
    by = np.where(weight > 0.0, surface.shift - centre[:, None], 0.0) / safe[:, None]
    return Centres(centre, variance_of(by, surface.covariance) / (1.0 - held) ** 2, total**2)


def line_through(centres: Centres, x: Float[np.ndarray, " n"], link: Int[np.ndarray, " n"]) -> Crest:
    """Weighted least-squares line of each link through its profiles' centres.

    Its covariance takes for each centre what is larger, its variance by the noise or the scatter about the line, so a
    line drawn through clutter says so.
    """
    w = centres.weight
    links = int(link.max(initial=-1)) + 1

    def total(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " l"]:
        return np.bincount(link, values, links).astype(float)  # of nothing at all it would be integers

    used = w > 0.0
    count, safe = total(1.0 * used), np.maximum(total(w), 1e-300)
    w = w / safe[link]
    middle = total(w * x)
    x = x - middle[link]
    sxx, c0, sxy = total(w * x * x), total(w * centres.shift), total(w * x * centres.shift)
    turns = sxx > 1e-9
    c1 = np.where(turns, sxy / np.where(turns, sxx, 1.0), 0.0)
    line = c0[link] + c1[link] * x
    left = total(used * (centres.shift - line) ** 2) / np.maximum(count - 2.0, 1.0)
    variance = np.maximum(centres.variance, left[link])
    lever = np.where(turns, 1.0 / np.where(turns, sxx, 1.0), 0.0)
    # Rows of the estimator: c0 = sum w y, c1 = sum w x y / sxx.
    v00, v01 = total(w * w * variance), total(w * w * x * variance) * lever
    v11 = total(w * w * x * x * variance) * lever**2
    sigma = np.sqrt(np.maximum(v00[link] + 2.0 * x * v01[link] + x * x * v11[link], 0.0))
    enough = (count >= LEAST_PROFILES)[link]
    return Crest(np.where(enough, line, np.nan), np.where(enough, sigma, np.inf), used & enough)


def along_link(crossings: Crossings) -> Float[np.ndarray, " n"]:
    """Place of each profile along its link in the image, pixels from the link's first profile."""
    samplers = crossings.samplers
    first = np.zeros(int(samplers.link.max(initial=-1)) + 1, dtype=int)
    first[samplers.link[::-1]] = np.arange(samplers.link.size)[::-1]
    away = samplers.origin - samplers.origin[first[samplers.link]]
    return (away * np.stack([-samplers.direction[:, 1], samplers.direction[:, 0]], axis=1)).sum(axis=1)


def _edges(crossings: Crossings, fit: Callable[[Correlation, Float[np.ndarray, " n"]], Crest]) -> EdgePoints:
    """Edges at the known width around a fitted crest, refused where the crest is too low to be the link."""
    surface = correlate(crossings, gaussian_slopes(crossings))
    crest = fit(surface, along_link(crossings))
    link, n = crossings.samplers.link, crossings.samplers.link.size
    at = np.clip(np.nan_to_num(crest.shift), surface.shift[0], surface.shift[-1])
    index = np.clip(np.rint((at - surface.shift[0]) / crossings.step).astype(int), 0, surface.shift.size - 1)
    here = surface.curves[np.arange(n), index]
    height, wanted = np.bincount(link, crest.used * here), np.bincount(link, crest.used * surface.wanted)
    clear = np.bincount(link, crest.used * np.sqrt(surface.covariance[:, 0])) * _CLEAR
    low = (height < np.maximum(_LEAST_HEIGHT * wanted, clear))[link] if n else np.zeros(0, dtype=bool)
    reason = np.full(n, FOUND)
    reason[low] = FLAT
    reason[np.abs(np.nan_to_num(crest.shift)) > crossings.reach] = BORDER
    few = np.bincount(link, 1.0 * (crossings.state == FOUND).any(axis=1), minlength=1)[link] < LEAST_PROFILES
    reason[~np.isfinite(crest.shift)] = FLAT
    reason[few] = HIDDEN
    noise2 = np.maximum(surface.covariance[:, 0], 1e-12)
    misfit = np.repeat(((here - surface.wanted) ** 2 / noise2)[:, None], 2, axis=1)
    both = np.ones((1, 2))
    return answer(
        crossings,
        OUTWARD * crest.shift[:, None],
        crest.sigma[:, None] * both,
        np.repeat(reason[:, None], 2, axis=1),
        misfit,
    )
