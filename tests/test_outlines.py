"""Outlines: rims and silhouettes against brute force, ray casting and meshes; polygons and meshes by their laws."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.camera import Camera, orthographic, perspective, project_camera, rays
from handtrack.outlines import convex_hull, merged_polygon, mesh, rims, silhouettes, simplify
from handtrack.pills import Pills, ray_hits

EYE, ZERO = np.eye(3), np.zeros(3)
BENT = np.array([0.12, -0.15, 0.002, -0.003, 0.04])
CAMERAS = {
    "orthographic": orthographic(640, 480, 2.0, 320.0, 240.0, EYE, ZERO),
    "perspective": perspective(640, 480, 600.0, 620.0, 310.0, 250.0, EYE, ZERO),
    "distorted": perspective(640, 480, 600.0, 620.0, 310.0, 250.0, EYE, ZERO, BENT),
}
cameras = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())


def random_pills(seed: int, n: int = 12) -> Pills:
    """Pills of every slant and taper in front of the camera, some with one sphere hidden by the other."""
    rng = np.random.default_rng(seed)
    base = rng.uniform([-80, -60, 250], [80, 60, 500], (n, 3))
    return Pills(base, base + rng.normal(0, 30, (n, 3)), rng.uniform(3, 25, (n, 2)))


def sight_lines(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Point and unit direction of the line of sight to each point, in camera axes."""
    if camera.kind == "orthographic":
        return points, np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    return np.zeros_like(points), points / np.linalg.norm(points, axis=-1, keepdims=True)


