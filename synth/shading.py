"""Surface normals in, light out: ambient, diffuse and specular parts with one directional light.

Phong's model: with the normal n, the direction l to the light, the direction v to the eye and the mirrored light
r = 2 (n.l) n - l, a pixel of grey level `albedo` shows

    I = albedo (ambient + diffuse max(0, n.l)) + 255 specular max(0, r.v)^shininess        (no specular part where n.l
    <= 0)

evaluated at every pixel (`phong`), at the corners of facets and blended (`gouraud`), or once a facet (`flat`): the
shading methods of the hand thesis, section 10.2. `binary` shows the bare albedo (section 10.1).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from handtrack.camera import Camera
from handtrack.pills import Pills

from . import _kernels
from .facets import Counts, facet_light, facet_number, facet_place, facet_points, facet_rows
from .raycast import pill_normal, pill_table

Mode = Literal["binary", "flat", "gouraud", "phong"]
Coefficients = tuple[float, float, float, float]
MODES: dict[str, int] = {
    "binary": _kernels.BINARY,
    "flat": _kernels.FLAT,
    "gouraud": _kernels.GOURAUD,
    "phong": _kernels.PHONG,
}


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """Reflectance of the links; the same for all but their colour.

    Attributes
    ----------
    albedo : (l, 3)
        Red, green, blue of each link, 0..255.
    ambient, diffuse, specular : float
        Shares of the light, >= 0.
    shininess : float
        Exponent of the specular part, > 0.
    """

    albedo: Float[np.ndarray, "l 3"]
    ambient: float = 0.25
    diffuse: float = 0.65
    specular: float = 0.08
    shininess: float = 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """One light far away: `direction` (3,) points from the scene to it, in camera axes; any length but zero."""

    direction: Float[np.ndarray, " 3"]


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """All that turns a hit into light, ready for the renderer: see `make_look`.

    Attributes
    ----------
    mode : int
        Number of the mode in the compiled loops.
    coefficients : (ambient, diffuse, specular, shininess)
        Specular in grey levels.
    light : (3,)
        Unit vector to the light, camera axes.
    counts : (cap, side, around)
        Rings on a cap, rings on the side, sectors around, of the facets.
    rows : (l, 17)
        Pills with their facet frames, from `facet_rows`.
    facets : (l, r, c, 2)
        Light (body, gloss) of facets or of their corners; of no use in the other modes.
    """

    mode: int
    coefficients: Coefficients
    light: Float[np.ndarray, " 3"]
    counts: Counts
    rows: Float[np.ndarray, "l 17"]
    facets: Float[np.ndarray, "l r c 2"]


def make_look(
    pills: Pills, camera: Camera, material: Material, light: Light, mode: Mode = "phong", facets: Counts = (3, 4, 16)
) -> Look:
    """Prepare the light on posed pills.

    Parameters
    ----------
    facets : (int, int, int)
        Rings on a cap, rings on the side, sectors around: the coarse mesh of flat and Gouraud shading.

    Raises
    ------
    ValueError
        For a negative share, a light without direction or fewer facets than make a body.
    """
    shares = (material.ambient, material.diffuse, material.specular)
    if not (min(shares) >= 0 and material.shininess > 0):
        raise ValueError(f"material: shares of light {shares} must be >= 0 and shininess {material.shininess} > 0")
    size = float(np.linalg.norm(light.direction))
    if not (size > 0 and np.isfinite(size)):
        raise ValueError(f"light: direction {light.direction.tolist()} was given; wanted a finite, non-zero vector")
    if min(facets[0], facets[1]) < 1 or facets[2] < 3:
        raise ValueError(f"facets: {facets} is no body; wanted at least 1 ring on cap and side and 3 sectors")
    coefficients = (material.ambient, material.diffuse, 255.0 * material.specular, material.shininess)
    rows, towards = facet_rows(pill_table(pills)), light.direction / size
    lit = np.zeros((rows.shape[0], 1, 1, 2))
    if mode in ("flat", "gouraud"):
        lit = _light_of_facets(rows, facets, camera, coefficients, towards, mode == "flat")
    return Look(MODES[mode], coefficients, towards, facets, rows, lit)


def _light_of_facets(
    rows: Float[np.ndarray, "l 17"],
    counts: Counts,
    camera: Camera,
    coefficients: Coefficients,
    towards: Float[np.ndarray, " 3"],
    flat: bool,
) -> Float[np.ndarray, "l r c 2"]:
    """Light at the middle of each facet (`flat`), or at its first corner."""
    cap, side, around = counts
    middle = 0.5 if flat else 0.0
    point, normal = facet_points(rows, counts, np.arange(2 * cap + side + 1) + middle, np.arange(around) + middle)
    view = view_directions(camera, point.reshape(-1, 3))
    lit = point_light(normal.reshape(-1, 3), view, coefficients, towards)
    return lit.reshape(*point.shape[:3], 2)


def view_directions(camera: Camera, p_cam: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Unit vectors from points in camera axes to the eye."""
    if camera.kind == "orthographic":
        return np.tile([0.0, 0.0, -1.0], (p_cam.shape[0], 1))
    return -p_cam / np.sqrt((p_cam * p_cam).sum(axis=1, keepdims=True))


def point_light(
    n: Float[np.ndarray, "n 3"],
    view: Float[np.ndarray, "n 3"],
    coefficients: Coefficients,
    light: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, "n 2"]:
    """Body (ambient and diffuse, for the albedo to multiply) and gloss: twin of `_kernels.point_light`.

    >>> facing = np.array([[0.0, 0.0, -1.0]])
    >>> point_light(facing, facing, (0.25, 0.5, 20.0, 8.0), facing[0]).tolist()
    [[0.75, 20.0]]
    """
    ambient, diffuse, specular, shininess = coefficients
    facing = n @ light
    mirrored = 2.0 * facing * (n * view).sum(axis=1) - view @ light
    gloss = np.where((facing > 0) & (mirrored > 0), specular * np.maximum(mirrored, 0.0) ** shininess, 0.0)
    return np.column_stack([ambient + diffuse * np.maximum(facing, 0.0), gloss])


def surface(
    look: Look, camera: Camera, pill: Int[np.ndarray, " n"], p_cam: Float[np.ndarray, "n 3"]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Key and light of surface points: the twin of `_kernels.surface_key` and `_kernels.surface_light`.

    The key changes wherever the image may jump: at the silhouette, from pill to pill, or from facet to facet.
    """
    if look.mode == _kernels.BINARY:
        return np.zeros(pill.size, dtype=int), np.tile([1.0, 0.0], (pill.size, 1))
    rows = look.rows[pill]
    normal = pill_normal(rows, p_cam)
    if look.mode == _kernels.PHONG:
        return pill, point_light(normal, view_directions(camera, p_cam), look.coefficients, look.light)
    ring, sector = facet_place(rows, look.counts, p_cam, normal)
    lit = facet_light(look.facets, look.counts, pill, ring, sector, look.mode == _kernels.GOURAUD)
    if look.mode == _kernels.GOURAUD:
        return pill, lit
    i, j = facet_number(look.counts, ring, sector)
    cap, side, around = look.counts
    return (pill * (2 * cap + side) + i) * around + j, lit
