"""Particles in, those that cannot be out: what is known of where a wrist may be.

The tests of the wrist thesis, in its order (section 6.3.1); a particle that fails one is not looked at by the next:

* collision: the way from the elbow to the particle, and a bit beyond, meets the room;
* joint volume: the arm would leave its plane or its range (section 6.2.1);
* skeletal shell: the particle is not a forearm away from the elbow (section 2.3.1);
* depth map, in open loop only: the camera sees something behind the particle, so it would have seen the wrist
  (section 2.3.2). A pixel without a reading takes the nearest one, only where asked.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from .. import _kernels
from ..camera import Camera, project_camera
from .environment import RayCaster as RayCaster

TESTS = ("collision", "joint_volume", "shell", "depth")


@dataclass(frozen=True, slots=True)
class Room:
    """The collision test.

    Attributes
    ----------
    caster : RayCaster
    start : float
        Metres from the elbow at which rays begin: nearer surfaces are within its own error.
    clearance : float
        Metres that the middle of a wrist keeps from a surface, straight ahead.
    """

    caster: RayCaster
    start: float = 0.03
    clearance: float = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class JointVolume:
    """Where the forearm can point, given the upper arm (wrist thesis, section 6.2.1).

    Attributes
    ----------
    upper : (3,)
        Unit vector from shoulder to elbow.
    normal : (3,)
        Unit normal of the arm's plane, `upper x forearm`, across `upper`.
    elbow : (float, float)
        Least and greatest angle inside the elbow, radians; pi is straight.
    half_thickness : float
        Radians by which the forearm may leave the plane.
    """

    upper: Float[np.ndarray, " 3"]
    normal: Float[np.ndarray, " 3"]
    elbow: tuple[float, float]
    half_thickness: float


@dataclass(frozen=True, slots=True)
class Shell:
    """Distances between a joint and its father that are allowed, metres.

    Within them all are equally likely, as in the thesis, or normally distributed about their middle with `sigma`.
    """

    least: float
    greatest: float
    sigma: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class DepthMap:
    """The depth test.

    Attributes
    ----------
    depth : (h, w)
        Metres along z, 0 where there is no reading.
    camera : Camera
    margin : float
        Metres by which a reading has to lie behind a particle, at no distance.
    noise : float
        Further metres for each square metre of depth: depth noise grows with the square.
    reach : int
        Pixels within which another reading stands for a missing one.
    along : tuple of float
        Shares of the way from the father to the particle: what the camera sees behind the middle of the limb there
        speaks against the particle too. The thesis looks at its end only.
    """

    depth: Float32[np.ndarray, "h w"]
    camera: Camera
    margin: float = 0.02
    noise: float = 0.006
    reach: int = 60
    along: tuple[float, ...] = (1.0,)


@dataclass(frozen=True, slots=True, eq=False)
class Constraints:
    """What is tested; None leaves a test out."""

    room: Room | None = None
    volume: JointVolume | None = None
    shell: Shell | None = None
    depth: DepthMap | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Survivors:
    """Which particles live, and how many each of `TESTS` killed."""

    alive: Bool[np.ndarray, " n"]
    kills: Int[np.ndarray, " 4"]


def survivors(
    p: Float[np.ndarray, "n 3"],
    father: Float[np.ndarray, "*n 3"] | None,
    tests: Constraints,
    alive: Bool[np.ndarray, " n"] | None = None,
) -> Survivors:
    """Put particles through all tests, in their order.

    Parameters
    ----------
    p : (n, 3)
        Metres, camera axes.
    father : (3,), (n, 3) or None
        The joint before, for a wrist the elbow, one for all or one each; without one only the depth map is asked.
    alive : (n,), optional
        Particles to be tested; all if not given.
    """
    kills = np.zeros(len(TESTS), int)
    root = None if father is None else _each(father, p)
    p = np.ascontiguousarray(p)
    at = None if alive is None or alive.all() else np.flatnonzero(alive)  # None: all
    for k, test in enumerate(_tests(root is not None, tests)):
        if test is None or (p.shape[0] if at is None else at.size) == 0:
            continue
        q = p if at is None else p[at]
        dead = test(q, q if root is None else root if at is None else root[at])
        kills[k] = np.count_nonzero(dead)
        if kills[k]:
            at = np.flatnonzero(~dead) if at is None else at[~dead]
    left = np.full(p.shape[0], at is None)
    if at is not None:
        left[at] = True
    return Survivors(left, kills)


def _each(father: Float[np.ndarray, "*n 3"], p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """A father for each particle."""
    if father.ndim == 2:
        return np.ascontiguousarray(father)
    out = np.empty(p.shape)
    out[:] = father
    return out


def _tests(rooted: bool, tests: Constraints):
    """Functions that say which particles fail, in the order of `TESTS`; None for those left out."""
    room, volume, shell, depth = tests.room, tests.volume, tests.shell, tests.depth
    return (
        None if room is None or not rooted else lambda p, root: collides(p, root, room),
        None if volume is None or not rooted else lambda p, root: outside_volume(p, root, volume),
        None if shell is None or not rooted else lambda p, root: outside_shell(p, root, shell),
        None if depth is None else lambda p, root: contradicted(p, root if rooted else None, depth),
    )


def collides(p: Float[np.ndarray, "n 3"], father: Float[np.ndarray, "*n 3"], room: Room) -> Bool[np.ndarray, " n"]:
    """Whether the way from the father, and `clearance` beyond, meets the room."""
    origin, vector = _kernels.limb_rays(p, _each(father, p), room.start, room.clearance)
    return room.caster.hits(origin, vector) <= 1.0


def limb_rays_numpy(
    p: Float[np.ndarray, "n 3"], father: Float[np.ndarray, "n 3"], start: float, beyond: float
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Twin of the compiled rays along limbs."""
    way = p - father
    length = np.linalg.norm(way, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = np.where(length > 0, way / length, 0.0)
    return father + start * unit, (np.maximum(length - start, 0.0) + beyond) * unit


def outside_volume(
    p: Float[np.ndarray, "n 3"], father: Float[np.ndarray, "*n 3"], volume: JointVolume
) -> Bool[np.ndarray, " n"]:
    """Whether forearms (elbow to wrist) leave the arm's plane by more than allowed, or bend the elbow too far.

    A nearly straight forearm may be on the far side of the upper arm by the same angle.
    """
    return _kernels.outside_wedge(p, _each(father, p), *_wedge(volume))


def _wedge(volume: JointVolume) -> tuple[Float[np.ndarray, "3 3"], float, float, float]:
    """Normal, inner direction and upper arm; sine of the half-thickness; cosines of the elbow's range."""
    axes = np.stack([volume.normal, np.cross(volume.normal, volume.upper), volume.upper])
    most = math.sin(min(volume.half_thickness, 0.5 * math.pi))
    return axes, most, math.cos(volume.elbow[0]), math.cos(volume.elbow[1])


def outside_volume_numpy(
    p: Float[np.ndarray, "n 3"],
    father: Float[np.ndarray, "n 3"],
    axes: Float[np.ndarray, "3 3"],
    most: float,
    least_bend: float,
    most_bend: float,
) -> Bool[np.ndarray, " n"]:
    """Twin of the compiled test of the joint volume."""
    fore = p - father
    off, inner, along = axes @ fore.T / np.maximum(np.linalg.norm(fore, axis=1), 1e-12)
    return (np.abs(off) > most) | (inner < -most) | (-along > least_bend) | (-along < most_bend)


def outside_shell(
    p: Float[np.ndarray, "n 3"], father: Float[np.ndarray, "*n 3"], shell: Shell
) -> Bool[np.ndarray, " n"]:
    """Whether distances from the father are beyond the shell's."""
    length = _kernels.limb_lengths(p, _each(father, p))
    return (length < shell.least) | (length > shell.greatest)


def shell_weight(
    p: Float[np.ndarray, "n 3"], father: Float[np.ndarray, "*n 3"] | None, shell: Shell | None
) -> Float[np.ndarray, " n"] | float:
    """Logarithm of the likelihood of distances from the father; zero for a shell with hard edges only."""
    if father is None or shell is None or shell.sigma is None:
        return 0.0
    length = _kernels.limb_lengths(np.ascontiguousarray(p), _each(father, p))
    return -0.5 * ((length - 0.5 * (shell.least + shell.greatest)) / shell.sigma) ** 2


def contradicted(
    p: Float[np.ndarray, "n 3"], father: Float[np.ndarray, "n 3"] | None, depth: DepthMap
) -> Bool[np.ndarray, " n"]:
    """Whether the camera sees something behind a particle, or behind the limb that leads to it.

    Off the image, or without any reading near, nothing speaks.
    """
    shares = np.array(depth.along if father is not None else (1.0,))
    camera = depth.camera
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    return _kernels.seen_through(
        depth.depth, p, p if father is None else father, shares, lens, camera.distortion,
        camera.kind == "perspective", depth.margin, depth.noise, depth.reach,
    )  # fmt: skip


def seen_through_numpy(
    p: Float[np.ndarray, "n 3"], father: Float[np.ndarray, "n 3"], depth: DepthMap
) -> Bool[np.ndarray, " n"]:
    """Twin of the compiled look along limbs."""
    limb = father[:, None] + np.array(depth.along)[:, None] * (p - father)[:, None]
    uv, z = project_camera(depth.camera, limb), limb[..., 2]
    height, width = depth.depth.shape
    with np.errstate(invalid="ignore"):
        place = np.rint(uv)
        on = np.all((place >= 0) & (place < (width, height)), axis=-1)
    column, row = np.moveaxis(np.where(on[..., None], place, 0.0).astype(np.int64), -1, 0)
    reading = nearest_readings_numpy(depth.depth, row.ravel(), column.ravel(), depth.reach).reshape(z.shape)
    return np.any(on & (reading.astype(float) > z + depth.margin + depth.noise * z * z), axis=1)


def nearest_readings_numpy(
    depth: Float32[np.ndarray, "h w"], row: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"], reach: int
) -> Float32[np.ndarray, " n"]:
    """Twin of the compiled search: every reading is looked at for every pixel."""
    out = depth[row, column].copy()
    y, x = np.nonzero(depth)
    for i in np.flatnonzero(out == 0):
        far = (y - row[i]) ** 2 + (x - column[i]) ** 2
        if far.size and far.min() <= reach * reach:
            best = int(np.argmin(far))
            out[i] = depth[y[best], x[best]]
    return out


def volume_at(
    upper: Float[np.ndarray, " 3"],
    normal: Float[np.ndarray, " 3"],
    elbow: tuple[float, float],
    half_thickness: float,
) -> JointVolume:
    """The joint volume of an upper arm, its normal set across the arm again."""
    upper = upper / np.linalg.norm(upper)
    across = normal - (normal @ upper) * upper
    return JointVolume(upper, across / np.linalg.norm(across), elbow, half_thickness)


def plane_normal(
    upper: Float[np.ndarray, " 3"], fore: Float[np.ndarray, " 3"], least: float = 0.25
) -> Float[np.ndarray, " 3"] | None:
    """Unit normal of the plane of an arm; None where it is so straight (sine below `least`) that noise decides."""
    normal = np.cross(upper, fore)
    size = float(np.linalg.norm(normal))
    reach = float(np.linalg.norm(upper) * np.linalg.norm(fore))
    return None if size <= least * reach or size == 0.0 else normal / size


def carried(
    v: Float[np.ndarray, "*n 3"], before: Float[np.ndarray, " 3"], after: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Vectors turned by the least rotation that takes one direction to another.

    Opposite directions have no least rotation: vectors stay as they are.

    >>> carried(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 2.0])).round(9).tolist()
    [-1.0, 0.0, 0.0]
    """
    a, b = before / np.linalg.norm(before), after / np.linalg.norm(after)
    axis, cosine = np.cross(a, b), float(a @ b)
    if cosine < -1.0 + 1e-9:
        return v
    return cosine * v + np.cross(axis, v) + (v @ axis)[..., None] * axis / (1.0 + cosine)
