"""Recorded motion in, joint values of a hand out: BVH skeletons with fingers, and markers on the fingers of a hand.

A skeleton tells the direction of every phalanx against the palm; with the lengths of the hand at hand that makes
places for its joints. Markers tell places, in axes that three markers on the back of the hand define; how the model's
palm sits in these axes, and how large the recorded hand is, is found together with the poses, in turns. Joint values
follow by damped least squares of all frames at once, inside the joint limits.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import PchipInterpolator

from handtrack.errors import InputError
from handtrack.formats.bvh import Bvh, joint_frames, read_bvh
from handtrack.formats.markers import Markers, read_markers
from handtrack.kinematics import forward, pose_from_free

from ..labels.bodies import MeshHand, PillHand
from ..labels.solids import KEYPOINTS
from ..mesh_hand import FINGERS
from .hands import own_axes
from .poses import joint_ranges

LONGEST_GAP = 0.2  # seconds over which markers that were not seen are filled in
PRIOR, STIFF = 3.0, 12.0  # mm for a radian away from a slightly bent hand: of a pose, and while the palm is sought
BENT = 0.2  # of a slightly bent hand's joints, share of the way to where bending ends
STEPS, FEW, TURN = 25, 4, 1e-5  # rounds of least squares, those in each turn, and radians of its differences
TURNS, SAMPLE = 12, 40  # rounds in which markers find the palm, and frames used for that
_WORDS = {"little": ("pinky", "little"), "middle": ("middle", "mid")}
_ROWS = {finger: [KEYPOINTS.index(name) for name in KEYPOINTS if name.startswith(finger)] for finger in FINGERS}


def joint_motion(
    path: Path | str, hand: PillHand | MeshHand, fps: float, side: str = "right"
) -> Float[np.ndarray, "m j"]:
    """Joint values of a hand from a file, frame by frame.

    Parameters
    ----------
    path : Path or str
        `.bvh`, `.tsv` or `.trc`.
    hand : PillHand or MeshHand
        Of the side wanted.
    fps : float
        Frames a second of the result.
    side : {"right", "left"}
        Which of a skeleton's hands to take; if it has only the other one, that is mirrored.

    Raises
    ------
    InputError
        If the file is bad, or holds no fingers.
    """
    path = Path(path)
    if path.suffix.lower() == ".bvh":
        skeleton = read_bvh(path)
        points, rate = _targets_of_skeleton(path, skeleton, hand, side), 1.0 / skeleton.seconds
        q = fitted(hand, points, known_places(hand))
    else:
        markers = read_markers(path)
        q, rate = _of_markers(path, markers, hand), markers.rate
    return resampled(q, rate, fps)


def resampled(q: Float[np.ndarray, "m j"], rate: float, fps: float) -> Float[np.ndarray, "n j"]:
    """Joint values at another rate, on straight lines between the frames; at least two frames."""
    count = max(2, int((q.shape[0] - 1) / rate * fps) + 1)
    at = np.minimum(np.arange(count) / fps * rate, q.shape[0] - 1)
    low = np.minimum(at.astype(int), max(q.shape[0] - 2, 0))
    high = np.minimum(low + 1, q.shape[0] - 1)
    return q[low] + (at - low)[:, None] * (q[high] - q[low])


def known_places(hand: PillHand | MeshHand) -> Float[np.ndarray, "k k"]:
    """Weights that make each keypoint a point of its own: the identity; markers between joints have other rows."""
    return np.eye(hand.point.shape[0])


def fitted(
    hand: PillHand | MeshHand,
    target: Float[np.ndarray, "m p 3"],
    mixing: Float[np.ndarray, "p k"],
    prior: float = PRIOR,
    start: Float[np.ndarray, "m j"] | None = None,
    steps: int = STEPS,
) -> Float[np.ndarray, "m j"]:
    """Joint values that bring points of a hand to places, in its own axes; NaN where there is none to go to.

    Parameters
    ----------
    mixing : (p, k)
        Each point as a mean of keypoints.
    prior : float
        Pull towards a slightly bent hand, mm for a radian.
    start : (m, j), optional
        First guess; the slightly bent hand if not given.
    steps : int
        Most rounds of least squares.
    """
    model = hand.model
    limits = np.where(np.isfinite(model.limits), model.limits, [-np.pi, np.pi])
    _, _, finger, end = joint_ranges(model)
    rest = np.clip(np.where(finger >= 0, BENT * end, 0.0), *limits.T)
    q = np.tile(rest, (target.shape[0], 1)) if start is None else start
    known = ~np.isnan(target)
    goal = np.where(known, target, 0.0)
    if isinstance(hand, PillHand) and hand.mirrored:
        goal = goal * (-1.0, 1.0, 1.0)
    for _ in range(steps):
        now = _points(hand, q, mixing)
        J = np.stack([(_points(hand, q + TURN * e, mixing) - now) / TURN for e in np.eye(q.shape[1])], axis=-1)
        r = np.where(known, goal - now, 0.0).reshape(q.shape[0], -1)
        J = np.where(known[..., None], J, 0.0).reshape(q.shape[0], -1, q.shape[1])
        normal = J.transpose(0, 2, 1) @ J + prior**2 * np.eye(q.shape[1])
        right = (J.transpose(0, 2, 1) @ r[..., None])[..., 0] + prior**2 * (rest - q)
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        q = np.clip(q + np.clip(step, -0.5, 0.5), *limits.T)
        if np.abs(step).max() < 1e-5:
            break
    return pose_from_free(model, q[:, model.free])


def _points(
    hand: PillHand | MeshHand, q: Float[np.ndarray, "m j"], mixing: Float[np.ndarray, "p k"]
) -> Float[np.ndarray, "m p 3"]:
    """Points of a hand in the axes of its tree; a keypoint that the hand lacks counts as its origin."""
    frames = forward(hand.model, q)
    base = np.broadcast_to(np.eye(4), (q.shape[0], 1, 4, 4))
    F = np.concatenate([frames, base], axis=1)[:, hand.point_frame]
    place = np.nan_to_num(hand.point)
    return mixing @ ((F[..., :3, :3] @ place[:, :, None])[..., 0] + F[..., :3, 3])


def _rest_points(hand: PillHand | MeshHand) -> Float[np.ndarray, "k 3"]:
    """Keypoints of the zero pose in the hand's own axes."""
    points = _points(hand, np.zeros((1, len(hand.model.joint_names))), known_places(hand))[0]
    return points * (-1.0, 1.0, 1.0) if isinstance(hand, PillHand) and hand.mirrored else points


