"""Claims about runs: the bytes depend on the job alone, what is finished stays, and every failure is one line."""

import errno
import json
import os
import pickle
import signal
from functools import partial
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks import kill_points
from handtrack.errors import InputError
from synth.dataset import engine as engines
from synth.dataset import record as records
from synth.dataset import store as storage
from synth.dataset.dask_engine import check_address, dasked
from synth.dataset.engine import Stopped, finish_unit, pooled, run, serial
from synth.dataset.plan import Unit, units
from synth.dataset.record import DatasetRecord, FileRecord, UnitRecord, difference
from synth.dataset.store import names, open_store, tree_digest

RECORD = DatasetRecord("shards", 1, 25, 10, (("scene.yaml", "ab"),), (("numpy", "2.0"),))
FIXED = [("scene.yaml", b"scene\n")]


def made(store, engine=serial, record=RECORD, make=kill_points.make, merge=kill_points.merge, done=lambda *_: None):
    return run(store, record, FIXED, make, merge, engine, done)


def make_or_die(unit):
    """As `kill_points.make`; the second unit kills its process."""
    if unit.number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return kill_points.make(unit)


def make_or_fail(unit):
    if unit.number == 1:
        raise InputError(f"unit {unit.number}: bad input")
    return kill_points.make(unit)


class Unsendable(Exception):
    def __init__(self, a, b):
        super().__init__(f"{a} and {b}")


def fail_unsendably(unit):
    raise Unsendable("this", "that")


def interrupt(unit):
    raise KeyboardInterrupt


def disk_full(unit):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "out/shards/00001.tar")


@pytest.fixture(scope="module")
def digest(tmp_path_factory):
    store = open_store(str(tmp_path_factory.mktemp("whole")))
    assert made(store).made == 25
    return tree_digest(store)


@given(st.integers(1, 300), st.integers(1, 50))
def test_units_hold_every_image_once(count, size):
    each = units(count, size)
    assert [k for unit in each for k in range(unit.first, unit.first + unit.count)] == list(range(count))
    assert all(a.count == size and b.number == a.number + 1 for a, b in pairwise(each))


def test_no_units_of_nothing():
    with pytest.raises(ValueError, match="at least 1 of each"):
        units(0, 10)


def test_records_are_read_back():
    assert records.read_dataset(records.dataset_text(RECORD), "here") == RECORD
    unit = UnitRecord(Unit(2, 20, 5), (FileRecord("a", 3, "ff"),))
    assert records.read_unit(records.unit_text(unit), unit.unit, "here") == unit
    assert records.read_complete(records.complete_text(25, unit.files), "here") == (25, unit.files)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "here: Expecting value"),
        (b"\xff\xfe", "here: "),
        (b"[]", "no `format: handtrack/dataset-1`"),
        (b'{"format": "handtrack/dataset-1"}', "'layout' is missing"),
        (records.dataset_text(RECORD).replace(b'"shards"', b'"boxes"'), "one of shards, coco, folders was wanted"),
        (records.dataset_text(RECORD).replace(b": 25", b": 0"), "0 where a whole number of at least 1"),
        (records.dataset_text(RECORD).replace(b'{\n  "numpy": "2.0"\n }', b"3"), "a record of handtrack/dataset-1"),
    ],
)
def test_damaged_records_are_told_in_one_line(content, message):
    with pytest.raises(InputError, match=message):
        records.read_dataset(content, "here")


def test_records_of_units_are_checked():
    text = records.unit_text(UnitRecord(Unit(2, 20, 5), ()))
    with pytest.raises(InputError, match="says unit 2 with 5 images"):
        records.read_unit(text, Unit(2, 20, 10), "here")
    with pytest.raises(InputError, match="'files' is missing"):
        records.read_unit(text.replace(b"files", b"piles"), Unit(2, 20, 5), "here")
    with pytest.raises(InputError, match="'count' is missing"):
        records.read_complete(records.complete_text(1, ()).replace(b"count", b"mount"), "here")


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (DatasetRecord("coco", 1, 25, 10, RECORD.inputs, RECORD.versions), "format shards there, coco here"),
        (DatasetRecord("shards", 1, 30, 10, RECORD.inputs, RECORD.versions), "count 25 there, 30 here"),
        (DatasetRecord("shards", 1, 25, 5, RECORD.inputs, RECORD.versions), "shard size 10 there, 5 here"),
        (DatasetRecord("shards", 1, 25, 10, (("scene.yaml", "cd"),), RECORD.versions), "scene.yaml ab there, cd here"),
        (DatasetRecord("shards", 1, 25, 10, RECORD.inputs, ()), "numpy 2.0 there, absent here"),
    ],
)
def test_another_job_is_refused_with_the_difference(tmp_path, other, words):
    assert difference(RECORD, RECORD) is None
    assert difference(RECORD, other) == words
    store = open_store(str(tmp_path))
    made(store)
    before = tree_digest(store)
    with pytest.raises(InputError, match=f"another dataset: {words}"):
        made(store, record=other)
    assert tree_digest(store) == before


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match=r"holds other files \(thesis.txt\)"):
        made(open_store(str(tmp_path)))
    assert os.listdir(tmp_path) == ["thesis.txt"]


