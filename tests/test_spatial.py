"""Claims about the judgement of skeletons: rewards, penalties, the gate, heights, sides; and the kernel's twin."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as tried
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from made_people import confidences, figure
from scipy.spatial.transform import Rotation

from handtrack._kernels.skeletons import judge_skeletons
from handtrack.body import spatial
from handtrack.body.people_settings import Settings
from handtrack.body.skeleton_graph import FAR, NEAR, NECK, SEGMENTS, SHARE, SHORTEST, SIDE, TALLEST
from handtrack.body.spatial import clean, evaluate, judged_numpy, rewards

ANY = st.one_of(st.floats(-4.0, 4.0), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1e6, -1e6, 1e-300, 1e150, -1e308]))
R, P = 0.07, 0.03  # different, so that they are told apart
MINE = Settings(reward=R, penalty=P)


def judged(p: np.ndarray, sure: np.ndarray, settings: Settings = MINE, known: np.ndarray | None = None):
    """What the kernel makes of cleaned skeletons: p, confidence, height, added, bones."""
    p, sure = clean(p, sure)
    m = p.shape[0]
    known = np.full(m, np.nan) if known is None else known
    height, added, bones = np.empty(m), np.empty((m, 16)), np.empty(m)
    numbers = np.array(
        [SHORTEST, TALLEST, spatial._CLEAR, settings.tolerance, settings.reward, settings.penalty, NECK / SIDE]
    )
    judge_skeletons(
        p, sure, NEAR, FAR, SHARE, spatial._PAIRS, spatial._SHARES, known, numbers, height, added, bones
    )  # fmt: skip
    return p, sure, height, added, bones


def arm(upper: float, fore: float) -> np.ndarray:
    """A left arm whose bones have these shares of what they should be; NaN leaves one out. Height 1.75 m."""
    p = np.full((1, 16, 3), np.nan)
    p[0, 2] = 0.1, 0.1, 2.0
    if not np.isnan(upper):
        p[0, 0] = p[0, 2] - [0.0, 1.75 * 0.186 * upper, 0.0]
    if not np.isnan(fore):
        p[0, 4] = p[0, 2] + [1.75 * 0.146 * fore, 0.0, 0.0]
    return p


@pytest.mark.parametrize(
    ("upper", "fore", "elbow"),
    [
        (1.0, 1.0, 2 * R),
        (1.8, 1.8, -2 * P),
        (1.0, 1.8, R - P),
        (0.4, 1.0, R - P),
        (1.0, np.nan, R),
        (np.nan, 1.8, -P),
        (np.nan, np.nan, 0.0),
    ],
)
def test_rewards_and_penalties_are_those_of_the_paper(upper, fore, elbow):
    """People paper, II-A: r for a right bone, p for a wrong one, 2r where all are right, 2p for two wrong ones."""
    p = arm(upper, fore)
    added = evaluate(p, confidences(p, 0.5), MINE, np.array([1.75])).confidence - confidences(p, 0.5)
    assert added[0, 2] == pytest.approx(elbow)
    for k, share in ((0, upper), (4, fore)):
        assert added[0, k] == pytest.approx(0.0 if np.isnan(share) else R if share == 1.0 else -P)


@pytest.mark.parametrize(("share", "right"), [(0.76, True), (1.24, True), (0.74, False), (1.26, False)])
def test_a_bone_is_right_within_the_tolerance(share, right):
    p = arm(np.nan, share)
    added = evaluate(p, confidences(p, 0.5), MINE, np.array([1.75])).reward[0]
    assert added == pytest.approx(R if right else -P)


def test_the_reward_of_a_person_is_the_mean_over_what_is_seen():
    p = arm(1.0, 1.0)
    assert evaluate(p, confidences(p), MINE).reward[0] == pytest.approx((R + 2 * R + R) / 3)


@given(st.integers(0, 9999))
def test_a_missing_bone_is_not_a_wrong_bone(seed):
    """Whatever keypoints are missing, those of a right skeleton are never punished."""
    rng = np.random.default_rng(seed)
    p = figure(1.7)[None].copy()
    p[0, rng.random(16) < rng.random()] = np.nan
    found = evaluate(p, confidences(p, 0.5), MINE)
    assert (found.confidence[0] >= clean(p, confidences(p, 0.5))[1][0]).all()
    bones = np.isfinite(found.p[0, FAR] - found.p[0, NEAR]).all(axis=1)
    count = np.bincount(np.concatenate([NEAR[bones], FAR[bones]]), minlength=12)
    seen = ~np.isnan(p[0, :12, 0])
    wanted = 0.5 + np.select([count > 1, count == 1], [2 * R, R], 0.0)
    np.testing.assert_allclose(found.confidence[0, :12][seen], wanted[seen])


@given(st.integers(0, 9999), st.permutations(range(len(SEGMENTS))))
def test_the_order_of_bones_plays_no_part(seed, order):
    rng = np.random.default_rng(seed)
    p = np.stack([figure(h) for h in (1.6, 1.8)]) + rng.normal(0.0, 0.08, (2, 16, 3))
    p[rng.random((2, 16)) < 0.2] = np.nan
    before = evaluate(p, confidences(p), MINE)
    order = np.array(order)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("NEAR", "FAR", "SHARE"):
            patch.setattr(spatial, name, getattr(spatial, name)[order])
        after = evaluate(p, confidences(p), MINE)
    for name in ("p", "confidence", "root", "height", "reward", "kept"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))


@given(st.integers(0, 9999), st.permutations(range(5)))
def test_people_are_judged_alone(seed, order):
    rng = np.random.default_rng(seed)
    p = np.stack([figure(h) for h in (1.5, 1.6, 1.7, 1.8, 1.9)]) + rng.normal(0.0, 0.1, (5, 16, 3))
    p[rng.random((5, 16)) < 0.3] = np.nan
    sure = confidences(p) * rng.random((5, 16))
    order = list(order)
    a, b = evaluate(p, sure, MINE), evaluate(p[order], sure[order], MINE)
    for name in ("p", "confidence", "root", "height", "reward", "kept"):
        np.testing.assert_array_equal(getattr(a, name)[order], getattr(b, name))
    assert tuple(a.reason[i] for i in order) == b.reason


@given(st.integers(0, 9999))
def test_where_people_look_from_does_not_change_what_they_earn(seed):
    rng = np.random.default_rng(seed)
    p = figure(1.75)[None] + rng.normal(0.0, 0.05, (16, 3))
    turned = (p - [0, 0, 2.2]) @ Rotation.from_rotvec(rng.normal(0.0, 2.0, 3)).as_matrix().T + [0, 0, 2.2]
    a, b = evaluate(p, confidences(p), MINE), evaluate(turned, confidences(p), MINE)
    np.testing.assert_allclose(a.confidence, b.confidence)
    np.testing.assert_allclose(a.height, b.height)


@pytest.mark.parametrize(("z", "kept"), [(2.9, True), (3.1, False), (-3.1, False)])
def test_people_beyond_the_distance_are_left_out(z, kept):
    p = figure(1.75, (0.0, 0.0, z))[None]
    p = p - np.nanmean(p[:, [0, 1, 6, 7]], axis=1)[:, None] + [0.0, 0.0, z]
    found = evaluate(p, confidences(p), Settings())
    np.testing.assert_allclose(found.root[0], [0.0, 0.0, z], atol=1e-12)
    assert found.kept.tolist() == [kept]
    assert found.reason == ("" if kept else "beyond the distance",)


def test_where_the_root_is_not_known_the_middle_of_what_is_seen_counts():
    p = np.full((1, 16, 3), np.nan)
    p[0, [4, 5]] = (0.5, 0.0, 3.5), (-0.5, 0.0, 3.5)
    found = evaluate(p, confidences(p), Settings())
    np.testing.assert_allclose(found.root[0], [0.0, 0.0, 3.5])
    assert found.reason == ("beyond the distance",)
    assert evaluate(p, confidences(p), Settings(distance=4.0)).kept.all()


@pytest.mark.parametrize(("height", "kept"), [(0.8, False), (1.2, True), (2.2, True), (2.6, False)])
def test_only_plausible_heights_are_people(height, kept):
    p = figure(height)[None]
    found = evaluate(p, confidences(p), Settings())
    assert found.kept.tolist() == [kept] and found.reason == ("" if kept else "no plausible height",)
    assert found.height[0] == (pytest.approx(height, rel=0.002) if kept else pytest.approx(np.nan, nan_ok=True))


def test_a_single_wrong_bone_does_not_say_that_this_is_nobody():
    p = arm(np.nan, 4.0)
    found = evaluate(p, confidences(p), Settings())
    assert found.kept.all() and np.isnan(found.height[0]) and found.reward[0] == 0.0


def test_a_known_height_is_what_bones_are_judged_by():
    p = figure(1.75)[None]
    own, told = evaluate(p, confidences(p), MINE), evaluate(p, confidences(p), MINE, np.array([1.25]))
    assert own.reward[0] > 0 > told.reward[0] and told.height.tolist() == [1.25]
    none = evaluate(p, confidences(p), MINE, np.array([np.nan]))
    np.testing.assert_array_equal(none.confidence, own.confidence)


def test_confidence_0_and_a_missing_place_are_the_same():
    p = figure(1.75)[None].copy()
    absent = p.copy()
    absent[0, [3, 4, 9]] = np.nan
    sure = confidences(p)
    sure[0, [3, 4, 9]] = 0.0
    a, b = evaluate(p, sure, MINE), evaluate(absent, confidences(p), MINE)
    for name in ("p", "confidence", "root", "height", "reward", "kept"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert a.confidence[0, 4] == 0.0 and np.isnan(a.p[0, 4]).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 0.0, -0.3])
def test_confidences_that_are_no_positive_numbers_mean_unseen(bad):
    p, sure = clean(figure()[None], np.full((1, 16), bad))
    assert np.isnan(p).all() and (sure == 0).all()


def test_confidences_stay_from_0_to_1():
    p = figure(1.75)[None]
    assert evaluate(p, confidences(p, 0.98), MINE).confidence.max() == 1.0
    assert clean(p, confidences(p, 7.0))[1].max() == 1.0
    wrong = arm(2.0, 2.0)
    assert evaluate(wrong, confidences(wrong, 0.01), MINE, np.array([1.75])).confidence.min() == 0.0


def straddling() -> np.ndarray:
    """Legs 45 degrees apart from upright each, so that exchanged ones are of a clearly wrong length. One person."""
    p = figure(1.75)[None].copy()
    for hip, way in ((6, 1.0), (7, -1.0)):
        out = np.array([way, 1.0, 0.0]) / np.sqrt(2.0)
        p[0, hip + 2] = p[0, hip] + 1.75 * 0.245 * out
        p[0, hip + 4] = p[0, hip + 2] + 1.75 * 0.246 * out
    return p


def swapped(p: np.ndarray, *pairs: int) -> np.ndarray:
    p = p.copy()
    for k in pairs:
        p[:, [k, k + 1]] = p[:, [k + 1, k]]
    return p


@pytest.mark.parametrize("pairs", [(2,), (4,), (8,), (10,), (2, 4), (8, 10), (4, 10), (2, 4, 8, 10)])
def test_exchanged_sides_are_put_right_with_their_confidences(pairs):
    p = straddling()
    sure = confidences(p) * np.linspace(0.6, 1.0, 16)
    wrong = evaluate(swapped(p, *pairs), swapped(sure[..., None], *pairs)[..., 0], MINE)
    right = evaluate(p, sure, MINE)
    np.testing.assert_array_equal(wrong.p, right.p)
    np.testing.assert_array_equal(wrong.confidence, right.confidence)


@pytest.mark.parametrize("p", [figure(1.75)[None], straddling()], ids=["standing", "straddling"])
def test_right_sides_stay(p):
    np.testing.assert_array_equal(evaluate(p, confidences(p), MINE).p[0, :12], p[0, :12])


def test_legs_that_could_be_either_way_stay():
    """Thighs side by side are as long either way, within what people differ by."""
    p = swapped(figure(1.75)[None], 8)
    np.testing.assert_array_equal(evaluate(p, confidences(p), MINE).p[0, :12], p[0, :12])


def test_crossed_forearms_are_not_taken_for_exchanged_ones():
    p = figure(1.75)[None].copy()
    for elbow, wrist, way in ((2, 4, -1.0), (3, 5, 1.0)):
        p[0, wrist] = p[0, elbow] + 1.75 * 0.146 * np.array([way, 0.0, 0.0])
    np.testing.assert_array_equal(evaluate(p, confidences(p), MINE).p[0, :12], p[0, :12])


def test_keypoints_farther_than_any_sensor_sees_are_unseen():
    """No room sensor sees beyond 50 m (as the reader of skeletons says); a number like 1e308 is a sensor's slip."""
    p = figure()[None].copy()
    p[0, 3, 2], p[0, 4, 0], p[0, 5, 1] = 51.0, -1e308, 1e200
    found = evaluate(p, confidences(p), Settings())
    assert np.isnan(found.p[0, 3:6]).all() and (found.confidence[0, 3:6] == 0).all() and found.kept.all()


