"""A track and the truth in, how far landmarks are off in the image of each view out.

    d_v = |project_v(landmark(q)) - project_v(landmark(q_true))|        pixels, for each frame, landmark and view v

The views weigh alike in what `evaluate` says of landmarks: its figures are those of all distances together.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from .camera import Camera
from .evaluate import Evaluation, evaluate, landmark_distances
from .kinematics import Model
from .sequences import Truth
from .track import Track


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkErrors:
    """Mean, median and largest distance of the landmarks in each view, pixels; NaN where there is none."""

    mean: Float[np.ndarray, " v"]
    median: Float[np.ndarray, " v"]
    largest: Float[np.ndarray, " v"]


def evaluate_views(
    track: Track, truth: Truth, model: Model, cameras: Sequence[Camera]
) -> tuple[Evaluation, LandmarkErrors]:
    """Compare a track with the truth; the landmarks in every view.

    Raises
    ------
    InputError, ValueError
        As `evaluate` does; ValueError without a camera.
    """
    if not cameras:
        raise ValueError("cameras: got none; one for each view is wanted")
    result = evaluate(track, truth, model, cameras[0])
    _, rows, truth_rows = np.intersect1d(track.frame, truth.frame, return_indices=True)
    distances = [landmark_distances(model, camera, track.q[rows], truth.q[truth_rows]) for camera in cameras]
    known = [distance[np.isfinite(distance)] for distance in distances]
    each = np.array([_figures(distance) for distance in known])
    mean, median, largest = _figures(np.concatenate(known))
    result = replace(result, landmark_px=mean, landmark_median_px=median, landmark_max_px=largest)
    return result, LandmarkErrors(*each.T)


def _figures(distance: Float[np.ndarray, " n"]) -> tuple[float, float, float]:
    if not distance.size:
        return math.nan, math.nan, math.nan
    return float(distance.mean()), float(np.median(distance)), float(distance.max())


def as_text(errors: LandmarkErrors) -> str:
    """A line for each view.

    >>> print(as_text(LandmarkErrors(*np.array([[0.5, np.nan], [0.4, np.nan], [2.0, np.nan]]))))
    view 0        mean 0.500 px, median 0.400 px, largest 2.000 px
    view 1        mean - px, median - px, largest - px
    """
    rows = zip(errors.mean, errors.median, errors.largest, strict=True)
    return "\n".join(
        f"view {number:<8} mean {_cell(mean)} px, median {_cell(median)} px, largest {_cell(largest)} px"
        for number, (mean, median, largest) in enumerate(rows)
    )


def as_data(errors: LandmarkErrors) -> list[dict[str, float | None]]:
    """The same as plain data, None where there is no value."""
    rows = zip(errors.mean, errors.median, errors.largest, strict=True)
    names = ("landmark_px", "landmark_median_px", "landmark_max_px")
    return [
        {name: float(f"{value:.9g}") if math.isfinite(value) else None for name, value in zip(names, row, strict=True)}
        for row in rows
    ]


def _cell(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "-"
