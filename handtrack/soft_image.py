"""Posed pills and their appearance in, a smooth image and what it says of every link's motion out.

A pixel is a square of sensor. Each pill covers a share `a_k` of it, known from the distance d of its outline in pixels
(`pills.clearance`, in either projection) and the direction in which the outline crosses the square,

    a_k = A(d_k, n_k) * lens,        I = sum_k w_k c_k + (1 - sum w) background,

where A is the area a straight edge leaves of a square, c_k the grey level of the pill there, and w_k the share that
shows when the pills are laid over each other from front to back: `(1 - m) a_k` behind what covers m where two edges
cross, `a_k - m` where they run side by side, `min(a_k, 1 - m)` where they face each other. Where two pills meet in a
crease, the nearer one gives way over one pixel. Near an outline a pixel is cut into smaller squares.

Every part has a derivative by the twist of the links (velocity of the base, angular velocity), so

    H = sum over pixels of (dI/dtwist)^T (dI/dtwist)

holds both what moving outlines and what changing shades tell. The turning of an edge inside its pixel is left out: it
is of second order.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr

from . import _kernels
from .appearance import SHARP, Appearance, shade_numpy
from .camera import Camera, rays
from .pills import Pills, clearance, ray_hits_numpy

FINE, BLOCK = 1, 8  # squares along the side of a pixel on an edge; pixels along the side of a block without edges
_LEAST, _FAINT = 1e-3, 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class SoftImage:
    """A smooth image and the information of its pixels, for noise of one grey level.

    Attributes
    ----------
    image : (h, w)
        Grey levels.
    motion : (6l, 6l)
        By the twists of the links in camera axes: velocity of the base (model units), angular velocity (radians).
    cross, light : (6l, m), (m, m)
        The same for the appearance: 28 coefficients of the shading, l gains, the background; empty unless asked for.
    """

    image: Float[np.ndarray, "h w"]
    motion: Float[np.ndarray, "n n"]
    cross: Float[np.ndarray, "n m"]
    light: Float[np.ndarray, "m m"]


def ray_grid(camera: Camera) -> Float[np.ndarray, "h w 2"]:
    """Normalised coordinates (undistorted) of all pixel centres."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    origin, direction = rays(camera, np.stack([u.ravel(), v.ravel()], axis=1))
    flat = origin[:, :2] if camera.kind == "orthographic" else direction[:, :2]
    return np.ascontiguousarray(flat).reshape(*u.shape, 2)


def soft_image(
    pills: Pills,
    camera: Camera,
    appearance: Appearance,
    grid: Float[np.ndarray, "h w 2"] | None = None,
    *,
    fine: int = FINE,
    block: int = BLOCK,
    light: bool = False,
) -> SoftImage:
    """Render pills with a known appearance, with the information of the image on the motion of every link.

    Parameters
    ----------
    pills : Pills
        In camera axes.
    appearance : Appearance
        Its blur is split into that of the pixel and its sampling, `SHARP`, and that of the lens.
    grid : (h, w, 2)
        From `ray_grid`, to be computed once for each camera.
    fine : int
        Squares along the side of a pixel near an outline.
    block : int
        A power of two: pixels along the side of the largest block that one sample stands for, away from edges; 1 for
        an image to look at.
    light : bool
        Whether the derivatives by the appearance are wanted as well.
    """
    grid = ray_grid(camera) if grid is None else grid
    links, m = pills.base.shape[0], 29 + pills.base.shape[0] if light else 0
    image, H = np.empty(grid.shape[:2]), np.zeros((6 * links + m, 6 * links + m))
    _kernels.soft_image(
        grid,
        camera.kind == "perspective",
        (pills.base, pills.tip, pills.radius),
        pill_boxes(pills, camera),
        (appearance.shading, appearance.gain),
        float(appearance.background),
        lens_blur(appearance),
        fine,
        block,
        light,
        image,
        H,
    )
    H = np.triu(H) + np.triu(H, 1).T
    return SoftImage(image, H[: 6 * links, : 6 * links], H[: 6 * links, 6 * links :], H[6 * links :, 6 * links :])


def lens_blur(appearance: Appearance) -> float:
    """Standard deviation of the blur beyond that of a square pixel, pixels."""
    return float(np.sqrt(max(appearance.blur**2 - SHARP**2, 0.0)))


