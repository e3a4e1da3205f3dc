"""Image and video files: grey values, refusals from the header, and warnings."""

import os
import struct
import zlib
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from av.codec.codec import UnknownCodecError
from PIL import Image

from handtrack.errors import InputError
from handtrack.formats.images import grey, image_paths, matching_paths, open_images_of, read_header, read_image
from handtrack.formats.videos import open_video

RAMP = np.arange(48, dtype=np.uint8).reshape(6, 8)


def saved(path: Path, pixels: np.ndarray, **options) -> Path:
    Image.fromarray(pixels).save(path, **options)
    return path


@pytest.mark.parametrize("suffix", ["png", "bmp", "tif", "pgm"])
def test_eight_bit_grey_is_read_as_it_is(tmp_path, suffix):
    image = read_image(saved(tmp_path / f"ramp ü %d.{suffix}", RAMP))
    assert image.dtype == np.float32
    np.testing.assert_array_equal(image, RAMP)


def test_colour_becomes_grey_by_rec_601(tmp_path):
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    image = read_image(saved(tmp_path / "a.png", pixels))
    np.testing.assert_allclose(image, pixels @ np.array([0.299, 0.587, 0.114]), atol=1e-4)
    np.testing.assert_allclose(grey(np.full((2, 2, 3), 255, np.uint8)), 255, atol=1e-4)


def test_sixteen_bit_is_scaled_not_cut(tmp_path):
    deep = (RAMP.astype(np.uint16) * 1394).clip(0, 65535).astype(np.uint16)
    path = saved(tmp_path / "deep.png", deep)
    assert read_header(path).deep
    np.testing.assert_allclose(read_image(path), deep / 257.0, atol=1e-4)


