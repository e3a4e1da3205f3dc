"""A replayed frame in, one small card for each sampler out: its profile, template and window above its WSSD curve.

Both share one axis, positions along the sampler in pixels from the predicted edge, outwards to the right: a template
shifted by k has its edge at k, so the lowest point of the curve stands below the edge it means. What the tracker let
go (curve, best shift of a rejected profile) is computed again from profile and template.
"""

import html
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..appearance import Appearance
from ..edges import BORDER, FLAT, FOUND, HIDDEN, JOINT, MISFIT, OUTSIDE
from ..edges.wssd import curves, search
from ..measure import Look
from ..replay import Replay
from .explain_evidence import DOUBTED, Evidence, appearance_of, hiding_links, link_names, outline_edge
from .explain_facts import joint_scale, joint_units, signed
from .explain_findings import compass
from .explain_image import OUTCOMES, SHORT, path_of, runs, short

_WIDTH, _TOP, _GAP, _LOW = 240.0, 82.0, 10.0, 52.0  # of a card's drawing, its two panels and what is between them
_COUNTED = 8  # samples that a profile counts for, as in `edges.wssd`


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """What the search for edges saw in one view.

    Attributes
    ----------
    shift : (k,)
        Shifts in pixels.
    wssd, cost : (n, k)
        Mean square difference at each shift, inf where too little is seen; and the same with what the prediction adds.
    best, rise, used : (n,)
        The best shift within reach in pixels, the template's contrast in grey levels, its visible samples.
    """

    shift: Float[np.ndarray, " k"]
    wssd: Float[np.ndarray, "n k"]
    cost: Float[np.ndarray, "n k"]
    best: Float[np.ndarray, " n"]
    rise: Float[np.ndarray, " n"]
    used: Int[np.ndarray, " n"]


def searched(look: Look, appearance: Appearance) -> Searched:
    """The WSSD curves of a view again.

    The standard deviation of the prediction is read off the reach, `3 sigma + 1`; it was cut for the widest searches.
    """
    predicted = np.maximum((look.reach - 1.0) / 3.0, 0.0) + 0.5
    scale2 = max(appearance.spread, appearance.noise) ** 2
    best, _, rise, used, shift = search(look.profiles, look.templates, look.reach, predicted, scale2)
    wssd = curves(look.profiles, look.templates)
    weight = np.clip(used, 1, _COUNTED)[:, None] / scale2
    return Searched(shift, wssd, wssd + (shift / predicted[:, None]) ** 2 / weight, shift[best], rise, used)


