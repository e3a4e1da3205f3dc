"""Random numbers in, a smooth wandering of place and attitude out: sums of sines, known at every frame by itself."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

TERMS, PERIODS = 3, (18.0, 70.0)  # sines for each axis, and their periods in frames


@dataclass(frozen=True, slots=True, eq=False)
class Wandering:
    """Sines (amplitude, frequency, phase) of six values: translation in mm, rotation vector in radians; each (6, n)."""

    amplitude: Float[np.ndarray, "6 n"]
    frequency: Float[np.ndarray, "6 n"]
    phase: Float[np.ndarray, "6 n"]


def wandering(rng: np.random.Generator, translation: float, rotation: float) -> Wandering:
    """A wandering of given root mean square speeds, in mm and radians a frame (over all directions together)."""
    frequency = 2.0 * np.pi / rng.uniform(*PERIODS, (6, TERMS))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, TERMS))
    speed = np.repeat([translation, rotation], 3)[:, None]
    amplitude = speed * np.sqrt(2.0 / (3.0 * TERMS)) / frequency
    return Wandering(amplitude, frequency, phase)


def offset(path: Wandering, frame: int) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Turn and shift at a frame, against the middle of the wandering."""
    if not path.amplitude.any():
        return np.eye(3), np.zeros(3)
    value = (path.amplitude * np.sin(path.frequency * frame + path.phase)).sum(axis=1)
    return Rotation.from_rotvec(value[3:]).as_matrix(), value[:3]
