"""What the filter of an arm is told, sees and remembers; and how it learns lengths and the plane from what it sees."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float, Float32, Int

from ..camera import Camera
from .constraints import RayCaster, carried, plane_normal
from .joint_filter import Cloud, Estimate, Motion, Sampling

Variant = Literal["original", "joint-volume", "complete"]
VARIANTS: tuple[Variant, ...] = get_args(Variant)
JOINTS = ("shoulder", "elbow", "wrist")
TRACKED, INFERRED = 0, 1


@dataclass(frozen=True, slots=True)
class Settings:
    """Parameters of the filter.

    Attributes
    ----------
    elbow : (float, float)
        Range of the angle inside the elbow, radians (alpha4 of the thesis).
    half_thickness : float
        Radians by which the forearm may leave the plane that the arm had when it was last seen.
    inferred, inferred_bias : float or None, float
        Standard deviation of each coordinate of an inferred shoulder or elbow, metres, or None where only tracked ones
        count; and the part of it that lasts, which no averaging takes away.
    inferred_wrist, lasting : float or None, float
        Standard deviation of an inferred wrist, or None where it does not count; its errors last so many seconds, so
        that all measurements of such a time count as one.
    soft_shell : bool
        Whether distances in the shell are normally distributed, or all equally likely.
    fathers_apart : float or None
        Whether each particle takes the joint before to be somewhere else within its covariance, and for how many
        seconds about the same; hidden particles move along with it. None: all take its estimate, and stay.
    lengths : (float, float)
        Upper arm and forearm where they have not been measured, metres.
    length_sigma : float
        Standard deviation of these.
    slack : float
        Standard deviations of the distance from father to joint that the shell is half as thick as.
    fathers, sampling : Sampling
        Of shoulder and elbow, and of the wrist.
    fathers_speed : float
        As `motion.speed`, of shoulder and elbow: they move less than the wrist, which hangs on them.
    margin, noise, reach, limb : float, float, int, tuple of float
        Of the depth test: see `constraints.DepthMap`, where `limb` is `along` for the forearm.
    start, clearance : float
        Of the collision test: see `constraints.Room`.
    redraws : int
        Directions that are tried for each particle when all have died.
    far : float
        Metres from the camera, on its axis, at which a wrist that has never been seen is thought, with this spread.
    """

    variant: Variant = "complete"
    motion: Motion = field(default_factory=Motion)
    sampling: Sampling = field(default_factory=Sampling)
    fathers: Sampling = field(default_factory=lambda: Sampling(particles=500))
    fathers_speed: float = 0.25
    elbow: tuple[float, float] = (math.radians(20.0), math.pi)
    half_thickness: float = math.radians(18.0)
    inferred: float | None = 0.05
    inferred_bias: float = 0.02
    inferred_wrist: float | None = 0.08
    lasting: float = 0.2
    soft_shell: bool = True
    fathers_apart: float | None = 0.3
    lengths: tuple[float, float] = (0.30, 0.26)
    length_sigma: float = 0.04
    slack: float = 3.0
    margin: float = 0.02
    noise: float = 0.006
    reach: int = 60
    limb: tuple[float, ...] = (0.4, 0.6, 0.8, 1.0)
    start: float = 0.03
    clearance: float = 0.03
    redraws: int = 4
    far: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What the sensor says at one moment.

    Attributes
    ----------
    time : float
        Seconds.
    p : (3, 3)
        Shoulder, elbow, wrist, metres, camera axes; NaN where the sensor gives no place.
    state : (3,)
        0 tracked, 1 inferred, 2 lost; only tracked joints are measured.
    depth : (h, w) or None
        Metres, 0 where there is no reading.
    """

    time: float
    p: Float[np.ndarray, "3 3"]
    state: Int[np.ndarray, " 3"]
    depth: Float32[np.ndarray, "h w"] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ArmState:
    """What the filter remembers from one moment to the next.

    Attributes
    ----------
    clouds : tuple of Cloud
        Shoulder, elbow, wrist; empty before the first moment.
    length, length_variance : (2,)
        Upper arm and forearm, metres and m^2, as measured so far.
    length_count : (2,)
        Measurements of them.
    upper, normal : (3,) or None
        Direction of the upper arm, and unit normal of the arm's plane, at the last moment; None before they are known.
    places, spreads : (2, 3), (2, 3, 3) or None
        Estimates of shoulder and elbow at the last moment, and roots of their covariances.
    """

    time: float | None
    clouds: tuple[Cloud, ...]
    length: Float[np.ndarray, " 2"]
    length_variance: Float[np.ndarray, " 2"]
    length_count: Int[np.ndarray, " 2"]
    upper: Float[np.ndarray, " 3"] | None = None
    normal: Float[np.ndarray, " 3"] | None = None
    places: Float[np.ndarray, "2 3"] | None = None
    spreads: Float[np.ndarray, "2 3 3"] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What does not change: the camera and, for `complete`, the room."""

    camera: Camera
    caster: RayCaster | None = None
    settings: Settings = field(default_factory=Settings)


def settings_of(variant: Variant) -> Settings:
    """The settings of a variant; `original` is chapter 2 of the thesis, which knows neither of the things added here.

    Those are: inferred joints, hidden particles that move along with the elbow, distances in the shell that are not
    equally likely, and the depth map asked along the whole forearm.
    """
    if variant != "original":
        return Settings(variant)
    return Settings(
        variant,
        inferred=None,
        inferred_wrist=None,
        soft_shell=False,
        fathers_apart=None,
        fathers_speed=Motion().speed,
        limb=(1.0,),
    )


def begin(settings: Settings) -> ArmState:
    """The state before anything has been seen."""
    variance = np.full(2, settings.length_sigma**2)
    return ArmState(None, (), np.array(settings.lengths), variance, np.zeros(2, int))


def lengths_measured(state: ArmState, seen: Seen) -> ArmState:
    """Lengths of upper arm and forearm from the tracked joints: running mean and variance of all distances so far."""
    length, variance, count = state.length.copy(), state.length_variance.copy(), state.length_count.copy()
    for k in range(2):
        both = seen.state[k] == TRACKED and seen.state[k + 1] == TRACKED
        distance = float(np.linalg.norm(seen.p[k + 1] - seen.p[k]))
        if not both or not math.isfinite(distance):
            continue
        count[k] += 1
        share = 1.0 / count[k]
        apart = distance - length[k]
        if count[k] == 1:
            length[k] = distance
        else:
            length[k] += share * apart
            # the prior variance counts as one measurement
            variance[k] += share * (apart * (distance - length[k]) - variance[k])
    return replace(state, length=length, length_variance=variance, length_count=count)


def plane_seen(state: ArmState, seen: Seen, estimates: Sequence[Estimate]) -> ArmState:
    """The arm's plane: from the wrist while it is tracked, else carried along with the upper arm."""
    upper = estimates[1].mean - estimates[0].mean
    if "lost" in (estimates[0].status, estimates[1].status) or not np.linalg.norm(upper) > 1e-6:
        return state
    normal = state.normal
    if normal is not None and state.upper is not None:
        normal = carried(normal, state.upper, upper)
    if seen.state[2] == TRACKED and np.isfinite(seen.p[2]).all():
        found = plane_normal(upper, seen.p[2] - estimates[1].mean)
        normal = normal if found is None else found
    return replace(state, upper=upper / np.linalg.norm(upper), normal=normal)
