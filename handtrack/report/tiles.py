"""Track and evaluation in; the figures at the top of the report out."""

import html
import math

import numpy as np

from ..evaluate import Evaluation
from ..track import Track
from .figures import Joints, bound_ratio, small_number

_DEGREE = "\N{DEGREE SIGN}"
_NBSP = "\N{NO-BREAK SPACE}"


def summary_tiles(track: Track, joints: Joints, evaluation: Evaluation | None, views: int = 1) -> list[str]:
    """All tiles in reading order: how much was tracked, how well, how sure, how fast."""
    errors = [] if evaluation is None else _evaluation_tiles(evaluation, views)
    return [*_status_tiles(track), *errors, *_certainty_tiles(track, joints), _time_tile(track)]


def _status_tiles(track: Track) -> list[str]:
    count = track.frame.size
    shares = [(status, float(np.mean(track.status == status))) for status in ("tracked", "uncertain", "lost")]
    others = ", ".join(f"{round(share * count)} {status}" for status, share in shares[1:] if share > 0)
    bar = "".join(
        f'<i style="flex:{share:.4f};background:var(--{status})"></i>' for status, share in shares if share > 0
    )
    return [
        _tile("Frames", f"{count}", f"over {float(track.time[-1] - track.time[0]):.2f}{_NBSP}s"),
        _tile("Tracked", _percent(shares[0][1]), f'{others or "every frame"}<span class="bar">{bar}</span>'),
    ]


def _certainty_tiles(track: Track, joints: Joints) -> list[str]:
    """What the tracker itself says: sigmas of the angles, and how well the outline fits."""
    measured = track.residual[np.isfinite(track.residual)]  # NaN in frames without edges
    value = f"{np.median(measured):.2f}{_NBSP}px" if measured.size else "none"
    residual = _tile("Residual", value, "median RMS of the edge points")
    sigma = joints.sigma[:, ~joints.prismatic]
    if not sigma.size:
        return [residual]
    note = f"largest {sigma.max():.2f}{_DEGREE}"
    return [_tile("Median sigma", f"{small_number(float(np.median(sigma)))}{_DEGREE}", note), residual]


def _time_tile(track: Track) -> str:
    milliseconds = 1000.0 * track.seconds
    usual = float(np.median(milliseconds))
    note = f"95{_NBSP}% below {np.percentile(milliseconds, 95):.2f}{_NBSP}ms"
    if milliseconds[0] > 3 * usual:  # it holds the compilation
        note += f", first {milliseconds[0]:.0f}{_NBSP}ms"
    return _tile("Time per frame", f"{usual:.2f}{_NBSP}ms", note)


def _evaluation_tiles(evaluation: Evaluation, views: int) -> list[str]:
    """What the truth adds: errors of angles and landmarks, and whether the sigmas are honest."""
    worst = evaluation.worst_joint
    scale, unit = (
        (1.0, _NBSP + html.escape(evaluation.units)) if evaluation.prismatic[worst] else (180.0 / np.pi, _DEGREE)
    )
    name = html.escape(evaluation.joint_names[worst])
    note = f"{name}, largest error {evaluation.largest[worst] * scale:.2f}{unit}"
    ratio = bound_ratio(evaluation, worst)
    note += "" if ratio is None else f", {ratio:.1f} times the Cram\N{LATIN SMALL LETTER E WITH ACUTE}r-Rao bound"
    tiles = [_tile("Worst-joint RMSE", f"{small_number(float(evaluation.rmse[worst]) * scale)}{unit}", note)]
    if math.isfinite(evaluation.landmark_px):
        note = f"largest {evaluation.landmark_max_px:.2f}{_NBSP}px" + (f", {views} views together" if views > 1 else "")
        tiles.append(_tile("Landmark error", f"{evaluation.landmark_px:.2f}{_NBSP}px", note))
    if math.isfinite(evaluation.nees_mean):
        # Per degree of freedom and rooted, NEES is the size of an error in sigmas, which is easier to judge.
        edges = [math.sqrt(edge / evaluation.nees_mean_dof) for edge in evaluation.nees_band]
        ratio = math.sqrt(evaluation.nees_mean / evaluation.nees_mean_dof)
        note = f"errors of {ratio:.2f} sigmas, 95{_NBSP}% band {edges[0]:.2f} to {edges[1]:.2f}"
        tiles.append(_tile(f"NEES, ideally {evaluation.nees_mean_dof:.3g}", f"{evaluation.nees_mean:.2f}", note))
    return tiles


def _tile(name: str, value: str, note: str) -> str:
    """One figure with its name above and a note below; `note` is HTML."""
    return f'<div class="tile"><span>{name}</span><b>{value}</b><small>{note}</small></div>'


def _percent(share: float) -> str:
    """Per cent, never rounded up to 100 or down to 0."""
    if share in (0.0, 1.0):
        return f"{100 * share:.0f}{_NBSP}%"
    return f"{min(max(100 * share, 0.1), 99.9):.1f}{_NBSP}%"
