"""A track in, the stretches in which another pose looked the same out, named by joint.

The tracker keeps a rival pose while a link may be folded to either side of the image plane (`hypotheses`). A stretch is
a run of frames, with short gaps, in which some joint of the two differs by more than 5 degrees.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .hypotheses import AMBIGUOUS
from .kinematics import Model
from .observability import length_unit, sliding_joints
from .observability_words import span
from .track import Track

_GAP = 3  # frames that a rival may be absent for
_MOST_NAMED = 4


@dataclass(frozen=True, slots=True, eq=False)
class Ambiguity:
    """Stretches with a second pose.

    Attributes
    ----------
    first, last, count : (a,)
        Frame numbers, and in how many frames between them a second pose lived.
    difference : (a, j)
        Second pose less the reported one, where they are farthest apart, radians (model units for sliding joints).
    scale : (j,)
        What counts as one radian for each joint.
    weight : (a,)
        Largest weight of the second pose.
    """

    joint_names: tuple[str, ...]
    units: str
    first: Int[np.ndarray, " a"]
    last: Int[np.ndarray, " a"]
    count: Int[np.ndarray, " a"]
    difference: Float[np.ndarray, "a j"]
    scale: Float[np.ndarray, " j"]
    weight: Float[np.ndarray, " a"]


def ambiguity(track: Track, model: Model) -> Ambiguity:
    """Stretches of a track with a second pose; none for a track that does not say."""
    count = len(model.joint_names)
    scale = np.where(sliding_joints(model), length_unit(model), 1.0)
    rival = np.full(track.q.shape, np.nan) if track.rival is None else track.rival
    weight = np.zeros(track.frame.size) if track.rival_weight is None else track.rival_weight
    off = (rival - track.q) / scale
    far = np.nan_to_num(np.abs(off)).max(axis=1, initial=0.0)
    rows = np.flatnonzero(far > AMBIGUOUS)
    starts = rows[np.diff(rows, prepend=-2 - _GAP) > _GAP + 1]
    runs = np.split(rows, np.searchsorted(rows, starts[1:])) if rows.size else []
    widest = np.array([run[np.argmax(far[run])] for run in runs], dtype=int)
    return Ambiguity(
        joint_names=model.joint_names,
        units=model.units,
        first=track.frame[[int(run[0]) for run in runs]],
        last=track.frame[[int(run[-1]) for run in runs]],
        count=np.array([run.size for run in runs], dtype=int),
        difference=(off[widest] * scale).reshape(-1, count),
        scale=scale,
        weight=np.array([float(weight[run].max()) for run in runs]),
    )


def named(seen: Ambiguity, row: int) -> tuple[tuple[str, float, str], ...]:
    """Joints that differ by more than 5 degrees in a stretch, the largest first: name, difference, unit."""
    angle = np.abs(seen.difference[row] / seen.scale)
    order = [i for i in np.argsort(-angle, kind="stable") if angle[i] > AMBIGUOUS][:_MOST_NAMED]
    slides = seen.scale != 1.0
    return tuple(
        (
            seen.joint_names[i],
            round(float(seen.difference[row, i]) if slides[i] else float(np.degrees(seen.difference[row, i])), 1),
            seen.units if slides[i] else "deg",
        )
        for i in order
    )


def lines(seen: Ambiguity) -> tuple[str, ...]:
    """The stretches as sentences; none if there were none."""
    texts = []
    for row in range(seen.count.size):
        joints = ", ".join(f"{name} {value:+.1f} {unit}" for name, value, unit in named(seen, row))
        when = span(int(seen.first[row]), int(seen.last[row]))
        texts.append(f"{joints}: folded it looks the same; weight up to {seen.weight[row]:.2f}, {when}")
    return tuple(texts)


def as_data(seen: Ambiguity) -> list[dict[str, object]]:
    """The stretches as plain data for JSON; degrees, model units for sliding joints."""
    return [
        {
            "first": int(seen.first[row]),
            "last": int(seen.last[row]),
            "frames": int(seen.count[row]),
            "weight": round(float(seen.weight[row]), 3),
            "joints": {name: value for name, value, _ in named(seen, row)},
        }
        for row in range(seen.count.size)
    ]
