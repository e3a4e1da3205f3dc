"""Labels of an image hold for every pixel and keypoint: brute-force rays, supersampling and plain NumPy agree."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from label_shots import camera_of, shot, still

from handtrack.camera import project_camera, rays
from handtrack.pills import ray_hits
from synth import _kernels
from synth.labels import image as imaging
from synth.labels import plain
from synth.labels.geometry import KNOTS, boxes_of, geometry, hull, instants, window_grid
from synth.labels.image import lattice, light_table, noise_key, paint_table
from synth.labels.look import Canvas, labelled
from synth.labels.seen import places, see
from synth.labels.shot import Exposure, Shot, keypoints_at, solids_at
from synth.raycast import pixel_grid

SHOTS = [
    {},
    {"kind": "orthographic"},
    {"bent": True, "left": True},
    {"mesh": True},
    {"mesh": True, "kind": "orthographic", "left": True},
    {"mesh": True, "bent": True},
]
each_shot = pytest.mark.parametrize("options", SHOTS, ids=str)


def sensed(background, window, span, exposure, key):
    out = np.empty_like(background)
    imaging.sensed(background, window, span, exposure, key, out)
    return out


def oracle(one: Shot, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth and part of the first surface on rays through image positions: exact pills, and Embree for triangles."""
    solids, camera = solids_at(one, 0.0), one.camera
    origin, direction = rays(camera, xy)
    if camera.kind == "orthographic":
        origin = origin - 500.0 * direction
    hits = ray_hits(solids.pills, origin, direction)
    depth, part = hits.t, np.where(hits.pill >= 0, solids.pill_part[hits.pill] if hits.pill.size else -1, -1)
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    mesh = trimesh.Trimesh(solids.vertices, solids.triangles, process=False)
    # Embree works in single precision: of several hits within a micrometre it may name any.
    places, ray, triangle = RayMeshIntersector(mesh).intersects_location(origin, direction, multiple_hits=False)
    t = np.full(xy.shape[0], np.inf)
    t[ray] = places[:, 2] - origin[ray, 2]
    owner = np.full(xy.shape[0], -1)
    owner[ray] = solids.triangle_part[triangle]
    part = np.where(t < depth, owner, part)
    return np.minimum(t, depth) + origin[:, 2], part


@each_shot
def test_depth_and_part_of_every_pixel_are_those_of_its_ray(options):
    one = shot(1, **options)
    found = labelled(one)
    v, u = np.mgrid[: one.camera.height, : one.camera.width]
    depth, part = oracle(one, np.column_stack([u.ravel(), v.ravel()]).astype(float))
    same = part.reshape(v.shape) == found.part
    # Single precision: a ray may pass an edge of two triangles on the other side.
    assert same.mean() > (0.9990 if options.get("mesh") else 0.9997)
    assert (found.part >= 0).sum() > 500
    seen = same & (found.part >= 0)
    np.testing.assert_allclose(found.depth[seen], depth.reshape(v.shape)[seen], atol=2e-2)
    assert np.isinf(found.depth[found.part < 0]).all()


@each_shot
@pytest.mark.parametrize("seed", [2, 3])
def test_keypoints_are_visible_where_a_ray_says_so_and_name_what_hides_them(options, seed):
    one = shot(seed, **options)
    found = labelled(one)
    marks = keypoints_at(one, 0.0)
    np.testing.assert_allclose(found.keypoint, project_camera(one.camera, marks.p_cam))
    depth, part = oracle(one, found.keypoint.reshape(-1, 2))
    own = (marks.own.ravel() >> np.maximum(part, 0).astype(np.uint64)) & np.uint64(1) == 1
    hidden = (part >= 0) & ~own & (depth < marks.p_cam.reshape(-1, 3)[:, 2])
    inside = ((found.keypoint >= -0.5) & (found.keypoint < (one.camera.width - 0.5, one.camera.height - 0.5))).all(-1)
    np.testing.assert_array_equal(found.visibility, np.where(inside, np.where(hidden.reshape(1, 21), 1, 2), 0))
    np.testing.assert_array_equal(found.hidden_by, np.where(found.visibility == 1, part.reshape(1, 21), -1))


