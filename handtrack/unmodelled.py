"""A compared frame in, what is known of errors that neither pills nor shading express out (`synthesis.Unmodelled`).

The sizes of the errors of patches take one step of expectation and maximisation with each frame: the mean of
`b^2 + var(b)` over the patches, weighted by how much the image has told of each. Errors of the shading that come back
with the same normal, such as a highlight or the line where the light ends, are kept in a table over the normal.
"""

import numpy as np
from jaxtyping import Float, Int

from ._kernels.soft_pill import CELLS
from ._kernels.soft_rows import PATCHES
from .robust import median
from .synthesis import COMMON, Differences, Unmodelled

_MEMORY, _TABLE_MEMORY = 0.8, 0.9  # weight of earlier frames
_LEAST = (0.003, 0.002, 0.1)  # sizes: grey level (relative), shift (pixels); of a sample: grey levels
_HOLD = 1.0  # pull of a table's node towards zero
_WHOLE = 0.98  # share of a sample that a surface must fill to tell of its grey level
_FEW = 20  # blocks inside surfaces below which nothing is learnt


def learn_unmodelled(
    known: Unmodelled, found: Differences, error: Float[np.ndarray, "p 2"], gain: Float[np.ndarray, " l"]
) -> Unmodelled:
    """Sizes of the unmodelled errors with one more frame: one step of expectation and maximisation."""
    inside = found.samples.place[:, 2] > 1.0
    if inside.sum() < _FEW:
        return known
    grain = 1.4826 * median(np.abs(found.r[inside]))
    sizes = np.array([known.level, known.shift / found.unit])
    variance = np.diagonal(found.inverse, axis1=1, axis2=2).reshape(-1, 2)
    told = 1.0 - variance / sizes**2 / (1.0 + COMMON)  # share of what is now known of a patch that the image has told
    square = (np.minimum(error**2, (4.0 * sizes) ** 2) + variance) / (1.0 + COMMON)
    weight = np.maximum(told, 0.0)
    now = (weight * square).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-9)
    now = np.where(weight.sum(axis=0) > 4.0, now, sizes**2) * [1.0, found.unit**2]
    old = np.array([known.level, known.shift]) ** 2
    level, shift = np.maximum(np.sqrt(_MEMORY * old + (1.0 - _MEMORY) * now), _LEAST[:2])
    sums = _learn_table(known, found, error, gain)
    table = sums[1] / (sums[0] + _HOLD)
    return Unmodelled(float(level), float(shift), _grain(known, grain), table, sums)


def _learn_table(
    known: Unmodelled, found: Differences, error: Float[np.ndarray, "p 2"], gain: Float[np.ndarray, " l"]
) -> Float[np.ndarray, "2 t t"]:
    """Weights and weighted errors of the shading at the nodes of a table over the normal, earlier frames fading."""
    shown = found.seen.by_patch[:, 0] > _WHOLE * found.seen.level
    inside = np.flatnonzero(shown & ((found.samples.place[:, 2] > 1.0) | (found.seen.by_patch[:, 1] == 0.0)))
    patch, normal = found.samples.patch[inside], found.seen.normal[inside]
    of_link = gain[patch // PATCHES]
    before = 0.0 if known.table is None else read_table(known.table, normal)
    off = (found.r[inside] + found.seen.by_patch[inside, 0] * error[patch, 0]) / of_link + before
    weight = np.minimum(found.weight[inside] * of_link**2, 4.0)
    at, share = _nodes(normal)
    sums = np.zeros((2, (CELLS + 1) ** 2)) if known.sums is None else _TABLE_MEMORY * known.sums.reshape(2, -1)
    sums[0] += np.bincount(at.ravel(), (share * weight).ravel(), sums.shape[1])
    sums[1] += np.bincount(at.ravel(), (share * weight * off).ravel(), sums.shape[1])
    return sums.reshape(2, CELLS + 1, CELLS + 1)


def _nodes(normal: Float[np.ndarray, "n 3"]) -> tuple[Int[np.ndarray, "4 n"], Float[np.ndarray, "4 n"]]:
    """The four nodes of the table around each normal, and their shares."""
    place = 0.5 * CELLS * (normal[:, :2] + 1.0)
    corner = np.clip(place.astype(np.int64), 0, CELLS - 1)
    u, v = (place - corner).T
    at = corner[:, 1] * (CELLS + 1) + corner[:, 0]
    return (
        np.stack([at, at + 1, at + CELLS + 1, at + CELLS + 2]),
        np.stack([(1.0 - v) * (1.0 - u), (1.0 - v) * u, v * (1.0 - u), v * u]),
    )


def read_table(table: Float[np.ndarray, "t t"], normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """The table at unit normals, between its nodes: twin of the kernel's reading."""
    at, share = _nodes(normal)
    return (table.ravel()[at] * share).sum(axis=0)


def _grain(known: Unmodelled, now: float) -> float:
    return max(float(np.sqrt(_MEMORY * known.grain**2 + (1.0 - _MEMORY) * now**2)), _LEAST[2])
