"""Shots made by hand, for tests of labels: a hand of pills or a skinned one, a ball, a crate and a stick before it."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from handtrack.camera import Camera, orthographic, perspective
from handtrack.formats.glb import read_glb
from handtrack.kinematics.builtin import model as builtin
from handtrack.pills import Pills
from synth.dataset.hands import pill_hand, skinned_hand
from synth.labels.bodies import Body, Placed, Rigid
from synth.labels.shot import Exposure, Shot, parts_of
from synth.labels.solids import Lights, Paint

HAND_MESH = Path(__file__).parents[2] / "shared" / "data" / "hand_mesh" / "right.glb"
NONE = np.zeros((0, 3))
NO_TRIANGLES = np.zeros((0, 3), np.int64)


def ball(radius: float) -> Rigid:
    pills = Pills(np.zeros((1, 3)), np.zeros((1, 3)), np.full((1, 2), radius))
    return Rigid("sphere", pills, NONE, NONE, NO_TRIANGLES)


def stick(length: float, radius: float) -> Rigid:
    pills = Pills(np.zeros((1, 3)), np.array([[length, 0.0, 0.0]]), np.array([[radius, 0.6 * radius]]))
    return Rigid("pill", pills, NONE, NONE, NO_TRIANGLES)


def crate(size: float) -> Rigid:
    """A box of flat faces: four vertices each."""
    vertices, normals, triangles = [], [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal, a, b = np.zeros(3), np.zeros(3), np.zeros(3)
            normal[axis], a[(axis + 1) % 3], b[(axis + 2) % 3] = sign, 1.0, sign
            n = len(vertices)
            vertices += [normal - a - b, normal + a - b, normal + a + b, normal - a + b]
            normals += [normal] * 4
            triangles += [[n, n + 1, n + 2], [n, n + 2, n + 3]]
    none = Pills(NONE, NONE, np.zeros((0, 2)))
    return Rigid("box", none, 0.5 * size * np.array(vertices), np.array(normals), np.array(triangles))


def turned(rng: np.random.Generator) -> np.ndarray:
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[:, [1, 0, 2]]


def camera_of(kind: str, size: tuple[int, int], bent: bool = False) -> Camera:
    """A camera 420 mm before the middle of the hand."""
    width, height = size
    middle = (0.5 * width - 0.5, 0.5 * height - 0.5)
    R, t = np.diag([1.0, -1.0, -1.0]), np.array([0.0, 55.0, 420.0])
    if kind == "orthographic":
        return orthographic(width, height, height / 300.0, *middle, R, t)
    k = np.array([-0.25, 0.08, 0.002, -0.001, 0.0]) if bent else None
    return perspective(width, height, 1.4 * height, 1.4 * height, *middle, R, t, k)


def shot(
    seed: int,
    *,
    kind: str = "perspective",
    size: tuple[int, int] = (96, 72),
    mesh: bool = False,
    left: bool = False,
    bent: bool = False,
    speed: float = 1.0,
    exposure: Exposure | None = None,
) -> Shot:
    """A random pose seen by a camera, with three occluders; everything moves on to the next frame."""
    rng = np.random.default_rng(seed)
    hand = skinned_hand(read_glb(HAND_MESH), left) if mesh else pill_hand(builtin("full_hand"), left)
    limits = hand.model.limits
    q = limits[:, 0] + (limits[:, 1] - limits[:, 0]) * rng.uniform(0.2, 0.7, limits.shape[0])
    shift = np.array([0.0, 50.0, 0.0]) if mesh else np.zeros(3)
    bodies = [_body(rng, hand, shift, 10.0 * speed, np.stack([q, q + 0.1 * speed * rng.standard_normal(q.size)]))]
    shapes = (ball(rng.uniform(8, 20)), crate(rng.uniform(15, 40)), stick(rng.uniform(30, 90), rng.uniform(4, 9)))
    for shape in shapes:
        place = np.array([rng.uniform(-50, 50), rng.uniform(-30, 110), rng.uniform(40, 120)])
        bodies.append(_body(rng, shape, place, 10.0 * speed, np.zeros((2, 0)), turned(rng)))
    bodies = tuple(bodies)
    parts = parts_of(bodies)
    count = len(parts.name)
    paint = Paint(
        rng.uniform(90, 240, (count, 3)),
        rng.uniform(30, 200, (count, 3)),
        rng.integers(0, 4, count),
        rng.uniform(4, 12, count),
        rng.uniform(0, 0.2, count),
        rng.integers(4, 40, count).astype(float),
    )
    lights = rng.standard_normal((2, 3)) - np.array([0.0, 0.0, 2.0])
    lights = Lights(0.25, lights / np.linalg.norm(lights, axis=1, keepdims=True), rng.uniform(0.2, 0.6, (2, 3)))
    background = rng.integers(0, 120, (size[1], size[0], 3)).astype(np.uint8)
    camera = camera_of(kind, size, bent)
    return Shot(bodies, parts, paint, camera, lights, background, exposure or Exposure(), seed, seed, 0, seed)


def still(one: Shot) -> Shot:
    """The same shot with nothing moving."""
    bodies = tuple(
        replace(body, q=body.q[[0, 0]], placed=Placed(body.placed.R[[0, 0]], body.placed.t[[0, 0]]))
        for body in one.bodies
    )
    return replace(one, bodies=bodies)


def _body(rng, shape, place, speed, q, R=None) -> Body:
    """A body that moves by some `speed` mm and 0.1 rad until the next frame."""
    first = np.eye(3) if R is None else R
    axis = 0.1 * rng.standard_normal(3) * min(speed, 1.0)
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    angle = max(float(np.linalg.norm(axis)), 1e-12)
    turn = np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * K @ K
    move = speed * rng.standard_normal(3)
    return Body(shape, Placed(np.stack([first, turn @ first]), np.stack([place, place + move])), q)
