"""The page about a frame says what was measured, adds up, and can be made again from a run."""

import re
from collections import Counter
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser

import numpy as np
import pytest

from handtrack.edges import BORDER, FLAT, FOUND, HIDDEN, JOINT, MISFIT, OUTSIDE
from handtrack.measure import Look
from handtrack.replay import Replay, replay
from handtrack.report.explain import render_explanation
from handtrack.report.explain_cards import searched
from handtrack.report.explain_evidence import (
    DOUBTED,
    appearance_of,
    evidence_of,
    hiding_links,
    link_names,
    off_truth,
    outline_edge,
    prior_share_of_joints,
)
from handtrack.report.explain_facts import joint_facts, link_facts, listed
from handtrack.report.explain_findings import compass, count_words, findings_of
from handtrack.report.explain_image import geometry_path, runs, scene_svg
from handtrack.report.explain_lines import boundaries, votes
from handtrack.report.explain_tables import joint_table, link_table, vote_table
from handtrack.report.explain_truth import truth_facts
from handtrack.residuals import LineFeatures, chain
from handtrack.scatter import whiten_numpy, whitener
from handtrack.sequences import Truth
from handtrack.settings import Settings
from handtrack.tracker import track
from synth.scenes import images, two_finger_crossing

FRAMES, AT = 4, 3
WAYS = {
    "outline": Settings(),
    "lines": Settings(residuals="lines"),
    "refined": Settings(refine=True),
    "polygons": Settings(visibility="polygons"),
}


@cache
def shot():
    scene = two_finger_crossing(3, frames=FRAMES, size=(320, 240), scale=1.6)
    return scene, tuple(np.asarray(image, dtype=np.float32) for image in images(scene))


@cache
def past_of(way: str = "outline", views: int = 1, number: int = AT) -> Replay:
    scene, pictures = shot()
    on = [chain(scene.model, scene.camera)] * views
    given = [(picture,) * views for picture in pictures] if views > 1 else pictures
    return replay(given, on, scene.start, scene.fps, WAYS[way], number)


@cache
def blind() -> Replay:
    """A frame in which the light went out."""
    scene, pictures = shot()
    dark = [*pictures[:2], np.zeros_like(pictures[0])]
    return replay(dark, [chain(scene.model, scene.camera)], scene.start, scene.fps, Settings(), 2)


def true_pose(number: int = AT):
    return shot()[0].truth[number]


def said(past, joints=None, links=None, truth=None):
    evidence = evidence_of(past)
    found = findings_of(
        past, evidence, joints or joint_facts(past, evidence), links or link_facts(past, evidence), truth
    )
    return " ".join(finding.text for finding in found)


class Page(HTMLParser):
    """Elements that are open and must be closed, all attributes that load or name something, and the words."""

    def __init__(self, text):
        super().__init__()
        self.open, self.references, self.ids, self.samplers, self.words = [], [], [], [], []
        self.classes = Counter()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag not in ("meta", "link", "input", "image", "circle", "rect", "path"):
            self.open.append(tag)
        self.references += [values[name] for name in ("src", "href", "action", "data") if name in values]
        self.ids += [values["id"]] if "id" in values else []
        self.samplers += [values["data-s"]] if "data-s" in values else []
        self.classes.update((values.get("class") or "").split())

    def handle_endtag(self, tag):
        if tag in self.open and tag not in ("path", "circle", "rect", "image"):
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@cache
def page_of(way: str = "outline", views: int = 1):
    truth = Truth(np.arange(FRAMES), np.array([true_pose(i) for i in range(FRAMES)]))
    return render_explanation(past_of(way, views), truth, "clip <1>", ("odd & old",))


# --- replay


