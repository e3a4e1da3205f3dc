"""The simulated cell: its person keeps to a human arm and out of the furniture, and its files say what happened."""

import io
import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import config

from handtrack.body import arm as body_arm
from handtrack.camera import project, rays
from handtrack.errors import InputError
from handtrack.formats.rgbd import read_depth, read_rgbd
from handtrack.formats.robots import read_robot
from handtrack.formats.skeletons import INFERRED, KEYPOINTS, LOST, TRACKED
from synth import cell_plan
from synth.cell import CellSettings, depth_frames, detections_of, make_cell, mirrored, room_ply, simulate_cell
from synth.cell_arm import arm_spheres
from synth.cell_motion import BEHIND_ROBOT, INTO_SHELF, minimum_jerk, recorded_wander, smooth_noise
from synth.cell_plan import ELBOW, WRIST
from synth.cell_robot import SHARE, Robot, links_of
from synth.cell_room import Boxes, distance_to, distance_to_numpy, first_hits, mesh_of
from synth.cell_sensor import sense_depth, states_of
from synth.cell_view import (
    BY_BODY,
    BY_ROBOT,
    BY_ROOM,
    OUTSIDE,
    Surfaces,
    person_and_robot,
    room_surfaces,
    visible_share,
)
from synth.people import (
    LEFT,
    PARTS,
    RIGHT,
    angle_limits,
    arm_angles,
    body_of,
    elbow_at,
    shoulders,
    showing,
    trunk_axes,
    within_limits,
)

SMALL = CellSettings(frames=120, fps=12.0, width=96, height=72)
ARM_MARKERS = ("hand_top", "hand_left", "hand_right", "right_elbow", "right_shoulder")


