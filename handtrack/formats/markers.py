"""Marker files in, places of named markers in every frame out: Qualisys tables (.tsv) and OpenSim's TRC (.trc).

A marker that was not seen has empty cells, zeros in all three (Qualisys), or NaN: it comes out as NaN. Lengths come out
in millimetres.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from .paths import read_bytes

MOST_BYTES = 500_000_000
_UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0}


@dataclass(frozen=True, slots=True, eq=False)
class Markers:
    """Places of markers, mm, NaN where they were not seen; `rate` in frames a second."""

    names: tuple[str, ...]
    places: Float[np.ndarray, "m n 3"]
    rate: float


def read_markers(path: Path | str) -> Markers:
    """Read a marker file by its ending.

    Raises
    ------
    InputError
        In one line with file, line and what was wanted: for an unknown ending, a header without rate or names, and
        rows that hold no numbers or too few.
    """
    path = Path(path)
    lines = read_bytes(path, MOST_BYTES).decode("utf-8", "replace").splitlines()
    if path.suffix.lower() == ".tsv":
        return _qualisys(path, lines)
    if path.suffix.lower() == ".trc":
        return _trc(path, lines)
    raise InputError(f"{path}: has the ending {path.suffix!r}; .tsv (Qualisys) or .trc is wanted")


def _qualisys(path: Path, lines: list[str]) -> Markers:
    """Header lines of a word and its values, a line of column names, then rows with or without frame and time."""
    header: dict[str, list[str]] = {}
    first = 0
    for number, line in enumerate(lines):
        cells = line.split("\t")
        if _number(cells[0]) is not None:
            first = number
            break
        header[cells[0].strip()] = [cell.strip() for cell in cells[1:]]
    names = tuple(name for name in header.get("MARKER_NAMES", []) if name)
    rate = _number((header.get("FREQUENCY") or [""])[0])
    if not names or rate is None or not rate > 0:
        raise InputError(f"{path}: line 1: its header lacks MARKER_NAMES or FREQUENCY; a Qualisys table is wanted")
    _unique(path, names)
    extra = 2 if "Frame" in header else 0
    places = _rows(path, lines, first, "\t", extra, len(names))
    places[(places == 0.0).all(axis=-1)] = np.nan
    return Markers(names, places, rate)


def _trc(path: Path, lines: list[str]) -> Markers:
    """Three header lines, names above their three columns, a line X1 Y1 Z1 ..., then rows with frame and time."""
    cut = "," if lines and lines[0].count(",") > lines[0].count("\t") else "\t"
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        raise InputError(f"{path}: line 1: no TRC file; PathFileType is wanted")
    facts = dict(zip((c.strip() for c in lines[1].split(cut)), (c.strip() for c in lines[2].split(cut)), strict=False))
    rate, unit = _number(facts.get("DataRate", "")), facts.get("Units", "mm")
    if rate is None or not rate > 0 or unit not in _UNITS:
        raise InputError(f"{path}: line 3: DataRate > 0 and Units out of {', '.join(_UNITS)} are wanted")
    names = tuple(cell.strip() for cell in lines[3].split(cut)[2:] if cell.strip())
    if not names:
        raise InputError(f"{path}: line 4: holds no marker names")
    _unique(path, names)
    first = next((i for i in range(4, len(lines)) if _number(lines[i].split(cut)[0]) is not None), len(lines))
    return Markers(names, _UNITS[unit] * _rows(path, lines, first, cut, 2, len(names)), rate)


def _unique(path: Path, names: tuple[str, ...]) -> None:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: marker {twice!r} is given twice")


def _rows(path: Path, lines: list[str], first: int, cut: str, extra: int, count: int) -> Float[np.ndarray, "m n 3"]:
    """Places from rows of cells, after `extra` ones that say frame and time."""
    rows = []
    for number in range(first, len(lines)):
        if not lines[number].strip():
            continue
        cells = lines[number].split(cut)[extra : extra + 3 * count]
        cells += [""] * (3 * count - len(cells))
        try:
            row = np.array([float(cell) if cell.strip() else np.nan for cell in cells])
        except ValueError as error:
            raise InputError(f"{path}: line {number + 1}: {error}; numbers are wanted") from error
        if np.isinf(row).any():
            raise InputError(f"{path}: line {number + 1}: holds an infinite number")
        rows.append(row)
    if not rows:
        raise InputError(f"{path}: holds no rows of places")
    places = np.stack(rows).reshape(len(rows), count, 3)
    places[np.isnan(places).any(axis=-1)] = np.nan
    return places


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
