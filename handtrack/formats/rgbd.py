"""A folder with `scene.yaml` (`format: handtrack/rgbd-1`) in, an RGB-D scene of a person out; and back.

Depth images are 16-bit millimetres, 0 where there is no reading. Everything is in camera axes, so the camera has
R = I and t = 0. Images are decoded as they are asked for; their headers are all looked at first.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
from jaxtyping import Float32
from PIL import Image
from pydantic import Field

from ..camera import Camera
from ..errors import InputError
from .cameras import PerspectiveFile, camera_from_file, cameras_text
from .images import matching_paths, read_header
from .paths import inside
from .skeletons import Detections, TruthPoints, read_skeletons, read_truth, skeletons_text, truth_text
from .writing import folder_written_whole
from .yaml_files import Document, Strict, at, read_yaml, validate

NAME = "scene.yaml"
FORMAT = "handtrack/rgbd-1"
HIGHEST_FPS = 1e5
MILLIMETRES = 1000.0  # in a metre
MOST_MILLIMETRES = 65535


@dataclass(frozen=True, slots=True, eq=False)
class RgbdScene:
    """Everything that tracking a person in an RGB-D scene needs.

    Attributes
    ----------
    path : Path
        The scene file.
    fps : float
        Frames per second.
    camera : Camera
        Perspective, R = I and t = 0.
    depth : tuple of Path
        One image for each frame; see `read_depth`.
    detections : Detections
        As many times as depth images.
    environment : Path or None
        Mesh of the room in metres, camera axes.
    truth : TruthPoints or None
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    path: Path
    fps: float
    camera: Camera
    depth: tuple[Path, ...]
    detections: Detections
    environment: Path | None
    truth: TruthPoints | None
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.depth)


class _SceneFile(Strict):
    format: Literal["handtrack/rgbd-1"]
    fps: Annotated[float, Field(gt=0, le=HIGHEST_FPS)]
    camera: Annotated[PerspectiveFile, Field()]
    depth: str
    skeleton: str
    environment: str | None = None
    truth: str | None = None


def read_rgbd(folder: Path | str) -> RgbdScene:
    """Open a scene folder, or its `scene.yaml`.

    Raises
    ------
    InputError
        In one line with file, place and what was wanted: for a scene file that is not one, a camera that is not at the
        origin, depth that is not 16-bit or has another size than the camera, and malformed tables.
    """
    path = Path(folder)
    path = path / NAME if path.is_dir() else path
    document = read_yaml(path)
    entry = validate(document, _SceneFile)
    camera = _at_origin(camera_from_file(entry.camera, document, ("camera",)), document)
    notes: list[str] = []
    depth, said = matching_paths(path.parent, entry.depth, at(document, ("depth",)))
    notes += said
    for image in depth:
        _check_header(image, camera)
    skeleton = _file(document, "skeleton", entry.skeleton, notes)
    detections = read_skeletons(skeleton, len(depth), entry.fps)
    notes += detections.warnings
    environment = None if entry.environment is None else _file(document, "environment", entry.environment, notes)
    truth = None
    if entry.truth is not None:
        truth = read_truth(_file(document, "truth", entry.truth, notes), len(depth))
        notes += truth.warnings
    return RgbdScene(path, entry.fps, camera, depth, detections, environment, truth, tuple(notes))


def _at_origin(camera: Camera, document: Document) -> Camera:
    for name, value, wanted in (("R", camera.R, np.eye(3)), ("t", camera.t, np.zeros(3))):
        if not np.array_equal(value, wanted):
            text = "the identity" if name == "R" else "zero"
            raise InputError(f"{at(document, ('camera', name))} is not {text}; a scene is given in camera axes")
    return camera


def _file(document: Document, key: str, text: str, notes: list[str]) -> Path:
    """A file that the scene names, which must be there; a link that leads out of the folder is noted."""
    place = at(document, (key,))
    path, said = inside(document.path.parent, text, place)
    if not path.is_file():
        raise InputError(f"{place} {text!r} is no file in {document.path.parent}; a file is wanted")
    notes += said
    return path


