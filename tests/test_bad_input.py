"""Every rule for readers: bad input is one line that names the file and what was wanted; nothing else comes out."""

import csv
import io
import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from PIL import Image

from handtrack.errors import InputError
from handtrack.formats import read_camera, read_model, read_truth
from handtrack.formats.models import model_from_document
from handtrack.formats.yaml_files import parse_yaml
from handtrack.kinematics.builtin import model
from handtrack.sequences import open_sequence

IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


def model_data() -> dict[str, Any]:
    return {
        "format": "handtrack/model-1",
        "name": "test",
        "units": "mm",
        "frames": [
            {"id": 1, "parent": 0, "alpha": 180, "a": -11, "d": 0, "theta": -90},
            {
                "id": 2,
                "parent": 1,
                "alpha": -90,
                "a": 0,
                "d": 0,
                "theta": {"joint": "mcp", "limits": [-45, 90]},
                "link": {"length": 46, "radius": 9.5},
            },
            {
                "id": 3,
                "parent": 2,
                "alpha": 0,
                "a": 46,
                "d": 0,
                "theta": {"joint": "pip"},
                "link": {"length": 27, "radius": [9, 8]},
            },
            {"id": 4, "parent": 3, "alpha": 0, "a": 27, "d": 0, "theta": {"joint": "dip"}},
            {"id": 5, "parent": 0, "transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},
        ],
        "couplings": [{"joint": "dip", "of": "pip", "ratio": 0.67}],
    }


def sequence_data() -> dict[str, Any]:
    return {
        "format": "handtrack/sequence-1",
        "fps": 25,
        "frames": "frames/*.png",
        "camera": {
            "type": "perspective",
            "width": 16,
            "height": 12,
            "fx": 20,
            "fy": 20,
            "cx": 8,
            "cy": 6,
            "R": [list(row) for row in IDENTITY],
            "t": [0, 0, 300],
            "distortion": [0, 0, 0, 0, 0],
        },
        "model": "model.yaml",
        "start": {"mcp": 10, "pip": 20},
        "truth": "truth.csv",
    }


def put(data: dict[str, Any], place: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    inner: Any = data
    for step in place[:-1]:
        inner = inner[step]
    if value is ...:
        del inner[place[-1]]
    else:
        inner[place[-1]] = value
    return data


def put_sequence(folder: Path, data: dict[str, Any] | None = None) -> Path:
    (folder / "frames").mkdir(parents=True)
    for i in range(3):
        Image.fromarray(np.full((12, 16), 50 * i, np.uint8)).save(folder / f"frames/{i}.png")
    (folder / "model.yaml").write_text(json.dumps(model_data()))
    (folder / "truth.csv").write_text("frame,mcp,pip,dip\n0,1,2,3\n1,2,3,4\n2,3,4,5\n")
    (folder / "sequence.yaml").write_text(json.dumps(sequence_data() if data is None else data, indent=1))
    return folder


def assert_one_line(error: InputError, name: str) -> None:
    text = str(error)
    assert "\n" not in text
    assert name in text


def test_the_good_files_that_the_bad_ones_are_made_from_are_good(tmp_path):
    sequence = open_sequence(put_sequence(tmp_path / "a"))
    assert sequence.warnings == ()
    assert len(list(sequence.frames)) == 3


MODEL_CASES: list[tuple[tuple[str | int, ...], Any, str]] = [
    (("frames", 1, "id"), 1, "line .*frames.*id: 1 is given twice; ids are unique"),
    (("frames", 1, "parent"), 9, "frame 9 does not exist; the id of a frame, or 0, is wanted"),
    (("frames", 0, "parent"), 3, r"parents go in a cycle \(1 > 3 > 2 > 1\)"),
    (("frames", 0, "parent"), 1, "parents go in a cycle"),
    (("frames", 0, "id"), 0, "greater than 0"),
    (("frames", 0, "parent"), -1, "greater than or equal to 0"),
    (("frames",), [], "at least 1 item"),
    (("frames",), ..., "'frames' is missing"),
    (("frames", 1, "theta", "joint"), "2nd", "is no joint name; letters, digits and _"),
    (("frames", 1, "theta", "joint"), "a b", "is no joint name"),
    (("frames", 1, "theta", "joint"), "é", "is no joint name"),
    (("frames", 1, "theta", "joint"), "mcp\n", "is no joint name"),
    (("frames", 1, "theta", "joint"), "time", "name of another column"),
    (("frames", 1, "theta", "joint"), "a_sigma", "name of another column"),
    (("frames", 1, "theta", "joint"), "pip", "'pip' is named twice"),
    (("frames", 1, "theta", "joint"), 3, "a string"),
    (("frames", 1, "theta", "limits"), [90, -45], r"limits: \[90, -45\]: low < high is wanted"),
    (("frames", 1, "theta", "limits"), [5, 5], "low < high is wanted"),
    (("frames", 1, "theta", "limits"), [5], "at least 2 items"),
    (("frames", 1, "theta", "range"), [5, 6], "unknown key 'range'; known are joint, offset, limits"),
    (("frames", 1, "d"), {"joint": "slide"}, "both d and theta are joints"),
    (("frames", 1, "d"), ..., "'d' is missing; alpha, a, d and theta"),
    (("frames", 1, "alpha"), "ninety", "'ninety' given; wanted: a number"),
    (("frames", 1, "alpha"), True, "wanted: a number"),
    (("frames", 1, "alpha"), math.inf, "is not a finite number"),
    (("frames", 1, "link", "length"), 0, "greater than 0"),
    (("frames", 1, "link", "radius"), -9.5, r"frames\[1\].link.radius: -9.5 given; wanted: greater than 0"),
    (("frames", 2, "link", "radius"), [9, -1], "greater than 0"),
    (("frames", 2, "link", "radius"), [9, 8, 7], "at most 2 items"),
    (("frames", 1, "link", "width"), 1, "unknown key 'width'; known are length, radius"),
    (("frames", 4, "transform", 0, 0), 1.01, "is not rigid"),
    (("frames", 4, "transform", 0, 0), -1, "is not rigid"),
    (("frames", 4, "transform", 3, 0), 1, r"last row is .*\[0, 0, 0, 1\] is wanted"),
    (("frames", 4, "transform"), IDENTITY, "at least 4 items"),
    (("frames", 4, "alpha"), 0, "has `transform` and `alpha`; one or the other"),
    (("couplings", 0, "of"), "thumb", "couplings.*joint 'thumb' does not exist; wanted: mcp, pip, dip"),
    (("couplings", 0, "of"), "dip", "'dip' follows itself in a circle"),
    (("couplings",), [{"joint": "dip", "of": "pip", "ratio": 1}] * 2, "'dip' is coupled twice"),
    (("units",), "inch", "'mm' or 'm'"),
    (("format",), "handtrack/model-2", "'handtrack/model-1'"),
    (("name",), "", "at least 1 character"),
    (("colour",), "red", "unknown key 'colour'"),
]


@pytest.mark.parametrize(("place", "value", "message"), MODEL_CASES)
def test_bad_models_are_one_clear_line(tmp_path, place, value, message):
    path = tmp_path / "model.yaml"
    text = json.dumps(put(model_data(), place, value), indent=1).replace("Infinity", ".inf")
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_model(path)
    assert_one_line(caught.value, "model.yaml")


def test_couplings_that_circle_over_two_joints_are_refused(tmp_path):
    data = model_data()
    data["couplings"].append({"joint": "pip", "of": "dip", "ratio": 1})
    (tmp_path / "model.yaml").write_text(json.dumps(data))
    with pytest.raises(InputError, match="in a circle"):
        read_model(tmp_path / "model.yaml")


def test_a_model_without_a_joint_is_refused(tmp_path):
    data = put(model_data(), ("frames",), model_data()["frames"][:1])
    (tmp_path / "model.yaml").write_text(json.dumps(data))
    with pytest.raises(InputError, match="no frame has a joint; at least one"):
        read_model(tmp_path / "model.yaml")


def rotation_off_by(angle: float) -> list[list[float]]:
    return [[math.cos(angle), -math.sin(angle), 0], [0, 1, 0], [0, 0, 1]]


SEQUENCE_CASES: list[tuple[tuple[str | int, ...], Any, str]] = [
    (("camera", "R"), rotation_off_by(1e-3), "camera.R: is no rotation: R R.T differs from the identity by 0.001"),
    (("camera", "R"), [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "is a reflection: its determinant is -1"),
    (("camera", "R"), [[1, 0], [0, 1]], "at least 3 items"),
    (("camera", "t"), [0, 0], "at least 3 items"),
    (("camera", "fx"), 0, "camera.fx: 0 given; wanted: greater than 0"),
    (("camera", "fy"), -20, "greater than 0"),
    (("camera", "width"), 0, "greater than 0"),
    (("camera", "width"), 16.0, "integer"),
    (("camera", "width"), 17, "0.png: is 16 x 12 pixels; 17 x 12, the camera's size, is wanted"),
    (("camera", "distortion"), [-5, 0, 0, 0, 0], "camera.distortion: folds inside the image"),
    (("camera", "distortion"), [0, 0], "at least 5 items"),
    (("camera", "scale"), 3, "unknown key 'scale'"),
    (("camera", "type"), "fisheye", "'type' must be one of 'orthographic', 'perspective'"),
    (("camera", "type"), ..., "camera: its 'type' must be one of"),
    (("camera", "cx"), ..., "camera: 'cx' is missing"),
    (("camera",), ..., "'camera' is missing"),
    (("camera",), "wide", "camera: "),
    (("fps",), 0, "fps: 0 given; wanted: greater than 0"),
    (("fps",), "25", "'25' given; wanted: a number"),
    (("fps",), math.nan, "is not a finite number"),
    (("frames",), "images/*.png", "is no folder"),
    (("frames",), "frames/*.jpg", "matches no file"),
    (("frames",), "/data/*.png", "is absolute; a path inside the folder"),
    (("frames",), "../a/*.png", "leaves the folder by '..'"),
    (("frames",), "film.mp4", "film.mp4: no such file"),
    (("frames",), "", "is no path"),
    (("frames",), 7, "a string"),
    (("model",), "hand.yaml", "no such file, and no built-in model; built in are index"),
    (("model",), "../model.yaml", "leaves the folder by '..'"),
    (("model",), "C:\\model.yaml", "is absolute"),
    (("model",), "..\\model.yaml", "leaves the folder"),
    (("model",), "a\0b", "is no path|special characters"),
    (("start", "thumb"), 1, "start.thumb: joint 'thumb' is not in model 'test'; wanted: mcp, pip, dip"),
    (("start", "pip"), ..., "start: start has no value for pip; every joint of 'test'"),
    (("start", "pip"), "x", "'x' given; wanted: a number"),
    (("truth",), "none.csv", "none.csv: no such file"),
    (("truth",), "/truth.csv", "is absolute"),
    (("colour",), 1, "unknown key 'colour'; known are format, fps, frames, camera, model, start, truth"),
    (("format",), "handtrack/sequence-9", "wanted: 'handtrack/sequence-1'"),
]


@pytest.mark.parametrize(("place", "value", "message"), SEQUENCE_CASES)
def test_bad_sequences_are_one_clear_line(tmp_path, place, value, message):
    folder = put_sequence(tmp_path / "clip")
    text = json.dumps(put(sequence_data(), place, value), indent=1).replace("NaN", ".nan")
    (folder / "sequence.yaml").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        open_sequence(folder)
    assert_one_line(caught.value, "clip")


def without_sequence_file(folder: Path) -> None:
    (folder / "sequence.yaml").unlink()


def without_images(folder: Path) -> None:
    for path in (folder / "frames").iterdir():
        path.unlink()


def with_a_broken_png(folder: Path) -> None:
    (folder / "frames/1.png").write_bytes(b"\x89PNG\r\n\x1a\nbroken")


def with_a_truncated_png(folder: Path) -> None:
    path = folder / "frames/1.png"
    noise = np.random.default_rng(0).integers(0, 255, (12, 16), dtype=np.uint8)
    Image.fromarray(noise).save(path)
    path.write_bytes(path.read_bytes()[:-90])


def with_another_size(folder: Path) -> None:
    Image.fromarray(np.zeros((12, 15), np.uint8)).save(folder / "frames/2.png")


def with_a_folder_for_a_model(folder: Path) -> None:
    (folder / "model.yaml").unlink()
    (folder / "model.yaml").mkdir()


def with_a_link_in_a_circle(folder: Path) -> None:
    (folder / "model.yaml").unlink()
    os.symlink(folder / "model.yaml", folder / "model.yaml")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (without_sequence_file, "clip: has no sequence.yaml"),
        (without_images, "matches no file"),
        (with_a_broken_png, "1.png: is no readable image"),
        (with_a_truncated_png, "1.png: is broken"),
        (with_another_size, "2.png: is 15 x 12 pixels; 16 x 12, the camera's size, is wanted"),
        (with_a_folder_for_a_model, "model.yaml: is not a file"),
        (with_a_link_in_a_circle, "model.yaml"),
    ],
)
def test_bad_folders_are_one_clear_line(tmp_path, spoil: Callable[[Path], None], message: str):
    folder = put_sequence(tmp_path / "clip")
    spoil(folder)
    with pytest.raises(InputError, match=message) as caught:
        list(open_sequence(folder).frames)
    assert_one_line(caught.value, "clip")


def test_what_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match="nowhere: no such file"):
        open_sequence(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frame,mcp,pip,dip\n0,1,nan,3\n", "line 2: pip: 'nan' given; a finite number is wanted"),
        ("frame,mcp,pip,dip\n0,1,,3\n", "line 2: pip: '' given"),
        ("frame,mcp,pip,dip\n1,1,2,3\n0,1,2,3\n", "line 3: frame: 0 after 1; strictly rising"),
        ("frame,mcp,pip,dip\n0,1,2,3\n0,1,2,3\n", "strictly rising"),
        ("frame,mcp,pip,dip\n0.5,1,2,3\n", "a whole number from 0 is wanted"),
        ("frame,mcp,pip,dip\n-1,1,2,3\n", "a whole number from 0 is wanted"),
        ("frame,mcp,thumb\n0,1,2\n", "column 'thumb' is no joint of model 'test'; wanted: mcp, pip, dip"),
        ("frame\n0\n", "has no joint"),
        ("frame,mcp\n", "has a header and no rows"),
        ("mcp,pip,dip\n1,2,3\n", "column 'frame' is missing"),
        ("frame,mcp,pip,dip\n0,1,2\n", "line 2: 3 cells; 4, as in the header"),
        ("", "is empty"),
    ],
)
def test_malformed_truth_is_one_clear_line(tmp_path, text, message):
    folder = put_sequence(tmp_path / "clip")
    (folder / "truth.csv").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        open_sequence(folder)
    assert_one_line(caught.value, "truth.csv")


