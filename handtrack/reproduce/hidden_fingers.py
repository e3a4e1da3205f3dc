"""Tracks through occlusions and their truths in, how well a hidden finger was kept and found again out.

Over N seeded runs of a scene, with e the error of the hidden finger's joints and C their stated covariance:

    error     root mean square of e over the hidden frames
    NEES      e^T C^-1 e, whose mean is the number of joints if C is right
    2 sigma   share of the frames with  e^T C^-1 e <= chi2_0.954(joints), the ellipsoid of two sigmas; and of all e_j
    back      frames from when a tenth of the finger is seen again until all its joints are within 5 degrees, and stay
    swapped   runs after which the finger's pose is that of another finger, and the other's pose its own
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from ..evaluate import nees

SEEN_AGAIN = 0.1  # share of a finger that must show before it can be asked for
NEAR = np.radians(5.0)  # all joints closer to the truth than this: the finger is found again
STAYS = 3  # frames for which it has to stay so
PROMPT = 3  # frames within which it should be found
_TELLING = np.radians(10.0)  # fingers closer to each other than this cannot be told apart by their poses
_TWO_SIGMA = float(chi2.cdf(4.0, 1))


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One run of n frames, m of them with the finger hidden. Angles in radians.

    Attributes
    ----------
    kind, length, seed : str, int, int
        Scene, the length it was asked for, and its seed.
    off, sigma : (m, j)
        Error and stated standard deviation of the hidden finger's joints.
    nees : (m,)
        Of these joints together.
    others : float
        Root mean square error of all other joints in all frames.
    back : (i,)
        For each time that the finger came to be seen again: frames until it was found; inf for never.
    swapped : bool
        Whether it ended with another finger's pose.
    seconds : float
        Median computing time of a frame.
    """

    kind: str
    length: int
    seed: int
    off: Float[np.ndarray, "m j"]
    sigma: Float[np.ndarray, "m j"]
    nees: Float[np.ndarray, " m"]
    others: float
    back: Float[np.ndarray, " i"]
    swapped: bool
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What a tracker said of n frames: joints, their covariance, and the median computing time of a frame."""

    q: Float[np.ndarray, "n j"]
    covariance: Float[np.ndarray, "n j j"]
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Script:
    """What truly happened.

    Attributes
    ----------
    truth : (n, j)
    fingers : (f, j)
        Which joints belong to which finger.
    watched : int
        The finger that is hidden.
    share, hidden : (n,)
        Its visible share, and the frames in which it counts as hidden.
    """

    kind: str
    length: int
    seed: int
    truth: Float[np.ndarray, "n j"]
    fingers: Bool[np.ndarray, "f j"]
    watched: int
    share: Float[np.ndarray, " n"]
    hidden: Bool[np.ndarray, " n"]


def trial(script: Script, run: Run) -> Trial:
    """Compare a run with what truly happened."""
    mine, hidden = script.fingers[script.watched], script.hidden
    off = run.q - script.truth
    covariance = run.covariance[hidden][:, mine][:, :, mine]
    back = found_again(np.abs(off[:, mine]).max(axis=1), script.share, hidden)
    return Trial(
        kind=script.kind,
        length=script.length,
        seed=script.seed,
        off=off[hidden][:, mine],
        sigma=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
        nees=nees(off[hidden][:, mine], covariance)[0],
        others=float(np.sqrt(np.mean(off[:, ~mine] ** 2))),
        back=back,
        swapped=swapped(script, run.q),
        seconds=run.seconds,
    )


def found_again(
    worst: Float[np.ndarray, " n"], share: Float[np.ndarray, " n"], hidden: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, " i"]:
    """Frames from each return of a finger until it is found; inf for never, nothing for one that does not return.

    Parameters
    ----------
    worst : (n,)
        Largest error of its joints, radians.

    >>> worst, share = np.array([0.0, 9, 9, 9, 0, 0, 0]), np.array([1.0, 0, 0, 0.2, 0.5, 1, 1])
    >>> found_again(worst, share, share < 0.01).tolist()
    [1.0]
    """
    near = np.append(worst <= NEAR, np.ones(STAYS - 1, dtype=bool))
    stays = np.all(np.lib.stride_tricks.sliding_window_view(near, STAYS), axis=1)
    ends = np.flatnonzero(hidden[:-1] & ~hidden[1:]) + 1
    found = []
    for end in ends:
        seen = end + np.flatnonzero(share[end:] >= SEEN_AGAIN)
        if seen.size:
            frames = np.flatnonzero(stays[seen[0] :])
            found.append(float(frames[0]) if frames.size else np.inf)
    return np.array(found)


def swapped(script: Script, q: Float[np.ndarray, "n j"]) -> bool:
    """Whether, in most of the frames after the finger came back, two fingers' poses fit better exchanged."""
    mine = script.fingers[script.watched]
    ends = np.flatnonzero(script.hidden[:-1] & ~script.hidden[1:])
    if not ends.size:
        return False
    later = np.flatnonzero(~script.hidden & (np.arange(script.hidden.size) > ends[0] + PROMPT))
    q, truth = q[later], script.truth[later]
    for number, its in enumerate(script.fingers):
        if number == script.watched or its.sum() != mine.sum():
            continue
        apart = np.abs(truth[:, mine] - truth[:, its]).max(axis=1) > _TELLING
        straight = _distance(q[:, mine], truth[:, mine]) + _distance(q[:, its], truth[:, its])
        crosswise = _distance(q[:, mine], truth[:, its]) + _distance(q[:, its], truth[:, mine])
        if apart.any() and np.mean((crosswise < straight)[apart]) > 0.5:
            return True
    return False


