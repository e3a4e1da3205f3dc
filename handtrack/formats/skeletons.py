"""`skeletons.csv` and `truth.csv` of bodies in, keypoints as arrays out; and back. Metres, seconds, camera axes.

* `skeletons.csv`: `frame,time,person,keypoint,x,y,z,confidence` and, where the sensor says it, `state`. `person` counts
  the detections of one frame and is no identity. A keypoint that was not seen has empty coordinates and confidence 0.
* `truth.csv`: `frame,person,keypoint,x,y,z`; here a `person` stays the same from frame to frame.

A detection is one `(frame, person)`; frames without any are allowed. Their time is filled in between the others' by
frame number.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from ..errors import InputError
from .tables import LONGEST_GAP, Table, integers, numbers, read_table, words
from .writing import write_text

KEYPOINTS = (
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "root", "mid_hip", "mid_shoulder", "head",
)  # fmt: skip
STATES = ("tracked", "inferred", "lost")
TRACKED, INFERRED, LOST = range(len(STATES))

FARTHEST = 50.0  # metres: a room sensor sees no farther, so more is another unit
MOST_FRAMES, MOST_PERSONS, MOST_CELLS = 1_000_000, 1000, 5_000_000
SLOW = 100.0  # times whose step is this many frames long count milliseconds
_COLUMNS = ("frame", "time", "person", "keypoint", "x", "y", "z", "confidence")
_TRUTH_COLUMNS = ("frame", "person", "keypoint", "x", "y", "z")


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """What a body sensor saw, sorted by frame, then by person.

    Attributes
    ----------
    time : (f,)
        Seconds of every frame, strictly rising; also of frames without a detection.
    frame, person : (d,)
        Frame of each detection, and its number in that frame, from 0; no identity.
    p : (d, 16, 3)
        Keypoints in the order of `KEYPOINTS`, metres, camera axes; NaN where unseen.
    confidence : (d, 16)
        0..1; 0 where unseen.
    state : (d, 16)
        Index into `STATES`; `lost` where unseen, `tracked` where seen by a sensor that does not say.
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    time: Float[np.ndarray, " f"]
    frame: Int[np.ndarray, " d"]
    person: Int[np.ndarray, " d"]
    p: Float[np.ndarray, "d 16 3"]
    confidence: Float[np.ndarray, "d 16"]
    state: Int8[np.ndarray, "d 16"]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class TruthPoints:
    """True keypoints: `p` is (f, persons, 16, 3), metres, camera axes, NaN where unknown; warnings of the reader."""

    p: Float[np.ndarray, "f persons 16 3"]
    warnings: tuple[str, ...] = ()


def read_skeletons(path: Path | str, frames: int | None, fps: float) -> Detections:
    """Read the detections of a scene.

    Parameters
    ----------
    frames : int or None
        Number of frames of the scene; None takes the last frame of the file as the last. Rows beyond are left out, with
        a warning.
    fps : float
        Frames a second: the time of frames that the file does not name, and the check of the time's unit.

    Raises
    ------
    InputError
        For a table that is malformed, names an unknown keypoint or state, gives a keypoint twice, has coordinates
        beyond 50 m or times that look like milliseconds, or whose time does not rise with the frames.
    """
    path = Path(path)
    table = read_table(path, _COLUMNS)
    frame, person, keypoint, p = _points(table)
    confidence = _confidence(table)
    seen = ~np.isnan(p[:, 0])
    state, notes = _states(table, seen)
    seen &= state != LOST
    p[~seen], confidence[~seen] = np.nan, 0.0
    if frames is not None and frame.size and frame.max() >= frames:
        kept = int(np.count_nonzero(frame < frames))
        ends = f"the scene ends with frame {frames - 1}" if frames else "the scene has no frame"
        notes.append(f"{path}: has rows up to frame {frame.max()}; {ends} and {frame.size - kept} rows are left out")
    count = frames if frames is not None else int(frame.max(initial=-1)) + 1
    time, gap = _times(table, frame, count, fps)
    notes += gap
    inside = frame < count
    key, at = np.unique(np.column_stack([frame, person])[inside], axis=0, return_inverse=True)
    d = key.shape[0]
    out = Detections(
        time, key[:, 0].copy(), key[:, 1].copy(), np.full((d, 16, 3), np.nan), np.zeros((d, 16)),
        np.full((d, 16), LOST, dtype=np.int8), tuple(notes),
    )  # fmt: skip
    place = (at.reshape(-1), keypoint[inside])
    out.p[place], out.confidence[place], out.state[place] = p[inside], confidence[inside], state[inside]
    return out


