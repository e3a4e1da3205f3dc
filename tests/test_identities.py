"""Claims about who is who: the cost, the cheapest assignment, gates, who is new, who comes back, exchanged sides."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_people import figure

from handtrack.body.identities import (
    FAR,
    SAME_HEIGHT,
    SWAP_MARGIN,
    TWIN,
    WIDEST,
    Costs,
    assigned,
    costs,
    gates,
    newcomers,
    returned,
    undone_swaps,
)
from handtrack.body.people_settings import Settings

PAPER, ROBUST = Settings(mode="paper"), Settings()


def people(rng: np.random.Generator, q: int, holes: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    p = rng.normal(0.0, 0.4, (q, 12, 3))
    p[rng.random((q, 12)) < holes] = np.nan
    return p, np.where(np.isnan(p[..., 0]), 0.0, rng.random((q, 12)))


@given(st.integers(0, 9999), st.integers(0, 4), st.integers(0, 4), st.sampled_from(["paper", "robust"]))
def test_costs_are_those_of_the_paper_pair_by_pair(seed, q, m, mode):
    """People paper, II-B: means over common keypoints, the highest element elsewhere, D + C + u(D + C - delta)."""
    rng = np.random.default_rng(seed)
    (p, c), (z, sure) = people(rng, q, 0.6), people(rng, m, 0.6)
    settings = Settings(mode=mode, delta=float(rng.uniform(0.1, 1.5)))
    found = costs(p, c, z, sure, settings)
    d, e = np.full((q, m), np.nan), np.full((q, m), np.nan)
    for i in range(q):
        for j in range(m):
            common = [k for k in range(12) if not np.isnan(p[i, k, 0] + z[j, k, 0])]
            if common:
                apart = [np.linalg.norm(p[i, k] - z[j, k]) for k in common]
                d[i, j] = np.mean(apart if mode == "paper" else np.minimum(apart, FAR))
                e[i, j] = np.mean([abs(c[i, k] - sure[j, k]) for k in common])
    empty = np.isnan(d)
    np.testing.assert_array_equal(np.isinf(found.distance), empty)
    np.testing.assert_allclose(found.distance[~empty], d[~empty])
    np.testing.assert_allclose(found.confidence[~empty], e[~empty])
    d[empty], e[empty] = (0.0, 0.0) if empty.all() else (np.nanmax(d), np.nanmax(e))
    m_of = d + e + np.where(d + e > settings.delta, 1.0, 0.0)
    np.testing.assert_allclose(found.total, m_of)


@pytest.mark.parametrize(("off", "total"), [(0.2, 0.4), (0.29, 0.49), (0.31, 1.51), (0.6, 1.8)])
def test_the_step_adds_one_beyond_delta(off, total):
    one, c = np.zeros((1, 12, 3)), np.full((1, 12), 0.7)
    found = costs(one, c, one + np.array([0.0, off, 0.0]), c - 0.2, PAPER)
    assert found.total[0, 0] == pytest.approx(total)


def test_one_keypoint_on_the_wall_counts_fully_only_for_the_paper():
    one, c = np.zeros((1, 12, 3)), np.ones((1, 12))
    other = one.copy()
    other[0, 4] = 0.0, 0.0, 6.0
    assert costs(one, c, other, c, PAPER).distance[0, 0] == pytest.approx(6.0 / 12)
    assert costs(one, c, other, c, ROBUST).distance[0, 0] == pytest.approx(FAR / 12)
    assert costs(one, c, other, c, ROBUST, np.array([2.0])).distance[0, 0] == pytest.approx(2.0 / 12)


@given(st.integers(0, 9999))
def test_costs_follow_the_order_of_people_and_skeletons(seed):
    rng = np.random.default_rng(seed)
    (p, c), (z, sure) = people(rng, 3), people(rng, 4)
    rows, columns = rng.permutation(3), rng.permutation(4)
    a, b = costs(p, c, z, sure, ROBUST), costs(p[rows], c[rows], z[columns], sure[columns], ROBUST)
    np.testing.assert_array_equal(a.total[np.ix_(rows, columns)], b.total)
    np.testing.assert_array_equal(a.distance[np.ix_(rows, columns)], b.distance)


@given(st.integers(0, 9999), st.integers(1, 5), st.integers(1, 5))
def test_assignments_are_the_cheapest_of_all(seed, q, m):
    """All people, or all skeletons, get one; no other way costs less."""
    total = np.random.default_rng(seed).uniform(0.0, 3.0, (q, m))
    who, which, cost = assigned(Costs(total, 0.0 * total, total), np.full(q, 9.0))
    assert who.size == which.size == min(q, m) == np.unique(who).size == np.unique(which).size
    np.testing.assert_array_equal(cost, total[who, which])
    wide = total if q <= m else total.T
    best = min(sum(wide[i, j] for i, j in enumerate(way)) for way in permutations(range(wide.shape[1]), wide.shape[0]))
    assert cost.sum() == pytest.approx(best)


@given(st.integers(0, 9999), st.integers(0, 4), st.integers(0, 4))
def test_nobody_is_assigned_beyond_his_gate_and_as_many_as_can_be_are(seed, q, m):
    rng = np.random.default_rng(seed)
    d, gate = rng.uniform(0.0, 1.0, (q, m)), rng.uniform(0.0, 1.0, q)
    who, which, _ = assigned(Costs(d, 0.0 * d, d), gate)
    assert (d[who, which] <= gate[who]).all()
    within = d <= gate[:, None]
    most = max(
        (
            sum(within[i, j] for i, j in zip(range(q), way, strict=False) if j < m)
            for way in permutations(range(m + q), q)
        ),
        default=0,
    )
    assert who.size == most


def test_those_who_have_nothing_in_common_are_not_assigned():
    p, c = np.full((1, 12, 3), np.nan), np.zeros((1, 12))
    z = p.copy()
    p[0, :6], z[0, 6:] = 0.0, 0.0
    who, _, _ = assigned(costs(p, c, z, c, ROBUST), np.ones(1))
    assert who.size == 0


def test_gates_widen_while_somebody_is_unseen_but_not_for_ever():
    found = gates(np.array([0.0, 0.3, 1.0, 100.0]), ROBUST)
    assert found.tolist() == [ROBUST.gate, pytest.approx(ROBUST.gate + 0.3), WIDEST, WIDEST]
    assert gates(np.array([5.0]), Settings(gate=4.0)).tolist() == [4.0]


def test_newcomers_are_free_whole_enough_and_no_twins():
    d = np.array([[0.0, 0.5 * TWIN, 2.0, 3.0, 3.0]])
    found = Costs(d, 0.0 * d, d)
    enough = np.array([True, True, True, False, True])
    assert newcomers(found, np.array([0]), np.array([True]), enough).tolist() == [2, 4]
    assert newcomers(found, np.array([0]), np.array([False]), enough).tolist() == [1, 2, 4]  # he has no label yet


def test_who_comes_back_is_known_by_his_height_and_by_how_far_he_can_have_walked():
    heights, here = np.array([1.60, 1.80]), np.zeros((2, 3))
    assert returned(1.63, np.zeros(3), heights, here, np.full(2, 5.0)) == 0
    assert returned(1.77, np.zeros(3), heights, here, np.full(2, 5.0)) == 1
    assert returned(1.81 + SAME_HEIGHT, np.zeros(3), heights, here, np.full(2, 5.0)) == -1
    assert returned(1.8, np.array([9.0, 0.0, 0.0]), heights, here, np.full(2, 0.5)) == -1
    assert returned(1.8, np.array([9.0, 0.0, 0.0]), heights, here, np.full(2, 5.0)) == 1
    assert returned(np.nan, np.zeros(3), heights, here, np.full(2, 5.0)) == -1
    assert returned(1.7, np.zeros(3), np.zeros(0), np.zeros((0, 3)), np.zeros(0)) == -1
    assert returned(1.7, np.zeros(3), np.array([np.nan]), np.zeros((1, 3)), np.ones(1)) == -1


@pytest.mark.parametrize("pairs", [(0,), (2,), (4,), (2, 4), (0, 2, 4, 6, 8, 10)])
def test_exchanged_sides_are_put_back_where_people_are_expected(pairs):
    rng = np.random.default_rng(4)
    expected = figure()[None, :12]
    p = expected + rng.normal(0.0, 0.02, (1, 12, 3))
    sure = rng.random((1, 12, 2))
    wrong, wrong_sure = p.copy(), sure.copy()
    for k in pairs:
        wrong[:, [k, k + 1]], wrong_sure[:, [k, k + 1]] = p[:, [k + 1, k]], sure[:, [k + 1, k]]
    found, found_sure = undone_swaps(expected, wrong, wrong_sure)
    np.testing.assert_array_equal(found, p)
    np.testing.assert_array_equal(found_sure, sure)


def test_sides_stay_where_nothing_is_expected_or_one_of_them_is_missing_or_it_is_not_clear():
    p = figure()[None, :12]
    sure = np.full((1, 12, 2), 0.5)
    for expected in (np.full_like(p, np.nan), p):
        np.testing.assert_array_equal(undone_swaps(expected, p, sure)[0], p)
    one = p.copy()
    one[0, 4] = np.nan
    exchanged = one[:, np.arange(12) ^ 1]
    np.testing.assert_array_equal(undone_swaps(p, exchanged, sure)[0][0, 4:6], exchanged[0, 4:6])
    near = p.copy()
    near[0, 4], near[0, 5] = (0.4 * SWAP_MARGIN, 0.2, 2.0), (-0.4 * SWAP_MARGIN, 0.2, 2.0)
    exchanged = near[:, np.arange(12) ^ 1]
    np.testing.assert_array_equal(undone_swaps(near, exchanged, sure)[0][0, 4:6], exchanged[0, 4:6])
