"""What a user has of people in; skeletons in space, and what belongs to them, out.

* a scene folder with `scene.yaml` (`format: handtrack/skeletons-1`): as it is;
* keypoints in pixels (OpenPose's folder, COCO's or MediaPipe's file), camera and depth images: `back_projection`;
* MediaPipe's file with a camera alone: `world_landmarks`.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..camera import Camera
from ..errors import InputError
from ..formats.cameras import read_camera
from ..formats.images import image_paths
from ..formats.people_scenes import PeopleScene, read_people_scene
from ..formats.pose_inputs import read_poses
from ..formats.poses2d import Poses2d
from ..formats.rgbd import NAME, RgbdScene, read_depth
from ..formats.skeletons import Detections, TruthPoints
from .back_projection import DepthSettings, detections_in_depth
from .world_landmarks import detections_by_world

FPS = 30.0  # where nothing says it


@dataclass(frozen=True, slots=True, eq=False)
class PeopleInput:
    """Skeletons in space.

    Attributes
    ----------
    path : Path
        What the user named.
    fps : float
        Frames a second.
    camera : Camera or None
        R = I and t = 0: everything is in its axes.
    detections : Detections
    truth : TruthPoints or None
    files : tuple of (str, tuple of Path)
        All that was read: what it is, and its files in their order.
    warnings : tuple of str
        What was accepted with care, a line each.
    skin : float or None
        How far wrists are still in front of their joints, metres; None if nobody knows (see `skin`).
    """

    path: Path
    fps: float
    camera: Camera | None
    detections: Detections
    truth: TruthPoints | None
    files: tuple[tuple[str, tuple[Path, ...]], ...]
    warnings: tuple[str, ...] = ()
    skin: float | None = 0.0


@dataclass(frozen=True, slots=True)
class Given:
    """What stands beside keypoints in pixels.

    Attributes
    ----------
    camera : Path or None
        File with one perspective camera; where it stands in the world is not asked.
    depth : Path or None
        Folder of 16-bit depth images in millimetres, one for each frame.
    fps : float or None
        Frames a second; 30 if None.
    offset : float or None
        Metres from the skin to the joint; with depth images the usual ones if None (see `DepthSettings`), in a scene
        unknown then.
    """

    camera: Path | None = None
    depth: Path | None = None
    fps: float | None = None
    offset: float | None = None


def open_people(path: Path, given: Given | None = None) -> PeopleInput:
    """Open whatever holds people.

    Raises
    ------
    InputError
        In one line with file, place and what was wanted.
    """
    given = given or Given()
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; a scene, or keypoints of a pose network, is wanted")
    if (path / NAME).is_file() or path.name == NAME:
        for name in ("camera", "depth", "fps"):
            if getattr(given, name) is not None:
                raise InputError(f"--{name}: is not for a scene with {NAME}, which holds places in metres already")
        return _scene(read_people_scene(path), given.offset)
    return _in_pixels(path, given)


def _scene(scene: PeopleScene, skin: float | None) -> PeopleInput:
    return PeopleInput(
        path=scene.path.absolute().parent,
        fps=scene.fps,
        camera=scene.camera,
        detections=scene.detections,
        truth=scene.truth,
        files=tuple((file.name, (file,)) for file in scene.files),
        warnings=scene.warnings,
        skin=skin,
    )


def _in_pixels(path: Path, given: Given) -> PeopleInput:
    if given.camera is None:
        raise InputError(f"--camera: is wanted: {path} holds keypoints in pixels")
    camera = read_camera(given.camera)
    if camera.kind != "perspective":
        raise InputError(f"{given.camera}: camera: is {camera.kind}; a perspective one is wanted")
    camera = replace(camera, R=np.eye(3), t=np.zeros(3))  # results are in its own axes
    fps = FPS if given.fps is None else given.fps
    poses = read_poses(path, fps, (camera.width, camera.height))
    files = [("keypoints", poses.files or (path,)), ("camera", (given.camera,))]
    notes: tuple[str, ...] = ()
    if given.depth is not None:
        images = image_paths(given.depth)
        seen, notes = _by_depth(given, images, poses, camera, fps)
        files.append(("depth", images))
    elif poses.world is not None:
        seen = detections_by_world(poses, camera)
        notes = (f"{path}: has no depth images beside it; distances are the network's guesses",)
    else:
        raise InputError(f"--depth: is wanted: {path} holds keypoints in pixels, and nothing tells how far they are")
    if seen.time.size > 1:
        fps = float(1.0 / np.median(np.diff(seen.time)))
    return PeopleInput(path.absolute(), fps, camera, seen, None, tuple(files), (*seen.warnings, *notes))


def _by_depth(
    given: Given, images: tuple[Path, ...], poses: Poses2d, camera: Camera, fps: float
) -> tuple[Detections, tuple[str, ...]]:
    """Detections from depth images, and warnings."""
    frames, notes = poses.time.size, ()
    if len(images) < frames:
        raise InputError(f"{given.depth}: has {len(images)} images; {frames}, one for each frame, are wanted")
    if len(images) > frames:
        notes = (f"{given.depth}: has {len(images)} images for {frames} frames; the first {frames} are used",)
    nobody = Detections(
        np.zeros(0), np.zeros(0, int), np.zeros(0, int), np.zeros((0, 16, 3)), np.zeros((0, 16)),
        np.zeros((0, 16), np.int8),
    )  # fmt: skip
    scene = RgbdScene(images[0].parent, fps, camera, images, nobody, None, None)
    settings = DepthSettings() if given.offset is None else DepthSettings(offset=given.offset)
    return detections_in_depth(poses, (read_depth(scene, n) for n in range(frames)), camera, settings), notes
