"""Claims about whole datasets through the command line: made, made again, and checked."""

import io
import json
import shutil
import tarfile
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from labelled_double import labelled_double

from handtrack.cli import dataset_making as making
from handtrack.cli import main
from handtrack.cli.dataset_progress import image_progress
from synth.dataset.encode import Labels, Sample, encoded
from synth.dataset.index import index_bytes, read_index
from synth.dataset.mask_bits import bits_of_texts
from synth.dataset.masks import masks_of_bits
from synth.dataset.rules import broken_rules, checked
from synth.dataset.shards import members_of, shard_bytes
from synth.dataset.store import open_store, tree_digest

SCENE = """format: handtrack/scene-1
image: {width: 48, height: 36}
sequence: {frames: 3}
hands:
  - {kind: pills}
occluders:
  - {kind: sphere}
"""
LAYOUTS = ("shards", "coco", "folders")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "verify.yaml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory):
    """A small dataset in each layout."""
    out = tmp_path_factory.mktemp("whole")
    for layout in LAYOUTS:
        assert _make(scene, out / layout, layout) == 0
    return out


@pytest.fixture
def copy(whole, tmp_path):
    """A dataset that may be damaged."""

    def copied(layout):
        shutil.copytree(whole / layout, tmp_path / layout)
        return tmp_path / layout

    return copied


def _make(scene, out, layout="shards", *more):
    arguments = ["dataset", str(scene), "--out", str(out), "--count", "7", "--shard-size", "4", "--workers", "1"]
    return main([*arguments, "--format", layout, *more])


def _verify(out, *more):
    return main(["dataset", "verify", str(out), "--workers", "1", *more])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_dataset_is_whole(whole, layout, capsys):
    assert _verify(whole / layout, "--share", "0.5", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["whole"] and facts["problems"] == []
    assert (facts["images"], facts["units"], facts["labels_checked"], facts["rendered_again"]) == (7, 2, 7, 4)
    rows = read_index((whole / layout / "index.parquet").read_bytes())
    assert [row.index for row in rows] == list(range(7))
    assert [row.frame for row in rows] == [0, 1, 2, 0, 1, 2, 0]


def test_a_run_tells_what_it_did(scene, tmp_path, capsys):
    assert _make(scene, tmp_path / "a", "shards", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["images"] == facts["made"] == 7 and facts["uri"] == str(tmp_path / "a")
    (tmp_path / "a" / "records" / "00001.json").unlink()
    assert _make(scene, tmp_path / "a") == 0
    assert ": 7 images (4 were there), " in capsys.readouterr().out


def test_an_archive_is_that_of_all_its_samples(whole):
    content = (whole / "shards" / "shards" / "00000.tar").read_bytes()
    rows = read_index((whole / "shards" / "rows" / "00000.parquet").read_bytes())
    samples = [Sample(key, files, row) for (key, files), row in zip(members_of(content), rows, strict=True)]
    assert shard_bytes(samples) == content


def test_the_number_of_a_frame_decides_nothing_but_itself(scene, whole, tmp_path):
    """Another size of unit makes the same images and index, in other archives."""
    _make(scene, tmp_path / "b", "coco", "--shard-size", "3")
    for path in (whole / "coco").rglob("*"):
        if path.parent.name in ("images", "annotations"):
            assert (tmp_path / "b" / path.relative_to(whole / "coco")).read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seed", "2"], "another dataset: seed 1 there, 2 here"),
        (["--count", "9"], "another dataset: count 7 there, 9 here"),
        (["--scheduler", "tcp://127.0.0.1:1"], "go with --engine dask"),
        (["--engine", "dask", "--scheduler", "tcp://10.1.1.1:1"], "10.1.1.1 is not this machine"),
        (["--storage-option", "a=b"], "goes with an object store"),
        (["--count", "0"], "greater than or equal to 1"),
    ],
)
def test_bad_arguments_are_one_line(scene, whole, capsys, arguments, message):
    before = tree_digest(open_store(str(whole / "shards")))
    assert _make(scene, whole / "shards", "shards", *arguments) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("error: ") and message in said and "\n" not in said
    assert tree_digest(open_store(str(whole / "shards"))) == before


