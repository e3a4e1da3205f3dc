"""A skinned hand and a pose in, its grey image out: the truth for tracking with a surface.

Vertices follow the frames of a tree by linear blend skinning,

    v(q) = sum_j w_j  F_j(q) F_j(0)^-1  v,

with F_j the frame that mesh joint j follows (none: it rests) and v the vertex of the bind pose, which is the pose 0 of
a tree made by `synth.mesh_hand`. Nothing here is shared with `handtrack.surface`: samples spread over each pixel find
their triangle by a z-buffer of their own and are lit one by one (Phong), so outlines are smooth by brute force.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from handtrack.camera import Camera, project_camera
from handtrack.formats.glb import SkinnedMesh
from handtrack.kinematics import Model, forward

from . import _kernels
from .shading import Light, Material

SAMPLES = 64


@dataclass(frozen=True, slots=True, eq=False)
class SkinnedHand:
    """A mesh tied to the frames of a tree.

    Attributes
    ----------
    follows : (j,)
        Frame of the tree that each joint of the mesh follows; -1 for the base.
    rest : (f, 4, 4)
        Frames of the pose in which the mesh was bound.
    albedo : (v,)
        Grey level of each vertex in full light.
    """

    mesh: SkinnedMesh
    follows: Int[np.ndarray, " j"]
    rest: Float[np.ndarray, "f 4 4"]
    albedo: Float[np.ndarray, " v"]


def posed_hand(
    hand: SkinnedHand, model: Model, q: Float[np.ndarray, " j"]
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"]]:
    """Vertices and unit normals of the pose q, world axes."""
    mesh = hand.mesh
    moved = np.concatenate([forward(model, q) @ np.linalg.inv(hand.rest), np.eye(4)[None]])[hand.follows]
    blend = (mesh.weight[..., None, None] * moved[mesh.joint]).sum(axis=1)
    vertices = (blend[:, :3, :3] @ mesh.vertices[..., None])[..., 0] + blend[:, :3, 3]
    normals = (blend[:, :3, :3] @ mesh.normals[..., None])[..., 0]
    return vertices, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def sample_places(count: int) -> Float[np.ndarray, "s 2"]:
    """Places in a pixel, -1/2 to 1/2: Hammersley's points, i / n beside the mirrored binary digits of i.

    >>> sample_places(4).tolist()
    [[-0.375, -0.375], [-0.125, 0.125], [0.125, -0.125], [0.375, 0.375]]
    """
    number, mirrored, share = np.arange(count), np.zeros(count), 0.5
    while share > 0.5 / count:
        mirrored, number, share = mirrored + share * (number % 2), number // 2, 0.5 * share
    return np.column_stack([(np.arange(count) + 0.5) / count, mirrored + 0.5 / count]) - 0.5


def render_hand(
    hand: SkinnedHand,
    model: Model,
    q: Float[np.ndarray, " j"],
    camera: Camera,
    material: Material,
    light: Light,
    background: float | Float[np.ndarray, "h w"] = 0.0,
    samples: int = SAMPLES,
) -> Float[np.ndarray, "h w"]:
    """Grey levels, neither clipped nor rounded; the material gives the shares of light, the hand the albedo.

    Raises
    ------
    ValueError
        If a vertex lies behind a perspective camera.
    """
    vertices, normals = posed_hand(hand, model, q)
    p = np.ascontiguousarray(vertices @ camera.R.T + camera.t)
    pinhole = camera.kind == "perspective"
    if pinhole and not p[:, 2].min() > 0.0:
        raise ValueError(f"camera: the hand reaches {-p[:, 2].min():.1f} mm behind it; a camera before it is wanted")
    xy = np.ascontiguousarray(project_camera(camera, p))
    image = np.empty((camera.height, camera.width))
    image[:] = background
    low, high = np.floor(xy.min(axis=0)), np.ceil(xy.max(axis=0))
    box = tuple(
        int(np.clip(edge, first, size - 1))
        for edge, first, size in (
            (low[1], 0, camera.height),
            (high[1], -1, camera.height),
            (low[0], 0, camera.width),
            (high[0], -1, camera.width),
        )
    )
    _kernels.render_samples(
        xy,
        1.0 / p[:, 2] if pinhole else np.ascontiguousarray(p[:, 2]),
        pinhole,
        p,
        normals @ camera.R.T,
        hand.albedo,
        hand.mesh.triangles,
        sample_places(samples),
        box,
        light.direction / np.linalg.norm(light.direction),
        (material.ambient, material.diffuse, 255.0 * material.specular, material.shininess),
        image,
    )
    return image
