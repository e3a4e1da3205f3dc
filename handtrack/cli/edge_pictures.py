"""One profile across a phalanx in, a picture of every edge method's criterion over it out."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from ..across import crossings
from ..appearance import learn
from ..axes import axis_spread
from ..edges import FOUND, curves
from ..edges.crossings import OUTWARD, Crossings
from ..edges.derivative import gaussian_slopes, plain_slopes
from ..edges.rectilinear import along_link, fit_iterative, fit_mwplls, fit_plls
from ..edges.width_restricted import correlate
from ..measure import posed
from ..measure_crossings import METHODS
from ..measure_lines import COUNT, look_lines
from ..profiles import place_across
from ..reproduce.edge_methods import Motion
from ..residuals import chain
from ..settings import EDGES, Settings

_OFF = np.radians(1.5)  # of each joint: how wrong the pose is that the profile is placed by


def criterion_figure(motion: Motion, frame: int, link: int | None = None) -> Figure:
    """The middle profile of a link in a frame, seen from a pose that is off by a degree and a half in every joint.

    Left, from the top: grey levels with every method's edges, both derivatives, the correlation with the two-peak
    template, the WSSD curve. Right: where the profile lies, and the link's correlation surface with the three lines.

    Parameters
    ----------
    link : int, optional
        The one with most edges to be seen where none is given; of several, the last.
    """
    on = chain(motion.model, motion.camera)
    true = motion.truth[frame][motion.model.free]
    image = motion.images[frame]
    known = learn(image, posed(on, true), motion.camera)
    off, covariance = true + _OFF, _OFF**2 * np.eye(true.size)
    pills = posed(on, off)
    samplers = place_across(pills, on.camera, COUNT)
    spread = axis_spread(on, samplers, off, covariance)
    reach = 3.0 * spread + 1.0
    crossed = crossings(image, pills, on.model.link_finger, on.camera, known, samplers, reach, spread)
    if link is None:
        seen_edges = np.bincount(samplers.link, (crossed.state == FOUND).sum(axis=1))
        link = int(seen_edges.size - 1 - np.argmax(seen_edges[::-1]))
    one = int(np.flatnonzero(samplers.link == link)[COUNT // 2])
    seen = look_lines(image, on, off, covariance, known, Settings(residuals="lines"))
    wssd = curves(seen.profiles, seen.templates)[one]
    figure = Figure(figsize=(12.0, 10.0), layout="constrained")
    grid = figure.add_gridspec(5, 2, width_ratios=(1.7, 1.0))
    left = [figure.add_subplot(grid[i, 0]) for i in range(5)]
    _grey(left[0], crossed, one)
    _derivatives(left[1:3], crossed, one)
    _template_curves(left[3:], crossed, one, wssd, 0.5 * float(reach[one]))
    _place(figure.add_subplot(grid[:3, 1]), motion, frame, crossed, one)
    _surface(figure.add_subplot(grid[3:, 1]), crossed, link)
    return figure


def _grey(axes: Any, crossed: Crossings, one: int) -> None:
    u, values = crossed.profiles.u, crossed.profiles.values[one]
    axes.plot(u, values, color="black", linewidth=1.2)
    axes.fill_between(u, 0, 255, where=~crossed.window[one], color="0.85", step="mid")
    for side in (0, 1):
        axes.axvline(crossed.edge[one, side], color="black", linestyle=":")
    for number, (name, method) in enumerate(zip(EDGES[1:], METHODS, strict=True)):
        edges = method(crossed)
        rows = np.array([2 * one, 2 * one + 1])
        rows = rows[edges.reason[rows] == FOUND]
        at = crossed.edge[one][rows % 2] + OUTWARD[rows % 2] * edges.offset[rows]
        height = np.full(at.size, 20.0 + 32.0 * number)
        axes.errorbar(at, height, xerr=2.0 * edges.sigma[rows], fmt="o", ms=4, color=f"C{number}")
        axes.text(u[-1] + 1.0, 20.0 + 32.0 * number, name, color=f"C{number}", fontsize=8, va="center")
    axes.set(ylabel="grey level", xlim=(u[0], u[-1]), ylim=(0, 255), title="profile; dotted: predicted; points: edges")


def _derivatives(two: list[Any], crossed: Crossings, one: int) -> None:
    tau = 0.25 * crossed.width[one]
    for axes, given, name in zip(two, (plain_slopes(crossed), gaussian_slopes(crossed)), EDGES[1:3], strict=True):
        axes.plot(given.u, np.where(given.usable[one], given.values[one], np.nan), color=f"C{EDGES.index(name) - 1}")
        axes.axhline(0.0, color="0.7", linewidth=0.8)
        axes.set(xlim=(crossed.profiles.u[0], crossed.profiles.u[-1]), ylabel="grey levels / px", title=name)
    for side in (0, 1):
        middle = crossed.edge[one, side]
        two[1].axvspan(middle - tau, middle + tau, color="C2", alpha=0.2, label=None if side else "window of width")
    two[1].set_xlabel("place across the phalanx (px)")
    two[1].legend(loc="upper center", fontsize="small", frameon=False)


def _template_curves(two: list[Any], crossed: Crossings, one: int, wssd: Float[np.ndarray, " k"], shown: float) -> None:
    surface = correlate(crossed, gaussian_slopes(crossed))
    two[0].plot(surface.shift, np.where(surface.allowed[one], surface.curves[one], np.nan), color="C3")
    two[0].set(title="width-compensated: correlation with two peaks", ylabel="grey levels / px")
    shift = (np.arange(wssd.size) - wssd.size // 2) * crossed.step
    two[1].plot(shift, np.where(np.isfinite(wssd), wssd, np.nan), color="black")
    two[1].set(title="wssd: template of grey levels", ylabel="mean square", yscale="log", xlabel="shift (px)")
    for axes in two:
        axes.set_xlim(-2.0 * shown, 2.0 * shown)


def _place(axes: Any, motion: Motion, frame: int, crossed: Crossings, one: int) -> None:
    axes.imshow(motion.images[frame], cmap="gray", vmin=0, vmax=255)
    mine = crossed.samplers.link == crossed.samplers.link[one]
    for row in np.flatnonzero(mine):
        ends = crossed.samplers.origin[row] + crossed.edge[row][:, None] * crossed.samplers.direction[row]
        axes.plot(*ends.T, color="tab:orange", linewidth=2.0 if row == one else 0.7)
    centre = crossed.samplers.origin[one]
    axes.set(
        xlim=(centre[0] - 110, centre[0] + 110),
        ylim=(centre[1] + 110, centre[1] - 110),
        title="where the profiles lie",
    )


def _surface(axes: Any, crossed: Crossings, link: int) -> None:
    surface = correlate(crossed, gaussian_slopes(crossed))
    mine = np.flatnonzero(crossed.samplers.link == link)
    x = along_link(crossed)
    shown = np.where(surface.allowed[mine], surface.curves[mine], np.nan)
    axes.set_facecolor("0.7")
    axes.pcolormesh(x[mine], surface.shift, shown.T, cmap="viridis", shading="nearest")
    for name, fit, style in (("plls", fit_plls, "--"), ("mwplls", fit_mwplls, ":"), ("iterative", fit_iterative, "-")):
        crest = fit(surface, x, crossed.samplers.link)
        axes.plot(x[mine], crest.shift[mine], style, color="white", linewidth=1.6, label=name)
    reach = float(crossed.reach[mine].max())
    axes.set(xlabel="place along the link (px)", ylabel="shift (px)", ylim=(-reach, reach), title="correlation surface")
    legend = axes.legend(loc="upper right", fontsize="small", facecolor="0.3")
    for text in legend.get_texts():
        text.set_color("white")
