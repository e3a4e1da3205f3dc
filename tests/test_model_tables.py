"""What `handtrack models show` says of shapes and couplings."""

import json
from pathlib import Path

import pytest

from handtrack.cli import main
from handtrack.cli.model_tables import coupling_lines, frame_rows, shape_rows
from handtrack.kinematics import Coupling, FrameRow, LinkSigmas, model_from_rows
from handtrack.kinematics.builtin import model, model_names

SHAPED = """
format: handtrack/model-1
name: shaped
frames:
  - {id: 4, parent: 0, alpha: 0, a: 0, d: 0, theta: {joint: pip}, link: {length: 27, radius: 8}}
  - id: 9
    parent: 4
    alpha: 0
    a: 27
    d: 0
    theta: {joint: dip}
    link: {length: 16, radius: [8, 6], tip_offset: [1.5, 0, -0.25], sigmas: {length: 0.5, radius: [0.25, 0.5]}}
couplings:
  - {joint: dip, of: pip, ratio: 0.5, offset: -2, sigma: 12}
"""


@pytest.fixture
def shaped(tmp_path: Path) -> str:
    (tmp_path / "shaped.yaml").write_text(SHAPED)
    return str(tmp_path / "shaped.yaml")


def test_offsets_sigmas_and_couplings_are_shown(shaped, capsys):
    assert main(["models", "show", shaped]) == 0
    lines = capsys.readouterr().out.splitlines()
    head = next(i for i, line in enumerate(lines) if "tip end by" in line)
    assert " ".join(lines[head + 1].split()) == "9 0 0 0 1.5 0 -0.25 0.50 0.25 0.5 0 0 0 0 0 0"
    assert lines[-1] == "dip = 0.5 pip + -2 (sigma 12)"


def test_the_same_is_said_to_machines(shaped, capsys):
    assert main(["models", "show", shaped, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    (shape,) = told["shapes"]
    assert (shape["id"], shape["tip_offset"], shape["radius_sigma"]) == (9, [1.5, 0.0, -0.25], [0.25, 0.5])
    assert told["couplings"] == ["dip = 0.5 pip + -2 (sigma 12)"]
    assert len(told["frames"]) == 2


@pytest.mark.parametrize("name", model_names())
def test_plain_models_have_no_shapes_to_show(name, capsys):
    assert shape_rows(model(name)) == []
    assert main(["models", "show", name]) == 0
    assert "tip end by" not in capsys.readouterr().out


def test_the_coupled_hand_names_its_four_soft_couplings():
    assert coupling_lines(model("full_hand")) == []
    assert coupling_lines(model("full_hand_coupled"))[3] == "index_dip = 0.666667 index_pip (sigma 15)"


def test_couplings_of_sliding_joints_are_in_millimetres_for_each_degree():
    rows = [FrameRow(1, 0, joint="turn"), FrameRow(2, 1, joint="slide", prismatic=True)]
    exact = model_from_rows("m", rows, [Coupling("slide", "turn", 2.0, 1.0)])
    assert coupling_lines(exact) == ["slide = 0.0349066 turn + 1"]
    soft = model_from_rows("m", rows, [Coupling("turn", "slide", 0.5, sigma=0.1)])
    assert coupling_lines(soft) == ["turn = 28.6479 slide (sigma 5.72958)"]
    assert frame_rows(exact)[1][:3] == [2, 1, "slide"]


def test_a_shape_that_is_only_uncertain_is_shown_too():
    row = FrameRow(3, 0, joint="q", link_length=9.0, link_radius=(2.0, 2.0), link_sigmas=LinkSigmas(length=0.5))
    assert shape_rows(model_from_rows("m", [row]))[0][:4] == [3, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0.5]
