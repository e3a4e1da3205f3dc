"""Names of files in, files that may be read out.

A path that stands in a file stays inside that file's folder; one that a user typed may lead anywhere.
"""

from pathlib import Path, PurePosixPath, PureWindowsPath

from ..errors import InputError


def read_bytes(path: Path, limit: int | None = None) -> bytes:
    """Content of a regular file.

    Raises
    ------
    InputError
        If it is missing, no regular file, not readable, or larger than `limit` bytes.
    """
    try:
        if not path.exists():
            raise InputError(f"{path}: no such file")
        if not path.is_file():
            raise InputError(f"{path}: is not a file; a file is wanted")
        with path.open("rb") as stream:
            content = stream.read() if limit is None else stream.read(limit + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: cannot be read ({_reason(error)})") from error
    if limit is not None and len(content) > limit:
        raise InputError(f"{path}: is larger than {limit} bytes, the most that is read here")
    return content


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or " ".join(str(error).split())


def inside(folder: Path, text: str, place: str) -> tuple[Path, tuple[str, ...]]:
    """The path that `text`, written at `place` of a file in `folder`, means; with a warning if a link leads out.

    Raises
    ------
    InputError
        For an absolute path, one with `..`, or an empty one.

    >>> inside(Path("clip"), "frames/a.png", "clip/sequence.yaml: line 3: frames:")[0].as_posix()
    'clip/frames/a.png'
    """
    parts = PurePosixPath(text.replace("\\", "/")).parts
    if not parts or "\0" in text:
        raise InputError(f"{place} {text!r} is no path; a path inside the folder is wanted")
    if PurePosixPath(text).is_absolute() or PureWindowsPath(text).drive or PureWindowsPath(text).root:
        raise InputError(f"{place} {text!r} is absolute; a path inside the folder is wanted")
    if ".." in parts:
        raise InputError(f"{place} {text!r} leaves the folder by '..'; a path inside the folder is wanted")
    path = folder / text
    return path, leaving(folder, path)


def leaving(folder: Path, path: Path) -> tuple[str, ...]:
    """A warning if `path` lies outside `folder` once symbolic links are followed."""
    try:
        outside = not path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError) as error:
        raise InputError(f"{path}: cannot be followed ({_reason(error)})") from error
    return (f"{path}: a symbolic link leads out of its folder, to {path.resolve()}",) if outside else ()
