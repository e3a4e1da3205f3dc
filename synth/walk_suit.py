"""True segments in, what an inertial suit makes of them out: they drift, and their orientations are a little off.

With the drift of heading `psi(t)` and of place `d(t)`, a segment i of calibration error `C_i` and noise `N_i(t)` has

    suit_R_i = Rot_z(psi) R_i C_i N_i,    suit_p_pelvis = Rot_z(psi) p_pelvis + d

and the origins of the other segments follow from these orientations along the lengths that the suit was told, for it
measures no places. Most of the drift grows one way (walk paper, section IV-B: "large and asymmetrical"), unevenly.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from .cell_motion import smooth_noise
from .walk_settings import WalkSettings

FULL = 300.0  # seconds: drifts are told for five minutes
WANDER = 20.0  # seconds over which the drift's pace changes
UP = 0.05  # of the drift goes up or down: the legs keep the height
ODOMETRY = 0.003  # metres, standard deviation of each sample's own error of place
SLOW_NOISE = 1.0  # seconds over which most of the orientation's noise lasts


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """By how much the suit's frame is off.

    Attributes
    ----------
    place : (f, 3)
        `d(t)`, metres.
    heading : (f,)
        `psi(t)`, radians.
    """

    place: Float[np.ndarray, "f 3"]
    heading: Float[np.ndarray, " f"]


def drift_of(rng: np.random.Generator, time: Float[np.ndarray, " f"], settings: WalkSettings) -> Drift:
    """Draw a drift that is zero, up to the offset, at the start.

    A share `asymmetry` of the length that is reached at the end goes straight, at a pace that changes; the rest is a
    walk at random, of as much standard deviation at the end.
    """
    n = time.size
    whole = float(time[-1] - time[0]) + 1e-9
    step = np.diff(time, prepend=time[0])
    rate = n / whole
    length = rng.uniform(*settings.drift) * whole / FULL
    way = rng.uniform(-math.pi, math.pi)
    direction = np.array([math.cos(way), math.sin(way), UP * rng.standard_normal()])
    pace = np.exp(0.5 * smooth_noise(rng, n, max(WANDER * rate, 1.0), 1)[:, 0]) * step
    pace = np.cumsum(pace) / max(float(pace.sum()), 1e-12)
    walk = np.cumsum(rng.standard_normal((n, 4)) * np.sqrt(step / whole)[:, None], axis=0)
    aside = (1.0 - settings.asymmetry) * length * walk[:, :3] * [1.0, 1.0, UP]
    offset = settings.start_offset * rng.standard_normal(3) * [1.0, 1.0, 0.2]
    steady = 0.7 * rng.standard_normal() * (time - time[0]) / whole  # a gyroscope's bias, beside its random walk
    turned = settings.heading_drift * math.sqrt(whole / FULL) * (steady + 0.7 * walk[:, 3])
    turned += settings.start_heading * rng.standard_normal()
    return Drift(offset + settings.asymmetry * length * pace[:, None] * direction + aside, np.radians(turned))


def frames_along(
    parent: Int[np.ndarray, " 13"],
    offset: Float[np.ndarray, "13 3"],
    root: Float[np.ndarray, "f 3"],
    R: Float[np.ndarray, "f 13 3 3"],
) -> Float[np.ndarray, "f 13 3"]:
    """Origins of segments from their orientations and the place of the first."""
    p = np.empty((root.shape[0], parent.size, 3))
    p[:, 0] = root
    for i in range(1, parent.size):
        p[:, i] = p[:, parent[i]] + R[:, parent[i]] @ offset[i]
    return p


def errors_of(
    rng: np.random.Generator, time: Float[np.ndarray, " f"], segments: int, settings: WalkSettings
) -> Float[np.ndarray, "f 13 3 3"]:
    """`C_i N_i(t)` of all segments."""
    rate = time.size / float(time[-1] - time[0] + 1e-9)
    sigma = np.full((segments, 1), settings.calibration)
    sigma[0] = settings.pelvis_calibration
    constant = sigma * rng.standard_normal((segments, 3))
    slow = smooth_noise(rng, time.size, max(SLOW_NOISE * rate, 0.1), 3 * segments).reshape(-1, segments, 3)
    quick = rng.standard_normal((time.size, segments, 3))
    noise = settings.orientation_noise * (math.sqrt(0.8) * slow + math.sqrt(0.2) * quick)
    C = Rotation.from_rotvec(np.radians(constant)).as_matrix()
    N = Rotation.from_rotvec(np.radians(noise).reshape(-1, 3)).as_matrix()
    return C @ N.reshape(time.size, segments, 3, 3)


def sense_segments(
    rng: np.random.Generator,
    time: Float[np.ndarray, " f"],
    pelvis: Float[np.ndarray, "f 3"],
    R: Float[np.ndarray, "f 13 3 3"],
    parent: Int[np.ndarray, " 13"],
    offset: Float[np.ndarray, "13 3"],
    settings: WalkSettings,
) -> tuple[Float[np.ndarray, "f 13 3"], Float[np.ndarray, "f 13 4"], Drift]:
    """What the suit reports: origins and quaternions (real part first), NaN where a sample is lost; and its drift.

    Parameters
    ----------
    pelvis, R : (f, 3), (f, 13, 3, 3)
        True place of the pelvis, and true world_R_segment.
    offset : (13, 3)
        Of the segments' origins in their parents' axes, as the suit was told.
    """
    drift = drift_of(rng, time, settings)
    turn = Rotation.from_euler("z", drift.heading[:, None]).as_matrix()
    of_suit = turn[:, None] @ R @ errors_of(rng, time, parent.size, settings)
    root = (turn @ pelvis[..., None])[..., 0] + drift.place + ODOMETRY * rng.standard_normal(pelvis.shape)
    p = frames_along(parent, offset, root, of_suit)
    wxyz = Rotation.from_matrix(of_suit.reshape(-1, 3, 3)).as_quat(scalar_first=True, canonical=True)
    wxyz = wxyz.reshape(*p.shape[:2], 4)
    lost = rng.random(time.size) < settings.missing
    lost[[0, -1]] = False  # the table begins and ends with a sample
    p[lost], wxyz[lost] = np.nan, np.nan
    return p, wxyz, drift
