"""The result of every edge method: points with sigma, and why a profile gave none."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

FOUND, HIDDEN, JOINT, OUTSIDE, FLAT, BORDER, MISFIT = range(7)
REASONS = (
    "found",
    "hidden by another finger",
    "no depth step: the finger goes on",
    "outside the image",
    "no contrast",
    "valley at the end of the search range",
    "does not look like the template",
)


@dataclass(frozen=True, slots=True, eq=False)
class EdgePoints:
    """One entry for each sampler.

    Attributes
    ----------
    xy, offset : (n, 2), (n,)
        Edge position in pixels, and its coordinate u along the sampler; the sampler's origin where none was found.
    sigma : (n,)
        Standard deviation of `offset`, pixels; inf where none was found.
    reason : (n,)
        FOUND or why not; index into REASONS.
    misfit : (n,)
        Mean square difference from the template at the valley, in units of the expected noise.
    """

    xy: Float[np.ndarray, "n 2"]
    offset: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, " n"]
    reason: Int[np.ndarray, " n"]
    misfit: Float[np.ndarray, " n"]
