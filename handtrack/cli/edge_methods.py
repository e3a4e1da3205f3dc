"""A number of seeded motions in, the table and picture of every edge method out: `handtrack reproduce edge-methods`.

Each scene is that of `reproduce two-finger-occlusion`: two fingers that cross, and the same in perspective, faster and
with more noise. The figures come from `handtrack.reproduce.edge_methods`; here are the sequences, and the words.
"""

from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from synth.scenes import images

from ..reproduce.edge_methods import THEIRS, Motion, Row, edge_methods
from ..settings import EDGES
from .console import table
from .occlusion import Variant, make_scene

VARIANTS: tuple[Variant, ...] = ("crossing", "hard")
ROWS = len(EDGES) + 2  # of one scene: WSSD has two, and the last is the method as printed
_HEADER = ("bias px", "scatter px", "err/sigma", "found %", "false %")
_TRACKED = ("RMSE deg", "NEES/dof", "lost", "ms")


def make_motions(variant: Variant, motions: int, first_seed: int, frames: int) -> tuple[Motion, ...]:
    """Rendered sequences with their truth."""
    found = []
    for seed in range(first_seed, first_seed + motions):
        scene = make_scene(seed, variant, frames)
        pictures = tuple(np.asarray(image, dtype=np.float32) for image in images(scene))
        found.append(Motion(pictures, scene.model, scene.camera, scene.truth, scene.start, scene.fps))
    return tuple(found)


def run(
    motions: int, first_seed: int = 0, frames: int = 60, progress: Callable[[int], None] | None = None
) -> tuple[tuple[Variant, tuple[Row, ...]], ...]:
    """Rows of both scenes; `progress` is called with the number of rows done."""
    results = []
    for number, variant in enumerate(VARIANTS):

        def done(rows: int, before: int = number * ROWS) -> None:
            if progress is not None:
                progress(before + rows)

        results.append((variant, edge_methods(make_motions(variant, motions, first_seed, frames), progress=done)))
    return tuple(results)


def as_text(results: tuple[tuple[Variant, tuple[Row, ...]], ...], motions: int) -> str:
    """One table for each scene, edges in single frames beside tracking, then what the thesis says of each method."""
    parts = []
    for variant, rows in results:
        header = [
            "method",
            *_HEADER,
            *(f"outline {_TRACKED[0]}", *_TRACKED[1:]),
            *(f"lines {_TRACKED[0]}", *_TRACKED[1:]),
        ]
        parts += [f"two fingers, {variant}, {motions} motions", table(header, [_cells(row) for row in rows]), ""]
    parts.append("what the thesis, which prints no figure of these methods, says of them:")
    parts.append(table(["method", "words"], [[name, words] for name, words in THEIRS.items()]))
    return "\n".join(parts)


def _cells(row: Row) -> list[object]:
    edges: list[object] = ["-"] * len(_HEADER)
    if row.edges is not None:
        e = row.edges
        edges = [e.bias, e.scatter, e.normalised, 100.0 * e.found, 100.0 * e.false]
    cells: list[object] = [row.method, *edges]
    for tracked in (row.outline, row.lines):
        if tracked is None:
            cells += ["-"] * len(_TRACKED)
        else:
            cells += [float(np.degrees(tracked.worst_rmse)), tracked.nees_ratio, tracked.lost, tracked.frame_ms]
    return cells


def as_data(results: tuple[tuple[Variant, tuple[Row, ...]], ...], motions: int) -> dict[str, object]:
    """The figures as plain data; angles in degrees, edges in pixels."""
    scenes = {variant: [_row_data(row) for row in rows] for variant, rows in results}
    return {"motions": motions, "scenes": scenes, "thesis": THEIRS}


def _row_data(row: Row) -> dict[str, object]:
    tracked = {
        name: None
        if figures is None
        else {
            "worst_rmse_median_deg": float(np.degrees(figures.worst_rmse)),
            "nees_per_dof": figures.nees_ratio,
            "motions_lost": figures.lost,
            "median_frame_ms": figures.frame_ms,
        }
        for name, figures in (("outline", row.outline), ("lines", row.lines))
    }
    return {"method": row.method, "edges": None if row.edges is None else asdict(row.edges), **tracked}
