"""A made-up skinned hand with the joints of a W3C hand, and the GLB file that holds it: no test needs a file of others.

Fingers are round tubes along +y with the back of the hand towards +z, the palm is an ellipsoid; a right hand, mm.
"""

import json
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from handtrack.formats.glb import _PARENT_OF as PARENT_OF
from handtrack.formats.glb import FINGERS, HAND_JOINTS, SkinnedMesh

AROUND = 10
KNUCKLES = {
    "thumb": ((-30.0, -45.0, -4.0), (-0.75, 0.65, -0.15), (34.0, 30.0, 24.0), 9.0),
    "index-finger": ((-24.0, 2.0, 0.0), (-0.08, 1.0, 0.0), (42.0, 25.0, 20.0), 8.0),
    "middle-finger": ((-4.0, 5.0, 2.0), (0.0, 1.0, 0.0), (45.0, 28.0, 20.0), 8.0),
    "ring-finger": ((15.0, 2.0, 0.0), (0.06, 1.0, 0.0), (42.0, 26.0, 20.0), 7.5),
    "pinky-finger": ((31.0, -6.0, -3.0), (0.14, 1.0, -0.02), (33.0, 20.0, 18.0), 6.5),
}


def made_hand() -> SkinnedMesh:
    """The hand as `read_glb` would return it."""
    bind, vertices, triangles, joints, weights = _joints(), [], [], [], []
    for finger, (_, _, lengths, radius) in KNUCKLES.items():
        chain = [HAND_JOINTS.index(name) for name in HAND_JOINTS if name.startswith(f"{finger}-")]
        chain = chain if finger == "thumb" else chain[1:]
        first = sum(len(part) for part in vertices)
        v, t, j, w = _tube(bind, chain, lengths, radius)
        vertices.append(v), triangles.append(t + first), joints.append(j), weights.append(w)
    first = sum(len(part) for part in vertices)
    v, t = _ellipsoid()
    vertices.append(v), triangles.append(t + first)
    joints.append(np.tile([0, 0], (len(v), 1))), weights.append(np.tile([1.0, 0.0], (len(v), 1)))
    p, corners = np.concatenate(vertices), np.concatenate(triangles)
    return SkinnedMesh(
        vertices=p,
        normals=_normals(p, corners),
        triangles=corners,
        joint_names=HAND_JOINTS,
        parent=np.array([PARENT_OF[name] for name in HAND_JOINTS]),
        bind=bind,
        joint=np.concatenate(joints),
        weight=np.concatenate(weights),
    )


def _joints() -> np.ndarray:
    out = np.tile(np.eye(4), (len(HAND_JOINTS), 1, 1))
    out[0, :3, :3], out[0, :3, 3] = _axes(np.array([0.0, 1.0, 0.0])), [0.0, -75.0, 0.0]
    for finger in FINGERS:
        place, direction, lengths, _ = (np.array(part) for part in KNUCKLES[finger])
        direction = direction / np.linalg.norm(direction)
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        if finger != "thumb":
            along = np.concatenate([[-55.0], along])
        names = [name for name in HAND_JOINTS if name.startswith(f"{finger}-")]
        for name, s in zip(names, along, strict=True):
            out[HAND_JOINTS.index(name), :3, :3] = _axes(direction)
            out[HAND_JOINTS.index(name), :3, 3] = place + s * direction
    return out


def _axes(direction: np.ndarray) -> np.ndarray:
    z = -direction
    x = np.cross([0.0, 0.0, 1.0], z)
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _tube(bind: np.ndarray, chain: list[int], lengths, radius: float):
    """Rings along the bones of a finger and a round tip; weights blend over 5 mm at each joint."""
    total, ends = float(sum(lengths)), np.cumsum(lengths)
    bend = np.linspace(0.0, 0.5 * np.pi, 5)[:-1]
    along = np.concatenate([np.arange(-10.0, total - radius, 5.0), total - radius + radius * np.sin(bend)])
    radii = np.concatenate([np.full(along.size - bend.size, radius), radius * np.cos(bend)])
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    local = np.stack(
        [np.outer(radii, np.cos(angle)), np.outer(radii, np.sin(angle)), np.tile(-along[:, None], (1, AROUND))], axis=-1
    ).reshape(-1, 3)
    local = np.concatenate([local, [[0.0, 0.0, -total], [0.0, 0.0, 10.0]]])
    v = local @ bind[chain[0], :3, :3].T + bind[chain[0], :3, 3]
    rings, t = along.size, []
    for r in range(rings - 1):
        for a in range(AROUND):
            i, j = r * AROUND + a, r * AROUND + (a + 1) % AROUND
            t += [[i, j, i + AROUND], [j, j + AROUND, i + AROUND]]
    for a in range(AROUND):
        last = (rings - 1) * AROUND
        t.append([last + a, last + (a + 1) % AROUND, rings * AROUND])
        t.append([(a + 1) % AROUND, a, rings * AROUND + 1])
    s = -local[:, 2]
    bone = np.searchsorted(ends[:-1], s)
    share = np.zeros((s.size, 3))
    for i, end in enumerate((0.0, *ends[:-1])):
        share[:, i] = np.clip((s - end) / 5.0 + 0.5, 0.0, 1.0) if i else 1.0
    shares = share - np.pad(share[:, 1:], ((0, 0), (0, 1)))
    j = np.stack([np.maximum(bone - 1, 0), bone], axis=1)
    beyond = shares[np.arange(s.size), np.minimum(bone + 1, 2)] * (bone < 2)
    ahead = beyond > 0.0
    j[ahead] = np.stack([bone[ahead], bone[ahead] + 1], axis=1)
    w = np.take_along_axis(shares, j, axis=1) * np.where(j[:, :1] == j[:, 1:], [1.0, 0.0], [1.0, 1.0])
    return v, np.array(t)[:, ::-1], np.array(chain)[j], w / w.sum(axis=1, keepdims=True)


