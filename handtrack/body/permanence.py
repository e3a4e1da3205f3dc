"""Measurements of keypoints in; where every keypoint is, seen or not, and how sure that is, out.

All keypoints of all people are one batch of clouds (q, 12, n, ...); the two modes differ in what a particle is.

`paper` (people paper, II-C): a particle is a place. While the measurement z is surer than T,

    w_i ~ exp(-|z - x_i|^2 / (2 sigma^2)),   R = alpha^(c - beta),   sigma = R or sqrt(R),

and the cloud is drawn anew; otherwise particles move along the line fitted to the last gamma places, bounded.

`robust`: a particle is a story of the keypoint, which says of every measurement so far whether it was right or an
outlier. Given the story, place and speed are normal, with a speed that decays to that of the whole person (an
Ornstein-Uhlenbeck process), and a Kalman filter has them exactly (Rao-Blackwellised: Doucet et al. 2000). A
measurement parts every story in two, and begins one in which all before was wrong; alike stories are merged and the
heaviest kept. Confidence and the length of the bone to the next joint say how likely a measurement is right.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .._kernels.people import hypotheses_step
from .people_settings import Settings
from .resting import PARENT
from .skeleton_graph import FILTERED

# Deviation of the speed (m/s), how long it lasts (s), widest deviation of a place (m), random walk (m^2/s).
_TRUNK, _JOINT, _END = (0.30, 0.5, 0.25, 1e-5), (0.42, 0.4, 0.22, 2e-5), (0.60, 0.3, 0.25, 3e-5)
MOTION = np.array([_TRUNK, _TRUNK, _JOINT, _JOINT, _END, _END, _TRUNK, _TRUNK, _JOINT, _JOINT, _END, _END])
# Logarithms: of the odds that an outlier follows another, of outliers' density (1/m^3), of a new beginning's odds.
# Metres within which stories are alike; most that a bone of the wrong length counts; how likely an outlier stays;
# seconds after which a hidden joint is thought to be where it mostly is; logarithm of the odds that begin a person.
STAY, CLUTTER, AGAIN, NEAR, LEAST, SAME, REST, UNSURE = 0.5, 0.0, -5.0, 0.015, 8.0, 0.8, 1.5, -2.0
RULES = np.array([STAY, CLUTTER, AGAIN, NEAR, LEAST, SAME, REST, UNSURE])
SLACK = 0.04  # metres by which a bone's measured length changes with the posture
SLOPE, MIDDLE = 14.0, 0.40  # of the odds that a measurement is right, over its confidence
NOISE_ACROSS, NOISE_ALONG = 0.042, 0.07  # metres at confidence 0.65; errors that last want more than jitter alone
BASE = 0.004  # metres at 1 m: deviation of a depth camera's reading, which grows with the square
SYSTEMATIC = 0.02**2 * np.eye(3)  # of a joint's place in the network's idea
FASTEST = 2.0  # m/s, of the paper's line
WALK = 0.03  # metres: deviation of the paper's random step in a thirtieth of a second


@dataclass(frozen=True, slots=True, eq=False)
class Stories:
    """Stories of q people's keypoints.

    Attributes
    ----------
    x, v : (q, 12, n, 3)
        Metres, m/s, camera axes.
    c : (q, 12, n, 2, 3)
        Variances of place, of both, of speed; across the view, and along it.
    weight : (q, 12, n)
        Sum to one, or all 0 for a keypoint that was never seen.
    outlier : (q, 12, n)
        1 where the last measurement was an outlier.
    last : (q, 12, 3)
        That measurement, metres; NaN if there was none.
    """

    x: Float[np.ndarray, "q 12 n 3"]
    v: Float[np.ndarray, "q 12 n 3"]
    c: Float[np.ndarray, "q 12 n 2 3"]
    weight: Float[np.ndarray, "q 12 n"]
    outlier: Float[np.ndarray, "q 12 n"]
    last: Float[np.ndarray, "q 12 3"]


@dataclass(frozen=True, slots=True, eq=False)
class Particles:
    """The paper's clouds, and the last places of each keypoint.

    Attributes
    ----------
    x : (q, 12, n, 3)
        Metres; NaN for a keypoint that was never seen.
    past : (q, 12, gamma, 3)
        Estimates of seen frames, the newest last; NaN where there are fewer.
    when : (q, 12, gamma)
        Seconds.
    """

    x: Float[np.ndarray, "q 12 n 3"]
    past: Float[np.ndarray, "q 12 gamma 3"]
    when: Float[np.ndarray, "q 12 gamma"]


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Place (q, 12, 3), covariance (q, 12, 3, 3), and how much the measurement is believed, 0..1 (q, 12)."""

    p: Float[np.ndarray, "q 12 3"]
    covariance: Float[np.ndarray, "q 12 3 3"]
    believed: Float[np.ndarray, "q 12"]


