"""Steady, labelled people in, `people.csv` out; and back. Metres, seconds, camera axes.

`frame,time,person,keypoint,x,y,z,confidence,cxx,cxy,cxz,cyy,cyz,czz,status`: as `skeletons.csv`, but here a `person`
stays the same from frame to frame. A `seen` or `predicted` keypoint has a finite place and covariance (m^2), always. A
`lost` one may have neither; then both are left empty, and its confidence is 0.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from ..errors import InputError
from .skeletons import KEYPOINTS, MOST_FRAMES, MOST_PERSONS
from .tables import Table, integers, numbers, read_table, words
from .writing import write_text

NAME = "people.csv"
STATUSES = ("seen", "predicted", "lost")
SEEN, PREDICTED, LOST = range(len(STATUSES))
COLUMNS = (
    "frame", "time", "person", "keypoint", "x", "y", "z", "confidence",
    "cxx", "cxy", "cxz", "cyy", "cyz", "czz", "status",
)  # fmt: skip
_UPPER = np.triu_indices(3)
_NEGATIVE = 1e-9  # share of the largest variance by which rounding to ten digits may push an eigenvalue below zero


@dataclass(frozen=True, slots=True, eq=False)
class People:
    """Who was where, sorted by frame, then by person.

    Attributes
    ----------
    time : (f,)
        Seconds of every frame, strictly rising; also of frames without anybody.
    frame, person : (d,)
        Frame of each entry, and who it is; a label is one person's throughout.
    p : (d, 16, 3)
        Keypoints in the order of `KEYPOINTS`, metres, camera axes; NaN only where lost.
    confidence : (d, 16)
        Of the measurement that was used, 0..1; 0 where there was none.
    covariance : (d, 16, 3, 3)
        m^2; NaN only where lost.
    status : (d, 16)
        Index into `STATUSES`.
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    time: Float[np.ndarray, " f"]
    frame: Int[np.ndarray, " d"]
    person: Int[np.ndarray, " d"]
    p: Float[np.ndarray, "d 16 3"]
    confidence: Float[np.ndarray, "d 16"]
    covariance: Float[np.ndarray, "d 16 3 3"]
    status: Int8[np.ndarray, "d 16"]
    warnings: tuple[str, ...] = ()


def people_text(people: People) -> str:
    """Text of `people.csv`.

    Raises
    ------
    ValueError
        If a time is not finite, a status unknown, or a keypoint that is not lost has no finite place and covariance.

    >>> zero = np.zeros(1, dtype=int)
    >>> C = np.broadcast_to(np.eye(3) / 64, (1, 16, 3, 3))
    >>> one = People(np.zeros(1), zero, zero, np.ones((1, 16, 3)), np.ones((1, 16)), C, np.zeros((1, 16), np.int8))
    >>> print(people_text(one).splitlines()[1])
    0,0,0,left_shoulder,1,1,1,1,0.015625,0,0,0.015625,0,0.015625,seen
    """
    values = np.concatenate(
        [people.p, people.confidence[..., None], people.covariance[..., _UPPER[0], _UPPER[1]]], axis=-1
    )
    if not np.isfinite(people.time).all():
        raise ValueError("people: time: is not finite; results hold finite numbers")
    if ((people.status < 0) | (people.status >= len(STATUSES))).any():
        raise ValueError(f"people: status: an index into {', '.join(STATUSES)} is wanted")
    whole = np.asarray(np.isfinite(values).all(axis=-1))
    bad = ~whole & (people.status != LOST)
    if bad.any():
        i, k = np.argwhere(bad)[0]
        raise ValueError(
            f"people: frame {people.frame[i]}, person {people.person[i]}: {KEYPOINTS[k]} is not finite; only a lost "
            "keypoint may lack its place"
        )
    lines = [",".join(COLUMNS)]
    for i, (n, who) in enumerate(zip(people.frame.tolist(), people.person.tolist(), strict=True)):
        head = f"{n},{_short(float(people.time[n]))},{who}"
        for name, row, there, status in zip(
            KEYPOINTS, values[i].tolist(), whole[i].tolist(), people.status[i].tolist(), strict=True
        ):
            cells = ",".join(map(_short, row)) if there else ",,,0,,,,,,"
            lines.append(f"{head},{name},{cells},{STATUSES[status]}")
    return "\n".join(lines) + "\n"


def write_people(path: Path | str, people: People) -> None:
    """Write `people.csv`, whole or not at all; see `people_text`."""
    write_text(Path(path), people_text(people))


