"""A hand and where its base goes in, a model that a tracker can follow, its joint values and its camera out.

Trackers know a tree on a base that stands still. A base that moves is put on six joints, of which three slide along
z, y and x and three turn: `T = Tz Ty Tx Rz(wrist_yaw) Ry(wrist_pitch) Rx(wrist_roll)` in the axes that the base has in
the first frame. Each is a row of eq. (2.1) of the hand thesis; fixed frames turn the axes back between them.

A left hand is the model mirrored: with `M = diag(1, 1, -1)` in the axes of every frame, `M T M` negates alpha and d of
eq. (2.1) and leaves a and theta, so that joint values stay what they are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from handtrack.camera import Camera
from handtrack.formats.model_writing import dh_parameters, exact_couplings
from handtrack.kinematics import Model
from handtrack.kinematics.tree import FrameRow, link_transform, model_from_rows

from ..labels.bodies import MeshHand, PillHand, Rigid
from ..labels.shot import Shot

STILL = 1e-9  # change of a placement, in parts of its size, that is none
WRIST = ("wrist_z", "wrist_y", "wrist_x", "wrist_yaw", "wrist_pitch", "wrist_roll")
_MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])
_HALF_TURN = np.diag([-1.0, 1.0, -1.0])  # from the mirrored frames to the mirrored base: diag(-1, 1, 1) M
_QUARTER = np.pi / 2


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What a tracker needs of one hand in one sequence.

    Attributes
    ----------
    q : (m, j)
        True joint values; radians, millimetres where a joint slides.
    """

    model: Model
    camera: Camera
    q: Float[np.ndarray, "m j"]


def tracked(shots: Sequence[Shot]) -> Tracked | None:
    """The first hand of a sequence as a tracker's input; None where no image has a hand.

    Parameters
    ----------
    shots : sequence of Shot
        All frames of one sequence, in order.

    Raises
    ------
    ValueError
        If the frames are not of one camera and one hand.
    """
    hands = [next((body for body in shot.bodies if not isinstance(body.shape, Rigid)), None) for shot in shots]
    first = hands[0] if hands else None
    if first is None or isinstance(first.shape, Rigid):
        return None
    if any(hand is None or hand.q.shape != first.q.shape for hand in hands):
        raise ValueError("shots: their first hands differ; frames of one sequence are wanted")
    mirrored = isinstance(first.shape, PillHand) and first.shape.mirrored
    turn = _HALF_TURN if mirrored else np.eye(3)
    poses = np.tile(np.eye(4), (len(shots), 1, 1))
    for pose, shot, hand in zip(poses, shots, hands, strict=True):
        if hand is not None:
            pose[:3, :3] = shot.camera.R @ hand.placed.R[0] @ turn
            pose[:3, 3] = shot.camera.R @ hand.placed.t[0] + shot.camera.t
    q = np.stack([hand.q[0] for hand in hands if hand is not None])
    camera = replace(shots[0].camera, R=poses[0, :3, :3], t=poses[0, :3, 3])
    moved = np.linalg.inv(poses[0]) @ poses
    if np.abs(moved - np.eye(4)).max() <= STILL * max(1.0, np.abs(poses[0]).max()):
        return Tracked(hand_model(first.shape, moves=False), camera, q)
    angles = Rotation.from_matrix(moved[:, :3, :3]).as_euler("ZYX")
    return Tracked(hand_model(first.shape, moves=True), camera, np.hstack([moved[:, 2::-1, 3], angles, q]))


def hand_model(shape: PillHand | MeshHand, moves: bool) -> Model:
    """The tree of a hand, mirrored if it is a left one of pills, with its palm and six joints for a base that moves.

    Raises
    ------
    ValueError
        For a mirrored model with a joint that slides.
    """
    model = shape.model
    mirrored = isinstance(shape, PillHand) and shape.mirrored
    if mirrored and model.prismatic.any():
        raise ValueError(f"shape: mirrored model '{model.name}' has a joint that slides; turning joints are wanted")
    start = int(model.frame_ids.max()) + 1
    base = base_rows(start) if moves else []
    rows = base + _hand_rows(shape, mirrored, base[-1].id if base else 0)
    return model_from_rows(model.name, rows, [*exact_couplings(model), *model.soft_couplings], model.units)


