"""A model in, the text of `model.yaml` out, so that reading it gives the same model.

A model keeps one constant transform for each frame; its Denavit-Hartenberg parameters are read off it by inverting eq.
(2.1) of the hand thesis: `theta = atan2(-T01, T00)`, `alpha = atan2(-T12, T22)`, `a = T03`,
`d = -sin(alpha) T13 + cos(alpha) T23`. A fixed transform that is not of that form (`T02 != 0`) is written as a matrix.
"""

import json
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..kinematics.couplings import Coupling
from ..kinematics.tree import LinkSigmas, Model, link_transform
from .writing import write_text

TOLERANCE = 1e-13  # of a transform read back, against its own size


def write_model(path: Path | str, model: Model) -> None:
    """Write a model file, whole or not at all.

    The tree, names, units, lengths, radii, offset ends and their sigmas come back bit for bit, transforms, limits and
    couplings to rounding (1e-13): angles pass through degrees. A coupling of a coupling comes back as one on the
    independent joint, the same map; soft couplings come back as they were given.

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
    couplings = [*exact_couplings(model), *model.soft_couplings]
    if couplings:
        lines += ["couplings:", *(f"  - {_coupling_text(model, coupling)}" for coupling in couplings)]
    if model.shape_factor is not None:
        rows = (_list(row[: i + 1]) for i, row in enumerate(model.shape_factor))
        lines += ["shape_factor:", *(f"  - {row}" for row in rows)]
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
        parts.append(f"link: {_link_text(model, int(link))}")
    return "{" + ", ".join(parts) + "}"


def _link_text(model: Model, link: int) -> str:
    """A pill; offsets and sigmas only where there are any."""
    length = float(model.link_length[link])
    parts = [f"length: {number(length)}", f"radius: {_radius_text(model.link_radius[link])}"]
    base, tip = link_offsets(model, link)
    parts += [f"base_offset: {_list(base)}"] if any(base) else []
    parts += [f"tip_offset: {_list(tip)}"] if any(tip) else []
    if model.link_buried is not None and model.link_buried[link]:
        parts.append(f"buried: {number(model.link_buried[link])}")
    sigmas = model.link_sigmas[link]
    return "{" + ", ".join(parts + ([] if sigmas is None else [f"sigmas: {_sigmas_text(sigmas)}"])) + "}"


def link_offsets(model: Model, link: int) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """What is added to the ends (0, 0, 0) and (length, 0, 0) of a link, in the form that gives the same ends again."""
    length, tip = float(model.link_length[link]), [float(x) for x in model.link_tip[link]]
    along = tip[0] - length
    short = round(along, 12)  # 0.1 rather than 0.10000000000000142
    base = [float(x) for x in model.link_base[link]]
    return (base[0], base[1], base[2]), (short if length + short == tip[0] else along, tip[1], tip[2])


def _sigmas_text(sigmas: LinkSigmas) -> str:
    parts = [f"length: {number(sigmas.length)}"] if sigmas.length else []
    parts += [f"radius: {_radius_text(sigmas.radius)}"] if any(sigmas.radius) else []
    parts += [f"base_offset: {_list(sigmas.base_offset)}"] if any(sigmas.base_offset) else []
    parts += [f"tip_offset: {_list(sigmas.tip_offset)}"] if any(sigmas.tip_offset) else []
    return "{" + ", ".join(parts) + "}"


def _radius_text(radius: Iterable[float]) -> str:
    base, tip = (number(x) for x in radius)
    return base if base == tip else f"[{base}, {tip}]"


def _list(values: Iterable[float]) -> str:
    return "[" + ", ".join(number(x) for x in values) + "]"


def _joint_text(model: Model, joint: int, offset: str, slides: bool) -> str:
    name, (low, high) = model.joint_names[joint], model.limits[joint]
    parts = [f"joint: {name}"] + ([] if offset == "0" else [f"offset: {offset}"])
    if math.isfinite(low) != math.isfinite(high):
        raise ValueError(f"model: limits of joint '{name}' are [{low}, {high}]; two finite ones or none are wanted")
    if math.isfinite(low):
        low, high = (low, high) if slides else (_degrees(low), _degrees(high))
        parts.append(f"limits: [{number(low)}, {number(high)}]")
    return "{" + ", ".join(parts) + "}"


def exact_couplings(model: Model) -> tuple[Coupling, ...]:
    """The one independent joint that each dependent joint follows, in radians and model units."""
    found = []
    for joint, name in enumerate(model.joint_names):
        if joint not in model.free:
            column = int(np.argmax(model.coupling[joint] != 0))
            of = model.joint_names[int(model.free[column])]
            ratio, offset = float(model.coupling[joint, column]), float(model.coupling_offset[joint])
            found.append(Coupling(name, of, ratio, offset))
    return tuple(found)


def in_file_units(model: Model, coupling: Coupling) -> Coupling:
    """A coupling in degrees and model units."""
    slides = {model.joint_names[joint]: bool(model.prismatic[i]) for i, joint in enumerate(model.joint) if joint >= 0}
    ratio, offset, sigma = coupling.ratio, coupling.offset, coupling.sigma
    if slides[coupling.joint] != slides[coupling.of]:
        ratio *= math.radians(1.0) if slides[coupling.joint] else math.degrees(1.0)
    if not slides[coupling.joint]:
        offset, sigma = _degrees(offset), None if sigma is None else _degrees(sigma)
    return Coupling(coupling.joint, coupling.of, _neat(ratio), offset, sigma)


def _coupling_text(model: Model, coupling: Coupling) -> str:
    given = in_file_units(model, coupling)
    parts = [f"joint: {given.joint}", f"of: {given.of}", f"ratio: {number(given.ratio)}"]
    parts += [f"offset: {number(given.offset)}"] if given.offset else []
    parts += [f"sigma: {number(given.sigma)}"] if given.sigma is not None else []
    return "{" + ", ".join(parts) + "}"
