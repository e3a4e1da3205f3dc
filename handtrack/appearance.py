"""Image and a posed model in, how the surface and the background look out.

The thesis keeps templates from a frame without occlusion and supposes constant light; links that turn break that
supposition by half a pixel to three. Here grey level is a smooth function of the surface normal in camera axes, a
polynomial of degree four on the sphere plus one distant light, `max(n . l, 0)`, times a gain for each link, learnt
robustly from the image and carried over time, so that a template can be rendered at the present pose. Degree two
would do for most light on a matt surface (Ramamoorthi and Hanrahan 2001); the rest is for broad highlights, and the
light for the line where it ends.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from . import _kernels
from .camera import Camera, pixels_per_unit, project_camera, rays
from .pills import Pills, ray_hits
from .profiles import sample_points
from .robust import median

_RIDGE = 3e-5  # pull of each coefficient towards zero, growing with the square of its degree
_ALONG = np.linspace(0.08, 0.92, 5)  # where on each link grey levels are read
_ACROSS = np.array([-1.3, -0.955, -0.9, -0.8, -0.6, -0.3, 0.0, 0.3, 0.6, 0.8, 0.9, 0.955, 1.3])  # in radii
SHARP = 0.5  # pixels of blur: a box of one pixel and a linear interpolation, sqrt(1/12 + 1/6)
_MEMORY = 0.8  # weight of what earlier frames told, for each new frame


@dataclass(frozen=True, slots=True, eq=False)
class Appearance:
    """Grey levels of surface and background.

    Attributes
    ----------
    shading : (28,)
        Coefficients of grey level over the normal in camera axes: 25 for the basis of `harmonics`, then the light l.
    gain : (l,)
        Factor of each link.
    background, noise : float
        Grey level behind the hand, and standard deviation of the pixel noise.
    blur : float
        Standard deviation of the blur that pixels, lens and interpolation leave on an edge, pixels.
    spread : float
        Standard deviation of grey level about the fitted shading: noise and what the shading cannot express.
    normal_matrix, normal_vector : (26, 26), (26,)
        Accumulated least-squares sums, the memory over time.
    """

    shading: Float[np.ndarray, " 28"]
    gain: Float[np.ndarray, " l"]
    background: float
    noise: float
    blur: float
    spread: float
    normal_matrix: Float[np.ndarray, "26 26"]
    normal_vector: Float[np.ndarray, " 26"]


_POWERS = [(a - b, b) for a in range(5) for b in range(a + 1)]  # x^i y^j up to degree 4
_DEEP = [(a - b, b) for a in range(4) for b in range(a + 1)]  # the same up to degree 3, times z
_DEGREE = np.array([i + j for i, j in _POWERS] + [i + j + 1 for i, j in _DEEP])


def harmonics(normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 25"]:
    """Polynomials of degree four on the unit sphere: `x^i y^j` up to degree 4, then `z x^i y^j` up to degree 3.

    They span the spherical harmonics of orders 0 to 4.

    >>> harmonics(np.array([[0.0, 0.0, -1.0]])).nonzero()[1].tolist()
    [0, 15]
    """
    out = np.empty((normal.shape[0], _DEGREE.size))
    _kernels.fill_harmonics(normal, out)
    return out


def harmonics_numpy(normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 25"]:
    """The same as `harmonics` in plain NumPy: the twin of the compiled kernel."""
    x, y, z = normal.T
    flat = [x**i * y**j for i, j in _POWERS]
    return np.stack(flat + [z * x**i * y**j for i, j in _DEEP], axis=1)


def shade_numpy(
    appearance: Appearance, normal: Float[np.ndarray, "n 3"], link: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Expected grey level of surface points; the background's where `link` is -1."""
    level = appearance.gain[np.maximum(link, 0)] * shaded(appearance.shading, normal)
    return np.where(link >= 0, level, appearance.background)