def test_a_side_that_is_not_seen_is_not_exchanged():
    p = swapped(figure(1.75)[None], 4)
    p[0, 4] = np.nan
    np.testing.assert_array_equal(evaluate(p, confidences(p), MINE).p[0, :12], p[0, :12])


@given(st.integers(0, 99_999))
@tried(max_examples=150)
def test_the_compiled_judgement_is_that_of_its_twin(seed):
    rng = np.random.default_rng(seed)
    p = np.stack([figure(h) for h in rng.uniform(0.9, 2.4, 4)]) + rng.normal(
        0.0, rng.choice([0.0, 0.05, 0.3]), (4, 16, 3)
    )
    p[..., 12:, :] = rng.normal(0.0, 1.0, (4, 4, 3))
    p = swapped(p, *rng.choice([2, 4, 8, 10], rng.integers(0, 3), replace=False).tolist())
    p[rng.random((4, 16)) < rng.choice([0.0, 0.3, 0.8])] = np.nan
    sure = rng.random((4, 16)) * (rng.random((4, 16)) < 0.9)
    known = np.where(rng.random(4) < 0.5, np.nan, rng.uniform(1.2, 2.1, 4))
    settings = Settings(reward=rng.uniform(0, 0.3), penalty=rng.uniform(0, 0.3), tolerance=rng.uniform(0.05, 0.5))
    for one, other in zip(
        judged(p, sure, settings, known), judged_numpy(*clean(p, sure), known, settings), strict=True
    ):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_rewards_without_a_height_are_none():
    p = figure()[None]
    added, bones = rewards(p, np.array([np.nan]), MINE)
    assert (added == 0).all() and bones.tolist() == [len(SEGMENTS)]