@pytest.mark.parametrize("engine", [partial(pooled, workers=1), partial(pooled, workers=3)])
def test_pools_of_any_size_give_the_same_bytes(tmp_path, digest, engine):
    store, told = open_store(str(tmp_path / "new")), []
    made(store, engine, done=lambda *figures: told.append(figures))
    assert tree_digest(store) == digest
    assert told[0] == (0, 0) and told[-1] == (25, 0) and len(told) == 4


def test_dask_gives_the_same_bytes_and_survives_a_failure(tmp_path, digest):
    store = open_store(str(tmp_path))
    with pytest.raises(InputError, match="unit 1: bad input"):
        made(store, partial(dasked, workers=2), make=make_or_fail)
    assert made(store, partial(dasked, workers=2)).made < 25
    assert tree_digest(store) == digest
    assert list(dasked(kill_points.make, [], 2)) == []


@pytest.mark.parametrize(
    ("address", "remote", "message"),
    [
        ("tcp://10.0.0.1:8786", False, "10.0.0.1 is not this machine; say --allow-remote"),
        ("somewhere:8786", False, "somewhere is not this machine"),
        ("127.0.0.1", True, "an address such as"),
        ("tcp://127.0.0.1:port", True, "an address such as"),
        ("", False, "an address such as"),
    ],
)
def test_only_loopback_unless_told(address, remote, message):
    with pytest.raises(InputError, match=message):
        check_address(address, remote)
    for fine in ("tcp://127.0.0.1:8786", "localhost:8786", "tcp://[::1]:8786"):
        check_address(fine, False)
    check_address("tcp://10.0.0.1:8786", True)


def test_a_running_scheduler_is_used(tmp_path, digest):
    from distributed import LocalCluster

    store = open_store(str(tmp_path))
    options = {"processes": False, "protocol": "tcp", "host": "127.0.0.1", "dashboard_address": None}
    with LocalCluster(1, threads_per_worker=1, **options) as cluster:
        address = str(cluster.scheduler_address)  # type: ignore[union-attr]
        made(store, partial(dasked, workers=1, scheduler=address))
    assert tree_digest(store) == digest


def test_a_scheduler_that_is_not_there_stops(tmp_path, monkeypatch):
    from synth.dataset import dask_engine

    monkeypatch.setattr(dask_engine, "_SECONDS", "100ms")
    with pytest.raises(Stopped, match="run again to go on"):
        made(open_store(str(tmp_path)), partial(dasked, workers=1, scheduler="tcp://127.0.0.1:9"))


def test_arguments_of_engines_are_checked():
    for engine in (pooled, dasked):
        with pytest.raises(ValueError, match="workers: 0"):
            list(engine(kill_points.make, units(3, 1), 0))


def test_a_lost_worker_stops_in_words_and_the_next_run_goes_on(tmp_path, digest):
    store = open_store(str(tmp_path))
    with pytest.raises(Stopped, match=r"a worker process was lost .*; what is finished stays, run again to go on"):
        made(store, partial(pooled, workers=2), make=make_or_die)
    made(store, partial(pooled, workers=2))
    assert tree_digest(store) == digest


@pytest.mark.parametrize(
    ("make", "kind", "message"),
    [
        (make_or_fail, InputError, "unit 1: bad input"),
        (disk_full, Stopped, "out/shards/00001.tar: No space left on device; what is finished stays"),
        (fail_unsendably, RuntimeError, "Unsendable: this and that"),
    ],
)
def test_a_failure_in_a_worker_arrives(tmp_path, make, kind, message):
    with pytest.raises(kind, match=message):
        made(open_store(str(tmp_path)), partial(pooled, workers=2), make=make)


def test_a_worker_answers_units_until_there_are_none():
    """The worker's loop, run here: its processes leave no trace of coverage."""
    import multiprocessing
    import threading

    here, there = multiprocessing.get_context("spawn").Pipe()
    for unit in (Unit(0, 0, 10), Unit(1, 10, 10), None):
        here.send(unit)
    before = signal.getsignal(signal.SIGINT)
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(engines, "_end_with", lambda parent: None)
            engines._serve(there, make_or_fail)
    finally:
        signal.signal(signal.SIGINT, before)
    assert threading.active_count() >= 1
    fine, files = here.recv()
    assert fine and files == kill_points.make(Unit(0, 0, 10))
    fine, error = here.recv()
    assert not fine and isinstance(error, InputError) and "make_or_fail" in error.__notes__[0]


def test_a_worker_ends_with_its_parent(monkeypatch):
    class Parent:
        def join(self):
            ended.append("parent")

    ended = []
    monkeypatch.setattr(engines.os, "_exit", ended.append)
    engines._end_with(Parent())
    assert ended == ["parent", 1]


def test_an_interruption_leaves_nothing_half_written(tmp_path, digest):
    store = open_store(str(tmp_path))
    with pytest.raises(KeyboardInterrupt):
        made(store, make=interrupt)
    assert sorted(names(store)) == ["dataset.json", "scene.yaml"]
    made(store)
    assert tree_digest(store) == digest


def test_a_full_disk_stops_in_words_and_the_next_run_goes_on(tmp_path, digest, monkeypatch):
    store, write = open_store(str(tmp_path)), os.write

    def fills(handle, content):
        if b"shards 00001" in bytes(content[:20]):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(handle, content)

    with monkeypatch.context() as patch:
        patch.setattr(storage.os, "write", fills)
        with pytest.raises(Stopped, match=r"shards/00001.txt: No space left on device; what is finished stays"):
            made(store)
    assert not list(tmp_path.rglob("*.partial"))
    assert made(store).made == 15
    assert tree_digest(store) == digest


def test_a_read_only_place_stops_in_words(tmp_path, monkeypatch):
    def refuses(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(storage.os, "makedirs", refuses)
    with pytest.raises(Stopped, match="out: Read-only file system; what is finished stays"):
        made(open_store(str(tmp_path / "out")))


@pytest.mark.parametrize(
    "name", ["records/00001.json", "shards/00001.txt", "complete.json", "index.txt", "scene.yaml", "rows/00002.txt"]
)
@pytest.mark.parametrize("damage", ["remove", "empty"])
def test_what_is_missing_or_cut_off_is_made_again(tmp_path, digest, name, damage):
    store = open_store(str(tmp_path))
    made(store)
    (tmp_path / name).unlink() if damage == "remove" else (tmp_path / name).write_bytes(b"")
    made(store)
    assert tree_digest(store) == digest


def test_a_finished_dataset_is_left_alone(tmp_path):
    store = open_store(str(tmp_path))
    made(store)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    summary = made(store, make=interrupt)
    assert summary.made == 0 and summary.count == 25
    assert (
        summary.size
        == sum(path.stat().st_size for path in tmp_path.rglob("*.*")) - (tmp_path / "complete.json").stat().st_size
    )
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_no_file_tells_where_or_when_it_was_made(tmp_path):
    import socket

    store = open_store(str(tmp_path / "secret-place"))
    made(store)
    text = b"".join(path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file())
    for word in (str(tmp_path), "secret-place", socket.gethostname(), "time", "worker"):
        assert word.encode() not in text


def test_threads_of_workers_are_set_and_put_back(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with engines.one_thread():
        assert os.environ["OMP_NUM_THREADS"] == os.environ["MKL_NUM_THREADS"] == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7" and "MKL_NUM_THREADS" not in os.environ


def test_tasks_travel_to_workers():
    task = partial(finish_unit, open_store("memory://a/b"), kill_points.make)
    assert pickle.loads(pickle.dumps(task)).func is finish_unit
    assert json.loads(records.dataset_text(RECORD))["seed"] == 1