def shaded(shading: Float[np.ndarray, " 28"], normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Grey level of unit normals before any link's gain."""
    return harmonics(normal) @ shading[:25] + np.maximum(normal @ shading[25:], 0.0)


def learn(
    image: Float[np.ndarray, "h w"], pills: Pills, camera: Camera, previous: Appearance | None = None
) -> Appearance:
    """Fit the appearance to one image with the model posed in it, and blend it with what is known.

    Points are taken across every link and just beyond it; those that do not fit (another surface, a wrong pose, a
    highlight) are weighted down by Tukey's function of their residual.
    """
    points, level, origin, direction = surface_samples(image, pills, camera, previous.blur if previous else SHARP)
    hits = ray_hits(pills, origin, direction)
    on = hits.pill >= 0
    noise = pixel_noise(image, points, on)
    return learn_from_samples(
        hits.normal[on], hits.pill[on], level[on], level[~on], noise, pills.base.shape[0], previous
    )


def learn_from_samples(
    normal: Float[np.ndarray, "n 3"],
    link: Int[np.ndarray, " n"],
    level: Float[np.ndarray, " n"],
    behind: Float[np.ndarray, " m"],
    noise: float,
    links: int,
    previous: Appearance | None = None,
) -> Appearance:
    """The appearance from grey levels of surface points, whatever the shape of the surface.

    Parameters
    ----------
    normal, link, level : (n, 3), (n,), (n,)
        Unit normal in camera axes, link and grey level of points on the surface.
    behind : (m,)
        Grey levels of the background.
    noise : float
        Standard deviation of the pixel noise in this image, see `pixel_noise`.
    links : int
        Number of links, each with a gain.
    """
    background = median(behind) if behind.size else (previous.background if previous else 0.0)
    gain = previous.gain if previous else np.ones(links)
    if previous is not None:
        noise = _MEMORY * previous.noise + (1.0 - _MEMORY) * noise
        background = _MEMORY * previous.background + (1.0 - _MEMORY) * background
    if level.size < 20:
        everything = np.concatenate([level, behind])
        return replace(previous, noise=noise) if previous else _flat(links, background, noise, everything)
    basis = harmonics(normal)
    known = previous and gain[link] * (basis @ previous.shading[:25] + np.maximum(normal @ previous.shading[25:], 0.0))
    weight = _plausible(level, known, background, noise)
    light = _light(normal, level / gain[link], weight, previous.shading[25:] if previous else None)
    root = np.sqrt(weight)
    lit, design = np.empty(level.size), np.empty((level.size, _DEGREE.size + 1))
    _kernels.fill_shading(basis, normal, light, gain, link, root, lit, design)
    matrix, vector = design.T @ design, design.T @ (root * level)
    if previous is not None:
        matrix, vector = matrix + _MEMORY * previous.normal_matrix, vector + _MEMORY * previous.normal_vector
    solution = np.linalg.solve(matrix + _RIDGE * level.size * np.diag(np.append(_DEGREE**2, 0.0) + 1e-3), vector)
    shading = np.append(solution[:25], max(solution[25], 0.0) * light)
    shaded_now = basis @ solution[:25] + max(solution[25], 0.0) * lit
    residual = np.abs(level - gain[link] * shaded_now)[weight > 0]
    spread = 1.4826 * median(residual) if residual.size else noise
    gain, blur = _gains(gain, link, level, shaded_now, weight), previous.blur if previous else SHARP
    return Appearance(shading, gain, background, noise, blur, spread, matrix, vector)


def _plausible(
    target: Float[np.ndarray, " n"], known: Float[np.ndarray, " n"] | None, background: float, noise: float
) -> Float[np.ndarray, " n"]:
    """Weight of each point: none for what is as dark as the background at the start, or far from the known shading.

    The cut leaves room for a shaded side that the shading has not learnt yet, or it never would.
    """
    foreground = np.abs(target - background)
    typical = median(foreground)
    if known is None:
        return (foreground > max(0.1 * typical, 3.0 * noise)).astype(float)
    residual = np.abs(target - known)
    cut = 4.7 * max(1.4826 * median(residual), 0.06 * typical, noise)
    return np.where(residual < cut, (1.0 - (residual / cut) ** 2) ** 2, 0.0)


def design_numpy(
    basis: Float[np.ndarray, "n 25"],
    normal: Float[np.ndarray, "n 3"],
    light: Float[np.ndarray, " 3"],
    scale: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 26"]:
    """Rows of the shading model times `scale`, in plain NumPy: the twin of the compiled `fill_shading`."""
    return np.column_stack([basis, np.maximum(normal @ light, 0.0)]) * scale[:, None]


def _light(
    normal: Float[np.ndarray, "n 3"],
    target: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
    previous: Float[np.ndarray, " 3"] | None,
) -> Float[np.ndarray, " 3"]:
    """Direction of the one light that with a constant explains the grey levels best, by alternating least squares.

    Given which points are lit, level and light are linear; given the light, so is which points are lit.
    """
    light = previous if previous is not None and previous.any() else np.array([0.0, 0.0, -1.0])
    return _kernels.find_light(np.ascontiguousarray(normal), target, weight, light, 4 if previous is None else 2)


def light_numpy(
    normal: Float[np.ndarray, "n 3"],
    target: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
    light: Float[np.ndarray, " 3"],
    rounds: int,
) -> Float[np.ndarray, " 3"]:
    """The light after some rounds in plain NumPy: the twin of the compiled `find_light`."""
    for _ in range(rounds):
        lit = normal * (normal @ light > 0)[:, None]
        design = np.column_stack([np.ones(target.size), lit])
        weighted = design * weight[:, None]
        ridge = 1e-3 * max(float(weight.sum()), 1.0) * np.eye(4)
        light = np.linalg.solve(weighted.T @ design + ridge, weighted.T @ target)[1:]
        size = float(np.linalg.norm(light))
        light = light / size if size > 1e-6 else np.array([0.0, 0.0, -1.0])
    return light


_Samples = tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]


def surface_samples(image: Float[np.ndarray, "h w"], pills: Pills, camera: Camera, blur: float) -> _Samples:
    """Points on and beside every link, with their grey levels and rays (origin, direction)."""
    n = pills.base.shape[0] * _ALONG.size * _ACROSS.size
    out = np.empty((n, 2)), np.empty(n), np.empty((n, 3)), np.empty((n, 3))
    count = _kernels.surface_points(
        image,
        pills.base,
        pills.tip,
        pills.radius,
        camera.kind == "orthographic",
        np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        camera.distortion,
        _ALONG,
        _ACROSS,
        blur,
        *out,
    )
    return out[0][:count], out[1][:count], out[2][:count], out[3][:count]


def surface_samples_numpy(image: Float[np.ndarray, "h w"], pills: Pills, camera: Camera, blur: float) -> _Samples:
    """The same as `surface_samples` in plain NumPy: the twin of the compiled kernel."""
    base, tip = project_camera(camera, pills.base), project_camera(camera, pills.tip)
    axis = tip - base
    length = np.linalg.norm(axis, axis=1)
    across = np.stack([-axis[:, 1], axis[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
    radius = pills.radius.mean(axis=1) * pixels_per_unit(camera, 0.5 * (pills.base + pills.tip))
    points = base[:, None, None] + _ALONG[:, None, None] * axis[:, None, None]
    rim = np.maximum(1.0 - 2.0 * blur / np.maximum(radius, 1.0), 0.5)[:, None]  # as near to the edge as blur allows
    share = np.where(np.abs(_ACROSS) < 1.0, np.clip(_ACROSS, -rim, rim), _ACROSS + np.sign(_ACROSS) * (0.967 - rim))
    points = (points + (radius[:, None] * share)[:, None, :, None] * across[:, None, None]).reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    level, inside = sample_points(image, points)
    return points[inside], level[inside], *rays(camera, points[inside])


def pixel_noise(image: Float[np.ndarray, "h w"], points: Float[np.ndarray, "n 2"], on: Bool[np.ndarray, " n"]) -> float:
    """Pixel noise from second differences along rows on the surface, where nothing is clipped at black."""
    size = np.empty(points.shape[0])
    chosen = on if on.sum() >= 50 else np.ones(on.size, dtype=np.bool_)
    return _noise_of(size[: _kernels.second_differences(image, points, chosen, size)])


def noise_numpy(image: Float[np.ndarray, "h w"], points: Float[np.ndarray, "n 2"], on: Bool[np.ndarray, " n"]) -> float:
    """The same as `pixel_noise` in plain NumPy: the twin of the compiled kernel."""
    at = np.rint(points[on] if on.sum() >= 50 else points).astype(int)
    at = at[(at[:, 0] >= 1) & (at[:, 0] < image.shape[1] - 1) & (at[:, 1] >= 0) & (at[:, 1] < image.shape[0])]
    x, y = at.T
    return _noise_of(np.abs(image[y, x - 1] - 2.0 * image[y, x] + image[y, x + 1]).astype(float))


def _noise_of(size: Float[np.ndarray, " n"]) -> float:
    if size.size < 10:
        return 1.0
    # The mean, cut where edges begin: a median of whole grey levels would move in steps of 0.6.
    typical = float(np.minimum(size, 4.0 * max(median(size), 1.0)).mean())
    return max(typical * np.sqrt(np.pi / 2.0) / np.sqrt(6.0), 0.29)


def _gains(
    gain: Float[np.ndarray, " l"],
    link: Int[np.ndarray, " n"],
    target: Float[np.ndarray, " n"],
    level: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " l"]:
    """Gain of each link, pulled towards 1 and moved slowly: light and albedo cannot be told apart from few points."""
    strength = 0.2 * (weight * level * level).sum() / gain.size
    top = np.bincount(link, weight * target * level, gain.size) + strength * gain
    bottom = np.bincount(link, weight * level * level, gain.size) + strength
    return np.clip(gain + 0.3 * (top / np.maximum(bottom, 1e-9) - gain), 0.3, 3.0)


def _flat(links: int, background: float, noise: float, level: Float[np.ndarray, " n"]) -> Appearance:
    """A surface of one grey level, when next to nothing of the model is in the image."""
    brightest = float(level.max()) if level.size else 255.0
    shading = np.zeros(28)
    shading[0] = brightest
    return Appearance(shading, np.ones(links), background, noise, SHARP, noise, np.zeros((26, 26)), np.zeros(26))
