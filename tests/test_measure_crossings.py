"""Edge methods on images of two fingers: edges lie on the true silhouette, never on what another finger hides."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from jaxtyping import config
from numpy.testing import assert_allclose

from handtrack.across import crossings, silhouette_edges
from handtrack.appearance import Appearance, learn
from handtrack.axes import axis_spread, find_axes
from handtrack.camera import rays
from handtrack.edges import FOUND, HIDDEN, JOINT, OUTSIDE, Crossings
from handtrack.evaluate import evaluate
from handtrack.measure import Look
from handtrack.measure import posed as pills_at
from handtrack.measure_crossings import FITTED, METHODS, edge_samplers, method_of
from handtrack.measure_lines import COUNT, look_lines
from handtrack.pills import Pills, ray_hits
from handtrack.profiles import CAP, place_across
from handtrack.reproduce.edge_methods import true_edges
from handtrack.residuals import Chain, LineFeatures, OutlineFeatures, chain, line_residuals, outline_residuals
from handtrack.sequences import Truth
from handtrack.settings import EDGES, Settings
from handtrack.tracker import track
from synth.scene import Scene, image
from synth.scenes import two_finger_crossing

APART, CROSSING = 0, 12
OFF = np.radians([1.0, -0.8, 0.6, -1.0, 0.7, 0.9])
NAMES = EDGES[1:]
every_name = pytest.mark.parametrize("name", NAMES)


@cache
def scene(kind: str) -> Scene:
    return two_finger_crossing(1, frames=24, size=(320, 240), scale=1.6, projection=kind)


@cache
def seen(kind: str, frame: int) -> tuple[Chain, np.ndarray, np.ndarray, Appearance]:
    """The chain, the image, the true pose, and the appearance learnt there."""
    on, true = chain(scene(kind).model, scene(kind).camera), scene(kind).truth[frame]
    picture = image(scene(kind), frame).astype(np.float32)
    known = learn(picture, pills_at(on, true), on.camera)
    return on, picture, true, learn(picture, pills_at(on, true), on.camera, known)


@cache
def looked(name: str, residuals: str, frame: int = APART, kind: str = "orthographic") -> Look:
    on, picture, true, known = seen(kind, frame)
    chosen: dict[str, Any] = {"edges": name, "residuals": residuals}
    return look_lines(picture, on, true + OFF, np.radians(1.0) ** 2 * np.eye(6), known, Settings(**chosen))


@cache
def placed(frame: int, kind: str = "orthographic", polygons: bool = False) -> Crossings:
    on, picture, true, known = seen(kind, frame)
    pills = pills_at(on, true + OFF)
    samplers = place_across(pills, on.camera, COUNT)
    spread = axis_spread(on, samplers, true + OFF, np.radians(1.0) ** 2 * np.eye(6))
    finger = on.model.link_finger
    return crossings(picture, pills, finger, on.camera, known, samplers, 3.0 * spread + 1.0, spread, polygons=polygons)


def test_every_name_but_wssd_has_its_method():
    assert [method_of(name) for name in NAMES] == list(METHODS)
    assert set(FITTED) < set(NAMES)


@pytest.mark.parametrize("wrong", ["wssd", "Gaussian", ""])
def test_what_is_no_method_is_refused(wrong):
    with pytest.raises(ValueError, match=f"edges: got '{wrong}', wanted one of difference, gaussian"):
        method_of(wrong)


@pytest.mark.parametrize(("name", "kind"), [*((name, "orthographic") for name in NAMES), ("gaussian", "perspective")])
def test_edges_lie_on_the_true_silhouette(name, kind):
    on, _, true, _ = seen(kind, APART)
    look = looked(name, "outline", APART, kind)
    sides = look.found & (look.samplers.kind != CAP)
    s = look.samplers
    place, visible = true_edges(
        pills_at(on, true), on.model.link_finger, on.camera, s.origin[sides], s.direction[sides], s.link[sides]
    )
    error = (look.edges.offset[sides] - place)[visible]
    assert visible.mean() > 0.9 and visible.sum() > 40
    limit = 0.6 if name == "mwplls" else 0.25  # a centre of mass is drawn off by shading
    assert np.sqrt(np.mean(error**2)) < limit and np.abs(np.median(error)) < 0.12


@every_name
def test_outline_features_are_the_found_edges_as_rays(name):
    on, _, true, _ = seen("orthographic", APART)
    look = looked(name, "outline")
    assert isinstance(look.features, OutlineFeatures)
    assert look.found.sum() == look.features.link.size > 40
    np.testing.assert_array_equal(look.features.link, look.samplers.link[look.found])
    assert (look.samplers.kind[look.found] == CAP).any()
    before, _ = outline_residuals(on, look.features, true + OFF)
    after, _ = outline_residuals(on, look.features, true)
    assert np.median(np.abs(after)) < 1.5 and np.median(np.abs(after)) < 0.4 * np.median(np.abs(before))


@every_name
def test_line_features_agree_with_the_true_pose(name):
    on, _, true, _ = seen("orthographic", APART)
    look = looked(name, "lines")
    assert isinstance(look.features, LineFeatures)
    assert look.features.line_link.size >= 4 and look.features.tip_link.size == 2
    before, _ = line_residuals(on, look.features, true + OFF)
    after, _ = line_residuals(on, look.features, true)
    assert np.median(np.abs(after)) < 0.5 * np.median(np.abs(before))


@every_name
@pytest.mark.parametrize("residuals", ["outline", "lines"])
def test_a_look_has_one_entry_for_each_edge(name, residuals):
    look = looked(name, residuals)
    n = look.samplers.link.size
    assert n == 6 * 2 * COUNT + (10 if residuals == "outline" else 0)
    for values in (look.edges.reason, look.reach, look.expected, look.found, look.templates.state):
        assert values.shape == (n,)
    assert look.profiles.values.shape[0] == n
    np.testing.assert_array_equal(look.expected, ~np.isin(look.edges.reason, (HIDDEN, JOINT, OUTSIDE)))
    sides = look.samplers.side[: 12 * COUNT]
    np.testing.assert_array_equal(sides, np.tile([-1, 1], 6 * COUNT))


@every_name
def test_no_edge_lies_where_another_finger_is_in_front(name):
    kind = "perspective" if name in ("gaussian", "plls") else "orthographic"
    on, _, true, _ = seen(kind, CROSSING)
    look = looked(name, "outline", CROSSING, kind)
    finger, found = on.model.link_finger, look.found & (look.samplers.kind != CAP)
    inwards = look.edges.xy[found] - look.samplers.direction[found]
    front = hit_by(pills_at(on, true), on, inwards)
    np.testing.assert_array_equal(finger[front[front >= 0]], finger[look.samplers.link[found]][front >= 0])
    behind = finger[look.samplers.link] == 0
    assert (look.edges.reason[behind] == HIDDEN).sum() > 10


def hit_by(pills: Pills, on: Chain, xy: np.ndarray) -> np.ndarray:
    """The link that the ray through each pixel meets first, -1 for none."""
    return ray_hits(pills, *rays(on.camera, xy.reshape(-1, 2))).pill.reshape(xy.shape[:-1])


@pytest.mark.parametrize("kind", ["orthographic", "perspective"])
@pytest.mark.parametrize("polygons", [False, True])
def test_windows_keep_clear_of_the_other_finger(kind, polygons):
    on, _, true, _ = seen(kind, CROSSING)
    given = placed(CROSSING, kind, polygons)
    s = given.samplers
    at = s.origin[:, None] + given.profiles.u[:, None] * s.direction[:, None]
    exact = placed(CROSSING, kind)
    assert (given.window == exact.window).mean() > 0.9
    hit = hit_by(pills_at(on, true + OFF), on, at)
    foreign = (hit >= 0) & (on.model.link_finger[hit] != on.model.link_finger[s.link][:, None])
    assert foreign.any() and (exact.window & foreign).sum() == 0
    near = np.lib.stride_tricks.sliding_window_view(np.pad(foreign, ((0, 0), (3, 3))), 7, axis=1).any(axis=2)
    assert not (exact.window & near).any()  # a pixel and a half to either side


def test_predicted_edges_are_where_windows_say_so():
    given = placed(APART)
    on, _, true, _ = seen("orthographic", APART)
    assert_allclose(given.edge, silhouette_edges(pills_at(on, true + OFF), on.camera, given.samplers))
    assert_allclose(given.width, given.edge[:, 1] - given.edge[:, 0])
    expected = given.state == FOUND
    assert expected.mean() > 0.7 and (given.rise[expected] > 5.0).all()
    assert (given.state == JOINT).any()  # where one link meets the next


def test_samplers_of_edges_start_on_them_and_lead_outwards():
    on, *_ = seen("orthographic", APART)
    given = placed(APART)
    outline = edge_samplers(given, on)
    for side in (0, 1):
        away = outline.origin[side::2] - given.samplers.origin
        assert_allclose((away * given.samplers.direction).sum(axis=1), given.edge[:, side], atol=1e-9)
        assert_allclose(outline.direction[side::2], (-1.0, 1.0)[side] * given.samplers.direction)


def test_an_image_without_the_hand_shows_no_edges():
    on, picture, true, known = seen("orthographic", APART)
    for name in ("difference", "mwplls-iterative"):
        for residuals in ("outline", "lines"):
            chosen: dict[str, Any] = {"edges": name, "residuals": residuals}
            empty = np.full_like(picture, 5.0)
            look = look_lines(empty, on, true, 1e-4 * np.eye(6), known, Settings(**chosen))
            assert not look.found.any()
            rows = look.features.link if isinstance(look.features, OutlineFeatures) else look.features.line_link
            assert rows.size == 0


def test_fitted_edges_count_for_no_more_than_their_line():
    for name in FITTED:
        look = looked(name, "outline")
        assert isinstance(look.features, OutlineFeatures)
        sides = look.samplers.kind[look.found] != CAP
        stated, used = look.edges.sigma[look.found][sides], look.features.sigma[sides]
        link = look.features.link[sides]
        count = np.bincount(link)[link]
        assert_allclose(used, stated * np.sqrt(0.5 * count))
    look = looked("gaussian", "outline")
    assert isinstance(look.features, OutlineFeatures)
    assert_allclose(look.features.sigma, look.edges.sigma[look.found])


def test_an_axis_wants_points_on_both_sides():
    xy = np.array([[0.0, 1.0], [5.0, 1.0], [10.0, 1.0], [0.0, -1.0], [5.0, -1.0], [10.0, -1.0]])
    link, side, sigma = np.zeros(6, dtype=int), np.array([1, 1, 1, -1, -1, -1]), np.full(6, 0.1)
    whole = find_axes(link, side, xy, sigma, np.ones(6, dtype=bool))
    assert whole.link.tolist() == [0] and whole.line.valid.all()
    assert_allclose(np.abs(whole.line.normal), [[0.0, 1.0]], atol=1e-12)
    assert_allclose(whole.line.rho, 0.0, atol=1e-12)
    assert find_axes(link, side, xy, sigma, np.arange(6) < 5).link.size == 0
    assert find_axes(link[:0], side[:0], xy[:0], sigma[:0], np.zeros(0, dtype=bool)).link.size == 0


def test_a_half_hidden_link_keeps_its_axis_by_its_width():
    on, _, true, _ = seen("orthographic", CROSSING)
    look = looked("gaussian", "lines", CROSSING)
    assert isinstance(look.features, LineFeatures)
    found = look.found.reshape(-1, 2)
    both = np.bincount(look.samplers.link[::2][found.all(axis=1)], minlength=6)
    helped = [link for link in look.features.line_link if both[link] < 3]
    assert helped
    r, _ = line_residuals(on, look.features, true)
    rows = np.repeat(look.features.line_link, 2)
    assert np.abs(r[-rows.size :][np.isin(rows, helped)]).max() < 5.0


@pytest.mark.parametrize(("name", "residuals"), [("width-compensated", "outline"), ("mwplls-iterative", "lines")])
def test_a_crossing_is_followed(name, residuals):
    chosen: dict[str, Any] = {"edges": name, "residuals": residuals}
    moving = scene("orthographic")
    pictures = [image(moving, k).astype(np.float32) for k in range(6)]
    found = track(pictures, moving.model, moving.camera, moving.start, moving.fps, Settings(**chosen))
    judged = evaluate(found, Truth(np.arange(6), moving.truth[:6]), moving.model, moving.camera)
    assert np.degrees(judged.rmse.max()) < 2.5 and (found.status != "lost").all()


def test_an_unknown_method_is_refused_by_the_settings(monkeypatch):
    monkeypatch.setattr(config, "jaxtyping_disable", True)
    with pytest.raises(ValueError, match="edges: got 'canny'"):
        Settings(edges="canny")  # type: ignore[arg-type]
