"""Folders of pictures of a board in, the place of a depth camera in a headset's frame out, as a file and in pictures.

The moving camera's folder has `poses.csv` (`frame,x,y,z,qw,qx,qy,qz`: its pose in its fixed frame 0; frame 0 is the
first image by name). Images that show too little of the board are left out, and it is said why.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Num, UInt8

from ..camera import Camera, project_camera
from ..errors import InputError
from ..formats.cameras import read_camera
from ..formats.images import image_paths, read_image
from ..formats.writing import write_text
from .board import Board, Detection, detect, read_board
from .fusion import read_poses
from .registration import Gate, Mean, Pose, Relation, board_pose, register

FORMAT = "handtrack/registration-1"
POOR = 1.0  # pixels: a camera that is calibrated well reprojects below (wrist thesis, 5.2.2)
AMBIGUOUS = 1.5  # times the error of the first minimum


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """What the images of one camera gave.

    Attributes
    ----------
    names : tuple of n str
        File names.
    reprojection_px : (n,)
        NaN where there is no pose.
    corners : (n,)
        How many gave the pose.
    kept : (n,)
        Whether the pose is part of the mean.
    reasons : tuple of n str
        Why it is not; empty where it is.
    """

    names: tuple[str, ...]
    reprojection_px: Float[np.ndarray, " n"]
    corners: Num[np.ndarray, " n"]
    kept: Bool[np.ndarray, " n"]
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Place of the fixed camera in frame 0, what every image said, and what was accepted with care."""

    relation: Relation
    moving: Views
    fixed: Views
    warnings: tuple[str, ...]


def register_images(
    images_1: Path | str,
    poses_1: Path | str,
    camera_1: Path | str,
    images_kin: Path | str,
    camera_kin: Path | str,
    board: Path | str,
    gate: Gate | None = None,
) -> Registration:
    """Register a fixed camera to the frame of a moving one.

    Parameters
    ----------
    images_1, images_kin : folder
        Pictures of the board by the moving and by the fixed camera.
    poses_1 : file
        Poses of the moving camera; pictures without one are left out.
    camera_1, camera_kin : file
        Camera files; of a camera's own place nothing is used.
    board : file
        `board.yaml`.
    gate : Gate or None
        How far the board may seem to move.

    Raises
    ------
    InputError
        For files that cannot be read, or where no picture of a camera gives a pose.
    """
    plan = read_board(board)
    moving, fixed = image_paths(Path(images_1)), image_paths(Path(images_kin))
    frames, A_01 = read_poses(poses_1, len(moving))
    at_1, why_1 = _poses(moving, read_camera(camera_1), plan, set(frames.tolist()), f"{poses_1} has no row for it")
    at_kin, why_kin = _poses(fixed, read_camera(camera_kin), plan, set(range(len(fixed))), "")
    for folder, poses, why in ((images_1, at_1, why_1), (images_kin, at_kin, why_kin)):
        if not poses:
            raise InputError(f"{folder}: no image gives the pose of the board; the first one: {why[0]}")
    row = {frame: i for i, frame in enumerate(frames.tolist())}
    relation = register(A_01[[row[k] for k in at_1]], list(at_1.values()), list(at_kin.values()), gate)
    views = _views(moving, at_1, relation.moving, why_1), _views(fixed, at_kin, relation.fixed, why_kin)
    warnings = [
        note
        for folder, one, poses in zip((images_1, images_kin), views, (at_1, at_kin), strict=True)
        for note in _notes(str(folder), one, poses)
    ]
    return Registration(relation, *views, tuple(warnings))


def _poses(
    paths: Sequence[Path], camera: Camera, board: Board, wanted: set[int], otherwise: str
) -> tuple[dict[int, Pose], dict[int, str]]:
    """Poses of the board by number of the image, and why others have none."""
    poses, reasons = {}, {}
    for k, path in enumerate(paths):
        if k not in wanted:
            reasons[k] = otherwise
            continue
        image = read_image(path)
        if image.shape != (camera.height, camera.width):
            raise InputError(
                f"{path}: is {image.shape[1]} x {image.shape[0]} pixels; {camera.width} x {camera.height}, the "
                "camera's size, is wanted"
            )
        try:
            poses[k] = board_pose(detect(image, board, camera), board, camera)
        except InputError as error:
            reasons[k] = str(error)
    return poses, reasons


def _views(paths: Sequence[Path], poses: dict[int, Pose], mean: Mean, why: dict[int, str]) -> Views:
    """Everything about a camera's images; reasons of what the gate left out are added."""
    kept = np.zeros(len(paths), dtype=bool)
    kept[list(poses)] = mean.kept
    reasons = tuple(
        "" if one else why.get(k, "the board seems to be elsewhere: beyond the gate") for k, one in enumerate(kept)
    )
    error = np.array([poses[k].reprojection_px if k in poses else np.nan for k in range(len(paths))])
    corners = np.array([poses[k].corners if k in poses else 0 for k in range(len(paths))])
    return Views(tuple(path.name for path in paths), error, corners, kept, reasons)


