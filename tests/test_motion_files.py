"""Joint values from recordings: known motion comes back, real recordings give plausible hands."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handtrack.errors import InputError
from handtrack.formats.markers import Markers, read_markers
from handtrack.kinematics.builtin import model
from synth.dataset import motion_files
from synth.dataset.draw import prepare, shot
from synth.dataset.hands import own_axes, pill_hand
from synth.dataset.motion_files import filled, fitted, joint_motion, known_places, resampled
from synth.dataset.poses import path_of
from synth.dataset.scene_file import read_scene
from synth.labels.solids import KEYPOINTS

DATA = Path(__file__).parents[2] / "shared" / "data"
CLIP, MOCAP = DATA / "body_bvh" / "bvh_test3.bvh", DATA / "hand_mocap" / "recording.tsv"


@pytest.fixture(scope="module")
def right():
    return pill_hand(model("full_hand"))


@pytest.fixture(scope="module")
def left():
    return pill_hand(model("full_hand"), left=True)


def _known(hand, frames=12, seed=3):
    return path_of(hand.model, np.random.default_rng(seed), frames - 1, 4.0, 0.1, False)


@pytest.mark.parametrize("side", ["right", "left"])
def test_places_of_joints_give_the_joint_values_back(request, side):
    hand = request.getfixturevalue(side)
    q = _known(hand)
    target = motion_files._points(hand, q, known_places(hand))
    found = fitted(hand, target * (-1.0, 1.0, 1.0) if side == "left" else target, known_places(hand), prior=1e-3)
    bends = [i for i, name in enumerate(hand.model.joint_names) if not name.startswith("thumb")]
    assert np.degrees(np.abs(found - q)[:, bends]).max() < 0.5
    again = motion_files._points(hand, found, known_places(hand))
    assert np.linalg.norm(again - target, axis=-1).max() < 0.5


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_skeleton_with_fingers_moves_a_hand(request, side):
    hand = request.getfixturevalue(side)
    q = joint_motion(CLIP, hand, 60.0, side)
    assert q.shape[0] == int(99 * 0.008333 * 60) + 1
    low, high = hand.model.limits.T
    assert (q >= low - 1e-9).all() and (q <= high + 1e-9).all()
    assert 2.0 < np.degrees(np.ptp(q, axis=0)).max() < 120.0


def test_a_missing_side_is_mirrored_from_the_other(tmp_path, right):
    text = CLIP.read_text()
    cut = tmp_path / "left_only.bvh"
    cut.write_text(text.replace("RightHand", "OtherHand"))
    np.testing.assert_allclose(
        joint_motion(cut, right, 30.0, "right"), joint_motion(CLIP, pill_hand(model("full_hand"), True), 30.0, "left"),
        atol=1e-3,
    )  # fmt: skip


def test_markers_of_a_known_motion_are_met_again(monkeypatch, right, tmp_path):
    q = _known(right, frames=60)
    names = [f"{finger}_{part}" for finger in motion_files.FINGERS for part in ("middle", "tip")]
    mixing = motion_files._marker_mixing(names)
    points = motion_files._points(right, q, mixing)
    back = np.array([[0.0, 45.0, -12.0], [-22.0, 20.0, -12.0], [24.0, 22.0, -12.0]])
    places = np.concatenate([np.broadcast_to(back, (q.shape[0], 3, 3)), points], axis=1)
    turn = Rotation.from_rotvec(np.linspace(0, 1, q.shape[0])[:, None] * [0.4, -0.7, 0.3]).as_matrix()
    places = places @ turn.transpose(0, 2, 1) + [100.0, 50.0, 400.0]
    markers = Markers(("hand_top", "hand_left", "hand_right", *names), places, 100.0)
    monkeypatch.setattr(motion_files, "read_markers", lambda path: markers)
    found = joint_motion(tmp_path / "x.tsv", right, 100.0)
    again = motion_files._points(right, found, mixing)
    distance = np.linalg.norm(np.diff(again, axis=1), axis=-1) - np.linalg.norm(np.diff(points, axis=1), axis=-1)
    assert np.abs(distance).mean() < 6.0  # the palm's seat and the size are found, not given
    bends = [right.model.joint_names.index(f"{finger}_pip") for finger in motion_files.FINGERS[1:]]
    for joint in bends:
        if np.ptp(q[:, joint]) > np.radians(20):
            assert np.corrcoef(q[:, joint], found[:, joint])[0, 1] > 0.8


def test_the_real_recording_gives_a_hand_that_moves_within_its_limits(right):
    q = joint_motion(MOCAP, right, 25.0)
    assert q.shape[0] > 150
    assert np.degrees(np.abs(np.diff(q, axis=0)).max()) < 40.0
    assert np.degrees(np.ptp(q, axis=0)).max() > 15.0


def test_short_gaps_are_filled_and_long_ones_stay():
    t = np.arange(200) / 100.0
    places = np.stack([np.sin(t), np.cos(t), t], axis=1)[:, None] * 100.0
    holes = places.copy()
    holes[50:60], holes[100:150] = np.nan, np.nan
    out = filled(holes, 100.0)
    np.testing.assert_allclose(out[50:60], places[50:60], atol=0.05)
    assert np.isnan(out[100:150]).all() and not np.isnan(out[150:]).any()


@pytest.mark.parametrize(("rate", "fps", "count"), [(100.0, 25.0, 26), (100.0, 100.0, 101), (30.0, 60.0, 201)])
def test_resampling_keeps_the_motion(rate, fps, count):
    q = np.arange(101)[:, None] / rate * np.array([[0.5, -1.0]])
    out = resampled(q, rate, fps)
    assert out.shape[0] == count
    np.testing.assert_allclose(out, np.arange(count)[:, None] / fps * np.array([[0.5, -1.0]]), atol=1e-12)


def test_files_without_fingers_are_refused(tmp_path, right):
    with pytest.raises(InputError, match="no joints of all fingers"):
        joint_motion(DATA / "body_bvh" / "bvh_test1.bvh", right, 30.0)
    with pytest.raises(InputError, match="has no marker 'thumb_middle'"):
        joint_motion(DATA / "body_markers" / "markers.trc", right, 30.0)


def test_a_scene_takes_its_motion_from_a_file(tmp_path, right):
    (tmp_path / "clip.bvh").write_text(CLIP.read_text())
    path = tmp_path / "scene.yaml"
    path.write_text(
        "format: handtrack/scene-1\nimage: {width: 64, height: 48}\nsequence: {frames: 8, fps: 60}\n"
        "hands: [{pose: {type: file, file: clip.bvh}}]\n"
    )
    source = prepare(read_scene(path), 0)
    motion = joint_motion(path.parent / "clip.bvh", right, 60.0)
    for index in (3, 11):
        q = shot(source, index).bodies[0].q
        nearest = np.abs(motion - q[0]).max(axis=1).argmin()
        np.testing.assert_allclose(q[0], motion[nearest])
        np.testing.assert_allclose(q[1], motion[(nearest + 1) % motion.shape[0]])


def test_hands_of_both_sides_have_the_same_axes(right, left):
    (R, middle), (L, other) = own_axes(right), own_axes(left)
    np.testing.assert_allclose(middle * (-1, 1, 1), other, atol=1e-9)
    flip = np.diag([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(L, flip @ R @ flip, atol=1e-9)
    assert len(KEYPOINTS) == 21 and read_markers(MOCAP).rate == 100.0
