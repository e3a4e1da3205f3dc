"""A track in, `widths.csv` out: the measured and the filtered width of each link in each frame.

`frame,link,width_mm,sigma_mm,profiles,filtered_mm,filtered_sigma_mm`: one row for each frame and link, millimetres
whatever the model's unit. A link is named by the joint of its frame, or `frame_<id>` where that is fixed. Cells are
empty where a link was not seen, and filtered ones until it first is.
"""

import math
from pathlib import Path

import numpy as np

from ..kinematics.tree import Model
from ..track import Track
from ..width import FilteredWidths, filter_widths
from .writing import write_text

COLUMNS = ("frame", "link", "width_mm", "sigma_mm", "profiles", "filtered_mm", "filtered_sigma_mm")
_MILLIMETRES = {"mm": 1.0, "m": 1000.0}


def write_widths(path: Path | str, track: Track, model: Model) -> None:
    """Write the table, whole or not at all.

    Raises
    ------
    ValueError
        If the track has no widths, or not those of the model's links.
    """
    write_text(Path(path), widths_text(track, model))


def widths_text(track: Track, model: Model) -> str:
    """Text of `widths.csv`."""
    filtered = filtered_of(track)
    if track.width is None or track.width_sigma is None or track.width_profiles is None or filtered is None:
        raise ValueError("track: has no widths; one that `tracker.track` returned is wanted")
    names = link_names(model)
    if track.width.shape[1] != len(names):
        raise ValueError(
            f"track: has widths of {track.width.shape[1]} links; wanted the {len(names)} of '{model.name}'"
        )
    unit = _MILLIMETRES.get(model.units, 1.0)
    lines = [",".join(COLUMNS)]
    for i, frame in enumerate(track.frame):
        for k, name in enumerate(names):
            seen = _cells(unit * track.width[i, k], unit * track.width_sigma[i, k])
            kept = _cells(unit * filtered.width[i, k], unit * filtered.sigma[i, k])
            lines.append(f"{frame},{name},{seen},{track.width_profiles[i, k]},{kept}")
    return "\n".join(lines) + "\n"


def filtered_of(track: Track) -> FilteredWidths | None:
    """The widths of a track filtered over its frames; None for a track that does not say."""
    if track.width is None or track.width_sigma is None:
        return None
    return filter_widths(track.width, track.width_sigma, track.width_lasting)


def link_names(model: Model) -> tuple[str, ...]:
    """The joint that moves each link's frame; `frame_<id>` where there is none.

    >>> from handtrack.kinematics.builtin import model
    >>> link_names(model("two_finger"))[:2], link_names(model("p"))
    (('middle_mcp', 'middle_pip'), ('frame_2',))
    """
    joints = model.joint[model.link_frame]
    ids = model.frame_ids[model.link_frame]
    return tuple(
        model.joint_names[joint] if joint >= 0 else f"frame_{frame}" for joint, frame in zip(joints, ids, strict=True)
    )


def _cells(width: np.floating | float, sigma: np.floating | float) -> str:
    """Two cells, empty without a measurement."""
    return f"{float(width):.8g},{float(sigma):.6g}" if math.isfinite(sigma) else ","
