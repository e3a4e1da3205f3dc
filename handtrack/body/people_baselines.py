"""Skeletons and the identities of a result in; what simpler filters make of them out.

`raw` is the measurements themselves. `kalman-1` and `kalman-2` are Kalman filters with constant velocity and constant
acceleration, noise matrices by filterpy, all keypoints as one batch; they predict without a bound while nothing is
measured. `one-euro` is a low pass whose cut-off rises with the speed (Casiez, Roussel & Vogel, CHI 2012):

    f = f_min + b |v|,   a = 1 / (1 + 1 / (2 pi f dt)),   x <- x + a (z - x)
"""

import math
from dataclasses import dataclass

import numpy as np
from filterpy.common import Q_discrete_white_noise
from jaxtyping import Float

from ..formats.people import LOST, PREDICTED, SEEN, People
from ..formats.skeletons import Detections
from .identities import assigned, costs
from .people_settings import Settings
from .skeleton_graph import complete
from .spatial import clean

NAMES = ("raw", "kalman-1", "kalman-2", "one-euro")
GATE = 0.5  # metres: bounded mean distance within which a skeleton is one of the people of the result
NOISE = 0.05  # metres: deviation of a measurement, for the Kalman filters
JERKY = {"kalman-1": 5.0, "kalman-2": 5.0}  # m/s^2: deviation of what each takes for constant's change in a step
SLOWEST, EAGER, SPEED_CUT = 1.0, 1.0, 1.0  # Hz, Hz per m/s, Hz: of the one-euro filter


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Places (f, k, 3) and variances (f, k) through all frames; NaN where there is nothing."""

    p: Float[np.ndarray, "f k 3"]
    variance: Float[np.ndarray, "f k"]


def baseline(name: str, detections: Detections, identities: People, settings: Settings) -> People:
    """Follow people by a simpler filter.

    Parameters
    ----------
    name : 'raw', 'kalman-1', 'kalman-2' or 'one-euro'
    identities : People
        A result for the same skeletons: who is who, and who is there, comes from it.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    if name not in NAMES:
        raise ValueError(f"name: got '{name}', wanted one of {', '.join(NAMES)}")
    z, confidence = _measurements(detections, identities, settings)
    d = identities.frame.size
    p, covariance = np.full((d, 16, 3), np.nan), np.full((d, 16, 3, 3), np.nan)
    status = np.full((d, 16), LOST, dtype=np.int8)
    for label in np.unique(identities.person).tolist():
        own = np.flatnonzero(identities.person == label)
        course = _course(name, identities.time[identities.frame[own]], z[own])
        known = ~np.isnan(course.p[..., 0])
        p[own] = course.p
        covariance[own] = np.where(known, course.variance, np.nan)[..., None, None] * np.eye(3)
        status[own] = np.where(~np.isnan(z[own][..., 0]), SEEN, np.where(known, PREDICTED, LOST))
    return People(identities.time, identities.frame, identities.person, p, confidence, covariance, status)


def _measurements(
    detections: Detections, identities: People, settings: Settings
) -> tuple[Float[np.ndarray, "d 16 3"], Float[np.ndarray, "d 16"]]:
    """Places and confidences that belong to each entry of the result."""
    d = identities.frame.size
    z, confidence = np.full((d, 16, 3), np.nan), np.zeros((d, 16))
    p, sure = clean(detections.p, detections.confidence)
    p, sure = complete(p, sure)
    frames = np.arange(identities.time.size + 1)
    ours, theirs = np.searchsorted(identities.frame, frames), np.searchsorted(detections.frame, frames)
    for n in range(identities.time.size):
        a, b = slice(ours[n], ours[n + 1]), slice(theirs[n], theirs[n + 1])
        found = costs(identities.p[a, :12], identities.confidence[a, :12], p[b, :12], sure[b, :12], settings)
        who, which, _ = assigned(found, np.full(ours[n + 1] - ours[n], GATE))
        z[ours[n] + who], confidence[ours[n] + who] = p[theirs[n] + which], sure[theirs[n] + which]
    return z, confidence


