"""Camera and truth in, the texts of their files out, so that reading them gives the same numbers."""

import numpy as np
from jaxtyping import Float

from ..camera import Camera
from ..formats.poses import code_units
from ..kinematics import Model
from ..sequences import Truth


def camera_text(camera: Camera) -> str:
    """A camera as a YAML file of its own."""
    return "format: handtrack/camera-1\n" + camera_lines(camera)


def camera_lines(camera: Camera) -> str:
    """The `camera:` part of a file.

    >>> from handtrack.camera import orthographic
    >>> print(camera_lines(orthographic(64, 48, 2.0, 32.0, 24.0, np.eye(3), np.zeros(3))))
    camera:
      type: orthographic
      width: 64
      height: 48
      scale: 2.0
      cx: 32.0
      cy: 24.0
      R: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
      t: [0.0, 0.0, 0.0]
    <BLANKLINE>
    """
    orthographic = camera.kind == "orthographic"
    values: list[tuple[str, object]] = [("type", camera.kind), ("width", camera.width), ("height", camera.height)]
    values += [("scale", float(camera.fx))] if orthographic else [("fx", float(camera.fx)), ("fy", float(camera.fy))]
    values += [("cx", float(camera.cx)), ("cy", float(camera.cy)), ("R", camera.R.tolist()), ("t", camera.t.tolist())]
    if camera.distortion.any():
        values.append(("distortion", camera.distortion.tolist()))
    return "camera:\n" + "".join(f"  {name}: {value}\n" for name, value in values)


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
