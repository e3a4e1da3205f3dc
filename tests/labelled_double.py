"""Labelled images made without the renderer: pills parallel to an image plane, seen by a parallel camera.

Everything follows from distances to segments in the plane, so that labels agree with each other and with the solids.
"""

from typing import get_args

import numpy as np

from handtrack.camera import orthographic
from synth.labels.labelled import HIDDEN, SEEN, UNSEEN, Labelled
from synth.labels.solids import HAND_PARTS, KEYPOINTS, Kind, Parts

JOINTS = ("wrist_x", *(name for name in KEYPOINTS if name.endswith(("mcp", "pip"))))


def labelled_double(
    seed=0, width=96, height=72, hands=1, occluders=2, index=None, sequence=0, frame=0, scale=0.5
) -> Labelled:
    """An image with hands of 20 pills each and occluders of one, all placed at random."""
    rng = np.random.default_rng(seed)
    kind = get_args(Kind)[:hands] + get_args(Kind)[2 : 2 + occluders]
    names = HAND_PARTS * hands + kind[hands:]
    instance = np.concatenate([np.repeat(np.arange(hands), len(HAND_PARTS)), np.arange(hands, hands + occluders)])
    a, b, radius = _segments(rng, hands, occluders, width / scale, height / scale)
    depth_each, normal_each = _surfaces(a, b, radius, width, height, scale)
    if not names:  # what the smallest depth of no part is
        depth_each, normal_each = np.full((1, height, width), np.inf), np.zeros((1, height, width, 3))
    nearest = np.argmin(depth_each, axis=0)
    depth = np.take_along_axis(depth_each, nearest[None], axis=0)[0]
    number = np.where(np.isfinite(depth), nearest, -1).astype(np.int16)
    seen = np.isfinite(depth_each)[: len(names)]
    bits = (seen * (np.uint64(1) << np.arange(len(names), dtype=np.uint64))[:, None, None]).sum(0, dtype=np.uint64)
    normal = np.take_along_axis(normal_each, nearest[None, ..., None], axis=0)[0]
    normal[number < 0] = 0.0
    camera = orthographic(width, height, scale, 0.0, 0.0, np.eye(3), np.zeros(3))
    marks = _keypoints(rng, a, b, radius, hands, number, depth, camera)
    modal = np.array([(number == k).sum() for k in range(len(names))], float)
    amodal = seen.sum(axis=(1, 2)).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        fraction = np.where(amodal > 0, modal / amodal, np.nan)
    parts = Parts(names, instance, kind)
    moved = np.where(number[..., None] >= 0, rng.normal(0.0, 3.0, (len(names) + 1, 2))[number], 0.0)
    image = rng.integers(60, 90, (height, width, 3)) + (number[..., None] >= 0) * (100, 70, 50)
    return Labelled(
        image.astype(np.uint8), depth.astype(np.float32), normal.astype(np.float32), number, bits,
        moved.astype(np.float32), *marks, parts, modal, amodal, fraction,
        _boxes(number == np.arange(len(names))[:, None, None], parts), _boxes(seen, parts),
        tuple(JOINTS for _ in range(hands)), tuple(rng.uniform(-0.5, 1.5, len(JOINTS)) for _ in range(hands)),
        camera, seed if index is None else index, sequence, frame,
    )  # fmt: skip


def _segments(rng, hands, occluders, width, height):
    """Ends and radii of pills: a wrist, fingers that fan out from it, then things in front."""
    a, b, radius = [], [], []
    for _ in range(hands):
        wrist = np.array([rng.uniform(0.3, 0.7) * width, rng.uniform(0.7, 0.95) * height, rng.uniform(450, 550)])
        turn = rng.uniform(-0.6, 0.6)
        unit = 0.16 * min(width, height)
        a.append(wrist), b.append(wrist + np.array([0.0, 1.2 * unit, 0.0])), radius.append(0.5 * unit)
        for finger, links in enumerate((3, 4, 4, 4, 4)):
            angle, at = turn - np.pi / 2 + 0.28 * (finger - 2), wrist
            for link in range(links):
                angle += rng.normal(0.0, 0.15)
                end = at + unit * (1.5 if link == 0 else 0.9) * np.array([np.cos(angle), np.sin(angle), 0.0])
                a.append(at), b.append(end), radius.append((0.32 - 0.05 * link) * unit)
                at = end
    for _ in range(occluders):
        at = np.array([rng.uniform(0.2, 0.8) * width, rng.uniform(0.2, 0.8) * height, rng.uniform(300, 380)])
        a.append(at), b.append(at + np.array([*rng.normal(0.0, 0.1 * width, 2), 0.0])), radius.append(0.06 * width)
    return np.array(a).reshape(-1, 3), np.array(b).reshape(-1, 3), np.array(radius)


def _surfaces(a, b, radius, width, height, scale):
    """Depth (inf) and normal of every pill at every pixel."""
    y, x = np.mgrid[:height, :width] / scale
    p = np.stack([x, y], axis=-1)
    along = b[:, :2] - a[:, :2]
    share = (
        np.einsum("hwnk,nk->nhw", p[:, :, None] - a[:, :2], along) / np.maximum((along**2).sum(1), 1e-9)[:, None, None]
    )
    nearest = a[:, None, None, :2] + np.clip(share, 0.0, 1.0)[..., None] * along[:, None, None]
    apart = p - nearest
    left = radius[:, None, None] ** 2 - (apart**2).sum(-1)
    inside = left >= 0
    out = np.sqrt(np.where(inside, left, 0.0))
    depth = np.where(inside, a[:, 2, None, None] - out, np.inf)
    normal = np.concatenate([apart, -out[..., None]], axis=-1) / radius[:, None, None, None]
    return depth, normal * inside[..., None]


def _keypoints(rng, a, b, radius, hands, number, depth, camera):
    """Pixels, camera axes, visibility and what hides them, of keypoints that lie at the ends of pills."""
    per = len(HAND_PARTS)
    height, width = number.shape
    points = np.full((hands, 21, 3), np.nan)
    visible, hidden_by = np.full((hands, 21), UNSEEN), np.full((hands, 21), -1)
    for hand in range(hands):
        ends = b[hand * per : (hand + 1) * per]
        points[hand] = np.concatenate([a[hand * per, None], a[hand * per + 1, None], ends[1:4],
                                       *(ends[4 + 4 * f : 8 + 4 * f] for f in range(4))])  # fmt: skip
    xy = points[..., :2] * camera.fx
    column, row = (np.rint(xy[..., k]).astype(int) for k in (0, 1))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    for hand, k in np.argwhere(inside).tolist():
        part = int(number[row[hand, k], column[hand, k]])
        own = part < 0 or part // per == hand
        visible[hand, k], hidden_by[hand, k] = (SEEN, -1) if own else (HIDDEN, part)
    if hands and rng.random() < 0.5:
        xy[-1, -1] = points[-1, -1] = np.nan
        visible[-1, -1], hidden_by[-1, -1] = UNSEEN, -1
    return xy, points, visible, hidden_by


def _boxes(masks, parts):
    out = np.zeros((len(parts.kind), 4))
    for k in range(out.shape[0]):
        rows, columns = np.nonzero(masks[parts.instance == k].any(axis=0))
        if rows.size:
            out[k] = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
    return out
