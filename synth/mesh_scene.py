"""A skinned hand mesh and a seed in, a ready scene out: fingers that bend at random, seen from any side."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from handtrack.formats.glb import SkinnedMesh
from handtrack.kinematics import Model

from .mesh import SkinnedHand, posed_hand
from .mesh_hand import FINGERS, mesh_hand, resized
from .motion import inside_limits, keys_needed, walk
from .scene import Scene, about_x, skin, view, wrong_start
from .sensor import Sensor

_BEHIND = 8.0  # grey level
_ROAM = {  # degrees
    "mcp": (-5.0, 55.0),
    "pip": (0.0, 60.0),
    "dip": (0.0, 40.0),
    "abduction": (-6.0, 6.0),
    "radial": (-10.0, 15.0),
    "ip": (0.0, 40.0),
}


def mesh_scene(
    seed: int,
    mesh: SkinnedMesh,
    *,
    frames: int = 60,
    scale: float = 1.0,
    mirror: bool = False,
    fingers: Sequence[str] = FINGERS[1:],
    abduction: bool = False,
    covered: bool = False,
    tilt: float = 30.0,
    turn: float = 0.0,
    palm: bool = False,
    projection: str = "orthographic",
    noise: float = 2.0,
    max_speed: float = 3.0,
    start_error: float = 0.0,
    zoom: float = 2.6,
    size: tuple[int, int] = (640, 480),
) -> Scene:
    """Fingers of a mesh that bend at random.

    Parameters
    ----------
    scale, mirror : float, bool
        Size of the hand, and whether it is the other one.
    fingers, abduction, covered
        See `synth.mesh_hand.mesh_hand`.
    tilt, turn : float
        Degrees by which the camera is turned about the image's horizontal and vertical axes.
    palm : bool
        Whether the camera stands before the palm rather than behind the back of the hand.
    max_speed : float
        Degrees a frame that the fastest joint reaches.
    start_error : float
        Degrees by which each joint of the given start pose is wrong.
    zoom : float
        Pixels for each mm.
    """
    model, hand = mesh_hand(resized(mesh, scale, mirror), fingers, abduction, covered)
    rng = np.random.default_rng(seed)
    roam = np.radians([_ROAM[name.rsplit("_", 1)[1]] for name in model.joint_names])
    keys = rng.uniform(roam[:, 0], roam[:, 1], (keys_needed(frames, max_speed, 25.0), roam.shape[0]))
    truth = walk(inside_limits(model, keys), frames, max_speed)
    R = _upright(hand)
    a = math.radians(turn)
    about_y = np.array([[math.cos(a), 0.0, math.sin(a)], [0.0, 1.0, 0.0], [-math.sin(a), 0.0, math.cos(a)]])
    R = about_x(math.radians(tilt)) @ about_y @ (np.diag([-1.0, 1.0, -1.0]) @ R if palm else R)
    camera = view(projection, size, zoom, (0.5 * size[0], 0.5 * size[1]), R, _middle(hand, model, truth))
    start = wrong_start(model, truth[0], start_error, seed)
    return Scene(
        "mesh", seed, model, camera, truth, start, skin(model), sensor=Sensor(noise), background=8.0, hand=hand
    )


def _upright(hand: SkinnedHand) -> Float[np.ndarray, "3 3"]:
    """Camera axes that see the back of the hand with its fingers upwards."""
    joints = [
        hand.mesh.bind[i, :3, :3] for i, name in enumerate(hand.mesh.joint_names) if name.endswith("phalanx-proximal")
    ]
    up = -np.mean([joint[:, 2] for joint in joints], axis=0)
    back = np.mean([joint[:, 1] for joint in joints], axis=0)
    y = -up / np.linalg.norm(up)
    z = -back + (back @ y) * y
    z = z / np.linalg.norm(z)
    return np.stack([np.cross(y, z), y, z])


def _middle(hand: SkinnedHand, model: Model, truth: Float[np.ndarray, "m j"]) -> Float[np.ndarray, " 3"]:
    """Middle of the places that moving skin takes, world axes."""
    moving = (hand.mesh.weight * (hand.follows >= 0)[hand.mesh.joint]).sum(axis=1) > 0.5
    places = np.concatenate([posed_hand(hand, model, q)[0][moving] for q in truth[:: max(len(truth) // 10, 1)]])
    return 0.5 * (places.min(axis=0) + places.max(axis=0))
