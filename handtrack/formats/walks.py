"""A folder with `walk.yaml` (`format: handtrack/walk-1`) in, what a suit and a camera saw of a walk out; and back.

* `segments.csv`: `frame,time,segment,x,y,z,qw,qx,qy,qz`, metres, in the inertial suit's own drifting frame. A segment's
  origin is its proximal joint; in the neutral pose all have the axes x forward, y to the left, z up.
* `keypoints2d.csv`: `frame,time,keypoint,u,v,confidence`, pixels. An unseen keypoint has no coordinates, confidence 0.
* `truth.csv`: `frame,pelvis_x,pelvis_y,pelvis_z,qw,qx,qy,qz` and `truth_keypoints.csv`: `frame,keypoint,x,y,z`, in the
  world frame; both may be absent. Their frames are the suit's.

Suit and camera each have their own frames and times, at their own rates; samples may be missing, and rows may stand in
any order. Optional in `walk.yaml`: `measurements`, lengths of the person's segments in metres.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import Field, PositiveFloat

from ..camera import Camera
from ..errors import InputError
from .cameras import PerspectiveFile, camera_from_file, cameras_text
from .skeletons import KEYPOINTS
from .tables import LONGEST_GAP, Table, integers, numbers, read_table, words
from .writing import folder_written_whole
from .yaml_files import Strict, read_yaml, validate

NAME, FORMAT = "walk.yaml", "handtrack/walk-1"
SEGMENTS = (
    "pelvis", "trunk", "head", "left_upper_arm", "left_forearm", "right_upper_arm", "right_forearm",
    "left_thigh", "left_shank", "left_foot", "right_thigh", "right_shank", "right_foot",
)  # fmt: skip
UNUSED = ("neck", "left_shoulder", "right_shoulder", "left_hand", "right_hand", "left_toe", "right_toe")
SEGMENT_COLUMNS = ("frame", "time", "segment", "x", "y", "z", "qw", "qx", "qy", "qz")
KEYPOINT_COLUMNS = ("frame", "time", "keypoint", "u", "v", "confidence")
TRUTH_COLUMNS = ("frame", "pelvis_x", "pelvis_y", "pelvis_z", "qw", "qx", "qy", "qz")
TRUTH_POINT_COLUMNS = ("frame", "keypoint", "x", "y", "z")

MOST_FRAMES = 1_000_000
HIGHEST_FPS = 1e5
WIDEST = 5.0  # metres between two segments of one person: more is another unit
FARTHEST = 1e5  # metres
FARTHEST_PIXEL = 1e6
UNIT_TOLERANCE = 0.01  # of a quaternion's length
SLOW = 100.0  # times whose step is this many frames long count milliseconds


@dataclass(frozen=True, slots=True, eq=False)
class WalkTruth:
    """Where the person really was, at the suit's frames.

    Attributes
    ----------
    p, wxyz : (f, 3), (f, 4)
        Place and orientation, world_R_pelvis, of the pelvis in the world; NaN where unknown.
    keypoints : (f, 16, 3)
        In the order of `KEYPOINTS`, metres, world; NaN where unknown.
    """

    p: Float[np.ndarray, "f 3"]
    wxyz: Float[np.ndarray, "f 4"]
    keypoints: Float[np.ndarray, "f 16 3"]


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """What a suit and a camera saw.

    Attributes
    ----------
    path : Path
        The walk file.
    fps : float
        Nominal frames per second.
    camera : Camera
        Perspective; its R, t map world to camera.
    height : float
        Of the person, metres.
    measurements : tuple of (str, float)
        Measured lengths by name, metres; may be empty.
    frame, time : (f,), (f,)
        The suit's frames, without a gap, and their seconds, strictly rising.
    p, wxyz : (f, 13, 3), (f, 13, 4)
        Origins and unit quaternions, suit_R_segment, of `SEGMENTS` in the suit's frame; NaN where a sample is missing.
    camera_frame, camera_time : (c,), (c,)
        The camera's frames, without a gap, and their seconds, on the same clock.
    uv, confidence : (c, 16, 2), (c, 16)
        Pixels of `KEYPOINTS`, NaN where unseen, and 0..1, 0 where unseen.
    truth : WalkTruth or None
    warnings : tuple of str
        What was accepted with care, a line each.
    """

    path: Path
    fps: float
    camera: Camera
    height: float
    measurements: tuple[tuple[str, float], ...]
    frame: Int[np.ndarray, " f"]
    time: Float[np.ndarray, " f"]
    p: Float[np.ndarray, "f 13 3"]
    wxyz: Float[np.ndarray, "f 13 4"]
    camera_frame: Int[np.ndarray, " c"]
    camera_time: Float[np.ndarray, " c"]
    uv: Float[np.ndarray, "c 16 2"]
    confidence: Float[np.ndarray, "c 16"]
    truth: WalkTruth | None
    warnings: tuple[str, ...] = ()


class _Measurements(Strict):
    hip: PositiveFloat | None = None
    shoulder: PositiveFloat | None = None
    lumbar: PositiveFloat | None = None
    trunk: PositiveFloat | None = None
    neck: PositiveFloat | None = None
    head: PositiveFloat | None = None
    upper_arm: PositiveFloat | None = None
    forearm: PositiveFloat | None = None
    thigh: PositiveFloat | None = None
    shank: PositiveFloat | None = None
    foot: PositiveFloat | None = None
    ankle: PositiveFloat | None = None


class _WalkFile(Strict):
    format: Literal["handtrack/walk-1"]
    fps: Annotated[float, Field(gt=0, le=HIGHEST_FPS)]
    camera: Annotated[PerspectiveFile, Field()]
    height_m: Annotated[float, Field(ge=0.5, le=2.5)]
    measurements: _Measurements = _Measurements()


def read_walk(folder: Path | str, with_keypoints: bool = True) -> Walk:
    """Read a walk folder, or its `walk.yaml`.

    Parameters
    ----------
    with_keypoints : bool
        If false, `keypoints2d.csv` is not read and may be absent: the camera has no frames then.

    Raises
    ------
    InputError
        In one line with file, place and what was wanted: for a walk file that is not one, malformed tables, unknown
        segments or keypoints, quaternions that are no rotations, and numbers that look like another unit.
    """
    path = Path(folder)
    path = path / NAME if path.is_dir() else path
    document = read_yaml(path)
    entry = validate(document, _WalkFile)
    camera = camera_from_file(entry.camera, document, ("camera",))
    notes: list[str] = []
    frame, time, p, wxyz = _segments(path.parent / "segments.csv", entry.fps, notes)
    camera_frame, camera_time, uv, confidence = np.arange(0), np.zeros(0), np.zeros((0, 16, 2)), np.zeros((0, 16))
    if with_keypoints:
        camera_frame, camera_time, uv, confidence = _keypoints(path.parent / "keypoints2d.csv", entry.fps, notes)
    return Walk(
        path=path,
        fps=entry.fps,
        camera=camera,
        height=entry.height_m,
        measurements=tuple((name, value) for name, value in entry.measurements if value is not None),
        frame=frame,
        time=time,
        p=p,
        wxyz=wxyz,
        camera_frame=camera_frame,
        camera_time=camera_time,
        uv=uv,
        confidence=confidence,
        truth=_truth(path.parent, frame, notes),
        warnings=tuple(notes),
    )


def _segments(
    path: Path, fps: float, notes: list[str]
) -> tuple[Int[np.ndarray, " f"], Float[np.ndarray, " f"], Float[np.ndarray, "f 13 3"], Float[np.ndarray, "f 13 4"]]:
    """Frames, times, origins and quaternions of the suit."""
    table = read_table(path, SEGMENT_COLUMNS)
    names = words(table, "segment", (*SEGMENTS, *UNUSED))
    kind = np.array([SEGMENTS.index(name) if name in SEGMENTS else -1 for name in names], dtype=int)
    values = np.column_stack([numbers(table, name, empty=True) for name in SEGMENT_COLUMNS[3:]])
    frame = _frame_numbers(table)
    known = ~np.isnan(values)
    _refuse(table, known.any(axis=1) != known.all(axis=1), "x ... qz: only some are given; all or none are wanted")
    _refuse(table, np.abs(values[:, :3]).max(axis=1, initial=0.0) > FARTHEST, f"x, y, z: beyond {FARTHEST:g} m")
    length = np.linalg.norm(values[:, 3:], axis=1)
    _refuse(table, np.abs(length - 1.0) > UNIT_TOLERANCE, "qw, qx, qy, qz: a unit quaternion is wanted")
    values[:, 3:] /= length[:, None]
    frames, time = _frame_times(table, frame, fps, notes)
    if (kind < 0).any():
        notes.append(f"{path}: segment '{names[int((kind < 0).argmax())]}' and its like are not used")
    out = _spread(table, frame - frames[0], kind, values, (frames.size, len(SEGMENTS)), "segment")
    apart = np.abs(out[..., :3] - out[:, :1, :3]).max(axis=(1, 2), initial=0.0, where=~np.isnan(out[..., :3]))
    wide = frames[apart > WIDEST]
    if wide.size:
        raise InputError(
            f"{path}: frame {wide[0]}: segments lie more than {WIDEST:g} m from the pelvis, as if in millimetres; "
            "metres are wanted"
        )
    return frames, time, out[..., :3].copy(), out[..., 3:].copy()


def _keypoints(
    path: Path, fps: float, notes: list[str]
) -> tuple[Int[np.ndarray, " c"], Float[np.ndarray, " c"], Float[np.ndarray, "c 16 2"], Float[np.ndarray, "c 16"]]:
    """Frames, times, pixels and confidences of the camera."""
    table = read_table(path, KEYPOINT_COLUMNS)
    kind = np.array([KEYPOINTS.index(name) for name in words(table, "keypoint", KEYPOINTS)], dtype=int)
    uv = np.column_stack([numbers(table, name, empty=True) for name in "uv"])
    confidence = numbers(table, "confidence")
    known = ~np.isnan(uv)
    _refuse(table, known[:, 0] != known[:, 1], "u, v: only one is given; both or none are wanted")
    _refuse(table, np.abs(uv).max(axis=1, initial=0.0) > FARTHEST_PIXEL, f"u, v: beyond {FARTHEST_PIXEL:g} pixels")
    _refuse(table, (confidence < 0) | (confidence > 1), "confidence: a number from 0 to 1 is wanted")
    uv[confidence == 0] = np.nan
    confidence = np.where(np.isnan(uv[:, 0]), 0.0, confidence)
    frame = _frame_numbers(table)
    frames, time = _frame_times(table, frame, fps, notes)
    values = np.column_stack([uv, confidence])
    out = _spread(table, frame - frames[0], kind, values, (frames.size, len(KEYPOINTS)), "keypoint")
    return frames, time, out[..., :2].copy(), np.nan_to_num(out[..., 2], nan=0.0)


def _truth(folder: Path, frames: Int[np.ndarray, " f"], notes: list[str]) -> WalkTruth | None:
    """True pelvis and keypoints at the suit's frames; None without any file."""
    path, points = folder / "truth.csv", folder / "truth_keypoints.csv"
    if not path.is_file():
        return None
    table = read_table(path, TRUTH_COLUMNS)
    values = np.column_stack([numbers(table, name) for name in TRUTH_COLUMNS[1:]])
    length = np.linalg.norm(values[:, 3:], axis=1)
    _refuse(table, ~(np.abs(length - 1.0) <= UNIT_TOLERANCE), "qw, qx, qy, qz: a unit quaternion is wanted")
    values[:, 3:] /= length[:, None]
    at = _frame_numbers(table) - frames[0]
    inside = (at >= 0) & (at < frames.size)
    pelvis = _spread(table, at, np.zeros(at.size, dtype=int), values, (frames.size, 1), "frame", inside)[:, 0]
    absent = int(np.isnan(pelvis[:, 0]).sum())
    if absent:
        notes.append(f"{path}: has no truth for {absent} of {frames.size} frames")
    if not inside.all():
        notes.append(f"{path}: has truth for frames that the suit lacks; {int((~inside).sum())} rows are left out")
    keypoints = np.full((frames.size, len(KEYPOINTS), 3), np.nan)
    if points.is_file():
        table = read_table(points, TRUTH_POINT_COLUMNS)
        kind = np.array([KEYPOINTS.index(name) for name in words(table, "keypoint", KEYPOINTS)], dtype=int)
        p = np.column_stack([numbers(table, axis) for axis in "xyz"])
        at = _frame_numbers(table) - frames[0]
        inside = (at >= 0) & (at < frames.size)
        keypoints = _spread(table, at, kind, p, (frames.size, len(KEYPOINTS)), "keypoint", inside)
    return WalkTruth(pelvis[:, :3].copy(), pelvis[:, 3:].copy(), keypoints)


