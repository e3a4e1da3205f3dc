"""A seed and a length in, a scene in which a finger is hidden and comes back out.

- `hidden`: of two fingers that look alike (same lengths, radii, grey) the nearer moves before the farther, hides every
  pixel of it for so many frames, and leaves on either side; meanwhile the farther keeps still, goes on or comes back;
- `hand`: the same with index and middle finger of a whole hand (21 joints), seen from the thumb's side;
- `board`: a board rises before one of two look-alike fingers, stays and sinks;
- `crossing`: the crossing fingers of section 6.1 of the hand thesis, but alike; hidden in part, again and again.

A finger is hidden by one that is no thicker only because the nearer one looks larger by the ratio p of their depths.
Its axis y(x) = sum_i phi_i max(x - p a_i, 0), with its joints at a_i and small bends phi, has to follow that of the
farther one, sum_i theta_i max(x - b_i, 0): phi = M theta by least squares, and ray casting says whether it is enough.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from handtrack.camera import Camera, camera_from_world, project_camera
from handtrack.kinematics import FrameRow, Model, forward, link_ends, model_from_rows
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.outlines import rims
from handtrack.pills import pose_pills

from .motion import inside_limits, key_times_path
from .scene import Scene, view
from .scenes import two_finger_crossing
from .scripted import HIDDEN, Board, Scripted, finger_joints, finger_names, shares
from .sensor import Sensor
from .shading import Material

Motion = Literal["still", "on", "back"]
MOTIONS: tuple[Motion, ...] = ("still", "on", "back")
NAMES = ("hidden", "hand", "board", "crossing")

_GREY = np.array([230.0, 204.0, 192.0])
_SIDE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])  # along the knuckles; fingers to the right
_DISTANCE, _SCALE = 145.0, 2.4  # of the camera from the knuckles, mm; pixels for each mm there
_TAIL = 24  # frames after the occlusion
_APART, _SLIVER = 26.0, 2.6  # degrees between the fingers before and after, and next to the frames of the occlusion
_PARTLY = 0.6  # share below which a crossing finger counts as hidden
_NEARLY = 0.05  # and below which one in a whole hand does, whose other fingers may show a little of it
_RISE = 6  # frames in which the board comes up


def look_alike() -> Model:
    """Two fingers side by side, 11 mm to each side of {0}, as in Table 6.1, but both with the lengths of the index."""
    index = builtin_model("index")
    lengths = np.linalg.norm(index.link_tip - index.link_base, axis=1)
    rows, reach = [], 70.7
    for first, across, finger in ((1, -11.0, "middle"), (6, 11.0, "index")):
        rows += [
            FrameRow(first, 0, math.pi, across, 0.0, -0.5 * math.pi),
            FrameRow(first + 1, first, 0.0, reach, 0.0, 0.0),
        ]
        parent, alpha, a = first + 1, -0.5 * math.pi, 0.0
        for i, part in enumerate(("mcp", "pip", "dip")):
            low, high = index.limits[i].tolist()
            radius = (float(index.link_radius[i, 0]), float(index.link_radius[i, 1]))
            rows.append(
                FrameRow(
                    first + 2 + i,
                    parent,
                    alpha,
                    a,
                    0.0,
                    0.0,
                    joint=f"{finger}_{part}",
                    limits=(low, high),
                    link_length=float(lengths[i]),
                    link_radius=radius,
                )
            )
            parent, alpha, a = first + 2 + i, 0.0, float(lengths[i])
    return model_from_rows("look_alike", rows)


def one_grey(model: Model) -> Material:
    """Skin that is the same on every finger."""
    return Material(np.tile(_GREY, (model.link_finger.size, 1)))


def hidden(seed: int, *, frames: int = 20, motion: Motion | None = None, noise: float = 2.0) -> Scripted:
    """The index finger hides the middle finger, which looks alike, for `frames` frames.

    Parameters
    ----------
    seed : int
        Decides all that is not given: sides, speeds, bends, what the hidden finger does.
    frames : int
        How long every pixel of it is hidden.
    motion : 'still', 'on' or 'back', optional
        What the hidden finger does meanwhile: keep still, go on as it came, or turn round.
    """
    return _behind("hidden", seed, look_alike(), frames, motion, noise)


def hand(seed: int, *, frames: int = 20, motion: Motion | None = None, noise: float = 2.0) -> Scripted:
    """The same with a whole hand, whose other fingers stand by; parameters as in `hidden`."""
    return _behind("hand", seed, builtin_model("full_hand"), frames, motion, noise)


def _behind(kind: str, seed: int, model: Model, frames: int, motion: Motion | None, noise: float) -> Scripted:
    _check(frames)
    whole = kind == "hand"
    rng = np.random.default_rng([seed, frames, NAMES.index(kind)])
    chosen = motion or MOTIONS[int(rng.integers(3))]
    lead, sides = int(rng.integers(12, 16)), rng.choice([-1.0, 1.0], 2)
    base = _base(rng, chosen, lead, frames) + (18.0 if whole else 0.0)
    apart = _separation(lead, frames, _APART * sides * rng.uniform(0.85, 1.0, 2))
    bends = key_times_path(
        rng.uniform([2.0, 1.0], [8.0, 5.0], (5, 2)), np.linspace(0.0, base.size - 1.0, 5), np.arange(float(base.size))
    )
    others = np.array([[8.0, 6.0], [4.0, 3.0]]) * rng.uniform(0.5, 1.0, (2, 2))
    knuckles = link_ends(model, forward(model, np.zeros(len(model.joint_names))))[0][_roots(model)]
    focus = (0.45 * 640, 0.62 * 480) if whole else (0.2 * 640, 0.5 * 480)
    camera = view("perspective", (640, 480), _SCALE, focus, _SIDE, knuckles.mean(axis=0), _SCALE * _DISTANCE)
    M = _cover(model, camera)
    hide = slice(lead, lead + frames)
    for _ in range(8):
        far = np.column_stack([base, bends])
        near = far @ M.T
        near[:, 0] += apart
        near[:, 1:] += np.abs(apart)[:, None] / _APART * others[0]
        truth = inside_limits(model, _poses(model, far, near, others[1]))
        scene = Scene(kind, seed, model, camera, truth, truth[0].copy(), one_grey(model), sensor=Sensor(noise))
        links, fingers = shares(scene)
        share = fingers[:, finger_names(model).index("middle")]
        if (share[hide] < (_NEARLY if whole else HIDDEN)).all():
            return Scripted(scene, kind, "middle", links, fingers, share < (_NEARLY if whole else HIDDEN))
        bends = 0.7 * bends  # the straighter they are, the better one hides the other
    raise ValueError(f"seed: {seed} gives no motion that hides the finger for {frames} frames")


def _roots(model: Model) -> Int[np.ndarray, " 2"]:
    """First links of the middle and the index finger."""
    names = finger_names(model)
    return np.array([np.flatnonzero(model.link_finger == names.index(name))[0] for name in ("middle", "index")])


def _base(rng: np.random.Generator, motion: Motion, lead: int, frames: int) -> Float[np.ndarray, " m"]:
    """Direction of the hidden finger in every frame, degrees: it comes with a speed, then does what it does."""
    speed = rng.choice([-1.0, 1.0]) * min(rng.uniform(0.5, 1.3), 26.0 / frames)
    within = np.arange(1.0, frames + 1)
    kept = {
        "still": np.maximum(1.0 - within / 3.0, 0.0),
        "on": np.ones(frames),
        "back": np.maximum(1.0 - within / min(4.0, frames / 3.0), -1.0),
    }[motion]
    after = kept[-1] * np.maximum(1.0 - np.arange(1.0, _TAIL + 1) / 10.0, 0.0)
    velocity = speed * np.concatenate([np.linspace(0.0, 1.0, lead), kept, after])
    base = np.cumsum(velocity)
    return base - 0.5 * (base.min() + base.max()) + rng.uniform(-4.0, 4.0)


def _separation(lead: int, frames: int, ends: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " m"]:
    """Angle from the hidden finger to the hiding one, degrees: to zero at an even speed, and away on either side."""
    share = np.linspace(_SLIVER / _APART, 1.0, lead)
    away = np.append(share, np.ones(_TAIL))[:_TAIL]
    return np.concatenate([ends[0] * share[::-1], np.zeros(frames), ends[1] * away])


def _cover(model: Model, camera: Camera) -> Float[np.ndarray, "3 3"]:
    """The matrix M: bends of the index finger whose image follows that of the middle finger."""
    base, tip = link_ends(model, forward(model, np.zeros(len(model.joint_names))))
    depth = camera_from_world(camera, base[_roots(model)])[:, 2]
    starts = []
    for root, scale in zip(_roots(model), (1.0, depth[0] / depth[1]), strict=True):
        length = np.linalg.norm(tip - base, axis=1)[root : root + 3]
        starts.append(scale * np.concatenate([[0.0], np.cumsum(length[:2])]))
    x = np.linspace(0.0, starts[0][2] + 20.0, 60)[:, None]
    theirs, ours = (np.maximum(x - start, 0.0) for start in starts)
    return np.linalg.lstsq(ours, theirs, rcond=None)[0]


def _poses(
    model: Model, far: Float[np.ndarray, "m 3"], near: Float[np.ndarray, "m 3"], rest: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, "m j"]:
    """Poses in radians from degrees of the two fingers; other fingers of a hand stretch away below, the thumb rests."""
    q = np.zeros((far.shape[0], len(model.joint_names)))
    standing = {"ring": (-22.0, *rest), "little": (-38.0, *rest[::-1])}
    for finger, pose in (("middle", far), ("index", near), *standing.items()):
        joints = [i for i in finger_joints(model, finger) if not model.joint_names[i].endswith("abduction")]
        if joints:
            q[:, joints] = pose
    return np.radians(q)


def board(seed: int, *, frames: int = 20, motion: Motion | None = None, noise: float = 2.0) -> Scripted:
    """A board rises before the lower of two look-alike fingers, and stays for `frames` frames; as in `hidden`."""
    _check(frames)
    rng = np.random.default_rng([seed, frames, NAMES.index("board")])
    lead, model = int(rng.integers(12, 16)), look_alike()
    plain = two_finger_crossing(seed, frames=2, noise=noise)
    names = finger_names(model)
    knuckle = project_camera(plain.camera, _knuckles(model, plain.camera))
    lower = names[int(np.argmax(knuckle[:, 1]))]
    chosen = motion or MOTIONS[int(rng.integers(3))]
    base = _base(rng, chosen, lead, frames) * 0.6
    count = base.size
    steps, every = np.linspace(0.0, count - 1.0, 5), np.arange(float(count))
    down, up = (
        key_times_path(rng.uniform(low, high, (5, 3)), steps, every)
        for low, high in (([-3.0, 4.0, 3.0], [3.0, 14.0, 10.0]), ([18.0, 6.0, 4.0], [30.0, 18.0, 12.0]))
    )
    down[:, 0] += base - 18.0
    truth = np.zeros((count, 6))
    for finger in names:
        truth[:, finger_joints(model, finger)] = np.radians(down if finger == lower else up)
    truth = inside_limits(model, truth)
    scene = Scene("board", seed, model, plain.camera, truth, truth[0].copy(), one_grey(model), sensor=Sensor(noise))
    shown = _board(scene, names.index(lower), lead, frames)
    links, fingers = shares(scene, shown)
    return Scripted(scene, "board", lower, links, fingers, fingers[:, names.index(lower)] < HIDDEN, shown)


def _knuckles(model: Model, camera: Camera) -> Float[np.ndarray, "2 3"]:
    base = link_ends(model, forward(model, np.zeros(len(model.joint_names))))[0]
    return camera_from_world(camera, base[_roots(model)])


def _board(scene: Scene, finger: int, lead: int, frames: int) -> Board:
    """A board from below, its edge a little turned, that covers a finger in `frames` frames wholly."""
    count, mine = scene.truth.shape[0], scene.model.link_finger == finger
    normal = np.array([0.0, -1.0])
    outline = [
        project_camera(scene.camera, rims(pose_pills(scene.model, forward(scene.model, q), scene.camera), scene.camera))
        for q in scene.truth
    ]
    tops = np.array([(xy[mine] @ normal).max() for xy in outline])
    top = tops[lead : lead + frames].max() + 2.0
    bottom = np.array([(xy[mine] @ normal).min() for xy in outline]).min() - 5.0
    number = np.arange(float(count))
    up = np.clip((number - (lead - _RISE)) / _RISE, 0.0, 1.0)
    down = np.clip((lead + frames - 1 + _RISE - number) / _RISE, 0.0, 1.0)
    return Board(normal, bottom + np.minimum(up, down) * (top - bottom))


def crossing(seed: int, *, frames: int = 60, motion: Motion | None = None, noise: float = 2.0) -> Scripted:
    """The index finger crosses in front of the middle finger, which looks alike; `motion` has no say here."""
    _check(frames)
    plain = two_finger_crossing(seed, frames=frames, noise=noise)
    model = look_alike()
    scene = replace(plain, name="crossing", model=model, material=one_grey(model))
    links, fingers = shares(scene)
    return Scripted(scene, "crossing", "middle", links, fingers, fingers[:, 0] < _PARTLY)


def occlusion_scene(name: str, seed: int, frames: int, motion: Motion | None = None) -> Scripted:
    """The scene of that name, hidden for so many frames (`crossing`: so many frames long).

    Raises
    ------
    ValueError
        For an unknown name, or a number of frames below 1 or above 60.

    >>> scene = occlusion_scene("hidden", 1, 10)
    >>> int(scene.hidden.sum()) >= 10
    True
    """
    makers: tuple[Callable[..., Scripted], ...] = (hidden, hand, board, crossing)
    if name not in NAMES:
        raise ValueError(f"name: '{name}' is no scene; there are {', '.join(NAMES)}")
    return makers[NAMES.index(name)](seed, frames=frames, motion=motion)


def _check(frames: int) -> None:
    if not 1 <= frames <= 60:
        raise ValueError(f"frames: {frames}; wanted 1 to 60")
