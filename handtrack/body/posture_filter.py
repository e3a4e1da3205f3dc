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
from jaxtyping import Float

from .. import _kernels
from .particles import effective_size, normalised, resampled
from .posture import ROOT, Body, chain_frames
from .posture_tree import PART_SEGMENTS, PARTS, Chain
from .walk_moment import Moment
from .walk_settings import Settings

EACH = 4  # angles of a part; they and the segments stand in the order of the parts
FIRST = np.cumsum([0] + [len(segments) for segments in PART_SEGMENTS[:-1]])  # first segment of each part
ROOTS = np.repeat([segments[0] for segments in PART_SEGMENTS], [len(segments) for segments in PART_SEGMENTS])
ITERATIONS = 2  # of the fit that the proposal is linearised at; it begins near
DELTA = 1e-4  # radians, of its central differences
DAMPING = 1e-6  # share of the largest curvature: angles that nothing tells of stay where they are
SHORTEST = 1e-3  # seconds: two moments may lie as near together as one likes
SIDES = DELTA * np.tile(np.vstack([np.zeros((1, EACH)), np.eye(EACH), -np.eye(EACH)]), len(PARTS))  # all parts at once


@dataclass(frozen=True, slots=True, eq=False)
class Postures:
    """Particles of all parts.

    Attributes
    ----------
    chain : Chain
        All segments but the pelvis, each part hanging from a root of its own.
    theta : (m, 20)
        Angles; the columns of different parts have nothing to do with one another. NaN before the first moment.
    weight : (m, 5)
        Of each of `posture_tree.PARTS`; each column sums to one.
    """

    chain: Chain
    theta: Float[np.ndarray, "m 20"]
    weight: Float[np.ndarray, "m 5"]

    @property
    def known(self) -> bool:
        """Whether a sample of the suit was taken in."""
        return not bool(np.isnan(self.theta[0, 0]))


def begin(body: Body, settings: Settings) -> Postures:
    """Particles that know nothing yet."""
    m = settings.part_particles
    return Postures(parted(body), np.full((m, EACH * len(PARTS)), np.nan), np.full((m, len(PARTS)), 1.0 / m))


def parted(body: Body) -> Chain:
    """The chains of the five parts as one, so that all are posed in one call."""
    parts = body.parts
    joints = np.cumsum([0] + [chain.axis.size for chain in parts])
    return Chain(
        parent=np.concatenate([np.where(c.parent < 0, -1, c.parent + at) for c, at in zip(parts, FIRST, strict=True)]),
        offset=np.concatenate([chain.offset for chain in parts]),
        first=np.concatenate([*(c.first[:-1] + at for c, at in zip(parts, joints[:-1], strict=True)), joints[-1:]]),
        axis=np.concatenate([chain.axis for chain in parts]),
        sign=np.concatenate([chain.sign for chain in parts]),
    )


def relative_frames(
    body: Body, p: Float[np.ndarray, "13 3"], R: Float[np.ndarray, "13 3 3"]
) -> Float[np.ndarray, "12 4 4"]:
    """Frames of the segments relative to the roots of their parts, as a suit has them.

    Parameters
    ----------
    p, R : (13, 3), (13, 3, 3)
        Origins and orientations of all segments in the suit's frame.

    Returns
    -------
    frames : (12, 4, 4)
        Of `formats.walks.SEGMENTS` but the pelvis. A root lies in the part's first joint and has the axes of the
        segment that carries the part.

    >>> from .posture import body_of, segment_frames
    >>> body = body_of(1.8)
    >>> T = segment_frames(body, np.zeros((1, 26)))[0]
    >>> relative_frames(body, T[:, :3, 3], T[:, :3, :3])[3, :3, 3].round(3).tolist()  # left forearm
    [0.0, 0.335, 0.0]
    """
    axes = np.swapaxes(R[body.whole.parent[ROOTS]], 1, 2)
    out = np.zeros((ROOTS.size, 4, 4))
    out[:, :3, :3], out[:, 3, 3] = axes @ R[1:], 1.0
    out[:, :3, 3] = (axes @ (p[1:] - p[ROOTS])[:, :, None])[..., 0]
    return out


