"""Claims about the files of a dataset, held against readers that are not ours where there are any."""

import io
import json
import tarfile
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labelled_double import labelled_double
from pycocotools import mask as reference
from webdataset import WebDataset  # pyright: ignore[reportAttributeAccessIssue]

from handtrack.errors import InputError
from synth.dataset.decode import decoded
from synth.dataset.encode import Labels, encoded
from synth.dataset.index import index_bytes, placed, read_index, row_of
from synth.dataset.masks import bits_of_masks, box_of_mask, mask_of_text, masks_of_bits, masks_of_numbers, union_bits
from synth.dataset.shards import members_of, shard_bytes, spans_of
from synth.labels.solids import KEYPOINTS

CASES = [(seed, hands, occluders) for seed, (hands, occluders) in enumerate([(1, 2), (2, 3), (0, 2), (1, 0), (0, 0)])]
PNG = Labels(image="png")


def its_text(mask) -> str:
    encoded_mask: Any = reference.encode(np.asfortranarray(mask.astype(np.uint8)))
    return encoded_mask["counts"].decode()


# Masks


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 64), st.floats(0.0, 1.0), st.integers(0, 10**6))
def test_masks_of_any_bits_are_those_of_pycocotools(height, width, count, density, seed):
    rng = np.random.default_rng(seed)
    set_bits = rng.random((height, width, count)) < density
    bits = (set_bits * (np.uint64(1) << np.arange(count, dtype=np.uint64))).sum(axis=2, dtype=np.uint64)
    texts = masks_of_bits(bits, count)
    assert list(texts) == [its_text(set_bits[..., k]) for k in range(count)]
    assert (bits_of_masks(texts, (height, width)) == bits).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 30), st.integers(1, 30), st.integers(1, 30), st.integers(0, 10**6))
def test_masks_of_numbers_are_those_of_pycocotools(height, width, count, seed):
    number = np.random.default_rng(seed).integers(-1, count, (height, width))
    texts = masks_of_numbers(number.astype(np.int16), count)
    assert list(texts) == [its_text(number == k) for k in range(count)]


def test_long_runs_take_several_characters_and_come_back():
    mask = np.zeros((1500, 1400), bool)
    mask[3, 5] = mask[700:1490, 1000:] = True
    (text,) = masks_of_bits(mask.astype(np.uint64), 1)
    assert text == its_text(mask) and (mask_of_text(text, mask.shape) == mask).all()


@pytest.mark.parametrize("text", ["", "1!", "o", "~~", "é", "ooooooooo0", "211", "P0"])
def test_a_text_that_is_no_mask_of_that_size_is_refused(text):
    with pytest.raises(ValueError, match=r"^text: "):
        mask_of_text(text, (3, 3))


def test_a_part_beyond_the_count_is_refused():
    with pytest.raises(ValueError, match="count: 2 parts, and a pixel of part 5"):
        masks_of_numbers(np.array([[-1, 5]]), 2)


def test_unions_and_boxes_are_those_of_the_pixels():
    image = labelled_double(1, hands=2, occluders=2)
    owner, count = image.parts.instance, len(image.parts.kind)
    united = union_bits(image.amodal, owner, count)
    for g in range(count):
        own = np.stack([(image.amodal >> np.uint64(k)) & np.uint64(1) for k in np.flatnonzero(owner == g)]).any(axis=0)
        assert (((united >> np.uint64(g)) & np.uint64(1)) == own).all()
        assert box_of_mask(np.asarray(own)).tolist() == image.amodal_box[g].tolist()
    assert box_of_mask(np.zeros((4, 5), bool)).tolist() == [0.0, 0.0, 0.0, 0.0]


# Samples


