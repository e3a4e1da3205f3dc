"""Templates and windows: what each sampler should see, checked with rays and with images from the renderer."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.appearance import Appearance, learn
from handtrack.camera import Camera, orthographic, perspective, rays
from handtrack.kinematics import forward
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.pills import Pills, pose_pills, ray_hits
from handtrack.profiles import SIDE, Samplers, place_outline, sample, with_rays
from handtrack.templates import EXPECTED, HIDDEN, JOINT, MARGIN, Templates, expect, expect_numpy, positions
from synth.render import render
from synth.scenes import Scene, clean_image, posed, two_finger_crossing
from synth.shading import Light, Material

EYE, ZERO = np.eye(3), np.zeros(3)
FINGERS = builtin_model("two_finger").link_finger
TIPS = builtin_model("two_finger").link_is_tip


def plain(links: int, level: float = 200.0, background: float = 10.0) -> Appearance:
    """A surface of one grey level."""
    shading = np.zeros(28)
    shading[0] = level
    return Appearance(shading, np.ones(links), background, 1.0, 0.5, 1.0, np.zeros((26, 26)), np.zeros(26))


def random_appearance(rng: np.random.Generator, links: int) -> Appearance:
    return replace(plain(links), shading=rng.normal(0, 30, 28), gain=rng.uniform(0.7, 1.3, links))


def crossing(seed: int, projection: str = "orthographic") -> Scene:
    return two_finger_crossing(seed, frames=40, projection=projection, max_speed=6.0)


def hit_groups(
    pills: Pills, camera: Camera, samplers: Samplers, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finger (-1: background), depth and pill that the ray at each position u sees."""
    xy = samplers.origin[:, None] + u[None, :, None] * samplers.direction[:, None]
    hits = ray_hits(pills, *rays(camera, xy.reshape(-1, 2)))
    finger = np.where(hits.pill >= 0, FINGERS[hits.pill], -1)
    shape = xy.shape[:2]
    return finger.reshape(shape), hits.t.reshape(shape), hits.pill.reshape(shape)


def outline(clip: Scene, frame: int) -> tuple[Pills, Samplers]:
    pills = posed(clip, frame)
    return pills, place_outline(pills, clip.camera, clip.model.link_is_tip)


CASES = [
    (seed, projection, frame)
    for seed in (0, 1)
    for projection in ("orthographic", "perspective")
    for frame in (0, 12, 33)
]
cases = pytest.mark.parametrize(("seed", "projection", "frame"), CASES)


def same(a: Templates, b: Templates) -> None:
    np.testing.assert_array_equal(a.u, b.u)
    np.testing.assert_array_equal(a.state, b.state)
    np.testing.assert_array_equal(a.visible, b.visible)
    np.testing.assert_allclose(a.values, b.values, atol=1e-8)
    np.testing.assert_allclose(a.parts, b.parts, atol=1e-9)


@pytest.mark.parametrize("name", ["two_finger", "full_hand", "index_thumb"])
@pytest.mark.parametrize("kind", ["orthographic", "perspective"])
def test_kernel_and_numpy_twin_expect_the_same(name, kind):
    model, rng = builtin_model(name), np.random.default_rng(0)
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    R *= np.linalg.det(R)
    states = set()
    for step, bent in ((0.5, 0.0), (1.0, 0.1), (0.5, 0.1), (0.5, 0.0)):
        t = np.array([0.0, 0.0, 400.0]) - R @ [0.0, 60.0, 0.0]
        camera = orthographic(640, 480, 2.5, 320.0, 240.0, R, t)
        if kind == "perspective":
            camera = perspective(
                640, 480, 900.0, 910.0, 320.0, 240.0, R, t, bent * np.array([1.0, -1.0, 0.01, -0.02, 0.1])
            )
        low, high = model.limits.T
        pills = pose_pills(model, forward(model, rng.uniform(low, high)), camera)
        samplers = place_outline(pills, camera, model.link_is_tip)
        look = random_appearance(rng, model.link_frame.size)
        arguments = (samplers, pills, model.link_finger, camera, look, 14.0, 8.0, step)
        found = expect(*arguments)
        same(found, expect_numpy(*arguments))
        states |= set(found.state)
        R = R @ R
    assert EXPECTED in states and HIDDEN in states


@cases
def test_kernel_and_numpy_twin_agree_on_crossing_fingers(seed, projection, frame):
    clip = crossing(seed, projection)
    pills, samplers = outline(clip, frame)
    known = learn(clean_image(clip, 0), posed(clip, 0), clip.camera)
    arguments = (samplers, pills, clip.model.link_finger, clip.camera, known)
    same(expect(*arguments), expect_numpy(*arguments))


