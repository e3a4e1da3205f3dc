"""Files of one image in, its labels as arrays out: the inverse of `encode`, up to the steps that 8 and 16 bits have."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8, UInt64

from handtrack.camera import Camera, orthographic, perspective
from handtrack.errors import InputError

from ..labels.solids import KEYPOINTS, Parts
from .encode import FLOW_STEPS, FLOW_ZERO, FORMAT
from .masks import bits_of_masks


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """What files say of an image; fields are those of `Labelled`, None where they were not written.

    Joints come in the order of their names.

    Attributes
    ----------
    key : str
    depth_unit : float
        Millimetres; depths are multiples of it.
    seed : int or None
        That the dataset was drawn from.
    """

    key: str
    image: UInt8[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"] | None
    normal: Float[np.ndarray, "h w 3"] | None
    part: Int[np.ndarray, "h w"] | None
    amodal: UInt64[np.ndarray, "h w"] | None
    flow: Float[np.ndarray, "h w 2"] | None
    keypoint: Float[np.ndarray, "n 21 2"]
    keypoint_cam: Float[np.ndarray, "n 21 3"]
    visibility: Int[np.ndarray, "n 21"]
    hidden_by: Int[np.ndarray, "n 21"]
    parts: Parts
    visible_area: Float[np.ndarray, " p"]
    amodal_area: Float[np.ndarray, " p"]
    fraction: Float[np.ndarray, " p"]
    modal_box: Float[np.ndarray, "i 4"]
    amodal_box: Float[np.ndarray, "i 4"]
    joint_names: tuple[tuple[str, ...], ...]
    angles: tuple[Float[np.ndarray, " j"], ...]
    camera: Camera | None
    index: int
    sequence: int
    frame: int
    depth_unit: float
    seed: int | None


def decoded(key: str, files: Sequence[tuple[str, bytes]]) -> Decoded:
    """Labels of one image.

    Parameters
    ----------
    files : sequence of (str, bytes)
        Extensions and contents, as `encoded` and `shards.members_of` give them.

    Raises
    ------
    InputError
        If image or JSON file are missing, a file is not what its extension says, or sizes differ.
    """
    by = dict(files)
    name = next((name for name in ("image.png", "image.jpg") if name in by), None)
    if name is None or "json" not in by:
        raise InputError(f"{key}: has the files {', '.join(sorted(by)) or 'none'}; an image and json are wanted")
    document = read_document(key, by["json"])
    try:
        size = (int(document["camera"]["height"]), int(document["camera"]["width"]))
        pictures = _pictures(key, by, name, size, float(document["depth_unit_mm"]))
        return Decoded(key, *pictures[:4], _amodal(document, size), pictures[4], *_rest(document))
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        wrong = f"no {error}" if isinstance(error, KeyError) else " ".join(str(error).split())
        raise InputError(f"{key}.json: {wrong}; labels of one image are wanted") from error


def read_document(key: str, content: bytes) -> dict[str, Any]:
    """The JSON file of one image, its format checked.

    Raises
    ------
    InputError
        If it is none.
    """
    try:
        document = json.loads(content)
    except ValueError as error:
        raise InputError(f"{key}.json: {error}; JSON is wanted") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(f"{key}.json: is not of format {FORMAT}")
    return document


def camera_of(entry: dict[str, Any]) -> Camera:
    """The camera that a JSON file describes."""
    R, t = np.array(entry["R"], float), np.array(entry["t"], float)
    size = int(entry["width"]), int(entry["height"])
    centre = float(entry["cx"]), float(entry["cy"])
    if entry["type"] == "orthographic":
        return orthographic(*size, float(entry["scale"]), *centre, R, t)
    bend = np.array(entry["distortion"], float) if "distortion" in entry else None
    return perspective(*size, float(entry["fx"]), float(entry["fy"]), *centre, R, t, bend)


def image_of(key: str, name: str, content: bytes, size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    """Red, green and blue of a colour image.

    Raises
    ------
    InputError
        If it is none, or not of that size.
    """
    return np.ascontiguousarray(_picture(key, name, content, (*size, 3), np.uint8)[..., ::-1])


def _pictures(key: str, by: dict[str, bytes], name: str, size: tuple[int, int], unit: float):
    """Image, depth, normals, parts, flow."""
    image = image_of(key, name, by[name], size)
    depth = normal = part = flow = None
    if "depth.png" in by:
        steps = _picture(key, "depth.png", by["depth.png"], size, np.uint16)
        depth = np.where(steps == 0, np.float32(np.inf), steps.astype(np.float32) * np.float32(unit))
    if "normal.png" in by:
        steps = _picture(key, "normal.png", by["normal.png"], (*size, 3), np.uint8)[..., ::-1]
        normal = (steps / np.float32(127.5) - np.float32(1.0)) * steps.any(axis=-1, keepdims=True)
        normal = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 0.5)
    if "part.png" in by:
        part = _picture(key, "part.png", by["part.png"], size, np.uint8).astype(np.int16) - 1
    if "flow.png" in by:
        flow = _flow(_picture(key, "flow.png", by["flow.png"], (*size, 3), np.uint16), part)
    return image, depth, normal, part, flow


def _flow(steps: np.ndarray, part: np.ndarray | None) -> Float[np.ndarray, "h w 2"]:
    """Pixels x, y; 0 where no part is, NaN where a part has no flow (or, without parts, wherever there is none)."""
    flow = (steps[..., :0:-1].astype(np.float32) - FLOW_ZERO) / np.float32(FLOW_STEPS)
    unseen = steps[..., 0] == 0
    flow[unseen] = np.nan
    if part is not None:
        flow[unseen & (part < 0)] = 0.0
    return flow


def _picture(key: str, name: str, content: bytes, shape: tuple[int, ...], kind: type) -> np.ndarray:
    pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    if pixels is None:
        raise InputError(f"{key}.{name}: cannot be decoded; a whole picture is wanted")
    if pixels.shape != shape or pixels.dtype != kind:
        raise InputError(
            f"{key}.{name}: has shape {pixels.shape} of {pixels.dtype}; {shape} of {np.dtype(kind)} are wanted"
        )
    return pixels


def _amodal(document: dict[str, Any], size: tuple[int, int]) -> UInt64[np.ndarray, "h w"] | None:
    masks = [part.get("amodal") for part in document["parts"]]
    if masks and masks[0] is None:
        return None
    return bits_of_masks([mask["counts"] for mask in masks], size)


def _rest(document: dict[str, Any]) -> tuple[Any, ...]:
    """Everything that is not an image, in the order of `Decoded`."""
    hands, instances, parts = document["hands"], document["instances"], document["parts"]
    by = [[-1 if k is None else k for k in hand["hidden_by"]] for hand in hands]
    return (
        _points([hand["keypoints"] for hand in hands], 2),
        _points([hand["keypoints_mm"] for hand in hands], 3),
        np.array([hand["visibility"] for hand in hands], np.int64).reshape(-1, len(KEYPOINTS)),
        np.array(by, np.int64).reshape(-1, len(KEYPOINTS)),
        Parts(
            tuple(part["name"] for part in parts),
            np.array([part["instance"] for part in parts], np.int64),
            tuple(instance["kind"] for instance in instances),
        ),
        *(_numbers([part[name] for part in parts]) for name in ("visible_area", "amodal_area", "visible_fraction")),
        *(np.array([i[name] for i in instances], float).reshape(-1, 4) for name in ("modal_box", "amodal_box")),
        tuple(tuple(hand["angles_deg"]) for hand in hands),
        tuple(np.radians(_numbers(list(hand["angles_deg"].values()))) for hand in hands),
        camera_of(document["camera"]),
        document["index"],
        document["sequence"],
        document["frame"],
        document["depth_unit_mm"],
        document.get("seed"),
    )


def _points(hands: list[list[list[float | None]]], length: int) -> Float[np.ndarray, "n 21 d"]:
    """Keypoints, NaN for null."""
    return np.array(hands, float).reshape(-1, len(KEYPOINTS), length)


def _numbers(values: list[float | None]) -> Float[np.ndarray, " n"]:
    """Numbers, NaN for null."""
    return np.array(values, float)