@pytest.mark.parametrize(("seed", "hands", "occluders"), CASES)
def test_a_sample_decodes_to_its_labels(seed, hands, occluders):
    image = labelled_double(seed, hands=hands, occluders=occluders, index=seed + 7, sequence=3, frame=2)
    sample = encoded(image, PNG, seed=11)
    again: Any = decoded(sample.key, sample.files)
    seen = image.part >= 0
    assert sample.key == f"{seed + 7:09d}" and (again.index, again.sequence, again.frame) == (seed + 7, 3, 2)
    assert (again.seed, again.depth_unit) == (11, 0.1)
    for name in ("image", "part", "amodal", "visibility", "hidden_by", "modal_box", "amodal_box"):
        assert np.array_equal(getattr(again, name), getattr(image, name)), name
    for name in ("keypoint", "keypoint_cam", "visible_area", "amodal_area", "fraction"):
        np.testing.assert_allclose(getattr(again, name), getattr(image, name), rtol=0, atol=5.1e-7, err_msg=name)
    assert (np.isinf(again.depth) == ~seen).all()
    np.testing.assert_allclose(again.depth[seen], image.depth[seen], rtol=1e-6, atol=0.0501)
    np.testing.assert_allclose(again.normal, image.normal, rtol=0, atol=0.006)
    np.testing.assert_allclose(again.flow, image.flow, rtol=0, atol=0.5 / 64 + 1e-6)
    assert again.parts.name == image.parts.name and again.parts.kind == image.parts.kind
    assert (again.parts.instance == image.parts.instance).all()
    for names, values, names_again, values_again in zip(
        image.joint_names, image.angles, again.joint_names, again.angles, strict=True
    ):
        assert dict(zip(names_again, np.round(values_again, 7), strict=True)) == pytest.approx(
            dict(zip(names, values, strict=True)), abs=1e-7
        )
    assert again.camera.fx == image.camera.fx and (again.camera.R == image.camera.R).all()


def test_the_same_image_gives_the_same_bytes():
    first, second = (encoded(labelled_double(5), Labels(), 1) for _ in range(2))
    assert first.files == second.files and first.row == second.row


def test_the_json_file_is_sorted_and_compact_and_has_no_nan():
    image = labelled_double(1, hands=2)
    text = dict(encoded(image, PNG, 4).files)["json"]
    document = json.loads(text, parse_constant=lambda word: pytest.fail(word))
    assert json.dumps(document, sort_keys=True, separators=(",", ":")).encode() == text
    hand = document["hands"][1]
    for k, by in enumerate(hand["hidden_by"]):
        assert (by is None) == (hand["visibility"][k] != 1)
        assert by is None or image.parts.name[by] in hand["hidden_by_name"][k]
    assert "seed" not in json.loads(dict(encoded(image, PNG).files)["json"])


def test_pictures_are_what_other_readers_expect():
    image = labelled_double(2)
    files = dict(encoded(image, PNG).files)
    seen = image.part >= 0

    def read(name) -> Any:
        return cv2.imdecode(np.frombuffer(files[name], np.uint8), cv2.IMREAD_UNCHANGED)

    assert np.array_equal(read("image.png")[..., ::-1], image.image)
    assert np.array_equal(read("part.png"), image.part + 1)
    assert np.array_equal(read("depth.png"), np.where(seen, np.rint(np.where(seen, image.depth, 0) * 10), 0))
    normal = np.where(seen[..., None], np.rint(127.5 * (image.normal.astype(float) + 1)), 0)
    assert np.abs(read("normal.png")[..., ::-1] - normal).max() <= 1
    flow = read("flow.png")[..., ::-1]
    assert np.array_equal(flow[..., 2], seen)
    expected = np.rint(image.flow.astype(float) * 64 + 32768)[seen]
    assert np.abs(flow[seen][:, :2] - expected).max() <= 1 and not flow[~seen].any()


def test_flow_that_is_not_known_is_marked_and_comes_back_as_nan():
    image = labelled_double(3)
    flow = image.flow.copy()
    y, x = np.argwhere(image.part >= 0)[5]
    flow[y, x] = np.nan
    again: Any = decoded("x", encoded(replace(image, flow=flow), PNG).files)
    assert np.isnan(again.flow[y, x]).all() and np.isnan(again.flow).sum() == 2
    np.testing.assert_allclose(again.flow, flow, rtol=0, atol=0.01)


@pytest.mark.parametrize(("unit", "words"), [(0.001, "up to|from"), (2000.0, "another unit")])
def test_a_depth_that_does_not_fit_is_an_error_and_no_clip(unit, words):
    with pytest.raises(InputError, match=rf"image 0: a depth of .* mm does not fit into 16 bits .*({words})"):
        encoded(labelled_double(0), Labels(depth_unit=unit))


def test_a_depth_behind_the_camera_is_an_error():
    image = labelled_double(0)
    with pytest.raises(InputError, match=r"a depth of -.* mm does not fit"):
        encoded(replace(image, depth=image.depth - np.float32(2000.0)), Labels())


