"""A number of frames in, how much the process has grown while tracking them out."""

import resource
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from synth.scenes import images, two_finger_crossing

from ..residuals import chain
from ..settings import Settings
from ..tracker import follow

_STATM = Path("/proc/self/statm")
_WARM = 500  # frames after which nothing is compiled, cached or learnt for the first time


def there_and_back(pictures: list[np.ndarray], frames: int) -> Iterator[np.ndarray]:
    """As many frames as asked for: a short sequence forwards and backwards in turn, so that nothing jumps.

    >>> [int(frame[0]) for frame in there_and_back([np.array([n]) for n in range(3)], 8)]
    [0, 1, 2, 1, 0, 1, 2, 1]
    """
    order = [*range(len(pictures)), *range(len(pictures) - 2, 0, -1)]
    for number in range(frames):
        yield pictures[order[number % len(order)]]


def resident_mb() -> float:
    """Memory of this process now, in MB; where the system does not tell, the most it ever had."""
    if _STATM.exists():
        return int(_STATM.read_text().split()[1]) * resource.getpagesize() / 2**20
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (2**20 if sys.platform == "darwin" else 2**10)


def growth_mb(frames: int, settings: Settings | None = None, sequence: int = 40) -> float:
    """By how many MB the process grows from the frame at which everything is warm to the last."""
    scene = two_finger_crossing(0, frames=sequence)
    pictures = [np.asarray(image, dtype=np.float32) for image in images(scene)]
    on, start = (chain(scene.model, scene.camera),), 0.0
    together = there_and_back(pictures, frames)
    for number, _ in enumerate(follow(together, on, scene.start, scene.fps, settings or Settings())):
        if number == min(_WARM, frames // 2):
            start = resident_mb()
    return resident_mb() - start
