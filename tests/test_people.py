"""Claims about people in view: labels that stay, gaps that are told, the gate, one call a frame.

Faults of the released code have tests of their own (`test_people_faults`), with all shapes checked; here they are
checked only now and then, for that takes four fifths of the time.
"""

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as tried
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from jaxtyping import config
from made_people import confidences, figure, recording

from handtrack.body.people import PeopleFrame, Settings, begin, follow, step
from handtrack.body.people_metrics import honesty, labels_of, main_labels, switches
from handtrack.body.people_output import BUILT
from handtrack.body.people_tracks import places
from handtrack.body.skin import WRIST
from handtrack.formats.people import LOST, PREDICTED, SEEN, People, people_text
from handtrack.formats.skeletons import Detections
from synth.people_tasks import CROSSINGS, TaskSettings, crossing, make_task

MODES = ("robust", "paper")
FPS = 30.0


@pytest.fixture(autouse=True)
def unchecked(monkeypatch):
    """Shapes are not checked."""
    monkeypatch.setattr(config, "jaxtyping_disable", True)


def plain(mode: Literal["robust", "paper"], **changed) -> Settings:
    """Settings for readings of joints, and for tests that are quick."""
    quick: dict[str, Any] = {"skin": 0.0, "particles": 40}
    return Settings(mode=mode, **quick | changed)


def shaken(p: np.ndarray, rng: np.random.Generator, sigma: float = 0.008) -> np.ndarray:
    return p + rng.normal(0.0, sigma, p.shape)


def two(rng: np.random.Generator) -> np.ndarray:
    """Two people who stand side by side, the smaller one on the left of the image."""
    return shaken(np.stack([figure(1.62, (-0.6, 0.0, 2.2)), figure(1.85, (0.6, 0.0, 2.3))]), rng)


def whole(people: People) -> None:
    """What every result promises: finite where seen or predicted, nothing where lost, no gap without a status."""
    there = people.status != LOST
    assert np.isfinite(people.p[there]).all() and np.isfinite(people.covariance[there]).all()
    assert np.isnan(people.p[~there]).all() and np.isnan(people.covariance[~there]).all()
    assert (people.confidence[people.status != SEEN] == 0).all()
    assert (np.linalg.eigvalsh(people.covariance[there]).min(initial=1.0, axis=-1) > -1e-9).all()
    for label in np.unique(people.person):
        frames = people.frame[people.person == label]
        np.testing.assert_array_equal(frames, np.arange(frames[0], frames[-1] + 1))
    key = people.frame * (people.person.max(initial=0) + 1) + people.person
    assert (np.diff(key) > 0).all()
    assert people_text(people).count("\n") == 16 * people.frame.size + 1


def near(people: People, truth: np.ndarray, label: int, within: float = 0.12) -> bool:
    """Whether a label is at a true person's place (16, 3) or (f, 16, 3) in all its frames that are not lost."""
    own = (people.person == label) & (people.status[:, 0] != LOST)
    goal = truth[people.frame[own]] if truth.ndim == 3 else truth
    off = places(people.p[own, :12]) - places(goal.reshape(-1, 16, 3)[:, :12])
    return bool(np.linalg.norm(off, axis=1).max() < within)


# Who is who.


@pytest.mark.parametrize("kind", CROSSINGS)
@pytest.mark.parametrize("seed", [101, 209])
def test_no_identity_is_switched(kind, seed):
    task = crossing(seed, kind)
    people = follow(task.detections, Settings())
    labels = labels_of(people, task.truth)
    assert switches(labels).tolist() == [0, 0]
    assert sorted(main_labels(labels)) == [0, 1] == np.unique(people.person).tolist()
    whole(people)


