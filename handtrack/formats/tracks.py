"""A track in, tables out, and back.

* `poses.csv`: `frame,time,status,confidence,<joint>...,<joint>_sigma...`, degrees (model units where a joint slides);
* `covariance.csv`: `frame` and the upper triangle of the covariance, columns `a*b`, in those units squared;
* `evidence.csv`: `frame,edges,residual,visible_0,visible_1...`, what each pose rests on (residual empty without edges);
* `timing.csv`: `frame,seconds`, apart from the others because it differs from run to run.
"""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from ..kinematics.tree import Model
from ..track import LOST, TRACKED, UNCERTAIN, Track
from .poses import code_units
from .tables import Table, check_rising, integers, numbers, read_table, words
from .writing import write_text

STATUSES = (TRACKED, UNCERTAIN, LOST)
HEAD = ("frame", "time", "status", "confidence")


def write_track(folder: Path | str, track: Track, model: Model | None = None) -> None:
    """Write the four tables into a folder that exists; each is whole or absent.

    Parameters
    ----------
    model : Model or None
        Tells which joints slide; without it every joint is taken to turn, and written in degrees.

    Raises
    ------
    ValueError
        If a pose, sigma, covariance, time or confidence is not finite, or a status is unknown: tables never hold NaN.
    """
    _check(track)
    units = _units(track, model)
    folder = Path(folder)
    write_text(folder / "poses.csv", poses_text(track, units))
    write_text(folder / "covariance.csv", covariance_text(track, units))
    write_text(folder / "evidence.csv", evidence_text(track))
    write_text(
        folder / "timing.csv",
        _table(("frame", "seconds"), zip(map(str, track.frame), map(_short, track.seconds), strict=True)),
    )


def _check(track: Track) -> None:
    for name in ("time", "q", "sigma", "covariance", "confidence", "visible", "seconds"):
        bad = np.argwhere(~np.isfinite(getattr(track, name)))
        if bad.size:
            raise ValueError(f"track: {name} of row {bad[0][0]} is not finite; results hold finite numbers")
    for status in track.status:
        if status not in STATUSES:
            raise ValueError(f"track: status '{status}' is unknown; wanted: {', '.join(STATUSES)}")


def _units(track: Track, model: Model | None) -> Float[np.ndarray, " j"]:
    if model is None:
        return np.full(len(track.joint_names), math.radians(1.0))
    if model.joint_names != track.joint_names:
        raise ValueError(
            f"model: '{model.name}' has joints {model.joint_names}; the track's, {track.joint_names}, are wanted"
        )
    return code_units(model)


def _short(value: float) -> str:
    """Ten digits: far below any sigma, and the same text wherever rounding differs in the last bit."""
    return f"{float(value) + 0.0:.10g}"


