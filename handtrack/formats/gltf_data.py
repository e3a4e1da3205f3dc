"""A glTF 2.0 file in, its description and arrays out: the container, the buffers, and strictly checked accessors.

Both forms are read, binary (`.glb`) and text with buffers beside it (`.gltf`). The packages that read glTF either leave
out skins (trimesh) or leave the decoding of accessors to their user and bring a JSON schema library along (pygltflib);
what is needed here is small, so it is written out, and everything that a file claims is checked before it is used.
"""

import base64
import binascii
import json
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote

import numpy as np
from jaxtyping import Shaped

from ..errors import InputError
from .paths import inside, read_bytes

MAX_BYTES = 64_000_000
_MAX_ITEMS = 4_000_000
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


@dataclass(frozen=True, slots=True, eq=False)
class Gltf:
    """A parsed file: where it came from, its JSON object, and its buffers."""

    path: Path
    content: Any
    buffers: tuple[bytes, ...]

    def fail(self, place: str, problem: str) -> NoReturn:
        """Refuse the file: one line with the place and what was wanted."""
        raise InputError(f"{self.path}: {place}: {problem}")


def read_gltf(path: Path) -> Gltf:
    """Read the container and its buffers.

    Raises
    ------
    InputError
        If the file is larger than 64 MB, is no glTF 2.0, is cut short, or names buffers outside its folder.
    """
    data = read_bytes(path, MAX_BYTES)
    text, binary = _chunks(path, data) if data[:4] == b"glTF" else (data, None)
    bare = Gltf(path, _parsed(path, text), ())
    version = item(bare, "asset", "version", wanted=str)
    if not version.startswith("2."):
        bare.fail("asset.version", f"{version[:20]!r}; glTF 2.0 is wanted")
    return Gltf(path, bare.content, _buffers(bare, binary))


def _chunks(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
    """JSON text and binary chunk of a `.glb`."""
    if len(data) < 20:
        raise InputError(f"{path}: is cut short after {len(data)} bytes; a glTF header is wanted")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise InputError(f"{path}: header: container version {version}; 2 is wanted")
    if length != len(data):
        raise InputError(f"{path}: header: says {length} bytes, the file has {len(data)}; a whole file is wanted")
    found, at = [], 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise InputError(f"{path}: byte {at}: a chunk of {size} bytes leaves the file")
        found.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    if not found or found[0][0] != _JSON_CHUNK:
        raise InputError(f"{path}: byte 12: the first chunk is no JSON; a description of the scene is wanted first")
    binary = found[1][1] if len(found) > 1 and found[1][0] == _BINARY_CHUNK else None
    return found[0][1], binary


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"the number {text} is not finite")


def _parsed(path: Path, text: bytes) -> dict[str, Any]:
    try:
        content = json.loads(text.decode("utf-8"), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        reason = "is nested too deeply" if isinstance(error, RecursionError) else " ".join(str(error).split())[:200]
        raise InputError(f"{path}: is no glTF: {reason}; a binary glTF, or its JSON text, is wanted") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: is no glTF: its JSON is no object")
    return content


def _buffers(gltf: Gltf, binary: bytes | None) -> tuple[bytes, ...]:
    loaded, total = [], 0
    for number in range(len(item(gltf, "buffers", wanted=list, default=[]))):
        place = f"buffers[{number}]"
        size = item(gltf, "buffers", number, "byteLength", wanted=int)
        uri = item(gltf, "buffers", number, "uri", wanted=str, default="")
        if not uri:
            if number or binary is None:
                gltf.fail(place, "has no uri and no binary chunk; data in the file or beside it is wanted")
            data = binary
        elif uri.startswith("data:"):
            data = _embedded(gltf, place, uri)
        else:
            beside, notes = inside(gltf.path.parent, unquote(uri), f"{gltf.path}: {place}.uri:")
            if notes:
                gltf.fail(f"{place}.uri", "a symbolic link leads out of the folder; data inside it is wanted")
            data = read_bytes(beside, MAX_BYTES)
        if not 0 < size <= len(data):
            gltf.fail(f"{place}.byteLength", f"{size} given, there are {len(data)} bytes")
        loaded.append(data[:size])
        total += size
        if total > MAX_BYTES:
            gltf.fail(place, f"all buffers together have more than {MAX_BYTES} bytes, the most that is read here")
    return tuple(loaded)


def _embedded(gltf: Gltf, place: str, uri: str) -> bytes:
    head, _, body = uri.partition(",")
    if not head.endswith(";base64"):
        gltf.fail(f"{place}.uri", "embedded data in another coding; base64 is wanted")
    try:
        return base64.b64decode(body, validate=True)
    except (binascii.Error, ValueError) as error:
        raise InputError(f"{gltf.path}: {place}.uri: no base64 data ({error})") from error


def item(gltf: Gltf, *keys: str | int, wanted: type, default: Any = None) -> Any:
    """The value under nested keys, of the wanted type; the default where the last key is missing, if there is one."""
    value: Any = gltf.content
    names: tuple[Any, ...] = keys
    for depth, key in enumerate(names):
        last = depth == len(keys) - 1
        missing = not isinstance(value, dict) or key not in value
        if isinstance(key, int):
            missing = not isinstance(value, list) or not 0 <= key < len(value)
        if missing:
            if last and default is not None:
                return default
            gltf.fail(_named(keys[: depth + 1]), "is missing")
        value = value[key]
    right = isinstance(value, int | float) if wanted is float else isinstance(value, wanted)
    if not right or (isinstance(value, bool) and wanted is not bool):
        gltf.fail(_named(keys), f"{str(value)[:40]!r} given; {_KINDS[wanted]} is wanted")
    return value


_KINDS: dict[type, str] = {int: "a whole number", float: "a number", str: "text", list: "a list", dict: "an object"}


def _named(keys: Sequence[str | int]) -> str:
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).lstrip(".")