def test_the_order_of_detections_plays_no_part():
    """The same skeletons in another order in every frame: the same people, but for names of two who come at once."""
    rng = np.random.default_rng(5)
    frames = [two(rng) for _ in range(40)]
    for p in frames[10:]:
        p[rng.random((2, 16)) < 0.2] = np.nan
    a = follow(recording(frames), Settings())
    b = follow(recording([p[rng.permutation(2)] for p in frames]), Settings())
    assert a.frame.size == b.frame.size
    renamed = {}
    for label in (0, 1):
        mine = a.p[a.person == label]
        renamed[label] = next(other for other in (0, 1) if np.array_equal(mine, b.p[b.person == other], equal_nan=True))
    assert sorted(renamed.values()) == [0, 1]


@pytest.mark.parametrize("mode", MODES)
def test_somebody_gets_a_label_after_several_frames_and_a_glimpse_gets_none(mode):
    p = figure()[None]
    nobody = np.zeros((0, 16, 3))
    assert follow(recording([p] * 4 + [nobody] * 20), plain(mode)).frame.size == 0
    people = follow(recording([p] * 9), plain(mode))
    assert people.frame.tolist() == [4, 5, 6, 7, 8] and (people.person == 0).all()
    assert follow(recording([p] * 4), plain(mode, confirm=1)).frame.tolist() == [0, 1, 2, 3]


def test_one_who_is_unsure_needs_longer():
    p = figure()[None]
    people = follow(recording([p] * 60, [confidences(p, 0.3)] * 60), plain("robust"))
    assert people.frame.min() > 20


def test_too_few_keypoints_are_nobody():
    p = np.full((1, 16, 3), np.nan)
    p[0, [0, 2, 4]] = figure()[[0, 2, 4]]
    assert follow(recording([p] * 60), plain("robust")).frame.size == 0


def test_a_second_report_of_somebody_is_nobody_new():
    rng = np.random.default_rng(6)
    frames = [np.stack([shaken(figure(), rng), shaken(figure(), rng, 0.02)]) for _ in range(60)]
    people = follow(recording(frames), plain("robust"))
    late = people.frame > 10
    assert np.unique(people.person[late]).size <= 2  # both came at once
    frames = [p[:1] for p in frames[:20]] + frames[20:]
    assert np.unique(follow(recording(frames), plain("robust")).person).tolist() == [0]


@pytest.mark.parametrize("mode", MODES)
def test_somebody_is_predicted_until_the_time_out_and_then_gone(mode):
    rng = np.random.default_rng(7)
    frames = [shaken(figure()[None], rng) for _ in range(20)] + [np.zeros((0, 16, 3))] * 100
    people = follow(recording(frames), plain(mode, time_out=1.0))
    assert people.frame.max() == pytest.approx(19 + 30, abs=1)
    assert (people.status[people.frame >= 20] == PREDICTED).all()
    whole(people)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("off", [0.3, 1.2])
def test_one_who_is_hidden_and_steps_out_elsewhere_keeps_his_label(mode, off):
    """Farther than the gate of one who is seen: his gate stays open until his track has come to him."""
    rng = np.random.default_rng(17)
    there = figure(1.75, (off, 0.0, 2.2))
    frames = [shaken(figure(1.75, (0.0, 0.0, 2.0))[None], rng) for _ in range(40)] + [np.zeros((0, 16, 3))] * 45
    frames += [shaken(there[None], rng) for _ in range(60)]
    people = follow(recording(frames), plain(mode))
    assert np.unique(people.person).tolist() == [0] and (people.status[-1] == SEEN).all()
    assert np.linalg.norm(people.p[-1, :12] - there[:12], axis=1).max() < 0.2
    whole(people)


@pytest.mark.parametrize("seen", [9, 10, 11])
@pytest.mark.parametrize("hidden", [[0, 1], list(range(12))], ids=["shoulders", "all"])
def test_one_who_is_begun_anew_elsewhere_is_whole_whatever_of_him_is_seen_next(seen, hidden):
    rng = np.random.default_rng(18)
    there = figure(1.75, (0.5, 0.0, 2.3))
    frames = [shaken(figure()[None], rng) for _ in range(30)] + [shaken(there[None], rng) for _ in range(seen)]
    for _ in range(10):
        p = shaken(there[None], rng)
        p[0, hidden] = np.nan
        frames.append(p)
    people = follow(recording(frames), plain("robust"))
    assert np.unique(people.person).tolist() == [0] and people.frame[-1] == 30 + seen + 9
    whole(people)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("remember", "labels"), [(60.0, [0]), (1.0, [0, 1])])