def _course(name: str, time: Float[np.ndarray, " f"], z: Float[np.ndarray, "f k 3"]) -> Course:
    if name == "raw":
        return Course(z, np.where(np.isnan(z[..., 0]), np.nan, NOISE**2))
    if name == "one-euro":
        return one_euro(time, z)
    return kalman(time, z, 1 if name == "kalman-1" else 2, JERKY[name])


def kalman(time: Float[np.ndarray, " f"], z: Float[np.ndarray, "f k 3"], order: int, jerky: float) -> Course:
    """Kalman filters with constant velocity (order 1) or acceleration (order 2), one for each keypoint.

    Parameters
    ----------
    z : (f, k, 3)
        Metres; NaN where nothing is measured: then they predict.
    jerky : float
        Deviation of the acceleration within a step (order 1), or of its change (order 2), m/s^2.

    >>> t = np.arange(60) / 30
    >>> z = np.zeros((60, 1, 3)) + t[:, None, None]
    >>> bool(abs(kalman(t, z, 1, 5.0).p[-1] - z[-1]).max() < 1e-3)
    True
    """
    f, k = z.shape[:2]
    n = order + 1
    x, c = np.full((k, n, 3), np.nan), np.zeros((k, n, n))
    start = np.diag([NOISE**2, 1.0, 25.0][:n])
    p, variance = np.full((f, k, 3), np.nan), np.full((f, k), np.nan)
    for i in range(f):
        if i:
            dt = float(time[i] - time[i - 1])
            step = _transition(n, dt)
            x, c = step @ x, step @ c @ step.T + np.asarray(Q_discrete_white_noise(n, dt, jerky**2), dtype=float)
        seen = ~np.isnan(z[i, :, 0])
        new = seen & np.isnan(x[:, 0, 0])
        x[new] = 0.0
        x[new, 0], c[new] = z[i, new], start
        old = seen & ~new
        gain = c[:, :, 0] / (c[:, 0, 0] + NOISE**2)[:, None]
        off = np.where(old[:, None], z[i] - x[:, 0], 0.0)
        x = x + gain[:, :, None] * off[:, None]
        c = c - np.where(old[:, None, None], gain[:, :, None] * c[:, None, 0], 0.0)
        p[i], variance[i] = x[:, 0], np.where(np.isnan(x[:, 0, 0]), np.nan, c[:, 0, 0])
    return Course(p, variance)


def _transition(n: int, dt: float) -> Float[np.ndarray, "n n"]:
    """Taylor's series of a place and its n - 1 derivatives over a step."""
    return np.array([[dt ** (b - a) / math.factorial(b - a) if b >= a else 0.0 for b in range(n)] for a in range(n)])


def one_euro(time: Float[np.ndarray, " f"], z: Float[np.ndarray, "f k 3"]) -> Course:
    """A low pass whose cut-off rises with the speed; it holds its last place while nothing is measured.

    >>> z = np.ones((9, 1, 3))
    >>> one_euro(np.arange(9) / 30, z).p[-1].tolist()
    [[1.0, 1.0, 1.0]]
    """
    x, v = np.full(z.shape[1:], np.nan), np.zeros(z.shape[1:])
    last = np.full(z.shape[1], np.nan)
    p = np.full(z.shape, np.nan)
    for i, now in enumerate(time.tolist()):
        seen = ~np.isnan(z[i, :, 0])
        new = seen & np.isnan(x[:, 0])
        x[new], last[new] = z[i, new], now
        old = seen & ~new
        dt = np.where(old, now - last, 1.0)[:, None]
        v = np.where(old[:, None], v + _share(SPEED_CUT, dt) * ((z[i] - x) / dt - v), v)
        speed = np.sqrt((v * v).sum(axis=-1, keepdims=True))
        x = np.where(old[:, None], x + _share(SLOWEST + EAGER * speed, dt) * (z[i] - x), x)
        last[seen] = now
        p[i] = x
    return Course(p, np.where(np.isnan(p[..., 0]), np.nan, NOISE**2))


def _share(cut: float | np.ndarray, dt: Float[np.ndarray, "k 1"]) -> Float[np.ndarray, "k 1"]:
    """How far a low pass goes towards a new value in a step."""
    return np.asarray(1.0 / (1.0 + 1.0 / (2.0 * math.pi * cut * dt)))
