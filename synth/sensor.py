"""A clean image in, what a camera would deliver out: vignette, noise, quantisation."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """How a clean image is spoilt.

    Attributes
    ----------
    noise : float
        Standard deviation of the Gaussian noise, grey levels; 0 for none.
    vignette : float
        Share of the light lost in the corners, 0..1; it grows with the square of the distance from the middle.
    quantise : bool
        Round and clip to 0..255.
    """

    noise: float = 0.0
    vignette: float = 0.0
    quantise: bool = True


def vignette_gain(height: int, width: int, loss: float) -> Float[np.ndarray, "h w"]:
    """Gain of each pixel, 1 in the middle and `1 - loss` in the corners.

    >>> vignette_gain(1, 3, 0.5).tolist()
    [[0.5, 1.0, 0.5]]
    """
    v, u = np.mgrid[:height, :width] - np.array([[[(height - 1) / 2]], [[(width - 1) / 2]]])
    r2 = u * u + v * v
    return (1.0 - loss * r2 / max(r2.max(), 1e-300)).astype(np.float32)


def sense(image: Float[np.ndarray, "h w *c"], sensor: Sensor, rng: np.random.Generator) -> Float[np.ndarray, "h w *c"]:
    """Apply a sensor to a clean image; the noise of colour channels is independent.

    Raises
    ------
    ValueError
        For a negative noise or a vignette outside 0..1.
    """
    if not 0 <= sensor.noise < np.inf or not 0 <= sensor.vignette <= 1:
        raise ValueError(f"sensor: noise {sensor.noise} must be >= 0 and vignette {sensor.vignette} within 0..1")
    out = image.astype(np.float32)
    if sensor.vignette > 0:
        gain = vignette_gain(image.shape[0], image.shape[1], sensor.vignette)
        out = out * gain.reshape(gain.shape + (1,) * (image.ndim - 2))
    if sensor.noise > 0:
        out = out + np.float32(sensor.noise) * rng.standard_normal(out.shape, dtype=np.float32)
    return np.clip(np.rint(out), 0, 255) if sensor.quantise else out
