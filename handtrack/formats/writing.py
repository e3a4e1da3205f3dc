"""Content in, a file or folder that is whole or absent out.

Everything is written beside its target, flushed to the disk, and renamed: a rename within one folder is atomic, so a
reader, or a rerun after an interruption, never sees half of it.
"""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError


def write_bytes(path: Path, content: bytes) -> None:
    """Replace a file by new content, whole or not at all."""
    handle, name = tempfile.mkstemp(prefix=f".{path.name[:100]}.", suffix=".partial", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def write_text(path: Path, text: str) -> None:
    """Replace a file by new UTF-8 text with plain newlines, whole or not at all."""
    write_bytes(path, text.encode("utf-8"))


@contextmanager
def folder_written_whole(path: Path, replace: bool = False) -> Iterator[Path]:
    """A temporary folder to write into; it becomes `path` when the block ends, and is removed if the block raises.

    Parameters
    ----------
    replace : bool
        Whether a folder that is already there, and not empty, gives way. It stays until the new one is complete.

    Raises
    ------
    InputError
        If `path` is a file, or a folder that is not empty and `replace` is false.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file; a new or empty folder is wanted")
    if path.is_dir() and any(path.iterdir()) and not replace:
        raise InputError(f"{path}: already exists and is not empty; a new or empty folder is wanted")
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{path.name[:100]}.", suffix=".partial", dir=path.parent))
    try:
        os.chmod(partial, 0o777 & ~_umask())
        yield partial
        for file in sorted(partial.rglob("*")):
            if file.is_file():
                with file.open("rb") as stream:
                    os.fsync(stream.fileno())
        _put_in_place(partial, path)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    _sync_folder(path.parent)


def _put_in_place(partial: Path, path: Path) -> None:
    """Rename the new folder to its name; an old one of that name steps aside first and comes back if that fails."""
    if not path.is_dir():
        partial.rename(path)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{path.name[:100]}.", suffix=".old", dir=path.parent))
    path.rename(old)  # onto an empty folder: allowed, and atomic
    try:
        partial.rename(path)
    except BaseException:
        old.rename(path)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _sync_folder(folder: Path) -> None:
    """Make the rename itself durable, where the system lets a folder be opened."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