def pill_boxes(pills: Pills, camera: Camera) -> Float[np.ndarray, "l 4"]:
    """Lowest and highest normalised coordinates (x, x, y, y) of each pill; empty if it reaches behind the camera."""
    centre, r = np.stack([pills.base, pills.tip]), pills.radius.T[..., None]
    low, high = centre[..., :2] - r, centre[..., :2] + r
    if camera.kind == "perspective":
        near, far = centre[..., 2:] - r, centre[..., 2:] + r
        safe = near > 1e-6 * np.abs(far)
        near, far = np.where(safe, near, 1.0), np.where(safe, far, 1.0)
        low = np.where(safe, np.minimum(low / near, low / far), np.inf)
        high = np.where(safe, np.maximum(high / near, high / far), -np.inf)
    low, high = low.min(axis=0), high.max(axis=0)
    broken = ~(np.isfinite(low) & np.isfinite(high)).all(axis=1)
    low[broken], high[broken] = np.inf, -np.inf
    return np.column_stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]])


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What each of l pills shows in each of n squares; twin of one row of facts in the kernel."""

    there: Bool[np.ndarray, "l n"]
    share: Float[np.ndarray, "l n"]
    level: Float[np.ndarray, "l n"]
    depth: Float[np.ndarray, "l n"]
    edge: Float[np.ndarray, "l n 2"]
    size: Float[np.ndarray, "l n"]
    lean: Float[np.ndarray, "l n 2"]
    hit: Bool[np.ndarray, "l n"]


def soft_image_numpy(
    pills: Pills,
    camera: Camera,
    appearance: Appearance,
    *,
    fine: int = FINE,
    edges_of: Pills | None = None,
) -> Float[np.ndarray, "h w"]:
    """The image of `soft_image` in plain NumPy, every pixel cut: the kernel's twin, and by differences its derivatives.

    Parameters
    ----------
    edges_of : Pills, optional
        Pills whose edges cross the pixels in the directions that are used, so that differences leave out what the
        kernel's derivatives leave out.
    """
    grid = ray_grid(camera)
    flat = np.concatenate([grid, *np.gradient(grid, axis=(1, 0))], axis=2).reshape(-1, 6)
    steps = (np.arange(fine) + 0.5) / fine - 0.5
    image = np.zeros(flat.shape[0])
    for v in steps:
        for u in steps:
            place = flat.copy()
            place[:, :2] += u * flat[:, 2:4] + v * flat[:, 4:]
            turned = None if edges_of is None else _see(edges_of, camera, appearance, place, 1.0 / fine, None)
            seen = _see(pills, camera, appearance, place, 1.0 / fine, turned)
            image += _composite(seen, place, camera, appearance, 1.0 / fine, turned) / fine**2
    return image.reshape(grid.shape[:2])


def _see(
    pills: Pills,
    camera: Camera,
    appearance: Appearance,
    place: Float[np.ndarray, "n 6"],
    h: float,
    turned: _Seen | None,
) -> _Seen:
    """One pill after the other, in every square; `place` holds X, Y and their slopes along x, then along y."""
    pinhole, s = camera.kind == "perspective", lens_blur(appearance)
    boxes = pill_boxes(pills, camera)
    width = np.sqrt(h * h / 12.0 + s * s)
    rows = []
    for k in range(pills.base.shape[0]):
        origin, direction = _ray(place[:, :2], pinhole)
        link = np.full(place.shape[0], k)
        near = clearance(pills, link, origin, direction)
        far = near.depth if pinhole else np.ones(link.size)
        edge, size = _lean(near.normal, far, place)
        if turned is not None:
            edge, size = turned.edge[k], turned.size[k]
        d = near.distance / size
        share = cover_numpy(d, edge, h, s)
        there = (share >= _FAINT) & np.isfinite(boxes[k]).all()
        z = d / width
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            mills = np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) / ndtr(-z)
        mills = np.where((z > -4.0) & there, mills, 0.0)
        moved = place[:, 2:4] * edge[:, :1] + place[:, 4:] * edge[:, 1:]
        origin, direction = _ray(place[:, :2] - (width * mills)[:, None] * moved, pinhole)
        found = ray_hits_numpy(
            Pills(pills.base[k : k + 1], pills.tip[k : k + 1], pills.radius[k : k + 1]), origin, direction
        )
        facing = (found.normal * direction).sum(axis=1)
        inside = found.pill == 0
        normal = np.where(inside[:, None], found.normal, near.normal)
        hit = inside & (facing < -1e-9)
        far = np.where(inside, found.t, near.depth) if pinhole else far
        across, steep = _lean(normal, far, place)
        lean = -across * (steep / np.where(hit, facing, 1.0))[:, None]
        rows.append(
            (
                there,
                share,
                shade_numpy(appearance, normal, link),
                np.where(inside, found.t, near.depth),
                edge,
                size,
                lean,
                hit,
            )
        )
    return _Seen(*(np.stack(column) for column in zip(*rows, strict=True)))


def _ray(xy: Float[np.ndarray, "n 2"], pinhole: bool) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Rays through normalised coordinates."""
    nothing, one = np.zeros((xy.shape[0], 1)), np.ones((xy.shape[0], 1))
    at, along = np.hstack([xy, nothing if not pinhole else one]), np.hstack([0.0 * xy, one])
    return (np.zeros_like(at), at) if pinhole else (at, along)


