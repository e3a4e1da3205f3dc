"""Pose-FF: the pelvis from the camera alone, with the suit's postures."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handtrack.body import pose_filter
from handtrack.body.suit_body import body_of_walk
from handtrack.body.walk_metrics import WalkErrors, walk_errors, walk_figures, yaw_of
from handtrack.body.walk_run import follow_walk
from handtrack.body.walk_settings import Settings
from handtrack.formats.walk_tracks import WalkTrack
from handtrack.formats.walks import Walk
from synth.walk import WalkScene, WalkSettings, make_walk

TOLD = Settings(method="pose-ff")


@pytest.fixture(scope="module")
def scene() -> WalkScene:
    return make_walk(3, WalkSettings(seconds=20.0))


@pytest.fixture(scope="module")
def track(scene: WalkScene) -> WalkTrack:
    return follow_walk(scene.walk, body_of_walk(scene.walk), TOLD)


def errors_of(scene: WalkScene, track: WalkTrack) -> WalkErrors:
    assert scene.walk.truth is not None
    return walk_errors(track, scene.walk.truth)


def drifting(walk: Walk, metres: float, degrees: float) -> Walk:
    """The same walk seen by a suit whose frame also drifts away from the first frame on."""
    share = np.linspace(0.0, 1.0, walk.time.size)
    turn = Rotation.from_rotvec(np.radians(degrees) * share[:, None] * np.array([0.0, 0.0, 1.0]))
    p = np.stack([turn.apply(walk.p[:, i]) for i in range(13)], axis=1)
    p[..., 0] += metres * share[:, None]
    wxyz = np.stack(
        [(turn * Rotation.from_quat(walk.wxyz[:, i], scalar_first=True)).as_quat(scalar_first=True) for i in range(13)],
        axis=1,
    )
    return replace(walk, p=p, wxyz=wxyz)


def test_in_view_the_person_is_found(scene: WalkScene, track: WalkTrack):
    errors = errors_of(scene, track)
    sure = track.in_view & np.isin(track.status, ("tracked",))
    assert sure.sum() > 20
    assert np.median(errors.place[sure]) < 0.25
    assert np.median(np.abs(errors.heading[sure])) < np.radians(15.0)


def test_drift_of_the_suit_does_not_matter(scene: WalkScene, track: WalkTrack):
    walk = drifting(scene.walk, 20.0, 90.0)
    other = follow_walk(walk, body_of_walk(walk), TOLD)
    np.testing.assert_allclose(other.p, track.p, atol=2e-3)
    turned = yaw_of(other.wxyz) - yaw_of(track.wxyz)
    assert np.abs(np.arctan2(np.sin(turned), np.cos(turned))).max() < np.radians(1.0)


def test_out_of_view_nothing_is_known(scene: WalkScene, track: WalkTrack):
    gone = ~track.in_view
    assert track.sigma[gone, 0].max() > 4.0 * np.median(track.sigma[track.in_view, 0])
    assert "lost" in set(track.status[gone])


def test_found_again_after_each_time_out_of_view(scene: WalkScene, track: WalkTrack):
    errors = errors_of(scene, track).place
    back = np.flatnonzero(track.in_view[1:] & ~track.in_view[:-1]) + 1
    back = back[back + 5 < track.frame.size]
    back = back[[track.in_view[k : k + 5].all() for k in back]]
    assert back.size
    for k in back:
        assert errors[k + 4] < 0.5


def test_worse_than_the_suit_with_its_drift_undone(scene: WalkScene, track: WalkTrack):
    pose = walk_figures(track, scene.walk.truth)
    drift = follow_walk(scene.walk, body_of_walk(scene.walk), Settings(method="drift-ff"))
    better = walk_figures(drift, scene.walk.truth)
    assert pose is not None and better is not None
    assert better.mean < 0.5 * pose.mean and better.out_of_view < 0.2 * pose.out_of_view


def test_the_pelvis_tilt_is_the_suits(scene: WalkScene, track: WalkTrack):
    found = Rotation.from_quat(track.wxyz, scalar_first=True).as_matrix()[:, 2]
    suit = Rotation.from_quat(scene.walk.wxyz[:, 0], scalar_first=True).as_matrix()[:, 2]
    np.testing.assert_allclose(found, suit, atol=1e-7)


def test_begins_where_the_suit_does_until_the_camera_speaks(scene: WalkScene):
    walk = scene.walk
    blind = replace(walk, uv=np.full_like(walk.uv, np.nan), confidence=np.zeros_like(walk.confidence))
    found = follow_walk(blind, body_of_walk(walk), TOLD)
    assert np.linalg.norm(found.p[0] - walk.p[0, 0]) < 0.15
    assert found.status[-1] == "lost" and not found.in_view.any()
    assert found.sigma[-1, 0] > 5.0 * found.sigma[0, 0]


def test_begin_has_no_particles_yet(scene: WalkScene):
    assert pose_filter.begin(body_of_walk(scene.walk), TOLD).cloud.x.shape == (0, 6)
