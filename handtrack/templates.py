"""Samplers and posed pills in, what each profile should look like and which of its samples may be compared out.

A template is rendered at the present pose: a ray through every sample, shaded by the learnt appearance, blurred like
a pixel and a linear interpolation blur an edge. The same rays tell the window: samples of the own finger inwards,
samples of one and the same surface (or the background) outwards, each up to the first change and less a margin for
the error of the pose. So the order of the links is found for every sample, also where a mean depth orders them
wrongly (hand thesis, Figure 4.16).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from . import _kernels
from .appearance import SHARP, Appearance, shade_numpy
from .camera import Camera, pixels_per_unit
from .pills import Pills, ray_hits_numpy
from .profiles import Samplers

EXPECTED, HIDDEN, JOINT = 0, 1, 2
MARGIN = 1.5  # pixels kept free where another surface begins


@dataclass(frozen=True, slots=True, eq=False)
class Templates:
    """Expected profiles at positions u.

    Attributes
    ----------
    values, visible : (n, m)
        Grey levels, and the window function.
    parts : (n, 2, m)
        Share of the own finger in each sample, and that share times the cosine between its normal and the line of
        sight.
    state : (n,)
        EXPECTED, HIDDEN (another finger is in front) or JOINT (the surface goes on: no depth step, no edge).
    """

    u: Float[np.ndarray, " m"]
    values: Float[np.ndarray, "n m"]
    parts: Float[np.ndarray, "n 2 m"]
    visible: Bool[np.ndarray, "n m"]
    state: Int[np.ndarray, " n"]


def positions(inwards: float, outwards: float, step: float) -> Float[np.ndarray, " m"]:
    """Positions along a sampler; the edge at 0 falls between two of them.

    >>> positions(1.0, 0.5, 0.5).tolist()
    [-0.75, -0.25, 0.25]
    """
    return (np.arange(-round(inwards / step), round(outwards / step)) + 0.5) * step


def depth_step_numpy(samplers: Samplers, pills: Pills, camera: Camera) -> Float[np.ndarray, " n"]:
    """Depth that must lie between two surfaces of one finger for an edge to be seen: a quarter of the link's radius.

    In plain NumPy: the twin of the compiled `depth_steps`.
    """
    step = 0.25 * pills.radius[samplers.link].mean(axis=1)
    # Rays advance by depth; on the tangent the surface falls away, so allow at least what two pixels see of it.
    return np.maximum(step, 2.0 / pixels_per_unit(camera, samplers.contact))


@lru_cache(maxsize=64)
def _blur_kernel(step: float, blur: float) -> Float[np.ndarray, " b"]:
    reach = int(np.ceil(3.0 * blur / step))
    x = np.arange(-reach, reach + 1) * step
    weight = np.exp(-0.5 * (x / blur) ** 2)
    return weight / weight.sum()


def expect(
    samplers: Samplers,
    pills: Pills,
    finger: Int[np.ndarray, " l"],
    camera: Camera,
    appearance: Appearance,
    inwards: float = 12.0,
    outwards: float = 6.0,
    step: float = 0.5,
) -> Templates:
    """Rendered templates, windows and states of outline samplers.

    Parameters
    ----------
    finger : (l,)
        Finger of each link; links of one finger do not hide one another unless there is a depth step.
    inwards, outwards, step : float
        Length of the window on either side of the edge, and distance of its samples, pixels.
    """
    u = positions(inwards, outwards, step)
    shape = (samplers.link.size, u.size)
    values, visible = np.empty(shape), np.empty(shape, dtype=np.bool_)
    parts = np.empty((shape[0], 2, shape[1]))
    state, focal = np.empty(samplers.link.size, dtype=np.int64), 0.5 * (camera.fx + camera.fy)
    _kernels.expect_profiles(
        samplers.ray,
        samplers.slope,
        u,
        pills.base,
        pills.tip,
        pills.radius,
        finger,
        samplers.link,
        _kernels.depth_steps(pills.radius, samplers.link, samplers.contact, focal, camera.kind == "orthographic"),
        appearance.shading,
        appearance.gain,
        appearance.background,
        _blur_kernel(step, appearance.blur),
        round((MARGIN + appearance.blur - SHARP) / step),
        values,
        parts,
        visible,
        state,
    )
    return Templates(u, values, parts, visible, state)


def expect_numpy(
    samplers: Samplers,
    pills: Pills,
    finger: Int[np.ndarray, " l"],
    camera: Camera,
    appearance: Appearance,
    inwards: float = 12.0,
    outwards: float = 6.0,
    step: float = 0.5,
) -> Templates:
    """The same as `expect` in plain NumPy: the twin of the compiled kernel."""
    u = positions(inwards, outwards, step)
    n, m, mid = samplers.link.size, u.size, int(np.searchsorted(u, 0.0))
    ray = (samplers.ray[:, None, :] + u[None, :, None] * samplers.slope[:, None, :]).reshape(-1, 6)
    hits = ray_hits_numpy(pills, ray[:, :3], ray[:, 3:])
    raw = shade_numpy(appearance, hits.normal, hits.pill).reshape(n, m)
    depth, group = hits.t.reshape(n, m), np.where(hits.pill >= 0, finger[hits.pill], -1).reshape(n, m)
    jump = depth_step_numpy(samplers, pills, camera)
    own = finger[samplers.link]
    cover = (group == own[:, None]) & (np.arange(m) < mid)
    cosine = -(hits.normal * ray[:, 3:]).sum(axis=1) / np.linalg.norm(ray[:, 3:], axis=1)
    values = blurred(raw, step, appearance.blur)
    parts = np.stack(
        [blurred(1.0 * cover, step, appearance.blur), blurred(cover * cosine.reshape(n, m), step, appearance.blur)],
        axis=1,
    )
    inner, outer = mid - 2, mid + 1
    with np.errstate(invalid="ignore"):
        depth_step = depth[:, outer] - depth[:, inner]
        other = (group[:, outer] >= 0) & (group[:, outer] != own) & (depth_step < 0)
        state = np.where((group[:, inner] != own) | other, HIDDEN, EXPECTED)
        state[(state == EXPECTED) & (group[:, outer] == own) & (depth_step < jump)] = JOINT
        steady = (group[:, :-1] == own[:, None]) & (np.abs(np.diff(depth, axis=1)) < jump[:, None])
    visible = np.zeros((n, m), dtype=bool)
    margin = round((MARGIN + appearance.blur - SHARP) / step)
    inner_run = np.logical_and.accumulate(steady[:, : mid - 1][:, ::-1], axis=1)[:, ::-1]
    visible[:, mid - 1 : mid + 1] = True
    visible[:, : mid - 1] = inner_run
    outer_run = np.logical_and.accumulate(group[:, mid + 1 :] == group[:, outer, None], axis=1)
    visible[:, mid + 1 :] = outer_run
    index = np.arange(m)
    first = mid - 1 - inner_run.sum(axis=1)
    last = mid + outer_run.sum(axis=1)
    cut_low = (first > 0)[:, None] & (index >= first[:, None]) & (index < np.minimum(first + margin, mid - 2)[:, None])
    low = np.maximum(last - margin, mid + 1)
    cut_high = (last < m - 1)[:, None] & (index > low[:, None]) & (index <= last[:, None])
    visible &= ~cut_low & ~cut_high & (state == EXPECTED)[:, None]
    return Templates(u, values, parts, visible, state)


def blurred(rows: Float[np.ndarray, "n m"], step: float, blur: float) -> Float[np.ndarray, "n m"]:
    """Profiles of rays, `step` pixels apart, as pixels, lens and interpolation blur them."""
    kernel = _blur_kernel(step, blur)
    reach = kernel.size // 2
    padded = np.pad(rows, ((0, 0), (reach, reach)), mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, kernel.size, axis=1) @ kernel
