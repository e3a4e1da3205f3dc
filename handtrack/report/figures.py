"""Track and truth in; the charts of the report out, with the values that the page shows under the pointer."""

import html
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ..bound import usual_sigma
from ..evaluate import Evaluation, joint_error, prismatic_joints
from ..kinematics import Model
from ..sequences import Truth
from ..track import Track
from .fingers import Finger, fingers_of, short_name
from .plots import Frame, Series, chart, mirrored_ticks, padded_limits

_APART = 1.0  # degrees or model units beyond which a rival has a line of its own


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """A chart's HTML, and what the script needs to read values from it."""

    name: str
    html: str
    unit: str
    series: tuple[Series, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Joints:
    """Joint values as the page shows them: degrees, or model units for prismatic joints; truth has the track's rows.

    `rival` is another pose that the images could not tell from the tracked one, NaN for the joints that are the same.
    """

    model: Model
    fingers: tuple[Finger, ...]
    prismatic: Bool[np.ndarray, " j"]
    values: Float[np.ndarray, "n j"]
    sigma: Float[np.ndarray, "n j"]
    truth: Float[np.ndarray, "n j"] | None
    error: Float[np.ndarray, "n j"] | None
    rival: Float[np.ndarray, "n j"] | None = None

    def unit(self, joint: int) -> str:
        """Unit of a joint with the space that belongs before it."""
        return f" {self.model.units}" if self.prismatic[joint] else "\N{DEGREE SIGN}"


def joints_of(track: Track, model: Model, truth: Truth | None) -> Joints:
    """Joint values, sigmas, truth and errors in the units of files; truth is NaN in the frames it does not cover."""
    prismatic = prismatic_joints(model)
    scale = np.where(prismatic, 1.0, 180.0 / np.pi)
    true = error = None
    if truth is not None:
        _, rows, truth_rows = np.intersect1d(track.frame, truth.frame, return_indices=True)
        true = np.full(track.q.shape, np.nan)
        true[rows] = truth.q[truth_rows]
        error = joint_error(track.q, true, prismatic) * scale
        true = true * scale
    rival = None
    if track.rival is not None:
        apart = np.abs(track.rival - track.q) * scale > _APART
        rival = np.where(apart, track.rival, np.nan) * scale
    return Joints(model, fingers_of(model), prismatic, track.q * scale, track.sigma * scale, true, error, rival)


def finger_section(
    number: int, joints: Joints, frame: Frame, evaluation: Evaluation | None
) -> tuple[str, list[Figure]]:
    """One finger: its angles, and below them the error (or the sigma) of each joint."""
    finger = joints.fingers[number]
    figures = []
    rows = []
    for slides in (False, True):  # degrees and millimetres do not share an axis
        chosen = [joint for joint in finger.joints if bool(joints.prismatic[joint]) == slides]
        if chosen:
            figures.append(_angles(f"q{number}{'d' if slides else ''}", joints, finger, chosen, frame))
    for place, joint in enumerate(finger.joints):
        last = place == len(finger.joints) - 1
        figure = _error(f"e{joint}", joints, finger, place, joint, frame, last)
        figures.append(figure)
        rows.append(_error_row(figure, joints, joint, finger, place, evaluation))
    angles = "".join(figure.html for figure in figures if figure.name.startswith("q"))
    what = "Error and its 2-sigma band" if joints.error is not None else "Two sigmas"
    markup = (
        f'<section class="card finger"><h3><i class="chip" style="background:{finger.colour}"></i>'
        f'{html.escape(finger.name)}</h3>{angles}<h4>{what}</h4><div class="rows">{"".join(rows)}</div></section>'
    )
    return markup, figures


def _angles(name: str, joints: Joints, finger: Finger, chosen: Sequence[int], frame: Frame) -> Figure:
    series = tuple(
        Series(
            short_name(joints.model.joint_names[joint], finger),
            f"c{finger.joints.index(joint) % 6}",
            joints.values[:, joint],
            joints.sigma[:, joint],
            None if joints.truth is None else joints.truth[:, joint],
            None if joints.rival is None else joints.rival[:, joint],
        )
        for joint in chosen
    )
    shown = [item.values for item in series] + [item.truth for item in series if item.truth is not None]
    shown += [item.rival for item in series if item.rival is not None]
    limits = padded_limits(*shown, least=4.0)
    unit = joints.unit(chosen[0])
    return Figure(name, chart(name, frame, series, limits, unit, kind="tall", ticks=5, labels=True), unit, series)


def _error(name: str, joints: Joints, finger: Finger, place: int, joint: int, frame: Frame, last: bool) -> Figure:
    """Error of a joint inside a band of two sigmas round zero; without truth, the band alone."""
    label = short_name(joints.model.joint_names[joint], finger)
    style = f"c{place % 6}"
    sigma = joints.sigma[:, joint]
    error = None if joints.error is None else joints.error[:, joint]
    # A lost stretch with its huge sigma must not flatten everything else: scale by the usual sigma and the errors.
    usual = 3.0 * float(np.median(sigma))
    largest = float(np.nanmax(np.abs(error))) if error is not None and np.isfinite(error).any() else 0.0
    reach = 1.08 * max(usual, largest, 1e-3)
    band = Series(label, style, np.zeros(sigma.size), sigma)
    drawn = [band] if error is None else [band, Series(label, style, error)]
    limits, marks = (-reach, reach), mirrored_ticks(reach)
    markup = chart(name, frame, drawn, limits, joints.unit(joint), kind="low", marks=marks, time_axis=last)
    series = Series(label, style, np.full(sigma.size, np.nan) if error is None else error, sigma)
    return Figure(name, markup, joints.unit(joint), (series,))


def _error_row(
    figure: Figure, joints: Joints, joint: int, finger: Finger, place: int, evaluation: Evaluation | None
) -> str:
    name = html.escape(short_name(joints.model.joint_names[joint], finger))
    unit = html.escape(joints.unit(joint))
    facts = f"sigma {small_number(float(np.median(joints.sigma[:, joint])))}{unit}"
    if evaluation is not None and np.isfinite(evaluation.rmse[joint]):
        rmse = float(evaluation.rmse[joint]) * (1.0 if joints.prismatic[joint] else 180.0 / np.pi)
        inside = 100 * evaluation.coverage_2sigma[joint]
        facts = f"RMSE {small_number(rmse)}{unit}<br>{inside:.0f}\N{NO-BREAK SPACE}% in 2 sigmas"
        ratio = bound_ratio(evaluation, joint)
        facts += "" if ratio is None else f"<br>{ratio:.1f} \N{MULTIPLICATION SIGN} bound"
    label = f'<b class="c{place % 6}">{name}</b>'
    return f'<div class="row">{figure.html}<span class="facts">{label} {facts}</span></div>'


def bound_ratio(evaluation: Evaluation, joint: int) -> float | None:
    """RMSE of a joint over its usual Cramer-Rao bound; None where there is none, or the images say nothing of it."""
    if evaluation.bounds is None:
        return None
    least = float(usual_sigma(evaluation.bounds)[joint])
    return float(evaluation.rmse[joint]) / least if 0.0 < least < np.inf else None


def small_number(value: float) -> str:
    """Two decimals, three below a tenth."""
    return f"{value:.2f}" if value >= 0.0995 else f"{value:.3f}"


def quality_figures(track: Track, frame: Frame) -> list[Figure]:
    """Fit, evidence and time of each frame."""
    milliseconds = 1000.0 * track.seconds
    usual = float(np.percentile(milliseconds, 98)) if milliseconds.size else 1.0
    table = (
        ("residual", " px", track.residual, padded_limits(track.residual, least=0.2, zero=True)),
        ("edges", "", track.edges.astype(float), padded_limits(track.edges.astype(float), least=4.0, zero=True)),
        ("confidence", "", track.confidence, (0.0, 1.05)),
        ("time", " ms", milliseconds, (0.0, max(1.5 * usual, 1e-3))),
    )
    figures = []
    for name, unit, values, limits in table:
        series = (Series(name, "neutral", values),)
        if name == "edges" and track.view_edges is not None and track.view_edges.shape[1] > 1:
            each = track.view_edges.T.astype(float)
            series = (*series, *(Series(f"view {i}", f"c{i % 6}", of_view) for i, of_view in enumerate(each)))
        figures.append(Figure(name, chart(name, frame, series, limits, unit, kind="medium", ticks=3), unit, series))
    return figures


def visibility_rows(
    visible: Float[np.ndarray, "n l"], joints: Joints, frame: Frame, prefix: str = "v"
) -> tuple[str, list[Figure]]:
    """Visible share of each link over time, a filled curve for each; names of the charts begin with the prefix."""
    rows, figures = [], []
    count = visible.shape[1]
    for finger_number, finger in enumerate(joints.fingers):
        for place, link in enumerate(finger.links):
            name = f"{prefix}{link}"
            series = (Series(f"{finger.name} {place + 1}", f"f{finger_number % 8}", 100.0 * visible[:, link]),)
            last = len(figures) == count - 1
            markup = chart(name, frame, series, (0.0, 100.0), "", kind="strip", ticks=1, filled=True, time_axis=last)
            figures.append(Figure(name, markup, " %", series))
            label = f"{html.escape(finger.name)} {place + 1}"
            share = f"{100 * visible[:, link].mean():.0f}\N{NO-BREAK SPACE}%"
            facts = f'<span class="facts"><b>{label}</b> {share}</span>'
            rows.append(f'<div class="row">{markup}{facts}</div>')
    return f'<div class="rows">{"".join(rows)}</div>', figures
