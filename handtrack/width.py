"""Opposite edges of a link in, its width out: for each profile, for each link, and filtered over frames.

A profile is a pair of edges found on both sides of a link at one axial position. Each edge is a ray, and its distance
`|c(s) - ray|` from the axis, at the s where a pill of the model's taper touches it, is the radius that this pill would
need there. The width of the profile is the sum of both: where the axis is off to one side, one grows by what the other
loses. It is a width in space, whatever the projection and however much the link is foreshortened.

The profiles of a link are redundant measures of one width (hand thesis, appendix E). Their differences to the model's
width are fitted by a line over the axial position with robust weights: its middle is the width, its slope the taper.

Over frames the width is a constant, so the appendix keeps only the position part of its filter: `p = p + g (E[p_i] -
p)`, with a gain g that is chosen (`constant_gain`). The gain that follows from variances, `g = P / (P + sigma^2)`,
makes it a Kalman filter (`filter_widths`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from . import _kernels
from .measure import Look
from .pills import Pills, clearance
from .profiles import Samplers
from .robust import CAUCHY_C, cauchy_weight

COMMON = 0.05  # pixels: what all edges of one side of a link may share, from shading and blur that are slightly off
_PULL = (0.5, 0.2)  # share of a clear difference that may be missed where the model is too wide, and too narrow
_CLEAR = 2.0  # sigmas beyond which a difference to the model is one
_TAPER = 0.1  # standard deviation of the taper about the model's, share of the width
_LEAST_FOR_SCALE = 4  # profiles from which on their own scatter is believed
_STEPS = 3


@dataclass(frozen=True, slots=True, eq=False)
class ProfileWidths:
    """One entry for each profile with both edges, link by link.

    Attributes
    ----------
    link, along : (m,)
        Link, and axial position in [0, 1].
    width, sigma : (m,)
        Twice the mean of both radii, model units, and its standard deviation from those of the edges.
    pixels, pixels_sigma : (m,)
        Distance of the two edges across the axis in the image, pixels.
    """

    link: Int[np.ndarray, " m"]
    along: Float[np.ndarray, " m"]
    width: Float[np.ndarray, " m"]
    sigma: Float[np.ndarray, " m"]
    pixels: Float[np.ndarray, " m"]
    pixels_sigma: Float[np.ndarray, " m"]


@dataclass(frozen=True, slots=True, eq=False)
class LinkWidths:
    """One entry for each link of the model.

    Attributes
    ----------
    width, sigma : (l,)
        Width in the middle of the link, model units; width 0 and sigma inf where no profile has both edges.
    lasting : (l,)
        The part of sigma that is the same in all frames; 0 where unseen.
    taper, taper_sigma : (l,)
        Width at the tip less that at the base; the model's, with sigma a tenth of the width, where nothing tells.
    pixels : (l,)
        Mean width of the profiles in the image, pixels; of the view that tells most. 0 where unseen.
    profiles : (l,)
        Number of profiles with both edges.
    """

    width: Float[np.ndarray, " l"]
    sigma: Float[np.ndarray, " l"]
    lasting: Float[np.ndarray, " l"]
    taper: Float[np.ndarray, " l"]
    taper_sigma: Float[np.ndarray, " l"]
    pixels: Float[np.ndarray, " l"]
    profiles: Int[np.ndarray, " l"]


@dataclass(frozen=True, slots=True, eq=False)
class FilteredWidths:
    """Filtered widths of every frame and link, model units; sigma inf, and width 0, before a link was first seen."""

    width: Float[np.ndarray, "n l"]
    sigma: Float[np.ndarray, "n l"]


def opposite_edges(
    samplers: Samplers, found: Bool[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Indices of the found edges on side +1 that have one opposite, and of those, link by link.

    Only samplers that stand on one side each are paired: those across a link (side 0) find both edges in one match with
    a template, which has its width from the model.
    """
    plus, minus = np.empty(found.size, dtype=np.int64), np.empty(found.size, dtype=np.int64)
    count = _kernels.opposite_edges(found, samplers.link, samplers.along, samplers.side, plus, minus)
    return plus[:count], minus[:count]


