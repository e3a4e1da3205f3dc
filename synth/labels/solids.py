"""The things a camera sees at one instant: pills and triangles in camera axes, each belonging to a numbered part.

A part is the smallest thing with a label of its own: a phalanx, a metacarpal, the wrist, or a whole occluder. Parts
belong to instances (a hand, an occluder). Their numbers are the values of part images (-1: background) and the bits of
amodal images, so there are at most 64.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int, UInt64

from handtrack.pills import Pills

MOST_PARTS = 64
Kind = Literal["right_hand", "left_hand", "sphere", "box", "pill", "mesh"]


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """Names of the parts and whose they are; the same at every instant.

    Attributes
    ----------
    name : tuple of p str
        Of the part within its instance: `index_proximal`, `wrist`, ...; an occluder's only part has its kind's name.
    instance : (p,)
        Number of the instance of each part; ascending.
    kind : tuple of n str
        Kind of each instance; hands come first.
    """

    name: tuple[str, ...]
    instance: Int[np.ndarray, " p"]
    kind: tuple[Kind, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Solids:
    """Surfaces at one instant, camera axes, millimetres.

    Attributes
    ----------
    pills : Pills
        l pills.
    pill_axes : (l, 3, 3)
        Rows are the axes of each pill's own frame (x from base to tip); with its base they tie points to the surface.
    pill_part : (l,)
    vertices, normals : (v, 3), (v, 3)
        Unit outward normals for smooth shading.
    rest : (v, 3)
        The vertices in the axes of their instance before it bends, where textures are defined.
    triangles : (t, 3)
        Vertices, counter-clockwise seen from outside.
    triangle_part : (t,)
    """

    pills: Pills
    pill_axes: Float[np.ndarray, "l 3 3"]
    pill_part: Int[np.ndarray, " l"]
    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    rest: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "t 3"]
    triangle_part: Int[np.ndarray, " t"]


@dataclass(frozen=True, slots=True, eq=False)
class Keypoints:
    """Points to be labelled at one instant, 21 for each hand, in the order of `KEYPOINTS`.

    Attributes
    ----------
    p_cam : (n, 21, 3)
        Camera axes, millimetres; NaN where a hand has no such point.
    own : (n, 21) uint64
        Bits of the parts that a ray may meet first while the point still counts as seen: those the point lies in.
    """

    p_cam: Float[np.ndarray, "n 21 3"]
    own: UInt64[np.ndarray, "n 21"]


@dataclass(frozen=True, slots=True, eq=False)
class Paint:
    """Colour of each part: a base colour and a second one that a solid texture mixes in.

    Attributes
    ----------
    colour, second : (p, 3)
        Red, green, blue, 0..255.
    texture : (p,)
        Number in `TEXTURES`: plain, noise, stripes, checker.
    grain : (p,)
        Size of the texture's features, millimetres.
    specular, shininess : (p,)
        Share of the light mirrored, >= 0, and how narrow the highlight is: Phong's exponent, > 0.
    """

    colour: Float[np.ndarray, "p 3"]
    second: Float[np.ndarray, "p 3"]
    texture: Int[np.ndarray, " p"]
    grain: Float[np.ndarray, " p"]
    specular: Float[np.ndarray, " p"]
    shininess: Float[np.ndarray, " p"]


TEXTURES = ("plain", "noise", "stripes", "checker")


@dataclass(frozen=True, slots=True, eq=False)
class Lights:
    """Ambient light and lights far away.

    Attributes
    ----------
    ambient : float
        Share of the colour seen without any light.
    direction : (k, 3)
        Unit vectors from the scene to each light, camera axes.
    strength : (k, 3)
        Red, green, blue share of the colour that each light adds where it falls straight.
    """

    ambient: float
    direction: Float[np.ndarray, "k 3"]
    strength: Float[np.ndarray, "k 3"]


KEYPOINTS = (
    "wrist",
    *(f"thumb_{part}" for part in ("cmc", "mcp", "ip", "tip")),
    *(f"{finger}_{part}" for finger in ("index", "middle", "ring", "little") for part in ("mcp", "pip", "dip", "tip")),
)

HAND_PARTS = (
    "wrist",
    *(f"thumb_{part}" for part in ("metacarpal", "proximal", "distal")),
    *(
        f"{finger}_{part}"
        for finger in ("index", "middle", "ring", "little")
        for part in ("metacarpal", "proximal", "intermediate", "distal")
    ),
)
