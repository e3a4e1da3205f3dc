"""A model in, URDF text out, for robot viewers and simulators.

URDF puts a joint at a constant origin and lets it turn about, or slide along, one axis: exactly a frame's `prefix` and
its z axis. Lengths become metres and exact couplings `mimic` tags; soft ones, which URDF cannot say, are left out. A
pill is drawn as a cylinder with a ball at each end (of the mean radius where it tapers: URDF has no cones).
"""

import math
import xml.etree.ElementTree as ET

import numpy as np
from jaxtyping import Float

from ..kinematics.tree import Model

METRES = {"mm": 0.001, "m": 1.0}
UNLIMITED = 1e9  # a prismatic joint must have limits in URDF


def export_urdf(model: Model) -> str:
    """URDF of the model; link `frame_0` is the base frame.

    >>> from handtrack.kinematics.builtin import model
    >>> export_urdf(model("r")).splitlines()[1]
    '<robot name="r">'
    """
    scale = METRES.get(model.units, 1.0)
    robot = ET.Element("robot", name=model.name)
    ET.SubElement(robot, "link", name="frame_0")
    for i, number in enumerate(model.frame_ids):
        body = ET.SubElement(robot, "link", name=f"frame_{number}")
        for link in np.flatnonzero(model.link_frame == i):
            ends = scale * model.link_base[link], scale * model.link_tip[link]
            _add_pill(body, *ends, scale * model.link_radius[link])
        _add_joint(robot, model, i, scale)
    ET.indent(robot)
    return '<?xml version="1.0"?>\n' + ET.tostring(robot, encoding="unicode") + "\n"


def _add_joint(robot: ET.Element, model: Model, i: int, scale: float) -> None:
    index, number = int(model.joint[i]), model.frame_ids[i]
    # a hyphen keeps the names of fixed joints apart from those of the model's joints
    name, kind = (f"fixed-{number}", "fixed") if index < 0 else (model.joint_names[index], "revolute")
    joint = ET.SubElement(robot, "joint", name=name)
    parent = model.frame_ids[model.parent[i]] if model.parent[i] >= 0 else 0
    ET.SubElement(joint, "parent", link=f"frame_{parent}")
    ET.SubElement(joint, "child", link=f"frame_{number}")
    ET.SubElement(
        joint, "origin", xyz=_text(scale * model.prefix[i, :3, 3]), rpy=_text(roll_pitch_yaw(model.prefix[i, :3, :3]))
    )
    if index >= 0:
        kind = _add_motion(joint, model, index, bool(model.prismatic[i]), scale)
    joint.set("type", kind)


def _add_motion(joint: ET.Element, model: Model, index: int, slides: bool, scale: float) -> str:
    """Axis, limits and mimic of a moving joint; returns its type."""
    ET.SubElement(joint, "axis", xyz="0 0 1")
    unit = scale if slides else 1.0
    low, high = (float(limit) for limit in unit * model.limits[index])
    if slides or (math.isfinite(low) and math.isfinite(high)):
        low, high = max(low, -UNLIMITED), min(high, UNLIMITED)
        ET.SubElement(joint, "limit", lower=repr(low), upper=repr(high), effort="1", velocity="10")
        kind = "prismatic" if slides else "revolute"
    else:
        kind = "continuous"
    if index not in model.free:
        column = int(np.argmax(model.coupling[index] != 0))
        of = int(model.free[column])
        of_unit = scale if bool(model.prismatic[model.joint == of].any()) else 1.0
        multiplier = float(model.coupling[index, column]) * unit / of_unit
        offset = float(model.coupling_offset[index]) * unit
        ET.SubElement(joint, "mimic", joint=model.joint_names[of], multiplier=repr(multiplier), offset=repr(offset))
    return kind


def _add_pill(
    body: ET.Element, base: Float[np.ndarray, " 3"], tip: Float[np.ndarray, " 3"], radius: Float[np.ndarray, " 2"]
) -> None:
    """Cylinder from base to tip (URDF's lie along z) and two balls, to be seen and to collide."""
    x, y, z = (float(part) for part in tip - base)
    turn = [0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x)]
    for use in ("visual", "collision"):
        tube = ET.SubElement(body, use)
        ET.SubElement(tube, "origin", xyz=_text(0.5 * (base + tip)), rpy=_text(turn))
        shape = ET.SubElement(tube, "geometry")
        length = math.hypot(x, y, z)
        ET.SubElement(shape, "cylinder", length=repr(length), radius=repr(float(radius.mean())))
        for end, r in ((base, radius[0]), (tip, radius[1])):
            ball = ET.SubElement(body, use)
            ET.SubElement(ball, "origin", xyz=_text(end), rpy="0 0 0")
            ET.SubElement(ET.SubElement(ball, "geometry"), "sphere", radius=repr(float(r)))


def roll_pitch_yaw(R: Float[np.ndarray, "3 3"]) -> tuple[float, float, float]:
    """Angles with `R = Rz(yaw) Ry(pitch) Rx(roll)`; roll is 0 where pitch is +-90 degrees.

    >>> roll_pitch_yaw(np.eye(3))
    (0.0, 0.0, 0.0)
    """
    across = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(0.0 - R[2, 0], across)  # never minus zero
    if across < 1e-12:
        return 0.0, pitch, math.atan2(-R[0, 1], R[1, 1])
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def _text(values: object) -> str:
    return " ".join(repr(float(x) + 0.0) for x in np.asarray(values, dtype=float))
