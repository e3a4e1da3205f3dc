"""Posed pills in, what can be seen of each out: depth order, truncated polygons, window functions, visible shares.

Two answers to the same question:

- *Polygons* (hand thesis, 4.3.3): every link's silhouette, less the silhouettes of the links in front of it. The thesis
  orders links by the mean depth of their polygons' vertices, which fails where a long link leads away from the viewer
  (its Figure 4.16); the order ``pairwise`` compares two links on the ray through the middle of their overlap instead.
- *Rays*: each sample point asks which pill its line of sight meets first. Nothing is ordered, so nothing can be
  ordered wrongly, pills may even pass through each other.

Both use pixels (x, y), and in both nothing outside the image is visible.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int, Shaped

from .camera import Camera, project_camera, rays
from .outlines import rims
from .pills import Pills, ray_hits


@dataclass(frozen=True, slots=True, eq=False)
class Layers:
    """Truncated polygons of posed links.

    Attributes
    ----------
    whole : (l,) shapely polygons, the silhouettes; empty for a link that is not wholly in front of the camera.
    truncated : (l,) shapely geometries, what of them can be seen inside the image; they may be in pieces, or empty.
    depth : (l,) mean depth of the polygons' vertices, model units along the viewing direction; NaN where empty.
    covers : (l, l) ``covers[i, j]``: link i is in front of link j, overlaps it, and was cut out of it.
    """

    whole: Shaped[np.ndarray, " l"]
    truncated: Shaped[np.ndarray, " l"]
    depth: Float[np.ndarray, " l"]
    covers: Bool[np.ndarray, "l l"]


def truncated_polygons(
    pills: Pills,
    camera: Camera,
    finger: Int[np.ndarray, " l"],
    order: str = "mean-depth",
    same_finger: bool = False,
    n_arc: int = 16,
) -> Layers:
    """Cut from every link's silhouette what other links hide of it.

    Parameters
    ----------
    pills : l pills in camera axes.
    camera : Camera
    finger : (l,) number of the finger each link belongs to.
    order : ``mean-depth``, the thesis's order of layers by the mean depth of the polygons' vertices; or ``pairwise``,
        by which surface is met first in the middle of each overlap, right wherever the two do not pass through each
        other.
    same_finger : whether the links of one finger hide each other too; the thesis (Figure 4.17) leaves them whole.
    n_arc : points on each end arc of a silhouette.

    Returns
    -------
    Layers

    Raises
    ------
    ValueError
        for an order of another name.

    Examples
    --------
    >>> from handtrack.camera import orthographic
    >>> balls = Pills(*[np.array([[0.0, 0.0, z] for z in (5.0, 9.0)])] * 2, np.array([[2.0, 2.0], [3.0, 3.0]]))
    >>> camera = orthographic(20, 20, 1.0, 10.0, 10.0, np.eye(3), np.zeros(3))
    >>> layers = truncated_polygons(balls, camera, np.array([0, 1]))
    >>> layers.covers.tolist(), visible_fraction(layers).round(2).tolist()
    ([[False, True], [False, False]], [1.0, 0.56])
    """
    if order not in ("mean-depth", "pairwise"):
        raise ValueError(f"order is {order!r}; wanted 'mean-depth' or 'pairwise'")
    rim = rims(pills, camera, n_arc)
    outline = project_camera(camera, rim)
    seen = np.isfinite(outline).all(axis=(1, 2))
    whole = np.full(seen.size, shapely.Polygon(), dtype=object)
    whole[seen] = shapely.polygons(outline[seen])
    depth = rim[..., 2].mean(axis=1)
    i, j = np.nonzero(np.triu(np.full((seen.size, seen.size), True) if same_finger else finger[:, None] != finger, k=1))
    meeting = _boxes_overlap(whole, i, j)
    i, j = i[meeting], j[meeting]
    meeting = shapely.intersects(whole[i], whole[j])
    i, j = i[meeting], j[meeting]
    first_in_front = _nearer_in_the_middle(pills, camera, whole, i, j) if order == "pairwise" else depth[i] <= depth[j]
    covers = np.zeros((seen.size, seen.size), dtype=bool)
    covers[np.where(first_in_front, i, j), np.where(first_in_front, j, i)] = True
    return Layers(whole, _inside_image(_cut(whole, covers), camera), depth, covers)


def _boxes_overlap(
    shapes: Shaped[np.ndarray, " l"], i: Int[np.ndarray, " p"], j: Int[np.ndarray, " p"]
) -> Bool[np.ndarray, " p"]:
    """Whether the bounding boxes of two shapes meet; False for empty ones, whose boxes are NaN."""
    low, high = np.split(shapely.bounds(shapes), 2, axis=1)
    return np.all((low[i] < high[j]) & (low[j] < high[i]), axis=1)


def _nearer_in_the_middle(
    pills: Pills, camera: Camera, whole: Shaped[np.ndarray, " l"], i: Int[np.ndarray, " p"], j: Int[np.ndarray, " p"]
) -> Bool[np.ndarray, " p"]:
    """Whether link i is met before link j on the ray through the middle of their overlap, convex and so inside it."""
    middle = shapely.centroid(shapely.intersection(whole[i], whole[j]))
    origin, direction = rays(camera, np.stack([shapely.get_x(middle), shapely.get_y(middle)], axis=-1))
    first = np.zeros(i.size, dtype=bool)
    for row, pair in enumerate(np.stack([i, j], axis=1)):
        two = Pills(pills.base[pair], pills.tip[pair], pills.radius[pair])
        first[row] = ray_hits(two, origin[row : row + 1], direction[row : row + 1]).pill[0] == 0
    return first


def _cut(whole: Shaped[np.ndarray, " l"], covers: Bool[np.ndarray, "l l"]) -> Shaped[np.ndarray, " l"]:
    """Each shape less those that cover it, one covering shape after the other: quicker than uniting them first."""
    truncated = whole.copy()
    for link in np.flatnonzero(covers.any(axis=1)):
        under = covers[link]
        truncated[under] = shapely.difference(truncated[under], whole[link])
    return truncated


def _inside_image(shapes: Shaped[np.ndarray, " l"], camera: Camera) -> Shaped[np.ndarray, " l"]:
    """Clip shapes to the image, whose pixels reach half a pixel beyond their centres."""
    low, high = np.split(shapely.bounds(shapes), 2, axis=1)
    corner = np.array([camera.width, camera.height]) - 0.5
    out = np.flatnonzero(np.any((low < -0.5) | (high > corner), axis=1))
    shapes[out] = shapely.intersection(shapes[out], shapely.box(-0.5, -0.5, *corner))
    return shapes


def window(
    polygon: shapely.Geometry | Shaped[np.ndarray, "*b"], xy: Float[np.ndarray, "*c 2"]
) -> Bool[np.ndarray, "*c"]:
    """Window function of samples: one where they fall inside their link's truncated polygon, else zero (4.3.3).

    Parameters
    ----------
    polygon : one geometry for all points, or an array of them whose shape broadcasts against that of the points: for
        (l, s, 2), s samples of l links, ``layers.truncated[:, None]``; for (n, 2) with the link of each,
        ``layers.truncated[link]``.
    xy : (*c, 2) px.

    Returns
    -------
    (*c) bool; False on the border and for NaN.

    Examples
    --------
    >>> window(shapely.box(0, 0, 2, 2), np.array([[1.0, 1.0], [3.0, 1.0]])).tolist()
    [True, False]
    """
    shapely.prepare(polygon)
    return np.asarray(shapely.contains_xy(polygon, xy[..., 0], xy[..., 1]))


def visible_fraction(layers: Layers) -> Float[np.ndarray, " l"]:
    """Visible share of each link's silhouette by area, 0 to 1; 0 for a link behind the camera or out of the image."""
    area = shapely.area(layers.whole)
    share = shapely.area(layers.truncated) / np.where(area > 0, area, 1.0)
    return np.clip(share, 0.0, 1.0)


