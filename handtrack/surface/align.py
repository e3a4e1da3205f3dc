"""Images and a pose close to the right one in, the pose that aligns every pixel of the surface out.

Gauss-Newton steps on residuals of all pixels (`surface.dense`) and the prediction. As in `handtrack.refine`, light and
gains are solved for with the pose and eliminated, single pixels that do not fit get robust weights, and what the
appearance cannot express is an error that all pixels of a patch share, its size estimated from the residuals.

Two things that residuals do not show are added to the covariance of the pixels, A^-1: every link of the surface may be
displaced by some hundredths of a pixel (a renderer, a lens or a skin that are a little different), with H the gradients
of the image on each link,

    C = A^-1 + A^-1 (tau^2 sum_l J^T H_l H_l^T J) A^-1,

and where outlines and shading contradict each other by more than both claim, one of them is wrong: see `conflict`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

from ..camera import Camera
from ..robust import cauchy_weight, median
from ..scatter import Whitener
from .dense import LIGHTS, Dense, dense_rows
from .image import EDGE
from .shading import SurfaceAppearance
from .skin import Surface

_STEPS = 5
_REST = 0.5  # of a sigma in each joint: a step at which the pose rests
_GAIN_SIGMA = 0.02  # of each region's gain
_LIGHT_SIGMA = 3.0  # grey levels, of each coefficient of the shading
_LEAST_PIXELS = 60
_LEAST_CONTRAST = 5.0  # in units of the noise
_FIRST_COVER = 0.1  # error of the covered share of a pixel before it was estimated
_REWEIGHED = 2
_SHRINK = 0.1  # of the covariance, with each step
_MOST_SPREAD = 4.0
_LEAST_S, _CUT = 0.8, 4.0
_CAUCHY = 1.15  # what the scatter of residuals with Cauchy's weights falls short of what it does to a pose
_DISPLACED = 0.01  # pixels by which a link may be displaced without any trace
_MOST_CONFLICT = 20.0
_LIKELY = 10.0  # times the scatter of grey levels: a pixel that is farther off shows something else


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """An aligned pose.

    Attributes
    ----------
    u, information : (k,), (k, k)
        Free joints, and what the images alone say of them.
    residual : float
        Root mean square of the pixels' residuals in units of the noise.
    fitting : float
        Share of the pixels within the surface that show about what they should: small where there is no hand.
    conflict : float
        Squared distance of the poses that outlines and shading tell apart, in units of what it should be: about 1.
    """

    u: Float[np.ndarray, " k"]
    information: Float[np.ndarray, "k k"]
    residual: float
    fitting: float
    conflict: float


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """Gradient g (k,) and matrix A (k, k) of the pixels; the same of those on outlines, `edge_g` and `edge_A`;
    the matrix of displaced links, `shifted`; sum of squared residuals and their number; pixels within the surface, and
    how many of them show about what they should."""

    g: Float[np.ndarray, " k"]
    A: Float[np.ndarray, "k k"]
    edge_g: Float[np.ndarray, " k"]
    edge_A: Float[np.ndarray, "k k"]
    shifted: Float[np.ndarray, "k k"]
    squares: float
    count: int
    within: int
    fitting: int

    def plus(self, other: "_System") -> "_System":
        """Two views together."""
        return _System(*(getattr(self, field.name) + getattr(other, field.name) for field in fields(self)))


def align(
    images: Sequence[Float[np.ndarray, "h w"]],
    surface: Surface,
    cameras: Sequence[Camera],
    appearance: Sequence[SurfaceAppearance],
    u: Float[np.ndarray, " k"],
    mean: Float[np.ndarray, " k"],
    prior: Float[np.ndarray, "k k"],
    covariance: Float[np.ndarray, "k k"],
    stride: int = 3,
    steps: int = _STEPS,
) -> Aligned:
    """Align all views in one solve.

    Parameters
    ----------
    u : (k,)
        Pose from the edges, within a pixel or two of the right one.
    mean, prior : (k,), (k, k)
        Prediction and its information.
    covariance : (k, k)
        How far off u may be: residuals that this explains are no outliers.
    stride : int
        Inside the surface one pixel in `stride` along rows and columns is taken.
    """
    limits = surface.model.limits[surface.model.free]
    views = list(zip(images, cameras, appearance, strict=True))
    system = _nothing(u.size)
    for _ in range(steps):
        system = _normal_equations(views, surface, u, stride, covariance)
        g, both = system.g + prior @ (u - mean), system.A + prior
        free = ~((u <= limits[:, 0]) & (g > 0.0) | (u >= limits[:, 1]) & (g < 0.0))
        h = np.zeros(u.size)
        h[free] = -np.linalg.solve(both[np.ix_(free, free)], g[free])
        u = np.clip(u + h, limits[:, 0], limits[:, 1])
        covariance = _SHRINK * covariance
        if h @ both @ h < _REST**2 * u.size:
            break
    # (A^-1 + A^-1 S A^-1)^-1, also where A has no inverse.
    least = 1e-9 * max(float(np.trace(system.A)), 1e-9) * np.eye(u.size)
    information = system.A @ np.linalg.solve(system.A + system.shifted + least, system.A)
    information = 0.5 * (information + information.T)
    residual = float(np.sqrt(system.squares / max(system.count, 1)))
    return Aligned(u, information, residual, system.fitting / max(system.within, 1), _conflict(system))


def _nothing(k: int) -> _System:
    return _System(
        *(np.zeros(shape) for shape in ((k,), (k, k), (k,), (k, k), (k, k))), squares=0.0, count=0, within=0, fitting=0
    )


def _conflict(system: _System) -> float:
    """(d_1 - d_2)^T (A_1^-1 + A_2^-1)^-1 (d_1 - d_2) / k with d_i = A_i^-1 g_i: outlines against all else."""
    k = system.g.size
    least = 1e-6 * max(float(np.trace(system.A)), 1e-9) / k * np.eye(k)
    A1, A2 = system.edge_A + least, system.A - system.edge_A + least
    apart = np.linalg.solve(A1, system.edge_g) - np.linalg.solve(A2, system.g - system.edge_g)
    spread = np.linalg.inv(A1) + np.linalg.inv(A2)
    return float(np.clip(apart @ np.linalg.solve(spread, apart) / k, 0.0, _MOST_CONFLICT))


def _normal_equations(
    views: Sequence[tuple[Float[np.ndarray, "h w"], Camera, SurfaceAppearance]],
    surface: Surface,
    u: Float[np.ndarray, " k"],
    stride: int,
    covariance: Float[np.ndarray, "k k"],
) -> _System:
    """The pixels of all views."""
    out = _nothing(u.size)
    for image, camera, appearance in views:
        rows = dense_rows(image, surface, camera, u, appearance, stride)
        if rows.r.size >= _LEAST_PIXELS:
            shift = _gradients(image, rows, appearance.noise)
            likely = _LIKELY * max(1.0, appearance.spread / appearance.noise)
            out = out.plus(_eliminated(rows, shift, _known(surface), covariance, likely))
    return out


def _gradients(image: Float[np.ndarray, "h w"], rows: Dense, noise: float) -> Float[np.ndarray, "n 2"]:
    """What a displacement by tau pixels along x and along y changes, in units of the noise."""
    row, column = rows.row, rows.column
    up, down = np.maximum(row - 1, 0), np.minimum(row + 1, image.shape[0] - 1)
    left, right = np.maximum(column - 1, 0), np.minimum(column + 1, image.shape[1] - 1)
    by_x = image[row, right] - image[row, left]
    by_y = image[down, column] - image[up, column]
    return 0.5 * _DISPLACED / noise * np.column_stack([by_x, by_y])


def _known(surface: Surface) -> Float[np.ndarray, " m"]:
    """Information on the coefficients of the shading, the light's share and the gains, from earlier frames."""
    sigma = np.full(LIGHTS + surface.finger.size, _LIGHT_SIGMA)
    sigma[LIGHTS:] = _GAIN_SIGMA
    return sigma**-2.0


