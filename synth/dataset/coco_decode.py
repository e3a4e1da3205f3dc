"""An image, its entries in COCO's annotations and its row of the index in, its labels as arrays out.

Depth, normals, flow and the camera are in no COCO file. Parts come in the order in which the annotations name them.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import UInt8

from handtrack.errors import InputError

from ..labels.solids import MOST_PARTS, Parts
from .coco import HAND, OCCLUDERS, category_of
from .decode import Decoded
from .index import Row
from .mask_bits import bits_of_texts
from .masks import mask_of_text, masks_of_numbers

Named = tuple[int, str]  # instance and name of a part


def coco_decoded(row: Row, image: UInt8[np.ndarray, "h w 3"], entries: Sequence[tuple[str, Any]]) -> Decoded:
    """Labels of one image.

    Parameters
    ----------
    row : Row
    image : (h, w, 3)
    entries : sequence of (str, dict)
        Letter and content of the image's entries, as `sample_files.piece_entries` gives them.

    Raises
    ------
    InputError
        If an entry is not what the annotations of a dataset hold.
    """
    try:
        hands = {_hand_number(entry): entry for kind, entry in entries if kind == "h"}
        return _decoded(row, image, hands, [entry for kind, entry in entries if kind == "p"])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(f"annotations of image {row.key}: {error}; those of a dataset are wanted") from error


def _hand_number(entry: dict[str, Any]) -> int:
    return int(entry["id"]) % MOST_PARTS - 1


def _decoded(row: Row, image: np.ndarray, hands: dict[int, dict[str, Any]], parts: list[dict[str, Any]]) -> Decoded:
    size = image.shape[:2]
    entry_of = {(int(entry["instance"]), int(entry["category_id"])): entry for entry in parts}
    share: dict[Named, float] = {
        (hand, name): np.nan if value is None else float(value)
        for hand, entry in hands.items()
        for name, value in entry["part_visible_fraction"].items()
    }
    share |= {
        (instance, OCCLUDERS[category - category_of(OCCLUDERS[0])]): float(entry["visible_fraction"])
        for (instance, category), entry in entry_of.items()
        if instance >= row.hands
    }
    named = sorted(share)
    found = [entry_of.get((instance, category_of(name))) for instance, name in named]
    part = np.full(size, -1)
    for k, entry in enumerate(found):
        if entry is not None:
            part[mask_of_text(entry["segmentation"]["counts"], size)] = k
    empty = masks_of_numbers(np.full(size, -1), 1)[0]
    amodal = bits_of_texts([entry["amodal_segmentation"]["counts"] if entry else empty for entry in found], size)
    areas = np.array([entry["area"] if entry else 0 for entry in found], float)
    keypoint, points, visible, hidden_by = _keypoints(row, hands, named)
    return Decoded(
        key=row.key,
        image=image,
        depth=None,
        normal=None,
        part=part,
        amodal=amodal,
        flow=None,
        keypoint=keypoint,
        keypoint_cam=points,
        visibility=visible,
        hidden_by=hidden_by,
        parts=Parts(tuple(name for _, name in named), np.array([i for i, _ in named], int), row.kinds),  # type: ignore[arg-type]
        visible_area=areas,
        amodal_area=np.array([int((amodal >> np.uint64(k) & np.uint64(1)).sum()) for k in range(len(named))], float),
        fraction=np.array([share[key] for key in named], float),
        modal_box=np.array(row.modal_boxes, float).reshape(-1, 4),
        amodal_box=np.array(row.amodal_boxes, float).reshape(-1, 4),
        joint_names=row.joints,
        angles=tuple(np.radians(angles) for angles in row.angles_deg),
        camera=None,
        index=row.index,
        sequence=row.sequence,
        frame=row.frame,
        depth_unit=1.0,
        seed=None,
    )


def _keypoints(row: Row, hands: dict[int, dict[str, Any]], named: list[Named]):
    """Pixels, camera axes, visibility and hiding part of the keypoints of all hands; NaN for a hand outside."""
    keypoint, points = np.full((row.hands, 21, 2), np.nan), np.full((row.hands, 21, 3), np.nan)
    visible, hidden_by = np.zeros((row.hands, 21), int), np.full((row.hands, 21), -1)
    for hand, entry in hands.items():
        if entry["category_id"] != HAND:
            raise ValueError(f"category {entry['category_id']} among the hands")
        triples = np.array(entry["keypoints"], float).reshape(21, 3)
        visible[hand] = triples[:, 2]
        keypoint[hand] = np.where(triples[:, 2:] > 0, triples[:, :2], np.nan)
        points[hand] = np.array(entry["keypoints_mm"], float).reshape(21, 3)
        for k, words in enumerate(entry["hidden_by"]):
            hider = None if words is None else _part_of_words(words)
            hidden_by[hand, k] = named.index(hider) if hider in named else -1
    return keypoint, points, visible, hidden_by


def _part_of_words(words: str) -> Named:
    """Instance and name of `hand 0 index_distal` or `sphere 2`."""
    kind, instance, *rest = words.split(" ", 2)
    return int(instance), rest[0] if rest else kind
