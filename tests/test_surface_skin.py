"""Skinning obeys its laws; the compiled loops do what their plain twins do; derivatives are those of differences."""

from dataclasses import replace

import numpy as np
import pytest
from made_hand import made_hand

from handtrack.camera import orthographic, perspective
from handtrack.kinematics import FrameRow, forward, model_from_rows
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.surface import Surface, bind, drives_by_name, pose_skin
from handtrack.surface.binding import mirrored
from handtrack.surface.residuals import SurfaceFeatures, surface_residuals, surface_shape_jacobian
from handtrack.surface.skin import edge_points, normals_numpy, points_numpy, posed_numpy, vertex_normals
from synth.mesh import posed_hand
from synth.mesh_hand import mesh_hand, resized

MESH = made_hand()
MODEL, HAND = mesh_hand(MESH, abduction=True)
SURFACE = bind(MODEL, MESH)
FRONT = orthographic(320, 240, 1.5, 160.0, 120.0, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 300.0]))
NEAR = perspective(320, 240, 400.0, 380.0, 160.0, 120.0, np.diag([1.0, -1.0, -1.0]), np.array([3.0, -5.0, 300.0]))
SOME = np.arange(0, MESH.vertices.shape[0], 7)


def pose(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.1, 0.6, len(MODEL.joint_names))


def in_world(p, camera):
    return (p - camera.t) @ camera.R


def test_at_the_rest_pose_every_vertex_is_where_the_mesh_has_it():
    skin = pose_skin(SURFACE, FRONT, SURFACE.rest)
    np.testing.assert_allclose(in_world(skin.p, FRONT), MESH.vertices, atol=1e-5)
    np.testing.assert_allclose(skin.normal @ FRONT.R, MESH.normals, atol=1e-5)
    assert SURFACE.misfit.max() < 1e-5 and SURFACE.scale == pytest.approx(1.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_linear_blend_agrees_with_the_renderers_own_skinning(seed):
    vertices, normals = posed_hand(HAND, MODEL, pose(seed))
    skin = pose_skin(SURFACE, FRONT, pose(seed))
    np.testing.assert_allclose(in_world(skin.p, FRONT), vertices, atol=1e-3)
    np.testing.assert_allclose(skin.normal @ FRONT.R, normals, atol=1e-4)


def test_a_rigid_motion_of_the_base_moves_every_vertex_along():
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0, 5.0], [np.sin(angle), np.cos(angle), 0.0, -3.0]])
    turn = np.vstack([turn, [0.0, 0.0, 1.0, 9.0], [0.0, 0.0, 0.0, 1.0]])
    fixed = MODEL.parent < 0
    prefix = np.where(fixed[:, None, None], turn @ MODEL.prefix, MODEL.prefix)
    moved = bind(replace(MODEL, prefix=prefix), MESH)
    p, q = (in_world(pose_skin(s, FRONT, pose(4)).p, FRONT) for s in (SURFACE, moved))
    np.testing.assert_allclose(q, p @ turn[:3, :3].T + turn[:3, 3], atol=1e-3)


@pytest.mark.parametrize("camera", [FRONT, NEAR])
def test_posed_vertices_and_normals_are_those_of_the_plain_twin(camera):
    compiled, plain = pose_skin(SURFACE, camera, pose(5)), posed_numpy(SURFACE, camera, pose(5))
    np.testing.assert_allclose(compiled.p, plain.p, atol=1e-9)
    np.testing.assert_allclose(compiled.normal, plain.normal, atol=1e-12)


def test_points_normals_and_their_derivatives_are_those_of_the_plain_twins():
    ends, share = np.stack([SOME, (SOME + 1) % MESH.vertices.shape[0]], axis=1), np.linspace(0.0, 1.0, SOME.size)
    for compiled, plain in (
        (edge_points(SURFACE, ends, share, pose(6)), points_numpy(SURFACE, ends, share, pose(6))),
        (vertex_normals(SURFACE, SOME, pose(6)), normals_numpy(SURFACE, SOME, pose(6))),
    ):
        np.testing.assert_allclose(compiled[0], plain[0], atol=1e-9)
        np.testing.assert_allclose(compiled[1], plain[1], atol=1e-9)


def test_derivatives_of_points_and_normals_are_those_of_differences():
    u, h = pose(7), 1e-6
    ends, share = np.stack([SOME, SOME[::-1]], axis=1), np.full(SOME.size, 0.3)
    for at in (lambda v: edge_points(SURFACE, ends, share, v), lambda v: vertex_normals(SURFACE, SOME, v)):
        J = at(u)[1]
        for j in range(u.size):
            step = h * (np.arange(u.size) == j)
            np.testing.assert_allclose(J[..., j], (at(u + step)[0] - at(u - step)[0]) / (2 * h), atol=1e-5)


