"""A calibration of several cameras as Pose2Sim and anipose write it (.toml) in, cameras out; metres.

[cam_01]
size = [1088.0, 1920.0]
matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
distortions = [k1, k2, p1, p2]          # or with k3
rotation = [rx, ry, rz]                 # a rotation vector, from the world to the camera
translation = [x, y, z]
"""

import tomllib
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, RootModel, ValidationError
from scipy.spatial.transform import Rotation

from ..camera import Camera, perspective
from ..errors import InputError
from .json_files import Loose
from .paths import read_bytes

MOST_BYTES = 1_000_000
_Row3 = Annotated[list[float], Field(min_length=3, max_length=3)]


class _Camera(Loose):
    size: Annotated[list[float], Field(min_length=2, max_length=2)]
    matrix: Annotated[list[_Row3], Field(min_length=3, max_length=3)]
    distortions: Annotated[list[float], Field(min_length=4, max_length=5)]
    rotation: _Row3
    translation: _Row3
    fisheye: bool = False


class _Content(RootModel[dict[str, _Camera]]):
    pass


def read_calibration(path: Path | str) -> tuple[tuple[str, ...], tuple[Camera, ...]]:
    """Names and cameras of a calibration, in the file's order.

    Raises
    ------
    InputError
        If it is no such file, or has no camera, a fisheye one, skew, or a size or focal length that is not positive.
    """
    path = Path(path)
    try:
        content = tomllib.loads(read_bytes(path, MOST_BYTES).decode("utf-8"))
        cameras = _Content.model_validate({name: one for name, one in content.items() if name != "metadata"}).root
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))[:100]
        raise InputError(f"{path}: {place}: {first['msg'][:200]}; a calibration of cameras is wanted") from error
    except ValueError as error:  # no UTF-8, or no TOML
        raise InputError(f"{path}: is no TOML: {' '.join(str(error).split())[:200]}") from error
    if not cameras:
        raise InputError(f"{path}: has no cameras; at least one is wanted")
    return tuple(cameras), tuple(_camera(path, name, one) for name, one in cameras.items())


def _camera(path: Path, name: str, one: _Camera) -> Camera:
    K = np.array(one.matrix)
    if one.fisheye:
        raise InputError(f"{path}: {name}: is a fisheye camera; a pinhole with k1 k2 p1 p2 k3 is wanted")
    plain = K[0, 1] == K[1, 0] == 0 and np.array_equal(K[2], [0.0, 0.0, 1.0])
    if not (plain and K[0, 0] > 0 and K[1, 1] > 0):
        raise InputError(f"{path}: {name}: matrix: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0 is wanted")
    width, height = (round(value) for value in one.size)
    if width < 1 or height < 1:
        raise InputError(f"{path}: {name}: size: {one.size}; positive numbers of pixels are wanted")
    bend = np.array([*one.distortions, 0.0][:5])
    R = Rotation.from_rotvec(one.rotation).as_matrix()
    fx, fy, cx, cy = (float(K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return perspective(width, height, fx, fy, cx, cy, R, np.array(one.translation), bend)
