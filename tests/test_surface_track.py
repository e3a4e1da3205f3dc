"""A skinned hand is followed, with sigmas that are honest; what cannot be seen is said to be so."""

import cv2
import numpy as np
import pytest
from made_hand import made_hand

from handtrack.camera import orthographic
from handtrack.report import draw_overlay
from handtrack.settings import Settings
from handtrack.surface import bind, dense
from handtrack.surface.align import align, patch_scatter
from handtrack.surface.dense import chosen_pixels, dense_rows
from handtrack.surface.image import EDGE, INSIDE, box_of, expected_image, shade_box_numpy
from handtrack.surface.learning import learn_surface
from handtrack.surface.outline import outline_numpy, outline_pieces, vertex_motion
from handtrack.surface.tracking import track_surface
from handtrack.surface.view import moving_box, view_of
from synth.mesh_scene import mesh_scene
from synth.scene import clean_image, images, images_together
from synth.views import with_views

MESH = made_hand()
SMALL = {"size": (320, 240), "zoom": 1.8, "noise": 1.5}
CLIP = mesh_scene(3, MESH, frames=6, scale=0.85, mirror=True, tilt=25.0, start_error=1.0, **SMALL)
SURFACE = bind(CLIP.model, MESH)
PICTURES = [np.asarray(picture, dtype=float) for picture in images(CLIP)]


@pytest.fixture(scope="module")
def tracked():
    return track_surface(PICTURES, SURFACE, CLIP.camera, CLIP.start)


@pytest.fixture(scope="module")
def learnt():
    out = None
    for frame in range(3):
        out = learn_surface(PICTURES[frame], SURFACE, CLIP.camera, CLIP.truth[frame], out)
    return out


def test_a_mirrored_smaller_hand_is_followed_within_half_a_degree(tracked):
    off = np.degrees(tracked.q - CLIP.truth)
    assert np.sqrt((off**2).mean(axis=0)).max() < 0.5
    assert (tracked.status == "tracked").all() and (tracked.confidence > 0.8).all()


def test_its_sigmas_are_honest(tracked):
    off = tracked.q - CLIP.truth
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(tracked.covariance), off)
    assert 0.15 < nees.mean() / 12.0 < 1.8
    assert (np.abs(off) < 2.0 * tracked.sigma).mean() > 0.9


def test_the_same_images_give_the_same_track(tracked):
    again = track_surface(PICTURES[:2], SURFACE, CLIP.camera, CLIP.start)
    np.testing.assert_array_equal(again.q, tracked.q[:2])
    np.testing.assert_array_equal(again.covariance, tracked.covariance[:2])


def test_a_dark_palm_does_not_spoil_the_light():
    clip = mesh_scene(5, MESH, frames=3, covered=True, tilt=35.0, **SMALL)
    found = track_surface(images(clip), bind(clip.model, MESH), clip.camera, clip.start)
    assert np.degrees(np.sqrt(((found.q - clip.truth) ** 2).mean(axis=0))).max() < 0.8


@pytest.mark.parametrize(("blur", "most"), [(0.5, 0.8), (1.0, 3.5)])
def test_a_blurred_picture_is_followed_too(blur, most):
    rng, soft = np.random.default_rng(1), []
    for frame in range(2):
        clean = cv2.GaussianBlur(np.asarray(clean_image(CLIP, frame), dtype=float), (0, 0), blur)
        soft.append(clean + rng.normal(0.0, 1.5, clean.shape))
    found = track_surface(soft, SURFACE, CLIP.camera, CLIP.start)
    assert np.degrees(np.sqrt(((found.q - CLIP.truth[:2]) ** 2).mean(axis=0))).max() < most


def test_two_views_in_perspective_are_solved_together():
    small = {**SMALL, "size": (200, 150), "zoom": 1.1}
    clip = with_views(mesh_scene(4, MESH, frames=2, projection="perspective", **small), 2)
    surface = bind(clip.model, MESH)
    both = track_surface(images_together(clip), surface, clip.cameras, clip.start)
    one = track_surface(images(clip), surface, clip.camera, clip.start)
    assert np.degrees(np.abs(both.q - clip.truth)).max() < 1.0
    assert np.median(both.sigma / one.sigma) < 0.95 and both.view_edges is not None
    assert (both.view_edges > 10).all()


