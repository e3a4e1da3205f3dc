"""Keypoints in pixels and depth images in, keypoints in space out. Metres, seconds, camera axes.

A depth camera sees the skin, and a keypoint's pixel may have no reading, or lie beside a thin arm on what is behind it.
So the depth z is taken from a square window about the pixel: its readings are sorted and cut into clusters where two
neighbours are more than `gap` apart; the nearest cluster with at least `share` of the readings is the body's, z its
median. The joint lies a little deeper along the ray r, r_z = 1 (people paper, II; offset and window are ours):

    p = z r + offset r / |r|

Where the window has too few readings, or none of a body's depth, the keypoint stays unseen; its confidence is kept
otherwise.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from ..camera import Camera, rays
from ..formats.poses2d import Poses2d, to_keypoints
from ..formats.skeletons import LOST, TRACKED, Detections


@dataclass(frozen=True, slots=True)
class DepthSettings:
    """How depth is read at a keypoint; checked on construction.

    Attributes
    ----------
    window : int
        Half width of the window, pixels; 0 takes the keypoint's own pixel.
    gap : float
        Metres between the readings of two clusters.
    share : float
        Share of the window's readings that a cluster needs, 0..1.
    fewest : float
        Share of the window's pixels that need a reading, 0..1.
    nearest, farthest : float
        Metres; readings outside are none.
    offset : float
        Metres from the skin to the joint, along the ray.
    """

    window: int = 4
    gap: float = 0.08
    share: float = 0.25
    fewest: float = 0.15
    nearest: float = 0.3
    farthest: float = 8.0
    offset: float = 0.035

    def __post_init__(self) -> None:
        for name, low, high in (
            ("window", 0, 100), ("gap", 0.001, 10.0), ("share", 0.0, 1.0), ("fewest", 0.0, 1.0),
            ("nearest", 0.0, 50.0), ("farthest", 0.0, 50.0), ("offset", -0.5, 0.5),
        ):  # fmt: skip
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: got {getattr(self, name)}, wanted {low} to {high}")
        if not self.nearest < self.farthest:
            raise ValueError(f"farthest: got {self.farthest}, wanted more than nearest, {self.nearest}")


def back_project(
    uv: Float[np.ndarray, "m k 2"],
    depth: Float[np.ndarray, "h w"] | Float32[np.ndarray, "h w"],
    camera: Camera,
    settings: DepthSettings | None = None,
) -> Float[np.ndarray, "m k 3"]:
    """Keypoints of one frame in space, metres; NaN where they or the depth are unseen.

    Parameters
    ----------
    uv : (m, k, 2)
        Pixels, NaN where unseen.
    depth : (h, w)
        Metres; 0, negative or not finite where there is no reading.

    >>> camera = Camera("perspective", 5, 5, 10.0, 10.0, 2.0, 2.0, np.eye(3), np.zeros(3), np.zeros(5))
    >>> back_project(np.array([[[2.0, 2.0]]]), np.full((5, 5), 1.5), camera).tolist()
    [[[0.0, 0.0, 1.535]]]
    """
    settings = settings or DepthSettings()
    if depth.shape != (camera.height, camera.width):
        raise ValueError(f"depth: got {depth.shape}, wanted {(camera.height, camera.width)}, the camera's size")
    m, k = uv.shape[:2]
    flat = uv.reshape(-1, 2)
    out = np.full((m * k, 3), np.nan)
    seen = np.isfinite(flat).all(axis=1)
    z = near_depth(flat[seen], depth, settings)
    _, ray = rays(camera, flat[seen])
    out[seen] = z[:, None] * ray + settings.offset * ray / np.linalg.norm(ray, axis=1, keepdims=True)
    return out.reshape(m, k, 3)


def near_depth(
    uv: Float[np.ndarray, "n 2"],
    depth: Float[np.ndarray, "h w"] | Float32[np.ndarray, "h w"],
    settings: DepthSettings,
) -> Float[np.ndarray, " n"]:
    """Median of the nearest cluster of readings about each pixel, metres; NaN where there is none."""
    z, count = _windows(uv, depth, settings)
    n, size = z.shape
    with np.errstate(invalid="ignore"):
        cut = np.diff(z, axis=1) > settings.gap
    cluster = np.concatenate([np.zeros((n, 1), dtype=int), np.cumsum(cut, axis=1)], axis=1)
    known = np.isfinite(z)
    members = np.bincount((cluster + size * np.arange(n)[:, None])[known], minlength=n * size).reshape(n, size)
    enough = members >= np.maximum(settings.share * count, 1.0)[:, None]
    chosen = enough.argmax(axis=1)
    first = (cluster < chosen[:, None]).sum(axis=1)
    middle = first + 0.5 * (members[np.arange(n), chosen] - 1)
    row = np.arange(n)
    low, high = np.floor(middle).astype(int).clip(0, size - 1), np.ceil(middle).astype(int).clip(0, size - 1)
    good = enough.any(axis=1) & (count >= max(settings.fewest * size, 1.0))
    return np.where(good, 0.5 * (z[row, low] + z[row, high]), np.nan)


def _windows(
    uv: Float[np.ndarray, "n 2"],
    depth: Float[np.ndarray, "h w"] | Float32[np.ndarray, "h w"],
    settings: DepthSettings,
) -> tuple[Float[np.ndarray, "n s"], Float[np.ndarray, " n"]]:
    """Readings about each pixel, rising, inf where there is none, and how many there are."""
    h, w = depth.shape
    step = np.arange(-settings.window, settings.window + 1)
    # far off the image is as good as just off it, and fits into an integer
    at = np.rint(np.clip(uv, -1e6, 1e6)).astype(int)
    x = at[:, 0, None] + np.tile(step, step.size)
    y = at[:, 1, None] + np.repeat(step, step.size)
    inside = (x >= 0) & (x < w) & (y >= 0) & (y < h)
    z = depth[y.clip(0, h - 1), x.clip(0, w - 1)].astype(float)
    with np.errstate(invalid="ignore"):
        inside &= (z >= settings.nearest) & (z <= settings.farthest)
    return np.sort(np.where(inside, z, np.inf), axis=1), inside.sum(axis=1).astype(float)


def detections_in_depth(
    poses: Poses2d,
    depths: Iterable[Float[np.ndarray, "h w"] | Float32[np.ndarray, "h w"]],
    camera: Camera,
    settings: DepthSettings | None = None,
) -> Detections:
    """People of a whole recording in space.

    Parameters
    ----------
    depths : iterable of (h, w)
        One for each frame of the poses, metres. They may come one by one: each is used once.

    Raises
    ------
    ValueError
        If there are fewer depth images than frames.
    """
    bounds = np.searchsorted(poses.frame, np.arange(poses.time.size + 1))
    p = np.full((*poses.uv.shape[:2], 3), np.nan)
    number = 0
    for number, depth in zip(range(1, poses.time.size + 1), depths, strict=False):
        rows = slice(bounds[number - 1], bounds[number])
        p[rows] = back_project(poses.uv[rows], depth, camera, settings)
    if number < poses.time.size:
        raise ValueError(f"depths: got {number} images, wanted {poses.time.size}, one for each frame")
    # centres are built in space: the middle of two pixels is not the pixel of the middle
    return detections_from(poses, *to_keypoints(p, poses.confidence, poses.names))


def detections_from(
    poses: Poses2d, p: Float[np.ndarray, "d 16 3"], confidence: Float[np.ndarray, "d 16"]
) -> Detections:
    """Detections with the times of poses and with places found for them; a keypoint without a place is unseen."""
    seen = np.isfinite(p).all(axis=-1) & (confidence > 0)
    return Detections(
        time=poses.time,
        frame=poses.frame,
        person=poses.person,
        p=np.where(seen[..., None], p, np.nan),
        confidence=np.where(seen, confidence, 0.0),
        state=np.where(seen, TRACKED, LOST).astype(np.int8),
        warnings=poses.warnings,
    )
