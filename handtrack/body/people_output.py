"""Tracks in; labelled people of a frame, and of a whole recording, out.

Of the 16 keypoints the first 12 are followed; the others are built of them with their covariances, and are as well seen
as the least of those.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Int8

from ..formats.people import LOST, PREDICTED, SEEN, People
from .people_settings import Settings
from .people_tracks import Tracks, places
from .skeleton_graph import FILTERED, NECK, SIDE

_TRUNK = NECK / SIDE  # of the trunk's length from the shoulders up to the head
# Weights of the filtered keypoints in root, middle of hips, middle of shoulders, head.
BUILT = np.zeros((4, FILTERED))
BUILT[0, [0, 1, 6, 7]] = 0.25
BUILT[1, [6, 7]] = 0.5
BUILT[2, [0, 1]] = 0.5
BUILT[3, [0, 1]], BUILT[3, [6, 7]] = 0.5 + 0.5 * _TRUNK, -0.5 * _TRUNK
_FROM = BUILT != 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PeopleFrame:
    """People of a frame, q of them, by rising label.

    Attributes
    ----------
    person : (q,)
        Labels, which stay.
    p, covariance : (q, 16, 3), (q, 16, 3, 3)
        Metres, m^2, camera axes; NaN only where lost.
    confidence : (q, 16)
        Of the measurement that was used; 0 where there was none.
    status : (q, 16)
        Index into `formats.people.STATUSES`: seen, predicted, lost.
    height : (q,)
        Metres; NaN if no bone has told it.
    """

    person: Int[np.ndarray, " q"]
    p: Float[np.ndarray, "q 16 3"]
    covariance: Float[np.ndarray, "q 16 3 3"]
    confidence: Float[np.ndarray, "q 16"]
    status: Int8[np.ndarray, "q 16"]
    height: Float[np.ndarray, " q"]


def frame_of(tracks: Tracks, settings: Settings) -> PeopleFrame:
    """Everybody who has a label and is not beyond the distance."""
    middle = places(tracks.p)
    shown = (tracks.label >= 0) & (np.sqrt((middle * middle).sum(axis=1)) <= settings.distance)
    rows = np.flatnonzero(shown)
    rows = rows[np.argsort(tracks.label[rows])]
    p, covariance, used, hidden = (x[rows] for x in (tracks.p, tracks.covariance, tracks.used, tracks.hidden))
    status = np.where(hidden <= 0.0, SEEN, np.where(hidden <= settings.longest, PREDICTED, LOST))
    lost = status == LOST
    p = np.where(lost[..., None], np.nan, p)
    covariance = np.where(lost[..., None, None], np.nan, covariance)
    worst = np.stack([status[:, used_by].max(axis=1) for used_by in _FROM], axis=1)
    least = np.stack([used[:, used_by].min(axis=1) for used_by in _FROM], axis=1)
    built_p, built_c = _built(p, covariance)
    return PeopleFrame(
        tracks.label[rows],
        np.concatenate([p, built_p], axis=1),
        np.concatenate([covariance, built_c], axis=1),
        np.concatenate([used, least], axis=1),
        np.concatenate([status, worst], axis=1).astype(np.int8),
        tracks.height[rows],
    )


def _built(
    p: Float[np.ndarray, "q 12 3"], covariance: Float[np.ndarray, "q 12 3 3"]
) -> tuple[Float[np.ndarray, "q 4 3"], Float[np.ndarray, "q 4 3 3"]]:
    """Keypoints in between, and their covariances; NaN where one that is needed is lost."""
    q = p.shape[0]
    lacking = (np.isnan(p[..., 0]) @ _FROM.T.astype(float)) > 0
    here = ~np.isnan(p[..., :1])
    built = BUILT @ np.where(here, p, 0.0)
    spread = (BUILT**2 @ np.where(here, covariance.reshape(q, FILTERED, 9), 0.0)).reshape(q, 4, 3, 3)
    return np.where(lacking[..., None], np.nan, built), np.where(lacking[..., None, None], np.nan, spread)


def gathered(time: Float[np.ndarray, " f"], frames: Sequence[PeopleFrame], warnings: tuple[str, ...]) -> People:
    """A recording of its frames; one who comes back has lost entries for the frames in between."""
    nothing = np.zeros(0, dtype=int)
    frame = np.concatenate([nothing, *(np.full(each.person.size, n) for n, each in enumerate(frames))])
    person = np.concatenate([nothing, *(each.person for each in frames)])
    gap_frame, gap_person = _gaps(frame, person)
    g = gap_frame.size
    frame, person = np.concatenate([frame, gap_frame]), np.concatenate([person, gap_person])
    order = np.lexsort((person, frame))
    tails = ((16, 3), np.nan), ((16,), 0.0), ((16, 3, 3), np.nan)
    p, confidence, covariance = (
        np.concatenate([*(getattr(each, name) for each in frames), np.full((g, *shape), value)])[order]
        for name, (shape, value) in zip(("p", "confidence", "covariance"), tails, strict=True)
    )
    status = np.concatenate([*(each.status for each in frames), np.full((g, 16), LOST, dtype=np.int8)])[order]
    return People(
        np.asarray(time, dtype=float), frame[order], person[order], p, confidence, covariance, status, warnings
    )


def _gaps(
    frame: Int[np.ndarray, " d"], person: Int[np.ndarray, " d"]
) -> tuple[Int[np.ndarray, " g"], Int[np.ndarray, " g"]]:
    """Frames, and who is missing there between two entries."""
    order = np.lexsort((frame, person))
    a, b = order[:-1], order[1:]
    missing = np.where(person[a] == person[b], frame[b] - frame[a] - 1, 0)
    first = np.repeat(frame[a] + 1, missing)
    within = np.arange(first.size) - np.repeat(np.cumsum(missing) - missing, missing)
    return first + within, np.repeat(person[a], missing)
