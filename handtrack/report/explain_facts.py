"""A replayed frame and its evidence in; one row of figures for each joint and for each link out.

Residuals of a link are kept apart by side: both sides outside the model speak of a radius, one out and one in of a
link that stands beside its place, those of the tip of a length.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..edges import FOUND, HIDDEN, JOINT
from ..evaluate import prismatic_joints
from ..kinematics import Model, pose_from_free
from ..replay import Replay
from .explain_evidence import Evidence, hiding_links, prior_share_of_joints

OUTCOMES = 8  # the reasons of `edges`, and DOUBTED
_UNKNOWN = 1e-6  # information, 1/rad^2, that stands for none
_WEAK = 0.5  # share of the prediction above which it decides a direction
_SIDES = (1, -1, 0)


@dataclass(frozen=True, slots=True, eq=False)
class JointFacts:
    """Arrays over all joints, degrees (model units for joints that slide).

    Attributes
    ----------
    predicted, predicted_sigma, fitted, filtered : (j,)
        `predicted` has soft couplings in it, as the fit had them; `filtered` is what the filter makes of the fit.
    sigma, image_sigma : (j,)
        As stated, and from this frame's images alone; inf where they say nothing.
    prior_share : (j,)
        How much the prediction decides, 0 to 1.
    unseen, at_limit : (j,)
        `at_limit` is -1 or 1 at the lower or upper limit, else 0.
    weak : tuple of (str, float)
        Directions that the prediction decides, as joint names with factors, and its share in each.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    predicted: Float[np.ndarray, " j"]
    predicted_sigma: Float[np.ndarray, " j"]
    fitted: Float[np.ndarray, " j"]
    filtered: Float[np.ndarray, " j"]
    sigma: Float[np.ndarray, " j"]
    image_sigma: Float[np.ndarray, " j"]
    prior_share: Float[np.ndarray, " j"]
    unseen: Bool[np.ndarray, " j"]
    at_limit: Int[np.ndarray, " j"]
    weak: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class LinkFacts:
    """Arrays over all links, those of all views together.

    Attributes
    ----------
    count : (l, 8)
        Samplers by outcome.
    hidden_by : (l,)
        The link that hides most of it; -1 for none.
    rms, weight : (l,)
        Root mean square residual, pixels, and mean weight of its evidence; NaN without.
    side, side_sigma : (l, 3)
        Median residual on side +1, on side -1 and at the tip, pixels, positive outside the model, and its standard
        deviation if the edges are as good as they claim; NaN where nothing was found.
    facing : (l, 3, 2)
        Where these sides look to in the image, as sums of unit vectors of the first view that has any.
    pull : (l, j)
        How far the link pushes each joint, degrees (model units for joints that slide).
    """

    count: Int[np.ndarray, "l 8"]
    hidden_by: Int[np.ndarray, " l"]
    rms: Float[np.ndarray, " l"]
    weight: Float[np.ndarray, " l"]
    side: Float[np.ndarray, "l 3"]
    side_sigma: Float[np.ndarray, "l 3"]
    facing: Float[np.ndarray, "l 3 2"]
    pull: Float[np.ndarray, "l j"]

    @property
    def total(self) -> Int[np.ndarray, " l"]:
        """Samplers that could show an edge if nothing hid it."""
        return self.count.sum(axis=1) - self.count[:, JOINT]

    @property
    def used(self) -> Int[np.ndarray, " l"]:
        """Samplers whose edge counts, doubted ones among them."""
        return self.count[:, FOUND] + self.count[:, -1]

    @property
    def visible(self) -> Float[np.ndarray, " l"]:
        """Share that no other finger hides."""
        return 1.0 - self.count[:, HIDDEN] / np.maximum(self.total, 1)


def joint_facts(past: Replay, evidence: Evidence) -> JointFacts:
    """What became of each joint, from prediction to filter."""
    model, found = past.on[0].model, past.frame.estimate
    C, scale = model.coupling, joint_scale(model)
    low, high = model.limits.T
    q = past.frame.q
    close = 1e-6 + 1e-9 * np.abs(q)
    image = np.linalg.inv(found.information + _UNKNOWN * np.eye(found.u.size))
    image_sigma = np.sqrt((C @ image * C).sum(axis=1))
    unseen = np.abs(C[:, past.frame.unseen]).sum(axis=1) > 0.0
    return JointFacts(
        names=model.joint_names,
        units=joint_units(model),
        predicted=pose_from_free(model, found.prior.mean) * scale,
        predicted_sigma=np.sqrt((C @ found.prior.covariance * C).sum(axis=1)) * scale,
        fitted=q * scale,
        filtered=pose_from_free(model, past.after.prediction.motion.q) * scale,
        sigma=np.sqrt(np.diag(past.frame.covariance)) * scale,
        image_sigma=np.where(image_sigma > 0.5 / np.sqrt(_UNKNOWN), np.inf, image_sigma * scale),
        prior_share=prior_share_of_joints(model, evidence.prior_share),
        unseen=unseen,
        at_limit=np.where(q <= low + close, -1, np.where(q >= high - close, 1, 0)),
        weak=_weak_directions(past, evidence),
    )


