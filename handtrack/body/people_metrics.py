"""Labelled people and their truth in; how far off, how unsteady, how rough, how mixed up and how honest they are out.

The people paper's figures (III-E) of one keypoint, with d_k the distance of estimate p_k and truth t_k:

    MAE = mean d_k        STD = standard deviation of d_k        ACC = mean |p''_k - t''_k|

The second derivative p'' is the divided difference over three frames. Who is who: in every frame labels are paired with
true people by the least sum of distances; a pair stays while it is within the gate (CLEAR-MOT, Bernardin & Stiefelhagen
2008). A label that comes to another true person than before, or a person to another label, is a switch.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Int8
from scipy.optimize import linear_sum_assignment

from ..formats.people import LOST, PREDICTED, SEEN, People
from ..formats.skeletons import TruthPoints

QUANTILE_95 = 7.814727903251179  # of chi square with three degrees of freedom
FILTERED = 12  # the first keypoints are measured; the others are built from them
GATE = 0.5  # metres, median over keypoints, within which a label can be a true person
NOBODY = -1


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Figures of one keypoint of one person.

    Attributes
    ----------
    mae, std, acc : float
        Metres, metres, m/s^2; NaN where nothing can be compared.
    frames : int
        Frames that were compared.
    present : float
        Share of the frames with a truth in which there was an output, 0..1.
    """

    mae: float
    std: float
    acc: float
    frames: int
    present: float


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """One keypoint of one label through all frames.

    Attributes
    ----------
    p, covariance : (f, 3), (f, 3, 3)
        Metres, m^2; NaN where the label is absent or the keypoint lost.
    status : (f,)
        Index into `formats.people.STATUSES`, -1 where the label is absent.
    """

    p: Float[np.ndarray, "f 3"]
    covariance: Float[np.ndarray, "f 3 3"]
    status: Int8[np.ndarray, " f"]


@dataclass(frozen=True, slots=True)
class Honesty:
    """Share of keypoints whose truth is inside the 95 % ellipsoid (NaN if there is none), and how many there are."""

    seen: float
    predicted: float
    seen_count: int
    predicted_count: int


def held(p: Float[np.ndarray, "f 3"]) -> Float[np.ndarray, "f 3"]:
    """The last place up to each frame; NaN before the first. A robot that is told nothing keeps its goal.

    >>> held(np.array([[np.nan] * 3, [1.0] * 3, [np.nan] * 3]))[:, 0].tolist()
    [nan, 1.0, 1.0]
    """
    if not p.shape[0]:
        return p.copy()
    last = np.maximum.accumulate(np.where(np.isfinite(p).all(axis=1), np.arange(p.shape[0]), -1))
    return np.where(last[:, None] >= 0, p[np.maximum(last, 0)], np.nan)


def accuracy(time: Float[np.ndarray, " f"], p: Float[np.ndarray, "f 3"], truth: Float[np.ndarray, "f 3"]) -> Accuracy:
    """MAE, STD and ACC of one keypoint (people paper, III-E); where nothing is put out the last place is held.

    Parameters
    ----------
    time : (f,)
        Seconds.
    p, truth : (f, 3)
        Metres; NaN where there is no output, or no truth.

    >>> t, zero = np.arange(4) / 10, np.zeros((4, 3))
    >>> found = accuracy(t, zero + (0.0, 3.0, 4.0), zero)
    >>> found.mae, found.std, found.acc
    (5.0, 0.0, 0.0)
    """
    known, given = (np.isfinite(points[:, 0]) for points in (truth, p))
    kept = held(p)
    distance = np.linalg.norm(kept - truth, axis=1)
    compared = np.isfinite(distance)
    rough = np.linalg.norm(second_difference(time, kept) - second_difference(time, truth), axis=1)
    rough = rough[np.isfinite(rough)]
    return Accuracy(
        mae=float(distance[compared].mean()) if compared.any() else np.nan,
        std=float(distance[compared].std()) if compared.any() else np.nan,
        acc=float(rough.mean()) if rough.size else np.nan,
        frames=int(compared.sum()),
        present=float(given[known].mean()) if known.any() else np.nan,
    )


def second_difference(time: Float[np.ndarray, " f"], p: Float[np.ndarray, "f d"]) -> Float[np.ndarray, "g d"]:
    """Second derivative at all frames but the first and last, for steps of any length; units of p / s^2.

    >>> t = np.array([0.0, 1.0, 3.0, 4.0])
    >>> second_difference(t, 1.5 * t[:, None] ** 2)[:, 0].tolist()
    [3.0, 3.0]
    """
    if time.size < 3:
        return np.zeros((0, p.shape[1]))
    velocity = np.diff(p, axis=0) / np.diff(time)[:, None]
    return 2.0 * np.diff(velocity, axis=0) / (time[2:] - time[:-2])[:, None]


