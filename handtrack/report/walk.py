"""A person who was followed through a walk in; one HTML file out that holds everything and opens from disk.

The path in plan (followed, suit alone, truth) with ellipses of two sigma, errors over time, and a skeleton that can be
turned and played. Text, style and scripts are the files `walk*` beside this module, and the style of the other pages.
The page loads nothing; the same input gives the same bytes.
"""

import base64
import html
import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np
from jaxtyping import Int

from ..body.walk_metrics import yaw_of
from ..camera import Camera
from ..formats.skeletons import KEYPOINTS
from ..formats.walk_tracks import STATUSES, WalkTrack
from ..formats.walks import Walk, WalkTruth
from ..formats.writing import write_text
from .walk_facts import WalkFacts
from .walk_tiles import walk_tiles

MOST_FRAMES = 5000  # in one page; more are thinned
BONES = (
    (0, 1), (0, 2), (2, 4), (1, 3), (3, 5), (0, 6), (1, 7), (6, 7), (6, 8), (8, 10), (7, 9), (9, 11), (14, 15),
)  # fmt: skip
COLOURS = (
    ("tracked", "#2fb457"), ("predicted", "#2f8fe5"), ("uncertain", "#e0a030"), ("lost", "#e5484d"),
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class WalkShown:
    """Everything that the page shows.

    Attributes
    ----------
    title, method : str
        Name of the walk, and of the way in which the person was followed.
    track : WalkTrack
    facts : WalkFacts
        Of the track.
    raw : WalkTrack or None
        The suit alone, at the same frames.
    truth : WalkTruth or None
        At the same frames.
    walk : Walk or None
        What the camera saw, and where it stands.
    milliseconds : float or None
        Median time of a frame.
    settings, versions, inputs, warnings : tuple
        As in `page.RunInfo`.
    """

    title: str
    method: str
    track: WalkTrack
    facts: WalkFacts
    raw: WalkTrack | None = None
    truth: WalkTruth | None = None
    walk: Walk | None = None
    milliseconds: float | None = None
    settings: tuple[tuple[str, str], ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    inputs: tuple[tuple[str, str], ...] = ()
    warnings: tuple[str, ...] = ()


def write_walk_report(path: Path, shown: WalkShown) -> None:
    """Write the page as a single HTML file, whole or not at all.

    Raises
    ------
    ValueError
        If there is no frame.
    """
    write_text(path, render_walk_page(shown))


def render_walk_page(shown: WalkShown) -> str:
    """The text of the page; see `write_walk_report`."""
    track = shown.track
    if not track.frame.size:
        raise ValueError("track: has no frames, at least one was wanted")
    step = -(-track.frame.size // MOST_FRAMES)
    tiles = walk_tiles(track, shown.facts, shown.milliseconds)
    thinned = (f"The page shows one frame in {step}; the files hold all of them.",) if step > 1 else ()
    return Template(_asset("walk.html")).substitute(
        title=html.escape(shown.title),
        subtitle=html.escape(_subtitle(shown)),
        style=_asset("page.css")
        + ":root{"
        + "".join(f"--{k}:{c};" for k, c in COLOURS)
        + "}"
        + _asset("wrist.css")
        + _asset("walk.css"),
        warnings="".join(f'<p class="warning">{html.escape(text)}</p>' for text in (*shown.warnings, *thinned)),
        tiles="".join(tiles),
        tile_count=len(tiles),
        run=_table("Settings", shown.settings) + _table("Versions", shown.versions) + _table("Inputs", shown.inputs),
        data=json.dumps(_data(shown, step), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        script=_asset("walk_scene.js") + _asset("walk_charts.js") + _asset("walk.js"),
    )


def _asset(name: str) -> str:
    return resources.files(__name__.rpartition(".")[0]).joinpath(name).read_text(encoding="utf-8")


def _subtitle(shown: WalkShown) -> str:
    camera = "" if shown.walk is None else f" and {shown.walk.camera_frame.size} of the camera"
    return f"{shown.track.frame.size} frames of an inertial suit{camera}; method {shown.method}."


def _table(caption: str, pairs: tuple[tuple[str, str], ...]) -> str:
    if not pairs:
        return ""
    rows = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in pairs)
    return f'<section class="card"><h3>{caption}</h3><table class="pairs">{rows}</table></section>'


def _data(shown: WalkShown, step: int) -> dict[str, object]:
    """What the scripts draw: arrays as base64 of 32-bit floats, metres and degrees; NaN where there is nothing."""
    track, raw, truth = shown.track, shown.raw, shown.truth
    rows = np.arange(0, track.frame.size, step)
    status = np.array([STATUSES.index(name) for name in track.status[rows].tolist()])
    return {
        "frame": track.frame[rows].tolist(),
        "time": [round(t, 5) for t in track.time[rows].tolist()],
        "keypoints": [name.replace("_", " ") for name in KEYPOINTS],
        "statuses": STATUSES,
        "bones": BONES,
        "status": _bytes(status, "u1"),
        "inView": _bytes(track.in_view[rows], "u1"),
        "pelvis": _floats(track.p[rows]),
        "sigma": _floats(track.sigma[rows]),
        "heading": _floats(np.degrees(yaw_of(track.wxyz[rows]))),
        "sigmaHeading": _floats(np.degrees(track.sigma_heading[rows])),
        "points": _floats(track.keypoints[rows]),
        "joints": [name.replace("_", " ") for name in track.joint_names],
        "posture": _floats(np.degrees(track.posture[rows])),
        "sigmaPosture": _floats(np.degrees(track.sigma_posture[rows])),
        "raw": None if raw is None else _other(raw.p[rows], raw.wxyz[rows], raw.keypoints[rows]),
        "truth": None if truth is None else _other(truth.p[rows], truth.wxyz[rows], truth.keypoints[rows]),
        "seen": None if shown.walk is None else _floats(seen_at(shown.walk, track.time[rows])),
        "camera": None if shown.walk is None else _camera(shown.walk.camera),
    }


def _other(p: np.ndarray, wxyz: np.ndarray, keypoints: np.ndarray) -> dict[str, str]:
    return {"pelvis": _floats(p), "heading": _floats(np.degrees(yaw_of(wxyz))), "points": _floats(keypoints)}


def _camera(camera: Camera) -> dict[str, object]:
    return {
        "width": camera.width, "height": camera.height,
        "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy,
        "R": camera.R.tolist(), "t": camera.t.tolist(),
    }  # fmt: skip


def seen_at(walk: Walk, time: np.ndarray) -> np.ndarray:
    """Keypoints (n, 16, 2) in pixels of the camera's frame nearest to each time; NaN where none is within a frame."""
    after = np.searchsorted(walk.camera_time, time).clip(1, max(walk.camera_time.size - 1, 1))
    before: Int[np.ndarray, " n"] = after - 1
    after = after.clip(max=walk.camera_time.size - 1)
    nearer = np.abs(walk.camera_time[after] - time) < np.abs(walk.camera_time[before] - time)
    at = np.where(nearer, after, before)
    far = np.abs(walk.camera_time[at] - time) > 1.0 / walk.fps
    return np.where(far[:, None, None], np.nan, walk.uv[at])


def _floats(values: np.ndarray) -> str:
    return _bytes(values, "<f4")


def _bytes(values: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode("ascii")
