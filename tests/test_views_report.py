"""What a run of several views says of each: landmarks, video, page, record and command line."""

import json
import re
from dataclasses import replace

import av
import numpy as np
import pytest

from handtrack.camera import orthographic, project
from handtrack.cli import main
from handtrack.cli.rendering import write_scene
from handtrack.evaluate import evaluate, landmark_joints, landmarks
from handtrack.formats import read_cameras, read_track
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.report import RunInfo, draw_overlay, write_overlay
from handtrack.report.mosaic import side_by_side
from handtrack.report.page import render_page
from handtrack.sequences import Truth
from handtrack.track import Track
from handtrack.view_errors import as_data, as_text, evaluate_views
from synth.scenes import two_finger_crossing
from synth.views import turned, with_views

RUN = RunInfo("clip", 25.0, views=("left <1>", "right"))
MODEL = builtin_model("two_finger")


def cameras(count=2, width=160, height=120):
    first = replace(two_finger_crossing(1, frames=1, size=(160, 120), scale=0.8).camera, width=width, height=height)
    return tuple(turned(first, np.array([0.0, 60.0, 0.0]), 0.9 * number) for number in range(count))


def make_track(n=5, views=2):
    q = 0.05 * np.arange(n)[:, None] * np.ones(6)
    sigma = np.full(q.shape, 0.02)
    view_edges = np.arange(n)[:, None] + 10 * np.arange(1, views + 1)
    visible = np.linspace(0.1, 1.0, views)[None, :, None] * np.ones((n, 1, 6))
    return Track(
        joint_names=MODEL.joint_names,
        frame=np.arange(n),
        time=np.arange(n) / 25.0,
        q=q,
        sigma=sigma,
        covariance=sigma[:, :, None] ** 2 * np.eye(6),
        information=np.zeros((n, 6, 6)),
        status=np.full(n, "tracked"),
        confidence=np.ones(n),
        residual=np.full(n, 0.3),
        visible=visible.max(axis=1),
        edges=view_edges.sum(axis=1),
        seconds=np.full(n, 0.003),
        view_edges=view_edges,
        view_visible=visible,
    )


def data_of(page):
    found = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    return json.loads(found[0])


# --- landmarks


def test_landmark_errors_are_those_of_each_camera():
    found, seen = make_track(), cameras()
    truth = Truth(found.frame, found.q + 0.03)
    result, errors = evaluate_views(found, truth, MODEL, seen)
    moving = landmark_joints(MODEL).any(axis=1)
    all_of_them = []
    for view, camera in enumerate(seen):
        here, there = (project(camera, landmarks(MODEL, q)[:, moving]) for q in (found.q, truth.q))
        distance = np.linalg.norm(here - there, axis=-1)
        figures = distance.mean(), np.median(distance), distance.max()
        np.testing.assert_allclose([errors.mean[view], errors.median[view], errors.largest[view]], figures)
        all_of_them.append(distance)
    assert errors.mean[0] != pytest.approx(errors.mean[1], rel=0.01)
    assert result.landmark_px == pytest.approx(np.mean(all_of_them))
    assert result.landmark_median_px == pytest.approx(np.median(all_of_them))
    assert result.landmark_max_px == pytest.approx(np.max(all_of_them))
    assert result.rmse.tolist() == evaluate(found, truth, MODEL, seen[0]).rmse.tolist()


def test_one_view_gives_what_evaluate_gives():
    found, camera = make_track(), cameras()[0]
    truth = Truth(found.frame, found.q + 0.03)
    result, alone = evaluate_views(found, truth, MODEL, [camera])[0], evaluate(found, truth, MODEL, camera)
    assert (result.landmark_px, result.landmark_max_px) == (alone.landmark_px, alone.landmark_max_px)
    with pytest.raises(ValueError, match="cameras: got none; one for each view is wanted"):
        evaluate_views(found, truth, MODEL, [])


def test_a_view_from_which_nothing_is_known_has_no_figures():
    found = make_track()
    truth = Truth(found.frame, np.where(np.arange(6) == 5, found.q, np.nan))  # a fingertip's joint alone: no landmark
    _, errors = evaluate_views(found, truth, MODEL, cameras())
    assert np.isnan(errors.mean).all()
    assert as_data(errors)[1] == {"landmark_px": None, "landmark_median_px": None, "landmark_max_px": None}
    assert as_text(errors).splitlines()[1] == "view 1        mean - px, median - px, largest - px"


# --- video


def test_pictures_stand_in_reading_order_at_their_own_scale():
    def picture(height, width, level):
        return np.full((height, width, 3), level, dtype=np.uint8)

    whole = side_by_side([picture(40, 30, 100), picture(20, 50, 200), picture(10, 10, 250)])
    assert whole.shape == (40, 30 + 6 + 50 + 6 + 10, 3)
    assert (whole[:40, :30] == 100).all() and (whole[:20, 36:86] == 200).all() and (whole[:10, 92:] == 250).all()
    assert (whole[20:, 36:] == 24).all()
    square = side_by_side([picture(10, 20, level) for level in (1, 2, 3, 4)])
    assert square.shape == (26, 46, 3)
    assert [square[y, x, 0] for y, x in ((0, 0), (0, 26), (16, 0), (16, 26))] == [1, 2, 3, 4]
    alone = picture(10, 20, 7)
    assert side_by_side([alone]) is alone


