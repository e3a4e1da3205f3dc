"""Several views: files in step, cameras in order, and one clear line where they are not."""

import json
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from handtrack.camera import orthographic, perspective, project
from handtrack.errors import InputError
from handtrack.formats.cameras import cameras_text, read_camera, read_cameras
from handtrack.kinematics import forward, link_ends
from handtrack.sequences import Sequence, open_images, open_sequence
from handtrack.tracker import track
from synth.raycast import cast
from synth.scenes import Scene, image, images_together, posed, scene, two_finger_crossing
from synth.sequence import write_sequence
from synth.views import turned, with_views

FRONT = {
    "type": "orthographic",
    "width": 16,
    "height": 12,
    "scale": 3.2,
    "cx": 8,
    "cy": 6,
    "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "t": [0, 0, 0],
}
SIDE = FRONT | {"width": 8, "R": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]}
START = {"theta1": 10.0, "theta2": -20.5}


def pictures(folder: Path, count: int = 3, width: int = 16, base: int = 0) -> None:
    folder.mkdir(parents=True)
    for i in range(count):
        Image.fromarray(np.full((12, width), base + 10 * i, np.uint8)).save(folder / f"{i:06d}.png")


def film(path: Path, count: int = 4, rate: int = 25, width: int = 16, stamps: list[int] | None = None) -> Path:
    """A video whose frame n is n * 40 grey; `stamps` in frames."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.width, stream.height, stream.pix_fmt = width, 12, "yuv420p"
        for i in range(count):
            frame = av.VideoFrame.from_ndarray(np.full((12, width, 3), 40 * i, np.uint8), format="rgb24")
            frame.pts = i if stamps is None else stamps[i]
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def clip(folder: Path, counts: tuple[int, int] = (3, 3), **changes: object) -> Path:
    """A sequence of two views, 16 and 8 pixels wide, grey 0, 10, 20 and 100, 110, 120."""
    pictures(folder / "left", counts[0])
    pictures(folder / "right", counts[1], 8, 100)
    entry = {
        "format": "handtrack/sequence-1",
        "fps": 25,
        "frames": ["left/*.png", "right/*.png"],
        "camera": [FRONT, SIDE],
        "model": "rr",
        "start": START,
        **changes,
    }
    (folder / "sequence.yaml").write_text(json.dumps(entry, indent=1))
    return folder


def opened_videos(*paths: Path, **options: float) -> Sequence:
    camera = orthographic(16, 12, 1.0, 8.0, 6.0, np.eye(3), np.zeros(3))
    other = replace(camera, t=np.array([1.0, 0.0, 0.0]))
    return open_images(list(paths), "rr", [camera, other][: len(paths)], START, **options)


# --- files


def test_views_of_different_sizes_come_in_step(tmp_path):
    sequence = open_sequence(clip(tmp_path / "a"))
    assert sequence.warnings == ()
    assert [camera.width for camera in sequence.cameras] == [16, 8]
    assert sequence.names == ("left", "right")
    assert len(sequence) == 3
    together = list(sequence)
    assert [picture.shape for picture in together[0]] == [(12, 16), (12, 8)]
    assert [[picture[0, 0] for picture in pair] for pair in together] == [[0, 100], [10, 110], [20, 120]]
    np.testing.assert_allclose(sequence.times, [0, 0.04, 0.08])
    assert sequence.camera is sequence.cameras[0] and sequence.frames is sequence.views[0]


def test_one_view_may_be_written_as_a_list(tmp_path):
    sequence = open_sequence(clip(tmp_path / "a", frames=["left/*.png"], camera=[FRONT]))
    assert len(sequence.cameras) == len(sequence.views) == 1
    assert [[picture[0, 0] for picture in pictures] for pictures in sequence] == [[0], [10], [20]]


def test_each_video_of_a_pair_is_decoded_in_step(tmp_path):
    folder = clip(tmp_path / "a", frames=["l.mp4", "r.mp4"], camera=[FRONT, SIDE | {"width": 16}])
    film(folder / "l.mp4")
    film(folder / "r.mp4")
    sequence = open_sequence(folder)
    assert sequence.names == ("l.mp4", "r.mp4")
    means = [[float(picture.mean()) for picture in pair] for pair in sequence]
    np.testing.assert_allclose(means, np.array([[0, 40, 80, 120]] * 2).T, atol=4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera": FRONT}, r"sequence.yaml: line \d+: camera: 1 camera for 2 views in `frames`; one for each view"),
        ({"frames": "left/*.png"}, r"camera: 2 cameras for 1 view in `frames`"),
        ({"camera": [FRONT, SIDE, SIDE]}, r"3 cameras for 2 views"),
        ({"frames": [], "camera": []}, r"frames: \[\] given; wanted: a list with at least 1 item"),
        ({"frames": ["left/*.png", 3]}, r"frames\[1\]: 3 given; wanted: a string"),
        ({"frames": ["left/*.png", "up/*.png"]}, r"frames\[1\]: 'up/\*.png' matches nothing"),
        ({"frames": ["left/*.png", "../right/*.png"]}, r"frames\[1\]: .* leaves the folder by '..'"),
        ({"frames": ["left/*.png", "left/*.png"], "camera": [FRONT, FRONT]}, r"000000.png: is given for two views"),
        ({"camera": [SIDE, FRONT]}, r"left/000000.png: is 16 x 12 pixels; 8 x 12, the camera's size, is wanted"),
        ({"camera": [FRONT, SIDE | {"scale": -1}]}, r"camera\[1\].scale: -1 given; wanted"),
        ({"camera": [FRONT, SIDE | {"R": np.ones((3, 3)).tolist()}]}, r"camera\[1\].R: is no rotation"),
        ({"camera": [FRONT, {"type": "fisheye"}]}, r"camera\[1\]: its 'type' must be one of"),
    ],
)
def test_views_that_do_not_fit_are_one_clear_line(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        open_sequence(clip(tmp_path / "a", **changes))


def test_image_folders_of_unequal_number_are_refused(tmp_path):
    wanted = r"right/000000.png and on: 2 frames where .*left/000000.png and on has 3; the same number in every view"
    with pytest.raises(InputError, match=wanted):
        open_sequence(clip(tmp_path / "a", (3, 2)))


def test_a_longer_video_is_cut_to_the_shortest_with_a_warning(tmp_path):
    sequence = opened_videos(film(tmp_path / "a.mp4", 4), film(tmp_path / "b.mp4", 3))
    assert sequence.warnings[-1].endswith("1 of 4 frames of " + str(tmp_path / "a.mp4") + " are left out")
    assert len(sequence) == len(list(sequence)) == len(sequence.times) == 3
    assert sequence.frames.read(2).mean() == pytest.approx(80, abs=4)


def test_a_video_beside_images_must_be_as_long(tmp_path):
    pictures(tmp_path / "left", 3)
    with pytest.raises(InputError, match=r"left/000000.png and on: 3 frames where .*b.mp4 has 4"):
        opened_videos(tmp_path / "left", film(tmp_path / "b.mp4", 4))
    sequence = opened_videos(tmp_path / "left", film(tmp_path / "c.mp4", 3, rate=50))
    assert sequence.fps == 50.0 and sequence.warnings == ()
    np.testing.assert_allclose(sequence.times, [0, 0.02, 0.04])


def test_videos_out_of_step_are_refused_whatever_rate_is_said(tmp_path):
    slow, fast = film(tmp_path / "slow.mp4", rate=25), film(tmp_path / "fast.mp4", rate=50)
    wanted = r"fast.mp4: frame 2 is 0.04 s after its first, that of .*slow.mp4 0.08 s; .* half a frame, 0.02 s, are"
    for options in ({}, {"fps": 30.0}):
        with pytest.raises(InputError, match=wanted):
            opened_videos(slow, fast, **options)
    folder = clip(tmp_path / "a", frames=["l.mp4", "r.mp4"], camera=[FRONT, SIDE | {"width": 16}])
    film(folder / "l.mp4")
    film(folder / "r.mp4", rate=50)
    with pytest.raises(InputError, match="views in step within half a frame"):
        open_sequence(folder)


def test_a_frame_that_one_camera_dropped_is_noticed(tmp_path):
    whole, dropped = film(tmp_path / "whole.mp4"), film(tmp_path / "dropped.mp4", stamps=[0, 1, 3, 4])
    with pytest.raises(InputError, match=r"dropped.mp4: frame 2 is 0.12 s after its first"):
        opened_videos(whole, dropped)


def test_every_input_has_its_camera(tmp_path):
    paths = [film(tmp_path / "a.mp4"), film(tmp_path / "b.mp4")]
    camera = orthographic(16, 12, 1.0, 8.0, 6.0, np.eye(3), np.zeros(3))
    with pytest.raises(InputError, match="camera: 1 camera for 2 views; one for each view, in the same order"):
        open_images(paths, "rr", camera)
    with pytest.raises(InputError, match=r"nothing.mp4: no such file or folder"):
        open_images([paths[0], tmp_path / "nothing.mp4"], "rr", [camera, camera])
    with pytest.raises(InputError, match=r"a.mp4: is given for two views"):
        open_images([paths[0], tmp_path / "." / "a.mp4"], "rr", [camera, camera])
    both = open_images(paths, "rr", [camera, camera])
    assert both.warnings == ("camera[1]: stands where camera[0] stands; another place says more of the depth",)


def test_a_camera_file_may_hold_all_cameras(tmp_path):
    cameras = (
        perspective(16, 12, 20.0, 21.0, 8.0, 6.0, np.eye(3), np.zeros(3), np.array([0.1, 0.0, 0.0, 0.0, 0.0])),
        orthographic(16, 12, 3.2, 8.0, 6.0, np.diag([-1.0, 1.0, -1.0]), np.array([0.1, 2.0 / 3.0, 3.0])),
    )
    (tmp_path / "camera.yaml").write_text(cameras_text(cameras))
    again = read_cameras(tmp_path / "camera.yaml")
    for camera, back in zip(cameras, again, strict=True):
        assert (back.kind, back.fx, back.fy) == (camera.kind, camera.fx, camera.fy)
        for name in ("R", "t", "distortion"):
            np.testing.assert_array_equal(getattr(back, name), getattr(camera, name))
    paths = [film(tmp_path / "a.mp4"), film(tmp_path / "b.mp4")]
    assert len(open_images(paths, "rr", tmp_path / "camera.yaml").cameras) == 2
    with pytest.raises(InputError, match=r"camera.yaml: camera: has 2 cameras; one is wanted here"):
        read_camera(tmp_path / "camera.yaml")


def test_views_are_named_after_what_tells_them_apart(tmp_path):
    folder = clip(tmp_path / "a")
    for source, target in (("left", "l"), ("right", "r")):
        for path in (folder / source).iterdir():
            path.rename(folder / f"{target}_{path.name}")
    (folder / "sequence.yaml").write_text((folder / "sequence.yaml").read_text().replace("left/", "l_"))
    (folder / "sequence.yaml").write_text((folder / "sequence.yaml").read_text().replace("right/", "r_"))
    assert open_sequence(folder).names == ("l", "r")
    deep = clip(tmp_path / "b", frames=["left/x/*.png", "right/x/*.png"])
    for side in ("left", "right"):
        (deep / side / "x").mkdir()
        for path in list((deep / side).glob("*.png")):
            path.rename(deep / side / "x" / path.name)
    assert open_sequence(deep).names == ("view0", "view1")


# --- scenes


def test_further_cameras_look_at_the_hand_from_sixty_degrees():
    for name in ("two-finger-crossing", "full-hand-spread", "index-thumb-pinch"):
        made = with_views(scene(name, 1, frames=30), 3)
        assert len(made.cameras) == 3 and made.cameras[0] is made.camera
        first = made.camera.R
        for camera, angle in zip(made.more_cameras, (-60.0, 60.0), strict=True):
            about_y = camera.R @ first.T
            np.testing.assert_allclose(about_y[1], [0.0, 1.0, 0.0], atol=1e-12)
            assert np.degrees(np.arctan2(about_y[0, 2], about_y[0, 0])) == pytest.approx(angle)
        ends = np.concatenate(link_ends(made.model, forward(made.model, made.truth)), axis=1)
        for camera in made.cameras:
            xy = project(camera, ends)
            assert (xy > 0).all() and (xy < [camera.width, camera.height]).all()


def test_the_point_turned_about_keeps_its_pixel_and_depth():
    camera = perspective(640, 480, 600.0, 610.0, 320.0, 240.0, np.eye(3), np.array([5.0, -3.0, 200.0]))
    point = np.array([12.0, 7.0, 31.0])
    for angle in (-1.0, 0.4, 2.0):
        np.testing.assert_allclose(project(turned(camera, point, angle), point), project(camera, point), atol=1e-9)


def test_every_view_shows_the_true_pose_with_noise_of_its_own():
    made = with_views(two_finger_crossing(2, frames=2, size=(160, 120), scale=0.8), 2)
    first, second = next(images_together(made))
    np.testing.assert_array_equal(first, image(two_finger_crossing(2, frames=2, size=(160, 120), scale=0.8), 0))
    empty = [cast(posed(made, 0, view), made.cameras[view]).part < 0 for view in (0, 1)]
    for picture, none in zip((first, second), empty, strict=True):
        assert picture[none].mean() < 0.3 * picture[~none].mean()
    corner = np.s_[:20, :20]
    assert abs(np.corrcoef(first[corner].ravel(), second[corner].ravel())[0, 1]) < 0.3


def test_the_light_stands_still_while_the_camera_turns():
    made = replace(with_views(two_finger_crossing(2, frames=1, size=(160, 120), scale=0.8, noise=0.0), 2), mode="phong")
    moved = replace(made, camera=made.cameras[1], more_cameras=())
    lit, carried = image(made, 0, 1), image(moved, 0)
    assert np.abs(lit - carried).max() > 10.0  # a light that moved with the camera would give the same image


def test_the_number_of_views_is_bounded():
    for count in (0, 6):
        with pytest.raises(ValueError, match=f"count: {count} views; wanted 1 to 5"):
            with_views(two_finger_crossing(1, frames=1), count)


@pytest.mark.parametrize("video", [False, True])
def test_a_written_sequence_of_two_views_reads_back(tmp_path, video):
    made = with_views(two_finger_crossing(2, frames=3, size=(160, 120), scale=0.8), 2)
    seen: list[int] = []
    write_sequence(tmp_path / "clip", made, video=video, done=seen.append)
    back = open_sequence(tmp_path / "clip")
    assert back.warnings == () and seen == [1, 2, 3, 4, 5, 6]
    assert back.names == (("view0.mp4", "view1.mp4") if video else ("view0", "view1"))
    for camera, true in zip(back.cameras, made.cameras, strict=True):
        np.testing.assert_array_equal(camera.R, true.R)
        np.testing.assert_array_equal(camera.t, true.t)
    for pair, true in zip(back, images_together(made), strict=True):
        for picture, exact in zip(pair, true, strict=True):
            assert np.abs(picture - exact).mean() < (4.0 if video else 1e-6)


# --- tracking


@pytest.fixture(scope="module")
def hand() -> Scene:
    return with_views(scene("full-hand-spread", 1, frames=8), 2)


def test_a_second_view_makes_the_pose_surer(hand):
    one = track((pair[:1] for pair in images_together(hand)), hand.model, [hand.camera], hand.start, hand.fps)
    two = track(images_together(hand), hand.model, hand.cameras, hand.start, hand.fps)
    assert (two.sigma[-1] < 1.1 * one.sigma[-1]).all()  # the noise in it is estimated from the frames themselves
    assert np.median(two.sigma[-1]) < 0.6 * np.median(one.sigma[-1])
    thumb = [joint for joint, name in enumerate(hand.model.joint_names) if name.startswith("thumb")]
    assert np.degrees(np.abs(two.q - hand.truth)[:, thumb].max()) < 0.3
    known, alone = (np.linalg.eigvalsh(found.information[-1])[0] for found in (two, one))
    assert known > 4.0 * alone  # the weakest direction of one view
