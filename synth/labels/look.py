"""One shot in, its image with all labels out."""

import numpy as np
from jaxtyping import Float, Int

from .. import _kernels
from ..dataset.shot import Shot, joints_of, keypoints_at, solids_at
from . import keypoints as points
from .geometry import Geometry, Span, boxes_of, frames_of, geometry, hull, instants
from .image import MOMENTS, blurred, coloured, noise_key, normals_of, sensed
from .labelled import Labelled
from .seen import Seen, see


def labelled(shot: Shot) -> Labelled:
    """Image and labels of a shot.

    Labels hold for the instant of this frame, or, with a rolling shutter, of each row's reading; those at a pixel are
    what its centre sees.
    """
    camera, exposure = shot.camera, shot.exposure
    times = instants(exposure.readout)
    now = [solids_at(shot, s) for s in times]
    boxes = boxes_of(now, camera)
    moments = _moments(shot, times) if exposure.blur else []
    moved = [boxes_of(solids, camera) for solids in moments]
    span = hull(np.concatenate([boxes, *moved]), camera)
    here = geometry(now, camera, boxes, span)
    seen = see(here, len(shot.parts.name))
    behind = _crop(shot.background, span)
    if moments:
        pairs = zip(moments, moved, strict=True)
        window = blurred(
            [geometry(solids, camera, box, span, here.grid) for solids, box in pairs], shot.paint, shot.lights, behind
        )
        normal = normals_of(here, seen)
    else:
        window, normal = coloured(here, seen, shot.paint, shot.lights, behind)
    marks = [keypoints_at(shot, s) for s in times]
    p_cam, xy = points.placed(marks, camera)
    visible, hidden_by = points.visibility(p_cam, xy, marks[0].own, camera, here)
    visible_area, amodal_area, modal_box, amodal_box = _areas(here, seen, shot)
    with np.errstate(invalid="ignore"):
        fraction = np.where(amodal_area > 0, visible_area / amodal_area, np.nan)
    names, angles = joints_of(shot)
    size = (camera.height, camera.width)
    return Labelled(
        sensed(shot.background, window, span, exposure, noise_key(shot.seed, shot.index)),
        _full(size, span, np.float32(np.inf), seen.depth.astype(np.float32)),
        _full(size, span, np.float32(0.0), normal),
        _full(size, span, np.int16(-1), seen.part),
        _full(size, span, np.uint64(0), seen.bits),
        _full(size, span, np.float32(0.0), _flow(shot, times, here, seen)),
        xy,
        p_cam,
        visible,
        hidden_by,
        shot.parts,
        visible_area,
        amodal_area,
        fraction,
        modal_box,
        amodal_box,
        names,
        angles,
        camera,
        shot.index,
        shot.sequence,
        shot.frame,
    )


def _moments(shot: Shot, times: Float[np.ndarray, " k"]) -> list:
    """Solids at moments spread evenly over the time for which the shutter is open."""
    shift = ((np.arange(MOMENTS) + 0.5) / MOMENTS - 0.5) * shot.exposure.blur
    return [[solids_at(shot, s) for s in times + by] for by in shift]


def _flow(shot: Shot, times: Float[np.ndarray, " k"], here: Geometry, seen: Seen) -> Float[np.ndarray, "h w 2"]:
    """Pixels from here to where each point is one frame later."""
    after = [solids_at(shot, s + 1.0) for s in times]
    frames, vertices = frames_of(after, here.knot, here.blend), np.stack([solids.vertices for solids in after])
    out = np.zeros((*seen.surface.shape, 2), np.float32)
    g, corner = here, (float(here.span[0]), float(here.span[2]))
    _kernels.flow(
        g.grid, g.lens, g.bend, g.straight, corner, g.pinhole, g.tables, g.frames, frames, g.vertices,
        vertices, g.triangles, g.knot, g.blend, seen.depth, seen.surface, out,
    )  # fmt: skip
    return out


def _areas(here: Geometry, seen: Seen, shot: Shot):
    """Visible and amodal area of parts, and modal and amodal boxes of instances."""
    count = len(shot.parts.name)
    visible, amodal = np.zeros(count), np.zeros(count)
    far = max(shot.camera.width, shot.camera.height)
    modal_box = np.tile(np.array([far, 0, far, 0]), (count, 1))
    amodal_box = modal_box.copy()
    _kernels.measure(
        seen.part, seen.bits, here.part_of, seen.first, seen.level, seen.sample_surface, seen.sample_bits,
        visible, amodal, modal_box, amodal_box,
    )  # fmt: skip
    corner = (here.span[0], here.span[2])
    return visible, amodal, _of_instances(modal_box, shot, corner), _of_instances(amodal_box, shot, corner)


def _of_instances(box: Int[np.ndarray, "p 4"], shot: Shot, corner: tuple[int, int]) -> Float[np.ndarray, "n 4"]:
    """Boxes (x0, y0, x1, y1) of instances in the image from those (x0, x1, y0, y1) of their parts in the window."""
    out = np.zeros((len(shot.parts.kind), 4))
    for k in range(out.shape[0]):
        own = box[shot.parts.instance == k]
        low, high = own[:, ::2].min(axis=0), own[:, 1::2].max(axis=0)
        if (high > low).all():
            out[k] = *(low + corner), *(high + corner)
    return out


def _crop(picture: np.ndarray, span: Span) -> np.ndarray:
    x0, x1, y0, y1 = span
    return picture[y0:y1, x0:x1]


def _full(size: tuple[int, int], span: Span, nothing: np.generic, window: np.ndarray) -> np.ndarray:
    """An image of one value with a window put in."""
    shape = (*size, *window.shape[2:])
    out = np.zeros(shape, window.dtype) if nothing == 0 else np.full(shape, nothing, window.dtype)
    x0, x1, y0, y1 = span
    out[y0:y1, x0:x1] = window
    return out