@dataclass(frozen=True, slots=True)
class _Scale:
    """Positions along a sampler, `low` to `high`, as those in a card's drawing."""

    low: float
    high: float

    def __call__(self, at: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return (at - self.low) / (self.high - self.low) * _WIDTH


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """What all cards of a view are made from."""

    past: Replay
    evidence: Evidence
    number: int
    names: tuple[str, ...]
    look: Look
    found: Searched
    appearance: Appearance
    front: Int[np.ndarray, " n"]
    outline: Float[np.ndarray, " n"]
    off: Float[np.ndarray, " n"] | None


def cards(past: Replay, evidence: Evidence, view: int, off: Float[np.ndarray, " n"] | None) -> Iterator[str]:
    """Cards of one view as HTML, those with the largest pull first, then those without an edge.

    Parameters
    ----------
    off : (n,) or None
        Distance of each accepted edge from the true outline, where the truth is known.
    """
    look, on = past.frame.estimate.seen[view], past.on[view]
    appearance = appearance_of(past)[view]
    found, front = searched(look, appearance), hiding_links(on, look)
    names, outline = link_names(on.model), outline_edge(past, evidence, view)
    each = _View(past, evidence, view, names, look, found, appearance, front, outline, off)
    row = evidence.row_of[view]
    strength = np.append(np.abs(_pulls(past, evidence)).max(axis=1, initial=0.0), 0.0)[row]
    outcome = evidence.outcome[view]
    rank = np.select([np.isin(outcome, (FOUND, DOUBTED)), ~np.isin(outcome, (HIDDEN, JOINT, OUTSIDE))], [0, 1], 2)
    for i in np.lexsort((look.samplers.link, -strength, rank)):
        yield _card(each, int(i), float(strength[i]))


def _pulls(past: Replay, evidence: Evidence) -> Float[np.ndarray, "n j"]:
    model = past.on[0].model
    return evidence.rows.pull @ model.coupling.T * joint_scale(model)


def _card(each: _View, i: int, strength: float) -> str:
    look, outcome = each.look, int(each.evidence.outcome[each.number][i])
    row = int(each.evidence.row_of[each.number][i])
    residual = abs(float(each.evidence.rows.residual[row])) if row >= 0 else -1.0
    link = int(look.samplers.link[i])
    name = html.escape(each.names[link])
    return (
        f'<figure class="card o{outcome}" id="s{each.number}-{i}" data-link="{link}" data-outcome="{outcome}" '
        f'data-pull="{strength:.4f}" data-residual="{residual:.3f}"><figcaption><span><b>{name}</b> '
        f'{_place(look, i)}</span><span class="chip-o">{html.escape(SHORT[outcome])}</span></figcaption>'
        f"{_drawing(each, i)}"
        f"<p>{html.escape(_words(each, i, outcome, row))}</p></figure>"
    )


def _place(look: Look, i: int) -> str:
    side = int(look.samplers.side[i])
    if side:
        return f"{compass(look.samplers.direction[i])} side, at {look.samplers.along[i]:.2f}"
    if look.samplers.along[i] >= 1.0:
        return f"tip, {compass(look.samplers.direction[i])}"
    return f"across, at {look.samplers.along[i]:.2f}"


def _words(each: _View, i: int, outcome: int, row: int) -> str:
    """What became of a sampler, with its figures."""
    look, edges = each.look, each.look.edges
    if outcome not in (FOUND, DOUBTED):
        return _why_not(each, i, outcome)
    place = f"{signed(edges.offset[i], 2)} \N{PLUS-MINUS SIGN} {edges.sigma[i]:.2f} px"
    said = f"Edge at {place} from where it was looked for. "
    if row >= 0:
        rows = each.evidence.rows
        sigmas = rows.residual[row] / rows.sigma[row]
        said += (
            f"Residual {signed(rows.residual[row], 2)} px ({signed(sigmas)} sigmas), weight {rows.weight[row]:.2f}. "
        )
        said += _pull_words(each, row)
    if each.off is not None and np.isfinite(each.off[i]):
        said += f" {signed(each.off[i])} px from the true outline."
    if outcome == DOUBTED:
        said += " Too far off the others to count."
    return said if look.found[i] else f"{said} Not used."


def _pull_words(each: _View, row: int) -> str:
    model = each.past.on[0].model
    pull = each.evidence.rows.pull[row] @ model.coupling.T * joint_scale(model)
    units = joint_units(model)
    strongest = [j for j in np.argsort(-np.abs(pull))[:2] if abs(pull[j]) >= 0.005]
    if not strongest:
        return "Pulls no joint by a hundredth."
    return "Pulls " + ", ".join(f"{model.joint_names[j]} {signed(pull[j], 2)}{units[j]}" for j in strongest) + "."


def _why_not(each: _View, i: int, outcome: int) -> str:
    found, noise = each.found, each.appearance.noise
    best, rise = float(found.best[i]), float(found.rise[i])
    place = int(np.argmin(np.abs(found.shift - best)))
    left = float(np.sqrt(found.wssd[i, place])) if np.isfinite(found.wssd[i, place]) else np.nan
    if outcome == HIDDEN:
        front = int(each.front[i])
        by = f" {each.names[front].capitalize()} stands in front." if front >= 0 else ""
        return f"Hidden by another finger.{by}"
    why = {
        OUTSIDE: "Too much of the window is outside the image.",
        FLAT: f"Contrast of {rise:.1f} grey levels for noise of {noise:.1f}: no edge that can be told to 1.5 px.",
        BORDER: f"The best place, {signed(best)} px, is at the end of the {each.look.reach[i]:.1f} px searched: the "
        "edge may lie beyond.",
        MISFIT: f"Even at the best place, {signed(best)} px, template and image differ by {left:.0f} grey levels RMS, "
        f"for a contrast of {rise:.0f}.",
    }
    plain = f"{OUTCOMES[outcome].capitalize()}."
    return why.get(outcome, plain) if each.past.settings.edges == "wssd" else plain


def _drawing(each: _View, i: int) -> str:
    """Profile, template and window above; WSSD below."""
    look, found = each.look, each.found
    u, values = look.profiles.u, np.where(look.profiles.inside[i], look.profiles.values[i], np.nan)
    x = _Scale(float(u[0]), float(u[-1]))
    seen = bool(look.edges.reason[i] == FOUND)
    place = float(look.edges.offset[i] if seen else found.best[i])
    tx = look.templates.u + place
    levels = np.concatenate([values, look.templates.values[i]])
    levels = levels[np.isfinite(levels)]
    span = (float(levels.min()), max(float(levels.max()), float(levels.min()) + 12.0)) if levels.size else (0.0, 255.0)
    parts = [_window_rects(look, i, x(tx)), _reach_rects(float(look.reach[i]), x)]
    parts += [_polyline("profile", x(u), _up(values, span, 0.0, _TOP))]
    kind = "template" if seen else "template try"
    parts += [_polyline(kind, x(tx), _up(look.templates.values[i], span, 0.0, _TOP))]
    if each.past.settings.edges == "wssd":
        parts += list(_curves(found, i, float(look.reach[i]), x))
    parts += list(_marks(each, i, seen, place, x))
    height = _TOP + _GAP + _LOW + 11.0
    return f'<svg viewBox="0 0 {_WIDTH:.0f} {height:.0f}">{"".join(parts)}{_labels(each, i, span, x, height)}</svg>'


def _window_rects(look: Look, i: int, x: Float[np.ndarray, " m"]) -> str:
    half = 0.5 * float(x[1] - x[0])
    return "".join(
        f'<rect class="window" x="{short(x[a] - half)}" y="0" width="{short(x[b] - x[a] + 2 * half)}" '
        f'height="{_TOP:.0f}"/>'
        for a, b in runs(look.templates.visible[i])
    )


def _reach_rects(reach: float, x: _Scale) -> str:
    """The panel of the curve, lighter where it was searched."""
    a, b = x(np.array([-reach, reach])).clip(0.0, _WIDTH)
    y = _TOP + _GAP
    return (
        f'<rect class="panel" x="0" y="{y:.0f}" width="{_WIDTH:.0f}" height="{_LOW:.0f}"/>'
        f'<rect class="reach" x="{short(a)}" y="{y:.0f}" width="{short(b - a)}" height="{_LOW:.0f}"/>'
    )


def _curves(found: Searched, i: int, reach: float, x: _Scale) -> Iterator[str]:
    """The WSSD over shifts, and dotted what the search minimises: with the cost of being far from the prediction."""
    near = np.abs(found.shift) <= reach + 3.0
    wssd = np.where(near & np.isfinite(found.wssd[i]), found.wssd[i], np.nan)
    if not np.isfinite(wssd).any():
        return
    cost = np.where(np.isfinite(wssd) & (np.abs(found.shift) <= reach), found.cost[i], np.nan)
    span = (0.0, max(float(np.nanmax(wssd)), 1.0))
    y = _TOP + _GAP
    yield _polyline("cost", x(found.shift), _up(np.minimum(cost, span[1]), span, y, _LOW))
    yield _polyline("wssd", x(found.shift), _up(wssd, span, y, _LOW))
    yield f'<text x="2" y="{y + 8:.0f}">WSSD to {span[1]:.0f}</text>'


def _marks(each: _View, i: int, seen: bool, place: float, x: _Scale) -> Iterator[str]:
    """The predicted place, the found one with its band of two sigmas, and where the fitted outline is."""
    bottom = _TOP + _GAP + _LOW
    zero = short(float(x(np.array([0.0]))[0]))
    yield f'<path class="zero" d="M{zero} 0V{bottom:.0f}"/>'
    if seen:
        sigma = min(float(each.look.edges.sigma[i]), 20.0)
        a, at, b = x(np.array([place - 2 * sigma, place, place + 2 * sigma]))
        yield f'<rect class="band" x="{short(a)}" y="0" width="{max(b - a, 0.6):.1f}" height="{bottom:.0f}"/>'
        yield f'<path class="at" d="M{short(at)} 0V{bottom:.0f}"/>'
        outline = float(each.outline[i])
        if np.isfinite(outline):
            yield f'<path class="outline" d="M{short(float(x(np.array([outline]))[0]))} 0V{bottom:.0f}"/>'
    elif each.found.used[i]:
        yield f'<path class="at try" d="M{short(float(x(np.array([place]))[0]))} 0V{bottom:.0f}"/>'


def _labels(each: _View, i: int, span: tuple[float, float], x: _Scale, height: float) -> str:
    reach = float(each.look.reach[i])
    ticks = [(at, signed(at, 0) if at else "0") for at in (-float(round(reach)), 0.0, float(round(reach)))]
    places = x(np.array([at for at, _ in ticks]))
    parts = [
        f'<text class="u" x="{short(float(at))}" y="{height - 2:.0f}">{text}</text>'
        for at, (_, text) in zip(places.clip(8.0, _WIDTH - 8.0), ticks, strict=True)
    ]
    parts.append(f'<text x="2" y="8">{span[1]:.0f}</text><text x="2" y="{_TOP - 2:.0f}">{span[0]:.0f}</text>')
    return "".join(parts)


def _up(
    values: Float[np.ndarray, " n"], span: tuple[float, float], top: float, height: float
) -> Float[np.ndarray, " n"]:
    """Values as heights in a panel, NaN where there is none."""
    return top + height - 2.0 - (values - span[0]) / (span[1] - span[0]) * (height - 4.0)


def _polyline(kind: str, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> str:
    """A path, interrupted where y is NaN."""
    finite = np.isfinite(y)
    points = np.stack([x, y], axis=1)
    pieces = [path_of(points[first : last + 1], closed=False) for first, last in runs(finite)]
    return f'<path class="{kind}" d="{"".join(pieces)}"/>'
