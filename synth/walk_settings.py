"""Every choice that the simulated walk leaves to its user."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class WalkSettings:
    """How a walk is simulated; checked on construction.

    Attributes
    ----------
    seconds : float
        Length of the walk.
    fps, camera_fps : float
        Samples a second of the suit, and of the camera.
    height : float
        Of the person, metres.
    proportions : float
        Standard deviation of each of the person's lengths from the average of that height, as a share of it.
    measured : float or None
        Standard deviation, metres, of the tape that measured the lengths; they go into the walk file and into the suit.
        None: nobody measured, and the suit takes the true lengths.
    speed : float
        Metres a second along the straights.
    stops : float
        Times a minute that the person stands still and moves the hands.
    gestures : float
        Times a minute that a hand moves while walking.
    looseness : float
        Degrees, standard deviation about each axis, of what the true joints do beside the model's 20 joints.
    in_view : float
        Share of the camera's frames in which the person is seen, 0.2 to 1.
    longest_gap : float
        Seconds that the person is out of view at most.
    noise : (float, float)
        Standard deviations of a keypoint, pixels: of the surest, and of the least sure.
    drop_outs, outliers : float
        Shares of keypoints that are not found, or found somewhere else.
    drift : (float, float)
        Metres between which the suit's position is off at the end of a walk of five minutes.
    asymmetry : float
        Share of the drift that goes one way; the rest wanders.
    heading_drift : float
        Degrees, standard deviation, that the suit's heading is off after five minutes.
    start_offset, start_heading : float
        Metres and degrees, standard deviations, that the suit is off at the start.
    calibration, pelvis_calibration : float
        Degrees, standard deviation about each axis, of a segment's constant error of orientation.
    orientation_noise : float
        Degrees, standard deviation about each axis, of its changing error.
    missing : float
        Share of the suit's samples that are lost.
    jitter : float
        Seconds, standard deviation of the camera's times about their even spacing, at most a tenth of it.
    distortion : tuple of five floats
        Of the camera, as OpenCV's `k1 k2 p1 p2 k3`.
    motion : Path or None
        BVH file of a recorded person: if it walks, its gait replaces the built-in one, else its arms the gestures.
    """

    seconds: float = 300.0
    fps: float = 5.0
    camera_fps: float = 5.0
    height: float = 1.75
    proportions: float = 0.02
    measured: float | None = 0.003
    speed: float = 1.0
    stops: float = 1.0
    gestures: float = 3.0
    looseness: float = 2.0
    in_view: float = 0.6
    longest_gap: float = 12.0
    noise: tuple[float, float] = (4.0, 8.0)
    drop_outs: float = 0.05
    outliers: float = 0.01
    drift: tuple[float, float] = (0.5, 1.5)
    asymmetry: float = 0.8
    heading_drift: float = 4.0
    start_offset: float = 0.05
    start_heading: float = 1.0
    calibration: float = 2.0
    pelvis_calibration: float = 1.0
    orientation_noise: float = 0.7
    missing: float = 0.0
    jitter: float = 0.0
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    motion: Path | None = None

    def __post_init__(self) -> None:
        for name, low, high in (
            ("seconds", 2.0, 36_000.0), ("fps", 1.0, 240.0), ("camera_fps", 1.0, 240.0), ("height", 1.0, 2.5),
            ("proportions", 0.0, 0.1), ("speed", 0.2, 2.0), ("stops", 0.0, 3.0), ("gestures", 0.0, 10.0),
            ("looseness", 0.0, 10.0), ("in_view", 0.2, 1.0), ("longest_gap", 1.0, 600.0), ("drop_outs", 0.0, 0.9),
            ("outliers", 0.0, 0.5), ("asymmetry", 0.0, 1.0), ("heading_drift", 0.0, 90.0), ("start_offset", 0.0, 10.0),
            ("start_heading", 0.0, 180.0), ("calibration", 0.0, 20.0), ("pelvis_calibration", 0.0, 20.0),
            ("orientation_noise", 0.0, 20.0), ("missing", 0.0, 0.9), ("jitter", 0.0, 0.1 / self.camera_fps),
        ):  # fmt: skip
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: got {getattr(self, name)}, wanted {low} to {high:g}")
        if self.measured is not None and not 0.0 <= self.measured <= 0.1:
            raise ValueError(f"measured: got {self.measured}, wanted 0 to 0.1 or None")
        for name in ("noise", "drift"):
            low, high = getattr(self, name)
            if not 0.0 <= low <= high:
                raise ValueError(f"{name}: got {(low, high)}, wanted two numbers from 0, the larger one last")