@each_shot
def test_modal_masks_partition_the_foreground_and_lie_inside_amodal_ones(options):
    found = labelled(shot(4, **options))
    foreground = found.part >= 0
    np.testing.assert_array_equal(foreground, np.isfinite(found.depth))
    np.testing.assert_array_equal(foreground, found.amodal != 0)
    bit = found.amodal[foreground] >> found.part[foreground].astype(np.uint64)
    assert (bit & np.uint64(1)).all()
    np.testing.assert_allclose(np.linalg.norm(found.normal[foreground], axis=1), 1.0, atol=1e-6)
    assert not found.normal[~foreground].any() and not found.flow[~foreground].any()


@each_shot
def test_a_part_alone_shows_its_amodal_mask(options):
    one = shot(5, **options)
    found = labelled(one)
    last = len(one.bodies) - 1  # the stick before all others, then each occluder alone
    for k in range(1, last + 1):
        part = int(np.flatnonzero(one.parts.instance == k)[0])
        alone = replace(one, bodies=(one.bodies[k],), parts=_parts(one, k))
        np.testing.assert_array_equal(labelled(alone).part >= 0, found.amodal >> np.uint64(part) & np.uint64(1) == 1)


def _parts(one: Shot, k: int):
    from synth.labels.shot import parts_of

    return parts_of((one.bodies[k],))


@each_shot
@pytest.mark.parametrize("size", [(160, 120), (40, 30)], ids=["large", "small"])
def test_visible_fractions_are_those_of_64_samples_in_every_pixel(options, size):
    for seed in (6, 7):
        one = shot(seed, size=size, **options)
        found = labelled(one)
        visible, amodal = _supersampled(one)
        shown = amodal > 0.5
        assert shown.sum() > 15
        np.testing.assert_allclose(found.amodal_area[shown], amodal[shown], atol=0.5, rtol=0.01)
        error = np.abs(found.fraction[shown] - visible[shown] / amodal[shown])
        assert error[amodal[shown] > 4].max() < 0.01
        assert error.max() < 0.05


