"""Track and cameras in; which view is which, and what each saw, out."""

import html
import math
from collections.abc import Sequence

import numpy as np

from ..camera import Camera
from ..track import Track
from ..view_errors import LandmarkErrors
from .figures import Figure, Joints, visibility_rows
from .plots import Frame

_DASH, _NBSP = "\N{EN DASH}", "\N{NO-BREAK SPACE}"


def camera_words(camera: Camera) -> str:
    """Kind of a camera, and whether its lens bends."""
    return camera.kind + (" with distortion" if camera.distortion.any() else "")


def size_words(camera: Camera) -> str:
    """Size of its image."""
    return f"{camera.width} \N{MULTIPLICATION SIGN} {camera.height} pixels"


def turn(camera: Camera, first: Camera) -> float:
    """Angle in degrees between the viewing directions of two cameras.

    >>> from handtrack.camera import orthographic
    >>> front = orthographic(8, 8, 1.0, 4.0, 4.0, np.eye(3), np.zeros(3))
    >>> side = orthographic(8, 8, 1.0, 4.0, 4.0, np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.zeros(3))
    >>> turn(side, front)
    90.0
    """
    return math.degrees(math.acos(float(np.clip(camera.R[2] @ first.R[2], -1.0, 1.0))))


def view_table(track: Track, cameras: Sequence[Camera], names: Sequence[str], landmarks: LandmarkErrors | None) -> str:
    """A row for each view: its files, its camera, the edges it gave and, with truth, its landmark error."""
    head = ["view", "images", "camera", "size", "direction"]
    edges, visible = track.view_edges, track.view_visible
    if edges is not None and visible is not None:
        head += ["edges in a frame", "links seen"]
    if landmarks is not None:
        head += ["landmark error", "largest"]
    rows = []
    for i, camera in enumerate(cameras):
        off = "the first" if i == 0 else f"{turn(camera, cameras[0]):.0f}\N{DEGREE SIGN} from the first"
        cells = [names[i] if i < len(names) else _DASH, camera_words(camera), size_words(camera), off]
        if edges is not None and visible is not None:
            share = float(edges[:, i].sum()) / max(float(edges.sum()), 1.0)
            cells.append(f"median {np.median(edges[:, i]):.0f}, {100 * share:.0f}{_NBSP}% of all")
            cells.append(f"{100 * visible[:, i].mean():.0f}{_NBSP}% of their outlines")
        if landmarks is not None:
            cells += [_pixels(float(values[i])) for values in (landmarks.mean, landmarks.largest)]
        rows.append(
            f'<tr><th><b class="c{i % 6}">view {i}</b></th>'
            + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
            + "</tr>"
        )
    header = "".join(f"<th>{name}</th>" for name in head)
    return (
        '<h2>Views</h2><section class="card wide"><table class="views">'
        f"<thead><tr>{header}</tr></thead><tbody>{''.join(rows)}</tbody></table></section>"
    )


def _pixels(value: float) -> str:
    return f"{value:.2f}{_NBSP}px" if math.isfinite(value) else _DASH


def visibility_of_views(track: Track, joints: Joints, frame: Frame) -> tuple[str, list[Figure]]:
    """Visible share of each link, in each view where the track tells them apart."""
    if track.view_visible is None or track.view_visible.shape[1] < 2:
        return visibility_rows(track.visible, joints, frame)
    blocks, figures = [], []
    for view in range(track.view_visible.shape[1]):
        markup, drawn = visibility_rows(track.view_visible[:, view], joints, frame, f"v{view}l")
        blocks.append(f"<h4>View {view}</h4>{markup}")
        figures += drawn
    return "".join(blocks), figures
