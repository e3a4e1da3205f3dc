"""A posed model in, the poses with a link folded to the other side of the image plane out.

A link whose axis makes the angle `phi` with the image plane has the same outline at `-phi`: exactly in an orthographic
view, nearly so in perspective (a mirror along the line of sight changes no projection). The same holds for a link
together with those beyond it, whose chord then makes the angle. A joint can only turn them into such a place if its
axis lies near the image plane too, or if two joints move the link. So candidates are solved for,

    min |outline(u') - outline(u)|      over the joints of the link and of those beyond it,

from a start on the other side, and kept if the outline is the same and the joints can go there. Where along its axis a
link ends in the next is no part of the outline: bones of a finger may shorten and lengthen in turns.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from . import _kernels
from .camera import Camera
from .kinematics import Model
from .measure import posed_with_frames
from .pills import Pills
from .profiles import place_outline
from .residuals import Chain, OutlineFeatures, in_world, outline_residuals

NEAR = np.radians(25.0)  # largest angle with the image plane
_APART = np.radians(2.5)  # folds closer than this are not followed apart
_CLOSE = np.radians(1.0)  # folds closer than this do not matter
_PLAUSIBLE = 3.0  # sigmas between a pose and its fold
_DISTINCT = 2.0  # sigmas of the fitted pose between two poses
_SAME = 0.6  # pixels that may lie between the outlines, root mean square
_CLOSE_SAME = 0.15
_HOPEFUL = 2.5  # pixels between the outlines from which a solution is sought
_SPACING = 12.0
_MOST = 3
_STEPS = 10
_NOT_ROBUST = 1e3  # pixels: a scale at which no distance is an outlier
_HELD = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class Folds:
    """Poses that look the same as a given one.

    Attributes
    ----------
    poses : (m, k)
        Apart by four degrees or more at some joint, the most plausible first.
    close : (p, k)
        Displacements to those nearer by: too near to be followed apart, too far for a covariance of first order.
    """

    poses: Float[np.ndarray, "m k"]
    close: Float[np.ndarray, "p k"]


def fold_candidates(
    on: Chain,
    u: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "k k"],
    fitted: Float[np.ndarray, "k k"] | None = None,
) -> Float[np.ndarray, "m k"]:
    """Poses that look the same with a link folded to the other side of the image plane: `find_folds(...).poses`.

    Examples
    --------
    >>> from handtrack.camera import orthographic
    >>> from handtrack.kinematics.builtin import model
    >>> from handtrack.residuals import chain
    >>> edge_on = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # the finger bends in depth
    >>> on = chain(model("r"), orthographic(64, 64, 10.0, 5.0, 32.0, edge_on, np.zeros(3)))
    >>> np.degrees(fold_candidates(on, np.radians([6.0]), np.eye(1) * 0.04)).round(3).tolist()
    [[-6.0]]
    """
    return find_folds(on, u, covariance, fitted).poses


def find_folds(
    on: Chain,
    u: Float[np.ndarray, " k"],
    covariance: Float[np.ndarray, "k k"],
    fitted: Float[np.ndarray, "k k"] | None = None,
) -> Folds:
    """Poses that look the same with a link, or a link and those beyond it, folded to the other side.

    Parameters
    ----------
    u : (k,)
        Independent joints.
    covariance : (k, k)
        How far off the pose may be, as predicted before the image was looked at: a fold is real if it lies within three
        standard deviations.
    fitted : (k, k), optional
        Covariance with the image: a fold within two of its standard deviations is no pose apart.

    Returns
    -------
    Folds
        At most three poses and a close fold of each finger, all inside the joint limits.
    """
    found: list[Float[np.ndarray, " k"]] = []
    distances: list[float] = []
    close: list[Float[np.ndarray, " k"]] = []
    for start, variable, features in _starts(on, u, covariance):
        near = bool(np.abs(start - u).max() < _APART)  # then the start is as good as a solution
        other = _if_the_same(on, u, start, variable, features) if near else _solved(on, u, start, variable, features)
        if other is None or np.abs(other - u).max() < 0.5 * _CLOSE:
            continue
        if np.abs(other - u).max() < _APART:
            if not any(_alike(other - u, step) for step in close):
                close.append(other - u)
            continue
        if any(np.abs(other - known).max() < 0.5 * _APART for known in found):
            continue
        distance = _distance(other - u, covariance)
        distinct = fitted is None or _distance(other - u, fitted) > _DISTINCT**2
        if distinct and distance < (_PLAUSIBLE + 1.0) ** 2:
            found.append(other)
            distances.append(distance)
    order = np.argsort(distances, kind="stable")[:_MOST]
    return Folds(np.array([found[i] for i in order]).reshape(-1, u.size), np.array(close).reshape(-1, u.size))


def _distance(step: Float[np.ndarray, " k"], covariance: Float[np.ndarray, "k k"]) -> float:
    """Squared, in standard deviations."""
    return float(step @ np.linalg.solve(covariance, step))


def _alike(a: Float[np.ndarray, " k"], b: Float[np.ndarray, " k"]) -> bool:
    return bool(abs(a @ b) > 0.7 * np.linalg.norm(a) * np.linalg.norm(b))


def _if_the_same(
    on: Chain,
    u: Float[np.ndarray, " k"],
    start: Float[np.ndarray, " k"],
    variable: Bool[np.ndarray, " k"],
    features: OutlineFeatures,
) -> Float[np.ndarray, " k"] | None:
    """The start itself, moved inside the limits, or None if the outline is another."""
    if not features.link.size:
        return None
    limits = on.model.limits[on.model.free]
    other = np.where(variable, np.clip(start, limits[:, 0], limits[:, 1]), u)
    return other if _apart(on, features, other) < _CLOSE_SAME else None


def depth_angles(
    camera: Camera, base: Float[np.ndarray, "l 3"], tip: Float[np.ndarray, "l 3"]
) -> Float[np.ndarray, " l"]:
    """Angle of each axis with the image plane, positive away from the camera; ends in camera axes.

    In perspective the plane is the one across the line of sight through the middle of the axis.
    """
    axis = tip - base
    length = np.maximum(np.linalg.norm(axis, axis=1), 1e-12)
    return np.arcsin(np.clip((axis * _sight(camera, base, tip)).sum(axis=1) / length, -1.0, 1.0))


def _sight(camera: Camera, base: Float[np.ndarray, "l 3"], tip: Float[np.ndarray, "l 3"]) -> Float[np.ndarray, "l 3"]:
    if camera.kind == "orthographic":
        return np.broadcast_to([0.0, 0.0, 1.0], base.shape)
    middle = 0.5 * (base + tip)
    return middle / np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-12)


def _starts(
    on: Chain, u: Float[np.ndarray, " k"], covariance: Float[np.ndarray, "k k"]
) -> Iterator[tuple[Float[np.ndarray, " k"], Bool[np.ndarray, " k"], OutlineFeatures]]:
    """Poses on the other side to solve from, the joints that may move, and the outline to keep."""
    model = on.model
    frames, pills = posed_with_frames(on, u)
    base, tip = pills.base, pills.tip
    outline: OutlineFeatures | None = None
    # Each link with those beyond it, up to the end of its finger, then each by itself.
    for end, far in ((tip[_far_link(model)], True), (tip, False)):
        allowed = (end != tip).any(axis=1) | (not far)
        angle, chosen, deeper, sideways = _screen(on, frames[0], base, end, allowed, covariance)
        for link in np.flatnonzero(chosen).tolist():
            variable, inside = _variables(on, link)
            own = variable & (on.moves[model.link_frame[link]].astype(float) @ (model.coupling != 0.0) > 0.0)
            if not own.any():
                continue
            outline = _outline(on, pills) if outline is None else outline
            start = u.copy()
            start[own] += least_turn(deeper[link, own], sideways[link, own], -2.0 * float(angle[link]))
            yield start, variable, _part(outline, inside)
            if not far and inside.sum() > 1:  # those beyond keep their direction
                wanted = np.where(np.arange(angle.size) == link, -2.0 * angle, 0.0)[inside]
                start = u.copy()
                start[variable] += np.linalg.lstsq(deeper[np.ix_(inside, variable)], wanted, rcond=0.05)[0]
                yield start, variable, _part(outline, inside)


_Screened = tuple[Float[np.ndarray, " l"], Bool[np.ndarray, " l"], Float[np.ndarray, "l k"], Float[np.ndarray, "l k"]]


def _screen(
    on: Chain,
    frames: Float[np.ndarray, "f 4 4"],
    base: Float[np.ndarray, "l 3"],
    end: Float[np.ndarray, "l 3"],
    allowed: Bool[np.ndarray, " l"],
    covariance: Float[np.ndarray, "k k"],
) -> _Screened:
    """Angles with the image plane, which of the allowed links may be folded, and their rows of `_slopes`."""
    model = on.model
    return _kernels.screen_folds(
        base,
        end,
        allowed,
        frames,
        on.joint_frame,
        model.prismatic[on.joint_frame],
        on.camera.R,
        on.camera.kind == "orthographic",
        on.moves[model.link_frame],
        model.coupling,
        np.ascontiguousarray(covariance),
        (NEAR, _CLOSE, _PLAUSIBLE),
    )


def screen_numpy(
    on: Chain,
    frames: Float[np.ndarray, "f 4 4"],
    base: Float[np.ndarray, "l 3"],
    end: Float[np.ndarray, "l 3"],
    allowed: Bool[np.ndarray, " l"],
    covariance: Float[np.ndarray, "k k"],
) -> _Screened:
    """The same as `_screen` in plain NumPy, with rows for every link: the twin of the compiled kernel."""
    model = on.model
    slides, moves = model.prismatic[on.joint_frame], on.moves[model.link_frame]
    sigma = np.sqrt(np.maximum((model.coupling @ covariance * model.coupling).sum(axis=1), 0.0))
    reach = _PLAUSIBLE * (moves @ np.where(slides, 0.0, sigma))
    z = np.where(slides[:, None], 0.0, frames[on.joint_frame, :3, 2]) @ on.camera.R.T
    angle = depth_angles(on.camera, base, end)
    size = np.abs(2.0 * angle)
    deeper, sideways = _slopes(on, z, moves, base, end)
    spread = np.sqrt(np.maximum((deeper @ covariance * deeper).sum(axis=1), 0.0))
    near = (size < 2.0 * NEAR) & (size > _CLOSE) & (size < reach) & (size < _PLAUSIBLE * spread)
    return angle, allowed & near, deeper, sideways


def _slopes(
    on: Chain,
    z: Float[np.ndarray, "j 3"],
    moves: Bool[np.ndarray, "l j"],
    base: Float[np.ndarray, "l 3"],
    end: Float[np.ndarray, "l 3"],
) -> tuple[Float[np.ndarray, "l k"], Float[np.ndarray, "l k"]]:
    """Derivative of the links' angle with the image plane, and of their direction in it, all joints beyond held.

    A joint with axis z turns the vector a by `z x a`, so `a . s` by `z . (a x s)`.
    """
    axis = end - base
    length = np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-12)
    axis, sight = axis / length, _sight(on.camera, base, end)
    flat = np.cross(axis, sight)
    flat = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    return (flat @ z.T * moves) @ on.model.coupling, (np.cross(axis, flat) @ z.T * moves) @ on.model.coupling


def least_turn(
    deeper: Float[np.ndarray, " v"], sideways: Float[np.ndarray, " v"], angle: float
) -> Float[np.ndarray, " v"]:
    """The smallest change x of the joints with `deeper @ x = angle` and `sideways @ x = 0`, as far as they can.

    The pseudoinverse of two rows by the eigenvectors of their 2 x 2 products; singular values below a twentieth of the
    larger one count as zero.

    >>> least_turn(np.array([1.0, 0.0]), np.array([0.0, 0.5]), 0.2).tolist()
    [0.2, 0.0]
    """
    a, b, c = float(deeper @ deeper), float(deeper @ sideways), float(sideways @ sideways)
    half, middle = math.hypot(0.5 * (a - c), b), 0.5 * (a + c)
    large, small = middle + half, middle - half
    if large <= 0.0:
        return np.zeros_like(deeper)
    turn = 0.5 * math.atan2(2.0 * b, a - c)
    x, y = math.cos(turn), math.sin(turn)  # eigenvector of the larger; the other is (-y, x)
    one, two = angle * x / large, -angle * y / small if small > 0.05**2 * large else 0.0
    return (one * x - two * y) * deeper + (one * y + two * x) * sideways


@lru_cache(maxsize=16)
def _far_link(model: Model) -> Int[np.ndarray, " l"]:
    """The last link of the finger that each link leads to."""
    out = np.arange(model.link_parent.size)
    for link in range(out.size - 1, -1, -1):  # parents come before their children
        if model.link_parent[link] >= 0:
            out[model.link_parent[link]] = out[link]
    return out


@lru_cache(maxsize=512)
def _variables(on: Chain, link: int) -> tuple[Bool[np.ndarray, " k"], Bool[np.ndarray, " l"]]:
    """Independent joints that move this link or those beyond it and nothing else, and these links."""
    model = on.model
    inside = np.zeros(model.link_frame.size, dtype=bool)
    inside[link] = True
    for other in range(link + 1, inside.size):
        inside[other] = model.link_parent[other] >= 0 and inside[model.link_parent[other]]
    moves = on.moves[model.link_frame].astype(float) @ (model.coupling != 0.0) > 0.0
    return moves[inside].any(axis=0) & ~moves[~inside].any(axis=0), inside


def _outline(on: Chain, pills: Pills) -> OutlineFeatures:
    """Points all along the outline of the pose, one pixel sure."""
    at = place_outline(pills, on.camera, on.model.link_is_tip, _SPACING)
    return OutlineFeatures(*in_world(on.camera, at.ray, at.slope), at.link, np.ones(at.link.size))


def _part(outline: OutlineFeatures, inside: Bool[np.ndarray, " l"]) -> OutlineFeatures:
    own = inside[outline.link]
    return OutlineFeatures(outline.ray[own], outline.slope[own], outline.link[own], outline.sigma[own])


def _solved(
    on: Chain,
    u: Float[np.ndarray, " k"],
    start: Float[np.ndarray, " k"],
    variable: Bool[np.ndarray, " k"],
    features: OutlineFeatures,
) -> Float[np.ndarray, " k"] | None:
    """The pose next to `start` with the outline of `u`, or None if there is none."""
    m, limits = on.model, on.model.limits[on.model.free]
    low, high = np.where(variable, limits[:, 0], u), np.where(variable, limits[:, 1], u)
    first = np.clip(start, low, high)
    if not features.link.size or not _apart(on, features, first) < _HOPEFUL:
        return None
    n = features.link.size
    found, _ = _kernels.fit_outline(
        first,
        (features.ray, features.slope, features.link, features.sigma),
        (
            *(m.parent, m.prefix, m.joint, m.prismatic, m.link_frame, m.link_base, m.link_tip, m.link_radius),
            *(on.moves, on.joint_frame),
        ),
        (m.coupling, m.coupling_offset),
        on.plain,
        (np.zeros(n), np.zeros(1), np.zeros(n, dtype=np.int64), 1.0),  # errors are independent
        _NOT_ROBUST,
        first,
        _HELD * np.eye(first.size),  # joints that no point tells stay where they start
        low,
        high,
        _STEPS,
        1e-4,
    )
    return found if _apart(on, features, found) < _SAME else None


def _apart(on: Chain, features: OutlineFeatures, u: Float[np.ndarray, " k"]) -> float:
    """Root mean square distance of the outline's points from that of another pose, pixels."""
    r = outline_residuals(on, features, u)[0]
    return math.sqrt(float(r @ r) / r.size)
