"""Depth images with known poses in, the room they show as a mesh out.

Every image says of every point near the surfaces it sees how far in front of them the point lies; these signed
distances are averaged on a sparse grid of voxels, and the room is where the average is zero (Curless and Levoy 1996):

    D(x) = sum_i clip((z_i(x) - z(x)) / truncation, -1, 1) / count,   left out where z_i(x) - z(x) < -truncation

with `z(x)` the depth of the point x from camera i and `z_i(x)` the reading of the pixel it falls on. The grid and the
marching cubes are Open3D's (`pip install handtrack[fusion]`); poses, lens, limits and the order of the result are ours.
"""

import math
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Num
from scipy.spatial.transform import Rotation

from ..camera import Camera, project_camera
from ..errors import InputError
from ..formats.rgbd import RgbdScene, read_depth, read_rgbd
from ..formats.tables import Table, check_rising, integers, numbers, read_table
from ..formats.writing import write_bytes
from .environment import Room, room_of

POSES = "poses.csv"
COLUMNS = ("frame", "x", "y", "z", "qw", "qx", "qy", "qz")
VOXEL, VOXELS = 0.02, (0.001, 0.5)  # metres
FARTHEST = 5.0  # metres: the noise of depth grows with its square
TRUNCATION, TRUNCATIONS = 4.0, (2.0, 16.0)  # voxels
SIDE = 16  # voxels of a block along each axis
MOST_BLOCKS = 60_000  # of 32 kB each
_RIGID = 1e-6  # how far a pose may be from a rotation
_UNIT = 1e-2  # how far the length of a quaternion in a file may be from 1


def fuse(
    depths: Iterable[Float32[np.ndarray, "h w"]],
    camera: Camera,
    poses: Float[np.ndarray, "f 4 4"],
    voxel: float = VOXEL,
    truncation: float | None = None,
    farthest: float = FARTHEST,
    seen: int = 1,
) -> Room:
    """The surfaces that depth images show.

    Parameters
    ----------
    depths : iterable of (h, w)
        Depth along the camera's axis, metres; 0 or NaN where there is no reading. Taken one after the other.
    camera : Camera
        Perspective, R = I and t = 0; it may have distortion.
    poses : (f, 4, 4)
        `p_world = pose @ p_cam`, one for each image, metres.
    voxel : float
        Edge of a voxel, metres, 0.001..0.5.
    truncation : float or None
        Distance in front of and behind a surface that is averaged, metres, 2 to 16 voxels; None: 4 voxels. Behind
        outlines, surfaces are too deep by up to this; noise greater than this leaves holes and crumbs.
    farthest : float
        Readings beyond are left out, metres.
    seen : int
        Images that must have looked at a place before it becomes a surface.

    Returns
    -------
    Room
        In the world of the poses, turned towards the cameras; the same order of vertices and triangles however many
        threads work. Without triangles where there is nothing to see.

    Raises
    ------
    ValueError
        If an argument is out of its range, shapes do not fit, or a pose is no rigid motion.
    InputError
        If Open3D is missing, or the room takes too many voxels.
    """
    band = TRUNCATION * voxel if truncation is None else truncation
    _check(camera, poses, voxel, band, farthest, seen)
    grid = _Grid(camera, voxel, band, farthest)
    count = 0
    for depth in depths:
        if count < poses.shape[0]:
            grid.add(depth, poses[count])
        count += 1
    if count != poses.shape[0]:
        raise ValueError(f"depths: got {count} images, wanted {poses.shape[0]}, one for each pose")
    vertices, triangles = in_order(*grid.surface(seen))
    if not triangles.shape[0]:
        return Room(vertices, triangles, (f"room: no surface within {farthest:g} m in {count} depth images",))
    return room_of(vertices, triangles)


def _check(
    camera: Camera, poses: Float[np.ndarray, "f 4 4"], voxel: float, band: float, farthest: float, seen: int
) -> None:
    if camera.kind != "perspective" or not (np.array_equal(camera.R, np.eye(3)) and not camera.t.any()):
        raise ValueError(f"camera: got {camera.kind} with R, t; wanted a perspective camera with R = I and t = 0")
    if not VOXELS[0] <= voxel <= VOXELS[1]:
        raise ValueError(f"voxel: got {voxel}, wanted {VOXELS[0]} to {VOXELS[1]} metres")
    low, high = TRUNCATIONS[0] * voxel, TRUNCATIONS[1] * voxel
    if not low * (1 - 1e-9) <= band <= high * (1 + 1e-9):
        raise ValueError(f"truncation: got {band}, wanted {low:g} to {high:g} metres, 2 to 16 voxels")
    if not 0.0 < farthest < math.inf:
        raise ValueError(f"farthest: got {farthest}, wanted metres above 0")
    if seen < 1:
        raise ValueError(f"seen: got {seen}, wanted 1 or more images")
    R = poses[:, :3, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        bad = ~(np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)) <= _RIGID).all(axis=(1, 2))
        bad |= ~(np.linalg.det(np.where(np.isfinite(R), R, 0.0)) > 0.0) | ~np.isfinite(poses[:, :3, 3]).all(axis=1)
        bad |= (poses[:, 3] != (0.0, 0.0, 0.0, 1.0)).any(axis=1)
    if bad.any():
        raise ValueError(f"poses: number {int(np.flatnonzero(bad)[0])} is no rigid motion; wanted [R t; 0 0 0 1]")


