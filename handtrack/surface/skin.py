"""A bound surface and a pose in, posed vertices, normals and the motion of surface points out: linear blend skinning.

    v(q) = sum_b w_b  world_T_b(q) world_T_b(q_rest)^-1 v_rest

with the frames b of the Denavit-Hartenberg tree for bones, and the base frame for what no joint moves. Normals are
blended by the same rotations. A point fixed to frame b moves like any point of the tree (`point_jacobian`), so the
derivative of a skinned point is the weighted sum of those.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .._kernels import skin as kernels
from ..camera import Camera, camera_from_world
from ..kinematics import Model, forward, joints_below, point_jacobian, pose_from_free


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A skinned mesh driven by the frames of a model; made by `bind`.

    Attributes
    ----------
    bone_frame : (b,)
        Frame of the model that each bone is; -1 for the base frame.
    bone, weight : (v, w), (v, w)
        Bones of each vertex and their shares, which sum to one.
    local, local_normal : (v, w, 3), (v, w, 3)
        Vertex and normal in the axes of each of its bones, mm.
    triangles : (t, 3)
        Counter-clockwise seen from outside.
    region, link : (t,), (t,)
        Link that moves each triangle most, `l` (one beyond the links) where no link does; and the link nearest to it.
    finger : (l + 1,)
        Finger of each region; -1 for the palm, which belongs to all.
    edge, edge_side : (e, 2), (e, 2)
        Vertices of each edge of the mesh, and the triangles on its two sides (the second -1 where the mesh ends).
    rest : (j,)
        Joint values of the bind pose, radians.
    misfit : (m,)
        Distances between the mesh's joints and the model's at that pose, mm.
    scale : float
        By which the mesh was made larger to fit the model.
    """

    model: Model
    moves: Bool[np.ndarray, "f j"]
    joint_frame: Int[np.ndarray, " j"]
    bone_frame: Int[np.ndarray, " b"]
    bone: Int[np.ndarray, "v w"]
    weight: Float[np.ndarray, "v w"]
    local: Float[np.ndarray, "v w 3"]
    local_normal: Float[np.ndarray, "v w 3"]
    triangles: Int[np.ndarray, "t 3"]
    region: Int[np.ndarray, " t"]
    link: Int[np.ndarray, " t"]
    finger: Int[np.ndarray, " r"]
    edge: Int[np.ndarray, "e 2"]
    edge_side: Int[np.ndarray, "e 2"]
    rest: Float[np.ndarray, " j"]
    misfit: Float[np.ndarray, " m"]
    scale: float


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """Posed vertices and unit normals, in camera axes."""

    p: Float[np.ndarray, "v 3"]
    normal: Float[np.ndarray, "v 3"]


def pose_skin(surface: Surface, camera: Camera, u: Float[np.ndarray, " k"]) -> Skin:
    """The surface at the independent joint values u, in camera axes."""
    frames = forward(surface.model, pose_from_free(surface.model, u))
    count = surface.weight.shape[0]
    p, normal = np.empty((count, 3)), np.empty((count, 3))
    kernels.pose_skin(
        frames,
        surface.bone_frame,
        surface.bone,
        surface.weight,
        surface.local,
        surface.local_normal,
        camera.R,
        camera.t,
        p,
        normal,
    )
    return Skin(p, normal)


def posed_numpy(surface: Surface, camera: Camera, u: Float[np.ndarray, " k"]) -> Skin:
    """The same as `pose_skin` in plain NumPy: the twin of the compiled kernel."""
    frames = forward(surface.model, pose_from_free(surface.model, u))
    bones = np.concatenate([frames, np.eye(4)[None]])[surface.bone_frame][surface.bone]
    turn, weight = bones[..., :3, :3], surface.weight[..., None]
    p = (weight * ((turn @ surface.local[..., None])[..., 0] + bones[..., :3, 3])).sum(axis=1)
    normal = (weight * (turn @ surface.local_normal[..., None])[..., 0]).sum(axis=1)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(size > 0.0, size, 1.0)
    return Skin(camera_from_world(camera, p), normal @ camera.R.T)


