"""Claims about sequence folders: a tracker's own readers open them, and model, camera and truth meet the labels."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from labelled_double import labelled_double
from scipy.spatial.transform import Rotation

from handtrack.camera import camera_from_world, perspective
from handtrack.kinematics import forward, link_ends
from handtrack.kinematics.builtin import model
from handtrack.pills import Pills
from handtrack.sequences import open_sequence
from synth.dataset.encode import Labels
from synth.dataset.folder import description_files, frame_files, frame_names
from synth.dataset.free_model import base_rows, hand_model, tracked
from synth.dataset.hands import pill_hand
from synth.labels.bodies import Body, Placed, Rigid, solids_of
from synth.labels.shot import Exposure, Shot, keypoints_at, parts_of
from synth.labels.solids import KEYPOINTS, Lights, Paint

CAMERA = perspective(
    96, 72, 80.0, 82.0, 48.0, 36.0, Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), np.array([5.0, -3.0, 20.0])
)
NONE = np.zeros((0, 3))
ROUND = Pills(np.zeros((1, 3)), np.zeros((1, 3)), np.full((1, 2), 9.0))
BALL = Rigid("sphere", ROUND, NONE, NONE, np.zeros((0, 3), int))


def placement(frame, moves) -> tuple[Any, Any]:
    drift = Rotation.from_rotvec(0.1 * moves * frame * np.array([1, 2, -1]))
    turn = Rotation.from_euler("XYZ", [math.pi, 0.1, 0.0]) * drift
    return turn.as_matrix(), np.array([10.0, 60.0, 450.0]) + moves * frame * np.array([3.0, -2.0, 5.0])


def shots(shape, moves=1.0, count=4):
    """Frames of one sequence: a hand whose joints and base move, and a ball in front of it."""
    out, (low, high) = [], shape.model.limits.T
    free = low + np.random.default_rng(4).uniform(0.2, 0.6, (count + 1, low.size)) * (high - low)
    for frame in range(count):
        (R0, t0), (R1, t1) = placement(frame, moves), placement(frame + 1, moves)
        hand = Body(shape, Placed(np.stack([R0, R1]), np.stack([t0, t1])), free[frame : frame + 2])
        ball = Body(BALL, Placed(np.tile(np.eye(3), (2, 1, 1)), np.full((2, 3), 50.0)), np.zeros((2, 0)))
        parts = parts_of((hand, ball))
        n = len(parts.name)
        paint = Paint(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, int), np.ones(n), np.zeros(n), np.ones(n))
        lights = Lights(0.5, np.zeros((0, 3)), np.zeros((0, 3)))
        grey = np.zeros((72, 96, 3), np.uint8)
        out.append(Shot((hand, ball), parts, paint, CAMERA, lights, grey, Exposure(), 1, frame, 0, frame))
    return out


def written(folder: Path, made, fps=30.0):
    for frame, shot in enumerate(made):
        image = replace(labelled_double(frame, 96, 72), index=frame, sequence=shot.sequence, frame=frame)
        for name, content in frame_files(image, Labels(), 1):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
    for name, content in description_files(made, fps):
        (folder / name).write_bytes(content)
    return folder / "sequence_000000"


@pytest.mark.parametrize("left", [False, True])
@pytest.mark.parametrize("moves", [0.0, 1.0])
def test_the_written_model_at_its_truth_meets_the_labelled_keypoints(tmp_path, left, moves):
    made = shots(pill_hand(model("full_hand"), left, radius=1.1), moves)
    sequence: Any = open_sequence(written(tmp_path, made))
    assert not sequence.warnings and len(sequence) == 4 and sequence.fps == 30.0
    assert ("wrist_yaw" in sequence.model.joint_names) == bool(moves)
    for frame, shot in enumerate(made):
        labelled = keypoints_at(shot, 0.0).p_cam[0]
        base, tip = link_ends(sequence.model, forward(sequence.model, sequence.truth.q[frame]))
        joints = np.concatenate([base, tip])
        ends = camera_from_world(sequence.cameras[0], joints)
        apart = np.linalg.norm(labelled[:, None] - ends[None], axis=2).min(axis=1)
        assert apart.max() < 1e-6, KEYPOINTS[int(apart.argmax())]
        solids = solids_of(shot.bodies[0], 0.0, CAMERA, 0)
        both = np.sort(np.linalg.norm(solids.pills.tip - solids.pills.base, axis=1))
        np.testing.assert_allclose(np.sort(np.linalg.norm(tip - base, axis=1)), both, atol=1e-9)
    np.testing.assert_allclose(np.sort(sequence.model.link_radius.ravel()), np.sort(solids.pills.radius.ravel()))
    np.testing.assert_allclose(sequence.start, sequence.truth.q[0], atol=1e-9)


def test_frames_are_the_pictures_and_their_labels_lie_beside_them(tmp_path):
    folder = written(tmp_path, shots(pill_hand(model("full_hand"))))
    assert sorted(path.name for path in folder.iterdir()) == [
        "depth", "flow", "frames", "labels", "model.yaml", "normal", "part", "sequence.yaml", "truth.csv",
    ]  # fmt: skip
    for name in ("depth", "flow", "frames", "normal", "part"):
        assert [path.name for path in sorted((folder / name).iterdir())] == [f"{k:06d}.png" for k in range(4)]
    picture: Any = cv2.imread(str(folder / "frames/000002.png"))
    assert np.array_equal(picture[..., ::-1], labelled_double(2, 96, 72).image)
    assert [name for _, name in frame_names(0, 1)][-1] == "sequence_000000/labels/000001.json"


def test_a_model_with_a_finger_alone_needs_no_palm(tmp_path):
    sequence: Any = open_sequence(written(tmp_path, shots(pill_hand(model("index")))))
    assert sequence.model.link_length.size == 3 and len(sequence.model.joint_names) == 9


def test_a_sequence_without_a_hand_is_not_described():
    made = [replace(shot, bodies=shot.bodies[1:]) for shot in shots(pill_hand(model("index")))]
    assert description_files(made, 25.0) == () and tracked([]) is None


def test_frames_of_different_hands_are_refused():
    first, second = shots(pill_hand(model("index")))[0], shots(pill_hand(model("full_hand")))[1]
    with pytest.raises(ValueError, match="shots: their first hands differ"):
        tracked([first, second])


def test_a_left_hand_with_a_sliding_joint_is_refused():
    shape = pill_hand(model("index"))
    slides = replace(shape.model, prismatic=np.ones(shape.model.parent.size, bool))
    with pytest.raises(ValueError, match="has a joint that slides; turning joints are wanted"):
        hand_model(replace(shape, model=slides, mirrored=True), moves=False)


@pytest.mark.parametrize("seed", range(5))
def test_six_joints_carry_the_base_to_any_place(seed):
    from handtrack.kinematics.tree import model_from_rows

    rng = np.random.default_rng(seed)
    turn, place = Rotation.from_rotvec(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 50.0, 3)
    q = np.concatenate([place[::-1], turn.as_euler("ZYX")])
    last = forward(model_from_rows("base", base_rows(3)), q)[-1]
    np.testing.assert_allclose(last[:3, :3], turn.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(last[:3, 3], place, atol=1e-12)


def test_a_fixed_frame_of_another_form_is_kept():
    shape = pill_hand(model("index"))
    prefix = shape.model.prefix.copy()
    odd = replace(
        shape.model,
        frame_ids=np.append(shape.model.frame_ids, 90),
        parent=np.append(shape.model.parent, 0),
        prefix=np.concatenate([prefix, _turned()[None]]),
        joint=np.append(shape.model.joint, -1),
        prismatic=np.append(shape.model.prismatic, False),
    )
    for mirrored in (False, True):
        made = hand_model(replace(shape, model=odd, mirrored=mirrored), moves=False)
        sign = np.diag([1.0, 1.0, -1.0, 1.0]) if mirrored else np.eye(4)
        index = made.frame_ids.tolist().index(90)
        np.testing.assert_allclose(made.prefix[index], sign @ _turned() @ sign)


def _turned():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.4, 0.5, 0.6]).as_matrix()
    return T
