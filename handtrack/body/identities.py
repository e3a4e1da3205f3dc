"""Expected people and skeletons of a frame in; who is who out.

The people paper's cost (II-B, eq. (2)) of person i's being skeleton j, with D the mean distance of their common
keypoints and C that of their confidences, u the unit step:

    M = D + C + u(D + C - delta)

The cheapest assignment is the Hungarian method's. Metres and confidences are added there as if they were one; a gate on
D alone keeps a stranger from being taken for somebody who left. Mode `robust` bounds every keypoint's distance, so that
one on the wall does not count for the whole body.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from .people_settings import Settings
from .skeleton_graph import FILTERED

FAR = 0.6  # metres: what a keypoint adds at most, in mode `robust`, if nothing else is said
BEYOND = 1.5  # gates: what a keypoint adds at most, so that half of them may be anywhere
GROWTH = 1.0  # m/s by which the gate widens while somebody is not seen
WIDEST = 1.5  # metres
TWIN = 0.2  # metres: a skeleton this near to a known person is a second report of him
SAME_HEIGHT = 0.12  # metres, within which somebody who comes may be somebody who left
FASTEST = 3.0  # m/s, of somebody who is not seen
_BIG = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class Costs:
    """D, C and M of q people and m skeletons, each (q, m); D is infinite where no keypoint is common."""

    distance: Float[np.ndarray, "q m"]
    confidence: Float[np.ndarray, "q m"]
    total: Float[np.ndarray, "q m"]


def costs(
    p: Float[np.ndarray, "q k 3"],
    confidence: Float[np.ndarray, "q k"],
    seen_p: Float[np.ndarray, "m k 3"],
    seen_confidence: Float[np.ndarray, "m k"],
    settings: Settings,
    farthest: Float[np.ndarray, " q"] | float = FAR,
) -> Costs:
    """D, C and M of every person with every skeleton.

    Parameters
    ----------
    p, confidence : (q, k, 3), (q, k)
        Where people are expected, metres, and how sure they were; NaN for keypoints that are not known.
    seen_p, seen_confidence : (m, k, 3), (m, k)
    farthest : (q,) or float
        What a keypoint adds to D at most, metres, in mode `robust`: more than the gate, or nobody is beyond it.

    >>> one, c = np.zeros((1, 12, 3)), np.ones((1, 12))
    >>> costs(one, c, one + [0.0, 0.6, 0.0], 0.5 * c, Settings(mode="paper")).total.round(2).tolist()
    [[2.1]]
    """
    apart = p[:, None] - seen_p[None]
    apart = np.sqrt((apart * apart).sum(axis=-1))
    common = ~np.isnan(apart)
    if settings.mode == "robust":
        apart = np.minimum(apart, np.broadcast_to(farthest, apart.shape[:1])[:, None, None])
    count = common.sum(axis=-1)
    none = count == 0
    count = np.maximum(count, 1)
    d = np.where(common, apart, 0.0).sum(axis=-1) / count
    c = np.where(common, np.abs(confidence[:, None] - seen_confidence[None]), 0.0).sum(axis=-1) / count
    if none.any():  # empty cells get the highest element
        highest_d, highest_c = d.max(initial=0.0, where=~none), c.max(initial=0.0, where=~none)
        total = np.where(none, highest_d + highest_c, d + c)
        d = np.where(none, np.inf, d)
    else:
        total = d + c
    return Costs(d, c, total + (total > settings.delta))


def assigned(
    found: Costs, gate: Float[np.ndarray, " q"]
) -> tuple[Int[np.ndarray, " a"], Int[np.ndarray, " a"], Float[np.ndarray, " a"]]:
    """People, their skeletons, and what it costs, for all that are within their gates.

    Parameters
    ----------
    gate : (q,)
        Largest D of each person, metres.

    >>> d = np.array([[0.1, 0.3], [0.2, 9.0]])
    >>> who, which, _ = assigned(Costs(d, 0 * d, d), np.ones(2))
    >>> who.tolist(), which.tolist()
    ([0, 1], [1, 0])
    """
    if not found.total.size:
        nobody = np.zeros(0, dtype=int)
        return nobody, nobody, np.zeros(0)
    within = found.distance <= gate[:, None]
    who, which = linear_sum_assignment(np.where(within, found.total, _BIG))
    good = within[who, which]
    who, which = who[good], which[good]
    return who, which, found.total[who, which]


def gates(unseen: Float[np.ndarray, " q"], settings: Settings) -> Float[np.ndarray, " q"]:
    """Gate of each person, metres: it widens while he is not seen."""
    return np.minimum(settings.gate + GROWTH * unseen, max(WIDEST, settings.gate))


def newcomers(
    found: Costs, taken: Int[np.ndarray, " a"], known: Bool[np.ndarray, " q"], enough: Bool[np.ndarray, " m"]
) -> Int[np.ndarray, " n"]:
    """Skeletons that may begin a person: free, whole enough, and no second report of a known person."""
    free = enough.copy()
    free[taken] = False
    if known.any():
        free &= ~(found.distance[known] < TWIN).any(axis=0)
    return np.flatnonzero(free)


def returned(
    height: float,
    place: Float[np.ndarray, " 3"],
    heights: Float[np.ndarray, " r"],
    places: Float[np.ndarray, "r 3"],
    away: Float[np.ndarray, " r"],
) -> int:
    """Which of those who left has come back, -1 for none: his height, and no farther than he could have walked.

    Parameters
    ----------
    height, place : float, (3,)
        Of who comes: metres; NaN if no bone told his height.
    heights, places, away : (r,), (r, 3), (r,)
        Of who left: metres, and seconds ago.

    >>> at = np.zeros((2, 3))
    >>> returned(1.8, np.ones(3), np.array([1.62, 1.78]), at, np.full(2, 5.0))
    1
    """
    if not heights.size:
        return -1
    off = np.abs(heights - height)
    far = np.sqrt(((places - place) ** 2).sum(axis=1))
    with np.errstate(invalid="ignore"):
        possible = (off <= SAME_HEIGHT) & (far <= 1.0 + FASTEST * away)
    return int(np.where(possible, off, np.inf).argmin()) if possible.any() else -1


def undone_swaps(
    expected: Float[np.ndarray, "a 12 3"], p: Float[np.ndarray, "a 12 3"], confidence: Float[np.ndarray, "a 12 2"]
) -> tuple[Float[np.ndarray, "a 12 3"], Float[np.ndarray, "a 12 2"]]:
    """Change left and right back where that fits what is expected of the person clearly better, pair by pair.

    Parameters
    ----------
    expected : (a, 12, 3)
        Where keypoints are expected, metres; NaN where nothing is.
    """
    other = np.arange(FILTERED) ^ 1
    straight = np.sqrt(((p - expected) ** 2).sum(axis=-1))
    across = np.sqrt(((p[:, other] - expected) ** 2).sum(axis=-1))
    pair = straight.reshape(-1, 6, 2).sum(axis=-1), across.reshape(-1, 6, 2).sum(axis=-1)
    with np.errstate(invalid="ignore"):
        wrong = np.repeat(pair[1] + SWAP_MARGIN < 0.5 * pair[0], 2, axis=-1)
    return np.where(wrong[..., None], p[:, other], p), np.where(wrong[..., None], confidence[:, other], confidence)


SWAP_MARGIN = 0.03  # metres
