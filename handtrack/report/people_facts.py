"""Labelled people, and where known the raw skeletons and the truth, in; figures of their page and of `run.json` out."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..body.people_metrics import (
    FILTERED,
    NOBODY,
    Accuracy,
    Honesty,
    accuracy,
    course_of,
    honesty,
    labels_of,
    main_labels,
    switches,
)
from ..formats.people import LOST, PREDICTED, SEEN, People
from ..formats.skeletons import KEYPOINTS, TruthPoints

WRIST = KEYPOINTS.index("left_wrist")


@dataclass(frozen=True, slots=True, eq=False)
class AgainstTruth:
    """What the truth says of a result.

    Attributes
    ----------
    mains, switches : (persons,)
        Label that stands for each true person, and how often he got another one.
    error, raw_error : (f, persons, 16)
        Distance of his label's keypoints, and of the raw ones with the same identities, metres; NaN for none.
    wrist, raw_wrist : tuple of Accuracy
        Left wrist of each true person.
    honesty : Honesty
    strangers : int
        Entries of people who are nobody in truth.
    """

    mains: Int[np.ndarray, " persons"]
    switches: Int[np.ndarray, " persons"]
    error: Float[np.ndarray, "f persons 16"]
    raw_error: Float[np.ndarray, "f persons 16"] | None
    wrist: tuple[Accuracy, ...]
    raw_wrist: tuple[Accuracy, ...]
    honesty: Honesty
    strangers: int


@dataclass(frozen=True, slots=True, eq=False)
class PeopleFacts:
    """Figures of a run.

    Attributes
    ----------
    labels : (q,)
        Everybody, rising.
    shares : tuple of float
        Of the filtered keypoints of those who are present: seen, predicted, lost.
    longest : float
        Seconds of the longest stretch in which a keypoint was predicted, and then seen again.
    truth : AgainstTruth or None
    """

    labels: Int[np.ndarray, " q"]
    shares: tuple[float, float, float]
    longest: float
    truth: AgainstTruth | None

    def as_data(self) -> dict[str, object]:
        """The same as plain data, millimetres; None where there is nothing to say."""
        seen, predicted, lost = self.shares
        out: dict[str, object] = {
            "people": self.labels.size,
            "seen": _round(seen),
            "predicted": _round(predicted),
            "lost": _round(lost),
            "longest_bridged_gap_s": _round(self.longest),
        }
        if self.truth is None:
            return out
        t = self.truth
        out |= {
            "identity_switches": int(t.switches.sum()),
            "stranger_entries": t.strangers,
            "seen_inside_95": _round(t.honesty.seen),
            "predicted_inside_95": _round(t.honesty.predicted),
            "mean_error_mm": _mm(_mean(t.error[:, :, :FILTERED])),
            "raw_mean_error_mm": None if t.raw_error is None else _mm(_mean(t.raw_error[:, :, :FILTERED])),
            "left_wrist": [_wrist(label, found) for label, found in zip(t.mains.tolist(), t.wrist, strict=True)],
            "raw_left_wrist": [
                _wrist(label, found) for label, found in zip(t.mains.tolist(), t.raw_wrist, strict=False)
            ],
        }
        return out

    def sentences(self) -> list[str]:
        """The same in words."""
        seen, predicted, lost = (100.0 * share for share in self.shares)
        lines = [
            f"{self.labels.size} people; keypoints seen {seen:.1f} %, predicted {predicted:.1f} %, lost {lost:.1f} %"
        ]
        if self.truth is None:
            return lines
        data, inside = self.as_data(), self.truth.honesty.predicted
        if data["mean_error_mm"] is not None:
            raw = "" if data["raw_mean_error_mm"] is None else f" (raw {data['raw_mean_error_mm']:.0f})"
            held = "" if np.isnan(inside) else f", truth inside {100.0 * inside:.0f} % of predicted 95 % ellipsoids"
            lines.append(
                f"mean error {data['mean_error_mm']:.0f} mm{raw}{held}; identity switches {data['identity_switches']}"
            )
        return lines


def facts_of(people: People, raw: People | None = None, truth: TruthPoints | None = None) -> PeopleFacts:
    """Figures of people, held against the truth where there is one.

    Parameters
    ----------
    raw : People or None
        The measurements themselves, with the same labels.
    """
    status = people.status[:, :FILTERED]
    n = max(status.size, 1)
    shares = tuple(float(np.count_nonzero(status == each)) / n for each in (SEEN, PREDICTED, LOST))
    labels = np.unique(people.person)
    known = None if truth is None or not truth.p.shape[1] else _against(people, raw, truth)
    return PeopleFacts(labels, (shares[0], shares[1], shares[2]), _longest(people, labels), known)


def _against(people: People, raw: People | None, truth: TruthPoints) -> AgainstTruth:
    labels = labels_of(people, truth)
    mains = main_labels(labels)
    known = np.isfinite(truth.p[people.frame.clip(max=truth.p.shape[0] - 1), :, :FILTERED, 0]).any(axis=(1, 2))
    return AgainstTruth(
        mains=mains,
        switches=switches(labels),
        error=errors(people, truth, mains),
        raw_error=None if raw is None else errors(raw, truth, mains),
        wrist=_wrists(people, truth, mains),
        raw_wrist=() if raw is None else _wrists(raw, truth, mains),
        honesty=honesty(people, truth, mains),
        strangers=int(np.count_nonzero(known & ~np.isin(people.person, mains[mains != NOBODY]))),
    )


def errors(people: People, truth: TruthPoints, mains: Int[np.ndarray, " persons"]) -> Float[np.ndarray, "f persons 16"]:
    """Distance of each true person's keypoints from those of his label, metres; NaN where either is unknown or lost."""
    f = people.time.size
    out = np.full((f, mains.size, len(KEYPOINTS)), np.nan)
    for person, label in enumerate(mains.tolist()):
        own = np.flatnonzero((people.person == label) & (people.frame < truth.p.shape[0]) & (label != NOBODY))
        at = people.frame[own]
        apart = np.linalg.norm(people.p[own] - truth.p[at, person], axis=-1)
        out[at, person] = np.where(people.status[own] == LOST, np.nan, apart)
    return out


