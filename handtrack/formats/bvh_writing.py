"""Labelled people in, a BioVision hierarchy out: for each person a skeleton whose bones have one length.

A bone is as long as its median over time. The hips have a place; every joint turns, R = R_z R_x R_y. A joint with
several children (hips, chest) turns so that it fits them best (Kabsch), one with a single child by the least rotation
that brings the bone to its place: keypoints say nothing of a bone's turn about itself. In rest a person stands upright,
arms aside, and looks along z; y is up; metres.

The format knows no gaps. Where a keypoint is lost, its joint keeps its last turn (before the first, the first), and a
limb that was never there is not in the file. Several people are several ROOTs in one file; programs that read one ROOT
only want a file for each (`person`).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from .people import People
from .people_markers import UP, courses, rate_of
from .skeletons import KEYPOINTS
from .writing import write_text

END = 0.05  # metres from the last joint of a chain to its end site
_X, _Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
# Joint, its parent, and where it lies in rest, seen from the parent. The left side is x, because people look along z.
_TREE = (
    ("mid_hip", "", 0.0 * _X),
    ("root", "mid_hip", _Y),
    ("mid_shoulder", "root", _Y),
    ("head", "mid_shoulder", _Y),
    ("left_shoulder", "mid_shoulder", _X),
    ("left_elbow", "left_shoulder", _X),
    ("left_wrist", "left_elbow", _X),
    ("right_shoulder", "mid_shoulder", -_X),
    ("right_elbow", "right_shoulder", -_X),
    ("right_wrist", "right_elbow", -_X),
    ("left_hip", "mid_hip", _X),
    ("left_knee", "left_hip", -_Y),
    ("left_ankle", "left_knee", -_Y),
    ("right_hip", "mid_hip", -_X),
    ("right_knee", "right_hip", -_Y),
    ("right_ankle", "right_knee", -_Y),
)
_NAMES = tuple(name for name, _, _ in _TREE)
_PARENT = np.array([_NAMES.index(parent) if parent else -1 for _, parent, _ in _TREE])
_REST = np.array([rest for _, _, rest in _TREE])


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """One person: offsets (16, 3) of the joints in rest, which are there, hips (f, 3) and local turns (f, 16, 3, 3)."""

    offset: Float[np.ndarray, "16 3"]
    there: Bool[np.ndarray, " 16"]
    hips: Float[np.ndarray, "f 3"]
    turn: Float[np.ndarray, "f 16 3 3"]


def write_bvh(path: Path | str, people: People, person: int | None = None) -> None:
    """Write people as skeletons, whole or not at all.

    Parameters
    ----------
    person : int or None
        Label of the only one to write; None writes all.

    Raises
    ------
    ValueError
        If there is nobody with hips, or not this person: the format holds at least one skeleton.
    """
    write_text(Path(path), bvh_text(people, person))


def bvh_text(people: People, person: int | None = None) -> str:
    """Text of the hierarchy and its motion; see `write_bvh`."""
    labels, p = courses(people)
    if person is not None:
        p, labels = p[:, labels == person], labels[labels == person]
    lines, columns = ["HIERARCHY"], []
    for i, label in enumerate(labels.tolist()):
        skeleton = skeleton_of(_in_order(p[:, i]) * UP)
        if skeleton is None:
            continue
        lines += _hierarchy(skeleton, 0, f"{label}_", 0)
        columns += [skeleton.hips, *(_angles(skeleton.turn[:, j]) for j in np.flatnonzero(skeleton.there))]
    if not columns:
        raise ValueError(f"people: got nobody with hips{'' if person is None else f' labelled {person}'}, wanted one")
    rows = np.concatenate(columns, axis=1)
    lines += ["MOTION", f"Frames: {rows.shape[0]}", f"Frame Time: {1.0 / rate_of(people):.10g}"]
    lines += [" ".join(f"{value + 0.0:.6f}" for value in row) for row in rows.tolist()]
    return "\n".join(lines) + "\n"


def _in_order(p: Float[np.ndarray, "f 16 3"]) -> Float[np.ndarray, "f 16 3"]:
    """Keypoints in the tree's order; centre joints that lack are built from those about them."""
    out = p[:, [KEYPOINTS.index(name) for name in _NAMES]]
    for name, ends in (("mid_hip", ("left_hip", "right_hip")), ("mid_shoulder", ("left_shoulder", "right_shoulder"))):
        at, lacking = _NAMES.index(name), np.isnan(out[:, _NAMES.index(name), 0])
        out[lacking, at] = out[:, [_NAMES.index(end) for end in ends]].mean(axis=1)[lacking]
    at = _NAMES.index("root")
    lacking = np.isnan(out[:, at, 0])
    out[lacking, at] = 0.5 * (out[:, _NAMES.index("mid_hip")] + out[:, _NAMES.index("mid_shoulder")])[lacking]
    return out


