"""Innovations of a Kalman filter in, the spectral density of its process noise out: no tuning for slow or fast joints.

How far a joint may have moved by the next frame differs from joint to joint and from second to second. An innovation y
with predicted variance S tells: its log likelihood has the slope

    d log N(y; 0, S) / d log psd  =  1/2 (y^2 / S - 1) d log S / d log psd

and the share ``u = 1 - R / S`` of the prediction in S stands for the last factor. Each frame climbs that slope,

    log psd  <-  log psd + rate u (min(y^2 / S, limit^2) - 1)

which is an exponential window of ``1 / rate`` frames. Since log psd stays bounded, its increments average to zero: over
time the mean of ``y^2 / S`` is one, whatever the motion looks like, which is what an honest sigma means. The limit
bounds what one wild measurement can do, yet a joint that sets off is followed within a few frames: the density grows
fast and falls slowly. Only the very frame in which a joint sets off at full speed stays a surprise; a lower bound on
the density says how much of that to expect.
"""

import numpy as np
from jaxtyping import Float

RATE = 0.15
LIMIT = 4.0


def process_from_innovations(
    psd: Float[np.ndarray, " j"],
    innovation: Float[np.ndarray, " j"],
    S: Float[np.ndarray, "j j"],
    R: Float[np.ndarray, "j j"],
    *,
    rate: float = RATE,
    limit: float = LIMIT,
    bounds: tuple[float, float] = (1e-6, 1e8),
) -> Float[np.ndarray, " j"]:
    """Spectral density for the next prediction, from the innovation of this frame.

    Parameters
    ----------
    psd : (j,)
        Density that the prediction was made with, > 0: rad^2/s^3 for order 2, rad^2/s^5 for order 3.
    innovation, S : (j,), (j, j)
        From `handtrack.smooth.update`; NaN innovations (joints not measured) leave their density alone.
    R : (j, j)
        Covariance of the measurement; where it explains all of S the innovation says nothing about the motion.
    rate : float
        Inverse length of the window in frames, 0 < rate <= 1.
    limit : float
        Innovations beyond this many sigmas count as this many, > 1.
    bounds : (float, float)
        Smallest and largest density.

    Returns
    -------
    (j,)
        Within `bounds`.

    Raises
    ------
    ValueError
        `rate` or `limit` out of range.

    Examples
    --------
    >>> psd = np.ones(2)
    >>> process_from_innovations(psd, np.array([2.0, 0.0]), np.eye(2), np.zeros((2, 2))).round(3).tolist()
    [1.568, 0.861]
    """
    if not (0.0 < rate <= 1.0 and limit > 1.0):
        raise ValueError(f"rate, limit: {rate}, {limit}; wanted 0 < rate <= 1 and limit > 1")
    total = S.diagonal()
    share = np.clip(1.0 - R.diagonal() / total, 0.0, 1.0)
    surprise = np.minimum(np.square(innovation) / total, limit * limit) - 1.0
    change = rate * share * np.where(np.isnan(surprise), 0.0, surprise)
    return np.clip(psd * np.exp(change), bounds[0], bounds[1])
