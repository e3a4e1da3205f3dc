"""A written sequence is read back as it was made; simulated edge points lie on the silhouette."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handtrack.camera import orthographic, perspective, rays
from handtrack.errors import InputError
from handtrack.kinematics import forward
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.pills import clearance, pose_pills
from handtrack.sequences import open_sequence
from synth.edge_points import simulate_edge_points
from synth.scene import image
from synth.scenes import index_thumb_pinch, random_motion, two_finger_crossing
from synth.sequence import write_sequence

SIZE = (160, 120)


def test_a_written_sequence_reads_back_as_it_was_made(tmp_path: Path) -> None:
    made = two_finger_crossing(2, frames=3, size=SIZE, scale=0.8, start_error=3.0)
    seen: list[int] = []
    write_sequence(tmp_path / "clip", made, done=seen.append)
    back = open_sequence(tmp_path / "clip")
    assert seen == [1, 2, 3] and back.warnings == () and back.fps == 25.0
    assert back.truth is not None and back.start is not None
    np.testing.assert_allclose(back.truth.q, made.truth, atol=1e-11)
    np.testing.assert_allclose(back.start, made.start, atol=1e-11)
    np.testing.assert_array_equal(back.camera.R, made.camera.R)
    assert back.model.joint_names == made.model.joint_names
    for frame in range(3):
        np.testing.assert_array_equal(back.frames.read(frame), image(made, frame))


def test_a_video_in_perspective_with_distortion_reads_back(tmp_path: Path) -> None:
    made = index_thumb_pinch(2, frames=4, size=SIZE, scale=0.75)
    made = replace(made, camera=replace(made.camera, distortion=np.array([-0.1, 0.01, 0.001, 0.0, 0.0])))
    write_sequence(tmp_path / "clip", made, video=True)
    back = open_sequence(tmp_path / "clip")
    np.testing.assert_array_equal(back.camera.distortion, made.camera.distortion)
    assert len(back.frames) == 4
    assert np.abs(back.frames.read(3) - image(made, 3)).mean() < 4.0


def test_colour_is_written_in_the_right_order_and_reads_back_as_grey(tmp_path: Path) -> None:
    made = replace(two_finger_crossing(2, frames=1, size=SIZE, scale=0.8, noise=0.0), colour=True)
    write_sequence(tmp_path / "clip", made)
    back = open_sequence(tmp_path / "clip").frames.read(0)
    np.testing.assert_allclose(back, image(made, 0) @ [0.299, 0.587, 0.114], atol=0.6)


def test_a_sliding_joint_is_written_in_model_units(tmp_path: Path) -> None:
    made = random_motion(1, builtin_model("pr"), frames=3, size=SIZE)
    write_sequence(tmp_path / "clip", made)
    back = open_sequence(tmp_path / "clip")
    assert back.truth is not None
    np.testing.assert_allclose(back.truth.q, made.truth, atol=1e-10)


def test_a_folder_in_use_is_left_alone_unless_it_may_be_replaced(tmp_path: Path) -> None:
    made = two_finger_crossing(2, frames=1, size=SIZE, scale=0.8)
    (tmp_path / "clip").mkdir()
    (tmp_path / "clip" / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match=r"already exists and is not empty"):
        write_sequence(tmp_path / "clip", made)
    assert (tmp_path / "clip" / "mine.txt").read_text() == "keep"
    write_sequence(tmp_path / "clip", made, replace=True)
    assert open_sequence(tmp_path / "clip").truth is not None


def test_simulated_edge_points_lie_on_the_silhouette_of_their_link() -> None:
    model = builtin_model("two_finger")
    q = np.radians([10.0, 20.0, 10.0, -15.0, 15.0, 8.0])
    camera = two_finger_crossing(1).camera
    points = simulate_edge_points(model, q, camera, marks=5)
    assert points.xy.shape == (60, 2) and points.tip_link.tolist() == [2, 5]
    pills = pose_pills(model, forward(model, q), camera)
    off = clearance(pills, points.link, *rays(camera, points.xy)).distance
    np.testing.assert_allclose(off, 0.0, atol=1e-9)
    assert (points.side.reshape(6, 2, 5) == np.array([1, -1])[:, None]).all()


def test_marks_are_spread_evenly_between_the_ends() -> None:
    model = builtin_model("r")
    camera = orthographic(64, 48, 2.0, 10.0, 20.0, np.eye(3), np.zeros(3))
    points = simulate_edge_points(model, np.array([np.pi / 2]), camera, marks=4)
    np.testing.assert_allclose(points.xy[:4, 1], 20.0 + 10.0 * np.arange(1, 5) / 5, atol=1e-12)
    np.testing.assert_allclose(points.xy[:4, 0] - points.xy[4:, 0], -2.0)  # +v is 90 degrees on from the axis, (9.4)


def test_edge_noise_is_across_the_link_and_repeatable() -> None:
    model, q = builtin_model("r"), np.zeros(1)
    camera = perspective(640, 480, 600.0, 600.0, 320.0, 240.0, np.eye(3), np.array([0.0, 0.0, 30.0]))
    exact = simulate_edge_points(model, q, camera, marks=500)
    noisy = simulate_edge_points(model, q, camera, marks=500, noise=0.5, rng=np.random.default_rng(3))
    again = simulate_edge_points(model, q, camera, marks=500, noise=0.5, rng=np.random.default_rng(3))
    off = noisy.xy - exact.xy
    assert np.abs(off[:, 0]).max() < 1e-9 and off[:, 1].std() == pytest.approx(0.5, rel=0.1)
    assert noisy.xy.tobytes() == again.xy.tobytes() and (noisy.tip_xy != exact.tip_xy).all()


def test_bad_edge_point_arguments_are_named() -> None:
    model, camera = builtin_model("r"), orthographic(64, 48, 2.0, 10.0, 20.0, np.eye(3), np.zeros(3))
    with pytest.raises(ValueError, match=r"marks: 0; wanted at least 1"):
        simulate_edge_points(model, np.zeros(1), camera, marks=0)
    with pytest.raises(ValueError, match=r"noise: 1.0 pixels; wanted >= 0, and a generator"):
        simulate_edge_points(model, np.zeros(1), camera, noise=1.0)
