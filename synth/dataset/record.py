"""What a dataset is made of in, its record out; and what a unit or the whole consists of.

    dataset.json               from the start: scene, seed, count and versions, all that the bytes depend on
    records/00000.json         after its files: a unit is finished when its record is there
    complete.json              at the very end

None of them holds a time, a host, a number of workers or a path outside the dataset.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from handtrack.errors import InputError

from .plan import Unit
from .store import Blob

Layout = Literal["shards", "coco", "folders"]
LAYOUTS: tuple[Layout, ...] = ("shards", "coco", "folders")
DATASET, COMPLETE, RECORDS = "dataset.json", "complete.json", "records"
FORMAT, UNIT_FORMAT, COMPLETE_FORMAT = "handtrack/dataset-1", "handtrack/dataset-unit-1", "handtrack/dataset-complete-1"


@dataclass(frozen=True, slots=True)
class DatasetRecord:
    """All that the bytes of a dataset depend on.

    Attributes
    ----------
    layout : "shards", "coco" or "folders"
    seed, count, unit_size : int
    inputs : tuple of (str, str)
        Name and SHA-256 of the scene file and of what it refers to.
    versions : tuple of (str, str)
        Packages that take part in making the bytes.
    """

    layout: Layout
    seed: int
    count: int
    unit_size: int
    inputs: tuple[tuple[str, str], ...]
    versions: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class FileRecord:
    """Name within the dataset, size in bytes and SHA-256 of a file."""

    name: str
    size: int
    sha256: str


@dataclass(frozen=True, slots=True)
class UnitRecord:
    """A finished unit and its files."""

    unit: Unit
    files: tuple[FileRecord, ...]


def file_record(blob: Blob) -> FileRecord:
    """The record of a file.

    >>> file_record(("a.txt", b"")).size
    0
    """
    name, content = blob
    return FileRecord(name, len(content), hashlib.sha256(content).hexdigest())


def dataset_text(record: DatasetRecord) -> bytes:
    """Content of `dataset.json`."""
    return _text(
        {
            "format": FORMAT,
            "layout": record.layout,
            "seed": record.seed,
            "count": record.count,
            "unit_size": record.unit_size,
            "inputs": dict(record.inputs),
            "versions": dict(record.versions),
        }
    )


def read_dataset(content: bytes, where: str) -> DatasetRecord:
    """The record that `dataset_text` wrote.

    Parameters
    ----------
    where : str
        What error messages call it.

    Raises
    ------
    InputError
        If it is none.
    """
    data = _data(content, where, FORMAT)
    try:
        return DatasetRecord(
            _layout(data["layout"]),
            _whole(data["seed"]),
            _whole(data["count"], 1),
            _whole(data["unit_size"], 1),
            tuple((str(key), str(value)) for key, value in data["inputs"].items()),
            tuple((str(key), str(value)) for key, value in data["versions"].items()),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _no_record(where, error, FORMAT) from error


def difference(there: DatasetRecord, here: DatasetRecord) -> str | None:
    """The first thing in which two datasets differ, in words; None if they are the same.

    >>> one = DatasetRecord("shards", 1, 10, 5, (), ())
    >>> difference(one, DatasetRecord("shards", 2, 10, 5, (), ()))
    'seed 1 there, 2 here'
    """
    for field, name in (("layout", "format"), ("seed", "seed"), ("count", "count"), ("unit_size", "shard size")):
        a, b = getattr(there, field), getattr(here, field)
        if a != b:
            return f"{name} {a} there, {b} here"
    for field in ("inputs", "versions"):
        a, b = dict(getattr(there, field)), dict(getattr(here, field))
        for name in sorted({*a, *b}):
            if a.get(name) != b.get(name):
                words = [_short(value) for value in (a.get(name), b.get(name))]
                return f"{name} {words[0]} there, {words[1]} here"
    return None


def record_name(unit: Unit) -> str:
    """Where the record of a unit is."""
    return f"{RECORDS}/{unit.name}.json"


def unit_text(record: UnitRecord) -> bytes:
    """Content of a unit's record."""
    unit = record.unit
    return _text(
        {
            "format": UNIT_FORMAT,
            "unit": unit.number,
            "first": unit.first,
            "count": unit.count,
            "files": _entries(record.files),
        }
    )


def read_unit(content: bytes, unit: Unit, where: str) -> UnitRecord:
    """The record of a unit.

    Raises
    ------
    InputError
        If it is none, or that of another unit.
    """
    data = _data(content, where, UNIT_FORMAT)
    try:
        found = Unit(_whole(data["unit"]), _whole(data["first"]), _whole(data["count"], 1))
        files = _files(data["files"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _no_record(where, error, UNIT_FORMAT) from error
    if found != unit:
        raise InputError(f"{where}: says unit {found.number} with {found.count} images; {unit} was wanted")
    return UnitRecord(found, files)


def complete_text(count: int, files: tuple[FileRecord, ...]) -> bytes:
    """Content of `complete.json`: the files that no unit's record names, records included."""
    return _text({"format": COMPLETE_FORMAT, "count": count, "files": _entries(files)})


def read_complete(content: bytes, where: str) -> tuple[int, tuple[FileRecord, ...]]:
    """Number of images, and files, of `complete.json`.

    Raises
    ------
    InputError
        If it is none.
    """
    data = _data(content, where, COMPLETE_FORMAT)
    try:
        return _whole(data["count"], 1), _files(data["files"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _no_record(where, error, COMPLETE_FORMAT) from error


def present(files: tuple[FileRecord, ...], sizes: Mapping[str, int]) -> bool:
    """Whether all files are there with their sizes."""
    return all(sizes.get(file.name) == file.size for file in files)


def _entries(files: tuple[FileRecord, ...]) -> list[dict[str, str | int]]:
    return [{"name": file.name, "bytes": file.size, "sha256": file.sha256} for file in files]


def _files(entries: list[dict[str, object]]) -> tuple[FileRecord, ...]:
    return tuple(FileRecord(str(e["name"]), _whole(e["bytes"]), str(e["sha256"])) for e in entries)


def _layout(value: object) -> Layout:
    for known in LAYOUTS:
        if value == known:
            return known
    raise ValueError(f"layout {value!r}; one of {', '.join(LAYOUTS)} was wanted")


def _whole(value: object, least: int = 0) -> int:
    if not isinstance(value, int) or value < least:
        raise ValueError(f"{value!r} where a whole number of at least {least} was wanted")
    return value


def _text(data: dict[str, object]) -> bytes:
    return (json.dumps(data, indent=1, sort_keys=True) + "\n").encode("ascii")


def _data(content: bytes, where: str, form: str) -> dict:
    try:
        data = json.loads(content)
    except ValueError as error:
        raise _no_record(where, error, form) from error
    if not isinstance(data, dict) or data.get("format") != form:
        raise InputError(f"{where}: has no `format: {form}`; a record of a dataset was wanted")
    return data


def _no_record(where: str, error: Exception, form: str) -> InputError:
    said = f"{error} is missing" if isinstance(error, KeyError) else str(error)
    return InputError(f"{where}: {said}; a record of {form} was wanted")


def _short(value: str | None) -> str:
    return "absent" if value is None else value[:16]