def png_of_rgb16(path: Path, values: np.ndarray) -> Path:
    """A 16-bit colour PNG by hand: Pillow writes none."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)
    header = struct.pack(">IIBBBBB", values.shape[1], values.shape[0], 16, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return path


def test_sixteen_bit_colour_is_scaled_with_a_warning(tmp_path):
    path = png_of_rgb16(tmp_path / "rgb16.png", np.full((6, 8, 3), 51400, np.uint16))
    images, notes = open_images_of([path], np.zeros(1), 8, 6)
    assert len(notes) == 1
    assert "16-bit values are scaled" in notes[0]
    np.testing.assert_allclose(images.read(0), 200, atol=1)


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P"])
def test_alpha_is_dropped_with_a_warning(tmp_path, mode):
    image = Image.fromarray(RAMP).convert("RGBA")
    image.putalpha(90)
    path = tmp_path / "alpha.png"
    if mode == "P":
        Image.fromarray(RAMP).convert("P").save(path, transparency=3)
    else:
        image.convert(mode).save(path)
    images, notes = open_images_of([path], np.zeros(1), 8, 6)
    assert "the alpha channel is dropped" in notes[0]
    np.testing.assert_allclose(images.read(0), RAMP, atol=1e-3)


def test_bilevel_and_cmyk_are_read(tmp_path):
    np.testing.assert_array_equal(read_image(saved(tmp_path / "b.png", RAMP > 20)), np.where(RAMP > 20, 255, 0))
    flat = Image.new("RGB", (8, 6), (90, 90, 90)).convert("CMYK")
    flat.save(tmp_path / "c.jpg", quality=100)
    np.testing.assert_allclose(read_image(tmp_path / "c.jpg"), 90, atol=3)


def test_pictures_over_64_megapixels_are_refused_before_decoding(tmp_path):
    for side in (9000, 60000):
        path = saved(tmp_path / f"{side}.png", RAMP)
        content = bytearray(path.read_bytes())
        content[16:24] = struct.pack(">II", side, side)
        content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"over 64 megapixels|not decoded"):
            read_header(path)
        with pytest.raises(InputError, match="not decoded"):
            read_image(path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("text.png", b"not an image", "is no readable image"),
        ("empty.png", b"", "is no readable image"),
        ("gif.png", b"GIF89a\x01\x00\x01\x00\x00\x00\x00;", "is no readable image"),
    ],
)
def test_files_that_are_no_images_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_header(tmp_path / name)


def test_a_truncated_image_is_refused_when_it_is_decoded(tmp_path):
    path = saved(tmp_path / "cut.png", np.random.default_rng(0).integers(0, 255, (60, 80), dtype=np.uint8))
    path.write_bytes(path.read_bytes()[:-2000])
    assert read_header(path).width == 80
    with pytest.raises(InputError, match=r"cut.png: is broken .*a complete image is wanted"):
        read_image(path)


def test_float_images_and_missing_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="8-bit or 16-bit"):
        read_header(saved(tmp_path / "f.tif", RAMP.astype(np.float32)))
    with pytest.raises(InputError, match="no such file"):
        read_header(tmp_path / "none.png")


def test_sizes_must_be_the_cameras_and_stay_so(tmp_path):
    path = saved(tmp_path / "a.png", RAMP)
    with pytest.raises(InputError, match="is 8 x 6 pixels; 9 x 6, the camera's size, is wanted"):
        open_images_of([path], np.zeros(1), 9, 6)
    images, _ = open_images_of([path], np.zeros(1), 8, 6)
    saved(path, RAMP[:4])
    with pytest.raises(InputError, match="is 8 x 4 pixels"):
        images.read(0)


def test_images_are_sorted_as_text_and_streamed(tmp_path):
    for number in (10, 9, 1):
        saved(tmp_path / f"{number}.png", np.full((6, 8), number, np.uint8))
    saved(tmp_path / ".hidden.png", RAMP)
    (tmp_path / "note.txt").write_text("x")
    paths, notes = matching_paths(tmp_path, "*.png", "here:")
    assert [path.name for path in paths] == ["1.png", "10.png", "9.png"]
    assert image_paths(tmp_path) == paths
    assert notes == ()
    images, _ = open_images_of(paths, np.arange(3.0), 8, 6)
    assert [image[0, 0] for image in images] == [1, 10, 9]
    assert len(images) == 3


def test_folders_may_be_called_anything(tmp_path):
    folder = tmp_path / "a[1] 100% ünï ✋"
    folder.mkdir()
    saved(folder / "x%03d.png", RAMP)
    paths, _ = matching_paths(tmp_path, "a[1] 100% ünï ✋/*.png", "here:")
    assert [path.name for path in paths] == ["x%03d.png"]


def test_links_out_of_the_folder_are_warned_of(tmp_path):
    inner = tmp_path / "clip"
    inner.mkdir()
    saved(tmp_path / "outside.png", RAMP)
    os.symlink(tmp_path / "outside.png", inner / "a.png")
    paths, notes = matching_paths(inner, "*.png", "here:")
    assert len(paths) == 1
    assert "a symbolic link leads out of its folder" in notes[0]


def test_patterns_that_match_nothing_are_refused(tmp_path):
    with pytest.raises(InputError, match="matches no file"):
        matching_paths(tmp_path, "*.png", "here:")
    with pytest.raises(InputError, match="is no folder"):
        matching_paths(tmp_path, "frames/*.png", "here:")
    with pytest.raises(InputError, match="has no images"):
        image_paths(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        image_paths(tmp_path / "none")


def video(
    path: Path,
    count: int = 12,
    codec: str = "mpeg4",
    size: tuple[int, int] = (64, 48),
    b_frames: int = 0,
    **options: str,
) -> Path:
    """Frames of flat grey that rises by 15 from each to the next, and starts again at the top."""
    with av.open(str(path), "w", options=options) as container:
        stream: Any = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = *size, "yuv420p", 4_000_000
        stream.gop_size = 5
        stream.codec_context.max_b_frames = b_frames
        for i in range(count):
            frame = av.VideoFrame.from_ndarray(
                np.full((size[1], size[0], 3), (30 + 15 * i) % 256, np.uint8), format="rgb24"
            )
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def test_video_frames_are_those_that_were_written(tmp_path):
    frames, fps, notes = open_video(video(tmp_path / "clip ü.mp4"), 64, 48, None)
    assert (len(frames), fps, notes) == (12, 25.0, ())
    np.testing.assert_allclose(frames.times, np.arange(12) / 25)
    levels = [float(image.mean()) for image in frames]
    np.testing.assert_allclose(levels, 30 + 15 * np.arange(12), atol=4)
    for i in (7, 0, 11):
        np.testing.assert_array_equal(frames.read(i).mean(), np.float32(levels[i]))


def test_a_given_frame_rate_sets_the_times(tmp_path):
    frames, fps, _ = open_video(video(tmp_path / "clip.mp4"), 64, 48, 50.0)
    assert fps == 50.0
    np.testing.assert_allclose(frames.times, np.arange(12) / 50)


def test_a_truncated_video_is_read_as_far_as_it_goes_with_a_warning(tmp_path):
    path = video(tmp_path / "clip.mp4", count=40, movflags="faststart")
    path.write_bytes(path.read_bytes()[: int(0.7 * path.stat().st_size)])
    frames, _, notes = open_video(path, 64, 48, None)
    assert 0 < len(frames) < 40
    assert f"ends after {len(frames)} frames where its header says 40" in notes[0]
    assert len(list(frames)) == len(frames)


@pytest.mark.parametrize(
    ("name", "codec"), [("a.avi", "mpeg4"), ("a.ts", "libx264"), ("a.webm", "libvpx"), ("a.mp4", "libx264")]
)
def test_every_frame_of_every_container_can_be_read_alone(tmp_path, name, codec):
    try:
        path = video(tmp_path / name, count=9, codec=codec, b_frames=2)
    except UnknownCodecError:
        pytest.skip(f"this build of FFmpeg has no {codec}")
    frames, _, notes = open_video(path, 64, 48, None)
    assert notes == ()
    assert [frames.read(i).mean() for i in range(9)] == [image.mean() for image in frames]


def test_a_truncated_video_whose_header_only_has_a_duration_is_told(tmp_path):
    path = video(tmp_path / "clip.mkv", count=40)
    path.write_bytes(path.read_bytes()[: int(0.7 * path.stat().st_size)])
    frames, _, notes = open_video(path, 64, 48, None)
    assert len(list(frames)) == len(frames) < 40
    assert f"ends after {len(frames)} frames where its header says 40" in notes[0]


def test_a_broken_frame_in_the_middle_is_an_error(tmp_path):
    path = video(tmp_path / "clip.mp4", count=40, movflags="faststart")
    content = path.read_bytes()
    start = content.index(b"mdat") + 4
    path.write_bytes(content[: start + 200] + bytes(len(content) - start - 200))
    frames, _, _ = open_video(path, 64, 48, None)
    with pytest.raises(InputError, match=r"clip.mp4: (frame \d+ of 40 cannot be decoded|is no readable video)"):
        list(frames)


def test_a_video_without_a_single_frame_is_refused(tmp_path):
    path = video(tmp_path / "clip.mkv", count=12)
    content = path.read_bytes()
    pictures = content.index(bytes.fromhex("1f43b675"))  # the first cluster of them
    for more in (0, 16, 60):
        path.write_bytes(content[: pictures + more])
        with pytest.raises(InputError, match=r"clip.mkv: (has no frame that can be decoded|is no readable video)"):
            open_video(path, 64, 48, None)


def test_a_video_that_ends_inside_a_frame_is_read_up_to_there(tmp_path):
    path = video(tmp_path / "clip.avi", count=40, b_frames=2)
    content = path.read_bytes()
    for share in (0.65, 0.7, 0.75):
        path.write_bytes(content[: int(share * len(content))])
        frames, _, notes = open_video(path, 64, 48, None)
        assert len(list(frames)) == len(frames) < 40
        assert "where its header says 40; those were read" in notes[0]


def test_a_video_without_a_count_in_its_header_is_counted(tmp_path):
    frames, _, notes = open_video(video(tmp_path / "clip.mkv"), 64, 48, None)
    assert (len(frames), notes) == (12, ())


def test_bad_videos_are_refused(tmp_path):
    path = video(tmp_path / "clip.mp4")
    with pytest.raises(InputError, match="is 64 x 48 pixels; 60 x 48, the camera's size"):
        open_video(path, 60, 48, None)
    (tmp_path / "text.mp4").write_text("no video")
    with pytest.raises(InputError, match="is no readable video"):
        open_video(tmp_path / "text.mp4", 64, 48, None)
    with pytest.raises(InputError, match="no such file"):
        open_video(tmp_path / "none.mp4", 64, 48, None)
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(InputError, match="is no readable video"):
        open_video(path, 64, 48, None)


def test_sound_alone_is_no_video(tmp_path):
    with av.open(str(tmp_path / "sound.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with pytest.raises(InputError, match="has no pictures"):
        open_video(tmp_path / "sound.mkv", 64, 48, None)


def test_frames_that_vanish_after_opening_are_an_error_not_a_short_answer(tmp_path):
    path = video(tmp_path / "clip.mkv", count=30)
    frames, _, _ = open_video(path, 64, 48, None)
    video(path, count=5)
    with pytest.raises(InputError, match="frame 5 of 30 cannot be decoded"):
        list(frames)
    with pytest.raises(InputError, match=r"frame 25 cannot be decoded|is no readable video"):
        frames.read(25)
    video(path, count=5, size=(32, 32))
    with pytest.raises(InputError, match="its size changes to 32 x 32"):
        list(frames)