def first_links(pills: Pills, camera: Camera, xy: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
    """Link that is seen at each sample point.

    Parameters
    ----------
    pills : l pills in camera axes; those not wholly in front of a perspective camera are left out.
    camera : Camera
    xy : (n, 2) px.

    Returns
    -------
    (n,) index of the first link on the line of sight; -1 on the background, -2 outside the image or for NaN.

    Examples
    --------
    >>> from handtrack.camera import orthographic
    >>> balls = Pills(*[np.array([[0.0, 0.0, z] for z in (5.0, 9.0)])] * 2, np.array([[2.0, 2.0], [3.0, 3.0]]))
    >>> camera = orthographic(20, 20, 1.0, 10.0, 10.0, np.eye(3), np.zeros(3))
    >>> first_links(balls, camera, np.array([[10.0, 10.0], [12.5, 10.0], [15.0, 10.0], [30.0, 10.0]])).tolist()
    [0, 1, -1, -2]
    """
    kept = np.arange(len(pills.base))
    if camera.kind == "perspective":
        kept = np.flatnonzero((pills.base[:, 2] > pills.radius[:, 0]) & (pills.tip[:, 2] > pills.radius[:, 1]))
    inside = np.all((xy >= -0.5) & (xy < np.array([camera.width, camera.height]) - 0.5), axis=-1)
    link = np.full(len(xy), -2)
    hit = ray_hits(Pills(pills.base[kept], pills.tip[kept], pills.radius[kept]), *rays(camera, xy[inside])).pill
    link[inside] = np.where(hit < 0, -1, np.append(kept, -1)[hit])
    return link


def visible_samples(
    pills: Pills,
    camera: Camera,
    link: Int[np.ndarray, " n"],
    xy: Float[np.ndarray, "n 2"],
    finger: Int[np.ndarray, " l"] | None = None,
) -> Bool[np.ndarray, " n"]:
    """Whether each sample shows its link: the per-sample order, right where the mean depth is wrong (Figure 4.16).

    Parameters
    ----------
    pills : l pills in camera axes.
    camera : Camera
    link : (n,) link that each sample belongs to.
    xy : (n, 2) px.
    finger : (l,) number of each link's finger; if given, the other links of a sample's own finger do not hide it, as in
        the thesis's Figure 4.17.

    Returns
    -------
    (n,) True where the link is the first on the line of sight; False beside its silhouette and outside the image.

    Examples
    --------
    >>> from handtrack.camera import orthographic
    >>> balls = Pills(*[np.array([[0.0, 0.0, z] for z in (5.0, 9.0)])] * 2, np.array([[2.0, 2.0], [3.0, 3.0]]))
    >>> camera = orthographic(20, 20, 1.0, 10.0, 10.0, np.eye(3), np.zeros(3))
    >>> xy = np.array([[10.0, 10.0], [12.5, 10.0]])
    >>> visible_samples(balls, camera, np.array([1, 1]), xy).tolist()
    [False, True]
    >>> visible_samples(balls, camera, np.array([1, 1]), xy, finger=np.array([0, 0])).tolist()
    [True, True]
    """
    if finger is None:
        return first_links(pills, camera, xy) == link
    visible = np.zeros(len(xy), dtype=bool)
    for own in np.unique(link):
        mine = np.flatnonzero(link == own)
        cast = np.append(np.flatnonzero(finger != finger[own]), own)
        some = Pills(pills.base[cast], pills.tip[cast], pills.radius[cast])
        visible[mine] = first_links(some, camera, xy[mine]) == len(cast) - 1
    return visible


def sample_fraction(
    link: Int[np.ndarray, " n"], visible: Bool[np.ndarray, " n"], n_links: int
) -> Float[np.ndarray, " l"]:
    """Share of each link's samples that are visible, 0 to 1; 0 for a link without samples.

    Examples
    --------
    >>> sample_fraction(np.array([0, 0, 2]), np.array([True, False, True]), 3).tolist()
    [0.5, 0.0, 1.0]
    """
    seen = np.bincount(link[visible], minlength=n_links)
    return seen / np.maximum(np.bincount(link, minlength=n_links), 1)
