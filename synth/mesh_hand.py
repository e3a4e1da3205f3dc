"""A skinned mesh with the joints of a W3C hand in, a Denavit-Hartenberg tree that moves it out.

Every phalanx gets a hinge: its x axis runs along the bone of the bind pose, its z axis is the joint's own -x, which a
finger bends about, made perpendicular to the bone. Pose 0 is the bind pose, frame {0} has the axes of the mesh. The
pills' radii are the mean distances of the skin from the bones.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from handtrack.formats.glb import SkinnedMesh
from handtrack.kinematics import FrameRow, Model, forward, model_from_rows

from .mesh import SkinnedHand

FINGERS = ("thumb", "index", "middle", "ring", "little")
LIMITS = {
    "mcp": (-30.0, 90.0),
    "pip": (-10.0, 100.0),
    "dip": (-15.0, 80.0),
    "abduction": (-20.0, 20.0),
    "radial": (-35.0, 35.0),
    "ip": (-15.0, 80.0),
}
TONE, DARK = 225.0, 12.0  # grey level of the skin in full light, and of a covered palm
_PARTS = ("phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
_THUMB_PARTS = ("metacarpal", "phalanx-proximal", "phalanx-distal", "tip")
_JOINTS, _THUMB_JOINTS = ("mcp", "pip", "dip"), ("radial", "mcp", "ip")


def resized(mesh: SkinnedMesh, scale: float = 1.0, mirror: bool = False) -> SkinnedMesh:
    """The mesh in another size, or as the other hand: mirrored in x, its triangles turned round.

    >>> resized.__module__
    'synth.mesh_hand'
    """
    if not (scale > 0.0 and math.isfinite(scale)):
        raise ValueError(f"scale: {scale}; wanted a finite number > 0")
    flip = np.diag([-1.0 if mirror else 1.0, 1.0, 1.0, 1.0])
    bind = flip @ mesh.bind @ flip
    bind[:, :3, 3] *= scale
    return replace(
        mesh,
        vertices=scale * mesh.vertices @ flip[:3, :3],
        normals=mesh.normals @ flip[:3, :3],
        triangles=np.ascontiguousarray(mesh.triangles[:, ::-1]) if mirror else mesh.triangles,
        bind=bind,
    )


def mesh_hand(
    mesh: SkinnedMesh,
    fingers: Sequence[str] = FINGERS[1:],
    abduction: bool = False,
    covered: bool = False,
    name: str = "mesh_hand",
) -> tuple[Model, SkinnedHand]:
    """Tree and skin of a hand.

    Parameters
    ----------
    fingers : sequence of str
        The ones that move, out of `FINGERS`.
    abduction : bool
        Whether fingers also turn sideways at the knuckle; the thumb does not.
    covered : bool
        Whether everything but the moving fingers is dark.

    Raises
    ------
    ValueError
        For an unknown finger, or joints that the mesh lacks.
    """
    rows: list[FrameRow] = []
    owner: dict[str, int] = {}
    for finger in fingers:
        if finger not in FINGERS:
            raise ValueError(f"fingers: '{finger}' is unknown; wanted some of {', '.join(FINGERS)}")
        rows += _finger(mesh, finger, abduction, len(rows), owner)
    model = model_from_rows(name, rows)
    at = {int(id): i for i, id in enumerate(model.frame_ids)}
    follows = np.array([at[owner[joint]] if joint in owner else -1 for joint in mesh.joint_names])
    moving = (mesh.weight * (follows >= 0)[mesh.joint]).sum(axis=1)
    albedo = np.full(moving.size, TONE) if not covered else DARK + (TONE - DARK) * moving
    return model, SkinnedHand(mesh, follows, forward(model, np.zeros(len(model.joint_names))), albedo)


def _finger(mesh: SkinnedMesh, finger: str, abduction: bool, used: int, owner: dict[str, int]) -> list[FrameRow]:
    """Rows of a finger; `owner` gets the row that each of its mesh joints follows."""
    thumb = finger == "thumb"
    spoken = {"thumb": "thumb", "little": "pinky-finger"}.get(finger, f"{finger}-finger")
    wanted = [f"{spoken}-{part}" for part in (_THUMB_PARTS if thumb else _PARTS)]
    missing = [joint for joint in wanted if joint not in mesh.joint_names]
    if missing:
        raise ValueError(f"mesh: has no joint '{missing[0]}', which the {finger} finger needs")
    numbers = [mesh.joint_names.index(joint) for joint in wanted]
    rows: list[FrameRow] = []
    parent, above = 0, np.eye(4)
    for i, part in enumerate(_THUMB_JOINTS if thumb else _JOINTS):
        joint, following = mesh.bind[numbers[i]], mesh.bind[numbers[i + 1], :3, 3]
        hinge = _hinge(joint, following)
        turns = [(f"{finger}_{part}", hinge, LIMITS[part])]
        if abduction and not thumb and i == 0:  # about the normal of bone and hinge, before the bending
            sideways = hinge[:, [0, 2, 1, 3]] * np.array([1.0, -1.0, 1.0, 1.0])
            turns.insert(0, (f"{finger}_abduction", sideways, LIMITS["abduction"]))
        for joint_name, frame, limits in turns:
            fixed, id = np.linalg.inv(above) @ frame, used + len(rows) + 1
            last = joint_name == turns[-1][0]
            length = float(np.linalg.norm(following - joint[:3, 3])) if last else None
            radius = _radius(mesh, numbers[i], hinge, length or 0.0)
            rows.append(FrameRow(id, parent, transform=fixed))
            rows.append(
                FrameRow(
                    id + 1,
                    id,
                    joint=joint_name,
                    limits=(math.radians(limits[0]), math.radians(limits[1])),
                    link_length=length,
                    link_radius=(radius, radius) if last else None,
                )
            )
            parent, above = id + 1, frame
        owner[wanted[i]] = parent
    owner[wanted[3]] = parent
    return rows


def _hinge(joint: Float[np.ndarray, "4 4"], following: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    """Frame of a hinge: x along the bone, z the joint's -x made perpendicular to it."""
    out = np.eye(4)
    bone = following - joint[:3, 3]
    x = bone / np.linalg.norm(bone)
    z = -joint[:3, 0] + (joint[:3, 0] @ x) * x
    z = z / np.linalg.norm(z)
    out[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    out[:3, 3] = joint[:3, 3]
    return out


def _radius(mesh: SkinnedMesh, joint: int, hinge: Float[np.ndarray, "4 4"], length: float) -> float:
    """Mean distance from the bone of the skin that mostly follows it, mm; a quarter of the bone if there is none."""
    own = (mesh.weight * (mesh.joint == joint)).sum(axis=1) > 0.5
    if not own.any():
        return max(0.25 * length, 1.0)
    off = (mesh.vertices[own] - hinge[:3, 3]) @ hinge[:3, :3]
    return float(np.hypot(off[:, 1], off[:, 2]).mean())
