"""Appendix D of the hand thesis, method by method: sequences with known truth in, one row of figures for each method
out.

Two questions are put to every method, and to the comparison with templates (WSSD) that the thesis settled on:

- in single frames, from a pose that is off as a prediction is: how far from the true silhouette do its edges lie,
  how many of those to be seen does it find, how many of its edges are none;
- over whole sequences, as part of the tracker: how far off is the worst joint, and do the sigmas say so.

True edges are where rays cease to hit the true pills, found by halving; the tracker's own outline has no part in it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..across import silhouette_edges
from ..appearance import Appearance, learn
from ..camera import Camera, rays
from ..evaluate import evaluate
from ..kinematics import Model
from ..measure import look, posed
from ..measure_lines import look_lines
from ..pills import Pills, ray_hits
from ..profiles import CAP
from ..residuals import Chain, chain
from ..sequences import Truth
from ..settings import EDGES, Settings
from ..tracker import track

FALSE = 2.0  # pixels: an edge farther from the true one is another edge
_FAR = 30.0  # pixels: how far from a sampler's origin the true edge is looked for
_HALVINGS = 30
_BESIDE = 0.75  # pixels from the true edge, where what is seen on either side decides whether it can be seen
_SIGMA = np.radians(1.0)  # of each joint of the pose that single frames are looked at from
_EVERY = 10  # frames between those looked at one by one

TEMPLATES, VALLEY, PRINTED = "wssd, outline templates", "wssd, valley", "mwplls-iterative as in 6.2"
THEIRS = {
    "difference": "not robust to image noise, but suffices for the purpose of demonstration (11.1.1)",
    "gaussian": "the more robust to image noise of the two (11.2)",
    "width": "allows less motion between frames (11.2.2)",
    "width-compensated": "also finds the weaker, wider peak (11.2.2)",
    "plls": "highly influenced by outliers; not used by itself (11.3.1)",
    "mwplls": "drawn to the centres of mass, biased where a crest stands off centre (11.3.2)",
    "mwplls-iterative": "the same in a much more compact way; the alternative method of 6.2 (11.3.3)",
    VALLEY: "the proposed method of 4.3; 6.1 tracks the crossing with it",
}


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A sequence with its truth; angles in radians."""

    images: tuple[Float[np.ndarray, "h w"], ...]
    model: Model
    camera: Camera
    truth: Float[np.ndarray, "m j"]
    start: Float[np.ndarray, " j"]
    fps: float


@dataclass(frozen=True, slots=True)
class EdgeFigures:
    """How edges compare with the true silhouette.

    Attributes
    ----------
    bias, scatter : float
        Mean (outwards positive) and standard deviation of the error of true edges, pixels.
    normalised : float
        Root mean square of the error over the stated sigma; 1 where sigmas are honest.
    found : float
        Share of the edges to be seen that were found.
    false : float
        Share of the edges found that are more than 2 pixels from the true one, or where none is to be seen.
    """

    bias: float
    scatter: float
    normalised: float
    found: float
    false: float


@dataclass(frozen=True, slots=True)
class TrackFigures:
    """Tracking over several motions: medians, and the number of motions that end more than 15 degrees off or lost."""

    worst_rmse: float
    nees_ratio: float
    frame_ms: float
    lost: int


@dataclass(frozen=True, slots=True)
class Row:
    """One method; None where it is not used that way."""

    method: str
    edges: EdgeFigures | None
    outline: TrackFigures | None
    lines: TrackFigures | None


@dataclass(frozen=True, slots=True, eq=False)
class _Errors:
    """Edges of one look beside the true ones: offset less true offset, stated sigma, found, to be seen."""

    error: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]
    found: Bool[np.ndarray, " n"]
    visible: Bool[np.ndarray, " n"]