@pytest.mark.parametrize("number", [0, AT])
def test_a_replayed_frame_is_that_of_the_track(number):
    scene, pictures = shot()
    whole = track(pictures, scene.model, scene.camera, scene.start, scene.fps)
    past = past_of(number=number)
    np.testing.assert_array_equal(past.frame.q, whole.q[number])
    assert past.frame.status == whole.status[number]
    assert past.time == whole.time[number]
    assert past.images[0] is pictures[number]


def test_replaying_a_frame_that_is_not_there_is_an_error():
    scene, pictures = shot()
    on = [chain(scene.model, scene.camera)]
    for number, told in ((-1, "number: got -1, wanted a frame from 0 on"), (9, "number: got 9, wanted one of")):
        with pytest.raises(ValueError, match=told):
            replay(pictures[:2], on, scene.start, scene.fps, Settings(), number)


def test_replay_tells_its_progress_and_takes_times():
    scene, pictures = shot()
    done = []
    on = [chain(scene.model, scene.camera)]
    past = replay(pictures, on, scene.start, scene.fps, Settings(), 2, np.arange(FRAMES) / 25.0, done.append)
    assert done == [1, 2, 3]
    assert past.time == 0.08


# --- evidence


@pytest.mark.parametrize("way", WAYS)
def test_pulls_of_links_prediction_and_rest_add_up_to_nothing(way):
    evidence = evidence_of(past_of(way))
    total = evidence.link_pull.sum(axis=0) + evidence.prior_pull + evidence.rest_pull
    np.testing.assert_allclose(total, 0.0, atol=1e-12)
    if way != "refined":  # there the grey levels of the surface are the rest
        assert np.degrees(np.abs(evidence.rest_pull)).max() < 0.05


@pytest.mark.parametrize("way", ["outline", "lines"])
def test_a_pull_is_the_gain_of_the_whitened_fit_times_the_residual(way):
    past = past_of(way)
    found, evidence = past.frame.estimate, evidence_of(past)
    assert found.rows is not None and found.fit is not None
    r, J = found.rows.residual(found.u)
    white = whitener(found.rows.sigma, found.rows.group, past.before.consistency.scatter)
    W = whiten_numpy(white, np.eye(r.size))
    D = np.diag(found.fit.weight) / found.fit.spread**2
    C = np.linalg.inv(J.T @ W.T @ D @ W @ J + found.prior.information)
    np.testing.assert_allclose(evidence.rows.pull, -(C @ J.T @ W.T @ D @ W * r).T, atol=1e-9)


def test_an_edge_moved_by_a_little_moves_the_pose_against_its_pull():
    past = past_of()
    evidence = evidence_of(past)
    rows = evidence.rows
    i = int(np.argmax(np.abs(rows.pull).max(axis=1)))
    # An edge outside the model (positive residual) pulls the model's outline outwards, so its residual falls.
    assert past.frame.estimate.rows is not None
    r, J = past.frame.estimate.rows.residual(past.frame.estimate.u)
    assert np.sign(J[i] @ rows.pull[i]) == -np.sign(r[i])


def test_every_accepted_sampler_has_a_row_and_others_have_none():
    past = past_of()
    evidence, look = evidence_of(past), past.frame.estimate.seen[0]
    assert ((evidence.row_of[0] >= 0) == look.found).all()
    assert set(evidence.outcome[0][look.found].tolist()) <= {FOUND, DOUBTED}
    np.testing.assert_allclose(evidence.rows.xy, look.edges.xy[look.found], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(evidence.rows.direction, axis=1), 1.0)
    edge = outline_edge(past, evidence, 0)
    assert (np.isfinite(edge) == look.found).all()


