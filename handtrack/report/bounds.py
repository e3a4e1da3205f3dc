"""A track, the truth and the Cramer-Rao bounds in; error, sigma and bound over time out, as a table and as a figure."""

import math

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from ..bound import Bounds
from ..evaluate import joint_error, prismatic_joints
from ..kinematics import Model
from ..sequences import Truth
from ..track import Track

_COLUMNS = 3
_LEAST = 0.02  # share of the smallest bound below which an error is not drawn: it crossed zero


def error_table(track: Track, truth: Truth, model: Model, found: Bounds | None) -> str:
    """Text of `evaluation.csv`: a row for each frame with truth, `frame,<joint>_error,<joint>_sigma,<joint>_bound...`.

    Degrees, or model units where a joint slides. A cell is empty where the truth lacks the joint, where no bound was
    computed, and where the images say nothing of the joint.
    """
    number, error, sigma, least = _series(track, truth, model, found)
    header = ",".join(f"{name}_{what}" for name in model.joint_names for what in ("error", "sigma", "bound"))
    cells = np.stack([error, sigma, least], axis=2).reshape(number.size, -1)
    rows = (f"{n}," + ",".join(_text(x) for x in row) for n, row in zip(number.tolist(), cells.tolist(), strict=True))
    return "\n".join([f"frame,{header}", *rows, ""])


def error_figure(track: Track, truth: Truth, model: Model, found: Bounds | None) -> Figure:
    """One chart for each joint: size of the error, sigma and bound over the frames, on a logarithmic scale."""
    number, error, sigma, least = _series(track, truth, model, found)
    count = len(model.joint_names)
    rows = math.ceil(count / _COLUMNS)
    figure = Figure(figsize=(4.2 * min(_COLUMNS, count), 2.3 * rows + 0.5), layout="constrained")
    grid = figure.subplots(rows, min(_COLUMNS, count), squeeze=False, sharex=True)
    slides = prismatic_joints(model)
    computed = np.isin(number, found.frame) if found is not None else np.zeros(number.size, dtype=bool)
    for j, axes in enumerate(grid.flat):
        if j >= count:
            axes.set_visible(False)
            continue
        floor = _LEAST * float(np.nanmin(np.concatenate([least[:, j], sigma[:, j]])))
        size = np.abs(error[:, j])
        axes.semilogy(
            number, np.where(size > floor, size, np.nan), ".", color="0.55", markersize=3.5, label="size of the error"
        )
        axes.semilogy(number, sigma[:, j], color="#4c78a8", label="sigma")
        if np.isfinite(least[:, j]).any():
            axes.semilogy(
                number[computed], least[computed, j], color="#e45756", marker=".", markersize=3.5, label="bound"
            )
        elif found is not None:
            axes.text(0.5, 0.04, "unseen: no bound", transform=axes.transAxes, ha="center", color="#e45756")
        axes.set_title(model.joint_names[j], fontsize=10)
        if j % _COLUMNS == 0 or slides[j]:
            axes.set_ylabel(model.units if slides[j] else "degrees")
        if j >= count - _COLUMNS:
            axes.set_xlabel("frame")
            axes.tick_params(labelbottom=True)
        axes.grid(visible=True, which="major", linewidth=0.4)
    handles, labels = grid.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, frameon=False)
    return figure


def _series(
    track: Track, truth: Truth, model: Model, found: Bounds | None
) -> tuple[np.ndarray, Float[np.ndarray, "n j"], Float[np.ndarray, "n j"], Float[np.ndarray, "n j"]]:
    """Frame numbers, error, sigma and bound in the units of files; NaN where there is no value."""
    number, rows, truth_rows = np.intersect1d(track.frame, truth.frame, return_indices=True)
    slides = prismatic_joints(model)
    scale = np.where(slides, 1.0, 180.0 / np.pi)
    error = joint_error(track.q[rows], truth.q[truth_rows], slides) * scale
    least = np.full(error.shape, np.nan)
    if found is not None:
        _, at, of = np.intersect1d(number, found.frame, return_indices=True)
        least[at] = np.where(np.isfinite(found.sigma[of]), found.sigma[of], np.nan) * scale
    return number, error, track.sigma[rows] * scale, least


def _text(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else ""