def test_who_comes_back_has_his_label_as_long_as_he_is_remembered(mode, remember, labels):
    rng = np.random.default_rng(8)
    frames = [shaken(figure(1.7)[None], rng) for _ in range(40)] + [np.zeros((0, 16, 3))] * 100
    frames += [shaken(figure(1.7, (0.4, 0.0, 2.0))[None], rng) for _ in range(60)]
    people = follow(recording(frames), plain(mode, time_out=0.5, remember=remember))
    assert np.unique(people.person).tolist() == labels
    gone = (people.frame > 60) & (people.frame < 140) & (people.person == 0)
    assert (people.status[gone] == LOST).all() and gone.sum() == (79 if labels == [0] else 0)
    whole(people)


def test_labels_are_not_used_twice():
    rng = np.random.default_rng(9)
    frames = []
    for height in (1.55, 1.7, 1.85):
        frames += [shaken(figure(height)[None], rng) for _ in range(40)] + [np.zeros((0, 16, 3))] * 40
    people = follow(recording(frames), plain("robust", time_out=0.5))
    assert np.unique(people.person).tolist() == [0, 1, 2]
    assert [people.frame[people.person == i].min() // 80 for i in range(3)] == [0, 1, 2]


# Output.


@pytest.mark.parametrize("mode", MODES)
def test_a_keypoint_of_confidence_0_is_predicted_and_less_and_less_sure(mode):
    """A wrist of confidence 0, wherever it is said to be, is predicted, with a covariance that grows."""
    rng = np.random.default_rng(3)
    frames, sure = [], []
    for i in range(75):
        p = shaken(figure()[None], rng)
        c = confidences(p)
        if i >= 30:
            p[0, 4], c[0, 4] = (3.0, -2.0, 1.0), 0.0
        frames.append(p)
        sure.append(c)
    people = follow(recording(frames, sure), plain(mode))
    hidden = people.frame >= 30
    assert (people.status[hidden, 4] == PREDICTED).all() and (people.status[hidden, 5] == SEEN).all()
    assert np.linalg.norm(people.p[hidden, 4] - figure()[4], axis=1).max() < 0.35
    traces = np.trace(people.covariance[hidden, 4], axis1=1, axis2=2)
    assert traces[5] < traces[15] < traces[40] and traces[40] > 3 * traces[0]
    whole(people)


@pytest.mark.parametrize("mode", MODES)
def test_nobody_is_put_out_beyond_the_distance(mode):
    """One walks away, beyond the gate, and comes back; predictions do not leave it either."""
    rng = np.random.default_rng(10)
    z = np.concatenate([np.linspace(2.0, 3.6, 60), np.linspace(3.6, 2.0, 60)])
    frames = [shaken(figure(1.75, (0.0, 0.0, far))[None], rng) for far in z]
    people = follow(recording(frames), plain(mode))
    far = np.linalg.norm(places(people.p[:, :12]), axis=1)
    assert np.nanmax(far) <= 3.0 and (people.frame < 20).any() and (people.frame > 100).any()
    assert np.isnan(far[(people.frame > 50) & (people.frame < 70)]).all()
    assert np.unique(people.person).tolist() == [0]
    whole(people)


def test_a_keypoint_is_lost_after_the_longest_prediction():
    rng = np.random.default_rng(11)
    frames = [shaken(figure()[None], rng) for _ in range(80)]
    for p in frames[20:]:
        p[0, 4] = np.nan
    people = follow(recording(frames), plain("robust", longest=1.0))
    status = people.status[:, 4]
    assert (status[people.frame < 20] == SEEN).all()
    assert (status[(people.frame >= 20) & (people.frame < 50)] == PREDICTED).all()
    assert (status[people.frame >= 51] == LOST).all() and (people.status[people.frame >= 51, 2] == SEEN).all()
    whole(people)


def test_built_keypoints_are_as_the_others_say():
    rng = np.random.default_rng(12)
    frames = [shaken(figure()[None], rng) for _ in range(30)]
    for p in frames[15:]:
        p[0, 6] = np.nan
    people = follow(recording(frames), plain("robust"))
    np.testing.assert_allclose(people.p[:, 12:], BUILT @ people.p[:, :12], atol=1e-12)
    np.testing.assert_allclose(BUILT.sum(axis=1), 1.0)
    assert (people.status[people.frame >= 16][:, [12, 13, 15]] == PREDICTED).all()
    assert (people.status[people.frame >= 16][:, 14] == SEEN).all()
    np.testing.assert_allclose(people.covariance[:, 14], 0.25 * (people.covariance[:, 0] + people.covariance[:, 1]))
    assert people.p[-1, 15, 1] < people.p[-1, 14, 1] < people.p[-1, 12, 1] < people.p[-1, 13, 1]  # y is down


def test_limbs_keep_their_length_and_covariances_a_bound_while_hidden():
    rng = np.random.default_rng(13)
    frames = []
    for i in range(150):
        p = shaken(figure(1.75)[None], rng)
        p[0, 4] += 0.1 * np.sin(0.2 * i) * np.array([1.0, 0.0, 0.0])
        if i >= 40:
            p[0, [3, 4, 5, 10]] = np.nan
        frames.append(p)
    people = follow(recording(frames), plain("robust"))
    late = people.frame >= 40
    for near_end, far_end, share in ((1, 3, 0.186), (2, 4, 0.146), (3, 5, 0.146), (8, 10, 0.246)):
        long = np.linalg.norm(people.p[late, far_end] - people.p[late, near_end], axis=1)
        np.testing.assert_allclose(long, 1.75 * share, rtol=0.15)
    traces = np.trace(people.covariance[late], axis1=-2, axis2=-1)
    assert (traces[1:40, 4] > 0.98 * traces[:39, 4]).all() and traces[39, 4] > 5 * traces[0, 4]
    assert traces.max() < 0.35


def test_predictions_are_honest():
    """On a simulated task in which the wrist is hidden most of the time the truth is inside as often as is said."""
    task = make_task("T3", 31, TaskSettings(frames=300))
    people = follow(task.detections, Settings(skin=WRIST))
    labels = labels_of(people, task.truth)
    found = honesty(people, task.truth, main_labels(labels))
    assert switches(labels).tolist() == [0, 0] and found.predicted_count > 300
    assert 0.85 < found.predicted <= 1.0 and found.seen > 0.85
    whole(people)


def test_readings_of_the_skin_are_put_below_it():
    """A joint lies some 35 mm behind the skin of a wrist, along the ray; mode `paper` takes readings as they are."""
    frames = [figure()[None]] * 60
    deep = {skin: follow(recording(frames), Settings(skin=skin)).p[-1, 4] for skin in (0.0, None, WRIST)}
    ray = figure()[4] / np.linalg.norm(figure()[4])
    assert (deep[WRIST] - deep[0.0]) @ ray == pytest.approx(WRIST, abs=0.008)
    assert (deep[None] - deep[0.0]) @ ray == pytest.approx(0.5 * WRIST, abs=0.008)
    paper = [follow(recording(frames), Settings(mode="paper", skin=skin)).p for skin in (0.0, WRIST)]
    np.testing.assert_array_equal(paper[0], paper[1])


def test_doubt_about_the_skin_is_told_along_the_ray():
    frames = [figure()[None]] * 30
    told, untold = (follow(recording(frames), Settings(skin=skin)).covariance[-1, 6] for skin in (WRIST, None))
    assert np.trace(untold) > np.trace(told)


@pytest.mark.parametrize("mode", MODES)
def test_swapped_sides_are_followed_right(mode):
    """Now and then a network takes left for right; wrists do not jump to the other side."""
    rng = np.random.default_rng(14)
    frames = []
    for i in range(60):
        p = shaken(figure()[None], rng)
        if i % 7 == 6:
            p = p[:, [1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 12, 13, 14, 15]]
        frames.append(p)
    people = follow(recording(frames), plain(mode))
    assert np.linalg.norm(people.p[:, :12] - figure()[:12], axis=-1).max() < 0.2


# The live API.


def by_hand(detections: Detections, settings: Settings, seed: int) -> list[PeopleFrame]:
    state, rng, out = begin(settings), np.random.default_rng(seed), []
    for n, time in enumerate(detections.time.tolist()):
        here = detections.frame == n
        state, frame = step(state, time, detections.p[here], detections.confidence[here], rng)
        out.append(frame)
    return out


@pytest.mark.parametrize("mode", MODES)
def test_frame_by_frame_gives_what_a_whole_recording_gives(mode):
    detections = crossing(7, "re-entering", TaskSettings(frames=110)).detections
    people = follow(detections, Settings(mode=mode), seed=5)
    frames = by_hand(detections, Settings(mode=mode), seed=5)
    for n, frame in enumerate(frames):
        here = (people.frame == n) & np.isin(people.person, frame.person)
        assert people.person[here].tolist() == frame.person.tolist()
        for name in ("p", "covariance", "confidence", "status"):
            np.testing.assert_array_equal(getattr(people, name)[here], getattr(frame, name))
        between = (people.frame == n) & ~here
        assert (people.status[between] == LOST).all()
        assert (people.person[between] < 10).all() and frame.height.shape == frame.person.shape


@pytest.mark.parametrize("mode", MODES)
def test_the_seed_decides_everything(mode):
    detections = make_task("T1", 4, TaskSettings(frames=60)).detections
    a, b, c = (follow(detections, Settings(mode=mode), seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.p, b.p)
    np.testing.assert_array_equal(a.covariance, b.covariance)
    assert np.array_equal(a.p, c.p, equal_nan=True) == (mode == "robust")  # mode `robust` draws nothing


@pytest.mark.parametrize("mode", MODES)
def test_a_state_can_be_gone_on_from_twice(mode):
    rng = np.random.default_rng(15)
    state = begin(plain(mode))
    for i in range(10):
        state, _ = step(state, i / FPS, two(rng), np.full((2, 16), 0.7), np.random.default_rng(i))
    p = two(rng)
    before = p.copy()
    first = step(state, 0.5, p, np.full((2, 16), 0.7), np.random.default_rng(1))[1]
    step(state, 0.4, p[:1], np.full((1, 16), 0.3), np.random.default_rng(9))
    second = step(state, 0.5, p, np.full((2, 16), 0.7), np.random.default_rng(1))[1]
    np.testing.assert_array_equal(first.p, second.p)
    np.testing.assert_array_equal(p, before)


def test_heights_are_told_with_people():
    pair = np.stack([figure(1.62, (-0.6, 0.0, 2.2)), figure(1.85, (0.6, 0.0, 2.2))])
    frames = by_hand(recording([pair] * 20), plain("robust"), 1)
    np.testing.assert_allclose(frames[-1].height, [1.62, 1.85], rtol=0.003)


@pytest.mark.parametrize(
    ("time", "p", "confidence", "message"),
    [
        (1.0, np.zeros((1, 12, 3)), np.zeros((1, 12)), r"p, confidence: got shapes \(1, 12, 3\)"),
        (1.0, np.zeros((2, 16, 3)), np.zeros((1, 16)), r"wanted \(m, 16, 3\) and \(m, 16\)"),
        (np.nan, np.zeros((1, 16, 3)), np.zeros((1, 16)), "time: got nan, wanted a finite"),
        (0.0, np.zeros((1, 16, 3)), np.zeros((1, 16)), "time: got 0.0, wanted more than 0.0"),
        (-1.0, np.zeros((0, 16, 3)), np.zeros((0, 16)), "that of the frame before"),
    ],
)
def test_bad_frames_are_refused(time, p, confidence, message):
    rng = np.random.default_rng(1)
    state, _ = step(begin(Settings()), 0.0, np.zeros((0, 16, 3)), np.zeros((0, 16)), rng)
    with pytest.raises(ValueError, match=message):
        step(state, time, p, confidence, rng)


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("mode", "best", "robust"), ("noise", "deviation", "variance"), ("distance", 0.0, "0.1 to"),
        ("reward", -0.1, "0.0 to 1.0"), ("alpha", 0.0, "1e-09 to"), ("beta", 1.5, "0.0 to 1.0"),
        ("threshold", np.nan, "0.0 to 1.0"), ("history", 0, "1 to"), ("particles", 1, "2 to"),
        ("hypotheses", 65, "2 to 64"), ("gate", np.inf, "0.01 to"), ("confirm", 0, "1 to"),
        ("skin", 0.5, "-0.2 to 0.2"),
    ],
)  # fmt: skip
def test_bad_settings_are_refused(name, value, wanted):
    with pytest.raises(ValueError, match=f"{name}: got .*{wanted}"):
        Settings(**{name: value})


