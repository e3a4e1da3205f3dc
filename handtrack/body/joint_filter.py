"""A joint's cloud and what was seen of it in, its next cloud and estimate out: one step of the constrained filter.

State of a particle is position and velocity, `s' = A s + noise` (wrist thesis, section 2.3.1). In closed loop, with a
measurement, the noise is an acceleration; weights follow the likelihood of the measurement. In open loop, while the
joint is hidden, velocities fade,

    v' = exp(-dt / tau) v + sigma_v sqrt(1 - exp(-2 dt / tau)) noise,

which has the spread `sigma_v` for ever, whatever the time step; particles live or die by the constraints.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from .constraints import TESTS, Constraints, shell_weight, survivors
from .particles import Scheme, effective_size, estimate, normalised, resampled, volume

Status = Literal["tracked", "predicted", "uncertain", "lost"]
NEVER = math.inf
SHELL_TIME = 1.0 / 30.0  # seconds after which hidden particles are weighed by their distance once more


@dataclass(frozen=True, slots=True)
class Motion:
    """How a joint moves and how well it is measured.

    Attributes
    ----------
    acceleration : float
        Standard deviation of each component in closed loop, m/s^2.
    speed, fading : float
        sigma_v and tau of open loop, m/s and s.
    sensor : float
        Standard deviation of each coordinate of a measurement, metres. The thesis puts standard deviations where the
        covariance belongs; here they are squared.
    start_speed : float
        Standard deviation of velocities where nothing is known of them, m/s.
    """

    acceleration: float = 10.0
    speed: float = 0.4
    fading: float = 0.15
    sensor: float = 0.015
    start_speed: float = 0.5


@dataclass(frozen=True, slots=True)
class Sampling:
    """Particles, the share of them below which the effective size asks for resampling, and how that is done."""

    particles: int = 2000
    resample_below: float = 0.5
    scheme: Scheme = "systematic"


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Particles of one joint.

    Attributes
    ----------
    x : (n, 6)
        Position and velocity, metres and seconds, camera axes.
    log_weight : (n,)
    unseen : float
        Seconds since the last measurement; infinite where there has been none.
    apart : (n, 3) or None
        Where each particle takes the joint before to be: standard deviations from its estimate, along the columns of
        the root of its covariance. None where this has not been drawn.
    """

    x: Float[np.ndarray, "n 6"]
    log_weight: Float[np.ndarray, " n"]
    unseen: float = NEVER
    apart: Float[np.ndarray, "n 3"] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Where a joint is.

    Attributes
    ----------
    mean, covariance : (3,), (3, 3)
        Of the particles that the constraints left alive, before resampling; metres, camera axes.
    volume : float
        Of the ellipsoid that holds 95 %, m^3.
    status : str
        `tracked` by a measurement; `predicted` without; `uncertain` where no particle was left and all were drawn
        anew, or the joint before is not tracked; `lost` where it has never been seen.
    kills : (4,)
        Particles that each of `constraints.TESTS` killed.
    effective : float
        Effective number of particles.
    """

    mean: Float[np.ndarray, " 3"]
    covariance: Float[np.ndarray, "3 3"]
    volume: float
    status: Status
    kills: Int[np.ndarray, " 4"]
    effective: float


def born(
    rng: np.random.Generator,
    mean: Float[np.ndarray, " 3"],
    sigma: float,
    speed: float,
    count: int,
    unseen: float,
) -> Cloud:
    """A cloud about a place, at rest on average."""
    x = rng.normal(size=(count, 6)) * np.repeat([sigma, speed], 3)
    x[:, :3] += mean
    return Cloud(x, np.zeros(count), unseen)


def moved(rng: np.random.Generator, x: Float[np.ndarray, "n 6"], dt: float, motion: Motion, closed: bool):
    """Particles one time step later.

    >>> rng = np.random.default_rng(0)
    >>> still = Motion(acceleration=0.0)
    >>> moved(rng, np.array([[0.0, 0.0, 0.0, 1.0, 2.0, 3.0]]), 0.5, still, True)[0, :3].tolist()
    [0.5, 1.0, 1.5]
    """
    noise = rng.normal(size=(x.shape[0], 3))
    out = np.empty_like(x)
    v = x[:, 3:]
    if closed:
        push = motion.acceleration * dt * noise
        out[:, 3:] = v + push
        out[:, :3] = x[:, :3] + dt * (v + 0.5 * push)
        return out
    keep = math.exp(-dt / motion.fading)
    out[:, 3:] = keep * v + motion.speed * math.sqrt(1.0 - keep * keep) * noise
    out[:, :3] = x[:, :3] + 0.5 * dt * (v + out[:, 3:])
    return out


def measured(
    rng: np.random.Generator,
    cloud: Cloud,
    y: Float[np.ndarray, " 3"],
    father: Float[np.ndarray, "*n 3"] | None,
    tests: Constraints,
    motion: Motion,
    sampling: Sampling,
) -> tuple[Cloud, Estimate]:
    """The step of closed loop, after the particles moved.

    Where a measurement follows a gap, or no particle is near it, the cloud begins anew at the measurement.
    """
    if cloud.unseen > 0.0:
        cloud = born(rng, y, motion.sensor, motion.start_speed, sampling.particles, 0.0)
        return cloud, estimated(cloud, "tracked", np.zeros(len(TESTS), int))
    far = ((y - cloud.x[:, :3]) ** 2).sum(axis=1) / motion.sensor**2
    tested = survivors(cloud.x[:, :3], father, tests)
    logs = np.where(
        tested.alive, cloud.log_weight - 0.5 * far + shell_weight(cloud.x[:, :3], father, tests.shell), -np.inf
    )
    if not tested.alive.any() or far[tested.alive].min() > 16.0:
        cloud = born(rng, y, motion.sensor, motion.start_speed, sampling.particles, 0.0)
        return cloud, estimated(cloud, "tracked", tested.kills)
    cloud = replace(cloud, log_weight=logs - logs.max(), unseen=0.0)
    return renewed(rng, cloud, sampling), estimated(cloud, "tracked", tested.kills)


def hidden(
    rng: np.random.Generator,
    cloud: Cloud,
    dt: float,
    father: Float[np.ndarray, "*n 3"] | None,
    tests: Constraints,
    sampling: Sampling,
) -> tuple[Cloud, Estimate | None]:
    """The step of open loop, after the particles moved; no estimate where all died."""
    tested = survivors(cloud.x[:, :3], father, tests, np.isfinite(cloud.log_weight))
    # a length is one fact, however many frames there are: its weight belongs to a time
    likely = min(dt / SHELL_TIME, 1.0) * shell_weight(cloud.x[:, :3], father, tests.shell)
    left = replace(
        cloud, log_weight=np.where(tested.alive, cloud.log_weight + likely, -np.inf), unseen=cloud.unseen + dt
    )
    if not tested.alive.any():
        return left, None
    return renewed(rng, left, sampling), estimated(left, "predicted", tested.kills)


def renewed(rng: np.random.Generator, cloud: Cloud, sampling: Sampling) -> Cloud:
    """The cloud, drawn anew by its weights where few particles carry them."""
    weight = normalised(cloud.log_weight)
    if effective_size(weight) >= sampling.resample_below * weight.size:
        return cloud
    chosen = resampled(rng, weight, sampling.scheme, sampling.particles)
    apart = None if cloud.apart is None else cloud.apart[chosen]
    return Cloud(cloud.x[chosen], np.zeros(chosen.size), cloud.unseen, apart)


def estimated(cloud: Cloud, status: Status, kills: Int[np.ndarray, " 4"]) -> Estimate:
    """What a cloud says."""
    weight = normalised(cloud.log_weight)
    mean, covariance = estimate(cloud.x[:, :3], weight)
    return Estimate(mean, covariance, volume(covariance), status, kills, effective_size(weight))
