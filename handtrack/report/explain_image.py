"""A replayed frame and its evidence in; one view's image with everything drawn on it out, as inline SVG.

The coordinates of the drawing are those of the image: (0, 0) is the centre of the top-left pixel. Layers are groups
with a class each, which the page shows and hides; samplers carry the name of their card.
"""

import base64
import html
from collections.abc import Iterator

import cv2
import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..camera import project_camera
from ..edges import FOUND, HIDDEN, JOINT, REASONS
from ..kinematics import Model
from ..measure import Look, posed
from ..outlines import merged_polygon, silhouettes
from ..pills import Pills
from ..replay import Replay
from ..residuals import Chain, LineFeatures
from ..visibility import truncated_polygons
from .explain_evidence import Evidence, link_names
from .explain_lines import draw_lines
from .fingers import fingers_of

ARROW = 10.0  # times as long as the residual
_LONGEST = 90.0  # pixels of an arrow
_AROUND = 24.0  # pixels of image around the hand
_TICK = 3.5  # pixels of a sampler to either side of the edge
_ARC = 14  # points on a round end
_GREEN, _BLUE = "#41d67f", "#7aa7d9"
COLOURS = (_GREEN, _BLUE, "#8b8f98", "#b98d5a", "#b48cff", "#ff5ac8", "#ff5252", "#ffc233")
OUTCOMES = (*REASONS, "found, but too far off to count")
SHORT = ("accepted", "hidden", "no depth step", "outside", "no contrast", "end of range", "misfit", "doubted")


def scene_svg(past: Replay, evidence: Evidence, view: int, true: Float[np.ndarray, " j"] | None) -> str:
    """One view's image with all layers.

    Parameters
    ----------
    true : (j,) or None
        The true pose, radians, drawn if it is whole.
    """
    on, look = past.on[view], past.frame.estimate.seen[view]
    width, height = on.camera.width, on.camera.height
    model, rival, found = on.model, past.frame.other, past.frame.estimate
    layers = [
        ("windows", _windows(past, look, on)),
        ("predicted", _outlines(posed(on, found.prior.mean), on, model)),
        ("rival", _outlines(posed(on, rival[model.free]), on, model) if rival is not None else iter(())),
        ("truth", _outlines(posed(on, true[model.free]), on, model) if true is not None else iter(())),
        ("fitted", _fitted(posed(on, found.u), on, model)),
        ("lines", draw_lines(past, view) if isinstance(look.features, LineFeatures) else iter(())),
        ("arrows", _arrows(evidence, view)),
        ("samplers", _samplers(look, evidence.outcome[view], view)),
        ("names", _names(posed(on, found.u), on, model)),
    ]
    groups = "".join(f'<g class="layer {name}">{"".join(items)}</g>' for name, items in layers)
    x, y, wide, high = _crop(posed(on, found.u), on)
    return (
        f'<svg class="scene" style="font-size:{0.0165 * wide:.1f}px" viewBox="{x:.1f} {y:.1f} {wide:.1f} {high:.1f}" '
        f'data-width="{width}" data-height="{height}" role="img" aria-label="Image of view {view} with outlines, '
        f'samplers and residuals">'
        f'<image href="{_png(past.images[view])}" x="-0.5" y="-0.5" width="{width}" height="{height}"/>{groups}</svg>'
    )


def _crop(pills: Pills, on: Chain) -> tuple[float, float, float, float]:
    """The part of the image that is shown first: the hand with a margin, in the shape of the image."""
    size = np.array([on.camera.width, on.camera.height], dtype=float)
    points = silhouettes(pills, on.camera, _ARC).reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)].clip(-0.5, size - 0.5)
    low, high = (points.min(axis=0), points.max(axis=0)) if points.size else (np.zeros(2) - 0.5, size - 0.5)
    share = min(1.0, max(0.25, float(((high - low + 2.0 * _AROUND) / size).max())))
    corner = np.clip(0.5 * (low + high) - 0.5 * share * size, -0.5, size * (1.0 - share) - 0.5)
    return float(corner[0]), float(corner[1]), float(share * size[0]), float(share * size[1])


def _png(image: Float[np.ndarray, "h w"]) -> str:
    grey = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return "data:image/png;base64," + base64.b64encode(cv2.imencode(".png", grey)[1].tobytes()).decode("ascii")


def path_of(points: Float[np.ndarray, "n 2"], closed: bool = True) -> str:
    """An SVG path through points, to a tenth of a pixel.

    >>> path_of(np.array([[0.0, 1.0], [2.25, 3.0]]), closed=False)
    'M0 1L2.2 3'
    """
    rounded = (np.round(points, 1) + 0.0).tolist()
    return "M" + "L".join(f"{x:.6g} {y:.6g}" for x, y in rounded) + ("Z" if closed else "")


def short(value: float) -> str:
    """A number with one decimal, or none if that is zero."""
    text = f"{value + 0.0:.1f}"
    return "0" if text == "-0.0" else text.removesuffix(".0")


def finger_of_links(model: Model) -> Int[np.ndarray, " l"]:
    """Number of each link's finger in `fingers_of`, which sets its colour."""
    number = np.zeros(model.link_frame.size, dtype=int)
    for i, finger in enumerate(fingers_of(model)):
        number[list(finger.links)] = i
    return number


