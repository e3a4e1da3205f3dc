"""Following walks: from folder to folder, with streams at any rates, and better than suit and camera alone."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from handtrack.body import walk_baselines
from handtrack.body.posture import keypoints
from handtrack.body.suit_body import body_of_walk
from handtrack.body.walk_baselines import place_from_points
from handtrack.body.walk_inputs import open_walk
from handtrack.body.walk_metrics import walk_figures
from handtrack.body.walk_moment import keypoint_sigma, lasting_factor, moments
from handtrack.body.walk_person import chains, walker
from handtrack.body.walk_run import follow_walk, run_folder, settings_for
from handtrack.body.walk_settings import METHODS, Settings
from handtrack.camera import project
from handtrack.errors import InputError
from handtrack.formats.poses2d import BODY_25
from handtrack.formats.skeletons import KEYPOINTS
from handtrack.formats.walk_tracks import NAMES, read_walk_track
from handtrack.formats.walks import Walk, write_walk
from synth.walk import WalkScene, WalkSettings, make_walk

READY = ("eskf", "camera", "suit")


@pytest.fixture(scope="module")
def scene() -> WalkScene:
    return make_walk(5, WalkSettings(seconds=16.0))


def short(seconds: float = 4.0, **changes) -> Walk:
    return make_walk(5, WalkSettings(seconds=seconds, **changes)).walk


def figures(walk: Walk, **changes):
    track = follow_walk(walk, body_of_walk(walk), Settings(**changes))
    found = walk_figures(track, walk.truth)
    assert found is not None
    return track, found


def openpose(folder: Path, walk: Walk, strangers: bool = False) -> None:
    """What the camera saw as OpenPose's files, the body's 12 joints only, `strangers` before the walker."""
    folder.mkdir()
    for n, (uv, confidence) in enumerate(zip(walk.uv, walk.confidence, strict=True)):
        people = []
        if strangers and n:
            people.append({"pose_keypoints_2d": [40.0, 50.0 + n, 0.5] * 25})
        if (confidence > 0).any():
            numbers = np.zeros((25, 3))
            for k, name in enumerate(KEYPOINTS[:12]):
                if confidence[k] > 0:
                    numbers[BODY_25.index(name)] = *uv[k], confidence[k]
            people.append({"pose_keypoints_2d": numbers.ravel().tolist()})
        (folder / f"walk_{n:012d}_keypoints.json").write_text(json.dumps({"people": people}), encoding="utf-8")


@pytest.mark.parametrize("method", READY)
def test_every_method_gives_a_row_of_finite_numbers_for_each_frame(scene: WalkScene, method):
    track, _ = figures(scene.walk, method=method)
    assert np.array_equal(track.frame, scene.walk.frame)
    for field in ("p", "wxyz", "sigma", "sigma_heading", "posture", "sigma_posture", "keypoints", "seconds"):
        assert np.isfinite(getattr(track, field)).all(), field
    np.testing.assert_allclose(np.linalg.norm(track.wxyz, axis=1), 1.0)


def test_error_state_filter_is_better_than_suit_and_camera_alone(scene: WalkScene):
    found = {name: figures(scene.walk, method=name)[1] for name in READY}
    assert found["eskf"].mean < 0.05 and found["eskf"].heading < np.radians(2.0)
    assert found["eskf"].mean < min(found["camera"].mean, found["suit"].mean)
    assert found["eskf"].wrist < found["suit"].wrist


def test_the_suit_alone_is_the_suit(scene: WalkScene):
    track, _ = figures(scene.walk, method="suit")
    np.testing.assert_allclose(track.p, scene.walk.p[:, 0], atol=1e-12)
    assert set(track.status) == {"predicted"}


def test_the_camera_alone_is_sure_in_view_only(scene: WalkScene):
    track, _ = figures(scene.walk, method="camera")
    assert set(track.status[track.in_view]) <= {"tracked", "uncertain"}
    blind = track.sigma[~track.in_view, 0]
    assert track.sigma[track.in_view, 0].min() < blind.min()


def test_a_pose_is_found_from_exact_points_through_a_bent_lens():
    bent = (-0.15, 0.03, 0.001, 0.0, 0.0)
    walk = short(2.0, distortion=bent)
    body = body_of_walk(walk)
    told = moments(walk, body, Settings())[0]
    true = told.q.copy()
    uv = project(walk.camera, keypoints(body, true[None])[0])
    still = true.copy()
    still[:6] = 0.0
    found = place_from_points(replace(told, uv=uv, confidence=np.ones(16)), keypoints(body, still[None])[0])
    assert found is not None
    np.testing.assert_allclose(found[0], true[:3], atol=1e-3)


def test_no_pose_is_found_from_few_points_or_from_nonsense():
    walk = short(2.0)
    told = moments(walk, body_of_walk(walk), Settings())[0]
    few = np.where(np.arange(16) < 5, 1.0, 0.0)
    points = np.random.default_rng(0).normal(size=(16, 3))
    assert place_from_points(replace(told, confidence=few), points) is None
    uv = np.random.default_rng(1).uniform(0.0, 700.0, (16, 2))
    assert place_from_points(replace(told, uv=uv, confidence=np.ones(16)), points) is None


def test_the_camera_alone_is_lost_before_it_saw_anybody():
    walk = short(2.0)
    walk = replace(walk, uv=np.full_like(walk.uv, np.nan), confidence=np.zeros_like(walk.confidence))
    track, _ = figures(walk, method="camera")
    assert set(track.status) == {"lost"} and not track.in_view.any()


@pytest.mark.parametrize(
    ("fps", "camera_fps", "jitter", "missing", "most"),
    [(5.0, 30.0, 0.002, 0.1, 0.06), (30.0, 4.0, 0.01, 0.2, 0.06), (10.0, 10.0, 0.0, 0.5, 0.09)],
)
def test_streams_of_any_rates_with_lost_samples_are_followed(fps, camera_fps, jitter, missing, most):
    walk = short(12.0, fps=fps, camera_fps=camera_fps, jitter=jitter, missing=missing)
    track, found = figures(walk)
    assert found.mean < most and track.frame.size == walk.frame.size
    assert 0.2 < track.in_view.mean() <= 1.0


def test_moments_are_in_order_and_hold_each_frame_once():
    walk = short(4.0, camera_fps=12.0, jitter=0.003, missing=0.2)
    told = moments(walk, body_of_walk(walk), Settings())
    time = np.array([each.time for each in told])
    frames = [each.frame for each in told if each.frame >= 0]
    assert (np.diff(time) >= 0).all() and frames == list(range(walk.frame.size))
    np.testing.assert_allclose(np.cumsum([each.dt for each in told]), time - time[0], atol=1e-9)
    assert sum(each.seen for each in told) <= walk.camera_time.size


def test_segments_between_samples_are_interpolated():
    walk = short(3.0, fps=10.0)
    whole = moments(walk, body_of_walk(walk), Settings())
    p, wxyz = walk.p.copy(), walk.wxyz.copy()
    p[5], wxyz[5] = np.nan, np.nan
    part = moments(replace(walk, p=p, wxyz=wxyz), body_of_walk(walk), Settings())
    at = next(i for i, each in enumerate(whole) if each.frame == 5)
    assert part[at].since == 0.0
    np.testing.assert_allclose(part[at].p, whole[at].p, atol=0.1)
    np.testing.assert_allclose(part[at].R, whole[at].R, atol=0.4)


def test_a_silent_suit_goes_on_for_a_while_and_its_camera_is_not_used():
    walk = short(4.0)
    p, wxyz = walk.p.copy(), walk.wxyz.copy()
    p[8:16], wxyz[8:16] = np.nan, np.nan
    told = moments(replace(walk, p=p, wxyz=wxyz), body_of_walk(walk), Settings())
    silent = [each for each in told if 8 <= each.frame < 16]
    assert [each.since for each in silent] == pytest.approx([0.2 * (k + 1) for k in range(8)])
    assert not any(each.seen or each.in_view for each in silent)
    moved = np.linalg.norm(silent[0].p[0] - told[7].p[0])
    assert 0.0 < moved < 0.5 and np.array_equal(silent[-1].p, silent[-2].p)
    track, _ = figures(replace(walk, p=p, wxyz=wxyz))
    assert track.sigma[15, 0] > 2.0 * track.sigma[7, 0]


def test_a_segment_without_any_sample_goes_with_its_parent():
    walk = short(2.0)
    p, wxyz = walk.p.copy(), walk.wxyz.copy()
    p[:, 2], wxyz[:, 2] = np.nan, np.nan
    told = moments(replace(walk, p=p, wxyz=wxyz), body_of_walk(walk), Settings())
    np.testing.assert_array_equal(told[3].R[2], told[3].R[1])


def test_a_walk_without_any_pelvis_is_refused():
    walk = short(2.0)
    with pytest.raises(InputError, match=r"segments\.csv: the pelvis has no sample"):
        moments(replace(walk, p=np.full_like(walk.p, np.nan)), body_of_walk(walk), Settings())


def test_keypoints_are_worth_what_their_confidence_says():
    sigma = keypoint_sigma(np.array([1.0, 0.8, 0.4, 0.1, 0.0]), Settings())
    assert (np.diff(sigma) > 0).all() and sigma[0] == 4.0 and sigma[2] == 8.0 and np.isinf(sigma[-1])


def test_frames_close_in_time_count_less_each():
    walk = short(2.0)
    told = moments(walk, body_of_walk(walk), Settings())[2]
    factors = [lasting_factor(replace(told, camera_dt=dt), Settings()) for dt in (1 / 60, 1 / 30, 0.2, 2.0, np.inf)]
    assert (np.diff(factors) < 0).all() and factors[-1] == 1.0
    assert factors[0] / (60 / 30 * factors[1]) == pytest.approx(1.0, abs=0.1)  # twice the frames tell no more
    assert lasting_factor(told, Settings(lasting=0.0)) == 1.0


def test_the_same_input_gives_the_same_files_but_for_timings(tmp_path: Path):
    write_walk(tmp_path / "walk", short(16.0))
    texts = []
    for name in ("one", "two"):
        done = run_folder(tmp_path / "walk", tmp_path / name, settings_for("eskf"))
        texts.append([(tmp_path / name / file).read_bytes() for file in NAMES])
        record = json.loads((tmp_path / name / "run.json").read_text(encoding="utf-8"))
        assert record["settings"]["method"] == "eskf" and record["figures"]["mean_mm"] < 60.0
        assert len(record["inputs"]) == 5 and record["frames"] == done.track.frame.size
    assert texts[0] == texts[1]
    again = read_walk_track(tmp_path / "one")
    np.testing.assert_allclose(again.p, done.track.p, atol=1e-9)
    assert again.status.tolist() == done.track.status.tolist()


def test_a_run_replaces_only_what_it_may(tmp_path: Path):
    write_walk(tmp_path / "walk", short(2.0))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="already exists and is not empty"):
        run_folder(tmp_path / "walk", tmp_path / "out", settings_for("suit"))
    run_folder(tmp_path / "walk", tmp_path / "out", settings_for("suit"), replace=True)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted((*NAMES, "run.json"))


def test_openposes_files_take_the_place_of_the_keypoints(tmp_path: Path):
    walk = short(8.0)
    write_walk(tmp_path / "walk", walk)
    (tmp_path / "walk" / "keypoints2d.csv").unlink()
    openpose(tmp_path / "json", walk, strangers=True)
    with pytest.raises(InputError, match=r"keypoints2d\.csv"):
        open_walk(tmp_path / "walk")
    opened = open_walk(tmp_path / "walk", tmp_path / "json")
    both = (opened.walk.confidence[:, :12] > 0) & (walk.confidence[:, :12] > 0)
    assert both.sum() > 0.9 * (walk.confidence[:, :12] > 0).sum()
    np.testing.assert_allclose(opened.walk.uv[:, :12][both], walk.uv[:, :12][both], atol=1e-9)
    done = run_folder(tmp_path / "walk", tmp_path / "out", settings_for("eskf"), poses=tmp_path / "json")
    assert done.record["figures"]["mean_mm"] < 60.0  # type: ignore[index]
    assert "json" in done.record["inputs"]  # type: ignore[operator]


def test_keypoints_of_another_time_are_refused(tmp_path: Path):
    walk = short(2.0)
    write_walk(tmp_path / "walk", walk)
    openpose(tmp_path / "json", walk)
    with pytest.raises(
        InputError, match="the keypoints go from 100 to 102 s, the suit from 0 to 2; times on one clock"
    ):
        open_walk(tmp_path / "walk", tmp_path / "json", start=100.0)


def test_a_chain_goes_on_after_a_gap_and_ends_after_a_long_one():
    uv = np.array([100.0, 900.0, 110.0, 905.0, 600.0])[:, None, None] + np.zeros((5, 16, 2))
    frame, time = np.array([0, 0, 1, 2, 3]), np.array([0.0, 0.1, 0.2, 5.0])
    assert chains(time, frame, uv, np.ones((5, 16)), 720.0).tolist() == [0, 1, 0, 1, 2]
    assert chains(time, frame, uv, np.zeros((5, 16)), 720.0).tolist() == [-1] * 5


def test_a_second_walker_with_another_posture_does_not_take_the_suits_place():
    walk, other = short(30.0), make_walk(8, WalkSettings(seconds=30.0)).walk
    c = walk.camera_time.size
    frame = np.repeat(np.arange(c), 2)
    uv = np.stack([other.uv[:c], walk.uv], axis=1).reshape(-1, 16, 2)
    confidence = np.stack([other.confidence[:c], walk.confidence], axis=1).reshape(-1, 16)
    chosen = walker(walk, frame, uv, confidence)
    both = (confidence > 0).sum(axis=1).reshape(-1, 2).min(axis=1) >= 8
    assert both.sum() > 20 and np.mean(chosen[both] % 2 == 1) > 0.9


def test_unknown_methods_and_settings_out_of_range_are_refused():
    with pytest.raises(InputError, match=r"--method: slam given; wanted: drift-ff"):
        settings_for("slam")
    with pytest.raises((ValueError, TypeError), match="method"):
        Settings(method="slam")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"least_sure: got 2\.0, wanted at least surest, 4"):
        Settings(least_sure=2.0)
    for field in fields(Settings):
        if field.name not in ("method", "proposal", "asymmetric", "calibrate"):
            for value in (-1,) if field.type is int else (-1.0, float("nan")):
                with pytest.raises(ValueError, match=f"{field.name}: got"):
                    replace(Settings(), **{field.name: value})
    assert [settings_for(name).method for name in METHODS] == list(METHODS)


def test_baselines_do_not_touch_the_random_numbers(scene: WalkScene):
    rng = np.random.default_rng(3)
    body = body_of_walk(scene.walk)
    told = moments(scene.walk, body, Settings(method="camera"))[0]
    walk_baselines.step(walk_baselines.begin(body, Settings(method="camera")), told, rng)
    assert rng.random() == np.random.default_rng(3).random()
