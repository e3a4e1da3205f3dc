"""Simulated people: bodies keep their bones, the camera sees what is there, and errors are as the module says."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import config

from handtrack.camera import project, rays
from handtrack.errors import InputError
from handtrack.formats.people_scenes import read_people_scene
from handtrack.formats.skeletons import KEYPOINTS
from synth.cell_room import Boxes, first_hits
from synth.cell_view import Eye
from synth.people import body_of, flesh
from synth.people_motion import along, person_at, recorded_sway, walked, way_of
from synth.people_scripts import TABLE, TASKS, script
from synth.people_stage import Sight, Stage, box_hits, depth_at, look, nothing_moves
from synth.people_tasks import CROSSINGS, Task, TaskSettings, crossing, make_task, simulate_people
from synth.pose_network import (
    FAULTLESS,
    GOOD,
    GUESS,
    INVERT,
    MISS,
    STRAY,
    SWAP,
    NetworkSettings,
    detect,
    modes,
)
from synth.pose_people import false_people, order_of, people_left_out

DATA = Path(__file__).parents[2] / "shared" / "data"
LEFT_WRIST = KEYPOINTS.index("left_wrist")
# People paper, Table I, first row: MAE of the operator's left wrist, metres.
TABLE_I = {"T0": 0.067, "T1": 0.195, "T2": 0.147, "T3": 0.319}


@pytest.fixture(scope="module")
def recorded():
    return {name: make_task(name, 1) for name in TASKS}


def wrist_error(task: Task) -> np.ndarray:
    """Raw error of the operator's left wrist; the last report is held where there is none."""
    truth = task.truth.p[:, 0, LEFT_WRIST]
    reported = np.full(truth.shape, np.nan)
    mine = task.who == 0
    reported[task.detections.frame[mine]] = task.detections.p[mine, LEFT_WRIST]
    seen = ~np.isnan(reported[:, 0])
    held = reported[np.maximum.accumulate(np.where(seen, np.arange(seen.size), 0))]
    return np.linalg.norm(held - truth, axis=1)


def test_raw_errors_of_the_wrist_are_near_the_papers_baseline(recorded):
    found = {name: float(np.nanmean(wrist_error(task))) for name, task in recorded.items()}
    for name, value in TABLE_I.items():
        assert 0.5 * value < found[name] < 1.6 * value, (name, found[name])
    assert found["T0"] == min(found.values())


def test_the_wrist_is_hidden_for_long_in_t3_and_hardly_in_t0(recorded):
    hidden = {name: (task.visible[:, 0, LEFT_WRIST] < 0.4) for name, task in recorded.items()}
    assert hidden["T3"].mean() > 0.35 and hidden["T0"].mean() < 0.1
    edges = np.flatnonzero(np.diff(np.concatenate([[0], hidden["T3"].astype(int), [0]])))
    assert np.diff(edges)[::2].max() > 60  # two seconds at a stretch


@pytest.mark.parametrize("name", TASKS)
def test_bones_keep_their_lengths(recorded, name):
    p = recorded[name].truth.p
    for a, b in ((0, 2), (2, 4), (1, 3), (3, 5), (6, 8), (8, 10), (0, 1), (6, 7)):
        length = np.linalg.norm(p[:, :, a] - p[:, :, b], axis=-1)
        np.testing.assert_allclose(length, length[:1].repeat(length.shape[0], axis=0), atol=1e-9)


@pytest.mark.parametrize("name", TASKS)
def test_hands_move_as_people_do(recorded, name):
    task = recorded[name]
    speed = np.linalg.norm(np.diff(task.truth.p[:, :, 4:6], axis=0), axis=-1) * task.fps
    assert 0.2 < speed[:, 0, 0].max() < 3.0 and speed.max() < 4.0


def test_people_stand_within_the_papers_gate(recorded):
    for task in recorded.values():
        assert np.linalg.norm(task.truth.p[:, :, KEYPOINTS.index("root")], axis=-1).max() < 3.0


def test_the_same_arguments_give_the_same_recording():
    a, b, c = (make_task("T2", seed, TaskSettings(frames=40)) for seed in (3, 3, 4))
    for name in ("p", "confidence", "frame", "person"):
        np.testing.assert_array_equal(getattr(a.detections, name), getattr(b.detections, name))
    np.testing.assert_array_equal(a.truth.p, b.truth.p)
    assert np.abs(a.truth.p - c.truth.p).max() > 0.01


