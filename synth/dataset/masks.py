"""Part numbers or bits of all pixels in, one run-length encoded mask for each part out; and back.

A mask is the text that COCO calls a compressed RLE. Pixels are taken column by column; the lengths of the runs of zeros
and ones alternate and begin with zeros. From the fourth on, the difference to the length two before is stored, five
bits at a time, lowest first: a character is 48 plus these bits plus 32 where more follow, and the highest of the last
five is the sign. All parts of an image are encoded together from the few places where a pixel differs from the one
before it.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

CHARACTERS = 8  # five bits each: lengths up to 2^39


def masks_of_bits(bits: UInt64[np.ndarray, "h w"], count: int) -> tuple[str, ...]:
    """Masks of bits 0 to `count` - 1.

    >>> masks_of_bits(np.array([[0, 1], [2, 3]], np.uint64), 2)
    ('22', '1110')
    """
    changed, at = _changes(bits)
    keys = []
    while changed.any():  # a bit at a time: few places change more than two
        kept = changed != 0
        at, changed = at[kept], changed[kept]
        lowest = changed & (~changed + np.uint64(1))
        keys.append((np.frexp(lowest.astype(float))[1] - 1).astype(np.int64) * bits.size + at)
        changed = changed ^ lowest
    return _texts(np.concatenate([np.zeros(0, np.int64), *keys]), count, bits.size)


def _changes(bits: UInt64[np.ndarray, "h w"]) -> tuple[UInt64[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Bits that differ from those of the pixel before, column by column, and where: in any order."""
    height, width = bits.shape
    before = np.zeros_like(bits)
    before[1:] = bits[:-1]
    before[0, 1:] = bits[-1, :-1]
    differ = bits ^ before
    at = np.flatnonzero(differ)
    row, column = np.divmod(at, width)
    return differ.ravel()[at], column * height + row


def masks_of_numbers(number: Int[np.ndarray, "h w"], count: int) -> tuple[str, ...]:
    """Masks of the pixels that hold 0 to `count` - 1; those that hold -1 belong to none.

    >>> masks_of_numbers(np.array([[-1, 0], [-1, 1]]), 2)
    ('211', '31')
    """
    x = number.T.ravel()
    before = np.concatenate([np.full(1, -1, x.dtype), x[:-1]])
    at = np.flatnonzero(x != before)
    part = np.concatenate([before[at], x[at]]).astype(np.int64)
    keys = part * x.size + np.concatenate([at, at])
    return _texts(keys[part >= 0], count, x.size)


def mask_of_text(text: str, size: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """The pixels of one mask.

    Parameters
    ----------
    size : (h, w)

    Raises
    ------
    ValueError
        If the text is no mask of that size.

    >>> mask_of_text("211", (2, 2)).tolist()
    [[False, True], [False, False]]
    """
    lengths = _lengths(text)
    height, width = size
    if (lengths < 0).any() or lengths.sum() != height * width:
        raise ValueError(f"text: its runs cover {lengths.sum()} pixels; {height} x {width} are wanted")
    ones = np.arange(lengths.size) % 2 == 1
    return np.repeat(ones, lengths).reshape(width, height).T


def bits_of_masks(texts: Sequence[str], size: tuple[int, int]) -> UInt64[np.ndarray, "h w"]:
    """The image whose bit k is mask k: what `masks_of_bits` was given.

    >>> bits_of_masks(("22", "1110"), (2, 2)).tolist()
    [[0, 1], [2, 3]]
    """
    out = np.zeros(size, np.uint64)
    for k, text in enumerate(texts):
        out |= mask_of_text(text, size).astype(np.uint64) << np.uint64(k)
    return out


def union_bits(bits: UInt64[np.ndarray, "h w"], group: Int[np.ndarray, " p"], count: int) -> UInt64[np.ndarray, "h w"]:
    """Bits of groups of parts: bit g is set where any part of group g is.

    >>> union_bits(np.array([[1, 2, 4]], np.uint64), np.array([0, 0, 1]), 2).tolist()
    [[1, 1, 2]]
    """
    out = np.zeros_like(bits)
    for g in range(count):
        own = np.uint64(sum(1 << k for k in np.flatnonzero(group == g).tolist()))
        out |= (bits & own != 0).astype(np.uint64) << np.uint64(g)
    return out


def box_of_mask(mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, " 4"]:
    """Pixels x0, y0, x1, y1 (half open) that hold a mask; zeros for an empty one.

    >>> box_of_mask(np.array([[False, True], [False, False]])).tolist()
    [1.0, 0.0, 2.0, 1.0]
    """
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    if not rows.size:
        return np.zeros(4)
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], float)


def _texts(keys: Int[np.ndarray, " n"], count: int, pixels: int) -> tuple[str, ...]:
    """Masks from the places where each part begins or ends, as part * pixels + place in any order."""
    part, place = np.divmod(np.sort(keys), pixels)
    if part.size and part[-1] >= count:
        raise ValueError(f"count: {count} parts, and a pixel of part {part[-1]}; each has to be below count")
    runs = np.bincount(part, minlength=count) + 1
    last = np.cumsum(runs) - 1
    first = last - runs + 1
    ends = np.empty(part.size + count, np.int64)
    ends[last] = pixels
    ends[np.arange(part.size) + part] = place
    lengths = np.diff(ends, prepend=0)
    lengths[first] = ends[first]
    stored = lengths.copy()
    late = np.flatnonzero(np.arange(ends.size) - np.repeat(first, runs) > 2)
    stored[late] -= lengths[late - 2]
    text, stops = _characters(stored)
    bounds = [0, *stops[last].tolist()]
    return tuple(text[a:b] for a, b in pairwise(bounds))


def _characters(values: Int[np.ndarray, " n"]) -> tuple[str, Int[np.ndarray, " n"]]:
    """The text of some numbers, and where each ends in it."""
    sizes = np.ones(values.size, np.int64)
    most = 1
    for most in range(1, CHARACTERS + 1):
        longer = (values >= 1 << (5 * most - 1)) | (values < -1 << (5 * most - 1))
        if not longer.any():
            break
        sizes += longer
    stops = np.cumsum(sizes)
    codes = np.empty(sizes.sum(), np.uint8)
    at, end, rest = stops - sizes, stops, values
    for _ in range(most):
        more = end - at > 1
        codes[at] = (rest & 31) + 32 * more + 48
        at, end, rest = at[more] + 1, end[more], rest[more] >> 5
    return codes.tobytes().decode("ascii"), stops


def _lengths(text: str) -> Int[np.ndarray, " n"]:
    """Lengths of runs that a text stores."""
    codes = np.frombuffer(text.encode("ascii", "replace"), np.uint8).astype(np.int64) - 48
    if not codes.size or codes.min() < 0 or codes.max() > 63 or codes[-1] & 32:
        raise ValueError(f"text: {text[:40]!r} is no compressed mask")
    first = np.flatnonzero(np.concatenate([[True], codes[:-1] & 32 == 0]))
    sizes = np.diff(first, append=codes.size)
    if sizes.max() > CHARACTERS:
        raise ValueError(f"text: a run takes {sizes.max()} characters; at most {CHARACTERS} are wanted")
    shift = 5 * (np.arange(codes.size) - np.repeat(first, sizes))
    values = np.add.reduceat((codes & 31) << shift, first)
    negative = codes[first + sizes - 1] & 16 != 0
    values[negative] -= 1 << (5 * sizes[negative])
    values[1::2] = np.cumsum(values[1::2])
    values[2::2] = np.cumsum(values[2::2])
    return values
