"""A seed and settings in, a simulated walk of a person with an inertial suit before one camera out, with its truth.

A person of given height, with lengths a little off the average, walks laps about a room, stands still at times, and
moves the hands. True joints do a little more than the 20 of the model (`looseness`); keypoints and suit see that body.
Suit and camera sample it at their own times.
"""

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from handtrack.body.anthropometry import Sizes, sizes_of
from handtrack.body.posture import Body, body_of, points_on, segment_frames
from handtrack.body.posture_tree import offsets_of
from handtrack.formats.walks import Walk, WalkTruth, write_walk

from .cell_motion import smooth_noise
from .walk_bvh import looped, read_motion, recorded_poses, stride_of
from .walk_camera import FEWEST, MORE, place_camera, seen_spans, sense_keypoints, shown, visible_lengths
from .walk_gait import STRIDE, fixed_poses, gait, gestures_of, standing_times, walking, with_gestures
from .walk_path import Way, lap, way_of
from .walk_settings import WalkSettings as WalkSettings
from .walk_suit import Drift, frames_along, sense_segments

RATE = 50.0  # samples a second of the motion itself
LOOSE = 0.6  # seconds over which the joints' looseness changes
STAND = (5.0, 8.0)  # seconds that a stop lasts
BETWEEN = 25.0  # seconds between two stops at least
IN_VIEW = 2.5  # seconds from the start for which the path is in view


@dataclass(frozen=True, slots=True, eq=False)
class WalkScene:
    """A simulated walk.

    Attributes
    ----------
    settings : WalkSettings
    walk : Walk
        What the suit and the camera report, and the truth.
    body : Body
        The person's true body.
    q : (f, 26)
        True poses, less the looseness of the joints, at the suit's frames.
    drift : Drift
        Of the suit.
    seen : (c,)
        In which of the camera's frames the person is in view.
    lap : (f,)
        Laps walked at the suit's frames.
    """

    settings: WalkSettings
    walk: Walk
    body: Body
    q: Float[np.ndarray, "f 26"]
    drift: Drift
    seen: Bool[np.ndarray, " c"]
    lap: Float[np.ndarray, " f"]


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """Poses and looseness on the fine grid."""

    way: Way
    q: Float[np.ndarray, "m 26"]
    loose: Float[np.ndarray, "m 39"]

    def at(self, time: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "n 26"], Float[np.ndarray, "n 13 3 3"]]:
        """Poses at times, and the extra turn of each segment."""
        q, loose = (
            np.column_stack([np.interp(time, self.way.time, column) for column in table.T])
            for table in (self.q, self.loose)
        )
        turn = Rotation.from_rotvec(np.radians(loose).reshape(-1, 3)).as_matrix()
        return q, turn.reshape(time.size, -1, 3, 3)


def make_walk(seed: int, settings: WalkSettings | None = None) -> WalkScene:
    """Simulate a walk; the same seed and settings give the same walk.

    Raises
    ------
    InputError
        If the recorded motion cannot be read.
    """
    settings = WalkSettings() if settings is None else settings
    person, room, suit, eye = (np.random.default_rng([seed, part]) for part in range(4))
    body, told = _person(person, settings)
    camera = place_camera(room, min(settings.in_view + MORE, 1.0), settings)
    motion = _motion(person, body, visible_lengths(camera, settings.height), settings)
    time = np.arange(math.floor(settings.seconds * settings.fps) + 1) / settings.fps
    camera_time = np.arange(math.floor(settings.seconds * settings.camera_fps) + 1) / settings.camera_fps
    camera_time = camera_time + settings.jitter * np.clip(eye.standard_normal(camera_time.size), -3.0, 3.0)
    q, loose = motion.at(time)
    R, points = _true_body(body, q, loose)
    _, seen_points = _true_body(body, *motion.at(camera_time))
    inside = shown(camera, seen_points).sum(axis=1) >= FEWEST
    seen = seen_spans(room, inside, settings.camera_fps, settings.in_view, settings.longest_gap)
    uv, confidence = sense_keypoints(eye, camera, seen_points, seen, settings)
    p, wxyz, drift = sense_segments(suit, time, q[:, :3], R, body.whole.parent, offsets_of(told), settings)
    names = tuple(field.name for field in fields(Sizes))
    walk = Walk(
        path=Path("walk.yaml"),
        fps=settings.fps,
        camera=camera,
        height=settings.height,
        measurements=() if settings.measured is None else tuple((name, getattr(told, name)) for name in names),
        frame=np.arange(time.size),
        time=time,
        p=p,
        wxyz=wxyz,
        camera_frame=np.arange(camera_time.size),
        camera_time=camera_time,
        uv=uv,
        confidence=confidence,
        truth=WalkTruth(
            q[:, :3].copy(), Rotation.from_matrix(R[:, 0]).as_quat(scalar_first=True, canonical=True), points
        ),
    )
    laps = np.interp(time, motion.way.time, motion.way.s - motion.way.s[0]) / lap()
    return WalkScene(settings, walk, body, q, drift, seen, laps)


