"""A look at an image in, how blurred its edges are out.

A template sharper than the image puts edges off where the surface is shaded, and claims too much. So templates of
several blurs are held against the edges that were found, and the blur that leaves the least is kept.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .appearance import SHARP, Appearance
from .edges import FOUND
from .edges.wssd import refine
from .measure import Look
from .profiles import sample
from .residuals import Chain
from .settings import Settings
from .templates import expect, positions

BLURS = SHARP * 2.0 ** (np.arange(7) / 2.0)  # 0.5 to 4 pixels
_BETTER = 0.9  # a new blur must leave this much less
_LEAST_EDGES = 12


def learn_blur(
    image: Float[np.ndarray, "h w"], on: Chain, seen: Look, appearance: Appearance, settings: Settings
) -> Appearance:
    """The appearance with the blur, out of `BLURS`, that fits the found edges best.

    Each edge is compared where it was found, with the grey levels of its template adjusted as in the edge search, so
    that only the shape of the rise counts; the median over edges is what is compared.
    """
    found = seen.edges.reason == FOUND
    if seen.samplers.link.size != found.size or found.sum() < _LEAST_EDGES or seen.reach.size == 0:
        return appearance
    step, inwards, outwards = 0.5, 10.0, 8.0
    at = replace(seen.samplers, origin=seen.edges.xy)  # samplers moved onto the edges: shift 0 is where each was found
    profiles = sample(image, at, positions(inwards, outwards, step), settings.interpolation)
    nothing = np.zeros(found.size, dtype=np.int64)
    ridge = np.tile([1e9, 1e-3, 1e-3, 1e-3, 1e-3], (found.size, 1))  # the place is kept, grey levels are free
    left = []
    for blur in BLURS:
        tried = replace(appearance, blur=float(blur))
        templates = expect(seen.samplers, seen.pills, on.model.link_finger, on.camera, tried, inwards, outwards, step)
        _, _, misfit = refine(profiles, templates, nothing, seen.samplers, step, ridge)
        usable = found & np.isfinite(misfit)
        left.append(float(np.median(misfit[usable])) if usable.any() else np.inf)
    now = int(np.argmin(np.abs(BLURS - appearance.blur)))
    best = int(np.argmin(left))
    return replace(appearance, blur=float(BLURS[best])) if left[best] < _BETTER * left[now] else appearance
