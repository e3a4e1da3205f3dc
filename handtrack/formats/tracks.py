"""A track in, tables out, and back.

* `poses.csv`: `frame,time,status,confidence,<joint>...,<joint>_sigma...`, degrees (model units where a joint slides);
* `covariance.csv`: `frame` and the upper triangle of the covariance, columns `a*b`, in those units squared;
* `information.csv`: `frame` and the upper triangle of what the images alone say of the independent joints, columns
  `a*b`, one over those units squared; all zero where they say nothing;
* `evidence.csv`: `frame,edges,residual,visible_0,visible_1...`, what each pose rests on (residual empty without edges);
  with several views also `view0_edges,view0_visible_0,view0_visible_1...,view1_edges...`;
* `rivals.csv`: another pose that the images could not tell from the tracked one, see `rivals`; if the track says;
* `timing.csv`: `frame,seconds`, apart from the others because it differs from run to run.
"""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from ..kinematics.tree import Model
from ..track import LOST, TRACKED, UNCERTAIN, Track
from .poses import code_units
from .rivals import read_rivals, rivals_rows
from .tables import Table, check_rising, integers, numbers, read_table, words
from .writing import write_text

STATUSES = (TRACKED, UNCERTAIN, LOST)
HEAD = ("frame", "time", "status", "confidence")


def write_track(folder: Path | str, track: Track, model: Model | None = None) -> None:
    """Write the tables into a folder that exists; each is whole or absent.

    Parameters
    ----------
    model : Model or None
        Tells which joints slide and which are independent; without it every joint is taken to turn, written in degrees,
        and to be independent.

    Raises
    ------
    ValueError
        If a pose, sigma, covariance, time or confidence is not finite, or a status is unknown: tables never hold NaN.
        If the information is not that of the independent joints.
    """
    _check(track)
    units = _units(track, model)
    free = np.arange(len(track.joint_names)) if model is None else model.free
    if track.information.shape[1:] != (free.size, free.size):
        got = " x ".join(map(str, track.information.shape[1:]))
        raise ValueError(f"track: information is {got}; wanted that of the {free.size} independent joints")
    folder = Path(folder)
    write_text(folder / "poses.csv", poses_text(track, units))
    write_text(folder / "covariance.csv", covariance_text(track, units))
    write_text(folder / "information.csv", information_text(track, units, free))
    write_text(folder / "evidence.csv", evidence_text(track))
    header, *rows = [*rivals_rows(track, units)] or [[]]
    if header:
        write_text(folder / "rivals.csv", _table(header, rows))
    write_text(
        folder / "timing.csv",
        _table(("frame", "seconds"), zip(map(str, track.frame), map(_short, track.seconds), strict=True)),
    )


def _check(track: Track) -> None:
    for name in ("time", "q", "sigma", "covariance", "information", "confidence", "visible", "seconds"):
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
    return _symmetric_text(track.frame, track.joint_names, track.covariance / np.outer(units, units))


def information_text(track: Track, units: Float[np.ndarray, " j"], free: Int[np.ndarray, " k"]) -> str:
    """Text of `information.csv`; `free` are the independent joints."""
    names = tuple(track.joint_names[joint] for joint in free)
    return _symmetric_text(track.frame, names, track.information * np.outer(units[free], units[free]))


def _symmetric_text(frame: Int[np.ndarray, " n"], names: tuple[str, ...], values: Float[np.ndarray, "n k k"]) -> str:
    """A symmetric matrix for each frame, by its upper triangle."""
    first, second = np.triu_indices(len(names))
    cells = values[:, first, second]
    return _table(("frame", *_pairs(names)), ([str(n), *map(_short, row)] for n, row in zip(frame, cells, strict=True)))


def _pairs(names: tuple[str, ...]) -> list[str]:
    """Columns of an upper triangle.

    >>> _pairs(("a", "b"))
    ['a*a', 'a*b', 'b*b']
    """
    first, second = np.triu_indices(len(names))
    return [f"{names[a]}*{names[b]}" for a, b in zip(first, second, strict=True)]


