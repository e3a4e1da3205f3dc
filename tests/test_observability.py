"""What the images alone can tell: open directions, their names, their stretches, and the report's section."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.ambiguity import ambiguity
from handtrack.ambiguity import as_data as folds_as_data
from handtrack.ambiguity import lines as fold_lines
from handtrack.camera import orthographic
from handtrack.kinematics import Coupling, FrameRow, Model, model_from_rows
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.measure import posed
from handtrack.observability import UNKNOWN, directions, observability, varimax
from handtrack.observability_words import as_data, grouped, lines, named
from handtrack.profiles import place_outline
from handtrack.report.observability import heat_map, observability_section
from handtrack.residuals import OutlineFeatures, chain, in_world, outline_residuals
from handtrack.track import Track

SURE = 1.0 / math.radians(0.1) ** 2
EDGE_ON = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # fingers bend towards the camera


def track_of(model: Model, information: np.ndarray, first_frame: int = 0) -> Track:
    n, j = information.shape[0], len(model.joint_names)
    return Track(
        joint_names=model.joint_names,
        frame=first_frame + np.arange(n),
        time=np.arange(n) / 25.0,
        q=np.zeros((n, j)),
        sigma=np.full((n, j), 0.01),
        covariance=np.tile(1e-4 * np.eye(j), (n, 1, 1)),
        information=information,
        status=np.array(["tracked"] * n),
        confidence=np.ones(n),
        residual=np.zeros(n),
        visible=np.ones((n, model.link_frame.size)),
        edges=np.full(n, 80),
        seconds=np.full(n, 0.003),
    )


def sure(model: Model, frames: int = 10) -> np.ndarray:
    return np.tile(SURE * np.eye(model.free.size), (frames, 1, 1))


def image_information(model: Model, R: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Of an outline whose edges are sure to a tenth of a pixel."""
    on = chain(model, orthographic(640, 480, 3.2, 320.0, 240.0, R, np.zeros(3)))
    at = place_outline(posed(on, u), on.camera, model.link_is_tip)
    edges = OutlineFeatures(*in_world(on.camera, at.ray, at.slope), at.link, np.full(at.link.size, 0.1))
    J = outline_residuals(on, edges, u)[1]
    return J.T @ J


def sliding_model(unit: float = 1.0, name: str = "mm") -> Model:
    rows = [
        FrameRow(1, 0, joint="slide", prismatic=True, link_length=40.0 * unit, link_radius=(9.0 * unit, 9.0 * unit)),
        FrameRow(2, 1, a=40.0 * unit, joint="turn", link_length=40.0 * unit, link_radius=(8.0 * unit, 8.0 * unit)),
    ]
    return model_from_rows("sliding", rows, units=name)


def test_joints_that_only_show_in_sum_are_one_direction_with_opposite_weights():
    model = builtin_model("index")
    J = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    seen = observability(track_of(model, np.tile(SURE * J.T @ J, (12, 1, 1)), first_frame=30), model)
    assert seen.count.tolist() == [12] and (seen.first[0], seen.last[0]) == (30, 41)
    assert dict(named(seen, seen.direction[0])) == {"index_mcp": 0.71, "index_pip": -0.71}
    assert lines(seen) == (
        "index_mcp 0.71, index_pip -0.71: the view cannot tell them apart; sigma over 54 deg, frames 30-41",
    )


def test_a_hidden_finger_is_named_joint_by_joint_and_said_in_one_sentence():
    model = builtin_model("full_hand")
    information = sure(model, 20)
    hidden = [model.joint_names.index(f"index_{part}") for part in ("abduction", "mcp", "pip", "dip")]
    information[5:15, hidden, hidden] = 0.0
    seen = observability(track_of(model, information), model)
    assert seen.unseen.all() and seen.count.tolist() == [10] * 4
    assert lines(seen) == (
        "index_abduction, index_mcp, index_pip, index_dip: not seen; sigma over 54 deg, frames 5-14",
    )
    assert (seen.sigma[5:15, hidden] > math.radians(50)).all() and (seen.sigma[:5] < math.radians(0.2)).all()


def test_a_lost_frame_leaves_every_joint_open():
    model = builtin_model("index")
    information = sure(model)
    information[3:7] = 0.0
    seen = observability(track_of(model, information), model)
    assert lines(seen) == ("every joint: not seen; sigma over 54 deg, frames 3-6",)
    assert np.allclose(seen.sigma[3:7], UNKNOWN)


def test_a_chain_that_is_seen_well_has_one_line_and_its_weakest_direction():
    model = builtin_model("two_finger")
    information = sure(model)
    information[4, 2, 2] = 1.0 / math.radians(2.0) ** 2
    seen = observability(track_of(model, information), model)
    assert not seen.count.size and len(lines(seen)) == 1
    assert lines(seen)[0].endswith("in every frame; the weakest direction is middle_dip (sigma 2.0 deg, frame 4).")
    information[4, 2, 2] = 0.0
    assert "but for single frames" in lines(observability(track_of(model, information), model))[0]