def _wrists(people: People, truth: TruthPoints, mains: Int[np.ndarray, " persons"]) -> tuple[Accuracy, ...]:
    f = min(people.time.size, truth.p.shape[0])
    return tuple(
        accuracy(people.time[:f], course_of(people, label, WRIST).p[:f], truth.p[:f, person, WRIST])
        for person, label in enumerate(mains.tolist())
    )


def _longest(people: People, labels: Int[np.ndarray, " q"]) -> float:
    """Seconds from the last to the next sight, over all stretches of `predicted` between two of `seen`."""
    most = 0.0
    for label in labels.tolist():
        own = np.flatnonzero(people.person == label)
        time, status = people.time[people.frame[own]], people.status[own, :FILTERED]
        for column in status.T:
            seen = np.flatnonzero(column == SEEN)
            lost = np.cumsum(column == LOST)
            bridged = np.diff(seen) > 1
            if seen.size > 1:
                whole = lost[seen[1:]] == lost[seen[:-1]]
                most = max(most, float(np.diff(time[seen])[bridged & whole].max(initial=0.0)))
    return most


def _wrist(label: int, found: Accuracy) -> dict[str, object]:
    return {
        "label": None if label == NOBODY else label,
        "mae_mm": _mm(found.mae),
        "std_mm": _mm(found.std),
        "acc_m_s2": _round(found.acc),
        "present": _round(found.present),
    }


def _mean(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan


def _mm(metres: float) -> float | None:
    return _round(1000.0 * metres, 2)


def _round(value: float, digits: int = 4) -> float | None:
    return None if not np.isfinite(value) else round(float(value), digits)
