"""Every choice that the simulated cell leaves to its user."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from .people import SIDES

USUAL, SHORTEST = 10.0, 9.0  # seconds of a cycle


@dataclass(frozen=True, slots=True)
class CellSettings:
    """How a cell is simulated; checked on construction.

    Attributes
    ----------
    frames : int
        Frames of the scene.
    cycles : int or None
        Assembly cycles, of four reaches each, that fill the frames, each at least 9 s long; None: cycles of 10 s, the
        last one cut off where the frames end.
    fps : float
        Frames per second.
    occlusion : 'static', 'dynamic' or 'both'
        Reaches into the shelf, reaches behind the robot, or two of each; the others are in the open.
    side : 'right' or 'left'
        The arm that works; the cell of the left one is a mirror image.
    width, height : int
        Pixels.
    field_of_view : float
        Horizontal, degrees.
    noise : float
        Standard deviation of depth at 1 m, metres; it grows with the square of the depth.
    holes : float
        Share of the image under random blobs without reading, 0..0.9; 0 leaves out holes at edges and grazing
        surfaces, too.
    farthest : float
        Metres beyond which there is no reading.
    sensor_noise : float
        Standard deviation of a tracked keypoint along each axis, metres.
    sensor_offset : float
        Metres by which keypoints are reported too near; about 0.035 for a sensor that takes the skin for the joint.
    linger : float
        Seconds that a hidden keypoint is still inferred before it is lost.
    motion : Path or None
        Markers of a recorded right arm (`hand_top`, `hand_left`, `hand_right`, `right_elbow`, `right_shoulder`) that
        replace the smooth noise over the reaches.
    """

    frames: int = 300
    cycles: int | None = None
    fps: float = 30.0
    occlusion: Literal["static", "dynamic", "both"] = "both"
    side: Literal["right", "left"] = "right"
    width: int = 320
    height: int = 240
    field_of_view: float = 60.0
    noise: float = 0.0015
    holes: float = 0.01
    farthest: float = 6.0
    sensor_noise: float = 0.010
    sensor_offset: float = 0.0
    linger: float = 0.2
    motion: Path | None = None

    def __post_init__(self) -> None:
        for name, low, high in (
            ("frames", 1, 1_000_000), ("fps", 1.0, 1000.0), ("width", 8, 8192),
            ("height", 8, 8192), ("field_of_view", 10.0, 150.0), ("noise", 0.0, 0.1), ("holes", 0.0, 0.9),
            ("farthest", 0.5, 60.0), ("sensor_noise", 0.0, 1.0), ("sensor_offset", -0.5, 0.5), ("linger", 0.0, 1e6),
        ):  # fmt: skip
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: got {getattr(self, name)}, wanted {low} to {high}")
        if self.cycles is not None and not 1 <= self.cycles <= self.frames / self.fps / SHORTEST:
            span = self.frames / self.fps
            raise ValueError(f"cycles: got {self.cycles} in {span:g} s; wanted from 1, each of {SHORTEST:g} s or more")
        for name, choices in (("occlusion", ("static", "dynamic", "both")), ("side", SIDES)):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name}: got '{getattr(self, name)}', wanted one of {', '.join(choices)}")

    def bounds(self) -> tuple[int, ...]:
        """First frame of each cycle, and the frame after the last; it may lie beyond the scene's end.

        >>> CellSettings(frames=400).bounds(), CellSettings(frames=600, cycles=2).bounds()
        ((0, 300, 600), (0, 300, 600))
        """
        if self.cycles is None:
            number = math.ceil(self.frames / (USUAL * self.fps))
            return tuple(round(i * USUAL * self.fps) for i in range(number + 1))
        return tuple(round(i * self.frames / self.cycles) for i in range(self.cycles + 1))
