"""A finished dataset in, the page of `handtrack dataset browse` out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from synth.dataset.browse import Tile, browse_page
from synth.dataset.coco_decode import coco_decoded
from synth.dataset.decode import decoded, image_of
from synth.dataset.folder import frame_names
from synth.dataset.index import Row, read_index
from synth.dataset.plan import units
from synth.dataset.record import DATASET, DatasetRecord, read_dataset
from synth.dataset.sample_files import piece_entries
from synth.dataset.shards import members_of
from synth.dataset.store import Store, open_store, place, read

from ..errors import InputError
from ..formats import write_text

INDEX = "index.parquet"
MOST = 400  # tiles: a page of some 40 MB


def browse(uri: str, out: Path, count: int, seed: int, options: Sequence[str] = ()) -> int:
    """Write a page with some images of a dataset, drawn at random, and the distributions of all.

    Parameters
    ----------
    uri : str
        Folder or object store of any layout.
    count : int
        Images to show, 1 to 400; fewer where the dataset has fewer.
    seed : int
        Which ones.
    options : sequence of str
        `KEY=VALUE` for the store.

    Returns
    -------
    int
        Number of images shown.

    Raises
    ------
    InputError
        If there is no finished dataset, or a file of it is not what the index says.
    """
    if not 1 <= count <= MOST:
        raise InputError(f"--count: {count} given; 1 to {MOST} images were wanted")
    store = open_store(uri, options)
    rows = _index(store)
    number = np.sort(np.random.default_rng(seed).choice(len(rows), min(count, len(rows)), replace=False))
    chosen = [rows[k] for k in number.tolist()]
    record = _record(store)
    tiles = (
        _coco_tiles(store, record, chosen)
        if record is not None and record.layout == "coco"
        else [tile for row in chosen if (tile := _tile(store, row))]
    )
    write_text(Path(out), browse_page(uri.rstrip("/").rpartition("/")[2], tiles, rows))
    return len(tiles)


def _record(store: Store) -> DatasetRecord | None:
    content = _content(store, DATASET)
    return None if content is None else read_dataset(content, place(store, DATASET))


def _tile(store: Store, row: Row) -> Tile | None:
    files = _files(store, row)
    picture = next((file for file in files if file[0].startswith("image.")), None)
    labels = decoded(row.key, files)
    return None if picture is None else Tile(labels, picture)


def _coco_tiles(store: Store, record: DatasetRecord, chosen: Sequence[Row]) -> list[Tile]:
    """Tiles of a dataset whose annotations are those of COCO."""
    tiles = []
    for unit in units(record.count, record.unit_size):
        rows = {row.index: row for row in chosen if unit.first <= row.index < unit.first + unit.count}
        entries: dict[int, list[tuple[str, Any]]] = {index: [] for index in rows}
        for kind, entry in piece_entries(store, unit) if rows else ():
            entries.get(entry["id" if kind == "i" else "image_id"], []).append((kind, entry))
        for index, row in rows.items():
            name = next((str(entry["file_name"]) for kind, entry in entries[index] if kind == "i"), None)
            content = None if name is None else _content(store, f"images/{name}")
            if name is None or content is None:
                raise InputError(f"{place(store, 'images')}: has no image {row.key}")
            picture = (f"image.{name.rpartition('.')[2]}", content)
            tiles.append(
                Tile(coco_decoded(row, image_of(row.key, *picture, (row.height, row.width)), entries[index]), picture)
            )
    return tiles


def _index(store: Store) -> tuple[Row, ...]:
    where = place(store, INDEX)
    try:
        rows = read_index(read(store, INDEX))
    except OSError as error:
        if not _missing(error):
            raise
        raise InputError(f"{where}: no such file; a finished dataset is wanted") from error
    except ValueError as error:
        raise InputError(f"{where}: {str(error).partition(': ')[2]}") from error
    if not rows:
        raise InputError(f"{where}: has no image; at least one is wanted")
    return rows


def _files(store: Store, row: Row) -> Sequence[tuple[str, bytes]]:
    """Files of one image, from its stretch of an archive or from the folder of its sequence."""
    if not row.shard:
        found = [(extension, _content(store, name)) for extension, name in frame_names(row.sequence, row.frame)]
        files = [(extension, content) for extension, content in found if content is not None]
        if not files:
            raise InputError(f"{store.uri}: has no labels of image {row.index}; shards or sequence folders are wanted")
        return files
    content = _content(store, row.shard, row.offset, row.offset + row.size)
    where = f"{place(store, row.shard)}: image {row.key} at byte {row.offset}"
    try:
        key, files = next(members_of(content or b""), ("", ()))
    except ValueError as error:
        raise InputError(f"{where}: {str(error).partition(': ')[2]}") from error
    if key != row.key:
        raise InputError(f"{where}: {key or 'nothing'} is there; the archive that the index describes is wanted")
    return files


def _content(store: Store, name: str, start: int | None = None, stop: int | None = None) -> bytes | None:
    try:
        return read(store, name, start, stop)
    except OSError as error:
        if not _missing(error):
            raise
        return None


def _missing(error: OSError) -> bool:
    return isinstance(error, FileNotFoundError) or isinstance(error.__cause__, FileNotFoundError)
