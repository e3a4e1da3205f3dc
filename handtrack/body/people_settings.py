"""Choices of the permanence filter: the people paper's numbers, and ours; checked on construction."""

import math
from dataclasses import dataclass
from typing import Literal

NoiseMeaning = Literal["sd", "variance"]


@dataclass(frozen=True, slots=True)
class Settings:
    """How people are followed. Metres, seconds.

    Attributes
    ----------
    mode : 'paper' or 'robust'
        The paper's rules, or ours.
    distance : float
        Delta: people whose root is farther from the camera are left out.
    reward, penalty : float
        r and p: by how much a right bone adds to its keypoints' confidence, and a wrong one takes away.
    tolerance : float
        A bone is right if its length is within this share of what the height says.
    delta : float
        Of the assignment's cost M = D + C + u(D + C - delta).
    alpha, beta : float
        Of the measurement's noise R = alpha^(c - beta).
    noise : 'sd' or 'variance'
        What R is, in mode `paper`: a standard deviation in metres, or a variance in m^2.
    threshold : float
        T: measurements that are less sure are occluded, in mode `paper`.
    history : int
        gamma: frames over which the first-order polynomial is fitted at most.
    particles : int
        Of each keypoint in mode `paper`.
    hypotheses : int
        Of each keypoint in mode `robust`.
    gate : float
        How far a person may be from where he is expected.
    confirm : int
        Frames in which somebody is seen before he gets a label.
    time_out, remember : float
        How long nothing of a person may be seen before he is gone; and how long he is remembered then.
    longest : float
        How long a keypoint is predicted before it is lost.
    skin : float or None
        How far in front of a wrist's joint its readings are, other joints in proportion (see `skin`); 0 for readings of
        joints, None if that is not known. Not used in mode `paper`.
    """

    mode: Literal["paper", "robust"] = "robust"
    distance: float = 3.0
    reward: float = 0.1
    penalty: float = 0.1
    tolerance: float = 0.25
    delta: float = 0.5
    alpha: float = 0.01
    beta: float = 0.2
    noise: NoiseMeaning = "sd"
    threshold: float = 0.4
    history: int = 50
    particles: int = 100
    hypotheses: int = 8
    gate: float = 0.6
    confirm: int = 5
    time_out: float = 2.0
    remember: float = 60.0
    longest: float = 10.0
    skin: float | None = None

    def __post_init__(self) -> None:
        for name, wanted in (("mode", ("paper", "robust")), ("noise", ("sd", "variance"))):
            if getattr(self, name) not in wanted:
                raise ValueError(f"{name}: got {getattr(self, name)!r}, wanted one of {', '.join(wanted)}")
        for name, low, high in (
            ("distance", 0.1, 1000.0), ("reward", 0.0, 1.0), ("penalty", 0.0, 1.0), ("tolerance", 0.01, 1.0),
            ("delta", 0.0, 100.0), ("alpha", 1e-9, 1.0), ("beta", 0.0, 1.0), ("threshold", 0.0, 1.0),
            ("history", 1, 10_000), ("particles", 2, 100_000), ("hypotheses", 2, 64), ("gate", 0.01, 100.0),
            ("confirm", 1, 1000), ("time_out", 0.0, 3600.0), ("remember", 0.0, 86_400.0), ("longest", 0.0, 3600.0),
            ("skin", -0.2, 0.2),
        ):  # fmt: skip
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"{name}: got {value}, wanted {low} to {high}")
