"""Run-length encoded masks of all parts in, one image of bits out: `masks.bits_of_masks`, ten times as fast.

All masks are decoded at once. Each run's end is a place where the bit of its part changes; bits of all pixels follow
from the changes before them, column by column, by exclusive or.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int, UInt64


def bits_of_texts(texts: Sequence[str], size: tuple[int, int]) -> UInt64[np.ndarray, "h w"]:
    """The image whose bit k is mask k.

    Parameters
    ----------
    texts : sequence of str
        Masks as `masks` describes them, at most 64.
    size : (h, w)

    Raises
    ------
    ValueError
        If a text is no mask of that size.

    >>> bits_of_texts(("22", "1110"), (2, 2)).tolist()
    [[0, 1], [2, 3]]
    """
    height, width = size
    if not texts:
        return np.zeros(size, np.uint64)
    part, lengths, start = _runs(texts)
    stops = np.cumsum(lengths)
    ends = np.append(stops[start[1:] - 1], stops[-1])
    whole = np.diff(ends, prepend=0)
    if (lengths < 0).any() or (whole != height * width).any():
        wrong = int(np.argmax(whole != height * width))
        raise ValueError(f"texts[{wrong}]: is no mask of {height} x {width} pixels")
    changes = np.zeros(height * width + 1, np.uint64)
    np.bitwise_xor.at(changes, stops - (ends - whole)[part], np.uint64(1) << part.astype(np.uint64))
    return np.bitwise_xor.accumulate(changes[:-1]).reshape(width, height).T


def _runs(
    texts: Sequence[str],
) -> tuple[Int[np.ndarray, " r"], Int[np.ndarray, " r"], Int[np.ndarray, " n"]]:
    """Part and length of every run, and the first run of each part."""
    codes = np.frombuffer("".join(texts).encode("ascii", "replace"), np.uint8).astype(np.int64) - 48
    ends = np.cumsum([len(text) for text in texts])
    last = codes & 32 == 0
    if not all(texts) or codes.min() < 0 or codes.max() > 63 or not last[ends - 1].all():
        raise ValueError("texts: hold one that is no compressed mask")
    first = np.flatnonzero(np.concatenate([[True], last[:-1]]))
    sizes = np.diff(first, append=codes.size)
    if sizes.max() > 8:
        raise ValueError(f"texts: a run takes {sizes.max()} characters; at most 8 are wanted")
    shift = 5 * (np.arange(codes.size) - np.repeat(first, sizes))
    values = np.add.reduceat((codes & 31) << shift, first)
    values -= np.where(codes[first + sizes - 1] & 16 != 0, 1 << (5 * sizes), 0)
    stop = np.searchsorted(first, ends)
    start = np.concatenate([[0], stop[:-1]])
    part = np.repeat(np.arange(len(texts)), stop - start)
    place = np.arange(values.size) - start[part]
    for odd in (True, False):  # from the fourth on, values are differences to the run two before
        own = (place % 2 == odd) & (place > 0)
        total, owner = np.cumsum(values[own]), part[own]
        before = np.concatenate([[0], total])[np.searchsorted(owner, np.arange(len(texts)))]
        values[own] = total - before[owner]
    return part, values, start
