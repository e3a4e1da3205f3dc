"""A person's height in, the lengths of the body's segments out; single measurements replace the shares of height.

Lengths between joints are shares of the height H (Drillis & Contini 1966, as printed by Winter 2009, "Biomechanics and
Motor Control of Human Movement", Figure 4.1): heights of ankle 0.039, knee 0.285, hip 0.530 and shoulder 0.818, upper
arm 0.186, forearm 0.146, foot 0.152. That figure's widths, 0.129 and 0.0955 to each side, reach to the skin; joint
centres lie inside of them, at shares chosen here, as are those of the lumbar joint and the neck, and the radii.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float

SHORTEST, TALLEST = 0.5, 2.5  # metres


@dataclass(frozen=True, slots=True)
class Sizes:
    """Distances between joints, metres; widths are half widths. Checked on construction.

    Attributes
    ----------
    hip, shoulder : float
        From the middle to each side.
    lumbar : float
        From the middle of the hips up to the joint of pelvis and trunk.
    trunk : float
        From there to the line between the shoulders.
    neck : float
        From that line up to the joint of trunk and head.
    head : float
        From there to the middle of the face.
    upper_arm, forearm, thigh, shank : float
    foot : float
        From the ankle forward to the tip.
    ankle : float
        Height of the ankle above the ground.
    """

    hip: float
    shoulder: float
    lumbar: float
    trunk: float
    neck: float
    head: float
    upper_arm: float
    forearm: float
    thigh: float
    shank: float
    foot: float
    ankle: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and 0.0 < value < TALLEST):
                raise ValueError(f"{field.name}: got {value} m; wanted a length above 0 and below {TALLEST} m")

    @property
    def hip_height(self) -> float:
        """Height of the hips above the ground of a person who stands straight."""
        return self.thigh + self.shank + self.ankle


def sizes_of(height: float) -> Sizes:
    """Segments of average proportions.

    Parameters
    ----------
    height : float
        Stature, metres, 0.5 to 2.5.

    Raises
    ------
    ValueError
        If the height is outside of that.

    >>> sizes = sizes_of(1.80)
    >>> round(sizes.thigh, 3), round(sizes.hip_height, 3)
    (0.441, 0.954)
    """
    if not SHORTEST <= height <= TALLEST:
        raise ValueError(f"height: got {height} m; wanted {SHORTEST} to {TALLEST} m")
    h = float(height)
    return Sizes(
        hip=0.055 * h,
        shoulder=0.117 * h,
        lumbar=0.058 * h,
        trunk=(0.818 - 0.530 - 0.058) * h,
        neck=0.022 * h,
        head=0.096 * h,
        upper_arm=0.186 * h,
        forearm=0.146 * h,
        thigh=(0.530 - 0.285) * h,
        shank=(0.285 - 0.039) * h,
        foot=0.115 * h,  # of the foot's 0.152 a quarter is heel, behind the ankle
        ankle=0.039 * h,
    )


def measured(sizes: Sizes, measurements: Iterable[tuple[str, float]]) -> Sizes:
    """Sizes some of which were measured: (name, metres) of each.

    Raises
    ------
    ValueError
        For a name that is none of the sizes, or a length that cannot be.

    >>> measured(sizes_of(1.8), [("thigh", 0.42)]).thigh
    0.42
    """
    pairs = tuple(measurements)
    known = tuple(field.name for field in fields(Sizes))
    for name, _ in pairs:
        if name not in known:
            raise ValueError(f"measurements: '{name}' is unknown; wanted: {', '.join(known)}")
    return replace(sizes, **dict(pairs))


def radii_of(height: float) -> Float[np.ndarray, "13 2"]:
    """Radii of the segments' pills at both ends, in the order of `posture.SEGMENTS`, metres."""
    arms, legs = ((0.027, 0.024), (0.023, 0.018)), ((0.045, 0.034), (0.033, 0.024), (0.022, 0.015))
    pairs = [(0.070, 0.070), (0.072, 0.080), (0.040, 0.055), *arms, *arms, *legs, *legs]
    return height * np.array(pairs)
