"""A scene in, its sequence folder out: pictures, model, cameras, start pose and true joint values.

    sequence.yaml    model.yaml    truth.csv    frames/000000.png ...   (or frames.mp4)
    several views:                              view0/000000.png ... view1/000000.png ...   (or view0.mp4 ...)

The folder appears whole or not at all.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from handtrack.formats import folder_written_whole, write_bytes, write_model, write_text
from handtrack.formats.cameras import cameras_text
from handtrack.formats.poses import code_units
from handtrack.kinematics import Model
from handtrack.report.video import write_video

from .scene import Scene, image

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
        Called with the number of images made so far, those of all views.

    Raises
    ------
    InputError
        If the folder exists, is not empty and may not be replaced.
    """
    with folder_written_whole(Path(folder), replace) as path:
        fill_sequence(path, scene, video=video, done=done)


def fill_sequence(path: Path, scene: Scene, *, video: bool = False, done: Callable[[int], None] | None = None) -> None:
    """Write the files of a sequence into a folder that is there and empty; see `write_sequence`."""
    names = [f"view{view}" for view in range(len(scene.cameras))] if scene.more_cameras else ["frames"]
    for view, name in enumerate(names):
        if video:
            write_video(path / f"{name}.mp4", _colour(_pixels(scene, view, done)), scene.fps)
            continue
        (path / name).mkdir()
        for number, pixels in enumerate(_pixels(scene, view, done)):
            _, content = cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels, COMPRESSION)
            write_bytes(path / name / f"{number:06d}.png", content.tobytes())
    write_model(path / "model.yaml", scene.model)
    write_text(path / "truth.csv", truth_text(scene.model, scene.truth))
    write_text(path / "sequence.yaml", sequence_text(scene, [name + (".mp4" if video else "/*.png") for name in names]))


def _pixels(scene: Scene, view: int, done: Callable[[int], None] | None) -> Iterator[UInt8[np.ndarray, "h w *c"]]:
    count = scene.truth.shape[0]
    for number in range(count):
        yield np.clip(np.rint(image(scene, number, view)), 0, 255).astype(np.uint8)
        if done is not None:
            done(view * count + number + 1)


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


def sequence_text(scene: Scene, frames: Sequence[str]) -> str:
    """Text of `sequence.yaml`, with a pattern for each view; the start pose names the independent joints."""
    model = scene.model
    start = (scene.start / code_units(model)).tolist()
    pose = ", ".join(f"{model.joint_names[joint]}: {_number(start[joint])}" for joint in model.free.tolist())
    patterns = frames[0] if len(frames) == 1 else f"[{', '.join(frames)}]"
    return (
        f"format: handtrack/sequence-1\nfps: {scene.fps:g}\nframes: {patterns}\n{cameras_text(scene.cameras)}"
        f"model: model.yaml\nstart: {{{pose}}}\ntruth: truth.csv\n"
    )


def _number(value: float) -> str:
    """Shortest text to ten digits, without a minus zero."""
    return f"{round(float(value), 10) + 0.0:.10g}"
