"""Track and truth in; errors, landmark distances and the honesty of the sigmas out.

With `e = q_estimated - q_true` of one frame (angles wrapped to +-180 degrees) and `C` its stated covariance:

    RMSE   = sqrt(mean e_j^2)              for each joint
    NEES   = e^T C^+ e                     for each frame; chi-square with rank(C) degrees of freedom if C is right
    cover  = share of |e_j| <= k sigma_j   0.683 for k = 1 and 0.954 for k = 2 if C is right and e is normal

`C^+` is the pseudo-inverse: joints that are coupled make C singular, and errors can only lie in its range. The
normalised estimation error squared (NEES) and its band are the consistency test of Bar-Shalom, Li and Kirubarajan,
Estimation with Applications to Tracking and Navigation (2001), section 5.4. Where the images are at hand, every RMSE
is also given as a ratio to the Cramer-Rao bound (`bound`).
"""

import json
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from .bound import Bounds, usual_sigma
from .camera import Camera, project
from .errors import InputError
from .kinematics import Model, forward, link_ends, point_jacobian
from .sequences import Truth
from .track import Track

_RANK_TOLERANCE = 1e-9  # eigenvalues of a correlation matrix below this are couplings, not information


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """How far a track is from the truth. Angles in radians (model units for prismatic joints).

    Attributes
    ----------
    joint_names, prismatic : (j,)
        Joints in the model's order, and which of them slide.
    units : str
        The model's unit of length, the unit of prismatic joints.
    frames, compared : int
        Frames in the track, and how many of them have a truth.
    rmse, bias, largest : (j,)
        Root mean square, mean and largest absolute error; NaN for a joint without truth.
    worst_joint : int
        Index of the largest RMSE, among the revolute joints where there is one.
    landmark_px, landmark_median_px, landmark_max_px : float
        Distances in pixels of the projected joint origins and tips that can move; NaN if there is none.
    share_tracked, share_uncertain, share_lost : float
        Shares of all frames of the track.
    nees, nees_dof : (n,)
        For each compared frame, and its degrees of freedom.
    nees_mean, nees_mean_dof : float
        Averages over the frames with at least one degree of freedom.
    nees_band : (float, float)
        95 % band of `nees_mean` for independent frames. Errors of neighbouring frames are related, so the band of one
        sequence is too narrow; over many sequences it is exact for one frame of each.
    coverage_1sigma, coverage_2sigma : (j,)
        Share of frames whose error is within one and two sigmas; NaN for a joint without truth.
    bounds : Bounds or None
        Cramer-Rao bounds, where the images were at hand.
    """

    joint_names: tuple[str, ...]
    prismatic: Bool[np.ndarray, " j"]
    units: str
    frames: int
    compared: int
    rmse: Float[np.ndarray, " j"]
    bias: Float[np.ndarray, " j"]
    largest: Float[np.ndarray, " j"]
    worst_joint: int
    landmark_px: float
    landmark_median_px: float
    landmark_max_px: float
    share_tracked: float
    share_uncertain: float
    share_lost: float
    nees: Float[np.ndarray, " n"]
    nees_dof: Int[np.ndarray, " n"]
    nees_mean: float
    nees_mean_dof: float
    nees_band: tuple[float, float]
    coverage_1sigma: Float[np.ndarray, " j"]
    coverage_2sigma: Float[np.ndarray, " j"]
    bounds: Bounds | None = None


