"""Cameras and truth in, the texts of their files out, so that reading them gives the same numbers."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..camera import Camera
from ..formats.cameras import cameras_text
from ..formats.poses import code_units
from ..kinematics import Model
from ..sequences import Truth


def camera_text(cameras: Sequence[Camera]) -> str:
    """Cameras as a YAML file of their own."""
    return "format: handtrack/camera-1\n" + cameras_text(cameras)


def degrees(model: Model, q: Float[np.ndarray, " j"]) -> dict[str, float]:
    """A pose as files have it: degrees, model units where a joint slides."""
    values = q / code_units(model)
    return {name: float(f"{value:.10g}") + 0.0 for name, value in zip(model.joint_names, values, strict=True)}


def truth_text(truth: Truth, model: Model) -> str:
    """Text of `truth.csv`: the joints that have a value in every frame."""
    known = np.flatnonzero(np.isfinite(truth.q).all(axis=0))
    values = truth.q[:, known] / code_units(model)[known] + 0.0
    header = ",".join(["frame", *(model.joint_names[joint] for joint in known)])
    rows = (f"{n},{','.join(f'{x:.10g}' for x in row)}" for n, row in zip(truth.frame, values, strict=True))
    return "\n".join([header, *rows]) + "\n"
