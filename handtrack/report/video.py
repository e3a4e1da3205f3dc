"""Colour images in, a video that a browser plays out: H.264, 4:2:0, index at the front of the file.

Images are encoded as they come, so the length of a video costs no memory.
"""

import os
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.codec import codec as av_codec
from jaxtyping import UInt8

# In the order of preference; all of them play inside an mp4 in present browsers. VP9 is slower to write.
_ENCODERS = ("libx264", "libopenh264", "libvpx-vp9")
_OPTIONS = {
    "libx264": {"preset": "veryfast", "crf": "19"},
    "libopenh264": {"qp": "22"},
    "libvpx-vp9": {"deadline": "realtime", "cpu-used": "6", "crf": "30", "b": "0"},
}
_KEYFRAME_EVERY = 12  # frames: seeking to any frame decodes at most these, which keeps scrubbing smooth


def find_encoder() -> str:
    """The best video encoder that this PyAV was built with.

    Raises
    ------
    RuntimeError
        If it has none that a browser plays.
    """
    for name in _ENCODERS:
        try:
            av_codec.Codec(name, "w")
        except av_codec.UnknownCodecError:
            continue
        return name
    raise RuntimeError(f"no video encoder: one of {', '.join(_ENCODERS)} was wanted in PyAV {av.__version__}")


def write_video(path: Path, images: Iterable[UInt8[np.ndarray, "h w 3"]], fps: float) -> str:
    """Encode RGB images into an mp4 file; returns the encoder's name.

    Parameters
    ----------
    images : iterable of (h, w, 3)
        RGB, all of one size. An odd last row or column is repeated: 4:2:0 needs even sizes.
    fps : float
        Frames per second, above 0.

    Raises
    ------
    ValueError
        If there is no image, or `fps` is not above 0.
    RuntimeError
        If PyAV has no encoder that a browser plays.
    """
    if not fps > 0:
        raise ValueError(f"fps: {fps} given, a number above 0 was wanted")
    encoder = find_encoder()
    part = path.with_name(path.name + ".part")
    try:
        count = _encode(part, images, fps, encoder)
        if not count:
            raise ValueError("images: none given, at least one was wanted")
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    return encoder


def _encode(path: Path, images: Iterable[UInt8[np.ndarray, "h w 3"]], fps: float, encoder: str) -> int:
    count = 0
    with av.open(str(path), "w", format="mp4", container_options={"movflags": "+faststart"}) as container:
        stream: Any = None
        for image in images:
            padded = np.pad(image, ((0, image.shape[0] % 2), (0, image.shape[1] % 2), (0, 0)), mode="edge")
            if stream is None:
                stream = container.add_stream(encoder, Fraction(fps).limit_denominator(1000), _OPTIONS[encoder])
                stream.pix_fmt = "yuv420p"
                stream.height, stream.width = padded.shape[:2]
                stream.gop_size = _KEYFRAME_EVERY
                stream.thread_count = 1  # the same bytes on every machine
            container.mux(stream.encode(av.VideoFrame.from_ndarray(padded, format="rgb24")))
            count += 1
        if stream is not None:
            container.mux(stream.encode())
    return count
