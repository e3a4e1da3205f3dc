"""Bodies that move between this frame and the next one: hands of pills, skinned hands, rigid occluders.

Each is given in its own axes, with joint values and a placement in the world for both frames. At the share s of the
frame interval joint values are q0 + s (q1 - q0), the origin moves along a straight line, and the axes turn about one
fixed axis: R(s) = R0 exp(s log(R0^T R1)).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from handtrack._kernels import skin
from handtrack.camera import Camera
from handtrack.kinematics import Model, forward
from handtrack.pills import Pills

from .solids import Keypoints, Kind, Solids


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """World placement of a body's own axes at this frame and the next: `p_world = R p + t`."""

    R: Float[np.ndarray, "2 3 3"]
    t: Float[np.ndarray, "2 3"]


@dataclass(frozen=True, slots=True, eq=False)
class PillHand:
    """A hand, or any tree, of pills, some of which may sit on its base.

    Attributes
    ----------
    mirrored : bool
        Whether it is the left hand of a model that describes a right one: x of its base frame is turned over.
    frame : (l,)
        Frame of the tree that carries each pill; -1 for the base.
    base, tip, radius : (l, 3), (l, 3), (l, 2)
        In that frame, millimetres.
    part : (l,)
        Part of each pill, counted within the body.
    part_names : tuple of str
    point_frame, point : (21,), (21, 3)
        Frame and place of each keypoint; NaN where there is none.
    point_parts : (21, n)
        Parts that each keypoint lies in, counted within the body.
    """

    model: Model
    mirrored: bool
    frame: Int[np.ndarray, " l"]
    base: Float[np.ndarray, "l 3"]
    tip: Float[np.ndarray, "l 3"]
    radius: Float[np.ndarray, "l 2"]
    part: Int[np.ndarray, " l"]
    part_names: tuple[str, ...]
    point_frame: Int[np.ndarray, " k"]
    point: Float[np.ndarray, "k 3"]
    point_parts: Bool[np.ndarray, "k n"]


@dataclass(frozen=True, slots=True, eq=False)
class MeshHand:
    """A skinned hand. Vertices and normals are given in the axes of each bone that moves them.

    Attributes
    ----------
    bone_frame : (b,)
        Frame of the tree that each bone is; -1 for the base.
    bone, weight : (v, w), (v, w)
        Bones of each vertex and their shares.
    local, local_normal : (v, w, 3), (v, w, 3)
    rest : (v, 3)
        Bind pose, where textures are defined.
    triangles, triangle_part : (t, 3), (t,)
    """

    model: Model
    left: bool
    bone_frame: Int[np.ndarray, " b"]
    bone: Int[np.ndarray, "v w"]
    weight: Float[np.ndarray, "v w"]
    local: Float[np.ndarray, "v w 3"]
    local_normal: Float[np.ndarray, "v w 3"]
    rest: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "t 3"]
    triangle_part: Int[np.ndarray, " t"]
    part_names: tuple[str, ...]
    point_frame: Int[np.ndarray, " k"]
    point: Float[np.ndarray, "k 3"]
    point_parts: Bool[np.ndarray, "k n"]


@dataclass(frozen=True, slots=True, eq=False)
class Rigid:
    """A stiff occluder of one part: pills or triangles in its own axes, millimetres."""

    kind: Kind
    pills: Pills
    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "t 3"]


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A shape in motion; `q` (2, j) holds the joint values of both frames (no columns for a rigid one)."""

    shape: PillHand | MeshHand | Rigid
    placed: Placed
    q: Float[np.ndarray, "2 j"]


def kind_of(shape: PillHand | MeshHand | Rigid) -> Kind:
    """Kind of an instance."""
    if isinstance(shape, Rigid):
        return shape.kind
    left = shape.left if isinstance(shape, MeshHand) else shape.mirrored
    return "left_hand" if left else "right_hand"


def placement_at(placed: Placed, s: float) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """World axes and origin of a body at the share s of the frame interval."""
    t = placed.t[0] + s * (placed.t[1] - placed.t[0])
    if s == 0.0:
        return placed.R[0], t
    if s == 1.0:
        return placed.R[1], t
    turn = Rotation.from_matrix(placed.R[0].T @ placed.R[1]).as_rotvec()
    return placed.R[0] @ Rotation.from_rotvec(s * turn).as_matrix(), t


def frames_at(body: Body, s: float) -> Float[np.ndarray, "f 4 4"]:
    """Frames of a body's tree in its own axes, its base last."""
    shape = body.shape
    if isinstance(shape, Rigid):
        return np.eye(4)[None]
    frames = forward(shape.model, body.q[0] + s * (body.q[1] - body.q[0]))
    return np.concatenate([frames, np.eye(4)[None]])


