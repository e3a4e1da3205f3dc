"""A model and a skinned mesh in, the surface tied to the model's frames out.

Every joint of the mesh follows a frame of the model. `index-finger-phalanx-proximal` follows the last frame at the
index finger's knuckle (`index_mcp`, after `index_abduction` where there is one), and so on; a joint that the model
does not have follows its nearest ancestor that is driven, and without one the palm: the last frame that all fingers
hang on, or the base. The pose and place at which the mesh was bound are those where the joints of both coincide best,

    min over q, X   sum_j w_j | origin_j(q) - X b_j |^2

over joint values q and similarities X (rotation, scale and shift, in closed form for each q). So one mesh serves hands
of any size; if its mirror image fits far better, model and mesh are of different sides and the mirror image is taken.
A mesh of another shape leaves a misfit that no pose mends; above a few millimetres it is refused.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares

from ..formats.glb import FINGERS, SkinnedMesh
from ..kinematics import Model, forward, link_ends, pose_from_free
from .skin import Surface, joint_tables, mesh_edges

_MOST_MISFIT = 2.0  # mm, root mean square over the joints
_SURELY, _CLEARLY = 0.2, 0.5  # mm of misfit at which no mirror image is tried, and how much better that must fit
_LEAST_BREADTH = 5.0  # mm across the line along which the joints spread most, root of the sum of squares
_TIP_WEIGHT = 0.02  # a model's last link ends where its cap begins, which is not where a mesh puts its tip
_LEAN = 1e-3  # mm for each radian: what no joint position tells stays near the middle of its range
_SPOKEN = {"thumb": 0, "index": 1, "middle": 2, "ring": 3, "little": 4, "pinky": 4}
_OF_FINGER = {"abduction": "proximal", "mcp": "proximal", "pip": "intermediate", "dip": "distal"}
_OF_THUMB = {
    "palmar": "metacarpal",
    "radial": "metacarpal",
    "cmc": "metacarpal",
    "abduction": "proximal",
    "mcp": "proximal",
    "ip": "distal",
}


def bind(
    model: Model, mesh: SkinnedMesh, drives: Sequence[tuple[str, str]] | None = None, most_misfit: float = _MOST_MISFIT
) -> Surface:
    """Tie a mesh to a model.

    Parameters
    ----------
    drives : sequence of (mesh joint, model joint)
        Which joint of the model each joint of the mesh follows; default by name, see `drives_by_name`.
    most_misfit : float
        Root mean square distance of the joints, mm, above which mesh and model are not of one hand.

    Raises
    ------
    ValueError
        If no joint can be matched, a name in `drives` is unknown, or the misfit is too large.
    """
    drives = drives_by_name(model, mesh.joint_names) if drives is None else tuple(drives)
    frame_of = _driving_frames(model, mesh, drives)
    found = _rest_pose(model, mesh, frame_of)
    if found.off > _SURELY:
        other = mirrored(mesh)
        its = _rest_pose(model, other, frame_of)
        mesh, found = (other, its) if its.off < _CLEARLY * found.off else (mesh, found)
    if not found.off <= most_misfit:
        raise ValueError(
            f"mesh: its joints lie {found.off:.1f} mm from those of model '{model.name}' at the best pose;"
            f" at most {most_misfit:.1f} mm is wanted: model and mesh of one hand"
        )
    driven = _followed(mesh, frame_of, _palm_frame(model, frame_of))
    return _tied(model, mesh, driven, found)


def drives_by_name(model: Model, joints: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Pairs of mesh joint and model joint whose names mean the same.

    A model joint's name is cut at underscores: one part names the finger (`thumb index middle ring little`), one the
    joint (`mcp pip dip abduction`, for the thumb `palmar radial cmc mcp abduction ip`).

    >>> from handtrack.kinematics.builtin import model
    >>> drives_by_name(model("index"), ["index-finger-phalanx-distal", "index-finger-tip"])
    (('index-finger-phalanx-distal', 'index_dip'),)
    """
    found = []
    for name in model.joint_names:
        words = name.lower().split("_")
        finger = next((_SPOKEN[word] for word in words if word in _SPOKEN), None)
        table = _OF_THUMB if finger == 0 else _OF_FINGER
        part = next((table[word] for word in words if word in table), None)
        if finger is None or part is None:
            continue
        joint = f"{FINGERS[finger]}-{part if part == 'metacarpal' else 'phalanx-' + part}"
        if joint in joints:
            found.append((joint, name))
    return tuple(found)


def _driving_frames(model: Model, mesh: SkinnedMesh, drives: Sequence[tuple[str, str]]) -> Int[np.ndarray, " j"]:
    """The last frame of those whose joints drive each mesh joint; -1 where none does."""
    if not drives:
        raise ValueError(
            f"model: no joint of '{model.name}' is named after a finger joint of the mesh; names such as index_mcp are"
            " wanted, or explicit drives"
        )
    frame_of = np.full(len(mesh.joint_names), -1)
    for joint, name in drives:
        if joint not in mesh.joint_names or name not in model.joint_names:
            raise ValueError(f"drives: ({joint!r}, {name!r}): a joint of the mesh and one of the model are wanted")
        frame = int(np.flatnonzero(model.joint == model.joint_names.index(name))[0])
        at = mesh.joint_names.index(joint)
        frame_of[at] = max(frame_of[at], frame)  # parents come first, so the larger index is farther out
    return frame_of