def test_hidden_is_where_another_finger_is_in_front():
    seen = set()
    for seed, projection, frame in CASES:
        clip = crossing(seed, projection)
        pills, samplers = outline(clip, frame)
        state = expect(samplers, pills, FINGERS, clip.camera, plain(6)).state
        own = FINGERS[samplers.link]
        (inner, outer), depth, _ = (
            np.moveaxis(x, 1, 0) for x in hit_groups(pills, clip.camera, samplers, np.array([-0.75, 0.75]))
        )
        covered = (inner != own) | ((outer >= 0) & (outer != own) & (depth[1] < depth[0]))
        np.testing.assert_array_equal(state == HIDDEN, covered)
        front = samplers.contact[:, 2] - depth.min(axis=0)
        assert (front[state == HIDDEN] > 0).all(), "something is nearer than the contact point"
        seen |= set(state)
    assert seen == {EXPECTED, HIDDEN, JOINT}


def straight_finger(camera: Camera) -> tuple[Pills, Samplers]:
    """Three links in a row, each 2 mm thinner than the one before: its start is inside the thicker one's cap."""
    base = np.array([[0.0, 0.0, 300.0], [40.0, 0.0, 300.0], [70.0, 0.0, 300.0]])
    tip = np.array([[40.0, 0.0, 300.0], [70.0, 0.0, 300.0], [90.0, 0.0, 300.0]])
    pills = Pills(base, tip, np.array([[10.0, 10.0], [8.0, 8.0], [6.0, 6.0]]))
    return pills, place_outline(pills, camera, np.array([False, False, True]), spacing=2.0, most=40)


def test_no_edge_is_expected_at_knuckles():
    camera = orthographic(400, 100, 3.0, 50.0, 50.0, EYE, ZERO)
    pills, samplers = straight_finger(camera)
    state = expect(samplers, pills, np.zeros(3, dtype=int), camera, plain(3)).state
    for link in (1, 2):
        reach = np.sqrt(
            pills.radius[link - 1, 1] ** 2 - pills.radius[link, 0] ** 2
        )  # of the thicker cap over this side
        x = samplers.contact[:, 0] - pills.base[link, 0]
        chosen = (samplers.link == link) & (samplers.kind == SIDE)
        assert (state[chosen & (x < reach - 0.5)] == JOINT).all() and (chosen & (x < reach - 0.5)).any()
        assert (state[chosen & (x > reach + 0.5)] == EXPECTED).all()
    assert (state[samplers.link == 0] == EXPECTED).all() and HIDDEN not in state


@pytest.mark.parametrize(("ahead", "state"), [(40.0, EXPECTED), (2.0, JOINT)])
def test_a_link_over_its_own_finger_shows_an_edge_only_with_a_depth_step(ahead, state):
    camera = orthographic(200, 100, 1.0, 100.0, 50.0, EYE, ZERO)
    ends = np.array([[-40.0, 0.0, 300.0], [40.0, 0.0, 300.0]])
    over = np.array([[0.0, 0.0, 300.0 - ahead - 20.0], [1.0, 0.0, 300.0 - ahead - 20.0]])
    pills = Pills(np.stack([ends[0], over[0]]), np.stack([ends[1], over[1]]), np.array([[20.0, 20.0], [5.0, 5.0]]))
    samplers = place_outline(pills, camera, np.array([False, True]), fan=np.array([0.0]))
    found = expect(samplers, pills, np.zeros(2, dtype=int), camera, plain(2))
    top = (samplers.link == 1) & (samplers.kind != SIDE)
    wanted = state if ahead > 20 else EXPECTED  # 15 mm lie between the ball's rim and the tube below
    assert found.state[top].tolist() == [wanted]


@cases
def test_windows_hold_one_surface_on_either_side_of_the_edge(seed, projection, frame):
    clip = crossing(seed, projection)
    pills, samplers = outline(clip, frame)
    found = expect(samplers, pills, FINGERS, clip.camera, plain(6))
    group, depth, _ = hit_groups(pills, clip.camera, samplers, found.u)
    own = FINGERS[samplers.link][:, None]
    away = np.abs(found.u) > 0.5  # the two samples next to the edge blend both sides
    inwards, outwards = found.visible & (found.u < 0) & away, found.visible & (found.u > 0) & away
    assert (group == own)[inwards].all()
    beyond = group[:, [int(np.searchsorted(found.u, 0.0)) + 1]]
    assert (group == beyond)[outwards].all()
    assert not found.visible[found.state != EXPECTED].any()
    jump = np.abs(np.diff(np.where(inwards, depth, 0.0), axis=1))
    assert jump[inwards[:, 1:] & inwards[:, :-1]].max() < 5.0, "no step in depth within the own finger's window"


