"""A tree of pills or a skinned mesh in, a hand with parts and keypoints out."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from handtrack.formats.glb import SkinnedMesh
from handtrack.kinematics import Model, forward
from handtrack.kinematics.builtin import HAND_LENGTH, KNUCKLE_ALONG

from ..labels.bodies import MeshHand, PillHand
from ..labels.solids import HAND_PARTS, KEYPOINTS
from ..mesh_hand import FINGERS, mesh_hand, resized

_SEGMENTS = ("proximal", "intermediate", "distal")
_THUMB_SEGMENTS = ("metacarpal", "proximal", "distal")
_JOINTS = ("mcp", "pip", "dip", "tip")
_THUMB_JOINTS = ("cmc", "mcp", "ip", "tip")
PALM_RADIUS = (11.0, 9.5)  # of a metacarpal's pill at the wrist and at the knuckle, mm, of a hand of `HAND_LENGTH`
WRIST_RADIUS, FOREARM = 24.0, 35.0  # of the pill that is wrist and the end of the forearm, and its length, mm
_SPREAD = 0.55  # metacarpals meet the wrist at this share of the distance between their knuckles


def pill_hand(model: Model, left: bool = False, radius: float = 1.0) -> PillHand:
    """A hand whose links are pills, with a palm of pills where the model is a whole hand.

    Parameters
    ----------
    model : Model
        A tree whose joints are named `index_mcp` and so on; links of other names become parts of their own.
    left : bool
        Mirror it; the model describes a right hand.
    radius : float
        Factor on all radii.
    """
    names = _link_names(model)
    frame, base, tip = model.link_frame.copy(), model.link_base, model.link_tip
    radii, parts = radius * model.link_radius, list(names)
    point_frame, point = np.full(len(KEYPOINTS), -1), np.full((len(KEYPOINTS), 3), np.nan)
    for link, name in enumerate(names):
        finger, _, segment = name.rpartition("_")
        joints = _joints_of(finger, segment)
        if joints is None:
            continue
        for joint, place in zip(joints, (model.link_base, model.link_tip), strict=True):
            if joint in KEYPOINTS:
                at = KEYPOINTS.index(joint)
                point_frame[at], point[at] = model.link_frame[link], place[link]
    if all(f"{finger}_proximal" in names for finger in FINGERS):
        palm = _palm(model, names, radius)
        frame = np.concatenate([frame, np.full(len(palm[0]), -1)])
        base, tip = np.concatenate([base, palm[1]]), np.concatenate([tip, palm[2]])
        radii, parts = np.concatenate([radii, palm[3]]), [*parts, *palm[0]]
        point_frame[0], point[0] = -1, palm[4]
    unique = tuple(dict.fromkeys(parts))
    part = np.array([unique.index(name) for name in parts], dtype=np.int64)
    return PillHand(model, left, frame, base, tip, radii, part, unique, point_frame, point, parts_of_points(unique))


def skinned_hand(mesh: SkinnedMesh, left: bool = False, scale: float = 1.0) -> MeshHand:
    """A skinned hand that bends in all fingers; `left` says that the mesh, a right hand, is to be mirrored."""
    model, skin = mesh_hand(resized(mesh, scale, left), FINGERS, abduction=True)
    mesh = skin.mesh
    frames = np.concatenate([skin.rest, np.eye(4)[None]])
    inverse = np.linalg.inv(frames)[skin.follows]
    R, t = inverse[mesh.joint][..., :3, :3], inverse[mesh.joint][..., :3, 3]
    local = (R @ mesh.vertices[:, None, :, None])[..., 0] + t
    local_normal = (R @ mesh.normals[:, None, :, None])[..., 0]
    point_frame, point = _mesh_points(mesh, skin.follows, inverse)
    return MeshHand(
        model,
        left,
        skin.follows.astype(np.int64),
        mesh.joint.astype(np.int64),
        mesh.weight,
        local,
        local_normal,
        mesh.vertices,
        mesh.triangles.astype(np.int64),
        _triangle_parts(mesh),
        HAND_PARTS,
        point_frame,
        point,
        parts_of_points(HAND_PARTS),
    )


def longer(model: Model, factor: Float[np.ndarray, " l"]) -> Model:
    """The model with links of other lengths; what sits on a link's tip moves with it.

    Parameters
    ----------
    factor : (l,)
        On each link's length.
    """
    prefix = model.prefix.copy()
    for link, frame in enumerate(model.link_frame):
        grown = (factor[link] - 1.0) * model.link_length[link]
        for child in np.flatnonzero(model.parent == frame):
            prefix[child, 0, 3] += grown
    tip = model.link_tip.copy()
    tip[:, 0] += (factor - 1.0) * model.link_length
    return replace(model, prefix=prefix, link_length=model.link_length * factor, link_tip=tip)


@lru_cache(maxsize=32)
def parts_of_points(names: tuple[str, ...]) -> Bool[np.ndarray, "k n"]:
    """Which parts each keypoint lies in: those that meet at the joint, the distal one for a tip."""
    inside = np.zeros((len(KEYPOINTS), len(names)), dtype=bool)
    for k, point in enumerate(KEYPOINTS):
        for part in _meeting(point):
            if part in names:
                inside[k, names.index(part)] = True
    inside.flags.writeable = False
    return inside


def _meeting(point: str) -> tuple[str, ...]:
    """Parts that meet at a keypoint."""
    if point == "wrist":
        return ("wrist", *(f"{finger}_metacarpal" for finger in FINGERS))
    finger, joint = point.split("_")
    segments = ("wrist", *_THUMB_SEGMENTS) if finger == "thumb" else ("metacarpal", *_SEGMENTS)
    at = (_THUMB_JOINTS if finger == "thumb" else _JOINTS).index(joint)
    ends = segments[at : at + 2]
    return tuple(part if part == "wrist" else f"{finger}_{part}" for part in ends)


def _joints_of(finger: str, segment: str) -> tuple[str, str] | None:
    """Keypoints at the base and tip of a segment."""
    segments, joints = (_THUMB_SEGMENTS, _THUMB_JOINTS) if finger == "thumb" else (_SEGMENTS, _JOINTS)
    if finger not in FINGERS or segment not in segments:
        return None
    at = segments.index(segment)
    return f"{finger}_{joints[at]}", f"{finger}_{joints[at + 1]}"


def _link_names(model: Model) -> tuple[str, ...]:
    """Part of each link: `index_proximal` for the first of a finger's links, or the name of the joint that moves it."""
    names: list[str] = []
    for link, frame in enumerate(model.link_frame):
        joint = model.joint[frame]
        moved = model.joint_names[joint] if joint >= 0 else f"link_{link}"
        finger = moved.split("_")[0]
        below, at = model.link_parent[link], 0
        while below >= 0:
            below, at = model.link_parent[below], at + 1
        segments = _THUMB_SEGMENTS if finger == "thumb" else _SEGMENTS
        known = finger in FINGERS and at < len(segments)
        names.append(f"{finger}_{segments[at]}" if known else moved)
    return tuple(names)


