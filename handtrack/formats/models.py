"""`model.yaml` in, a model out (`format: handtrack/model-1`).

Rows of modified Denavit-Hartenberg tables, hand thesis eq. (2.1): `alpha a d theta` in degrees and model units, where
`theta` (revolute) or `d` (prismatic) may be a joint; or a fixed 4x4 `transform` instead. Angles become radians here. A
link's pill may have its ends moved off the x axis, and standard deviations; a coupling with sigma is a soft prior.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, NonNegativeFloat, PositiveFloat, Tag

from ..errors import InputError
from ..kinematics.couplings import Coupling
from ..kinematics.tree import FrameRow, LinkSigmas, Model, model_from_rows
from .yaml_files import Document, Strict, at, read_yaml, shorten, validate

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
RESERVED = ("frame", "time", "status", "confidence")  # columns of poses.csv and truth.csv beside the joints
RIGID_TOLERANCE = 1e-6
_SHAPE, _SIGMA_TOLERANCE = 7, 1e-3  # parameters of a link's shape; how far its sigmas may be from the factor's


def _form(value: Any) -> str:
    return "keys" if isinstance(value, dict | Strict) else "list" if isinstance(value, list) else "number"


class JointFile(Strict):
    """A moving `theta` or `d`."""

    joint: str
    offset: float = 0.0
    limits: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None


_form_of_radius = Discriminator(lambda value: "list" if isinstance(value, list) else "number")
_Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
_Spread = Annotated[list[NonNegativeFloat], Field(min_length=3, max_length=3)]


class SigmasFile(Strict):
    """Standard deviations of a link's shape; 0 where it is not given."""

    length: NonNegativeFloat = 0.0
    radius: Annotated[
        Annotated[NonNegativeFloat, Tag("number")]
        | Annotated[list[NonNegativeFloat], Field(min_length=2, max_length=2), Tag("list")],
        _form_of_radius,
    ] = 0.0
    base_offset: _Spread = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    tip_offset: _Spread = Field(default_factory=lambda: [0.0, 0.0, 0.0])


class LinkFile(Strict):
    """A pill along the x axis of its frame; the offsets move the centres of its two ends, in the frame's axes."""

    length: PositiveFloat
    radius: Annotated[
        Annotated[PositiveFloat, Tag("number")]
        | Annotated[list[PositiveFloat], Field(min_length=2, max_length=2), Tag("list")],
        _form_of_radius,
    ]
    base_offset: _Triple | None = None
    tip_offset: _Triple | None = None
    sigmas: SigmasFile | None = None
    buried: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0


_Variable = Annotated[
    Annotated[float, Tag("number")] | Annotated[JointFile, Tag("keys")],
    Discriminator(lambda value: "keys" if _form(value) == "keys" else "number"),
]
_Row4 = Annotated[list[float], Field(min_length=4, max_length=4)]


class FrameFile(Strict):
    """One row of the table."""

    id: Annotated[int, Field(gt=0)]
    parent: Annotated[int, Field(ge=0)]
    alpha: float | None = None
    a: float | None = None
    d: _Variable | None = None
    theta: _Variable | None = None
    transform: Annotated[list[_Row4], Field(min_length=4, max_length=4)] | None = None
    link: LinkFile | None = None


class CouplingFile(Strict):
    """`joint = ratio * of + offset`, in the file's units: exactly, or with the standard deviation sigma."""

    joint: str
    of: str
    ratio: float
    offset: float = 0.0
    sigma: PositiveFloat | None = None


class ModelFile(Strict):
    """The whole file."""

    format: Literal["handtrack/model-1"]
    name: Annotated[str, Field(min_length=1)]
    units: Literal["mm", "m"] = "mm"
    frames: Annotated[list[FrameFile], Field(min_length=1)]
    couplings: list[CouplingFile] = Field(default_factory=list)
    shape_factor: list[list[float]] | None = None


def read_model(path: Path | str) -> Model:
    """Read a model file.

    Raises
    ------
    InputError
        In one line with file, line, place and what was wanted: for a file that is not of this format; ids given twice,
        parents that do not exist, cycles, no joint; joint names that are no words or not unique; lengths and radii
        that are not positive; offset ends of which one swallows the other; limits that are not low < high; transforms
        that are not rigid; couplings that name no joint or circle; a shape factor that is not lower triangular with
        seven rows for each link, or not of the links' sigmas.
    """
    return model_from_document(read_yaml(Path(path)))


