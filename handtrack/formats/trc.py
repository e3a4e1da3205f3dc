"""Labelled people in, OpenSim's marker table out (.trc); `markers.read_markers` reads it back.

Three lines of facts, names, axes, then rows `frame time x y z x y z ...`, with tabs; millimetres, y up. A gap leaves
its cells empty.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from .markers import Markers
from .people import People
from .people_markers import people_markers
from .writing import write_text


def trc_text(markers: Markers, time: Float[np.ndarray, " m"], name: str) -> str:
    """Text of a marker table.

    Parameters
    ----------
    time : (m,)
        Seconds of every frame.
    name : str
        Of the file, which the format repeats.

    Raises
    ------
    ValueError
        If there is no marker or frame, which the format cannot hold, or not a time for each frame.

    >>> markers = Markers(("a", "b"), np.array([[[1.0, 2.0, 3.0], [np.nan] * 3]]), 30.0)
    >>> trc_text(markers, np.zeros(1), "x.trc").splitlines()[5].split("\\t")
    ['1', '0', '1', '2', '3', '', '', '']
    """
    m, n = markers.places.shape[:2]
    if not (m and n):
        raise ValueError(f"markers: got {m} frames of {n} markers, wanted at least one of each")
    if time.size != m:
        raise ValueError(f"time: got {time.size}, wanted {m}, one for each frame")
    rate = _short(markers.rate)
    axes = [f"{axis}{i}" for i in range(1, n + 1) for axis in "XYZ"]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{m}\t{n}\tmm\t{rate}\t1\t{m}",
        "\t".join(["Frame#", "Time", *(cell for one in markers.names for cell in (one, "", ""))]),
        "\t".join(["", "", *axes]),
    ]
    for i, (seconds, row) in enumerate(zip(time.tolist(), markers.places.reshape(m, -1).tolist(), strict=True), 1):
        lines.append("\t".join([str(i), _short(seconds), *("" if cell != cell else _short(cell) for cell in row)]))
    return "\n".join(lines) + "\n"


def write_trc(path: Path | str, people: People) -> None:
    """Write people as a marker table, whole or not at all; see `trc_text` and `people_markers`."""
    path = Path(path)
    write_text(path, trc_text(people_markers(people), people.time - people.time[:1].sum(), path.name))


def _short(value: float) -> str:
    return f"{value + 0.0:.10g}"
