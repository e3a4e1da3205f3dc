"""Edges of a roughly calibrated hand in, how much of its first phalanges sits in a palm that the model lacks out.

Skin joins the fingers up to half their first phalanx, and beyond that the palm's own edges begin. Pills see neither:
their outline there is not where an edge is, whatever the shape. So where the edges of these halves are farther off
than all others, in every frame alike, they are better not looked at.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .kinematics import Model, forward, link_ends, pose_from_free
from .pills import Pills, clearance
from .residuals import Chain, OutlineFeatures, outline_residuals

SHARE = 0.55  # of a first phalanx: the web between the fingers ends near its middle
_WORSE, _LEAST = 1.6, 0.25  # times the distance of all other edges, and pixels
_FEW = 40  # edges


def buried_shares(
    on: Chain, sights: Sequence[tuple[OutlineFeatures, Float[np.ndarray, " k"]]]
) -> Float[np.ndarray, " l"] | None:
    """Share of each link to leave out, from its base: `SHARE` for first links if their edges say so, or None.

    Parameters
    ----------
    sights : sequence of (OutlineFeatures, (k,))
        Edges of a moment, and the pose that fits them with the model as far as it is calibrated.
    """
    first = on.model.link_parent < 0
    inside: list[Float[np.ndarray, " n"]] = []
    beyond: list[Float[np.ndarray, " n"]] = []
    for features, u in sights:
        off = np.abs(outline_residuals(on, features, u)[0] * features.sigma)
        near = first[features.link] & (_along(on.model, features, u) < SHARE)
        inside.append(off[near])
        beyond.append(off[~near])
    here, there = np.concatenate(inside), np.concatenate(beyond)
    if min(here.size, there.size) < _FEW:
        return None
    worse = float(np.median(here)) > max(_WORSE * float(np.median(there)), _LEAST)
    return SHARE * first if worse else None


def _along(model: Model, features: OutlineFeatures, u: Float[np.ndarray, " k"]) -> Float[np.ndarray, " n"]:
    base, tip = link_ends(model, forward(model, pose_from_free(model, u)))
    pills = Pills(base, tip, model.link_radius)
    return clearance(pills, features.link, features.ray[:, :3], features.ray[:, 3:]).along
