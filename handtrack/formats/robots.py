"""`robot.csv` in, the volume that a robot fills in every frame out; and back. Metres, camera axes.

The volume is a union of pills: `frame,link,ax,ay,az,bx,by,bz,radius` gives the ends and the radius of each. Every frame
of the scene has every link.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from .skeletons import FARTHEST
from .tables import integers, numbers, read_table

COLUMNS = ("frame", "link", "ax", "ay", "az", "bx", "by", "bz", "radius")
MOST_LINKS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class RobotVolume:
    """Ends of each link's axis (f, links, 2, 3) and its radius (f, links), metres, camera axes."""

    ends: Float[np.ndarray, "f links 2 3"]
    radius: Float[np.ndarray, "f links"]


def read_robot(path: Path | str, frames: int) -> RobotVolume:
    """Read the volume of a robot in a scene of so many frames.

    Raises
    ------
    InputError
        For a table that is malformed, a radius that is not above 0, coordinates beyond 50 m, or a link that is given
        twice or not at all in a frame of the scene.
    """
    path = Path(path)
    table = read_table(path, COLUMNS)
    frame, link = integers(table, "frame"), integers(table, "link")
    values = np.column_stack([numbers(table, name) for name in COLUMNS[2:]])
    for bad, text in (
        (link >= MOST_LINKS, f"link: a number below {MOST_LINKS} is wanted"),
        ((np.abs(values[:, :6]) > FARTHEST).any(axis=1), f"beyond {FARTHEST:g} m; metres are wanted"),
        (values[:, 6] <= 0, "radius: a number above 0 is wanted"),
    ):
        if bad.any():
            raise InputError(f"{path}: line {table.lines[bad.argmax()]}: {text}")
    links = int(link.max(initial=-1)) + 1
    inside = frame < frames
    times = np.zeros((frames, links), dtype=int)
    np.add.at(times, (frame[inside], link[inside]), 1)
    if (times != 1).any():
        n, k = np.argwhere(times != 1)[0]
        raise InputError(f"{path}: frame {n} has link {k} {times[n, k]} times; once is wanted")
    out = np.empty((frames, links, 7))
    out[frame[inside], link[inside]] = values[inside]
    return RobotVolume(out[..., :6].reshape(frames, links, 2, 3), out[..., 6].copy())


def robot_text(volume: RobotVolume) -> str:
    """Text of `robot.csv`.

    >>> ends = np.array([[[[0.0, 0.0, 2.0], [0.5, 0.0, 2.0]]]])
    >>> print(robot_text(RobotVolume(ends, np.array([[0.06]]))).splitlines()[1])
    0,0,0,0,2,0.5,0,2,0.06
    """
    frames, links = volume.radius.shape
    rows = np.concatenate([volume.ends.reshape(frames, links, 6), volume.radius[..., None]], axis=2)
    lines = [",".join(COLUMNS)]
    lines += [
        f"{n},{k},{','.join(f'{value + 0.0:.10g}' for value in rows[n, k])}"
        for n in range(frames)
        for k in range(links)
    ]
    return "\n".join(lines) + "\n"
