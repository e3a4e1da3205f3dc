"""The built-in models against the tables of the hand thesis and against what a hand looks like."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.kinematics import forward, link_ends
from handtrack.kinematics.builtin import HAND_BREADTH, HAND_LENGTH, SEGMENTS, model, model_names

DEGREE = math.pi / 180


def pose(name: str, **degrees: float) -> np.ndarray:
    hand = model(name)
    return np.array([degrees.get(joint, 0.0) for joint in hand.joint_names]) * DEGREE


def ends(name: str, **degrees: float) -> tuple[np.ndarray, np.ndarray]:
    hand = model(name)
    return link_ends(hand, forward(hand, pose(name, **degrees)))


@pytest.mark.parametrize(
    ("name", "joints", "links", "fingers"),
    [
        ("index", 3, 3, 1),
        ("index_thumb", 6, 6, 2),
        ("two_finger", 6, 6, 2),
        ("full_hand", 21, 15, 5),
        ("full_hand_coupled", 21, 15, 5),
        ("r", 1, 1, 1),
        ("p", 1, 1, 1),
        ("pr", 2, 1, 1),
        ("rr", 2, 2, 1),
    ],
)
def test_models_have_the_joints_of_their_tables(name, joints, links, fingers):
    hand = model(name)
    assert (len(hand.joint_names), hand.link_frame.size, int(hand.link_is_tip.sum())) == (joints, links, fingers)
    assert hand.link_finger.max() + 1 == fingers


def test_every_name_builds_a_model_of_that_name():
    assert [model(name).name for name in model_names()] == list(model_names())


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="'foot' is no built-in model; there are index, index_thumb"):
        model("foot")


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
@settings(max_examples=25, deadline=None)
def test_index_finger_is_the_planar_chain_of_table_2_2(q):
    finger = model("index")
    base, tip = link_ends(finger, forward(finger, np.array(q)))
    angle = np.cumsum(q)
    steps = finger.link_length[:, None] * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    np.testing.assert_allclose(tip, np.cumsum(steps, axis=0), atol=1e-12)
    np.testing.assert_allclose(base[1:], tip[:-1], atol=1e-12)


def test_two_fingers_lie_side_by_side_along_y_and_bend_towards_z():
    base, tip = ends("two_finger")
    np.testing.assert_allclose(base[:, 0], [-11] * 3 + [11] * 3, atol=1e-12)
    direction = (tip - base) / np.linalg.norm(tip - base, axis=1, keepdims=True)
    np.testing.assert_allclose(direction, np.tile([0.0, 1.0, 0.0], (6, 1)), atol=1e-12)
    base, tip = ends("two_finger", index_mcp=90.0)
    np.testing.assert_allclose(tip[3] - base[3], [0, 0, model("two_finger").link_length[3]], atol=1e-12)
    np.testing.assert_allclose(tip[0, 2], 0, atol=1e-12)


def test_fixed_frames_of_the_two_fingers_are_those_of_table_6_1():
    hand = model("two_finger")
    for number, across in ((1, -11.0), (6, 11.0)):
        T = hand.prefix[hand.frame_ids.tolist().index(number)]
        np.testing.assert_allclose(T, [[0, 1, 0, across], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]], atol=1e-12)


@pytest.mark.parametrize("finger", ["little", "ring", "middle", "index"])
def test_fingers_of_the_full_hand_bend_towards_the_palm_and_spread_apart(finger):
    hand = model("full_hand")
    last = next(i for i, frame in enumerate(hand.link_frame) if hand.joint_names[hand.joint[frame]] == f"{finger}_dip")
    straight = ends("full_hand")[1][last]
    for joint in ("mcp", "pip", "dip"):
        assert ends("full_hand", **{f"{finger}_{joint}": 30.0})[1][last, 2] > 3.0
    outwards = -1 if finger in ("little", "ring") else 1
    assert outwards * (ends("full_hand", **{f"{finger}_abduction": 15.0})[1][last] - straight)[0] > 10.0


def test_straight_middle_finger_reaches_a_hand_length_from_the_wrist():
    # 0.446 + 0.266 + 0.170 + 0.108 = 0.990 of hand length in Buchholz et al. 1992; frame {0} is 0.073 above the crease.
    hand = model("full_hand")
    _, tip = ends("full_hand")
    reach = (tip[:, 1] + hand.link_radius[:, 1])[hand.link_is_tip] + 0.073 * HAND_LENGTH
    assert reach.max() == pytest.approx(0.990 * HAND_LENGTH, abs=0.3)


def test_neighbouring_fingers_touch_at_most_where_they_are_not_spread():
    hand = model("full_hand")
    base, _ = ends("full_hand")
    knuckles = sorted((base[i, 0], hand.link_radius[i, 0]) for i in range(0, 12, 3))
    gaps = [b[0] - a[0] - a[1] - b[1] for a, b in itertools.pairwise(knuckles)]
    assert min(gaps) > -2.0
    assert knuckles[-1][0] - knuckles[0][0] < HAND_BREADTH


def test_thumb_lies_on_the_index_side_and_lifts_and_spreads():
    tips = {}
    for name, degrees in {"zero": {}, "palmar": {"thumb_palmar": 30.0}, "radial": {"thumb_radial": 30.0}}.items():
        tips[name] = ends("full_hand", **degrees)[1][-1]
    assert tips["zero"][0] > 20.0
    assert tips["zero"][2] == pytest.approx(0.0, abs=1e-12)
    assert tips["palmar"][2] > 10.0
    assert tips["radial"][0] > tips["zero"][0] + 30.0
    bent = ends("full_hand", thumb_mcp=-40.0)[1][-1]
    assert bent[0] < tips["zero"][0] - 20.0, "the thumb bends across the palm"


def test_thumb_and_index_finger_do_not_overlap_at_the_zero_pose():
    hand = model("full_hand")
    base, tip = ends("full_hand")
    s = np.linspace(0, 1, 50)[:, None]
    index, thumb = ([base[i] + s * (tip[i] - base[i]) for i in links] for links in (range(9, 12), range(12, 15)))
    for i, a in enumerate(index):
        for k, b in enumerate(thumb):
            nearest = np.linalg.norm(a[:, None] - b[None], axis=-1).min()
            assert nearest > hand.link_radius[9 + i, 0] + hand.link_radius[12 + k, 0] - 1.0


def test_index_and_thumb_of_table_2_3_open_with_positive_angles():
    straight = ends("index_thumb")[1]
    opened = ends("index_thumb", index_mcp=20.0, thumb_cmc=20.0)[1]
    assert opened[2, 2] > straight[2, 2] + 10.0
    assert opened[5, 2] < straight[5, 2] - 10.0


def test_ranges_are_those_of_table_2_1():
    hand = model("full_hand")
    limits = dict(zip(hand.joint_names, np.degrees(hand.limits).round(9).tolist(), strict=True))
    assert limits["ring_mcp"] == [-45, 90]
    assert limits["ring_pip"] == [0, 100]
    assert limits["ring_dip"] == [0, 80]
    assert limits["thumb_palmar"] == [0, 45]
    assert limits["thumb_mcp"] == [-55, 10]  # opening is positive in Table 6.2
    assert limits["thumb_ip"] == [-80, 15]
    assert np.isfinite(hand.limits).all()
    assert (hand.limits[:, 0] <= 0).all()
    assert (hand.limits[:, 1] >= 0).all(), "the zero pose is allowed"


def test_the_coupled_hand_is_the_full_hand_with_a_soft_prior_on_each_dip():
    hand, coupled = model("full_hand"), model("full_hand_coupled")
    for field in ("prefix", "limits", "coupling", "link_base", "link_tip", "link_radius"):
        np.testing.assert_array_equal(getattr(hand, field), getattr(coupled, field))
    assert hand.soft.shape == (0, 21)
    assert [c.joint for c in coupled.soft_couplings] == ["little_dip", "ring_dip", "middle_dip", "index_dip"]
    off = coupled.soft @ pose("full_hand_coupled", ring_pip=60.0, ring_dip=70.0, index_pip=30.0, index_dip=20.0)
    np.testing.assert_allclose(off, [0, 2, 0, 0], atol=1e-12, err_msg="sigma is 15 degrees")


def test_segments_shrink_outwards():
    for lengths in SEGMENTS.values():
        assert sorted(lengths, reverse=True) == list(lengths)


def test_chains_of_section_3_2_project_as_the_thesis_prints():
    P, d, angle = 3.0, 1.7, 0.4
    image_from_0 = np.array([[0, 0, 1, 0], [1, 0, 0, 0]])  # section 3.2.3
    pr = model("pr")
    point = forward(pr, np.array([d, angle]))[1] @ [P, 0, 0, 1]
    np.testing.assert_allclose(image_from_0 @ point, [d - P * math.sin(angle), P * math.cos(angle)], atol=1e-12)
    p = model("p")
    point = forward(p, np.array([d]))[p.link_frame[0]] @ [P, 0, 0, 1]
    np.testing.assert_allclose(np.array([[0, 0, 1, 0], [0, 1, 0, 0]]) @ point, [d, P], atol=1e-12)  # section 3.2.2
    rr = model("rr")
    _, tip = link_ends(rr, forward(rr, np.array([angle, 0.3])))
    np.testing.assert_allclose(
        tip[1, :2], 5 * np.array([math.cos(angle) + math.cos(angle + 0.3), math.sin(angle) + math.sin(angle + 0.3)])
    )
