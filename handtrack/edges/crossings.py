"""What every method of the hand thesis's appendix D is given, and the form in which it answers.

In goes a set of profiles across whole links, with windows and predicted edges; out come two edge points for each
profile, side -1 before side +1. All methods have this one signature,

    method(crossings: Crossings) -> EdgePoints        with 2 n entries

so one can stand for another. A finger's tip is a profile with an edge on side +1 alone.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..profiles import Profiles, Samplers
from .points import BORDER, FLAT, FOUND, HIDDEN, EdgePoints

OUTWARD = np.array([-1.0, 1.0])  # sign of u that leads out of the link on each side


@dataclass(frozen=True, slots=True, eq=False)
class Crossings:
    """Profiles across links and what is known before they are read.

    Attributes
    ----------
    samplers : Samplers
        The n paths; u = 0 on the projected axis for a link.
    profiles : Profiles
        Grey levels at evenly spaced positions u, pixels.
    window : (n, m)
        Samples that may be used: own finger or background, in the image, clear of whatever another finger shows.
    edge : (n, 2)
        Predicted edges on side -1 and +1, positions u in pixels; NaN where there is none.
    rise : (n, 2)
        Expected grey level just inside each edge less that just outside.
    state : (n, 2)
        FOUND where an edge may be looked for, else the reason why not.
    reach : (n,)
        How far from its predicted place an edge is believed, pixels.
    noise : float
        Standard deviation of the pixel noise, grey levels.
    blur : float
        Standard deviation of the blur on an edge, pixels.
    """

    samplers: Samplers
    profiles: Profiles
    window: Bool[np.ndarray, "n m"]
    edge: Float[np.ndarray, "n 2"]
    rise: Float[np.ndarray, "n 2"]
    state: Int[np.ndarray, "n 2"]
    reach: Float[np.ndarray, " n"]
    noise: float
    blur: float

    @property
    def step(self) -> float:
        """Distance of neighbouring samples, pixels."""
        return float(self.profiles.u[1] - self.profiles.u[0])

    @property
    def width(self) -> Float[np.ndarray, " n"]:
        """Seen width of the link at each profile, pixels; NaN where an edge has no place."""
        return self.edge[:, 1] - self.edge[:, 0]


def answer(
    crossings: Crossings,
    offset: Float[np.ndarray, "n 2"],
    sigma: Float[np.ndarray, "n 2"],
    reason: Int[np.ndarray, "n 2"],
    misfit: Float[np.ndarray, "n 2"],
) -> EdgePoints:
    """Edge points from what a method found, `offset` counted outwards from each predicted edge.

    Whatever the method says: an edge that was not to be looked for has its state as reason, one beyond reach is BORDER,
    one on samples outside the window is HIDDEN, and one without a finite sigma is FLAT.
    """
    u = np.nan_to_num(crossings.edge) + OUTWARD * np.nan_to_num(offset)
    index = np.rint((u - crossings.profiles.u[0]) / crossings.step).astype(int)
    within = (index >= 0) & (index < crossings.profiles.u.size)
    row = np.arange(index.shape[0])[:, None]
    seen = within & crossings.window[row, np.where(within, index, 0)]
    reason = np.where((reason == FOUND) & ~(np.isfinite(offset) & np.isfinite(sigma)), FLAT, reason)
    reason = np.where((reason == FOUND) & (np.abs(offset) > crossings.reach[:, None]), BORDER, reason)
    reason = np.where((reason == FOUND) & ~seen, HIDDEN, reason)
    reason = np.where(crossings.state != FOUND, crossings.state, reason)
    found = reason == FOUND
    at = np.where(np.isfinite(crossings.edge), crossings.edge, 0.0) + np.where(found, OUTWARD * offset, 0.0)
    xy = crossings.samplers.origin[:, None] + at[..., None] * crossings.samplers.direction[:, None]
    return EdgePoints(
        xy.reshape(-1, 2),
        np.where(found, offset, 0.0).ravel(),
        np.where(found, sigma, np.inf).ravel(),
        reason.ravel(),
        np.where(found, misfit, 0.0).ravel(),
    )
