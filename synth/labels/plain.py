"""The compiled loops of labels in plain NumPy, one surface after the other: what they are tested against.

Nothing here is fast. Rays are given by normalised coordinates `xy` (n, 2) and the window row of each, which decides
the instant at which a rolling shutter sees them.
"""

import numpy as np
from jaxtyping import Float, Int, UInt8, UInt64

from handtrack.camera import Camera, distort

from .. import _kernels
from ..raycast import pill_depth, pill_normal
from .geometry import Geometry, Span

Hits = tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"], UInt64[np.ndarray, " n"]]


def scan(geometry: Geometry, xy: Float[np.ndarray, "n 2"], row: Int[np.ndarray, " n"]) -> Hits:
    """Depth, first surface and bits of all parts on rays: twin of `_kernels.scan`, `scan_samples`, `first_surfaces`."""
    depth, surface = np.full(row.size, np.inf), np.full(row.size, -1)
    bits = np.zeros(row.size, np.uint64)
    count = geometry.tables[0]
    for k in range(geometry.part_of.size):
        t = pill_on(geometry, k, xy, row) if k < count else triangle_on(geometry, k - count, xy, row)[0]
        bits |= np.where(np.isfinite(t), np.uint64(1) << np.uint64(geometry.part_of[k]), np.uint64(0))
        nearer = t < depth - _kernels.TIE
        depth[nearer], surface[nearer] = t[nearer], k
    return depth, surface, bits


def pill_on(geometry: Geometry, k: int, xy: Float[np.ndarray, "n 2"], row: Int[np.ndarray, " n"]):
    """Depth of a pill on rays, each at its row's instant."""
    step = geometry.tables[1]
    t = np.full(row.size, np.inf)
    for v in np.unique(row) if step else row[:1]:
        here = row == v if step else np.full(row.size, True)
        t[here] = pill_depth(geometry.pills[k + step * v], geometry.pinhole, xy[here])
    return t


