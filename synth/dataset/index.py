"""What is known of every image in, one Parquet table out: which image is where, and what to choose it by.

A row for each image, in the order of their numbers. Readers find an image in its shard by `offset` and `size`, without
reading the rest, and select images by occlusion, view or pose before they load any.
"""

import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import islice, pairwise
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ..labels.labelled import HIDDEN, SEEN, Labelled
from ..labels.solids import KEYPOINTS

GROUP = 10_000  # rows
_WRIST, _INDEX, _MIDDLE, _LITTLE = (KEYPOINTS.index(f"{n}") for n in ("wrist", "index_mcp", "middle_mcp", "little_mcp"))


@dataclass(frozen=True, slots=True)
class Row:
    """One image. Lists of hands have one entry for each hand, lists of instances for each hand and occluder.

    Attributes
    ----------
    key : str
        Name of the image's files.
    index, sequence, frame : int
    shard : str
        Name of the archive that holds it; empty where there is none.
    offset, size : int
        Bytes in front of the image's first file header in the archive, and bytes of all its files with their headers;
        0 where there is no archive.
    width, height : int
        Pixels.
    hands, occluders : int
    kinds : tuple of str
        Of instances.
    keypoints_seen, keypoints_hidden : int
    visible_fraction : tuple of float or None
        Share of the pixels of each whole hand that are seen; None where it is outside the image.
    modal_boxes, amodal_boxes : tuple of tuple of 4 float
        Pixels x0, y0, x1, y1 of instances.
    distance_mm : tuple of float or None
        From the camera to the mean of a hand's keypoints; along z for a parallel camera.
    view : tuple of tuple of 3 float or None
        Unit vector from the hand to the camera in the hand's axes: towards the thumb's side, from wrist to knuckles,
        and out of the back. None where wrist or knuckles are not known.
    visibility : tuple of tuple of int
        Of the 21 keypoints of each hand: 0 outside or not there, 1 hidden, 2 seen.
    joints, angles_deg : tuple of tuple of str, tuple of tuple of float
        Names and values of the joints of each hand.
    """

    key: str
    index: int
    sequence: int
    frame: int
    shard: str
    offset: int
    size: int
    width: int
    height: int
    hands: int
    occluders: int
    kinds: tuple[str, ...]
    keypoints_seen: int
    keypoints_hidden: int
    visible_fraction: tuple[float | None, ...]
    modal_boxes: tuple[tuple[float, ...], ...]
    amodal_boxes: tuple[tuple[float, ...], ...]
    distance_mm: tuple[float | None, ...]
    view: tuple[tuple[float, ...] | None, ...]
    visibility: tuple[tuple[int, ...], ...]
    joints: tuple[tuple[str, ...], ...]
    angles_deg: tuple[tuple[float, ...], ...]


def _list(of: pa.DataType) -> pa.DataType:
    return pa.list_(of)


SCHEMA = pa.schema(
    [
        ("key", pa.string()),
        *((name, pa.int64()) for name in ("index", "sequence", "frame")),
        ("shard", pa.string()),
        *((name, pa.int64()) for name in ("offset", "size")),
        *((name, pa.int32()) for name in ("width", "height", "hands", "occluders")),
        ("kinds", _list(pa.string())),
        *((name, pa.int32()) for name in ("keypoints_seen", "keypoints_hidden")),
        ("visible_fraction", _list(pa.float64())),
        *((name, _list(_list(pa.float64()))) for name in ("modal_boxes", "amodal_boxes")),
        ("distance_mm", _list(pa.float64())),
        ("view", _list(_list(pa.float64()))),
        ("visibility", _list(_list(pa.int8()))),
        ("joints", _list(_list(pa.string()))),
        ("angles_deg", _list(_list(pa.float64()))),
    ]
)


def row_of(labelled: Labelled) -> Row:
    """The row of an image that is in no archive yet."""
    kinds = labelled.parts.kind
    hands = labelled.keypoint.shape[0]
    places = [_distance_and_view(labelled, hand) for hand in range(hands)]
    return Row(
        f"{labelled.index:09d}",
        labelled.index,
        labelled.sequence,
        labelled.frame,
        "",
        0,
        0,
        labelled.camera.width,
        labelled.camera.height,
        hands,
        len(kinds) - hands,
        kinds,
        int((labelled.visibility == SEEN).sum()),
        int((labelled.visibility == HIDDEN).sum()),
        tuple(visible_fraction(labelled, hand) for hand in range(hands)),
        tuple(tuple(box) for box in labelled.modal_box.tolist()),
        tuple(tuple(box) for box in labelled.amodal_box.tolist()),
        tuple(distance for distance, _ in places),
        tuple(view for _, view in places),
        tuple(tuple(visible) for visible in labelled.visibility.tolist()),
        labelled.joint_names,
        tuple(tuple((np.round(np.degrees(q), 6) + 0.0).tolist()) for q in labelled.angles),
    )


