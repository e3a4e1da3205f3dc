"""An RGB-D scene in, the track of its wrist out: the filter of the occluded wrist, frame by frame.

Where a frame has several detections, the person is followed who is nearest to where the keypoints were last, within
what a body can move; a lone stranger farther away is nobody. Depth is only read where a joint of the arm is not
measured: no other test asks for it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from jaxtyping import Float, Float32, Int

from ..errors import InputError
from ..formats.rgbd import RgbdScene, read_depth
from ..formats.skeletons import KEYPOINTS, LOST, Detections
from ..formats.wrists import WristTrack as WristTrack
from .arm import Side
from .environment import Engine, RayCaster, ray_caster, read_room
from .joint_filter import Cloud, Estimate
from .occluded_wrist import JOINTS, TRACKED, VARIANTS, Scene, Seen, Settings, Variant, begin, settings_of, step
from .particles import normalised, resampled

__all__ = ["JOINTS", "VARIANTS", "Arm", "Followed", "WristTrack", "arm_of", "arm_seen", "follow", "run", "settings_for"]

SHOWN = 200  # particles of each frame that are kept to be looked at
GATE, FASTEST = 0.6, 3.0  # metres that the same person may seem to jump, and m/s that he may move besides


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """What the sensor says of one arm.

    Attributes
    ----------
    p : (f, 3, 3)
        Shoulder, elbow, wrist, metres; NaN where unseen.
    state : (f, 3)
        0 tracked, 1 inferred, 2 lost.
    """

    p: Float[np.ndarray, "f 3 3"]
    state: Int[np.ndarray, "f 3"]


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Settings that were used in the end, what casts rays if anything does, and what had to be said about it."""

    settings: Settings
    caster: RayCaster | None
    warnings: tuple[str, ...]


def settings_for(variant: str, particles: int | None = None) -> Settings:
    """Settings of a variant, with another number of particles for the wrist if one is given.

    Raises
    ------
    InputError
        If the variant is unknown or there are fewer than 10 particles.
    """
    known: Variant | None = next((name for name in VARIANTS if name == variant), None)
    if known is None:
        raise InputError(f"--variant: {variant} given; wanted: {', '.join(VARIANTS)}")
    settings = settings_of(known)
    if particles is None:
        return settings
    if not 10 <= particles <= 1_000_000:
        raise InputError(f"--particles: {particles} given; 10 to 1000000 are wanted")
    return replace(settings, sampling=replace(settings.sampling, particles=particles))


def arm_of(detections: Detections, person: int = 0, side: Side = "right") -> Arm:
    """The arm of one person, in every frame.

    Parameters
    ----------
    person : int
        Place of the person among the detections of the first frame that has so many; 0 is the first.

    Raises
    ------
    InputError
        If no frame has so many persons.
    """
    chosen = _detections_of(detections, person)
    at = [KEYPOINTS.index(f"{side}_{name}") for name in JOINTS]
    f = detections.time.size
    p, state = np.full((f, 3, 3), np.nan), np.full((f, 3), LOST, dtype=int)
    seen = chosen >= 0
    p[seen] = detections.p[chosen[seen]][:, at]
    state[seen] = detections.state[chosen[seen]][:, at]
    return Arm(p, state)


