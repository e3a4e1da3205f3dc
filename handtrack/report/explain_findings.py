"""Figures of a frame in, what is wrong with it in plain words out, worst first.

Each rule looks at one thing and says it with the numbers it rests on. Thresholds are rules of thumb: they only decide
what is said, nothing is computed from them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from ..edges import BORDER, FLAT, FOUND, HIDDEN, MISFIT, OUTSIDE
from ..replay import Replay
from ..track import LOST, TRACKED
from .explain_evidence import Evidence, link_names
from .explain_facts import JointFacts, LinkFacts, joint_scale, listed, prior_pull, signed
from .explain_truth import TruthFacts

Level = Literal["bad", "odd", "note"]
_ORDER = ("bad", "odd", "note")
_WHY = (
    (HIDDEN, "hidden"),
    (OUTSIDE, "outside the image"),
    (FLAT, "without contrast"),
    (BORDER, "at the end of the search range"),
    (MISFIT, "unlike the template"),
)
_COMPASS = ("right", "lower right", "lower", "lower left", "left", "upper left", "upper", "upper right")
_MOST_OF_A_KIND = 4  # findings of one rule that are said one by one


@dataclass(frozen=True, slots=True)
class Finding:
    """One sentence or two; `size` orders findings of the same level, `links` are those it speaks of."""

    level: Level
    size: float
    text: str
    links: tuple[int, ...] = ()


def findings_of(
    past: Replay, evidence: Evidence, joints: JointFacts, links: LinkFacts, truth: TruthFacts | None
) -> tuple[Finding, ...]:
    """All findings, worst first; a note says so if nothing is wrong."""
    rules = [
        _evidence_as_a_whole(past, links),
        _joints_off(joints, truth),
        _trials(joints, truth),
        _prediction_off(joints),
        _rival(past, joints),
        _decided_by_prediction(joints),
        _at_limits(joints),
        _missing_edges(past, links),
        _sides(past, links),
        _doubted(past, links),
        _contradictions(past, evidence, joints, links),
        _consistency(past),
    ]
    found = [finding for rule in rules for finding in sorted(rule, key=lambda f: -f.size)[:_MOST_OF_A_KIND]]
    found.sort(key=lambda finding: (_ORDER.index(finding.level), -finding.size))
    if all(finding.level == "note" for finding in found):
        found.insert(0, Finding("note", 0.0, "Nothing stands out: edges were found and agree with the model."))
    return tuple(found)


def _evidence_as_a_whole(past: Replay, links: LinkFacts) -> Iterator[Finding]:
    frame, used = past.frame, int(links.used.sum())
    if frame.estimate.fit is None:
        yield Finding("bad", 100.0, "Hardly any edge was found: the pose is the prediction and nothing else.")
        return
    wanted = int((links.total - links.count[:, HIDDEN] - links.count[:, OUTSIDE]).sum())
    if frame.status != TRACKED:
        blind = [past.on[0].model.joint_names[past.on[0].model.free[k]] for k in np.flatnonzero(frame.unseen)]
        because = f"{used} of {wanted} expected edges were found"
        if blind:
            because += f", and the images alone leave more than 8\N{DEGREE SIGN} of doubt in {listed(blind)}"
        level: Level = "bad" if frame.status == LOST else "odd"
        yield Finding(level, 20.0, f"The frame counts as {frame.status}: {because}.")
    if frame.estimate.residual > 1.0:
        off = f"{frame.estimate.residual:.1f} px RMS"
        text = f"Edges lie {off} beside the fitted outline; a right model leaves 0.1 to 0.3 px."
        yield Finding("odd", 6.0 * frame.estimate.residual, text)


def _joints_off(joints: JointFacts, truth: TruthFacts | None) -> Iterator[Finding]:
    if truth is None:
        return
    size, wrong = np.abs(truth.error), _wrong(joints, truth)
    if not wrong:
        return
    sigmas = size / np.maximum(joints.sigma, 1e-9)
    named = [
        f"{joints.names[j]} {signed(float(truth.error[j]))}{joints.units[j]} ({sigmas[j]:.1f} sigmas)"
        for j in wrong[:4]
    ]
    more = f" and {len(wrong) - 4} more joints" if len(wrong) > 4 else ""
    yield Finding("bad", 100.0 + float(size[wrong[0]]), f"Off the truth: {', '.join(named)}{more}.")


def _wrong(joints: JointFacts, truth: TruthFacts) -> list[int]:
    """Joints off the truth by more than their sigmas allow, or by much, the worst first."""
    size = np.abs(truth.error)
    return [int(j) for j in np.argsort(-size) if size[j] > min(3.0, max(1.0, 2.0 * float(joints.sigma[j])))]


def _trials(joints: JointFacts, truth: TruthFacts | None) -> Iterator[Finding]:
    """Where the error came in."""
    if truth is None or not _wrong(joints, truth):
        return
    worst, best = int(np.argmax(np.abs(truth.error))), int(np.argmax(np.abs(truth.trial_error)))
    error, trial = float(abs(truth.error[worst])), float(abs(truth.trial_error[best]))
    unit = joints.units[best]
    said = f"Predicted from the truth, this frame would end {trial:.1f}{unit} off at worst ({joints.names[best]})"
    if trial < 0.35 * error:
        text = f"{said}: its image is good enough, the error came with the prediction from earlier frames."
    elif trial < 0.8 * error:
        text = f"{said}: part of the error came with the prediction, the rest is made here, by edges or model."
    else:
        text = f"{said}: it is made here, by wrong edges or a wrong model, and no better prediction would help."
    if np.isfinite(truth.cost_true) and truth.cost_true > 1.1 * truth.cost:
        text += (
            f" The edges taken fit the true pose worse (cost {truth.cost_true:.0f}) than this one ({truth.cost:.0f})."
        )
    elif np.isfinite(truth.cost_true) and truth.cost_true < 0.9 * truth.cost:
        costs = f"{truth.cost_true:.0f} against {truth.cost:.0f}"
        text += f" Yet the edges taken fit the true pose better (cost {costs})."
    yield Finding("bad", 100.0 + 0.9 * error, text)


def _prediction_off(joints: JointFacts) -> Iterator[Finding]:
    moved = joints.fitted - joints.predicted
    for j in np.argsort(-np.abs(moved)):
        sigmas = abs(moved[j]) / max(float(joints.predicted_sigma[j]), 1e-9)
        if sigmas < 2.5 and abs(moved[j]) < 8.0:
            continue
        away = f"{abs(moved[j]):.1f}{joints.units[j]}"
        text = f"The prediction of {joints.names[j]} was {away} away, {sigmas:.1f} of its sigmas."
        yield Finding("odd", float(5.0 * sigmas), text)


def _decided_by_prediction(joints: JointFacts) -> Iterator[Finding]:
    decided = np.flatnonzero(joints.prior_share > 0.5)
    if decided.size:
        order = decided[np.argsort(-joints.prior_share[decided], kind="stable")]
        named = [f"{joints.names[j]} ({100 * (1 - joints.prior_share[j]):.0f} %)" for j in order]
        verb = "is" if order.size == 1 else "are"
        text = f"{listed(named)} {verb} decided by the prediction: the images' share is in brackets."
        yield Finding("odd", 30.0 * float(joints.prior_share.max()), text)
    weak = [f"{words} ({100 * (1 - share):.0f} %)" for words, share in joints.weak[:3] if share > 0.75]
    if weak:
        text = f"Joints that the images hardly tell when they move together: {'; '.join(weak)}."
        yield Finding("odd", 20.0 * joints.weak[0][1], text)


def _rival(past: Replay, joints: JointFacts) -> Iterator[Finding]:
    """Another pose that the images cannot tell from this one."""
    if past.frame.other is None:
        return
    apart = (past.frame.other - past.frame.q) * joint_scale(past.on[0].model)
    largest = np.argsort(-np.abs(apart))[:3]
    named = [f"{joints.names[j]} {signed(float(apart[j]))}{joints.units[j]}" for j in largest if abs(apart[j]) >= 1.0]
    if not named:
        return
    share = past.frame.other_weight
    text = f"Another pose explains the images too and has {100 * share:.0f} % of the weight: {listed(named)} from here."
    yield Finding("odd", 60.0 * share, text)


def _at_limits(joints: JointFacts) -> Iterator[Finding]:
    for j in np.flatnonzero(joints.at_limit):
        side = "upper" if joints.at_limit[j] > 0 else "lower"
        text = f"{joints.names[j]} stands at its {side} limit, {joints.fitted[j]:.0f}{joints.units[j]}."
        yield Finding("odd", 15.0, text.replace("-", "\N{MINUS SIGN}"))


def _missing_edges(past: Replay, links: LinkFacts) -> Iterator[Finding]:
    names = link_names(past.on[0].model)
    for link, total in enumerate(links.total):
        missing = int(total - links.used[link])
        if not total or missing < max(2, 0.35 * total):
            continue
        parts = []
        for reason, words in _WHY:
            if number := int(links.count[link, reason]):
                front = int(links.hidden_by[link])
                by = f" by {names[front]}" if reason == HIDDEN and front >= 0 else ""
                parts.append(f"{number} {words}{by}")
        hidden = links.count[link, HIDDEN] / total
        level: Level = "note" if hidden > 0.8 * missing / total and missing < 0.7 * total else "odd"
        text = f"{names[link]}: {missing} of {total} edges not used ({listed(parts)})."
        yield Finding(level, 25.0 * missing / total, text, (link,))


def compass(direction: Float[np.ndarray, " 2"]) -> str:
    """Where a vector points in the image, y down.

    >>> compass(np.array([-1.0, 0.1])), compass(np.array([0.6, -0.5]))
    ('left', 'upper right')
    """
    angle = np.arctan2(direction[1], direction[0])
    return _COMPASS[int(np.rint(angle / (np.pi / 4))) % 8]


def _sides(past: Replay, links: LinkFacts) -> Iterator[Finding]:
    """Residuals that a whole side has in common."""
    names = link_names(past.on[0].model)
    clear = np.abs(links.side) > np.maximum(0.5, 4.0 * links.side_sigma)
    for link in np.flatnonzero(clear.any(axis=1)):
        one, other, tip = links.side[link]
        towards = [compass(facing) for facing in links.facing[link]]
        size = float(np.nanmax(np.abs(links.side[link])))
        if clear[link, 2] and not clear[link, :2].any():
            longer = "beyond" if tip > 0 else "short of"
            text = f"the tip in the image is {abs(tip):.1f} px {longer} the model's: length or bend of the link?"
        elif clear[link, :2].all() and one * other > 0:
            wider = "wider" if one > 0 else "narrower"
            text = f"{abs(one + other):.1f} px {wider} in the image than the model, on both sides: radius or distance?"
        elif clear[link, :2].all():
            shift = towards[0] if one > 0 else towards[1]
            far = f"{abs(one - other) / 2:.1f} px"
            text = f"its edges stand {far} to the {shift} of the model: joint or link out of place?"
        else:
            off = 0 if clear[link, 0] else 1
            where = "outside" if links.side[link, off] > 0 else "inside"
            rest = "the other side fits" if np.isfinite(links.side[link, 1 - off]) else "the other shows nothing"
            text = (
                f"edges on its {towards[off]} side lie {abs(links.side[link, off]):.1f} px {where} the model, {rest}: "
                "another object's edge, or the shape?"
            )
        yield Finding("odd", 8.0 * size, f"{names[link]}: {text}", (int(link),))


def _doubted(past: Replay, links: LinkFacts) -> Iterator[Finding]:
    names = link_names(past.on[0].model)
    doubted = links.count[:, -1]
    for link in np.flatnonzero((doubted >= 2) & (doubted >= 0.25 * links.used)):
        text = (
            f"{names[link]}: {doubted[link]} of {links.used[link]} found edges count for next to nothing: too far off."
        )
        yield Finding("odd", 20.0 * float(doubted[link] / links.used[link]), text, (int(link),))


def _contradictions(past: Replay, evidence: Evidence, joints: JointFacts, links: LinkFacts) -> Iterator[Finding]:
    """Joints that evidence pushes both ways by more than they are said to be uncertain, or by a degree."""
    names = link_names(past.on[0].model)
    prior = prior_pull(past, evidence)[0]
    noise = np.sqrt(np.diag(past.on[0].model.coupling @ evidence.covariance @ past.on[0].model.coupling.T))
    noise = noise * joint_scale(past.on[0].model)
    for j in range(len(joints.names)):
        pulls = np.append(links.pull[:, j], prior[j])
        words = [*names, "the prediction"]
        least = max(1.0, 0.15 * float(noise[j]))
        up, down = int(np.argmax(pulls)), int(np.argmin(pulls))
        if pulls[up] < least or -pulls[down] < least:
            continue
        text = (
            f"{joints.names[j]} is pulled both ways: {signed(pulls[up])}{joints.units[j]} by {words[up]}, "
            f"{signed(pulls[down])}{joints.units[j]} by {words[down]}."
        )
        yield Finding("odd", 6.0 * float(min(pulls[up], -pulls[down])), text, tuple({up, down} - {len(names)}))


def _consistency(past: Replay) -> Iterator[Finding]:
    scatter, shape = past.after.consistency.scatter, past.after.consistency.shape
    if scatter.s > 3.0 or scatter.tau > 0.6:
        text = (
            f"Edges of all frames so far scatter {scatter.s:.1f} times as far as they claim, whole sides by "
            f"{scatter.tau:.1f} px: the sigmas of the pose are widened for it."
        )
        yield Finding("odd", 3.0 * max(scatter.s / 3.0, scatter.tau), text)
    if shape.eps > 0.03:
        text = f"Residuals look as if lengths and radii of the model were off by {100 * shape.eps:.0f} %: calibrate it."
        yield Finding("odd", 400.0 * shape.eps, text)


def count_words(links: LinkFacts) -> str:
    """Outcomes of all samplers in one line."""
    parts = [f"{int(links.count[:, FOUND].sum())} accepted", f"{int(links.count[:, -1].sum())} doubted"]
    parts += [f"{number} {words}" for reason, words in _WHY if (number := int(links.count[:, reason].sum()))]
    return ", ".join(parts)
