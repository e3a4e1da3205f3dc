"""Claims about the page of a walk: what it holds, that it loads nothing, and that its scripts can draw it."""

import base64
import json
import re
import shutil
import subprocess
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handtrack.body.walk_metrics import yaw_of
from handtrack.camera import perspective
from handtrack.formats.walk_tracks import WalkTrack
from handtrack.formats.walks import Walk, WalkTruth
from handtrack.report import walk as page_of_walk
from handtrack.report.walk import WalkShown, render_walk_page, seen_at, write_walk_report
from handtrack.report.walk_facts import spans, walk_facts

F = 20
R = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
CAMERA = perspective(640, 360, 460.0, 460.0, 319.5, 179.5, R, np.array([0.0, 1.6, 4.2]))
TURN = np.linspace(0.0, 6.0, F)


def quaternion(turn):
    return Rotation.from_euler("z", np.asarray(turn)[:, None]).as_quat(scalar_first=True)


def truth():
    p = np.column_stack([np.cos(TURN), np.sin(TURN), np.full(F, 0.95)])
    return WalkTruth(p, quaternion(TURN), np.repeat(p[:, None], 16, axis=1))


def made(off=(0.03, 0.0, 0.0), turn=0.02, sigma=0.02):
    real = truth()
    in_view = ~np.isin(np.arange(F), [5, 6, 7, 8, 15])
    status = np.where(in_view, "tracked", "predicted")
    status[9], status[10] = "uncertain", "lost"
    return WalkTrack(
        np.arange(F) + 100, np.arange(F) / 5, real.p + off, quaternion(TURN + turn), np.full((F, 3), sigma),
        np.full(F, 0.015), ("left_knee", "right_elbow"), np.full((F, 2), 0.5), np.full((F, 2), 0.1),
        real.keypoints + off, in_view, status, np.full(F, 1e-3),
    )  # fmt: skip


def cut(track):
    """The track without a frame."""
    arrays = {f.name: getattr(track, f.name) for f in fields(track)}
    return replace(track, **{k: v[:0] for k, v in arrays.items() if isinstance(v, np.ndarray)})


def walk():
    uv = np.tile(np.arange(10.0)[:, None, None], (1, 16, 2))
    uv[3, 2] = np.nan
    return Walk(
        Path("walk.yaml"), 5.0, CAMERA, 1.8, (), np.arange(F), np.arange(F) / 5, np.zeros((F, 13, 3)),
        np.zeros((F, 13, 4)), np.arange(10), 0.02 + np.arange(10) / 5, uv, np.ones((10, 16)), None,
    )  # fmt: skip


def shown(**more):
    given = {"track": made(), "raw": made((0.3, 0.4, 0.0), -0.2), "truth": truth(), "walk": walk()} | more
    facts = walk_facts(given["track"], given["raw"], given["truth"])
    base = {"title": "hall <1>", "method": "drift-ff", "milliseconds": 0.5, "settings": (("a", "<b>"),)}
    return WalkShown(**(base | given), facts=facts)


def data_of(page):
    return json.loads(page.split('<script type="application/json" id="data">')[1].split("</script>")[0])


def floats(text, *shape):
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(shape)


def test_errors_are_distances_and_turns_from_the_truth():
    facts = walk_facts(made(), made((0.3, 0.4, 0.0), -0.2), truth())
    assert facts.errors is not None and facts.raw is not None
    assert np.allclose(facts.errors.place, 0.03) and np.allclose(facts.errors.heading, 0.02)
    assert np.allclose(facts.raw.place, 0.5) and np.allclose(facts.raw.wrist, 0.5)
    data = facts.as_data()
    assert data["mean_error_mm"] == 30 and data["raw_mean_error_mm"] == 500 and data["out_of_view_error_mm"] == 30
    assert data["heading_error_deg"] == pytest.approx(1.146) and data["in_view"] == 0.75 and data["lost"] == 0.05
    assert data["longest_out_of_view_s"] == pytest.approx(0.6)
    assert "30 mm (suit alone 500), out of view 30 mm" in facts.sentences()[1]


def test_a_heading_that_passes_half_a_turn_is_not_far_off():
    off = walk_facts(replace(made(), wxyz=quaternion(TURN + 2 * np.pi - 0.01)), None, truth()).errors
    assert off is not None and np.allclose(off.heading, -0.01)
    assert np.allclose(yaw_of(quaternion([3.0, -3.0])), [3.0, -3.0])


@pytest.mark.parametrize(("sigma", "held"), [(0.02, 1.0), (0.014, 2 / 3)])
def test_two_sigma_hold_what_lies_within_twice_the_deviation_along_each_axis(sigma, held):
    assert walk_facts(made(sigma=sigma), None, truth()).held == pytest.approx(held)


