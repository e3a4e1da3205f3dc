"""Model files: reading, exact round trips, URDF."""

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handtrack.errors import InputError
from handtrack.formats import write_model
from handtrack.formats.model_writing import dh_parameters, model_text, number
from handtrack.formats.models import model_from_document, read_model
from handtrack.formats.urdf import export_urdf, roll_pitch_yaw
from handtrack.formats.yaml_files import parse_yaml
from handtrack.kinematics import (
    Coupling,
    FrameRow,
    LinkSigmas,
    Model,
    forward,
    link_ends,
    link_transform,
    model_from_rows,
    pose_from_free,
)
from handtrack.kinematics.builtin import model, model_names

SHARED = Path(__file__).parents[2] / "shared/data/sequences"

EXAMPLE = """
format: handtrack/model-1
name: two_finger
units: mm
frames:
  - {id: 1, parent: 0, alpha: 180, a: -11, d: 0, theta: -90}            # fixed frame
  - id: 3
    parent: 1
    alpha: -90
    a: 0
    d: 0
    theta: {joint: middle_mcp, offset: 0, limits: [-45, 90]}
    link: {length: 46, radius: 9.5}
  - {id: 4, parent: 3, alpha: 0, a: 46, d: 0, theta: {joint: middle_pip, offset: 5}, link: {length: 27, radius: [9, 8]}}
  - {id: 5, parent: 4, alpha: 0, a: 27, d: {joint: slide, offset: 1, limits: [0, 3]}, theta: 0}
  - {id: 6, parent: 4, alpha: 0, a: 27, d: 0, theta: {joint: middle_dip}}
  - {id: 40, parent: 0, transform: [[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]}
couplings:
  - {joint: middle_dip, of: middle_pip, ratio: 0.67, offset: 3}
"""


def parsed(text: str) -> Model:
    return model_from_document(parse_yaml(text.encode(), Path("model.yaml")))


def assert_same(a: Model, b: Model) -> None:
    assert (a.name, a.units, a.joint_names) == (b.name, b.units, b.joint_names)
    exact = (
        "frame_ids",
        "parent",
        "joint",
        "prismatic",
        "free",
        "link_frame",
        "link_length",
        "link_radius",
        "link_base",
        "link_tip",
        "link_finger",
    )
    for field in exact:
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field), err_msg=field)
    for field in ("prefix", "limits", "coupling", "coupling_offset", "soft", "soft_target"):
        np.testing.assert_allclose(getattr(a, field), getattr(b, field), rtol=1e-13, atol=1e-13, err_msg=field)
    for one, other in zip(a.link_sigmas, b.link_sigmas, strict=True):
        assert (one is None) == (other is None)
        assert one is None or other is None or astuple(one) == astuple(other)
    for one, other in zip(a.soft_couplings, b.soft_couplings, strict=True):
        assert (one.joint, one.of) == (other.joint, other.of)
        np.testing.assert_allclose([one.ratio, one.offset], [other.ratio, other.offset], rtol=1e-13)
        assert one.sigma == pytest.approx(other.sigma, rel=1e-13)


def test_degrees_become_radians_and_the_rows_are_modified_dh():
    hand = parsed(EXAMPLE)
    assert hand.joint_names == ("middle_mcp", "middle_pip", "slide", "middle_dip")
    np.testing.assert_allclose(np.degrees(hand.limits[0]), [-45, 90])
    assert np.isinf(hand.limits[1]).all()
    np.testing.assert_allclose(hand.limits[2], [0, 3])
    np.testing.assert_allclose(hand.prefix[0], link_transform(math.pi, -11.0, 0.0, -math.pi / 2))
    np.testing.assert_allclose(hand.prefix[2], link_transform(0.0, 46.0, 0.0, math.radians(5)))
    np.testing.assert_allclose(hand.prefix[3], link_transform(0.0, 27.0, 1.0, 0.0))
    np.testing.assert_allclose(hand.prefix[5][:3, 3], [5, 6, 7])
    np.testing.assert_allclose(hand.link_radius, [[9.5, 9.5], [9, 8]])