def _landmarks(
    model: Model, mesh: SkinnedMesh, frame_of: Int[np.ndarray, " j"]
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Mesh joints and frames whose origins should coincide, and mesh tips with the links that should end there."""
    joints = np.flatnonzero(frame_of >= 0)
    ends = {int(frame): link for link, frame in enumerate(model.link_frame) if model.link_is_tip[link]}
    tips, links = [], []
    for j, name in enumerate(mesh.joint_names):
        above = int(mesh.parent[j])
        if name.endswith("-tip") and above >= 0 and int(frame_of[above]) in ends:
            tips.append(j)
            links.append(ends[int(frame_of[above])])
    return joints, frame_of[joints], np.array(tips, dtype=int), np.array(links, dtype=int)


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """Joint values of the bind pose (j,), the similarity world from mesh (4, 4), and each joint's misfit (m,), mm."""

    rest: Float[np.ndarray, " j"]
    place: Float[np.ndarray, "4 4"]
    misfit: Float[np.ndarray, " m"]

    @property
    def off(self) -> float:
        """Root mean square of the misfit."""
        return float(np.sqrt(np.mean(self.misfit**2)))


def _rest_pose(model: Model, mesh: SkinnedMesh, frame_of: Int[np.ndarray, " j"]) -> _Fitted:
    """The bind pose that brings the joints of both closest."""
    joints, frames_at, tips, links = _landmarks(model, mesh, frame_of)
    wanted = np.concatenate([mesh.bind[joints, :3, 3], mesh.bind[tips, :3, 3]])
    size = np.linalg.svd(mesh.bind[joints, :3, 3] - mesh.bind[joints, :3, 3].mean(axis=0), compute_uv=False)
    if size.size < 3 or size[1] < _LEAST_BREADTH:
        raise ValueError(
            f"model: {joints.size} joints of '{model.name}' are found in the mesh, all on one line; those of two"
            " fingers are wanted, or nothing tells which way the hand is turned"
        )
    weight = np.concatenate([np.ones(joints.size), np.full(tips.size, _TIP_WEIGHT)])
    limits = model.limits[model.free]
    low, high = np.where(np.isfinite(limits), limits, [-math.pi, math.pi]).T
    middle = 0.5 * (low + high)
    slack = np.radians(40.0)  # a mesh may be bound with its fingers bent backwards further than the model allows

    def places(u: Float[np.ndarray, " k"]) -> Float[np.ndarray, "m 3"]:
        frames = forward(model, pose_from_free(model, u))
        return np.concatenate([frames[frames_at, :3, 3], link_ends(model, frames)[1][links]])

    def cost(u: Float[np.ndarray, " k"]) -> Float[np.ndarray, " m"]:
        there = places(u)
        left = there - _moved(_similarity(wanted, there, weight), wanted)
        return np.concatenate([(weight[:, None] * left).reshape(-1), _LEAN * (u - middle)])

    best = None
    for start in (np.clip(np.zeros(low.size), low, high), middle):
        found = least_squares(cost, start, bounds=(low - slack, high + slack), xtol=1e-12, ftol=1e-12, gtol=1e-12)
        best = found if best is None or found.cost < 0.999 * best.cost else best
    u = best.x
    there = places(u)
    place = _similarity(wanted, there, weight)
    off = np.linalg.norm(there - _moved(place, wanted), axis=1)
    return _Fitted(pose_from_free(model, u), place, off[: joints.size])


def mirrored(mesh: SkinnedMesh) -> SkinnedMesh:
    """The other hand: mirrored in x, with its triangles turned round so that they still face outwards."""
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    return replace(
        mesh,
        vertices=mesh.vertices @ flip[:3, :3],
        normals=mesh.normals @ flip[:3, :3],
        triangles=np.ascontiguousarray(mesh.triangles[:, ::-1]),
        bind=flip @ mesh.bind @ flip,
    )


def _similarity(
    source: Float[np.ndarray, "m 3"], target: Float[np.ndarray, "m 3"], weight: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "4 4"]:
    """Rotation, scale and shift that take points to points with the least weighted squared distance (Umeyama 1991)."""
    w = (weight**2 / (weight**2).sum())[:, None]
    from_middle, to_middle = (w * source).sum(axis=0), (w * target).sum(axis=0)
    spread = w * (source - from_middle)
    left, size, right = np.linalg.svd((target - to_middle).T @ spread)
    flip = np.array([1.0, 1.0, np.linalg.det(left @ right)])
    scale = float((size * flip).sum()) / max(float((spread * (source - from_middle)).sum()), 1e-12)
    out = np.eye(4)
    out[:3, :3] = scale * (left * flip) @ right
    out[:3, 3] = to_middle - out[:3, :3] @ from_middle
    return out


def _moved(transform: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 3"]:
    return points @ transform[:3, :3].T + transform[:3, 3]


def _palm_frame(model: Model, frame_of: Int[np.ndarray, " j"]) -> int:
    """The last frame that all driven frames hang on; -1 for the base."""
    common: list[int] | None = None
    for frame in frame_of[frame_of >= 0].tolist():
        line = []
        at = int(model.parent[frame])
        while at >= 0:
            line.append(at)
            at = int(model.parent[at])
        common = line if common is None else [f for f in common if f in line]
    return max(common) if common else -1


def _followed(mesh: SkinnedMesh, frame_of: Int[np.ndarray, " j"], palm: int) -> Int[np.ndarray, " j"]:
    """The frame that each mesh joint follows: its own, or that of its nearest driven ancestor, or the palm's."""
    out = np.full(frame_of.size, palm)
    for j in range(frame_of.size):
        at = j
        while at >= 0 and frame_of[at] < 0:
            at = int(mesh.parent[at])
        out[j] = frame_of[at] if at >= 0 else palm
    return out


def _tied(
    model: Model,
    mesh: SkinnedMesh,
    driven: Int[np.ndarray, " j"],
    found: _Fitted,
) -> Surface:
    """Weights gathered by frame, and vertices in the axes of their frames."""
    rest, place = found.rest, found.place
    scale = float(np.cbrt(np.linalg.det(place[:3, :3])))
    used = np.unique(driven)
    shares = np.zeros((mesh.vertices.shape[0], used.size))
    np.add.at(
        shares,
        (np.arange(shares.shape[0])[:, None], np.searchsorted(used, driven)[mesh.joint]),
        mesh.weight,
    )
    width = max(int((shares > 1e-6).sum(axis=1).max()), 1)
    bone = np.argsort(-shares, axis=1, kind="stable")[:, :width]
    weight = np.take_along_axis(shares, bone, axis=1)
    weight = np.where(weight > 1e-6, weight, 0.0)
    weight = weight / weight.sum(axis=1, keepdims=True)
    world = _moved(place, mesh.vertices)
    normal = mesh.normals @ place[:3, :3].T / scale
    frames = np.concatenate([forward(model, rest), np.eye(4)[None]])[used[bone]]
    turn = np.swapaxes(frames[..., :3, :3], -1, -2)
    region, link, finger = _regions(model, rest, world, mesh.triangles, used, shares)
    edge, edge_side = mesh_edges(world, mesh.triangles)
    moves, joint_frame = joint_tables(model)
    return Surface(
        model=model,
        moves=moves,
        joint_frame=joint_frame,
        bone_frame=used,
        bone=bone,
        weight=weight,
        local=(turn @ (world[:, None] - frames[..., :3, 3])[..., None])[..., 0],
        local_normal=(turn @ normal[:, None, :, None])[..., 0],
        triangles=mesh.triangles,
        region=region,
        link=link,
        finger=finger,
        edge=edge,
        edge_side=edge_side,
        rest=rest,
        misfit=found.misfit,
        scale=scale,
    )


def _regions(
    model: Model,
    rest: Float[np.ndarray, " j"],
    world: Float[np.ndarray, "v 3"],
    triangles: Int[np.ndarray, "t 3"],
    used: Int[np.ndarray, " b"],
    shares: Float[np.ndarray, "v b"],
) -> tuple[Int[np.ndarray, " t"], Int[np.ndarray, " t"], Int[np.ndarray, " r"]]:
    """Region and nearest link of each triangle, and the finger of each region."""
    links = model.link_frame.size
    of_bone = np.full(used.size, links)
    for b, frame in enumerate(used.tolist()):
        at = frame
        while at >= 0 and at not in model.link_frame:
            at = int(model.parent[at])
        if at >= 0:
            of_bone[b] = int(np.flatnonzero(model.link_frame == at)[0])
    region = of_bone[shares[triangles].sum(axis=1).argmax(axis=1)]
    base, tip = link_ends(model, forward(model, rest))
    middle, axis = world[triangles].mean(axis=1), tip - base
    along = ((middle[:, None] - base) * axis).sum(axis=2) / np.maximum((axis * axis).sum(axis=1), 1e-9)
    near = base + np.clip(along, 0.0, 1.0)[..., None] * axis
    nearest = np.linalg.norm(middle[:, None] - near, axis=2).argmin(axis=1) if links else np.zeros(len(region), int)
    own = region < links
    # A link that several fingers hang on is part of the palm.
    finger = np.append(model.link_finger, -1)
    branching = np.bincount(model.link_parent[model.link_parent >= 0], minlength=links) > 1
    finger[:links][branching] = -1
    return region, np.where(own, region, nearest), finger
