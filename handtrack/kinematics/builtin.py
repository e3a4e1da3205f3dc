"""A name in, a built-in model out: fingers and hands of the hand thesis with measured lengths, and its test chains.

The tables (2.2, 2.3, 6.1, 6.2 and the chains of section 3.2) are rows of eq. (2.1); the thesis prints symbols for the
lengths, so they come from anthropometry:

* hand length `HL` = 189 mm and breadth `HB` = 87 mm: median British men, Pheasant and Haslegrave, "Bodyspace", 3rd ed.,
  2005, table of hand dimensions;
* segment lengths and places of the MCP and thumb CMC joints as fractions of `HL` and `HB`: Buchholz, Armstrong and
  Goldstein, "Anthropometric data for describing the kinematics of the human hand", Ergonomics 35(3), 1992, 261-273.
  Their distal segments end at the fingertip, so the last pill is shorter by its own radius: its cap ends there too;
* radii: the index finger's PIP joint is 21 mm wide and 19 mm thick, the thumb's IP joint 23 by 22 mm (the same table of
  "Bodyspace"). The other radii follow in round proportions chosen here; they are not measured values;
* coupling of DIP and PIP, in `full_hand_coupled` only: DIP = 2/3 PIP is the customary rule (Rijpkema and Girard,
  "Computer animation of knowledge-based human grasping", SIGGRAPH 1991; cited from memory). How far hands keep to such
  rules: linear fits of DIP on PIP left mean absolute errors of 6 to 14 degrees in manipulation, and 9 to 18 for fits
  made on free motion, over 26 activities (Roda-Sales, Sancho-Bru and Vergara, PeerJ 10:e14051, 2022, abstract). A
  normal error of sigma 15 has the mean absolute value 12, so sigma is 15 degrees;
* ranges: hand thesis, Table 2.1. It has no row for abduction at the MCP joints; those ranges are chosen here.

It is a right hand: fingers along +y of frame {0}, thumb towards +x, palm towards +z. {0} lies on the line of the third
metacarpal (of the hand of Table 6.1: half-way to the index), level with the thumb's CMC joint.
"""

import math
from collections.abc import Callable

from .couplings import Coupling
from .tree import FrameRow, Model, model_from_rows

HAND_LENGTH, HAND_BREADTH = 189.0, 87.0

# Segments from the knuckle outwards, fractions of hand length (Buchholz et al. 1992).
SEGMENTS = {
    "thumb": (0.251, 0.196, 0.158),
    "index": (0.245, 0.143, 0.097),
    "middle": (0.266, 0.170, 0.108),
    "ring": (0.244, 0.165, 0.107),
    "little": (0.204, 0.117, 0.093),
}
# Knuckle from the wrist crease, fraction of hand length, and from the third metacarpal, fraction of hand breadth.
KNUCKLE_ALONG = {"thumb": 0.073, "index": 0.447, "middle": 0.446, "ring": 0.409, "little": 0.368}
KNUCKLE_ACROSS = {"thumb": 0.196, "index": 0.251, "middle": 0.0, "ring": -0.206, "little": -0.402}
# Radii in mm; index proximal and thumb proximal are measured, the rest are proportions of them (see above).
RADII = {
    "thumb": (12.5, 11.25, 9.5),
    "index": (10.0, 8.75, 7.75),
    "middle": (10.0, 8.75, 7.75),
    "ring": (9.25, 8.25, 7.25),
    "little": (8.25, 7.25, 6.5),
}
# Table 2.1, degrees; flexion is positive.
FINGER_RANGES = {"mcp": (-45.0, 90.0), "pip": (0.0, 100.0), "dip": (0.0, 80.0)}
THUMB_RANGES = {"palmar": (0.0, 45.0), "radial": (0.0, 60.0), "mcp": (-10.0, 55.0), "ip": (-15.0, 80.0)}
THUMB_CONTACT = 22.0  # radial angle from the index finger's direction at which these pills touch
ABDUCTION = (-20.0, 20.0)
THUMB_ABDUCTION = (-15.0, 15.0)
DIP_OF_PIP, DIP_OF_PIP_SIGMA = 2.0 / 3.0, 15.0  # sigma in degrees

Link = tuple[float, tuple[float, float]]


