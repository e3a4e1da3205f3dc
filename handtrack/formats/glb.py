"""A glTF file with a skinned hand in, its surface, joints and weights out, in millimetres.

Joints carry the names of the W3C's WebXR hands (`wrist`, `index-finger-phalanx-proximal`, ...). The tree between them
is that of the names: exporters write the joint nodes flat as often as not. The bind pose is where the inverse bind
matrices say the joints were when the surface was tied to them.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from .gltf_data import Gltf, accessor, item, numbers, read_gltf

FINGERS = ("thumb", "index-finger", "middle-finger", "ring-finger", "pinky-finger")
_PHALANGES = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
_MM = 1000.0
_MOST_NODES, _MOST_TRIANGLES, _LARGEST_MM, _SMALLEST_MM = 4_000, 200_000, 2000.0, 5.0


def _parents() -> tuple[tuple[str, str | None], ...]:
    """Every joint of a hand with its parent."""
    found: list[tuple[str, str | None]] = [("wrist", None)]
    for finger in FINGERS:
        names = [f"{finger}-{part}" for part in _PHALANGES if finger != "thumb" or part != "phalanx-intermediate"]
        found += list(zip(names, ["wrist", *names], strict=False))
    return tuple(found)


HAND_JOINTS = tuple(name for name, _ in _parents())
_PARENT_OF = {name: HAND_JOINTS.index(parent) if parent else -1 for name, parent in _parents()}


@dataclass(frozen=True, slots=True, eq=False)
class SkinnedMesh:
    """A triangulated surface tied to joints.

    Attributes
    ----------
    vertices, normals : (v, 3), (v, 3)
        Bind pose, millimetres, and unit outward normals, in the mesh's axes.
    triangles : (t, 3)
        Vertices of each triangle, counter-clockwise seen from outside.
    joint_names, parent : (j,)
        W3C names, and the parent of each joint by its name: the nearest one that the mesh has (-1: none).
    bind : (j, 4, 4)
        Rigid transforms of the joints in the bind pose, millimetres.
    joint, weight : (v, w), (v, w)
        Joints that move each vertex and their shares, which sum to one.
    """

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "t 3"]
    joint_names: tuple[str, ...]
    parent: Int[np.ndarray, " j"]
    bind: Float[np.ndarray, "j 4 4"]
    joint: Int[np.ndarray, "v w"]
    weight: Float[np.ndarray, "v w"]


def read_glb(path: Path | str) -> SkinnedMesh:
    """Read the skinned hand of a `.glb` or `.gltf` file (glTF 2.0).

    All triangle primitives of all meshes that hang on the first skin are joined. Metres become millimetres.

    Raises
    ------
    InputError
        One line that names file, place and what was wanted, for a file that is broken, too large, without a skin, with
        joints of other names, or with numbers that are not finite.
    """
    gltf = read_gltf(Path(path))
    nodes = item(gltf, "nodes", wanted=list)
    skinned = [n for n in range(len(nodes)) if isinstance(nodes[n], dict) and "skin" in nodes[n] and "mesh" in nodes[n]]
    if not item(gltf, "skins", wanted=list, default=[]) or not skinned:
        gltf.fail("nodes", "no mesh with a skin; a hand tied to joints is wanted")
    skin = item(gltf, "nodes", skinned[0], "skin", wanted=int)
    names, bind, scale = _joints(gltf, skin)
    parts, first = [], 0
    for n in skinned:
        mesh = item(gltf, "nodes", n, "mesh", wanted=int)
        if item(gltf, "nodes", n, "skin", wanted=int) == skin:
            for p in range(len(item(gltf, "meshes", mesh, "primitives", wanted=list))):
                parts.append(_primitive(gltf, mesh, p, len(names), first))
                first += parts[-1][0].shape[0]
    return _joined(gltf, parts, names, bind, scale)


def _joined(gltf: Gltf, parts: list, names: tuple[str, ...], bind: Float[np.ndarray, "j 4 4"], scale: float):
    width = max(part[3].shape[1] for part in parts)
    padded = [[np.pad(part[i], ((0, 0), (0, width - part[i].shape[1]))) for part in parts] for i in (3, 4)]
    vertices, triangles = np.concatenate([part[0] for part in parts]), np.concatenate([part[2] for part in parts])
    vertices = vertices * scale * _MM
    if triangles.shape[0] > _MOST_TRIANGLES:
        gltf.fail("meshes", f"{triangles.shape[0]} triangles; at most {_MOST_TRIANGLES} are wanted")
    size = float(np.ptp(vertices, axis=0).max())
    if not _SMALLEST_MM < size < _LARGEST_MM:
        gltf.fail("meshes", f"the hand is {size:.3g} mm large; glTF is in metres, a hand of some 0.2 is wanted")
    shares = np.concatenate(padded[1])
    return SkinnedMesh(
        vertices=vertices,
        normals=np.concatenate([part[1] for part in parts]),
        triangles=triangles,
        joint_names=names,
        parent=np.array([_parent(name, names) for name in names]),
        bind=bind,
        joint=np.concatenate(padded[0]),
        weight=shares / shares.sum(axis=1, keepdims=True),
    )


def _parent(name: str, names: tuple[str, ...]) -> int:
    above = _PARENT_OF[name]
    while above >= 0 and HAND_JOINTS[above] not in names:
        above = _PARENT_OF[HAND_JOINTS[above]]
    return names.index(HAND_JOINTS[above]) if above >= 0 else -1


def _joints(gltf: Gltf, skin: int) -> tuple[tuple[str, ...], Float[np.ndarray, "j 4 4"], float]:
    """Names and bind transforms (mm) of a skin's joints, and the scale that turns the mesh's units into metres."""
    count = len(item(gltf, "skins", skin, "joints", wanted=list))
    of_node = [item(gltf, "skins", skin, "joints", i, wanted=int) for i in range(count)]
    names = tuple(item(gltf, "nodes", node, "name", wanted=str) for node in of_node)
    for i, name in enumerate(names):
        if name not in HAND_JOINTS:
            gltf.fail(
                f"nodes[{of_node[i]}].name", f"{name[:40]!r} is no joint of a W3C hand ('wrist', 'thumb-tip', ...)"
            )
        if names.index(name) != i:
            gltf.fail(f"nodes[{of_node[i]}].name", f"{name!r} is given twice; joints are unique")
    world = _world(gltf)[of_node]
    given = item(gltf, "skins", skin, "inverseBindMatrices", wanted=int, default=-1)
    if given < 0:
        return names, _rigid(gltf, world, "nodes", 1.0), 1.0
    inverse = accessor(gltf, given, "MAT4", lambda kind, _: kind == "<f4", "inverse bind matrices").astype(float)
    if inverse.shape[0] < count:
        gltf.fail(f"skins[{skin}]", f"{inverse.shape[0]} inverse bind matrices for {count} joints")
    inverse = np.swapaxes(inverse[:count].reshape(-1, 4, 4), 1, 2)
    if (np.abs(np.linalg.det(inverse[:, :3, :3])) < 1e-12).any():
        gltf.fail(f"skins[{skin}].inverseBindMatrices", "a matrix cannot be inverted; rigid transforms are wanted")
    shown = np.median(np.abs(np.linalg.det((world @ inverse)[:, :3, :3]))) ** (1.0 / 3.0)
    scale = float(shown)
    return names, _rigid(gltf, np.linalg.inv(inverse), f"skins[{skin}].inverseBindMatrices", scale), scale


def _rigid(gltf: Gltf, transforms: Float[np.ndarray, "j 4 4"], place: str, scale: float) -> Float[np.ndarray, "j 4 4"]:
    """The nearest rigid transforms, in millimetres; a joint that is sheared or mirrored is refused."""
    out = transforms.copy()
    with np.errstate(all="ignore"):
        size = np.cbrt(np.linalg.det(out[:, :3, :3]))
        turn = out[:, :3, :3] / size[:, None, None]
        off = np.abs(turn @ np.swapaxes(turn, 1, 2) - np.eye(3)).max()
    if not (np.isfinite(out).all() and (size > 0).all() and off < 1e-2):
        gltf.fail(place, "a joint is sheared, mirrored or flat; rotation, translation and one scale are wanted")
    left, _, right = np.linalg.svd(turn)
    out[:, :3, :3] = left @ right
    out[:, :3, 3] *= scale * _MM
    out[:, 3] = [0.0, 0.0, 0.0, 1.0]
    return out


def _world(gltf: Gltf) -> Float[np.ndarray, "n 4 4"]:
    """World transforms of all nodes."""
    count = len(item(gltf, "nodes", wanted=list))
    if count > _MOST_NODES:
        gltf.fail("nodes", f"{count} nodes; at most {_MOST_NODES} are wanted")
    above = np.full(count, -1)
    for n in range(count):
        children = item(gltf, "nodes", n, "children", wanted=list, default=[])
        for i in range(len(children)):
            child = item(gltf, "nodes", n, "children", i, wanted=int)
            if not 0 <= child < count or above[child] >= 0:
                gltf.fail(f"nodes[{n}].children[{i}]", f"{child} given; a node that has no other parent is wanted")
            above[child] = n
    local = np.stack([_local(gltf, n) for n in range(count)])
    world = local.copy()
    for n in range(count):
        node, steps = int(above[n]), 0
        while node >= 0:
            world[n], node, steps = local[node] @ world[n], int(above[node]), steps + 1
            if steps > count:
                gltf.fail(f"nodes[{n}]", "is below itself; a tree is wanted")
    return world


def _local(gltf: Gltf, n: int) -> Float[np.ndarray, "4 4"]:
    """A node's transform: its matrix, or translation, rotation (x, y, z, w) and scale."""
    if "matrix" in item(gltf, "nodes", n, wanted=dict):
        return numbers(gltf, 16, "nodes", n, "matrix", default=()).reshape(4, 4).T
    x, y, z, w = numbers(gltf, 4, "nodes", n, "rotation", default=(0.0, 0.0, 0.0, 1.0)).tolist()
    length = x * x + y * y + z * z + w * w
    if not 0.5 < length < 2.0:
        gltf.fail(f"nodes[{n}].rotation", "a unit quaternion is wanted")
    s, out = 2.0 / length, np.eye(4)
    out[:3, :3] = [
        [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
    ]
    out[:3, :3] *= numbers(gltf, 3, "nodes", n, "scale", default=(1.0, 1.0, 1.0))
    out[:3, 3] = numbers(gltf, 3, "nodes", n, "translation", default=(0.0, 0.0, 0.0))
    return out


def _primitive(gltf: Gltf, mesh: int, number: int, joints: int, first: int):
    """Vertices, normals, triangles (numbered from `first`), joints and weights of one primitive."""
    at = ("meshes", mesh, "primitives", number)
    place = f"meshes[{mesh}].primitives[{number}]"
    if item(gltf, *at, "mode", wanted=int, default=4) != 4:
        gltf.fail(f"{place}.mode", "triangles (4) are wanted")
    if "extensions" in item(gltf, *at, wanted=dict):
        gltf.fail(place, "is compressed or extended; plain data is wanted")
    vertices = _vectors(gltf, at, "POSITION")
    count = vertices.shape[0]
    index = item(gltf, *at, "indices", wanted=int, default=-1)
    whole = accessor(gltf, index, "SCALAR", _unsigned, "indices")[:, 0] if index >= 0 else np.arange(count)
    whole = whole.astype(np.int64)
    if whole.size % 3 or int(whole.max()) >= count:
        gltf.fail(f"{place}.indices", f"{whole.size} indices up to {int(whole.max())}; three each below {count}")
    triangles = whole.reshape(-1, 3)
    normals = _vectors(gltf, at, "NORMAL") if "NORMAL" in item(gltf, *at, "attributes", wanted=dict) else None
    normals = _normals(vertices, triangles) if normals is None else normals
    joint, weight = _influences(gltf, at, place, joints)
    if normals.shape[0] != count or weight.shape[0] != count:
        gltf.fail(f"{place}.attributes", f"{normals.shape[0]} normals, {weight.shape[0]} weights, {count} positions")
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    return vertices, normals / np.where(size > 0.0, size, 1.0), triangles + first, joint, weight


def _vectors(gltf: Gltf, at: tuple[str | int, ...], name: str) -> Float[np.ndarray, "v 3"]:
    number = item(gltf, *at, "attributes", name, wanted=int)
    return accessor(gltf, number, "VEC3", lambda kind, _: kind == "<f4", name).astype(float)


def _unsigned(kind: str, normalized: bool) -> bool:
    return kind in ("<u1", "<u2", "<u4") and not normalized


def _weighing(kind: str, normalized: bool) -> bool:
    return kind == "<f4" or (kind in ("<u1", "<u2") and normalized)


def _influences(gltf: Gltf, at: tuple[str | int, ...], place: str, joints: int):
    """Joints and weights of each vertex, four or, with a second set, eight."""
    attributes = item(gltf, *at, "attributes", wanted=dict)
    if "JOINTS_0" not in attributes or "WEIGHTS_0" not in attributes:
        gltf.fail(f"{place}.attributes", "JOINTS_0 and WEIGHTS_0 are wanted")
    sets = [0, 1] if "JOINTS_1" in attributes else [0]
    numbered = [item(gltf, *at, "attributes", f"JOINTS_{i}", wanted=int) for i in sets]
    weighed = [item(gltf, *at, "attributes", f"WEIGHTS_{i}", wanted=int) for i in sets]
    each = [accessor(gltf, n, "VEC4", _unsigned, "JOINTS") for n in numbered]
    shares = [accessor(gltf, n, "VEC4", _weighing, "WEIGHTS").astype(float) for n in weighed]
    if len({part.shape[0] for part in (*each, *shares)}) > 1:
        gltf.fail(f"{place}.attributes", "joints and weights of different counts; one for each vertex is wanted")
    joint, weight = np.hstack(each).astype(np.int64), np.hstack(shares)
    if (weight < -1e-6).any() or (weight.sum(axis=1) < 1e-6).any():
        gltf.fail(f"{place}.attributes.WEIGHTS_0", "weights >= 0 with a sum above 0 are wanted")
    weight = np.maximum(weight, 0.0)
    if (joint[weight > 0.0] >= joints).any():
        gltf.fail(f"{place}.attributes.JOINTS_0", f"joint {int(joint.max())} of {joints}")
    return np.where(weight > 0.0, joint, 0), weight


def _normals(vertices: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "t 3"]) -> Float[np.ndarray, "v 3"]:
    """Sums of the area vectors of the triangles around each vertex."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    area, out = np.cross(b - a, c - a), np.zeros(vertices.shape)
    for i in range(3):
        np.add.at(out, triangles[:, i], area)
    return out