@pytest.fixture(scope="module")
def cells():
    """Three cells, one of each kind of occlusion."""
    kinds = ("both", "static", "dynamic")
    return [
        make_cell(seed, CellSettings(frames=120, fps=12.0, width=96, height=72, occlusion=k))
        for seed, k in enumerate(kinds)
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("cell") / "scene"
    simulate_cell(path, 4, SMALL)
    return path


def some_boxes(count=6, seed=0):
    rng = np.random.default_rng(seed)
    return Boxes(rng.uniform(-1, 1, (count, 3)), rng.uniform(0.05, 0.5, (count, 3)), rng.uniform(-3, 3, count))


# the person


def test_segments_keep_their_length(cells):
    for cell in cells:
        for a, b, length in ((0, 2, cell.body.upper_arm), (2, 4, cell.body.forearm), (8, 10, cell.body.shin)):
            for side in (LEFT, RIGHT):
                size = np.linalg.norm(cell.p[:, a + side] - cell.p[:, b + side], axis=1)
                spread = 0.01 if a == 8 else 1e-9  # a knee stands a little in front
                assert np.abs(size - length).max() < spread


def test_arms_keep_the_joint_limits_in_every_frame(cells):
    for cell in cells:
        axes = trunk_axes(cell.posture.lean, cell.posture.twist)
        both = shoulders(cell.body, cell.posture.pelvis, axes)
        for side in (LEFT, RIGHT):
            wrist = cell.posture.wrist[:, side]
            elbow = elbow_at(cell.body, both[:, side], wrist, axes, cell.posture.swivel[:, side], side)
            assert within_limits(arm_angles(both[:, side], elbow, wrist, axes, side)).all()


def test_arms_never_touch_the_furniture(cells):
    s = np.linspace(0.0, 1.0, 60)[:, None]
    for cell in cells:
        for name in ("upper_arm", "forearm", "hand"):
            for side in ("left", "right"):
                k = PARTS.index(f"{side}_{name}")
                ends = cell.parts[:, k] @ cell.eye.R + cell.eye.place
                points = ends[:, :1] + s * (ends[:, 1:] - ends[:, :1])
                radius = cell.body.radius[k, 0] + s[:, 0] * (cell.body.radius[k, 1] - cell.body.radius[k, 0])
                gap = distance_to(cell.room.boxes, points.reshape(-1, 3)).reshape(points.shape[:2]) - radius
                assert gap.min() > 0.0


def test_joint_angles_rebuild_the_arm():
    rng = np.random.default_rng(0)
    n = 200
    a1, a2, a3, a4 = np.radians(rng.uniform([0, -40, -60, 30], [100, 80, 50, 170], (n, 4))).T
    o, f, u = np.eye(3)
    d = np.sin(a2)[:, None] * f + np.cos(a2)[:, None] * (np.sin(a1)[:, None] * o - np.cos(a1)[:, None] * u)
    ahead = np.cos(a2)[:, None] * f + np.sin(a2)[:, None] * (np.cos(a1)[:, None] * u - np.sin(a1)[:, None] * o)
    aside = np.cos(a1)[:, None] * o + np.sin(a1)[:, None] * u
    bent = np.cos(a3)[:, None] * ahead + np.sin(a3)[:, None] * aside
    g = -np.cos(a4)[:, None] * d + np.sin(a4)[:, None] * bent
    axes = np.broadcast_to(np.eye(3), (n, 3, 3))
    got = arm_angles(np.zeros((n, 3)), 0.3 * d, 0.3 * d + 0.25 * g, axes, RIGHT)
    np.testing.assert_allclose(got, np.column_stack([a1, a2, a3, a4]), atol=1e-9)
    flip = np.array([-1.0, 1.0, 1.0])
    left = arm_angles(np.zeros((n, 3)), 0.3 * d * flip, (0.3 * d + 0.25 * g) * flip, axes, LEFT)
    np.testing.assert_allclose(left, got, atol=1e-9)


def test_joint_angles_are_those_of_the_tracker(cells):
    cell = cells[0]
    axes = trunk_axes(cell.posture.lean, cell.posture.twist)
    shoulder, wrist = shoulders(cell.body, cell.posture.pelvis, axes)[:, RIGHT], cell.posture.wrist[:, RIGHT]
    elbow = elbow_at(cell.body, shoulder, wrist, axes, cell.posture.swivel[:, RIGHT], RIGHT)
    ours = arm_angles(shoulder, elbow, wrist, axes, RIGHT)
    for i in range(0, 120, 10):
        torso = np.column_stack([axes[i, 1], -axes[i, 0], axes[i, 2]])  # forward, left, up
        theirs = body_arm.arm_angles((elbow - shoulder)[i : i + 1], (wrist - elbow)[i : i + 1], torso, "right")
        np.testing.assert_allclose(ours[i], theirs[0], atol=1e-9)
    theirs = body_arm.limits_at(ours[:, 0], ours[:, 1])
    np.testing.assert_allclose(angle_limits(ours), theirs, atol=1e-12)


def test_an_arm_raised_forward_above_the_shoulder_is_flexed_not_abducted():
    d = np.array([0.0, math.sin(math.radians(120.0)), -math.cos(math.radians(120.0))])
    alpha = arm_angles(np.zeros(3), d, d + np.array([0.0, 0.0, 1.0]), np.eye(3), RIGHT)
    np.testing.assert_allclose(np.degrees(alpha[:2]), [0.0, 120.0], atol=1e-9)


def test_a_wrist_out_of_reach_has_no_elbow():
    body = body_of(1.75)
    far = np.array([[0.0, body.arm + 0.01, 0.0]])
    elbow = elbow_at(body, np.zeros((1, 3)), far, np.eye(3)[None], np.zeros(1), RIGHT)
    assert np.isnan(elbow).all()
    assert not within_limits(arm_angles(np.zeros((1, 3)), elbow, far, np.eye(3)[None], RIGHT)).any()


def test_every_keypoint_has_parts_that_show_it_and_they_hold_it(cells):
    own, cell = showing(), cells[0]
    assert own.any(axis=1).all()
    s = np.linspace(0.0, 1.0, 50)[:, None]
    for k in range(16):
        gaps = []
        for part in np.flatnonzero(own[k]):
            a, b = cell.parts[0, part]
            gaps.append(np.linalg.norm(a + s * (b - a) - cell.p[0, k], axis=1).min() - cell.body.radius[part].max())
        assert min(gaps) < 0.03, KEYPOINTS[k]


def test_an_absurd_stature_is_refused():
    with pytest.raises(ValueError, match=r"stature: 3\.0 m; wanted 1\.2 to 2\.3"):
        body_of(3.0)


# the room


def test_distance_from_boxes_agrees_with_its_twin():
    p = np.random.default_rng(1).uniform(-2, 2, (500, 3))
    boxes = some_boxes()
    np.testing.assert_allclose(distance_to(boxes, p), distance_to_numpy(boxes, p), atol=1e-12)
    assert (distance_to(boxes, p) < 0).any()


def test_rays_meet_boxes_where_they_meet_the_mesh_of_them():
    boxes = some_boxes()
    vertices, triangles = mesh_of(boxes)
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    assert mesh.volume == pytest.approx(8.0 * boxes.half.prod(axis=1).sum())  # turned outward
    origin = np.array([3.0, -2.5, 2.0])
    d = np.random.default_rng(2).uniform(-1.2, 1.2, (400, 3)) - origin
    share, normal = first_hits(boxes, origin, d)
    hit, ray, face = mesh.ray.intersects_location(np.broadcast_to(origin, d.shape), d, multiple_hits=False)
    wanted = np.full(400, np.inf)
    wanted[ray] = ((hit - origin) * d[ray]).sum(axis=1) / (d[ray] ** 2).sum(axis=1)
    np.testing.assert_allclose(share, wanted, rtol=1e-5)
    np.testing.assert_allclose(normal[ray], mesh.face_normals[face], atol=1e-6)
    assert np.isinf(share).any() and (normal[np.isinf(share)] == 0).all()


def test_a_ray_along_a_face_meets_only_what_lies_ahead():
    cube = Boxes(np.zeros((1, 3)), np.ones((1, 3)), np.zeros(1))
    d = np.array([[0.0, 4.0, 0.0], [-0.0, 4.0, -0.0], [1.0, 0.0, 0.0], [0.0, -4.0, 0.0]])
    share, _ = first_hits(cube, np.array([0.5, -3.0, 0.0]), d)
    np.testing.assert_array_equal(share, [0.5, 0.5, np.inf, np.inf])


def test_the_written_room_is_what_the_depth_camera_sees_behind_the_person(cells):
    cell = cells[0]
    mesh = trimesh.load(io.BytesIO(room_ply(cell)), file_type="ply", process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    camera = cell.eye.camera
    xy = np.stack(np.meshgrid(np.arange(0.0, 96, 5), np.arange(0.0, 72, 5)), axis=-1).reshape(-1, 2)
    origin, d = rays(camera, xy)
    hit, ray, _ = mesh.ray.intersects_location(origin, d, multiple_hits=False)
    room = room_surfaces(cell.room.boxes, cell.eye).depth[xy[:, 1].astype(int), xy[:, 0].astype(int)]
    wanted = np.full(xy.shape[0], np.inf)
    wanted[ray] = hit[:, 2]
    np.testing.assert_allclose(room, wanted, rtol=1e-4)
    seen = next(depth_frames(cell, np.random.default_rng(0)))[xy[:, 1].astype(int), xy[:, 0].astype(int)]
    assert (seen[seen > 0] < room[seen > 0] + 0.1).all() and (seen[seen > 0] < room[seen > 0] - 0.3).any()


# motion


@given(st.floats(-0.5, 1.5))
def test_minimum_jerk_runs_from_rest_to_rest(u):
    here, mirror = minimum_jerk(np.array([u])), minimum_jerk(np.array([1.0 - u]))
    assert here + mirror == pytest.approx(1.0)
    ends = minimum_jerk(np.array([0.0, 1e-4, 1.0 - 1e-4, 1.0]))
    assert np.abs(np.diff(ends)[[0, 2]]).max() < 1e-10


def test_smooth_noise_has_unit_variance():
    noise = smooth_noise(np.random.default_rng(0), 4000, 3.0, 8)
    assert np.std(noise) == pytest.approx(1.0, abs=0.06)
    assert np.std(np.diff(noise, axis=0)) < 0.3


def test_reaches_hide_the_wrist_behind_what_their_kind_says(cells):
    number = np.arange(120)
    for cell in cells:
        for kind, (_, arrive, depart, _) in zip(cell.tasks.kind, cell.tasks.frames, strict=True):
            there = (number >= arrive) & (number <= depart)
            cause, share = cell.cause[there, WRIST], cell.share[there, WRIST]
            if kind == INTO_SHELF:
                assert (cause == BY_ROOM).mean() > 0.8 and share.mean() < 0.15
            elif kind == BEHIND_ROBOT:
                assert (cause == BY_ROBOT).mean() > 0.6 and share.mean() < 0.4
        assert (cell.share[cell.share[:, WRIST] < 0.1, ELBOW] >= 0.5).mean() > 0.4
        assert cell.share[0, WRIST] >= 0.5


def test_each_kind_of_occlusion_has_two_reaches_of_each_of_its_tasks(cells):
    counts = [np.bincount(cell.tasks.kind, minlength=3).tolist() for cell in cells]
    assert counts == [[2, 2, 0], [2, 0, 2], [0, 2, 2]]


def test_the_arm_moves_no_faster_than_people_do(cells):
    for cell in cells:
        speed = np.linalg.norm(np.diff(cell.p[:, WRIST], axis=0), axis=1) * cell.settings.fps
        assert 0.8 < speed.max() < 2.2


def test_the_robot_keeps_its_lengths_and_is_led(cells):
    for cell in cells:
        size = np.linalg.norm(cell.links[:, :, 1] - cell.links[:, :, 0], axis=-1)
        np.testing.assert_allclose(size[:, 1:], np.broadcast_to(cell.robot.length, size[:, 1:].shape))
    robot = Robot(np.zeros(3), np.ones(3), 1.0, np.array([0.5, 0.6]), np.full(3, 0.1))
    led = np.array([[0.4, 0.3, 1.2], [5.0, 0.0, 1.0]])
    links = links_of(robot, led)
    np.testing.assert_allclose((links[:, 2, 0] + SHARE * (links[:, 2, 1] - links[:, 2, 0]))[0], led[0], atol=1e-12)
    assert np.linalg.norm(links[1, 2, 1] - [0, 0, 1]) < 1.1  # out of reach: stretched toward it
    assert links[0, 1, 1, 2] > 1.0  # the elbow is above the shoulder


def test_cells_differ_in_everything(cells):
    first, second = cells[0], cells[1]
    assert first.body.arm != second.body.arm
    assert not np.allclose(first.eye.R, second.eye.R)
    assert not np.allclose(first.room.shelf.corner, second.room.shelf.corner)
    assert first.eye.camera.cx != second.eye.camera.cx


def markers_table(tmp_path, names=ARM_MARKERS, rows=400, unseen=()):
    rng = np.random.default_rng(0)
    rest = {"right_elbow": (100.0, 0.0, -250.0), "right_shoulder": (0.0, 0.0, 0.0)}
    places = np.stack(
        [np.array(rest.get(name, (100.0, 250.0, -250.0))) + 3.0 * smooth_noise(rng, rows, 20.0, 3) for name in names],
        axis=1,
    )
    for name in unseen:
        places[:, names.index(name)] = 0.0
    places[50:60, 0] = 0.0  # a gap
    lines = ["NO_OF_MARKERS\t5", "FREQUENCY\t100", "MARKER_NAMES\t" + "\t".join(names)]
    lines += ["\t".join(f"{v:.3f}" for v in row.ravel()) for row in places]
    path = tmp_path / "arm.tsv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_recorded_motion_is_bounded_and_smooth(tmp_path):
    wander = recorded_wander(markers_table(tmp_path), np.random.default_rng(0), 300, 30.0)
    assert np.isfinite(wander.wrist).all() and np.linalg.norm(wander.wrist, axis=1).max() <= 0.04 + 1e-12
    assert 1e-4 < np.abs(np.diff(wander.wrist, axis=0)).max() < 0.02
    assert np.abs(wander.swivel).max() <= math.radians(15.0) + 1e-12
    cell = make_cell(3, CellSettings(frames=60, fps=12.0, motion=tmp_path / "arm.tsv"))
    assert cell.p.shape == (60, 16, 3)


def test_motion_without_an_arm_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"arm\.tsv: has no marker 'right_elbow'; wanted: hand_top"):
        recorded_wander(
            markers_table(tmp_path, ("hand_top", "hand_left", "hand_right", "x", "y")),
            np.random.default_rng(0),
            9,
            30.0,
        )
    with pytest.raises(InputError, match="marker 'right_elbow' is never seen"):
        recorded_wander(markers_table(tmp_path, unseen=("right_elbow",)), np.random.default_rng(0), 9, 30.0)


# the sensors


def test_depth_noise_grows_with_the_square_of_the_distance():
    rng = np.random.default_rng(0)
    for z in (1.0, 2.0, 4.0):
        wall = Surfaces(np.full((100, 100), z), np.ones((100, 100)))
        read = sense_depth(rng, wall, 0.002, 0.0, 0.4, 6.0)
        assert np.std(read) == pytest.approx(0.002 * z * z, rel=0.05)


def test_holes_lie_at_edges_grazing_surfaces_blobs_and_beyond_the_range():
    z = np.full((60, 80), 2.0)
    z[:, 40:] = 3.0
    facing = np.ones_like(z)
    facing[:10] = 0.1
    read = sense_depth(np.random.default_rng(0), Surfaces(z, facing), 0.0, 1e-6, 0.4, 6.0)
    assert (read[:10] == 0).mean() == pytest.approx(0.75, abs=0.08)
    assert (read[10:, 40] == 0).mean() == pytest.approx(0.7, abs=0.2)
    assert (read[10:, :39] > 0).all() and (read[10:, 42:] > 0).all()
    flat = Surfaces(np.full((200, 200), 2.0), np.ones((200, 200)))
    share = (sense_depth(np.random.default_rng(0), flat, 0.0, 0.1, 0.4, 6.0) == 0).mean()
    assert share == pytest.approx(1.0 - math.exp(-0.1), abs=0.03)
    for depth in (0.3, 7.0, np.inf):
        gone = Surfaces(np.full((4, 5), depth), np.ones((4, 5)))
        assert (sense_depth(np.random.default_rng(0), gone, 0.001, 0.0, 0.4, 6.0) == 0).all()


def test_states_follow_what_is_seen():
    share = np.array([0.9, 0.9, 0.3, 0.0, 0.0, 0.0, 0.0, 0.9, 0.9, 0.9])[:, None]
    wanted = [TRACKED, TRACKED, INFERRED, INFERRED, INFERRED, LOST, LOST, INFERRED, TRACKED, TRACKED]
    assert states_of(share, 2)[:, 0].tolist() == wanted
    assert states_of(np.zeros((3, 1)), 2)[:, 0].tolist() == [LOST] * 3


def test_a_tracked_keypoint_is_near_the_truth_and_an_inferred_one_less(cells):
    cell = cells[0]
    found = detections_of(cell, np.random.default_rng(0))
    error = np.linalg.norm(found.p - cell.p, axis=-1)
    tracked, inferred = error[found.state == TRACKED], error[found.state == INFERRED]
    assert math.sqrt((tracked**2).mean() / 3.0) == pytest.approx(0.010, rel=0.1)
    assert 0.03 < inferred.mean() < 0.12
    assert np.isnan(error[found.state == LOST]).all() and (found.confidence[found.state == LOST] == 0).all()
    assert found.confidence[found.state == TRACKED].min() > found.confidence[found.state == INFERRED].mean()
    for state in (TRACKED, INFERRED, LOST):
        assert (found.state[:, WRIST] == state).any()


def test_a_sensor_that_takes_the_skin_reports_joints_too_near(cells):
    cell = cells[0]
    plain = detections_of(cell, np.random.default_rng(0))
    near = detections_of(
        make_cell(0, CellSettings(frames=120, fps=12.0, width=96, height=72, sensor_offset=0.035)),
        np.random.default_rng(0),
    )
    moved = plain.p - near.p
    unit = cell.p / np.linalg.norm(cell.p, axis=-1, keepdims=True)
    np.testing.assert_allclose(moved[~np.isnan(moved)], (0.035 * unit)[~np.isnan(moved)], atol=1e-9)


def test_the_depth_at_a_tracked_wrist_is_its_skins(folder):
    scene = read_rgbd(folder)
    assert scene.truth is not None
    gaps = []
    for i in range(0, 120, 5):
        p = scene.truth.p[i, 0, WRIST]
        if scene.detections.state[i, WRIST] == TRACKED:
            x, y = np.rint(project(scene.camera, p)).astype(int)
            depth = read_depth(scene, i)[y, x]
            gaps += [p[2] - depth] if depth > 0 else []
    assert len(gaps) > 5 and 0.0 < np.median(gaps) < 0.06


def test_a_keypoint_off_the_image_is_not_seen(cells):
    cell = cells[0]
    shift = np.array([5.0, 0.0, 0.0])
    share, cause = visible_share(
        cell.body,
        cell.p[:2] + shift,
        cell.parts[:2] + shift,
        cell.links[:2],
        cell.robot.radius,
        cell.room.boxes,
        cell.eye,
    )
    assert (share == 0).all() and (cause == OUTSIDE).all()


def test_a_knee_behind_another_part_is_hidden_by_the_body(cells):
    cell = cells[0]
    parts = cell.parts[:1].copy()
    parts[:, PARTS.index("head")] = 0.7 * cell.p[0, 8]  # a head between the eye and the left knee
    share, cause = visible_share(
        cell.body,
        cell.p[:1],
        parts,
        cell.links[:1] + 50.0,
        cell.robot.radius,
        Boxes(np.full((1, 3), 90.0), np.ones((1, 3)), np.zeros(1)),
        cell.eye,
    )
    assert share[0, 8] == 0 and cause[0, 8] == BY_BODY
    assert person_and_robot(cell.body, parts[0], cell.links[0], cell.robot.radius).base.shape == (len(PARTS) + 3, 3)


# the scene


def test_the_scene_reads_without_a_warning(folder):
    scene = read_rgbd(folder)
    assert scene.warnings == () and len(scene) == 120 and scene.camera.width == 96
    assert scene.truth is not None and np.isfinite(scene.truth.p).all() and scene.truth.p.shape == (120, 1, 16, 3)
    assert read_robot(folder / "robot.csv", 120).ends.shape == (120, 3, 2, 3)
    assert 0.0 < np.mean([(read_depth(scene, i) == 0).mean() for i in (0, 60)]) < 0.3


def test_the_same_seed_gives_the_same_bytes(folder, tmp_path):
    simulate_cell(tmp_path / "again", 4, SMALL)
    files = sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
    assert len(files) == 125
    assert all((folder / name).read_bytes() == (tmp_path / "again" / name).read_bytes() for name in files)


def test_the_left_handed_cell_is_the_mirror_image(folder, tmp_path):
    simulate_cell(tmp_path / "left", 4, CellSettings(frames=120, fps=12.0, width=96, height=72, side="left"))
    right, left = read_rgbd(folder), read_rgbd(tmp_path / "left")
    assert right.truth is not None and left.truth is not None
    np.testing.assert_allclose(left.truth.p[:, 0], mirrored(right.truth.p[:, 0]), atol=1e-9)
    np.testing.assert_array_equal(read_depth(left, 7), read_depth(right, 7)[:, ::-1])
    uv, flipped = project(right.camera, right.truth.p[0, 0, WRIST]), project(left.camera, left.truth.p[0, 0, WRIST - 1])
    np.testing.assert_allclose(flipped, [95 - uv[0], uv[1]], atol=1e-6)
    a, b = (trimesh.load(scene.environment, process=False) for scene in (right, left))
    assert isinstance(a, trimesh.Trimesh) and isinstance(b, trimesh.Trimesh)
    assert b.volume == pytest.approx(a.volume) and b.volume > 0
    np.testing.assert_allclose(b.bounds[:, 0], -a.bounds[::-1, 0], atol=1e-6)
    swapped = read_robot(tmp_path / "left" / "robot.csv", 120).ends[..., 0]
    np.testing.assert_allclose(swapped, -read_robot(folder / "robot.csv", 120).ends[..., 0], atol=1e-9)


def test_several_cycles_follow_each_other_without_a_jump():
    cell = make_cell(5, CellSettings(frames=228, fps=12.0, cycles=2, occlusion="static"))
    assert cell.tasks.kind.size == 8 and (np.diff(cell.tasks.frames[:, 0]) > 0).all()
    assert np.linalg.norm(np.diff(cell.p, axis=0), axis=-1).max() * 12.0 < 4.0


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 2000), st.floats(1.0, 120.0))
def test_cycles_cover_the_scene(frames, fps):
    bounds = CellSettings(frames=frames, fps=fps).bounds()
    assert bounds[0] == 0 and bounds[-1] >= frames > bounds[-2]


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("frames", 0, "frames: got 0, wanted 1 to 1000000"),
        ("occlusion", "none", "occlusion: got 'none', wanted one of static, dynamic, both"),
        ("side", "up", "side: got 'up', wanted one of left, right"),
        ("noise", math.nan, "noise: got nan"),
        ("cycles", 3, "cycles: got 3 in 10 s; wanted from 1, each of 9 s or more"),
    ],
)
def test_settings_are_checked(monkeypatch, name, value, match):
    # The type checker of the tests would be first; users run without it.
    monkeypatch.setattr(config, "jaxtyping_disable", True)
    with pytest.raises(ValueError, match=match):
        CellSettings(**{name: value})


def test_a_hopeless_cell_is_given_up(monkeypatch):
    monkeypatch.setattr(cell_plan, "TRIES", 2)
    monkeypatch.setattr(cell_plan, "reachable", lambda body, ways, turn, boxes: np.zeros(ways.shape[0], dtype=bool))
    with pytest.raises(RuntimeError, match="seed 0: no cell of 2 lets the person work unhurt"):
        make_cell(0, SMALL)


def test_spheres_of_an_arm_lie_on_its_pills():
    body = body_of(1.7)
    shoulder, elbow, wrist = (
        np.zeros((1, 3)),
        np.array([[0.0, 0.0, -body.upper_arm]]),
        np.array([[0.0, body.forearm, -body.upper_arm]]),
    )
    places, radii = arm_spheres(body, shoulder, elbow, wrist)
    assert places.shape == (1, radii.size, 3)
    np.testing.assert_allclose(places[0, -1], [0.0, body.forearm + body.hand, -body.upper_arm])
    assert radii.min() == body.radius[PARTS.index("right_hand")].min()
