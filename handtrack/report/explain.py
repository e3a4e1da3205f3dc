"""One frame, tracked again, in; one HTML file out that shows why its pose is what it is.

The page's text, style and script are the files `explain.html`, `explain.css` and `explain.js` beside this module. It
loads nothing, and everything on it can be read without its script, which only adds zoom, choice and sorting.
"""

import html
from collections.abc import Sequence
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np

from ..formats.writing import write_text
from ..replay import Replay
from ..residuals import LineFeatures
from ..sequences import Truth
from .explain_cards import cards
from .explain_evidence import Evidence, appearance_of, evidence_of, link_names
from .explain_facts import joint_facts, link_facts
from .explain_findings import Finding, count_words, findings_of
from .explain_image import COLOURS, OUTCOMES, SHORT, scene_svg
from .explain_tables import joint_table, link_table, model_line, pull_table, settings_table, vote_table
from .explain_truth import TruthFacts, truth_facts
from .fingers import STATUS_COLOURS, finger_colour, fingers_of

_FOLDER = __name__.rpartition(".")[0]
_AT_ONCE = 8  # findings that are read without unfolding the rest
_LAYERS = (
    ("fitted", "fitted outline", True),
    ("predicted", "predicted", True),
    ("rival", "rival pose", True),
    ("truth", "truth", True),
    ("samplers", "samplers", True),
    ("arrows", "residuals \N{MULTIPLICATION SIGN} 10", True),
    ("lines", "lines and tips", True),
    ("windows", "windows", False),
    ("names", "names", True),
)


def write_explanation(
    path: Path, past: Replay, truth: Truth | None, title: str, warnings: Sequence[str] = ()
) -> tuple[Finding, ...]:
    """Write the page about one frame, whole or not at all, and return what it finds.

    Parameters
    ----------
    truth : Truth or None
        Used if it has a whole pose for this frame.
    title : str
        Name of the run.
    warnings : sequence of str
        What to say above everything else.
    """
    page, findings = render_explanation(past, truth, title, warnings)
    write_text(path, page)
    return findings


def render_explanation(
    past: Replay, truth: Truth | None, title: str, warnings: Sequence[str] = ()
) -> tuple[str, tuple[Finding, ...]]:
    """The text of the page, and its findings; see `write_explanation`."""
    evidence = evidence_of(past)
    known = _truth_of_frame(past, truth)
    joints, links = joint_facts(past, evidence), link_facts(past, evidence)
    findings = findings_of(past, evidence, joints, links, known)
    views = "".join(_view(past, evidence, view, known) for view in range(len(past.on)))
    status = past.frame.status
    page = Template(_asset("explain.html")).substitute(
        title=html.escape(f"{title}, frame {past.number}"),
        style=_colours(past) + _asset("explain.css"),
        warnings="".join(f'<p class="warning">{html.escape(text)}</p>' for text in warnings),
        status=f'<b class="status {status}">{status}</b>',
        subtitle=html.escape(_subtitle(past, count_words(links))),
        findings=_findings(findings),
        views=views,
        joints=joint_table(joints, known),
        links=link_table(past, links, joints, known),
        pulls=pull_table(past, evidence, links, joints),
        votes=_votes(past),
        settings=settings_table((name, str(value)) for name, value in asdict(past.settings).items()),
        appearance=settings_table(_learnt(past)),
        link_choices="".join(
            f'<option value="{i}">{html.escape(name)}</option>' for i, name in enumerate(link_names(past.on[0].model))
        ),
        outcome_choices="".join(f'<option value="{i}">{html.escape(text)}</option>' for i, text in enumerate(SHORT)),
        cards="".join(_card_section(past, evidence, view, known) for view in range(len(past.on))),
        script=_asset("explain.js"),
    )
    return page, findings


def _asset(name: str) -> str:
    return resources.files(_FOLDER).joinpath(name).read_text(encoding="utf-8")


def _truth_of_frame(past: Replay, truth: Truth | None) -> TruthFacts | None:
    if truth is None:
        return None
    row = np.flatnonzero(truth.frame == past.number)
    if not row.size or not np.isfinite(truth.q[row[0]]).all():
        return None
    return truth_facts(past, truth.q[row[0]])