def test_truth_that_is_not_text_is_refused(tmp_path):
    (tmp_path / "truth.csv").write_bytes(b"frame,theta1\n0,\xff\n")
    with pytest.raises(InputError, match="is not UTF-8"):
        read_truth(tmp_path / "truth.csv", model("r"))


def test_shorter_truth_is_only_a_warning(tmp_path):
    folder = put_sequence(tmp_path / "clip")
    (folder / "truth.csv").write_text("frame,mcp,pip,dip\n0,1,2,3\n")
    assert "has no truth for 2 of 3 frames" in open_sequence(folder).warnings[0]


def test_a_camera_file_needs_a_camera(tmp_path):
    path = tmp_path / "camera.yaml"
    for text in ("fps: 25", "format: handtrack/sequence-1", "camera: 3", "[1]"):
        path.write_text(text)
        with pytest.raises(InputError, match=r"camera.yaml"):
            read_camera(path)


GOOD_MODEL = yaml.safe_dump(model_data(), sort_keys=False)
GOOD_SEQUENCE = yaml.safe_dump(sequence_data(), sort_keys=False)
GOOD_TRUTH = "frame,mcp,pip,dip\n0,1,2,3\n1,2,3,4\n2,3,4,5\n"
JUNK = [
    "",
    "-",
    ":",
    ": ",
    "[",
    "]",
    "{",
    "}",
    "&a ",
    "*a",
    "!!int ",
    "nan",
    ".inf",
    "1e400",
    "-1",
    "0",
    "9" * 30,
    "'",
    '"',
    "\n",
    "\t",
]
JUNK += [
    "- ",
    "#",
    "\0",
    "\x85",
    "é",
    "null",
    "true",
    "? ",
    "|",
    ">",
    "%",
    "@",
    ",",
    "1e-3",
    "..",
    "/",
    "\\",
    "--- ",
    "...\n",
    "<<: ",
]


