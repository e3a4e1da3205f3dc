"""Boundary and axial lines: edge points of one side of a link in, lines with their covariance out.

A line is kept as the normal form of the hand thesis, eq. (3.2), ``a x + b y - rho = 0``, next to a point and a
direction. Fitting (section 4.4) tries the line through every pair of points, keeps the one with most inliers, and
refines it by a weighted principal component analysis of those. The axial line of a link is the bisector of its two
boundary lines: where both are equally far,

    (n1 . x - rho1) + (n2 . x - rho2) = 0,    n1, n2 turned to agree.

That sum needs no intersection point, so it holds alike for parallel, nearly parallel and converging boundaries, where
the intersection (4.2)-(4.3) loses all its digits long before the determinant falls under the thesis's threshold.

All functions take leading batch axes ``*b``: the groups of many links are fitted at once.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Shaped

Index = int | slice | np.ndarray

MIN_PAIR = 1e-9  # px: two points closer than this give no direction


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Lines in the image, one per batch entry; NaN throughout where ``status`` is not ``ok``.

    Attributes
    ----------
    normal : (*b, 2) unit normal (a, b), the direction turned by +90 degrees (x towards y).
    rho : (*b) px, ``normal . centroid``.
    centroid : (*b, 2) px, a point of the line: the weighted mean of the inliers.
    direction : (*b, 2) unit, headed from the first towards the last of the points.
    inliers : (*b, n) which points the line was fitted to.
    covariance : (*b, 2, 2) of (angle in radians, offset along the normal at the centroid in px).
    status : (*b) ``ok``, ``few points`` (under two distinct usable ones) or ``no direction`` (a round scatter).
    """

    normal: Float[np.ndarray, "*b 2"]
    rho: Float[np.ndarray, "*b"]
    centroid: Float[np.ndarray, "*b 2"]
    direction: Float[np.ndarray, "*b 2"]
    inliers: Bool[np.ndarray, "*b n"]
    covariance: Float[np.ndarray, "*b 2 2"]
    status: Shaped[np.ndarray, "*b"]

    def __getitem__(self, index: Index | tuple[Index, ...]) -> "Line":
        """Choose along the batch axes: of lines (l, 2), ``lines[:, 0]`` are the l first ones."""
        fields = (self.normal, self.rho, self.centroid, self.direction, self.inliers, self.covariance, self.status)
        return Line(*(np.asarray(field[index]) for field in fields))

    @property
    def valid(self) -> Bool[np.ndarray, "*b"]:
        """Where the line may be used."""
        return np.asarray(self.status == "ok")

    @property
    def angle(self) -> Float[np.ndarray, "*b"]:
        """Direction of the line in radians, from x towards y, in (-pi, pi]."""
        return np.asarray(np.arctan2(self.direction[..., 1], self.direction[..., 0]))


def fit_line(points: Float[np.ndarray, "*b n 2"], sigma: Float[np.ndarray, "*b n"], tolerance: float) -> Line:
    """Fit lines to points with outliers: deterministic RANSAC over all pairs, then weighted total least squares.

    Parameters
    ----------
    points : (*b, n, 2) px, in order along the link. A point that is not finite is left out, so groups may be padded.
    sigma : (*b, n) px, standard deviation of a point across the line, > 0; one of infinite or NaN sigma is left out.
    tolerance : px, a point at most this far from a pair's line is its inlier (tau of the hand thesis); inf takes all.

    Returns
    -------
    Line
        with batch axes ``*b``. The pair with most inliers wins; among equals the least sum of squared distances in
        units of sigma. The covariance is first order and takes ``sigma`` at its word.

    Raises
    ------
    ValueError
        for a tolerance or a sigma that is not positive.

    Notes
    -----
    Hand thesis, section 4.4; with weights w = 1/sigma^2 and S the weighted scatter of the inliers, the line runs along
    the main eigenvector of S, var(angle) = 1 / (l1 - l2) and var(offset) = 1 / sum(w). The difference of the
    eigenvalues stands for the spread along the line alone, as noise adds alike to both.

    Examples
    --------
    >>> line = fit_line(np.array([[0.0, 1.0], [1.0, 1.0], [2.0, 5.0], [3.0, 1.0]]), np.ones(4), tolerance=0.5)
    >>> line.direction.tolist(), float(line.rho), line.inliers.tolist()
    ([1.0, 0.0], 1.0, [True, True, False, True])
    """
    if not tolerance > 0:
        raise ValueError(f"tolerance is {tolerance}; wanted a positive distance in pixels")
    if np.any(sigma <= 0):
        raise ValueError(f"sigma holds {np.nanmin(sigma)}; wanted positive standard deviations in pixels")
    usable = np.isfinite(points).all(axis=-1) & np.isfinite(sigma)
    points = np.where(usable[..., None], points, 0.0)
    weight = np.where(usable, 1.0 / np.square(sigma), 0.0)
    inliers = _consensus(points, weight, usable, tolerance)
    return _total_least_squares(points, np.where(inliers, weight, 0.0), inliers)


