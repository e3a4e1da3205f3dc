"""Results in, pictures beside their tables out: what `--plot FILE` of a command writes (PNG, SVG or PDF)."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from ..errors import InputError
from ..formats import write_bytes
from ..kinematics import Model, forward, link_ends
from ..reproduce.pose_tables import PoseTable
from .occlusion import Occlusion

_FORMATS = (".png", ".svg", ".pdf")


def save(figure: Figure, path: Path) -> None:
    """Write a figure, whole or not at all."""
    check(path)
    content = BytesIO()
    figure.savefig(content, format=path.suffix[1:].lower(), dpi=120)
    write_bytes(path, content.getvalue())


def check(path: Path) -> None:
    """Refuse a file that no picture can be written to."""
    if path.suffix.lower() not in _FORMATS:
        raise InputError(f"--plot: {path} ends in '{path.suffix}'; one of {', '.join(_FORMATS)} was wanted")
    if not path.absolute().parent.is_dir() or path.is_dir():
        raise InputError(f"--plot: {path}; a file in an existing folder was wanted")


def occlusion_figure(result: Occlusion) -> Figure:
    """Worst-joint RMSE of each motion beside the NEES of each frame with its 95 % band."""
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    worst = np.degrees(result.worst_rmse)
    left.bar(result.seed, worst, color="#4c78a8")
    left.axhline(float(np.median(worst)), color="black", linewidth=1.0, label=f"median {np.median(worst):.3f}")
    left.set(xlabel="motion (seed)", ylabel="RMSE of the worst joint (degrees)")
    left.legend(frameon=False)
    right.axhspan(*result.band, color="#f58518", alpha=0.25, label="95 % band of right sigmas")
    right.plot(result.frame_nees, color="#4c78a8", label=f"mean over {result.seed.size} motions")
    right.set(xlabel="frame", ylabel="NEES", ylim=(0.0, None))
    right.legend(frameon=False)
    return figure


def pose_figure(tables: tuple[PoseTable, ...]) -> Figure:
    """Cost of the printed iterates of every table, ours and theirs."""
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    for axes, table in zip(figure.subplots(2, 3).flat, tables, strict=True):
        k = [row.k for row in table.rows]
        for values, style, label in (
            ([row.ours[-1] for row in table.rows], "o-", "ours"),
            ([row.printed[-1] for row in table.rows], "x--", "printed"),
        ):
            axes.plot(k, np.maximum(np.array(values, dtype=float), 1e-5), style, label=label)
        axes.set(title=f"Table {table.name}: {table.chain}", xlabel="step k", ylabel="cost H", yscale="log")
        axes.legend(frameon=False)
    return figure


def model_figure(model: Model) -> Figure:
    """A model at its resting pose: links as tubes of their radius, named joints, base axes."""
    low, high = np.where(np.isfinite(model.limits), model.limits, 0.0).T
    frames = forward(model, np.clip(np.zeros(len(model.joint_names)), low, np.maximum(low, high)))
    base, tip = link_ends(model, frames)
    figure = Figure(figsize=(7.0, 7.0), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    colours = [f"C{finger % 10}" for finger in model.link_finger]
    for start, end, radius, colour in zip(base, tip, model.link_radius.mean(axis=1), colours, strict=True):
        axes.plot(*np.stack([start, end]).T, color=colour, linewidth=max(float(radius), 1.0), solid_capstyle="round")
    places = [tuple(frames[int(np.flatnonzero(model.joint == j)[0]), :3, 3].round(6)) for j in range(low.size)]
    for place in dict.fromkeys(places):  # joints of one knuckle share a label
        names = [name for name, at in zip(model.joint_names, places, strict=True) if at == place]
        axes.text(*place, "\n".join(names), fontsize=7, va="center")
    points = np.concatenate([base, tip, np.zeros((1, 3))])
    _equal(axes, points)
    axes.view_init(elev=65.0, azim=-100.0)
    axes.set(xlabel="x", ylabel="y", zlabel="z", title=f"{model.name} ({model.units}), all joints at zero")
    return figure


def _equal(axes: Any, points: Float[np.ndarray, "n 3"]) -> None:
    """The same scale along all three axes."""
    middle, reach = 0.5 * (points.min(axis=0) + points.max(axis=0)), 0.55 * float(np.ptp(points, axis=0).max())
    for axis, centre in zip("xyz", middle, strict=True):
        getattr(axes, f"set_{axis}lim")(centre - reach, centre + reach)
    axes.set_box_aspect((1.0, 1.0, 1.0))