def test_without_a_hand_the_track_says_lost_and_keeps_its_pose(tracked):
    blank = np.full_like(PICTURES[0], 8.0) + np.random.default_rng(1).normal(0.0, 1.5, PICTURES[0].shape)
    found = track_surface([*PICTURES[:2], blank, blank], SURFACE, CLIP.camera, CLIP.start)
    assert found.status[1] == "tracked" and (found.status[2:] == "lost").all()
    assert not found.information[2:].any() and (found.sigma[3] > found.sigma[1]).all()
    assert np.isfinite(found.q).all()


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="start_pose: got 3 values"):
        track_surface(PICTURES, SURFACE, CLIP.camera, np.zeros(3))
    with pytest.raises(ValueError, match="image: got 320 x 100 pixels"):
        track_surface([PICTURES[0][:100]], SURFACE, CLIP.camera, CLIP.start)
    with pytest.raises(ValueError, match="1 images for 2 cameras"):
        track_surface([(PICTURES[0],)], SURFACE, [CLIP.camera, CLIP.camera], CLIP.start)
    with pytest.raises(ValueError, match="no image"):
        track_surface([], SURFACE, CLIP.camera, CLIP.start)


def test_the_overlay_shows_the_skin(tracked):
    plain = draw_overlay(PICTURES[2], tracked, 2, CLIP.model, CLIP.camera)
    skinned = draw_overlay(PICTURES[2], tracked, 2, CLIP.model, CLIP.camera, surface=SURFACE)
    assert skinned.shape == plain.shape and (skinned != plain).any(axis=2).mean() > 0.02


def rendered(u, appearance, box):
    """Expected levels in a given box, in plain NumPy."""
    view = view_of(SURFACE, CLIP.camera, u)
    low, size = np.array([box.x0, box.y0], dtype=float), np.array(box.kind.shape[::-1], dtype=float)
    moved = box_of(SURFACE, CLIP.camera, view, low, low + size - 1.0)
    return shade_box_numpy(SURFACE, view, moved, appearance), moved


def test_residuals_are_those_of_the_expected_image_in_units_of_the_noise(learnt):
    u = CLIP.truth[2]
    rows = dense_rows(PICTURES[2], SURFACE, CLIP.camera, u, learnt)
    view = view_of(SURFACE, CLIP.camera, u)
    box = box_of(SURFACE, CLIP.camera, view, *moving_box(SURFACE, CLIP.camera, view, 2.0))
    should = expected_image(SURFACE, CLIP.camera, view, learnt, box)
    off = (PICTURES[2] - should)[rows.row, rows.column] / learnt.noise
    np.testing.assert_allclose(rows.r, off, atol=1e-6)
    assert {1, 2, 3} == set(rows.kind.tolist()) and rows.contrast[rows.kind == EDGE].max() > 20.0


def test_derivatives_inside_the_surface_are_those_of_differences(learnt):
    u, h = CLIP.truth[2], 2e-5
    rows = dense_rows(PICTURES[2], SURFACE, CLIP.camera, u, learnt)
    view = view_of(SURFACE, CLIP.camera, u)
    box = box_of(SURFACE, CLIP.camera, view, *moving_box(SURFACE, CLIP.camera, view, 2.0))
    for j in (0, 4, 11):
        step = h * (np.arange(u.size) == j)
        (ahead, one), (behind, other) = (rendered(u + s, learnt, box) for s in (step, -step))
        slope = -(ahead - behind) / (2 * h) / learnt.noise
        row, column = rows.row - box.y0, rows.column - box.x0
        same = (rows.kind == INSIDE) & (one.triangle == other.triangle)[row, column]
        same &= (one.kind == INSIDE)[row, column] & (other.kind == INSIDE)[row, column]
        np.testing.assert_allclose(rows.J[same, j], slope[row, column][same], atol=2e-2 * np.abs(rows.J[:, j]).max())
        assert same.sum() > 100


def test_derivatives_on_outlines_are_those_of_differences_on_average(learnt):
    """Single pixels jump with their few samples; stretches of outline do not."""
    u, h = CLIP.truth[2], 1e-3
    rows = dense_rows(PICTURES[2], SURFACE, CLIP.camera, u, learnt)
    view = view_of(SURFACE, CLIP.camera, u)
    box = box_of(SURFACE, CLIP.camera, view, *moving_box(SURFACE, CLIP.camera, view, 2.0))
    edge = rows.kind == EDGE
    row, column = rows.row - box.y0, rows.column - box.x0
    for j in (0, 3, 9):
        step = h * (np.arange(u.size) == j)
        slope = -(rendered(u + step, learnt, box)[0] - rendered(u - step, learnt, box)[0]) / (2 * h) / learnt.noise
        moved, differs = rows.J[edge, j], slope[row, column][edge]
        strong = np.abs(moved) > 0.05 * np.abs(moved).max()
        assert (moved[strong] @ differs[strong]) / (moved[strong] @ moved[strong]) == pytest.approx(1.0, abs=0.2)