def _supersampled(one: Shot, side: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Visible and amodal area of parts from a regular grid of side x side rays in every pixel."""
    camera = one.camera
    solids = [solids_at(one, 0.0)]
    boxes = boxes_of(solids, camera)
    here = geometry(solids, camera, boxes, (0, camera.width, 0, camera.height))
    shape = (camera.height, camera.width)
    visible, amodal = np.zeros(len(one.parts.name)), np.zeros(len(one.parts.name))
    for dy in (np.arange(side) + 0.5) / side - 0.5:
        for dx in (np.arange(side) + 0.5) / side - 0.5:
            depth, surface = np.full(shape, np.inf), np.full(shape, -1, np.int32)
            bits = np.zeros(shape, np.uint64)
            _kernels.scan(
                here.grid, here.pinhole, here.tables, here.pills, here.vertices, here.triangles, here.knot,
                here.blend, here.boxes, here.part_of, (float(dx), float(dy)), depth, surface, bits,
            )  # fmt: skip
            visible += np.bincount(here.part_of[surface[surface >= 0]], minlength=visible.size)
            amodal += [(bits >> np.uint64(p) & np.uint64(1)).sum() for p in range(amodal.size)]
    return visible / side**2, amodal / side**2


@each_shot
@pytest.mark.parametrize("readout", [0.0, 0.8])
def test_compiled_loops_agree_with_their_plain_twins(options, readout):
    one = shot(8, size=(64, 48), **options)
    camera, times = one.camera, instants(readout)
    now, after = ([solids_at(one, s + by) for s in times] for by in (0.0, 1.0))
    boxes = boxes_of(now, camera)
    span = hull(boxes, camera)
    here, there = (geometry(solids, camera, boxes, span) for solids in (now, after))
    assert here.vertices.shape[0] == (KNOTS if readout else 1)
    seen = see(here, len(one.parts.name))
    v, u = (rows.ravel() for rows in np.mgrid[: seen.part.shape[0], : seen.part.shape[1]])
    xy = here.grid[:, 1:-1, 1:-1].reshape(2, -1).T
    depth, surface, bits = plain.scan(here, xy, v)
    same = seen.surface.ravel() == surface
    assert same.mean() > 0.999
    np.testing.assert_allclose(seen.depth.ravel()[same], depth[same], rtol=1e-9)
    assert (seen.bits.ravel() == bits).mean() > 0.999
    hit = same & (surface >= 0)
    args = xy[hit], v[hit], depth[hit], surface[hit]
    placed = plain.places(here, *args)
    found = labelled(replace(one, exposure=Exposure(readout=readout)))
    y, x = v[hit] + span[2], u[hit] + span[0]
    np.testing.assert_allclose(found.normal[y, x], placed[:3].T, atol=1e-5)
    target = plain.flow(here, there, camera, *args)
    np.testing.assert_allclose(found.flow[y, x], target - np.column_stack([x, y]), atol=2e-4)
    calm = (seen.first.ravel() < 0)[hit]
    table = paint_table(one.paint)[here.part_of[surface[hit]]]
    lit = plain.lit(placed, xy[hit], here.pinhole, table, light_table(one.lights), one.lights.ambient, lattice())
    level = np.clip(np.rint(lit), 0, 255)
    np.testing.assert_allclose(found.image[y, x][calm].astype(float), level[calm], atol=1.0)


def test_samples_of_edge_pixels_agree_with_the_plain_twin():
    one = shot(9, size=(120, 90))
    solids = [solids_at(one, 0.0)]
    boxes = boxes_of(solids, one.camera)
    here = geometry(solids, one.camera, boxes, hull(boxes, one.camera))
    seen = see(here, len(one.parts.name))
    v, u = np.nonzero(seen.first >= 0)
    level = seen.level[v, u].astype(int)
    assert set(np.unique(level)) >= {16, 64}
    at = np.concatenate([np.arange(n) for n in level])
    which = np.repeat(np.arange(v.size), level)
    pattern = np.searchsorted([8, 16], level)[which]
    offset = places()[pattern, at]
    grid, i, j = here.grid, v[which] + 1, u[which] + 1
    xy = np.stack(
        [
            g[i, j] + 0.5 * (offset[:, 0] * (g[i, j + 1] - g[i, j - 1]) + offset[:, 1] * (g[i + 1, j] - g[i - 1, j]))
            for g in grid
        ],
        axis=1,
    )
    depth, surface, _ = plain.scan(here, xy, v[which])
    index = seen.first[v, u][which] + at
    assert (seen.sample_surface[index] == surface).mean() > 0.999
    same = seen.sample_surface[index] == surface
    np.testing.assert_allclose(seen.sample_depth[index][same], depth[same], rtol=1e-9)


@pytest.mark.parametrize("options", [{}, {"mesh": True}, {"bent": True}], ids=str)
def test_flow_leads_every_surface_point_to_where_it_is_in_the_next_frame(options):
    one = shot(10, size=(160, 120), speed=0.4, **options)
    found = labelled(one)
    nxt = replace(one, bodies=tuple(_later(body) for body in one.bodies))
    after = labelled(nxt)
    v, u = np.nonzero(found.part >= 0)
    to = np.rint(np.column_stack([u, v]) + found.flow[v, u]).astype(int)
    inside = ((to >= 0) & (to < (160, 120))).all(axis=1)
    v, u, to = v[inside], u[inside], to[inside]
    assert (after.part[to[:, 1], to[:, 0]] == found.part[v, u]).mean() > 0.85  # the rest: edges and new occlusions
    assert np.abs(found.flow).max() > 2.0
    assert not labelled(still(one)).flow.any() or np.abs(labelled(still(one)).flow).max() < 1e-4


def _later(body):
    """The body as it stands in the next frame."""
    from synth.labels.bodies import Placed

    R, t, q = body.placed.R, body.placed.t, body.q
    return replace(body, q=q[[1, 1]], placed=Placed(R[[1, 1]], t[[1, 1]]))


def test_a_still_scene_looks_the_same_blurred_and_read_row_by_row():
    one = still(shot(11, size=(120, 90)))
    sharp = labelled(one)
    rolled = labelled(replace(one, exposure=Exposure(readout=0.7)))
    np.testing.assert_array_equal(rolled.part, sharp.part)
    np.testing.assert_allclose(rolled.keypoint, sharp.keypoint, atol=1e-9)
    np.testing.assert_array_equal(rolled.image, sharp.image)
    blurred = labelled(replace(one, exposure=Exposure(blur=0.5)))
    difference = blurred.image.astype(float) - sharp.image
    assert np.abs(difference).mean() < 1.5  # both are means over pixels, from other samples
    np.testing.assert_array_equal(blurred.part, sharp.part)


def test_a_rolling_shutter_sees_each_row_at_its_own_instant():
    one = shot(12, size=(80, 60), speed=3.0)
    found = labelled(replace(one, exposure=Exposure(readout=0.8)))
    for row in (10, 30, 50):
        s = 0.8 * (row / 59 - 0.5)
        bodies = tuple(_at(body, s) for body in one.bodies)
        then = labelled(replace(one, bodies=bodies))
        assert (found.part[row] == then.part[row]).mean() > 0.96
    assert (found.part != labelled(one).part).mean() > 0.01


def _at(body, s: float):
    """The body held still at a share of the frame interval."""
    from synth.labels.bodies import Placed, placement_at

    R, t = placement_at(body.placed, s)
    q = body.q[0] + s * (body.q[1] - body.q[0])
    return replace(body, q=np.stack([q, q]), placed=Placed(np.stack([R, R]), np.stack([t, t])))


def test_keypoints_of_a_rolling_shutter_lie_where_their_row_saw_them():
    one = replace(shot(13, size=(80, 60), speed=3.0), exposure=Exposure(readout=0.8))
    found = labelled(one)
    for k in range(21):
        s = 0.8 * (np.clip(found.keypoint[0, k, 1], 0, 59) / 59 - 0.5)
        then = project_camera(one.camera, keypoints_at(one, s).p_cam[0, k])
        np.testing.assert_allclose(found.keypoint[0, k], then, atol=0.02)


def test_blur_spreads_light_along_the_motion_and_keeps_its_sum():
    one = shot(14, size=(160, 120), speed=2.0)
    one = replace(one, background=np.zeros_like(one.background))
    sharp, blurred = (labelled(replace(one, exposure=Exposure(blur=b))) for b in (0.0, 0.9))
    assert (blurred.image.sum(axis=2) > 0).sum() > 1.1 * (sharp.image.sum(axis=2) > 0).sum()
    assert abs(blurred.image.mean() / sharp.image.mean() - 1.0) < 0.1


@pytest.mark.parametrize("noise", [0.5, 3.0, 12.0])
def test_noise_is_normal_white_and_of_the_wanted_size(noise):
    background = np.full((200, 300, 3), 128, np.uint8)
    exposure = Exposure(noise=noise)
    images = [
        sensed(background, np.zeros((0, 0, 3), np.float32), (0, 0, 0, 0), exposure, noise_key(1, i)) for i in (0, 1)
    ]
    one, two = (image.astype(float) - 128.0 for image in images)
    expected = np.hypot(noise, np.sqrt(1 / 12))  # rounding adds its own
    assert abs(one.std() / expected - 1.0) < 0.02 and abs(one.mean()) < 0.05 * expected
    assert noise < 1.0 or abs(np.mean(one**4) / one.std() ** 4 - 3.0) < 0.1  # steps of one level are coarse for less
    scaled = one / one.std()
    for a, b in (
        (scaled[1:], scaled[:-1]),
        (scaled[:, 1:], scaled[:, :-1]),
        (scaled[..., 0], scaled[..., 1]),
        (scaled, two / two.std()),
    ):
        assert abs((a * b).mean()) < 0.015


@settings(max_examples=20, deadline=None)
@given(gain=st.floats(0.3, 2.0), vignette=st.floats(0.0, 1.0), seed=st.integers(0, 9))
def test_gain_and_vignette_agree_with_the_plain_twin(gain, vignette, seed):
    rng = np.random.default_rng(seed)
    background = rng.integers(0, 256, (15, 20, 3)).astype(np.uint8)
    window, span = rng.uniform(0, 255, (4, 6, 3)).astype(np.float32), (3, 9, 5, 9)
    exposure = Exposure(gain=gain, vignette=vignette)
    expected = plain.sensed(background, window, span, gain, vignette)
    found = sensed(background, window, span, exposure, noise_key(0, 0))
    np.testing.assert_allclose(found, np.clip(np.floor(expected + 0.5), 0, 255), atol=1.0)
    clear = np.abs(expected % 1.0 - 0.5) > 1e-3
    np.testing.assert_array_equal(found[clear], np.clip(np.floor(expected + 0.5), 0, 255)[clear])


def test_the_same_shot_gives_the_same_bytes_and_another_index_other_noise():
    one = replace(shot(15), exposure=Exposure(noise=4.0, blur=0.3))
    first, again, other = labelled(one), labelled(one), labelled(replace(one, index=one.index + 1))
    for name in ("image", "depth", "normal", "part", "amodal", "flow", "keypoint", "fraction"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert (first.image != other.image).mean() > 0.5
    np.testing.assert_array_equal(first.part, other.part)


def test_a_canvas_used_again_shows_nothing_of_the_image_before():
    first, second = shot(18), shot(19, mesh=True)
    canvas = Canvas(96, 72)
    labelled(first, canvas)
    again, fresh = labelled(second, canvas), labelled(second)
    assert again.image is canvas.image
    for name in ("image", "depth", "normal", "part", "amodal", "flow"):
        np.testing.assert_array_equal(getattr(again, name), getattr(fresh, name))


def test_boxes_hold_the_pixels_of_every_instance():
    found = labelled(shot(16, size=(160, 120), mesh=True))
    for k in range(len(found.parts.kind)):
        mine = np.flatnonzero(found.parts.instance == k)
        modal = np.isin(found.part, mine)
        amodal = np.zeros(modal.shape, bool)
        for part in mine:
            amodal |= found.amodal >> np.uint64(part) & np.uint64(1) == 1
        for box, mask in ((found.modal_box[k], modal), (found.amodal_box[k], amodal)):
            v, u = np.nonzero(mask)
            expected = (u.min(), v.min(), u.max() + 1, v.max() + 1) if v.size else (0, 0, 0, 0)
            assert tuple(box) == expected


def test_nothing_in_view_gives_empty_labels():
    one = shot(17)
    away = replace(one.camera, t=one.camera.t + np.array([5000.0, 0.0, 0.0]))
    found = labelled(replace(one, camera=away))
    assert (found.part == -1).all() and not found.visibility.any() and np.isnan(found.fraction).all()
    np.testing.assert_array_equal(found.image, one.background)


@pytest.mark.parametrize("bent", [False, True])
@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
def test_the_windows_grid_is_that_of_the_whole_image(kind, bent):
    camera = camera_of(kind, (60, 40), bent)
    grid = window_grid(camera, (7, 31, 4, 25))
    np.testing.assert_allclose(grid.transpose(1, 2, 0), pixel_grid(camera)[4:27, 7:33], atol=1e-12)


def test_patterns_of_samples_fill_the_pixel_evenly():
    for i, n in enumerate((8, 16, 64)):
        pattern = places()[i, :n]
        assert np.abs(pattern).max() < 0.5 and np.abs(pattern.mean(axis=0)).max() < 1e-12
        np.testing.assert_allclose((pattern**2).mean(axis=0), 1 / 12, rtol=0.07)
