"""A unit of a dataset in its store in, the files of its images one after the other out, whatever the layout."""

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from handtrack.errors import InputError

from . import coco
from .index import Row
from .job import shard_name
from .plan import Unit
from .record import Layout, UnitRecord
from .shards import members_of
from .store import Store, place, read


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """Files of one image.

    Attributes
    ----------
    index : int
    key : str
    files : tuple of (str, bytes)
        By the names that `job.image_files` gives them.
    labels : tuple of (str, bytes) or None
        By their extensions, as `decode.decoded` takes them; None where files hold labels of many images.
    """

    index: int
    key: str
    files: tuple[tuple[str, bytes], ...]
    labels: tuple[tuple[str, bytes], ...] | None


def stored_images(store: Store, layout: Layout, record: UnitRecord, rows: Sequence[Row]) -> Iterator[Stored]:
    """Images of a unit, in the order of its rows.

    Raises
    ------
    InputError
        If rows and files disagree.
    """
    if layout == "shards":
        yield from _of_shard(store, record.unit, rows)
    elif layout == "coco":
        yield from _of_coco(store, record, rows)
    else:
        yield from _of_folders(store, record, rows)


def piece_entries(store: Store, unit: Unit) -> Iterator[tuple[str, Any]]:
    """Kind (i, h, p) and content of each entry of a unit's COCO annotations."""
    for line in read(store, coco.piece_name(unit.number)).splitlines():
        kind = chr(line[0])
        if kind in "ihp":
            yield kind, json.loads(line[1:])


def _of_shard(store: Store, unit: Unit, rows: Sequence[Row]) -> Iterator[Stored]:
    name = shard_name(unit)
    content = read(store, name)
    row_of: Mapping[str, Row] = {row.key: row for row in rows}
    found = 0
    for key, files in members_of(content):
        row = row_of.get(key)
        if row is None or row.shard != name:
            raise InputError(f"{place(store, name)}: holds image {key}, of which the index says nothing")
        start = content[row.offset : row.offset + len(key) + 1]
        if start != key.encode() + b".":
            raise InputError(f"{place(store, name)}: image {key} is not at byte {row.offset}, where the index has it")
        found += 1
        yield Stored(row.index, key, tuple((f"{key}.{extension}", data) for extension, data in files), files)
    if found != len(rows):
        raise InputError(f"{place(store, name)}: holds {found} images; {len(rows)} are wanted")


def _of_coco(store: Store, record: UnitRecord, rows: Sequence[Row]) -> Iterator[Stored]:
    name_of = {file.name.rpartition("/")[2].partition(".")[0]: file.name for file in record.files}
    for row in rows:
        name = name_of.get(row.key)
        if name is None:
            raise InputError(f"{place(store, 'images')}: has no image {row.key}")
        yield Stored(row.index, row.key, ((name, read(store, name)),), None)


def _of_folders(store: Store, record: UnitRecord, rows: Sequence[Row]) -> Iterator[Stored]:
    names: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for file in record.files:
        parts = file.name.split("/")
        if len(parts) == 3:
            names[parts[0], parts[2].partition(".")[0]].append(file.name)
    for row in rows:
        own = names.get((f"sequence_{row.sequence:06d}", f"{row.frame:06d}"))
        if own is None:
            raise InputError(f"{store.uri}: has no files of frame {row.frame} of sequence {row.sequence}")
        files = tuple((name, read(store, name)) for name in own)
        yield Stored(row.index, row.key, files, tuple((_extension(name), content) for name, content in files))


def _extension(name: str) -> str:
    """Extension of a file in an archive that would hold what this file of a sequence folder holds.

    >>> _extension("sequence_000000/frames/000003.png"), _extension("sequence_000000/labels/000003.json")
    ('image.png', 'json')
    """
    _, folder, file = name.split("/")
    ending = file.partition(".")[2]
    return {"frames": "image." + ending, "labels": ending}.get(folder, f"{folder}.{ending}")