def test_what_outlines_add_is_that_of_the_plain_twin(learnt, monkeypatch):
    u = CLIP.truth[2]
    view = view_of(SURFACE, CLIP.camera, u)
    box = box_of(SURFACE, CLIP.camera, view, *moving_box(SURFACE, CLIP.camera, view, 2.0))
    rows = dense_rows(PICTURES[2], SURFACE, CLIP.camera, u, learnt)
    row_of = np.full(box.triangle.shape, -1)
    row_of[rows.row - box.y0, rows.column - box.x0] = np.arange(rows.r.size)
    pieces = outline_pieces(SURFACE, CLIP.camera, view, u, vertex_motion(SURFACE, CLIP.camera, u))
    J, contrast = outline_numpy(SURFACE, view, pieces, learnt, row_of, box)
    np.testing.assert_allclose(contrast, rows.contrast[: contrast.size], atol=1e-6)
    monkeypatch.setattr(dense.kernels, "add_outline", lambda *given: None)
    added = rows.J - dense_rows(PICTURES[2], SURFACE, CLIP.camera, u, learnt).J
    np.testing.assert_allclose(J, added, atol=1e-6 * np.abs(added).max())


def test_alignment_goes_back_to_the_pose_it_was_moved_from(learnt):
    u, sigma = CLIP.truth[2], np.radians(0.4)
    off = sigma * np.random.default_rng(2).normal(size=u.size)
    wide, near = 1e-4 * np.eye(u.size), sigma**2 * np.eye(u.size)
    found = align([PICTURES[2]], SURFACE, [CLIP.camera], [learnt], u + off, u + off, wide, near)
    left = np.degrees(np.abs(found.u - u))
    claimed = np.degrees(np.sqrt(np.diag(np.linalg.inv(found.information))))
    assert (left < 3.0 * claimed).all() and left.mean() < 0.6 * np.degrees(np.abs(off)).mean()
    assert np.linalg.eigvalsh(found.information).min() > 0.0 and 0.0 <= found.conflict <= 20.0


def test_pixels_at_the_ends_of_the_scale_are_left_out(learnt):
    view = view_of(SURFACE, CLIP.camera, CLIP.truth[2])
    box = box_of(SURFACE, CLIP.camera, view, *moving_box(SURFACE, CLIP.camera, view, 2.0))
    for level in (0.0, 255.0):
        assert not chosen_pixels(SURFACE, box, np.full(box.kind.shape, level), 3).any()
    few = dense_rows(np.full_like(PICTURES[0], 255.0), SURFACE, CLIP.camera, CLIP.truth[2], learnt)
    assert few.r.size == 0


def test_patches_that_share_an_error_are_found_out():
    rng = np.random.default_rng(3)
    patch, kind = np.repeat(np.arange(80), 20), np.ones(1600, dtype=int)
    s, tau = patch_scatter(rng.normal(0.0, 1.3, 1600) + np.repeat(rng.normal(0.0, 0.8, 80), 20), patch, kind)
    assert s[0] == pytest.approx(1.3, abs=0.1) and tau[0] == pytest.approx(0.8, abs=0.2)
    alone, none = patch_scatter(rng.normal(0.0, 1.0, 6), np.arange(6), np.ones(6, dtype=int))
    assert none[0] == 0.0 and alone[0] >= 0.8


def test_one_side_of_the_hand_alone_still_tells_of_a_dark_finger(learnt):
    """Albedo: a finger painted half as bright gets half the albedo, the others stay as they were."""
    view = view_of(SURFACE, CLIP.camera, CLIP.truth[2])
    whole = np.array([0.0, 0.0]), np.array([CLIP.camera.width - 1.0, CLIP.camera.height - 1.0])
    box = box_of(SURFACE, CLIP.camera, view, *whole)
    first = CLIP.model.link_finger[0]
    painted = PICTURES[2].copy()
    mine = (box.triangle >= 0) & (SURFACE.finger[SURFACE.region[box.triangle]] == first)
    painted[mine] = 0.5 * painted[mine]
    out = learnt
    for _ in range(12):
        out = learn_surface(painted, SURFACE, CLIP.camera, CLIP.truth[2], out)
    seen = np.unique(SURFACE.triangles[box.triangle[mine & (box.kind == INSIDE)]])
    other = np.unique(SURFACE.triangles[box.triangle[(box.triangle >= 0) & ~mine & (box.kind == INSIDE)]])
    other = other[out.count[other] > 4.0]
    assert np.median(out.albedo[seen]) == pytest.approx(0.5, abs=0.15)
    assert np.median(out.albedo[other]) == pytest.approx(1.0, abs=0.03)


def test_settings_that_matter_are_taken():
    fast = track_surface(PICTURES[:2], SURFACE, CLIP.camera, CLIP.start, settings=Settings(passes=1, filter="none"))
    assert np.degrees(np.abs(fast.q[1] - CLIP.truth[1])).max() < 1.5


def test_a_hand_outside_the_picture_is_not_learnt():
    away = orthographic(60, 50, 1.0, -500.0, 20.0, CLIP.camera.R, CLIP.camera.t)
    found = learn_surface(np.full((50, 60), 9.0), SURFACE, away, CLIP.truth[0])
    assert found.background == pytest.approx(9.0) and np.isfinite(found.table).all()
