"""Rooms from depth images: where surfaces are, what is refused, and that nothing but the images decides the bytes."""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handtrack.body import fusion
from handtrack.body.environment import Room, ray_caster, read_room
from handtrack.body.fusion import fuse, fuse_folder, in_order, read_poses, room_ply, write_room
from handtrack.camera import orthographic, perspective, rays
from handtrack.cli import main
from handtrack.errors import InputError
from handtrack.formats.rgbd import write_rgbd
from handtrack.formats.skeletons import Detections
from synth.cell import CellSettings, make_cell
from synth.cell_room import distance_to
from synth.cell_sensor import sense_depth
from synth.cell_view import Eye, room_surfaces

DATA = Path(__file__).parents[2] / "shared" / "data" / "room_rgbd"
CAMERA = perspective(80, 60, 70.0, 72.0, 39.0, 30.5, np.eye(3), np.zeros(3))
VOXEL = 0.02


@pytest.fixture(autouse=True)
def _needs_open3d(request):
    if "without_open3d" not in request.keywords and "fuse" in request.node.name:
        pytest.importorskip("open3d", exc_type=ImportError)


def pose_of(turn, place):
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), place
    return out


def plane_depth(camera, pose, normal, offset):
    """Depth of the plane `normal . p = offset` in the world of `pose`, by rays through the pixels' centres."""
    u, v = np.meshgrid(np.arange(float(camera.width)), np.arange(float(camera.height)))
    _, d = rays(camera, np.stack([u.ravel(), v.ravel()], axis=1))
    z = (offset - normal @ pose[:3, 3]) / (d @ pose[:3, :3].T @ normal)
    return np.where(z > 0, z, 0.0).reshape(u.shape).astype(np.float32)


def half_pixel(camera, pose, points, normal):
    """How far a slanted plane seems to move when it is read half a pixel beside, along both axes of the image."""
    z, (nx, ny, nz) = ((points - pose[:3, 3]) @ pose[:3, :3])[:, 2], pose[:3, :3].T @ normal
    towards = np.abs((points - pose[:3, 3]) @ normal) / z
    return 0.5 * z * (abs(nx) / camera.fx + abs(ny) / camera.fy) * abs(nz) / towards


def flat(z):
    return np.full((CAMERA.height, CAMERA.width), z, np.float32)


def eyes_around(cell, count):
    rng = np.random.default_rng(1)
    out = [cell.eye]
    for _ in range(count - 1):
        turn = Rotation.from_rotvec(rng.uniform(-0.1, 0.1, 3)).as_matrix()
        out.append(Eye(cell.eye.place + rng.uniform(-0.3, 0.3, 3), turn @ cell.eye.R, cell.eye.camera))
    return out


@pytest.mark.parametrize(("noise", "median", "most"), [(0.0, 0.05, 0.3), (0.0015, 0.3, 1.0)])
def test_fused_meshes_lie_on_the_true_room(noise, median, most):
    cell = make_cell(3, CellSettings(frames=2))
    eyes, rng = eyes_around(cell, 6), np.random.default_rng(0)
    seen = [room_surfaces(cell.room.boxes, eye) for eye in eyes]
    depths = [sense_depth(rng, surfaces, noise, 0.01 * (noise > 0), 0.4, 6.0) for surfaces in seen]
    poses = np.stack([pose_of(Rotation.from_matrix(eye.R.T).as_rotvec(), eye.place) for eye in eyes])
    room = fuse(depths, cell.eye.camera, poses, VOXEL, farthest=6.0)
    signed = distance_to(cell.room.boxes, np.ascontiguousarray(room.vertices)) / VOXEL
    assert np.median(np.abs(signed)) < median
    assert np.quantile(np.abs(signed), 0.95) < most
    assert abs(np.median(signed)) < 0.05
    assert not room.warnings
    truth = seen[0].depth[2:-2:7, 2:-2:7]
    v, u = np.mgrid[2 : 240 - 2 : 7, 2 : 320 - 2 : 7]
    _, d = rays(cell.eye.camera, np.stack([u.ravel(), v.ravel()], axis=1).astype(float))
    met = 8.0 * ray_caster(room, "bvh").hits(eyes[0].place, 8.0 * d @ eyes[0].R).reshape(truth.shape)
    near = truth < 5.8
    assert np.isinf(met[near]).mean() < 0.02
    assert np.median(np.abs(met - truth)[near]) < 0.3 * VOXEL


