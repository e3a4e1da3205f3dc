"""Skeletons of a recording in; steady, labelled people, and the measurements that belong to each of them, out."""

from dataclasses import dataclass
from time import perf_counter
from typing import Literal

from ..errors import InputError
from ..formats.people import People
from ..formats.skeletons import Detections
from .people import Settings, follow
from .people_baselines import baseline

Mode = Literal["paper", "robust"]
MODES: tuple[Mode, ...] = ("paper", "robust")


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A finished run.

    Attributes
    ----------
    people, raw : People
        What was found, and the measurements of the same people.
    milliseconds : float
        Mean time of a frame.
    """

    people: People
    raw: People
    milliseconds: float


def settings_for(mode: str) -> Settings:
    """Settings of a mode.

    Raises
    ------
    InputError
        If the mode is unknown.
    """
    known: Mode | None = next((name for name in MODES if name == mode), None)
    if known is None:
        raise InputError(f"--mode: {mode} given; wanted: {', '.join(MODES)}")
    return Settings(mode=known)


def run(detections: Detections, settings: Settings, seed: int = 1) -> Followed:
    """Follow everybody through a recording.

    Parameters
    ----------
    seed : int
        Decides every random choice: the same skeletons, settings and seed give the same people.

    Raises
    ------
    InputError
        If there is no frame.
    """
    if not detections.time.size:
        raise InputError("skeletons: have no frames; at least one is wanted")
    begun = perf_counter()
    people = follow(detections, settings, seed)
    took = perf_counter() - begun
    raw = baseline("raw", detections, people, settings)
    return Followed(people, raw, 1e3 * took / detections.time.size)