def test_couplings_are_in_the_units_of_the_file():
    hand = parsed(EXAMPLE)
    q = pose_from_free(hand, np.array([0.0, math.radians(30), 0.0]))
    assert math.degrees(q[3]) == pytest.approx(0.67 * 30 + 3)
    mixed = parsed(
        EXAMPLE.replace("joint: middle_dip, of: middle_pip, ratio: 0.67", "joint: slide, of: middle_pip, ratio: 0.1")
    )
    q = pose_from_free(mixed, np.array([0.0, math.radians(30), 0.0]))
    assert q[2] == pytest.approx(0.1 * 30 + 3), "millimetres for each degree"


@pytest.mark.parametrize("name", model_names())
def test_builtin_models_come_back_from_their_files(name, tmp_path):
    write_model(tmp_path / "ü %20 model.yaml", model(name))
    assert_same(read_model(tmp_path / "ü %20 model.yaml"), model(name))


def test_the_example_comes_back_and_its_text_is_stable():
    hand = parsed(EXAMPLE)
    text = model_text(hand)
    assert_same(parsed(text), hand)
    assert model_text(parsed(text)) == text
    assert "{id: 1, parent: 0, alpha: 180, a: -11, d: 0, theta: -90}" in text
    assert "theta: {joint: middle_mcp, limits: [-45, 90]}, link: {length: 46, radius: 9.5}" in text
    assert "- {joint: middle_dip, of: middle_pip, ratio: 0.67, offset: 3}" in text


def test_couplings_between_turning_and_sliding_joints_come_back():
    text = EXAMPLE.replace("joint: middle_dip, of: middle_pip, ratio: 0.67", "joint: slide, of: middle_pip, ratio: 0.1")
    assert_same(parsed(model_text(parsed(text))), parsed(text))
    text = EXAMPLE.replace("joint: middle_dip, of: middle_pip, ratio: 0.67", "joint: middle_pip, of: slide, ratio: 12")
    assert_same(parsed(model_text(parsed(text))), parsed(text))


OFFSET = EXAMPLE.replace(
    "link: {length: 27, radius: [9, 8]}",
    "link: {length: 27, radius: [9, 8], base_offset: [0, 1, -0.5], tip_offset: [0.1, -2, 3], "
    "sigmas: {length: 0.5, radius: [0.2, 0.1], tip_offset: [1, 0.5, 2]}}",
)
SOFT = EXAMPLE.replace("ratio: 0.67, offset: 3", "ratio: 0.67, offset: 3, sigma: 12")


def test_offset_ends_and_their_sigmas_are_read_in_the_axes_of_their_frame():
    hand = parsed(OFFSET)
    np.testing.assert_array_equal(hand.link_base, [[0, 0, 0], [0, 1, -0.5]])
    np.testing.assert_array_equal(hand.link_tip, [[46, 0, 0], [27.1, -2, 3]])
    np.testing.assert_array_equal(hand.link_length, [46, 27])
    assert hand.link_sigmas[0] is None
    known = hand.link_sigmas[1]
    assert known is not None
    assert astuple(known) == (0.5, (0.2, 0.1), (0.0, 0.0, 0.0), (1.0, 0.5, 2.0))
    plain = parsed(EXAMPLE)
    frames = forward(hand, np.linspace(0.1, 0.4, 4))
    moved, fixed = link_ends(hand, frames)[1][1], link_ends(plain, frames)[1][1]
    np.testing.assert_allclose(moved - fixed, frames[2, :3, :3] @ [0.1, -2, 3], atol=1e-12)


def test_one_sigma_stands_for_both_radii():
    known = parsed(EXAMPLE.replace("radius: 9.5}", "radius: 9.5, sigmas: {radius: 0.4}}")).link_sigmas[0]
    assert known is not None
    assert known.radius == (0.4, 0.4)


def test_shapes_come_back_and_are_only_written_where_there_are_any():
    hand = parsed(OFFSET)
    text = model_text(hand)
    assert_same(parsed(text), hand)
    assert model_text(parsed(text)) == text
    assert "link: {length: 46, radius: 9.5}" in text
    assert (
        "base_offset: [0, 1, -0.5], tip_offset: [0.1, -2, 3], "
        "sigmas: {length: 0.5, radius: [0.2, 0.1], tip_offset: [1, 0.5, 2]}}" in text
    )


