"""The address of a folder or of an object store in, files that are whole or absent out.

One code path for both, through fsspec. In a folder a file is written beside its place, flushed to the disk and renamed;
an object store is given the whole file in one request. Either way a reader, or a run after an interruption, never sees
half a file. What an interrupted run left beside its place is called `.{name}.{16 hex digits}.partial`.
"""

import errno
import hashlib
import json
import os
import re
import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from handtrack.errors import InputError

Blob = tuple[str, bytes]  # name within the dataset, with slashes, and content
_PARTIAL = re.compile(r"\..+\.[0-9a-f]{16}\.partial")
_OPEN = 128  # files that are written before all of them are flushed; far below the usual limit of 1024
_BLOCK = 2**20
_ONE_REQUEST = 5 * 2**29  # chunk from which s3fs would split an upload; twice this is what S3 takes at once
_FOREIGN = ("botocore", "aiobotocore", "aiohttp", "urllib3")  # their failures are no OSError


@dataclass(frozen=True, slots=True)
class Store:
    """Where a dataset lies. Picklable: workers open their own connections.

    Attributes
    ----------
    uri : str
        As the user gave it.
    protocol : str
        fsspec's name of the kind of storage; `file` for a folder.
    root : str
        Folder or prefix, as that kind of storage writes it.
    options : tuple of (str, str)
        What fsspec is told besides; values are JSON where they parse as such.
    """

    uri: str
    protocol: str
    root: str
    options: tuple[tuple[str, str], ...] = ()

    @property
    def local(self) -> bool:
        """Whether it is a folder of this machine."""
        return self.protocol == "file"


def open_store(uri: str, options: Sequence[str] = ()) -> Store:
    """The store at an address: a folder, `s3://bucket/prefix`, or what else fsspec knows.

    Parameters
    ----------
    options : sequence of str
        `KEY=VALUE`, passed on to fsspec.

    Raises
    ------
    InputError
        If the kind of storage is unknown, its package is missing, or an option has no value.

    >>> open_store("memory://data/hands").root
    '/data/hands'
    """
    pairs = []
    for option in options:
        key, sign, value = option.partition("=")
        if not (key and sign):
            raise InputError(f"--storage-option: {option!r}; KEY=VALUE was wanted")
        pairs.append((key, value))
    if "://" not in uri or uri.startswith("file://"):
        if pairs:
            raise InputError("--storage-option: goes with an object store, and --out is a folder")
        return Store(uri, "file", str(Path(uri.removeprefix("file://")).absolute()))
    protocol = uri.split("://", 1)[0]
    store = Store(uri, protocol, "", tuple(pairs))
    root = str(_system(store)._strip_protocol(uri)).rstrip("/")
    if not root.strip("/"):
        raise InputError(f"{uri}: names no place in the store; {protocol}://bucket/prefix was wanted")
    return Store(uri, protocol, root, tuple(pairs))


def place(store: Store, name: str) -> str:
    """How a user finds a file of the store."""
    return f"{store.uri.rstrip('/')}/{name}"


def put(store: Store, blobs: Sequence[Blob]) -> None:
    """Write files, each whole or not at all.

    Raises
    ------
    OSError
        If one cannot be written; names it.
    """
    for first in range(0, len(blobs), _OPEN):
        if store.local:
            _put_local(store, blobs[first : first + _OPEN])
        else:
            _put_objects(store, blobs[first : first + _OPEN])


def read(store: Store, name: str, start: int | None = None, stop: int | None = None) -> bytes:
    """Content of a file, or the bytes from `start` to before `stop` of it."""
    with _named(store, name):
        return _system(store).cat_file(f"{store.root}/{name}", start=start, end=stop)


def names(store: Store) -> Mapping[str, int]:
    """Bytes of every file below the root, by its name; leftovers of interrupted runs are left out."""
    return {name: size for name, size in _all(store) if not _is_partial(name)}


def digest(store: Store, name: str) -> str:
    """SHA-256 of a file, hexadecimal."""
    total = hashlib.sha256()
    with _named(store, name), _system(store).open(f"{store.root}/{name}", "rb") as stream:
        while block := stream.read(_BLOCK):
            total.update(block)
    return total.hexdigest()


def tree_digest(store: Store) -> str:
    """SHA-256 over names and contents of all files, leftovers included: equal for equal trees only."""
    total = hashlib.sha256()
    for name, size in sorted(_all(store)):
        total.update(f"{name}\0{size}\0{digest(store, name)}\n".encode())
    return total.hexdigest()


def clean(store: Store) -> int:
    """Remove what interrupted runs left half-written; returns how many files that were."""
    if not store.local:
        return 0  # a request that was cut off leaves nothing
    left = [name for name, _ in _all(store) if _is_partial(name)]
    for name in left:
        with _named(store, name):
            Path(store.root, name).unlink(missing_ok=True)
    return len(left)


@contextmanager
def only_run(store: Store) -> Iterator[None]:
    """Keep other runs of this machine out of a folder while the block runs; an object store has no such lock.

    Raises
    ------
    InputError
        If another run is at work there.
    OSError
        If the folder cannot be made.
    """
    if not store.local:
        yield
        return
    with _named(store, ""):
        os.makedirs(store.root, exist_ok=True)
        handle = os.open(store.root, os.O_RDONLY)
    try:
        _lock(store, handle)
        yield
    finally:
        os.close(handle)