@pytest.mark.parametrize("bend", [None, np.array([-0.25, 0.06, 0.001, -0.002, 0.0])])
def test_fused_planes_are_where_they_are_through_any_lens_and_from_anywhere(bend):
    camera = perspective(160, 120, 140.0, 144.0, 78.0, 61.0, np.eye(3), np.zeros(3), bend)
    poses = np.stack([pose_of([0.1, -0.2, 0.3], [0.2, 0.1, -0.1]), pose_of([-0.2, 0.25, 1.0], [0.4, -0.3, 0.2])])
    normal = np.array([0.3, 0.4, np.sqrt(0.75)])
    room = fuse([plane_depth(camera, pose, normal, 1.5) for pose in poses], camera, poses, VOXEL)
    assert room.triangles.shape[0] > 1000
    error = room.vertices @ normal - 1.5
    step = np.max([half_pixel(camera, pose, room.vertices, normal) for pose in poses], axis=0)
    assert np.quantile(np.abs(error) / step, 0.99) < 1.0  # the nearest pixel is taken
    assert abs(error.mean()) < 0.01 * VOXEL
    corner = room.vertices[room.triangles]
    outward = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert (outward @ normal < 0).mean() > 0.999  # towards the cameras, before the plane; slivers of no height aside


def test_what_later_images_look_through_wears_off_when_they_are_fused():
    before = flat(2.0)
    before[20:40, 20:40] = 1.2
    poses = np.tile(np.eye(4), (4, 1, 1))
    kept = fuse([before] * 4, CAMERA, poses, VOXEL)
    worn = fuse([before] + [flat(2.0)] * 3, CAMERA, poses, VOXEL)
    assert (np.abs(kept.vertices[:, 2] - 1.2) < 0.01).any()
    assert not (worn.vertices[:, 2] < 1.5).any()


def test_what_too_few_images_saw_is_not_fused():
    poses = np.stack([np.eye(4), np.eye(4), pose_of([0, 0, 0], [0.5, 0, 0])])
    depths = [flat(1.5)] * 3
    once, thrice = (fuse(depths, CAMERA, poses, VOXEL, seen=seen) for seen in (1, 3))
    left = (0 - CAMERA.cx) / CAMERA.fx * 1.5
    assert once.vertices[:, 0].min() == pytest.approx(left, abs=0.04)
    assert thrice.vertices[:, 0].min() == pytest.approx(left + 0.5, abs=0.04)
    assert not fuse(depths, CAMERA, poses, VOXEL, seen=4).triangles.size


def test_readings_that_are_none_are_not_fused():
    depth = flat(2.0)
    depth[:, :20], depth[:, 60:] = np.nan, 3.0
    depth[:10] = -1.0
    pose = np.eye(4)[None]
    room = fuse([depth], CAMERA, pose, VOXEL, farthest=2.5)
    assert np.abs(room.vertices[:, 2] - 2.0).max() < 1e-3
    pixel = room.vertices[:, :2] / room.vertices[:, 2:] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy)
    assert pixel[:, 0].min() > 19.4
    assert pixel[:, 0].max() < 59.6
    assert pixel[:, 1].min() > 9.4
    for nothing in (flat(0.0), flat(np.nan), flat(2.6)):
        empty = fuse([nothing], CAMERA, pose, VOXEL, farthest=2.5)
        assert empty.triangles.shape == (0, 3)
        assert "no surface within 2.5 m in 1 depth images" in empty.warnings[0]
        assert np.isinf(ray_caster(empty).hits(np.zeros(3), np.array([[0.0, 0.0, 9.0]]))).all()