def _targets_of_skeleton(
    path: Path, skeleton: Bvh, hand: PillHand | MeshHand, side: str
) -> Float[np.ndarray, "m 21 3"]:
    """Where a hand's joints would be with the skeleton's directions and its own lengths, own axes."""
    other = {"right": "left", "left": "right"}[side]
    found, given = _fingers(skeleton, side), side
    if found is None:
        found, given = _fingers(skeleton, other), other
    if found is None:
        raise InputError(f"{path}: has no joints of all fingers of a hand; names like RightHandIndex1 are wanted")
    wrist, chains = found
    p = joint_frames(skeleton)[1]
    axes = _palm_axes(
        p[:, wrist], p[:, chains["index"][0]], p[:, chains["middle"][0]], p[:, chains["little"][0]], given
    )
    to_hand, _ = own_axes(hand)
    rest = _rest_points(hand)
    target = np.full((p.shape[0], len(KEYPOINTS), 3), np.nan)
    for finger, chain in chains.items():
        rows = _ROWS[finger]
        at = np.tile(rest[rows[0]], (p.shape[0], 1))
        for below, above, row, previous in zip(chain, chain[1:], rows[1:], rows, strict=False):
            bone = ((p[:, above] - p[:, below])[:, None] @ axes)[:, 0]  # in the axes of hands
            if given != side:
                bone = bone * (-1.0, 1.0, 1.0)
            bone = bone / np.maximum(np.linalg.norm(bone, axis=1, keepdims=True), 1e-12)
            at = at + float(np.linalg.norm(rest[row] - rest[previous])) * (bone @ to_hand)
            target[:, row] = at
    return target