def _eliminated(
    rows: Dense,
    shift: Float[np.ndarray, "n 2"],
    known: Float[np.ndarray, " m"],
    covariance: Float[np.ndarray, "k k"],
    likely: float,
) -> _System:
    """One view with light and gains solved for.

    Weights and scatter are those of what pose and light together leave of the residuals: a pose that is off must not
    look like outliers, nor like errors that patches share.
    """
    k = rows.J.shape[1]
    both = np.hstack([rows.J, rows.B])
    prior = np.zeros((k + known.size, k + known.size))
    prior[:k, :k] = np.linalg.inv(covariance)
    prior[range(k, prior.shape[0]), range(k, prior.shape[0])] = known
    pose = ((rows.J @ covariance) * rows.J).sum(axis=1)
    spread = np.sqrt(1.0 + (_FIRST_COVER * rows.contrast) ** 2)
    weight = cauchy_weight(rows.r / np.sqrt(spread**2 + pose)) / spread**2
    for _ in range(_REWEIGHED):
        weighted = both * weight[:, None]
        left = rows.r - both @ np.linalg.solve(weighted.T @ both + prior, weighted.T @ rows.r)
        spread = _spread(left, rows)
        weight = cauchy_weight(left / spread) / spread**2
    weight = np.sqrt(weight)
    s, tau = patch_scatter(weight * left, rows.patch, rows.kind)
    white, scale = Whitener(1.0, rows.patch, *_patches(rows, s, tau)), weight / (_CAUCHY * s)
    r, each = white(scale * rows.r, scale[:, None] * both)
    J, B = each[:, :k], each[:, k:]
    K = B.T @ B
    K[range(known.size), range(known.size)] += known
    solved = np.linalg.solve(K, B.T @ np.column_stack([J, r]))
    J_free, r_free = J - B @ solved[:, :k], r - B @ solved[:, k]
    # The map that whitens is symmetric: it is cheaper to apply it to J once more than to every displaced link.
    _, J_twice = white(r_free, J_free)
    weighed = scale[:, None] * shift
    links = [np.flatnonzero(rows.region == link) for link in np.unique(rows.region[rows.region >= 0])]
    JH = np.hstack([J_twice[link].T @ weighed[link] for link in links] or [np.zeros((k, 0))])
    outline = rows.kind == EDGE
    edge_A = J_free[outline].T @ J[outline]
    return _System(
        J_free.T @ r,
        J_free.T @ J,
        J_free[outline].T @ r_free[outline],
        0.5 * (edge_A + edge_A.T),
        JH @ JH.T,
        float(rows.r @ rows.r),
        rows.r.size,
        int((~outline).sum()),
        int((np.abs(rows.r[~outline]) < likely).sum()),
    )


