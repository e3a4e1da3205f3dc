"""Frames and track in, video out: the estimated model drawn on every image, all views side by side.

Each link is shown by its outline and axis in the colour of its finger, with white joints; round each tip the ellipse
that holds it at two sigmas, `J C J^T` with the tip's image Jacobian J and the pose's covariance C. It is drawn true to
scale, so a well-tracked tip shows none outside its dot.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from ..camera import Camera, project, project_with_jacobian
from ..kinematics import Model, forward, link_ends, point_jacobian
from ..outlines import silhouettes
from ..pills import pose_pills
from ..surface import Surface
from ..track import Track
from .fingers import STATUS_COLOURS, Finger, fingers_of, rgb
from .mosaic import side_by_side
from .skin_overlay import draw_skin
from .video import write_video

_SHIFT = 4  # OpenCV draws at 1/16 pixel
_LEAST_HEIGHT = 400  # smaller images are enlarged so that lines and text stay fine
_HIDDEN = 0.2  # links seen less than this are drawn faintly
_FONT = cv2.FONT_HERSHEY_DUPLEX

Image = Float[np.ndarray, "_ _"]


def write_overlay(
    path: Path,
    frames: Iterable[Image | Sequence[Image]],
    track: Track,
    model: Model,
    camera: Camera | Sequence[Camera],
    fps: float | None = None,
    surface: Surface | None = None,
) -> str:
    """Write the overlay video, one image for each row of the track; returns the name of the video encoder.

    Parameters
    ----------
    frames : iterable of (h, w), or of tuples of them
        The images the track was made from, grey 0..255, in the order of the track's rows; with several views a tuple at
        a time.
    camera : Camera or sequence of Camera
        One for each view.
    fps : float, optional
        Frames per second; by default from the track's times.
    surface : Surface, optional
        The skin that was tracked, drawn in place of the pills.

    Raises
    ------
    ValueError
        If there are fewer images than rows in the track.
    RuntimeError
        If PyAV has no encoder that a browser plays.
    """
    cameras = [camera] if isinstance(camera, Camera) else camera
    return write_video(
        path, _overlays(frames, track, model, cameras, surface), track_fps(track) if fps is None else fps
    )


def track_fps(track: Track) -> float:
    """Frames per second from the median time step of a track; 25 for a track of one frame."""
    steps = np.diff(track.time)
    return float(1.0 / np.median(steps)) if steps.size and np.median(steps) > 0 else 25.0


def _overlays(
    frames: Iterable[Image | Sequence[Image]],
    track: Track,
    model: Model,
    cameras: Sequence[Camera],
    surface: Surface | None,
) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    images = iter(frames)
    for row in range(track.frame.size):
        found = next(images, None)
        if found is None:
            raise ValueError(f"frames: {row} images given, the track has {track.frame.size} rows")
        together = (found,) if isinstance(found, np.ndarray) else found
        if len(together) != len(cameras):
            raise ValueError(f"frames: {len(together)} images given for {len(cameras)} cameras; one for each is wanted")
        yield side_by_side(
            [
                draw_overlay(image, track, row, model, camera, view if len(cameras) > 1 else None, surface)
                for view, (image, camera) in enumerate(zip(together, cameras, strict=True))
            ]
        )


def draw_overlay(
    image: Float[np.ndarray, "h w"],
    track: Track,
    row: int,
    model: Model,
    camera: Camera,
    view: int | None = None,
    surface: Surface | None = None,
) -> UInt8[np.ndarray, "rows columns 3"]:
    """Draw row `row` of the track on its image (grey, 0..255); returns RGB, enlarged if the image is small.

    Parameters
    ----------
    view : int, optional
        Number of the view where there are several: it is written on the picture, and links are faint where this view
        does not see them; the status is written on the first alone.
    surface : Surface, optional
        The skin that was tracked, drawn in place of the pills.
    """
    zoom = max(1, math.ceil(_LEAST_HEIGHT / image.shape[0]))
    grey = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    canvas = cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)
    if zoom > 1:
        canvas = cv2.resize(canvas, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
    fingers = fingers_of(model)
    frames = forward(model, track.q[row])
    visible = track.visible[row]
    if view is not None and track.view_visible is not None:
        visible = track.view_visible[row, view]
    if surface is None:
        _draw_links(canvas, zoom, model, camera, frames, visible, fingers)
    else:
        draw_skin(canvas, zoom, surface, camera, track.q[row], _link_colours(fingers, visible.size))
    _draw_axes(canvas, zoom, model, camera, frames, fingers)
    _draw_tips(canvas, zoom, model, camera, frames, track.covariance[row], fingers)
    if not view:
        _draw_caption(canvas, track, row)
        _draw_names(canvas, fingers)
    if view is not None:
        _draw_number(canvas, view)
    return canvas


def _to_canvas(xy: Float[np.ndarray, "m 2"], zoom: int) -> Int[np.ndarray, "m 2"]:
    """Pixels of the image (centre of the first pixel at 0) as fixed-point canvas coordinates."""
    limit = 2**14  # canvas pixels: keeps a pose far outside the image from overflowing OpenCV's fixed point
    canvas = np.clip((xy + 0.5) * zoom - 0.5, -limit, limit)
    return np.rint(canvas * 2**_SHIFT).astype(np.int32)


def _link_colours(fingers: tuple[Finger, ...], count: int) -> list[tuple[int, int, int]]:
    colours = [(255, 255, 255)] * count
    for finger in fingers:
        for link in finger.links:
            colours[link] = rgb(finger.colour)
    return colours


def _draw_links(
    canvas: UInt8[np.ndarray, "rows columns 3"],
    zoom: int,
    model: Model,
    camera: Camera,
    frames: Float[np.ndarray, "f 4 4"],
    visible: Float[np.ndarray, " l"],
    fingers: tuple[Finger, ...],
) -> None:
    """Translucent pills with their outlines, the farthest first."""
    pills = pose_pills(model, frames, camera)
    colours = _link_colours(fingers, visible.size)
    fill = canvas.copy()
    outlines: list[tuple[int, np.ndarray]] = []
    polygons = silhouettes(pills, camera)
    for link in np.argsort(-(pills.base[:, 2] + pills.tip[:, 2]), kind="stable"):
        if np.isfinite(polygons[link]).all():
            points = _to_canvas(polygons[link], zoom)
            outlines.append((int(link), points))
            cv2.fillPoly(fill, [points], colours[link], cv2.LINE_AA, _SHIFT)
    cv2.addWeighted(fill, 0.16, canvas, 0.84, 0.0, dst=canvas)
    faint = canvas.copy()
    for link, points in outlines:
        seen = visible[link] >= _HIDDEN
        cv2.polylines(canvas if seen else faint, [points], True, colours[link], 2 if seen else 1, cv2.LINE_AA, _SHIFT)
    if any(visible[link] < _HIDDEN for link, _ in outlines):
        cv2.addWeighted(faint, 0.5, canvas, 0.5, 0.0, dst=canvas)


def _draw_axes(
    canvas: UInt8[np.ndarray, "rows columns 3"],
    zoom: int,
    model: Model,
    camera: Camera,
    frames: Float[np.ndarray, "f 4 4"],
    fingers: tuple[Finger, ...],
) -> None:
    """Axis of each link and a white dot at each joint."""
    ends = [project(camera, p_world) for p_world in link_ends(model, frames)]
    colours = _link_colours(fingers, model.link_length.size)
    shown = np.isfinite(ends[0]).all(axis=1) & np.isfinite(ends[1]).all(axis=1)
    base, tip = (_to_canvas(np.nan_to_num(xy), zoom) for xy in ends)
    for link in np.flatnonzero(shown):
        cv2.line(canvas, tuple(base[link].tolist()), tuple(tip[link].tolist()), colours[link], 1, cv2.LINE_AA, _SHIFT)
    for link in np.flatnonzero(shown):
        _dot(canvas, base[link], 3.2, (255, 255, 255), colours[link])


def _draw_tips(
    canvas: UInt8[np.ndarray, "rows columns 3"],
    zoom: int,
    model: Model,
    camera: Camera,
    frames: Float[np.ndarray, "f 4 4"],
    covariance: Float[np.ndarray, "j j"],
    fingers: tuple[Finger, ...],
) -> None:
    """A coloured dot at each tip, inside its ellipse of two sigmas."""
    links = np.flatnonzero(model.link_is_tip)
    p_world = link_ends(model, frames)[1][links]
    xy, d_xy = project_with_jacobian(camera, p_world)
    jacobian = d_xy @ point_jacobian(model, frames, model.link_frame[links], p_world)
    spread = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
    colours = _link_colours(fingers, model.link_length.size)
    for link, centre, cov in zip(links, xy, spread, strict=True):
        if not (np.isfinite(centre).all() and np.isfinite(cov).all()):
            continue
        cv2.polylines(canvas, [_to_canvas(_ellipse(centre, cov), zoom)], True, (255, 255, 255), 1, cv2.LINE_AA, _SHIFT)
        _dot(canvas, _to_canvas(centre[None], zoom)[0], 3.2, colours[link], (255, 255, 255))


def _ellipse(centre: Float[np.ndarray, " 2"], covariance: Float[np.ndarray, "2 2"]) -> Float[np.ndarray, "m 2"]:
    """Points where the Mahalanobis distance from the centre is 2."""
    angle = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    variance, axes = np.linalg.eigh(covariance)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return centre + 2.0 * (circle * np.sqrt(np.maximum(variance, 0.0))) @ axes.T


def _dot(
    canvas: UInt8[np.ndarray, "rows columns 3"],
    at: Int[np.ndarray, " 2"],
    radius: float,
    colour: tuple[int, int, int],
    rim: tuple[int, int, int],
) -> None:
    point, scale = (int(at[0]), int(at[1])), 2**_SHIFT
    cv2.circle(canvas, point, round((radius + 1.0) * scale), rim, -1, cv2.LINE_AA, _SHIFT)
    cv2.circle(canvas, point, round((radius - 0.6) * scale), colour, -1, cv2.LINE_AA, _SHIFT)


def _panel(canvas: UInt8[np.ndarray, "rows columns 3"], left: int, top: int, width: int, height: int) -> None:
    """Darken a part of the canvas so that text on it can be read."""
    area = canvas[max(top, 0) : top + height, max(left, 0) : left + width]
    area[:] = (area * 0.35 + 8).astype(np.uint8)


def _text(
    canvas: UInt8[np.ndarray, "rows columns 3"], words: str, left: int, base: int, colour: tuple[int, int, int]
) -> int:
    """Write text, return the x where it ends."""
    cv2.putText(canvas, words, (left, base), _FONT, 0.45, colour, 1, cv2.LINE_AA)
    return left + cv2.getTextSize(words, _FONT, 0.45, 1)[0][0]


def _draw_caption(canvas: UInt8[np.ndarray, "rows columns 3"], track: Track, row: int) -> None:
    """Status, frame number and confidence in the upper left corner."""
    status = str(track.status[row])
    colour = rgb(dict(STATUS_COLOURS)[status])
    words = f"{status}   frame {track.frame[row]}   {track.time[row]:.2f} s   confidence {track.confidence[row]:.2f}"
    _panel(canvas, 8, 8, cv2.getTextSize(words, _FONT, 0.45, 1)[0][0] + 34, 24)
    cv2.circle(canvas, (21 * 16, 20 * 16), 5 * 16, colour, -1, cv2.LINE_AA, _SHIFT)
    _text(canvas, words, 33, 25, (240, 240, 240))


def _draw_number(canvas: UInt8[np.ndarray, "rows columns 3"], view: int) -> None:
    """Number of the view in the upper right corner."""
    words = f"view {view}"
    width = cv2.getTextSize(words, _FONT, 0.45, 1)[0][0] + 16
    left = max(canvas.shape[1] - 8 - width, 0)
    _panel(canvas, left, 8, width, 24)
    _text(canvas, words, left + 8, 25, (240, 240, 240))


def _draw_names(canvas: UInt8[np.ndarray, "rows columns 3"], fingers: tuple[Finger, ...]) -> None:
    """Names of the fingers in their colours along the lower edge."""
    named = [finger for finger in fingers if finger.links]
    widths = [cv2.getTextSize(finger.name, _FONT, 0.45, 1)[0][0] + 14 for finger in named]
    edges = np.concatenate([[16], 16 + np.cumsum(widths)]).astype(int)
    bottom = canvas.shape[0] - 8
    _panel(canvas, 8, bottom - 24, int(edges[-1]) - 10, 24)
    for finger, (left, _) in zip(named, pairwise(edges.tolist()), strict=True):
        _text(canvas, finger.name, left, bottom - 7, rgb(finger.colour))
