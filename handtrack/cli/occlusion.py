"""A number of seeded motions in, the figures of tracking two fingers through an occlusion out (hand thesis, 6.1).

The index finger crosses in front of the middle finger, 60 frames, tilted by 45 degrees (`synth.scenes`). For each
motion: the worst joint's RMSE, the frames lost and the mean NEES. Over all, the NEES of frame k of N independent
motions adds up to a chi-square variable with `sum(dof)` degrees of freedom if the sigmas are right, so its mean lies in

    [chi2_0.025(sum dof), chi2_0.975(sum dof)] / N        in 95 % of the frames k.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import chi2

from synth.scenes import Scene, images, two_finger_crossing, two_finger_hard

from ..evaluate import Evaluation, evaluate
from ..sequences import Truth
from ..settings import Settings
from ..tracker import track

Variant = Literal["crossing", "hard"]


@dataclass(frozen=True, slots=True, eq=False)
class Occlusion:
    """What N motions gave.

    Attributes
    ----------
    seed : (n,)
        Of each motion.
    worst_rmse : (n,)
        RMSE of each motion's worst joint, radians.
    worst_joint : tuple of str
    lost : (n,)
        Frames that the tracker calls lost.
    strayed : (n,)
        Whether the last frame's worst joint is off by more than 15 degrees, whatever the tracker says.
    nees, nees_dof : (n,)
        Mean over the frames.
    frame_nees : (m,)
        Mean over the motions, for each frame.
    band : (float, float)
        Of `frame_nees`, 95 %.
    frame_ms : float
        Median computing time of a frame, milliseconds.
    """

    seed: Int[np.ndarray, " n"]
    worst_rmse: Float[np.ndarray, " n"]
    worst_joint: tuple[str, ...]
    lost: Int[np.ndarray, " n"]
    strayed: np.ndarray
    nees: Float[np.ndarray, " n"]
    nees_dof: Float[np.ndarray, " n"]
    frame_nees: Float[np.ndarray, " m"]
    band: tuple[float, float]
    frame_ms: float


_STRAYED = np.radians(15.0)


def make_scene(seed: int, variant: Variant, frames: int) -> Scene:
    """Motion number `seed`."""
    return two_finger_hard(seed, frames=frames) if variant == "hard" else two_finger_crossing(seed, frames=frames)


def two_finger_occlusion(
    motions: int,
    variant: Variant,
    settings: Settings,
    first_seed: int = 0,
    frames: int = 60,
    progress: Callable[[int], None] | None = None,
) -> Occlusion:
    """Render, track and evaluate `motions` motions.

    Parameters
    ----------
    progress : callable
        Called with the number of motions done.
    """
    seeds = np.arange(first_seed, first_seed + motions)
    results: list[Evaluation] = []
    last, lost, times = np.zeros(motions), np.zeros(motions, dtype=int), []
    for i, seed in enumerate(seeds):
        scene = make_scene(int(seed), variant, frames)
        pictures = [np.asarray(image, dtype=np.float32) for image in images(scene)]
        found = track(pictures, scene.model, scene.camera, scene.start, scene.fps, settings)
        results.append(evaluate(found, Truth(np.arange(frames), scene.truth), scene.model, scene.camera))
        last[i] = np.abs(found.q[-1] - scene.truth[-1]).max()
        lost[i] = np.sum(found.status == "lost")
        times.append(found.seconds)
        if progress is not None:
            progress(i + 1)
    nees, dof = np.stack([result.nees for result in results]), np.stack([result.nees_dof for result in results])
    low, high = chi2.ppf([0.025, 0.975], float(np.median(dof.sum(axis=0)))) / motions
    return Occlusion(
        seed=seeds,
        worst_rmse=np.array([result.rmse[result.worst_joint] for result in results]),
        worst_joint=tuple(result.joint_names[result.worst_joint] for result in results),
        lost=lost,
        strayed=last > _STRAYED,
        nees=nees.mean(axis=1),
        nees_dof=dof.mean(axis=1),
        frame_nees=nees.mean(axis=0),
        band=(float(low), float(high)),
        frame_ms=float(1000.0 * np.median(np.concatenate(times))),
    )


def as_data(result: Occlusion, variant: Variant, settings: Settings) -> dict[str, object]:
    """The figures as plain data; angles in degrees."""
    worst = np.degrees(result.worst_rmse)
    inside = (result.frame_nees >= result.band[0]) & (result.frame_nees <= result.band[1])
    motions = [
        {
            "seed": int(result.seed[i]),
            "worst_joint": result.worst_joint[i],
            "worst_rmse_deg": float(worst[i]),
            "lost_frames": int(result.lost[i]),
            "strayed": bool(result.strayed[i]),
            "nees_mean": float(result.nees[i]),
        }
        for i in range(result.seed.size)
    ]
    return {
        "variant": variant,
        "residuals": settings.residuals,
        "motions": motions,
        "worst_rmse_median_deg": float(np.median(worst)),
        "worst_rmse_largest_deg": float(worst.max()),
        "motions_lost": int(np.sum((result.lost > 0) | result.strayed)),
        "nees_mean": float(result.nees.mean()),
        "nees_dof": float(result.nees_dof.mean()),
        "nees_band_95": list(result.band),
        "nees_frames_in_band": float(inside.mean()),
        "median_frame_ms": result.frame_ms,
    }
