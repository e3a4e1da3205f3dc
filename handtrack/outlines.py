"""Pills in, their shapes in the image out: rims, silhouettes, hulls, reduced and merged polygons, and meshes.

The rim of a pill is the closed curve on its surface where the lines of sight touch it: an arc of a circle on each of
the two end spheres, and two straight segments, where the common tangent planes touch. From the origin, sphere i with
centre c_i and radius r_i is touched along the cone ``d . c_i / |c_i| = cos(b_i)``, ``sin(b_i) = r_i / |c_i|``, and the
planes ``n . c1 = r1, n . c2 = r2, |n| = 1`` touch it at the angle f_i about its axis, counted from the direction that
leads away from the other sphere, with

    cos(f_1) = (sin(b_2) - sin(b_1) cos(e)) / (cos(b_1) sin(e)),    e = angle between c1 and c2,

and the indices exchanged for f_2. Parallel lines of sight are the limit ``cos(f_1) = (r2 - r1) / D``, D the distance of
the centres in the image plane. Where one sphere hides the other, the rim is the circle of the larger one alone. The
silhouette is the rim's projection, so lens distortion costs nothing but more points on the segments.

Polygons follow appendix C of the hand thesis: convex hull, Douglas-Peucker reduction, merged fingers.
"""

from collections.abc import Iterable

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, QhullError

from .camera import Camera, project_camera
from .pills import Pills

IN_LINE = 1e-8  # rad: closer than this two centres stand in line, and rounding decides their cross product


def silhouettes(pills: Pills, camera: Camera, n_arc: int = 24) -> Float[np.ndarray, "l m 2"]:
    """Outlines of pills in the image, as polygons whose vertices lie exactly on the silhouette.

    Parameters
    ----------
    pills : l pills in camera axes.
    camera : Camera
    n_arc : points on each of the two end arcs, at least 2. A chord stays within ``r (1 - cos(pi / (2 n_arc - 2)))`` of
        an arc of radius r over a half circle: 0.002 r for the default.

    Returns
    -------
    (l, m, 2) px, not closed, base arc first, then tip arc; in one turning sense. NaN for a pill that is not wholly in
    front of a perspective camera.

    Examples
    --------
    >>> from handtrack.camera import orthographic
    >>> ball = Pills(np.zeros((1, 3)), np.zeros((1, 3)), np.array([[2.0, 1.0]]))
    >>> xy = silhouettes(ball, orthographic(9, 9, 1.0, 4.0, 4.0, np.eye(3), np.zeros(3)))
    >>> bool(np.allclose(np.hypot(*(xy[0] - 4.0).T), 2.0))
    True
    """
    return project_camera(camera, rims(pills, camera, n_arc))


def rims(pills: Pills, camera: Camera, n_arc: int = 24) -> Float[np.ndarray, "l m 3"]:
    """Points of each pill's surface where the lines of sight touch it, in camera axes.

    Parameters
    ----------
    pills, camera, n_arc : as for `silhouettes`. The segments get ``n_arc`` points too where the lens bends them.

    Returns
    -------
    (l, m, 3) model units; NaN for a pill that is not wholly in front of a perspective camera.

    Raises
    ------
    ValueError
        for fewer than two points on an arc.
    """
    if n_arc < 2:
        raise ValueError(f"n_arc is {n_arc}; wanted at least 2 points on an arc")
    circles = _parallel_circles(pills) if camera.kind == "orthographic" else _cone_circles(pills)
    centre, away, side, touch = circles
    share = np.linspace(-1.0, 1.0, n_arc) * np.array([[1.0], [-1.0]])  # the tip arc runs back
    angle = touch[..., None] * share  # (l, 2, n_arc)
    arcs = (
        centre[:, :, None] + np.cos(angle)[..., None] * away[:, :, None] + np.sin(angle)[..., None] * side[:, :, None]
    )
    if not camera.distortion.any():
        return arcs.reshape(arcs.shape[0], 2 * n_arc, 3)
    step = np.linspace(0.0, 1.0, n_arc + 2)[1:-1, None]
    there, back = (
        a + step * (b - a) for a, b in ((arcs[:, 0, -1:], arcs[:, 1, :1]), (arcs[:, 1, -1:], arcs[:, 0, :1]))
    )
    return np.concatenate([arcs[:, 0], there, arcs[:, 1], back], axis=1)


def _parallel_circles(
    pills: Pills,
) -> tuple[
    Float[np.ndarray, "l 2 3"], Float[np.ndarray, "l 2 3"], Float[np.ndarray, "l 2 3"], Float[np.ndarray, "l 2"]
]:
    """For lines of sight along z: both ends' rim circles: centre, radii away and sideways, and touch angle."""
    ends = np.stack([pills.base, pills.tip], axis=1)
    apart = ends[:, 0, :2] - ends[:, 1, :2]
    far = np.hypot(apart[:, 0], apart[:, 1])
    r1, r2 = pills.radius.T
    hidden = far <= np.abs(r1 - r2)
    unit = np.where((far > 0)[:, None], apart / np.where(far > 0, far, 1.0)[:, None], [1.0, 0.0])
    flat = np.zeros((far.size, 2, 3))
    flat[:, 0, :2], flat[:, 1, :2] = unit, -unit
    sideways = np.zeros((far.size, 2, 3))
    sideways[:, :, 0], sideways[:, :, 1] = -unit[:, 1:], unit[:, :1]
    cosine = np.where(hidden, 0.0, (r2 - r1) / np.where(hidden, 1.0, far))
    touch = np.arccos(np.stack([cosine, -cosine], axis=1))
    centre, radius = _larger_where(hidden, r1 >= r2, ends, pills.radius)
    return centre, radius[..., None] * flat, radius[..., None] * sideways, touch