def numbers(gltf: Gltf, count: int, *keys: str | int, default: Sequence[float]) -> Shaped[np.ndarray, " n"]:
    """A list of `count` finite numbers."""
    values = item(gltf, *keys, wanted=list, default=list(default))
    right = len(values) == count and all(isinstance(x, int | float) and not isinstance(x, bool) for x in values)
    try:
        found = np.array(values, dtype=float) if right else np.full(1, np.nan)
    except OverflowError:
        found = np.full(1, np.nan)
    if not np.isfinite(found).all():
        gltf.fail(_named(keys), f"{count} finite numbers are wanted")
    return found


def accessor(
    gltf: Gltf, number: int, kind: str, allowed: Callable[[str, bool], bool], place: str
) -> Shaped[np.ndarray, "n k"]:
    """The values of an accessor; whole numbers are divided by their largest value where they are `normalized`.

    Parameters
    ----------
    kind : str
        SCALAR, VEC2, VEC3, VEC4 or MAT4.
    allowed : callable
        Whether a component type (`<f4`, `<u1`, ...) is allowed, given also if it is normalized.
    place : str
        What asks for it, for messages.

    Raises
    ------
    InputError
        If anything is missing, of another type, outside its buffer, or not finite.
    """
    at = ("accessors", number)
    dtype = np.dtype(_COMPONENTS.get(item(gltf, *at, "componentType", wanted=int), "V1"))
    given = item(gltf, *at, "type", wanted=str)
    normalized = item(gltf, *at, "normalized", wanted=bool, default=False)
    if given != kind or dtype.kind == "V" or not allowed(dtype.str.replace("|", "<"), normalized):
        gltf.fail(f"accessors[{number}]", f"{given[:20]} of component type {dtype.str} does not fit {place}")
    if item(gltf, *at, "sparse", wanted=dict, default={}):
        gltf.fail(f"accessors[{number}]", "is sparse; plain data is wanted")
    count = item(gltf, *at, "count", wanted=int)
    if not 0 < count <= _MAX_ITEMS:
        gltf.fail(f"accessors[{number}].count", f"{count} given; 1 to {_MAX_ITEMS} is wanted")
    values = _viewed(gltf, number, dtype, _WIDTHS[kind], count)
    if dtype.kind == "f" and not np.isfinite(values).all():
        gltf.fail(f"accessors[{number}]", f"{place} holds a number that is not finite")
    return values / float(np.iinfo(dtype).max) if normalized and dtype.kind in "iu" else values


def _viewed(gltf: Gltf, number: int, dtype: np.dtype, width: int, count: int) -> Shaped[np.ndarray, "n k"]:
    """Items of an accessor in its view, which may interleave them with others."""
    at = ("accessors", number)
    view = ("bufferViews", item(gltf, *at, "bufferView", wanted=int))
    offset = item(gltf, *at, "byteOffset", wanted=int, default=0)
    start = item(gltf, *view, "byteOffset", wanted=int, default=0)
    length = item(gltf, *view, "byteLength", wanted=int)
    size = width * dtype.itemsize
    stride = item(gltf, *view, "byteStride", wanted=int, default=size)
    buffer = item(gltf, *view, "buffer", wanted=int)
    if not 0 <= buffer < len(gltf.buffers):
        gltf.fail(f"{_named(view)}.buffer", f"{buffer} given; there are {len(gltf.buffers)} buffers")
    data = gltf.buffers[buffer]
    if start < 0 or length <= 0 or start + length > len(data):
        gltf.fail(_named(view), f"bytes {start} to {start + length} leave its buffer of {len(data)} bytes")
    if stride < size or stride > 252 + size or offset < 0 or offset + (count - 1) * stride + size > length:
        gltf.fail(f"accessors[{number}]", f"{count} items of {size} bytes leave its view of {length} bytes")
    raw = np.ndarray((count, width), dtype, data, start + offset, (stride, dtype.itemsize))
    return raw.copy()
