"""All that decides one image of a dataset, drawn from a scene file and (seed, index) alone.

Motion is given by the states at this frame and at the next one; between and around them joint values run linearly and
rigid bodies turn about a fixed axis. `solids_at(shot, s)` is the scene at the share s of the frame interval: 0 is this
frame, for which the labels hold, 1 the next one, to which the flow points.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from handtrack.camera import Camera

from .bodies import Body, Rigid, joined, kind_of, points_of, solids_of
from .solids import KEYPOINTS, MOST_PARTS, Keypoints, Lights, Paint, Parts, Solids


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """How the sensor turns light into an image.

    Attributes
    ----------
    blur : float
        Share of the frame interval that the shutter is open, centred on the pixel's moment; 0 for none.
    readout : float
        Share of the frame interval from the reading of the first row to that of the last (rolling shutter), centred
        on this frame; 0 for a global shutter.
    noise : float
        Standard deviation, grey levels.
    vignette : float
        Share of the light lost in the corners.
    gain : float
        Factor on all grey levels before noise.
    """

    blur: float = 0.0
    readout: float = 0.0
    noise: float = 0.0
    vignette: float = 0.0
    gain: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One image before it is rendered.

    Attributes
    ----------
    bodies : tuple of Body
        Hands first.
    parts : Parts
        Of all bodies, in their order; from `parts_of`.
    paint : Paint
        Of all parts.
    camera : Camera
        Stands still.
    lights : Lights
    background : (h, w, 3) uint8
    exposure : Exposure
    seed, index : int
        The image's own random numbers (noise) come from these two.
    sequence, frame : int
    """

    bodies: tuple[Body, ...]
    parts: Parts
    paint: Paint
    camera: Camera
    lights: Lights
    background: UInt8[np.ndarray, "h w 3"]
    exposure: Exposure
    seed: int
    index: int
    sequence: int
    frame: int


def parts_of(bodies: Sequence[Body]) -> Parts:
    """Parts of all bodies.

    Raises
    ------
    ValueError
        If they are more than an amodal image has bits for.
    """
    names = [body.shape.part_names if not isinstance(body.shape, Rigid) else (body.shape.kind,) for body in bodies]
    count = sum(map(len, names))
    if count > MOST_PARTS:
        raise ValueError(f"bodies: have {count} parts; wanted at most {MOST_PARTS}")
    instance = np.repeat(np.arange(len(bodies)), [len(own) for own in names])
    return Parts(tuple(name for own in names for name in own), instance, tuple(kind_of(body.shape) for body in bodies))


def solids_at(shot: Shot, s: float) -> Solids:
    """Surfaces at the share s of the frame interval, camera axes."""
    first = _first_parts(shot)
    return joined([solids_of(body, s, shot.camera, k) for body, k in zip(shot.bodies, first, strict=True)])


def keypoints_at(shot: Shot, s: float) -> Keypoints:
    """Keypoints of all hands at the share s of the frame interval, camera axes."""
    each = [
        points_of(body, s, shot.camera, k)
        for body, k in zip(shot.bodies, _first_parts(shot), strict=True)
        if not isinstance(body.shape, Rigid)
    ]
    p_cam = np.concatenate([points.p_cam for points in each] or [np.zeros((0, len(KEYPOINTS), 3))])
    own = np.concatenate([points.own for points in each] or [np.zeros((0, len(KEYPOINTS)), np.uint64)])
    return Keypoints(p_cam, own)


def joints_of(shot: Shot) -> tuple[tuple[tuple[str, ...], ...], tuple[Float[np.ndarray, " j"], ...]]:
    """Joint names and values (radians, this frame) of each hand."""
    hands = [body for body in shot.bodies if not isinstance(body.shape, Rigid)]
    names = tuple(body.shape.model.joint_names for body in hands if not isinstance(body.shape, Rigid))
    return names, tuple(body.q[0] for body in hands)


def _first_parts(shot: Shot) -> list[int]:
    """Number of the first part of each body."""
    return np.searchsorted(shot.parts.instance, np.arange(len(shot.bodies))).tolist()
