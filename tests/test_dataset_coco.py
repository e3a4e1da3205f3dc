"""Claims about the COCO files of a dataset, read with pycocotools."""

import contextlib
import io
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from labelled_double import labelled_double
from pycocotools import mask as reference
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from synth.dataset import coco
from synth.dataset.encode import Labels
from synth.dataset.masks import box_of_mask
from synth.labels.solids import KEYPOINTS

PNG = Labels(image="png")
IMAGES = [labelled_double(seed, hands=1 + seed % 2, occluders=2) for seed in range(8)]


@pytest.fixture(scope="module")
def coco_files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("coco")
    units = [coco.unit_files(IMAGES[k : k + 3], PNG, k // 3) for k in range(0, 8, 3)]
    for name, content in [file for unit in units for file in unit[:-1]] + list(
        coco.merged(unit[-1][1] for unit in units)
    ):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def opened(path) -> Any:
    with contextlib.redirect_stdout(io.StringIO()):
        return COCO(str(path))


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # pycocotools' own
def test_coco_masks_are_the_modal_masks(coco_files):
    hands, parts = (opened(coco_files / "annotations" / name) for name in ("hands.json", "parts.json"))
    assert len(hands.imgs) == 8 and {c["name"] for c in hands.cats.values()} == {"hand"}
    for image in IMAGES:
        instance = np.append(image.parts.instance, -1)[image.part]
        for entry in hands.imgToAnns[image.index]:
            hand = (entry["id"] - 1) % 64
            assert np.array_equal(hands.annToMask(entry), instance == hand)
            assert entry["area"] == (instance == hand).sum()
            x, y, w, h = entry["bbox"]
            assert [x, y, x + w, y + h] == image.modal_box[hand].tolist()
            whole = reference.decode(entry["amodal_segmentation"]).astype(bool)
            assert not (hands.annToMask(entry).astype(bool) & ~whole).any()
        seen = {int(k) for k in np.unique(image.part[image.part >= 0])}
        assert {(entry["id"] - 1) % 64 for entry in parts.imgToAnns[image.index]} == seen
        for entry in parts.imgToAnns[image.index]:
            k = (entry["id"] - 1) % 64
            mask = parts.annToMask(entry).astype(bool)
            assert np.array_equal(mask, image.part == k)
            x, y, w, h = entry["bbox"]
            assert [x, y, x + w, y + h] == box_of_mask(mask).tolist()
            assert parts.cats[entry["category_id"]]["name"] == image.parts.name[k]


def test_coco_keypoints_are_those_of_the_image(coco_files):
    hands = opened(coco_files / "annotations/hands.json")
    assert hands.cats[1]["keypoints"] == list(KEYPOINTS) and len(hands.cats[1]["skeleton"]) == 20
    for image in IMAGES:
        for entry in hands.imgToAnns[image.index]:
            hand = (entry["id"] - 1) % 64
            found = np.reshape(entry["keypoints"], (21, 3))
            assert (found[:, 2] == image.visibility[hand]).all()
            known = found[:, 2] > 0
            np.testing.assert_allclose(found[known, :2], image.keypoint[hand][known], atol=1e-6)
            assert not found[~known].any() and entry["num_keypoints"] == known.sum()
            assert [by is not None for by in entry["hidden_by"]] == (image.visibility[hand] == 1).tolist()


@pytest.mark.parametrize("kind", ["keypoints", "segm", "bbox"])
def test_coco_evaluation_of_the_truth_against_itself_is_perfect(coco_files, kind):
    truth = opened(coco_files / "annotations/hands.json")
    field = {"keypoints": "keypoints", "segm": "segmentation", "bbox": "bbox"}[kind]
    results = [
        {name: entry[name] for name in ("image_id", "category_id", field)} | {"score": 0.9}
        for entry in truth.anns.values()
    ]
    with contextlib.redirect_stdout(io.StringIO()):
        evaluation = COCOeval(truth, truth.loadRes(results), kind)
        evaluation.params.kpt_oks_sigmas = np.full(21, 0.05)
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    assert evaluation.stats[0] == pytest.approx(1.0)


def test_coco_files_do_not_depend_on_the_units():
    def merged(size):
        return coco.merged(coco.unit_files(IMAGES[k : k + size], PNG, 0)[-1][1] for k in range(0, 8, size))

    assert merged(3) == merged(8) == merged(1)


def test_parts_of_other_models_get_categories_of_their_own():
    image = labelled_double(0, occluders=0)
    image = replace(image, parts=replace(image.parts, name=tuple(f"link_{k}" for k in range(20))))
    _, (_, content) = coco.merged([coco.unit_files([image], PNG, 0)[-1][1]])
    document = json.loads(content)
    names = {entry["id"]: entry["name"] for entry in document["categories"]}
    assert len(names) == len(document["categories"]) and "link_3" in names.values()
    assert {names[entry["category_id"]] for entry in document["annotations"]} <= set(image.parts.name)
