"""What a camera could see of people in, what a bottom-up pose network and a depth image make of it out.

Every keypoint is, at each moment, in one of six modes, after the kinds of error of Ronchi and Perona (Benchmarking and
Error Diagnosis in Multi-Instance Pose Estimation, ICCV 2017):

* `GOOD`, with jitter;
* `GUESS`: hidden, and put where the rest of the body suggests;
* `MISS`: not reported;
* `SWAP`: on the same keypoint of another person, and nearly as sure as if it were right;
* `INVERT`: on the keypoint of the same person's other side;
* `STRAY`: on something else in the picture.

Modes change at random with rates a second (a Markov chain), so errors last: who is seen falls into an error rarely,
more often where another candidate is near in the image; who is hidden falls into one within a tenth of a second; who is
seen again recovers as fast. The place in space is the depth that the camera reads at the reported pixel: a wrist that
slips off the arm lands on what lies behind it. That depth is of the skin, not of the joint.

Sizes and confidences are measured on real footage: OpenPose's keypoints of one person in four calibrated views against
their triangulation (the Pose2Sim demonstration, 4800 keypoints, 3 to 4 m away). The fast part of the error has a median
deviation of 4.6 mm there, the slow part of 10 to 20 mm; jitter changes with confidence as exp(3 (0.65 - c)); confidence
is 0.64 +- 0.07 of keypoints that are right within 3 cm, and 0.29 +- 0.11 of those that are 20 to 50 cm off. Rates
cannot be measured there (one person, little hidden). They are ours, the same for all tasks, and chosen so that the raw
error of the left wrist comes near the first row of the people paper's Table I; with them three quarters of the
keypoints are good in T0, half in T3, and swaps are the rarest error.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from handtrack.formats.skeletons import KEYPOINTS

from .people_stage import Sight, depth_at
from .pose_people import Frame, false_people, order_of, people_left_out

GOOD, GUESS, MISS, SWAP, INVERT, STRAY = range(6)
REPORTED = (*range(12), KEYPOINTS.index("mid_hip"), KEYPOINTS.index("mid_shoulder"))  # of OpenPose's 25
_OTHER_SIDE = np.array([1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 12, 13, 14, 15])
# How far the network's idea of a joint is from the anatomist's, in shares of a limb's (hips and shoulders lie deep).
_LOOSE = np.array([1.2, 1.2, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.5, 1.5, 1.0, 1.0])


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """How a pose network errs; checked on construction. Rates are a second, times seconds, lengths metres.

    Attributes
    ----------
    jitter : float
        Pixels, white, each axis, at confidence 0.65: depth makes metres of it.
    slow, slow_time : float
        Deviation of the slow part of the error of a limb's joint, and how long it lasts.
    guess : float
        Deviation of a guessed keypoint from the true place.
    miss_rate, stray_rate, invert_rate : float
        Of a keypoint that is seen, with nothing near.
    crowd_rate : float
        Of a seen keypoint to jump onto another candidate for it, at no distance; `crowd` is the distance at which the
        rate has fallen to 1/e, across the line of sight at the person's depth.
    recover_rate : float
        From an error to what is seen.
    hide_rate : float
        From `GOOD` to an error where the keypoint is hidden.
    hidden : tuple of 4 floats
        Chances of a hidden keypoint to be guessed, missed, inverted, stray; the candidates near it take theirs first.
    flip_rate : float
        Of a whole person to have left and right changed, for one seen from the side ten times that.
    lose_rate, lose_time : float
        Of a whole person to be missed, and how long.
    false_rate, false_time : float
        Of false people, and how long they last; half of them repeat part of a person, half are scattered.
    depth_noise : float
        Deviation of the depth at 1 m; it grows with the square of the depth (0.08 pixels of disparity for a RealSense
        D455's 95 mm base: 0.002).
    hole : float
        Chance of a reported pixel to have no depth.
    skin : float
        Metres added to the depth read, as a correction from skin to joint; 0 as the paper has it.
    order : 'mixed', 'random' or 'kept'
        Whether the order of people in a frame changes now and then, in every frame, or never.
    """

    jitter: float = 0.55
    slow: float = 0.014
    slow_time: float = 0.5
    guess: float = 0.10
    miss_rate: float = 0.05
    stray_rate: float = 0.03
    invert_rate: float = 0.02
    crowd_rate: float = 4.0
    crowd: float = 0.10
    recover_rate: float = 8.0
    hide_rate: float = 10.0
    hidden: tuple[float, float, float, float] = (0.45, 0.30, 0.10, 0.15)
    flip_rate: float = 0.02
    lose_rate: float = 0.03
    lose_time: float = 0.15
    false_rate: float = 0.10
    false_time: float = 0.20
    depth_noise: float = 0.002
    hole: float = 0.02
    skin: float = 0.0
    order: Literal["mixed", "random", "kept"] = "mixed"

    def __post_init__(self) -> None:
        for name, low, high in (
            ("jitter", 0.0, 100.0), ("slow", 0.0, 1.0), ("slow_time", 0.01, 100.0), ("guess", 0.0, 2.0),
            ("miss_rate", 0.0, 100.0), ("stray_rate", 0.0, 100.0), ("invert_rate", 0.0, 100.0),
            ("crowd_rate", 0.0, 100.0), ("crowd", 0.001, 10.0), ("recover_rate", 0.1, 1000.0),
            ("hide_rate", 0.0, 1000.0), ("flip_rate", 0.0, 100.0), ("lose_rate", 0.0, 100.0),
            ("lose_time", 0.01, 100.0), ("false_rate", 0.0, 100.0), ("false_time", 0.01, 100.0),
            ("depth_noise", 0.0, 0.1), ("hole", 0.0, 1.0), ("skin", -0.2, 0.2),
        ):  # fmt: skip
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: got {getattr(self, name)}, wanted {low} to {high}")
        if self.order not in ("mixed", "random", "kept"):
            raise ValueError(f"order: got '{self.order}', wanted one of mixed, random, kept")
        if min(self.hidden) < 0 or not np.isclose(sum(self.hidden), 1.0):
            raise ValueError(f"hidden: got {self.hidden}, wanted four chances that sum to 1")


FAULTLESS = NetworkSettings(
    jitter=0.0, slow=0.0, guess=0.0, miss_rate=0.0, stray_rate=0.0, invert_rate=0.0, crowd_rate=0.0, hide_rate=0.0,
    flip_rate=0.0, lose_rate=0.0, false_rate=0.0, depth_noise=0.0, hole=0.0, order="kept",
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Reported people, d of them, sorted by frame, then by order of detection.

    Attributes
    ----------
    frame, order, who : (d,)
        Frame, number in it, and who it truly is; -1 for a false one.
    p : (d, 16, 3)
        Metres, camera axes; NaN where not reported.
    uv : (d, 16, 2)
        Pixels; NaN where not reported.
    confidence : (d, 16)
        0..1; 0 where not reported.
    mode : (d, 16)
        What each keypoint truly is, `GOOD` ... `STRAY`.
    """

    frame: Int[np.ndarray, " d"]
    order: Int[np.ndarray, " d"]
    who: Int[np.ndarray, " d"]
    p: Float[np.ndarray, "d 16 3"]
    uv: Float[np.ndarray, "d 16 2"]
    confidence: Float[np.ndarray, "d 16"]
    mode: Int8[np.ndarray, "d 16"]


def detect(rng: np.random.Generator, sight: Sight, fps: float, settings: NetworkSettings) -> Seen:
    """What is reported of a stage in all frames.

    Parameters
    ----------
    sight : Sight
        What the camera could see.
    fps : float
        Frames a second.
    """
    mode = modes(rng, sight, fps, settings)
    uv, confidence = _places(rng, sight, mode, fps, settings)
    gone = people_left_out(rng, uv.shape[:2], fps, settings.lose_rate, settings.lose_time)
    gone |= (confidence > 0).sum(axis=-1) < 4  # fewer joined parts make no person
    false = false_people(rng, uv, confidence, sight.stage.eye.camera, fps, settings.false_rate, settings.false_time)
    rows: list[Frame] = []
    last = np.arange(uv.shape[1] + 2)
    for i in range(uv.shape[0]):
        here = np.flatnonzero(~gone[i])
        extra = false.frame == i
        frame = Frame(
            np.concatenate([here, np.full(np.count_nonzero(extra), -1)]),
            np.concatenate([uv[i, here], false.uv[extra]]),
            np.concatenate([confidence[i, here], false.confidence[extra]]),
            np.concatenate([mode[i, here], np.full((np.count_nonzero(extra), 16), STRAY, dtype=np.int8)]),
        )
        last = order_of(rng, last, settings.order)
        rows.append(frame.sorted_by(last))
    return _in_space(rng, sight, rows, settings)


def modes(rng: np.random.Generator, sight: Sight, fps: float, settings: NetworkSettings) -> Int8[np.ndarray, "f q 16"]:
    """The mode of every keypoint in every frame; see the module."""
    f, q = sight.share.shape[:2]
    now = np.zeros((q, 16), dtype=np.int8)
    out = np.empty((f, q, 16), dtype=np.int8)
    metres = _metres_a_pixel(sight)
    edges = np.cumsum(settings.hidden)[:3]
    kinds = np.array([GUESS, MISS, INVERT, STRAY], dtype=np.int8)
    spontaneous = np.array([settings.miss_rate, settings.stray_rate, settings.invert_rate])
    for i in range(f):
        draw, pick, which = rng.random((3, q, 16))
        seen = sight.share[i] >= 0.4
        swap, invert = _candidates(sight, i, metres[i], settings.crowd)
        # the hidden one: candidates near it first, else by the chances of `hidden`
        error = kinds[np.searchsorted(edges, pick)]
        error = np.where(which < 0.6 * invert, INVERT, error)
        error = np.where(which > 1.0 - 0.6 * swap, SWAP, error)
        if i == 0:
            now = np.where(seen, GOOD, error).astype(np.int8)
        rates = np.concatenate(
            [np.broadcast_to(spontaneous, (q, 16, 3)), settings.crowd_rate * np.stack([swap, invert], axis=-1)], axis=-1
        )
        total = rates.sum(axis=-1)
        steps = np.cumsum(rates, axis=-1) / np.maximum(total, 1e-12)[..., None]
        faulty = np.array([MISS, STRAY, INVERT, SWAP, INVERT])[(pick[..., None] >= steps).sum(axis=-1).clip(max=4)]
        new = np.where(now == GOOD, np.where(seen, faulty, error), np.where(seen, GOOD, error))
        rate = np.where(now == GOOD, np.where(seen, total, settings.hide_rate), settings.recover_rate)
        rate = np.where(~seen & (now != GOOD), 1.0, rate)  # a hidden one stays in its error for about a second
        now = np.where(draw < 1.0 - np.exp(-rate / fps), new, now).astype(np.int8)
        out[i] = now
    out[:, :, 12:] = np.where((out[:, :, 12:] == GUESS) | (out[:, :, 12:] == GOOD), out[:, :, 12:], MISS)
    return _flipped(rng, sight, out, fps, settings.flip_rate)


def _metres_a_pixel(sight: Sight) -> Float[np.ndarray, "f q"]:
    """Size of a pixel at each person's depth."""
    return sight.stage.p[:, :, KEYPOINTS.index("root"), 2] / sight.stage.eye.camera.fx


def _candidates(
    sight: Sight, frame: int, metres: Float[np.ndarray, " q"], crowd: float
) -> tuple[Float[np.ndarray, "q 16"], Float[np.ndarray, "q 16"]]:
    """Pull, 0..1, of the nearest seen same keypoint of another person, and of one's own other side."""
    uv, share = sight.uv[frame], sight.share[frame]
    apart = np.linalg.norm(uv[:, None] - uv[None], axis=-1)
    q = uv.shape[0]
    apart = np.where(np.eye(q, dtype=bool)[:, :, None] | (share < 0.4)[None] | np.isnan(apart), np.inf, apart)
    other = apart.min(axis=1, initial=np.inf)
    own = np.linalg.norm(uv - uv[:, _OTHER_SIDE], axis=-1)
    own = np.where((share[:, _OTHER_SIDE] < 0.4) | np.isnan(own) | (np.arange(16) >= 12), np.inf, own)
    with np.errstate(invalid="ignore"):
        pulls = [np.nan_to_num(np.exp(-d * metres[:, None] / crowd)) for d in (other, own)]
    return pulls[0], pulls[1]


def _flipped(
    rng: np.random.Generator, sight: Sight, mode: Int8[np.ndarray, "f q 16"], fps: float, rate: float
) -> Int8[np.ndarray, "f q 16"]:
    """Now and then a whole person has left and right changed, for a fifth of a second."""
    wide = np.linalg.norm(sight.uv[:, :, 0] - sight.uv[:, :, 1], axis=-1) * _metres_a_pixel(sight)
    side = np.nan_to_num(wide, nan=1.0) < 0.15
    draw = rng.random((2, *wide.shape))
    begin, stay = draw[0] < 1.0 - np.exp(-rate * np.where(side, 10.0, 1.0) / fps), draw[1] < np.exp(-5.0 / fps)
    on = np.zeros(wide.shape, dtype=bool)
    before = np.zeros(wide.shape[1], dtype=bool)
    for i in range(wide.shape[0]):
        before = np.where(before, stay[i], begin[i])
        on[i] = before
    pairs = on[:, :, None] & (np.arange(16) < 12) & (mode == GOOD)
    return np.where(pairs, INVERT, mode).astype(np.int8)


def _lasting(rng: np.random.Generator, shape: tuple[int, ...], frames: float) -> Float[np.ndarray, "..."]:
    """Unit noise along the first axis that forgets within so many frames."""
    keep = np.exp(-1.0 / frames)
    white = rng.standard_normal(shape)
    white[1:] *= np.sqrt(1.0 - keep * keep)
    for i in range(1, shape[0]):
        white[i] += keep * white[i - 1]
    return white


def _places(
    rng: np.random.Generator, sight: Sight, mode: Int8[np.ndarray, "f q 16"], fps: float, settings: NetworkSettings
) -> tuple[Float[np.ndarray, "f q 16 2"], Float[np.ndarray, "f q 16"]]:
    """Reported pixels (NaN where none) and confidences."""
    f, q = mode.shape[:2]
    confidence = _confidences(rng, sight, mode, fps)
    metres = _metres_a_pixel(sight)[:, :, None, None]
    slow = settings.slow * _LOOSE[:, None] * _lasting(rng, (f, q, 16, 2), settings.slow_time * fps)
    wide = _lasting(rng, (f, q, 16, 2), 1.0 * fps)
    rough = np.exp(3.0 * (0.65 - confidence))[..., None]
    jitter = settings.jitter * rough * rng.standard_normal((f, q, 16, 2))
    good = sight.uv + slow / metres
    uv = good + jitter
    off = np.select([mode == GUESS, mode == STRAY], [settings.guess, 0.0], 0.0)[..., None] * wide
    uv += off / metres
    inverted = good[:, :, _OTHER_SIDE] + jitter
    uv = np.where((mode == INVERT)[..., None], inverted, uv)
    for person in range(q):
        nearest = _nearest(sight, person)
        other = np.take_along_axis(good, nearest[:, None, :, None], axis=1)[:, 0] + jitter[:, person]
        uv[:, person] = np.where((mode[:, person] == SWAP)[..., None], other, uv[:, person])
    uv = np.where((mode == STRAY)[..., None], _strayed(rng, sight, mode, metres), uv)
    camera = sight.stage.eye.camera
    with np.errstate(invalid="ignore"):
        inside = ((uv >= 0.0) & (uv <= np.array([camera.width, camera.height]) - 1.0)).all(axis=-1)
    shown = inside & (mode != MISS) & (confidence >= 0.05)  # OpenPose's own threshold of a part
    shown[:, :, [i for i in range(16) if i not in REPORTED]] = False
    return np.where(shown[..., None], uv, np.nan), np.where(shown, confidence, 0.0)


def _nearest(sight: Sight, person: int) -> Int[np.ndarray, "f 16"]:
    """Who has the seen same keypoint that is nearest in the image; oneself where nobody has."""
    apart = np.linalg.norm(sight.uv - sight.uv[:, person, None], axis=-1)
    apart = np.where((sight.share < 0.4) | np.isnan(apart), np.inf, apart)
    apart[:, person] = np.where(np.isinf(np.delete(apart, person, axis=1)).all(axis=1), 0.0, np.inf)
    return apart.argmin(axis=1)


def _strayed(
    rng: np.random.Generator, sight: Sight, mode: Int8[np.ndarray, "f q 16"], metres: Float[np.ndarray, "f q 1 1"]
) -> Float[np.ndarray, "f q 16 2"]:
    """A place in the image, 0.15 to 0.6 m from the true one, that stays while the error lasts."""
    f, q = mode.shape[:2]
    angle, far = rng.uniform(0.0, 2.0 * np.pi, (f, q, 16)), rng.uniform(0.15, 0.6, (f, q, 16))
    spot = sight.uv + (far[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)) / metres
    begins = np.ones(mode.shape, dtype=bool)
    begins[1:] = (mode[1:] != STRAY) | (mode[:-1] != STRAY)
    first = np.maximum.accumulate(np.where(begins, np.arange(f)[:, None, None], 0), axis=0)
    return np.take_along_axis(spot, first[..., None], axis=0)


def _confidences(
    rng: np.random.Generator, sight: Sight, mode: Int8[np.ndarray, "f q 16"], fps: float
) -> Float[np.ndarray, "f q 16"]:
    """Confidences by mode, 0..1: as measured; of a swap they are between those of right and wrong."""
    noise = _lasting(rng, mode.shape, 0.15 * fps)
    seen = 0.45 + 0.20 * np.clip(sight.share, 0.0, 1.0)
    level = np.where(mode == GOOD, seen, np.array([0.0, 0.30, 0.0, 0.50, 0.32, 0.22])[mode])
    spread = np.array([0.06, 0.11, 0.0, 0.10, 0.12, 0.11])[mode]
    return np.clip(level + spread * noise, 0.0, 0.95)


def _in_space(rng: np.random.Generator, sight: Sight, rows: list[Frame], settings: NetworkSettings) -> Seen:
    """All frames' people with the depths that the camera reads at their pixels."""
    count = [row.who.size for row in rows]
    frame = np.repeat(np.arange(len(rows)), count)
    who = np.concatenate([row.who for row in rows])
    uv = np.concatenate([row.uv for row in rows])
    confidence = np.concatenate([row.confidence for row in rows])
    mode = np.concatenate([row.mode for row in rows])
    z = np.concatenate([depth_at(sight, i, row.uv.reshape(-1, 2)) for i, row in enumerate(rows)]).reshape(uv.shape[:2])
    read: Bool[np.ndarray, "d 16"] = np.isfinite(z) & (z > 0.3) & (rng.random(z.shape) >= settings.hole)
    read &= confidence > 0
    z = np.where(read, z, 1.0)
    z = z + settings.depth_noise * z * z * rng.standard_normal(z.shape)
    camera = sight.stage.eye.camera
    xy = (uv - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    ray = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
    deeper = np.where(read, z, np.nan)[..., None] * ray
    deeper = deeper + settings.skin * ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    order = np.concatenate([np.arange(n) for n in count]) if rows else np.zeros(0, dtype=int)
    return Seen(frame, order, who, deeper, uv, np.where(read, confidence, 0.0), mode)
