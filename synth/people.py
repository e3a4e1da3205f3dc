"""Posture parameters in, keypoints and capsules of a person out; and the arm's joint angles with their limits.

The cell's frame: x to the person's right, y forward, z up, metres. Segment lengths are shares of the stature (Winter,
Biomechanics and Motor Control of Human Movement, Figure 4.1). An arm is placed by its wrist and by its swivel, the
angle of the elbow about the line from shoulder to wrist: with D the distance of wrist and shoulder and n its direction,

    E = S + a n + rho (cos(swivel) e1 + sin(swivel) e2),  a = (L1^2 - L2^2 + D^2) / (2 D),  rho^2 = L1^2 - a^2,

where e1 points down (back for a hanging arm) and e2 outward. The joint angles and their limits are those of the wrist
thesis, 6.2.1: abduction alpha1, flexion alpha2, rotation of the upper arm alpha3, inner angle of the elbow alpha4.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from handtrack.formats.skeletons import KEYPOINTS
from handtrack.pills import Pills

# The thesis prints 160 degrees for alpha3's upper limit at rest; Lenarcic and Umek (1994), whom it cites, have 60.
ALPHA3_HIGH = 60.0

LEFT, RIGHT = 0, 1  # of arms, and of every pair of keypoints
SIDES = ("left", "right")
PARTS = (
    "left_trunk", "right_trunk", "girdle", "neck", "head", "left_upper_arm", "right_upper_arm", "left_forearm",
    "right_forearm", "left_hand", "right_hand", "left_thigh", "right_thigh", "left_shin", "right_shin",
)  # fmt: skip

# Parts whose surface shows that a keypoint is seen.
_SHOWN_BY = {
    "shoulder": ("upper_arm", "trunk", "girdle"),
    "elbow": ("upper_arm", "forearm"),
    "wrist": ("forearm", "hand"),
    "hip": ("trunk", "thigh"),
    "knee": ("thigh", "shin"),
    "ankle": ("shin",),
    "root": ("left_trunk", "right_trunk"),
    "mid_hip": ("left_trunk", "right_trunk", "left_thigh", "right_thigh"),
    "mid_shoulder": ("girdle", "neck", "left_trunk", "right_trunk"),
    "head": ("head", "neck"),
}


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Lengths and radii of a person's segments, metres; widths are half widths."""

    shoulder: float
    hip: float
    hip_height: float
    trunk: float
    neck: float
    upper_arm: float
    forearm: float
    hand: float
    thigh: float
    shin: float
    radius: Float[np.ndarray, "parts 2"]

    @property
    def arm(self) -> float:
        """Length from shoulder to wrist."""
        return self.upper_arm + self.forearm


@dataclass(frozen=True, slots=True, eq=False)
class Posture:
    """Where a person stands and reaches, frame by frame, in the cell's frame; angles in radians.

    Attributes
    ----------
    pelvis : (f, 3)
        Middle of the hips.
    lean, twist : (f,)
        Of the trunk, forward and to the left.
    wrist : (f, 2, 3)
        Left and right.
    swivel : (f, 2)
        Of the elbows; 0 hangs down, positive is outward.
    """

    pelvis: Float[np.ndarray, "f 3"]
    lean: Float[np.ndarray, " f"]
    twist: Float[np.ndarray, " f"]
    wrist: Float[np.ndarray, "f 2 3"]
    swivel: Float[np.ndarray, "f 2"]

    def cut(self, frames: int) -> "Posture":
        """The first frames of it."""
        columns = (self.pelvis, self.lean, self.twist, self.wrist, self.swivel)
        return Posture(*(column[:frames] for column in columns))