def test_a_very_wide_picture_is_shrunk():
    whole = side_by_side([np.full((100, 2000, 3), 90, dtype=np.uint8)] * 3)
    assert whole.shape == (round(100 * 3840 / 6012), 3840, 3)


def test_the_video_shows_all_views_of_every_frame(tmp_path):
    found, seen = make_track(), cameras()
    seen = (seen[0], replace(seen[1], width=200))
    pairs = [(np.full((120, 160), 30.0, np.float32), np.full((120, 200), 200.0, np.float32))] * 5
    write_overlay(tmp_path / "o.mp4", pairs, found, MODEL, seen)
    with av.open(str(tmp_path / "o.mp4")) as container:
        shown = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(shown) == 5
    assert shown[0].shape == (480, 4 * 160 + 6 + 4 * 200, 3)
    assert abs(float(shown[0][470, 320].mean()) - 30) < 6 and abs(float(shown[0][470, 1400].mean()) - 200) < 6
    with pytest.raises(ValueError, match="1 images given for 2 cameras"):
        write_overlay(tmp_path / "p.mp4", [pairs[0][:1]] * 5, found, MODEL, seen)


def test_links_are_faint_in_the_view_that_does_not_see_them():
    found, seen = make_track(), cameras(1)[0]
    picture = np.zeros((120, 160), dtype=np.float32)
    hidden, shown = (draw_overlay(picture, found, 0, MODEL, seen, view) for view in (0, 1))
    below = np.s_[60:440]  # without the captions
    assert hidden[below].astype(int).sum() < shown[below].astype(int).sum()
    several = replace(found, view_visible=None)
    np.testing.assert_array_equal(draw_overlay(picture, several, 0, MODEL, seen, 1)[below], shown[below])


def test_only_the_first_view_tells_the_status():
    found, seen = make_track(), cameras(1)[0]
    picture = np.full((120, 160), 255.0, dtype=np.float32)
    first, second = (draw_overlay(picture, found, 0, MODEL, seen, view) for view in (0, 1))
    assert first[10:30, 10:100].mean() < 200 and second[10:30, 10:100].mean() > 250
    assert min(first[10:30, -60:].mean(), second[10:30, -60:].mean()) > 50
    assert max(first[10:30, -60:].mean(), second[10:30, -60:].mean()) < 200


# --- page


def test_the_page_says_which_view_is_which_and_what_it_gave():
    found, seen = make_track(), cameras()
    page = render_page(found, MODEL, seen, None, Truth(found.frame, found.q + 0.03), RUN)
    table = page[page.index('<table class="views">') :]
    rows = re.findall(r"<tr>(.*?)</tr>", table[: table.index("</table>")])
    assert len(rows) == 3
    assert "left &lt;1&gt;" in rows[1] and "the first" in rows[1] and "median 12, 35\N{NO-BREAK SPACE}%" in rows[1]
    assert "right" in rows[2] and "52\N{DEGREE SIGN} from the first" in rows[2]
    assert all("160 \N{MULTIPLICATION SIGN} 120 pixels" in row and "orthographic" in row for row in rows[1:])
    assert "2 views." in page and "2 views together" in page and '<main class="several">' in page
    charts = data_of(page)["charts"]
    assert [series["name"] for series in charts["edges"]["series"]] == ["edges", "view 0", "view 1"]
    assert charts["edges"]["series"][2]["v"] == [20, 21, 22, 23, 24]
    assert charts["v0l3"]["series"][0]["v"] == [10] * 5 and charts["v1l3"]["series"][0]["v"] == [100] * 5
    assert sorted(re.findall(r'data-chart="([^"]+)"><svg', page)) == sorted(charts)


def test_a_track_that_does_not_tell_its_views_apart_is_shown_all_the_same():
    found = replace(make_track(), view_edges=None, view_visible=None)
    page = render_page(found, MODEL, cameras(), None, None, replace(RUN, views=()))
    assert "edges in a frame" not in page and "landmark error" not in page
    assert "v3" in data_of(page)["charts"]


def test_a_page_of_one_view_speaks_of_no_views():
    page = render_page(make_track(views=1), MODEL, cameras(1), None, None, replace(RUN, views=("clip",)))
    assert "<h2>Views</h2>" not in page and "<main>" in page
    flat = orthographic(64, 48, 1.0, 32.0, 24.0, np.eye(3), np.zeros(3))
    assert render_page(make_track(views=1), MODEL, flat, None, None, RUN).count("Orthographic camera, 64") == 1


