"""The keys of a scene file, with their ranges and defaults: what may vary from image to image, and how far.

A range is one number, or two, `[low, high]`, between which every image or sequence draws its own. Lengths are
millimetres, angles degrees.
"""

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, PositiveFloat
from pydantic_core import PydanticCustomError

from handtrack.formats.yaml_files import Strict

MOST_PIXELS = 4096


def _range(low: float = -math.inf, high: float = math.inf, whole: bool = False) -> Any:
    """Type of a range whose numbers lie in low..high."""

    def check(value: Any) -> Any:
        a, b = value if isinstance(value, list) else (value, value)
        if not (low <= a <= b <= high):
            limits = f" within {low:g}..{high:g}" if math.isfinite(low) or math.isfinite(high) else ""
            raise PydanticCustomError("range", "a number or [low, high]{limits}", {"limits": limits})
        return a, b

    number = int if whole else float
    return Annotated[number | Annotated[list[number], Field(min_length=2, max_length=2)], AfterValidator(check)]


Any_ = _range()
Degrees = _range(-360.0, 360.0)
Turn = _range(0.0, 180.0)
Share = _range(0.0, 1.0)
Positive = _range(1e-3)
NotNegative = _range(0.0)
Level = _range(0.0, 255.0)
Count = _range(0.0, 12.0, whole=True)
Pixels = Annotated[int, Field(ge=16, le=MOST_PIXELS)]
Textures = Annotated[list[Literal["plain", "noise", "stripes", "checker"]], Field(min_length=1)]


class ImageFile(Strict):
    """`image:`"""

    width: Pixels = 640
    height: Pixels = 480
    type: Literal["png", "jpg"] = "jpg"
    quality: Annotated[int, Field(ge=1, le=100)] = 95


class SequenceFile(Strict):
    """`sequence:` how many frames belong together, and how far apart they are."""

    frames: Annotated[int, Field(ge=1, le=100_000)] = 1
    fps: PositiveFloat = 25.0


class DistortionFile(Strict):
    """`distortion:` OpenCV's coefficients."""

    k1: Any_ = (0.0, 0.0)
    k2: Any_ = (0.0, 0.0)
    p1: Any_ = (0.0, 0.0)
    p2: Any_ = (0.0, 0.0)
    k3: Any_ = (0.0, 0.0)


class CameraFile(Strict):
    """`camera:` looks at the first hand, or between both, from a direction in a cone about one."""

    type: Literal["perspective", "orthographic"] = "perspective"
    fov: _range(1.0, 150.0) = (50.0, 50.0)  # of the longer side of the image
    extent: Positive = (260.0, 260.0)  # millimetres that the longer side shows, for an orthographic camera
    distance: _range(50.0) = (350.0, 600.0)
    towards: Literal["palm", "back", "thumb", "little", "fingertips", "any"] = "any"
    cone: Turn = (0.0, 180.0)
    roll: Degrees = (-180.0, 180.0)
    off_centre: _range(0.0, 0.5) = (0.0, 0.1)  # share of the image by which the hand's middle may leave its middle
    distortion: DistortionFile = DistortionFile()


class MotionFile(Strict):
    """`motion:` wandering about a place along sums of sines."""

    translation: NotNegative = (0.0, 0.0)  # root mean square, millimetres a frame
    rotation: _range(0.0, 90.0) = (0.0, 0.0)  # root mean square, degrees a frame


class PoseFile(Strict):
    """`pose:` where joint values come from."""

    type: Literal["natural", "limits", "file"] = "natural"
    spread: Share = (0.0, 0.3)  # share of the joint ranges that is mixed in at random
    speed: _range(0.0, 45.0) = (0.0, 4.0)  # of the fastest joint, degrees a frame
    file: str | None = None


class HandFile(Strict):
    """One entry of `hands:`"""

    kind: Literal["pills", "mesh"] = "pills"
    model: str = "full_hand"
    mesh: str | None = None
    side: Literal["right", "left", "any"] = "right"
    scale: _range(0.2, 5.0) = (0.85, 1.15)
    lengths: _range(0.5, 2.0) = (1.0, 1.0)
    radii: _range(0.5, 2.0) = (1.0, 1.0)
    pose: PoseFile = PoseFile()
    motion: MotionFile = MotionFile()
    apart: NotNegative = (60.0, 160.0)  # of a second hand, from the first one
    turned: Turn = (0.0, 180.0)  # of a second hand, against the first one
    skin: Share = (0.0, 1.0)  # from light to dark


class OccluderFile(Strict):
    """One entry of `occluders:`"""

    kind: Literal["sphere", "box", "pill", "mesh"]
    mesh: str | None = None
    count: Count = (1, 1)
    place: Literal["free", "grasped"] = "free"
    size: Positive = (20.0, 60.0)  # diameter of a sphere or pill, edges of a box, longest side of a mesh
    length: _range(0.0) = (40.0, 160.0)  # of a pill
    nearer: _range(0.02, 0.98) = (0.3, 0.8)  # where between camera and hand a free one is
    aside: NotNegative = (0.0, 30.0)  # how far beside the line to a keypoint
    motion: MotionFile = MotionFile()
    textures: Textures = Field(default=["plain", "noise", "stripes", "checker"])


class LightsFile(Strict):
    """`lights:`"""

    count: _range(0.0, 8.0, whole=True) = (1, 3)
    ambient: _range(0.0, 1.0) = (0.2, 0.4)
    strength: NotNegative = (0.3, 0.8)
    colour: Share = (0.0, 0.2)  # how far from white
    cone: Turn = (0.0, 75.0)  # about the direction from the hand to the camera


class BackgroundFile(Strict):
    """`background:` one grey level, smooth colours at random, or pieces of the images in a folder."""

    kind: Literal["grey", "colours", "images"] = "colours"
    level: Level = (0.0, 255.0)
    folder: str | None = None


class SensorFile(Strict):
    """`sensor:`"""

    noise: _range(0.0, 100.0) = (0.0, 4.0)
    blur: Share = (0.0, 0.0)  # share of the frame interval
    readout: Share = (0.0, 0.0)  # share of the frame interval, rolling shutter
    vignette: Share = (0.0, 0.2)
    gain: _range(0.05, 5.0) = (0.8, 1.2)


class LabelsFile(Strict):
    """`labels:` what is written beside image and annotations."""

    depth: bool = True
    normal: bool = True
    part: bool = True
    flow: bool = True
    amodal: bool = True
    depth_unit: Annotated[float, Field(gt=0, le=10)] = 0.1


class SceneSchema(Strict):
    """The whole file."""

    format: Literal["handtrack/scene-1"]
    image: ImageFile = ImageFile()
    sequence: SequenceFile = SequenceFile()
    camera: CameraFile = CameraFile()
    hands: Annotated[list[HandFile], Field(min_length=1, max_length=2)] = Field(default_factory=lambda: [HandFile()])
    occluders: Annotated[list[OccluderFile], Field(max_length=12)] = Field(default_factory=list)
    lights: LightsFile = LightsFile()
    background: BackgroundFile = BackgroundFile()
    sensor: SensorFile = SensorFile()
    labels: LabelsFile = LabelsFile()
