"""A scene in, its sequence folder out: pictures, model, camera, start pose and true joint values.

    sequence.yaml    model.yaml    truth.csv    frames/000000.png ...   (or frames.mp4)

The folder appears whole or not at all.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from handtrack.camera import Camera
from handtrack.formats import folder_written_whole, write_bytes, write_model, write_text
from handtrack.formats.poses import code_units
from handtrack.kinematics import Model
from handtrack.report.video import write_video

from .scene import Scene, images

COMPRESSION = (cv2.IMWRITE_PNG_COMPRESSION, 6)


def write_sequence(
    folder: Path | str,
    scene: Scene,
    *,
    video: bool = False,
    replace: bool = False,
    done: Callable[[int], None] | None = None,
) -> None:
    """Write a scene as a sequence folder that `handtrack.sequences.open_sequence` reads.

    Parameters
    ----------
    video : bool
        A video file (lossy) instead of PNG pictures.
    replace : bool
        Whether a folder that is already there gives way.
    done : callable, optional
        Called with the number of frames made so far.

    Raises
    ------
    InputError
        If the folder exists, is not empty and may not be replaced.
    """
    with folder_written_whole(Path(folder), replace) as path:
        fill_sequence(path, scene, video=video, done=done)


def fill_sequence(path: Path, scene: Scene, *, video: bool = False, done: Callable[[int], None] | None = None) -> None:
    """Write the files of a sequence into a folder that is there and empty; see `write_sequence`."""
    if video:
        write_video(path / "frames.mp4", _colour(_pixels(scene, done)), scene.fps)
    else:
        (path / "frames").mkdir()
        for number, pixels in enumerate(_pixels(scene, done)):
            _, content = cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels, COMPRESSION)
            write_bytes(path / "frames" / f"{number:06d}.png", content.tobytes())
    write_model(path / "model.yaml", scene.model)
    write_text(path / "truth.csv", truth_text(scene.model, scene.truth))
    write_text(path / "sequence.yaml", sequence_text(scene, "frames.mp4" if video else "frames/*.png"))


def _pixels(scene: Scene, done: Callable[[int], None] | None) -> Iterator[UInt8[np.ndarray, "h w *c"]]:
    for number, image in enumerate(images(scene)):
        yield np.clip(np.rint(image), 0, 255).astype(np.uint8)
        if done is not None:
            done(number + 1)


def _colour(pictures: Iterator[UInt8[np.ndarray, "h w *c"]]) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    for pixels in pictures:
        yield pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)


def truth_text(model: Model, q: Float[np.ndarray, "m j"]) -> str:
    """Text of `truth.csv`: degrees, or model units where a joint slides.

    >>> from handtrack.kinematics.builtin import model
    >>> print(truth_text(model("rr"), np.array([[0.0, np.pi / 6]])))
    frame,theta1,theta2
    0,0,30
    """
    values = q / code_units(model)
    rows = (f"{n}," + ",".join(_number(x) for x in row) for n, row in enumerate(values.tolist()))
    return "\n".join(["frame," + ",".join(model.joint_names), *rows, ""])


def sequence_text(scene: Scene, frames: str) -> str:
    """Text of `sequence.yaml`; the start pose names the independent joints."""
    model = scene.model
    start = (scene.start / code_units(model)).tolist()
    pose = ", ".join(f"{model.joint_names[joint]}: {_number(start[joint])}" for joint in model.free.tolist())
    return (
        f"format: handtrack/sequence-1\nfps: {scene.fps:g}\nframes: {frames}\n{_camera_text(scene.camera)}"
        f"model: model.yaml\nstart: {{{pose}}}\ntruth: truth.csv\n"
    )


def _camera_text(camera: Camera) -> str:
    scale = [("scale", camera.fx)] if camera.kind == "orthographic" else [("fx", camera.fx), ("fy", camera.fy)]
    numbers = [("width", camera.width), ("height", camera.height), *scale, ("cx", camera.cx), ("cy", camera.cy)]
    numbers += [("R", camera.R.tolist()), ("t", camera.t.tolist())]
    if camera.distortion.any():
        numbers.append(("distortion", camera.distortion.tolist()))
    return f"camera:\n  type: {camera.kind}\n" + "".join(f"  {name}: {json.dumps(value)}\n" for name, value in numbers)


def _number(value: float) -> str:
    """Shortest text to ten digits, without a minus zero."""
    return f"{round(float(value), 10) + 0.0:.10g}"