def _lean(
    normal: Float[np.ndarray, "n 3"], far: Float[np.ndarray, " n"], place: Float[np.ndarray, "n 6"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Direction in the image, and size, of the slope of a surface's distance by pixel."""
    slope = np.stack([(normal[:, :2] * place[:, i : i + 2]).sum(axis=1) for i in (2, 4)], axis=1) * far[:, None]
    size = np.linalg.norm(slope, axis=1)
    slope, size = np.where(size[:, None] < 1e-12, [1e-12, 0.0], slope), np.maximum(size, 1e-12)
    return slope / size[:, None], size


def _composite(
    seen: _Seen,
    place: Float[np.ndarray, "n 6"],
    camera: Camera,
    appearance: Appearance,
    h: float,
    turned: _Seen | None,
) -> Float[np.ndarray, " n"]:
    """Grey level of every square, front to back."""
    order = np.argsort(np.where(seen.there, seen.depth, np.inf), axis=0, kind="stable")
    each = np.arange(place.shape[0])
    unit = np.sqrt(np.abs(place[:, 2] * place[:, 5] - place[:, 3] * place[:, 4]))
    if camera.kind == "perspective":
        unit = unit * np.abs(seen.depth[order[0], each])
    m, level, edge = np.zeros(each.size), np.zeros(each.size), np.zeros((each.size, 2))
    for i in range(order.shape[0]):
        k, there = order[i], seen.there[order[i], each]
        a, own = np.where(there, seen.share[k, each], 0.0), seen.edge[k, each]
        w = overlap_numpy(m, a, (edge * own).sum(axis=1))
        edge = np.where((there & (a < 1.0) & (w > 0.0))[:, None], own, edge)
        shown = seen.level[k, each]
        if i + 1 < order.shape[0]:
            j = order[i + 1]
            lean = (seen if turned is None else turned).lean
            share = _crease(seen, lean[j, each] - lean[k, each], k, j, unit, h, lens_blur(appearance))
            share = np.where(there & seen.there[j, each], share, 1.0)
            shown = shown + (1.0 - share) * seen.share[j, each] * (seen.level[j, each] - shown)
        level, m = level + w * np.where(there, shown, 0.0), m + w
    return level + (1.0 - m) * appearance.background


def _crease(seen: _Seen, lean: Float[np.ndarray, "n 2"], k, j, unit, h: float, s: float) -> Float[np.ndarray, " n"]:
    """Share of each square in which pill k lies before pill j."""
    each = np.arange(unit.size)
    apart, size = seen.depth[j, each] - seen.depth[k, each], np.linalg.norm(lean, axis=1)
    same = size < 1e-5 * unit
    safe = np.where(same, 1.0, size)
    share = cover_numpy(-apart / safe, lean / safe[:, None], h, s)
    share = np.where(same, np.where(apart < 1e-5 * unit, 0.5, 1.0), share)
    return np.where(seen.hit[k, each] & seen.hit[j, each], share, 1.0)


def overlap_numpy(
    m: Float[np.ndarray, " n"], a: Float[np.ndarray, " n"], cosine: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Share that shows of what covers `a` behind what covers `m`, by the angle between the two edges.

    >>> overlap_numpy(np.full(3, 0.25), np.full(3, 0.5), np.array([-1.0, 0.0, 1.0])).tolist()
    [0.5, 0.375, 0.25]
    """
    apart = (m <= 0.0) | (cosine < -0.8)
    return np.where(apart, np.minimum(a, 1.0 - m), np.where(cosine > 0.8, np.maximum(a - m, 0.0), (1.0 - m) * a))


def cover_numpy(
    d: Float[np.ndarray, " n"], edge: Float[np.ndarray, "n 2"], h: float, s: float
) -> Float[np.ndarray, " n"]:
    """Share of a square of side h inside a straight edge at signed distance d, seen through a lens of blur s.

    Parameters
    ----------
    d : (n,)
        Distance of the square's middle, positive outside.
    edge : (n, 2)
        Unit normal of the edge.

    >>> half, upright = np.array([0.0, 0.25]), np.tile([1.0, 0.0], (2, 1))
    >>> cover_numpy(half, upright, 1.0, 0.0).round(6).tolist()
    [0.5, 0.25]
    """
    size, d = np.abs(edge), np.clip(d, -50.0 * (h + s), 50.0 * (h + s))
    p, q = h * size.max(axis=1), h * np.maximum(size.min(axis=1), _LEAST)

    def ramp(x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        if s == 0.0:
            return 0.5 * np.maximum(x, 0.0) ** 2
        z = x / s
        density = np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
        return 0.5 * ((x * x + s * s) * ndtr(z) + x * s * density)

    total = ramp(0.5 * (p + q) - d) - ramp(0.5 * (p - q) - d) - ramp(0.5 * (q - p) - d) + ramp(-0.5 * (p + q) - d)
    share = np.clip(total / (p * q), 0.0, 1.0)
    return np.where(np.abs(d) > np.sqrt(0.5) * h + 6.0 * s, (d < 0.0).astype(float), share)