def _links(finger: str) -> tuple[Link, Link, Link]:
    """Length and radii of the three pills; the last ends its radius before the fingertip."""
    lengths = [round(fraction * HAND_LENGTH, 1) for fraction in SEGMENTS[finger]]
    lengths[2] = round(lengths[2] - RADII[finger][2], 1)
    first, second, third = ((length, (radius, radius)) for length, radius in zip(lengths, RADII[finger], strict=True))
    return first, second, third


def _row(
    id: int,
    parent: int,
    alpha: float = 0.0,
    a: float = 0.0,
    d: float = 0.0,
    theta: float = 0.0,
    joint: str | None = None,
    limits: tuple[float, float] | None = None,
    link: Link | None = None,
) -> FrameRow:
    """A row with angles in degrees, as the tables are read."""
    return FrameRow(
        id,
        parent,
        math.radians(alpha),
        a,
        d,
        math.radians(theta),
        joint=joint,
        limits=(-math.inf, math.inf) if limits is None else (math.radians(limits[0]), math.radians(limits[1])),
        link_length=None if link is None else link[0],
        link_radius=None if link is None else link[1],
    )


def _mirrored(limits: tuple[float, float]) -> tuple[float, float]:
    return -limits[1], -limits[0]


def _bending(first: int, parent: int, alpha: float, a: float, finger: str, sign: int = 1) -> list[FrameRow]:
    """MCP, PIP and DIP of a finger: three parallel axes, a pill on each frame; `sign` -1 where bending is negative."""
    rows = []
    for i, (part, link) in enumerate(zip(("mcp", "pip", "dip"), _links(finger), strict=True)):
        limits = FINGER_RANGES[part] if sign > 0 else _mirrored(FINGER_RANGES[part])
        rows.append(_row(first + i, parent, alpha, a, joint=f"{finger}_{part}", limits=limits, link=link))
        parent, alpha, a = first + i, 0.0, link[0]
    return rows


def _reach(finger: str) -> float:
    """From the level of the thumb's CMC joint to the knuckle, mm."""
    return round((KNUCKLE_ALONG[finger] - KNUCKLE_ALONG["thumb"]) * HAND_LENGTH, 1)


def _index() -> Model:
    """Table 2.2: one finger that bends towards +y of frame {0}."""
    return model_from_rows("index", _bending(1, 0, 0.0, 0.0, "index"))


def _index_thumb() -> Model:
    """Table 2.3. The pills touch at the zero pose: Table 2.1 measures the thumb from contact. Opening is positive.

    The thesis aligns the two base joints "as a simplification"; here each keeps its own distance from the wrist.
    """
    apart = 0.5 * (RADII["index"][0] + RADII["thumb"][0])
    first, second, third = _links("thumb")
    rows = [
        _row(1, 0, d=apart),
        *_bending(2, 1, 90.0, _reach("index"), "index", sign=-1),
        _row(5, 0, d=-apart),
        _row(6, 5, -90.0, 0.0, joint="thumb_cmc", limits=THUMB_RANGES["palmar"], link=first),
        _row(7, 6, 0.0, first[0], joint="thumb_mcp", limits=_mirrored(THUMB_RANGES["mcp"]), link=second),
        _row(8, 7, 0.0, second[0], joint="thumb_ip", limits=_mirrored(THUMB_RANGES["ip"]), link=third),
    ]
    return model_from_rows("index_thumb", rows)


def _two_finger() -> Model:
    """Table 6.1: middle and index finger side by side, 11 mm to each side of {0}; no abduction."""
    rows = []
    for first, across, finger in ((1, -11.0, "middle"), (6, 11.0, "index")):
        rows += [
            _row(first, 0, 180.0, across, theta=-90.0),
            _row(first + 1, first, 0.0, _reach(finger)),
            *_bending(first + 2, first + 1, -90.0, 0.0, finger),
        ]
    return model_from_rows("two_finger", rows)


def _finger_of_hand(first: int, side: int, finger: str) -> list[FrameRow]:
    """Rows 1-5 (little, ring: `side` -1) or 11-15 (middle, index: `side` 1) of Table 6.2; spreading is positive."""
    across = round(KNUCKLE_ACROSS[finger] * HAND_BREADTH, 1)
    return [
        _row(first, 0, 180.0 if side > 0 else 0.0, across, theta=-90.0 * side),
        _row(first + 1, first, 0.0, _reach(finger), joint=f"{finger}_abduction", limits=ABDUCTION),
        *_bending(first + 2, first + 1, -90.0 * side, 0.0, finger),
    ]