def _fingers(skeleton: Bvh, side: str) -> tuple[int, dict[str, list[int]]] | None:
    """The wrist, and each finger's last three joints and end; None if a finger is missing."""
    chains: dict[str, list[int]] = {}
    for finger in FINGERS:
        words = _WORDS.get(finger, (finger,))
        mine = [
            i
            for i, name in enumerate(skeleton.names)
            if any(word in name.lower() for word in words)
            and (side in name.lower() or name.lower().startswith((f"{side[0]}_", f"{side[0]}hand")))
        ]
        ends = [i for i in mine if i not in skeleton.parent]
        if not ends:
            return None
        chain = [ends[0]]
        while len(chain) < 4 and skeleton.parent[chain[0]] >= 0:
            chain.insert(0, int(skeleton.parent[chain[0]]))
        if len(chain) < 4 or not set(chain) <= set(mine):
            return None
        chains[finger] = chain
    above = [_ancestors(skeleton, chain[0]) for chain in chains.values()]
    shared = [i for i in above[0] if all(i in others for others in above)]
    return (shared[0], chains) if shared else None


def _ancestors(skeleton: Bvh, joint: int) -> list[int]:
    """Joints below one, the nearest first."""
    found, at = [], int(skeleton.parent[joint])
    while at >= 0:
        found.append(at)
        at = int(skeleton.parent[at])
    return found


def _palm_axes(wrist, index, middle, little, side: str) -> Float[np.ndarray, "m 3 3"]:
    """The axes of hands (see `hands.own_axes`) as columns, for every frame."""
    y = middle - wrist
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    z = np.cross(index - little, y) * (1.0 if side == "right" else -1.0)
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=-1)


def _of_markers(path: Path, markers: Markers, hand: PillHand | MeshHand) -> Float[np.ndarray, "m j"]:
    """Joint values over the longest stretch without long gaps; the markers are those of a right hand."""
    wanted = [f"{finger}_{part}" for finger in FINGERS for part in ("middle", "tip")]
    back = [name for name in markers.names if name.startswith("hand_")][:3]
    missing = [name for name in wanted if name not in markers.names]
    if missing or len(back) < 3:
        raise InputError(
            f"{path}: has no marker {(missing or ['hand_...'])[0]!r}; {', '.join(wanted)} and three hand_... are wanted"
        )
    places = filled(markers.places[:, [markers.names.index(name) for name in (*back, *wanted)]], markers.rate)
    first, last = _longest(np.asarray(~np.isnan(places).any(axis=(1, 2))))
    if last - first < 2:
        raise InputError(f"{path}: has no two frames in a row in which all its markers were seen")
    local = _in_back_axes(places[first:last])
    mixing = _marker_mixing(wanted)
    scale, R, t = _seated(hand, local, mixing)
    target = (local * scale) @ R.T + t
    if hand_is_left(hand):
        target = target * (-1.0, 1.0, 1.0)
    return fitted(hand, target @ own_axes(hand)[0], mixing)


def hand_is_left(hand: PillHand | MeshHand) -> bool:
    """Whether it is a left hand."""
    return hand.mirrored if isinstance(hand, PillHand) else hand.left


def filled(places: Float[np.ndarray, "m n 3"], rate: float) -> Float[np.ndarray, "m n 3"]:
    """Short gaps of markers filled along monotone cubics; longer ones stay."""
    out = places.copy()
    frames = np.arange(places.shape[0])
    for n in range(places.shape[1]):
        seen = ~np.isnan(places[:, n, 0])
        if seen.sum() < 2 or seen.all():
            continue
        smooth = PchipInterpolator(frames[seen], places[seen, n], axis=0, extrapolate=False)(frames)
        edges = np.flatnonzero(np.diff(np.concatenate([[1], seen, [1]])))
        for begin, end in edges.reshape(-1, 2):
            if end - begin <= LONGEST_GAP * rate:
                out[begin:end, n] = smooth[begin:end]
    return out


