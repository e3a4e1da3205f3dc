"""A scene (model, cameras, light, true motion) in, its images out.

Every image has its own random numbers, drawn from (seed, frame) or, in a further view, (seed, frame, view): images can
be made in any order, with the same bytes.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from handtrack.camera import Camera, orthographic, perspective
from handtrack.kinematics import Model, forward
from handtrack.pills import Pills, pose_pills

from .mesh import SkinnedHand, render_hand
from .render import REC_601, Background, render
from .sensor import Sensor, sense
from .shading import Light, Material, Mode

LIGHT = Light(np.array([-0.5, -0.6, -0.8]))  # from the upper left, in front of the scene
SKIN = np.array(
    [
        [236.0, 208.0, 188.0],
        [224.0, 196.0, 178.0],
        [242.0, 216.0, 200.0],
        [216.0, 186.0, 166.0],
        [230.0, 204.0, 192.0],
    ]
)
BLACK = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All that decides the images of a sequence.

    Attributes
    ----------
    camera : Camera
        Of the first view. The light stands still in its axes.
    truth : (m, j)
        Joint values of each frame, radians, in the order of `model.joint_names`.
    start : (j,)
        The pose given to a tracker for frame 0; may be wrong on purpose.
    background : float or (h, w) array
        Grey level behind the pills, in every view.
    more_cameras : tuple of Camera
        One for each further view; all see the scene at the same moments.
    hand : SkinnedHand, optional
        A skin that the tree moves, shown instead of the pills; grey and lit by Phong only.
    """

    name: str
    seed: int
    model: Model
    camera: Camera
    truth: Float[np.ndarray, "m j"]
    start: Float[np.ndarray, " j"]
    material: Material
    light: Light = LIGHT
    mode: Mode = "phong"
    colour: bool = False
    background: Background = BLACK
    sensor: Sensor = field(default_factory=Sensor)
    fps: float = 25.0
    more_cameras: tuple[Camera, ...] = ()
    hand: SkinnedHand | None = None

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """One camera for each view."""
        return (self.camera, *self.more_cameras)


def skin(model: Model) -> Material:
    """Skin whose tone differs a little from finger to finger; its grey levels reach from 60 at the rim to 220."""
    return Material(SKIN[model.link_finger % SKIN.shape[0]])


def posed(scene: Scene, frame: int, view: int = 0) -> Pills:
    """True pills of a frame, in the axes of a view's camera."""
    return pose_pills(scene.model, forward(scene.model, scene.truth[frame]), scene.cameras[view])


def clean_image(scene: Scene, frame: int, view: int = 0) -> Float[np.ndarray, "h w *c"]:
    """Image of a frame before the sensor."""
    camera, light = scene.cameras[view], scene.light
    if view:
        light = replace(light, direction=camera.R @ scene.camera.R.T @ light.direction)
    if scene.hand is not None:
        return render_hand(
            scene.hand, scene.model, scene.truth[frame], camera, scene.material, light, _grey(scene.background)
        )
    pills = posed(scene, frame, view)
    return render(pills, camera, scene.material, light, scene.mode, colour=scene.colour, background=scene.background)


def _grey(background: Background) -> float | Float[np.ndarray, "h w"]:
    """Background of a grey image."""
    if not isinstance(background, np.ndarray):
        return background
    return background @ REC_601 if background.ndim == 3 else background


def image(scene: Scene, frame: int, view: int = 0) -> Float[np.ndarray, "h w *c"]:
    """Image of a frame as a camera delivers it, float32 grey levels (or red, green, blue)."""
    seed = [scene.seed, frame, view] if view else [scene.seed, frame]
    return sense(clean_image(scene, frame, view), scene.sensor, np.random.default_rng(seed))


def images(scene: Scene) -> Iterator[Float[np.ndarray, "h w *c"]]:
    """Images of all frames in the first view, one after the other.

    >>> from synth.scenes import two_finger_crossing
    >>> [picture.shape for picture in images(two_finger_crossing(1, frames=2))]
    [(480, 640), (480, 640)]
    """
    for frame in range(scene.truth.shape[0]):
        yield image(scene, frame)


def images_together(scene: Scene) -> Iterator[tuple[Float[np.ndarray, "..."], ...]]:
    """For each frame the images of all views."""
    for frame in range(scene.truth.shape[0]):
        yield tuple(image(scene, frame, view) for view in range(len(scene.cameras)))


def about_x(angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about the horizontal image axis, radians."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def view(
    projection: str,
    size: tuple[int, int],
    scale: float,
    focus: tuple[float, float],
    R: Float[np.ndarray, "3 3"],
    target: Float[np.ndarray, " 3"],
    focal: float = 640.0,
) -> Camera:
    """Camera of either projection that shows world point `target` at pixel `focus` with the same scale there.

    The perspective camera stands at the distance where its focal length gives that scale.
    """
    width, height = size
    t = np.array([0.0, 0.0, focal / scale]) - R @ target
    if projection == "orthographic":
        return orthographic(width, height, scale, *focus, R, t)
    if projection == "perspective":
        return perspective(width, height, focal, focal, *focus, R, t)
    raise ValueError(f"projection: '{projection}' is unknown; wanted orthographic or perspective")


def wrong_start(model: Model, q: Float[np.ndarray, " j"], error: float, seed: int) -> Float[np.ndarray, " j"]:
    """A pose wrong by `error` degrees in every joint, with random signs turned where they would leave the limits."""
    if error == 0:
        return q.copy()
    sign = np.random.default_rng([seed, 2**31]).choice([-1.0, 1.0], q.size)
    off = q + sign * math.radians(error)
    out = (off < model.limits[:, 0]) | (off > model.limits[:, 1])
    return np.where(out, q - sign * math.radians(error), off)