def _consensus(
    points: Float[np.ndarray, "*b n 2"],
    weight: Float[np.ndarray, "*b n"],
    usable: Bool[np.ndarray, "*b n"],
    tolerance: float,
) -> Bool[np.ndarray, "*b n"]:
    """Inliers of the best pair of points; none where no pair gives a direction."""
    i, j = np.triu_indices(points.shape[-2], k=1)
    if i.size == 0:
        return np.zeros(usable.shape, dtype=bool)
    along = points[..., j, :] - points[..., i, :]
    length = np.hypot(along[..., 0], along[..., 1])
    possible = usable[..., i] & usable[..., j] & (length > MIN_PAIR)
    along = along / np.where(possible, length, 1.0)[..., None]
    apart = points[..., None, :, :] - points[..., i, None, :]  # (*b, pairs, n, 2), from each pair's first point
    distance = along[..., None, 0] * apart[..., 1] - along[..., None, 1] * apart[..., 0]
    inside = (np.abs(distance) <= tolerance) & usable[..., None, :] & possible[..., None]
    # Rounding must not throw out the two points that define the line, however small the tolerance is.
    pair = np.arange(i.size)
    inside[..., pair, i] |= possible
    inside[..., pair, j] |= possible
    count = inside.sum(axis=-1)
    cost = np.sum(np.where(inside, weight[..., None, :] * np.square(distance), 0.0), axis=-1)
    cost = np.where(count == count.max(axis=-1, keepdims=True), cost, np.inf)
    best = np.argmin(cost, axis=-1)
    return np.take_along_axis(inside, best[..., None, None], axis=-2)[..., 0, :]


def _total_least_squares(
    points: Float[np.ndarray, "*b n 2"], weight: Float[np.ndarray, "*b n"], inliers: Bool[np.ndarray, "*b n"]
) -> Line:
    """Weighted PCA of the inliers (weight 0 elsewhere), in closed form for two dimensions."""
    total = weight.sum(axis=-1)
    enough = inliers.sum(axis=-1) >= 2
    safe_total = np.where(enough, total, 1.0)
    centroid = np.sum(weight[..., None] * points, axis=-2) / safe_total[..., None]
    apart = points - centroid[..., None, :]
    sxx, syy = (np.sum(weight * np.square(apart[..., k]), axis=-1) for k in (0, 1))
    sxy = np.sum(weight * apart[..., 0] * apart[..., 1], axis=-1)
    gap = np.hypot(sxx - syy, 2.0 * sxy)  # l1 - l2
    status = np.where(enough, np.where(gap > 1e-12 * (sxx + syy), "ok", "no direction"), "few points")
    valid = status == "ok"
    angle = np.arctan2(2.0 * sxy, sxx - syy) / 2.0
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    # The points come in order along the link: the sign of their correlation with that order heads the line.
    rank = (
        np.arange(points.shape[-2])
        - np.sum(weight * np.arange(points.shape[-2]), axis=-1)[..., None] / (safe_total[..., None])
    )
    headed = np.sum(weight * rank * (apart @ direction[..., None])[..., 0], axis=-1)
    direction = np.where((headed < 0)[..., None], -direction, direction)
    covariance = np.zeros((*total.shape, 2, 2))
    covariance[..., 0, 0] = 1.0 / np.where(valid, gap, 1.0)
    covariance[..., 1, 1] = 1.0 / safe_total
    return _masked(centroid, direction, covariance, inliers, status)


def _masked(
    centroid: Float[np.ndarray, "*b 2"],
    direction: Float[np.ndarray, "*b 2"],
    covariance: Float[np.ndarray, "*b 2 2"],
    inliers: Bool[np.ndarray, "*b n"],
    status: Shaped[np.ndarray, "*b"],
) -> Line:
    """Complete a line from its point and direction, with NaN where the status is not ``ok``."""
    valid = np.asarray(status == "ok")
    centroid = np.where(valid[..., None], centroid, np.nan)
    direction = np.where(valid[..., None], direction, np.nan)
    normal = np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
    return Line(
        normal=normal,
        rho=np.asarray(np.sum(normal * centroid, axis=-1)),
        centroid=centroid,
        direction=direction,
        inliers=inliers,
        covariance=np.where(valid[..., None, None], covariance, np.nan),
        status=np.asarray(status),
    )


