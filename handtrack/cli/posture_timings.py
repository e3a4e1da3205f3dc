"""A number of repeats in, times of the body's kinematics out, beside Pinocchio's in the same run where it is installed.

Pinocchio gets the same tree through its URDF and the same poses, one call of `forwardKinematics` for each; nothing is
read out of it, so that its figure is that of its C++ alone, but for some 20 ns of a Python loop.
"""

import importlib
from importlib.util import find_spec
from typing import Any

import numpy as np
from jaxtyping import Float

from ..body.posture import ROOT, Body, body_of, chain_frames_numpy, segment_frames
from ..formats.urdf import export_urdf
from .timings import Timing, median_ms

BATCH = 1200


def posture(repeats: int) -> list[Timing]:
    """Segment frames of a batch of poses of a body."""
    body = body_of(1.75)
    rng = np.random.default_rng(0)
    theta = rng.uniform(body.limits[:, 0], body.limits[:, 1], (BATCH, body.limits.shape[0]))
    q = np.concatenate([rng.normal(size=(BATCH, ROOT)), theta], axis=1)
    name = f"segment frames of a body, 26 joint values, {BATCH} poses"
    ours = median_ms(lambda: segment_frames(body, q), repeats)
    plain = median_ms(lambda: chain_frames_numpy(body.whole, q), max(3, repeats // 6))
    found = [Timing(name, ours, "NumPy twin", plain)]
    if find_spec("pinocchio") is not None:
        found.append(Timing(name, ours, "Pinocchio, not read out", _pinocchio(body, q, repeats)))
    return found


def _pinocchio(body: Body, q: Float[np.ndarray, "n 26"], repeats: int) -> float:
    """Median milliseconds for all poses."""
    library: Any = importlib.import_module("pinocchio")
    model = library.buildModelFromXML(export_urdf(body.model))
    data, forward = model.createData(), library.forwardKinematics
    poses = np.zeros((q.shape[0], model.nq))
    for values, name in zip(q.T, body.model.joint_names, strict=True):
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 1:
            poses[:, joint.idx_q] = values
        else:  # a joint without limits is a point on the circle
            poses[:, joint.idx_q], poses[:, joint.idx_q + 1] = np.cos(values), np.sin(values)
    rows = list(poses)

    def work() -> None:
        for row in rows:
            forward(model, data, row)

    return median_ms(work, repeats)
