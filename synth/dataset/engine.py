"""Units of work in, a finished dataset in its store out; interrupted anywhere, the next run goes on.

    dataset.json ──► units, each: its files, then its record ──► merged files ──► complete.json

A unit is done when its record is there: files come before it, each whole or absent. So a run that finds a record
leaves the unit alone, and one that finds none makes it again, with the same bytes. The engine knows nothing of images:
it is given two functions, one that makes the files of a unit and one that makes the files of the whole.
"""

import multiprocessing
import os
import pickle
import signal
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import wait
from typing import Any, TypeVar

from handtrack.errors import InputError

from .plan import Unit, units
from .record import (
    COMPLETE,
    DATASET,
    DatasetRecord,
    FileRecord,
    UnitRecord,
    complete_text,
    dataset_text,
    difference,
    file_record,
    present,
    read_complete,
    read_dataset,
    read_unit,
    record_name,
    unit_text,
)
from .store import Blob, Store, clean, names, only_run, place, put, read

Make = Callable[[Unit], Sequence[Blob]]  # the files of a unit; picklable
Merge = Callable[[Store, Sequence[UnitRecord]], Iterable[Blob]]  # the files of the whole, from those of the units
T = TypeVar("T")
Engine = Callable[[Callable[[Unit], T], Sequence[Unit]], Iterator[T]]  # does a task for every unit, in any order
Done = Callable[[int, int], None]  # told how many images are done, and how many of them were before this run

# Not numba's: it reads its variable again whenever it compiles, and refuses a change; none of our kernels has threads.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
GO_ON = "what is finished stays, run again to go on"


class Stopped(RuntimeError):
    """A run ended before its dataset was whole, through nobody's bad input; the next run goes on from there."""


@dataclass(frozen=True, slots=True)
class Summary:
    """What a run did.

    Attributes
    ----------
    count, made : int
        Images of the dataset, and those that this run made.
    size : int
        Bytes of all files.
    """

    count: int
    made: int
    size: int


def run(
    store: Store,
    record: DatasetRecord,
    fixed: Sequence[Blob],
    make: Make,
    merge: Merge,
    engine: Engine[UnitRecord],
    done: Done,
) -> Summary:
    """Make a dataset, or what an earlier run left to make of it.

    Parameters
    ----------
    record : DatasetRecord
        What the dataset is.
    fixed : sequence of (str, bytes)
        Files that belong to no unit: the scene.
    make, merge : callable
        See above.
    engine : callable
        `serial`, or `pooled` or one of Dask with its workers bound.
    done : callable

    Raises
    ------
    InputError
        If the store holds something else, or making the files met bad input.
    Stopped
        If a file could not be written or a worker was lost.
    """
    todo = units(record.count, record.unit_size)
    try:
        with only_run(store):
            clean(store)
            sizes = _begun(store, record, fixed)
            finished = {r.unit: r for r in (_finished(store, unit, sizes) for unit in todo) if r is not None}
            before = sum(unit.count for unit in finished)
            done(before, before)
            _work(store, [unit for unit in todo if unit not in finished], make, engine, finished, done)
            whole = _end(store, record, fixed, merge, [finished[unit] for unit in todo])
            clean(store)
    except OSError as error:
        raise Stopped(_words(error)) from error
    size = sum(file.size for r in finished.values() for file in r.files) + sum(file.size for file in whole)
    return Summary(record.count, record.count - before, size)


def finish_unit(store: Store, make: Make, unit: Unit) -> UnitRecord:
    """Make a unit, write its files, and then its record."""
    blobs = make(unit)
    done = UnitRecord(unit, tuple(file_record(blob) for blob in blobs))
    put(store, blobs)
    put(store, [(record_name(unit), unit_text(done))])
    return done


def serial(task: Callable[[Unit], T], todo: Sequence[Unit]) -> Iterator[T]:
    """One unit after the other, in this process."""
    return map(task, todo)


def pooled(task: Callable[[Unit], T], todo: Sequence[Unit], workers: int) -> Iterator[T]:
    """Units as the processes of a pool finish them.

    Each process has a pipe of its own, so that one that is killed, even in the middle of an answer, shows as the end of
    its pipe; the pools of the standard library share one, and may wait for ever for the other half.

    Raises
    ------
    Stopped
        If a worker is lost.
    """
    if workers < 1:
        raise ValueError(f"workers: {workers}; at least 1 was wanted")
    rest = iter(todo)
    with _processes(task, min(workers, len(todo))) as pipes:
        try:
            busy = {pipe for pipe in pipes if _given(pipe, rest)}
            while busy:
                for pipe in wait(list(busy)):
                    fine, answer = pipe.recv()  # type: ignore[union-attr]
                    if not fine:
                        raise answer
                    if not _given(pipe, rest):
                        busy.remove(pipe)
                    yield answer
        except (EOFError, BrokenPipeError, ConnectionResetError) as error:
            raise Stopped(f"a worker process was lost (killed, or out of memory); {GO_ON}") from error