def _spread(left: Float[np.ndarray, " n"], rows: Dense) -> Float[np.ndarray, " n"]:
    """Standard deviation of each residual: noise, and on outlines an error of the covered share, `q contrast`.

    A renderer takes few points of a pixel, a sensor does not weigh its area evenly: q follows from what is left on
    outlines. Away from them the scatter is that of the residuals, at least that of the noise.
    """
    out = np.ones(left.size)
    outline = rows.contrast > _LEAST_CONTRAST
    if outline.sum() >= _LEAST_PIXELS:
        share = np.abs(left[outline]) / rows.contrast[outline]
        noise2 = 1.0 / rows.contrast[outline] ** 2
        cut = _CUT * 1.4826 * median(share)
        q2 = float((np.minimum(share, cut) ** 2 - noise2).mean())
        out[outline] = np.sqrt(1.0 + max(q2, 0.0) * rows.contrast[outline] ** 2)
    for which in np.unique(rows.kind):
        at = (rows.kind == which) & ~outline
        out[at] = min(max(1.0, 1.4826 * median(np.abs(left[at]))), _MOST_SPREAD)
    return out


def _patches(
    rows: Dense, s: Float[np.ndarray, " n"], tau: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " p"]]:
    """Unit vector and share of each patch's common error, its size differing by kind of pixel."""
    count = np.bincount(rows.patch).astype(float)
    of_patch = np.zeros(count.size)
    of_patch[rows.patch] = tau / s
    return (1.0 / np.sqrt(count))[rows.patch], 1.0 - 1.0 / np.sqrt(1.0 + of_patch**2 * count)


def patch_scatter(
    r: Float[np.ndarray, " n"], patch: Int[np.ndarray, " n"], kind: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """For each pixel: scatter within and between patches of its kind, in units of the noise (method of moments)."""
    s, tau = np.ones(r.size), np.zeros(r.size)
    for which in np.unique(kind):
        at = kind == which
        s[at], tau[at] = _scatter_of(r[at], patch[at])
    return s, tau


def _scatter_of(r: Float[np.ndarray, " n"], patch: Int[np.ndarray, " n"]) -> tuple[float, float]:
    _, member, count = np.unique(patch, return_inverse=True, return_counts=True)
    member = member.reshape(-1)
    cut = _CUT * 1.4826 * median(np.abs(r))
    r = np.clip(r, -cut, cut)
    mean = np.bincount(member, r) / count
    within = float(((r - mean[member]) ** 2).sum() / max(r.size - count.size, 1))
    s = max(float(np.sqrt(within)), _LEAST_S)
    full: Bool[np.ndarray, " p"] = count >= 4
    if full.sum() < 4:
        return s, 0.0
    between = float((mean[full] ** 2).mean())
    return s, float(np.sqrt(max(between - s * s * float((1.0 / count[full]).mean()), 0.0)))