def read_truth(path: Path | str, frames: int | None = None) -> TruthPoints:
    """Read true keypoints.

    Parameters
    ----------
    frames : int or None
        Number of frames of the scene; truth that is shorter or longer is a warning. None: as many as the file has.

    Raises
    ------
    InputError
        As `read_skeletons`.
    """
    path = Path(path)
    table = read_table(path, _TRUTH_COLUMNS)
    frame, person, keypoint, p = _points(table)
    count = frames if frames is not None else int(frame.max(initial=-1)) + 1
    inside = frame < count
    persons = int(person.max(initial=-1)) + 1
    if count * persons > MOST_CELLS:
        raise InputError(
            f"{path}: {count} frames of {persons} persons; at most {MOST_CELLS} of both together are wanted"
        )
    out = np.full((count, persons, 16, 3), np.nan)
    out[frame[inside], person[inside], keypoint[inside]] = p[inside]
    notes = []
    absent = count - np.unique(frame[inside & ~np.isnan(p[:, 0])]).size
    if absent:
        notes.append(f"{path}: has no truth for {absent} of {count} frames")
    if not inside.all():
        notes.append(f"{path}: has truth up to frame {frame.max()}; the scene ends with frame {count - 1}")
    return TruthPoints(out, tuple(notes))


def _points(
    table: Table,
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Frame, person, index of the keypoint and coordinates (NaN for an unseen one) of every row."""
    frame, person = integers(table, "frame"), integers(table, "person")
    for name, values, most in (("frame", frame, MOST_FRAMES), ("person", person, MOST_PERSONS)):
        if values.max(initial=0) >= most:
            row = int(values.argmax())
            raise InputError(f"{_at(table, row)} {name}: {values[row]} given; a number below {most} is wanted")
    number = {name: i for i, name in enumerate(KEYPOINTS)}
    keypoint = np.array([number[word] for word in words(table, "keypoint", KEYPOINTS)], dtype=int)
    p = np.column_stack([numbers(table, axis, empty=True) for axis in "xyz"])
    known = ~np.isnan(p)
    _refuse(table, known.any(axis=1) != known.all(axis=1), "x, y, z: only some are given; all three or none are wanted")
    far = np.asarray((np.abs(np.where(known, p, 0.0)) > FARTHEST).any(axis=1))
    _refuse(table, far, f"x, y, z: beyond {FARTHEST:g} m, as if in millimetres; metres are wanted")
    _, first, back = np.unique(
        np.column_stack([frame, person, keypoint]), axis=0, return_index=True, return_inverse=True
    )
    again = first[back.reshape(-1)] != np.arange(frame.size)
    _refuse(table, again, "keypoint: is given twice for this frame and person; once is wanted")
    return frame, person, keypoint, p


def _confidence(table: Table) -> Float[np.ndarray, " n"]:
    values = numbers(table, "confidence")
    _refuse(table, (values < 0) | (values > 1), "confidence: a number from 0 to 1 is wanted")
    return values


def _states(table: Table, seen: Bool[np.ndarray, " n"]) -> tuple[Int8[np.ndarray, " n"], list[str]]:
    """State of every row, and warnings; a sensor without states tracks what it sees."""
    if "state" not in table.names:
        return np.where(seen, TRACKED, LOST).astype(np.int8), []
    number = {name: i for i, name in enumerate(STATES)}
    state = np.array([number[word] for word in words(table, "state", STATES)], dtype=np.int8)
    _refuse(table, ~seen & (state != LOST), "state: 'lost' is wanted where there are no coordinates")
    placed = np.flatnonzero(seen & (state == LOST))
    if not placed.size:
        return state, []
    return state, [f"{_at(table, placed[0])} coordinates of a lost keypoint are not used (in {placed.size} rows)"]


def _times(
    table: Table, frame: Int[np.ndarray, " n"], count: int, fps: float
) -> tuple[Float[np.ndarray, " f"], list[str]]:
    """Seconds of all frames from those that the rows give, and a warning for a gap."""
    given = numbers(table, "time")
    named, first, back = np.unique(frame, return_index=True, return_inverse=True)
    time = given[first]
    _refuse(
        table, given != time[back.reshape(-1)], "time: differs within one frame; the same for all its rows is wanted"
    )
    step = np.diff(time)
    late = np.zeros(frame.size, dtype=bool)
    late[first[1:]] = step <= 0
    _refuse(table, late, "time: is not after that of the frame before; strictly rising values are wanted")
    if step.size and np.median(step / np.diff(named)) * fps > SLOW:
        raise InputError(
            f"{table.path}: time: {np.median(step / np.diff(named)):.4g} a frame at {fps:g} frames a second, as if in "
            "milliseconds; seconds are wanted"
        )
    notes = []
    if step.size and step.max() > LONGEST_GAP:
        i = int(step.argmax())
        notes.append(f"{_at(table, first[i + 1])} {step[i]:.3g} s pass without a row")
    number = np.arange(count)
    if not named.size:
        return number / fps, notes
    out = np.interp(number, named, time)
    out += np.minimum(number - named[0], 0) / fps + np.maximum(number - named[-1], 0) / fps
    return out, notes


def _at(table: Table, row: int | np.integer) -> str:
    return f"{table.path}: line {table.lines[row]}:"


def _refuse(table: Table, bad: Bool[np.ndarray, " n"], text: str) -> None:
    rows = np.flatnonzero(bad)
    if rows.size:
        raise InputError(f"{_at(table, rows[0])} {text}")


def write_skeletons(path: Path | str, detections: Detections, with_state: bool = False) -> None:
    """Write `skeletons.csv`, all 16 keypoints of every detection; whole or not at all."""
    write_text(Path(path), skeletons_text(detections, with_state))


def skeletons_text(detections: Detections, with_state: bool = False) -> str:
    """Text of `skeletons.csv`.

    >>> p, zero = np.full((1, 16, 3), np.nan), np.zeros(1, dtype=int)
    >>> p[0, 5] = 0.25, 0.5, 2.0
    >>> seen = Detections(np.zeros(1), zero, zero, p, np.zeros((1, 16)), np.full((1, 16), 2, dtype=np.int8))
    >>> print(skeletons_text(seen).splitlines()[6])
    0,0,0,right_wrist,0.25,0.5,2,0
    """
    lines = [",".join([*_COLUMNS, "state"] if with_state else _COLUMNS)]
    for i, (n, who) in enumerate(zip(detections.frame, detections.person, strict=True)):
        head = f"{n},{_short(float(detections.time[n]))},{who}"
        for k, name in enumerate(KEYPOINTS):
            end = f",{STATES[detections.state[i, k]]}" if with_state else ""
            lines.append(
                f"{head},{name},{_place(detections.p[i, k])},{_short(float(detections.confidence[i, k]))}{end}"
            )
    return "\n".join(lines) + "\n"


def write_truth(path: Path | str, truth: TruthPoints) -> None:
    """Write `truth.csv`, every keypoint that is known; whole or not at all."""
    write_text(Path(path), truth_text(truth))


def truth_text(truth: TruthPoints) -> str:
    """Text of `truth.csv`."""
    known = np.argwhere(~np.isnan(truth.p).any(axis=-1)).tolist()
    lines = [",".join(_TRUTH_COLUMNS)]
    lines += [f"{n},{who},{KEYPOINTS[k]},{_place(truth.p[n, who, k])}" for n, who, k in known]
    return "\n".join(lines) + "\n"


def _short(value: float) -> str:
    """Ten digits: far below any noise, and the same text wherever rounding differs in the last bit."""
    return f"{float(value) + 0.0:.10g}"


def _place(p: Float[np.ndarray, " 3"]) -> str:
    return ",," if np.isnan(p).any() else ",".join(_short(value) for value in p.tolist())
