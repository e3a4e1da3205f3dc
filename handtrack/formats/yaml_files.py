"""A YAML file in, checked plain data with the line of every place out.

Text that comes from elsewhere is read with limits (1 MB, depth 50, 100 alias expansions), and with the scalars of
YAML 1.2's core schema: `1e-3` and `25e0` are numbers, `yes`, `1:30` and `2020-01-01` are text. Keys given twice,
numbers that are not finite and tags other than the plain ones are errors. Every error is one line: file, line, place,
what was wanted.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError
from yaml.composer import Composer
from yaml.parser import Parser
from yaml.reader import Reader
from yaml.resolver import BaseResolver
from yaml.scanner import Scanner

from ..errors import InputError
from .paths import read_bytes

MAX_BYTES, MAX_DEPTH, MAX_EXPANSIONS = 1_000_000, 50, 100
MAX_INT = 2**63

_NULL, _BOOL, _INT, _FLOAT, _STR = (f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str"))


class Strict(BaseModel):
    """Base of every file's schema: exact types, finite numbers, and no key that the format does not know."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, dict):
            known = [field.alias or name for name, field in cls.model_fields.items()]
            for key in data:
                if key not in known:
                    wanted = ", ".join(known)
                    raise PydanticCustomError(
                        "unknown_key", "unknown key {key}; known are {wanted}", {"key": repr(key), "wanted": wanted}
                    )
        return data