def test_confidence_tells_right_from_wrong_but_not_always(recorded):
    task = recorded["T3"]
    mine = task.who >= 0
    truth = task.truth.p[task.detections.frame[mine], task.who[mine]][:, :12]
    off = np.linalg.norm(task.detections.p[mine, :12] - truth, axis=-1)
    sure = task.detections.confidence[mine, :12]
    assert np.nanmean(sure[off < 0.06]) > 0.55 and np.nanmean(sure[off > 0.2]) < 0.42
    assert 0.1 < (sure[off > 0.2] > 0.4).mean() < 0.5  # a wrist beside the arm is as sure as one on it


def test_false_people_are_few_unsure_and_nobody(recorded):
    tasks = recorded.values()
    false = np.concatenate([task.detections.confidence[task.who < 0] for task in tasks])
    assert 0 < false.shape[0] < 0.05 * sum(task.who.size for task in tasks)
    assert false.max() < 0.6 and ((false > 0).sum(axis=1) >= 2).all()


def test_detections_are_numbered_in_each_frame(recorded):
    d = recorded["T1"].detections
    assert (np.diff(d.frame) >= 0).all()
    np.testing.assert_array_equal(d.person, np.arange(d.frame.size) - np.searchsorted(d.frame, d.frame))
    np.testing.assert_array_equal(np.isnan(d.p[..., 0]), d.confidence == 0)
    assert np.isnan(d.p[:, [KEYPOINTS.index("root"), KEYPOINTS.index("head")]]).all()


def test_the_order_of_people_changes_now_and_then(recorded):
    task = recorded["T0"]
    both = [task.who[task.detections.frame == i].tolist() for i in range(task.visible.shape[0])]
    assert [0, 1] in both and [1, 0] in both


def test_a_faultless_network_reports_the_skin_at_the_true_pixel():
    task = make_task("T0", 2, TaskSettings(frames=30, network=FAULTLESS))
    truth = task.truth.p[task.detections.frame, task.who]
    clear = task.visible[task.detections.frame, task.who] > 0.99
    clear[:, 12:] = False
    body = clear & ~np.isnan(task.uv[..., 0])
    np.testing.assert_allclose(task.uv[body], project(task.camera, truth)[body], atol=1e-9)
    depth = (truth - task.detections.p)[..., 2][body & ~np.isnan(task.detections.p[..., 0])]
    assert (depth > -0.01).all() and np.median(depth) > 0.02 and depth.max() < 0.2


def test_skin_offset_moves_along_the_ray():
    plain, deeper = (
        make_task("T0", 2, TaskSettings(frames=5, network=NetworkSettings(skin=skin))) for skin in (0.0, 0.035)
    )
    moved = deeper.detections.p - plain.detections.p
    length = np.linalg.norm(moved, axis=-1)
    np.testing.assert_allclose(length[~np.isnan(length)], 0.035, atol=1e-12)
    ray = plain.detections.p / np.linalg.norm(plain.detections.p, axis=-1, keepdims=True)
    assert np.nanmin((moved * ray).sum(axis=-1)) > 0.0349


# --- crossings


@pytest.fixture(scope="module")
def scenes():
    return {kind: crossing(2, kind) for kind in CROSSINGS}


def test_permuted_people_stand_and_come_in_any_order(scenes):
    task = scenes["permuted"]
    root = task.truth.p[:, :, KEYPOINTS.index("root")]
    assert np.linalg.norm(np.ptp(root, axis=0), axis=-1).max() < 0.9
    first = task.who[np.searchsorted(task.detections.frame, np.arange(task.visible.shape[0]))]
    assert 0.3 < (first == 0).mean() < 0.7


def test_crossing_people_change_sides(scenes):
    x = scenes["crossing"].truth.p[:, :, KEYPOINTS.index("root"), 0]
    assert (np.sign(x[0]) == -np.sign(x[-1])).all() and np.sign(x[0, 0]) != np.sign(x[0, 1])


def test_entering_people_are_outside_at_first(scenes):
    task = scenes["entering"]
    assert task.detections.frame[task.who >= 0].min() > 5
    assert (task.visible[-1] > 0.4).mean() > 0.45


def test_who_re_enters_was_away_and_the_other_was_not(scenes):
    task = scenes["re-entering"]
    there = [np.isin(np.arange(task.visible.shape[0]), task.detections.frame[task.who == who]) for who in (0, 1)]
    assert there[0][:10].any() and there[0][-10:].any() and not there[0][75:105].any()
    assert there[1].mean() > 0.85


