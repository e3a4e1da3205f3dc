"""A finished dataset in, what is wrong with it out: counts, checksums, label rules, and images rendered again.

Each unit is checked by itself, so that workers share the work; files of the whole are checked by the parent.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from handtrack.errors import InputError

from .engine import Engine
from .job import INDEX, Job, image_files, rows_name, unit_rows
from .masks import mask_of_text
from .plan import Unit, units
from .record import (
    COMPLETE,
    DATASET,
    DatasetRecord,
    FileRecord,
    Layout,
    UnitRecord,
    read_complete,
    read_dataset,
    read_unit,
    record_name,
)
from .rules import broken_rules, checked
from .sample_files import piece_entries, stored_images
from .store import Store, digest, names, place, read

MOST = 20  # problems that are told of one unit
Done = Callable[[int], None]


@dataclass(frozen=True, slots=True)
class UnitVerdict:
    """What was found in one unit.

    Attributes
    ----------
    unit : Unit
    labels, rendered : int
        Images whose labels were held against the rules, and that were rendered again.
    files : tuple of str
        Names of its files.
    size : int
        Bytes of them.
    problems : tuple of str
    """

    unit: Unit
    labels: int
    rendered: int
    files: tuple[str, ...]
    size: int
    problems: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Verdict:
    """What was found in a dataset; `problems` is empty where all is well.

    Attributes
    ----------
    images, units, files, size : int
        How many were looked at; bytes.
    labels, rendered : int
        Images whose labels were held against the rules, and that were rendered again.
    problems : tuple of str
    """

    images: int
    units: int
    files: int
    size: int
    labels: int
    rendered: int
    problems: tuple[str, ...]


def verified(
    store: Store, record: DatasetRecord, job: Job | None, share: float, engine: Engine[UnitVerdict], done: Done
) -> Verdict:
    """Check a whole dataset.

    Parameters
    ----------
    record : DatasetRecord
        From `opened`.
    job : Job, optional
        To render images again with; without it none are.
    share : float
        Of the images, that are rendered again; at least one image is.
    """
    sizes = names(store)
    todo = units(record.count, record.unit_size)
    again = chosen(record.count, share) if job is not None else ()
    task = partial(unit_verdict, store, record.layout, job, again)
    found: dict[Unit, UnitVerdict] = {}
    for verdict in engine(task, todo):
        found[verdict.unit] = verdict
        done(sum(unit.count for unit in found))
    known = {name for verdict in found.values() for name in verdict.files}
    whole, problems = _whole(store, record, sizes)
    problems += [problem for unit in todo for problem in found[unit].problems]
    known |= {file.name for file in whole} | {COMPLETE}
    strangers = sorted(set(sizes) - known)
    problems += [f"{place(store, name)}: belongs to nothing" for name in strangers[:MOST]]
    return Verdict(
        record.count,
        len(todo),
        len(sizes),
        sum(sizes.values()),
        sum(verdict.labels for verdict in found.values()),
        sum(verdict.rendered for verdict in found.values()),
        tuple(problems),
    )


def opened(store: Store) -> DatasetRecord:
    """The record of the dataset in a store.

    Raises
    ------
    InputError
        If there is none.
    """
    where = place(store, DATASET)
    try:
        return read_dataset(read(store, DATASET), where)
    except FileNotFoundError as error:
        raise InputError(f"{where}: is not there; a dataset of `handtrack dataset` was wanted") from error


def chosen(count: int, share: float) -> tuple[int, ...]:
    """Numbers of the images that are rendered again, spread evenly.

    >>> chosen(400, 0.01)
    (50, 150, 250, 350)
    """
    many = min(count, max(1, round(count * share))) if share > 0 else 0
    return tuple(int((k + 0.5) * count / many) for k in range(many))


def unit_verdict(store: Store, layout: Layout, job: Job | None, again: Sequence[int], unit: Unit) -> UnitVerdict:
    """Check one unit."""
    name = record_name(unit)
    try:
        record = read_unit(read(store, name), unit, place(store, name))
    except (InputError, FileNotFoundError) as error:
        wrong = f"{place(store, name)}: is not there" if isinstance(error, FileNotFoundError) else str(error)
        return UnitVerdict(unit, 0, 0, (), 0, (f"{wrong}: the unit is not finished",))
    files = tuple(file.name for file in record.files)
    size = sum(file.size for file in record.files)
    problems = _damaged(store, record.files)
    labels = rendered = 0
    if not problems:
        try:
            labels, rendered, problems = _looked_at(store, layout, job, again, record)
        except (InputError, ValueError) as error:
            problems = [f"{place(store, name)}: {error}"]
    return UnitVerdict(unit, labels, rendered, (*files, name), size, tuple(problems[:MOST]))


def _looked_at(store: Store, layout: Layout, job: Job | None, again: Sequence[int], record: UnitRecord):
    """Images with labels, images rendered again, problems, of a unit whose files are whole."""
    unit, problems = record.unit, []
    rows = unit_rows(store, unit)
    if [row.index for row in rows] != list(range(unit.first, unit.first + unit.count)):
        problems.append(f"{place(store, rows_name(unit))}: does not name every image of the unit once")
    labels = rendered = 0
    wanted = {index for index in again if unit.first <= index < unit.first + unit.count}
    for image in stored_images(store, layout, record, rows):
        if image.labels is not None:
            labels += 1
            problems += [f"image {image.key}: {line}" for line in broken_rules(checked(image.key, image.labels))]
        if job is not None and image.index in wanted:
            rendered += 1
            problems += _differs(image.key, image_files(job, image.index), dict(image.files))
    if layout == "coco":
        labels, more = _pieces(store, unit)
        problems += more
    return labels, rendered, problems


def _differs(key: str, made: Sequence[tuple[str, bytes]], there: Mapping[str, bytes]) -> list[str]:
    """Files that rendering again does not give back."""
    if sorted(name for name, _ in made) != sorted(there):
        return [f"image {key}: has the files {', '.join(sorted(there))}; rendered again it has others"]
    return [f"image {key}: {name} differs from what is rendered again" for name, c in made if there[name] != c]


def _pieces(store: Store, unit: Unit) -> tuple[int, list[str]]:
    """Images in a unit's COCO annotations, and the rules that these break."""
    images, problems = 0, []
    for kind, entry in piece_entries(store, unit):
        if kind == "i":
            images += 1
            continue
        height, width = entry["segmentation"]["size"]
        modal, amodal = (
            mask_of_text(entry[n]["counts"], (height, width)) for n in ("segmentation", "amodal_segmentation")
        )
        what = f"annotation {entry['id']}"
        if modal.sum() != entry["area"]:
            problems.append(f"{what}: its mask has {modal.sum()} pixels, its area is {entry['area']}")
        if (modal & ~amodal).any():
            problems.append(f"{what}: a modal mask is not inside its amodal mask")
        x, y, w, h = entry["bbox"]
        rows, columns = np.nonzero(modal)
        if rows.size and not (x <= columns.min() and columns.max() < x + w and y <= rows.min() and rows.max() < y + h):
            problems.append(f"{what}: its mask reaches out of its box")
        if not 0.0 <= entry["visible_fraction"] <= 1.0:
            problems.append(f"{what}: visible fraction {entry['visible_fraction']}")
    if images != unit.count:
        problems.append(f"unit {unit.number}: has annotations of {images} images, {unit.count} are wanted")
    return images, problems


def _whole(store: Store, record: DatasetRecord, sizes: Mapping[str, int]) -> tuple[tuple[FileRecord, ...], list[str]]:
    """Files of the whole, and what is wrong with them."""
    where = place(store, COMPLETE)
    if COMPLETE not in sizes:
        return (), [f"{where}: is not there: the dataset is not finished, run the same command again"]
    try:
        count, files = read_complete(read(store, COMPLETE), where)
    except InputError as error:
        return (), [str(error)]
    problems = _damaged(store, files)
    if count != record.count:
        problems.append(f"{where}: {count} images, {record.count} are wanted")
    if INDEX not in {file.name for file in files}:
        problems.append(f"{where}: names no {INDEX}")
    return files, problems


def _damaged(store: Store, files: Sequence[FileRecord]) -> list[str]:
    """Files that are missing or are not what their record says."""
    out = []
    for file in files:
        try:
            if digest(store, file.name) != file.sha256:
                out.append(f"{place(store, file.name)}: is damaged; remove it and run the same command again")
        except FileNotFoundError:
            out.append(f"{place(store, file.name)}: is missing; run the same command again")
    return out
