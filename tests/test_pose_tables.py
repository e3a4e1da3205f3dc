"""Claims about the tables of the hand thesis, section 3.2: every reproducible value, and the errata."""

import json
import math

import numpy as np
import pytest

from handtrack.reproduce.chains import p_chain, pr_chain, r_chain, rr_chain
from handtrack.reproduce.pose_tables import as_json, as_text, pose_tables
from handtrack.solve import solve

TABLES = {table.name: table for table in pose_tables()}
PROBLEMS = {"r": r_chain, "p": p_chain, "pr": pr_chain, "rr": rr_chain}
FAR = np.radians([30.0, -60.0])

# Every value that Gauss-Newton reproduces to the printed decimals: table, iterate, joint values and cost (None: the
# cost of that row is not claimed).
REPRODUCED = [
    ("3.1", 0, (2.0944,), 4.9744),
    ("3.1", 1, (1.5727,), 0.0001),
    ("3.1", 2, (1.5708,), 0.0),
    ("3.1", 3, (1.5708,), 0.0),
    ("3.1", 4, (1.5708,), 0.0),
    ("3.2", 0, (1.0,), 1.5),
    ("3.2", 1, (0.0,), 0.0),
    ("3.2", 2, (0.0,), 0.0),
    ("3.3", 0, (2.0, 1.0472), 43.9103),
    ("3.3", 1, (6.8490, 0.4321), 2.1344),
    ("3.3", 2, (5.1707, 0.0480), 0.7339),
    ("3.3", 5, (2.9998, -0.5237), None),
    ("3.3", 7, (3.0, -0.5236), 0.0),
    ("3.4", 0, (-0.7330, -1.7802), 5.2081),
    ("3.4", 6, (-1.0472, -2.0944), 0.0),
    ("3.5", 0, (0.5236, -1.0472), 109.3510),
    ("3.5", 1, (1.2304, -4.4211), 131.2587),
    ("3.6", 0, (0.5236, -1.0472), 109.3510),
    ("3.6", 1, (0.5943, -1.3846), 93.2694),
    ("3.6", 97, (-1.0471, -2.0944), 0.0),
]


@pytest.mark.parametrize(("name", "k", "q", "cost"), REPRODUCED)
def test_each_reproduced_value_agrees_to_the_printed_decimals(name, k, q, cost):
    row = next(row for row in TABLES[name].rows if row.k == k)
    np.testing.assert_array_equal(np.round(row.ours[:-1], 4) + 0.0, q)
    np.testing.assert_array_equal(row.printed[:-1], q)
    assert row.expected[:-1].all()
    assert row.agrees[:-1].all()
    if cost is not None:
        assert round(row.ours[-1], 4) == cost == row.printed[-1]
        assert row.expected[-1]


def test_a_table_is_reproduced_when_all_its_expected_values_agree():
    assert all(table.reproduced for table in TABLES.values())
    assert list(TABLES) == ["3.1", "3.2", "3.3", "3.4", "3.5", "3.6"]


def test_values_that_are_not_expected_really_disagree_somewhere():
    # A flag that hides a value which does agree would be as wrong as a claim that fails.
    for table in TABLES.values():
        for row in table.rows:
            if not row.expected.all():
                assert not row.agrees[~row.expected].all(), (table.name, row.k)


@pytest.mark.parametrize("name", PROBLEMS)
def test_chain_jacobians_match_central_differences(name):
    problem = PROBLEMS[name]()
    rng = np.random.default_rng(0)
    for _ in range(5):
        q = rng.uniform(-3, 3, len(problem.model.joint_names))
        step = 1e-6
        numeric = np.stack(
            [(problem(q + step * e)[0] - problem(q - step * e)[0]) / (2 * step) for e in np.eye(q.size)], axis=1
        )
        np.testing.assert_allclose(problem(q)[1], numeric, atol=1e-8)


@pytest.mark.parametrize(
    ("name", "ideal"), [(table.chain.split(",")[0].lower(), table.ideal) for table in TABLES.values()]
)
def test_the_ideal_pose_leaves_no_residual(name, ideal):
    np.testing.assert_allclose(PROBLEMS[name]()(ideal)[0], 0.0, atol=1e-12)