def _ellipsoid():
    """The palm: a sphere of rings, stretched."""
    rows, columns = 9, 16
    theta, phi = np.pi * np.arange(1, rows) / rows, 2.0 * np.pi * np.arange(columns) / columns
    ring = np.stack([np.outer(np.sin(theta), np.cos(phi)), np.outer(np.sin(theta), np.sin(phi))], axis=-1)
    p = np.concatenate([ring, np.tile(np.cos(theta)[:, None, None], (1, columns, 1))], axis=-1).reshape(-1, 3)
    p = np.concatenate([p, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]) * [42.0, 50.0, 13.0] + [2.0, -40.0, 0.0]
    t = []
    for r in range(rows - 2):
        for c in range(columns):
            i, j = r * columns + c, r * columns + (c + 1) % columns
            t += [[i, i + columns, j], [j, i + columns, j + columns]]
    top, bottom, last = p.shape[0] - 2, p.shape[0] - 1, (rows - 2) * columns
    for c in range(columns):
        t += [[top, c, (c + 1) % columns], [bottom, last + (c + 1) % columns, last + c]]
    return p, np.array(t)


def _normals(p: np.ndarray, t: np.ndarray) -> np.ndarray:
    area, out = np.cross(p[t[:, 1]] - p[t[:, 0]], p[t[:, 2]] - p[t[:, 0]]), np.zeros(p.shape)
    for i in range(3):
        np.add.at(out, t[:, i], area)
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def glb(mesh: SkinnedMesh, change: Callable[[Any], None] = lambda content: None, normals: bool = True) -> bytes:
    """The file of a mesh: flat joint nodes, as exporters write them; `change` may spoil its description."""
    metres = np.linalg.inv(mesh.bind * np.array([[1, 1, 1, 1e-3]] * 3 + [[1, 1, 1, 1]]))
    four = (
        np.pad(mesh.joint, ((0, 0), (0, 4 - mesh.joint.shape[1]))),
        np.pad(mesh.weight, ((0, 0), (0, 4 - mesh.weight.shape[1]))),
    )
    arrays = [
        ("VEC3", 5126, (1e-3 * mesh.vertices).astype("<f4")),
        ("VEC3", 5126, mesh.normals.astype("<f4")),
        ("VEC4", 5121, four[0].astype("<u1")),
        ("VEC4", 5126, four[1].astype("<f4")),
        ("SCALAR", 5123, mesh.triangles.reshape(-1, 1).astype("<u2")),
        ("MAT4", 5126, np.swapaxes(metres, 1, 2).reshape(-1, 16).astype("<f4")),
    ]
    data, views, accessors = b"", [], []
    for kind, component, values in arrays:
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": values.nbytes})
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(values), "type": kind})
        data += values.tobytes() + b"\0" * (-values.nbytes % 4)
    joints = range(1, 1 + len(mesh.joint_names))
    attributes = {"POSITION": 0, "NORMAL": 1, "JOINTS_0": 2, "WEIGHTS_0": 3}
    if not normals:
        del attributes["NORMAL"]
    content = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": views,
        "accessors": accessors,
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 4}]}],
        "skins": [{"joints": list(joints), "inverseBindMatrices": 5}],
        "nodes": [
            {"mesh": 0, "skin": 0},
            *(
                {"name": name, "matrix": (frame * np.array([[1, 1, 1, 1e-3]] * 3 + [[1] * 4])).T.reshape(-1).tolist()}
                for name, frame in zip(mesh.joint_names, mesh.bind, strict=True)
            ),
        ],
    }
    change(content)
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks
