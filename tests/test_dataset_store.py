"""Claims about storage: whole or absent, one code path, failures that name their file."""

import errno
import os
import re
import resource
import subprocess
import sys

import pytest

from handtrack.errors import InputError
from synth.dataset import store as storage
from synth.dataset.store import clean, digest, names, only_run, open_store, place, put, read, tree_digest


@pytest.fixture(params=["folder", "objects"])
def store(request, tmp_path):
    if request.param == "folder":
        yield open_store(str(tmp_path / "a folder with % and é"))
        return
    import fsspec

    yield open_store("memory://tests/data")
    fsspec.filesystem("memory").rm("/tests", recursive=True) if fsspec.filesystem("memory").exists("/tests") else None


def test_what_is_put_is_listed_and_read(store):
    assert names(store) == {}
    put(store, [("a/b/c.bin", b"12345"), ("d.txt", b"")])
    assert names(store) == {"a/b/c.bin": 5, "d.txt": 0}
    assert read(store, "a/b/c.bin") == b"12345"
    assert read(store, "a/b/c.bin", 1, 3) == b"23"
    put(store, [("d.txt", b"new")])
    assert read(store, "d.txt") == b"new"


def test_digests_tell_trees_apart(store):
    put(store, [("a", b"1")])
    first = tree_digest(store)
    assert digest(store, "a") == "6b86b273ff34fce19d6b804eff5a3f5747ada4eaa22f1d49c01e52ddb7875b4b"
    put(store, [("a", b"2")])
    second = tree_digest(store)
    put(store, [("a", b"1"), ("b", b"")])
    assert len({first, second, tree_digest(store)}) == 3


def test_a_missing_file_is_named(store):
    with pytest.raises(FileNotFoundError, match=r"nothing\.txt"):
        read(store, "nothing.txt")


def test_leftovers_are_cleaned_and_other_hidden_files_stay(tmp_path):
    store = open_store(str(tmp_path))
    left = tmp_path / "shards" / ".00000.tar.0123456789abcdef.partial"
    mine = tmp_path / ".notes.partial"
    left.parent.mkdir()
    left.write_bytes(b"half")
    mine.write_bytes(b"")
    assert names(store) == {".notes.partial": 0}
    assert clean(store) == 1
    assert mine.exists() and not left.exists()
    assert clean(open_store("memory://tests/none")) == 0


@pytest.mark.parametrize("call", ["write", "fsync", "replace"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS])
def test_a_failed_write_leaves_the_old_file_and_nothing_beside_it(tmp_path, monkeypatch, call, code):
    store = open_store(str(tmp_path))
    put(store, [("sub/a", b"old")])

    def fails(*_):
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as patch:
        patch.setattr(storage.os, call, fails)
        with pytest.raises(OSError, match=re.escape(f"{os.strerror(code)}: '{place(store, 'sub/a')}'")):
            put(store, [("sub/a", b"new")])
    assert read(store, "sub/a") == b"old"
    assert os.listdir(tmp_path / "sub") == ["a"]


def test_a_limit_on_file_sizes_ends_in_one_line(tmp_path):
    """A real failure of the system's, in a process of its own: it takes no file beyond 4096 bytes."""
    program = (
        "from synth.dataset.store import open_store, put\n"
        f"try:\n    put(open_store({str(tmp_path)!r}), [('a', b'x' * 5000)])\n"
        "except OSError as error:\n    raise SystemExit(f'{error.filename}: {error.strerror}')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)),
    )
    assert done.stderr.strip() == f"{tmp_path}/a: {os.strerror(errno.EFBIG)}"
    assert os.listdir(tmp_path) == []


def test_a_file_in_the_way_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file; a folder was wanted"):
        names(open_store(str(tmp_path / "file")))
    with pytest.raises(OSError, match="file"):
        put(open_store(str(tmp_path / "file" / "below")), [("a", b"")])


def test_one_run_at_a_time_in_a_folder(tmp_path):
    store = open_store(str(tmp_path / "new"))
    with only_run(store), pytest.raises(InputError, match="another run is writing there"), only_run(store):
        pass
    with only_run(store):
        pass
    with only_run(open_store("memory://tests/a")), only_run(open_store("memory://tests/a")):
        pass
    assert os.listdir(tmp_path / "new") == []


def test_folders_without_locks_are_used_without(tmp_path, monkeypatch):
    import fcntl

    for code, fine in ((errno.ENOLCK, True), (errno.EIO, False)):

        def fails(*_, code=code):
            raise OSError(code, os.strerror(code))

        monkeypatch.setattr(fcntl, "flock", fails)
        store = open_store(str(tmp_path))
        if fine:
            with only_run(store):
                pass
        else:
            with pytest.raises(OSError, match=os.strerror(code)), only_run(store):
                pass


@pytest.mark.parametrize(
    ("uri", "options", "message"),
    [
        ("nothing://a/b", (), "folder or s3://bucket/prefix"),
        ("memory://", (), "names no place in the store"),
        ("memory://a", ("novalue",), "KEY=VALUE was wanted"),
        ("a", ("anon=true",), "goes with an object store"),
        ("github://a/b", ("token=1",), "org.*folder or s3://bucket/prefix was wanted"),
    ],
)
def test_bad_addresses_are_told_in_one_line(uri, options, message):
    with pytest.raises(InputError, match=message):
        open_store(uri, options)


def test_a_missing_package_is_told_with_its_extra(monkeypatch):
    import fsspec

    def missing(protocol, **_):
        raise ImportError(f"Install {protocol}fs")

    monkeypatch.setattr(fsspec, "filesystem", missing)
    with pytest.raises(InputError, match=r"install handtrack\[s3\]"):
        open_store("s3://bucket/data")
    with pytest.raises(InputError, match="that fsspec names for it"):
        open_store("gs://bucket/data")


def test_failures_of_foreign_libraries_become_system_errors(monkeypatch):
    from botocore.exceptions import EndpointConnectionError

    store = open_store("memory://tests/data")

    def fails(*_, **__):
        raise EndpointConnectionError(endpoint_url="http://127.0.0.1:9")

    monkeypatch.setattr(storage._system(store), "cat_file", fails)
    with pytest.raises(OSError, match="Could not connect to the endpoint URL"):
        read(store, "a")


def test_other_failures_stay_what_they_are(monkeypatch):
    store = open_store("memory://tests/data")

    def fails(*_, **__):
        raise KeyError("bug")

    monkeypatch.setattr(storage._system(store), "cat_file", fails)
    with pytest.raises(KeyError, match="bug"):
        read(store, "a")