@pytest.mark.parametrize("camera", [FRONT, NEAR])
def test_residuals_of_edge_points_and_their_derivatives(camera):
    u, h, n = pose(8), 1e-6, SOME.size
    angle = np.linspace(0.0, 6.0, n)
    features = SurfaceFeatures(
        np.stack([SOME, SOME[::-1]], axis=1),
        np.full(n, 0.4),
        np.random.default_rng(1).uniform(0.0, 240.0, (n, 2)),
        np.stack([np.cos(angle), np.sin(angle)], axis=1),
        SURFACE.link[:n] % MODEL.link_length.size,
        np.full(n, 0.5),
    )
    J = surface_residuals(SURFACE, camera, features, u)[1]
    for j in range(u.size):
        step = h * (np.arange(u.size) == j)
        ahead, behind = (surface_residuals(SURFACE, camera, features, u + s)[0] for s in (step, -step))
        np.testing.assert_allclose(J[:, j], (ahead - behind) / (2 * h), atol=2e-3)
    assert np.isfinite(surface_shape_jacobian(SURFACE, camera, features, u)).all()


@pytest.mark.parametrize(("scale", "mirror"), [(0.8, False), (1.25, True)])
def test_one_mesh_fits_hands_of_another_size_and_side(scale, mirror):
    other = resized(MESH, scale, mirror)
    model, hand = mesh_hand(other)
    surface = bind(model, MESH)
    assert surface.scale == pytest.approx(scale, rel=1e-5)
    q = np.full(len(model.joint_names), 0.4)
    vertices, _ = posed_hand(hand, model, q)
    skin = pose_skin(surface, FRONT, q)
    order = np.argsort(vertices @ [1.0, 2.0, 3.0])
    also = np.argsort(in_world(skin.p, FRONT) @ [1.0, 2.0, 3.0])
    np.testing.assert_allclose(in_world(skin.p, FRONT)[also], vertices[order], atol=1e-2)
    corners = skin.p[surface.triangles]
    outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((outwards * skin.normal[surface.triangles].sum(axis=1)).sum(axis=1) > 0.0).mean() > 0.97


def test_a_mirrored_mesh_mirrored_again_is_the_mesh():
    twice = mirrored(mirrored(MESH))
    np.testing.assert_allclose(twice.bind, MESH.bind)
    np.testing.assert_allclose(twice.vertices, MESH.vertices)


def test_a_model_of_another_hand_is_refused():
    with pytest.raises(ValueError, match=r"its joints lie \d+\.\d mm from those of model 'two_finger'"):
        bind(builtin_model("two_finger"), MESH, most_misfit=0.1)
    with pytest.raises(ValueError, match="no joint of 'rr' is named"):
        bind(builtin_model("rr"), MESH)
    with pytest.raises(ValueError, match="drives: "):
        bind(MODEL, MESH, [("thumb-tip", "no_such_joint")])


def test_joints_are_paired_by_finger_and_part():
    pairs = dict(drives_by_name(builtin_model("full_hand"), MESH.joint_names))
    assert pairs["thumb-phalanx-distal"] == "thumb_ip" and pairs["pinky-finger-phalanx-intermediate"] == "little_pip"


def test_a_joint_that_the_model_lacks_follows_the_one_before_it():
    """Two fingers without a last joint: their ends follow the middle one."""
    whole = mesh_hand(MESH, ("index", "ring"))[0]
    places, rows = forward(whole, np.zeros(6)), []
    for finger, first in (("index", 0), ("ring", 6)):
        above = np.eye(4)
        for part, frame in (("mcp", first), ("pip", first + 2)):
            id = len(rows) + 1
            rows.append(FrameRow(id, 0 if part == "mcp" else id - 1, transform=np.linalg.inv(above) @ places[frame]))
            rows.append(FrameRow(id + 1, id, joint=f"{finger}_{part}", link_length=40.0, link_radius=(8.0, 8.0)))
            above = places[frame]
    surface = bind(model_from_rows("short", rows), MESH)
    tip = np.flatnonzero(MESH.joint[:, 1] == MESH.joint_names.index("index-finger-phalanx-distal"))[-1]
    moved = edge_points(surface, np.array([[tip, tip]]), np.zeros(1), np.zeros(4))[1][0]
    assert (np.abs(moved[:, :2]).max(axis=0) > 5.0).all() and not moved[:, 2:].any()
    assert isinstance(surface, Surface) and set(surface.finger.tolist()) == {-1, 0, 1}


def test_the_joints_of_one_finger_do_not_tell_how_the_hand_is_turned():
    with pytest.raises(ValueError, match="all on one line; those of two fingers are wanted"):
        bind(mesh_hand(MESH, ("index",))[0], MESH)