def evaluate(track: Track, truth: Truth, model: Model, camera: Camera) -> Evaluation:
    """Compare a track with the truth, frame by frame.

    Parameters
    ----------
    truth : Truth
        May hold fewer frames than the track, and NaN for joints it does not know.

    Raises
    ------
    InputError
        If the two have no frame in common, or the truth names none of the joints in those frames.
    ValueError
        If track, truth and model do not have the same joints.
    """
    count = len(model.joint_names)
    if track.joint_names != model.joint_names:
        raise ValueError(f"track: has the joints {track.joint_names}, the model has {model.joint_names}")
    if truth.q.shape[1] != count:
        raise ValueError(f"truth: has {truth.q.shape[1]} columns of joints, the model has {count} joints")
    _, rows, truth_rows = np.intersect1d(track.frame, truth.frame, return_indices=True)
    if not rows.size:
        raise InputError("truth: no frame in common with the track; the same frame numbers were wanted in both")
    true = truth.q[truth_rows]
    if not np.isfinite(true).any():
        raise InputError("truth: no joint of the model has a value; at least one was wanted")
    prismatic = prismatic_joints(model)
    error = joint_error(track.q[rows], true, prismatic)
    known = np.isfinite(error)
    rmse = np.sqrt(_column_mean(error**2, known))
    distance = landmark_distances(model, camera, track.q[rows], true)
    distance = distance[np.isfinite(distance)]
    value, dof = nees(error, track.covariance[rows])
    mean, mean_dof, band = _average_nees(value, dof)
    inside = [np.abs(error) <= k * track.sigma[rows] for k in (1, 2)]
    return Evaluation(
        joint_names=model.joint_names,
        prismatic=prismatic,
        units=model.units,
        frames=track.frame.size,
        compared=rows.size,
        rmse=rmse,
        bias=_column_mean(error, known),
        largest=np.where(known.any(axis=0), np.max(np.abs(error), axis=0, where=known, initial=0.0), np.nan),
        worst_joint=_worst(rmse, prismatic),
        landmark_px=float(distance.mean()) if distance.size else math.nan,
        landmark_median_px=float(np.median(distance)) if distance.size else math.nan,
        landmark_max_px=float(distance.max()) if distance.size else math.nan,
        share_tracked=float(np.mean(track.status == "tracked")),
        share_uncertain=float(np.mean(track.status == "uncertain")),
        share_lost=float(np.mean(track.status == "lost")),
        nees=value,
        nees_dof=dof,
        nees_mean=mean,
        nees_mean_dof=mean_dof,
        nees_band=band,
        coverage_1sigma=_column_mean(inside[0], known),
        coverage_2sigma=_column_mean(inside[1], known),
    )


def prismatic_joints(model: Model) -> Bool[np.ndarray, " j"]:
    """Which joints slide, in the order of `model.joint_names`."""
    slides = np.zeros(len(model.joint_names), dtype=bool)
    slides[model.joint[model.joint >= 0]] = model.prismatic[model.joint >= 0]
    return slides


def joint_error(
    estimated: Float[np.ndarray, "n j"], true: Float[np.ndarray, "n j"], prismatic: Bool[np.ndarray, " j"]
) -> Float[np.ndarray, "n j"]:
    """Estimated minus true; revolute joints wrapped to [-pi, pi), NaN where there is no truth.

    >>> joint_error(np.array([[3.0]]), np.array([[-3.0]]), np.array([False])).round(4).tolist()
    [[-0.2832]]
    """
    error = estimated - true
    return np.where(prismatic, error, (error + np.pi) % (2 * np.pi) - np.pi)