def edge_points(
    surface: Surface, vertex: Int[np.ndarray, "n 2"], share: Float[np.ndarray, " n"], u: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 k"]]:
    """Points between two vertices, `(1 - share) v_0 + share v_1`, in world axes, and their derivative by u."""
    frames = forward(surface.model, pose_from_free(surface.model, u))
    p, J = np.empty((share.size, 3)), np.empty((share.size, 3, len(surface.model.joint_names)))
    kernels.contact_points(
        frames,
        surface.bone_frame,
        surface.bone,
        surface.weight,
        surface.local,
        surface.moves,
        surface.joint_frame,
        surface.model.prismatic,
        vertex,
        share,
        p,
        J,
    )
    return p, J @ surface.model.coupling


def points_numpy(
    surface: Surface, vertex: Int[np.ndarray, "n 2"], share: Float[np.ndarray, " n"], u: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 k"]]:
    """The same as `edge_points` in plain NumPy: the twin of the compiled kernel."""
    model = surface.model
    frames = forward(model, pose_from_free(model, u))
    extended = np.concatenate([frames, np.eye(4)[None]])
    p, J = np.zeros((share.size, 3)), np.zeros((share.size, 3, len(model.joint_names)))
    for side, part in enumerate((1.0 - share, share)):
        for i in range(surface.weight.shape[1]):
            v = vertex[:, side]
            frame, w = surface.bone_frame[surface.bone[v, i]], surface.weight[v, i] * part
            point = (extended[frame][:, :3, :3] @ surface.local[v, i][..., None])[..., 0] + extended[frame][:, :3, 3]
            moved = point_jacobian(model, frames, np.maximum(frame, 0), point) * (frame >= 0)[:, None, None]
            p, J = p + w[:, None] * point, J + w[:, None, None] * moved
    return p, J @ model.coupling


def vertex_normals(
    surface: Surface, vertex: Int[np.ndarray, " n"], u: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 k"]]:
    """Unit normals of vertices, world axes, and their derivative by u."""
    frames = forward(surface.model, pose_from_free(surface.model, u))
    normal, J = np.empty((vertex.size, 3)), np.empty((vertex.size, 3, len(surface.model.joint_names)))
    kernels.normal_motion(
        frames,
        surface.bone_frame,
        surface.bone,
        surface.weight,
        surface.local_normal,
        surface.moves,
        surface.joint_frame,
        surface.model.prismatic,
        vertex,
        normal,
        J,
    )
    return normal, J @ surface.model.coupling


def normals_numpy(
    surface: Surface, vertex: Int[np.ndarray, " n"], u: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 k"]]:
    """The same as `vertex_normals` in plain NumPy: the twin of the compiled kernel."""
    model = surface.model
    frames = forward(model, pose_from_free(model, u))
    bones = np.concatenate([frames, np.eye(4)[None]])[surface.bone_frame][surface.bone[vertex]]
    parts = surface.weight[vertex][..., None] * (bones[..., :3, :3] @ surface.local_normal[vertex][..., None])[..., 0]
    axis = frames[surface.joint_frame, :3, 2] * ~model.prismatic[surface.joint_frame][:, None]
    frame = surface.bone_frame[surface.bone[vertex]]
    turned = (
        np.cross(axis[None, None], parts[:, :, None])
        * (surface.moves[np.maximum(frame, 0)] & (frame >= 0)[..., None])[..., None]
    )
    normal, J = parts.sum(axis=1), np.swapaxes(turned.sum(axis=1), 1, 2)
    size = np.linalg.norm(normal, axis=1)
    normal = normal / size[:, None]
    J = (J - normal[..., None] * (normal[:, None] @ J)) / size[:, None, None]
    return normal, J @ model.coupling


def mesh_edges(
    places: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "t 3"]
) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, "e 2"]]:
    """Edges of a mesh and the triangles beside them; vertices at one place (a seam of the texture) count as one.

    Where more than two triangles meet in an edge, the first two are kept.

    >>> square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    >>> edge, side = mesh_edges(square, np.array([[0, 1, 2], [0, 2, 3]]))
    >>> edge.tolist(), side.tolist()
    ([[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]], [[0, -1], [0, 1], [1, -1], [0, -1], [1, -1]])
    """
    _, first, same = np.unique(np.round(places, 6), axis=0, return_index=True, return_inverse=True)
    of = first[same.reshape(-1)][triangles]
    ends = np.sort(np.concatenate([of[:, [0, 1]], of[:, [1, 2]], of[:, [2, 0]]]), axis=1)
    beside = np.tile(np.arange(triangles.shape[0]), 3)
    real = ends[:, 0] != ends[:, 1]
    ends, beside = ends[real], beside[real]
    order = np.lexsort((beside, ends[:, 1], ends[:, 0]))
    ends, beside = ends[order], beside[order]
    new = np.ones(ends.shape[0], dtype=bool)
    new[1:] = (ends[1:] != ends[:-1]).any(axis=1)
    at = np.flatnonzero(new)
    following = np.minimum(at + 1, ends.shape[0] - 1)
    paired = (at + 1 < ends.shape[0]) & ~new[following]
    return ends[at], np.stack([beside[at], np.where(paired, beside[following], -1)], axis=1)


def joint_tables(model: Model) -> tuple[Bool[np.ndarray, "f j"], Int[np.ndarray, " j"]]:
    """Which joints move which frame, and the frame of each joint."""
    joint_frame = np.empty(len(model.joint_names), dtype=np.int64)
    moved = np.flatnonzero(model.joint >= 0)
    joint_frame[model.joint[moved]] = moved
    return joints_below(model), joint_frame
