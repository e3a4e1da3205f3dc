"""Image files in, grey float32 pictures out, one at a time.

The header is looked at first, for all files: a picture of over 64 megapixels is refused before anything is decoded, and
a size other than the camera's before any tracking starts. Colour becomes grey by Rec. 601,
`0.299 R + 0.587 G + 0.114 B`.
"""

import fnmatch
import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

from ..errors import InputError
from .paths import inside, leaving

MAX_PIXELS = 64_000_000
FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "PPM")
SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm")
REC_601 = np.array([0.299, 0.587, 0.114], dtype=np.float32)

_EIGHT_BIT = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr")


@dataclass(frozen=True, slots=True, eq=False)
class Header:
    """What an image file says of itself before it is decoded."""

    width: int
    height: int
    deep: bool
    alpha: bool


@dataclass(frozen=True, slots=True, eq=False)
class ImageFiles:
    """Pictures in files, decoded when they are asked for.

    Attributes
    ----------
    paths : tuple of Path
        One file for each frame.
    times : (n,)
        Seconds.
    """

    paths: tuple[Path, ...]
    times: Float[np.ndarray, " n"]
    width: int
    height: int

    def __len__(self) -> int:
        return len(self.paths)

    def read(self, i: int) -> Float[np.ndarray, "h w"]:
        """Frame `i` as grey values 0..255, float32.

        Raises
        ------
        InputError
            If the file is broken, or has changed its size since the sequence was opened.
        """
        image = read_image(self.paths[i])
        if image.shape != (self.height, self.width):
            raise InputError(_wrong_size(self.paths[i], image.shape[1], image.shape[0], self.width, self.height))
        return image

    def __iter__(self) -> Iterator[Float[np.ndarray, "h w"]]:
        for i in range(len(self.paths)):
            yield self.read(i)


def open_images_of(
    paths: Sequence[Path], times: Float[np.ndarray, " n"], width: int, height: int
) -> tuple[ImageFiles, tuple[str, ...]]:
    """Check the headers of image files against the camera's size; warnings for 16-bit and alpha.

    Raises
    ------
    InputError
        For a file that is no image of a known format, has another size, or more than 64 megapixels.
    """
    deep, alpha = [], []
    for path in paths:
        header = read_header(path)
        if (header.width, header.height) != (width, height):
            raise InputError(_wrong_size(path, header.width, header.height, width, height))
        deep += [path] if header.deep else []
        alpha += [path] if header.alpha else []
    notes = []
    if deep:
        notes.append(f"{deep[0]}: 16-bit values are scaled to 0..255 (in {len(deep)} of {len(paths)} images)")
    if alpha:
        notes.append(f"{alpha[0]}: the alpha channel is dropped (in {len(alpha)} of {len(paths)} images)")
    return ImageFiles(tuple(paths), times, width, height), tuple(notes)


def _wrong_size(path: Path, width: int, height: int, wanted_width: int, wanted_height: int) -> str:
    return f"{path}: is {width} x {height} pixels; {wanted_width} x {wanted_height}, the camera's size, is wanted"


def image_paths(folder: Path) -> tuple[Path, ...]:
    """All image files of a folder, sorted by name."""
    try:
        names = sorted(
            name for name in os.listdir(folder) if name.lower().endswith(SUFFIXES) and not name.startswith(".")
        )
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror})") from error
    if not names:
        raise InputError(f"{folder}: has no images; at least one file ending in {' '.join(SUFFIXES)} is wanted")
    return tuple(folder / name for name in names)


def matching_paths(folder: Path, pattern: str, place: str) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Files inside `folder` that `pattern` matches, sorted by name (as text: `10` before `9`), and warnings.

    Only the last part of the pattern may have wildcards, so folders may be called anything. Hidden files do not match.
    """
    base, _ = inside(folder, pattern, place)
    where, wild = base.parent, base.name
    if not where.is_dir():
        raise InputError(f"{place} {pattern!r} matches nothing: {where} is no folder")
    try:
        names = sorted(n for n in os.listdir(where) if fnmatch.fnmatchcase(n, wild) and not n.startswith("."))
    except OSError as error:
        raise InputError(f"{where}: cannot be read ({error.strerror})") from error
    paths = tuple(where / name for name in names if (where / name).is_file())
    if not paths:
        raise InputError(f"{place} {pattern!r} matches no file in {where}; at least one image is wanted")
    leading_out = [path for path in paths if leaving(folder, path)]
    notes = leaving(folder, leading_out[0]) if leading_out else ()
    return paths, notes


def _open(path: Path) -> Image.Image:
    """Pillow's image with its header read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Pillow's own, higher limit and of odd metadata
        try:
            return Image.open(path, formats=FORMATS)
        except Image.DecompressionBombError as error:
            raise InputError(f"{path}: has over {MAX_PIXELS // 10**6} megapixels; it is not decoded") from error
        except FileNotFoundError as error:
            raise InputError(f"{path}: no such file") from error
        except Exception as error:  # Pillow's readers raise many kinds for broken files
            raise InputError(f"{path}: is no readable image; a PNG, JPEG, BMP, TIFF or PPM file is wanted") from error


def read_header(path: Path) -> Header:
    """Size, depth and alpha of an image file, without decoding it.

    Raises
    ------
    InputError
        If it is no image, has more than 64 megapixels, or values that are neither 8-bit nor 16-bit.
    """
    with _open(path) as image:
        return _header(path, image)


def _header(path: Path, image: Image.Image) -> Header:
    width, height = image.size
    if width * height > MAX_PIXELS:
        raise InputError(
            f"{path}: is {width} x {height} pixels, over {MAX_PIXELS // 10**6} megapixels; it is not decoded"
        )
    deep = image.mode.startswith("I;16") or any(";16" in str(tile[3]) for tile in getattr(image, "tile", ()))
    if not deep and image.mode not in _EIGHT_BIT:
        raise InputError(f"{path}: has values of kind {image.mode!r}; 8-bit or 16-bit grey or colour is wanted")
    return Header(width, height, deep, alpha=image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info)


def read_image(path: Path) -> Float[np.ndarray, "h w"]:
    """Decode one image to grey values 0..255, float32.

    Raises
    ------
    InputError
        If it is broken or what `read_header` refuses.
    """
    with _open(path) as image:
        _header(path, image)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                if image.mode.startswith("I;16"):
                    return np.asarray(image).astype(np.float32) * np.float32(255 / 65535)
                plain = image if image.mode in ("L", "RGB") else image.convert(_plain_mode(image.mode))
                return grey(np.asarray(plain))
            except Exception as error:  # as above
                raise InputError(
                    f"{path}: is broken ({' '.join(str(error).split())}); a complete image is wanted"
                ) from error


def _plain_mode(mode: str) -> str:
    return "L" if mode in ("1", "LA") else "RGB"


def grey(pixels: np.ndarray) -> Float[np.ndarray, "h w"]:
    """Rec. 601 luma of 8-bit colour, or 8-bit grey as it is; float32.

    >>> grey(np.array([[[200, 0, 0], [10, 10, 10]]], dtype=np.uint8)).round(1).astype(float).round(1).tolist()
    [[59.8, 10.0]]
    """
    if pixels.ndim == 2:
        return pixels.astype(np.float32)
    return pixels.astype(np.float32) @ REC_601