def _colours(past: Replay) -> str:
    """Colours of status, outcomes and fingers, which the rest of the reports share."""
    status = "".join(f"--{name}:{colour};" for name, colour in STATUS_COLOURS)
    outcomes = "".join(f".o{i}{{--o:{colour}}}" for i, colour in enumerate(COLOURS))
    fingers = "".join(f".f{i}{{--s:{finger_colour(i)}}}" for i in range(min(8, len(fingers_of(past.on[0].model)))))
    return f":root{{{status}}}{outcomes}{fingers}"


def _subtitle(past: Replay, counted: str) -> str:
    found = past.frame.estimate
    count = len(past.on)
    views = f"{count} views, " if count > 1 else ""
    return (
        f"{views}{past.time:.2f} s; {model_line(past.on[0].model)}; confidence {past.frame.confidence:.2f}, residual "
        f"{found.residual:.2f} px RMS. Samplers: {counted}."
    )


def _findings(findings: Sequence[Finding]) -> str:
    items = [
        f'<li class="{finding.level}" data-links="{" ".join(map(str, finding.links))}">{html.escape(finding.text)}</li>'
        for finding in findings
    ]
    first, rest = items[:_AT_ONCE], items[_AT_ONCE:]
    more = f"<details><summary>{len(rest)} more</summary><ol>{''.join(rest)}</ol></details>" if rest else ""
    return f"<ol>{''.join(first)}</ol>{more}"


def _view(past: Replay, evidence: Evidence, view: int, known: TruthFacts | None) -> str:
    """One image with its switches for layers and its key."""
    lines = isinstance(past.frame.estimate.seen[view].features, LineFeatures)
    boxes, labels = [], []
    for name, words, shown in _LAYERS:
        absent = {"truth": known is None, "lines": not lines, "rival": past.frame.other is None}
        if absent.get(name, False):
            continue
        boxes.append(f'<input type="checkbox" class="switch {name}" id="v{view}-{name}"{" checked" if shown else ""}>')
        labels.append(f'<label for="v{view}-{name}"><i class="key {name}"></i>{words}</label>')
    title = f"<h3>View {view}</h3>" if len(past.on) > 1 else ""
    svg = scene_svg(past, evidence, view, None if known is None else known.q)
    return (
        f'<section class="view">{title}{"".join(boxes)}<div class="switches">{"".join(labels)}'
        f'<span class="zoom" hidden><button type="button" data-zoom="in">+</button><button type="button" '
        f'data-zoom="out">\N{MINUS SIGN}</button><button type="button" data-zoom="all">all</button></span></div>'
        f'<div class="stage">{svg}</div>{_outcome_key(evidence, view)}</section>'
    )


def _outcome_key(evidence: Evidence, view: int) -> str:
    """The outcomes that occur, with their colours and numbers."""
    count = np.bincount(evidence.outcome[view], minlength=len(OUTCOMES))
    items = "".join(
        f'<li class="o{i}"><i></i>{html.escape(OUTCOMES[i])} <b>{count[i]}</b></li>' for i in np.flatnonzero(count)
    )
    return f'<ul class="outcomes">{items}</ul>'


def _card_section(past: Replay, evidence: Evidence, view: int, known: TruthFacts | None) -> str:
    title = f"<h3>View {view}</h3>" if len(past.on) > 1 else ""
    off = None if known is None else known.off[view]
    return f'{title}<div class="cards">{"".join(cards(past, evidence, view, off))}</div>'


def _votes(past: Replay) -> str:
    if not all(isinstance(look.features, LineFeatures) for look in past.frame.estimate.seen):
        return ""
    return f'<h2>Votes for boundary lines</h2><section class="card-box">{vote_table(past)}</section>'


def _learnt(past: Replay) -> list[tuple[str, str]]:
    """What earlier frames had taught of light, noise and honesty when this one came."""
    scatter, shape = past.after.consistency.scatter, past.after.consistency.shape
    pairs = [
        ("edges scatter, times their sigmas", f"{scatter.s:.2f}"),
        ("common offset of a side", f"{scatter.tau:.2f} px"),
        ("error of the model's shape", f"{100 * shape.eps:.1f} %"),
        ("search wider than predicted", f"{past.frame.estimate.widen:.2g} times"),
    ]
    for view, look in enumerate(appearance_of(past)):
        at = f" (view {view})" if len(past.on) > 1 else ""
        pairs += [
            (f"noise, spread{at}", f"{look.noise:.1f}, {look.spread:.1f} grey levels"),
            (f"background{at}", f"{look.background:.0f}"),
            (f"blur{at}", f"{look.blur:.2f} px"),
        ]
    return pairs
