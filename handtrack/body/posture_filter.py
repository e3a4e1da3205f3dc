"""Segments of a suit in, particles of five body parts' joint angles out: the walk paper's Multiple Posture Filter.

Trunk with head, arms and legs are filtered one by one (walk paper, section III-C), each with particles of its own four
angles, which follow a walk at random. What is seen of a part are the places of its segments' origins and ends relative
to its root, and their orientations, with normal noise:

    theta_k ~ N(theta_{k-1}, Sigma dt),    z_k ~ N(h(theta_k), Sigma_x).

Four angles that may turn by 20 degrees from one frame to the next, and are seen to two, leave next to nothing of a few
hundred particles that are drawn blindly. So they are drawn from the normal distribution that transition and linearised
observation have together (Doucet, Godsill & Andrieu 2000, "On sequential Monte Carlo sampling methods", section II-D),
and weighted by what that leaves out,

    w_k = w_{k-1} p(z_k | theta_k) p(theta_k | theta_{k-1}) / g(theta_k | theta_{k-1}, z_k).

The belief over the whole posture is the product over the parts (2): `whole_postures` draws from it with the particles
of the parts themselves, put together in shuffled order.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_triangular

from .particles import effective_size, normalised, resampled
from .posture import PART_JOINTS, Body, part_frames
from .posture_tree import PART_SEGMENTS, PARTS
from .walk_settings import Settings

ITERATIONS = 3  # of the fit that the proposal is linearised at
DELTA = 1e-4  # radians, of its central differences
DAMPING = 1e-6  # share of the largest curvature: angles that nothing tells of stay where they are
SHORTEST = 1e-3  # seconds: two moments may lie as near together as one likes
SIDES = DELTA * np.vstack([np.zeros((1, 4)), np.eye(4), -np.eye(4)])


@dataclass(frozen=True, slots=True, eq=False)
class Postures:
    """Particles of all parts.

    Attributes
    ----------
    theta : (5, m, 4)
        Angles of each of `posture_tree.PARTS`, radians; NaN before the first moment.
    weight : (5, m)
        Each row sums to one.
    """

    theta: Float[np.ndarray, "5 m 4"]
    weight: Float[np.ndarray, "5 m"]


def begin(settings: Settings) -> Postures:
    """Particles that know nothing yet."""
    m = settings.part_particles
    return Postures(np.full((len(PARTS), m, 4), np.nan), np.full((len(PARTS), m), 1.0 / m))


def part_measurement(
    body: Body, part: int, p: Float[np.ndarray, "13 3"], R: Float[np.ndarray, "13 3 3"]
) -> Float[np.ndarray, "s 4 4"]:
    """Frames of a part's segments relative to its root, as the suit has them.

    Parameters
    ----------
    p, R : (13, 3), (13, 3, 3)
        Origins and orientations of all segments in the suit's frame.

    >>> from .posture import body_of, segment_frames
    >>> body = body_of(1.8)
    >>> T = segment_frames(body, np.zeros((1, 26)))[0]
    >>> part_measurement(body, 1, T[:, :3, 3], T[:, :3, :3])[1, :3, 3].round(3).tolist()
    [0.0, 0.335, 0.0]
    """
    at = np.array(PART_SEGMENTS[part])
    axes = R[body.whole.parent[at[0]]].T
    out = np.zeros((at.size, 4, 4))
    out[:, :3, :3], out[:, 3, 3] = axes @ R[at], 1.0
    out[:, :3, 3] = (p[at] - p[at[0]]) @ axes.T
    return out


def features(
    body: Body, part: int, frames: Float[np.ndarray, "n s 4 4"], settings: Settings
) -> Float[np.ndarray, "n d"]:
    """What is compared of a part, in standard deviations: origins, ends and axes of its segments.

    The sum of squared differences of two rotations' nine numbers is 4 (1 - cos a), about 2 a^2 for an angle a.
    """
    n, s = frames.shape[:2]
    R, origin = frames[:, :, :3, :3], frames[:, :, :3, 3]
    end = origin + (R @ body.end[list(PART_SEGMENTS[part])][:, :, None])[..., 0]
    out = np.empty((n, s, 15))
    out[..., :3], out[..., 3:6] = origin / settings.segment_noise, end / settings.segment_noise
    out[..., 6:] = R.reshape(n, s, 9) / (np.sqrt(2.0) * np.radians(settings.segment_turn_noise))
    return out.reshape(n, s * 15)


def fitted(
    body: Body, part: int, z: Float[np.ndarray, " d"], theta: Float[np.ndarray, " 4"], settings: Settings
) -> tuple[Float[np.ndarray, " 4"], Float[np.ndarray, "4 4"]]:
    """Angles that suit the segments best, and how precisely they tell them: Gauss and Newton from a first guess.

    Returns
    -------
    theta : (4,)
        Inside the limits.
    precision : (4, 4)
        `J^T J`, the inverse of their covariance.
    """
    limits = body.limits[PART_JOINTS[part]]
    precision = np.zeros((4, 4))
    for _ in range(ITERATIONS):
        y = features(body, part, part_frames(body, part, theta + SIDES), settings)
        J = (y[1:5] - y[5:]) / (2.0 * DELTA)
        precision = J @ J.T
        damped = precision + DAMPING * precision.max() * np.eye(4)
        theta = np.clip(theta + np.linalg.solve(damped, J @ (z - y[0])), *limits.T)
    return theta, precision


def log_likelihood(
    body: Body, part: int, theta: Float[np.ndarray, "n 4"], z: Float[np.ndarray, " d"], settings: Settings
) -> Float[np.ndarray, " n"]:
    """ln p(z | theta) of a part's particles but for a constant; `z` as `features` has it."""
    apart = features(body, part, part_frames(body, part, theta), settings) - z
    return -0.5 * np.einsum("nd,nd->n", apart, apart)