@pytest.mark.parametrize("kind", CROSSINGS)
def test_the_two_of_a_crossing_differ_in_height(scenes, kind):
    p = scenes[kind].truth.p[0]
    thigh = np.linalg.norm(p[:, 0] - p[:, 2], axis=-1)  # upper arm: 0.186 of the height
    assert abs(thigh[0] - thigh[1]) > 0.186 * 0.0999


def test_who_walks_looks_ahead_and_who_stands_at_the_camera():
    rng, path = np.random.default_rng(0), np.column_stack([np.linspace(0, 3, 90), np.full(90, 2.0)])
    p = walked(rng, body_of(1.75), path, 30.0)
    across = p[40, 1] - p[40, 0]  # to the right shoulder
    assert across[1] < -0.3 and abs(across[0]) < 0.1
    swing = p[20:, 10, 0] - p[20:, 6, 0]
    assert swing.max() > 0.15 and swing.min() < -0.15
    still = walked(rng, body_of(1.75), np.tile([[0.0, 2.0]], (30, 1)), 30.0)
    assert (still[:, 1] - still[:, 0])[10, 0] < -0.3


# --- motion and stage


def test_a_way_stays_at_its_ends_and_stops_at_every_knot():
    way = way_of([(1.0, (0.0, 0.0, 0.0), 0.0), (2.0, (1.0, 0.0, 0.0), 0.2), (4.0, (1.0, 1.0, 0.0), 0.0)])
    time = np.linspace(0.0, 5.0, 501)
    p = along(way, time)
    np.testing.assert_allclose(
        p[[0, 100, 200, 400, 500]], [[0, 0, 0], [0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 0]], atol=1e-12
    )
    speed = np.linalg.norm(np.gradient(p, time, axis=0), axis=1)
    assert speed[[100, 200, 400]].max() < 0.02 and p[:, 2].max() == pytest.approx(0.2, abs=1e-6)


@pytest.mark.parametrize("file", ["hand_mocap/recording.tsv", "body_markers/markers.trc"])
def test_recorded_hands_sway_a_little(file):
    rng = np.random.default_rng(1)
    sway = recorded_sway(DATA / file, rng, 2000, 30.0)
    size = np.linalg.norm(sway, axis=1)
    assert size.max() <= 0.04 + 1e-12 and size.mean() > 0.002 and np.linalg.norm(sway.mean(axis=0)) < 0.01
    assert np.linalg.norm(np.diff(sway, axis=0), axis=1).max() < 0.04


def test_a_recorded_arm_moves_the_hands_of_a_task():
    plain, moved = (
        make_task("T0", 1, TaskSettings(frames=20, motion=path)) for path in (None, DATA / "hand_mocap/recording.tsv")
    )
    assert 0.001 < np.abs(plain.truth.p[:, 0, 4] - moved.truth.p[:, 0, 4]).max() < 0.2


def test_a_recording_without_an_arm_is_refused(tmp_path):
    head = "FREQUENCY\t50\nMARKER_NAMES\thand_top\thand_left\thand_right\tright_shoulder\n"
    path = tmp_path / "m.tsv"
    path.write_text(head.replace("hand_top", "nose") + "\t".join(["1"] * 12))
    with pytest.raises(InputError, match=r"no markers of an arm; wanted: hand_top.* or STYLr"):
        recorded_sway(path, np.random.default_rng(0), 5, 30.0)
    path.write_text(head + "\t".join(["0"] * 3 + ["1"] * 9))
    with pytest.raises(InputError, match="'hand_top' is never seen"):
        recorded_sway(path, np.random.default_rng(0), 5, 30.0)


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_boxes_are_met_where_the_cells_own_slabs_are_met(seed):
    rng = np.random.default_rng(seed)
    boxes = Boxes(rng.normal(0, 2, (6, 3)), rng.uniform(0.1, 0.8, (6, 3)), rng.uniform(-3, 3, 6))
    origin, vectors = np.array([5.0, -4.0, 3.0]), rng.normal(0, 1, (40, 3)) - [2.0, -2.0, 1.0]
    found = box_hits(boxes.centre, boxes.half, boxes.turn, origin, vectors)
    np.testing.assert_allclose(found, first_hits(boxes, origin, vectors)[0], rtol=1e-9)