def test_a_full_disk_is_one_line_and_exit_code_1(scene, tmp_path, capsys, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("synth.dataset.store.os.fsync", full)
    assert _make(scene, tmp_path / "full") == 1
    assert capsys.readouterr().err.strip() == (
        f"error: {tmp_path}/full/dataset.json: No space left on device; what is finished stays, run again to go on"
    )


def test_missing_packages_are_told_with_their_extra(monkeypatch, scene, tmp_path, capsys):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(making, "import_module", missing)
    assert _make(scene, tmp_path / "none") == 2
    assert "needs the package fsspec; install handtrack[dataset]" in capsys.readouterr().err


def test_the_first_word_is_a_scene_unless_it_is_a_command(capsys):
    for words in ([], ["--help"]):
        assert main(["dataset", *words]) == 0
        assert "verify" in capsys.readouterr().out
    for words in (["verify.yaml"], ["./verify"], ["--", "verify"]):
        assert main(["dataset", *words]) == 2
        assert "--out" in capsys.readouterr().err
    assert main(["dataset", "--count", "3"]) == 2
    assert "scene" in capsys.readouterr().err
    assert main(["dataset", "verify"]) == 2
    assert "uri" in capsys.readouterr().err


def test_a_page_is_written(whole, tmp_path, capsys):
    assert main(["dataset", "browse", str(whole / "shards"), "--out", str(tmp_path / "page.html"), "--count", "2"]) == 0
    assert capsys.readouterr().out.strip() == f"{tmp_path / 'page.html'}: 2 images"


def test_nothing_is_no_dataset(tmp_path, capsys):
    assert _verify(tmp_path) == 2
    assert "a dataset of `handtrack dataset` was wanted" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("layout", "name", "message"),
    [
        ("shards", "shards/00001.tar", "shards/00001.tar: is damaged; remove it and run the same command again"),
        ("coco", "images/000000003.jpg", "images/000000003.jpg: is damaged"),
        ("folders", "sequence_000001/depth/000002.png", "sequence_000001/depth/000002.png: is damaged"),
        ("shards", "index.parquet", "index.parquet: is damaged"),
        ("shards", "scene.yaml", "scene.yaml: is damaged"),
        ("shards", "records/00000.json", "the unit is not finished"),
        ("shards", "complete.json", "a record of handtrack/dataset-complete-1 was wanted"),
    ],
)
def test_a_changed_byte_is_found(copy, capsys, layout, name, message):
    path = copy(layout) / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2 if path.suffix != ".json" else 0] ^= 1
    path.write_bytes(content)
    assert _verify(path.parents[len(Path(name).parts) - 1], "--share", "0") == 1
    said = capsys.readouterr()
    assert "NOT whole" in said.out and message in said.err and "error: " in said.err


@pytest.mark.parametrize(
    ("layout", "name", "message"),
    [
        ("shards", "shards/00000.tar", "shards/00000.tar: is missing; run the same command again"),
        ("shards", "records/00001.json", "records/00001.json: is not there: the unit is not finished"),
        ("shards", "complete.json", "is not there: the dataset is not finished"),
    ],
)
def test_a_missing_file_is_found_and_made_again(copy, scene, whole, capsys, layout, name, message):
    out = copy(layout)
    (out / name).unlink()
    (out / "stranger.txt").write_text("")
    assert _verify(out, "--share", "0") == 1
    said = capsys.readouterr().err
    assert message in said and "stranger.txt: belongs to nothing" in said
    (out / "stranger.txt").unlink()
    assert _make(scene, out) == 0
    assert tree_digest(open_store(str(out))) == tree_digest(open_store(str(whole / layout)))


