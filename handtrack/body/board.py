"""A picture of a ChArUco board in, its chessboard corners out (wrist thesis, 5.2.1).

The board lies in the plane z = 0 of its own frame: x along its columns, y down its rows, z into the board, origin at
the outer corner of the first square. Corners are counted along rows, as OpenCV does. OpenCV 4 and 5 give arrays of
different shapes; both are brought to `(n, 2)` and `(n,)` here and nowhere else.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
from jaxtyping import Float, Int, Num, UInt8
from pydantic import Field

from ..camera import Camera
from ..errors import InputError
from ..formats.paths import inside, read_bytes
from ..formats.yaml_files import MAX_BYTES, Strict, at, parse_yaml, read_yaml, validate

FORMAT = "handtrack/board-1"
MOST_SQUARES = 100  # along a side
LARGEST_SQUARE = 5.0  # metres: a larger one is in another unit
LEAST_CORNERS = 6
SETTLED = 1e-3  # pixels: OpenCV's own 0.1 stops corners 0.2 pixels from where they settle
DICTIONARIES = tuple(sorted(name[5:] for name in dir(cv2.aruco) if name.startswith("DICT_") and name.isupper()))


@dataclass(frozen=True, slots=True, eq=False)
class Dictionary:
    """Patterns of markers.

    Attributes
    ----------
    name : str
        One of OpenCV's, such as `5X5_100`, or that of a file.
    bits : (n, s, s)
        Inner squares of each marker, 1 is white.
    mend : int
        Wrong bits that are mended.
    """

    name: str
    bits: UInt8[np.ndarray, "n s s"]
    mend: int


@dataclass(frozen=True, slots=True, eq=False)
class Board:
    """A chessboard with a marker in each white square.

    Attributes
    ----------
    columns, rows : int
        Squares along x and y, at least 2.
    square, marker : float
        Sides of a square and of the marker in it, metres.
    dictionary : Dictionary
    legacy : bool
        A white first square where `rows` is even, as OpenCV printed boards before 4.6.
    first : int
        Number of the first marker.
    """

    columns: int
    rows: int
    square: float
    marker: float
    dictionary: Dictionary
    legacy: bool = False
    first: int = 0

    def __post_init__(self) -> None:
        for name, value in (("columns", self.columns), ("rows", self.rows)):
            if not 2 <= value <= MOST_SQUARES:
                raise ValueError(f"{name}: {value} given; 2 to {MOST_SQUARES} are wanted")
        if not 0 < self.square <= LARGEST_SQUARE:
            raise ValueError(
                f"square: {self.square:g} given; metres, above 0 and at most {LARGEST_SQUARE:g}, are wanted"
            )
        if not 0 < self.marker < self.square:
            raise ValueError(f"marker: {self.marker:g} given; a side above 0 and below the square's is wanted")
        known = self.dictionary.bits.shape[0]
        if not 0 <= self.first <= known - self.markers:
            raise ValueError(
                f"first: {self.first} given; {self.markers} markers from there on are wanted of the {known} of "
                f"{self.dictionary.name}"
            )

    @property
    def markers(self) -> int:
        """Number of markers, one in each white square."""
        return self.columns * self.rows // 2

    @property
    def corners(self) -> Float[np.ndarray, "c 3"]:
        """Inner corners of the chessboard in the board's frame, metres."""
        y, x = np.mgrid[1 : self.rows, 1 : self.columns]
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * self.square


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """Corners found: pixels (n, 2), their numbers (n,), and how many markers were read."""

    xy: Float[np.ndarray, "n 2"]
    ids: Int[np.ndarray, " n"]
    markers: int


class _BoardFile(Strict):
    format: Literal["handtrack/board-1"]
    columns: Annotated[int, Field(ge=2, le=MOST_SQUARES)]
    rows: Annotated[int, Field(ge=2, le=MOST_SQUARES)]
    square: Annotated[float, Field(gt=0, le=LARGEST_SQUARE)]
    marker: Annotated[float, Field(gt=0)]
    dictionary: str
    legacy: bool = False
    first: Annotated[int, Field(ge=0)] = 0


def read_board(path: Path | str) -> Board:
    """Read `board.yaml`.

    `dictionary` is a name (`5X5_100`) or a file of markers inside the board's folder, as OpenCV writes them.

    Raises
    ------
    InputError
        For a file that is none, or a board that cannot be.
    """
    document = read_yaml(Path(path))
    entry = validate(document, _BoardFile)
    name = entry.dictionary.upper().removeprefix("DICT_")
    if name in DICTIONARIES:
        dictionary = named_dictionary(name)
    elif entry.dictionary.lower().endswith((".yml", ".yaml")):
        dictionary = read_dictionary(inside(document.path.parent, entry.dictionary, at(document, ("dictionary",)))[0])
    else:
        raise InputError(
            f"{at(document, ('dictionary',))} {entry.dictionary!r} given; one of {', '.join(DICTIONARIES)}, or a file "
            "that ends in .yml, is wanted"
        )
    try:
        return Board(entry.columns, entry.rows, entry.square, entry.marker, dictionary, entry.legacy, entry.first)
    except ValueError as error:
        raise InputError(f"{document.path}: {error}") from error