@cases
def test_windows_keep_a_margin_from_the_next_surface(seed, projection, frame):
    clip = crossing(seed, projection)
    pills, samplers = outline(clip, frame)
    found = expect(samplers, pills, FINGERS, clip.camera, plain(6))
    group, _, _ = hit_groups(pills, clip.camera, samplers, found.u)
    edge = int(np.searchsorted(found.u, 0.0))
    for row in np.flatnonzero(found.state == EXPECTED):
        change = np.flatnonzero(group[row, edge + 1 :] != group[row, edge + 1])
        if change.size:  # the next surface begins between this sample and the one before
            beyond = found.u[edge + 1 + change[0]]
            room = beyond - found.u[found.visible[row]].max()
            assert room >= min(MARGIN, beyond - found.u[edge + 1]), "less only where the edge itself needs the sample"


def test_an_unoccluded_pill_is_seen_in_the_whole_window():
    camera = perspective(320, 240, 500.0, 500.0, 160.0, 120.0, EYE, ZERO)
    pills = Pills(np.array([[-20.0, 0.0, 300.0]]), np.array([[30.0, 5.0, 310.0]]), np.array([[11.0, 10.0]]))
    samplers = place_outline(pills, camera, np.array([True]))
    found = expect(samplers, pills, np.array([0]), camera, plain(1))
    assert (found.state == EXPECTED).all() and found.visible.all()
    assert found.u[0] == -11.75 and found.u[-1] == 5.75
    np.testing.assert_allclose(found.values[:, found.u < -2], 200.0, atol=1e-9)
    np.testing.assert_allclose(found.values[:, found.u > 2], 10.0, atol=1e-9)
    np.testing.assert_allclose(found.parts[:, 0, found.u < -2], 1.0, atol=1e-9)
    np.testing.assert_allclose(found.parts[:, 0, found.u > 2], 0.0, atol=1e-9)
    facing = found.parts[:, 1] / np.maximum(found.parts[:, 0], 1e-9)
    assert (facing[:, found.u < -2] > 0.3).all() and (facing[:, 0] > facing[:, 14]).all(), "the rim looks away"


@pytest.mark.parametrize(("step", "tolerance"), [(0.5, 0.03), (1.0, 0.08)])
def test_the_edge_of_a_template_is_blurred_like_an_image(step, tolerance):
    camera = perspective(320, 240, 500.0, 500.0, 160.0, 120.0, EYE, ZERO)
    pills = Pills(np.array([[-20.0, -3.0, 300.0]]), np.array([[30.0, 8.0, 310.0]]), np.array([[12.0, 10.0]]))
    image = render(
        pills, camera, Material(np.full((1, 3), 200.0)), Light(np.array([0.0, 0.0, -1.0])), "binary", background=10.0
    )
    samplers = place_outline(pills, camera, np.array([True]), spacing=1.5, most=60)
    found = expect(samplers, pills, np.array([0]), camera, plain(1), step=step)
    difference = sample(image, samplers, found.u).values - found.values
    assert np.abs(difference.mean(axis=0)).max() < tolerance * 190
    assert np.sqrt(np.mean(difference**2)) < 0.04 * 190


@cases
def test_templates_look_like_the_image_they_stand_for(seed, projection, frame):
    clip = crossing(seed, projection)
    known = None
    for before in range(max(frame - 2, 0), frame + 1):
        known = learn(clean_image(clip, before), posed(clip, before), clip.camera, known)
    assert known is not None
    pills, samplers = outline(clip, frame)
    found = expect(samplers, pills, FINGERS, clip.camera, known)
    seen = sample(clean_image(clip, frame), samplers, found.u)
    both = found.visible & seen.inside
    assert np.median(np.abs(seen.values - found.values)[both]) < 5.0
    assert np.percentile(np.abs(seen.values - found.values)[both], 95) < 0.15 * 175


@given(st.integers(1, 40), st.integers(1, 40), st.sampled_from([0.25, 0.5, 1.0]))
@settings(deadline=None)
def test_positions_put_the_edge_between_two_samples(inwards, outwards, step):
    u = positions(inwards * step, outwards * step, step)
    np.testing.assert_allclose(np.diff(u), step)
    assert u.size == inwards + outwards and (u < 0).sum() == inwards
    np.testing.assert_allclose(np.abs(u).min(), step / 2)


def test_no_samplers_give_no_templates():
    pills = Pills(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)))
    camera, none = orthographic(20, 20, 1.0, 10.0, 10.0, EYE, ZERO), np.zeros(0, dtype=int)
    samplers = with_rays(camera, np.zeros((0, 2)), np.zeros((0, 2)), none, np.zeros(0), none, none, np.zeros((0, 3)))
    found = expect(samplers, pills, none, camera, plain(0))
    assert found.values.shape == (0, 36) and found.state.size == 0
