"""The name of a scene in, the scene and its sequence folder out: the work of `handtrack render`."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from synth.motion import keys_needed, random_keys, walk
from synth.scenes import Scene, images, skin, two_finger_crossing, two_finger_hard, view
from synth.shading import Mode

from ..camera import Camera
from ..errors import InputError
from ..evaluate import landmarks
from ..formats import write_bytes, write_model, write_text
from ..formats.images import read_image
from ..kinematics import Model
from ..sequences import NAME, Truth, find_model
from .console import Done
from .record import whole_folder
from .texts import sequence_text, truth_text

SIZE = (640, 480)
_FILLED = 0.7  # share of the image that a free motion spreads over
_SWING = 25.0  # degrees: what neighbouring random key poses surely differ by in some joint, for the number of keys
_SPEED = 3.0  # degrees a frame


def build(name: str, model: str | None, seed: int, frames: int) -> Scene:
    """The scene of that name; `random` moves any model within its limits."""
    if (name == "random") != (model is not None):
        raise InputError("--model: goes with `--scene random`, which needs it")
    if name == "two-finger-hard":
        return two_finger_hard(seed, frames=frames)
    if model is None:
        return two_finger_crossing(seed, frames=frames)
    return random_scene(find_model(model), seed, frames)


def random_scene(model: Model, seed: int, frames: int) -> Scene:
    """A model that moves at random within its limits, seen from where it spreads most."""
    rng = np.random.default_rng(seed)
    with np.errstate(invalid="ignore"):  # the middle of a joint without limits is inf - inf, and set to zero then
        keys = random_keys(model, rng, keys_needed(frames, _SPEED, _SWING))
    truth = walk(keys, frames, _SPEED)
    return Scene("random", seed, model, facing(model, truth), truth, truth[0].copy(), skin(model))


def facing(model: Model, q: Float[np.ndarray, "n j"]) -> Camera:
    """Orthographic camera that holds a whole motion: image axes along the two directions in which it spreads most."""
    points = landmarks(model, q).reshape(-1, 3)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=True)
    R = np.array([axes[0], axes[1], np.cross(axes[0], axes[1])])
    reach = np.abs((points - middle) @ R[:2].T).max(axis=0) + model.link_radius.max()
    scale = float((_FILLED * 0.5 * np.array(SIZE) / reach).min())
    return view("orthographic", SIZE, scale, (0.5 * SIZE[0], 0.5 * SIZE[1]), R, middle)


def dressed(
    scene: Scene, noise: float | None, vignette: float | None, background: Path | None, mode: Mode, colour: bool
) -> Scene:
    """The scene with another sensor, background, light or colour, where something is given."""
    sensor = scene.sensor
    if noise is not None:
        sensor = replace(sensor, noise=noise)
    if vignette is not None:
        sensor = replace(sensor, vignette=vignette)
    behind = scene.background
    if background is not None:
        behind = read_image(background)
        wanted = (scene.camera.height, scene.camera.width)
        if behind.shape != wanted:
            raise InputError(
                f"{background}: is {behind.shape[1]} x {behind.shape[0]} pixels; {wanted[1]} x {wanted[0]} was wanted"
            )
    return replace(scene, sensor=sensor, background=behind, mode=mode, colour=colour)


def write_scene(out: Path, scene: Scene, done: Done | None = None) -> None:
    """Write a scene as a sequence folder, whole or not at all; an earlier sequence there is replaced."""
    with whole_folder(out, NAME, "sequence") as folder:
        (folder / "frames").mkdir()
        for number, image in enumerate(images(scene)):
            pixels = np.clip(np.rint(image), 0, 255).astype(np.uint8)
            _, content = cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels)
            write_bytes(folder / "frames" / f"{number:06d}.png", content.tobytes())
            if done is not None:
                done(number + 1)
        write_model(folder / "model.yaml", scene.model)
        truth = Truth(np.arange(scene.truth.shape[0]), scene.truth)
        write_text(folder / "truth.csv", truth_text(truth, scene.model))
        write_text(folder / NAME, sequence_text(scene.fps, scene.camera, scene.model, scene.start))