def model_from_document(document: Document) -> Model:
    """The model that a parsed file describes; see `read_model`."""
    entry = validate(document, ModelFile)
    _check_tree(document, entry.frames)
    rows = [_row(document, i, frame) for i, frame in enumerate(entry.frames)]
    prismatic = {row.joint: row.prismatic for row in rows if row.joint is not None}
    if not prismatic:
        raise InputError(
            f"{at(document, ('frames',))} no frame has a joint; at least one `theta: {{joint: ...}}` is wanted"
        )
    couplings = [_coupling(document, i, coupling, prismatic) for i, coupling in enumerate(entry.couplings)]
    try:
        model = model_from_rows(entry.name, rows, couplings, entry.units)
    except ValueError as error:
        raise InputError(f"{at(document)} {error}") from error
    return model if entry.shape_factor is None else _with_factor(document, entry.shape_factor, rows, model)


def _with_factor(document: Document, given: list[list[float]], rows: Sequence[FrameRow], model: Model) -> Model:
    """The model with the lower triangle F of its shape's covariance `F F^T`, links in the order of the file."""
    place = ("shape_factor",)
    size = _SHAPE * model.link_frame.size
    if [len(row) for row in given] != list(range(1, size + 1)):
        raise InputError(f"{at(document, place)} {len(given)} rows; {size} rows of 1 to {size} numbers were wanted")
    factor = np.zeros((size, size))
    factor[np.tril_indices(size)] = np.concatenate([np.array(row, dtype=float) for row in given])
    if not (np.isfinite(factor).all() and (factor.diagonal() >= 0.0).all()):
        raise InputError(f"{at(document, place)} has a number that is not finite, or negative on the diagonal")
    listed = [row.id for row in rows if row.link_length is not None]
    order = np.array([listed.index(int(model.frame_ids[frame])) for frame in model.link_frame], dtype=int)
    if (np.diff(order) < 0).any():  # links of the model come parents first: the factor of the permuted covariance
        upper = np.linalg.qr(factor[(_SHAPE * order[:, None] + np.arange(_SHAPE)).ravel()].T)[1]
        factor = upper.T * np.where(upper.diagonal() < 0.0, -1.0, 1.0)
    known = [one or LinkSigmas() for one in model.link_sigmas]
    sigma = np.array([[one.length, *one.radius, *one.base_offset[1:], *one.tip_offset[1:]] for one in known]).ravel()
    off = np.abs(np.linalg.norm(factor, axis=1) - sigma) > _SIGMA_TOLERANCE * (sigma + 1e-9)
    if off.any():
        frame = int(model.frame_ids[model.link_frame[int(np.argmax(off)) // _SHAPE]])
        raise InputError(f"{at(document, place)} differs from the `sigmas` of frame {frame}; the same ones were wanted")
    return replace(model, shape_factor=factor)


def _check_tree(document: Document, frames: Sequence[FrameFile]) -> None:
    """Ids unique, parents present, no cycle; each error with the line of its frame."""
    parent: dict[int, int] = {}
    for i, frame in enumerate(frames):
        if frame.id in parent:
            raise InputError(f"{at(document, ('frames', i, 'id'))} {frame.id} is given twice; ids are unique")
        parent[frame.id] = frame.parent
    settled = {0}
    for i, frame in enumerate(frames):
        if frame.parent not in parent and frame.parent != 0:
            place = at(document, ("frames", i, "parent"))
            raise InputError(f"{place} frame {frame.parent} does not exist; the id of a frame, or 0, is wanted")
    for i, frame in enumerate(frames):
        way: list[int] = []
        number = frame.id
        while number not in settled:
            if number in way:
                circle = " > ".join(map(str, [*way[way.index(number) :], number]))
                raise InputError(
                    f"{at(document, ('frames', i, 'parent'))} parents go in a cycle ({circle}); a tree on 0 is wanted"
                )
            way.append(number)
            number = parent[number]
        settled.update(way)


def _row(document: Document, i: int, frame: FrameFile) -> FrameRow:
    row = _bare_row(document, i, frame)
    return row if frame.link is None else _with_link(document, ("frames", i, "link"), frame.link, row)


def _with_link(document: Document, place: tuple[str | int, ...], link: LinkFile, row: FrameRow) -> FrameRow:
    """The row with its pill."""
    radius, base, tip = _pair(link.radius), link.base_offset, link.tip_offset
    if base is not None or tip is not None:
        apart = math.dist(base or (0.0, 0.0, 0.0), np.add((link.length, 0.0, 0.0), tip or (0.0, 0.0, 0.0)))
        if not apart > abs(radius[0] - radius[1]):
            raise InputError(
                f"{at(document, place)} its ends are {apart:g} apart with radii {radius[0]:g} and {radius[1]:g}: "
                "one swallows the other; offsets that leave them further apart are wanted"
            )
    given = link.sigmas
    sigmas = None
    if given is not None:
        sigmas = LinkSigmas(given.length, _pair(given.radius), _triple(given.base_offset), _triple(given.tip_offset))
    return replace(
        row,
        link_length=link.length,
        link_radius=radius,
        link_base_offset=None if base is None else _triple(base),
        link_tip_offset=None if tip is None else _triple(tip),
        link_sigmas=sigmas,
        link_buried=link.buried,
    )


def _pair(given: float | list[float]) -> tuple[float, float]:
    return (given[0], given[1]) if isinstance(given, list) else (given, given)


def _triple(given: list[float]) -> tuple[float, float, float]:
    return given[0], given[1], given[2]


def _bare_row(document: Document, i: int, frame: FrameFile) -> FrameRow:
    """The row without its pill."""
    place = ("frames", i)
    if frame.transform is not None:
        extra = [key for key in ("alpha", "a", "d", "theta") if getattr(frame, key) is not None]
        if extra:
            raise InputError(f"{at(document, place)} has `transform` and `{extra[0]}`; one or the other is wanted")
        return FrameRow(frame.id, frame.parent, transform=_rigid(document, i, frame.transform))
    missing = [key for key in ("alpha", "a", "d", "theta") if getattr(frame, key) is None]
    if missing:
        raise InputError(
            f"{at(document, place)} '{missing[0]}' is missing; alpha, a, d and theta (or transform) are wanted"
        )
    if isinstance(frame.theta, JointFile) and isinstance(frame.d, JointFile):
        raise InputError(f"{at(document, place)} both d and theta are joints; one joint for each frame is wanted")
    prismatic = isinstance(frame.d, JointFile)
    moving = frame.d if isinstance(frame.d, JointFile) else frame.theta if isinstance(frame.theta, JointFile) else None
    d, theta = (
        value.offset if isinstance(value, JointFile) else float(value or 0.0) for value in (frame.d, frame.theta)
    )
    limits = (-math.inf, math.inf)
    if moving is not None:
        limits = _limits(document, (*place, "d" if prismatic else "theta"), moving, prismatic)
    return FrameRow(
        frame.id,
        frame.parent,
        math.radians(frame.alpha or 0.0),
        frame.a or 0.0,
        d,
        math.radians(theta),
        joint=None if moving is None else moving.joint,
        prismatic=prismatic,
        limits=limits,
    )


def _limits(
    document: Document, place: tuple[str | int, ...], moving: JointFile, prismatic: bool
) -> tuple[float, float]:
    """Limits in radians or model units; the joint's name is checked on the way."""
    if NAME.fullmatch(moving.joint) is None:
        raise InputError(
            f"{at(document, (*place, 'joint'))} {shorten(moving.joint)} is no joint name; "
            "letters, digits and _ are wanted, not beginning with a digit"
        )
    if moving.joint in RESERVED or moving.joint.endswith("_sigma"):
        raise InputError(
            f"{at(document, (*place, 'joint'))} '{moving.joint}' is the name of another column of the result tables; "
            "another joint name is wanted"
        )
    if moving.limits is None:
        return -math.inf, math.inf
    low, high = moving.limits
    if not low < high:
        raise InputError(f"{at(document, (*place, 'limits'))} [{low:g}, {high:g}]: low < high is wanted")
    return (low, high) if prismatic else (math.radians(low), math.radians(high))


def _rigid(document: Document, i: int, rows: list[list[float]]) -> np.ndarray:
    """A 4x4 transform, checked to be a rotation and a shift."""
    T = np.array(rows, dtype=float)
    place = at(document, ("frames", i, "transform"))
    if not np.array_equal(T[3], [0.0, 0.0, 0.0, 1.0]):
        raise InputError(f"{place} its last row is {T[3].tolist()}; [0, 0, 0, 1] is wanted")
    error = float(np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max())
    if not error <= RIGID_TOLERANCE or np.linalg.det(T[:3, :3]) < 0:
        raise InputError(f"{place} is not rigid: its upper 3x3 block must be a rotation within {RIGID_TOLERANCE:g}")
    return T


def _coupling(document: Document, i: int, entry: CouplingFile, prismatic: dict[str, bool]) -> Coupling:
    """A coupling in radians and model units."""
    for key, joint in (("joint", entry.joint), ("of", entry.of)):
        if joint not in prismatic:
            place = at(document, ("couplings", i, key))
            raise InputError(f"{place} joint {shorten(joint)} does not exist; wanted: {', '.join(prismatic)}")
    unit = {joint: 1.0 if slides else math.radians(1.0) for joint, slides in prismatic.items()}
    ratio = (
        entry.ratio
        if prismatic[entry.joint] == prismatic[entry.of]
        else entry.ratio * unit[entry.joint] / unit[entry.of]
    )
    own = unit[entry.joint]
    sigma = None if entry.sigma is None else entry.sigma * own
    return Coupling(entry.joint, entry.of, ratio, entry.offset * own, sigma)