def simulate_walk(
    folder: Path | str, seed: int, settings: WalkSettings | None = None, replace: bool = False
) -> WalkScene:
    """Write a complete walk folder; returns what was written, with what the files do not say.

    Raises
    ------
    InputError
        If the folder is not empty and may not be replaced, or the recorded motion cannot be read.
    """
    scene = make_walk(seed, settings)
    write_walk(folder, scene.walk, replace)
    return scene


def _person(rng: np.random.Generator, settings: WalkSettings) -> tuple[Body, Sizes]:
    """A body, and its lengths as a tape measured them."""
    average = sizes_of(settings.height)
    names = [field.name for field in fields(Sizes)]
    true = {
        name: getattr(average, name) * (1.0 + settings.proportions * float(np.clip(value, -2.5, 2.5)))
        for name, value in zip(names, rng.standard_normal(len(names)), strict=True)
    }
    sizes = replace(average, **true)
    tape = (settings.measured or 0.0) * rng.standard_normal(len(names))
    told = {name: max(true[name] + float(error), 0.2 * true[name]) for name, error in zip(names, tape, strict=True)}
    return body_of(settings.height, sizes), replace(average, **told)


def _motion(rng: np.random.Generator, body: Body, visible: Float[np.ndarray, " v"], settings: WalkSettings) -> _Motion:
    """Walk, stand, and move the hands."""
    ahead = np.abs((visible[:, None] + IN_VIEW * settings.speed - visible) % lap()).min(axis=1) < 0.1
    start = float(rng.choice(visible[ahead] if ahead.any() else visible))
    way = way_of(rng, settings.seconds, RATE, settings.speed, start, _stops(rng, visible, start, settings))
    swing, poses = gait(way.s / STRIDE, way.pace), fixed_poses(way.time.size)
    if settings.motion is not None:
        recorded = read_motion(settings.motion, body)
        stride = stride_of(recorded, body.sizes.thigh + body.sizes.shank)
        if stride is None:
            poses = recorded_poses(recorded, way.time)
        else:
            still = gait(np.zeros(1), np.zeros(1))
            swing = still + way.pace[:, None] * (looped(stride, way.s / STRIDE) - still)
    gestures = gestures_of(rng, way, settings.gestures, standing_times(way))
    theta = with_gestures(swing[:, 3:], way.time, gestures, poses)
    q = walking(rng, body, way, swing, theta)
    loose = settings.looseness * smooth_noise(rng, way.time.size, LOOSE * RATE, 39)
    loose[:, :3] = 0.0  # the pelvis is where it is
    return _Motion(way, q, loose)


def _stops(
    rng: np.random.Generator, visible: Float[np.ndarray, " v"], start: float, settings: WalkSettings
) -> Float[np.ndarray, "n 2"]:
    """Arc lengths in view at which to stand, and for how long."""
    wanted = rng.poisson(settings.stops * settings.seconds / 60.0)
    s = start + settings.speed * (5.0 + np.sort(rng.uniform(0.0, max(settings.seconds - 10.0, 0.0), wanted)))
    laps = np.floor(s / lap())
    near = visible[np.abs(visible[None, :] - (s - laps * lap())[:, None]).argmin(axis=1)] + laps * lap()
    kept: list[float] = []
    for value in near.tolist():
        if value - start > 3.0 * settings.speed and (not kept or value - kept[-1] > BETWEEN * settings.speed):
            kept.append(value)
    return np.column_stack([np.array(kept), rng.uniform(*STAND, len(kept))])


def _true_body(
    body: Body, q: Float[np.ndarray, "n 26"], loose: Float[np.ndarray, "n 13 3 3"]
) -> tuple[Float[np.ndarray, "n 13 3 3"], Float[np.ndarray, "n 16 3"]]:
    """True world_R_segment and keypoints: every segment turns a little more than its joints say."""
    T = segment_frames(body, q)
    R = np.empty_like(T[..., :3, :3])
    for i, above in enumerate(body.whole.parent):
        own = T[:, i, :3, :3] if above < 0 else np.swapaxes(T[:, above, :3, :3], -1, -2) @ T[:, i, :3, :3]
        R[:, i] = own @ loose[:, i] if above < 0 else R[:, above] @ own @ loose[:, i]
    frames = np.zeros_like(T)
    frames[..., :3, :3], frames[..., 3, 3] = R, 1.0
    frames[..., :3, 3] = frames_along(body.whole.parent, body.whole.offset, q[:, :3], R)
    return R, points_on(frames, body.keypoint_segment, body.keypoint_local)
