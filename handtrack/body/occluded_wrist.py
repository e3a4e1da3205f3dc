"""An arm as a sensor sees it in, where its wrist can be out, hidden or not: the filter of the wrist thesis.

Shoulder, elbow and wrist follow each other (chapter 2): each has its own cloud, and the estimate of one is the father
of the next. Three variants are those of section 7.3.1:

* `original`: the skeletal shell, and the depth map while the wrist is hidden;
* `joint-volume`: the arm's plane and the elbow's range too;
* `complete`: the room too.
"""

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float32

from .arm_state import INFERRED as INFERRED
from .arm_state import JOINTS as JOINTS
from .arm_state import TRACKED as TRACKED
from .arm_state import VARIANTS as VARIANTS
from .arm_state import ArmState as ArmState
from .arm_state import Scene as Scene
from .arm_state import Seen as Seen
from .arm_state import Settings as Settings
from .arm_state import Variant as Variant
from .arm_state import begin as begin
from .arm_state import lengths_measured, plane_seen
from .arm_state import settings_of as settings_of
from .constraints import Constraints, DepthMap, Room, Shell, volume_at
from .joint_filter import NEVER, Cloud, Estimate, born, hidden, measured, moved
from .particles import volume
from .redraw import all_dead, never_seen


def step(state: ArmState, seen: Seen, scene: Scene, rng: np.random.Generator) -> tuple[ArmState, tuple[Estimate, ...]]:
    """One moment further.

    Returns
    -------
    ArmState
    tuple of Estimate
        Of shoulder, elbow, wrist. The wrist's cloud before resampling has this mean and covariance.

    Raises
    ------
    ValueError
        If time does not rise.
    """
    dt = 0.0 if state.time is None else seen.time - state.time
    if state.time is not None and not dt > 0.0:
        raise ValueError(f"time: {seen.time:g} s after {state.time:g} s; a later time was wanted")
    state = lengths_measured(state, seen)
    clouds, estimates = [], []
    for joint in range(3):
        father = estimates[joint - 1] if joint else None
        if joint == 2:
            state = plane_seen(state, seen, estimates)
        before = state.clouds[joint] if state.clouds else _unknown(rng, joint, scene.settings)
        cloud, estimate = _joint_step(rng, joint, before, dt, father, state, seen, scene)
        clouds.append(cloud)
        estimates.append(estimate)
    places = np.stack([each.mean for each in estimates[:2]])
    spreads = np.stack([_root(each.covariance) for each in estimates[:2]])
    new = replace(state, time=seen.time, clouds=tuple(clouds), places=places, spreads=spreads)
    return new, tuple(estimates)