def _distance(a: Float[np.ndarray, "n j"], b: Float[np.ndarray, "n j"]) -> Float[np.ndarray, " n"]:
    return np.abs(a - b).mean(axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """Figures of one scene and length over its runs; angles in degrees, time in milliseconds.

    Attributes
    ----------
    error, worst : float
        RMS error of the hidden finger, median of the runs and largest of them.
    nees, joints : float, int
        Mean, and what it would be if the stated covariances were right.
    inside, inside_joints : float
        Share of the hidden frames within the ellipsoid of two sigmas, and of the joints within two of their own.
    swaps, prompt, lost : int
        Runs that ended swapped; that found the finger within `PROMPT` frames each time, and not swapped; that never
        found it.
    back, back_90 : float
        Frames until it was found: median and nine tenths of the runs; inf for never.
    others : float
        Median RMS error of all other joints.
    """

    kind: str
    length: int
    runs: int
    hidden: int
    error: float
    worst: float
    nees: float
    joints: int
    inside: float
    inside_joints: float
    swaps: int
    prompt: int
    lost: int
    back: float
    back_90: float
    others: float
    milliseconds: float


def summed(trials: Sequence[Trial]) -> tuple[Row, ...]:
    """One row for each scene and length, in the order in which they come."""
    keys = list(dict.fromkeys((each.kind, each.length) for each in trials))
    return tuple(_row([each for each in trials if (each.kind, each.length) == key]) for key in keys)


def _row(trials: Sequence[Trial]) -> Row:
    off = np.concatenate([each.off for each in trials])
    sigma = np.concatenate([each.sigma for each in trials])
    value = np.concatenate([each.nees for each in trials])
    joints = off.shape[1]
    back = np.array([each.back.max(initial=0.0) for each in trials])
    swaps = np.array([each.swapped for each in trials])
    errors = np.degrees([np.sqrt(np.mean(each.off**2)) for each in trials if each.off.size])
    return Row(
        kind=trials[0].kind,
        length=trials[0].length,
        runs=len(trials),
        hidden=value.size,
        error=float(np.median(errors)) if errors.size else float("nan"),
        worst=float(errors.max(initial=0.0)),
        nees=float(value.mean()) if value.size else float("nan"),
        joints=joints,
        inside=float(np.mean(value <= chi2.ppf(_TWO_SIGMA, joints))) if value.size else float("nan"),
        inside_joints=float(np.mean(np.abs(off) <= 2.0 * sigma)) if off.size else float("nan"),
        swaps=int(swaps.sum()),
        prompt=int(np.sum((back <= PROMPT) & ~swaps)),
        lost=int(np.isinf(back).sum()),
        back=float(np.quantile(back, 0.5, method="inverted_cdf")),
        back_90=float(np.quantile(back, 0.9, method="inverted_cdf")),
        others=float(np.degrees(np.median([each.others for each in trials]))),
        milliseconds=1e3 * float(np.median([each.seconds for each in trials])),
    )


HEADER = (
    "scene",
    "frames",
    "runs",
    "error deg",
    "worst run",
    "NEES",
    "of",
    "2 sigma %",
    "joints %",
    "swaps",
    f"back in {PROMPT}",
    "never",
    "back",
    "90 %",
    "others deg",
    "ms",
)


def table_rows(rows: Sequence[Row]) -> list[list[object]]:
    """Rows under `HEADER`."""
    return [
        [
            row.kind,
            row.length,
            row.runs,
            row.error,
            row.worst,
            f"{row.nees:.2f}",
            row.joints,
            f"{100.0 * row.inside:.1f}",
            f"{100.0 * row.inside_joints:.1f}",
            row.swaps,
            row.prompt,
            row.lost,
            frames_text(row.back),
            frames_text(row.back_90),
            row.others,
            f"{row.milliseconds:.1f}",
        ]
        for row in rows
    ]


def frames_text(count: float) -> str:
    """A number of frames in words.

    >>> frames_text(3.0), frames_text(np.inf)
    ('3', 'never')
    """
    return f"{count:.0f}" if np.isfinite(count) else "never"


def as_data(rows: Sequence[Row], trials: Sequence[Trial] = ()) -> dict[str, object]:
    """The figures as plain data."""
    return {
        "seen_again_share": SEEN_AGAIN,
        "near_deg": float(np.degrees(NEAR)),
        "prompt_frames": PROMPT,
        "scenes": [
            {
                "scene": row.kind,
                "frames": row.length,
                "runs": row.runs,
                "hidden_frames": row.hidden,
                "error_deg": row.error,
                "error_worst_run_deg": row.worst,
                "nees": row.nees,
                "nees_expected": row.joints,
                "inside_two_sigma": row.inside,
                "joints_inside_two_sigma": row.inside_joints,
                "swaps": row.swaps,
                "found_promptly": row.prompt,
                "never_found": row.lost,
                "frames_until_found_median": row.back,
                "frames_until_found_90": row.back_90,
                "others_deg": row.others,
                "frame_ms": row.milliseconds,
            }
            for row in rows
        ],
        "runs": [
            {
                "scene": each.kind,
                "frames": each.length,
                "seed": each.seed,
                "error_deg": float(np.degrees(np.sqrt(np.mean(each.off**2)))) if each.off.size else None,
                "nees": float(each.nees.mean()) if each.nees.size else None,
                "frames_until_found": each.back,
                "swapped": each.swapped,
            }
            for each in trials
        ],
    }
