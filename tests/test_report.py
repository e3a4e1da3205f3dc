"""The page holds everything it shows, says only what is true, and nothing in it can run by accident."""

import dataclasses
import json
import re
from html.parser import HTMLParser

import av
import numpy as np
import pytest

from handtrack.bound import Bounds
from handtrack.camera import orthographic, perspective, project
from handtrack.kinematics import FrameRow, forward, link_ends, model_from_rows
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.report import RunInfo, draw_overlay, write_overlay, write_report
from handtrack.report import video as video_module
from handtrack.report.figures import small_number
from handtrack.report.fingers import STATUS_COLOURS, fingers_of, rgb, short_name
from handtrack.report.overlay import track_fps
from handtrack.report.page import render_page
from handtrack.report.plots import (
    Frame,
    band_path,
    line_path,
    mirrored_ticks,
    padded_limits,
    status_spans,
    thin,
    tick_values,
)
from handtrack.report.video import find_encoder, write_video
from handtrack.sequences import Truth
from handtrack.track import Track

RUN = RunInfo("clip", 25.0, (("passes", "3"),), (("numpy", "2"),), (("truth.csv", "0123"),))


def camera_for(model, width=160, height=120):
    tips = np.concatenate(link_ends(model, forward(model, np.zeros(len(model.joint_names)))))
    R = np.diag([1.0, -1.0, -1.0])
    return orthographic(width, height, 0.6, width / 2, height / 2, R, -R @ tips.mean(axis=0))


def make_track(model, n=6, sigma=0.02):
    q = 0.05 * np.arange(n)[:, None] * np.ones(len(model.joint_names))
    status = np.array(["tracked"] * n, dtype="<U9")
    status[1:2], status[2:3] = "uncertain", "lost"
    sigmas = np.full(q.shape, sigma)
    return Track(
        joint_names=model.joint_names,
        frame=np.arange(n),
        time=np.arange(n) / 25.0,
        q=q,
        sigma=sigmas,
        covariance=sigmas[:, :, None] ** 2 * np.eye(q.shape[1]),
        information=np.zeros((n, model.free.size, model.free.size)),
        status=status,
        confidence=np.linspace(1.0, 0.5, n),
        residual=np.full(n, 0.3),
        visible=np.full((n, model.link_length.size), 0.75),
        edges=np.full(n, 80),
        seconds=np.full(n, 0.003),
    )


@pytest.fixture(scope="module")
def two_finger():
    model = builtin_model("two_finger")
    return model, camera_for(model), make_track(model)


def images(camera, count):
    return [np.full((camera.height, camera.width), 20.0 + i, dtype=np.float32) for i in range(count)]


def frames_of(path):
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


class Page(HTMLParser):
    """Every attribute that can load something, every element, and all text."""

    def __init__(self, text):
        super().__init__()
        self.references, self.tags, self.words = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.references += [
            value for name, value in attrs if name in ("src", "href", "poster", "data", "action", "srcset")
        ]

    def handle_data(self, data):
        self.words.append(data)


def data_of(page):
    found = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    return json.loads(found[0])


# --- fingers


def test_fingers_of_the_full_hand_have_names_colours_and_all_joints():
    model = builtin_model("full_hand")
    fingers = fingers_of(model)
    assert sorted(finger.name for finger in fingers) == ["index", "little", "middle", "ring", "thumb"]
    assert sorted(joint for finger in fingers for joint in finger.joints) == list(range(21))
    assert sorted(link for finger in fingers for link in finger.links) == list(range(15))
    assert len({finger.colour for finger in fingers}) == 5
    assert not {finger.colour for finger in fingers} & {colour for _, colour in STATUS_COLOURS}


def test_a_joint_that_moves_several_fingers_has_a_group_of_its_own():
    rows = [
        FrameRow(1, 0, joint="wrist_turn"),
        FrameRow(2, 1, joint="a_bend", link_length=5.0, link_radius=(1.0, 1.0)),
        FrameRow(3, 1, a=3.0, joint="b_bend", link_length=5.0, link_radius=(1.0, 1.0)),
        FrameRow(4, 0, joint="spare"),
    ]
    fingers = fingers_of(model_from_rows("claw", rows))
    assert [(finger.name, finger.joints, finger.links) for finger in fingers] == [
        ("a", (1,), (0,)),
        ("b", (2,), (1,)),
        ("spare", (3,), ()),
        ("wrist", (0,), ()),
    ]
    assert short_name("a_bend", fingers[0]) == "bend"
    assert short_name("spare", fingers[2]) == "spare"