def test_the_same_images_are_fused_to_the_same_bytes():
    rng = np.random.default_rng(0)
    depths = [flat(1.5) + rng.normal(0, 0.01, (60, 80)).astype(np.float32) for _ in range(3)]
    poses = np.stack([pose_of(rng.uniform(-0.2, 0.2, 3), rng.uniform(-0.2, 0.2, 3)) for _ in range(3)])
    first = room_ply(fuse(depths, CAMERA, poses, VOXEL))
    assert all(room_ply(fuse(iter(depths), CAMERA, poses, VOXEL)) == first for _ in range(3))


@pytest.mark.skipif(not DATA.is_dir(), reason="the shared depth images are not here")
def test_a_room_fused_from_four_images_foretells_the_fifth():
    files = [DATA / "depth" / f"{i:05d}.png" for i in range(5)]
    depths = [
        np.asarray(cv2.imread(str(file), cv2.IMREAD_UNCHANGED)).astype(np.float32) / np.float32(1000) for file in files
    ]
    lines = (DATA / "trajectory.log").read_text().splitlines()
    poses = np.array([[line.split() for line in lines[5 * i + 1 : 5 * i + 5]] for i in range(5)], float)
    camera = perspective(640, 480, 525.0, 525.0, 319.5, 239.5, np.eye(3), np.zeros(3))
    room = fuse(depths[:4], camera, poses[:4], VOXEL)
    v, u = np.mgrid[4:480:16, 4:640:16]
    _, d = rays(camera, np.stack([u.ravel(), v.ravel()], axis=1).astype(float))
    z = depths[4][4:480:16, 4:640:16].ravel()
    met = 6.0 * ray_caster(room, "bvh").hits(poses[4, :3, 3], 6.0 * d @ poses[4, :3, :3].T)
    known = (z > 0) & (z < 4.9)
    error = np.abs(met - z)[known]
    assert np.isinf(error).mean() < 0.1  # the camera has moved on: the new rim was not seen before
    assert np.median(error) < 0.4 * VOXEL


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"voxel": 0.0}, r"voxel: got 0.0, wanted 0.001 to 0.5 metres"),
        ({"voxel": np.nan}, r"voxel: got nan"),
        ({"truncation": 0.03}, r"truncation: got 0.03, wanted 0.04 to 0.32 metres"),
        ({"truncation": np.nan}, r"truncation: got nan"),
        ({"farthest": 0.0}, r"farthest: got 0.0, wanted metres above 0"),
        ({"farthest": np.inf}, r"farthest: got inf"),
        ({"seen": 0}, r"seen: got 0, wanted 1 or more"),
        ({"poses": np.full((1, 4, 4), np.nan)}, r"poses: number 0 is no rigid motion"),
        ({"poses": np.diag([1.0, 1.0, -1.0, 1.0])[None]}, r"poses: number 0 is no rigid motion"),
        ({"poses": np.diag([1.1, 1.0, 1.0, 1.0])[None]}, r"poses: number 0 is no rigid motion"),
        ({"poses": np.diag([1.0, 1.0, 1.0, 2.0])[None]}, r"poses: number 0 is no rigid motion"),
        ({"poses": np.tile(np.eye(4), (2, 1, 1))}, r"depths: got 1 images, wanted 2, one for each pose"),
        ({"poses": np.zeros((0, 4, 4))}, r"depths: got 1 images, wanted 0"),
        ({"depths": [np.zeros((60, 81), np.float32)]}, r"depths: got an image of \(60, 81\), wanted \(60, 80\)"),
        ({"camera": orthographic(80, 60, 3.0, 0.0, 0.0, np.eye(3), np.zeros(3))}, r"camera: got orthographic"),
        ({"camera": perspective(80, 60, 70.0, 70.0, 40.0, 30.0, np.eye(3), np.ones(3))}, r"wanted .* t = 0"),
    ],
)
def test_arguments_that_cannot_be_fused_are_named(change, message):
    arguments = {"depths": [flat(1.0)], "camera": CAMERA, "poses": np.eye(4)[None], "voxel": VOXEL}
    with pytest.raises(ValueError, match=message):
        fuse(**{**arguments, **change})


