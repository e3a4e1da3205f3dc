"""Particles of where a body is in, its keypoints in the world and what is said of it out.

A particle is a place e of the pelvis in the world and a turn D about fixed axes,

    D = Rot_z(h) Rot_y(b) Rot_x(a),    p_world = e + D B p_pelvis,

with the pelvis's orientation B as the suit has it: of it the drift is undone by the heading h, and by the tilts a and b
where they are wanted. Each particle also has the pace of its six numbers, of which only the mean is a particle's own
(Schoen, Gustafsson & Nordlund 2005, "Marginalized particle filters").

A mean of rotations is the rotation nearest to the mean of their matrices in the least squares (Moakher 2002, "Means and
averaging in the group of rotations"), its covariance that of the rotation vectors from there.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from .particles import effective_size, estimate, resampled
from .posture import ROOT, Body, keypoints

SIZE = 6  # x, y, z, a, b, h
HEADING = 5
SMALL = -0.9  # cosine of the largest turn whose axis is read from the matrix
SHRINK = 0.9  # of the particles toward their mean, where they are spread anew


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Weighted particles.

    Attributes
    ----------
    x : (n, 6)
        e, a, b and h of each; metres and radians.
    pace : (n, 6)
        Mean pace of these numbers given the particle's own way, per second.
    pace_variance : (6,)
        What is left to know of the paces, the same for all particles.
    weight : (n,)
        Sums to one.
    theta : (n, 20)
        Posture that each particle has just been given.
    """

    x: Float[np.ndarray, "n 6"]
    pace: Float[np.ndarray, "n 6"]
    pace_variance: Float[np.ndarray, " 6"]
    weight: Float[np.ndarray, " n"]
    theta: Float[np.ndarray, "n 20"]


def scattered(
    mean: Float[np.ndarray, " 6"],
    sigma: Float[np.ndarray, " 6"],
    pace_sigma: Float[np.ndarray, " 6"],
    theta: Float[np.ndarray, "n 20"],
    rng: np.random.Generator,
) -> Cloud:
    """Particles about a mean, one for each posture, with paces of mean zero."""
    n = theta.shape[0]
    x = mean + sigma * rng.standard_normal((n, SIZE))
    return Cloud(x, np.zeros((n, SIZE)), pace_sigma**2, np.full(n, 1.0 / max(n, 1)), theta)


