"""Random numbers in, what is behind the hand out: one grey level, smooth colours, or a piece of an image."""

from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from handtrack.errors import InputError
from handtrack.formats.images import read_header
from handtrack.formats.paths import read_bytes

MOST_CACHED = 64 * 2**20  # bytes of decoded images that a process keeps
FINER = 40  # columns and rows of smooth colours before they are stretched
_cache: OrderedDict[Path, UInt8[np.ndarray, "h w 3"]] = OrderedDict()


def plain(rng: np.random.Generator, size: tuple[int, int], level: tuple[float, float]) -> UInt8[np.ndarray, "h w 3"]:
    """One grey level, drawn from a range; `size` is (width, height)."""
    return np.full((size[1], size[0], 3), round(rng.uniform(*level)), np.uint8)


def colours(rng: np.random.Generator, size: tuple[int, int], level: tuple[float, float]) -> UInt8[np.ndarray, "h w 3"]:
    """Smooth colours: a few random ones, paler or stronger, spread by bicubic, then (faster) linear interpolation."""
    rows, columns = rng.integers(2, 9, 2)
    grey = rng.uniform(*level, (rows, columns, 1))
    coarse = (grey + rng.uniform(0.0, 0.6) * (rng.uniform(*level, (rows, columns, 3)) - grey)).astype(np.uint8)
    finer = cv2.resize(coarse, (FINER, FINER), interpolation=cv2.INTER_CUBIC)
    return cv2.resize(finer, size, interpolation=cv2.INTER_LINEAR)


def piece(rng: np.random.Generator, size: tuple[int, int], paths: Sequence[Path]) -> UInt8[np.ndarray, "h w 3"]:
    """A random piece of a random image, of the wanted shape, perhaps mirrored, scaled to the wanted size."""
    image = _decoded(paths[int(rng.integers(len(paths)))])
    height, width = image.shape[:2]
    largest = min(width / size[0], height / size[1])
    scale = largest * rng.uniform(0.5, 1.0)
    w, h = max(1, int(scale * size[0])), max(1, int(scale * size[1]))
    x, y = int(rng.integers(width - w + 1)), int(rng.integers(height - h + 1))
    cut = image[y : y + h, x : x + w]
    if rng.random() < 0.5:
        cut = cut[:, ::-1]
    how = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
    return cv2.resize(np.ascontiguousarray(cut), size, interpolation=how)


def _decoded(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """Red, green, blue of an image file; the images used last stay in memory up to a limit."""
    found = _cache.pop(path, None)
    if found is None:
        read_header(path)  # refuses what is too large before it is decoded
        data = np.frombuffer(read_bytes(path), np.uint8)
        decoded = cv2.imdecode(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if decoded is None:
            raise InputError(f"{path}: cannot be decoded; an image is wanted")
        found = np.ascontiguousarray(decoded[..., ::-1])
    _cache[path] = found
    while len(_cache) > 1 and sum(image.nbytes for image in _cache.values()) > MOST_CACHED:
        _cache.popitem(last=False)
    return found
