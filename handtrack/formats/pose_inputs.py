"""What a pose network wrote in, people in pixels out: OpenPose's folder, or a JSON file of COCO's or MediaPipe's."""

import re
from pathlib import Path

from ..errors import InputError
from .coco_poses import read_coco_poses
from .json_files import MOST_BYTES
from .mediapipe import read_mediapipe
from .openpose import Layout, read_openpose
from .paths import read_bytes
from .poses2d import Poses2d

_COCO, _MEDIAPIPE = rb'"(keypoints|annotations)"', rb'"(pose_landmarks|poseLandmarks|landmarks|frames)"'


def read_poses(path: Path | str, fps: float, size: tuple[int, int] | None = None, layout: Layout = "auto") -> Poses2d:
    """Read people in pixels by what is there.

    Parameters
    ----------
    fps : float
        Frames a second, where the files do not say.
    size : (width, height) or None
        Of the image, pixels; MediaPipe's landmarks cannot do without.
    layout : 'auto', 'body_25' or 'body_25b'
        Of OpenPose's 25 keypoints.

    Raises
    ------
    InputError
        If the path is none of these, or the size is wanting.
    """
    path = Path(path)
    if path.is_dir():
        return read_openpose(path, fps, size, layout)
    data = read_bytes(path, MOST_BYTES)
    if re.search(_COCO, data):
        return read_coco_poses(path, fps)
    if re.search(_MEDIAPIPE, data):
        if size is None:
            raise InputError(f"{path}: MediaPipe's landmarks are shares of an image; its size is wanted (a camera)")
        return read_mediapipe(path, fps, size)
    raise InputError(
        f"{path}: holds no keypoints or landmarks; OpenPose's folder, or COCO's or MediaPipe's file is wanted"
    )
