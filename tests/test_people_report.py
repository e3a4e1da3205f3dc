"""Claims about the page of people: what it holds, that it loads nothing, and that its scripts can draw it."""

import base64
import json
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from handtrack.camera import perspective
from handtrack.formats.people import LOST, PREDICTED, People
from handtrack.formats.skeletons import KEYPOINTS, Detections, TruthPoints
from handtrack.report import people as page_of_people
from handtrack.report.people import PeopleShown, floor_of, render_people_page, upward, write_people_report
from handtrack.report.people_facts import facts_of

CAMERA = perspective(160, 120, 150.0, 150.0, 80.0, 60.0, np.eye(3), np.zeros(3))
F = 12
STANDING = np.zeros((16, 3))
STANDING[:, 1] = [-0.5, -0.5, -0.2, -0.2, 0, 0, 0, 0, 0.45, 0.45, 0.9, 0.9, -0.25, 0, -0.5, -0.7]
STANDING[:, 0] = np.tile([0.2, -0.2], 8)


def shown(**more):
    rng = np.random.default_rng(0)
    frame, person = np.repeat(np.arange(F), 2), np.tile([3, 8], F)
    truth = np.tile(STANDING, (F, 2, 1, 1)) + np.array([[[-0.5, 0.4, 2.0]], [[0.5, 0.4, 2.5]]])
    p = truth.reshape(-1, 16, 3) + 0.01 * rng.normal(size=(2 * F, 16, 3))
    status = np.zeros((2 * F, 16), np.int8)
    status[8:14, 4], status[14:, 4] = PREDICTED, LOST
    p[18:, 4] = np.nan
    covariance = np.tile(np.diag([1e-4, 2e-4, 4e-4]), (2 * F, 16, 1, 1))
    covariance[18:, 4] = np.nan
    people = People(np.arange(F) / 30, frame, person, p, np.ones((2 * F, 16)), covariance, status)
    base = {"people": people, "truth": TruthPoints(truth), "raw": people} | more
    seen = Detections(people.time, frame, np.tile([0, 1], F), p, np.ones((2 * F, 16)), np.zeros((2 * F, 16), np.int8))
    facts = facts_of(base["people"], base["raw"], base["truth"])
    given = {"title": "hall <1>", "mode": "robust", "camera": CAMERA, "gate": 3.0, "milliseconds": 0.5} | base
    return PeopleShown(detections=seen, facts=facts, settings=(("a", "<b>"),), **given)


def data_of(page):
    return json.loads(page.split('<script type="application/json" id="data">')[1].split("</script>")[0])


def places(text):
    mm = np.frombuffer(base64.b64decode(text), "<i2").reshape(-1, 16, 3).astype(float)
    return np.where(mm == page_of_people.NOWHERE, np.nan, mm / 1000)


def test_a_page_loads_nothing_and_escapes_what_it_is_told():
    page = render_people_page(shown(warnings=("look <out>",)))
    assert "hall &lt;1&gt;" in page and "look &lt;out&gt;" in page and "<td><b>" not in page
    assert not re.search(r"(?:src|href)=[\"'](?!data:)", page) and "default-src 'none'" in page
    assert re.findall(r"https?://[^\"' ]*", page) == ["http://www.w3.org/2000/svg"]
    assert "$" not in re.sub(r"\$\{", "", page)


def test_arrays_in_the_page_are_those_of_the_people():
    what = shown()
    data = data_of(render_people_page(what))
    p = places(data["people"]["p"])
    assert np.nanmax(np.abs(p - what.people.p)) <= 0.0005001 and (np.isnan(p) == np.isnan(what.people.p)).all()
    assert data["people"]["starts"] == list(range(0, 2 * F + 1, 2)) and data["people"]["label"][:2] == [3, 8]
    status = np.frombuffer(base64.b64decode(data["people"]["status"]), "u1").reshape(-1, 16)
    assert (status == what.people.status).all() and data["statuses"] == ["seen", "predicted", "lost"]
    c = np.frombuffer(base64.b64decode(data["people"]["covariance"]), "<f4").reshape(-1, 16, 6)
    assert np.allclose(c[0, 0], [1e-4, 0, 0, 2e-4, 0, 4e-4]) and not c[20, 4].any()
    assert what.truth is not None
    truth = places(data["truth"]["p"]).reshape(F, 2, 16, 3)
    assert np.abs(truth - what.truth.p).max() <= 0.0005001 and data["truth"]["label"] == [3, 8]
    assert len(data["keypoints"]) == len(KEYPOINTS) and np.array(data["bones"]).max() < 16


def test_tiles_tell_the_truth_and_what_is_predicted():
    page = render_people_page(shown())
    for words in ("Keypoints seen", "Longest gap bridged", "Truth in the ellipsoid", "Identity switches", "0.50"):
        assert words in page
    bare = render_people_page(shown(truth=None, raw=None, milliseconds=None))
    assert "Identity switches</span>" not in bare and "Time per frame" not in bare


def test_what_is_not_known_is_left_out():
    data = data_of(render_people_page(shown(truth=None, raw=None, camera=None, gate=None)))
    assert data["truth"] is data["raw"] is data["camera"] is data["gate"] is None


def test_nobody_makes_a_page_and_no_frame_makes_none(tmp_path):
    what = shown()
    none = np.zeros(0, int)
    nobody = People(
        what.people.time, none, none, np.zeros((0, 16, 3)), np.zeros((0, 16)), np.zeros((0, 16, 3, 3)),
        np.zeros((0, 16), np.int8),
    )  # fmt: skip
    empty = replace(what, people=nobody, raw=None, facts=facts_of(nobody, None, what.truth))
    write_people_report(tmp_path / "report.html", empty)
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
    data = data_of((tmp_path / "report.html").read_text())
    assert data["labels"] == [] and data["floor"] is None and data["up"] == [0, -1, 0]
    with pytest.raises(ValueError, match="no frames"):
        render_people_page(replace(empty, people=replace(nobody, time=np.zeros(0))))


def test_a_long_run_is_thinned_and_says_so(monkeypatch):
    monkeypatch.setattr(page_of_people, "MOST_ENTRIES", 10)
    page = render_people_page(shown())
    data = data_of(page)
    assert "one frame in 3;" in page
    assert data["step"] == 3 and len(data["time"]) == 4 and data["people"]["starts"] == [0, 2, 4, 6, 8]
    assert np.nanmax(np.abs(places(data["people"]["p"])[2] - shown().people.p[6])) < 0.001


def test_up_and_the_floor_come_from_the_people():
    people = shown().people
    assert np.allclose(upward(people), [0, -1, 0], atol=0.03)
    assert floor_of(people, np.array([0.0, -1.0, 0.0])) == pytest.approx(-1.35, abs=0.03)
    c, s = np.cos(0.35), np.sin(0.35)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    assert np.allclose(upward(replace(people, p=people.p @ tilt.T)), tilt @ [0, -1, 0], atol=0.03)
    legless = replace(people, p=np.where(np.arange(16)[:, None] >= 8, np.nan, people.p))
    assert floor_of(legless, np.array([0.0, -1.0, 0.0])) == pytest.approx(-0.45, abs=0.03)


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node to run the scripts")
def test_scripts_are_free_of_syntax_errors(tmp_path):
    script = render_people_page(shown()).rsplit("<script>", 1)[1].split("</script>")[0]
    (tmp_path / "page.js").write_text(script)
    subprocess.run([str(shutil.which("node")), "--check", tmp_path / "page.js"], check=True)