def _detections_of(detections: Detections, person: int) -> Int[np.ndarray, " f"]:
    """Number of the person's detection in each frame, -1 where there is none."""
    f = detections.time.size
    chosen = np.full(f, -1)
    rows = np.searchsorted(detections.frame, np.arange(f + 1))
    last, when, begun = np.full((len(KEYPOINTS), 3), np.nan), np.full(len(KEYPOINTS), -np.inf), False
    for n in range(f):
        here = np.arange(rows[n], rows[n + 1])
        if not begun:
            if here.size <= person:
                continue
            best = int(here[person])
        elif here.size:
            apart = np.linalg.norm(detections.p[here] - last, axis=2) - FASTEST * (detections.time[n] - when)
            known = ~np.isnan(apart)
            mean = np.where(known, apart, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
            mean = np.where(known.any(axis=1), mean, np.inf if here.size > 1 else 0.0)
            if not mean.min() <= GATE:
                continue
            best = int(here[mean.argmin()])
        else:
            continue
        chosen[n], begun = best, True
        found = np.isfinite(detections.p[best]).all(axis=1)
        last[found], when[found] = detections.p[best][found], detections.time[n]
    if f and detections.frame.size and not begun:
        raise InputError(f"person: {person} given; no frame has so many, they are counted from 0")
    return chosen


def arm_seen(arm: Arm, time: Float[np.ndarray, " f"], frame: int, depth: Float32[np.ndarray, "h w"] | None) -> Seen:
    """What the filter is told of a frame."""
    return Seen(float(time[frame]), arm.p[frame], arm.state[frame], depth)


def follow(scene: RgbdScene, settings: Settings, engine: Engine = "auto") -> Followed:
    """The settings for a scene: `complete` needs a room, and falls back to `joint-volume` where there is none.

    Raises
    ------
    InputError
        If the mesh of the room cannot be read, or the engine is not installed.
    """
    if settings.variant != "complete":
        return Followed(settings, None, ())
    without = replace(settings, variant="joint-volume")
    if scene.environment is None:
        said = f"{scene.path}: names no environment; 'joint-volume' is taken instead of 'complete'"
        return Followed(without, None, (said,))
    room = read_room(scene.environment)
    if not room.triangles.shape[0]:
        said = f"{scene.environment}: is empty; 'joint-volume' is taken instead of 'complete'"
        return Followed(without, None, (*room.warnings, said))
    return Followed(settings, ray_caster(room, engine), room.warnings)


def run(
    scene: RgbdScene,
    settings: Settings,
    seed: int = 1,
    person: int = 0,
    side: Side = "right",
    engine: Engine = "auto",
    progress: Callable[[int], None] | None = None,
) -> WristTrack:
    """Follow the wrist of one arm through a scene.

    Parameters
    ----------
    seed : int
        Decides every random choice: the same scene, settings and seed give the same track.
    person, side : int, str
        Whose arm, and which; see `arm_of`.
    engine : str
        What casts rays in the room; see `environment.ray_caster`.
    progress : callable
        Called with the number of frames done.

    Raises
    ------
    InputError
        For a broken depth image or room, a person who is not there, or a scene without frames.
    """
    if not len(scene):
        raise InputError(f"{scene.path}: has no frames; at least one is wanted")
    arm = arm_of(scene.detections, person, side)
    used = follow(scene, settings, engine)
    told = Scene(scene.camera, used.caster, used.settings)
    rng, thinning = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    state, found, clouds, seconds = begin(used.settings), [], [], []
    for frame in range(len(scene)):
        hidden = (arm.state[frame] != TRACKED).any()
        seen = arm_seen(arm, scene.detections.time, frame, read_depth(scene, frame) if hidden else None)
        begun = perf_counter()
        state, estimates = step(state, seen, told, rng)
        seconds.append(perf_counter() - begun)
        found.append(estimates)
        clouds.append(_thinned(thinning, state.clouds[2]))
        if progress is not None:
            progress(frame + 1)
    return _track(scene.detections.time, found, np.stack(clouds), np.array(seconds), used.warnings)


def _thinned(rng: np.random.Generator, cloud: Cloud) -> Float32[np.ndarray, "c 3"]:
    """Some particles, drawn by their weights."""
    weight = normalised(cloud.log_weight)
    if not weight.any():
        weight = np.full(weight.size, 1.0 / weight.size)
    return cloud.x[resampled(rng, weight, count=SHOWN), :3].astype(np.float32)


def _track(
    time: Float[np.ndarray, " f"],
    found: list[tuple[Estimate, ...]],
    cloud: Float32[np.ndarray, "f c 3"],
    seconds: Float[np.ndarray, " f"],
    warnings: tuple[str, ...],
) -> WristTrack:
    shoulder, elbow, wrist = zip(*found, strict=True)
    return WristTrack(
        time=time,
        mean=np.stack([each.mean for each in wrist]),
        covariance=np.stack([each.covariance for each in wrist]),
        volume=np.array([each.volume for each in wrist]),
        status=np.array([each.status for each in wrist], dtype=np.str_),
        kills=np.stack([each.kills for each in wrist]),
        elbow=np.stack([each.mean for each in elbow]),
        shoulder=np.stack([each.mean for each in shoulder]),
        cloud=cloud,
        seconds=seconds,
        warnings=warnings,
    )
