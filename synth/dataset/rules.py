"""Labels of one image in, the rules that they break out: what has to hold between labels, whatever the scene.

Modal masks are a partition of the foreground, as they are numbers of one image; so the rules compare that image with
the other ones, and everything else with it.
"""

import numpy as np

from ..labels.labelled import HIDDEN, SEEN, UNSEEN
from .decode import Decoded

SLACK = 2e-6  # files round to six digits


def broken_rules(image: Decoded) -> tuple[str, ...]:
    """One line for each rule that the labels of an image break; none as a rule."""
    return (*_foreground(image), *_areas(image), *_keypoints(image), *_boxes(image))


def _foreground(image: Decoded) -> list[str]:
    """The image of parts against depth, normals and amodal masks."""
    part, out = image.part, []
    if part is None:
        return []
    count = len(image.parts.name)
    if part.min() < -1 or part.max() >= count:
        return [f"part {part.max()} of {count} parts"]
    seen = part >= 0
    if image.depth is not None and (np.isfinite(image.depth) != seen).any():
        out.append("the foreground of depth is not that of parts")
    if image.normal is not None and (image.normal.any(axis=-1) != seen).any():
        out.append("the foreground of normals is not that of parts")
    if image.flow is not None and image.flow[~seen].any():
        out.append("the background flows")
    if image.amodal is not None:
        if ((image.amodal != 0) != seen).any():
            out.append("the union of amodal masks is not the foreground")
        own = np.uint64(1) << np.maximum(part, 0).astype(np.uint64)
        if (seen & (image.amodal & own == 0)).any():
            out.append("a modal mask is not inside its amodal mask")
    return out


def _areas(image: Decoded) -> list[str]:
    """Visible and amodal areas, and their ratio."""
    seen, whole, share = image.visible_area, image.amodal_area, image.fraction
    out = []
    if (seen < 0).any() or (seen > whole + SLACK).any() or (whole > image.image[..., 0].size + SLACK).any():
        out.append("areas do not rise from 0 over visible and amodal to the image's")
    known = whole > SLACK
    if np.isfinite(share[whole == 0]).any() or not np.isfinite(share[known]).all():
        out.append("a visible fraction is given where a part is outside, or is not where it is inside")
    # the ratio of two rounded areas: what rounding can do to it grows as the area shrinks
    off = np.abs(share[known] * whole[known] - seen[known])
    if (off > SLACK * (1.0 + whole[known])).any():
        out.append("a visible fraction is not visible over amodal area")
    if image.part is not None and (seen[np.unique(image.part[image.part >= 0])] <= 0).any():
        out.append("a part is seen but has no visible area")
    return out


def _keypoints(image: Decoded) -> list[str]:
    """Visibility against places, against what hides, and against visible fractions."""
    visible, by, xy = image.visibility, image.hidden_by, image.keypoint
    height, width = image.image.shape[:2]
    out = []
    if not np.isin(visible, (UNSEEN, HIDDEN, SEEN)).all():
        return ["a keypoint's visibility is none of 0, 1, 2"]
    if ((by >= 0) != (visible == HIDDEN)).any() or by.max(initial=-1) >= len(image.parts.name):
        return ["a keypoint is hidden by nothing, or not hidden by something"]
    with np.errstate(invalid="ignore"):
        slack = np.where(visible > UNSEEN, SLACK, -SLACK)
        low, high = -0.5 - slack, np.array([width, height]) - 0.5 + slack[..., None]
        inside = ((xy >= low[..., None]) & (xy <= high)).all(axis=-1)
    if (inside != (visible > UNSEEN)).any():
        out.append("a keypoint's visibility and its place disagree about the image's edge")
    for hand in range(visible.shape[0]):
        area = image.visible_area[image.parts.instance == hand].sum()
        if (visible[hand] == SEEN).any() and area <= 0:
            out += [f"keypoints of hand {hand} are seen, but no part of it is"]
    hiding = np.unique(by[by >= 0])
    if (image.amodal_area[hiding] <= 0).any():
        out.append("a keypoint is hidden by a part that is not in the image")
    return out


def _boxes(image: Decoded) -> list[str]:
    """Modal boxes inside amodal ones, those inside the image, and pixels inside boxes."""
    height, width = image.image.shape[:2]
    modal, amodal = image.modal_box, image.amodal_box
    out = []
    full = (modal[:, 2:] > modal[:, :2]).all(axis=1)
    if (modal[~full] != 0).any():
        out.append("a box is empty, but not at 0")
    if (modal[full, :2] < amodal[full, :2]).any() or (modal[full, 2:] > amodal[full, 2:]).any():
        out.append("a modal box is not inside its amodal box")
    if (amodal[:, :2] < 0).any() or (amodal[:, 2:] > (width, height)).any():
        out.append("an amodal box is not inside the image")
    if image.part is not None and len(image.parts.name):
        instance = np.where(image.part >= 0, image.parts.instance[image.part], -1)
        for k in np.unique(instance[instance >= 0]).tolist():
            y, x = (np.flatnonzero((instance == k).any(axis=axis)) for axis in (1, 0))
            held = modal[k, :2] <= (x[0], y[0]), modal[k, 2:] >= (x[-1] + 1, y[-1] + 1)
            if not np.all(held):
                out.append(f"pixels of instance {k} lie outside its modal box")
    return out