def gap_between_line_and_pill(pills: Pills, k: int, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Brute force over 4001 spheres between the ends: distance of the line from the nearest of their surfaces."""
    s = np.linspace(0, 1, 4001)[:, None]
    centre = pills.base[k] + s * (pills.tip[k] - pills.base[k])
    radius = pills.radius[k, 0] + s[:, 0] * (pills.radius[k, 1] - pills.radius[k, 0])
    apart = centre - origin[:, None]
    along = apart @ direction[..., None]
    return (np.linalg.norm(apart - along * direction[:, None], axis=-1) - radius).min(axis=1)


@cameras
@pytest.mark.parametrize("seed", range(3))
def test_lines_of_sight_touch_every_pill_at_its_rim(camera, seed):
    pills = random_pills(seed)
    rim = rims(pills, camera, 9)
    for k in range(len(rim)):
        origin, direction = sight_lines(camera, rim[k])
        np.testing.assert_allclose(gap_between_line_and_pill(pills, k, origin, direction), 0.0, atol=1e-5)


@cameras
def test_rim_points_lie_on_the_surface(camera):
    pills = random_pills(4)
    rim = rims(pills, camera, 9)
    s = np.linspace(0, 1, 4001)[:, None]
    for k in range(len(rim)):
        centre = pills.base[k] + s * (pills.tip[k] - pills.base[k])
        radius = pills.radius[k, 0] + s[:, 0] * (pills.radius[k, 1] - pills.radius[k, 0])
        gap = (np.linalg.norm(rim[k][:, None] - centre, axis=-1) - radius).min(axis=1)
        np.testing.assert_allclose(gap, 0.0, atol=1e-5)


@cameras
@pytest.mark.parametrize("seed", range(2))
def test_silhouette_holds_just_the_pixels_whose_rays_hit(camera, seed):
    pills = random_pills(seed + 10, n=4)
    xy = np.stack(np.meshgrid(np.arange(0.0, 640, 6), np.arange(0.0, 480, 6)), axis=-1).reshape(-1, 2)
    origin, direction = rays(camera, xy)
    for k, outline in enumerate(silhouettes(pills, camera, n_arc=200)):
        one = Pills(pills.base[[k]], pills.tip[[k]], pills.radius[[k]])
        hit = ray_hits(one, origin, direction).pill == 0
        polygon = shapely.polygons(outline)
        sure = shapely.distance(shapely.points(xy), polygon.exterior) > 0.02
        assert hit.any()
        np.testing.assert_array_equal(hit[sure], shapely.contains_xy(polygon, xy)[sure])


@cameras
def test_silhouette_agrees_with_the_hull_of_the_projected_mesh(camera):
    pills = random_pills(7)
    for k, outline in enumerate(silhouettes(pills, camera, n_arc=60)):
        axis = pills.tip[k] - pills.base[k]
        length = float(np.linalg.norm(axis))
        vertices, _ = mesh(pills.radius[k, 0], pills.radius[k, 1], length, n_around=60, n_cap=40)
        turn = np.linalg.qr(np.stack([axis / length, [0.3, 0.5, 0.8], [0.9, -0.4, 0.1]], axis=1))[0]
        turn[:, 0] = axis / length
        cloud = project_camera(camera, vertices @ turn.T + pills.base[k])
        exact, hull = shapely.polygons(outline), shapely.polygons(convex_hull(cloud))
        assert shapely.area(hull) == pytest.approx(shapely.area(exact), rel=6e-3)
        assert shapely.hausdorff_distance(hull, exact, densify=0.2) < 0.3


@settings(max_examples=80, deadline=None)
@given(
    x=st.floats(-30, 30), z=st.floats(-45, 45), r1=st.floats(0.5, 40), r2=st.floats(0.5, 40),
    kind=st.sampled_from(sorted(CAMERAS)),
)  # fmt: skip
def test_silhouette_is_a_simple_closed_curve_at_any_size_and_slant(x, z, r1, r2, kind):
    pills = Pills(np.array([[1.0, 2.0, 300.0]]), np.array([[1.0 + x, 2.0, 300.0 + z]]), np.array([[r1, r2]]))
    outline = silhouettes(pills, CAMERAS[kind])[0]
    polygon = shapely.polygons(outline)
    assert np.isfinite(outline).all() and polygon.is_valid
    if kind != "distorted":
        assert polygon.area == pytest.approx(polygon.convex_hull.area, rel=1e-9)


@cameras
@pytest.mark.parametrize(("near", "far"), [((30.0, 30.0), (30.0, 8.0)), ((30.0, 8.0), (30.0, 30.0))])
def test_one_sphere_hiding_the_other_leaves_its_circle(camera, near, far):
    ends = np.array([[0.0, 0.0, 300.0], [5.0, -3.0, 310.0]])
    for first in (0, 1):
        radius = np.array([[20.0, 4.0]]) if first == 0 else np.array([[4.0, 20.0]])
        pills = Pills(ends[[0]], ends[[1]], radius)
        alone = Pills(ends[[first]], ends[[first]], np.array([[20.0, 20.0]]))
        a, b = (shapely.polygons(silhouettes(p, camera, n_arc=200)[0]) for p in (pills, alone))
        assert shapely.symmetric_difference(a, b).area < 1e-3 * a.area


@cameras
def test_silhouette_moves_smoothly_as_one_sphere_slides_behind_the_other(camera):
    shift = np.linspace(6.0, 14.0, 400)
    base = np.tile([10.0, 0.0, 300.0], (400, 1))
    tip = base + np.stack([shift, np.zeros(400), np.full(400, 2.0)], axis=-1)
    outlines = silhouettes(Pills(base, tip, np.tile([20.0, 10.0], (400, 1))), camera, 200)
    area = np.array([shapely.Polygon(outline).area for outline in outlines])
    assert np.abs(np.diff(area)).max() < 5e-3 * area[0]


@pytest.mark.parametrize("aside", [0.0, 1e-17, 1e-14, 1e-12, 1e-9, 1e-7, 1e-4])
@pytest.mark.parametrize("tip_radius", [9.0, 9.0 * 340 / 300])
def test_pill_nearly_end_on_keeps_its_touching_rays(aside, tip_radius):
    base = np.array([[70.0, -40.0, 300.0]])
    pills = Pills(base, base * (340 / 300) + [aside, 0.0, 0.0], np.array([[9.0, tip_radius]]))
    for camera in CAMERAS.values():
        rim = rims(pills, camera, 9)[0]
        np.testing.assert_allclose(gap_between_line_and_pill(pills, 0, *sight_lines(camera, rim)), 0.0, atol=1e-5)


def test_pill_seen_end_on_is_a_disc():
    pills = Pills(np.array([[0.0, 0.0, 300.0]]), np.array([[0.0, 0.0, 340.0]]), np.array([[9.0, 9.0]]))
    flat = silhouettes(pills, CAMERAS["orthographic"])[0] - [320.0, 240.0]
    np.testing.assert_allclose(np.hypot(*flat.T), 18.0, rtol=1e-12)
    deep = (silhouettes(pills, CAMERAS["perspective"])[0] - [310.0, 250.0]) / [600.0, 620.0]
    np.testing.assert_allclose(np.hypot(*deep.T), 9.0 / np.sqrt(300.0**2 - 81.0), rtol=1e-12)


def test_sphere_off_the_axis_is_seen_as_an_ellipse_not_a_circle():
    ball = Pills(np.array([[100.0, 0.0, 200.0]]), np.array([[100.0, 0.0, 200.0]]), np.array([[30.0, 30.0]]))
    slope = (silhouettes(ball, CAMERAS["perspective"], 100)[0] - [310.0, 250.0]) / [600.0, 620.0]
    wide, high = np.ptp(slope, axis=0)
    middle, half = np.arctan2(100.0, 200.0), np.arcsin(30.0 / np.hypot(100.0, 200.0))
    assert wide == pytest.approx(np.tan(middle + half) - np.tan(middle - half), rel=1e-3)
    assert wide > 1.1 * high


@pytest.mark.parametrize("depth", [-50.0, 0.0, 8.0])
def test_a_pill_not_wholly_in_front_of_the_lens_is_nan_and_the_others_are_not_touched(depth):
    pills = Pills(
        np.array([[0.0, 0.0, 100.0], [20.0, 0.0, 100.0]]),
        np.array([[30.0, 0.0, 90.0], [20.0, 0.0, depth]]),
        np.full((2, 2), 9.0),
    )
    outline = silhouettes(pills, CAMERAS["perspective"])
    assert np.isfinite(outline[0]).all() and np.isnan(outline[1]).all()
    alone = Pills(pills.base[:1], pills.tip[:1], pills.radius[:1])
    np.testing.assert_allclose(outline[0], silhouettes(alone, CAMERAS["perspective"])[0], rtol=1e-13)
    assert np.isfinite(silhouettes(pills, CAMERAS["orthographic"])).all()


def test_arcs_need_two_points():
    with pytest.raises(ValueError, match="n_arc is 1"):
        silhouettes(random_pills(0), CAMERAS["perspective"], n_arc=1)


SIZES = [(9.0, 9.0, 40.0), (10.0, 6.0, 30.0), (6.0, 10.0, 30.0), (10.0, 4.0, 5.0), (4.0, 10.0, 5.0), (8.0, 8.0, 0.0)]


@pytest.mark.parametrize("size", SIZES)
def test_mesh_is_closed_outward_and_like_a_sphere(size):
    vertices, faces = mesh(*size, n_around=12, n_cap=5)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    both = np.unique(edges, axis=0)
    assert len(both) == len(edges), "an edge runs twice in the same direction"
    np.testing.assert_array_equal(np.unique(edges[:, ::-1], axis=0), both)
    assert len(vertices) - len(edges) // 2 + len(faces) == 2  # Euler characteristic
    assert set(faces.ravel()) == set(range(len(vertices)))
    a, b, c = vertices[faces].swapaxes(0, 1)
    assert np.all(np.sum(np.cross(b - a, c - a) * ((a + b + c) / 3 - [size[2] / 2, 0, 0]), axis=1) > 0)


@pytest.mark.parametrize("size", SIZES)
def test_mesh_vertices_lie_on_the_pill(size):
    vertices, _ = mesh(*size, n_around=12, n_cap=5)
    s = np.linspace(0, 1, 4001)
    centre = np.stack([s * size[2], 0 * s, 0 * s], axis=-1)
    gap = np.linalg.norm(vertices[:, None] - centre, axis=-1) - (size[0] + s * (size[1] - size[0]))
    np.testing.assert_allclose(gap.min(axis=1), 0.0, atol=1e-5)


def test_volume_of_a_fine_mesh_is_that_of_the_capsule():
    vertices, faces = mesh(9.0, 9.0, 40.0, n_around=200, n_cap=80)
    volume = np.sum(np.linalg.det(vertices[faces])) / 6.0
    assert volume == pytest.approx(np.pi * 81 * 40 + 4 / 3 * np.pi * 729, rel=1e-3)


def test_mesh_refuses_impossible_sizes():
    with pytest.raises(ValueError, match="radii and length are 0"):
        mesh(0.0, 1.0, 3.0)
    with pytest.raises(ValueError, match="radii and length are nan"):
        mesh(float("nan"), 1.0, 3.0)
    with pytest.raises(ValueError, match="n_around, n_cap are 2, 1"):
        mesh(1.0, 1.0, 3.0, n_around=2, n_cap=1)


def test_hull_keeps_the_corners_alone_in_order():
    rng = np.random.default_rng(0)
    corners = np.array([[0.0, 0.0], [10.0, 0.0], [12.0, 7.0], [3.0, 9.0]])
    inner = rng.dirichlet(np.ones(4), 200) @ corners
    hull = convex_hull(np.concatenate([inner, corners]))
    start = int(np.argmin(np.hypot(*hull.T)))
    np.testing.assert_array_equal(np.roll(hull, -start, axis=0), corners)


@pytest.mark.parametrize(
    "points", [np.zeros((2, 2)), np.arange(10.0).reshape(5, 2), np.array([[0.0, 0.0], [1.0, 0.0], [np.nan, 1.0]])]
)
def test_points_without_area_have_no_hull(points):
    with pytest.raises(ValueError, match="not in line"):
        convex_hull(points)


def test_default_tolerance_is_the_perimeter_over_250_points():
    corners = np.array([[0.0, 0.0], [50.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
    limit = 400.0 / (250.0 * 5)
    for bump, kept in ((0.98 * limit, 4), (1.02 * limit, 5)):
        polygon = corners - np.array([[0, 0], [0, bump], [0, 0], [0, 0], [0, 0]])
        assert len(simplify(polygon)) == kept


@pytest.mark.parametrize("tolerance", [None, 0.5, 3.0])
def test_reduced_outline_stays_within_the_tolerance(tolerance):
    outline = silhouettes(random_pills(3), CAMERAS["perspective"], 60)[0]
    reduced = simplify(outline, tolerance)
    perimeter = shapely.polygons(outline).length
    assert 3 <= len(reduced) < len(outline)
    assert set(map(tuple, reduced)) <= set(map(tuple, outline))
    bound = perimeter / (250 * len(outline)) if tolerance is None else tolerance
    assert shapely.hausdorff_distance(shapely.polygons(outline), shapely.polygons(reduced)) <= bound + 1e-9


def test_simplify_names_bad_arguments():
    with pytest.raises(ValueError, match="polygon has 2 vertices"):
        simplify(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="tolerance is -1"):
        simplify(np.eye(3)[:, :2], -1.0)


def test_merged_finger_is_the_union_of_its_links():
    outlines = silhouettes(random_pills(5, n=4), CAMERAS["orthographic"])
    outlines[3] = np.nan
    merged = merged_polygon(outlines)
    xy = np.random.default_rng(1).uniform([0, 0], [640, 480], (4000, 2))
    each = [shapely.contains_xy(shapely.polygons(outline), xy) for outline in outlines[:3]]
    np.testing.assert_array_equal(shapely.contains_xy(merged, xy), np.any(each, axis=0))
    assert shapely.is_empty(merged_polygon([]))