def _root(covariance: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Columns whose products with independent standard deviations have this covariance; also of a flat one."""
    variance, axes = np.linalg.eigh(covariance)
    return axes * np.sqrt(np.maximum(variance, 0.0)) @ axes.T


def _unknown(rng: np.random.Generator, joint: int, settings: Settings) -> Cloud:
    """A joint that has never been seen."""
    count = (settings.sampling if joint == 2 else settings.fathers).particles
    place = np.array([0.0, 0.0, settings.far])
    return born(rng, place, 0.5 * settings.far, settings.motion.start_speed, count, NEVER)


def _joint_step(
    rng: np.random.Generator,
    joint: int,
    cloud: Cloud,
    dt: float,
    father: Estimate | None,
    state: ArmState,
    seen: Seen,
    scene: Scene,
) -> tuple[Cloud, Estimate]:
    """Step of shoulder (0), elbow (1) or wrist (2)."""
    settings = scene.settings
    sampling = settings.sampling if joint == 2 else settings.fathers
    y = seen.p[joint] if np.isfinite(seen.p[joint]).all() else None
    sigma = None if y is None else _sensor_sigma(joint, int(seen.state[joint]), settings)
    known = father if father is not None and father.status != "lost" else None
    cloud, place = _carried(rng, joint, cloud, dt, known, state, settings, sigma is None)
    if dt > 0.0 and cloud.unseen < NEVER:
        motion = settings.motion if joint == 2 else replace(settings.motion, speed=settings.fathers_speed)
        cloud = replace(cloud, x=moved(rng, cloud.x, dt, motion, sigma is not None))
    tests = _tests(joint, known, state, None if sigma is not None else seen.depth, scene)
    if y is not None and sigma is not None:
        cloud, estimate = measured(rng, cloud, y, place, tests, replace(settings.motion, sensor=sigma), sampling)
        return cloud, estimate if sigma == settings.motion.sensor else _widened(estimate, settings.inferred_bias**2)
    middle = None if known is None else known.mean
    if cloud.unseen == NEVER:
        return never_seen(rng, cloud, joint, middle, state, tests, settings)
    if y is not None and joint == 2 and seen.state[2] == INFERRED:
        cloud = _guessed(cloud, y, dt, settings)
    left, estimate = hidden(rng, cloud, dt, place, tests, sampling)
    if estimate is None:
        return all_dead(rng, left, joint, middle, state, tests, settings)
    if father is None:
        return left, estimate
    return left, replace(estimate, status=estimate.status if father.status == "tracked" else "uncertain")


def _carried(
    rng: np.random.Generator,
    joint: int,
    cloud: Cloud,
    dt: float,
    father: Estimate | None,
    state: ArmState,
    settings: Settings,
    hidden: bool,
) -> tuple[Cloud, Float[np.ndarray, "*n 3"] | None]:
    """Particles moved along with where each of them takes the joint before to be, and these places."""
    if father is None:
        return replace(cloud, apart=None), None
    if settings.fathers_apart is None:
        return cloud, father.mean
    n = cloud.x.shape[0]
    fresh = rng.normal(size=(n, 3))
    keep = math.exp(-dt / settings.fathers_apart)
    apart = fresh if cloud.apart is None else keep * cloud.apart + math.sqrt(1.0 - keep * keep) * fresh
    place = father.mean + apart @ _root(father.covariance)
    x = cloud.x
    if hidden and cloud.apart is not None and state.places is not None and state.spreads is not None:
        x = x.copy()
        x[:, :3] += place - state.places[joint - 1] - cloud.apart @ state.spreads[joint - 1]
    return replace(cloud, x=x, apart=apart), place


def _sensor_sigma(joint: int, state: int, settings: Settings) -> float | None:
    """Standard deviation of a measurement of a joint; None where it is none."""
    if state == TRACKED:
        return settings.motion.sensor
    return settings.inferred if state == INFERRED and joint < 2 else None


def _widened(estimate: Estimate, more: Float[np.ndarray, "3 3"] | float) -> Estimate:
    """An estimate with more variance."""
    covariance = estimate.covariance + (more * np.eye(3) if isinstance(more, float) else more)
    return replace(estimate, covariance=covariance, volume=volume(covariance))


def _guessed(cloud: Cloud, y: Float[np.ndarray, " 3"], dt: float, settings: Settings) -> Cloud:
    """A hidden wrist's cloud, weighed by where the sensor supposes it: errors that last are not counted every frame."""
    if settings.inferred_wrist is None:
        return cloud
    far = ((cloud.x[:, :3] - y) ** 2).sum(axis=1) / settings.inferred_wrist**2
    return replace(cloud, log_weight=cloud.log_weight - 0.5 * far * min(dt / settings.lasting, 1.0))


def _tests(
    joint: int,
    father: Estimate | None,
    state: ArmState,
    depth: Float32[np.ndarray, "h w"] | None,
    scene: Scene,
) -> Constraints:
    """The constraints of a joint; `depth` only in open loop."""
    settings = scene.settings
    seen = None
    if depth is not None:
        along = settings.limb if joint == 2 else (1.0,)
        seen = DepthMap(depth, scene.camera, settings.margin, settings.noise, settings.reach, along)
    if joint == 0 or father is None:
        return Constraints(depth=seen)
    variance = 0.0 if settings.fathers_apart is not None else father.covariance.trace() / 3.0
    sigma = math.sqrt(state.length_variance[joint - 1] + variance)
    middle = float(state.length[joint - 1])
    thick = settings.slack * sigma
    shell = Shell(max(middle - thick, 0.0), middle + thick, sigma if settings.soft_shell else None)
    if joint == 1 or settings.variant == "original":
        return Constraints(shell=shell, depth=seen)
    volume = None
    if state.normal is not None and state.upper is not None:
        volume = volume_at(state.upper, state.normal, settings.elbow, settings.half_thickness)
    room = None
    if settings.variant == "complete" and scene.caster is not None:
        room = Room(scene.caster, settings.start, settings.clearance)
    return Constraints(room, volume, shell, seen)