@given(
    st.floats(1.0, 100.0),
    st.tuples(st.floats(-0.4, 0.4), st.floats(-5, 5), st.floats(-5, 5)),
    st.tuples(*[st.floats(-5, 5)] * 3),
    st.tuples(*[st.floats(0, 9)] * 3),
)
@settings(max_examples=60, deadline=None)
def test_offset_ends_come_back_bit_for_bit(length, tip, base, spread):
    sigmas = LinkSigmas(spread[0], (spread[1], spread[2]), spread, (spread[2], spread[1], spread[0]))
    moved = (tip[0] * length, tip[1], tip[2])
    row = FrameRow(
        1,
        0,
        joint="q",
        link_length=length,
        link_radius=(0.1, 0.1),
        link_base_offset=(base[0] - 6.0, base[1], base[2]),
        link_tip_offset=moved,
        link_sigmas=sigmas,
    )
    hand = model_from_rows("any", [row])
    assert_same(parsed(model_text(hand)), hand)


@pytest.mark.parametrize(
    ("link", "message"),
    [
        ("base_offset: [0, 1]", "base_offset: .*a list with at least 3 items"),
        ("tip_offset: [0, 1, 2, 3]", "tip_offset: .*a list with at most 3 items"),
        ("tip_offset: 3", "tip_offset: 3 given; wanted: a.* list"),
        ("tip_offset: [0, .nan, 0]", "not a finite number"),
        ("tip_ofset: [0, 0, 0]", "unknown key 'tip_ofset'; known are length, radius, base_offset, tip_offset, sigmas"),
        ("sigmas: {length: -1}", "sigmas.length: -1 given; wanted: greater than or equal to 0"),
        ("sigmas: {radius: [1, -1]}", "sigmas.radius.*greater than or equal to 0"),
        ("sigmas: {radius: [1, 1, 1]}", "sigmas.radius: .*a list with at most 2 items"),
        ("sigmas: {tip_offset: [1, 1, -1]}", "sigmas.tip_offset.*greater than or equal to 0"),
        ("sigmas: {offset: [0, 0, 0]}", "unknown key 'offset'; known are length, radius, base_offset, tip_offset"),
    ],
)
def test_shapes_that_make_no_sense_are_refused_with_their_place(link, message):
    text = EXAMPLE.replace("link: {length: 46, radius: 9.5}", "link: {length: 46, radius: 9.5, " + link + "}")
    with pytest.raises(InputError, match=r"^model.yaml: line 13: .*" + message):
        parsed(text)


def test_an_end_that_swallows_the_other_is_refused():
    swallowed = "link: {length: 46, radius: [9.5, 4], tip_offset: [-41, 0, 0]}"
    with pytest.raises(InputError, match=r"frames\[1\].link: its ends are 5 apart with radii 9.5 and 4: one swallows"):
        parsed(EXAMPLE.replace("link: {length: 46, radius: 9.5}", swallowed))
    beside = "link: {length: 46, radius: [9.5, 4], base_offset: [45, 3, 0], tip_offset: [0, -3, 0]}"
    assert parsed(EXAMPLE.replace("link: {length: 46, radius: 9.5}", beside)).link_tip[0].tolist() == [46, -3, 0]


def test_a_coupling_with_sigma_leaves_both_joints_free_and_says_how_far_they_part():
    hand = parsed(SOFT)
    assert hand.free.size == 4
    u = np.radians([0.0, 30.0, 0.0, 0.67 * 30 + 3 + 12])
    np.testing.assert_allclose(hand.soft @ u - hand.soft_target, [1.0], atol=1e-12)
    assert parsed(EXAMPLE).soft.shape == (0, 3)
    assert parsed(EXAMPLE).soft_target.shape == (0,)


def test_soft_couplings_come_back_beside_exact_ones():
    both = SOFT + "  - {joint: slide, of: middle_mcp, ratio: 0.1}\n"
    both += "  - {joint: slide, of: middle_dip, ratio: -0.2, sigma: 0.7}\n"
    hand = parsed(both)
    assert_same(parsed(model_text(hand)), hand)
    assert "- {joint: middle_dip, of: middle_pip, ratio: 0.67, offset: 3, sigma: 12}" in model_text(hand)
    assert "- {joint: slide, of: middle_dip, ratio: -0.2, sigma: 0.7}" in model_text(hand)
    q = np.array([math.radians(20.0), math.radians(10.0), math.radians(-15.0)])  # mcp, pip, dip; slide follows mcp
    np.testing.assert_allclose((hand.soft @ q - hand.soft_target)[1], (0.1 * 20 - 0.2 * 15) / 0.7, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("sigma: 12", "sigma: 0"), "couplings[0].sigma: 0 given; wanted: greater than 0"),
        (("sigma: 12", "sigma: wide"), "couplings[0].sigma: 'wide' given; wanted: a number"),
        (("of: middle_pip", "of: middle_dip"), "'middle_dip' follows itself in a circle"),
        (("of: middle_pip", "of: ring_pip"), "couplings[0].of: joint 'ring_pip' does not exist"),
        (("couplings:", "couplings:\n  - {joint: middle_pip, of: middle_dip, ratio: 1}"), "follows itself in a circle"),
    ],
)
def test_soft_couplings_that_make_no_sense_are_refused(change, message):
    with pytest.raises(InputError, match=re.escape(message)):
        parsed(SOFT.replace(*change))


