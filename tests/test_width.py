"""Width of a link from the edges of both its sides: exact where the edges are, honest where they are not."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handtrack.camera import Camera, orthographic, perspective, rays
from handtrack.edges import FLAT, FOUND, EdgePoints
from handtrack.formats.widths import COLUMNS, link_names, widths_text, write_widths
from handtrack.kinematics import FrameRow, model_from_rows
from handtrack.kinematics.builtin import model as builtin_model
from handtrack.measure import Look
from handtrack.pills import Pills, clearance
from handtrack.profiles import Profiles, place_across, place_outline
from handtrack.residuals import OutlineFeatures
from handtrack.templates import Templates
from handtrack.track import Track
from handtrack.tracker import track
from handtrack.width import (
    LinkWidths,
    ProfileWidths,
    constant_gain,
    filter_widths,
    link_widths,
    link_widths_numpy,
    measured_radii,
    opposite_edges,
    opposite_edges_numpy,
    profile_widths,
    profile_widths_numpy,
    widths_in_views,
)

AXES, NOWHERE = np.eye(3), np.zeros(3)
CAMERAS = {
    "orthographic": orthographic(640, 480, 3.0, 320.0, 240.0, AXES, NOWHERE),
    "perspective": perspective(640, 480, 900.0, 900.0, 320.0, 240.0, AXES, NOWHERE),
    "bent": perspective(640, 480, 900.0, 880.0, 320.0, 240.0, AXES, NOWHERE, np.array([-0.1, 0.02, 1e-3, 0.0, 0.0])),
}


def pill(r0: float, r1: float, tilt: float = 0.0, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Pills:
    """A link of 46 mm in front of the camera that leaves the image plane by `tilt` degrees."""
    base = np.array([[-15.0, 6.0, 300.0]]) + shift
    t = math.radians(tilt)
    heading = np.array([math.cos(t) * 0.8, math.cos(t) * 0.6, math.sin(t)])
    return Pills(base, base + 46.0 * heading, np.array([[r0, r1]]))


def look_at(
    true: Pills, supposed: Pills, camera: Camera, noise: float = 0.0, seed: int = 0, sigma: float = 0.1
) -> Look:
    """Samplers placed on the supposed pills, edges exactly where each path crosses the silhouette of the true ones."""
    tips = np.zeros(true.base.shape[0], dtype=bool)
    samplers = place_outline(supposed, camera, tips, 8.0)
    n = samplers.link.size

    inside, outside = np.full(n, -20.0), np.full(n, 20.0)
    for _ in range(50):
        offset = 0.5 * (inside + outside)
        origin, direction = rays(camera, samplers.origin + offset[:, None] * samplers.direction)
        beyond = clearance(true, samplers.link, origin, direction).distance > 0.0
        inside, outside = np.where(beyond, inside, offset), np.where(beyond, offset, outside)
    return with_edges(samplers, offset + noise * np.random.default_rng(seed).normal(size=n), sigma, supposed)


def with_edges(samplers, offset, sigma, pills) -> Look:
    n = samplers.link.size
    xy = samplers.origin + offset[:, None] * samplers.direction
    edges = EdgePoints(xy, offset, np.full(n, sigma), np.full(n, FOUND), np.ones(n))
    u = np.array([-1.0, 0.0, 1.0])
    templates = Templates(u, np.zeros((n, 3)), np.zeros((n, 2, 3)), np.ones((n, 3), dtype=bool), np.zeros(n, dtype=int))
    profiles = Profiles(u, np.zeros((n, 3)), np.ones((n, 3), dtype=bool))
    yes = np.ones(n, dtype=bool)
    features = OutlineFeatures(samplers.ray, samplers.slope, samplers.link, edges.sigma)
    return Look(pills, samplers, templates, profiles, edges, np.full(n, 9.0), yes, yes, features)


def only(look: Look, kept: np.ndarray) -> Look:
    """The look with other edges gone."""
    reason = np.where(kept, FOUND, FLAT)
    return replace(look, found=kept, edges=replace(look.edges, reason=reason))


@pytest.mark.parametrize("kind", CAMERAS)
@pytest.mark.parametrize("tilt", [0.0, 35.0, 60.0])
@pytest.mark.parametrize(("r0", "r1"), [(9.0, 9.0), (10.0, 7.0)])
def test_width_is_exact_whatever_projection_taper_tilt_and_wrong_radius(kind, tilt, r0, r1):
    true, supposed = pill(r0, r1, tilt), pill(r0 + 0.4, r1 + 0.4, tilt)
    seen = look_at(true, supposed, CAMERAS[kind])
    found = profile_widths(seen, supposed)
    assert found.width.size >= 2
    np.testing.assert_allclose(found.width, 2.0 * (r0 + found.along * (r1 - r0)), atol=2e-3)
    whole = link_widths(found, supposed.radius)
    assert whole.width[0] == pytest.approx(r0 + r1, abs=2e-3)
    assert whole.taper[0] == pytest.approx(2.0 * (r1 - r0), abs=0.02)
    assert whole.profiles[0] == found.width.size


@pytest.mark.parametrize("kind", ["orthographic", "perspective"])
def test_an_axis_that_is_off_to_one_side_does_not_change_the_width(kind):
    true = pill(9.0, 8.0, 30.0)
    supposed = pill(9.0, 8.0, 30.0, shift=(-0.6, 0.8, 0.0))
    found = link_widths(profile_widths(look_at(true, supposed, CAMERAS[kind]), supposed), supposed.radius)
    assert found.width[0] == pytest.approx(17.0, abs=0.01)


def test_pixels_are_the_distance_of_the_edges_in_the_image():
    true = pill(9.0, 9.0, 40.0)
    found = profile_widths(look_at(true, pill(9.5, 9.5, 40.0), CAMERAS["orthographic"]), true)
    np.testing.assert_allclose(found.pixels, 18.0 * 3.0, atol=1e-9)
    np.testing.assert_allclose(found.pixels_sigma, 0.1 * math.sqrt(2), atol=1e-12)
    np.testing.assert_allclose(found.sigma, found.pixels_sigma / 3.0, atol=1e-9)
    near = profile_widths(look_at(true, true, CAMERAS["perspective"]), true)
    assert near.pixels[0] > near.pixels[-1], "the tip is further away"


def test_a_taper_that_the_model_does_not_have_is_found():
    true, supposed = pill(10.0, 8.0, 20.0), pill(9.0, 9.0, 20.0)
    seen = look_at(true, supposed, CAMERAS["orthographic"], sigma=0.01)
    found = link_widths(profile_widths(seen, supposed), supposed.radius)
    assert found.taper[0] == pytest.approx(-4.0, abs=0.1)
    assert found.width[0] == pytest.approx(18.0, abs=0.02)


@pytest.mark.parametrize("kind", ["orthographic", "perspective"])
def test_sigma_covers_the_error_of_noisy_edges(kind):
    true, camera = pill(9.0, 8.0, 30.0), CAMERAS[kind]
    clean = look_at(true, true, camera)
    z, taper_z, single = [], [], []
    for seed in range(400):
        noise = 0.1 * np.random.default_rng(seed).normal(size=clean.edges.offset.size)
        profiles = profile_widths(with_edges(clean.samplers, clean.edges.offset + noise, 0.1, true), true)
        found = link_widths(profiles, true.radius, common=0.0)
        z.append((found.width[0] - 17.0) / found.sigma[0])
        taper_z.append((found.taper[0] + 2.0) / found.taper_sigma[0])
        single += ((profiles.width - 18.0 + 2.0 * profiles.along) / profiles.sigma).tolist()
    assert 0.9 < np.mean(np.abs(z) < 2.0) <= 1.0
    assert 0.6 < np.std(z) < 1.2
    assert np.std(taper_z) < 1.2
    assert 0.95 < np.std(single) < 1.05, "profiles carry no robust scale"
    assert abs(np.mean(z)) < 0.15


def test_a_fifth_of_wild_edges_does_not_move_the_width():
    true = pill(9.0, 9.0)
    clean = look_at(true, true, CAMERAS["orthographic"])
    worst = 0.0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        n = clean.edges.offset.size
        wild = rng.permutation(n) < n // 10  # of single edges, so up to a fifth of the pairs
        offset = clean.edges.offset + 0.1 * rng.normal(size=n) + wild * rng.choice([-6.0, 6.0], n)
        found = link_widths(profile_widths(with_edges(clean.samplers, offset, 0.1, true), true), true.radius)
        worst = max(worst, abs(found.width[0] - 18.0))
    assert worst < 0.12


def test_profiles_that_scatter_more_than_they_claim_widen_the_sigma():
    true = pill(9.0, 9.0)
    calm = look_at(true, true, CAMERAS["orthographic"], noise=0.1)
    wild = look_at(true, true, CAMERAS["orthographic"], noise=1.0)
    sigma = [link_widths(profile_widths(look, true), true.radius, common=0.0).sigma[0] for look in (calm, wild)]
    assert sigma[1] > 4.0 * sigma[0]


def test_a_clear_difference_to_the_model_adds_to_sigma_and_does_not_average_away():
    narrow, wide, same = (link_widths(ProfileWidths(*of(18.0 + d)), np.array([[9.0, 9.0]])) for d in (-1.0, 1.0, 0.0))
    assert same.lasting[0] == pytest.approx(math.sqrt(2) * 0.05 / 3.0)
    assert 0.45 < narrow.lasting[0] < 0.5
    assert 0.18 < wide.lasting[0] < 0.205
    assert narrow.sigma[0] > narrow.lasting[0]


def of(width: float, count: int = 6) -> tuple[np.ndarray, ...]:
    one = np.ones(count)
    return np.zeros(count, dtype=int), np.linspace(0.1, 0.9, count), width * one, 0.05 * one, 3.0 * width * one, one


def test_a_link_seen_at_one_end_only_is_less_sure_of_its_middle():
    whole, end = ProfileWidths(*of(18.0)), ProfileWidths(*of(18.0))
    end = replace(end, along=0.1 * end.along)
    sigma = [link_widths(each, np.array([[9.0, 9.0]])).sigma[0] for each in (whole, end)]
    assert sigma[1] > 3.0 * sigma[0]


def test_only_opposite_edges_are_paired():
    true = pill(9.0, 9.0)
    look = look_at(true, true, CAMERAS["orthographic"])
    plus, minus = opposite_edges(look.samplers, look.found)
    np.testing.assert_array_equal(look.samplers.along[plus], look.samplers.along[minus])
    assert (look.samplers.side[plus] == 1).all()
    assert (look.samplers.side[minus] == -1).all()
    one_side = only(look, look.samplers.side == 1)
    assert profile_widths(one_side, true).width.size == 0
    unseen = link_widths(profile_widths(one_side, true), true.radius)
    assert (unseen.width[0], unseen.sigma[0], unseen.profiles[0], unseen.lasting[0]) == (0.0, np.inf, 0, 0.0)
    assert (unseen.taper[0], unseen.taper_sigma[0]) == (0.0, pytest.approx(1.8))


def test_samplers_across_a_link_measure_no_width():
    true = pill(9.0, 9.0)
    across = place_across(true, CAMERAS["orthographic"])
    look = with_edges(across, np.zeros(across.link.size), 0.1, true)
    assert opposite_edges(look.samplers, look.found)[0].size == 0


def hand_look(seed: int, camera: Camera) -> Look:
    """Five pills at random with random offsets, and some edges missing."""
    rng = np.random.default_rng(seed)
    base = np.column_stack([rng.uniform(-40, 40, (5, 2)), rng.uniform(250, 350, 5)])
    pills = Pills(base, base + rng.uniform(15, 30, (5, 1)) * rng.normal(size=(5, 3)), rng.uniform(4, 9, (5, 2)))
    samplers = place_outline(pills, camera, np.array([True, False, True, False, True]))
    look = with_edges(samplers, rng.normal(size=samplers.link.size), 0.2, pills)
    sigma = rng.uniform(0.05, 0.4, samplers.link.size)
    look = replace(look, edges=replace(look.edges, sigma=sigma))
    return only(look, rng.uniform(size=samplers.link.size) < 0.7)


@pytest.mark.parametrize("kind", CAMERAS)
@pytest.mark.parametrize("seed", range(6))
def test_kernels_agree_with_their_plain_twins(kind, seed):
    look = hand_look(seed, CAMERAS[kind])
    for ours, plain in zip(
        opposite_edges(look.samplers, look.found), opposite_edges_numpy(look.samplers, look.found), strict=True
    ):
        np.testing.assert_array_equal(ours, plain)
    moved = replace(look.pills, base=look.pills.base + 0.3, radius=look.pills.radius * 1.02)
    profiles, twins = profile_widths(look, moved), profile_widths_numpy(look, moved)
    for name in ("link", "along", "width", "sigma", "pixels", "pixels_sigma"):
        np.testing.assert_allclose(getattr(profiles, name), getattr(twins, name), rtol=1e-9, atol=1e-9, err_msg=name)
    links, plain = link_widths(profiles, moved.radius), link_widths_numpy(profiles, moved.radius)
    for name in LinkWidths.__slots__:
        np.testing.assert_allclose(getattr(links, name), getattr(plain, name), rtol=1e-9, atol=1e-9, err_msg=name)


def test_a_pill_seen_end_on_gives_no_side_and_no_width():
    base = np.array([[0.0, 0.0, 300.0]])
    end_on = Pills(base, base + np.array([0.0, 0.0, 40.0]), np.array([[9.0, 8.0]]))
    samplers = place_outline(end_on, CAMERAS["orthographic"], np.array([True]))
    look = with_edges(samplers, np.zeros(samplers.link.size), 0.1, end_on)
    assert profile_widths(look, end_on).width.size == 0
    side_on = pill(9.0, 8.0)
    shown = look_at(side_on, side_on, CAMERAS["orthographic"])
    for twin in (profile_widths, profile_widths_numpy):  # a pose so wrong that the link points at the camera
        assert np.isfinite(twin(shown, end_on).width).all()


def test_views_are_weighted_by_their_variances_and_share_what_lasts():
    true = Pills(*(np.concatenate([getattr(pill(9.0, 9.0), name)] * 2) for name in ("base", "tip", "radius")))
    good, poor = (look_at(true, true, CAMERAS["perspective"], noise=s, seed=1, sigma=s) for s in (0.05, 0.2))
    first_only = only(poor, poor.samplers.link == 0)
    each = [link_widths(profile_widths(look, true), true.radius) for look in (good, first_only)]
    both = widths_in_views([good, first_only], [true, true], true.radius)
    weight = each[0].sigma[0] ** -2 / (each[0].sigma[0] ** -2 + each[1].sigma[0] ** -2)
    assert both.width[0] == pytest.approx(weight * each[0].width[0] + (1 - weight) * each[1].width[0])
    assert both.lasting[0] <= both.sigma[0] < each[1].sigma[0]
    assert both.profiles.tolist() == [each[0].profiles[0] + each[1].profiles[0], each[0].profiles[1]]
    for name in ("width", "sigma", "lasting", "taper", "pixels"):
        assert getattr(both, name)[1] == pytest.approx(getattr(each[0], name)[1]), "one view does not see link 1"
    nobody = widths_in_views([only(good, ~good.found)] * 2, [true, true], true.radius)
    assert np.isinf(nobody.sigma).all()
    assert not nobody.width.any()


# --- over frames -----------------------------------------------------------------------------------------------------


@given(st.floats(5, 30), st.lists(st.floats(5, 30), min_size=1, max_size=8), st.floats(0, 1))
@settings(max_examples=50, deadline=None)
def test_one_update_is_the_formula_of_appendix_e(predicted, measured, g):
    n = len(measured)
    error = [p - predicted for p in measured]
    ours = float(constant_gain(np.array([predicted]), np.array(measured)[:, None], g)[0])
    assert ours == pytest.approx(predicted + g * sum(error) / n)
    assert ours == pytest.approx((1 - g) * predicted + g / n * sum(measured))


def test_each_profile_can_keep_a_width_of_its_own():
    kept = constant_gain(np.array([10.0, 20.0]), np.array([[12.0, 18.0]]), 0.25)
    np.testing.assert_allclose(kept, [10.5, 19.5])


def test_the_constant_gain_filter_forgets_as_the_powers_of_one_minus_g():
    width = np.array([[20.0], [22.0], [19.0], [25.0]])
    found = filter_widths(width, np.ones((4, 1)), gain=0.3)
    weights = np.array([0.7**3, 0.3 * 0.7**2, 0.3 * 0.7, 0.3])
    assert found.width[-1, 0] == pytest.approx(weights @ width[:, 0])
    assert found.sigma[-1, 0] == pytest.approx(math.sqrt((weights**2).sum()))


def test_the_filter_with_variances_is_the_weighted_mean_of_all_frames():
    rng = np.random.default_rng(3)
    width, sigma = rng.normal(18.0, 0.3, (30, 2)), rng.uniform(0.1, 0.5, (30, 2))
    found = filter_widths(width, sigma)
    np.testing.assert_allclose(found.width[-1], (width / sigma**2).sum(axis=0) / (sigma**-2).sum(axis=0))
    np.testing.assert_allclose(found.sigma[-1], (sigma**-2).sum(axis=0) ** -0.5)


def test_a_frame_without_the_link_leaves_its_width():
    width, sigma = np.array([[0.0], [18.0], [0.0], [19.0]]), np.array([[np.inf], [0.1], [np.inf], [0.1]])
    found = filter_widths(width, sigma)
    assert found.width[:, 0].tolist() == [0.0, 18.0, 18.0, 18.5]
    assert np.isinf(found.sigma[0, 0])
    assert found.sigma[2, 0] == found.sigma[1, 0]


@pytest.mark.parametrize("gain", [None, 0.2])
def test_filtered_sigma_covers_the_error_of_noise_and_of_what_lasts(gain):
    rng = np.random.default_rng(5)
    links, frames, random, lasting = 2000, 25, 0.3, 0.15
    bias = lasting * rng.normal(size=links)
    width = 18.0 + bias + random * rng.normal(size=(frames, links))
    sigma = np.full((frames, links), math.hypot(random, lasting))
    found = filter_widths(width, sigma, np.full((frames, links), lasting), gain)
    z = (found.width - 18.0) / found.sigma
    np.testing.assert_allclose(z.std(axis=1), 1.0, atol=0.06)
    assert found.sigma[-1, 0] > lasting


@pytest.mark.parametrize("gain", [0.0, -0.5, 1.5, math.nan])
def test_gains_outside_their_range_are_refused(gain):
    with pytest.raises(ValueError, match=f"gain: got {gain}, wanted a number above 0 and at most 1"):
        filter_widths(np.ones((2, 2)), np.ones((2, 2)), gain=gain)


def test_a_constant_gain_is_checked_too():
    with pytest.raises(ValueError, match=r"gain: got -0\.1, wanted a number from 0 to 1"):
        constant_gain(np.ones(1), np.ones((2, 1)), -0.1)
    with pytest.raises(ValueError, match="measured: has no width"):
        constant_gain(np.ones(1), np.ones((0, 1)), 0.5)


# --- in a run --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tracked() -> tuple[Track, np.ndarray]:
    from synth.scenes import images, two_finger_crossing

    scene = two_finger_crossing(3, frames=6)
    return track(images(scene), scene.model, scene.camera, scene.start), scene.model.link_radius.sum(axis=1)


def test_a_track_knows_the_widths_of_the_links_it_saw(tracked):
    found, true = tracked
    assert found.width is not None
    assert found.width_sigma is not None
    seen = np.isfinite(found.width_sigma)
    assert seen.mean() > 0.6
    error = (found.width - true)[seen]
    assert np.abs(error).max() < 0.4
    assert np.mean(np.abs(error) < 2.0 * found.width_sigma[seen]) > 0.85
    assert not found.width[~seen].any()


def test_the_table_has_a_row_for_each_frame_and_link_and_no_nan(tracked, tmp_path):
    found, _ = tracked
    write_widths(tmp_path / "widths.csv", found, builtin_model("two_finger"))
    lines = (tmp_path / "widths.csv").read_text().splitlines()
    assert lines[0] == ",".join(COLUMNS)
    assert len(lines) == 1 + 6 * 6
    assert lines[1].startswith("0,middle_mcp,")
    assert not any(word in cell for cell in lines[1:] for word in ("nan", "inf"))


def test_the_table_is_empty_where_nothing_was_seen_and_in_millimetres(tracked):
    found, _ = tracked
    hand = builtin_model("two_finger")
    assert found.width is not None
    assert found.width_sigma is not None
    assert found.width_profiles is not None
    sigma, profiles = found.width_sigma.copy(), found.width_profiles.copy()
    sigma[:, 0], profiles[:, 0] = np.inf, 0
    blind = replace(found, width=0.001 * found.width, width_sigma=0.001 * sigma, width_profiles=profiles)
    blind = replace(blind, width_lasting=None)
    rows = [line.split(",") for line in widths_text(blind, replace(hand, units="m")).splitlines()[1:]]
    assert rows[0] == ["0", "middle_mcp", "", "", "0", "", ""]
    assert float(rows[-1][5]) == pytest.approx(15.5, abs=0.2), "the index finger's tip, in millimetres"


def test_widths_of_another_model_or_of_none_are_refused(tracked):
    found, _ = tracked
    with pytest.raises(ValueError, match="track: has no widths"):
        widths_text(replace(found, width=None), builtin_model("two_finger"))
    with pytest.raises(ValueError, match="has widths of 6 links; wanted the 15 of 'full_hand'"):
        widths_text(found, builtin_model("full_hand"))


def test_tracking_again_with_the_measured_radii_mends_a_model_that_is_too_wide():
    from synth.scenes import images, index_thumb_pinch

    scene = index_thumb_pinch(0, frames=8)
    true, hand = scene.model.link_radius, scene.model
    hand = replace(hand, link_radius=1.05 * true)
    found = track(images(scene), hand, scene.camera, scene.start)
    assert found.width is not None
    assert found.width_sigma is not None
    filtered = filter_widths(found.width, found.width_sigma, found.width_lasting)
    mended = measured_radii(hand.link_radius, filtered.width[-1], filtered.sigma[-1])
    seen = np.isfinite(filtered.sigma[-1])
    assert seen.sum() >= 4
    np.testing.assert_allclose(mended[seen] / true[seen], 1.0, atol=0.01)
    np.testing.assert_array_equal(mended[~seen], hand.link_radius[~seen])


def test_links_on_fixed_frames_are_named_by_their_frame():
    rows = [
        FrameRow(1, 0, joint="q", link_length=1.0, link_radius=(1.0, 1.0)),
        FrameRow(7, 1, link_length=1.0, link_radius=(1.0, 1.0)),
    ]
    assert link_names(model_from_rows("m", rows)) == ("q", "frame_7")


def test_the_report_shows_measured_and_filtered_widths_of_each_link(tracked):
    from handtrack.report.figures import joints_of
    from handtrack.report.plots import Frame
    from handtrack.report.widths import width_section

    found, _ = tracked
    joints, frame = joints_of(found, builtin_model("two_finger"), None), Frame(found.time, found.status)
    markup, figures = width_section(found, joints, frame)
    assert len(figures) == 6
    assert "Width of each link" in markup
    assert "nan" not in markup
    assert width_section(replace(found, width=None), joints, frame) == ("", [])
    assert found.width_sigma is not None
    never = replace(found, width_sigma=np.full_like(found.width_sigma, np.inf))
    assert width_section(never, joints, frame)[0].count("not measured") == 6