def named_dictionary(name: str) -> Dictionary:
    """One of OpenCV's dictionaries: `4X4_50` ... `7X7_1000`, `APRILTAG_36H11`, `ARUCO_ORIGINAL` ...

    >>> named_dictionary("5X5_100").bits.shape
    (100, 5, 5)
    """
    if name not in DICTIONARIES:
        raise ValueError(f"name: {name!r} given; one of {', '.join(DICTIONARIES)} is wanted")
    opened = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
    size, rows = int(opened.markerSize), np.asarray(opened.bytesList)
    bits = [cv2.aruco.Dictionary.getBitsFromByteList(row[None], size) for row in rows]
    return Dictionary(name, np.asarray(bits, np.uint8).reshape(-1, size, size), int(opened.maxCorrectionBits))


def read_dictionary(path: Path | str) -> Dictionary:
    """Read markers of one's own from a file of OpenCV's `Dictionary.writeDictionary`.

    Raises
    ------
    InputError
        For a file that is none, with file and key.
    """
    path = Path(path)
    content = read_bytes(path, MAX_BYTES)
    if content.startswith(b"%YAML:"):  # OpenCV's own first line, which no other parser knows
        content = b"#" + content
    data = parse_yaml(content, path).data
    if not isinstance(data, dict):
        raise InputError(f"{path}: keys nmarkers, markersize and marker_0 on are wanted")
    count, size, mend = (data.get(key, 0) for key in ("nmarkers", "markersize", "maxCorrectionBits"))
    for key, value, low, high in (
        ("nmarkers", count, 1, 10_000), ("markersize", size, 3, 16), ("maxCorrectionBits", mend, 0, 256)
    ):  # fmt: skip
        if not isinstance(value, int) or not low <= value <= high:
            raise InputError(f"{path}: {key}: {value!r} given; a whole number from {low} to {high} is wanted")
    bits = np.empty((count, size * size), np.uint8)
    for i in range(count):
        text = data.get(f"marker_{i}", "")
        if not isinstance(text, str) or len(text) != size * size or not set(text) <= {"0", "1"}:
            raise InputError(f"{path}: marker_{i}: {size * size} digits 0 or 1 in quotes are wanted")
        bits[i] = np.frombuffer(text.encode(), np.uint8) - ord("0")
    return Dictionary(path.name, bits.reshape(count, size, size), mend)


def opencv_board(board: Board) -> cv2.aruco.CharucoBoard:
    """The same board for OpenCV, which can also draw it: `opencv_board(board).generateImage((w, h))`."""
    rows = [np.asarray(cv2.aruco.Dictionary.getByteListFromBits(bits)) for bits in board.dictionary.bits]
    markers = cv2.aruco.Dictionary(np.concatenate(rows), board.dictionary.bits.shape[1], board.dictionary.mend)
    ids = np.arange(board.first, board.first + board.markers, dtype=np.int32)
    out = cv2.aruco.CharucoBoard((board.columns, board.rows), float(board.square), float(board.marker), markers, ids)
    out.setLegacyPattern(board.legacy)
    return out


def flat(array: Num[np.ndarray, "..."] | None, width: int) -> Num[np.ndarray, "n w"]:
    """What OpenCV found as rows: `(n, 1, w)` of version 4, `(n, w)` of version 5, or None for nothing.

    >>> flat(np.zeros((3, 1, 2)), 2).shape, flat(np.zeros((3, 2)), 2).shape, flat(None, 1).shape
    ((3, 2), (3, 2), (0, 1))
    """
    return np.zeros((0, width)) if array is None else np.asarray(array).reshape(-1, width)


def detect(image: Num[np.ndarray, "h w *c"], board: Board, camera: Camera | None = None) -> Detection:
    """Find the corners of a board.

    Parameters
    ----------
    image : (h, w) or (h, w, 3)
        Grey, or colour in OpenCV's order, 0..255.
    camera : Camera or None
        Only its size is looked at. Corners are placed by the markers beside them, which no lens bends much; a camera's
        parameters would add their own error to that.

    Returns
    -------
    Detection
        Pixels in the order of the corners' numbers; perhaps none.

    Raises
    ------
    ValueError
        If the image has another size than the camera.
    """
    if camera is not None and image.shape[:2] != (camera.height, camera.width):
        raise ValueError(
            f"image: {image.shape[1]} x {image.shape[0]} pixels; {camera.width} x {camera.height}, the camera's, wanted"
        )
    pixels = np.ascontiguousarray(np.clip(image, 0, 255), np.uint8)
    grey = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
    habits = cv2.aruco.DetectorParameters()
    habits.cornerRefinementMinAccuracy = SETTLED
    detector = cv2.aruco.CharucoDetector(opencv_board(board), cv2.aruco.CharucoParameters(), habits)
    corners, ids, _, markers = detector.detectBoard(grey)
    xy, number = flat(corners, 2).astype(float), flat(ids, 1)[:, 0].astype(int)
    order = np.argsort(number, kind="stable")
    return Detection(xy[order], number[order], flat(markers, 1).shape[0])


def refusal(board: Board, found: Detection) -> str:
    """Why a detection gives no pose, in words; empty where it does."""
    if not found.markers:
        return f"no marker of {board.dictionary.name} is seen"
    if not found.ids.size:
        return (
            f"{found.markers} markers are seen, but they are not arranged as on this board (is it of another size, "
            "first marker or legacy pattern?)"
        )
    if found.ids.size < LEAST_CORNERS:
        return f"{found.ids.size} corners are seen; {LEAST_CORNERS} are wanted"
    cells = np.column_stack([found.ids % (board.columns - 1), found.ids // (board.columns - 1)]).astype(float)
    if np.linalg.matrix_rank(cells - cells[0]) < 2:
        return "the corners seen are on one line; some across it are wanted"
    return ""
