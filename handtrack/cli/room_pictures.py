"""Rooms and boards in; the pictures and figures that `body room` and `body register` show beside their results, out."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ..body.board import Board, detect
from ..body.environment import Room, ray_caster
from ..body.registration import Pose, board_pose
from ..body.registration_files import Registration, draw_detection
from ..camera import Camera, rays
from ..errors import InputError
from ..formats.cameras import read_camera
from ..formats.images import image_paths, read_image

SHOWN = 9  # pictures of each camera
WIDEST = 640  # pixels of each


def shaded(room: Room, camera: Camera, pose: Float[np.ndarray, "4 4"]) -> UInt8[np.ndarray, "h w 3"]:
    """A room lit from the camera, which stands at `pose`; darker with the distance, blue where there is nothing."""
    v, u = np.mgrid[: camera.height, : camera.width].reshape(2, -1)
    _, way = rays(camera, np.stack([u, v], axis=1).astype(float))
    way = 20.0 * way @ pose[:3, :3].T
    share = ray_caster(room).hits(pose[:3, 3], way).reshape(camera.height, camera.width)
    depth = 20.0 * share
    seen = np.where(np.isfinite(depth), depth, np.nan)
    rise = np.hypot(np.gradient(seen, axis=0) * camera.fy, np.gradient(seen, axis=1) * camera.fx) / seen
    light = 1.0 / np.sqrt(1.0 + rise**2)  # cosine between the surface's normal and the camera's axis
    level = np.where(np.isfinite(light), light, 0.5) * np.clip(1.0 - 0.12 * seen, 0.2, 1.0)
    grey = np.where(np.isfinite(depth), np.nan_to_num(255.0 * level), 0.0)[..., None]
    return np.where(np.isfinite(depth)[..., None], grey, (90.0, 50.0, 40.0)).astype(np.uint8)


def drawn(folder: Path, camera_file: Path, board: Board) -> list[UInt8[np.ndarray, "h w 3"]]:
    """The first pictures of a folder, with the corners found and the board's axes."""
    camera, out = read_camera(camera_file), []
    for path in image_paths(folder)[:SHOWN]:
        image = read_image(path)
        found = detect(image, board, camera)
        try:
            pose: Pose | None = board_pose(found, board, camera)
        except InputError:
            pose = None
        picture = draw_detection(image, found, pose, board, camera)
        words = f"{path.name}: {found.ids.size} corners" + (f", {pose.reprojection_px:.2f} px" if pose else "")
        picture[:30] //= 3
        cv2.putText(picture, words, (8, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255, 255, 255), 1, cv2.LINE_AA)
        scale = min(1.0, WIDEST / picture.shape[1])
        out.append(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    return out


def png(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """A picture as the bytes of a PNG file."""
    return cv2.imencode(".png", picture)[1].tobytes()


def facts(found: Registration) -> dict[str, object]:
    """What a registration found, for machines."""
    sigma = np.sqrt(np.diag(found.relation.covariance))
    return {
        "A_0kin": found.relation.A_0kin.tolist(),
        "sigma_mm": float(1e3 * np.linalg.norm(sigma[:3])),
        "sigma_degrees": float(np.degrees(np.linalg.norm(sigma[3:]))),
        "moving_images": int(found.moving.kept.sum()),
        "fixed_images": int(found.fixed.kept.sum()),
        "moving_reprojection_px": found.relation.moving.pose.reprojection_px,
        "fixed_reprojection_px": found.relation.fixed.pose.reprojection_px,
    }
