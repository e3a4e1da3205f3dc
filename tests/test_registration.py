"""Claims about boards and registration: rendered and computed boards are the truth; photographs are the hard cases."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handtrack.body.board import (
    Board,
    Detection,
    Dictionary,
    detect,
    flat,
    named_dictionary,
    opencv_board,
    read_board,
    read_dictionary,
    refusal,
)
from handtrack.body.registration import (
    Gate,
    Pose,
    adjoint,
    average,
    board_pose,
    inverse,
    register,
    relate,
    rigid,
)
from handtrack.body.registration_files import (
    draw_detection,
    register_images,
    registration_text,
    write_registration,
)
from handtrack.camera import orthographic, perspective, project_camera, rays
from handtrack.cli import main
from handtrack.errors import InputError
from handtrack.formats.cameras import cameras_text

PHOTOS = Path(__file__).parents[2] / "shared" / "data" / "charuco"
SMALL = Board(5, 4, 0.06, 0.045, named_dictionary("4X4_50"))
LARGE = Board(10, 7, 0.04, 0.03, named_dictionary("5X5_100"))
BENT = np.array([0.08, -0.1, 0.001, -0.001, 0.02])


def camera_of(width, height, focal, bend=None):
    centre = ((width - 1) / 2, (height - 1) / 2)
    return perspective(width, height, focal, focal, *centre, np.eye(3), np.zeros(3), bend)


KINECT, HEADSET = camera_of(1920, 1080, 1060.0), camera_of(2048, 1152, 1450.0)


def middle(board):
    return np.array([board.columns, board.rows, 0.0]) * board.square / 2


def place(rng, board, distance, tilt):
    """A pose of a board whose middle is at a distance and which is tilted by an angle."""
    axis = rng.normal(size=2)
    R = Rotation.from_rotvec([*(tilt * axis / np.linalg.norm(axis)), rng.uniform(-0.3, 0.3)]).as_matrix()
    at = np.array([*rng.uniform(-0.1, 0.1, 2), distance])
    return R, at - R @ middle(board)


def corners_seen(rng, board, camera, R, t, noise=0.3):
    xy = project_camera(camera, board.corners @ R.T + t)
    return Detection(xy + rng.normal(scale=noise, size=xy.shape), np.arange(xy.shape[0]), board.markers)


def picture(board, camera, R, t, fine=3):
    """A picture of a sheet with a board: every pixel is the mean of rays that meet the sheet (camera.rays)."""
    side = 40
    sheet = 30.0 + 0.8 * opencv_board(board).generateImage((board.columns * side, board.rows * side)).astype(float)
    part = (np.arange(fine) + 0.5) / fine - 0.5
    x, y = ((np.arange(n)[:, None] + part).ravel() for n in (camera.width, camera.height))
    _, way = rays(camera, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    far = (R[:, 2] @ t) / (way @ R[:, 2])
    cell = ((way * far[:, None] - t) @ R)[:, :2] / board.square
    row, column = np.floor(cell[:, ::-1] * side).astype(int).T
    on_sheet = ((cell > -0.7) & (cell < (board.columns + 0.7, board.rows + 0.7))).all(axis=1)
    inside = (row >= 0) & (row < sheet.shape[0]) & (column >= 0) & (column < sheet.shape[1])
    value = np.where(on_sheet, 234.0, 90.0)
    value[inside] = sheet[row[inside], column[inside]]
    return cv2.GaussianBlur(value.reshape(camera.height, fine, camera.width, fine).mean(axis=(1, 3)), (0, 0), 0.5)


def turned(A, B):
    """Distance, metres, and angle, radians, between two rigid motions."""
    difference = inverse(A) @ B
    return np.linalg.norm(difference[:3, 3]), Rotation.from_matrix(difference[:3, :3]).magnitude()


# Boards and pictures of them


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize(("columns", "rows"), [(5, 4), (4, 5), (5, 7), (6, 4), (2, 2)])
def test_our_board_is_the_one_that_opencv_draws(columns, rows, legacy):
    board = Board(columns, rows, 0.04, 0.03, named_dictionary("5X5_100"), legacy)
    theirs = opencv_board(board)
    np.testing.assert_allclose(np.asarray(theirs.getChessboardCorners()), board.corners, atol=1e-7)
    assert len(np.ravel(theirs.getIds())) == board.markers


@pytest.mark.parametrize("legacy", [False, True])
def test_the_corners_of_a_drawn_board_are_found_where_they_are(legacy):
    board = Board(6, 4, 0.04, 0.03, named_dictionary("5X5_100"), legacy, first=3)
    drawn = cv2.copyMakeBorder(
        opencv_board(board).generateImage((480, 320)), 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=(255.0,)
    )
    for image in (drawn, drawn.astype(np.float32), cv2.cvtColor(drawn, cv2.COLOR_GRAY2BGR)):
        found = detect(image, board)
        assert found.markers == 12 and found.ids.tolist() == list(range(15))
        assert np.abs(found.xy - (board.corners[:, :2] * 2000 + 39.5)).max() < 0.25
    other = detect(drawn, Board(6, 4, 0.04, 0.03, named_dictionary("5X5_100"), not legacy, first=3))
    assert not other.ids.size  # the wrong pattern places nothing


def test_a_rendered_board_is_found_without_bias():
    rng = np.random.default_rng(4)
    camera = camera_of(480, 360, 420.0, BENT)
    R, t = place(rng, SMALL, 0.7, 0.4)
    image = picture(SMALL, camera, R, t) + rng.normal(scale=2.0, size=(360, 480))
    found = detect(image, SMALL, camera)
    assert found.ids.tolist() == list(range(12))
    error = found.xy - project_camera(camera, SMALL.corners @ R.T + t)
    assert np.abs(error.mean(axis=0)).max() < 0.03 and error.std() < 0.1
    pose = board_pose(found, SMALL, camera)
    far, turn = turned(rigid(R, t), pose.matrix)
    assert far < 0.002 and turn < np.radians(0.3) and pose.reprojection_px < 0.1 and pose.corners == 12


def test_an_image_of_another_size_than_the_camera_is_refused():
    with pytest.raises(ValueError, match="image: 20 x 10 pixels; 480 x 360, the camera's, wanted"):
        detect(np.zeros((10, 20), np.uint8), SMALL, camera_of(480, 360, 420.0))


@pytest.mark.parametrize("shape", [(5, 1, 2), (5, 2)])
def test_arrays_of_both_versions_of_opencv_are_brought_to_rows(shape):
    assert flat(np.arange(10.0).reshape(shape), 2).tolist() == np.arange(10.0).reshape(5, 2).tolist()
    assert flat(None, 1).shape == (0, 1)


# What is refused


@pytest.mark.parametrize(("changes", "message"), [
    ({"columns": 1}, "columns: 1 given; 2 to 100 are wanted"),
    ({"rows": 101}, "rows: 101 given; 2 to 100 are wanted"),
    ({"square": 40.0}, "square: 40 given; metres, above 0 and at most 5, are wanted"),
    ({"marker": 0.04}, "marker: 0.04 given; a side above 0 and below the square's is wanted"),
    ({"first": 34}, "first: 34 given; 17 markers from there on are wanted of the 50 of 4X4_50"),
])  # fmt: skip
def test_boards_that_cannot_be_are_refused(changes, message):
    given_ = {"columns": 5, "rows": 7, "square": 0.04, "marker": 0.03, "dictionary": named_dictionary("4X4_50")}
    with pytest.raises(ValueError, match=message):
        Board(**{**given_, **changes})


def test_an_unknown_dictionary_is_refused():
    with pytest.raises(ValueError, match="name: '4X4_51' given; one of 4X4_100"):
        named_dictionary("4X4_51")


BOARD_FILE = """format: handtrack/board-1
columns: 5
rows: 7
square: 0.04
marker: 0.02
dictionary: 6x6_250
"""


def test_a_board_file_gives_its_board(tmp_path):
    (tmp_path / "board.yaml").write_text(BOARD_FILE + "legacy: true\nfirst: 2\n")
    board = read_board(tmp_path / "board.yaml")
    assert (board.columns, board.rows, board.square, board.marker) == (5, 7, 0.04, 0.02)
    assert board.legacy and board.first == 2 and board.dictionary.name == "6X6_250"


@pytest.mark.parametrize(("old", "new", "message"), [
    ("6x6_250", "markers", r"line 6: dictionary: 'markers' given; one of 4X4_100, .*, or a file that ends in .yml"),
    ("6x6_250", "../d.yml", r"leaves the folder by '\.\.'"),
    ("6x6_250", "d.yml", r"d\.yml: no such file"),
    ("0.02", "0.05", r"board\.yaml: marker: 0\.05 given; a side above 0 and below the square's"),
    ("columns: 5", "columns: one", r"line 2: columns:"),
    ("rows: 7\n", "", r"'rows' is missing"),
])  # fmt: skip
def test_bad_board_files_are_refused_with_their_line(tmp_path, old, new, message):
    (tmp_path / "board.yaml").write_text(BOARD_FILE.replace(old, new))
    with pytest.raises(InputError, match=message) as refused:
        read_board(tmp_path / "board.yaml")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("text", "message"), [
    ("nmarkers: 1\nmarkersize: 3\nmarker_0: '010111000'\n", ""),
    ("%YAML:1.0\nnmarkers: 1\nmarkersize: 3\nmaxCorrectionBits: 1\nmarker_0: '010111000'\n", ""),
    ("nmarkers: 0\nmarkersize: 3\n", "nmarkers: 0 given; a whole number from 1 to 10000"),
    ("nmarkers: 1\nmarkersize: 3.5\n", "markersize: 3.5 given; a whole number from 3 to 16"),
    ("nmarkers: 2\nmarkersize: 3\nmarker_0: '010111000'\n", "marker_1: 9 digits 0 or 1 in quotes"),
    ("nmarkers: 1\nmarkersize: 3\nmarker_0: '010111002'\n", "marker_0: 9 digits 0 or 1 in quotes"),
    ("- 1\n", "keys nmarkers, markersize and marker_0 on are wanted"),
    ("nmarkers: [\n", "valid YAML is wanted"),
])  # fmt: skip
def test_files_of_markers_are_read_or_refused(tmp_path, text, message):
    path = tmp_path / "d.yml"
    path.write_text(text)
    if not message:
        assert read_dictionary(path).bits.tolist() == [[[0, 1, 0], [1, 1, 1], [0, 0, 0]]]
        return
    with pytest.raises(InputError, match=message):
        read_dictionary(path)


def test_our_reader_of_markers_agrees_with_opencvs_own():
    path = PHOTOS / "tutorial_dict.yml"
    theirs, file = cv2.aruco.Dictionary(), cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    theirs.readDictionary(file.root())
    ours = read_dictionary(path)
    board = opencv_board(Board(5, 7, 0.04, 0.02, ours))
    np.testing.assert_array_equal(np.asarray(board.getDictionary().bytesList), np.asarray(theirs.bytesList))


def test_a_detection_that_gives_no_pose_says_why():
    line = Detection(np.zeros((6, 2)), np.arange(6), 9)
    assert refusal(LARGE, line) == "the corners seen are on one line; some across it are wanted"
    assert refusal(LARGE, Detection(np.zeros((0, 2)), np.zeros(0, int), 0)) == "no marker of 5X5_100 is seen"
    with pytest.raises(InputError, match="are on one line"):
        board_pose(line, LARGE, KINECT)
    with pytest.raises(ValueError, match="camera: orthographic given; a perspective one is wanted"):
        board_pose(line, LARGE, orthographic(64, 48, 1.0, 32.0, 24.0, np.eye(3), np.zeros(3)))


# Photographs


def test_the_photographed_board_begins_with_marker_one():
    """Counted from 0 it does not fit; from 1 it lies flat to within a pixel, bent paper and lens and all."""
    image = np.asarray(cv2.imread(str(PHOTOS / "choriginal.png")))
    markers = read_dictionary(PHOTOS / "tutorial_dict.yml")
    wrong = Board(5, 7, 0.04, 0.02, markers)
    assert refusal(wrong, detect(image, wrong)).startswith("15 markers are seen, but they are not arranged as on this")
    board = Board(5, 7, 0.04, 0.02, markers, first=1)
    found = detect(image, board)
    assert found.ids.size >= 19
    H, _ = cv2.findHomography(board.corners[found.ids, :2], found.xy)
    assert np.sqrt(((cv2.perspectiveTransform(board.corners[None, found.ids, :2], H)[0] - found.xy) ** 2).mean()) < 1.0


def test_a_covered_board_is_refused_in_words():
    board = Board(5, 7, 0.04, 0.02, read_dictionary(PHOTOS / "tutorial_dict.yml"), first=1)
    found = detect(np.asarray(cv2.imread(str(PHOTOS / "chocclusion.png"))), board)
    with pytest.raises(InputError, match="1 corners are seen; 6 are wanted"):
        board_pose(found, board, camera_of(640, 480, 450.0))


# Poses


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), distance=st.floats(0.6, 3.0), tilt=st.floats(0.0, 1.2))
def test_exact_corners_give_the_exact_pose(seed, distance, tilt):
    rng = np.random.default_rng(seed)
    camera = camera_of(1280, 960, 900.0, BENT)
    R, t = place(rng, LARGE, distance, tilt)
    pose = board_pose(corners_seen(rng, LARGE, camera, R, t, 0.0), LARGE, camera)
    far, turn = turned(rigid(R, t), pose.matrix)
    assert far < 1e-6 and turn < 1e-6 and pose.reprojection_px < 1e-6
    assert pose.other_px >= pose.reprojection_px


def test_the_covariance_of_a_pose_says_how_far_it_is_off():
    rng = np.random.default_rng(5)
    surprise = []
    for _ in range(60):
        R, t = place(rng, LARGE, 1.6, 0.5)
        pose = board_pose(corners_seen(rng, LARGE, KINECT, R, t), LARGE, KINECT)
        off = inverse(pose.matrix) @ rigid(R, t)
        move = np.concatenate([off[:3, 3], Rotation.from_matrix(off[:3, :3]).as_rotvec()])
        surprise.append(move @ np.linalg.solve(pose.covariance, move))
    assert 4.0 < np.mean(surprise) < 8.5  # chi-square of 6 degrees of freedom: 6


def test_wrong_corners_hardly_move_a_pose():
    """Five of 54 are off by tens of pixels: the pose stays within its own sigma of that of the others alone."""
    for seed in range(6, 12):
        rng = np.random.default_rng(seed)
        R, t = place(rng, LARGE, 1.6, 0.5)
        found = corners_seen(rng, LARGE, KINECT, R, t)
        xy = found.xy.copy()
        xy[:5] += rng.normal(scale=30.0, size=(5, 2))
        pose = board_pose(Detection(xy, found.ids, found.markers), LARGE, KINECT)
        without = board_pose(Detection(xy[5:], found.ids[5:], found.markers), LARGE, KINECT)
        off = inverse(without.matrix) @ pose.matrix
        move = np.concatenate([off[:3, 3], Rotation.from_matrix(off[:3, :3]).as_rotvec()])
        assert (np.abs(move) < np.sqrt(np.diag(without.covariance))).all()
        assert pose.corners <= xy.shape[0] - 4


def test_a_small_far_board_could_be_tilted_either_way():
    rng = np.random.default_rng(7)
    R, t = place(rng, SMALL, 6.0, 0.1)
    pose = board_pose(corners_seen(rng, SMALL, camera_of(640, 480, 500.0), R, t), SMALL, camera_of(640, 480, 500.0))
    assert pose.other_px < 1.2 * pose.reprojection_px


def test_corners_that_no_pose_explains_fit_badly():
    for seed in range(5):
        chaos = Detection(np.random.default_rng(seed).uniform(0, 1000, (54, 2)), np.arange(54), 30)
        try:
            assert board_pose(chaos, LARGE, KINECT).reprojection_px > 20
        except InputError as error:
            assert str(error) == "no pose in front of the camera explains the corners"  # noqa: PT017


# Means and relations


def near(rng, R, t, moved, turned_by, covariance=1e-6):
    return Pose(
        R @ Rotation.from_rotvec(rng.normal(scale=turned_by, size=3)).as_matrix(),
        t + rng.normal(scale=moved, size=3),
        covariance * np.eye(6),
        0.3,
        24,
    )


def test_a_mean_leaves_out_what_is_beyond_the_gate():
    rng = np.random.default_rng(9)
    R, t = place(rng, LARGE, 1.6, 0.5)
    poses = [near(rng, R, t, 0.002, 0.002) for _ in range(20)]
    flipped = [near(rng, R @ Rotation.from_euler("x", 60, degrees=True).as_matrix(), t, 0.002, 0.002) for _ in range(7)]
    away = [near(rng, R, t + 0.3, 0.002, 0.002) for _ in range(6)]
    mean = average([*flipped, *poses, *away])
    assert mean.kept.tolist() == [False] * 7 + [True] * 20 + [False] * 6
    far, turn = turned(rigid(R, t), mean.pose.matrix)
    assert far < 0.002 and turn < 0.002
    assert average([*flipped, *poses, *away], Gate(10.0, 4.0)).kept.all()


def test_a_mean_weighs_each_direction_by_how_well_it_is_known():
    sharp_x, sharp_y = np.diag([1e-8, 1e-2, 1, 1, 1, 1]), np.diag([1e-2, 1e-8, 1, 1, 1, 1])
    a = Pose(np.eye(3), np.array([0.01, 0.0, 1.0]), sharp_x, 0.3, 24)
    b = Pose(np.eye(3), np.array([0.0, 0.02, 1.0]), sharp_y, 0.3, 24)
    mean = average([a, b])
    np.testing.assert_allclose(mean.pose.t, [0.01, 0.02, 1.0], atol=1e-6)


def test_the_mean_of_turns_across_half_a_turn_is_between_them():
    poses = [
        Pose(Rotation.from_euler("z", angle, degrees=True).as_matrix(), np.zeros(3), 1e-6 * np.eye(6), 0.3, 24)
        for angle in (179.0, -179.0, 180.0)
    ]
    assert Rotation.from_matrix(average(poses).pose.R).magnitude() == pytest.approx(np.pi, abs=1e-6)


def test_a_mean_is_less_sure_where_poses_differ_more_than_they_say():
    rng = np.random.default_rng(10)
    calm = average([near(rng, np.eye(3), np.zeros(3), 1e-4, 1e-4) for _ in range(20)])
    wild = average([near(rng, np.eye(3), np.zeros(3), 0.01, 0.01) for _ in range(20)])
    np.testing.assert_allclose(np.diag(calm.pose.covariance), 1e-6 / 20, rtol=1e-6)
    assert 0.3e-4 / 20 < wild.pose.covariance[0, 0] < 3e-4 / 20


def test_two_poses_far_apart_give_one_of_them():
    one, two = (Pose(np.eye(3), np.array([x, 0.0, 1.0]), 1e-6 * np.eye(6), 0.3, 24) for x in (0.0, 1.0))
    assert average([one, two]).kept.sum() == 1
    assert average([two]).pose.t.tolist() == [1.0, 0.0, 1.0]


@pytest.mark.parametrize(("work", "message"), [
    (lambda: average([]), "poses: none given; at least one is wanted"),
    (lambda: Gate(0.0, 1.0), "translation: 0.0 given; a number above 0 is wanted"),
    (lambda: Gate(1.0, float("nan")), "rotation: nan given"),
    (lambda: register(np.zeros((2, 4, 4)), [], []), "A_01: 2 given; 0, one for each pose of the board"),
])  # fmt: skip
def test_arguments_that_make_no_sense_are_refused(work, message):
    with pytest.raises(ValueError, match=message):
        work()


def test_the_adjoint_carries_small_moves_between_frames():
    rng = np.random.default_rng(11)
    A = rigid(Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), rng.normal(size=3))
    move = rng.normal(scale=1e-6, size=6)
    little = rigid(Rotation.from_rotvec(move[3:]).as_matrix(), move[:3])
    there = A @ little @ inverse(A)
    found = np.concatenate([there[:3, 3], Rotation.from_matrix(there[:3, :3]).as_rotvec()])
    np.testing.assert_allclose(found, adjoint(A) @ move, atol=1e-11)


def test_frames_cancel_in_the_relation():
    rng = np.random.default_rng(12)
    A_01, A_1char, A_kinchar = (
        rigid(Rotation.from_rotvec(rng.normal(size=(5, 3))).as_matrix(), rng.normal(size=(5, 3))) for _ in range(3)
    )
    A_0kin = relate(A_01, A_1char, A_kinchar)
    np.testing.assert_allclose(A_0kin @ A_kinchar, A_01 @ A_1char, atol=1e-12)


# The whole way


def scene(rng, board, distance, images, noise=0.3):
    """True place of the fixed camera, and what both cameras make of a board at a distance."""
    A_0kin = rigid(Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), rng.uniform(-1, 1, 3))
    R, t = place(rng, board, distance, rng.uniform(0.3, 0.6))
    fixed = [board_pose(corners_seen(rng, board, KINECT, R, t, noise), board, KINECT) for _ in range(images)]
    A_01, moving = [], []
    for _ in range(images):
        R_1, t_1 = place(rng, board, distance + rng.uniform(-0.1, 0.1), rng.uniform(0.2, 0.7))
        A_01.append(A_0kin @ rigid(R, t) @ inverse(rigid(R_1, t_1)))
        moving.append(board_pose(corners_seen(rng, board, HEADSET, R_1, t_1, noise), board, HEADSET))
    return A_0kin, np.stack(A_01), moving, fixed


def test_cameras_are_registered_within_two_millimetres_and_a_fifth_of_a_degree():
    """At 1.6 m, with 0.3 px of noise on every corner: thirty images of each camera do so as a rule, few do not."""
    errors = []
    for seed in range(8):
        A_0kin, A_01, moving, fixed = scene(np.random.default_rng(500 + seed), LARGE, 1.6, 30)
        errors.append(turned(A_0kin, register(A_01, moving, fixed).A_0kin))
    far, turn = np.array(errors).T
    assert np.median(far) <= 0.002 and far.max() <= 0.004 and turn.max() <= np.radians(0.2)


def test_the_covariance_of_a_registration_says_how_far_it_is_off():
    rng = np.random.default_rng(14)
    surprise = []
    for _ in range(25):
        A_0kin, A_01, moving, fixed = scene(rng, LARGE, 1.6, 4)
        found = register(A_01, moving, fixed)
        off = inverse(found.A_0kin) @ A_0kin
        move = np.concatenate([off[:3, 3], Rotation.from_matrix(off[:3, :3]).as_rotvec()])
        surprise.append(move @ np.linalg.solve(found.covariance, move))
    assert 3.0 < np.mean(surprise) < 9.0  # 6 would be exact


# Files


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    """Folders of two cameras that see a board: a blank image and a moved board among them."""
    folder, rng = tmp_path_factory.mktemp("shots"), np.random.default_rng(15)
    camera = camera_of(480, 360, 420.0)
    camera_bent = camera_of(480, 360, 430.0, BENT)
    for name, one in (("camera_1", camera_bent), ("camera_kin", camera)):
        (folder / f"{name}.yaml").write_text(cameras_text([one]))
    (folder / "board.yaml").write_text(
        "format: handtrack/board-1\ncolumns: 5\nrows: 4\nsquare: 0.06\nmarker: 0.045\ndictionary: 4X4_50\n"
    )
    (folder / "one").mkdir()
    (folder / "kin").mkdir()
    A_0kin = rigid(Rotation.from_euler("xyz", [10, 40, -5], degrees=True).as_matrix(), np.array([0.5, -0.2, 0.1]))
    R, t = place(rng, SMALL, 0.75, 0.5)
    rows = ["frame,time,x,y,z,qw,qx,qy,qz"]
    for k in range(5):
        R_1, t_1 = place(rng, SMALL, 0.7, 0.3 + 0.1 * k)
        A_01 = A_0kin @ rigid(R, t) @ inverse(rigid(R_1, t_1))
        cv2.imwrite(str(folder / "one" / f"{k}.png"), picture(SMALL, camera_bent, R_1, t_1, 2))
        A_01[0, 3] += 0.5 if k == 4 else 0.0  # it lost its way
        q = Rotation.from_matrix(A_01[:3, :3]).as_quat()
        rows += [",".join(map(str, [k, k / 10, *A_01[:3, 3], q[3], *q[:3]]))] if k != 3 else []
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    for k in range(2):
        seen = picture(SMALL, camera, R, t, 2) if k else np.full((360, 480), 90.0)
        cv2.imwrite(str(folder / "kin" / f"{k}.png"), seen + rng.normal(scale=1.0, size=seen.shape))
    return folder, A_0kin


def registered(folder, **changes):
    given_ = {
        "images_1": folder / "one", "poses_1": folder / "poses.csv", "camera_1": folder / "camera_1.yaml",
        "images_kin": folder / "kin", "camera_kin": folder / "camera_kin.yaml", "board": folder / "board.yaml",
    }  # fmt: skip
    return register_images(**{**given_, **changes})


def test_folders_of_pictures_register_their_cameras(shots, tmp_path):
    folder, A_0kin = shots
    found = registered(folder)
    far, turn = turned(A_0kin, found.relation.A_0kin)
    assert far < 0.004 and turn < np.radians(0.3)
    assert found.moving.kept.tolist() == [True, True, True, False, False] and found.fixed.kept.tolist() == [False, True]
    assert found.moving.reasons[3].endswith("poses.csv has no row for it")
    assert found.moving.reasons[4] == "the board seems to be elsewhere: beyond the gate"
    assert found.fixed.reasons[0] == "no marker of 4X4_50 is seen" and np.isnan(found.fixed.reprojection_px[0])
    assert "2 of 5 images are left out; the first, 3.png" in found.warnings[0]
    assert "1 of 2 images are left out; the first, 0.png: no marker of 4X4_50" in found.warnings[-1]
    assert "1 of 3 images also fit a board tilted the other way" in found.warnings[1]
    write_registration(tmp_path / "r.yaml", found)
    text = (tmp_path / "r.yaml").read_text()
    assert text == registration_text(registered(folder))  # the same bytes
    data = yaml.safe_load(text)
    np.testing.assert_array_equal(data["A_0kin"], found.relation.A_0kin)
    np.testing.assert_array_equal(data["covariance"], found.relation.covariance)
    assert [image["kept"] for image in data["fixed"]["images"]] == [False, True]
    assert data["fixed"]["images"][0]["reason"] == "no marker of 4X4_50 is seen"


def test_pictures_that_fit_badly_or_disagree_are_warned_about(shots, tmp_path):
    folder, _ = shots
    wrong = perspective(480, 360, 300.0, 500.0, 239.5, 179.5, np.eye(3), np.zeros(3))
    (tmp_path / "wrong.yaml").write_text(cameras_text([wrong]))
    found = registered(folder, camera_1=tmp_path / "wrong.yaml", gate=Gate(1e-6, 1e-6))
    assert any("1 of 4 poses agree; the board or the poses moved" in note for note in found.warnings)
    assert any("px; below 1 px is wanted of a calibrated camera" in note for note in found.warnings)


def test_folders_that_cannot_be_registered_are_refused(shots, tmp_path):
    folder, _ = shots
    (tmp_path / "blank").mkdir()
    cv2.imwrite(str(tmp_path / "blank" / "a.png"), np.full((360, 480), 90, np.uint8))
    with pytest.raises(InputError, match="no image gives the pose of the board; the first one: no marker of 4X4_50"):
        registered(folder, images_kin=tmp_path / "blank")
    cv2.imwrite(str(tmp_path / "blank" / "a.png"), np.full((36, 48), 90, np.uint8))
    with pytest.raises(InputError, match="is 48 x 36 pixels; 480 x 360, the camera's size, is wanted"):
        registered(folder, images_kin=tmp_path / "blank")
    with pytest.raises(InputError, match="no such file"):
        registered(folder, board=tmp_path / "board.yaml")


def test_a_drawing_shows_corners_and_axes_where_they_are():
    rng = np.random.default_rng(16)
    camera = camera_of(480, 360, 420.0)
    R, t = place(rng, SMALL, 0.7, 0.3)
    found = corners_seen(rng, SMALL, camera, R, t, 0.0)
    pose = board_pose(found, SMALL, camera)
    blank = np.zeros((360, 480), np.uint8)
    rings, whole = draw_detection(blank, found, None, SMALL, camera), draw_detection(blank, found, pose, SMALL, camera)
    x, y = np.rint(found.xy[0]).astype(int)
    assert not rings[y, x].any() and rings[y - 6 : y + 7, x - 6 : x + 7].any()
    assert whole[y, x, 0] > 100 and whole[y, x, 1] < 100  # the cross of the pose
    end = np.rint(project_camera(camera, R @ np.array([0.1, 0.0, 0.0]) + t)).astype(int)
    assert whole[end[1], end[0]].argmax() == 2  # the x axis is red
    assert not blank.any()


def test_a_dictionary_of_ones_own_makes_a_board_that_is_found():
    rng = np.random.default_rng(17)
    markers = Dictionary("own", rng.integers(0, 2, (20, 6, 6)).astype(np.uint8), 0)
    board = Board(5, 4, 0.06, 0.045, markers)
    drawn = cv2.copyMakeBorder(
        opencv_board(board).generateImage((500, 400)), 30, 30, 30, 30, cv2.BORDER_CONSTANT, value=(255.0,)
    )
    assert detect(drawn, board).ids.size == 12


def test_cameras_are_registered_and_shown_from_the_command_line(shots, tmp_path, capsys):
    folder, A_0kin = shots
    command = ["body", "register", "--moving", folder / "one", "--poses", folder / "poses.csv"]
    command += ["--moving-camera", folder / "camera_1.yaml", "--fixed", folder / "kin", "--fixed-camera"]
    command = [str(word) for word in [*command, folder / "camera_kin.yaml", "--board", folder / "board.yaml", "--out"]]
    assert main([*command, str(tmp_path / "r.yaml"), "--json"]) == 0
    told = capsys.readouterr()
    facts = json.loads(told.out)
    assert "2 of 5 images are left out" in told.err
    np.testing.assert_allclose(facts["A_0kin"], registered(folder).relation.A_0kin)
    assert (facts["moving_images"], facts["fixed_images"]) == (3, 1) and 0 < facts["sigma_mm"] < 20
    far, _ = turned(A_0kin, np.array(facts["A_0kin"]))
    assert 1e3 * far < 3.0 * facts["sigma_mm"]
    picture = np.asarray(cv2.imread(facts["picture"]))
    assert picture.shape[0] > 3 * 360 and picture.shape[1] > 2 * 480  # seven images in three rows
    assert main([*command, str(tmp_path / "s.yml")]) == 0
    assert "3 and 1 images, reprojection error" in capsys.readouterr().out
    for wrong, message in (
        (["r.txt"], "ends in .yaml is wanted"),
        (["t.yaml", "--gate-mm", "0"], "--gate-mm, --gate-"),
    ):
        assert main([*command, str(tmp_path / wrong[0]), *wrong[1:]]) == 2
        assert message in capsys.readouterr().err and not (tmp_path / wrong[0]).exists()