def _longest(fine: Bool[np.ndarray, " m"]) -> tuple[int, int]:
    """First and last (exclusive) frame of the longest run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], fine.astype(int), [0]]))).reshape(-1, 2)
    if not edges.size:
        return 0, 0
    begin, end = edges[(edges[:, 1] - edges[:, 0]).argmax()]
    return int(begin), int(end)


def _in_back_axes(places: Float[np.ndarray, "m n 3"]) -> Float[np.ndarray, "m p 3"]:
    """Finger markers in axes that the three markers on the back define; these come first."""
    a, b, c = (places[:, i] for i in range(3))
    x = c - b
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    z = np.cross(x, a - b)
    z = z / np.linalg.norm(z, axis=1, keepdims=True)
    axes = np.stack([x, np.cross(z, x), z], axis=-1)
    return (places[:, 3:] - ((a + b + c) / 3.0)[:, None]) @ axes


def _marker_mixing(wanted: list[str]) -> Float[np.ndarray, "p k"]:
    """A `middle` marker sits on the joint half-way along the finger, a `tip` marker at the fingertip."""
    mixing = np.zeros((len(wanted), len(KEYPOINTS)))
    for i, name in enumerate(wanted):
        finger, part = name.split("_")
        rows = _ROWS[finger]
        mixing[i, rows[3] if part == "tip" else rows[1]] = 1.0
    return mixing


def _seated(hand: PillHand | MeshHand, local: Float[np.ndarray, "m p 3"], mixing: Float[np.ndarray, "p k"]):
    """Scale, rotation and shift that take the back's axes to those of a right hand, found in turns with poses."""
    to_hand, _ = own_axes(hand)
    flip = np.array([-1.0, 1.0, 1.0]) if hand_is_left(hand) else np.ones(3)
    few = local[np.linspace(0, local.shape[0] - 1, min(SAMPLE, local.shape[0])).astype(int)]
    best = (np.inf, 1.0, np.eye(3), np.zeros(3))
    for start in _starts(few):
        scale, R, t = start
        error, q = np.inf, None
        for _ in range(TURNS):
            target = ((few * scale) @ R.T + t) * flip
            q = fitted(hand, target @ to_hand, mixing, STIFF, q, FEW)
            made = _points(hand, q, mixing)
            if isinstance(hand, PillHand) and hand.mirrored:
                made = made * (-1.0, 1.0, 1.0)
            made = (made @ to_hand.T) * flip
            scale, R, t = _similar(few.reshape(-1, 3), made.reshape(-1, 3))
            error = float(np.sqrt(((((few * scale) @ R.T + t) - made) ** 2).sum(axis=-1).mean()) / scale)
        if error < best[0]:
            best = (error, scale, R, t)
    return best[1:]


def _starts(local: Float[np.ndarray, "m p 3"]):
    """First guesses: fingers point away from the back, their knuckles from index to little span the palm."""
    mean = local.mean(axis=0)  # thumb, index, middle, ring, little: middle and tip of each
    y = mean[[3, 5, 7, 9]].mean(axis=0)
    y = y / np.linalg.norm(y)
    across = mean[2] - mean[8]
    x = across - (across @ y) * y
    x = x / np.linalg.norm(x)
    R = np.stack([x, y, np.cross(x, y)])
    for tilt in (-0.4, 0.0, 0.4):
        c, s = np.cos(tilt), np.sin(tilt)
        yield 1.0, np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ R, np.array([0.0, 35.0, -15.0])


def _similar(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]):
    """Scale, rotation and shift that take points a nearest to points b (after Umeyama, PAMI 13(4), 1991)."""
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    U, _, V = np.linalg.svd((b - mean_b).T @ (a - mean_a) / a.shape[0])
    S = np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(V))])
    R = U @ S @ V
    # The ratio of the spreads, not the regression's: that one shrinks with every misfit, round after round.
    scale = float(np.sqrt(((b - mean_b) ** 2).sum() / ((a - mean_a) ** 2).sum()))
    scale = float(np.clip(scale, 0.6, 1.6))
    return scale, R, mean_b - scale * R @ mean_a