def skeleton_of(p: Float[np.ndarray, "f 16 3"]) -> Skeleton | None:
    """The skeleton that follows keypoints in the tree's order, y up; None if its hips are never there."""
    f = p.shape[0]
    bone = p - p[:, np.maximum(_PARENT, 0)]
    known = ~np.isnan(bone[..., 0])
    there = np.asarray(known.any(axis=0))
    for j in range(1, len(_NAMES)):
        there[j] &= there[_PARENT[j]]
    if not there[0]:
        return None
    length = np.array([np.median(np.linalg.norm(bone[known[:, j], j], axis=1)) if there[j] else 0.0 for j in range(16)])
    offset = _REST * length[:, None]
    world, turn = np.tile(np.eye(3), (f, 16, 1, 1)), np.tile(np.eye(3), (f, 16, 1, 1))
    for j in range(16):
        children = np.flatnonzero(there & np.equal(_PARENT, j))
        above = world[:, _PARENT[j]] if j else np.tile(np.eye(3), (f, 1, 1))
        if children.size:
            sure = np.asarray(known[:, children].all(axis=1))
            now = _fitted(above[sure], offset[children], bone[sure][:, children])
            turn[:, j] = _held(np.swapaxes(above[sure], 1, 2) @ now, sure)
        world[:, j] = above @ turn[:, j]
    return Skeleton(offset, there, _held(p[known[:, 0], 0], known[:, 0]), turn)


def _held(values: Float[np.ndarray, "n ..."], sure: Bool[np.ndarray, " f"]) -> Float[np.ndarray, "f ..."]:
    """Values of the sure frames in all frames: the last one, before the first the first; turns never known are none."""
    if not values.shape[0]:
        return np.tile(np.eye(3), (sure.size, 1, 1))
    return values[np.maximum(np.cumsum(sure) - 1, 0)]


def _fitted(
    above: Float[np.ndarray, "n 3 3"], rest: Float[np.ndarray, "c 3"], bone: Float[np.ndarray, "n c 3"]
) -> Float[np.ndarray, "n 3 3"]:
    """Rotations that bring bones in rest to where they are, from the parent's axes on."""
    if rest.shape[0] == 1:
        return _least_turn((above @ rest[0][:, None])[..., 0], bone[:, 0]) @ above
    u, _, vt = np.linalg.svd(np.swapaxes(bone, 1, 2) @ rest)
    sign = np.ones((bone.shape[0], 3))
    sign[:, 2] = np.linalg.det(u) * np.linalg.det(vt)
    return (u * sign[:, None]) @ vt


def _least_turn(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """The least rotations that bring directions a to b: R = 1 + [v] + [v]^2 / (1 + c), v = a x b, c = a . b."""
    a = a / np.maximum(np.linalg.norm(a, axis=1, keepdims=True), 1e-12)
    b = b / np.maximum(np.linalg.norm(b, axis=1, keepdims=True), 1e-12)
    v, c = np.cross(a, b), (a * b).sum(axis=1)
    skew = np.zeros((a.shape[0], 3, 3))
    skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    skew -= np.swapaxes(skew, 1, 2)
    out = np.eye(3) + skew + skew @ skew / np.maximum(1.0 + c, 1e-12)[:, None, None]
    opposite = c < -1.0 + 1e-9  # half a turn about anything across
    across = np.cross(a, np.where(np.abs(a[:, :1]) < 0.9, _X, _Y))
    across = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    half = 2.0 * across[:, :, None] * across[:, None, :] - np.eye(3)
    return np.where(opposite[:, None, None], half, out)


def _angles(R: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3"]:
    """Degrees about z, x, y of R = R_z R_x R_y."""
    x = np.arcsin(np.clip(R[:, 2, 1], -1.0, 1.0))
    level = np.abs(R[:, 2, 1]) > 1.0 - 1e-9  # z and y turn about one axis: all of it is given to z
    z = np.where(level, np.arctan2(R[:, 1, 0], R[:, 0, 0]), np.arctan2(-R[:, 0, 1], R[:, 1, 1]))
    y = np.where(level, 0.0, np.arctan2(-R[:, 2, 0], R[:, 2, 2]))
    return np.degrees(np.stack([z, x, y], axis=1))


def _children(skeleton: Skeleton, j: int) -> Int[np.ndarray, " c"]:
    return np.flatnonzero(skeleton.there & np.equal(_PARENT, j))


def _hierarchy(skeleton: Skeleton, j: int, prefix: str, depth: int) -> list[str]:
    """Lines of a joint and all below it, in the tree's order; the last of a chain has an end site 5 cm beyond."""
    pad, children = "\t" * depth, _children(skeleton, j)
    offset = " ".join(f"{value + 0.0:.6f}" for value in skeleton.offset[j])
    place = "6 Xposition Yposition Zposition" if j == 0 else "3"
    lines = [
        f"{pad}{'JOINT' if j else 'ROOT'} {prefix}{_NAMES[j]}",
        f"{pad}{{",
        f"{pad}\tOFFSET {offset}",
        f"{pad}\tCHANNELS {place} Zrotation Xrotation Yrotation",
    ]
    if not children.size:
        end = " ".join(f"{value + 0.0:.6f}" for value in END * _REST[j])
        lines += [f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET {end}", f"{pad}\t}}"]
    for child in children:
        lines += _hierarchy(skeleton, int(child), prefix, depth + 1)
    return [*lines, f"{pad}}}"]