def no_stories(q: int, n: int) -> Stories:
    """Stories of q people of whom nothing was seen yet."""
    k = FILTERED
    return Stories(
        np.zeros((q, k, n, 3)), np.zeros((q, k, n, 3)), np.zeros((q, k, n, 2, 3)), np.zeros((q, k, n)),
        np.zeros((q, k, n)), np.full((q, k, 3), np.nan),
    )  # fmt: skip


def no_particles(q: int, n: int, history: int) -> Particles:
    """Clouds of q people of whom nothing was seen yet."""
    k = FILTERED
    return Particles(
        np.full((q, k, n, 3), np.nan), np.full((q, k, history, 3), np.nan), np.full((q, k, history), np.nan)
    )


def _before(
    stories: Stories, k: int, moved: Float[np.ndarray, "q 3"]
) -> tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, "q 3 3"]]:
    """Where a keypoint was, moved on; NaN where it was never seen; and a variance for each axis."""
    w, x = stories.weight[:, k, :, None], stories.x[:, k]
    middle = (w * x).sum(axis=1)
    variance = (w * (stories.c[:, k, :, [0, 0, 1], 0].transpose(1, 2, 0) + (x - middle[:, None]) ** 2)).sum(axis=1)
    known = w.sum(axis=1) > 0
    return np.where(known, middle + moved, np.nan), variance[:, :, None] * np.eye(3)


def _arrays(stories: Stories) -> tuple[np.ndarray, ...]:
    return stories.x, stories.v, stories.c, stories.weight, stories.outlier, stories.last


def paper_noise(confidence: Float[np.ndarray, "*b"], settings: Settings) -> Float[np.ndarray, "*b"]:
    """Standard deviation of a measurement, metres: R = alpha^(c - beta), or its root (people paper, eq. (6)).

    >>> paper_noise(np.array([0.2, 0.7]), Settings()).round(3).tolist()
    [1.0, 0.1]
    """
    r = settings.alpha ** (confidence - settings.beta)
    return r if settings.noise == "sd" else np.sqrt(r)


def robust_step(
    stories: Stories,
    z: Float[np.ndarray, "q 12 3"],
    confidence: Float[np.ndarray, "q 12"],
    dt: float,
    drift: Float[np.ndarray, "q 3"],
    length: Float[np.ndarray, "q 12"],
    rest: Float[np.ndarray, "q 12 3"],
) -> tuple[Stories, Estimate]:
    """One frame of all stories.

    Parameters
    ----------
    z : (q, 12, 3)
        Metres; NaN where unseen.
    confidence : (q, 12)
    dt : float
        Seconds since the last frame.
    drift : (q, 3)
        Speed of each whole person, m/s.
    length : (q, 12)
        Length of the bone to the joint before, metres; NaN where unknown.
    rest : (q, 12, 3)
        From the joint before to where the keypoint mostly is, metres.

    >>> z = np.full((1, 12, 3), np.nan)
    >>> z[0, 4] = 0.0, 0.0, 2.0
    >>> length = np.full((1, 12), 0.3)
    >>> still, rest = np.zeros((1, 3)), np.zeros((1, 12, 3))
    >>> _, found = robust_step(no_stories(1, 4), z, np.full((1, 12), 0.7), 0.03, still, length, rest)
    >>> found.p[0, 4].tolist(), bool(np.isnan(found.p[0, 5]).all())
    ([0.0, 0.0, 2.0], True)
    """
    q = z.shape[0]
    new = Stories(*(array.copy() for array in _arrays(stories)))
    mean, spread, right = np.full((q, FILTERED, 3), np.nan), np.zeros((q, FILTERED, 3, 3)), np.zeros((q, FILTERED))
    mean[:, 1], spread[:, 1] = _before(stories, 1, drift * dt)
    rough = np.exp(3.0 * (0.65 - confidence))
    r = np.empty((q, FILTERED, 2))
    r[..., 0] = (NOISE_ACROSS * rough) ** 2
    r[..., 1] = (NOISE_ALONG * rough) ** 2 + (BASE * z[..., 2] ** 2) ** 2
    hypotheses_step(
        new.x, new.v, new.c, new.weight, new.outlier, new.last, z, SLOPE * (confidence - MIDDLE), r, dt, drift, MOTION,
        PARENT, length, rest, SLACK, RULES, mean, spread, right,
    )  # fmt: skip
    spread = np.where(np.isnan(mean)[..., None], np.nan, spread + SYSTEMATIC)
    return new, Estimate(mean, spread, right)


def paper_step(
    clouds: Particles,
    z: Float[np.ndarray, "q 12 3"],
    confidence: Float[np.ndarray, "q 12"],
    time: float,
    dt: float,
    hidden: Float[np.ndarray, "q 12"],
    settings: Settings,
    rng: np.random.Generator,
) -> tuple[Particles, Estimate]:
    """One frame of the paper's filter.

    Parameters
    ----------
    z, confidence : (q, 12, 3), (q, 12)
        As for `robust_step`; the confidence with rewards and penalties.
    hidden : (q, 12)
        Seconds for which each keypoint has been predicted; a line ends after gamma frames of that.
    """
    used = ~np.isnan(z[..., 0]) & (confidence > settings.threshold)
    sigma = paper_noise(confidence, settings)
    noise = rng.standard_normal(clouds.x.shape)
    fresh = used & np.isnan(clouds.x[..., 0, 0])
    start = np.where(used[..., None], z, 0.0)[:, :, None] + np.minimum(sigma, 0.1)[..., None, None] * noise
    line = np.where((hidden <= settings.history * dt)[..., None], slopes(clouds), 0.0)
    moved = clouds.x + np.where(used[..., None], 0.0, line * dt)[:, :, None] + WALK * math.sqrt(30.0 * dt) * noise
    x = np.where(fresh[..., None, None], start, moved)
    off = x - np.where(used[..., None], z, np.nan_to_num(x[:, :, 0]))[:, :, None]
    square = (off * off).sum(axis=-1) / (sigma * sigma)[..., None]
    square = np.where(used[..., None], square - square.min(axis=-1, keepdims=True), 0.0)
    weight = np.exp(-0.5 * square)
    weight /= weight.sum(axis=-1, keepdims=True)
    mean = (weight[..., None] * x).sum(axis=2)
    apart = x - mean[:, :, None]
    covariance = np.einsum("qkn,qkni,qknj->qkij", weight, apart, apart)
    x = np.take_along_axis(x, drawn_anew(rng, weight)[..., None], axis=2)
    past, when = clouds.past.copy(), clouds.when.copy()
    past[used] = np.concatenate([past[used][:, 1:], mean[used][:, None]], axis=1)
    when[used] = np.concatenate([when[used][:, 1:], np.full((np.count_nonzero(used), 1), time)], axis=1)
    return Particles(x, past, when), Estimate(mean, covariance, used.astype(float))


def drawn_anew(rng: np.random.Generator, weight: Float[np.ndarray, "q k n"]) -> Int[np.ndarray, "q k n"]:
    """Systematic resampling of all clouds at once: see `particles.resampled`."""
    q, k, n = weight.shape
    rows = np.arange(q * k)[:, None]
    total = np.cumsum(weight.reshape(-1, n), axis=1)
    total = total / total[:, -1:] + rows
    at = rows + (np.arange(n) + rng.random((q * k, 1))) / n
    found = np.searchsorted(total.ravel(), at.ravel(), side="right").reshape(-1, n) - n * rows
    return np.clip(found, 0, n - 1).reshape(q, k, n)


def slopes(clouds: Particles) -> Float[np.ndarray, "q 12 3"]:
    """Speed of the line that fits each keypoint's last places best, m/s, at most 2; 0 with fewer than two of them."""
    known = ~np.isnan(clouds.when)
    count = np.maximum(known.sum(axis=-1), 1)
    t = np.where(known, clouds.when, 0.0)
    t = np.where(known, t - (t.sum(axis=-1) / count)[..., None], 0.0)
    p = np.where(known[..., None], clouds.past, 0.0)
    square = (t * t).sum(axis=-1)
    speed = np.einsum("qkg,qkgi->qki", t, p) / np.where(square > 0, square, 1.0)[..., None]
    fast = np.sqrt((speed * speed).sum(axis=-1, keepdims=True))
    return speed * np.minimum(1.0, FASTEST / np.maximum(fast, 1e-9))


def seen_now(estimate: Estimate) -> Bool[np.ndarray, "q 12"]:
    """Where the measurement is rather believed than not."""
    return estimate.believed > 0.5