def opposite_edges_numpy(
    samplers: Samplers, found: Bool[np.ndarray, " n"]
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """The same as `opposite_edges` in plain NumPy: the twin of the compiled kernel."""
    place = samplers.link + samplers.along  # along is inside (0, 1) on the sides
    plus, minus = np.flatnonzero(found & (samplers.side == 1)), np.flatnonzero(found & (samplers.side == -1))
    _, one, other = np.intersect1d(place[plus], place[minus], return_indices=True)
    return plus[one], minus[other]


def profile_widths(seen: Look, pills: Pills) -> ProfileWidths:
    """Widths of all profiles of a look that have both edges (hand thesis, appendix E).

    Parameters
    ----------
    seen : Look
        Samplers and edges; their pixels need not lie on the outline of the pills.
    pills : Pills
        The model at the pose that is taken for true, camera axes; its taper is used, its radii are not.
    """
    s, e = seen.samplers, seen.edges
    plus, minus = opposite_edges(s, seen.found)
    out = np.empty((plus.size, 5))
    _kernels.profile_widths(
        pills.base,
        pills.tip,
        pills.radius,
        plus,
        minus,
        s.link,
        s.ray,
        s.slope,
        e.offset,
        e.sigma,
        e.xy,
        s.direction,
        out,
    )
    return ProfileWidths(s.link[plus], *out.T)


def profile_widths_numpy(seen: Look, pills: Pills) -> ProfileWidths:
    """The same as `profile_widths` in plain NumPy: the twin of the compiled kernel."""
    s, e = seen.samplers, seen.edges
    pair = np.stack(opposite_edges_numpy(s, seen.found))
    link, at = s.link[pair], s.ray[pair] + e.offset[pair][..., None] * s.slope[pair]
    flat = at.reshape(-1, 6)
    gap = clearance(pills, link.reshape(-1), flat[:, :3], flat[:, 3:])
    along, depth = gap.along.reshape(pair.shape), gap.depth.reshape(pair.shape)
    slope, normal = s.slope[pair], gap.normal.reshape(*pair.shape, 3)
    per_pixel = np.abs((normal * (slope[..., :3] + depth[..., None] * slope[..., 3:])).sum(axis=-1))
    r0, r1 = pills.radius[link, 0], pills.radius[link, 1]
    radius = gap.distance.reshape(pair.shape) + r0 + along * (r1 - r0)
    across = s.direction[pair[0]] - s.direction[pair[1]]
    apart = e.xy[pair[0]] - e.xy[pair[1]]
    return ProfileWidths(
        link[0],
        along.mean(axis=0),
        radius.sum(axis=0),
        np.hypot(*(per_pixel * e.sigma[pair])),
        (apart * across).sum(axis=1) / np.maximum(np.linalg.norm(across, axis=1), 1e-12),
        np.hypot(*e.sigma[pair]),
    )


def link_widths(profiles: ProfileWidths, radius: Float[np.ndarray, "l 2"], common: float = COMMON) -> LinkWidths:
    """The width of each link from its profiles, robustly.

    With `d_i` the difference of a profile's width to the model's at its place s_i, Cauchy weights and the profiles' own
    scatter as scale, `d_i = d + t (s_i - 1/2)` is fitted; t has a normal prior of a tenth of the width, so that a link
    of which only one end is seen has a larger sigma in its middle.

    Two causes of error are the same for all profiles and frames. The edges of one side share what shading and blur are
    off by. And edges are drawn towards the model, because the shading of the surface was learnt inside its outline: a
    model that is too wide takes background for a dark rim. Half of a clear difference to the model counts for that, a
    fifth where the model is too narrow.

    Parameters
    ----------
    radius : (l, 2)
        Radii of the model at base and tip.
    common : float
        Standard deviation of what the edges of one side share, pixels: more profiles do not average it away.

    >>> one = np.ones(2)
    >>> two = ProfileWidths(np.array([0, 0]), np.array([0.25, 0.75]), 21.0 * one, 0.1 * one, 63.0 * one, 0.3 * one)
    >>> seen = link_widths(two, np.array([[10.0, 10.0], [9.0, 9.0]]))
    >>> seen.width.round(6).tolist(), seen.profiles.tolist(), seen.sigma.round(3).tolist()
    ([21.0, 0.0], [2, 0], [0.211, inf])
    """
    rows = np.column_stack([profiles.along, profiles.width, profiles.sigma, profiles.pixels])
    out = np.empty((radius.shape[0], 7))
    _kernels.link_widths(rows, profiles.link, radius, common, _TAPER, _PULL, _CLEAR, CAUCHY_C, out)
    width, sigma, lasting, taper, taper_sigma, pixels, count = out.T
    return LinkWidths(width, sigma, lasting, taper, taper_sigma, pixels, count.astype(int))


def link_widths_numpy(profiles: ProfileWidths, radius: Float[np.ndarray, "l 2"], common: float = COMMON) -> LinkWidths:
    """The same as `link_widths` in plain NumPy: the twin of the compiled kernel."""
    mean, growth = radius.sum(axis=1), 2.0 * (radius[:, 1] - radius[:, 0])
    zero = np.zeros(mean.size)
    found = LinkWidths(zero, zero + np.inf, zero.copy(), growth, _TAPER * mean, zero.copy(), zero.astype(int))
    for k in np.unique(profiles.link):
        of = profiles.link == k
        s, sigma = profiles.along[of] - 0.5, profiles.sigma[of]
        d = profiles.width[of] - mean[k] - s * growth[k]
        fit, scale = np.array([np.median(d), 0.0]), 1.0
        design = np.stack([np.ones_like(s), s], axis=1)
        for _ in range(_STEPS):
            z = (d - design @ fit) / sigma
            if d.size >= _LEAST_FOR_SCALE:
                scale = max(1.0, 1.4826 * float(np.median(np.abs(z))))
            weight = cauchy_weight(z / scale) / (scale * sigma) ** 2
            normal = (design * weight[:, None]).T @ design
            normal[1, 1] += (_TAPER * mean[k]) ** -2.0
            fit = np.linalg.solve(normal, design.T @ (weight * d))
        variance = np.diag(np.linalg.inv(normal))
        found.width[k], found.taper[k], found.taper_sigma[k] = mean[k] + fit[0], growth[k] + fit[1], variance[1] ** 0.5
        found.pixels[k], found.profiles[k] = np.average(profiles.pixels[of], weights=weight), d.size
        shared = 2.0 * (common * found.width[k] / found.pixels[k]) ** 2
        pull = _PULL[0] if fit[0] < 0.0 else _PULL[1]
        lasting = shared + pull**2 * max(fit[0] ** 2 - _CLEAR**2 * (variance[0] + shared), 0.0)
        found.sigma[k], found.lasting[k] = np.sqrt(variance[0] + lasting), np.sqrt(lasting)
    return found


def widths_in_views(seen: Sequence[Look], pills: Sequence[Pills], radius: Float[np.ndarray, "l 2"]) -> LinkWidths:
    """The width of each link from one look at each view, weighted by their inverse variances.

    What lasts is taken to be the same in all views. The tapers of all views carry the same prior, so theirs is that of
    the view that tells most.
    """
    each = [link_widths(profile_widths(*view), radius) for view in zip(seen, pills, strict=True)]
    if len(each) == 1:
        return each[0]
    weight = np.array([view.sigma for view in each]) ** -2.0
    total = weight.sum(axis=0)
    share = weight / np.where(total > 0.0, total, 1.0)
    alone = np.array([np.where(view.profiles > 0, view.sigma**2 - view.lasting**2, 0.0) for view in each])
    lasting = (share * np.array([view.lasting for view in each])).sum(axis=0)
    best, links = np.argmax(weight, axis=0), np.arange(radius.shape[0])
    taper, taper_sigma, pixels = (
        np.array([getattr(view, name) for view in each])[best, links] for name in ("taper", "taper_sigma", "pixels")
    )
    return LinkWidths(
        width=(share * np.array([view.width for view in each])).sum(axis=0),
        sigma=np.where(total > 0.0, np.sqrt((share**2 * alone).sum(axis=0) + lasting**2), np.inf),
        lasting=lasting,
        taper=taper,
        taper_sigma=taper_sigma,
        pixels=pixels,
        profiles=np.sum([view.profiles for view in each], axis=0),
    )


def constant_gain(
    predicted: Float[np.ndarray, " l"], measured: Float[np.ndarray, "n l"], gain: float
) -> Float[np.ndarray, " l"]:
    """One update of the hand thesis, appendix E: `(1 - g) p + g / N sum p_i`.

    With N = 1 it is the appendix's update of one profile's own width, `p + g e`; the prediction of a constant is its
    last estimate.

    Parameters
    ----------
    predicted, measured : (l,), (n, l)
        Widths so far, and N redundant measures of each.
    gain : float
        g, 0 to 1; `1 - theta^3` for the discounting factor theta of the hand thesis, section 5.1.2.

    >>> constant_gain(np.array([20.0]), np.array([[21.0], [23.0]]), 0.5).tolist()
    [21.0]
    """
    if not 0.0 <= gain <= 1.0:
        raise ValueError(f"gain: got {gain}, wanted a number from 0 to 1")
    if not measured.shape[0]:
        raise ValueError("measured: has no width, at least one is wanted")
    return predicted + gain * (measured - predicted).mean(axis=0)


def filter_widths(
    width: Float[np.ndarray, "n l"],
    sigma: Float[np.ndarray, "n l"],
    lasting: Float[np.ndarray, "n l"] | None = None,
    gain: float | None = None,
) -> FilteredWidths:
    """Widths of one frame after the other, filtered recursively as constants (hand thesis, appendix E).

    Parameters
    ----------
    width, sigma : (n, l)
        Measured widths and their standard deviations; sigma inf where a link was not seen, which leaves its estimate.
    lasting : (n, l) or None
        The part of sigma that is the same in all frames, which averaging cannot reduce; None for no such part.
    gain : float or None
        The appendix's constant gain g; None for the gain that follows from the variances, `P / (P + sigma^2)`.

    Returns
    -------
    FilteredWidths
        The first measurement starts the filter. With the constant gain its sigma follows from that gain,
        `P = (1 - g)^2 P + g^2 sigma^2`, which is what the appendix leaves out.

    Raises
    ------
    ValueError
        For a gain outside (0, 1].

    >>> seen = filter_widths(np.array([[20.0], [22.0]]), np.ones((2, 1)))
    >>> seen.width.tolist(), seen.sigma.round(4).tolist()
    ([[20.0], [21.0]], [[1.0], [0.7071]])
    """
    kept = np.zeros(width.shape) if lasting is None else lasting
    if gain is not None and not 0.0 < gain <= 1.0:
        raise ValueError(f"gain: got {gain}, wanted a number above 0 and at most 1, or None")
    links = width.shape[1]
    now, variance, stays, begun = np.zeros(links), np.zeros(links), np.zeros(links), np.zeros(links, dtype=bool)
    filtered, spread = np.zeros(width.shape), np.full(width.shape, np.inf)
    for i in range(width.shape[0]):
        seen = np.isfinite(sigma[i])
        alone = np.where(seen, np.maximum(np.where(seen, sigma[i], 0.0) ** 2 - kept[i] ** 2, 0.0), 0.0)
        total = variance + alone
        own = np.divide(variance, total, out=np.ones(links), where=total > 0.0) if gain is None else gain
        g = np.where(seen, np.where(begun, own, 1.0), 0.0)
        now = now + g * (width[i] - now)
        variance = (1.0 - g) ** 2 * variance + g**2 * alone
        stays = (1.0 - g) * stays + g * kept[i]
        begun = begun | seen
        filtered[i], spread[i] = now, np.where(begun, np.sqrt(variance + stays**2), np.inf)
    return FilteredWidths(filtered, spread)


def measured_radii(
    radius: Float[np.ndarray, "l 2"], width: Float[np.ndarray, " l"], sigma: Float[np.ndarray, " l"]
) -> Float[np.ndarray, "l 2"]:
    """A model's radii scaled so that every measured link has its width in the middle; the others as they are.

    What the appendix wants the width for: tracking again with these radii renders better templates.

    Parameters
    ----------
    radius : (l, 2)
        Radii of the model at base and tip.
    width, sigma : (l,)
        Filtered widths, the last row of `filter_widths`; sigma inf where a link was never measured.

    >>> radius = np.array([[10.0, 8.0], [7.0, 7.0]])
    >>> measured_radii(radius, np.array([19.8, 0.0]), np.array([0.1, np.inf])).round(3).tolist()
    [[11.0, 8.8], [7.0, 7.0]]
    """
    scale = np.where(np.isfinite(sigma), width / radius.sum(axis=1), 1.0)
    return radius * scale[:, None]