def _cone_circles(
    pills: Pills,
) -> tuple[
    Float[np.ndarray, "l 2 3"], Float[np.ndarray, "l 2 3"], Float[np.ndarray, "l 2 3"], Float[np.ndarray, "l 2"]
]:
    """The same for lines of sight through the origin."""
    ends = np.stack([pills.base, pills.tip], axis=1)
    front = np.all(ends[..., 2] > pills.radius, axis=1)
    if not front.all():
        ends = np.where(front[:, None, None], ends, [0.0, 0.0, 2.0])
    size = np.where(front[:, None], pills.radius, 1.0)
    distance = np.sqrt((ends * ends).sum(axis=-1))
    axis = ends / distance[..., None]
    sine = size / distance
    cosine = np.sqrt(1.0 - sine * sine)
    normal = _cross(axis[:, 0], axis[:, 1])
    sin_e = np.sqrt((normal * normal).sum(axis=-1))
    cos_e = (axis[:, 0] * axis[:, 1]).sum(axis=-1)
    half = np.arcsin(sine)
    in_line = sin_e < IN_LINE
    hidden = in_line | (np.abs(half[:, 0] - half[:, 1]) >= np.arctan2(sin_e, cos_e))
    if in_line.any():  # any direction across the axis will do
        spare = _cross(axis[:, 0], np.where(np.abs(axis[:, 0, :1]) < 0.5, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
        normal = np.where(in_line[:, None], spare, normal)
    normal = normal / np.sqrt((normal * normal).sum(axis=-1, keepdims=True))
    safe = np.where(hidden[:, None], 1.0, cosine * sin_e[:, None])
    touch = np.arccos(
        np.where(hidden[:, None], 0.0, np.clip((sine[:, ::-1] - sine * cos_e[:, None]) / safe, -1.0, 1.0))
    )
    # The touching circle of a sphere lies nearer than its centre, and is smaller: c cos(b)^2 and r cos(b).
    centre, radius = ends * (cosine * cosine)[..., None], size * cosine
    if hidden.any():
        larger = half[:, 0] >= half[:, 1]
        axis, _ = _larger_where(hidden, larger, axis, radius)
        centre, radius = _larger_where(hidden, larger, centre, radius)
    away = _cross(np.stack([axis[:, 0], -axis[:, 1]], axis=1), normal[:, None])
    centre = np.where(front[:, None, None], centre, np.nan)
    return centre, radius[..., None] * away, radius[..., None] * normal[:, None], touch


def _cross(a: Float[np.ndarray, "*n 3"], b: Float[np.ndarray, "*m 3"]) -> Float[np.ndarray, "*k 3"]:
    """Cross product; np.cross spends most of its time on checks at these sizes."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def _larger_where(
    hidden: Bool[np.ndarray, " l"],
    first: Bool[np.ndarray, " l"],
    points: Float[np.ndarray, "l 2 3"],
    radius: Float[np.ndarray, "l 2"],
) -> tuple[Float[np.ndarray, "l 2 3"], Float[np.ndarray, "l 2"]]:
    """Take both ends from the larger sphere (the first where `first`) where it hides the other."""
    end = np.where(hidden[:, None], np.where(first, 0, 1)[:, None], np.array([0, 1]))
    row = np.arange(hidden.size)[:, None]
    return points[row, end], radius[row, end]


def mesh(
    radius_base: float, radius_tip: float, length: float, n_around: int = 24, n_cap: int = 8
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Closed triangle mesh of a pill along the x axis, base centre at the origin (hand thesis, Figure 10.1).

    Parameters
    ----------
    radius_base, radius_tip, length : model units, radii > 0 and length >= 0.
    n_around : vertices around the axis, at least 3.
    n_cap : rings on each end cap, at least 1; the last ring of each cap is where the tangent cone touches.

    Returns
    -------
    (vertices, faces)
        Vertices on the surface; faces count anticlockwise seen from outside.

    Raises
    ------
    ValueError
        for sizes or counts out of these ranges.

    Examples
    --------
    >>> vertices, faces = mesh(9.0, 7.0, 40.0)
    >>> vertices.min(axis=0)[0].item(), vertices.max(axis=0)[0].item()
    (-9.0, 47.0)
    """
    if not (radius_base > 0 and radius_tip > 0 and length >= 0):
        raise ValueError(
            f"radii and length are {radius_base}, {radius_tip}, {length}; wanted radii > 0 and length >= 0"
        )
    if n_around < 3 or n_cap < 1:
        raise ValueError(f"n_around, n_cap are {n_around}, {n_cap}; wanted at least 3 and 1")
    # A surface normal makes the angle `polar` with the x axis: pi at the base pole, 0 at the tip pole.
    step = np.arange(1, n_cap + 1) / n_cap
    if length <= abs(radius_base - radius_tip):  # one sphere holds the other
        polar = np.pi * (1.0 - np.arange(1, 2 * n_cap) / (2 * n_cap))
        radius = np.full(polar.size, max(radius_base, radius_tip))
        centre = np.full(polar.size, 0.0 if radius_base >= radius_tip else length)
    else:
        edge = np.arccos((radius_base - radius_tip) / length)
        polar = np.concatenate([np.pi - (np.pi - edge) * step, edge * step[::-1]])
        radius = np.repeat([radius_base, radius_tip], n_cap)
        centre = np.repeat([0.0, length], n_cap)
    turn = 2.0 * np.pi * np.arange(n_around) / n_around
    x = np.repeat((centre + radius * np.cos(polar))[:, None], n_around, axis=1)
    out = (radius * np.sin(polar))[:, None]
    rings = np.stack([x, out * np.cos(turn), out * np.sin(turn)], axis=-1).reshape(-1, 3)
    poles = np.array([[centre[0] - radius[0], 0.0, 0.0], [centre[-1] + radius[-1], 0.0, 0.0]])
    return np.concatenate([rings, poles]), _ring_faces(polar.size, n_around)


def _ring_faces(n_rings: int, n_around: int) -> Int[np.ndarray, "f 3"]:
    """Triangles between neighbouring rings of vertices, and to the two poles that follow them."""
    here = np.arange(n_around)
    after = (here + 1) % n_around
    low = (np.arange(n_rings - 1) * n_around)[:, None]
    a, b = low + here, low + after
    c, d = a + n_around, b + n_around
    sides = np.stack([np.stack([a, b, c], axis=-1), np.stack([b, d, c], axis=-1)]).reshape(-1, 3)
    last, pole = (n_rings - 1) * n_around, n_rings * n_around
    base = np.stack([np.full(n_around, pole), after, here], axis=-1)
    tip = np.stack([np.full(n_around, pole + 1), last + here, last + after], axis=-1)
    return np.concatenate([sides, base, tip])


def convex_hull(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    """Corners of the smallest convex polygon around points, in order (hand thesis, appendix C).

    Parameters
    ----------
    points : (n, 2), any unit, finite, not all on one line.

    Returns
    -------
    (m, 2) corners with rising angle from x towards y, not closed.

    Raises
    ------
    ValueError
        for points that span no area.

    Examples
    --------
    >>> convex_hull(np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.5], [2.0, 2.0], [0.0, 2.0]])).shape
    (4, 2)
    """
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError) as error:
        raise ValueError(
            f"points of shape {points.shape}; wanted three or more finite ones that are not in line"
        ) from error


def simplify(polygon: Float[np.ndarray, "m 2"], tolerance: float | None = None) -> Float[np.ndarray, "k 2"]:
    """Drop vertices that matter little: Douglas and Peucker's reduction (hand thesis, appendix C).

    Parameters
    ----------
    polygon : (m, 2), not closed, at least three vertices.
    tolerance : how far a dropped vertex may lie from the result, same unit; by default the thesis's A / (250 N), A
        being the perimeter and N the number of vertices.

    Returns
    -------
    (k, 2), a choice of the vertices in their order, not closed; always at least three.

    Raises
    ------
    ValueError
        for a negative or NaN tolerance, or fewer than three vertices.

    Notes
    -----
    The work is done by GEOS, which keeps the ring's start and never lets a polygon cross itself or collapse.

    Examples
    --------
    >>> simplify(np.array([[0.0, 0.0], [1.0, 0.0001], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])).tolist()
    [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
    """
    if len(polygon) < 3:
        raise ValueError(f"polygon has {len(polygon)} vertices; wanted at least 3")
    if tolerance is None:
        edges = polygon - np.roll(polygon, 1, axis=0)
        tolerance = float(np.hypot(edges[:, 0], edges[:, 1]).sum()) / (250.0 * len(polygon))
    if not tolerance >= 0:
        raise ValueError(f"tolerance is {tolerance}; wanted a distance of 0 or more")
    reduced = shapely.simplify(shapely.polygons(polygon), tolerance, preserve_topology=True)
    return shapely.get_coordinates(reduced)[:-1]


def merged_polygon(polygons: Iterable[Float[np.ndarray, "m 2"]]) -> shapely.Geometry:
    """Union of polygons: the outline of a finger from those of its links (hand thesis, Figure 10.6).

    Parameters
    ----------
    polygons : each (m, 2), not closed, with at least three vertices; one with NaN (behind the camera) is left out.

    Returns
    -------
    shapely.Geometry
        A polygon, or several where the parts do not touch; empty without parts.

    Examples
    --------
    >>> square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    >>> merged_polygon([square, square + 1.0]).area
    7.0
    """
    return shapely.union_all([shapely.Polygon(polygon) for polygon in polygons if np.isfinite(polygon).all()])
