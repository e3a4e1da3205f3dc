"""A video file in, grey float32 pictures and their times out, one at a time.

A header may promise more frames than the file holds. So the packets are counted first, without decoding; only where the
count is not what the header says is the file decoded once to find how many frames there really are.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.error import FFmpegError
from jaxtyping import Float

from ..errors import InputError
from .images import MAX_PIXELS, grey

SUFFIXES = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ogv", ".wmv")


@dataclass(frozen=True, slots=True, eq=False)
class VideoFile:
    """Frames of a video, decoded when they are asked for.

    Attributes
    ----------
    times : (n,)
        Seconds.
    own : (n,)
        Seconds since the first frame by the file's own time stamps; the same as `times` unless another rate was given.
    stamps : (n,)
        The file's own time stamps, to seek by.
    """

    path: Path
    times: Float[np.ndarray, " n"]
    own: Float[np.ndarray, " n"]
    stamps: tuple[int, ...]
    width: int
    height: int

    def __len__(self) -> int:
        return len(self.stamps)

    def read(self, i: int) -> Float[np.ndarray, "h w"]:
        """Frame `i` as grey values 0..255, float32: decoded from the key frame before it, or from the first.

        Raises
        ------
        InputError
            If the file is broken there.
        """
        stamp = self.stamps[i]
        for seeking in (True, False):  # some containers' indices lead behind the frame
            with _opened(self.path) as (container, stream):
                if seeking:
                    container.seek(stamp, stream=stream)
                for frame in container.decode(stream):
                    if frame.pts == stamp:
                        return self._grey(frame)
                    if frame.pts is None or frame.pts > stamp:
                        break
        raise InputError(f"{self.path}: frame {i} cannot be decoded; a complete video is wanted")

    def __iter__(self) -> Iterator[Float[np.ndarray, "h w"]]:
        with _opened(self.path) as (container, stream):
            count = 0
            for frame in container.decode(stream):
                yield self._grey(frame)
                count += 1
                if count == len(self.stamps):  # a truncated file would raise on the next frame
                    return
        raise InputError(
            f"{self.path}: frame {count} of {len(self.stamps)} cannot be decoded; a complete video is wanted"
        )

    def _grey(self, frame: av.VideoFrame) -> Float[np.ndarray, "h w"]:
        if (frame.width, frame.height) != (self.width, self.height):
            raise InputError(f"{self.path}: its size changes to {frame.width} x {frame.height}; one size is wanted")
        return grey(frame.to_ndarray(format="rgb24"))


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """Container and first video stream; what goes wrong in the block becomes an `InputError`."""
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise InputError(f"{path}: has no pictures; a video is wanted")
            stream = container.streams.video[0]
            stream.thread_type = "NONE"  # the same frames, whatever the number of cores
            yield container, stream
    except (FFmpegError, OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = (error.strerror if isinstance(error, OSError) else None) or " ".join(str(error).split())
        raise InputError(f"{path}: is no readable video ({reason})") from error


def open_video(path: Path, width: int, height: int, fps: float | None) -> tuple[VideoFile, float, tuple[str, ...]]:
    """Open a video file whose pictures have the camera's size.

    Parameters
    ----------
    fps : float or None
        Frames per second that `times` go by; None for the file's own time stamps.

    Returns
    -------
    VideoFile, float, tuple of str
        The frames, frames per second, and warnings: a file that ends before its header says.

    Raises
    ------
    InputError
        If it is no video, has no frame, another size, or more than 64 megapixels.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    with _opened(path) as (container, stream):
        size = (stream.codec_context.width, stream.codec_context.height)
        if size[0] * size[1] > MAX_PIXELS:
            raise InputError(f"{path}: is {size[0]} x {size[1]} pixels, over {MAX_PIXELS // 10**6} megapixels")
        if size != (width, height):
            raise InputError(
                f"{path}: is {size[0]} x {size[1]} pixels; {width} x {height}, the camera's size, is wanted"
            )
        rate = float(stream.average_rate or stream.guessed_rate or 0)
        base = float(stream.time_base or 0)
        promised = int(stream.frames or 0) or int((container.duration or 0) / av.time_base * rate)
        packets = [packet for packet in container.demux(stream) if packet.size]
        stamps = [packet.pts for packet in packets if not packet.is_discard]
        promised -= len(packets) - len(stamps)  # what an edit list cuts off is decoded but never shown
        complete = len(stamps) >= promised > 0 and None not in stamps and len(set(stamps)) == len(stamps)
    if not complete:
        stamps = _decoded_stamps(path)
    if not stamps:
        raise InputError(f"{path}: has no frame that can be decoded; a video is wanted")
    notes: tuple[str, ...] = ()
    if promised > len(stamps):
        notes = (f"{path}: ends after {len(stamps)} frames where its header says {promised}; those were read",)
    ordered = sorted(int(stamp) for stamp in stamps)
    own = (np.array(ordered, dtype=float) - ordered[0]) * base
    if fps is None and not rate > 0:
        raise InputError(f"{path}: does not say its frame rate; `fps` is wanted")
    times = own if fps is None else np.arange(len(ordered)) / fps
    return VideoFile(path, times, own, tuple(ordered), width, height), (rate if fps is None else fps), notes


def _decoded_stamps(path: Path) -> list[int]:
    """Time stamps of the frames that really decode, up to the first that does not."""
    stamps: list[int] = []
    try:
        with _opened(path) as (container, stream):
            for frame in container.decode(stream):
                if frame.pts is None or (stamps and frame.pts <= stamps[-1]):
                    break
                stamps.append(frame.pts)
    except InputError:
        pass  # the file ends inside a frame: what came before is what can be read
    return stamps
