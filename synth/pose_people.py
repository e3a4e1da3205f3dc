"""Reported keypoints of people in; who is missed as a whole, who is made up, and in which order they come, out."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from handtrack.camera import Camera

CHANGES = 0.15  # share of frames with a new order, where it is 'mixed'


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """People reported in one frame: who each truly is (-1: nobody), pixels, confidences and modes."""

    who: Int[np.ndarray, " m"]
    uv: Float[np.ndarray, "m 16 2"]
    confidence: Float[np.ndarray, "m 16"]
    mode: Int8[np.ndarray, "m 16"]

    def sorted_by(self, rank: Int[np.ndarray, " r"]) -> "Frame":
        """In the order of the ranks of places 0, 1, ...; who has none comes last."""
        at = np.concatenate([rank, np.arange(rank.size, self.who.size)])[: self.who.size]
        by = np.argsort(at, kind="stable")
        return Frame(self.who[by], self.uv[by], self.confidence[by], self.mode[by])


@dataclass(frozen=True, slots=True, eq=False)
class FalsePeople:
    """Made-up people, n of them over all frames: frame, pixels (NaN where unseen), confidences."""

    frame: Int[np.ndarray, " n"]
    uv: Float[np.ndarray, "n 16 2"]
    confidence: Float[np.ndarray, "n 16"]


def people_left_out(
    rng: np.random.Generator, shape: tuple[int, int], fps: float, rate: float, seconds: float
) -> Bool[np.ndarray, "f q"]:
    """Who is missed as a whole, frame by frame: `rate` a second, each time for about `seconds`."""
    begin, end = rng.random((2, *shape))
    out = np.zeros(shape, dtype=bool)
    before = np.zeros(shape[1], dtype=bool)
    for i in range(shape[0]):
        before = np.where(before, end[i] < np.exp(-1.0 / (fps * seconds)), begin[i] < 1.0 - np.exp(-rate / fps))
        out[i] = before
    return out


def order_of(rng: np.random.Generator, last: Int[np.ndarray, " r"], kind: str) -> Int[np.ndarray, " r"]:
    """The order of people in the next frame."""
    changes = kind == "random" or (kind == "mixed" and rng.random() < CHANGES)
    return rng.permutation(last) if changes else last


def false_people(
    rng: np.random.Generator,
    uv: Float[np.ndarray, "f q 16 2"],
    confidence: Float[np.ndarray, "f q 16"],
    camera: Camera,
    fps: float,
    rate: float,
    seconds: float,
) -> FalsePeople:
    """Made-up people: every other one repeats some keypoints of a person, the others are somewhere in the image.

    Their confidences are low, 0.1 to 0.4, and 4 to 8 of their keypoints are reported.
    """
    f, q = uv.shape[:2]
    frames: list[Int[np.ndarray, " n"]] = []
    places: list[Float[np.ndarray, "n 16 2"]] = []
    shown: list[Float[np.ndarray, "n 16"]] = []
    for begin in np.flatnonzero(rng.random(f) < 1.0 - np.exp(-rate / fps)).tolist():
        span = np.arange(begin, min(begin + 1 + int(rng.exponential(seconds * fps)), f))
        person, kept = int(rng.integers(q)), rng.permutation(14)[: rng.integers(4, 9)]
        model = uv[span, person]
        if rng.random() < 0.5:
            model = model + rng.normal(0.0, 3.0, 2)
        else:
            size = np.array([camera.width, camera.height], dtype=float)
            middle = np.where(np.isnan(model), 0.0, model).sum(axis=1) / np.maximum((~np.isnan(model)).sum(axis=1), 1)
            spot = rng.uniform(0.1, 0.9, 2) * size
            model = spot + rng.uniform(0.3, 1.0) * (model - middle[:, None]) + rng.normal(0.0, 6.0, (16, 2))
        model = model + rng.normal(0.0, 2.0, model.shape)
        with np.errstate(invalid="ignore"):
            there = ((model >= 0.0) & (model <= [camera.width - 1.0, camera.height - 1.0])).all(axis=-1)
        there &= (confidence[span, person] > 0) & np.isin(np.arange(16), kept)
        frames.append(span)
        places.append(np.where(there[..., None], model, np.nan))
        sure = np.clip(rng.uniform(0.1, 0.4, 16) + rng.normal(0.0, 0.03, there.shape), 0.05, 1.0)
        shown.append(np.where(there, sure, 0.0))
    if not frames:
        return FalsePeople(np.zeros(0, dtype=int), np.zeros((0, 16, 2)), np.zeros((0, 16)))
    out = FalsePeople(np.concatenate(frames), np.concatenate(places), np.concatenate(shown))
    enough = (out.confidence > 0).sum(axis=1) >= 4
    return FalsePeople(out.frame[enough], out.uv[enough], out.confidence[enough])
