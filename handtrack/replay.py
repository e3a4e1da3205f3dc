"""A sequence and the number of a frame in, everything known of that frame out: what it was predicted from, what was
seen, how it was fitted, what was learnt.

A track keeps poses and lets the looks at the images go. The tracker draws no random numbers, so tracking again up to
the frame shows again what it saw, to the last digit.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .prediction import Prediction, predict
from .residuals import Chain
from .settings import Settings
from .tracker import Frame, Image, State, begin, step


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """One frame, tracked again.

    Attributes
    ----------
    number, time : int, float
        Of the frame, and its time in seconds.
    images, on : tuple of (h, w), tuple of Chain
        One for each view.
    ahead : Prediction
        Pose and motion before the images of this frame, soft couplings apart.
    before, after : State
        What the tracker carried into the frame, and out of it.
    """

    number: int
    time: float
    images: tuple[Image, ...]
    on: tuple[Chain, ...]
    settings: Settings
    ahead: Prediction
    before: State
    after: State
    frame: Frame


def replay(
    frames: Iterable[Image | Sequence[Image]],
    on: Sequence[Chain],
    start_pose: Float[np.ndarray, " j"],
    fps: float,
    settings: Settings,
    number: int,
    times: Sequence[float] | Float[np.ndarray, " n"] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Replay:
    """Track frames 0 to `number` as `tracker.track` does, and keep all of the last one.

    Parameters
    ----------
    frames, on, start_pose, fps, settings, times
        As for `tracker.follow`.
    number : int
        Frame to explain, from 0.
    progress : callable
        Called with the number of frames done.

    Raises
    ------
    ValueError
        If there are not so many frames, or for what the tracker refuses.
    """
    if number < 0:
        raise ValueError(f"number: got {number}, wanted a frame from 0 on")
    state, earlier = begin(on, start_pose, fps, settings), 0.0
    for i, given in enumerate(frames):
        images = (given,) if isinstance(given, np.ndarray) else tuple(given)
        now = float(times[i]) if times is not None else i / fps
        dt = now - earlier if i else 0.0
        after, frame = step(state, images, on, dt, settings)
        if progress is not None:
            progress(i + 1)
        if i == number:
            ahead = predict(state.prediction, dt)
            return Replay(number, now, images, tuple(on), settings, ahead, state, after, frame)
        state, earlier = after, now
    raise ValueError(f"number: got {number}, wanted one of the frames there are")