def test_line_residuals_point_from_the_model_to_the_image():
    past = past_of("lines")
    rows, features = evidence_of(past).rows, past.frame.estimate.seen[0].features
    assert isinstance(features, LineFeatures)
    m = features.tip_link.size
    np.testing.assert_allclose(rows.xy[: 2 * m], np.repeat(features.tip, 2, axis=0))
    line = np.repeat(features.line, 2, axis=0)
    np.testing.assert_allclose((rows.xy[2 * m :] * line[:, :2]).sum(axis=1), line[:, 2], atol=1e-9)
    # Where the evidence is, less the residual along the direction, the model is: a tip's two rows agree on one point.
    model = rows.xy - rows.residual[:, None] * rows.direction
    np.testing.assert_allclose((model[0] - features.tip[0])[0], rows.residual[0], atol=1e-9)
    assert (rows.sampler == -1).all()


def test_without_edges_the_prediction_decides_everything():
    past = blind()
    evidence, model = evidence_of(past), past.on[0].model
    assert past.frame.estimate.fit is None
    assert evidence.rows.link.size == 0
    np.testing.assert_allclose(prior_share_of_joints(model, evidence.prior_share), 1.0)
    joints = joint_facts(past, evidence)
    assert np.isinf(joints.image_sigma).all()
    assert "Hardly any edge was found" in said(past)
    page, _ = render_explanation(past, None, "dark")
    assert "nothing" in page


def test_links_are_named_by_their_finger_and_place():
    names = link_names(shot()[0].model)
    assert names[:3] == ("middle proximal", "middle middle", "middle distal")
    assert len(set(names)) == 6


def test_hidden_samplers_are_behind_another_finger():
    past = past_of(number=AT)
    on, look = past.on[0], past.frame.estimate.seen[0]
    front = hiding_links(on, look)
    assert (front[look.edges.reason != HIDDEN] == -1).all()
    hidden = look.edges.reason == HIDDEN
    if hidden.any():
        behind = on.model.link_finger[look.samplers.link[hidden]]
        assert (on.model.link_finger[front[hidden]] != behind)[front[hidden] >= 0].all()


# --- facts


def test_facts_of_joints_are_those_of_the_frame():
    past = past_of()
    evidence = evidence_of(past)
    joints = joint_facts(past, evidence)
    np.testing.assert_allclose(joints.fitted, np.degrees(past.frame.q))
    np.testing.assert_allclose(joints.sigma, np.degrees(np.sqrt(np.diag(past.frame.covariance))))
    assert ((joints.prior_share >= 0) & (joints.prior_share <= 1)).all()
    assert (joints.image_sigma * 1.001 >= np.degrees(np.sqrt(np.diag(evidence.covariance)))).all()
    assert set(joints.units) == {"\N{DEGREE SIGN}"}


def test_directions_that_the_prediction_decides_are_told():
    past = past_of()
    found = past.frame.estimate
    one = found.information[np.ix_([0], [0])]
    blurred = np.zeros_like(found.information)
    blurred[:2, :2] = one * np.array([[1.0, 1.0], [1.0, 1.0]])  # only the sum of two joints is seen
    weak = replace(past, frame=replace(past.frame, estimate=replace(found, information=blurred)))
    joints = joint_facts(weak, evidence_of(weak))
    assert any("middle_mcp" in words and "middle_pip" in words for words, _ in joints.weak)
    assert "hardly tell when they move together" in said(weak)
    assert "decided by the prediction" in said(weak)


def test_counts_of_outcomes_are_all_samplers():
    for views in (1, 2):
        past = past_of(views=views)
        links = link_facts(past, evidence_of(past))
        samplers = sum(look.samplers.link.size for look in past.frame.estimate.seen)
        assert links.count.sum() == samplers
        assert (links.used <= links.total).all()
        assert f"{links.count[:, FOUND].sum()} accepted" in count_words(links)


def test_a_wider_image_shows_on_both_sides_and_a_turned_one_on_opposite_ones():
    past = past_of()
    evidence = evidence_of(past)
    look, rows = past.frame.estimate.seen[0], evidence.rows
    side = look.samplers.side[rows.sampler]
    wide = link_facts(past, replace(evidence, rows=replace(rows, residual=np.full(rows.residual.size, 0.8))))
    assert np.nanmin(wide.side) == np.nanmax(wide.side) == 0.8
    turned = link_facts(past, replace(evidence, rows=replace(rows, residual=0.8 * side)))
    assert np.nanmax(turned.side[:, 0]) == 0.8 and np.nanmax(turned.side[:, 1]) == -0.8


