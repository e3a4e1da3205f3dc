"""A model in, the cells of its tables and the lines of its couplings out, in the units of files."""

import math

from ..formats.model_writing import exact_couplings, in_file_units, link_offsets
from ..kinematics import LinkSigmas, Model


def frame_rows(model: Model) -> list[list[object]]:
    """Id, parent, joint, limits, length and both radii of each frame; None where there is none."""
    rows: list[list[object]] = []
    for i in range(model.frame_ids.size):
        joint, parent = int(model.joint[i]), int(model.parent[i])
        row: list[object] = [int(model.frame_ids[i]), int(model.frame_ids[parent]) if parent >= 0 else 0]
        if joint < 0:
            row += [None, None, None]
        else:
            limits = [float(x) if model.prismatic[i] else math.degrees(x) for x in model.limits[joint]]
            row += [model.joint_names[joint], *(limit if math.isfinite(limit) else None for limit in limits)]
        links = [k for k in range(model.link_frame.size) if int(model.link_frame[k]) == i]
        pill = [[float(model.link_length[k]), *map(float, model.link_radius[k])] for k in links]
        rows.append(row + (list(pill[0]) if pill else [None, None, None]))
    return rows


def shape_rows(model: Model) -> list[list[object]]:
    """Id, offsets of both ends, and sigmas of length, radii and offsets, of each pill that has any of them."""
    rows: list[list[object]] = []
    for link, frame in enumerate(model.link_frame):
        base, tip = link_offsets(model, link)
        known = model.link_sigmas[link]
        if any(base) or any(tip) or known is not None:
            sigmas = known or LinkSigmas()
            spreads = [sigmas.length, list(sigmas.radius), list(sigmas.base_offset), list(sigmas.tip_offset)]
            rows.append([int(model.frame_ids[frame]), list(base), list(tip), *spreads])
    return rows


def coupling_lines(model: Model) -> list[str]:
    """One line for each coupling, in the units of files; soft ones end with their sigma."""
    lines = []
    for coupling in (*exact_couplings(model), *model.soft_couplings):
        given = in_file_units(model, coupling)
        offset = f" + {given.offset:g}" if given.offset else ""
        sigma = "" if given.sigma is None else f" (sigma {given.sigma:g})"
        lines.append(f"{given.joint} = {given.ratio:g} {given.of}{offset}{sigma}")
    return lines
