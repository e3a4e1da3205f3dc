"""Claims about the figures of people: the paper's three, who is who, and whether the ellipsoids are honest."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handtrack.body.people_metrics import (
    QUANTILE_95,
    accuracy,
    course_of,
    held,
    honesty,
    labels_of,
    main_labels,
    second_difference,
    squares,
    switches,
)
from handtrack.formats.people import LOST, PREDICTED, SEEN, People
from handtrack.formats.skeletons import TruthPoints
from handtrack.report.people_facts import facts_of

F = 20
BODY = np.random.default_rng(5).normal(scale=0.3, size=(16, 3))


def truth_of(centres):
    """True people about these places (f, persons, 3)."""
    return TruthPoints(np.asarray(centres, float)[:, :, None] + BODY)


def people_of(labels, centres, sd=0.01, status=None):
    """Entries with these labels (f, persons) about the same places; label -1 is absent."""
    labels, centres = np.asarray(labels), np.asarray(centres, float)
    order = np.argsort(np.where(labels < 0, 10**6, labels), axis=1, kind="stable")
    frame, at = np.nonzero(np.take_along_axis(labels, order, 1) >= 0)
    who = order[frame, at]
    d = frame.size
    return People(
        time=np.arange(labels.shape[0]) / 30, frame=frame, person=labels[frame, who],
        p=centres[frame, who][:, None] + BODY, confidence=np.ones((d, 16)),
        covariance=np.tile(sd**2 * np.eye(3), (d, 16, 1, 1)),
        status=np.zeros((d, 16), np.int8) if status is None else np.full((d, 16), status, np.int8),
    )  # fmt: skip


def two(f=F, apart=1.0):
    out = np.zeros((f, 2, 3))
    out[:, 1, 0] = apart
    out[:, :, 2] = 2.0
    return out


def test_mae_std_and_acc_are_those_of_the_paper():
    """By hand: distances 3, 4, 5 mm; second differences of the error are 0."""
    truth = np.zeros((3, 3))
    p = np.array([[0.003, 0, 0], [0.004, 0, 0], [0.005, 0, 0]])
    found = accuracy(np.arange(3) / 10, p, truth)
    assert found.mae == pytest.approx(0.004) and found.std == pytest.approx(np.sqrt(2 / 3) * 1e-3)
    assert found.acc == pytest.approx(0.0, abs=1e-9) and found.frames == 3 and found.present == 1.0
    p[1, 0] = 0.014
    assert accuracy(np.arange(3) / 10, p, truth).acc == pytest.approx(2 * 0.01 * 100)


@given(st.integers(3, 30), st.floats(0.2, 5.0), st.floats(-3.0, 3.0))
def test_acc_of_a_parabola_is_its_acceleration_at_any_steps(count, scale, a):
    time = np.cumsum(np.random.default_rng(count).uniform(0.01, 0.1, count)) * scale
    p = np.column_stack([0.5 * a * time**2, time, 1.0 + 0 * time])
    assert np.allclose(second_difference(time, p), [a, 0.0, 0.0], atol=1e-6)
    assert accuracy(time, p, p * [0, 1, 1]).acc == pytest.approx(abs(a), abs=1e-6)


def test_where_nothing_is_put_out_the_last_place_counts():
    p, truth = np.zeros((4, 3)), np.zeros((4, 3))
    truth[:, 0] = [0, 1, 2, 3]
    p[:, 0] = [np.nan, 1, np.nan, np.nan]
    found = accuracy(np.arange(4.0), p, truth)
    assert found.mae == pytest.approx(1.0) and found.frames == 3 and found.present == 0.25
    assert held(np.full((0, 3), np.nan)).shape == (0, 3)


def test_without_truth_or_output_there_are_no_figures():
    nothing = np.full((5, 3), np.nan)
    found = accuracy(np.arange(5.0), nothing, np.zeros((5, 3)))
    assert np.isnan([found.mae, found.std, found.acc]).all() and found.present == 0.0 and found.frames == 0
    assert np.isnan(accuracy(np.arange(2.0), nothing[:2], nothing[:2]).present)


def test_labels_are_found_whatever_they_are_called():
    labels = labels_of(people_of(np.tile([7, 3], (F, 1)), two()), truth_of(two()))
    assert (labels == [7, 3]).all() and switches(labels).tolist() == [0, 0] and main_labels(labels).tolist() == [7, 3]


def test_a_swap_is_a_switch_of_both_and_a_new_label_of_one():
    names = np.tile([1, 2], (F, 1))
    names[10:] = [2, 1]
    assert switches(labels_of(people_of(names, two()), truth_of(two()))).tolist() == [1, 1]
    names = np.tile([1, 2], (F, 1))
    names[8:12, 0], names[12:, 0] = -1, 5
    labels = labels_of(people_of(names, two()), truth_of(two()))
    assert switches(labels).tolist() == [1, 0] and (labels[8:12, 0] == -1).all()
    names[12:, 0] = 1
    assert switches(labels_of(people_of(names, two()), truth_of(two()))).tolist() == [0, 0]


def test_people_who_pass_through_each_other_keep_their_labels():
    """Nearer to the other than to oneself for some frames is no switch: a pair stays while it is within the gate."""
    centres = two()
    centres[:, 0, 0] = np.linspace(-1, 1, F)
    centres[:, 1, 0] = np.linspace(1, -1, F)
    shifted = centres.copy()
    shifted[8:12] = shifted[8:12, ::-1]
    labels = labels_of(people_of(np.tile([1, 2], (F, 1)), shifted), truth_of(centres))
    assert switches(labels).tolist() == [0, 0] and (labels == [1, 2]).all()


def test_who_is_beyond_the_gate_is_nobody():
    far = two()
    far[:, 0, 2] += 0.6
    labels = labels_of(people_of(np.tile([1, 2], (F, 1)), far), truth_of(two()))
    assert (labels[:, 0] == -1).all() and (labels[:, 1] == 2).all()
    assert main_labels(labels).tolist() == [-1, 2]
    assert (labels_of(people_of(np.tile([1, 2], (F, 1)), far), truth_of(two()), gate=0.7) == [1, 2]).all()


def test_a_truth_that_is_shorter_or_unknown_leaves_frames_without_labels():
    truth = two()
    truth[5, 1] = np.nan
    labels = labels_of(people_of(np.tile([1, 2], (F, 1)), two()), truth_of(truth[:12]))
    assert (labels[12:] == -1).all() and labels[5].tolist() == [1, -1] and switches(labels).tolist() == [0, 0]
    nobody = labels_of(people_of(np.full((F, 2), -1), two()), truth_of(two()))
    assert (nobody == -1).all() and main_labels(nobody).tolist() == [-1, -1]


def test_no_label_stands_for_two():
    labels = np.array([[1, -1]] * 5 + [[-1, 1]] * 9)
    assert main_labels(labels).tolist() == [-1, 1]


def test_a_course_has_a_row_for_every_frame():
    names = np.tile([1, 2], (F, 1))
    names[4:6, 1] = -1
    people = people_of(names, two())
    people.status[people.frame == 9] = LOST
    course = course_of(people, 2, 4)
    assert course.p.shape == (F, 3) and np.isnan(course.p[4:6]).all() and (course.status[4:6] == -1).all()
    assert np.isnan(course.p[9]).all() and course.status[9] == LOST and np.isfinite(course.covariance[10]).all()
    assert np.allclose(course.p[0], [1, 0, 2] + BODY[4]) and course.status[0] == SEEN


def test_squares_are_those_of_the_inverse_and_a_flat_covariance_does_not_fail():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(6, 3, 3))
    C, d = a @ np.swapaxes(a, 1, 2) + 0.1 * np.eye(3), rng.normal(size=(6, 3))
    want = [x @ np.linalg.inv(c) @ x for x, c in zip(d, C, strict=True)]
    assert np.allclose(squares(d, C, np.zeros((6, 3))), want)
    flat = squares(np.zeros((1, 3)), np.diag([1.0, 1.0, 0.0])[None], np.array([[0.0, 0.0, 0.01]]))
    assert flat[0] > 1e6
    assert np.isnan(squares(np.full((1, 3), np.nan), C[:1], d[:1]))


@pytest.mark.parametrize("status", [SEEN, PREDICTED])
def test_honest_gaussians_are_inside_in_95_per_cent(status):
    rng = np.random.default_rng(1)
    people = people_of(np.tile([1, 2], (400, 1)), two(400), sd=0.05, status=status)
    people.p[...] += 0.05 * rng.normal(size=people.p.shape)
    found = honesty(people, truth_of(two(400)), np.array([1, 2]))
    share, other = (found.seen, found.predicted) if status == SEEN else (found.predicted, found.seen)
    assert share == pytest.approx(0.95, abs=0.01) and np.isnan(other)
    assert max(found.seen_count, found.predicted_count) == 400 * 2 * 12
    assert pytest.approx(7.8147, abs=1e-4) == QUANTILE_95


def test_facts_hold_the_raw_skeletons_beside_the_estimate():
    people, raw = (people_of(np.tile([4, 9], (F, 1)), two()) for _ in range(2))
    raw.p[..., 0] += 0.1
    facts = facts_of(people, raw, truth_of(two()))
    data: dict[str, Any] = facts.as_data()
    assert data["people"] == 2 and data["identity_switches"] == 0 and data["mean_error_mm"] == 0.0
    assert data["raw_mean_error_mm"] == 100.0 and data["raw_left_wrist"][1] == {
        "label": 9, "mae_mm": 100.0, "std_mm": 0.0, "acc_m_s2": 0.0, "present": 1.0,
    }  # fmt: skip
    assert facts.truth is not None and facts.truth.raw_error is not None
    assert facts.truth.raw_error.shape == (F, 2, 16) and len(facts.sentences()) == 2


def test_facts_without_truth_count_what_was_seen_and_bridged():
    people = people_of(np.tile([4, -1], (F, 1)), two())
    people.status[5:11, 3] = PREDICTED
    people.status[12:, 4] = PREDICTED
    people.status[2:4, 5] = LOST
    facts = facts_of(people)
    assert facts.longest == pytest.approx(7 / 30)
    assert facts.shares == pytest.approx(((240 - 6 - 8 - 2) / 240, 14 / 240, 2 / 240))
    assert facts.truth is None and facts.as_data()["lost"] == round(2 / 240, 4) and len(facts.sentences()) == 1
    empty = facts_of(people_of(np.full((F, 2), -1), two()), None, truth_of(two()))
    assert empty.as_data()["mean_error_mm"] is None and len(empty.sentences()) == 1


def test_strangers_are_counted_only_where_somebody_true_is_known():
    centres = np.concatenate([two(), two()[:, :1] + [0, 0, 3.0]], axis=1)
    people = people_of(np.tile([1, 2, 8], (F, 1)), centres)
    truth = two()
    truth[15:] = np.nan
    assert facts_of(people, None, truth_of(truth)).as_data()["stranger_entries"] == 15