def turns(x: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "n 3 3"]:
    """D of every particle.

    >>> (turns(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2]]))[0].round(6) + 0.0).tolist()
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    (ca, cb, ch), (sa, sb, sh) = np.cos(x[:, 3:]).T, np.sin(x[:, 3:]).T
    out = np.empty((x.shape[0], 3, 3))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = ch * cb, ch * sb * sa - sh * ca, ch * sb * ca + sh * sa
    out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = sh * cb, sh * sb * sa + ch * ca, sh * sb * ca - ch * sa
    out[:, 2, 0], out[:, 2, 1], out[:, 2, 2] = -sb, cb * sa, cb * ca
    return out


def world_points(cloud: Cloud, body: Body, base: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "n 16 3"]:
    """Keypoints of every particle in the world.

    Parameters
    ----------
    base : (3, 3)
        Orientation B of the pelvis.
    """
    q = np.zeros((cloud.theta.shape[0], ROOT + cloud.theta.shape[1]))
    q[:, ROOT:] = cloud.theta
    return keypoints(body, q) @ np.swapaxes(turns(cloud.x) @ base, 1, 2) + cloud.x[:, None, :3]


def walked(
    cloud: Cloud,
    way: Float[np.ndarray, "n 3"],
    dt: float,
    noise: Float[np.ndarray, " 6"],
    keep: float,
    usual: Float[np.ndarray, " 6"],
    rng: np.random.Generator,
) -> Cloud:
    """The particles a while later: along their ways and paces, and at random.

    A particle's step tells of its pace, since it is the sum of that and of noise: a scalar Kalman update each, with a
    gain that is the same for all particles. Then the pace changes toward zero, by what `keep` leaves of it.

    Parameters
    ----------
    way : (n, 3)
        Of the pelvis in the world, as each particle sees it.
    noise : (6,)
        Variances of the walk at random in this step.
    usual : (6,)
        Standard deviations that the paces have in the long run.
    """
    mean = cloud.x + dt * cloud.pace
    mean[:, :3] += way
    variance = noise + cloud.pace_variance * dt**2
    x = mean + np.sqrt(variance) * rng.standard_normal(mean.shape)
    gain = np.divide(cloud.pace_variance * dt, variance, out=np.zeros(SIZE), where=variance > 0)
    left = cloud.pace_variance * (1.0 - gain * dt)
    return replace(
        cloud,
        x=x,
        pace=keep * (cloud.pace + gain * (x - mean)),
        pace_variance=keep**2 * left + (1.0 - keep**2) * usual**2,
    )


def chosen(cloud: Cloud, at: Int[np.ndarray, " n"]) -> Cloud:
    """The particles of these numbers, of equal weight."""
    even = np.full(at.size, 1.0 / at.size)
    return replace(cloud, x=cloud.x[at], pace=cloud.pace[at], theta=cloud.theta[at], weight=even)


def renewed(cloud: Cloud, share: float, rng: np.random.Generator) -> Cloud:
    """The particles drawn anew by their weights, once for all, where fewer than a share of them count.

    The paper's Algorithm 1 has this inside of the loop over the particles, before all of them have a weight.
    """
    if effective_size(cloud.weight) >= share * cloud.weight.size:
        return cloud
    return chosen(cloud, resampled(rng, cloud.weight))


def spread_anew(cloud: Cloud, rng: np.random.Generator) -> Cloud:
    """The particles drawn anew and moved apart, with the mean and the covariance that they had.

    Each goes toward the mean by a share and at random by what that takes of the covariance (Liu & West 2001, "Combined
    parameter and state estimation in simulation-based filtering", section 10.3.2).
    """
    both = np.concatenate([cloud.x, cloud.pace], axis=1)
    mean, covariance = estimate(both, cloud.weight)
    value, axes = np.linalg.eigh(covariance)
    # the symmetric root: unlike the axes' signs, it does not hang on rounding
    root = (axes * np.sqrt(np.maximum(value, 0.0) * (1.0 - SHRINK**2))) @ axes.T
    new = both[resampled(rng, cloud.weight)]
    new = mean + SHRINK * (new - mean) + rng.standard_normal(new.shape) @ root.T
    even = np.full(new.shape[0], 1.0 / new.shape[0])
    return replace(cloud, x=new[:, :SIZE], pace=new[:, SIZE:], weight=even)


def mean_turn(
    R: Float[np.ndarray, "n 3 3"], weight: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "n 3"]]:
    """Mean of rotations, and the rotation vectors, about the world's axes, that take it to each of them.

    >>> near = Rotation.from_euler("z", [[179.0], [-177.0]], degrees=True).as_matrix()
    >>> mean, apart = mean_turn(near, np.array([0.5, 0.5]))
    >>> float(np.degrees(np.arctan2(mean[1, 0], mean[0, 0])).round(6)), np.degrees(apart[:, 2]).round(6).tolist()
    (-179.0, [-2.0, 2.0])
    """
    u, _, vt = np.linalg.svd(np.einsum("n,nij->ij", weight, R))
    mean = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return mean, rotation_vectors(R @ mean.T)


def rotation_vectors(R: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Axes times angles; scipy's, but quicker for small turns: it first looks whether these are rotations at all.

    >>> rotation_vectors(Rotation.from_rotvec([[0.1, -0.2, 0.3]]).as_matrix()).round(6).tolist()
    [[0.1, -0.2, 0.3]]
    """
    twice = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = 0.5 * np.sqrt((twice**2).sum(axis=1))
    cosine = 0.5 * (R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2] - 1.0)
    if cosine.min(initial=1.0) < SMALL:  # near half a turn the axis is no longer told by the difference
        return Rotation.from_matrix(R).as_rotvec()
    angle = np.arctan2(sine, cosine)
    factor = np.divide(angle, 2.0 * sine, out=np.full(sine.size, 0.5), where=sine > 1e-9)
    return twice * factor[:, None]


def moments_of(
    cloud: Cloud,
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "4 4"]]:
    """Mean place, mean turn D, and covariance of x, y, z and the turn about the vertical."""
    turn, apart = mean_turn(turns(cloud.x), cloud.weight)
    mean, covariance = estimate(np.column_stack([cloud.x[:, :3], apart[:, 2]]), cloud.weight)
    return mean[:3], turn, covariance
