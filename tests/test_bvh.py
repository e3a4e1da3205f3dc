"""BVH files: known facts of real clips, the meaning of channels, and one clear line for what is malformed."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handtrack.errors import InputError
from handtrack.formats.bvh import joint_frames, read_bvh

CLIPS = Path(__file__).parents[2] / "shared" / "data" / "body_bvh"
SMALL = """HIERARCHY
ROOT Hips
{
    OFFSET 1 2 3
    CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
    JOINT Arm
    {
        OFFSET 0 10 0
        CHANNELS 3 Zrotation Xrotation Yrotation
        End Site
        {
            OFFSET 5 0 0
        }
    }
}
MOTION
Frames: 2
Frame Time: 0.04
0 0 0 0 0 0 0 0 0
1 0 0 90 0 0 10 20 30
"""


def _written(folder: Path, text: str) -> Path:
    path = folder / "clip.bvh"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("name", "joints", "frames", "seconds"),
    [("bvh_test1", 29, 75, 0.033333), ("bvh_test2", 28, 61, 0.008333), ("bvh_test3", 73, 100, 0.008333)],
)
def test_real_clips_have_the_joints_and_frames_that_they_say(name, joints, frames, seconds):
    clip = read_bvh(CLIPS / f"{name}.bvh")
    assert len(clip.names) == joints and clip.motion.shape[0] == frames and clip.seconds == seconds
    R, p = joint_frames(clip)
    np.testing.assert_allclose(R @ R.transpose(0, 1, 3, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    moved = [i for i, kinds in enumerate(clip.channels) if clip.parent[i] >= 0 and not any(k < 3 for k in kinds)]
    bones = np.linalg.norm(p[:, moved] - p[:, clip.parent[moved]], axis=-1)
    np.testing.assert_allclose(bones, np.tile(np.linalg.norm(clip.offset[moved], axis=1), (frames, 1)), atol=1e-9)


def test_channels_turn_in_their_order_about_axes_already_turned(tmp_path):
    clip = read_bvh(_written(tmp_path, SMALL))
    R, p = joint_frames(clip)
    assert clip.names == ("Hips", "Arm", "Arm_end")
    np.testing.assert_allclose(p[0], [[1, 2, 3], [1, 12, 3], [6, 12, 3]])
    np.testing.assert_allclose(p[1, 1], [2 - 10, 2, 3], atol=1e-12)
    turn = Rotation.from_euler("ZXY", [10, 20, 30], degrees=True).as_matrix()
    np.testing.assert_allclose(R[1, 1], R[1, 0] @ turn, atol=1e-12)
    np.testing.assert_allclose(p[1, 2], p[1, 1] + R[1, 1] @ [5, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("HIERARCHY", "BVH", "line 1: 'BVH' was found; HIERARCHY is wanted"),
        ("JOINT Arm", "JOINT Hips", "line 6: joint 'Hips' is given twice"),
        ("0 10 0", "0 ten 0", "line 8: 'ten' was found; a number is wanted"),
        ("CHANNELS 3 Zrotation Xrotation", "CHANNELS 3 Zrotation Zrotation", "line 9: a channel is given twice"),
        ("CHANNELS 3", "CHANNELS 9", "9 channels; 0 to 6 are wanted"),
        ("CHANNELS 3 Zrotation", "CHANNELS 3 Wrotation", "'Wrotation' was found"),
        ("Frames: 2", "Frames: 3", "18 numbers follow; 3 frames of 9 are wanted"),
        ("Frames: 2", "Frames: 0", "0 frames"),
        ("0.04", "-1", "frame time -1"),
        ("0 0 0 0 0 0 0 0 0\n", "0 0 0 x 0 0 0 0 0\n", "holds a word that is no number"),
        ("0 0 0 0 0 0 0 0 0\n", "0 0 0 nan 0 0 0 0 0\n", "not finite"),
        (SMALL[SMALL.index("ROOT") : SMALL.index("MOTION")], "", "no ROOT comes before MOTION"),
    ],
)
def test_what_is_malformed_is_named_with_its_line(tmp_path, old, new, wanted):
    assert old in SMALL
    with pytest.raises(InputError, match=wanted):
        read_bvh(_written(tmp_path, SMALL.replace(old, new, 1)))


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(0, len(SMALL) - 30), junk=st.sampled_from(["", "}", "ROOT", "1e999", "\x00", "{ {", "End"]))
def test_a_file_cut_anywhere_is_refused_in_one_line(tmp_path_factory, cut, junk):
    path = _written(tmp_path_factory.mktemp("cut"), SMALL[:cut] + junk)
    with pytest.raises(InputError) as error:
        read_bvh(path)
    assert "\n" not in str(error.value) and "clip.bvh" in str(error.value)