def _check_header(path: Path, camera: Camera) -> None:
    header = read_header(path)
    if not header.deep or header.alpha:
        raise InputError(f"{path}: is not 16-bit grey; 16-bit depth in millimetres is wanted")
    if (header.width, header.height) != (camera.width, camera.height):
        raise InputError(
            f"{path}: is {header.width} x {header.height} pixels; {camera.width} x {camera.height}, the camera's size, "
            "is wanted"
        )


def read_depth(scene: RgbdScene, frame: int) -> Float32[np.ndarray, "h w"]:
    """Depth of one frame, metres; 0 where there is no reading.

    Raises
    ------
    InputError
        If the image is broken, not 16-bit grey, or has changed its size since the scene was opened.
    """
    path = scene.depth[frame]
    _check_header(path, scene.camera)
    try:
        with Image.open(path) as image:
            values = np.asarray(image)
    except Exception as error:  # Pillow's readers raise many kinds for broken files
        raise InputError(f"{path}: is broken ({' '.join(str(error).split())}); a complete image is wanted") from error
    if values.ndim != 2 or values.dtype.itemsize < 2:
        raise InputError(f"{path}: is not 16-bit grey; 16-bit depth in millimetres is wanted")
    return values.astype(np.float32) / np.float32(MILLIMETRES)


def write_rgbd(
    folder: Path | str,
    fps: float,
    camera: Camera,
    depths: Iterable[Float32[np.ndarray, "h w"]],
    detections: Detections,
    environment: bytes | None = None,
    truth: TruthPoints | None = None,
    more: Sequence[tuple[str, bytes]] = (),
    replace: bool = False,
) -> None:
    """Write a scene folder, whole or not at all.

    Parameters
    ----------
    depths : iterable of (h, w)
        Metres, one for each of `detections.time`; rounded to millimetres, 0 where there is no reading.
    environment : bytes or None
        Content of `room.ply`.
    more : sequence of (name, content)
        Further files beside them.
    replace : bool
        Whether a folder that is already there gives way.

    Raises
    ------
    InputError
        If `folder` is a file, or not empty and `replace` is false.
    ValueError
        If the depth images are not as many, or not of the size, that the camera and the detections say.
    """
    with folder_written_whole(Path(folder), replace) as partial:
        (partial / "depth").mkdir()
        count = 0
        for count, depth in enumerate(depths, 1):
            (partial / "depth" / f"{count - 1:06d}.png").write_bytes(_png(depth, camera))
        if count != detections.time.size:
            raise ValueError(f"depths: {count} images; wanted {detections.time.size}, one for each frame")
        (partial / "skeletons.csv").write_text(skeletons_text(detections, with_state=True), encoding="utf-8")
        keys = [f"format: {FORMAT}\n", f"fps: {float(fps)}\n", cameras_text([camera]), "depth: depth/*.png\n"]
        keys.append("skeleton: skeletons.csv\n")
        if environment is not None:
            (partial / "room.ply").write_bytes(environment)
            keys.append("environment: room.ply\n")
        if truth is not None:
            (partial / "truth.csv").write_text(truth_text(truth), encoding="utf-8")
            keys.append("truth: truth.csv\n")
        for name, content in more:
            (partial / name).write_bytes(content)
        (partial / NAME).write_text("".join(keys), encoding="utf-8")


def _png(depth: Float32[np.ndarray, "h w"], camera: Camera) -> bytes:
    if depth.shape != (camera.height, camera.width):
        raise ValueError(f"depths: {depth.shape} given; wanted {(camera.height, camera.width)}, the camera's size")
    values = np.rint(np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0) * MILLIMETRES)
    values = np.where((values >= 0) & (values <= MOST_MILLIMETRES), values, 0).astype(np.uint16)
    return cv2.imencode(".png", values, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