def corners_at(
    vertices: Float[np.ndarray, "k v 3"], geometry: Geometry, t: Int[np.ndarray, "*n"], row: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3 3"]:
    """Corners of one triangle, or of one for each ray, at the rows' instants."""
    knot, share = geometry.knot[row][:, None], geometry.blend[row][:, None, None]
    index = np.broadcast_to(geometry.triangles[t], (row.size, 3))
    low, high = vertices[knot, index], vertices[np.minimum(knot + 1, vertices.shape[0] - 1), index]
    return low + share * (high - low)


def triangle_on(
    geometry: Geometry, t: Int[np.ndarray, "*n"] | int, xy: Float[np.ndarray, "n 2"], row: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Depth of a triangle on rays, and the shares of its corners, by Cramer's rule for o + s d = sum of shares."""
    corners = corners_at(geometry.vertices, geometry, np.asarray(t), row)
    origin = np.column_stack([0.0 * xy if geometry.pinhole else xy, np.zeros(row.size)])
    direction = np.column_stack([xy if geometry.pinhole else 0.0 * xy, np.ones(row.size)])
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    system = np.stack([one, two, -direction], axis=2)
    whole = np.linalg.det(system)
    solved = np.full((row.size, 3), np.nan)
    fit = np.abs(whole) > 0
    solved[fit] = np.linalg.solve(system[fit], (origin - corners[:, 0])[fit][..., None])[..., 0]
    shares = np.column_stack([1.0 - solved[:, 0] - solved[:, 1], solved[:, :2]])
    with np.errstate(invalid="ignore"):
        inside = (shares >= 0).all(axis=1) & ((solved[:, 2] > 1e-6) | (not geometry.pinhole))
    return np.where(inside, solved[:, 2], np.inf), shares


def places(
    geometry: Geometry,
    xy: Float[np.ndarray, "n 2"],
    row: Int[np.ndarray, " n"],
    depth: Float[np.ndarray, " n"],
    surface: Int[np.ndarray, " n"],
) -> Float[np.ndarray, "6 n"]:
    """Normals and own places of hits: twin of `_kernels.places`."""
    out = np.zeros((6, row.size))
    count, step = geometry.tables
    p = np.column_stack([xy * depth[:, None] if geometry.pinhole else xy, depth])
    pill = surface < count
    table, frame = (rows[surface[pill] + step * row[pill]] for rows in (geometry.pills, geometry.frames))
    out[:3, pill] = pill_normal(table, p[pill]).T
    axes = frame[:, 3:].reshape(-1, 3, 3)
    out[3:, pill] = (axes @ (p[pill] - frame[:, :3])[..., None])[..., 0].T
    skin = ~pill
    t = surface[skin] - count
    _, shares = triangle_on(geometry, t, xy[skin], row[skin])
    at = np.minimum(geometry.knot[row[skin]], geometry.normals.shape[0] - 1)
    normal = (shares[..., None] * geometry.normals[at[:, None], geometry.triangles[t]]).sum(axis=1)
    out[:3, skin] = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).T
    out[3:, skin] = (shares[..., None] * geometry.rest[geometry.triangles[t]]).sum(axis=1).T
    return out


def mixture(
    texture: Int[np.ndarray, " n"], p: Float[np.ndarray, "n 3"], lattice: Float[np.ndarray, "c c c"]
) -> Float[np.ndarray, " n"]:
    """Share of the second colour at places given in grains."""
    low = np.floor(p)
    a = p - low
    a = a * a * (3.0 - 2.0 * a)
    i = low.astype(np.int64)
    noise = np.zeros(p.shape[0])
    for corner in np.ndindex(2, 2, 2):
        at = (i + corner) % lattice.shape[0]
        weight = np.where(corner, a, 1.0 - a).prod(axis=1)
        noise += weight * lattice[at[:, 0], at[:, 1], at[:, 2]]
    stripes = 0.5 + 0.5 * np.sin(2.0 * np.pi * (p @ np.array([1.0, 0.35, 0.2])))
    return np.choose(texture, [np.zeros(p.shape[0]), noise, stripes, i.sum(axis=1) % 2])


def lit(
    placed: Float[np.ndarray, "6 n"],
    xy: Float[np.ndarray, "n 2"],
    pinhole: bool,
    paint: Float[np.ndarray, "n 10"],
    lights: Float[np.ndarray, "k 6"],
    ambient: float,
    lattice: Float[np.ndarray, "c c c"],
) -> Float[np.ndarray, "n 3"]:
    """Colours of hits, each with the paint of its row: twin of `mix_colours` and `light_up`."""
    share = mixture(paint[:, 6].astype(int), placed[3:].T * paint[:, 7:8], lattice)[:, None]
    own = paint[:, :3] + share * (paint[:, 3:6] - paint[:, :3])
    view = np.tile([0.0, 0.0, -1.0], (xy.shape[0], 1))
    if pinhole:
        view = -np.column_stack([xy, np.ones(xy.shape[0])])
        view /= np.linalg.norm(view, axis=1, keepdims=True)
    out, normal = ambient * own, placed[:3].T
    for light in lights:
        facing = normal @ light[:3]
        mirrored = 2.0 * facing * (normal * view).sum(axis=1) - view @ light[:3]
        t = np.where((facing > 0) & (mirrored > 0), mirrored, 0.0)
        gloss = paint[:, 8] * t / (paint[:, 9] - paint[:, 9] * t + t)
        out = out + light[3:] * (own * np.maximum(facing, 0.0)[:, None] + gloss[:, None])
    return out


def flow(
    here: Geometry,
    there: Geometry,
    camera: Camera,
    xy: Float[np.ndarray, "n 2"],
    row: Int[np.ndarray, " n"],
    depth: Float[np.ndarray, " n"],
    surface: Int[np.ndarray, " n"],
) -> Float[np.ndarray, "n 2"]:
    """Pixels where surface points are one frame later: twin of `_kernels.flow`, which takes their place now away."""
    count, step = here.tables
    placed = places(here, xy, row, depth, surface)[3:].T
    p = np.zeros((row.size, 3))
    pill = surface < count
    frame = there.frames[surface[pill] + step * row[pill]]
    p[pill] = frame[:, :3] + (frame[:, 3:].reshape(-1, 3, 3).transpose(0, 2, 1) @ placed[pill][..., None])[..., 0]
    t = surface[~pill] - count
    _, shares = triangle_on(here, t, xy[~pill], row[~pill])
    p[~pill] = (shares[..., None] * corners_at(there.vertices, here, t, row[~pill])).sum(axis=1)
    flat = p[:, :2] / p[:, 2:] if here.pinhole else p[:, :2]
    return distort(flat, camera.distortion) * (camera.fx, camera.fy) + (camera.cx, camera.cy)


def sensed(
    background: UInt8[np.ndarray, "h w 3"],
    window: Float[np.ndarray, "a b 3"],
    span: Span,
    gain: float,
    vignette: float,
) -> Float[np.ndarray, "h w 3"]:
    """Grey levels before noise and rounding: twin of `_kernels.sensed` without its noise."""
    out = background.astype(float)
    out[span[2] : span[3], span[0] : span[1]] = window
    v, u = np.mgrid[: out.shape[0], : out.shape[1]] - 0.5 * (np.array(out.shape[:2]) - 1.0)[:, None, None]
    r2 = u * u + v * v
    return out * (gain * (1.0 - vignette * r2 / max(r2.max(), 1e-300)))[..., None]