def _frame_numbers(table: Table) -> Int[np.ndarray, " n"]:
    frame = integers(table, "frame")
    _refuse(table, frame >= MOST_FRAMES, f"frame: a number below {MOST_FRAMES} is wanted")
    return frame


def _frame_times(
    table: Table, frame: Int[np.ndarray, " n"], fps: float, notes: list[str]
) -> tuple[Int[np.ndarray, " f"], Float[np.ndarray, " f"]]:
    """All frames from the first to the last that is named, and their seconds; those between are filled in."""
    if not frame.size:
        raise InputError(f"{table.path}: has a header and no row; at least one is wanted")
    given = numbers(table, "time")
    named, first, back = np.unique(frame, return_index=True, return_inverse=True)
    time = given[first]
    _refuse(table, given != time[back.reshape(-1)], "time: differs within one frame; the same for all rows is wanted")
    step = np.diff(time)
    late = np.zeros(frame.size, dtype=bool)
    late[first[1:]] = step <= 0
    _refuse(table, late, "time: is not after that of the frame before; strictly rising values are wanted")
    if step.size and np.median(step / np.diff(named)) * fps > SLOW:
        raise InputError(
            f"{table.path}: time: {np.median(step / np.diff(named)):.4g} a frame at {fps:g} frames a second, as if in "
            "milliseconds; seconds are wanted"
        )
    if step.size and step.max() > LONGEST_GAP:
        i = int(step.argmax())
        notes.append(f"{table.path}: line {table.lines[first[i + 1]]}: {step[i]:.3g} s pass without a row")
    frames = np.arange(named[0], named[-1] + 1)
    return frames, np.interp(frames, named, time)