def _outlines(pills: Pills, on: Chain, model: Model) -> Iterator[str]:
    """The outline of each finger, its links merged."""
    polygons, number = silhouettes(pills, on.camera, _ARC), finger_of_links(model)
    for finger in np.unique(number):
        merged = merged_polygon(list(polygons[number == finger]))
        yield f'<path class="f{finger % 8}" d="{geometry_path(merged)}"/>'


def geometry_path(shape: shapely.Geometry) -> str:
    """Path along all rings of a polygon or several."""
    rings = [ring for part in shapely.get_parts(shape) for ring in shapely.get_rings(part)]
    return "".join(path_of(shapely.get_coordinates(ring)[:-1]) for ring in rings)


def _fitted(pills: Pills, on: Chain, model: Model) -> Iterator[str]:
    """The outline with the axes of the links and their joints."""
    yield from _outlines(pills, on, model)
    number = finger_of_links(model)
    base, tip = (project_camera(on.camera, end) for end in (pills.base, pills.tip))
    for link in np.flatnonzero(np.isfinite(base).all(axis=1) & np.isfinite(tip).all(axis=1)):
        ends = path_of(np.stack([base[link], tip[link]]), closed=False)
        x, y = (short(v) for v in base[link].tolist())
        yield f'<path class="axis f{number[link] % 8}" data-link="{link}" d="{ends}"/>'
        yield f'<circle cx="{x}" cy="{y}" r="1.6"/>'


def runs(mask: Bool[np.ndarray, " m"]) -> list[tuple[int, int]]:
    """First and last index of each run of True.

    >>> runs(np.array([True, True, False, True]))
    [(0, 1), (3, 3)]
    """
    change = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(a), int(b) - 1) for a, b in change.reshape(-1, 2)]


def _windows(past: Replay, look: Look, on: Chain) -> Iterator[str]:
    """What each sampler may compare; and the truncated polygons where these decide it."""
    u, half = look.templates.u, 0.5 * float(look.templates.u[1] - look.templates.u[0])
    start = look.samplers.origin + look.edges.offset[:, None] * look.samplers.direction
    for i in np.flatnonzero(look.templates.visible.any(axis=1)):
        for first, last in runs(look.templates.visible[i]):
            ends = start[i] + np.array([[u[first] - half], [u[last] + half]]) * look.samplers.direction[i]
            yield f'<path class="window" d="{path_of(ends, closed=False)}"/>'
    if past.settings.visibility == "polygons":
        layers = truncated_polygons(look.pills, on.camera, on.model.link_finger)
        for link, shape in enumerate(layers.truncated):
            yield f'<path class="polygon" data-link="{link}" d="{geometry_path(shape)}"/>'


def _arrows(evidence: Evidence, view: int) -> Iterator[str]:
    """From the fitted model towards the evidence, ten times as long as the residual."""
    rows = evidence.rows
    for i in np.flatnonzero((rows.view == view) & np.isfinite(rows.xy).all(axis=1)):
        start = rows.xy[i] - rows.residual[i] * rows.direction[i]
        long = float(np.clip(ARROW * rows.residual[i], -_LONGEST, _LONGEST))
        end = start + long * rows.direction[i]
        outcome = 7 if rows.weight[i] < 0.3 else 0
        yield (
            f'<path class="o{outcome}" data-link="{rows.link[i]}" style="opacity:{0.35 + 0.65 * rows.weight[i]:.2f}" '
            f'd="{path_of(np.stack([start, end]), closed=False)}"/>'
        )


def _samplers(look: Look, outcome: Int[np.ndarray, " n"], view: int) -> Iterator[str]:
    """A tick across the outline for each sampler, and a dot where it found the edge; those without an edge below."""
    names = [html.escape(text) for text in OUTCOMES]
    order = np.argsort(np.isin(outcome, (FOUND, 7)).astype(int) - np.isin(outcome, (HIDDEN, JOINT)), kind="stable")
    for i in order:
        if not np.isfinite(look.samplers.origin[i]).all():
            continue
        ends = look.samplers.origin[i] + np.array([[-_TICK], [_TICK]]) * look.samplers.direction[i]
        line = path_of(ends, closed=False)
        dot = ""
        if look.edges.reason[i] == FOUND:
            x, y = (short(v) for v in look.edges.xy[i].tolist())
            dot = f'<circle cx="{x}" cy="{y}" r="1.3"/>'
        yield (
            f'<g class="s o{outcome[i]}" data-s="s{view}-{i}" data-link="{look.samplers.link[i]}">'
            f'<title>{names[outcome[i]]}</title><path class="hit" d="{line}"/><path d="{line}"/>{dot}</g>'
        )


def _names(pills: Pills, on: Chain, model: Model) -> Iterator[str]:
    middle = project_camera(on.camera, 0.5 * (pills.base + pills.tip))
    for link, name in enumerate(link_names(model)):
        if np.isfinite(middle[link]).all():
            x, y = (short(v) for v in middle[link].tolist())
            yield f'<text x="{x}" y="{y}" data-link="{link}">{html.escape(name)}</text>'