def test_nobody_is_judged_without_harm():
    found = evaluate(np.zeros((0, 16, 3)), np.zeros((0, 16)), Settings())
    assert found.p.shape == (0, 16, 3) and found.kept.shape == (0,) and found.reason == ()


def test_one_without_a_keypoint_is_nobody():
    found = evaluate(np.full((1, 16, 3), np.nan), np.ones((1, 16)), Settings())
    assert found.reason == ("no keypoint",) and not found.kept.any() and np.isnan(found.root).all()


@given(hnp.arrays(float, (3, 16, 3), elements=ANY), hnp.arrays(float, (3, 16), elements=ANY))
@tried(max_examples=100)
def test_whatever_comes_is_judged_and_not_changed(p, sure):
    before = p.copy(), sure.copy()
    found = evaluate(p, sure, Settings())
    np.testing.assert_array_equal(p, before[0])
    np.testing.assert_array_equal(sure, before[1])
    assert np.isfinite(found.confidence).all() and np.isfinite(found.reward).all()
    assert found.confidence.min() >= 0.0 and found.confidence.max() <= 1.0
    assert ((found.confidence > 0) <= np.isfinite(found.p).all(axis=-1)).all()
    assert not (found.kept & np.isnan(found.root).any(axis=-1)).any()
    assert all(bool(reason) != kept for reason, kept in zip(found.reason, found.kept, strict=True))
