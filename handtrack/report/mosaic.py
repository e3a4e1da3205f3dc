"""One picture of each view in, one picture with all of them side by side out.

Up to three views stand in a row, more in a square. Pictures keep their scale, unless the whole would be wider than
browsers play.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

_GAP = 6  # pixels between neighbours
_IN_A_ROW = 3
_WIDEST = 3840
_BETWEEN = 24  # grey level of gaps and of what a smaller picture leaves over


def side_by_side(pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> UInt8[np.ndarray, "rows columns 3"]:
    """All pictures in one, in reading order; a single one as it is.

    >>> side_by_side([np.zeros((40, 30, 3), np.uint8), np.zeros((20, 50, 3), np.uint8)]).shape
    (40, 86, 3)
    """
    if len(pictures) == 1:
        return pictures[0]
    lefts, tops, width, height = _places([picture.shape[:2] for picture in pictures])
    whole = np.full((height, width, 3), _BETWEEN, dtype=np.uint8)
    for picture, left, top in zip(pictures, lefts, tops, strict=True):
        whole[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    if width <= _WIDEST:
        return whole
    return cv2.resize(whole, (_WIDEST, round(height * _WIDEST / width)), interpolation=cv2.INTER_AREA)


def _places(sizes: Sequence[tuple[int, int]]) -> tuple[list[int], list[int], int, int]:
    """Left and upper edge of each picture, then width and height of the whole; sizes are (height, width)."""
    columns = len(sizes) if len(sizes) <= _IN_A_ROW else math.ceil(math.sqrt(len(sizes)))
    widths = [max(width for _, width in sizes[column::columns]) for column in range(columns)]
    heights = [max(height for height, _ in sizes[i : i + columns]) for i in range(0, len(sizes), columns)]
    left = np.concatenate([[0], np.cumsum(np.array(widths) + _GAP)])
    top = np.concatenate([[0], np.cumsum(np.array(heights) + _GAP)])
    lefts = [int(left[i % columns]) for i in range(len(sizes))]
    tops = [int(top[i // columns]) for i in range(len(sizes))]
    return lefts, tops, int(left[-1]) - _GAP, int(top[-1]) - _GAP
