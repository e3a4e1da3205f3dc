"""Several calibrated views of a person in; places in space, each view lifted into space, and agreement out. Metres.

A point seen by views with rays (a, b, 1) in camera axes satisfies `(r_1 - a r_3) x = a t_3 - t_1` and the same with b
and r_2, where r_j are the rows of a view's R and t its translation: linear in x, weighted by confidence and focal
length. While a view misses by more than `miss` pixels and three are left, the one without which the others fit best is
left out.

One view has no depth. `lifted` gives it that of a reference, as a depth camera without error would: what remains is the
error of the view's own keypoints.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..camera import Camera, camera_from_world, project, rays
from ..formats.markers import Markers
from ..formats.poses2d import Poses2d, to_keypoints
from ..formats.skeletons import Detections
from .back_projection import detections_from

FEWEST = 2  # views
# A marker table's short names; its axes (y up) are the world's (z up) turned: (x, y, z) of the table is (y, z, x).
_SHORT = tuple(
    f"{side[0].upper()}{joint.capitalize()}"
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in ("left", "right")
)


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """How near places are to a reference.

    Attributes
    ----------
    median, worst : float
        Distance, metres: its median, and the quantile of 95 %; NaN where nothing is comparable.
    share : float
        Of comparable keypoints within 50 mm, 0..1.
    each : (12,)
        Median distance of each of the first keypoints, metres.
    compared : int
        Keypoints that both have.
    """

    median: float
    worst: float
    share: float
    each: Float[np.ndarray, " 12"]
    compared: int


def reference_of(markers: Markers) -> Float[np.ndarray, "f 16 3"]:
    """Keypoints of a table of triangulated joints (`LShoulder` ... `RAnkle`), metres, world axes; NaN where unknown."""
    out = np.full((markers.places.shape[0], 16, 3), np.nan)
    for k, name in enumerate(_SHORT):
        if name in markers.names:
            out[:, k] = 0.001 * markers.places[:, markers.names.index(name)][:, [2, 0, 1]]
    return out


def triangulate(
    cameras: Sequence[Camera],
    uv: Float[np.ndarray, "v n 2"],
    confidence: Float[np.ndarray, "v n"],
    miss: float = 25.0,
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, "v n"]]:
    """Places of points in world axes, NaN where fewer than two views see them, and which views were used.

    Parameters
    ----------
    uv : (v, n, 2)
        Pixels of each view, NaN where unseen.
    miss : float
        Pixels by which a used view may miss while three or more are left.
    """
    used = np.isfinite(uv).all(axis=-1) & (confidence > 0)
    A, b = _equations(cameras, np.where(used[..., None], uv, 0.0))
    x, off = _tried(cameras, uv, confidence, A, b, used)
    for _ in range(len(cameras) - FEWEST):
        bad = np.flatnonzero((off > miss) & (used.sum(axis=0) > FEWEST))
        if not bad.size:
            break
        part = (cameras, uv[:, bad], confidence[:, bad], A[:, bad], b[:, bad])
        without = used[:, bad] & ~np.eye(len(cameras), dtype=bool)[:, :, None]  # one row of views for each left out
        tries = [_tried(*part, one) for one in without]
        worst = np.where(used[:, bad], np.stack([far for _, far in tries]), np.inf)
        best, row = worst.argmin(axis=0), np.arange(bad.size)
        used[:, bad] = without[best, :, row].T
        x[bad], off[bad] = np.stack([place for place, _ in tries])[best, row], worst[best, row]
    return x, used


def _tried(
    cameras: Sequence[Camera],
    uv: Float[np.ndarray, "v n 2"],
    confidence: Float[np.ndarray, "v n"],
    A: Float[np.ndarray, "v n 2 3"],
    b: Float[np.ndarray, "v n 2"],
    used: Bool[np.ndarray, "v n"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Places from the used views, and by how many pixels the worst of these misses."""
    x = _solved(A, b, np.where(used, confidence, 0.0), used)
    off = np.stack([np.linalg.norm(project(c, x) - view, axis=-1) for c, view in zip(cameras, uv, strict=True)])
    # what lies behind a camera is infinitely far off
    return x, np.where(used, np.nan_to_num(off, nan=np.inf), 0.0).max(axis=0)


