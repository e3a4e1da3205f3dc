"""Figures of joints and links in, the tables of the page out."""

import html
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from ..edges import HIDDEN, OUTSIDE
from ..kinematics import Model
from ..replay import Replay
from .explain_evidence import Evidence, link_names
from .explain_facts import JointFacts, LinkFacts, prior_pull, signed
from .explain_image import finger_of_links
from .explain_lines import boundaries, votes
from .explain_truth import TruthFacts

_DASH = "\N{EN DASH}"


def joint_table(joints: JointFacts, truth: TruthFacts | None) -> str:
    """A row for each joint: from prediction over fit to filter, and what decided it."""
    header = ["joint", "predicted", "fitted", "moved", "filtered", "sigma", "images alone", "decided by prediction", ""]
    rows = []
    for j, name in enumerate(joints.names):
        unit = joints.units[j]
        image = joints.image_sigma[j]
        cells = [
            f"<th>{html.escape(name)}</th>",
            _cell(_number(joints.predicted[j], unit)),
            _cell(f"<b>{_number(joints.fitted[j], unit)}</b>"),
            _cell(signed(joints.fitted[j] - joints.predicted[j], 2) + unit),
            _cell(_number(joints.filtered[j], unit)),
            _cell(f"{joints.sigma[j]:.2f}{unit}"),
            _cell(f"{image:.2f}{unit}" if np.isfinite(image) else "nothing"),
            _share(float(joints.prior_share[j])),
            _cell(_state(joints, j), "words"),
        ]
        if truth is not None:
            cells += _truth_cells(joints, truth, j)
        rows.append(f"<tr>{''.join(cells)}</tr>")
    if truth is not None:
        header += ["off the truth", "in sigmas", "if predicted from truth"]
    return _table(header, rows)


def _truth_cells(joints: JointFacts, truth: TruthFacts, j: int) -> list[str]:
    error, unit = float(truth.error[j]), joints.units[j]
    sigmas = abs(error) / max(float(joints.sigma[j]), 1e-9)
    kind = "bad" if sigmas > 2.0 and abs(error) > 0.5 else ""
    return [
        _cell(signed(error, 2) + unit, kind),
        _cell(f"{sigmas:.1f}", kind),
        _cell(signed(truth.trial_error[j], 2) + unit),
    ]


def _state(joints: JointFacts, j: int) -> str:
    words = ["images say little"] if joints.unseen[j] else []
    if joints.at_limit[j]:
        words.append("at its upper limit" if joints.at_limit[j] > 0 else "at its lower limit")
    weak = [name for name, _ in joints.weak if joints.names[j] in name.split()]
    if weak:
        words.append(f"weak: {html.escape(weak[0])}")
    return "; ".join(words)


def link_table(past: Replay, links: LinkFacts, joints: JointFacts, truth: TruthFacts | None) -> str:
    """A row for each link: what was found of it, and what it did to the pose."""
    names, number = link_names(past.on[0].model), finger_of_links(past.on[0].model)
    header = ["link", "visible", "expected", "found", "doubted", "residual RMS", "sides", "tip", "weight", "pulls most"]
    off = None if truth is None else _off_by_link(past, truth, len(names))
    header += [] if off is None else ["edges off the truth"]
    rows = []
    for link, name in enumerate(names):
        expected = int(links.total[link] - links.count[link, HIDDEN] - links.count[link, OUTSIDE])
        found = int(links.used[link])
        j = int(np.argmax(np.abs(links.pull[link]))) if links.pull.size else 0
        pull = float(links.pull[link, j])
        strongest = (
            f"{html.escape(joints.names[j])} {signed(pull, 2)}{joints.units[j]}" if abs(pull) >= 0.005 else _DASH
        )
        cells = [
            f'<th><i class="chip f{number[link] % 8}"></i>{html.escape(name)}</th>',
            _cell(f"{100 * links.visible[link]:.0f} %" if links.total[link] else _DASH),
            _cell(str(expected)),
            _cell(str(found), "bad" if found < 0.65 * expected else ""),
            _cell(str(int(links.count[link, -1])) if links.count[link, -1] else _DASH),
            _cell(_pixels(links.rms[link]), "bad" if links.rms[link] > 1.0 else ""),
            _cell(" / ".join(_signed_pixels(v) for v in links.side[link, :2])),
            _cell(_signed_pixels(links.side[link, 2])),
            _cell(f"{links.weight[link]:.2f}" if np.isfinite(links.weight[link]) else _DASH),
            _cell(strongest),
        ]
        if off is not None:
            cells.append(_cell(_pixels(off[link])))
        rows.append(f'<tr data-link="{link}">{"".join(cells)}</tr>')
    return _table(header, rows)