def _spread(
    table: Table,
    at: Int[np.ndarray, " n"],
    kind: Int[np.ndarray, " n"],
    values: Float[np.ndarray, "n d"],
    shape: tuple[int, int],
    what: str,
    inside: Bool[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, "f k d"]:
    """Rows put in their places, NaN elsewhere; a row of unknown kind, or outside, is left out."""
    used = np.flatnonzero(kind >= 0 if inside is None else inside)
    cell = at[used] * shape[1] + kind[used]
    _, first, back = np.unique(cell, return_index=True, return_inverse=True)
    again = np.zeros(at.size, dtype=bool)
    again[used[first[back.reshape(-1)] != np.arange(cell.size)]] = True
    _refuse(table, again, f"{what}: is given twice for this frame; once is wanted")
    out = np.full((shape[0] * shape[1], values.shape[1]), np.nan)
    out[cell] = values[used]
    return out.reshape(*shape, -1)


def _refuse(table: Table, bad: Bool[np.ndarray, " n"], text: str) -> None:
    rows = np.flatnonzero(bad)
    if rows.size:
        raise InputError(f"{table.path}: line {table.lines[rows[0]]}: {text}")


def write_walk(folder: Path | str, walk: Walk, replace: bool = False) -> None:
    """Write a walk folder, whole or not at all; `walk.path` and `walk.warnings` are not used.

    A camera without frames gets no `keypoints2d.csv`.

    Raises
    ------
    InputError
        If `folder` is a file, or not empty and `replace` is false.
    """
    with folder_written_whole(Path(folder), replace) as partial:
        keys = [f"format: {FORMAT}\n", f"fps: {float(walk.fps)}\n", cameras_text([walk.camera])]
        keys.append(f"height_m: {float(walk.height)}\n")
        if walk.measurements:
            keys += ["measurements:\n", *(f"  {name}: {float(value)}\n" for name, value in walk.measurements)]
        for name, text in (
            (NAME, "".join(keys)),
            ("segments.csv", segments_text(walk)),
            *([("keypoints2d.csv", keypoints_text(walk))] if walk.camera_frame.size else []),
            *_truth_texts(walk),
        ):
            (partial / name).write_text(text, encoding="utf-8")


def segments_text(walk: Walk) -> str:
    """Text of `segments.csv`; a missing sample has no row."""
    lines = [",".join(SEGMENT_COLUMNS)]
    values = np.concatenate([walk.p, walk.wxyz], axis=-1)
    lines += [
        f"{walk.frame[i]},{_short(walk.time[i])},{SEGMENTS[k]},{_row(values[i, k])}"
        for i, k in np.argwhere(~np.isnan(values).any(axis=-1)).tolist()
    ]
    return "\n".join(lines) + "\n"


def keypoints_text(walk: Walk) -> str:
    """Text of `keypoints2d.csv`, all 16 keypoints of every frame."""
    lines = [",".join(KEYPOINT_COLUMNS)]
    for i, (frame, time) in enumerate(zip(walk.camera_frame.tolist(), walk.camera_time.tolist(), strict=True)):
        for k, name in enumerate(KEYPOINTS):
            seen = not np.isnan(walk.uv[i, k]).any()
            cells = f"{_row(walk.uv[i, k])},{_short(walk.confidence[i, k])}" if seen else ",,0"
            lines.append(f"{frame},{_short(time)},{name},{cells}")
    return "\n".join(lines) + "\n"


def _truth_texts(walk: Walk) -> tuple[tuple[str, str], ...]:
    """Names and texts of the truth's files; none without truth."""
    if walk.truth is None:
        return ()
    values = np.concatenate([walk.truth.p, walk.truth.wxyz], axis=-1)
    p = walk.truth.keypoints
    known, seen = (np.argwhere(~np.isnan(part).any(axis=-1)).tolist() for part in (values, p))
    pelvis = [",".join(TRUTH_COLUMNS), *(f"{walk.frame[i]},{_row(values[i])}" for (i,) in known)]
    points = [",".join(TRUTH_POINT_COLUMNS), *(f"{walk.frame[i]},{KEYPOINTS[k]},{_row(p[i, k])}" for i, k in seen)]
    return (("truth.csv", "\n".join(pelvis) + "\n"), ("truth_keypoints.csv", "\n".join(points) + "\n"))


def _short(value: float) -> str:
    """Ten digits: far below any noise, and the same text wherever rounding differs in the last bit."""
    return f"{float(value) + 0.0:.10g}"


def _row(values: Float[np.ndarray, " d"]) -> str:
    return ",".join(_short(value) for value in values.tolist())
