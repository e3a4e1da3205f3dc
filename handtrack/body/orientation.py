"""Angular rates and accelerations in, orientations of the sensors out, and how well they agree with gravity.

A complementary filter integrates the rates and is drawn towards gravity (Madgwick 2010, "An efficient orientation
filter for inertial and inertial/magnetic sensor arrays"; its author's `imufusion` library does it, the extra `imu`).
World axes have z up. The heading starts at zero and drifts, unless a magnetometer is there and wanted.
"""

import importlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ..formats.imu_logs import GRAVITY, ImuLogs

SETTLING = 0.25  # seconds whose mean acceleration gives the first tilt


@dataclass(frozen=True, slots=True)
class FusionSettings:
    """How rates and accelerations are weighted; checked on construction.

    Attributes
    ----------
    gain : float
        Pull of gravity, and of the magnetic field, against the rates; 0 only integrates.
    rejection : float
        Degrees: accelerations farther off the expected direction are left out, for the sensor is moving; 0 takes all.
    magnetic : bool
        Whether the magnetic field gives the heading.
    """

    gain: float = 0.5
    rejection: float = 10.0
    magnetic: bool = False

    def __post_init__(self) -> None:
        for name, low, high in (("gain", 0.0, 100.0), ("rejection", 0.0, 180.0)):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: got {getattr(self, name)}, wanted {low} to {high:g}")


def orientations(logs: ImuLogs, settings: FusionSettings | None = None) -> Float[np.ndarray, "m n 4"]:
    """world_R_sensor of all sensors at all times, as unit quaternions, real part first.

    Raises
    ------
    ValueError
        If the library is not installed, or `magnetic` is set and a sensor has no magnetometer.
    """
    settings = FusionSettings() if settings is None else settings
    if settings.magnetic and np.isnan(logs.magnetometer).any():
        missing = np.isnan(logs.magnetometer).any(axis=(0, 2))
        raise ValueError(f"settings: magnetic: sensor '{logs.names[int(missing.argmax())]}' has no magnetometer")
    library = _library()
    step = float(logs.time[1] - logs.time[0])
    out = np.empty((logs.time.size, len(logs.names), 4))
    for i in range(len(logs.names)):
        out[:, i] = _one(library, logs, i, step, settings)
    return out


def _library() -> Any:
    try:
        return importlib.import_module("imufusion")
    except ImportError as error:
        raise ValueError("imufusion is not installed; pip install 'handtrack[imu]' brings it") from error


def _one(library: Any, logs: ImuLogs, i: int, step: float, settings: FusionSettings) -> Float[np.ndarray, "m 4"]:
    """Orientations of one sensor; the library takes degrees and g."""
    rates = np.degrees(logs.gyroscope[:, i])
    pulls, fields = logs.accelerometer[:, i] / GRAVITY, logs.magnetometer[:, i]
    fusion, chosen = library.Ahrs(), library.AhrsSettings()
    chosen.gain, chosen.acceleration_rejection, chosen.magnetic_rejection = settings.gain, settings.rejection, 0.0
    chosen.sample_rate = 1.0 / step
    chosen.rejection_timeout = 5.0
    fusion.set_settings(chosen)
    fusion.set_sample_period(step)
    fusion.skip_startup()
    first = max(math.ceil(SETTLING / step), 1)
    start = upright(pulls[:first].mean(axis=0))
    fusion.set_quaternion(northward(start, fields[:first].mean(axis=0)) if settings.magnetic else start)
    out = np.empty((logs.time.size, 4))
    for k in range(logs.time.size):
        if settings.magnetic:
            fusion.update(rates[k], pulls[k], fields[k])
        else:
            fusion.update_no_magnetometer(rates[k], pulls[k])
        out[k] = fusion.get_quaternion()
    return out


def upright(up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 4"]:
    """The least rotation, real part first, that turns a sensor whose `up` points so into a world with z up.

    >>> upright(np.array([0.0, 0.0, 2.0])).tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    n = up / np.linalg.norm(up)
    axis = np.array([n[1], -n[0], 0.0])  # n x z
    q = np.array([1.0 + n[2], *axis]) if n[2] > -1.0 + 1e-12 else np.array([0.0, 1.0, 0.0, 0.0])
    return q / np.linalg.norm(q) + 0.0


def northward(wxyz: Float[np.ndarray, " 4"], field: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 4"]:
    """The same tilt with the heading at which a magnetic field, in the sensor's axes, points to the world's x.

    >>> northward(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 1.0, -1.0])).round(3).tolist()
    [0.707, 0.0, 0.0, -0.707]
    """
    turn = Rotation.from_quat(wxyz, scalar_first=True)
    north = turn.apply(field)
    about = Rotation.from_euler("z", -math.atan2(north[1], north[0]))
    return (about * turn).as_quat(scalar_first=True, canonical=True)


def up_error(logs: ImuLogs, wxyz: Float[np.ndarray, "m n 4"]) -> Float[np.ndarray, " n"]:
    """Angle, radians, of each sensor's mean acceleration in the world from the vertical.

    A person who walks and stops gains no speed on average, so what is left is gravity, and the angle an error of tilt.
    """
    turn = Rotation.from_quat(wxyz.reshape(-1, 4), scalar_first=True)
    mean = turn.apply(logs.accelerometer.reshape(-1, 3)).reshape(logs.accelerometer.shape).mean(axis=0)
    return np.arctan2(np.hypot(mean[:, 0], mean[:, 1]), mean[:, 2])


def headings(wxyz: Float[np.ndarray, "m n 4"]) -> Float[np.ndarray, "m n"]:
    """Turn of each sensor about the vertical since the first sample, radians, without jumps.

    >>> q = Rotation.from_euler("z", [[0.0], [170.0], [190.0]], degrees=True).as_quat(scalar_first=True)
    >>> np.degrees(headings(q[:, None])[:, 0]).round(6).tolist()
    [0.0, 170.0, 190.0]
    """
    turn = Rotation.from_quat(wxyz.reshape(-1, 4), scalar_first=True).as_matrix().reshape(*wxyz.shape[:2], 3, 3)
    since = turn @ np.swapaxes(turn[0], -1, -2)
    return np.unwrap(np.arctan2(since[..., 1, 0] - since[..., 0, 1], since[..., 0, 0] + since[..., 1, 1]), axis=0)