def base_rows(start: int) -> list[FrameRow]:
    """Rows, numbered from `start`, that carry a frame anywhere; the last one is that frame."""
    slide = [(0.0, 0.0, WRIST[0]), (-_QUARTER, -_QUARTER, WRIST[1]), (-_QUARTER, 0.0, WRIST[2])]
    spin = [(0.0, 0.0, WRIST[3]), (-_QUARTER, -_QUARTER, WRIST[4]), (-_QUARTER, 0.0, WRIST[5])]
    rows, id = [], start
    for group, prismatic in ((slide, True), (spin, False)):
        turned = np.eye(4)
        for alpha, theta, joint in group:
            parent = rows[-1].id if rows else 0
            rows.append(FrameRow(id, parent, alpha=alpha, theta=theta, joint=joint, prismatic=prismatic))
            turned = turned @ link_transform(alpha, 0.0, 0.0, theta)
            id += 1
        rows.append(FrameRow(id, rows[-1].id, transform=np.round(np.linalg.inv(turned))))
        id += 1
    return rows


def _hand_rows(shape: PillHand | MeshHand, mirrored: bool, base: int) -> list[FrameRow]:
    """Rows of the hand's own tree, and of the pills that sit on its base."""
    model = shape.model
    sign = -1.0 if mirrored else 1.0
    flip = np.array([1.0, 1.0, sign])
    radius = shape.radius if isinstance(shape, PillHand) else model.link_radius
    rows = []
    for i, id in enumerate(model.frame_ids.tolist()):
        parent = int(model.frame_ids[model.parent[i]]) if model.parent[i] >= 0 else base
        joint = int(model.joint[i])
        row = FrameRow(id, parent, transform=_mirrored(model.prefix[i], mirrored))
        if joint >= 0:
            alpha, a, d, theta = dh_parameters(model.prefix[i]) or (0.0, 0.0, 0.0, 0.0)
            row = FrameRow(
                id, parent, sign * np.radians(alpha), a, sign * d, np.radians(theta), model.joint_names[joint],
                bool(model.prismatic[i]), tuple(model.limits[joint].tolist()),
            )  # fmt: skip
        for link in np.flatnonzero(model.link_frame == i).tolist():
            length = float(model.link_length[link])
            at, end = model.link_base[link] * flip, model.link_tip[link] * flip - (length, 0.0, 0.0)
            row = replace(
                row, link_length=length, link_radius=tuple(radius[link].tolist()),
                link_base_offset=tuple(at.tolist()), link_tip_offset=tuple(end.tolist()),
            )  # fmt: skip
        rows.append(row)
    return rows + (_palm_rows(shape, mirrored, base, 1000) if isinstance(shape, PillHand) else [])


def _mirrored(T: Float[np.ndarray, "4 4"], mirrored: bool) -> Float[np.ndarray, "4 4"]:
    return _MIRROR @ T @ _MIRROR if mirrored else T


def _palm_rows(shape: PillHand, mirrored: bool, base: int, start: int) -> list[FrameRow]:
    """Fixed frames whose x axes run along the pills that sit on the base."""
    rows = []
    for pill in np.flatnonzero(shape.frame < 0).tolist():
        along = shape.tip[pill] - shape.base[pill]
        length = float(np.linalg.norm(along))
        x = along / length
        side = np.cross(x, np.eye(3)[int(np.argmin(np.abs(x)))])
        y = side / np.linalg.norm(side)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = np.column_stack([x, y, np.cross(x, y)]), shape.base[pill]
        T = _mirrored(T, mirrored)
        rows.append(
            FrameRow(
                start + len(rows), base, transform=T, link_length=length, link_radius=tuple(shape.radius[pill].tolist())
            )
        )
    return rows