def test_flow_beyond_16_bits_is_an_error():
    image = labelled_double(0)
    with pytest.raises(InputError, match=r"image 0: flow of [0-9.]+ pixels; less than 512"):
        encoded(replace(image, flow=image.flow * np.float32(1000.0)), Labels())


def test_labels_that_are_not_wanted_are_not_written():
    none = Labels(depth=False, normal=False, part=False, flow=False, amodal=False)
    sample = encoded(labelled_double(0), none)
    again: Any = decoded(sample.key, sample.files)
    assert [name for name, _ in sample.files] == ["image.jpg", "json"]
    assert again.depth is again.normal is again.part is again.flow is again.amodal is None
    flow_alone: Any = decoded("x", encoded(labelled_double(0), replace(none, flow=True)).files)
    assert np.isnan(flow_alone.flow).any() and flow_alone.part is None


def test_a_jpeg_is_near_its_image_and_quality_sets_its_size():
    image = labelled_double(0)
    good, poor = (encoded(image, Labels(quality=quality)) for quality in (95, 40))
    assert np.abs(decoded("x", good.files).image.astype(int) - image.image).mean() < 10
    assert len(poor.files[0][1]) < 0.6 * len(good.files[0][1])


def changed(name, content):
    files = dict(encoded(labelled_double(0), PNG).files)
    return [(key, data) for key, data in (files | {name: content}).items() if data is not None]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("image.png", None, "an image and json are wanted"),
        ("json", None, "an image and json are wanted"),
        ("json", b"{", "x.json: .*JSON is wanted"),
        ("json", b"[]", "x.json: is not of format handtrack/labels-1"),
        ("json", b'{"format":"handtrack/labels-1"}', "x.json: no 'camera'"),
        ("json", b'{"format":"handtrack/labels-1","camera":{"height":72,"width":"?"}}', "x.json: invalid literal"),
        ("depth.png", b"", "x.depth.png: cannot be decoded"),
        ("depth.png", b"abc", "x.depth.png: cannot be decoded"),
        ("part.png", cv2.imencode(".png", np.zeros((3, 3), np.uint8))[1].tobytes(), "x.part.png: has shape"),
        ("part.png", cv2.imencode(".png", np.zeros((72, 96), np.uint16))[1].tobytes(), "of uint16; .* of uint8"),
    ],
)
def test_a_sample_that_is_not_whole_is_refused_by_name(name, content, words):
    with pytest.raises(InputError, match=words):
        decoded("x", changed(name, content))


def test_a_perspective_camera_with_distortion_comes_back():
    image = labelled_double(0)
    camera = replace(image.camera, kind="perspective", fy=80.0, distortion=np.array([0.1, 0.0, 0.001, 0.0, 0.0]))
    again: Any = decoded("x", encoded(replace(image, camera=camera), PNG).files).camera
    assert (again.kind, again.fx, again.fy) == ("perspective", camera.fx, 80.0)
    assert (again.distortion == camera.distortion).all()
    plain: Any = decoded("x", encoded(replace(image, camera=replace(camera, distortion=np.zeros(5))), PNG).files).camera
    assert not plain.distortion.any()


# Shards


SAMPLES = [encoded(labelled_double(seed, hands=1 + seed % 2), Labels(), 9) for seed in range(6)]


def test_an_archive_depends_on_its_samples_alone():
    content = shard_bytes(SAMPLES)
    assert content == shard_bytes(SAMPLES[::-1]) and len(content) % 10240 == 0
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        members = archive.getmembers()
    assert [member.name for member in members] == [f"{s.key}.{name}" for s in SAMPLES for name, _ in s.files]
    assert {(m.mtime, m.uid, m.gid, m.uname, m.gname, m.mode) for m in members} == {(0, 0, 0, "", "", 0o644)}


def test_spans_find_an_image_without_the_rest():
    content, spans = shard_bytes(SAMPLES), spans_of(SAMPLES)
    for sample, (offset, size) in zip(SAMPLES, spans, strict=True):
        assert list(members_of(content[offset : offset + size])) == [(sample.key, sample.files)]
    assert list(members_of(content)) == [(sample.key, sample.files) for sample in SAMPLES]


@pytest.mark.parametrize("content", [b"x" * 700, shard_bytes(SAMPLES[:1])[:2000]])
def test_an_archive_that_is_none_or_cut_off_is_refused(content):
    with pytest.raises(ValueError, match=r"^content: "):
        list(members_of(content))


