"""Claims about the page of a hidden wrist: what it holds, that it loads nothing, and that its scripts can draw it."""

import base64
import json
import re
import shutil
import subprocess
from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh

from handtrack.body.environment import room_of
from handtrack.camera import perspective
from handtrack.formats.robots import RobotVolume
from handtrack.formats.wrists import WristTrack
from handtrack.report.wrist import WristShown, render_wrist_page, write_wrist_report
from handtrack.report.wrist_facts import facts_of
from handtrack.report.wrist_room import decimated, edges, upward

CAMERA = perspective(160, 120, 150.0, 150.0, 80.0, 60.0, np.eye(3), np.zeros(3))
F = 12


def box(size=(1.0, 1.0, 1.0), at=(0.0, 0.0, 2.0)):
    made = trimesh.creation.box(size)
    return room_of(np.asarray(made.vertices) + at, np.asarray(made.faces, np.int64))


def shown(**more):
    rng = np.random.default_rng(0)
    mean = np.array([0.1, 0.0, 2.0]) + 0.01 * rng.normal(size=(F, 3))
    track = WristTrack(
        time=np.arange(F) / 30, mean=mean, covariance=np.tile(np.diag([1e-3, 2e-3, 4e-3]), (F, 1, 1)),
        volume=np.full(F, 2e-3), status=np.array(["tracked"] * 4 + ["predicted"] * 5 + ["uncertain"] * 3),
        kills=rng.integers(0, 50, (F, 4)), elbow=mean - [0.2, 0, 0], shoulder=mean - [0.2, 0.3, 0],
        cloud=(mean[:, None] + 0.05 * rng.normal(size=(F, 30, 3))).astype(np.float32), seconds=np.full(F, 2e-3),
    )  # fmt: skip
    truth = np.stack([track.shoulder, track.elbow, mean + 0.02], axis=1)
    robot = RobotVolume(np.tile([[[0.5, 0.0, 2.0], [1.0, 0.0, 2.0]]], (F, 1, 1, 1)), np.full((F, 1), 0.05))
    state = np.zeros((F, 3), int)
    state[4:, 2] = 2
    seen = np.where(state[..., None] == 2, np.nan, truth)
    base = {"truth": truth, "room": box(), "robot": robot} | more
    known = base["truth"] if base["truth"] is None else truth[:, 2]
    facts = facts_of(track, state[:, 2], seen[:, 2], known, base["robot"])
    given = {"title": "cell <1>", "side": "right", "camera": CAMERA, "settings": (("a", "<b>"),)} | base
    return WristShown(track=track, facts=facts, seen=seen, state=state, **given)


def first(track, count):
    return replace(track, **{f.name: getattr(track, f.name)[:count] for f in fields(track)})


def data_of(page):
    return json.loads(page.split('<script type="application/json" id="data">')[1].split("</script>")[0])


def test_a_page_loads_nothing_and_escapes_what_it_is_told():
    page = render_wrist_page(shown(warnings=("look <out>",)))
    assert "cell &lt;1&gt;" in page and "look &lt;out&gt;" in page and "<b>" not in page.split("pairs")[-1][:60]
    assert not re.search(r"(?:src|href)=[\"'](?!data:)", page) and "default-src 'none'" in page
    assert re.findall(r"https?://[^\"' ]*", page) == ["http://www.w3.org/2000/svg"]
    assert "$" not in re.sub(r"\$\{", "", page)


def test_arrays_in_the_page_are_those_of_the_track():
    what = shown()
    data = data_of(render_wrist_page(what))
    joints = np.frombuffer(base64.b64decode(data["joints"]), "<f4").reshape(F, 3, 3)
    assert np.allclose(joints[:, 2], what.track.mean, atol=1e-6) and np.allclose(
        joints[:, 0], what.track.shoulder, atol=1e-6
    )
    cloud = np.frombuffer(base64.b64decode(data["cloud"]["data"]), "<i2").reshape(F, data["cloud"]["count"], 3)
    assert np.abs(cloud / 1000.0 - what.track.cloud).max() <= 0.0005001
    axes = np.frombuffer(base64.b64decode(data["ellipsoid"]), "<f4").reshape(F, 3, 3)
    assert np.allclose(axes[0] @ axes[0].T, 7.8147 * what.track.covariance[0], rtol=1e-4, atol=1e-9)
    assert data["charts"][0]["name"] == "Error of the wrist" and len(data["charts"]) == 4
    assert data["hidden"] == [0] * 4 + [1] * 8 and data["statuses"][data["status"][-1]] == "uncertain"


def test_what_is_not_known_is_left_out():
    data = data_of(render_wrist_page(shown(truth=None, robot=None, room=None)))
    assert data["truth"] is data["robot"] is data["room"] is None
    assert [chart["name"].split()[0] for chart in data["charts"]] == ["Volume", "Particles"]


def test_an_empty_track_is_refused_and_a_page_is_written_whole(tmp_path):
    what = shown()
    write_wrist_report(tmp_path / "report.html", what)
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(ValueError, match="no frames"):
        render_wrist_page(replace(what, track=first(what.track, 0)))


def test_one_frame_makes_a_page():
    what = shown()
    one = first(what.track, 1)
    facts = facts_of(one, what.state[:1, 2], what.seen[:1, 2], None, None)
    data = data_of(
        render_wrist_page(
            replace(what, track=one, facts=facts, seen=what.seen[:1], state=what.state[:1], truth=None, robot=None)
        )
    )
    assert data["time"] == [0.0] and data["hidden"] == [0]


def test_a_large_room_is_thinned_and_stays_where_it_was():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=1.0)
    room = room_of(np.asarray(ball.vertices), np.asarray(ball.faces, np.int64))
    small = decimated(room, 3000)
    assert 500 < small.triangles.shape[0] <= 3000 < room.triangles.shape[0]
    assert np.abs(np.linalg.norm(small.vertices, axis=1) - 1.0).max() < 0.02
    assert decimated(room_of(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), 10).triangles.size == 0


def test_a_box_has_twelve_edges_and_a_smooth_ball_none():
    assert edges(box()).shape == (12, 2)
    ball = trimesh.creation.icosphere(subdivisions=3)
    assert edges(room_of(np.asarray(ball.vertices), np.asarray(ball.faces, np.int64))).size == 0
    assert edges(room_of(np.zeros((0, 3)), np.zeros((0, 3), np.int64))).size == 0
    assert edges(box(), most=11).size == 0


def test_up_is_across_the_floor():
    c, s = np.cos(0.35), np.sin(0.35)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    floor = box((4.0, 0.02, 4.0))
    assert np.allclose(upward(replace(floor, vertices=floor.vertices @ tilt.T)), tilt @ [0, -1, 0], atol=1e-3)
    assert upward(None).tolist() == [0, -1, 0]
    wall = box((0.01, 0.001, 4.0))
    assert np.allclose(upward(wall), [0, -1, 0], atol=1e-6)


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node to run the scripts")
def test_scripts_are_free_of_syntax_errors(tmp_path):
    script = render_wrist_page(shown()).rsplit("<script>", 1)[1].split("</script>")[0]
    (tmp_path / "page.js").write_text(script)
    subprocess.run([str(shutil.which("node")), "--check", tmp_path / "page.js"], check=True)