def solids_of(body: Body, s: float, camera: Camera, first: int) -> Solids:
    """Surfaces of a body in camera axes; its parts are numbered from `first`."""
    R, t = placement_at(body.placed, s)
    R, t = camera.R @ R, camera.R @ t + camera.t
    shape = body.shape
    if isinstance(shape, PillHand):
        return _pill_solids(shape, frames_at(body, s), R, t, first)
    if isinstance(shape, MeshHand):
        return _mesh_solids(shape, frames_at(body, s), R, t, first)
    pills = Pills(shape.pills.base @ R.T + t, shape.pills.tip @ R.T + t, shape.pills.radius)
    count = pills.base.shape[0]
    return Solids(
        pills,
        np.broadcast_to(R.T, (count, 3, 3)),
        np.full(count, first),
        shape.vertices @ R.T + t,
        shape.normals @ R.T,
        shape.vertices,
        shape.triangles,
        np.full(shape.triangles.shape[0], first),
    )


def points_of(body: Body, s: float, camera: Camera, first: int) -> Keypoints:
    """Keypoints of a hand in camera axes, and the bits of the parts they lie in."""
    shape = body.shape
    if isinstance(shape, Rigid):
        raise ValueError(f"body: a {shape.kind} has no keypoints; wanted a hand")
    R, t = placement_at(body.placed, s)
    F = frames_at(body, s)[shape.point_frame]
    p = (F[:, :3, :3] @ shape.point[:, :, None])[..., 0] + F[:, :3, 3]
    if isinstance(shape, PillHand) and shape.mirrored:
        p = p * (-1.0, 1.0, 1.0)
    bit = np.uint64(1) << np.arange(first, first + len(shape.part_names), dtype=np.uint64)
    own = (shape.point_parts * bit).sum(axis=1, dtype=np.uint64)
    p_cam = (p @ R.T + t) @ camera.R.T + camera.t
    return Keypoints(p_cam[None], own[None])


def _pill_solids(shape: PillHand, frames: Float[np.ndarray, "f 4 4"], R, t, first: int) -> Solids:
    """Pills of a posed hand; a mirrored hand's own axes are mirrored with it, so textures are too."""
    F = frames[shape.frame]
    turn, origin = F[:, :3, :3], F[:, :3, 3]
    base = (turn @ shape.base[:, :, None])[..., 0] + origin
    tip = (turn @ shape.tip[:, :, None])[..., 0] + origin
    axes = turn.transpose(0, 2, 1)
    if shape.mirrored:
        flip = np.array([-1.0, 1.0, 1.0])
        base, tip, axes = base * flip, tip * flip, axes * flip
    pills = Pills(base @ R.T + t, tip @ R.T + t, shape.radius)
    none = np.zeros((0, 3))
    return Solids(
        pills, axes @ R.T, shape.part + first, none, none, none, np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    )


def _mesh_solids(shape: MeshHand, frames: Float[np.ndarray, "f 4 4"], R, t, first: int) -> Solids:
    """Skin of a posed hand by linear blend skinning."""
    vertices, normals = np.empty(shape.rest.shape), np.empty(shape.rest.shape)
    skin.pose_skin(
        frames, shape.bone_frame, shape.bone, shape.weight, shape.local, shape.local_normal,
        np.ascontiguousarray(R), t, vertices, normals,
    )  # fmt: skip
    none = np.zeros((0, 3))
    return Solids(
        Pills(none, none, np.zeros((0, 2))),
        np.zeros((0, 3, 3)),
        np.zeros(0, np.int64),
        vertices,
        normals,
        shape.rest,
        shape.triangles,
        shape.triangle_part + first,
    )


def joined(solids: list[Solids]) -> Solids:
    """The surfaces of all bodies as one."""
    if len(solids) == 1:
        return solids[0]
    first = np.cumsum([0] + [s.vertices.shape[0] for s in solids])
    return Solids(
        Pills(
            np.concatenate([s.pills.base for s in solids]),
            np.concatenate([s.pills.tip for s in solids]),
            np.concatenate([s.pills.radius for s in solids]),
        ),
        np.concatenate([s.pill_axes for s in solids]),
        np.concatenate([s.pill_part for s in solids]),
        np.concatenate([s.vertices for s in solids]),
        np.concatenate([s.normals for s in solids]),
        np.concatenate([s.rest for s in solids]),
        np.concatenate([s.triangles + k for s, k in zip(solids, first, strict=False)]),
        np.concatenate([s.triangle_part for s in solids]),
    )