# --- findings


def with_sides(past, one, other, tip):
    links = link_facts(past, evidence_of(past))
    side, sigma = np.full_like(links.side, np.nan), np.full_like(links.side, 0.05)
    side[2] = one, other, tip
    facing = links.facing.copy()
    facing[2] = [[1.0, 0.0], [-1.0, 0.0], [0.0, -1.0]]
    return replace(links, side=side, side_sigma=sigma, facing=facing)


@pytest.mark.parametrize(
    ("sides", "told"),
    [
        ((1.0, 0.8, np.nan), "middle distal: 1.8 px wider in the image than the model, on both sides"),
        ((-1.0, -0.8, np.nan), "1.8 px narrower"),
        ((1.0, -1.0, 0.0), "its edges stand 1.0 px to the right of the model"),
        ((-2.0, 1.0, 0.0), "its edges stand 1.5 px to the left of the model"),
        ((0.0, 0.1, 2.5), "the tip in the image is 2.5 px beyond the model's"),
        ((0.0, 0.1, -2.5), "the tip in the image is 2.5 px short of the model's"),
        ((1.2, 0.0, 0.0), "edges on its right side lie 1.2 px outside the model, the other side fits"),
        ((np.nan, -1.2, 0.0), "edges on its left side lie 1.2 px inside the model, the other shows nothing"),
    ],
)
def test_residuals_of_sides_say_what_may_be_wrong_with_the_shape(sides, told):
    past = past_of()
    assert told in said(past, links=with_sides(past, *sides))


def with_counts(past, **outcomes):
    links = link_facts(past, evidence_of(past))
    count = np.zeros_like(links.count)
    count[:, FOUND] = 10
    count[2] = 0
    for name, number in outcomes.items():
        count[2, int(name[1:])] = number
    hidden_by = np.full(links.hidden_by.size, -1)
    hidden_by[2] = 4
    return replace(links, count=count, hidden_by=hidden_by)


def test_missing_edges_are_told_with_their_reasons():
    past = past_of()
    links = with_counts(past, **{f"o{FOUND}": 5, f"o{HIDDEN}": 6, f"o{BORDER}": 2, f"o{MISFIT}": 1, f"o{JOINT}": 4})
    told = said(past, links=links)
    assert (
        "middle distal: 9 of 14 edges not used (6 hidden by index middle, 2 at the end of the search range and "
        "1 unlike the template)" in told
    )
    assert "middle proximal" not in told.split("edges not used")[0]
    assert "not used" not in said(past, links=with_counts(past, **{f"o{FOUND}": 9, f"o{FLAT}": 1}))


def test_doubted_edges_are_told():
    past = past_of()
    assert "6 of 10 found edges count for next to nothing" in said(past, links=with_counts(past, o0=4, o7=6))


def test_a_prediction_far_off_limits_and_contradictions_are_told():
    past = past_of()
    evidence = evidence_of(past)
    joints, links = joint_facts(past, evidence), link_facts(past, evidence)
    moved = joints.fitted.copy()
    moved[1] += 12.0
    limit = np.zeros(joints.at_limit.size, dtype=int)
    limit[0], limit[2] = 1, -1
    told = said(past, replace(joints, predicted=moved, at_limit=limit))
    assert "The prediction of middle_pip was 12.0" in told
    assert "middle_mcp stands at its upper limit" in told and "middle_dip stands at its lower limit" in told
    pull = links.pull.copy()
    pull[0, 3], pull[1, 3] = 4.0, -4.0
    told = said(past, links=replace(links, pull=pull))
    assert (
        "index_mcp is pulled both ways: +4.0\N{DEGREE SIGN} by middle proximal, \N{MINUS SIGN}4.0\N{DEGREE SIGN} by "
        "middle middle" in told
    )