def _palm(model: Model, names: tuple[str, ...], radius: float):
    """Names, ends and radii of the pills of metacarpals and wrist, and the wrist's place, in the base frame."""
    rest = forward(model, np.zeros(len(model.joint_names)))
    knuckle = {finger: rest[model.link_frame[names.index(f"{finger}_proximal")], :3, 3] for finger in FINGERS[1:]}
    size = knuckle["middle"][1] / ((KNUCKLE_ALONG["middle"] - KNUCKLE_ALONG["thumb"]) * HAND_LENGTH)
    wrist = np.array([0.0, -KNUCKLE_ALONG["thumb"] * HAND_LENGTH * size, 0.0])
    base, tip, radii = [], [], []
    for place in knuckle.values():
        base.append(wrist + np.array([_SPREAD * place[0], 8.0 * size, 0.0]))
        tip.append(place)
        radii.append(np.array(PALM_RADIUS) * radius * size)
    base.append(wrist)
    tip.append(wrist - np.array([0.0, FOREARM * size, 0.0]))
    radii.append(np.full(2, WRIST_RADIUS * radius * size))
    parts = (*(f"{finger}_metacarpal" for finger in knuckle), "wrist")
    return parts, np.array(base), np.array(tip), np.array(radii), wrist


def _part_of_joint(joint: str) -> str:
    """Part of a W3C hand joint: the bone that starts there; a tip belongs to the distal phalanx."""
    if joint == "wrist":
        return "wrist"
    finger = joint.split("-")[0].replace("pinky", "little")
    segment = joint.rsplit("-", 1)[1]
    return f"{finger}_{'distal' if segment == 'tip' else segment}"


