"""A walk folder, and perhaps what a pose network wrote of it, in; the walk with the network's keypoints out.

A network numbers people anew in every frame. The walker is who is followed from where the most keypoints are sure: in
each frame the person nearest in the image to the one before, within what somebody moves; after a while unseen, again
the one whose keypoints are the surest.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from ..formats.openpose import Layout
from ..formats.pose_inputs import read_poses
from ..formats.poses2d import Poses2d, to_keypoints
from ..formats.walks import Walk, read_walk

FASTEST = 1.0  # of the image's height a second, that somebody's middle moves
JUMP = 0.1  # of the image's height, that it may seem to move besides
FORGET = 1.0  # seconds unseen after which anybody may be the walker
_TABLES = ("segments.csv", "keypoints2d.csv", "truth.csv", "truth_keypoints.csv")


@dataclass(frozen=True, slots=True, eq=False)
class WalkInput:
    """An opened walk.

    Attributes
    ----------
    walk : Walk
    files : tuple of (str, tuple of Path)
        All that was read: what it is, and its files in their order.
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    walk: Walk
    files: tuple[tuple[str, tuple[Path, ...]], ...]
    warnings: tuple[str, ...]


def open_walk(
    folder: Path | str,
    poses: Path | str | None = None,
    fps: float | None = None,
    start: float = 0.0,
    layout: Layout = "auto",
) -> WalkInput:
    """Open a walk folder.

    Parameters
    ----------
    poses : path, optional
        OpenPose's folder, or COCO's or MediaPipe's file, in the place of `keypoints2d.csv`, which may be absent then.
    fps, start : float, float
        Of its frames: how many a second (those of the walk if None), and the time of the first on the suit's clock.
    layout : str
        Of OpenPose's 25 keypoints.

    Raises
    ------
    InputError
        In one line with file, place and what was wanted.
    """
    walk = read_walk(folder, with_keypoints=poses is None)
    root = walk.path.parent
    files = [(name, (root / name,)) for name in (walk.path.name, *_TABLES) if (root / name).is_file()]
    if poses is None:
        return WalkInput(walk, tuple(files), walk.warnings)
    size = (walk.camera.width, walk.camera.height)
    found = read_poses(poses, walk.fps if fps is None else fps, size, layout)
    files = [(name, paths) for name, paths in files if name != "keypoints2d.csv"]
    files.append((Path(poses).name, found.files or (Path(poses),)))
    return WalkInput(with_poses(walk, found, start), tuple(files), (*walk.warnings, *found.warnings))


def with_poses(walk: Walk, poses: Poses2d, start: float = 0.0) -> Walk:
    """The walk with one person of a network's as what its camera saw.

    Parameters
    ----------
    start : float
        Time of the network's first frame on the suit's clock.

    Raises
    ------
    InputError
        If there are no frames, or none overlaps the suit's.
    """
    if not poses.time.size:
        raise InputError(f"{walk.path}: the keypoints have no frames; at least one is wanted")
    time = poses.time + start
    if time[-1] < walk.time[0] or time[0] > walk.time[-1]:
        raise InputError(
            f"{walk.path}: the keypoints go from {time[0]:.4g} to {time[-1]:.4g} s, the suit from {walk.time[0]:.4g} "
            f"to {walk.time[-1]:.4g}; times on one clock are wanted"
        )
    uv, confidence = to_keypoints(poses.uv, poses.confidence, poses.names)
    chosen = walker(poses.time, poses.frame, uv, confidence, float(walk.camera.height))
    seen = chosen >= 0
    all_uv, sure = np.full((time.size, 16, 2), np.nan), np.zeros((time.size, 16))
    all_uv[seen], sure[seen] = uv[chosen[seen]], confidence[chosen[seen]]
    return replace(walk, camera_frame=np.arange(time.size), camera_time=time, uv=all_uv, confidence=sure)


def walker(
    time: Float[np.ndarray, " f"],
    frame: Int[np.ndarray, " d"],
    uv: Float[np.ndarray, "d 16 2"],
    confidence: Float[np.ndarray, "d 16"],
    height: float,
) -> Int[np.ndarray, " f"]:
    """Number of the walker's detection in each frame, -1 where nobody is.

    Parameters
    ----------
    frame : (d,)
        Of each detection, ascending.
    height : float
        Of the image, pixels.

    >>> uv = np.zeros((3, 16, 2)) + np.array([100.0, 400.0, 110.0])[:, None, None]
    >>> walker(np.array([0.0, 0.1]), np.array([0, 1, 1]), uv, np.ones((3, 16)), 720.0).tolist()
    [0, 2]
    """
    chosen = np.full(time.size, -1)
    rows = np.searchsorted(frame, np.arange(time.size + 1))
    known = confidence > 0
    count = known.sum(axis=1)
    middle = np.where(known[..., None], uv, 0.0).sum(axis=1) / np.maximum(count, 1)[:, None]
    last, when = np.full(2, np.nan), -np.inf
    for n in range(time.size):
        here = np.arange(rows[n], rows[n + 1])
        here = here[count[here] > 0]
        if not here.size:
            continue
        age = time[n] - when
        if age > FORGET:
            best = int(here[confidence[here].sum(axis=1).argmax()])
        else:
            apart = np.linalg.norm(middle[here] - last, axis=1)
            if apart.min() > height * (JUMP + FASTEST * age):
                continue
            best = int(here[apart.argmin()])
        chosen[n], last, when = best, middle[best], time[n]
    return chosen
