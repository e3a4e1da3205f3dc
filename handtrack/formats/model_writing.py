"""A model in, the text of `model.yaml` out, so that reading it gives the same model.

A model keeps one constant transform for each frame; its Denavit-Hartenberg parameters are read off it by inverting eq.
(2.1) of the hand thesis: `theta = atan2(-T01, T00)`, `alpha = atan2(-T12, T22)`, `a = T03`,
`d = -sin(alpha) T13 + cos(alpha) T23`. A fixed transform that is not of that form (`T02 != 0`) is written as a matrix.
"""

import json
import math
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..kinematics.tree import Model, link_transform
from .writing import write_text

TOLERANCE = 1e-13  # of a transform read back, against its own size


def write_model(path: Path | str, model: Model) -> None:
    """Write a model file, whole or not at all.

    The tree, names, units, lengths and radii come back bit for bit, transforms and limits to rounding (1e-13): angles
    pass through degrees. A coupling of a coupling comes back as one on the independent joint, the same map.

    Raises
    ------
    ValueError
        For what the format cannot hold: a joint whose frame is not of Denavit-Hartenberg form, or one-sided limits.
    """
    write_text(Path(path), model_text(model))


def model_text(model: Model) -> str:
    """The text that `write_model` writes."""
    lines = [
        "format: handtrack/model-1",
        f"name: {json.dumps(model.name, ensure_ascii=False)}",
        f"units: {model.units}",
        "frames:",
        *(f"  - {_frame_text(model, i)}" for i in range(model.parent.size)),
    ]
    coupled = [i for i in range(len(model.joint_names)) if i not in model.free]
    if coupled:
        lines += ["couplings:", *(f"  - {_coupling_text(model, joint)}" for joint in coupled)]
    return "\n".join(lines) + "\n"


def dh_parameters(transform: Float[np.ndarray, "4 4"]) -> tuple[float, float, float, float] | None:
    """`alpha, a, d, theta` (degrees, model units) of eq. (2.1), or None for a transform that is not of that form.

    >>> dh_parameters(link_transform(math.pi / 2, 3.0, -1.0, math.pi))
    (90.0, 3.0, -1.0, 180.0)
    """
    T = transform
    alpha, theta = _degrees(math.atan2(-T[1, 2], T[2, 2])), _degrees(math.atan2(-T[0, 1], T[0, 0]))
    ra = math.radians(alpha)
    a, d = float(T[0, 3]), _neat(float(-math.sin(ra) * T[1, 3] + math.cos(ra) * T[2, 3]))
    again = link_transform(ra, a, d, math.radians(theta))
    size = max(1.0, float(np.abs(T[:3, 3]).max()))
    return (alpha, a, d, theta) if np.abs(again - T).max() <= TOLERANCE * size else None


def number(value: float) -> str:
    """Shortest text that reads back as the same number; whole numbers without a point.

    >>> number(46.0), number(0.1), number(1e-07)
    ('46', '0.1', '1e-07')
    """
    value = float(value) + 0.0  # no minus zero
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


def _neat(value: float) -> float:
    """The value rounded to 12 decimals where that changes only the last bits."""
    rounded = round(value, 12)
    return rounded if abs(rounded - value) <= 4 * math.ulp(value) else value


def _degrees(radians: float) -> float:
    return _neat(math.degrees(radians))


def _frame_text(model: Model, i: int) -> str:
    parent = int(model.frame_ids[model.parent[i]]) if model.parent[i] >= 0 else 0
    parts = [f"id: {model.frame_ids[i]}", f"parent: {parent}"]
    parameters = dh_parameters(model.prefix[i])
    joint = int(model.joint[i])
    if parameters is None:
        if joint >= 0:
            name = model.joint_names[joint]
            raise ValueError(
                f"model: frame of joint '{name}' is not of the form (2.1); a fixed frame below it is wanted"
            )
        rows = ", ".join("[" + ", ".join(number(x) for x in row) + "]" for row in model.prefix[i])
        parts.append(f"transform: [{rows}]")
    else:
        alpha, a, d, theta = (number(x) for x in parameters)
        if joint >= 0 and model.prismatic[i]:
            d = _joint_text(model, joint, d, slides=True)
        elif joint >= 0:
            theta = _joint_text(model, joint, theta, slides=False)
        parts += [f"alpha: {alpha}", f"a: {a}", f"d: {d}", f"theta: {theta}"]
    for link in np.flatnonzero(model.link_frame == i):
        base, tip = (number(x) for x in model.link_radius[link])
        radius = base if base == tip else f"[{base}, {tip}]"
        parts.append(f"link: {{length: {number(model.link_length[link])}, radius: {radius}}}")
    return "{" + ", ".join(parts) + "}"


def _joint_text(model: Model, joint: int, offset: str, slides: bool) -> str:
    name, (low, high) = model.joint_names[joint], model.limits[joint]
    parts = [f"joint: {name}"] + ([] if offset == "0" else [f"offset: {offset}"])
    if math.isfinite(low) != math.isfinite(high):
        raise ValueError(f"model: limits of joint '{name}' are [{low}, {high}]; two finite ones or none are wanted")
    if math.isfinite(low):
        low, high = (low, high) if slides else (_degrees(low), _degrees(high))
        parts.append(f"limits: [{number(low)}, {number(high)}]")
    return "{" + ", ".join(parts) + "}"


def _coupling_text(model: Model, joint: int) -> str:
    """The one independent joint that this joint follows, in file units."""
    slides = np.zeros(len(model.joint_names), dtype=bool)
    slides[model.joint[model.joint >= 0]] = model.prismatic[model.joint >= 0]
    column = int(np.argmax(model.coupling[joint] != 0))
    of = int(model.free[column])
    ratio, offset = float(model.coupling[joint, column]), float(model.coupling_offset[joint])
    if slides[joint] != slides[of]:
        ratio *= math.radians(1.0) if slides[joint] else math.degrees(1.0)
    offset = offset if slides[joint] else _degrees(offset)
    parts = [f"joint: {model.joint_names[joint]}", f"of: {model.joint_names[of]}", f"ratio: {number(_neat(ratio))}"]
    return "{" + ", ".join(parts + ([f"offset: {number(offset)}"] if offset else [])) + "}"
