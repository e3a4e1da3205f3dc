"""Everybody who is followed or remembered, as parallel arrays, and how people are added and left out."""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from .people_settings import Settings
from .permanence import Particles, Stories, no_particles, no_stories
from .resting import AT_FIRST
from .skeleton_graph import FILTERED, HIPS, SEGMENTS, SHOULDERS

# Share of height of the bone that ends in each filtered keypoint; shoulders hang on each other, hips on shoulders.
BONE = np.zeros(FILTERED)
BONE[[segment.far for segment in SEGMENTS[:8]]] = [segment.share for segment in SEGMENTS[:8]]
BONE[list(SHOULDERS)], BONE[list(HIPS)] = SEGMENTS[8].share, SEGMENTS[10].share
TENTATIVE = -1


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """People who are followed, q of them.

    Attributes
    ----------
    label : (q,)
        -1 for one who is not confirmed yet.
    hits : (q,)
        Frames in which he was seen, so far.
    sure : (q,)
        Sum over these of the mean confidence.
    unseen : (q,)
        Seconds for which nothing of him has been seen.
    height, told : (q,)
        Mean of the told heights, metres (NaN for none), and how many.
    drift : (q, 3)
        Speed of the whole person, m/s.
    paced : (q,)
        Of how many frames that is a mean.
    was : (q, 12, 3)
        Measurements of the frame before, metres; NaN where none.
    doubted : (q,)
        Seconds for which most of his sure measurements were not believed.
    length, measured : (q, 12)
        Length of the bone to the joint before, metres, NaN where unknown; and how often it was measured.
    rest, rested : (q, 12, 3), (q, 12)
        Mean direction of that bone in the person's axes (see `resting`), and of how many frames.
    p, covariance : (q, 12, 3), (q, 12, 3, 3)
        Last estimate; NaN where never seen.
    confidence : (q, 12)
        Running mean.
    hidden : (q, 12)
        Seconds for which each keypoint has been predicted; inf where never seen.
    used : (q, 12)
        Confidence of this frame's measurement where it is believed, else 0.
    clouds : Stories or Particles
    """

    label: Int[np.ndarray, " q"]
    hits: Int[np.ndarray, " q"]
    sure: Float[np.ndarray, " q"]
    unseen: Float[np.ndarray, " q"]
    height: Float[np.ndarray, " q"]
    told: Float[np.ndarray, " q"]
    drift: Float[np.ndarray, "q 3"]
    paced: Float[np.ndarray, " q"]
    was: Float[np.ndarray, "q 12 3"]
    doubted: Float[np.ndarray, " q"]
    length: Float[np.ndarray, "q 12"]
    measured: Float[np.ndarray, "q 12"]
    rest: Float[np.ndarray, "q 12 3"]
    rested: Float[np.ndarray, "q 12"]
    p: Float[np.ndarray, "q 12 3"]
    covariance: Float[np.ndarray, "q 12 3 3"]
    confidence: Float[np.ndarray, "q 12"]
    hidden: Float[np.ndarray, "q 12"]
    used: Float[np.ndarray, "q 12"]
    clouds: Stories | Particles


@dataclass(frozen=True, slots=True, eq=False)
class Remembered:
    """People who left, r of them: label, height and where they were last, metres, and when, seconds."""

    label: Int[np.ndarray, " r"]
    height: Float[np.ndarray, " r"]
    place: Float[np.ndarray, "r 3"]
    time: Float[np.ndarray, " r"]


def nobody(q: int, settings: Settings) -> Tracks:
    """Tracks of q people of whom nothing is known yet."""
    k = FILTERED
    robust = settings.mode == "robust"
    clouds = no_stories(q, settings.hypotheses) if robust else no_particles(q, settings.particles, settings.history)
    return Tracks(
        label=np.full(q, TENTATIVE),
        hits=np.zeros(q, dtype=int),
        sure=np.zeros(q),
        unseen=np.zeros(q),
        height=np.full(q, np.nan),
        told=np.zeros(q),
        drift=np.zeros((q, 3)),
        paced=np.zeros(q),
        was=np.full((q, k, 3), np.nan),
        doubted=np.zeros(q),
        length=np.full((q, k), np.nan),
        measured=np.zeros((q, k)),
        rest=np.tile(AT_FIRST, (q, 1, 1)),
        rested=np.zeros((q, k)),
        p=np.full((q, k, 3), np.nan),
        covariance=np.full((q, k, 3, 3), np.nan),
        confidence=np.zeros((q, k)),
        hidden=np.full((q, k), np.inf),
        used=np.zeros((q, k)),
        clouds=clouds,
    )


def joined(a: Tracks, b: Tracks) -> Tracks:
    """People of both, those of `a` first."""
    return _mapped(lambda x, y: np.concatenate([x, y]), a, b)


def chosen(tracks: Tracks, kept: Bool[np.ndarray, " q"]) -> Tracks:
    """Some of them, in their order."""
    return tracks if kept.all() else _mapped(lambda x: x[kept], tracks)


def _mapped(change, *parts):
    """The same kind of object with every array changed."""
    values = [[getattr(part, field.name) for part in parts] for field in fields(parts[0])]
    return replace(
        parts[0],
        **{
            field.name: change(*value) if isinstance(value[0], np.ndarray) else _mapped(change, *value)
            for field, value in zip(fields(parts[0]), values, strict=True)
        },
    )


def nobody_remembered() -> Remembered:
    """Nobody left yet."""
    return Remembered(np.zeros(0, dtype=int), np.zeros(0), np.zeros((0, 3)), np.zeros(0))


def places(p: Float[np.ndarray, "q 12 3"]) -> Float[np.ndarray, "q 3"]:
    """Middle of each trunk, or of what is known; NaN where nothing is."""
    trunk = p[:, [0, 1, 6, 7]]
    known = ~np.isnan(p[..., 0])
    count = known.sum(axis=1)[:, None]
    rest = np.where(known[..., None], p, 0.0).sum(axis=1) / np.maximum(count, 1)
    rest = np.where(count > 0, rest, np.nan)
    middle = trunk.sum(axis=1) / 4.0
    return np.where(np.isnan(middle), rest, middle)