SchemaT = TypeVar("SchemaT", bound=BaseModel)
Place = tuple[str | int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Document:
    """Content of a YAML file, with the parsed nodes that know their lines."""

    path: Path
    data: Any
    root: yaml.Node


class _Loader(Reader, Scanner, Parser, Composer, BaseResolver):
    """PyYAML's parser with the limits; it only composes nodes and never constructs objects."""

    def __init__(self, text: str) -> None:
        Reader.__init__(self, text)
        Scanner.__init__(self)
        Parser.__init__(self)
        Composer.__init__(self)
        BaseResolver.__init__(self)
        self.depth = 0
        self.expansions = 0
        self.inside: dict[str, int | None] = {}  # expansions within each anchor; None while it is being read

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            within = self.inside.get(event.anchor, 0)
            if within is None:
                raise yaml.MarkedYAMLError(
                    problem=f"alias '{event.anchor}' refers to itself", problem_mark=event.start_mark
                )
            self.expansions += 1 + within
            if self.expansions > MAX_EXPANSIONS:
                raise yaml.MarkedYAMLError(
                    problem=f"aliases expand to more than {MAX_EXPANSIONS} copies", problem_mark=event.start_mark
                )
            return super().compose_node(parent, index)
        anchor, before = event.anchor, self.expansions
        if anchor is not None and anchor not in self.inside:  # a second use is refused by the composer
            self.inside[anchor] = None
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise yaml.MarkedYAMLError(problem=f"nested deeper than {MAX_DEPTH} levels", problem_mark=event.start_mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        if anchor is not None:
            self.inside[anchor] = self.expansions - before
        return node


for _tag, _pattern, _first in (
    (_NULL, r"(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    (_BOOL, r"(?:true|True|TRUE|false|False|FALSE)$", list("tTfF")),
    (_INT, r"[-+]?[0-9]+$", list("-+0123456789")),
    (_FLOAT, r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$", list("-+0123456789.")),
    (_FLOAT, r"(?:[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$", list("-+.")),
):
    _Loader.add_implicit_resolver(_tag, re.compile(_pattern), _first)


def read_yaml(path: Path) -> Document:
    """Read and parse a YAML file.

    Raises
    ------
    InputError
        For a file that is missing, too large, not UTF-8 or not YAML, and for what the module's text refuses.
    """
    return parse_yaml(read_bytes(path, MAX_BYTES), path)


def parse_yaml(content: bytes, path: Path) -> Document:
    """The same from bytes; `path` is only named in errors.

    >>> parse_yaml(b"{a: 1e-3, b: yes}", Path("x.yaml")).data
    {'a': 0.001, 'b': 'yes'}
    """
    if len(content) > MAX_BYTES:
        raise InputError(f"{path}: {len(content)} bytes; at most {MAX_BYTES} are read from a YAML file")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8 text") from error
    try:
        root = _Loader(text).get_single_node()
    except yaml.MarkedYAMLError as error:
        line = f" line {error.problem_mark.line + 1}:" if error.problem_mark is not None else ""
        raise InputError(f"{path}:{line} {error.problem or error.context}; valid YAML is wanted") from error
    except yaml.YAMLError as error:
        raise InputError(f"{path}: {' '.join(str(error).split())}; valid YAML is wanted") from error
    if root is None:
        raise InputError(f"{path}: is empty; YAML with keys is wanted")
    return Document(path, _value(root, path), root)


def _value(node: yaml.Node, path: Path) -> Any:
    """Plain Python data of a node; keys are text and unique, numbers finite."""
    where = f"{path}: line {node.start_mark.line + 1}:"
    if isinstance(node, yaml.MappingNode):
        if node.tag != BaseResolver.DEFAULT_MAPPING_TAG:
            raise InputError(f"{where} tag {node.tag!r} is not read; plain YAML is wanted")
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = f"{path}: line {key_node.start_mark.line + 1}:"
            if not isinstance(key_node, yaml.ScalarNode):
                raise InputError(f"{line} a key must be a word, not a list or mapping")
            if key_node.value in data:
                raise InputError(f"{line} key {key_node.value!r} is given twice; keys are unique")
            data[key_node.value] = _value(value_node, path)
        return data
    if isinstance(node, yaml.SequenceNode):
        if node.tag != BaseResolver.DEFAULT_SEQUENCE_TAG:
            raise InputError(f"{where} tag {node.tag!r} is not read; plain YAML is wanted")
        return [_value(item, path) for item in node.value]
    return _scalar(node, where)


def _scalar(node: yaml.Node, where: str) -> str | int | float | bool | None:
    text, tag = node.value, node.tag
    if tag == _STR:
        return text
    if tag == _NULL:
        return None
    if tag == _BOOL and text.lower() in ("true", "false"):
        return text.lower() == "true"
    if tag == _INT and re.fullmatch(r"[-+]?[0-9]{1,19}", text) and abs(int(text)) < MAX_INT:
        return int(text)
    if tag in (_INT, _FLOAT):
        try:
            number = float(text.replace(".inf", "inf").replace(".nan", "nan")) if "_" not in text else math.nan
        except ValueError:
            number = math.nan
        if tag == _INT or not math.isfinite(number):
            raise InputError(f"{where} {shorten(text)} is not a finite number of ordinary size")
        return number
    raise InputError(f"{where} tag {tag!r} is not read; plain YAML is wanted")


def shorten(value: object, length: int = 60) -> str:
    """A value on one line, cut to a readable length."""
    text = repr(value)
    return text if len(text) <= length else text[: length - 3] + "..."


def line_of(document: Document, place: Sequence[str | int]) -> int:
    """Line, from 1, on which a place in the document begins: that of the deepest part that exists."""
    node, line = document.root, document.root.start_mark.line
    for step in place:
        found = None
        if isinstance(node, yaml.MappingNode):
            found = next(((k, v) for k, v in node.value if k.value == step), None)
        elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
            found = (node.value[step], node.value[step])
        if found is None:
            break
        line, node = found[0].start_mark.line, found[1]
    return line + 1


def at(document: Document, place: Sequence[str | int] = ()) -> str:
    """`file: line n: frames[2].link` to begin an error message with."""
    text = ""
    for step in place:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return f"{document.path}: line {line_of(document, place)}:" + (f" {text}:" if text else "")


def validate(document: Document, schema: type[SchemaT]) -> SchemaT:
    """The document as an instance of its schema.

    Raises
    ------
    InputError
        Naming the first place that does not fit, and how many more there are.
    """
    if not isinstance(document.data, dict):
        raise InputError(f"{at(document)} keys with values are wanted, not {shorten(document.data)}")
    try:
        return schema.model_validate(document.data)
    except ValidationError as error:
        details = error.errors(include_url=False)
        more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
        raise InputError(_say(document, details[0]) + more) from error


def _has(data: Any, step: str | int) -> bool:
    if isinstance(data, list):
        return isinstance(step, int) and step < len(data)
    return isinstance(data, dict) and step in data


def _say(document: Document, detail: ErrorDetails) -> str:
    """One pydantic error as one line."""
    place: list[str | int] = []
    data = document.data
    for i, step in enumerate(detail["loc"]):
        if _has(data, step):
            place.append(step)
            data = data[step]
        elif detail["type"] == "missing" and i == len(detail["loc"]) - 1:
            return f"{at(document, place)} '{step}' is missing"
        # any other step is pydantic's own name for one form of a value
    message = detail["msg"]
    if detail["type"] == "unknown_key":
        return f"{at(document, place)} {message}"
    if detail["type"].startswith("union_tag"):
        wanted = detail.get("ctx", {}).get("expected_tags", "keys")
        return f"{at(document, place)} its 'type' must be one of {wanted}"
    message = message.replace("Input should be ", "").replace("List should have", "a list with")
    message = message.replace("a valid dictionary or instance of", "keys of").replace("valid ", "")
    return f"{at(document, place)} {shorten(detail['input'])} given; wanted: {message}"