def test_the_papers_numbers_are_the_papers():
    """People paper, III-D."""
    s = Settings()
    assert (s.distance, s.reward, s.penalty, s.delta, s.alpha, s.beta, s.threshold, s.history) == (
        3.0, 0.1, 0.1, 0.5, 0.01, 0.2, 0.4, 50,
    )  # fmt: skip


@pytest.mark.parametrize("mode", MODES)
def test_nothing_is_followed_without_harm(mode):
    for frames in ([], [np.zeros((0, 16, 3))] * 5, [np.full((2, 16, 3), np.nan)] * 5):
        people = follow(recording(frames), plain(mode))
        assert people.frame.size == 0 and people.p.shape == (0, 16, 3) and people.time.size == len(frames)


def test_steps_of_any_length_are_taken():
    rng = np.random.default_rng(16)
    slow = recording([two(rng) for _ in range(40)])
    for time in (np.cumsum(rng.uniform(1e-4, 0.4, 40)), np.arange(40) * 1e-6, np.arange(40) * 1.5):
        for mode in MODES:
            people = follow(replace(slow, time=time), plain(mode))
            assert np.unique(people.person).tolist() == [0, 1]
            whole(people)


ANY = st.one_of(st.floats(-4.0, 4.0), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1e6, 1e150, -1e308, 49.9]))
FRAME = st.integers(0, 3).flatmap(
    lambda m: st.tuples(hnp.arrays(float, (m, 16, 3), elements=ANY), hnp.arrays(float, (m, 16), elements=ANY))
)


@given(st.lists(FRAME, min_size=1, max_size=6), st.sampled_from(MODES), st.integers(0, 99))
@tried(max_examples=40, deadline=None)
def test_whatever_comes_people_are_whole(garbage, mode, seed):
    """Two people, then anything, then anything amid the two in any order with holes."""
    rng = np.random.default_rng(seed)
    pairs = [(p := two(rng), confidences(p)) for _ in range(8)]
    pairs += garbage
    for p, sure in garbage:
        both = two(rng)
        both[rng.random((2, 16)) < 0.3] = np.nan
        order = rng.permutation(2 + p.shape[0])
        pairs.append((np.concatenate([both, p])[order], np.concatenate([confidences(both), sure])[order]))
    people = follow(recording([p for p, _ in pairs], [c for _, c in pairs]), Settings(mode=mode, particles=20))
    whole(people)
    assert {0, 1} <= set(people.person.tolist())
    far = np.linalg.norm(places(people.p[:, :12]), axis=1)
    assert not (far > 3.0 + 1e-9).any()
