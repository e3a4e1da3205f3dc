"""One labelled image in, its files as bytes out: what a dataset stores of it. `decode` is the inverse.

    image.png or image.jpg    colours as the sensor delivers them
    depth.png                 16 bit, round(depth / unit), 0 where nothing is
    normal.png                8 bit, round(127.5 (n + 1)), 0 0 0 where nothing is
    part.png                  8 bit, part number + 1, 0 where nothing is
    flow.png                  16 bit, round(64 u) + 32768, round(64 v) + 32768, 1; 0 0 0 where there is no flow
    json                      everything else

The same image gives the same bytes. Sorted keys, and numbers of a fixed number of digits, leave nothing open.
"""

import json
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt8, UInt16

from handtrack.errors import InputError
from handtrack.formats.cameras import camera_entries

from ..labels.labelled import Labelled
from .index import Row, row_of
from .masks import masks_of_bits

FORMAT = "handtrack/labels-1"
DIGITS = 6  # after the point, of pixels, millimetres and shares
FLOW_STEPS, FLOW_ZERO = 64.0, 32768  # per pixel; the value for no motion: KITTI's flow images
DEPTH_MAX = 65535

# Level, strategy and filter of zlib's and libpng's: where time and size were best together, see docs.
_UP = cv2.IMWRITE_PNG_FILTER_UP
_NUMBERS = (cv2.IMWRITE_PNG_COMPRESSION, 2, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_DEFAULT,
            cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE)  # fmt: skip
_RUNS = (cv2.IMWRITE_PNG_COMPRESSION, 3, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE,
           cv2.IMWRITE_PNG_FILTER, _UP)  # fmt: skip
_SMOOTH = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_DEFAULT,
           cv2.IMWRITE_PNG_FILTER, _UP)  # fmt: skip
_FLOW = (cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_DEFAULT,
           cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE)  # fmt: skip
_COLOURS = (cv2.IMWRITE_PNG_COMPRESSION, 3, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY,
            cv2.IMWRITE_PNG_FILTER, _UP)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Labels:
    """What is written of each image, and how.

    Attributes
    ----------
    image : "png" or "jpg"
    quality : int
        Of a JPEG image, 1 to 100.
    depth_unit : float
        Millimetres of depth for one step of the 16-bit image; 0.1 reaches to 6553 mm.
    depth, normal, part, flow, amodal : bool
        Whether depth, normals, part numbers, flow and the amodal masks of parts are written.
    """

    image: Literal["png", "jpg"] = "jpg"
    quality: int = 95
    depth_unit: float = 0.1
    depth: bool = True
    normal: bool = True
    part: bool = True
    flow: bool = True
    amodal: bool = True


@dataclass(frozen=True, slots=True)
class Sample:
    """The files of one image.

    Attributes
    ----------
    key : str
        Number of the image in the dataset, nine digits.
    files : tuple of (str, bytes)
        Extension and content of each file, in the order of the module's text.
    row : Row
        What the index says of it.
    """

    key: str
    files: tuple[tuple[str, bytes], ...]
    row: Row


def encoded(labelled: Labelled, labels: Labels, seed: int | None = None) -> Sample:
    """The files of one image.

    Parameters
    ----------
    seed : int, optional
        That the dataset was drawn from; goes into the JSON file.

    Raises
    ------
    InputError
        If depths do not fit into 16 bits of the chosen unit, or there is flow beyond 512 pixels.
    """
    key = f"{labelled.index:09d}"
    files = [image_file(labelled, labels)]
    if labels.depth:
        files.append(("depth.png", _png(depth_steps(labelled, labels.depth_unit), _RUNS)))
    if labels.normal:
        files.append(("normal.png", _png(normal_steps(labelled), _SMOOTH)))
    if labels.part:
        files.append(("part.png", _png((labelled.part + 1).astype(np.uint8), _NUMBERS)))
    if labels.flow:
        files.append(("flow.png", _png(flow_steps(labelled), _FLOW)))
    files.append(("json", json_bytes(labelled, labels, seed)))
    return Sample(key, tuple(files), row_of(labelled))


def image_file(labelled: Labelled, labels: Labels) -> tuple[str, bytes]:
    """Extension and content of the colour image."""
    pixels = cv2.cvtColor(labelled.image, cv2.COLOR_RGB2BGR)
    if labels.image == "png":
        return "image.png", _png(pixels, _COLOURS)
    _, content = cv2.imencode(".jpg", pixels, (cv2.IMWRITE_JPEG_QUALITY, labels.quality))
    return "image.jpg", content.tobytes()


def depth_steps(labelled: Labelled, unit: float) -> UInt16[np.ndarray, "h w"]:
    """Depth in steps of `unit` millimetres, 0 where nothing is.

    Raises
    ------
    InputError
        If a depth does not fit into 16 bits.
    """
    depth, seen = labelled.depth, _mask(labelled)
    low, high, *_ = cv2.minMaxLoc(depth, seen) if seen.any() else (unit, unit)
    if not (low >= 0.5 * unit and high <= DEPTH_MAX * unit):
        wrong = high if low >= 0.5 * unit else low
        raise InputError(
            f"image {labelled.index}: a depth of {wrong:g} mm does not fit into 16 bits with depth_unit_mm {unit:g}; "
            f"depths from {0.5 * unit:g} to {DEPTH_MAX * unit:g} mm are wanted, or another unit"
        )
    steps = cv2.addWeighted(depth, 1.0 / unit, depth, 0.0, 0.0, dtype=cv2.CV_16U)
    return cv2.copyTo(steps, seen)


