"""Claims about rooms and rays: Embree, the tree of boxes and plain arithmetic agree; bad meshes are refused."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack import _kernels
from handtrack.body.environment import ENGINES, Room, hits_numpy, ray_caster, read_room, room_of, within_numpy
from handtrack.errors import InputError

DATA = Path(__file__).parents[2] / "shared" / "data" / "room_meshes"
CASTERS = ("embree", "bvh")


def soup(rng, count):
    middle = rng.uniform(-1, 1, (count, 1, 3))
    vertices = (middle + rng.normal(scale=0.2, size=(count, 3, 3))).reshape(-1, 3)
    return room_of(vertices, np.arange(3 * count).reshape(-1, 3))


def agree(a, b, atol):
    np.testing.assert_array_equal(np.isfinite(a), np.isfinite(b))
    np.testing.assert_allclose(a[np.isfinite(a)], b[np.isfinite(b)], atol=atol)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 300))
def test_the_tree_finds_what_looking_at_every_triangle_finds(seed, count):
    rng = np.random.default_rng(seed)
    room = soup(rng, count)
    origins, vectors = rng.uniform(-1, 1, (40, 3)), rng.normal(size=(40, 3))
    vectors[:6] *= np.eye(3)[[0, 1, 2, 0, 1, 2]]  # along the axes
    agree(ray_caster(room, "bvh").hits(origins, vectors), hits_numpy(room, origins, vectors), 1e-9)


@pytest.mark.parametrize("name", ["chair_model.obj", "no_indices_3storybuilding.glb", "capsule.obj"])
def test_both_engines_agree_on_real_meshes(name):
    room = read_room(DATA / name)
    low, high = room.vertices.min(axis=0), room.vertices.max(axis=0)
    rng = np.random.default_rng(1)
    origins = rng.uniform(low, high, (4000, 3))
    vectors = rng.uniform(low, high, (4000, 3)) - origins
    found = [ray_caster(room, engine).hits(origins, vectors) for engine in CASTERS]
    same = np.isfinite(found[0]) == np.isfinite(found[1])
    assert same.mean() > 0.999  # edges may go to either side in single precision
    both = np.isfinite(found[0]) & same
    assert both.any()
    assert np.quantile(np.abs(found[0][both] - found[1][both]), 0.99) < 1e-4


@pytest.mark.parametrize("engine", CASTERS)
def test_no_ray_leaves_a_closed_mesh_through_edges_or_corners(engine):
    mesh = trimesh.creation.icosphere(subdivisions=3)
    room = room_of(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    corner = room.vertices[room.triangles]
    at_edges = 0.5 * (corner + np.roll(corner, 1, axis=1)).reshape(-1, 3)
    targets = np.concatenate([room.vertices, at_edges, corner.mean(axis=1)])
    share = ray_caster(room, engine).hits(np.zeros(3), 2.0 * targets)
    assert (np.abs(share - 0.5) < 1e-3).all()


@pytest.mark.parametrize("engine", CASTERS)
def test_rays_end_where_their_vector_ends(engine):
    room = room_of(np.array([[1.0, -1, -1], [1, 1, -1], [1, 0, 1]]), np.array([[0, 1, 2]]))
    vectors = np.array([[0.9, 0, 0], [1.1, 0, 0], [2, 0, 0], [-2, 0, 0], [0, 0, 0], [np.nan, 0, 0]])
    share = ray_caster(room, engine).hits(np.zeros(3), vectors)
    np.testing.assert_allclose(share[1:3], [1 / 1.1, 0.5], rtol=1e-6)
    assert np.isinf(share[[0, 3, 4, 5]]).all()


def test_shares_are_checked_as_by_plain_arithmetic():
    rng = np.random.default_rng(0)
    share = rng.choice([0.0, 0.5, 1.0, 1.5, np.inf, np.nan], 200).astype(np.float32)
    origin, vector = (rng.choice([0, 1, -1, 0, 2, np.nan, np.inf], (200, 3), p=p).astype(np.float32) for p in (
        [0.3, 0.2, 0.2, 0.1, 0.1, 0.05, 0.05], [0.5, 0.1, 0.1, 0.2, 0.0, 0.05, 0.05]
    ))  # fmt: skip
    ours, twin = _kernels.within(share, origin, vector), within_numpy(share, origin, vector)
    np.testing.assert_array_equal(ours, twin)
    assert 10 < np.isfinite(ours).sum() < 150


@pytest.mark.parametrize("engine", ENGINES)
def test_an_empty_room_stops_nothing(engine):
    caster = ray_caster(Room(np.zeros((0, 3)), np.zeros((0, 3), int)), engine)
    assert np.isinf(caster.hits(np.zeros(3), np.ones((5, 3)))).all() and caster.engine == "none"


def test_without_embree_the_tree_is_taken_or_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("handtrack.body.environment.find_spec", lambda name: None)
    room = soup(np.random.default_rng(0), 5)
    assert ray_caster(room).engine == "bvh"
    with pytest.raises(InputError, match=r"Embree is not installed; `pip install handtrack\[room\]`"):
        ray_caster(room, "embree")


def test_many_triangles_in_one_place_do_not_break_the_tree():
    room = room_of(np.tile([[1.0, -1, -1], [1, 1, -1], [1, 0, 1]], (100, 1)), np.arange(300).reshape(-1, 3))
    assert ray_caster(room, "bvh").hits(np.zeros(3), np.array([[2.0, 0, 0]]))[0] == pytest.approx(0.5)


def test_triangles_without_area_or_place_are_left_out():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [np.nan, 0, 0]])
    room = room_of(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]), "r.ply")
    assert room.triangles.tolist() == [[0, 1, 2]]
    assert room.warnings == ("r.ply: 2 of 3 triangles have no area or no place and are left out",)


@pytest.mark.parametrize(("vertices", "triangles", "message"), [
    (np.eye(3), [[0, 1, 3]], r"m: a triangle names vertex 3 of 3"),
    (2000 * np.eye(3), [[0, 1, 2]], r"m: reaches 2000 from the origin; metres are wanted"),
])  # fmt: skip
def test_rooms_that_cannot_be_are_refused(vertices, triangles, message):
    with pytest.raises(InputError, match=message):
        room_of(vertices, np.array(triangles), "m")


def test_bad_files_are_refused_in_one_line(tmp_path):
    cases = {
        "missing.ply": (None, "no such file"),
        "empty.ply": (b"", "has 0 bytes"),
        "words.ply": (b"hello\nworld\n", "a mesh is wanted"),
        "words.xyz1": (b"hello", "a mesh is wanted"),
        "cut.glb": (b"glTF\x02\x00\x00\x00\x10\x00", "a mesh is wanted"),
    }
    for name, (content, message) in cases.items():
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=message) as refusal:
            read_room(tmp_path / name)
        assert "\n" not in str(refusal.value) and name in str(refusal.value)


def test_a_file_of_several_parts_is_one_room(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(extents=(1, 1, 1)))
    scene.add_geometry(
        trimesh.creation.box(extents=(1, 1, 1)), transform=trimesh.transformations.translation_matrix([3, 0, 0])
    )
    scene.export(tmp_path / "two.glb")
    room = read_room(tmp_path / "two.glb")
    assert room.triangles.shape[0] == 24 and room.vertices[:, 0].max() == pytest.approx(3.5)