def body_of(stature: float) -> Body:
    """A body of average proportions.

    >>> body = body_of(1.75)
    >>> round(body.upper_arm, 3), round(body.forearm, 3)
    (0.326, 0.256)
    """
    if not 1.2 <= stature <= 2.3:
        raise ValueError(f"stature: {stature} m; wanted 1.2 to 2.3")
    h = stature
    pairs = ((0.072, 0.062), (0.037, 0.037), (0.030, 0.030), (0.052, 0.055), (0.027, 0.024), (0.023, 0.018))
    trunk, girdle, neck, head, upper, fore = pairs
    lower = ((0.020, 0.015), (0.045, 0.034), (0.033, 0.024))
    each = [trunk, trunk, girdle, neck, head, upper, upper, fore, fore]
    each += [pair for pair in lower for _ in SIDES]
    return Body(
        shoulder=0.117 * h,
        hip=0.055 * h,
        hip_height=0.530 * h,
        trunk=0.288 * h,
        neck=0.110 * h,
        upper_arm=0.186 * h,
        forearm=0.146 * h,
        hand=0.065 * h,  # to the knuckles: the fingers hold something
        thigh=0.245 * h,
        shin=0.246 * h,
        radius=h * np.array(each),
    )


def trunk_axes(lean: Float[np.ndarray, "*b"], twist: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "*b 3 3"]:
    """Rows right, forward and up of the trunk."""
    cl, sl, ct, st = np.cos(lean), np.sin(lean), np.cos(twist), np.sin(twist)
    zero = np.zeros_like(cl)
    right = np.stack([ct, st, zero], axis=-1)
    forward = np.stack([-st * cl, ct * cl, -sl], axis=-1)
    up = np.stack([-st * sl, ct * sl, cl], axis=-1)
    return np.stack([right, forward, up], axis=-2)


def shoulders(
    body: Body, pelvis: Float[np.ndarray, "*b 3"], axes: Float[np.ndarray, "*b 3 3"]
) -> Float[np.ndarray, "*b 2 3"]:
    """Left and right shoulder."""
    middle = pelvis + body.trunk * axes[..., 2, :]
    aside = body.shoulder * axes[..., 0, :]
    return np.stack([middle - aside, middle + aside], axis=-2)