def _equations(
    cameras: Sequence[Camera], uv: Float[np.ndarray, "v n 2"]
) -> tuple[Float[np.ndarray, "v n 2 3"], Float[np.ndarray, "v n 2"]]:
    """Rows and right sides of each view's two equations; their error is in pixels times metres of depth."""
    rows, right = [], []
    for camera, pixels in zip(cameras, uv, strict=True):
        slope = rays(camera, pixels)[1][:, :2]
        rows.append(camera.fx * (camera.R[:2] - slope[..., None] * camera.R[2]))
        right.append(camera.fx * (slope * camera.t[2] - camera.t[:2]))
    return np.stack(rows), np.stack(right)


def _solved(
    A: Float[np.ndarray, "v n 2 3"],
    b: Float[np.ndarray, "v n 2"],
    weight: Float[np.ndarray, "v n"],
    used: Bool[np.ndarray, "v n"],
) -> Float[np.ndarray, "n 3"]:
    w = weight[..., None, None]
    N = (np.swapaxes(A, -1, -2) @ A * w).sum(axis=0)
    r = ((np.swapaxes(A, -1, -2) @ b[..., None]) * w).sum(axis=0)[..., 0]
    good = used.sum(axis=0) >= FEWEST
    good &= np.linalg.cond(np.where(good[:, None, None], N, np.eye(3))) < 1e12
    x = np.linalg.solve(np.where(good[:, None, None], N, np.eye(3)), r[..., None])[..., 0]
    return np.where(good[:, None], x, np.nan)


def lifted(poses: Poses2d, reference: Float[np.ndarray, "f 16 3"], camera: Camera, gate: float = 150.0) -> Detections:
    """One view's people in space, camera axes, with the depths of the reference.

    A person whose keypoints are, in the median, more than `gate` pixels from the reference's is somebody else: of an
    unknown place, and left unseen. Of several within the gate each gets the same depths.

    Parameters
    ----------
    reference : (f, 16, 3)
        World axes, NaN where unknown.
    """
    uv, confidence = to_keypoints(poses.uv, poses.confidence, poses.names)
    known = np.full((poses.time.size, 16, 3), np.nan)
    count = min(poses.time.size, reference.shape[0])
    known[:count] = reference[:count]
    p_cam = camera_from_world(camera, known)[poses.frame]
    off = np.linalg.norm(project(camera, known)[poses.frame] - uv, axis=-1)
    apart = np.where(np.isfinite(off), off, np.inf)
    middle = np.median(np.where(np.isfinite(off).any(axis=1)[:, None], _filled(apart), np.inf), axis=1)
    ray = rays(camera, np.nan_to_num(uv).reshape(-1, 2))[1].reshape(*uv.shape[:2], 3)
    p = np.where((middle <= gate)[:, None, None] & np.isfinite(uv[..., :1]), p_cam[..., 2:] * ray, np.nan)
    return detections_from(poses, p, confidence)


def _filled(apart: Float[np.ndarray, "d k"]) -> Float[np.ndarray, "d k"]:
    """Distances with unknown ones replaced by each row's median of the known."""
    with np.errstate(invalid="ignore"):
        known = np.isfinite(apart)
        middle = np.array([np.median(row[ok]) if ok.any() else np.inf for row, ok in zip(apart, known, strict=True)])
    return np.where(known, apart, middle[:, None])


def agreement(p: Float[np.ndarray, "f 16 3"], reference: Float[np.ndarray, "f 16 3"]) -> Agreement:
    """How near keypoints of one person are to a reference in the same axes."""
    off = np.linalg.norm(p[:, :12] - reference[:, :12], axis=-1)
    known = np.isfinite(off)
    each = np.array([np.median(off[ok, k]) if (ok := known[:, k]).any() else np.nan for k in range(12)])
    if not known.any():
        return Agreement(np.nan, np.nan, np.nan, each, 0)
    values = off[known]
    return Agreement(
        median=float(np.median(values)),
        worst=float(np.quantile(values, 0.95)),
        share=float((values <= 0.05).mean()),
        each=each,
        compared=int(values.size),
    )