def test_chains_of_couplings_come_back_as_the_same_map():
    rows = [FrameRow(i, i - 1, a=1.0, joint=f"j{i}", link_length=1.0, link_radius=(0.1, 0.1)) for i in (1, 2, 3)]
    chain = model_from_rows("chain", rows, [Coupling("j2", "j1", 0.5, 0.1), Coupling("j3", "j2", 0.5, 0.2)])
    assert_same(parsed(model_text(chain)), chain)


angles = st.floats(-180, 180)
lengths = st.floats(-200, 200)


@given(st.lists(st.tuples(angles, lengths, lengths, angles), min_size=1, max_size=4))
@settings(max_examples=50, deadline=None)
def test_any_table_comes_back_with_the_same_forward_kinematics(table):
    rows = [
        FrameRow(i + 1, i, math.radians(alpha), a, d, math.radians(theta), joint=f"j{i}", prismatic=i % 2 == 1)
        for i, (alpha, a, d, theta) in enumerate(table)
    ]
    chain = model_from_rows("any", rows)
    q = np.linspace(-1, 1, len(rows))
    np.testing.assert_allclose(forward(parsed(model_text(chain)), q), forward(chain, q), atol=1e-9)


def test_general_transforms_are_kept_as_matrices():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.3, -0.4, 0.5]).as_matrix()
    T[:3, 3] = [1, 2, 3]
    assert dh_parameters(T) is None
    hand = model_from_rows("t", [FrameRow(1, 0, transform=T), FrameRow(2, 1, joint="q")])
    assert_same(parsed(model_text(hand)), hand)


def test_what_the_format_cannot_hold_is_refused():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.3, -0.4, 0.5]).as_matrix()
    with pytest.raises(ValueError, match="frame of joint 'q' is not of the form"):
        model_text(model_from_rows("t", [FrameRow(1, 0, transform=T, joint="q")]))
    with pytest.raises(ValueError, match="two finite ones or none"):
        model_text(model_from_rows("t", [FrameRow(1, 0, joint="q", limits=(0.0, math.inf))]))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_read_back_as_themselves(value):
    assert float(number(value)) == value
    assert parse_yaml(f"a: {number(value)}".encode(), Path("x")).data["a"] == value


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared sequences are not here")
def test_models_of_the_mesh_sequences_are_read_and_come_back():
    hand = read_model(SHARED / "mesh_covered_palm/model.yaml")
    assert len(hand.joint_names) == 12
    assert hand.link_is_tip.sum() == 4
    assert_same(parsed(model_text(hand)), hand)


def urdf_frames(text: str, values: dict[str, float]) -> dict[str, np.ndarray]:
    """World frames of URDF links, by an independent reading of the format."""
    frames = {"frame_0": np.eye(4)}
    for joint in ET.fromstring(text.split("\n", 1)[1]).iter("joint"):
        if joint.find("parent") is None:
            continue
        origin, parent, child = joint.find("origin"), joint.find("parent"), joint.find("child")
        assert origin is not None
        assert parent is not None
        assert child is not None
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("xyz", [float(x) for x in origin.attrib["rpy"].split()]).as_matrix()
        T[:3, 3] = [float(x) for x in origin.attrib["xyz"].split()]
        mimic = joint.find("mimic")
        value = values.get(joint.attrib["name"], 0.0)
        if mimic is not None:
            value = float(mimic.attrib["multiplier"]) * values[mimic.attrib["joint"]] + float(mimic.attrib["offset"])
        motion = np.eye(4)
        if joint.attrib["type"] == "prismatic":
            motion[2, 3] = value
        elif joint.attrib["type"] != "fixed":
            motion[:3, :3] = Rotation.from_rotvec([0, 0, value]).as_matrix()
        frames[child.attrib["link"]] = frames[parent.attrib["link"]] @ T @ motion
    return frames