def evidence_text(track: Track) -> str:
    """Text of `evidence.csv`."""
    names = ["frame", "edges", "residual", *(f"visible_{link}" for link in range(track.visible.shape[1]))]
    residual = ["" if not math.isfinite(value) else _short(value) for value in track.residual]
    rows = [
        [str(track.frame[i]), str(track.edges[i]), residual[i], *map(_short, track.visible[i])]
        for i in range(track.frame.size)
    ]
    if track.view_edges is not None and track.view_visible is not None and track.view_edges.shape[1] > 1:
        for view in range(track.view_edges.shape[1]):
            names += _view_columns(view, track.visible.shape[1])
            for i, row in enumerate(rows):
                row += [str(track.view_edges[i, view]), *map(_short, track.view_visible[i, view])]
    return _table(names, rows)


def _view_columns(view: int, links: int) -> list[str]:
    return [f"view{view}_edges", *(f"view{view}_visible_{link}" for link in range(links))]


def read_track(folder: Path | str, model: Model | None = None) -> Track:
    """Read a track back; only `poses.csv` is needed.

    Without `covariance.csv` the covariance is diagonal; without `information.csv` the information is zero; without
    `evidence.csv` there are no edges and no links, and the residual is NaN; without `rivals.csv` the track does not say
    whether there were any; without `timing.csv` the seconds are NaN.

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
    covariance = _read_symmetric(folder / "covariance.csv", frame, joints)
    if covariance is None:
        covariance = sigma[:, :, None] ** 2 * np.eye(len(joints))
    free = _independent(folder / "information.csv", joints) if model is None else model.free
    information = _read_symmetric(folder / "information.csv", frame, tuple(joints[joint] for joint in free))
    if information is None:
        information = np.zeros((frame.size, free.size, free.size))
    edges, residual, visible, view_edges, view_visible = _read_evidence(folder / "evidence.csv", frame)
    rival, rival_weight = read_rivals(folder / "rivals.csv", frame, joints, units)
    return Track(
        joint_names=joints,
        frame=frame,
        time=time,
        q=q * units,
        sigma=sigma * units,
        covariance=covariance * np.outer(units, units),
        information=information / np.outer(units[free], units[free]),
        status=np.array(words(table, "status", STATUSES), dtype=np.str_),
        confidence=confidence,
        residual=residual,
        visible=visible,
        edges=edges,
        seconds=_read_seconds(folder / "timing.csv", frame),
        view_edges=view_edges,
        view_visible=view_visible,
        rival=rival,
        rival_weight=rival_weight,
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


def _read_symmetric(path: Path, frame: np.ndarray, names: tuple[str, ...]) -> Float[np.ndarray, "n k k"] | None:
    """A symmetric matrix for each frame from its upper triangle; None without the file."""
    first, second = np.triu_indices(len(names))
    table = _read_for(path, frame, ["frame", *_pairs(names)])
    if table is None:
        return None
    values = np.empty((frame.size, len(names), len(names)))
    cells = _columns(table, _pairs(names))
    values[:, first, second] = cells
    values[:, second, first] = cells
    return values


def _independent(path: Path, joints: tuple[str, ...]) -> Int[np.ndarray, " k"]:
    """The joints that a table of information is about; all of them without the table."""
    if not path.exists():
        return np.arange(len(joints))
    names = read_table(path, ("frame",)).names
    return np.array([i for i, joint in enumerate(joints) if f"{joint}*{joint}" in names], dtype=int)


_Evidence = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]


def _read_evidence(path: Path, frame: np.ndarray) -> _Evidence:
    """Edges, residual and visible share of each link; then edges and visible shares in each view, if it says."""
    table = _read_for(path, frame, ["frame", "edges", "residual"])
    if table is None:
        return np.zeros(frame.size, dtype=int), np.full(frame.size, math.nan), np.zeros((frame.size, 0)), None, None
    visible = _columns(table, [name for name in table.names if name.startswith("visible_")])
    whole = integers(table, "edges"), numbers(table, "residual", empty=True), visible
    views = 0
    while f"view{views}_edges" in table.names:
        views += 1
    if not views:
        return *whole, None, None
    columns = [_view_columns(view, visible.shape[1]) for view in range(views)]
    missing = next((name for names in columns for name in names if name not in table.names), None)
    if missing is not None:
        raise InputError(f"{path}: line 1: column '{missing}' is missing; every view has a column for each link")
    edges = np.stack([integers(table, names[0]) for names in columns], axis=1)
    return *whole, edges, np.stack([_columns(table, names[1:]) for names in columns], axis=1)


def _read_seconds(path: Path, frame: np.ndarray) -> Float[np.ndarray, " n"]:
    table = _read_for(path, frame, ["frame", "seconds"])
    return np.full(frame.size, math.nan) if table is None else numbers(table, "seconds")