def test_a_lost_frame_and_bad_scatter_and_shape_are_told():
    past = past_of()
    after = past.after
    scatter, shape = after.consistency.scatter, after.consistency.shape
    consistency = replace(after.consistency, scatter=replace(scatter, s=5.0), shape=replace(shape, eps=0.08))
    unseen = past.frame.unseen.copy()
    unseen[0] = True
    frame = replace(past.frame, status="lost", unseen=unseen, estimate=replace(past.frame.estimate, residual=2.5))
    told = said(replace(past, frame=frame, after=replace(after, consistency=consistency)))
    assert "The frame counts as lost" in told and "doubt in middle_mcp" in told
    assert "off by 8 %" in told and "scatter 5.0 times" in told and "2.5 px RMS beside" in told


def test_a_rival_pose_is_told_and_drawn():
    past = past_of()
    other = past.frame.q.copy()
    other[4] += np.radians(20.0)
    doubtful = replace(past, frame=replace(past.frame, other=other, other_weight=0.3))
    assert "has 30 % of the weight: index_pip +20.0\N{DEGREE SIGN} from here" in said(doubtful)
    page, _ = render_explanation(doubtful, None, "clip")
    assert "rival pose" in page
    same = replace(past, frame=replace(past.frame, other=past.frame.q, other_weight=0.3))
    assert "Another pose" not in said(same)


def test_nothing_stands_out_where_nothing_is_wrong():
    past = past_of()
    evidence = evidence_of(past)
    joints = joint_facts(past, evidence)
    calm = replace(joints, prior_share=np.zeros(joints.prior_share.size), weak=(), predicted=joints.fitted)
    links = link_facts(past, evidence)
    links = replace(links, count=np.eye(8, dtype=int)[[0] * 6] * 9, side=np.zeros((6, 3)), pull=np.zeros((6, 6)))
    found = findings_of(past, evidence, calm, links, None)
    assert [finding.level for finding in found] == ["note"]
    assert "Nothing stands out" in found[0].text


def test_findings_are_sorted_worst_first():
    past = past_of()
    truth = truth_facts(past, true_pose() + np.radians(6.0))
    evidence = evidence_of(past)
    found = findings_of(past, evidence, joint_facts(past, evidence), link_facts(past, evidence), truth)
    order = [("bad", "odd", "note").index(finding.level) for finding in found]
    assert order == sorted(order)
    assert found[0].text.startswith("Off the truth: ")
    assert "and 2 more joints" in found[0].text


def test_words_for_directions_and_lists():
    angles = np.radians([0, 45, 90, 135, 180, 225, 270, 315])
    words = [compass(np.array([np.cos(a), np.sin(a)])) for a in angles]
    assert words == ["right", "lower right", "lower", "lower left", "left", "upper left", "upper", "upper right"]
    assert listed([]) == "" and listed(["a"]) == "a"


# --- truth


def test_a_frame_measured_well_is_right_and_would_be_again():
    past = past_of()
    facts = truth_facts(past, true_pose())
    assert np.abs(facts.error).max() < 1.0 and np.abs(facts.trial_error).max() < 1.0
    assert 0.5 < facts.cost_true / facts.cost < 2.0
    np.testing.assert_array_equal(np.isfinite(facts.off[0]), past.frame.estimate.seen[0].found)
    assert np.nanmean(np.abs(facts.off[0])) < 0.3