def edge_methods(
    motions: Sequence[Motion], methods: Sequence[str] = EDGES, progress: Callable[[int], None] | None = None
) -> tuple[Row, ...]:
    """Measure every method on the same motions.

    Parameters
    ----------
    methods : sequence of str
        Names of `settings.EDGES`; 'wssd' gives two rows, templates on the outline and the valley across links.
    progress : callable
        Called with the number of rows done.
    """
    rows = []
    for name in methods:
        outline, lines = Settings(edges=name), Settings(edges=name, residuals="lines")  # type: ignore[arg-type]
        if name == "wssd":
            rows.append(Row(TEMPLATES, single_frames(motions, outline), tracking(motions, outline), None))
            rows.append(Row(VALLEY, single_frames(motions, lines), None, tracking(motions, lines)))
        else:
            rows.append(
                Row(name, single_frames(motions, outline), tracking(motions, outline), tracking(motions, lines))
            )
        if progress is not None:
            progress(len(rows))
    if "mwplls-iterative" in methods:
        rows.append(Row(PRINTED, None, None, tracking(motions, as_printed())))
        if progress is not None:
            progress(len(rows))
    return tuple(rows)


def as_printed() -> Settings:
    """Section 6.2: Gaussian derivative, compensated restriction, iterative MWPLLS, one step a look, theta 0.85."""
    return Settings(
        residuals="lines", edges="mwplls-iterative", solver="gauss-newton-one", filter="ghk", theta=0.85, passes=1
    )


def tracking(motions: Sequence[Motion], settings: Settings) -> TrackFigures:
    """Track every motion and hold it against its truth."""
    worst, ratio, took, lost = [], [], [], 0
    for motion in motions:
        found = track(motion.images, motion.model, motion.camera, motion.start, motion.fps, settings)
        frames = np.arange(len(motion.images))
        judged = evaluate(found, Truth(frames, motion.truth), motion.model, motion.camera)
        worst.append(judged.rmse[judged.worst_joint])
        ratio.append(judged.nees_mean / judged.nees_mean_dof)
        took.append(np.median(found.seconds))
        strayed = np.abs(found.q[-1] - motion.truth[-1]).max() > np.radians(15.0)
        lost += bool(strayed or (found.status == "lost").any())
    return TrackFigures(float(np.median(worst)), float(np.median(ratio)), 1000.0 * float(np.median(took)), lost)


def single_frames(motions: Sequence[Motion], settings: Settings) -> EdgeFigures:
    """Look at every tenth frame of each motion from a pose that is off by a degree, and hold the edges against truth.

    The appearance is learnt at the true pose, so that the edges alone are judged.
    """
    looks = []
    for number, motion in enumerate(motions):
        on, rng = chain(motion.model, motion.camera), np.random.default_rng(number)
        known: Appearance | None = None
        for frame in range(0, len(motion.images), _EVERY):
            true = motion.truth[frame][motion.model.free]
            image, pills = motion.images[frame], posed(on, true)
            known = learn(image, pills, motion.camera, known)
            off = true + _SIGMA * rng.standard_normal(true.size)
            looks.append(_errors(image, on, off, known, settings, pills))
    columns = zip(*((seen.error, seen.sigma, seen.found, seen.visible) for seen in looks), strict=True)
    return _figures(_Errors(*(np.concatenate(parts) for parts in columns)))


def _figures(all_: _Errors) -> EdgeFigures:
    right = all_.found & all_.visible & (np.abs(all_.error) <= FALSE)
    error = all_.error[right]
    if not error.size:
        return EdgeFigures(np.nan, np.nan, np.nan, 0.0, 1.0 if all_.found.any() else 0.0)
    return EdgeFigures(
        bias=float(error.mean()),
        scatter=float(error.std()),
        normalised=float(np.sqrt(np.mean((error / all_.sigma[right]) ** 2))),
        found=float(right.sum() / max(int(all_.visible.sum()), 1)),
        false=float(1.0 - right.sum() / all_.found.sum()),
    )


