"""Samples in, a tar archive out as the webdataset package reads it; and back.

A member is called `{key}.{extension}`; the members of an image follow each other, images come in the order of their
keys. Times, owners and modes are the same in all archives, so that the same samples give the same bytes. USTAR, blocks
of 512 bytes, padded to 10 240 at the end.
"""

import io
import tarfile
from collections.abc import Iterable, Iterator

from .encode import Sample

BLOCK = 512


def shard_bytes(samples: Iterable[Sample]) -> bytes:
    """The archive of some samples, sorted by key.

    >>> content = shard_bytes([])
    >>> len(content), content.count(0)
    (10240, 10240)
    """
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for sample in sorted(samples, key=lambda sample: sample.key):
            for extension, content in sample.files:
                member = tarfile.TarInfo(f"{sample.key}.{extension}")  # time, owner and group are 0, the mode 0644
                member.size = len(content)
                archive.addfile(member, io.BytesIO(content))
    return stream.getvalue()


def spans_of(samples: Iterable[Sample]) -> tuple[tuple[int, int], ...]:
    """Offset and size in bytes of each sample in the archive of all of them, sorted by key.

    >>> spans_of([])
    ()
    """
    out, offset = [], 0
    for sample in sorted(samples, key=lambda sample: sample.key):
        size = sum(BLOCK + -(-len(content) // BLOCK) * BLOCK for _, content in sample.files)
        out.append((offset, size))
        offset += size
    return tuple(out)


def members_of(content: bytes) -> Iterator[tuple[str, tuple[tuple[str, bytes], ...]]]:
    """Key and files of each sample of an archive, or of the stretch of one that `spans_of` gives.

    Raises
    ------
    ValueError
        If the content is no such archive, or is cut off.
    """
    key, files = "", []
    try:
        with tarfile.open(fileobj=io.BytesIO(content), mode="r:") as archive:
            for member in archive:
                stream = archive.extractfile(member)
                data = b"" if stream is None else stream.read()
                name, _, extension = member.name.partition(".")
                if len(data) != member.size or not extension:
                    raise ValueError(f"content: member {member.name!r} is cut off or has no extension")
                if name != key and files:
                    yield key, tuple(files)
                    files = []
                key = name
                files.append((extension, data))
    except tarfile.TarError as error:
        raise ValueError(f"content: {error}; a tar archive is wanted") from error
    if files:
        yield key, tuple(files)
