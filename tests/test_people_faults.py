"""What the released code of the people paper gets wrong, and this one must not; each fault by its name."""

from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.body.people import Settings, begin, follow, step
from handtrack.body.people_metrics import labels_of, switches
from handtrack.body.spatial import evaluate, judged_numpy
from handtrack.formats.people import LOST
from handtrack.formats.skeletons import KEYPOINTS
from synth.people_tasks import TaskSettings, crossing, make_task

MODES: tuple[Literal["paper", "robust"], ...] = ("paper", "robust")
BODY = np.array(
    [[0.2, 0.0, 0.0], [-0.2, 0.0, 0.0], [0.2, 0.32, 0.0], [-0.2, 0.32, 0.0], [0.2, 0.57, 0.0], [-0.2, 0.57, 0.0],
     [0.1, 0.5, 0.0], [-0.1, 0.5, 0.0], [0.1, 0.93, 0.0], [-0.1, 0.93, 0.0], [0.1, 1.36, 0.0], [-0.1, 1.36, 0.0]]
)  # fmt: skip


def person(x: float, scale: float = 1.0, z: float = 2.2) -> np.ndarray:
    p = np.full((16, 3), np.nan)
    p[:12] = scale * BODY + np.array([x, -0.4, z])
    return p


def run(frames, mode: Literal["paper", "robust"]):
    """Results of frames, each a list of (skeleton, confidence)."""
    state, rng, found = begin(Settings(mode=mode, skin=0.0)), np.random.default_rng(1), []
    for n, people in enumerate(frames):
        p = np.array([one for one, _ in people]).reshape(-1, 16, 3)
        c = np.array([np.broadcast_to(sure, 16) for _, sure in people], dtype=float).reshape(-1, 16)
        state, frame = step(state, n / 30.0, p, c, rng)
        found.append(frame)
    return found


@pytest.mark.parametrize("mode", MODES)
def test_fault_one_of_two_people_is_lost_when_detections_come_permuted(mode):
    rng = np.random.default_rng(4)
    pair = [(person(-0.6), 0.65), (person(0.7, 0.9), 0.65)]
    found = run([[pair[i] for i in rng.permutation(2)] for _ in range(60)], mode)
    for frame in found[10:]:
        assert frame.person.tolist() == [0, 1] or frame.person.tolist() == found[10].person.tolist()
        assert frame.person.size == 2
    x = np.array([frame.p[:, 12, 0] for frame in found[10:]])
    assert np.ptp(x, axis=0).max() < 0.1


@pytest.mark.parametrize("mode", MODES)
def test_fault_a_stranger_inherits_a_label(mode):
    """One leaves; somebody of another height comes in elsewhere, after the other is given up, and before."""
    for pause in (10, 90):
        frames = [[(person(-0.7, 1.0), 0.65)]] * 40 + [[]] * pause + [[(person(0.8, 0.82), 0.65)]] * 60
        found = run(frames, mode)
        assert found[30].person.tolist() == [0]
        for frame in found[-20:]:
            assert frame.person[frame.p[:, 12, 0] > 0.4].tolist() == [1]


def test_fault_a_missing_bone_counts_as_a_wrong_one():
    whole, part = person(0.0), person(0.0)
    part[[4, 8]] = np.nan
    found = evaluate(np.stack([whole, part]), np.full((2, 16), 0.5), Settings())
    both = ~np.isnan(part[:12, 0])
    assert (found.confidence[1, :12][both] >= 0.5).all()
    assert found.confidence[1, 2] == pytest.approx(0.6)  # one right bone of the two that an elbow has
    assert found.confidence[0, 2] == pytest.approx(0.7)
    assert found.confidence[1, 4] == 0.0


@pytest.mark.parametrize("mode", MODES)
def test_fault_the_filter_is_skipped_when_the_confidence_is_zero(mode):
    """A keypoint of confidence 0 is predicted, and so is one that is absent: the same way."""
    zero, absent = np.full(16, 0.65), person(0.0)
    zero[4] = 0.0
    absent[4] = np.nan
    wrong = person(0.0)
    wrong[4] = 5.0, 5.0, 5.0
    start = [[(person(0.0), 0.65)]] * 30
    results = [run([*start, *[[(p, c)]] * 10], mode) for p, c in ((wrong, zero), (absent, np.full(16, 0.65)))]
    for frame in (results[0][-1], results[1][-1]):
        assert frame.person.size == 1
        assert frame.status[0, 4] == 1
        assert np.linalg.norm(frame.p[0, 4] - person(0.0)[4]) < 0.1
    np.testing.assert_array_equal(results[0][-1].p, results[1][-1].p)


