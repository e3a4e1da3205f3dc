"""Track and evaluation in; the figures at the top of the report out."""

import html
import math

import numpy as np

from ..evaluate import Evaluation
from ..track import Track
from .figures import Joints

_DEGREE = "\N{DEGREE SIGN}"


def track_tiles(track: Track, joints: Joints) -> list[str]:
    """What is known without a truth: frames, status, sigma, residual, time."""
    count = track.frame.size
    seconds = float(track.time[-1] - track.time[0])
    shares = [(status, float(np.mean(track.status == status))) for status in ("tracked", "uncertain", "lost")]
    milliseconds = 1000.0 * track.seconds
    others = ", ".join(f"{int(round(share * count))} {status}" for status, share in shares[1:] if share > 0)
    bar = "".join(f'<i style="flex:{share:.4f};background:var(--{status})"></i>' for status, share in shares if share > 0)
    tiles = [
        tile("Frames", f"{count}", f"{seconds:.2f} s"),
        tile(
            "Tracked",
            _percent(shares[0][1]),
            (others or "every frame") + f'<span class="bar">{bar}</span>',
        ),
    ]
    angles = ~joints.prismatic
    if angles.any():
        sigma = joints.sigma[:, angles]
        tiles.append(tile("Median sigma", f"{np.median(sigma):.2f}{_DEGREE}", f"largest {sigma.max():.2f}{_DEGREE}"))
    tiles.append(tile("Residual", f"{np.median(track.residual):.2f} px", "median RMS of edge points"))
    first = f", first frame {milliseconds[0]:.0f} ms" if count > 1 and milliseconds[0] > 3 * np.median(milliseconds) else ""
    tiles.append(
        tile("Time per frame", f"{np.median(milliseconds):.2f} ms", f"95 % below {np.percentile(milliseconds, 95):.2f} ms{first}")
    )
    return tiles


def evaluation_tiles(evaluation: Evaluation) -> list[str]:
    """What the truth adds: errors of angles and landmarks, and whether the sigmas are honest."""
    worst = evaluation.worst_joint
    slides = bool(evaluation.prismatic[worst])
    scale, unit = (1.0, f" {evaluation.units}") if slides else (180.0 / np.pi, _DEGREE)
    name = html.escape(evaluation.joint_names[worst])
    tiles = [
        tile(
            "Worst-joint RMSE",
            f"{evaluation.rmse[worst] * scale:.2f}{html.escape(unit)}",
            f"{name}, largest error {evaluation.largest[worst] * scale:.2f}{html.escape(unit)}",
        )
    ]
    if math.isfinite(evaluation.landmark_px):
        tiles.append(
            tile("Landmark error", f"{evaluation.landmark_px:.2f} px", f"largest {evaluation.landmark_max_px:.2f} px")
        )
    if math.isfinite(evaluation.nees_mean):
        low, high = evaluation.nees_band
        verdict = "sigmas consistent"
        if evaluation.nees_mean > high:
            verdict = "sigmas too small"
        elif evaluation.nees_mean < low:
            verdict = "sigmas cautious"
        tiles.append(
            tile("NEES", f"{evaluation.nees_mean:.2f}", f"{verdict}; 95 % band {low:.2f} to {high:.2f}")
        )
    return tiles


def tile(name: str, value: str, note: str) -> str:
    """One figure with its name above and a note below; `note` is HTML."""
    return f'<div class="tile"><span>{name}</span><b>{value}</b><small>{note}</small></div>'


def _percent(share: float) -> str:
    """Per cent, never rounded up to 100 or down to 0."""
    digits = 0 if share in (0.0, 1.0) else 1
    return f"{min(100 * share, 99.9) if share < 1 else 100:.{digits}f} %"
