"""A path, a wanted share in view and true keypoints in, a camera in the room and the keypoints it finds out.

The camera stands outside of the arena and looks past the path's middle, so that a part of each lap is out of view; what
is left of the wanted share is taken by spans in which something stands in the way. A keypoint's confidence c, drawn
from 0.4 to 1 and lower for the side of the body that faces away, tells its noise: the larger one of the settings for
c = 0.4, the smaller one for c = 1.
"""

import math

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label
from scipy.signal import lfilter

from handtrack.camera import Camera, perspective, project
from handtrack.formats.skeletons import KEYPOINTS

from .walk_path import lap, place_at
from .walk_settings import WalkSettings

WIDTH, HEIGHT, FOCAL = 1280, 720, 920.0  # pixels: a field of view of 70 degrees
BACK, UP, DOWN = 4.2, 1.6, 9.0  # metres from the path's middle and above the floor; degrees that it looks down
MARGIN = 20.0  # pixels from the border at which a person counts as in view
MORE = 0.08  # share of the laps that is in view beyond what is wanted
LASTING = 0.2  # seconds over which half of a keypoint's noise lasts
LEAST, SUREST = 0.4, 1.0  # confidence
FAR_SIDE = 0.2  # confidence that the side facing away loses
OUTLIER = 80.0  # pixels, standard deviation of a keypoint that was found somewhere else
FEWEST = 8  # keypoints inside the image of a person in view
SPANS = (1.0, 6.0)  # seconds that something stands in the way
TRIES = 500


def camera_at(azimuth: float, aside: float, distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)) -> Camera:
    """A camera `BACK` from the middle of the room at an azimuth, looking `aside` of it; radians."""
    place = np.array([BACK * math.cos(azimuth), BACK * math.sin(azimuth), UP])
    look = azimuth + math.pi + aside
    down = math.radians(DOWN)
    forward = np.array([math.cos(look) * math.cos(down), math.sin(look) * math.cos(down), -math.sin(down)])
    right = np.array([math.sin(look), -math.cos(look), 0.0])
    R = np.stack([right, np.cross(forward, right), forward])
    middle = (0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1))
    return perspective(WIDTH, HEIGHT, FOCAL, FOCAL, *middle, R, -R @ place, np.array(distortion))


def shown(camera: Camera, p_world: Float[np.ndarray, "*n 3"], margin: float = 0.0) -> Bool[np.ndarray, "*n"]:
    """Which points project into the image, `margin` pixels from its border."""
    uv = project(camera, p_world)
    inside = (uv >= margin - 0.5) & (uv <= np.array([camera.width, camera.height]) - 0.5 - margin)
    return np.asarray(inside.all(axis=-1))


def place_camera(rng: np.random.Generator, share: float, settings: WalkSettings) -> Camera:
    """A camera on one of the room's sides that sees about a share of the path, at the height of a pelvis."""
    s = np.linspace(0.0, lap(), 241)[:-1]
    xy, _ = place_at(s)
    points = np.column_stack([xy, np.full(s.size, 0.52 * settings.height)])
    azimuth = 0.5 * math.pi * rng.integers(4) + rng.uniform(-0.3, 0.3)
    way = rng.choice([-1.0, 1.0])
    asides = np.radians(np.arange(0.0, 75.0, 0.5))
    shares = np.array([shown(camera_at(azimuth, way * a), points, MARGIN).mean() for a in asides])
    fits = np.abs(np.maximum.accumulate(shares[::-1])[::-1] - share)
    return camera_at(azimuth, way * float(asides[int(fits.argmin())]), settings.distortion)


def visible_lengths(camera: Camera, height: float) -> Float[np.ndarray, " n"]:
    """Arc lengths of one lap at which the pelvis is well inside the image; all of them if it never is."""
    s = np.linspace(0.0, lap(), 121)[:-1]
    xy, _ = place_at(s)
    seen = shown(camera, np.column_stack([xy, np.full(s.size, 0.52 * height)]), 5.0 * MARGIN)
    return s[seen] if seen.any() else s


