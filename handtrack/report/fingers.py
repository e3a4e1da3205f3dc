"""Model in, its fingers out: which joints and links belong together, what they are called and how they are coloured.

A finger is a group of links that lead to one tip. A joint belongs to the finger all of whose links it moves; one that
moves several (a wrist) goes to a group of its own. Names are the common beginning of the joint names:
`index_mcp, index_pip` make `index`.
"""

import os.path
from collections.abc import Sequence
from dataclasses import dataclass

from ..kinematics import Model, joints_below

# Bright enough on a dark image, dark enough on a white page, and told apart by the common kinds of colour blindness;
# green, amber and red are left to the status.
_COLOURS = ("#2f8fff", "#ff8c2e", "#14bdb4", "#e35bc4", "#8d6bff", "#b3a800", "#c0663c", "#5f8795")

STATUS_COLOURS = (("tracked", "#2fb457"), ("uncertain", "#e8a317"), ("lost", "#e5484d"))


def finger_colour(number: int) -> str:
    """Colour `#rrggbb` of a finger by its number; they repeat after eight."""
    return _COLOURS[number % len(_COLOURS)]


@dataclass(frozen=True, slots=True, eq=False)
class Finger:
    """A group of joints and links, by their indices in the model, with a name and a colour `#rrggbb`."""

    name: str
    colour: str
    joints: tuple[int, ...]
    links: tuple[int, ...]


def fingers_of(model: Model) -> tuple[Finger, ...]:
    """Fingers of a model in the order of their first link, then the groups of joints that move several fingers."""
    moves = joints_below(model)[model.link_frame]
    # Finger numbers that each joint moves.
    groups = [tuple(sorted(set(model.link_finger[moved].tolist()))) for moved in moves.T]
    alone = [(finger,) for finger in range(int(model.link_finger.max(initial=-1)) + 1)]
    shared = sorted({group for group in groups if len(group) != 1})
    fingers: list[Finger] = []
    for group in alone + shared:
        joints = tuple(joint for joint, moved in enumerate(groups) if moved == group)
        links = tuple(i for i, finger in enumerate(model.link_finger) if group == (int(finger),))
        if joints or links:
            name = _common_name([model.joint_names[joint] for joint in joints]) or f"group {len(fingers) + 1}"
            fingers.append(Finger(name, finger_colour(len(fingers)), joints, links))
    return tuple(fingers)


def short_name(joint: str, finger: Finger) -> str:
    """The joint's name without the finger's, `pip` of `index_pip`."""
    return joint.removeprefix(finger.name).lstrip("_") or joint


def _common_name(names: Sequence[str]) -> str:
    """Common beginning of the names up to an underscore, or the names themselves where they share none."""
    if len(names) < 2:
        return names[0].rpartition("_")[0] or names[0] if names else ""
    start = os.path.commonprefix(list(names))
    whole = start if start in names else start.rpartition("_")[0]
    return whole.rstrip("_") or (", ".join(names) if len(names) < 4 else "")


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue 0..255 of `#rrggbb`.

    >>> rgb("#2f8fff")
    (47, 143, 255)
    """
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
