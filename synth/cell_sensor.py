"""True depth and true keypoints in, what a depth camera and its body tracker report out.

Depth has noise whose deviation grows with the square of the distance (as of a triangulating sensor: Khoshelham and
Elberink 2012), and holes: beside depth edges, where light grazes a surface, in random blobs, and beyond the range. A
keypoint is `tracked` while most of it is seen, `inferred` while some of it is, or shortly after, and `lost` later.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int8
from scipy.signal import lfilter

from handtrack.formats.skeletons import INFERRED, LOST, TRACKED

from .cell_motion import smooth_noise
from .cell_view import Surfaces

MOSTLY, SOMEWHAT = 0.5, 0.12  # visible shares from which a keypoint is tracked, and inferred
SETTLE = 2  # frames that a keypoint is seen before it is tracked again
GRAZING = 0.2  # cosine of incidence below which most light is lost
JUMP, JUMP_SHARE = 0.03, 0.02  # a depth edge: metres, and share of the depth
BLOB = (1.5, 5.0)  # radii of the random holes, pixels
LAG, LONGEST_LAG = 0.35, 0.06  # how an inferred keypoint stays behind: share of the way, metres


def sense_depth(
    rng: np.random.Generator, seen: Surfaces, noise: float, holes: float, nearest: float, farthest: float
) -> Float32[np.ndarray, "h w"]:
    """One depth image, metres, 0 where there is no reading.

    Parameters
    ----------
    noise : float
        Standard deviation at 1 m, metres; it grows with the square of the depth.
    holes : float
        Share of the image under random blobs, 0..1; 0 leaves out all holes but those of the range.
    """
    z = np.where(np.isfinite(seen.depth), seen.depth, 0.0)
    out = z + noise * z * z * rng.standard_normal(z.shape)
    empty = (z < nearest) | (z > farthest)
    if holes > 0.0:
        edge, chance = _far_sides(z), rng.random(z.shape)
        empty |= edge & (chance < 0.7)
        empty |= (seen.facing < GRAZING) & (chance > 0.25)
        empty |= _blobs(rng, z.shape, holes)
    return np.where(empty, 0.0, out).astype(np.float32)


def _far_sides(z: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Pixels beside a neighbour that is much nearer, and one pixel more to the left, in the projector's shadow."""
    out = np.zeros(z.shape, dtype=bool)
    step = JUMP + JUMP_SHARE * z
    across, down = np.diff(z, axis=1), np.diff(z, axis=0)
    out[:, 1:] |= across > step[:, 1:]
    out[:, :-1] |= -across > step[:, :-1]
    out[1:] |= down > step[1:]
    out[:-1] |= -down > step[:-1]
    shadow = np.zeros_like(out)
    shadow[:, :-2] = -(z[:, 2:] - z[:, :-2]) > step[:, :-2]
    return out | shadow


def _blobs(rng: np.random.Generator, shape: tuple[int, ...], share: float) -> Bool[np.ndarray, "h w"]:
    low, high = BLOB
    area = np.pi * (low * low + low * high + high * high) / 3.0
    count = int(rng.poisson(share * shape[0] * shape[1] / area))
    places = rng.uniform((0, 0), (shape[1], shape[0]), (count, 2))
    radii = rng.uniform(low, high, count)
    mask = np.zeros(shape, dtype=np.uint8)
    for (x, y), r in zip(places, radii, strict=True):
        cv2.circle(mask, (int(x * 16), int(y * 16)), int(r * 16), 1, -1, cv2.LINE_8, 4)
    return mask.astype(bool)


def states_of(share: Float[np.ndarray, "f k"], linger: int) -> Int8[np.ndarray, "f k"]:
    """State of every keypoint from its visible share.

    Parameters
    ----------
    linger : int
        Frames that a hidden keypoint is still inferred.

    >>> states_of(np.array([[1.0], [1.0], [0.0], [0.0], [1.0], [1.0]]), 1)[:, 0].tolist()
    [0, 0, 1, 2, 1, 0]
    """
    out = np.empty(share.shape, dtype=np.int8)
    hidden = np.full(share.shape[1], linger + 1)
    shown = np.full(share.shape[1], SETTLE)
    for i in range(share.shape[0]):
        seen = share[i] >= SOMEWHAT
        hidden = np.where(seen, 0, hidden + 1)
        shown = np.where(seen, shown + 1, 0)
        out[i] = np.where(hidden <= linger, INFERRED, LOST)
        out[i][(share[i] >= MOSTLY) & (shown >= SETTLE)] = TRACKED
    return out


def sense_keypoints(
    rng: np.random.Generator,
    p_cam: Float[np.ndarray, "f 16 3"],
    share: Float[np.ndarray, "f 16"],
    state: Int8[np.ndarray, "f 16"],
    noise: float,
    offset: float,
    fps: float,
) -> tuple[Float[np.ndarray, "f 16 3"], Float[np.ndarray, "f 16"]]:
    """Reported keypoints (NaN where lost) and their confidence.

    Half of a tracked keypoint's variance is white, half lasts for a tenth of a second. An inferred one lags behind, has
    a bias of three such deviations that changes within half a second, and twice the noise.

    Parameters
    ----------
    noise : float
        Standard deviation of a tracked keypoint along each axis, metres.
    offset : float
        Metres by which all keypoints are reported too near along the line of sight, as if they lay in the skin.
    """
    f = p_cam.shape[0]
    keep = np.exp(-10.0 / fps)
    white = rng.standard_normal((2, f, 16, 3))
    lasting = lfilter([np.sqrt(1.0 - keep * keep)], [1.0, -keep], white[0], axis=0)
    jitter = noise * np.sqrt(0.5) * (white[1] + lasting)
    p = p_cam + jitter
    number = np.where(state == TRACKED, np.arange(f)[:, None], -1)
    last = np.maximum.accumulate(number, axis=0)
    held = np.take_along_axis(p, np.maximum(last, 0)[..., None], axis=0)
    lag = np.where((last >= 0)[..., None], LAG * (held - p_cam), 0.0)
    size = np.linalg.norm(lag, axis=-1, keepdims=True)
    lag = lag * (LONGEST_LAG / np.maximum(size, LONGEST_LAG))
    bias = 3.0 * noise * smooth_noise(rng, f, 0.5 * fps, 48).reshape(f, 16, 3)
    p = np.where((state == INFERRED)[..., None], p_cam + lag + bias + 2.0 * jitter, p)
    p = p - offset * p_cam / np.linalg.norm(p_cam, axis=-1, keepdims=True)
    confidence = np.where(state == TRACKED, 0.7 + 0.3 * share, 0.2 + 0.3 * share) + 0.03 * rng.standard_normal((f, 16))
    confidence = np.where(state == LOST, 0.0, np.clip(confidence, 0.05, 1.0))
    return np.where((state == LOST)[..., None], np.nan, p), confidence
