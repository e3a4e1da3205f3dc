"""A replayed frame in; every residual row with its weight and its pull on the pose, and every sampler's outcome out.

At the fitted pose the pulls of all evidence balance. With `r` the residuals in units of sigma, `J` their derivative,
`W` the map that makes their errors independent, `D` the robust weights over the squared scale, `L` the information of
the prediction and `C` the covariance of the pose,

    sum_i p_i + p_prior = 0,    p_i = -C (J^T W D W)_i r_i,    p_prior = -C L (u - mean)

so `p_i` is how far edge i pushes each joint against all others: what the pose would move, to first order, if the edge
were not there. `C L` is the share that the prediction has in each joint.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..appearance import Appearance
from ..camera import project
from ..edges import FOUND, HIDDEN
from ..kinematics import Model, forward, link_ends, pose_from_free
from ..measure import Look
from ..replay import Replay
from ..residuals import Chain, LineFeatures, OutlineFeatures, outline_residuals
from ..scatter import whitener
from ..visibility import first_links
from .fingers import fingers_of

DOUBTED = 7  # an outcome beyond the reasons of `edges`: found, but with less than `DOUBT` of its weight
DOUBT = 0.3
_ORDINALS = {1: ("",), 2: ("proximal", "distal"), 3: ("proximal", "middle", "distal")}


@dataclass(frozen=True, slots=True, eq=False)
class EvidenceRows:
    """Residual rows of a fitted frame, in the order of the fit; those of all views stacked.

    Attributes
    ----------
    view, link : (n,)
    sampler : (n,)
        The sampler that gave the edge; -1 for rows of lines and tips.
    xy, direction : (n, 2)
        Where the evidence stands in the image of its view, and the unit vector along which the residual counts.
    residual, sigma : (n,)
        Distance of the evidence from the fitted model along `direction`, and its standard deviation, pixels.
    weight : (n,)
        Robust weight, 0 to 1.
    pull : (n, k)
        How far the row pushes each independent joint.
    """

    view: Int[np.ndarray, " n"]
    link: Int[np.ndarray, " n"]
    sampler: Int[np.ndarray, " n"]
    xy: Float[np.ndarray, "n 2"]
    direction: Float[np.ndarray, "n 2"]
    residual: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]
    pull: Float[np.ndarray, "n k"]


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What the pose of a frame rests on.

    Attributes
    ----------
    rows : EvidenceRows
        Without any row where nothing was fitted.
    outcome : tuple of (n,)
        For each view, of each sampler: a reason of `edges`, or DOUBTED.
    row_of : tuple of (n,)
        For each view, the row that a sampler gave; -1 for none.
    link_pull : (l, k)
        Pull of each link's rows together.
    prior_pull, rest_pull : (k,), (k,)
        Pull of the prediction, and what is left to the sum of zero: joint limits, grey levels of the surface.
    prior_share : (k, k)
        `C L`.
    covariance : (k, k)
        `C`, of noise and prediction alone.
    """

    rows: EvidenceRows
    outcome: tuple[Int[np.ndarray, " n"], ...]
    row_of: tuple[Int[np.ndarray, " n"], ...]
    link_pull: Float[np.ndarray, "l k"]
    prior_pull: Float[np.ndarray, " k"]
    rest_pull: Float[np.ndarray, " k"]
    prior_share: Float[np.ndarray, "k k"]
    covariance: Float[np.ndarray, "k k"]


def evidence_of(past: Replay) -> Evidence:
    """Weights, residuals, pulls and outcomes of a frame."""
    found, model = past.frame.estimate, past.on[0].model
    covariance = np.linalg.inv(found.information + found.prior.information)
    share = covariance @ found.prior.information
    prior_pull = -share @ (found.u - found.prior.mean)
    rows = _rows(past, covariance)
    link_pull = np.zeros((model.link_frame.size, found.u.size))
    np.add.at(link_pull, rows.link, rows.pull)
    outcome, row_of = [], []
    for view, look in enumerate(found.seen):
        row = np.full(look.found.size, -1)
        mine = np.flatnonzero((rows.view == view) & (rows.sampler >= 0))
        row[rows.sampler[mine]] = mine
        now = look.edges.reason.copy()
        now[(row >= 0) & (np.append(rows.weight, 1.0)[row] < DOUBT)] = DOUBTED
        outcome.append(now)
        row_of.append(row)
    rest = -(link_pull.sum(axis=0) + prior_pull)
    return Evidence(rows, tuple(outcome), tuple(row_of), link_pull, prior_pull, rest, share, covariance)


def _rows(past: Replay, covariance: Float[np.ndarray, "k k"]) -> EvidenceRows:
    found = past.frame.estimate
    k = found.u.size
    if found.fit is None or found.rows is None:
        none, points = np.zeros(0), np.zeros((0, 2))
        whole = np.zeros(0, dtype=int)
        return EvidenceRows(whole, whole, whole, points, points, none, none, none, np.zeros((0, k)))
    places = [_places(on, look, found.u) for on, look in zip(past.on, found.seen, strict=True)]
    link, sampler, xy, direction = (np.concatenate(column) for column in zip(*places, strict=True))
    view = np.repeat(np.arange(len(places)), [place[0].size for place in places])
    r, _ = found.rows.residual(found.u)
    scaled = found.fit.J * (found.fit.weight / found.fit.spread**2)[:, None]
    white = whitener(found.rows.sigma, found.rows.group, past.before.consistency.scatter)
    gain = covariance @ white(found.fit.r, scaled)[1].T
    pull = -(gain * r).T
    return EvidenceRows(
        view, link, sampler, xy, direction, r * found.rows.sigma, found.rows.sigma, found.fit.weight, pull
    )


