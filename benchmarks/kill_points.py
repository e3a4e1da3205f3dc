"""A run that is killed (SIGKILL) at a chosen call that writes: every such call of all its processes counts.

Started as a program it makes a dataset, of a scene or of a stand-in for one, by an engine:

    python benchmarks/kill_points.py serial|pool|dask OUT [SCENE COUNT SIZE]

HANDTRACK_KILL=FILE:N:self|parent|nobody counts calls in FILE, a byte each, and kills at the N-th: the process that
makes the call, or its parent. A process that dies in `os.write` writes half of it.
"""

import fcntl
import os
import signal
import sys
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

VARIABLE = "HANDTRACK_KILL"
UNITS, SIZE = 3, 10


def make(unit):
    """The files of a unit that is no image's."""
    return tuple((f"{kind}/{unit.name}.txt", f"{kind} {unit.name} ".encode() * 500) for kind in ("shards", "rows"))


def merge(store, done):
    """One file from all units."""
    from synth.dataset.store import read

    yield "index.txt", b"".join(read(store, record.files[1].name) for record in done)


def install(counter: str, at: int, victim: str) -> None:
    """Replace the calls of `os` that write by ones that count, and that kill at the chosen count."""

    def due() -> bool:
        with open(counter, "ab") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX)
            stream.write(b".")
            stream.flush()
            return os.fstat(stream.fileno()).st_size == at and victim != "nobody"

    def die() -> None:
        own = os.getpid()
        alone = victim == "self" or os.environ.get("HANDTRACK_MAIN") == str(own)
        os.kill(own if alone else os.getppid(), signal.SIGKILL)

    def counted(call, before=None):
        def wrapped(*args, **named):
            if due():
                if before is not None:
                    before(*args)
                die()
            return call(*args, **named)

        return wrapped

    write, opened = os.write, os.open

    def open_counted(path, flags, *args, **named):
        if flags & os.O_CREAT and due():
            die()
        return opened(path, flags, *args, **named)

    import multiprocessing.connection  # keeps its own way to write: pipes are no files

    del multiprocessing
    os.write = counted(write, lambda handle, content: write(handle, content[: len(content) // 2]))
    os.open = open_counted
    for name in ("fsync", "replace", "makedirs", "unlink"):
        setattr(os, name, counted(getattr(os, name)))


def run_once(kind: str, out: str, scene: str | None = None, count: int = UNITS * SIZE, size: int = SIZE) -> None:
    """Make the dataset, or what is left to make of it."""
    from synth.dataset.engine import pooled, run, serial
    from synth.dataset.record import DatasetRecord
    from synth.dataset.store import open_store

    engine = serial
    if kind == "pool":
        engine = partial(pooled, workers=2)
    elif kind == "dask":
        from synth.dataset.dask_engine import dasked

        engine = partial(dasked, workers=2)
    if scene is None:
        from benchmarks import kill_points as here

        record = DatasetRecord("shards", 1, count, size, (), ())
        run(open_store(out), record, [("scene.yaml", b"scene\n")], here.make, here.merge, engine, lambda *_: None)
        return
    from synth.dataset.job import dataset_record, fixed_files, job_of, merged_files, unit_files

    job = job_of(Path(scene), "shards", 1, count, size)
    files, merged = partial(unit_files, job), partial(merged_files, "shards")
    run(open_store(out), dataset_record(job), fixed_files(job), files, merged, engine, lambda *_: None)


def _installed() -> None:
    told = os.environ.get(VARIABLE)
    if told:
        counter, at, victim = told.rsplit(":", 2)
        install(counter, int(at), victim)


if __name__ in ("__main__", "__mp_main__"):
    if __name__ == "__main__":
        os.environ["HANDTRACK_MAIN"] = str(os.getpid())
    _installed()
if __name__ == "__main__":
    _, kind, out, *more = sys.argv
    if more:
        run_once(kind, out, more[0], int(more[1]), int(more[2]))
    else:
        run_once(kind, out)
