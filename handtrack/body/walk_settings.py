"""Choices of the filters that follow a walk: the walk paper's numbers where it tells them, and ours; checked on making.

The paper tells counts of particles only (section IV-A: "1200 particles totals (200 for the fusion filter and 1000 in
total for the MPF)"). The other numbers say what a suit and a network of keypoints are usually like.
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

Method = Literal["drift-ff", "pose-ff", "eskf", "camera", "suit"]
METHODS: tuple[Method, ...] = get_args(Method)


@dataclass(frozen=True, slots=True)
class Settings:
    """How a walk is followed. Metres, seconds, pixels; angles in degrees.

    Attributes
    ----------
    method : str
        One of `METHODS`: particles on the suit's drift or on the pelvis, the error-state filter, the camera or the suit
        alone.
    particles, part_particles : int
        Of the fusion filter, and of each of the five posture filters.
    proposal : bool
        Whether postures are drawn from the posture filters (walk paper, section III-D), or by a walk at random.
    surest, least_sure : float
        Standard deviation of a keypoint of confidence 1, and of one of confidence 0.4, pixels.
    lasting : float
        Seconds over which half of a keypoint's noise lasts: what camera frames closer than that tell is tempered.
    outliers, outlier_spread : float
        Share of keypoints that were found somewhere else, and how far that is, pixels.
    freedom : float
        Degrees of freedom of Student's t, the robust loss of the error-state filter.
    gate : float
        Keypoints farther than this many standard deviations from the prediction count as found somewhere else.
    fewest : int
        Keypoints that make a frame of the camera count as one in view.
    drift_noise, drift_per_speed : float
        Random walk of the drift, m / sqrt(s): while standing, and what each m/s adds.
    drift_up : float
        Share of these in the vertical, which the legs keep.
    heading_noise : float
        Random walk of the heading's drift, degrees / sqrt(s).
    asymmetric : bool
        Whether the drift also has a mean pace of its own, which is followed (walk paper, section IV-B: "not considering
        yet that assymetry").
    pace, heading_pace : float
        Usual size of that pace, m/s and degrees/s.
    pace_lasts : float
        Seconds over which it changes.
    calibrate : bool
        Whether constant errors of the segments' orientations are followed too, by the error-state filter.
    calibration, pelvis_calibration : float
        Usual size of these errors about each axis, of a segment and of the pelvis.
    orientation_noise : float
        Changing error of a segment's orientation about each axis.
    length_noise : float
        Error of a keypoint's place for all that the body's model leaves out.
    odometry_noise : float
        Error of each single place of the suit that does not last.
    start, start_heading : float
        How far off the suit's frame may be before the camera first says so; and how much is left after a re-start.
    tilt : float
        By how much the suit's vertical may be off too; 0: the drift turns about the vertical only. Of Drift-FF.
    pose_noise, pose_heading_noise : float
        Random walk of the pelvis in Pose-FF, m / sqrt(s) and degrees / sqrt(s).
    posture_noise : float
        Random walk of the posture's angles in the posture filters, degrees / sqrt(s).
    segment_noise, segment_turn_noise : float
        Of a segment's relative place, and of its relative orientation, to the posture filters.
    temper : float
        Power of the camera's likelihood in the particle filters, which are few for its sharpness.
    resample : float
        Share of effective particles below which they are drawn anew.
    lost_after : int
        Frames in view, one after another, that do not fit until the filter begins anew.
    iterations : int
        Of the error-state filter's update at most.
    longest_hold : float
        Seconds without a sample of the suit after which its posture is not used any more.
    """

    method: Method = "eskf"
    particles: int = 200
    part_particles: int = 200
    proposal: bool = True
    surest: float = 4.0
    least_sure: float = 8.0
    lasting: float = 0.2
    outliers: float = 0.01
    outlier_spread: float = 80.0
    freedom: float = 5.0
    gate: float = 5.0
    fewest: int = 4
    drift_noise: float = 0.008
    drift_per_speed: float = 0.008
    drift_up: float = 0.1
    heading_noise: float = 0.2
    asymmetric: bool = True
    pace: float = 0.004
    heading_pace: float = 0.01
    pace_lasts: float = 60.0
    calibrate: bool = True
    calibration: float = 2.0
    pelvis_calibration: float = 1.0
    orientation_noise: float = 0.7
    length_noise: float = 0.01
    odometry_noise: float = 0.003
    start: float = 0.3
    start_heading: float = 5.0
    tilt: float = 0.0
    pose_noise: float = 0.5
    pose_heading_noise: float = 40.0
    posture_noise: float = 40.0
    segment_noise: float = 0.02
    segment_turn_noise: float = 4.0
    temper: float = 0.3
    resample: float = 0.5
    lost_after: int = 3
    iterations: int = 5
    longest_hold: float = 0.5

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"method: got {self.method!r}, wanted one of {', '.join(METHODS)}")
        for name, low, high in (
            ("particles", 2, 1_000_000), ("part_particles", 2, 1_000_000), ("surest", 0.01, 1000.0),
            ("least_sure", 0.01, 1000.0), ("lasting", 0.0, 60.0), ("outliers", 0.0, 0.9),
            ("outlier_spread", 1.0, 1e5), ("freedom", 1.0, 1e6), ("gate", 1.0, 1e6), ("fewest", 1, 16),
            ("drift_noise", 0.0, 10.0), ("drift_per_speed", 0.0, 10.0), ("drift_up", 0.0, 1.0),
            ("heading_noise", 0.0, 180.0), ("pace", 0.0, 1.0), ("heading_pace", 0.0, 180.0),
            ("pace_lasts", 0.1, 1e6), ("calibration", 0.0, 45.0), ("pelvis_calibration", 0.0, 45.0),
            ("orientation_noise", 0.0, 45.0), ("length_noise", 0.0, 1.0), ("odometry_noise", 0.0, 1.0),
            ("start", 0.001, 100.0), ("start_heading", 0.01, 180.0), ("tilt", 0.0, 45.0), ("pose_noise", 1e-4, 100.0),
            ("pose_heading_noise", 0.01, 1000.0), ("posture_noise", 0.01, 1000.0), ("segment_noise", 1e-4, 1.0),
            ("segment_turn_noise", 0.01, 180.0), ("temper", 0.001, 1.0), ("resample", 0.0, 1.0),
            ("lost_after", 1, 1000), ("iterations", 1, 100), ("longest_hold", 0.0, 60.0),
        ):  # fmt: skip
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"{name}: got {value}, wanted {low} to {high:g}")
        if self.least_sure < self.surest:
            raise ValueError(f"least_sure: got {self.least_sure}, wanted at least surest, {self.surest}")