def test_a_ray_along_a_face_and_no_boxes_at_all():
    none = box_hits(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(3), np.eye(3))
    assert np.isinf(none).all()
    one = box_hits(np.zeros((1, 3)), np.ones((1, 3)), np.zeros(1), np.array([-3.0, 1.0, 0.0]), np.eye(3)[:1])
    assert one.tolist() == [2.0]


def made_stage(frames: int = 60) -> Stage:
    """Two people side by side, two metres away, before nothing."""
    rng = np.random.default_rng(5)
    task = make_task("T0", 5, TaskSettings(frames=2, network=FAULTLESS))
    bodies = (body_of(1.75), body_of(1.70))
    paths = [np.tile([[x, 2.2]], (frames, 1)) for x in (-0.5, 0.5)]
    p = np.stack([walked(rng, body, path, 30.0) for body, path in zip(bodies, paths, strict=True)], axis=1)
    R = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    eye = Eye(np.array([0.0, 0.0, 1.1]), R, task.camera)
    away = Boxes(np.full((1, 3), -90.0), np.ones((1, 3)), np.zeros(1))
    return Stage(eye, bodies, eye.see(p), away, *nothing_moves(frames), np.zeros((frames, 0, 2, 3)), np.zeros(0))


@pytest.fixture(scope="module")
def sight() -> Sight:
    return look(made_stage())


def test_all_of_a_person_in_the_open_is_seen_and_nothing_behind_a_board(sight):
    assert sight.share[:, :, :12].min() > 0.4
    stage = sight.stage
    board = Boxes(np.array([[-0.5, 1.2, 1.0]]), np.array([[0.5, 0.02, 2.0]]), np.zeros(1))
    hidden = look(
        Stage(stage.eye, stage.bodies, stage.p, board, stage.centre, stage.turn, stage.half, stage.links, stage.radius)
    )
    assert hidden.share[:, 0].max() == 0.0 and hidden.share[:, 1, :12].min() > 0.4
    z = depth_at(hidden, 0, hidden.uv[0].reshape(-1, 2)).reshape(2, 16)
    np.testing.assert_allclose(z[0], 1.18, atol=1e-9)


def test_the_depth_of_a_joint_is_that_of_its_skin(sight):
    z = depth_at(sight, 3, sight.uv[3].reshape(-1, 2)).reshape(2, 16)
    under = sight.stage.p[3, :, :, 2] - z
    radius = np.stack([flesh(body) for body in sight.stage.bodies])
    assert (np.abs(under[:, :12] - radius[:, :12]) < 0.08).all()
    assert np.isinf(depth_at(sight, 3, np.array([[2.0, 2.0], [np.nan, 1.0]]))).all()


def test_who_is_away_hides_nothing(sight):
    stage = sight.stage
    p = stage.p.copy()
    p[:, 1] = np.nan
    gone = look(Stage(stage.eye, stage.bodies, p, stage.still, *nothing_moves(60), stage.links, stage.radius))
    assert gone.share[:, 1].max() == 0.0 and gone.share[:, 0, :12].min() > 0.4
    seen = detect(np.random.default_rng(0), gone, 30.0, FAULTLESS)
    assert set(seen.who.tolist()) == {0}


# --- the network


def quiet(**changes) -> NetworkSettings:
    base = {name: getattr(FAULTLESS, name) for name in NetworkSettings.__dataclass_fields__}
    return NetworkSettings(**{**base, **changes})


def with_share(sight: Sight, share: np.ndarray) -> Sight:
    return Sight(sight.stage, sight.uv, share, sight.parts)


def test_nothing_happens_to_a_seen_keypoint_without_rates(sight):
    assert (modes(np.random.default_rng(0), sight, 30.0, quiet())[:, :, :12] == GOOD).all()


def test_a_hidden_keypoint_falls_into_an_error_within_a_tenth_of_a_second_and_recovers(sight):
    share = sight.share.copy()
    share[20:40, 0, LEFT_WRIST] = 0.0
    settings = quiet(hide_rate=10.0, recover_rate=8.0)
    found = np.stack(
        [modes(np.random.default_rng(s), with_share(sight, share), 30.0, settings)[:, 0, LEFT_WRIST] for s in range(60)]
    )
    wrong = (found != GOOD).mean(axis=0)
    assert wrong[:20].max() == 0.0 and wrong[39] > 0.97 and wrong[-1] < 0.06
    assert 0.45 < wrong[22] < 0.8  # 1 - exp(-10 * 0.1) after three frames
    assert set(found[:, 35].tolist()) <= {GUESS, MISS, SWAP, INVERT, STRAY} and (found[:, 35] == GUESS).mean() > 0.2


