"""Claims about bones: printed shares, heights from any of them in any order and posture, centre joints."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_people import confidences, figure
from scipy.spatial.transform import Rotation

from handtrack.body import skeleton_graph
from handtrack.body.skeleton_graph import (
    FAR,
    FILTERED,
    HEAD,
    LIMBS,
    MID_HIP,
    MID_SHOULDER,
    NEAR,
    NECK,
    OTHER_SIDE,
    ROOT,
    SEGMENTS,
    SHARE,
    SHORTEST,
    SIDE,
    TALLEST,
    complete,
    heights,
    lengths,
)
from handtrack.formats.skeletons import KEYPOINTS

HEIGHTS = st.floats(1.1, 2.2)


def several(*people: np.ndarray) -> np.ndarray:
    return np.stack(people)


@pytest.mark.parametrize(
    ("name", "share"), [("upper_arm", 0.186), ("forearm", 0.146), ("thigh", 0.245), ("shank", 0.246)]
)
def test_limbs_have_the_shares_that_winter_prints(name, share):
    """Winter 2009, Figure 4.1, after Drillis & Contini 1966."""
    found = {segment.name: segment.share for segment in SEGMENTS}
    assert found[f"left_{name}"] == found[f"right_{name}"] == share


def test_bones_of_the_trunk_fit_together():
    """Shoulders, hips and the sides between them are one trapezium, as long as the trunk."""
    share = {segment.name: segment.share for segment in SEGMENTS}
    across = 0.5 * (share["shoulders"] - share["hips"])
    assert share["left_side"] == share["right_side"] == pytest.approx(np.hypot(SIDE, across), abs=1e-3)


def test_bones_name_their_ends_and_go_outwards():
    for segment in SEGMENTS[:LIMBS]:
        side, bone = segment.name.split("_", 1)
        ends = {"upper_arm": ("shoulder", "elbow"), "forearm": ("elbow", "wrist"), "thigh": ("hip", "knee")}
        near, far = ends.get(bone, ("knee", "ankle"))
        assert (KEYPOINTS[segment.near], KEYPOINTS[segment.far]) == (f"{side}_{near}", f"{side}_{far}")
    assert set(np.concatenate([NEAR, FAR])) == set(range(FILTERED))
    assert len({segment.name for segment in SEGMENTS}) == len(SEGMENTS)


def test_other_sides_change_left_and_right():
    for one, other in enumerate(OTHER_SIDE):
        change = ("left", "right") if "left" in KEYPOINTS[one] else ("right", "left")
        assert KEYPOINTS[other] == KEYPOINTS[one].replace(*change)
    np.testing.assert_array_equal(OTHER_SIDE[OTHER_SIDE], np.arange(16))


def test_a_forearm_of_25_cm_tells_the_papers_height():
    """People paper, II-A: 0.146 of the height, so some 1.71 m."""
    p = np.full((1, 16, 3), np.nan)
    p[0, 2], p[0, 4] = (0.1, 0.2, 2.0), (0.1, 0.2, 2.25)
    assert heights(p, confidences(p))[0] == pytest.approx(1.71, abs=0.005)


@given(HEIGHTS, st.integers(0, 9999), st.integers(0, 15))
def test_any_bones_in_any_posture_tell_the_height(height, seed, holes):
    rng = np.random.default_rng(seed)
    p = figure(height)[None].copy()
    p[0, rng.choice(FILTERED, min(holes, FILTERED), replace=False)] = np.nan
    p = p @ Rotation.from_rotvec(rng.normal(0.0, 2.0, 3)).as_matrix().T + rng.normal(0.0, 3.0, 3)
    told = heights(p, confidences(p))[0]
    if np.isnan(lengths(p)).all():
        assert np.isnan(told)
    else:
        assert told == pytest.approx(height, rel=0.0025)  # the sides' share has three digits


@given(st.lists(HEIGHTS, min_size=1, max_size=6), st.integers(0, 999))
def test_people_do_not_depend_on_each_other_or_on_their_order(tall, seed):
    p = several(*(figure(h) for h in tall))
    order = np.random.default_rng(seed).permutation(len(tall))
    np.testing.assert_array_equal(heights(p[order], confidences(p)), heights(p, confidences(p))[order])


def test_heights_do_not_depend_on_the_order_of_bones(monkeypatch):
    rng = np.random.default_rng(1)
    p = several(*(figure(1.75) + rng.normal(0.0, 0.05, (16, 3)) for _ in range(20)))
    before = heights(p, confidences(p))
    order = rng.permutation(len(SEGMENTS))
    for name in ("NEAR", "FAR", "SHARE"):
        monkeypatch.setattr(skeleton_graph, name, getattr(skeleton_graph, name)[order])
    np.testing.assert_array_equal(heights(p, confidences(p)), before)


def test_a_few_wild_keypoints_do_not_change_the_height():
    p = figure(1.8)[None].copy()
    p[0, 4], p[0, 11] = (5.0, 1.0, 9.0), (-3.0, 0.0, 1.0)
    assert heights(p, confidences(p))[0] == pytest.approx(1.8, rel=0.0025)


def test_heights_are_those_of_a_plain_median_of_plausible_bones():
    rng = np.random.default_rng(3)
    p = several(*(figure(1.7) + rng.normal(0.0, 0.15, (16, 3)) for _ in range(50)))
    p[rng.random(p.shape[:2]) < 0.4] = np.nan
    for person, told in zip(p, heights(p, confidences(p)), strict=True):
        each = np.linalg.norm(person[FAR] - person[NEAR], axis=1) / SHARE
        each = each[(each > SHORTEST) & (each < TALLEST)]
        np.testing.assert_allclose(told, np.median(each) if each.size else np.nan)


@pytest.mark.parametrize("height", [0.5, 0.95, 2.4, 9.0])
def test_heights_that_nobody_has_are_not_told(height):
    p = figure(height)[None]
    assert np.isnan(heights(p, confidences(p))[0])


def test_bones_of_confidence_0_tell_nothing():
    p = figure(1.7)[None]
    sure = confidences(p)
    sure[0, 2:] = 0.0
    sure[0, 1] = 0.0
    assert np.isnan(heights(p, sure)[0])


def test_nobody_has_no_height():
    assert heights(np.zeros((0, 16, 3)), np.zeros((0, 16))).shape == (0,)


def test_lengths_are_distances_and_nan_at_missing_ends():
    p = figure(2.0)[None].copy()
    p[0, 4] = np.nan
    found = lengths(p)[0]
    assert np.isnan(found[2]) and np.isnan(found).sum() == 1
    np.testing.assert_allclose(found[[0, 1, 4, 9]], 2.0 * SHARE[[0, 1, 4, 9]])


def test_centre_joints_are_built_as_the_paper_says():
    """The root is the mean of shoulders and hips (people paper, II-A)."""
    p = figure(1.8)[None]
    built, sure = complete(p, confidences(p, 0.6))
    np.testing.assert_allclose(built[0, ROOT], p[0, [0, 1, 6, 7]].mean(axis=0))
    np.testing.assert_allclose(built[0, MID_HIP], p[0, [6, 7]].mean(axis=0))
    np.testing.assert_allclose(built[0, MID_SHOULDER], p[0, [0, 1]].mean(axis=0))
    np.testing.assert_allclose(built[0, HEAD] - built[0, MID_SHOULDER], [0.0, -1.8 * NECK, 0.0], atol=1e-12)
    assert (sure[0] == 0.6).all()


@given(st.integers(0, 9999), st.floats(0.0, 1.0))
def test_what_is_seen_stays_and_what_is_built_is_as_sure_as_the_least_sure(seed, holes):
    rng = np.random.default_rng(seed)
    p = rng.normal(0.0, 1.0, (4, 16, 3))
    p[rng.random((4, 16)) < holes] = np.nan
    sure = np.where(np.isnan(p[..., 0]), 0.0, rng.random((4, 16)))
    kept = p.copy(), sure.copy()
    built, c = complete(p, sure)
    np.testing.assert_array_equal(p, kept[0])
    np.testing.assert_array_equal(sure, kept[1])
    seen = ~np.isnan(p[..., 0])
    np.testing.assert_array_equal(built[seen], p[seen])
    np.testing.assert_array_equal(c[seen], sure[seen])
    there = ~np.isnan(built[..., 0])
    np.testing.assert_array_equal(there[:, :FILTERED], seen[:, :FILTERED])
    for middle, a, b in ((MID_HIP, 6, 7), (MID_SHOULDER, 0, 1), (ROOT, MID_HIP, MID_SHOULDER)):
        both = there[:, a] & there[:, b]
        np.testing.assert_array_equal(there[:, middle], seen[:, middle] | both)
        new = both & ~seen[:, middle]
        np.testing.assert_array_equal(c[new, middle], np.minimum(c[new, a], c[new, b]))
    assert (c[~there] == 0.0).all()
    again, sure_again = complete(built, c)
    np.testing.assert_array_equal(again, built)
    np.testing.assert_array_equal(sure_again, c)