@pytest.mark.parametrize("mode", MODES)
def test_fault_the_filter_hangs_on_nan(mode):
    rng = np.random.default_rng(2)
    frames = []
    for n in range(50):
        p, c = person(0.01 * n), np.full(16, 0.65)
        if n > 20:
            p[rng.random(16) < 0.4, rng.integers(3)] = rng.choice([np.nan, np.inf, -np.inf])
            c[rng.random(16) < 0.2] = np.nan
        frames.append([(p, c), (np.full((16, 3), np.nan), 0.5)])
    found = run(frames, mode)
    assert all(frame.person.tolist() == [0] for frame in found[10:])
    assert np.isfinite(found[-1].p[0, :12]).all()
    assert np.isfinite(found[-1].covariance[0, :12]).all()


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_whatever_comes_in_every_output_has_a_status_and_is_finite_or_lost(data):
    mode = data.draw(st.sampled_from(MODES))
    seed, count = data.draw(st.integers(0, 2**31)), data.draw(st.integers(1, 4))
    rng = np.random.default_rng(seed)
    state = begin(Settings(mode=mode, confirm=1, particles=20))
    wild = np.array([np.nan, np.inf, -np.inf, 0.0, 1e12, -1e-300])
    for n in range(12):
        p = np.stack(
            [person(rng.normal(0, 1), rng.uniform(0.3, 2)) for _ in range(rng.integers(0, count + 1))] or [person(0)]
        )
        c = rng.uniform(-0.5, 1.5, p.shape[:2])
        bad = rng.random(p.shape) < data.draw(st.sampled_from([0.0, 0.02, 0.3]))
        p[bad] = rng.choice(wild, bad.sum())
        state, frame = step(state, 0.03 * (n + 1), p, c, rng)
        known = frame.status != LOST
        assert np.isfinite(frame.p[known]).all() and np.isfinite(frame.covariance[known]).all()
        assert np.isnan(frame.p[~known]).all()
        assert np.unique(frame.person).size == frame.person.size
        values = np.linalg.eigvalsh(frame.covariance[known])
        assert (values > -1e-9 * np.abs(values).max(initial=1.0)).all()


def test_order_of_detections_does_not_matter():
    task = make_task("T1", 3, TaskSettings(frames=60))
    d, rng = task.detections, np.random.default_rng(0)
    results = []
    for shuffled in (False, True):
        state, out = begin(Settings()), []
        for n, time in enumerate(d.time.tolist()):
            rows = np.flatnonzero(d.frame == n)
            rows = rng.permutation(rows) if shuffled else rows
            state, frame = step(state, time, d.p[rows], d.confidence[rows], np.random.default_rng(1))
            out.append(frame)
        results.append(out)
    for a, b in zip(*results, strict=True):
        assert np.array_equal(np.sort(a.height.round(9)), np.sort(b.height.round(9)))
        assert a.person.size == b.person.size


@pytest.mark.parametrize("kind", ["permuted", "crossing", "entering", "re-entering"])
def test_nobody_changes_identity(kind):
    for seed in (1, 2):
        task = crossing(seed, kind)
        assert switches(labels_of(follow(task.detections, Settings(), 1), task.truth)).sum() == 0


def test_one_call_for_each_frame_gives_what_the_recording_gives():
    task = make_task("T3", 2, TaskSettings(frames=90))
    d, state, rng = task.detections, begin(Settings()), np.random.default_rng(5)
    people = follow(d, Settings(), 5)
    for n, time in enumerate(d.time.tolist()):
        state, frame = step(state, time, d.p[d.frame == n], d.confidence[d.frame == n], rng)
        here = (people.frame == n) & np.isin(people.person, frame.person)
        np.testing.assert_array_equal(people.p[here], frame.p)
        np.testing.assert_array_equal(people.covariance[here], frame.covariance)


def test_nobody_beyond_the_distance_and_no_gap_without_status():
    task = make_task("T2", 5, TaskSettings(frames=150))
    people = follow(task.detections, Settings(distance=2.6), 1)
    trunk = np.linalg.norm(np.nanmean(people.p[:, [0, 1, 6, 7]], axis=1), axis=-1)
    assert np.nanmax(trunk) <= 2.6 + 1e-9
    for label in np.unique(people.person):
        frames = people.frame[people.person == label]
        np.testing.assert_array_equal(np.diff(frames), 1)
    assert np.isin(people.status, (0, 1, 2)).all()


@pytest.mark.parametrize("seed", range(3))
def test_the_compiled_judgement_does_what_its_twin_does(seed):
    rng = np.random.default_rng(seed)
    p = np.stack([person(0.0, scale) for scale in rng.uniform(0.4, 1.5, 40)])
    p[:, :12] += rng.normal(0.0, 0.08, (40, 12, 3))
    p[rng.random((40, 16)) < 0.3] = np.nan
    swapped = rng.random(40) < 0.4
    p[swapped, 4], p[swapped, 5] = p[swapped, 5], p[swapped, 4]
    c = np.where(np.isnan(p[..., 0]), 0.0, rng.uniform(0.1, 1.0, (40, 16)))
    known = np.where(rng.random(40) < 0.3, 1.8, np.nan)
    found = evaluate(p, c, Settings(), known)
    plain = judged_numpy(p, c, known, Settings())
    np.testing.assert_allclose(found.p, plain[0], atol=1e-12)
    np.testing.assert_allclose(found.height, plain[2], atol=1e-12)
    seen = plain[1] > 0
    np.testing.assert_allclose(found.confidence[seen], np.clip(plain[1] + plain[3], 0, 1)[seen], atol=1e-12)
    assert len(KEYPOINTS) == found.p.shape[1]
