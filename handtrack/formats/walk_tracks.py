"""The track of a walk in, `walk.csv`, `posture.csv` and `keypoints.csv` out; and back. Metres, world frame.

* `walk.csv`: `frame,pelvis_x,pelvis_y,pelvis_z,qw,qx,qy,qz,sx,sy,sz,time,sigma_heading,in_view,status`; `sx`, `sy`,
  `sz` are standard deviations of the place, `sigma_heading` that of the heading in degrees;
* `posture.csv`: `frame,<joint>...,<joint>_sigma...`, degrees;
* `keypoints.csv`: `frame,keypoint,x,y,z`.

One row for each frame, and never NaN: where the camera saw nothing the sigmas grow, and the status says so.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from ..errors import InputError
from .skeletons import KEYPOINTS
from .tables import Table, check_rising, integers, numbers, read_table, words
from .writing import write_text

NAMES = ("walk.csv", "posture.csv", "keypoints.csv")
STATUSES = ("tracked", "predicted", "uncertain", "lost")
COLUMNS = (
    "frame", "pelvis_x", "pelvis_y", "pelvis_z", "qw", "qx", "qy", "qz", "sx", "sy", "sz",
    "time", "sigma_heading", "in_view", "status",
)  # fmt: skip
POINT_COLUMNS = ("frame", "keypoint", "x", "y", "z")


@dataclass(frozen=True, slots=True, eq=False)
class WalkTrack:
    """Where a person walked, and how, frame by frame of the suit.

    Attributes
    ----------
    frame, time : (f,), (f,)
        Number and seconds.
    p, wxyz : (f, 3), (f, 4)
        Pelvis in the world; unit quaternion world_R_pelvis, real part first.
    sigma, sigma_heading : (f, 3), (f,)
        Standard deviations of the place along the world's axes, metres, and of the heading, radians.
    joint_names : tuple of j str
    posture, sigma_posture : (f, j), (f, j)
        Joint angles and their standard deviations, radians.
    keypoints : (f, 16, 3)
        In the order of `formats.skeletons.KEYPOINTS`.
    in_view : (f,)
        Whether the camera saw the person.
    status : (f,) of str
        One of `STATUSES`: `tracked` with the camera's help, `predicted` without, `uncertain` after a re-start or with a
        wide spread, `lost` where the estimate is no better than a guess.
    seconds : (f,)
        Computing time; NaN after reading.
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    frame: Int[np.ndarray, " f"]
    time: Float[np.ndarray, " f"]
    p: Float[np.ndarray, "f 3"]
    wxyz: Float[np.ndarray, "f 4"]
    sigma: Float[np.ndarray, "f 3"]
    sigma_heading: Float[np.ndarray, " f"]
    joint_names: tuple[str, ...]
    posture: Float[np.ndarray, "f j"]
    sigma_posture: Float[np.ndarray, "f j"]
    keypoints: Float[np.ndarray, "f 16 3"]
    in_view: Bool[np.ndarray, " f"]
    status: np.ndarray
    seconds: Float[np.ndarray, " f"]
    warnings: tuple[str, ...] = ()


def walk_texts(track: WalkTrack) -> tuple[str, str, str]:
    """Texts of the three files, in the order of `NAMES`.

    Raises
    ------
    ValueError
        If a number is not finite, or a status is unknown.
    """
    for name in ("time", "p", "wxyz", "sigma", "sigma_heading", "posture", "sigma_posture", "keypoints"):
        values = getattr(track, name)
        bad = ~np.isfinite(values.reshape(track.frame.size, -1)).all(axis=1)
        if bad.any():
            raise ValueError(f"track: {name}: row {int(bad.argmax())} is not finite; results hold finite numbers")
    unknown = sorted(set(track.status.tolist()) - set(STATUSES))
    if unknown:
        raise ValueError(f"track: status '{unknown[0]}' is unknown; wanted: {', '.join(STATUSES)}")
    frames = track.frame.tolist()
    pelvis = np.column_stack([track.p, track.wxyz, track.sigma, track.time, np.degrees(track.sigma_heading)])
    rows = zip(frames, pelvis, track.in_view.astype(int).tolist(), track.status.tolist(), strict=True)
    walk = [",".join(COLUMNS), *(f"{n},{_row(values)},{seen},{status}" for n, values, seen, status in rows)]
    heads = [*track.joint_names, *(f"{name}_sigma" for name in track.joint_names)]
    angles = np.degrees(np.column_stack([track.posture, track.sigma_posture]))
    posture = [",".join(["frame", *heads]), *(f"{n},{_row(row)}" for n, row in zip(frames, angles, strict=True))]
    points = [",".join(POINT_COLUMNS)]
    for n, row in zip(frames, track.keypoints, strict=True):
        points += [f"{n},{name},{_row(p)}" for name, p in zip(KEYPOINTS, row, strict=True)]
    walk_text, posture_text, points_text = ("\n".join(lines) + "\n" for lines in (walk, posture, points))
    return walk_text, posture_text, points_text