def test_fingers_without_a_common_name_are_called_by_their_joints():
    rr = builtin_model("rr")
    assert [finger.name for finger in fingers_of(rr)] == ["theta1, theta2"]
    rows = [FrameRow(i, i - 1, joint=name, link_length=2.0, link_radius=(1.0, 1.0)) for i, name in enumerate("wxyz", 1)]
    assert [finger.name for finger in fingers_of(model_from_rows("snake", rows))] == ["group 1"]


# --- plots


def test_ticks_are_round_and_inside_the_limits():
    for low, high in ((0.0, 1.0), (-7.3, 91.0), (1e-4, 3e-4), (-1.0, 1e5)):
        ticks = tick_values(low, high, 4)
        assert 2 <= ticks.size <= 6
        assert low - 1e-9 <= ticks[0] and ticks[-1] <= high + 1e-9
    for reach in (0.001, 0.11, 0.37, 1.0, 48.0):
        low, zero, high = mirrored_ticks(reach)
        assert zero == 0 and -low == high
        assert 0.37 * reach < high < reach


def test_limits_hold_the_values_and_are_never_empty():
    assert padded_limits(np.array([np.nan]), least=2.0) == (-1.0, 1.0)
    assert padded_limits(np.array([5.0]), least=2.0) == (4.0, 6.0)
    assert padded_limits(np.array([5.0]), least=2.0, zero=True) == pytest.approx((0.0, 5.3))


def test_paths_break_where_there_is_no_value():
    assert line_path(np.arange(3.0), np.array([np.nan, 1.0, 2.5])) == "M1 1L2 2.5"
    assert band_path(np.arange(3.0), np.zeros(3), np.array([np.nan, 1.0, 2.0])) == "M1 1L2 2L2 0L1 0Z"
    assert band_path(np.arange(2.0), np.zeros(2), np.full(2, np.nan)) == ""


def test_thinning_a_long_series_keeps_its_peaks_and_its_ends():
    values = np.sin(np.arange(50_000) / 500.0)
    values[12_345] = 9.0
    values[7] = -9.0
    rows = thin(values)
    assert rows.size < 2500
    assert {0, 7, 12_345, 49_999} <= set(rows.tolist())
    assert (np.diff(rows) > 0).all()


def test_stretches_that_are_not_tracked_meet_half_way_between_frames():
    frame = Frame(np.arange(5.0), np.array(["tracked", "lost", "lost", "uncertain", "tracked"]))
    assert status_spans(frame) == [("lost", 125.0, 625.0), ("uncertain", 625.0, 875.0)]
    assert status_spans(Frame(np.zeros(1), np.array(["lost"]))) == [("lost", 0.0, 1000.0)]
    assert status_spans(Frame(np.zeros(1), np.array(["tracked"]))) == []


def test_small_numbers_get_a_third_decimal():
    assert (small_number(0.0123), small_number(0.0996), small_number(1.0)) == ("0.012", "0.10", "1.00")


# --- overlay


def test_overlay_draws_joints_and_tips_where_the_camera_projects_them(two_finger):
    model, _, track = two_finger
    camera = camera_for(model, 640, 480)
    image = draw_overlay(np.zeros((480, 640), dtype=np.float32), track, 0, model, camera)
    assert image.shape == (480, 640, 3) and image.dtype == np.uint8
    base, tip = (project(camera, p) for p in link_ends(model, forward(model, track.q[0])))
    for x, y in np.rint(base).astype(int):
        assert (image[y, x] == 255).all()
    for finger in fingers_of(model):
        x, y = np.rint(tip[finger.links[-1]]).astype(int)
        assert tuple(image[y, x]) == rgb(finger.colour)


def test_overlay_shows_the_status_colour(two_finger):
    model, camera, track = two_finger
    for row, (_, colour) in enumerate(STATUS_COLOURS):
        image = draw_overlay(np.zeros((camera.height, camera.width), dtype=np.float32), track, row, model, camera)
        assert tuple(image[20, 21]) == rgb(colour)


def test_small_images_are_enlarged_and_stay_aligned(two_finger):
    model, camera, track = two_finger
    image = np.zeros((camera.height, camera.width), dtype=np.float32)
    drawn = draw_overlay(image, track, 0, model, camera)
    assert drawn.shape == (480, 640, 3)
    x, y = np.rint((project(camera, link_ends(model, forward(model, track.q[0]))[0][0]) + 0.5) * 4 - 0.5).astype(int)
    assert (drawn[y, x] == 255).all()


