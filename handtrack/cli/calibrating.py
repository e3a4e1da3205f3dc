"""A sequence in, its calibrated model written, told and drawn: the work of `handtrack calibrate-shape`."""

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from ..calibrate import Calibration, calibrate
from ..calibrate_couplings import with_coupled_tips
from ..errors import InputError
from ..formats.model_writing import write_model
from ..kinematics import Model, forward, pose_from_free
from ..link_shape import PARAMETERS, reshaped
from ..outlines import silhouettes
from ..pills import pose_pills
from ..sequences import Sequence
from ..settings import Settings

MOST = 64  # frames
ROUNDS = 5  # of tracking and solving at the most, for the progress bar
_NAMES = ("length", "radius_base", "radius_tip", "base_y", "base_z", "tip_y", "tip_z")


def calibrated(
    sequence: Sequence,
    out: Path,
    done: Callable[[int], None],
    most: int = MOST,
    couple: float | None = None,
    start_sigma: float = 3.0,
) -> Calibration:
    """Calibrate the sequence's model on its first frames and write it to a file.

    Parameters
    ----------
    most : int
        Frames that are used at the most.
    couple : float or None
        Standard deviation, degrees, of a soft coupling of the last joints of each finger; none where it is None.
    start_sigma : float
        Standard deviation of the start pose, degrees.
    """
    if not out.absolute().parent.is_dir() or out.is_dir():
        raise InputError(f"--out: {out}; a file in an existing folder was wanted")
    found = calibrated_model(sequence, most, done, couple, start_sigma)
    write_model(out, found.model)
    return found


def calibrated_model(
    sequence: Sequence, most: int, done: Callable[[int], None], couple: float | None = None, start_sigma: float = 3.0
) -> Calibration:
    """The sequence's model calibrated on its first `most` frames; see `calibrated`."""
    if sequence.start is None:
        raise InputError(f"{sequence.path}: no start pose; `start:` in the sequence file was wanted")
    if couple is not None and not 0.0 < couple < np.inf:
        raise InputError(f"--couple-tips: {couple:g}; a number of degrees > 0 was wanted")
    if most < 2:
        raise InputError(f"--calibrate: {most}; 2 frames or more were wanted")
    images = list(islice(sequence, most))
    try:
        settings = Settings(start_sigma=np.radians(start_sigma))
        model = sequence.model
        if couple is not None:
            model = with_coupled_tips(model, sequence.start, np.radians(couple))
        return calibrate(images, model, sequence.cameras, sequence.start, sequence.fps, settings, done)
    except ValueError as refused:
        raise InputError(f"{sequence.path}: {refused}") from refused


def with_calibrated_model(sequence: Sequence, most: int, done: Callable[[int], None], start_sigma: float) -> Sequence:
    """The sequence with its model calibrated on the first frames, and a line that says so."""
    found = calibrated_model(sequence, most, done, None, start_sigma)
    said = (
        f"the model's shape was calibrated on {found.frames.size} frames: edges {found.residual_before:.2f} px from "
        f"the outline before, {found.residual_after:.2f} px after; model.yaml of this run holds it"
    )
    return replace(sequence, model=found.model, warnings=(*sequence.warnings, said))


def _table(found: Calibration) -> tuple[Float[np.ndarray, "l 7"], Float[np.ndarray, "l 7"]]:
    return found.shape, np.sqrt(np.diag(found.covariance)).reshape(-1, PARAMETERS)


def link_names(model: Model) -> list[str]:
    """Each link by the joint that moves it, or by the number of its frame."""
    joints = model.joint[model.link_frame]
    numbers = model.frame_ids[model.link_frame]
    return [model.joint_names[j] if j >= 0 else f"frame {n}" for j, n in zip(joints, numbers, strict=True)]


def shape_data(found: Calibration, out: Path) -> dict[str, object]:
    """The change of every link's shape with its sigma, in model units."""
    shape, sigma = _table(found)
    links = {
        name: {key: [round(float(v), 4), round(float(s), 4)] for key, v, s in zip(_NAMES, row, wide, strict=True)}
        for name, row, wide in zip(link_names(found.model), shape, sigma, strict=True)
    }
    return {
        "model": str(out),
        "frames": found.frames.tolist(),
        "residual_px": [round(found.residual_before, 4), round(found.residual_after, 4)],
        "links": links,
    }


def shape_text(found: Calibration, out: Path) -> str:
    """The same as a table."""
    shape, sigma = _table(found)
    lines = [f"{'link':<18}" + "".join(f"{name:>16}" for name in _NAMES)]
    for name, row, wide in zip(link_names(found.model), shape, sigma, strict=True):
        lines.append(f"{name:<18}" + "".join(f"{f'{v:+.2f} ± {s:.2f}':>16}" for v, s in zip(row, wide, strict=True)))
    said = f"{found.frames.size} frames: edges {found.residual_before:.2f} px from the outline before, "
    return "\n".join([*lines, f"{said}{found.residual_after:.2f} px after ({found.model.units})", str(out)])


def outline_figure(sequence: Sequence, found: Calibration) -> Figure:
    """First and last frame used, with the outlines of the model as it came and as it was found, in the same pose."""
    figure = Figure(figsize=(12.0, 5.2), layout="constrained")
    camera = sequence.cameras[0]
    came = reshaped(found.model, -found.shape)
    chosen = sorted({0, int(found.frames.size) - 1})
    for axes, at in zip(np.atleast_1d(figure.subplots(1, len(chosen))), chosen, strict=True):
        plot: Any = axes
        plot.imshow(sequence.views[0].read(int(found.frames[at])), cmap="gray", vmin=0, vmax=255)
        for model, colour, label in ((came, "#f58518", "as it came"), (found.model, "#54a24b", "calibrated")):
            pills = pose_pills(model, forward(model, pose_from_free(model, found.poses[at])), camera)
            for number, polygon in enumerate(silhouettes(pills, camera)):
                closed = np.vstack([polygon, polygon[:1]])
                plot.plot(*closed.T, color=colour, linewidth=1.0, label=label if number == 0 else None)
        plot.set(title=f"frame {found.frames[at]}", xticks=[], yticks=[])
        plot.legend(frameon=False, labelcolor="white", loc="lower right")
    return figure
