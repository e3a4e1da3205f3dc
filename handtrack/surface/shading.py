"""Grey levels of a posed surface in, how it shines out: one light, a table over the normals, and albedo.

The polynomial and light of `handtrack.appearance` leave a few grey levels where a surface is glossy or seen at a
grazing angle, and those move edges by a tenth of a pixel. A surface shows every normal many times over, so a table
over the normals can hold what one light does not:

    level = gain_region  albedo_vertex  ( max(n . l, 0) + T(n) )

T is a bicubic spline on the plane that maps normals with equal areas, `(x, y) sqrt(2 / (1 - z))`, the direction to the
camera in the middle. Where no grey level was read it is pulled towards a smooth guess: an even light with a highlight
(`surface.gloss`) if that explains the readings, else the polynomial. The albedo of each vertex (dark skin, a dress that
ends somewhere) is pulled towards one.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float, Int

from .._kernels import mesh_image as kernels
from ..appearance import Appearance, harmonics
from ..robust import median
from .gloss import Gloss, fit_gloss, highlight

SIZE, SPACING, LOW = 17, 0.25, -2.0
_ROUGH, _LARGE = 4.0, 12.0  # grey levels: second differences and size of the table that are to be expected
_MEMORY = 0.8  # weight of what earlier frames told, for each new frame
_ALBEDO_PRIOR = 12.0  # pixels that say the albedo is one
_TRUST = 20.0  # how much tighter the table is held where one light with a highlight explains the surface
_KEPT_EACH, _KEPT = 1200, 6000  # readings kept of each frame, and of all
FAIR = 0.9  # albedo below which a surface says little of the light
_LEAST_CUT = 0.03  # of the brightest level: how far plausible levels may be off


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Grey levels of surface points.

    Attributes
    ----------
    normal, region, level : (n, 3), (n,), (n,)
    row, column : (n,), (n,)
        Pixel of the box they were read in.
    vertex, share : (n, 3), (n, 3)
        Corners of the triangle each lies on, and barycentric coordinates.
    """

    normal: Float[np.ndarray, "n 3"]
    region: Int[np.ndarray, " n"]
    level: Float[np.ndarray, " n"]
    vertex: Int[np.ndarray, "n 3"]
    share: Float[np.ndarray, "n 3"]
    row: Int[np.ndarray, " n"]
    column: Int[np.ndarray, " n"]

    def chosen(self, at) -> "Readings":
        """Some of them."""
        return Readings(*(getattr(self, field.name)[at] for field in fields(self)))

    def colour(self, albedo: Float[np.ndarray, " v"]) -> Float[np.ndarray, " n"]:
        """Albedo blended between the corners."""
        return (self.share * albedo[self.vertex]).sum(axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceAppearance:
    """Grey levels of a surface and of what is behind it.

    Attributes
    ----------
    plain : Appearance
        Smooth shading of its own, with a gain for each region of the surface, background, noise and blur.
    light : (3,)
        Towards the light, camera axes, times its grey level.
    table : (g, g)
        Grey levels to add to the light, over mapped normals.
    albedo : (v,)
        Factor of each vertex.
    spread : float
        Standard deviation of grey levels about all of this.
    matrix, vector : (g g, g g), (g g,)
        What earlier frames told of the table: normal equations, the lower triangle of the matrix.
    told, count : (v,), (v,)
        What they told of the albedo: sums of weighted ratios and of weights.
    gloss : Gloss or None
        One light with a highlight, as far as it was fitted.
    kept : Readings
        Some readings of the last frames, where the surface is not dark.
    """

    plain: Appearance
    light: Float[np.ndarray, " 3"]
    table: Float[np.ndarray, "g g"]
    albedo: Float[np.ndarray, " v"]
    spread: float
    matrix: Float[np.ndarray, "n n"]
    vector: Float[np.ndarray, " n"]
    told: Float[np.ndarray, " v"]
    count: Float[np.ndarray, " v"]
    gloss: Gloss | None
    kept: Readings

    @property
    def noise(self) -> float:
        """Standard deviation of the pixel noise."""
        return self.plain.noise

    @property
    def blur(self) -> float:
        """Standard deviation of the blur of an edge, pixels."""
        return self.plain.blur

    @property
    def background(self) -> float:
        """Grey level behind the surface."""
        return self.plain.background


_NO_READINGS = (((3,), float), ((), int), ((), float), ((3,), int), ((3,), float), ((), int), ((), int))


def plain_appearance(plain: Appearance, vertices: int) -> SurfaceAppearance:
    """Smooth shading only: an empty table, albedo one."""
    n = SIZE * SIZE
    ones, nothing = np.ones(vertices), np.zeros(vertices)
    return SurfaceAppearance(
        plain=plain,
        light=plain.shading[25:],
        table=polynomial_table(plain).reshape(SIZE, SIZE),
        albedo=ones,
        spread=plain.spread,
        matrix=np.zeros((n, n)),
        vector=np.zeros(n),
        told=nothing,
        count=nothing,
        gloss=None,
        kept=Readings(*(np.zeros((0, *width), kind) for width, kind in _NO_READINGS)),
    )


def forgotten(appearance: SurfaceAppearance) -> SurfaceAppearance:
    """The same with nothing remembered of table and albedo: where they were learnt as if the image were sharp."""
    vertices = appearance.albedo.size
    fresh = plain_appearance(appearance.plain, vertices)
    return replace(fresh, light=appearance.light, table=appearance.table, gloss=appearance.gloss)


def mapped(normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Normals on the plane of equal areas about the direction to the camera.

    >>> mapped(np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])).round(3).tolist()
    [[0.0, 0.0], [1.414, 0.0]]
    """
    return normal[:, :2] * np.sqrt(2.0 / np.maximum(1.0 - normal[:, 2:], 0.2))


def table_rows(normal: Float[np.ndarray, "n 3"]) -> tuple[Int[np.ndarray, "n 16"], Float[np.ndarray, "n 16"]]:
    """Columns and values of the splines that are not zero at each normal."""
    column, weight = np.empty((normal.shape[0], 16), dtype=np.int64), np.empty((normal.shape[0], 16))
    kernels.table_rows(np.ascontiguousarray(normal), LOW, SPACING, SIZE, column, weight)
    return column, weight


def table_rows_numpy(normal: Float[np.ndarray, "n 3"]) -> tuple[Int[np.ndarray, "n 16"], Float[np.ndarray, "n 16"]]:
    """The same as `table_rows` in plain NumPy: the twin of the compiled kernel."""
    at = np.clip((mapped(normal) - LOW) / SPACING, 1.0, SIZE - 2.000001)
    first = np.floor(at).astype(int)
    f = at - first
    g = 1.0 - f
    value = (
        np.stack(
            [g**3, 3.0 * f * f * (f - 2.0) + 4.0, 3.0 * g * g * (g - 2.0) + 4.0, f**3],
            axis=-1,
        )
        / 6.0
    )  # (n, 2, 4)
    number = first[..., None] - 1 + np.arange(4)
    column = number[:, 1, :, None] * SIZE + number[:, 0, None, :]
    return column.reshape(-1, 16), (value[:, 1, :, None] * value[:, 0, None, :]).reshape(-1, 16)


def table_levels(table: Float[np.ndarray, "g g"], normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Values of a table at normals."""
    column, weight = table_rows(normal)
    return (table.reshape(-1)[column] * weight).sum(axis=1)