def labels_of(people: People, truth: TruthPoints, gate: float = GATE) -> Int[np.ndarray, "f persons"]:
    """Label that each true person has in every frame, -1 where none.

    Parameters
    ----------
    gate : float
        Metres, median over the filtered keypoints that both have, beyond which a label is nobody's.
    """
    f, persons = people.time.size, truth.p.shape[1]
    out = np.full((f, persons), NOBODY)
    rows = np.searchsorted(people.frame, np.arange(f + 1))
    last = np.full(persons, NOBODY)
    for n in range(min(f, truth.p.shape[0])):
        here = slice(rows[n], rows[n + 1])
        labels = people.person[here]
        apart = _apart(people.p[here, :FILTERED], truth.p[n, :, :FILTERED])
        kept = (labels[:, None] == last[None]) & (apart <= gate)
        row, column = linear_sum_assignment(np.where(apart <= gate, apart, 1e3 * gate) - 1e2 * gate * kept)
        good = apart[row, column] <= gate
        out[n, column[good]] = labels[row[good]]
        last = np.where(out[n] >= 0, out[n], last)
    return out


def _apart(p: Float[np.ndarray, "q k 3"], truth: Float[np.ndarray, "persons k 3"]) -> Float[np.ndarray, "q persons"]:
    """Median distance over common keypoints, infinite where there is none."""
    distance = np.sort(np.linalg.norm(p[:, None] - truth[None], axis=-1), axis=-1)  # NaN last
    count = np.isfinite(distance).sum(axis=-1)
    if not distance.size:
        return np.full(distance.shape[:2], np.inf)
    middle = np.take_along_axis(distance, np.maximum((count - 1) // 2, 0)[..., None], axis=-1)[..., 0]
    return np.where(count > 0, middle, np.inf)


def switches(labels: Int[np.ndarray, "f persons"]) -> Int[np.ndarray, " persons"]:
    """How often each true person got another label than the one before, absences left out.

    >>> switches(np.array([[3, 5], [3, -1], [-1, 5], [4, 5]])).tolist()
    [1, 0]
    """
    count = [np.count_nonzero(np.diff(column[column != NOBODY])) for column in labels.T]
    return np.array(count, dtype=int)


def main_labels(labels: Int[np.ndarray, "f persons"]) -> Int[np.ndarray, " persons"]:
    """The label that stands for each true person: with these the most frames are right; -1 for a person without any.

    >>> main_labels(np.array([[3, 5], [3, 5], [5, 3]])).tolist()
    [3, 5]
    """
    names = np.unique(labels[labels != NOBODY])
    count = (labels[:, :, None] == names).sum(axis=0)
    row, column = linear_sum_assignment(count, maximize=True)
    out = np.full(labels.shape[1], NOBODY)
    used = count[row, column] > 0
    out[row[used]] = names[column[used]]
    return out


def course_of(people: People, label: int, keypoint: int) -> Course:
    """One keypoint of one label through all frames.

    Parameters
    ----------
    keypoint : int
        Index into `KEYPOINTS`.
    """
    f = people.time.size
    own = np.flatnonzero(people.person == label)
    p, covariance = np.full((f, 3), np.nan), np.full((f, 3, 3), np.nan)
    status = np.full(f, -1, dtype=np.int8)
    status[people.frame[own]] = people.status[own, keypoint]
    kept = own[people.status[own, keypoint] != LOST]
    p[people.frame[kept]], covariance[people.frame[kept]] = people.p[kept, keypoint], people.covariance[kept, keypoint]
    return Course(p, covariance, status)


def squares(
    p: Float[np.ndarray, "... 3"], covariance: Float[np.ndarray, "... 3 3"], truth: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "..."]:
    """Squared Mahalanobis distance of the truth; NaN where any of them is not known.

    >>> squares(np.zeros((1, 3)), np.eye(3)[None] * 4.0, np.array([[0.0, 0.0, 4.0]])).tolist()
    [4.0]
    """
    known = np.isfinite(p).all(axis=-1) & np.isfinite(truth).all(axis=-1) & np.isfinite(covariance).all(axis=(-1, -2))
    variance, axes = np.linalg.eigh(covariance[known])
    along = (np.swapaxes(axes, -1, -2) @ (truth - p)[known][..., None])[..., 0]
    out = np.full(known.shape, np.nan)
    out[known] = (along**2 / np.maximum(variance, 1e-18)).sum(axis=-1)
    return out


def honesty(people: People, truth: TruthPoints, mains: Int[np.ndarray, " persons"]) -> Honesty:
    """How often the truth is inside the 95 % ellipsoid, over the filtered keypoints of the labels of true people.

    Parameters
    ----------
    mains : (persons,)
        See `main_labels`. A label is held against its own person wherever it is.
    """
    inside, status = [np.zeros(0, dtype=bool)], [np.zeros(0, dtype=np.int8)]
    for person, label in enumerate(mains.tolist()):
        own = np.flatnonzero((people.person == label) & (people.frame < truth.p.shape[0]) & (label != NOBODY))
        square = squares(
            people.p[own, :FILTERED], people.covariance[own, :FILTERED], truth.p[people.frame[own], person, :FILTERED]
        )
        known = np.isfinite(square)
        inside.append(square[known] <= QUANTILE_95)
        status.append(people.status[own, :FILTERED][known])
    within, word = np.concatenate(inside), np.concatenate(status)
    shares = [float(within[word == each].mean()) if (word == each).any() else np.nan for each in (SEEN, PREDICTED)]
    counts = [int((word == each).sum()) for each in (SEEN, PREDICTED)]
    return Honesty(shares[0], shares[1], counts[0], counts[1])
