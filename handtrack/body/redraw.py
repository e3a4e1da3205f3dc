"""A joint of which no particle is left, or that has never been seen, in; a cloud drawn anew on the shell out."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .arm_state import ArmState, Settings
from .constraints import TESTS, Constraints, survivors
from .joint_filter import NEVER, Cloud, Estimate, born, estimated


def all_dead(
    rng: np.random.Generator,
    cloud: Cloud,
    joint: int,
    father: Float[np.ndarray, " 3"] | None,
    state: ArmState,
    tests: Constraints,
    settings: Settings,
) -> tuple[Cloud, Estimate]:
    """A cloud drawn anew on the shell: where all constraints agree, or else without the one that forbids everything."""
    count = cloud.x.shape[0]
    if father is None:
        spread = estimated(replace(cloud, log_weight=np.zeros(count)), "uncertain", np.zeros(len(TESTS), int))
        grown = born(rng, spread.mean, 0.5, settings.motion.start_speed, count, cloud.unseen)
        return grown, estimated(grown, "uncertain", np.full(len(TESTS), 0))
    sigma = math.sqrt(state.length_variance[joint - 1])
    p = on_shell(rng, father, float(state.length[joint - 1]), sigma, count * settings.redraws)
    kills = np.zeros(len(TESTS), int)
    for left in _fewer(replace(tests, shell=None)):
        tested = survivors(p, father, left)
        kills = kills if kills.any() else tested.kills
        if tested.alive.any():
            break
    alive = np.flatnonzero(tested.alive)
    chosen = p[alive[rng.integers(alive.size, size=count)]]
    x = np.hstack([chosen, settings.motion.speed * rng.normal(size=(count, 3))])
    new = Cloud(x, np.zeros(count), cloud.unseen)
    return new, estimated(new, "uncertain", kills)


def _fewer(tests: Constraints) -> Sequence[Constraints]:
    """Constraints, and with fewer and fewer of them: the depth map is the first to be doubted."""
    without = replace(tests, depth=None)
    return tests, without, replace(without, volume=None), Constraints()


def on_shell(
    rng: np.random.Generator, centre: Float[np.ndarray, " 3"], radius: float, sigma: float, count: int
) -> Float[np.ndarray, "n 3"]:
    """Places about a sphere, all directions equally likely."""
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return centre + way * (radius + sigma * rng.normal(size=(count, 1)))


def never_seen(
    rng: np.random.Generator,
    cloud: Cloud,
    joint: int,
    father: Float[np.ndarray, " 3"] | None,
    state: ArmState,
    tests: Constraints,
    settings: Settings,
) -> tuple[Cloud, Estimate]:
    """A joint that no sensor has seen yet: anywhere on the shell about its father, or anywhere in view."""
    if father is None:
        return cloud, estimated(cloud, "lost", np.zeros(len(TESTS), int))
    new, estimate = all_dead(rng, cloud, joint, father, state, tests, settings)
    return replace(new, unseen=NEVER), replace(estimate, status="uncertain")
