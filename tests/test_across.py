"""Profiles across whole links: silhouettes where rays stop hitting, windows of the own finger and background only."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from handtrack.across import MARGIN, Across, across, polygon_windows
from handtrack.appearance import Appearance, learn
from handtrack.camera import Camera, rays
from handtrack.measure import posed as pills_at
from handtrack.pills import Pills, ray_hits
from handtrack.residuals import Chain, chain
from synth.scene import clean_image
from synth.scenes import two_finger_crossing

COUNT = 8
CROSSING = 12  # the frame in which the finger behind is hidden most
KINDS = ("orthographic", "perspective")


@cache
def seen(kind: str, frame: int) -> tuple[Chain, Pills, Appearance]:
    """Two fingers apart in frame 0, one before the other later; with the appearance of the clean image."""
    scene = two_finger_crossing(1, frames=24, size=(320, 240), scale=1.6, projection=kind)
    on = chain(scene.model, scene.camera)
    pills = pills_at(on, scene.truth[frame])
    image = clean_image(scene, frame).astype(np.float32)
    return on, pills, learn(image, pills, on.camera, learn(image, pills, on.camera))


def wide(kind: str, frame: int, polygons: bool = False) -> Across:
    on, pills, appearance = seen(kind, frame)
    return across(pills, on.model.link_finger, on.camera, appearance, COUNT, polygons)


def points_of(found: Across) -> np.ndarray:
    return found.samplers.origin[:, None] + found.u[:, None] * found.samplers.direction[:, None]


def alone(pills: Pills, link: int) -> Pills:
    return Pills(pills.base[link : link + 1], pills.tip[link : link + 1], pills.radius[link : link + 1])


def hit_by(pills: Pills, camera: Camera, xy: np.ndarray) -> np.ndarray:
    """The pill a ray through each pixel meets first, -1 for none."""
    return ray_hits(pills, *rays(camera, xy.reshape(-1, 2))).pill.reshape(xy.shape[:-1])


@pytest.mark.parametrize("kind", KINDS)
def test_samplers_stand_across_every_link(kind):
    found = wide(kind, 0)
    np.testing.assert_array_equal(np.bincount(found.samplers.link), COUNT)
    assert_allclose(np.linalg.norm(found.samplers.direction, axis=1), 1.0)
    assert found.values.shape == found.visible.shape == (6 * COUNT, found.u.size)
    assert_allclose(found.u, -found.u[::-1])


@pytest.mark.parametrize("kind", KINDS)
def test_edges_are_where_the_rays_cease_to_hit_the_link(kind):
    on, pills, _ = seen(kind, 0)
    found = wide(kind, 0)
    assert np.isfinite(found.edge).all() and (found.edge[:, 0] < 0.0).all() and (found.edge[:, 1] > 0.0).all()
    for link in range(6):
        of_link = np.flatnonzero(found.samplers.link == link)
        at, direction = found.samplers.origin[of_link, None], found.samplers.direction[of_link, None]
        for offset, wanted in ((-0.1, True), (0.1, False)):
            outwards = found.edge[of_link] + offset * np.array([-1.0, 1.0])
            hit = hit_by(alone(pills, link), on.camera, at + outwards[..., None] * direction) == 0
            assert (hit == wanted).mean() > 0.95


@pytest.mark.parametrize("kind", KINDS)
def test_an_unhidden_link_is_visible_with_a_margin_of_background(kind):
    found = wide(kind, 0)
    assert (found.share > 0.8).all() and np.median(found.share) > 0.98
    tip = found.samplers.link == 5
    beside = (found.u < found.edge[:, :1]) | (found.u > found.edge[:, 1:])
    width = (found.visible & beside).sum(axis=1) * 0.5
    assert (width[tip] >= 2 * MARGIN - 1.0).all() and (width <= 2 * MARGIN + 1.0).all()
    assert found.visible[tip][~beside[tip]].mean() > 0.98


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("frame", [0, CROSSING])
def test_windows_hold_no_sample_of_another_finger(kind, frame):
    on, pills, _ = seen(kind, frame)
    found = wide(kind, frame)
    hit = hit_by(pills, on.camera, points_of(found))
    finger = on.model.link_finger
    foreign = (hit >= 0) & (finger[hit] != finger[found.samplers.link][:, None])
    assert not (found.visible & foreign).any()
    assert foreign.any()


@pytest.mark.parametrize("kind", KINDS)
def test_a_hidden_link_has_a_small_share_and_the_one_in_front_all(kind):
    on, pills, _ = seen(kind, CROSSING)
    found = wide(kind, CROSSING)
    hit = hit_by(pills, on.camera, points_of(found))
    finger = on.model.link_finger
    own = (hit >= 0) & (finger[hit] == finger[found.samplers.link][:, None])
    inside = (found.u >= found.edge[:, :1]) & (found.u <= found.edge[:, 1:])
    assert_allclose(found.share, (own & inside).sum(axis=1) / inside.sum(axis=1), atol=1e-12)
    assert found.share.min() < 0.6 and (found.share[finger[found.samplers.link] == 1] > 0.9).all()


@pytest.mark.parametrize("kind", KINDS)
def test_templates_are_the_clean_image(kind):
    scene = two_finger_crossing(1, frames=24, size=(320, 240), scale=1.6, projection=kind)
    found = wide(kind, 0)
    image = clean_image(scene, 0)
    points = np.rint(points_of(found)).astype(int)
    x, y = np.clip(points[..., 0], 0, 319), np.clip(points[..., 1], 0, 239)
    beside = (found.u < found.edge[:, :1] - 2.0) | (found.u > found.edge[:, 1:] + 2.0)
    inside = (found.u > found.edge[:, :1] + 2.0) & (found.u < found.edge[:, 1:] - 2.0)
    difference = np.abs(found.values - image[y, x])
    assert np.percentile(difference[found.visible & beside], 95) < 3.0
    assert np.median(difference[found.visible & inside]) < 6.0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("frame", [0, CROSSING])
def test_polygons_and_rays_agree_on_almost_every_sample(kind, frame):
    one, two = wide(kind, frame), wide(kind, frame, polygons=True)
    np.testing.assert_array_equal(one.values, two.values)
    near = (one.u >= one.edge[:, :1] - MARGIN) & (one.u <= one.edge[:, 1:] + MARGIN)
    assert (one.visible == two.visible)[near].mean() > 0.95
    assert_allclose(one.share, two.share, atol=0.25)
    assert np.abs(one.share - two.share).mean() < 0.04


def test_polygon_windows_tell_own_finger_from_background():
    on, pills, _ = seen("orthographic", 0)
    points = np.array([[[1.0, 1.0], [2.0, 1.0], [1.0, 2.0]]])
    own, free = polygon_windows(pills, on.model.link_finger, on.camera, np.array([0]), points)
    assert not own.any() and free.all()
    middle = on.camera.fx * (0.5 * (pills.base + pills.tip))[5, :2] + [on.camera.cx, on.camera.cy]
    own, free = polygon_windows(pills, on.model.link_finger, on.camera, np.array([5]), middle[None, None])
    assert own.all() and not free.any()


@pytest.mark.parametrize("polygons", [False, True])
def test_a_link_seen_along_its_axis_shows_no_pair_of_edges_or_a_finite_one(polygons):
    on, _, appearance = seen("orthographic", 0)
    towards = Pills(np.array([[0.0, 0.0, 300.0]]), np.array([[0.0, 0.0, 260.0]]), np.array([[9.0, 8.0]]))
    found = across(towards, np.array([0]), on.camera, appearance, COUNT, polygons)
    assert np.isfinite(found.values).all() and np.isfinite(found.u).all()
    assert not found.visible[np.isnan(found.edge).any(axis=1)].any()