def write_walk_track(folder: Path | str, track: WalkTrack) -> None:
    """Write the three files into a folder, each whole or not at all; see `walk_texts`."""
    for name, text in zip(NAMES, walk_texts(track), strict=True):
        write_text(Path(folder) / name, text)


def read_walk_track(folder: Path | str) -> WalkTrack:
    """Read the three files of a result folder.

    Raises
    ------
    InputError
        For a table that is malformed, whose frames do not rise, or whose frames differ from those of `walk.csv`.
    """
    folder = Path(folder)
    table = read_table(folder / NAMES[0], COLUMNS)
    frame, time = integers(table, "frame"), numbers(table, "time")
    check_rising(table, "frame", frame)
    check_rising(table, "time", time)
    values = np.column_stack([numbers(table, name) for name in COLUMNS[1:11]])
    seen = integers(table, "in_view")
    _refuse(table, seen > 1, "in_view: 0 or 1 is wanted")
    _refuse(table, np.asarray((values[:, 7:] < 0).any(axis=1)), "sx, sy, sz: 0 or more is wanted")
    names, posture, sigma_posture = _posture(folder / NAMES[1], frame)
    return WalkTrack(
        frame=frame,
        time=time,
        p=values[:, :3].copy(),
        wxyz=values[:, 3:7].copy(),
        sigma=values[:, 7:].copy(),
        sigma_heading=np.radians(numbers(table, "sigma_heading")),
        joint_names=names,
        posture=posture,
        sigma_posture=sigma_posture,
        keypoints=_points(folder / NAMES[2], frame),
        in_view=seen.astype(bool),
        status=np.array(words(table, "status", STATUSES), dtype=np.str_),
        seconds=np.full(frame.size, np.nan),
    )


def _posture(
    path: Path, frame: Int[np.ndarray, " f"]
) -> tuple[tuple[str, ...], Float[np.ndarray, "f j"], Float[np.ndarray, "f j"]]:
    """Joint names, angles and sigmas."""
    table = read_table(path, ("frame",))
    names = tuple(name for name in table.names[1:] if not name.endswith("_sigma"))
    if not names or table.names != ("frame", *names, *(f"{name}_sigma" for name in names)):
        raise InputError(f"{path}: line 1: frame, joints and the same joints with '_sigma' are wanted as columns")
    _same_frames(table, integers(table, "frame"), frame)
    values = np.radians(np.column_stack([numbers(table, name) for name in table.names[1:]]))
    return names, values[:, : len(names)].copy(), values[:, len(names) :].copy()


def _points(path: Path, frame: Int[np.ndarray, " f"]) -> Float[np.ndarray, "f 16 3"]:
    table = read_table(path, POINT_COLUMNS)
    kind = np.array([KEYPOINTS.index(name) for name in words(table, "keypoint", KEYPOINTS)], dtype=int)
    order = np.argsort(integers(table, "frame") * len(KEYPOINTS) + kind, kind="stable")
    _same_frames(table, integers(table, "frame")[order], np.repeat(frame, len(KEYPOINTS)))
    if (kind[order] != np.tile(np.arange(len(KEYPOINTS)), frame.size)).any():
        raise InputError(f"{path}: all 16 keypoints are wanted once for each frame")
    p = np.column_stack([numbers(table, axis) for axis in "xyz"])
    return p[order].reshape(frame.size, len(KEYPOINTS), 3)


def _same_frames(table: Table, found: Int[np.ndarray, " n"], wanted: Int[np.ndarray, " m"]) -> None:
    if not np.array_equal(found, wanted):
        raise InputError(f"{table.path}: its frames are not those of {NAMES[0]}; the same are wanted")


def _refuse(table: Table, bad: Bool[np.ndarray, " n"], text: str) -> None:
    rows = np.flatnonzero(bad)
    if rows.size:
        raise InputError(f"{table.path}: line {table.lines[rows[0]]}: {text}")


def _row(values: Float[np.ndarray, " d"]) -> str:
    return ",".join(f"{value + 0.0:.10g}" for value in values.tolist())
