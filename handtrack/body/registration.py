"""Corners of a board that two sensors see in, the place of one sensor in the other's frame out.

A board stands still. A fixed camera `kin` sees it at `A_kin,char`. A moving camera `1`, which knows its own pose
`A_0,1` in a fixed frame 0, sees it at `A_1,char`. Then (wrist thesis, 5.2)

    A_0,kin = A_0,1 A_1,char A_kin,char^-1.

`A_a,b` takes points of frame b to frame a. A pose solves the perspective-n-point problem (5.2.2) by minimising the
reprojection error. Both ways to the board are averaged over their images before they are composed (5.3): a weighted
mean of poses near their centre, so that a misjudged one is left out.

Errors of a pose are small moves in the frame that it places, `A (I + [rho, phi])` with rho in metres first and phi in
radians after it. Composing from the left leaves them as they are; the inverse and what follows carry them by the
adjoint.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from ..camera import Camera, project_with_jacobian, undistort
from ..errors import InputError
from ..robust import huber_weight, robust_sigma
from .board import Board, Detection, refusal

EXPECTED = 0.3  # pixels: error of a corner before any was seen ...
WORTH = 10.0  # ... which counts as much as so many numbers that were
FINEST = 0.05  # pixels: below it corners are not told apart as good and bad
WRONG = 6.0  # standard deviations
STEPS = 30
SETTLED = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Where a board is in a camera's axes, or any frame in another.

    Attributes
    ----------
    R, t : (3, 3), (3,)
        Rotation and place, metres: `p = R p_board + t`.
    covariance : (6, 6)
        Of moves in the board's frame: metres, then radians.
    reprojection_px : float
        Root mean square distance of the corners used to where the pose puts them.
    corners : int
        How many were used.
    other_px : float
        The same distance for the second minimum, the board tilted the other way. As small as the first one: the picture
        does not tell which of the two it is.
    """

    R: Float[np.ndarray, "3 3"]
    t: Float[np.ndarray, " 3"]
    covariance: Float[np.ndarray, "6 6"]
    reprojection_px: float
    corners: int
    other_px: float = float("inf")

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        """Homogeneous, `p = A p_board`."""
        return rigid(self.R, self.t)


@dataclass(frozen=True, slots=True)
class Gate:
    """How far from their centre poses may be that are averaged: metres and radians, above 0."""

    translation: float = 0.05
    rotation: float = np.radians(3.0).item()

    def __post_init__(self) -> None:
        for name, value in (("translation", self.translation), ("rotation", self.rotation)):
            if not 0 < value < np.inf:
                raise ValueError(f"{name}: {value} given; a number above 0 is wanted")