def _full_hand_rows() -> list[FrameRow]:
    """Table 6.2 with the rows that the thesis left out: ring like little, index like middle; 21 joints.

    The thumb's zero pose lies in the palm's plane, in contact with the index finger, from where Table 2.1 measures;
    `thumb_palmar` lifts it towards the palm's side, `thumb_radial` spreads it; its last two joints open when positive.
    """
    spread = (0.0, THUMB_RANGES["radial"][1] - THUMB_CONTACT)
    first, second, third = _links("thumb")
    across = round(KNUCKLE_ACROSS["thumb"] * HAND_BREADTH, 1)
    return [
        *_finger_of_hand(1, -1, "little"),
        *_finger_of_hand(6, -1, "ring"),
        *_finger_of_hand(11, 1, "middle"),
        *_finger_of_hand(16, 1, "index"),
        _row(21, 0, 0.0, across),
        _row(22, 21, 90.0, joint="thumb_palmar", limits=THUMB_RANGES["palmar"]),
        _row(23, 22, 90.0, theta=THUMB_CONTACT - 90.0, joint="thumb_radial", limits=spread, link=first),
        _row(24, 23, -90.0, first[0], joint="thumb_abduction", limits=THUMB_ABDUCTION),
        _row(25, 24, 90.0, joint="thumb_mcp", limits=_mirrored(THUMB_RANGES["mcp"]), link=second),
        _row(26, 25, 0.0, second[0], joint="thumb_ip", limits=_mirrored(THUMB_RANGES["ip"]), link=third),
    ]


def _full_hand() -> Model:
    return model_from_rows("full_hand", _full_hand_rows())


def _full_hand_coupled() -> Model:
    """The same hand with a soft prior of each finger's DIP on its PIP."""
    couplings = [
        Coupling(f"{finger}_dip", f"{finger}_pip", DIP_OF_PIP, sigma=math.radians(DIP_OF_PIP_SIGMA))
        for finger in ("little", "ring", "middle", "index")
    ]
    return model_from_rows("full_hand_coupled", _full_hand_rows(), couplings)


_STICK: Link = (5.0, (0.5, 0.5))  # section 3.2 draws sticks of length 5 and gives no width or unit


def _r() -> Model:
    """Section 3.2.1: one revolute joint."""
    return model_from_rows("r", [_row(1, 0, joint="theta1", link=_STICK)])


def _p() -> Model:
    """Section 3.2.2: one prismatic joint; the link lies along y of its frame, so a fixed frame turns x there."""
    return model_from_rows("p", [FrameRow(1, 0, joint="d1", prismatic=True), _row(2, 1, theta=90.0, link=_STICK)])


def _pr() -> Model:
    """Section 3.2.3: a revolute joint on a prismatic one."""
    rows = [FrameRow(1, 0, joint="d1", prismatic=True), _row(2, 1, -90.0, joint="theta2", link=_STICK)]
    return model_from_rows("pr", rows)


def _rr() -> Model:
    """Section 3.2.4: two revolute joints."""
    rows = [_row(1, 0, joint="theta1", link=_STICK), _row(2, 1, 0.0, _STICK[0], joint="theta2", link=_STICK)]
    return model_from_rows("rr", rows)


_MODELS: tuple[tuple[str, Callable[[], Model]], ...] = (
    ("index", _index),
    ("index_thumb", _index_thumb),
    ("two_finger", _two_finger),
    ("full_hand", _full_hand),
    ("full_hand_coupled", _full_hand_coupled),
    ("r", _r),
    ("p", _p),
    ("pr", _pr),
    ("rr", _rr),
)


def model_names() -> tuple[str, ...]:
    """Names that `model` knows.

    >>> model_names()
    ('index', 'index_thumb', 'two_finger', 'full_hand', 'full_hand_coupled', 'r', 'p', 'pr', 'rr')
    """
    return tuple(name for name, _ in _MODELS)


def model(name: str) -> Model:
    """A built-in model; lengths in millimetres (the chains of section 3.2 have no unit).

    Raises
    ------
    ValueError
        If there is no built-in model of that name.

    >>> model("two_finger").joint_names
    ('middle_mcp', 'middle_pip', 'middle_dip', 'index_mcp', 'index_pip', 'index_dip')
    """
    for known, build in _MODELS:
        if known == name:
            return build()
    raise ValueError(f"name: '{name}' is no built-in model; there are {', '.join(model_names())}")
