"""A scene, a seed and a number of images in; the files of every unit, and those of the whole, out.

The seam between images and the engine: here shots are drawn, rendered, encoded and packed.

    shards     shards/00000.tar, rows/00000.parquet                      index.parquet
    coco       images/000000000.jpg, pieces/00000.jsonl, rows/...        annotations/*.json, index.parquet
    folders    sequence_000000/..., rows/00000.parquet                   index.parquet
"""

import hashlib
import io
import tarfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import metadata
from pathlib import Path

from handtrack.errors import InputError

from ..labels.labelled import Labelled
from ..labels.look import Canvas, labelled
from . import coco, folder
from .draw import Source, prepare, shot
from .encode import Sample, encoded
from .index import Row, index_bytes, placed, read_index, row_of
from .plan import Unit
from .record import DatasetRecord, Layout, UnitRecord
from .scene_file import SceneFile, read_scene
from .shards import BLOCK, shard_bytes, spans_of
from .store import Blob, Store, read

SCENE, INDEX = "scene.yaml", "index.parquet"
_PACKAGES = ("handtrack", "numpy", "scipy", "numba", "opencv-python-headless", "pyarrow")
_BLOCK = 2**20


@dataclass(frozen=True, slots=True)
class Job:
    """All that the bytes of a dataset depend on, with the files to read it from.

    Attributes
    ----------
    scene : Path
        Scene file.
    surface : Path or None
        Mesh for the scene's skinned hands that name none.
    layout : str
    seed, count, unit_size : int
    inputs : tuple of (str, str)
        Name and SHA-256 of the scene file and of the files it refers to.
    """

    scene: Path
    surface: Path | None
    layout: Layout
    seed: int
    count: int
    unit_size: int
    inputs: tuple[tuple[str, str], ...]


def job_of(scene: Path, layout: Layout, seed: int, count: int, unit_size: int, surface: Path | None = None) -> Job:
    """The job that makes a dataset of a scene.

    Raises
    ------
    InputError
        If the scene, or a file it refers to, is bad.
    """
    source = read_scene(scene)
    prepare(source, seed, surface)  # bad input is said at once, not by a worker
    return Job(
        scene.absolute(), surface and surface.absolute(), layout, seed, count, unit_size, _inputs(source, surface)
    )


def dataset_record(job: Job) -> DatasetRecord:
    """What `dataset.json` says."""
    return DatasetRecord(job.layout, job.seed, job.count, job.unit_size, job.inputs, versions())


def fixed_files(job: Job) -> tuple[Blob, ...]:
    """Files that belong to no unit: the scene."""
    return ((SCENE, job.scene.read_bytes()),)


def unit_files(job: Job, unit: Unit) -> tuple[Blob, ...]:
    """Files of a unit; they depend on the job and the unit's number alone.

    Raises
    ------
    InputError
        If the scene's files are no longer what they were when the job began, or an image has values that its files
        cannot hold.
    """
    scene, source = _loaded(job)
    numbers = range(unit.first, unit.first + unit.count)
    canvas = Canvas(scene.schema.image.width, scene.schema.image.height)
    images = (labelled(shot(source, index), canvas) for index in numbers)  # each is used up before the next
    if job.layout == "shards":
        return _shard(unit, (encoded(image, scene.labels, job.seed) for image in images))
    rows: list[Row] = []
    if job.layout == "coco":
        blobs = coco.unit_files(_noted(images, rows), scene.labels, unit.number)
    else:
        frames = [folder.frame_files(image, scene.labels, job.seed) for image in _noted(images, rows)]
        about = [_description(job, sequence) for sequence in _sequences_begun(unit, scene.frames)]
        blobs = tuple(blob for files in (*frames, *about) for blob in files)
    return (*blobs, _rows_blob(unit, rows))