def test_images_that_another_scene_would_give_are_found(copy, scene, tmp_path, capsys, monkeypatch):
    out = copy("shards")
    other = tmp_path / "other.yaml"
    other.write_text(SCENE.replace("kind: sphere", "kind: box"))
    assert _verify(out, "--scene", str(other)) == 2
    assert "scene.yaml is not what the dataset was made from" in capsys.readouterr().err
    from synth.dataset import verify

    monkeypatch.setattr(verify, "image_files", lambda job, index: (("000000003.json", b""),))
    assert _verify(out) == 1
    assert "image 000000003: has the files" in capsys.readouterr().err


def test_a_scene_with_files_is_rendered_with_its_folder(tmp_path, capsys, monkeypatch):
    import cv2

    (tmp_path / "places").mkdir()
    cv2.imwrite(str(tmp_path / "places" / "a.png"), np.full((40, 50, 3), 90, np.uint8))
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE + "background: {kind: images, folder: places}\n")
    assert _make(scene, tmp_path / "out") == 0
    assert _verify(tmp_path / "out") == 0
    assert "not rendered again: the scene refers to other files (places/a.png)" in capsys.readouterr().err
    assert _verify(tmp_path / "out", "--scene", str(scene)) == 0
    assert " 1 rendered again" in capsys.readouterr().out
    monkeypatch.setattr("synth.dataset.job._version", lambda package: "9.9")
    _verify(tmp_path / "out", "--scene", str(scene))
    assert "warning: numpy" in capsys.readouterr().err
    cv2.imwrite(str(tmp_path / "places" / "a.png"), np.full((40, 50, 3), 91, np.uint8))
    assert _verify(tmp_path / "out", "--scene", str(scene)) == 2
    assert "places/a.png is not what the dataset was made from" in capsys.readouterr().err


def _forged(out, name, change):
    """Change a file of the first unit, and its record with it, so that only its content is wrong."""
    path, record = out / name, out / "records" / "00000.json"
    content = change(path.read_bytes())
    path.write_bytes(content)
    data = json.loads(record.read_text())
    files = [file | ({"sha256": sha256(content).hexdigest()} if file["name"] == name else {}) for file in data["files"]]
    record.write_text(json.dumps(data | {"files": files}))


def _without(word, by=b""):
    return lambda content: content.replace(word, by)


def _renamed(word, by):
    """An archive whose members have other names, with headers that are right again."""

    def forge(content):
        stream = io.BytesIO()
        with tarfile.open(fileobj=stream, mode="w", format=tarfile.USTAR_FORMAT) as archive:
            for key, files in members_of(content):
                for extension, data in files:
                    member = tarfile.TarInfo(f"{key}.{extension}".replace(word, by))
                    member.size = len(data)
                    archive.addfile(member, io.BytesIO(data))
        return stream.getvalue()

    return forge