def _smoothness() -> Float[np.ndarray, "n n"]:
    """Information that the table is smooth and small."""
    second = np.diff(np.eye(SIZE), n=2, axis=0)
    one = np.kron(np.eye(SIZE), second)
    other = np.kron(second, np.eye(SIZE))
    return (one.T @ one + other.T @ other) / _ROUGH**2 + np.eye(SIZE * SIZE) / _LARGE**2


_PRIOR = _smoothness()


def _to_table() -> Float[np.ndarray, "n m"]:
    """Map from levels at `_NORMALS` to the table that has them, by least squares."""
    column, weight = table_rows_numpy(_NORMALS)
    design = np.zeros((_NORMALS.shape[0], SIZE * SIZE))
    np.add.at(design, (np.arange(design.shape[0])[:, None], column), weight)
    return np.linalg.solve(design.T @ design + 1e-6 * np.eye(SIZE * SIZE), design.T)


def lit_levels(appearance: SurfaceAppearance, normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Grey levels of normals before gain and albedo."""
    return np.maximum(normal @ appearance.light, 0.0) + table_levels(appearance.table, normal)


def expected_levels(appearance: SurfaceAppearance, of: Readings) -> Float[np.ndarray, " n"]:
    """What the appearance says of surface points."""
    return appearance.plain.gain[of.region] * of.colour(appearance.albedo) * lit_levels(appearance, of.normal)


def learn_shading(plain: Appearance, before: SurfaceAppearance, of: Readings) -> SurfaceAppearance:
    """Fit highlight, table and albedo to one image's grey levels, and blend them with what is known.

    Parameters
    ----------
    plain : Appearance
        The smooth shading learnt from this image.
    before : SurfaceAppearance
        What is known from earlier frames.
    """
    noise = max(plain.noise, 0.3)
    colour = of.colour(before.albedo)
    factor = plain.gain[of.region] * colour
    off = of.level - expected_levels(before, of)
    weight = _tukey(off, noise, float(np.abs(of.level).max(initial=1.0)))
    right = of.level / np.maximum(factor, 1e-3)
    kept = _kept(before.kept, of.chosen((weight > 0.2) & (colour > FAIR)))
    gloss = None
    if kept.level.size > 200:
        fair = kept.chosen(kept.colour(before.albedo) > FAIR)
        gloss = fit_gloss(fair.normal, fair.level, plain.shading[25:], noise, before.gloss)
    if gloss is not None and gloss.spread >= max(0.9 * plain.spread, 1.2 * noise):
        gloss = None
    light = plain.shading[25:] if gloss is None else gloss.light
    prior = polynomial_table(plain) if gloss is None else gloss_table(gloss)
    lit = np.maximum(of.normal @ light, 0.0)
    column, splines = table_rows(of.normal)
    matrix, vector = _MEMORY * before.matrix, _MEMORY * before.vector
    sound = np.where(colour > FAIR, weight, 0.0) * (factor / noise) ** 2
    kernels.add_rows(column, splines, right - lit, sound, matrix, vector)
    whole = np.tril(matrix) + np.tril(matrix, -1).T
    sure = 1.0 if gloss is None else (plain.spread / max(gloss.spread, noise)) ** 2 * _TRUST
    table = np.linalg.solve(whole + sure * _PRIOR, vector + sure * _PRIOR @ prior).reshape(SIZE, SIZE)
    smooth = plain.gain[of.region] * (lit + table_levels(table, of.normal))
    albedo, told, count = _albedo(before, of, smooth, noise)
    off = of.level - smooth * of.colour(albedo)
    spread = max(1.4826 * median(np.abs(off)), plain.noise) if off.size else plain.spread
    return SurfaceAppearance(plain, light, table, albedo, spread, matrix, vector, told, count, gloss, kept)


def _kept(before: Readings, of: Readings) -> Readings:
    """Some readings of this frame and of the last ones."""
    new = of.chosen(slice(None, None, max(of.level.size // _KEPT_EACH, 1)))
    pairs = ((getattr(new, field.name), getattr(before, field.name)) for field in fields(Readings))
    return Readings(*(np.concatenate(pair)[:_KEPT] for pair in pairs))


def _grid_normals() -> Float[np.ndarray, "n 3"]:
    """Normals spread over the table, where it has any."""
    at = np.arange(LOW + SPACING, -LOW - SPACING + 1e-9, 0.5 * SPACING)
    place = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    r2 = (place**2).sum(axis=1)
    place, r2 = place[r2 < 3.0], r2[r2 < 3.0]
    return np.column_stack([place * np.sqrt(1.0 - 0.25 * r2)[:, None], 0.5 * r2 - 1.0])


_NORMALS = _grid_normals()


def gloss_table(gloss: Gloss) -> Float[np.ndarray, " n"]:
    """Even light and highlight as a table."""
    return _TO_TABLE @ (gloss.ambient + highlight(gloss, _NORMALS))


def polynomial_table(plain: Appearance) -> Float[np.ndarray, " n"]:
    """The polynomial of a smooth shading as a table."""
    return _TO_TABLE @ (harmonics(_NORMALS) @ plain.shading[:25])


def _tukey(off: Float[np.ndarray, " n"], noise: float, brightest: float) -> Float[np.ndarray, " n"]:
    if not off.size:
        return off
    cut = 4.7 * max(1.4826 * median(np.abs(off)), noise, _LEAST_CUT * brightest / 3.0)
    return np.where(np.abs(off) < cut, (1.0 - (off / cut) ** 2) ** 2, 0.0)


def _albedo(
    before: SurfaceAppearance, of: Readings, smooth: Float[np.ndarray, " n"], noise: float
) -> tuple[Float[np.ndarray, " v"], Float[np.ndarray, " v"], Float[np.ndarray, " v"]]:
    """Albedo of each vertex: the mean ratio of grey level and shading around it, each pixel by its brightness.

    The ratio is taken of what the albedo so far leaves, so that it sharpens from frame to frame.
    """
    bright = smooth > 4.0 * noise
    colour = np.maximum(of.colour(before.albedo), 0.02)
    ratio = of.level / np.maximum(smooth * colour, 1e-3)
    weight = np.where(bright, (smooth / max(float(np.median(smooth)) if smooth.size else 1.0, 1e-3)) ** 2, 0.0)
    told, count = _MEMORY * before.told, _MEMORY * before.count
    target = np.clip(ratio[:, None] * before.albedo[of.vertex], 0.02, 3.0)
    told = told + np.bincount(of.vertex.reshape(-1), (weight[:, None] * of.share * target).reshape(-1), told.size)
    count = count + np.bincount(of.vertex.reshape(-1), (weight[:, None] * of.share).reshape(-1), count.size)
    albedo = (told + _ALBEDO_PRIOR) / (count + _ALBEDO_PRIOR)
    usual = _usual(albedo, count)
    return albedo / usual, told / usual, count  # what light and albedo share is given to the light


def _usual(values: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"]) -> float:
    """Middle of the shortest interval with a third of the weight: dark parts of a hand do not move it."""
    order = np.argsort(values)
    ordered, below = values[order], np.cumsum(weight[order])
    if not below[-1] > 0.0:
        return 1.0
    last = np.searchsorted(below, below + below[-1] / 3.0)
    inside = last < ordered.size
    if not inside.any():
        return 1.0
    length = ordered[last[inside]] - ordered[inside]
    first = int(np.argmin(length))
    return float(0.5 * (ordered[first] + ordered[last[first]]))


_TO_TABLE = _to_table()
