"""Labelled images in, COCO annotation files out: hands with keypoints and masks, and every part with its masks.

Units of work make pieces, which are joined in their order at the end: a piece has a line for each entry (an image, a
hand or a part) behind one letter that says which. Numbers of entries follow from that of the image, so that pieces know
nothing of each other.

    id of a hand or part = 64 (number of the image) + number of the instance or part + 1

Boxes are [x, y, width, height] from the edges of pixels: column 0 begins at 0. Keypoints are x, y, v with the centre of
the top-left pixel at (0, 0).
"""

import zlib
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..labels.labelled import UNSEEN, Labelled
from ..labels.solids import HAND_PARTS, KEYPOINTS, MOST_PARTS
from .encode import DIGITS, Labels, compact, image_file, part_words, plain
from .index import visible_fraction
from .masks import masks_of_bits, masks_of_numbers, union_bits

HAND = 1  # the only category of hands.json
OCCLUDERS = ("sphere", "box", "pill", "mesh")
_KNOWN = HAND_PARTS + OCCLUDERS
BONES = tuple((0 if k % 4 == 1 else k - 1, k) for k in range(1, len(KEYPOINTS)))  # keypoints that a bone joins
Files = tuple[tuple[str, bytes], ...]


def unit_files(images: Iterable[Labelled], labels: Labels, number: int) -> Files:
    """Names and contents of the files of one unit of work: its images, and its piece of the annotations.

    Parameters
    ----------
    number : int
        Of the unit; names its piece.
    """
    files, lines = [], []
    for labelled in images:
        extension, content = image_file(labelled, labels)
        name = f"{labelled.index:09d}.{extension.partition('.')[2]}"
        files.append((f"images/{name}", content))
        lines += entries(labelled, name)
    return (*files, (piece_name(number), b"".join(line + b"\n" for line in lines)))


def piece_name(number: int) -> str:
    """Name of a unit's piece.

    >>> piece_name(12)
    'pieces/00012.jsonl'
    """
    return f"pieces/{number:05d}.jsonl"


def entries(labelled: Labelled, file_name: str) -> Iterator[bytes]:
    """Lines of one image: itself, its hands, its parts."""
    height, width = labelled.part.shape
    image = {"id": labelled.index, "file_name": file_name, "width": width, "height": height}
    yield b"i" + compact(image | {"sequence": labelled.sequence, "frame": labelled.frame})
    count = len(labelled.parts.kind)
    owner = labelled.parts.instance
    instance = np.append(owner, -1)[labelled.part]  # part -1 takes the last entry
    modal, amodal = (
        masks_of_numbers(instance, count),
        masks_of_bits(union_bits(labelled.amodal, owner, count), count),
    )
    area = np.bincount(instance[instance >= 0], minlength=count)
    for hand in range(labelled.keypoint.shape[0]):
        if area[hand]:
            yield b"h" + compact(_hand(labelled, hand, int(area[hand]), modal[hand], amodal[hand]))
    yield from _parts(labelled)


def merged(pieces: Iterable[bytes]) -> Files:
    """Names and contents of the annotation files from all pieces, in their order."""
    lines = {b"i": [], b"h": [], b"p": []}
    names: set[str] = set()
    for piece in pieces:
        for line in piece.splitlines():
            if line[:1] == b"n":
                names.add(line[1:].decode())
            else:
                lines[line[:1]].append(line[1:])
    hands = _document(lines[b"i"], lines[b"h"], hand_categories())
    return ("annotations/hands.json", hands), (
        "annotations/parts.json",
        _document(lines[b"i"], lines[b"p"], part_categories(sorted(names))),
    )


def _document(images: Sequence[bytes], annotations: Sequence[bytes], categories: list[dict[str, Any]]) -> bytes:
    return b'{"annotations":[%s],"categories":%s,"images":[%s],"info":{"description":"handtrack dataset"}}' % (
        b",\n".join(annotations),
        compact(categories),
        b",\n".join(images),
    )


def hand_categories() -> list[dict[str, Any]]:
    """The category of hands: names of the keypoints and the bones between them, numbered from 1."""
    bones = [[a + 1, b + 1] for a, b in BONES]
    return [{"id": HAND, "name": "hand", "supercategory": "hand", "keypoints": list(KEYPOINTS), "skeleton": bones}]


