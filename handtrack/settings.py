"""Every choice the tracker leaves to its user, with the default that the benchmarks back."""

import math
from dataclasses import dataclass
from typing import Literal

EDGES = ("wssd", "difference", "gaussian", "width", "width-compensated", "plls", "mwplls", "mwplls-iterative")


@dataclass(frozen=True, slots=True)
class Settings:
    """How to track; checked on construction.

    Attributes
    ----------
    residuals : 'outline' or 'lines'
        Every edge point against the pill outline, or the thesis's tips and axial lines.
    edges : str
        How edges are found: 'wssd' against expected profiles, or a method of the hand thesis, appendix D.
    refine : bool
        Align edges and the whole rendered image with the grey levels in one more solve.
    hypotheses : bool
        Keep the other side of a link that may be folded either way, until the images decide.
    solver : str
        Method of `handtrack.solve.solve`; 'gauss-newton-one' is the thesis's single step for each pass.
    passes : int
        Most measuring passes on one frame; the loop ends early once the pose rests.
    templates : 'rendered' or 'first'
        Templates rendered at the present pose, or kept from the first frame (links must be unoccluded there).
    visibility : 'rays' or 'polygons'
        Window functions from a ray through every sample, or from truncated polygons in order of mean depth.
    interpolation : 'nearest', 'bilinear' or 'bicubic'
        How profiles are sampled.
    filter : 'kalman', 'ghk' or 'none'
        How the next frame is predicted: adaptive Kalman filter, critically damped g-h-k filter, or the last pose.
    theta : float
        Discounting factor of the g-h-k filter, 0 < theta < 1.
    start_sigma : float
        Standard deviation of the start pose, radians.
    start_speed : float
        Standard deviation of the unknown joint velocities at the start, radians a frame.
    spacing : float
        Distance of neighbouring samplers along a link, pixels.
    """

    residuals: Literal["outline", "lines"] = "outline"
    edges: Literal[
        "wssd", "difference", "gaussian", "width", "width-compensated", "plls", "mwplls", "mwplls-iterative"
    ] = "wssd"
    refine: bool = False
    hypotheses: bool = True
    solver: Literal["levenberg-marquardt", "gauss-newton", "gauss-newton-one", "damped", "trust-region"] = (
        "levenberg-marquardt"
    )
    passes: int = 4
    templates: Literal["rendered", "first"] = "rendered"
    visibility: Literal["rays", "polygons"] = "rays"
    interpolation: Literal["nearest", "bilinear", "bicubic"] = "bilinear"
    filter: Literal["kalman", "ghk", "none"] = "kalman"
    theta: float = 0.4
    start_sigma: float = math.radians(3.0)
    start_speed: float = math.radians(4.0)
    spacing: float = 10.0

    def __post_init__(self) -> None:
        for name, choices in (
            ("residuals", ("outline", "lines")),
            ("edges", EDGES),
            ("solver", ("levenberg-marquardt", "gauss-newton", "gauss-newton-one", "damped", "trust-region")),
            ("templates", ("rendered", "first")),
            ("visibility", ("rays", "polygons")),
            ("interpolation", ("nearest", "bilinear", "bicubic")),
            ("filter", ("kalman", "ghk", "none")),
        ):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name}: got '{getattr(self, name)}', wanted one of {', '.join(choices)}")
        if self.templates == "first" and self.residuals != "lines":
            raise ValueError(
                "templates: got 'first', which goes with residuals 'lines'; outlines need rendered templates"
            )
        if not 1 <= self.passes <= 20:
            raise ValueError(f"passes: got {self.passes}, wanted 1 to 20")
        if not 0.0 < self.theta < 1.0:
            raise ValueError(f"theta: got {self.theta}, wanted a number between 0 and 1")
        for name in ("start_sigma", "start_speed", "spacing"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: got {getattr(self, name)}, wanted a positive number")
