"""People who were followed and what was seen of them in; one HTML file out that holds everything and opens from disk.

A view in space (from any side, or as the camera sees it) beside tracks in plan, the state of every keypoint, and the
course of a chosen one over time. Text, style and scripts are the files `people*` beside this module, and the style of
the other pages. The page loads nothing; the same input gives the same bytes.
"""

import base64
import html
import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np
from jaxtyping import Float, Int

from ..camera import Camera
from ..formats.people import STATUSES, People
from ..formats.skeletons import KEYPOINTS, Detections, TruthPoints
from ..formats.writing import write_text
from .people_facts import PeopleFacts
from .people_tiles import tiles_of

MOST_ENTRIES = 10_000  # people times frames in one page; more are thinned
NOWHERE = -32768  # millimetres of what has no place
BONES = (
    (0, 1), (0, 2), (2, 4), (1, 3), (3, 5), (0, 6), (1, 7), (6, 7), (6, 8), (8, 10), (7, 9), (9, 11), (14, 15),
)  # fmt: skip
COLOURS = (("tracked", "#2fb457"), ("seen", "#2fb457"), ("predicted", "#2f8fe5"), ("lost", "#e5484d"))


@dataclass(frozen=True, slots=True, eq=False)
class PeopleShown:
    """Everything that the page shows.

    Attributes
    ----------
    title, mode : str
        Name of the scene, and of the way in which people were followed.
    raw : People or None
        The measurements that belong to each label.
    detections : Detections
        All that was reported.
    gate : float or None
        Metres from the camera beyond which nobody is followed.
    milliseconds : float or None
        Mean time of a frame.
    settings, versions, inputs, warnings : tuple
        As in `page.RunInfo`.
    """

    title: str
    mode: str
    people: People
    raw: People | None
    detections: Detections
    truth: TruthPoints | None
    facts: PeopleFacts
    camera: Camera | None = None
    gate: float | None = None
    milliseconds: float | None = None
    settings: tuple[tuple[str, str], ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    inputs: tuple[tuple[str, str], ...] = ()
    warnings: tuple[str, ...] = ()


def write_people_report(path: Path, shown: PeopleShown) -> None:
    """Write the page as a single HTML file, whole or not at all.

    Raises
    ------
    ValueError
        If there is no frame.
    """
    write_text(path, render_people_page(shown))


def render_people_page(shown: PeopleShown) -> str:
    """The text of the page; see `write_people_report`."""
    people = shown.people
    if not people.time.size:
        raise ValueError("people: has no frames, at least one was wanted")
    step = -(-max(people.frame.size, 1) // MOST_ENTRIES)
    tiles = tiles_of(people, shown.facts, shown.milliseconds)
    thinned = (f"The page shows one frame in {step}; the files hold all of them.",) if step > 1 else ()
    return Template(_asset("people.html")).substitute(
        title=html.escape(shown.title),
        subtitle=html.escape(_subtitle(shown)),
        style=_asset("page.css")
        + ":root{"
        + "".join(f"--{k}:{c};" for k, c in COLOURS)
        + "}"
        + _asset("wrist.css")
        + _asset("people.css"),
        warnings="".join(f'<p class="warning">{html.escape(text)}</p>' for text in (*shown.warnings, *thinned)),
        tiles="".join(tiles),
        tile_count=len(tiles),
        run=_table("Settings", shown.settings) + _table("Versions", shown.versions) + _table("Inputs", shown.inputs),
        data=json.dumps(_data(shown, step), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        script=_asset("people_scene.js") + _asset("people_charts.js") + _asset("people.js"),
    )


def _asset(name: str) -> str:
    return resources.files(__name__.rpartition(".")[0]).joinpath(name).read_text(encoding="utf-8")


def _subtitle(shown: PeopleShown) -> str:
    count, entries = shown.facts.labels.size, shown.detections.frame.size
    who = f"{count} {'person' if count == 1 else 'people'}"
    return f"{who} in {shown.people.time.size} frames, from {entries} reported skeletons; mode {shown.mode}."


def _table(caption: str, pairs: tuple[tuple[str, str], ...]) -> str:
    if not pairs:
        return ""
    rows = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in pairs)
    return f'<section class="card"><h3>{caption}</h3><table class="pairs">{rows}</table></section>'


def _data(shown: PeopleShown, step: int) -> dict[str, object]:
    """What the scripts draw: places as base64, millimetres; -32768 where there is none."""
    people, truth = shown.people, shown.truth
    frames = np.arange(0, people.time.size, step)
    camera = shown.camera
    up = upward(people)
    return {
        "step": step,
        "time": [round(t, 5) for t in people.time[frames].tolist()],
        "keypoints": [name.replace("_", " ") for name in KEYPOINTS],
        "statuses": STATUSES,
        "bones": BONES,
        "labels": shown.facts.labels.tolist(),
        "people": _entries(people, frames, step, whole=True),
        "raw": None if shown.raw is None else _entries(shown.raw, frames, step, whole=False),
        "seen": _reported(shown.detections, frames, step),
        "truth": None if truth is None or not truth.p.shape[1] else _truth(truth, shown.facts, frames),
        "up": up.round(6).tolist(),
        "floor": floor_of(people, up),
        "gate": shown.gate,
        "camera": None if camera is None else {
            "width": camera.width, "height": camera.height,
            "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy,
        },
    }  # fmt: skip


def _entries(people: People, frames: Int[np.ndarray, " g"], step: int, whole: bool) -> dict[str, object]:
    """Entries of the shown frames; without covariances and states where `whole` is false."""
    rows = np.flatnonzero(people.frame % step == 0)
    out: dict[str, object] = {
        "starts": np.searchsorted(people.frame[rows], np.append(frames, frames[-1] + 1)).tolist(),
        "label": people.person[rows].tolist(),
        "p": _millimetres(people.p[rows]),
    }
    if whole:
        upper = people.covariance[rows][:, :, *np.triu_indices(3)]
        out["status"] = _bytes(people.status[rows], "u1")
        out["covariance"] = _bytes(np.nan_to_num(upper), "<f4")
    return out


def _reported(seen: Detections, frames: Int[np.ndarray, " g"], step: int) -> dict[str, object]:
    rows = np.flatnonzero(seen.frame % step == 0)
    starts = np.searchsorted(seen.frame[rows], np.append(frames, frames[-1] + 1))
    return {"starts": starts.tolist(), "p": _millimetres(seen.p[rows])}


def _truth(truth: TruthPoints, facts: PeopleFacts, frames: Int[np.ndarray, " g"]) -> dict[str, object]:
    p = np.full((frames.size, *truth.p.shape[1:]), np.nan)
    known = frames < truth.p.shape[0]
    p[known] = truth.p[frames[known]]
    mains = [] if facts.truth is None else facts.truth.mains.tolist()
    return {"label": mains, "p": _millimetres(p)}


def upward(people: People) -> Float[np.ndarray, " 3"]:
    """Unit vector against gravity, as the median of the people's trunks says; minus y where there is none.

    Parameters
    ----------
    people : People
        Mostly upright.
    """
    hip, shoulder = ((p[:, 0] + p[:, 1]) / 2.0 for p in (people.p[:, 6:8], people.p[:, 0:2]))
    way = (shoulder - hip)[np.isfinite(shoulder - hip).all(axis=1)]
    length = np.linalg.norm(way, axis=1)
    way = way[length > 0.1] / length[length > 0.1, None]
    middle = np.median(way, axis=0) if way.size else np.zeros(3)
    size = float(np.linalg.norm(middle))
    return middle / size if size > 0.3 else np.array([0.0, -1.0, 0.0])


def floor_of(people: People, up: Float[np.ndarray, " 3"]) -> float | None:
    """Height of the floor along `up` from the camera, metres, below 0: 5 cm under the ankles; None without anybody."""
    height = people.p[:, 10:12].reshape(-1, 3) @ up
    height = height[np.isfinite(height)]
    if not height.size:
        height = people.p.reshape(-1, 3) @ up
        height = height[np.isfinite(height)]
    return round(float(np.quantile(height, 0.05)) - 0.05, 4) if height.size else None


def _millimetres(p: np.ndarray) -> str:
    known = np.isfinite(p).all(axis=-1, keepdims=True)
    values = np.where(known, np.clip(np.rint(1000.0 * np.nan_to_num(p)), -32767, 32767), NOWHERE)
    return _bytes(values, "<i2")


def _bytes(values: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode("ascii")
