"""The track of a hidden wrist and its scene in; one HTML file out that holds everything it needs and opens from disk.

A view in space (room, arm, particles, ellipsoid, truth, robot) beside curves over time. Text, style and scripts are the
files `wrist.*` beside this module, and the style of the other report. The page loads nothing; the same input gives the
same bytes.
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

from ..body.environment import Room
from ..body.particles import ellipsoid
from ..camera import Camera
from ..formats.robots import RobotVolume
from ..formats.wrists import KILLS, STATUSES, WristTrack
from ..formats.writing import write_text
from .wrist_facts import LITRE, Facts, robot_distance
from .wrist_room import decimated, edges, upward
from .wrist_tiles import tiles_of

MOST_POINTS = 1_500_000  # particles in one page
COLOURS = (("tracked", "#2fb457"), ("predicted", "#2f8fe5"), ("uncertain", "#e8a317"), ("lost", "#e5484d"))


@dataclass(frozen=True, slots=True, eq=False)
class WristShown:
    """Everything that the page shows.

    Attributes
    ----------
    title, side : str
        Name of the scene, and which arm.
    seen, state : (f, 3, 3), (f, 3)
        Shoulder, elbow, wrist as the sensor has them, and its states (0 tracked, 1 inferred, 2 lost).
    truth : (f, 3, 3) or None
    settings, versions, inputs, warnings : tuple
        As in `page.RunInfo`.
    """

    title: str
    side: str
    track: WristTrack
    facts: Facts
    seen: Float[np.ndarray, "f 3 3"]
    state: Int[np.ndarray, "f 3"]
    truth: Float[np.ndarray, "f 3 3"] | None
    room: Room | None
    robot: RobotVolume | None
    camera: Camera
    settings: tuple[tuple[str, str], ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    inputs: tuple[tuple[str, str], ...] = ()
    warnings: tuple[str, ...] = ()


def write_wrist_report(path: Path, shown: WristShown) -> None:
    """Write the page as a single HTML file, whole or not at all.

    Raises
    ------
    ValueError
        If the track is empty.
    """
    write_text(path, render_wrist_page(shown))


def render_wrist_page(shown: WristShown) -> str:
    """The text of the page; see `write_wrist_report`."""
    track = shown.track
    if not track.time.size:
        raise ValueError("track: has no frames, at least one was wanted")
    tiles = tiles_of(shown.track, shown.facts)
    return Template(_asset("wrist.html")).substitute(
        title=html.escape(shown.title),
        subtitle=html.escape(_subtitle(shown)),
        style=_asset("page.css") + ":root{" + "".join(f"--{k}:{c};" for k, c in COLOURS) + "}" + _asset("wrist.css"),
        warnings="".join(f'<p class="warning">{html.escape(text)}</p>' for text in shown.warnings),
        tiles="".join(tiles),
        tile_count=len(tiles),
        run=_table("Settings", shown.settings) + _table("Versions", shown.versions) + _table("Inputs", shown.inputs),
        data=json.dumps(_data(shown), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        script=_asset("wrist_scene.js") + _asset("wrist_charts.js") + _asset("wrist.js"),
    )


def _asset(name: str) -> str:
    return resources.files(__name__.rpartition(".")[0]).joinpath(name).read_text(encoding="utf-8")


def _subtitle(shown: WristShown) -> str:
    c, f = shown.camera, shown.track.time.size
    room = "no room" if shown.room is None else f"a room of {shown.room.triangles.shape[0]} triangles"
    size = f"{c.width} \N{MULTIPLICATION SIGN} {c.height} pixels"
    return f"{shown.side.capitalize()} wrist, {f} frames, depth camera of {size}, {room}."


def _table(caption: str, pairs: tuple[tuple[str, str], ...]) -> str:
    if not pairs:
        return ""
    rows = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in pairs)
    return f'<section class="card"><h3>{caption}</h3><table class="pairs">{rows}</table></section>'


def _data(shown: WristShown) -> dict[str, object]:
    """What the scripts draw: arrays as base64, curves as numbers."""
    track, camera = shown.track, shown.camera
    f = track.time.size
    per_frame = max(1, min(track.cloud.shape[1], MOST_POINTS // f))
    cloud = track.cloud[:, :: -(-max(track.cloud.shape[1], 1) // per_frame)]
    joints = np.stack([track.shoulder, track.elbow, track.mean], axis=1)
    return {
        "time": _numbers(track.time, 5),
        "status": [STATUSES.index(status) for status in track.status.tolist()],
        "statuses": STATUSES,
        "sensor": shown.state[:, 2].tolist(),
        "hidden": shown.facts.hidden.astype(int).tolist(),
        "joints": _floats(joints),
        "seen": _floats(np.where(np.isfinite(shown.seen), shown.seen, np.nan)),
        "truth": None if shown.truth is None else _floats(shown.truth),
        "ellipsoid": _floats(_ellipsoids(track)),
        "cloud": {"count": cloud.shape[1], "data": _millimetres(cloud)},
        "camera": {
            "width": camera.width, "height": camera.height,
            "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy,
        },
        "up": upward(shown.room).round(6).tolist(),
        "room": None if shown.room is None or not shown.room.triangles.size else _room(shown.room),
        "robot": None if shown.robot is None or not shown.robot.radius.size else _robot(shown.robot),
        "charts": _charts(shown),
    }  # fmt: skip


def _ellipsoids(track: WristTrack) -> Float[np.ndarray, "f 3 3"]:
    """Half axes of the 95 % ellipsoids, as columns."""
    found = [ellipsoid(mean, covariance) for mean, covariance in zip(track.mean, track.covariance, strict=True)]
    return np.stack([each.axes * each.half for each in found])


def _room(room: Room) -> dict[str, object]:
    small = decimated(room)
    corners = small.vertices[small.triangles].reshape(-1, 3)
    lines = small.vertices[edges(small)].reshape(-1, 3)
    return {"triangles": _floats(corners), "edges": _floats(lines), "whole": int(room.triangles.shape[0])}


def _robot(robot: RobotVolume) -> dict[str, object]:
    return {"links": int(robot.radius.shape[1]), "ends": _floats(robot.ends), "radius": _floats(robot.radius)}


def _charts(shown: WristShown) -> list[dict[str, object]]:
    """Curves: name, unit, digits, and series (name, colour class, values)."""
    track, facts = shown.track, shown.facts
    out: list[dict[str, object]] = []

    def chart(name: str, unit: str, series: list[dict[str, object]], **more: object) -> None:
        out.append({"name": name, "unit": unit, "series": series, **more})

    if facts.error is not None and facts.held is not None:
        held = np.where(facts.hidden, facts.held, np.nan)
        chart(
            "Error of the wrist",
            "mm",
            [_series("last position held", "neutral dash", 1e3 * held), _series("estimate", "c0", 1e3 * facts.error)],
            digits=0,
        )
    spread = np.maximum(track.volume / LITRE, 1e-6)
    chart("Volume of the 95 % ellipsoid", "l", [_series("volume", "c4", spread, 6)], log=True, digits=3)
    kills = [
        _series(name.replace("_", " "), f"k{k} area", track.kills[:, k], 0)
        for k, name in enumerate(KILLS)
    ]  # fmt: skip
    chart("Particles that each constraint forbade", "", kills, stacked=True, digits=0)
    if facts.robot is not None and facts.nearest is not None and np.isfinite(facts.robot).all():
        series = [_series("nearest particle", "c1 dash", facts.nearest), _series("5 % quantile", "c1", facts.robot)]
        if shown.truth is not None and shown.robot is not None:
            true = robot_distance(shown.truth[:, 2:3], shown.robot)[:, 0]
            series.append(_series("true wrist", "ink dots", true))
        chart("Distance from the cloud to the robot", "m", series, digits=2)
    return out


def _series(name: str, style: str, values: np.ndarray, digits: int = 4) -> dict[str, object]:
    return {"name": name, "style": style, "values": _numbers(values, digits)}


def _numbers(values: np.ndarray, digits: int) -> list[float | None]:
    return [None if not np.isfinite(value) else round(value, digits) for value in values.astype(float).tolist()]


def _floats(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")


def _millimetres(cloud: np.ndarray) -> str:
    values = np.clip(np.rint(1000.0 * cloud.astype(float)), -32767, 32767)
    return base64.b64encode(np.ascontiguousarray(values, "<i2").tobytes()).decode("ascii")
