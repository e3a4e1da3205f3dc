"""Track, truth and video in; one HTML file out that holds everything it needs and opens from disk.

The page's text, style and script are the files `page.html`, `page.css` and `page.js` beside this module. A content
security policy in the page forbids it to load anything from elsewhere. The same input gives the same bytes.
"""

import base64
import html
import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np

from ..bound import Bounds
from ..camera import Camera
from ..kinematics import Model
from ..sequences import Truth
from ..track import Track
from ..view_errors import evaluate_views
from .figures import Figure, Joints, finger_section, joints_of, quality_figures
from .fingers import STATUS_COLOURS, finger_colour, short_name
from .observability import observability_section
from .plots import Frame, status_spans
from .tiles import summary_tiles
from .views import camera_words, size_words, view_table, visibility_of_views
from .widths import width_section

_CAPTIONS = (
    ("residual", "Distance of the accepted edge points from the outline, RMS"),
    ("edges", "Accepted edge points"),
    ("confidence", "Confidence"),
    ("time", "Computing time of each frame, image reading apart"),
)


@dataclass(frozen=True, slots=True, eq=False)
class RunInfo:
    """What the page says about the run; all of it is text to be shown, none of it is interpreted.

    Attributes
    ----------
    title : str
        Name of the sequence.
    fps : float
        Frames per second of the overlay video.
    settings, versions, inputs : tuple of (str, str)
        Names and values of settings, names and versions of packages, names and checksums of input files.
    warnings : tuple of str
        What was accepted with care.
    views : tuple of str
        What each view is called, where there are several.
    """

    title: str
    fps: float
    settings: tuple[tuple[str, str], ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    inputs: tuple[tuple[str, str], ...] = ()
    warnings: tuple[str, ...] = ()
    views: tuple[str, ...] = ()


def write_report(
    path: Path,
    track: Track,
    model: Model,
    camera: Camera | Sequence[Camera],
    video: Path | None,
    truth: Truth | None,
    run: RunInfo,
    bounds: Bounds | None = None,
) -> None:
    """Write the report of one run as a single HTML file.

    Parameters
    ----------
    path : Path
        Where to write; replaced at once, so that nothing half-written stays behind.
    camera : Camera or sequence of Camera
        One for each view.
    video : Path or None
        The overlay video, from `write_overlay`; it is put inside the page.
    truth : Truth or None
        May be shorter than the track and lack joints.
    run : RunInfo
        Its `fps` is that of the video.
    bounds : Bounds or None
        Cramer-Rao bounds of some frames: with a truth the page says how near to them the errors are.

    Raises
    ------
    ValueError
        If the track is empty or does not fit the model; InputError if the truth has nothing in common with it.
    """
    if not track.frame.size:
        raise ValueError("track: has no frames, at least one was wanted")
    page = render_page(track, model, camera, None if video is None else video.read_bytes(), truth, run, bounds)
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(page, encoding="utf-8", newline="\n")
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def render_page(
    track: Track,
    model: Model,
    camera: Camera | Sequence[Camera],
    video: bytes | None,
    truth: Truth | None,
    run: RunInfo,
    bounds: Bounds | None = None,
) -> str:
    """The text of the report; see `write_report`."""
    frame = Frame(track.time, track.status)
    cameras = [camera] if isinstance(camera, Camera) else camera
    evaluation, landmarks = (None, None) if truth is None else evaluate_views(track, truth, model, cameras)
    evaluation = None if evaluation is None else replace(evaluation, bounds=bounds)
    joints = joints_of(track, model, truth)
    sections = [finger_section(i, joints, frame, evaluation) for i, f in enumerate(joints.fingers) if f.joints]
    quality = quality_figures(track, frame)
    visibility, visible_figures = visibility_of_views(track, joints, frame)
    widths, width_figures = width_section(track, joints, frame)
    figures = [figure for _, group in sections for figure in group] + quality + visible_figures + width_figures
    tiles = summary_tiles(track, joints, evaluation, len(cameras))
    return Template(_asset("page.html")).substitute(
        title=html.escape(run.title),
        subtitle=html.escape(_subtitle(track, model, cameras)),
        style=_asset("page.css") + _colour_rules(len(joints.fingers)),
        warnings="".join(f'<p class="warning">{html.escape(text)}</p>' for text in run.warnings),
        tiles="".join(tiles),
        tile_count=len(tiles),
        video=_video(video, cameras[0] if len(cameras) == 1 else None),
        wide=' class="several"' if len(cameras) > 1 else "",
        views=view_table(track, cameras, run.views, landmarks) if len(cameras) > 1 else "",
        scrub=_scrub(frame),
        now=_now_table(joints, [figure for _, group in sections for figure in group]),
        fingers="".join(markup for markup, _ in sections),
        quality="".join(_quality_card(figure) for figure in quality),
        visibility=visibility,
        widths=widths,
        observability=observability_section(track, model),
        settings=_table("Settings", run.settings) + _table("Versions", run.versions) + _table("Inputs", run.inputs),
        truth_key="" if truth is None else '<li><i class="key truth-key"></i>true value</li>',
        rival_key=_rival_key(joints),
        data=_data(track, figures, run.fps),
        script=_asset("page.js"),
    )


def _rival_key(joints: Joints) -> str:
    """Legend of the rivals' curves, where there are any."""
    if joints.rival is None or not np.isfinite(joints.rival).any():
        return ""
    return '<li><i class="key rival-key"></i>a pose that looks the same</li>'


def _asset(name: str) -> str:
    return resources.files(__name__.rpartition(".")[0]).joinpath(name).read_text(encoding="utf-8")


def _subtitle(track: Track, model: Model, cameras: Sequence[Camera]) -> str:
    seen = f"{len(cameras)} views."
    if len(cameras) == 1:
        seen = f"{camera_words(cameras[0]).capitalize()} camera, {size_words(cameras[0])}."
    return (
        f"Model {model.name}: {len(model.joint_names)} joints, {model.link_length.size} links. {seen} "
        f"Frames {track.frame[0]} to {track.frame[-1]}."
    )


def _colour_rules(count: int) -> str:
    """Style of the finger and status colours, which the overlay video shares."""
    fingers = "".join(f".f{i % 8}{{--s:{finger_colour(i)}}}" for i in range(min(count, 8)))
    return ":root{" + "".join(f"--{name}:{colour};" for name, colour in STATUS_COLOURS) + "}" + fingers


def _video(video: bytes | None, camera: Camera | None) -> str:
    """The video, in the shape of the camera's image where there is one camera."""
    if video is None:
        return '<p class="novideo">No video was written for this run.</p>'
    data = base64.b64encode(video).decode("ascii")
    shape = "" if camera is None else f' style="aspect-ratio:{camera.width}/{camera.height}"'
    return (
        f'<video id="video" controls loop muted playsinline preload="auto"{shape} '
        f'src="data:video/mp4;base64,{data}"></video>'
    )


def _scrub(frame: Frame) -> str:
    """The time line below the video, coloured by status."""
    spans = "".join(
        f'<i style="left:{left / 10:.2f}%;width:{(right - left) / 10:.2f}%;background:var(--{status})"></i>'
        for status, left, right in status_spans(frame)
    )
    return f'<div id="scrub" class="scrub" title="Click to go to a frame">{spans}</div>'


def _now_table(joints: Joints, figures: Sequence[Figure]) -> str:
    """A row for each joint that the script fills with the values of the present frame; the last frame without it."""
    place = {
        (figure.name[1:].rstrip("d"), item.name): (figure, i)
        for figure in figures
        if figure.name.startswith("q")
        for i, item in enumerate(figure.series)
    }
    true = "" if joints.truth is None else "<th>truth</th><th>error</th>"
    rows = []
    for number, finger in enumerate(joints.fingers):
        for joint in finger.joints:
            name = short_name(joints.model.joint_names[joint], finger)
            figure, series = place[str(number), name]
            unit = html.escape(joints.unit(joint))
            blank = "" if joints.truth is None else "<td></td><td></td>"
            rows.append(
                f'<tr data-chart="{figure.name}" data-series="{series}"><th><i class="chip f{number % 8}"></i>'
                f"{html.escape(joints.model.joint_names[joint])}</th><td>{joints.values[-1, joint]:.2f}{unit}</td>"
                f"<td>{joints.sigma[-1, joint]:.3f}{unit}</td>{blank}</tr>"
            )
    return (
        f"<table class='now'><thead><tr><th>joint</th><th>estimate</th><th>sigma</th>{true}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def _quality_card(figure: Figure) -> str:
    caption = dict(_CAPTIONS)[figure.name]
    values = figure.series[0].values
    values = values[np.isfinite(values)]
    unit = html.escape(figure.unit)
    facts = "no values"
    if values.size:
        other, extreme = ("smallest", values.min()) if figure.name == "confidence" else ("largest", values.max())
        facts = f"median <b>{np.median(values):.3g}{unit}</b>, {other} <b>{extreme:.3g}{unit}</b>"
    for series in figure.series[1:]:
        mine = series.values[np.isfinite(series.values)]
        facts += f', <b class="{series.style}">{html.escape(series.name)}</b> {np.median(mine):.3g}{unit}'
    return f'<section class="card"><h3>{caption}</h3>{figure.html}<p class="facts">{facts}</p></section>'


def _table(caption: str, pairs: tuple[tuple[str, str], ...]) -> str:
    if not pairs:
        return ""
    rows = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in pairs)
    return f'<section class="card"><h3>{caption}</h3><table class="pairs">{rows}</table></section>'


def _data(track: Track, figures: Sequence[Figure], fps: float) -> str:
    """What the script reads: JSON that cannot end its script element, and has null for NaN."""
    charts = {
        figure.name: {
            "unit": figure.unit,
            "series": [
                {"name": item.name, "style": item.style, "v": _numbers(item.values)}
                | ({} if item.sigma is None else {"s": _numbers(item.sigma)})
                | ({} if item.truth is None else {"t": _numbers(item.truth)})
                for item in figure.series
            ],
        }
        for figure in figures
    }
    document = {
        "fps": fps,
        "frame": track.frame.tolist(),
        "time": _numbers(track.time),
        "status": track.status.tolist(),
        "charts": charts,
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return text.replace("<", "\\u003c")


def _numbers(values: np.ndarray) -> list[float | None]:
    """Ten-thousandths are finer than anything shown, and keep the page small."""
    return [round(value, 4) + 0.0 if math.isfinite(value) else None for value in values.tolist()]