def normal_steps(labelled: Labelled) -> UInt8[np.ndarray, "h w 3"]:
    """Normals as colours, blue (z) first; 0 0 0 where nothing is, which no unit normal becomes."""
    out = cv2.convertScaleAbs(labelled.normal, alpha=127.5, beta=127.5)
    return cv2.copyTo(cv2.cvtColor(out, cv2.COLOR_RGB2BGR), _mask(labelled))


def flow_steps(labelled: Labelled) -> UInt16[np.ndarray, "h w 3"]:
    """Flow as a 16-bit image: valid, y, x, the order in which OpenCV takes blue, green and red.

    Raises
    ------
    InputError
        For flow of 512 pixels or more.
    """
    flow, valid = labelled.flow, _mask(labelled)
    if np.isnan(flow.min(initial=0.0)):
        valid = valid * np.isfinite(flow).all(axis=-1)
        flow = np.where(valid[..., None] != 0, flow, np.float32(0.0))
    most = max(-flow.min(initial=0.0), flow.max(initial=0.0))
    if not most < FLOW_ZERO / FLOW_STEPS:
        raise InputError(f"image {labelled.index}: flow of {most:g} pixels; less than 512 is wanted of 16-bit flow")
    steps = cv2.addWeighted(flow, FLOW_STEPS, flow, 0.0, FLOW_ZERO, dtype=cv2.CV_16U)
    out = np.empty((*valid.shape, 3), np.uint16)
    cv2.mixChannels([steps, valid.astype(np.uint16)], [out], [0, 2, 1, 1, 2, 0])
    return cv2.copyTo(out, valid)


def _mask(labelled: Labelled) -> UInt8[np.ndarray, "h w"]:
    """1 where something is seen, 0 elsewhere."""
    return (labelled.part >= 0).view(np.uint8)


def _png(pixels: Shaped[np.ndarray, "h w *c"], how: tuple[int, ...]) -> bytes:
    return cv2.imencode(".png", pixels, how)[1].tobytes()


def json_bytes(labelled: Labelled, labels: Labels, seed: int | None) -> bytes:
    """The JSON file of one image."""
    document: dict[str, Any] = {
        "format": FORMAT,
        "index": labelled.index,
        "sequence": labelled.sequence,
        "frame": labelled.frame,
        "camera": dict(camera_entries(labelled.camera)),
        "depth_unit_mm": labels.depth_unit,
        "hands": [_hand(labelled, hand) for hand in range(labelled.keypoint.shape[0])],
        "instances": _instances(labelled),
        "parts": parts_entries(labelled, masks_of_bits(labelled.amodal, len(labelled.parts.name)), labels.amodal),
    }
    if seed is not None:
        document["seed"] = seed
    return compact(document)


def compact(document: object) -> bytes:
    """JSON without spaces, keys sorted."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False).encode("ascii")


def plain(values: Float[np.ndarray, " *n"]) -> Any:
    """Nested lists of rounded numbers, null for NaN.

    >>> plain(np.array([1 / 3, np.nan, -0.0]))
    [0.333333, None, 0.0]
    """
    out = (np.round(values, DIGITS) + 0.0).tolist()
    return out if np.isfinite(values).all() else _nulls(out)


def _nulls(value: Any) -> Any:
    if isinstance(value, list):
        return [_nulls(item) for item in value]
    return value if value == value else None


def _hand(labelled: Labelled, hand: int) -> dict[str, Any]:
    """Keypoints in the order of `KEYPOINTS`, and joint angles, of one hand."""
    by = labelled.hidden_by[hand].tolist()
    angles = plain(np.degrees(labelled.angles[hand]))
    return {
        "kind": labelled.parts.kind[hand],
        "keypoints": plain(labelled.keypoint[hand]),
        "keypoints_mm": plain(labelled.keypoint_cam[hand]),
        "visibility": labelled.visibility[hand].tolist(),
        "hidden_by": [None if k < 0 else k for k in by],
        "hidden_by_name": [None if k < 0 else part_words(labelled, k) for k in by],
        "angles_deg": dict(zip(labelled.joint_names[hand], angles, strict=True)),
    }


def part_words(labelled: Labelled, part: int) -> str:
    """Name of a part in the whole image: `hand 0 index_distal`, `sphere 2`."""
    instance = int(labelled.parts.instance[part])
    kind = labelled.parts.kind[instance]
    return f"hand {instance} {labelled.parts.name[part]}" if kind.endswith("hand") else f"{kind} {instance}"


def _instances(labelled: Labelled) -> list[dict[str, Any]]:
    boxes = zip(labelled.parts.kind, plain(labelled.modal_box), plain(labelled.amodal_box), strict=True)
    return [{"kind": kind, "modal_box": modal, "amodal_box": amodal} for kind, modal, amodal in boxes]


def parts_entries(labelled: Labelled, masks: tuple[str, ...], with_masks: bool) -> list[dict[str, Any]]:
    """What is known of each part."""
    size = list(labelled.part.shape)
    columns = zip(
        labelled.parts.name,
        labelled.parts.instance.tolist(),
        plain(labelled.visible_area),
        plain(labelled.amodal_area),
        plain(labelled.fraction),
        masks,
        strict=True,
    )
    return [
        {"name": name, "instance": instance, "visible_area": seen, "amodal_area": whole, "visible_fraction": share}
        | ({"amodal": {"size": size, "counts": mask}} if with_masks else {})
        for name, instance, seen, whole, share, mask in columns
    ]