class _Grid:
    """Signed distances on a sparse grid, by Open3D."""

    def __init__(self, camera: Camera, voxel: float, band: float, farthest: float) -> None:
        self._o3d = open3d()
        self._camera, self._voxel, self._farthest = camera, voxel, farthest
        self._multiple = band / voxel
        self._source = _source_pixels(camera)
        K = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
        self._K = self._o3d.core.Tensor(K)
        # A point is given the pixel whose number is its position rounded down; a pixel's centre has a whole position
        # here, so that half a pixel makes it the nearest one.
        half = np.zeros((3, 3))
        half[:2, 2] = 0.5
        self._K_nearest = self._o3d.core.Tensor(K + half)
        single = self._o3d.core.float32
        self._volume = self._o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"), (single, single), ((1), (1)), voxel, SIDE, 2000, self._o3d.core.Device("CPU:0")
        )

    def add(self, depth: Float32[np.ndarray, "h w"], pose: Float[np.ndarray, "4 4"]) -> None:
        """Average one image in, also where earlier ones saw surfaces: what this one looks through wears off."""
        if depth.shape != (self._camera.height, self._camera.width):
            size = (self._camera.height, self._camera.width)
            raise ValueError(f"depths: got an image of {depth.shape}, wanted {size}, the camera's size")
        good = np.where((depth > 0.0) & (depth <= self._farthest), depth, np.float32(0.0))  # NaN compares as false
        if self._source is not None:
            good = np.where(self._source >= 0, good.ravel()[self._source], np.float32(0.0))
        if not good.any():
            return
        inverse = np.eye(4)
        inverse[:3, :3], inverse[:3, 3] = pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3]
        image = self._o3d.t.geometry.Image(self._o3d.core.Tensor(np.ascontiguousarray(good)))
        extrinsic = self._o3d.core.Tensor(inverse)
        scale = (1.0, 2.0 * self._farthest, self._multiple)
        near = self._volume.compute_unique_block_coordinates(image, self._K, extrinsic, *scale)
        table = self._volume.hashmap()
        if near.shape[0] <= MOST_BLOCKS:
            table.activate(near)
        if max(near.shape[0], table.size()) > MOST_BLOCKS:
            raise InputError(
                f"voxel: {self._voxel:g} m gives more than {MOST_BLOCKS} blocks of {SIDE}^3 voxels; larger voxels or "
                "a nearer farthest are wanted"
            )
        blocks = table.key_tensor()[table.active_buf_indices().to(self._o3d.core.int64)]
        self._volume.integrate(blocks, image, self._K_nearest, extrinsic, *scale)

    def surface(self, seen: int) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "t 3"]]:
        """Where the average is zero."""
        empty = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
        if not self._volume.hashmap().size() or self._volume.attribute("weight").numpy().max() < seen:
            return empty
        mesh = self._volume.extract_triangle_mesh(seen - 0.5)
        if "indices" not in mesh.triangle or "positions" not in mesh.vertex:
            return empty
        return mesh.vertex.positions.numpy().astype(float), mesh.triangle.indices.numpy().astype(np.int64)


def _source_pixels(camera: Camera) -> Int[np.ndarray, "h w"] | None:
    """Pixel (row-major number, -1 outside) that shows what the camera without distortion sees; None without any."""
    if not camera.distortion.any():
        return None
    u, v = np.meshgrid(np.arange(float(camera.width)), np.arange(float(camera.height)))
    slopes = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    x, y = np.moveaxis(np.rint(project_camera(camera, slopes)), -1, 0)
    inside = (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    return np.where(inside, y * camera.width + x, -1).astype(np.int64)


def open3d() -> Any:
    """The package.

    Raises
    ------
    InputError
        If it is not installed, or cannot be loaded because a library of the system is missing.
    """
    try:
        return import_module("open3d")
    except (ImportError, OSError) as error:
        words = " ".join(str(error).split())[:200]
        raise InputError(
            f"fusion: Open3D cannot be loaded ({words}); `pip install handtrack[fusion]` brings it"
        ) from error


def in_order(
    vertices: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "t 3"]
) -> tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, "s 3"]]:
    """The same surface in an order that depends on nothing but its shape.

    Vertices in one place become one; what then has no area, and vertices of no triangle, are left out. Vertices are
    sorted by x, y, z; every triangle begins with its first vertex and keeps its sense.

    >>> v, t = in_order(np.array([[1.0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 0, 0]]), np.array([[2, 3, 0], [0, 1, 3]]))
    >>> v.tolist(), t.tolist()
    ([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], [[0, 2, 1]])
    """
    corner = vertices[triangles]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    kept = corner[(cross != 0.0).any(axis=1)].reshape(-1, 3) + 0.0  # no negative zeros
    if not kept.size:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    order, first = _sorted_rows(kept)
    index = np.empty(order.size, np.int64)
    index[order] = np.cumsum(first) - 1
    index = index.reshape(-1, 3)
    turned = index[np.arange(index.shape[0])[:, None], (index.argmin(axis=1)[:, None] + np.arange(3)) % 3]
    rows, once = _sorted_rows(turned)
    return kept[order[first]], turned[rows[once]]


