"""Claims about the page that shows a dataset, and about the command that writes it."""

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from labelled_double import labelled_double

from handtrack.cli.dataset_browse import browse
from handtrack.errors import InputError
from synth.dataset import coco
from synth.dataset.browse import Tile, browse_page
from synth.dataset.browse_charts import bars, charts, histogram
from synth.dataset.browse_layers import (
    depth_colours,
    facts,
    flow_colours,
    layers,
    normal_colours,
    part_colour,
    part_colours,
    part_name,
)
from synth.dataset.coco_decode import coco_decoded
from synth.dataset.decode import decoded
from synth.dataset.encode import Labels, encoded
from synth.dataset.folder import frame_files
from synth.dataset.index import index_bytes, placed, row_of
from synth.dataset.record import DatasetRecord, dataset_text
from synth.dataset.shards import shard_bytes, spans_of
from synth.labels.solids import KEYPOINTS

IMAGES = [labelled_double(k, hands=1 + k % 2, occluders=2, sequence=k // 4, frame=k % 4) for k in range(9)]
SAMPLES = [encoded(image, Labels(), 3) for image in IMAGES]
ROWS = tuple(sample.row for sample in SAMPLES)


def tile(sample):
    return Tile(decoded(sample.key, sample.files), sample.files[0])


@pytest.fixture
def shards(tmp_path):
    rows = placed(ROWS, "shards/00000.tar", spans_of(SAMPLES))
    (tmp_path / "data/shards").mkdir(parents=True)
    (tmp_path / "data/shards/00000.tar").write_bytes(shard_bytes(SAMPLES))
    (tmp_path / "data/index.parquet").write_bytes(index_bytes(rows))
    return tmp_path / "data"


def test_the_page_holds_everything_and_loads_nothing(shards, tmp_path):
    assert browse(str(shards), tmp_path / "page.html", 4, 0) == 4
    text = (tmp_path / "page.html").read_text()
    assert text.count("<figure") == 4 and "9 images of 96 × 72 pixels in 3 sequences" in text
    assert not re.search(r"""(?:src|href)=["'](?!data:)""", text) and "://" not in text
    assert "default-src 'none'" in text and "$" not in re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)


def test_the_same_images_give_the_same_page_and_another_seed_others(shards, tmp_path):
    pages = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        browse(str(shards), tmp_path / name, 3, seed)
        pages.append((tmp_path / name).read_bytes())
    assert pages[0] == pages[1] != pages[2]


@pytest.fixture
def coco_folder(tmp_path):
    units = [coco.unit_files(IMAGES[k : k + 4], Labels(), k // 4) for k in range(0, 9, 4)]
    record = DatasetRecord("coco", 3, 9, 4, (), ())
    files = [file for unit in units for file in unit]
    files += [("index.parquet", index_bytes(ROWS)), ("dataset.json", dataset_text(record))]
    for name, content in files:
        (tmp_path / "coco" / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / "coco" / name).write_bytes(content)
    return tmp_path / "coco"


def test_a_coco_dataset_is_shown(coco_folder, tmp_path):
    assert browse(str(coco_folder), tmp_path / "page.html", 9, 0) == 9
    text = (tmp_path / "page.html").read_text()
    assert text.count("<figure") == 9 and text.count('class="over part"') == 9
    (coco_folder / "images" / "000000003.jpg").unlink()
    with pytest.raises(InputError, match="images: has no image 000000003"):
        browse(str(coco_folder), tmp_path / "page.html", 9, 0)


@pytest.mark.parametrize("k", range(9))
def test_coco_annotations_say_the_same_as_the_labels_of_archives(k):
    *_, (_, piece) = coco.unit_files([IMAGES[k]], Labels(), 0)
    entries = [(chr(line[0]), json.loads(line[1:])) for line in piece.splitlines() if line[:1] in (b"h", b"p")]
    there, here = decoded(SAMPLES[k].key, SAMPLES[k].files), coco_decoded(ROWS[k], IMAGES[k].image, entries)
    for a, b in zip(named_masks(there), named_masks(here), strict=True):
        assert a.keys() == b.keys()
        assert all(np.array_equal(a[name], b[name]) for name in a)
    assert np.array_equal(there.visibility, here.visibility)
    inside = there.visibility > 0
    np.testing.assert_array_equal(there.keypoint[inside], here.keypoint[inside])
    for hand, point in zip(*np.nonzero(there.hidden_by >= 0), strict=True):
        names = [part_name(image, int(image.hidden_by[hand, point])) for image in (there, here)]
        assert names[0] == names[1]
    assert facts(here).count("<table") == facts(there).count("<table")


def named_masks(image):
    """Modal and amodal masks that are not empty, by instance and name."""
    names = list(zip(image.parts.instance.tolist(), image.parts.name, strict=True))
    modal = {name: image.part == i for i, name in enumerate(names) if (image.part == i).any()}
    amodal = {name: image.amodal >> np.uint64(i) & np.uint64(1) for i, name in enumerate(names) if name in modal}
    return modal, amodal


def test_annotations_of_something_else_are_refused():
    with pytest.raises(InputError, match=f"annotations of image {ROWS[0].key}: 'part_visible_fraction'"):
        coco_decoded(ROWS[0], IMAGES[0].image, [("h", {"id": 1, "category_id": 1})])


def test_a_folder_of_sequences_shows_the_same_labels(shards, tmp_path):
    folder = tmp_path / "folders"
    for image in IMAGES:
        for name, content in frame_files(image, Labels(), 3):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
    (folder / "index.parquet").write_bytes(index_bytes(map(row_of, IMAGES)))
    texts = []
    for place in (shards, folder):
        browse(str(place), tmp_path / "page.html", 20, 0)
        text = (tmp_path / "page.html").read_text()
        texts.append(re.sub(r'class="base image"[^>]*>|<title>[^<]*·|<h1>\w+', "", text))
    assert texts[0].count("<figure") == 9 and texts[0] == texts[1]


def test_a_place_without_a_finished_dataset_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"index\.parquet: no such file; a finished dataset is wanted"):
        browse(str(tmp_path), tmp_path / "page.html", 3, 0)
    (tmp_path / "index.parquet").write_bytes(b"abc")
    with pytest.raises(InputError, match=r"index\.parquet: .*a Parquet file is wanted"):
        browse(str(tmp_path), tmp_path / "page.html", 3, 0)
    (tmp_path / "index.parquet").write_bytes(index_bytes([]))
    with pytest.raises(InputError, match=r"index\.parquet: has no image"):
        browse(str(tmp_path), tmp_path / "page.html", 3, 0)
    (tmp_path / "index.parquet").write_bytes(index_bytes(ROWS))
    with pytest.raises(InputError, match=r"has no labels of image \d; shards or sequence folders"):
        browse(str(tmp_path), tmp_path / "page.html", 3, 0)
    with pytest.raises(InputError, match="--count: 0 given; 1 to 400"):
        browse(str(tmp_path), tmp_path / "page.html", 0, 0)


def test_a_file_that_cannot_be_read_is_no_missing_one(tmp_path):
    (tmp_path / "index.parquet").mkdir()
    with pytest.raises(IsADirectoryError):
        browse(str(tmp_path), tmp_path / "page.html", 3, 0)
    (tmp_path / "index.parquet").rmdir()
    (tmp_path / "index.parquet").write_bytes(index_bytes(ROWS[:1]))
    (tmp_path / frame_files(IMAGES[0], Labels())[0][0]).mkdir(parents=True)
    with pytest.raises(IsADirectoryError):
        browse(str(tmp_path), tmp_path / "page.html", 3, 0)


def test_an_archive_that_the_index_does_not_describe_is_refused(shards, tmp_path):
    archive = shards / "shards/00000.tar"
    content = archive.read_bytes()
    first, second, *others = placed(ROWS, "shards/00000.tar", spans_of(SAMPLES))
    wrong = [replace(first, offset=second.offset, size=second.size), second, *others]
    (shards / "index.parquet").write_bytes(index_bytes(wrong))
    with pytest.raises(InputError, match=r"00000\.tar: image 000000000 at byte \d+: 000000001 is there; the archive"):
        browse(str(shards), tmp_path / "page.html", 20, 0)
    (shards / "index.parquet").write_bytes(index_bytes([first, second, *others]))
    archive.write_bytes(b"?" * len(content))
    with pytest.raises(InputError, match=r"00000\.tar: image 000000000 at byte 0: .*a tar archive is wanted"):
        browse(str(shards), tmp_path / "page.html", 20, 0)
    archive.unlink()
    with pytest.raises(InputError, match=r"image 000000000 at byte 0: nothing is there|tar archive is wanted"):
        browse(str(shards), tmp_path / "page.html", 20, 0)


def test_keypoints_are_drawn_by_visibility_and_hidden_ones_name_what_hides_them():
    image = decoded("x", SAMPLES[1].files)
    drawing = layers(image, SAMPLES[1].files[0])
    assert drawing.count('<circle class="seen"') == (image.visibility == 2).sum()
    assert drawing.count('<circle class="hidden"') == (image.visibility == 1).sum() > 0
    hand, k = np.argwhere(image.visibility == 1)[0]
    by = int(image.hidden_by[hand, k])
    fill = "#{:02x}{:02x}{:02x}".format(*part_colour(by))
    name = KEYPOINTS[k].replace("_", " ")
    assert re.search(rf'class="hidden" fill="{fill}"[^>]*><title>{name}: hidden by ', drawing)


def test_an_image_with_no_labels_but_keypoints_still_has_a_tile():
    none = Labels(depth=False, normal=False, part=False, flow=False, amodal=False)
    sample = encoded(replace(IMAGES[0], part=np.full_like(IMAGES[0].part, -1)), none)
    page = browse_page("a <b>", [tile(sample)], [sample.row])
    assert "a &lt;b&gt;" in page and page.count("<image") == 1


def test_colours_tell_near_from_far_and_leave_the_background_black():
    image: Any = decoded("x", SAMPLES[0].files)
    nothing = image.part < 0
    for colours in (depth_colours(image.depth), normal_colours(image.normal), flow_colours(image.flow)):
        assert not colours[nothing].any() and colours[~nothing].any()
    assert not depth_colours(np.full((3, 4), np.inf)).any()
    red_and_blue = depth_colours(np.array([[1.0, 2.0]]))[0].astype(int)
    assert red_and_blue[0, 0] > red_and_blue[0, 2] and red_and_blue[1, 2] > red_and_blue[1, 0]
    painted = part_colours(image)
    assert not painted[nothing].any() and (painted[~nothing][:, 3] == 150).all()
    assert len({part_colour(k) for k in range(64)}) == 64


def test_a_histogram_holds_every_value_once():
    chart = histogram("t", np.array([0.0, 1.0, 1.0, 10.0]), (0.0, 10.0), "mm")
    heights = [float(h) for h in re.findall(r'height="([\d.]+)"', chart.drawing)]
    assert sorted(heights) == [150.0, 150.0, 300.0] and chart.facts.startswith("4 values, median 1 mm")
    counted = histogram("t", np.array([0.0, 1.0, 1.0, 2.0]), (0.0, 3.0), "")
    assert counted.drawing.count("<rect") == 3 and "<i>2</i>" in counted.drawing
    assert "no values" in histogram("t", np.zeros(0), (0.0, 1.0), "").drawing


def test_bars_are_as_long_as_their_values():
    chart = bars("t", ["a_b", "c"], np.array([5.0, 10.0]), "%")
    assert re.findall(r"width:([\d.]+)%", chart.drawing) == ["50.0", "100.0"] and "a b" in chart.drawing


def test_charts_of_a_dataset_say_how_many_values_they_hold():
    by_title = {chart.title: chart for chart in charts(ROWS)}
    hands = sum(row.hands for row in ROWS)
    assert by_title["Visible share of each hand"].facts.startswith(f"{hands} values")
    assert by_title["Distance of the camera"].facts.startswith(f"{hands} values")
    assert len(by_title) == 7 and by_title["Joint angles"].drawing.count('class="strip"') == 10


def test_charts_of_a_dataset_without_hands_are_empty_and_no_error():
    row = encoded(labelled_double(0, hands=0), Labels()).row
    titles = [chart.title for chart in charts([row])]
    assert "Joint angles" not in titles and len(titles) == 5