def seen_spans(
    rng: np.random.Generator, inside: Bool[np.ndarray, " c"], fps: float, share: float, longest: float
) -> Bool[np.ndarray, " c"]:
    """Frames in which the person is seen: in view, and nothing stands in the way.

    Spans are taken away until the wanted share is left, none of them longer than `longest` seconds; the first reaches
    nearly that. Where the path alone hides more than wanted, nothing is taken away.
    """
    seen = inside.copy()
    most = math.floor(longest * fps)
    for k in range(TRIES):
        spare = int(seen.sum() - round(share * seen.size))
        if spare <= 0:
            break
        if k == 0:  # one gap as long as it may be
            gaps = np.flatnonzero(~seen[: seen.size // 2])
            first = int(gaps[-1]) + 1 if gaps.size else seen.size // 3
            length = min(int(rng.uniform(0.85, 1.0) * most), seen.size)
            before = first - int(np.flatnonzero(seen[:first])[-1]) - 1 if seen[:first].any() else 0
            length = max(length - before, 0)
        else:
            length = math.ceil(min(rng.uniform(*SPANS), longest) * fps)
            first = int(rng.integers(math.ceil(2.0 * fps), max(seen.size, math.ceil(2.0 * fps) + 1)))
        length = min(length, spare)
        trial = seen.copy()
        trial[first : first + length] = False
        if longest_run(~trial) <= most:
            seen = trial
    return seen


def longest_run(mask: Bool[np.ndarray, " n"]) -> int:
    """Length of the longest run of True.

    >>> longest_run(np.array([True, False, True, True]))
    2
    """
    runs, count = label(mask)  # type: ignore[misc]
    return int(np.bincount(runs.ravel())[1:].max()) if count else 0


def sense_keypoints(
    rng: np.random.Generator,
    camera: Camera,
    p_world: Float[np.ndarray, "c 16 3"],
    seen: Bool[np.ndarray, " c"],
    settings: WalkSettings,
) -> tuple[Float[np.ndarray, "c 16 2"], Float[np.ndarray, "c 16"]]:
    """Pixels of the keypoints that are found, NaN for the others, and their confidences."""
    c = p_world.shape[0]
    uv = project(camera, p_world)
    place = -camera.R.T @ camera.t
    across = p_world[:, KEYPOINTS.index("right_shoulder")] - p_world[:, KEYPOINTS.index("left_shoulder")]
    toward = place - p_world[:, KEYPOINTS.index("mid_shoulder")]
    side = (across * toward).sum(axis=-1) / np.linalg.norm(across, axis=-1) / np.linalg.norm(toward, axis=-1)
    is_left = np.array([name.startswith("left_") for name in KEYPOINTS])
    is_right = np.array([name.startswith("right_") for name in KEYPOINTS])
    away = np.maximum(side, 0.0)[:, None] * is_left + np.maximum(-side, 0.0)[:, None] * is_right
    confidence = np.clip(0.85 - FAR_SIDE * away + 0.12 * rng.standard_normal((c, 16)), LEAST, SUREST)
    low, high = settings.noise
    sigma = high - (high - low) * (confidence - LEAST) / (SUREST - LEAST)
    keep = math.exp(-1.0 / (LASTING * settings.camera_fps))
    white = rng.standard_normal((2, c, 16, 2))
    lasting = lfilter([math.sqrt(1.0 - keep * keep)], [1.0, -keep], white[0], axis=0)
    out = uv + sigma[..., None] * math.sqrt(0.5) * (white[1] + lasting)
    wrong = rng.random((c, 16)) < settings.outliers
    out = out + np.where(wrong[..., None], OUTLIER * rng.standard_normal((c, 16, 2)), 0.0)
    found = seen[:, None] & shown(camera, p_world) & (rng.random((c, 16)) >= settings.drop_outs)
    found &= np.asarray(
        (out >= -0.5).all(axis=-1) & (out <= np.array([camera.width, camera.height]) - 0.5).all(axis=-1)
    )
    return np.where(found[..., None], out, np.nan), np.where(found, confidence, 0.0)
