"""
Datasets: loading shards and COCO files
=======================================

Datasets of hands with exact occlusion labels come as tar shards or as COCO files. Both are read by packages that people
use already, webdataset and pycocotools. Here the library makes eight images, which are then loaded again;
``handtrack dataset SCENE --out FOLDER --count N`` makes as many as wanted.
``python examples/10_load_datasets.py --out loaded.png`` keeps the picture.
"""

import argparse
import contextlib
import io
import tempfile
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import webdataset
from pycocotools.coco import COCO

from synth.dataset import coco
from synth.dataset.draw import prepare, shot
from synth.dataset.encode import encoded
from synth.dataset.scene_file import read_scene
from synth.dataset.shards import shard_bytes
from synth.labels.look import labelled

# %%
# A scene file says what is drawn at random: a hand of pills of any side and pose, and a box before it.

SCENE = """format: handtrack/scene-1
image: {width: 256, height: 256, type: png}
camera: {fov: [35, 50], distance: [350, 450]}
hands: [{kind: pills, side: any}]
occluders: [{kind: box, size: [15, 30]}]
"""
folder = Path(tempfile.mkdtemp())
(folder / "scene.yaml").write_text(SCENE)
scene = read_scene(folder / "scene.yaml")
source = prepare(scene, seed=7)
images = [labelled(shot(source, index)) for index in range(8)]

# One shard, and the COCO files of the same images.
(folder / "00000.tar").write_bytes(shard_bytes(encoded(image, scene.labels, seed=7) for image in images))
*pictures, (_, piece) = coco.unit_files(images, scene.labels, 0)
for name, content in [*pictures, *coco.merged([piece])]:
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_bytes(content)

# %%
# webdataset gives a dictionary for each image: pictures as arrays, labels from its JSON file.

samples = list(webdataset.WebDataset(str(folder / "00000.tar"), shardshuffle=False).decode("rgb8"))
for sample in samples:
    hidden = [name for name in sample["json"]["hands"][0]["hidden_by_name"] if name]
    print(f"{sample['__key__']}: {len(hidden)} keypoints hidden, by {sorted(set(hidden))}")

# %%
# pycocotools gives masks and keypoints of the same hands. Visible ones are green, hidden ones red.

with contextlib.redirect_stdout(io.StringIO()):
    hands = COCO(str(folder / "annotations/hands.json"))
figure, axes = plt.subplots(2, 4, figsize=(12, 6.2), layout="constrained")
for axis, sample in zip(axes.flat, samples, strict=True):
    axis.imshow(sample["image.png"])
    for hand in hands.imgToAnns[sample["json"]["index"]]:
        axis.contour(hands.annToMask(hand), levels=[0.5], colors="gold", linewidths=1.0)
        for x, y, v in zip(*[iter(hand["keypoints"])] * 3, strict=True):
            axis.plot(x, y, "o", ms=4, color=("none", "red", "lime")[v])
    axis.set(title=sample["__key__"], xticks=[], yticks=[])

if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", help="file for the picture; without it nothing is written")
    if (out := parser.parse_known_args()[0].out) is not None:
        figure.savefig(out, dpi=100)