@st.composite
def mutated(draw: st.DrawFn, text: str) -> bytes:
    """The text with up to four places cut, doubled, or replaced by junk."""
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        length = draw(st.integers(0, 12))
        what = draw(st.sampled_from(["junk", "double", "cut", "move"]))
        piece = text[start : start + length]
        if what == "junk":
            piece = draw(st.sampled_from(JUNK))
        elif what == "double":
            piece = piece * 2
        elif what == "cut":
            piece = ""
        else:
            other = draw(st.integers(0, len(text)))
            piece = text[other : other + length]
        text = text[:start] + piece + text[start + length :]
    content = text.encode()
    if draw(st.integers(0, 9)) == 0:
        at = draw(st.integers(0, len(content)))
        content = content[:at] + draw(st.binary(max_size=3)) + content[at:]
    return content


anything = settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@given(mutated(GOOD_MODEL))
@anything
@example(b"a: &x [*x]")
@example(b"frames: [[]]")
def test_any_model_text_is_a_model_or_one_clear_line(content):
    try:
        model_from_document(parse_yaml(content, Path("model.yaml")))
    except InputError as error:
        assert_one_line(error, "model.yaml")


@given(mutated(GOOD_SEQUENCE))
@anything
def test_any_sequence_text_is_a_sequence_or_one_clear_line(tmp_path, content):
    folder = tmp_path / "clip"
    if not folder.exists():
        put_sequence(folder)
    (folder / "sequence.yaml").write_bytes(content)
    try:
        open_sequence(folder)
    except InputError as error:
        assert_one_line(error, "clip")