FORGED = [
    ("shards", "shards/00000.tar", lambda c: shard_bytes([]), "holds 0 images; 4 are wanted"),
    ("shards", "shards/00000.tar", _without(b"000000002.", b"000000009."), "no header at byte"),
    ("shards", "shards/00000.tar", lambda c: c[:700], "is cut off"),
    ("shards", "shards/00000.tar", _without(b"handtrack/labels-1", b"handtrack/labels-2"), "not of format"),
    ("shards", "shards/00000.tar", _without(b'"hidden_by":', b'"hidden_BY":'), "no 'hidden_by'"),
    ("shards", "shards/00000.tar", _renamed("json", "jsox"), "no json"),
    ("shards", "shards/00000.tar", _without(b'"height":36', b'"height":37'), "has not the size of the image"),
    ("shards", "rows/00000.parquet", lambda c: index_bytes(read_index(c)[:3]), "of which the index says nothing"),
    ("shards", "rows/00000.parquet", lambda c: index_bytes(_moved(read_index(c))), "is not at byte"),
    ("shards", "rows/00000.parquet", lambda c: b"", "a Parquet file is wanted"),
    ("coco", "rows/00000.parquet", lambda c: index_bytes(read_index(c)[:3]), "does not name every image"),
    ("coco", "rows/00000.parquet", lambda c: index_bytes(_other_keys(read_index(c))), "images: has no image"),
    ("coco", "pieces/00000.jsonl", lambda c: b"\n".join(c.splitlines()[1:]), "annotations of 3 images, 4 are wanted"),
    ("coco", "pieces/00000.jsonl", _without(b'"area":', b'"area":1'), "pixels, its area is"),
    ("coco", "pieces/00000.jsonl", _without(b'"bbox":[', b'"bbox":[9'), "reaches out of its box"),
    ("coco", "pieces/00000.jsonl", _without(b'"visible_fraction":', b'"visible_fraction":7'), "visible fraction 7"),
    ("coco", "pieces/00000.jsonl", lambda c: _swapped(c), "a modal mask is not inside its amodal mask"),
    ("folders", "rows/00000.parquet", lambda c: index_bytes(_other_frames(read_index(c))), "no files of frame 99"),
]


def _moved(rows):
    return [replace(row, offset=row.offset + 512) for row in rows]


def _other_keys(rows):
    return [replace(row, key="x" + row.key) for row in rows]


def _other_frames(rows):
    return [replace(row, frame=99) for row in rows]


def _swapped(content):
    """Modal masks where amodal ones belong."""
    amodal, modal, other = b'"amodal_segmentation"', b'"segmentation"', b'"other"'
    return content.replace(amodal, other).replace(modal, amodal).replace(other, modal)


@pytest.mark.parametrize(("layout", "name", "change", "message"), FORGED)
def test_files_that_contradict_each_other_are_found(copy, capsys, layout, name, change, message):
    out = copy(layout)
    _forged(out, name, change)
    assert _verify(out, "--share", "0") == 1
    assert message in capsys.readouterr().err


def test_a_count_that_is_not_the_datasets_is_found(copy, capsys):
    path = copy("shards") / "complete.json"
    path.write_text(path.read_text().replace('"count": 7', '"count": 8').replace("index.parquet", "records/00000.json"))
    assert _verify(path.parent, "--share", "0") == 1
    said = capsys.readouterr().err
    assert "8 images, 7 are wanted" in said and "names no index.parquet" in said


def test_a_changed_picture_differs_from_what_is_rendered_again(copy, capsys, monkeypatch):
    from synth.dataset import verify

    made = verify.image_files
    monkeypatch.setattr(verify, "image_files", lambda job, k: tuple((n, c + b" ") for n, c in made(job, k)))
    assert _verify(copy("folders")) == 1
    assert "frames/000000.png differs from what is rendered again" in capsys.readouterr().err


def test_a_store_that_fails_while_it_is_checked_is_one_line(copy, capsys, monkeypatch):
    from synth.dataset import verify
    from synth.dataset.engine import Stopped

    def stops(*_):
        raise Stopped("a worker process was lost")

    monkeypatch.setattr(verify, "unit_verdict", stops)
    assert _verify(copy("shards")) == 1
    assert capsys.readouterr().err.strip() == "error: a worker process was lost"


@given(st.integers(0, 2**32), st.integers(1, 64), st.integers(1, 9), st.integers(1, 9))
def test_bits_come_back_from_masks(seed, count, height, width):
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2**63, (height, width), dtype=np.uint64) & np.uint64(2 ** min(count, 63) - 1)
    assert (bits_of_texts(masks_of_bits(bits, count), (height, width)) == bits).all()


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (("4", "5"), "texts\\[1\\]: is no mask of 2 x 2"),
        (("4", ""), "no compressed mask"),
        (("4", "!"), "no compressed mask"),
        (("4", "P"), "no compressed mask"),
        (("PPPPPPPP0",), "takes 9 characters"),
        (("6N",), "is no mask of"),
    ],
)
def test_damaged_masks_are_refused(texts, message):
    assert bits_of_texts((), (2, 2)).tolist() == [[0, 0], [0, 0]]
    with pytest.raises(ValueError, match=message):
        bits_of_texts(texts, (2, 2))


