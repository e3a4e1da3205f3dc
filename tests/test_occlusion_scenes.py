"""Scripted occlusions and injected losses: what the scripts promise is what the rays see."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from handtrack.kinematics import forward, link_ends
from handtrack.visibility import truncated_polygons
from synth.loss_scenes import KINDS, loss_picture, loss_pictures, loss_scene
from synth.occlusion_scenes import MOTIONS, look_alike, occlusion_scene
from synth.scene import posed
from synth.scripted import HIDDEN, covered, finger_joints, finger_names, picture, pictures, shares


def test_the_fingers_look_alike():
    model = look_alike()
    assert model.joint_names == tuple(f"{f}_{p}" for f in ("middle", "index") for p in ("mcp", "pip", "dip"))
    base, tip = link_ends(model, forward(model, np.zeros(6)))
    length = np.linalg.norm(tip - base, axis=1)
    np.testing.assert_allclose(length[:3], length[3:])
    np.testing.assert_allclose(model.link_radius[:3], model.link_radius[3:])
    np.testing.assert_allclose(model.limits[:3], model.limits[3:])
    np.testing.assert_allclose(base[3] - base[0], [22.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("frames", [10, 20, 30])
def test_the_hidden_finger_shows_no_pixel_for_just_so_many_frames(frames):
    for seed in range(2):
        scene = occlusion_scene("hidden", 100 + seed, frames)
        share = scene.finger_share[:, finger_names(scene.scene.model).index(scene.watched)]
        when = np.flatnonzero(scene.hidden)
        assert when.size == frames and when[-1] - when[0] == frames - 1
        assert (share[scene.hidden] < HIDDEN).all() and share[0] > 0.4 and share[-1] > 0.4
        one = scene.scene.material.albedo
        assert (one == one[0]).all()


@pytest.mark.parametrize("motion", MOTIONS)
def test_the_hidden_finger_does_what_the_script_says(motion):
    scene = occlusion_scene("hidden", 7, 20, motion)
    q = np.degrees(scene.scene.truth[:, finger_joints(scene.scene.model, "middle")][:, 0])
    inside = np.flatnonzero(scene.hidden)
    first, last = inside[0], inside[-1]
    came = q[first] - q[first - 3]
    went = q[last] - q[last - 3]
    assert abs(came) > 1.0
    if motion == "still":
        assert abs(q[last] - q[first + 3]) < 0.2
    else:
        assert np.sign(went) == (np.sign(came) if motion == "on" else -np.sign(came)) and abs(went) > 1.0


def test_the_hiding_finger_leaves_on_either_side():
    sides = set()
    for seed in range(5):
        scene = occlusion_scene("hidden", seed, 1)
        apart = np.degrees(scene.scene.truth[:, 3] - scene.scene.truth[:, 0])
        sides.add((np.sign(apart[0]), np.sign(apart[-1])))
    assert len(sides) >= 3


def test_scenes_are_made_again_by_their_seed_and_differ_by_it():
    one, same, other = (occlusion_scene("hidden", seed, 5) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.scene.truth, same.scene.truth)
    np.testing.assert_array_equal(picture(one, 5), picture(same, 5))
    assert one.scene.truth.shape != other.scene.truth.shape or (one.scene.truth != other.scene.truth).any()


def test_shares_are_those_of_the_outlines():
    scene = occlusion_scene("hidden", 2, 2)
    for frame in (0, 4, int(np.flatnonzero(scene.hidden)[0]) - 3):
        its = scene.scene
        whole = truncated_polygons(posed(its, frame), its.camera, its.model.link_finger, n_arc=64).whole
        far, near = shapely.union_all(whole[:3]), shapely.union_all(whole[3:])
        share = shapely.difference(far, near).area / far.area
        np.testing.assert_allclose(scene.finger_share[frame], [share, 1.0], atol=0.01)
        np.testing.assert_allclose(scene.link_share[frame, 2] > 0.0, share > 0.0)


def test_a_board_covers_the_lower_finger_and_nothing_hides_the_other_wholly():
    scene = occlusion_scene("board", 5, 5)
    names = finger_names(scene.scene.model)
    other = 1 - names.index(scene.watched)
    assert scene.hidden.sum() >= 5 and scene.board is not None
    assert scene.finger_share[scene.hidden, other].min() > 0.5
    frame = int(np.flatnonzero(scene.hidden)[2])
    share = covered(scene.board, frame, (480, 640))
    under = share == 1.0
    image = picture(scene, frame)
    assert abs(image[under].mean() - scene.board.grey) < 3.0 and share.min() == 0.0
    without, _ = shares(replace(scene.scene, truth=scene.scene.truth[: frame + 1]))
    assert (without[frame] >= scene.link_share[frame]).all() and without[frame].sum() > scene.link_share[frame].sum()


def test_crossing_fingers_are_hidden_in_part_only():
    scene = occlusion_scene("crossing", 1, 30)
    assert scene.finger_share.min() > 0.2 and scene.scene.truth.shape[0] == 30
    assert next(iter(pictures(scene))).shape == (480, 640)


def test_a_whole_hand_hides_its_middle_finger():
    scene = occlusion_scene("hand", 1, 4)
    assert scene.scene.truth.shape[1] == 21 and scene.hidden.sum() >= 4
    assert finger_names(scene.scene.model) == ("little", "ring", "middle", "index", "thumb")
    ring = scene.finger_share[:, 1]
    assert ring.min() > 0.1, "the other fingers stay in view"


@pytest.mark.parametrize("name", ["hidden", "hand", "board", "crossing"])
def test_motions_stay_inside_the_limits(name):
    scene = occlusion_scene(name, 11, 4).scene
    assert (scene.truth >= scene.model.limits[:, 0] - 1e-12).all()
    assert (scene.truth <= scene.model.limits[:, 1] + 1e-12).all()
    np.testing.assert_array_equal(scene.start, scene.truth[0])


def test_unknown_names_and_lengths_are_refused():
    with pytest.raises(ValueError, match="there are hidden, hand, board, crossing"):
        occlusion_scene("fog", 1, 10)
    with pytest.raises(ValueError, match="wanted 1 to 60"):
        occlusion_scene("hidden", 1, 0)
    with pytest.raises(ValueError, match="at least 40"):
        loss_scene("cut", 1, frames=20)


@pytest.mark.parametrize("kind", KINDS)
def test_an_injection_strikes_the_fingers_that_it_names(kind):
    for seed in (0, 3):
        loss, plain = loss_scene(kind, seed), loss_scene("none", seed)
        moved = np.abs(np.degrees(loss.scene.truth - plain.scene.truth)).reshape(60, 2, 3).max(axis=2)
        if kind in ("cut", "jump"):
            assert (moved[loss.at : loss.until, loss.struck].max(axis=1) > 15.0).all()
            assert moved[: loss.at].max() == 0.0 and moved[:, ~loss.struck].max(initial=0.0) == 0.0
            assert loss.until == 60 or moved[loss.until :].max() == 0.0
        else:
            assert moved.max() == 0.0
        if kind == "forced":
            assert loss.forced is not None
            off = np.abs(np.degrees(loss.forced - loss.scene.truth[loss.at - 1])).reshape(2, 3).max(axis=1)
            assert (off[loss.struck] > 15.0).any() and off[~loss.struck].max(initial=0.0) == 0.0
        assert (kind == "none") == (not loss.struck.any()) and (kind == "none") == (loss.at == 60)


def test_a_covered_camera_sees_nothing_and_other_pictures_are_as_they_were():
    loss, plain = loss_scene("covered", 2), loss_scene("none", 2)
    assert loss_picture(loss, loss.at).max() < 20.0 and loss_picture(loss, loss.until - 1).max() < 20.0
    for frame in (loss.at - 1, loss.until):
        np.testing.assert_array_equal(loss_picture(loss, frame), loss_picture(plain, frame))
    assert next(iter(loss_pictures(loss))).shape == (480, 640)