def elbow_at(
    body: Body,
    shoulder: Float[np.ndarray, "*b 3"],
    wrist: Float[np.ndarray, "*b 3"],
    axes: Float[np.ndarray, "*b 3 3"],
    swivel: Float[np.ndarray, "*b"],
    side: int,
) -> Float[np.ndarray, "*b 3"]:
    """The elbow between shoulder and wrist; NaN where the wrist is out of reach."""
    line = wrist - shoulder
    length = np.linalg.norm(line, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        n = line / length[..., None]
        along = (body.upper_arm**2 - body.forearm**2 + length**2) / (2.0 * length)
        rho = np.sqrt(body.upper_arm**2 - along**2)
    down = -axes[..., 2, :] - 0.5 * axes[..., 1, :]
    e1 = down - (down * n).sum(axis=-1, keepdims=True) * n
    e1 = e1 / np.linalg.norm(e1, axis=-1, keepdims=True)
    e2 = np.cross(n, e1) * (1.0 if side == LEFT else -1.0)
    around = np.cos(swivel)[..., None] * e1 + np.sin(swivel)[..., None] * e2
    return shoulder + along[..., None] * n + rho[..., None] * around


def arm_angles(
    shoulder: Float[np.ndarray, "*b 3"],
    elbow: Float[np.ndarray, "*b 3"],
    wrist: Float[np.ndarray, "*b 3"],
    axes: Float[np.ndarray, "*b 3 3"],
    side: int,
) -> Float[np.ndarray, "*b 4"]:
    """Joint angles alpha1..alpha4 of an arm, radians.

    With o, f, u outward, forward and up of the trunk, the upper arm is `sin(a2) f + cos(a2) (sin(a1) o - cos(a1) u)`;
    at a1 = a2 = a3 = 0 it hangs and a bent forearm points forward; a3 > 0 turns the forearm outward; a4 = 180 degrees
    is the straight arm. Of the two pairs (a1, a2) for one direction, the one within the range of a1 is given.

    >>> arm_angles(np.zeros(3), np.array([0, 0, -0.3]), np.array([0, 0.2, -0.3]), np.eye(3), RIGHT).round(3).tolist()
    [0.0, 0.0, 0.0, 1.571]
    """
    out = axes[..., 0, :] * (1.0 if side == RIGHT else -1.0)
    forward, up = axes[..., 1, :], axes[..., 2, :]
    d = (elbow - shoulder) / np.linalg.norm(elbow - shoulder, axis=-1, keepdims=True)
    g = (wrist - elbow) / np.linalg.norm(wrist - elbow, axis=-1, keepdims=True)
    d_out, d_up = (d * out).sum(axis=-1), (d * up).sum(axis=-1)
    a2 = np.arcsin(np.clip((d * forward).sum(axis=-1), -1.0, 1.0))
    a1 = np.arctan2(d_out, -d_up) + 0.0
    other = (a1 > math.radians(160.0)) | (a1 < math.radians(-9.0))
    mirrored = a1 - np.copysign(np.pi, a1)
    fits = other & (mirrored >= math.radians(-9.0)) & (mirrored <= math.radians(160.0))
    a1, a2 = np.where(fits, mirrored, a1), np.where(fits, np.pi - a2, a2)
    c1, s1, c2, s2 = (f(a)[..., None] for a in (a1, a2) for f in (np.cos, np.sin))
    ahead = c2 * forward + s2 * (c1 * up - s1 * out)
    aside = c1 * out + s1 * up
    a3 = np.arctan2((g * aside).sum(axis=-1), (g * ahead).sum(axis=-1))
    a4 = np.arccos(np.clip(-(d * g).sum(axis=-1), -1.0, 1.0))
    return np.stack([a1, a2, a3, a4], axis=-1)


def angle_limits(alpha: Float[np.ndarray, "*b 4"]) -> Float[np.ndarray, "*b 4 2"]:
    """Lowest and highest joint angles at a pose, radians (wrist thesis, 6.2.1; see `ALPHA3_HIGH`).

    >>> np.degrees(angle_limits(np.zeros(4))).round().tolist()
    [[-9.0, 160.0], [-43.0, 153.0], [-90.0, 60.0], [20.0, 180.0]]
    """
    a1, a2 = np.degrees(alpha[..., 0]), np.degrees(alpha[..., 1])
    one = np.ones_like(a1)
    low = [-9.0 * one, -43.0 + a1 / 3.0, -90.0 + 7.0 * a1 / 9.0 - a2 / 9.0 + 2.0 * a1 * a2 / 810.0, 20.0 * one]
    high = [160.0 * one, 153.0 - a1 / 6.0, ALPHA3_HIGH + 4.0 * a1 / 9.0 - 5.0 * a2 / 9.0 + 5.0 * a1 * a2 / 810.0]
    high.append(180.0 * one)
    return np.radians(np.stack([np.stack(low, axis=-1), np.stack(high, axis=-1)], axis=-1))


def within_limits(alpha: Float[np.ndarray, "*b 4"], spare: float = 0.0) -> Bool[np.ndarray, "*b"]:
    """Whether all joint angles keep `spare` radians from their limits; false for NaN."""
    limits = angle_limits(alpha)
    # a straight arm is the end of the range, not a limit to keep away from
    top = limits[..., 1] - spare * np.array([1.0, 1.0, 1.0, 0.0])
    return np.asarray(((alpha >= limits[..., 0] + spare) & (alpha <= top)).all(axis=-1))


def keypoints_of(body: Body, posture: Posture) -> Float[np.ndarray, "f 16 3"]:
    """All keypoints, in the order of `KEYPOINTS`, in the cell's frame."""
    axes = trunk_axes(posture.lean, posture.twist)
    straight = trunk_axes(np.zeros_like(posture.lean), np.zeros_like(posture.twist))
    shoulder = shoulders(body, posture.pelvis, axes)
    elbow = np.stack(
        [elbow_at(body, shoulder[:, s], posture.wrist[:, s], axes, posture.swivel[:, s], s) for s in (LEFT, RIGHT)],
        axis=1,
    )
    aside = np.stack([-body.hip * straight[:, 0], body.hip * straight[:, 0]], axis=1)
    hip = posture.pelvis[:, None] + aside
    stand = 0.04 * straight[:, None, 1]  # knees a little in front of the hips
    knee = hip - body.thigh * straight[:, None, 2] + stand
    ankle = knee - body.shin * straight[:, None, 2] - stand
    pairs = np.stack([shoulder, elbow, posture.wrist, hip, knee, ankle], axis=1).reshape(-1, 12, 3)
    up = axes[:, 2]
    root = posture.pelvis + 0.15 * body.trunk * up
    middle = shoulder.mean(axis=1)
    head = middle + body.neck * up + 0.02 * axes[:, 1]
    return np.concatenate([pairs, np.stack([root, posture.pelvis, middle, head], axis=1)], axis=1)


def capsules_of(body: Body, p: Float[np.ndarray, "f 16 3"]) -> Float[np.ndarray, "f parts 2 3"]:
    """Ends of the axis of every part, in the order of `PARTS`, from the keypoints (in any frame)."""
    shoulder, elbow, wrist, hip, knee, ankle = np.moveaxis(p[:, :12].reshape(-1, 6, 2, 3), 1, 0)
    middle_hip, middle, head = p[:, None, 13], p[:, None, 14], p[:, None, 15]
    up = (middle - middle_hip) / body.trunk
    chest = middle + 0.55 * (shoulder - middle) - 0.05 * up
    waist = middle_hip + 0.9 * (hip - middle_hip)
    reach = (wrist - elbow) / np.linalg.norm(wrist - elbow, axis=-1, keepdims=True)
    hand = wrist + body.hand * reach
    top = head + 0.25 * (head - middle)
    single = np.stack([np.stack([shoulder[:, 0], shoulder[:, 1]], axis=1), np.concatenate([middle, head], axis=1)], 1)
    skull = np.concatenate([head, top], axis=1)[:, None]
    pairs = [(waist, chest), (shoulder, elbow), (elbow, wrist), (wrist, hand), (hip, knee), (knee, ankle)]
    doubles = [np.stack(pair, axis=2) for pair in pairs]
    return np.concatenate([doubles[0], single, skull, *doubles[1:]], axis=1)


def pills_of(body: Body, ends: Float[np.ndarray, "parts 2 3"]) -> Pills:
    """One frame's parts as pills."""
    return Pills(np.ascontiguousarray(ends[:, 0]), np.ascontiguousarray(ends[:, 1]), body.radius)


def showing() -> Bool[np.ndarray, "16 parts"]:
    """Which parts show each keypoint when they are seen beside it."""
    out = np.zeros((16, len(PARTS)), dtype=bool)
    for k, name in enumerate(KEYPOINTS):
        side, _, joint = name.partition("_")
        if side in SIDES:
            parts = [part for short in _SHOWN_BY[joint] for part in (f"{side}_{short}", short) if part in PARTS]
        else:
            parts = list(_SHOWN_BY[name])
        out[k, [PARTS.index(part) for part in parts]] = True
    return out


def flesh(body: Body) -> Float[np.ndarray, " 16"]:
    """Radius of the body about each keypoint, metres: how much deeper than the skin it lies."""
    part = dict(zip(PARTS, body.radius, strict=True))
    joints = [part["left_upper_arm"][0], part["left_forearm"][0], part["left_hand"][0]]
    joints += [part["left_thigh"][0], part["left_shin"][0], part["left_shin"][1]]
    trunk = part["left_trunk"]
    return np.array([r for r in joints for _ in SIDES] + [trunk[0], trunk[0], trunk[1], part["head"][1]])
