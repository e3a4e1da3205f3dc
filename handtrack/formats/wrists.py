"""The track of a hidden wrist in, `wrist.csv` out; and back. Metres, seconds, camera axes.

`frame,time,x,y,z,cxx,cxy,cxz,cyy,cyz,czz,volume,status,killed_collision,killed_joint_volume,killed_shell,killed_depth`:
mean and covariance of the weighted particles that the constraints left alive, before resampling; `volume` (m^3) is that
of the ellipsoid that holds 95 %, `4/3 pi 7.815^1.5 sqrt(det C)`; `killed_` counts the particles that each constraint
forbade. One row for each frame, and never NaN: a wrist that was never seen has a wide covariance and says `lost`.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Int

from ..errors import InputError
from .tables import check_rising, integers, numbers, read_table, words
from .writing import write_text

NAME = "wrist.csv"
STATUSES = ("tracked", "predicted", "uncertain", "lost")
KILLS = ("collision", "joint_volume", "shell", "depth")
COLUMNS = (
    "frame", "time", "x", "y", "z", "cxx", "cxy", "cxz", "cyy", "cyz", "czz", "volume", "status",
    *(f"killed_{name}" for name in KILLS),
)  # fmt: skip
_UPPER = np.triu_indices(3)


@dataclass(frozen=True, slots=True, eq=False)
class WristTrack:
    """Where a wrist was, frame by frame.

    Attributes
    ----------
    time : (f,)
        Seconds.
    mean, covariance : (f, 3), (f, 3, 3)
        Metres, camera axes; of the weighted particles before resampling.
    volume : (f,)
        Of the ellipsoid that holds 95 %, m^3.
    status : (f,) of str
        One of `STATUSES`.
    kills : (f, 4)
        Particles that each of `KILLS` forbade.
    elbow, shoulder : (f, 3)
        Means of the joints before; NaN where they are not known, as after reading.
    cloud : (f, c, 3)
        Some of the particles, each as likely as the others, spread as the covariance says; none after reading.
    seconds : (f,)
        Computing time, reading of images apart; NaN after reading.
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    time: Float[np.ndarray, " f"]
    mean: Float[np.ndarray, "f 3"]
    covariance: Float[np.ndarray, "f 3 3"]
    volume: Float[np.ndarray, " f"]
    status: np.ndarray
    kills: Int[np.ndarray, "f 4"]
    elbow: Float[np.ndarray, "f 3"]
    shoulder: Float[np.ndarray, "f 3"]
    cloud: Float32[np.ndarray, "f c 3"]
    seconds: Float[np.ndarray, " f"]
    warnings: tuple[str, ...] = ()


def wrist_text(track: WristTrack) -> str:
    """Text of `wrist.csv`.

    Raises
    ------
    ValueError
        If a time, mean, covariance or volume is not finite, or a status is unknown.
    """
    numbers_of = (track.time[:, None], track.mean, track.covariance[:, *_UPPER], track.volume[:, None])
    values = np.concatenate(numbers_of, axis=1)
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        raise ValueError(f"track: row {int(bad.argmax())} is not finite; results hold finite numbers")
    unknown = sorted(set(track.status.tolist()) - set(STATUSES))
    if unknown:
        raise ValueError(f"track: status '{unknown[0]}' is unknown; wanted: {', '.join(STATUSES)}")
    lines = [",".join(COLUMNS)]
    for n, (row, status, kills) in enumerate(zip(values.tolist(), track.status, track.kills.tolist(), strict=True)):
        cells = ",".join(f"{value + 0.0:.10g}" for value in row)
        lines.append(f"{n},{cells},{status},{','.join(map(str, kills))}")
    return "\n".join(lines) + "\n"


def write_wrist(path: Path | str, track: WristTrack) -> None:
    """Write `wrist.csv`, whole or not at all; see `wrist_text`."""
    write_text(Path(path), wrist_text(track))


def read_wrist(path: Path | str) -> WristTrack:
    """Read `wrist.csv`; what it does not hold is NaN or empty.

    Raises
    ------
    InputError
        For a table that is malformed, whose frames do not count from 0, or with a negative variance or volume.
    """
    path = Path(path)
    table = read_table(path, COLUMNS)
    frame, time = integers(table, "frame"), numbers(table, "time")
    check_rising(table, "time", time)
    values = {name: numbers(table, name) for name in COLUMNS[2:12]}
    for bad, text in (
        (frame != np.arange(frame.size), "frame: one row for each, counted from 0, is wanted"),
        (np.minimum.reduce([values[name] for name in ("cxx", "cyy", "czz", "volume")]) < 0, "0 or more is wanted"),
    ):
        if bad.any():
            raise InputError(f"{path}: line {table.lines[bad.argmax()]}: {text}")
    covariance = np.empty((frame.size, 3, 3))
    for (i, j), name in zip(np.transpose(_UPPER).tolist(), COLUMNS[5:11], strict=True):
        covariance[:, i, j] = covariance[:, j, i] = values[name]
    unknown = np.full((frame.size, 3), np.nan)
    return WristTrack(
        time=time,
        mean=np.column_stack([values[axis] for axis in "xyz"]),
        covariance=covariance,
        volume=values["volume"],
        status=np.array(words(table, "status", STATUSES), dtype=np.str_),
        kills=np.column_stack([integers(table, f"killed_{name}") for name in KILLS]),
        elbow=unknown,
        shoulder=unknown.copy(),
        cloud=np.zeros((frame.size, 0, 3), np.float32),
        seconds=np.full(frame.size, np.nan),
    )