def test_a_finding_bridges_short_gaps_but_not_long_ones_and_forgets_its_sign():
    model = builtin_model("index")
    information = sure(model, 30)
    for frame in [*range(2, 8), *range(10, 14), *range(20, 25)]:
        J = (-1.0) ** frame * np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        information[frame] = SURE * J.T @ J
    seen = observability(track_of(model, information), model)
    assert list(zip(seen.first.tolist(), seen.last.tolist(), seen.count.tolist(), strict=True)) == [
        (2, 13, 10),
        (20, 24, 5),
    ]


def test_two_directions_of_different_sigma_stay_two():
    pairs = np.kron(np.eye(2), np.array([[1.0, 1.0], [1.0, -1.0]]) / math.sqrt(2.0))
    weak = [1.0 / math.radians(angle) ** 2 for angle in (6.0, 30.0)]
    A = pairs @ np.diag([SURE, weak[0], SURE, weak[1]]) @ pairs.T
    found, sigma, unseen = directions(A, math.radians(5.0))
    assert np.degrees(sigma).round().tolist() == [6.0, 27.0] and not unseen.any()
    assert np.abs(found).round(2).tolist() == [[0.71, 0.71, 0.0, 0.0], [0.0, 0.0, 0.71, 0.71]]


def test_units_of_length_do_not_matter():
    texts, weights = [], []
    for unit, name in ((1.0, "mm"), (0.001, "m")):
        model = sliding_model(unit, name)
        J = np.array([[1.0 / unit, 40.0]])  # the slide and the turn move the tip alike
        seen = observability(track_of(model, np.tile(1e4 * J.T @ J, (5, 1, 1))), model)
        weights.append(seen.direction[0])
        texts.append(json.loads(json.dumps(as_data(seen)))["directions"][0])
        assert seen.sigma[0, 0] == pytest.approx(UNKNOWN * 40.0 * unit / math.sqrt(2.0), rel=0.01)
    np.testing.assert_allclose(weights[0], weights[1], atol=1e-9)
    assert weights[0] == pytest.approx([math.sqrt(0.5), -math.sqrt(0.5)], abs=0.01)
    assert {text["unit"] for text in texts} <= {"mm", "m", "deg"}


def test_an_unseen_slide_is_told_in_units_of_length():
    model = sliding_model()
    information = np.tile(np.diag([1.0 / 12.0**2, SURE]), (6, 1, 1))
    seen = observability(track_of(model, information), model)
    assert lines(seen) == ("slide: not seen; sigma 12 mm, frames 0-5",)
    assert json.loads(json.dumps(as_data(seen)))["median_sigma"]["slide"] == pytest.approx(11.5, abs=0.5)
    assert "12 mm" in observability_section(track_of(model, information), model)


def test_a_coupled_joint_shares_the_sigma_of_the_one_it_follows():
    rows = [
        FrameRow(1, 0, joint="pip", link_length=30.0, link_radius=(8.0, 8.0)),
        FrameRow(2, 1, a=30.0, joint="dip", link_length=20.0, link_radius=(7.0, 7.0)),
    ]
    model = model_from_rows("coupled", rows, [Coupling("dip", "pip", 0.5)])
    seen = observability(track_of(model, np.full((4, 1, 1), 1.0 / math.radians(8.0) ** 2)), model)
    np.testing.assert_allclose(seen.sigma[:, 1], 0.5 * seen.sigma[:, 0])
    assert named(seen, seen.direction[0]) == (("pip", 1.0),)


def test_a_finger_seen_edge_on_hides_its_joints_and_one_seen_from_the_side_does_not():
    model, u = builtin_model("index"), np.zeros(3)
    flat = image_information(model, np.eye(3), u)
    deep = image_information(model, EDGE_ON, u)
    assert not directions(flat, math.radians(5.0))[0].size
    found, _, unseen = directions(deep, math.radians(5.0))
    assert unseen.all() and np.array_equal(found, np.eye(3))


def test_a_link_that_points_at_an_orthographic_camera_gives_finite_sigmas():
    model = builtin_model("index")
    ahead = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    A = image_information(model, ahead, np.zeros(3))
    seen = observability(track_of(model, np.tile(A, (4, 1, 1))), model)
    assert np.isfinite(seen.sigma).all() and (seen.sigma <= UNKNOWN * (1.0 + 1e-9)).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(0, 4))
def test_directions_are_unit_vectors_that_span_what_the_threshold_says(seed, rank, extra):
    rng = np.random.default_rng(seed)
    k = rank + extra
    J = rng.normal(size=(rank, k)) * 200.0
    found, sigma, unseen = directions(J.T @ J, math.radians(5.0))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-9)
    assert (sigma > 0.0).all() and unseen.size == sigma.size
    if extra:
        null = np.linalg.svd(J)[2][rank:]
        left = null - null @ np.linalg.pinv(found) @ found
        assert np.linalg.norm(left, axis=1).max() * UNKNOWN <= math.radians(5.0) * 1.01


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_varimax_keeps_the_space_and_finds_sparse_vectors(seed, m):
    rng = np.random.default_rng(seed)
    sparse = np.kron(np.eye(m), np.array([[0.8], [-0.6]]))
    basis = sparse @ np.linalg.qr(rng.normal(size=(m, m)))[0]
    turned = varimax(basis)
    np.testing.assert_allclose(turned @ turned.T, basis @ basis.T, atol=1e-9)
    np.testing.assert_allclose(np.abs(sparse.T @ turned).max(axis=0), 1.0, atol=1e-3)