def test_truth_that_lacks_a_frame_leaves_it_out():
    real = truth()
    real.p[3] = np.nan
    facts = walk_facts(made(), None, real)
    assert facts.as_data()["mean_error_mm"] == 30 and facts.held == 1.0
    real.p[:] = np.nan
    facts = walk_facts(made(), None, real)
    assert facts.as_data()["place_in_two_sigma"] is None and len(facts.sentences()) == 1


def test_frames_of_another_walk_are_refused():
    with pytest.raises(ValueError, match="truth: has 3 frames, wanted those of the track, 20"):
        walk_facts(made(), None, WalkTruth(np.zeros((3, 3)), np.zeros((3, 4)), np.zeros((3, 16, 3))))


def test_spans_are_the_stretches_that_are_on():
    assert spans(np.ones(3, bool)) == [(0, 2)] and spans(np.zeros(3, bool)) == [] and spans(np.zeros(0, bool)) == []


def test_a_page_loads_nothing_and_escapes_what_it_is_told():
    page = render_walk_page(shown(warnings=("look <out>",)))
    assert "hall &lt;1&gt;" in page and "look &lt;out&gt;" in page and "<td><b>" not in page
    assert not re.search(r"(?:src|href)=[\"'](?!data:)", page) and "default-src 'none'" in page
    assert re.findall(r"https?://[^\"' ]*", page) == ["http://www.w3.org/2000/svg"]
    assert "$" not in re.sub(r"\$\{", "", page)


def test_arrays_in_the_page_are_those_of_the_track():
    what = shown()
    data = data_of(render_walk_page(what))
    track = what.track
    assert np.allclose(floats(data["pelvis"], F, 3), track.p) and np.allclose(floats(data["sigma"], F, 3), 0.02)
    assert np.allclose(floats(data["points"], F, 16, 3), track.keypoints)
    assert np.allclose(floats(data["posture"], F, 2), np.degrees(0.5)) and data["joints"] == [
        "left knee",
        "right elbow",
    ]
    assert np.allclose(floats(data["truth"]["pelvis"], F, 3), truth().p)
    assert np.allclose(floats(data["raw"]["heading"], F)[0], np.degrees(-0.2))
    status = np.frombuffer(base64.b64decode(data["status"]), "u1")
    assert [data["statuses"][k] for k in status.tolist()] == track.status.tolist()
    assert (np.frombuffer(base64.b64decode(data["inView"]), "u1") == track.in_view).all()
    assert data["frame"][0] == 100 and data["camera"]["R"] == R.tolist() and np.array(data["bones"]).max() < 16


def test_keypoints_seen_are_those_of_the_nearest_camera_frame():
    uv = seen_at(walk(), np.array([-0.5, 0.0, 0.3, 0.61, 1.9, 5.0]))
    assert (
        np.isnan(uv[[0, 5]]).all() and uv[1, 0, 0] == 0 and uv[2, 0, 0] == 1 and uv[3, 0, 0] == 3 and uv[4, 0, 0] == 9
    )
    assert np.isnan(uv[3, 2]).all()
    few = walk()
    one = replace(
        few, camera_frame=few.camera_frame[:1], camera_time=few.camera_time[:1], uv=few.uv[:1],
        confidence=few.confidence[:1],
    )  # fmt: skip
    assert seen_at(one, np.array([0.0, 9.0]))[:, 0, 0].tolist()[0] == 0


def test_what_is_not_known_is_left_out():
    page = render_walk_page(shown(raw=None, truth=None, walk=None, milliseconds=None))
    data = data_of(page)
    assert data["truth"] is data["raw"] is data["camera"] is data["seen"] is None
    assert "Mean error</span>" not in page and "Time per frame" not in page
    assert "suit alone 500" in render_walk_page(shown()) and "of the camera;" not in page


def test_tiles_keep_silent_where_the_truth_does():
    real, all_seen = truth(), replace(made(), in_view=np.ones(F, bool), status=np.full(F, "tracked"))
    page = render_walk_page(shown(track=all_seen, raw=None, truth=real))
    assert "never uncertain or lost" in page and "Out of view</span>" not in page


def test_no_frame_makes_no_page(tmp_path):
    what = shown(raw=None, truth=None)
    write_walk_report(tmp_path / "report.html", what)
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(ValueError, match="no frames"):
        render_walk_page(replace(what, track=cut(what.track)))


def test_a_long_walk_is_thinned_and_says_so(monkeypatch):
    monkeypatch.setattr(page_of_walk, "MOST_FRAMES", 8)
    page = render_walk_page(shown())
    data = data_of(page)
    assert "one frame in 3;" in page and data["frame"] == list(range(100, 120, 3))
    assert np.allclose(floats(data["truth"]["pelvis"], 7, 3), truth().p[::3])


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node to run the scripts")
def test_scripts_are_free_of_syntax_errors(tmp_path):
    script = render_walk_page(shown()).rsplit("<script>", 1)[1].split("</script>")[0]
    (tmp_path / "page.js").write_text(script)
    subprocess.run([str(shutil.which("node")), "--check", tmp_path / "page.js"], check=True)