def test_a_wrist_near_another_persons_is_taken_for_it_and_a_lonely_one_is_not(sight):
    uv = sight.uv.copy()
    uv[:, 0, LEFT_WRIST] = uv[:, 1, LEFT_WRIST] + 2.0
    near = Sight(sight.stage, uv, sight.share, sight.parts)
    settings = quiet(crowd_rate=4.0)
    mode = np.stack([modes(np.random.default_rng(s), near, 30.0, settings) for s in range(10)])
    assert (mode[..., 0, LEFT_WRIST] == SWAP).mean() > 0.15
    alone = np.stack([modes(np.random.default_rng(s), sight, 30.0, settings) for s in range(10)])
    assert (alone == SWAP).mean() < 0.01
    seen = detect(np.random.default_rng(0), near, 30.0, settings)
    swapped = (seen.mode[:, LEFT_WRIST] == SWAP) & (seen.who == 0)
    np.testing.assert_allclose(seen.uv[swapped, LEFT_WRIST], near.uv[seen.frame[swapped], 1, LEFT_WRIST])


def test_inverted_and_stray_keypoints_are_elsewhere(sight):
    settings = quiet(invert_rate=4.0, stray_rate=4.0, recover_rate=2.0)
    seen = detect(np.random.default_rng(1), sight, 30.0, settings)
    true = sight.uv[seen.frame, seen.who]
    off = np.linalg.norm(seen.uv - true, axis=-1)
    inverted = (seen.mode == INVERT) & ~np.isnan(off)
    other = np.linalg.norm(true[:, 4] - true[:, 5], axis=-1)
    np.testing.assert_allclose(off[:, 4][inverted[:, 4]], other[inverted[:, 4]])
    stray = (seen.mode == STRAY)[:, :12] & ~np.isnan(off[:, :12])
    assert stray.any() and inverted.any() and off[:, :12][stray].min() > 10.0


def test_a_person_seen_from_the_side_is_flipped_more_often(sight):
    assert (modes(np.random.default_rng(0), sight, 30.0, quiet(flip_rate=0.5))[:, :, :12] == INVERT).any()
    narrow = sight.uv.copy()
    narrow[:, :, 1] = narrow[:, :, 0] + 1.0
    side = Sight(sight.stage, narrow, sight.share, sight.parts)
    counts = [
        sum((modes(np.random.default_rng(s), view, 30.0, quiet(flip_rate=0.1)) == INVERT).sum() for s in range(20))
        for view in (sight, side)
    ]
    assert counts[1] > 3 * counts[0]


def test_jitter_is_in_pixels_and_grows_where_confidence_falls(sight):
    seen = detect(np.random.default_rng(0), sight, 30.0, quiet(jitter=0.55))
    off = (seen.uv - sight.uv[seen.frame, seen.who])[:, :12]
    assert 0.45 < np.nanstd(off) < 0.65
    dim = with_share(sight, np.full_like(sight.share, 0.45))
    unsure = detect(np.random.default_rng(0), dim, 30.0, quiet(jitter=0.55))
    assert np.nanstd((unsure.uv - dim.uv[unsure.frame, unsure.who])[:, :12]) > 1.2 * np.nanstd(off)


def test_depth_noise_grows_with_the_square_of_depth_and_holes_are_unseen(sight):
    plain = detect(np.random.default_rng(0), sight, 30.0, quiet())
    noisy = detect(np.random.default_rng(0), sight, 30.0, quiet(depth_noise=0.002))
    assert 0.7 < np.nanstd((noisy.p - plain.p)[..., 2]) / (0.002 * np.nanmean(plain.p[..., 2] ** 2)) < 1.3
    holes = detect(np.random.default_rng(0), sight, 30.0, quiet(hole=0.3))
    lost = (holes.confidence == 0)[:, :12].mean()
    assert 0.2 < lost < 0.4 and np.isnan(holes.p[holes.confidence == 0]).all()


def test_people_are_missed_now_and_then_for_a_moment():
    out = people_left_out(np.random.default_rng(0), (30_000, 2), 30.0, 0.5, 0.2)
    starts = np.count_nonzero(np.diff(out.astype(int), axis=0) == 1)
    assert 0.8 < starts / (2 * 1000.0 * 0.5 / 1.1) < 1.2
    assert 0.8 < out.sum() / starts / (0.2 * 30.0 + 0.5) < 1.2
    assert not people_left_out(np.random.default_rng(0), (100, 2), 30.0, 0.0, 0.2).any()