def visible_fraction(labelled: Labelled, instance: int) -> float | None:
    """Share of the pixels that an instance would cover alone in which it is seen; None where there are none."""
    own = np.flatnonzero(labelled.parts.instance == instance)
    bits = np.uint64(sum(1 << k for k in own.tolist()))
    whole = np.count_nonzero(labelled.amodal & bits)
    seen = np.count_nonzero((labelled.part >= own[0]) & (labelled.part <= own[-1])) if own.size else 0
    return round(seen / whole, 6) if whole else None


def _distance_and_view(labelled: Labelled, hand: int) -> tuple[float | None, tuple[float, ...] | None]:
    """Millimetres to a hand, and the direction from it to the camera in its own axes."""
    p = labelled.keypoint_cam[hand]
    known = p[np.isfinite(p).all(axis=1)]
    if not known.size:
        return None, None
    middle = known.mean(axis=0)
    parallel = labelled.camera.kind == "orthographic"
    distance = float(middle[2] if parallel else math.sqrt(middle @ middle))
    up, side = p[_MIDDLE] - p[_WRIST], p[_INDEX] - p[_LITTLE]
    out = np.array(
        [side[1] * up[2] - side[2] * up[1], side[2] * up[0] - side[0] * up[2], side[0] * up[1] - side[1] * up[0]]
    )
    if labelled.parts.kind[hand] == "right_hand":
        out = -out
    lengths = math.sqrt(up @ up), math.sqrt(out @ out)
    if not (min(lengths) > 0 and math.isfinite(sum(lengths))):
        return round(distance, 6), None
    up, out = up / lengths[0], out / lengths[1]
    side = side - (side @ up) * up
    side = side / math.sqrt(side @ side)
    towards = np.array([0.0, 0.0, -1.0]) if parallel else -middle / math.sqrt(middle @ middle)
    return round(distance, 6), tuple(round(float(towards @ axis), 6) + 0.0 for axis in (side, up, out))


def index_bytes(rows: Iterable[Row]) -> bytes:
    """A Parquet file of rows; the same rows give the same bytes.

    Raises
    ------
    ValueError
        If the rows are not in the order of their numbers.
    """
    stream, rows, last = io.BytesIO(), iter(rows), -1
    with pq.ParquetWriter(
        stream,
        SCHEMA,
        compression="zstd",
        compression_level=3,
        version="2.6",
        store_schema=False,
        write_statistics=True,
    ) as writer:
        while batch := list(islice(rows, GROUP)):  # no more rows than these are in memory
            numbers = [last, *(row.index for row in batch)]
            if any(b <= a for a, b in pairwise(numbers)):
                raise ValueError("rows: image numbers do not rise; sorted rows, each once, are wanted")
            last = numbers[-1]
            columns = [pa.array([getattr(row, field.name) for row in batch], field.type) for field in SCHEMA]
            writer.write_table(pa.Table.from_arrays(columns, schema=SCHEMA), row_group_size=GROUP)
    return stream.getvalue()


def read_index(content: bytes) -> tuple[Row, ...]:
    """Rows of a Parquet file that `index_bytes` wrote.

    Raises
    ------
    ValueError
        If the content is none.
    """
    try:
        table = pq.read_table(io.BytesIO(content))
    except pa.ArrowException as error:
        raise ValueError(f"content: {' '.join(str(error).split())}; a Parquet file is wanted") from error
    names = [field.name for field in fields(Row)]
    missing = [name for name in names if name not in table.column_names]
    if missing:
        raise ValueError(f"content: has no column {missing[0]!r}; an index of images is wanted")
    columns = [table.column(name).to_pylist() for name in names]
    return tuple(Row(*(_tuples(value) for value in row)) for row in zip(*columns, strict=True))


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def placed(rows: Sequence[Row], shard: str, spans: Sequence[tuple[int, int]]) -> tuple[Row, ...]:
    """Rows that say where in a shard their images are; spans (offset, size) come from `shards.spans_of`."""
    return tuple(
        replace(row, shard=shard, offset=offset, size=size) for row, (offset, size) in zip(rows, spans, strict=True)
    )
