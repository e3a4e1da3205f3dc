"""Motions stay inside limits and speeds, seeds decide every byte, scenes show what they promise."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.camera import project
from handtrack.kinematics import Coupling, FrameRow, Model, forward, link_ends, model_from_rows
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.kinematics.builtin import model_names
from handtrack.pills import Pills
from synth.motion import inside_limits, key_times_path, largest_step, random_keys, walk
from synth.raycast import cast
from synth.scene import Scene, image, images, posed, view, wrong_start
from synth.scenes import NAMES, PINCHED, scene, two_finger_crossing, two_finger_hard
from synth.sensor import Sensor, sense, vignette_gain

SMALL = (160, 120)


def make(name: str, seed: int, frames: int = 20) -> Scene:
    if name == "random":
        return scene(name, seed, builtin_model("full_hand"), frames=frames)
    return scene(name, seed, frames=frames)


@pytest.mark.parametrize("name", NAMES)
def test_every_scene_stays_inside_limits_and_in_the_picture(name: str) -> None:
    made = make(name, 5, 60)
    assert made.name == name and made.truth.shape == (60, len(made.model.joint_names))
    low, high = made.model.limits.T
    assert (made.truth >= low - 1e-12).all() and (made.truth <= high + 1e-12).all()
    assert (made.start >= low).all() and (made.start <= high).all()
    base, tip = link_ends(made.model, forward(made.model, made.truth))
    xy = project(made.camera, np.concatenate([base, tip], axis=1))
    assert (xy > 0).all() and (xy < [made.camera.width, made.camera.height]).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_bytes_in_any_order(name: str) -> None:
    made, again, other = make(name, 5, 4), make(name, 5, 4), make(name, 6, 4)
    forwards = [picture.tobytes() for picture in images(made)]
    assert forwards[::-1] == [image(again, frame).tobytes() for frame in (3, 2, 1, 0)]
    assert image(other, 0).tobytes() != forwards[0]
    assert made.start.tobytes() == again.start.tobytes()


@pytest.mark.parametrize("speed", [0.5, 3.5, 8.0])
def test_the_fastest_joint_reaches_the_speed_and_none_exceeds_it(speed: float) -> None:
    for seed in range(5):
        step = math.degrees(largest_step(two_finger_crossing(seed, max_speed=speed).truth))
        assert step == pytest.approx(speed, rel=1e-9) and step <= speed * (1 + 1e-12)


def visible_shares(made: Scene, frame: int) -> list[float]:
    """Share of what a middle-finger link would show without the index finger."""
    pills = posed(made, frame)
    middle = Pills(pills.base[:3], pills.tip[:3], pills.radius[:3])
    alone, part = cast(middle, made.camera).part, cast(pills, made.camera).part
    return [float((part == k).sum() / (alone == k).sum()) for k in range(3)]


def test_the_index_finger_hides_half_of_the_middle_finger_but_never_a_whole_link() -> None:
    for seed in range(6):
        made = two_finger_crossing(seed, size=(320, 240), scale=1.6)
        most_hidden = np.array([min(visible_shares(made, frame)) for frame in range(0, 60, 3)])
        assert most_hidden.min() < 0.55 and most_hidden.max() > 0.8 and most_hidden.min() > 0.0


def test_the_crossing_looks_as_the_thesis_says() -> None:
    made = two_finger_crossing(1)
    pills = posed(made, 0)
    assert (pills.tip[[2, 5], 0] > pills.base[[0, 3], 0] + 60).all()  # fingers point to the right
    assert pills.base[3, 2] < pills.base[0, 2]  # the index finger is nearer
    assert (made.camera.R @ [1.0, 0.0, 0.0])[1] == pytest.approx(math.sin(math.pi / 4))  # tilted about image x
    grey = image(made, 0)
    fingers = grey[cast(pills, made.camera).part >= 0]
    assert 100 < np.median(fingers) < 200 and np.quantile(fingers, 0.99) < 235
    assert np.median(grey) == 5.0


def test_the_hard_variant_starts_wrong_by_three_degrees_and_shows_the_same_size() -> None:
    hard, plain = two_finger_hard(4), two_finger_crossing(4)
    np.testing.assert_allclose(np.abs(np.degrees(hard.start - hard.truth[0])), 3.0)
    np.testing.assert_array_equal(plain.start, plain.truth[0])
    assert hard.camera.kind == "perspective" and hard.sensor.noise == 6.0
    assert hard.camera.fx / posed(hard, 0).base[[0, 3], 2].mean() == pytest.approx(plain.camera.fx, rel=1e-6)


def test_a_wrong_start_turns_back_at_the_limits() -> None:
    model = builtin_model("two_finger")
    for seed in range(8):
        start = wrong_start(model, model.limits[:, 0].copy(), 3.0, seed)
        np.testing.assert_allclose(np.degrees(start - model.limits[:, 0]), 3.0)


def test_pinching_tips_touch() -> None:
    model = builtin_model("index_thumb")
    _, tip = link_ends(model, forward(model, np.radians(PINCHED)))
    gap = np.linalg.norm(tip[:, 2] - tip[:, 5], axis=1) - model.link_radius[2, 1] - model.link_radius[5, 1]
    assert (np.abs(gap - 0.3) < 0.15).all()


def test_the_spread_hand_keeps_its_thumb_and_grades_the_flexion() -> None:
    made = make("full-hand-spread", 2, 80)
    names = made.model.joint_names
    thumb = [i for i, name in enumerate(names) if name.startswith("thumb")]
    assert np.ptp(made.truth[:, thumb], axis=0).max() == 0.0
    last = dict(zip(names, np.degrees(made.truth[-1]), strict=True))
    mcp = [last[f"{finger}_mcp"] for finger in ("little", "ring", "middle", "index")]
    assert mcp[0] < -15 and (np.diff(mcp) > 0).all()


@pytest.mark.parametrize("name", model_names())
def test_any_built_in_model_moves_at_random(name: str) -> None:
    made = scene("random", 1, builtin_model(name), frames=10, projection="perspective")
    assert largest_step(made.truth) > 0
    assert (cast(posed(made, 9), made.camera).part >= 0).sum() > 100


def test_scenes_are_asked_for_by_name() -> None:
    with pytest.raises(ValueError, match=r"name: 'wave' is no scene; there are two-finger-crossing"):
        scene("wave", 1)
    with pytest.raises(ValueError, match=r"model: scene 'random' wants a model"):
        scene("random", 1)
    with pytest.raises(ValueError, match=r"model: scene 'two-finger-hard' has its own model"):
        scene("two-finger-hard", 1, builtin_model("index"))
    with pytest.raises(ValueError, match=r"projection: 'fisheye' is unknown"):
        view("fisheye", SMALL, 1.0, (0.0, 0.0), np.eye(3), np.zeros(3))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 8), st.integers(1, 40), st.floats(0.1, 30.0))
def test_a_walk_never_leaves_the_range_of_its_keys_nor_its_speed(
    seed: int, keys: int, frames: int, speed: float
) -> None:
    poses = np.random.default_rng(seed).uniform(-1.0, 1.0, (keys, 3))
    q = walk(poses, frames, speed)
    assert q.shape == (frames, 3)
    assert (q <= poses.max(axis=0) + 1e-12).all() and (q >= poses.min(axis=0) - 1e-12).all()
    assert math.degrees(largest_step(q)) <= speed * (1 + 1e-12)
    np.testing.assert_allclose(q[0], poses[0])


def test_the_path_goes_through_its_keys() -> None:
    keys, times = np.random.default_rng(0).normal(size=(5, 2)), np.array([0.0, 1.0, 1.5, 4.0, 9.0])
    np.testing.assert_allclose(key_times_path(keys, times, times), keys, atol=1e-14)
    with pytest.raises(ValueError, match=r"times: .* must rise strictly"):
        key_times_path(keys, times[::-1], times)
    with pytest.raises(ValueError, match=r"at: 0.0 to 10.0 leaves the path's times 0.0 to 9.0"):
        key_times_path(keys, times, np.array([0.0, 10.0]))


def test_bad_walks_are_named() -> None:
    keys = np.zeros((2, 1))
    with pytest.raises(ValueError, match=r"frames: 0; wanted at least 1"):
        walk(keys, 0, 1.0)
    with pytest.raises(ValueError, match=r"max_speed: nan degrees a frame"):
        walk(keys, 3, math.nan)


def coupled_model() -> Model:
    rows = [
        FrameRow(1, 0, joint="a", limits=(-1.0, 1.0), link_length=5.0, link_radius=(1.0, 1.0)),
        FrameRow(2, 1, a=5.0, joint="b", link_length=5.0, link_radius=(1.0, 1.0)),
        FrameRow(3, 2, a=5.0, joint="s", prismatic=True, link_length=5.0, link_radius=(1.0, 1.0)),
    ]
    return model_from_rows("coupled", rows, [Coupling("b", "a", 0.5)])


def test_random_keys_obey_limits_couplings_and_widths() -> None:
    model = coupled_model()
    q = random_keys(model, np.random.default_rng(0), 400, width=40.0)
    assert np.abs(q[:, 0]).max() <= math.radians(20.0)
    np.testing.assert_allclose(q[:, 1], 0.5 * q[:, 0])
    assert 15.0 < np.abs(q[:, 2]).max() <= 20.0  # a sliding joint roams in model units
    np.testing.assert_allclose(inside_limits(model, np.array([3.0, 9.0, 1.0])), [1.0, 0.5, 1.0])


def test_noise_has_the_spread_asked_for() -> None:
    flat = np.full((300, 400), 100.0, dtype=np.float32)
    noisy = sense(flat, Sensor(noise=3.0, quantise=False), np.random.default_rng(1))
    assert noisy.dtype == np.float32
    assert noisy.std() == pytest.approx(3.0, rel=0.01) and noisy.mean() == pytest.approx(100.0, abs=0.03)
    assert np.corrcoef(noisy[:, 1:].ravel(), noisy[:, :-1].ravel())[0, 1] == pytest.approx(0.0, abs=0.01)
    rounded = sense(flat * 2.55, Sensor(noise=3.0), np.random.default_rng(1))
    assert (rounded == np.rint(rounded)).all() and rounded.max() == 255.0
    assert (sense(flat, Sensor(), np.random.default_rng(1)) == flat).all()


def test_vignette_darkens_the_corners_of_grey_and_colour() -> None:
    gain = vignette_gain(61, 81, 0.4)
    assert gain[30, 40] == 1.0 and gain[0, 0] == pytest.approx(0.6) and gain[30, 0] > 0.7
    colour = np.full((61, 81, 3), 200.0, dtype=np.float32)
    dark = sense(colour, Sensor(vignette=0.4, quantise=False), np.random.default_rng(0))
    np.testing.assert_allclose(dark[..., 1], 200.0 * gain, rtol=1e-6)
    with pytest.raises(ValueError, match=r"sensor: noise -1.0 must be >= 0"):
        sense(colour, Sensor(noise=-1.0), np.random.default_rng(0))