def test_a_room_that_takes_too_many_voxels_is_not_fused(monkeypatch):
    monkeypatch.setattr(fusion, "MOST_BLOCKS", 2)
    with pytest.raises(InputError, match=r"voxel: 0.02 m gives more than 2 blocks of 16\^3 voxels; larger voxels"):
        fuse([flat(2.0)], CAMERA, np.eye(4)[None], VOXEL)


def test_without_open3d_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(
        InputError, match=r"Open3D cannot be loaded \(.*\); `pip install handtrack\[fusion\]`"
    ) as caught:
        fusion.open3d()
    assert "\n" not in str(caught.value)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
def test_the_order_of_a_mesh_depends_on_its_shape_alone(seed, count):
    rng = np.random.default_rng(seed)
    vertices = rng.integers(-2, 3, (12, 3)).astype(float)  # some in one place
    triangles = rng.integers(0, 12, (count, 3))
    v, t = in_order(vertices, triangles)
    spread = rng.permutation(12)
    turned = np.stack([np.roll(row, rng.integers(3)) for row in np.argsort(spread)[triangles]])
    again = in_order(np.where(vertices == 0, -0.0, vertices)[spread], rng.permutation(turned))
    assert np.array_equal(v, again[0])
    assert np.array_equal(t, again[1])
    corner = vertices[triangles]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    given_ones = {tuple(map(tuple, c[np.lexsort(c.T[::-1])])) for c in corner[(area != 0).any(axis=1)]}
    assert {tuple(map(tuple, c[np.lexsort(c.T[::-1])])) for c in v[t]} == given_ones
    assert np.unique(t).size == v.shape[0]
    turn = np.cross(v[t][:, 1] - v[t][:, 0], v[t][:, 2] - v[t][:, 0])
    assert {tuple(x + 0.0) for x in turn} == {
        tuple(x + 0.0) for x in area[(area != 0).any(axis=1)]
    }  # the sense is kept


def test_a_written_room_reads_back_and_a_failed_one_leaves_nothing(tmp_path):
    vertices, triangles = in_order(np.eye(4, 3) * [1.5, 2.0, -0.25], np.array([[0, 1, 2], [2, 3, 1]]))
    room = Room(vertices, triangles)
    write_room(tmp_path / "room.ply", room)
    again = read_room(tmp_path / "room.ply")
    assert np.array_equal(again.vertices, vertices)
    assert np.array_equal(again.triangles, triangles)
    write_room(tmp_path / "empty.ply", Room(np.zeros((0, 3)), np.zeros((0, 3), int)))
    assert not read_room(tmp_path / "empty.ply").triangles.size
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(OSError, match="folder"):
        write_room(tmp_path / "folder.ply", room)
    assert {file.name for file in tmp_path.iterdir()} == {"room.ply", "empty.ply", "folder.ply"}


