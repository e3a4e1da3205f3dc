"""A sequence with its truth in, Cramer-Rao bounds of a few frames out; reads only the images it needs."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Float, Int

from ..bound import Bounds, bounds, spread_frames
from ..camera import Camera
from ..formats.images import ImageFiles
from ..kinematics import Model
from ..residuals import chain
from ..sequences import Sequence as Input
from ..sequences import Truth
from ..track import Track

Image = Float[np.ndarray, "h w"]
FEW = 6  # frames: the bound changes slowly along a motion


def whole_truth(track: Track, truth: Truth) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n j"]]:
    """Numbers of the tracked frames whose truth lacks no joint, and the true joints there."""
    whole = np.isfinite(truth.q).all(axis=1)
    number, _, rows = np.intersect1d(track.frame, truth.frame[whole], return_indices=True)
    return number, truth.q[whole][rows]


def bounds_of_input(
    sequence: Input,
    cameras: Sequence[Camera],
    model: Model,
    number: Int[np.ndarray, " n"],
    q: Float[np.ndarray, "n j"],
    known_light: bool = True,
    done: Callable[[int], None] | None = None,
) -> Bounds:
    """Bounds at the true poses q of these frames."""
    on = [chain(model, camera) for camera in cameras]
    return bounds(pictures(sequence, number), on, q, number, known_light, done)


def few_bounds(sequence: Input, track: Track) -> Bounds | None:
    """Bounds of some frames of a sequence that has a truth and images one by one; a video would be decoded again."""
    if sequence.truth is None or not all(isinstance(view, ImageFiles) for view in sequence.views):
        return None
    number, q = whole_truth(track, sequence.truth)
    if not number.size:
        return None
    chosen = spread_frames(number.size, FEW)
    return bounds_of_input(sequence, sequence.cameras, sequence.model, number[chosen], q[chosen])


def pictures(sequence: Input, number: Int[np.ndarray, " n"]) -> Iterator[Sequence[Image]]:
    """Images of all views in the frames asked for, in rising order; videos are decoded from their start."""
    if all(isinstance(view, ImageFiles) for view in sequence.views):
        for i in number.tolist():
            yield tuple(view.read(i) for view in sequence.views)
        return
    wanted, last = set(number.tolist()), int(number[-1])
    for i, together in enumerate(sequence):
        if i in wanted:
            yield together
        if i >= last:
            return