def axial_line(line1: Line, line2: Line) -> Line:
    """Axial lines of links from their two boundary lines: the bisector, with the covariance of both carried over.

    Parameters
    ----------
    line1, line2 : boundary lines of the two sides, of the same batch shape.

    Returns
    -------
    Line
        The points as far from one boundary as from the other. Of the two bisectors it is the one that makes the least
        angle with the boundaries: v2 is turned round where ||v1 + v2|| < ||v1 - v2|| (hand thesis, 4.4). Its centroid
        is the mean of the two mean points, eq. (4.4), brought onto the bisector; its direction follows ``line1``;
        ``inliers`` are those of ``line1``, then of ``line2``. The status is ``ok`` where that of both lines is, else
        the first status that is not.

    Notes
    -----
    The angle is the mean of the two angles. With F(x) = d1(x) + d2(x) the sum of the signed distances, |grad F| =
    |n1 + n2|, and turning line i by da and shifting it by do changes F at the centroid by -(s_i da + do), s_i being
    how far along line i the centroid lies; that gives the offset's row of the Jacobian.

    Examples
    --------
    >>> top = fit_line(np.array([[0.0, 2.0], [4.0, 2.0]]), np.ones(2), tolerance=1.0)
    >>> bottom = fit_line(np.array([[4.0, -4.0], [0.0, -4.0]]), np.ones(2), tolerance=1.0)
    >>> axis = axial_line(top, bottom)
    >>> axis.direction.tolist(), float(axis.rho)
    ([1.0, 0.0], -1.0)
    """
    turn = np.where(np.sum(line1.direction * line2.direction, axis=-1) < 0, -1.0, 1.0)
    v1, v2 = line1.direction, turn[..., None] * line2.direction
    n1, n2 = line1.normal, turn[..., None] * line2.normal
    rho1, rho2 = line1.rho, turn * line2.rho
    norm = np.linalg.norm(n1 + n2, axis=-1)  # at least sqrt(2) once the two agree
    direction = (v1 + v2) / norm[..., None]
    normal = (n1 + n2) / norm[..., None]
    centre = (line1.centroid + line2.centroid) / 2.0
    off = np.sum(normal * centre, axis=-1) - (rho1 + rho2) / norm
    centroid = centre - off[..., None] * normal
    s1 = np.sum((centroid - line1.centroid) * v1, axis=-1)
    s2 = np.sum((centroid - line2.centroid) * v2, axis=-1)
    covariance = np.zeros((*norm.shape, 2, 2))
    # An offset of line 2 is counted along its own normal; turned round, the offset and its cross term change sign.
    for line, s, sign in ((line1, s1, np.ones_like(turn)), (line2, s2, turn)):
        jacobian = np.zeros((*norm.shape, 2, 2))
        jacobian[..., 0, 0] = 0.5
        jacobian[..., 1, 0] = s / norm
        jacobian[..., 1, 1] = sign / norm
        covariance = covariance + jacobian @ line.covariance @ np.swapaxes(jacobian, -1, -2)
    status = np.where(line1.valid, line2.status, line1.status)
    return _masked(centroid, direction, covariance, np.concatenate([line1.inliers, line2.inliers], axis=-1), status)


def distance(
    line: Line, points: Float[np.ndarray, "*b k 2"]
) -> tuple[Float[np.ndarray, "*b k"], Float[np.ndarray, "*b k"]]:
    """Signed distance of points to their line, eq. (3.2) of the hand thesis, and the line's share of its sigma.

    Parameters
    ----------
    line : lines of batch shape ``*b``.
    points : (*b, k, 2) px.

    Returns
    -------
    (distance, sigma)
        px, ``a x + b y - rho``, positive on the side of the normal, and the standard deviation of the line itself
        across its direction beside each point; NaN for a line that is not valid.

    Examples
    --------
    >>> line = fit_line(np.array([[0.0, 1.0], [2.0, 1.0]]), np.ones(2), tolerance=1.0)
    >>> far, sigma = distance(line, np.array([[1.0, 4.0], [2.0, 4.0]]))
    >>> far.tolist(), np.square(sigma).round(6).tolist()
    ([3.0, 3.0], [0.5, 1.0])
    """
    apart = points - line.centroid[..., None, :]
    along = np.sum(apart * line.direction[..., None, :], axis=-1)
    across = np.sum(apart * line.normal[..., None, :], axis=-1)
    c = line.covariance[..., None, :, :]
    variance = np.square(along) * c[..., 0, 0] + 2.0 * along * c[..., 0, 1] + c[..., 1, 1]
    return across, np.sqrt(variance)


def refined_tip(p_tip: Float[np.ndarray, "*b 2"], line: Line) -> Float[np.ndarray, "*b 2"]:
    """Bring predicted finger tips onto their terminal axial lines: the nearest point, hand thesis eq. (4.1).

    Parameters
    ----------
    p_tip : (*b, 2) px, the predicted tip in the image.
    line : axial lines of the distal links, batch shape ``*b``.

    Returns
    -------
    (*b, 2) px; NaN where the line is not valid.

    Examples
    --------
    >>> line = fit_line(np.array([[0.0, 1.0], [4.0, 1.0]]), np.ones(2), tolerance=1.0)
    >>> refined_tip(np.array([3.0, 7.0]), line).tolist()
    [3.0, 1.0]
    """
    along = np.sum((p_tip - line.centroid) * line.direction, axis=-1)
    return line.centroid + along[..., None] * line.direction