def _notes(folder: str, views: Views, poses: dict[int, Pose]) -> Iterable[str]:
    """What is to be said about a camera's images."""
    count, total = int(views.kept.sum()), views.kept.size
    if count < total:
        first = int((~views.kept).argmax())
        yield (
            f"{folder}: {total - count} of {total} images are left out; the first, {views.names[first]}: "
            f"{views.reasons[first]}"
        )
    if 2 * count <= len(poses) and len(poses) > 1:
        yield f"{folder}: {count} of {len(poses)} poses agree; the board or the poses moved"
    rms = float(np.sqrt(np.mean(views.reprojection_px[views.kept] ** 2)))
    if rms > POOR:
        yield f"{folder}: reprojection error {rms:.2g} px; below {POOR:g} px is wanted of a calibrated camera"
    doubtful = sum(
        poses[k].other_px < AMBIGUOUS * poses[k].reprojection_px for k in np.flatnonzero(views.kept).tolist()
    )
    if doubtful:
        yield (
            f"{folder}: {doubtful} of {count} images also fit a board tilted the other way; nearer or oblique ones are "
            "wanted"
        )


def registration_text(registration: Registration) -> str:
    """The result as YAML: the matrix, its standard deviations, the mean errors, and a line for each image."""
    relation = registration.relation
    sigma = np.sqrt(np.maximum(np.diag(relation.covariance), 0.0))
    lines = [f"format: {FORMAT}\n", "A_0kin:\n", *(f"  - {_list(row)}\n" for row in relation.A_0kin)]
    lines += [f"sigma_m: {_list(sigma[:3])}\n", f"sigma_degrees: {_list(np.degrees(sigma[3:]))}\n"]
    lines += ["covariance:\n", *(f"  - {_list(row)}\n" for row in relation.covariance)]
    for name, views, mean in (
        ("moving", registration.moving, relation.moving),
        ("fixed", registration.fixed, relation.fixed),
    ):
        lines.append(f"{name}:\n  reprojection_px: {mean.pose.reprojection_px:.4g}\n  images:\n")
        for file, px, corners, kept, reason in zip(
            views.names, views.reprojection_px, views.corners, views.kept, views.reasons, strict=True
        ):
            entry = [f"name: {_quoted(file)}", f"corners: {corners}", f"kept: {str(bool(kept)).lower()}"]
            entry += [] if np.isnan(px) else [f"reprojection_px: {px:.4g}"]
            entry += [f"reason: {_quoted(reason)}"] if reason else []
            lines.append(f"    - {{{', '.join(entry)}}}\n")
    return "".join(lines)


def write_registration(path: Path | str, registration: Registration) -> None:
    """Write `registration_text`, whole or not at all."""
    write_text(Path(path), registration_text(registration))


def _list(values: Iterable[float]) -> str:
    return f"[{', '.join(f'{float(value) + 0.0!r}' for value in values)}]"


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def draw_detection(
    image: Num[np.ndarray, "h w *c"], found: Detection, pose: Pose | None, board: Board, camera: Camera
) -> UInt8[np.ndarray, "h w 3"]:
    """A picture, in OpenCV's order of colours, with the corners found and, where there is a pose, the board's axes.

    Corners are yellow rings; crosses show where the pose puts them. The axes are x red, y green, z blue and three
    squares long; z leads into the board and is drawn backwards, towards the viewer.
    """
    pixels = np.ascontiguousarray(np.clip(image, 0, 255), np.uint8)
    out = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR) if pixels.ndim == 2 else pixels.copy()
    for xy in found.xy:
        cv2.circle(out, _sixteenths(xy), 5 * 16, (0, 220, 255), 1, cv2.LINE_AA, 4)
    if pose is None:
        return out
    ends = np.concatenate([np.zeros((1, 3)), 3 * board.square * np.diag([1.0, 1.0, -1.0]), board.corners[found.ids]])
    xy = project_camera(camera, ends @ pose.R.T + pose.t)
    for end, colour in zip(xy[1:4], ((60, 60, 230), (60, 180, 60), (230, 120, 40)), strict=True):
        if np.isfinite(xy[0] + end).all():
            cv2.line(out, _sixteenths(xy[0]), _sixteenths(end), colour, 2, cv2.LINE_AA, 4)
    for x, y in xy[4:]:
        for dx, dy in ((3, 3), (3, -3)):
            ends_of = _sixteenths(np.array([x - dx, y - dy])), _sixteenths(np.array([x + dx, y + dy]))
            cv2.line(out, *ends_of, (200, 0, 200), 1, cv2.LINE_AA, 4)
    return out


def _sixteenths(xy: Float[np.ndarray, " 2"]) -> tuple[int, int]:
    """A position for OpenCV's lines, which know parts of pixels as whole numbers."""
    x, y = np.rint(np.clip(xy, -1e6, 1e6) * 16).astype(int)
    return int(x), int(y)