def _places(
    on: Chain, look: Look, u: Float[np.ndarray, " k"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Link, sampler, place and direction of each residual row of one view."""
    features = look.features
    if isinstance(features, OutlineFeatures):
        xy = project(on.camera, features.ray[:, :3] + features.ray[:, 3:])
        moved = features.ray + features.slope
        ahead = project(on.camera, moved[:, :3] + moved[:, 3:]) - xy
        direction = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
        found = np.flatnonzero(look.found)
        sampler = found if found.size == features.link.size else np.full(features.link.size, -1)
        return features.link, sampler, xy, direction
    return _line_places(on, features, u)


def _line_places(
    on: Chain, features: LineFeatures, u: Float[np.ndarray, " k"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Two rows for each tip, in x and y, and two for each axis.

    They stand where the image has them, while residuals of lines are those of the model: so the direction is turned.
    """
    base, tip = link_ends(on.model, forward(on.model, pose_from_free(on.model, u)))
    link = np.repeat(features.line_link, 2)
    model_xy = project(on.camera, base[link] + features.along.reshape(-1, 1) * (tip - base)[link])
    normal, rho = np.repeat(features.line[:, :2], 2, axis=0), np.repeat(features.line[:, 2], 2)
    off = (model_xy * normal).sum(axis=1) - rho
    xy = np.concatenate([np.repeat(features.tip, 2, axis=0), model_xy - off[:, None] * normal])
    direction = np.concatenate([np.tile(-np.eye(2), (features.tip_link.size, 1)), -normal])
    links = np.concatenate([np.repeat(features.tip_link, 2), link])
    return links, np.full(links.size, -1), xy, direction


def appearance_of(past: Replay) -> tuple[Appearance, ...]:
    """What was known of the light when the frame was looked at; of the first frame, what was learnt from it."""
    return past.before.appearance or past.after.appearance or ()


def link_names(model: Model) -> tuple[str, ...]:
    """What links are called: their finger, and their place in it from the palm outwards.

    >>> from handtrack.kinematics.builtin import model
    >>> link_names(model("index"))
    ('index proximal', 'index middle', 'index distal')
    """
    names = [""] * model.link_frame.size
    for finger in fingers_of(model):
        ordinals = _ORDINALS.get(len(finger.links), tuple(f"link {i + 1}" for i in range(len(finger.links))))
        for link, ordinal in zip(finger.links, ordinals, strict=True):
            names[link] = f"{finger.name} {ordinal}".strip()
    return tuple(names)


def hiding_links(on: Chain, look: Look) -> Int[np.ndarray, " n"]:
    """The link of another finger that stands in front of each hidden sampler; -1 where there is none."""
    model, samplers = on.model, look.samplers
    front = np.full(samplers.link.size, -1)
    hidden = look.edges.reason == HIDDEN
    for away in (-1.0, 1.0):
        first = first_links(look.pills, on.camera, samplers.origin + away * samplers.direction)
        other = (first >= 0) & (model.link_finger[np.maximum(first, 0)] != model.link_finger[samplers.link])
        front = np.where(hidden & other & (front < 0), first, front)
    return front


def prior_share_of_joints(model: Model, share: Float[np.ndarray, "k k"]) -> Float[np.ndarray, " j"]:
    """How much of each joint the prediction decides, 0 to 1; a joint that follows others has their share."""
    C = model.coupling
    mine = ((C @ share) * C).sum(axis=1) / np.maximum((C * C).sum(axis=1), 1e-12)
    return np.clip(mine, 0.0, 1.0)


def off_truth(past: Replay, view: int, true: Float[np.ndarray, " j"]) -> Float[np.ndarray, " n"]:
    """Distance of each accepted edge of a view from the outline of the true pose, pixels; positive outside.

    NaN for samplers without an edge, or with evidence of another kind.
    """
    look, on = past.frame.estimate.seen[view], past.on[view]
    out = np.full(look.found.size, np.nan)
    features = look.features
    if isinstance(features, OutlineFeatures) and features.link.size == look.found.sum():
        r, _ = outline_residuals(on, features, true[on.model.free])
        out[look.found] = r * features.sigma
    return out


def outline_edge(past: Replay, evidence: Evidence, view: int) -> Float[np.ndarray, " n"]:
    """Position u of the fitted outline on each sampler that gave an edge; NaN on the others."""
    look, row = past.frame.estimate.seen[view], evidence.row_of[view]
    residual = np.append(evidence.rows.residual, np.nan)[row]
    return np.where(look.edges.reason == FOUND, look.edges.offset - residual, np.nan)