def image_files(job: Job, index: int) -> tuple[Blob, ...]:
    """Files of one image, made again. In an archive they are called `{key}.{extension}`."""
    scene, source = _loaded(job)
    image = labelled(shot(source, index))
    if job.layout == "shards":
        sample = encoded(image, scene.labels, job.seed)
        return tuple((f"{sample.key}.{extension}", content) for extension, content in sample.files)
    if job.layout == "coco":
        return coco.unit_files([image], scene.labels, 0)[:-1]
    return folder.frame_files(image, scene.labels, job.seed)


def merged_files(layout: Layout, store: Store, done: Sequence[UnitRecord]) -> Iterator[Blob]:
    """Files of the whole from those of the units."""
    if layout == "coco":
        yield from coco.merged(read(store, coco.piece_name(record.unit.number)) for record in done)
    yield INDEX, index_bytes(row for record in done for row in unit_rows(store, record.unit))


def unit_rows(store: Store, unit: Unit) -> tuple[Row, ...]:
    """What the index says of a unit's images."""
    return read_index(read(store, rows_name(unit)))


def shard_name(unit: Unit) -> str:
    """The archive of a unit."""
    return f"shards/{unit.name}.tar"


def rows_name(unit: Unit) -> str:
    """The part of the index that is about a unit."""
    return f"rows/{unit.name}.parquet"


def versions() -> tuple[tuple[str, str], ...]:
    """Packages that take part in making the bytes."""
    return tuple((name, _version(name)) for name in _PACKAGES)


def _shard(unit: Unit, samples: Iterable[Sample]) -> tuple[Blob, ...]:
    """The archive of a unit, as `shard_bytes` would make it of all samples, with no more than one of them in memory."""
    stream, rows = io.BytesIO(), []
    for sample in samples:
        (_, size), start = spans_of([sample])[0], stream.tell()
        stream.write(memoryview(shard_bytes([sample]))[:size])
        rows += placed([sample.row], shard_name(unit), [(start, size)])
    end = stream.tell() + 2 * BLOCK
    stream.write(bytes(2 * BLOCK + -end % tarfile.RECORDSIZE))
    return (shard_name(unit), stream.getvalue()), _rows_blob(unit, rows)


def _rows_blob(unit: Unit, rows: Iterable[Row]) -> Blob:
    return rows_name(unit), index_bytes(rows)


def _noted(images: Iterable[Labelled], rows: list[Row]) -> Iterator[Labelled]:
    """The images, one by one, while their rows gather."""
    for image in images:
        rows.append(row_of(image))
        yield image


def _sequences_begun(unit: Unit, frames: int) -> range:
    """Sequences whose first frame is in the unit: it describes them."""
    return range(-(-unit.first // frames), -(-(unit.first + unit.count) // frames))


def _description(job: Job, sequence: int) -> tuple[Blob, ...]:
    scene, source = _loaded(job)
    first = sequence * scene.frames
    last = min(first + scene.frames, job.count)
    return folder.description_files([shot(source, index) for index in range(first, last)], scene.fps)


@lru_cache(maxsize=1)
def _loaded(job: Job) -> tuple[SceneFile, Source]:
    """The scene and what it refers to, once for each process."""
    scene = read_scene(job.scene)
    if _inputs(scene, job.surface) != job.inputs:
        raise InputError(f"{job.scene}: it, or a file it refers to, has changed since the run began")
    return scene, prepare(scene, job.seed, job.surface)


def _inputs(scene: SceneFile, surface: Path | None) -> tuple[tuple[str, str], ...]:
    """Name and SHA-256 of the scene and its files; names are those that the scene uses."""
    found = [(SCENE, hashlib.sha256(scene.text.encode()).hexdigest())]
    found += [(name, _digest(path)) for name, path in scene.inputs]
    if surface is not None:
        found.append(("surface", _digest(surface)))
    return tuple(found)


def _digest(path: Path) -> str:
    total = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK):
            total.update(block)
    return total.hexdigest()


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def with_scene(job: Job, scene: Path) -> Job:
    """The same job, read from another copy of its scene."""
    return replace(job, scene=scene.absolute())
