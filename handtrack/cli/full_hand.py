"""A number of seeded motions in, the whole hand tracked through them by one camera and by two out (hand thesis, 6.2.2).

Rendering is exact (`synth`), the figures are put together by `handtrack.reproduce.full_hand`.
"""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.figure import Figure

from synth.scenes import full_hand_spread, images_together
from synth.views import with_views

from ..evaluate import evaluate
from ..reproduce.full_hand import FullHand, full_hand
from ..sequences import Truth
from ..settings import Settings
from ..tracker import track


def track_hands(
    motions: int,
    views: int,
    settings: Settings,
    first_seed: int = 0,
    frames: int = 60,
    progress: Callable[[int], None] | None = None,
) -> FullHand:
    """Render, track and evaluate `motions` motions seen by `views` cameras.

    Parameters
    ----------
    progress : callable
        Called with the number of motions done.
    """
    tracks, truths, evaluations = [], [], []
    for i in range(motions):
        scene = with_views(full_hand_spread(first_seed + i, frames=frames), views)
        pictures = (
            tuple(np.asarray(image, dtype=np.float32) for image in together) for together in images_together(scene)
        )
        found = track(pictures, scene.model, scene.cameras, scene.start, scene.fps, settings)
        tracks.append(found)
        truths.append(scene.truth)
        evaluations.append(evaluate(found, Truth(np.arange(frames), scene.truth), scene.model, scene.camera))
        if progress is not None:
            progress(i + 1)
    model = full_hand_spread(first_seed, frames=2).model
    return full_hand(views, model, tracks, truths, evaluations)


def figure(results: Sequence[FullHand]) -> Figure:
    """RMSE, largest error and two median sigmas of every joint, a panel for each number of views."""
    drawn = Figure(figsize=(11.0, 3.4 * len(results)), layout="constrained")
    panels = drawn.subplots(len(results), 1, squeeze=False, sharex=True)[:, 0]
    x = np.arange(len(results[0].joint_names))
    for axes, result in zip(panels, results, strict=True):
        axes.bar(x, result.rmse, color="#4c78a8", label="RMSE")
        axes.plot(x, result.largest, "v", color="#e45756", label="largest error")
        axes.plot(x, 2.0 * result.sigma, "_", color="black", markersize=14, label="2 sigmas, median")
        views = "one view" if result.views == 1 else f"{result.views} views"
        axes.set(ylabel="degrees", title=f"{views}, {result.worst_rmse.size} motions", yscale="log", ylim=(0.005, 20.0))
        axes.legend(frameon=False, ncols=3, loc="upper left")
    panels[-1].set_xticks(x, [name.replace("_", " ") for name in results[0].joint_names], rotation=60, ha="right")
    return drawn