def _good():
    return checked("0", encoded(labelled_double(3), Labels(image="png")).files)


def test_labels_of_the_double_break_no_rule():
    for seed in range(5):
        files = encoded(labelled_double(seed, hands=seed % 3), Labels(image="png")).files
        assert broken_rules(checked("0", files)) == ()


def _changed(name, change):
    image = _good()
    value = np.array(getattr(image, name))
    change(value, image)
    return replace(image, **{name: value})


def _set(index, value):
    def change(array, image):
        array[index] = value

    return change


def _first(found):
    return tuple(axis[0] for axis in np.nonzero(found))


RULES = [
    ("part", _set((0, 0), 99), "part 98 of"),
    ("depth", lambda a, image: a.__setitem__(_first(image.part > 0), False), "foreground of depth"),
    ("normal", lambda a, image: a.__setitem__(_first(image.part == 0), True), "foreground of normals"),
    ("amodal", lambda a, image: a.__setitem__(_first(image.part == 0), 1), "union of amodal"),
    ("amodal", lambda a, image: a.__setitem__(_first(image.part == 1), 2), "not inside its amodal mask"),
    ("visible_area", _set(0, 1e9), "areas do not rise"),
    ("fraction", lambda a, image: a.__setitem__(_first(image.amodal_area > 0), np.nan), "fraction is given where"),
    ("fraction", lambda a, image: a.__setitem__(_first(image.amodal_area > 50), 0.123), "not visible over amodal"),
    (
        "visible_area",
        lambda a, image: a.__setitem__(int(np.bincount(image.part[image.part > 0]).argmax()) - 1, 0.0),
        "seen but has no visible area",
    ),
    ("visibility", _set((0, 0), 3), "none of 0, 1, 2"),
    ("hidden_by", lambda a, image: a.__setitem__(_first(image.visibility == 2), 5), "not hidden by something"),
    ("keypoint", lambda a, image: a.__setitem__(_first(image.visibility == 2), -3.0), "the image's edge"),
    ("visible_area", lambda a, image: a.__setitem__(slice(0, 20), 0.0), "keypoints of hand 0 are seen"),
    ("amodal_area", lambda a, image: a.__setitem__(np.unique(image.hidden_by)[-1], 0.0), "not in the image"),
    ("modal_box", _set(0, (5.0, 5.0, 4.0, 4.0)), "a box is empty, but not at 0"),
    ("modal_box", _set(0, (-9.0, 0.0, 999.0, 999.0)), "not inside its amodal box"),
    ("amodal_box", _set(0, (-9.0, 0.0, 999.0, 999.0)), "not inside the image"),
    ("modal_box", lambda a, image: a.__setitem__((0, 2), a[0, 0] + 1.0), "lie outside its modal box"),
]


@pytest.mark.parametrize(("name", "change", "message"), RULES)
def test_a_broken_rule_is_named(name, change, message):
    assert any(message in line for line in broken_rules(_changed(name, change)))


def test_progress_tells_rate_and_time_left(capsys, monkeypatch):
    monkeypatch.setattr("handtrack.cli.dataset_progress.SECONDS", 0.0)
    with image_progress("images", 100) as done:
        done(10, 10)
        done(30, 10)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("images: 10 of 100") and "images/s" in lines[1] and lines[1].endswith("left")


def test_workers_are_the_cores_of_this_process(monkeypatch):
    assert making.cores() >= 1
    monkeypatch.delattr(making.os, "sched_getaffinity", raising=False)
    assert making.cores() >= 1
