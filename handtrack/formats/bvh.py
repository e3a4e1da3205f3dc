"""A BioVision hierarchy file in, its joints, their channels and their places in every frame out.

A joint sits on its parent by `OFFSET` and turns by its channels in the order in which they are listed, each rotation
about an axis already turned by those before: R = R_1 R_2 R_3. Position channels add to the offset. `End Site` ends a
chain; it has a place and no channels, and is called after its joint, `<joint>_end`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from .paths import read_bytes

MOST_BYTES, MOST_JOINTS, MOST_FRAMES = 200_000_000, 1_000, 1_000_000
CHANNELS = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")


@dataclass(frozen=True, slots=True, eq=False)
class Bvh:
    """Joints and their motion.

    Attributes
    ----------
    names : tuple of n str
        Joints and end sites, parents first.
    parent : (n,)
        -1 for a root.
    offset : (n, 3)
        In the parent's axes, in the file's unit (unknown to the format).
    channels : tuple of n tuples of int
        Numbers in `CHANNELS` of each joint's channels.
    motion : (m, c)
        All channels of every frame; rotations in degrees.
    seconds : float
        Between frames.
    """

    names: tuple[str, ...]
    parent: Int[np.ndarray, " n"]
    offset: Float[np.ndarray, "n 3"]
    channels: tuple[tuple[int, ...], ...]
    motion: Float[np.ndarray, "m c"]
    seconds: float


class _Words:
    """The words of a file, one after the other, and the line of the last one."""

    def __init__(self, path: Path, text: str) -> None:
        self.path, self.line, self._at = path, 1, 0
        self._words = [(word, number) for number, line in enumerate(text.splitlines(), 1) for word in line.split()]

    def fail(self, wanted: str) -> NoReturn:
        raise InputError(f"{self.path}: line {self.line}: {wanted}")

    def next(self, wanted: str) -> str:
        if self._at >= len(self._words):
            self.fail(f"the file ends; {wanted} is wanted")
        word, self.line = self._words[self._at]
        self._at += 1
        return word

    def expect(self, *known: str) -> str:
        word = self.next(" or ".join(known))
        if word not in known:
            self.fail(f"{word[:40]!r} was found; {' or '.join(known)} is wanted")
        return word

    def number(self, wanted: str) -> float:
        word = self.next(wanted)
        try:
            value = float(word)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            self.fail(f"{word[:40]!r} was found; {wanted} is wanted")
        return value

    def rest(self) -> tuple[list[str], int]:
        """All words left, and the line of the first of them."""
        first = self._words[self._at][1] if self._at < len(self._words) else self.line
        return [word for word, _ in self._words[self._at :]], first


def read_bvh(path: Path | str) -> Bvh:
    """Read a BVH file.

    Raises
    ------
    InputError
        In one line with file, line and what was wanted: for anything that is not a hierarchy with its motion, names
        given twice, channels that are unknown or given twice, and numbers that are missing or not finite.
    """
    words = _Words(Path(path), read_bytes(Path(path), MOST_BYTES).decode("utf-8", "replace"))
    words.expect("HIERARCHY")
    names: list[str] = []
    parent: list[int] = []
    offset: list[list[float]] = []
    channels: list[tuple[int, ...]] = []
    chain: list[int] = []
    while True:
        word = words.expect(*(("JOINT", "End", "}") if chain else ("ROOT", "MOTION")))
        if word == "MOTION":
            break
        if word == "}":
            chain.pop()
            continue
        above = chain[-1] if chain else -1
        name = words.next("a name") if word != "End" else f"{names[above]}_end"
        if word == "End":
            words.expect("Site")
        if name in names:
            words.fail(f"joint {name!r} is given twice")
        chain.append(len(names))
        names.append(name)
        parent.append(above)
        words.expect("{")
        words.expect("OFFSET")
        offset.append([words.number("a number") for _ in range(3)])
        channels.append(() if word == "End" else _channels(words))
        if len(names) > MOST_JOINTS:
            words.fail(f"more than {MOST_JOINTS} joints; fewer are wanted")
    if not names:
        words.fail("no ROOT comes before MOTION; a hierarchy is wanted")
    motion, seconds = _motion(words, sum(map(len, channels)))
    return Bvh(tuple(names), np.array(parent), np.array(offset), tuple(channels), motion, seconds)


def _channels(words: _Words) -> tuple[int, ...]:
    """Channels of a joint."""
    words.expect("CHANNELS")
    count = words.number("a number of channels")
    if count not in range(7):
        words.fail(f"{count:g} channels; 0 to 6 are wanted")
    found = tuple(CHANNELS.index(words.expect(*CHANNELS)) for _ in range(int(count)))
    if len(set(found)) != len(found):
        words.fail("a channel is given twice")
    return found


def _motion(words: _Words, width: int) -> tuple[Float[np.ndarray, "m c"], float]:
    """Table of channels, and seconds between frames."""
    words.expect("Frames:")
    frames = words.number("a number of frames")
    if not (frames == int(frames) and 1 <= frames <= MOST_FRAMES):
        words.fail(f"{frames:g} frames; 1 to {MOST_FRAMES} are wanted")
    words.expect("Frame")
    words.expect("Time:")
    seconds = words.number("seconds")
    if not seconds > 0:
        words.fail(f"frame time {seconds:g}; a time > 0 is wanted")
    rest, line = words.rest()
    if len(rest) != int(frames) * width:
        raise InputError(
            f"{words.path}: line {line}: {len(rest)} numbers follow; {int(frames)} frames of {width} are wanted"
        )
    try:
        motion = np.array(rest, dtype=float).reshape(int(frames), width)
    except ValueError as error:
        raise InputError(f"{words.path}: line {line}: the motion holds a word that is no number ({error})") from error
    if not np.isfinite(motion).all():
        raise InputError(f"{words.path}: line {line}: the motion holds numbers that are not finite")
    return motion, seconds


def joint_frames(bvh: Bvh) -> tuple[Float[np.ndarray, "m n 3 3"], Float[np.ndarray, "m n 3"]]:
    """Axes (as columns) and places of all joints in every frame, in the axes of the root's parent."""
    frames, count = bvh.motion.shape[0], len(bvh.names)
    R, p = np.empty((frames, count, 3, 3)), np.empty((frames, count, 3))
    column = 0
    for i, kinds in enumerate(bvh.channels):
        turn = np.broadcast_to(np.eye(3), (frames, 3, 3))
        shift = np.tile(bvh.offset[i], (frames, 1))
        for kind in kinds:
            value = bvh.motion[:, column]
            column += 1
            if kind < 3:
                shift[:, kind] += value
            else:
                turn = turn @ _about(kind - 3, np.radians(value))
        above = bvh.parent[i]
        R[:, i] = turn if above < 0 else R[:, above] @ turn
        p[:, i] = shift if above < 0 else p[:, above] + (R[:, above] @ shift[..., None])[..., 0]
    return R, p


def _about(axis: int, angle: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 3 3"]:
    """Rotations about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    out = np.zeros((angle.size, 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[:, axis, axis] = 1.0
    out[:, i, i], out[:, j, j], out[:, i, j], out[:, j, i] = c, c, -s, s
    return out
