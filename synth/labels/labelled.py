"""One image with all its labels, in memory."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8, UInt64

from handtrack.camera import Camera

from .solids import Parts

UNSEEN, HIDDEN, SEEN = 0, 1, 2  # COCO's visibility: outside the image or not there, hidden, seen


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """An image and what is known of it. Pixel (0, 0) is the centre of the top-left pixel; lengths are millimetres.

    Attributes
    ----------
    image : (h, w, 3) uint8
        Red, green, blue.
    depth : (h, w) float32
        Camera z of the surface, inf on the background.
    normal : (h, w, 3) float32
        Unit outward normal in camera axes, zero on the background.
    part : (h, w) int16
        Number of the part seen at the pixel's centre, -1 on the background: the modal masks of all parts.
    amodal : (h, w) uint64
        Bit k is set where part k would be seen if it were alone: the amodal masks of all parts.
    flow : (h, w, 2) float32
        Pixels (x, y) by which the surface point moves until the next frame; zero on the background, NaN where the
        point then lies behind the camera.
    keypoint : (n, 21, 2)
        Pixels of the keypoints of each hand, NaN where it has none or it lies behind the camera.
    keypoint_cam : (n, 21, 3)
        The same in camera axes.
    visibility : (n, 21)
        0 outside the image or not there, 1 hidden, 2 seen.
    hidden_by : (n, 21)
        Part that the ray to a hidden keypoint meets first; -1 where it is seen or outside.
    parts : Parts
    visible_area, amodal_area : (p,)
        Pixels, with fractions: area of each part inside the image, as it is seen and as it would be seen alone.
    fraction : (p,)
        Visible over amodal area; NaN where the part is wholly outside the image.
    modal_box, amodal_box : (n, 4)
        Pixels x0, y0, x1, y1 (half open) of every instance; zeros where nothing is seen.
    joint_names : tuple of n tuples of str
        Joints of each hand.
    angles : tuple of n arrays (j,)
        Joint values of each hand, radians.
    camera : Camera
    index, sequence, frame : int
        Number of the image in the dataset, of its sequence, and of the frame within it.
    """

    image: UInt8[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]
    part: Int[np.ndarray, "h w"]
    amodal: UInt64[np.ndarray, "h w"]
    flow: Float[np.ndarray, "h w 2"]
    keypoint: Float[np.ndarray, "n 21 2"]
    keypoint_cam: Float[np.ndarray, "n 21 3"]
    visibility: Int[np.ndarray, "n 21"]
    hidden_by: Int[np.ndarray, "n 21"]
    parts: Parts
    visible_area: Float[np.ndarray, " p"]
    amodal_area: Float[np.ndarray, " p"]
    fraction: Float[np.ndarray, " p"]
    modal_box: Float[np.ndarray, "i 4"]
    amodal_box: Float[np.ndarray, "i 4"]
    joint_names: tuple[tuple[str, ...], ...]
    angles: tuple[Float[np.ndarray, " j"], ...]
    camera: Camera
    index: int
    sequence: int
    frame: int
