"""Files of one image in, the rules that its labels break out: what has to hold between labels, whatever the scene.

Modal masks are a partition of the foreground, as they are numbers of one image; so the rules compare that image with
the other ones, and everything else with it. Files are decoded no further than the rules need: this runs for every
image.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8, UInt64

from handtrack.errors import InputError

from ..labels.labelled import HIDDEN, SEEN, UNSEEN
from ..labels.solids import KEYPOINTS
from .decode import read_document
from .mask_bits import bits_of_texts

SLACK = 2e-6  # files round to six digits
SPECK, SLIVER = 2, 0.01  # pixels, and share of a part's area: so little of it the samples which measure areas may miss


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """What the rules are about.

    Attributes
    ----------
    size : (h, w)
        Of the picture.
    part : (h, w) or None
        Part number + 1; 0 for the background.
    depth, normal : (h, w) or None
        Where they say that something is seen.
    amodal : (h, w) or None
        Bit k for part k.
    instance : (p,)
        Of each part.
    visible_area, amodal_area, fraction : (p,)
    keypoint, visibility, hidden_by : (n, 21, 2), (n, 21), (n, 21)
    modal_box, amodal_box : (i, 4)
    """

    size: tuple[int, int]
    part: UInt8[np.ndarray, "h w"] | None
    depth: Bool[np.ndarray, "h w"] | None
    normal: Bool[np.ndarray, "h w"] | None
    amodal: UInt64[np.ndarray, "h w"] | None
    instance: Int[np.ndarray, " p"]
    visible_area: Float[np.ndarray, " p"]
    amodal_area: Float[np.ndarray, " p"]
    fraction: Float[np.ndarray, " p"]
    keypoint: Float[np.ndarray, "n 21 2"]
    visibility: Int[np.ndarray, "n 21"]
    hidden_by: Int[np.ndarray, "n 21"]
    modal_box: Float[np.ndarray, "i 4"]
    amodal_box: Float[np.ndarray, "i 4"]


def checked(key: str, files: Sequence[tuple[str, bytes]]) -> Checked:
    """What the files of an image say.

    Parameters
    ----------
    files : sequence of (str, bytes)
        By their extensions.

    Raises
    ------
    InputError
        If files are missing, cannot be decoded, or have another size than the picture.
    """
    by = dict(files)
    if "json" not in by:
        raise InputError(f"{key}: has no json file; labels of one image are wanted")
    document = read_document(key, by["json"])
    try:
        size = int(document["camera"]["height"]), int(document["camera"]["width"])
        part, depth, normal = _planes(key, by, size)
        return Checked(size, part, depth, normal, _amodal(document, size), *_numbers(document))
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        wrong = f"no {error}" if isinstance(error, KeyError) else " ".join(str(error).split())
        raise InputError(f"{key}.json: {wrong}; labels of one image are wanted") from error


def broken_rules(image: Checked) -> tuple[str, ...]:
    """One line for each rule that the labels of an image break; none as a rule."""
    count = image.instance.size
    if image.part is not None and image.part.max(initial=0) > count:
        return (f"part {image.part.max() - 1} of {count} parts",)
    return (*_foreground(image), *_areas(image), *_keypoints(image), *_boxes(image))


def _foreground(image: Checked) -> list[str]:
    """The image of parts against depth, normals and amodal masks."""
    part, out = image.part, []
    if part is None:
        return []
    seen = part > 0
    if image.depth is not None and (image.depth != seen).any():
        out.append("the foreground of depth is not that of parts")
    if image.normal is not None and (image.normal != seen).any():
        out.append("the foreground of normals is not that of parts")
    if image.amodal is not None:
        if ((image.amodal != 0) != seen).any():
            out.append("the union of amodal masks is not the foreground")
        at = np.flatnonzero(seen)
        own = np.uint64(1) << (part.ravel()[at] - 1).astype(np.uint64)
        if (image.amodal.ravel()[at] & own == 0).any():
            out.append("a modal mask is not inside its amodal mask")
    return out


def _areas(image: Checked) -> list[str]:
    """Visible and amodal areas, and their ratio."""
    seen, whole, share = image.visible_area, image.amodal_area, image.fraction
    out = []
    if (seen < 0).any() or (seen > whole + SLACK).any() or (whole > image.size[0] * image.size[1] + SLACK).any():
        out.append("areas do not rise from 0 over visible and amodal to the image's")
    known = whole > SLACK
    if np.isfinite(share[whole == 0]).any() or not np.isfinite(share[known]).all():
        out.append("a visible fraction is given where a part is outside, or is not where it is inside")
    # the ratio of two rounded areas: what rounding can do to it grows as the area shrinks
    off = np.abs(share[known] * whole[known] - seen[known])
    if (off > SLACK * (1.0 + whole[known])).any():
        out.append("a visible fraction is not visible over amodal area")
    if image.part is not None:
        pixels = np.bincount(image.part.ravel(), minlength=seen.size + 1)[1:]
        if (seen[pixels > SPECK + SLIVER * whole] <= 0).any():
            out.append("a part is seen but has no visible area")
    return out


def _keypoints(image: Checked) -> list[str]:
    """Visibility against places, against what hides, and against visible fractions."""
    visible, by, xy = image.visibility, image.hidden_by, image.keypoint
    height, width = image.size
    out = []
    if not np.isin(visible, (UNSEEN, HIDDEN, SEEN)).all():
        return ["a keypoint's visibility is none of 0, 1, 2"]
    if ((by >= 0) != (visible == HIDDEN)).any() or by.max(initial=-1) >= image.instance.size:
        return ["a keypoint is hidden by nothing, or not hidden by something"]
    with np.errstate(invalid="ignore"):
        slack = np.where(visible > UNSEEN, SLACK, -SLACK)[..., None]
        inside = ((xy >= -0.5 - slack) & (xy <= np.array([width, height]) - 0.5 + slack)).all(axis=-1)
    if (inside != (visible > UNSEEN)).any():
        out.append("a keypoint's visibility and its place disagree about the image's edge")
    for hand in range(visible.shape[0]):
        area = image.visible_area[image.instance == hand].sum()
        if (visible[hand] == SEEN).any() and area <= 0:
            out += [f"keypoints of hand {hand} are seen, but no part of it is"]
    if (image.amodal_area[np.unique(by[by >= 0])] <= 0).any():
        out.append("a keypoint is hidden by a part that is not in the image")
    return out


def _boxes(image: Checked) -> list[str]:
    """Modal boxes inside amodal ones, those inside the image, and pixels inside boxes."""
    height, width = image.size
    modal, amodal = image.modal_box, image.amodal_box
    out = []
    full = (modal[:, 2:] > modal[:, :2]).all(axis=1)
    if (modal[~full] != 0).any():
        out.append("a box is empty, but not at 0")
    if (modal[full, :2] < amodal[full, :2]).any() or (modal[full, 2:] > amodal[full, 2:]).any():
        out.append("a modal box is not inside its amodal box")
    if (amodal[:, :2] < 0).any() or (amodal[:, 2:] > (width, height)).any():
        out.append("an amodal box is not inside the image")
    if image.part is None:
        return out
    own = np.append(0, image.instance + 1).astype(np.uint8)[image.part]  # instance + 1 of each pixel
    for k in range(modal.shape[0]):
        x0, y0, x1, y1 = modal[k].astype(int)
        if (own[max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)] == k + 1).sum() != (own == k + 1).sum():
            out.append(f"pixels of instance {k} lie outside its modal box")
    return out


def _planes(key: str, by: Mapping[str, bytes], size: tuple[int, int]) -> tuple[Any, Any, Any]:
    """Parts, and where depth and normals say that something is seen. No rule is about flow: it takes as long."""
    part = _picture(key, "part.png", by, size)
    depth, normal = (_picture(key, f"{name}.png", by, size) for name in ("depth", "normal"))
    return (
        part,
        None if depth is None else depth != 0,
        None if normal is None else (normal[..., 0] | normal[..., 1] | normal[..., 2]) != 0,
    )


def _picture(key: str, name: str, by: Mapping[str, bytes], size: tuple[int, int]) -> np.ndarray | None:
    if name not in by:
        return None
    pixels = cv2.imdecode(np.frombuffer(by[name], np.uint8), cv2.IMREAD_UNCHANGED) if by[name] else None
    if pixels is None or pixels.shape[:2] != size:
        raise InputError(f"{key}.{name}: cannot be decoded, or has not the size of the image; {size} is wanted")
    return pixels


def _amodal(document: dict[str, Any], size: tuple[int, int]) -> UInt64[np.ndarray, "h w"] | None:
    masks = [part.get("amodal") for part in document["parts"]]
    if masks and masks[0] is None:
        return None
    return bits_of_texts([mask["counts"] for mask in masks], size)


def _numbers(document: dict[str, Any]) -> tuple[Any, ...]:
    """Everything that is not an image, in the order of `Checked`; NaN for null."""
    hands, instances, parts = document["hands"], document["instances"], document["parts"]
    by = [[-1 if k is None else k for k in hand["hidden_by"]] for hand in hands]
    per = len(KEYPOINTS)
    return (
        np.array([part["instance"] for part in parts], np.int64),
        *(
            np.array([part[name] for part in parts], float)
            for name in ("visible_area", "amodal_area", "visible_fraction")
        ),
        np.array([hand["keypoints"] for hand in hands], float).reshape(-1, per, 2),
        np.array([hand["visibility"] for hand in hands], np.int64).reshape(-1, per),
        np.array(by, np.int64).reshape(-1, per),
        *(np.array([i[name] for i in instances], float).reshape(-1, 4) for name in ("modal_box", "amodal_box")),
    )