def _triangle_parts(mesh: SkinnedMesh) -> Int[np.ndarray, " t"]:
    """Part that moves each triangle most, in the order of `HAND_PARTS`."""
    part_of = np.array([HAND_PARTS.index(_part_of_joint(name)) for name in mesh.joint_names])
    share = np.zeros((mesh.vertices.shape[0], len(HAND_PARTS)))
    np.add.at(share, (np.arange(share.shape[0])[:, None], part_of[mesh.joint]), mesh.weight)
    return share[mesh.triangles].sum(axis=1).argmax(axis=1)


def _mesh_points(mesh: SkinnedMesh, follows: Int[np.ndarray, " j"], inverse: Float[np.ndarray, "j 4 4"]):
    """Frame and place of each keypoint: the mesh's joints."""
    ends = {"cmc": "metacarpal", "mcp": "phalanx-proximal", "pip": "phalanx-intermediate", "tip": "tip"}
    ends |= {"dip": "phalanx-distal", "ip": "phalanx-distal"}
    frame, point = np.full(len(KEYPOINTS), -1), np.full((len(KEYPOINTS), 3), np.nan)
    for k, name in enumerate(KEYPOINTS):
        joint = "wrist"
        if name != "wrist":
            finger, end = name.split("_")
            spoken = {"thumb": "thumb", "little": "pinky-finger"}.get(finger, f"{finger}-finger")
            joint = f"{spoken}-{ends[end]}"
        if joint in mesh.joint_names:
            j = mesh.joint_names.index(joint)
            frame[k] = follows[j]
            point[k] = inverse[j, :3, :3] @ mesh.bind[j, :3, 3] + inverse[j, :3, 3]
    return frame, point


def scaled_model(model: Model, scale: float) -> Model:
    """The model in another size; its joints turn as before."""
    prefix = model.prefix.copy()
    prefix[:, :3, 3] *= scale
    return replace(
        model,
        prefix=prefix,
        link_length=scale * model.link_length,
        link_radius=scale * model.link_radius,
        link_base=scale * model.link_base,
        link_tip=scale * model.link_tip,
    )


def scaled(hand: PillHand | MeshHand, scale: float, radius: float = 1.0) -> PillHand | MeshHand:
    """A hand in another size; `radius` is a further factor on the radii of pills."""
    model = scaled_model(hand.model, scale)
    if isinstance(hand, PillHand):
        return replace(
            hand,
            model=model,
            base=scale * hand.base,
            tip=scale * hand.tip,
            radius=scale * radius * hand.radius,
            point=scale * hand.point,
        )
    return replace(hand, model=model, local=scale * hand.local, rest=scale * hand.rest, point=scale * hand.point)


def own_axes(hand: PillHand | MeshHand) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Rotation from a hand's own axes to those of hands, and the middle of its knuckles, in its own axes.

    In the axes of hands y points to the fingertips and z out of the palm; x points to the thumb of a right hand, away
    from that of a left one. A hand without these keypoints keeps its own axes, about the middle of its links.
    """
    frames = np.concatenate([forward(hand.model, np.zeros(len(hand.model.joint_names))), np.eye(4)[None]])
    F = frames[hand.point_frame]
    p = (F[:, :3, :3] @ hand.point[:, :, None])[..., 0] + F[:, :3, 3]
    mirrored = isinstance(hand, PillHand) and hand.mirrored
    if mirrored:
        p = p * (-1.0, 1.0, 1.0)
    at = [KEYPOINTS.index(name) for name in ("wrist", "index_mcp", "middle_mcp", "little_mcp")]
    if np.isnan(p[at]).any():
        known = p[~np.isnan(p[:, 0])]
        return np.eye(3), known.mean(axis=0) if known.size else np.zeros(3)
    wrist, index, middle, little = p[at]
    y = middle - wrist
    y = y / np.linalg.norm(y)
    z = np.cross(index - little, y) * (-1.0 if mirrored or getattr(hand, "left", False) else 1.0)
    z = z / np.linalg.norm(z)
    return np.stack([np.cross(y, z), y, z]), 0.5 * (index + little) + 0.3 * (middle - 0.5 * (index + little))
