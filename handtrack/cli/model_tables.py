"""A model in, the cells of its table and the lines of its couplings out, in the units of files."""

import math

from ..kinematics import Model


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


def coupling_lines(model: Model) -> list[str]:
    """One line for each joint that follows others, in the units of files."""
    lines = []
    slides = {int(j): bool(p) for j, p in zip(model.joint, model.prismatic, strict=True) if j >= 0}
    for joint in range(len(model.joint_names)):
        if joint in model.free:
            continue
        own = 1.0 if slides[joint] else 180.0 / math.pi
        terms = []
        for column, source in enumerate(model.free):
            ratio = float(model.coupling[joint, column])
            if ratio:
                unit = own / (1.0 if slides[int(source)] else 180.0 / math.pi)
                terms.append(f"{ratio * unit:g} {model.joint_names[int(source)]}")
        offset = float(model.coupling_offset[joint]) * own
        lines.append(f"{model.joint_names[joint]} = {' + '.join(terms)}" + (f" + {offset:g}" if offset else ""))
    return lines
