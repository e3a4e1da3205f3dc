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
    for member, data in _members(content):
        name, _, extension = member.partition(".")
        if not extension:
            raise ValueError(f"content: member {member!r} has no extension")
        if name != key and files:
            yield key, tuple(files)
            files = []
        key = name
        files.append((extension, data))
    if files:
        yield key, tuple(files)


def _members(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Name and content of each plain file: headers as `shard_bytes` writes them, a tenth of what tarfile takes."""
    start = 0
    while start < len(content):
        header = content[start : start + BLOCK]
        if not any(header):
            return  # what the archive is filled up with
        try:
            told, size = int(header[148:154], 8), int(header[124:135], 8)
        except ValueError:
            told, size = -1, 0
        name = header[:100].partition(b"\0")[0].decode("ascii", "replace")
        if len(header) < BLOCK or sum(header) - sum(header[148:156]) + 8 * ord(" ") != told:
            raise ValueError(f"content: no header at byte {start}; a tar archive is wanted")
        if header[156:157] != b"0" or header[257:262] != b"ustar" or any(header[345:500]):
            raise ValueError(f"content: member {name!r} is no plain file with a short name")
        start += BLOCK
        if start + size > len(content):
            raise ValueError(f"content: member {name!r} is cut off")
        yield name, content[start : start + size]
        start += -(-size // BLOCK) * BLOCK
