"""Visibility: polygons and rays must tell the same story, except where the mean depth is known to be wrong."""

import numpy as np
import pytest
import shapely

from handtrack.camera import orthographic, perspective
from handtrack.pills import Pills
from handtrack.visibility import (
    first_links,
    sample_fraction,
    truncated_polygons,
    visible_fraction,
    visible_samples,
    window,
)

EYE, ZERO = np.eye(3), np.zeros(3)
BENT = np.array([0.1, -0.1, 0.001, -0.002, 0.0])
CAMERAS = {
    "orthographic": orthographic(320, 240, 1.2, 160.0, 120.0, EYE, ZERO),
    "perspective": perspective(320, 240, 500.0, 500.0, 160.0, 120.0, EYE, ZERO),
    "distorted": perspective(320, 240, 500.0, 500.0, 160.0, 120.0, EYE, ZERO, BENT),
}
cameras = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
FINGERS = np.array([0, 0, 0, 1, 1, 1])
IMAGE = shapely.box(-0.5, -0.5, 319.5, 239.5)


def of_finger(number: int) -> np.ndarray:
    return np.equal(FINGERS, number)


def chain(start: np.ndarray, turn: float, slope: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three tapered links from `start`, in the image direction `turn`, each falling away by its slope."""
    ends = [start]
    for length, fall in zip((46.0, 28.0, 22.0), slope, strict=True):
        step = np.array([np.cos(turn), np.sin(turn), fall])
        ends.append(ends[-1] + length * step / np.linalg.norm(step))
    radius = np.array([[9.5, 9.0], [9.0, 8.0], [8.0, 7.0]])
    return np.array(ends[:-1]), np.array(ends[1:]), radius


def two_fingers(seed: int) -> Pills:
    """Two fingers that cross in the image, one everywhere behind the other by more than their thickness."""
    rng = np.random.default_rng(seed)
    one = chain(np.array([-45.0, rng.uniform(-20, 20), 400.0]), rng.uniform(-0.4, 0.4), list(rng.uniform(-0.3, 0.3, 3)))
    two = chain(np.array([rng.uniform(-20, 20), -45.0, 480.0]), rng.uniform(1.2, 1.9), list(rng.uniform(-0.3, 0.3, 3)))
    pair = (one, two) if rng.random() < 0.5 else (two, one)
    return Pills(*(np.concatenate(parts) for parts in zip(*pair, strict=True)))


def figure_4_16() -> Pills:
    """A lies across the far end of B; B leads from far behind A to near the viewer, so its mean depth is the less."""
    return Pills(
        np.array([[0.0, -30.0, 400.0], [0.0, 0.0, 430.0]]),
        np.array([[0.0, 30.0, 400.0], [70.0, 0.0, 260.0]]),
        np.full((2, 2), 8.0),
    )


def grid(step: float = 4.0) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(0, 320, step), np.arange(0, 240, step)), axis=-1).reshape(-1, 2)


def test_mean_depth_is_wrong_where_a_link_leads_away_and_the_ray_is_right():
    pills, camera, finger = figure_4_16(), CAMERAS["orthographic"], np.array([0, 1])
    crossing = np.array([[160.0, 120.0]])  # above B's far end, inside both silhouettes
    mean, pair = (truncated_polygons(pills, camera, finger, order) for order in ("mean-depth", "pairwise"))
    assert mean.depth[1] < mean.depth[0]
    assert mean.covers[1, 0], "the mean depth takes B for the front"
    assert pair.covers[0, 1] and not pair.covers[1, 0]
    assert first_links(pills, camera, crossing) == 0
    assert [bool(window(mean.truncated[k], crossing)[0]) for k in (0, 1)] == [False, True]
    assert [bool(window(pair.truncated[k], crossing)[0]) for k in (0, 1)] == [True, False]
    assert [bool(visible_samples(pills, camera, np.array([k]), crossing)[0]) for k in (0, 1)] == [True, False]


@cameras
@pytest.mark.parametrize("order", ["mean-depth", "pairwise"])
@pytest.mark.parametrize("seed", range(3))
def test_windows_agree_with_rays_away_from_borders(camera, order, seed):
    pills, xy = two_fingers(seed), grid()
    layers = truncated_polygons(pills, camera, FINGERS, order, n_arc=40)
    assert layers.covers.any()
    for link in range(6):
        seen = visible_samples(pills, camera, np.full(len(xy), link), xy, FINGERS)
        sure = shapely.distance(shapely.points(xy), shapely.boundary(layers.truncated[link])) > 0.05
        agree = window(layers.truncated[link], xy)[sure] == seen[sure]
        assert agree.mean() > 0.99
        if order == "pairwise":
            assert agree.all()


@cameras
@pytest.mark.parametrize("seed", range(6))
def test_truncated_fingers_part_the_union_of_silhouettes(camera, seed):
    layers = truncated_polygons(two_fingers(seed), camera, FINGERS)
    one, two = (shapely.union_all(layers.truncated[of_finger(f)]) for f in (0, 1))
    everything = shapely.intersection(shapely.union_all(layers.whole), IMAGE)
    assert shapely.intersection(one, two).area < 1e-6
    assert shapely.symmetric_difference(shapely.union(one, two), everything).area < 1e-6
    assert all(shapely.within(layers.truncated, shapely.buffer(layers.whole, 1e-9)))


def test_a_ring_of_three_links_is_ordered_pair_by_pair():
    """Each link lies on the next: no order of layers exists, the pairs still have one."""
    turn = 2 * np.pi * np.arange(3) / 3
    corner = 40 * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    along = np.roll(corner, -1, axis=0) - corner
    base = np.concatenate([corner - 0.2 * along, np.full((3, 1), 380.0)], axis=1)
    tip = np.concatenate([corner + 1.2 * along, np.full((3, 1), 420.0)], axis=1)
    pills, camera, finger = Pills(base, tip, np.full((3, 2), 5.0)), CAMERAS["orthographic"], np.arange(3)
    layers = truncated_polygons(pills, camera, finger, "pairwise")
    assert layers.covers.sum() == 3 and all(layers.covers.sum(axis=0) == 1)
    xy = grid(1.0)
    first = first_links(pills, camera, xy)
    for link in range(3):
        sure = shapely.distance(shapely.points(xy), shapely.boundary(layers.truncated[link])) > 0.1
        np.testing.assert_array_equal(window(layers.truncated[link], xy)[sure], (first == link)[sure])


@pytest.mark.parametrize("order", ["mean-depth", "pairwise"])
def test_links_of_one_finger_stay_whole_unless_asked(order):
    pills, camera = two_fingers(0), CAMERAS["perspective"]
    alone = truncated_polygons(pills, camera, np.zeros(6, dtype=int), order)
    np.testing.assert_allclose(visible_fraction(alone), 1.0)
    joined = truncated_polygons(pills, camera, FINGERS, order, same_finger=True)
    area = shapely.area(joined.truncated).sum()
    assert area == pytest.approx(shapely.union_all(joined.whole).area, rel=1e-9)
    assert visible_fraction(joined).min() < 0.95


def test_visible_area_is_the_count_of_visible_pixels():
    pills, camera, xy = two_fingers(1), CAMERAS["perspective"], grid(1.0)
    layers = truncated_polygons(pills, camera, FINGERS, "pairwise", n_arc=40)
    link = np.repeat(np.arange(6), len(xy))
    inside = window(np.repeat(layers.whole, len(xy)), np.tile(xy, (6, 1)))
    seen = visible_samples(pills, camera, link[inside], np.tile(xy, (6, 1))[inside], FINGERS)
    np.testing.assert_allclose(sample_fraction(link[inside], seen, 6), visible_fraction(layers), atol=0.01)


def test_windows_of_many_links_are_those_of_each():
    pills, camera = two_fingers(2), CAMERAS["orthographic"]
    layers = truncated_polygons(pills, camera, FINGERS)
    xy = np.random.default_rng(0).uniform([60, 40], [260, 200], (6, 50, 2))
    together = window(layers.truncated[:, None], xy)
    for link in range(6):
        np.testing.assert_array_equal(together[link], window(layers.truncated[link], xy[link]))
    flat = window(layers.truncated[np.repeat(np.arange(6), 50)], xy.reshape(-1, 2))
    np.testing.assert_array_equal(flat, together.ravel())
    assert together.any() and not together.all()


def test_the_nearer_of_two_fingers_is_seen_whole():
    pills = two_fingers(3)
    front = int(np.argmin([pills.base[of_finger(f), 2].mean() for f in (0, 1)]))
    share = visible_fraction(truncated_polygons(pills, CAMERAS["orthographic"], FINGERS))
    np.testing.assert_allclose(share[of_finger(front)], 1.0)
    assert share[of_finger(1 - front)].min() < 0.9


def test_nothing_is_seen_outside_the_image():
    pills = Pills(
        np.array([[-170.0, 0.0, 50.0], [300.0, 0.0, 50.0]]),
        np.array([[-100.0, 0.0, 50.0], [340.0, 0.0, 50.0]]),
        np.full((2, 2), 8.0),
    )
    camera = CAMERAS["orthographic"]
    layers = truncated_polygons(pills, camera, np.array([0, 1]))
    assert 0.3 < visible_fraction(layers)[0] < 0.7 and visible_fraction(layers)[1] == 0.0
    xy = np.array([[10.0, 120.0], [-20.0, 120.0], [520.0, 120.0], [200.0, 120.0], [np.nan, 0.0]])
    assert first_links(pills, camera, xy).tolist() == [0, -2, -2, -1, -2]
    assert visible_samples(pills, camera, np.array([0, 0, 1, 0, 0]), xy).tolist() == [True, False, False, False, False]


@pytest.mark.parametrize("order", ["mean-depth", "pairwise"])
def test_links_behind_the_camera_are_not_seen_and_hide_nothing(order):
    pills = Pills(
        np.array([[0.0, 0.0, -400.0], [-30.0, 0.0, 300.0]]),
        np.array([[0.0, 0.0, 5.0], [30.0, 0.0, 300.0]]),
        np.full((2, 2), 8.0),
    )
    camera, finger, xy = CAMERAS["perspective"], np.array([0, 1]), np.array([[160.0, 120.0]])
    layers = truncated_polygons(pills, camera, finger, order)
    assert visible_fraction(layers).tolist() == [0.0, 1.0] and np.isnan(layers.depth[0])
    assert first_links(pills, camera, xy) == 1
    assert not window(layers.truncated[0], xy).any()


def test_no_links_leave_the_background():
    nothing = Pills(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)))
    camera = CAMERAS["perspective"]
    assert first_links(nothing, camera, np.array([[5.0, 5.0]])).tolist() == [-1]
    assert len(truncated_polygons(nothing, camera, np.zeros(0, dtype=int)).truncated) == 0


def test_an_unknown_order_is_refused():
    with pytest.raises(ValueError, match="order is 'painter'"):
        truncated_polygons(two_fingers(0), CAMERAS["perspective"], FINGERS, order="painter")


def test_a_link_without_samples_has_no_visible_share():
    assert sample_fraction(np.array([1]), np.array([True]), 3).tolist() == [0.0, 1.0, 0.0]