@dataclass(frozen=True, slots=True, eq=False)
class Mean:
    """An averaged pose, and which poses (n,) it is the mean of."""

    pose: Pose
    kept: Bool[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class Relation:
    """Where the fixed camera is in frame 0.

    Attributes
    ----------
    A_0kin : (4, 4)
        Points in the fixed camera's axes to frame 0.
    covariance : (6, 6)
        Of moves in the fixed camera's axes: metres, then radians.
    moving, fixed : Mean
        Of the board in frame 0 and in the fixed camera's axes.
    """

    A_0kin: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    moving: Mean
    fixed: Mean


def rigid(R: Float[np.ndarray, "*n 3 3"], t: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 4 4"]:
    """Homogeneous matrices of rotations and places."""
    out = np.zeros((*t.shape[:-1], 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = R, t, 1.0
    return out


def inverse(A: Float[np.ndarray, "*n 4 4"]) -> Float[np.ndarray, "*n 4 4"]:
    """Inverse of rigid motions."""
    R = A[..., :3, :3].swapaxes(-1, -2)
    return rigid(R, -(R @ A[..., :3, 3:])[..., 0])


def relate(
    A_01: Float[np.ndarray, "*n 4 4"], A_1char: Float[np.ndarray, "*n 4 4"], A_kinchar: Float[np.ndarray, "*n 4 4"]
) -> Float[np.ndarray, "*n 4 4"]:
    """`A_0,kin = A_0,1 A_1,char A_kin,char^-1` (wrist thesis, 5.2).

    >>> one, two = np.eye(4), np.eye(4)
    >>> one[2, 3], two[2, 3] = 1.5, 2.0
    >>> relate(np.eye(4), one, two)[2, 3].item()
    -0.5
    """
    return A_01 @ A_1char @ inverse(A_kinchar)


def board_pose(found: Detection, board: Board, camera: Camera) -> Pose:
    """Where a board is in the axes of a perspective camera; the camera's own place (`R`, `t`) is left out.

    The two minima of a plane's reprojection error are found in closed form (Collins & Bartoli 2014, by OpenCV), both
    are refined with Huber's weights, and the better one is taken.

    Raises
    ------
    InputError
        If too few corners are seen, or none across the others.
    ValueError
        If the camera is orthographic.
    """
    if camera.kind != "perspective":
        raise ValueError(f"camera: {camera.kind} given; a perspective one is wanted")
    reason = refusal(board, found)
    if reason:
        raise InputError(reason)
    camera = replace(camera, R=np.eye(3), t=np.zeros(3))
    points = board.corners[found.ids]
    slope = undistort((found.xy - (camera.cx, camera.cy)) / (camera.fx, camera.fy), camera.distortion)
    _, turns, places, _ = cv2.solvePnPGeneric(points, slope, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE)
    tries = [
        _refined(Rotation.from_rotvec(np.ravel(turn)).as_matrix(), np.ravel(place), points, found.xy, camera)
        for turn, place in zip(turns, places, strict=True)
    ]
    tries = [one for one in tries if one is not None]
    if not tries:
        raise InputError("no pose in front of the camera explains the corners")
    best, *others = sorted(tries, key=lambda one: one.reprojection_px)
    return replace(best, other_px=others[0].reprojection_px) if others else best


def _refined(
    R: Float[np.ndarray, "3 3"],
    t: Float[np.ndarray, " 3"],
    points: Float[np.ndarray, "n 3"],
    xy: Float[np.ndarray, "n 2"],
    camera: Camera,
) -> Pose | None:
    """Gauss-Newton with weights from a start; None where corners come to lie behind the camera."""
    far, weight, normal = np.zeros(points.shape[0]), np.ones(points.shape[0]), np.eye(6)
    for turn in range(STEPS):
        seen, J = _linear(R, t, points, camera)
        if not np.isfinite(seen).all():
            return None
        error = xy - seen
        far = np.linalg.norm(error, axis=1)
        ratio = far / max(robust_sigma(error.ravel()), FINEST)
        # near the solution, corners that are plainly wrong are left out: many of them would pull, each a little
        weight = np.where((turn >= 3) & (ratio > WRONG), 0.0, huber_weight(ratio, 2.5))
        normal = np.einsum("nij,n,nik->jk", J, weight, J)
        step = np.linalg.lstsq(normal, np.einsum("nij,n,ni->j", J, weight, error), rcond=None)[0]
        t = t + R @ step[:3]
        R = R @ Rotation.from_rotvec(step[3:]).as_matrix()
        if np.abs(step).max() < SETTLED:
            break
    used = np.greater(weight, 0.5)
    free = max(2 * int(used.sum()) - 6, 0)
    variance = ((weight * far**2).sum() + WORTH * EXPECTED**2) / (free + WORTH)
    covariance = variance * np.linalg.pinv(normal, hermitian=True)
    rms = float(np.sqrt((far[used] ** 2).mean())) if used.any() else float("inf")
    return Pose(R, t, covariance, rms, int(used.sum()))


def _linear(
    R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, " 3"], points: Float[np.ndarray, "n 3"], camera: Camera
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 6"]]:
    """Pixels of the board's points and their derivative by a move in the board's frame."""
    seen, by_point = project_with_jacobian(camera, points @ R.T + t)
    by_place = by_point @ R
    return seen, np.concatenate([by_place, -by_place @ crosses(points)], axis=2)


def crosses(v: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """Matrices with `crosses(v) @ x = v x x`."""
    x, y, z = np.moveaxis(v, -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack(row, axis=-1) for row in ((o, -z, y), (z, o, -x), (-y, x, o))], axis=-2)


def average(poses: Sequence[Pose], gate: Gate | None = None) -> Mean:
    """Mean of poses of one thing.

    Around the pose that is nearest to all others, those within the gate are averaged by the inverse of their
    covariances, with Huber's weights; and again around that mean. The covariance grows where poses differ by more
    than theirs explain.

    Raises
    ------
    ValueError
        If there are no poses.

    >>> def at(x):
    ...     return Pose(np.eye(3), np.array([x, 0.0, 1.6]), 1e-6 * np.eye(6), 0.2, 24)
    >>> mean = average([at(0.0), at(0.002), at(0.4)])
    >>> round(mean.pose.t[0].item(), 6), mean.kept.tolist()
    (0.001, [True, True, False])
    """
    if not poses:
        raise ValueError("poses: none given; at least one is wanted")
    gate = Gate() if gate is None else gate
    R, t = np.stack([pose.R for pose in poses]), np.stack([pose.t for pose in poses])
    information = np.linalg.pinv(np.stack([pose.covariance for pose in poses]), hermitian=True)
    apart = np.stack([_apart(R, t, R[i], t[i], gate).sum(axis=1) for i in range(len(poses))])
    first = int(np.minimum(apart, 4.0).sum(axis=1).argmin())  # beyond the gate far is no worse than out
    mean_R, mean_t, covariance = R[first], t[first], poses[first].covariance
    kept = np.arange(len(poses)) == first
    for _ in range(3):
        near = np.all(_apart(R, t, mean_R, mean_t, gate) <= 1.0, axis=1)
        if not near.any():
            break
        kept = near
        mean_R, mean_t, covariance = _weighted(R[kept], t[kept], information[kept], mean_R, mean_t)
    used = [pose for pose, one in zip(poses, kept, strict=True) if one]
    rms = float(np.sqrt(np.mean([pose.reprojection_px**2 for pose in used])))
    return Mean(Pose(mean_R, mean_t, covariance, rms, sum(pose.corners for pose in used)), kept)


def _apart(
    R: Float[np.ndarray, "n 3 3"],
    t: Float[np.ndarray, "n 3"],
    to_R: Float[np.ndarray, "3 3"],
    to_t: Float[np.ndarray, " 3"],
    gate: Gate,
) -> Float[np.ndarray, "n 2"]:
    """Distances in place and turn, in units of the gate."""
    turn = Rotation.from_matrix(to_R.T @ R).magnitude()
    return np.column_stack([np.linalg.norm(t - to_t, axis=1) / gate.translation, turn / gate.rotation])


def _weighted(
    R: Float[np.ndarray, "n 3 3"],
    t: Float[np.ndarray, "n 3"],
    information: Float[np.ndarray, "n 6 6"],
    mean_R: Float[np.ndarray, "3 3"],
    mean_t: Float[np.ndarray, " 3"],
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"], Float[np.ndarray, "6 6"]]:
    """Weighted mean from a start near it, and its covariance."""
    surprise, weight, total = np.zeros(t.shape[0]), np.ones(t.shape[0]), information.sum(axis=0)
    for _ in range(STEPS):
        turn = Rotation.from_matrix(mean_R.T @ R).as_rotvec()
        move = np.concatenate([(t - mean_t) @ mean_R, turn], axis=1)
        surprise = np.einsum("ni,nij,nj->n", move, information, move)
        usual = max(float(np.median(surprise)) / 5.35, 1.0)  # 5.35: median of chi-square with 6 degrees of freedom
        weight = huber_weight(np.sqrt(surprise / usual), 4.0)
        total = np.einsum("n,nij->ij", weight, information)
        step = np.linalg.pinv(total, hermitian=True) @ np.einsum("n,nij,nj->i", weight, information, move)
        mean_t = mean_t + mean_R @ step[:3]
        mean_R = mean_R @ Rotation.from_rotvec(step[3:]).as_matrix()
        if np.abs(step).max() < SETTLED:
            break
    extra = float((weight * surprise).sum()) / max(6 * (t.shape[0] - 1), 1)
    return mean_R, mean_t, max(extra, 1.0) * np.linalg.pinv(total, hermitian=True)


def register(
    A_01: Float[np.ndarray, "n 4 4"], moving: Sequence[Pose], fixed: Sequence[Pose], gate: Gate | None = None
) -> Relation:
    """Place of the fixed camera in frame 0, from a board that both cameras see.

    Parameters
    ----------
    A_01 : (n, 4, 4)
        Poses of the moving camera in frame 0, rigid.
    moving : sequence of n poses
        Of the board in the moving camera's axes at those poses.
    fixed : sequence of Pose
        Of the board in the fixed camera's axes; any number, at any time.
    gate : Gate or None
        How far the board may seem to move.

    Raises
    ------
    ValueError
        If there is no pose, or not as many as places of the moving camera.
    """
    if A_01.shape[0] != len(moving):
        raise ValueError(f"A_01: {A_01.shape[0]} given; {len(moving)}, one for each pose of the board, are wanted")
    placed = [
        replace(pose, R=A[:3, :3] @ pose.R, t=A[:3, :3] @ pose.t + A[:3, 3])
        for A, pose in zip(A_01, moving, strict=True)
    ]
    in_zero, in_kin = average(placed, gate), average(fixed, gate)
    A = relate(np.eye(4), in_zero.pose.matrix, in_kin.pose.matrix)
    carry = adjoint(in_kin.pose.matrix)
    covariance = carry @ (in_zero.pose.covariance + in_kin.pose.covariance) @ carry.T
    return Relation(A, covariance, in_zero, in_kin)


def adjoint(A: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "6 6"]:
    """What a small move in one frame is in another: `A (I + [x]) A^-1 = I + [adjoint(A) x]`."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = A[:3, :3]
    out[:3, 3:] = crosses(A[:3, 3]) @ A[:3, :3]
    return out