def features(body: Body, frames: Float[np.ndarray, "n 12 4 4"], settings: Settings) -> Float[np.ndarray, "n 12 12"]:
    """What is compared of each segment, in standard deviations: its far end, where the next one begins, and its axes.

    The sum of squared differences of two rotations' nine numbers is 4 (1 - cos a), about 2 a^2 for an angle a.
    """
    R = frames[..., :3, :3]
    out = np.empty((*frames.shape[:2], 12))
    place, turn = _weights(settings)
    out[..., :3] = (frames[..., :3, 3] + (R @ body.end[1:, :, None])[..., 0]) * place
    out[..., 3:].reshape(R.shape)[...] = R * turn
    return out


def _weights(settings: Settings) -> tuple[float, float]:
    """What a metre, and a unit of an axis, count in `features`."""
    return 1.0 / settings.segment_noise, float(1.0 / (np.sqrt(2.0) * np.radians(settings.segment_turn_noise)))


def measured(body: Body, moment: Moment, settings: Settings) -> Float[np.ndarray, "12 12"]:
    """What the suit tells, as `features` has it."""
    return features(body, relative_frames(body, moment.p, moment.R)[None], settings)[0]


def expected(
    state: Postures, body: Body, theta: Float[np.ndarray, "n 20"], settings: Settings
) -> Float[np.ndarray, "n 12 12"]:
    """What the suit should tell of postures, as `features` has it."""
    return features(body, chain_frames(state.chain, theta), settings)


def log_likelihood(
    state: Postures, body: Body, theta: Float[np.ndarray, "n 20"], z: Float[np.ndarray, "12 12"], settings: Settings
) -> Float[np.ndarray, "n 5"]:
    """ln p(z | theta) of the parts' particles but for a constant; `z` as `features` has it."""
    return -0.5 * _by_part(misfits(body, chain_frames(state.chain, theta), z, settings), axis=1)


def misfits(
    body: Body, frames: Float[np.ndarray, "n 12 4 4"], z: Float[np.ndarray, "12 12"], settings: Settings
) -> Float[np.ndarray, "n 12"]:
    """Squared differences of segments from what is measured of them, in standard deviations."""
    out = np.empty(frames.shape[:2])
    _kernels.segment_misfits(frames, np.ascontiguousarray(body.end[1:]), z, *_weights(settings), out)
    return out


def misfits_numpy(
    body: Body, frames: Float[np.ndarray, "n 12 4 4"], z: Float[np.ndarray, "12 12"], settings: Settings
) -> Float[np.ndarray, "n 12"]:
    """The same in plain NumPy."""
    apart = features(body, frames, settings) - z
    return np.einsum("nsd,nsd->ns", apart, apart)


def fitted(
    state: Postures, body: Body, z: Float[np.ndarray, "12 12"], theta: Float[np.ndarray, " 20"], settings: Settings
) -> tuple[Float[np.ndarray, "5 4"], Float[np.ndarray, "5 4 4"]]:
    """Angles that suit the segments best, and how precisely they tell them: Gauss and Newton from a first guess.

    Returns
    -------
    theta : (5, 4)
        Inside the limits.
    precision : (5, 4, 4)
        `J^T J`, the inverse of their covariance.
    """
    precision = np.zeros((len(PARTS), EACH, EACH))
    for _ in range(ITERATIONS):
        y = expected(state, body, theta + SIDES, settings)
        J = (y[1 : 1 + EACH] - y[1 + EACH :]) / (2.0 * DELTA)  # (4, 12, 12): of each segment by its part's angles
        precision = _by_part(np.einsum("asd,bsd->sab", J, J), axis=0)
        pull = _by_part(np.einsum("asd,sd->sa", J, z - y[0]), axis=0)
        damped = precision + DAMPING * precision.max(axis=(1, 2), keepdims=True) * np.eye(EACH)
        theta = theta + np.linalg.solve(damped, pull[..., None]).reshape(-1)
        theta = np.clip(theta, body.limits[:, 0], body.limits[:, 1])
    return theta.reshape(-1, EACH), precision