@given(mutated(GOOD_TRUTH))
@anything
def test_any_table_text_is_finite_numbers_or_one_clear_line(tmp_path, content):
    path = tmp_path / "truth.csv"
    path.write_bytes(content)
    hand = model_from_document(parse_yaml(GOOD_MODEL.encode(), Path("model.yaml")))
    try:
        truth, _ = read_truth(path, hand)
    except InputError as error:
        assert_one_line(error, "truth.csv")
    else:
        rows = [row for row in csv.reader(io.StringIO(content.decode("utf-8-sig"), newline="")) if row]
        assert truth.q.shape == (len(rows) - 1, 3)
        assert np.isfinite(truth.q[:, [name in [c.strip() for c in rows[0]] for name in hand.joint_names]]).all()


def png(deep: bool) -> bytes:
    stream = io.BytesIO()
    values = np.random.default_rng(1).integers(0, 255, (12, 16))
    Image.fromarray(values.astype(np.uint16 if deep else np.uint8)).save(stream, "PNG")
    return stream.getvalue()


@given(
    st.booleans(),
    st.lists(st.tuples(st.integers(0, 280), st.integers(0, 255)), min_size=1, max_size=4),
    st.integers(0, 300),
)
@anything
def test_any_image_file_is_a_picture_or_one_clear_line(tmp_path, deep, flips, length):
    folder = tmp_path / "clip"
    if not folder.exists():
        put_sequence(folder)
    content = bytearray(png(deep))
    for at, value in flips:
        content[at % len(content)] = value
    (folder / "frames/1.png").write_bytes(bytes(content[: max(length, 20)] if length < 200 else content))
    try:
        for image in open_sequence(folder).frames:
            assert image.shape == (12, 16)
            assert np.isfinite(image).all()
    except InputError as error:
        assert_one_line(error, "clip")
