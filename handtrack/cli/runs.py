"""A folder to write into in, a complete run in its place out; or nothing at all.

Everything is written into a hidden sibling, forced to the disk, and renamed: a run is there whole or not there.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError

RUN_FILE = "run.json"


@contextmanager
def whole_folder(out: Path, marker: str, wanted: str) -> Iterator[Path]:
    """Folder to write into; it becomes `out` when the block ends well and vanishes when it does not.

    An earlier folder of the same kind, known by its file `marker`, is replaced; anything else is left alone.

    Parameters
    ----------
    out : Path
        Final place. Missing parents are made.
    marker : str
        Name of the file that such a folder always holds.
    wanted : str
        What such a folder is called, for the message.

    Raises
    ------
    InputError
        If `out` is a file, or a folder with other things in it.
    """
    out = Path(os.path.abspath(out))
    _check_replaceable(out, marker, wanted)
    made = _make_parents(out.parent)
    part = out.with_name(f".{out.name}.partial")
    if part.is_dir():
        shutil.rmtree(part)  # an earlier attempt that was killed
    try:
        part.mkdir()
        yield part
        _sync(part)
        _put_in_place(part, out)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        for folder in made:
            _remove_if_empty(folder)
        raise


def _check_replaceable(out: Path, marker: str, wanted: str) -> None:
    if out.exists() and not out.is_dir():
        raise InputError(f"--out: {out} is a file; a folder was wanted")
    if out.is_dir() and any(out.iterdir()) and not (out / marker).is_file():
        raise InputError(f"--out: {out} holds other files and no {marker}; a new folder or an earlier {wanted} was wanted")


def _make_parents(folder: Path) -> list[Path]:
    """Make a folder and its parents; returns those that were missing, innermost first."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as failure:
        raise InputError(f"--out: {folder} lies inside a file; a folder was wanted") from failure
    return missing


def _remove_if_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _put_in_place(part: Path, out: Path) -> None:
    old = out.with_name(f".{out.name}.old")
    if out.is_dir():
        if old.is_dir():
            shutil.rmtree(old)
        out.rename(old)
    try:
        part.rename(out)
    except OSError:
        if old.is_dir():
            old.rename(out)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _sync(folder: Path) -> None:
    for place in (*sorted(folder.rglob("*")), folder):
        handle = os.open(place, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