@pytest.mark.parametrize("source", ["example", "slide", "full_hand", "pr"])
@pytest.mark.filterwarnings("ignore:Gimbal lock")
def test_urdf_moves_like_the_model(source):
    text = EXAMPLE if source == "example" else EXAMPLE.replace("joint: middle_dip, of", "joint: slide, of")
    hand = parsed(text) if source in ("example", "slide") else model(source)
    u = np.linspace(0.1, 0.9, hand.free.size)
    q = pose_from_free(hand, u)
    slides = {hand.joint_names[hand.joint[i]] for i in np.flatnonzero(hand.prismatic)}
    values = {name: q[i] * (0.001 if name in slides else 1.0) for i, name in enumerate(hand.joint_names)}
    frames = urdf_frames(export_urdf(hand), values)
    ours = forward(hand, q)
    ours[:, :3, 3] *= 0.001
    for i, frame in enumerate(hand.frame_ids):
        np.testing.assert_allclose(frames[f"frame_{frame}"], ours[i], atol=1e-9)


def test_urdf_draws_each_pill_as_a_cylinder_and_two_balls():
    robot = ET.fromstring(export_urdf(parsed(EXAMPLE)).split("\n", 1)[1])
    visuals = robot.findall("./link[@name='frame_4']/visual/geometry/*")
    assert [shape.tag for shape in visuals] == ["cylinder", "sphere", "sphere"]
    assert [float(shape.attrib["radius"]) for shape in visuals] == pytest.approx([0.0085, 0.009, 0.008])


def test_urdf_pills_reach_from_one_offset_end_to_the_other():
    hand = parsed(OFFSET)
    robot = ET.fromstring(export_urdf(hand).split("\n", 1)[1])
    base, tip = hand.link_base[1] / 1000, hand.link_tip[1] / 1000
    tube, *balls = robot.findall("./link[@name='frame_4']/visual")
    for ball, end in zip(balls, (base, tip), strict=True):
        np.testing.assert_allclose([float(x) for x in ball[0].attrib["xyz"].split()], end, atol=1e-12)
    middle, turn = ([float(x) for x in tube[0].attrib[key].split()] for key in ("xyz", "rpy"))
    half = 0.5 * float(tube[1][0].attrib["length"]) * Rotation.from_euler("xyz", turn).as_matrix()[:, 2]
    np.testing.assert_allclose([middle - half, middle + half], [base, tip], atol=1e-12)


def test_urdf_has_no_mimic_for_a_soft_coupling():
    assert "mimic" in export_urdf(parsed(EXAMPLE))
    assert "mimic" not in export_urdf(parsed(SOFT))


def test_urdf_limits_are_in_radians_and_missing_ones_are_continuous():
    robot = ET.fromstring(export_urdf(parsed(EXAMPLE)).split("\n", 1)[1])
    kinds = {joint.attrib["name"]: joint.attrib["type"] for joint in robot.findall("joint")}
    assert kinds == {
        "fixed-1": "fixed",
        "middle_mcp": "revolute",
        "middle_pip": "continuous",
        "slide": "prismatic",
        "middle_dip": "continuous",
        "fixed-40": "fixed",
    }
    limit = robot.find("./joint[@name='middle_mcp']/limit")
    assert limit is not None
    assert float(limit.attrib["upper"]) == pytest.approx(math.pi / 2)
    assert 'name="a &amp; &lt;b&gt;"' in export_urdf(model_from_rows("a & <b>", [FrameRow(1, 0, joint="q")]))


@given(st.floats(-3.1, 3.1), st.floats(-math.pi / 2, math.pi / 2), st.floats(-3.1, 3.1))
@settings(max_examples=50, deadline=None)
def test_roll_pitch_yaw_rebuild_the_rotation_even_where_pitch_is_upright(roll, pitch, yaw):
    for p in (pitch, math.pi / 2, -math.pi / 2):
        R = Rotation.from_euler("xyz", [roll, p, yaw]).as_matrix()
        np.testing.assert_allclose(Rotation.from_euler("xyz", roll_pitch_yaw(R)).as_matrix(), R, atol=1e-7)
