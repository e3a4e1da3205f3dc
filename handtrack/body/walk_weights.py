"""Particles, postures and the keypoints of a frame in, weighted particles out: eq. (6) of the walk paper, made sturdy.

    w_k = w_{k-1} p(z_c | e, D, theta)^s,    p = product over keypoints of (1 - o) N(r; 0, sigma^2) + o N(r; 0, l^2)

with the pixels r between the keypoint and its image. A keypoint's sigma goes with its confidence, o is the share of
keypoints that were found somewhere else, and the power s tempers what a few hundred particles, or frames that share
their noise, would take for too sure. The weights belong to (4) with k in both factors: the paper's (4) and (5) have the
posture of k + 1 beside the place of k, but Algorithm 1 draws both for k, and so is it done here.

Where one step would leave too few particles, it is taken in several, each with the largest power that leaves enough,
and particles are spread anew in between (Oudjane & Musso 2000, "Progressive correction for regularized particle
filters"; Deutscher, Blake & Reid 2000 anneal postures alike).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..camera import camera_from_world, pixels_per_unit, project
from .particles import effective_size, normalised
from .posture import Body
from .walk_cloud import Cloud, spread_anew, world_points
from .walk_moment import Moment, keypoint_sigma, lasting_factor
from .walk_settings import Settings

STAGES = 12  # steps of one update at most
HALVINGS = 10
STEP = 0.3  # share of effective particles that each step leaves
FARTHEST = 6.0  # spreads of an outlier beyond which it does not get worse


def pixel_variance(moment: Moment, points: Float[np.ndarray, "16 3"], settings: Settings) -> Float[np.ndarray, " 16"]:
    """Variance of each keypoint along an axis of the image, pixels^2: the network's and the body model's.

    Parameters
    ----------
    points : (16, 3)
        About where the keypoints are, world.
    """
    metre = pixels_per_unit(moment.camera, camera_from_world(moment.camera, points))
    return keypoint_sigma(moment.confidence, settings) ** 2 + (metre * settings.length_noise) ** 2


def log_likelihood(
    moment: Moment, points: Float[np.ndarray, "n 16 3"], variance: Float[np.ndarray, " 16"], settings: Settings
) -> Float[np.ndarray, " n"]:
    """ln p(z_c | e, D, theta) of every particle, but for a constant.

    Parameters
    ----------
    points : (n, 16, 3)
        Keypoints of each particle in the world.
    variance : (16,)
        Of `pixel_variance`.
    """
    seen = moment.confidence > 0
    uv = project(moment.camera, points[:, seen])
    far = settings.outlier_spread**2
    square = ((uv - moment.uv[seen]) ** 2).sum(axis=-1)
    square = np.minimum(np.nan_to_num(square, nan=np.inf), FARTHEST**2 * far)  # NaN: behind the camera
    near = (1.0 - settings.outliers) / variance[seen] * np.exp(-0.5 * square / variance[seen])
    # a little is left for points somewhere else even if nobody expects any, since no weight may be nothing
    wrong = max(settings.outliers, 1e-6) / far * np.exp(-0.5 * square / far)
    return np.log(near + wrong).sum(axis=1)


def largest_power(
    weight: Float[np.ndarray, " n"], log_likelihood: Float[np.ndarray, " n"], most: float, share: float
) -> float:
    """Largest power of a likelihood, up to `most`, that leaves so large a share of the particles effective.

    >>> largest_power(np.full(4, 0.25), np.zeros(4), 0.3, 0.5)
    0.3
    """
    wanted = min(share * weight.size, 0.99 * effective_size(weight))
    likelihood = log_likelihood - log_likelihood.max()

    def leaves(power: float) -> bool:
        new = weight * np.exp(power * likelihood)
        return float(new.sum()) ** 2 >= wanted * float(new @ new)

    if leaves(most):
        return most
    low, high = 0.0, most
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if leaves(middle) else (low, middle)
    return low


def weighed(
    cloud: Cloud,
    points: Float[np.ndarray, "n 16 3"],
    draw: Callable[[Cloud], Cloud],
    body: Body,
    base: Float[np.ndarray, "3 3"],
    moment: Moment,
    settings: Settings,
    rng: np.random.Generator,
) -> Cloud:
    """The particles with weights that a frame of the camera gives to them, and the postures that these belong to.

    Parameters
    ----------
    points : (n, 16, 3)
        Their keypoints in the world.
    draw : callable
        Gives other postures to particles that have moved.
    base : (3, 3)
        Orientation of the pelvis before each particle turns it.
    """
    left = settings.temper / lasting_factor(moment, settings)
    variance = pixel_variance(moment, np.einsum("n,nkd->kd", cloud.weight, points), settings)
    for stage in range(STAGES):
        if stage:
            cloud = draw(spread_anew(cloud, rng))
            points = world_points(cloud, body, base)
        found = log_likelihood(moment, points, variance, settings)
        last = stage == STAGES - 1 or not settings.proposal
        power = left if last else largest_power(cloud.weight, found, left, STEP)
        cloud = replace(cloud, weight=normalised(np.log(np.maximum(cloud.weight, 1e-300)) + power * found))
        left -= power
        if left <= 0.0:
            break
    return cloud


def fits(cloud: Cloud, points: Float[np.ndarray, "n 16 3"], moment: Moment, settings: Settings) -> bool:
    """Whether most keypoints lie where the particles, as they are before the frame, expect them.

    Parameters
    ----------
    points : (n, 16, 3)
        Keypoints of the particles in the world.
    """
    seen = moment.confidence > 0
    uv = project(moment.camera, points[:, seen])
    good = np.isfinite(uv).all(axis=(1, 2))
    share = float(cloud.weight[good].sum())
    if share < 0.5:
        return False
    weight, uv, points = cloud.weight[good] / share, uv[good], points[good]
    mean = np.einsum("n,nkd->kd", weight, uv)
    apart = np.swapaxes(uv - mean, 0, 1)
    whole = np.swapaxes(apart * weight[:, None], 1, 2) @ apart
    variance = pixel_variance(moment, np.einsum("n,nkd->kd", weight, points), settings)[seen]
    whole = whole + variance[:, None, None] * np.eye(2)
    off = moment.uv[seen] - mean
    square = (off * np.linalg.solve(whole, off[..., None])[..., 0]).sum(axis=1)
    return bool(np.mean(square < settings.gate**2) > 0.5)