def _sorted_rows(table: Num[np.ndarray, "n 3"]) -> tuple[Int[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Order of the rows, and which of them, in that order, differ from the one before."""
    order = np.lexsort(table.T[::-1])
    differs = (np.diff(table[order], axis=0) != 0).any(axis=1)
    return order, np.concatenate([[True], differs])


def read_poses(path: Path | str, frames: int) -> tuple[Int[np.ndarray, " f"], Float[np.ndarray, "f 4 4"]]:
    """Frames and their poses from `poses.csv`: `frame,x,y,z,qw,qx,qy,qz`, camera to world, metres.

    Parameters
    ----------
    frames : int
        Frames of the scene.

    Raises
    ------
    InputError
        With file and line, for a table that is not one, a frame that the scene does not have, or a quaternion whose
        length is not 1 within 0.01.
    """
    table = read_table(Path(path), COLUMNS)
    frame = integers(table, "frame")
    check_rising(table, "frame", frame)
    if not frame.size:
        raise InputError(f"{table.path}: has no rows; the pose of one frame or more is wanted")
    if frame[-1] >= frames:
        at = f"{table.path}: line {table.lines[-1]}: frame:"
        raise InputError(f"{at} {frame[-1]} given; the scene has frames 0 to {frames - 1}")
    place = np.stack([numbers(table, name) for name in COLUMNS[1:4]], axis=-1)
    return frame, _poses(place, _quaternions(table))


def _quaternions(table: Table) -> Float[np.ndarray, "f 4"]:
    wxyz = np.stack([numbers(table, name) for name in COLUMNS[4:]], axis=-1)
    length = np.linalg.norm(wxyz, axis=1)
    bad = np.flatnonzero(~(np.abs(length - 1.0) <= _UNIT))
    if bad.size:
        at = f"{table.path}: line {table.lines[bad[0]]}: qw,qx,qy,qz:"
        raise InputError(f"{at} length {length[bad[0]]:g} given; a rotation, length 1, is wanted")
    return wxyz


def _poses(place: Float[np.ndarray, "f 3"], wxyz: Float[np.ndarray, "f 4"]) -> Float[np.ndarray, "f 4 4"]:
    out = np.tile(np.eye(4), (place.shape[0], 1, 1))
    out[:, :3, :3] = Rotation.from_quat(wxyz[:, [1, 2, 3, 0]]).as_matrix()
    out[:, :3, 3] = place
    return out


def fuse_folder(
    folder: Path | str,
    voxel: float = VOXEL,
    truncation: float | None = None,
    farthest: float = FARTHEST,
    seen: int = 1,
) -> Room:
    """The room that the depth images of a scene folder (`handtrack/rgbd-1`) show, with the poses of its `poses.csv`.

    Frames without a pose are left out. The room is in the world of the poses; for tracking with it that must be the
    axes of the tracking camera.

    Raises
    ------
    InputError
        For a scene or poses that cannot be read, and as `fuse`.
    """
    scene = read_rgbd(folder)
    frame, poses = read_poses(scene.path.parent / POSES, len(scene))
    room = fuse(_depths(scene, frame), scene.camera, poses, voxel, truncation, farthest, seen)
    return Room(room.vertices, room.triangles, (*scene.warnings, *room.warnings))


def _depths(scene: RgbdScene, frame: Int[np.ndarray, " f"]) -> Iterable[Float32[np.ndarray, "h w"]]:
    return (read_depth(scene, int(i)) for i in frame)


def room_ply(room: Room) -> bytes:
    """A room as a binary PLY file, single precision."""
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {room.vertices.shape[0]}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {room.triangles.shape[0]}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(room.triangles.shape[0], dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, room.triangles
    return head.encode("ascii") + room.vertices.astype("<f4").tobytes() + rows.tobytes()


def write_room(path: Path | str, room: Room) -> None:
    """Write `room_ply`, whole or not at all."""
    write_bytes(Path(path), room_ply(room))