def test_an_archive_of_other_things_is_refused():
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        archive.addfile(tarfile.TarInfo("readme"))
    with pytest.raises(ValueError, match="has no extension"):
        list(members_of(stream.getvalue()))


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # webdataset leaves closing to Python
def test_webdataset_loads_a_shard(tmp_path):
    (tmp_path / "00000.tar").write_bytes(shard_bytes(SAMPLES))
    shard: Any = WebDataset(str(tmp_path / "00000.tar"), shardshuffle=False)
    found = list(shard.decode("rgb8"))
    assert [sample["__key__"] for sample in found] == [sample.key for sample in SAMPLES]
    for seed, sample in enumerate(found):
        image = labelled_double(seed, hands=1 + seed % 2)
        assert sample["image.jpg"].shape == image.image.shape
        assert sample["json"]["hands"][0]["visibility"] == image.visibility[0].tolist()


# Index


def test_the_index_comes_back_and_its_bytes_are_the_same():
    rows = placed([sample.row for sample in SAMPLES], "shards/00000.tar", spans_of(SAMPLES))
    content = index_bytes(rows)
    assert content == index_bytes(iter(rows)) and read_index(content) == rows
    table = pq.read_table(io.BytesIO(content))
    assert table.num_rows == 6 and table.column("kinds").to_pylist()[1][:2] == ["right_hand", "left_hand"]
    assert rows[3].offset == sum(row.size for row in rows[:3])


def test_an_empty_index_has_its_columns():
    assert read_index(index_bytes([])) == ()


def test_rows_count_what_is_in_the_image():
    image = labelled_double(1, hands=2, occluders=3)
    row = row_of(image)
    assert (row.hands, row.occluders, row.kinds) == (2, 3, image.parts.kind)
    assert row.keypoints_seen == (image.visibility == 2).sum() and row.keypoints_hidden == (image.visibility == 1).sum()
    own = (image.part >= 0) & (image.part < 20)
    whole = (image.amodal & np.uint64(2**20 - 1)) != 0
    assert row.visible_fraction[0] == pytest.approx(own.sum() / whole.sum(), abs=1e-6)


def hand_points(axes):
    """A right hand that lies in a plane, knuckles away from the wrist, seen from one of six sides."""
    points = np.zeros((21, 3))
    up, side, _ = axes
    places = {"middle_mcp": (90, 0), "index_mcp": (90, 20), "little_mcp": (80, -35), "wrist": (0, 0)}
    for name, (u, s) in places.items():
        points[KEYPOINTS.index(name)] = u * up + s * side + 600.0 * np.array([0, 0, 1.0])
    return points


@pytest.mark.parametrize(("kind", "sign"), [("right_hand", 1.0), ("left_hand", -1.0)])
def test_the_view_is_where_the_camera_stands_in_the_axes_of_the_hand(kind, sign):
    x, y, z = np.eye(3)
    image = labelled_double(0, occluders=0)
    image = replace(image, parts=replace(image.parts, kind=(kind,)))
    # A right hand with its fingers up and its thumb to the left in the image shows its back to the camera.
    back = (-y, -sign * x, -z)
    palm, pointing = (-y, sign * x, z), (-z, -sign * x, y)
    for axes, view in ((back, (0, 0, 1)), (palm, (0, 0, -1)), (pointing, (0, 1, 0))):
        found: Any = row_of(replace(image, keypoint_cam=hand_points(axes)[None])).view[0]
        np.testing.assert_allclose(found, view, atol=1e-6)


def test_distance_is_along_the_ray_of_a_perspective_camera():
    image = labelled_double(0, occluders=0)
    points = np.full((1, 21, 3), (30.0, 40.0, 120.0))
    row = row_of(replace(image, keypoint_cam=points, camera=replace(image.camera, kind="perspective")))
    assert row.distance_mm == (130.0,) and row.view == (None,)
    assert row_of(replace(image, keypoint_cam=points * np.nan)).distance_mm == (None,)


def test_rows_out_of_order_are_refused():
    with pytest.raises(ValueError, match="rows: image numbers do not rise"):
        index_bytes([SAMPLES[1].row, SAMPLES[1].row])


def test_a_file_that_is_no_index_is_refused():
    import pyarrow as pa

    stream = io.BytesIO()
    pq.write_table(pa.table({"a": [1]}), stream)
    with pytest.raises(ValueError, match="has no column 'key'"):
        read_index(stream.getvalue())
    with pytest.raises(ValueError, match="a Parquet file is wanted"):
        read_index(b"abc")
