"""A folder of raw inertial logs in, the samples of all sensors on one clock out.

Each sensor has a folder of its own, with `Inertial.csv` (`Timestamp (us)`, `Gyroscope X (deg/s)` and Y, Z,
`Accelerometer X (g)` and Y, Z) and, where it has them, `Magnetometer.csv` (`X (a.u.)`, Y, Z) and `Quaternion.csv` (`W`,
X, Y, Z, the sensor's own estimate): the layout that x-IMU3 loggers write. Their counts differ, for each sensor samples
at a rate of its own and loses some. The common clock runs from the latest start to the earliest end; values between
two samples are interpolated, quaternions along the arc. A folder's name, less serial number and connection, is that of
the sensor.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation, Slerp

from ..errors import InputError
from .tables import Table, check_rising, numbers, read_table

GRAVITY = 9.80665  # m/s^2 in 1 g
MICROSECOND = 1e-6
LOST = 1.5  # an interval longer than this many usual ones has lost a sample
LONGEST_GAP = 0.25  # seconds that are bridged without a warning
MOST_SAMPLES = 5_000_000
TIME = "Timestamp (us)"
INERTIAL = tuple(
    f"{name} {axis} ({unit})" for name, unit in (("Gyroscope", "deg/s"), ("Accelerometer", "g")) for axis in "XYZ"
)
MAGNETOMETER = tuple(f"{axis} (a.u.)" for axis in "XYZ")
QUATERNION = ("W", "X", "Y", "Z")
_SERIAL = re.compile(r"\s+[0-9A-Fa-f]{8}(\s*\([^)]*\))?$")


@dataclass(frozen=True, slots=True, eq=False)
class ImuLogs:
    """What the sensors measured, on one clock.

    Attributes
    ----------
    names : tuple of n str
        Sensors, sorted; `left_upper_leg` for the folder `Left Upper Leg 64F61CC4 (UDP)`.
    time : (m,)
        Seconds from the first common moment, evenly spaced.
    gyroscope : (m, n, 3)
        rad/s, in each sensor's axes.
    accelerometer : (m, n, 3)
        m/s^2; a sensor at rest shows 9.8 upward.
    magnetometer : (m, n, 3)
        The sensor's own unit; NaN for a sensor without.
    wxyz : (m, n, 4)
        The sensor's own estimate of world_R_sensor, real part first; NaN for a sensor without.
    measured : (m, n)
        Whether no sample of the sensor was lost about that time.
    counts : tuple of n int
        Samples that each sensor gave.
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    names: tuple[str, ...]
    time: Float[np.ndarray, " m"]
    gyroscope: Float[np.ndarray, "m n 3"]
    accelerometer: Float[np.ndarray, "m n 3"]
    magnetometer: Float[np.ndarray, "m n 3"]
    wxyz: Float[np.ndarray, "m n 4"]
    measured: Bool[np.ndarray, "m n"]
    counts: tuple[int, ...]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Stream:
    """Times in seconds, and values, of one table."""

    time: Float[np.ndarray, " k"]
    values: Float[np.ndarray, "k d"]


