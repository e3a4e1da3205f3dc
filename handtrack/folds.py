"""A posed model in, the poses with a link folded to the other side of the image plane out.

A link whose axis makes the angle `phi` with the image plane has the same outline at `-phi`: exactly in an orthographic
view, nearly so in perspective (a mirror along the line of sight changes no projection). The same holds for a link
together with those beyond it, whose chord then makes the angle. A joint can only turn them into such a place if its
axis lies near the image plane too, or if two joints move the link. So candidates are solved for,

    min |outline(u') - outline(u)|      over the joints of the link and of those beyond it,

from a start on the other side, and kept if the outline is the same and the joints can go there. Where along its axis a
link ends in the next is no part of the outline: bones of a finger may shorten and lengthen in turns.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .camera import Camera, camera_from_world
from .kinematics import forward, link_ends, pose_from_free
from .pills import Pills
from .profiles import place_outline
from .residuals import Chain, OutlineFeatures, in_world, outline_residuals
from .solve import solve

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
    off = outline_residuals(on, features, other)[0]
    return other if np.sqrt(np.mean(off**2)) < _CLOSE_SAME else None


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
    # The sum of the joints' sigmas is more than any link's angle can have: most frames end here.
    sigma_q = np.sqrt((model.coupling @ covariance * model.coupling).sum(axis=1))
    reach = _PLAUSIBLE * (on.moves[model.link_frame] @ np.where(model.prismatic[on.joint_frame], 0.0, sigma_q))
    if not (reach > _CLOSE).any():
        return
    frames = forward(model, pose_from_free(model, u))
    base, tip = (camera_from_world(on.camera, end) for end in link_ends(model, frames))
    z = np.where(model.prismatic[on.joint_frame, None], 0.0, frames[on.joint_frame, :3, 2]) @ on.camera.R.T
    moves = on.moves[model.link_frame]
    outline: OutlineFeatures | None = None
    # Each link with those beyond it, up to the end of its finger, then each by itself.
    for end, far in ((_far_end(on, tip), True), (tip, False)):
        angle = depth_angles(on.camera, base, end)
        size = np.abs(2.0 * angle)
        near = (size < 2.0 * NEAR) & (size > _CLOSE) & (size < reach) & ((end != tip).any(axis=1) | (not far))
        if not near.any():
            continue
        deeper, sideways = _slopes(on, z, moves, base, end)
        spread = np.sqrt(np.maximum((deeper @ covariance * deeper).sum(axis=1), 0.0))
        for link in np.flatnonzero(near & (size < _PLAUSIBLE * spread)).tolist():
            variable, inside = _variables(on, link)
            own = variable & (moves[link].astype(float) @ (model.coupling != 0.0) > 0.0)
            if not own.any():
                continue
            outline = _outline(on, base, tip) if outline is None else outline
            turn = np.linalg.lstsq(
                np.stack([deeper[link], sideways[link]])[:, own], [-2.0 * angle[link], 0.0], rcond=0.05
            )[0]
            start = u.copy()
            start[own] += turn
            yield start, variable, _part(outline, inside)
            if not far and inside.sum() > 1:  # those beyond keep their direction
                wanted = np.where(np.arange(angle.size) == link, -2.0 * angle, 0.0)[inside]
                start = u.copy()
                start[variable] += np.linalg.lstsq(deeper[np.ix_(inside, variable)], wanted, rcond=0.05)[0]
                yield start, variable, _part(outline, inside)


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
    flat = _cross(axis, sight)
    flat = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    return (flat @ z.T * moves) @ on.model.coupling, (_cross(axis, flat) @ z.T * moves) @ on.model.coupling


def _cross(a: Float[np.ndarray, "l 3"], b: Float[np.ndarray, "l 3"]) -> Float[np.ndarray, "l 3"]:
    """`np.cross`, which takes longer to see what it was given than to multiply."""
    x, y = a[:, [1, 2, 0]], b[:, [1, 2, 0]]
    return (a * y - x * b)[:, [1, 2, 0]]


def _far_end(on: Chain, tip: Float[np.ndarray, "l 3"]) -> Float[np.ndarray, "l 3"]:
    """Tip of the finger that each link leads to: of the last link beyond it."""
    out = tip.copy()
    parent = on.model.link_parent
    for link in range(tip.shape[0] - 1, -1, -1):  # parents come before their children
        if parent[link] >= 0:
            out[parent[link]] = out[link]
    return out


def _variables(on: Chain, link: int) -> tuple[Bool[np.ndarray, " k"], Bool[np.ndarray, " l"]]:
    """Independent joints that move this link or those beyond it and nothing else, and these links."""
    model = on.model
    inside = np.zeros(model.link_frame.size, dtype=bool)
    inside[link] = True
    for other in range(link + 1, inside.size):
        inside[other] = model.link_parent[other] >= 0 and inside[model.link_parent[other]]
    moves = on.moves[model.link_frame].astype(float) @ (model.coupling != 0.0) > 0.0
    return moves[inside].any(axis=0) & ~moves[~inside].any(axis=0), inside


def _outline(on: Chain, base: Float[np.ndarray, "l 3"], tip: Float[np.ndarray, "l 3"]) -> OutlineFeatures:
    """Points all along the outline of the pose, one pixel sure."""
    pills = Pills(base, tip, on.model.link_radius)
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
    if not features.link.size:
        return None

    def residual(part: Float[np.ndarray, " v"]) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m v"]]:
        v = u.copy()
        v[variable] = part
        r, J = outline_residuals(on, features, v)
        return r, J[:, variable]

    limits = on.model.limits[on.model.free][variable]
    first = np.clip(start[variable], *limits.T)
    if not np.sqrt(np.mean(residual(first)[0] ** 2)) < _HOPEFUL:
        return None
    bounds = limits if np.isfinite(limits).any() else None
    found = solve(residual, first, bounds=bounds, max_steps=_STEPS, tolerance=1e-4)
    if not np.sqrt(np.mean(found.residual**2)) < _SAME:
        return None
    out = u.copy()
    out[variable] = found.x
    return out
