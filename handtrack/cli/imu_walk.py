"""Inertial logs in, a walk without keypoints out: the work of `handtrack body imu`."""

from pathlib import Path

import numpy as np

from ..body.imu_suit import SuitSegments, suit_segments
from ..body.orientation import FusionSettings, orientations
from ..body.posture import Body
from ..camera import Camera
from ..errors import InputError
from ..formats.imu_logs import ImuLogs
from ..formats.walks import NAME, Walk


def suit_of(logs: ImuLogs, body: Body, headings: str, folder: Path) -> SuitSegments:
    """Segments as `--headings` wants them.

    Raises
    ------
    InputError
        If the sensors have no orientations or no magnetometer, or their names are those of no segments.
    """
    try:
        if headings == "sensors":
            wxyz = logs.wxyz
            if np.isnan(wxyz).any():
                raise ValueError("a sensor has no Quaternion.csv; --headings rates or magnetic was wanted")
        else:
            wxyz = orientations(logs, FusionSettings(magnetic=headings == "magnetic"))
        return suit_segments(logs, wxyz, body)
    except ValueError as refused:
        raise InputError(f"{folder}: {refused}") from refused


def walk_of(suit: SuitSegments, camera: Camera, height: float, out: Path) -> Walk:
    """The walk that a suit saw; its camera has no frames yet."""
    f = suit.time.size
    return Walk(
        path=out / NAME,
        fps=float(1.0 / np.median(np.diff(suit.time))),
        camera=camera,
        height=height,
        measurements=(),
        frame=np.arange(f),
        time=suit.time,
        p=suit.p,
        wxyz=suit.wxyz,
        camera_frame=np.arange(0),
        camera_time=np.zeros(0),
        uv=np.zeros((0, 16, 2)),
        confidence=np.zeros((0, 16)),
        truth=None,
    )


def facts(suit: SuitSegments, out: Path) -> dict[str, object]:
    """What a machine wants to know of it."""
    way = suit.p[:, 0, :2]
    return {
        "walk": str(out / NAME),
        "frames": int(suit.time.size),
        "seconds": float(suit.time[-1] - suit.time[0]),
        "way_m": float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()),
        "ended_m": float(np.linalg.norm(way[-1] - way[0])),
        "warnings": list(suit.warnings),
    }
