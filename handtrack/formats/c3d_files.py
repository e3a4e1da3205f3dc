"""Labelled people in, a C3D file out, and markers of a C3D file back. Needs the extra `handtrack[c3d]` (ezc3d).

Millimetres, y up. A gap has the residual -1, as the format wants it; residuals of other points are 0.
"""

import tempfile
from pathlib import Path
from types import ModuleType

import numpy as np

from ..errors import InputError
from .markers import Markers
from .paths import read_bytes
from .people import People
from .people_markers import people_markers
from .writing import write_bytes

MOST_BYTES = 500_000_000
_UNITS = (("mm", 1.0), ("cm", 10.0), ("m", 1000.0))


def _library() -> ModuleType:
    try:
        import ezc3d
    except ImportError as error:
        raise InputError("C3D files need a package that is not installed; 'pip install handtrack[c3d]'") from error
    return ezc3d


def write_c3d(path: Path | str, people: People) -> None:
    """Write people as markers, whole or not at all; see `people_markers`.

    Raises
    ------
    InputError
        If ezc3d is not installed.
    """
    write_bytes(Path(path), c3d_bytes(people_markers(people)))


def c3d_bytes(markers: Markers) -> bytes:
    """Content of a C3D file.

    Raises
    ------
    ValueError
        If there is no marker or frame, which the format cannot hold.
    InputError
        If ezc3d is not installed.
    """
    m, n = markers.places.shape[:2]
    if not (m and n):
        raise ValueError(f"markers: got {m} frames of {n} markers, wanted at least one of each")
    file = _library().c3d()
    point = file["parameters"]["POINT"]
    point["RATE"]["value"] = [markers.rate]
    point["LABELS"]["value"] = list(markers.names)
    point["UNITS"]["value"] = ["mm"]
    for name, axis in (("X_SCREEN", "+X"), ("Y_SCREEN", "+Y")):
        file.add_parameter("POINT", name, [axis])
    places = np.moveaxis(markers.places, 2, 0)
    gap = np.isnan(places).any(axis=0)
    points = np.ones((4, n, m))
    points[:3] = np.where(gap, 0.0, places).transpose(0, 2, 1)
    file["data"]["points"] = points
    file["data"]["meta_points"] = {
        "residuals": np.where(gap, -1.0, 0.0).T[None],
        "camera_masks": np.zeros((7, n, m), dtype=bool),
    }
    with tempfile.TemporaryDirectory() as folder:  # the library writes to names only
        name = Path(folder) / "people.c3d"
        file.write(str(name))
        return name.read_bytes()


def read_c3d(path: Path | str) -> Markers:
    """Read the markers of a C3D file, millimetres, in the axes of the file; NaN where one was not seen.

    Raises
    ------
    InputError
        If ezc3d is not installed, or the file is none, has no markers, or gives a marker twice.
    """
    path = Path(path)
    read_bytes(path, MOST_BYTES)
    try:
        file = _library().c3d(str(path))
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"{path}: is no C3D file ({' '.join(str(error).split())[:120]})") from error
    point = file["parameters"]["POINT"]
    places = file["data"]["points"][:3].transpose(2, 1, 0).astype(float)
    # a parameter holds 255 labels; more are in LABELS2, LABELS3 ...
    lists = ["LABELS", *(f"LABELS{i}" for i in range(2, 2 + places.shape[1] // 255))]
    names = tuple(label for one in lists if one in point for label in point[one]["value"])[: places.shape[1]]
    rate = float(point["RATE"]["value"][0]) if len(point["RATE"]["value"]) else 0.0
    if not names or len(names) < places.shape[1] or not places.shape[0] or not rate > 0:
        raise InputError(f"{path}: has no markers; a C3D file with labelled points and a rate is wanted")
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: marker {twice!r} is given twice")
    unit = (point["UNITS"]["value"] or ["mm"])[0].strip()
    if unit not in dict(_UNITS):
        raise InputError(f"{path}: its unit is {unit[:20]!r}; {', '.join(name for name, _ in _UNITS)} is wanted")
    unseen = np.isnan(places).any(axis=-1) | (file["data"]["meta_points"]["residuals"][0].T < 0)
    return Markers(names, np.where(unseen[..., None], np.nan, dict(_UNITS)[unit] * places), rate)
