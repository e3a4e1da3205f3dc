"""The name of a scene in, the scene and its sequence folder out: the work of `handtrack render`."""

from pathlib import Path

import cv2
import numpy as np

from synth.scenes import Scene, images, two_finger_crossing, two_finger_hard

from ..formats import write_bytes, write_model, write_text
from ..sequences import NAME, Truth
from .console import Done
from .record import whole_folder
from .texts import sequence_text, truth_text


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


def build(name: str, model: str | None, seed: int, frames: int) -> Scene:
    """The scene of that name."""
    return two_finger_hard(seed, frames=frames) if name == "two-finger-hard" else two_finger_crossing(seed, frames=frames)