def measured(body: Body, p: Float[np.ndarray, "13 3"], R: Float[np.ndarray, "13 3 3"], settings: Settings) -> list:
    """What the suit tells of each part, as `features` has it."""
    parts = range(len(PARTS))
    return [features(body, part, part_measurement(body, part, p, R)[None], settings)[0] for part in parts]


def step(
    state: Postures,
    body: Body,
    p: Float[np.ndarray, "13 3"],
    R: Float[np.ndarray, "13 3 3"],
    guess: Float[np.ndarray, " 20"],
    dt: float,
    settings: Settings,
    rng: np.random.Generator,
) -> Postures:
    """The particles after one more sample of the suit.

    Parameters
    ----------
    p, R : (13, 3), (13, 3, 3)
        Segments in the suit's frame.
    guess : (20,)
        Posture to begin the fit at, radians; see `posture.pose_from_segments`.
    dt : float
        Seconds since the last sample.
    """
    theta, weight = np.empty_like(state.theta), np.empty_like(state.weight)
    for part, z in enumerate(measured(body, p, R, settings)):
        mode, precision = fitted(body, part, z, guess[PART_JOINTS[part]], settings)
        before = state.theta[part]
        known = not np.isnan(before[0, 0])
        spread = np.radians(settings.posture_noise) ** 2 * max(dt, SHORTEST)
        prior = 1.0 / spread if known else DAMPING * float(precision.max())
        root = np.linalg.cholesky(precision + prior * np.eye(4))
        chance = rng.standard_normal(before.shape)
        pull = precision @ mode + prior * (before if known else mode)
        mean = solve_triangular(root.T, solve_triangular(root, pull.T.reshape(4, -1), lower=True)).T
        # a sample beyond a joint's limit stays at it
        drawn = np.clip(mean + solve_triangular(root.T, chance.T).T, *body.limits[PART_JOINTS[part]].T)
        log_weight = np.log(np.maximum(state.weight[part], 1e-300)) + log_likelihood(body, part, drawn, z, settings)
        log_weight += 0.5 * np.einsum("nd,nd->n", chance, chance)
        if known:
            log_weight -= 0.5 * prior * np.einsum("nd,nd->n", drawn - before, drawn - before)
        theta[part], weight[part] = _renewed(drawn, normalised(log_weight), settings, rng)
    return replace(state, theta=theta, weight=weight)


def whole_postures(state: Postures, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 20"]:
    """Whole postures from the product of the parts (2): each part's own particles by their weights, in shuffled order.

    Without shuffling, the systematic draw would pair first particles with first ones again and again.
    """
    out = np.empty((count, PART_JOINTS.size))
    for part, joints in enumerate(PART_JOINTS):
        chosen = resampled(rng, state.weight[part], count=count)
        out[:, joints] = state.theta[part][rng.permutation(chosen)]
    return out


def mean_posture(state: Postures) -> tuple[Float[np.ndarray, " 20"], Float[np.ndarray, " 20"]]:
    """Weighted mean and standard deviation of every angle; no angle reaches round the circle."""
    mean, sigma = np.empty(PART_JOINTS.size), np.empty(PART_JOINTS.size)
    for part, joints in enumerate(PART_JOINTS):
        mean[joints] = state.weight[part] @ state.theta[part]
        sigma[joints] = np.sqrt(state.weight[part] @ (state.theta[part] - mean[joints]) ** 2)
    return mean, sigma


def _renewed(
    theta: Float[np.ndarray, "m 4"], weight: Float[np.ndarray, " m"], settings: Settings, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "m 4"], Float[np.ndarray, " m"]]:
    """Particles drawn anew where too few of them count."""
    if effective_size(weight) >= settings.resample * weight.size:
        return theta, weight
    return theta[resampled(rng, weight)], np.full(weight.size, 1.0 / weight.size)


def known_yet(state: Postures) -> Bool[np.ndarray, ""] | bool:
    """Whether a sample of the suit was taken in."""
    return not bool(np.isnan(state.theta[0, 0, 0]))
