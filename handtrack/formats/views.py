"""The frames of several views in, checked to be in step; their names and what was cut off out.

Frame n of every view shows the same moment. Image files say nothing of time, so their numbers must be equal. Videos do:
counted from its first frame, frame n of each must be within half a frame of frame n of the first view. A video that
is longer than another is cut to the shortest, with a warning, because cameras seldom stop together.
"""

import os.path
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from .images import ImageFiles
from .videos import VideoFile

Frames = ImageFiles | VideoFile


def in_step(views: Sequence[Frames], fps: float) -> tuple[tuple[Frames, ...], tuple[str, ...]]:
    """The views, all of one length, and a warning where a video was cut.

    Parameters
    ----------
    fps : float
        Frames per second; half a frame is the most that two views may be apart.

    Raises
    ------
    InputError
        If two views are the same files, image files differ in number, or time stamps differ by over half a frame.
    """
    for number, view in enumerate(views):
        for other in views[:number]:
            if _first_file(view).resolve() == _first_file(other).resolve():
                raise InputError(f"{_first_file(view)}: is given for two views; files of its own for each are wanted")
    counts = [len(view) for view in views]
    shortest, longest = int(np.argmin(counts)), int(np.argmax(counts))
    count, notes = counts[shortest], ()
    if counts[longest] > count:
        if not all(isinstance(view, VideoFile) for view in views):
            raise InputError(
                f"{_place(views[shortest])}: {count} frames where {_place(views[longest])} has {counts[longest]}; "
                "the same number in every view is wanted"
            )
        cut = f"{counts[longest] - count} of {counts[longest]} frames of {_place(views[longest])} are left out"
        notes = (f"{_place(views[shortest])}: has {count} frames, fewer than another view; {cut}",)
    views = tuple(_cut(view, count) for view in views)
    _check_times(views, [view.times for view in views], 0.5 / fps)
    videos = [view for view in views if isinstance(view, VideoFile)]
    own = [video.own for video in videos]
    if len(own) > 1 and count > 1:
        _check_times(videos, own, 0.5 * float(np.median(np.diff(own[0]))))
    return views, notes


def view_names(views: Sequence[Frames]) -> tuple[str, ...]:
    """A name for each view: its video's, its folder's, or what the names of its images begin with.

    >>> left, right = (ImageFiles((Path(f"clip/{name}_0.png"),), np.zeros(1), 4, 3) for name in ("left", "right"))
    >>> view_names([left, right]), view_names([left])
    (('left', 'right'), ('clip',))
    """
    names = [view.path.name if isinstance(view, VideoFile) else view.paths[0].absolute().parent.name for view in views]
    if len(set(names)) < len(names):
        names = [view.path.name if isinstance(view, VideoFile) else _beginning(view.paths) for view in views]
    unique = len(set(names)) == len(names) and all(names)
    return tuple(names) if unique else tuple(f"view{number}" for number in range(len(names)))


def _beginning(paths: Sequence[Path]) -> str:
    return os.path.commonprefix([paths[0].stem, paths[-1].stem]).rstrip("0123456789_-. ")


def _first_file(view: Frames) -> Path:
    return view.path if isinstance(view, VideoFile) else view.paths[0]


def _place(view: Frames) -> str:
    return str(view.path) if isinstance(view, VideoFile) else f"{view.paths[0]} and on"


def _cut(view: Frames, count: int) -> Frames:
    if isinstance(view, VideoFile):
        return replace(view, times=view.times[:count], own=view.own[:count], stamps=view.stamps[:count])
    return view


def _check_times(views: Sequence[Frames], times: Sequence[Float[np.ndarray, " n"]], half: float) -> None:
    for view, own in zip(views[1:], times[1:], strict=True):
        bad = np.flatnonzero(np.abs(own - times[0]) > half * (1.0 + 1e-6))
        if bad.size:
            n = int(bad[0])
            raise InputError(
                f"{_place(view)}: frame {n} is {own[n]:.4g} s after its first, that of {_place(views[0])} "
                f"{times[0][n]:.4g} s; views in step within half a frame, {half:.3g} s, are wanted"
            )
