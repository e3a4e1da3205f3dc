"""What the images alone said of the joints in, the directions they left open out, named by joint and by frame.

`A` of one frame is the information of the images about the independent joints, without prediction, soft couplings and
limits. Sliding joints are measured in a typical link's length, so that A has one unit, 1/rad^2. With the floor of
knowing nothing at all, 60 degrees,

    C = (A + 1 / 60^2)^-1,        C v = sigma^2 v,        sigma > threshold

every eigenvector v is a motion that the view does not tell from standing still: the hand thesis saw it in its thumb
(chapter 7: "the first two links have two DOF each"). A joint with `A_ii < 1 / threshold^2` is not seen even if all
others are known, and is named by itself. Directions of about the same sigma are known only as a space, so they are
turned within it until each names few joints (varimax, Kaiser 1958). Directions that stay alike over frames are one
finding.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .kinematics import Model
from .track import Track

THRESHOLD = np.radians(5.0)
UNKNOWN = np.radians(60.0)  # sigma of knowing nothing
_ALIKE = 0.85  # cosine of two directions that are the same finding
_GAP = 2  # frames that a finding may be absent for
_LEAST_FRAMES = 3
_BAND = 2.0  # ratio of sigmas within which directions are turned
_TURNS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Observability:
    """What the images alone say, and do not say.

    Attributes
    ----------
    joint_names, free : tuple of str, (k,)
        All joints, and the indices of the independent ones.
    prismatic : (j,)
        Which joints slide.
    units, length : str, float
        The model's unit, and the length that counts as one radian for sliding joints.
    frame, sigma : (n,), (n, j)
        Image-only standard deviation of every joint in every frame, radians (model units where it slides).
    threshold : float
        Radians.
    direction : (d, k)
        Open directions, unit vectors over the independent joints (radians, or `length` for sliding ones); the largest
        weight is positive.
    direction_sigma, largest_sigma : (d,), (d,)
        Median and largest standard deviation along each, radians (or times `length`).
    first, last, count : (d,)
        Frame numbers between which each was found, and in how many frames.
    unseen : (d,)
        Single joints that the images do not show at all.
    weakest, weakest_sigma, weakest_frame : (k,), float, int
        The direction with the largest sigma of all frames.
    """

    joint_names: tuple[str, ...]
    free: Int[np.ndarray, " k"]
    prismatic: Bool[np.ndarray, " j"]
    units: str
    length: float
    frame: Int[np.ndarray, " n"]
    sigma: Float[np.ndarray, "n j"]
    threshold: float
    direction: Float[np.ndarray, "d k"]
    direction_sigma: Float[np.ndarray, " d"]
    largest_sigma: Float[np.ndarray, " d"]
    first: Int[np.ndarray, " d"]
    last: Int[np.ndarray, " d"]
    count: Int[np.ndarray, " d"]
    unseen: Bool[np.ndarray, " d"]
    weakest: Float[np.ndarray, " k"]
    weakest_sigma: float
    weakest_frame: int


@dataclass(slots=True, eq=False)
class _Finding:
    """A direction while it is followed from frame to frame."""

    total: Float[np.ndarray, " k"]
    rows: list[int]
    sigmas: list[float]
    unseen: bool


def observability(track: Track, model: Model, threshold: float = THRESHOLD) -> Observability:
    """Open directions of a track.

    Parameters
    ----------
    threshold : float
        Standard deviation from the images alone beyond which a direction counts as open, radians.

    Raises
    ------
    ValueError
        If the track has no frames, or its information does not fit the model.

    Examples
    --------
    >>> from handtrack.kinematics.builtin import model
    >>> directions(np.diag([1e4, 1.0]), np.radians(5.0))[0].round(3).tolist()
    [[0.0, 1.0]]
    """
    k = model.free.size
    if not track.frame.size:
        raise ValueError("track: has no frames, at least one was wanted")
    if track.information.shape != (track.frame.size, k, k):
        raise ValueError(f"track: information has the shape {track.information.shape}; (frames, {k}, {k}) was wanted")
    if not 0.0 < threshold < UNKNOWN:
        raise ValueError(f"threshold: got {threshold}; an angle above 0 and below {UNKNOWN:.3f} radians was wanted")
    slides, length = sliding_joints(model), length_unit(model)
    scale = np.where(slides[model.free], length, 1.0)
    A = track.information * (scale[:, None] * scale)
    C = np.linalg.inv(A + np.eye(k) / UNKNOWN**2)
    C = 0.5 * (C + np.swapaxes(C, 1, 2))
    variance, vector = np.linalg.eigh(C)
    T = model.coupling * scale
    sigma = np.sqrt(np.maximum(((T @ C) * T).sum(axis=2), 0.0))
    worst = int(np.argmax(variance[:, -1]))
    open_rows = np.flatnonzero((variance[:, -1] > threshold**2) | (_least_alone(A) < threshold**-2))
    found = _follow(A, C, open_rows, threshold)
    kept = [one for one in found if len(one.rows) >= min(_LEAST_FRAMES, track.frame.size)]
    kept.sort(key=lambda one: (one.rows[0], -max(one.sigmas)))
    columns = np.array([one.total for one in kept]).reshape(-1, k)
    return Observability(
        joint_names=model.joint_names,
        free=model.free,
        prismatic=slides,
        units=model.units,
        length=length,
        frame=track.frame,
        sigma=sigma,
        threshold=threshold,
        direction=columns / np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), 1e-300),
        direction_sigma=np.array([float(np.median(one.sigmas)) for one in kept]),
        largest_sigma=np.array([max(one.sigmas) for one in kept]),
        first=track.frame[[one.rows[0] for one in kept]],
        last=track.frame[[one.rows[-1] for one in kept]],
        count=np.array([len(one.rows) for one in kept], dtype=int),
        unseen=np.array([one.unseen for one in kept], dtype=bool),
        weakest=_upright(vector[worst, :, -1:].T)[0],
        weakest_sigma=float(np.sqrt(variance[worst, -1])),
        weakest_frame=int(track.frame[worst]),
    )


def directions(
    A: Float[np.ndarray, "k k"], threshold: float, C: Float[np.ndarray, "k k"] | None = None
) -> tuple[Float[np.ndarray, "m k"], Float[np.ndarray, " m"], Bool[np.ndarray, " m"]]:
    """Open directions of one frame, their sigmas, and which are single joints not seen at all.

    Parameters
    ----------
    A : (k, k)
        Information of the images, 1/rad^2, all joints in one unit.
    C : (k, k), optional
        `(A + 1 / UNKNOWN^2)^-1`, if it is known already.
    """
    k = A.shape[0]
    C = np.linalg.inv(A + np.eye(k) / UNKNOWN**2) if C is None else C
    alone = np.diag(A) < threshold**-2
    seen = np.flatnonzero(~alone)
    rows, sigmas = [np.eye(k)[alone]], [np.sqrt(np.diag(C)[alone])]
    if seen.size:
        variance, vector = np.linalg.eigh(C[np.ix_(seen, seen)])
        weak = variance > threshold**2
        for low, high in _bands(np.sqrt(variance[weak])):
            members = np.flatnonzero(weak)[low:high]
            turned = np.zeros((members.size, k))
            turned[:, seen] = varimax(vector[:, members]).T
            rows.append(_upright(turned))
            sigmas.append(np.sqrt(((turned @ C) * turned).sum(axis=1)))
    out = np.concatenate(rows)
    return out, np.concatenate(sigmas), np.arange(out.shape[0]) < int(alone.sum())


def varimax(basis: Float[np.ndarray, "k m"]) -> Float[np.ndarray, "k m"]:
    """The same space with a basis in which every vector has few large entries (Kaiser 1958).

    >>> turned = varimax(np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2.0))
    >>> np.abs(turned).round(6).tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    """
    m = basis.shape[1]
    if m < 2:
        return basis
    # An even mixture is a saddle of the criterion; pivoted elimination starts away from it.
    turn = np.linalg.qr(basis[_pivots(basis)].T)[0]
    for _ in range(_TURNS):
        L = basis @ turn
        U, _, V = np.linalg.svd(basis.T @ (L**3 - L * (L * L).mean(axis=0)))
        before, turn = turn, U @ V
        if np.abs(turn - before).max() < 1e-4:
            break
    return basis @ turn


def _pivots(basis: Float[np.ndarray, "k m"]) -> list[int]:
    """Rows whose joints span the space best, the largest first."""
    left, chosen = basis.copy(), []
    for _ in range(basis.shape[1]):
        size = (left * left).sum(axis=1)
        best = int(np.argmax(size))
        chosen.append(best)
        along = left[best] / np.sqrt(size[best])
        left = left - np.outer(left @ along, along)
    return chosen


def _bands(sigma: Float[np.ndarray, " m"]) -> list[tuple[int, int]]:
    """Runs of sorted sigmas whose largest is at most `_BAND` times the smallest."""
    runs, start = [], 0
    for i in range(1, sigma.size + 1):
        if i == sigma.size or sigma[i] > _BAND * sigma[start]:
            runs.append((start, i))
            start = i
    return runs


def _follow(
    A: Float[np.ndarray, "n k k"], C: Float[np.ndarray, "n k k"], open_rows: Int[np.ndarray, " r"], threshold: float
) -> list[_Finding]:
    """Findings: the open directions of every frame, joined to those of the frames before."""
    done: list[_Finding] = []
    live: list[_Finding] = []
    for row in open_rows.tolist():
        done += [one for one in live if row - one.rows[-1] > _GAP + 1]
        live = [one for one in live if row - one.rows[-1] <= _GAP + 1]
        vectors, sigmas, unseen = directions(A[row], threshold, C[row])
        known = np.array([one.total / np.linalg.norm(one.total) for one in live]).reshape(-1, A.shape[1])
        cosine = vectors @ known.T
        taken = np.zeros(len(live), dtype=bool)
        for i in range(vectors.shape[0]):
            free = np.where(taken, 0.0, np.abs(cosine[i]))
            best = int(np.argmax(free)) if free.size else -1
            if best >= 0 and free[best] > _ALIKE and live[best].unseen == bool(unseen[i]):
                taken[best] = True
                one = live[best]
                one.total = one.total + np.sign(cosine[i, best]) * vectors[i]
                one.rows.append(row)
                one.sigmas.append(float(sigmas[i]))
            else:
                live.append(_Finding(vectors[i], [row], [float(sigmas[i])], bool(unseen[i])))
                taken = np.append(taken, True)
                cosine = np.column_stack([cosine, np.zeros(vectors.shape[0])])
    return done + live


def _least_alone(A: Float[np.ndarray, "n k k"]) -> Float[np.ndarray, " n"]:
    return np.diagonal(A, axis1=1, axis2=2).min(axis=1)


def _upright(rows: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "m k"]:
    """Each row with its largest entry positive."""
    largest = np.take_along_axis(rows, np.abs(rows).argmax(axis=1)[:, None], axis=1)
    return np.where(largest < 0.0, -rows, rows)


def length_unit(model: Model) -> float:
    """The length that counts as one radian: a typical link's."""
    return float(np.median(model.link_length)) if model.link_length.size else 1.0


def sliding_joints(model: Model) -> Bool[np.ndarray, " j"]:
    """Which joints slide."""
    slides = np.zeros(len(model.joint_names), dtype=bool)
    moved = model.joint >= 0
    slides[model.joint[moved]] = model.prismatic[moved]
    return slides