def test_bad_input_is_named():
    model = builtin_model("index")
    track = track_of(model, sure(model))
    empty = track_of(model, sure(model, 0))
    with pytest.raises(ValueError, match=r"track: has no frames"):
        observability(empty, model)
    with pytest.raises(ValueError, match=r"information has the shape \(10, 2, 2\); \(frames, 3, 3\)"):
        observability(replace(track, information=track.information[:, :2, :2]), model)
    with pytest.raises(ValueError, match=r"threshold: got 2.0"):
        observability(track, model, 2.0)


def test_findings_are_plain_data():
    model = builtin_model("full_hand")
    information = sure(model, 12)
    information[2:9] = 0.0
    data = as_data(observability(track_of(model, information), model))
    again = json.loads(json.dumps(data, allow_nan=False))
    assert again["threshold"] == 5.0 and len(again["directions"]) == 21
    assert again["directions"][0]["frames"] == 7 and again["directions"][0]["unit"] == "deg"
    assert set(again["median_sigma"]) == set(model.joint_names)


def test_the_section_names_directions_and_folds_and_escapes_names():
    rows = [FrameRow(1, 0, joint="a", link_length=30.0, link_radius=(8.0, 8.0))]
    model = replace(model_from_rows("one", rows), joint_names=("<a>",))
    track = track_of(model, np.zeros((5, 1, 1)))
    track = replace(track, rival=np.full((5, 1), 0.3), rival_weight=np.linspace(0.1, 0.4, 5))
    text = observability_section(track, model)
    assert "<b>&lt;a&gt;</b> not seen" in text and "&lt;a&gt;</b> +17.2 deg" in text and "0.40" in text
    assert "<a>" not in text
    assert "fix every joint" in observability_section(track_of(model, SURE * np.ones((5, 1, 1))), model)


def test_weak_directions_and_long_lists_are_shown_in_the_section():
    model = builtin_model("index")
    J = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    apart = np.tile(SURE * J.T @ J, (5, 1, 1))
    assert "<b>index_mcp</b> +0.71, <b>index_pip</b> \N{MINUS SIGN}0.71" in observability_section(
        track_of(model, apart), model
    )
    weak = np.array([[SURE, 0.0, 0.0], [0.0, 1000.0, 126.0], [0.0, 126.0, 186.0]])
    seen = observability(track_of(model, np.tile(weak, (5, 1, 1))), model, math.radians(4.3))
    assert lines(seen)[0].startswith("index_dip: the view hardly shows it; sigma 4.4 deg")
    hand = builtin_model("full_hand")
    information = sure(hand, 140)
    for joint in range(21):
        information[6 * joint : 6 * joint + 4, joint, joint] = 0.0
    track = track_of(hand, information)
    assert "and 7 shorter ones" in observability_section(track, hand)
    assert len(grouped(observability(track, hand))) == 21


def test_the_heat_map_keeps_the_worst_frame_of_a_long_stretch():
    model = builtin_model("index")
    information = sure(model, 2000)
    information[1234, 1, 1] = 0.0
    seen = observability(track_of(model, information), model)
    text = heat_map(seen, model)
    assert re.findall(r'class="h(\d)" d="', text) == ["5"]
    assert 'viewBox="0 0 300 30"' in text


def test_stretches_with_a_second_pose_are_named():
    model = builtin_model("index")
    track = track_of(model, sure(model, 30))
    assert fold_lines(ambiguity(track, model)) == ()
    rival, weight = np.full((30, 3), np.nan), np.zeros(30)
    rival[4:9] = np.radians([-12.0, 20.0, 1.0])
    rival[6, 1] = math.radians(24.0)
    rival[20] = np.radians([0.0, 0.0, 5.5])
    rival[25] = np.radians([0.0, 0.0, 4.0])  # too near to be told
    weight[4:9] = 0.3
    seen = ambiguity(replace(track, rival=rival, rival_weight=weight), model)
    assert fold_lines(seen) == (
        "index_pip +24.0 deg, index_mcp -12.0 deg: folded it looks the same; weight up to 0.30, frames 4-8",
        "index_dip +5.5 deg: folded it looks the same; weight up to 0.00, frame 20",
    )
    assert json.loads(json.dumps(folds_as_data(seen)))[0]["joints"] == {"index_pip": 24.0, "index_mcp": -12.0}


def test_a_sliding_joint_of_a_second_pose_is_told_in_its_unit():
    model = sliding_model()
    track = track_of(model, sure(model, 5))
    rival = np.tile([10.0, 0.0], (5, 1))
    seen = ambiguity(replace(track, rival=rival, rival_weight=np.full(5, 0.5)), model)
    assert fold_lines(seen) == ("slide +10.0 mm: folded it looks the same; weight up to 0.50, frames 0-4",)
