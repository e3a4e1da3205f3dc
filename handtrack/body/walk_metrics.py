"""The track of a walk and its truth in, how far off and how honest it is out; metres, radians.

The error of the place is the distance of the pelvis from the true one, that of the heading the angle between the yaws
of both pelvises, that of a wrist its distance in the world. Two standard deviations hold 95.4 % of a normal error along
an axis: well above, a filter is too modest, and well below, too sure.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from ..formats.skeletons import KEYPOINTS
from ..formats.walk_tracks import WalkTrack
from ..formats.walks import WalkTruth

WRISTS = (KEYPOINTS.index("left_wrist"), KEYPOINTS.index("right_wrist"))


@dataclass(frozen=True, slots=True, eq=False)
class WalkErrors:
    """Errors frame by frame; NaN where the truth is unknown.

    Attributes
    ----------
    off, place : (f, 3), (f,)
        Estimate less truth of the pelvis, and its length.
    heading : (f,)
        Estimate less truth, -pi to pi.
    wrist, relative : (f, 2), (f, 2)
        Distance of left and right wrist from the true ones in the world; and in the pelvis's own axes.
    """

    off: Float[np.ndarray, "f 3"]
    place: Float[np.ndarray, " f"]
    heading: Float[np.ndarray, " f"]
    wrist: Float[np.ndarray, "f 2"]
    relative: Float[np.ndarray, "f 2"]


@dataclass(frozen=True, slots=True, eq=False)
class WalkFigures:
    """What is said of a whole walk; NaN where nothing is known.

    Attributes
    ----------
    mean, worst : float
        Error of the pelvis's place: its mean, and the largest.
    in_view, out_of_view : float
        Its means while the camera saw the person, and while not.
    heading : float
        Mean size of the heading's error.
    wrist, relative : float
        Mean errors of both wrists.
    held : (3,)
        Share of the frames in which two standard deviations hold the place, along x, y and z.
    heading_held : float
        The same for the heading.
    """

    mean: float
    worst: float
    in_view: float
    out_of_view: float
    heading: float
    wrist: float
    relative: float
    held: Float[np.ndarray, " 3"]
    heading_held: float

    def as_data(self) -> dict[str, object]:
        """The same as plain data: millimetres, degrees and shares; None where nothing is known."""
        return {
            "mean_mm": _round(1e3 * self.mean, 2),
            "worst_mm": _round(1e3 * self.worst, 2),
            "in_view_mm": _round(1e3 * self.in_view, 2),
            "out_of_view_mm": _round(1e3 * self.out_of_view, 2),
            "heading_deg": _round(float(np.degrees(self.heading)), 3),
            "wrist_mm": _round(1e3 * self.wrist, 2),
            "wrist_relative_mm": _round(1e3 * self.relative, 2),
            "two_sigma_hold": [_round(share, 4) for share in self.held.tolist()],
            "two_sigma_hold_heading": _round(self.heading_held, 4),
        }


def walk_errors(track: WalkTrack, truth: WalkTruth) -> WalkErrors:
    """Errors of a track against a truth of the same frames.

    Raises
    ------
    ValueError
        If the truth has another number of frames.
    """
    if truth.p.shape[0] != track.frame.size:
        raise ValueError(f"truth: has {truth.p.shape[0]} frames; wanted those of the track, {track.frame.size}")
    off = track.p - truth.p
    at = list(WRISTS)
    apart = track.keypoints[:, at] - truth.keypoints[:, at]
    own = _in_pelvis(track.keypoints[:, at], track.p, track.wxyz) - _in_pelvis(
        truth.keypoints[:, at], truth.p, truth.wxyz
    )
    return WalkErrors(
        off=off,
        place=np.linalg.norm(off, axis=1),
        heading=wrapped(yaw_of(track.wxyz) - yaw_of(truth.wxyz)),
        wrist=np.linalg.norm(apart, axis=-1),
        relative=np.linalg.norm(own, axis=-1),
    )


def walk_figures(track: WalkTrack, truth: WalkTruth | None) -> WalkFigures | None:
    """Figures of a track; None without a truth."""
    if truth is None:
        return None
    errors = walk_errors(track, truth)
    known = np.isfinite(errors.place)
    return WalkFigures(
        mean=_mean(errors.place),
        worst=float(errors.place[known].max()) if known.any() else np.nan,
        in_view=_mean(errors.place[track.in_view]),
        out_of_view=_mean(errors.place[~track.in_view]),
        heading=_mean(np.abs(errors.heading)),
        wrist=_mean(errors.wrist),
        relative=_mean(errors.relative),
        held=held(errors.off, track.sigma),
        heading_held=float(held(errors.heading[:, None], track.sigma_heading[:, None])[0]),
    )


def held(
    off: Float[np.ndarray, "f d"], sigma: Float[np.ndarray, "f d"], sigmas: float = 2.0
) -> Float[np.ndarray, " d"]:
    """Share of the errors within so many standard deviations, along each axis; NaN where none is known.

    >>> held(np.array([[1.0], [3.0], [np.nan]]), np.ones((3, 1))).tolist()
    [0.5]
    """
    known = np.isfinite(off)
    inside = (np.abs(np.where(known, off, 0.0)) <= sigmas * sigma) & known
    count = known.sum(axis=0)
    return np.where(count > 0, inside.sum(axis=0) / np.maximum(count, 1), np.nan)


def lap_means(error: Float[np.ndarray, " f"], lap: Float[np.ndarray, " f"]) -> Float[np.ndarray, " laps"]:
    """Mean error of each lap that was walked to its end, laps counted from 0; empty if none was.

    Parameters
    ----------
    lap : (f,)
        Laps walked at each frame, with fractions.

    >>> lap_means(np.array([1.0, 3.0, 5.0, 9.0]), np.array([0.0, 0.5, 1.0, 2.0])).tolist()
    [2.0, 5.0]
    """
    whole = int(np.floor(lap.max(initial=0.0)))
    return np.array([_mean(error[(lap >= k) & (lap < k + 1)]) for k in range(whole)])


def longest_span(mask: Bool[np.ndarray, " f"], time: Float[np.ndarray, " f"]) -> float:
    """Seconds of the longest stretch in which a mask is on, from its first frame to its last; 0 if it never is."""
    edge = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    first, last = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1) - 1
    return float((time[last] - time[first]).max(initial=0.0))


def yaw_of(wxyz: Float[np.ndarray, "f 4"]) -> Float[np.ndarray, " f"]:
    """Heading of orientations, radians; the first angle of `Rot_z(yaw) Rot_y(pitch) Rot_x(roll)`; NaN stays NaN.

    >>> yaw_of(np.array([[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]])).round(6).tolist()
    [1.570796]
    """
    w, x, y, z = wxyz.T
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def wrapped(angle: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Angles brought to -pi ... pi."""
    return np.arctan2(np.sin(angle), np.cos(angle))


def _in_pelvis(
    points: Float[np.ndarray, "f k 3"], p: Float[np.ndarray, "f 3"], wxyz: Float[np.ndarray, "f 4"]
) -> Float[np.ndarray, "f k 3"]:
    known = np.isfinite(wxyz).all(axis=1)
    R = np.full((wxyz.shape[0], 3, 3), np.nan)
    if known.any():
        R[known] = Rotation.from_quat(wxyz[known], scalar_first=True).as_matrix()
    return (points - p[:, None]) @ R


def _mean(values: Float[np.ndarray, "*n"]) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def _round(value: float, digits: int) -> float | None:
    return round(value, digits) if np.isfinite(value) else None