def test_false_people_repeat_others_or_are_somewhere(sight):
    sure = np.where(np.arange(16) < 12, 0.6, 0.0) * np.ones(sight.uv.shape[:3])
    camera = sight.stage.eye.camera
    false = false_people(np.random.default_rng(3), sight.uv, sure, camera, 30.0, 5.0, 0.2)
    count = (false.confidence > 0).sum(axis=1)
    assert false.frame.size > 5 and count.min() >= 4 and count.max() <= 8
    assert np.isnan(false.uv[false.confidence == 0]).all() and false.confidence.max() < 0.55
    none = false_people(np.random.default_rng(3), sight.uv, sure, camera, 30.0, 0.0, 0.2)
    assert none.frame.size == 0


def test_orders_are_kept_mixed_or_random():
    rng, start = np.random.default_rng(0), np.arange(4)
    assert order_of(rng, start, "kept") is start
    changed = [
        not np.array_equal(order_of(rng, start, kind), start) for kind in ("mixed", "random") for _ in range(200)
    ]
    assert 10 < sum(changed[:200]) < 60 and sum(changed[200:]) > 180


# --- files and arguments


def test_a_task_is_written_as_a_scene_that_reads_back(tmp_path):
    task = make_task("T1", 4, TaskSettings(frames=8))
    simulate_people(tmp_path / "scene", task)
    scene = read_people_scene(tmp_path / "scene")
    assert scene.camera is not None and scene.truth is not None and scene.fps == 30.0 and not scene.warnings
    assert (scene.camera.width, scene.camera.height) == (848, 480)
    np.testing.assert_allclose(scene.detections.p, task.detections.p, rtol=1e-9)
    np.testing.assert_allclose(scene.truth.p, task.truth.p, rtol=1e-9)
    before = {path.name: path.read_bytes() for path in (tmp_path / "scene").iterdir()}
    with pytest.raises(InputError, match="not empty"):
        simulate_people(tmp_path / "scene", task)
    simulate_people(tmp_path / "scene", task, replace_folder=True)
    assert before == {path.name: path.read_bytes() for path in (tmp_path / "scene").iterdir()}


def test_projection_of_the_files_places_is_inside_the_image(recorded):
    task = recorded["T2"]
    seen = ~np.isnan(task.detections.p[..., 0])
    uv = project(task.camera, task.detections.p[seen])
    assert uv.min() >= -1e-6 and (uv <= [847.0 + 1e-6, 479.0 + 1e-6]).all()
    np.testing.assert_allclose(uv, task.uv[seen], atol=1e-6)
    assert np.isfinite(rays(task.camera, uv)[1]).all()


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: make_task("T4", 0), "name: got 'T4', wanted one of T0, T1, T2, T3"),
        (lambda: crossing(0, "dancing"), "kind: got 'dancing', wanted one of permuted"),
        (lambda: TaskSettings(frames=1), "frames: got 1, wanted 2 to"),
        (lambda: TaskSettings(fps=0.0), "fps: got 0.0, wanted 1.0 to"),
        (lambda: NetworkSettings(hole=1.5), "hole: got 1.5, wanted 0.0 to 1.0"),
        (lambda: NetworkSettings(order="sorted"), "order: got 'sorted', wanted one of"),  # pyright: ignore
        (lambda: NetworkSettings(hidden=(0.5, 0.5, 0.5, 0.0)), "hidden: got .* wanted four chances"),
    ],
)
def test_bad_arguments_are_named(call, text, monkeypatch):
    monkeypatch.setattr(config, "jaxtyping_disable", True)
    with pytest.raises(ValueError, match=text):
        call()


def test_scripts_keep_hands_above_the_table():
    rng = np.random.default_rng(0)
    people = (person_at(rng, 1.75, (-0.42, 0.42), -152.0), person_at(rng, 1.75, (0.42, 0.42), 152.0))
    for name in TASKS:
        done = script(np.random.default_rng(1), name, people, 900, 30.0)
        over = (np.abs(done.hands[..., 0]) < 0.9) & (np.abs(done.hands[..., 1] + 0.12) < 0.3)
        assert done.hands[over][:, 2].min() > TABLE and done.hands.shape == (900, 2, 2, 3)