# --- command line


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rendered") / "pair"
    write_scene(folder, with_views(two_finger_crossing(3, frames=3, size=(160, 120), scale=0.8), 2))
    return folder


@pytest.fixture(scope="module")
def run(clip, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tracked") / "run"
    assert main(["track", str(clip), "--out", str(folder)]) == 0
    return folder


def test_the_record_names_all_views_with_their_cameras_and_checksums(run, clip):
    record = json.loads((run / "run.json").read_text())
    assert [view["name"] for view in record["views"]] == ["view0", "view1"]
    assert set(record["inputs"]) == {"frames[0]", "frames[1]", "sequence.yaml", "model"}
    assert record["inputs"]["frames[0]"] != record["inputs"]["frames[1]"]
    again = read_cameras(run / "camera.yaml")
    for view, camera in zip(record["views"], again, strict=True):
        assert view["camera"]["R"] == camera.R.tolist() and view["camera"]["width"] == 160
    assert len(read_track(run).frame) == 3


def test_evaluate_tells_the_landmark_error_of_each_view(run, capsys):
    assert main(["evaluate", str(run)]) == 0
    lines = capsys.readouterr().out.splitlines()
    place = lines.index("landmarks in each view")
    assert [line.split("  ")[0] for line in lines[place + 1 : place + 3]] == ["view 0", "view 1"]
    assert main(["evaluate", str(run), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    means = [view["landmark_px"] for view in facts["views"]]
    assert facts["landmark_px"] == pytest.approx(np.mean(means))


def camera_files(clip, folder):
    for number, camera in enumerate(read_cameras(clip / "sequence.yaml")):
        text = (clip / "sequence.yaml").read_text()
        block = text[text.index("camera:") : text.index("model:")].split("  - ")[number + 1]
        (folder / f"{number}.yaml").write_text("camera:\n    " + block)
        assert read_cameras(folder / f"{number}.yaml")[0].R.tolist() == camera.R.tolist()
    return [str(folder / f"{number}.yaml") for number in (0, 1)]


def test_folders_and_cameras_given_apart_are_tracked_together(clip, run, tmp_path):
    one, two = camera_files(clip, tmp_path)
    start = (clip / "sequence.yaml").read_text()
    start = start[start.index("start: ") + 7 : start.index("\ntruth")]
    given = [
        "track",
        str(clip / "view0"),
        str(clip / "view1"),
        "--model",
        "two_finger",
        "--start",
        start,
        "--fps",
        "25",
    ]
    assert main([*given, "--camera", one, "--camera", two, "--out", str(tmp_path / "run")]) == 0
    np.testing.assert_allclose(read_track(tmp_path / "run").q, read_track(run).q, atol=1e-9)
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert record["sequence"] == "view0, view1"


def test_wrong_views_on_the_command_line_are_one_clear_line(clip, tmp_path, capsys):
    one, two = camera_files(clip, tmp_path)
    out = ["--out", str(tmp_path / "run"), "--model", "two_finger", "--fps", "25"]
    for arguments, wanted in (
        ([str(clip / "view0"), str(clip / "view1"), "--camera", one], "1 camera for 2 views"),
        ([str(clip / "view0"), "--camera", one, "--camera", two], "2 cameras for 1 view"),
        ([str(clip), str(clip / "view1")], "is a sequence, which names all its views itself"),
        ([str(clip / "view0"), "nothing", "--camera", one, "--camera", two], "nothing: no such file or folder"),
        ([str(clip / "view0"), str(clip / "view1")], "--model and --camera were wanted"),
        ([str(clip), "--camera", one], "--camera: "),
    ):
        assert main(["track", *arguments, *out]) == 2
        said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
        assert len(said) == 1 and wanted in said[0]
    assert not (tmp_path / "run").exists()


def test_the_options_of_the_tracker_reach_its_settings(clip, tmp_path):
    chosen = ["--edges", "gaussian", "--refine", "--no-hypotheses"]
    assert main(["track", str(clip), "--out", str(tmp_path / "run"), *chosen]) == 0
    settings = json.loads((tmp_path / "run" / "run.json").read_text())["settings"]
    assert (settings["edges"], settings["refine"], settings["hypotheses"]) == ("gaussian", True, False)
    assert main(["track", str(clip), "--out", str(tmp_path / "other"), "--edges", "sobel"]) == 2


def test_render_makes_as_many_views_as_asked_for(tmp_path, capsys):
    asked = ["render", "--out", str(tmp_path / "clip"), "--scene", "index-thumb-pinch", "--frames", "1"]
    assert main([*asked, "--views", "3"]) == 0
    assert sorted(path.name for path in (tmp_path / "clip").glob("view*")) == ["view0", "view1", "view2"]
    assert len(read_cameras(tmp_path / "clip" / "sequence.yaml")) == 3
    assert main([*asked, "--views", "6"]) == 2
    assert "--views" in capsys.readouterr().err