def test_uncertain_tips_have_a_larger_ellipse(two_finger):
    model, _, track = two_finger
    camera = camera_for(model, 640, 480)
    image = np.zeros((480, 640), dtype=np.float32)
    sure = draw_overlay(image, track, 5, model, camera)  # at row 0 the tips move along the line of sight
    unsure = draw_overlay(image, dataclasses.replace(track, covariance=400 * track.covariance), 5, model, camera)
    white = [(picture.min(axis=2) > 120).sum() for picture in (sure, unsure)]
    assert white[1] > white[0] + 60


def test_hidden_links_are_drawn_faintly(two_finger):
    model, _, track = two_finger
    camera = camera_for(model, 640, 480)
    image = np.zeros((480, 640), dtype=np.float32)
    seen = draw_overlay(image, track, 0, model, camera)
    hidden = draw_overlay(image, dataclasses.replace(track, visible=0 * track.visible), 0, model, camera)
    assert hidden.sum() < 0.9 * seen.sum()


def test_pose_outside_the_image_or_behind_the_camera_draws_only_the_caption(two_finger):
    model, _, track = two_finger
    image = np.zeros((480, 640), dtype=np.float32)
    for camera in (
        orthographic(640, 480, 1e6, 1e9, 1e9, np.eye(3), np.zeros(3)),
        perspective(640, 480, 500.0, 500.0, 320.0, 240.0, np.eye(3), np.array([0.0, 0.0, -1e4])),
    ):
        drawn = draw_overlay(image, track, 0, model, camera)
        assert not drawn[40:440].any()
        assert drawn[:40].any()


def test_video_has_every_frame_in_order_and_an_index_at_its_front(two_finger, tmp_path):
    model, camera, track = two_finger
    path = tmp_path / "overlay.mp4"
    pictures = [np.full((camera.height, camera.width), 40.0 * i, dtype=np.float32) for i in range(6)]
    assert write_overlay(path, pictures, track, model, camera) == find_encoder()
    decoded = frames_of(path)
    assert len(decoded) == 6
    levels = [frame[60:420, 600:].mean() for frame in decoded]
    np.testing.assert_allclose(levels, 40.0 * np.arange(6), atol=4)
    data = path.read_bytes()
    assert 0 < data.index(b"moov") < data.index(b"mdat")
    assert [file.name for file in tmp_path.iterdir()] == ["overlay.mp4"]


