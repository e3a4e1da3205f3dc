"""The `camera:` part of a file in, a checked camera out; and back. It is a list where there are several views.

Checked: `R` is a rotation (`R R^T = I` within 1e-6, determinant +1), sizes and scales are positive, and the distortion
does not fold the picture: on the straight way from the principal point to every point of the image border, the area
factor of OpenCV's `k1 k2 p1 p2 k3` (the determinant of its derivative) stays positive.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Discriminator, Field, PositiveFloat, Tag

from ..camera import Camera, distort, orthographic, perspective
from ..errors import InputError
from .yaml_files import Document, Place, Strict, at, read_yaml, validate

ROTATION_TOLERANCE = 1e-6
MOST_VIEWS = 64

_Row3 = Annotated[list[float], Field(min_length=3, max_length=3)]
_Size = Annotated[int, Field(gt=0, le=100_000)]


class _Common(Strict):
    width: _Size
    height: _Size
    cx: float
    cy: float
    R: Annotated[list[_Row3], Field(min_length=3, max_length=3)]
    t: _Row3


class OrthographicFile(_Common):
    """`camera:` with `type: orthographic`."""

    type: Literal["orthographic"]
    scale: PositiveFloat


class PerspectiveFile(_Common):
    """`camera:` with `type: perspective`."""

    type: Literal["perspective"]
    fx: PositiveFloat
    fy: PositiveFloat
    distortion: Annotated[list[float], Field(min_length=5, max_length=5)] | None = None


CameraFile = Annotated[OrthographicFile | PerspectiveFile, Field(discriminator="type")]


OneOrMoreCameras = Annotated[
    Annotated[CameraFile, Tag("one")]
    | Annotated[list[CameraFile], Field(min_length=1, max_length=MOST_VIEWS), Tag("list")],
    Discriminator(lambda value: "list" if isinstance(value, list) else "one"),
]


class _CameraAlone(Strict):
    camera: OneOrMoreCameras
    format: Literal["handtrack/camera-1"] = "handtrack/camera-1"


def read_camera(path: Path | str) -> Camera:
    """The one camera of a file; see `read_cameras`.

    Raises
    ------
    InputError
        For a file that is not such a file, has several cameras, or one that cannot be.
    """
    first, *others = read_cameras(path)
    if others:
        raise InputError(f"{path}: camera: has {1 + len(others)} cameras; one is wanted here")
    return first


def read_cameras(path: Path | str) -> tuple[Camera, ...]:
    """Cameras from a file of their own, `camera: {...}` or `camera: [{...}, ...]`, or from those of a sequence file.

    Raises
    ------
    InputError
        For a file that is not such a file, or a camera that cannot be.
    """
    document = read_yaml(Path(path))
    if isinstance(document.data, dict) and document.data.get("format") == "handtrack/sequence-1":
        only: dict[str, Any] = {"camera": document.data["camera"]} if "camera" in document.data else {}
        document = Document(document.path, only, document.root)
    return cameras_from_file(validate(document, _CameraAlone).camera, document)


def cameras_from_file(
    entry: OrthographicFile | PerspectiveFile | list[OrthographicFile | PerspectiveFile], document: Document
) -> tuple[Camera, ...]:
    """The camera, or cameras, of a validated `camera:` at the top of a document."""
    if isinstance(entry, list):
        return tuple(camera_from_file(one, document, ("camera", number)) for number, one in enumerate(entry))
    return (camera_from_file(entry, document, ("camera",)),)


def camera_from_file(entry: OrthographicFile | PerspectiveFile, document: Document, place: Place) -> Camera:
    """The camera that a validated `camera:` describes; `place` is where it stands in its document."""
    R, t = np.array(entry.R, dtype=float), np.array(entry.t, dtype=float)
    error = float(np.abs(R @ R.T - np.eye(3)).max())
    if not error <= ROTATION_TOLERANCE:
        raise InputError(
            f"{at(document, (*place, 'R'))} is no rotation: R R^T differs from the identity by {error:.2g}; "
            f"at most {ROTATION_TOLERANCE:g} is wanted"
        )
    if np.linalg.det(R) < 0:
        raise InputError(f"{at(document, (*place, 'R'))} is a reflection: its determinant is -1; +1 is wanted")
    if isinstance(entry, OrthographicFile):
        return orthographic(entry.width, entry.height, entry.scale, entry.cx, entry.cy, R, t)
    bend = None if entry.distortion is None else np.array(entry.distortion, dtype=float)
    camera = perspective(entry.width, entry.height, entry.fx, entry.fy, entry.cx, entry.cy, R, t, bend)
    if folds(camera):
        raise InputError(
            f"{at(document, (*place, 'distortion'))} folds inside the image: two directions meet in one pixel; "
            "coefficients that stay one-to-one are wanted"
        )
    return camera


def cameras_text(cameras: Sequence[Camera]) -> str:
    """The `camera:` part of a file: keys for one camera, a list for several; it reads back to the last digit.

    >>> from handtrack.camera import orthographic
    >>> print(cameras_text([orthographic(64, 48, 2.0, 32.0, 24.0, np.eye(3), np.zeros(3))]))
    camera:
      type: orthographic
      width: 64
      height: 48
      scale: 2.0
      cx: 32.0
      cy: 24.0
      R: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
      t: [0.0, 0.0, 0.0]
    <BLANKLINE>
    """
    if len(cameras) == 1:
        return "camera:\n" + "".join(f"  {name}: {value}\n" for name, value in camera_entries(cameras[0]))
    lines = [
        f"  {'  ' if row else '- '}{name}: {value}\n"
        for camera in cameras
        for row, (name, value) in enumerate(camera_entries(camera))
    ]
    return "camera:\n" + "".join(lines)


def camera_entries(camera: Camera) -> tuple[tuple[str, object], ...]:
    """Keys and plain values of a camera, as a file has them."""
    parallel = camera.kind == "orthographic"
    entries: list[tuple[str, object]] = [("type", camera.kind), ("width", camera.width), ("height", camera.height)]
    entries += [("scale", float(camera.fx))] if parallel else [("fx", float(camera.fx)), ("fy", float(camera.fy))]
    entries += [("cx", float(camera.cx)), ("cy", float(camera.cy)), ("R", camera.R.tolist()), ("t", camera.t.tolist())]
    if camera.distortion.any():
        entries.append(("distortion", camera.distortion.tolist()))
    return tuple(entries)


def folds(camera: Camera, steps: int = 64, samples: int = 33) -> bool:
    """Whether the distortion maps two directions to one pixel of the image.

    Every point of the image border is approached from the principal point in `steps` equal steps; at each the inverse
    is followed by Newton's method from the step before. Where the derivative's determinant is not positive, or the
    inverse is lost, the picture has folded.

    >>> folds(perspective(640, 480, 500.0, 500.0, 320.0, 240.0, np.eye(3), np.zeros(3)))
    False
    """
    k = camera.distortion
    if not k.any():
        return False
    u = np.linspace(-0.5, 0.5, samples)
    edge = np.full(samples, 0.5)
    border = np.concatenate([np.stack(xy, axis=-1) for xy in ((u, -edge), (u, edge), (-edge, u), (edge, u))])
    pixels = (border + 0.5) * (camera.width, camera.height) - 0.5
    goal = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    slope = np.zeros_like(goal)
    with np.errstate(over="ignore", invalid="ignore"):
        for part in np.arange(1, steps + 1) / steps:
            for _ in range(4):
                derivative, area = _derivative(slope, k)
                if not (area > 1e-6).all():
                    return True
                error = distort(slope, k) - part * goal
                slope = slope - np.linalg.solve(derivative, error[..., None])[..., 0]
            if not (np.abs(distort(slope, k) - part * goal) < 1e-6).all():
                return True
    return not (_derivative(slope, k)[1] > 1e-6).all()


def _derivative(
    slope: Float[np.ndarray, "n 2"], k: Float[np.ndarray, " 5"], step: float = 1e-6
) -> tuple[Float[np.ndarray, "n 2 2"], Float[np.ndarray, " n"]]:
    """Derivative of `distort` by central differences, and its determinant."""
    along = [(distort(slope + h, k) - distort(slope - h, k)) / (2 * step) for h in step * np.eye(2)]
    derivative = np.stack(along, axis=-1)
    return derivative, np.linalg.det(derivative)