def step(state: Postures, body: Body, moment: Moment, settings: Settings, rng: np.random.Generator) -> Postures:
    """The particles after one more sample of the suit."""
    m = state.theta.shape[0]
    z = measured(body, moment, settings)
    mode, precision = fitted(state, body, z, moment.q[ROOT:], settings)
    spread = np.radians(settings.posture_noise) ** 2 * max(moment.dt, SHORTEST)
    prior = 1.0 / spread if state.known else DAMPING * float(precision.max())
    before = state.theta.reshape(m, len(PARTS), EACH) if state.known else mode[None]
    root = np.linalg.inv(np.linalg.cholesky(precision + prior * np.eye(EACH)))  # root^T root is the covariance
    pull = (precision @ mode[..., None])[..., 0] + prior * before
    chance = rng.standard_normal((m, len(PARTS), EACH))
    drawn = _times(np.swapaxes(root, 1, 2), _times(root, pull) + chance)
    # a sample beyond a joint's limit stays at it
    theta = np.clip(drawn.reshape(m, -1), body.limits[:, 0], body.limits[:, 1])
    log_weight = np.log(np.maximum(state.weight, 1e-300)) + log_likelihood(state, body, theta, z, settings)
    log_weight += 0.5 * (chance**2).sum(axis=2)
    if state.known:
        log_weight -= 0.5 * prior * ((theta - state.theta) ** 2).reshape(m, len(PARTS), EACH).sum(axis=2)
    return _renewed(state, theta, log_weight, settings, rng)


def whole_postures(state: Postures, count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 20"]:
    """Whole postures from the product of the parts (2): each part's own particles by their weights, in shuffled order.

    Without shuffling, the systematic draw would pair first particles with first ones again and again.
    """
    out = np.empty((count, state.theta.shape[1]))
    for part, joints in enumerate(_joints()):
        at = resampled(rng, state.weight[:, part], count=count)
        out[:, joints] = state.theta[rng.permutation(at), joints]
    return out


def mean_posture(state: Postures) -> tuple[Float[np.ndarray, " 20"], Float[np.ndarray, " 20"]]:
    """Weighted mean and standard deviation of every angle; none reaches round the circle."""
    weight = np.repeat(state.weight, EACH, axis=1)
    mean = (weight * state.theta).sum(axis=0)
    return mean, np.sqrt((weight * (state.theta - mean) ** 2).sum(axis=0))


def _renewed(
    state: Postures,
    theta: Float[np.ndarray, "m 20"],
    log_weight: Float[np.ndarray, "m 5"],
    settings: Settings,
    rng: np.random.Generator,
) -> Postures:
    """Particles with new weights, drawn anew in the parts where too few of them count."""
    weight = np.empty_like(log_weight)
    for part, joints in enumerate(_joints()):
        weight[:, part] = normalised(log_weight[:, part])
        if effective_size(weight[:, part]) < settings.resample * theta.shape[0]:
            theta[:, joints] = theta[resampled(rng, weight[:, part]), joints]
            weight[:, part] = 1.0 / theta.shape[0]
    return replace(state, theta=theta, weight=weight)


def _joints() -> list[slice]:
    """Columns of each part's angles."""
    return [slice(EACH * part, EACH * (part + 1)) for part in range(len(PARTS))]


def _by_part(of_segments: Float[np.ndarray, "..."], axis: int) -> Float[np.ndarray, "..."]:
    """Sums over the segments of each part."""
    return np.add.reduceat(of_segments, FIRST, axis=axis)


def _times(A: Float[np.ndarray, "5 4 4"], v: Float[np.ndarray, "n 5 4"]) -> Float[np.ndarray, "n 5 4"]:
    """Each part's matrix times its vectors, for all particles."""
    return np.swapaxes(np.swapaxes(v, 0, 1) @ np.swapaxes(A, 1, 2), 0, 1)
