"""A walk folder, and perhaps what a pose network wrote of it, in; the walk with the network's keypoints out."""

from dataclasses import dataclass
from pathlib import Path

from ..formats.openpose import Layout
from ..formats.pose_inputs import read_poses
from ..formats.walks import Walk, read_walk
from .walk_person import with_poses

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
    there = [name for name in (walk.path.name, *_TABLES) if (root / name).is_file()]
    files: list[tuple[str, tuple[Path, ...]]] = [(name, (root / name,)) for name in there]
    if poses is None:
        return WalkInput(walk, tuple(files), walk.warnings)
    size = (walk.camera.width, walk.camera.height)
    found = read_poses(poses, walk.fps if fps is None else fps, size, layout)
    files = [(name, paths) for name, paths in files if name != "keypoints2d.csv"]
    files.append((Path(poses).name, found.files or (Path(poses),)))
    return WalkInput(with_poses(walk, found, start), tuple(files), (*walk.warnings, *found.warnings))
