"""A CSV file in, columns of checked numbers and words out.

UTF-8, comma separated, one header line. A needed column is present, every line has as many cells as the header, and
numbers are plain and finite (or an empty cell where the format allows one): `nan`, `inf` and `1_000` are errors that
name their line.
"""

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from .paths import read_bytes
from .yaml_files import shorten

LONGEST_GAP = 1.0  # seconds between rows without a warning

_PLAIN = re.compile(r"\s*[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?\s*", re.ASCII)


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Text cells of a CSV file.

    Attributes
    ----------
    names : tuple of str
        Column names, unique.
    columns : tuple of tuple of str
        Cells of each column.
    lines : (n,)
        Line of the file that each row ends on, from 1.
    """

    path: Path
    names: tuple[str, ...]
    columns: tuple[tuple[str, ...], ...]
    lines: Int[np.ndarray, " n"]


def read_table(path: Path, needed: Sequence[str] = ()) -> Table:
    """Read a CSV file whose header has the `needed` columns.

    Raises
    ------
    InputError
        If the file is missing, not UTF-8, has no header, repeats or lacks a column, or has a line of another length.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8 text") from error
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        for row in reader:
            if row:
                rows.append(row)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: {error}; comma separated values are wanted") from error
    if not rows:
        raise InputError(f"{path}: is empty; a header line {shorten(','.join(needed))} is wanted")
    names = tuple(name.strip() for name in rows[0])
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{path}: line {lines[0]}: column {shorten(name)} is given twice; names are unique")
    for name in needed:
        if name not in names:
            raise InputError(f"{path}: line {lines[0]}: column '{name}' is missing; wanted: {', '.join(needed)}")
    for row, line in zip(rows, lines, strict=True):
        if len(row) != len(names):
            raise InputError(f"{path}: line {line}: {len(row)} cells; {len(names)}, as in the header, are wanted")
    columns = tuple(zip(*rows[1:], strict=True)) if len(rows) > 1 else ((),) * len(names)
    return Table(path, names, columns, np.array(lines[1:], dtype=int))


def numbers(table: Table, name: str, empty: bool = False) -> Float[np.ndarray, " n"]:
    """A column of finite numbers; NaN for an empty cell where `empty` allows it.

    Raises
    ------
    InputError
        Naming line and column of the first cell that is none.
    """
    cells = table.columns[table.names.index(name)]
    values = np.full(len(cells), math.nan)
    for i, cell in enumerate(cells):
        if empty and not cell.strip():
            continue
        value = float(cell) if _PLAIN.fullmatch(cell) else math.nan
        if not math.isfinite(value):
            allowed = "a finite number or nothing" if empty else "a finite number"
            raise InputError(f"{table.path}: line {table.lines[i]}: {name}: {shorten(cell)} given; {allowed} is wanted")
        values[i] = value
    return values


def integers(table: Table, name: str, low: int = 0) -> Int[np.ndarray, " n"]:
    """A column of whole numbers of at least `low`."""
    values = numbers(table, name)
    bad = np.flatnonzero((values != np.floor(values)) | (values < low) | (values > 2**53))
    if bad.size:
        line, cell = table.lines[bad[0]], table.columns[table.names.index(name)][bad[0]]
        raise InputError(
            f"{table.path}: line {line}: {name}: {shorten(cell)} given; a whole number from {low} is wanted"
        )
    return values.astype(int)


def words(table: Table, name: str, known: Sequence[str]) -> tuple[str, ...]:
    """A column whose cells are each one of the `known` words."""
    cells = table.columns[table.names.index(name)]
    for cell, line in zip(cells, table.lines, strict=True):
        if cell not in known:
            raise InputError(f"{table.path}: line {line}: {name}: {shorten(cell)} given; wanted: {', '.join(known)}")
    return tuple(cells)


def check_rising(table: Table, name: str, values: Float[np.ndarray, " n"] | Int[np.ndarray, " n"]) -> None:
    """Refuse a column that does not rise from every row to the next."""
    bad = np.flatnonzero(np.diff(values) <= 0)
    if bad.size:
        i = int(bad[0]) + 1
        place = f"{table.path}: line {table.lines[i]}: {name}:"
        raise InputError(f"{place} {values[i]:g} after {values[i - 1]:g}; strictly rising values are wanted")


def gap_warnings(table: Table, time: Float[np.ndarray, " n"]) -> tuple[str, ...]:
    """A warning for the longest gap in time, in seconds, if it is over a second."""
    if time.size < 2 or np.diff(time).max() <= LONGEST_GAP:
        return ()
    i = int(np.diff(time).argmax())
    return (f"{table.path}: line {table.lines[i + 1]}: {time[i + 1] - time[i]:.3g} s pass without a row",)