def nees(
    error: Float[np.ndarray, "n j"], covariance: Float[np.ndarray, "n j j"]
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Normalised estimation error squared `e^T C^+ e` of each frame, and its degrees of freedom.

    Parameters
    ----------
    error : (n, j)
        NaN where a joint has no truth: such a joint is left out of its frame.
    covariance : (n, j, j)
        Symmetric, positive semi-definite; units of the error squared.

    Returns
    -------
    value : (n,)
        Chi-square distributed with `dof` degrees of freedom if the errors are normal with this covariance.
    dof : (n,)
        Rank of the covariance of the joints with truth.

    >>> value, dof = nees(np.array([[2.0, np.nan]]), 4.0 * np.eye(2)[None])
    >>> value.tolist(), dof.tolist()
    ([1.0], [1])
    """
    deviation = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    used = np.isfinite(error) & (deviation > 0)
    # Scaled to a correlation matrix, so that one tolerance serves radians and millimetres.
    scale = np.where(used, 1.0 / np.where(used, deviation, 1.0), 0.0)
    correlation = scale[:, :, None] * covariance * scale[:, None, :]
    scaled = np.where(used, error, 0.0) * scale
    eigenvalue, vector = np.linalg.eigh(correlation)
    keep = eigenvalue > _RANK_TOLERANCE
    along = (np.swapaxes(vector, 1, 2) @ scaled[:, :, None])[:, :, 0]
    value = np.sum(np.where(keep, along**2 / np.where(keep, eigenvalue, 1.0), 0.0), axis=1)
    return value, keep.sum(axis=1)


def landmark_distances(
    model: Model, camera: Camera, estimated: Float[np.ndarray, "n j"], true: Float[np.ndarray, "n j"]
) -> Float[np.ndarray, "n m"]:
    """Image distances between estimated and true landmarks, pixels.

    Landmarks are the origins of the link frames and the tips of the chains. Those that no joint can move are left out:
    they would only thin the mean. NaN where the truth lacks a joint the landmark depends on, or behind the camera.
    """
    used = landmark_joints(model)
    moving = used.any(axis=1)
    missing = (~np.isfinite(true)).astype(int) @ used[moving].T.astype(int) > 0
    filled = np.where(np.isfinite(true), true, estimated)
    here, there = (project(camera, landmarks(model, q)[:, moving]) for q in (estimated, filled))
    return np.where(missing, np.nan, np.linalg.norm(here - there, axis=-1))


def landmarks(model: Model, q: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n m 3"]:
    """Origins of all link frames, then the tips of the chains, in the base frame."""
    base, tip = link_ends(model, forward(model, q))
    return np.concatenate([base, tip[:, model.link_is_tip]], axis=1)


def landmark_joints(model: Model) -> Bool[np.ndarray, "m j"]:
    """Which joints move which landmark, read off the Jacobian at a pose in general position.

    The tree alone does not tell: a frame's own rotation moves its tip but not its origin.
    """
    q = 0.1 + 0.618 * np.arange(len(model.joint_names)) % 1.0  # unequal angles: no two axes fall together by accident
    frames = forward(model, q)
    owner = np.concatenate([model.link_frame, model.link_frame[model.link_is_tip]])
    jacobian = point_jacobian(model, frames, owner, landmarks(model, q[None])[0])
    return np.abs(jacobian).max(axis=1) > 1e-9


def as_json(evaluation: Evaluation) -> str:
    """The evaluation as JSON text: degrees (model units for prismatic joints), null where there is no value."""
    to_file = np.where(evaluation.prismatic, 1.0, 180.0 / np.pi)
    names = evaluation.joint_names
    columns = {
        "rmse": evaluation.rmse * to_file,
        "bias": evaluation.bias * to_file,
        "largest": evaluation.largest * to_file,
        "coverage_1sigma": evaluation.coverage_1sigma,
        "coverage_2sigma": evaluation.coverage_2sigma,
    }
    joints = [
        {"joint": name, "unit": evaluation.units if slides else "deg"}
        | {column: _number(values[i]) for column, values in columns.items()}
        | _bound_entry(evaluation, i, to_file[i])
        for i, (name, slides) in enumerate(zip(names, evaluation.prismatic, strict=True))
    ]
    document = {
        "frames": evaluation.frames,
        "compared": evaluation.compared,
        "worst_joint": names[evaluation.worst_joint],
        "worst_rmse": _number(evaluation.rmse[evaluation.worst_joint] * to_file[evaluation.worst_joint]),
        "landmark_px": _number(evaluation.landmark_px),
        "landmark_median_px": _number(evaluation.landmark_median_px),
        "landmark_max_px": _number(evaluation.landmark_max_px),
        "share_tracked": _number(evaluation.share_tracked),
        "share_uncertain": _number(evaluation.share_uncertain),
        "share_lost": _number(evaluation.share_lost),
        "nees_mean": _number(evaluation.nees_mean),
        "nees_mean_dof": _number(evaluation.nees_mean_dof),
        "nees_band": [_number(edge) for edge in evaluation.nees_band],
        "nees": [_number(value) for value in evaluation.nees],
        "nees_dof": evaluation.nees_dof.tolist(),
        "bound": _bound_document(evaluation.bounds),
        "joints": joints,
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _bound_entry(evaluation: Evaluation, joint: int, to_file: float) -> dict[str, object]:
    """Bound of a joint, the ratio of its RMSE to it, and the share of frames blind to it; none without bounds."""
    if evaluation.bounds is None:
        return {}
    bound = float(usual_sigma(evaluation.bounds)[joint])
    share = float(np.isinf(evaluation.bounds.sigma[:, joint]).mean())
    ratio = float(evaluation.rmse[joint]) / bound if bound > 0.0 and math.isfinite(bound) else math.nan
    return {"bound": _number(bound * to_file), "rmse_to_bound": _number(ratio), "unseen_frames": _number(share)}


def _bound_document(bounds: Bounds | None) -> dict[str, object] | None:
    if bounds is None:
        return None
    return {
        "frames": bounds.frame.tolist(),
        "noise": [_number(noise) for noise in np.median(bounds.noise, axis=0)],
        "known_light": bounds.known_light,
    }


def as_text(evaluation: Evaluation) -> str:
    """The evaluation as a plain table of text; degrees (model units for prismatic joints)."""
    width = max(len("joint"), *(len(name) for name in evaluation.joint_names))
    header = f"{'joint':<{width}}  {'rmse':>8}  {'bias':>8}  {'largest':>8}  {'in 1 s':>6}  {'in 2 s':>6}"
    more = "" if evaluation.bounds is None else f"  {'bound':>8}  {'ratio':>6}"
    lines = [f"{header}{more}  unit"]
    for i, name in enumerate(evaluation.joint_names):
        slides = bool(evaluation.prismatic[i])
        scale, unit = (1.0, evaluation.units) if slides else (180.0 / np.pi, "deg")
        errors = [values[i] * scale for values in (evaluation.rmse, evaluation.bias, evaluation.largest)]
        shares = [evaluation.coverage_1sigma[i], evaluation.coverage_2sigma[i]]
        cells = [_cell(x, 8, 3) for x in errors] + [_cell(100 * x, 5, 0, "%") for x in shares]
        lines.append(f"{name:<{width}}  " + "  ".join(cells + _bound_cells(evaluation, i, scale)) + f"  {unit}")
    low, high = evaluation.nees_band
    return "\n".join(
        [
            *lines,
            "",
            f"worst joint   {evaluation.joint_names[evaluation.worst_joint]}",
            f"landmarks     mean {_cell(evaluation.landmark_px)} px, median {_cell(evaluation.landmark_median_px)} px, "
            f"largest {_cell(evaluation.landmark_max_px)} px",
            f"frames        {evaluation.frames}, with truth {evaluation.compared}: "
            f"tracked {100 * evaluation.share_tracked:.1f} %, uncertain {100 * evaluation.share_uncertain:.1f} %, "
            f"lost {100 * evaluation.share_lost:.1f} %",
            f"NEES          mean {_cell(evaluation.nees_mean)} at {_cell(evaluation.nees_mean_dof, digits=1)} degrees "
            f"of freedom, 95 % band {_cell(low)} to {_cell(high)}",
            *_bound_lines(evaluation.bounds),
            "",
        ]
    )


def _bound_cells(evaluation: Evaluation, joint: int, scale: float) -> list[str]:
    if evaluation.bounds is None:
        return []
    bound = float(usual_sigma(evaluation.bounds)[joint]) * scale
    if math.isinf(bound):
        return ["  unseen", _cell(math.nan, 6, 1)]
    return [f"{bound:8.4f}", _cell(evaluation.rmse[joint] * scale / bound if bound > 0.0 else math.nan, 6, 1)]


def _bound_lines(bounds: Bounds | None) -> list[str]:
    if bounds is None:
        return []
    noise = ", ".join(f"{value:.2f}" for value in np.median(bounds.noise, axis=0))
    light = "known" if bounds.known_light else "unknown"
    return [f"bound         Cramer-Rao, median of {bounds.frame.size} frames; noise {noise} grey levels, light {light}"]


def _column_mean(values: np.ndarray, known: Bool[np.ndarray, "n j"]) -> Float[np.ndarray, " j"]:
    """Mean of each column over its known rows, NaN where there is none."""
    count = known.sum(axis=0)
    total = np.sum(values, axis=0, where=known, dtype=float)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _worst(rmse: Float[np.ndarray, " j"], prismatic: Bool[np.ndarray, " j"]) -> int:
    """Index of the largest RMSE; lengths are compared with each other only where no angle has a truth."""
    angles = np.where(prismatic | ~np.isfinite(rmse), -1.0, rmse)
    return int(np.argmax(angles)) if angles.max() >= 0 else int(np.nanargmax(rmse))


def _average_nees(
    value: Float[np.ndarray, " n"], dof: Int[np.ndarray, " n"]
) -> tuple[float, float, tuple[float, float]]:
    """Mean over the frames that have a degree of freedom, its mean dof, and its 95 % band."""
    count = int(np.count_nonzero(dof))
    if not count:
        return math.nan, math.nan, (math.nan, math.nan)
    total = int(dof.sum())
    low, high = chi2.ppf([0.025, 0.975], total) / count
    return float(value[dof > 0].mean()), total / count, (float(low), float(high))


def _number(value: float) -> float | None:
    """A finite number with nine significant digits, or None: JSON has no NaN."""
    return float(f"{value:.9g}") if math.isfinite(value) else None


def _cell(value: float, width: int = 0, digits: int = 3, suffix: str = "") -> str:
    """A number right-aligned in a table cell, a dash where there is none."""
    return f"{value:{width}.{digits}f}{suffix}" if math.isfinite(value) else "-".rjust(width + len(suffix))
