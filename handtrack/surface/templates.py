"""Contour samplers and a posed mesh in, what each profile should look like and which samples may be compared out.

The same as `handtrack.templates` with the mesh for the pills: grey levels from the learnt appearance and the blended
normals of the triangle met at every sample, a window inwards over the surface that goes on without a step in depth,
outwards over background or another surface up to the first change, and a state.
"""

import numpy as np
from jaxtyping import Float

from .._kernels import raster as kernels
from ..appearance import SHARP, Appearance, shade_numpy
from ..camera import Camera, pixels_per_unit
from ..profiles import Samplers
from ..templates import EXPECTED, HIDDEN, JOINT, MARGIN, Templates, blurred, positions
from .contour import Attached
from .raster import Projected, Tiles, probe_numpy, smooth_normals
from .skin import Skin, Surface

_JUMP = 0.25  # of the link's radius: a step in depth between two surfaces
_REACH = 1.0  # of the radius: depth within which the surface just inside belongs to the contour


def contact_table(surface: Surface, samplers: Samplers, at: Attached, camera: Camera) -> Float[np.ndarray, "n 4"]:
    """Depth, finger, step in depth that separates surfaces, and depth that still is the same surface."""
    radius = surface.model.link_radius[samplers.link].mean(axis=1)
    pixel = 1.0 / pixels_per_unit(camera, samplers.contact)
    jump = np.maximum(_JUMP * radius, 2.0 * pixel)
    finger = surface.finger[at.region].astype(float)
    return np.stack([samplers.contact[:, 2], finger, jump, np.maximum(_REACH * radius, 2.0 * jump)], axis=1)


def _blur_kernel(step: float, blur: float) -> Float[np.ndarray, " b"]:
    """What `blurred` does to a single sample."""
    reach = int(np.ceil(3.0 * blur / step))
    return blurred(np.eye(1, 2 * reach + 1, reach), step, blur)[0]


def expect_contours(
    surface: Surface,
    skin: Skin,
    mesh: Projected,
    tiles: Tiles,
    samplers: Samplers,
    at: Attached,
    camera: Camera,
    appearance: Appearance,
    inwards: float = 10.0,
    outwards: float = 5.0,
    step: float = 0.5,
) -> Templates:
    """Rendered templates, windows and states of contour samplers.

    Parameters
    ----------
    appearance : Appearance
        With a gain for each region of the surface: one more than the links of the model.
    inwards, outwards, step : float
        Length of the window on either side of the edge, and distance of its samples, pixels.
    """
    u = positions(inwards, outwards, step)
    shape = (samplers.link.size, u.size)
    values, visible = np.empty(shape), np.empty(shape, dtype=np.bool_)
    parts, state = np.empty((shape[0], 2, shape[1])), np.empty(shape[0], dtype=np.int64)
    kernels.expect_contours(
        samplers.origin,
        samplers.direction,
        contact_table(surface, samplers, at, camera),
        u,
        (
            mesh.xy,
            mesh.inverse,
            mesh.pinhole,
            mesh.triangles,
            tiles.packed(),
            skin.normal,
            surface.region,
            surface.finger,
            mesh.area,
        ),
        (appearance.shading, appearance.gain, appearance.background),
        _blur_kernel(step, appearance.blur),
        round((MARGIN + appearance.blur - SHARP) / step),
        values,
        parts,
        visible,
        state,
    )
    return Templates(u, values, parts, visible, state)


def expect_numpy(
    surface: Surface,
    skin: Skin,
    mesh: Projected,
    samplers: Samplers,
    at: Attached,
    camera: Camera,
    appearance: Appearance,
    inwards: float = 10.0,
    outwards: float = 5.0,
    step: float = 0.5,
) -> Templates:
    """The same as `expect_contours` in plain NumPy: the twin of the compiled kernel."""
    u = positions(inwards, outwards, step)
    n, m, mid = samplers.link.size, u.size, int(np.searchsorted(u, 0.0))
    inner, outer = mid - 2, mid + 1
    points = (samplers.origin[:, None, :] + u[None, :, None] * samplers.direction[:, None, :]).reshape(-1, 2)
    seen = probe_numpy(mesh, points)
    normal = smooth_normals(skin, mesh, seen)
    hit, depth = (seen.triangle >= 0).reshape(n, m), seen.depth.reshape(n, m)
    region = np.where(seen.triangle >= 0, surface.region[seen.triangle], -1).reshape(n, m)
    raw = shade_numpy(appearance, normal, region.reshape(-1)).reshape(n, m)
    face = np.maximum(-normal[:, 2], 0.0).reshape(n, m)
    own_depth, own, jump, reach = contact_table(surface, samplers, at, camera).T
    finger = np.where(region >= 0, surface.finger[region], -1)
    stranger = (finger >= 0) & (own[:, None] >= 0) & (finger != own[:, None])
    back = np.where(seen.triangle >= 0, mesh.area[seen.triangle] > 0.0, False).reshape(n, m)
    with np.errstate(invalid="ignore"):
        state = np.full(n, EXPECTED)
        near = hit[:, outer] & (depth[:, outer] < depth[:, inner] + jump)
        covered = near & stranger[:, outer] & (depth[:, outer] < depth[:, inner])
        state[near] = np.where(covered[near], HIDDEN, JOINT)
        state[stranger[:, inner] | back[:, inner] | (depth[:, inner] > own_depth + reach)] = JOINT
        front = depth[:, inner] < own_depth - np.where(stranger[:, inner], jump, reach)
        state[front] = np.where(stranger[front, inner], HIDDEN, JOINT)
        state[~hit[:, inner]] = JOINT
        steady = hit[:, :-1] & hit[:, 1:] & (np.abs(np.diff(depth, axis=1)) < jump[:, None])
    visible, cover = np.zeros((n, m), dtype=bool), np.zeros((n, m), dtype=bool)
    margin = round((MARGIN + appearance.blur - SHARP) / step)
    for i in np.flatnonzero(state == EXPECTED):
        low = top = mid - 1 if hit[i, mid - 1] else inner
        while low > 0 and steady[i, low - 1]:
            low -= 1
        cover[i, low : top + 1] = True
        visible[i, low : mid + 1] = True
        if low > 0:
            visible[i, low : min(low + margin, mid - 2)] = False
        high = mid
        while high < m - 1 and hit[i, high + 1] == hit[i, outer]:
            if high >= outer and hit[i, high + 1] and not steady[i, high]:
                break
            high += 1
        visible[i, mid + 1 : high + 1] = True
        if high < m - 1:
            visible[i, max(high - margin, mid + 1) + 1 : high + 1] = False
    told = (state == EXPECTED)[:, None]
    blur = appearance.blur
    parts = np.stack([blurred(1.0 * cover, step, blur), blurred(cover * face, step, blur)], axis=1)
    return Templates(u, blurred(raw, step, blur) * told, parts * told[:, None], visible, state)
