"""Denavit-Hartenberg trees: rows of a table in, link frames and analytic Jacobians out.

Modified (Craig) convention of the hand thesis, eq. (2.1): every frame sits on its parent by

    parent_T_frame = Rot_x(alpha_{i-1}) Trans_x(a_{i-1}) Rot_z(theta_i) Trans_z(d_i)

and the chain is multiplied together as in eq. (2.2). Everything that does not move is folded into one constant
`prefix`, so that a joint only ever turns about, or slides along, the z axis of its own frame.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .. import _kernels
from .couplings import Coupling, coupling_matrix, soft_rows
from .order import parents_first


@dataclass(frozen=True, slots=True, eq=False)
class LinkSigmas:
    """Standard deviations of a link's shape, model units: length, the two radii, and the offsets of the two ends."""

    length: float = 0.0
    radius: tuple[float, float] = (0.0, 0.0)
    base_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tip_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class FrameRow:
    """One row of a modified Denavit-Hartenberg table (hand thesis, eq. (2.1)); radians and model units.

    Attributes
    ----------
    id, parent : int
        Positive frame number, and the frame it sits on; 0 is the base frame.
    alpha, a, d, theta : float
        `alpha_{i-1}`, `a_{i-1}`, `d_i`, `theta_i`. For the variable that moves this is its offset.
    joint : str or None
        Name of the joint that moves `theta` (or `d` if `prismatic`); None for a fixed frame.
    limits : (float, float)
        Range of the joint.
    transform : (4, 4) or None
        Fixed transform used instead of the four parameters; a row with a transform has no joint.
    link_length, link_radius : float, (float, float)
        A pill along the x axis of this frame, with its radius at the base and at the tip; None for no body.
    link_base_offset, link_tip_offset : (float, float, float) or None
        Added to the centres (0, 0, 0) and (link_length, 0, 0) of the pill's end spheres, in the axes of this frame.
    link_sigmas : LinkSigmas or None
        How well the shape is known; None where it is taken as exact.
    link_buried : float
        Share of the link, from its base, whose outline is not looked at.
    """

    id: int
    parent: int
    alpha: float = 0.0
    a: float = 0.0
    d: float = 0.0
    theta: float = 0.0
    joint: str | None = None
    prismatic: bool = False
    limits: tuple[float, float] = (-math.inf, math.inf)
    transform: Float[np.ndarray, "4 4"] | None = None
    link_length: float | None = None
    link_radius: tuple[float, float] | None = None
    link_base_offset: tuple[float, float, float] | None = None
    link_tip_offset: tuple[float, float, float] | None = None
    link_sigmas: LinkSigmas | None = None
    link_buried: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A tree of frames with joints and pill-shaped links, as parallel arrays.

    Attributes
    ----------
    frame_ids, parent : (f,)
        Number of each frame in its file, and the index of its parent in these arrays (-1: the base frame {0}).
        Parents come before their children.
    prefix : (f, 4, 4)
        Constant part of `parent_T_frame`; the joint's motion about or along z multiplies it from the right.
    joint, prismatic : (f,)
        Index of the joint that moves the frame (-1: fixed), and whether it slides.
    joint_names, limits : (j,), (j, 2)
        Radians (model units for prismatic joints).
    free, coupling, coupling_offset : (k,), (j, k), (j,)
        Independent joints `u`, and `q = coupling @ u + coupling_offset`.
    soft, soft_target, soft_couplings : (c, k), (c,), tuple of Coupling
        Soft couplings, `soft @ u - soft_target` standard normal, and as they were given.
    link_frame, link_length, link_radius : (l,), (l,), (l, 2)
        Pills along the x axes of their frames.
    link_base, link_tip : (l, 3), (l, 3)
        Centres of the pills' end spheres in their frames: (0, 0, 0) and (length, 0, 0) unless the shape is offset.
    link_sigmas : tuple of LinkSigmas or None
        How well each link's shape is known; None where it is taken as exact.
    shape_factor : (7l, 7l) or None
        Lower triangle F: the shapes of all links, seven parameters each, have covariance `F F^T`. None where only
        `link_sigmas` tell.
    link_buried : (l,) or None
        Share of each link, from its base, whose outline is not looked at: it sits in a palm the model lacks.
    link_finger, link_is_tip, link_parent : (l,)
        Group of links that lead to the same tip, whether the link ends its chain, and the nearest link below it (-1).
    """

    name: str
    units: str
    frame_ids: Int[np.ndarray, " f"]
    parent: Int[np.ndarray, " f"]
    prefix: Float[np.ndarray, "f 4 4"]
    joint: Int[np.ndarray, " f"]
    prismatic: Bool[np.ndarray, " f"]
    joint_names: tuple[str, ...]
    limits: Float[np.ndarray, "j 2"]
    free: Int[np.ndarray, " k"]
    coupling: Float[np.ndarray, "j k"]
    coupling_offset: Float[np.ndarray, " j"]
    soft: Float[np.ndarray, "c k"]
    soft_target: Float[np.ndarray, " c"]
    soft_couplings: tuple[Coupling, ...]
    link_frame: Int[np.ndarray, " l"]
    link_length: Float[np.ndarray, " l"]
    link_radius: Float[np.ndarray, "l 2"]
    link_base: Float[np.ndarray, "l 3"]
    link_tip: Float[np.ndarray, "l 3"]
    link_sigmas: tuple[LinkSigmas | None, ...]
    link_finger: Int[np.ndarray, " l"]
    link_is_tip: Bool[np.ndarray, " l"]
    link_parent: Int[np.ndarray, " l"]
    shape_factor: Float[np.ndarray, "p p"] | None = None
    link_buried: Float[np.ndarray, " l"] | None = None


def link_transform(alpha: float, a: float, d: float, theta: float) -> Float[np.ndarray, "4 4"]:
    """`{i-1}_T_{i}` of the hand thesis, eq. (2.1).

    >>> link_transform(0.0, 2.0, 0.0, 0.0)[:3, 3].round(3).tolist()
    [2.0, -0.0, 0.0]
    """
    ct, st, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    return np.array(
        [
            [ct, -st, 0.0, a],
            [st * ca, ct * ca, -sa, -sa * d],
            [st * sa, ct * sa, ca, ca * d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def model_from_rows(
    name: str, rows: Sequence[FrameRow], couplings: Sequence[Coupling] = (), units: str = "mm"
) -> Model:
    """Build a model from the rows of its Denavit-Hartenberg table.

    Parameters
    ----------
    rows : sequence of FrameRow
        In any order; ids unique and positive, parents present, no cycle.
    couplings : sequence of Coupling
        Joints that follow others linearly, exactly or within a sigma.

    Raises
    ------
    ValueError
        For a table that is not a tree, has no joint, names a joint twice, or couples joints in a circle.
    """
    rows = parents_first(rows)
    index = {row.id: i for i, row in enumerate(rows)}
    names = _joint_names(name, rows)
    parent = np.array([index[row.parent] if row.parent else -1 for row in rows])
    prefix = np.stack(
        [
            row.transform if row.transform is not None else link_transform(row.alpha, row.a, row.d, row.theta)
            for row in rows
        ]
    )
    free, coupling, offset = coupling_matrix(tuple(names), couplings)
    soft, soft_target = soft_rows(tuple(names), couplings, coupling, offset)
    links = [i for i, row in enumerate(rows) if row.link_length is not None]
    link_finger, link_is_tip, link_parent = _link_groups(parent, np.array(links, dtype=int))
    return Model(
        name=name,
        units=units,
        frame_ids=np.array([row.id for row in rows]),
        parent=parent,
        prefix=prefix.astype(float),
        joint=np.array([names.index(row.joint) if row.joint is not None else -1 for row in rows]),
        prismatic=np.array([row.prismatic for row in rows]),
        joint_names=tuple(names),
        limits=np.array([row.limits for row in rows if row.joint is not None], dtype=float),
        free=free,
        coupling=coupling,
        coupling_offset=offset,
        soft=soft,
        soft_target=soft_target,
        soft_couplings=tuple(coupling for coupling in couplings if coupling.sigma is not None),
        link_frame=np.array(links, dtype=int),
        link_length=np.array([rows[i].link_length for i in links], dtype=float),
        link_radius=np.array([rows[i].link_radius for i in links], dtype=float).reshape(-1, 2),
        link_base=np.array([rows[i].link_base_offset or (0.0, 0.0, 0.0) for i in links], float).reshape(-1, 3),
        link_tip=np.array(
            [np.add((rows[i].link_length or 0.0, 0.0, 0.0), rows[i].link_tip_offset or (0.0, 0.0, 0.0)) for i in links],
            float,
        ).reshape(-1, 3),
        link_sigmas=tuple(rows[i].link_sigmas for i in links),
        link_finger=link_finger,
        link_is_tip=link_is_tip,
        link_parent=link_parent,
        link_buried=np.array([rows[i].link_buried for i in links]) if any(row.link_buried for row in rows) else None,
    )


def _joint_names(name: str, rows: Sequence[FrameRow]) -> list[str]:
    """Names of the joints in the order of their rows, all checked."""
    names = [row.joint for row in rows if row.joint is not None]
    if not names:
        raise ValueError(f"rows: model '{name}' has no joint; at least one is needed")
    for joint in names:
        if names.count(joint) > 1:
            raise ValueError(f"rows: joint '{joint}' is named twice; joint names are unique")
    for row in rows:
        if row.link_length is not None and row.link_radius is None:
            raise ValueError(f"rows: frame {row.id} has a link without a radius; both length and radius are needed")
        if not row.limits[0] < row.limits[1]:
            raise ValueError(f"rows: joint '{row.joint}' has limits {row.limits}; the lower must be below the upper")
    return names


def _link_groups(
    parent: Int[np.ndarray, " f"], links: Int[np.ndarray, " l"]
) -> tuple[Int[np.ndarray, " l"], Bool[np.ndarray, " l"], Int[np.ndarray, " l"]]:
    """Finger number, tip flag and parent link of each link; a finger is what leads to exactly one tip."""
    is_link = np.zeros(parent.size, dtype=bool)
    is_link[links] = True
    below = np.full(parent.size, -1)  # nearest ancestor frame that carries a link
    for i in range(parent.size):
        if parent[i] >= 0:
            below[i] = parent[i] if is_link[parent[i]] else below[parent[i]]
    number = {int(frame): i for i, frame in enumerate(links)}
    link_parent = np.array([number.get(int(below[frame]), -1) for frame in links], dtype=int)
    is_tip = np.array([i not in set(link_parent.tolist()) for i in range(links.size)], dtype=bool)
    tips_above: list[set[int]] = [set() for _ in links]
    for tip in np.flatnonzero(is_tip):
        link = int(tip)
        while link >= 0:
            tips_above[link].add(int(tip))
            link = int(link_parent[link])
    keys = [tuple(sorted(tips)) for tips in tips_above]
    order = sorted(set(keys), key=keys.index)
    return np.array([order.index(key) for key in keys], dtype=int), is_tip, link_parent


def pose_from_free(model: Model, u: Float[np.ndarray, "*b k"]) -> Float[np.ndarray, "*b j"]:
    """All joint values from the independent ones: `q = coupling @ u + coupling_offset`."""
    return u @ model.coupling.T + model.coupling_offset


def forward(model: Model, q: Float[np.ndarray, "*b j"]) -> Float[np.ndarray, "*b f 4 4"]:
    """Link frames in the base frame, `world_T_frame`, hand thesis eq. (2.2).

    Parameters
    ----------
    q : (..., j)
        Joint values in the order of `model.joint_names`, radians (model units for prismatic joints).

    Returns
    -------
    (..., f, 4, 4)
        One rigid transform for each frame, in the order of `model.frame_ids`.

    Raises
    ------
    ValueError
        If the last axis of `q` is not the number of joints.
    """
    if q.shape[-1] != len(model.joint_names):
        raise ValueError(
            f"q: last axis has {q.shape[-1]} values, model '{model.name}' has {len(model.joint_names)} joints"
        )
    flat = np.ascontiguousarray(q, dtype=float).reshape(-1, q.shape[-1])
    frames = _kernels.forward(model.parent, model.prefix, model.joint, model.prismatic, flat)
    return frames.reshape(*q.shape[:-1], model.parent.size, 4, 4)


def forward_numpy(model: Model, q: Float[np.ndarray, "*b j"]) -> Float[np.ndarray, "*b f 4 4"]:
    """The same as `forward` in plain NumPy: the twin that the compiled kernel is tested against."""
    frames = np.empty((*q.shape[:-1], model.parent.size, 4, 4))
    for i, (parent, joint) in enumerate(zip(model.parent, model.joint, strict=True)):
        local = np.broadcast_to(model.prefix[i], (*q.shape[:-1], 4, 4))
        if joint >= 0:
            motion = np.zeros((*q.shape[:-1], 4, 4))
            motion[..., range(4), range(4)] = 1.0
            value = q[..., joint]
            if model.prismatic[i]:
                motion[..., 2, 3] = value
            else:
                motion[..., 0, 0] = motion[..., 1, 1] = np.cos(value)
                motion[..., 1, 0] = np.sin(value)
                motion[..., 0, 1] = -np.sin(value)
            local = local @ motion
        frames[..., i, :, :] = frames[..., parent, :, :] @ local if parent >= 0 else local
    return frames


def link_ends(
    model: Model, frames: Float[np.ndarray, "*b f 4 4"]
) -> tuple[Float[np.ndarray, "*b l 3"], Float[np.ndarray, "*b l 3"]]:
    """Base and tip of every link's axis, in the base frame, from the frames of `forward`."""
    of_links = frames[..., model.link_frame, :, :]
    turn, origin = of_links[..., :3, :3], of_links[..., :3, 3]
    base = (turn @ model.link_base[:, :, None])[..., 0] + origin
    return base, (turn @ model.link_tip[:, :, None])[..., 0] + origin