def _table(names: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    return "\n".join([",".join(names), *(",".join(row) for row in rows)]) + "\n"


def poses_text(track: Track, units: Float[np.ndarray, " j"]) -> str:
    """Text of `poses.csv`."""
    names = [*HEAD, *track.joint_names, *(f"{joint}_sigma" for joint in track.joint_names)]
    q, sigma = track.q / units, track.sigma / units
    rows = (
        [
            str(track.frame[i]),
            _short(track.time[i]),
            str(track.status[i]),
            _short(track.confidence[i]),
            *map(_short, q[i]),
            *map(_short, sigma[i]),
        ]
        for i in range(track.frame.size)
    )
    return _table(names, rows)


def covariance_text(track: Track, units: Float[np.ndarray, " j"]) -> str:
    """Text of `covariance.csv`."""
    first, second = np.triu_indices(len(track.joint_names))
    names = ["frame", *(f"{track.joint_names[a]}*{track.joint_names[b]}" for a, b in zip(first, second, strict=True))]
    cells = (track.covariance / np.outer(units, units))[:, first, second]
    return _table(names, ([str(number), *map(_short, row)] for number, row in zip(track.frame, cells, strict=True)))


def evidence_text(track: Track) -> str:
    """Text of `evidence.csv`."""
    names = ["frame", "edges", "residual", *(f"visible_{link}" for link in range(track.visible.shape[1]))]
    residual = ["" if not math.isfinite(value) else _short(value) for value in track.residual]
    rows = (
        [str(track.frame[i]), str(track.edges[i]), residual[i], *map(_short, track.visible[i])]
        for i in range(track.frame.size)
    )
    return _table(names, rows)


def read_track(folder: Path | str, model: Model | None = None) -> Track:
    """Read a track back; only `poses.csv` is needed.

    Without `covariance.csv` the covariance is diagonal; without `evidence.csv` there are no edges and no links, and the
    residual is NaN; without `timing.csv` the seconds are NaN.

    Raises
    ------
    InputError
        For tables that are malformed or do not fit each other.
    """
    folder = Path(folder)
    table = read_table(folder / "poses.csv", HEAD)
    joints = _joint_columns(table)
    frame, time = integers(table, "frame"), numbers(table, "time")
    check_rising(table, "frame", frame)
    check_rising(table, "time", time)
    confidence = numbers(table, "confidence")
    if ((confidence < 0) | (confidence > 1)).any():
        line = table.lines[np.argmax((confidence < 0) | (confidence > 1))]
        raise InputError(f"{table.path}: line {line}: confidence: a number from 0 to 1 is wanted")
    q = _columns(table, joints)
    sigma = _columns(table, tuple(f"{joint}_sigma" for joint in joints))
    if (sigma < 0).any():
        line = table.lines[np.argmax((sigma < 0).any(axis=1))]
        raise InputError(f"{table.path}: line {line}: a sigma is negative; 0 or more is wanted")
    if model is not None and model.joint_names != joints:
        wanted = ", ".join(model.joint_names)
        raise InputError(f"{table.path}: line 1: its joints are not those of model '{model.name}'; wanted: {wanted}")
    units = np.full(len(joints), math.radians(1.0)) if model is None else code_units(model)
    covariance = _read_covariance(folder / "covariance.csv", frame, joints)
    if covariance is None:
        covariance = sigma[:, :, None] ** 2 * np.eye(len(joints))
    edges, residual, visible = _read_evidence(folder / "evidence.csv", frame)
    return Track(
        joint_names=joints,
        frame=frame,
        time=time,
        q=q * units,
        sigma=sigma * units,
        covariance=covariance * np.outer(units, units),
        status=np.array(words(table, "status", STATUSES), dtype=np.str_),
        confidence=confidence,
        residual=residual,
        visible=visible,
        edges=edges,
        seconds=_read_seconds(folder / "timing.csv", frame),
    )


def _joint_columns(table: Table) -> tuple[str, ...]:
    """Joint names of `poses.csv`: as many sigma columns follow, in the same order."""
    rest = table.names[len(HEAD) :]
    joints = rest[: len(rest) // 2]
    wanted = (*HEAD, *joints, *(f"{joint}_sigma" for joint in joints))
    if not joints or table.names != wanted:
        raise InputError(f"{table.path}: line 1: columns {','.join(HEAD)},<joint>...,<joint>_sigma... are wanted")
    return joints


def _columns(table: Table, names: Iterable[str]) -> Float[np.ndarray, "n c"]:
    columns = [numbers(table, name) for name in names]
    return np.stack(columns, axis=-1) if columns else np.zeros((table.lines.size, 0))


def _read_for(path: Path, frame: np.ndarray, needed: Iterable[str]) -> Table | None:
    """A table with one row for each of the frames, or None if there is no such file."""
    if not path.exists():
        return None
    table = read_table(path, tuple(needed))
    if not np.array_equal(integers(table, "frame"), frame):
        raise InputError(f"{path}: its frames are not those of poses.csv; one row for each is wanted")
    return table


def _read_covariance(path: Path, frame: np.ndarray, joints: tuple[str, ...]) -> Float[np.ndarray, "n j j"] | None:
    first, second = np.triu_indices(len(joints))
    names = [f"{joints[a]}*{joints[b]}" for a, b in zip(first, second, strict=True)]
    table = _read_for(path, frame, ["frame", *names])
    if table is None:
        return None
    covariance = np.empty((frame.size, len(joints), len(joints)))
    cells = _columns(table, names)
    covariance[:, first, second] = cells
    covariance[:, second, first] = cells
    return covariance


def _read_evidence(path: Path, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges, residual and visible share of each link."""
    table = _read_for(path, frame, ["frame", "edges", "residual"])
    if table is None:
        return np.zeros(frame.size, dtype=int), np.full(frame.size, math.nan), np.zeros((frame.size, 0))
    visible = _columns(table, [name for name in table.names if name.startswith("visible_")])
    return integers(table, "edges"), numbers(table, "residual", empty=True), visible


def _read_seconds(path: Path, frame: np.ndarray) -> Float[np.ndarray, " n"]:
    table = _read_for(path, frame, ["frame", "seconds"])
    return np.full(frame.size, math.nan) if table is None else numbers(table, "seconds")
