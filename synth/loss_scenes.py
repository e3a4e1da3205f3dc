"""A seed and a kind in, a scene in which a tracker is made to lose a finger out.

Two look-alike fingers cross now and then, always partly in view (`synth.occlusion_scenes.crossing`); then

- `none`: nothing happens;
- `cut`: for some frames the pictures are those of another pose, as after a bad cut;
- `jump`: one finger, or both, is elsewhere from one frame to the next, and goes on from there;
- `covered`: the camera is covered for some frames, and the hand moves on;
- `forced`: the pictures are as they were, but the tracker is told a wrong pose: one finger far off, or both exchanged.

The truth is what the pictures show; under a covered camera, where the hand is.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from handtrack.kinematics import Model

from .motion import inside_limits
from .occlusion_scenes import look_alike, one_grey
from .scene import Scene
from .scenes import two_finger_crossing
from .scripted import seen_by_camera
from .sensor import sense

Kind = Literal["none", "cut", "jump", "covered", "forced"]
KINDS: tuple[Kind, ...] = ("none", "cut", "jump", "covered", "forced")
FRAMES = 60

_LEAST, _MOST = 25.0, 40.0  # degrees by which a finger is displaced
_DARK = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Loss:
    """A scene with an injected loss.

    Attributes
    ----------
    scene : Scene
        Its truth is what the pictures show.
    at, until : int
        First frame of the injection, and first one after it; both the number of frames for `none`.
    struck : (f,)
        Fingers of the model that it strikes.
    dark : bool
        Whether the camera sees nothing in these frames.
    forced : (j,) or None
        Pose that the tracker is made to believe right before frame `at`.
    """

    scene: Scene
    kind: Kind
    at: int
    until: int
    struck: Bool[np.ndarray, " f"]
    dark: bool = False
    forced: Float[np.ndarray, " j"] | None = None


def loss_scene(kind: Kind, seed: int, frames: int = FRAMES, noise: float = 2.0) -> Loss:
    """The scene of that kind.

    Raises
    ------
    ValueError
        For an unknown kind, or fewer than 40 frames.

    >>> loss = loss_scene("jump", 1)
    >>> 15 <= loss.at < loss.until, bool(loss.struck.any())
    (True, True)
    """
    if kind not in KINDS:
        raise ValueError(f"kind: '{kind}' is unknown; there are {', '.join(KINDS)}")
    if frames < 40:
        raise ValueError(f"frames: {frames}; wanted at least 40")
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    model = look_alike()
    plain = two_finger_crossing(seed, frames=frames, noise=noise, max_speed=2.5)
    scene = replace(plain, name=f"loss-{kind}", model=model, material=one_grey(model))
    at = int(rng.integers(15, 22))
    if kind == "none":
        return Loss(scene, kind, frames, frames, np.zeros(2, dtype=bool))
    if kind == "covered":
        return Loss(scene, kind, at, at + int(rng.integers(8, 13)), np.ones(2, dtype=bool), dark=True)
    struck = np.ones(2, dtype=bool) if rng.random() < 0.4 else np.arange(2) == rng.integers(2)
    if kind == "forced":
        return _forced(scene, at, struck, rng)
    until = frames if kind == "jump" else at + int(rng.integers(8, 13))
    truth = scene.truth.copy()
    truth[at:until] = _displaced(model, truth[at:until], struck, rng)
    return Loss(replace(scene, truth=truth), kind, at, until, struck)


def _forced(scene: Scene, at: int, struck: Bool[np.ndarray, " 2"], rng: np.random.Generator) -> Loss:
    """The tracker is told a pose with one finger displaced, or with both fingers exchanged."""
    before = scene.truth[at - 1]
    exchanged = np.concatenate([before[3:], before[:3]])
    if struck.all() and np.abs(exchanged - before).max() > np.radians(_LEAST):
        return Loss(scene, "forced", at, at + 1, struck, forced=exchanged)
    return Loss(scene, "forced", at, at + 1, struck, forced=_displaced(scene.model, before[None], struck, rng)[0])


def _displaced(
    model: Model, q: Float[np.ndarray, "n 6"], struck: Bool[np.ndarray, " 2"], rng: np.random.Generator
) -> Float[np.ndarray, "n 6"]:
    """Poses with some fingers turned at the knuckle, upwards or downwards where there is more room, and bent anew."""
    off = q.copy()
    for finger in np.flatnonzero(struck):
        mcp = 3 * finger
        turn = np.radians(rng.uniform(_LEAST, _MOST))
        off[:, mcp] += turn if q[:, mcp].mean() < 0.0 else -turn
        off[:, mcp + 1] += np.radians(rng.uniform(-5.0, 20.0))
    return inside_limits(model, off)


def loss_picture(loss: Loss, frame: int) -> Float[np.ndarray, "h w"]:
    """The image of a frame as a camera delivers it."""
    scene = loss.scene
    if loss.dark and loss.at <= frame < loss.until:
        dark = np.full((scene.camera.height, scene.camera.width), _DARK, dtype=np.float32)
        return sense(dark, scene.sensor, np.random.default_rng([scene.seed, frame]))
    return seen_by_camera(scene, frame)


def loss_pictures(loss: Loss) -> Iterator[Float[np.ndarray, "h w"]]:
    """The images of all frames."""
    for frame in range(loss.scene.truth.shape[0]):
        yield loss_picture(loss, frame)