def joints_below(model: Model) -> Bool[np.ndarray, "f j"]:
    """Which joints move which frame: the frame's own joint and those of its ancestors."""
    moves = np.zeros((model.parent.size, len(model.joint_names)), dtype=bool)
    for i, (parent, joint) in enumerate(zip(model.parent, model.joint, strict=True)):
        if parent >= 0:
            moves[i] = moves[parent]
        if joint >= 0:
            moves[i, joint] = True
    return moves


def point_jacobian(
    model: Model,
    frames: Float[np.ndarray, "*b f 4 4"],
    frame: Int[np.ndarray, " n"],
    p_world: Float[np.ndarray, "*b n 3"],
) -> Float[np.ndarray, "*b n 3 j"]:
    """Derivative of points fixed to frames by all joint values, in the base frame.

    A revolute joint moves a point by `z x (p - o)`, a prismatic one by `z`, where `z` and `o` are the axis and origin
    of the joint's own frame; this replaces the symbolic Jacobians of the hand thesis, section 3.1.2, for any tree.

    Parameters
    ----------
    frames : (..., f, 4, 4)
        From `forward`.
    frame : (n,)
        Index of the frame that each point is fixed to.
    p_world : (..., n, 3)
        The points in the base frame.
    """
    of_joint = np.empty(len(model.joint_names), dtype=int)
    moved = np.flatnonzero(model.joint >= 0)
    of_joint[model.joint[moved]] = moved
    of = frames[..., of_joint, :, :]
    axis, origin = of[..., :3, 2], of[..., :3, 3]
    arm = p_world[..., :, None, :] - origin[..., None, :, :]
    turned = np.cross(np.broadcast_to(axis[..., None, :, :], arm.shape), arm)
    motion = np.where(model.prismatic[of_joint][:, None], axis[..., None, :, :], turned)
    motion = motion * joints_below(model)[frame][..., None]
    return np.swapaxes(motion, -1, -2)