def test_the_chains_project_as_the_thesis_writes_them():
    # Projections of sections 3.2.1-3.2.4, {0} at p0; the cosine in PR is the corrected one.
    theta, d = 0.7, 1.3
    np.testing.assert_allclose(r_chain()(np.array([theta]))[0][:2], [5 * math.cos(theta), 5 * math.sin(theta) - 5])
    np.testing.assert_allclose(p_chain()(np.array([d]))[0], [d, 0, d, d], atol=1e-12)
    slide = pr_chain()
    expected = np.array([d - 5 * math.sin(theta), 5 * math.cos(theta)]) - slide.tip
    np.testing.assert_allclose(slide(np.array([d, theta]))[0][:2], expected, atol=1e-12)
    arm = rr_chain()
    both = theta + d
    tip = np.array([-5 * math.sin(both) - 5 * math.sin(theta) + 3, 5 * math.cos(both) + 5 * math.cos(theta)])
    np.testing.assert_allclose(arm(np.array([theta, d]))[0][:2], tip - arm.tip, atol=1e-12)


def test_the_correct_step_of_table_3_4_is_not_the_printed_one():
    row = TABLES["3.4"].rows[1]
    assert not row.agrees.any()
    np.testing.assert_allclose(row.ours, [-0.9280, -2.1949, 0.3228], atol=5e-5)
    assert row.ours[-1] < 0.5 * row.printed[-1]


def test_the_number_of_steps_is_that_of_a_correct_gauss_newton():
    assert [TABLES[name].steps for name in ("3.4", "3.5")] == [5, 12]
    assert {table.status for table in TABLES.values()} == {"converged"}


def test_the_start_of_table_3_5_reaches_the_ideal_pose_after_all():
    table = TABLES["3.5"]
    assert table.rows[1].ours[-1] > table.rows[0].ours[-1]
    np.testing.assert_allclose(table.rows[-1].ours[:-1], table.ideal, atol=1e-4)


def test_the_printed_end_of_table_3_5_is_no_minimum():
    residual, jacobian = rr_chain()(TABLES["3.5"].rows[-1].printed[:-1])
    slope = jacobian.T @ residual
    assert abs(slope[0]) < 0.01
    assert slope[1] == pytest.approx(-2.04, abs=0.005)
    cost = [0.5 * (rr_chain()(np.array([3.3974, -4.5082 + step]))[0] ** 2).sum() for step in (-1e-5, 1e-5)]
    assert slope[1] == pytest.approx((cost[1] - cost[0]) / 2e-5, abs=1e-4)


def test_the_cost_printed_at_step_5_of_table_3_3_is_that_of_step_4():
    path = solve(pr_chain(), np.array([2.0, math.radians(60)]), method="gauss-newton", trace=True)
    assert round(path.trace_cost[4], 4) == 0.0005
    assert path.trace_cost[5] < 5e-5


@pytest.mark.parametrize("method", ["levenberg-marquardt", "trust-region"])
def test_the_lesson_of_the_tables_holds_for_methods_that_judge_their_steps(method):
    path = solve(rr_chain(), FAR, method=method, trace=True)
    assert path.status == "converged"
    assert (np.diff(path.trace_cost) < 1e-12).all()
    np.testing.assert_allclose(path.x, TABLES["3.5"].ideal, atol=1e-8)


def test_text_shows_both_values_and_tells_the_errata():
    text = as_text(pose_tables())
    assert "Table 3.3: chain PR, Gauss-Newton stops at step 7, reproduced" in text
    assert "43.9103 =  43.9103" in text
    assert "-0.9280 ~  -0.8616" in text
    assert "leads to a pose which is not the ideal one. It does not" in " ".join(text.split())
    assert "p0y + P s(theta2)" in text
    assert "-0.0000" not in text
    assert max(map(len, text.splitlines())) <= 120


def test_text_says_so_where_a_value_fails():
    from dataclasses import replace

    table = TABLES["3.2"]
    broken = replace(table, rows=(replace(table.rows[0], ours=table.rows[0].ours + 1.0), *table.rows[1:]))
    text = as_text((broken,))
    assert "NOT REPRODUCED" in text
    assert "2.0000 x   1.0000" in text


def test_json_holds_the_same_tables():
    tables = json.loads(as_json(pose_tables()))
    assert [table["name"] for table in tables] == list(TABLES)
    assert all(table["reproduced"] for table in tables)
    row = tables[4]["rows"][1]
    assert row["printed"] == [1.2304, -4.4211, 131.2587]
    np.testing.assert_allclose(row["ours"], row["printed"], atol=5e-5)
    assert row["agrees"] == [True, True, True]
    assert tables[4]["errata"]