def test_where_the_error_came_in_is_told():
    past = past_of()
    facts = truth_facts(past, true_pose())
    for error, trial, cost_true, told in (
        (10.0, 1.0, 10.0, "the error came with the prediction"),
        (10.0, 5.0, 99.0, "part of the error came with the prediction, the rest is made here"),
        (10.0, 9.5, 1.0, "no better prediction would help. Yet the edges taken fit the true pose better"),
    ):
        spoilt = replace(
            facts,
            error=np.full(6, error),
            trial_error=np.full(6, trial),
            cost=10.0,
            cost_true=cost_true,
        )
        assert told in said(past, truth=spoilt)
    assert "fit the true pose worse" in said(past, truth=replace(spoilt, cost_true=99.0))


def test_truth_of_a_frame_without_evidence_has_no_cost():
    facts = truth_facts(blind(), true_pose(2))
    assert np.isnan(facts.cost) and np.isnan(facts.cost_true)


def test_lines_have_no_distance_from_the_true_outline():
    assert np.isnan(off_truth(past_of("lines"), 0, true_pose())).all()


# --- drawing


@pytest.mark.parametrize("way", WAYS)
def test_the_page_holds_every_sampler_once_and_refers_to_nothing_outside(way):
    text, _ = page_of(way)
    page = Page(text)
    samplers = past_of(way).frame.estimate.seen[0].samplers.link.size
    assert page.open == []
    assert page.classes["card"] == samplers == len(page.samplers)
    assert len(page.ids) == len(set(page.ids))
    assert set(page.samplers) <= set(page.ids)
    assert all(reference.startswith("data:") for reference in page.references)
    assert "http://" not in text and "https://" not in text and "@import" not in text and "url(" not in text
    assert "default-src 'none'" in text
    assert "nan" not in "".join(re.findall(r'\b(?:d|x|y|cx|cy|r|width|viewBox)="([^"]*)"', text))
    assert len(text) < 3_000_000


def test_names_from_outside_are_only_text():
    text, _ = page_of()
    assert "clip &lt;1&gt;, frame 3" in text and "<1>" not in text
    assert '<p class="warning">odd &amp; old</p>' in text


def test_the_same_frame_gives_the_same_bytes():
    assert (
        page_of()[0]
        == render_explanation(
            past_of(),
            Truth(np.arange(FRAMES), np.array([true_pose(i) for i in range(FRAMES)])),
            "clip <1>",
            ("odd & old",),
        )[0]
    )


def test_truth_is_on_the_page_only_where_it_is_whole():
    past = past_of()
    assert "off the truth" in page_of()[0]
    for truth in (None, Truth(np.array([0]), np.zeros((1, 6))), Truth(np.array([AT]), np.full((1, 6), np.nan))):
        text, _ = render_explanation(past, truth, "clip")
        assert "off the truth" not in text and "v0-truth" not in text


def test_two_views_have_an_image_and_cards_each():
    text, _ = page_of(views=2)
    page = Page(text)
    assert page.classes["scene"] == 2
    assert "View 1" in text and "2 views" in text
    assert sum(name.startswith("s1-") for name in page.samplers) == len(page.samplers) // 2


def test_lines_are_drawn_with_their_votes_and_polygons_where_they_decide():
    text, _ = page_of("lines")
    page = Page(text)
    assert "Votes for boundary lines" in text
    assert page.classes["boundary"] == 12 and page.classes["axial"] == 6 and page.classes["tip-cross"] == 2
    assert Page(page_of("polygons")[0]).classes["polygon"] == 6
    assert Page(page_of()[0]).classes["polygon"] == page.classes["polygon"] == 0


def test_votes_of_two_views_are_counted_apart():
    past = past_of("lines")
    seen = past.frame.estimate.seen * 2
    both = replace(past, on=past.on * 2, frame=replace(past.frame, estimate=replace(past.frame.estimate, seen=seen)))
    both = replace(
        both,
        after=replace(past.after, appearance=appearance_of(past) * 2),
        before=replace(past.before, appearance=appearance_of(past) * 2),
    )
    assert vote_table(both).count("<tr data-link") == 12
    assert "<th>view</th>" in vote_table(both) and "<th>view</th>" not in vote_table(past)