def test_video_of_odd_size_is_padded_and_plays_at_the_tracks_rate(two_finger, tmp_path):
    model, camera, track = two_finger
    odd = dataclasses.replace(camera, width=641, height=481)
    write_overlay(
        tmp_path / "odd.mp4", images(odd, 6), dataclasses.replace(track, time=np.arange(6) / 10.0), model, odd
    )
    with av.open(str(tmp_path / "odd.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height) == (642, 482)
        assert stream.pix_fmt == "yuv420p"
        assert stream.average_rate == 10


def test_frame_rate_comes_from_the_median_step(two_finger):
    _, _, track = two_finger
    assert track_fps(dataclasses.replace(track, time=np.array([0.0, 0.1, 0.2, 0.9, 1.0, 1.1]))) == pytest.approx(10.0)
    assert track_fps(make_track(builtin_model("r"), 1)) == 25.0


def test_missing_images_are_an_error_that_leaves_nothing_behind(two_finger, tmp_path):
    model, camera, track = two_finger
    with pytest.raises(ValueError, match="frames: 2 images given, the track has 6 rows"):
        write_overlay(tmp_path / "overlay.mp4", images(camera, 2), track, model, camera)
    assert not list(tmp_path.iterdir())


def test_video_without_images_or_rate_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="images: none given"):
        write_video(tmp_path / "v.mp4", [], 25.0)
    with pytest.raises(ValueError, match=r"fps: 0\.0 given"):
        write_video(tmp_path / "v.mp4", [np.zeros((4, 4, 3), dtype=np.uint8)], 0.0)
    assert not list(tmp_path.iterdir())


def test_another_encoder_is_used_where_the_first_is_missing(monkeypatch):
    monkeypatch.setattr(video_module, "_ENCODERS", ("no-such-encoder", "libx264"))
    assert find_encoder() == "libx264"
    monkeypatch.setattr(video_module, "_ENCODERS", ("no-such-encoder",))
    with pytest.raises(RuntimeError, match="no video encoder: one of no-such-encoder was wanted"):
        find_encoder()


# --- page


def test_page_refers_to_nothing_outside_itself(two_finger, tmp_path):
    model, camera, track = two_finger
    video = tmp_path / "overlay.mp4"
    write_overlay(video, images(camera, 6), track, model, camera)
    write_report(tmp_path / "report.html", track, model, camera, video, Truth(track.frame, track.q), RUN)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.references
    assert all(reference.startswith("data:") for reference in page.references)
    assert "http://" not in text and "https://" not in text and "@import" not in text and "url(" not in text
    assert "default-src 'none'" in text
    assert page.tags.count("video") == 1
    assert sorted(file.name for file in tmp_path.iterdir()) == ["overlay.mp4", "report.html"]


def test_page_without_truth_and_without_video_says_so(two_finger):
    model, camera, track = two_finger
    text = render_page(track, model, camera, None, None, RUN)
    assert "video" not in Page(text).tags
    assert "No video was written" in text
    assert "RMSE" not in "".join(re.findall(r'<div class="tile">.*?</div>', text))
    assert all("t" not in series for chart in data_of(text)["charts"].values() for series in chart["series"])


def test_page_tells_the_figures_of_the_evaluation(two_finger):
    model, camera, track = two_finger
    truth = Truth(track.frame, track.q - np.radians(1.5))
    text = render_page(track, model, camera, None, truth, RUN)
    tiles = dict(re.findall(r'<div class="tile"><span>(.*?)</span><b>(.*?)</b>', text))
    assert tiles["Worst-joint RMSE"] == "1.50\N{DEGREE SIGN}"
    assert tiles["Frames"] == "6"
    assert tiles["Tracked"].startswith("66.7")
    assert tiles["Time per frame"].startswith("3.00")
    assert tiles["Median sigma"] == "1.15\N{DEGREE SIGN}"
    assert "NEES, ideally 6" in tiles


def test_page_says_how_near_the_errors_are_to_the_bound_where_there_is_one(two_finger):
    model, camera, track = two_finger
    truth = Truth(track.frame, track.q - np.radians(1.5))
    least = np.radians(np.tile([0.5, 0.5, 0.5, 0.5, 0.5, np.inf], (2, 1)))
    known = Bounds(np.array([0, 5]), least, np.ones((2, 1)), True)
    text = render_page(track, model, camera, None, truth, RUN, known)
    assert text.count("3.0 \N{MULTIPLICATION SIGN} bound") == 5  # the images say nothing of the sixth joint
    assert "3.0 times the Cram\N{LATIN SMALL LETTER E WITH ACUTE}r-Rao bound" in text
    assert "bound" not in "".join(re.findall(r'<div class="tile">.*?</div>', render_page(*two_finger_page(two_finger))))


def two_finger_page(two_finger):
    model, camera, track = two_finger
    return track, model, camera, None, Truth(track.frame, track.q), RUN


def test_a_rival_is_drawn_where_it_differs_and_named_once(two_finger):
    model, camera, track = two_finger
    rival = track.q.copy()
    rival[2:4, 0] += np.radians(12.0)
    rival[[0, 5]] = np.nan
    other = dataclasses.replace(track, rival=rival, rival_weight=np.array([0.0, 0.1, 0.2, 0.3, 0.1, 0.0]))
    text = render_page(other, model, camera, None, None, RUN)
    assert len(re.findall(r'<path class="rival c\d"', text)) == 1
    assert text.count("a pose that looks the same") == 1
    plain = render_page(track, model, camera, None, None, RUN)
    assert 'class="rival' not in plain and "a pose that looks the same" not in plain


def test_values_under_the_pointer_are_those_of_the_track_in_degrees(two_finger):
    model, camera, track = two_finger
    truth = Truth(track.frame[:4], track.q[:4] + 0.01)
    data = data_of(render_page(track, model, camera, None, truth, RUN))
    assert data["frame"] == list(range(6))
    assert data["status"][:3] == ["tracked", "uncertain", "lost"]
    first = data["charts"]["q0"]["series"][0]
    joint = fingers_of(model)[0].joints[0]
    np.testing.assert_allclose(first["v"], np.degrees(track.q[:, joint]), atol=1e-4)
    np.testing.assert_allclose(first["s"], np.degrees(track.sigma[:, joint]), atol=1e-4)
    assert first["t"][4:] == [None, None]
    error = data["charts"][f"e{joint}"]["series"][0]["v"]
    np.testing.assert_allclose(error[:4], -np.degrees(0.01), atol=1e-4)


def test_every_chart_has_its_values_and_every_joint_its_row(two_finger):
    model, camera, track = two_finger
    text = render_page(track, model, camera, None, Truth(track.frame, track.q), RUN)
    named = re.findall(r'<div class="chart [a-z]*" data-chart="([^"]+)"', text)
    assert sorted(named) == sorted(data_of(text)["charts"])
    assert all(name in text for name in model.joint_names)
    assert len(re.findall(r"<tr data-chart", text)) == len(model.joint_names)


def test_page_holds_no_nan(two_finger):
    model, camera, track = two_finger
    truth = Truth(track.frame[:2], np.where(np.arange(6) == 3, np.nan, track.q[:2]))
    text = render_page(track, model, camera, None, truth, RUN)
    assert not re.search(r"\bnan\b", text, re.IGNORECASE)
    assert not re.search(r"\binf\b", text)


def test_frames_without_edges_leave_gaps_not_nan(two_finger):
    model, camera, track = two_finger
    some = np.where(np.arange(6) == 2, np.nan, 0.25)
    text = render_page(dataclasses.replace(track, residual=some), model, camera, None, None, RUN)
    assert "<b>0.25\N{NO-BREAK SPACE}px</b>" in text
    assert data_of(text)["charts"]["residual"]["series"][0]["v"][2] is None
    none = render_page(dataclasses.replace(track, residual=np.full(6, np.nan)), model, camera, None, None, RUN)
    assert "<b>none</b>" in none and "no values" in none
    assert not re.search(r"\bnan\b", text + none, re.IGNORECASE)


def test_words_of_the_user_are_shown_and_never_run(two_finger):
    model, camera, track = two_finger
    nasty = "</script><script>alert(1)</script><img src=x onerror=alert(2)> & \"'$title"
    run = RunInfo(nasty, 25.0, ((nasty, nasty),), ((nasty, nasty),), ((nasty, nasty),), (nasty,))
    named = dataclasses.replace(model, name=nasty, units=nasty)
    page = Page(render_page(track, named, camera, None, None, run))
    plain = Page(render_page(track, model, camera, None, None, dataclasses.replace(run, title="x")))
    assert page.tags.count("script") == plain.tags.count("script") == 2
    assert "img" not in page.tags
    assert sum(nasty in words for words in page.words) >= 5


def test_page_is_the_same_bytes_for_the_same_run(two_finger, tmp_path):
    model, camera, track = two_finger
    for name in ("a", "b"):
        write_overlay(tmp_path / f"{name}.mp4", images(camera, 6), track, model, camera)
        write_report(tmp_path / f"{name}.html", track, model, camera, tmp_path / f"{name}.mp4", None, RUN)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_models_that_slide_are_shown_in_their_units():
    model = builtin_model("pr")
    camera = orthographic(100, 100, 2.0, 50.0, 50.0, np.eye(3), np.zeros(3))
    track = make_track(model)
    text = render_page(track, model, camera, None, Truth(track.frame, track.q), RUN)
    data = data_of(text)["charts"]
    assert {data["q0"]["unit"], data["q0d"]["unit"]} == {"\N{DEGREE SIGN}", f" {model.units}"}
    only_slide = render_page(make_track(builtin_model("p")), builtin_model("p"), camera, None, None, RUN)
    assert "Median sigma" not in only_slide


def test_track_of_one_frame_and_long_tracks_are_shown():
    model = builtin_model("r")
    camera = orthographic(100, 100, 2.0, 50.0, 50.0, np.eye(3), np.zeros(3))
    assert "over 0.00" in render_page(make_track(model, 1), model, camera, None, None, RUN)
    slow_start = dataclasses.replace(make_track(model, 9), seconds=np.array([1.5] + [0.002] * 8))
    assert "first 1500" in render_page(slow_start, model, camera, None, None, RUN)


def test_share_is_never_rounded_up_to_all():
    model = builtin_model("r")
    camera = orthographic(100, 100, 2.0, 50.0, 50.0, np.eye(3), np.zeros(3))
    status = np.array(["lost"] + ["tracked"] * 2999)
    text = render_page(dataclasses.replace(make_track(model, 3000), status=status), model, camera, None, None, RUN)
    assert "<b>99.9\N{NO-BREAK SPACE}%</b>" in text


def test_empty_track_is_refused_and_nothing_written(two_finger, tmp_path):
    model, camera, track = two_finger
    arrays = {name: getattr(track, name) for name in Track.__slots__ if isinstance(getattr(track, name), np.ndarray)}
    empty = dataclasses.replace(track, **{name: values[:0] for name, values in arrays.items()})
    with pytest.raises(ValueError, match="track: has no frames"):
        write_report(tmp_path / "report.html", empty, model, camera, None, None, RUN)
    assert not list(tmp_path.iterdir())