def joint_scale(model: Model) -> Float[np.ndarray, " j"]:
    """What turns joint values of the code into those of files."""
    return np.where(prismatic_joints(model), 1.0, 180.0 / np.pi)


def joint_units(model: Model) -> tuple[str, ...]:
    """Unit of each joint, with the space that belongs before it."""
    return tuple(f" {model.units}" if slides else "\N{DEGREE SIGN}" for slides in prismatic_joints(model))


def _weak_directions(past: Replay, evidence: Evidence) -> tuple[tuple[str, float], ...]:
    """Directions of several joints of which the prediction has the greater share.

    They are the eigenvectors of `C L`, made symmetric by the root of L.
    """
    model, prior = past.on[0].model, past.frame.estimate.prior
    root = np.linalg.cholesky(prior.information).T
    share, vectors = np.linalg.eigh(root @ evidence.covariance @ root.T)
    directions = np.linalg.solve(root, vectors)
    found = []
    for column in np.argsort(-share):
        v = directions[:, column] / np.abs(directions[:, column]).max()
        large = np.flatnonzero(np.abs(v) >= 0.3)
        if share[column] < _WEAK or large.size < 2:
            continue
        v = v * np.sign(v[large[0]])
        words = [f"{v[k]:+.1f} {model.joint_names[model.free[k]]}" for k in large]
        found.append((" ".join(words).removeprefix("+").replace("-", "\N{MINUS SIGN}"), float(share[column])))
    return tuple(found)


def link_facts(past: Replay, evidence: Evidence) -> LinkFacts:
    """What became of each link's evidence."""
    model, seen, rows = past.on[0].model, past.frame.estimate.seen, evidence.rows
    links = model.link_frame.size
    count = np.zeros((links, OUTCOMES), dtype=int)
    fronts = np.zeros((links, links + 1), dtype=int)  # the last column is for none
    sides = []
    for view, (on, look) in enumerate(zip(past.on, seen, strict=True)):
        np.add.at(count, (look.samplers.link, evidence.outcome[view]), 1)
        np.add.at(fronts, (look.samplers.link, hiding_links(on, look)), 1)
        mine = rows.sampler[rows.view == view]
        sides.append(np.where(mine >= 0, look.samplers.side[mine], 2))
    hidden_by = np.where(fronts[:, :-1].any(axis=1), fronts[:, :-1].argmax(axis=1), -1)
    number = np.bincount(rows.link, minlength=links)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(np.bincount(rows.link, rows.residual**2, links) / number)
        weight = np.bincount(rows.link, rows.weight, links) / number
    side, side_sigma, facing = _side_residuals(evidence, np.concatenate(sides), links)
    pull = evidence.link_pull @ model.coupling.T * joint_scale(model)
    return LinkFacts(count, hidden_by, rms, weight, side, side_sigma, facing, pull)


def _side_residuals(
    evidence: Evidence, side: Int[np.ndarray, " n"], links: int
) -> tuple[Float[np.ndarray, "l 3"], Float[np.ndarray, "l 3"], Float[np.ndarray, "l 3 2"]]:
    """Median residual, its standard deviation and the direction of each side; what is no outline has side 2."""
    rows = evidence.rows
    middle, sigma = np.full((links, 3), np.nan), np.full((links, 3), np.nan)
    facing = np.zeros((links, 3, 2))
    for link in range(links):
        for column, of in enumerate(_SIDES):
            mine = (rows.link == link) & (side == of)
            if mine.any():
                middle[link, column] = np.median(rows.residual[mine])
                sigma[link, column] = 1.25 / np.sqrt((rows.sigma[mine] ** -2.0).sum())  # a median's, not a mean's
                first = mine & (rows.view == rows.view[mine][0])
                facing[link, column] = rows.direction[first].sum(axis=0)
    return middle, sigma, facing


def prior_pull(past: Replay, evidence: Evidence) -> Float[np.ndarray, "2 j"]:
    """Pull of the prediction, and of what else there is (limits, grey levels), on all joints in the units of files."""
    model = past.on[0].model
    both = np.stack([evidence.prior_pull, evidence.rest_pull])
    return both @ model.coupling.T * joint_scale(model)


def signed(value: float, digits: int = 1) -> str:
    """A number with its sign, the minus a typographic one."""
    return f"{value + 0.0:+.{digits}f}".replace("-", "\N{MINUS SIGN}")


def listed(words: Sequence[str]) -> str:
    """Words as a list in a sentence.

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)