def poses_file(folder, rows, header="frame,x,y,z,qw,qx,qy,qz"):
    path = folder / "poses.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_poses_turn_and_move_the_camera_into_the_world(tmp_path):
    path = poses_file(tmp_path, ["1,0.5,-1,2,0.7071068,0,0,0.7071068", "3,0,0,0,1.001,0,0,0"])
    frame, poses = read_poses(path, 4)
    assert frame.tolist() == [1, 3]
    assert (poses[0] @ [1.0, 0.0, 0.0, 1.0]) == pytest.approx([0.5, 0.0, 2.0, 1.0])  # x is turned to y
    assert np.array_equal(poses[1], np.eye(4))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], r"poses.csv: has no rows"),
        (["0,0,0,0,1,0,0,0", "4,0,0,0,1,0,0,0"], r"poses.csv: line 3: frame: 4 given; the scene has frames 0 to 3"),
        (["1,0,0,0,1,0,0,0", "1,0,0,0,1,0,0,0"], r"poses.csv: line 3: frame: 1 after 1; strictly rising"),
        (["0,0,0,0,1,1,0,0"], r"poses.csv: line 2: qw,qx,qy,qz: length 1.41421 given; a rotation, length 1"),
        (["0,0,0,0,0,0,0,0"], r"poses.csv: line 2: qw,qx,qy,qz: length 0 given"),
        (["0,0,nan,0,1,0,0,0"], r"poses.csv: line 2: y: 'nan' given; a finite number"),
        (["-1,0,0,0,1,0,0,0"], r"poses.csv: line 2: frame: '-1' given"),
    ],
)
def test_bad_poses_are_refused_with_file_and_line(tmp_path, rows, message):
    with pytest.raises(InputError, match=message):
        read_poses(poses_file(tmp_path, rows), 4)


def test_poses_that_are_missing_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"poses.csv"):
        read_poses(tmp_path / "poses.csv", 4)


def test_a_scene_folder_is_fused_with_the_poses_it_has(tmp_path):
    poses = np.stack([pose_of([0, 0, 0], [0, 0, 0]), pose_of([0, 0.1, 0], [0.2, 0, 0])])
    normal = np.array([0.0, 0.0, 1.0])
    depths = [plane_depth(CAMERA, pose, normal, 1.5) for pose in poses]
    none = np.zeros(0, int)
    unseen = Detections(
        np.arange(3) / 30.0, none, none, np.zeros((0, 16, 3)), np.zeros((0, 16)), np.zeros((0, 16), np.int8)
    )
    write_rgbd(tmp_path / "scene", 30.0, CAMERA, [depths[0], flat(0.7), depths[1]], unseen)
    q = Rotation.from_matrix(poses[1, :3, :3]).as_quat()
    poses_file(tmp_path / "scene", ["0,0,0,0,1,0,0,0", f"2,0.2,0,0,{q[3]},{q[0]},{q[1]},{q[2]}"])
    room = fuse_folder(tmp_path / "scene", VOXEL)  # the frame at 0.7 m has no pose
    assert room.triangles.shape[0] > 1000
    assert np.abs(room.vertices[:, 2] - 1.5).max() < 0.1 * VOXEL


def test_a_fused_room_is_written_and_shown_from_the_command_line(tmp_path, capsys):
    unseen = Detections(
        np.arange(3) / 30.0, np.zeros(0, int), np.zeros(0, int), np.zeros((0, 16, 3)), np.zeros((0, 16)),
        np.zeros((0, 16), np.int8),
    )  # fmt: skip
    depth = flat(1.5)
    depth[20:40, 20:40] = 1.2
    write_rgbd(tmp_path / "scene", 30.0, CAMERA, [depth] * 3, unseen)
    poses_file(tmp_path / "scene", ["0,0,0,0,1,0,0,0", "1,0,0,0,1,0,0,0"])
    command = ["body", "room", str(tmp_path / "scene"), "--out"]
    assert main([*command, str(tmp_path / "room.ply"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["images"] == 2 and facts["triangles"] == read_room(tmp_path / "room.ply").triangles.shape[0] > 1000
    picture = np.asarray(cv2.imread(facts["picture"])).astype(int)
    assert picture.shape == (60, 80, 3)
    assert picture[30, 30].mean() > picture[10, 60].mean() > 120  # the box is nearer; both face the camera
    assert main([*command, str(tmp_path / "r.ply")]) == 0
    assert "triangles from 2 depth images" in capsys.readouterr().out
    for wrong, message in (
        (["r.obj"], "ends in .ply is wanted"),
        (["s.ply", "--voxel", "9"], "--voxel: got 9.0, wanted"),
    ):
        assert main([*command, str(tmp_path / wrong[0]), *wrong[1:]]) == 2
        assert message in capsys.readouterr().err and not (tmp_path / wrong[0]).exists()