def read_imu_logs(folder: Path | str, rate: float | None = None) -> ImuLogs:
    """Read the logs of all sensors below a folder.

    Parameters
    ----------
    rate : float, optional
        Samples a second of the common clock; the median of the sensors' own rates if not given.

    Raises
    ------
    InputError
        For a folder without logs, two sensors of one name, malformed tables, times that do not rise, and sensors that
        have no moment in common.
    ValueError
        If `rate` is not above 0.
    """
    folder = Path(folder)
    if rate is not None and not rate > 0.0:
        raise ValueError(f"rate: got {rate}; wanted a number above 0")
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; one with a folder for each sensor is wanted")
    folders = sorted(path.parent for path in folder.glob("*/Inertial.csv"))
    if not folders:
        raise InputError(f"{folder}: has no sensor; folders with an Inertial.csv each are wanted")
    names = [sensor_name(path.name) for path in folders]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{folder}: sensor '{name}' is there twice; names are unique")
    order = sorted(range(len(names)), key=names.__getitem__)
    folders, names = [folders[i] for i in order], [names[i] for i in order]
    notes: list[str] = []
    inertial = [_stream(path / "Inertial.csv", INERTIAL, notes) for path in folders]
    time = _common_clock(folder, inertial, rate)
    shape = (time.size, len(names))
    gyroscope, accelerometer = np.empty((*shape, 3)), np.empty((*shape, 3))
    magnetometer, wxyz = np.full((*shape, 3), np.nan), np.full((*shape, 4), np.nan)
    measured = np.empty(shape, dtype=bool)
    for i, (path, stream) in enumerate(zip(folders, inertial, strict=True)):
        values = _resampled(stream, time)
        gyroscope[:, i], accelerometer[:, i] = np.radians(values[:, :3]), GRAVITY * values[:, 3:]
        measured[:, i] = _measured(stream, time)
        if (path / "Magnetometer.csv").is_file():
            magnetometer[:, i] = _resampled(_stream(path / "Magnetometer.csv", MAGNETOMETER, notes), time)
        if (path / "Quaternion.csv").is_file():
            wxyz[:, i] = _turned(path / "Quaternion.csv", time, notes)
    counts = tuple(stream.time.size for stream in inertial)
    return ImuLogs(
        tuple(names), time - time[0], gyroscope, accelerometer, magnetometer, wxyz, measured, counts, tuple(notes)
    )


def sensor_name(folder: str) -> str:
    """Name of a sensor from that of its folder.

    >>> sensor_name("Left Upper Leg 64F61CC4 (UDP)")
    'left_upper_leg'
    """
    return re.sub(r"\W+", "_", _SERIAL.sub("", folder).strip()).lower()


def _stream(path: Path, columns: tuple[str, ...], notes: list[str]) -> _Stream:
    table: Table = read_table(path, (TIME, *columns))
    time = numbers(table, TIME)
    if not 2 <= time.size <= MOST_SAMPLES:
        raise InputError(f"{path}: has {time.size} samples; 2 to {MOST_SAMPLES} are wanted")
    check_rising(table, TIME, time)
    time = MICROSECOND * time
    step = np.diff(time)
    if step.max() > LONGEST_GAP:
        i = int(step.argmax())
        notes.append(f"{path}: line {table.lines[i + 1]}: {step[i]:.3g} s pass without a sample")
    return _Stream(time, np.column_stack([numbers(table, name) for name in columns]))


def _common_clock(folder: Path, streams: list[_Stream], rate: float | None) -> Float[np.ndarray, " m"]:
    """Times that all sensors have."""
    begin, end = max(float(s.time[0]) for s in streams), min(float(s.time[-1]) for s in streams)
    if not begin < end:
        raise InputError(f"{folder}: the sensors have no moment in common; logs of one recording are wanted")
    step = float(np.median([np.median(np.diff(s.time)) for s in streams])) if rate is None else 1.0 / rate
    count = int(np.floor((end - begin) / step * (1.0 + 1e-12))) + 1
    if count > MOST_SAMPLES:
        raise InputError(f"{folder}: {count} samples at {1.0 / step:.4g} a second; at most {MOST_SAMPLES} are wanted")
    return begin + step * np.arange(count)


def _resampled(stream: _Stream, time: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m d"]:
    return np.column_stack([np.interp(time, stream.time, column) for column in stream.values.T])


def _measured(stream: _Stream, time: Float[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Whether the two samples about each time follow each other."""
    step = np.diff(stream.time)
    after = np.clip(np.searchsorted(stream.time, time, side="right"), 1, stream.time.size - 1)
    return np.asarray(step[after - 1] <= LOST * np.median(step))


def _turned(path: Path, time: Float[np.ndarray, " m"], notes: list[str]) -> Float[np.ndarray, "m 4"]:
    """A sensor's own quaternions; before its first and after its last sample they stay."""
    stream = _stream(path, QUATERNION, notes)
    length = np.linalg.norm(stream.values, axis=1)
    if (np.abs(length - 1.0) > 0.01).any():
        raise InputError(f"{path}: sample {int((np.abs(length - 1.0) > 0.01).argmax())}: a unit quaternion is wanted")
    turn = Slerp(stream.time, Rotation.from_quat(stream.values, scalar_first=True))
    return turn(np.clip(time, stream.time[0], stream.time[-1])).as_quat(scalar_first=True, canonical=True)