def read_people(path: Path | str) -> People:
    """Read `people.csv`; frames that it does not name get their time from the others by frame number.

    Raises
    ------
    InputError
        For a table that is malformed, names an unknown keypoint or status, does not give each person of a frame all 16
        keypoints once, lacks the place of a keypoint that is not lost, whose time does not rise with the frames, or
        with a covariance that has a negative eigenvalue.
    """
    path = Path(path)
    table = read_table(path, COLUMNS)
    frame, person = _whole(table, "frame", MOST_FRAMES), _whole(table, "person", MOST_PERSONS)
    keypoint = np.array([KEYPOINTS.index(word) for word in words(table, "keypoint", KEYPOINTS)], dtype=int)
    status = np.array([STATUSES.index(word) for word in words(table, "status", STATUSES)], dtype=np.int8)
    p = np.column_stack([numbers(table, axis, empty=True) for axis in "xyz"])
    confidence = numbers(table, "confidence")
    _refuse(table, (confidence < 0) | (confidence > 1), "confidence: a number from 0 to 1 is wanted")
    covariance = _covariance(table)
    gap = np.isnan(p).any(axis=1) | np.isnan(covariance).any(axis=(1, 2))
    _refuse(table, gap & (status != LOST), "x ... czz: are wanted for a keypoint that is not lost")
    p[gap], covariance[gap] = np.nan, np.nan
    key, first, at = np.unique(np.column_stack([frame, person]), axis=0, return_index=True, return_inverse=True)
    d = key.shape[0]
    cell = at.reshape(-1) * len(KEYPOINTS) + keypoint
    counts = np.bincount(cell, minlength=d * len(KEYPOINTS))
    _refuse(table, counts[cell] > 1, "keypoint: is given twice for this frame and person; once is wanted")
    _refuse(
        table,
        np.isin(np.arange(frame.size), first[(counts.reshape(d, len(KEYPOINTS)) == 0).any(axis=1)]),
        "keypoint: some are missing for this frame and person; all 16 are wanted",
    )
    order = np.argsort(cell)
    shape = (d, len(KEYPOINTS))
    return People(
        time=_times(table, frame, numbers(table, "time")),
        frame=key[:, 0].copy(),
        person=key[:, 1].copy(),
        p=p[order].reshape(*shape, 3),
        confidence=confidence[order].reshape(shape),
        covariance=covariance[order].reshape(*shape, 3, 3),
        status=status[order].reshape(shape),
    )


def _whole(table: Table, name: str, most: int) -> Int[np.ndarray, " n"]:
    values = integers(table, name)
    _refuse(table, values >= most, f"{name}: a number below {most} is wanted")
    return values


def _covariance(table: Table) -> Float[np.ndarray, "n 3 3"]:
    """Covariances, NaN where any of their cells is empty."""
    columns = [numbers(table, name, empty=True) for name in COLUMNS[8:14]]
    out = np.empty((columns[0].size, 3, 3))
    for i, j, values in zip(*_UPPER, columns, strict=True):
        out[:, i, j] = out[:, j, i] = values
    known = np.asarray(~np.isnan(out).any(axis=(1, 2)))
    spread = np.linalg.eigvalsh(np.where(known[:, None, None], out, np.eye(3)))
    _refuse(table, spread[:, 0] < -_NEGATIVE * spread[:, 2], "cxx ... czz: no covariance: it has a negative eigenvalue")
    return out


def _times(table: Table, frame: Int[np.ndarray, " n"], given: Float[np.ndarray, " n"]) -> Float[np.ndarray, " f"]:
    """Seconds of all frames up to the last."""
    named, first, back = np.unique(frame, return_index=True, return_inverse=True)
    _refuse(table, given != given[first][back.reshape(-1)], "time: differs within one frame; one time is wanted")
    late = np.zeros(frame.size, dtype=bool)
    late[first[1:]] = np.diff(given[first]) <= 0
    _refuse(table, late, "time: is not after that of the frame before; strictly rising values are wanted")
    if not named.size:
        return np.zeros(0)
    number = np.arange(named[-1] + 1)
    step = float(np.median(np.diff(given[first]) / np.diff(named))) if named.size > 1 else 1.0
    return np.interp(number, named, given[first]) + step * np.minimum(number - named[0], 0)


def _refuse(table: Table, bad: Bool[np.ndarray, " n"], text: str) -> None:
    rows = np.flatnonzero(bad)
    if rows.size:
        raise InputError(f"{table.path}: line {table.lines[rows[0]]}: {text}")


def _short(value: float) -> str:
    return f"{value + 0.0:.10g}"