def _errors(
    image: Float[np.ndarray, "h w"],
    on: Chain,
    u: Float[np.ndarray, " k"],
    known: Appearance,
    settings: Settings,
    true: Pills,
) -> _Errors:
    """One look, its side edges beside the true ones."""
    covariance = _SIGMA**2 * np.eye(u.size)
    valley = settings.edges == "wssd" and settings.residuals == "lines"
    if settings.edges == "wssd" and not valley:
        seen = look(image, on, u, covariance, known, settings)
    else:
        seen = look_lines(image, on, u, covariance, known, settings)
    samplers, edges = seen.samplers, seen.edges
    sides = samplers.kind != CAP
    origin, direction, link = samplers.origin[sides], samplers.direction[sides], samplers.link[sides]
    offset, sigma, found = edges.offset[sides], edges.sigma[sides], seen.found[sides]
    if valley:  # one shift for both edges of a profile
        edge = np.nan_to_num(silhouette_edges(seen.pills, on.camera, samplers))
        outward = np.array([-1.0, 1.0])
        origin = (origin[:, None] + edge[..., None] * direction[:, None]).reshape(-1, 2)
        direction = (outward[:, None] * direction[:, None]).reshape(-1, 2)
        offset, link = (outward * offset[:, None]).ravel(), np.repeat(link, 2)
        sigma, found = np.repeat(sigma, 2), np.repeat(found, 2)
    place, visible = true_edges(true, on.model.link_finger, on.camera, origin, direction, link)
    return _Errors(offset - place, sigma, found, visible)


def true_edges(
    pills: Pills,
    finger: Int[np.ndarray, " l"],
    camera: Camera,
    origin: Float[np.ndarray, "n 2"],
    direction: Float[np.ndarray, "n 2"],
    link: Int[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Where along outward paths the rays cease to hit the link's pill, pixels, and whether that edge is to be seen.

    It is where just inside the own finger is in front, and just outside the background or a finger behind it. NaN (and
    not visible) where no ray within 30 pixels hits the link.
    """
    place = np.full(link.size, np.nan)
    for one in np.unique(link):
        mine = link == one
        alone = Pills(pills.base[[one]], pills.tip[[one]], pills.radius[[one]])
        place[mine] = _leaving(alone, camera, origin[mine], direction[mine])
    at = np.nan_to_num(place)[:, None] + np.array([-_BESIDE, _BESIDE])
    xy = origin[:, None] + at[..., None] * direction[:, None]
    seen = ray_hits(pills, *rays(camera, xy.reshape(-1, 2)))
    group = np.where(seen.pill >= 0, finger[seen.pill], -1).reshape(-1, 2)
    depth = seen.t.reshape(-1, 2)
    behind = (group[:, 1] < 0) | ((group[:, 1] != finger[link]) & (depth[:, 1] > depth[:, 0]))
    return place, np.isfinite(place) & (group[:, 0] == finger[link]) & behind


def _leaving(
    pill: Pills, camera: Camera, origin: Float[np.ndarray, "n 2"], direction: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Where the last ray along each path hits a single pill: by steps of a pixel, then by halving."""

    def hit(u: Float[np.ndarray, "n k"]) -> Bool[np.ndarray, "n k"]:
        xy = origin[:, None] + u[..., None] * direction[:, None]
        return (ray_hits(pill, *rays(camera, xy.reshape(-1, 2))).pill >= 0).reshape(u.shape)

    steps = np.arange(-_FAR, _FAR + 1.0)
    whole = hit(np.tile(steps, (origin.shape[0], 1)))
    last = steps.size - 1 - np.argmax(whole[:, ::-1], axis=1)
    low = steps[last]
    high = low + 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        still = hit(middle[:, None])[:, 0]
        low, high = np.where(still, middle, low), np.where(still, high, middle)
    return np.where(whole.any(axis=1) & ~whole[:, -1], 0.5 * (low + high), np.nan)