def _lock(store: Store, handle: int) -> None:
    """The system frees the lock when the process ends, however it does, and nothing of it is in the folder."""
    try:
        import fcntl
    except ImportError:  # no such locks on Windows
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"{store.uri}: another run is writing there; wait for it to end") from None
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL):
            raise  # some network folders have no locks: the bytes are the same without


def _put_local(store: Store, blobs: Sequence[Blob]) -> None:
    """Write all beside their places, flush all, rename all: disks flush many files at once faster than one by one."""
    staged: list[tuple[str, str, int]] = []
    folders: list[str] = []
    at = ""
    try:
        try:
            for at, content in blobs:
                path = os.path.join(store.root, *at.split("/"))
                folders.extend(_made(store, os.path.dirname(path)))
                partial, handle = _stage(path)
                staged.append((partial, path, handle))
                _write(handle, content)
            for _, path, handle in staged:
                at = os.path.relpath(path, store.root)
                os.fsync(handle)
        finally:
            for _, _, handle in staged:
                os.close(handle)
        for partial, path, _ in staged:
            at = os.path.relpath(path, store.root)
            os.replace(partial, path)
        for folder in dict.fromkeys([*folders, *(os.path.dirname(path) for _, path, _ in staged)]):
            _sync_folder(folder)
    except BaseException as error:
        for partial, _, _ in staged:
            Path(partial).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise _at(store, at, error) from error
        raise


def _made(store: Store, folder: str) -> list[str]:
    """Make a folder; returns those whose list of files changed by that."""
    missing = []
    while not os.path.isdir(folder):
        missing.append(folder)
        folder = os.path.dirname(folder)
    for each in reversed(missing):
        with _named(store, os.path.relpath(each, store.root)):
            os.makedirs(each, exist_ok=True)
    return [os.path.dirname(each) for each in missing]


def _stage(path: str) -> tuple[str, int]:
    """A new file beside a path; its rights follow the user's mask."""
    folder, name = os.path.split(path)
    partial = os.path.join(folder, f".{name}.{secrets.token_hex(8)}.partial")
    return partial, os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)


def _write(handle: int, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[os.write(handle, rest) :]


def _sync_folder(folder: str) -> None:
    """Make renames durable, where the system lets a folder be opened."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _put_objects(store: Store, blobs: Sequence[Blob]) -> None:
    system = _system(store)
    more = {"chunksize": _ONE_REQUEST} if store.protocol in ("s3", "s3a") else {}
    for name, content in blobs:
        with _named(store, name):
            system.pipe_file(f"{store.root}/{name}", content, **more)


def _all(store: Store) -> list[tuple[str, int]]:
    with _named(store, ""):
        system = _system(store)
        if store.local and os.path.exists(store.root) and not os.path.isdir(store.root):
            raise InputError(f"{store.uri}: is a file; a folder was wanted")
        try:
            found: Any = system.find(store.root, detail=True)
        except FileNotFoundError:
            return []
    first = len(store.root) + 1
    return [(path[first:], int(facts["size"])) for path, facts in found.items()]


def _is_partial(name: str) -> bool:
    return _PARTIAL.fullmatch(name.rpartition("/")[2]) is not None


def _system(store: Store) -> Any:
    """fsspec's object for the store; fsspec keeps one for each set of options and process."""
    import fsspec

    options: dict[str, Any] = {key: _value(text) for key, text in store.options}
    if store.protocol in ("s3", "s3a"):
        options.setdefault("use_listings_cache", False)  # others write there too
    try:
        return fsspec.filesystem(store.protocol, **options)
    except ImportError as error:
        extra = f"install handtrack[{'s3' if store.protocol in ('s3', 's3a') else store.protocol}]"
        if store.protocol not in ("s3", "s3a"):
            extra = "install the package that fsspec names for it"
        raise InputError(f"{store.uri}: {store.protocol} storage needs a package that is missing; {extra}") from error
    except (TypeError, ValueError) as error:  # no such storage, or one that wants other options
        raise InputError(f"{store.uri}: {error}; a folder or s3://bucket/prefix was wanted") from error


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


@contextmanager
def _named(store: Store, name: str) -> Iterator[None]:
    """Let every failure of the storage be an OSError that names the file."""
    try:
        yield
    except OSError as error:
        raise _at(store, name, error) from error
    except Exception as error:
        if type(error).__module__.partition(".")[0] not in _FOREIGN:
            raise
        raise OSError(errno.EIO, " ".join(str(error).split()), place(store, name).rstrip("/")) from error


def _at(store: Store, name: str, error: OSError) -> OSError:
    usual = {FileNotFoundError: errno.ENOENT, PermissionError: errno.EACCES}.get(type(error), errno.EIO)
    text = error.strerror or (os.strerror(usual) if usual != errno.EIO else " ".join(str(error).split()))
    return OSError(error.errno or usual, text or type(error).__name__, place(store, name).rstrip("/"))
