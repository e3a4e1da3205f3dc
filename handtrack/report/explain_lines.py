"""A frame measured with `lines` in; its pairs of edges, boundary lines, axes and tips as SVG, and their votes, out.

The tracker keeps only axes and tips. Which profiles voted for the boundary lines is found again the same way: the
pair of edges of each profile that was found, the line with most inliers through those of a side (hand thesis, 4.4).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..across import across
from ..axes import TOLERANCE
from ..lines import Line, fit_line
from ..measure_lines import COUNT
from ..replay import Replay
from ..residuals import LineFeatures
from .explain_evidence import appearance_of

_BEYOND = 8.0  # pixels that lines are drawn beyond their outermost points


@dataclass(frozen=True, slots=True, eq=False)
class Boundaries:
    """Boundary lines of the links that have them.

    Attributes
    ----------
    link : (a,)
    points, inlier : (a, 2, n, 2), (a, 2, n)
        Edge points of side -1 and +1, NaN where a profile gave none, and whether they agree with the line.
    line : Line
        Batch axes (a, 2).
    """

    link: Int[np.ndarray, " a"]
    points: Float[np.ndarray, "a 2 n 2"]
    inlier: Bool[np.ndarray, "a 2 n"]
    line: Line


def boundaries(past: Replay, view: int) -> Boundaries:
    """The boundary lines of one view, found again from the edges of its profiles."""
    on, look = past.on[view], past.frame.estimate.seen[view]
    appearance = appearance_of(past)[view]
    polygons = past.settings.visibility == "polygons"
    wide = across(look.pills, on.model.link_finger, on.camera, appearance, COUNT, polygons)
    count = np.bincount(look.samplers.link[look.found], minlength=on.model.link_frame.size)
    links = np.flatnonzero(count >= 3)
    points, sigma = np.full((links.size, 2, COUNT, 2), np.nan), np.full((links.size, 2, COUNT), np.inf)
    for row, link in enumerate(links):
        mine = np.flatnonzero(look.found & (look.samplers.link == link))
        for side in (0, 1):
            own = mine[look.samplers.side[mine] == (-1, 1)[side]]
            if own.size:  # a method that finds each side by itself
                points[row, side, : own.size] = look.edges.xy[own]
                sigma[row, side, : own.size] = look.edges.sigma[own]
                continue
            if look.samplers.side[mine].any():
                continue
            at = look.edges.offset[mine] + wide.edge[mine, side]
            points[row, side, : mine.size] = look.samplers.origin[mine] + at[:, None] * look.samplers.direction[mine]
            sigma[row, side, : mine.size] = np.sqrt(2.0) * look.edges.sigma[mine]
    line = fit_line(points, sigma, TOLERANCE)
    return Boundaries(links, points, line.inliers, line)


def votes(found: Boundaries) -> tuple[tuple[int, str], ...]:
    """For each link, how many points agree with its two boundary lines, in words."""
    given = np.isfinite(found.points).all(axis=-1).sum(axis=-1)
    agree = found.inlier.sum(axis=-1)
    words = [f"{a[0]} of {n[0]}, {a[1]} of {n[1]}" for a, n in zip(agree, given, strict=True)]
    return tuple(zip(found.link.tolist(), words, strict=True))


def draw_lines(past: Replay, view: int) -> Iterator[str]:
    """Points of the edges, boundary lines through them, axes, tips with their circle of two sigmas."""
    features = past.frame.estimate.seen[view].features
    if not isinstance(features, LineFeatures):
        return
    found = boundaries(past, view)
    for row, link in enumerate(found.link):
        for side in (0, 1):
            yield from _boundary(found, row, side, int(link))
    for link, (a, b, rho) in zip(features.line_link, features.line, strict=True):
        near = found.points[found.link == link].reshape(-1, 2)
        yield _segment("axial", int(link), np.array([-b, a]), rho * np.array([a, b]), near)
    for link, (x, y), sigma in zip(features.tip_link, features.tip, features.tip_sigma, strict=True):
        yield (
            f'<path class="tip-cross" data-link="{link}" d="M{x - 3:.1f} {y:.1f}h6M{x:.1f} {y - 3:.1f}v6"/>'
            f'<circle class="tip-sigma" cx="{x:.1f}" cy="{y:.1f}" r="{2 * sigma:.2f}"/>'
        )


def _boundary(found: Boundaries, row: int, side: int, link: int) -> Iterator[str]:
    points = found.points[row, side]
    for (x, y), agrees in zip(points, found.inlier[row, side], strict=True):
        if np.isfinite(x):
            kind = "vote" if agrees else "no-vote"
            yield f'<circle class="{kind}" data-link="{link}" cx="{x:.1f}" cy="{y:.1f}" r="1.5"/>'
    line = found.line[row, side]
    if line.valid:
        yield _segment("boundary", link, line.direction, line.centroid, points)


def _segment(
    kind: str,
    link: int,
    direction: Float[np.ndarray, " 2"],
    point: Float[np.ndarray, " 2"],
    near: Float[np.ndarray, "n 2"],
) -> str:
    """The part of a line beside the points near it."""
    along = (near[np.isfinite(near).all(axis=1)] - point) @ direction
    low, high = (float(along.min()), float(along.max())) if along.size else (-20.0, 20.0)
    (x0, y0), (x1, y1) = point + np.array([[low - _BEYOND], [high + _BEYOND]]) * direction
    return f'<path class="{kind}" data-link="{link}" d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}"/>'