def part_categories(others: Iterable[str] = ()) -> list[dict[str, Any]]:
    """Categories of the parts of hands and of occluders, and of parts that only some models have."""
    return [
        {"id": category_of(name), "name": name, "supercategory": "occluder" if name in OCCLUDERS else "hand"}
        for name in (*_KNOWN, *(name for name in others if name not in _KNOWN))
    ]


def category_of(name: str) -> int:
    """Number of a part's category; a name of no list gets one from its own checksum, the same in every dataset.

    >>> category_of("wrist"), category_of("sphere")
    (1, 21)
    """
    return _KNOWN.index(name) + 1 if name in _KNOWN else 1000 + zlib.crc32(name.encode()) % 2**30


def _hand(labelled: Labelled, hand: int, area: int, modal: str, amodal: str) -> dict[str, Any]:
    parts = np.flatnonzero(labelled.parts.instance == hand).tolist()
    return _annotation(labelled, hand, HAND, area, modal, amodal, labelled.modal_box[hand]) | {
        "keypoints": keypoint_triples(labelled, hand),
        "num_keypoints": int((labelled.visibility[hand] > UNSEEN).sum()),
        "hidden_by": [None if k < 0 else part_words(labelled, k) for k in labelled.hidden_by[hand].tolist()],
        "side": labelled.parts.kind[hand].partition("_")[0],
        "amodal_bbox": _bbox(labelled.amodal_box[hand]),
        "visible_fraction": visible_fraction(labelled, hand),
        "part_visible_fraction": dict(
            zip([labelled.parts.name[k] for k in parts], plain(labelled.fraction[parts]), strict=True)
        ),
        "keypoints_mm": plain(labelled.keypoint_cam[hand]),
    }


def _parts(labelled: Labelled) -> Iterator[bytes]:
    """Lines of the parts that can be seen, and of names that stand in no list."""
    count = len(labelled.parts.name)
    numbers = labelled.part[labelled.part >= 0]
    area = np.bincount(numbers, minlength=count).tolist()
    modal, amodal = masks_of_numbers(labelled.part, count), masks_of_bits(labelled.amodal, count)
    boxes = _boxes(labelled.part, count)
    for k, name in enumerate(labelled.parts.name):
        if not area[k]:
            continue
        entry = _annotation(labelled, k, category_of(name), area[k], modal[k], amodal[k], boxes[k])
        share = round(float(labelled.fraction[k]), DIGITS)
        yield b"p" + compact(entry | {"instance": int(labelled.parts.instance[k]), "visible_fraction": share})
        if name not in _KNOWN:
            yield b"n" + name.encode()


def _annotation(
    labelled: Labelled, k: int, category: int, area: int, modal: str, amodal: str, box: Float[np.ndarray, " 4"]
) -> dict[str, Any]:
    size = list(labelled.part.shape)
    return {
        "id": labelled.index * MOST_PARTS + k + 1,
        "image_id": labelled.index,
        "category_id": category,
        "iscrowd": 0,
        "area": area,
        "bbox": _bbox(box),
        "segmentation": {"size": size, "counts": modal},
        "amodal_segmentation": {"size": size, "counts": amodal},
    }


def keypoint_triples(labelled: Labelled, hand: int) -> list[float | int]:
    """x, y and visibility of each keypoint, one after the other; zeros for those that are outside or not there."""
    visible = labelled.visibility[hand]
    xy = np.where(visible[:, None] > UNSEEN, labelled.keypoint[hand], 0.0)
    triples = zip(plain(xy), visible.tolist(), strict=True)
    return [number for (x, y), v in triples for number in (x, y, v)]


def _bbox(box: Float[np.ndarray, " 4"]) -> list[float]:
    x0, y0, x1, y1 = box.tolist()
    return [x0, y0, x1 - x0, y1 - y0]


def _boxes(part: Int[np.ndarray, "h w"], count: int) -> Float[np.ndarray, "p 4"]:
    """Pixels x0, y0, x1, y1 (half open) in which each part is seen; zeros where it is not."""
    y, x = np.nonzero(part >= 0)
    number = part[y, x]
    low = np.full((count, 2), max(part.shape))
    high = np.zeros((count, 2), np.int64)
    for k, at in enumerate((x, y)):
        np.minimum.at(low[:, k], number, at)
        np.maximum.at(high[:, k], number, at + 1)
    return np.where(high[:, :1] > 0, np.hstack([low, high]), 0).astype(float)
