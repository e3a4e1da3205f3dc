"""Tracks of the hand of Table 6.2 and their truths in, the hand thesis's words beside our figures out (section 6.2.2).

The fingers spread, then flex by degrees, the little one backwards and the index finger most; the thumb rests; the plane
of the hand is tilted by 45 degrees. The thesis prints plots (Figure 6.6) and no numbers, so its column holds its
statements: the fingers "are successfully tracked", the thumb converged to "a situation which doesn't correspond at all
to the ground-truth", and "from the camera point of view no problem is visible" (chapter 7).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..ambiguity import ambiguity
from ..ambiguity import lines as fold_lines
from ..evaluate import Evaluation
from ..kinematics import Model
from ..observability import THRESHOLD, observability
from ..observability_words import lines, named
from ..track import Track

FOLLOWS, ASTRAY = "follows the truth", "doesn't correspond at all"
_DEGREES = 180.0 / np.pi


@dataclass(frozen=True, slots=True, eq=False)
class FullHand:
    """Figures of one kind of run over several motions; angles in degrees.

    Attributes
    ----------
    views : int
        Cameras that saw the motions.
    joint_names, stated : tuple of str
        And what the thesis says of each joint.
    rmse, largest, sigma, covered : (j,)
        Medians over the motions of the RMSE and the median sigma; largest error of all; share of the errors within two
        sigmas.
    worst_rmse : (m,)
        Of each motion's worst joint of the fingers.
    thumb_rmse, thumb_covered : (m,), float
        The same of the thumb's, and the share of frames in which all its joints are within two sigmas.
    weakest : tuple of (str, float)
        Joints and weights of the weakest direction of the first motion.
    weakest_sigma : float
        Image-only standard deviation along it.
    findings : tuple of str
        Open directions and folds of the first motion.
    frame_ms : float
        Median computing time.
    """

    views: int
    joint_names: tuple[str, ...]
    stated: tuple[str, ...]
    rmse: Float[np.ndarray, " j"]
    largest: Float[np.ndarray, " j"]
    sigma: Float[np.ndarray, " j"]
    covered: Float[np.ndarray, " j"]
    worst_rmse: Float[np.ndarray, " m"]
    thumb_rmse: Float[np.ndarray, " m"]
    thumb_covered: float
    weakest: tuple[tuple[str, float], ...]
    weakest_sigma: float
    findings: tuple[str, ...]
    frame_ms: float


def full_hand(
    views: int,
    model: Model,
    tracks: Sequence[Track],
    truths: Sequence[Float[np.ndarray, "n j"]],
    evaluations: Sequence[Evaluation],
    threshold: float = THRESHOLD,
) -> FullHand:
    """Sum up the motions seen by `views` cameras.

    Parameters
    ----------
    tracks, truths, evaluations : sequences
        One for each motion; truths in radians, a row for each frame.
    threshold : float
        Image-only sigma from which on a direction is reported, radians.
    """
    thumb = np.array([name.startswith("thumb") for name in model.joint_names])
    rmse = np.stack([each.rmse for each in evaluations]) * _DEGREES
    error = np.stack([np.abs(track.q - truth) for track, truth in zip(tracks, truths, strict=True)])
    inside = error <= 2.0 * np.stack([track.sigma for track in tracks])
    seen = observability(tracks[0], model, threshold)
    return FullHand(
        views=views,
        joint_names=model.joint_names,
        stated=tuple(ASTRAY if is_thumb else FOLLOWS for is_thumb in thumb),
        rmse=np.median(rmse, axis=0),
        largest=error.max(axis=(0, 1)) * _DEGREES,
        sigma=np.median([np.median(track.sigma, axis=0) for track in tracks], axis=0) * _DEGREES,
        covered=inside.mean(axis=(0, 1)),
        worst_rmse=rmse[:, ~thumb].max(axis=1),
        thumb_rmse=rmse[:, thumb].max(axis=1),
        thumb_covered=float(inside[:, :, thumb].all(axis=2).mean()),
        weakest=named(seen, seen.weakest),
        weakest_sigma=float(seen.weakest_sigma * _DEGREES),
        findings=lines(seen) + fold_lines(ambiguity(tracks[0], model)),
        frame_ms=float(1000.0 * np.median(np.concatenate([track.seconds for track in tracks]))),
    )


def rows(results: Sequence[FullHand]) -> tuple[list[str], list[list[object]]]:
    """Header and rows of the table: for each joint the thesis's statement, then the figures of every kind of run."""
    header = ["joint", "thesis, chapter 7"]
    for result in results:
        views = "1 view" if result.views == 1 else f"{result.views} views"
        header += [f"{views}: RMSE", "max", "sigma", "in 2 s"]
    table: list[list[object]] = []
    for j, name in enumerate(results[0].joint_names):
        row: list[object] = [name, results[0].stated[j]]
        for result in results:
            figures = (result.rmse[j], result.largest[j], result.sigma[j])
            row += [*(f"{float(value):.2f}" for value in figures), f"{100.0 * result.covered[j]:.0f} %"]
        table.append(row)
    return header, table


def summary(result: FullHand) -> tuple[str, ...]:
    """What the table comes to, in sentences."""
    views = "one view" if result.views == 1 else f"{result.views} views"
    motions = result.worst_rmse.size
    fingers, thumb = float(np.median(result.worst_rmse)), float(np.median(result.thumb_rmse))
    weights = ", ".join(f"{name} {value:+.2f}" for name, value in result.weakest)
    return (
        f"{views}, {motions} motions, {result.frame_ms:.1f} ms a frame: worst joint's RMSE, median over the motions: "
        f"fingers {fingers:.2f} deg, thumb {thumb:.2f} deg",
        f"  all joints of the thumb within two sigmas in {100.0 * result.thumb_covered:.0f} % of the frames",
        f"  weakest direction of the first motion: {weights}; image-only sigma {result.weakest_sigma:.1f} deg",
        *(f"  {line}" for line in result.findings),
    )


def as_data(results: Sequence[FullHand]) -> dict[str, object]:
    """The figures as plain data, degrees."""
    return {
        "section": "6.2.2",
        "results": [
            {
                "views": result.views,
                "motions": int(result.worst_rmse.size),
                "fingers_worst_rmse_median_deg": round(float(np.median(result.worst_rmse)), 4),
                "thumb_worst_rmse_median_deg": round(float(np.median(result.thumb_rmse)), 4),
                "thumb_frames_covered": round(result.thumb_covered, 4),
                "weakest_direction": dict(result.weakest),
                "weakest_sigma_deg": round(result.weakest_sigma, 3),
                "findings": list(result.findings),
                "frame_ms": round(result.frame_ms, 2),
                "joints": [
                    {
                        "joint": name,
                        "thesis": result.stated[j],
                        "rmse_deg": round(float(result.rmse[j]), 4),
                        "largest_deg": round(float(result.largest[j]), 4),
                        "sigma_deg": round(float(result.sigma[j]), 4),
                        "coverage_2sigma": round(float(result.covered[j]), 4),
                    }
                    for j, name in enumerate(result.joint_names)
                ],
            }
            for result in results
        ],
    }
