"""YAML files: which scalars are numbers, and what is refused with file and line."""

from pathlib import Path
from typing import Annotated, Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from handtrack.errors import InputError
from handtrack.formats.yaml_files import MAX_BYTES, MAX_DEPTH, Strict, line_of, parse_yaml, read_yaml, validate

HERE = Path("clip/model.yaml")


def data(text: str) -> Any:
    return parse_yaml(text.encode(), HERE).data


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("25e0", 25.0),
        ("-1.5E+2", -150.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("+7", 7),
        ("010", 10),
        ("true", True),
        ("False", False),
        ("~", None),
        ("yes", "yes"),
        ("no", "no"),
        ("1:30", "1:30"),
        ("1_000", "1_000"),
        ("0x1F", "0x1F"),
        ("2020-01-01", "2020-01-01"),
        ("'1e-3'", "1e-3"),
        ("Ünï ✋ %20", "Ünï ✋ %20"),
    ],
)
def test_scalars_are_those_of_the_core_schema(text, value):
    result = data(f"a: {text}")["a"]
    assert result == value
    assert type(result) is type(value)


def test_json_is_read_as_yaml():
    assert data('{"a": [1, 2.5, null, {"b": "c"}]}') == {"a": [1, 2.5, None, {"b": "c"}]}


def test_an_anchor_may_be_used_a_hundred_times_but_not_more():
    few = data("a: &x {n: 1}\nb: [" + ", ".join(["*x"] * 100) + "]")
    assert few["b"] == [{"n": 1}] * 100
    with pytest.raises(InputError, match="line 2: aliases expand to more than 100 copies"):
        data("a: &x {n: 1}\nb: [" + ", ".join(["*x"] * 101) + "]")


def test_nested_aliases_count_as_often_as_they_are_copied():
    lines = ["a0: &a0 [x, x]"] + [f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 12)]
    assert sum(line.count("*") for line in lines) < 100
    with pytest.raises(InputError, match="aliases expand to more than 100 copies"):
        data("\n".join(lines))


def test_depth_up_to_the_limit_is_read():
    inner = MAX_DEPTH - 2  # the outer mapping and the innermost number are levels too
    data("a: " + "[" * inner + "1" + "]" * inner)
    with pytest.raises(InputError, match=f"nested deeper than {MAX_DEPTH} levels"):
        data("a: " + "[" * (inner + 1) + "1" + "]" * (inner + 1))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3", "line 3: key 'a' is given twice"),
        ("a: .nan", "line 1: '.nan' is not a finite number"),
        ("a:\n- 1e999", "line 2: '1e999' is not a finite number"),
        ("a: 99999999999999999999", "is not a finite number of ordinary size"),
        ("? [1]\n: 2", "a key must be a word"),
        ("a: !!python/object:os.system x", "tag 'tag:yaml.org,2002:python/object:os.system' is not read"),
        ("a: !x [1]", "tag '!x' is not read"),
        ("a: !x {b: 1}", "tag '!x' is not read"),
        ("a: !!int word", "'word' is not a finite number"),
        ("a: !!float 1_0", "'1_0' is not a finite number"),
        ("a: !!bool maybe", "is not read"),
        ("a: &x [*x]", "alias 'x' refers to itself"),
        ("a: *x", "found undefined alias"),
        ("a: [1, 2", "line 1: .*valid YAML is wanted"),
        ("a: 'text", "valid YAML is wanted"),
        ("a: 1\n--- \nb: 2", "valid YAML is wanted"),
        ("a: \x07", "special characters are not allowed"),
        ("", "is empty"),
        ("# only a remark", "is empty"),
    ],
)
def test_refused_texts_name_file_line_and_reason(text, message):
    with pytest.raises(InputError, match=message) as caught:
        data(text)
    assert str(caught.value).startswith("clip/model.yaml: ")
    assert "\n" not in str(caught.value)


def test_bytes_that_are_not_utf8_are_refused():
    with pytest.raises(InputError, match="byte 3 is not UTF-8"):
        parse_yaml(b"a: \xff", HERE)


def test_large_files_are_refused_before_parsing(tmp_path):
    big = tmp_path / "big.yaml"
    big.write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(InputError, match="larger than 1000000 bytes"):
        read_yaml(big)
    with pytest.raises(InputError, match="at most 1000000"):
        parse_yaml(big.read_bytes(), big)


def test_missing_files_and_folders_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"nowhere.yaml: no such file"):
        read_yaml(tmp_path / "nowhere.yaml")
    with pytest.raises(InputError, match="is not a file"):
        read_yaml(tmp_path)
    with pytest.raises(InputError, match=r"cannot be read|no such file"):
        read_yaml(tmp_path / "a\0b")


class Inner(Strict):
    x: float
    n: int = 0


class Outer(Strict):
    items: Annotated[list[Inner], Field(min_length=1)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("items:\n- {x: 1}\n- {x: one}", r"line 3: items\[1\].x: 'one' given; wanted: a number$"),
        ("items:\n- {x: 1}\n- {n: 1}", r"line 3: items\[1\]: 'x' is missing$"),
        ("items:\n- {x: 1, y: 2}", r"line 2: items\[0\]: unknown key 'y'; known are x, n$"),
        ("items:\n- {x: 1, n: 1.5}", r"items\[0\].n: 1.5 given; wanted: a integer|items\[0\].n: 1.5 given; wanted: "),
        ("items:\n- {x: true}", "True given; wanted: a number"),
        ("items: []", "wanted: .* at least 1 item"),
        ("items: {a: 1}", "wanted: a list"),
        ("items:\n- {x: a}\n- {x: b}\n- {x: c}", r"\(and 2 more\)$"),
        ("[1]", "keys with values are wanted"),
    ],
)
def test_what_does_not_fit_the_schema_is_one_line_with_its_place(text, message):
    with pytest.raises(InputError, match=message) as caught:
        validate(parse_yaml(text.encode(), HERE), Outer)
    assert "\n" not in str(caught.value)


def test_lines_are_those_of_the_deepest_part_that_exists():
    document = parse_yaml(b"a:\n  b:\n  - 1\n  - 2\n", HERE)
    assert [line_of(document, place) for place in ((), ("a",), ("a", "b"), ("a", "b", 1), ("a", "b", 9), ("z",))] == [
        1,
        1,
        2,
        4,
        2,
        1,
    ]


@given(st.text(alphabet="ab:-[]{}*&!,'\"\n 1.e#|>%@?~\t\\", max_size=60))
@settings(max_examples=80, deadline=None)
def test_any_text_is_data_or_one_clear_line(text):
    message = ""
    try:
        data(text)
    except InputError as error:
        message = str(error)
    assert "\n" not in message


scalars = (
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(-1e9, 1e9) | st.text("abc é✋", max_size=5)
)
trees = st.recursive(
    scalars, lambda t: st.lists(t, max_size=4) | st.dictionaries(st.text("abc", min_size=1), t, max_size=4)
)


@given(st.dictionaries(st.text("abc", min_size=1), trees, max_size=4))
@settings(max_examples=50, deadline=None)
def test_what_pyyaml_writes_is_read_back(tree):
    assert data(yaml.safe_dump(tree, allow_unicode=True)) == tree