def test_every_point_votes_for_its_boundary_line_where_edges_are_clean():
    found = boundaries(past_of("lines"), 0)
    given = np.isfinite(found.points).all(axis=-1)
    assert (found.inlier <= given).all()
    assert (found.inlier.sum(axis=-1) >= 0.7 * given.sum(axis=-1)).all()
    assert all(" of " in words for _, words in votes(found))


def with_reasons(past: Replay, reasons) -> Replay:
    """The same frame with other reasons for its first samplers."""
    look: Look = past.frame.estimate.seen[0]
    reason = look.edges.reason.copy()
    chosen = np.flatnonzero(~look.found)[: len(reasons)]
    chosen = chosen if chosen.size == len(reasons) else np.arange(len(reasons))
    reason[chosen] = reasons
    changed = replace(look, edges=replace(look.edges, reason=reason))
    return replace(past, frame=replace(past.frame, estimate=replace(past.frame.estimate, seen=(changed,))))


def test_every_reason_is_told_with_its_figures():
    past = with_reasons(blind(), [HIDDEN, JOINT, OUTSIDE, FLAT, BORDER, MISFIT])
    text, _ = render_explanation(past, None, "clip")
    for words in (
        "Hidden by another finger.",
        "No depth step: the finger goes on.",
        "Too much of the window is outside the image.",
        "no edge that can be told to 1.5 px",
        "the edge may lie beyond.",
        "template and image differ by",
    ):
        assert words in text


def test_an_edge_that_is_too_far_off_is_doubted():
    past = past_of()
    found = past.frame.estimate
    assert found.fit is not None
    weight = found.fit.weight.copy()
    weight[:2] = 0.1
    weak = replace(past, frame=replace(past.frame, estimate=replace(found, fit=replace(found.fit, weight=weight))))
    text, _ = render_explanation(weak, None, "clip")
    outcome, row = evidence_of(weak).outcome[0], evidence_of(weak).row_of[0]
    np.testing.assert_array_equal(outcome[row >= 0] == DOUBTED, weight < 0.3)
    assert "Too far off the others to count." in text


def test_the_curve_computed_again_is_lowest_where_the_edge_was_found():
    past = past_of()
    look = past.frame.estimate.seen[0]
    found = searched(look, appearance_of(past)[0])
    step = found.shift[1] - found.shift[0]
    assert (np.abs(found.best - look.edges.offset)[look.found] <= 1.01 * step).all()
    assert (found.cost >= found.wssd).all()


def test_a_pose_outside_the_image_is_drawn_whole_image():
    past = past_of()
    camera = replace(past.on[0].camera, cx=1e5)
    far = replace(past, on=(chain(past.on[0].model, camera),))
    assert 'viewBox="-0.5 -0.5 320.0 240.0"' not in scene_svg(past, evidence_of(past), 0, None)
    assert "<svg" in scene_svg(far, evidence_of(past), 0, None)


def test_paths_and_runs():
    import shapely

    assert geometry_path(shapely.box(0, 0, 1, 2)) == "M1 0L1 2L0 2L0 0Z"
    assert geometry_path(shapely.Polygon()) == ""
    assert runs(np.zeros(3, dtype=bool)) == []


def test_tables_mark_what_is_bad():
    past = past_of()
    evidence = evidence_of(past)
    joints, links = joint_facts(past, evidence), link_facts(past, evidence)
    limit = np.zeros(6, dtype=int)
    limit[:2] = 1, -1
    truth = replace(truth_facts(past, true_pose()), error=np.array([9.0, 0, 0, 0, 0, 0]))
    text = joint_table(replace(joints, at_limit=limit, unseen=np.ones(6, dtype=bool)), truth)
    assert "at its upper limit" in text and "at its lower limit" in text and "images say little" in text
    assert text.count('class="bad"') == 2
    assert 'class="bad"' in link_table(past, replace(links, rms=np.full(6, 2.0)), joints, None)
