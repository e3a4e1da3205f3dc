"""An image and a surface posed in it in, how the surface shines and how blurred it looks out."""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float

from ..appearance import learn_from_samples, pixel_noise
from ..camera import Camera
from ..sharpness import BLURS
from .image import EDGE, INSIDE, RIM, Box, box_of, expected_image, fragments, lens_blur
from .raster import smooth_normals
from .shading import FAIR, Readings, SurfaceAppearance, expected_levels, learn_shading, plain_appearance
from .skin import Surface
from .view import View, moving_box, moving_triangles, view_of

_BEYOND = 24.0  # pixels around the hand that are taken for background
_MOST = 3000  # readings of the smooth shading
_LEAST_OUTLINE = 100  # pixels
_BETTER = 0.9  # a new blur must leave this much less
_BLACK, _WHITE = 1.5, 253.5  # grey levels that a sensor may have cut


def learn_surface(
    image: Float[np.ndarray, "h w"],
    surface: Surface,
    camera: Camera,
    u: Float[np.ndarray, " k"],
    previous: SurfaceAppearance | None = None,
) -> SurfaceAppearance:
    """Fit the appearance to one image with the surface posed in it, and blend it with what is known.

    The smooth shading is learnt away from edges, as for pills; the table and the albedo up to the pixels that an edge
    crosses. A palm that no joint moves is left out: it may be dressed or dark, and no edge is searched there.
    """
    view = view_of(surface, camera, u)
    low, high = moving_box(surface, camera, view, _BEYOND)
    box = box_of(surface, camera, view, low, high)
    height, width = box.triangle.shape
    part = np.ascontiguousarray(image[box.y0 : box.y0 + height, box.x0 : box.x0 + width], dtype=float)
    moving = (box.triangle >= 0) & moving_triangles(surface)[box.triangle]
    inside, every = _chosen(box, moving)
    behind = part[cv2.dilate((box.kind > 0).astype(np.uint8), np.ones((7, 7), np.uint8)) == 0]
    centre, every = _readings(surface, view, box, part, inside), _readings(surface, view, box, part, every)
    row, column = np.nonzero(inside)
    noise = pixel_noise(part, np.column_stack([column, row]).astype(float), np.ones(row.size, dtype=bool))
    regions, before = surface.finger.size, previous.plain if previous else None
    colour = centre.colour(previous.albedo if previous else np.ones(surface.weight.shape[0]))
    fair = colour > FAIR
    plain = learn_from_samples(
        centre.normal[fair], centre.region[fair], centre.level[fair], behind, noise, regions, before
    )
    plain = replace(plain, gain=np.ones(regions))  # the albedo says it all, and better
    known = previous or plain_appearance(plain, surface.weight.shape[0])
    return learn_shading(plain, known, _at_centres(surface, camera, view, box, replace(known, plain=plain), every))


def _chosen(box: Box, moving: Bool[np.ndarray, "h w"]) -> tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Pixels for the smooth shading, and those for table and albedo: every second inside, every one at the rim."""
    inside = moving & (box.kind == INSIDE)
    stride = max(int(np.sqrt(inside.sum() / _MOST)), 1)
    grid, second = np.zeros(inside.shape, dtype=bool), np.zeros(inside.shape, dtype=bool)
    grid[::stride, ::stride], second[::2, ::2] = True, True
    return inside & grid, (inside & second) | (moving & (box.kind == RIM))


def _readings(
    surface: Surface, view: View, box: Box, part: Float[np.ndarray, "h w"], chosen: Bool[np.ndarray, "h w"]
) -> Readings:
    row, column = np.nonzero(chosen & (part > _BLACK) & (part < _WHITE))
    seen = fragments(view, box, row, column)
    normal = smooth_normals(view.skin, view.mesh, seen)
    vertex = surface.triangles[seen.triangle]
    return Readings(normal, surface.region[seen.triangle], part[row, column], vertex, seen.bary, row, column)


def _at_centres(
    surface: Surface, camera: Camera, view: View, box: Box, known: SurfaceAppearance, of: Readings
) -> Readings:
    """Levels of pixels turned into those of their centres: less what area and lens should have made of them."""
    rim, lens = box.kind == RIM, lens_blur(known)
    if lens > 0.0:
        size = 2 * int(np.ceil(3.0 * lens)) + 1
        rim = (box.kind > 0) & (cv2.dilate((box.kind == EDGE).astype(np.uint8), np.ones((size, size), np.uint8)) > 0)
    whole = expected_image(surface, camera, view, known, box, rim)
    made = whole[of.row + box.y0, of.column + box.x0] - expected_levels(known, of)
    return replace(of, level=of.level - np.where(rim[of.row, of.column], made, 0.0))


def learn_lens(
    image: Float[np.ndarray, "h w"],
    surface: Surface,
    camera: Camera,
    u: Float[np.ndarray, " k"],
    appearance: SurfaceAppearance,
) -> SurfaceAppearance:
    """The appearance with the blur, out of `sharpness.BLURS`, that explains the pixels about the outline best."""
    view = view_of(surface, camera, u)
    low, high = moving_box(surface, camera, view, 8.0)
    box = box_of(surface, camera, view, low, high)
    moving = (box.triangle >= 0) & moving_triangles(surface)[box.triangle]
    outline = cv2.dilate(((box.kind == EDGE) & moving).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    if outline.sum() < _LEAST_OUTLINE:
        return appearance
    row, column = np.nonzero(outline)
    level = image[row + box.y0, column + box.x0]
    tried = [replace(appearance, plain=replace(appearance.plain, blur=float(blur))) for blur in BLURS]
    wanted = box.kind > 0
    left = []
    for each in tried:
        should = expected_image(surface, camera, view, each, box, wanted)[row + box.y0, column + box.x0]
        left.append(float(np.median(np.abs(level - should))))
    now, best = int(np.argmin(np.abs(BLURS - appearance.blur))), int(np.argmin(left))
    return tried[best] if left[best] < _BETTER * left[now] else appearance