def _off_by_link(past: Replay, truth: TruthFacts, links: int) -> Float[np.ndarray, " l"]:
    total, count = np.zeros(links), np.zeros(links)
    for look, off in zip(past.frame.estimate.seen, truth.off, strict=True):
        known = np.isfinite(off)
        total += np.bincount(look.samplers.link[known], off[known] ** 2, links)
        count += np.bincount(look.samplers.link[known], minlength=links)
    return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)


def pull_table(past: Replay, evidence: Evidence, links: LinkFacts, joints: JointFacts) -> str:
    """Which link pushes which joint, how far; the columns add up to zero."""
    prior, rest = prior_pull(past, evidence)
    names = [*link_names(past.on[0].model), "prediction", "limits, grey levels"]
    pulls = np.vstack([links.pull, prior, rest])
    kept = np.append(np.ones(len(names) - 1, dtype=bool), bool((np.abs(rest) > 0.02).any()))
    largest = float(np.abs(pulls).max(initial=1e-9))
    rows = []
    for name, row, link in zip(np.array(names)[kept], pulls[kept], np.flatnonzero(kept), strict=True):
        cells = "".join(_heat(float(value), largest) for value in row)
        mark = f' data-link="{link}"' if link < links.rms.size else ' class="sum"'
        rows.append(f"<tr{mark}><th>{html.escape(name)}</th>{cells}</tr>")
    return _table(["pull of", *joints.names], rows, "pulls")


def vote_table(past: Replay) -> str:
    """Votes of the boundary lines, view by view; only for frames measured with lines."""
    names, rows = link_names(past.on[0].model), []
    for view in range(len(past.on)):
        for link, words in votes(boundaries(past, view)):
            at = _cell(str(view)) if len(past.on) > 1 else ""
            cells = f"<th>{html.escape(names[link])}</th>{at}{_cell(words)}"
            rows.append(f'<tr data-link="{link}">{cells}</tr>')
    header = ["link", *(["view"] if len(past.on) > 1 else []), "points that agree with its two boundary lines"]
    return _table(header, rows)


def settings_table(pairs: Iterable[tuple[str, str]]) -> str:
    """Names and values."""
    rows = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in pairs)
    return f'<table class="pairs">{rows}</table>'


def model_line(model: Model) -> str:
    """The model in a few words."""
    return f"model {model.name}, {len(model.joint_names)} joints, {model.link_frame.size} links"


def _heat(value: float, largest: float) -> str:
    """A cell coloured by sign and size; empty where nothing is pulled."""
    if abs(value) < 0.005:
        return "<td></td>"
    share = 100 * min(1.0, abs(value) / largest) ** 0.6
    colour = "var(--plus)" if value > 0 else "var(--minus)"
    return f'<td style="background:color-mix(in srgb,{colour} {0.75 * share:.0f}%,transparent)">{signed(value, 2)}</td>'


def _share(share: float) -> str:
    kind = " high" if share > 0.5 else ""
    return f'<td class="share{kind}"><i style="width:{100 * share:.0f}%"></i><span>{100 * share:.0f} %</span></td>'


def _table(header: Sequence[str], rows: Sequence[str], kind: str = "") -> str:
    head = "".join(f"<th>{html.escape(name)}</th>" for name in header)
    return (
        f'<div class="wide"><table class="facts-table {kind}"><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _cell(text: str, kind: str = "") -> str:
    return f'<td class="{kind}">{text}</td>' if kind else f"<td>{text}</td>"


def _number(value: float, unit: str) -> str:
    return f"{value:.2f}".replace("-", "\N{MINUS SIGN}") + unit


def _pixels(value: float) -> str:
    return f"{value:.2f} px" if np.isfinite(value) else _DASH


def _signed_pixels(value: float) -> str:
    return signed(value, 1) if np.isfinite(value) else _DASH
