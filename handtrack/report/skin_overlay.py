"""A posed surface and a picture in, the picture with the visible outline of each finger's skin drawn on it out."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ..camera import Camera
from ..surface import Surface
from ..surface.raster import rasterise
from ..surface.view import view_of

_PALM = (170, 170, 170)
_FILL = 0.16


def draw_skin(
    canvas: UInt8[np.ndarray, "rows columns 3"],
    zoom: int,
    surface: Surface,
    camera: Camera,
    q: Float[np.ndarray, " j"],
    colours: Sequence[tuple[int, int, int]],
) -> None:
    """Draw in place: the skin of each finger tinted and outlined in the colour of its links, the palm in grey.

    Parameters
    ----------
    q : (j,)
        All joint values.
    colours : sequence of (red, green, blue)
        One for each link.
    """
    seen = rasterise(view_of(surface, camera, q[surface.model.free]).mesh, camera).triangle
    finger = np.where(seen >= 0, surface.finger[surface.region[np.maximum(seen, 0)]] + 1, -1)
    fill = canvas.copy()
    lines = []
    for number in np.unique(finger[finger >= 0]).tolist():
        shown = (finger == number).astype(np.uint8)
        found, _ = cv2.findContours(
            cv2.resize(shown, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST),
            cv2.RETR_LIST,
            cv2.CHAIN_APPROX_NONE,
        )
        own = np.flatnonzero(surface.model.link_finger == number - 1)
        colour = colours[own[0]] if number and own.size else _PALM
        cv2.drawContours(fill, found, -1, colour, -1)
        lines.append((found, colour))
    cv2.addWeighted(fill, _FILL, canvas, 1.0 - _FILL, 0.0, dst=canvas)
    for found, colour in lines:
        cv2.drawContours(canvas, found, -1, colour, 1, cv2.LINE_AA)