def _given(pipe: Any, rest: Iterator[Unit]) -> bool:
    """Give a worker its next unit; False if there is none."""
    unit = next(rest, None)
    if unit is not None:
        pipe.send(unit)
    return unit is not None


@contextmanager
def _processes(task: Callable[[Unit], T], count: int) -> Iterator[list[Any]]:
    """Start workers, and let them end with the block; gives the parent's ends of their pipes."""
    context = multiprocessing.get_context("spawn")  # forks of a process with threads may hang
    started, pipes = [], []
    try:
        with one_thread():
            for _ in range(count):
                here, there = context.Pipe()
                pipes.append(here)
                process = context.Process(target=_serve, args=(there, task), daemon=True)
                process.start()
                started.append(process)
                there.close()  # the worker alone holds it now
        yield pipes
        for pipe in pipes:
            pipe.send(None)
    except BaseException:
        for process in started:
            process.terminate()
        raise
    finally:
        for process in started:
            process.join()
        for pipe in pipes:
            pipe.close()


def _serve(pipe: Any, task: Callable[[Unit], T]) -> None:
    """A worker: units in, answers out. It leaves interrupts to its parent, and ends when that ends or is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(multiprocessing.parent_process(),), daemon=True).start()
    while (unit := pipe.recv()) is not None:
        try:
            answer = True, task(unit)
        except Exception as error:  # noqa: BLE001 - the parent raises it again
            answer = False, _sendable(error)
        pipe.send(answer)


def _sendable(error: Exception) -> Exception:
    """The failure itself, or its words where it cannot be sent."""
    try:
        error.add_note(traceback.format_exc())
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - whatever keeps it from being sent
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)


@contextmanager
def one_thread() -> Iterator[None]:
    """Let processes that are started meanwhile compute with one thread each."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _begun(store: Store, record: DatasetRecord, fixed: Sequence[Blob]):
    """Make sure that the store holds this dataset, or nothing yet; returns the sizes of its files."""
    sizes = names(store)
    where = place(store, DATASET)
    if DATASET in sizes:
        other = difference(read_dataset(read(store, DATASET), where), record)
        if other is not None:
            raise InputError(f"{where}: another dataset: {other}; a new or empty folder, or the same job, was wanted")
    elif sizes:
        raise InputError(f"{store.uri}: holds other files ({min(sizes)}); a new or empty folder was wanted")
    blobs = [(DATASET, dataset_text(record)), *fixed]
    for blob in blobs:
        if blob[0] not in sizes or read(store, blob[0]) != blob[1]:
            put(store, [blob])
    return names(store)


def _finished(store: Store, unit: Unit, sizes) -> UnitRecord | None:
    """The record of a unit whose files are all there."""
    name = record_name(unit)
    if name not in sizes:
        return None
    try:
        found = read_unit(read(store, name), unit, place(store, name))
    except InputError:
        return None  # damaged: made again
    return found if present(found.files, sizes) else None


def _work(store: Store, todo: Sequence[Unit], make: Make, engine: Engine[UnitRecord], finished, done: Done) -> None:
    """Let an engine finish units; adds their records to `finished`."""
    if not todo:
        return
    before = total = sum(unit.count for unit in finished)
    each = engine(partial(finish_unit, store, make), todo)
    try:
        for unit_record in each:
            finished[unit_record.unit] = unit_record
            total += unit_record.unit.count
            done(total, before)
    except BaseException:
        close = getattr(each, "close", None)
        if close is not None:
            close()  # workers end first, ...
        clean(store)  # ... so that nothing half-written stays
        raise


def _end(
    store: Store, record: DatasetRecord, fixed: Sequence[Blob], merge: Merge, done: Sequence[UnitRecord]
) -> tuple[FileRecord, ...]:
    """Write what belongs to the whole, unless that is there; returns the files that belong to no unit."""
    sizes = names(store)
    if COMPLETE in sizes:
        try:
            count, files = read_complete(read(store, COMPLETE), place(store, COMPLETE))
        except InputError:
            count, files = 0, ()
        if count == record.count and present(files, sizes):
            return files
    files = [file_record(blob) for blob in [(DATASET, dataset_text(record)), *fixed]]
    files += [file_record((record_name(r.unit), unit_text(r))) for r in done]
    for blob in merge(store, done):
        files.append(file_record(blob))
        put(store, [blob])
    text = complete_text(record.count, tuple(files))
    put(store, [(COMPLETE, text)])
    return tuple(files)


def _words(error: OSError) -> str:
    place = f"{error.filename}: " if error.filename else ""
    return f"{place}{error.strerror or error}; {GO_ON}"
