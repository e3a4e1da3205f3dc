"""One shot in, its image with all labels out."""

import numpy as np
from jaxtyping import Float, Int

from .. import _kernels
from . import keypoints as points
from .geometry import Geometry, Span, boxes_of, frames_of, geometry, hull, instants
from .image import MOMENTS, blurred, coloured, noise_key, normals_of, sensed
from .labelled import Labelled
from .seen import Seen, see
from .shot import Shot, joints_of, keypoints_at, solids_at


class Canvas:
    """The images of a `Labelled`, to be used again for the next one of the same size.

    Fresh memory has to be handed over by the operating system page by page, which takes longer than drawing a hand.
    """

    def __init__(self, width: int, height: int) -> None:
        shape = (height, width)
        self.image = np.zeros((*shape, 3), np.uint8)
        self.depth = np.full(shape, np.inf, np.float32)
        self.normal = np.zeros((*shape, 3), np.float32)
        self.part = np.full(shape, -1, np.int16)
        self.amodal = np.zeros(shape, np.uint64)
        self.flow = np.zeros((*shape, 2), np.float32)
        self.span: Span = (0, 0, 0, 0)

    def clear(self) -> None:
        """Take the window of the last image back to background."""
        x0, x1, y0, y1 = self.span
        images = (self.depth, self.normal, self.part, self.amodal, self.flow)
        for values, nothing in zip(images, (np.inf, 0.0, -1, 0, 0.0), strict=True):
            values[y0:y1, x0:x1] = nothing
        self.span = (0, 0, 0, 0)


def labelled(shot: Shot, canvas: Canvas | None = None) -> Labelled:
    """Image and labels of a shot.

    Labels hold for the instant of this frame, or, with a rolling shutter, of each row's reading; those at a pixel are
    what its centre sees.

    Parameters
    ----------
    canvas : Canvas, optional
        Of the camera's size, to draw into: the result is valid until it is used again.
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
    c = canvas or Canvas(camera.width, camera.height)
    c.clear()
    c.span, (x0, x1, y0, y1) = span, span
    sensed(shot.background, window, span, exposure, noise_key(shot.seed, shot.index), c.image)
    c.depth[y0:y1, x0:x1], c.normal[y0:y1, x0:x1] = seen.depth, normal
    c.part[y0:y1, x0:x1], c.amodal[y0:y1, x0:x1] = seen.part, seen.bits
    _flow(shot, times, here, seen, c.flow[y0:y1, x0:x1])
    return Labelled(
        c.image,
        c.depth,
        c.normal,
        c.part,
        c.amodal,
        c.flow,
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


def _flow(
    shot: Shot, times: Float[np.ndarray, " k"], here: Geometry, seen: Seen, out: Float[np.ndarray, "h w 2"]
) -> None:
    """Pixels from here to where each point is one frame later."""
    after = [solids_at(shot, s + 1.0) for s in times]
    frames, vertices = frames_of(after, here.knot, here.blend), np.stack([solids.vertices for solids in after])
    g, corner = here, (float(here.span[0]), float(here.span[2]))
    _kernels.flow(
        g.grid, g.lens, g.bend, g.straight, corner, g.pinhole, g.tables, g.frames, frames, g.vertices,
        vertices, g.triangles, g.knot, g.blend, seen.depth, seen.surface, out,
    )  # fmt: skip


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
