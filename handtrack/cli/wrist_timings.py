"""A number of repeats in, times of the hidden wrist's filter and of its rays out."""

import math
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from time import perf_counter

import numpy as np

from ..body.arm_state import Scene, Seen, begin, settings_of
from ..body.environment import RayCaster, Room, ray_caster, room_of
from ..body.joint_filter import Sampling
from ..body.occluded_wrist import step
from ..camera import perspective
from .timings import Timing

CELLS = 158  # of the wall, along each side: 2 x 158^2 triangles
PARTICLES = 2000
RAYS = 20_000


def wrist(repeats: int) -> list[Timing]:
    """The filter with all its tests, and rays from one place, in a room of 50 000 triangles."""
    room = _room()
    caster = ray_caster(room)
    name = f"hidden wrist, {PARTICLES} particles, {room.triangles.shape[0]} triangles, {caster.engine}"
    tree = ray_caster(room, "bvh")
    found = [Timing(name, _filter(caster, repeats), "the same, by our own tree", _filter(tree, repeats))]
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(RAYS, 3)) * 0.2 + (0.0, 0.0, 3.0)
    rays = f"{RAYS} rays, by our own tree" if find_spec("embreex") is None else f"{RAYS} rays, {caster.engine}"
    against = _bare(room, vectors, repeats)
    ours = _median(lambda: caster.hits(np.zeros(3), vectors), repeats)
    found.append(Timing(rays, ours) if against is None else Timing(rays, ours, "Embree's own call", against))
    if caster.engine != "bvh":
        own = _median(lambda: tree.hits(np.zeros(3), vectors), repeats)
        found.append(Timing(f"{RAYS} rays, by our own tree", own, "Embree's own call", against))
    return found


def _room() -> Room:
    """A wavy wall, 2 m before the camera."""
    side = np.linspace(-3.0, 3.0, CELLS + 1)
    x, y = np.meshgrid(side, side)
    z = 2.2 + 0.05 * np.sin(9.0 * x) * np.cos(7.0 * y)
    at = np.arange((CELLS + 1) ** 2).reshape(CELLS + 1, CELLS + 1)
    a, b, c, d = at[:-1, :-1].ravel(), at[:-1, 1:].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    return room_of(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), triangles)


def _filter(caster: RayCaster, repeats: int) -> float:
    """Median milliseconds of a frame in which the wrist is behind a screen."""
    camera = perspective(320, 240, 300.0, 300.0, 160.0, 120.0, np.eye(3), np.zeros(3))
    settings = replace(settings_of("complete"), sampling=Sampling(particles=PARTICLES))
    scene, rng = Scene(camera, caster, settings), np.random.default_rng(1)
    state, depth = begin(settings), np.full((240, 320), 2.2, np.float32)
    depth[60:220, 120:280] = 1.6
    depth[::17, ::13] = 0.0
    took = []
    for frame in range(30 + repeats):
        angle = 0.9 + 0.4 * math.sin(frame / 20.0)
        wrist = np.array([0.26 * math.sin(angle), 0.26 * math.cos(angle), 2.0])
        p = np.stack([np.array([0.0, -0.3, 2.0]), np.array([0.0, 0.0, 2.0]), wrist])
        code = np.array([0, 0, 0 if frame < 20 else 2])
        seen = Seen(frame / 30.0, p + 0.01 * rng.normal(size=(3, 3)), code, depth)
        begun = perf_counter()
        state, _ = step(state, seen, scene, rng)
        took.append(perf_counter() - begun)
    return 1e3 * float(np.median(took[30:]))


def _bare(room: Room, vectors: np.ndarray, repeats: int) -> float | None:
    """Median milliseconds of Embree's call with arrays as it wants them; None where it is not installed."""
    if find_spec("embreex") is None:
        return None
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore import EmbreeDevice
    from embreex.rtcore_scene import EmbreeScene

    device = EmbreeDevice()
    scene = EmbreeScene(device, robust=True)  # as ours: rays do not pass between neighbouring triangles
    TriangleMesh(scene, np.ascontiguousarray(room.vertices[room.triangles], np.float32))
    start, way = np.zeros(vectors.shape, np.float32), vectors.astype(np.float32)
    return _median(lambda: scene.run(start, way, query="DISTANCE"), repeats)


def _median(work: Callable[[], object], repeats: int) -> float:
    work()
    took = []
    for _ in range(repeats):
        begun = perf_counter()
        work()
        took.append(perf_counter() - begun)
    return 1e3 * float(np.median(took))
